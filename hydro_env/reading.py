"""Reading YAML and JSON: every such file of the project is read here, and nothing else parses either.

`check_file` looks at a user's file of any kind before it is opened; `run_python` runs one with Python code.

What is read comes from strangers, too. So it is plain data (tables with text keys, lists, text, numbers, truth values, null)
of a bounded size, depth and number of values, and whatever is wrong is one `InputError` that names file and line:

* the file is UTF-8 text, with or without a byte order mark;
* a key is text and stands once in its table;
* text can be written again: no NUL, no half of a surrogate pair;
* whole numbers have at most `DIGITS` digits;
* in YAML, what looks like a date or like 1:30 is text, an alias costs what it stands for, `<<` merges nothing, and there
  are no tags beyond those of plain data. Python's recursion limit and the alias limit guard against "billion laughs".
"""

import hashlib
import importlib.util
import json
import os
import re
import stat
import sys
from importlib import resources
from pathlib import Path
from types import ModuleType
from typing import Any

import yaml

from hydro_env.errors import InputError, shown

#: Size of a YAML file; the largest of the package has 10 kB. PyYAML takes some seconds for as much.
MAX_BYTES_OF_YAML = 2**17
#: Size of any other file that is written by hand.
MAX_BYTES = 2**20
#: Size of a JSON file that a command wrote.
MAX_BYTES_OF_RESULTS = 2**28
#: Values in a file written by hand, each alias counted as what it stands for.
MAX_VALUES = 10**6
#: Tables and lists inside each other.
DEPTH = 40
#: Of a whole number: enough for the 128 bits of a random stream's entropy.
DIGITS = 40


# --- files ------------------------------------------------------------------------------------------------------------
def check_file(path: str | Path, what: str) -> None:
    """InputError that says that `what` is expected ("a model in YAML") unless `path` is a plain file that may be read: a pipe
    or a device may never end."""
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISREG(mode):
            with open(path, "rb"):
                return
        problem = "a folder" if stat.S_ISDIR(mode) else "a pipe or a device, not a plain file"
    except (FileNotFoundError, NotADirectoryError):
        problem = "no such file"
    except OSError as error:
        problem = f"cannot be read ({error.strerror})"
    except ValueError as error:  # a zero byte in the name
        problem = f"no path of a file ({error})"
    raise InputError(f"{path}: {problem}; expected {what}")


def read_text(path: str | Path, what: str, *, max_bytes: int = MAX_BYTES) -> str:
    """The text of a UTF-8 file. InputError that says that `what` is expected ("a model in YAML") for anything else."""
    check_file(path, what)
    with Path(path).open("rb") as file:
        data = file.read(max_bytes + 1)
    if len(data) > max_bytes:
        raise InputError(f"{path}: larger than {max_bytes / 2**20:g} MiB; expected {what}")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        line = data.count(b"\n", 0, problem.start) + 1
        raise InputError(
            f"{path} line {line}: not a UTF-8 text file; expected {what}, saved with the encoding UTF-8"
        ) from None


def read_yaml(path: str | Path, what: str) -> Any:
    """The content of a YAML file. InputError that names the file and `what` is expected."""
    return parse_yaml(read_text(path, what, max_bytes=MAX_BYTES_OF_YAML), str(path))


def shipped_yaml(package: str, name: str) -> Any:
    """The content of a YAML file that ships beside the modules of a package."""
    return parse_yaml((resources.files(package) / name).read_text(encoding="utf-8"), name)


def read_json(path: str | Path, what: str, *, max_bytes: int = MAX_BYTES) -> Any:
    """The content of a JSON file. InputError that names the file and `what` is expected."""
    return parse_json(read_text(path, what, max_bytes=max_bytes), str(path), max_values=max_bytes)


def run_python(path: Path) -> ModuleType:
    """Runs a Python file of the user's, who named it, as a module of its own. Raises what its code raises."""
    # Files of one name in two folders are two modules.
    digest = hashlib.sha256(str(path.resolve()).encode()).hexdigest()[:8]
    spec = importlib.util.spec_from_file_location(f"hydro_env_user_{path.stem}_{digest}", path)
    assert spec is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # so that what it defines can be pickled to worker processes
    # From the source itself: Python's cache takes a file of the same size that was written in the same second for the same.
    exec(compile(path.read_bytes(), str(path), "exec"), module.__dict__)
    return module


# --- YAML -------------------------------------------------------------------------------------------------------------
_PLAIN = ("map", "seq", "str", "int", "float", "bool", "null")
_TAG = "tag:yaml.org,2002:"


class _Loader(yaml.SafeLoader):
    """YAML of plain data, without the silent traps of YAML 1.1."""

    yaml_constructors = {  # noqa: RUF012 (PyYAML's way)
        f"{_TAG}{kind}": yaml.SafeLoader.yaml_constructors[f"{_TAG}{kind}"] for kind in _PLAIN
    }
    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 (filled below)

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        if node.tag not in self.yaml_constructors:
            tag = node.tag.replace(_TAG, "!!")
            raise _problem(node, f"the tag {shown(tag)} is not known here; write plain text or numbers")
        try:
            return super().construct_object(node, deep)  # type: ignore[no-untyped-call]
        except (ValueError, IndexError, KeyError):
            kind = node.tag.replace(_TAG, "!!")
            raise _problem(node, f"{shown(node.value)} is not a {kind}, or is too long") from None

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        taken: set[str] = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=True)
            if isinstance(key, bool):
                said = f"the key {key_node.value!r} is a truth value in YAML; in quotes it is a name"
                raise _problem(key_node, said)
            if not isinstance(key, str):
                raise _problem(key_node, f"the key {shown(key)} is not text; in quotes it is a name")
            if key in taken:
                raise _problem(key_node, f"the key {shown(key)} is given twice")
            taken.add(key)
        return super().construct_mapping(node, deep)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        """Merges no other table into this one: merges of merges grow without end."""


# What a plain scalar may be. Left out: dates, numbers to the base 60, merges and "=".
_RESOLVED = {
    "bool": (r"yes|Yes|YES|no|No|NO|true|True|TRUE|false|False|FALSE|on|On|ON|off|Off|OFF", "yYnNtTfFoO"),
    "float": (
        r"[-+]?(?:[0-9][0-9_]*)\.[0-9_]*(?:[eE][-+][0-9]+)?|[-+]?\.[0-9][0-9_]*(?:[eE][-+][0-9]+)?"
        r"|[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)",
        "-+0123456789.",
    ),
    "int": (r"[-+]?(?:0|[1-9][0-9_]*)", "-+0123456789"),
    "null": (r"~|null|Null|NULL|", ["~", "n", "N", ""]),
}
for _kind, (_pattern, _first) in _RESOLVED.items():
    _Loader.add_implicit_resolver(f"{_TAG}{_kind}", re.compile(rf"(?:{_pattern})\Z"), list(_first))


def _problem(node: yaml.Node, text: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=text, problem_mark=node.start_mark)


def parse_yaml(text: str, where: str) -> Any:
    """The content of a YAML text. InputError, naming `where` and the line, for what is none; see the module."""
    try:
        data = yaml.load(text, _Loader)
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise InputError(
            f"{where} line {line}: not YAML: it holds the character {shown(chr(error.character))}"
        ) from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line_of = f" line {mark.line + 1}" if mark is not None else ""
        raise InputError(f"{where}{line_of}: not YAML: {getattr(error, 'problem', None) or error}") from None
    except RecursionError:
        raise _too_deep(where) from None
    _check(data, where, MAX_VALUES)
    return data


# --- JSON -------------------------------------------------------------------------------------------------------------
def parse_json(text: str, where: str, *, max_values: int = MAX_VALUES) -> Any:
    """The content of a JSON text. InputError, naming `where`, for what is none; see the module."""
    try:
        data = json.loads(text, object_pairs_hook=_table, parse_constant=_refused, parse_int=_whole)
    except json.JSONDecodeError as error:
        raise InputError(f"{where} line {error.lineno}: not JSON: {error.msg}") from None
    except ValueError as error:
        raise InputError(f"{where}: {error}") from None
    except RecursionError:
        raise _too_deep(where) from None
    _check(data, where, max_values)
    return data


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table: dict[str, Any] = {}
    for key, value in pairs:
        if key in table:
            raise ValueError(f"the key {shown(key)} is given twice")
        table[key] = value
    return table


def _refused(constant: str) -> Any:
    raise ValueError(f"not JSON: {constant} is not a JSON number")


def _whole(digits: str) -> int:
    if len(digits) > DIGITS + 1:
        raise ValueError(f"the whole number {digits[:20]}... has more than {DIGITS} digits")
    return int(digits)


#: NUL, and the halves of surrogate pairs.
_UNWRITABLE = re.compile("[\0\ud800-\udfff]")


# --- both -------------------------------------------------------------------------------------------------------------
def _too_deep(where: str) -> InputError:
    return InputError(f"{where}: nested too deep; at most {DEPTH} tables and lists stand inside each other")


def _check(data: Any, where: str, max_values: int) -> None:
    """InputError for data too deep, too many, or of which a text or number cannot be used. Aliases are followed each time."""
    waiting, count = [(data, 0)], 0
    while waiting:
        value, depth = waiting.pop()
        count += 1
        if count > max_values:
            raise InputError(
                f"{where}: more than {max_values} values, an alias counted as what it stands for"
            )
        if isinstance(value, dict | list):
            if depth == DEPTH:
                raise _too_deep(where)
            inner = value if isinstance(value, list) else [*value, *value.values()]
            waiting += [(each, depth + 1) for each in inner]
        elif isinstance(value, str):
            if _UNWRITABLE.search(value):
                raise InputError(f"{where}: the text {shown(value)} holds a character that cannot be written")
        elif isinstance(value, int) and abs(value) >= 10**DIGITS:
            raise InputError(f"{where}: the whole number {shown(value)} has more than {DIGITS} digits")

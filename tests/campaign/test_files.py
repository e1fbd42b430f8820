"""A campaign of broken files, environment arguments and options: each works, or is refused in one clear line.

`pytest -m slow tests/campaign/test_files.py` runs all of it, the default tests a random hundred.
"""

from __future__ import annotations

import copy
import io
import json
import math
import random
import re
import struct
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import Any, get_args, get_type_hints

import gymnasium
import numpy as np
import pytest
import yaml

import hydro_env  # noqa: F401 (registers the environment)
from hydro_env import cli
from hydro_env.benchmark import command as benchmark
from hydro_env.benchmark.suite import load_suite
from hydro_env.cli.main import run
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.registry import make_controller
from hydro_env.measured.mapping import load_mapping
from hydro_env.plant import load_effects, load_model
from hydro_env.tasks.mismatch import load_mismatch

from .hostile import MARK, Case, wrong_with

ROOT = Path(__file__).parents[2]
CASES: dict[str, Case] = {}
Call = Callable[[Path], Any]


def add(name: str, call: Call, refused: bool = False) -> None:
    assert name not in CASES, name
    CASES[name] = Case(call, refused)


def command(*words: str) -> tuple[int, str]:
    """A command in this process: exit status and the error (the last line on stderr, after the progress)."""
    err = io.StringIO()
    with redirect_stdout(io.StringIO()), redirect_stderr(err):
        status = run(list(words))
    lines = err.getvalue().replace("\r", "\n").strip().splitlines()
    return status, "\n".join(line for line in lines if not re.match(r"(.*: +)? *\d+%\|", line))


# --- YAML -------------------------------------------------------------------------------------------------------------
MODEL = {
    "schema": "hydro_env/model/1", "name": "mine", "base": "paper", "substep": 1.0e-4, "both": {"J": 0.0031},
    "channel_1": {"Kq": 0.476}, "channel_2": {"valve": "paper"},
    "effects": {"dead_zone": {"channel_1": {"overlap_positive": 7.0e-5}}}, "sources": {"J": "drawing"},
}  # fmt: skip
MAPPING = {
    "schema": "hydro_env/mapping/1", "name": "crane", "table": {"delimiter": ";", "decimal": ",", "skip_rows": 0},
    "time": {"column": "t", "unit": "ms"}, "supply": {"column": "Ps", "unit": "bar"},
    "channel_1": {
        "actuator": "cylinder", "displacement": {"value": 12.06, "unit": "cm2"},
        "command": {"column": "U", "unit": "fraction", "full_scale": 10.0},
        "pressure": {"column": "pA", "unit": "bar", "minus": {"column": "pB", "unit": "bar", "scale": 0.61}},
        "speed": {"column": "v", "unit": "mm/s", "sign": -1},
    },
}  # fmt: skip
SUITE = {"splits": {"val": 2}, "scenarios": ["sine"], "metrics": ["tracking_mae_rpm"]}
MISMATCH = {
    "entropy": 5, "cases": 10, "outside": "train",
    "parameters": {
        "Kq": {"loguniform": [0.2, 0.476]}, "R": 100.0, "Fs": {"uniform": [0.1, 0.7]},
        "Fc": {"uniform": [0.1, 0.6], "at_most": "Fs"}, "dead_zone.overlap_positive": [7.0e-5, 0.0],
    },
    "faults": {"hot": {"R": 130.0}},
}  # fmt: skip
TRAINING = yaml.safe_load((ROOT / "configs" / "ppo_quick.yml").read_text())


def _training(path: Path) -> Any:
    from hydro_env.training.config import read_config

    return read_config(path)


READERS: dict[str, tuple[Any, Callable[[Path], Any]]] = {
    "model": (MODEL, load_model),
    "mapping": (MAPPING, load_mapping),
    "suite": (SUITE, load_suite),
    "mismatch": (MISMATCH, load_mismatch),
    "training": (TRAINING, _training),
}


def _laughs(levels: int, merge: bool) -> str:
    lines = ["a0: &a0 {k: 1, l: 2}"]
    for n in range(1, levels):
        inner = ", ".join([f"*a{n - 1}"] * 9)
        lines.append(f"a{n}: &a{n} " + (f"{{<<: [{inner}]}}" if merge else f"[{inner}]"))
    return "\n".join(lines) + f"\nname: *a{levels - 1}\n"


HOSTILE_YAML: dict[str, str | bytes] = {
    "empty": "", "comment": "# nothing\n", "null": "~\n", "number": "1\n", "text": "words\n", "list": "- 1\n- 2\n",
    "deep lists": "[" * 400 + "]" * 400, "deep maps": "{a: " * 400 + "1" + "}" * 400,
    "deeper lists": "[" * 5000, "deep blocks": "".join(" " * n + "a:\n" for n in range(600)),
    "deep dashes": "- " * 900 + "1\n", "deep in a key": "name: " + "[" * 300 + "]" * 300 + "\n",
    "month 13": "name: 2024-13-45\n", "day 0": "both: {J: 2024-01-00}\n", "a date": "name: 2024-01-05\n",
    "hour 77": "name: 2001-12-14t77:59:43.10-05:00\n", "no int": "name: !!int foo\n", "no float": "substep: !!float x\n",
    "no bool": "name: !!bool perhaps\n", "empty int": "name: !!int ''\n", "long int": f"substep: {'9' * 5000}\n",
    "400 digits": f"entropy: {'7' * 400}\n", "int in a key": f"{'9' * 5000}: 1\n", "sexagesimal": "cases: 99:99:99\n",
    "binary": "name: !!binary R0lGODlhDAAM\n", "bad binary": "name: !!binary ä\n", "set": "name: !!set {a, b}\n",
    "omap": "name: !!omap [a: 1]\n", "pairs": "name: !!pairs [a: 1]\n", "timestamp": "name: !!timestamp x\n",
    "python": f"name: !!python/object/apply:os.system ['touch {MARK}']\n",
    "python name": "name: !!python/name:os.system\n",
    "python new": f"name: !!python/object/new:subprocess.Popen [['touch', '{MARK}']]\n", "own tag": "name: !mine 1\n",
    "laughs": _laughs(12, False), "merged laughs": _laughs(9, True), "laughs of 7": _laughs(7, False),
    "alias to itself": "name: &a [*a]\n", "map in itself": "&a {name: *a}\n", "no such alias": "name: *nobody\n",
    "merge of text": "<<: text\n", "merge": "base_: &a {name: x}\n<<: *a\n", "nul": "name: a\0b\n",
    "nul escape": 'name: "a\\0b"\n', "surrogate": 'name: "\\ud800"\n', "bell": "name: a\x07b\n",
    "twice": "name: a\nname: b\n", "tabs": "both:\n\tJ: 1\n", "tab after colon": "name:\ta\n", "list key": "? [a]\n: 1\n",
    "map key": "? {a: 1}\n: 1\n", "null key": "~: 1\n", "number key": "1.5: 1\n", "truth key": "on: 1\n",
    "nan": "substep: .nan\n", "inf": "substep: .inf\n", "open": "name: [a\n", "quote": "name: 'a\n", "colon": "a: b: c\n",
    "two documents": "name: a\n---\nname: b\n", "directive": "%YAML 9.9\n---\nname: a\n", "percent": "%", "at": "name: @a\n",
    "backtick": "name: `ls`\n", "cp1252": "name: Hydraulikprüfstand\n".encode("cp1252"),
    "utf-16": "name: mine\n".encode("utf-16"), "utf-16 bare": "name: mine\n".encode("utf-16-le"),
    "utf-32": "name: mine\n".encode("utf-32"), "with mark": "\ufeffname: mine\n", "bytes": bytes(range(256)),
    "gzip": b"\x1f\x8b\x08\0\0\0\0\0\0\xff", "huge": "name: " + "x" * 30_000_000, "many lines": "a: 1\n" * 300_000,
    "many keys": "".join(f"k{n}: 1\n" for n in range(20_000)), "long key": "k" * 100_000 + ": 1\n",
    "long comment": "#" * 500_000, "long list": f"name: [{'1,' * 100_000}]\n", "line ends": "name: a\u2028b\n",
}  # fmt: skip
#: Of these no reader may make anything.
REFUSED_YAML = {
    "empty", "number", "text", "list", "deep lists", "deep maps", "deeper lists", "deep in a key", "no int", "no float",
    "no bool", "long int", "int in a key", "binary", "set", "python", "python name", "python new", "own tag", "laughs",
    "merged laughs", "alias to itself", "no such alias", "nul", "nul escape", "surrogate", "twice", "tabs", "list key",
    "map key", "open", "quote", "cp1252", "utf-16", "utf-16 bare", "utf-32", "bytes", "gzip", "huge", "two documents",
}  # fmt: skip


def _written(name: str, content: str | bytes, read: Callable[[Path], Any]) -> Call:
    def call(folder: Path) -> Any:
        path = folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8", "surrogatepass"))
        read(path)

    return call


#: What may stand where something else belongs.
JUNK: tuple[Any, ...] = (
    None, True, -1, 0, 10**30, 10**400, 1.5, -1e300, math.inf, math.nan, "", "x" * 5000, "a\nb", "\u2028", "ä",
    "__import__('os')",
    [], [1, 2], [[[]]], {}, {"a": {"b": 1}}, {"x" * 300: 1}, ["dead_zone"], "1e999", "-.inf", "~", "../../etc/passwd",
)  # fmt: skip


def _places(tree: Any, place: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    yield place
    for key, inner in (
        tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    ):
        yield from _places(inner, (*place, key))


def _mutated(tree: Any, stream: random.Random) -> Any:
    """The tree with one place replaced, removed, renamed or doubled."""
    tree = copy.deepcopy(tree)
    place = stream.choice([p for p in _places(tree) if p])
    parent = tree
    for key in place[:-1]:
        parent = parent[key]
    way, junk = stream.choice(("replace", "replace", "replace", "remove", "rename")), stream.choice(JUNK)
    if way == "replace":
        parent[place[-1]] = junk
    elif way == "remove" or isinstance(parent, list):
        del parent[place[-1]]
    else:
        parent[str(junk)] = parent.pop(place[-1])
    return tree


def _damaged(data: bytes, stream: random.Random) -> bytes:
    """Bytes flipped, cut out, doubled or put in."""
    out = bytearray(data)
    for _ in range(stream.randint(1, 4)):
        at, length = stream.randrange(len(out)), stream.randint(1, 40)
        way = stream.randrange(4)
        if way == 0:
            out[at] = stream.randrange(256)
        elif way == 1 and len(out) > length + 10:
            del out[at : at + length]
        elif way == 2:
            out[at:at] = out[at : at + length]
        else:
            out[at:at] = stream.choice(
                (b"[", b"{", b"&a ", b"*a", b"!!int ", b"\t", b"\0", b": ", b"\xff", b"- ", b"9" * 60)
            )
    return bytes(out)


def _yaml_cases() -> None:
    for kind, (tree, read) in READERS.items():
        good = yaml.safe_dump(tree, sort_keys=False)
        add(f"yaml {kind}: as it should be", _written("good.yaml", good, read))
        for name, content in HOSTILE_YAML.items():
            add(f"yaml {kind}: {name}", _written("bad.yaml", content, read), name in REFUSED_YAML)
        for n in range(25):
            stream = random.Random(f"{kind} bytes {n}")
            add(f"yaml {kind}: damaged {n}", _written("bad.yaml", _damaged(good.encode(), stream), read))
        for n in range(45):
            tree_n = _mutated(tree, random.Random(f"{kind} tree {n}"))
            text = yaml.safe_dump(tree_n, sort_keys=False, allow_unicode=True)
            add(f"yaml {kind}: changed {n}", _written("bad.yaml", text, read))
        add(f"yaml {kind}: a folder", lambda folder, read=read: read(_folder(folder / "x.yaml")), True)
        add(f"yaml {kind}: missing", lambda folder, read=read: read(folder / "no.yaml"), True)
        add(f"yaml {kind}: endless", lambda _, read=read: read(_link(_ / "zero.yaml", "/dev/zero")), True)
        add(f"yaml {kind}: link to itself", lambda _, read=read: read(_link(_ / "a.yaml", "a.yaml")), True)
        add(f"yaml {kind}: long path", lambda _, read=read: read(_ / ("x" * 5000 + ".yaml")), True)
        add(f"yaml {kind}: nul in the path", lambda _, read=read: read(_ / "a\0b.yaml"), True)


def _folder(path: Path) -> Path:
    path.mkdir()
    return path


def _link(path: Path, target: str) -> Path:
    path.symlink_to(target)
    return path


def _circles() -> None:
    """Models that build on each other."""

    def chain(length: int, closed: bool, key: str) -> Call:
        def call(folder: Path) -> Any:
            for n in range(length):
                following = folder / f"m{(n + 1) % length}.yaml" if closed or n + 1 < length else "paper"
                tree: dict[str, Any] = {"schema": "hydro_env/model/1"}
                if key in ("base", "both"):
                    tree["base"] = str(following)
                if key in ("valve", "both"):
                    tree |= {side: {"valve": str(following)} for side in ("channel_1", "channel_2")}
                (folder / f"m{n}.yaml").write_text(yaml.safe_dump(tree))
            load_model(folder / "m0.yaml")

        return call

    for key in ("base", "valve", "both"):
        for length in (1, 2, 3, 30, 300):
            add(f"model: circle of {length}, {key}", chain(length, True, key), True)
        for length in (2, 12, 1500):
            add(f"model: chain of {length}, {key}", chain(length, False, key), length > 12)


# --- JSON and policies ------------------------------------------------------------------------------------------------
GAINS = json.loads((ROOT / "hydro_env" / "controllers" / "data" / "cross_coupled.json").read_text())
HOSTILE_JSON: dict[str, str | bytes] = {
    "empty": "", "null": "null", "list": "[]", "deep": "[" * 100_000, "deep closed": "[" * 900 + "]" * 900,
    "deep maps": '{"a":' * 900 + "1" + "}" * 900, "nan": '{"schema": NaN}', "infinity": '{"schema": -Infinity}',
    "long int": f'{{"schema": {"9" * 5000}}}', "400 digits": f'{{"schema": {"9" * 400}}}', "1e999": '{"schema": 1e999}',
    "twice": '{"schema": 1, "schema": 2}', "surrogate": '{"schema": "\\ud800"}', "nul": '{"schema": "\\u0000"}',
    "half": '{"schema": ', "comma": '{"schema": 1,}', "single quotes": "{'schema': 1}", "mark": "\ufeff{}",
    "utf-16": "{}".encode("utf-16"), "cp1252": '{"ü": 1}'.encode("cp1252"), "huge": "[" + "1," * 20_000_000,
    "bytes": bytes(range(256)), "comment": "// {}",
}  # fmt: skip


def _json_cases() -> None:
    text = json.dumps(GAINS)
    for name, content in HOSTILE_JSON.items():
        add(f"gains: {name}", _written("bad.json", content, make_controller), True)
    for n in range(60):
        tree = _mutated(GAINS, random.Random(f"gains tree {n}"))
        add(f"gains: changed {n}", _written("bad.json", json.dumps(tree), make_controller))
    for n in range(30):
        damaged = _damaged(text.encode(), random.Random(f"gains bytes {n}"))
        add(f"gains: damaged {n}", _written("bad.json", damaged, make_controller))


METADATA = {
    "schema": "hydro_env/policy/2",
    "activation": "tanh",
    "squash": "clip",
    "interface": {"kind": "frames"},
}


def _npy(shape: str, descr: str = "'<f4'", data: bytes = b"", extra: str = "") -> bytes:
    """An npy file with a header that says anything."""
    header = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, {extra}}}\n".encode()
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def _arrays(**more: Any) -> dict[str, Any]:
    stream = np.random.default_rng(0)
    arrays = {
        "metadata": np.array(json.dumps(METADATA)),
        "w0": stream.normal(0.0, 0.1, (4, 9)).astype(np.float32), "b0": np.zeros(4, np.float32),
        "w1": stream.normal(0.0, 0.1, (2, 4)).astype(np.float32), "b1": np.zeros(2, np.float32),
    }  # fmt: skip
    return {name: value for name, value in {**arrays, **more}.items() if value is not None}


def _npz(entries: dict[str, Any], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method) as archive:
        for name, value in entries.items():
            if not isinstance(value, bytes):
                memory = io.BytesIO()
                np.save(memory, value, allow_pickle=True)
                value = memory.getvalue()
            archive.writestr(f"{name}.npy", value)
    return out.getvalue()


class _Runs:
    """A pickle of it runs code."""

    def __reduce__(self) -> Any:
        return (exec, (f"open({MARK!r}, 'w')",))


def _policy_cases() -> None:
    shapes = ("(10000000000,)", "(1152921504606846976,)", "(100000, 100000)", "(-1,)", "(-2, -2)", "(2.5,)", "('a',)", "5",
              "[4, 9]", "()", "(4, 9)", "(9, 9, 9, 9, 9, 9)", "(0, 9)", "(1 << 70,)", "(True, 3)",
              f"({'1,' * 3000})")  # fmt: skip
    arrays = {f"shape {shape[:30]}": {"w0": _npy(shape)} for shape in shapes}
    descrs = ("'O'", "'|O'", "'<f4,<f4'", "[('a', '<f4')]", "'V100'", "'<U5'", "'<c16'", "'?'", "'<M8[s]'", "'x'", "None", "7",
              "'<f16'", "'>f8'", "'<f2'", "__import__('os')", "'S99999999999'", "[" * 150 + "]" * 150)  # fmt: skip
    arrays |= {f"dtype {descr[:30]}": {"w0": _npy("(4, 9)", descr, b"\0" * 144)} for descr in descrs}
    arrays |= {
        "deep header": {"w0": _npy("(" * 3000 + ")" * 3000)}, "long header": {"w0": _npy("(4, 9)", extra="'x': 1, " * 7000)},
        "version 9": {"w0": b"\x93NUMPY\x09\x00" + b"\0" * 200}, "no npy": {"w0": b"words"}, "no bytes": {"w0": b""},
        "pickled object": {"w0": np.array([_Runs()], dtype=object)},
        "pickled metadata": {"metadata": np.array(_Runs(), dtype=object)},
        "bomb": {"w0": _npy("(1000000000,)", "'|u1'", b"\0" * 300_000_000)}, "inf": {"w0": np.full((4, 9), np.inf)},
        "too large for single": {"w0": np.full((4, 9), 1e300)}, "no input": {"w0": np.zeros((4, 0), np.float32)},
        "no unit": {"w0": np.zeros((0, 9), np.float32), "b0": np.zeros(0, np.float32)}, "twelve": {"w12": np.zeros(1)},
        "list of metadata": {"metadata": np.array(["a", "b"])}, "number of metadata": {"metadata": np.array(5.0)},
        "bytes of metadata": {"metadata": np.array(b"{}")}, "deep metadata": {"metadata": np.array("[" * 50_000)},
        "deep map": {"metadata": np.array('{"a":' * 800 + "1" + "}" * 800)}, "long name": {"w" * 60_000: np.zeros(1)},
    }  # fmt: skip
    good = {"shape (4, 9)", "dtype '<f2'", "dtype '>f8'"}
    for name, change in arrays.items():
        may = name in good or name.startswith("dtype")
        add(f"policy: {name}", _written("bad.npz", _npz(_arrays(**change)), NumpyPolicy), not may)
    for n, junk in enumerate(JUNK):
        for key in ("activation", "squash", "interface", "schema"):
            changed = json.dumps({**METADATA, key: junk})
            entries = _arrays(metadata=np.array(changed))
            add(
                f"policy: {key} is junk {n}",
                _written("bad.npz", _npz(entries), NumpyPolicy),
                key != "interface",
            )
        for key in ("kind", "frames", "width", "law", "outputs"):
            table = {"kind": "flow" if key in ("law", "outputs") else "frames", key: junk}
            entries = _arrays(metadata=np.array(json.dumps({**METADATA, "interface": table})))
            add(f"policy: interface {key} is junk {n}", _written("bad.npz", _npz(entries), NumpyPolicy))
    shipped = (ROOT / "hydro_env" / "controllers" / "policies" / "ppo.npz").read_bytes()
    for n in range(60):
        damaged = _damaged(shipped, random.Random(f"policy {n}"))
        add(f"policy: damaged {n}", _written("bad.npz", damaged, NumpyPolicy))
    for n in range(40):
        stream = random.Random(f"small policy {n}")
        stored = _npz(_arrays(), zipfile.ZIP_STORED if n % 2 else zipfile.ZIP_DEFLATED)
        add(f"policy: damaged small {n}", _written("bad.npz", _damaged(stored, stream), NumpyPolicy))
    for cut in (0, 1, 4, 30, 100, 1000, 10_000):
        add(f"policy: cut at {cut}", _written("bad.npz", shipped[:cut], NumpyPolicy), True)


# --- controllers and effects in Python --------------------------------------------------------------------------------
CONTROLLER = """
import numpy as np
class C:
    name = {name}
    def reset(self, n, period):
        self.n = n
    def act(self, observation):
        return {act}
"""
NAMES = (
    "'/*SCORES*/null'", "'/*TRACES*/null'", "'/*STYLE*/'", "'</script><script>alert(1)</script>'", "'\"\\\\''", "'{{ 7*7 }}'",
    "'{% raw %}'", "'$x$ $_{'", "'ä'", "'\\ud800'", "'a\\nb'", "'\\0'", "''", "'x' * 10**6", "7", "None", "[]", "b'x'",
    "'\\u202e'",
    "'../../x'", "'&lt;'", "'\\\\1'",
)  # fmt: skip


def _benchmark(text: str) -> Call:
    def call(folder: Path) -> Any:
        (folder / "mine.py").write_text(text)
        words = (
            "--suite",
            "quick",
            "--split",
            "val",
            "--scenario",
            "sine",
            "--cases",
            "1",
            "--out",
            str(folder / "out"),
        )
        done = command("benchmark", f"{folder / 'mine.py'}:C", *words)
        if done[0] == 0:
            page = (folder / "out" / "scores.html").read_text(encoding="utf-8")
            data, _ = json.JSONDecoder().raw_decode(page, page.index("const S = ") + len("const S = "))
            assert data["schema"] == benchmark.SCHEMA, "the page's data cannot be read"
            assert page.count("</script>") == 1 and "/*STYLE*/" not in page.partition("<script>")[0]
        return done

    return call


def _python_cases() -> None:
    for n, name in enumerate(NAMES):
        add(f"controller: name {n}", _benchmark(CONTROLLER.format(name=name, act="np.zeros((self.n, 2))")))
    for key in ("needs", "plant"):
        for n, junk in enumerate(("7", "[]", "'\\ud800'", "'x' * 10**6", "object()", "{}", "b'paper'")):
            text = CONTROLLER.format(name="'c'", act="np.zeros((self.n, 2))") + f"    {key} = {junk}\n"
            add(f"controller: {key} is junk {n}", _benchmark(text), True)
    for n, act in enumerate(("None", "'x'", "np.zeros(3)", "np.full((self.n, 2), np.nan)", "[[1e400, 0]]", "1/0", "object()",
                             "[['a', 'b']]", "np.zeros((self.n, 2), complex)", "np.zeros((0, 2))", "10**400")):  # fmt: skip
        add(f"controller: act gives {n}", _benchmark(CONTROLLER.format(name="'c'", act=act)), True)
    for n, text in enumerate(("", "raise SystemError", "x = (", "1/0", "C = 5", "class C: pass", "def C(a): pass", "\0", "é" * 9,
                              "class C:\n    def __init__(self):\n        raise KeyError('a')\n",
                              "import nothing_at_all")):  # fmt: skip
        add(f"controller: file {n}", _written("mine.py", text, lambda p: make_controller(f"{p}:C")), True)
        add(f"effects: file {n}", _written("own.py", text, lambda p: load_effects([p])), True)
    specs = ("", ":", "a:b", "x.py", "x.py:", "x.py:C", "os:system", ".json", ".npz", "x.json", "pid_tuned:", "pid_tuned:kp",
             "pid_tuned:kp=x", "pid_tuned:kp=1=2", "pid_tuned:nothing=1", "ppo:kp=1", "é", "x" * 5000, "a\0b", "a\0b.json",
             "a\0b.npz",
             "a\0b.py:C", "x" * 5000 + ".npz", "x" * 5000 + ".py:C", "..:..", "\ud800", "\ud800.json", "this:that:C")  # fmt: skip
    for n, spec in enumerate(specs):
        add(f"controller: named {n}", lambda _, spec=spec: make_controller(spec), True)


# --- the environment --------------------------------------------------------------------------------------------------
ARGUMENTS = ("plant", "scenario", "mismatch", "control_period", "history", "noise", "reward")
BATCH = ("num_envs", "autoreset_mode", "max_episode_steps", "dtype", "render_mode")
ABUSE: tuple[Any, ...] = (
    *JUNK, b"paper", b"\xff", object(), int, len, 3 + 4j, np.zeros((2, 2)), np.array("paper"), np.nan, (),
    {1: 2}, {None: 1}, set(),
    Path("/"), Path("nowhere.yaml"), "a\0b", "a\0b.yaml", range(3), np.float32(-1.0), "\ud800", "x" * 5000 + ".yaml",
    {"R": object()},
)  # fmt: skip


def _env_cases() -> None:
    def make(**more: Any) -> None:
        env = gymnasium.make("hydro_env:HydraulicSync-v0", disable_env_checker=True, **more)
        env.reset(seed=0)
        env.step(np.zeros(2, np.float32))
        env.close()

    def batch(**more: Any) -> None:
        gymnasium.make_vec("hydro_env:HydraulicSync-v0", **{"num_envs": 2, "plant": "paper", **more}).close()

    def reset(**more: Any) -> None:
        gymnasium.make("hydro_env:HydraulicSync-v0", disable_env_checker=True, plant="paper").unwrapped.reset(
            **more
        )

    for n, junk in enumerate(ABUSE):
        for name in ARGUMENTS:
            add(f"environment: {name} is junk {n}", lambda _, k=name, v=junk: make(**{k: v}))
        for name in BATCH:
            from hydro_env.envs import HydraulicSyncVectorEnv as Batch

            if not (name == "num_envs" and junk is True):
                add(
                    f"environment: batch {name} is junk {n}",
                    lambda _, k=name, v=junk: Batch(**{"plant": "paper", k: v}),
                )
        for name in ("seed", "options"):
            add(f"environment: reset {name} is junk {n}", lambda _, k=name, v=junk: reset(**{k: v}))
        for name in ("mismatch", "scenario", "case", "reset_mask"):
            add(
                f"environment: option {name} is junk {n}",
                lambda _, k=name, v=junk: reset(seed=1, options={k: v}),
            )
        for key in ("duration", "setpoint_rpm", "load_Nm", "name"):
            add(
                f"environment: scenario {key} is junk {n}",
                lambda _, k=key, v=junk: make(scenario={"duration": 1.0, k: v}),
            )
    for n, mismatch in enumerate(({"Kq": {"uniform": [1, 2, 3]}}, {"Kq": {"uniform": "ab"}}, {"Kq": [[1], [2]]}, {"Kq": [1,
    None]},
                                  {"Fc": {"uniform": [0.1, 0.2], "at_most": []}}, {"R": {"loguniform": [0, 1]}},
                                  {"R": {"uniform": [1, 1e400]}}, {"R": 10**400}, {"command_delay.delay": 1e308})):  # fmt: skip
        add(f"environment: mismatch table {n}", lambda _, v=mismatch: make(mismatch=v), True)
    add("environment: a batch", lambda _: batch())


# --- options ----------------------------------------------------------------------------------------------------------
NUMBERS = (
    "inf",
    "-inf",
    "nan",
    "NaN",
    "",
    " ",
    "x",
    "-1",
    "1e400",
    "-1e300",
    "1e30",
    "9" * 25,
    "9" * 5000,
    "0x10",
    "1;5",
    "--",
    "1;2",
    "½",
)
TEXTS_OF_NUMBERS = (("valve-test", "--seconds"), ("valve-test", "--sweep-period"))
WORDS = {"hide": ("--none",), "diagnose": ("x.csv",)}


def _numeric_options() -> Iterator[tuple[str, str]]:
    """Every option of every command that takes a number."""
    for registered in cli.app.registered_commands:
        work = registered.callback
        assert work is not None
        name = registered.name or work.__name__
        hints = get_type_hints(work)
        for parameter, kind in hints.items():
            inner = {kind, *get_args(kind), *(deep for one in get_args(kind) for deep in get_args(one))}
            if inner & {int, float} and bool not in inner:
                yield name, f"--{parameter.replace('_', '-')}"
    yield from TEXTS_OF_NUMBERS


def _option_cases() -> None:
    for name, option in _numeric_options():
        for number in NUMBERS:
            if option == "--sweep-period" and not number.strip():
                continue  # none is given, as by default
            words = (name, *WORDS.get(name, ()), f"{option}={number}")
            add(f"option {name} {option}={number[:30]} ({len(number)})",
                lambda folder, w=words: command(*w, "--out", str(folder / "out")), True)  # fmt: skip
    paths = (
        ("hide", "--none", "--model"), ("diagnose", "--mapping"), ("diagnose", "--inspect"), ("diagnose",), ("benchmark",
        "--suite"),
        ("benchmark", "pid_paper", "--plant"), ("benchmark",), ("tune", "--plant"), ("hide", "--none", "--effects"),
        ("valve-test", "--no-pictures"),
    )  # fmt: skip
    for words in paths:
        for what in ("", ".", "/", "nowhere.yaml", "nowhere/deep.yaml", "folder.yaml", "folder.csv", "locked.yaml", "x" * 300,
                     "x" * 5000 + ".yaml", "/dev/null", "/dev/null/x.yaml", "a\nb.yaml", "\udcff.yaml",
                     "$(touch " + MARK + ").yaml"):  # fmt: skip
            add(f"path {' '.join(words)} {what[:20]!r} ({len(what)})",
                lambda folder, w=words, p=what: _with_paths(folder, *w, p),
                (words[-1], what) != ("--inspect", "locked.yaml"))  # fmt: skip
    for name in (
        "hide",
        "speed",
        "tune",
        "benchmark",
        "valve-test",
        "reproduce",
        "demo",
        "close-loop",
        "diagnose",
    ):
        for out in ("file", "file/out", "/proc/x", "/dev/null", "x" * 5000, "a\0b"):
            add(f"out {name} {out[:20]!r}",
                lambda folder, n=name, o=out: _with_paths(folder, n, *WORDS.get(n, ()), out=o), True)  # fmt: skip


def _with_paths(folder: Path, *words: str, out: str = "out") -> tuple[int, str]:
    """A command in a folder with a file, folders that are called like files, and a file that nobody may read."""
    import os

    (folder / "file").write_text("x")
    for name in ("folder.yaml", "folder.csv"):
        (folder / name).mkdir()
    (folder / "locked.yaml").write_text("x")
    (folder / "locked.yaml").chmod(0)
    before = Path.cwd()
    os.chdir(folder)
    try:
        return command(*words, f"--out={out}")
    finally:
        os.chdir(before)


def _long_cell(folder: Path) -> Any:
    (folder / "curve.csv").write_text("signal_mA,flow_lpm\n" + "1" * 10_000_000 + ",2\n")
    return command("valve-test", str(folder / "curve.csv"), "--no-pictures", "--out", str(folder / "out"))


_yaml_cases()
_circles()
_json_cases()
_policy_cases()
_python_cases()
_env_cases()
_option_cases()
add("valve-test: a cell of ten million digits", _long_cell, True)

SMOKE = random.Random(17).sample(sorted(CASES), 100)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def prepare(name: str) -> None:
    """What takes time and memory of its own: the import of PyTorch."""
    if name.startswith("yaml training"):
        pytest.importorskip("hydro_env.training.config", reason="needs the extra agents")


@pytest.mark.parametrize("name", SMOKE)
def test_smoke(name: str, folder: Path) -> None:
    prepare(name)
    assert wrong_with(CASES[name], folder) == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", list(CASES))
def test_campaign(name: str, folder: Path) -> None:
    prepare(name)
    assert wrong_with(CASES[name], folder) == ""

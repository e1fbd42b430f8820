"""The folder of a case: copies of logs, model and mapping, and case.json, which alone says what counts.

    DIR/case.json        what was given, asked, answered and found
    DIR/logs/            copies of all logs
    DIR/model.yaml       the model, unless it is a preset; mapping.yaml likewise
    DIR/question_N.csv   commands and loads of the Nth question
    DIR/round_N/         the diagnosis after N - 1 questions
    DIR/report.html      the story

Files appear whole, case.json after all that it speaks of. So a call that is killed leaves a case that the next one goes on with.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from ..diagnosis.input.parts import split
from ..errors import InputError, shown
from ..files import output_folder, sha256_of, to_json, write_bytes, write_json
from ..plant import load_model, preset_names
from ..reading import MAX_BYTES_OF_RESULTS, check_file, read_json
from ..validation import FileTable, checked

FILE = "case.json"
#: Options of the first call that name files; the folder has copies.
COPIED = {"model": "model.yaml", "mapping": "mapping.yaml"}

#: A file of the folder, or a log of it with its windows.
Name = Annotated[str, Field(pattern=r"^(logs/)?[^/\\.][^/\\]*$")]


class Place(FileTable):
    """Where something may be, channel "1", "2", "both" or "rig", and the probabilities of what it is, which sum to one."""

    channel: str
    hypotheses: dict[str, float]


class Question(FileTable):
    """An experiment that was asked for: why, its file (None: in words only), what to record, and the `sensor` among that which
    the logs lacked; how far models of two names are `apart` there, RMS in units of what is not known; how likely the best
    answer is right now, and is `expected` to be then."""

    why: str
    commands: Name | None
    record: list[str]
    sensor: str | None
    apart: dict[str, float]
    now: float
    expected: float


class Round(FileTable):
    """Logs that came and, once they are diagnosed, the verdict with all logs so far, what is open, and what is asked next."""

    logs: list[Name]
    remarks: list[str] = Field(default_factory=list)
    verdict: str | None = None
    seconds: float = 0.0
    open: list[Place] = Field(default_factory=list)
    question: Question | None = None


class CaseFile(FileTable):
    """The content of case.json. `options` are those of the first call; `files` the SHA-256 of every file that was given."""

    FORMAT = "hydro_env/case/1"

    options: dict[str, Any]
    files: dict[Name, str]
    sealed: list[Name]
    practice: bool
    rounds: Annotated[list[Round], Field(min_length=1)]
    closed: str | None = None

    @property
    def asked(self) -> list[Question]:
        """All questions, the last one perhaps without an answer."""
        return [r.question for r in self.rounds if r.question is not None]


def read(folder: Path) -> CaseFile:
    """The case of a folder. InputError if it is none, or a file of it is missing or changed."""
    path = folder / FILE
    if not path.exists():
        raise InputError(f"{folder}: no case ({FILE} is missing); begin one with logs and --sealed")
    case = checked(CaseFile, read_json(path, "a case", max_bytes=MAX_BYTES_OF_RESULTS), path)
    words = (*case.sealed, *(w for r in case.rounds for w in r.logs))
    for name in {path_of(w) for w in words} - {*case.files}:
        raise InputError(f"{path}: {shown(name)} is used, but not among files; restore {FILE}")
    for name, sha256 in case.files.items():
        check_file(folder / name, "a file of the case; restore it")
        if sha256_of(folder / name) != sha256:
            raise InputError(f"{folder / name}: not what the case was given (SHA-256 differs); restore it")
    return case


def write(folder: Path, case: CaseFile) -> None:
    """Writes case.json in one go."""
    write_json(folder / FILE, {"schema": case.FORMAT} | case.model_dump())


def path_of(word: str) -> str:
    """The path of a log without its windows."""
    return split(word)[0]


def hashes_of(words: Sequence[str]) -> list[str]:
    """The SHA-256 of logs. InputError for a file that cannot be read."""
    paths = [Path(path_of(word)) for word in words]
    for path in paths:
        check_file(path, "a log")
    return [sha256_of(path) for path in paths]


def begin(folder: Path, logs: Sequence[str], sealed: Sequence[str], options: dict[str, Any]) -> CaseFile:
    """Makes the folder of a new case, which is not there or empty. InputError for what cannot be read."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"{folder}: neither a case nor empty; name a new folder for --case")
    load_model(options["model"])
    practice = (Path(path_of(logs[0])).parent / "truth.json").exists()
    with suppress(OSError):
        folder.rmdir()  # so that the new one comes in one go
    with output_folder(folder) as work:
        files: dict[str, str] = {}
        fitted, held_out = (_copied(work, words, files) for words in (logs, sealed))
        for option, name in COPIED.items():
            source = options[option]
            if source is not None and source not in preset_names():
                check_file(source, f"a {option} in YAML")
                write_bytes(work / name, Path(source).read_bytes())
                files[name] = sha256_of(work / name)
        case = CaseFile(
            options=options, files=files, sealed=held_out, practice=practice, rounds=[Round(logs=fitted)]
        )
        write(work, case)
    return case


def added(folder: Path, case: CaseFile, logs: Sequence[str]) -> CaseFile:
    """The case with a new round of logs, which are copied. InputError for a log that it holds already."""
    seen = dict.fromkeys(case.files.values(), "the case holds this log already")
    for word, sha256 in zip(logs, hashes_of(logs), strict=True):
        if known := seen.get(sha256):
            raise InputError(f"{word}: {known}; give the log of the last question")
        seen[sha256] = "this log is given twice"
    files = dict(case.files)
    words = _copied(folder, logs, files)
    case = case.model_copy(update={"files": files, "rounds": [*case.rounds, Round(logs=words)]})
    write(folder, case)
    return case


def restore(folder: Path, before: CaseFile, case: CaseFile) -> None:
    """Takes back what `case` has more: logs that cannot be used."""
    write(folder, before)
    for name in {*case.files} - {*before.files}:
        (folder / name).unlink()


def _copied(folder: Path, words: Sequence[str], files: dict[str, str]) -> list[str]:
    """Copies logs and adds them to `files`; the words that name the copies."""
    (folder / "logs").mkdir(exist_ok=True)
    found = []
    for word, sha256 in zip(words, hashes_of(words), strict=True):
        path = Path(path_of(word))
        name = next((n for n, known in files.items() if known == sha256), None)
        if name is None:
            name = f"logs/{len(files) + 1}_{path.name}"
            write_bytes(folder / name, path.read_bytes())
            files[name] = sha256
        found.append(name + word[len(path_of(word)) :])
    return found


def check_options(folder: Path, case: CaseFile, options: dict[str, Any], given: set[str]) -> None:
    """InputError if an option that is `given` differs from that of the first call, or the case has other ones."""
    if {*options} != {*case.options}:
        raise InputError(f"{folder / FILE}: options should be {', '.join(options)}; restore the file")
    for option in given:
        value, first = options[option], case.options[option]
        same = to_json(value) == to_json(first)
        copy = COPIED.get(option, "")
        if copy in case.files:
            same = os.path.isfile(value) and sha256_of(Path(value)) == case.files[copy]
        if not same:
            name = f"--{option.replace('_', '-')}"
            raise InputError(f"{folder}: {name} is {shown(value)}, the case was begun with {shown(first)}")

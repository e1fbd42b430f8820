"""The command line: every bad input is one line on stderr and exit status 2, and leaves nothing behind."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import typer

from hydro_env import __version__, cli
from hydro_env.cli.help import examples
from hydro_env.cli.main import spread
from hydro_env.errors import LOST, InputError, stopped_by_signals

Run = Callable[..., tuple[int, str, str]]


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """Runs a command in an empty folder: exit status, stdout, stderr."""
    monkeypatch.chdir(tmp_path)

    def run(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as end:
            cli.main([str(argument) for argument in arguments])
        printed = capsys.readouterr()
        return int(end.value.code or 0), printed.out, printed.err

    return run


def is_one_line(err: str) -> bool:
    lines = [line for line in err.replace("\r", "\n").splitlines() if line.strip() and "it/s" not in line]
    return bool(lines) and lines[-1].startswith("error: ") and not any("Traceback" in line for line in lines)


def listing(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


def write_log(path: Path, change: Callable[[list[list[str]]], object] = lambda rows: None) -> Path:
    """A plausible log of 4 s at 100 Hz in the contract's format, after `change` of its rows (row 0: the header)."""
    time = np.arange(400) * 0.01
    command = 40.0 * np.sign(np.sin(3.0 * time + 0.1))
    speed = np.convolve(command * 12.0, np.full(20, 0.05))[: len(time)]
    names = ["time_s", "setpoint_rpm"]
    names += [f"{signal}_{channel}_{unit}" for channel in (1, 2) for signal, unit in SIGNALS]
    rows = [names]
    for n in range(len(time)):
        one = [command[n], command[n] / 100.0, 5.0 + 0.01 * n, speed[n], 0.0]
        rows.append([f"{value:.4f}" for value in (time[n], 480.0, *one, *one)])
    change(rows)
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8")
    return path


SIGNALS = (("command", "V"), ("current", "A"), ("pressure", "bar"), ("speed", "rpm"), ("load", "Nm"))


def test_version(run: Run) -> None:
    assert run("--version") == (0, f"hydro_env {__version__}\n", "")


def test_help_lists_the_commands(run: Run) -> None:
    status, out, _ = run("--help")
    assert status == 0
    for command in (
        "benchmark",
        "close-loop",
        "demo",
        "diagnose",
        "hide",
        "lab",
        "list",
        "reproduce",
        "speed",
        "tune",
        "valve-test",
    ):
        assert f"\n  {command} " in out
        assert run(command, "--help")[0] == 0


def test_every_command_takes_out(run: Run) -> None:
    for command in cli.app.registered_commands:
        name = command.name or command.callback.__name__  # type: ignore[union-attr]
        if name in ("list", "lab", "diagnose"):  # write only when they are asked to, or to a case
            continue
        status, _, err = run(name, *{"live": ["x.yaml"], "pdf": ["x.html"]}.get(name, []))
        assert status == 2 and err.startswith("error: Missing option '--out'"), name


@pytest.mark.parametrize(
    "arguments", [["nope"], ["hide", "--nope", "--out", "x"], ["hide", "--seed", "one", "--out", "x"]]
)
def test_usage_errors(run: Run, tmp_path: Path, arguments: list[str]) -> None:
    status, _, err = run(*arguments)
    assert status == 2 and is_one_line(err) and err.count("\n") == 1
    assert listing(tmp_path) == []


@pytest.mark.parametrize("out", ["file", "file/out", "/proc/hydro_env/out"])
@pytest.mark.parametrize(
    "command", ["benchmark", "close-loop", "demo", "hide", "reproduce", "speed", "tune", "valve-test"]
)
def test_folder_that_cannot_be_written(run: Run, tmp_path: Path, command: str, out: str) -> None:
    (tmp_path / "file").write_text("x")
    status, _, err = run(command, "--out", out)
    assert status == 2 and is_one_line(err) and out in err
    assert listing(tmp_path) == ["file"]


BAD = {
    "unknown preset": (["benchmark", "pid_paper", "--plant", "papre", "--out", "out"], ["papre", "paper"]),
    "no such model file": (["hide", "--none", "--model", "rig.yaml", "--out", "out"], ["rig.yaml"]),
    "unknown controller": (["benchmark", "pid_papr", "--out", "out"], ["pid_papr", "pid_paper"]),
    "unknown scenario": (
        ["benchmark", "pid_paper", "--scenario", "stairs", "--out", "out"],
        ["stairs", "staircase"],
    ),
    "unknown split": (
        ["benchmark", "pid_paper", "--split", "test_intrp", "--out", "out"],
        ["test_intrp", "test_interp"],
    ),
    "no such suite": (["benchmark", "--suite", "quickly", "--out", "out"], ["quickly", "quick"]),
    "unknown effect": (["hide", "deadzone", "--out", "out"], ["deadzone", "dead_zone"]),
    "unknown channel": (["hide", "dead_zone:3", "--out", "out"], ["3", "1, 2 or both"]),
    "nothing to hide": (["hide", "--out", "out"], ["--none"]),
    "value without a number": (
        ["hide", "dead_zone", "--value", "dead_zone.overlap_positive=x", "--out", "out"],
        ["NUMBER"],
    ),
    "unknown law": (["tune", "--controller", "pdi", "--out", "out"], ["pdi", "pid"]),
    "tuning on a test split": (
        ["tune", "--mismatch", "test_interp", "--out", "out"],
        ["test_interp", "train"],
    ),
    "no such log": (["diagnose", "fit.csv", "--sealed", "sealed.csv", "--out", "out"], ["fit.csv"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_arguments(run: Run, tmp_path: Path, name: str) -> None:
    arguments, words = BAD[name]
    status, _, err = run(*arguments)
    assert status == 2 and is_one_line(err), err
    for word in words:
        assert word in err
    assert listing(tmp_path) == []


MODELS = {
    "a key that does not exist": ("schema: hydro_env/model/1\nname: x\nboth: {Kqq: 0.4}\n", ["Kqq", "Kq"]),
    "an effect that does not exist": (
        "schema: hydro_env/model/1\nname: x\neffects: {deadzone: {}}\n",
        ["deadzone", "dead_zone"],
    ),
    "a section that does not exist": (
        "schema: hydro_env/model/1\nname: x\nchanel_1: {Kq: 0.4}\n",
        ["chanel_1", "channel_1"],
    ),
    "text for a number": ("schema: hydro_env/model/1\nname: x\nboth: {Kq: big}\n", ["Kq", "big"]),
    "no YAML": ("both: {Kq: 0.4\n", []),
    "a negative mass": ("schema: hydro_env/model/1\nname: x\nboth: {m: -1.0}\n", ["m", "-1"]),
    "nothing": ("", []),
}


@pytest.mark.parametrize("name", MODELS)
def test_bad_model_files(run: Run, tmp_path: Path, name: str) -> None:
    text, words = MODELS[name]
    (tmp_path / "model.yaml").write_text(text)
    status, _, err = run("hide", "--none", "--model", "model.yaml", "--out", "out")
    assert status == 2 and is_one_line(err), err
    for word in ("model.yaml", *words):
        assert word in err
    assert listing(tmp_path) == ["model.yaml"]


def _drop(name: str) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        column = rows[0].index(name)
        for row in rows:
            del row[column]

    return change


def _rename(old: str, new: str) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        rows[0][rows[0].index(old)] = new

    return change


def _put(row: int, name: str, value: str) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        rows[row][rows[0].index(name)] = value

    return change


def _pause(rows: list[list[str]]) -> None:
    for row in rows[100:]:
        row[0] = f"{float(row[0]) + 30.0:.4f}"


LOGS: dict[str, tuple[Callable[[list[list[str]]], object], list[str]]] = {
    "no time": (_drop("time_s"), ["time_s"]),
    "no speed": (lambda rows: (_drop("speed_1_rpm")(rows), _drop("speed_2_rpm")(rows)), ["speed"]),
    "no command": (lambda rows: (_drop("command_1_V")(rows), _drop("command_2_V")(rows)), ["command"]),
    "text in a number": (_put(100, "speed_1_rpm", "fast"), ["fast", "speed_1_rpm", "101"]),
    "time running backwards": (_put(100, "time_s", "0.5"), ["time_s", "101"]),
    "a gap of half a minute": (_pause, ["time_s", "101", "split"]),
    "a wrong unit": (_rename("speed_1_rpm", "speed_1_kg"), ["speed_1"]),
    "no rows": (lambda rows: rows.__delitem__(slice(1, None)), []),
    "an empty file": (lambda rows: rows.clear(), ["empty"]),
    "a row cut short": (lambda rows: rows[100].__delitem__(slice(5, None)), ["101"]),
}


@pytest.mark.parametrize("name", LOGS)
def test_bad_logs(run: Run, tmp_path: Path, name: str) -> None:
    change, words = LOGS[name]
    write_log(tmp_path / "fit.csv", change)
    status, _, err = run("diagnose", "fit.csv", "--sealed", "sealed.csv", "--out", "out")
    assert status == 2 and is_one_line(err), err
    for word in ("fit.csv", *words):
        assert word in err
    assert listing(tmp_path) == ["fit.csv"]


MAPPING = "schema: hydro_env/mapping/1\nname: x\ntime: {column: time_s, unit: s}\n"
MAPPINGS = {
    "a unit that does not exist": (
        "channel_1: {command: {column: command_1_V, unit: V}, speed: {column: speed_1_rpm, unit: knots}}",
        ["knots"],
    ),
    "a key that does not exist": ("channel_1: {spede: {column: speed_1_rpm, unit: rpm}}", ["spede", "speed"]),
    "no YAML": ("channel_1: {", []),
}


@pytest.mark.parametrize("name", MAPPINGS)
def test_bad_mappings(run: Run, tmp_path: Path, name: str) -> None:
    text, words = MAPPINGS[name]
    write_log(tmp_path / "fit.csv")
    (tmp_path / "mapping.yaml").write_text(MAPPING + text)
    status, _, err = run(
        "diagnose", "fit.csv", "--sealed", "sealed.csv", "--mapping", "mapping.yaml", "--out", "out"
    )
    assert status == 2 and is_one_line(err), err
    for word in ("mapping.yaml", *words):
        assert word in err
    assert listing(tmp_path) == ["fit.csv", "mapping.yaml"]


def test_interrupt(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hydro_env.practice import generate as hide

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(hide, "run", interrupted)
    status, _, err = run("hide", "dead_zone", "--out", "out")
    assert status == 130 and is_one_line(err)
    assert listing(tmp_path) == []


def test_missing_extra_is_named(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from hydro_env.practice import generate as hide

    def missing(*_: object, **__: object) -> None:
        raise ModuleNotFoundError("No module named 'plotly.graph_objects'", name="plotly.graph_objects")

    monkeypatch.setattr(hide, "run", missing)
    status, _, err = run("hide", "dead_zone", "--out", "out")
    assert status == 2 and "'.[report]'" in err and is_one_line(err)
    assert listing(tmp_path) == []


def test_a_mistake_in_the_program_is_not_hidden(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from hydro_env.practice import generate as hide

    def wrong(*_: object, **__: object) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(hide, "run", wrong)
    with pytest.raises(ZeroDivisionError):
        run("hide", "dead_zone", "--out", "out")


def test_error_message_is_one_line(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    from hydro_env.practice import generate as hide

    def bad(*_: object, **__: object) -> None:
        raise InputError("first\nsecond")

    monkeypatch.setattr(hide, "run", bad)
    assert run("hide", "dead_zone", "--out", "out") == (2, "", "error: first second\n")


def test_hide_writes_logs_and_truth(run: Run, tmp_path: Path) -> None:
    status, out, _ = run("hide", "dead_zone:1", "--duration", 3, "--rate", 100, "--out", "out")
    assert status == 0 and "truth.json" in out
    assert listing(tmp_path / "out") == ["fit_1.csv", "fit_2.csv", "model.yaml", "sealed.csv", "truth.json"]
    assert json.loads((tmp_path / "out" / "truth.json").read_text())["effects"][0]["name"] == "dead_zone"


def test_as_a_program(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hydro_env", "hide", "deadzone", "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ") and done.stderr.count("\n") == 1
    assert listing(tmp_path) == []


def test_option_with_several_values() -> None:
    given = ["diagnose", "a", "b", "--sealed", "c", "d", "--seed", "1", "--sealed", "e"]
    expected = ["diagnose", "a", "b", "--sealed", "c", "--sealed", "d", "--seed", "1", "--sealed", "e"]
    assert spread(given, ["--sealed"]) == expected


@pytest.mark.parametrize("streams", ["", "2>&1", "2>&-", "0<&- >&- 2>&-"])
def test_a_reader_that_leaves_takes_no_results_with_it(tmp_path: Path, streams: str) -> None:
    """Also one of the progress and of errors, and where there never was one."""
    reader, writer = os.pipe()
    os.close(reader)
    what = ["hide", "dead_zone:1", "--duration", "3", "--rate", "100", "--out", str(tmp_path / "practice")]
    command = ["sh", "-c", f'exec "$@" {streams}', "sh", sys.executable, "-u", "-m", "hydro_env", *what]
    done = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert done.returncode == 0 and "Error" not in done.stderr
    assert (tmp_path / "practice" / "truth.json").is_file()


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_command_that_is_told_to_end_leaves_nothing(tmp_path: Path, name: str) -> None:
    what = ["hide", "dead_zone:1", "--duration", "1000", "--out", str(tmp_path / "practice")]
    number = getattr(signal, name)

    def as_in_a_terminal() -> None:
        # Tests that run under nohup ignore SIGHUP, and so would the command.
        signal.signal(number, signal.SIG_DFL)

    command = [sys.executable, "-m", "hydro_env", *what]
    with subprocess.Popen(command, stderr=subprocess.PIPE, preexec_fn=as_in_a_terminal) as process:
        while not listing(tmp_path) and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(number)
        _, said = process.communicate(timeout=120)
    assert process.returncode == 128 + number
    assert said.decode().splitlines()[-1].startswith("error: interrupted")
    assert listing(tmp_path) == []


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGINT"])
@pytest.mark.parametrize("by", ["finalizer", "compiled code"])
def test_an_interruption_that_others_drop_is_not_lost(name: str, by: str) -> None:
    """Python drops what a finalizer raises, such as those of compiled modules; C code may clear any error."""

    class Compiled:
        def __del__(self) -> None:
            signal.raise_signal(getattr(signal, name))
            time.sleep(0)

    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # what runs in the background ignores it
    with pytest.raises(KeyboardInterrupt), stopped_by_signals() as signals:
        if by == "finalizer":
            Compiled()
        else:
            with suppress(KeyboardInterrupt):
                signal.raise_signal(getattr(signal, name))
                time.sleep(0)
        time.sleep(10)
    signal.signal(signal.SIGINT, before)
    assert signals == [getattr(signal, name)]


@pytest.mark.skipif(not hasattr(signal, "SIGHUP"), reason="no such signals")
def test_an_interruption_that_takes_long_is_not_raised_twice() -> None:
    with stopped_by_signals() as signals:
        try:
            signal.raise_signal(signal.SIGTERM)
        except KeyboardInterrupt:
            time.sleep(1.2 * LOST)
            signal.raise_signal(signal.SIGTERM)  # nor by one more signal
            time.sleep(0.1)
    time.sleep(1.2 * LOST)
    assert signals == [signal.SIGTERM]


@pytest.mark.parametrize("example", [each for some in examples().values() for each in some])
def test_examples_of_the_help_are_understood(example: str) -> None:
    _, name, *words = shlex.split(example)
    command = typer.main.get_command(cli.app).commands[name]  # type: ignore[attr-defined]
    command.make_context(name, spread(words, ["--sealed"]))


def test_every_command_has_examples_and_grouped_options(run: Run) -> None:
    for name, command in typer.main.get_command(cli.app).commands.items():  # type: ignore[attr-defined]
        _, out, _ = run(name, "--help")
        assert examples()[name] and all(example in out for example in examples()[name])
        for inner in getattr(command, "commands", [""]):  # only --help stands under "Help"
            text = run(name, *filter(None, [inner]), "--help")[1]
            assert re.search(r"\nHelp:\n +--help +Show this message and exit.\n\n", text), (name, inner)
    assert "Examples:" in run("--help")[1]


def test_list(run: Run, tmp_path: Path) -> None:
    status, out, _ = run("list")
    assert status == 0
    for line in ("controllers\n  pid_paper ", "effects\n", "  dead_zone ", "  rig ", "  sine ", "  own "):
        assert line in out
    assert all(len(line.split(maxsplit=1)) == 2 for line in out.splitlines() if line.startswith("  "))
    status, out, _ = run("list", "effects", "--json", "--out", "lists")
    data = json.loads(out)
    assert (
        set(data) == {"schema", "effects"} and json.loads((tmp_path / "lists/list.json").read_text()) == data
    )
    overlap = next(each for each in data["effects"] if each["name"] == "dead_zone")["parameters"][0]
    assert overlap["unit"] == "m" and overlap["high"] == 4.5e-4
    status, _, err = run("list", "effect")
    assert status == 2 and "did you mean 'effects'" in err

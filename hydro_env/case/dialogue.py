"""The dialogue: `hydro-env diagnose --case DIR` adds the logs that came, diagnoses all of them, and asks or closes."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..diagnosis import Diagnosis
from ..diagnosis.command import diagnosed
from ..diagnosis.experiment_design import SENSORS
from ..diagnosis.logs import Logs
from ..diagnosis.stages.naming import UNKNOWN
from ..diagnosis.stages.next_experiment import FILE as NEXT_EXPERIMENT
from ..errors import InputError, suggestion
from ..files import output_folder, write_text
from ..pages import beside_results
from . import folder as cases
from .folder import CaseFile, Place, Question
from .hypotheses import certainty, expected, places_of
from .page import case_page

#: From this probability of the best answer on a case is sure: names that leave a little reach 0.88 (`naming.INCOMPLETE`).
SURE = 0.85
#: A question has to bring this much probability.
WORTH_ASKING = 0.02
#: A sensor for one experiment costs as much as this many experiments, unless the user says otherwise.
COST = 1.0
#: What a rig log calls what `hydro-env hide --record` does not.
ALWAYS = "time, command, speed"
#: Attributes of a log by what `hydro-env hide --record` calls them.
_LOGGED = {"load": ("load",), "setpoint": ("setpoint",), **SENSORS, "line_pressures": ("pressure_a",)}


def run(
    folder: Path, logs: Sequence[str], sealed: Sequence[str], options: dict[str, Any], given: set[str], *,
    arguments: Callable[[dict[str, Any]], dict[str, Any]], jobs: int | None = None, quiet: bool = False,
) -> CaseFile:  # fmt: skip
    """Begins a case, adds `logs` to one, goes on with a call that was interrupted, or says where the case stands.

    Args:
        folder: of the case; new or empty for a first call.
        logs: to fit: the first ones, or those that came back for the last question.
        sealed: held-out logs of the first call.
        options: of the command by their names, kept by the first call; `given` are those that the user gave.
        arguments: of `diagnose`, other than logs, model and mapping, from options.
        jobs: threads; None: one for every core.
        quiet: prints nothing.

    Raises:
        InputError: for what is no case, other options than the first call's, and logs that cannot be used.
    """
    arguments(options)
    new = bool(logs) and bool(sealed) and not (folder / cases.FILE).exists()
    if new:
        case = cases.begin(folder, logs, sealed, options)
    else:
        case = cases.read(folder)
        if sealed:
            raise InputError(
                f"{folder}: --sealed is given, but held-out logs are those of the first call; leave it out"
            )
        cases.check_options(folder, case, options, given)
        case = _with(folder, case, logs)
    if case.rounds[-1].verdict is None:
        try:
            case = _diagnosed(folder, case, arguments(case.options), jobs, quiet)
        except InputError:
            if new:
                shutil.rmtree(folder)
            elif logs:
                _without_last(folder, case)
            raise
    if not quiet:
        print(said(folder, case))
    return case


def _with(folder: Path, case: CaseFile, logs: Sequence[str]) -> CaseFile:
    """The case with logs, unless an interrupted call has added the same ones already."""
    last = case.rounds[-1]
    if not logs:
        return case
    if last.verdict is None:
        known = [case.files[cases.path_of(w)] for w in last.logs]
        if [
            cases.sha256_of(Path(cases.path_of(w))) for w in logs if Path(cases.path_of(w)).exists()
        ] == known:
            return case
        raise InputError(
            f"{folder}: logs of an interrupted call wait; run it again without logs, then give further ones"
        )
    if case.closed:
        raise InputError(f"{folder}: the case is closed ({case.closed}); begin another one for further logs")
    return cases.added(folder, case, logs)


def _without_last(folder: Path, case: CaseFile) -> None:
    """Takes back the round of a log that cannot be used."""
    before = {w for r in case.rounds[:-1] for w in r.logs} | {*case.sealed}
    kept = {cases.path_of(w) for w in before}
    mine = {cases.path_of(w) for w in case.rounds[-1].logs} - kept
    files = {n: sha for n, sha in case.files.items() if n not in mine}
    cases.write(folder, case.model_copy(update={"rounds": case.rounds[:-1], "files": files}))
    for name in mine:
        (folder / name).unlink(missing_ok=True)


def _diagnosed(
    folder: Path, case: CaseFile, arguments: dict[str, Any], jobs: int | None, quiet: bool
) -> CaseFile:
    """Diagnoses all logs and adds what was found: the round's folder, the question, the page, and case.json last."""
    model, mapping = (
        str(folder / copy) if copy in case.files else case.options[name]
        for name, copy in cases.COPIED.items()
    )
    fit = [str(folder / word) for r in case.rounds for word in r.logs]
    with output_folder(folder / f"round_{len(case.rounds)}") as work:
        found = diagnosed(
            fit, [str(folder / word) for word in case.sealed], work, jobs=jobs, quiet=quiet, model=model, mapping=mapping,
            **arguments,
        )  # fmt: skip
    number = len(case.asked) + 1
    places = places_of(found)
    question, closed = _next(found, places, f"question_{number}.csv", number <= case.options["questions"])
    last, experiment = case.rounds[-1], found.next_experiment
    if question is not None and question.commands is not None and experiment is not None:
        write_text(folder / question.commands, str(experiment.csv()))
    now = last.model_copy(
        update={
            "verdict": found.verdict, "seconds": round(found.seconds, 1), "open": places, "question": question,
            "remarks": _remarks(found, case),
        }
    )  # fmt: skip
    case = case.model_copy(update={"rounds": [*case.rounds[:-1], now], "closed": closed})
    with beside_results(folder / "report.html"):
        write_text(folder / "report.html", case_page(folder, case))
    cases.write(folder, case)
    return case


def _next(
    found: Diagnosis, places: Sequence[Place], file: str, may_ask: bool
) -> tuple[Question | None, str | None]:
    """The next question, or why the case is closed."""
    experiment, now, settings = found.next_experiment, certainty(places), found.logs.fit.settings
    if now >= SURE and found.verdict != "unknown" and not found.best_guess:
        return None, "sure"
    if experiment is None:
        return None, "nothing left that experiments within the limits can part"
    names = [n for p in places for n in p.hypotheses if n != UNKNOWN]
    why = experiment.description.replace(NEXT_EXPERIMENT, file)
    then = expected(places, experiment.apart, settings)
    prediction = None if experiment.design is None else experiment.design.prediction
    if experiment.design is not None and prediction is None and then - now < WORTH_ASKING:
        return None, f"nothing left that experiments within the limits can part: {why}"
    if not may_ask:
        return None, "questions used up"
    open_ = ", ".join(dict.fromkeys(n.replace("_", " ") for n in names[:4])) or UNKNOWN
    question = Question(
        why=f"open: {open_}; {why}", commands=None if experiment.design is None else file,
        record=[*recorded(found.logs), *filter(None, [experiment.sensor])], sensor=experiment.sensor,
        apart={" | ".join(pair): round(d, 2) for pair, d in experiment.apart.items()}, now=now, expected=then,
    )  # fmt: skip
    return question, None


def recorded(logs: Logs) -> list[str]:
    """What the logs hold beside time, command and speed, as `hydro-env hide --record` calls it."""
    every = [part.log for part in (*logs.fit.rig.parts, *logs.held_out.parts)]
    return [n for n, signals in _LOGGED.items() if any(log.get(signals[0]) is not None for log in every)]


def _remarks(found: Diagnosis, case: CaseFile) -> list[str]:
    """What a log lacks that was asked for."""
    if len(case.rounds) < 2 or (asked := case.rounds[-2].question) is None or asked.sensor is None:
        return []
    shas = {case.files[cases.path_of(w)] for w in case.rounds[-1].logs}
    attribute = _LOGGED[asked.sensor][0]
    came = any(p.log.get(attribute) is not None for p in found.rig.parts if p.log.sha256 in shas)
    return [] if came else [f"came back without {asked.sensor.replace('_', ' ')}"]


def sensor_costs(words: Sequence[str]) -> tuple[tuple[str, float], ...]:
    """`spool=2` ... as the cost of each sensor in experiments; `none`: no sensor may be asked for. InputError for others."""
    costs = dict.fromkeys(SENSORS, COST)
    for word in words:
        name, equals, text = word.partition("=")
        if word == "none":
            return ()
        if name not in SENSORS:
            raise InputError(f"--sensor {word}: {suggestion(name, [*SENSORS, 'none'])}")
        try:
            costs[name] = float(text)
        except ValueError:
            costs[name] = -1.0
        if not equals or not costs[name] >= 0.0:
            raise InputError(f"--sensor {word}: expected {name}=COST, a number of experiments from 0 on")
    return tuple(costs.items())


def said(folder: Path, case: CaseFile) -> str:
    """Where the case stands, in at most about fifteen lines."""
    last = case.rounds[-1]
    assert last.verdict is not None
    logs = sum(len(r.logs) for r in case.rounds)
    lines = [f"{folder}: {logs} logs, {len(case.asked)} questions so far; verdict {last.verdict}"]
    lines += [f"  remark: the last log {text}" for text in last.remarks]
    for place in last.open[:4]:
        shares = [f"{n.replace('_', ' ')} {p:.2f}" for n, p in [*place.hypotheses.items()][:5]]
        where = "rig" if place.channel == "rig" else f"channel {place.channel}"
        lines.append(f"  {where}: {', '.join(shares)}")
    if case.closed:
        lines.append(f"closed: {case.closed}")
    elif last.question is not None:
        lines += _asked(folder, case, last.question)
    return "\n".join([*lines, f"  report: {folder / 'report.html'}"])


def _asked(folder: Path, case: CaseFile, question: Question) -> list[str]:
    lines = [f"question {len(case.asked)} of {case.options['questions']}: {question.why}"]
    if question.expected > question.now:
        lines.append(
            f"  the best answer is right with {question.now:.2f} now, {question.expected:.2f} expected then"
        )
    log = f"{ALWAYS}, {', '.join(question.record)}"
    if question.commands is None:
        return [*lines, f"  log: {log}", f"  then: hydro-env diagnose --case {folder} LOG"]
    file = folder / question.commands
    lines += [f"  play: {file} (look at it first)", f"  log: {log}"]
    answer = "LOG"
    if case.practice:
        answer = f"answer_{len(case.asked)}/played.csv"
        record = ",".join(question.record)
        lines.append(
            f"  practice rig: hydro-env hide ... --record {record} --play {file} --out {Path(answer).parent}"
        )
    return [*lines, f"  then: hydro-env diagnose --case {folder} {answer}"]

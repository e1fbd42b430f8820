"""The dialogue: `hydro-env diagnose --case DIR` adds the logs that came, diagnoses all of them, and asks or closes."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from ..diagnosis import Diagnosis
from ..diagnosis.logs import Logs
from ..diagnosis.report import wording as words
from ..diagnosis.stages import next_experiment
from ..diagnosis.stages.naming import UNKNOWN
from ..errors import InputError
from ..files import output_folder, write_text
from ..pages import beside_results
from . import command
from . import folder as cases
from .folder import CaseFile, Place, Question, Round
from .hypotheses import certainty, expected, places_of, with_experiment
from .page import case_page
from .sensors import SENSORS, Shown, costs_of, shown

#: From this probability of the best answer on a case is sure; names that leave something reach 0.88 (`naming.INCOMPLETE`).
SURE = 0.9
#: A question has to bring this much probability.
WORTH_ASKING = 0.02
#: Why a case may be closed.
NOTHING_LEFT = "nothing left that experiments within the limits can part"
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
    arguments(options), costs_of(options["sensor"] or [])
    before = None
    if logs and sealed and not (folder / cases.FILE).exists():
        case = cases.begin(folder, logs, sealed, options)
    else:
        before = case = cases.read(folder)
        if sealed:
            raise InputError(f"{folder}: held-out logs are those of the first call; leave --sealed out")
        cases.check_options(folder, case, options, given)
        case = _with(folder, case, logs)
    if case.rounds[-1].verdict is None:
        try:
            case = _diagnosed(folder, case, arguments(case.options), jobs, quiet)
        except InputError as problem:
            if before is None:
                shutil.rmtree(folder)
            elif before is not case:
                cases.restore(folder, before, case)
            text = str(problem)
            for word, copy in zip(logs, case.rounds[-1].logs, strict=False):  # the copy may be gone
                text = text.replace(str(folder / cases.path_of(copy)), cases.path_of(word))
            raise InputError(text) from None
    if not quiet:
        print(said(folder, case))
    return case


def _with(folder: Path, case: CaseFile, logs: Sequence[str]) -> CaseFile:
    """The case with logs, unless an interrupted call has added the same ones already."""
    if case.closed and logs:
        raise InputError(f"{folder}: the case is closed ({case.closed}); begin another one for further logs")
    if not logs or (waiting := case.rounds[-1]).verdict is not None:
        return cases.added(folder, case, logs) if logs else case
    if cases.hashes_of(logs) != [case.files[cases.path_of(w)] for w in waiting.logs]:
        raise InputError(f"{folder}: logs of an interrupted call wait; call it without logs first")
    return case


def _diagnosed(
    folder: Path, case: CaseFile, arguments: dict[str, Any], jobs: int | None, quiet: bool
) -> CaseFile:
    """Diagnoses all logs, beside what the round before found, and adds what is found: the round's folder, the question, the page,
    and case.json last."""
    copies = {name: folder / copy for name, copy in cases.COPIED.items() if copy in case.files}
    given = {name: copies.get(name, case.options[name]) for name in cases.COPIED}
    fit = [str(folder / word) for r in case.rounds for word in r.logs]
    for left in folder.glob(".round_*"):  # of a call that was killed
        shutil.rmtree(left)
    before = folder / f"round_{len(case.rounds) - 1}" / "model.yaml"
    if before.exists():  # the first round has none, and nothing is lost where somebody took it away
        arguments = {**arguments, "former": before}
    with output_folder(folder / f"round_{len(case.rounds)}") as work:
        sealed = [str(folder / word) for word in case.sealed]
        found = command.run(fit, sealed, work, jobs=jobs, quiet=quiet, summary=False, **given, **arguments)
    number, places = len(case.asked) + 1, places_of(found)
    if certainty(places) < SURE:
        found = with_experiment(found)
    with_sensor = shown(found, costs_of(case.options["sensor"] or []))
    file, may_ask = f"question_{number}.csv", number <= case.options["questions"]
    question, closed = next_question(found, places, with_sensor, file, may_ask)
    if question is not None and question.commands is not None and found.next_experiment is not None:
        write_text(folder / question.commands, str(found.next_experiment.csv()))
    now = Round(
        logs=case.rounds[-1].logs, remarks=_remarks(found, case), verdict=found.verdict, seconds=round(found.seconds, 1),
        open=places, question=question,
    )  # fmt: skip
    case = case.model_copy(update={"rounds": [*case.rounds[:-1], now], "closed": closed})
    with beside_results(folder / "report.html"):
        write_text(folder / "report.html", case_page(folder, case))
    cases.write(folder, case)
    return case


def next_question(
    found: Diagnosis, places: Sequence[Place], shown: Shown, file: str, may_ask: bool
) -> tuple[Question | None, str | None]:
    """The next question, or why the case is closed."""
    experiment, now = found.next_experiment, certainty(places)
    if now >= SURE and found.verdict != "unknown" and not found.best_guess:
        return None, "sure"
    if experiment is None:
        return None, NOTHING_LEFT
    why, design = experiment.description.replace(next_experiment.FILE, file), experiment.design
    if shown.sensor:  # in the place of what the catalogue knows of the pair
        why = why.partition("; or ")[0] + shown.words
    then = expected(places, shown.apart, found.logs.fit.settings.temper)
    unseen = found.verdict in ("none", "calibration")
    shows = unseen and max(shown.apart.values(), default=0.0) >= next_experiment.PARTED
    if design is not None and design.prediction is None and then - now < WORTH_ASKING and not shows:
        return None, f"{NOTHING_LEFT}: {why}"
    if not may_ask:
        return None, "questions used up"
    names = [n for _, n in shown.apart] if unseen else [n for p in places for n in p.hypotheses]
    open_ = ", ".join(dict.fromkeys([words.plain(n) for n in names if n != UNKNOWN][:4])) or UNKNOWN
    question = Question(
        why=f"{_status(found)}: {open_}; {why}", commands=None if design is None else file,
        record=[*recorded(found.logs), *filter(None, [shown.sensor])], sensor=shown.sensor,
        apart={" | ".join(pair): round(d, 2) for pair, d in shown.apart.items()}, now=now, expected=then,
    )  # fmt: skip
    return question, None


def _status(found: Diagnosis) -> str:
    """How far what a question is about is known, in words."""
    if found.best_guess:
        return "best guess, not proven"
    if found.verdict in ("none", "calibration"):
        return "these logs would not show"
    settled = found.effects and not any(e.indistinguishable_from for e in found.effects)
    return "leaves more than the noise" if settled and found.verdict == "effects" else "open"


def recorded(logs: Logs) -> list[str]:
    """What the logs hold beside time, command and speed, as `hydro-env hide --record` calls it."""
    every = [(p.log, c) for p in (*logs.fit.rig.parts, *logs.held_out.parts) for c in p.log.channels]
    return [n for n, signals in _LOGGED.items() if any(log.has(signals[0], c) for log, c in every)]


def _remarks(found: Diagnosis, case: CaseFile) -> list[str]:
    """What a log lacks that was asked for."""
    if len(case.rounds) < 2 or (asked := case.rounds[-2].question) is None or asked.sensor is None:
        return []
    shas = {case.files[cases.path_of(w)] for w in case.rounds[-1].logs}
    attribute = _LOGGED[asked.sensor][0]
    came = any(p.log.get(attribute) is not None for p in found.rig.parts if p.log.sha256 in shas)
    return [] if came else [f"came back without {words.plain(asked.sensor)}"]


def said(folder: Path, case: CaseFile) -> str:
    """Where the case stands, in at most about fifteen lines."""
    last = case.rounds[-1]
    logs = sum(len(r.logs) for r in case.rounds)
    answered = f"{len(case.rounds) - 1} of at most {case.options['questions']} questions answered"
    lines = [f"{folder}: {logs} {'log' if logs == 1 else 'logs'}, {answered}; verdict {last.verdict}"]
    lines += [f"  remark: the last log {text}" for text in last.remarks]
    for place in last.open[:4]:
        shares = [f"{words.plain(n)} {p:.2f}" for n, p in [*place.hypotheses.items()][:5]]
        lines.append(f"  {words.where(place.channel)}: {', '.join(shares)}")
    if case.closed:
        lines.append(f"closed: {case.closed}")
    elif last.question is not None:
        lines += _asked(folder, case, last.question)
    return "\n".join([*lines, f"  report: {folder / 'report.html'}"])


def _asked(folder: Path, case: CaseFile, question: Question) -> list[str]:
    lines = [f"question {len(case.asked)} of {case.options['questions']}: {question.why}"]
    now, then = question.now, question.expected
    if then > now:
        lines.append(f"  the best answer is right with {now:.2f} now, {then:.2f} expected then")
    answer, out = "LOG", f"answer_{len(case.asked)}"
    if question.commands is not None:
        file = folder / question.commands
        lines += [f"  play: {file} (look at it first)"]
        if case.practice:
            record, answer = ",".join(question.record), f"{out}/played.csv"
            lines += [f"  practice rig: hydro-env hide ... --record {record} --play {file} --out {out}"]
    log = ", ".join(("time, command, speed", *question.record))
    return [*lines, f"  log: {log}", f"  then: hydro-env diagnose --case {folder} {answer}"]

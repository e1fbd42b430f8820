"""Dialogues: the rigs of a set made with `--ask` answer questions with logs, within a budget.

A method's folder holds for each rig, in a folder `NAME` beside its answer, what it asks and what came back:

    question_1.csv   commands, and loads, as `hydro-env hide --play` takes them
    question_1.json  {"record": ["spool"]}, optional: sensors for this run that the rig's first log lacks
    answer_1.csv     the log, which `play` writes

Only `play` reads the truth, so whoever keeps that of a sealed set may play for others.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from ...case.dialogue import SURE, next_question
from ...case.hypotheses import certainty, places_of, with_experiment
from ...case.sensors import SENSORS, shown
from ...diagnosis import Diagnosis
from ...errors import InputError
from ...files import write_json, write_text
from ...practice.generate import PLAYED, make_practice
from ...practice.recorder import log_text
from ...reading import read_json
from ...validation import FileTable, checked, known
from .sets import DURATION, columns_of, read_set, read_truth

#: Takes a diagnosis, and returns commands with loads (CSV) and the sensors to record besides; None where nothing is asked.
Designer = Callable[[Diagnosis, np.random.Generator], tuple[str, list[str]] | None]


def asked(found: Diagnosis, rng: np.random.Generator) -> tuple[str, list[str]] | None:
    """What a case asks (`hydro-env diagnose --case`), with sensors that cost nothing, since the budget has one for a question."""
    places = places_of(found)
    if certainty(places) < SURE:
        found = with_experiment(found)
    sensor = shown(found, dict.fromkeys(SENSORS, 0.0))
    question, _ = next_question(found, places, sensor, "question.csv", may_ask=True)
    commands = found.next_experiment and found.next_experiment.csv()
    return (commands, [*filter(None, [sensor.sensor])]) if question and commands else None


def answers_of(own: Path) -> list[Path]:
    """The logs that came back to a rig's folder of questions."""
    return sorted(own.glob("answer_*.csv"))


def converse(
    design: Designer, diagnosed: Callable[[list[Path]], Diagnosis], folder: Path, own: Path
) -> Diagnosis | None:
    """Asks a rig in `folder` until its budget is spent or `design` asks nothing more, with `own` as the folder of questions; the
    last diagnosis, or None while a question waits for who has the truth."""
    about = read_json(folder / "rig.json", "a rig of the naming benchmark")
    most = about.get("budget", {}).get("questions", 0)
    while True:
        answers = answers_of(own)
        number = len(answers) + 1
        if not (own / f"question_{number}.csv").exists():
            found = diagnosed(answers)
            question = design(found, np.random.default_rng([number, 8])) if number <= most else None
            if question is None:
                return found
            own.mkdir(parents=True, exist_ok=True)
            write_json(own / f"question_{number}.json", {"record": question[1]})
            write_text(own / f"question_{number}.csv", question[0])
        if not (folder.parents[1] / "truth").is_dir():
            return None
        play_rig(folder.parents[1], own)


def play(folder: Path, methods: Path) -> int:
    """Answers all questions in a method's folder that have no answer yet, from the set in `folder`; how many there were.

    InputError for a set without dialogues or with another truth than the published one, and for questions beyond the budget.
    """
    return sum(
        play_rig(folder, methods / rig) for rig in read_set(folder)["rigs"] if (methods / rig).is_dir()
    )


def play_rig(folder: Path, own: Path) -> int:
    """The same for one rig, with `own` as its folder of questions."""
    truth = read_truth(folder, own.name)
    about = read_json(folder / "rigs" / own.name / "rig.json", "a rig of the naming benchmark")
    if "budget" not in about:
        raise InputError(f"{folder}: its rigs answer no questions; make a set with --ask")
    left, played = dict(about["budget"]), 0
    for number in range(1, len([*own.glob("question_*.csv")]) + 1):
        question, answer = (own / f"{name}_{number}.csv" for name in ("question", "answer"))
        lasting = np.diff(columns_of(question, ("time_s",))[:, 0])
        # The last row lasts as long as the one before.
        seconds = round(float(lasting.sum() + lasting[-1:].sum()), 6)
        sensors = [name for name in _recorded(question.with_suffix(".json")) if name not in truth["record"]]
        spent = {"questions": 1, "seconds": seconds, "sensors": len(sensors)}
        left = {key: left[key] - spent[key] for key in left}
        if short := [key for key, rest in left.items() if rest < 0]:
            raise InputError(
                f"{question}: beyond the rig's budget of {about['budget'][short[0]]:g} {short[0]} in all"
            )
        if not answer.exists():
            settings = {key: truth[key] for key in ("severity", "base_error", "noise", "seed", "values")}
            record = [*truth["record"], *sensors]
            practice = make_practice(
                truth["hidden"], play=question, record=record, duration=DURATION, **settings
            )
            write_text(answer, log_text(practice.logs[PLAYED]))
            played += 1
    return played


class _Question(FileTable):
    record: list[Annotated[str, known("sensor", SENSORS)]] = Field(default_factory=list)


def _recorded(path: Path) -> list[str]:
    """The sensors that a question wants."""
    return checked(_Question, read_json(path, "a question"), path).record if path.exists() else []

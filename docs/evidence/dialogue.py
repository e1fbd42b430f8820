"""What a dialogue decides: blind rigs that are asked up to three questions, and the same rigs with random experiments.

    python -m docs.evidence.dialogue --out DIR [--seed N] [--singles N] [--pairs N] [--empty N] [--minutes M] [--jobs N]
                                     [--questions asked random ...]

Each rig hides one effect (all of the catalogue in turn, small, medium and large), two, or none; base parameters are up to 15 %
off the given model's but in every second rig without effects; noise, sizes and forms as in `blind_trials`. The first log is 6 s
of closed-loop operation, the held-out one 6 s of another mixture. As long as the diagnosis is not sure (`case.dialogue`), the
rig plays 12 s that it asks for, with the sensor that it asks for, or random or D-optimal manoeuvres of the same family and limits
(`naming_methods.designs`). All logs are diagnosed together, beside what was found before, against the same held-out one.

Exact is a rig if the dialogue ends with the hidden names on their channels, alone, or with none where nothing is hidden; proven
if the held-out log is explained as well, and no other name is listed beside one. Rigs that DIR holds already are not run again.
Writes dialogue.json, dialogue.md, and in paired.md how many questions each kind needs.
"""

from __future__ import annotations

import argparse
import math
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import binomtest

from agents.command import run_command
from hydro_env.case.dialogue import SURE, recorded
from hydro_env.case.hypotheses import certainty, places_of
from hydro_env.diagnosis import Diagnosis, diagnose
from hydro_env.errors import InputError
from hydro_env.experiments.coverage import by_channel, given_names
from hydro_env.experiments.naming_benchmark.dialogue import asked
from hydro_env.files import write_json, write_text
from hydro_env.limits import CORES, SEEDS, Limits
from hydro_env.parallel import Failure, as_done
from hydro_env.plant import PlantModel
from hydro_env.practice.generate import PLAYED, make_practice
from hydro_env.reading import MAX_BYTES_OF_RESULTS, read_json

from .blind_trials.cases import BASE_ERROR, cases
from .blind_trials.judging import covered, judge
from .blind_trials.running import method
from .blind_trials.tables import markdown
from .naming_methods.designs import at_random, d_optimal

SCHEMA = "hydro_env/dialogue/1"
#: The logs of a rig: what is known first, and what is held out.
FIRST, HELD_OUT = "fit_2", "sealed"
LOG_SECONDS, RATE, QUESTIONS = 6.0, 500.0, 3
#: What a rig is asked.
KINDS = {"asked": asked, "random": at_random, "d_optimal": d_optimal}
GROUPS = ("single", "pair", "empty")


@dataclass(frozen=True)
class Rig:
    """A practice rig that is asked: its `folder`, the settings of its logs, and what it hides."""

    folder: Path
    settings: Mapping[str, Any]
    truth: Mapping[str, Any]

    def diagnosed(
        self, answers: Sequence[Path] = (), former: PlantModel | None = None
    ) -> tuple[Diagnosis, float]:
        """What the first log and `answers` show beside the `former` model, and how many seconds that took."""
        begin, model = time.perf_counter(), self.folder / "model.yaml"
        logs, sealed = [self.folder / f"{FIRST}.csv", *answers], [self.folder / f"{HELD_OUT}.csv"]
        found = diagnose(logs, sealed, model=model, former=former)
        return found, time.perf_counter() - begin

    def played(self, name: str, commands: str, record: Sequence[str]) -> Path:
        """The log of these commands."""
        file = self.folder / f"{name}.csv"
        write_text(file, commands)
        make_practice(**self.settings, play=file, record=list(dict.fromkeys(record))).write(
            self.folder / name
        )
        return self.folder / name / f"{PLAYED}.csv"


def run_rig(rig: Mapping[str, Any], kinds: Sequence[str] = tuple(KINDS)) -> dict[str, Any]:
    """One rig with each kind of questions: what was found after every log."""
    settings = {
        "effects": rig["hidden"], "base_error": rig["base_error"], "severity": rig["severity"], "duration": LOG_SECONDS,
        "rate": RATE, "seed": rig["seed"],
    }  # fmt: skip
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_practice(**settings, runs=(FIRST, HELD_OUT)).write(folder)
        own = Rig(folder, settings, read_json(folder / "truth.json", "a practice rig"))
        first = own.diagnosed()
        rounds = {kind: _rounds(own, kind, *first) for kind in kinds}
    return {**rig, "method": method(), **rounds}


def _rounds(rig: Rig, kind: str, found: Diagnosis, seconds: float) -> list[dict[str, Any]]:
    """What was found after every log, from `found` in the first one, which took `seconds`."""
    rng = np.random.default_rng([rig.settings["seed"], 8])
    answers: list[Path] = []
    rounds: list[dict[str, Any]] = []
    while True:
        begin = time.perf_counter()
        question = KINDS[kind](found, rng) if len(rounds) < QUESTIONS else None
        seconds += time.perf_counter() - begin
        commands, sensors = question or ("", [])
        rounds.append(_answer(found, rig.truth) | {"sensors": sensors, "seconds": round(seconds, 1)})
        if question is None:
            return rounds
        answers.append(rig.played(f"{kind}_{len(rounds)}", commands, [*recorded(found.logs), *sensors]))
        found, seconds = rig.diagnosed(answers, found.model)


def _answer(found: Diagnosis, truth: Mapping[str, Any]) -> dict[str, Any]:
    data, places = found.as_dict(), places_of(found)
    hidden = by_channel(truth["effects"])
    judged = judge(data, hidden, truth["verdict"])
    tied = any(e["indistinguishable_from"] for e in data["effects"])
    names = [[e["name"], e["channel"], e["probability"]] for e in data["effects"]]
    proven = judged["right"] and not found.best_guess and not tied
    return {
        "verdict": data["verdict"], "names": names, "proven": proven, "set": judged["set"], "alarm": judged["alarm"],
        "given": given_names(data["effects"], hidden), "certainty": certainty(places), "best_guess": found.best_guess,
        "covered": covered(data, truth),
    }  # fmt: skip


def rigs(seed: int, singles: int, pairs: int, empty: int) -> Iterator[dict[str, Any]]:
    """Rigs in turn, so that a run that is stopped has some of each group."""
    drawn: dict[str, list[tuple[str, ...]]] = {
        "single": [c.hidden for c in cases(["medium"], seed)], "pair": [c.hidden for c in cases(["two"], seed)],
        "empty": [()],
    }  # fmt: skip
    wanted = dict(zip(GROUPS, (singles, pairs, empty), strict=True))
    order = sorted(((n + 0.5) / count, g, n) for g, count in wanted.items() for n in range(count))
    for _, group, n in order:
        hidden, severity = drawn[group][n % len(drawn[group])], ("medium", "small", "large")[n % 3]
        known = group == "empty" and n % 2
        yield {
            "group": group, "hidden": list(hidden), "seed": seed + 1000 * GROUPS.index(group) + n,
            "severity": severity if group == "single" else "medium", "base_error": 0.0 if known else BASE_ERROR,
        }  # fmt: skip


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Counts in Markdown by group and kind of questions."""
    head = [
        "rigs", "questions", "exact at first", *(f"after {n + 1}" for n in range(QUESTIONS)), "proven", "false names",
        "asked, mean",
        "names of 0.9 and more that are right", "true values inside 90 % intervals: effects, base parameters",
    ]  # fmt: skip
    cells = []
    for group in GROUPS:
        own = [r for r in rows if r["group"] == group]
        for kind in [k for k in KINDS if own and k in own[0]]:
            exact = [sum(_exact(r, _after(r[kind], n)) for r in own) for n in range(QUESTIONS + 1)]
            last = [_after(r[kind], QUESTIONS) for r in own]
            sure = [right for each in last for p, right in each["given"] if p >= SURE]
            inside = ", ".join(
                f"{sum(e['covered']['at_90'][k] for e in last)} of {sum(e['covered'][k][1] for e in last)}"
                for k in ("effects", "base")
            )
            cells.append([
                f"{group}: {len(own)}", kind, *exact, sum(e["proven"] for e in last), sum(e["alarm"] for e in last),
                f"{np.mean([len(r[kind]) - 1 for r in own]):.2f}", f"{sum(sure)} of {len(sure)}", inside,
            ])  # fmt: skip
    return "\n".join(markdown(head, cells)) + "\n"


def paired(rows: Sequence[Mapping[str, Any]]) -> str:
    """How many questions each kind needs until a rig is exact, beside those that are asked; one more than there are where it
    never is."""
    own, *others = [kind for kind in KINDS if rows and kind in rows[0]]
    still = [r for r in rows if not _exact(r, r[own][0])]
    needed = [{kind: _needed(r, kind) for kind in (own, *others)} for r in still]
    text = []
    for kind in others if needed else ():
        fewer, more = (sum((n[own] - n[kind]) * sign > 0 for n in needed) for sign in (-1, 1))
        p = binomtest(fewer, fewer + more).pvalue if fewer + more else 1.0
        mean = " and ".join(f"{np.mean([n[k] for n in needed]):.2f}" for k in (own, kind))
        text.append(
            f"Of {len(needed)} open rigs {own} questions need fewer than {kind} ones in {fewer}, more in {more} (p = {p:.2g});"
            f" mean {mean}."
        )
    return "\n\n".join(text)


def _after(rounds: Sequence[Mapping[str, Any]], questions: int) -> Mapping[str, Any]:
    return rounds[min(questions, len(rounds) - 1)]


def _exact(row: Mapping[str, Any], found: Mapping[str, Any]) -> bool:
    """Whether these names, and no others, are those that are hidden."""
    right = [own for _, own in found["given"]]
    verdicts = ("effects",) if row["hidden"] else ("none", "calibration")
    return all(right) and len(right) == len(row["hidden"]) and found["verdict"] in verdicts


def _needed(row: Mapping[str, Any], kind: str) -> int:
    last = len(row[kind]) - 1
    return last if _exact(row, row[kind][last]) else QUESTIONS + 1


def main() -> None:
    parser = argparse.ArgumentParser(prog="dialogue", description="What up to three questions decide.")
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--seed", type=SEEDS, default=680000)
    for group, count in zip(GROUPS, (100, 60, 100), strict=True):
        name = f"--{group}" if group == "empty" else f"--{group}s"
        parser.add_argument(name, type=Limits(0, 1000, whole=True), default=count, help="rigs of this group")
    parser.add_argument("--minutes", type=Limits(0.0, 1e6, unit="min"), default=math.inf)
    parser.add_argument("--jobs", type=CORES, default=1, help="processes")
    parser.add_argument("--questions", nargs="+", choices=KINDS, default=[*KINDS], help="kinds of questions")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    path, end = given.out / "dialogue.json", time.monotonic() + 60.0 * given.minutes
    rows = (
        read_json(path, "the rigs of a run", max_bytes=MAX_BYTES_OF_RESULTS)["rows"] if path.exists() else []
    )
    done = {r["seed"] for r in rows}
    left = [r for r in rigs(given.seed, given.singles, given.pairs, given.empty) if r["seed"] not in done]
    with closing(as_done(left, partial(run_rig, kinds=given.questions), jobs=given.jobs)) as finished:
        for place, row in finished:
            if isinstance(row, Failure):
                raise InputError(f"rig {left[place]['seed']}: {row}")
            rows.append(row)
            write_json(path, {"schema": SCHEMA, "rows": rows})
            print(row["seed"], row["hidden"], " | ".join(_said(row, k) for k in given.questions), flush=True)
            if time.monotonic() > end:
                break
    rows.sort(key=lambda r: r["seed"])
    write_text(given.out / "dialogue.md", table(rows))
    write_text(given.out / "paired.md", paired(rows) + "\n")
    print(table(rows), paired(rows), sep="\n")


def _said(row: Mapping[str, Any], kind: str) -> str:
    last = row[kind][-1]
    return f"{kind} {len(row[kind]) - 1}: {last['names']} {'exact' if _exact(row, last) else ''}"


if __name__ == "__main__":
    run_command(main)

"""What the next experiment is worth: blind rigs whose first logs leave names open, then one proposed and one random experiment.

    python -m docs.evidence.next_experiment --out DIR [--seed N] [--rigs N] [--minutes M] [--jobs N]

Each rig hides one effect that the catalogue declares alike with others, of medium size and on one channel, and has base
parameters up to 15 % off the given model's; noise, sizes and forms as in `blind_trials`. The first log is 6 s of closed-loop
operation, the held-out one 6 s of another mixture. Where the diagnosis leaves several names, a best guess or `unknown`, the
rig plays 12 s of commands and loads twice: those that the diagnosis proposes, and random ones of the same family and limits.
Each log is diagnosed together with the first one, against the same held-out log.

Decided is a rig if the diagnosis confirms the right effect on the right channel, alone, with no name beside it.

Rigs that DIR holds already are not run again, so a run may be interrupted and continued. Writes next_experiment.json and
next_experiment.md.
"""

from __future__ import annotations

import argparse
import itertools
import math
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from agents.command import run_command
from hydro_env.diagnosis import Diagnosis, Settings, diagnose
from hydro_env.diagnosis.experiment_design import SECONDS, commands_csv
from hydro_env.diagnosis.stages.next_experiment import max_load
from hydro_env.experiments.coverage import by_channel
from hydro_env.files import write_json, write_text
from hydro_env.limits import CORES, SEEDS, Limits
from hydro_env.plant import BUILT_IN, CATALOGUE
from hydro_env.practice.generate import PLAYED, make_practice
from hydro_env.reading import read_json

from .blind_trials.cases import BASE_ERROR
from .blind_trials.judging import HELD_OUT_WITHIN, judge
from .blind_trials.running import method
from .blind_trials.tables import markdown
from .naming_methods.designs import random_design

SCHEMA = "hydro_env/next_experiment/1"
#: The logs of a rig: what is known first, and what is held out.
FIRST, HELD_OUT = "fit_2", "sealed"
LOG_SECONDS, RATE = 6.0, 500.0
SECOND = ("proposed", "random")


def run_rig(seed: int, hidden: Sequence[str], jobs: int = 1) -> dict[str, Any]:
    """One rig: its first diagnosis, and those with a proposed and with a random experiment if the first leaves names open."""
    how: dict[str, Any] = {
        "base_error": BASE_ERROR,
        "duration": LOG_SECONDS,
        "rate": RATE,
        "seed": seed,
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_practice(hidden, runs=(FIRST, HELD_OUT), **how).write(folder)
        truth = read_json(folder / "truth.json", "a practice rig")
        begin = time.process_time()
        first = _diagnosed(folder, [], jobs)
        row = {"seed": seed, "hidden": list(hidden), "first": _answer(first, truth), "open": _open(first)}
        proposed, rng = first.next_experiment, np.random.default_rng([seed, 7])
        commands = {
            "proposed": proposed.csv() if proposed is not None else None,
            "random": commands_csv(*random_design(first.rig.model, Settings(), rng, max_load(first))),
        }
        for kind in SECOND if row["open"] else ():
            row[kind] = None
            if commands[kind] is not None:
                write_text(folder / f"{kind}.csv", str(commands[kind]))
                make_practice(hidden, play=folder / f"{kind}.csv", **how).write(folder / kind)
                row[kind] = _answer(_diagnosed(folder, [folder / kind / f"{PLAYED}.csv"], jobs), truth)
        if proposed is not None:
            row["proposal"] = proposed.as_dict()
    return row | {"cpu_s": round(time.process_time() - begin, 1), "method": method()}


def _diagnosed(folder: Path, more: list[Path], jobs: int) -> Diagnosis:
    fit = [folder / f"{FIRST}.csv", *more]
    return diagnose(fit, [folder / f"{HELD_OUT}.csv"], model=folder / "model.yaml", jobs=jobs)


def _open(found: Diagnosis) -> bool:
    """Whether a diagnosis leaves names open."""
    tied = any(e.indistinguishable_from for e in found.effects)
    return found.verdict == "unknown" or found.best_guess or (found.verdict == "effects" and tied)


def _answer(found: Diagnosis, truth: Mapping[str, Any]) -> dict[str, Any]:
    data = found.as_dict()
    judged = judge(data, by_channel(truth["effects"]), truth["verdict"])
    names = {n for e in data["effects"] for n in (e["name"], *e["indistinguishable_from"])}
    kept = {k: judged[k] for k in ("verdict", "named", "right", "set", "worst")}
    return kept | {
        "best_guess": found.best_guess,
        "names": len(names),
        "decided": judged["right"] and not _open(found),
    }


def decided(rows: Sequence[Mapping[str, Any]], kind: str) -> int:
    """How many of the rigs an experiment decided."""
    return sum(bool(r[kind] and r[kind]["decided"]) for r in rows)


def run(out: Path, seed: int, rigs: int, minutes: float = math.inf, jobs: int = 1) -> list[dict[str, Any]]:
    """Runs rigs until `rigs` of them left names open, or the time is over; returns all rows of the folder."""
    from tqdm import tqdm

    out.mkdir(parents=True, exist_ok=True)
    path = out / "next_experiment.json"
    rows = read_json(path, "the rigs of a run")["rows"] if path.exists() else []
    end = time.monotonic() + 60.0 * minutes
    with tqdm(total=rigs, initial=min(sum(r["open"] for r in rows), rigs), unit="rig") as bar:
        for number, hidden in _drawn(seed):
            if sum(r["open"] for r in rows) >= rigs or time.monotonic() > end:
                break
            if any(r["seed"] == number for r in rows):
                continue
            rows.append(run_rig(number, hidden, jobs))
            bar.update(int(rows[-1]["open"]))
            write_json(path, {"schema": SCHEMA, "rows": rows})
            tqdm.write(_line(rows[-1]), file=sys.stdout)
            sys.stdout.flush()
    write_text(out / "next_experiment.md", table(rows))
    return rows


def _drawn(seed: int) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Seeds and what they hide, without end: in each round every effect that is declared alike with others once, on a drawn
    channel and in a drawn order."""
    names = [n for n in BUILT_IN if CATALOGUE[n].indistinguishable_from and not CATALOGUE[n].family]
    rng = np.random.default_rng([seed, 6])
    numbers = itertools.count(seed)
    while True:
        for n in rng.permutation(len(names)):
            yield next(numbers), (f"{names[n]}:{rng.integers(1, 3)}",)


def _line(row: Mapping[str, Any]) -> str:
    def said(kind: str) -> str:
        answer = row.get(kind)
        if not answer:
            return "-"
        mark = (
            "decided" if answer["decided"] else "right" if answer["right"] else "set" if answer["set"] else ""
        )
        return f"{', '.join(answer['named']) or answer['verdict']} {mark}".strip()

    return f"{row['seed']} {', '.join(row['hidden']):<32}" + " | ".join(said(k) for k in ("first", *SECOND))


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Counts in Markdown, over the rigs whose first logs left names open."""
    own = [r for r in rows if r["open"]]
    head = [
        "logs",
        "decided",
        "right effect named",
        "right, or listed with the named one",
        "names left, mean",
        "held-out error, times the noise, geometric mean",
        "within 1.3",
    ]
    cells = []
    for kind, what in (
        ("first", "first log alone"),
        ("proposed", "and the proposed experiment"),
        ("random", "and a random one"),
    ):
        answers = [r[kind] for r in own if r[kind]]
        names = [a["names"] for a in answers if a["names"]]
        left = np.array([a["worst"] for a in answers])
        cells.append([
            what, f"{decided(own, kind)} of {len(own)}", sum(a["right"] for a in answers), sum(a["set"] for a in answers),
            f"{np.mean(names):.1f}" if names else "-", f"{np.exp(np.mean(np.log(left))):.1f}" if answers else "-",
            int(np.sum(left <= HELD_OUT_WITHIN)),
        ])  # fmt: skip
    return "\n".join(markdown(head, cells)) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="next_experiment", description=f"What {SECONDS:g} s of proposed commands decide."
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the rows")
    parser.add_argument("--seed", type=SEEDS, default=30000)
    parser.add_argument(
        "--rigs", type=Limits(1, 1000, whole=True), default=20, help="rigs that leave names open"
    )
    parser.add_argument("--minutes", type=Limits(0.0, 1e6, unit="min"), default=math.inf)
    parser.add_argument("--jobs", type=CORES, default=1, help="threads of a diagnosis")
    given = parser.parse_args()
    print(table(run(given.out, given.seed, given.rigs, given.minutes, given.jobs)), end="")


if __name__ == "__main__":
    run_command(main)

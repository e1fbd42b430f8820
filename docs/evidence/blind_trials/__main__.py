"""`python -m docs.evidence.blind_trials`, see the package."""

from __future__ import annotations

import argparse
import math
from pathlib import Path

from agents.command import run_command
from hydro_env.limits import CORES, SEEDS, Limits

from .ablation import ablation_table, folder_without, write_ablation
from .cases import EMPTY, GROUPS, Case, cases
from .judging import summary
from .rules import RULES
from .running import Running, practice_logs, rows_of, run_trials
from .tables import publish


def _numbers(text: str) -> range:
    """`7` or `3-7`, the numbers it means."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="blind_trials", description="How often the diagnosis is right.")
    add = parser.add_argument
    add("--out", type=Path, required=True, help="folder of the trials' rows")
    add("--groups", nargs="*", default=["nothing", "parameters", "medium", "two", "unlisted"], choices=GROUPS)
    add("--seed", type=SEEDS, default=20000)
    add("--minutes", type=Limits(0.0, 1e6, unit="min"), default=math.inf)
    add("--jobs", type=CORES, default=1, help="threads of a diagnosis")
    add("--slice", default="1/1", help="K/N: every N-th trial from the K-th")
    add(
        "--empty",
        type=Limits(0, 100_000, whole=True),
        default=EMPTY,
        help="trials of each group that hides nothing",
    )
    add("--only", type=_numbers, nargs="*", help="seeds of the trials to be run, or FIRST-LAST")
    add("--logs", type=Path, help="folder in which practice logs are kept")
    add("--make", action="store_true", help="only makes the logs, in --logs")
    add(
        "--without-rule",
        nargs="+",
        default=[],
        metavar="NAME",
        choices=RULES,
        help="rules of the diagnosis to switch off",
    )
    add(
        "--constant",
        nargs="+",
        default=[],
        metavar="MODULE.NAME=VALUE",
        help="constants of the diagnosis to change",
    )
    add(
        "--ablation",
        action="store_true",
        help="compares all trials without a rule with those with it; runs nothing",
    )
    add("--write", type=Path, help="folder that trials.json is published to; runs nothing")
    given = parser.parse_args()
    if given.make and given.logs is None:
        parser.error("--make needs --logs FOLDER")
    return given


def _wanted(given: argparse.Namespace) -> list[Case]:
    part, of = map(int, given.slice.split("/"))
    wanted = cases(given.groups, given.seed, given.empty)[part - 1 :: of]
    if given.only is not None:
        wanted = [c for c in wanted if any(c.seed in seeds for seeds in given.only)]
    return wanted


def main() -> None:
    given = _arguments()
    if given.write is not None:
        publish(rows_of(given.out), given.write)
    elif given.ablation:
        print(ablation_table(write_ablation(given.out)), end="")
    elif given.make:
        for case in _wanted(given):
            practice_logs(case, given.logs / f"{case.group}_{case.seed}")
    else:
        part, of = given.slice.split("/")
        rows = run_trials(
            folder_without(given.out, [*given.without_rule, *given.constant]), _wanted(given),
            Running(jobs=given.jobs, logs=given.logs, rules_off=tuple(given.without_rule), constants=tuple(given.constant)),
            minutes=given.minutes,
            name="trials.json" if of == "1" else f"trials_{part}_of_{of}.json", say=lambda text: print(text, flush=True),
        )  # fmt: skip
        for s in summary(rows):
            if s["trials"]:
                print(f"{s['what']:<80}{s['count']:4} of {s['trials']}")


if __name__ == "__main__":
    run_command(main)

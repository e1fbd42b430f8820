"""Trains one policy for each of several seeds: `python -m agents.sweep --config configs/ppo.yml --seeds 0 1 2 --out DIR`.

With `--jobs N` in processes of this machine, with `--engine ray` on a Ray cluster; the policies are the same. One seed
says little of a training file: what another seed gives may differ by more than what a setting changes.

DIR receives `seed_0/` and so on, each a run of agents.train, and `sweep.json`: the scores of every seed's best policy on
pairs of `val` that took no part in choosing it, and over the seeds their interquartile mean with its 95 % interval
(bootstrap over seeds). The same command again goes on with what is not finished; a seed whose process dies goes on from
its last checkpoint. On a cluster without a disk that all nodes see, it is restarted, and only the policy, its curve and
its scores come back.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.command import run_command
from hydro_env.benchmark.statistics import bootstrap_interval, iqm
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.files import write_bytes, write_json
from hydro_env.limits import CORES, SEEDS, Limits
from hydro_env.parallel import ENGINES, Failure, check_engine, run
from hydro_env.training.config import Config, read_config
from hydro_env.training.evaluate import METRICS, scored_pairs
from hydro_env.training.train import make_model, train

SCHEMA = "hydro_env/sweep/1"


def sweep(
    config: Config,
    seeds: Sequence[int],
    out: Path,
    *,
    engine: str = "local",
    jobs: int = 1,
    pairs: int = 64,
    command: str = "",
    progress: bool = True,
) -> dict[str, Any]:
    """Trains every seed, writes `out/sweep.json` and returns what it holds.

    Args:
        config: the training file; its own seed has no say.
        seeds: different numbers of at least 0.
        engine, jobs: see `hydro_env.parallel`.
        pairs: how many pairs of `val` a finished policy drives in each of the file's `evaluate_scenarios`. They follow
            those that chose the policy.

    InputError for bad input; also if `out` holds runs of another training file.
    """
    check_engine(engine, jobs)
    if pairs < 1:
        raise InputError(f"pairs must be at least 1, not {pairs}")
    out = out.absolute()
    _prepare(config, seeds, out)
    work = partial(_train_seed, config=config, out=out, pairs=pairs, command=command)
    results = run(list(seeds), work, engine=engine, jobs=jobs, progress=progress, unit="seed")
    finished = []
    for seed, result in zip(seeds, results, strict=True):
        if not isinstance(result, Failure):
            _bring_home(out / f"seed_{seed}", config, result.pop("files"))
            finished.append(result)
    summary: dict[str, Any] = {
        "schema": SCHEMA,
        "config": config.path.name,
        "text": config.text,
        "split": "val",
        "pairs": [config.training.evaluate_pairs, config.training.evaluate_pairs + pairs],
        "seeds": finished,
        "failed": [
            {"seed": seed, "reason": result.reason}
            for seed, result in zip(seeds, results, strict=True)
            if isinstance(result, Failure)
        ],
        "rows": _rows(finished, config.training.evaluate_scenarios),
    }
    write_json(out / "sweep.json", summary)
    return summary


def _prepare(config: Config, seeds: Sequence[int], out: Path) -> None:
    """Refuses what cannot be trained, makes the folder of the sweep."""
    if len(set(seeds)) < len(seeds) or not seeds or min(seeds) < 0:
        raise InputError(f"seeds {' '.join(map(str, seeds))}: expected different numbers of at least 0")
    make_model(config)  # a mistake in the file is no failure of a seed
    for seed in seeds:
        begun = out / f"seed_{seed}" / "config.yml"
        if begun.is_file() and begun.read_text(encoding="utf-8") != config.text:
            raise InputError(
                f"{config.path}: differs from {begun}, with which the sweep was started; name another folder"
            )
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise InputError(f"--out {out}: cannot write there ({problem.strerror or problem})") from None


def _train_seed(seed: int, *, config: Config, out: Path, pairs: int, command: str) -> dict[str, Any]:
    """Trains a seed, or what is left of it, and scores its policy; this is what runs on an engine."""
    own = dataclasses.replace(config, training=config.training.model_copy(update={"seed": seed}))
    folder = out / f"seed_{seed}"
    progress = train(own, folder, resume=(folder / "config.yml").is_file(), command=command, bar=False)
    best = min(progress["curve"], key=lambda row: row["score"])
    kwargs = scored_pairs(config.env_kwargs)
    first = config.training.evaluate_pairs
    scores = {}
    for scenario in config.training.evaluate_scenarios:
        policy = NumpyPolicy(folder / "policy.npz")
        episodes = roll_out(policy, range(first, first + pairs), scenario=scenario, **kwargs)
        scores[scenario] = {name: float(iqm(values)) for name, values in episodes.metrics(METRICS).items()}
        scores[scenario]["mean_return"] = float(np.mean(episodes.returns))
    files = {name: (folder / name).read_bytes() for name in ("policy.npz", "curve.json")}
    return {
        "seed": seed,
        "steps": progress["steps"],
        "best_at": best["steps"],
        "scores": scores,
        "files": files,
    }


def _bring_home(folder: Path, config: Config, files: dict[str, bytes]) -> None:
    """Writes what was made on a node that does not see our disk."""
    if not (folder / "policy.npz").is_file():
        folder.mkdir(exist_ok=True)
        for name, content in {**files, "config.yml": config.text.encode()}.items():
            write_bytes(folder / name, content)


def _rows(finished: list[dict[str, Any]], scenarios: Sequence[str]) -> list[dict[str, Any]]:
    """Interquartile mean over the seeds of every metric in every scenario."""
    rows = []
    for scenario in scenarios if finished else ():
        for metric in (*METRICS, "mean_return"):
            values = np.array([each["scores"][scenario][metric] for each in finished])
            where = {"scenario": scenario, "metric": metric, "n": len(values)}
            rows.append({**where, "iqm": float(iqm(values)), "ci95": list(bootstrap_interval(values))})
    return rows


def report(summary: dict[str, Any]) -> str:
    """What the command prints."""
    lines = []
    for row in summary["rows"]:
        low, high = row["ci95"]
        lines.append(
            f"{row['scenario']:16} {row['metric']:26} {row['iqm']:8.3g} [{low:.3g}, {high:.3g}] over {row['n']} seeds"
        )
    return "\n".join(lines + [f"seed {each['seed']} failed: {each['reason']}" for each in summary["failed"]])


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m agents.sweep",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--config", type=Path, required=True, help="training file, see configs/")
    parser.add_argument("--seeds", type=SEEDS, nargs="+", required=True, help="one policy for each")
    parser.add_argument("--out", type=Path, required=True, help="folder of the sweep")
    parser.add_argument("--engine", default="local", help=f"one of {', '.join(ENGINES)}")
    parser.add_argument("--jobs", type=CORES, default=1, help="processes of engine local")
    parser.add_argument(
        "--pairs",
        type=Limits(1, 1000, whole=True),
        default=64,
        help="pairs of val that score a finished policy",
    )
    parser.add_argument("--quiet", action="store_true", help="no progress bar")
    arguments = parser.parse_args()
    command = " ".join(["python -m agents.sweep", *sys.argv[1:]])

    def work() -> None:
        summary = sweep(
            read_config(arguments.config),
            arguments.seeds,
            arguments.out,
            engine=arguments.engine,
            jobs=arguments.jobs,
            pairs=arguments.pairs,
            command=command,
            progress=not arguments.quiet,
        )
        print(report(summary))
        print(arguments.out / "sweep.json")
        if summary["failed"]:
            raise SystemExit(1)

    run_command(work)


if __name__ == "__main__":
    # As the module that other processes import, not as the nameless one that was started.
    from agents import sweep as module

    module.main()

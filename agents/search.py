"""Looks for better settings with Optuna: `python -m agents.search --config configs/ppo.yml --out runs/search`.

Each trial is a shortened training run in a folder of its own, `OUT/trial_0007`, whose `config.yml` is an ordinary training
file with the tried values filled in; what it is judged by is the best score on `val` (see
`hydro_env.training.config.Training`). Trials that fall behind the median of the others are stopped early. The study lies in
`OUT/study.db` (SQLite): a search that was stopped goes on where it was, several processes may share one, and
`optuna-dashboard sqlite:///OUT/study.db` shows it.
"""

from __future__ import annotations

import argparse
import copy
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from agents.command import run_command
from hydro_env.errors import InputError, to_install
from hydro_env.limits import SEEDS, Limits
from hydro_env.reading import read_yaml
from hydro_env.training.config import ENV_ID, read_config
from hydro_env.training.train import train

if TYPE_CHECKING:
    import optuna


def suggest(trial: optuna.Trial, data: dict[str, Any]) -> dict[str, Any]:
    """A training file's content with values of a trial filled in."""
    data = copy.deepcopy(data)
    table, training = data[ENV_ID], data["training"]
    rate = trial.suggest_float("learning_rate", 1e-4, 3e-3, log=True)
    table["learning_rate"] = f"lin_{rate:.3g}"
    table["gamma"] = 1.0 - trial.suggest_float("one_minus_gamma", 0.01, 0.1, log=True)
    reward = table["env_kwargs"].setdefault("reward", {})
    reward["tracking"] = trial.suggest_float("reward_tracking", 0.1, 1.0, log=True)
    reward["difference"] = trial.suggest_float("reward_difference", 1.0, 10.0, log=True)
    if training["algorithm"] == "ppo":
        table["gae_lambda"] = trial.suggest_float("gae_lambda", 0.8, 0.98)
        table["n_epochs"] = trial.suggest_int("n_epochs", 3, 12)
        table["clip_range"] = trial.suggest_float("clip_range", 0.1, 0.3)
    else:
        table["tau"] = trial.suggest_float("tau", 0.002, 0.05, log=True)
        table["gradient_steps"] = trial.suggest_int("gradient_steps", 1, 4)
    return data


def search(config: Path, out: Path, *, trials: int, steps: int, seed: int = 0) -> optuna.Study:
    """Runs `trials` more trials of `steps` control periods each; returns the study with all there are."""
    read_config(config)  # what is wrong with the file is better said at once
    try:
        import optuna
    except ImportError:
        raise InputError(f"the search needs Optuna: {to_install('search')}") from None
    data = read_yaml(config, "a training file in YAML")
    data[ENV_ID]["n_timesteps"] = steps
    data["training"]["evaluate_every"] = max(1, steps // 8)
    data["training"]["checkpoint_every"] = steps
    out.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        study_name=config.stem,
        storage=f"sqlite:///{out / 'study.db'}",
        load_if_exists=True,
        direction="minimize",
        sampler=optuna.samplers.TPESampler(seed=seed + 1000 * len(list(out.glob("trial_*")))),
        pruner=optuna.pruners.MedianPruner(n_startup_trials=4, n_warmup_steps=steps // 3),
    )

    def objective(trial: optuna.Trial) -> float:
        folder = out / f"trial_{trial.number:04d}"
        folder.mkdir(exist_ok=True)
        tried = folder / "tried.yml"
        tried.write_text(yaml.safe_dump(suggest(trial, data), sort_keys=False), encoding="utf-8")

        def report(step: int, score: float) -> None:
            trial.report(score, step)
            if trial.should_prune():
                raise optuna.TrialPruned

        progress = train(read_config(tried), folder, bar=False, report=report)
        return float(progress["best"])

    study.optimize(objective, n_trials=trials)
    return study


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.search", description=__doc__)
    parser.add_argument("--config", type=Path, required=True, help="training file to start from")
    parser.add_argument("--out", type=Path, required=True, help="folder of the study and its runs")
    parser.add_argument("--trials", type=Limits(1, 100_000, whole=True), default=20, help="trials to add")
    parser.add_argument(
        "--steps", type=Limits(1, 10**12, whole=True), default=300_000, help="control periods of a trial"
    )
    parser.add_argument("--seed", type=SEEDS, default=0, help="of the sampler")
    chosen = parser.parse_args()

    def run() -> None:
        study = search(chosen.config, chosen.out, trials=chosen.trials, steps=chosen.steps, seed=chosen.seed)
        print(
            f"best of {len(study.trials)} trials: {study.best_value:.2f}, {chosen.out}/trial_{study.best_trial.number:04d}"
        )
        for key, value in study.best_params.items():
            print(f"  {key} {value:.4g}")

    run_command(run)


if __name__ == "__main__":
    main()

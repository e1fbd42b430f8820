"""Scores of a policy during training, in rpm, and its return; never on pairs of a test split unless it is trained on them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import trim_mean

from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.learned.policy_interface import Policy
from hydro_env.controllers.rollout import roll_out

#: Where policies that are trained on these splits are scored.
VALIDATION = {"train": "val", "train_any": "val_any"}
METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm", "command_variation")


def scored_pairs(env_kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Plant, control period and mismatch on which a policy trained with these arguments is scored: pairs of `val` for those
    of `train`, rigs of `val_any` for those of `train_any`, otherwise the mismatch it is trained on (the plant's own pair, with
    other noise, if that is `null`)."""
    kwargs = {key: env_kwargs[key] for key in ("plant", "control_period") if key in env_kwargs}
    mismatch = env_kwargs.get("mismatch", "train")
    scored = VALIDATION.get(mismatch, mismatch) if isinstance(mismatch, str) else mismatch
    return kwargs | {"mismatch": scored}


def evaluate(
    policy: str | Path | Policy, pairs: int, env_kwargs: dict[str, Any], scenario: str = "setpoint_steps"
) -> dict[str, float]:
    """Interquartile means over the first `pairs` pairs of `scored_pairs` in a scenario, the 95th percentile of the largest
    speed difference, and the mean return with the environment's default weights. `policy`: a policy file, or what it holds."""
    driver = policy if isinstance(policy, Policy) else NumpyPolicy(policy)
    episodes = roll_out(driver, range(pairs), scenario=scenario, **scored_pairs(env_kwargs))
    metrics = episodes.metrics(METRICS)
    scores = {name: float(trim_mean(metrics[name], 0.25)) for name in METRICS}
    scores["max_speed_difference_rpm_p95"] = float(np.percentile(metrics["max_speed_difference_rpm"], 95))
    scores["mean_return"] = float(np.mean(episodes.returns))
    return scores

"""Scores of a policy during training, on the split `val` alone and in rpm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import trim_mean

from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.rollout import roll_out

__all__ = ["METRICS", "evaluate"]

METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm", "command_variation")


def evaluate(
    policy: str | Path,
    pairs: int,
    env_kwargs: dict[str, Any],
    scenario: str = "setpoint_steps",
) -> dict[str, float]:
    """Interquartile means over the first `pairs` pairs of `val` in a scenario, and the 95th percentile of the largest
    speed difference. A policy that is trained on the plant's own pair (`mismatch: null`) is scored on that one, `pairs`
    times with other noise."""
    kwargs = {key: env_kwargs[key] for key in ("plant", "control_period") if key in env_kwargs}
    mismatch = None if env_kwargs.get("mismatch", "train") is None else "val"
    episodes = roll_out(NumpyPolicy(policy), range(pairs), mismatch=mismatch, scenario=scenario, **kwargs)
    metrics = episodes.metrics(METRICS)
    scores = {name: float(trim_mean(metrics[name], 0.25)) for name in METRICS}
    scores["max_speed_difference_rpm_p95"] = float(np.percentile(metrics["max_speed_difference_rpm"], 95))
    return scores

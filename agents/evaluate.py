"""Scores of a policy during training, on the split `val` alone and in rpm."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import trim_mean

from hydro_env.controllers.policy import NumpyPolicy
from hydro_env.controllers.rollout import roll_out
from hydro_env.controllers.view import make_view

__all__ = ["METRICS", "LawAlone", "evaluate"]

METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm", "command_variation")


class LawAlone:
    """The control law of a view without a network: all outputs are zero. What a training has to beat."""

    def __init__(self, view: dict[str, Any] | None = None) -> None:
        self.name, self.view = "law alone", make_view(view or {"kind": "flow"})

    def reset(self, num_rigs: int, control_period: float) -> None:
        self._period, self._fresh = control_period, True
        self._outputs = np.zeros((num_rigs * self.view.rows_per_rig, self.view.num_actions))

    def act(self, observation: NDArray[np.floating[Any]]) -> NDArray[np.floating[Any]]:
        if self._fresh:
            self.view.start(observation, self._period)
            self._fresh = False
        else:
            self.view.see(observation)
        return self.view.command(self._outputs)


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

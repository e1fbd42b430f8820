"""The rigs that a policy is trained on, as a Stable-Baselines3 environment that a checkpoint can hold."""

from __future__ import annotations

import inspect
from collections.abc import Sequence
from typing import Any

from stable_baselines3.common.vec_env import VecMonitor

__all__ = ["SEED_SPACING", "TrainingRigs"]

#: Between the first rigs of the runs of two successive seeds: more than the rigs of any run.
SEED_SPACING = 2**40


class TrainingRigs(VecMonitor):
    """Reports the returns of episodes, and can be pickled."""

    def __getstate__(self) -> dict[str, Any]:
        """All but the table of class members that the base class keeps, which cannot be pickled."""
        return {key: value for key, value in self.__dict__.items() if key != "class_attributes"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state, class_attributes=dict(inspect.getmembers(type(self))))

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seeds the rigs so that runs of different seeds share no episode, however many rigs they have."""
        return list(self.venv.seed(None if seed is None else seed * SEED_SPACING))

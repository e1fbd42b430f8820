"""Inputs that drop out: their last good values for a while, then no command.

A value that is not finite counts as absent. Its last good value stands in for `HOLD` seconds; then, and before there was a good
value at all, the commands are zero, the controller is not called, so that it keeps its state, and `fault` is set until all inputs
are there again. `hydro_env.export` writes the same rule in C and Structured Text.
"""

from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: How long the last good value of an input stands in for it, s.
HOLD = 0.05
#: What is greater is as good as infinite: a value that says "absent" where a language has no NaN.
MAX_VALUE = 1e300


def held_samples(period: float) -> int:
    """How many samples in a row, `period` s apart, an input may be absent."""
    return int(HOLD / period + 1e-9)


class InputGuard:
    """Watches the observations (N, n) of N rigs. `fault` (N,): whose commands are zero because an input is absent."""

    def __init__(self, num_rigs: int, period: float) -> None:
        self.fault: NDArray[np.bool_] = np.zeros(num_rigs, bool)
        self._most = held_samples(period)
        self._good: NDArray[Any] | None = None
        self._missed: NDArray[np.int64] | None = None

    def seen(self, observation: NDArray[Any]) -> NDArray[Any]:
        """The observation with the last good value of what is absent. ValueError for one of another number of rigs."""
        if observation.ndim != 2 or len(observation) != len(self.fault):
            raise ValueError(f"reset for {len(self.fault)} rigs, got observations {observation.shape}")
        if self._good is None or self._missed is None or self._good.shape != observation.shape:
            self._good = np.zeros_like(observation)
            self._missed = np.full(observation.shape, self._most + 1)
        there = np.abs(observation, dtype=float) <= MAX_VALUE
        self._missed = np.where(there, 0, np.minimum(self._missed, self._most) + 1)
        self._good = np.where(there, observation, self._good)
        self.fault = np.any(self._missed > self._most, axis=1)
        return self._good


Act = Callable[[Any, NDArray[Any]], NDArray[Any]]


def guarded(act: Act) -> Act:
    """The method `act` behind the `guard` that the controller made in `reset`. In a batch some of whose rigs have all inputs, the
    state of the others follows their last good values."""

    @wraps(act)
    def safe(self: Any, observation: NDArray[Any]) -> NDArray[Any]:
        seen = self.guard.seen(np.asarray(observation))
        fault = self.guard.fault
        if fault.size and fault.all():
            return np.zeros((fault.size, 2))
        command = act(self, seen)
        return np.where(fault[:, None], 0.0, command) if fault.any() else command

    return safe

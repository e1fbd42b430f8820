"""A control period of all rows of a batch: commands to the plant; sensors, reward and true signals from it."""

import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from ..arrays import AnyArray, Bools, Floats, Integers, Singles
from ..plant import Plant
from .profiles import Profiles
from .step_kernels import SIGNALS, STATE, TRUE, apply, observe, take_inputs, wind

#: observation (N, n) float32, true signals (N, TRUE), reward (N,), terminated (N,), truncated (N,)
Result = tuple[Singles, Floats, Floats, Bools, Bools]


class Rollout:
    """The rigs of a batch with the `STATE` of their episodes.

    `deviation` (N, 6) is that of the sensors' noise, scaled like the observation, of `width` numbers; `sensing` (14,) as for
    `observe`.
    """

    def __init__(self, plant: Plant, period: float, width: int, sensing: Floats, threads: int) -> None:
        self.period, self.width, self.threads = period, width, threads
        self.deviation, self.sensing = np.zeros((plant.num_rigs, 6)), sensing
        self.rows = np.arange(plant.num_rigs)
        self.state: AnyArray = np.zeros(plant.num_rigs, STATE)
        self.profiles = Profiles(plant.num_rigs)
        self._command, self._load = np.zeros((2, plant.num_rigs, 2))
        self.take(plant)

    def take(self, plant: Plant) -> None:
        """Drives this plant from now on."""
        self.plant = plant
        self.state["rated"] = plant.get("u_rated")
        self._where = np.array([plant.row_of(name) for name in SIGNALS], np.int64)
        # In float32 the angles are summed up here, unless an effect goes by them.
        self._winds = plant.memory.dtype == np.float32 and not plant.angle_acts
        # The ranges of rows that threads step, whole blocks of the plant; none where one thread steps them all.
        block = plant.memory.shape[2] // 2
        edges = [len(plant.memory) * k // self.threads * block for k in range(self.threads)]
        parts = [slice(*edge) for edge in pairwise([*edges, plant.num_rigs]) if edge[0] < edge[1]]
        self._parts = parts if len(parts) > 1 else []
        self._pool: tuple[int, ThreadPoolExecutor] | None = None
        plant.make_room(self.period)  # once for all threads

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pool": None}  # a copy has threads of its own

    @property
    def angle(self) -> Floats:
        """Shaft angles since the reset, (N, 2), rad."""
        return self.state["turned"] if self._winds else self.plant.get("angle")

    def step(self, actions: Floats) -> Result:
        """A control period with actions (N, 2). ValueError if one is not finite."""
        if not apply(actions, self.state, self._command, self._load):
            raise ValueError("an action is not finite")
        result = self.outputs()
        if self._parts:
            if self._pool is None or self._pool[0] != os.getpid():  # threads do not survive a fork
                self._pool = os.getpid(), ThreadPoolExecutor(self.threads, "hydro_env")
            list(self._pool[1].map(partial(self._step_part, result), self._parts))
            self.plant.turn(1)
        else:
            self.plant.hold(self._command, self._load, self.period)
            self.sense(self.rows, result)
        return result

    def _step_part(self, result: Result, part: slice) -> None:
        """Plant and sensors of a range of rows over a period, in a thread."""
        self.plant.hold_rigs(part, self._command, self._load, self.period)
        self.sense(self.rows[part], result)

    def outputs(self) -> Result:
        """Room for a result."""
        n = self.rows.size
        ended = np.zeros((2, n), np.bool_)
        return np.empty((n, self.width), np.float32), np.zeros((n, TRUE)), np.zeros(n), ended[0], ended[1]

    def sense(self, rows: Integers, result: Result) -> None:
        """Fills the result of some rows at their present step; of observations the newest frame."""
        take_inputs(rows, self.state, self.profiles.starts, self.profiles.levels, self.deviation)
        observe(rows, self.state, self.plant.memory, self._where, self.sensing, *result)
        if self._winds:
            wind(rows, self.state, self.plant.memory, self._where[SIGNALS.index("angle")], result[1])

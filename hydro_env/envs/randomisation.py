"""Which episode every row plays, and what is drawn for it: the pair of valves, faults of its sensors, the streams of the rest."""

from collections.abc import Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arrays import AnyArray, Floats, Integers
from ..errors import InputError, shown
from ..limits import Limits
from ..plant import PlantModel
from ..streams import Component, Streams
from ..tasks.mismatch import SENSOR_PARAMETERS, Mismatch, own_values
from .step_kernels import NEVER

SEED = Limits(0, 2**128 - 1, whole=True)


class Episodes(NamedTuple):
    """Episodes that the rows `rows` (n,) play next: each of a seed its number, and its case, -1 for none."""

    rows: Integers
    seeds: list[int]
    numbers: list[int]
    cases: list[int]

    def streams(self, component: Component, part: slice = slice(None)) -> Streams:
        """The streams of a component, of all or a part of them."""
        return Streams(component, self.seeds[part], self.numbers[part])


class Randomisation:
    """Of N rows `episode` (its number, -1 before the first), `case` (-1 for none) and `fault` ("" for none)."""

    def __init__(self, num_rows: int, model: PlantModel) -> None:
        self.model = model
        self.episode, self.case = np.full((2, num_rows), -1)
        self.fault = np.full(num_rows, "", object)
        self._seeds: list[int] = []
        #: Parameters that a mismatch has set so far, with the values where none sets them.
        self._own: dict[str, tuple[float, float]] = {}
        self._sensor = {name: np.full((num_rows, 2), p.nominal) for name, p in SENSOR_PARAMETERS.items()}

    def next(
        self, rows: Integers, mismatch: Mismatch | None, seed: int | Sequence[int | None] | None = None, case: Any = None,
    ) -> Episodes:  # fmt: skip
        """What these rows play next: the first episode of their seeds where these are given, else the one after the last.

        InputError for a wrong seed, and for a case that is asked for and not there; nothing is changed then.
        """
        n = self.episode.size
        if isinstance(seed, (Sequence, np.ndarray)) and not isinstance(seed, (str, bytes)):
            given = list(seed)
        else:
            given = [None if seed is None else SEED.check(seed, "reset: seed") + i for i in range(n)]
        if len(given) != n:
            raise InputError(f"reset: {len(given)} seeds for {n} environments")
        given = [None if each is None else SEED.check(each, "reset: a seed") for each in given]
        if not self._seeds:
            base = int(np.random.SeedSequence().generate_state(1, np.uint64)[0]) >> 1
            self._seeds = [base + i for i in range(n)]
        own = [old if new is None else new for old, new in zip(self._seeds, given, strict=True)]
        seeds = [own[i] for i in rows.tolist()]
        numbers = [int(self.episode[i]) + 1 if given[i] is None else 0 for i in rows.tolist()]
        return Episodes(rows, seeds, numbers, _cases(rows, mismatch, seeds, numbers, case))

    def draw(self, episodes: Episodes, mismatch: Mismatch | None) -> dict[str, ArrayLike]:
        """Begins these episodes. Returns parameters for the plant, each broadcasts to (n, 2); faults of sensors stay here."""
        rows = episodes.rows
        for row, seed in zip(rows.tolist(), episodes.seeds, strict=True):
            self._seeds[row] = seed
        self.episode[rows], self.case[rows], self.fault[rows] = episodes.numbers, episodes.cases, ""
        drawn: dict[str, Floats] = {}
        if mismatch is not None:
            pairs = mismatch.draw(episodes.seeds, episodes.numbers, episodes.cases, self.model)
            drawn, self.fault[rows] = pairs.values, pairs.fault
            self._own |= {name: own_values(name, self.model) for name in drawn if name not in self._own}
        values: dict[str, ArrayLike] = {name: drawn.get(name, own) for name, own in self._own.items()}
        for name in self._sensor.keys() & values.keys():
            self._sensor[name][rows] = values.pop(name)
        return values

    def start(self, state: AnyArray, episodes: Episodes, period: float) -> None:
        """Puts into the `STATE` of all rows what these episodes have of noise and faults of sensors."""
        rows = episodes.rows
        noise = episodes.streams(Component.NOISE)
        state["noise_key"][rows], state["noise_counter"][rows] = noise.keys, noise.counters
        state["noise_factor"][rows] = self._sensor["speed_sensor.noise_factor"][rows]
        stuck = self._sensor["speed_sensor.stuck_from"][rows]
        # At the earliest from the first reading on, which it then holds.
        first = np.maximum(1, np.ceil(np.where(stuck < inf, stuck, 0.0) / period - 1e-9))
        state["stuck_from"][rows] = np.where(stuck < inf, first.astype(np.int64), NEVER)

    def noise(self, episodes: Episodes, levels: Floats) -> Floats:
        """Levels of the noise, (6,) or (n, 6), between two, (2, 6); speeds, currents and pressures have a share each."""
        low, high = levels
        if (low == high).all():
            return low
        share = episodes.streams(Component.LEVEL).random(3).repeat(2, axis=1)
        return np.asarray(low + share * (high - low))

    def value(self, name: str, plant: Any) -> Floats:
        """Values (N, 2) of a parameter in which the valves may differ, as they now are."""
        return np.asarray(self._sensor[name].copy() if name in self._sensor else plant.get(name))

    def pairs(self, plant: Any) -> dict[str, Floats]:
        """The values of all of these."""
        return {name: self.value(name, plant) for name in self._own or self.model.values}


def _cases(
    rows: Integers, mismatch: Mismatch | None, seeds: list[int], numbers: list[int], asked: Any
) -> list[int]:
    """Numbers of the cases these rows meet, -1 for none. InputError for one that is asked for and not there."""
    if mismatch is None or mismatch.cases is None:
        if asked is not None:
            raise InputError("reset: option case needs a mismatch with a fixed list of cases, such as val")
        return [-1] * rows.size
    if asked is None:
        return [mismatch.case(seed, number) for seed, number in zip(seeds, numbers, strict=True)]
    try:
        cases = [int(asked) + i if np.ndim(asked) == 0 else int(asked[i]) for i in rows.tolist()]
    except (TypeError, ValueError, IndexError, OverflowError):
        raise InputError(f"reset: option case is {shown(asked)}, expected a number, or one a row") from None
    if not all(0 <= each < mismatch.cases for each in cases):
        raise InputError(f"reset: option case: cases of {mismatch.name!r} are 0 ... {mismatch.cases - 1}")
    return cases

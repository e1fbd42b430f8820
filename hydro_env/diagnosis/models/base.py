"""What the workflow needs to know of a machine: its channels, unknowns and candidates, and its simulated measurements.

Two machines exist: `motor.MotorRig`, the dynamic plant, and `steady_valve.SteadyValve`, the reduced model for axes of
which only command and speed (and perhaps pressure) are known. Everything after this file works on either.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from ...plant import Parameter, PlantModel
from ...units import BAR, LPM, MILLIMETRE, RPM
from ..input.parts import Part

__all__ = ["BLOCK_S", "Machine", "Request", "UNITS", "Segment", "measured_segments"]

#: Rows of one log and signal that a fit looks at, at most; the proof looks at all of them.
MAX_ROWS = 6000
#: Length of the blocks that have a variance of their own, s.
BLOCK_S = 0.1
#: Signals that a machine may predict, with the unit they are shown in and its size in SI.
UNITS = {
    "speed": ("rpm", RPM),
    "current": ("A", 1.0),
    "pressure": ("bar", BAR),
    "spool": ("mm", MILLIMETRE),
    "flow": ("lpm", LPM),
}


@dataclass(frozen=True)
class Request:
    """One simulation that is wanted: parameter values of `channel` (0, 1), or of the whole rig (None: pairs)."""

    channel: int | None
    values: Mapping[str, float | tuple[float, float]]

    @property
    def effects(self) -> frozenset[str]:
        return frozenset(name.split(".", 1)[0] for name in self.values if "." in name)


@dataclass
class Segment:
    """One signal of one channel in one log: the measured samples (n,), and which rows of the simulation they are."""

    log: int
    channel: int
    signal: str
    measured: np.ndarray
    rows: np.ndarray
    inside: np.ndarray
    period: float
    place: slice = field(default_factory=lambda: slice(0, 0))

    @cached_property
    def used(self) -> np.ndarray:
        """Which rows count (n,)."""
        return self.inside & np.isfinite(self.measured)

    @cached_property
    def filled(self) -> np.ndarray:
        """The measured samples (n,), 0 where there is none."""
        return np.nan_to_num(self.measured)

    @cached_property
    def blocks(self) -> tuple[np.ndarray, np.ndarray]:
        """The first row of every block (b,), and how many rows of it count (b,)."""
        first = np.arange(0, self.rows.size, max(10, round(BLOCK_S / self.period)))
        return first, np.add.reduceat(self.used.astype(float), first)

    def error(self, simulated: np.ndarray) -> np.ndarray:
        """Measured less simulated (n,), 0 where a row does not count."""
        return np.where(self.used, self.filled - simulated[self.place], 0.0)


class Machine(Protocol):
    """A model of the rig with the logs it is fitted to."""

    model: PlantModel
    parts: list[Part]
    channels: tuple[int, ...]
    segments: dict[int, list[Segment]]
    notes: list[str]
    own: dict[str, Parameter]
    quick: bool
    exact: bool

    def base(self, channel: int) -> list[str]:
        """Names of the parameters that calibration may adjust."""

    def candidates(self) -> list[str]:
        """Effects of the catalogue that this machine can have."""

    def given(self, name: str, channel: int) -> float:
        """The value of a parameter in the model as given."""

    def predict(self, requests: Sequence[Request]) -> list[dict[int, np.ndarray]]:
        """For every request, by channel: the simulated samples (n,) in the order of `segments[channel]`."""

    def close(self) -> None:
        """Ends what the machine holds open."""

    def written(self, model: PlantModel) -> PlantModel:
        """The estimated model as it goes to a model file of the plant."""

    def with_parts(self, parts: list[Part], every_row: bool) -> Machine:
        """The same machine on other logs."""


def measured_segments(
    parts: Sequence[Part], channels: Sequence[int], signals: Sequence[str], every_row: bool
) -> dict[int, list[Segment]]:
    """The measurements of every channel as segments that lie one behind the other in a vector."""
    found: dict[int, list[Segment]] = {}
    for channel in channels:
        place, found[channel] = 0, []
        for number, part in enumerate(parts):
            step = 1 if every_row else max(1, -(-len(part.log) // MAX_ROWS))
            rows = np.arange(0, len(part.log), step)
            for signal in signals:
                if not part.log.has(signal, channel):
                    continue
                values = part.log.get(signal)
                assert values is not None
                segment = Segment(
                    number,
                    channel,
                    signal,
                    values[rows, channel],
                    rows,
                    part.inside[rows],
                    part.log.period * step,
                )
                segment.place = slice(place, place + rows.size)
                place += rows.size
                found[channel].append(segment)
    return found

"""What the environment needs of a plant, whether it is ours or a foreign one, and how one is made of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..plant import Plant, PlantModel
from ..plant.plant import Lost

__all__ = ["PlantSource", "PlantLike", "make_plant"]

Floats = NDArray[np.float64]


class PlantLike(Protocol):
    """Rigs that are driven side by side; every member is as `Plant` describes it.

    `lost` may be empty where a plant does not say what it could not follow, and `copy` may raise InputError.
    """

    @property
    def num_rigs(self) -> int: ...
    @property
    def effects(self) -> tuple[str, ...]: ...
    @property
    def memory(self) -> NDArray[Any]: ...
    @property
    def angle_acts(self) -> bool: ...
    @property
    def lost(self) -> Sequence[Lost]: ...
    def row_of(self, name: str) -> int: ...
    def get(self, name: str) -> Floats: ...
    def set_values(self, values: Mapping[str, ArrayLike], rows: NDArray[np.int64]) -> None: ...
    def reset(self, rows: NDArray[np.int64] | None = None) -> None: ...
    def make_room(self, period: float) -> None: ...
    def hold(self, command_V: Floats, load_Nm: Floats, period: float) -> None: ...
    def hold_rigs(self, rigs: slice, command_V: Floats, load_Nm: Floats, period: float) -> None: ...
    def turn(self, rows: int) -> None: ...
    def copy(self) -> Plant: ...


@runtime_checkable
class PlantSource(Protocol):
    """A model of something else that is driven like a rig: it is simulated by code of its own."""

    name: str

    def make_plant(self, num_rigs: int, dtype: Any) -> PlantLike: ...


def make_plant(
    model: PlantModel, num_rigs: int, effects: tuple[str, ...], tolerance: float | None, dtype: Any
) -> PlantLike:
    """Rigs of a model; `effects` and `tolerance` as for `Plant`. InputError for what the plant cannot be."""
    if isinstance(model, PlantSource):
        return model.make_plant(num_rigs, dtype)
    return Plant(model, num_rigs, effects=effects, tolerance=tolerance, dtype=dtype)

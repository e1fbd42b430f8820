"""Which model of the rig logs are fitted with."""

from __future__ import annotations

from collections.abc import Callable

from ...errors import InputError
from ...plant import PlantModel
from ..input.parts import Part
from .base import RigModel
from .dynamic_rig import DynamicRig
from .steady_valve import SteadyValve

__all__ = ["rig_model"]


def rig_model(
    model: PlantModel, parts: list[Part], steady: bool, jobs: int, count: Callable[[int], None],
    without: frozenset[str] = frozenset(),
) -> RigModel:  # fmt: skip
    """The reduced steady-valve model for cylinders, or where `steady` is wanted, else the dynamic plant, on `parts` of logs.

    `jobs` threads simulate, `count` is called with the number of simulations done, `without` are effects that are no candidates.
    InputError for logs of motors and cylinders.
    """
    kinds = {part.log.kinds[c] for part in parts for c in part.log.channels}
    if len(kinds) > 1:
        raise InputError("the mapping mixes motors and cylinders; diagnose one kind at a time")
    if steady or kinds == {"cylinder"}:
        return SteadyValve(model, parts, progress=count, without=without)
    return DynamicRig(model, parts, jobs=jobs, progress=count, without=without)

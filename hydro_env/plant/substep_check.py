"""How finely a model with unusual values has to be stepped, by a short simulation of it.

`stiffness` and the laws of the effects tell from parameters how finely a channel has to be stepped. They were measured on
models that lie far apart, but values far from any real rig can be combined in ways that no such law foresees. So a model is
simulated once where a value of a channel is outside of its plausible range: for a second from rest, under six commands, at
its substep and at half of it, and where the speeds differ at a half and a quarter, and so on. Other commands may meet events
that these do not, such as a spool that just sticks, and there half of a substep has a thirtieth of the error. So the model
gets half of the longest substep that agrees with its half. The parts in which a stiff channel takes every substep are
shortened with it.

An eighth and a sixteenth may differ too. If a millionth of the command moves the speed by more than a ten-thousandth, the
motion separates neighbouring solutions: no simulator foretells it, and it says nothing about the substep. If not, the model is
refused.

What is usual costs nothing: values in their plausible ranges, from which mismatch is drawn, and those of a preset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from math import ceil, pi
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..units import RPM
from .accepted import inside, with_unit
from .catalogue import CATALOGUE, Effect
from .kernel import compile_kernel
from .parameters import PARAMETERS

if TYPE_CHECKING:
    from .model import PlantModel

__all__ = ["GROWTH", "NUDGE", "TOLERANCE_RPM", "TOLERANCE_SHARE", "followed"]

Array = NDArray[np.float64]
#: A speed that is off by less than this (rpm, RMS), or by less than this share of itself, is right.
TOLERANCE_RPM, TOLERANCE_SHARE = 0.1, 1e-4
#: The part of it that the check allows, and how much finer than that the model is stepped; docs/reference/plant.md has what this
#: costs and leaves.
_ALLOWED, _RESERVE = 1 / 64, 2
#: In how many parts the substep is tried, each against twice as many.
_PARTS = (1, 2, 4, 8)
#: Change of the command that shows what a motion makes of small errors, and by how much more it has to change the speed.
NUDGE, GROWTH = 1e-6, 100.0
_PERIOD, _ROWS = 0.01, 100
#: What no limit of the command stands for, V.
_NO_LIMIT = 200.0


def followed(model: PlantModel, presets: Callable[[], Sequence[PlantModel]]) -> PlantModel:
    """The model with a substep that follows it: its own wherever that is so. `presets` are only asked for if need be.

    A substep that no preset has is the user's choice, and taken as it is. InputError, in one line, for a model that is not
    followed by an eighth of the substep either.
    """
    outside = [_outside(model, channel) for channel in (0, 1)]
    if not any(outside) or model.substep not in {preset.substep for preset in presets()}:
        return model
    unusual = [
        [] if any(_has(preset, model, channel, found) for preset in presets()) else list(found.values())
        for channel, found in enumerate(outside)
    ]
    if not any(unusual):
        return model
    values = tuple(sorted(model.values.items()))
    parts, wrong = _parts(values, tuple(CATALOGUE[name] for name in model.declared), model.substep)
    if not wrong:
        return model if parts == model.finer else replace(model, finer=parts)
    channel = next((c for c in wrong if unusual[c]), wrong[0])
    raise InputError(
        f"model {model.name!r}: channel {channel + 1}: no substep down to {model.substep / _PARTS[-1] * 1e6:.3g} us follows"
        f" {', '.join(unusual[channel] or unusual[1 - channel])}; give values nearer to what is usual, or a shorter substep"
    )


def _outside(model: PlantModel, channel: int) -> dict[str, str]:
    """What is outside of its plausible range on a channel, in words by name."""
    found = {}
    for name in model.values:
        effect, _, own = name.rpartition(".")
        p = CATALOGUE[effect].parameter(own) if effect else PARAMETERS[name]
        value = model.value(name, channel)
        if value != p.neutral and not inside(value, (p.low, p.high)):
            found[name] = f"{name} {value:g} (usual {p.low:g} to {with_unit(p.high, p)})"
    return found


def _has(preset: PlantModel, model: PlantModel, channel: int, names: Iterable[str]) -> bool:
    """Whether a preset has all of these values of a channel."""
    return all(preset.value(name, 0) == model.value(name, channel) for name in names)


# --- simulation -------------------------------------------------------------------------------------------------------
@lru_cache(maxsize=1024)
def _parts(
    values: tuple[tuple[str, tuple[float, float]], ...], effects: tuple[Effect, ...], substep: float
) -> tuple[int, tuple[int, ...]]:
    """In how many parts the substep (s) is to be taken, and the channels on which none of `_PARTS` follows."""
    rigs = np.arange(_commands().shape[1])
    enough = np.ones((len(rigs), 2), np.int64)
    now = _speeds(dict(values), effects, substep, 1, rigs)
    for parts in _PARTS:
        then = _speeds(dict(values), effects, substep, 2 * parts, rigs)
        apart = _differ(now, then, _ALLOWED)
        enough[rigs] = np.where(apart, 2 * parts, enough[rigs])
        left = apart.any(axis=1)
        if not left.any():
            break
        unsettled = _differ(now, then, 1.0)[left]
        rigs, now = rigs[left], (then[0][:, left], then[1][left])
    else:
        one, other = (
            _speeds(dict(values), effects, substep, 2, rigs, times)[0] for times in (1.0, 1.0 - NUDGE)
        )
        separates = (_rms(one - other) > GROWTH * NUDGE * _rms(one)).any(axis=0)
        if (wrong := (unsettled & ~separates) | now[1]).any():
            return 0, tuple(np.flatnonzero(wrong.any(axis=0)).tolist())
        enough[rigs] = np.where(unsettled, 1, enough[rigs])
    return min(_RESERVE * int(enough.max()), 2 * _PARTS[-1]), ()


def _differ(
    one: tuple[Array, NDArray[np.bool_]], other: tuple[Array, NDArray[np.bool_]], share: float
) -> NDArray[np.bool_]:
    """Where speeds are apart by more than so much of what is right, or diverged, (rigs, 2)."""
    (a, broken), (b, broken_too) = one, other
    return (_rms(a - b) > share * _bound(b)) | broken | broken_too


def _rms(speed: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(speed**2, axis=0)))


def _bound(speed: Array) -> Array:
    return np.maximum(TOLERANCE_RPM, TOLERANCE_SHARE * _rms(speed))


@cache
def _commands() -> Array:
    """Shares of the rated command, (rows, rigs, 2): two of slow sines, levels for 10 ms, large and small, levels for 50 ms, and
    its two ends."""
    rng = np.random.default_rng(0)
    time = np.arange(_ROWS)[:, None] * _PERIOD
    phase = np.array([0.0, 2.0])

    def sines(large: float, small: float) -> Array:
        """Sines of these frequencies (Hz)."""
        slow, quick = (np.sin(2.0 * pi * f * time + n * phase) for n, f in ((1, large), (2, small)))
        return np.asarray(0.6 * slow + 0.15 * quick)

    def levels(rows: int) -> Array:
        return np.repeat(rng.uniform(-1.0, 1.0, (_ROWS // rows, 2)), rows, axis=0)

    ends = np.where(np.cumsum(rng.random((_ROWS, 2)) < 0.4, axis=0) % 2 == 0, 1.0, -1.0)
    return np.stack([sines(0.8, 3.0), sines(2.0, 7.0), levels(1), 0.3 * levels(1), levels(5), ends], axis=1)


def _speeds(
    values: Mapping[str, tuple[float, float]],
    effects: tuple[Effect, ...],
    substep: float,
    parts: int,
    rigs: NDArray[np.int64],
    times: float = 1.0,
) -> tuple[Array, NDArray[np.bool_]]:
    """Speeds in rpm under so many times some of the commands, with the substep in so many parts, (rows, rigs, 2), and which
    diverged, (rigs, 1). The kernel is the one that a single rig of the model takes."""
    kernel = compile_kernel((e.name for e in effects), 1)
    commands = _commands()[:, rigs]
    memory = np.zeros((len(rigs), kernel.num_rows, 2))
    known = {f"{e.name}.{p.name}": p for e in effects for p in e.parameters}
    for name, p in (PARAMETERS | known).items():
        memory[:, kernel.rows[name]] = values.get(name, p.nominal)
    for effect in effects:
        if (
            effect.delays_command
        ):  # how late a command is does not matter, and it may be later than the run is long
            memory[:, kernel.rows[f"{effect.name}.{effect.delays_command}"]] = 0.0
    rated = np.minimum(memory[:, kernel.rows["u_rated"]], _NO_LIMIT)
    substeps = max(1, ceil(_PERIOD * parts / substep - 1e-9))
    h = _PERIOD / substeps
    out = np.empty((1, *commands.shape))
    kernel.advance(
        memory.reshape(-1),
        kernel.room(),
        np.zeros((len(rigs), 3, 2)) if kernel.has_delay else None,
        0,
        times * commands * rated,
        np.zeros((1, 1, 2)),
        substeps,
        h,
        parts * h,
        np.array([kernel.rows["speed"]]),
        1,
        out,
    )
    diverged = np.asarray((memory[:, kernel.rows["diverged"]] > 0.0).any(axis=1, keepdims=True))
    return out[0] / RPM, diverged

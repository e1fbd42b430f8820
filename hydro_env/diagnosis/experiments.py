"""Which experiment would tell apart what the logs cannot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from .machine import Machine

if TYPE_CHECKING:
    from .result import Named

__all__ = ["MENU", "next_experiment"]

#: Pairs that are often confused, and the experiment under which they differ.
MENU: tuple[tuple[frozenset[str], str], ...] = (
    (
        frozenset({"dead_zone", "spring_preload"}),
        "record the spool position: overlap lets the spool move without flow, a preload does not let it move",
    ),
    (
        frozenset({"magnetic_hysteresis", "spool_stiction"}),
        "triangles of +-60 % of the rated command with 0.5 s and 20 s per cycle, then again with a dither of "
        "5 % at 100 Hz: dither shrinks stiction, not magnetic hysteresis",
    ),
    (
        frozenset({"command_delay", "sensor_lag"}),
        "sine sweep of 1 to 20 Hz about a bias with the pressure recorded: the pressure shows a delay of the "
        "command, not the lag of the speed sensor",
    ),
    (
        frozenset({"load_bias", "motor_coulomb_friction"}),
        "the same slow ramp in both directions of rotation: friction changes its sign, a load does not",
    ),
    (
        frozenset({"line_loss", "quadratic_drag"}),
        "drive the motor from outside with the valve closed and both ports connected: drag acts, line loss "
        "does not; or measure the pressure at the motor's ports",
    ),
    (
        frozenset({"dead_zone", "flow_gain_nonlinearity"}),
        "slow triangles of 20, 40 and 80 % of the rated command: overlap is the same width in all",
    ),
    (
        frozenset({"dead_zone", "null_offset"}),
        "slow triangle through zero with at least 10 s per cycle",
    ),
    (
        frozenset({"supply_droop", "pressure_dependent_flow"}),
        "record the supply pressure; drive the other channel alone while this one holds its command",
    ),
    (
        frozenset({"sensor_gain", "directional_gain"}),
        "count revolutions over a minute at constant speed, both directions",
    ),
)  # fmt: skip


def next_experiment(named: Sequence[Named], machine: Machine) -> dict[str, Any] | None:
    """The experiment that separates the names that stayed tied, or None."""
    for effect in named:
        for rival in effect.indistinguishable_from:
            for pair, text in MENU:
                if pair == {effect.name, rival}:
                    return {"description": text, "separates": sorted(pair)}
    for effect in named:
        if effect.indistinguishable_from:
            missing = [
                s for s in ("current", "pressure", "load") if not any(p.log.has(s) for p in machine.parts)
            ]
            text = (
                f"record {', '.join(missing)} as well"
                if missing
                else "slow triangles of three amplitudes, then steps under load"
            )
            return {"description": text, "separates": [effect.name, *effect.indistinguishable_from]}
    return None

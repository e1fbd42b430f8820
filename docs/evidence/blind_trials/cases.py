"""The trials: groups, what is hidden in each, and the seeds, which are frozen."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_env.plant import BUILT_IN, CATALOGUE, Effect

#: Largest error of a base parameter.
BASE_ERROR = 0.15
EVERYTHING = ("setpoint", "current", "pressure", "load")
#: Trials of two effects.
NUMBER_OF_PAIRS = 20
#: group: (settings of the log, whether the effect is taken out of the candidates)
GROUPS: dict[str, dict[str, Any]] = {
    "nothing": {"base_error": 0.0},
    "parameters": {},
    "medium": {},
    "two": {},
    "unlisted": {"unlisted": True},
    "small": {"severity": "small"},
    "large": {"severity": "large"},
    "speed_only": {"record": ("setpoint",)},
    "current_too": {"record": ("setpoint", "current")},
    "quiet": {"noise": 0.1},
    "noisy": {"noise": 10.0},
    "no_twins": {"unlisted": True, "twins": False},
}
#: What the seeds of the groups begin with. Frozen: a seed means the same trial whatever is added later.
_GROUP_SEEDS = {
    "nothing": 0, "parameters": 1000, "medium": 2000, "two": 3000, "unlisted": 4000, "small": 5000, "large": 6000,
    "speed_only": 7000, "current_too": 8000, "quiet": 9000, "noisy": 10000, "no_twins": 11000,
}  # fmt: skip


def _and_new(frozen: tuple[str, ...], new: Iterable[Effect]) -> tuple[str, ...]:
    """Effects in the order of their seeds: those of a frozen list, and whatever the catalogue has got since."""
    return (*frozen, *(e.name for e in new if not e.family and e.name not in frozen))


#: The effects that are hidden one by one, and of which pairs are drawn.
_FROZEN = (
    "command_delay", "driver_saturation", "coil_heating", "magnetic_hysteresis", "spool_stiction", "spring_preload",
    "flow_force", "null_offset", "dead_zone", "flow_saturation", "directional_gain", "flow_gain_nonlinearity",
    "pressure_dependent_flow", "supply_droop", "entrained_air", "line_loss", "crossport_relief", "speed_dependent_leakage",
    "motor_coulomb_friction", "quadratic_drag", "displacement_ripple", "load_bias", "eccentric_load", "shaft_backlash",
    "viscosity_drift", "sensor_lag", "sensor_gain", "sensor_offset",
)  # fmt: skip
_ORDER = _and_new(_FROZEN, (CATALOGUE[name] for name in BUILT_IN))
#: The same for those whose declared twins are taken out, too.
_ORDER_WITHOUT_TWINS = _and_new((
    "command_delay", "magnetic_hysteresis", "spool_stiction", "spring_preload", "dead_zone", "line_loss", "quadratic_drag",
    "sensor_lag",
), (CATALOGUE[name] for name in BUILT_IN if CATALOGUE[name].indistinguishable_from))  # fmt: skip
#: Groups in which something is hidden that may be named.
WITH_NAME = frozenset(GROUPS) - {"nothing", "parameters", "unlisted", "no_twins"}
#: Trials of each group that hides nothing, unless told otherwise.
EMPTY = 10


@dataclass(frozen=True)
class Case:
    """One trial: what is hidden and how it is logged; whether it is taken out of the candidates, and its declared twins too."""

    group: str
    hidden: tuple[str, ...]
    seed: int
    severity: str = "medium"
    base_error: float = BASE_ERROR
    noise: float = 1.0
    record: tuple[str, ...] = EVERYTHING
    unlisted: bool = False
    twins: bool = True


def cases(groups: Sequence[str], seed: int, empty: int = EMPTY) -> list[Case]:
    """The trials of these groups; each has a seed of its own, and another `seed` gives other rigs, sizes and manoeuvres.

    `empty` is how many there are of each group that hides nothing.
    """
    found = []
    for group in groups:
        first = seed + _GROUP_SEEDS[group]
        sets: list[tuple[str, ...]]
        if group in ("nothing", "parameters"):
            sets = [()] * empty
        elif group == "two":
            sets = [_pair(first + number) for number in range(NUMBER_OF_PAIRS)]
        else:
            names = _ORDER_WITHOUT_TWINS if group == "no_twins" else _ORDER
            sets = [(_on(n, 1 + number % 2),) for number, n in enumerate(names)]
        found += [Case(group, hidden, first + number, **GROUPS[group]) for number, hidden in enumerate(sets)]
    return found


def _pair(seed: int) -> tuple[str, ...]:
    """Two effects of the frozen list on channels of their own choice, drawn from a seed; no two that logs cannot part."""
    rng = np.random.default_rng([seed, 2])
    while True:
        one, other = (_FROZEN[n] for n in rng.choice(len(_FROZEN), 2, replace=False))
        if other not in CATALOGUE[one].indistinguishable_from:
            channels = rng.integers(1, 3, 2)
            return _on(one, int(channels[0])), _on(other, int(channels[1]))


def _on(effect: str, channel: int) -> str:
    return effect if CATALOGUE[effect].scope == "rig" else f"{effect}:{channel}"


def commands(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """The commands that make these rows and no others: for every block of seeds one for the groups that were run whole, and
    one for the others."""
    found = []
    done = {(r["group"], r["seed"]) for r in rows}
    blocks = {(g, s): s - _GROUP_SEEDS[g] for g, s in done}
    for block in sorted({b - b % 1000 for b in blocks.values()}):
        own = {key for key, b in blocks.items() if b - b % 1000 == block}
        # Groups that hide nothing may have any number of trials.
        nothing = [sum(group == g for g, _ in own) for group in ("nothing", "parameters")]
        empty = max(nothing)
        whole, part = [], []
        for group in GROUPS:
            every = {(group, c.seed) for c in cases([group], block, empty)}
            if every and every <= own:
                whole.append(group)
            elif every & own:
                part.append(group)
        start = f"python -m docs.evidence.blind_trials --seed {block} --out DIR"
        start += f" --empty {empty}" if empty else ""
        if whole:
            found.append(f"{start} --groups {' '.join(whole)}")
        if part:
            seeds = " ".join(_ranges([s for g, s in sorted(own) if g in part]))
            found.append(f"{start} --groups {' '.join(part)} --only {seeds}")
    return found


def _ranges(numbers: Sequence[int]) -> list[str]:
    """Whole numbers in order, neighbours as `first-last`."""
    found: list[list[int]] = []
    for n in sorted(numbers):
        if found and n == found[-1][-1] + 1:
            found[-1][1:] = [n]
        else:
            found.append([n])
    return ["-".join(map(str, pair)) for pair in found]

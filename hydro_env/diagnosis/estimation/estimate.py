"""An estimate: the unknowns of a channel or of the whole rig, their values so far, and what was simulated with these."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from math import nan
from typing import TYPE_CHECKING

import numpy as np

from ...plant import CATALOGUE
from ..models.base import Request
from .unknowns import SCALED_TOGETHER, Unknown, effect_unknowns, less_taken

if TYPE_CHECKING:
    from .uncertainty import Intervals

__all__ = ["Estimate", "Vector", "joined"]

Vector = np.ndarray


@dataclass(eq=False)
class Estimate:
    """Unknowns of a channel (None: of the whole rig) and their values, on the scale `q` of each.

    `simulated` holds, by channel, the samples at `q`; `columns` their derivatives (n, number of unknowns) where they were
    last computed; `cost` twice the negative log-likelihood at `q`. `follow` holds
    parameters that are not estimated but repeat another one, by name (with a minus: its opposite), or a number. `together`
    names the directions of `SCALED_TOGETHER` along which derivatives are taken.
    """

    channel: int | None
    unknowns: list[Unknown]
    q: Vector
    label: str = ""
    simulated: dict[int, Vector] = field(default_factory=dict)
    columns: dict[int, Vector] = field(default_factory=dict)
    cost: float = np.inf
    intervals: Intervals | None = None
    follow: dict[str, str | float] = field(default_factory=dict)
    together: tuple[str, ...] = ("k",)

    def request(self, q: Vector | None = None) -> Request:
        """The simulation at q (default: at the estimate)."""
        q = self.q if q is None else q
        if self.channel is not None:
            values = {u.name: u.value(v) for u, v in zip(self.unknowns, q, strict=True)}
            return Request(self.channel, self._with_followers(values))
        pairs: dict[str, list[float]] = {}
        for u, v in zip(self.unknowns, q, strict=True):
            value = u.value(v)
            # What is estimated for one channel alone is on the other one as given.
            pair = pairs.setdefault(u.name, [nan, nan])
            for c in (0, 1) if u.channel is None else (u.channel,):
                pair[c] = value
        sides = [self._with_followers({name: pair[c] for name, pair in pairs.items()}) for c in (0, 1)]
        return Request(None, {name: (sides[0][name], sides[1][name]) for name in sides[0]})

    def beside(self, moves: Iterable[Vector]) -> list[Request]:
        """The simulation at the estimate, and behind it those at `q + move`, for differences: all take the steps of the first."""
        here = self.request()
        return [here, *(replace(self.request(self.q + move), like=here) for move in moves)]

    def _with_followers(self, values: dict[str, float]) -> dict[str, float]:
        for name, source in self.follow.items():
            if not isinstance(source, str):
                values[name] = source
            elif source.removeprefix("-") in values:
                value = values[source.removeprefix("-")]
                values[name] = -value if source.startswith("-") else value
        return values

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        pairs = np.array([u.bounds for u in self.unknowns]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def values(self, channel: int) -> dict[str, float]:
        """The estimated values that act on a channel, by name."""
        own = zip(self.unknowns, self.q, strict=True)
        return self._with_followers({u.name: u.value(v) for u, v in own if u.channel in (None, channel)})

    def effects(self) -> list[str]:
        """The effects of which parameters are estimated."""
        return list(dict.fromkeys(u.effect for u in self.unknowns if u.effect))

    def placed_effects(self) -> list[tuple[str, int | None]]:
        """The effects of which parameters are estimated, each with its channel, None for one of the whole rig."""
        own = (u for u in self.unknowns if u.effect)
        every = ((u.effect, u.channel if self.channel is None else self.channel) for u in own)
        return list(dict.fromkeys(every))

    # --- other estimates made from this one -------------------------------------------------------------------------------
    def at(self, q: Vector, label: str | None = None) -> Estimate:
        """The same unknowns at q, not yet simulated."""
        label = self.label if label is None else label
        return Estimate(self.channel, self.unknowns, q, label, follow=self.follow, together=self.together)

    def from_given(self) -> Estimate:
        """Known parameters as given, but those of the coil (the current determines them, whatever is missing behind), and
        effects as they are: known parameters that were fitted while an effect was missing have moved to make up for it."""
        known = np.array([not u.effect and u.name not in ("R", "L") for u in self.unknowns])
        return self.at(np.clip(np.where(known, 0.0, self.q), *self.bounds))

    def in_all_directions(self) -> Estimate:
        """The same values, to go on with derivatives along every direction of `SCALED_TOGETHER`: for where nothing is missing."""
        twin = self.at(self.q.copy())
        twin.together = tuple(SCALED_TOGETHER)
        return twin

    def with_effect(self, effect: str, start: dict[str, float], on: int | None = None) -> Estimate:
        """An effect more, at the values `start` {own name: value}; `on` a channel, where the estimate is the rig's."""
        alone = on if self.channel is None else None
        added = [replace(u, channel=alone) for u in effect_unknowns(CATALOGUE[effect], start)]
        q = np.concatenate([self.q, np.zeros(len(added))])
        channel = on if self.channel is None else self.channel
        if channel is not None:
            taken = less_taken(self.values(channel), effect, start)
            for j, u in enumerate(self.unknowns):
                if u.name in taken and u.channel in (None, channel):
                    q[j] = np.clip(u.q(taken[u.name]), *u.bounds)
        return Estimate(self.channel, [*self.unknowns, *added], q, effect, follow=self.follow)

    def extended(self, effect: str, start: dict[str, float], on: int | None = None) -> Estimate:
        """An effect more, with the derivatives taken along; those of the new parameters are zero."""
        twin = self.with_effect(effect, start, on)
        for c, known in self.columns.items():
            # They lie in memory column by column, as they come.
            own = twin.columns[c] = np.zeros((known.shape[0], len(twin.unknowns)), order="F")
            own[:, : known.shape[1]] = known
        return twin

    def without(self, effect: str, on: int | None = None) -> Estimate:
        """An effect less, at the same values of everything else; `on` as in `with_effect`."""
        alone = on if self.channel is None else None
        keep = [j for j, u in enumerate(self.unknowns) if (u.effect, u.channel) != (effect, alone)]
        follow = {n: s for n, s in self.follow.items() if effect not in (_effect_of(n), _effect_of(s))}
        unknowns, label = [self.unknowns[j] for j in keep], f"without {effect}"
        return Estimate(self.channel, unknowns, self.q[keep], label, follow=follow)

    def adopt(self, other: Estimate) -> bool:
        """Takes over the values of `other`, of the same unknowns, if it explains the logs better; whether it does."""
        if not other.cost < self.cost:
            return False
        self.q, self.cost, self.simulated, self.columns = other.q, other.cost, other.simulated, other.columns
        return True


def _effect_of(name: str | float) -> str:
    """The effect of a parameter, with or without a minus."""
    return str(name).removeprefix("-").split(".")[0]


def joined(estimates: dict[int, Estimate]) -> Estimate:
    """The estimates of the channels as one of the rig."""
    first = next(iter(estimates.values()))
    if first.channel is None:
        return first
    # What a channel's estimate holds is that channel's own, also beside the other one.
    unknowns = [replace(u, channel=c) for c, p in estimates.items() for u in p.unknowns]
    q = np.concatenate([p.q for p in estimates.values()])
    follow = {name: source for p in estimates.values() for name, source in p.follow.items()}
    simulated = {c: p.simulated[c] for c, p in estimates.items()}
    whole = Estimate(None, unknowns, q, "rig", simulated=simulated, follow=follow)
    place = 0
    for c, p in estimates.items():
        matrix = np.zeros((p.simulated[c].size, len(unknowns)), order="F")
        if c in p.columns:
            matrix[:, place : place + len(p.unknowns)] = p.columns[c]
        whole.columns[c] = matrix
        place += len(p.unknowns)
    whole.cost = sum(p.cost for p in estimates.values())
    return whole

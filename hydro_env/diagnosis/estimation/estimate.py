"""An estimate: the unknowns of a channel or of the whole rig, their values so far, and what was simulated with these."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from math import nan

import numpy as np

from ...plant import CATALOGUE, Effect, PlantModel
from ..models.base import Request, Samples
from .unknowns import SCALED_TOGETHER, Unknown, effect_unknowns, less_taken

Vector = np.ndarray


@dataclass(frozen=True)
class Intervals:
    """`low` and `high` (k,) hold 95 % of the replicas' estimates of q. `draws` (m, k) are some of the replicas' estimates."""

    low: Vector
    high: Vector
    draws: Vector


@dataclass(eq=False)
class Estimate:
    """Unknowns of a channel (None: of the whole rig) and their values, on the scale `q` of each.

    `simulated` holds, by channel, the samples at `q`; `columns` their derivatives (n, number of unknowns) where they were
    last computed; `cost` twice the negative log-likelihood at `q`. `follow` holds
    parameters that are not estimated but repeat another one, by name (with a minus: its opposite), or a number. `together`
    names the directions of `SCALED_TOGETHER` along which derivatives are taken. An estimate equals itself alone, so it can be
    the key of a dictionary.
    """

    channel: int | None
    unknowns: list[Unknown]
    q: Vector
    label: str = ""
    simulated: Samples = field(default_factory=dict)
    columns: Samples = field(default_factory=dict)
    cost: float = np.inf
    intervals: Intervals | None = None
    follow: dict[str, str | float] = field(default_factory=dict)
    together: tuple[str, ...] = ("k",)

    def request(self, q: Vector | None = None) -> Request:
        """The simulation at q (default: at the estimate)."""
        if self.channel is not None:
            return Request(self.channel, self.values(self.channel, q))
        one, other = (self.values(c, q) for c in (0, 1))
        # What is estimated for one channel alone is on the other one as given.
        return Request(None, {name: (one.get(name, nan), other.get(name, nan)) for name in {**one, **other}})

    def beside(self, moves: Iterable[Vector]) -> list[Request]:
        """The simulation at the estimate, and behind it those at `q + move`, for differences: all take the steps of the first."""
        here = self.request()
        return [here, *(replace(self.request(self.q + move), like=here) for move in moves)]

    @property
    def bounds(self) -> tuple[Vector, Vector]:
        pairs = np.array([u.bounds for u in self.unknowns]).reshape(-1, 2)
        return pairs[:, 0], pairs[:, 1]

    def values(self, channel: int, q: Vector | None = None) -> dict[str, float]:
        """The values at q (default: at the estimate) that act on a channel, by name."""
        own = zip(self.unknowns, self.q if q is None else q, strict=True)
        values = {u.name: u.value(v) for u, v in own if u.channel in (None, channel)}
        for name, source in self.follow.items():
            if not isinstance(source, str):
                values[name] = source
            elif source.removeprefix("-") in values:
                value = values[source.removeprefix("-")]
                values[name] = -value if source.startswith("-") else value
        return values

    def effects(self) -> list[str]:
        """The effects of which parameters are estimated."""
        return list(dict.fromkeys(u.effect for u in self.unknowns if u.effect))

    def placed_effects(self) -> list[tuple[str, int | None]]:
        """The effects of which parameters are estimated, each with its channel, None for one of the whole rig."""
        own = (u for u in self.unknowns if u.effect)
        every = ((u.effect, u.channel if self.channel is None else self.channel) for u in own)
        return list(dict.fromkeys(every))

    # --- other estimates made from this one -------------------------------------------------------------------------------
    def at(self, q: Vector, label: str | None = None) -> "Estimate":
        """The same unknowns at q, not yet simulated."""
        label = self.label if label is None else label
        return Estimate(self.channel, self.unknowns, q, label, follow=self.follow, together=self.together)

    def at_values_of(self, model: PlantModel, channel: int) -> "Estimate":
        """The same unknowns at the values that a model has on a channel, within their bounds."""
        values = [(u, model.value(u.name, channel)) for u in self.unknowns]
        return self.at(np.array([u.q(min(max(value, u.low), u.high)) for u, value in values]))

    def from_given(self) -> "Estimate":
        """Known parameters as given, but those of the coil (the current determines them, whatever is missing behind), and
        effects as they are: known parameters that were fitted while an effect was missing have moved to make up for it."""
        known = np.array([not u.effect and u.name not in ("R", "L") for u in self.unknowns])
        return self.at(np.clip(np.where(known, 0.0, self.q), *self.bounds))

    def in_all_directions(self) -> "Estimate":
        """The same values, to go on with derivatives along every direction of `SCALED_TOGETHER`: for where nothing is missing."""
        return replace(self.at(self.q.copy()), together=tuple(SCALED_TOGETHER))

    def with_effect(self, of: Effect | str, start: dict[str, float], on: int | None = None) -> "Estimate":
        """An effect more, one of the paper's rig by its name, at the values `start` {own name: value}; `on` a channel, where the
        estimate is the rig's."""
        described = CATALOGUE[of] if isinstance(of, str) else of
        effect, alone = described.name, on if self.channel is None else None
        added = [replace(u, channel=alone) for u in effect_unknowns(described, start)]
        q = np.concatenate([self.q, np.zeros(len(added))])
        channel = on if self.channel is None else self.channel
        if channel is not None:
            taken = less_taken(self.values(channel), effect, start)
            for j, u in enumerate(self.unknowns):
                if u.name in taken and u.channel in (None, channel):
                    q[j] = np.clip(u.q(taken[u.name]), *u.bounds)
        return Estimate(self.channel, [*self.unknowns, *added], q, effect, follow=self.follow)

    def extended(self, effect: Effect | str, start: dict[str, float], on: int | None = None) -> "Estimate":
        """An effect more, with the derivatives taken along; those of the new parameters are zero."""
        twin = self.with_effect(effect, start, on)
        for c, known in self.columns.items():
            # They lie in memory column by column, as they come.
            own = twin.columns[c] = np.zeros((known.shape[0], len(twin.unknowns)), order="F")
            own[:, : known.shape[1]] = known
        return twin

    def without(self, effect: str, on: int | None = None) -> "Estimate":
        """An effect less, at the same values of everything else; `on` as in `with_effect`."""
        alone = on if self.channel is None else None
        keep = [j for j, u in enumerate(self.unknowns) if (u.effect, u.channel) != (effect, alone)]
        follow = {n: s for n, s in self.follow.items() if effect not in (_effect_of(n), _effect_of(s))}
        unknowns, label = [self.unknowns[j] for j in keep], f"without {effect}"
        return Estimate(self.channel, unknowns, self.q[keep], label, follow=follow)

    def with_whole_orders(self) -> "Estimate | None":
        """The same with every order held at the nearest whole number; None where no order is estimated."""
        places = [j for j, u in enumerate(self.unknowns) if u.is_order and u.low < u.high]
        unknowns, q = [*self.unknowns], self.q.copy()
        for j in places:
            unknowns[j], q[j] = unknowns[j].held(round(unknowns[j].value(q[j]))), 0.0
        return replace(self.at(q), unknowns=unknowns) if places else None

    def improve(self, cost: float, q: Vector, simulated: Samples) -> None:
        """Moves to q, where the `simulated` samples have this cost, if that is lower."""
        if cost < self.cost:
            self.cost, self.q, self.simulated = cost, q, simulated

    def adopt(self, other: "Estimate") -> bool:
        """Takes over the values of `other`, of the same unknowns, if it explains the logs better; whether it does."""
        better = other.cost < self.cost
        if better:
            self.improve(other.cost, other.q, other.simulated)
            self.columns = other.columns
        return better


#: Estimates by channel; the same one for both where the whole rig was estimated together.
Estimates = dict[int, Estimate]


def distinct(estimates: Estimates) -> list[Estimate]:
    """Each estimate once."""
    return list(dict.fromkeys(estimates.values()))


def _effect_of(name: str | float) -> str:
    """The effect of a parameter, with or without a minus."""
    return str(name).removeprefix("-").split(".")[0]


def joined(estimates: Estimates) -> Estimate:
    """The estimates of the channels as one of the rig, in which what the channels share is there once."""
    first = next(iter(estimates.values()))
    if first.channel is None:
        return first
    names = {c: [_of_channel(u, c) for u in p.unknowns] for c, p in estimates.items()}
    place = {u: n for n, u in enumerate(dict.fromkeys(u for own in names.values() for u in own))}
    follow = {name: source for p in estimates.values() for name, source in p.follow.items()}
    whole = Estimate(None, list(place), np.zeros(len(place)), "rig", follow=follow)
    for c, p in estimates.items():
        own = [place[u] for u in names[c]]
        whole.q[own] = p.q
        if c in p.simulated:
            whole.simulated[c] = p.simulated[c]
            matrix = whole.columns[c] = np.zeros((p.simulated[c].size, len(place)), order="F")
            matrix[:, own] = p.columns.get(c, 0.0)
    whole.cost = sum(p.cost for p in estimates.values())
    return whole


def _of_channel(unknown: Unknown, channel: int) -> Unknown:
    """What a channel's estimate holds is that channel's own, also beside the other one, unless it is of an effect of the rig."""
    effect = unknown.name.rpartition(".")[0]
    return unknown if effect and CATALOGUE[effect].scope == "rig" else replace(unknown, channel=channel)

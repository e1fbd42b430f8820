"""What every effect of the catalogue would look like in these logs: its signature beside the calibrated model.

One simulation per effect and size. A signature is the change of all signals; what calibration could absorb of it is
projected off. From it follow, at once, whether the effect could be seen at all here (`detectable`), which effects look
alike (`alike`), and how much of the present residual each could explain (`screen`). Finite sizes are used because a dead
zone, play or stiction has no useful derivative at zero.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from math import nan

import numpy as np

from ...plant import CATALOGUE, Effect
from ..estimation import Estimate, Fit, could_pay, effect_starts, less_taken
from ..logs import Estimates, Logs
from ..models.base import Request, effect_in

__all__ = ["Screening", "alike", "detectable", "hidden_by_calibration", "run", "screen"]

#: Squared length of a projected signature, in noise units, from which an effect counts as visible.
VISIBLE = 60.0
#: Share of the squared length of what an effect changes that calibration may leave of an effect that it takes up: derivatives at
#: one place never take all of it.
ABSORBED = 1e-4
#: Cosine from which two projected signatures count as the same.
SAME_DIRECTION = 0.96


@dataclass
class Screening:
    """An effect on a channel (None: the rig) at the size that explains most of the residual.

    `gain` is the expected fall of the deviance, `visible` the squared length of the signature of medium size in noise
    units after projection, by channel; `signature` that projected signature, normalised, all channels one after the other.
    `unprojected` is the squared length before projection. `request` is the simulation at `start`, and `simulated` its samples by
    channel.
    """

    effect: str
    channel: int | None
    start: dict[str, float]
    gain: float
    visible: float
    signature: np.ndarray
    unprojected: float = 0.0
    request: Request | None = None
    simulated: dict[int, np.ndarray] = field(default_factory=dict)

    def begin(self, fit: Fit, estimate: Estimate) -> None:
        """Spares an estimate that begins where the screening has been its first simulation."""
        if estimate.request() == self.request:
            estimate.simulated = self.simulated
            estimate.cost = fit.cost(estimate, self.simulated, estimate.q)

    @property
    def hidden(self) -> bool:
        """Whether it would show if nothing were calibrated, and calibration takes it all."""
        return self.unprojected > VISIBLE and self.visible <= max(VISIBLE, ABSORBED * self.unprojected)

    @property
    def shows(self) -> bool:
        """Whether logs like these would show it."""
        return self.visible > VISIBLE and not self.hidden


class _Projector:
    """Takes out of a weighted vector what small changes of the base parameters can make."""

    def __init__(self, fit: Fit, estimate: Estimate, channel: int, deviations: dict[str, float]) -> None:
        self.weights = _weights(fit, estimate, channel, deviations)
        columns = estimate.columns[channel] * self.weights[:, None]
        # Rows of the prior below the columns make the projection a ridge: parameters move inside their priors only.
        prior = np.diag([1.0 if u.prior else 1e-3 for u in estimate.unknowns])
        self.basis, _ = np.linalg.qr(np.vstack([columns, prior]))
        self.rows = columns.shape[0]

    def __call__(self, vector: np.ndarray) -> np.ndarray:
        full = np.concatenate([vector * self.weights, np.zeros(self.basis.shape[0] - self.rows)])
        full -= self.basis @ (self.basis.T @ full)
        return full[: self.rows]


def run(logs: Logs, calibrated: Estimates, earlier: Sequence[Screening] = ()) -> list[Screening]:
    """Screens every candidate beside the calibrated model."""
    settled = [c for c, p in calibrated.items() if not could_pay(logs.fit, p, c)]
    return screen(logs.fit, calibrated, logs.rig.candidates(), logs.seconds, earlier, settled)


def screen(
    fit: Fit, estimates: Estimates, effects: Sequence[str], seconds: float, earlier: Sequence[Screening] = (),
    settled: Collection[int] = (),
) -> list[Screening]:  # fmt: skip
    """Screens every effect on every channel, beside the present `estimates`, best first.

    On channels that have `settled`, where nothing is left to explain, only the medium size is simulated, which says what would
    be seen. Effects of the whole rig are screened on both channels together. What did best in an `earlier`
    screening, if there is one, is tried again.
    """
    wanted: list[tuple[str, int | None, dict[str, float], bool]] = []
    for name in effects:
        for channel in estimates if CATALOGUE[name].scope == "channel" else (None,):
            if fit.rig.has(name, channel):
                continue
            effect = effect_in(fit.rig, name, channel)
            known = [k.start for k in earlier if (k.effect, k.channel) == (name, channel)]
            starts = effect_starts(effect, seconds)
            if channel in settled:
                starts = [start for start in starts if _is_medium(effect, start)] or starts
            starts = [*starts, *(start for start in known if start not in starts)]
            wanted += [(name, channel, s, _is_medium(effect, s)) for s in starts]
    requests = [_request(estimates, name, c, start) for name, c, start, _ in wanted]
    results = fit.rig.predict(requests)
    left = {c: _Projector(fit, p, c, _deviations(fit, p, c)) for c, p in estimates.items()}
    noise = {
        c: _Projector(fit, p, c, {s.signal: fit.noise[c, s.signal] for s in fit.rig.segments[c]})
        for c, p in estimates.items()
    }
    errors = {c: left[c](_error(fit, p, c)) for c, p in estimates.items()}
    found: dict[tuple[str, int | None], Screening] = {}
    for (name, channel, start, medium), request, result in zip(wanted, requests, results, strict=True):
        channels = fit.rig.channels if channel is None else (channel,)
        if not all(np.isfinite(result[c]).all() for c in channels):
            continue
        changes = {c: result[c] - estimates[c].simulated[c] for c in channels}
        gained = _gain(fit, {c: left[c](changes[c]) for c in channels}, errors, left)
        one = found.get((name, channel))
        if one is None or medium:
            signature = np.concatenate([noise[c](changes[c]) for c in channels])
            size = float(signature @ signature)
            direction = signature / max(np.sqrt(size), 1e-30)
        if one is None:
            one = found[name, channel] = Screening(name, channel, start, gained, size, direction)
        if medium:
            one.visible, one.signature = size, direction
            one.unprojected = sum(float(np.sum((changes[c] * noise[c].weights) ** 2)) for c in channels)
        if one.request is None or gained > one.gain:
            one.gain, one.start, one.request, one.simulated = gained, start, request, result
    return sorted(found.values(), key=lambda k: -k.gain)


def _request(estimates: Estimates, effect: str, channel: int | None, start: dict[str, float]) -> Request:
    extra = {f"{effect}.{name}": value for name, value in start.items()}
    if channel is not None and estimates[channel].channel is None:
        return estimates[channel].with_effect(effect, start, channel).request()
    if channel is not None:
        values = estimates[channel].values(channel)
        return Request(channel, {**values, **less_taken(values, effect, start), **extra})
    sides = [estimates[c].values(c) if c in estimates else {} for c in (0, 1)]
    pairs = {name: (sides[0].get(name, nan), sides[1].get(name, nan)) for name in {*sides[0], *sides[1]}}
    return Request(None, {**pairs, **{name: (value, value) for name, value in extra.items()}})


def _is_medium(effect: Effect, start: dict[str, float]) -> bool:
    return all(start[p.name] == p.typical for p in effect.parameters if p.typical != p.nominal or p.starts)


def _weights(fit: Fit, estimate: Estimate, channel: int, deviations: dict[str, float]) -> np.ndarray:
    weights = np.zeros(estimate.simulated[channel].size)
    for s in fit.rig.segments[channel]:
        weights[s.place] = s.used / deviations[s.signal]
    return weights


def _deviations(fit: Fit, estimate: Estimate, channel: int) -> dict[str, float]:
    """By signal the RMS error, at least the noise."""
    sums: dict[str, list[float]] = {}
    for s in fit.rig.segments[channel]:
        error = (s.measured - estimate.simulated[channel][s.place])[s.used]
        entry = sums.setdefault(s.signal, [0.0, 1e-9])
        entry[0] += float(error @ error)
        entry[1] += error.size
    return {n: float(np.sqrt(max(t / k, fit.noise[channel, n] ** 2))) for n, (t, k) in sums.items()}


def _error(fit: Fit, estimate: Estimate, channel: int) -> np.ndarray:
    simulated = estimate.simulated[channel]
    return np.concatenate([np.nan_to_num(s.measured - simulated[s.place]) for s in fit.rig.segments[channel]])


def _gain(
    fit: Fit, changes: dict[int, np.ndarray], errors: dict[int, np.ndarray], projectors: dict[int, _Projector]
) -> float:
    """Fall of the deviance if the change came with the best factor from 0 to 1.5."""
    square = sum(float(changes[c] @ changes[c]) for c in changes)
    if square <= 1e-12:
        return 0.0
    factor = float(np.clip(sum(float(changes[c] @ errors[c]) for c in changes) / square, 0.0, 1.5))
    total = 0.0
    for c in changes:
        for s in fit.rig.segments[c]:
            used = s.used
            before = errors[c][s.place][used]
            after = before - factor * changes[c][s.place][used]
            # In the units of the weights the noise is the noise over the deviation that was left.
            scale = projectors[c].weights[s.place][used]
            noise = (fit.noise[c, s.signal] * (scale[0] if scale.size else 1.0)) ** 2
            total += before.size * np.log(max(np.mean(before**2), noise) / max(np.mean(after**2), noise))
    return float(total)


def detectable(screening: Sequence[Screening]) -> dict[str, dict[str, bool]]:
    """By effect and channel ("1", "2", "rig"): whether an effect of medium size would show in these logs."""
    found: dict[str, dict[str, bool]] = {}
    for one in screening:
        key = "rig" if one.channel is None else str(one.channel + 1)
        found.setdefault(one.effect, {})[key] = one.shows
    return {name: dict(sorted(found[name].items())) for name in CATALOGUE if name in found}


def hidden_by_calibration(screening: Sequence[Screening]) -> dict[str, list[str]]:
    """By effect the channels on which calibration takes all of an effect of medium size that would show otherwise."""
    found: dict[str, list[str]] = {}
    for one in screening:
        if one.hidden:
            found.setdefault(one.effect, []).append("rig" if one.channel is None else str(one.channel + 1))
    return {name: sorted(found[name]) for name in CATALOGUE if name in found}


def alike(screening: Sequence[Screening]) -> dict[tuple[str, int | None], list[str]]:
    """For every effect on a channel the visible ones whose signature has the same direction, whatever the sign."""
    found: dict[tuple[str, int | None], list[str]] = {}
    for a in screening:
        same = [
            b.effect for b in screening
            if b is not a and b.channel == a.channel and min(a.visible, b.visible) > VISIBLE
            and abs(float(a.signature @ b.signature)) > SAME_DIRECTION
        ]  # fmt: skip
        found[a.effect, a.channel] = same
    return found

"""What every effect of the catalogue would look like in these logs: its signature beside the calibrated model.

One simulation per effect and size. A signature is the change of all signals; what calibration could absorb of it is
projected off. From it follow, at once, whether the effect could be seen at all here (`detectable`), and how much of the present
residual each could explain (`screen`). Finite sizes are used because a dead
zone, play or stiction has no useful derivative at zero.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ...plant import CATALOGUE, Effect
from ..estimation.estimate import Estimate, Estimates, joined
from ..estimation.fit import Fit
from ..estimation.unknowns import effect_starts
from ..logs import Logs, place_of
from ..models.base import Samples, effect_in

#: Squared length of a projected signature, in noise units, from which an effect counts as visible: its expected gain is then what
#: three parameters must pay for (`candidates.penalty`), the most that the size of an effect of the catalogue has.
VISIBLE = 60.0
#: Share of the squared length of what an effect changes that calibration may leave of an effect that it takes up, a hundredth of
#: the amplitude: derivatives at one place never take all of it.
ABSORBED = 1e-4


@dataclass(frozen=True)
class Screening:
    """An effect on a channel (None: the rig) at the size that explains most of the residual.

    `gain` is the expected fall of the deviance, `visible` the squared length of the signature of medium size in noise units
    after projection, of all channels, `unprojected` that before projection.
    """

    effect: str
    channel: int | None
    start: dict[str, float]
    gain: float
    visible: float
    unprojected: float = 0.0

    @property
    def hidden(self) -> bool:
        """Whether it would show if nothing were calibrated, and calibration takes it all."""
        return self.unprojected > VISIBLE and self.visible <= max(VISIBLE, ABSORBED * self.unprojected)

    @property
    def shows(self) -> bool:
        """Whether logs like these would show it."""
        return self.visible > VISIBLE and not self.hidden


class _Projector:
    """Weights the signals of a channel by `deviations`, and takes out what small changes of the base parameters can make."""

    def __init__(self, fit: Fit, estimate: Estimate, channel: int, deviations: Mapping[str, float]) -> None:
        self.weights = np.zeros(estimate.simulated[channel].size)
        for s in fit.rig.segments[channel]:
            self.weights[s.place] = s.used / deviations[s.signal]
        columns = estimate.columns[channel] * self.weights[:, None]
        # Rows of the prior below the columns make the projection a ridge: parameters move inside their priors only.
        prior = np.diag([1.0 if u.prior else 1e-3 for u in estimate.unknowns])
        # Of the vectors that are projected the rows of the prior are zero.
        self.rows = np.linalg.qr(np.vstack([columns, prior]))[0][: len(columns)]

    def __call__(self, vector: np.ndarray) -> np.ndarray:
        weighted = vector * self.weights
        return np.asarray(weighted - self.rows @ (self.rows.T @ weighted))


def run(logs: Logs, calibrated: Estimates, earlier: Sequence[Screening] = ()) -> list[Screening]:
    """Screens every candidate beside the calibrated model."""
    settled = [c for c, p in calibrated.items() if not logs.fit.could_pay(p, c)]
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
    beside: dict[int | None, Estimate] = dict(estimates.items())
    if any(CATALOGUE[name].scope == "rig" for name in effects):
        beside[None] = joined(estimates)
    tries: list[tuple[Effect, int | None, list[dict[str, float]]]] = []
    for name in effects:
        for channel in estimates if CATALOGUE[name].scope == "channel" else (None,):
            if not fit.rig.has(name, channel):
                effect = effect_in(fit.rig, name, channel)
                known = [k.start for k in earlier if (k.effect, k.channel) == (name, channel)]
                looks = medium_starts if channel in settled else effect_starts
                starts = looks(effect, seconds)
                tries.append((effect, channel, [*starts, *(start for start in known if start not in starts)]))
    begun = [beside[c].with_effect(effect, start, c) for effect, c, starts in tries for start in starts]
    results = iter(fit.rig.predict([p.request() for p in begun]))
    left = {c: _Projector(fit, p, c, _deviations(fit, p, c)) for c, p in estimates.items()}
    at_noise = {c: {s: fit.noise[c, s] for s in fit.rig.segments[c].by_signal} for c in estimates}
    noise = {c: _Projector(fit, p, c, at_noise[c]) for c, p in estimates.items()}
    every = {c: [s.error(p.simulated[c]) for s in fit.rig.segments[c]] for c, p in estimates.items()}
    errors = {c: left[c](np.concatenate(own)) for c, own in every.items()}
    found = []
    for effect, channel, starts in tries:
        channels, rows = fit.rig.channels if channel is None else (channel,), []
        for start, result in zip(starts, results, strict=False):
            change = {c: result[c] - estimates[c].simulated[c] for c in channels}
            if all(np.isfinite(change[c]).all() for c in channels):
                gain = _gain(fit, {c: left[c](change[c]) for c in channels}, errors, left)
                rows.append((gain, start, change))
        if rows:
            gain, start, change = max(rows, key=lambda row: row[0])
            medium = ([each for _, size, each in rows if _is_medium(effect, size)] or [change])[-1]
            visible = sum(float(np.sum(noise[c](each) ** 2)) for c, each in medium.items())
            unprojected = sum(float(np.sum((each * noise[c].weights) ** 2)) for c, each in medium.items())
            found.append(Screening(effect.name, channel, start, gain, visible, unprojected))
    return sorted(found, key=lambda k: -k.gain)


def medium_starts(effect: Effect, seconds: float) -> list[dict[str, float]]:
    """First looks of medium size; all where there is none."""
    starts = effect_starts(effect, seconds)
    return [start for start in starts if _is_medium(effect, start)] or starts


def _is_medium(effect: Effect, start: dict[str, float]) -> bool:
    return all(start[p.name] == p.typical for p in effect.parameters if p.typical != p.nominal or p.starts)


def _deviations(fit: Fit, estimate: Estimate, channel: int) -> dict[str, float]:
    """By signal the RMS error, at least the noise."""
    simulated, signals = estimate.simulated[channel], fit.rig.segments[channel].by_signal.items()
    errors = {signal: np.concatenate([s.left(simulated) for s in own]) for signal, own in signals}
    return {s: max(fit.noise[channel, s], float(np.sqrt(np.mean(e**2)))) for s, e in errors.items()}


def _gain(fit: Fit, changes: Samples, errors: Samples, projectors: dict[int, _Projector]) -> float:
    """Fall of the deviance if the change came with the best factor from 0 to 1.5."""
    square = sum(float(change @ change) for change in changes.values())
    if square <= 1e-12:
        return 0.0
    factor = float(np.clip(sum(float(changes[c] @ errors[c]) for c in changes) / square, 0.0, 1.5))
    total = 0.0
    for c, change in changes.items():
        after = errors[c] - factor * change
        for s in fit.rig.segments[c]:
            if not s.used.any():
                continue
            # In the units of the weights the noise is the noise over the deviation that was left.
            noise = (fit.noise[c, s.signal] * projectors[c].weights[s.place].max()) ** 2
            powers = [max(float(np.mean(each[s.place][s.used] ** 2)), noise) for each in (errors[c], after)]
            total += float(s.used.sum()) * np.log(powers[0] / powers[1])
    return float(total)


def detectable(screening: Sequence[Screening]) -> dict[str, dict[str, bool]]:
    """By effect and channel ("1", "2", "rig"): whether an effect of medium size would show in these logs."""
    shown = sorted((k.effect, place_of(k.channel), k.shows) for k in screening)
    found = {name: {place: shows for effect, place, shows in shown if effect == name} for name in CATALOGUE}
    return {name: own for name, own in found.items() if own}


def hidden_by_calibration(screening: Sequence[Screening]) -> dict[str, list[str]]:
    """By effect the channels on which calibration takes all of an effect of medium size that would show otherwise."""
    hidden = [k for k in screening if k.hidden]
    found = {name: sorted(place_of(k.channel) for k in hidden if k.effect == name) for name in CATALOGUE}
    return {name: own for name, own in found.items() if own}

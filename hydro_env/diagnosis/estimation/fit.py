"""How well an estimate explains the logs: residuals, likelihood, and the deviance between two models.

The likelihood follows the residual: every block of a tenth of a second of every signal has a variance of its own, at least
the noise's, which is maximum likelihood for variances that are unknown. What the model explains well thereby counts, and a
few events that it misses (a spool that sticks a moment longer) do not drown the rest.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import nan, pi, sqrt

import numpy as np

from ...plant.scales import swing
from ..models.base import BLOCK_S, Joined, RigModel, Samples, Segment
from ..settings import Settings
from .estimate import Estimate, Estimates, Vector
from .noise import WINDOW_S, effective_samples, noise_floor

#: Standard deviations of the noise by (channel, signal), in SI.
Noise = dict[tuple[int, str], float]
#: Signals with fewer samples than this say nothing of their correlation (as in `effective_samples`).
MIN_SAMPLES = 8
#: Windows of the noise for a motor that swings, as a share of the time of a swing, of which a parabola leaves a thousandth,
#: and what is much less noise than the usual ones show, a quarter of its power: coloured noise shows somewhat less, too.
SHARE_OF_SWING, MUCH_LESS = 0.1, 0.5
#: Signals above this many times the noise count where power is compared: three quarters of their power are missing.
CLEARLY_ABOVE = 2.0
#: A residual (in `Fit.levels`, summed over the signals) that is too small to speak of something unknown: errors of 1.15 times the
#: noise in one signal.
SMALL_SUM = 0.15
#: A log is at its noise up to this many times that: two standard deviations of an RMS over `MAX_ROWS` samples,
#: 1 + 2 / sqrt(12000).
WITHIN_NOISE = 1.02
#: A log whose mean square error is above this many times the noise's (that squared) could pay for an effect, if its deviance is
#: worth one parameter of a library of 200 (`candidates.penalty_per_parameter`).
ABOVE_NOISE, WORTH = 1.04, 20.0
#: A residual (`Fit.level`) up to which a local minimum may be the cause, errors of 2.1 times the noise; what a missing effect
#: leaves is larger.
SMALL_LEVEL = 1.0
#: Rows of derivatives that stay in the processor's cache: their products take half as long as those of all rows.
CACHED = 4096


def noise_in(rig: RigModel, segment: Segment, values: Vector) -> float:
    """Standard deviation of the noise that a signal or its residual (n,) shows, SI. Of a motor that swings on its lines a window
    may hold a swing, which no parabola follows: where much shorter windows show much less, that counts."""
    found = noise_floor(values, segment.used, segment.period)
    square, decay = swing(rig.model, segment.channel)
    window = SHARE_OF_SWING * 2.0 * pi / sqrt(square)
    if not rig.has_hidden_states or decay > 2.0 * sqrt(square) or window > WINDOW_S:
        return found
    short = noise_floor(values, segment.used, segment.period, window)
    return short if short < MUCH_LESS * found else found


def noise_of(rig: RigModel, estimates: Estimates) -> Noise:
    """The smallest noise that the residual of a model or the bare signal shows, SI."""
    noise: Noise = {}
    for channel, estimate in estimates.items():
        simulated = estimate.simulated[channel]
        for signal, own in rig.segments[channel].by_signal.items():
            # Of the residual: a model, even a poor one, takes the fast movements out.
            both = [[noise_in(rig, s, x) for x in (s.measured - simulated[s.place], s.measured)] for s in own]
            noise[channel, signal] = max(float(np.nanmedian(np.nanmin(both, axis=1))), 1e-12)
    return noise


@dataclass(frozen=True)
class Fit:
    """A model of the rig with its logs, and the noise of their signals: what every estimate is compared with."""

    rig: RigModel
    noise: Noise
    settings: Settings = field(default_factory=Settings)

    def on(self, rig: RigModel) -> "Fit":
        """The same with other logs, or another view of the model."""
        return replace(self, rig=rig)

    def with_noise_seen_by(self, estimates: Estimates) -> "Fit":
        """The same with the noise as these estimates show it, where that is lower: what is missing makes it look larger."""
        seen = noise_of(self.rig, estimates)
        noise = {key: min(value, seen.get(key, value)) for key, value in self.noise.items()}
        return replace(self, noise=noise)

    def channels_of(self, estimate: Estimate) -> tuple[int, ...]:
        return self.rig.channels if estimate.channel is None else (estimate.channel,)

    # --- residuals --------------------------------------------------------------------------------------------------------
    def rms(self, simulated: Vector, channel: int) -> dict[tuple[int, str], float]:
        """RMS error by (log, signal) over the rows that count, SI."""
        errors = {(s.log, s.signal): s.left(simulated) for s in self.rig.segments[channel]}
        return {key: float(np.sqrt(np.mean(e * e))) if e.size else nan for key, e in errors.items()}

    def levels(self, simulated: Vector, channel: int) -> dict[str, float]:
        """By signal: how far the errors are above the noise, as the mean over blocks of log(power), 0 at the noise.

        Unlike an RMS it is not a matter of a few events, such as a spool that meets its end stop a millisecond late.
        """
        j, power = self._powers(simulated, channel)
        found = {}
        for number, signal in enumerate(j.signals):
            own = j.signal == number
            count = j.count[own]
            total = float(count @ np.log(power[own] / self.noise[channel, signal] ** 2))
            found[signal] = max(total / max(float(count.sum()), 1.0) - float(np.log(2.0)), 0.0)
        return found

    def level(self, estimate: Estimate) -> float:
        """The largest level of all signals of an estimate's channels."""
        found = (self.levels(estimate.simulated[c], c) for c in self.channels_of(estimate))
        return max(v for each in found for v in each.values())

    def at_noise(self, estimate: Estimate, within: float = WITHIN_NOISE) -> bool:
        """Whether no signal of any log is left with more than `within` times its noise."""
        left = {c: self.rms(estimate.simulated[c], c) for c in self.channels_of(estimate)}
        return all(v < within * self.noise[c, s] for c, own in left.items() for (_, s), v in own.items())

    # --- criteria ---------------------------------------------------------------------------------------------------------
    def could_pay(self, estimate: Estimate, channel: int) -> bool:
        """Whether a channel has a residual above its noise that could pay for an effect, or one that must not stay unexplained.

        A residual that goes on for long counts few independent samples, and the many more that are left when an effect explains
        it.
        """
        worth, seen = 0.0, False
        for s in self.rig.segments[channel]:
            error = s.left(estimate.simulated[channel])
            if error.size:
                ratio = float(np.mean(error**2)) / self.noise[channel, s.signal] ** 2
                seen = seen or ratio > ABOVE_NOISE
                worth += effective_samples(error) * max(np.log(ratio), 0.0)
        return seen and (worth > WORTH or self.unexplained(estimate, channel))

    def unexplained(self, estimate: Estimate, channel: int) -> bool:
        """Whether a residual stays that is clearly above the noise, in a signal of a log."""
        factor, left = self.settings.unexplained, self.rms(estimate.simulated[channel], channel)
        return any(v > factor * self.noise[channel, signal] for (_, signal), v in left.items())

    def mostly_explained(self, before: Estimate, after: Estimate, channel: int) -> bool:
        """Whether most of the residual that `before` leaves on a channel is explained by `after`, by level or by power.

        By level a few events count little, such as a spool that meets its end stop late in a model of another functional form;
        by power what is small everywhere counts little, such as the ripple that a steady model leaves.
        """
        old, new = (sum(self.levels(p.simulated[channel], channel).values()) for p in (before, after))
        by_level = new < SMALL_SUM or new < (1.0 - self.settings.level_share) * old
        was, left = (self.rms(p.simulated[channel], channel) for p in (before, after))
        noise = {k: self.noise[channel, k[1]] for k in left}
        excess = {k: left[k] ** 2 - noise[k] ** 2 for k in left if left[k] > CLEARLY_ABOVE * noise[k]}
        left_share = 1.0 - self.settings.power_share
        by_power = all(e < left_share * (was[k] ** 2 - noise[k] ** 2) for k, e in excess.items())
        return by_level or by_power

    def far_from_noise(self, estimate: Estimate) -> bool:
        """Whether more is left than a local minimum leaves."""
        return self.level(estimate) > SMALL_LEVEL

    # --- likelihood -------------------------------------------------------------------------------------------------------
    def _powers(self, simulated: Vector, channel: int) -> tuple[Joined, Vector]:
        """The samples of a channel, and the power of each block (b,): the mean square of the error plus the noise's."""
        j = self.rig.segments[channel].joined
        error = j.filled - simulated
        error *= j.used  # in place, as this is done for every simulation
        error *= error
        mean = np.add.reduceat(error, j.first) / np.maximum(j.count, 1.0)
        return j, mean + np.array([self.noise[channel, signal] ** 2 for signal in j.signals])[j.signal]

    def cost(self, estimate: Estimate, simulated: Samples, q: Vector) -> float:
        """Twice the negative log-likelihood with an unknown variance in every block, plus priors; inf for a failed simulation."""
        total = float(sum(v * v for u, v in zip(estimate.unknowns, q, strict=True) if u.prior))
        for channel in self.channels_of(estimate):
            if not np.isfinite(simulated[channel]).all():
                return np.inf
            j, power = self._powers(simulated[channel], channel)
            total += float(j.count @ np.log(power))
        return total

    def cost_of_noise(self, estimate: Estimate) -> float:
        """The cost of an error that is the noise alone, without priors."""
        segments = [s for c in self.channels_of(estimate) for s in self.rig.segments[c]]
        return sum(
            float(s.blocks[1].sum() * np.log(2.0 * self.noise[s.channel, s.signal] ** 2)) for s in segments
        )

    def evaluate(self, estimates: Sequence[Estimate]) -> None:
        """Simulates every estimate and sets `simulated` and `cost`."""
        for one, result in zip(estimates, self.rig.predict([p.request() for p in estimates]), strict=True):
            self.take(one, result)

    def take(self, estimate: Estimate, simulated: Samples) -> None:
        """Sets what was simulated at the estimate, and its cost."""
        estimate.simulated, estimate.cost = simulated, self.cost(estimate, simulated, estimate.q)

    def rescore(self, estimates: Sequence[Estimate]) -> None:
        """Sets `cost` again, for another noise."""
        for one in estimates:
            one.cost = self.cost(one, one.simulated, one.q)

    def weights(self, simulated: Vector, channel: int) -> Vector:
        """One over the standard deviation of every sample (n,), 0 for rows that do not count."""
        j, power = self._powers(simulated, channel)
        return j.used / np.sqrt(np.repeat(power, np.diff(j.first, append=simulated.size)))

    # --- likelihood ratio -------------------------------------------------------------------------------------------------
    def gain(self, smaller: Estimate, larger: Estimate, channels: Sequence[int] | None = None) -> float:
        """How much better `larger` explains the data: the fall of the deviance, counted in independent samples.

        As in the cost that is minimised, every block has a variance of its own: one effect of two is a gain although the
        events that only the other one explains raise any RMS.
        """
        own = self.channels_of(larger) if channels is None else channels
        return float(sum(self.gain_by_stretch(smaller, larger, c, BLOCK_S).sum() for c in own))

    def gain_by_stretch(self, smaller: Estimate, larger: Estimate, channel: int, stretch_s: float) -> Vector:
        """Fall of the deviance from `smaller` to `larger` (m,) in every stretch of a channel's logs, in independent samples.

        The share of samples that is independent is that of the signal with the longest memory: were every signal counted by
        its own, a current at its white noise would outweigh a pressure that is far off for seconds.
        """
        found: dict[tuple[int, int], float] = {}
        shares = []
        for s in self.rig.segments[channel]:
            if s.used.sum() < MIN_SAMPLES:
                continue
            floor = self.noise[channel, s.signal] ** 2
            number = s.stretches(stretch_s)
            errors = [s.error(p.simulated[channel]) for p in (smaller, larger)]
            weights = self.weights(larger.simulated[channel], channel)[s.place]
            shares.append(effective_samples((errors[1] * weights)[s.used]) / float(s.used.sum()))
            counts = np.bincount(number, s.used.astype(float))
            powers = [np.bincount(number, e * e) / np.maximum(counts, 1.0) + floor for e in errors]
            for n, value in enumerate(counts * np.log(powers[0] / powers[1])):
                found[s.log, n] = found.get((s.log, n), 0.0) + float(value)
        return min(shares, default=1.0) * np.array([found[key] for key in sorted(found)])

    # --- normal equations -------------------------------------------------------------------------------------------------
    def normal_equations(self, estimate: Estimate) -> tuple[Vector, Vector]:
        """Normal matrix (k, k) and right-hand side (k,) of the linearised estimation, priors included."""
        prior = np.array([1.0 if u.prior else 0.0 for u in estimate.unknowns])
        matrix, side = np.diag(prior), -prior * estimate.q
        for channel in self.channels_of(estimate):
            simulated, columns = estimate.simulated[channel], estimate.columns[channel]
            weights = self.weights(simulated, channel) ** 2
            error = self.rig.segments[channel].joined.filled - simulated
            for first in range(0, error.size, CACHED):
                rows = slice(first, first + CACHED)
                weighted = columns[rows].T * weights[rows]
                matrix += weighted @ columns[rows]
                side += weighted @ error[rows]
        return matrix.reshape(prior.size, prior.size), side

    def normal_equations_by_stretch(self, estimate: Estimate, stretch_s: float) -> tuple[Vector, Vector]:
        """Normal matrices (m, k, k) and right-hand sides (m, k), without priors, of m stretches of time of all logs.

        Samples count by the share of them that is independent.
        """
        size = len(estimate.unknowns)
        found: dict[tuple[int, int], tuple[Vector, Vector]] = {}
        for channel in self.channels_of(estimate):
            weights = self.weights(estimate.simulated[channel], channel)
            for s in self.rig.segments[channel]:
                if s.used.sum() < MIN_SAMPLES:
                    continue
                error = s.error(estimate.simulated[channel])
                share = effective_samples(error[s.used]) / float(s.used.sum())
                columns = estimate.columns[channel][s.place] * weights[s.place, None]
                number = s.stretches(stretch_s)
                for n in range(number[-1] + 1):
                    rows = number == n
                    matrix, side = found.setdefault((s.log, n), (np.zeros((size, size)), np.zeros(size)))
                    part = columns[rows]
                    matrix += share * (part.T @ part)
                    side += share * (part.T @ (error[rows] * weights[s.place][rows]))
        ordered = [found[key] for key in sorted(found)]
        return np.array([m for m, _ in ordered]), np.array([v for _, v in ordered])

"""The design of an experiment: 12 s of commands, and loads where the rig has been loaded, that show what the logs leave open.

Two things may be open, and the logarithms of both criteria are added up.

Which of several models is right. The criterion is the squared difference of two models' answers, in units of all that is not
known about it: the noise (or what the better model leaves of the logs, where that is more), the form of the laws, which no
machine keeps to exactly (`FORM`), and what either model's parameters leave open, as an ensemble of estimates that the logs
allow. What another value of a parameter would make up for counts for nothing. Box and Hill (1967), Technometrics 9, 57;
Buzzi-Ferraris and others (1984), Chem. Eng. Sci. 39, 81.

What the held-out logs will show. Their commands and loads are known beforehand, and simulations of estimates that the logs allow
may be far apart there: the scale of all torques is open where no load acted. The criterion is how far they would still be apart
with the experiment's log (V-optimality; Atkinson, Donev and Tobias 2007, Optimum Experimental Designs, section 10.6).

Search: the best of some random experiments, then coordinate exchange, Meyer and Nachtsheim (1995), Technometrics 37, 60: one
piece after the other is replaced by the best of some random ones. All pieces are simulated as part of the whole, so that what
changes slowly (a coil that heats up) counts.

An experiment is an array (T, 2, 2) with a row every `PERIOD`: for each channel the command as a share of the rated one and the
load in N m.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from ..measured import RigLog
from ..plant import PlantModel, scales_of
from ..plant.sensors import NOISE
from ..waveforms import triangle
from .estimation.estimate import Estimate
from .estimation.fit import Fit
from .estimation.uncertainty import intervals_of, replica_differences
from .input.parts import Part
from .models.base import BLOCK_S, SI, UNITS, Request
from .models.dynamic_rig import DynamicRig
from .settings import Settings
from .stages.values import SHAPE_BY_FORM

Array = np.ndarray

#: Period of the commands and length of an experiment, s; rests at both ends, longer than the shaft's memory
#: (`estimation.uncertainty`), and pieces in between, in periods.
PERIOD, SECONDS = 0.01, 12.0
REST, PIECE, PIECES = 24, 192, 6
#: Random experiments to begin with, and random pieces of which the best takes a place: two blocks of the kernel, and one.
FIRST, PIECES_TRIED = 16, 8
#: An effect may do this much more or less than its law says: less of a difference tells forms apart, not effects.
FORM = SHAPE_BY_FORM
#: Where every experiment goes beyond the pressure limit, commands are taken smaller by this factor, this many times at most: down
#: to an eighth.
SMALLER, MAX_TIMES_SMALLER = 0.6, 5


@dataclass(frozen=True)
class Question:
    """Which of these models is right: estimates of a channel (None: of the whole rig) by the name of what they contain."""

    channel: int | None
    models: Mapping[str, Estimate]


@dataclass(frozen=True)
class Operation:
    """What an estimate of a channel is to predict: `apart` (draws, draws) are mean products of how far the simulations of its
    draws are from its own on the held-out logs, in units of the noise, so that the trace is the mean square of all of them."""

    estimate: Estimate
    apart: Array

    @classmethod
    def of(cls, held_out: Fit, estimate: Estimate, channel: int) -> "Operation":
        """What an estimate with intervals is to predict of a channel on the held-out logs."""
        differences = [np.nan_to_num(rows) for _, rows in replica_differences(held_out, estimate, channel)]
        joined = np.concatenate(differences, axis=1)
        return cls(estimate, joined @ joined.T / joined.size)


@dataclass(frozen=True)
class Design:
    """Commands (T, 2) in V and loads (T, 2) in N m, one row every `PERIOD`, and for each pair of names how far their models are
    apart: RMS in units of what is not known. `prediction`: how far estimates are apart on the held-out logs now and, as expected,
    with the experiment, RMS in times the noise."""

    command_V: Array
    load: Array
    apart: Mapping[tuple[str, str], float]
    prediction: tuple[float, float] | None = None


# --- the family of experiments ----------------------------------------------------------------------------------------
def _piece(rng: np.random.Generator, size: float, max_load: float) -> Array:
    """A random piece (PIECE, 2). The command is a triangle, steps, a sine of rising frequency or a constant. In half of the
    pieces a load is on, from the beginning or from somewhere in the piece."""
    x = np.arange(PIECE) / PIECE
    kind = rng.integers(4)
    middle = rng.uniform(-0.7, 0.7) * rng.integers(2)
    swing = 0.05 * 20.0 ** rng.random() * rng.choice([-1.0, 1.0])
    cycles = 0.5 * 12.0 ** rng.random()
    steps, sweep = np.where((cycles * x) % 1.0 < 0.5, 1.0, -1.0), np.sin(np.pi * 4.0 * cycles * x * x)
    wave = (triangle(cycles * x), steps, sweep, np.ones(PIECE))[kind]
    load = rng.uniform(-max_load, max_load) * rng.integers(2) * (x >= rng.uniform(0.0, 0.7) * rng.integers(2))
    return size * np.column_stack([np.clip(middle + swing * wave, -1.0, 1.0), load])


def experiments_of(pieces: Array, limits: Settings) -> Array:
    """Pieces (..., PIECES, PIECE, 2, 2) between two rests as experiments within the limits of command and rate."""
    rest = np.zeros((*pieces.shape[:-4], REST, 2, 2))
    joined = pieces.reshape(*pieces.shape[:-4], PIECES * PIECE, 2, 2)
    out = np.concatenate([rest, joined, rest], axis=-3)
    wanted = np.clip(out[..., 0], -limits.command_limit, limits.command_limit)
    step = limits.rate_limit * PERIOD
    out[..., 0, :, 0] = 0.0
    for n in range(1, wanted.shape[-2]):
        last = out[..., n - 1, :, 0]
        out[..., n, :, 0] = last + np.clip(wanted[..., n, :] - last, -step, step)
    return out


def random_pieces(
    rng: np.random.Generator, count: int, size: float, max_load: float, pieces: int = PIECES
) -> Array:
    """Pieces (count, pieces, PIECE, 2, 2) of random experiments."""
    found = [[[_piece(rng, size, max_load) for _ in (0, 1)] for _ in range(pieces)] for _ in range(count)]
    return np.moveaxis(np.array(found), 2, 3)


def commands_csv(command_V: Array, load: Array) -> str:
    """Commands (T, 2) in V, and loads (T, 2) in N m if there are any, as the beginning of a rig log: one row every `PERIOD`, each
    held until the next."""
    loads = [f",{a:.3f},{b:.3f}" for a, b in load] if load.any() else [""] * len(load)
    head = "time_s,command_1_V,command_2_V" + (",load_1_Nm,load_2_Nm" if load.any() else "")
    rows = (f"{n * PERIOD:.2f},{a:.3f},{b:.3f}{loads[n]}" for n, (a, b) in enumerate(command_V))
    return "\n".join([head, *rows]) + "\n"


# --- the criterion ----------------------------------------------------------------------------------------------------
#: Mean square distances (experiments,) of the answers of all pairs of models of a question.
Distances = dict[tuple[str, str], Array]


def _distances(one: Array, other: Array, times: float) -> Array:
    """Mean squares (experiments,) of the difference, less what the ensembles say could be made up for (Woodbury's identity), if
    the experiment is done `times` times."""
    found = np.empty(one.shape[1])
    for n in range(found.size):
        a, b = one[:, n], other[:, n]
        known = np.sqrt(times / (1.0 + FORM**2 * np.maximum(_power(a[0] - a[1]), _power(b[0] - b[1]))))
        a, b = ((x * known).reshape(len(x), -1) for x in (a, b))
        difference = a[0] - b[0]
        open_ = np.concatenate([(x[2:] - x[0]) / np.sqrt(max(len(x) - 2, 1)) for x in (a, b)])
        inner = open_ @ difference
        absorbed = inner @ np.linalg.solve(np.eye(len(open_)) + open_ @ open_.T, inner)
        found[n] = max(float(difference @ difference - absorbed), 0.0) / difference.size
    return found


def _power(change: Array) -> Array:
    """Mean squares over blocks of `BLOCK_S` of signals (signals, T), repeated for every row."""
    rows = round(BLOCK_S / PERIOD)
    blocks = np.mean(change.reshape(len(change), -1, rows) ** 2, axis=-1)
    return np.repeat(blocks, rows, axis=-1)


def _scale(fit: Fit, models: Collection[Estimate], channel: int, signal: str) -> float:
    """The noise of a signal, or what the best of the models leaves of it where that is more; of one not logged the usual."""
    if (channel, signal) not in fit.noise:
        unit, size = UNITS[signal]
        usual = NOISE["pressure_bar" if unit == "bar" else f"{signal}_{unit}"] * size
        return usual * scales_of(fit.rig.model).factor(SI[unit])
    left = [fit.rms(p.simulated[channel], channel) for p in models]
    powers = [np.mean([v * v for (_, s), v in own.items() if s == signal]) for own in left]
    return max(fit.noise[channel, signal], float(np.sqrt(min(powers))))


#: What the requests of each model show, by channel (requests, n, signals, T), and whether a channel is allowed (n, 2).
Answers = tuple[list[dict[int, Array]], Array]


@dataclass(frozen=True)
class Trial:
    """Experiments on the models: what each question's models answer, what each channel's estimate would still leave open of the
    held-out logs, and which channels stay below the pressure limit. `more`: signals that are logged besides; `times`: how often
    the experiment is done."""

    fit: Fit
    questions: Sequence[Question]
    operations: Mapping[int, Operation] = field(default_factory=dict)
    more: Sequence[str] = ()
    times: float = 1.0

    @property
    def signals(self) -> list[str]:
        """The signals that are logged."""
        return [*self.fit.rig.signals, *self.more]

    @cached_property
    def _requests(self) -> list[list[Request]]:
        """For every model of every question, then for every operation: the estimate, the same without the effect in question (or
        without any), and others that the logs allow as well."""
        models = [(p, p.without(name)) for question in self.questions for name, p in question.models.items()]
        models += [(o.estimate, _without_effects(o.estimate)) for o in self.operations.values()]
        draws = {p: (p.intervals or intervals_of(self.fit, p)).draws for p, _ in models}
        return [[p.request(), bare.request(), *(p.request(q) for q in draws[p])] for p, bare in models]

    def read(self, answers: Answers) -> tuple[list[Distances], dict[int, Array]]:
        """How far apart the models of each question are: means over the signals that the logs have, but sums with `more`, since
        a sensor takes nothing away. By channel the mean squares (n,) by which estimates would still be apart on the held-out
        logs."""
        places = [[*UNITS].index(signal) for signal in self.signals]
        ensembles = ({c: v[:, :, places] for c, v in table.items()} for table in answers[0])
        times, apart = self.times * len(self.signals) / len(self.fit.rig.signals), []
        for question in self.questions:
            own = dict(zip(question.models, ensembles, strict=False))
            # One of the models may be of the whole rig, another one of a channel alone.
            shared = sorted(set.intersection(*(set(table) for table in own.values())))
            scales = {c: self._scales(question.models.values(), c) for c in shared}
            of = {name: {c: table[c] / scales[c] for c in shared} for name, table in own.items()}
            pairs = itertools.combinations(of, 2)
            found = {(a, b): [_distances(of[a][c], of[b][c], times) for c in shared] for a, b in pairs}
            apart.append({pair: np.mean(squares, axis=0) for pair, squares in found.items()})
        left = {c: self._left(c, table[c]) for c, table in zip(self.operations, ensembles, strict=True)}
        return apart, left

    def simulated(self, experiments: Array) -> Answers:
        """What the models show in every signal in experiments (n, T, 2, 2)."""
        rig = self.fit.rig
        assert isinstance(rig, DynamicRig)
        parts = [_part(each, rig.model, n) for n, each in enumerate(experiments)]
        own = DynamicRig(rig.model, parts, jobs=rig.jobs, progress=rig.progress, without=rig.without)
        results = own.predict([r for each in self._requests for r in each])
        # The segments of a channel are all signals of the first experiment, then those of the next one.
        every = [{c: v.reshape(len(parts), len(UNITS), -1) for c, v in result.items()} for result in results]
        allowed, pressure = np.ones((len(parts), 2), bool), [*UNITS].index("pressure")
        for table in every:
            for c, values in table.items():
                peak = np.abs(values[:, pressure]).max(axis=-1)
                # A comparison with NaN is false: what diverges is not allowed either.
                allowed[:, c] &= peak <= _max_pressure(rig.model, c, self.fit.settings)
        each = iter(every)
        grouped = [[*itertools.islice(each, len(requests))] for requests in self._requests]
        return [{c: np.nan_to_num([t[c] for t in own]) for c in own[0]} for own in grouped], allowed

    def _scales(self, models: Collection[Estimate], channel: int) -> Array:
        """What cannot be known of each signal (signals, 1)."""
        return np.array([[_scale(self.fit, models, channel, signal)] for signal in self.signals])

    def _left(self, channel: int, table: Array) -> Array:
        """Mean squares (n,) by which the simulations of the held-out logs would still be apart, in units of the noise, of the
        `table` (2 + draws, n, signals, T) of an operation."""
        operation = self.operations[channel]
        seen = table / self._scales([operation.estimate], channel)
        left = np.empty(table.shape[1])
        for n in range(left.size):
            whole, bare, *draws = seen[:, n]
            known = np.sqrt(self.times / (1.0 + FORM**2 * _power(whole - bare)))
            off = ((np.array(draws) - whole) * known).reshape(len(draws), -1) / np.sqrt(len(draws))
            left[n] = np.trace(np.linalg.solve(np.eye(len(off)) + off @ off.T, operation.apart))
        return left

    def distances(self, answers: Answers) -> dict[tuple[str, str], float]:
        """How far the models of each pair are apart in one experiment, RMS in units of what is not known."""
        return {pair: float(np.sqrt(d[0])) for each in self.read(answers)[0] for pair, d in each.items()}

    def scores(self, answers: Answers) -> Array:
        """How good experiments are for each channel (n, 2), a natural logarithm; -inf beyond the pressure limit.

        A pair that is as far apart as what is not known counts as separated, and more for nothing."""
        apart, left = self.read(answers)
        allowed, rows = answers[1], round(SECONDS / PERIOD)
        found = np.zeros(allowed.shape)
        for question, squares in zip(self.questions, apart, strict=True):
            own = [c for c in (0, 1) if question.channel in (None, c)]
            for d in squares.values():
                found[:, own] += (np.log1p(d * rows) - np.log1p(d))[:, None]
        for c, mean_square in left.items():
            found[:, c] -= np.log1p(mean_square)
        return np.where(allowed, found, -np.inf)


def _max_pressure(model: PlantModel, channel: int, limits: Settings) -> float:
    """The load pressure of a channel that no model may exceed, Pa."""
    if limits.pressure_limit is not None:
        return limits.pressure_limit
    having = ("pressure_dependent_flow", "external_leakage", "case_drain", "anti_cavitation")
    return min(model.value(f"{effect}.supply_pressure", channel) for effect in having)


def _without_effects(estimate: Estimate) -> Estimate:
    for effect, channel in estimate.placed_effects():
        estimate = estimate.without(effect, channel if estimate.channel is None else estimate.channel)
    return estimate


def _part(experiment: Array, model: PlantModel, number: int) -> Part:
    """A log of an experiment in which every signal is asked for."""
    names = ("speed", "current", "pressure", "spool", "flow", "pressure_a", "pressure_b", "motor_pressure")
    asked: dict[str, Any] = dict.fromkeys(names, np.zeros(experiment.shape[:2]))
    time, command = np.arange(len(experiment)) * PERIOD, experiment[..., 0] * np.array(model.pair("u_rated"))
    log = RigLog(time, command, load=experiment[..., 1], name=str(number), **asked)
    return Part(str(number), log, np.ones(len(experiment), bool))


# --- the search -------------------------------------------------------------------------------------------------------
def best_design(trial: Trial, rng: np.random.Generator, max_load: float = 0.0) -> Design | None:
    """The experiment that was found to show best what is open; None where none keeps below the pressure limit.

    `max_load`: largest load in N m.
    """
    settings, size = trial.fit.settings, 1.0
    for _ in range(MAX_TIMES_SMALLER):
        pieces = random_pieces(rng, FIRST, size, max_load)
        scores = trial.scores(trial.simulated(experiments_of(pieces, settings)))
        if np.isfinite(scores).any(axis=0).all():
            break
        size *= SMALLER
    else:
        return None
    best = np.argmax(scores, axis=0)
    chosen = np.stack([pieces[best[c], :, :, c] for c in (0, 1)], axis=-2)
    reached = scores[best, [0, 1]]
    for place in range(PIECES):
        tried = np.repeat(chosen[None], PIECES_TRIED, axis=0)
        tried[:, place] = random_pieces(rng, PIECES_TRIED, size, max_load, 1)[:, 0]
        scores = trial.scores(trial.simulated(experiments_of(tried, settings)))
        best = np.argmax(scores, axis=0)
        for c in (0, 1):
            if scores[best[c], c] > reached[c]:
                chosen[place, :, c], reached[c] = tried[best[c], place, :, c], scores[best[c], c]
    return _described(trial, experiments_of(chosen, settings))


def _described(trial: Trial, experiment: Array) -> Design:
    answers = trial.simulated(experiment[None])
    left, prediction = trial.read(answers)[1], None
    if left:
        now = max(float(np.trace(each.apart)) for each in trial.operations.values())
        prediction = np.sqrt(now), np.sqrt(max(float(each[0]) for each in left.values()))
    rated = np.array(trial.fit.rig.model.pair("u_rated"))
    return Design(experiment[..., 0] * rated, experiment[..., 1], trial.distances(answers), prediction)

"""The design of an experiment: 12 s of commands for which models that explain the logs so far answer most differently.

Criterion: the squared difference of two models' answers, in units of all that is not known about it. That is the noise (or what
the better model leaves of the logs, where that is more), the form of the laws, which no machine keeps to exactly (`FORM`), and
what either model's parameters leave open, as an ensemble of estimates that the logs allow. What another value of a parameter
would make up for counts for nothing. Box and Hill (1967), Technometrics 9, 57; Buzzi-Ferraris and others (1984), Chem. Eng.
Sci. 39, 81.

Search: the best of some random experiments, then coordinate exchange, Meyer and Nachtsheim (1995), Technometrics 37, 60: one
piece after the other is replaced by the best of some random ones. All pieces are simulated as part of the whole, so that what
changes slowly (a coil that heats up) counts.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..measured import RigLog
from ..plant import PlantModel
from ..plant.sensors import NOISE
from ..waveforms import triangle
from .estimation import Estimate, Fit, intervals_of
from .input.parts import Part
from .models.base import BLOCK_S, UNITS, Request
from .models.dynamic_rig import DynamicRig
from .settings import Settings

__all__ = ["SECONDS", "Design", "Question", "Trial", "best_design", "commands_csv", "random_design"]

Array = np.ndarray

#: Period of the commands and length of an experiment, s; rests at both ends and pieces in between, in periods.
PERIOD, SECONDS = 0.01, 12.0
REST, PIECE, PIECES = 24, 192, 6
#: Random experiments to begin with, and random pieces of which the best takes a place.
FIRST, PIECES_TRIED = 16, 8
#: An effect may do this much more or less than its law says: less of a difference tells forms apart, not effects.
FORM = 0.1
#: Where every experiment goes beyond the pressure limit, commands are taken smaller by this factor, so many times at most.
SMALLER, TIMES_SMALLER = 0.6, 5


@dataclass(frozen=True)
class Question:
    """Which of these models is right: estimates of a channel (None: of the whole rig) by the name of what they contain."""

    channel: int | None
    models: Mapping[str, Estimate]

    def concerns(self, channel: int) -> bool:
        return self.channel in (None, channel)


@dataclass(frozen=True)
class Design:
    """Commands (T, 2) in V, one row every `PERIOD`, and for each pair of names how far their models are apart: RMS in units of
    what is not known. `signals` is the same by signal, of all that could be logged."""

    command_V: Array
    apart: Mapping[tuple[str, str], float]
    signals: Mapping[tuple[str, str], Mapping[str, float]]

    @property
    def least(self) -> float:
        return min(self.apart.values())


# --- the family of commands -------------------------------------------------------------------------------------------
def _piece(rng: np.random.Generator, size: float) -> Array:
    """A random piece (PIECE,) as a share of the rated command: triangle, steps, a sine of rising frequency, or a constant."""
    x = np.arange(PIECE) / PIECE
    kind = rng.integers(4)
    middle = rng.uniform(-0.7, 0.7) * rng.integers(2)
    swing = 0.05 * 20.0 ** rng.random() * rng.choice([-1.0, 1.0])
    cycles = 0.5 * 12.0 ** rng.random()
    wave = (
        triangle(cycles * x),
        np.where((cycles * x) % 1.0 < 0.5, 1.0, -1.0),
        np.sin(np.pi * 4.0 * cycles * x * x),
        np.ones(PIECE),
    )[kind]
    return size * np.clip(middle + swing * wave, -1.0, 1.0)


def _whole(pieces: Array, limits: Settings) -> Array:
    """Pieces (..., PIECES, PIECE, 2) between two rests as commands (..., T, 2) within the limits of command and rate."""
    rest = np.zeros((*pieces.shape[:-3], REST, 2))
    joined = pieces.reshape(*pieces.shape[:-3], PIECES * PIECE, 2)
    wanted = np.clip(
        np.concatenate([rest, joined, rest], axis=-2), -limits.command_limit, limits.command_limit
    )
    step = limits.rate_limit * PERIOD
    out = np.zeros_like(wanted)
    for n in range(1, wanted.shape[-2]):
        out[..., n, :] = out[..., n - 1, :] + np.clip(wanted[..., n, :] - out[..., n - 1, :], -step, step)
    return out


def _drawn(rng: np.random.Generator, count: int, size: float, pieces: int = PIECES) -> Array:
    """Random experiments (count, pieces, PIECE, 2)."""
    found = [[[_piece(rng, size) for _ in (0, 1)] for _ in range(pieces)] for _ in range(count)]
    return np.moveaxis(np.array(found), 2, 3)


def random_design(model: PlantModel, limits: Settings, rng: np.random.Generator) -> Array:
    """A random experiment of the family, commands (T, 2) in V."""
    return _whole(_drawn(rng, 1, 1.0)[0], limits) * np.array(model.pair("u_rated"))


def commands_csv(command_V: Array) -> str:
    """Commands (T, 2) in V as the beginning of a rig log: one row every `PERIOD`, each held until the next."""
    rows = (f"{n * PERIOD:.2f},{a:.3f},{b:.3f}\n" for n, (a, b) in enumerate(command_V))
    return "time_s,command_1_V,command_2_V\n" + "".join(rows)


# --- the criterion ----------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class _Answers:
    """What the models of a question answer to every experiment: by name and channel (2 + draws, experiments, signals, T) in
    units of the noise; the first is the estimate, the second the same without the effect of that name."""

    question: Question
    of: Mapping[str, Mapping[int, Array]]

    def apart(self, signals: Sequence[int]) -> dict[tuple[str, str], Array]:
        """Mean square distances of all pairs of models (experiments,), by some of the signals."""
        return {
            (one, other): np.mean([_distances(self.of[one][c], self.of[other][c], signals) for c in self.of[one]], axis=0)
            for one, other in itertools.combinations(self.question.models, 2)
        }  # fmt: skip


def _distances(one: Array, other: Array, signals: Sequence[int]) -> Array:
    """Mean squares (experiments,) of the difference, less what the ensembles say could be made up for (Woodbury's identity)."""
    found = np.empty(one.shape[1])
    for n in range(found.size):
        a, b = (x[:, n, signals] for x in (one, other))
        known = 1.0 / np.sqrt(1.0 + FORM**2 * np.maximum(_power(a[0] - a[1]), _power(b[0] - b[1])))
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


def _scale(fit: Fit, question: Question, channel: int, signal: str) -> float:
    """The noise of a signal, or what the better model leaves of it where that is more; of one that is not logged the usual."""
    if (channel, signal) not in fit.noise:
        unit, size = UNITS[signal]
        return NOISE["pressure_bar" if unit == "bar" else f"{signal}_{unit}"] * size
    left = [
        np.sqrt(
            np.mean([v * v for (_, s), v in fit.rms(p.simulated[channel], channel).items() if s == signal])
        )
        for p in question.models.values()
    ]
    return max(fit.noise[channel, signal], float(min(left)))


@dataclass(frozen=True)
class Trial:
    """Experiments on the models: what each question's models answer, and which channels stay below the pressure limit."""

    fit: Fit
    questions: Sequence[Question]

    @cached_property
    def _draws(self) -> dict[int, Array]:
        """Estimates that the logs allow as well, (draws, k) by model."""
        models = [p for question in self.questions for p in question.models.values()]
        return {id(p): (p.intervals or intervals_of(self.fit, p)).draws for p in models}

    def run(self, shares: Array) -> tuple[list[_Answers], Array]:
        """Simulates experiments (n, T, 2), shares of the rated command. Also whether a channel is allowed (n, 2)."""
        rig = self.fit.rig
        assert isinstance(rig, DynamicRig)
        parts = [_part(share * np.array(rig.model.pair("u_rated")), n) for n, share in enumerate(shares)]
        own = DynamicRig(rig.model, parts, jobs=rig.jobs, progress=rig.progress, without=rig.without)
        wanted: list[tuple[int, str]] = []
        requests: list[Request] = []
        for number, question in enumerate(self.questions):
            for name, estimate in question.models.items():
                bare = estimate.without(name)
                own_requests = [
                    estimate.request(),
                    bare.request(),
                    *(estimate.request(q) for q in self._draws[id(estimate)]),
                ]
                wanted += [(number, name)] * len(own_requests)
                requests += own_requests
        try:
            results = own.predict(requests)
        finally:
            own.close()
        allowed = np.ones((len(shares), 2), bool)
        signals = list(UNITS)
        found: list[dict[str, dict[int, list[Array]]]] = [{} for _ in self.questions]
        for (number, name), result in zip(wanted, results, strict=True):
            for c, values in result.items():
                table = np.array(
                    [[values[s.place] for s in own.segments[c] if s.log == n] for n in range(len(parts))]
                )
                peak = np.abs(table[:, signals.index("pressure")]).max(axis=-1)
                # A comparison with NaN is false: what diverges is not allowed either.
                allowed[:, c] &= peak <= _most_pressure(rig.model, c, self.fit.settings)
                scale = np.array([_scale(self.fit, self.questions[number], c, s) for s in signals])
                found[number].setdefault(name, {}).setdefault(c, []).append(
                    np.nan_to_num(table) / scale[:, None]
                )
        answers = [
            _Answers(q, {name: {c: np.array(v) for c, v in of.items()} for name, of in each.items()})
            for q, each in zip(self.questions, found, strict=True)
        ]
        return answers, allowed

    def logged(self) -> list[int]:
        """Places of the logged signals in the list of all."""
        assert isinstance(self.fit.rig, DynamicRig)
        return [n for n, s in enumerate(UNITS) if s in self.fit.rig.signals]

    def scores(self, shares: Array) -> Array:
        """How good experiments are for each channel (n, 2); -inf beyond the pressure limit.

        The logarithm keeps a pair that is far apart already from outweighing one that is not."""
        answers, allowed = self.run(shares)
        found = np.zeros((len(shares), 2))
        for each in answers:
            score = sum(np.log1p(d * shares.shape[1]) for d in each.apart(self.logged()).values())
            for c in (0, 1):
                found[:, c] += score if each.question.concerns(c) else 0.0
        return np.where(allowed, found, -np.inf)


def _most_pressure(model: PlantModel, channel: int, limits: Settings) -> float:
    """The load pressure of a channel that no model may exceed, Pa."""
    if limits.pressure_limit is not None:
        return limits.pressure_limit
    return min(
        model.value(f"{e}.supply_pressure", channel)
        for e in ("pressure_dependent_flow", "external_leakage", "anti_cavitation")
    )


def _part(command_V: Array, number: int) -> Part:
    """A log of these commands in which every signal is asked for."""
    rows = len(command_V)
    empty = np.zeros((rows, 2))
    log = RigLog(
        np.arange(rows) * PERIOD, command_V, empty, current=empty, pressure=empty, spool=empty, flow=empty,
        pressure_a=empty, pressure_b=empty, name=str(number),
    )  # fmt: skip
    return Part(str(number), log, np.ones(rows, bool))


# --- the search -------------------------------------------------------------------------------------------------------
def best_design(fit: Fit, questions: Sequence[Question], rng: np.random.Generator) -> Design | None:
    """The experiment that was found to part the models of all questions best; None where none keeps below the pressure limit.

    fit        the model of the rig with the logs so far, of which the questions' estimates are
    questions  at least one
    """
    trial = Trial(fit, questions)
    size = 1.0
    for _ in range(TIMES_SMALLER):
        pieces = _drawn(rng, FIRST, size)
        scores = trial.scores(_whole(pieces, fit.settings))
        if np.isfinite(scores).any(axis=0).all():
            break
        size *= SMALLER
    else:
        return None
    best = np.argmax(scores, axis=0)
    chosen = np.stack([pieces[best[c], ..., c] for c in (0, 1)], axis=-1)
    reached = scores[best, [0, 1]]
    for place in range(PIECES):
        tried = np.repeat(chosen[None], PIECES_TRIED, axis=0)
        tried[:, place] = _drawn(rng, PIECES_TRIED, size, 1)[:, 0]
        scores = trial.scores(_whole(tried, fit.settings))
        best = np.argmax(scores, axis=0)
        for c in (0, 1):
            if scores[best[c], c] > reached[c]:
                chosen[place, :, c], reached[c] = tried[best[c], place, :, c], scores[best[c], c]
    return _described(trial, _whole(chosen, fit.settings))


def _described(trial: Trial, share: Array) -> Design:
    answers, _ = trial.run(share[None])
    logged, names = trial.logged(), list(UNITS)

    def of(signals: Sequence[int]) -> dict[tuple[str, str], float]:
        return {pair: float(np.sqrt(d[0])) for each in answers for pair, d in each.apart(signals).items()}

    by_signal = {name: of([n]) for n, name in enumerate(names)}
    apart = of(logged)
    signals = {pair: {name: by_signal[name][pair] for name in names} for pair in apart}
    return Design(share * np.array(trial.fit.rig.model.pair("u_rated")), apart, signals)

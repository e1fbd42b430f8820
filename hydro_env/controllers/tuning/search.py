"""The search for gains: what a set of gains costs, and differential evolution over a batch of rigs.

The cost of one episode, in rpm, is
    tracking_mae_rpm + weight (max_speed_difference_rpm + 2 rms_speed_difference_rpm) + 5 command_variation:
the mean error of both motors to the set-point, plus the difference between them, which counts double by default since
moving together is the task. Its peak alone would not do: gains that limit-cycle, by as much as the last reversal takes the
motors apart, would cost nothing. Nor would commands full of noise, which wear valves out. Motors at rest do not part: the
tracking error beyond the mark from which the benchmark calls a controller idle counts tenfold. The cost of a set of gains is its
mean over pairs and scenarios.

Differential evolution (SciPy) searches the gains on the scale their `Gain` names; a whole generation is one batch of rigs. All
candidates drive the same pairs with the same noise. Known gains are candidates of the first generation (`tuning.tune`). The
best of the last one are compared on other pairs, since gains that suit the few pairs of a search best do not suit all.
Only the split `train` may be used, or the plant's own pair.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib.metadata import version
from math import inf, log
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from tqdm import tqdm

from hydro_env.controllers.base import FRACTION_PER_V, Controller, Floats, Gain, Measurements
from hydro_env.controllers.registry import law_of
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError, place_of
from hydro_env.plant import PAPER, load_model, scales_of, simulate
from hydro_env.tasks import OWN, default_mismatch, load_scenario
from hydro_env.tasks.metrics import IDLE
from hydro_env.units import RPM

#: Candidates of a generation: about three for each of up to eight gains.
POPULATION = 24
#: Pairs of valves that a set of gains drives in every scenario, and how many sets are tried, where nothing else is asked for.
#: Of the plant's own pair these are twelve episodes with other noise and set-points: gains that fit a few suit no others.
CASES, TRIALS = 12, 480
EPISODES = 2 * CASES * TRIALS
#: Of the last generation, compared on other pairs, in as many episodes as a generation takes.
FINALISTS = 6
#: Gains nearer than this share of their range to its end are said to have ended there.
AT_END = 0.01
SCENARIOS = "setpoint_steps", "random_steps"
COSTS = ("tracking_mae_rpm", "max_speed_difference_rpm", "rms_speed_difference_rpm", "command_variation")
#: How many rpm of the peak difference one of the RMS difference is worth, how many rpm of tracking error one whole rated command
#: a second, and one rpm of it beyond the mark of the idle.
RMS, WEAR, IDLING = 2.0, 5.0, 10.0
#: Ranges reach down to known gains divided by this: a stiff rig takes less than the least that the paper's may need.
ROOM = 10.0


@dataclass(frozen=True)
class Task:
    """The law, and what it is tuned for.

    law: as for `law_of`. weight: rpm of tracking error that one rpm of the peak difference is worth. plant: preset or model
    file. mismatch: "train", or None ("own", "none") for the plant's own pair of valves; "auto": "own" for a plant file that
    sets what "train" draws. scenarios: count equally.
    """

    law: str = "pid"
    weight: float = 2.0
    plant: str = "paper_dead_zone"
    mismatch: str | None = "train"
    scenarios: tuple[str, ...] = SCENARIOS

    def __post_init__(self) -> None:
        pairs = default_mismatch(self.plant) if self.mismatch == "auto" else self.mismatch
        object.__setattr__(self, "mismatch", None if pairs in (OWN, "none") else pairs)


@dataclass(frozen=True)
class Search:
    """One search.

    cases: pairs of valves each candidate drives in each scenario (seeds `seed`, `seed + 1`, ...). episodes: the budget, how
    many may be simulated in all. period: of control, s.
    """

    task: Task
    seed: int = 0
    period: float = 0.01
    cases: int = CASES
    episodes: int = EPISODES
    progress: bool = True

    @property
    def generation(self) -> int:
        """Episodes of a generation."""
        return self.cases * POPULATION * len(self.task.scenarios)


def search(wanted: Search, known: Sequence[Mapping[str, float]] = ()) -> dict[str, Any]:
    """{"gains", "tuning"}; gains that are `known` beforehand are candidates of the first generation.

    InputError for a control law or split that may not be tuned on, or a budget below three generations.
    """
    wanted = _checked(wanted)
    task, generations = wanted.task, wanted.episodes // wanted.generation - 1
    law = law_of(task.law)
    bounds = _bounds(law, known)
    first = _latin_hypercube(bounds, np.random.default_rng(wanted.seed))
    for row, gains in enumerate(known, 1):
        first[row] = _genes(law, gains, bounds)
    bar = tqdm(
        total=(generations + 1) * wanted.generation, desc=f"{task.law} {wanted.period:g} s", unit="episode",
        disable=not wanted.progress,
    )  # fmt: skip
    trials = _Trials(wanted, law, bounds, bar)
    with bar, _users_errors():
        found = differential_evolution(
            trials.costs, bounds, init=first, maxiter=generations - 1,
            rng=np.random.default_rng(wanted.seed), vectorized=True, updating="deferred", mutation=(0.4, 0.9),
            recombination=0.9, polish=False, tol=0.0,
        )  # fmt: skip
        best, told = trials.final(found.population, found.population_energies, known)
    found_gains = _named(law, _values(law, best))
    if found_gains.get("slew", 0.0) * FRACTION_PER_V * wanted.period >= 2.0:
        del found_gains["slew"]  # the whole range within one period: no limit
    size = scales_of(load_model(task.plant)) if law.similar else PAPER
    sizes = {gain.name: gain.size(size) for gain in law.GAINS}
    told["trials"] = POPULATION * found.nfev  # SciPy counts generations
    told["episodes"] = (found.nfev + 1) * wanted.generation
    ends = _ends(law, best, bounds)
    told["at_end_of_range"] = {name: end for name, end in ends.items() if name in found_gains}
    return {
        "gains": {key: float(f"{value * sizes[key]:.4g}") for key, value in found_gains.items()},
        "tuning": _account(wanted, generations, known) | told,
    }


@dataclass
class _Trials:
    """Candidates that drive, all at once, and the least cost so far after every generation."""

    wanted: Search
    law: type[Controller]
    bounds: Floats
    bar: tqdm
    lowest: list[float] = field(default_factory=list)

    def costs(self, genes: Floats) -> Floats:
        """Costs (candidates,) of genes (gains, candidates) of a generation."""
        begin = self.wanted.seed
        costs = self._on(range(begin, begin + self.wanted.cases), genes)
        self.lowest.append(min([float(np.min(costs)), *self.lowest[-1:]]))
        return costs

    def _on(self, seeds: range, genes: Floats) -> Floats:
        columns = np.repeat(_values(self.law, genes), len(seeds), axis=1)[:, :, None]
        tried = self.law(self.wanted.task.law, **_named(self.law, columns))
        return self._cost(tried.carry(), genes.shape[1], seeds, self.bar)

    def _cost(self, controller: Any, count: int, seeds: range, bar: tqdm | None = None) -> Floats:
        """Costs (count,) of `count` sets of gains that `controller` holds, a row of gains for each pair of `seeds` in turn."""
        task = self.wanted.task
        total, wear = np.zeros(count), WEAR * scales_of(load_model(task.plant)).speed
        for scenario in task.scenarios:
            done = roll_out(
                controller, list(seeds) * count, plant=task.plant, mismatch=task.mismatch, scenario=scenario,
                control_period=self.wanted.period, dtype="float32",
            )  # fmt: skip
            tracking, peak, rms, variation = (done.metrics(COSTS)[name] for name in COSTS)
            beyond = np.maximum(tracking - IDLE * np.abs(done.trace.setpoint_rpm).mean(axis=0), 0.0)
            costs = tracking + task.weight * (peak + RMS * rms) + wear * variation + (IDLING - 1.0) * beyond
            total += costs.reshape(count, len(seeds)).mean(axis=1) / len(task.scenarios)
            if bar is not None:
                bar.update(len(done.returns))
        return total

    def final(
        self, population: Floats, costs: Floats, known: Sequence[Mapping[str, float]]
    ) -> tuple[Floats, dict[str, Any]]:
        """The best of the last generation (candidates, gains) on other pairs, and what there is to tell: what it, the first of
        the `known` gains and motors at rest cost there, and what the last quarter of the search has gained.
        """
        first = [_genes(self.law, gains, self.bounds) for gains in known[:1]]
        order = np.argsort(costs, kind="stable")[: FINALISTS - len(first)]
        genes = np.array([*population[order], *first])
        begin = self.wanted.seed + self.wanted.cases
        seeds = range(begin, begin + self.wanted.cases * POPULATION // FINALISTS)
        found = self._on(seeds, genes.T)
        best = int(np.argmin(found))
        rest = self._cost(_Rest(), 1, seeds)
        late = self.lowest[-1 - len(self.lowest) // 4]
        told: dict[str, Any] = {
            "cost": _short(found[best]),
            "judged_on": len(seeds),
            "last_quarter_gained_percent": _short(100.0 * (1.0 - self.lowest[-1] / late)),
            "at_rest": _short(rest[0]),
        }
        if known:
            told["start"] = _short(found[-1])
        return genes[best], told


class _Rest(Controller):
    """Commands of zero: what it costs to do nothing."""

    def command(self, measured: Measurements) -> Floats:
        return np.zeros_like(measured.speed)


def _short(value: float) -> float:
    return float(f"{value:.5g}")


def _ends(law: type[Controller], genes: Floats, bounds: Floats) -> dict[str, float]:
    """Gains that lie at an end of the range that is searched, with the share of the range they lie at: 0 or 1."""
    low, high = bounds.T
    shares = _named(law, (genes - low) / (high - low))
    return {name: round(share) for name, share in shares.items() if abs(share - round(share)) < AT_END}


def _named(law: type[Controller], values: Floats) -> dict[str, Any]:
    """Values (gains, ...) by the names of the law's gains."""
    return dict(zip((gain.name for gain in law.GAINS), values, strict=True))


@contextmanager
def _users_errors() -> Iterator[None]:
    """Turns what a user's controller raises, which SciPy wraps, into an InputError with file and line."""
    try:
        yield
    except Exception as problem:
        first: BaseException = problem
        while first.__context__ is not None:
            first = first.__context__
        if not (place := place_of(first)):
            raise
        raise InputError(f"{place}: {type(first).__name__}: {first}") from None


def _checked(wanted: Search) -> Search:
    """The search with the names of its scenarios."""
    task = wanted.task
    if task.mismatch not in ("train", None):
        raise InputError(f"mismatch {task.mismatch!r}: tune on 'train' or 'own', never on other splits")
    task = replace(task, scenarios=tuple(load_scenario(each.strip()).name for each in task.scenarios))
    load_model(task.plant)  # here, since SciPy hides what goes wrong inside of a search
    least = 3 * wanted.generation
    if wanted.cases < 1 or wanted.episodes < least:
        raise InputError(f"episodes {wanted.episodes}: {wanted.cases} cases need at least {least}")
    return replace(wanted, task=task)


def _account(wanted: Search, generations: int, known: Sequence[Mapping[str, float]]) -> dict[str, Any]:
    """What a gains file says of the search, for who reads or repeats it."""
    task = wanted.task
    return {
        "split": task.mismatch,
        "plant": str(task.plant),
        "scenarios": list(task.scenarios),
        "cases": wanted.cases,
        "seed": wanted.seed,
        "control_period_s": wanted.period,
        "objective": f"mean over pairs and scenarios of tracking_mae_rpm + {task.weight:g} (max_speed_difference_rpm + {RMS:g} "
        f"rms_speed_difference_rpm) + {WEAR:g} command_variation; tracking beyond {IDLE:g} of that at rest {IDLING:g} times",
        "optimiser": f"differential evolution, population {POPULATION}, {generations} generations",
        "began_with": [dict(gains) for gains in known],
        "plant_dtype": "float32",
        "version": version("hydro_env"),
        "plant_drive_rpm": list(drive(task.plant)),
    }


@lru_cache
def drive(plant: str) -> tuple[float, float]:
    """Speeds (rpm) of both motors of a plant after a fixed drive of 0.65 s: gains belong to a plant that still drives so."""
    levels = np.repeat([0.0, 0.4, -0.5, 0.6, 0.3], [10, 20, 15, 10, 11])
    volts = levels[:, None] * np.array(load_model(plant).pair("u_rated"))
    speed = simulate(load_model(plant), volts, None, 0.01, record=("speed",))["speed"][-1, 0]
    return round(float(speed[0] / RPM), 2), round(float(speed[1] / RPM), 2)


def _bounds(law: type[Controller], known: Sequence[Mapping[str, float]]) -> Floats:
    """Where to search, (gains, 2): the logarithm of gains on a logarithmic scale."""

    def of(gain: Gain) -> tuple[float, float]:
        if not gain.log:
            return gain.low, gain.high
        low = min(gain.low, *(gains.get(gain.name, inf) / ROOM for gains in known), inf)
        return log(low), log(gain.high)

    return np.array([of(gain) for gain in law.GAINS])


def _values(law: type[Controller], genes: Floats) -> Floats:
    """Gains for what the search works with, both (gains, ...)."""
    return np.stack([np.exp(x) if gain.log else x for gain, x in zip(law.GAINS, genes, strict=True)])


def _genes(law: type[Controller], gains: Mapping[str, float], bounds: Floats) -> Floats:
    """What the search works with for known gains, (gains,); one that is left out at the end of its range next to its default."""

    def of(gain: Gain) -> float:
        value = gains.get(gain.name, gain.default)
        value = inf if value is None else value
        return log(value) if gain.log else value

    return np.clip([of(gain) for gain in law.GAINS], *bounds.T)


def _latin_hypercube(bounds: Floats, rng: np.random.Generator) -> Floats:
    """First generation (POPULATION, gains): every gain's range is cut into equal parts, each used once; the first candidate is
    the middle of all ranges."""
    parts = np.stack([rng.permutation(POPULATION) for _ in bounds], axis=1)
    share = (parts + rng.random(parts.shape)) / POPULATION
    share[0] = 0.5
    return bounds[:, 0] + share * (bounds[:, 1] - bounds[:, 0])

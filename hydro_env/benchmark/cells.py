"""The cells of a benchmark: one controller on one split and scenario, driven, scored and summed up.

Case i of a split is what a reset with seed `seed + first + i` draws: pair of valves, noise and all. Every controller meets the
same cases, so that scores may be compared case by case. A controller that raises, returns something that is not a command, or
lets the plant diverge is named and counted as failed where it did so; the rest go on.
"""

import copy
import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.benchmark.statistics import Summary, iqm, mean_of, normalised, scaled, summarise
from hydro_env.benchmark.suite import BASELINE, BOUND, PEAK, RETURN, TRACKING, Suite
from hydro_env.controllers.registry import make_controller, source_of
from hydro_env.controllers.rollout import roll_out
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.errors import InputError, shown
from hydro_env.parallel import Failure, Store
from hydro_env.parallel import run as run_tasks
from hydro_env.tasks import METRICS, Metric, Trace, never_settled
from hydro_env.tasks.metrics import IDLE

SCORE = Metric(
    "normalised_score", "normalised score", "",
    f"the return on a scale that is 0 at the interquartile mean of {BASELINE} and 100 at that of {BOUND}, in each split and "
    "scenario; more is better",
    lambda trace: trace.returns, more=True,
)  # fmt: skip
#: The metrics of scores.json by name.
SCORED = METRICS | {SCORE.name: SCORE}
#: Of the plant that every controller meets: half the time of float64, and scores move as they do with other steps
#: (docs/reference/benchmark.md, Precision).
DTYPE = "float32"
#: S that a controller may take for one split and scenario, by default: 200 rigs for 8 s are 160,000 commands to each valve.
LIMIT = 600.0
#: Of a controller's name.
MAX_LETTERS = 200
#: How many samples of a trace the page keeps, about: those with the largest difference.
TRACE_SAMPLES = 120


@dataclass
class Cell:
    """One controller on one split and scenario: what is to be run, then what came of it."""

    controller: Any
    name: str
    split: str
    scenario: str
    cases: int
    first: int = 0
    metrics: dict[str, Floats] = field(default_factory=dict)
    summaries: dict[str, Summary] = field(default_factory=dict)
    unsettled: int = 0
    faults: tuple[str, ...] = ()
    decision_s: float = 0.0
    idle: bool = False
    needs: str = "measurements"
    plant: str | None = None
    traces: dict[str, Any] = field(default_factory=dict)
    failure: str | None = None
    trust: bool = False
    note: str = ""

    @property
    def place(self) -> tuple[str, str]:
        """Split and scenario."""
        return self.split, self.scenario

    @property
    def about(self) -> dict[str, str]:
        """Whose it is and where, as tables have it."""
        return {"controller": self.name, "split": self.split, "scenario": self.scenario}

    def with_summaries(self) -> "Cell":
        """The cell with what the values of each metric come to; resamples keep the share of each fault."""
        summaries = {
            name: summarise(values, strata=self.faults, more=METRICS[name].more)
            for name, values in self.metrics.items()
        }
        return replace(self, summaries=summaries)


@dataclass(frozen=True)
class Conditions:
    """What every controller meets: a plant (preset, model file or model), the control period in s and the seeds, `seed + i`
    for case i; `limit` is the time in s that it may take by itself for one split and scenario before it counts as failed."""

    plant: Any = "paper_dead_zone"
    control_period: float = 0.01
    seed: int = 0
    limit: float = LIMIT

    @property
    def dtype(self) -> str:
        """Of the plant; one that is no model of ours has its own."""
        return str(getattr(self.plant, "dtype", DTYPE))

    def check(self, suite: Suite) -> None:
        """InputError for what every controller would fail by: a plant, a control period or a seed that cannot be."""
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}, expected a whole number of at least 0")
        if not self.limit > 0.0:
            raise InputError(f"limit must be more than 0 s, not {self.limit:g}")
        split, scenario, period = next(iter(suite.splits)), suite.scenarios[0], self.control_period
        HydraulicSyncVectorEnv(1, plant=self.plant, mismatch=split, scenario=scenario, control_period=period)


def cells_of(specs: Sequence[Any], suite: Suite, trust: bool) -> Iterator[Cell]:
    """Every controller on every split and scenario; a controller given twice or under a taken name is
    numbered.
    """
    taken: set[str] = set()
    for spec in specs:
        made = make_controller(spec, trust=trust)
        first = name = _text(spec, "name", getattr(made, "name", type(made).__name__))
        while name in taken:
            name = f"{first}_{len(taken)}"
        taken.add(name)
        portable = str(spec) if isinstance(spec, str | Path) else made
        needs = _text(spec, "needs", getattr(made, "needs", "measurements"))
        plant = getattr(made, "plant", None)
        if plant is not None:
            _text(spec, "plant", plant)
        for split, cases in suite.splits.items():
            for scenario in suite.scenarios:
                yield Cell(
                    portable, name, split, scenario, cases, suite.first, needs=needs, plant=plant, trust=trust
                )


def by_name(cells: Iterable[Cell]) -> dict[str, list[Cell]]:
    """The cells of each controller, which stand together."""
    return {name: list(own) for name, own in groupby(cells, attrgetter("name"))}


def _text(spec: Any, key: str, value: Any) -> str:
    """What a controller says of itself. InputError for what tables and pages cannot show in a line."""
    if not isinstance(value, str) or not 0 < len(value) <= MAX_LETTERS or not value.isprintable():
        raise InputError(
            f"controller {shown(spec)}: its {key} is {shown(value)}, expected text of 1 to {MAX_LETTERS} printable letters"
        )
    return value


def _key(cell: Cell, conditions: Conditions) -> str | None:
    """What the result of a cell depends on besides our own code: also the content of the files that it names.
    None for what cannot be compared. (What a controller's file imports from elsewhere is not seen.)
    """
    try:
        named = [_content(cell.controller), _content(conditions.plant)]
    except Exception:
        return None
    where = (conditions.control_period, conditions.seed)
    return repr((named, cell.name, cell.split, cell.scenario, cell.cases, cell.first, where))


def _content(spec: Any) -> str:
    if hasattr(spec, "to_dict"):  # a model of a plant
        return repr(spec.to_dict())
    if not isinstance(spec, str | Path):
        raise TypeError("an object says nothing of the code behind it")
    path = source_of(str(spec))
    if path is not None and path.suffix == ".json" and ":" in (law := read_gains(path).controller):
        spec = f"{spec} {_content(law)}"
    return f"{spec} {'' if path is None else hashlib.sha256(path.read_bytes()).hexdigest()}"


def drive(
    cells: Sequence[Cell],
    conditions: Conditions,
    engine: str,
    jobs: int,
    progress: bool,
    folder: str | Path | None = None,
) -> list[Cell]:
    """The cells with their scores, or why they failed; a folder keeps those that are done."""
    store = None if folder is None else Store(folder, partial(_key, conditions=conditions))
    done = run_tasks(
        cells, partial(_driven, conditions=conditions), engine=engine, jobs=jobs, progress=progress, unit="episode",
        size=lambda cell: cell.cases, store=store,
    )  # fmt: skip
    return [
        replace(cell, failure=result.reason) if isinstance(result, Failure) else result
        for cell, result in zip(cells, done, strict=True)
    ]


def _driven(cell: Cell, conditions: Conditions) -> Cell:
    """The cell with its scores. Nothing that a controller keeps from one cell reaches another: each has one of its own."""
    controller = make_controller(copy.deepcopy(cell.controller), trust=cell.trust)
    own = getattr(controller, "plant", None)
    first = conditions.seed + cell.first
    done = roll_out(
        controller, list(range(first, first + cell.cases)), plant=own or conditions.plant,
        mismatch=None if own else cell.split, scenario=cell.scenario, control_period=conditions.control_period,
        limit=conditions.limit, dtype=DTYPE if own else conditions.dtype,
    )  # fmt: skip
    # Rounded, so that what a result file keeps of them is all there is.
    metrics = {name: values.astype(np.float32).astype(float) for name, values in done.metrics().items()}
    for name, values in metrics.items():
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{name} of case {int(np.argmin(np.isfinite(values)))} is not finite")
    note = ""
    if done.typical_command > 1.0:
        note = f"half of its commands are {done.typical_command:.3g} or more, and 1 was applied instead: a command is a fraction"
        note += " of the rated one, not a voltage"
    still = iqm(np.abs(done.trace.setpoint_rpm).mean(axis=0))
    scored = replace(
        cell, metrics=metrics, faults=done.faults, note=note, unsettled=int(np.sum(never_settled(done.trace))),
        traces=_kept(done.trace, metrics[PEAK]), idle=iqm(metrics[TRACKING]) > IDLE * still,
        decision_s=done.decision_s,
    )  # fmt: skip
    return scored.with_summaries()


def _kept(trace: Trace, difference: Floats) -> dict[str, Any]:
    """The typical (median) and the worst case of a cell by their largest speed difference (N,), for the page."""
    order = np.argsort(difference, kind="stable")
    chosen = {"typical": int(order[(len(order) - 1) // 2]), "worst": int(order[-1])}
    return {
        which: {"case": case, "value": round(float(difference[case]), 1), **_thinned(trace, case)}
        for which, case in chosen.items()
    }


def _thinned(trace: Trace, case: int) -> dict[str, Any]:
    """One case of a trace with the samples and digits that a picture needs: the speed of motor 1 in rpm, and
    by how much it is ahead of motor 2 in tenths of an rpm; the commands in % of the rated one. Of every few samples the one
    with the largest difference is kept, so that no peak is lost.
    """
    total = len(trace.setpoint_rpm)
    every = max(1, total // TRACE_SAMPLES)
    apart = np.copysign(trace.peak_difference_rpm[:, case], trace.difference_rpm[:, case])
    rows = [n + int(np.argmax(np.abs(apart[n : n + every]))) for n in range(0, total, every)]
    in_force = np.minimum(rows, len(trace.command) - 1)
    command = np.rint(100.0 * trace.command[in_force, case]).astype(int)
    return {
        "sample": rows,
        "setpoint_rpm": np.rint(trace.setpoint_rpm[rows, case]).astype(int).tolist(),
        "speed_rpm": np.rint(trace.speed_rpm[rows, case, 0]).astype(int).tolist(),
        "ahead_drpm": np.rint(10.0 * apart[rows]).astype(int).tolist(),
        "command_percent": command.T.tolist(),
    }


def score_ends(cells: Iterable[Cell]) -> dict[tuple[str, str], tuple[float, float]]:
    """Returns that are 0 and 100 of the score, by split and scenario, where their intervals lie apart: elsewhere there is nothing
    to gain that the number of cases can tell from nothing."""
    returns = {(cell.name, cell.place): cell.summaries[RETURN] for cell in cells if cell.metrics}
    ends = {}
    for name, place in returns:
        low, high = returns[name, place], returns.get((BOUND, place))
        if name == BASELINE and high and low.ci95[1] < high.ci95[0]:
            ends[place] = low.iqm, high.iqm
    return ends


def overall(cells: Sequence[Cell], ends: Mapping[tuple[str, str], tuple[float, float]]) -> dict[str, Summary]:
    """Score, peak and tracking error of a controller over a suite: the mean of its splits and scenarios. Nothing where it failed
    in one of them."""
    if not all(cell.metrics for cell in cells):
        return {}
    # The same pairs of valves drive all scenarios of a split: resampled together, or the interval would be too narrow.
    seeds = [sorted({cell.split for cell in cells}).index(cell.split) for cell in cells]
    faults = [cell.faults for cell in cells]

    def mean(parts: list[tuple[Summary, Floats]]) -> Summary:
        summaries, values = zip(*parts, strict=True)
        return mean_of(summaries, list(zip(values, faults, seeds, strict=True)))

    found = {
        name: mean([(cell.summaries[name], cell.metrics[name]) for cell in cells])
        for name in (PEAK, TRACKING)
    }
    if all(cell.place in ends for cell in cells):
        own = [(cell.summaries[RETURN], cell.metrics[RETURN], ends[cell.place]) for cell in cells]
        found[SCORE.name] = mean(
            [(normalised(summary, at), scaled(values, at)) for summary, values, at in own]
        )
    return found

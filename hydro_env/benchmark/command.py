"""`hydro-env benchmark`: scores controllers on the fixed suite and writes scores.json and scores.html.

Case i of a split is what a reset with seed `seed + i` draws: pair of valves, noise and all. Every
controller meets the same cases, so that scores may be compared case by case. A controller that raises,
returns something that is not a command, or lets the plant diverge is named and counted as failed where it
did so; the rest go on.
"""

from __future__ import annotations

import copy
import hashlib
import importlib.util
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.benchmark.report import scores_page, scores_table
from hydro_env.benchmark.statistics import Summary, gap_closed, probability_of_improvement, summarise
from hydro_env.benchmark.suite import Suite, load_suite
from hydro_env.benchmark.tuned import tuned
from hydro_env.controllers.base import Floats
from hydro_env.controllers.registry import CONTROLLERS, make_controller, split_gains
from hydro_env.controllers.rollout import roll_out
from hydro_env.controllers.tuning.gains import read_gains
from hydro_env.controllers.user_files import controllers_in
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.errors import InputError, place_of, shown
from hydro_env.files import write_json, write_text
from hydro_env.pages import beside_results
from hydro_env.parallel import Failure, Store, check_engine
from hydro_env.parallel import run as run_tasks
from hydro_env.plant import load_model, scales_of
from hydro_env.tasks import METRICS, OWN, SPLITS, Trace, default_mismatch, never_settled

__all__ = ["SCHEMA", "Conditions", "Selection", "run"]

SCHEMA = "hydro_env/scores/1"
BASELINE = "pid_tuned"
"""Against whom the probability of improvement is given (the first controller where it does not take part)."""
BOUND = "oracle"
"""Who says how much there is to gain on the baseline."""

DTYPE = "float32"
"""Of the plant that every controller meets: half the time of float64, and scores move as they do with other steps
(docs/reference/benchmark.md, Precision)."""

LIMIT = 600.0
"""S that a controller may take for one split and scenario, by default: 200 rigs for 8 s are 160,000 commands to each valve."""

MAX_LETTERS = 200
"""Of a controller's name."""

TRACE_METRIC = "max_speed_difference_rpm"
"""By which a cell's typical (median) and worst case are chosen, whose traces the page shows."""
TRACE_SAMPLES = 120
"""How many samples of a trace the page keeps, about: those with the largest difference."""


@dataclass
class Cell:
    """One controller on one split and scenario: what is to be run, then what came of it."""

    controller: Any
    name: str
    split: str
    scenario: str
    cases: int
    metrics: dict[str, Floats] = field(default_factory=dict)
    summaries: dict[str, Summary] = field(default_factory=dict)
    unsettled: int = 0
    needs: str = "measurements"
    plant: str | None = None
    traces: dict[str, Any] = field(default_factory=dict)
    failure: str | None = None
    trust: bool = False
    note: str = ""


@dataclass(frozen=True)
class Selection:
    """What is driven: a suite ("quick", "full" or a YAML file, see suite.yaml), narrowed or widened to these splits, scenarios
    and cases per split. The split `own` is the plant's own pair of valves."""

    suite: str | Path = "full"
    splits: Sequence[str] | None = None
    scenarios: Sequence[str] | None = None
    cases: int | None = None

    def load(self, plant: Any) -> Suite:
        """The suite. A plant file that sets what the splits would draw is driven with its own pair of valves, unless the splits
        are named here or in a suite file. InputError for a name that does not exist."""
        splits, shipped = self.splits, Path(self.suite).suffix == ""
        if splits is None and shipped and default_mismatch(plant) == OWN:
            splits = [OWN]
        return load_suite(self.suite).narrowed(splits, self.scenarios, self.cases)


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


def run(
    out: str | Path | None, *, controllers: Sequence[Any] | None = None, selection: Selection | None = None,
    conditions: Conditions | None = None, engine: str = "local", jobs: int = 1, cells_folder: str | Path | None = None,
    progress: bool = True, trust: bool = False, gains: str | Path | None = None,
) -> dict[str, Any]:  # fmt: skip
    """Scores controllers and writes `out/scores.json` and `out/scores.html`.

    Args:
        out: folder to write to, made if need be; None writes nothing.
        controllers: what `make_controller` takes; `file.py` stands for all controllers in it, "all" for all that ship. By
            default those.
        selection: what they drive; the full suite by default.
        conditions: on what.
        engine, jobs: where the cells run, see `hydro_env.parallel`; makes no difference to the scores.
        cells_folder: keeps finished cells, and gives back those that are still the same.
        progress: whether to show a progress bar.
        gains: folder of gains for the plant, if that is a file: controllers that ship with gains for the paper's plant are
            tuned for it first, those that are there already are taken. None: all are scored with the gains that ship.
        trust: whether agents of Stable-Baselines3 (.zip) may be loaded, which runs code from the file.

    Returns what scores.json holds. InputError for a name that does not exist.
    """
    conditions = conditions or Conditions()
    chosen = (selection or Selection()).load(conditions.plant)
    check_engine(engine, jobs)
    conditions.check(chosen)
    store = None if cells_folder is None else Store(cells_folder, partial(_key, conditions=conditions))
    specs = _specs(controllers or ["all"])
    first: list[str] = []
    if gains is not None:
        specs, first = tuned(
            specs, conditions.plant, own=[*chosen.splits] == [OWN], period=conditions.control_period, folder=Path(gains),
            engine=engine, jobs=jobs, progress=progress,
        )  # fmt: skip
    cells = list(_cells(specs, chosen, trust))
    if out is not None:
        Path(out).mkdir(parents=True, exist_ok=True)
    done = run_tasks(
        cells, partial(_run_cell, conditions=conditions), engine=engine, jobs=jobs, progress=progress, unit="episode",
        size=lambda cell: cell.cases, store=store,
    )  # fmt: skip
    done = [
        replace(cell, failure=result.reason) if isinstance(result, Failure) else result
        for cell, result in zip(cells, done, strict=True)
    ]
    scores = _scores(done, chosen, conditions)
    scores["about"] += f" Tuned for this plant: {', '.join(first)}." if first else ""
    if out is not None:
        write_json(Path(out) / "scores.json", scores)
        with beside_results(page := Path(out) / "scores.html"):
            write_text(page, scores_page(scores, _traces(done, conditions)))
    return scores


def _specs(controllers: Sequence[Any]) -> list[Any]:
    """The controllers with "all" and files spelt out, less those for another plant; one that is also named by itself comes
    once."""
    own = [entry for entry in CONTROLLERS.values() if not entry.apart]
    files = [controllers_in(str(spec)) if str(spec).endswith(".py") else [spec] for spec in controllers]
    controllers = list(chain.from_iterable(files))
    if not any(isinstance(spec, str) and spec == "all" for spec in controllers):
        return controllers
    names = [entry.name for entry in own]
    return names + [spec for spec in controllers if not isinstance(spec, str) or spec not in ("all", *names)]


def _cells(specs: Sequence[Any], suite: Suite, trust: bool) -> Iterator[Cell]:
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
                yield Cell(portable, name, split, scenario, cases, needs=needs, plant=plant, trust=trust)


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
    return repr((named, cell.name, cell.split, cell.scenario, cell.cases, where))


def _content(spec: Any) -> str:
    if hasattr(spec, "to_dict"):  # a model of a plant
        return repr(spec.to_dict())
    if not isinstance(spec, str | Path):
        raise TypeError("an object says nothing of the code behind it")
    source = split_gains(str(spec))[0].rpartition(":")[0]
    if source and not source.endswith(".py"):
        module = importlib.util.find_spec(source)
        source = "" if module is None or module.origin is None else module.origin
    path = Path(source or spec)
    if path.suffix == ".json" and ":" in (law := read_gains(path).controller):
        spec = f"{spec} {_content(law)}"
    return f"{spec} {hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ''}"


def _run_cell(cell: Cell, conditions: Conditions) -> Cell | Failure:
    """The cell with its scores. Whatever a controller raises is the failure of its cell alone; it says where in the user's own
    file that was.
    """
    try:
        return _driven(cell, conditions)
    except Exception as problem:
        if not (place := place_of(problem)):
            raise
        return Failure(f"{type(problem).__name__}: {' '.join(str(problem).split())}"[:300] + f" ({place})")


def _driven(cell: Cell, conditions: Conditions) -> Cell:
    """The cell with its scores. Nothing that a controller keeps from one cell reaches another: each has one of its own."""
    controller = make_controller(copy.deepcopy(cell.controller), trust=cell.trust)
    own = getattr(controller, "plant", None)
    done = roll_out(
        controller, list(range(conditions.seed, conditions.seed + cell.cases)), plant=own or conditions.plant,
        mismatch=None if own else cell.split, scenario=cell.scenario, control_period=conditions.control_period,
        limit=conditions.limit, dtype=DTYPE if own else conditions.dtype,
    )  # fmt: skip
    metrics = done.metrics(METRICS)
    for name, values in metrics.items():
        if not np.all(np.isfinite(values)):
            raise ValueError(f"{name} of case {int(np.argmin(np.isfinite(values)))} is not finite")
    note = ""
    if done.typical_command > 1.0:
        note = f"half of its commands are {done.typical_command:.3g} or more, and 1 was applied instead: a command is a fraction"
        note += " of the rated one, not a voltage"
    of = {METRICS[name].of: values for name, values in metrics.items()}  # the command's travel has two names
    once = {name: summarise(values, strata=done.faults, seed=conditions.seed) for name, values in of.items()}
    summaries = {name: once[METRICS[name].of] for name in metrics}
    traces = _kept(done.trace, metrics[TRACE_METRIC])
    unsettled = int(np.sum(never_settled(done.trace)))
    return replace(cell, metrics=metrics, summaries=summaries, unsettled=unsettled, traces=traces, note=note)


def _kept(trace: Trace, difference: Floats) -> dict[str, Any]:
    """The typical and the worst case of a cell by their largest speed difference (N,), for the page."""
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


def _scores(cells: list[Cell], suite: Suite, conditions: Conditions) -> dict[str, Any]:
    names = list(dict.fromkeys(cell.name for cell in cells))
    baseline = BASELINE if BASELINE in names else names[0]
    summaries = {
        (cell.name, cell.split, cell.scenario, metric): cell.summaries[metric]
        for cell in cells
        for metric in (suite.metrics if cell.metrics else ())
    }
    plant = conditions.plant
    label = plant if isinstance(plant, str) else str(getattr(plant, "name", plant))
    drawn = {split: _drawn_over(plant, split) for split in suite.splits if split != OWN}
    return {
        "schema": SCHEMA,
        "suite": suite.name,
        "about": f"Suite {suite.name} on the plant {label}, control period {conditions.control_period * 1000:g} ms, "
        f"seed {conditions.seed}. {_valves(suite, drawn)}",
        "plant": label,
        "seed": conditions.seed,
        "control_period_s": conditions.control_period,
        "dtype": conditions.dtype,
        "splits": suite.splits,
        "drawn_over": drawn,
        "controllers": names,
        "needs": {cell.name: cell.needs for cell in cells},
        "own_plant": {cell.name: cell.plant for cell in cells if cell.plant is not None},
        "baseline": baseline,
        "bound": BOUND if BOUND in names else None,
        "rows": [
            {**_place(*key), "iqm": s.iqm, "ci95": list(s.ci95), "cvar95": s.cvar95, "n": s.n}
            for key, s in summaries.items()
        ],
        "failed": _told(cells, "reason", lambda cell: cell.failure),
        "never_settled": _told(cells, "cases", lambda cell: cell.unsettled),
        "notes": _told(cells, "note", lambda cell: cell.note),
        "improvement": _improvement(cells, suite, baseline),
        "gap_closed": _gaps_closed(summaries, baseline),
    }


def _told(cells: list[Cell], key: str, of: Callable[[Cell], Any]) -> list[dict[str, Any]]:
    """What there is to be told of cells, under `key`, each with its place."""
    return [
        {"controller": cell.name, "split": cell.split, "scenario": cell.scenario, key: value}
        for cell in cells
        if (value := of(cell))
    ]


def _drawn_over(plant: Any, split: str) -> list[str]:
    """Values of a plant that are not scored, since the split draws them: base parameters and effects."""
    own, ranges = load_model(plant).values, SPLITS[split].ranges
    about = {
        name: " (varied about it)" if isinstance(ranges[name].meant_for, float) else ""
        for name in ranges
        if name in own
    }
    return list(dict.fromkeys(name.partition(".")[0] + how for name, how in about.items()))


def _valves(suite: Suite, drawn: dict[str, list[str]]) -> str:
    """Whose valves are scored, in words: the plant's own, or drawn ones, and what of the plant these take the place of."""
    sentences = ["Split own: the plant's own pair of valves."] if OWN in suite.splits else []
    for names in dict.fromkeys(tuple(each) for each in drawn.values()):
        alike = [split for split, each in drawn.items() if tuple(each) == names]
        instead = f" in place of the plant's own {', '.join(names)}" if names else ""
        sentences.append(f"Split {', '.join(alike)}: pairs of valves are drawn{instead}.")
    return " ".join(sentences)


def _place(controller: str, split: str, scenario: str, metric: str) -> dict[str, str]:
    return {"controller": controller, "split": split, "scenario": scenario, "metric": metric}


def _improvement(cells: list[Cell], suite: Suite, baseline: str) -> list[dict[str, Any]]:
    """How probably each cell's controller does better than the baseline on the same case."""
    theirs = {(cell.split, cell.scenario): cell for cell in cells if cell.name == baseline}
    rows: list[dict[str, Any]] = []
    for cell in cells:
        other = theirs[cell.split, cell.scenario]
        if cell.name == baseline or not cell.metrics or not other.metrics:
            continue
        for metric in suite.metrics:
            chance = probability_of_improvement(cell.metrics[metric], other.metrics[metric])
            place = _place(cell.name, cell.split, cell.scenario, metric)
            rows.append({**place, "over": baseline, "probability": chance})
    return rows


def _gaps_closed(summaries: dict[tuple[str, str, str, str], Summary], baseline: str) -> list[dict[str, Any]]:
    """Which share of the way from the baseline to the bound each controller has gone, where there is a gap."""
    rows: list[dict[str, Any]] = []
    for (name, *where), summary in summaries.items():
        split, scenario, metric = where
        ends = [summaries.get((end, split, scenario, metric)) for end in (baseline, BOUND)]
        share = None if ends[0] is None or ends[1] is None else gap_closed(summary, ends[0], ends[1])
        if name not in (baseline, BOUND) and share is not None:
            place = _place(name, split, scenario, metric)
            rows.append({**place, "over": baseline, "bound": BOUND, "share": share})
    return rows


def _traces(cells: list[Cell], conditions: Conditions) -> dict[str, Any] | None:
    """The typical and the worst case behind every row, by split, scenario and controller, for the page."""
    places: dict[str, Any] = {}
    for cell in cells:
        if cell.traces:
            of_split = places.setdefault(cell.split, {})
            of_split.setdefault(cell.scenario, {})[cell.name] = cell.traces
    if not places:
        return None
    limit = float(
        f"{60.0 * scales_of(load_model(conditions.plant)).speed:.2g}"
    )  # of the axis of the difference
    about = {"period_s": conditions.control_period, "limit_rpm": limit, "metric": TRACE_METRIC}
    return {**about, "splits": places}


def report(scores: dict[str, Any]) -> str:
    """What the command prints. InputError if every controller failed everywhere."""
    if not scores["rows"]:
        first = scores["failed"][0]
        raise InputError(f"every controller failed; {first['controller']}: {first['reason']}")
    notes = {each["controller"]: f"\nnote: {each['controller']}: {each['note']}" for each in scores["notes"]}
    return f"{scores['about']}\n\n{scores_table(scores)}{''.join(notes.values())}"

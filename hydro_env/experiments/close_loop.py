"""`hydro-env close-loop`: is a model repaired by a diagnosis worth anything to the controller that is designed on it?

    hide      effects are hidden in a rig that the independent reference simulator plays; its base parameters are wrong too
    diagnose  the rig's logs give model.yaml
    tune      each controller is designed and tuned three times with the same budget and seed: on the model an engineer has
              (`wrong`), on the repaired one (`repaired`), and on the true one (`true`), the ceiling
    score     each of them drives the hidden rig, on scenarios that no tuning has seen

A rig stands for a case (what is hidden) and a seed (how large, which manoeuvres, which base parameters). Shipped controllers
that were made for any pair of valves and know no model of the rig are driven as well, for comparison (`none`).

Intervals are 95 % percentile bootstrap ones of the mean over rigs: cases are drawn anew, and in each of them its seeds.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from math import log
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from hydro_env.controllers import make_controller
from hydro_env.controllers.base import Controller, Floats, Gain
from hydro_env.controllers.classical.cross_coupling import CrossCoupled
from hydro_env.controllers.classical.model_inverse import ModelInverse
from hydro_env.controllers.classical.pid import PidController
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.experiments.truth_drive import drive
from hydro_env.files import write_json, write_text
from hydro_env.parallel import Failure, Store
from hydro_env.parallel import run as run_tasks
from hydro_env.plant import PlantModel
from hydro_env.practice.generate import constants_of
from hydro_env.practice.reference.forms import Constants
from hydro_env.tasks import Trace, compute, load_scenario

__all__ = [
    "CASES", "LAWS", "SCENARIOS", "SCHEMA", "SHIPPED", "SOURCES", "Rig", "collect", "make_rig", "read", "run", "score", "summary",
    "table", "write_rigs",
]  # fmt: skip

SCHEMA = "hydro_env/close_loop/1"
#: What is hidden, by the name of the case.
CASES: dict[str, tuple[str, ...]] = {
    "dead_zone": ("dead_zone:1",),
    "hysteresis": ("magnetic_hysteresis:2",),
    "droop": ("supply_droop",),
    "mixed": ("dead_zone:2", "magnetic_hysteresis:1"),
}
#: Models on which a controller is tuned.
SOURCES = ("wrong", "repaired", "true")
#: What scores are made on. Tuning has seen none of them.
SCENARIOS = ("setpoint_steps", "load_step", "sine")
#: What is tuned on, how often a candidate drives it, and the rpm of tracking error that one rpm of difference is worth.
TUNED_ON, TUNING_EPISODES, WEIGHT = "random_drives", 4, 2.0
POPULATION, GENERATIONS = 16, 11
#: Largest error of a base parameter of the model that the engineer has.
BASE_ERROR = 0.1
#: Controllers as shipped, which know no model of the rig.
SHIPPED = ("cross_coupled", "adaptive_flow", "ppo")
METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm")
RESAMPLES = 4000


# --- what is tuned ------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Law:
    """A control law, made from a model and gains. Gains in `fixed` say how fast the set-point is followed: were they free,
    a tuner would buy synchronisation with tracking or the other way round, and nothing could be compared. `each` are gains
    with a value for each channel."""

    summary: str
    make: Callable[..., Controller]
    gains: tuple[Gain, ...]
    fixed: Mapping[str, float] = field(default_factory=dict)
    each: tuple[str, ...] = ()
    model: bool = False

    def build(self, name: str, model: PlantModel, gains: Mapping[str, Any]) -> Controller:
        """The controller with these gains; `model` is told to those laws that are made from one."""
        told = {"model": model} if self.model else {}
        return self.make(name, **told, **self.fixed, **gains)

    def genes(self) -> list[tuple[Gain, int | None]]:
        """What is searched: gains, twice those that each channel has of its own."""
        free = [gain for gain in self.gains if gain.default is None and gain.name not in self.fixed]
        return [(g, c) for g in free for c in ((0, 1) if g.name in self.each else (None,))]


LAWS: dict[str, Law] = {
    "pid": Law(
        "the paper's law: a PID on each motor, gains of its own for each valve",
        PidController,
        PidController.GAINS,
        each=("Kp", "Ti"),
    ),
    "cross_coupled": Law(
        "PI with a PI on the speed difference", CrossCoupled, CrossCoupled.GAINS, fixed={"filter": 0.067}
    ),
    "model_inverse": Law(
        "feed-forward and inverse valve curves read off the model, and feedback",
        ModelInverse,
        ModelInverse.GAINS,
        fixed={"rate": 30.0},
        model=True,
    ),
}


@dataclass(frozen=True)
class Tuning:
    """A search for gains: of which law, on which model."""

    law: str
    source: str
    rig: str  # "" on the wrong model, which all rigs share
    model: PlantModel
    seed: int
    generations: int = GENERATIONS

    @property
    def key(self) -> str:
        return f"tuning {self.law} {self.seed} {self.generations} {_text(self.model)}"


def tune(task: Tuning) -> dict[str, Any]:
    """The gains with the least mean cost on the task's own model, and that cost in rpm."""
    law = LAWS[task.law]
    genes = law.genes()
    seeds = [task.seed * 1000 + n for n in range(TUNING_EPISODES)]

    def gains_of(points: Floats) -> dict[str, Floats]:
        """Gains (candidates, 1 or 2) of points (genes, candidates)."""
        made: dict[str, list[Floats]] = {}
        for (gain, _), row in zip(genes, points, strict=True):
            made.setdefault(gain.name, []).append(np.exp(row) if gain.log else row)
        return {name: np.stack(rows, axis=-1) for name, rows in made.items()}

    def mean_costs(points: Floats) -> Floats:
        count = points.shape[1]
        gains = {name: np.repeat(value, len(seeds), axis=0) for name, value in gains_of(points).items()}
        tried = law.build(task.law, task.model, gains)
        done = roll_out(tried, seeds * count, plant=task.model, mismatch=None, scenario=TUNED_ON)
        costs = done.metrics(["tracking_mae_rpm", "max_speed_difference_rpm"])
        cost = costs["tracking_mae_rpm"] + WEIGHT * costs["max_speed_difference_rpm"]
        return cost.reshape(count, len(seeds)).mean(axis=1)

    bounds = np.array([(log(g.low), log(g.high)) if g.log else (g.low, g.high) for g, _ in genes])
    first = qmc.LatinHypercube(len(genes), rng=np.random.default_rng(task.seed)).random(POPULATION)
    found = differential_evolution(
        mean_costs, bounds, init=bounds[:, 0] + first * (bounds[:, 1] - bounds[:, 0]), maxiter=task.generations - 1,
        rng=np.random.default_rng(task.seed), vectorized=True, updating="deferred", mutation=(0.4, 0.9),
        recombination=0.9, polish=False, tol=0.0,
    )  # fmt: skip
    best = {name: [float(f"{v:.4g}") for v in value[0]] for name, value in gains_of(found.x[:, None]).items()}
    gains = {name: value if len(value) > 1 else value[0] for name, value in best.items()}
    return {"gains": gains, "cost_rpm": float(found.fun)}


# --- rigs ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class RigTask:
    """A rig to be made and diagnosed."""

    case: str
    seed: int
    duration: float = 12.0

    @property
    def name(self) -> str:
        return f"{self.case}_{self.seed}"

    @property
    def key(self) -> str:
        return f"rig {CASES[self.case]} {self.number} {self.duration} {BASE_ERROR}"

    @property
    def number(self) -> int:
        """Seed of the practice logs: no two rigs share one."""
        return 100 * list(CASES).index(self.case) + self.seed


@dataclass(frozen=True)
class Rig:
    """A hidden truth and what the diagnosis made of its logs: `wrong`, `repaired` and `true` models by `SOURCES`."""

    case: str
    seed: int
    forms: str
    models: Mapping[str, PlantModel]
    truth: Mapping[str, Any]
    diagnosis: Mapping[str, Any]

    @property
    def name(self) -> str:
        return f"{self.case}_{self.seed}"

    def row(self) -> dict[str, Any]:
        """What the table of rigs says."""
        from hydro_env.experiments.blind_trials import judge

        sides = {"both": ("1", "2")}
        hidden = {
            (e["name"], c) for e in self.truth["effects"] for c in sides.get(e["channel"], (e["channel"],))
        }
        judged = judge(dict(self.diagnosis), hidden, self.truth["verdict"])
        speeds = {k: v for k, v in self.diagnosis["gap"]["sealed"].items() if k.startswith("speed")}
        return {
            "rig": self.name, "case": self.case, "seed": self.seed, "forms": self.forms, "hidden": self.truth["effects"],
            "verdict": judged["verdict"], "named": judged["named"], "right": judged["right"],
            "sealed_rpm": {k: {m: v[m] for m in ("noise", "before", "after")} for k, v in speeds.items()},
        }  # fmt: skip


def make_rig(task: RigTask) -> Rig:
    """Hides, logs and diagnoses."""
    from hydro_env.diagnosis import diagnose
    from hydro_env.practice.generate import make_practice

    practice = make_practice(
        CASES[task.case], model="paper", base_error=BASE_ERROR, seed=task.number, duration=task.duration
    )
    with tempfile.TemporaryDirectory() as folder:
        practice.write(Path(folder))
        logs = [Path(folder) / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed")]
        found = diagnose(logs[:2], logs[2:], model=Path(folder) / "model.yaml")
    models = {"wrong": practice.given, "repaired": found.model, "true": practice.true}
    return Rig(task.case, task.seed, practice.truth["forms"], models, practice.truth, found.as_dict())


def write_rigs(folder: Path, rigs: Sequence[Rig]) -> None:
    """Writes each rig's models and diagnosis: `folder/RIG/{wrong,repaired,true}.yaml`, truth.json, diagnosis.json."""
    for rig in rigs:
        own = folder / rig.name
        own.mkdir(parents=True, exist_ok=True)
        for source, model in rig.models.items():
            model.to_yaml(own / f"{source}.yaml")
        write_json(own / "truth.json", rig.truth)
        write_json(own / "diagnosis.json", rig.diagnosis)


# --- scores -------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Score:
    """A controller that drives a hidden rig. `gains` of a law, tuned on `source`; None: a shipped controller."""

    controller: str
    source: str
    rig: str
    scenario: str
    model: PlantModel
    gains: Mapping[str, Any] | None
    truth: PlantModel
    forms: str
    constants: Constants | None
    seed: int

    @property
    def key(self) -> str:
        told = _text(self.model) if self.gains is not None else ""
        gains = json.dumps(self.gains)
        rig = f"{_text(self.truth)} {self.forms} {json.dumps(self.constants)}"
        return f"score {self.controller} {gains} {told} {rig} {self.scenario} {self.seed}"


def score(task: Score) -> dict[str, Any]:
    """What `scored` keeps of the drive."""
    controller = (
        make_controller(task.controller)
        if task.gains is None
        else LAWS[task.controller].build(task.controller, task.model, task.gains)
    )
    drawn: dict[str, Any] = {"forms": task.forms, "constants": task.constants}
    return scored(drive(controller, task.truth, task.scenario, task.seed, **drawn))


def scored(trace: Trace) -> dict[str, Any]:
    """What is kept of a drive: its metrics, and the speed difference in rpm, period by period, for pictures."""
    return {
        "metrics": {name: float(value[0]) for name, value in compute(trace, METRICS).items()},
        "difference_rpm": np.round(trace.difference_rpm[:, 0], 2).tolist(),
    }


def _text(model: PlantModel) -> str:
    return json.dumps(model.to_dict(), sort_keys=True)


def _work(task: Any) -> Any:
    """Any task; one function, so that one store serves them all."""
    match task:
        case RigTask():
            return make_rig(task)
        case Tuning():
            return tune(task)
        case Score():
            return score(task)
    raise TypeError(type(task))


# --- what it says ---------------------------------------------------------------------------------------------------------
def collect(scores: Sequence[Mapping[str, Any]], seed: int = 0) -> list[dict[str, Any]]:
    """Means over rigs by controller, scenario and metric, and what repairing the model changed.

    `scores` are rows {controller, tuned_on, rig, case, seed, scenario, metrics}. Of every controller that was tuned, the
    rows hold `wrong`, `repaired`, `true` as {mean, ci95}; `change`: mean on the repaired model over that on the wrong one,
    less 1; `better`: on how many rigs it was lower. Shipped controllers have `none` alone.
    """
    rows = []
    kinds = dict.fromkeys((s["controller"], s["tuned_on"] == "none", s["scenario"]) for s in scores)
    for controller, shipped, scenario in kinds:
        own = [s for s in scores if s["controller"] == controller and s["scenario"] == scenario]
        own = [s for s in own if (s["tuned_on"] == "none") == shipped]
        for metric in METRICS:
            values: dict[str, dict[tuple[str, int], float]] = {}
            for s in own:
                values.setdefault(s["tuned_on"], {})[s["case"], s["seed"]] = s["metrics"][metric]
            rigs = sorted(set.intersection(*(set(each) for each in values.values())))
            drawn = _drawn(rigs, seed)
            table = {source: np.array([each[rig] for rig in rigs]) for source, each in values.items()}
            means = {source: each[drawn].mean(axis=1) for source, each in table.items()}
            row: dict[str, Any] = {
                "controller": controller,
                "scenario": scenario,
                "metric": metric,
                "n": len(rigs),
            }
            for source, each in table.items():
                row[source] = {"mean": float(each.mean()), "ci95": _interval(means[source])}
            if {"wrong", "repaired"} <= table.keys():
                before, after = table["wrong"], table["repaired"]
                row["change"] = {
                    "mean": float(after.mean() / before.mean() - 1.0),
                    "ci95": _interval(means["repaired"] / means["wrong"] - 1.0),
                }
                row["better"] = int(np.sum(after < before))
            rows.append(row)
    return rows


def _drawn(rigs: Sequence[tuple[str, int]], seed: int) -> Any:
    """Places of the rigs in every resample (RESAMPLES, n): cases drawn anew, and in each of them as many of its seeds."""
    stream = np.random.default_rng(seed)
    cases = [np.flatnonzero([case == each for case, _ in rigs]) for each in dict.fromkeys(c for c, _ in rigs)]
    size = max(len(each) for each in cases)  # cases of equal weight, also if a rig of one of them failed
    picked = stream.integers(len(cases), size=(RESAMPLES, len(cases)))
    return np.array(
        [np.concatenate([cases[c][stream.integers(len(cases[c]), size=size)] for c in row]) for row in picked]
    )


def _interval(values: Floats) -> list[float]:
    return [float(v) for v in np.percentile(values, [2.5, 97.5])]


def table(data: Mapping[str, Any]) -> str:
    """The scores as a table in Markdown, one line a controller and scenario."""
    lines = [
        "| controller | scenario | peak error, rpm: model as given | repaired | true | change by the repair | better on"
        " | RMS: as given, repaired, true | tracking error: as given, repaired, true |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    by = {(r["controller"], "none" in r, r["scenario"], r["metric"]): r for r in data["summary"]}
    for name, shipped in dict.fromkeys((r["controller"], "none" in r) for r in data["summary"]):
        for scenario in dict.fromkeys(r["scenario"] for r in data["summary"]):
            largest, rms, tracking = (by[name, shipped, scenario, metric] for metric in METRICS)
            if shipped:
                cells = [_shown(largest["none"]), "", "", "", ""]
                rest = [f"{row['none']['mean']:.1f}" for row in (rms, tracking)]
                name_shown = f"{name} as shipped"
            else:
                change = largest["change"]
                low, high = (100.0 * v for v in change["ci95"])
                cells = [_shown(largest[source]) for source in SOURCES]
                cells += [
                    f"{100.0 * change['mean']:+.0f} % [{low:+.0f}, {high:+.0f}]",
                    f"{largest['better']} of {largest['n']}",
                ]
                rest = [
                    ", ".join(f"{row[source]['mean']:.1f}" for source in SOURCES) for row in (rms, tracking)
                ]
                name_shown = name
            lines.append(f"| {name_shown} | {scenario} | {' | '.join([*cells, *rest])} |")
    return "\n".join(lines)


def _shown(entry: Mapping[str, Any]) -> str:
    low, high = entry["ci95"]
    return f"{entry['mean']:.1f} [{low:.1f}, {high:.1f}]"


def summary(data: Mapping[str, Any]) -> str:
    """What the command prints."""
    right = sum(row["right"] for row in data["rigs"])
    lines = [
        f"{len(data['rigs'])} hidden rigs, {right} named correctly. Peak synchronisation error, rpm, on the hidden rigs:"
    ]
    for row in data["summary"]:
        if row["metric"] != METRICS[0]:
            continue
        start = f"{row['controller']:<14} {row['scenario']:<15}"
        if "none" in row:
            lines.append(f"{start} as shipped, without information on the rig: {_shown(row['none'])}")
            continue
        low, high = (100.0 * v for v in row["change"]["ci95"])
        lines.append(
            f"{start} tuned on the model as given {_shown(row['wrong'])}, on the repaired one {_shown(row['repaired'])}, "
            f"on the true one {_shown(row['true'])}: {100.0 * row['change']['mean']:+.0f} % [{low:+.0f}, {high:+.0f}], "
            f"better on {row['better']} of {row['n']}"
        )
    lines += [f"failed: {each['task']}: {each['reason']}" for each in data["failed"]]
    return "\n".join(lines)


# --- all of it ------------------------------------------------------------------------------------------------------------
def run(
    out: str | Path,
    *,
    cases: Sequence[str] | None = None,
    seeds: int = 2,
    seed: int = 0,
    cells: str | Path | None = None,
    jobs: int = 1,
    engine: str = "local",
    duration: float = 12.0,
    generations: int = GENERATIONS,
    pictures: bool = True,
    progress: bool = True,
) -> dict[str, Any]:
    """Closes the loop on every case and seed; writes close_loop.json, close_loop.md, rigs/ and, if asked, a picture.

    Args:
        out: an existing folder.
        cases: names of `CASES`; None: all.
        seeds: rigs of each case, with the seeds `seed`, `seed + 1`, ...
        cells: folder that keeps what is done, so that a run that was stopped goes on; None: nothing is kept.
        jobs, engine: see `hydro_env.parallel`.
        duration: of each log, s.
        generations: of every search.
        pictures: whether to draw close_loop.png (needs the extra `report`).
        progress: whether to show progress bars.

    Returns the content of close_loop.json. InputError for an unknown case, or if nothing could be done.
    """
    out = Path(out)
    chosen = list(CASES if cases is None else cases)
    for case in chosen:
        if case not in CASES:
            raise InputError(f"unknown case {case!r}: there are {', '.join(CASES)}")
    if seeds < 1 or seed < 0 or seed + seeds > 100:
        raise InputError(f"seeds {seed} to {seed + seeds - 1}: 0 to 99 are right")
    if generations < 2:
        raise InputError(f"generations is {generations}; at least 2 are right")
    store = None if cells is None else Store(cells, lambda task: str(task.key))
    work = partial(run_tasks, function=_work, engine=engine, jobs=jobs, progress=progress, store=store)
    failed: list[dict[str, str]] = []

    def done(tasks: Sequence[Any], unit: str) -> list[tuple[Any, Any]]:
        """Tasks with their results; those that failed are noted and left out."""
        results = list(zip(tasks, work(tasks, unit=unit), strict=True))
        failed.extend({"task": _label(t), "reason": r.reason} for t, r in results if isinstance(r, Failure))
        return [(t, r) for t, r in results if not isinstance(r, Failure)]

    rigs = [
        rig for _, rig in done([RigTask(c, seed + n, duration) for c in chosen for n in range(seeds)], "rig")
    ]
    if not rigs:
        raise InputError(f"no rig could be made: {failed[0]['reason']}")
    tunings = {
        (law, source, "" if source == "wrong" else rig.name, rig.seed): Tuning(
            law, source, "" if source == "wrong" else rig.name, rig.models[source], rig.seed, generations
        )
        for rig in rigs
        for law in LAWS
        for source in SOURCES
    }
    tuned = {(t.law, t.source, t.rig, t.seed): found for t, found in done(list(tunings.values()), "tuning")}
    drives = []
    for rig in rigs:
        common: dict[str, Any] = {
            "rig": rig.name, "truth": rig.models["true"], "forms": rig.forms, "constants": constants_of(rig.truth),
            "seed": rig.seed,
        }  # fmt: skip
        for scenario in SCENARIOS:
            for law in LAWS:
                for source in SOURCES:
                    found = tuned.get((law, source, "" if source == "wrong" else rig.name, rig.seed))
                    if found is not None:
                        drives.append(
                            Score(
                                law,
                                source,
                                scenario=scenario,
                                model=rig.models[source],
                                gains=found["gains"],
                                **common,
                            )
                        )
            for name in SHIPPED:
                drives.append(
                    Score(name, "none", scenario=scenario, model=rig.models["wrong"], gains=None, **common)
                )
    by_name = {rig.name: rig for rig in rigs}
    scores = []
    for task, result in done(drives, "drive"):
        of = by_name[task.rig]
        scores.append(
            {"controller": task.controller, "tuned_on": task.source, "rig": task.rig, "case": of.case, "seed": of.seed,
             "scenario": task.scenario, **result}
        )  # fmt: skip
    data = {
        "schema": SCHEMA,
        "settings": {
            "cases": {case: list(CASES[case]) for case in chosen}, "seeds": [seed, seeds], "base_error": BASE_ERROR,
            "log_s": duration, "tuned_on": load_scenario(TUNED_ON).name,
            "episodes_of_a_tuning": TUNING_EPISODES * POPULATION * generations,
            "weight": WEIGHT, "truth": "plant.reference, forms: " + ", ".join(sorted({rig.forms for rig in rigs})),
        },
        "rigs": [rig.row() for rig in rigs],
        "gains": [
            {"controller": law, "tuned_on": source, "rig": name or None, "seed": number, **found}
            for (law, source, name, number), found in tuned.items()
        ],
        "scores": scores,
        "summary": collect(scores),
        "failed": failed,
    }  # fmt: skip
    write_rigs(out / "rigs", rigs)
    write(out, data, pictures)
    return data


def write(out: Path, data: Mapping[str, Any], pictures: bool = True) -> None:
    """Writes close_loop.json, its traces of the first scenario (traces.json), close_loop.md and close_loop.png."""
    scores = [{k: v for k, v in s.items() if k != "difference_rpm"} for s in data["scores"]]
    traces = [s for s in data["scores"] if s["scenario"] == SCENARIOS[0] and "difference_rpm" in s]
    write_json(out / "close_loop.json", {**data, "scores": scores})
    write_json(out / "traces.json", traces, indent=None)
    write_text(out / "close_loop.md", table(data) + "\n")
    if pictures:
        from hydro_env.experiments.close_loop_picture import draw

        draw(data, out / "close_loop.png")


def read(folder: Path) -> dict[str, Any]:
    """What `write` wrote. InputError if there is no such result."""
    try:
        data: dict[str, Any] = json.loads((folder / "close_loop.json").read_text(encoding="utf-8"))
        traces = json.loads((folder / "traces.json").read_text(encoding="utf-8"))
    except (OSError, ValueError):
        raise InputError(f"{folder}: holds no result of `hydro-env close-loop --out {folder}`") from None
    if data.get("schema") != SCHEMA:
        raise InputError(f"{folder / 'close_loop.json'}: its schema should be {SCHEMA!r}")
    kept = {_of(s): s for s in traces}
    return {**data, "scores": [kept.get(_of(s), s) for s in data["scores"]]}


def _of(row: Mapping[str, Any]) -> tuple[str, ...]:
    return tuple(row[key] for key in ("controller", "tuned_on", "rig", "scenario"))


def _label(task: Any) -> str:
    parts = [getattr(task, name, "") for name in ("law", "controller", "source", "rig", "name", "scenario")]
    return " ".join(str(part) for part in parts if part)

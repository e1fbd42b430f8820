"""`hydro-env close-loop`: is a model repaired by a diagnosis worth anything to the controller that is designed on it?

    hide      effects are hidden in a rig that the independent reference simulator plays; its base parameters are wrong too
    diagnose  the rig's logs give model.yaml
    tune      each controller is designed and tuned three times with the same budget and seed: on the model an engineer has
              (`wrong`), on the repaired one (`repaired`), and on the true one (`true`), the ceiling
    score     each of them drives the hidden rig, on scenarios that no tuning has seen

A rig stands for a case (what is hidden) and a seed (how large, which manoeuvres, which base parameters). Shipped controllers
that were made for any pair of valves and know no model of the rig are driven as well, for comparison (`none`).

The summary has means over hidden rigs. Their intervals are 95 % percentile bootstrap ones: cases are drawn again, and in each of
them its seeds.
"""

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, product
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.controllers import make_controller
from hydro_env.diagnosis import diagnose
from hydro_env.errors import InputError, check_known
from hydro_env.experiments import close_loop_drives as drives
from hydro_env.experiments.coverage import by_channel
from hydro_env.files import write_json, write_text
from hydro_env.parallel import Failure, Store
from hydro_env.parallel import run as run_tasks
from hydro_env.plant import PlantModel
from hydro_env.practice.generate import constants_of, make_practice
from hydro_env.tasks import Trace, compute, load_scenario

SCHEMA = "hydro_env/close_loop/1"
#: What is hidden, by the name of the case.
CASES: dict[str, tuple[str, ...]] = {
    "dead_zone": ("dead_zone:1",),
    "hysteresis": ("magnetic_hysteresis:2",),
    "droop": ("supply_droop",),
    "mixed": ("dead_zone:2", "magnetic_hysteresis:1"),
}
#: What scores are made on. Tuning has seen none of them.
SCENARIOS = ("setpoint_steps", "load_step", "sine")
#: Largest error of a base parameter of the model that the engineer has, and the length of each log, s.
BASE_ERROR, DURATION = 0.1, 12.0
#: Controllers as shipped, which know no model of the rig.
SHIPPED = ("cross_coupled", "adaptive_flow", "probing_flow")
#: Models on which a controller is tuned.
SOURCES = ("wrong", "repaired", "true")
METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm")
RESAMPLES = 4000


# --- rigs ---------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class RigTask:
    """A rig to be made and diagnosed."""

    case: str
    seed: int

    def __str__(self) -> str:
        return f"{self.case}_{self.seed}"

    def row(self) -> dict[str, Any]:
        """What tables say of it."""
        return {"rig": str(self), "case": self.case, "seed": self.seed}

    @property
    def number(self) -> int:
        """Seed of the practice logs: no two rigs share one."""
        return 100 * list(CASES).index(self.case) + self.seed

    def run(self) -> "Rig":
        """Hides, logs and diagnoses."""
        practice = make_practice(
            CASES[self.case], model="paper", base_error=BASE_ERROR, seed=self.number, duration=DURATION
        )
        with tempfile.TemporaryDirectory() as folder:
            practice.write(Path(folder))
            logs = [Path(folder) / f"{name}.csv" for name in ("fit_1", "fit_2", "sealed")]
            found = diagnose(logs[:2], logs[2:], model=Path(folder) / "model.yaml")
        models = {"wrong": practice.given, "repaired": found.model, "true": practice.true}
        return Rig(self, models, practice.truth, found.as_dict())


@dataclass(frozen=True)
class Rig:
    """A hidden truth (the content of truth.json) and what the diagnosis made of its logs: `wrong`, `repaired` and `true` models
    by `SOURCES`, and the content of diagnosis.json."""

    task: RigTask
    models: Mapping[str, PlantModel]
    truth: Mapping[str, Any]
    diagnosis: Mapping[str, Any] = field(repr=False)

    def row(self) -> dict[str, Any]:
        """What the table of rigs says."""
        verdict, named = self.diagnosis["verdict"], by_channel(self.diagnosis["effects"])
        right = verdict == self.truth["verdict"] and named == by_channel(self.truth["effects"])
        speeds = {k: v for k, v in self.diagnosis["gap"]["sealed"].items() if k.startswith("speed")}
        return {
            **self.task.row(), "forms": self.truth["forms"],
            "hidden": self.truth["effects"], "verdict": verdict, "named": sorted(f"{n}:{c}" for n, c in named),
            "right": right, "sealed_rpm": {k: {m: v[m] for m in ("noise", "before", "after")} for k, v in speeds.items()},
        }  # fmt: skip


def write_rigs(folder: Path, rigs: Sequence[Rig]) -> None:
    """Writes each rig's models and diagnosis: `folder/RIG/{wrong,repaired,true}.yaml`, truth.json, diagnosis.json."""
    for rig in rigs:
        own = folder / str(rig.task)
        own.mkdir(parents=True, exist_ok=True)
        for source, model in rig.models.items():
            model.to_yaml(own / f"{source}.yaml")
        write_json(own / "truth.json", rig.truth)
        write_json(own / "diagnosis.json", rig.diagnosis)


# --- scores -------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Score:
    """A controller that drives a hidden rig. `gains` of a law, tuned on the model `source`; None: a shipped controller."""

    controller: str
    source: str
    rig: Rig
    scenario: str
    gains: Mapping[str, Any] | None = None

    def __str__(self) -> str:
        return f"{self.controller} {self.source} {self.rig.task} {self.scenario}"

    def row(self) -> dict[str, Any]:
        """What the scores say of it."""
        about = {"controller": self.controller, "tuned_on": self.source}
        return {**about, **self.rig.task.row(), "scenario": self.scenario}

    def run(self) -> dict[str, Any]:
        """What `scored` keeps of the drive."""
        rig, name = self.rig, self.controller
        if self.gains is None:
            controller: Any = make_controller(name)
        else:
            controller = drives.LAWS[name].build(name, rig.models[self.source], self.gains)
        forms = {"forms": rig.truth["forms"], "constants": constants_of(rig.truth)}
        return scored(drives.drive(controller, rig.models["true"], self.scenario, rig.task.seed, **forms))


def scored(trace: Trace) -> dict[str, Any]:
    """What is kept of a drive: its metrics, and the speed difference in rpm, period by period, for pictures."""
    return {
        "metrics": {name: float(value[0]) for name, value in compute(trace, METRICS).items()},
        "difference_rpm": np.round(trace.difference_rpm[:, 0], 2).tolist(),
    }


def _work(task: Any) -> Any:
    """Any task; one function, so that one store serves them all."""
    return task.run()


# --- the summary ---------------------------------------------------------------------------------------------------------
def collect(scores: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Means over rigs by controller, scenario and metric, and what repairing the model changed.

    `scores` are rows {controller, tuned_on, rig, case, seed, scenario, metrics}. Of every controller that was tuned, the
    rows hold `wrong`, `repaired`, `true` as {mean, ci95}; `change`: mean on the repaired model over that on the wrong one,
    less 1; `better`: on how many rigs it was lower. Shipped controllers have `none` alone.
    """
    groups: dict[tuple[str, bool, str], list[Mapping[str, Any]]] = {}
    for s in scores:
        groups.setdefault((s["controller"], s["tuned_on"] == "none", s["scenario"]), []).append(s)
    return [
        {"controller": controller, "scenario": scenario, "metric": metric, **_compared(own, metric)}
        for (controller, _, scenario), own in groups.items()
        for metric in METRICS
    ]


def _compared(scores: Sequence[Mapping[str, Any]], metric: str) -> dict[str, Any]:
    """A controller on a scenario: means of a metric by model over the rigs that all models have, and the change."""
    values: dict[str, dict[tuple[str, int], float]] = {}
    for s in scores:
        values.setdefault(s["tuned_on"], {})[s["case"], s["seed"]] = s["metrics"][metric]
    rigs = sorted(set.intersection(*(set(each) for each in values.values())))
    drawn = _drawn(rigs)
    of = {source: np.array([each[rig] for rig in rigs]) for source, each in values.items()}
    means = {source: each[drawn].mean(axis=1) for source, each in of.items()}
    row: dict[str, Any] = {"n": len(rigs)}
    for source, each in of.items():
        row[source] = {"mean": float(each.mean()), "ci95": _interval(means[source])}
    if {"wrong", "repaired"} <= of.keys():
        mean = float(of["repaired"].mean() / of["wrong"].mean() - 1.0)
        row["change"] = {"mean": mean, "ci95": _interval(means["repaired"] / means["wrong"] - 1.0)}
        row["better"] = int(np.sum(of["repaired"] < of["wrong"]))
    return row


def _drawn(rigs: Sequence[tuple[str, int]]) -> Any:
    """Places of the rigs in every resample (RESAMPLES, n): cases drawn again, and in each of them as many of its seeds."""
    stream = np.random.default_rng(0)
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
            sources = ("none",) if shipped else SOURCES
            titled = f"{name} as shipped" if shipped else name
            cells = [titled, scenario, *(_shown(largest[s]) for s in sources)]
            cells += [""] * 4 if shipped else [_change(largest), f"{largest['better']} of {largest['n']}"]
            cells += [", ".join(f"{row[s]['mean']:.1f}" for s in sources) for row in (rms, tracking)]
            lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _shown(entry: Mapping[str, Any]) -> str:
    low, high = entry["ci95"]
    return f"{entry['mean']:.1f} [{low:.1f}, {high:.1f}]"


def _change(row: Mapping[str, Any]) -> str:
    low, high = (100.0 * v for v in row["change"]["ci95"])
    return f"{100.0 * row['change']['mean']:+.0f} % [{low:+.0f}, {high:+.0f}]"


def summary(data: Mapping[str, Any]) -> str:
    """What the command prints."""
    right = sum(row["right"] for row in data["rigs"])
    head = f"{len(data['rigs'])} hidden rigs, {right} named correctly. Errors on the hidden rigs:"
    failed = [f"failed: {each['task']}: {each['reason']}" for each in data["failed"]]
    return "\n".join([head, table(data), *failed])


# --- all of it ------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Settings:
    """Which rigs are made and how much is searched.

    Args:
        cases: names of `CASES`.
        seeds: rigs of each case, with the seeds `seed`, `seed + 1`, ...
        generations: of every search for gains.

    InputError for an unknown case or a number that cannot be.
    """

    cases: tuple[str, ...] = tuple(CASES)
    seeds: int = 2
    seed: int = 0
    generations: int = drives.GENERATIONS

    def __post_init__(self) -> None:
        check_known("unknown case", self.cases, CASES)
        if self.seeds < 1 or self.seed < 0 or self.seed + self.seeds > 100:
            raise InputError(f"seeds {self.seed} to {self.seed + self.seeds - 1}: 0 to 99 are right")


def run(
    out: str | Path, settings: Settings | None = None, *, cells: str | Path | None = None, jobs: int = 1,
    engine: str = "local", progress: bool = True,
) -> dict[str, Any]:  # fmt: skip
    """Closes the loop on every case and seed; writes close_loop.json, traces.json, close_loop.md and rigs/.

    Args:
        out: an existing folder.
        cells: folder that keeps what is done, so that a run that was stopped goes on; None: nothing is kept.
        jobs, engine: see `hydro_env.parallel`.
        progress: whether to show progress bars.

    Returns the content of close_loop.json. InputError if nothing could be done.
    """
    out, settings = Path(out), settings or Settings()
    # The text of a task holds all that its result depends on.
    store = None if cells is None else Store(cells, repr)
    work = partial(run_tasks, function=_work, engine=engine, jobs=jobs, progress=progress, store=store)
    failed: list[dict[str, str]] = []

    def done(tasks: Sequence[Any], unit: str) -> list[tuple[Any, Any]]:
        """Tasks with their results; those that failed are noted and left out."""
        results = list(zip(tasks, work(tasks, unit=unit), strict=True))
        failed.extend({"task": str(t), "reason": r.reason} for t, r in results if isinstance(r, Failure))
        return [(t, r) for t, r in results if not isinstance(r, Failure)]

    numbers = range(settings.seed, settings.seed + settings.seeds)
    rigs = [rig for _, rig in done([RigTask(*each) for each in product(settings.cases, numbers)], "rig")]
    if not rigs:
        raise InputError(f"no rig could be made: {failed[0]['reason']}")
    wanted = {rig.task: _tunings(rig, settings.generations) for rig in rigs}
    tuned = dict(done(list(dict.fromkeys(chain(*wanted.values()))), "tuning"))
    # Of every law that could be tuned and every shipped controller, on every rig and scenario.
    tasks: list[Score] = []
    for rig, scenario in product(rigs, SCENARIOS):
        own = [each for each in wanted[rig.task] if each in tuned]
        tasks += [Score(each.law, each.source, rig, scenario, tuned[each]["gains"]) for each in own]
        tasks += [Score(name, "none", rig, scenario) for name in SHIPPED]
    scores = [{**task.row(), **result} for task, result in done(tasks, "drive")]
    data = {
        "schema": SCHEMA, "settings": _settings_row(settings, rigs), "rigs": [rig.row() for rig in rigs],
        "gains": [{**task.row(), **found} for task, found in tuned.items()], "scores": scores,
        "summary": collect(scores), "failed": failed,
    }  # fmt: skip
    write_rigs(out / "rigs", rigs)
    write(out, data)
    return data


def _tunings(rig: Rig, generations: int) -> list[drives.Tuning]:
    """Every law on every model of a rig; the wrong model is one for all rigs of a seed."""
    own = {source: "" if source == "wrong" else str(rig.task) for source in SOURCES}
    return [
        drives.Tuning(law, source, own[source], rig.models[source], rig.task.seed, generations)
        for law, source in product(drives.LAWS, SOURCES)
    ]


def _settings_row(settings: Settings, rigs: Sequence[Rig]) -> dict[str, Any]:
    return {
        "cases": {case: list(CASES[case]) for case in settings.cases}, "seeds": [settings.seed, settings.seeds],
        "base_error": BASE_ERROR, "log_s": DURATION, "tuned_on": load_scenario(drives.TUNED_ON).name,
        "episodes_of_a_tuning": drives.TUNING_EPISODES * drives.POPULATION * settings.generations,
        "weight": drives.WEIGHT,
        "truth": "practice.reference, forms: " + ", ".join(sorted({rig.truth["forms"] for rig in rigs})),
    }  # fmt: skip


def write(out: Path, data: Mapping[str, Any]) -> None:
    """Writes close_loop.json, its traces of the first scenario (traces.json) and close_loop.md."""
    scores = [{k: v for k, v in s.items() if k != "difference_rpm"} for s in data["scores"]]
    traces = [s for s in data["scores"] if s["scenario"] == SCENARIOS[0] and "difference_rpm" in s]
    write_json(out / "close_loop.json", {**data, "scores": scores})
    write_json(out / "traces.json", traces, indent=None)
    write_text(out / "close_loop.md", table(data) + "\n")

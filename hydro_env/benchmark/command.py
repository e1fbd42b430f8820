"""`hydro-env benchmark`: scores controllers on the fixed suite and writes scores.json and scores.html."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env import __version__
from hydro_env.benchmark.cells import SCORE, Cell, Conditions, by_name, cells_of, drive, overall, score_ends
from hydro_env.benchmark.report import scores_page, scores_table
from hydro_env.benchmark.result import check_protocol, read_declared, write_results
from hydro_env.benchmark.statistics import normalised, probability_of_improvement
from hydro_env.benchmark.suite import BASELINE, BOUND, PEAK, RETURN, Suite, load_suite
from hydro_env.benchmark.tuned import tuned, warn_of_others
from hydro_env.controllers.registry import CONTROLLERS
from hydro_env.controllers.user_files import controllers_in
from hydro_env.errors import InputError
from hydro_env.files import write_json, write_text
from hydro_env.pages import beside_results
from hydro_env.parallel import check_engine
from hydro_env.plant import load_model, preset_names, scales_of
from hydro_env.tasks import METRICS, OWN, SPLITS, VERSIONS, default_mismatch

SCHEMA = "hydro_env/scores/1"


@dataclass(frozen=True)
class Selection:
    """What is driven: a suite ("quick", "full", "paper" or a YAML file, see suite.yaml), narrowed or widened to these splits,
    scenarios and cases per split. The split `own` is the plant's own pair of valves. `declared`: a YAML file
    that says how the controllers were trained, for their result files."""

    suite: str | Path = "full"
    splits: Sequence[str] | None = None
    scenarios: Sequence[str] | None = None
    cases: int | None = None
    declared: str | Path | None = None

    def load(self, plant: Any) -> Suite:
        """The suite. A plant file that sets what the splits would draw is driven with its own pair of valves, unless the splits
        are named here or in a suite file. InputError for a name that does not exist."""
        splits, shipped = self.splits, Path(self.suite).suffix == ""
        if splits is None and shipped and default_mismatch(plant) == OWN:
            splits = [OWN]
        return load_suite(self.suite).narrowed(splits, self.scenarios, self.cases)


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
    check_protocol(chosen, conditions)
    training = read_declared(selection.declared) if selection else None
    specs = _specs(controllers or ["all"])
    given = len(specs)
    specs = specs + [name for name in (BASELINE, BOUND) if chosen.protocol and name not in specs]
    first: list[str] = []
    if gains is not None:
        specs, first = tuned(
            specs, conditions.plant, own=[*chosen.splits] == [OWN], period=conditions.control_period, folder=Path(gains),
            engine=engine, jobs=jobs, progress=progress,
        )  # fmt: skip
    warn_of_others(specs, conditions.plant)
    cells = list(cells_of(specs, chosen, trust))
    if out is not None:
        Path(out).mkdir(parents=True, exist_ok=True)
    done = drive(cells, conditions, engine, jobs, progress, cells_folder)
    scores = _scores(done, chosen, conditions)
    scores["about"] += f" Tuned for this plant: {', '.join(first)}." if first else ""
    if out is not None:
        write_json(Path(out) / "scores.json", scores)
        if chosen.protocol and conditions.plant in preset_names():
            trained = {cell.name: training for cell in done[: given * len(done) // len(specs)]}
            write_results(Path(out), done, scores, trained)
        with beside_results(page := Path(out) / "scores.html"):
            write_text(page, scores_page(scores, _traces(done, conditions)))
    return scores


def _specs(controllers: Sequence[Any]) -> list[Any]:
    """The controllers with "all" and files spelt out, less those for another plant; one that is also named by itself comes
    once."""
    files = [controllers_in(str(spec)) if str(spec).endswith(".py") else [spec] for spec in controllers]
    specs = list(chain.from_iterable(files))
    if "all" not in specs:
        return specs
    names = [entry.name for entry in CONTROLLERS.values() if not entry.apart]
    return names + [spec for spec in specs if spec not in ("all", *names)]


def _scores(cells: list[Cell], suite: Suite, conditions: Conditions) -> dict[str, Any]:
    cells_by_name = by_name(cells)
    names = [*cells_by_name]
    baseline = BASELINE if BASELINE in names else names[0]
    ends, scored = score_ends(cells), [cell for cell in cells if cell.metrics]
    rows = [(cell, metric, cell.summaries[metric]) for cell in scored for metric in suite.metrics]
    for cell in (cell for cell in scored if cell.place in ends):
        rows.append((cell, SCORE.name, normalised(cell.summaries[RETURN], ends[cell.place])))
    plant = conditions.plant
    label = plant if isinstance(plant, str) else str(getattr(plant, "name", plant))
    drawn = {split: _drawn_over(plant, split) for split in suite.splits if split != OWN}
    return {
        "schema": SCHEMA,
        "versions": {"hydro_env": __version__, **VERSIONS},
        "suite": suite.name,
        "first": suite.first,
        "scenarios": list(suite.scenarios),
        "metrics": list(suite.metrics),
        "about": f"Suite {suite.name} on the plant {label}, control period {conditions.control_period * 1000:g} ms, "
        f"seed {conditions.seed}. {_valves(suite, drawn)}{_unscored(cells, ends)}",
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
        "rows": [{**cell.about, "metric": metric, **s.row} for cell, metric, s in rows],
        "failed": _told(cells, "reason", "failure"),
        "never_settled": _told(cells, "cases", "unsettled"),
        "idle": _told(cells, "idle", "idle"),
        "decision_us": {name: _decision_us(own) for name, own in cells_by_name.items()},
        "notes": _told(cells, "note", "note"),
        "improvement": list(_improvement(cells, suite, baseline)),
        "overall": [
            {"controller": name, "metric": metric, **s.row}
            for name, own in cells_by_name.items()
            for metric, s in overall(own, ends).items()
        ],
    }


def _decision_us(cells: Iterable[Cell]) -> float:
    """The median time that a controller takes for a rig and a command, us."""
    return round(1e6 * float(np.median([cell.decision_s for cell in cells])), 2)


def _told(cells: list[Cell], key: str, of: str) -> list[dict[str, Any]]:
    """What there is to be told of cells, their field `of`, under `key`, each with its place."""
    return [{**cell.about, key: value} for cell in cells if (value := getattr(cell, of))]


def _drawn_over(plant: Any, split: str) -> list[str]:
    """Values of a plant that are not scored, since the split draws them: base parameters and effects."""
    own, ranges = load_model(plant).values, SPLITS[split].ranges
    told = []
    for name in filter(own.__contains__, ranges):
        how = " (varied about it)" if isinstance(ranges[name].meant_for, float) else ""
        told.append(name.partition(".")[0] + how)
    return list(dict.fromkeys(told))


def _valves(suite: Suite, drawn: dict[str, list[str]]) -> str:
    """Whose valves are scored, in words: the plant's own, or drawn ones, and what of the plant these take the place of."""
    sentences = ["Split own: the plant's own pair of valves."] if OWN in suite.splits else []
    for names in dict.fromkeys(tuple(each) for each in drawn.values()):
        alike = [split for split, each in drawn.items() if tuple(each) == names]
        instead = f" in place of the plant's own {', '.join(names)}" if names else ""
        sentences.append(f"Split {', '.join(alike)}: pairs of valves are drawn{instead}.")
    return " ".join(sentences)


def _unscored(cells: list[Cell], ends: Mapping[tuple[str, str], Any]) -> str:
    """Why there is no normalised score somewhere, in a sentence; nothing where there is one everywhere."""
    missing = [name for name in (BASELINE, BOUND) if name not in {cell.name for cell in cells}]
    if missing:
        return f" No {SCORE.title}: {' and '.join(missing)} did not take part."
    places = dict.fromkeys(" ".join(cell.place) for cell in cells if cell.place not in ends)
    why = f"where {BASELINE} or {BOUND} failed or their intervals of the return touch"
    return f" No {SCORE.title} in {', '.join(places)}, {why}." if places else ""


def _improvement(cells: list[Cell], suite: Suite, baseline: str) -> Iterator[dict[str, Any]]:
    """How probably each cell's controller does better than the baseline on the same case."""
    theirs = {cell.place: cell.metrics for cell in cells if cell.name == baseline}
    for cell in cells:
        if cell.name == baseline or not cell.metrics or not theirs[cell.place]:
            continue
        for metric in suite.metrics:
            sign = -1.0 if METRICS[metric].more else 1.0
            chance = probability_of_improvement(
                sign * cell.metrics[metric], sign * theirs[cell.place][metric]
            )
            yield {**cell.about, "metric": metric, "over": baseline, "probability": chance}


def _traces(cells: list[Cell], conditions: Conditions) -> dict[str, Any] | None:
    """The typical and the worst case behind every row, by split, scenario and controller, for the page."""
    places: dict[str, Any] = {}
    for cell in cells:
        if cell.traces:
            places.setdefault(cell.split, {}).setdefault(cell.scenario, {})[cell.name] = cell.traces
    if not places:
        return None
    # Of the axis of the difference.
    limit = float(f"{60.0 * scales_of(load_model(conditions.plant)).speed:.2g}")
    about = {"period_s": conditions.control_period, "limit_rpm": limit, "metric": PEAK}
    return {**about, "splits": places}


def report(scores: dict[str, Any]) -> str:
    """What the command prints. InputError if every controller failed everywhere."""
    if not scores["rows"]:
        first = scores["failed"][0]
        raise InputError(f"every controller failed; {first['controller']}: {first['reason']}")
    notes = {each["controller"]: f"\nnote: {each['controller']}: {each['note']}" for each in scores["notes"]}
    return f"{scores['about']}\n\n{scores_table(scores)}{''.join(notes.values())}"

"""Writes the generated parts of README.md and of the pages in docs: `python docs/generate.py [FILE ...]`.

A generated part stands between `<!-- generated: NAME -->` and `<!-- end -->` and is never edited by hand;
tests/project/test_docs.py checks that all are up to date. The reference is made from the code, measured results from
docs/evidence/results.json. To publish new results, name the files that hold them:

    python docs/generate.py scores/scores.json speed/speed.json      # of `hydro-env benchmark` and `hydro-env speed`
    python docs/generate.py licences                                 # of the installed packages
    python docs/generate.py robustness=runs/robustness/robustness.md # the first table of a Markdown file, by its name
"""

from __future__ import annotations

import ast
import inspect
import json
import math
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import fields
from importlib import import_module, metadata
from itertools import combinations
from pathlib import Path
from typing import Any, get_type_hints

import gymnasium
import numpy as np
import typer.main
import yaml

import hydro_env.benchmark
import hydro_env.tasks
from hydro_env.benchmark.cells import SCORE
from hydro_env.benchmark.report import NEEDS
from hydro_env.benchmark.result import CLASSES, read_result
from hydro_env.benchmark.statistics import iqm, probability_of_improvement
from hydro_env.benchmark.suite import BASELINE, RETURN
from hydro_env.cli import app
from hydro_env.cli.help import examples as examples_by_command
from hydro_env.controllers import CONTROLLERS, make_controller
from hydro_env.controllers.base import Controller
from hydro_env.controllers.mpc.flow_controller import FlowSettings
from hydro_env.data_sheet import sheet
from hydro_env.diagnosis import STAGES, Settings
from hydro_env.envs import HydraulicSyncEnv, HydraulicSyncVectorEnv, Reward
from hydro_env.envs.observation import LIMIT, NOISE, OBSERVATION, SCALES
from hydro_env.envs.step_kernels import COLUMNS
from hydro_env.experiments.naming_benchmark import scoring
from hydro_env.live import link
from hydro_env.measured import mapping
from hydro_env.plant import CATALOGUE, PARAMETERS, load_model, model_files, parameter_of, preset_names
from hydro_env.plant.catalogue import separating_experiment
from hydro_env.plant.catalogue.form_corrections import CORRECTIONS, follows
from hydro_env.plant.catalogue.form_corrections import FAMILY as FORMS
from hydro_env.plant.catalogue.losses import FAMILY as LOSSES
from hydro_env.plant.model_files import sources_of
from hydro_env.practice.hidden import SEVERITIES
from hydro_env.practice.recorder import SENSORS
from hydro_env.practice.reference.forms import CONSTANTS
from hydro_env.tasks import METRICS, SCENARIOS
from hydro_env.tasks.mismatch import SENSOR_PARAMETERS
from hydro_env.tasks.rigs import QUANTITIES
from hydro_env.units import BAR, RPM, UNITS

HERE = Path(__file__).parent
ROOT = HERE.parent
EVIDENCE = HERE / "evidence"
RESULTS = EVIDENCE / "results.json"
LICENCES = HERE / "licences.json"


def pages() -> list[Path]:
    """Every page that may hold generated parts."""
    return [ROOT / "README.md", ROOT / "SECURITY.md", *sorted(HERE.rglob("*.md"))]


def _number(value: float) -> str:
    return "none" if math.isinf(value) else f"{value:.4g}"


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _cell(text: object) -> str:
    """The text in one line, with what would end a cell escaped."""
    return " ".join(str(text).split()).replace("|", "\\|")


def _table(head: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = ["| " + " | ".join(map(_cell, row)) + " |" for row in [head, ["---"] * len(head), *rows]]
    return "\n".join(lines)


# --- plant ------------------------------------------------------------------------------------------------------------
def parameters() -> str:
    rows = [
        [
            f"`{p.name}`",
            p.note or "",
            _number(p.nominal),
            p.unit,
            f"{_number(p.low)} to {_number(p.high)}",
            " to ".join(map(_number, p.possible)) + (", or 0" if p.name in ("Fc", "Fs") else ""),
            p.source,
        ]
        for p in PARAMETERS.values()
    ]
    head = [
        "symbol",
        "meaning, reading",
        "nominal",
        "unit",
        "plausible range",
        "accepted",
        "source",
    ]
    return _table(head, rows)


def presets() -> str:
    rows = []
    for name in preset_names():
        effects = load_model(name).effects
        rows.append([f"`{name}`", ", ".join(f"`{effect}`" for effect in effects) or "none"])
    return _table(["preset", "effects beyond the paper's equations"], rows)


def preset_values() -> str:
    """Every value that a preset gives or takes from its base or valve; both channels in one row where they agree."""
    rows = []
    for name in preset_names():
        preset, sources = load_model(name), sources_of(name)
        first = True
        for value, pair in preset.values.items():
            texts = [sources[value, channel] for channel in (0, 1)]
            same = pair[0] == pair[1] and texts[0] == texts[1]
            unit = _unit(parameter_of(value).unit)
            for channel in (0,) if same else (0, 1):
                where = "both" if same else channel + 1
                label = f"`{name}`" if first else ""
                rows.append([label, f"`{value}`", where, f"{pair[channel]:.6g}", unit, texts[channel]])
                first = False
    return _table(["preset", "parameter", "channel", "value", "unit", "source"], rows)


def effects() -> str:
    """The effects that are candidates of every diagnosis."""
    rows = []
    for effect in CATALOGUE.values():
        if effect.family:
            continue
        sizes = [
            f"`{p.name}` {_number(p.low)} to {_number(p.high)} {_unit(p.unit)}".strip()
            for p in effect.parameters
        ]
        name = f"`{effect.name}`<br>{effect.title}"
        port = "rig" if effect.scope == "rig" else effect.port
        rows.append([name, port, effect.summary, effect.signature, "; ".join(sizes), effect.source])
    return _table(["effect", "port", "what it is", "how it shows", "parameters", "source"], rows)


def twins() -> str:
    """Pairs that the catalogue declares indistinguishable or hard to tell apart, with the experiment that separates them."""
    rows = []
    for a, b in combinations((e for e in CATALOGUE.values() if not e.family), 2):
        never = b.name in a.indistinguishable_from or a.name in b.indistinguishable_from
        experiment = separating_experiment(a.name, b.name)
        if never or experiment:
            rows.append([f"`{a.name}`", f"`{b.name}`", "no" if never else "rarely", experiment])
    return _table(["effect", "and", "separated by the usual channels", "by this experiment"], rows)


def form_corrections() -> str:
    rows = []
    for effect in (e for e in CATALOGUE.values() if e.family == FORMS):
        of = [name for name, own in CORRECTIONS.items() if effect.name in own]
        repeated = {n.split(".")[1] for name in of for n in follows(effect.name, name)}
        numbers = [f"`{p.name}`" for p in effect.parameters if p.name not in repeated]
        serves = ", ".join(f"`{name}`" for name in of)
        rows.append([f"`{effect.name}`", effect.port, effect.summary, ", ".join(numbers), serves])
    return _table(["correction", "port", "what it is", "parameters", "of the effects"], rows)


def severities() -> str:
    rows = [[f"`{name}`", f"{low:g}", f"{high:g}"] for name, (low, high) in SEVERITIES.items()]
    return _table(["severity", "least multiple", "greatest multiple"], rows)


def sensors() -> str:
    rows = [[name, s.unit, f"{s.noise:g}", f"{s.resolution:g}"] for name, s in SENSORS.items()]
    return _table(["signal", "unit", "standard deviation", "resolution"], rows)


def form_constants() -> str:
    rows = [
        [
            f"`{c.name}`",
            c.unit,
            f"{c.low:.3g}",
            f"{c.high:.3g}",
            "by factors" if c.log else "evenly",
            c.reason,
        ]
        for c in CONSTANTS
    ]
    return _table(["constant", "unit", "least", "greatest", "drawn", "why"], rows)


def losses() -> str:
    rows = []
    for effect in (e for e in CATALOGUE.values() if e.family == LOSSES):
        for number, p in enumerate(effect.parameters):
            span = f"{_number(p.low)} to {_number(p.high)}"
            label = f"`{effect.name}`" if number == 0 else ""
            rows.append(
                [
                    label,
                    f"`{p.name}`",
                    p.note,
                    _unit(p.unit),
                    _number(p.nominal),
                    _number(p.typical),
                    span,
                    p.source,
                ]
            )
    head = ["effect", "parameter", "meaning", "unit", "neutral", "medium", "range", "source"]
    return _table(head, rows)


# --- controllers ------------------------------------------------------------------------------------------------------
def controllers() -> str:
    rows = []
    for name, entry in CONTROLLERS.items():
        controller = make_controller(name)
        plant = getattr(controller, "plant", None)
        rows.append(
            [
                f"`{name}`",
                entry.summary,
                NEEDS[getattr(controller, "needs", "measurements")] or "none",
                f"`{plant}`" if plant else "",
            ]
        )
    return _table(["controller", "what it does", "privileged information", "plant of its own"], rows)


def law_settings() -> str:
    """Settings of the flow controller: a row for each field of each part."""
    rows: list[list[object]] = []

    def add(kind: type, path: str) -> None:
        for name, hint in get_type_hints(kind, include_extras=True).items():
            default = kind._field_defaults[name]  # type: ignore[attr-defined]
            if hasattr(default, "_fields"):
                add(type(default), f"{path}.{name}")
                continue
            value = default if isinstance(default, bool) else f"{default:.4g}"
            unit, summary, *reasons = hint.__metadata__
            text = ". ".join([summary, *(f"{reason[:1].upper()}{reason[1:]}" for reason in reasons)])
            rows.append([f"`{path}.{name}`", str(value).lower(), _unit(unit), text])

    add(FlowSettings, "law")
    return _table(["setting", "default", "unit", "meaning and source"], rows)


def gains() -> str:
    """Gains at a control period of 10 ms."""
    rows = []
    for name in CONTROLLERS:
        controller = make_controller(name)
        if isinstance(controller, Controller):
            texts = []
            for gain in controller.GAINS:
                value = np.ravel(controller.gains[gain.name])
                if np.all(np.isfinite(value)):
                    numbers = ", ".join(f"{v:.0f}" if v >= 1000 else f"{v:.4g}" for v in value)
                    texts.append(f"{gain.name} {numbers} {_unit(gain.unit)}".strip())
            rows.append([f"`{name}`", "; ".join(texts)])
    return _table(["controller", "gains at 10 ms"], rows)


# --- task -------------------------------------------------------------------------------------------------------------
def _yaml(package: Any, name: str) -> Any:
    return yaml.safe_load((Path(package.__file__).parent / name).read_text(encoding="utf-8"))


def _drawn(value: Any) -> str:
    if not isinstance(value, dict):
        return str(value)
    kind = next(k for k in ("uniform", "loguniform") if k in value)
    low, high = value[kind]
    text = f"{_number(low)} to {_number(high)}" + (", log-uniform" if kind == "loguniform" else "")
    return text + (f", at most `{value['at_most']}`" if "at_most" in value else "")


def splits() -> str:
    """Ranges of what each split draws; splits of the same ranges share a column."""
    found: dict[str, tuple[str, dict[str, Any]]] = {}
    for name, split in _yaml(hydro_env.tasks, "splits.yaml")["splits"].items():
        ranges = {"pairs": split.get("cases", "unlimited"), **split["parameters"]}
        ranges |= {f"rig: {key}": value for key, value in split.get("rig", {}).items()}
        shown = {key: str(value) if key == "pairs" else _drawn(value) for key, value in ranges.items()}
        same = repr({key: value for key, value in shown.items() if key != "pairs"})
        if same in found:
            title, before = found[same]
            title, shown["pairs"] = f"{title}, `{name}`", f"{before['pairs']}, {shown['pairs']}"
        else:
            title = f"`{name}`"
        found[same] = title, shown
    columns = dict(found.values())
    rows = []
    for key in dict.fromkeys(key for shown in columns.values() for key in shown):
        rows.append([_with_unit(key), *(shown.get(key, "") for shown in columns.values())])
    return _table(["parameter", *columns], rows)


def _with_unit(name: str) -> str:
    """A parameter of a split, with its unit or meaning."""
    if name == "pairs":
        return name
    if name.startswith("rig: "):
        quantity = name.removeprefix("rig: ")
        return f"`{quantity}`: {QUANTITIES.get(quantity, 'how many times as slow everything is')}"
    unit = "" if name in SENSOR_PARAMETERS else _unit(parameter_of(name).unit)
    return f"`{name}`" + (f", {unit}" if unit else "")


def faults() -> str:
    rows = []
    for name, values in _yaml(hydro_env.tasks, "splits.yaml")["splits"]["faulted"]["faults"].items():
        rows.append([f"`{name}`", "; ".join(f"`{key}` {_drawn(value)}" for key, value in values.items())])
    return _table(["fault", "drawn values (SI)"], rows)


def scenarios() -> str:
    rows = [[f"`{s.name}`", s.summary, f"{s.duration:g} s"] for s in SCENARIOS.values()]
    return _table(["scenario", "what is driven", "length"], rows)


def metrics() -> str:
    rows = [[f"`{m.name}`", m.unit, m.definition] for m in METRICS.values()]
    return _table(["metric", "unit", "definition"], rows)


def suites() -> str:
    rows = []
    for name, suite in _yaml(hydro_env.benchmark, "suite.yaml").items():
        pairs = ", ".join(f"`{split}` {count}" for split, count in suite["splits"].items())
        rows.append([f"`{name}`", pairs, ", ".join(f"`{each}`" for each in suite["scenarios"])])
    return _table(["suite", "pairs of each split", "scenarios"], rows)


def packages() -> str:
    """The parts of the package and what each may import, from the table that the tests check."""
    text = (ROOT / "tests" / "project" / "test_architecture.py").read_text(encoding="utf-8")
    allowed = next(
        ast.literal_eval(node.value)
        for node in ast.parse(text).body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "ALLOWED"
    )
    rows = []
    for name, others in allowed.items():
        if not name.startswith("_"):
            file = ROOT / "hydro_env" / name / "__init__.py"
            source = file if file.exists() else file.parent.with_suffix(".py")
            what = (ast.get_docstring(ast.parse(source.read_text(encoding="utf-8"))) or "").splitlines()[0]
            rows.append([f"`{name}`", what, ", ".join(f"`{other}`" for other in others.split())])
    return _table(["part of `hydro_env`", "what it is", "may import"], rows)


def diagnosis_stages() -> str:
    """The stages in their order."""
    rows = [
        [number, f"`{sys.modules[stage.__module__].__name__.rpartition('.')[2]}`", text, _first_line(stage)]
        for number, (stage, text) in enumerate(STAGES.items(), 1)
    ]
    return _table(["", "module in `hydro_env/diagnosis/stages`", "stage", "what it does"], rows)


def diagnosis_settings() -> str:
    """The fields of `Settings` with the comments above them."""
    rows = []
    for comment, name in re.findall(r"((?: +#:.*\n)+) +(\w+):", inspect.getsource(Settings)):
        default = getattr(Settings(), name)
        shown = "" if default == frozenset() else f"`{default}`"
        rows.append([f"`{name}`", comment.replace("#:", ""), shown])
    return _table(["setting", "meaning", "default"], rows)


def _first_line(thing: Any) -> str:
    return (thing.__doc__ or "").strip().splitlines()[0]


def environment() -> str:
    """The docstring of the environment from `info` on; the page has the rest as tables."""
    text = inspect.cleandoc(HydraulicSyncEnv.__doc__ or "")
    return text[text.index("## Info") :].replace("## ", "### ")


def batch() -> str:
    """What the docstring of the batch lists."""
    text = inspect.cleandoc(HydraulicSyncVectorEnv.__doc__ or "")
    return text[text.index("\n* ") + 1 :]


def observation() -> str:
    """The signals of a frame."""
    units = {"setpoint": ("rpm", RPM), "speed": ("rpm", RPM), "current": ("A", 1.0), "pressure": ("bar", BAR)}
    levels = {"speed": NOISE["speed_rpm"], "current": NOISE["current_A"], "pressure": NOISE["pressure_bar"]}
    meaning = {
        "setpoint": "set-point of the period that begins",
        "speed": "measured speed of motor",
        "current": "measured current of coil",
        "pressure": "measured pressure difference over motor",
        "command": "last command, clipped, of valve",
    }
    rows = []
    for number, (name, scale) in enumerate(zip(OBSERVATION, SCALES, strict=True)):
        kind, _, channel = name.partition("_")
        unit, factor = units.get(kind, ("of the rated command", 1.0))
        noise = f"{levels[kind]:g} {unit}" if kind in levels else "none"
        one = scale / factor
        limit = 1.0 if kind == "command" else LIMIT
        bounds = f"±{limit * one:g} {unit}"
        rows.append([number, f"`{name}`", f"{meaning[kind]} {channel}", f"{one:g} {unit}", bounds, noise])
    head = ["index", "name", "what it is", "1.0 stands for", "clipped to", "noise (standard deviation)"]
    return _table(head, rows)


def reward() -> str:
    """The terms of the reward with their default weights."""
    weights = Reward()
    formulas = {
        "tracking": "|speed - set-point| / 100 rpm, mean of both motors",
        "difference": "|speed 1 - speed 2| / 100 rpm",
        "variation": "|command - command before| as a fraction of the rated one, mean of both valves",
        "divergence": "1, once, if the simulation diverges",
    }
    rows = []
    for each in fields(Reward):
        key = f"reward_{each.name}"
        told = f'`info["{key}"]`' if key in COLUMNS else ""
        rows.append([f"`{each.name}`", f"{getattr(weights, each.name):g}", formulas[each.name], told])
    return _table(["term", "weight", "what is weighed and subtracted", "where it is told"], rows)


def episodes() -> str:
    """The scenarios with the length of an episode."""
    period = inspect.signature(HydraulicSyncEnv).parameters["control_period"].default
    rows = [
        [f"`{s.name}`", s.summary, f"{s.duration:g} s", s.steps(period), "yes" if s.random else ""]
        for s in SCENARIOS.values()
    ]
    head = ["scenario", "what is driven", "length", f"steps at {period:g} s", "random in each episode"]
    return _table(head, rows)


def threshold() -> str:
    """The reward threshold of the registered specification."""
    spec = gymnasium.spec("HydraulicSync-v0")
    return (
        f'`gymnasium.spec("HydraulicSync-v0").reward_threshold` is {spec.reward_threshold:g}, a little below the mean return '
        "of `cross_coupled` in the default task."
    )


# --- command line and files -------------------------------------------------------------------------------------------
def _commands() -> dict[str, Any]:
    """All commands by what stands behind `hydro-env`, those of groups as `export fmu`."""
    found: dict[str, Any] = {}
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        inner = getattr(command, "commands", None)
        found |= {name: command} if inner is None else {f"{name} {each}": inner[each] for each in inner}
    return found


def commands() -> str:
    """Every command with its arguments and options."""
    parts = []
    for name, command in sorted(_commands().items()):
        rows = []
        for parameter in command.params:
            if getattr(parameter, "hidden", False):
                continue
            names = (
                [*parameter.opts, *parameter.secondary_opts] if parameter.param_type_name == "option" else []
            )
            label = (
                " / ".join(f"`{each}`" for each in names)
                or f"`{parameter.metavar or parameter.name.upper()}`"
            )
            default = parameter.default
            shown = "" if default is None or default is False or callable(default) else f"`{default}`"
            if parameter.required:
                shown = "required"
            rows.append([label, getattr(parameter, "help", None) or "", shown])
        text = inspect.cleandoc(command.help or "")
        examples = "\n".join(examples_by_command()[name.rpartition(" ")[2]])
        table = _table(["option", "meaning", "default"], rows)
        parts.append(f"## hydro-env {name}\n\n{text}\n\n```text\n{examples}\n```\n\n{table}")
    return "\n\n".join(parts)


def log_columns() -> str:
    rows = [["`time_s`", "s"]]
    rows += [
        [f"`{signal}_1_{end}`, `{signal}_2_{end}`", unit] for signal, (end, unit) in mapping.CONTRACT.items()
    ]
    rows += [[f"`{column}`", unit] for column, unit in mapping.CONTRACT_RIG.values()]
    return _table(["column", "unit"], rows)


def units() -> str:
    by: dict[str, list[str]] = {}
    for unit in UNITS.values():
        by.setdefault(unit.quantity, []).append(f"`{unit.name}`")
    return _table(["quantity", "units"], [[quantity, ", ".join(names)] for quantity, names in by.items()])


def _docstring(module: Any) -> str:
    return "```text\n" + inspect.cleandoc(module.__doc__ or "") + "\n```"


# --- measured ---------------------------------------------------------------------------------------------------------
PEAK, TRACKING, TRAVEL = "max_speed_difference_rpm", "tracking_mae_rpm", "command_travel_per_s"
REVERSALS = "valve_reversals_per_s"
SCORES = (
    ("test_interp", "setpoint_steps", "set-point steps"),
    ("test_interp", "load_step", "load step"),
    ("test_interp", "sine", "sine"),
    ("test_extrap", "setpoint_steps", "set-point steps, `test_extrap`"),
)
SCENARIOS_OF_VAL = ("setpoint_steps", "load_step", "staircase", "sine", "unequal_load", "disturbance")
SHORT = ("pid_paper", "pid_tuned", "cross_coupled", "probing_flow", "servo_pid", "oracle", "ppo", "gru")
SPEED = (
    "machine", "single", "batch", "commands", "error_rpm", "error_float32_rpm", "tolerance_rpm",
    "memory_bytes_per_env", "effects", "start",
)  # fmt: skip


def licences() -> str:
    return _table(["package", "version", "licence"], json.loads(LICENCES.read_text(encoding="utf-8")))


def take_licences() -> None:
    """Keeps the declared licences of all pinned packages. A package that is not installed in the pinned version keeps its row."""
    kept = (
        {row[0]: row for row in json.loads(LICENCES.read_text(encoding="utf-8"))} if LICENCES.exists() else {}
    )
    rows, missing = [], []
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines():
        name, _, version = line.partition("==")
        try:
            about = metadata.metadata(name)
        except metadata.PackageNotFoundError:
            about = None
        if about is not None and about["Version"].partition("+")[0] == version:  # "+cpu" is the same package
            rows.append([name, version, _licence(about)])
        elif kept.get(name, ["", ""])[1] == version:
            rows.append(kept[name])
        else:
            missing.append(line)
    if missing:
        raise SystemExit(f"licences: not installed: {' '.join(missing)}")
    LICENCES.write_text(_json(rows) + "\n", encoding="utf-8")


def _licence(about: Any) -> str:
    """What a package declares: an SPDX expression, else its classifiers, else the first line of its free text."""
    classified = [
        each.rpartition(" :: ")[2]
        for each in about.get_all("Classifier", [])
        if each.startswith("License :: ")
    ]
    stated = (
        about["License-Expression"],
        "; ".join(classified),
        (about["License"] or "").strip().partition("\n")[0],
    )
    return next((text for text in stated if text), "not declared")


def take(argument: str, command: str = "") -> None:
    """Keeps what the tables need of a result file, with the commit it was measured at and the command, else the one before."""
    if argument == "licences":
        take_licences()
        return
    results, made = _results(), {"command": command} if command else {}
    name, _, path = argument.rpartition("=")
    if name:
        if name not in results["tables"]:
            raise SystemExit(f"{name}: no such table; there are {', '.join(results['tables'])}")
        lines = [line.strip() for line in Path(path).read_text(encoding="utf-8").splitlines()]
        rows = [
            [cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")
        ]
        kept = {key: value for key, value in results["tables"][name].items() if key != "commits"}
        results["tables"][name] = kept | made | {"commit": _commit(), "head": rows[0], "rows": rows[2:]}
    else:
        data = json.loads(Path(path).read_text(encoding="utf-8"))
        if data["schema"] == "hydro_env/scores/1":
            places = {column[:2] for column in SCORES} | {("val", scenario) for scenario in SCENARIOS_OF_VAL}
            columns = ["controller", "split", "scenario", "metric", "iqm", "cvar95"]
            rows = [
                [*(r[c] for c in columns[:4]), *(round(r[c], 6) for c in columns[4:])]
                for r in data["rows"]
                if (r["split"], r["scenario"]) in places and r["metric"] in (PEAK, TRACKING, TRAVEL)
            ]
            # What this file does not score keeps its rows; what no longer ships loses them.
            kept, new = results["scores"], {tuple(row[:3]) for row in rows}
            rows += [row for row in kept["rows"] if row[0] in CONTROLLERS and tuple(row[:3]) not in new]
            for split in data["splits"]:
                kept["commits"][split] = kept["commits"].get(split, {}) | dict.fromkeys(
                    data["controllers"], _commit()
                )
            kept |= made | {"seed": data["seed"], "columns": columns, "rows": rows}
        elif data["schema"] == "hydro_env/speed/1":
            kept = {"command": results["speed"]["command"], "commit": _commit()} | made
            results["speed"] = kept | {key: data[key] for key in SPEED}
        else:
            raise SystemExit(f"{path}: schema {data['schema']!r}; scores.json and speed.json are right")
    RESULTS.write_text(_json(results) + "\n", encoding="utf-8")


def keep(name: str, command: str) -> None:
    """Keeps at which commit files that lie beside results.json were measured, and with what."""
    results = _results()
    results["files"][name] = {"command": command, "commit": _commit()}
    RESULTS.write_text(_json(results) + "\n", encoding="utf-8")


def _commit() -> str:
    done = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=HERE, capture_output=True, text=True, check=True
    )
    return done.stdout.strip()


def _json(value: Any, depth: int = 0) -> str:
    """JSON with a line for every row of plain values."""
    pad = " " * (depth + 1)
    if isinstance(value, dict) and any(isinstance(each, dict | list) for each in value.values()):
        inner = [f"{pad}{json.dumps(k, ensure_ascii=False)}: {_json(v, depth + 1)}" for k, v in value.items()]
        return "{\n" + ",\n".join(inner) + "\n" + " " * depth + "}"
    if isinstance(value, list) and any(isinstance(each, dict | list) for each in value):
        return "[\n" + ",\n".join(pad + _json(each, depth + 1) for each in value) + "\n" + " " * depth + "]"
    return json.dumps(value, ensure_ascii=False)


def _results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8"))
    return found


def _origin(found: dict[str, Any]) -> str:
    commands = " and ".join(f"`{command}`" for command in found["command"].split("; "))
    if "commits" not in found:
        return f"Measured with {commands} at commit `{found['commit']}`."
    *others, most = sorted(Counter(found["commits"].values()), key=list(found["commits"].values()).count)
    rest = [
        f"; {', '.join(f'`{name}`' for name, own in found['commits'].items() if own == commit)} at `{commit}`"
        for commit in others
    ]
    return f"Measured with {commands} at commit `{most}`{''.join(rest)}."


def _stored(name: str) -> str:
    """A measured table as it is kept, with its command."""
    found = _results()["tables"][name]
    return f"{_origin(found)}\n\n{_table(found['head'], found['rows'])}"


def _scored(split: str) -> tuple[dict[str, Any], dict[tuple[str, ...], list[float]]]:
    """The scores with the commits at which those of a split were measured, and their values by what they are of."""
    found = _results()["scores"]
    commits = {name: commit for name, commit in found["commits"][split].items() if name in CONTROLLERS}
    return found | {"commits": commits}, {tuple(row[:4]): row[4:] for row in found["rows"]}


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}"


def _scores(
    cells: dict[tuple[str, ...], list[float]],
    names: Sequence[str],
    columns: Sequence[tuple[str, str, str]],
    metrics: Sequence[str],
) -> str:
    """A row per controller; each cell has the metrics of a split and scenario."""
    rows = []
    for name in names:
        row = [f"`{name}`"]
        for split, scenario, _ in columns:
            values = [cells.get((name, split, scenario, metric)) for metric in metrics]
            row.append(
                " / ".join(
                    "–" if value is None else f"{value[0]:.2f}" if metric == TRAVEL else _digits(value[0])
                    for metric, value in zip(metrics, values, strict=True)
                )
            )
        rows.append(row)
    return _table(["controller", *(heading for _, _, heading in columns)], rows)


def scores() -> str:
    found, cells = _scored("test_interp")
    return f"{_origin(found)}\n\n{_scores(cells, list(found['commits']), SCORES, (PEAK, TRACKING, TRAVEL))}"


def scores_short() -> str:
    return _scores(_scored("test_interp")[1], SHORT, SCORES[:2], (PEAK, TRACKING))


def leaderboard() -> str:
    """The result files of docs/leaderboard, the best first within a class; whoever is idle anywhere comes last."""
    found = [read_result(path) for path in sorted((HERE / "leaderboard").glob("*.json"))]
    for each in found:
        for key in ("suite", "versions", "score_ends"):
            if each[key] != found[0][key]:
                raise SystemExit(f"{each['controller']}: {key} is not that of {found[0]['controller']}")
    base = next((each for each in found if each["controller"] == BASELINE), None)
    classes = list(dict.fromkeys(CLASSES.values()))
    classes.insert(2, "servo valves")
    found.sort(
        key=lambda each: (each["idle"] > 0, classes.index(each["class"]), -each["overall"][SCORE.name]["iqm"])
    )
    rows = []
    for each in found:
        of = each["overall"]
        score, (low, high) = of[SCORE.name]["iqm"], of[SCORE.name]["ci95"]
        means = {
            name: np.mean([iqm(case["metrics"][name]) for case in each["cases"]])
            for name in (RETURN, TRAVEL, REVERSALS)
        }
        better = "" if base is None else f"{_better(each, base):.0%}"
        rows.append(
            [
                f"`{each['controller']}`" + " (idle)" * (each["idle"] > 0), each["class"], f"{score:.1f} [{low:.1f}, {high:.1f}]",
                f"{of[SCORE.name]['cvar95']:.0f}", better, f"{means[RETURN]:.0f}", f"{of[PEAK]['iqm']:.1f}",
                f"{of[TRACKING]['iqm']:.1f}", f"{means[TRAVEL]:.2f}", f"{means[REVERSALS]:.1f}", f"{each['decision_us']:.0f}",
            ]
        )  # fmt: skip
    head = [
        "controller", "class", "score [95 %]", "worst 5 %", f"better return than `{BASELINE}`", "return", "peak, rpm",
        "tracking, rpm", "travel, 1/s", "reversals, 1/s", "time per decision, µs",
    ]  # fmt: skip
    told = ", ".join(f"{name} {version}" for name, version in found[0]["versions"].items()) if found else ""
    return f"{_origin(_results()['files']['leaderboard'])} Versions: {told}.\n\n{_table(head, rows)}"


def _better(ours: dict[str, Any], theirs: dict[str, Any]) -> float:
    """The share of cases with the greater return."""
    costs = [[np.negative(case["metrics"][RETURN]) for case in each["cases"]] for each in (ours, theirs)]
    return float(np.mean([probability_of_improvement(one, other) for one, other in zip(*costs, strict=True)]))


def classical() -> str:
    """Of the controllers that are not learned: with the mean of the worst 5 % of the peak error in brackets."""
    found, cells = _scored("val")
    rows = []
    for name in found["commits"]:
        if isinstance(make_controller(name), Controller):
            row = [f"`{name}`"]
            for scenario in SCENARIOS_OF_VAL:
                peak, tracking = (cells[name, "val", scenario, metric] for metric in (PEAK, TRACKING))
                row.append(f"{peak[0]:.1f} / {tracking[0]:.1f} ({peak[1]:.0f})")
            rows.append(row)
    head = ["controller", *(f"`{scenario}`" for scenario in SCENARIOS_OF_VAL)]
    return f"{_origin(found)}\n\n{_table(head, rows)}"


def speed() -> str:
    found = _results()["speed"]
    rows = [
        [
            r["num_envs"],
            r["dtype"],
            f"{r['env_steps_per_s']:,.0f}",
            f"{r['steps_a_period']:.0f}",
            f"{r['times_real_time']:,.0f}",
        ]
        for r in found["batch"]
    ]
    head = [
        "rigs",
        "precision",
        "environment steps per s",
        "steps of a channel in 10 ms",
        "times real time",
    ]
    return f"{_origin(found)}\n\n{_table(head, rows)}"


def _by_command(value: Callable[[dict[str, Any]], str]) -> str:
    """A row per plant and precision, a column per kind of command."""
    rows = _results()["speed"]["commands"]
    kinds = list(dict.fromkeys(r["kind"] for r in rows))
    cells = {(r["plant"], r["dtype"], r["kind"]): value(r) for r in rows}
    table = [
        [f"`{plant}`", dtype, *(cells[plant, dtype, kind] for kind in kinds)]
        for plant, dtype in dict.fromkeys((r["plant"], r["dtype"]) for r in rows)
    ]
    return _table(["plant", "precision", *(kind.replace("_", "-") for kind in kinds)], table)


def accuracy() -> str:
    """Largest error of a speed by kind of command, rpm."""
    errors = _by_command(lambda r: f"{r['error_rpm']:.2g}")
    return f"{_origin(_results()['speed'])}\n\n{errors}"


def speed_commands() -> str:
    """Environment steps a second, in brackets the steps of a channel in a control period."""
    return _by_command(lambda r: f"{r['env_steps_per_s']:,.0f} ({r['steps_a_period']:.0f})")


def speed_short() -> str:
    """The README's sentence."""
    found = _results()["speed"]
    double = [r for r in found["commands"] if r["dtype"] == "float64"]

    def rates(plant: str) -> str:
        rates = sorted((r["env_steps_per_s"] for r in double if r["plant"] == plant), reverse=True)
        return f"`{plant}` {rates[0]:,.0f} to {rates[-1]:,.0f}"

    return (
        f"Environment steps per second, {double[0]['num_envs']} rigs on one thread, smooth to bang-bang commands: "
        f"{rates('paper_dead_zone')}, {rates('rig')}. Largest speed error against SciPy's stiff solver: "
        f"{found['error_rpm']['worst_against_reference']:.2g} rpm."
    )


def costs() -> str:
    found = _results()["speed"]
    start, cost = found["start"], found["effects"]
    rows = [
        ["one environment, time for a step", f"{1e6 / found['single']['env_steps_per_s']:.0f} us"],
        ["a step of a channel, base plant", f"{cost['base_ns']:.0f} ns"],
        ["a step of a channel, with a dead zone", f"{cost['dead_zone_ns']:.0f} ns"],
        ["a step of a channel, every effect compiled in", f"{cost['all_neutral_ns']:.0f} ns"],
        ["start of Python to first environment step, nothing compiled yet", f"{start['cold_s']:.1f} s"],
        ["the same, compiled before", f"{start['warm_s']:.1f} s"],
        ["memory of one rig", f"{found['memory_bytes_per_env']:.0f} bytes"],
    ]
    return _table(["what", "value"], rows)


def _evidence(name: str) -> Any:
    """A module of docs/evidence, also where this file runs as a script."""
    if str(ROOT) not in sys.path:
        sys.path.insert(0, str(ROOT))
    return import_module(f"docs.evidence.{name}")


def _trial_rows() -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = json.loads((EVIDENCE / "trials.json").read_text(encoding="utf-8"))["rows"]
    return rows


def trials() -> str:
    """Counts of the blind trials and every one that failed."""
    at = _results()["files"]["blind_trials"]["commit"]
    return f"{_evidence('blind_trials').table(_trial_rows()).strip()}\n\nMeasured at commit `{at}`."


def naming() -> str:
    """The naming benchmark: methods, and what the diagnosis says of its certainty."""
    scores = json.loads((EVIDENCE / "naming.json").read_text(encoding="utf-8"))
    made = (
        f"{_origin(_results()['files']['naming'])} The first {scores['rigs']} rigs of seed {scores['seed']}."
    )
    return f"{made}\n\n{scoring.table(scores)}"


def _counts() -> list[tuple[str, int, int]]:
    """What the blind trials count: what, how many, of how many."""
    rows = _trial_rows()
    single = [r for r in rows if r["group"] == "medium"]
    pairs = [r for r in rows if r["group"] == "two"]
    none = [r for r in rows if r["group"] in ("nothing", "parameters")]
    return [
        ("single effects named", sum(r["set"] for r in single), len(single)),
        ("pairs with both effects named", sum(r["both"] for r in pairs), len(pairs)),
        (
            "rigs without a missing effect where one is named or guessed",
            sum(r["alarm"] for r in none),
            len(none),
        ),
        ("held-out speed within 1.3 times the noise", sum(r["sealed"] for r in single), len(single)),
    ]


def diagnosis_short() -> str:
    """The README's sentence on the blind trials."""
    (_, named, single), (_, both, pairs), (_, alarms, none), _ = _counts()
    return (
        f"In blind trials against an independent simulator, {named} of {single} single effects and {both} of {pairs} pairs were "
        f"named, exactly or as declared indistinguishable. An effect was named or guessed in {alarms} of {none} rigs that lack "
        "none ([all trials](docs/blind_trials.md))."
    )


def diagnosis_results() -> str:
    """How often the diagnosis is right, by kind of test."""
    naming = json.loads((EVIDENCE / "naming.json").read_text(encoding="utf-8"))["summary"]
    own, other = (next(r for r in naming if r["method"] == name) for name in ("diagnose", "certify"))
    tables = _results()["tables"]
    rows = [["blind trials", what, f"{count} of {total}"] for what, count, total in _counts()]
    for what, key in (("effects named", "name"), ("rigs with a false name", "false_name")):
        counts = (f"{r[key]['count']} of {r[key]['of']}" for r in (own, other))
        rows.append(["naming benchmark", what, "{}; {} by `certify`".format(*counts)])
    rigs, right = tables["four_edge_rigs"]["rows"][:2]
    for seed, total, count in zip(tables["four_edge_rigs"]["head"][1:], rigs[1:], right[1:], strict=True):
        rows.append(["rigs of another simulator", f"verdict and names right, {seed}", f"{count} of {total}"])
    return _table(["test", "what is counted", "result"], rows)


PARTS: dict[str, Callable[[], str]] = {
    made.__name__: made
    for made in (
        parameters, presets, preset_values, effects, twins, form_corrections, severities, sensors, form_constants, losses,
        controllers, gains, law_settings, splits, faults, scenarios, metrics, suites, environment, batch, packages,
        observation, reward, episodes, threshold,
        diagnosis_stages,
        diagnosis_settings, commands, log_columns, units, scores, scores_short,
        classical, leaderboard, accuracy, speed, speed_commands, speed_short, costs, trials, naming, diagnosis_short,
        diagnosis_results, licences,
    )
}  # fmt: skip
PARTS["mapping_file"] = lambda: _docstring(mapping)
PARTS["link_file"] = lambda: _docstring(link)
PARTS["blind_trials_help"] = lambda: _docstring(_evidence("blind_trials"))
PARTS["model_file"] = lambda: _docstring(model_files)
PARTS["data_sheet"] = lambda: f"{_docstring(sheet)}\n\n```yaml\n{sheet.template()}```"


def part(name: str) -> str:
    """The generated part of that name; a measured table that is kept as it is if the code makes none."""
    return PARTS[name]() if name in PARTS else _stored(name)


def filled(text: str) -> str:
    """The text with every generated part made again."""

    def fill(match: re.Match[str]) -> str:
        return f"{match[1]}\n{part(match[2])}\n<!-- end -->"

    return re.sub(r"(<!-- generated: (\w+) -->)\n.*?<!-- end -->", fill, text, flags=re.S)


def write() -> None:
    """Writes the generated parts of all pages."""
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if text != filled(text):
            page.write_text(filled(text), encoding="utf-8")
            print(f"written: {page.relative_to(ROOT)}")


if __name__ == "__main__":
    for argument in sys.argv[1:]:
        take(argument)
    write()

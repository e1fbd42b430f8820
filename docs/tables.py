"""Writes the tables of the documents: `python docs/tables.py [scores/scores.json] [speed/speed.json]`.

A table stands between `<!-- table: NAME -->` and `<!-- end -->` and is never edited by hand. Those of the plant are made
from the code; measured ones from docs/results.json, which keeps what they need of the named files (by
`hydro-env benchmark` and `hydro-env speed`).
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.controllers import CONTROLLERS, make_controller
from hydro_env.controllers.base import Controller
from hydro_env.plant import CATALOGUE, PARAMETERS, load_model, parameter_of, preset_names
from hydro_env.plant.catalogue.form_corrections import CORRECTIONS, follows
from hydro_env.plant.catalogue.form_corrections import FAMILY as SHAPES
from hydro_env.plant.catalogue.losses import FAMILY as LOSSES
from hydro_env.plant.model import sources_of

HERE = Path(__file__).parent


def _number(value: float) -> str:
    return "none" if math.isinf(value) else f"{value:.4g}"


def _table(head: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *rows]]
    return "\n".join(lines)


def parameters() -> str:
    rows = [
        [
            f"`{p.name}`",
            p.note or "",
            _number(p.nominal),
            p.unit,
            f"{_number(p.low)} to {_number(p.high)}",
            p.source,
        ]
        for p in PARAMETERS.values()
    ]
    return _table(["symbol", "meaning, reading", "nominal", "unit", "plausible range", "source"], rows)


def presets() -> str:
    rows = []
    for name in preset_names():
        model = load_model(name)
        rows.append([f"`{name}`", ", ".join(f"`{effect}`" for effect in model.effects) or "none"])
    return _table(["preset", "effects beyond the paper's equations"], rows)


def preset_values() -> str:
    """Every value that a preset gives or takes from its base or valve; both channels in one row where they agree."""
    rows = []
    for name in preset_names():
        model, sources = load_model(name), sources_of(name)
        first = True
        for value, pair in model.values.items():
            texts = [sources[value, channel] for channel in (0, 1)]
            same = pair[0] == pair[1] and texts[0] == texts[1]
            unit = parameter_of(value).unit
            for channel in (0,) if same else (0, 1):
                rows.append(
                    [
                        f"`{name}`" if first else "",
                        f"`{value}`",
                        "both" if same else str(channel + 1),
                        f"{pair[channel]:.6g}",
                        "" if unit == "1" else unit,
                        texts[channel],
                    ]
                )
                first = False
    return _table(["preset", "value", "channel", "", "unit", "source"], rows)


def effects() -> str:
    """The effects that are candidates of the diagnosis; `losses` has the loss models."""
    rows = []
    for effect in CATALOGUE.values():
        if effect.family:
            continue
        sizes = [
            f"`{p.name}` {_number(p.low)} to {_number(p.high)} {p.unit if p.unit != '1' else ''}".strip()
            for p in effect.parameters
        ]
        scope = "rig" if effect.scope == "rig" else effect.port
        rows.append(
            [f"`{effect.name}`", scope, effect.summary, effect.signature, "; ".join(sizes), effect.source]
        )
    return _table(["effect", "port", "what it is", "how it shows", "parameters", "source"], rows)


def shapes() -> str:
    """Corrections of form, which are no candidates."""
    rows = []
    for effect in (e for e in CATALOGUE.values() if e.family == SHAPES):
        of = [f"`{name}`" for name, own in CORRECTIONS.items() if effect.name in own]
        repeated = {
            n.split(".")[1]
            for name, own in CORRECTIONS.items()
            if effect.name in own
            for n in follows(effect.name, name)
        }
        numbers = [f"`{p.name}`" for p in effect.parameters if p.name not in repeated]
        rows.append([f"`{effect.name}`", effect.port, effect.summary, ", ".join(numbers), ", ".join(of)])
    return _table(["correction", "port", "what it is", "numbers", "of"], rows)


def losses() -> str:
    rows = []
    for effect in CATALOGUE.values():
        if effect.family != LOSSES:
            continue
        for number, p in enumerate(effect.parameters):
            shown = "" if p.unit == "1" else p.unit
            rows.append(
                [
                    f"`{effect.name}`" if number == 0 else "",
                    f"`{p.name}`",
                    p.note,
                    shown,
                    _number(p.nominal),
                    _number(p.nominal if p.typical is None else p.typical),
                    f"{_number(p.low)} to {_number(p.high)}",
                    p.source,
                ]
            )
    head = ["effect", "parameter", "meaning", "unit", "neutral", "medium", "range", "where it comes from"]
    return _table(head, rows)


def gains() -> str:
    """Gains at 10 ms of every classical controller that ships."""
    rows = []
    for name in CONTROLLERS:
        controller = make_controller(name)
        if isinstance(controller, Controller):
            told = []
            for gain in controller.GAINS:
                value = np.ravel(controller.gains[gain.name])
                if np.all(np.isfinite(value)):
                    numbers = ", ".join(f"{v:.0f}" if v >= 1000 else f"{v:.4g}" for v in value)
                    told.append(f"{gain.name} {numbers}" + ("" if gain.unit == "1" else f" {gain.unit}"))
            rows.append([f"`{name}`", "; ".join(told)])
    return _table(["name", "gains"], rows)


# --- measured ---------------------------------------------------------------------------------------------------------
SCORES = (
    ("test_interp", "setpoint_steps", "steps"),
    ("test_interp", "load_step", "load step"),
    ("test_interp", "sine", "sine"),
    ("test_extrap", "setpoint_steps", "steps, valves beyond the training ranges"),
)
CLASSICAL = ("setpoint_steps", "load_step", "staircase", "sine", "unequal_load", "disturbance")
"""Scenarios of the table of the classical controllers, on the split `val`."""
SPEED = (
    "machine",
    "single",
    "batch",
    "error_rpm",
    "error_float32_rpm",
    "substep_s",
    "near_limit",
    "memory_bytes_per_env",
    "effects",
    "start",
)
METRICS = ("max_speed_difference_rpm", "tracking_mae_rpm")


def take(path: Path) -> None:
    """Keeps what the tables need of a result file."""
    data = json.loads(path.read_text(encoding="utf-8"))
    results = _results()
    if data["schema"] == "hydro_env/scores/1":
        places = {column[:2] for column in SCORES} | {("val", scenario) for scenario in CLASSICAL}
        rows = [r for r in data["rows"] if (r["split"], r["scenario"]) in places and r["metric"] in METRICS]
        results["scores"] = {"controllers": data["controllers"], "seed": data["seed"], "rows": rows}
    elif data["schema"] == "hydro_env/speed/1":
        results["speed"] = {key: data[key] for key in SPEED}
    else:
        raise SystemExit(f"{path}: schema {data['schema']!r}; scores.json and speed.json are right")
    text = json.dumps(results, indent=1, ensure_ascii=False)
    RESULTS.write_text(text + "\n", encoding="utf-8")


def _results() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    return found


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}"


def scores() -> str:
    found = _results()["scores"]
    cells = {(r["controller"], r["split"], r["scenario"], r["metric"]): r for r in found["rows"]}
    rows = []
    for name in found["controllers"]:
        row = [f"`{name}`"]
        for split, scenario, _ in SCORES:
            pair = [cells.get((name, split, scenario, metric)) for metric in METRICS]
            row.append(" / ".join("–" if each is None else _digits(each["iqm"]) for each in pair))
        rows.append(row)
    return _table(["controller", *(heading for _, _, heading in SCORES)], rows)


def classical() -> str:
    """Of the controllers that are not learned: with the mean of the worst 5 % of the speed difference in brackets."""
    found = _results()["scores"]
    cells = {(r["controller"], r["scenario"], r["metric"]): r for r in found["rows"] if r["split"] == "val"}
    rows = []
    for name in found["controllers"]:
        if isinstance(make_controller(name), Controller):
            row = [f"`{name}`"]
            for scenario in CLASSICAL:
                apart, off = (cells[name, scenario, metric] for metric in METRICS)
                row.append(f"{apart['iqm']:.1f} at {off['iqm']:.1f} ({apart['cvar95']:.0f})")
            rows.append(row)
    return _table(["controller", *(f"`{scenario}`" for scenario in CLASSICAL)], rows)


def speed() -> str:
    found = _results()["speed"]
    rows = [
        [
            f"{r['num_envs']}",
            r["dtype"],
            f"{r['env_steps_per_s']:,.0f}",
            f"{r['channel_substeps_per_s'] / 1e6:.1f}",
            f"{r['times_real_time']:,.0f}",
        ]
        for r in found["batch"]
    ]
    return _table(
        ["rigs", "numbers", "environment steps per s", "million channel substeps per s", "times real time"],
        rows,
    )


def error() -> str:
    found = _results()["speed"]
    double, single = (found[key]["worst_against_reference"] for key in ("error_rpm", "error_float32_rpm"))
    twin = found["near_limit"]
    return (
        f"One environment takes {1e6 / found['single']['env_steps_per_s']:.0f} us a step. The largest error of a speed "
        f"against SciPy's stiff solver on the plain equations is {double:.2g} rpm ({single:.2g} in float32), with "
        f"substeps of {found['substep_s'] * 1e6:.0f} us. The same statements compiled by a C++ compiler give the same "
        f"bits and take {twin['cpp_ns']:.0f} ns a channel substep, our kernel {twin['kernel_ns']:.0f} ns: "
        f"{twin['operations']} operations of float64 arithmetic, {100 * twin['share_of_peak']:.0f} % of the "
        f"{twin['peak_gflops']:.0f} GFLOP/s that a loop of nothing but multiplications and additions reaches on this thread. "
        "A substep costs {base_ns:.0f} ns a channel for the base plant, {dead_zone_ns:.0f} ns with a dead zone and "
        "{all_neutral_ns:.0f} ns with every effect of the catalogue compiled in; what a model does not name is not "
        "compiled. ".format(**found["effects"])
        + "From the start of Python to the first step of an environment it takes {cold_s:.1f} s with nothing compiled "
        "yet, {warm_s:.1f} s after that. ".format(**found["start"])
        + f"A rig's plant takes {found['memory_bytes_per_env']:.0f} bytes."
    )


RESULTS = HERE / "results.json"
TABLES: dict[str, Callable[[], str]] = {
    "parameters": parameters,
    "presets": presets,
    "preset_values": preset_values,
    "effects": effects,
    "losses": losses,
    "shapes": shapes,
    "gains": gains,
    "scores": scores,
    "classical": classical,
    "speed": speed,
    "error": error,
}


def filled(text: str) -> str:
    """The text with every table made anew."""

    def fill(match: re.Match[str]) -> str:
        return f"{match[1]}\n{TABLES[match[2]]()}\n<!-- end -->"

    return re.sub(r"(<!-- table: (\w+) -->)\n.*?<!-- end -->", fill, text, flags=re.S)


def main() -> None:
    for name in sys.argv[1:]:
        take(Path(name))
    for path in (HERE.parent / "README.md", *sorted(HERE.glob("*.md"))):
        path.write_text(filled(path.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()

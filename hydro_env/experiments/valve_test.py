"""`hydro-env valve-test`: the steady curves of modelled or measured valves, their figures, and the most alike pair.

What the figures mean stands in `hydro_env.valve_bench.figures`.

What choosing alike valves is worth: every pair of the modelled valves drives two equal motors under given controllers. All pairs
get the motors of the first model and the valves of their own. Both orders are driven, since a controller may have gains of its
own for each channel, under several seeds of the sensor noise.
"""

from collections.abc import Sequence
from itertools import combinations_with_replacement, product
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env.controllers.registry import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.files import write_json, write_text
from hydro_env.pages import beside_results, png, svg
from hydro_env.plant import CATALOGUE, PARAMETERS, PlantModel
from hydro_env.valve_bench.bench import Sweeps, Tested, Valve, bench, branches_csv, pairs_of
from hydro_env.valve_bench.page import draw_curves, draw_rates, gain_of, page

SCHEMA = "hydro_env/valve_test/1"
#: Valves that are tested when none is named.
VALVES = ("valve_1", "valve_2", "valve_3")
#: Controllers under which pairs are compared: the paper's, with gains of its own for each channel; the same law with
#: equal gains, which leaves the difference to the valves; and the best classical one, which learns it.
CONTROLLERS = ("pid_paper", "pid_tuned", "adaptive_flow")
SCENARIO = "setpoint_steps"
#: Base parameters of the motor and its line; the others are the valve's.
MOTOR = ("D", "J", "B", "Km", "beta", "V")
#: Ports of the effects that sit in the valve.
PORTS = ("driver", "coil", "force", "opening", "flow")
#: What is compared: speed differences, and the tracking error without which they mean little.
METRICS = ("max_speed_difference_rpm", "rms_speed_difference_rpm", "tracking_mae_rpm")


def run(
    out: str | Path, valves: Sequence[str], sweeps: Sweeps | None = None, *, controllers: Sequence[str] = CONTROLLERS,
    seeds: int = 4, pictures: bool = True, progress: bool = True,
) -> dict[str, Any]:  # fmt: skip
    """Tests the valves and writes valve_test.json, curves.csv and, if asked, the page and pictures to an existing folder.

    Args:
        out: an existing folder.
        valves, sweeps: see `hydro_env.valve_bench.bench`.
        controllers: under which all pairs of modelled valves are driven; none: no such comparison.
        seeds: how many seeds of the sensor noise per pair and order.
        pictures: whether to write valve_test.html and draw valve_test.png and valve_rates.png.
        progress: whether to show progress bars.

    Returns the content of valve_test.json. InputError for anything that cannot be used.
    """
    out = Path(out)
    for name in controllers:
        make_controller(name)  # an unknown name is reported before the long work
    tested = bench(valves, sweeps, progress=progress)
    pairs = pairs_of(tested)
    models = [each.model for each in tested if each.model is not None]
    mixed = pairs and controllers and len(models) < len(tested)
    why = "measured curves drive no pair: they say nothing of a valve's motion, only models can drive a motor"
    driven = None
    if len(models) > 1 and controllers:
        names = {valve.name for valve in models}
        first, second = next(pair["valves"] for pair in pairs if names.issuperset(pair["valves"]))
        driven = synchronisation(models, controllers, (first, second), seeds=seeds, progress=progress)
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "valves": [
            {"source": each.source, **each.figures.as_json(), "rate_check": each.rates.as_json()}
            for each in tested
        ],
        "pairs": pairs,
        "most_alike": pairs[0]["valves"] if pairs else None,
        "synchronisation": driven,
        "findings": [why] if mixed else [],
    }
    write_text(out / "curves.csv", branches_csv(tested))
    write_json(out / "valve_test.json", data)
    if pictures:
        with beside_results(out / "valve_test.html"):
            _draw(out, tested, data)
    return data


def _draw(out: Path, tested: Sequence[Tested], data: dict[str, Any]) -> None:
    # A modelled valve's loops hardly differ; a measured one's may.
    sweeps = [(each.figures.curve,) if each.model else each.sweeps for each in tested]
    curves = draw_curves(sweeps, [each.figures for each in tested])
    inline: list[Any] = [svg(curves, "flow over signal of every valve"), None]
    png(curves, out / "valve_test.png")
    several = [each for each in tested if each.rates.hysteresis_percent is not None]
    if several:
        rates = draw_rates([each.figures.curve.name for each in several], [each.rates for each in several])
        inline[1] = svg(rates, "width of the loop over the sweep rate")
        png(rates, out / "valve_rates.png")
    write_text(out / "valve_test.html", page(data, *inline))


# --- pairs -----------------------------------------------------------------------------------------------------------
def pair_model(first: Valve, second: Valve, rig: PlantModel) -> PlantModel:
    """The rig with these two valves: motors, loads, supply and sensors are those of `rig`, alike on both channels."""
    of_valve = {name: name not in MOTOR for name in PARAMETERS}
    declared = {*first.model.declared, *second.model.declared, *rig.declared}
    for name, effect in CATALOGUE.items():
        inside = effect.port in PORTS
        if name in (declared if inside else rig.declared):
            of_valve |= {f"{name}.{p.name}": inside for p in effect.parameters}
    values = {
        name: (first.value(name), second.value(name)) if inside else (rig.value(name, 0),) * 2
        for name, inside in of_valve.items()
    }
    return PlantModel(name=f"{first.name} + {second.name}", values=values)


def synchronisation(
    valves: Sequence[Valve], controllers: Sequence[str], alike: tuple[str, str], *, seeds: int, progress: bool
) -> dict[str, Any]:
    """Drives all pairs under all controllers, with `seeds` seeds each, and says by how much the pair `alike` wins.

    Every valve is paired with its like as well (`twins`): what is left there is the controller's, not the valves'.
    """
    names = list(dict.fromkeys(controllers))
    tasks = list(product(names, combinations_with_replacement(valves, 2)))
    rows = [
        _scores(name, first, second, valves[0].model, seeds)
        for name, (first, second) in tqdm(tasks, desc="pairs", disable=not progress, leave=False)
    ]
    twins = [row for row in rows if row["valves"][0] == row["valves"][1]]
    pairs = [row for row in rows if row not in twins]
    return {
        "scenario": SCENARIO,
        "pairs": pairs,
        "twins": twins,
        "most_alike": [_gain(name, pairs, twins, alike) for name in names],
    }


def _scores(controller: str, first: Valve, second: Valve, rig: PlantModel, seeds: int) -> dict[str, Any]:
    """Mean metrics of a pair of valves, in both orders, and their ranges."""
    orders = [(first, second)] if first is second else [(first, second), (second, first)]
    runs = [
        roll_out(
            make_controller(controller), range(seeds), plant=pair_model(*order, rig), mismatch=None, scenario=SCENARIO
        ).metrics(METRICS)
        for order in orders
    ]  # fmt: skip
    scores = {metric: np.concatenate([run[metric] for run in runs]) for metric in METRICS}
    return {
        "controller": controller,
        "valves": [first.name, second.name],
        **{metric: float(values.mean()) for metric, values in scores.items()},
        "range": {metric: [float(values.min()), float(values.max())] for metric, values in scores.items()},
        "episodes": len(orders) * seeds,
    }


def _gain(
    name: str, pairs: list[dict[str, Any]], twins: list[dict[str, Any]], alike: tuple[str, str]
) -> dict[str, Any]:
    """How the pair that is most alike does against the others under one controller."""
    metric = METRICS[0]
    rows = [row for row in pairs if row["controller"] == name]
    own = next(row for row in rows if set(row["valves"]) == set(alike))
    others = [row for row in rows if row is not own]
    like = [row[metric] for row in twins if row["controller"] == name and row["valves"][0] in alike]
    gain = {"controller": name, "valves": list(alike), metric: own[metric], "twins_rpm": float(np.mean(like))}
    if not others:
        return gain
    mean = float(np.mean([row[metric] for row in others]))
    best = min(others, key=lambda row: row[metric])
    return gain | {
        "wins": own[metric] < best[metric],
        "best_other": best["valves"],
        "rpm_less_than_best_other": best[metric] - own[metric],
        "mean_of_others_rpm": mean,
        "rpm_less_than_mean_of_others": mean - own[metric],
    }


# --- the terminal -----------------------------------------------------------------------------------------------------
def summary(data: dict[str, Any]) -> str:
    """The result in a few lines for the terminal."""
    width = max(len(valve["name"]) for valve in data["valves"])
    unit, gain = gain_of(data["valves"])
    # The unit of every column stands below its head; + and - are the two directions of the flow.
    lines = [
        f"{'valve':{width}}    dead zone    hyster.  widest     null        gain       linearity     max. flow   loop is",
        f"{'':{width}}       %           %      at, %      %     {unit:^15}      %           l/min",
        f"{'':{width}}    +       -                                +       -      +     -      +       -",
    ]
    for valve in data["valves"]:
        sides = valve["positive"], valve["negative"]
        gains = [None if side is None else {"gain": gain(valve, side)} for side in sides]
        loop = valve["hysteresis"]
        lines.append(
            f"{valve['name']:{width}} {_two(sides, 'dead_zone_percent', '7.2f')} {_number(loop['percent'], '8.2f')}"
            f"{_number(loop['widest_at_percent'], '8.0f')} {_number(valve['null']['percent'], '9.2f')}  "
            f"{_two(gains, 'gain', '#7.4g')} {_two(sides, 'linearity_percent', '5.2f')}  "
            f"{_two(sides, 'maximum_flow_lpm', '7.2f')}  {valve['rate_check']['verdict']}"
        )
    for valve in data["valves"]:
        check = valve["rate_check"]
        lines.append(f"{valve['name']}: {check['verdict']}: {check['reason']}")
        lines += [f"note: {finding}" for finding in [*valve["findings"], *check["findings"]]]
    lines += [f"note: {finding}" for finding in data["findings"]]
    for pair in data["pairs"][:3]:
        mark = "most similar:" if pair is data["pairs"][0] else ""
        apart = f"{pair['distance_percent']:.1f} % of the largest flow apart"
        lines.append(f"{mark:13} {' and '.join(pair['valves'])}, {apart}")
    if data["synchronisation"] is not None:
        lines += _driven(data["synchronisation"], 2 * width + 3)
    return "\n".join(lines)


def _driven(found: dict[str, Any], width: int) -> list[str]:
    """What the pairs do under each controller."""
    lines = ["peak synchronisation error, rpm (tracking error)"]
    lines += [
        f"  {row['controller']:14} {' + '.join(row['valves']):{width}} "
        f"{row['max_speed_difference_rpm']:6.1f} ({row['tracking_mae_rpm']:.1f})"
        for row in found["pairs"]
    ]
    for gain in (each for each in found["most_alike"] if "wins" in each):
        word, less = ("wins", "less") if gain["wins"] else ("does not win", "more")
        share = gain["max_speed_difference_rpm"] / gain["mean_of_others_rpm"]
        lines.append(
            f"  {gain['controller']}: the most similar pair {word}: {abs(gain['rpm_less_than_best_other']):.1f} rpm "
            f"{less} than the best other pair, {100.0 * share:.0f} % of the others' mean; the same valve twice: "
            f"{gain['twins_rpm']:.1f} rpm"
        )
    return lines


def _number(value: float | None, form: str) -> str:
    """A number; one that rounds to zero has no sign."""
    return "-".rjust(int(form.lstrip("#").split(".")[0])) if value is None else format(value, f"z{form}")


def _two(sides: Sequence[dict[str, Any] | None], key: str, form: str) -> str:
    return " ".join(_number(None if side is None else side[key], form) for side in sides)

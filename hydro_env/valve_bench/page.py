"""The page of a valve test: the content of valve_test.json as tables with one unit to a column, the curves, and every term."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from typing import Any

from hydro_env import __version__
from hydro_env.pages import render

Valve = Mapping[str, Any]
#: Digits after the point of percentages: a hundredth of a percent of the rated signal is finer than any valve repeats.
DIGITS = 2
NOTHING = "–"


def page(data: Mapping[str, Any], curves: Any, rates: Any) -> str:
    """The HTML page. `data` is the content of valve_test.json, `curves` and `rates` the pictures, as `pages.svg` makes them, or
    None."""
    valves, both = data["valves"], " and ".join
    findings = [each for valve in valves for each in (*valve["findings"], *valve["rate_check"]["findings"])]
    return render(
        files(__package__).joinpath("valve_test.html"),
        title=f"Valve test: {', '.join(valve['name'] for valve in valves)}",
        version=__version__,
        curves=curves,
        rates=rates,
        sides=_sides(valves),
        loops=_loops(valves),
        leakage=_leakage(valves),
        checks=[(v["name"], v["rate_check"]["verdict"], v["rate_check"]["reason"]) for v in valves],
        findings=findings + data["findings"],
        pairs=[(both(pair["valves"]), f"{pair['distance_percent']:.1f}") for pair in data["pairs"]],
        driven=[
            (row["controller"], both(row["valves"]), f"{row['max_speed_difference_rpm']:.1f}", f"{row['tracking_mae_rpm']:.1f}")
            for row in (data["synchronisation"] or {"pairs": ()})["pairs"]
        ],
    )  # fmt: skip


def gain_of(valves: Sequence[Valve]) -> tuple[str, Callable[[Valve, Mapping[str, Any]], float]]:
    """The unit of the gain of all valves, and the gain of a side of one in it: where the signals have different units, per
    percent of the rated signal."""
    units = {valve["rated_signal"]["unit"] for valve in valves}
    if len(units) == 1:
        return f"l/min per {units.pop()}", lambda valve, side: side["gain_lpm_per_unit"]
    return (
        "l/min per %",
        lambda valve, side: side["gain_lpm_per_unit"] * valve["rated_signal"]["value"] / 100.0,
    )


def _percent(value: float | None) -> str:
    """A percentage; a value that rounds to zero has no sign."""
    return NOTHING if value is None else f"{round(value, DIGITS) + 0.0:.{DIGITS}f}"


def _spread(value: float | None) -> str:
    """An uncertainty in percent, with as many digits as what it belongs to."""
    least = 10.0**-DIGITS
    return NOTHING if value is None else _percent(value) if value >= least else f"< {least:g}"


def _sides(valves: Sequence[Valve]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the table with a row for each valve and direction."""
    unit, gain = gain_of(valves)
    heads = ["dead zone, %", "dead zone ±, %", "flow begins at, %", "flow ends at, %", f"gain, {unit}", "linearity, %",
             "maximum flow, l/min", "saturated from, %"]  # fmt: skip
    rows = []
    for valve, direction in ((v, d) for v in valves for d in ("positive", "negative") if v[d] is not None):
        side, rated = valve[direction], valve["rated_signal"]["value"]
        begins, ends, flat = (
            _percent(side[at] and 100.0 * side[at] / rated)
            for at in ("opens_at", "closes_at", "saturates_at")
        )
        rows.append([
            valve["name"], direction, _percent(side["dead_zone_percent"]),
            _spread(100.0 * side["dead_zone_uncertainty"] / rated), begins, ends, f"{gain(valve, side):#.4g}",
            _percent(side["linearity_percent"]), _percent(side["maximum_flow_lpm"]), flat,
        ])  # fmt: skip
    return heads, rows


def _loops(valves: Sequence[Valve]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the table with a row for each valve."""
    heads = ["rated signal", "unit", "hysteresis, %", "hysteresis ±, %", "widest at, %", "null, %", "gain asymmetry, %",
             "maximum flow asymmetry, %", "threshold, %"]  # fmt: skip
    rows = []
    for valve in valves:
        rated, loop = valve["rated_signal"], valve["hysteresis"]
        rows.append([
            valve["name"], f"{rated['value']:.4g}", rated["unit"], _percent(loop["percent"]),
            _spread(loop["uncertainty_percent"]), _percent(loop["widest_at_percent"]),
            _percent(valve["null"]["percent"]), _percent(valve["gain_asymmetry_percent"]),
            _percent(valve["maximum_flow_asymmetry_percent"]), _percent(valve["threshold_percent"]),
        ])  # fmt: skip
    return heads, rows


def _leakage(valves: Sequence[Valve]) -> list[list[str]]:
    """Rows of the table of curves of internal leakage."""
    return [
        [valve["name"], f"{own['maximum_lpm']:.3g}", f"{own['least_lpm']:.3g}", _percent(own["null_percent"])]
        for valve in valves
        if (own := valve.get("leakage"))
    ]

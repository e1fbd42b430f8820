"""The page of a valve test: the content of valve_test.json as tables with one unit to a column, the curves, and every term.

What stands in which cell is said in valve_test.html. Pictures, flow over signal of all valves (the paper's Fig. 2) and loops over
the sweep rate, need the extra `report`.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from hydro_env import __version__
from hydro_env.pages import COLOURS, figure, legend, render
from hydro_env.units import LPM
from hydro_env.valve_bench.curve import Curve, Loop, loop_of
from hydro_env.valve_bench.figures import Figures
from hydro_env.valve_bench.rates import RateCheck

Valve = Mapping[str, Any]
#: Digits after the point of percentages: a hundredth of a percent of the rated signal is finer than any valve repeats.
DIGITS = 2
NOTHING = "–"
DOT: Any = {"markersize": 4.5, "markeredgecolor": "white", "markeredgewidth": 0.7, "zorder": 5}
#: Factor and label of the axis of a signal, by its unit.
AXES = {"A": (1e3, "current, mA"), "V": (1.0, "command, V"), "m": (1e3, "spool travel, mm")}
STYLES = ("-", (0, (4, 1.5)), (0, (1.2, 1.2)))


def page(data: Mapping[str, Any], curves: Any, rates: Any) -> str:
    """The HTML page. `data` is the content of valve_test.json, `curves` and `rates` the pictures, as `pages.svg` makes them, or
    None."""
    valves = data["valves"]
    unit, gain = gain_of(valves)
    findings = [each for valve in valves for each in (*valve["findings"], *valve["rate_check"]["findings"])]
    return render(
        files(__package__).joinpath("valve_test.html"),
        title=f"Valve test: {', '.join(valve['name'] for valve in valves)}",
        version=__version__,
        curves=curves,
        rates=rates,
        data=data,
        sides=[(v, way, v[way]) for v in valves for way in ("positive", "negative") if v[way] is not None],
        findings=findings + data["findings"],
        unit=unit,
        gain=gain,
        percent=_percent,
        spread=_spread,
    )


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


def draw_curves(valves: Sequence[Sequence[Curve]], figures: Sequence[Figures]) -> Any:
    """Flow over signal, one colour a valve; arrows show the way through the loop, dots where flow begins.

    `valves` holds the sweeps of each valve. Several sweeps of one valve are drawn the fainter, the faster they are.
    """
    drawing, (axis,) = figure(1, height=4.0)
    scale, along = _scale([sweeps[0] for sweeps in valves])
    edges: list[float] = []
    for n, (sweeps, found) in enumerate(zip(valves, figures, strict=True)):
        colour, style = COLOURS[n % len(COLOURS)], STYLES[n // len(COLOURS) % len(STYLES)]
        for place, curve in enumerate(sorted(sweeps, key=lambda curve: -curve.seconds)):
            loop = loop_of(curve)
            timed = len(sweeps) > 1 and curve.time is not None
            label = f"{curve.name}, {curve.seconds:.0f} s" if timed else curve.name
            for branch in loop.branches:
                axis.plot(branch.signal * scale(curve), branch.flow / LPM, color=colour, linestyle=style,
                          alpha=1.0 / (1.0 + place), label=label if branch is loop.branches[0] else None)  # fmt: skip
            _arrows(axis, loop, scale(curve), colour)
        sides = {1: found.positive, -1: found.negative}
        own = [sign * side.dead_zone * scale(sweeps[0]) for sign, side in sides.items() if side is not None]
        axis.plot(own, np.zeros(len(own)), "o", color=colour, **DOT)
        edges += own
    if edges:
        axis.plot([], [], "o", color="grey", label="flow begins (middle of both branches)", **DOT)
    axis.set(xlabel=along, ylabel="flow, l/min")
    axis.legend(loc="upper left", frameon=False)
    return drawing


def _scale(curves: Sequence[Curve]) -> tuple[Callable[[Curve], float], str]:
    """Factor from a curve's signal to the axis, and the axis's label: percent if the valves' inputs differ."""
    units = {curve.signal_unit for curve in curves}
    if len(units) > 1 or not units <= AXES.keys():
        return (lambda curve: curve.percent(1.0)), "signal, % of rated"
    factor, label = AXES[units.pop()]
    return (lambda curve: factor), label


def _arrows(axis: Any, loop: Loop, scale: float, colour: str) -> None:
    style = {"arrowstyle": "-|>", "color": colour, "mutation_scale": 9}
    for branch, way in ((loop.rising, 1), (loop.falling, -1)):
        if branch is None or len(branch.signal) < 10:
            continue
        x, q = branch.signal * scale, branch.flow / LPM
        for share in (0.18, 0.82):
            n = int(np.clip(share * len(x), 3, len(x) - 4))
            tail, tip = ((x[at], q[at]) for at in (n - 3 * way, n + 3 * way))
            axis.annotate("", tip, tail, arrowprops=style)


def draw_rates(names: Sequence[str], checks: Sequence[RateCheck]) -> Any:
    """Mean loop over sweep rate of each valve, with the fitted hysteresis + 2 lag rate."""
    drawing, (axis,) = figure(1, height=3.2)
    shown: set[float] = set()
    for n, (name, check) in enumerate(zip(names, checks, strict=True)):
        colour = COLOURS[n % len(COLOURS)]
        rates = np.array([100.0 * sweep.rate / check.rated for sweep in check.sweeps])
        shown |= {float(f"{rate:.2g}") for rate in rates}
        wide = np.array([100.0 * np.abs(sweep.blocks) / check.rated for sweep in check.sweeps])
        mean = np.abs(np.array([100.0 * sweep.width / check.rated for sweep in check.sweeps]))
        spread = np.abs(np.array([mean - wide.min(axis=1), wide.max(axis=1) - mean]))
        axis.errorbar(rates, mean, spread, fmt="o", color=colour, capsize=3, label=f"{name}: {check.verdict}")
        if check.hysteresis_percent is not None and check.lag_s is not None:
            fine = np.geomspace(rates.min(), rates.max(), 100)
            loop = np.abs(check.hysteresis_percent[0] + 2.0 * check.lag_s[0] * fine)
            axis.plot(fine, loop, color=colour, linewidth=0.9)
    axis.set(xlabel="sweep rate, % of the rated signal per second", ylabel="loop, % of the rated signal",
             xscale="log", ylim=(0.0, None))  # fmt: skip
    axis.set_xticks(sorted(shown), [f"{rate:g}" for rate in sorted(shown)])
    axis.set_xticks([], minor=True)
    legend(axis)
    return drawing

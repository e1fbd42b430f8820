"""The page of a valve test: the content of valve_test.json as tables with one unit to a column, the curves, and every term.

What stands in which cell is said in valve_test.html.
"""

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

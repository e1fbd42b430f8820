"""Both shafts under several controllers on the same pair of valves, as an animation for a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import numpy as np

from hydro_env.controllers.registry import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.pages import fill
from hydro_env.tasks import Trace

#: Step between the rows of a trace that are kept: 20 ms, in which a shaft at 600 rpm turns by 72 degrees.
EVERY = 2


def record(titles: Mapping[str, str], seeds: Sequence[int], *, split: str, scenario: str) -> dict[str, Any]:
    """Drives the same pair of valves with every controller.

    Args:
        titles: what the page calls each controller, by its name.
        seeds: cases of the split. The one is shown whose largest speed difference under the first controller is the median.
        split, scenario: what is driven.

    Returns what the page's script draws: `seed` of the case, `period_s` between the samples, `setpoint_rpm` (T,), and for every
    controller in `runs` `speed_rpm` (2, T) in whole rpm, `ahead_deg` (T,), by how much shaft 1 is ahead of shaft 2, and
    `command_percent` (2, T) of the rated command, that which is in force from then on.
    """
    where: dict[str, Any] = {"mismatch": split, "scenario": scenario}
    name, *_ = titles
    trace = roll_out(make_controller(name), seeds, **where).trace
    peaks = np.abs(trace.difference_rpm).max(axis=0)
    seed = seeds[int(np.argsort(peaks, kind="stable")[(len(seeds) - 1) // 2])]
    traces = {name: roll_out(make_controller(name), [seed], **where).trace for name in titles}
    return {
        "seed": seed,
        "period_s": EVERY * trace.period,
        "setpoint_rpm": _whole(traces[name].setpoint_rpm[::EVERY, 0]),
        "runs": [{"name": name, "title": titles[name], **_run(each)} for name, each in traces.items()],
    }


def _run(trace: Trace) -> dict[str, Any]:
    command = np.vstack([trace.command[:, 0], trace.command[-1:, 0]])  # after the last row the last one stays
    return {
        "speed_rpm": [_whole(trace.speed_rpm[::EVERY, 0, motor]) for motor in (0, 1)],
        "ahead_deg": _whole(trace.angle_difference_deg[::EVERY, 0]),
        "command_percent": [_whole(100.0 * command[::EVERY, motor]) for motor in (0, 1)],
    }


def _whole(values: Any) -> list[int]:
    return np.rint(values).astype(int).tolist()


def animation(recorded: Mapping[str, Any]) -> Any:
    """The part of a page (`Markup`) that plays what `record` returns; one to a page, since its elements have ids."""
    from markupsafe import Markup

    return Markup(fill(files(__package__).joinpath("shaft_animation.html"), TRACES=recorded))

"""Valves on the bench: presets and model files, of which every different channel is a valve, and files of measured curves.

The distance of two valves is the root of the mean squared difference of flow over both branches and the signals, from minus to
plus the rated signal, that both were driven over, in percent of the largest flow of all. It asks what the same signal does on
either valve, which is what a synchronising drive meets.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from os.path import commonprefix
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env.errors import InputError
from hydro_env.plant import PlantModel, load_model, preset_names
from hydro_env.units import LPM
from hydro_env.valve_bench.curve import FLOW, Curve, loop_of
from hydro_env.valve_bench.figures import Figures, identify
from hydro_env.valve_bench.rates import RateCheck, check_rates
from hydro_env.valve_bench.read import Columns, read_curve
from hydro_env.valve_bench.record import record


@dataclass(frozen=True)
class Sweeps:
    """How valves are swept.

    Args:
        signal: "current" or "command", the input over which modelled valves are read.
        seconds: lengths of the sweeps of modelled valves, s.
        columns: what the columns of measured curves are.
        periods: lengths of the measured sweeps, s: one for every file, or one for all.
        one_valve: all measured files are sweeps of the same valve.
    """

    signal: str = "current"
    seconds: tuple[float, ...] = (5.0, 20.0, 80.0)
    columns: Columns = field(default_factory=Columns)
    periods: tuple[float, ...] = ()
    one_valve: bool = False


@dataclass(frozen=True)
class Valve:
    """A modelled valve: channel 0 or 1 of a model."""

    name: str
    model: PlantModel
    channel: int

    def value(self, name: str) -> float:
        """A parameter of its model on its channel, SI."""
        return self.model.value(name, self.channel)


@dataclass(frozen=True)
class Tested:
    """One valve on the bench: all sweeps, the figures of the slowest of them (`figures.curve`), the check of all rates; its
    model if it has one.
    """

    source: str
    sweeps: tuple[Curve, ...]
    figures: Figures
    rates: RateCheck
    model: Valve | None = None


def bench(valves: Sequence[str], how: Sweeps | None = None, *, progress: bool = True) -> list[Tested]:
    """Puts every valve (preset, model file or file with a measured curve; `paper:2` is channel 2) on the bench.

    InputError for anything that cannot be used.
    """
    how = how or Sweeps()
    if not valves:
        known = ", ".join(preset_names())
        raise InputError(f"name a valve: a preset ({known}), a model file or a measured curve")
    files = [text for text in valves if not _is_model(text)]
    models = [(text, valve) for text in valves if text not in files for valve in _valves_of(text)]
    if len(how.periods) not in (0, 1, len(files)):
        told = f"--sweep-period gives {len(how.periods)} values for {len(files)} measured files"
        raise InputError(f"{told}: one for all, or one each")
    tested = []
    for text, valve in tqdm(models, desc="valves", disable=not (progress and models), leave=False):
        swept = partial(record, valve.model, valve.channel, signal=how.signal, name=valve.name)
        tested.append(_tested(text, [swept(seconds=seconds) for seconds in how.seconds], valve))
    periods = (how.periods or (how.columns.sweep_period,)) * len(files)
    columns = [replace(how.columns, sweep_period=period) for period in periods]
    curves = [read_curve(*each) for each in zip(files, columns, strict=False)]
    if how.one_valve and curves:
        tested.append(_tested(", ".join(files), _of_one_valve(curves)))
    else:
        tested += [_tested(text, [curve]) for text, curve in zip(files, curves, strict=True)]
    return _named_apart(tested)


def _of_one_valve(curves: Sequence[Curve]) -> list[Curve]:
    """Curves as sweeps of one valve: of the same rated signal, with what all names begin with as name."""
    if len({curve.signal_unit for curve in curves}) > 1:
        raise InputError("--one-valve: the files have signals of different quantities")
    rated = max(curve.rated for curve in curves)
    name = commonprefix([curve.name for curve in curves]).rstrip("_- ") or curves[0].name  # noqa: RUF071 (of letters)
    return [replace(curve, rated=rated, name=name) for curve in curves]


def _is_model(text: str) -> bool:
    """Whether a preset or a model file is meant; a word that is neither, nor looks like a file, is an unknown preset."""
    name, _ = _split(text)
    suffix = Path(name).suffix
    return name in preset_names() or suffix in (".yaml", ".yml") or not (suffix or Path(name).exists())


def _split(text: str) -> tuple[str, int | None]:
    """`paper:2` as ("paper", 1); a name without a channel has None."""
    name, colon, last = text.rpartition(":")
    if colon and name and last.isdigit() and not Path(text).exists():
        if last not in ("1", "2"):
            raise InputError(f"{text}: a rig has the channels 1 and 2, not {last}")
        return name, int(last) - 1
    return text, None


def _valves_of(text: str) -> list[Valve]:
    name, channel = _split(text)
    model = load_model(name)
    if channel is None and all(pair[0] == pair[1] for pair in model.values.values()):  # both are alike
        return [Valve(model.name, model, 0)]
    return [Valve(f"{model.name}:{c + 1}", model, c) for c in ((0, 1) if channel is None else (channel,))]


def _tested(source: str, sweeps: list[Curve], model: Valve | None = None) -> Tested:
    """The figures come from the slowest sweep, which is the steadiest."""
    slowest = max(sweeps, key=lambda curve: curve.seconds)
    why = "the curve has branches of one direction only: no loop"
    check = RateCheck("undecided", why, rated=slowest.rated)
    try:
        figures = identify(slowest)
        if figures.hysteresis_percent is not None:
            check = check_rates(sweeps)
    except InputError as problem:
        raise InputError(f"{source}: {str(problem).removeprefix(f'{slowest.name}: ')}") from None
    return Tested(source, tuple(sweeps), figures, check, model)


def _named_apart(tested: Sequence[Tested]) -> list[Tested]:
    """Valves of the same name get numbers, so that a pair can be named."""
    names = [each.figures.curve.name for each in tested]
    apart = []
    for n, (name, each) in enumerate(zip(names, tested, strict=True)):
        if names.count(name) > 1:
            name = f"{name} ({names[: n + 1].count(name)})"
        figures = replace(each.figures, curve=replace(each.figures.curve, name=name))
        apart.append(replace(each, figures=figures, model=each.model and replace(each.model, name=name)))
    return apart


def pairs_of(tested: Sequence[Tested]) -> list[dict[str, Any]]:
    """All pairs of valves with flow curves by name and distance, the most alike first."""
    curves = [each.figures.curve for each in tested if each.figures.kind == FLOW]
    return [
        {"valves": [curves[i].name, curves[j].name], "distance_percent": apart}
        for apart, i, j in most_alike(curves)
    ]


def most_alike(curves: Sequence[Curve]) -> list[tuple[float, int, int]]:
    """All pairs, the most alike first: (distance in percent of the largest flow of all, first, second)."""
    full = max((float(np.abs(curve.flow).max()) for curve in curves), default=0.0)
    pairs = itertools.combinations(range(len(curves)), 2)
    return sorted((distance(curves[i], curves[j], full), i, j) for i, j in pairs)


def distance(first: Curve, second: Curve, full_flow: float | None = None) -> float:
    """Distance of two valves in percent of `full_flow` (m3/s; their own largest flow if None). A missing branch is as the other.

    InputError if one of them is no flow curve, or they share no range of the signal.
    """
    both = [(curve, loop_of(curve)) for curve in (first, second)]
    for curve, loop in both:
        if loop.kind != FLOW:
            raise curve.refused("a leakage curve; only flow curves can be compared")
    low = max(loop.low / curve.rated for curve, loop in both)
    high = min(loop.high / curve.rated for curve, loop in both)
    if not high - low > 0.1:
        raise InputError(f"{first.name} and {second.name} were not driven over the same signals")
    share = np.linspace(low, high, 801)
    one, other = (
        np.array([branch.flow_at(share * curve.rated) for branch in (loop.branches[0], loop.branches[-1])])
        for curve, loop in both
    )
    full = full_flow or max(float(np.abs(flow).max()) for flow in (one, other))
    return 100.0 * float(np.sqrt(np.mean((one - other) ** 2))) / full


def branches_csv(tested: Sequence[Tested]) -> str:
    """The averaged branches as text: valve, direction, signal in percent of the rated one, flow in l/min."""
    lines = ["valve,direction,signal_percent,flow_lpm"]
    for each in tested:
        curve, loop = each.figures.curve, loop_of(each.figures.curve)
        name = '"' + curve.name.replace('"', "'") + '"' if "," in curve.name else curve.name
        for word, branch in (("rising", loop.rising), ("falling", loop.falling)):
            if branch is not None:
                cells = zip(curve.percent(branch.signal), branch.flow / LPM, strict=True)
                lines += [f"{name},{word},{x:.5g},{q:.6g}" for x, q in cells]
    return "\n".join(lines) + "\n"

"""`hydro-env valve-test`: the steady curves of modelled or measured valves, their figures, and the most alike pair.

A valve is a preset or model file, of which every different channel is one (`paper:2`: only channel 2), or a file with a
measured curve. Several files may be sweeps of one valve at different rates. What the figures mean stands in
`hydro_env.valve_bench.figures`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from hydro_env.errors import InputError
from hydro_env.experiments.valve_pairs import Valve, synchronisation
from hydro_env.experiments.valve_test_page import gain_of, page
from hydro_env.files import write_json, write_text
from hydro_env.pages import beside_results
from hydro_env.plant import load_model, preset_names
from hydro_env.units import LPM
from hydro_env.valve_bench.alike import most_alike
from hydro_env.valve_bench.curve import FLOW, Curve, loop_of
from hydro_env.valve_bench.figures import Figures, identify
from hydro_env.valve_bench.rates import RateCheck, check_rates
from hydro_env.valve_bench.read import Columns, read_curve
from hydro_env.valve_bench.record import own_channels, record_rates

__all__ = ["CONTROLLERS", "Settings", "Tested", "bench", "default_valves", "run", "summary"]

SCHEMA = "hydro_env/valve_test/1"
#: Lengths of the sweeps of a modelled valve, s.
SECONDS = (5.0, 20.0, 80.0)
#: Controllers under which pairs are compared: the paper's, with gains of its own for each channel; the same law with
#: equal gains, which leaves the difference to the valves; and the best classical one, which learns it.
CONTROLLERS = ("pid_paper", "pid_tuned", "adaptive_flow")


@dataclass(frozen=True)
class Settings:
    """How valves are tested.

    Args:
        signal: "current" or "command", the input over which modelled valves are read.
        seconds: lengths of the sweeps of modelled valves, s.
        columns: what the columns of measured curves are.
        sweep_periods: s, one for every measured file, or one for all.
        one_valve: all measured files are sweeps of the same valve.
        controllers: under which all pairs of modelled valves are driven; none: no such comparison.
        seeds: seeds of the sensor noise per pair and order.
        pictures: whether to write valve_test.html and draw valve_test.png and valve_rates.png.
    """

    signal: str = "current"
    seconds: tuple[float, ...] = SECONDS
    columns: Columns = field(default_factory=Columns)
    sweep_periods: tuple[float, ...] = ()
    one_valve: bool = False
    controllers: tuple[str, ...] = CONTROLLERS
    seeds: int = 4
    pictures: bool = True


@dataclass(frozen=True)
class Tested:
    """One valve on the bench: all sweeps, the slowest of them (`curve`) and its figures, the check of all rates; its
    model if it has one.
    """

    source: str
    sweeps: tuple[Curve, ...]
    curve: Curve
    figures: Figures
    rates: RateCheck
    model: Valve | None = None


def run(
    out: str | Path, valves: Sequence[str], settings: Settings | None = None, *, progress: bool = True
) -> dict[str, Any]:
    """Tests the valves (presets, model files, files of measured curves) and writes valve_test.json, curves.csv and, if asked,
    the pictures to an existing folder.

    Returns the content of valve_test.json. InputError for anything that cannot be used.
    """
    out, settings = Path(out), settings or Settings()
    for name in settings.controllers:
        from hydro_env.controllers.registry import make_controller

        make_controller(name)  # an unknown name is reported before the long work
    tested = bench(valves, settings, progress=progress)
    pairs = _pairs(tested)
    models = [each.model for each in tested if each.model is not None]
    findings = []
    if pairs and settings.controllers and len(models) < len(tested):
        findings.append(
            "measured curves drive no pair: they say nothing of a valve's motion, only models can drive a motor"
        )
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "valves": [
            {"source": each.source, **each.figures.as_json(), "rate_check": each.rates.as_json()}
            for each in tested
        ],
        "pairs": pairs,
        "most_alike": pairs[0]["valves"] if pairs else None,
        "synchronisation": _synchronised(models, pairs, settings, progress),
        "findings": findings,
    }
    write_text(out / "curves.csv", _table(tested))
    write_json(out / "valve_test.json", data)
    if settings.pictures:
        with beside_results(out / "valve_test.html"):
            _draw(out, tested, data)
    return data


def _synchronised(
    models: Sequence[Valve], pairs: Sequence[dict[str, Any]], settings: Settings, progress: bool
) -> dict[str, Any] | None:
    """All pairs of modelled valves driven by the controllers, or None if there are not two or none is to drive."""
    if len(models) < 2 or not settings.controllers:
        return None
    names = {valve.name for valve in models}
    first, second = next(pair["valves"] for pair in pairs if names.issuperset(pair["valves"]))
    return synchronisation(
        models, settings.controllers, alike=(first, second), seeds=range(settings.seeds), progress=progress
    )


def _draw(out: Path, tested: Sequence[Tested], data: dict[str, Any]) -> None:
    from hydro_env.pages import png, svg
    from hydro_env.valve_bench.picture import draw_curves, draw_rates

    # A modelled valve's loops hardly differ; a measured one's may.
    sweeps = [(each.curve,) if each.model else each.sweeps for each in tested]
    curves = draw_curves(sweeps, [each.figures for each in tested])
    inline: list[Any] = [svg(curves, "flow over signal of every valve"), None]
    png(curves, out / "valve_test.png")
    several = [each for each in tested if each.rates.hysteresis_percent is not None]
    if several:
        rates = draw_rates([each.curve.name for each in several], [each.rates for each in several])
        inline[1] = svg(rates, "width of the loop over the sweep rate")
        png(rates, out / "valve_rates.png")
    write_text(out / "valve_test.html", page(data, *inline))


def default_valves() -> list[str]:
    """Valves that are tested when none is named: the presets of single valves, or else the paper's pair."""
    return [name for name in preset_names() if name.startswith("valve_")] or ["paper_dead_zone"]


def bench(valves: Sequence[str], settings: Settings | None = None, *, progress: bool = True) -> list[Tested]:
    """Puts every valve on the bench; see `run`."""
    settings = settings or Settings()
    if not valves:
        raise InputError(
            f"name a valve: a preset ({', '.join(preset_names())}), a model file or a measured curve"
        )
    models: list[tuple[str, Valve]] = []
    files: list[str] = []
    for text in valves:
        if _is_model(text):
            models += [(text, valve) for valve in _model_valves(text)]
        else:
            files.append(text)
    if len(settings.sweep_periods) not in (0, 1, len(files)):
        raise InputError(
            f"--sweep-period gives {len(settings.sweep_periods)} values for {len(files)} measured files: one for all, "
            "or one each"
        )
    tested: list[Tested] = []
    with tqdm(total=len(models) + len(files), desc="valves", disable=not progress, leave=False) as bar:
        for text, valve in models:
            sweeps = record_rates(
                valve.model, valve.channel, settings.seconds, signal=settings.signal, name=valve.name
            )
            tested.append(_tested(text, sweeps, valve))
            bar.update()
        curves = []
        for n, text in enumerate(files):
            own = settings.columns
            if settings.sweep_periods:
                own = replace(own, sweep_period=(settings.sweep_periods * len(files))[n])
            curves.append(read_curve(text, own))
            bar.update()
    return _named_apart(tested + _measured(files, curves, settings.one_valve))


def _measured(files: Sequence[str], curves: list[Curve], one_valve: bool) -> list[Tested]:
    """Measured curves, each of a valve of its own or all of the same one."""
    if not one_valve or not curves:
        return [_tested(text, [curve], None) for text, curve in zip(files, curves, strict=True)]
    if len({curve.signal_unit for curve in curves}) > 1:
        raise InputError("--one-valve: the files have signals of different quantities")
    rated = max(curve.rated for curve in curves)
    name = _common([curve.name for curve in curves])
    return [_tested(", ".join(files), [replace(curve, rated=rated, name=name) for curve in curves], None)]


def _common(names: Sequence[str]) -> str:
    """What all names begin with, or the first name."""
    length = next(
        (n for n, letters in enumerate(zip(*names, strict=False)) if len(set(letters)) > 1), len(min(names))
    )
    return names[0][:length].rstrip("_- ") or names[0]


def _is_model(text: str) -> bool:
    name = _split(text)[0]
    return name in preset_names() or Path(name).suffix in (".yaml", ".yml") or not _looks_like_a_file(name)


def _looks_like_a_file(name: str) -> bool:
    return Path(name).exists() or bool(Path(name).suffix)


def _split(text: str) -> tuple[str, int | None]:
    """`paper:2` as ("paper", 1); a name without a channel has None."""
    name, colon, last = text.rpartition(":")
    if colon and name and last.isdigit() and not Path(text).exists():
        if last not in ("1", "2"):
            raise InputError(f"{text}: a rig has the channels 1 and 2, not {last}")
        return name, int(last) - 1
    return text, None


def _model_valves(text: str) -> list[Valve]:
    name, channel = _split(text)
    model = load_model(name)
    channels = own_channels(model) if channel is None else (channel,)
    label = model.name
    return [
        Valve(label if len(channels) == 1 and channel is None else f"{label}:{c + 1}", model, c)
        for c in channels
    ]


def _tested(source: str, sweeps: list[Curve], model: Valve | None) -> Tested:
    """The figures come from the slowest sweep, which is the steadiest."""
    slowest = max(sweeps, key=lambda curve: 0.0 if curve.time is None else float(np.ptp(curve.time)))
    try:
        figures = identify(slowest)
        if figures.hysteresis_percent is None:
            why = "the curve has branches of one direction only: no loop"
            check = RateCheck("undecided", why, rated=slowest.rated)
        else:
            check = check_rates(sweeps)
    except InputError as problem:
        raise InputError(f"{source}: {str(problem).removeprefix(f'{slowest.name}: ')}") from None
    return Tested(source, tuple(sweeps), slowest, figures, check, model)


def _named_apart(tested: list[Tested]) -> list[Tested]:
    """Valves of the same name get numbers, so that a pair can be named."""
    counts: dict[str, int] = {}
    apart = []
    names = [each.curve.name for each in tested]
    for each in tested:
        name = each.curve.name
        if names.count(name) > 1:
            counts[name] = counts.get(name, 0) + 1
            name = f"{name} ({counts[name]})"
        apart.append(
            replace(
                each,
                curve=replace(each.curve, name=name),
                figures=replace(each.figures, name=name),
                model=None if each.model is None else replace(each.model, name=name),
            )
        )
    return apart


def _pairs(tested: Sequence[Tested]) -> list[dict[str, Any]]:
    """All pairs of valves with flow curves, the most alike first."""
    able = [each for each in tested if each.figures.kind == FLOW]
    if len(able) < 2:
        return []
    return [
        {"valves": [able[i].curve.name, able[j].curve.name], "distance_percent": apart}
        for apart, i, j in most_alike([each.curve for each in able])
    ]


def _table(tested: Sequence[Tested]) -> str:
    """The averaged branches as text: valve, direction, signal in percent of the rated one, flow in l/min."""
    lines = ["valve,direction,signal_percent,flow_lpm"]
    for each in tested:
        loop = loop_of(each.curve)
        name = '"' + each.curve.name.replace('"', "'") + '"' if "," in each.curve.name else each.curve.name
        for word, branch in (("rising", loop.rising), ("falling", loop.falling)):
            if branch is None:
                continue
            for x, q in zip(100.0 * branch.signal / each.curve.rated, branch.flow / LPM, strict=True):
                lines.append(f"{name},{word},{x:.5g},{q:.6g}")
    return "\n".join(lines) + "\n"


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
        mark = "most similar: " if pair is data["pairs"][0] else "              "
        lines.append(
            f"{mark}{' and '.join(pair['valves'])}, {pair['distance_percent']:.1f} % of the largest flow apart"
        )
    found = data["synchronisation"]
    if found is not None:
        lines.append("peak synchronisation error, rpm (tracking error)")
        for row in found["pairs"]:
            lines.append(
                f"  {row['controller']:14} {' + '.join(row['valves']):{2 * width + 3}} "
                f"{row['max_speed_difference_rpm']:6.1f} ({row['tracking_mae_rpm']:.1f})"
            )
        for gain in found["most_alike"]:
            if "wins" in gain:
                word, less = ("wins", "less") if gain["wins"] else ("does not win", "more")
                share = gain["max_speed_difference_rpm"] / gain["mean_of_others_rpm"]
                lines.append(
                    f"  {gain['controller']}: the most similar pair {word}: {abs(gain['rpm_less_than_best_other']):.1f} rpm "
                    f"{less} than the best other pair, {100.0 * share:.0f} % of the others' mean; the same valve twice: "
                    f"{gain['twins_rpm']:.1f} rpm"
                )
    return "\n".join(lines)


def _number(value: float | None, form: str) -> str:
    """A number; one that rounds to zero has no sign."""
    return "-".rjust(int(form.lstrip("#").split(".")[0])) if value is None else format(value, f"z{form}")


def _two(sides: Sequence[dict[str, Any] | None], key: str, form: str) -> str:
    return " ".join(_number(None if side is None else side[key], form) for side in sides)

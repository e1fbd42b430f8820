"""The valve bench finds what was put into a valve, and says in one line what is wrong with a measured curve."""

from __future__ import annotations

import gzip
import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hydro_env import cli
from hydro_env.errors import InputError
from hydro_env.experiments.valve_test import pair_model
from hydro_env.plant import Plant, PlantModel, load_model
from hydro_env.units import LPM
from hydro_env.valve_bench import (
    Columns,
    Curve,
    check_rates,
    distance,
    identify,
    loop_of,
    most_alike,
    read_curve,
    record,
    record_rigs,
)
from hydro_env.valve_bench.bench import Sweeps, Valve, bench
from hydro_env.valve_bench.curve import resolution
from hydro_env.valve_bench.page import gain_of

#: All effects of these tests, so that one kernel serves them all.
EFFECTS = ("command_delay", "magnetic_hysteresis", "null_offset", "dead_zone", "flow_saturation", "directional_gain",
           "flow_gain_nonlinearity")  # fmt: skip
PAPER = replace(load_model("paper"), declared=EFFECTS)
#: The paper's V1 with next to no friction: what is left is what a test puts in.
SMOOTH = PAPER.with_values({"Fc": 0.0, "Fs": 0.0}, name="smooth")
FULL = 20.0 * LPM


def play(signal: np.ndarray, width: float) -> np.ndarray:
    """The output of a gap of this width."""
    out = np.empty_like(signal)
    held = 0.0
    for n, value in enumerate(signal):
        held = min(max(held, value - width / 2.0), value + width / 2.0)
        out[n] = held
    return out


def made(
    edges: tuple[float, float] = (0.1, 0.1),
    gains: tuple[float, float] = (1.0, 1.0),
    width: float = 0.0,
    *,
    noise: float = 0.0,
    rows: int = 4000,
    seconds: float = 20.0,
    lag: float = 0.0,
    quantity: str = "A",
    name: str = "made",
) -> Curve:
    """A valve in plain formulas: play, two edges, two gains (of `FULL` per rated signal), a first-order lag, noise."""
    quarter = rows // 4
    share = np.interp(np.arange(5 * quarter + 1), np.array([0, 1, 3, 5]) * quarter, [0.0, 1.0, -1.0, 1.0])
    step = seconds / (4 * quarter)
    inside = share.copy()
    if lag:
        for n in range(1, len(share)):  # exact for a ramp
            inside[n] = inside[n - 1] + (share[n] - inside[n - 1]) * (1.0 - np.exp(-step / lag))
    x = play(inside, width)
    flow = gains[0] * np.maximum(0.0, x - edges[0]) - gains[1] * np.maximum(0.0, -x - edges[1])
    flow = FULL * (flow + noise * np.random.default_rng(1).standard_normal(len(flow)))
    keep = slice(quarter, None)
    return Curve(name, share[keep], flow[keep], quantity, 1.0, np.arange(len(share))[keep] * step)


# --- truth -------------------------------------------------------------------------------------------------------------
@settings(max_examples=40, deadline=None)
@given(
    edges=st.tuples(st.floats(-0.05, 0.4), st.floats(0.05, 0.4)),
    gains=st.tuples(st.floats(0.5, 2.0), st.floats(0.5, 2.0)),
    width=st.floats(0.0, 0.15),
    rows=st.sampled_from([400, 4000, 20000]),
)
def test_what_was_put_into_a_curve_is_found(
    edges: tuple[float, float], gains: tuple[float, float], width: float, rows: int
) -> None:
    found = identify(made(edges, gains, width, rows=rows))
    assert found.positive is not None and found.negative is not None
    for side, edge, gain in zip((found.positive, found.negative), edges, gains, strict=True):
        assert side.dead_zone == pytest.approx(edge, abs=0.004)
        assert side.gain == pytest.approx(gain * FULL, rel=0.01)
        assert side.linearity_percent < 0.8
        assert side.maximum_flow == pytest.approx(gain * FULL * (1.0 - width / 2.0 - edge), rel=0.02)
    assert found.hysteresis_percent == pytest.approx(100.0 * width, abs=0.7)
    assert found.null == pytest.approx((edges[0] - edges[1]) / 2.0, abs=0.004)
    assert found.gain_asymmetry_percent == pytest.approx(100.0 * (1.0 - min(gains) / max(gains)), abs=1.0)


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(0.01, 100.0), flow=st.floats(0.1, 10.0), turned=st.booleans())
def test_percentages_do_not_depend_on_units_or_signs(scale: float, flow: float, turned: bool) -> None:
    one = made((0.2, 0.1), (1.0, 0.8), 0.05)
    other = replace(
        one,
        signal=one.signal * scale,
        rated=scale,
        flow=one.flow * flow * (-1.0 if turned else 1.0),
    )
    first, second = identify(one), identify(other)
    for name in ("hysteresis_percent", "gain_asymmetry_percent", "threshold_percent"):
        # A sample on the border of two bins may fall to either side.
        assert getattr(first, name) == pytest.approx(getattr(second, name), abs=0.05)
    assert first.positive is not None and second.positive is not None
    assert first.positive.dead_zone * scale == pytest.approx(second.positive.dead_zone, rel=1e-3)


@pytest.mark.parametrize("noise", [0.003, 0.01, 0.03])
def test_noise(noise: float) -> None:
    found = identify(made((0.2, 0.1), (1.0, 0.8), 0.06, noise=noise, rows=20_000))
    assert found.positive is not None and found.negative is not None
    assert found.positive.dead_zone == pytest.approx(0.2, abs=0.01)
    assert found.negative.dead_zone == pytest.approx(0.1, abs=0.01)
    assert found.positive.gain == pytest.approx(FULL, rel=0.02)
    assert found.mean_loop_percent == pytest.approx(6.0, abs=0.5)
    assert found.hysteresis_percent == pytest.approx(6.0, abs=0.5 + 100.0 * noise)
    assert found.noise == pytest.approx(noise * FULL, rel=0.25)


@pytest.mark.parametrize("overlaps", [(0.0, 0.0), (7e-5, 7e-5), (2e-4, 5e-5)])
@pytest.mark.parametrize("offset", [0.0, 2e-5])
def test_a_modelled_valve(overlaps: tuple[float, float], offset: float) -> None:
    """Edges within 2 um of spool travel; hysteresis as friction and magnet give it; the model's own gain."""
    model = PAPER.with_values(
        {
            "dead_zone.overlap_positive": overlaps[0],
            "dead_zone.overlap_negative": overlaps[1],
            "null_offset.offset": offset,
            "magnetic_hysteresis.amplitude": 0.3,
            "directional_gain.ratio": 0.8,
        }
    )
    data = identify(record(model, 0)).as_json()
    edges = overlaps[0] - offset, overlaps[1] + offset
    for side, edge, ratio in (("positive", edges[0], 1.0), ("negative", edges[1], 0.8)):
        assert data[side]["dead_zone_travel_m"] == pytest.approx(edge, abs=2e-6)
        assert data[side]["gain_m2_per_s"] == pytest.approx(ratio * model.value("Kq", 0), rel=0.005)
    # The spool breaks loose at Fs both ways, the magnet's loop is 0.3 N high both ways.
    force = model.value("alpha", 0) * 0.73
    assert data["hysteresis"]["percent"] == pytest.approx(
        100.0 * 2.0 * (model.value("Fs", 0) + 0.3) / force, rel=0.03
    )
    assert data["gain_asymmetry_percent"] == pytest.approx(20.0, abs=0.3)


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_valves_drawn_at_random(noise: float) -> None:
    """Edges within 3 um and gains within 0.5 %, with noise of 1 % too; the loop lies where friction and magnet put it."""
    rng = np.random.default_rng(7)
    for _ in range(8):
        friction = rng.uniform(0.1, 0.4)
        valve = {
            "Fs": friction,
            "Fc": rng.uniform(0.1, min(friction, 0.3)),
            "vs": 10.0 ** rng.uniform(-4.0, -2.0),
            "Kq": 0.476106 * rng.uniform(0.65, 1.0),
            "null_offset.offset": rng.uniform(-3e-5, 3e-5),
            "dead_zone.overlap_positive": rng.uniform(0.0, 2e-4),
            "dead_zone.overlap_negative": rng.uniform(0.0, 2e-4),
            "magnetic_hysteresis.amplitude": rng.uniform(0.0, 0.3),
        }
        curve = record(PAPER.with_values(valve), 0)
        added = noise * np.abs(curve.flow).max() * rng.standard_normal(len(curve.flow))
        found = identify(replace(curve, flow=curve.flow + added))
        travel, offset = curve.travel_per_signal, valve["null_offset.offset"]
        assert travel is not None and found.positive is not None and found.negative is not None
        for side, word, shift in (
            (found.positive, "positive", -offset),
            (found.negative, "negative", offset),
        ):
            edge = valve[f"dead_zone.overlap_{word}"] + shift
            assert side.dead_zone * travel == pytest.approx(edge, abs=3e-6)
            assert side.gain / travel == pytest.approx(valve["Kq"], rel=0.005)
        # A spool that creeps is held by something between Coulomb and static friction.
        low, high = (
            200.0 * (valve[f] + valve["magnetic_hysteresis.amplitude"]) / (20.0 * 0.73) for f in ("Fc", "Fs")
        )
        assert found.mean_loop_percent is not None and low - 0.1 < found.mean_loop_percent < high + 0.1


def test_a_curved_and_saturated_edge() -> None:
    model = SMOOTH.with_values(
        {
            "dead_zone.overlap_positive": 1e-4,
            "dead_zone.overlap_negative": 1e-4,
            "flow_gain_nonlinearity.curvature": 0.5,
        }
    )
    found = identify(record(model, 0))
    assert found.positive is not None and found.positive.saturates_at is None
    assert found.positive.dead_zone * 20.0 / 17000.0 == pytest.approx(1e-4, abs=5e-6)
    assert found.positive.linearity_percent > 2.0
    flat = identify(record(SMOOTH.with_values({"flow_saturation.opening_limit": 4.3e-4}), 0))
    assert flat.positive is not None and flat.negative is not None
    assert flat.positive.saturates_at == pytest.approx(0.73 / 2.0, rel=0.02)
    assert any("saturated from 50 %" in note for note in flat.findings)
    assert flat.threshold_percent is None


def test_where_the_loop_is_widest() -> None:
    """A loop that opens at one place only is named there."""
    curve = made((0.0, 0.0), rows=8000)
    flow = np.linspace(-1.1, 1.1, 2001)
    half = 0.05 * np.exp(-(((flow - 0.6) / 0.1) ** 2))
    rising = np.gradient(curve.signal) > 0.0
    both = [np.interp(curve.signal, flow + way * half, flow) * FULL for way in (1.0, -1.0)]
    found = identify(replace(curve, flow=np.where(rising, both[0], both[1])))
    assert found.hysteresis_percent == pytest.approx(10.0, abs=0.3)
    assert found.widest_at == pytest.approx(0.6, abs=0.03)


def test_threshold_is_seen_where_the_signal_turns() -> None:
    assert identify(made(width=0.06, rows=40_000)).threshold_percent == pytest.approx(6.0, abs=0.3)


# --- incomplete sweeps ----------------------------------------------------------------------------------------------------
def test_one_branch_only() -> None:
    curve = made((0.2, 0.1), width=0.1)
    down = slice(0, 2001)
    found = identify(replace(curve, signal=curve.signal[down], flow=curve.flow[down], time=None))
    assert found.hysteresis_percent is None and found.threshold_percent is None
    assert any("only falling branches" in note for note in found.findings)
    assert found.positive is not None and found.positive.dead_zone == pytest.approx(0.15, abs=0.005)


def test_one_side_only() -> None:
    curve = made((0.2, 0.1), width=0.1)
    use = curve.signal >= 0.0
    order = np.concatenate([np.flatnonzero(use & (np.arange(len(use)) > 2000)), np.flatnonzero(use)[:1000]])
    found = identify(replace(curve, signal=curve.signal[order], flow=curve.flow[order], time=None))
    assert found.negative is None and found.null is None and found.positive is not None
    assert found.positive.dead_zone == pytest.approx(0.2, abs=0.005)
    assert found.hysteresis_percent == pytest.approx(10.0, abs=0.5)
    assert any("no negative flow" in note for note in found.findings)


def test_sweep_that_does_not_close() -> None:
    curve = made(width=0.1)
    part = slice(0, 3400)
    loop = loop_of(replace(curve, signal=curve.signal[part], flow=curve.flow[part], time=None))
    assert any("does not close" in note for note in loop.findings)


@pytest.mark.parametrize("rows, margin", [(24, 5.0), (40, 3.0), (100, 1.0)])
def test_few_points(rows: int, margin: float) -> None:
    found = identify(made((0.2, 0.1), width=0.1, rows=rows))
    assert found.positive is not None and found.positive.dead_zone == pytest.approx(0.2, abs=0.06)
    assert found.hysteresis_percent == pytest.approx(10.0, abs=margin)


def test_steps_of_a_display_are_noticed() -> None:
    curve = made((0.0, 0.0), width=0.05)
    coarse = replace(curve, flow=np.round(curve.flow / FULL, 1) * FULL)
    assert resolution(coarse.flow) == pytest.approx(0.1 * FULL)
    assert resolution(np.random.default_rng(0).standard_normal(1000)) == 0.0
    found = identify(coarse)
    assert any("recorded in steps" in note for note in found.findings)
    assert found.positive is not None and found.positive.gain == pytest.approx(FULL, rel=0.05)
    assert found.positive.dead_zone_uncertainty > 0.04


# --- lag or hysteresis ----------------------------------------------------------------------------------------------------
def at_three_rates(model: PlantModel, signal: str = "current") -> list[Curve]:
    return [record(model, 0, seconds=seconds, signal=signal) for seconds in (5.0, 20.0, 80.0)]


def test_loop_that_does_not_care_about_the_rate() -> None:
    check = check_rates(at_three_rates(PAPER.with_values({"magnetic_hysteresis.amplitude": 0.3})))
    assert check.verdict == "hysteresis", check
    assert check.hysteresis_percent is not None
    low, high = check.hysteresis_percent[1:]
    assert low - 0.1 < 100.0 * 2.0 * 0.5 / (20.0 * 0.73) < high + 0.1


def test_loop_that_is_lag() -> None:
    late = SMOOTH.with_values({"command_delay.delay": 0.03})
    check = check_rates(at_three_rates(late, "command"))
    assert check.verdict == "lag", check
    # The dead time, L/R, and what the spool takes.
    assert check.lag_s is not None and check.lag_s[0] == pytest.approx(0.031, abs=0.0015)
    assert check.bound_percent is not None and check.bound_percent < 0.5
    assert check.exponent == pytest.approx(1.0, abs=0.1)


def test_loop_that_is_both() -> None:
    both = PAPER.with_values({"command_delay.delay": 0.03, "magnetic_hysteresis.amplitude": 0.1})
    check = check_rates(at_three_rates(both, "command"))
    assert check.verdict == "both", check
    assert check.hysteresis_percent is not None and check.lag_s is not None
    assert check.hysteresis_percent[0] == pytest.approx(100.0 * 2.0 * 0.3 / (20.0 * 0.73), abs=0.2)
    assert check.lag_s[0] == pytest.approx(0.031, abs=0.0015)


@settings(max_examples=20, deadline=None)
@given(width=st.floats(0.02, 0.1), lag=st.sampled_from([0.0, 0.05, 0.2]), noise=st.sampled_from([0.0, 0.005]))
def test_the_parts_of_a_loop_are_told_apart(width: float, lag: float, noise: float) -> None:
    sweeps = [made(width=width, lag=lag, noise=noise, seconds=seconds) for seconds in (10.0, 40.0, 160.0)]
    check = check_rates(sweeps)
    assert check.hysteresis_percent is not None and check.lag_s is not None
    assert check.hysteresis_percent[0] == pytest.approx(100.0 * width, abs=0.4)
    assert check.lag_s[0] == pytest.approx(lag, abs=0.01)
    assert check.verdict == ("hysteresis" if 4.0 * 2.0 * lag / 10.0 < 0.2 * width else check.verdict)
    assert check.verdict in ("hysteresis", "both", "lag") and (lag > 0.0 or check.verdict == "hysteresis")


def test_no_loop() -> None:
    check = check_rates([made(seconds=seconds) for seconds in (5.0, 50.0)])
    assert check.verdict == "no loop"


def test_one_rate_cannot_tell() -> None:
    check = check_rates([made(width=0.1)])
    assert check.verdict == "undecided" and "one sweep rate" in check.reason
    unknown = check_rates([replace(made(width=0.1), time=None)] * 2)
    assert unknown.verdict == "undecided" and "unknown" in unknown.reason


def test_several_rates_in_one_recording() -> None:
    parts = [made(width=0.05, lag=0.2, seconds=seconds) for seconds in (10.0, 100.0)]
    assert parts[0].time is not None and parts[1].time is not None
    whole = replace(
        parts[0],
        signal=np.concatenate([part.signal for part in parts]),
        flow=np.concatenate([part.flow for part in parts]),
        time=np.concatenate([parts[0].time, parts[1].time - parts[1].time[0] + parts[0].time[-1]]),
    )
    check = check_rates([whole])
    assert len(check.sweeps) == 2 and check.verdict == "both"
    assert check.lag_s is not None and check.lag_s[0] == pytest.approx(0.2, rel=0.1)


# --- pairs -----------------------------------------------------------------------------------------------------------------
def test_the_most_alike_pair() -> None:
    curves = [made((0.3, 0.3), width=0.1, name="a"), made((0.1, 0.1), name="b"), made((0.11, 0.1), name="c")]
    pairs = most_alike(curves)
    assert pairs[0][1:] == (1, 2)
    assert distance(curves[0], curves[0]) == 0.0
    assert distance(curves[0], curves[1]) == pytest.approx(distance(curves[1], curves[0]))


def test_a_pair_takes_valves_and_leaves_the_motor() -> None:
    rig = load_model("paper_dead_zone")
    other = load_model("servo").with_values({"J": 0.01, "supply_droop.relative_drop": 0.3})
    made_pair = pair_model(Valve("a", other, 0), Valve("b", rig, 0), rig)
    assert made_pair.pair("J") == (rig.value("J", 0),) * 2
    assert made_pair.pair("Kq") == (other.value("Kq", 0), rig.value("Kq", 0))
    assert made_pair.pair("dead_zone.overlap_positive") == (0.0, rig.value("dead_zone.overlap_positive", 0))
    assert made_pair.pair("supply_droop.relative_drop") == (0.0, 0.0)


# --- files -----------------------------------------------------------------------------------------------------------------
def rows_of(curve: Curve) -> list[list[str]]:
    assert curve.time is not None
    header = ["time_s", "current (mA)", "flow (l/min)"]
    return [header] + [
        [f"{t:.4f}", f"{1e3 * x:.3f}", f"{q / LPM:.5f}"]
        for t, x, q in zip(curve.time, curve.signal, curve.flow, strict=True)
    ]


def write(path: Path, rows: list[list[str]], between: str = ",") -> Path:
    text = "".join(between.join(row) + "\n" for row in rows)
    path.write_bytes(gzip.compress(text.encode()) if path.suffix == ".gz" else text.encode())
    return path


COLUMNS = Columns(signal="current (mA)", flow="flow (l/min)", time="time_s")


@pytest.mark.parametrize(
    "name, between", [("a.csv", ","), ("a.txt", "\t"), ("a.csv.gz", ";"), ("a.txt.gz", "  ")]
)
def test_formats(tmp_path: Path, name: str, between: str) -> None:
    curve = made((0.2, 0.1), width=0.1, rows=2000)
    columns = replace(COLUMNS, signal="2", flow="3", time="1", rated=1000.0)
    back = read_curve(write(tmp_path / name, rows_of(curve), between), columns)
    np.testing.assert_allclose(back.signal, curve.signal, atol=1e-6)
    np.testing.assert_allclose(back.flow, curve.flow, atol=1e-5 * LPM)
    assert back.rated == 1.0 and back.signal_unit == "A" and back.name == "a"


def test_no_header_and_other_units(tmp_path: Path) -> None:
    curve = made((0.2, 0.1), width=0.1, rows=2000)
    rows = [
        [f"{100.0 * x:.3f}", f"{q / 6.30902e-5:.6f}"] for x, q in zip(curve.signal, curve.flow, strict=True)
    ]
    back = read_curve(write(tmp_path / "a.txt", rows, " "), Columns(signal_unit="%", flow_unit="gpm"))
    np.testing.assert_allclose(back.signal, curve.signal, atol=1e-5)
    np.testing.assert_allclose(back.flow, curve.flow, rtol=1e-4, atol=1e-9)
    assert len(back.signal) == len(curve.signal)


def test_suffixes_need_a_unit(tmp_path: Path) -> None:
    curve = made(rows=400)
    rows = [["Current (mA)", "Flow (GPM)"]]
    rows += [
        [f"{1e3 * x:.1f}m", f"{q / 6.30902e-5:.5f}"] for x, q in zip(curve.signal, curve.flow, strict=True)
    ]
    path = write(tmp_path / "a.txt", rows, "\t")
    with pytest.raises(InputError, match="once or twice"):
        read_curve(path)
    assert read_curve(path, Columns(signal_unit="A")).rated == pytest.approx(1.0)


def test_holes_are_left_out_and_said(tmp_path: Path) -> None:
    rows = rows_of(made(width=0.1, rows=2000))
    rows[17][2] = ""
    rows[30][1] = "nan"
    curve = read_curve(write(tmp_path / "a.csv", rows), COLUMNS)
    assert len(curve.signal) == len(rows) - 3
    assert any("2 rows without a number left out, the first is row 18" in note for note in curve.findings)


def test_time_by_the_length_of_the_sweep(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", rows_of(made(width=0.1, rows=2000)))
    for columns in (
        replace(COLUMNS, time=None, sweep_period=20.0),
        replace(COLUMNS, time=None, row_period=0.01),
    ):
        time = read_curve(path, columns).time
        assert time is not None and time[-1] == pytest.approx(20.0, rel=0.01)


Change = Callable[[list[list[str]]], object]


def shuffle_time(rows: list[list[str]]) -> None:
    rows[40][0] = "1.0"


BAD: dict[str, tuple[Change, Columns, list[str]]] = {
    "no such column": (lambda rows: None, replace(COLUMNS, flow="flw"), ["flw", "flow (l/min)"]),
    "number of a column that is not there": (lambda rows: None, replace(COLUMNS, flow="9"), ["'9'"]),
    "same column twice": (lambda rows: None, replace(COLUMNS, flow="2"), ["different columns"]),
    "time as flow": (lambda rows: None, Columns(signal="2", flow="1", flow_unit="lpm"), ["does not follow"]),
    "time goes back": (shuffle_time, COLUMNS, ["row 41", "time_s", "goes back"]),
    "unknown unit": (lambda rows: None, replace(COLUMNS, flow_unit="lpn"), ["lpn", "l/min"]),
    "unit of something else": (lambda rows: None, replace(COLUMNS, flow_unit="bar"), ["pressure", "flow"]),
    "no unit": (lambda rows: rows[0].__setitem__(1, "x"), replace(COLUMNS, signal="x"), ["--signal-unit"]),
    "text for a number": (
        lambda rows: rows[9].__setitem__(2, "open"),
        COLUMNS,
        ["row 10", "flow (l/min)", "open"],
    ),
    "mostly holes": (lambda rows: [row.__setitem__(2, "") for row in rows[30:]], COLUMNS, ["lack a number"]),
    "flow stands still": (
        lambda rows: [row.__setitem__(2, "1.0") for row in rows[1:]],
        COLUMNS,
        ["all the time"],
    ),
    "signal stands still": (lambda rows: [row.__setitem__(1, "1.0") for row in rows[1:]], COLUMNS, ["range"]),
    "three rows": (lambda rows: rows.__delitem__(slice(4, None)), COLUMNS, ["3 samples"]),
    "header only": (lambda rows: rows.__delitem__(slice(1, None)), COLUMNS, ["no rows"]),
    "negative rated signal": (lambda rows: None, replace(COLUMNS, rated=-3.0), ["must be positive"]),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files(tmp_path: Path, name: str) -> None:
    change, columns, words = BAD[name]
    rows = rows_of(made(width=0.1, rows=400))
    change(rows)
    path = write(tmp_path / "valve.csv", rows)
    with pytest.raises(InputError) as error:
        identify(read_curve(path, columns))
    line = str(error.value)
    assert "\n" not in line and ("valve" in line or "--" in line)
    for word in words:
        assert word in line


@settings(max_examples=30, deadline=None)
@given(data=st.lists(st.tuples(st.floats(-1, 1), st.floats(-1e-3, 1e-3)), max_size=60))
def test_any_samples_give_figures_or_one_line(data: list[tuple[float, float]]) -> None:
    points = np.array(data).reshape(-1, 2)
    try:
        found = identify(Curve("any", points[:, 0], points[:, 1], "A", 1.0))
    except InputError as problem:
        assert "\n" not in str(problem)
    else:
        json.dumps(found.as_json(), allow_nan=False)


# --- the command -----------------------------------------------------------------------------------------------------------
def command(*arguments: object) -> int:
    with pytest.raises(SystemExit) as end:
        cli.main(["valve-test", *(str(argument) for argument in arguments)])
    return int(end.value.code or 0)


def test_models_on_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    status = command("paper_dead_zone", "servo:1", "--out", out, "--seconds", "2,20",
                     "--controllers", "pid_tuned", "--seeds", 1)  # fmt: skip
    assert status == 0
    data = json.loads((out / "valve_test.json").read_text())
    assert data["schema"] == "hydro_env/valve_test/1"
    assert [valve["name"] for valve in data["valves"]] == [
        "paper_dead_zone:1",
        "paper_dead_zone:2",
        "servo:1",
    ]
    for valve in data["valves"]:
        assert valve["rate_check"]["verdict"] in ("hysteresis", "lag", "both")
        for side in ("positive", "negative"):
            assert valve[side]["maximum_flow_lpm"] > 10.0
    assert data["valves"][0]["positive"]["dead_zone_travel_m"] == pytest.approx(68.4e-6, abs=2e-6)
    assert len(data["pairs"]) == 3 and data["most_alike"] == data["pairs"][0]["valves"]
    synchronisation = data["synchronisation"]
    assert len(synchronisation["pairs"]) == 3 and len(synchronisation["twins"]) == 3
    (gain,) = synchronisation["most_alike"]
    own = next(row for row in synchronisation["pairs"] if row["valves"] == data["most_alike"])
    others = [row["max_speed_difference_rpm"] for row in synchronisation["pairs"] if row is not own]
    assert gain["rpm_less_than_best_other"] == pytest.approx(min(others) - own["max_speed_difference_rpm"])
    for picture in ("valve_test.png", "valve_rates.png"):
        assert (out / picture).stat().st_size > 10_000
    said = capsys.readouterr().out
    assert "most similar" in said and "l/min per A" in said and "-0.00" not in said
    page = (out / "valve_test.html").read_text()
    assert page.count("<svg") == 2 and not re.search(r"(src|href)=[\"']?(https?:)?//", page)
    # A simulated valve scatters by next to nothing, which is not printed as 1e-12; and a null of zero has no sign.
    assert data["valves"][2]["positive"]["dead_zone_uncertainty"] < 1e-4
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", page)
    assert "&lt; 0.01" in cells and not [cell for cell in cells if re.search(r"\de-|-0\.00$", cell)]
    heads = set(re.findall(r'<th class="wrap">([^<]*)</th>', page))
    units = ["%", "deg", "rpm", "l/min"]
    assert all(sum(unit in head for unit in units) <= 1 for head in heads)
    assert {
        "dead zone, %",
        "gain, l/min per A",
        "maximum flow, l/min",
        "peak synchronisation error, rpm",
    } <= heads


def test_gains_of_valves_with_different_signals_have_one_unit() -> None:
    current = {"rated_signal": {"value": 0.5, "unit": "A"}}
    voltage = {"rated_signal": {"value": 10.0, "unit": "V"}}
    unit, gain = gain_of([current, current])
    assert unit == "l/min per A" and gain(current, {"gain_lpm_per_unit": 30.0}) == 30.0
    unit, gain = gain_of([current, voltage])
    assert unit == "l/min per %"
    # 15 l/min at the rated signal of both.
    assert gain(current, {"gain_lpm_per_unit": 30.0}) == gain(voltage, {"gain_lpm_per_unit": 1.5}) == 0.15


def test_a_hostile_name_stays_text_in_the_page(tmp_path: Path) -> None:
    name = "<img src=x onerror=alert(1)>{{ 7*7 }}"
    path = tmp_path / f"{name.replace('/', '')}.csv"
    write(path, rows_of(made(width=0.05, seconds=100.0, rows=2000)))
    assert (
        command(path, "--flow-column", "3", "--signal-column", "current (mA)", "--out", tmp_path / "out") == 0
    )
    page = (tmp_path / "out" / "valve_test.html").read_text()
    assert "<img" not in page and "&lt;img src=x" in page and "{{ 7*7 }}" in page


def test_measured_curve_on_the_command_line(tmp_path: Path) -> None:
    for number, seconds in enumerate((10.0, 100.0)):
        curve = made(width=0.05, lag=0.2, seconds=seconds, rows=2000)
        write(tmp_path / f"sweep_{number}.csv", rows_of(curve))
    options = ["--signal-column", "current (mA)", "--flow-column", "3", "--time-column", "1", "--no-pictures"]
    files = [tmp_path / "sweep_0.csv", tmp_path / "sweep_1.csv"]
    assert command(*files, *options, "--one-valve", "--out", tmp_path / "out") == 0
    data = json.loads((tmp_path / "out" / "valve_test.json").read_text())
    (valve,) = data["valves"]
    assert valve["name"] == "sweep" and valve["rate_check"]["verdict"] == "both"
    assert data["synchronisation"] is None and data["most_alike"] is None
    assert command(*files, *options, "--out", tmp_path / "apart") == 0
    assert len(json.loads((tmp_path / "apart" / "valve_test.json").read_text())["pairs"]) == 1
    mixed = [files[1], "paper", *options, "--seconds", "5", "--controllers", "pid_tuned", "--seeds", 1]
    assert command(*mixed, "--out", tmp_path / "mixed") == 0
    data = json.loads((tmp_path / "mixed" / "valve_test.json").read_text())
    assert len(data["pairs"]) == 3 and "measured curves drive no pair" in data["findings"][0]
    assert data["synchronisation"]["most_alike"][0]["valves"] == ["paper:1", "paper:2"]


@pytest.mark.parametrize(
    "arguments, words",
    [
        (["papre"], ["papre", "paper"]),
        (["paper:3"], ["channels 1 and 2"]),
        (["nothing.csv"], ["nothing.csv", "no such file"]),
        (["nothing.yaml"], ["nothing.yaml"]),
        (["paper", "--controllers", "pdi_paper"], ["pdi_paper"]),
        (["paper", "--signal", "pressure"], ["pressure", "current or command"]),
        (["paper", "--seconds", "5,x"], ["--seconds"]),
        (["paper", "--seconds", "0.01"], ["from 0.5 to 3600 s"]),
        (["paper", "--sweep-period", "5,20"], ["--sweep-period"]),
    ],
)
def test_bad_arguments(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], words: list[str]
) -> None:
    assert command(*arguments, "--out", tmp_path / "out") == 2
    lines = [line for line in capsys.readouterr().err.replace("\r", "\n").splitlines() if line.strip()]
    assert lines[-1].startswith("error: ")
    for word in words:
        assert word in lines[-1]
    assert not (tmp_path / "out").exists()


def test_what_a_curve_lacks_is_said_of_its_file(tmp_path: Path) -> None:
    rows = rows_of(made(rows=400))
    for row in rows[1:]:
        row[2] = "1.0"
    path = write(tmp_path / "still.csv", rows)
    with pytest.raises(InputError, match=r"still\.csv: the flow is 1 l/min all the time"):
        bench([str(path)], Sweeps(columns=COLUMNS), progress=False)


def test_valves_of_one_name_are_told_apart() -> None:
    tested = bench(["paper:1", "paper:1"], Sweeps(seconds=(2.0,)), progress=False)
    assert [each.figures.curve.name for each in tested] == ["paper:1 (1)", "paper:1 (2)"]


# --- measured on a real machine -----------------------------------------------------------------------------------------
real = pytest.mark.skipif(
    "HYDRO_ENV_REALDATA" not in os.environ, reason="HYDRO_ENV_REALDATA names no folder of measured logs"
)
REAL = Columns(signal_unit="A", flow_unit="GPM", rated=0.025)


@real
def test_a_real_servo_valve() -> None:
    folder = Path(os.environ["HYDRO_ENV_REALDATA"]) / "servovalve"
    found = identify(read_curve(folder / "flow_gain.txt.gz", replace(REAL, row_period=0.01)))
    assert found.positive is not None and found.negative is not None
    assert found.positive.maximum_flow / LPM == pytest.approx(9.46, abs=0.05)
    assert found.gain_asymmetry_percent is not None and found.gain_asymmetry_percent < 2.0
    assert abs(found.positive.dead_zone) < 0.05 * 0.025
    assert found.hysteresis_percent is not None and 1.0 < found.hysteresis_percent < 4.0


@real
def test_a_real_loop_is_lag() -> None:
    folder = Path(os.environ["HYDRO_ENV_REALDATA"]) / "servovalve"
    sweeps = [
        read_curve(folder / f"leakage_period_{period}.txt.gz", replace(REAL, sweep_period=float(period)))
        for period in (20, 100, 500)
    ]
    check = check_rates(sweeps)
    assert check.verdict == "lag"
    assert check.bound_percent is not None and check.bound_percent < 2.0
    assert check_rates(sweeps[:1]).verdict == "undecided"


def test_a_batch_of_rigs_on_the_bench():
    """Every valve as `record` has it alone, within what a sweep of 8 s instead of 20 s costs; a rig's supply is its own."""
    model = load_model("paper_dead_zone")
    plant = Plant(model, 3, effects=["null_offset"])
    plant.set("null_offset.offset", [[0.0, 0.0], [2e-5, 0.0], [0.0, -2e-5]])
    rigs = record_rigs(plant)
    assert len(rigs) == 3
    for channel in (0, 1):
        alone = identify(record(model, channel, signal="command"))
        here = identify(rigs[0][channel])
        for side in ("positive", "negative"):
            one, other = getattr(alone, side), getattr(here, side)
            assert abs(one.dead_zone - other.dead_zone) < 0.005 * here.curve.rated
            assert other.gain == pytest.approx(one.gain, rel=0.01)
    null = [identify(pair[0]).null for pair in rigs[:2]]
    travel = model.value("alpha", 0) / model.value("k", 0) / model.value("R", 0)
    assert (null[0] - null[1]) * travel == pytest.approx(2e-5, rel=0.1)
    coupled = Plant(model, 1, effects=["supply_droop"])
    assert len(record_rigs(coupled, seconds=2.0)) == 1

"""Practice logs: what is hidden is what the truth says, a seed gives the same logs, bad input is refused in a line."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hydro_env.errors import InputError
from hydro_env.plant import CATALOGUE, load_model, simulate
from hydro_env.plant.sensors import NOISE
from hydro_env.practice.generate import make_practice, run
from hydro_env.practice.hidden import SEVERITIES, parse_effects, parse_values
from hydro_env.practice.manoeuvres import RUNS, plans
from hydro_env.practice.reference.forms import CONSTANTS, STOPS, draw
from hydro_env.units import RPM

HEADER = (
    "time_s,setpoint_rpm,command_1_V,current_1_A,pressure_1_bar,speed_1_rpm,load_1_Nm,"
    "command_2_V,current_2_A,pressure_2_bar,speed_2_rpm,load_2_Nm"
)


def _quick(effects=(), **options):
    return make_practice(effects, **{"duration": 3.0, "runs": ("fit_1",), **options})


def _equal(a, b):
    return a.logs.keys() == b.logs.keys() and all(
        np.array_equal(a.logs[n][c], b.logs[n][c]) for n in a.logs for c in a.logs[n]
    )


def test_files_and_truth(tmp_path):
    practice = run(["dead_zone:1", "supply_droop"], tmp_path, duration=3.0, seed=5, base_error_percent=10)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "fit_1.csv",
        "fit_2.csv",
        "model.yaml",
        "sealed.csv",
        "truth.json",
    ]
    for name in ("fit_1", "fit_2", "sealed"):
        text = (tmp_path / f"{name}.csv").read_text()
        assert text.splitlines()[0] == HEADER
        table = np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1)
        assert table.shape == (3000, 12)
        np.testing.assert_allclose(table, np.column_stack(list(practice.logs[name].values())), atol=1e-6)
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["verdict"] == "effects"
    assert [(e["name"], e["channel"]) for e in truth["effects"]] == [
        ("dead_zone", "1"),
        ("supply_droop", "rig"),
    ]
    assert truth["logs"] == {"fit": ["fit_1.csv", "fit_2.csv"], "sealed": ["sealed.csv"]}
    for entry in truth["effects"]:
        for own, number in entry["parameters"].items():
            assert practice.true.value(f"{entry['name']}.{own}", 0) == number["value"]
    assert practice.true.value("dead_zone.overlap_positive", 1) == 0.0
    for name, entry in truth["base_parameters"].items():
        symbol, channel = name.rsplit("_", 1)
        assert practice.true.value(symbol, int(channel) - 1) == entry["value"]
        assert abs(entry["value"] / entry["nominal"] - 1.0) <= 0.1 + 1e-9 or symbol == "Fs"
    # What an engineer is given knows nothing of what is hidden.
    assert load_model(tmp_path / "model.yaml") == load_model("paper") == practice.given


def test_seed_decides_everything():
    assert _equal(_quick(["dead_zone:1"], seed=4), _quick(["dead_zone:1"], seed=4))
    assert not _equal(_quick(["dead_zone:1"], seed=4), _quick(["dead_zone:1"], seed=5))


def test_nothing_hidden_is_explained_by_the_model():
    """With the fitting kernel on the given model, only the noise is left."""
    practice = make_practice(duration=3.0, seed=1, runs=("fit_1", "fit_2", "sealed"))
    assert practice.truth["verdict"] == "none"
    assert practice.truth["effects"] == [] and practice.truth["base_parameters"] == {}
    for log in practice.logs.values():
        command = np.column_stack([log["command_1_V"], log["command_2_V"]])
        load = np.column_stack([log["load_1_Nm"], log["load_2_Nm"]])
        simulated = simulate("paper", command, load, 1e-3, record=("speed", "current"))
        for c in (0, 1):
            left = log[f"speed_{c + 1}_rpm"] - simulated["speed"][:, 0, c] / RPM
            assert np.std(left) == pytest.approx(NOISE["speed_rpm"], rel=0.1)
            left = log[f"current_{c + 1}_A"] - simulated["current"][:, 0, c]
            assert np.std(left) == pytest.approx(NOISE["current_A"], rel=0.1)


def test_base_error_alone_is_calibration():
    practice = _quick(base_error=0.2, seed=2)
    assert practice.truth["verdict"] == "calibration"
    factors = [e["value"] / e["nominal"] for e in practice.truth["base_parameters"].values()]
    assert max(factors) <= 1.2 + 1e-9 and min(factors) >= 0.8 - 1e-9 and np.std(factors) > 0.05


def test_noise_has_its_size_and_quantisation():
    noisy, clean = _quick(seed=3), _quick(seed=3, noise=0.0)
    for name, key, resolution in (
        ("speed_1_rpm", "speed_rpm", 0.1), ("current_1_A", "current_A", 0.0005), ("pressure_1_bar", "pressure_bar", 0.01),
    ):  # fmt: skip
        error = noisy.logs["fit_1"][name] - clean.logs["fit_1"][name]
        assert np.std(error) == pytest.approx(NOISE[key], rel=0.1)
        steps = noisy.logs["fit_1"][name] / resolution
        np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_recorded_signals_change_no_other():
    few, more = _quick(seed=6, record=("load",)), _quick(seed=6, record=("load", "spool", "flow", "pressure"))
    assert list(few.logs["fit_1"]) == [
        "time_s", "command_1_V", "speed_1_rpm", "load_1_Nm", "command_2_V", "speed_2_rpm", "load_2_Nm",
    ]  # fmt: skip
    assert {"spool_1_mm", "flow_2_lpm", "pressure_1_bar"} <= set(more.logs["fit_1"])
    for name, column in few.logs["fit_1"].items():
        np.testing.assert_array_equal(column, more.logs["fit_1"][name])


def test_pressures_of_both_lines():
    """Their difference is the load pressure, their mean half the supply; a leak drains them."""
    record = ("pressure", "line_pressures")
    log = _quick(["external_leakage:2"], seed=6, record=record, noise=0.0).logs["fit_1"]
    for channel in (1, 2):
        a, b = log[f"pressure_a_{channel}_bar"], log[f"pressure_b_{channel}_bar"]
        inside = (a > 0.0) & (b > 0.0)
        np.testing.assert_allclose((a - b)[inside], log[f"pressure_{channel}_bar"][inside], atol=1e-6)
        mean = 0.5 * (a + b)[inside]
        # There is no number where the lines would be below vacuum.
        assert min(np.nanmin(a), np.nanmin(b)) >= -1.01325
        assert np.ptp(mean) > 5.0 if channel == 2 else np.ptp(mean) < 1e-6


def test_load_that_nobody_logs_is_not_applied():
    practice = _quick(seed=7, record=("current",), noise=0.0, duration=9.0)
    again = simulate(
        "paper",
        np.column_stack([practice.logs["fit_1"][f"command_{c}_V"] for c in (1, 2)]),
        None,
        1e-3,
        record=("speed",),
    )
    assert np.abs(practice.logs["fit_1"]["speed_1_rpm"] - again["speed"][:, 0, 0] / RPM).max() < 0.5


@pytest.mark.parametrize("rate", [50.0, 200.0])
def test_rate(rate):
    log = _quick(rate=rate).logs["fit_1"]
    assert log["time_s"].size == round(3.0 * rate)
    np.testing.assert_allclose(np.diff(log["time_s"]), 1.0 / rate)


def _multiple(p, value):
    """How many typical distances a value of a parameter is from the neutral one; of a limit what stands for it."""
    if np.isinf(p.nominal):
        return (p.typical / value) ** 2
    if p.log and p.nominal > 0.0:
        return abs(np.log(value / p.nominal) / np.log(p.typical / p.nominal))
    return abs((value - p.nominal) / (p.typical - p.nominal))


@pytest.mark.parametrize("severity", SEVERITIES)
def test_sizes_fill_the_range_of_a_severity(severity):
    """Drawn sizes lie within the range and the bounds, and in all parts of it."""
    low, high = SEVERITIES[severity]
    below = []
    for name, effect in CATALOGUE.items():
        for seed in range(8):
            hidden = make_practice([name], severity=severity, runs=(), seed=seed).hidden[0]
            for p in effect.parameters:
                value = hidden.parameters[p.name]
                assert p.low <= value <= p.high, (name, p.name, value)
                if p.typical not in (None, p.nominal):
                    multiple = _multiple(p, value)
                    inside = low * (1.0 - 1e-9) <= multiple <= high * (1.0 + 1e-9)
                    assert inside or value in (p.low, p.high), (name, p.name, multiple)
                    below.append(multiple < np.sqrt(low * high))
    assert 0.3 < np.mean(below) < 0.7


@pytest.mark.parametrize("rated", [10.0, 24.0])
def test_sizes_in_volts_are_shares_of_the_rated_command(rated):
    paper = load_model("paper")
    valve = paper.with_values({"u_rated": rated, "R": 100.0 * rated / paper.value("u_rated", 0)})
    for name in ("driver_saturation", "input_hysteresis"):
        ours, theirs = (
            make_practice([name], model=m, runs=(), seed=4).hidden[0].parameters for m in (valve, paper)
        )
        share = rated / paper.value("u_rated", 0)
        assert ours == pytest.approx({n: share * v for n, v in theirs.items()})


def test_signs_and_shapes_are_drawn():
    rigs = [
        make_practice(["load_bias:1", "displacement_ripple:2", "viscosity_drift"], runs=(), seed=s)
        for s in range(12)
    ]
    values = [{f"{h.name}.{n}": v for h in rig.hidden for n, v in h.parameters.items()} for rig in rigs]
    assert {np.sign(v["load_bias.bias"]) for v in values} == {-1.0, 1.0}
    orders = {v["displacement_ripple.order"] for v in values}
    assert len(orders) > 4 and all(float(n).is_integer() for n in orders)
    # A drift of minutes would not be seen in a log of 12 s.
    assert all(3.0 <= v["viscosity_drift.time_constant"] <= 18.0 for v in values)


def test_forms_are_drawn_for_every_rig():
    """All constants of form lie within their ranges, differ from rig to rig and are in the truth."""
    sets = [draw(np.random.default_rng(s)) for s in range(20)]
    for c in CONSTANTS:
        found = [s[c.name] for s in sets]
        assert c.low <= min(found) < max(found) <= c.high, c.name
        assert len(set(found)) == len(sets), c.name
    for s in sets:
        travels, shares = np.array(s["stop_travels"]), np.array(s["stop_shares"])
        assert len(travels) == STOPS and shares.sum() == pytest.approx(1.0)
        # At a turn the force must not fall while the current grows, also in the narrowest loop: slope below 2.
        assert (shares / travels).sum() < 2.0
    practice = _quick(["dead_zone:1"], seed=5)
    assert {n: e["value"] for n, e in practice.truth["form_constants"].items()} == practice.constants
    assert _quick(["dead_zone:1"], forms="catalogue").truth["form_constants"] == {}


def test_manoeuvres_differ_from_seed_to_seed():
    """No two rigs are asked to do the same, and both channels are in closed loop at the same time."""
    for name in RUNS:
        first, second = (list(plans(name, np.random.SeedSequence(s), 0.01, 1200)) for s in (1, 2))
        np.testing.assert_array_equal(first[0].closed, first[1].closed)
        assert np.mean(first[0].value == second[0].value) < 0.3
        for plan in first:
            assert plan.value.size == plan.load.size == 1200
            assert np.abs(plan.value[~plan.closed]).max(initial=0.0) <= 1.0


def test_explicit_values():
    practice = make_practice(["dead_zone:2"], values={"dead_zone.overlap_positive": 7e-5}, runs=())
    assert practice.true.pair("dead_zone.overlap_positive") == (0.0, 7e-5)
    assert practice.true.pair("dead_zone.overlap_negative")[1] > 0.0
    assert parse_values(["a.b=1e-3"]) == {"a.b": 1e-3}
    assert parse_effects(["dead_zone", "sensor_lag:2"]) == {"dead_zone": "both", "sensor_lag": "2"}


@pytest.mark.parametrize(
    ("effects", "options", "message"),
    [
        (["dead_zon"], {}, "did you mean 'dead_zone'"),
        (["dead_zone:3"], {}, "a channel is 1, 2 or both"),
        (["supply_droop:1"], {}, "acts on the whole rig"),
        (["dead_zone:1", "dead_zone:2"], {}, "named twice"),
        (["dead_zone"], {"values": {"dead_zone.overlap": 1e-4}}, "no parameter 'overlap'"),
        (["dead_zone"], {"values": {"sensor_lag.time_constant": 0.01}}, "not among the effects"),
        (["dead_zone"], {"values": {"dead_zone.overlap_positive": 1.0}}, "expected a number from"),
        (
            ["dead_zone"],
            {"values": {"dead_zone.overlap_positive": 0.0, "dead_zone.overlap_negative": 0.0}},
            "nothing is hidden",
        ),
        (["dead_zone"], {"severity": "huge"}, "small, medium, large"),
        (["dead_zone"], {"rate": 333.0}, "multiple of 100 Hz"),
        (["dead_zone"], {"duration": 0.5}, "from 3 to 3600 s"),
        (["dead_zone"], {"seed": -1}, "whole number"),
        (["dead_zone"], {"record": ("colour",)}, "unknown 'colour'"),
        (["dead_zone"], {"model": "papr"}, "unknown plant"),
    ],
)
def test_bad_input(effects, options, message):
    with pytest.raises(InputError, match=message) as caught:
        make_practice(effects, **{"runs": (), **options})
    assert "\n" not in str(caught.value)


def test_bad_commands_leave_nothing_behind(tmp_path):
    with pytest.raises(InputError, match="--none"):
        run([], tmp_path)
    with pytest.raises(InputError, match="--none"):
        run(["dead_zone"], tmp_path, none=True)
    with pytest.raises(InputError, match="NUMBER"):
        run(["dead_zone"], tmp_path, values=["dead_zone.overlap_positive=wide"])
    assert list(tmp_path.iterdir()) == []


def test_the_same_rig_plays_commands_from_a_file(tmp_path):
    table = "time_s,command_1_V,load_1_Nm\n0.0,0,0\n0.5,20.5,0\n1.0,-20.5,0.3\n1.5,0,0\n"
    (tmp_path / "commands.csv").write_text(table)
    how = {"duration": 3.0, "seed": 4, "base_error": 0.1}
    first = make_practice(["dead_zone:1"], runs=("fit_1",), **how)
    played = make_practice(["dead_zone:1"], play=tmp_path / "commands.csv", **how)
    assert list(played.logs) == ["played"] and played.truth["logs"] == {"played": ["played.csv"]}
    for key in ("effects", "base_parameters", "form_constants"):
        assert played.truth[key] == first.truth[key]
    log = played.logs["played"]
    assert (
        len(log["time_s"]) == 2000
    )  # each row is held until the next, the last as long as the one before it
    rows = [0, 499, 500, 999, 1000, 1500]
    np.testing.assert_array_equal(log["command_1_V"][rows], [0, 0, 20.5, 20.5, -20.5, 0])
    np.testing.assert_array_equal(log["load_1_Nm"][[999, 1000, 1500]], [0, 0.3, 0])
    assert not log["command_2_V"].any() and np.abs(log["speed_1_rpm"][800:1000]).mean() > 50.0
    again = make_practice(["dead_zone:1"], play=tmp_path / "commands.csv", **how)
    assert _equal(played, again)
    (tmp_path / "others.csv").write_text(table.replace("20.5", "20.6"))
    others = make_practice(["dead_zone:1"], play=tmp_path / "others.csv", **how).logs["played"]
    assert not np.array_equal(log["speed_1_rpm"][:400], others["speed_1_rpm"][:400])  # noise of its own


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,speed_1_rpm\n0,0\n1,0\n", "columns time_s and command_1_V"),
        ("time_s,command_1_V\n", "only a header, no rows"),
        ("time_s,command_1_V\n0,0\n", "at least two rows"),
        ("time_s,command_1_V\n0,0\n1,x\n", "row 3, column 'command_1_V': 'x' is not a number"),
        ("time_s,command_1_V\n0,0\n1\n", "row 3 has 1 cells, the header has 2"),
        ("time_s,command_1_V\n0,0\n1,\n", "row 3, column 'command_1_V': no number"),
        (
            "time_s,command_1_V\n0,0\n1,74\n",
            "row 3, column 'command_1_V': 74 is beyond the rated command of 73 V",
        ),
        ("time_s,command_1_V\n0,0\n1,0\n1,0\n", "row 4, column 'time_s': does not rise"),
        ("time_s,command_1_V\n0,0\n5000,0\n", "3600 s at most"),
    ],
)
def test_commands_that_cannot_be_played_are_refused(tmp_path, text, words):
    (tmp_path / "commands.csv").write_text(text)
    with pytest.raises(InputError, match=words) as problem:
        run(["dead_zone:1"], tmp_path / "out", play=tmp_path / "commands.csv")
    assert "commands.csv" in str(problem.value) and not (tmp_path / "out").exists()


def test_logs_of_a_large_rig_are_those_of_its_size() -> None:
    """Loads, set-points, noise and what is hidden grow with the rig; ramps keep the lines near the supply's pressure."""
    size = 24.0  # of a motor of 200 cm3 behind a valve of 10 V, at 250 bar
    values = {
        "D": size * 1.348e-6,
        "J": 0.5,
        "Km": 4e-12,
        "V": 2e-3,
        "B": 0.2,
        "Kq": 3.0,
        "u_rated": 10.0,
        "R": 13.7,
    }
    model = load_model("paper").with_values({**values, "pressure_dependent_flow.supply_pressure": 250e5})
    hidden = ["load_bias:1", "input_hysteresis:2"]
    found = make_practice(hidden, model=model, duration=10.0, rate=100.0, seed=4, runs=("fit_2",))
    bias, play = (next(iter(h.parameters.values())) for h in found.hidden)
    assert 10.0 < abs(bias) < 60.0 and 0.1 < play < 1.0
    log = found.logs["fit_2"]
    assert np.abs(log["load_1_Nm"]).max() > 10.0
    assert np.ptp(log["speed_2_rpm"]) > 50.0 and np.ptp(log["pressure_2_bar"]) < 2.5 * 250.0
    wrong = {"load_bias.bias": 400.0}
    with pytest.raises(InputError, match="expected a number from -1"):
        make_practice(["load_bias:1"], model=model, values=wrong)


@pytest.mark.slow
def test_manoeuvres_of_a_motor_that_starts_slowly_last_as_much_longer() -> None:
    """Its ramps reach the full command, and its lines stay between tank and supply."""
    slow = {"J": 0.015, "Km": 4e-12, "pressure_dependent_flow.supply_pressure": 50e5}
    model = load_model("paper").with_values(slow)
    found = make_practice(model=model, rate=50.0, seed=2, runs=("fit_1",))
    log = found.logs["fit_1"]
    lasts = found.truth["duration_s"]
    assert lasts > 60.0 and lasts == pytest.approx(log["time_s"][-1], rel=0.01)
    for c in (1, 2):
        assert np.abs(log[f"command_{c}_V"]).max() > 0.95 * model.value("u_rated", c - 1)
        assert np.abs(log[f"pressure_{c}_bar"]).max() < 50.0
    assert make_practice(runs=("fit_1",), rate=50.0).truth["duration_s"] == 12.0

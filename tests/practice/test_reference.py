"""The reference simulator: balances it must keep, published and measured figures, delays, and its two forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hydro_env.errors import InputError
from hydro_env.plant import BUILT_IN, CATALOGUE, load_model, simulate
from hydro_env.practice.reference import REFERENCE_SIGNALS, ReferenceRig, simulate_reference
from tests.golden import typical

RPM = math.pi / 30


class PaperPID:
    """(12) with the gains of Table III, a filtered derivative (N = 100 1/s) and anti-windup, on the paper's set-points."""

    def __init__(self, period):
        self.gain, self.reset_time, self.rate_time = np.array([[0.016, 0.023], [0.156, 0.150], [0.005, 0.0]])
        self.period, self.smooth = period, math.exp(-100.0 * period)
        self.sum, self.slope, self.last = np.zeros(2), np.zeros(2), np.zeros(2)

    def __call__(self, time, signals):
        error = (-200.0 if 2.0 <= time < 4.0 else 600.0) - signals["measured_speed"] / RPM
        self.slope = self.smooth * self.slope + (1.0 - self.smooth) * (error - self.last) / self.period
        self.last = error
        wanted = self.gain * (error + self.sum / self.reset_time + self.rate_time * self.slope)
        given = np.clip(wanted, -73.0, 73.0)
        self.sum = np.where(
            (wanted != given) & (error * wanted > 0.0), self.sum, self.sum + error * self.period
        )
        return given


def paper_experiment(model, period=0.01, samples=1, **settings):
    """6 s of the reference under `PaperPID`: its signals, "command" and "load", (600 * samples, 2), rows as of the plant."""
    rig, controller = ReferenceRig(model, **settings), PaperPID(period)
    rows, now = [], rig.signals()
    for n in range(600):
        command = controller(n * period, now)
        part = rig.advance(command, np.zeros(2), period, samples)
        held = {"command": np.tile(command, (samples, 1)), "load": np.zeros((samples, 2))}
        rows.append({name: np.vstack([now[name], values[:-1]]) for name, values in part.items()} | held)
        now = {name: values[-1] for name, values in part.items()}
    return {name: np.concatenate([row[name] for row in rows]) for name in rows[0]}


def _steps(rng, rows=60, hold=10, limit=60.0):
    return np.repeat(rng.uniform(-limit, limit, (rows, 2)), hold, axis=0)


@pytest.mark.parametrize(("overlap", "low", "high"), [(0.0, 12.0, 14.5), (70e-6, 176.0, 186.0)])
def test_paper_experiment(overlap, low, high):
    """Tables I-III taken literally give about 13 rpm; 70 um of overlap on V1 alone give the published size."""
    model = load_model("paper").with_values(
        {"dead_zone.overlap_positive": (overlap, 0.0), "dead_zone.overlap_negative": (overlap, 0.0)}
    )
    run = paper_experiment(model, samples=5, tolerance=1e-6)
    difference = np.abs(run["speed"][:, 0] - run["speed"][:, 1]) / RPM
    assert low < difference.max() < high
    assert difference[-1] < 30.0


def test_flow_and_energy_balance():
    """What the valve delivers is stored, leaks or turns the motor; what the motor takes up moves, rubs or lifts."""
    model = load_model("paper")
    rng = np.random.default_rng(1)
    period = 1e-4
    command = _steps(rng, rows=20, hold=100)
    load = np.repeat(rng.uniform(-0.5, 0.5, (10, 2)), 200, axis=0)
    run = simulate_reference(model, command, load, period, tolerance=1e-9)

    def integral(values):
        return np.sum(0.5 * (values[1:] + values[:-1]), axis=0) * period

    def of(name):
        return np.array([model.value(name, 0), model.value(name, 1)])

    pressure, speed = run["pressure"], run["speed"]
    stored = of("V") / of("beta") * pressure[-1]
    used = integral(of("D") * speed + of("Km") * pressure)
    np.testing.assert_allclose(integral(run["flow"]), stored + used, rtol=2e-4, atol=2e-9)

    kinetic = 0.5 * of("J") * speed[-1] ** 2
    hydraulic = integral(of("D") * pressure * speed)
    lost = integral(of("B") * speed**2)
    # The load steps between rows: each row's torque acts until the next.
    lifted = np.sum(load[:-1] * np.diff(run["angle"], axis=0), axis=0)
    np.testing.assert_allclose(hydraulic, kinetic + lost + lifted, rtol=2e-4, atol=1e-4)

    # Coil: (u - R i - alpha v) / L integrates to the current.
    volts = np.sum(command[:-1], axis=0) * period
    flux = integral(of("R") * run["current"]) + of("alpha") * run["spool"][-1] + of("L") * run["current"][-1]
    np.testing.assert_allclose(volts, flux, rtol=1e-4, atol=1e-3)


def test_steady_state_by_hand():
    """At rest of all rates: i = u/R, k x = alpha i within friction, w = Kq x / (D + B Km / D)."""
    model = load_model("paper")
    run = simulate_reference(model, np.full((3000, 2), 30.0), np.zeros((3000, 2)), 1e-3)
    for c in (0, 1):
        p = model.channels[c]
        assert run["current"][-1, c] == pytest.approx(0.3, rel=1e-4)
        assert abs(p["k"] * run["spool"][-1, c] - p["alpha"] * 0.3) < p["Fs"]
        expected = p["Kq"] * run["spool"][-1, c] / (p["D"] + p["B"] * p["Km"] / p["D"])
        assert run["speed"][-1, c] == pytest.approx(expected, rel=1e-3)


def test_solvers_agree():
    command = _steps(np.random.default_rng(2), rows=12, limit=73.0)
    fast = simulate_reference("paper", command, None, 1e-3)
    strict = simulate_reference("paper", command, None, 1e-3, method="Radau", tolerance=1e-8)
    assert np.abs(fast["speed"] - strict["speed"]).max() / RPM < 1e-3


def test_end_stops_hold():
    command = np.repeat(73.0 * np.random.default_rng(3).choice([-1.0, 1.0], (40, 2)), 10, axis=0)
    run = simulate_reference("paper", command, None, 1e-3)
    assert np.abs(run["spool"]).max() < 1.3e-3


def test_pressure_at_the_motor_is_less_by_the_loss_of_the_lines():
    model = load_model("paper").with_values(
        {
            "line_loss.coefficient": 1e14,
            "displacement_ripple.amplitude": 0.1,
            "displacement_ripple.order": 7.0,
        }
    )
    command = _steps(np.random.default_rng(6))
    run = simulate_reference(model, command, None, 1e-3)
    ripple = 1.0 + 0.1 * np.cos(7.0 * run["angle"])
    motor_flow = np.array([p["D"] for p in model.channels]) * ripple * run["speed"]
    lost = run["pressure"] - run["motor_pressure"]
    np.testing.assert_allclose(lost, 1e14 * motor_flow * np.abs(motor_flow), rtol=1e-9, atol=1e-3)
    compiled = simulate(model, command, None, 1e-3, record=["motor_pressure"])["motor_pressure"][:, 0]
    assert np.abs(compiled - run["motor_pressure"]).max() < 1e-3 * np.abs(run["motor_pressure"]).max()


def test_delay_is_a_pure_shift():
    model = load_model("paper")
    command = _steps(np.random.default_rng(4))
    plain = simulate_reference(model, command, None, 1e-3)
    late = simulate_reference(model.with_values({"command_delay.delay": 0.0137}), command, None, 1e-3)
    shifted = simulate_reference(model.with_values({"command_delay.delay": 0.014}), command, None, 1e-3)
    np.testing.assert_allclose(shifted["current"][14:], plain["current"][:-14], atol=1e-6)
    assert np.abs(late["current"] - shifted["current"]).max() > 1e-3


def test_rows_and_chunks_agree():
    """One call for the log equals the rig advanced piece by piece; row 0 is rest."""
    command = _steps(np.random.default_rng(5), rows=20)
    log = simulate_reference("paper", command, None, 1e-3)
    rig = ReferenceRig("paper")
    for n in range(20):
        now = rig.signals()
        for name in REFERENCE_SIGNALS:
            np.testing.assert_allclose(
                log[name][10 * n], now[name], rtol=1e-4, atol=1e-6 + 1e-5 * np.abs(log[name]).max()
            )
        rig.advance(command[10 * n], 0.0, 0.01)
    assert not any(log[name][0].any() for name in REFERENCE_SIGNALS)


def test_supply_couples_the_channels():
    model = load_model("paper").with_values({"supply_droop.relative_drop": 0.6})
    command = np.zeros((400, 2))
    command[:, 0] = 40.0
    alone = simulate_reference(model, command, None, 1e-3)
    command[:, 1] = 60.0
    together = simulate_reference(model, command, None, 1e-3)
    assert together["speed"][-1, 0] < 0.97 * alone["speed"][-1, 0]


def _severe(effect):
    values = typical(effect.name)
    if effect.name in ("coil_heating", "viscosity_drift"):
        values[f"{effect.name}.time_constant"] = 3.0
    return values


def _rich():
    """Steps and slow reversals under load, 0.6 s."""
    rng = np.random.default_rng(6)
    slow = np.repeat(45.0 * np.sin(np.arange(30) * 0.3), 10)
    command = np.concatenate([_steps(rng, rows=30), np.column_stack([slow, -slow])])
    return command, np.repeat(rng.uniform(-0.7, 0.7, (4, 2)), 150, axis=0)


@pytest.fixture(scope="module")
def plain():
    return simulate_reference("paper", *_rich(), 1e-3, tolerance=1e-5)["measured_speed"]


@pytest.mark.parametrize("name", BUILT_IN)
def test_forms_mean_the_same(name, plain):
    """Both forms of an effect act, with the same sign and size."""
    model = load_model("paper").with_values(_severe(CATALOGUE[name]))
    runs = {
        forms: simulate_reference(model, *_rich(), 1e-3, forms=forms, tolerance=1e-5)["measured_speed"]
        for forms in ("same", "different")
    }
    size = np.sqrt(np.mean((runs["same"] - plain) ** 2))
    between = np.sqrt(np.mean((runs["different"] - runs["same"]) ** 2))
    assert size > 0.0
    assert between < 0.6 * size + 0.5 * RPM


@pytest.mark.parametrize("forms", ["same", "different"])
def test_neutral_effects_vanish(forms, plain):
    neutral = {f"{e.name}.{p.name}": p.nominal for e in CATALOGUE.values() for p in e.parameters}
    run = simulate_reference(
        load_model("paper").with_values(neutral), *_rich(), 1e-3, forms=forms, tolerance=1e-5
    )
    assert np.abs(run["measured_speed"] - plain).max() < 0.01 * RPM


def test_bad_input():
    with pytest.raises(InputError, match="unknown plant"):
        simulate_reference("papr", np.zeros((3, 2)), None, 1e-3)
    with pytest.raises(ValueError, match="forms"):
        ReferenceRig("paper", forms="other")
    with pytest.raises(ValueError, match=r"\(T, 2\)"):
        simulate_reference("paper", np.zeros((3, 2)), np.zeros((2, 2)), 1e-3)
    with pytest.raises(ValueError, match="finite"):
        simulate_reference("paper", np.full((3, 2), np.nan), None, 1e-3)

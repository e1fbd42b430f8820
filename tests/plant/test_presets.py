"""The presets do what they stand for: valves after Fig. 2, servo valves, a realistic rig; every value has a source."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from hydro_env.envs import HydraulicSyncVectorEnv
from hydro_env.envs.observation import decode
from hydro_env.errors import InputError
from hydro_env.plant import Plant, PlantModel, load_model, preset_names
from hydro_env.plant.model_files import sources_of
from hydro_env.units import LPM
from hydro_env.valve_bench import distance, identify, record
from hydro_env.valve_bench.curve import Curve

RPM, BAR = math.pi / 30, 1e5
VALVES = ("valve_1", "valve_2", "valve_3")
RATED = 0.73  # A, the end of Fig. 2


@pytest.fixture(scope="module")
def sweeps() -> dict[str, Curve]:
    """A slow sweep of each valve, as on the bench of the paper: flow over coil current, both directions."""
    return {name: record(load_model(name), 0, seconds=20.0) for name in VALVES}


def branches(curve: Curve, current: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rising and falling flow (l/min) at positive currents; the sweep goes down first."""
    half = curve.signal.size // 2
    down, up = slice(0, half), slice(half, None)
    rising = np.interp(current, curve.signal[up], curve.flow[up] / LPM)
    return rising, np.interp(current, curve.signal[down][::-1], curve.flow[down][::-1] / LPM)


def bend(current: np.ndarray, flow: np.ndarray) -> float:
    """Largest distance of a branch from its own straight line, over its largest flow."""
    return float(np.abs(flow - np.polyval(np.polyfit(current, flow, 1), current)).max() / flow.max())


# --- Fig. 2 -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", VALVES)
def test_no_flow_below_300_mA_and_flow_from_about_400(name: str, sweeps: dict[str, Curve]) -> None:
    closed = np.abs(sweeps[name].signal) <= 0.3
    assert np.all(sweeps[name].flow[closed] == 0.0)
    figures = identify(sweeps[name])
    for side in (figures.positive, figures.negative):
        assert side is not None and side.opens_at is not None and side.closes_at is not None
        assert 0.37 < side.opens_at < 0.43
        assert 0.3 < side.closes_at < side.opens_at
        assert side.largest_signal == pytest.approx(RATED, abs=0.005)


@pytest.mark.parametrize("name", VALVES)
def test_the_opening_branch_is_nearly_straight(name: str, sweeps: dict[str, Curve]) -> None:
    current = np.linspace(0.45, RATED - 0.01, 50)
    rising, _ = branches(sweeps[name], current)
    assert bend(current, rising) < 0.01
    assert np.all(np.diff(rising) > 0.0)  # and no flat top


def test_valve_1_has_the_wide_loop_and_a_bent_closing_branch(sweeps: dict[str, Curve]) -> None:
    figures = {name: identify(sweeps[name]) for name in VALVES}
    width = {name: f.hysteresis_percent for name, f in figures.items()}
    assert min(width.values()) > 4.0  # "the valve has a large hysteresis"; a servo valve has some tenths
    assert width["valve_1"] > 2.5 * max(width["valve_2"], width["valve_3"])
    # Every loop is flat just after its turn; beyond 50 mA only V1 is still bent.
    current = np.linspace(0.4, RATED - 0.05, 50)
    bends = {name: bend(current, branches(sweeps[name], current)[1]) for name in VALVES}
    assert bends["valve_1"] > 0.04
    assert bends["valve_1"] > 3.0 * max(bends["valve_2"], bends["valve_3"])
    gains = np.gradient(branches(sweeps["valve_1"], current)[1], current)
    assert gains[-1] < 0.6 * gains[0]


def test_valves_2_and_3_are_alike_and_all_largest_flows_differ(sweeps: dict[str, Curve]) -> None:
    apart = {pair: distance(*(sweeps[name] for name in pair)) for pair in itertools.combinations(VALVES, 2)}
    assert 3.0 * apart["valve_2", "valve_3"] < min(apart["valve_1", "valve_2"], apart["valve_1", "valve_3"])
    largest = sorted(float(sweeps[name].flow.max()) for name in VALVES)
    assert all(b > 1.05 * a for a, b in itertools.pairwise(largest))
    assert sweeps["valve_1"].flow.max() == largest[-1]


@pytest.mark.parametrize("name", VALVES)
def test_the_loop_is_the_valves_and_not_the_sweeps(name: str, sweeps: dict[str, Curve]) -> None:
    """Hysteresis, not lag, which would shrink to a quarter; friction grows a little in a slower sweep (Stribeck)."""
    slow = identify(record(load_model(name), 0, seconds=80.0))
    assert slow.hysteresis_percent == pytest.approx(identify(sweeps[name]).hysteresis_percent, rel=0.05)


# --- servo ------------------------------------------------------------------------------------------------------------
def response(model: PlantModel, frequency: float, share: float) -> complex:
    """Spool travel over the command's, at this frequency (Hz) and this share of the rated command."""
    step, periods = 1e-4, 8
    time = np.arange(int(periods / frequency / step)) * step
    command = share * model.value("u_rated", 0) * np.sin(2 * np.pi * frequency * time)
    spool = Plant(model).run(command[:, None] * np.ones(2), None, step, ("spool",))["spool"][:, 0, 0]
    settled = time >= 0.5 * periods / frequency
    wave = 2j * np.mean(spool[settled] * np.exp(-2j * np.pi * frequency * time[settled]))
    per_volt = model.value("alpha", 0) / (model.value("R", 0) * model.value("k", 0))
    return complex(wave / (share * model.value("u_rated", 0) * per_volt))


def test_servo_valves_have_no_lap_and_hardly_a_loop() -> None:
    for channel in (0, 1):
        curve = record(load_model("servo"), channel, seconds=20.0)
        figures = identify(curve)
        assert figures.hysteresis_percent is not None and figures.hysteresis_percent < 0.3
        for side in (figures.positive, figures.negative):
            assert side is not None
            assert abs(side.dead_zone) < 1e-3 * curve.rated
            assert side.linearity_percent < 0.1
    # Half a per cent of the command moves the motor; the cheap valves stay shut at thirty times as much.
    for name, share, moves in (("servo", 0.005, True), ("valve_2", 0.15, False)):
        plant = Plant(name)
        for _ in range(100):
            plant.step(share * 73.0, 0.0, 0.01)
        assert np.all(plant.speed > 0.5 * RPM) == moves
        assert np.all(plant.flow > 0.0) == moves


def test_the_spool_of_a_servo_valve_follows_at_any_size_of_command() -> None:
    """A closed spool loop: the same bandwidth for small and large commands, no resonance, no phase lost to friction."""
    servo, paper = load_model("servo"), load_model("paper")
    small, large = (response(servo, 50.0, share) for share in (0.05, 0.8))
    assert abs(small / large - 1.0) < 0.03
    assert abs(large) > 0.9 and -60.0 < math.degrees(np.angle(large)) < -40.0
    edge = response(servo, 100.0, 0.5)
    assert 0.5 < abs(edge) < 0.75 and -105.0 < math.degrees(np.angle(edge)) < -85.0
    # The spool on springs alone: friction eats the small command, and the large one meets a resonance.
    assert abs(response(paper, 10.0, 0.02)) < 0.8
    assert abs(response(paper, 50.0, 0.02)) < 0.2 < 1.1 < abs(response(paper, 50.0, 1.0))


def test_matched_servo_valves_drive_both_motors_nearly_alike() -> None:
    plant = Plant("servo")
    for _ in range(300):
        plant.step(30.0, 0.0, 0.01)
    assert plant.speed[0] / plant.speed[0, 0] == pytest.approx([1.0, 0.98], abs=2e-3)


# --- rig --------------------------------------------------------------------------------------------------------------
FULL = 22.8  # V, what 24 V leave


def hold(model: str | PlantModel, command: object, load: object, seconds: float, **values: float) -> Plant:
    """Commands and loads held from rest; loads come after a second, so that the shaft turns."""
    plant = Plant(model)
    plant.set_values(values)
    plant.reset()
    for n in range(round(seconds / 0.01)):
        plant.step(command, np.asarray(load) * (n >= 100), 0.01)  # type: ignore[arg-type]
    return plant


def test_24_V_are_the_end_of_the_driver() -> None:
    """Whatever is asked for, also where the limit of the command is lifted; and the current is Fig. 2's largest."""
    asked = [hold("rig", volts, 0.0, 1.0, u_rated=100.0).current[0] for volts in (FULL, 24.0, 90.0)]
    assert np.array_equal(asked[0], asked[1]) and np.array_equal(asked[0], asked[2])
    assert asked[0] == pytest.approx([RATED, RATED], rel=5e-3)


def test_the_relief_valves_open_and_hold_the_pressure() -> None:
    """Shafts held: without relief the pressure goes nearly to the supply's, with it to the setting and little more."""
    shut = load_model("rig").with_values({"crossport_relief.relief_pressure": math.inf})
    with_relief, without = hold("rig", FULL, 0.0, 2.0, J=1e4), hold(shut, FULL, 0.0, 2.0, J=1e4)
    assert np.all(np.abs(with_relief.speed) < 1.0 * RPM)
    assert np.all((with_relief.pressure > 80.0 * BAR) & (with_relief.pressure < 90.0 * BAR))
    assert np.all(without.pressure > 93.0 * BAR) and np.all(without.pressure < 100.0 * BAR)
    assert np.all(with_relief.flow > 1.8 * without.flow)


def test_both_valves_share_a_supply_that_follows_late() -> None:
    """Motor 1 under load slows when valve 2 opens, at first not, and by nine tenths after a quarter of a second."""
    command = np.zeros((600, 2))
    command[:, 0] = FULL
    command[300:, 1] = FULL
    load = np.tile([6.0, 0.0], (600, 1)) * (np.arange(600) >= 50)[:, None]
    speed = Plant("rig").run(command, load, 0.005, ("speed",))["speed"][:, 0, 0]
    smooth = np.convolve(speed, np.ones(10) / 10, "same")  # the ripple of twelve teeth
    before, after = smooth[250:290].mean(), smooth[550:590].mean()
    assert 0.9 * before < after < 0.985 * before
    lost = (before - smooth) / (before - after)
    assert lost[300] < 0.1 and 0.2 < lost[325] < 0.9 < lost[400]
    stiff = load_model("rig").with_values({"supply_droop.relative_drop": 0.0})
    kept = Plant(stiff).run(command, load, 0.005, ("speed",))["speed"][:, 0, 0]
    assert kept[550:590].mean() == pytest.approx(kept[250:290].mean(), rel=5e-3)


def test_flow_falls_with_the_root_of_what_the_load_leaves() -> None:
    """The orifice law, on the rig without the spool's flow force and the droop, which also ask for the load."""
    rig = load_model("rig").with_values({"supply_droop.relative_drop": 0.0, "flow_force.coefficient": 0.0})
    plants = [hold(rig, [FULL, 0.0], [load, 0.0], 4.0) for load in (0.0, 8.0)]
    pressure = np.array([plant.pressure[0, 0] for plant in plants])
    assert pressure[1] > pressure[0] + 40.0 * BAR
    expected = np.sqrt(1.0 - pressure / (100.0 * BAR))
    overlap = rig.value("dead_zone.overlap_positive", 0)
    spools = np.array([plant.spool[0, 0] for plant in plants])
    found = np.array([plant.flow[0, 0] for plant in plants]) / (spools - overlap)
    assert found[1] / found[0] == pytest.approx(expected[1] / expected[0], rel=1e-6)


def test_leakage_is_that_of_a_good_motor() -> None:
    """Read per minute: some per cent of the flow under load, where the paper's reading per second loses most of it."""
    shares = []
    for model, command, load in (("rig", FULL, 4.0), ("paper", 73.0, 0.8)):
        plant = hold(model, command, load, 4.0)
        shares.append(1.0 - (plant.get("D") * plant.speed / plant.flow)[0, 0])
    assert 0.02 < shares[0] < 0.12 and shares[1] > 0.4


def test_a_line_with_volume_rings_when_the_valve_shuts() -> None:
    """The shaft's inertia on the springs of fluid and air: pressure overshoots into both relief valves and dies out."""
    command = np.where(np.arange(1000) < 400, FULL, 0.0)[:, None] * [1.0, 0.0]
    out = Plant("rig").run(command, None, 0.001, ("pressure", "speed"))
    pressure, speed = out["pressure"][:, 0, 0], out["speed"][:, 0, 0]
    after = pressure[400:]
    assert -95.0 * BAR < after.min() < -80.0 * BAR  # relief on the return side
    assert after[np.argmin(after) :].max() > 20.0 * BAR
    assert np.abs(after[-200:]).max() < 2.0 * BAR and np.abs(speed[-200:]).max() < 1.0 * RPM
    # A period of the ringing between the stiff fluid's and what the air makes of it.
    turns = np.flatnonzero(np.diff(np.sign(speed[400:560])))
    J, D, V, beta = (load_model("rig").value(name, 0) for name in ("J", "D", "V", "beta"))
    stiff = 2.0 * math.pi * math.sqrt(J * V / (D * D * beta))
    assert 0.9 * stiff < 2e-3 * float(np.diff(turns)[:2].mean()) < 1.6 * stiff


def test_end_stops_hold_the_spool() -> None:
    """With the softest springs that such a valve may have the full current pushes it into its stop, and no further."""
    free = hold("rig", FULL, 0.0, 1.0)
    pushed = hold("rig", FULL, 0.0, 1.0, k=12000.0)
    stop, stiffness = free.get("x_max"), free.get("k_stop")
    assert np.all(free.spool < stop)
    wanted = free.get("alpha") * pushed.current / 12000.0  # without stop, friction and flow force
    assert np.all(wanted > 1.15 * stop)
    assert np.all((pushed.spool > stop) & (pushed.spool < stop + 15.0 / stiffness))


def test_sensors_of_the_rig_lag_and_are_noisy() -> None:
    ramp = np.linspace(0.6, 1.0, 200)[:, None] * np.ones(2) * FULL
    out = Plant("rig").run(ramp, None, 0.005, ("speed", "measured_speed"))
    true, shown = out["speed"][:, 0, 0], out["measured_speed"][:, 0, 0]
    time = np.arange(200) * 0.005
    climbing = slice(120, 190)
    assert shown[climbing] == pytest.approx(np.interp(time - 0.005, time, true)[climbing], rel=2e-3)
    env = HydraulicSyncVectorEnv(400, plant="rig", mismatch=None, scenario="setpoint_steps")
    env.reset(seed=0)
    seen = decode(env.step(np.zeros((400, 2), np.float32))[0])
    assert seen.speed.std() / RPM == pytest.approx(1.0, rel=0.1)
    assert seen.current.std() == pytest.approx(2e-3, rel=0.1)
    assert seen.pressure.std() / BAR == pytest.approx(0.05, rel=0.1)


# --- sources ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", preset_names())
def test_every_value_of_a_preset_has_a_source(name: str) -> None:
    model, sources = load_model(name), sources_of(name)
    assert set(sources) == {(value, channel) for value in model.values for channel in (0, 1)}
    assert all(text.strip() and text[-1] != "." for text in sources.values())


def test_sources_follow_base_and_valve_and_are_checked(tmp_path) -> None:  # type: ignore[no-untyped-def]
    rig, valve = sources_of("rig"), sources_of("valve_2")
    assert rig["Kq", 1] == valve["Kq", 0] and rig["Kq", 0] == sources_of("valve_1")["Kq", 0] != rig["Kq", 1]
    path = tmp_path / "mine.yaml"
    head = "schema: hydro_env/model/1\nbase: rig\nboth: {R: 30.0}\n"
    path.write_text(head + "sources: {R: measured}\n")
    mine = sources_of(path)
    assert mine["R", 0] == "measured" and mine["V", 0] == rig["V", 0]
    assert load_model(path).value("R", 1) == 30.0
    path.write_text(head)
    assert "mine.yaml" in sources_of(path)["R", 0]  # given there, without a word where it is from
    for wrong, said in (
        ("{Rr: measured}", "did you mean 'R'"),
        ("{R: 3}", "sources.R is 3, should be text"),
        ("[R]", "name: value"),
    ):
        path.write_text(head + f"sources: {wrong}\n")
        with pytest.raises(InputError, match=said):
            load_model(path)

"""What defines each effect, seen from outside: how signals answer, not how the law is written.

Loss models of the motor have a file of their own, test_losses.py, and every effect is also in the balances of
test_balances.py, in the golden trajectories and, at its strongest, in test_plant_accuracy.py.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from hydro_env.plant import BUILT_IN, CATALOGUE, Plant
from hydro_env.plant.catalogue.losses import FAMILY

PERIOD = 0.01
K, ALPHA, R = 17000.0, 20.0, 100.0  # spring, force per current, resistance of the paper's valves

Array = NDArray[np.float64]
_TESTED: set[str] = set()


def defines(*names: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Says which effects a test defines."""

    def mark(test: Callable[..., None]) -> Callable[..., None]:
        _TESTED.update(names)
        return test

    return mark


def test_every_effect_has_such_a_test() -> None:
    assert {name for name in BUILT_IN if CATALOGUE[name].family != FAMILY} == _TESTED


@pytest.fixture(scope="module")
def everything() -> Plant:
    """Nine rigs with every effect compiled in, all neutral; at a tolerance at which they settle to many digits."""
    return Plant("paper", 9, effects=BUILT_IN, tolerance=1e-8)


@pytest.fixture
def rigs(everything: Plant) -> Callable[..., Plant]:
    """A plant at rest with these values: numbers for all rigs, lists for one after the other; "__" stands for a dot."""
    nominal = everything.memory.copy()

    def make(**values: float | list[float]) -> Plant:
        everything.memory[:] = nominal
        for name, value in values.items():
            each = np.atleast_1d(value)
            column = np.resize(each, everything.num_rigs)[:, None]
            everything.set(name.replace("__", "."), column)
        everything.reset()
        return everything

    return make


@pytest.fixture(autouse=True)
def _clean(everything: Plant):  # type: ignore[no-untyped-def]
    """Leaves the shared plant as it was."""
    before = everything.memory.copy()
    yield
    everything.memory[:] = before
    everything.reset()


def hold(plant: Plant, command: object, load: object = 0.0, seconds: float = 3.0) -> Plant:
    for _ in range(round(seconds / PERIOD)):
        plant.step(command, load, PERIOD)  # type: ignore[arg-type]
    return plant


def column(*values: float) -> Array:
    """Commands or loads (9, 2): these for the first rigs, the last one for all others."""
    return np.tile(np.resize(np.r_[values, [values[-1]] * 9][:9], 9)[:, None], 2)


# --- driver and coil --------------------------------------------------------------------------------------------------
@defines("command_delay")
def test_a_delay_shifts_everything(rigs: Callable[..., Plant]) -> None:
    delay = 0.00537
    commands = np.full((400, 2), 40.0)
    late = rigs(command_delay__delay=delay).run(commands, None, 1e-4, ("speed",))["speed"][:, 0, 0]
    early = rigs().run(commands, None, 1e-4, ("speed",))["speed"][:, 0, 0]
    time = np.arange(400) * 1e-4
    assert np.allclose(np.interp(time - delay, time, early)[60:], late[60:], atol=2e-3 * early.max())


@defines("driver_saturation")
def test_a_driver_clips_the_current_at_its_voltage_and_not_before(rigs: Callable[..., Plant]) -> None:
    plant = hold(rigs(driver_saturation__voltage_limit=45.0), column(40.0, -44.0, 50.0, -73.0), seconds=0.5)
    assert plant.current[:4, 0] * R == pytest.approx([40.0, -44.0, 45.0, -45.0], rel=1e-6)


@defines("coil_heating")
def test_a_hot_coil_loses_current_in_its_own_time(rigs: Callable[..., Plant]) -> None:
    rise, tau, volts = 0.3, 2.0, 60.0
    plant = rigs(coil_heating__rise=rise, coil_heating__time_constant=tau)
    current = plant.run(np.full((1500, 2), volts), None, PERIOD, ("current",))["current"][:, 0, 0]
    assert current[10] == pytest.approx(volts / R, rel=0.02)  # hardly warm
    hot = current[-1]
    assert volts / hot == pytest.approx(
        R * (1.0 + rise * (hot / 0.73) ** 2), rel=1e-3
    )  # rated power warms by `rise`
    heat, expected = 0.0, []
    for _ in range(1500):  # less current, less power: a little faster than `tau`
        expected.append(volts / (R * (1.0 + rise * heat)))
        heat += PERIOD / tau * ((expected[-1] / 0.73) ** 2 - heat)
    assert current[40:] == pytest.approx(expected[40:], rel=1e-3)  # the spool is at rest


# --- force ------------------------------------------------------------------------------------------------------------
@defines("magnetic_hysteresis")
def test_a_magnetic_loop_is_as_wide_at_any_rate(rigs: Callable[..., Plant]) -> None:
    values = {
        "magnetic_hysteresis__amplitude": 1.0,
        "magnetic_hysteresis__width": 0.1,
        "Fc": 0.02,
        "Fs": 0.02,
    }
    widths = []
    for seconds in (4.0, 16.0):
        rows = int(seconds / PERIOD)
        share = np.interp(np.linspace(0, 1, rows), [0, 0.2, 0.6, 1.0], [0, 1, -1, 1])
        out = rigs(**values).run(60 * share[:, None] * np.ones((1, 2)), None, PERIOD, ("current", "spool"))
        current, spool = out["current"][:, 0, 0], out["spool"][:, 0, 0]
        falling, rising = slice(int(0.25 * rows), int(0.55 * rows)), slice(int(0.65 * rows), None)
        down = np.interp(0.0, current[falling][::-1], spool[falling][::-1])
        widths.append((down - np.interp(0.0, current[rising], spool[rising])) * K)
    assert widths[1] == pytest.approx(2.0, rel=0.1)  # twice the amplitude, with a little friction
    assert widths[0] == pytest.approx(widths[1], rel=0.05)


@defines("spool_stiction")
def test_a_sticky_spool_ignores_small_forces_and_then_jumps(rigs: Callable[..., Plant]) -> None:
    """Static friction 0.2 + 0.6 N: 0.6 N of the coil only bend the bristles, 1.2 N tear the spool off."""
    force = np.array([0.6, 1.2])
    for static, moves in (([0.0], [True, True]), ([0.6], [False, True])):
        plant = rigs(spool_stiction__static=static * 9, spool_stiction__coulomb=0.3)
        spool = hold(plant, column(*(force / ALPHA * R)), seconds=1.0).spool[:2, 0]
        assert list(spool > 15e-6) == moves
        assert spool[1] == pytest.approx(force[1] / K, abs=0.9 / K)
    ramp = np.linspace(0.0, 8.0, 2667)[:, None] * np.ones(2)  # 3 V/s
    plant = rigs(spool_stiction__static=[0.6, 0.0], spool_stiction__coulomb=[0.1, 0.0], vs=1e-4)
    travel = np.diff(plant.run(ramp, None, 1e-3, ("spool",))["spool"][:, :2, 0], axis=0)
    assert (
        travel[:, 0].max() > 5e-6 > 2.0 * travel[:, 1].max()
    )  # in a millisecond, in which the springs ask for 0.04 um
    assert np.median(travel[:, 0]) < 0.02e-6


@defines("spool_stop")
def test_a_stop_holds_the_spool_and_not_the_current(rigs: Callable[..., Plant]) -> None:
    travel = 4e-4
    plant = hold(rigs(spool_stop__travel=[travel, travel, np.inf]), column(20.0, 60.0, 60.0), seconds=1.0)
    spool, current = plant.spool[:3, 0], plant.get("current")[:3, 0]
    assert current == pytest.approx(np.array([20.0, 60.0, 60.0]) / R, rel=1e-3)
    free = current * ALPHA / K
    assert spool[[0, 2]] == pytest.approx(free[[0, 2]], rel=0.06) and spool[0] < travel < free[1]
    assert travel < spool[1] < travel + (free[1] - travel) * K / 5e5  # pressed a little into it


@defines("spring_preload")
def test_a_preload_is_a_threshold_of_current_and_none_of_opening(rigs: Callable[..., Plant]) -> None:
    preload = 2.0
    plant = hold(
        rigs(spring_preload__preload=preload, Fc=0.02, Fs=0.02), column(5.0, 9.0, 30.0, -30.0), seconds=1.0
    )
    force = ALPHA * plant.current[:4, 0]
    assert np.all(np.abs(plant.spool[:2, 0]) < 20e-6)  # 1.0 and 1.8 N: below the preload
    assert plant.spool[2:4, 0] * K == pytest.approx((np.abs(force[2:]) - preload) * [1.0, -1.0], abs=0.05)
    assert plant.flow[:4, 0] == pytest.approx(plant.get("Kq")[:4, 0] * plant.spool[:4, 0], rel=1e-12)


@defines("flow_force")
def test_flow_force_closes_the_valve_the_more_the_greater_its_pressure_drop(
    rigs: Callable[..., Plant],
) -> None:
    supply, coefficient = 100e5, 3e-4
    values = {
        "flow_force__coefficient": coefficient,
        "flow_force__supply_pressure": supply,
        "Fc": 0.02,
        "Fs": 0.02,
    }
    plant = hold(rigs(**values), column(50.0, 50.0, 50.0, -50.0), column(0.0, 0.6, -0.6, 0.0), 4.0)
    spool, pressure = plant.spool[:4, 0], plant.pressure[:4, 0]
    drop = supply - np.sign(spool) * pressure
    assert spool * (K + coefficient * drop) == pytest.approx(ALPHA * plant.current[:4, 0], abs=0.06)
    assert (
        spool[2] < spool[0] < spool[1] < ALPHA * 0.5 / K
    )  # a driven motor leaves more of the pressure to the valve


# --- opening ----------------------------------------------------------------------------------------------------------
@defines("null_offset")
def test_an_offset_opens_the_centred_valve_and_shifts_both_directions(rigs: Callable[..., Plant]) -> None:
    offset = 4e-5
    plant = hold(rigs(null_offset__offset=offset, Fc=0.02, Fs=0.02), column(0.0, 30.0, -30.0), seconds=1.0)
    kq, flow = plant.get("Kq")[0, 0], plant.flow[:3, 0]
    assert flow[0] == pytest.approx(kq * offset, rel=1e-9)
    assert flow[1] + flow[2] == pytest.approx(2.0 * kq * offset, rel=1e-3)


@defines("dead_zone")
def test_a_dead_zone_takes_its_own_overlap_each_way(rigs: Callable[..., Plant]) -> None:
    values = {"dead_zone__overlap_positive": 1e-4, "dead_zone__overlap_negative": 2e-4}
    plant = hold(rigs(**values), column(40.0, -40.0, 5.0, -15.0), seconds=1.0)
    opening = (plant.flow / plant.get("Kq"))[:4, 0]
    assert opening[:2] == pytest.approx(plant.spool[:2, 0] - [1e-4, -2e-4], abs=1e-9)
    assert -2e-4 < plant.spool[3, 0] < -1.5e-4 and np.all(opening[2:] == 0.0)  # spools inside the overlaps


@defines("flow_saturation")
def test_a_saturated_valve_gives_no_more(rigs: Callable[..., Plant]) -> None:
    limit = 3e-4
    plant = hold(rigs(flow_saturation__opening_limit=limit), column(20.0, 40.0, 70.0, -70.0), seconds=1.0)
    flow, most = plant.flow[:4, 0], plant.get("Kq")[0, 0] * limit
    assert flow[0] == pytest.approx(plant.get("Kq")[0, 0] * plant.spool[0, 0], rel=1e-12) and flow[0] < most
    assert flow[1:] == pytest.approx([most, most, -most], rel=1e-12)
    assert plant.spool[2, 0] > 1.5 * plant.spool[1, 0] > 1.5 * limit  # the spool does go on


@defines("directional_gain")
def test_directions_of_different_gain(rigs: Callable[..., Plant]) -> None:
    plant = hold(rigs(directional_gain__ratio=0.7), column(35.0, -35.0, 60.0, -60.0), seconds=1.0)
    flow, spool = plant.flow[:4, 0], plant.spool[:4, 0]
    assert spool[1::2] == pytest.approx(-spool[::2], rel=1e-9)
    assert flow[1::2] / flow[::2] == pytest.approx([-0.7, -0.7], rel=1e-9)
    assert flow[::2] == pytest.approx(plant.get("Kq")[0, 0] * spool[::2], rel=1e-12)


@defines("flow_gain_nonlinearity")
def test_a_progressive_edge_gives_little_at_first_and_the_rated_flow_in_the_end(
    rigs: Callable[..., Plant],
) -> None:
    plant = hold(
        rigs(flow_gain_nonlinearity__curvature=0.6), column(4.0, 30.0, 50.0, 73.0, -50.0), seconds=1.0
    )
    gain = (plant.flow / plant.spool)[:5, 0] / plant.get("Kq")[0, 0]
    assert gain[0] == pytest.approx(0.4, abs=0.05) and gain[3] == pytest.approx(1.0, abs=0.02)
    assert np.all(np.diff(gain[:4]) > 0.0) and gain[4] == pytest.approx(gain[2], rel=1e-6)


# --- flow and supply --------------------------------------------------------------------------------------------------
@defines("pressure_dependent_flow")
def test_flow_follows_the_root_of_what_the_load_leaves_of_the_supply(rigs: Callable[..., Plant]) -> None:
    supply = 20e5
    plant = rigs(pressure_dependent_flow__supply_pressure=supply)
    hold(plant, column(50.0, 50.0, 50.0, -50.0), column(0.0, 0.8, -0.8, 0.0), 4.0)
    share = (plant.flow / (plant.get("Kq") * plant.spool))[:4, 0]
    taken = (np.sign(plant.spool) * plant.pressure)[:4, 0] / supply
    assert share**2 == pytest.approx(1.0 - taken, rel=1e-9)
    assert share[1] < share[0] - 0.1 < share[2] - 0.2 and share[3] == pytest.approx(share[0], rel=1e-6)


@defines("supply_droop")
def test_a_weak_supply_couples_the_channels_with_memory(rigs: Callable[..., Plant]) -> None:
    plant = rigs(supply_droop__relative_drop=0.5, supply_droop__time_constant=0.2)
    command = np.zeros((400, 1, 2))
    command[:, :, 0] = 50.0
    command[200:, :, 1] = 60.0
    flow = plant.run(command, None, PERIOD, ("flow",))["flow"][:, 0]
    before, after = flow[199], flow[-1]
    assert after[0] < 0.97 * before[0]
    # Share of the supply that is left: its fall is proportional to the flow of both, 49 l/min taking half of it.
    left = (after / (plant.get("Kq") * plant.spool)[0]) ** 2
    assert left == pytest.approx([1.0 - 0.5 * after.sum() / 8.178e-4] * 2, rel=1e-3)
    gone = (before[0] - flow[200:, 0]) / (before[0] - after[0])
    assert gone[2] < 0.1 and 0.5 < gone[22] < 0.85  # two tenths of a second, and the spool's own time


# --- line -------------------------------------------------------------------------------------------------------------
@defines("entrained_air")
def test_air_yields_as_boyle_says(rigs: Callable[..., Plant]) -> None:
    """Oil pumped into a closed line: its volume against the pressure is that of the oil and of an isothermal gas."""
    fraction = 0.02
    plant = rigs(entrained_air__fraction=[fraction, 0.0], J=1e6, Km=1e-18)
    out = plant.run(np.full((400, 2), 2.5), None, 1e-3, ("flow", "pressure"))
    flow, pressure = out["flow"][:, :2, 0], out["pressure"][:, :2, 0]
    pumped = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5e-3 * (flow[1:] + flow[:-1]), axis=0)])
    gas = fraction * (1.0 - 101325.0 / (101325.0 + pressure[:, 0]))
    assert pumped[20:, 0] == pytest.approx(1e-4 * (pressure[20:, 0] / 1.267e9 + gas[20:]), rel=2e-3)
    at = [np.argmax(pressure[:, rig] > 1e5) for rig in (0, 1)]
    assert at[0] > 3 * at[1] > 0  # the slow first rise
    assert pressure[-1, 0] > 20e5
    slope = pumped[-1] - pumped[-20]
    assert slope / (pressure[-1] - pressure[-20]) == pytest.approx(
        1e-4 / 1.267e9, rel=0.1
    )  # and hard in the end


@defines("underlap")
def test_underlap_doubles_the_gain_and_softens_the_pressure(rigs: Callable[..., Plant]) -> None:
    up, down = 4e-5, 2e-5
    values = {"underlap__underlap_positive": [0.0, up], "underlap__underlap_negative": [0.0, down]}
    still = {"Fc": 0.0, "Fs": 0.0, "s2": 2.0}
    for command, more in ((60.0, up), (-60.0, -down)):
        plant = hold(rigs(**values, **still), command)
        gained = (plant.flow / plant.get("Kq"))[:2, 0]
        assert gained[1] - gained[0] == pytest.approx(more, rel=1e-6)  # beyond it, the underlap is added
    gain = []
    for command in (0.5, -0.5):
        plant = hold(rigs(**values, **still), command)
        gain.append((plant.flow / plant.get("Kq"))[:2, 0])
    assert gain[0][1] - gain[1][1] == pytest.approx(2.0 * (gain[0][0] - gain[1][0]), rel=1e-3)
    # A load presses oil back through the open centre: 2 u Kq sqrt(...) at a pressure of half the supply.
    equal = {"underlap__underlap_positive": [0.0, up], "underlap__underlap_negative": [0.0, up]}
    plant = hold(rigs(**equal, **still, underlap__supply_pressure=100e5, Km=1e-9), 0.0, 2.0)
    pressure = plant.pressure[1, 0]
    root = np.sqrt(1.0 + pressure / 100e5) - np.sqrt(1.0 - pressure / 100e5)
    assert plant.flow[0, 0] == 0.0
    assert plant.flow[1, 0] == pytest.approx(-up * plant.get("Kq")[1, 0] * root, rel=0.1)


@defines("input_hysteresis")
def test_play_at_the_input_holds_the_current_after_a_reversal(rigs: Callable[..., Plant]) -> None:
    plant = rigs(input_hysteresis__width=[4.0, 0.0])
    seen = []
    for command in (30.0, 27.0, 26.0, 20.0, 23.0, 30.0):
        hold(plant, command, seconds=0.5)
        seen.append(R * plant.get("current")[:2, 0])
    with_play, without = np.array(seen).T
    assert with_play == pytest.approx([28.0, 28.0, 28.0, 22.0, 22.0, 28.0], abs=1e-3)
    assert without == pytest.approx([30.0, 27.0, 26.0, 20.0, 23.0, 30.0], abs=1e-3)


@defines("line_loss")
def test_a_line_takes_pressure_with_the_square_of_the_flow(rigs: Callable[..., Plant]) -> None:
    plant = hold(rigs(line_loss__coefficient=4e13), column(25.0, 50.0, -50.0), seconds=4.0)
    D, speed = plant.get("D")[:3, 0], plant.speed[:3, 0]
    lost = plant.pressure[:3, 0] - plant.get("B")[:3, 0] * speed / D  # what does not reach the shaft
    assert lost == pytest.approx(4e13 * (D * speed) * np.abs(D * speed), rel=1e-5)
    assert lost[1] > 2.5 * lost[0] > 0.0 and lost[2] == pytest.approx(-lost[1], rel=1e-3)


@defines("crossport_relief")
def test_relief_valves_clip_the_pressure_both_ways(rigs: Callable[..., Plant]) -> None:
    setting, slope = 10e5, 1e-9
    values = {"crossport_relief__relief_pressure": [setting, np.inf], "crossport_relief__conductance": slope}
    for sign in (1.0, -1.0):
        plant = hold(rigs(**values, J=1e6, Km=1e-11), column(*[sign * 30.0] * 2), seconds=3.0)
        pressure, flow = sign * plant.pressure[:2, 0], sign * plant.flow[:2, 0]
        assert flow[0] == pytest.approx(1e-11 * pressure[0] + slope * (pressure[0] - setting), rel=1e-6)
        assert setting < pressure[0] < 12e5 < 100e5 < pressure[1]
    below = hold(rigs(**values), column(10.0), seconds=1.0)
    assert (
        below.pressure[0, 0] == pytest.approx(below.pressure[1, 0], rel=1e-4)
        and 0.0 < below.pressure[0, 0] < setting
    )


def test_relief_valves_open_higher_than_they_reseat_and_in_their_own_time(rigs: Callable[..., Plant]) -> None:
    setting, slope, lag = 10e5, 1e-9, 0.02
    values = {
        "crossport_relief__relief_pressure": setting,
        "crossport_relief__conductance": slope,
        "crossport_relief__hysteresis": [0.2, 0.0, 0.0],
        "crossport_relief__time_constant": [0.0, 0.0, lag],
    }

    def ramp(start: float, end: float) -> tuple[Array, Array]:
        """Pressure, and flow through the relief valves, at the end of a slow ramp of the command."""
        for command in np.linspace(start, end, 100):
            hold(plant, sign * command, seconds=0.02)
        hold(plant, sign * end, seconds=0.5)
        pressure = sign * plant.pressure[:3, 0]
        return pressure, sign * plant.flow[:3, 0] - 1e-10 * pressure

    for sign in (1.0, -1.0):
        plant = rigs(**values, J=1e6, Km=1e-10)
        pressure, flow = ramp(0.0, 30.0)  # opens above 11 bar, without friction above 10 bar
        assert pressure[0] > 11e5 > pressure[1] > setting
        assert flow == pytest.approx(slope * (pressure - [1.1 * setting, setting, setting]), rel=0.03)
        before, held = pressure, flow
        pressure, flow = ramp(30.0, 27.0)  # stays as far open, till the pressure is 2 bar lower
        assert pressure[0] < before[0] - 0.5e5 and flow[0] == pytest.approx(held[0], rel=0.06)
        assert flow[1] == pytest.approx(slope * (pressure[1] - setting), rel=0.03)
        pressure, flow = ramp(27.0, 10.0)
        assert (pressure < 0.9 * setting).all() and flow == pytest.approx(0.0, abs=1e-9)
        # In its first milliseconds a slow valve has not opened yet.
        plant.reset()
        hold(plant, sign * 30.0, seconds=0.01)
        assert sign * plant.pressure[2, 0] > sign * plant.pressure[1, 0] + 1e5


@defines("external_leakage")
def test_a_leak_takes_flow_from_its_own_line(rigs: Callable[..., Plant]) -> None:
    leak, supply = 4e-12, 100e5
    values = {
        "external_leakage__conductance": [leak, -leak, 0.0],
        "external_leakage__supply_pressure": supply,
    }
    plant = rigs(**values)
    for sign in (1.0, -1.0):
        plant.reset()
        hold(plant, sign * 60.0, 0.5 * sign)
        missing = (plant.flow - plant.get("D") * plant.speed - plant.get("Km") * plant.pressure)[:3, 0]
        mean = plant.get("lines__mean_pressure")[:2, 0]
        a, b = (0.5 * (supply * (1.0 + mean) + way * plant.pressure[:2, 0]) for way in (1.0, -1.0))
        assert missing[0] == pytest.approx(0.5 * leak * a[0], rel=1e-4)  # half of what leaves either line
        assert missing[1] == pytest.approx(-0.5 * leak * b[1], rel=1e-4)
        assert ((mean > -0.2) & (mean < 0.0)).all()  # both lines are a little lower for it
        assert missing[2] == pytest.approx(0.0, abs=1e-12)
    # At closed valves both lines drain, and nothing leaks any more.
    plant = hold(rigs(**values), 0.0, 0.0, 5.0)
    assert plant.get("lines__mean_pressure")[0, 0] == pytest.approx(-1.0, abs=1e-3)
    assert abs(plant.speed[0, 0]) < 0.1


@defines("case_drain")
def test_a_case_drain_takes_flow_from_both_lines_alike(rigs: Callable[..., Plant]) -> None:
    drain, supply = 4e-12, 100e5
    plant = rigs(case_drain__conductance=[drain, 0.0], case_drain__supply_pressure=supply)
    means = []
    for sign in (1.0, -1.0):
        plant.reset()
        hold(plant, sign * 60.0, 0.5 * sign)
        missing = (plant.flow - plant.get("D") * plant.speed - plant.get("Km") * plant.pressure)[:2, 0]
        # Half of what leaves either line: of the difference of the two, and no more than that.
        assert missing[0] == pytest.approx(0.5 * drain * plant.pressure[0, 0], rel=1e-4)
        assert missing[1] == pytest.approx(0.0, abs=1e-12)
        means.append(plant.get("lines__mean_pressure")[0, 0])
    assert means[0] == pytest.approx(means[1], rel=1e-6) and -0.2 < means[0] < 0.0
    plant = hold(rigs(case_drain__conductance=[drain, 0.0]), 0.0, 0.0, 5.0)
    assert plant.get("lines__mean_pressure")[0, 0] == pytest.approx(-1.0, abs=1e-3)


@defines("anti_cavitation")
def test_check_valves_fill_the_line_that_a_driven_motor_empties(rigs: Callable[..., Plant]) -> None:
    """An overrunning load turns the motor at a closed valve, from rest."""
    supply, slope, opens = 20e5, 1e-10, [-0.3e5, 4e5, 0.0, -0.3e5]
    values = {
        "anti_cavitation__conductance": [slope, slope, 0.0, slope],
        "anti_cavitation__supply_pressure": [supply, supply, supply, 100e5],
        "anti_cavitation__opening_pressure": opens,
    }
    volume = 4.0 * 1e-4 / 12670e5  # m3/Pa of both lines
    for sign in (1.0, -1.0):
        plant = rigs(**values)
        load = np.tile([sign * 6.0, 0.0], (6000, 1))
        rows = plant.run(np.zeros((6000, 2)), load, 2e-4, ("pressure", "speed", "lines__mean_pressure"))
        pressure, speed, off = (rows[name][:, :4, 0] for name in rows)
        # Without the valves, and with valves that stay closed, nothing of a bit is different.
        for signal in (pressure, speed):
            np.testing.assert_array_equal(signal[:, 2], signal[:, 3])
        assert not off[:, 2:].any() and 0.5 * (supply - np.abs(pressure[:, 2])).min() < -5e5
        # In the end they have filled the lines till the drained one is where they close; not all at once.
        mean = 0.5 * supply * (1.0 + off[:, :2])
        drained = mean - 0.5 * np.abs(pressure[:, :2])
        assert drained[-1] == pytest.approx(opens[:2], abs=0.02e5)
        assert (drained.min(axis=0) < np.array(opens[:2]) - 0.05e5).all()
        # What both lines hold more is what came through the valves.
        drawn = np.sum(slope * np.maximum(opens[:2] - drained, 0.0), axis=0) * 2e-4
        assert volume * (mean[-1] - 0.5 * supply) == pytest.approx(drawn, rel=0.02)


def test_a_leak_and_check_valves_have_the_lines_in_common(rigs: Callable[..., Plant]) -> None:
    """Under a lasting overrunning load at a closed valve they draw what leaks from the line that is pressed."""
    leak, slope, supply = 2e-11, 1e-9, 50e5
    values = {
        "external_leakage__conductance": [leak, 0.0, 0.0],
        "external_leakage__supply_pressure": [supply, 90e5, 120e5],
        "anti_cavitation__conductance": slope,
        "anti_cavitation__supply_pressure": [70e5, supply, supply],
    }
    plant = hold(rigs(**values, Km=1e-10), 0.0, 12.0, 3.0)
    pressure, mean = plant.pressure[:3, 0], 0.5 * supply * (1.0 + plant.get("lines__mean_pressure")[:3, 0])
    high, low = mean + 0.5 * np.abs(pressure), mean - 0.5 * np.abs(pressure)
    assert leak * high[0] == pytest.approx(slope * (-0.3e5 - low[0]), rel=1e-3)
    # The supply pressure is that of the first effect that acts: without a leak, that of the check valves.
    assert low[1] == pytest.approx(-0.3e5, rel=1e-3) and mean[1] > 1.2 * 0.5 * supply
    assert (pressure[1], mean[1]) == (pressure[2], mean[2])


@defines("line_volume")
def test_a_volume_behind_a_throttle_fills_with_the_pressure(rigs: Callable[..., Plant]) -> None:
    conductance, volume = 1e-10, 1e-3
    plant = rigs(line_volume__conductance=[conductance, 0.0], line_volume__volume=volume, J=1e6, Km=1e-9)
    hold(plant, 30.0, seconds=0.02)
    time_constant = volume / (plant.get("beta")[0, 0] * conductance)
    before, side = plant.pressure[0, 0], plant.get("line_volume__side_pressure")[0, 0]
    assert 0.0 < side < 0.9 * before and plant.pressure[1, 0] > before  # it takes oil while it fills
    hold(plant, 30.0, seconds=max(1.0, 10.0 * time_constant))
    assert plant.get("line_volume__side_pressure")[0, 0] == pytest.approx(plant.pressure[0, 0], rel=1e-3)
    assert plant.pressure[1, 0] == pytest.approx(plant.pressure[0, 0], rel=1e-3)  # and none when it is full


# --- motor ------------------------------------------------------------------------------------------------------------
def friction(plant: Plant) -> Array:
    """Torque that the oil gives and neither the bearing's drag nor inertia takes, at steady speed."""
    return (plant.get("D") * plant.pressure - plant.get("B") * plant.speed)[:, 0]


@defines("speed_dependent_leakage")
def test_leakage_by_speed_shows_in_the_flow_balance_without_load(rigs: Callable[..., Plant]) -> None:
    plant = hold(
        rigs(speed_dependent_leakage__coefficient=2e-7),
        column(30.0, 60.0, -60.0, 60.0),
        column(0, 0, 0, 0.5),
        4.0,
    )
    missing = (plant.flow - plant.get("D") * plant.speed - plant.get("Km") * plant.pressure)[:4, 0]
    assert missing == pytest.approx(2e-7 * plant.speed[:4, 0], rel=1e-6)


@defines("motor_coulomb_friction")
def test_dry_friction_opposes_motion_and_holds_the_shaft(rigs: Callable[..., Plant]) -> None:
    values = {"motor_coulomb_friction__coulomb": 0.2, "motor_coulomb_friction__static": 0.4}
    plant = hold(rigs(**values), column(60.0, 30.0, -60.0), seconds=5.0)
    assert friction(plant)[:3] == pytest.approx([0.2, 0.2, -0.2], rel=1e-6)
    # Closed valves leak (Km), so a load turns the shaft slowly, unless friction holds it.
    plant = hold(rigs(**values), 0.0, column(0.3, 0.6, -0.3), 2.0)
    assert np.all(np.abs(plant.speed[[0, 2], 0]) < 0.15) and plant.speed[1, 0] < -1.0
    free = hold(rigs(), 0.0, column(0.3), 2.0)
    assert free.speed[0, 0] < -1.0


@defines("quadratic_drag")
def test_drag_grows_with_the_square_of_speed(rigs: Callable[..., Plant]) -> None:
    plant = hold(rigs(quadratic_drag__coefficient=2e-4), column(25.0, 50.0, -50.0), seconds=4.0)
    speed = plant.speed[:3, 0]
    assert friction(plant)[:3] == pytest.approx(2e-4 * speed * np.abs(speed), rel=1e-6)


@defines("displacement_ripple")
def test_ripple_is_a_line_at_the_order_of_the_shafts_speed(rigs: Callable[..., Plant]) -> None:
    plant = rigs(displacement_ripple__amplitude=[0.04, 0.0], displacement_ripple__order=7.0)
    out = plant.run(np.full((3000, 2), 25.0), None, 1e-3, ("speed", "angle"))
    for rig, there in ((0, True), (1, False)):
        angle, speed = out["angle"][1500:, rig, 0], out["speed"][1500:, rig, 0]
        turns = np.arange(angle[0], angle[-1], 2 * np.pi / 128)
        turns = turns[: 128 * (len(turns) // 128)]
        lines = 2 * np.abs(np.fft.rfft(np.interp(turns, angle, speed))) / len(turns)
        per_turn = lines[:: len(turns) // 128][1:30]  # lines at 1, 2, ... times the shaft's speed
        if there:
            assert np.argmax(per_turn) + 1 == 7 and per_turn[6] > 5e-3
            assert per_turn[6] > 10.0 * np.delete(per_turn, [6, 13]).max()
        else:
            assert per_turn.max() < 1e-3


# --- load -------------------------------------------------------------------------------------------------------------
@defines("load_bias")
def test_a_bias_has_one_sign_in_both_directions(rigs: Callable[..., Plant]) -> None:
    plant = hold(rigs(load_bias__bias=0.4), column(60.0, -60.0, 30.0), seconds=5.0)
    assert friction(plant)[:3] == pytest.approx([0.4] * 3, rel=1e-6)


@defines("eccentric_load")
def test_an_unbalanced_weight_turns_with_the_shaft(rigs: Callable[..., Plant]) -> None:
    plant = rigs(eccentric_load__amplitude=0.3, eccentric_load__phase=0.7)
    out = plant.run(np.full((2000, 2), 40.0), None, 1e-3, ("speed", "angle", "pressure"))
    angle, speed, pressure = (out[name][:, 0, 0] for name in ("angle", "speed", "pressure"))
    inertia = plant.get("J")[0, 0] * np.gradient(speed, 1e-3)
    torque = (plant.get("D")[0, 0] * pressure - plant.get("B")[0, 0] * speed - inertia)[200:-2]
    parts = np.stack([np.sin(angle), np.cos(angle), np.ones_like(angle)], axis=1)[200:-2]
    found = np.linalg.lstsq(parts, torque, rcond=None)[0]
    assert found == pytest.approx([0.3 * np.cos(0.7), 0.3 * np.sin(0.7), 0.0], abs=3e-3)


@defines("shaft_backlash")
def test_behind_a_gap_the_load_waits_until_the_gap_is_closed(rigs: Callable[..., Plant]) -> None:
    gap, stiffness, inertia = 0.08, 300.0, 0.004
    values = {
        "shaft_backlash__gap": gap,
        "shaft_backlash__stiffness": stiffness,
        "shaft_backlash__inertia": inertia,
    }
    plant = rigs(**values)
    names = ("speed", "pressure", "angle", "shaft_backlash__load_speed")
    out = plant.run(np.full((600, 2), 30.0), None, 2e-4, names)
    speed, pressure, angle, load_speed = (out[name][:, 0, 0] for name in names)
    free = np.argmax(angle > 0.5 * gap)  # from the middle of the gap
    assert 20 < free < 300
    assert np.all(load_speed[:free] == 0.0) and load_speed[free + 20] > 0.0
    # Until then the motor drives its own inertia alone, and afterwards both gain what the oil and the bearing give.
    D, B, J = (plant.get(name)[0, 0] for name in ("D", "B", "J"))
    torque = D * pressure - B * speed
    impulse = np.concatenate([[0.0], np.cumsum(1e-4 * (torque[1:] + torque[:-1]))])
    assert J * speed[10:free] == pytest.approx(impulse[10:free], rel=1e-3, abs=2e-6)
    assert (J * speed + inertia * load_speed)[free:] == pytest.approx(impulse[free:], rel=2e-3, abs=5e-6)
    # A standing load winds the coupling beyond the gap.
    wound = hold(rigs(**values), 40.0, 0.5, 6.0).get("shaft_backlash__twist")[0, 0]
    assert wound == pytest.approx(0.5 * gap + 0.5 / stiffness, rel=1e-3)


# --- fluid ------------------------------------------------------------------------------------------------------------
@defines("viscosity_drift")
def test_a_warmer_fluid_leaks_more_and_drags_less(rigs: Callable[..., Plant]) -> None:
    change, tau = -0.6, 0.5  # log of the viscosity's ratio
    plant = rigs(viscosity_drift__change=change, viscosity_drift__time_constant=tau)

    def ratios() -> tuple[float, float]:
        D, leak = plant.get("D")[0, 0], (plant.flow - plant.get("D") * plant.speed)[0, 0]
        return leak / plant.pressure[0, 0] / 1.592e-10, D * plant.pressure[0, 0] / plant.speed[
            0, 0
        ] / 0.0042972

    leakage, drag = hold_ratio = (hold(plant, 50.0, 0.0, 6.0), ratios())[1]
    assert hold_ratio == pytest.approx((np.exp(-change), np.exp(change)), rel=1e-3)
    assert leakage > 1.7 > 0.6 > drag


# --- sensor -----------------------------------------------------------------------------------------------------------
@defines("sensor_lag", "sensor_gain", "sensor_offset")
def test_sensors_change_what_is_measured_and_nothing_else(rigs: Callable[..., Plant]) -> None:
    time = np.arange(300) * 2e-3
    commands = (40.0 + 20.0 * np.sin(6.0 * time))[:, None] * np.ones(2)
    values = {
        "sensor_lag__time_constant": [0.0, 0.02, 0.0, 0.0],
        "sensor_gain__gain": [1.0, 1.0, 1.1, 1.0],
        "sensor_offset__offset": [0.0, 0.0, 0.0, 1.5],
    }
    plant = rigs(**{name: each + [each[0]] * 5 for name, each in values.items()})
    out = plant.run(commands, None, 2e-3, ("speed", "measured_speed"))
    true, shown = out["speed"][:, :4, 0], out["measured_speed"][:, :4, 0]
    # The state of a lag counts when a step is chosen: the speed stays within the tolerance.
    assert true == pytest.approx(true[:, :1] * np.ones(4), abs=plant.tolerance)
    assert np.all(true[:, 2:] == true[:, :1]) and np.all(shown[:, 0] == true[:, 0])
    lag = shown[:, 1] + 0.02 * np.gradient(shown[:, 1], 2e-3)  # a filter of first order, undone
    assert lag[2:-2] == pytest.approx(true[2:-2, 1], abs=5e-3 * true.max())
    assert shown[:, 2] == pytest.approx(1.1 * true[:, 2], rel=1e-12)
    assert shown[:, 3] == pytest.approx(true[:, 3] + 1.5, rel=1e-12)

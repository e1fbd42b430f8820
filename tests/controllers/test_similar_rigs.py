"""A rig that is the paper's at another size is the same task: observations, rewards and scores are those of the paper's rig."""

from __future__ import annotations

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.plant import PAPER, PARAMETERS, PlantModel, Scales, load_model, scales_of
from hydro_env.tasks import SCENARIOS, load_scenario

#: Preferred numbers; the power of the coil is that of force and travel.
SIZE = Scales(
    command=2.5 * 2.5 / 10.0, current=10.0, force=2.5, travel=2.5, flow=2.0, displacement=4.0, inertia=8.0, pressure=1.0
)  # fmt: skip


def similar(model: PlantModel) -> PlantModel:
    """The same rig at this size, with motions as quick as there."""
    factors = {name: SIZE.factor(p.unit) for name, p in PARAMETERS.items()}
    factors |= {"J": SIZE.torque / SIZE.speed, "V": SIZE.flow / SIZE.pressure, "beta": 1.0}
    factors |= {f"dead_zone.overlap_{way}": SIZE.travel for way in ("positive", "negative")}
    values = {name: tuple(f * v for v in model.pair(name)) for name, f in factors.items()}
    return replace(model.with_values(values), tolerance=SIZE.speed * model.tolerance)


@pytest.fixture(scope="module")
def rig() -> PlantModel:
    return similar(load_model("paper_dead_zone"))


def test_the_size_of_the_rig_is_found(rig: PlantModel) -> None:
    found = scales_of(rig)
    assert found.command == pytest.approx(SIZE.command)
    assert replace(found, command=SIZE.command) == SIZE


def test_the_same_actions_have_the_same_observations_and_rewards(rig: PlantModel) -> None:
    made = [
        gymnasium.make("hydro_env:HydraulicSync-v0", plant=plant, scenario="setpoint_steps", mismatch="val", noise=0.0)
        for plant in ("paper_dead_zone", rig)
    ]  # fmt: skip
    seen = [env.reset(seed=3)[0] for env in made]
    np.testing.assert_allclose(seen[1], seen[0])
    actions = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 2)).cumsum(axis=0).clip(-0.6, 0.6)
    for action in actions.astype(np.float32):
        (paper, reward, *_), (here, other, *_) = (env.step(action) for env in made)
        np.testing.assert_allclose(here, paper, atol=2e-3)
        assert other == pytest.approx(reward, abs=0.01)


def test_scenarios_go_with_the_size_and_tables_of_ones_own_do_not() -> None:
    table = {"duration": 1.0, "setpoint_rpm": [[0.0, 400.0]], "load_Nm": [[0.0, 0.5, 0.5]]}
    for source, speed, torque in (
        ("sine", SIZE.speed, SIZE.torque),
        (SCENARIOS["sine"], SIZE.speed, SIZE.torque),
        (table, 1.0, 1.0),
    ):
        found = load_scenario(source, SIZE)
        assert (found.speed, found.torque) == (speed, torque)
        assert load_scenario(source, PAPER).summary in found.summary


@pytest.mark.parametrize("name", ["pid_tuned", "cross_coupled", "compensated", "gru", "oracle"])
def test_controllers_that_ship_do_the_same_there(name: str, rig: PlantModel) -> None:
    peaks = []
    for plant, size in (("paper_dead_zone", PAPER), (rig, SIZE)):
        done = roll_out(
            make_controller(name), range(8), plant=plant, mismatch="val", scenario="setpoint_steps"
        )
        found = done.metrics()
        peaks.append(
            [found[key].mean() / size.speed for key in ("max_speed_difference_rpm", "tracking_mae_rpm")]
        )
        if size is SIZE:
            assert done.trace.setpoint_rpm.max() == pytest.approx(300.0)
    assert peaks[1] == pytest.approx(peaks[0], rel=0.05)


def test_gains_of_ones_own_are_in_the_units_of_the_rig(rig: PlantModel) -> None:
    carried = make_controller("pid_tuned")
    size = SIZE.command / SIZE.speed  # V/rpm
    own = make_controller("pid_tuned").with_gains(Kp=size * carried.gains["Kp"])
    for controller in (carried, own):
        controller.drives(rig)
        controller.reset(1, 0.01)
    assert own.gains["Kp"] == pytest.approx(carried.gains["Kp"])


def test_a_smaller_valve_before_the_same_motor_makes_the_pressures_smaller_too() -> None:
    law = make_controller("adaptive_flow")
    law.drives(load_model("valve_2"))
    assert law.scales.flow < 0.8
    # Else the motor leaks another share of its flow.
    assert law.scales.pressure == pytest.approx(law.scales.flow)

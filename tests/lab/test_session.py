"""The session without a page: it drives as the environment does, takes changes while it runs, and records logs."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.lab.rig import LiveRig
from hydro_env.lab.session import COLUMNS, MANUAL, MAX_SECONDS, Session, Settings
from hydro_env.measured import read_log
from hydro_env.plant import Plant
from hydro_env.units import RPM

NUMBER = 3


def run(session: Session, seconds: float) -> np.ndarray:
    for _ in range(round(seconds * 100)):
        session.step()
    return session.snapshot().past


@pytest.mark.parametrize("controller", ["pid_tuned", "gru", "probing_flow", "bench_flow"])
def test_it_drives_as_the_environment_does(controller: str) -> None:
    """With the noise taken out of both: the same pair, scenario and controller give the same bits."""
    from hydro_env.envs.batch import HydraulicSyncVectorEnv

    session = Session(Settings(controller=controller, scenario="load_step", number=NUMBER), noise=0.0)
    past = run(session, 5.0)
    env = HydraulicSyncVectorEnv(1, mismatch="test_interp", scenario="load_step", noise=0.0)
    observation, info = env.reset(seed=[NUMBER])
    driver = make_controller(controller)
    if driver.needs != "measurements":
        driver.prepare(copy.deepcopy(env.plant))
    driver.reset(1, 0.01)
    for row in past:
        assert row[COLUMNS.index("setpoint_rpm")] == pytest.approx(info["setpoint_rpm"][0])
        np.testing.assert_array_equal(row[2:4], info["speed_rpm"][0])
        np.testing.assert_array_equal(row[5:7], info["command_V"][0])
        action = np.clip(driver.act(observation), -1.0, 1.0).astype(np.float32)
        observation, _, _, _, info = env.step(action)


def test_the_sensors_have_their_noise() -> None:
    session = Session(Settings(scenario=MANUAL))
    shown = np.array([session._rig.sense(0.0).observation[0, 1:3] for _ in range(2000)])
    assert np.std(shown * 600.0) == pytest.approx(1.0, rel=0.1)  # 1 rpm, the scale is 600 rpm


def test_controllers_take_over_while_it_runs() -> None:
    session = Session(Settings(scenario=MANUAL, setpoint_rpm=300.0))
    run(session, 2.0)
    for name in ("cross_coupled", "gru", "oracle", "pid_paper", "probing_flow"):
        session.choose_controller(name)
        before = session.snapshot().now["speed_1_rpm"]
        session.step()
        assert abs(session.snapshot().now["speed_1_rpm"] - before) < 30.0, name
        run(session, 2.0)
        now = session.snapshot()
        assert now.problem == "" and now.now["speed_1_rpm"] == pytest.approx(300.0, abs=20.0), name
    assert "privileged" not in now.note and session.settings.controller == "probing_flow"


def test_what_a_controller_knows_is_said() -> None:
    session = Session(Settings(controller="oracle"))
    assert "future loads" in session.snapshot().note
    session.choose_controller("servo_pid")
    assert "servo" in session.snapshot().note
    session.choose_controller("gru")
    assert session.snapshot().note == ""


def test_the_set_point_by_hand_takes_over() -> None:
    session = Session(Settings(scenario="sine"))
    run(session, 1.0)
    session.set_setpoint(-200.0)
    assert session.settings.scenario == MANUAL
    assert run(session, 3.0)[-1, 2] == pytest.approx(-200.0, abs=20.0)


def test_a_scenario_begins_again_at_its_end_and_the_rig_runs_on() -> None:
    session = Session(Settings(scenario="setpoint_steps"))
    past = run(session, 7.0)
    time, setpoint = past[:, 0], past[:, 1]
    assert time[-1] == pytest.approx(6.99) and set(np.unique(setpoint[590:600])) == {600.0}
    assert set(np.unique(setpoint[600:620].round())) == {0.0} and setpoint[-1] == pytest.approx(600.0)


def test_a_load_acts_on_its_motor_and_adds_to_the_scenario() -> None:
    session = Session(Settings(scenario=MANUAL, setpoint_rpm=300.0))
    run(session, 2.0)
    session.set_load(0, 0.8)
    past = run(session, 0.1)
    assert past[-1, 2] < 290.0 and past[-1, 3] == pytest.approx(300.0, abs=8.0)
    session.choose_scenario("load_step")
    session.step()
    np.testing.assert_allclose(session.snapshot().load_Nm, (0.8, 0.0))


def test_an_effect_acts_at_once_and_goes_again() -> None:
    name = "motor_coulomb_friction.coulomb"
    session = Session(Settings(scenario=MANUAL, setpoint_rpm=300.0), noise=0.0)
    calm = run(session, 2.0)[-1]
    session.set_effect(name, 1, 1.0)
    assert session.snapshot().effects[name] == (0.0, 1.0)
    braked = run(session, 0.1)[-1]
    assert braked[3] < calm[3] - 10.0 and braked[2] == pytest.approx(calm[2], abs=1.0)
    session.clear_effects()
    assert session.snapshot().effects[name] == (0.0, 0.0)
    with pytest.raises(InputError, match="out of range"):
        session.set_effect(name, 0, 99.0)


def test_effects_that_were_set_stay_with_another_pair_and_go_back_to_it() -> None:
    name = "dead_zone.overlap_positive"
    session = Session()
    own = session.snapshot().effects[name]
    session.set_effect(name, 0, 3e-4)
    session.choose_valves("paper_dead_zone", "test_interp", 1)
    assert session.snapshot().effects[name][0] == 3e-4
    session.clear_effects()
    session.choose_valves("paper_dead_zone", "test_interp", 0)
    assert session.snapshot().effects[name] == own
    session.choose_valves("paper_dead_zone", "own", 0)
    plant = Plant("paper_dead_zone")
    assert session.snapshot().effects[name] == tuple(plant.get(name)[0])


def test_another_preset_begins_at_rest() -> None:
    session = Session()
    run(session, 1.0)
    session.choose_valves("servo", "own", 0)
    assert session.snapshot().time == 0.0 and session.snapshot().now["speed_1_rpm"] == 0.0
    assert run(session, 1.5)[-1, 2] > 500.0


def test_a_rig_goes_as_far_as_its_reach_says(tmp_path: Path) -> None:
    """At the rated command, without load, and against the torque that stops it."""
    path = tmp_path / "mine.yaml"
    path.write_text(
        "schema: hydro_env/model/1\nbase: paper\nboth: {D: 8.0e-6, R: 5.0, alpha: 8.0, u_rated: 10.0, Km: 1.0e-10, J: 0.005}\n"
        "channel_2: {Kq: 0.2}\nsources: {D: sheet, R: sheet, alpha: sheet}\n"
    )
    for preset in ("paper", str(path)):
        rig = LiveRig(preset, noise=0.0)
        for load, wanted in ((0.0, rig.reach.speed_rpm), (rig.reach.torque_Nm, 0.0)):
            rig.reset()
            for _ in range(300):
                rig.hold([1.0, 1.0], [load, load])
            assert min(rig.sense(0.0).speed_rpm) == pytest.approx(wanted, abs=0.02 * rig.reach.speed_rpm)
    session = Session(Settings(preset=str(path), split="own"))
    assert "paper_dead_zone" in session.snapshot().note
    session.set_load(0, session.snapshot().reach.torque_Nm)
    session.choose_valves("rig", "own", 0)
    assert session.settings.load_Nm == (0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda s: s.choose_controller("gruu"), "did you mean 'gru'"),
        (lambda s: s.choose_scenario("sin"), "did you mean 'sine'"),
        (lambda s: s.choose_valves("paper_dead_zone", "test_interp", 10**6), "test_interp"),
        (lambda s: s.choose_valves("nowhere", "own", 0), "unknown plant"),
        (lambda s: s.set_setpoint(float("nan")), "set-point"),
        (lambda s: s.set_setpoint(1500.0), "set-point is 1500.0, expected a number from -139"),
        (lambda s: s.set_load(0, 1e9), "load 1"),
        (lambda s: s.set_effect("dead_zone.x", 0, 0.0), "no parameter"),
    ],
)
def test_what_cannot_be_is_one_line_and_changes_nothing(change, word: str) -> None:
    session = Session()
    before = session.settings
    with pytest.raises(InputError, match=word):
        change(session)
    assert session.settings == before
    session.step()


def test_a_controller_that_fails_is_stopped_and_named(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "class Mine:\n    def reset(self, n, period): self.left = 5\n"
        "    def act(self, seen):\n        self.left -= 1\n        assert self.left, 'no more'\n        return [[0.5, 0.5]]\n"
    )
    session = Session()
    session.choose_controller(f"{tmp_path}/mine.py:Mine")
    run(session, 0.2)
    assert "mine.py" in session.snapshot().problem and "no more" in session.snapshot().problem
    assert session.snapshot().now["command_1_V"] == 0.0
    session.choose_controller("pid_tuned")
    assert session.snapshot().problem == "" and run(session, 1.2)[-1, 2] > 400.0


def test_a_recording_is_a_log_of_the_rig_from_rest(tmp_path: Path) -> None:
    session = Session(Settings(scenario="load_step"))
    run(session, 1.0)
    session.record()
    past = run(session, 3.0)
    assert session.snapshot().recorded == pytest.approx(3.0)
    session.stop_recording()
    path = tmp_path / "log.csv"
    path.write_text(session.finished_log)
    log = read_log(path)
    assert log.uniform and log.period == pytest.approx(1e-3) and len(log) == 3000
    assert not any(finding.sure for finding in log.findings)
    np.testing.assert_allclose(log.speed[::10] / RPM, past[:, 2:4], atol=6.0)
    np.testing.assert_allclose(log.command_V[9:-1:10], past[1:, 5:7], atol=1e-3)
    load = log.get("load")
    assert load is not None and load[-1, 0] == pytest.approx(0.8)
    with pytest.raises(InputError, match="no log"):
        session.stop_recording()


def test_a_recording_ends_by_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    assert MAX_SECONDS == 120.0
    monkeypatch.setattr("hydro_env.lab.session.MAX_SECONDS", 0.5)
    session = Session()
    session.record()
    run(session, 1.0)
    assert session.snapshot().recorded is None
    assert len(session.finished_log.splitlines()) == 1 + 500


def test_the_trace_of_the_benchmark_is_that_of_the_session() -> None:
    """`roll_out` and a session differ in noise alone."""
    session = Session(Settings(controller="cross_coupled", number=NUMBER))
    trace = roll_out(make_controller("cross_coupled"), [NUMBER], mismatch="test_interp").trace
    np.testing.assert_allclose(run(session, 6.0)[:, 2:4], trace.speed_rpm[:600, 0], atol=25.0)

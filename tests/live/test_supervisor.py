"""Limits, watchdog and plausibility, sample by sample, with the exact times that the documents state."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from hydro_env.live.link import Link, Sample
from hydro_env.live.supervisor import PATIENCE, START, State, Supervisor

CYCLE, WATCHDOG = 0.01, 0.1


def link(**changed: Any) -> Link:
    channel = {
        "speed": {"name": "n{}", "unit": "rpm", "range": [-900, 900]},
        "pressure": {"name": "p{}", "unit": "bar"},
    }
    channels = {
        f"channel_{c}": {"command": {"name": f"u{c}", "rated": 10}}
        | {key: value | {"name": f"{key}{c}"} for key, value in channel.items()}
        for c in (1, 2)
    }
    return Link.model_validate(
        {"protocol": "udp", "address": "rig:1", "listen": "here:2", "cycle_s": CYCLE, "watchdog_s": WATCHDOG, "count": "n"}
        | {"time": {"name": "t"}} | channels | changed
    )  # fmt: skip


class Rig:
    """Samples every cycle, on a clock that is 1000 s behind."""

    def __init__(self, **changed: Any) -> None:
        self.now, self.count, self.late = 50.0, 0, 0.0
        self.link = link(**changed)
        self.supervisor = Supervisor(self.link, self.now)
        self.rng = np.random.default_rng(0)

    def sample(self, **values: float) -> Sample:
        self.count += 1
        usual = {key: float(self.rng.standard_normal()) for key in self.link.inputs}
        return Sample(self.count, self.now - self.late - 1000.0, usual | values)

    def step(self, wanted: Any = (0.1, -0.1), lost: bool = False, **values: float) -> bool:
        self.now += CYCLE
        sample = self.sample(**values)
        new = self.supervisor.see(self.now, None if lost else sample)
        if new:
            self.supervisor.take(self.now, wanted)
        return new

    def run(self, steps: int, **more: Any) -> None:
        for _ in range(steps):
            self.step(**more)

    def until_fault(self, most: float, **more: Any) -> float:
        start = self.now
        while self.supervisor.state is not State.FAULT:
            self.step(**more)
            assert self.now - start < most + 1e-9, self.supervisor.state
        return self.now - start


def running(**changed: Any) -> Rig:
    rig = Rig(**changed)
    rig.run(START + 40)
    assert rig.supervisor.state is State.RUNNING and rig.supervisor.command.any()
    return rig


def test_nothing_is_written_before_there_are_good_samples() -> None:
    rig = Rig()
    rig.run(START)
    assert rig.supervisor.state is State.WAITING and not rig.supervisor.command.any()
    rig.run(2)
    assert rig.supervisor.state is State.RUNNING


def test_a_rig_at_another_pace_is_never_driven() -> None:
    rig = Rig(cycle_s=0.02)
    rig.run(START + 1)
    assert rig.supervisor.cause == "samples come every 0.01 s, cycle_s of the link is 0.02"


def test_a_rig_that_never_speaks_is_a_fault() -> None:
    rig = Rig()
    rig.until_fault(PATIENCE + 2 * CYCLE, lost=True)


def test_commands_keep_to_limit_and_rate() -> None:
    rig = Rig(command_limit_percent=20.0, rate_limit=2.0)
    rig.run(START + 1)
    commands = []
    for wanted in [(1.0, -1.0)] * 30 + [(-1.0, 1.0)] * 30:
        rig.step(wanted)
        commands.append(rig.supervisor.command)
    assert np.abs(commands).max() == pytest.approx(0.2)
    assert np.abs(np.diff(commands, axis=0)).max() <= 2.0 * CYCLE + 1e-9
    assert commands[-1].tolist() == pytest.approx([-0.2, 0.2])


def test_the_rate_is_that_of_the_clock_after_a_pause() -> None:
    rig = running(rate_limit=2.0)
    rig.supervisor.command = np.zeros(2)
    rig.run(6, lost=True)
    rig.step((1.0, 1.0))
    assert rig.supervisor.command.max() <= 2.0 * 2.0 * CYCLE + 1e-9


@pytest.mark.parametrize("kind", ["lost", "old", "late"])
def test_without_new_samples_there_is_a_fault_in_the_stated_time(kind: str) -> None:
    rig = running()
    if kind == "old":
        rig.count -= 1000
    if kind == "late":
        rig.late = WATCHDOG + 0.05
    took = rig.until_fault(rig.link.stop_s, lost=kind == "lost")
    assert took > WATCHDOG - CYCLE
    assert ("old or late" in rig.supervisor.cause) == (kind != "lost")
    assert not rig.supervisor.command.any()


def test_a_delay_that_grows_slowly_is_seen_and_clocks_may_drift() -> None:
    rig = running()
    for _ in range(4000):  # 40 s
        rig.late += 5e-4 * CYCLE
        rig.step()
    assert rig.supervisor.state is State.RUNNING
    for _ in range(1000):
        rig.late += 0.02 * CYCLE
        rig.step()
    assert rig.supervisor.state is State.FAULT


def test_single_lost_and_exchanged_samples_do_no_harm() -> None:
    rig = running()
    rig.step(lost=True)
    one, two = rig.sample(), rig.sample()
    rig.now += 2 * CYCLE
    assert rig.supervisor.see(rig.now, two) and not rig.supervisor.see(rig.now, one)
    rig.step()
    assert rig.supervisor.state is State.RUNNING and rig.supervisor.command.any()


def test_what_is_done_while_a_sample_is_late_can_be_chosen() -> None:
    for when_late, open_ in (("hold", True), ("zero", False)):
        rig = running(when_late=when_late)
        rig.run(4, lost=True)
        assert rig.supervisor.state is State.RUNNING and rig.supervisor.command.any() == open_


@pytest.mark.parametrize("value", [math.nan, math.inf, 900.5 * math.pi / 30])
def test_an_implausible_value_is_a_fault_at_once(value: float) -> None:
    rig = running()
    rig.step(speed_2=value)
    assert rig.supervisor.state is State.FAULT and "speed_2" in rig.supervisor.cause
    assert not rig.supervisor.command.any()


def test_a_signal_that_is_absent_is_a_fault() -> None:
    rig = running()
    rig.now += CYCLE
    values = {key: 0.1 for key in rig.link.inputs if key != "pressure_1"}
    rig.supervisor.see(rig.now, Sample(rig.count + 1, rig.now - 1000.0, values))
    assert "pressure_1" in rig.supervisor.cause


def test_a_frozen_speed_is_a_fault_in_the_stated_time_but_not_at_rest() -> None:
    rig = running()
    took = rig.until_fault(rig.link.frozen_after("speed_1") + rig.link.stop_s, speed_1=3.0)
    assert took > rig.link.frozen_after("speed_1") and "speed_1 is frozen" in rig.supervisor.cause
    rig = Rig()
    rig.run(300, wanted=(0.0, 0.0), speed_1=0.0, pressure_1=5.0)
    assert rig.supervisor.state is State.RUNNING
    rig.run(300, pressure_1=5.0)  # that a pressure stands still is none, unless the link says so
    assert rig.supervisor.state is State.RUNNING


@pytest.mark.parametrize("wanted", [(0.1, math.nan), "full", (0.1,), None])
def test_what_is_no_command_is_a_fault(wanted: Any) -> None:
    rig = running()
    rig.step(wanted)
    assert rig.supervisor.state is State.FAULT and "the controller gave" in rig.supervisor.cause


def test_a_fault_stays_with_its_first_cause() -> None:
    rig = running()
    rig.step(speed_1=math.nan)
    cause = rig.supervisor.cause
    rig.run(500)
    rig.supervisor.fail(rig.now, "another")
    rig.supervisor.stop(rig.now)
    assert (rig.supervisor.state, rig.supervisor.cause) == (State.FAULT, cause)
    assert not rig.supervisor.command.any()

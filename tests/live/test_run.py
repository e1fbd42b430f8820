"""Runs against a simulated rig behind UDP and behind a real OPC UA server: it follows, and every fault closes the valves in time.

What the rig wrote down of its valves is the witness.
"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_env.live.driver import Driver, controlled, played
from hydro_env.live.link import Link
from hydro_env.live.run import Run
from hydro_env.live.supervisor import State
from hydro_env.measured import read_log
from hydro_env.plant import load_model
from hydro_env.units import RPM
from tests.live.rig import OpcUaRig, Rig, UdpRig, late

RATED_V = load_model("paper_dead_zone").pair("u_rated")
#: A law that is slow enough for the delays of any machine, and how near it comes, rpm.
GENTLE, NEAR = "pid_tuned:Kp=0.02,Ti=0.2,Td=0", 40.0
#: What a busy machine may add to a stated time, s.
BUSY = 0.4


@pytest.fixture(scope="module", params=["udp", "opcua"])
def started(request: pytest.FixtureRequest) -> Iterator[Rig]:
    if request.param == "opcua":
        pytest.importorskip("asyncua", reason="needs the extra live")
    rig: Rig = UdpRig() if request.param == "udp" else OpcUaRig()
    rig.start()
    assert rig.ready.wait(120.0)
    yield rig
    rig.end()


@pytest.fixture
def rig(started: Rig) -> Rig:
    started.rest()
    return started


def constant(share: float = 0.15) -> Driver:
    return Driver(lambda n, sample, command: np.full(2, share), None)


class Attempt:
    """A run in a thread of its own."""

    def __init__(self, link: Link, driver: Driver, out: Path, **more: Any) -> None:
        self.told: list[str] = []
        self.run = Run(link, driver, out, RATED_V, told=self.told.append, **more)
        self.problem: BaseException | None = None
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        try:
            self.run()
        except BaseException as problem:
            self.problem = problem

    def until(self, there: Callable[[], bool], seconds: float = 20.0) -> None:
        end = time.monotonic() + seconds
        while not there() and self._thread.is_alive():
            assert time.monotonic() < end, self.run.supervisor.state
            time.sleep(0.005)

    def driving(self, rig: Rig) -> None:
        """Waits until the valves are open."""
        self.until(lambda: bool(rig.applied) and any(rig.applied[-1][1:]))

    def end(self) -> str:
        self.run.stop.set()
        self._thread.join(20.0)
        assert not self._thread.is_alive()
        if self.problem is not None:
            raise self.problem
        return self.run.supervisor.cause


def test_a_controller_follows_the_set_point_and_leaves_a_clean_log(rig: Rig, tmp_path: Path) -> None:
    """Both signs of the link are other ones than the model's: a wrong one would run away."""
    scenario = tmp_path / "profile.yaml"
    scenario.write_text("{duration: 5.6, setpoint_rpm: [[0.2, 150], [2.9, -100]]}")
    link, limit = rig.link(), 0.5
    driver = controlled(GENTLE, link, load_model("paper_dead_zone"), str(scenario), (limit, link.rate_limit))
    attempt = Attempt(link, driver, tmp_path / "out", limit=limit)
    attempt.until(lambda: False, 30.0)
    assert attempt.end() == ""
    assert attempt.run.supervisor.state is State.STOPPED
    assert rig.applied[-1][1:] == (0.0, 0.0) or rig.closed_after(time.monotonic()) == 0.0
    log = read_log(tmp_path / "out" / "log_1.csv")
    assert {f.code for f in log.findings} <= {"gap", "uneven_sampling"}, (
        log.findings
    )  # a busy machine loses samples
    assert log.signals == ("command", "current", "pressure", "speed", "setpoint") and log.period == rig.cycle
    assert log.setpoint is not None
    for rpm in (150.0, -100.0):
        rows = np.flatnonzero(np.abs(log.setpoint / RPM - rpm) < 1.0)
        assert np.abs(log.speed[rows[-6:]].mean(axis=0) / RPM - rpm).max() < NEAR
    assert np.abs(log.command_V).max() <= limit * RATED_V[0] + 1e-9
    states = [
        json.loads(line)["state"] for line in (tmp_path / "out" / "log_1.jsonl").read_text().splitlines()
    ]
    assert states == ["waiting", "running", "stopped"]


def numbers_of(**changed: Any) -> Callable[[dict[str, Any]], dict[str, Any]]:
    return lambda numbers: numbers | changed


def frozen(rig: Rig) -> Callable[[dict[str, Any]], dict[str, Any]]:
    kept = rig.numbers()["n1"]
    return lambda numbers: numbers | {"n1": kept}


FAULTS: dict[str, tuple[Callable[[Rig], Any], str]] = {
    "lost": (lambda rig: lambda numbers: None, "no new sample"),
    "late": (lambda rig: late(round(1.0 / rig.cycle)), "no new sample"),
    "old": (lambda rig: lambda numbers: numbers | {"n": numbers["n"] - 1000}, "old or late"),
    "implausible": (lambda rig: numbers_of(n2=1500.0), "speed_2 is 1500 rpm, its range is -900 to 900"),
    "not a number": (lambda rig: numbers_of(p1=float("nan")), ""),
    "frozen": (frozen, "speed_1 is frozen"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_closes_the_valves_in_time_and_stays(rig: Rig, tmp_path: Path, name: str) -> None:
    disturb, said = FAULTS[name]
    link = rig.link()
    attempt = Attempt(link, constant(), tmp_path)
    attempt.driving(rig)
    broken, rig.disturb = time.monotonic(), disturb(rig)
    attempt.until(lambda: attempt.run.supervisor.state is State.FAULT)
    rig.disturb = lambda numbers: numbers  # all is well again, and it makes no difference
    opened = len(rig.applied)
    attempt.until(lambda: len(rig.applied) > opened + 8)
    cause = attempt.end()
    assert said in cause
    assert attempt.told[-1] == f"fault: {cause}; zero is written until Ctrl-C"
    took = rig.closed_after(broken)
    assert took <= link.stop_s + (link.frozen_after("speed_1") if name == "frozen" else 0.0) + BUSY
    events = (tmp_path / "log_1.jsonl").read_text().splitlines()
    assert json.loads(events[-1])["state"] == "fault" and json.loads(events[-1])["cause"] == cause
    assert read_log(tmp_path / "log_1.csv").command_V[-1].tolist() == [0.0, 0.0]


#: The network makes no difference to these.
over_udp = pytest.mark.parametrize("started", ["udp"], indirect=True)


def failing(n: int) -> Any:
    return np.full(2, 0.15) if n < 10 else 1 / 0


def hanging(n: int) -> Any:
    if n >= 10:
        time.sleep(3.0)
    return np.full(2, 0.15)


@over_udp
@pytest.mark.parametrize(
    ("act", "said"),
    [
        (failing, "ZeroDivisionError"),
        (hanging, "no command within"),
        (lambda n: [0.15, 0.15 if n < 10 else np.nan], "nan], expected two commands that are finite"),
        (lambda n: [0.15, 0.15] if n < 10 else "full", "expected two commands"),
    ],
    ids=["fails", "hangs", "nan", "nonsense"],
)
def test_a_controller_that_fails_closes_the_valves(rig: Rig, tmp_path: Path, act: Any, said: str) -> None:
    moments: list[float] = []

    def noted(n: int, sample: Any, command: Any) -> Any:
        if n >= 10:
            moments.append(time.monotonic())
        return act(n)

    link = rig.link()
    attempt = Attempt(link, Driver(noted, None), tmp_path)
    attempt.driving(rig)
    attempt.until(lambda: attempt.run.supervisor.state is State.FAULT)
    opened = len(rig.applied)
    attempt.until(lambda: len(rig.applied) > opened + 5)
    assert said in attempt.end()
    assert rig.closed_after(moments[0]) <= link.stop_s + BUSY


@over_udp
def test_a_full_disk_closes_the_valves(rig: Rig, tmp_path: Path) -> None:
    attempt = Attempt(rig.link(), constant(), tmp_path)
    attempt.driving(rig)

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    broken, attempt.run.log.row = time.monotonic(), full  # type: ignore[method-assign]
    attempt.until(lambda: attempt.problem is not None)
    opened = len(rig.applied)
    attempt.until(lambda: len(rig.applied) > opened + 5)
    time.sleep(5 * rig.cycle)
    assert isinstance(attempt.problem, OSError)
    assert rig.closed_after(broken) <= rig.link().stop_s + BUSY


@pytest.mark.parametrize("started", ["opcua"], indirect=True)
def test_a_server_that_dies_is_a_fault_and_gets_zero_when_it_is_back(rig: Rig, tmp_path: Path) -> None:
    """What is written cannot arrive meanwhile: there the heartbeat closes the valves."""
    assert isinstance(rig, OpcUaRig)
    attempt = Attempt(rig.link(), constant(), tmp_path)
    attempt.driving(rig)
    broken, rig.alive = time.monotonic(), False
    try:
        attempt.until(lambda: attempt.run.supervisor.state is State.FAULT)
        assert time.monotonic() - broken <= rig.link().stop_s + BUSY
        attempt.until(lambda: not any(rig.applied[-1][1:]))
    finally:
        rig.alive = True
    beat = rig.received["alive"]
    attempt.until(lambda: rig.received["alive"] != beat)
    assert rig.received["u1"] == rig.received["u2"] == 0.0
    assert attempt.end()


@over_udp
def test_an_experiment_is_played_within_the_limits(rig: Rig, tmp_path: Path) -> None:
    table = tmp_path / "next_experiment.csv"
    shares = [0.0, 0.0, 0.1, 0.1, 0.5, 0.5, -0.1, -0.1, 0.0, 0.0]
    rows = [f"{0.1 * n:.1f},{RATED_V[0] * share:.4f},0" for n, share in enumerate(shares)]
    table.write_text("\n".join(["time_s,command_1_V,command_2_V", *rows]) + "\n")
    link = rig.link()
    attempt = Attempt(link, played(table, link, load_model("paper_dead_zone")), tmp_path)
    attempt.until(lambda: False, 20.0)
    assert attempt.end() == ""
    played_shares = read_log(tmp_path / "log_1.csv").command_V / np.array(RATED_V)
    assert {*np.round(played_shares[:, 0], 3)} >= {0.0, 0.1, 0.2, -0.1} and np.abs(
        played_shares
    ).max() <= 0.2 + 1e-6
    assert not played_shares[:, 1].any()

"""The page without a browser: what is chosen on it reaches the session, and the server lets in who may."""

from __future__ import annotations

import asyncio
import http.client
import re
import signal
import subprocess
import sys
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

import pytest
from nicegui import ui
from nicegui.testing import User
from nicegui.testing.user_simulation import user_simulation

from hydro_env.errors import InputError
from hydro_env.lab.elements import SlidingNumber
from hydro_env.lab.server import Lab, run
from hydro_env.lab.worker import Seen
from tests.lab.server import served


def on_the_page(lab: Lab, steps: Callable[[User], Awaitable[None]]) -> None:
    """Opens the page, does the steps on it, and ends the lab."""

    async def act() -> None:
        async with user_simulation(lab.page) as user:
            await user.open("/")
            await steps(user)

    lab.worker.start()
    try:
        asyncio.run(act())
    finally:
        lab.close()


async def until(lab: Lab, true: Callable[[Seen], bool]) -> None:
    for _ in range(1000):
        if true(lab.worker.seen):
            return
        await asyncio.sleep(0.02)
    raise AssertionError(lab.worker.seen)


def slider(user: User, label: str, group: str = "") -> SlidingNumber:
    (found,) = [
        each
        for each in user.find(SlidingNumber).elements
        if (each.props["label"], each.props["group"]) == (label, group)
    ]
    return found


def move(element: SlidingNumber, position: int) -> None:
    """What the browser sends when the slider is moved."""
    (listener,) = element._event_listeners.values()
    element._handle_event({"listener_id": listener.id, "args": position})


def test_choices_reach_the_session(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out")

    async def steps(user: User) -> None:
        choices = {each.props["label"]: each for each in user.find(ui.select).elements}
        choices["controller"].value = "gru"
        await until(lab, lambda seen: seen.session.settings.controller == "gru")
        move(slider(user, "set-point by hand"), 25)
        await until(lab, lambda seen: abs(seen.session.now["speed_1_rpm"] - 250.0) < 20.0)
        await until(lab, lambda seen: choices["set-point"].value == "manual")
        move(slider(user, "load on motor 2"), 40)
        await until(lab, lambda seen: seen.session.load_Nm == (0.0, 0.4))
        choices["preset or model"].value = "servo"
        await until(lab, lambda seen: seen.session.settings.preset == "servo")
        choices["speed of time"].value = 5.0
        await until(lab, lambda seen: seen.tempo == 5.0)
        user.find("Pause").click()
        await until(lab, lambda seen: not seen.running)
        await user.should_see("paused")
        user.find("Reset").click()
        await until(lab, lambda seen: seen.session.time == 0.0)

    on_the_page(lab, steps)


def test_a_model_of_ones_own_is_driven_and_the_sliders_suit_it(tmp_path: Path) -> None:
    lab, path = Lab(tmp_path / "out"), tmp_path / "mine.yaml"
    path.write_text(
        "schema: hydro_env/model/1\nbase: paper\nboth: {D: 7.96e-6, R: 5.0, alpha: 8.0, u_rated: 10.0, Kq: 0.7}\n"
        "effects: {pressure_dependent_flow: {both: {supply_pressure: 120.0e+5}}}\n"
        "sources: {D: sheet, R: sheet, alpha: sheet, Kq: sheet}\n"
    )

    async def steps(user: User) -> None:
        (driver,) = [each for each in user.find(ui.expansion).elements if each.text.startswith("driver")]
        driver.value = True
        await asyncio.sleep(0.1)
        lab.uploads.add(path, "mine.yaml", "model")
        (rig,) = [each for each in user.find(ui.select).elements if each.props["label"] == "preset or model"]
        (model,) = [
            each for each in user.find(ui.select).elements if each.props["label"] == "model to diagnose"
        ]
        for _ in range(200):
            if str(path) in rig.options and model.value == str(path):
                break
            await asyncio.sleep(0.02)
        rig.value = str(path)
        await until(lab, lambda seen: seen.session.settings.preset == str(path))
        assert lab.worker.seen.session.settings.split == "own"
        await user.should_see("with 10 V at the valves", retries=50)
        hand, limit = (
            slider(user, "set-point by hand"),
            slider(user, "channel 1", "limit of the driver's voltage"),
        )
        assert (hand.props["most"], hand.props["text"]) == (78, "0 rpm")
        move(limit, 1)
        assert limit.props["text"] == "10 V"
        move(hand, 30)
        await until(lab, lambda seen: seen.session.now["setpoint_rpm"] == 300.0)

    on_the_page(lab, steps)


def test_effects_are_moved_by_sliders_and_come_back(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out")
    name = "motor_coulomb_friction.coulomb"

    async def steps(user: User) -> None:
        (motor,) = [each for each in user.find(ui.expansion).elements if each.text.startswith("motor")]
        motor.value = True
        await asyncio.sleep(0.1)
        both = [slider(user, f"channel {c}", "Coulomb friction") for c in (1, 2)]
        move(both[1], 50)
        await until(lab, lambda seen: seen.session.effects[name] == (0.0, 1.0))
        assert both[1].props["text"] == "1 N m" and both[0].props["text"] == "0 N m"
        user.find("All as they were").click()
        await until(lab, lambda seen: seen.session.effects[name] == (0.0, 0.0))
        for _ in range(100):
            if both[1].props["text"] == "0 N m":
                return
            await asyncio.sleep(0.05)
        raise AssertionError("the slider did not follow")

    on_the_page(lab, steps)


def test_what_is_refused_is_said_on_the_page(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out")

    async def steps(user: User) -> None:
        lab.worker.ask(lambda session: session.choose_valves("paper_dead_zone", "test_interp", 10**6))
        await until(lab, lambda seen: bool(seen.refused))
        await user.should_see("test_interp", retries=20)
        user.find("Diagnose").click()
        await user.should_see("no log to fit", retries=20)

    on_the_page(lab, steps)


def test_a_recorded_log_is_listed_and_looked_at(tmp_path: Path) -> None:
    lab = Lab(tmp_path / "out")
    lab.worker.set_tempo(5.0)

    async def steps(user: User) -> None:
        user.find("Record a log, from rest").click()
        await until(lab, lambda seen: (seen.session.recorded or 0.0) > 3.0)
        await user.should_see("Stop recording", retries=20)
        user.find("Stop recording").click()
        await user.should_see("log_1.csv", retries=50)
        user.find("Look at the log").click()
        await user.should_see("nothing suspicious found", retries=600)

    on_the_page(lab, steps)
    assert (tmp_path / "out" / "log_1.csv").read_text().startswith("time_s,setpoint_rpm,command_1_V")


def test_a_log_that_cannot_be_written_is_said_and_the_rig_runs_on(tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    lab = Lab(tmp_path / "out")

    async def steps(user: User) -> None:
        user.find("Record a log, from rest").click()
        await until(lab, lambda seen: (seen.session.recorded or 0.0) > 0.1)
        await user.should_see("Stop recording", retries=100)
        user.find("Stop recording").click()
        await until(lab, lambda seen: "was not written" in seen.refused)
        time = lab.worker.seen.session.time
        await until(lab, lambda seen: seen.session.time > time)

    on_the_page(lab, steps)


# --- the server -------------------------------------------------------------------------------------------------------
def ask(
    port: int, path: str, method: str = "GET", body: bytes | None = None, **headers: str
) -> tuple[int, str, str]:
    """Status, cookie and text."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=30)
    connection.request(method, path, body, {name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    text = answer.read().decode("utf-8", "replace")
    connection.close()
    return answer.status, (answer.getheader("set-cookie") or "").partition(";")[0], text


def test_the_server_lets_in_who_may_and_ends_cleanly(tmp_path: Path) -> None:
    out, temporary = tmp_path / "out", tmp_path / "temporary"
    with served(out, temporary) as (process, port, key):
        assert ask(port, "/")[0] == 403
        assert ask(port, f"/?key={key}", Host="evil.example")[0] == 403
        status, cookie, _ = ask(port, f"/?key={key}")
        assert status == 303
        status, _, page = ask(port, "/", Cookie=cookie)
        assert status == 200 and "hydro_env lab" in page
        assert not re.search(r"(src|href)=[\"']?(https?:)?//", page)
        upload = "/upload?name=a.csv"
        assert ask(port, upload, "POST", b"1", Cookie=cookie, Origin="http://evil.example")[0] == 403
        assert ask(port, upload, "POST", b"1", Cookie=cookie)[0] == 200
        status, _, text = ask(port, "/upload?name=a.pkl", "POST", b"1", Cookie=cookie)
        assert status == 400 and "expected a log" in text
        (tmp_path / "secret").write_text("a secret")
        out.mkdir()
        (out / "own.txt").write_text("a secret")
        for path in (
            "diagnosis_1/report.html",
            "..%2fsecret",
            "..%2fout/own.txt",
            "diagnosis_1/..%2fown.txt",
            "./own.txt",
        ):
            assert "a secret" not in ask(port, f"/results/{path}", Cookie=cookie)[2]
        assert ask(port, "/results/diagnosis_1/report.html", Cookie=cookie)[0] == 404
        assert len(list(temporary.rglob("*.csv"))) == 1
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
        assert process.returncode in (0, 130) and "Traceback" not in said
    assert not any(temporary.glob("hydro_env_lab_*")) and [path.name for path in out.iterdir()] == ["own.txt"]


def test_a_taken_port_is_one_line(tmp_path: Path) -> None:
    with served(tmp_path / "out", tmp_path / "temporary") as (_, port, _key):
        command = [
            sys.executable,
            "-m",
            "hydro_env",
            "lab",
            "--no-browser",
            "--port",
            str(port),
            "--out",
            str(tmp_path),
        ]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and f"--port {port}" in done.stderr


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write there"):
        run(tmp_path / "file" / "out")


@pytest.mark.parametrize("signals", [(signal.SIGINT, signal.SIGINT), (signal.SIGTERM,), (signal.SIGHUP,)])
def test_nothing_is_left_however_it_is_ended(tmp_path: Path, signals: tuple[signal.Signals, ...]) -> None:
    temporary = tmp_path / "temporary"
    with served(tmp_path / "out", temporary) as (process, _, _key):
        for each in signals:
            process.send_signal(each)
            time.sleep(0.05)
        _, said = process.communicate(timeout=60)
        assert process.returncode in (0, 130) and "Traceback" not in said
    assert not any(temporary.glob("hydro_env_lab_*"))

"""Link files: what they mean, and one line for whatever is wrong with them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_env.errors import InputError
from hydro_env.live.driver import controlled, played
from hydro_env.live.link import Link, load_link
from hydro_env.live.log import Followed, Log, newest_log
from hydro_env.plant import load_model
from tests.live.test_supervisor import link as described

GOOD: dict[str, Any] = {
    "schema": "hydro_env/link/1", "protocol": "udp", "address": "192.168.0.10:5005", "listen": "0.0.0.0:5006",
    "cycle_s": 0.01, "watchdog_s": 0.1, "count": "n",
    "channel_1": {"command": {"name": "u1", "rated": 10, "sign": -1},
                  "speed": {"name": "n1", "unit": "rpm", "range": [-900, 900]}},
    "channel_2": {"command": {"name": "u2", "rated": 100}, "speed": {"name": "n2", "unit": "Hz", "sign": -1, "range": [-15, 15]}},
}  # fmt: skip


def test_units_and_signs_are_those_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "link.yaml"
    path.write_text(yaml.safe_dump(GOOD | {"time": {"name": "t", "unit": "ms"}}))
    link = load_link(path)
    sample = link.sample({"n": 5, "t": 250, "n1": 60, "n2": -1.0})
    assert sample.number == 5 and sample.time == 0.25
    assert sample.values == pytest.approx({"speed_1": 2 * math.pi, "speed_2": 2 * math.pi})
    assert link.outputs((0.5, 0.5), 1) == {"u1": -5.0, "u2": 50.0}
    assert math.isnan(link.sample({"n1": True}).values["speed_1"]) and math.isnan(
        link.sample({}).values["speed_1"]
    )


def channel(**changed: Any) -> Any:
    return {"channel_1": GOOD["channel_1"] | changed}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "hydro_env/link/2"}, "should be 'hydro_env/link/1'"),
        ({"protocol": "modbus"}, "protocol is 'modbus', should be 'udp' or 'opcua'"),
        ({"address": "192.168.0.10"}, "should be HOST:PORT"),
        ({"protocol": "opcua"}, "should begin with opc.tcp://"),
        ({"watchdog_s": 0.02}, "at least three times cycle_s"),
        ({"command_limit_percent": 60}, "command_limit_percent is 60, should be less than or equal to 20"),
        ({"count": ""}, "count is missing"),
        ({"cycel_s": 0.01}, "did you mean 'cycle_s'?"),
        ({"heartbeat": "n1"}, "the name 'n1' stands for two things"),
        (channel(speed={"name": "n1", "unit": "rpm"}), "channel_1: speed.range is missing"),
        (channel(pressure={"name": "p", "unit": "rpm"}), "pressure: rpm is a unit of angular speed; use bar"),
        (channel(pressure={"name": "p", "unit": "baar"}), "unknown unit 'baar'"),
        ({"channel_1": {"command": {"name": "u1", "rated": 0}}}, "channel_1.command.rated is 0, should be greater than 0"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(tmp_path: Path, change: Any, said: str) -> None:
    path = tmp_path / "link.yaml"
    path.write_text(yaml.safe_dump(GOOD | change))
    with pytest.raises(InputError, match=r"link\.yaml: ") as problem:
        load_link(path)
    assert said in str(problem.value)


MODEL = load_model("paper_dead_zone")


def bare() -> Link:
    return Link.model_validate({key: value for key, value in GOOD.items() if key != "schema"})


def test_a_controller_is_refused_that_reads_what_the_rig_lacks() -> None:
    with pytest.raises(InputError, match=r"gru reads current_1, .*pressure_1.*, which the link file lacks"):
        controlled("gru", bare(), MODEL, "sine", (0.2, 2.0))
    controlled("pid_tuned", bare(), MODEL, "sine", (0.2, 2.0))


def test_what_cannot_be_driven_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="needs the loads to come"):
        controlled("oracle", bare(), MODEL, "sine", (0.2, 2.0))
    with pytest.raises(InputError, match="no set-point"):
        controlled("pid_tuned", bare(), MODEL, None, (0.2, 2.0))
    profile = tmp_path / "profile.yaml"
    profile.write_text("{steps: [], duration: 20}")
    with pytest.raises(InputError, match=r"profile\.yaml: .*unknown key 'steps'"):
        controlled("pid_tuned", bare(), MODEL, str(profile), (0.2, 2.0))
    own = tmp_path / "own.py"
    own.write_text(
        "class Own:\n    def reset(self, n, period): ...\n    def act(self, observation):\n        return 1 / 0\n"
    )
    with pytest.raises(InputError, match="fails on a rig at rest: ZeroDivisionError"):
        controlled(f"{own}:Own", bare(), MODEL, "sine", (0.2, 2.0))
    table = tmp_path / "played.csv"
    table.write_text("time_s,command_1_V,load_1_Nm\n0,0,0\n0.1,1,0.5\n")
    with pytest.raises(InputError, match="has loads, which a link cannot set"):
        played(table, bare(), MODEL)


def test_a_controller_knows_its_limits() -> None:
    """Set-points out of reach wind nothing up: as soon as they are within reach, the command leaves its limit."""
    sample = described().sample({"n": 1, "t": 0.0})

    def later(allowed: tuple[float, float]) -> np.ndarray:
        driver = controlled("pid_tuned:Kp=0.05,Td=0", described(), MODEL, "setpoint_steps", allowed)
        at_rest, fast = (sample._replace(values=dict.fromkeys(described().inputs, v)) for v in (0.0, 63.5))
        wanted = [driver.act(n, each, np.full(2, 0.1)) for n, each in enumerate([at_rest] * 100 + [fast] * 5)]
        return np.ravel(wanted[-1])

    assert later((0.1, 2.0)).max() < 0.1
    assert later((1.0, math.inf)).min() > 0.1


def test_a_log_can_be_followed_while_it_grows(tmp_path: Path) -> None:
    log = Log(tmp_path, described().inputs, (73.0, 73.0))
    followed = Followed(log.path, ("time_s", "speed_1_rpm", "command_2_V", "nothing"), most=3)
    followed.look()
    for n in range(5):
        log.row(0.01 * n, np.array([0.0, 0.5]), {"speed_1": n * math.pi / 30, "speed_2": math.nan})
    log.row(0.04, np.zeros(2), {})  # no later than the last
    log.event(state="fault", cause="x")
    followed.look()
    assert followed.rows[:, :3].tolist() == [[0.02, 2.0, 36.5], [0.03, 3.0, 36.5], [0.04, 4.0, 36.5]]
    assert np.isnan(followed.rows[:, 3]).all() and followed.events == {"state": "fault", "cause": "x"}
    log.row(0.06, np.zeros(2), {})
    followed.look()
    assert followed.rows[-1, 0] == 0.06 and newest_log(tmp_path) == log.path
    other = Log(tmp_path, described().inputs, (73.0, 73.0))
    assert newest_log(tmp_path) == other.path == tmp_path / "log_2.csv"
    log.close(), other.close()

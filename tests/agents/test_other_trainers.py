"""The script of docs/howto/use_another_trainer.md for sb3-contrib, with few control periods, and the agent it saves."""

import re
from pathlib import Path

import numpy as np
import pytest

from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out

pytest.importorskip("sb3_contrib")

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "use_another_trainer.md"


def test_its_script_trains_an_agent_that_drives(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.S)
    (script,) = [block for block in blocks if "sb3_contrib" in block]
    for number, fewer in (("500_000", "1024"), ("25_600", "512")):
        assert script.count(number) == 1
        script = script.replace(number, fewer)
    exec(compile(script, PAGE.name, "exec"), {"__name__": "script"})
    course = {"duration": 0.2, "setpoint_rpm": [[0.0, 300.0]]}
    driven = roll_out(
        make_controller("tqc.zip:increment=0.3", trust=True), [5], mismatch="val", scenario=course
    )
    assert np.isfinite(driven.returns).all() and np.ptp(driven.trace.command) > 0.0

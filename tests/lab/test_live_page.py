"""The page that follows a run of `hydro-env live`."""

from __future__ import annotations

import asyncio
import os
from pathlib import Path

import numpy as np
import pytest
from nicegui.testing import User
from nicegui.testing.user_simulation import user_simulation

from hydro_env.errors import InputError
from hydro_env.lab.live_page import LivePage
from hydro_env.live.log import Log


def test_it_shows_state_signals_and_fault_of_the_newest_log(tmp_path: Path) -> None:
    async def act() -> None:
        async with user_simulation(LivePage(tmp_path).page) as user:
            user: User
            await user.open("/")
            await user.should_see("yet", retries=20)
            Log(tmp_path, ["speed_1"], (10.0, 10.0)).close()
            log = Log(tmp_path, ["speed_1", "speed_2", "pressure_1"], (10.0, 10.0))
            log.row(0.0, np.array([0.1, 0.0]), {"speed_1": 10.4719755, "speed_2": 0.0, "pressure_1": 5e5})
            log.event(state="running", cause="")
            await user.should_see("log_2.csv: running", retries=20)
            await user.should_see("speed_1_rpm 100", retries=20)
            await user.should_see("command_1_V 1")
            log.event(state="fault", cause="speed_1 is frozen")
            await user.should_see("speed_1 is frozen", retries=20)
            os.utime(log.path, (0, 0))
            await user.should_see("no new row for", retries=20)
            log.close()

    asyncio.run(act())


def test_a_folder_that_is_not_there_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder; name the --out of `hydro-env live`"):
        LivePage(tmp_path / "nowhere")

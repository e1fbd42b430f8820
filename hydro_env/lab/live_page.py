"""The page of a run of `hydro-env live`: it follows the newest log of a folder, and can change nothing."""

import time
from pathlib import Path

import numpy as np
from fastapi import FastAPI
from nicegui import ui

from hydro_env.arrays import Floats
from hydro_env.errors import InputError
from hydro_env.lab.elements import EVERY, Plots
from hydro_env.lab.page import PICTURE, section
from hydro_env.lab.session import COLUMNS, SHOWN
from hydro_env.live.log import Followed, newest_log
from hydro_env.measured.mapping import contract_columns

#: Seconds without a new row after which the page says so.
QUIET = 2.0


class LivePage:
    """What the server shows in the place of a rig of its own. InputError for a folder that is not there."""

    def __init__(self, folder: Path) -> None:
        if not folder.is_dir():
            raise InputError(f"--live {folder}: no such folder; name the --out of `hydro-env live`")
        self.told = f"Follows the newest log in {folder}."
        self._folder = folder

    def start(self) -> None:
        """Nothing: the run is another program's."""

    def add_routes(self, app: FastAPI) -> None:
        """None: nothing can be sent."""

    def close(self) -> None:
        """Nothing."""

    def page(self) -> None:
        """Builds the page for a browser."""
        log: Followed | None = None
        with ui.element("main").classes("lab"), ui.element("div").style("grid-column: 1 / -1"):
            with section("Live rig"):
                state = ui.label().classes("lab-big").props('role=status aria-live="polite"')
                fault = ui.label().classes("lab-bad").props("role=alert")
                numbers = ui.label().classes("lab-soft")
            with section("Last seconds"):
                plots = Plots()

        def look() -> None:
            """Reads on, and shows it."""
            nonlocal log
            path = newest_log(self._folder)
            if path is None:
                state.text = f"no log in {self._folder} yet"
                return
            if log is None or log.path != path:
                log = Followed(path, tuple(contract_columns()), EVERY * SHOWN)
            log.look()
            age = time.time() - path.stat().st_mtime
            quiet = f"; no new row for {age:.0f} s" if age > QUIET else ""
            state.text = f"{path.name}: {log.events.get('state', 'begins')}{quiet}"
            fault.text = str(log.events.get("cause", ""))
            if len(log.rows):
                newest = zip(contract_columns(), log.rows[-1], strict=True)
                numbers.text = ", ".join(
                    f"{name} {value:.4g}" for name, value in newest if not np.isnan(value)
                )
                plots.draw(_past(log.rows))

        ui.timer(2.0 * PICTURE, look)


def _past(rows: Floats) -> Floats:
    """Rows of a log as the plots take them."""
    at = {name: rows[:, n] for n, name in enumerate(contract_columns())}
    at["difference_rpm"] = at["speed_1_rpm"] - at["speed_2_rpm"]
    return np.column_stack([at[name] for name in COLUMNS])

"""The page of a run of `hydro-env live`: it follows the newest log of a folder, and can change nothing."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
from fastapi import FastAPI
from nicegui import ui
from numpy.typing import NDArray

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
        _View(self._folder)


class _View:
    """What one browser sees."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._log: Followed | None = None
        with ui.element("main").classes("lab"), ui.element("div").style("grid-column: 1 / -1"):
            with section("Live rig"):
                self._state = ui.label().classes("lab-big").props('role=status aria-live="polite"')
                self._fault = ui.label().classes("lab-bad").props("role=alert")
                self._numbers = ui.label().classes("lab-soft")
            with section("Last seconds"):
                self._plots = Plots()
        ui.timer(2.0 * PICTURE, self._look)

    def _look(self) -> None:
        """Reads on, and shows it."""
        path = newest_log(self._folder)
        if path is None:
            self._state.text = f"no log in {self._folder} yet"
            return
        if self._log is None or self._log.path != path:
            self._log = Followed(path, tuple(contract_columns()), EVERY * SHOWN)
        self._log.look()
        events, age = self._log.events, time.time() - path.stat().st_mtime
        quiet = f"; no new row for {age:.0f} s" if age > QUIET else ""
        self._state.text = f"{path.name}: {events.get('state', 'begins')}{quiet}"
        self._fault.text = str(events.get("cause", ""))
        rows = self._log.rows
        if len(rows):
            newest = zip(contract_columns(), rows[-1], strict=True)
            self._numbers.text = ", ".join(
                f"{name} {value:.4g}" for name, value in newest if not np.isnan(value)
            )
            self._plots.draw(_past(rows))


def _past(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows of a log as the plots take them."""
    at = {name: rows[:, n] for n, name in enumerate(contract_columns())}
    at["difference_rpm"] = at["speed_1_rpm"] - at["speed_2_rpm"]
    return np.column_stack([at[name] for name in COLUMNS])

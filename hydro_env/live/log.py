"""What a run leaves in its folder: `log_N.csv`, a rig log, and `log_N.jsonl`, one line for whatever else happened.

Both are written row by row, so that they are whole after a kill.
"""

from collections.abc import Iterable, Mapping
from itertools import count
from pathlib import Path
from typing import IO, Any

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.files import to_json
from hydro_env.measured.mapping import contract_columns
from hydro_env.reading import parse_json
from hydro_env.units import from_si


class Log:
    """Writes both files. `signals`: keys of what is logged beside the commands; `rated_V` (2,): what a command of 1 is."""

    def __init__(self, folder: Path, signals: Iterable[str], rated_V: tuple[float, float]) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        number = next(n for n in count(1) if not (folder / f"log_{n}.csv").exists())
        self.path = folder / f"log_{number}.csv"
        self._rated, keys = np.array(rated_V), {"command_1", "command_2", *signals}
        self._columns = {  # with their units, by key ("speed_1")
            key: (column, symbol)
            for column, (signal, c, symbol) in contract_columns().items()
            if (key := signal if c is None else f"{signal}_{c + 1}") in keys
        }
        self._rows: IO[str] = open(self.path, "x", encoding="utf-8", newline="\n", buffering=1)  # noqa: SIM115
        self._events: IO[str] = open(self.path.with_suffix(".jsonl"), "w", encoding="utf-8", buffering=1)  # noqa: SIM115
        self._rows.write(",".join(["time_s", *(name for name, _ in self._columns.values())]) + "\n")
        self._last = -np.inf

    def row(self, time: float, command: Floats, values: Mapping[str, float]) -> None:
        """What was seen at a time, s, in SI, and the commands (2,) since, as shares. A row that is not later than the last
        is left out."""
        if not time >= self._last + 1e-6:
            return
        self._last = time
        volts = command * self._rated
        values = {**values, "command_1": float(volts[0]), "command_2": float(volts[1])}
        cells = [from_si(values.get(key, np.nan), symbol) for key, (_, symbol) in self._columns.items()]
        text = ",".join("" if np.isnan(cell) else f"{cell:.7g}" for cell in cells)
        self._rows.write(f"{time:.6f},{text}\n")

    def event(self, **what: Any) -> None:
        """A line with whatever happened."""
        self._events.write(to_json(what) + "\n")

    def close(self) -> None:
        """Closes the files."""
        self._rows.close()
        self._events.close()


def newest_log(folder: Path) -> Path | None:
    """The log that was begun last in a folder."""
    numbers = [int(path.stem[4:]) for path in folder.glob("log_*.csv") if path.stem[4:].isdecimal()]
    return folder / f"log_{max(numbers)}.csv" if numbers else None


class Followed:
    """A log that grows, as it is read again and again: `rows` (n, columns) are the last `most`, NaN where a cell is blank, and
    `events` what happened, merged: the newest value of each key."""

    def __init__(self, path: Path, columns: tuple[str, ...], most: int) -> None:
        self.path, self.columns, self.most = path, columns, most
        self.rows: Floats = np.zeros((0, len(columns)))
        self.events: dict[str, Any] = {}
        self._read = {path: 0, path.with_suffix(".jsonl"): 0}
        self._places: list[int] = []

    def look(self) -> None:
        """Reads what has been written since."""
        lines = self._lines(self.path)
        if lines and not self._places:
            header = lines.pop(0).split(",")
            self._places = [header.index(name) if name in header else -1 for name in self.columns]
        cells = [[*line.split(","), ""] for line in lines[-self.most :]]
        new = [[float(row[place] or "nan") for place in self._places] for row in cells]
        if new:
            self.rows = np.vstack([self.rows, new])[-self.most :]
        for line in self._lines(self.path.with_suffix(".jsonl")):
            self.events |= parse_json(line, str(self.path))

    def _lines(self, path: Path) -> list[str]:
        """The whole lines of a file that are new."""
        with open(path, "rb") as file:
            file.seek(self._read[path])
            whole = file.read().rpartition(b"\n")[0]
        self._read[path] += len(whole) + bool(whole)
        return whole.decode("utf-8", "replace").splitlines()

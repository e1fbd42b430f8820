"""A log of the session as it would come from a rig: columns, noise and resolution of the practice logs, at 1 kHz."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_env.envs.observation import Floats
from hydro_env.lab.rig import PERIOD, RECORDED, SAMPLES
from hydro_env.plant import Scales
from hydro_env.practice.recorder import COLUMNS, SENSORS, columns_of, log_text

#: Seconds after which a recording ends by itself.
MAX_SECONDS = 120.0

_READ = {sensor.signal: name for name, sensor in SENSORS.items() if sensor.signal in RECORDED}
#: Where `LiveRig.noise` has each sensor.
_NOISE = {"measured_speed": slice(0, 2), "current": slice(2, 4), "pressure": slice(4, 6)}


class Recording:
    """Rows of a log, a control period at a time. The readings that a controller got stand in the first row of each."""

    def __init__(self, seed: int, scales: Scales) -> None:
        self._columns = columns_of(scales)
        self._stream = np.random.default_rng(seed)
        self._periods: list[dict[str, Floats]] = []

    @property
    def seconds(self) -> float:
        """How long it is, s."""
        return len(self._periods) * PERIOD

    def add(
        self, setpoint_rpm: float, command_V: Floats, load_Nm: Floats, noise: Floats, signals: Mapping[str, Floats]
    ) -> None:  # fmt: skip
        """Adds a control period: what was in force, (2,) each, the sensors' noise at its beginning (6,), and what
        `LiveRig.hold` recorded."""
        rows = {"setpoint": np.full((SAMPLES, 1), setpoint_rpm)}
        rows |= {"command": np.tile(command_V, (SAMPLES, 1)), "load": np.tile(load_Nm, (SAMPLES, 1))}
        for name in RECORDED:
            sensor = self._columns[_READ[name]]
            errors = self._stream.standard_normal((SAMPLES, 2))
            errors[0] = noise[_NOISE[name]]
            shown = signals[name] / sensor.size + sensor.noise * errors
            rows[_READ[name]] = np.round(shown / sensor.resolution) * sensor.resolution
        self._periods.append(rows)

    def text(self) -> str:
        """The log as CSV."""
        rows = {name: np.vstack([period[name] for period in self._periods]) for name in self._periods[0]}
        setpoint = rows.pop("setpoint")[:, 0]
        columns = {"time_s": np.arange(len(setpoint)) * PERIOD / SAMPLES, "setpoint_rpm": setpoint}
        for c in (0, 1):
            columns |= {f"{n}_{c + 1}_{COLUMNS[n].unit}": values[:, c] for n, values in rows.items()}
        return log_text(columns, self._columns)

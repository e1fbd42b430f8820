"""The rig that plays a manoeuvre, its speed controllers, its sensors, and the log that they leave.

Commands change once in a control period of 10 ms; the log may be faster. Noise is that of `plant.sensors`; the recorded
values are rounded to the resolution of each sensor. Sensors are those for the range of the rig: noise and resolution, as the
set-points and loads of a manoeuvre, grow with it (`plant.scales`).
"""

import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Bools, Floats
from ..errors import InputError
from ..measured.mapping import contract_columns
from ..plant import Plant, PlantModel, Scales, scales_of
from ..plant.scales import PAPER, rated, swing
from ..plant.sensors import NOISE
from ..units import BAR, LPM, MILLIMETRE, RPM
from .manoeuvres import Plan, plans
from .reference import ReferenceRig
from .reference.forms import OF_BOTH_LINES, Constants

CONTROL_PERIOD = 0.01  # s
#: Time from standstill to the full command for which manoeuvres are long enough, s: about as long as they hold a step; and how
#: many times as long they last at most where it takes longer: a round of two minutes.
REACH, LONGEST = 0.25, 10.0
#: Pressure above the tank's that no oil falls below, Pa.
_VACUUM = -101325.0
#: Forms of a rig that the compiled plant plays, with the laws of the catalogue.
CATALOGUE_FORMS = "catalogue"


@dataclass(frozen=True)
class Column:
    """A quantity of the log: the unit of its columns and their decimals. Of what a sensor shows also the simulator's signal, the
    size of the unit in SI, and the sensor's noise and resolution in that unit."""

    unit: str
    decimals: int
    signal: str = ""
    size: float = 1.0
    noise: float = 0.0
    resolution: float = 0.0


#: Columns of a log by the first words of their names; those of a channel in their order.
COLUMNS = {
    "time": Column("s", 6),
    "setpoint": Column("rpm", 1),
    "command": Column("V", 3),
    "current": Column("A", 4, "current", 1.0, NOISE["current_A"], 0.0005),
    "pressure": Column("bar", 2, "pressure", BAR, NOISE["pressure_bar"], 0.01),
    "speed": Column("rpm", 1, "measured_speed", RPM, NOISE["speed_rpm"], 0.1),
    "load": Column("Nm", 3),
    "spool": Column("mm", 4, "spool", MILLIMETRE, NOISE["spool_mm"], 0.0005),
    "flow": Column("lpm", 2, "flow", LPM, NOISE["flow_lpm"], 0.01),
    "pressure_a": Column("bar", 2, "pressure_a", BAR, NOISE["pressure_bar"], 0.01),
    "pressure_b": Column("bar", 2, "pressure_b", BAR, NOISE["pressure_bar"], 0.01),
    "motor_pressure": Column("bar", 2, "motor_pressure", BAR, NOISE["pressure_bar"], 0.01),
}
#: What the units of columns measure, by which they grow with a rig; a command is written alike on every one.
_MEASURES = {"rpm": "rad/s", "A": "A", "bar": "Pa", "Nm": "N m", "mm": "m", "lpm": "m3/s"}
SENSORS = {name: column for name, column in COLUMNS.items() if column.signal}
#: What may be recorded besides time, command and speed: columns by the name under which they are asked for.
RECORDABLE: dict[str, tuple[str, ...]] = {
    name: (name,) for name in ("setpoint", "current", "pressure", "load", "spool", "flow", "motor_pressure")
}
RECORDABLE["line_pressures"] = ("pressure_a", "pressure_b")


def columns_of(scales: Scales) -> dict[str, Column]:
    """The columns of a log of a rig of this size."""
    found = {}
    for name, column in COLUMNS.items():
        factor = scales.factor(_MEASURES.get(column.unit, ""))
        decimals = column.decimals + max(0, math.ceil(-math.log10(factor)))
        noise, resolution = factor * column.noise, factor * column.resolution
        found[name] = replace(column, decimals=decimals, noise=noise, resolution=resolution)
    return found


class _CatalogueRig:
    """The compiled plant in the place of a `ReferenceRig`."""

    def __init__(self, model: PlantModel) -> None:
        self.plant = Plant(model)
        lines = ("pressure_a", "pressure_b")
        self.names = [*(s.signal for s in SENSORS.values() if s.signal not in lines), "mean_line_pressure"]

    def signals(self) -> dict[str, Floats]:
        return {name: self.plant.get(name)[0] for name in self.names}

    def advance(self, command_V: Floats, load_Nm: Floats, duration: float, samples: int) -> dict[str, Floats]:
        command, load = np.tile(command_V, (samples, 1)), np.tile(load_Nm, (samples, 1))
        rows = self.plant.run(command, load, duration / samples, self.names)
        if lost := self.plant.lost:
            raise InputError(f"{lost[0]}; take smaller effects")
        end = self.signals()
        return {name: np.vstack([rows[name][1:, 0], end[name]]) for name in self.names}


def _with_lines(signals: dict[str, Floats], level: Floats) -> dict[str, Floats]:
    """The signals with the pressures of both lines above the tank's, Pa. The simulator knows no cavitation: where a line would be
    below vacuum it does not know what a sensor shows, NaN."""
    mean, half = level + signals["mean_line_pressure"], 0.5 * signals["pressure"]
    lines = {"pressure_a": mean + half, "pressure_b": mean - half}
    return signals | {name: np.where(line < _VACUUM, np.nan, line) for name, line in lines.items()}


@dataclass(frozen=True)
class _Motor:
    """A motor behind its valve, linearised: its `full` speed at the rated command without load, rpm, the square of the frequency
    at which it swings on its lines, (rad/s)2, and how fast that decays, 1/s.

    `ramp` is the time from standstill to the full command, s, in which the lines stay between tank and supply: three times what
    the supply takes to bring it up to speed, and a swing; none where its leakage holds the pressure below the supply's. It is
    what an engineer sets at the amplifier. As a run has to end, it has a longest value."""

    full: float
    swing: float
    decay: float
    ramp: float

    @classmethod
    def of(cls, given: PlantModel, channel: int) -> "_Motor":
        D, J, Km = (given.value(name, channel) for name in ("D", "J", "Km"))
        at = rated(given, channel)
        square, decay = swing(given, channel)
        start = J * at["flow"] / (D**2 * at["pressure"])
        once = 0.0 if decay > 2.0 * math.sqrt(square) else 2.0 * math.pi / math.sqrt(square)
        leaks = at["flow"] < Km * at["pressure"]
        ramp = 0.0 if leaks else min(LONGEST * REACH, max(3.0 * start, once))
        return cls(at["flow"] / at["displacement"] / RPM, square, decay, ramp)


def _motors(given: PlantModel) -> list[_Motor]:
    """The motors of a rig that is not of the paper's size; none else, as nothing has to be slower or weaker there."""
    own_size = replace(scales_of(given), command=1.0) != PAPER
    return [_Motor.of(given, channel) for channel in (0, 1)] if own_size else []


def stretch_of(given: PlantModel) -> float:
    """How many times as long manoeuvres last on a rig as on the paper's, so that its ramps reach what they are to reach."""
    return max([1.0, *(motor.ramp / REACH for motor in _motors(given))])


class _SpeedLoop:
    """The PI controllers of the rig: the paper's V1 gains, scaled to the flow gain of the given model. A rig of another size has
    gains of its own: its integral acts so slowly that neither a motor that swings on its lines nor the spool is excited, and the
    command that the model needs for the set-point goes ahead."""

    def __init__(self, given: PlantModel, period: float) -> None:
        self.gain = 0.016 * 476106e-6 / np.array(given.pair("Kq"))  # V/rpm
        self.reset_time, self.period = np.full(2, 0.156), period  # s
        self.limit = np.array(given.pair("u_rated"))
        # The sum of errors, rpm s, and the command ahead of the loop in V by rpm of the set-point and for its sign.
        self.sum, self.slope, self.edge = np.zeros((3, 2))
        for c, motor in enumerate(_motors(given)):
            at = rated(given, c)
            spool = math.sqrt(given.value("k", c) / given.value("m", c))  # rad/s
            self.slope[c] = at["command"] / motor.full
            self.edge[c] = at["command"] * given.value("dead_zone.overlap_positive", c) / at["travel"]
            integral = min(4.0, max(0.1, 0.25 * motor.decay), 0.1 * spool)  # 1/s
            self.reset_time[c] = min(max(motor.decay / motor.swing, 0.02), 0.5)
            self.gain[c] = self.slope[c] * integral * self.reset_time[c]

    def __call__(self, setpoint: Floats, speed: Floats) -> Floats:
        error = setpoint - speed
        wanted = self.gain * (error + self.sum / self.reset_time)
        wanted = wanted + self.slope * setpoint + self.edge * np.sign(setpoint)
        given = np.clip(wanted, -self.limit, self.limit)
        grows = (wanted == given) | ~(error * wanted > 0.0)
        self.sum = np.where(grows, self.sum + error * self.period, self.sum)
        return given


@dataclass(frozen=True)
class Recorder:
    """Logs runs of one rig.

    given, true  the model an engineer has, to which the speed controllers are set, and the rig
    forms        of the effects: `CATALOGUE_FORMS`, or one of `reference.FORMS` with its `constants`
    record       signals besides time, command and speed, of `RECORDABLE`; without "load" none is applied
    noise        factor on the sensors' noise; 0: no noise and no quantisation
    rate         rows per second
    duration     of a log, s
    """

    given: PlantModel
    true: PlantModel
    forms: str
    constants: Constants | None
    record: Sequence[str]
    noise: float
    rate: float
    duration: float

    def log(self, run: str, seeds: np.random.SeedSequence) -> dict[str, Floats]:
        """Drives one of `manoeuvres.RUNS` and returns the log's columns by header name."""
        plan_seed, noise_seed = seeds.spawn(2)
        steps, scales = max(1, round(self.duration / self.period)), scales_of(self.given)
        every = plans(run, plan_seed, self.period / stretch_of(self.given), steps)
        found = [p.scaled(scales.speed, scales.torque) for p in every]
        if motors := _motors(self.given):
            step, full = self.period / max(1e-9, *(m.ramp for m in motors)), min(m.full for m in motors)
            found = [p.ramped(step, step * full) for p in found]
        return self.played(found, noise_seed)

    @property
    def period(self) -> float:
        """Time between two commands, s."""
        return max(CONTROL_PERIOD, 1.0 / self.rate)

    def played(self, channels: Sequence[Plan], noise_seed: np.random.SeedSequence) -> dict[str, Floats]:
        """Drives the plan of each channel and returns the log's columns by header name."""
        period = self.period
        samples = round(period * self.rate)
        steps = len(channels[0].value)
        value, closed, load = (np.column_stack(each) for each in zip(*channels, strict=True))
        of = columns_of(scales_of(self.given))
        load = load.round(of["load"].decimals)
        if "load" not in self.record:  # a load that nobody logs would be a second hidden effect
            load = np.zeros_like(load)
        # Every signal has a stream of its own: recording more of them changes none.
        streams = dict(zip(SENSORS, noise_seed.spawn(len(SENSORS)), strict=True))
        errors = {
            n: self.noise * of[n].noise * np.random.default_rng(s).standard_normal((steps * samples, 2))
            for n, s in streams.items()
        }
        command, shown = self._drive(value, closed, load, errors["speed"][::samples, :], period, samples)
        rows: dict[str, Floats] = {
            "command": np.repeat(command, samples, axis=0),
            "load": np.repeat(load, samples, axis=0),
            **{n: self._read(of[n], shown[n], errors[n]) for n in SENSORS},
        }
        columns = {"time_s": np.arange(steps * samples) / self.rate}
        if "setpoint" in self.record:
            setpoint = np.where(closed, value, 0.0)[:, 0]
            columns["setpoint_rpm"] = np.round(np.repeat(setpoint, samples), of["setpoint"].decimals)
        asked = {"command", "speed", *(n for name in self.record for n in RECORDABLE[name])}
        kept = {n: column.unit for n, column in COLUMNS.items() if n in rows and n in asked}
        return columns | {f"{n}_{c + 1}_{unit}": rows[n][:, c] for c in (0, 1) for n, unit in kept.items()}

    def _level(self) -> Floats:
        """What the simulator's mean line pressure is above, (2,) in Pa: half the supply's where the model has none."""
        without = np.isinf(self.true.pair("pressure_dependent_flow.supply_pressure"))
        supply = np.array(self.true.pair(f"{OF_BOTH_LINES[-1]}.supply_pressure"))
        for name in OF_BOTH_LINES[-2::-1]:
            acts = np.array(self.true.pair(f"{name}.conductance")) != 0.0
            supply = np.where(acts, self.true.pair(f"{name}.supply_pressure"), supply)
        return np.where(without, 0.5 * supply, 0.0)

    def _drive(
        self, value: Floats, closed: Bools, load: Floats, speed_error: Floats, period: float, samples: int
    ) -> tuple[Floats, dict[str, Floats]]:  # fmt: skip
        """Command (steps, 2) in V and what each sensor sees, (steps * samples, 2) in SI without noise."""
        steps = len(value)
        loop, most = _SpeedLoop(self.given, period), np.array(self.given.pair("u_rated"))
        rig: ReferenceRig | _CatalogueRig
        if self.forms == CATALOGUE_FORMS:
            rig = _CatalogueRig(self.true)
        else:
            rig = ReferenceRig(self.true, forms=self.forms, constants=self.constants, tolerance=1e-6)
        level = self._level()
        now = _with_lines(rig.signals(), level)
        command = np.empty((steps, 2))
        shown = {n: np.empty((steps * samples, 2)) for n in SENSORS}
        for n in range(steps):
            speed = now["measured_speed"] / RPM + speed_error[n]
            by_loop = loop(np.where(closed[n], value[n], 0.0), speed)
            loop.sum = np.where(closed[n], loop.sum, 0.0)
            volts = np.round(np.where(closed[n], by_loop, value[n] * most), 3)
            command[n] = np.clip(volts, -most, most)
            part = _with_lines(rig.advance(command[n], load[n], period, samples), level)
            for name, sensor in SENSORS.items():
                shown[name][n * samples] = now[sensor.signal]
                shown[name][n * samples + 1 : (n + 1) * samples] = part[sensor.signal][:-1]
            now = {signal: values[-1] for signal, values in part.items()}
        return command, shown

    def _read(self, sensor: Column, shown: Floats, error: Floats) -> Floats:
        raw = shown / sensor.size + error
        return np.round(raw / sensor.resolution) * sensor.resolution if self.noise > 0.0 else raw


def log_text(columns: Mapping[str, Floats], kinds: Mapping[str, Column] = COLUMNS) -> str:
    """A rig log as CSV text; `kinds` of columns say their decimals."""
    known, buffer = contract_columns(), io.StringIO()
    np.savetxt(
        buffer, np.column_stack(list(columns.values())), fmt=[f"%.{kinds[known[name][0]].decimals}f" for name in columns],
        delimiter=",", header=",".join(columns), comments="",
    )  # fmt: skip
    return buffer.getvalue()

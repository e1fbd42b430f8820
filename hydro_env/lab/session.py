"""The session: a rig, the controller that drives it, the scenario it follows, its signals of the last seconds, and logs of it.

A session runs period by period and has no clock, no thread and no page: `worker` runs it in step with the clock. A log is as it
would come from a rig: columns, noise and resolution of the practice logs, at 1 kHz.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hydro_env.arrays import Floats
from hydro_env.benchmark.report import NEEDS
from hydro_env.controllers import CONTROLLERS, make_controller
from hydro_env.controllers.rollout import inform
from hydro_env.errors import InputError
from hydro_env.lab.rig import PERIOD, RECORDED, SAMPLES, LiveRig, Reach, Reading
from hydro_env.limits import Limits
from hydro_env.plant import Scales
from hydro_env.practice.recorder import COLUMNS as LOGGED
from hydro_env.practice.recorder import SENSORS, columns_of, log_text
from hydro_env.tasks import load_scenario
from hydro_env.units import RPM

#: The scenario in which the set-point is what the slider says.
MANUAL = "manual"
#: Control periods that a snapshot shows: 10 s.
SHOWN = 1000
#: Columns of `Snapshot.past`; the difference is that of motor 1 less motor 2.
COLUMNS = (
    "time_s", "setpoint_rpm", "speed_1_rpm", "speed_2_rpm", "difference_rpm", "command_1_V", "command_2_V",
)  # fmt: skip
#: Preset for which the shipped controllers were tuned, but for those that name another one.
TUNED_FOR = "paper_dead_zone"
#: Numbers of pairs of valves.
CASES = Limits(0, 2**31 - 1, whole=True)
#: Seconds after which a recording ends by itself.
MAX_SECONDS = 120.0

_READ = {sensor.signal: name for name, sensor in SENSORS.items() if sensor.signal in RECORDED}


@dataclass(frozen=True)
class Settings:
    """What was chosen: the rig (a preset or a model file), pair of valves, controller and scenario, and what is set by hand."""

    preset: str = TUNED_FOR
    split: str = "test_interp"
    number: int = 0
    controller: str = "pid_tuned"
    scenario: str = "setpoint_steps"
    setpoint_rpm: float = 0.0
    load_Nm: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Snapshot:
    """The session at one instant, for whoever shows it. `past` (n, len(COLUMNS)) are the last periods, oldest first."""

    settings: Settings
    time: float
    angle: tuple[float, ...]
    past: Floats
    #: In force, those of the scenario included.
    load_Nm: tuple[float, ...]
    #: Every parameter of the effects offered, as it is on both channels, SI.
    effects: dict[str, tuple[float, float]]
    #: Of the rig, and so of what is set by hand.
    reach: Reach
    #: What is to be known of the controller, "" for nothing.
    note: str
    #: What went wrong last, in one line, "" for nothing.
    problem: str
    #: Seconds of the log that is being recorded.
    recorded: float | None

    @property
    def now(self) -> dict[str, float]:
        """The newest row of `past` by column, zeros before there is one."""
        row = self.past[-1] if len(self.past) else np.zeros(len(COLUMNS))
        return dict(zip(COLUMNS, map(float, row), strict=True))


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
        for name, first in zip(RECORDED, noise.reshape(3, 2), strict=True):
            sensor = self._columns[_READ[name]]
            errors = self._stream.standard_normal((SAMPLES, 2))
            errors[0] = first
            shown = signals[name] / sensor.size + sensor.noise * errors
            rows[_READ[name]] = np.round(shown / sensor.resolution) * sensor.resolution
        self._periods.append(rows)

    def text(self) -> str:
        """The log as CSV."""
        rows = {name: np.vstack([period[name] for period in self._periods]) for name in self._periods[0]}
        setpoint = rows.pop("setpoint")[:, 0]
        columns = {"time_s": np.arange(len(setpoint)) * PERIOD / SAMPLES, "setpoint_rpm": setpoint}
        for c in (0, 1):
            columns |= {f"{n}_{c + 1}_{LOGGED[n].unit}": values[:, c] for n, values in rows.items()}
        return log_text(columns, self._columns)


class Session:
    """A rig under a controller. Every method may be called between two periods; what cannot be is an InputError, and nothing
    has changed then."""

    def __init__(self, settings: Settings | None = None, *, noise: float = 1.0, seed: int = 0) -> None:
        self.settings = settings or Settings()
        self._noise, self._seed = noise, seed
        self._streams = np.random.SeedSequence(seed)
        self._recording: Recording | None = None
        self.finished_log = ""
        self._rig = LiveRig(self.settings.preset, noise=noise, seed=seed)
        self._rig.take_pair(self.settings.split, self.settings.number)
        self._effects = self._rig.values()
        self.choose_controller(self.settings.controller)
        self.choose_scenario(self.settings.scenario)
        self.reset()

    # --- what may be chosen ---------------------------------------------------------------------------------------
    def choose_valves(self, preset: str, split: str, number: int) -> None:
        """Puts in another pair of valves. Effects set by hand are kept. Another preset restarts the rig, with nothing set by
        hand."""
        number = CASES.check(number, "pair")
        same = preset == self.settings.preset
        rig = self._rig if same else LiveRig(preset, noise=self._noise, seed=self._seed)
        rig.take_pair(split, number)
        if not same:
            self._rig = rig
            self.settings = replace(self.settings, setpoint_rpm=0.0, load_Nm=(0.0, 0.0))
            self.reset()
        self.settings = replace(self.settings, preset=preset, split=split, number=number)
        self._rig_changed()

    def choose_controller(self, name: str) -> None:
        """Lets another controller take over, from where the rig stands."""
        self._controller = make_controller(name)
        self._needs = str(getattr(self._controller, "needs", "measurements"))
        self.settings = replace(self.settings, controller=name)
        self.problem = ""
        self._fresh = True

    def choose_scenario(self, name: str) -> None:
        """Follows a scenario from its beginning, over and over, or with `MANUAL` the set-point by hand. The rig runs on."""
        scenario = None if name == MANUAL else load_scenario(name, self._rig.scales)
        self._reference = None if scenario is None else scenario.reference(PERIOD, self._stream())
        self._row = 0
        self.settings = replace(self.settings, scenario=name)
        self._loads_changed()

    def set_setpoint(self, rpm: float) -> None:
        """The set-point by hand, which is followed from now on."""
        most = self._rig.reach.speed_rpm
        rpm = Limits(-most, most, unit="rpm").check(rpm, "set-point")
        self.settings = replace(self.settings, setpoint_rpm=rpm)
        if self.settings.scenario != MANUAL:
            self.choose_scenario(MANUAL)

    def set_load(self, channel: int, torque: float) -> None:
        """A load in N m on motor 0 or 1, added to that of the scenario."""
        loads, most = list(self.settings.load_Nm), self._rig.reach.torque_Nm
        loads[channel] = Limits(-most, most, unit="N m").check(torque, f"load {channel + 1}")
        self.settings = replace(self.settings, load_Nm=(loads[0], loads[1]))
        self._loads_changed()

    def set_effect(self, name: str, channel: int | None, value: float) -> None:
        """A parameter of an effect (SI), on motor 0 or 1 or both (None)."""
        self._rig.set(name, channel, value)
        self._rig_changed()

    def clear_effects(self) -> None:
        """Takes back what `set_effect` did."""
        self._rig.clear()
        self._rig_changed()

    def reset(self) -> None:
        """Puts the rig to rest at time zero and restarts the scenario. What was chosen stays."""
        self._rig.reset()
        self._row = 0
        self._past = np.zeros((0, len(COLUMNS)))
        self.problem = ""
        self._reading: Reading | None = None
        self._stop_recording()
        self._fresh = True

    # --- recording ------------------------------------------------------------------------------------------------
    def record(self) -> None:
        """Puts the rig to rest and begins a log, so that a diagnosis can simulate it from there. It ends with `stop_recording`,
        a reset, or after `MAX_SECONDS` seconds; its text then stands in `finished_log`."""
        self.reset()
        self._recording = Recording(int(self._stream().integers(2**32)), self._rig.scales)

    def stop_recording(self) -> None:
        """Ends the log. InputError if none was begun."""
        if self._recording is None:
            raise InputError("no log is being recorded")
        self._stop_recording()

    def _stop_recording(self) -> None:
        if self._recording is not None and self._recording.seconds > 0.0:
            self.finished_log = self._recording.text()
        self._recording = None

    # --- time -----------------------------------------------------------------------------------------------------
    def step(self) -> None:
        """One control period. A controller that fails leaves both valves without command, and `problem` says why."""
        setpoint, load = self._wanted()
        reading = self._reading = self._rig.sense(setpoint)
        one, two = reading.speed_rpm
        row = [self._rig.time, setpoint, one, two, one - two, *reading.command_V]
        self._past = np.vstack([self._past[-SHOWN + 1 :], row])
        action = self._action(reading)
        rows = self._rig.hold(action, load, record=self._recording is not None)
        if self._recording is not None:
            command = np.clip(action, -1.0, 1.0) * self._rig.rated
            self._recording.add(setpoint, command, load, self._rig.noise, rows)
            if self._recording.seconds >= MAX_SECONDS:
                self._stop_recording()
        if lost := next(iter(self._rig.plant.lost), ""):
            self.reset()
            self.problem = f"{lost}, and the rig was put to rest; take smaller values"
            return
        if self._reference is not None:
            self._row += 1
            if self._row >= len(self._reference.load) - 1:
                self.choose_scenario(self.settings.scenario)

    def snapshot(self) -> Snapshot:
        """The session as it is."""
        _, load = self._wanted()
        angle = np.zeros(2) if self._reading is None else self._reading.angle
        return Snapshot(
            self.settings,
            self._rig.time,
            tuple(angle.tolist()),
            self._past,
            tuple(load.tolist()),
            self._effects,
            self._rig.reach,
            self._note(),
            self.problem,
            None if self._recording is None else self._recording.seconds,
        )

    # --- within ---------------------------------------------------------------------------------------------------
    def _stream(self) -> np.random.Generator:
        return np.random.default_rng(self._streams.spawn(1)[0])

    def _wanted(self) -> tuple[float, Floats]:
        """Set-point in rpm and loads (2,) in N m that are in force from now on."""
        own = np.array(self.settings.load_Nm)
        if self._reference is None:
            return self.settings.setpoint_rpm, own
        return float(self._reference.setpoint[self._row]) / RPM, self._reference.load[self._row] + own

    def _rig_changed(self) -> None:
        """A controller that knows the valves restarts with what they now are."""
        self._effects = self._rig.values()
        self._fresh |= self._needs != "measurements"

    def _loads_changed(self) -> None:
        """A controller that knows the loads to come restarts with what they now are."""
        self._fresh |= self._needs == "everything"

    def _action(self, reading: Reading) -> Floats:
        if self.problem:
            return np.zeros(2)
        try:
            if self._fresh:
                loads = np.zeros((1, 2)) if self._reference is None else self._reference.load[self._row :]
                coming = (loads + np.array(self.settings.load_Nm))[:, None, :]
                inform(self._controller, self._rig.model, self._rig.plant, lambda: coming)
                self._controller.reset(1, PERIOD)
                self._fresh = False
            action = np.asarray(self._controller.act(reading.observation), dtype=float).reshape(2)
            if not np.isfinite(action).all():
                raise ValueError("a command is not finite")
            return action
        except Exception as problem:  # a controller of the user's may raise anything
            self.problem = str(InputError(f"{self.settings.controller} failed and was stopped: {problem}"))
            return np.zeros(2)

    def _note(self) -> str:
        notes = []
        if known := NEEDS.get(self._needs, self._needs):
            notes.append(f"knows {known}")
        own = getattr(self._controller, "plant", None)
        if own is None and self.settings.controller in CONTROLLERS and self._needs != "everything":
            own = TUNED_FOR
        if own is not None and own != self.settings.preset:
            notes.append(f"made for the preset {own}")
        return "; ".join(notes)

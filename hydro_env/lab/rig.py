"""One rig in motion: its valves, effects, set-point and loads may change at every control period."""

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from hydro_env.arrays import AnyArray, Floats, Singles
from hydro_env.envs.observation import FRAME, noise_levels, scales_on
from hydro_env.envs.step_kernels import NEVER, SIGNALS, STATE, TRUE, observe
from hydro_env.plant import CATALOGUE, Plant, PlantModel, Scales, load_model, scales_of
from hydro_env.plant.catalogue.form_corrections import FAMILY as FORMS
from hydro_env.tasks import draw_pairs
from hydro_env.tasks.mismatch import OWN, SENSOR_PARAMETERS, own_values
from hydro_env.units import BAR, RPM

#: Control period, s, as in the benchmark.
PERIOD = 0.01
#: Rows of a recording in a control period: 1 kHz, as practice logs have.
SAMPLES = 10
#: What a recording takes from the plant.
RECORDED = ("measured_speed", "current", "pressure")

_ROW = np.zeros(1, np.int64)


def effects_offered() -> list[str]:
    """Names of the effects that a rig may have: the package's and the user's own, without corrections of form."""
    return [name for name, effect in CATALOGUE.items() if effect.family != FORMS]


@dataclass(frozen=True)
class Reach:
    """What the valves of a rig do at their rated commands."""

    rated_V: tuple[float, float]
    #: Without load, of the weaker channel.
    speed_rpm: float
    #: At standstill, of the weaker channel; of a motor without leakage that at the supply pressure, or at 350 bar.
    torque_Nm: float
    #: Of both channels, beside the paper's rig.
    scales: tuple[Scales, Scales]


def reach_of(model: PlantModel) -> Reach:
    """The reach of a rig from its base parameters: Kq x = D w + Km dp, D dp = B w + torque."""
    speeds, torques = [], []
    for c in (0, 1):
        D, B, Km, Kq, alpha, R, k = (
            model.value(name, c) for name in ("D", "B", "Km", "Kq", "alpha", "R", "k")
        )
        voltage = min(model.value("u_rated", c), model.value("driver_saturation.voltage_limit", c))
        flow = Kq * min(alpha * voltage / (R * k), model.value("x_max", c))
        speeds.append(flow / (D + Km * B / D) / RPM)
        supply = min(model.value("pressure_dependent_flow.supply_pressure", c), 350.0 * BAR)
        torques.append(D * min(flow / Km if Km > 0.0 else inf, supply))
    return Reach(model.pair("u_rated"), min(speeds), min(torques), (scales_of(model, 0), scales_of(model, 1)))


@dataclass(frozen=True)
class Reading:
    """A rig at one instant: what the sensors show, and the true signals (see `envs.step_kernels.COLUMNS`)."""

    #: (1, 9), as the environment gives it.
    observation: Singles
    #: (2,), true.
    speed_rpm: Floats
    #: (2,), of the shafts since the start, rad.
    angle: Floats
    #: (2,), in force until now.
    command_V: Floats


class LiveRig:
    """One rig that runs on for as long as it is stepped: `sense`, then `hold`, once a control period.

    All effects of the catalogue are compiled in, so that each may be set at any time; neutral ones change no bit. `noise` is a
    factor on the sensors' noise. Row for row it does what the environment does with the same reference, without end and reward.

    InputError for an unknown plant.
    """

    def __init__(self, plant: str = "paper_dead_zone", *, noise: float = 1.0, seed: int = 0) -> None:
        self.model = load_model(plant)
        self.reach = reach_of(self.model)
        self._offered = effects_offered()
        self.plant = Plant(self.model, 1, effects=self._offered)
        self.scales = scales_of(self.model)
        self._levels = noise_levels(noise, self.scales)
        self._stream = np.random.default_rng(seed)
        self._where = np.array([self.plant.row_of(name) for name in SIGNALS], np.int64)
        self._drawn: dict[str, tuple[float, float]] = {}
        self._set: dict[str, list[float]] = {}
        self._sensor = {name: np.full((1, 2), p.nominal) for name, p in SENSOR_PARAMETERS.items()}
        self.reset()

    # --- valves and effects ---------------------------------------------------------------------------------------
    def take_pair(self, split: str, number: int) -> None:
        """Puts in a pair of valves: that of a number in a split, or the preset's own for `own`. Effects set by hand are kept.

        InputError for an unknown split or a number beyond its list.
        """
        values = {} if split == OWN else draw_pairs(split, [number], model=self.model).values
        for name in {*self._drawn, *values}:
            pair = values[name][0] if name in values else own_values(name, self.model)
            if name in self._sensor:
                self._sensor[name][0] = pair
            elif name not in self._set:
                self.plant.set(name, [pair])
            self._drawn[name] = (float(pair[0]), float(pair[1]))

    def value(self, name: str) -> tuple[float, float]:
        """A parameter of both channels as it now is, SI."""
        pair = self.plant.get(name)[0]
        return float(pair[0]), float(pair[1])

    def values(self) -> dict[str, tuple[float, float]]:
        """Every parameter of the effects offered, of both channels, SI."""
        names = (f"{effect}.{p.name}" for effect in self._offered for p in CATALOGUE[effect].parameters)
        return {name: self.value(name) for name in names}

    def set(self, name: str, channel: int | None, value: float) -> None:
        """Sets a parameter of an effect on channel 0 or 1, or on both (None). InputError for a value that cannot be."""
        pair = list(self.value(name))
        for each in (0, 1) if channel is None else (channel,):
            pair[each] = value
        self.model.with_values({name: pair})  # refuses what no component has
        self.plant.set(name, [pair])
        self._set[name] = pair

    def clear(self) -> None:
        """Takes back all that was `set`: the values are those of the pair of valves, or of the preset."""
        for name in self._set:
            self.plant.set(name, [self._drawn.get(name, self.model.pair(name))])
        self._set.clear()

    # --- time -----------------------------------------------------------------------------------------------------
    def reset(self) -> None:
        """Puts the rig to rest at time zero."""
        self.plant.reset()
        self.time = 0.0
        self._state: AnyArray = np.zeros(1, STATE)
        self._noise = np.zeros((1, 6), np.float32)

    @property
    def rated(self) -> Floats:
        """Rated commands (2,), V."""
        return self.plant.get("u_rated")[0]

    def sense(self, setpoint_rpm: float) -> Reading:
        """What the rig shows now, with the set-point that is in force from now on."""
        self._stream.standard_normal(out=self._noise, dtype=np.float32)
        # A sensor sticks at its first reading at the earliest.
        sticks = self.time >= np.maximum(self._sensor["speed_sensor.stuck_from"], PERIOD) - 1e-9
        row = self._state[0]
        row["setpoint"], row["rated"] = setpoint_rpm * RPM, self.rated
        row["noise"] = self._levels * self._noise[0]
        row["noise_factor"] = self._sensor["speed_sensor.noise_factor"][0]
        row["stuck_from"] = np.where(sticks[0], 0, NEVER)
        observation, true = np.zeros((1, FRAME), np.float32), np.zeros((1, TRUE))
        reward, ended = np.zeros(1), np.zeros((2, 1), np.bool_)
        sensing = np.append(scales_on(self.scales), np.zeros(5))
        observe(_ROW, self._state, self.plant.memory, self._where, sensing, observation, true, reward, *ended)
        return Reading(observation, true[0, 0:2], self.plant.angle[0], true[0, 4:6])

    def hold(self, action: ArrayLike, load_Nm: ArrayLike, *, record: bool = False) -> dict[str, Floats]:
        """Holds commands (2,), fractions of the rated ones and clipped to [-1, 1], and loads (2,) over a control period.

        With `record` returns the signals `RECORDED`, (SAMPLES, 2) each from the beginning of the period on, SI, else none.
        """
        # As actions are passed on to the environment.
        fraction = self._state["fraction"]
        fraction[:] = np.clip(np.asarray(action, dtype=float), -1.0, 1.0).astype(np.float32)
        command, load = fraction * self.rated, np.asarray(load_Nm, dtype=float).reshape(1, 2)
        rows: dict[str, Floats] = {}
        if record:
            ones = np.ones((SAMPLES, 1))
            rows = self.plant.run(ones * command, ones * load, PERIOD / SAMPLES, RECORDED)
        else:
            self.plant.hold(command, load, PERIOD)
        self.time = round(self.time + PERIOD, 9)
        return {name: values[:, 0] for name, values in rows.items()}

    @property
    def noise(self) -> Floats:
        """What the sensors added last, standard normal: speeds, currents, pressures, (6,)."""
        return self._noise[0].astype(float)

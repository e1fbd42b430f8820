"""The data sheet of a model, measured on the simulated plant as a test bench would: the valves as in ISO 10770-1.

Keys are those of the data sheets; what no sheet has is `no_load_speed_rpm` and `stall_pressure_bar` of the whole rig.
"""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hydro_env.arrays import AnyArray, Floats
from hydro_env.data_sheet.derive import total_drop
from hydro_env.plant import PARAMETERS, Plant, PlantModel
from hydro_env.plant.model import VALVE_PARAMETERS
from hydro_env.units import BAR, LPM, MILLISECOND, RPM
from hydro_env.valve_bench import identify, record

#: On the bench the drop over the valve is held, and nothing but the motor itself takes torque.
_NO_RIG = {
    "supply_droop.relative_drop": 0.0, "line_loss.coefficient": 0.0, "entrained_air.fraction": 0.0,
    "crossport_relief.relief_pressure": math.inf,
}  # fmt: skip
#: Amplitude ratio at -3 dB.
_MINUS_3_DB = 10.0**-0.15
#: Frequencies of a sweep over the natural one, points in a period of the highest, periods of the lowest.
_SHARES, _POINTS, _PERIODS = np.geomspace(0.1, 4.0, 20), 20, 3


def _on_the_bench(model: PlantModel, **values: float) -> PlantModel:
    """The model with nothing but valve and motor, and one set of effects for all, so that one kernel serves every data sheet."""
    effects = {name.split(".")[0] for name in _NO_RIG}
    return replace(model, declared=(*model.declared, *effects), ranges={}).with_values({**_NO_RIG, **values})


def _valve_alone(model: PlantModel) -> PlantModel:
    """The valve before a motor of 63 cm3 without friction, whose inertia takes hardly any pressure; else the base plant's."""
    motor = {name: PARAMETERS[name].nominal for name in ("J", "Km", "beta", "V")}
    dry = dict.fromkeys(("motor_coulomb_friction.coulomb", "motor_coulomb_friction.static"), 0.0)
    return _on_the_bench(model, **motor, D=1e-5, B=0.0, **dry)


def _run(
    plant: Plant, channel: int, command: ArrayLike, load: ArrayLike, period: float, *signals: str
) -> list[Floats]:
    """Signals (T,) of a channel under a command (T,) in V and a load, (T,) or constant, in N m; the other valve is closed."""

    def alone(values: ArrayLike) -> Floats:
        both = np.zeros((np.size(values), 2))
        both[:, channel] = values
        return both

    out = plant.run(alone(command), alone(load), period, signals)
    return [out[name][:, 0, channel] for name in signals]


def steady_figures(model: PlantModel, channel: int, q: Mapping[str, float]) -> dict[str, float]:
    """Rated flow at its drop, dead band and hysteresis."""
    alone = _valve_alone(model)
    supply = model.value("pressure_dependent_flow.supply_pressure", channel)
    load = alone.value("D", channel) * (supply - total_drop(q))
    found = identify(record(alone, channel, seconds=40.0, signal="command"))
    sides = [side for side in (found.positive, found.negative) if side is not None]
    band = max(0.0, float(np.mean([side.dead_zone for side in sides])))
    rated = np.full(300, model.value("u_rated", channel))
    (flow,) = _run(Plant(alone), channel, rated, load, 0.01, "flow")
    return {
        "rated_flow_lpm": float(np.mean(flow[-50:])) / LPM,
        "dead_band_percent": found.curve.percent(band),
        "hysteresis_percent": found.hysteresis_percent or 0.0,
    }


def dynamics_of(model: PlantModel, channel: int, q: Mapping[str, float]) -> dict[str, float]:
    """Step response and frequencies of the spool; infinite where it is not reached."""
    alone = _valve_alone(model)
    own = math.sqrt(model.value("k", channel) / model.value("m", channel)) / (2.0 * math.pi)
    rated = model.value("u_rated", channel)
    period, frequencies = 1.0 / (own * 200.0), np.array(own * _SHARES, np.float64)
    (spool,) = _run(Plant(alone), channel, np.full(4000, rated), 0.0, period, "spool")
    share = min(q["step_response_to_percent"] / 100.0, 0.98)  # 100 %: within 2 %
    gain, phase = _response(alone, channel, frequencies, rated * q["frequency_amplitude_percent"] / 100.0)
    return {
        "step_response_ms": _crossing(np.arange(4000) * period, spool / spool[-1], share) / MILLISECOND,
        "frequency_minus_3_dB_Hz": _crossing(frequencies, -gain / gain[0], -_MINUS_3_DB),
        "frequency_minus_90_deg_Hz": _crossing(frequencies, -phase, 0.5 * math.pi),
    }


def _response(
    model: PlantModel, channel: int, frequencies: Floats, amplitude: float
) -> tuple[Floats, Floats]:
    """Amplitude and phase (rad) of the spool at sines of the command, each frequency on a rig of its own."""
    period = 1.0 / (frequencies[-1] * _POINTS)
    time = np.arange(math.ceil(_PERIODS / frequencies[0] / period)) * period
    command = np.zeros((len(time), len(frequencies), 2))
    command[:, :, channel] = amplitude * np.sin(2.0 * math.pi * frequencies * time[:, None])
    spool = Plant(model, len(frequencies)).run(command, None, period, ("spool",))["spool"][:, :, channel]
    last = time >= time[-1] / _PERIODS
    found = np.empty(len(frequencies), complex)
    for n, frequency in enumerate(frequencies):
        # Row n is the state when command n begins to act: what is held until then is half a period late.
        angle = 2.0 * math.pi * frequency * (time[last] - 0.5 * period)
        basis = np.column_stack([np.sin(angle), np.cos(angle), np.ones(len(angle))])
        sine, cosine, _ = np.linalg.lstsq(basis, spool[last, n], rcond=None)[0]
        found[n] = complex(sine, cosine)
    return np.abs(found), np.unwrap(np.angle(found))


def _crossing(x: AnyArray, y: AnyArray, level: float) -> float:
    """Where a signal first reaches a level from below, between the points."""
    above = np.flatnonzero(y >= level)
    if not above.size:
        return math.inf
    n = int(above[0])
    return float(x[0] if n == 0 else np.interp(level, y[n - 1 : n + 1], x[n - 1 : n + 1]))


def motor_figures(model: PlantModel, channel: int, q: Mapping[str, float]) -> dict[str, float]:
    """Efficiencies at their point, and the starting torque, before a valve that has flow enough."""
    pressure, speed = q["at_pressure_bar"] * BAR, q["at_speed_rpm"] * RPM
    displacement = model.value("D", channel)
    valve = {name: PARAMETERS[name].nominal for name in VALVE_PARAMETERS}
    rated = valve["u_rated"]
    travel = valve["alpha"] * rated / valve["R"] / valve["k"]
    closed = dict.fromkeys(("dead_zone.overlap_positive", "dead_zone.overlap_negative"), 0.0)
    gain = min(2.0 * displacement * speed / travel, PARAMETERS["Kq"].possible[1])
    valve |= {"Kq": gain, "magnetic_hysteresis.amplitude": 0.0, "magnetic_hysteresis.width": 0.03}
    supply = {"pressure_dependent_flow.supply_pressure": 4.0 * pressure}
    bench = _on_the_bench(model, **closed, **valve, **supply)
    plant, found = Plant(bench), {}
    rows = round(min(max(10.0 * _memory(model, channel), 1.0), 60.0) / 0.01)
    command, load, signals = 0.6 * rated, displacement * pressure, ("speed", "pressure", "flow")
    for _ in range(8):  # the command by what the speed lacks, the load by what the pressure lacks
        out = _run(plant, channel, np.full(rows, command), load, 0.01, *signals)
        found = {name: float(np.mean(values[-20:])) for name, values in zip(signals, out, strict=True)}
        missing = displacement * (speed - found["speed"])
        command = min(command * max(1.0 + missing / found["flow"], 0.3), rated)
        load += displacement * (pressure - found["pressure"])
    return {
        "volumetric_efficiency_percent": 100.0 * displacement * found["speed"] / found["flow"],
        "mechanical_efficiency_percent": 100.0 * load / (displacement * found["pressure"]),
        "starting_torque_percent": _starting_torque(bench, channel, q),
    }


def _starting_torque(bench: PlantModel, channel: int, q: Mapping[str, float]) -> float:
    """Percent of the theoretical torque that is left when the motor breaks away."""
    command = np.linspace(0.0, 0.1 * bench.value("u_rated", channel), 3000)
    speed, pressure = _run(Plant(bench), channel, command, 0.0, 0.01, "speed", "pressure")
    breakaway = float(np.max(pressure[speed < 0.25]))  # full friction, see `motor_coulomb_friction`
    return 100.0 * (1.0 - breakaway / (q.get("starting_torque_at_bar", q["at_pressure_bar"]) * BAR))


def _memory(model: PlantModel, channel: int) -> float:
    """Time constant of the shaft, s."""
    value = {name: model.value(name, channel) for name in ("J", "B", "D", "Km")}
    return value["J"] / (value["B"] + value["D"] ** 2 / max(value["Km"], 1e-15))


def rig_figures(model: PlantModel, channel: int) -> dict[str, float]:
    """Speed of both motors without load at the rated commands, and the pressure at which the load stops one."""
    seconds = min(max(20.0 * _memory(model, channel), 20.0), 300.0)
    rows = round(seconds / 0.01)
    both = Plant(model).run(np.tile(model.pair("u_rated"), (rows, 1)), None, 0.01, ("speed",))["speed"]
    command = np.full(2 * rows, model.value("u_rated", channel))
    most = model.value("D", channel) * model.value("pressure_dependent_flow.supply_pressure", channel)
    load = np.concatenate([np.zeros(rows), np.linspace(0.0, 1.2 * most, rows)])
    speed, pressure = _run(Plant(model), channel, command, load, 0.01, "speed", "pressure")
    stopped = np.flatnonzero(speed[rows:] <= 0.0)
    stall = pressure[rows + stopped[0]] if stopped.size else math.inf
    fast = float(np.mean(both[-20:, 0, channel]))
    return {"no_load_speed_rpm": fast / RPM, "stall_pressure_bar": float(stall) / BAR}

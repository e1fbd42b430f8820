"""The modelled spool: where it stands under the commands, and which commands bring it to a place.

A coil that lags, a spool with mass, spring, damping and Coulomb friction between stops, and a valve with a dead zone and one
gain. Positions and commands are shares of the rated command, flows of the rated flow. Substeps are split symmetrically
(Strang): half a step of position, a step of speed, half a step of position.
"""

from math import exp
from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.controllers.base import TUNED, Floats
from hydro_env.controllers.estimation.nominal import SPOOL_RATE, STICTION, Motor
from hydro_env.jit import compiled


class SpoolSettings(NamedTuple):
    """The modelled spool and what lies before and behind it."""

    rate: Annotated[float, "1/s", "rate of the undamped spool's mode", "Table II"] = SPOOL_RATE
    damping: Annotated[float, "1", "damping ratio", "assumed: back-EMF and viscous friction"] = 0.03
    friction: Annotated[float, "1", "Coulomb friction relative to the nominal stiction", TUNED] = 0.85
    substep: Annotated[float, "s", "step of the model", "a 24th of the spool's period"] = 1.25e-3
    coil: Annotated[float, "s", "time constant of the coil", "L / R, Table II"] = 1e-3
    pressure_lag: Annotated[float, "s", "lag of the pressure behind the flow", "V / (beta Km)"] = 5e-4
    stop: Annotated[float, "1", "end stops, in rated travels", "1 mm of the nominal valve"] = 1.16


class Channel(NamedTuple):
    """The modelled channel for compiled code: substeps of `step` s, `steps` a period."""

    period: float  # of control, s
    steps: int
    step: float
    rate: float  # of the spool's mode, 1/s
    decay: float  # of the spool's speed in a substep
    grip: float  # speed that friction takes in a substep
    late: float  # share of a change of command that the coil has yet to follow after a substep
    late_mean: float  # and on the mean of a substep
    stop: float
    per_speed: float  # flows that speed, torque and acceleration of the motor take
    per_torque: float
    per_acceleration: float
    fresh: float  # share of the flow at its end, not at its beginning, that turns the motor in a substep
    travel: Floats  # of a spool after a command of 1 that lasts a period, by substep: (horizon steps,)
    swing: Floats  # its speed over `rate`


def channel_of(settings: SpoolSettings, motor: Motor, period: float, horizon: int) -> Channel:
    """The model for a control period in s; responses over `horizon` periods."""
    steps = max(1, round(period / settings.substep))
    step, rate = period / steps, settings.rate
    late = exp(-step / settings.coil)
    late_mean = (1.0 - late) * settings.coil / step
    decay = exp(-2.0 * settings.damping * rate * step)
    travel, swing = [], []
    position = speed = coil = 0.0
    for n in range(horizon * steps):
        command = 1.0 if n < steps else 0.0
        position += 0.5 * step * speed
        speed = decay * speed + step * rate * rate * (command + late_mean * (coil - command) - position)
        position += 0.5 * step * speed
        coil = command + late * (coil - command)
        travel.append(position)
        swing.append(speed / rate)
    grip = step * rate * rate * (settings.friction * STICTION)
    # the mean over a substep of a ramp from 0 to 1 that passes the pressure's lag
    lag = settings.pressure_lag
    fresh = 0.5 - lag / step * (1.0 - lag / step * (1.0 - exp(-step / lag)))
    return Channel(
        period, steps, step, rate, decay, grip, late, late_mean, settings.stop, motor.per_speed, motor.per_torque,
        motor.per_acceleration, fresh, np.array(travel), np.array(swing),
    )  # fmt: skip


class SpoolModel:
    """Positions and speeds (num_rigs, 2) of spools, and the commands that have passed their coils.

    `ringing` is the squared amplitude of the swing about the command. `unsampled`: mean flow of the last period less the
    mean of its two ends, which is what samples miss.
    """

    def __init__(self, command: Floats, channel: Channel, pressure_lag: float) -> None:
        """At rest, where a command (num_rigs, 2) brings them that was in force for long."""
        self.channel, self._pressure_lag = channel, pressure_lag
        self.position, self.coil = np.array(command, float), np.array(command, float)
        self.speed, self.ringing, self.unsampled = np.zeros((3, *command.shape))

    @property
    def shown(self) -> Floats:
        """Positions (num_rigs, 2) that the measured flow tells of, which lags."""
        return self.position - self._pressure_lag * self.speed

    def move(self, command: Floats, edge: Floats, gain: Floats) -> None:
        """One control period under held commands (num_rigs, 2), behind valves with these edges and gains."""
        held = np.ascontiguousarray(command, dtype=float)
        state = self.position, self.speed, self.coil, self.ringing, self.unsampled
        follow(*state, held, edge, gain, self.channel)


@compiled
def substep(position, speed, coil, command, m):
    """One substep of a spool: position, speed and the command that has passed the coil after it."""
    gap = coil - command
    position += 0.5 * m.step * speed
    speed = m.decay * speed + m.step * m.rate * m.rate * (command + m.late_mean * gap - position)
    speed -= min(max(speed, -m.grip), m.grip)
    position += 0.5 * m.step * speed
    if abs(position) > m.stop:
        speed = min(speed, 0.0) if position > 0.0 else max(speed, 0.0)
        position = min(max(position, -m.stop), m.stop)
    return position, speed, command + m.late * gap


@compiled
def valve_flow(position, positive, negative, gain):
    """Flow, and whether the valve is open."""
    nearest = -negative if position < -negative else position
    nearest = positive if position > positive else nearest
    return gain * (position - nearest), position != nearest


@compiled
def follow(position, speed, coil, ringing, unsampled, command, edge, gain, m):
    """Spools (N, 2) under held commands for a period, in place; see `SpoolModel`."""
    for i in range(position.shape[0]):
        for c in range(2):
            x, v, late, u = position[i, c], speed[i, c], coil[i, c], command[i, c]
            flow, _ = valve_flow(x, edge[i, c, 0], edge[i, c, 1], gain[i, c])
            first, total = flow, 0.5 * flow
            for _ in range(m.steps):
                x, v, late = substep(x, v, late, u, m)
                flow, _ = valve_flow(x, edge[i, c, 0], edge[i, c, 1], gain[i, c])
                total += flow
            unsampled[i, c] = (total - 0.5 * flow) / m.steps - 0.5 * (first + flow)
            position[i, c], speed[i, c], coil[i, c] = x, v, late
            ringing[i, c] = (x - u) ** 2 + (v / m.rate) ** 2


@compiled
def deadbeat_state(sent, rows, position, speed, coil, goal, pace, m):
    """Commands `sent` (N, 2), in place, that bring the spools marked in `rows` (N, 2) to the positions `goal` with the speeds
    `pace` (N, 2) in two periods; Newton's method on the linear response, as friction bends it a little."""
    first, last = 2 * m.steps - 1, m.steps - 1
    a, b, c, d = m.travel[first], m.travel[last], m.swing[first], m.swing[last]
    span = a * d - b * c
    for i in range(sent.shape[0]):
        for k in range(2):
            if not rows[i, k]:
                continue
            now = then = goal[i, k]
            for _ in range(3):
                x, v, late = position[i, k], speed[i, k], coil[i, k]
                for _ in range(m.steps):
                    x, v, late = substep(x, v, late, now, m)
                for _ in range(m.steps):
                    x, v, late = substep(x, v, late, then, m)
                off, slow = goal[i, k] - x, (pace[i, k] - v) / m.rate
                now += (d * off - b * slow) / span
                then += (a * slow - c * off) / span
            sent[i, k] = min(max(now, -1.0), 1.0)


@compiled
def deadbeat_position(sent, rows, position, speed, coil, goal, m):
    """Commands `sent` (N, 2), in place, after a period of which the spools marked in `rows` (N, 2) pass the positions `goal`
    (N, 2), at whatever speed."""
    slope = m.travel[m.steps - 1]
    for i in range(sent.shape[0]):
        for k in range(2):
            if not rows[i, k]:
                continue
            command = goal[i, k]
            for _ in range(3):
                x, v, late = position[i, k], speed[i, k], coil[i, k]
                for _ in range(m.steps):
                    x, v, late = substep(x, v, late, command, m)
                command += (goal[i, k] - x) / slope
            sent[i, k] = min(max(command, -1.0), 1.0)

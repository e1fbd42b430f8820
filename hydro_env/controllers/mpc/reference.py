"""The reference: one speed for both motors, which runs to the set-point as fast as the weaker valve allows."""

from math import inf
from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.controllers.base import HAND, TUNED, Bools, Floats
from hydro_env.controllers.estimation.nominal import NOMINAL, TUNED_PERIOD
from hydro_env.controllers.estimation.spool import Channel
from hydro_env.controllers.estimation.valve_estimator import ValveState
from hydro_env.jit import compiled
from hydro_env.units import RPM

INERTIA = NOMINAL["J"]
#: Change of the set-point in a period up to which it is taken to go on, rad/s: 2500 rpm/s at 10 ms.
SMOOTH = 25.0 * RPM


class ReferenceSettings(NamedTuple):
    """How the reference runs to the set-point."""

    rate: Annotated[float, "1/s", "rate at which it runs to the set-point", TUNED] = 42.0
    rise: Annotated[float, "1/s", "how fast the flow may rise, rated flows a second", TUNED] = 28.0
    fall: Annotated[float, "1", "how many times as fast it may fall", TUNED] = 4.0
    doubt: Annotated[float, "1", "an unknown gain divides that rise by 1 + doubt", TUNED] = 5.5
    capacity: Annotated[float, "1", "share of the weaker valve's capacity that may be used", TUNED] = 0.94
    most: Annotated[float, "rad/s2", "largest acceleration without load", "what the supply's pressure gives"] = inf  # fmt: skip
    foresight: Annotated[float, "1", "response times by which a smooth set-point is foreseen", HAND] = 1.0


class ReferenceState(NamedTuple):
    """Speed (rad/s) and acceleration (rad/s2), the flow they take, each (N,), and the speeds before, newest first,
    (periods, N)."""

    speed: Floats
    acceleration: Floats
    flow: Floats
    history: Floats


class Reference:
    """Holds a `ReferenceState` in `state`, whose arrays keep their place."""

    def __init__(
        self, settings: ReferenceSettings, channel: Channel, setpoint: Floats, speed: Floats, remembered: int
    ) -> None:
        """Begins at the mean of both motors' speeds (num_rigs, 2); `setpoint` (num_rigs,). `remembered`: speeds that are kept."""
        self.settings, self._channel, period = settings, channel, channel.period
        # at longer periods more goes wrong before it is seen: flow rises by less
        self._growth = settings.rise * min(1.0, TUNED_PERIOD / period) ** 1.5 * period
        acceleration, flow, self._slope = np.zeros((3, len(setpoint)))
        mean = np.mean(speed, axis=1)
        self.state = ReferenceState(mean, acceleration, flow, np.stack([mean] * remembered))
        self._setpoint, self.smooth = setpoint, np.zeros(len(setpoint), bool)

    def foresee(self, setpoint: Floats, response: float) -> Floats:
        """Where a smoothly moving set-point will be when the motors can be there, (num_rigs,). `response`: periods by which
        speeds follow the reference. `smooth` tells afterwards whether the set-point moves no faster than that."""
        slope = setpoint - self._setpoint
        self.smooth = np.abs(slope) < SMOOTH
        goes_on = self.smooth & (np.abs(slope - self._slope) < 0.2 * SMOOTH)
        self._setpoint, self._slope = setpoint, slope
        periods = self.settings.foresight * (1.0 / (self.settings.rate * self._channel.period) + response)
        return setpoint + np.where(goes_on, periods * slope, 0.0)

    def update(
        self, setpoint: Floats, speed: Floats, torque: Floats, valves: ValveState, coasts: Bools, rests: Bools
    ) -> None:
        """One period towards the set-point (num_rigs,). `speed`, `torque` (num_rigs, 2): of the motors. Where it `coasts`,
        it goes on as a motor without flow does, where it `rests`, at the motors' speed."""
        readings = np.ascontiguousarray(setpoint), np.ascontiguousarray(speed), torque
        _step(self.settings, self._growth, self._channel, *readings, valves, coasts, rests, self.state)


@compiled
def capacity(gain, edge):
    """Flow at the rated command in the direction of the edge."""
    return gain * max(1.0 - edge, 0.1)


@compiled
def _step(s, growth, m, setpoint, speed, torque, valves, coasts, rests, r):
    for i in range(setpoint.size):
        motors = (speed[i, 0] + speed[i, 1]) / 2.0
        mean_load = (torque[i, 0] + torque[i, 1]) / 2.0
        load = m.per_torque * mean_load
        held = m.per_speed * r.speed[i] + load
        faster = _acceleration(s, growth, m, i, setpoint[i], held, mean_load, valves, r)
        for k in range(r.history.shape[0] - 1, 0, -1):
            r.history[k, i] = r.history[k - 1, i]
        if coasts[i] or rests[i]:
            r.speed[i] = motors
            r.acceleration[i] = (
                0.0 if rests[i] else -m.per_speed / m.per_acceleration * motors - mean_load / INERTIA
            )
            r.history[:, i] = motors
        else:
            r.speed[i] += m.period * faster
            r.acceleration[i] = faster
            r.history[0, i] = r.speed[i]
        r.flow[i] = m.per_speed * r.speed[i] + load + m.per_acceleration * faster


@compiled
def _acceleration(s, growth, m, i, setpoint, held, load, valves, r):
    """Acceleration by the flow that the reference asks for; `held` is the flow that holds its speed."""
    gain, edge = valves.gain[i], valves.edge[i]
    now = held + m.per_acceleration * r.acceleration[i]
    unsure = np.sqrt(max(valves.gain_variance[i, 0], valves.gain_variance[i, 1])) / 0.12
    rise = growth / (1.0 + s.doubt * unsure)
    upward = rise if now >= 0.0 else s.fall * rise
    downward = rise if now <= 0.0 else s.fall * rise
    flow = held + m.per_acceleration * s.rate * (setpoint - r.speed[i])
    flow = min(max(flow, now - downward), now + upward)
    least = s.capacity * min(capacity(gain[0], edge[0, 1]), capacity(gain[1], edge[1, 1]))
    most = s.capacity * min(capacity(gain[0], edge[0, 0]), capacity(gain[1], edge[1, 0]))
    faster = (min(max(flow, -least), most) - held) / m.per_acceleration
    return min(max(faster, -s.most - load / INERTIA), s.most - load / INERTIA)

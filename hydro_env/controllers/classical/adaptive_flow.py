"""Adaptive flow controller: learns both valves while it drives them; neither motor starts before the other.

The flow into a motor is seen from its pressure and speed (eq. 1), so the valve's curve can be learnt on
line: for each channel and direction an extended Kalman filter estimates the edge of the dead zone and the
flow gain from where the spool should be and what flows. A reference speed, common to both motors, is turned
into flow by the motor's own equations and into commands by the inverse of the curves as known so far. When
the flow must change direction and the new edges are not yet known, both spools creep up to them; the first
to flow is held there until the other flows too, while the reference coasts as a motor without flow does.
Commands pass a three-point filter with a zero at the spool's lightly damped mode, because every step would
set it ringing.
"""

from __future__ import annotations

import numpy as np

from hydro_env.controllers.base import SLEW, Controller, Floats, Gain, Measurements
from hydro_env.controllers.estimation.valve_map import (
    FLOW_PER_ACCELERATION,
    MOTOR_RATE,
    NOMINAL,
    ValveMap,
    flow_for,
    measured_flow,
)
from hydro_env.controllers.spool import Spool

__all__ = ["AdaptiveFlow", "ValveLearner"]

FLOWING = 0.008
"""Share of the rated flow that counts as flowing: four standard deviations of the measured flow's noise."""


LARGEST_EDGE = 0.6
"""No dead zone reaches further than this share of the rated command; Fig. 2 shows 0.4."""


class ValveLearner:
    """Kalman estimates of edge and gain for each rig, channel and direction, with the uncertainty of both.

    The prior is the scatter of valves of one type; `drift` is the random walk of the edge per root second,
    which keeps the estimate awake to friction and wear.
    """

    def __init__(self, num_rigs: int, period: float, drift: Floats | float) -> None:
        shape = (num_rigs, 2, 2)
        self.map = ValveMap(np.full(shape, 0.115), np.full(shape, 0.82))
        self.edge_variance = np.full(shape, 0.07**2)
        self.gain_variance = np.full(shape, 0.12**2)
        self.covariance = np.zeros(shape)
        self.drift = np.broadcast_to(np.ravel(drift), (num_rigs,))[:, None, None] ** 2 * period
        self._noise = 0.008
        self._last = np.zeros((num_rigs, 2))

    def learn(self, spool: Floats, flow: Floats) -> None:
        """Takes in where the spools should be and what flows, both (num_rigs, 2) and signed."""
        moved = np.abs(spool - self._last)
        self._last = spool
        sign = np.array([1.0, -1.0])
        x, y = spool[..., None] * sign, flow[..., None] * sign
        edge, gain = self.map.edge, self.map.gain
        active = (x > edge) | (y > FLOWING)
        active &= x > 0.5 * (edge - edge[..., ::-1])  # only the direction in which the spool stands
        beyond = np.maximum(x - edge, 0.0)
        surprise = y - gain * beyond
        # A moving spool is not quite where the model has it.
        noise = self._noise**2 + (0.1 * moved[..., None]) ** 2
        self.edge_variance = np.minimum(self.edge_variance + np.where(active, self.drift, 0.0), 0.1**2)
        by_edge = self.edge_variance * -gain + self.covariance * beyond
        by_gain = self.covariance * -gain + self.gain_variance * beyond
        total = -gain * by_edge + beyond * by_gain + noise
        to_edge, to_gain = np.where(active, by_edge / total, 0.0), np.where(active, by_gain / total, 0.0)
        self.map.edge = np.clip(edge + to_edge * surprise, -0.15, LARGEST_EDGE)
        self.map.gain = np.clip(gain + to_gain * surprise, 0.3, 1.6)
        self.edge_variance = np.maximum(self.edge_variance - to_edge * by_edge, 1e-8)
        self.gain_variance = np.maximum(self.gain_variance - to_gain * by_gain, 1e-8)
        self.covariance = self.covariance - to_edge * by_gain


class LoadObserver:
    """Torque on each shaft (N m) from pressure and speed: Luenberger, with a double pole at `rate` 1/s."""

    def __init__(self, speed: Floats, period: float, rate: Floats | float) -> None:
        self.speed, self.load = speed.copy(), np.zeros_like(speed)
        self._period = period
        # Sampled, the poles lie at 1 - rate period.
        self._rate = np.minimum(np.reshape(rate, (-1, 1)), 0.95 / period)

    def step(self, speed: Floats, pressure: Floats) -> Floats:
        miss = speed - self.speed
        rate = (NOMINAL["D"] * pressure - NOMINAL["B"] * self.speed - self.load) / NOMINAL["J"]
        self.speed = self.speed + self._period * (rate + 2.0 * self._rate * miss)
        self.load = self.load - self._period * NOMINAL["J"] * self._rate**2 * miss
        return self.load


class AdaptiveFlow(Controller):
    """See the module's text. The drawn valves are unknown to it."""

    GAINS = (
        Gain("rate", "1/s", 8.0, 60.0, summary="double pole of the reference: 2 / rate is its mean delay"),
        Gain("Kp", "1/s", 1.0, 20.0, summary="acceleration per error to the reference speed"),
        Gain("Ks", "1/s", 5.0, 100.0, summary="acceleration per half of the speed difference"),
        Gain(
            "search",
            "1/s",
            3.0,
            20.0,
            summary="how fast the spools creep up to an unknown edge (command per s)",
        ),
        Gain("caution", "1/s", 0.2, 5.0, summary="how fast flow may grow, times the doubt about the gain"),
        Gain("observer", "1/s", 30.0, 95.0, summary="double pole of the load observer"),
        Gain("drift", "1/sqrt(s)", 0.01, 0.15, summary="random walk of the edge in the valve estimate"),
        SLEW,
    )
    shape = 1.0
    known_within = 0.02
    """An edge with a standard deviation below this needs no search."""

    def start(self, measured: Measurements) -> None:
        n = len(measured.speed)
        self._spool = Spool(measured.command, self.period)
        self._learner = self._first_estimate(n)
        self._load = LoadObserver(measured.speed, self.period, self.gains["observer"])
        self._speed = np.mean(measured.speed, axis=1)  # the reference: speed and acceleration
        self._acceleration = np.zeros(n)
        self._direction = np.zeros(n)
        self._crossing = np.zeros(n, dtype=bool)
        self._creep = np.zeros((n, 2))
        self._rate = np.broadcast_to(np.ravel(self.gains["rate"]), (n,))

    def _first_estimate(self, num_rigs: int) -> ValveLearner:
        return ValveLearner(num_rigs, self.period, self.gains["drift"])

    def command(self, measured: Measurements) -> Floats:
        self._spool.step(self.sent)
        flow = measured_flow(measured.speed, measured.pressure)
        self._learner.learn(self._spool.position, flow)
        load = self._load.step(measured.speed, measured.pressure)
        self._move_reference(measured, load)
        wanted = flow_for(self._speed, self._acceleration, np.mean(load, axis=1))
        self._watch_direction(wanted)

        asked = self._drive(measured, load)
        creeping = self._creep_to_edge(measured, flow)
        return np.where(self._crossing[:, None], creeping, asked)

    def _move_reference(self, measured: Measurements, load: Floats) -> None:
        """One period of the reference: a critically damped second-order lag; it coasts during a search."""
        rate, step = self._rate, self.period
        gap = measured.setpoint - self._speed
        decay = np.exp(-rate * step)
        slope = rate * gap - self._acceleration
        next_gap = (gap + slope * step) * decay
        acceleration = (rate * (gap + slope * step) - slope) * decay

        # No more flow than the weaker valve can give, nor faster than its gain can be learnt on the way.
        torque = np.mean(load, axis=1)
        held = flow_for(self._speed, 0.0, torque)
        now = flow_for(self._speed, self._acceleration, torque)
        doubt = np.sqrt(np.max(self._facing(self._learner.gain_variance), axis=1))
        growth = np.ravel(self.gains["caution"]) / doubt * step
        most = self._strongest_flow()
        upper = np.where(self._direction > 0.0, np.minimum(most[:, 0], now + growth), most[:, 0])
        lower = np.where(self._direction < 0.0, np.maximum(-most[:, 1], now - growth), -most[:, 1])
        limited = np.clip(
            acceleration, (lower - held) / FLOW_PER_ACCELERATION, (upper - held) / FLOW_PER_ACCELERATION
        )
        free = limited == acceleration
        speed = np.where(free, measured.setpoint - next_gap, self._speed + step * limited)
        motors = np.mean(measured.speed, axis=1)
        coasting = -MOTOR_RATE * motors - torque / NOMINAL["J"]
        self._acceleration = np.where(self._crossing, coasting, limited)
        self._speed = np.where(self._crossing, motors, speed)

    def _strongest_flow(self) -> Floats:
        """What the weaker valve of each rig can give, less a reserve, (num_rigs, 2 directions)."""
        curve = self._learner.map
        return 0.9 * np.min(curve.gain * (1.0 - curve.edge), axis=1)

    def _watch_direction(self, wanted: Floats) -> None:
        """Begins a crossing where the flow asked for changes its direction."""
        sign = np.sign(wanted)
        turns = (np.abs(wanted) > 2.0 * FLOWING) & (sign != self._direction)
        self._direction = np.where(turns, sign, self._direction)
        edge = self._facing(self._learner.map.edge)
        deviation = np.sqrt(self._facing(self._learner.edge_variance))
        self._creep = np.where(turns[:, None], edge - 2.0 * deviation, self._creep)
        unknown = np.any(deviation > self.known_within, axis=1)
        self._crossing = np.where(turns, unknown, self._crossing)

    def _facing(self, values: Floats) -> Floats:
        """The values (num_rigs, 2, 2) of the direction each rig is to flow in, (num_rigs, 2)."""
        return np.where(self._direction[:, None] < 0.0, values[..., 1], values[..., 0])

    def _drive(self, measured: Measurements, load: Floats) -> Floats:
        """Commands that let both motors follow the reference."""
        kp, ks = (np.reshape(self.gains[key], (-1, 1)) for key in ("Kp", "Ks"))
        apart = np.mean(measured.speed, axis=1, keepdims=True) - measured.speed
        asked = self._acceleration[:, None] + kp * (self._speed[:, None] - measured.speed) + ks * apart
        return self._learner.map.command(flow_for(self._speed[:, None], asked, load), blend=FLOWING)

    def _creep_to_edge(self, measured: Measurements, flow: Floats) -> Floats:
        """Commands while an edge is searched; ends the search of a rig when both of its motors have flow."""
        sign = self._direction[:, None]
        edge = self._facing(self._learner.map.edge)
        gain = self._facing(self._learner.map.gain)
        known = np.sqrt(self._facing(self._learner.edge_variance)) < self.known_within
        flowing = (
            (sign * flow > FLOWING) | known | (self._creep > LARGEST_EDGE)
        )  # no flow seen: a sick sensor
        pace = np.reshape(self.gains["search"], (-1, 1)) * self.period
        self._creep = np.where(flowing, self._creep, self._creep + pace)
        self._crossing = self._crossing & ~np.all(flowing, axis=1)
        return sign * np.where(flowing, edge + FLOWING / gain, self._creep)

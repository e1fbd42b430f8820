"""Feedback: the flow that each motor is to get, from the reference, its error and the speed difference.

The error is the one to the reference as it was when the present speed was asked for; the speed difference is predicted to the
time at which a new command acts (a Smith predictor: with the flows asked for meanwhile). A sudden load on one motor alone is
recognised, so that it can be answered without delay.
"""

from typing import Annotated, NamedTuple

import numpy as np

from hydro_env.arrays import Bools, Floats, Integers
from hydro_env.controllers.base import TUNED
from hydro_env.controllers.estimation.estimator import MAX_DELAY
from hydro_env.controllers.estimation.motor_filter import MotorState
from hydro_env.controllers.estimation.nominal import NOMINAL, RATED_FLOW, TUNED_PERIOD, Motor
from hydro_env.controllers.estimation.spool import Channel
from hydro_env.controllers.mpc.reference import ReferenceState
from hydro_env.jit import compiled
from hydro_env.units import RPM

#: Least time between two answers to sudden loads, s; set by hand.
PAUSE = 0.15
#: Speed below which there is no saying which way a spool stops short, rad/s; set by hand.
SLOW = 20.0 * RPM


class FeedbackSettings(NamedTuple):
    """Gains on the errors, delays, and what counts as a sudden load."""

    track: Annotated[float, "1/s", "acceleration per error to the reference", TUNED] = 11.0
    couple: Annotated[float, "1/s", "acceleration per half of the speed difference", TUNED] = 47.0
    settle: Annotated[
        float, "1/s", "pace at which flow takes out what lasts of that error", "the gain above does"
    ] = 0.0
    delay: Annotated[float, "s", "from a flow asked for to the speed it gives", TUNED] = 0.016
    lead: Annotated[float, "10 ms", "how far ahead the speed difference is predicted", TUNED] = 0.66
    late: Annotated[float, "1", "a delay of n periods divides the gains by 1 + late n", TUNED] = 0.8
    jump: Annotated[float, "N m", "half of the difference of two misses that is a sudden load", TUNED] = 0.15


class FeedbackNumbers(NamedTuple):
    """What follows from them for a motor and a control period."""

    settle: float
    jump: float
    gain: float  # what a longer period leaves of the gains
    mode: bool
    share_period: float  # of the way to the final speed (or of an acceleration, s), in a period
    share_lead: float  # and in the lead
    whole: int  # periods of the delay, and the part of one
    part: float
    pause: int
    damp: float  # flow that is taken off per pressure, 1/Pa
    swell: float  # flow into the lines per change of acceleration in a period
    push: float  # acceleration per pressure
    inertia: float
    drag: float


class FeedbackState(NamedTuple):
    """`flow` (N, 2): asked for. `apart` (N, 2): half of the predicted difference, of each motor to the other, and `behind`
    (N,): error of the mean to the reference, rad/s. `short` (N,): how far motors are short of a reference in the end, rad/s; a
    spool that sticks stops short of its command. `wanted` (periods, N, 2): flows asked for before, newest first. `sudden`
    (N,): share of an answer to a sudden load, `pause` (N,): samples until the next one."""

    flow: Floats
    apart: Floats
    behind: Floats
    short: Floats
    sudden: Floats
    pause: Integers


class Feedback:
    """Holds a `FeedbackState` in `state`, whose arrays keep their place."""

    def __init__(self, settings: FeedbackSettings, motor: Motor, channel: Channel, speed: Floats) -> None:
        """Asks at first for the flow that holds the speeds (num_rigs, 2)."""
        period, num_rigs = channel.period, len(speed)
        spans = np.array([period, settings.lead * TUNED_PERIOD])
        if motor.damping:
            shares = spans
        elif motor.mode:
            shares = 1.0 - np.exp(-motor.mode * spans)
        else:
            shares = spans * (1.0 - 0.5 * motor.rate * TUNED_PERIOD)
        whole = int(settings.delay / period)
        self.remembered = whole + 2 + MAX_DELAY
        """References that the error looks back on."""
        self._settings, self._channel = settings, channel
        self._numbers = FeedbackNumbers(
            settle=settings.settle * period,
            # a difference of speeds over half the time is twice as noisy; slower sampling allows less feedback
            jump=settings.jump * max(1.0, TUNED_PERIOD / period), gain=min(1.0, TUNED_PERIOD / period),
            mode=bool(motor.mode), share_period=float(shares[0]), share_lead=float(shares[1]),
            whole=whole, part=settings.delay / period - whole, pause=round(PAUSE / period),
            damp=motor.damping * NOMINAL["Km"] / RATED_FLOW,
            swell=1e-12 * motor.compliance * NOMINAL["J"] / NOMINAL["D"] / RATED_FLOW / period if motor.damping else 0.0,
            push=NOMINAL["D"] / NOMINAL["J"], inertia=NOMINAL["J"], drag=motor.friction * NOMINAL["B"],
        )  # fmt: skip
        behind, short, sudden, self._before = np.zeros((4, num_rigs))
        flow, apart = channel.per_speed * speed, np.zeros((num_rigs, 2))
        self.state = FeedbackState(flow, apart, behind, short, sudden, np.zeros(num_rigs, int))
        self._wanted = np.zeros((MAX_DELAY + 1, num_rigs, 2))

    def update(
        self, speed: Floats, motors: MotorState, noise: Floats, delay: Integers, wanted: Floats,
        reference: ReferenceState, probing: Bools,
    ) -> None:  # fmt: skip
        """Asks for flow.

        Args:
            speed: to go by, (num_rigs, 2), rad/s.
            motors: their loads, and by how much these were off.
            noise: of the speeds, as a multiple of the usual, (num_rigs, 2).
            delay: whole periods by which commands come late, (num_rigs,).
            wanted: flows that were asked for in the period before, (num_rigs, 2).
            reference: as it is now.
            probing: rigs that probe their valves, (num_rigs,).
        """
        self._wanted = np.concatenate([wanted[None], self._wanted[:-1]])
        f, speed = self.state, np.ascontiguousarray(speed)
        _sudden(self._numbers, motors.miss, noise, probing, f)
        _ask(
            self._settings,
            self._numbers,
            self._channel,
            speed,
            motors,
            delay,
            self._wanted,
            self._before,
            reference,
            f,
        )
        self._before[:] = reference.acceleration


@compiled
def _sudden(s, miss, noise, probing, f):
    for i in range(f.pause.size):
        jump = s.jump * max(noise[i, 0], noise[i, 1])
        sudden = min(max((abs(miss[i, 0] - miss[i, 1]) - 2.0 * jump) / jump, 0.0), 1.0)
        f.sudden[i] = sudden if f.pause[i] <= 0 and not probing[i] else 0.0
        f.pause[i] = s.pause if f.sudden[i] > 0.0 else f.pause[i] - 1


@compiled
def _ask(w, s, m, speed, motors, delay, wanted, before, r, f):
    ahead, torque, pressure = np.empty(2), motors.torque, motors.pressure
    for i in range(delay.size):
        for c in range(2):
            ahead[c] = _predict(s, m, speed[i, c], torque[i, c], pressure[i, c], delay[i], wanted[:, i, c])
        mean = (speed[i, 0] + speed[i, 1]) / 2.0
        at = s.whole + delay[i]  # the reference `delay` ago
        f.behind[i] = (1.0 - s.part) * r.history[at, i] + s.part * r.history[at + 1, i] - mean
        gain = s.gain / (1.0 + w.late * delay[i])
        way = r.speed[i] / (abs(r.speed[i]) + SLOW)
        f.short[i] += s.settle / (1.0 + w.late * delay[i]) * way * f.behind[i]
        held = r.speed[i] + way * f.short[i]
        for c in range(2):
            f.apart[i, c] = 0.5 * (ahead[c] - ahead[1 - c])
            faster = r.acceleration[i] + gain * (w.track * f.behind[i] - w.couple * f.apart[i, c])
            f.flow[i, c] = (
                m.per_speed * held + m.per_acceleration * faster + m.per_torque * torque[i, c]
            ) + (s.swell * (r.acceleration[i] - before[i]) - s.damp * pressure[i, c])


@compiled
def _predict(s, m, speed, torque, pressure, late, wanted):
    """Speed when a new command acts: whole periods until the last command comes into effect, then what the spool takes."""
    if s.damp > 0.0:
        span = late * s.share_period + s.share_lead
        return speed + span * (s.push * pressure - (torque + s.drag * speed) / s.inertia)
    for more in range(late + 1):
        share = s.share_period if more < late else s.share_lead
        flow = wanted[late - more]
        if s.mode:
            speed += share * ((flow - m.per_torque * torque) / m.per_speed - speed)
        else:
            rate = flow - m.per_speed * speed - m.per_torque * torque
            speed += share * (rate / m.per_acceleration)
    return speed

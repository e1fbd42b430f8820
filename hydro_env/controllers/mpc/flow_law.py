"""The arithmetic of the flow view's law, compiled: one loop over the rigs for each half of a control period.

`think`     all that is decided before a network's outputs are known: reference, crossing, what feedback asks for.
`describe`  a network's inputs.
`steer`     from the flow asked for to the command.

`hydro_env.controllers.mpc.flow_controller` explains the law and keeps what it remembers; arrays are its attributes, one row per
rig and one column per channel, written in place.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from hydro_env.controllers.estimation.valve_estimate import FLOWING
from hydro_env.jit import compiled
from hydro_env.plant import PARAMETERS
from hydro_env.units import RPM

__all__ = ["BOTH", "FRAME", "NOMINAL", "OWN", "SPEED", "SPOOL_RATE", "Tuning", "describe", "steer", "think"]

NOMINAL = {name: parameter.nominal for name, parameter in PARAMETERS.items()}
INERTIA = NOMINAL["J"]
SPOOL_RATE = sqrt(NOMINAL["k"] / NOMINAL["m"])
SPEED, PRESSURE = 600.0 * RPM, 10e5  # scales of the inputs
OWN, BOTH, FRAME = 24, 12, 3
"""Numbers of inputs: of each channel, of the rig, and of each remembered sample."""


class Tuning(NamedTuple):
    """Numbers of a view, and of its motor and control period, for its compiled parts."""

    period: float
    per_speed: float
    per_torque: float
    per_acceleration: float
    coasting: float
    rate: float
    growth: float
    fall: float
    doubt: float
    most: float
    known: float
    jump: float
    bolt: float
    pause: int
    mode: bool
    share_period: float
    share_lead: float
    whole: int
    part: float
    track: float
    couple: float
    feedback: float
    late: float
    calm: float
    reach: float
    shift: float
    blend: float
    creep: float
    pulse: float
    pulse_samples: int
    spacing: int
    outer: float


@compiled
def think(
    tuned, setpoint, measured, torque, miss, noise, delay, wanted, gain, edge, unknown, nearest, gain_variance,
    edge_variance, probing, quick, speed, acceleration, before, direction, crossing, crept, bolting, pausing,
    law, aparts, behinds, effect,
):  # fmt: skip
    """Moves the reference, begins crossings and asks for flow (`law`), from the set-point (N,) and the speeds `measured`
    (N, 2) in rad/s. `delay` (N,): whole periods by which commands come late; `wanted` (periods, N, 2) and `before`
    (periods, N): flows asked for and references, newest first.
    """
    ahead = np.empty(2)
    for i in range(speed.size):
        motors = (measured[i, 0] + measured[i, 1]) / 2.0
        mean_load = (torque[i, 0] + torque[i, 1]) / 2.0
        load = tuned.per_torque * mean_load
        waits = crossing[i] or probing[i]

        # one period of the reference, by the flow it asks for
        held = tuned.per_speed * speed[i] + load
        now = held + tuned.per_acceleration * acceleration[i]
        unsure = np.sqrt(max(gain_variance[i, 0], gain_variance[i, 1])) / 0.12
        growth = tuned.growth * quick[i] / (1.0 + tuned.doubt * unsure)
        upward = growth if now >= 0.0 else tuned.fall * growth
        downward = growth if now <= 0.0 else tuned.fall * growth
        flow = held + tuned.per_acceleration * tuned.rate * quick[i] * (setpoint[i] - speed[i])
        flow = min(max(flow, now - downward), now + upward)
        least = tuned.most * min(_capacity(gain[i, 0], edge[i, 0, 1]), _capacity(gain[i, 1], edge[i, 1, 1]))
        most = tuned.most * min(_capacity(gain[i, 0], edge[i, 0, 0]), _capacity(gain[i, 1], edge[i, 1, 0]))
        faster = (min(max(flow, -least), most) - held) / tuned.per_acceleration
        for k in range(before.shape[0] - 1, 0, -1):
            before[k, i] = before[k - 1, i]
        if waits:
            speed[i] = motors
            acceleration[i] = 0.0 if probing[i] else -tuned.coasting * motors - mean_load / INERTIA
            before[:, i] = motors
        else:
            speed[i] += tuned.period * faster
            acceleration[i] = faster
            before[0, i] = speed[i]
        asked = tuned.per_speed * speed[i] + load + tuned.per_acceleration * faster

        # a crossing begins where the flow asked for changes its direction and an edge there is unknown
        if abs(asked) > 2.0 * FLOWING and np.sign(asked) != direction[i] and not probing[i]:
            direction[i] = np.sign(asked)
            d = 1 if direction[i] < 0.0 else 0
            crossing[i] = False
            for c in range(2):
                deviation = np.sqrt(edge_variance[i, c, d])
                crept[i, c] = nearest[i, c, d] if unknown[i, c, d] else edge[i, c, d] - 2.0 * deviation
                if deviation > tuned.known:
                    crossing[i] = True

        jump = tuned.jump * max(noise[i, 0], noise[i, 1])
        sudden = min(max((abs(miss[i, 0] - miss[i, 1]) - 2.0 * jump) / jump, 0.0), 1.0)
        bolting[i] = tuned.bolt * sudden if pausing[i] <= 0 and not probing[i] else 0.0
        pausing[i] = tuned.pause if bolting[i] > 0.0 else pausing[i] - 1

        # speed difference one period ahead, under the flows asked for last: whole periods until the last command comes
        # into effect, then what the spool takes
        late = delay[i]
        for c in range(2):
            ahead[c] = measured[i, c]
            for more in range(late + 1):
                share = tuned.share_period if more < late else tuned.share_lead
                flow = wanted[late - more, i, c]
                if tuned.mode:
                    final = (flow - tuned.per_torque * torque[i, c]) / tuned.per_speed
                    ahead[c] += share * (final - ahead[c])
                else:
                    rate = flow - tuned.per_speed * ahead[c] - tuned.per_torque * torque[i, c]
                    ahead[c] += share * (rate / tuned.per_acceleration)
        # the reference `delay` ago
        at = tuned.whole + late
        behinds[i] = (1.0 - tuned.part) * before[at, i] + tuned.part * before[at + 1, i] - motors
        feedback = tuned.feedback / (1.0 + tuned.late * late)
        worst = 0.0
        for c in range(2):
            aparts[i, c] = 0.5 * (ahead[c] - ahead[1 - c])
            correction = tuned.track * behinds[i] - tuned.couple * aparts[i, c]
            faster = acceleration[i] + feedback * correction
            law[i, c] = (
                tuned.per_speed * speed[i] + tuned.per_acceleration * faster + tuned.per_torque * torque[i, c]
            )
            worst = max(worst, abs(setpoint[i] - measured[i, c]))
        effect[i] = 1.0 if probing[i] else tuned.calm + (1.0 - tuned.calm) * min(worst / (100.0 * RPM), 1.0)


@compiled
def steer(
    tuned, given, law, seen_flow, noisier, gain, edge, edge_variance, direction, crossing, crept, probing, sides, swept,
    pulsed, bolting, asked, wanted, sent,
):  # fmt: skip
    """The commands `sent` (N, 2) for the flows asked for and a network's outputs `given` (N, 2, 3); `asked` (samples, N, 2)
    are the commands before the filter that leaves the spool at rest, oldest first.
    """
    flow, new = np.empty(2), np.empty(2)
    there = np.empty(2, np.bool_)
    for i in range(sent.shape[0]):
        # one valve at its limit: both give way, so that they stay together
        excess = 0.0
        for c in range(2):
            flow[c] = law[i, c] + tuned.reach * given[i, c, 0]
            d = 1 if flow[c] < 0.0 else 0
            excess = max(excess, abs(flow[c]) - _capacity(gain[i, c], edge[i, c, d]))
        for c in range(2):
            flow[c] -= np.sign(flow[c]) * excess
            new[c] = _command(flow[c], gain[i, c], edge[i, c, 0], edge[i, c, 1], tuned.blend)

        # looking for an edge on the way; one too far away: no flow is seen, a sick sensor
        d = 1 if direction[i] < 0.0 else 0
        for c in range(2):
            flows = direction[i] * seen_flow[i, c] > FLOWING * noisier[i, c]
            there[c] = flows or np.sqrt(edge_variance[i, c, d]) < tuned.known or crept[i, c] > 0.6
            if not there[c]:
                crept[i, c] += tuned.creep
        crossing[i] = crossing[i] and not (there[0] and there[1])
        if crossing[i]:
            for c in range(2):
                new[c] = direction[i] * (edge[i, c, d] + FLOWING / gain[i, c] if there[c] else crept[i, c])

        if probing[i]:
            level = 0.0
            if 0 < pulsed[i] <= 2 * tuned.pulse_samples:
                level = tuned.pulse if pulsed[i] <= tuned.pulse_samples else -tuned.pulse
            for c in range(2):
                if sides[i, c] < 2:
                    new[c] = swept[i, c] if sides[i, c] == 0 else -swept[i, c]
                else:
                    new[c] = _command(level, gain[i, c], edge[i, c, 0], edge[i, c, 1], tuned.blend)

        last = asked.shape[0] - 1
        for c in range(2):
            wanted[i, c] = 0.0 if crossing[i] or probing[i] else flow[c]
            newest = min(max(new[c] + tuned.shift * given[i, c, 1], -1.0), 1.0)
            ends, middle = newest + asked[0, i, c], asked[tuned.spacing, i, c]
            smooth = tuned.outer * ends + (1.0 - 2.0 * tuned.outer) * middle
            for k in range(last):
                asked[k, i, c] = asked[k + 1, i, c] + bolting[i] * (newest - asked[k + 1, i, c])
            asked[last, i, c] = newest
            sent[i, c] = min(max(smooth + bolting[i] * (newest - smooth), -1.0), 1.0)


@compiled
def _capacity(gain, edge):
    """Flow at the rated command in the direction of the edge."""
    return gain * max(1.0 - edge, 0.1)


@compiled
def _command(flow, gain, edge, other_edge, blend):
    """Command for a flow through a valve with its positive and its negative edge: below `blend` the jump over the dead zone
    is a ramp.
    """
    middle = 0.5 * (edge - other_edge)
    beyond = -(other_edge + abs(flow) / gain) if flow < 0.0 else edge + abs(flow) / gain
    return middle + min(abs(flow) / blend, 1.0) * (beyond - middle)


@compiled
def describe(
    inputs, rows, setpoint, speed, pressure, flow, sent, position, spool_speed, asked, law, wanted, torque, miss, edge,
    gain, edge_variance, gain_variance, unknown, surprise, crept, reference, acceleration, behind, direction, crossing,
    probing, effect, apart, past,
):  # fmt: skip
    """A network's `inputs` (n, 2, features) of the rigs `rows` (n,), which measure set-point, speed, pressure and flow (n, 2).
    A channel's own come first, then the other's, those of the rig, and what is remembered.
    """
    row = np.empty(inputs.shape[2])
    for k in range(rows.size):
        i = rows[k]
        for own in range(2):
            at = 0
            for c in (own, 1 - own):
                error = setpoint[k] - speed[k, c]
                row[at] = error / SPEED
                row[at + 1] = min(max(error / (60.0 * RPM), -1.0), 1.0)
                row[at + 2] = 2.0 * flow[k, c]
                row[at + 3] = pressure[k, c] / PRESSURE
                row[at + 4], row[at + 5], row[at + 6] = (
                    sent[i, c],
                    position[i, c],
                    spool_speed[i, c] / SPOOL_RATE,
                )
                row[at + 7], row[at + 8] = asked[-1, i, c], asked[0, i, c]
                row[at + 9], row[at + 10] = 2.0 * law[i, c], 2.0 * wanted[i, c]
                row[at + 11], row[at + 12] = torque[i, c], miss[i, c]
                row[at + 13], row[at + 14], row[at + 15] = (
                    4.0 * edge[i, c, 0],
                    4.0 * edge[i, c, 1],
                    gain[i, c],
                )
                row[at + 16] = 10.0 * min(np.sqrt(edge_variance[i, c, 0]), 0.1)
                row[at + 17] = 10.0 * min(np.sqrt(edge_variance[i, c, 1]), 0.1)
                row[at + 18] = 8.0 * np.sqrt(gain_variance[i, c])
                row[at + 19], row[at + 20] = unknown[i, c, 0], unknown[i, c, 1]
                row[at + 21], row[at + 22], row[at + 23] = (
                    20.0 * surprise[i, c],
                    4.0 * crept[i, c],
                    speed[k, c] / SPEED,
                )
                at += OWN
            row[at], row[at + 1] = setpoint[k] / SPEED, reference[i] / SPEED
            row[at + 2] = acceleration[i] / (20.0 * SPEED)
            row[at + 3], row[at + 4] = (setpoint[k] - reference[i]) / SPEED, behind[i] / (60.0 * RPM)
            row[at + 5], row[at + 6], row[at + 7], row[at + 8] = (
                direction[i],
                crossing[i],
                probing[i],
                effect[i],
            )
            ahead = speed[k, own] - speed[k, 1 - own]
            row[at + 9] = min(max(ahead / (60.0 * RPM), -1.0), 1.0)
            row[at + 10] = min(max(ahead / (10.0 * RPM), -1.0), 1.0)
            row[at + 11] = min(max(apart[i, own] / (10.0 * RPM), -1.0), 1.0)
            at += BOTH
            for frame in range(past.shape[0]):
                for n in range(FRAME):
                    row[at + n] = past[frame, i, own, n]
                at += FRAME
            for n in range(at):
                inputs[k, own, n] = min(max(row[n], -5.0), 5.0)

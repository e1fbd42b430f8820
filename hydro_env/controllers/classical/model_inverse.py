"""A controller made from a plant model: flow feed-forward and the inverse of the valves' curves, both as the model has them.

What `Compensated` measures on a valve bench and `AdaptiveFlow` learns on line, this one reads off a model: give it the
model that `hydro-env diagnose` wrote, and it drives the rig with what the diagnosis found. It learns nothing, so a wrong
model shows: feedback has to make up for it.
"""

from typing import Any

import numpy as np

from hydro_env.controllers.base import Controller, Floats, Gain, Measurements
from hydro_env.controllers.classical.reference import DoublePole
from hydro_env.controllers.input_shaping import InputShaper
from hydro_env.plant import Plant, PlantModel
from hydro_env.waveforms import triangle

#: Part of a valve's largest flow that the reference may ask for; the rest is left to feedback.
RESERVE = 0.9
#: Control periods between a command and the speed that it makes, about: filter, hold, coil and spool.
LAG = 2


def flow_curve(model: PlantModel) -> tuple[Floats, Floats]:
    """Steady flow of a model's valves: commands (201,) in [-1, 1] and flows (201, 2) in m3/s, not falling.

    As on a valve bench: one slow triangle over the whole range, whose rising and falling branches are averaged, with the
    motors running free.
    """
    period, steps = 0.01, 800
    share = triangle(np.arange(steps) / steps)
    command = share[:, None] * np.array(model.pair("u_rated"))
    flow = Plant(model).run(command, None, period, ["flow"])["flow"][1:, 0]
    share = share[:-1]  # a row of the run is the state before its command acts
    falls = np.gradient(share) < 0.0
    grid = np.linspace(-1.0, 1.0, 201)
    branches = []
    for branch in (falls, ~falls):
        order = np.argsort(share[branch], kind="stable")
        at, of = share[branch][order], flow[branch][order]
        branches.append(np.stack([np.interp(grid, at, of[:, c]) for c in (0, 1)], axis=1))
    return grid, np.maximum.accumulate(np.mean(branches, axis=0), axis=0)


class ModelInverse(Controller):
    """Both motors follow one reference; the flow this takes by the model's motors goes through the model's valves, inverted.

    The reference is the set-point through a double pole at `rate`, no faster than the weaker valve of the model allows.
    Feedback asks for acceleration: a PI on each motor's error to the reference, and a proportional part on its distance to
    the mean of both. Three successive commands are averaged so that the spool's lightly damped mode stays at rest.
    """

    GAINS = (
        Gain("rate", "1/s", 10.0, 60.0, summary="double pole of the reference: 2 / rate is its mean delay"),
        Gain("Kp", "1/s", 2.0, 40.0, summary="acceleration per error to the reference speed"),
        Gain("Ti", "s", 0.03, 1.0, summary="integral time on that error"),
        Gain("Ks", "1/s", 2.0, 80.0, summary="acceleration per distance to the mean of both motors"),
        Gain("blend", "1", 1e-3, 0.1, summary="share of the largest flow below which the inverse is a ramp"),
    )

    def __init__(self, name: str | None = None, /, *, model: PlantModel, **gains: Any) -> None:
        super().__init__(name, **gains)
        self.model = model
        self._motor = {key: np.array(model.pair(key)) for key in ("D", "Km", "J", "B", "k", "m")}
        self._commands, self._flows = flow_curve(model)
        self._largest = np.stack([self._flows[-1], -self._flows[0]], axis=1)  # (2 channels, 2 directions)
        # Where the flow begins in either direction, (2 directions, 2 channels).
        small = 2e-3 * self._largest.max()
        opens, closes = np.argmax(self._flows > small, axis=0), np.argmax(self._flows[::-1] < -small, axis=0)
        self._edges = np.stack([self._commands[opens], self._commands[::-1][closes]])

    def start(self, measured: Measurements) -> None:
        self._reference = DoublePole(np.mean(measured.speed, axis=1), self.gains["rate"], self.period)
        self._past = [self._reference.speed] * (LAG + 1)
        self._sum = np.zeros_like(measured.speed)
        rate = float(np.mean(np.sqrt(self._motor["k"] / self._motor["m"])))
        self._shaper = InputShaper(rate, self.period, measured.command.astype(float))

    def command(self, measured: Measurements) -> Floats:
        # Columns, in which a gain may have one row per rig.
        kp, ti, ks, blend = (np.reshape(self.gains[key], (-1, 1)) for key in ("Kp", "Ti", "Ks", "blend"))
        self._move_reference(measured.setpoint)
        error = self._past[0][:, None] - measured.speed
        apart = np.mean(measured.speed, axis=1, keepdims=True) - measured.speed
        grown = self._sum + self.period / ti * kp * error
        asked = self._reference.acceleration[:, None] + kp * error + ks * apart
        flow = self._flow(self._reference.speed[:, None], asked + grown)
        beyond = np.where(flow > 0.0, flow > self._largest[:, 0], -flow > self._largest[:, 1])
        self._sum = np.where(beyond & (error * flow > 0.0), self._sum, grown)  # no further into a limit
        return self._shaper.step(self._inverse(flow, blend))

    def _flow(self, speed: Floats, acceleration: Floats) -> Floats:
        """What the model's motors take without load, m3/s: eq. (1) and (3)."""
        p = self._motor
        return p["D"] * speed + p["Km"] / p["D"] * (p["J"] * acceleration + p["B"] * speed)

    def _move_reference(self, setpoint: Floats) -> None:
        """One period of the reference, no faster than the weaker valve allows."""
        r, p = self._reference, self._motor
        speed, wanted = r.ahead(setpoint)
        held, growth = self._flow(r.speed[:, None], np.zeros(2)), p["Km"] * p["J"] / p["D"]
        upper = np.min((RESERVE * self._largest[:, 0] - held) / growth, axis=1)
        lower = np.max((-RESERVE * self._largest[:, 1] - held) / growth, axis=1)
        limited = np.clip(wanted, np.minimum(lower, 0.0), np.maximum(upper, 0.0))
        r.speed = np.where(limited == wanted, speed, r.speed + self.period * limited)
        r.acceleration = limited
        self._past = [*self._past[1:], r.speed]

    def _inverse(self, flow: Floats, blend: Floats) -> Floats:
        """Commands for flows, both (num_rigs, 2); the jump over the dead zone is a ramp for flows below `blend`."""
        curves = [_rising(self._flows[:, c], self._commands) for c in (0, 1)]
        command = np.stack([np.interp(flow[:, c], *curves[c]) for c in (0, 1)], axis=1)
        share = np.clip(np.abs(flow) / (blend * self._largest.max()), 0.0, 1.0)
        middle = 0.5 * (self._edges[0] + self._edges[1])
        edge = np.where(flow < 0.0, self._edges[1], self._edges[0])
        return command + (share - 1.0) * (edge - middle)


def _rising(flow: Floats, command: Floats) -> tuple[Floats, Floats]:
    """The rows of a curve at which the flow rises, so that it can be read the other way round."""
    rises = np.concatenate([[True], np.diff(flow) > 1e-9 * np.ptp(flow)])
    return flow[rises], command[rises]

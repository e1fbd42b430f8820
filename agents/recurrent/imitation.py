"""The first stage: the network imitates the law that probes and plans, in the states that the network itself visits (DAgger;
Ross, Gordon and Bagnell, A reduction of imitation learning and structured prediction to no-regret online learning, 2011).

A share of the rigs that grows from none to nearly all is driven by the network. The law follows along on every rig: its
estimates take in what was sent, whoever sent it, and it says what it would send. The network is to send the same, and a second
head is to say from the recurrent state where gains and edges of the valves truly are, and what the law knows of the moment.
That is how the state learns what to keep.
"""

from __future__ import annotations

from math import cos, pi
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from agents.recurrent.network import RecurrentPolicy
from agents.recurrent.rigs import KNOWN, Rigs
from agents.recurrent.settings import MILLION, Settings
from hydro_env.controllers.mpc.flow_controller import FlowController, FlowSettings
from hydro_env.controllers.mpc.planner import PlannerSettings
from hydro_env.envs.observation import OBSERVATION, SCALES, decode

SPEED = SCALES[OBSERVATION.index("speed_1")]
SENT = slice(OBSERVATION.index("command_1"), OBSERVATION.index("command_2") + 1)
NOTES = 16
"""Numbers of what the law knows of the moment that the network is to know as well."""
LAW = FlowSettings(planner=PlannerSettings(turns=1))
"""With one step of its planner a period instead of four: half the time, and 0.1 rpm worse."""
COMMANDS = 10.0
"""Weight of the commands' loss, which brings it to the size of the notes'."""


class Teacher:
    """The law, asked about rigs that others drive."""

    def __init__(self, observation: NDArray[Any], period: float) -> None:
        self._law = FlowController(LAW)
        self._law.start(decode(observation), period)

    def command(self) -> NDArray[np.float64]:
        """What the law would send, (num_rigs, 2)."""
        return self._law.command()

    def see(self, observation: NDArray[Any], followed: NDArray[np.bool_]) -> None:
        """Takes in the next observation (num_rigs, 9), in which stands what was sent; `followed`: whether that was the law's."""
        law, sent = self._law, observation[:, SENT].astype(float)
        law.sent = sent
        law.shaper.replace(~followed[:, None], sent)
        law.update(decode(observation))

    def restart(self, rigs: NDArray[np.int64], observation: NDArray[Any]) -> None:
        """Begins again with the first observations (n, 9) of some rigs."""
        if not rigs.size:
            return
        begun = FlowController(LAW)
        begun.start(decode(observation), self._law.period)
        if rigs.size == len(self._law.sent):
            self._law = begun
        else:
            _put(self._law, rigs, begun)

    def notes(self) -> NDArray[np.float64]:
        """What the law knows, (num_rigs, NOTES), scaled to about one: spools, loads, speeds, reference, phase."""
        law, e = self._law, self._law.estimator
        speeds, reference = e.motors.state.speed, law.reference.state
        return np.concatenate(
            [
                3.0 * e.spool.position, e.spool.speed / 100.0, e.motors.state.torque, 2.0 * speeds / SPEED,
                2.0 * reference.speed[:, None] / SPEED, reference.acceleration[:, None] / (20.0 * SPEED),
                law.probing.active[:, None], law.crossing.state.active[:, None],
                10.0 * (speeds - reference.speed[:, None]) / SPEED, 4.0 * law.wanted,
            ],
            axis=1,
        )  # fmt: skip


def _put(into: Any, rigs: NDArray[np.int64], part: Any) -> None:
    """Puts what `part` keeps of some rigs, fewer than all, in their place: the axis of rigs of an array is the one whose lengths
    differ."""
    if isinstance(into, np.ndarray):
        for axis in np.flatnonzero(np.not_equal(into.shape, part.shape)).tolist():
            into.swapaxes(0, axis)[rigs] = part.swapaxes(0, axis)
    elif isinstance(into, list | tuple):
        for own, other in zip(into, part, strict=True):
            _put(own, rigs, other)
    elif hasattr(into, "__dict__"):
        for name, own in vars(into).items():
            _put(own, rigs, getattr(part, name))


class PiTeacher:
    """PI controllers on speeds and speed difference, as changes of the command: all that they need is in two observations."""

    def __init__(self, observation: NDArray[Any], period: float) -> None:
        self._before = self._newest = observation.astype(float)
        self._integral = np.array([7.7, 2.0]) * period

    def command(self) -> NDArray[np.float64]:
        """What they would send, (num_rigs, 2)."""
        (error, apart), (error_before, apart_before) = _errors(self._newest), _errors(self._before)
        step = self._newest[:, :1] - self._before[:, :1]
        change = 0.066 * (error - error_before - 0.5 * step) + 0.022 * (apart - apart_before)
        change += self._integral[0] * error + self._integral[1] * apart
        return (self._newest[:, SENT] + change).clip(-1.0, 1.0)

    def see(self, observation: NDArray[Any], followed: NDArray[np.bool_]) -> None:
        """Takes in the next observation (num_rigs, 9)."""
        self._before, self._newest = self._newest, observation.astype(float)

    def restart(self, rigs: NDArray[np.int64], observation: NDArray[Any]) -> None:
        """Begins again with the first observations (n, 9) of some rigs."""
        self._before[rigs] = self._newest[rigs] = observation

    def notes(self) -> NDArray[np.float64]:
        """They know nothing of the moment."""
        return np.zeros((len(self._newest), NOTES))


def _errors(observation: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tracking errors (num_rigs, 2) and how far each motor is behind the other (num_rigs, 2), scaled."""
    speed = observation[:, 1:3]
    return observation[:, :1] - speed, speed[:, ::-1] - speed


class ImitationStage:
    """`window()` drives one window and learns from it; `done` counts control periods of single rigs."""

    def __init__(self, settings: Settings, policy: RecurrentPolicy, done: int) -> None:
        s = self.settings = settings.imitation
        self.policy, self.done, self.total = policy, done, int(s.periods * MILLION)
        # another seed after a resume: other episodes than those driven before
        self._stream = np.random.default_rng([settings.training.seed, done])
        self.rigs = Rigs(settings, s.rigs, s.window, seed=int(self._stream.integers(2**40)))
        self.optimiser = torch.optim.Adam(policy.parameters(), lr=s.rate, betas=(0.9, 0.98))
        self._teacher = (Teacher if s.law else PiTeacher)(self.rigs.observation, self.rigs.env.control_period)
        self._state = torch.zeros(s.rigs, policy.units)
        self._inputs = torch.zeros(s.window, s.rigs, policy.num_inputs)
        self._labels, self._notes = (
            torch.zeros(s.window, s.rigs, 2),
            torch.zeros(s.window, s.rigs, KNOWN + NOTES),
        )

    def window(self) -> dict[str, float]:
        """Returns the mean absolute error of the commands and the mean squares of gains' and edges' errors, of the last batch."""
        s, begun = self.settings, self._state
        self._drive()
        fraction = min(1.0, self.done / self.total)
        warm = min(1.0, (self.done + 1) / (50.0 * s.window * s.rigs))
        for group in self.optimiser.param_groups:
            group["lr"] = s.rate * warm * max(0.03, 0.5 * (1.0 + cos(pi * fraction)))
        for _ in range(s.epochs):
            order = torch.from_numpy(self._stream.permutation(s.rigs))
            for rigs in order.split(s.batch):
                said = self._learn(rigs, begun)
        self.done += s.window * s.rigs
        return said

    @torch.no_grad()
    def _drive(self) -> None:
        s, rigs = self.settings, self.rigs
        share = min(s.share, self.done / (s.handover * MILLION))
        followed = self._stream.random(s.rigs) >= share
        state, valves = self._state, rigs.valves()
        for t in range(s.window):
            self._inputs[t] = rigs.inputs()
            commands, state = self.policy.step(self._inputs[t], state)
            labels = self._teacher.command()
            self._labels[t] = torch.from_numpy(labels)
            self._notes[t] = torch.from_numpy(np.concatenate([valves, self._teacher.notes()], axis=1))
            rigs.step(np.where(followed[:, None], labels, commands.numpy()))
            self._teacher.see(rigs.observation, followed)
        begun = rigs.next_window()
        self._teacher.restart(begun, rigs.observation[begun])
        self._state = state.clone()
        self._state[begun] = 0.0

    def _learn(self, rigs: Tensor, begun: Tensor) -> dict[str, float]:
        """A step of the optimiser with the window of some rigs."""
        s = self.settings
        commands, notes = self.policy(self._inputs[:, rigs], begun[rigs])
        error = commands - self._labels[:, rigs]
        # near an edge an error of one per cent is a motor that stands: it has to count beside the large ones
        of_commands = COMMANDS * s.precise * (torch.sqrt(1.0 + (error / s.precise) ** 2) - 1.0).mean()
        of_each = (notes - self._notes[:, rigs]).square().mean((0, 1))
        of_notes = of_each.mean()
        self.optimiser.zero_grad(set_to_none=True)
        (of_commands + s.notes * of_notes).backward()
        nn.utils.clip_grad_norm_(self.policy.parameters(), 0.5)
        self.optimiser.step()
        gains, edges = of_each[:2].mean().item(), of_each[2:KNOWN].mean().item()
        return {"command_error": error.detach().abs().mean().item(), "gains": gains, "edges": edges}

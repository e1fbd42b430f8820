"""The second stage: the gradient of the cost through the simulator (as in Xu et al., Accelerated policy learning with parallel
differentiable simulation, 2022).

How a rig's state after a control period depends on its state and on the commands that act in it is found by forward differences:
copies of all rigs, each with one state or one command shifted a little, are simulated beside them. The copies of a rig take the
same steps, so that the choice of steps is in no difference (internal numerical differentiation, Bock 1981). Both channels are
shifted at once: what they do to each other within a period, through a drooping supply, is some per cent and left out. With these
slopes the cost of a window is differentiated by the network's weights: through plant, delay line, sensors and recurrent state,
back to the window's beginning. Which states are shifted is measured at the start (`felt_states`).

A closed loop over many dead zones and stick-slips multiplies small changes without bound, so what is propagated back is bounded
(`Bounded`): of each rig by a largest length, and the plant's part by a decay. There is no noise on the commands and no critic.
"""

from __future__ import annotations

from copy import deepcopy
from math import ceil, cos, exp, log, pi
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.autograd.function import Function, once_differentiable

from agents.recurrent.network import RecurrentPolicy
from agents.recurrent.rigs import KNOWN, Rigs
from agents.recurrent.settings import MILLION, Gradient, Settings
from hydro_env.envs.observation import OBSERVATION, SCALES
from hydro_env.plant import Plant
from hydro_env.plant.plant import BLOCKS
from hydro_env.units import RPM

SPEED, CURRENT, PRESSURE = (
    float(SCALES[OBSERVATION.index(f"{name}_1")]) for name in ("speed", "current", "pressure")
)
FELT = 0.05
"""A state counts if a change of its usual size moves a speed, or its reading, by more than this share of the usual one."""
AHEAD, STARTS = 6, 5
"""Periods within which that is to be felt, and the times of a random drive at which it is tried."""
USUAL = 0.5
"""Largest command of that drive, of the rated one."""
STEP = 0.005
"""By which states are shifted, of their usual size."""
SHIFT = 0.03
"""By which the commands are shifted: of the rated one, up or down by chance. A spool that sticks does not follow a smaller shift
(friction is up to 2.7 % of the rated command), although a policy that changes moves it sooner or later."""
READINGS = {"measured_speed": SPEED, "current": CURRENT, "pressure": PRESSURE}
"""What the sensors show, and what 1 stands for: the middle of an observation, two columns each."""
TO_RPM = SPEED / RPM
SMOOTHED_COST = 0.1
"""How much of the cost of the newest window is taken into what is usual for a rig: a few windows make up an episode."""
INTEGRAL, PROPORTIONAL, SMOOTHED = 0.01, 1.0, 0.05
"""Of the logarithm of the tracking error's weight: what a relative excess over the bound adds in an update, what the smoothed
excess adds while it lasts, and how much of the newest excess is taken into that."""


def copies_of(plant: Plant, block: int) -> tuple[Plant, NDArray[np.int64]]:
    """Copies of all rigs that take the same steps, a block to a rig, and the rig of each."""
    of = np.repeat(np.arange(plant.num_rigs), block)
    twins = Plant(
        plant.model, len(of), effects=plant.effects, tolerance=plant.tolerance,
        dtype=plant.memory.dtype, block=block, grouped=True,
    )  # fmt: skip
    twins.take_state(plant, of, parameters=True)
    return twins, of


def felt_states(rigs: Rigs, stream: np.random.Generator) -> dict[str, float]:
    """The states whose changes are felt, the most felt one first, with their usual sizes (root of the mean square, SI). The angle
    is left out: nobody steers its phase."""
    rigs = deepcopy(rigs)
    plant, n, command = rigs.plant, rigs.num_rigs, np.zeros((rigs.num_rigs, 2))

    def drive() -> None:
        np.copyto(command, stream.uniform(-USUAL, USUAL, (n, 2)), where=stream.random((n, 2)) < 0.3)
        rigs.step(command)

    squares = dict.fromkeys((name for name in plant.states if name != "angle"), 0.0)
    for _ in range(STARTS * AHEAD):
        drive()
        for name in squares:
            squares[name] += np.square(plant.get(name)).mean() / (STARTS * AHEAD)
    sizes = {name: float(np.sqrt(square)) for name, square in squares.items() if square > 0.0}
    felt, pairs = dict.fromkeys(sizes, 0.0), {name: copies_of(plant, 2) for name in sizes}
    for t in range(STARTS * AHEAD):
        for name, (twins, of) in pairs.items() if t % AHEAD == 0 else ():
            twins.take_state(plant, of)
            twins.shift(name, STEP * sizes[name], slice(1, None, 2))
        drive()
        for name, (twins, of) in pairs.items():
            twins.step(plant.get("command")[of], plant.get("load")[of], rigs.env.control_period)
            for seen in ("speed", "measured_speed"):
                moved = np.diff(twins.get(seen).reshape(n, 2, 2), axis=1) / (STEP * sizes["speed"])
                felt[name] = max(felt[name], float(np.sqrt(np.square(moved).mean())))
    return {name: sizes[name] for name in sorted(felt, key=lambda name: -felt[name]) if felt[name] > FELT}


class Slopes:
    """Forward differences of a control period, on copies of the rigs: first of each rig as it is, then with each state shifted,
    then with each command that may act in the period: the newest one, and those on their way, `commands` in all (half a block at
    most)."""

    def __init__(self, rigs: Rigs, stream: np.random.Generator) -> None:
        self._rigs, self._stream = rigs, stream
        periods = ceil(rigs.plant.delay.max() / rigs.env.control_period - 1e-6)
        self.commands = min(1 + periods, BLOCKS[-1] // 2)
        sizes = felt_states(rigs, stream)
        self.states = list(sizes)[: BLOCKS[-1] - 1 - self.commands]
        self._scales = {name: sizes[name] for name in self.states} | {"speed": SPEED} | READINGS
        columns = list(self._scales)
        self.speed, self.readings = columns.index("speed"), [columns.index(name) for name in READINGS]
        self._shifts = len(self.states) + self.commands
        self._block = min(size for size in BLOCKS if size > self._shifts)
        self._twins, self._of = copies_of(rigs.plant, self._block)

    def match(self) -> None:
        """Gives the copies their rigs' parameters."""
        self._twins.take_state(self._rigs.plant, self._of, parameters=True)

    def before(self) -> None:
        """Puts the copies beside their rigs, which stand at the beginning of a period."""
        plant, twins, last = self._rigs.plant, self._twins, len(self.states) + 1
        self._up = self._stream.choice([-SHIFT, SHIFT], (plant.num_rigs, 2))
        self._more = self._up * plant.get("u_rated")
        twins.take_state(plant, self._of)
        for k, name in enumerate(self.states, 1):
            twins.shift(name, STEP * self._scales[name], slice(k, None, self._block))
        for ago in range(1, self.commands):
            twins.shift_sent(ago, self._more, slice(last + ago, None, self._block))

    def after(self) -> tuple[Tensor, Tensor]:
        """The scaled states and readings (num_rigs, 2, columns) of the rigs, which have gone through the period, and their slopes
        by what was shifted, (shifts, num_rigs, 2, columns): by the states, which are the first columns, and by the commands, the
        newest first."""
        plant, states = self._rigs.plant, len(self.states)
        command = plant.get("command")[self._of]
        command[states + 1 :: self._block] += self._more
        self._twins.step(command, plant.get("load")[self._of], self._rigs.env.control_period)
        moved = self.columns(self._twins).unflatten(0, (-1, self._block)).transpose(0, 1)
        slopes = moved[1 : self._shifts + 1] - moved[0]
        slopes[:states] /= STEP
        slopes[states:] /= torch.from_numpy(self._up.astype(np.float32))[..., None]
        return self.columns(), slopes

    def columns(self, plant: Plant | None = None) -> Tensor:
        """Scaled states and readings of all rigs, (num_rigs, 2, columns)."""
        get = (plant or self._rigs.plant).get
        return torch.from_numpy(
            np.stack([get(name) / scale for name, scale in self._scales.items()], axis=-1).astype(np.float32)
        )


class Period(Function):
    """The states after a period, whose gradient by the states before and the commands (commands, N, 2) is that of the slopes."""

    @staticmethod
    def forward(ctx: Any, before: Tensor, commands: Tensor, after: Tensor, slopes: Tensor) -> Tensor:
        ctx.save_for_backward(slopes)
        ctx.states = len(slopes) - len(commands)
        return after.clone()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, Tensor, None, None]:
        (slopes,) = ctx.saved_tensors
        by = (slopes * gradient).sum(-1)  # (shifts, N, 2)
        before = torch.zeros_like(gradient)
        before[..., : ctx.states] = by[: ctx.states].permute(1, 2, 0)
        return before, by[ctx.states :], None, None


class Bounded(Function):
    """The values as they are; their gradient is multiplied by `keep` and, for each rig, at most `most` long."""

    @staticmethod
    def forward(ctx: Any, values: Tensor, most: float, keep: float) -> Tensor:
        ctx.most, ctx.keep = most, keep
        return values.view_as(values)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> tuple[Tensor, None, None]:
        length = gradient.flatten(1).norm(dim=1).clamp(min=1e-9)
        factor = ctx.keep * (ctx.most / length).clamp(max=1.0)
        return gradient * factor.view(-1, *[1] * (gradient.dim() - 1)), None, None


class GradientStage:
    """`window()` drives one window of every group of rigs and learns from them; `done` counts control periods of single rigs."""

    def __init__(self, settings: Settings, policy: RecurrentPolicy, done: int) -> None:
        s = self.settings = settings.gradient
        self.policy, self.done, self.total = policy, done, int(s.periods * MILLION)
        stream = np.random.default_rng([settings.training.seed, 1, done])
        self.groups = [Group(settings, env, own, policy, stream) for env, own in settings.driven]
        self.optimiser = torch.optim.Adam(policy.parameters(), lr=s.rate, betas=(0.9, 0.98))
        self._updates = 0
        # beside the optimiser's own state, so that it is in the checkpoint
        integrals = [log(group.settings.tracking) for group in self.groups]
        self.optimiser.param_groups[0].update(integral=integrals, excess=[0.0] * len(integrals))

    def window(self) -> dict[str, float]:
        """Returns the mean costs of a period: speed difference, tracking error in rpm, travel; the notes' loss on the valves; and
        the weight of tracking; of each group, numbered from the second on."""
        s, kept = self.settings, self.optimiser.param_groups[0]
        self.optimiser.zero_grad(set_to_none=True)
        rigs = sum(group.rigs.num_rigs for group in self.groups)
        found: dict[str, float] = {}
        for n, group in enumerate(self.groups):
            # A Lagrange multiplier with a proportional part, which damps it (Stooke, Achiam and Abbeel, Responsive safety in
            # reinforcement learning by PID Lagrangian methods, 2020).
            weight = exp(kept["integral"][n] + PROPORTIONAL * kept["excess"][n])
            said = group.learn(weight)
            bound = group.settings.bound
            excess = min(said["tracking"] / bound - 1.0, 1.0) if bound else 0.0
            kept["excess"][n] += SMOOTHED * (excess - kept["excess"][n])
            kept["integral"][n] += INTEGRAL * excess
            found |= {
                f"{key}{n + 1}" if n else key: value for key, value in {**said, "weight": weight}.items()
            }
        for each in self.policy.parameters():
            assert each.grad is not None  # the heads have one as well
            each.grad /= rigs * s.window
        size = nn.utils.clip_grad_norm_(self.policy.parameters(), 1.0)
        warm = min(1.0, (self._updates + 1) / 30.0)  # Adam knows nothing of the gradients' size yet
        fraction = min(1.0, self.done / self.total)
        for group in self.optimiser.param_groups:
            group["lr"] = s.rate * warm * max(0.05, 0.5 * (1.0 + cos(pi * fraction)))
        if torch.isfinite(size):
            self.optimiser.step()
        self._updates += 1
        self.done += s.window * rigs
        return found


class Group:
    """Rigs of one kind, driven in windows."""

    def __init__(
        self,
        settings: Settings,
        env: dict[str, Any],
        own: Gradient,
        policy: RecurrentPolicy,
        stream: np.random.Generator,
    ) -> None:
        self.settings, self.policy = own, policy
        self.rigs = Rigs(settings, own.rigs, own.window, int(stream.integers(2**40)), env)
        self._slopes = Slopes(self.rigs, stream)
        self._state = torch.zeros(own.rigs, policy.units)
        self._usual = torch.zeros(own.rigs)  # cost of a period of each rig, smoothed

    def learn(self, weight: float) -> dict[str, float]:
        """Drives a window and adds the gradient of its cost to that of the network's weights, summed over rigs, so that bounds on
        one rig's gradient do not depend on how many there are. Returns the mean costs of a period on rigs without a fault,
        or on all if each has one."""
        s = self.settings
        parts, notes = self._drive()
        costs = (parts * torch.tensor([1.0, weight, 1.0])).sum(1)
        healthy = torch.from_numpy(self.rigs.healthy if self.rigs.healthy.any() else ~self.rigs.healthy)
        # Rigs on which little is possible, as with a faulty sensor, would drown the others.
        share = s.relative / (s.relative + self._usual)
        (s.window * ((share * costs).sum() + s.notes * notes * s.rigs)).backward()
        self._usual += SMOOTHED_COST * (costs.detach() - self._usual)
        begun = self.rigs.next_window()
        self._state[begun], self._usual[begun] = 0.0, self._usual.mean()
        self._slopes.match()
        found = [*parts.detach()[healthy].mean(0).tolist(), notes.item()]
        return dict(zip(("difference", "tracking", "travel", "valves"), found, strict=True))

    def _drive(self) -> tuple[Tensor, Tensor]:
        """The mean costs (num_rigs, 3) of a period, see `_costs`, and the mean loss of the notes, which can be differentiated by
        the network's weights."""
        s, rigs, policy = self.settings, self.rigs, self.policy
        state, plant = self._state, self._slopes.columns()
        sent = torch.from_numpy(rigs.observation[:, -2:])
        before = torch.from_numpy(rigs.before)
        valves = torch.from_numpy(rigs.valves().astype(np.float32))
        total, notes = torch.zeros(s.rigs, 3), torch.zeros(())
        under_way = [sent] * self._slopes.commands
        for t in range(s.window):
            setpoint = rigs.observation[:, :1] * (SCALES[0] / RPM)
            if t > 0:
                state = Bounded.apply(state, s.max_memory, s.keep_memory)
                plant = Bounded.apply(plant, s.max_state, s.keep_state)
                sent = Bounded.apply(sent, s.max_command, 1.0)
            seen = self._seen(plant, sent) if t > 0 else torch.from_numpy(rigs.observation)
            commands, state = policy.step(torch.cat([before, seen], 1), state)
            commands = commands.clamp(-1.0, 1.0)
            notes = notes + (policy.note(state)[:, :KNOWN] - valves).square().mean()
            self._slopes.before()
            rigs.step(commands.detach().numpy())
            under_way = [commands, *under_way[:-1]]
            plant = Period.apply(plant, torch.stack(under_way), *self._slopes.after())
            speed = TO_RPM * plant[..., self._slopes.speed]
            total = total + _costs(s, speed, torch.from_numpy(setpoint), commands - sent)
            sent, before = commands, seen
        self._state = state.detach().clone()
        return total / s.window, notes / s.window

    def _seen(self, plant: Tensor, sent: Tensor) -> Tensor:
        """The observation (N, 9), which moves with the states and commands it was taken from."""
        moving = torch.cat([plant[..., self._slopes.readings].transpose(1, 2).flatten(1), sent], 1)
        moving = Bounded.apply(moving, self.settings.max_reading, 1.0)
        shown = torch.from_numpy(self.rigs.observation)
        return shown + nn.functional.pad(moving - moving.detach(), (1, 0))


def _costs(s: Gradient, speed: Tensor, setpoint: Tensor, move: Tensor) -> Tensor:
    """The costs (N, 3) of a period, tracking without its weight: speeds (N, 2) and set-point (N, 1) in rpm, moves (N, 2) of the
    commands."""
    apart = (speed[:, 0] - speed[:, 1]).abs()
    beyond = s.huber_threshold * (2.0 * apart - s.huber_threshold)
    difference = torch.where(apart < s.huber_threshold, apart**2, beyond) / 100.0
    tracking = (speed - setpoint).abs().mean(1)
    return torch.stack([s.difference * difference, tracking, s.travel * move.abs().mean(1)], 1)

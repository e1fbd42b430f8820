"""What a policy needs, tried row by row: `python -m agents.ablations ROW [ROW ...] --seeds 0 1 --out runs/trials`.

Every row trains a policy of its own kind for 250,000 control periods on pairs of `train`, with the settings of
configs/ppo.yml (direct commands: configs/close_loop.yml), picks the best by the score of configs/ppo.yml on the same pairs
of `val`, and is scored on further pairs of `val`; `--steps 0` scores the law alone. Rows differ in

* what the network sees: the plain observation (`plain`), or what `FlowView` makes of it;
* what its outputs do: `residual` on the law's flow, command and pace as the shipped agents have them, `added` to the law's
  commands, or `direct` commands (while the law probes at rest, the law's);
* memory: none beyond the view's, a longer history of samples, or a recurrent layer;
* what it learns from: PPO with or without a critic that is told the true valves and spools, a curriculum that begins
  without dead zones and mismatch, or a teacher whose commands it imitates where it drives itself (DAgger): the law told
  the true valves, or the oracle.

These are experiments: PPO here is a loop of its own because Stable-Baselines3's cannot tell the critic more than the
policy and is slow with recurrent layers; nothing is resumed, and only scores are kept (`OUT/ROW_SEED.json`).
"""

from __future__ import annotations

import argparse
import copy
import json
import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from agents.checkpoint import write_whole
from agents.config import Config, read_config
from agents.evaluate import METRICS
from agents.policy_env import ViewVecEnv
from agents.train import cleanly, staggered
from hydro_env.benchmark.statistics import iqm
from hydro_env.controllers import make_controller
from hydro_env.controllers.estimation.valve_map import true_map
from hydro_env.controllers.learned.policy_interface import View, make_view
from hydro_env.controllers.mpc.flow_controller import RATED_TRAVEL, FlowView
from hydro_env.controllers.mpc.flow_law import SPOOL_RATE
from hydro_env.controllers.rollout import roll_out
from hydro_env.envs.batch import HydraulicSyncVectorEnv
from hydro_env.errors import InputError
from hydro_env.plant import Plant
from hydro_env.sb3 import HydraulicSyncVecEnv
from hydro_env.tasks.mismatch import Mismatch, load_mismatch

__all__ = ["TRIALS", "Trial", "run"]

CONFIGS = Path(__file__).parents[1] / "configs"
WIDTH = 64
FINAL = range(256, 512)
"""Pairs of `val` that score the policy of a trial; those before may choose it."""

Floats = NDArray[np.floating[Any]]


@dataclass(frozen=True)
class Trial:
    """A row of the table.

    Attributes:
        view: settings of the view; {} for the plain observation.
        outputs: "residual", "added" or "direct"; a plain observation knows only direct commands.
        recurrent: whether policy (and critic) have a recurrent layer in the middle.
        told: whether the critic sees the true valves and spools.
        curriculum: whether mismatch and dead zones grow over the first half.
        teacher: "" for PPO, "law" or "oracle".
        spread: logarithm of the standard deviation of exploration at the start.
        settings: the training file that PPO's arguments and reward are from. The reward of configs/ppo.yml teaches direct
            commands to stand still.
    """

    view: dict[str, Any] = field(default_factory=lambda: {"kind": "flow"})
    outputs: str = "residual"
    recurrent: bool = False
    told: bool = False
    curriculum: bool = False
    teacher: str = ""
    spread: float = -2.0
    settings: str = "ppo.yml"


DIRECT = Trial(outputs="direct", spread=-1.5, settings="close_loop.yml")
PLAIN = replace(DIRECT, view={"kind": "frames", "frames": 1})
TRIALS = {
    "shipped": Trial(),
    "history": Trial({"kind": "flow", "frames": 16}),
    "recurrent": Trial(recurrent=True),
    "told_critic": Trial(told=True),
    "recurrent_told_critic": Trial(recurrent=True, told=True),
    "curriculum": Trial(curriculum=True),
    "added": Trial(outputs="added"),
    "direct": DIRECT,
    "direct_recurrent": replace(DIRECT, recurrent=True),
    "plain": PLAIN,
    "plain_history": replace(PLAIN, view={"kind": "frames", "frames": 16}),
    "plain_recurrent": replace(PLAIN, recurrent=True),
    "plain_recurrent_told_critic": replace(PLAIN, recurrent=True, told=True),
    "plain_curriculum": replace(PLAIN, recurrent=True, curriculum=True),
    "law_to_plain": replace(PLAIN, recurrent=True, teacher="law"),
    "law_to_added": Trial(outputs="added", recurrent=True, teacher="law"),
    "law_to_added_no_memory": Trial(outputs="added", teacher="law"),
    "oracle_to_plain": replace(PLAIN, recurrent=True, teacher="oracle"),
    "oracle_to_added": Trial(outputs="added", recurrent=True, teacher="oracle"),
    "oracle_to_direct": replace(DIRECT, recurrent=True, teacher="oracle"),
}


def config_of(trial: Trial) -> Config:
    """The training file of a row: plant, pairs, steps of a lesson and judgement are those of configs/ppo.yml."""
    shipped, own = read_config(CONFIGS / "ppo.yml"), read_config(CONFIGS / trial.settings)
    if trial.teacher:
        return shipped
    training = replace(shipped.training, peak=own.training.peak)
    kwargs = {**shipped.env_kwargs, "reward": own.env_kwargs["reward"]}
    return replace(own, env_kwargs=kwargs, training=training)


class CommandView(FlowView):
    """What `FlowView` sees; the first output for each valve is its command, or what is added to the law's. The others idle."""

    added = True

    def command(self, outputs: Floats) -> Floats:
        given = _commands(outputs)
        self.law = law = super().command(np.zeros_like(outputs))
        driven = np.where(
            self.probing[:, None], law, np.clip(given + law if self.added else given, -1.0, 1.0)
        )
        self.asked[-1] += driven - law
        self.sent = driven
        return self.sent.copy()


def _commands(outputs: Floats) -> Floats:
    """The outputs that concern commands, (rigs, 2): the first of each valve's row."""
    return np.asarray(outputs, dtype=float)[:, 0].reshape(-1, 2)


class DirectView(CommandView):
    added = False


def view_of(trial: Trial) -> View:
    """The view of a row."""
    if trial.outputs == "residual" or trial.view["kind"] != "flow":
        return make_view(trial.view)
    settings = {key: value for key, value in trial.view.items() if key != "kind"}
    return (CommandView if trial.outputs == "added" else DirectView)(**settings)


# ---- networks ---------------------------------------------------------------------------------------------------------
class Net(nn.Module):
    """Two hidden layers, of which the second may be recurrent; inputs (steps, rows, features)."""

    def __init__(self, inputs: int, outputs: int, recurrent: bool, last: float) -> None:
        super().__init__()
        self.first = nn.Linear(inputs, WIDTH)
        self.memory = nn.GRU(WIDTH, WIDTH) if recurrent else None
        self.second = nn.Linear(WIDTH, WIDTH)
        self.last = nn.Linear(WIDTH, outputs)
        for layer, gain in ((self.first, 2**0.5), (self.second, 2**0.5), (self.last, last)):
            nn.init.orthogonal_(layer.weight, gain)
            nn.init.zeros_(layer.bias)

    def forward(self, inputs: Tensor, state: Tensor, fresh: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Outputs and the state (1, rows, WIDTH) afterwards; rows begin anew at the steps where they are `fresh`."""
        hidden = torch.tanh(self.first(inputs))
        if self.memory is None:
            return self.last(torch.tanh(self.second(hidden))), state
        starts = [0] if fresh is None else sorted({0, *fresh.any(dim=1).nonzero().flatten().tolist()})
        parts = []
        for begin, end in zip(starts, [*starts[1:], len(inputs)], strict=True):
            if fresh is not None:
                state = state * (~fresh[begin])[None, :, None]
            part, state = self.memory(hidden[begin:end], state)
            parts.append(part)
        remembered = torch.cat(parts)
        return self.last(torch.tanh(self.second(remembered + hidden))), state


def as_tensor(values: Any) -> Tensor:
    return torch.as_tensor(np.ascontiguousarray(values, dtype=np.float32))


class Driver:
    """A policy as a controller that learns nothing."""

    name = "trial"

    def __init__(self, view: View, policy: Net) -> None:
        self.view, self.policy = view, policy

    def reset(self, num_rigs: int, control_period: float) -> None:
        self._period, self._fresh = control_period, True
        self._state = torch.zeros(1, num_rigs * self.view.rows_per_rig, WIDTH)

    def act(self, observation: Floats) -> Floats:
        seen = self.view.start(observation, self._period) if self._fresh else self.view.see(observation)
        self._fresh = False
        with torch.no_grad():
            outputs, self._state = self.policy(as_tensor(seen)[None], self._state)
        return self.view.command(outputs[0].clamp(-1.0, 1.0).numpy())


def scores(driver: Any, pairs: range, config: Config) -> dict[str, Any]:
    """Per scenario of the file's evaluation the interquartile means and the 95th percentile of the difference, and the score
    that chooses."""
    training, told = config.training, {}
    for name in training.evaluate_scenarios:
        metrics = roll_out(driver, pairs, scenario=name, plant=config.env_kwargs["plant"]).metrics(METRICS)
        told[name] = {metric: float(iqm(values)) for metric, values in metrics.items()}
        told[name]["p95"] = float(np.percentile(metrics[METRICS[0]], 95))
    weights = {METRICS[0]: 1.0, "tracking_mae_rpm": training.tracking_weight, "p95": training.tail_weight}
    each = [sum(weight * row[key] for key, weight in weights.items()) for row in told.values()]
    return {"score": float(np.mean(each)), "scenarios": told}


class Best:
    """The best policy so far, by its score on the file's pairs of `val`."""

    def __init__(self, trial: Trial, config: Config) -> None:
        self.view, self.config, self.score, self.curve = view_of(trial), config, np.inf, []  # type: ignore[var-annotated]
        self.policy: Net | None = None

    def look(self, policy: Net, steps: int) -> None:
        told = scores(Driver(self.view, policy), range(self.config.training.evaluate_pairs), self.config)
        self.curve.append({"steps": steps, **told})
        if told["score"] < self.score:
            self.score, self.policy = told["score"], copy.deepcopy(policy)


def truth(plant: Plant, rows_per_rig: int) -> Floats:
    """True edges, gain, friction and spool of each valve, own channel first where a rig has a row for each."""
    valves = true_map(plant)
    own = np.stack(
        [
            4.0 * valves.edge[..., 0], 4.0 * valves.edge[..., 1], valves.gain[..., 0], 3.0 * plant.get("Fs"),
            plant.spool / RATED_TRAVEL, plant.spool_speed / RATED_TRAVEL / SPOOL_RATE,
        ],
        axis=-1,
    )  # fmt: skip
    if rows_per_rig == 1:
        return own.reshape(len(own), -1)
    return np.concatenate([own, own[:, ::-1]], axis=-1).reshape(2 * len(own), -1)


def narrowed(mismatch: Mismatch, share: float) -> Mismatch:
    """A mismatch whose ranges have shrunk to a share, to zero where they begin there, else to their middle."""

    def shrink(low: float, high: float, log: bool) -> tuple[float, float]:
        middle = (low * high) ** 0.5 if log else 0.5 * (low + high) if low else 0.0
        if log:
            return middle * (low / middle) ** share, middle * (high / middle) ** share
        return middle + share * (low - middle), middle + share * (high - middle)

    ranges = {}
    for name, each in mismatch.ranges.items():
        bounds = [shrink(low, high, each.log) for low, high in zip(each.low, each.high, strict=True)]
        low, high = zip(*bounds, strict=True)
        ranges[name] = replace(each, low=low, high=high)
    return replace(mismatch, ranges=ranges)


# ---- PPO ----------------------------------------------------------------------------------------------------------------
def reinforce(trial: Trial, config: Config, seed: int, steps: int) -> Best:
    """PPO as in Stable-Baselines3, with a critic that may be told more and a recurrent layer in both."""
    hyper, view = config.hyper, view_of(trial)
    rigs = HydraulicSyncVecEnv(config.num_envs, **config.env_kwargs)
    rigs.seed(seed)
    rigs.set_options(staggered(rigs))
    env = ViewVecEnv(rigs, view, 0.01, config.training.peak)
    rows, plant, length = env.num_envs, rigs.batch.plant, int(hyper["n_steps"])
    full = load_mismatch(config.env_kwargs["mismatch"])
    assert full is not None
    extra = 12 if trial.told else 0
    policy = Net(view.num_features, view.num_actions, trial.recurrent, 0.01)
    critic = Net(view.num_features + extra, 1, trial.recurrent, 1.0)
    spread = nn.Parameter(torch.full((view.num_actions,), trial.spread))
    weights = [*policy.parameters(), *critic.parameters(), spread]
    optimiser = torch.optim.Adam(weights, eps=1e-5)
    best = Best(trial, config)
    best.look(policy, 0)

    def more(seen: Any) -> Tensor:
        return as_tensor(np.concatenate([seen, truth(plant, view.rows_per_rig)], axis=1) if extra else seen)

    if trial.curriculum:
        rigs.batch.mismatch = narrowed(full, 0.05)
    seen, fresh = np.asarray(env.reset()), np.ones(rows, bool)
    states = [torch.zeros(1, rows, WIDTH) for _ in range(2)]
    done, evaluated = 0, 0
    while done < steps:
        if trial.curriculum:
            rigs.batch.mismatch = narrowed(full, min(1.0, 0.05 + 2.0 * done / steps))
        kept: dict[str, list[Tensor]] = {
            key: [] for key in ("seen", "more", "action", "chance", "value", "reward", "fresh")
        }
        begin = [state.clone() for state in states]
        for _ in range(length):
            own, told, started = as_tensor(seen), more(seen), torch.as_tensor(fresh)
            with torch.no_grad():
                mean, states[0] = policy(own[None], states[0], started[None])
                value, states[1] = critic(told[None], states[1], started[None])
                noise = torch.distributions.Normal(mean[0], spread.exp())
                action = noise.sample()
                chance = noise.log_prob(action).sum(-1)
            seen, reward, fresh, infos = env.step(action.clamp(-1.0, 1.0).numpy())  # type: ignore[assignment]
            reward = reward.copy()
            if fresh.any():  # the episode is cut off, not over: what would have come counts
                ended, last = np.flatnonzero(fresh), seen.copy()
                for row in ended:
                    last[row] = infos[row]["terminal_observation"]
                beyond = as_tensor(last)
                if extra:  # the valves as they were, the spools a period before
                    beyond = torch.cat([beyond, told[:, -extra:]], dim=1)
                with torch.no_grad():
                    reward[ended] += (
                        float(hyper["gamma"]) * critic(beyond[None], states[1])[0][0, ended, 0].numpy()
                    )
            for key, item in (
                ("seen", own), ("more", told), ("action", action), ("chance", chance), ("value", value[0, :, 0]),
                ("reward", as_tensor(reward)), ("fresh", started),
            ):  # fmt: skip
                kept[key].append(item)
        with torch.no_grad():
            following = critic(more(seen)[None], states[1], torch.as_tensor(fresh)[None])[0][0, :, 0]
        data = {key: torch.stack(items) for key, items in kept.items()}
        advantage = _advantages(data, following, torch.as_tensor(fresh), hyper)
        returns = advantage + data["value"]
        done += length * config.num_envs
        rate = (
            hyper["learning_rate"](1.0 - done / steps)
            if callable(hyper["learning_rate"])
            else hyper["learning_rate"]
        )
        for group in optimiser.param_groups:
            group["lr"] = max(float(rate), 1e-6)
        for chosen in _batches(
            rows, view.rows_per_rig, int(hyper["batch_size"]) // length, int(hyper["n_epochs"])
        ):
            part = {key: item[:, chosen] for key, item in data.items()}
            mean, _ = policy(part["seen"], begin[0][:, chosen], part["fresh"])
            value, _ = critic(part["more"], begin[1][:, chosen], part["fresh"])
            chance = torch.distributions.Normal(mean, spread.exp()).log_prob(part["action"]).sum(-1)
            ratio = torch.exp(chance - part["chance"])
            gain = advantage[:, chosen]
            gain = (gain - gain.mean()) / (gain.std() + 1e-8)
            clip = float(hyper["clip_range"])
            loss = -torch.min(gain * ratio, gain * ratio.clamp(1.0 - clip, 1.0 + clip)).mean()
            loss = (
                loss + float(hyper.get("vf_coef", 0.5)) * (value[..., 0] - returns[:, chosen]).square().mean()
            )
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(weights, float(hyper.get("max_grad_norm", 0.5)))
            optimiser.step()
        if done - evaluated >= config.training.evaluate_every or done >= steps:
            best.look(policy, done)
            evaluated = done
    return best


def _advantages(data: dict[str, Tensor], following: Tensor, fresh: Tensor, hyper: dict[str, Any]) -> Tensor:
    """Generalised advantages (steps, rows); an end is followed by nothing, its value is in the reward."""
    gamma, trace = float(hyper["gamma"]), float(hyper["gae_lambda"])
    advantage, carried = torch.zeros_like(data["reward"]), torch.zeros_like(following)
    for step in reversed(range(len(advantage))):
        goes_on = 1.0 - fresh.float()
        miss = data["reward"][step] + gamma * goes_on * following - data["value"][step]
        carried = miss + gamma * trace * goes_on * carried
        advantage[step], following, fresh = carried, data["value"][step], data["fresh"][step]
    return advantage


def _batches(rows: int, rows_per_rig: int, size: int, epochs: int) -> Iterator[Tensor]:
    """Rows for each minibatch; those whose episodes end together stay together, as recurrent layers like it."""
    groups = torch.arange(rows) // rows_per_rig % 16
    for _ in range(epochs):
        order = torch.argsort(torch.randperm(16)[groups] * 2.0 + torch.rand(rows))
        yield from order.split(max(1, size))


# ---- DAgger -----------------------------------------------------------------------------------------------------------------
class ToldLaw:
    """The law told the true valves, as a teacher: what it would send where another one drives."""

    def begin(self, env: HydraulicSyncVectorEnv, observation: Floats) -> None:
        self.env, self.view, self.first = env, FlowView(probe=0.0), True
        self.view.start(observation, env.control_period)

    def command(self, observation: Floats) -> Floats:
        if not self.first:
            self.view.see(observation)
        self.first = False
        true, valves = true_map(self.env.plant), self.view.valves
        valves.edge, valves.gain = true.edge.copy(), true.gain[..., 0].copy()
        valves.unknown[:], valves.edge_variance[:], valves.gain_variance[:] = False, 1e-6, 1e-6
        return self.view.command(np.zeros((2 * len(observation), 3)))

    def hear(self, sent: Floats) -> None:
        """What was sent instead."""
        self.view.asked[-1] += sent - self.view.sent
        self.view.sent = np.array(sent)


class Oracle:
    """The oracle as a teacher: it plans anew from where the rigs are."""

    def begin(self, env: HydraulicSyncVectorEnv, observation: Floats) -> None:
        self.env, self.oracle = env, make_controller("oracle")
        n = len(observation)
        self.oracle.prepare(copy.deepcopy(env.plant))
        self.oracle.foresee(np.stack([env.course(row).load for row in range(n)], axis=1))
        self.oracle.reset(n, env.control_period)

    def command(self, observation: Floats) -> Floats:
        if self.oracle._twin is not None and getattr(self.oracle, "_started", False):
            self.oracle._twin.take_state(self.env.plant, np.arange(len(observation)))
        return np.asarray(self.oracle.act(observation))

    def hear(self, sent: Floats) -> None:
        self.oracle._sent = np.array(sent)


class Teacher(Protocol):
    """Says what it would send on rigs that another one drives."""

    def begin(self, env: HydraulicSyncVectorEnv, observation: Floats) -> None: ...

    def command(self, observation: Floats) -> Floats: ...

    def hear(self, sent: Floats) -> None: ...


TEACHERS: dict[str, type[Teacher]] = {"law": ToldLaw, "oracle": Oracle}


def clone(trial: Trial, config: Config, seed: int, steps: int) -> Best:
    """DAgger: the teacher drives the first batch of episodes, the student all others; the teacher says what it would send."""
    view = view_of(trial)
    kwargs = {key: value for key, value in config.env_kwargs.items() if key != "reward"}
    length, rigs = int(kwargs["max_episode_steps"]), config.num_envs
    env = HydraulicSyncVectorEnv(rigs, autoreset_mode="Disabled", **kwargs)
    policy = Net(view.num_features, view.num_actions, trial.recurrent, 0.01)
    best, data, rounds = Best(trial, config), [], max(1, round(steps / rigs / length))
    best.look(policy, 0)
    observation, _ = env.reset(seed=seed * 10_000)
    for turn in range(rounds):
        if turn:
            observation, _ = env.reset()
        data.append(_lesson(trial, env, observation, view, policy, turn == 0))
        optimiser = torch.optim.Adam(policy.parameters(), lr=2e-3)
        batches = [(lesson, rows) for lesson in data for rows in torch.arange(lesson[0].shape[1]).split(64)]
        updates = len(batches) * (6 if turn < rounds - 1 else 20)
        for update in range(updates):
            for group in optimiser.param_groups:
                group["lr"] = 2e-3 * (1.0 - update / updates)
            (inputs, wanted, weight), rows = batches[int(torch.randint(len(batches), ()))]
            outputs, _ = policy(inputs[:, rows], torch.zeros(1, len(rows), WIDTH))
            miss = outputs[..., : wanted.shape[-1]] - wanted[:, rows]
            loss = (weight[:, rows, None] * miss.square()).mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
            optimiser.step()
        best.look(policy, (turn + 1) * rigs * length)
    return best


def _lesson(
    trial: Trial,
    env: HydraulicSyncVectorEnv,
    observation: Floats,
    view: View,
    policy: Net,
    teacher_drives: bool,
) -> tuple[Tensor, Tensor, Tensor]:
    """An episode of every rig: inputs, outputs that give the teacher's commands, weights (none while the law probes)."""
    teacher, driver = TEACHERS[trial.teacher](), Driver(view, policy)
    teacher.begin(env, observation)
    driver.reset(env.num_envs, env.control_period)
    assert env.max_episode_steps is not None
    kept: list[tuple[Any, Any, Any]] = []
    for step in range(env.max_episode_steps):
        seen = view.see(observation) if step else view.start(observation, env.control_period)
        with torch.no_grad():
            outputs, driver._state = policy(as_tensor(seen)[None], driver._state)
        wish = np.asarray(teacher.command(observation))
        given = outputs[0].clamp(-1.0, 1.0).numpy()
        own = view.command(given)
        asleep = np.zeros(env.num_envs, bool)
        target = wish
        if isinstance(view, CommandView):
            asleep = view.probing.copy()
            if view.added:
                target = wish - view.law
        sent = np.where(asleep[:, None] | (not teacher_drives), own, wish)
        if isinstance(view, CommandView):
            view.asked[-1] += sent - own
            view.sent = sent.copy()
        teacher.hear(sent)
        rows = view.rows_per_rig
        kept.append((seen, target.reshape(env.num_envs * rows, -1), np.repeat(~asleep, rows)))
        observation, *_ = env.step(sent.astype(np.float32))
    inputs, wanted, weight = (as_tensor(np.stack(each)) for each in zip(*kept, strict=True))
    return inputs, wanted, weight


# ---- command line ---------------------------------------------------------------------------------------------------------
def run(name: str, seed: int, steps: int, out: Path) -> dict[str, Any]:
    """Trains and scores a row with one seed; what is in `out` already is only read."""
    path = out / f"{name}_{seed}.json"
    if path.is_file():
        return dict(json.loads(path.read_text(encoding="utf-8")))
    torch.set_num_threads(1)
    torch.manual_seed(seed)
    trial, since = TRIALS[name], time.monotonic()
    config = config_of(trial)
    best = (clone if trial.teacher else reinforce)(trial, config, seed, steps)
    seconds = time.monotonic() - since
    assert best.policy is not None
    told = scores(Driver(view_of(trial), best.policy), FINAL, config)
    result = {"row": name, "seed": seed, "steps": steps, "seconds": seconds, **told, "curve": best.curve}
    out.mkdir(parents=True, exist_ok=True)
    write_whole(path, json.dumps(result, indent=1).encode())
    return result


def line(name: str, found: list[dict[str, Any]]) -> str:
    """A line of the table (Markdown): per scenario the difference of each seed, their mean tracking error and percentile."""
    cells = []
    for scenario in found[0]["scenarios"]:
        each = [result["scenarios"][scenario] for result in found]
        differences = ", ".join(f"{row[METRICS[0]]:.1f}" for row in each)
        tracking = np.mean([row["tracking_mae_rpm"] for row in each])
        cells.append(f"{differences} at {tracking:.1f} ({np.mean([row['p95'] for row in each]):.0f})")
    minutes = np.mean([result["seconds"] for result in found]) / 60.0
    return f"| {name} | " + " | ".join(cells) + f" | {minutes:.0f} |"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m agents.ablations", description=__doc__)
    parser.add_argument("rows", nargs="+", help=f"some of {', '.join(TRIALS)}")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0])
    parser.add_argument("--steps", type=int, default=250_000, help="control periods of single rigs")
    parser.add_argument("--out", type=Path, required=True, help="folder of the scores")
    chosen = parser.parse_args()

    def work() -> None:
        for name in chosen.rows:
            if name not in TRIALS:
                raise InputError(f"{name}: is no row; there are {', '.join(TRIALS)}")
        for name in chosen.rows:
            found = [run(name, seed, chosen.steps, chosen.out) for seed in chosen.seeds]
            print(line(name, found), flush=True)

    cleanly(work)


if __name__ == "__main__":
    main()

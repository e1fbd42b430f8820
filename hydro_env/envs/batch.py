"""Many environments as one: the task of keeping two motors in step, for all rows of a batch at once.

The single environment is a batch of one. Arrays have one row per rig.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from ..arrays import AnyArray, Bools, Floats, Integers, Picture, Singles
from ..errors import InputError, check_known, shown
from ..limits import Limits
from ..plant import Plant, PlantModel, load_model, scales_of
from ..plant.plant import machine_memory
from ..streams import Component
from ..tasks.mismatch import Mismatch, default_mismatch, load_mismatch
from ..tasks.scenarios import Reference, Scenario, load_scenario
from ..units import RPM
from .env_spec import OwnSpec
from .observation import ERRORS, FRAME, LIMIT, Noise, noise_levels, scales_on, with_errors
from .own_functions import OwnObservation, OwnReward, Signals, checked_rows
from .privileged import Privileged
from .profiles import encode
from .randomisation import Episodes, Randomisation
from .render import Recorder
from .reward import Reward, load_reward
from .rollout import Result, Rollout
from .step_kernels import COLUMNS, STATE

#: Keys of the `options` of `reset`.
OPTIONS = ("mismatch", "scenario", "noise", "case", "reset_mask")
#: Why an episode is terminated by a plant that does not say more.
DIVERGED = "diverged: the simulation of the plant is no longer finite"

NUM_ENVS = Limits(1, 2**40, whole=True)
CONTROL_PERIOD = Limits(1e-4, 1.0, unit="s")
HISTORY = Limits(1, 1000, whole=True, unit="frames")
INCREMENT = Limits(1e-6, 2.0)
TOLERANCE = Limits(1e-6, 1e3, unit="rpm")
RENDER_WIDTH = Limits(160, 7680, whole=True, unit="pixels")
EPISODE = Limits(1, 2**40, whole=True, unit="steps")
THREADS = Limits(1, 1024, whole=True)

#: Rows whose scenarios are drawn at a time.
_CHUNK = 1024
#: True only where the model has a supply pressure; without one it knows the difference of both lines alone.
_OF_LINES = "lowest_line_pressure_bar"


class HydraulicSyncVectorEnv(VectorEnv[Singles, Singles, AnyArray]):
    """The native batch of `HydraulicSync-v0`; `HydraulicSyncEnv` describes task, spaces and arguments.

    `gymnasium.make_vec("hydro_env:HydraulicSync-v0", num_envs=N, ...)` makes it. Beyond the single environment:

    * `reset(seed=s)` seeds row i with s + i, `reset(seed=[...])` each row with its own. Row i then is bit for bit the
      single environment of that seed, in this and all following episodes. Runs that are to share no episode need seeds
      at least N apart.
    * `autoreset_mode`: "NextStep" (default: the step after an end resets the row, ignores its action and has reward 0),
      "SameStep" (the end's observation is in `info["final_obs"]`) or "Disabled" (reset with
      `options={"reset_mask": mask}`).
    * `options` of `reset` hold for all rows that it resets, until they are reset again: an autoreset goes on with them, with the
      same case. `case=k` means case k + i for row i, a list one for each. `use_options(options)` gives them to the
      episodes that begin until the next `reset`, and resets no row itself.
    * `info` holds arrays with one row per rig and masks `_key` as Gymnasium has them; `pairs` the values of the valves.
    * `max_episode_steps` ends episodes early (truncation).
    * `plant` may be a `Plant`: its model, with its tolerance.
    * `dtype`: "float64" (default), or "float32" for a faster plant (see `Plant`). Angles are then summed up period by
      period in float64, and those of `plant` are what was turned since, unless an effect goes by them.
    * `threads` that step the rows together, 1 by default; as many as the machine has cores pay from some hundred rows on. They
      change no bit.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012 (Gymnasium's way)
    spec: Any = OwnSpec()

    def __init__(
        self, num_envs: int = 1, plant: str | Path | Mapping[str, Any] | PlantModel | Plant = "paper_dead_zone",
        scenario: str | Mapping[str, Any] | Scenario = "random_steps",
        mismatch: str | Path | Mapping[str, Any] | Mismatch | None = "auto", control_period: float = 0.01,
        render_mode: str | None = None, *, history: int = 1, noise: Noise = 1.0,
        reward: Mapping[str, float] | Reward | OwnReward | None = None, observation: OwnObservation | None = None,
        privileged: bool = False, autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None, dtype: str = "float64", render_width: int = 640,
        increment: float | None = None, errors: bool = False, threads: int = 1, tolerance_rpm: float | None = None,
    ) -> None:  # fmt: skip
        super().__init__()
        self.num_envs = NUM_ENVS.check(num_envs, "num_envs")
        self.control_period = CONTROL_PERIOD.check(control_period, "control_period")
        self.history = HISTORY.check(history, "history")
        self.increment = _optional(INCREMENT, increment, "increment")
        self.max_episode_steps = _optional(EPISODE, max_episode_steps, "max_episode_steps")
        self.threads = THREADS.check(threads, "threads")
        one_of("errors", errors, (False, True))
        one_of("privileged", privileged, (False, True))
        if not (observation is None or callable(observation)):
            raise InputError(f"observation is {shown(observation)}, expected None or a function")
        one_of("dtype", dtype, ("float64", "float32"))
        one_of("render_mode", render_mode, (None, "rgb_array"))
        one_of("autoreset_mode", autoreset_mode, (*AutoresetMode, *(mode.value for mode in AutoresetMode)))
        self.dtype, self.errors = np.dtype(dtype), errors
        self.model = plant.model if isinstance(plant, Plant) else load_model(plant)
        self._tolerance = _tolerance(plant, self.model, tolerance_rpm)
        self.scales = scales_of(self.model)
        self.scenario = load_scenario(scenario, self.scales)
        auto = isinstance(mismatch, str) and mismatch == "auto"
        self.mismatch = load_mismatch(default_mismatch(plant) if auto else mismatch)
        self.render_mode = render_mode
        self._own_reward, self._own_observation = reward if callable(reward) else None, observation
        self.reward = Reward() if callable(reward) else load_reward(reward)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        # First of what takes room, so that a batch that cannot fit is refused in its words.
        made = self._make_plant(() if self.mismatch is None else self.mismatch.effects)
        width = FRAME * self.history
        self._check_memory(6.0 * 4 * width * self.num_envs, f"observations with a history of {self.history}")
        self._noise = self._levels(noise)
        sensing = np.concatenate([scales_on(self.scales), self.reward.weights(self.scales.speed)])
        self._rollout = Rollout(made, self.control_period, width, sensing, self.threads)
        self._randomisation = Randomisation(self.num_envs, self.model)
        #: What each row showed last, (N, FRAME * history), oldest first.
        self._frames = np.zeros((self.num_envs, width), np.float32)
        known = (self._rollout, self._randomisation, self.mismatch, self._noise, self.scales)
        #: What `info["privileged"]` holds; None where nobody asked for it.
        self.privileged = Privileged(*known) if privileged else None
        self._true = self._rollout.outputs()[1]
        self._name_columns()
        self._make_spaces()
        self._ended, self._begun = np.zeros(self.num_envs, np.bool_), False
        self._shared: Scenario | None = None
        #: Options of the last `reset` of each row, by number; 0 stands for none.
        self._options: dict[int, dict[str, Any]] = {0: {}}
        self._held = np.zeros(self.num_envs, np.int64)
        width = RENDER_WIDTH.check(render_width, "render_width")
        self._recorder = None if render_mode is None else Recorder(self.num_envs, width, self.scales.speed)

    def _make_spaces(self) -> None:
        self.metadata = {
            **type(self).metadata,
            "render_fps": max(1, round(1.0 / self.control_period)),
            "autoreset_mode": self.autoreset_mode,
        }
        width = (FRAME + ERRORS * self.errors) * self.history
        self.single_observation_space = spaces.Box(-LIMIT, LIMIT, (width,), np.float32)
        if self._own_observation is not None:
            width = self.seen(self._frames, self._true, finite=False).shape[1]
            self.single_observation_space = spaces.Box(-np.inf, np.inf, (width,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def _make_plant(self, effects: tuple[str, ...]) -> Plant:
        """The rigs. A model with a method `make_plant` is of something else, simulated by code of its own: what that makes has
        all of `Plant` that is used here, with `lost` empty where it does not say what it could not follow."""
        if hasattr(self.model, "make_plant"):
            return self.model.make_plant(self.num_envs, self.dtype)
        return Plant(self.model, self.num_envs, effects=effects, tolerance=self._tolerance, dtype=self.dtype)

    def _levels(self, noise: Noise) -> Floats:
        """The levels (2, 6) between which the noise is drawn. InputError as `noise_levels`."""
        return np.stack([noise_levels(noise, self.scales, end) for end in (0, 1)])

    def _check_memory(self, need: float, what: str) -> None:
        """InputError where this machine has less memory than that many bytes."""
        if need > (available := machine_memory()):
            raise InputError(
                f"num_envs is {self.num_envs}: {what} need {need / 2**30:.3g} GiB, this machine has"
                f" {available / 2**30:.3g} GiB, enough for about {int(self.num_envs * available / need)}"
            )

    # --- the interface of Gymnasium -------------------------------------------------------------------------------
    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begins a new episode in every row (or those of `options["reset_mask"]`).

        Without a seed each row goes on to the next episode of its seed. InputError for unknown options.
        """
        read = self._read(options)
        mask = self._mask(read.pop("reset_mask", None))
        rows = np.flatnonzero(mask)
        self._begin(rows, seed, **read)
        if isinstance(seed, int | np.integer):
            super().reset(seed=int(seed))
        self._hold(rows, read)
        self._ended = self._ended & ~mask
        frames, self._true = self._frames.copy(), self._true.copy()  # what the other rows showed last
        self._show_first(mask, frames, self._true)
        return self.seen(frames, self._true), self._info(self._true, mask) | self._drawn_info(mask)

    def use_options(self, options: Mapping[str, Any] | None = None) -> None:
        """Gives the episodes after the present ones, until the next `reset`, these options of it; none without any.

        InputError as for `reset`, and for a mismatch with effects that the plant lacks: `reset` brings them in.
        """
        read = self._read(options)
        if "reset_mask" in read:
            raise InputError("use_options: reset_mask is for reset alone; options hold for all rows")
        if lacking := self._lacking(read.get("mismatch")):
            raise InputError(f"use_options: the plant lacks {', '.join(lacking)}: reset all rows with it")
        self._hold(np.arange(self.num_envs), read)

    def _read(self, options: Mapping[str, Any] | None) -> dict[str, Any]:
        """Options of `reset` as they are used. InputError for what is none."""
        if not isinstance(options, Mapping | None):
            raise InputError(f"reset: options {shown(options)}, expected a mapping of {', '.join(OPTIONS)}")
        read = dict(options or {})
        check_known("reset: unknown option", read, OPTIONS)
        scenarios = partial(load_scenario, scales=self.scales)
        readers: dict[str, Callable[[Any], Any]] = {
            "scenario": scenarios,
            "mismatch": load_mismatch,
            "noise": self._levels,
        }
        return {key: readers[key](value) if key in readers else value for key, value in read.items()}

    def _hold(self, rows: Integers, options: dict[str, Any]) -> None:
        """Notes the options with which the next episodes of these rows begin."""
        self._held[rows] = number = max(self._options) + 1 if options else 0
        self._options = {n: self._options.get(n, options) for n in {0, number, *self._held.tolist()}}

    def _mask(self, given: Any) -> Bools:
        """The rows (N,) that a reset is for; InputError if there are none."""
        if given is None:
            return np.ones(self.num_envs, np.bool_)
        try:
            mask = np.array(given)
        except ValueError:  # rows of different lengths
            mask = np.array(None)
        if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
            raise InputError(f"reset: reset_mask must be a mask of {self.num_envs} rows, one at least chosen")
        return mask

    def step(self, actions: ArrayLike) -> tuple[Singles, Floats, Bools, Bools, dict[str, Any]]:
        """One control period with the actions (N, 2). ValueError if they are no finite real numbers or the shape is wrong."""
        mode, everyone, again = self.autoreset_mode, np.ones(self.num_envs, np.bool_), self._ended
        if mode is AutoresetMode.DISABLED and again.any():
            raise gymnasium.error.ResetNeeded("an episode has ended: reset it, options={'reset_mask': mask}")
        waiting = mode is AutoresetMode.NEXT_STEP and again.any()
        result = self._rollout.outputs() if waiting and again.all() else self.step_rows(actions)
        observation, true, reward, terminated, truncated = result
        if waiting:
            self._restart(again, result)
            reward[again], terminated[again], truncated[again] = 0.0, False, False
            info = self._info(true, everyone, ~again, terminated) | self._drawn_info(again)
        else:
            info = self._info(true, everyone, everyone, terminated)
        self._ended = ended = terminated | truncated
        if mode is AutoresetMode.SAME_STEP and ended.any():
            final = np.full(self.num_envs, None, object)
            last = self.seen(observation, true)
            for row in np.flatnonzero(ended):
                final[row] = last[row].copy()
            final_info = self._info(true.copy(), ended, ended, terminated)
            self._restart(ended, result)
            info = self._info(true, everyone, ~ended) | self._drawn_info(ended)
            info |= {"final_obs": final, "_final_obs": ended, "final_info": final_info, "_final_info": ended}
            self._ended = np.zeros_like(ended)
        self._true = true
        return self.seen(observation, true), reward, terminated, truncated, info

    def render(self) -> tuple[Picture, ...] | None:
        """A picture (height, width, 3) of each row's recent past, if `render_mode` is "rgb_array"."""
        if self._recorder is None:
            return None
        rated = self._rollout.state["rated"].max(axis=1).tolist()
        return tuple(self._recorder.picture(row, self.control_period, each) for row, each in enumerate(rated))

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """An attribute, or what a method returns, for each row, as Gymnasium's own batches have it and trainers expect it.

        Everything but pictures the rows have in common. ValueError for what steps or resets them.
        """
        if name in ("reset", "step", "step_rows"):
            raise ValueError(f"{name} concerns all rows: call it on the environment itself")
        found = getattr(self, name)
        answer = found(*args, **kwargs) if callable(found) else found
        return answer if name == "render" and answer is not None else (answer,) * self.num_envs

    @property
    def episode_steps(self) -> int:
        """Control periods in an episode of the scenario that it was made with."""
        return self._steps(self.scenario)

    def _steps(self, scenario: Scenario) -> int:
        steps = scenario.steps(self.control_period)
        return steps if self.max_episode_steps is None else min(steps, self.max_episode_steps)

    # --- what the single environment and Stable-Baselines3 build on -----------------------------------------------
    @property
    def plant(self) -> Plant:
        """The rigs, a row each."""
        return self._rollout.plant

    @property
    def pairs(self) -> dict[str, Floats]:
        """Values (N, 2) of the parameters in which the valves of this environment may differ, as they now are."""
        return self._randomisation.pairs(self.plant)

    def reference(self, row: int = 0) -> Reference:
        """What the present episode of a row drives: set-point (T + 1,) in rad/s and loads (T + 1, 2) in N m."""
        state = self._rollout.state[row]
        return self._rollout.profiles.decoded(int(state["profile"]), int(state["last"]) + 1)

    def step_rows(self, actions: ArrayLike) -> Result:
        """One control period for all rows, without autoreset, info and what `seen` does. ValueError as for `step`."""
        if not self._begun:
            raise gymnasium.error.ResetNeeded("reset every row of the environment before the first step")
        wanted = checked_rows("actions are", actions, (self.num_envs, 2), finite=False)
        if self.increment is not None and np.isfinite(wanted).all():  # what is not is refused below
            wanted = self._rollout.state["fraction"] + self.increment * np.clip(wanted, -1.0, 1.0)
        result = self._rollout.step(wanted)
        self._remember(self._rollout.rows, result)
        if self._own_reward is not None:
            signals = {**self._signals(result[1], terms=True), "reward": result[2].copy()}
            result[2][:] = checked_rows(
                "reward: the function returned", self._own_reward(signals), (self.num_envs,)
            )
        return result

    def seen(self, frames: Singles, true: Floats, finite: bool = True) -> Singles:
        """What leaves the environment of its frames (N, n) and true signals (N, TRUE). InputError for what a function of the
        user's must not return."""
        shown = with_errors(frames) if self.errors else frames
        if self._own_observation is None:
            return shown
        own = self._own_observation(shown, self._signals(true))
        rows = checked_rows("observation: the function returned", own, (self.num_envs, None), finite)
        return rows.astype(np.float32)

    def _signals(self, true: Floats, terms: bool = False) -> Signals:
        """What functions of the user's are told of the rows; the terms of the reward where there has been a step."""
        table = true.view()
        table.flags.writeable = False
        told = {k: table[:, c] for k, c in self.columns.items() if terms or not k.startswith("reward")}
        return told if self.privileged is None else {**told, "privileged": self.privileged.now()}

    def reasons(self, terminated: Bools) -> NDArray[np.object_]:
        """Why these rows were terminated, None for the others."""
        lost = {each.rig: f"diverged: {each}" for each in reversed(self.plant.lost)}
        told = [lost.get(n, DIVERGED) if ends else None for n, ends in enumerate(terminated)]
        return np.array(told, object)

    # --- episodes -------------------------------------------------------------------------------------------------
    def _begin(
        self, rows: Integers, seed: int | Sequence[int | None] | None = None, *, scenario: Scenario | None = None,
        **options: Any,
    ) -> None:  # fmt: skip
        """Draws and starts an episode of each of these rows; `options` as for `reset`, read."""
        scenario = scenario or self.scenario
        mismatch: Mismatch | None = options.get("mismatch", self.mismatch)
        steps = self._steps(scenario)
        episodes = self._randomisation.next(rows, mismatch, seed, options.get("case"))
        lacking = self._lacking(mismatch)
        if lacking and rows.size < self.num_envs:
            raise InputError("reset: this mismatch has effects the plant lacks: reset all rows with it")
        if lacking:
            self._rollout.take(self._make_plant((*self.plant.effects, *lacking)))
        # Up to here something could be wrong with the options, and nothing has been changed; from here on not.
        self.plant.set_values(self._randomisation.draw(episodes, mismatch), rows)
        state = self._rollout.state
        state[rows] = np.zeros((), STATE)
        state["last"][rows] = steps
        state["rated"][rows] = self.plant.get("u_rated")[rows]
        self._randomisation.start(state, episodes, self.control_period)
        self._rollout.deviation[rows] = self._randomisation.noise(episodes, options.get("noise", self._noise))
        self._set_profiles(episodes, scenario)
        self.plant.reset(None if rows.size == self.num_envs else rows)
        self._begun = bool((self._randomisation.episode >= 0).all())
        self._name_columns()
        if self.privileged is not None:
            self.privileged.draw()
        if self._recorder is not None:
            self._recorder.clear(rows)

    def _lacking(self, mismatch: Mismatch | None) -> list[str]:
        """Effects of a mismatch that the plant does not have so far."""
        return [] if mismatch is None else sorted({*mismatch.effects} - {*self.plant.effects})

    def _name_columns(self) -> None:
        lines = self.plant.get("mean_line_pressure").any()
        #: `COLUMNS` that this plant has.
        self.columns = {key: column for key, column in COLUMNS.items() if key != _OF_LINES or lines}

    def _set_profiles(self, episodes: Episodes, scenario: Scenario) -> None:
        """Gives the rows their set-points and loads; where nothing is random all rows share one profile."""
        rows, profiles, number = episodes.rows, self._rollout.profiles, self._rollout.state["profile"]
        if not scenario.random and self._shared is not scenario and rows.size == self.num_envs:
            self._shared = scenario
            common = scenario.reference(self.control_period)
            profiles.share(*encode(common.setpoint[None], common.load[None]))
        if self._shared is scenario:
            number[rows] = 0
            return
        for begin in range(0, rows.size, _CHUNK):
            part = slice(begin, begin + _CHUNK)
            streams = episodes.streams(Component.SCENARIO, part)
            starts, levels = encode(*scenario.profiles(self.control_period, streams))
            need = profiles.bytes_with(levels.shape[1]) + self.plant.memory.nbytes
            self._check_memory(need, f"episodes of {self._steps(scenario)} steps")
            profiles.put(rows[part], starts, levels)
        number[rows] = rows + 1

    def _restart(self, ended: Bools, result: Result) -> None:
        """Starts the next episode of these rows and puts its first signals in their place."""
        for number in np.unique(self._held[ended]):
            self._begin(np.flatnonzero(ended & (self._held == number)), **self._options[int(number)])
        self._show_first(ended, *result[:2])

    # --- outputs --------------------------------------------------------------------------------------------------
    def _show_first(self, begun: Bools, frames: Singles, true: Floats) -> None:
        """Puts what these rows show at the beginning of their episodes in its place."""
        rows, first = np.flatnonzero(begun), self._rollout.outputs()
        self._rollout.sense(rows, first)
        self._remember(rows, first)
        frames[begun], true[begun] = first[0][begun], first[1][begun]

    def _remember(self, rows: Integers, result: Result) -> None:
        """Completes observations, whose last frame is new, by the frames before it, or where an episode begins by the new one
        again; and keeps what was sensed, for the next period and for pictures."""
        observation = result[0]
        if self.history > 1:
            new = rows[self._rollout.state["step"][rows] == 0]
            observation[rows, :-FRAME] = self._frames[rows, FRAME:]
            observation[new, :-FRAME] = np.tile(observation[new, -FRAME:], self.history - 1)
        if rows.size == self.num_envs:  # copied faster
            self._frames[:] = observation
        else:
            self._frames[rows] = observation[rows]
        if self._recorder is not None:
            self._recorder.add(rows, result[1], self._rollout.angle)

    def _info(
        self, true: Floats, given: Bools, stepped: Bools | None = None, terminated: Bools | None = None
    ) -> dict[str, Any]:
        """True signals of the rows `given`, the terms of the reward of those that `stepped`, and why rows were `terminated`."""
        info: dict[str, Any] = {}
        for key, column in self.columns.items():
            mask = stepped if key.startswith("reward") else given
            if mask is not None:
                info[key], info["_" + key] = true[:, column], mask
        if self.privileged is not None:
            info["privileged"], info["_privileged"] = self.privileged.now(), given
        if terminated is not None and terminated.any():
            info["termination"], info["_termination"] = self.reasons(terminated), terminated.copy()
        return info

    def _drawn_info(self, mask: Bools) -> dict[str, Any]:
        """What belongs to the first observation of some rows."""
        pairs, drawn = self.pairs, self._randomisation
        told: dict[str, Any] = {"mismatch": pairs | {"_" + name: mask for name in pairs}}
        told |= {"fault": drawn.fault.copy(), "case": drawn.case.copy()}
        return told | {"_" + key: mask for key in told}


def row_of(info: dict[str, Any], row: int) -> dict[str, Any]:
    """What a batch's info says of one row."""
    own: dict[str, Any] = {}
    for key, value in info.items():
        if key.startswith("_") or key in ("final_obs", "final_info") or not info["_" + key][row]:
            continue
        if isinstance(value, dict):
            own[key] = row_of(value, row)
        else:
            own[key] = value[row].copy() if value.ndim > 1 else value[row]
    return own


def _optional(limits: Limits, value: Any, name: str) -> Any:
    """None, or the value where it is within its limits."""
    return None if value is None else limits.check(value, name)


def _tolerance(plant: Any, model: PlantModel, given_rpm: float | None) -> float | None:
    """The tolerance that is given or that a `Plant` brings, rad/s; None for that of the model."""
    if given_rpm is not None:
        if hasattr(model, "make_plant"):
            raise InputError(f"tolerance_rpm: {model.name!r} is simulated by its own code; leave it out")
        return float(TOLERANCE.check(given_rpm, "tolerance_rpm") * RPM)
    return plant.tolerance if isinstance(plant, Plant) else None


def one_of(name: str, value: object, right: tuple[object, ...]) -> None:
    """InputError for an argument that is none of these."""
    if not any(type(value) is type(one) and value == one for one in right):
        raise InputError(f"{name} is {shown(value)}, expected one of {', '.join(map(repr, right))}")

"""Many environments as one: the task of keeping two motors in step, for all rows of a batch at once.

Everything the task does is written here, once; the single environment is a batch of one. Arrays have one row per rig.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import pairwise
from math import inf
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError, shown, suggestion
from ..limits import Limits
from ..plant import Plant, PlantModel, load_model
from ..plant.plant import machine_memory, make_plant
from ..streams import NormalNumbers, Streams
from ..tasks.mismatch import SENSOR_PARAMETERS, Mismatch, default_mismatch, load_mismatch, own_values
from ..tasks.scenarios import Reference, Scenario, load_scenario
from ..units import RPM
from .courses import Courses, pieces
from .made_spec import made_spec
from .observation import ERRORS, FRAME, LIMIT, SCALES, noise_levels, with_errors
from .render import Recorder
from .reward import Reward, load_reward
from .step_kernels import COLUMNS, SIGNALS, TRUE, apply, drive, look, wind

__all__ = ["HydraulicSyncVectorEnv", "Result"]

Floats = NDArray[np.float64]
#: observation (N, n) float32, true signals (N, TRUE), reward (N,), terminated (N,), truncated (N,)
Result = tuple[NDArray[np.float32], Floats, Floats, NDArray[np.bool_], NDArray[np.bool_]]

#: Components of an episode that have a random stream of their own, beside the mismatch's (number 0).
NOISE_STREAM, SCENARIO_STREAM = 1, 2
#: Keys of the `options` of `reset`.
OPTIONS = ("mismatch", "scenario", "case", "reset_mask")
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
SEED = Limits(0, 2**128 - 1, whole=True)

_NEVER = np.iinfo(np.int64).max
#: Rows whose courses are drawn at a time.
_CHUNK = 1024
_AT_RESET = [key for key in COLUMNS if not key.startswith("reward")]
#: True only where the model has a supply pressure; without one it knows the difference of both lines alone.
_OF_LINES = "lowest_line_pressure_bar"


class HydraulicSyncVectorEnv(VectorEnv[NDArray[np.float32], NDArray[np.float32], NDArray[Any]]):
    """The native batch of `HydraulicSync-v0`; `HydraulicSyncEnv` describes task, spaces and arguments.

    `gymnasium.make_vec("hydro_env:HydraulicSync-v0", num_envs=N, ...)` makes it. Beyond the single environment:

    * `reset(seed=s)` seeds row i with s + i, `reset(seed=[...])` each row with its own. Row i then is bit for bit the
      single environment of that seed, in this and all following episodes. Runs that are to share no episode need seeds
      at least N apart.
    * `autoreset_mode`: "NextStep" (default: the step after an end resets the row, ignores its action and has reward 0),
      "SameStep" (the end's observation is in `info["final_obs"]`) or "Disabled" (reset with
      `options={"reset_mask": mask}`).
    * `options` of `reset` hold for all rows that it resets, until they are reset again: an autoreset goes on with them, with the
      same case. `case=k` means case k + i for row i, a list one for each.
    * `info` holds arrays with one row per rig and masks `_key` as Gymnasium has them; `pairs` the values of the valves.
    * `max_episode_steps` ends episodes early (truncation).
    * `plant` may be a `Plant`: its model, with its tolerance.
    * `dtype`: "float64" (default), or "float32" for a faster plant (see `Plant`). Angles are then summed up period by
      period in float64, and those of `plant` are what was turned since, unless an effect goes by them.
    * `threads` that step the rows together, 1 by default; as many as the machine has cores pay from some hundred rows on. They
      change no bit.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 100}  # noqa: RUF012 (Gymnasium's way)
    _spec: EnvSpec | None = None
    _pool: tuple[int, ThreadPoolExecutor] | None

    def __init__(
        self,
        num_envs: int = 1,
        plant: str | Path | Mapping[str, Any] | PlantModel | Plant = "paper_dead_zone",
        scenario: str | Mapping[str, Any] | Scenario = "random_steps",
        mismatch: str | Path | Mapping[str, Any] | Mismatch | None = "auto",
        control_period: float = 0.01,
        render_mode: str | None = None,
        *,
        history: int = 1,
        noise: float | Mapping[str, float] = 1.0,
        reward: Mapping[str, float] | Reward | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        dtype: str = "float64",
        render_width: int = 640,
        increment: float | None = None,
        errors: bool = False,
        threads: int = 1,
        tolerance_rpm: float | None = None,
    ) -> None:
        super().__init__()
        self.num_envs = NUM_ENVS.check(num_envs, "num_envs")
        self.control_period = CONTROL_PERIOD.check(control_period, "control_period")
        self.history = HISTORY.check(history, "history")
        self.increment = _optional(INCREMENT, increment, "increment")
        self.max_episode_steps = _optional(EPISODE, max_episode_steps, "max_episode_steps")
        self.threads = THREADS.check(threads, "threads")
        _one_of("errors", errors, (False, True))
        _one_of("dtype", dtype, ("float64", "float32"))
        _one_of("render_mode", render_mode, (None, "rgb_array"))
        _one_of("autoreset_mode", autoreset_mode, (*AutoresetMode, *(mode.value for mode in AutoresetMode)))
        self.dtype, self.errors = np.dtype(dtype), errors
        self.model = plant.model if isinstance(plant, Plant) else load_model(plant)
        self._tolerance = _tolerance(plant, self.model, tolerance_rpm)
        self.scenario = load_scenario(scenario)
        self.mismatch = load_mismatch(
            default_mismatch(plant) if isinstance(mismatch, str) and mismatch == "auto" else mismatch
        )
        self.render_mode = render_mode
        self.reward = load_reward(reward)
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {
            **type(self).metadata,
            "render_fps": max(1, round(1.0 / self.control_period)),
            "autoreset_mode": self.autoreset_mode,
        }

        # First of what takes room, so that a batch that cannot fit is refused in its words.
        self._effects: tuple[str, ...] = ()
        self._build(self.mismatch)
        _check_room(self.num_envs, self.history)
        self._make_spaces()
        self._levels = noise_levels(noise)
        self._noisy = bool(self._levels.any())
        self._weights = self.reward.weights()
        width = RENDER_WIDTH.check(render_width, "render_width")
        self._recorder = None if render_mode is None else Recorder(self.num_envs, width)
        self._settable: dict[str, tuple[float, float]] = {}
        self._clear()

    def _make_spaces(self) -> None:
        width = (FRAME + ERRORS * self.errors) * self.history
        self.single_observation_space = spaces.Box(-LIMIT, LIMIT, (width,), np.float32)
        self.single_action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def _clear(self) -> None:
        """Makes room for what belongs to the episodes of each row."""
        n = self.num_envs
        self._seeds: list[int] = []
        self._episode = np.full(n, -1, np.int64)
        self._case = np.full(n, -1, np.int64)
        self._fault = np.full(n, "", object)
        self._ended = np.zeros(n, np.bool_)
        self._begun = False
        #: Options (N,) of the last `reset` of each row, or None.
        self.held = np.full(n, None, object)
        # The episode of each row: where it stands, what is driven, what the sensors do.
        self._step, self._last = np.zeros(n, np.int64), np.zeros(n, np.int64)
        self._courses, self._place, self._driven = Courses(n), np.zeros((n, 2), np.int64), np.zeros((n, 4))
        self._noise = NormalNumbers(n, self._levels.size)
        self._sensor = {name: np.full((n, 2), p.nominal) for name, p in SENSOR_PARAMETERS.items()}
        self._stuck, self._held = np.full((n, 2), _NEVER, np.int64), np.zeros((n, 2))
        self._fraction, self._moved, self._turned = np.zeros((n, 2)), np.zeros(n), np.zeros((n, 2))
        self._command, self._torque = np.zeros((n, 2)), np.zeros((n, 2))
        self._frames = np.zeros((n, FRAME * self.history), np.float32)
        self._all = np.arange(n)
        self._shared: Scenario | None = None

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_pool": None}  # a copy has threads of its own

    # --- the interface of Gymnasium -------------------------------------------------------------------------------
    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begins a new episode in every row (or those of `options["reset_mask"]`).

        Without a seed each row goes on to the next episode of its seed. InputError for unknown options.
        """
        if not isinstance(options, Mapping | None):
            raise InputError(
                f"reset: options is {shown(options)}, expected a mapping of {', '.join(OPTIONS)}"
            )
        options = dict(options or {})
        for key in options:
            if key not in OPTIONS:
                raise InputError(f"reset: unknown option {shown(key)}: {suggestion(key, OPTIONS)}")
        if "scenario" in options:
            options["scenario"] = load_scenario(options["scenario"])
        if "mismatch" in options:
            options["mismatch"] = load_mismatch(options["mismatch"])
        rows = self._all
        mask = options.pop("reset_mask", None)
        if mask is not None:
            try:
                mask = np.asarray(mask)
            except ValueError:
                raise InputError(f"reset: reset_mask is {shown(mask)}, expected a mask of rows") from None
            if mask.dtype != np.bool_ or mask.shape != (self.num_envs,) or not mask.any():
                raise InputError(
                    f"reset: reset_mask must be a mask of {self.num_envs} rows with one at least chosen"
                )
            rows = np.flatnonzero(mask)
        self._begin(rows, *self._next(rows, seed), **options)
        self.held[rows] = options or None
        self._begun = bool((self._episode >= 0).all())
        result = self._outputs()
        self._look(self._all if mask is None else rows, result)
        if mask is not None:  # rows that are not reset show what they showed last
            result[0][~mask] = self._frames[~mask]
        return self.seen(result[0]), self._reset_info({}, rows, result[1])

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], Floats, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One control period with the actions (N, 2). ValueError if they are no finite real numbers or the shape is wrong."""
        mode, everyone = self.autoreset_mode, np.ones(self.num_envs, np.bool_)
        again = self._ended.copy()
        if mode is AutoresetMode.DISABLED and again.any():
            raise gymnasium.error.ResetNeeded(
                "an episode has ended: reset its row, options={'reset_mask': mask}"
            )
        waiting = mode is AutoresetMode.NEXT_STEP and again.any()
        result = self._outputs() if waiting and again.all() else self.advance(actions)
        observation, true, reward, terminated, truncated = result
        if waiting:
            rows = np.flatnonzero(again)
            self._restart(rows, result)
            reward[rows], terminated[rows], truncated[rows] = 0.0, False, False
            info = self._reset_info(self._step_info(true, terminated, everyone, ~again), rows, true)
        else:
            info = self._step_info(true, terminated, everyone, everyone)
        ended = terminated | truncated
        if mode is AutoresetMode.SAME_STEP and ended.any():
            rows = np.flatnonzero(ended)
            final = np.full(self.num_envs, None, object)
            for row in rows:
                final[row] = self.seen(observation[row]).copy()
            final_info = self._step_info(true.copy(), terminated, ended, ended)
            self._restart(rows, result)
            info = self._step_info(true, np.zeros_like(ended), everyone, ~ended)
            info |= {"final_obs": final, "_final_obs": ended, "final_info": final_info, "_final_info": ended}
            self._reset_info(info, rows, true)
            ended = np.zeros_like(ended)
        self._ended = ended
        return self.seen(observation), reward, terminated, truncated, info

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """A picture (height, width, 3) of each row's recent past, if `render_mode` is "rgb_array"."""
        if self._recorder is None:
            return None
        return tuple(
            self._recorder.picture(row, self.control_period, float(self._rated[row].max()))
            for row in range(self.num_envs)
        )

    def call(self, name: str, *args: Any, **kwargs: Any) -> tuple[Any, ...]:
        """An attribute, or what a method returns, for each row, as Gymnasium's own batches have it and trainers expect it.

        Everything but pictures the rows have in common. ValueError for what steps or resets them.
        """
        if name in ("reset", "step", "advance"):
            raise ValueError(f"{name} concerns all rows: call it on the environment itself")
        found = getattr(self, name)
        answer = found(*args, **kwargs) if callable(found) else found
        return answer if name == "render" and answer is not None else (answer,) * self.num_envs

    @property
    def spec(self) -> EnvSpec | None:  # type: ignore[override]
        """What Gymnasium made this from; `max_episode_steps` is the length of its episodes."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        self._spec = made_spec(spec, self.episode_steps)

    @property
    def episode_steps(self) -> int:
        """Control periods in an episode of the scenario that it was made with."""
        steps = self.scenario.steps(self.control_period)
        return steps if self.max_episode_steps is None else min(steps, self.max_episode_steps)

    # --- what the single environment and Stable-Baselines3 build on -----------------------------------------------
    @property
    def pairs(self) -> dict[str, Floats]:
        """Values (N, 2) of the parameters in which the valves of this environment may differ, as they now are."""
        names = self._settable or self.model.values
        return {
            name: self._sensor[name].copy() if name in self._sensor else self.plant.get(name)
            for name in names
        }

    def course(self, row: int = 0) -> Reference:
        """What the present episode of a row drives: set-point (T + 1,) in rad/s and loads (T + 1, 2) in N m."""
        return self._courses.course(row, int(self._last[row]) + 1)

    def advance(self, actions: ArrayLike) -> Result:
        """One control period for all rows, without autoreset, info and `errors`. ValueError as for `step`."""
        if not self._begun:
            raise gymnasium.error.ResetNeeded("reset every row of the environment before the first step")
        wanted = _real(actions)
        if wanted.shape != self._command.shape:
            raise ValueError(f"actions have the shape {wanted.shape}, expected {self._command.shape}")
        if self.increment is not None and np.isfinite(wanted).all():  # what is not is refused below
            wanted = self._fraction + self.increment * np.clip(wanted, -1.0, 1.0)
        if not apply(
            wanted, self._rated, self._driven, self._step, self._fraction, self._moved, self._command, self._torque
        ):  # fmt: skip
            raise ValueError("an action is not finite")
        result = self._outputs()
        if self._parts:
            if self._pool is None or self._pool[0] != os.getpid():  # threads do not survive a fork
                self._pool = os.getpid(), ThreadPoolExecutor(self.threads, "hydro_env")
            list(self._pool[1].map(partial(self._hold_part, result), self._parts))
            self.plant.turn(1)
        else:
            self.plant.hold(self._command, self._torque, self.control_period)
            self._sense(self._all, result)
        self._show(self._all, result)
        return result

    def _hold_part(self, result: Result, part: slice) -> None:
        """Plant and sensors of a range of rows over a period, in a thread."""
        self.plant.hold_rigs(part, self._command, self._torque, self.control_period)
        self._sense(self._all[part], result)

    # --- episodes -------------------------------------------------------------------------------------------------
    def _build(self, mismatch: Mismatch | None) -> None:
        """Makes the plant anew with the effects that a mismatch needs beside those it had."""
        self._effects += () if mismatch is None else mismatch.effects
        self.plant = make_plant(
            self.model, self.num_envs, effects=self._effects, tolerance=self._tolerance, dtype=self.dtype
        )
        self._where = np.array([self.plant.row_of(name) for name in SIGNALS], np.int64)
        self._half = self.plant.memory.shape[2] // 2
        self._rated = self.plant.get("u_rated")
        # In float32 the angles are summed up here, unless an effect goes by them.
        self._winds = type(self.plant) is Plant and self.dtype == np.float32 and not self.plant.angle_acts
        self._parts, self._pool = self._split(), None
        self.plant.make_room(self.control_period)  # once for all threads

    def _split(self) -> list[slice]:
        """The ranges of rows that threads step, whole blocks of the kernel; none where one thread steps them all."""
        if self.threads == 1 or type(self.plant) is not Plant:
            return []
        blocks = -(-self.num_envs // self._half)
        edges = [min(self.num_envs, blocks * k // self.threads * self._half) for k in range(self.threads + 1)]
        parts = [slice(low, high) for low, high in pairwise(edges) if high > low]
        return parts if len(parts) > 1 else []

    def _next(
        self, rows: NDArray[np.int64], seed: int | Sequence[int | None] | None = None
    ) -> tuple[list[int], list[int]]:
        """Seeds of these rows and numbers of the episodes they play next. InputError for wrong seeds."""
        n = self.num_envs
        if seed is None or (isinstance(seed, (Sequence, np.ndarray)) and not isinstance(seed, (str, bytes))):
            given = [None] * n if seed is None else list(seed)
        else:
            first = SEED.check(seed, "reset: seed")
            super().reset(seed=first)
            given = [first + i for i in range(n)]
        if len(given) != n:
            raise InputError(f"reset: {len(given)} seeds for {n} environments")
        given = [None if each is None else SEED.check(each, "reset: a seed") for each in given]
        if not self._seeds:
            base = int(np.random.SeedSequence().generate_state(1, np.uint64)[0]) >> 1
            self._seeds = [base + i for i in range(n)]
        seeds, episodes = [], []
        for i in rows.tolist():
            each = given[i]
            seeds.append(self._seeds[i] if each is None else each)
            episodes.append(int(self._episode[i]) + 1 if each is None else 0)
        return seeds, episodes

    def _begin(self, rows: NDArray[np.int64], seeds: list[int], episodes: list[int], **options: Any) -> None:
        """Draws and starts an episode of each of these rows; `options` as for `reset`."""
        scenario: Scenario = options.get("scenario", self.scenario)
        mismatch: Mismatch | None = options.get("mismatch", self.mismatch)
        steps = scenario.steps(self.control_period)
        cases = self._cases(rows, mismatch, seeds, episodes, options.get("case"))
        if mismatch is not None and set(mismatch.effects) - set(self.plant.effects):
            if rows.size < self.num_envs:
                raise InputError(
                    "reset: this mismatch has effects the plant lacks so far: reset all rows with it"
                )
            self._build(mismatch)
        # Up to here something could be wrong with the options, and nothing has been changed; from here on not.
        for row, seed in zip(rows.tolist(), seeds, strict=True):
            self._seeds[row] = seed
        self._episode[rows] = episodes
        self._draw_valves(rows, mismatch, seeds, episodes, cases)
        self._drive(rows, scenario, steps, seeds, episodes)
        self.plant.reset(None if rows.size == self.num_envs else rows)
        self.has_lines = bool(self.plant.get("mean_line_pressure").any())
        self._step[rows] = 0
        self._fraction[rows] = 0.0
        self._moved[rows] = 0.0
        self._turned[rows] = 0.0
        self._held[rows] = 0.0
        self._ended[rows] = False
        if self._recorder is not None:
            self._recorder.clear(rows)

    def _restart(self, rows: NDArray[np.int64], result: Result) -> None:
        """Starts the next episode of these rows and puts its first signals in their place."""
        for options in {id(each): each for each in self.held[rows]}.values():
            some = rows[[each is options for each in self.held[rows]]]
            self._begin(some, *self._next(some), **(options or {}))
        first = self._outputs()
        self._look(rows, first)
        result[0][rows], result[1][rows] = first[0][rows], first[1][rows]

    def _cases(
        self,
        rows: NDArray[np.int64],
        mismatch: Mismatch | None,
        seeds: list[int],
        episodes: list[int],
        asked: Any,
    ) -> list[int]:
        """Numbers of the cases these rows meet, -1 for none. InputError for one that is asked for and not there."""
        listed = None if mismatch is None else mismatch.cases
        if mismatch is None or listed is None:
            if asked is not None:
                raise InputError(
                    "reset: option case needs a mismatch with a fixed list of cases, such as val"
                )
            return [-1] * rows.size
        if asked is None:
            return [mismatch.case(seed, episode) for seed, episode in zip(seeds, episodes, strict=True)]
        try:
            cases = (
                [int(asked) + int(i) for i in rows] if np.ndim(asked) == 0 else [int(asked[i]) for i in rows]
            )
        except (TypeError, ValueError, IndexError, OverflowError):
            raise InputError(
                f"reset: option case is {shown(asked)}, expected a number or one for each row"
            ) from None
        if not all(0 <= each < listed for each in cases):
            raise InputError(f"reset: option case: cases of {mismatch.name!r} are 0 ... {listed - 1}")
        return cases

    def _draw_valves(
        self,
        rows: NDArray[np.int64],
        mismatch: Mismatch | None,
        seeds: list[int],
        episodes: list[int],
        cases: list[int],
    ) -> None:
        self._case[rows] = cases
        self._fault[rows] = ""
        values: dict[str, Floats] = {}
        if mismatch is not None:
            drawn = mismatch.draw(seeds, episodes, cases, self.model)
            values = drawn.values
            self._fault[rows] = drawn.fault
            for name in values:
                if name not in self._settable:
                    self._settable[name] = own_values(name, self.model)
        pairs = {name: values.get(name, own) for name, own in self._settable.items()}
        for name in self._sensor.keys() & pairs.keys():
            self._sensor[name][rows] = pairs.pop(name)
        self.plant.set_values(pairs, rows)
        self._rated[rows] = self.plant.get("u_rated")[rows]
        stuck = self._sensor["speed_sensor.stuck_from"][rows]
        finite = stuck < inf
        self._stuck[rows] = _NEVER
        # At the earliest from the first reading on, which it then holds.
        first = np.maximum(1, np.ceil(np.where(finite, stuck, 0.0) / self.control_period - 1e-9))
        self._stuck[rows] = np.where(finite, first.astype(np.int64), _NEVER)

    def _drive(
        self, rows: NDArray[np.int64], scenario: Scenario, steps: int, seeds: list[int], episodes: list[int]
    ) -> None:
        self._last[rows] = steps if self.max_episode_steps is None else min(steps, self.max_episode_steps)
        if self._noisy:
            self._noise.begin(rows, _streams(seeds, episodes, NOISE_STREAM))
        if not scenario.random and self._shared is not scenario and rows.size == self.num_envs:
            self._shared = scenario
            common = scenario.reference(self.control_period)
            self._courses.share(*pieces(common.setpoint[None], common.load[None]))
        if self._shared is scenario:
            self._courses.of[rows] = 0
            return
        streams = _streams(seeds, episodes, SCENARIO_STREAM)
        for begin in range(0, rows.size, _CHUNK):
            part = slice(begin, begin + _CHUNK)
            starts, levels = pieces(*scenario.courses(self.control_period, Streams(streams.states[part])))
            self._check_memory(steps, levels.shape[1])
            self._courses.put(rows[part], starts, levels)

    def _check_memory(self, steps: int, most: int) -> None:
        """InputError where this machine has no room for courses of at most so many pieces."""
        need = self._courses.room(most) + self.plant.memory.nbytes
        if need > (available := machine_memory()):
            raise InputError(
                f"num_envs is {self.num_envs}: episodes of {steps} steps need {need / 2**30:.3g} GiB, this machine has"
                f" {available / 2**30:.3g} GiB, enough for about {int(self.num_envs * available / need)}; take fewer, or a"
                " shorter scenario"
            )

    # --- outputs --------------------------------------------------------------------------------------------------
    def _outputs(self) -> Result:
        n = self.num_envs
        return (
            np.empty(self._frames.shape, np.float32),
            np.zeros((n, TRUE)),
            np.zeros(n),
            np.zeros(n, np.bool_),
            np.zeros(n, np.bool_),
        )

    def _look(self, rows: NDArray[np.int64], result: Result) -> None:
        self._sense(rows, result)
        self._show(rows, result)

    def _sense(self, rows: NDArray[np.int64], result: Result) -> None:
        if self._noisy:
            self._noise.draw(rows)
        c = self._courses
        drive(rows, self._step, self._last, c.of, c.starts, c.levels, self._place, self._driven)
        look(
            rows, self.plant.memory, self._half, self._where, self._step, self._last, self._driven, self._noise.numbers,
            self._levels, SCALES, LIMIT, self._sensor["speed_sensor.noise_factor"], self._stuck, self._held, self._fraction,
            self._moved, self._rated, self._weights, *result,
        )  # fmt: skip
        if self._winds:
            wind(
                rows,
                self.plant.memory,
                self._half,
                self._where[SIGNALS.index("angle")],
                self._turned,
                result[1],
            )

    def _show(self, rows: NDArray[np.int64], result: Result) -> None:
        """What was sensed, behind the frames before it, and to the pictures."""
        observation = result[0]
        if self.history > 1:
            begun = rows[self._step[rows] == 0]
            observation[rows, :-FRAME] = self._frames[rows, FRAME:]
            observation[begun, :-FRAME] = np.tile(observation[begun, -FRAME:], self.history - 1)
        if rows is self._all:
            self._frames[:] = observation
        else:
            self._frames[rows] = observation[rows]
        if self._recorder is not None:
            self._recorder.add(rows, result[1], self._turned if self._winds else self.plant.angle)

    def seen(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """What leaves the environment of its frames."""
        return with_errors(observation) if self.errors else observation

    def _step_info(
        self,
        true: Floats,
        terminated: NDArray[np.bool_],
        given: NDArray[np.bool_],
        stepped: NDArray[np.bool_],
    ) -> dict[str, Any]:
        """What a step tells: true signals of the rows `given`, and the terms of the reward of those that `stepped`."""
        info: dict[str, Any] = {}
        for key, column in COLUMNS.items():
            if key == _OF_LINES and not self.has_lines:
                continue
            info[key] = true[:, column]
            info["_" + key] = given if key in _AT_RESET else stepped
        if terminated.any():
            info["termination"] = self.reasons(terminated)
            info["_termination"] = terminated.copy()
        return info

    def reasons(self, terminated: NDArray[np.bool_]) -> NDArray[np.object_]:
        """Why these rows were terminated, None for the others."""
        lost = {each.rig: f"diverged: {each}" for each in reversed(self.plant.lost)}
        return np.array(
            [lost.get(n, DIVERGED) if each else None for n, each in enumerate(terminated)], object
        )

    def _reset_info(self, info: dict[str, Any], rows: NDArray[np.int64], true: Floats) -> dict[str, Any]:
        """Adds what belongs to the first observation of some rows."""
        mask = np.zeros(self.num_envs, np.bool_)
        mask[rows] = True
        for key in _AT_RESET:
            if key not in info and (key != _OF_LINES or self.has_lines):
                info[key], info["_" + key] = true[:, COLUMNS[key]], mask
        pairs: dict[str, Any] = {}
        for name, values in self.pairs.items():
            pairs[name], pairs["_" + name] = values, mask
        for key, value in (("mismatch", pairs), ("fault", self._fault.copy()), ("case", self._case.copy())):
            info[key], info["_" + key] = value, mask
        return info


def _streams(seeds: list[int], episodes: list[int], component: int) -> Streams:
    """The streams of a component in these episodes of these seeds."""
    return Streams.seeded([seeds], [episodes, [component] * len(seeds)])


def _real(actions: ArrayLike) -> Floats:
    """Actions as float64. ValueError for what is no array of real numbers."""
    try:
        given = np.asarray(actions)
    except ValueError:
        raise ValueError("actions have rows of different lengths") from None
    if given.dtype.kind not in "fiub":
        raise ValueError(f"actions are {given.dtype}, expected real numbers")
    return np.ascontiguousarray(given, np.float64)


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


def _one_of(name: str, value: object, right: tuple[object, ...]) -> None:
    """InputError for an argument that is none of these."""
    if not any(type(value) is type(one) and value == one for one in right):
        raise InputError(f"{name} is {shown(value)}, expected one of {', '.join(map(repr, right))}")


def _check_room(num_envs: int, history: int) -> None:
    """InputError where the observations alone (limits of the spaces of one and of all rows, frames, results) cannot fit."""
    need = 6.0 * 4 * FRAME * history * num_envs
    if need > (most := machine_memory()):
        raise InputError(
            f"num_envs is {num_envs}, history is {history}: the observations need {need / 2**30:.1f} GiB, this machine has"
            f" {most / 2**30:.1f} GiB"
        )

"""The environment: synchronise two hydraulic motors although their valves differ."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from ..arrays import Picture, Singles
from ..plant import Plant, PlantModel
from ..tasks.mismatch import Mismatch
from ..tasks.scenarios import Scenario
from .batch import HydraulicSyncVectorEnv, one_of, row_of
from .env_spec import OwnSpec
from .observation import Noise
from .own_functions import OwnObservation, OwnReward
from .randomisation import SEED
from .render import PICTURES, Window
from .reward import Reward


class HydraulicSyncEnv(gymnasium.Env[Singles, Singles]):
    """
    ## Description

    Synchronise two hydraulic motors, each driven by its own proportional valve, at the speed of the set-point. The valves
    are of one type and yet differ in dead zone, gain, friction and offset. The agent observes only the rig's sensors; the
    valves' parameters are hidden.

    The plant is that of the paper "Impact of proportional valves' differences to ensure uniform motion of hydraulic
    motors", extended by what its equations leave out; see `hydro_env.plant`.

    ## Action space

    `Box(-1, 1, (2,), float32)`: the commands of valve 1 and valve 2 as fractions of the rated command (`u_rated` of the
    plant), held over the control period. Values beyond are clipped; values that are not finite raise a ValueError. With
    `increment` they are changes of the commands, in fractions of that increment.

    ## Observation space

    `Box(-10, 10, (9 * history,), float32)`: what can be measured, divided by scales that follow the size of the rig;
    12 * history with `errors`. With `history` above 1 the last frames, oldest first; at the start of an episode the first
    frame stands for those before it.

    In order: set-point in force from now on; speeds of motors 1 and 2; currents of coils 1 and 2; pressure differences over
    motors 1 and 2; the last action, clipped. `hydro_env.envs.observation` has names, scales and noise as data, and
    docs/reference/environment.md as a table.

    `hydro_env.envs.observation.decode`, told the size of the rig (`hydro_env.plant.scales_of`), gives them back in SI.

    ## Reward

    Minus the cost of the period: 0.5 |speed - set-point| / 100 rpm (mean of both motors) + 1.5 |speed 1 - speed 2| / 100
    rpm + 0.1 |change of action| (mean of both valves); 100 rpm on the paper's rig, on another one in proportion to its
    speed. Speeds are the true ones at the end of the period, the set-point the one that was in force. The terms are in
    `info`; `hydro_env.envs.Reward` describes the weights.

    ## Start

    Both motors at rest, both spools centred. A pair of valves is drawn from `mismatch`, a random scenario is drawn again.

    ## End

    *Truncation* at the end of the scenario: 600 steps by default. *Termination* only if the simulation diverges numerically,
    which costs 10 once; `info["termination"]` then says so.

    The environment ends its episodes itself, since their length depends on scenario and control period. So Gymnasium's
    registered specification has no limit; `env.spec.max_episode_steps` of an environment that was made has its own length.
    `env.spec.reward_threshold` is the mean return of `cross_coupled` in the default task, None in another one.

    ## Info

    True values, without noise and lag: `speed_rpm` (2,), `setpoint_rpm`, `speed_difference_rpm` (1 less 2),
    `peak_difference_rpm` (the largest absolute difference within the last control period, on a grid of 1 ms or finer),
    `command_V` (2,), `angle_difference_deg` (1 less 2). After a step also `reward_tracking`, `reward_difference`,
    `reward_variation`, and costs for constrained methods: `cost_difference`, by how many rpm the speed difference exceeds 20 rpm
    (on the paper's rig), and `cost_travel`, the mean change of the commands as a fraction of the rated one. Where the model has a
    supply pressure (`rig`), `lowest_line_pressure_bar`, the least gauge pressure in the four lines at the end of the
    period: below -1 bar oil would cavitate, and the simulation is no longer that of a real rig. Without a supply pressure
    only the difference of both lines is known. After a reset `mismatch` (parameter: (2,) values, SI), `fault` (its name,
    or "") and `case` (number in the split's list, -1 if it has none).

    ## Arguments

    `gymnasium.make("hydro_env:HydraulicSync-v0", plant="paper", scenario="setpoint_steps", mismatch="test_interp")`

    * `plant`: preset, YAML file, mapping or `PlantModel`. Default `paper_dead_zone`.
    * `scenario`: a name of `hydro_env.tasks.SCENARIOS`, step tables (see there) or a `Scenario`. Default
      `random_steps`.
    * `mismatch`: a split (`train`, `val`, `test_interp`, `test_extrap`, `faulted`; `train_robust` with delays, other control
      periods, noise and faults; `train_any`, `val_any`, `test_any` of whole rigs), a named pair (`paper_pair`), a YAML
      file or mapping of parameters to ranges or values, or `own` (None) for the plant's own pair. Default `auto`: `own`
      for a plant file that sets itself what `train` draws (`Kq`, a dead zone, ...), else `train`.
    * `control_period`: s, default 0.01.
    * `render_mode`: None, "rgb_array" (pictures) or "human" (a window in real time); extra `render`.
    * `render_width`: of the picture in pixels, default 640; its height is three quarters of that.
    * `history`: frames in an observation, default 1.
    * `noise`: factor on the sensors' noise, 0 for none, or levels such as {"speed_rpm": 2.0}. In place of a number a range,
      [lowest, highest], from which each episode draws, for each kind of sensor by itself.
    * `reward`: weights to be changed, such as {"variation": 0.5}, or a function of the true signals of `info` (arrays with one
      row per rig), with "reward" for the default one, that returns (N,).
    * `observation`: None, or a function of the frames (N, n) and the true signals that returns (N, k); it is called once with
      zeros to learn k. It goes row by row, as `reward` does: row i then is still the single environment.
    * `privileged`: whether `info["privileged"]` tells what no sensor shows, see `hydro_env.envs.privileged_names`.
    * `increment`: None, or what an action of 1 adds to the command in a control period, as a fraction of the rated one.
    * `errors`: whether each frame's errors to the set-point and speed difference, magnified, stand in front of the frames; see
      `hydro_env.envs.observation.with_errors`.
    * `tolerance_rpm`: None, or the error of a speed by which the simulation chooses its steps, in place of the model's (0.1 rpm
      unless its file says otherwise). A larger one is faster; see `hydro_env.plant.Plant`.

    `reset(options=...)` takes, for that episode, `mismatch`, `scenario`, `noise` and `case` (number of the case of a split
    with a fixed list). Anything unknown raises `hydro_env.errors.InputError`.

    ## Seeds

    `reset(seed=s)` begins the first episode of seed s, each `reset()` after it the next one. Mismatch, noise and
    scenario have a random stream of their own for each seed and episode. In a split with a fixed list of n cases the
    first episode of seed s meets case s modulo n, whatever else is chosen.

    ## Versions

    * `HydraulicSync-v0`: first version. A number means the same as long as `hydro_env.tasks.VERSIONS` (of physics, splits and
      reward) does; where one of these is raised, all ids go up.
    * `HydraulicSyncIncrement-v0`: the same with `increment=0.3, history=2, errors=True`.
    * `HydraulicSyncTraining-v0`: in addition `reward={"tracking": 0.08, "difference": 0.18, "variation": 0.002}`, since
      critics are slow to learn returns of a hundred.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 100}  # noqa: RUF012 (Gymnasium's way)
    spec: Any = OwnSpec()

    def __init__(
        self, plant: str | Path | Mapping[str, Any] | PlantModel | Plant = "paper_dead_zone",
        scenario: str | Mapping[str, Any] | Scenario = "random_steps",
        mismatch: str | Path | Mapping[str, Any] | Mismatch | None = "auto", control_period: float = 0.01,
        render_mode: str | None = None, *, history: int = 1, noise: Noise = 1.0,
        reward: Mapping[str, float] | Reward | OwnReward | None = None, observation: OwnObservation | None = None,
        privileged: bool = False, render_width: int = 640, increment: float | None = None, errors: bool = False,
        tolerance_rpm: float | None = None,
    ) -> None:  # fmt: skip
        one_of("render_mode", render_mode, (None, *type(self).metadata["render_modes"]))
        self._window = Window("hydro_env") if render_mode == "human" else None
        self.batch = HydraulicSyncVectorEnv(
            1, plant, scenario, mismatch, control_period, "rgb_array" if render_mode == "human" else render_mode,
            history=history, noise=noise, reward=reward, observation=observation, privileged=privileged,
            autoreset_mode=AutoresetMode.DISABLED, render_width=render_width, increment=increment, errors=errors,
            tolerance_rpm=tolerance_rpm,
        )  # fmt: skip
        self.render_mode = render_mode
        self.metadata = {**type(self).metadata, "render_fps": self.batch.metadata["render_fps"]}
        self.observation_space = self.batch.single_observation_space
        self.action_space = self.batch.single_action_space
        self._seeded = False
        self._steps = 0

    @property
    def plant(self) -> Plant:
        """The plant, a batch of one."""
        return self.batch.plant

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Singles, dict[str, Any]]:
        """Begins an episode; see the class. InputError for unknown options."""
        if seed is not None:
            seed = SEED.check(seed, "reset: seed")
        super().reset(seed=seed)
        if seed is None and not self._seeded:
            seed = self.np_random_seed
        self._seeded = True
        observation, batched = self.batch.reset(seed=None if seed is None else [seed], options=options)
        info = row_of(batched, 0)
        self._steps = 0
        self._show()
        return observation[0], {k: v.item() if isinstance(v, np.generic) else v for k, v in info.items()}

    def step(self, action: Singles) -> tuple[Singles, float, bool, bool, dict[str, Any]]:
        """One control period; see the class. ValueError for an action that is not two finite real numbers."""
        observation, true, reward, terminated, truncated = self.batch.step_rows([action])
        row, values = true[0], true[0].tolist()
        info: dict[str, Any] = {
            key: row[column] if isinstance(column, slice) else values[column]
            for key, column in self.batch.columns.items()
        }
        if self.batch.privileged is not None:
            info["privileged"] = self.batch.privileged.now()[0]
        ended = bool(terminated[0])
        if ended:
            info["termination"] = self.batch.reasons(terminated)[0]
        self._show()
        return self.batch.seen(observation, true)[0], float(reward[0]), ended, bool(truncated[0]), info

    def render(self) -> Picture | None:  # type: ignore[override]
        """A picture (height, width, 3) of the recent past, if `render_mode` is "rgb_array"; "human" shows it by itself."""
        frames = None if self._window is not None else self.batch.render()
        return None if frames is None else frames[0]

    def _show(self) -> None:
        """With "human", shows some of the control periods, so that the film runs in real time."""
        if self._window is None:
            return
        every = max(1, round(1.0 / (PICTURES * self.batch.control_period)))
        if self._steps % every == 0:
            frames = self.batch.render()
            assert frames is not None
            self._window.show(frames[0], 1.0 / (every * self.batch.control_period))
        self._steps += 1

    def close(self) -> None:
        """Closes the window of "human"."""
        if self._window is not None:
            self._window.close()

"""Data sets of recorded episodes in Minari's format, for offline reinforcement learning (needs the extra `dataset`).

One controller on one split of valve pairs makes one data set, `hydro_env/CONTROLLER-SPLIT-v0`, or
`hydro_env/SCENARIO/CONTROLLER-SPLIT-v0` for another scenario than the environment's default. The folder they are written to is
one for the variable `MINARI_DATASETS_PATH`, with which `minari.load_dataset` finds them.

An episode holds observations (T + 1, 9), actions (T, 2) as they were applied, and rewards (T,). Its `infos` are true signals
that no sensor showed, each with T + 1 rows. Its metadata are its seed, the number of its pair (`case`), its `fault` and the
drawn values of its valves (`mismatch`).
"""

import re
import shlex
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np

from hydro_env import __version__
from hydro_env.arrays import Floats, Singles
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import SIGNALS, Step, roll_out
from hydro_env.errors import InputError, place_of, suggestion, to_install
from hydro_env.plant import load_model, preset_names
from hydro_env.streams import Component, Streams
from hydro_env.tasks import OWN, SPLITS, load_scenario

if TYPE_CHECKING:
    from gymnasium.envs.registration import EnvSpec
    from minari.data_collector import EpisodeBuffer

#: The behaviour that draws every action evenly from the action space, as Gymnasium's `action_space.sample` does.
RANDOM = "random"
#: What is recorded where no controller is named: from no skill to all knowledge.
CONTROLLERS = (RANDOM, "pid_tuned", "probing_flow", "gru", "oracle")
SPLITS_RECORDED = ("train", "test_interp")
DEFAULT_SCENARIO = "random_steps"
#: Pairs on which what was learned from a data set is to be scored.
EVALUATION = "test_interp"
#: Rigs that are driven at once, which bounds the memory.
AT_ONCE = 100
#: HDF5 takes half as much again as the arrays themselves; as a whole number to be safe.
HDF5_OVERHEAD = 2
#: What is kept of the environment's `info` beside the true signals.
COSTS = ("cost_difference", "cost_travel")


@dataclass(frozen=True)
class Task:
    """What one data set holds: who drives which pairs of valves through what. `seed` is that of the first episode; the others
    have the numbers after it, and `env.reset(seed=...)` draws an episode's pair, noise and scenario again.

    `trust`: whether the controller's file may run code, as for `make_controller`.
    """

    controller: str
    split: str
    scenario: str = DEFAULT_SCENARIO
    episodes: int = 100
    plant: str = "paper_dead_zone"
    control_period: float = 0.01
    seed: int = 0
    trust: bool = False

    @property
    def id(self) -> str:
        """Minari's id of the data set."""
        name = re.sub(r"[^\w-]+", "_", Path(self.controller).name)
        above = "hydro_env" if self.scenario == DEFAULT_SCENARIO else f"hydro_env/{self.scenario}"
        return f"{above}/{name}-{self.split}-v0"

    @property
    def command(self) -> str:
        """The command that writes this data set, without `--out`."""
        options = ("controller", "split", "scenario", "episodes", "plant", "control_period", "seed")
        words = [word for key in options for word in (f"--{key.replace('_', '-')}", str(getattr(self, key)))]
        return shlex.join(["hydro-env", "dataset", *words, *(["--trust"] if self.trust else [])])

    def driver(self, seeds: Sequence[int]) -> Any:
        """The controller for episodes of these seeds."""
        if self.controller == RANDOM:
            return _RandomActions(seeds)
        return make_controller(self.controller, trust=self.trust)

    def environment(self, split: str) -> dict[str, Any]:
        """Keyword arguments of the environment on a split. A model file becomes its content, so that the data set needs no
        other file; a controller that belongs to another plant gets that one with its own pair."""
        own = getattr(self.driver([]), "plant", None)
        plant = own or self.plant
        return {
            "plant": plant if plant in preset_names() else load_model(plant).to_dict(),
            "scenario": self.scenario,
            "mismatch": OWN if own else split,
            "control_period": self.control_period,
        }


def check(tasks: Sequence[Task], out: Path) -> None:
    """InputError where a package or a name is unknown, or a data set of the same id is in `out` already."""
    for package in ("minari", "h5py", "PIL"):
        if find_spec(package) is None:
            raise InputError(f"data sets need {package}: {to_install('dataset')}")
    ids = [task.id for task in tasks]
    for task in tasks:
        if task.split not in (*SPLITS, OWN):
            raise InputError(f"--split {task.split}: {suggestion(task.split, [*SPLITS, OWN])}")
        load_scenario(task.scenario)
        task.environment(task.split)
        if ids.count(task.id) > 1:
            raise InputError(f"two data sets have the id {task.id}: name each controller and split once")
        if (out / task.id).exists():
            raise InputError(f"{out / task.id}: is there already; remove it or name another --out")


def write(folder: Path, task: Task) -> Iterator[int]:
    """Writes one data set below `folder`, after every part of it yielding how many episodes there are.

    ModuleNotFoundError without the extra `dataset`; InputError if the controller fails or lets a rig diverge.
    """
    from minari import __version__ as minari_version
    from minari.dataset.minari_storage import MinariStorage

    # Minari counts the size of a relative path in the wrong place.
    path = (folder / task.id / "data").absolute()
    path.mkdir(parents=True)
    where = task.environment(task.split)
    evaluated = OWN if where["mismatch"] == OWN else EVALUATION
    storage = MinariStorage.new(path, env_spec=_spec(where), data_format="hdf5")
    storage.update_metadata(
        {
            "dataset_id": task.id,
            "minari_version": minari_version,
            "eval_env_spec": _spec({**where, "mismatch": evaluated}).to_json(),
            "algorithm_name": task.controller,
            "author": {"hydro_env"},
            "requirements": [f"hydro_env=={__version__}"],
            "description": f"Two hydraulic motors behind unequal proportional valves, driven by {task.controller}",
        }
    )
    cases: list[int] = []
    seeds = range(task.seed, task.seed + task.episodes)
    for first in range(0, task.episodes, AT_ONCE):
        buffers, drawn = _episodes(task, seeds[first : first + AT_ONCE], where)
        _make_sure_of_room(path, buffers)
        storage.update_episodes(buffers)
        storage.update_episode_metadata(drawn, range(first, first + len(buffers)))
        cases += [each["case"] for each in drawn]
        yield len(cases)
    needs = getattr(task.driver([]), "needs", "measurements")
    made = {"version": __version__, "command": task.command, "seed": task.seed, "needs": needs}
    storage.update_metadata({"hydro_env": {**made, "cases": cases}})


def _make_sure_of_room(folder: Path, buffers: "Sequence[EpisodeBuffer]") -> None:
    """OSError if the disk has no room for these episodes.

    HDF5 meets a full disk with a crash of the process. So as much as it may take is written beforehand and removed.
    """
    need = sum(
        np.asarray(each).nbytes
        for buffer in buffers
        for each in (buffer.observations, buffer.actions, buffer.rewards, *(buffer.infos or {}).values())
    )
    path = folder / "room"
    try:
        path.write_bytes(bytes(HDF5_OVERHEAD * need))
    finally:
        path.unlink(missing_ok=True)


def _spec(arguments: dict[str, Any]) -> "EnvSpec":
    """What Minari makes the environment from again."""
    spec = gymnasium.make("hydro_env:HydraulicSync-v0", **arguments).spec
    assert spec is not None
    return spec


class _RandomActions:
    """Actions (n, 2) drawn evenly from [-1, 1], each rig's from a stream of its own seed."""

    def __init__(self, seeds: Sequence[int]) -> None:
        self._streams = Streams(Component.ACTIONS, seeds, [0] * len(seeds))

    def reset(self, num_rigs: int, control_period: float) -> None:
        """Nothing: an object drives one episode."""

    def act(self, observation: Singles) -> Floats:
        """The next action of each rig."""
        return 2.0 * self._streams.random(2) - 1.0


def _episodes(
    task: Task, seeds: Sequence[int], where: dict[str, Any]
) -> "tuple[list[EpisodeBuffer], list[dict[str, Any]]]":
    """The episodes of these seeds, and what each drew."""
    from minari.data_collector import EpisodeBuffer

    kept: list[Step] = []
    try:
        roll_out(task.driver(seeds), seeds, steps=kept, **where)
    except Exception as problem:
        place = place_of(problem)
        if not place and not isinstance(problem, ValueError):
            raise
        raise InputError(f"controller {task.controller}: {problem}{place and f' ({place})'}") from None
    first, *steps = kept
    observations = np.array([step.observation for step in kept])
    actions = np.array([step.action for step in steps], np.float32)
    rewards = np.array([step.reward for step in steps])
    signals = {key: np.array([step.info[key] for step in kept]) for key in (*SIGNALS, *COSTS)}
    last = np.arange(len(rewards)) == len(rewards) - 1
    buffers = [
        EpisodeBuffer(
            seed=seed,
            observations=observations[:, row],
            actions=actions[:, row],
            rewards=rewards[:, row],
            terminations=np.zeros_like(last),
            truncations=last,
            infos={key: values[:, row] for key, values in signals.items()},
        )
        for row, seed in enumerate(seeds)
    ]
    pairs = {name: pair for name, pair in first.info["mismatch"].items() if not name.startswith("_")}
    drawn = [
        {
            "case": int(first.info["case"][row]),
            "fault": str(first.info["fault"][row]),
            "return": float(rewards[:, row].sum()),
            **{f"mismatch/{name}": pair[row] for name, pair in pairs.items()},
        }
        for row in range(len(seeds))
    ]
    return buffers, drawn

"""What stands under a version gives the same numbers as when it got that version."""

from __future__ import annotations

from collections.abc import Callable

import gymnasium
import numpy as np
import pytest

from hydro_env.envs import HydraulicSyncVectorEnv
from hydro_env.plant import load_model, scales_of
from hydro_env.streams import Component, Streams
from hydro_env.tasks import NAMED_PAIRS, SCENARIOS, SPLITS, VERSIONS, draw_pairs

Numbers = dict[str, list[float]]
#: Cases of each split: of `faulted` each fault on each channel.
CASES = 24


def physics() -> Numbers:
    """Of 0.4 s of each preset with fixed commands: root mean squares of what the six sensors show."""
    found = {}
    for name in ("paper", "paper_dead_zone", "rig", "servo"):
        env = HydraulicSyncVectorEnv(1, name, "unequal_load", None)
        env.reset(seed=0)
        actions = 0.8 * np.sin(0.3 * np.arange(40))[:, None, None] * [1.0, -0.7]
        seen = np.array([env.step(action)[0][0] for action in actions], np.float64)
        found[name] = np.sqrt(np.square(seen[:, 1:7]).mean(axis=0)).tolist()
    return found


def splits() -> Numbers:
    """Of each split the length of its list and the mean logarithm of what is drawn; of each scenario what it drives."""
    found = {}
    for name in (*SPLITS, *NAMED_PAIRS):
        values = np.array(list(draw_pairs(name, CASES, model=load_model("paper_dead_zone")).values.values()))
        sizes = np.abs(values[np.isfinite(values) & (values != 0.0)])
        cases = (SPLITS[name].cases or 0) if name in SPLITS else 0
        found[name] = [cases, float(np.log(sizes).mean())]
    for name, scenario in SCENARIOS.items():
        setpoint, load = scenario.profiles(0.01, Streams(Component.SCENARIO, [3] * 8, range(8)))
        weights = np.cos(np.arange(setpoint.shape[1]))
        found[name] = [float((setpoint @ weights).sum()), *(weights @ load).sum(axis=0).tolist()]
    return found


#: What these functions gave, by version.
PHYSICS = {1: {
    "paper": [0.4360439, 0.2020325, 0.5741876, 0.4022334, 1.469939, 0.6819316],
    "paper_dead_zone": [0.3811436, 0.2020325, 0.5741876, 0.4022334, 1.293002, 0.6819316],
    "rig": [0.4757849, 0.001446759, 0.5605248, 0.3928552, 4.165689, 0.007817482],
    "servo": [0.4281893, 0.2937047, 0.5741677, 0.4022215, 1.427673, 0.9800293],
}}  # fmt: skip
DRAWN = {1: {
    "train": [0, -4.607068],
    "val": [1000, -4.695656],
    "test_interp": [1000, -4.672095],
    "test_extrap": [1000, -4.140753],
    "faulted": [1000, -5.808562],
    "train_robust": [0, -4.386377],
    "train_any": [0, -1.964515],
    "val_any": [1000, -1.928768],
    "test_any": [1000, -1.942562],
    "paper_pair": [0, -3.022651],
    "setpoint_steps": [-112.6511, 0, 0],
    "load_step": [-68.52445, 0.2919927, 0.2919927],
    "staircase": [2.65034, 0, 0],
    "sine": [-2.863842, 0, 0],
    "unequal_load": [-45.68297, 0.2144567, 0.5997121],
    "disturbance": [-62.89789, 0.40607, -0.2989806],
    "random_steps": [172.8252, 1.155292, -1.516047],
    "random_profiles": [-76.17245, 1.155292, -1.516047],
    "random_drives": [-87.72418, 0.8859582, 0.02725157],
}}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "function", "known"),
    [("physics", physics, PHYSICS), ("splits", splits, DRAWN)],
    ids=["physics", "splits"],
)
def test_what_stands_under_a_version_is_the_same(
    name: str, function: Callable[[], Numbers], known: dict[int, Numbers]
) -> None:
    found, right = function(), known[VERSIONS[name]]
    for key in found.keys() | right.keys():
        assert found.get(key) == pytest.approx(right.get(key), rel=1e-5), (
            f"{key} is not what version {VERSIONS[name]} of {name!r} means: raise it in hydro_env/tasks/versions.py, give the "
            f"environments their next ids and store {found.get(key)} here"
        )


@pytest.mark.parametrize("plant", ["paper_dead_zone", "rig"])
def test_the_reward_is_that_of_its_version(plant: str) -> None:
    """Version 1 by its formula, from the true signals."""
    assert VERSIONS["reward"] == 1, (
        "write the formula of the new version here, and raise the environments' ids"
    )
    small = gymnasium.spec("HydraulicSyncTraining-v0").kwargs["reward"]
    unit = 100.0 * scales_of(load_model(plant)).speed
    for given, weights in ((None, (0.5, 1.5, 0.1)), (small, (0.08, 0.18, 0.002))):
        env = HydraulicSyncVectorEnv(1, plant, "setpoint_steps", "val", reward=given)
        info, before = env.reset(seed=0)[1], np.zeros(2)
        for n in range(60):
            aim, action = info["setpoint_rpm"], np.array([0.6 * np.sin(0.2 * n), 0.5])
            _, (reward,), _, _, info = env.step(action[None])
            speed, moved = info["speed_rpm"], np.abs(action - before).mean()
            apart = abs(float(speed[0, 0] - speed[0, 1]))
            terms = np.abs(speed - aim[:, None]).mean() / unit, apart / unit, moved
            before = action
            told = "raise the version of the reward and the environments' ids, and store the formula here"
            assert reward == pytest.approx(-sum(w * t for w, t in zip(weights, terms, strict=True))), told
            assert info["cost_travel"] == pytest.approx(moved), told
            beyond = max(0.0, apart - 0.2 * unit)
            assert info["cost_difference"] == pytest.approx(beyond), told

"""The native batch: each row is the single environment bit for bit, autoreset modes, masks, copies, wrappers."""

import copy
import os
import pickle
import subprocess
import sys
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import hydro_env  # noqa: F401 (registers the environment)
from hydro_env.envs import HydraulicSyncEnv, HydraulicSyncVectorEnv
from hydro_env.errors import InputError
from hydro_env.plant import Plant, PlantModel, load_model
from hydro_env.units import RPM

SHORT = {"duration": 0.12, "setpoint_rpm": [[0.0, 300.0], [0.06, -200.0]], "load_Nm": [[0.03, 0.5, 0.1]]}


def make(num_envs, **more):
    return gymnasium.make_vec("hydro_env:HydraulicSync-v0", num_envs=num_envs, **{"plant": "paper", **more})


def actions(num_envs, steps, seed=0):
    return np.random.default_rng(seed).uniform(-0.8, 0.8, (steps, num_envs, 2)).astype(np.float32)


def same(one, two):
    if isinstance(one, dict):
        assert one.keys() == two.keys()
        for key in one:
            same(one[key], two[key])
    elif isinstance(one, tuple):
        for a, b in zip(one, two, strict=True):
            same(a, b)
    else:
        np.testing.assert_array_equal(one, two)


def own_observation(frames, true):
    return np.column_stack([frames[:, :3], true["speed_difference_rpm"] / 100.0, true["privileged"]])


def own_reward(true):
    return true["reward"] - 0.01 * np.abs(true["angle_difference_deg"]) * (true["cost_travel"] > 0.0)


OWN = {"observation": own_observation, "reward": own_reward, "privileged": True, "noise": [0.5, 2.0]}


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(
    "more",
    [
        {"scenario": SHORT},
        {"scenario": SHORT, "mismatch": "test_extrap", "history": 2},
        {"scenario": SHORT, "mismatch": "faulted", "control_period": 0.005},
        {"scenario": "random_steps", "mismatch": "train"},
        {"scenario": SHORT, "history": 2, "errors": True, **OWN},
    ],
    ids=["train", "extrap", "faulted", "random", "own"],
)
def test_rows_are_the_single_environment(mode, more):
    """Bit for bit, into the following episodes, against Gymnasium's own batch of single environments."""
    num_envs, steps = 19, 40  # more than two blocks of the compiled plant, the last one not full
    batch = make(num_envs, autoreset_mode=mode, **more)
    rows = SyncVectorEnv(
        [lambda: HydraulicSyncEnv(**{"plant": "paper", **more})] * num_envs,
        autoreset_mode=AutoresetMode(mode),
    )
    observation, info = batch.reset(seed=40)
    wanted, told = rows.reset(seed=40)
    np.testing.assert_array_equal(observation, wanted)
    same(info, told)
    for n, action in enumerate(actions(num_envs, steps)):
        if n == 7:  # from here on rows end at different times
            mask = np.arange(num_envs) % 3 == 1
            some = batch.reset(options={"reset_mask": mask})[0], rows.reset(options={"reset_mask": mask})[0]
            np.testing.assert_array_equal(some[0], some[1])
        result, wanted = batch.step(action), rows.step(action)
        same(result[:4], wanted[:4])
        for key, value in wanted[4].items():
            if key == "final_obs":
                for a, b in zip(result[4][key], value, strict=True):
                    np.testing.assert_array_equal(a, b)
            elif key == "final_info":
                ended = result[4]["_final_info"]
                for name in value:
                    np.testing.assert_array_equal(result[4][key][name][ended], value[name][ended])
            elif not key.startswith("_") and not isinstance(value, dict):
                mask = wanted[4]["_" + key]
                np.testing.assert_array_equal(result[4]["_" + key], mask)
                np.testing.assert_array_equal(result[4][key][mask], value[mask])
            elif isinstance(value, dict):
                mask = wanted[4]["_" + key]
                for name in value:
                    np.testing.assert_array_equal(result[4][key][name][mask], value[name][mask])


def test_rows_do_not_depend_on_their_neighbours():
    wide, narrow = make(11, mismatch="faulted", scenario="sine"), make(3, mismatch="faulted", scenario="sine")
    wide.reset(seed=list(range(11))), narrow.reset(seed=[8, 0, 5])
    for action in actions(11, 30):
        one, two = wide.step(action), narrow.step(action[[8, 0, 5]])
        same(tuple(part[[8, 0, 5]] for part in one[:4]), two[:4])


def test_both_precisions_draw_the_same_episodes():
    """Pairs, set-points and loads; also of the largest seeds, and where rows are reset in another order."""
    seeds = [2**128 - 1, 5, 2**64]
    one, two = make(3, mismatch="train"), make(3, mismatch="train", dtype="float32")
    one.reset(seed=seeds)
    for row in (2, 0, 1):
        two.reset(seed=seeds, options={"reset_mask": np.arange(3) == row})
    same(one.pairs["vs"].astype(np.float32), two.pairs["vs"].astype(np.float32))
    for row in range(3):
        np.testing.assert_array_equal(one.reference(row).setpoint, two.reference(row).setpoint)
        np.testing.assert_array_equal(one.reference(row).load, two.reference(row).load)
    assert len({one.reference(row).setpoint.tobytes() for row in range(3)}) == 3


def test_seeds_of_rows():
    first = make(4).reset(seed=7)[0]
    np.testing.assert_array_equal(first, make(4).reset(seed=[7, 8, 9, 10])[0])
    mixed = make(4)
    mixed.reset(seed=7)
    again = mixed.reset(seed=[None, 8, None, 10])[0]
    np.testing.assert_array_equal(again[[1, 3]], first[[1, 3]])
    assert (again[[0, 2]] != first[[0, 2]]).any(axis=1).all()
    assert len({row.tobytes() for row in make(50).reset()[0]}) == 50


def test_staggered_ends():
    """Rows that end at different times: each goes its own way, and a step never shows one row's end in another."""
    batch = make(3, scenario=SHORT, autoreset_mode="Disabled")
    batch.reset(seed=0)
    ends = []
    for n, action in enumerate(actions(3, 30)):
        if n == 5:
            _, info = batch.reset(options={"reset_mask": np.array([False, True, False])})
            assert info["_mismatch"].tolist() == [False, True, False]
        truncated = batch.step(action)[3]
        ends.append(truncated.tolist())
        if truncated.any():
            with pytest.raises(gymnasium.error.ResetNeeded):
                batch.step(action)
            batch.reset(options={"reset_mask": truncated})
    assert [n for n, end in enumerate(ends) if end[0]] == [11, 23]
    assert [n for n, end in enumerate(ends) if end[1]] == [16, 28]


def test_masked_reset_touches_no_other_row():
    batch, twin = (make(5, scenario="sine", autoreset_mode="Disabled") for _ in range(2))
    for env in (batch, twin):
        env.reset(seed=0)
        for action in actions(5, 10):
            env.step(action)
    mask = np.array([True, False, False, True, False])
    observation, _ = batch.reset(seed=[3, None, None, 4, None], options={"reset_mask": mask})
    before = twin.step(np.zeros((5, 2)))
    after = batch.step(np.zeros((5, 2)))
    same(tuple(part[~mask] for part in after[:4]), tuple(part[~mask] for part in before[:4]))
    np.testing.assert_array_equal(observation[mask], make(2, scenario="sine").reset(seed=3)[0])


def test_next_step_reset_ignores_the_action_and_gives_no_reward():
    batch = make(2, scenario=SHORT)
    batch.reset(seed=0)
    for action in actions(2, 12):
        result = batch.step(action)
    assert result[3].all()
    observation, reward, terminated, truncated, info = batch.step(np.full((2, 2), 0.7))
    assert (observation[:, 7:9] == 0).all()
    assert (reward == 0).all() and not terminated.any() and not truncated.any()
    assert info["_mismatch"].all() and not info["_reward_tracking"].any()


def test_divergence_resets_one_row():
    batch = make(3, scenario="sine")
    batch.reset(seed=0)
    batch.plant.memory[0, batch.plant.row_of("diverged"), 1] = 1.0
    _, _, terminated, _, info = batch.step(np.zeros((3, 2)))
    assert terminated.tolist() == [False, True, False]
    assert info["termination"][1].startswith("diverged") and info["termination"][0] is None
    _, _, terminated, _, _ = batch.step(np.zeros((3, 2)))
    assert not terminated.any()


def test_results_share_no_memory_and_stay():
    batch = make(3, scenario=SHORT, history=2)
    kept = [batch.reset(seed=0)]
    kept += [batch.step(action) for action in actions(3, 15)]
    copies = copy.deepcopy(kept)
    for action in actions(3, 5):
        batch.step(action)
    for result, then in zip(kept, copies, strict=True):
        same(result[:4][0], then[:4][0])
        same(result[-1]["speed_rpm"], then[-1]["speed_rpm"])
    for i, one in enumerate(kept):
        assert not any(np.shares_memory(one[0], two[0]) for two in kept[:i])


@pytest.mark.parametrize("duplicate", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
def test_copies_go_on_alike(duplicate):
    batch = make(9, scenario=SHORT, mismatch="faulted")
    batch.reset(seed=5)
    for action in actions(9, 5):
        batch.step(action)
    twin = duplicate(batch)
    for action in actions(9, 20, seed=1):
        same(batch.step(action), twin.step(action))


def test_options():
    batch = make(3, mismatch="test_interp")
    _, info = batch.reset(seed=0, options={"case": 10, "scenario": "sine"})
    assert info["case"].tolist() == [10, 11, 12]
    _, info = batch.reset(options={"case": [5, 1, 5]})
    assert info["case"].tolist() == [5, 1, 5]
    np.testing.assert_array_equal(info["mismatch"]["Kq"][0], info["mismatch"]["Kq"][2])
    _, info = batch.reset(
        options={"mismatch": {"sensor_lag.time_constant": 0.02, "spool_stiction.static": 0.1}}
    )
    assert (batch.plant.get("sensor_lag.time_constant") == 0.02).all()
    np.testing.assert_array_equal(batch.pairs["Kq"], np.tile(batch.model.pair("Kq"), (3, 1)))
    for options in ({"case": [1, 2]}, {"case": "x"}, {"seed": 1}, {"reset_mask": np.ones(2, bool)}):
        with pytest.raises(InputError, match="reset"):
            batch.reset(options=options)
    with pytest.raises(InputError, match="seeds"):
        batch.reset(seed=[1, 2])
    with pytest.raises(InputError, match="a seed is -2, expected a whole number from 0"):
        batch.reset(seed=[1, -2, 3])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_options_hold_until_the_next_reset(mode):
    batch = make(3, mismatch="val", scenario=SHORT, autoreset_mode=mode)
    batch.reset(seed=0, options={"mismatch": "test_interp", "case": 7})
    mask = np.array([False, True, False])
    batch.reset(options={"scenario": {"duration": 0.12, "setpoint_rpm": [[0.0, 99.0]]}, "reset_mask": mask})
    for action in actions(3, 14):
        batch.step(action)
    own = own_course(batch, 1), own_course(batch, 0)
    assert (own[0] == 99.0).all() and own[1][0] == 300.0
    assert batch._randomisation.case[[0, 2]].tolist() == [7, 9] and batch._randomisation.episode.tolist() == [
        1,
        2,
        1,
    ]
    batch.reset()
    assert own_course(batch, 1)[0] == 300.0


def own_course(batch, row):
    return np.round(batch.reference(row).setpoint * 30.0 / np.pi, 9)


def test_rows_may_be_reset_one_after_the_other():
    batch, twin = make(2), make(2)
    whole, _ = twin.reset(seed=3)
    for row in (0, 1):
        with pytest.raises(gymnasium.error.ResetNeeded, match="every row"):
            batch.step(np.zeros((2, 2)))
        observation, _ = batch.reset(seed=3, options={"reset_mask": np.arange(2) == row})
    np.testing.assert_array_equal(observation, whole)
    same(batch.step(np.zeros((2, 2))), twin.step(np.zeros((2, 2))))


def test_a_failed_first_reset_is_none():
    batch = make(2)
    with pytest.raises(InputError):
        batch.reset(options={"case": 3})
    with pytest.raises(gymnasium.error.ResetNeeded):
        batch.step(np.zeros((2, 2)))


def test_episode_limit():
    batch = make(2, max_episode_steps=7)
    batch.reset(seed=0)
    assert [batch.step(action)[3].all() for action in actions(2, 8)] == [False] * 6 + [True, False]


def test_gymnasium_wrappers_work():
    # Each by itself: before Gymnasium 1.2.2 they do not go together.
    wrapped = gymnasium.wrappers.vector.DictInfoToList(make(3, scenario=SHORT))
    _, infos = wrapped.reset(seed=0)
    assert set(infos[1]["mismatch"]) >= {"Kq", "R"}
    *_, infos = wrapped.step(np.zeros((3, 2)))
    assert infos[0]["speed_rpm"].shape == (2,)
    wrapped = gymnasium.wrappers.vector.RecordEpisodeStatistics(make(3, scenario=SHORT))
    wrapped.reset(seed=0)
    for action in actions(3, 12):
        *_, info = wrapped.step(action)
    assert info["episode"]["l"].tolist() == [12] * 3
    for space, sample in ((wrapped.observation_space, wrapped.step(wrapped.action_space.sample())[0]),):
        assert space.contains(sample)


def test_spaces_and_metadata():
    batch = make(4, history=2)
    assert batch.observation_space.shape == (4, 18)
    assert batch.single_observation_space == HydraulicSyncEnv("paper", history=2).observation_space
    assert batch.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert batch.spec.kwargs["num_envs"] == 4
    # an instance's settings are its own
    assert make(1, autoreset_mode="SameStep").metadata != make(1).metadata
    assert "autoreset_mode" not in HydraulicSyncVectorEnv.metadata


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_angles_in_single_precision_are_the_integrals_of_the_speeds(mode):
    """Also behind the end of an episode. Summed up in seven digits they were degrees off after some seconds; what is left is what
    seven digits make of the speeds."""
    far = {"duration": 4.0, "setpoint_rpm": [[0.0, 600.0]]}
    envs = [
        make(3, scenario=far, mismatch="val", dtype=d, autoreset_mode=mode, tolerance_rpm=0.01)
        for d in ("float64", "float32")
    ]
    for env in envs:
        env.reset(seed=5)
    for k in range(460):
        wanted, found = (env.step(np.full((3, 2), 0.6, np.float32))[-1] for env in envs)
        if k in (300, 399, 400, 459):
            np.testing.assert_allclose(found["speed_rpm"], wanted["speed_rpm"], atol=0.1)
            np.testing.assert_allclose(
                found["angle_difference_deg"], wanted["angle_difference_deg"], rtol=5e-5, atol=0.01
            )
    assert np.abs(wanted["angle_difference_deg"]).min() > 1.0


def test_an_effect_goes_by_angles_in_single_precision_too():
    ripple = {"displacement_ripple.amplitude": (0.05, 0.0), "displacement_ripple.order": (3.5, 3.5)}
    model = PlantModel(values=ripple)
    speeds = []
    for dtype in ("float64", "float32"):
        env = HydraulicSyncVectorEnv(1, plant=model, mismatch=None, dtype=dtype)
        env.reset(seed=0)
        for _ in range(200):
            *_, info = env.step(np.full((1, 2), 0.6, np.float32))
        speeds.append(info["speed_rpm"])
    np.testing.assert_allclose(speeds[1], speeds[0], atol=0.1)
    assert abs(speeds[0][0, 0] - speeds[0][0, 1]) > 1.0


def test_render():
    frames = make(2, render_mode="rgb_array").render()
    assert len(frames) == 2 and frames[0].shape == (480, 640, 3)


def test_wrong_use_is_named():
    batch = make(2)
    with pytest.raises(gymnasium.error.ResetNeeded):
        batch.step(np.zeros((2, 2)))
    batch.reset(seed=0)
    with pytest.raises(ValueError, match="shape"):
        batch.step(np.zeros((3, 2)))
    with pytest.raises(ValueError, match="finite"):
        batch.step(np.array([[0, 0], [np.nan, 0]]))
    with pytest.raises(ValueError, match="actions are complex128"):
        batch.step(np.zeros((2, 2), complex))
    with pytest.raises(InputError, match="num_envs"):
        HydraulicSyncVectorEnv(0)


def test_a_batch_that_cannot_fit_is_refused_in_a_line(monkeypatch):
    from hydro_env.envs import batch

    monkeypatch.setattr(batch, "machine_memory", lambda: 1e5)
    envs = HydraulicSyncVectorEnv(100)
    with pytest.raises(InputError, match=r"num_envs is 100: episodes of \d+ steps need .* GiB"):
        envs.reset(seed=0)
    with pytest.raises(InputError, match=r"10{12} rigs need .* GiB for their plant alone"):
        HydraulicSyncVectorEnv(10**12)


def test_the_tolerance_is_that_of_the_model_unless_one_is_given():
    """In rpm, for the model, the single environment and the batch; a plant brings its own."""
    fine = replace(load_model("paper"), tolerance=0.02 * RPM)
    plant = Plant("paper", tolerance=0.02 * RPM)
    for env in (make(2, plant=fine), make(2, plant=plant), make(2, tolerance_rpm=0.02)):
        assert env.plant.tolerance == 0.02 * RPM
    assert make(2, plant=plant, tolerance_rpm=1.0).plant.tolerance == 1.0 * RPM
    assert make(2).plant.tolerance == 0.1 * RPM == HydraulicSyncEnv().plant.tolerance
    batch, single = make(3, tolerance_rpm=2.0), HydraulicSyncEnv("paper", tolerance_rpm=2.0)
    usual = make(3)
    for env in (batch, usual):
        env.reset(seed=4)
    single.reset(seed=6)
    for each in actions(3, 20):
        observation, *_ = batch.step(each)
        same(single.step(each[2])[0], observation[2])
        assert (usual.step(each)[0] != observation).any()
    with pytest.raises(InputError, match="tolerance_rpm is 0, expected a number from 1e-06 to 1000 rpm"):
        make(2, tolerance_rpm=0)


@pytest.mark.parametrize("delay", [0.004, 0.014])
def test_what_went_before_a_reset_changes_no_bit(delay):
    """Also where commands are on their way, and however long the batch has run."""
    plant = PlantModel(values={"command_delay.delay": (delay, 0.5 * delay)})
    batch, single = make(2, plant=plant, autoreset_mode="Disabled"), HydraulicSyncEnv(plant)
    batch.reset(seed=[1, 5])
    for each in actions(2, 7):
        batch.step(each)
    batch.reset(seed=[None, 5], options={"reset_mask": np.array([False, True])})
    single.reset(seed=5)
    for each in actions(2, 20, seed=1):
        same(single.step(each[1])[0], batch.step(each)[0][1])


@pytest.mark.parametrize(
    "plant", ["paper_dead_zone", PlantModel(values={"command_delay.delay": (0.004, 0.004)})]
)
def test_threads_change_no_bit(plant):
    def course(threads):
        envs = HydraulicSyncVectorEnv(75, plant=plant, threads=threads, history=2, max_episode_steps=20)
        seen = [envs.reset(seed=3)[0]]
        stream = np.random.default_rng(0)
        for _ in range(45):
            observation, reward, *_ = envs.step(stream.uniform(-1.0, 1.0, (75, 2)))
            seen += [observation, reward]
        assert copy.deepcopy(envs).threads == threads
        return seen

    for one, many in zip(course(1), course(3), strict=True):
        np.testing.assert_array_equal(one, many)


FORKED = """
import os, numpy as np
from hydro_env.envs import HydraulicSyncVectorEnv
envs = HydraulicSyncVectorEnv(75, threads=3)
envs.reset(seed=3)
command = np.full((75, 2), 0.5)
envs.step(command)
reader, writer = os.pipe()
if os.fork() == 0:
    os.write(writer, envs.step(command)[0].tobytes())
    os._exit(0)
os.close(writer)
assert open(reader, "rb").read() == envs.step(command)[0].tobytes()
os.wait()
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_process_steps_with_threads_of_its_own():
    subprocess.run([sys.executable, "-c", FORKED], check=True, timeout=100)


@pytest.mark.parametrize("dtype", ["float64", "float32"])
@pytest.mark.parametrize("plant", ["paper_dead_zone", "rig", "delayed"])
@pytest.mark.parametrize("period", [0.0042, 0.02])
def test_the_peak_within_a_period_is_that_of_shorter_ones(plant, period, dtype):
    """A run that stops at every point of the grid has other steps, and the same peak."""
    model = load_model("paper_dead_zone" if plant == "delayed" else plant)
    if plant == "delayed":
        model = model.with_values({"command_delay.delay": (0.0035, 0.0125)})
    env = make(9, plant=model, control_period=period, dtype=dtype, scenario="setpoint_steps")  # without load
    env.reset(seed=2)
    beyond = 0.0
    for action in actions(9, 12):
        fine = env.plant.copy()
        info = env.step(action)[4]
        peak, points = np.zeros(9), int(np.ceil(period / 1e-3))
        for _ in range(points):
            fine.step(info["command_V"], np.zeros(2), period / points)
            peak = np.maximum(peak, np.abs(np.diff(fine.speed)[:, 0]) / RPM)
        np.testing.assert_allclose(info["peak_difference_rpm"], peak, atol=0.05)
        assert (info["peak_difference_rpm"] >= np.abs(info["speed_difference_rpm"])).all()
        beyond = max(beyond, (info["peak_difference_rpm"] - np.abs(info["speed_difference_rpm"])).max())
    assert beyond > 10.0  # what the end of a period does not show

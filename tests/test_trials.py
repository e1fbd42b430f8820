"""The experiments on memory, critic, teacher and curriculum: their parts do what they say, and every kind of row runs."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch

from agents import ablations as trials
from agents.ablations import TRIALS, Net, clone, config_of, narrowed, reinforce, view_of
from hydro_env.tasks.mismatch import load_mismatch


@pytest.fixture
def config():
    """configs/ppo.yml for some seconds."""
    usual = config_of(TRIALS["shipped"])
    hyper = {**usual.hyper, "n_steps": 8, "batch_size": 128, "n_epochs": 1}
    training = replace(usual.training, evaluate_pairs=2, evaluate_scenarios=("load_step",))
    kwargs = {**usual.env_kwargs, "max_episode_steps": 20}
    return replace(usual, num_envs=16, hyper=hyper, training=training, env_kwargs=kwargs)


def test_a_recurrent_row_that_begins_anew_forgets():
    torch.manual_seed(0)
    net = Net(3, 2, recurrent=True, last=1.0)
    inputs, fresh = torch.randn(9, 2, 3), torch.zeros(9, 2, dtype=torch.bool)
    fresh[4, 1] = True
    state = torch.randn(1, 2, trials.WIDTH)
    whole, _ = net(inputs, state, fresh)
    undisturbed, _ = net(inputs, state)
    anew, _ = net(inputs[4:, 1:], torch.zeros(1, 1, trials.WIDTH))
    torch.testing.assert_close(whole[:, 0], undisturbed[:, 0])
    torch.testing.assert_close(whole[:4, 1], undisturbed[:4, 1])
    torch.testing.assert_close(whole[4:, 1], anew[:, 0])


def test_a_curriculum_ends_at_the_whole_mismatch():
    full = load_mismatch("train")
    for name, each in narrowed(full, 1.0).ranges.items():
        np.testing.assert_allclose((each.low, each.high), (full.ranges[name].low, full.ranges[name].high))
    alike = narrowed(full, 0.0).ranges
    assert alike["dead_zone.overlap_positive"].high == (0.0, 0.0)
    assert all(np.allclose(each.low, each.high) for each in alike.values())


def test_outputs_of_zero_added_to_the_law_leave_it():
    """The view whose outputs are added sends what the shipped view sends without a network."""
    stream = np.random.default_rng(0)
    added, law = view_of(TRIALS["added"]), view_of(TRIALS["shipped"])
    observations = stream.normal(0.0, 0.3, (6, 2, 9)).astype(np.float32)
    seen = added.start(observations[0], 0.01), law.start(observations[0], 0.01)
    for observation in observations[1:]:
        np.testing.assert_array_equal(*seen)
        np.testing.assert_array_equal(added.command(np.zeros((4, 3))), law.command(np.zeros((4, 3))))
        seen = added.see(observation), law.see(observation)


@pytest.mark.parametrize(
    "name",
    [
        "recurrent_told_critic",
        "plain_curriculum",
        "law_to_added",
        pytest.param("oracle_to_plain", marks=pytest.mark.slow),
    ],
)
def test_rows_train(config, name):
    trial = TRIALS[name]
    train = clone if trial.teacher else reinforce
    best = train(trial, config, seed=0, steps=320)
    assert best.policy is not None and np.isfinite(best.score)
    first = Net(best.view.num_features, best.view.num_actions, trial.recurrent, 0.01)
    assert [w.shape for w in first.parameters()] == [w.shape for w in best.policy.parameters()]

"""The recurrent policy: what its two stages learn from, and a run that is stopped and goes on."""

import copy
import json
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("stable_baselines3")

import torch

from agents.recurrent.__main__ import train
from agents.recurrent.imitation import NOTES, ImitationStage, Teacher
from agents.recurrent.network import RecurrentPolicy
from agents.recurrent.rigs import KNOWN, Rigs
from agents.recurrent.settings import Gradient, Settings, read_settings
from agents.recurrent.simulator_gradient import GradientStage, Period, Slopes
from agents.speed import measure, summary
from hydro_env.controllers.learned.policy import NumpyPolicy
from hydro_env.controllers.mpc.flow_control import ProbingFlow
from hydro_env.errors import InputError

ROOT = Path(__file__).parents[2]
SHORT = """
env: {plant: paper_dead_zone, mismatch: train}
network: {inputs: 16, recurrent: 12, outputs: 8}
imitation: {periods: 0.0064, rigs: 16, window: 100, batch: 8, epochs: 1}
gradient: {periods: 0.0064, rigs: 16, window: 20}
training: {evaluate: 0.0032, pairs: 4}
"""


def settings_of(tmp_path, text=SHORT):
    path = tmp_path / "short.yml"
    path.write_text(text)
    return read_settings(path)


def policy_of(**sizes):
    torch.manual_seed(0)
    return RecurrentPolicy((16, 12, 8), KNOWN + NOTES)


@pytest.mark.parametrize("name", ["gru", "gru_any", "gru_rig"])
def test_the_shipped_recipe_is_valid_and_small(name):
    settings = read_settings(ROOT / "configs" / f"{name}.yml")
    sizes = settings.network
    policy = RecurrentPolicy((sizes.inputs, sizes.recurrent, sizes.outputs), KNOWN + NOTES)
    assert sum(array.size for array in policy.arrays().values()) <= 50_000
    assert settings.env["mismatch"] == "train"
    assert {env["mismatch"] for env, _ in settings.driven} <= {"train", "train_robust", "train_any"}


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("imitation:", "imitaton:", "unknown key 'imitaton': did you mean 'imitation'"),
        ("periods: 0.0064, rigs: 16, window: 100", "period: 1", "imitation: 'period' is unknown"),
        ("window: 20", "window: 7", "an episode of 600 periods should be a multiple"),
        ("rigs: 16, window: 20", "rigs: 0, window: 20", "gradient: rigs should be at least 1"),
        ("plant:", "plan:", "env: unknown key 'plan'"),
        ("recurrent: 12", "recurrent: many", "recurrent 'many' should be a number"),
        ("training:", "groups: [{window: 10}]\ntraining:", "group 1: window is the same for all groups"),
        ("training:", "groups: [{}, {env: {plan: rig}}]\ntraining:", "group 2: env: unknown key 'plan'"),
        ("training:", "groups: [{bond: 3}]\ntraining:", "group 1: 'bond' is unknown: did you mean 'bound'"),
    ],
)
def test_a_wrong_training_file_is_named_in_one_line(tmp_path, old, new, says):
    assert old in SHORT
    with pytest.raises(InputError) as caught:
        settings = settings_of(tmp_path, SHORT.replace(old, new))
        GradientStage(settings, policy_of(), 0)
    assert says in str(caught.value) and "\n" not in str(caught.value)


def test_a_teacher_that_is_followed_is_the_law():
    """What it says of rigs that it drives itself is what the law alone sends. It reads in single precision what was sent, and
    a saturated plan can turn that into another one: not on more than one rig in five."""
    rigs = Rigs(Settings(), 16, 100, seed=3)
    teacher, law = Teacher(rigs.observation, 0.01), ProbingFlow()
    law.settings = teacher._law.settings
    law.reset(16, 0.01)
    for _ in range(80):
        commands = teacher.command()
        apart = np.abs(commands - law.act(rigs.observation)).max(axis=1)
        assert np.quantile(apart, 0.8) < 1e-5
        rigs.step(commands)
        teacher.see(rigs.observation, np.ones(16, bool))


def test_windows_hold_whole_episodes():
    rigs = Rigs(Settings(), 32, 100, seed=0)
    begun = np.zeros(32, int)
    for _ in range(6):
        for _ in range(100):
            rigs.step(np.zeros((32, 2)))
        new = rigs.next_window()
        begun[new] += 1
        np.testing.assert_array_equal(rigs.before[new], rigs.observation[new])
        assert (rigs.observation[new, -2:] == 0.0).all()
    assert (begun == 1).all()


HEATED = {"base": "train", "coil_heating.rise": 0.25}
LATE = {"base": "train", "command_delay.delay": {"uniform": [0.0, 0.02]}, "sensor_lag.time_constant": 0.005}
ALWAYS = {"spool", "spool_speed", "speed"}
OF_RIG = ALWAYS | {"current", "pressure", "magnetic_hysteresis__loop", "sensor_lag__lagged_speed"}


@pytest.mark.parametrize(
    ("plant", "mismatch", "states", "commands"),
    [
        ("paper_dead_zone", HEATED, ALWAYS, 1),
        ("paper_dead_zone", LATE, ALWAYS | {"sensor_lag__lagged_speed"}, 3),
        ("rig", "train", OF_RIG, 1),
    ],
)
def test_shifted_are_the_states_that_last_and_the_commands_on_their_way(plant, mismatch, states, commands):
    """Coil and pressure of the paper's plant settle within a millisecond, and coils warm up within minutes; the coil of `rig`
    takes 6 ms, its hoses 24."""
    rigs = Rigs(Settings(env={"plant": plant, "mismatch": mismatch}), 64, 30, seed=1)
    slopes = Slopes(rigs, np.random.default_rng(0))
    assert set(slopes.states) == states and slopes.commands == commands


DRY = "magnetic_hysteresis.amplitude", "motor_coulomb_friction.coulomb", "motor_coulomb_friction.static"


@pytest.mark.parametrize(
    ("name", "dry", "window", "by"), [("paper_dead_zone", (), 6, 0.02), ("rig", DRY, 3, 0.005)]
)
def test_the_gradient_is_that_of_the_simulated_cost(name, dry, window, by):
    """Unbounded, it predicts what a change of the last layer's bias costs: against simulations of the same rigs with it. The
    spools hardly stick here; where they do, forward differences depend on their size."""
    whole = replace(
        Gradient(), rigs=64, window=window, keep_state=1.0, keep_memory=1.0,
        max_state=1e9, max_memory=1e9, max_reading=1e9, max_command=1e9,
    )  # fmt: skip
    policy = policy_of()
    env = {"plant": name, "mismatch": "train"}
    (stage,) = GradientStage(Settings(gradient=whole, env=env), policy, 0).groups
    plant = stage.rigs.env.plant
    for each in ("Fc", "Fs", *dry):
        plant.set(each, 0.02 * plant.get(each))
    for t in range(60):  # valves open to one side: no dead zone on the way
        stage.rigs.step(np.full((64, 2), min(0.4, 0.02 * t)))
    begun, state = copy.deepcopy(stage.rigs.env), torch.zeros(64, policy.units)

    def cost():
        stage.rigs.env, stage._state = copy.deepcopy(begun), state
        stage.rigs.observation = stage.rigs.before = begun._frames.copy()
        return (stage._drive()[0] * torch.tensor([1.0, whole.tracking, 1.0])).mean(0).sum()

    with torch.no_grad():
        policy.act.bias.fill_(0.4)
    stage._slopes.match()
    cost().backward()
    slopes = []
    for channel in (0, 1):
        found = []
        for change in (by, -by):
            with torch.no_grad():
                policy.act.bias[channel] += change
                found.append(cost().item())
                policy.act.bias[channel] -= change
        slopes.append((found[0] - found[1]) / (2.0 * by))
    np.testing.assert_allclose(policy.act.bias.grad, slopes, atol=0.15 * np.abs(slopes).max())


MANY = {
    **LATE, "supply_droop.relative_drop": 0.5, "magnetic_hysteresis.amplitude": 0.1, "coil_heating.rise": 0.25,
    "coil_heating.time_constant": 2.0, "entrained_air.fraction": 0.02, "crossport_relief.relief_pressure": 3e6,
    "crossport_relief.time_constant": 0.01,
}  # fmt: skip


@pytest.mark.parametrize("plant", ["paper_dead_zone", "rig"])
def test_what_a_delayed_command_does_within_a_window(plant):
    """The slopes, one after the other, say what the first of six commands does to the speeds shown at the end, on plants with a
    delay line and memory of many kinds: as central differences of whole windows do."""
    rigs = Rigs(Settings(env={"plant": plant, "mismatch": MANY}), 64, 30, seed=1)
    for name in ("Fc", "Fs"):
        rigs.plant.set(name, 0.02 * rigs.plant.get(name))
    slopes = Slopes(rigs, np.random.default_rng(0))
    for t in range(60):  # valves open to one side, and open further: no dead zone and no reversal
        rigs.step(np.full((64, 2), min(0.4, 0.02 * t)))
    begun, opening = copy.deepcopy(rigs.env), 0.4 + 0.06 * np.arange(1, 7)

    def shown(by):
        rigs.env = copy.deepcopy(begun)
        for t, command in enumerate(opening):
            rigs.step(np.full((64, 2), command + by * (t == 0)))
        return slopes.columns()[..., slopes.readings[0]]

    expected = (shown(0.02) - shown(-0.02)) / 0.04
    rigs.env = copy.deepcopy(begun)
    commands = torch.tensor(opening, dtype=torch.float32)[:, None, None].repeat(1, 64, 2).requires_grad_()
    state, sent = slopes.columns(), [torch.full((64, 2), 0.4)] * slopes.commands
    for t in range(6):
        slopes.before()
        rigs.step(commands[t].detach().numpy())
        sent = [commands[t], *sent[:-1]]
        state = Period.apply(state, torch.stack(sent), *slopes.after())
    state[..., slopes.readings[0]].sum().backward()
    apart = (commands.grad[0] - expected).square().mean().sqrt()
    assert apart < 0.15 * expected.square().mean().sqrt()


@pytest.mark.parametrize(("bound", "grows"), [(1.0, True), (1000.0, False)])
def test_the_weight_of_tracking_follows_its_bound(tmp_path, bound, grows):
    settings = settings_of(tmp_path, SHORT.replace("window: 20}", f"window: 20, bound: {bound}}}"))
    stage = GradientStage(settings, policy_of(), 0)
    weights = [stage.window()["weight"] for _ in range(4)]
    assert weights[0] == pytest.approx(settings.gradient.tracking)
    assert weights == sorted(weights, reverse=not grows) and weights[0] != weights[-1]


def test_groups_learn_as_one(tmp_path):
    """The gradient of two groups is the mean of their own, by their numbers of rigs; each has a weight of tracking."""
    groups = (
        "groups: [{rigs: 8, bound: 1.0}, {rigs: 16, bound: 1000.0, env: {mismatch: train_robust}}]\ntraining:"
    )
    stage = GradientStage(settings_of(tmp_path, SHORT.replace("training:", groups)), policy_of(), 0)
    assert [group.rigs.env.mismatch.name for group in stage.groups] == ["train", "train_robust"]
    said = [stage.window() for _ in range(3)]
    assert stage.done == 3 * 20 * 24
    assert said[0]["weight"] < said[2]["weight"] and said[0]["weight2"] > said[2]["weight2"]


def test_a_rig_that_nobody_can_steer_does_not_drown_the_others(tmp_path):
    """Twice the cost of a rig far beyond the bound is worth no more than a little of the others'."""
    stage = GradientStage(settings_of(tmp_path), policy_of(), 0).groups[0]
    found = {}
    for size in (1.0, 100.0):
        scale = torch.zeros(16, requires_grad=True)
        costs = size * scale.exp()[:, None].repeat(1, 3)
        stage._drive = lambda costs=costs: (costs, torch.zeros(()))
        stage._usual[:] = 2.0 * size
        stage.learn(0.01)
        found[size] = scale.grad.mean().item()
    assert 1.0 < found[100.0] / found[1.0] < 2.0


def test_a_group_whose_every_rig_has_a_fault_keeps_its_weight(tmp_path):
    faults = "groups: [{env: {mismatch: {base: faulted, parameters: {}, healthy: 0.0}}}]\ntraining:"
    stage = GradientStage(settings_of(tmp_path, SHORT.replace("training:", faults)), policy_of(), 0)
    assert all(np.isfinite(value) for _ in range(2) for value in stage.window().values())


@pytest.mark.parametrize("law", [True, False])
def test_imitation_lowers_the_error_of_the_commands(tmp_path, law):
    settings = settings_of(tmp_path)
    quick = replace(settings.imitation, law=law, periods=1.0, batch=4, epochs=8, rate=0.02)
    stage = ImitationStage(replace(settings, imitation=quick), policy_of(), 0)
    errors = [stage.window()["command_error"] for _ in range(12)]
    assert np.mean(errors[-2:]) < 0.5 * np.mean(errors[:2])


def test_a_run_scores_saves_and_goes_on(tmp_path):
    settings = settings_of(tmp_path)
    out = tmp_path / "run"
    whole = train(settings, out, bar=False)
    assert [row["stage"] for row in whole.progress["curve"]] == ["imitation"] * 2 + ["gradient"] * 2
    assert whole.periods == 12_800
    policy = NumpyPolicy(out / "policy.npz")
    assert policy.metadata["steps"] in [row["steps"] for row in whole.progress["curve"]]
    with pytest.raises(InputError, match="--resume"):
        train(settings, out, bar=False)
    assert train(settings, out, resume=True, bar=False).periods == 12_800
    (kept,) = whole.optimiser["param_groups"][0]["integral"]
    assert kept > np.log(Gradient().tracking)
    longer = settings_of(tmp_path, SHORT.replace("gradient: {periods: 0.0064", "gradient: {periods: 0.0096"))
    after = train(longer, out, resume=True, bar=False)
    assert (
        after.optimiser["param_groups"][0]["integral"][0] > kept
    )  # goes on: half the periods alone bring less
    assert after.periods == 16_000 and len(after.progress["curve"]) == 5
    assert json.loads((out / "curve.json").read_text()) == after.progress["curve"]
    (out / "checkpoint.pt").write_bytes((out / "checkpoint.pt").read_bytes()[:1000])
    with pytest.raises(
        InputError, match=r"checkpoint.pt: cannot be resumed .* delete it to start over"
    ) as caught:
        train(settings, out, resume=True, bar=False)
    assert "\n" not in str(caught.value)


def test_training_goes_on_from_a_policy(tmp_path):
    """What is scored first is that policy; one of another network is refused in one line."""
    settings = settings_of(tmp_path)
    first = train(settings, tmp_path / "first", bar=False)
    policy = tmp_path / "first" / "policy.npz"
    run = train(
        replace(settings, gradient=replace(settings.gradient, periods=0.0032)),
        tmp_path / "on",
        start=policy,
        bar=False,
    )
    key = "max_speed_difference_rpm"
    assert run.progress["curve"][0][key] == min(first.progress["curve"], key=lambda row: row["score"])[key]
    assert [row["stage"] for row in run.progress["curve"]] == ["gradient"] * 2 and run.periods == 3200
    with pytest.raises(InputError, match="is not the one of the training file") as refused:
        train(settings, tmp_path / "other", start=ROOT / "hydro_env/controllers/policies/ppo.npz", bar=False)
    assert "\n" not in str(refused.value) and not (tmp_path / "other" / "policy.npz").exists()


def test_killed_and_resumed(tmp_path):
    (tmp_path / "long.yml").write_text(SHORT.replace("periods: 0.0064", "periods: 1.0"))
    run = tmp_path / "run"
    command = [
        sys.executable,
        "-m",
        "agents.recurrent",
        "--config",
        str(tmp_path / "long.yml"),
        "--out",
        str(run),
    ]
    process = subprocess.Popen([*command, "--quiet"], cwd=ROOT, stderr=subprocess.PIPE)
    try:
        for _ in range(6000):  # on a busy machine the start alone takes a minute
            if (run / "curve.json").is_file() and (run / "checkpoint.pt").is_file():
                break
            assert process.poll() is None, process.stderr.read().decode()
            time.sleep(0.1)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    before = json.loads((run / "curve.json").read_text())
    after = train(settings_of(tmp_path, SHORT), run, resume=True, bar=False)
    assert after.progress["stage"] == "gradient"
    assert after.progress["curve"][: len(before)] == before


def test_the_rate_of_a_recipe_weighs_its_stages_by_their_periods(tmp_path):
    settings = settings_of(tmp_path)
    assert set(measure(settings, 0.0, seed=0)) == {"imitation", "gradient"}
    found = [{"imitation": (100.0, 200.0), "gradient": (300.0, 600.0)}] * 2
    last = summary(settings, found).splitlines()[-1].split()
    assert last == ["whole", "recipe", "300", "600"]  # as many periods in each: the harmonic mean

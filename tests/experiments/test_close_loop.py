"""Closing the loop: the drive on the reference simulator, the controller made from a model, tuning, scores and table."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_env import cli
from hydro_env.controllers import make_controller
from hydro_env.controllers.classical.model_inverse import ModelInverse, flow_curve
from hydro_env.controllers.rollout import roll_out
from hydro_env.errors import InputError
from hydro_env.experiments import close_loop, close_loop_drives
from hydro_env.experiments.close_loop import METRICS, SCENARIOS, SOURCES, RigTask, Score, Settings
from hydro_env.experiments.close_loop_drives import LAWS, Tuning, drive
from hydro_env.plant import PlantModel, load_model
from hydro_env.tasks import load_scenario

GAINS = {"rate": 30.0, "Kp": 10.0, "Ti": 0.15, "Ks": 25.0, "blend": 0.01}
SHORT = load_scenario({"name": "short", "duration": 1.2, "setpoint_rpm": [[0.1, 500.0], [0.7, -150.0]]})
DEAD_ZONE = {"dead_zone.overlap_positive": (9e-5, 0.0), "dead_zone.overlap_negative": (11e-5, 0.0)}


def run_loop(out: Path, **given: Any) -> dict[str, Any]:
    """`close_loop.run` with its settings by name."""
    own = {name: given.pop(name) for name in ("cases", "seeds", "seed", "generations") if name in given}
    return close_loop.run(
        out, Settings(**{**own, "cases": tuple(own.get("cases", close_loop.CASES))}), **given
    )


@pytest.fixture(scope="module")
def truth() -> PlantModel:
    return load_model("paper").with_values(DEAD_ZONE)


def test_the_drive_agrees_with_the_plant(truth: PlantModel) -> None:
    """Without noise and with the same forms of the effects, both simulators give the same closed loop."""
    found = drive(make_controller("cross_coupled"), truth, SHORT, 0, forms="same", noise=0.0)
    from hydro_env.envs.batch import HydraulicSyncVectorEnv

    env = HydraulicSyncVectorEnv(1, truth, SHORT, None, noise=0.0)
    observation, info = env.reset(seed=0)
    controller = make_controller("cross_coupled")
    controller.reset(1, env.control_period)
    speeds = [info["speed_rpm"][0].copy()]
    for _ in range(len(found.speed_rpm) - 1):
        observation, _, _, _, info = env.step(controller.act(observation).astype(np.float32))
        speeds.append(info["speed_rpm"][0].copy())
    assert np.abs(found.speed_rpm[:, 0] - np.array(speeds)).max() < 0.5
    assert found.command.shape == (120, 1, 2)


def test_the_drive_has_noise_of_its_seed(truth: PlantModel) -> None:
    runs = [drive(make_controller("pid_tuned"), truth, SHORT, seed).speed_rpm for seed in (1, 1, 2)]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_flow_curve_has_the_dead_zone(truth: PlantModel) -> None:
    command, flow = flow_curve(truth)
    travel = truth.value("alpha", 0) * truth.value("u_rated", 0) / (truth.value("R", 0) * truth.value("k", 0))
    positive, negative = 9e-5 / travel, -11e-5 / travel
    assert (np.diff(flow, axis=0) >= 0.0).all()
    still = (command > negative + 0.01) & (command < positive - 0.01)
    assert np.abs(flow[still, 0]).max() < 0.005 * flow.max()
    assert np.interp(positive + 0.03, command, flow[:, 0]) > 0.01 * flow.max()
    assert np.interp(negative - 0.03, command, flow[:, 0]) < -0.01 * flow.max()
    assert flow[-1, 0] == pytest.approx(
        truth.value("Kq", 0) * (travel - 9e-5), rel=0.02
    )  # branches that lag are averaged


def test_the_inverse_of_the_right_model_keeps_the_motors_in_step(truth: PlantModel) -> None:
    """Told the dead zone it keeps together what the model without it drives apart, and the other way round."""

    def peak(model: PlantModel, plant: PlantModel) -> float:
        """Mean over episodes, whose noise moves it between 5 and 17 rpm."""
        controller = ModelInverse(model=model, **GAINS)
        done = roll_out(controller, range(12), plant=plant, mismatch=None, scenario=SHORT)
        return float(done.metrics([METRICS[0]])[METRICS[0]].mean())

    plain = load_model("paper")
    assert peak(truth, truth) < 12.0
    assert peak(plain, plain) < 12.0
    assert peak(plain, truth) > 3.0 * peak(truth, truth)
    assert peak(truth, plain) > 3.0 * peak(plain, plain)


def test_the_inverse_drives_rows_alike(truth: PlantModel) -> None:
    """A row of a batch with gains by row is what that row is alone."""
    kp = np.array([[8.0], [16.0]])
    both = roll_out(
        ModelInverse(model=truth, **{**GAINS, "Kp": kp}), [3, 3], plant=truth, mismatch=None, scenario=SHORT
    )
    for row in (0, 1):
        alone = roll_out(
            ModelInverse(model=truth, **{**GAINS, "Kp": kp[row, 0]}),
            [3],
            plant=truth,
            mismatch=None,
            scenario=SHORT,
        )
        np.testing.assert_array_equal(both.trace.speed_rpm[:, row], alone.trace.speed_rpm[:, 0])


@pytest.mark.parametrize("law", LAWS)
def test_tuning_repeats_and_stays_in_range(
    law: str, truth: PlantModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(close_loop_drives, "POPULATION", 6)
    monkeypatch.setattr(close_loop_drives, "TUNING_EPISODES", 1)
    monkeypatch.setattr(close_loop_drives, "TUNED_ON", SHORT)
    task = Tuning(law, "true", "rig", truth, seed=3, generations=2)
    found = task.run()
    assert found == task.run()
    for gain in LAWS[law].genes():
        values = np.ravel(found["gains"][gain.name])
        assert len(values) == (2 if gain.name in LAWS[law].each else 1)
        assert (gain.low * 0.999 <= values).all() and (values <= gain.high * 1.001).all()
    assert set(LAWS[law].fixed).isdisjoint(found["gains"])
    LAWS[law].build(law, truth, found["gains"])  # they are what the law takes


def rows(changes: dict[str, float]) -> list[dict[str, Any]]:
    """Scores of two cases with two seeds: 10, 20, 30, 40 rpm, times what each model changes."""
    return [
        {"controller": "pid", "tuned_on": source, "rig": f"{case}_{seed}", "case": case, "seed": seed, "scenario": name,
         "metrics": dict.fromkeys(METRICS, 10.0 * (1 + 2 * place + seed) * factor)}
        for source, factor in changes.items() for place, case in enumerate("ab") for seed in (0, 1) for name in SCENARIOS
    ]  # fmt: skip


def test_collect_says_what_the_repair_changed() -> None:
    found = close_loop.collect(rows({"wrong": 1.0, "repaired": 0.25, "true": 0.2}))
    assert len(found) == len(SCENARIOS) * len(METRICS)
    first = found[0]
    assert first["wrong"]["mean"] == 25.0 and first["repaired"]["mean"] == 6.25 and first["n"] == 4
    low, high = first["wrong"]["ci95"]
    assert 10.0 <= low < 25.0 < high <= 40.0
    # the same factor on every rig: no doubt about the change, however different the rigs are
    np.testing.assert_allclose([first["change"]["mean"], *first["change"]["ci95"]], -0.75)
    assert first["better"] == 4


def test_collect_counts_only_rigs_that_all_models_have() -> None:
    scores = [
        s for s in rows({"wrong": 1.0, "repaired": 2.0}) if (s["rig"], s["tuned_on"]) != ("a_0", "repaired")
    ]
    first = close_loop.collect(scores)[0]
    assert first["n"] == 3 and first["wrong"]["mean"] == 30.0
    assert first["better"] == 0 and first["change"]["mean"] == pytest.approx(1.0)


def _written(folder: Path) -> dict[str, Any]:
    """A result of four rigs, written to a folder."""
    scores = rows({"wrong": 1.0, "repaired": 0.25, "true": 0.2})
    shipped = [{**s, "tuned_on": "none"} for s in rows({"wrong": 0.5})]
    for s in (*scores, *shipped):
        s["difference_rpm"] = [0.0, 1.0, 2.0]
    rigs = [{"rig": f"{c}_{n}", "case": c, "seed": n, "right": True,
             "hidden": [{"name": "dead_zone", "channel": "1"}]} for c in "ab" for n in (0, 1)]  # fmt: skip
    data = {"schema": close_loop.SCHEMA, "rigs": rigs, "scores": [*scores, *shipped], "failed": [],
            "summary": close_loop.collect([*scores, *shipped])}  # fmt: skip
    close_loop.write(folder, data)
    return data


def test_picture(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    pytest.importorskip("stable_baselines3")
    from agents import close_loop as agent
    from docs.evidence.close_loop_picture import draw

    _written(tmp_path)
    draw(agent.read(tmp_path), tmp_path / "close_loop.png")
    assert (tmp_path / "close_loop.png").stat().st_size > 10_000


def test_table(tmp_path: Path) -> None:
    data = _written(tmp_path)
    text = (tmp_path / "close_loop.md").read_text()
    assert "-75 %" in text and "as shipped" in text
    assert len({line.count("|") for line in text.splitlines()}) == 1
    assert "4 named correctly" in close_loop.summary(data)
    written, traces = (
        json.loads((tmp_path / f"{name}.json").read_text()) for name in ("close_loop", "traces")
    )
    assert written["summary"] == json.loads(json.dumps(data["summary"]))
    assert "difference_rpm" not in written["scores"][0]
    assert traces[0]["difference_rpm"] == [0.0, 1.0, 2.0]


def test_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="unknown case 'dead'"):
        run_loop(tmp_path, cases=["dead"])
    with pytest.raises(InputError, match="seeds"):
        run_loop(tmp_path, seeds=0)
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, truth: PlantModel) -> list[Any]:
    """The whole chain without the diagnosis, whose place a stub takes, and with short searches. Tells what was done."""
    done: list[Any] = []

    def made(task: RigTask) -> close_loop.Rig:
        if task.seed == 9:
            raise RuntimeError("no such rig")
        models = {"wrong": load_model("paper"), "repaired": truth, "true": truth}
        effects = [{"name": "dead_zone", "channel": "1", "parameters": {}}]
        gap = {"speed_1_rpm": {"noise": 1.0, "before": 90.0, "after": 1.0, "placebo": 50.0}}
        diagnosis = {"verdict": "effects", "gap": {"sealed": gap},
                     "effects": [{"name": "dead_zone", "channel": "1", "indistinguishable_from": []}]}  # fmt: skip
        hidden = {"verdict": "effects", "effects": effects, "forms": "same", "form_constants": {}}
        return close_loop.Rig(task, models, hidden, diagnosis)

    def noted(task: Any) -> Any:
        done.append(task)
        return work(task)

    work = close_loop._work
    monkeypatch.setattr(RigTask, "run", made)
    monkeypatch.setattr(close_loop, "_work", noted)
    monkeypatch.setattr(close_loop_drives, "POPULATION", 5)
    monkeypatch.setattr(close_loop_drives, "TUNING_EPISODES", 1)
    monkeypatch.setattr(close_loop_drives, "TUNED_ON", SHORT)
    monkeypatch.setattr(close_loop, "SCENARIOS", ("short",))
    monkeypatch.setattr(close_loop_drives, "LAWS", {"model_inverse": LAWS["model_inverse"]})
    monkeypatch.setattr(close_loop, "SHIPPED", ())
    monkeypatch.setattr("hydro_env.experiments.close_loop_drives.load_scenario", lambda name: SHORT)
    return done


def test_the_chain_goes_on_where_it_stopped(quick: list[Any], tmp_path: Path) -> None:
    def go() -> dict[str, Any]:
        return run_loop(
            tmp_path, cases=["dead_zone"], seeds=1, cells=tmp_path / "cells", generations=2,
            progress=False,
        )  # fmt: skip

    first = go()
    assert [type(task) for task in quick] == [RigTask, *[Tuning] * 3, *[Score] * 3]
    assert first["rigs"][0]["right"] and first["failed"] == []
    assert {s["tuned_on"] for s in first["scores"]} == set(SOURCES)
    assert first["summary"][0]["repaired"]["mean"] < first["summary"][0]["wrong"]["mean"]
    assert (
        load_model(tmp_path / "rigs" / "dead_zone_0" / "repaired.yaml").values
        == load_model("paper").with_values(DEAD_ZONE).values
    )
    quick.clear()
    assert go() == first
    assert quick == []
    for path in (tmp_path / "cells").iterdir():  # half of it lost
        if path.name < "8":
            path.unlink()
    assert go() == first


def test_the_command_goes_on_after_an_interruption(
    quick: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`hydro-env close-loop` that is stopped leaves no folder; the same command again does only what is left."""

    def command() -> tuple[int, str]:
        quick.clear()
        with pytest.raises(SystemExit) as end:
            cli.main(
                ["close-loop", "--case", "dead_zone", "--seeds", "1",
                 "--cells", str(tmp_path / "cells"), "--out", str(tmp_path / "out")]
            )  # fmt: skip
        return int(end.value.code or 0), capsys.readouterr().err.splitlines()[-1]

    working = close_loop._work

    def stopped(task: Any) -> Any:
        if isinstance(task, Tuning) and task.source == "repaired":
            raise KeyboardInterrupt
        return working(task)

    with monkeypatch.context() as patch:
        patch.setattr(close_loop, "_work", stopped)
        status, last = command()
    assert (status, last) == (130, "error: interrupted; nothing half-written is left in --out")
    assert [type(task) for task in quick] == [RigTask, Tuning]
    assert [path.name for path in tmp_path.iterdir()] == ["cells"]
    assert command()[0] == 0
    assert [type(task) for task in quick] == [Tuning, Tuning, *[Score] * 3]
    written = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert written == ["close_loop.json", "close_loop.md", "rigs", "traces.json"]
    assert command()[0] == 0 and quick == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["--case", "dead_zones"],
            "unknown case 'dead_zones': did you mean 'dead_zone'?",
        ),
        (["--seeds", "0"], "Invalid value for '--seeds'"),
        (["--seed", "99", "--seeds", "2"], "seeds 99 to 100: 0 to 99 are right"),
        (["--engine", "slurm"], "unknown engine 'slurm'"),
        (["--cells", "file"], "file"),
    ],
)
def test_the_command_with_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], said: str
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("x")
    with pytest.raises(SystemExit) as end:
        cli.main(["close-loop", *arguments, "--out", "out"])
    err = capsys.readouterr().err
    assert end.value.code == 2 and err.startswith("error: ") and err.count("\n") == 1 and said in err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


@pytest.mark.parametrize("missing", ["nothing", "traces", "schema", "rigs"])
def test_the_agent_with_a_folder_that_is_no_result(quick: list[Any], tmp_path: Path, missing: str) -> None:
    pytest.importorskip("stable_baselines3")
    from agents import close_loop as agent
    from hydro_env.training.config import read_config

    rigs = tmp_path / "rigs"
    rigs.mkdir()
    if missing != "nothing":
        run_loop(rigs, cases=["dead_zone"], seeds=1, generations=2, progress=False)
    if missing == "traces":
        (rigs / "traces.json").unlink()
    if missing == "schema":
        (rigs / "close_loop.json").write_text('{"schema": "hydro_env/scores/1"}')
    if missing == "rigs":
        (rigs / "rigs" / "dead_zone_0" / "repaired.yaml").unlink()
    with pytest.raises(InputError, match="repaired.yaml" if missing == "rigs" else str(rigs)):
        agent.run(rigs, tmp_path / "out", read_config(agent.CONFIG), progress=False)
    assert not (tmp_path / "out" / "runs").exists()


def test_a_rig_that_fails_is_told(quick: list[Any], tmp_path: Path) -> None:
    found = run_loop(tmp_path, cases=["dead_zone"], seeds=2, seed=8, generations=2, progress=False)
    assert [row["rig"] for row in found["rigs"]] == ["dead_zone_8"]
    (failed,) = found["failed"]
    assert failed["task"] == "dead_zone_9" and failed["reason"].startswith(
        f"RuntimeError: no such rig ({__file__}"
    )
    with pytest.raises(InputError, match="no such rig"):
        run_loop(tmp_path, cases=["dead_zone"], seeds=1, seed=9, progress=False)


def test_the_agent_beside_the_controllers(
    quick: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Trains for a moment on each model, drives the hidden rig, and does nothing twice."""
    pytest.importorskip("stable_baselines3")
    from agents import close_loop as agent
    from hydro_env.training.config import read_config

    (tmp_path / "rigs").mkdir()
    run_loop(tmp_path / "rigs", cases=["dead_zone"], seeds=1, generations=2, progress=False)
    whole = read_config(agent.CONFIG)
    config = replace(
        whole, num_envs=4, num_steps=64, hyper={**whole.hyper, "n_steps": 8, "batch_size": 32, "n_epochs": 1},
        env_kwargs={**whole.env_kwargs, "max_episode_steps": 20},
        training=whole.training.model_copy(update={"evaluate_pairs": 1}),
    )  # fmt: skip

    def go(config: Any) -> dict[str, Any]:
        return agent.run(tmp_path / "rigs", tmp_path / "out", config, progress=False)

    first = go(config)
    trained = {path.parent.name for path in (tmp_path / "out" / "runs").glob("*/policy.npz")}
    assert trained == {"wrong_0", "dead_zone_0_repaired", "dead_zone_0_true"}
    row = next(r for r in first["summary"] if r["controller"] == "ppo")
    assert set(SOURCES) < row.keys() and row["n"] == 1
    assert {r["controller"] for r in first["summary"]} == {"model_inverse", "ppo"}
    about = make_controller(tmp_path / "out" / "runs" / "dead_zone_0_repaired" / "policy.npz").metadata
    assert about["env_kwargs"]["plant"].endswith("repaired.yaml") and about["env_kwargs"]["mismatch"] is None

    def fail(*args: Any, **kwargs: Any) -> None:
        raise AssertionError("it has been trained")

    monkeypatch.setattr(agent, "train", fail)
    assert go(config) == first
    with pytest.raises(InputError, match="another training file"):
        go(replace(config, text="other"))


def test_rigs_share_the_wrong_model_and_no_seed() -> None:
    tasks = [RigTask(case, seed) for case in close_loop.CASES for seed in (0, 1, 2)]
    assert len({task.number for task in tasks}) == len(tasks)
    wrong = Tuning("pid", "wrong", "", load_model("paper"), 0)
    others = [replace(wrong, seed=1), replace(wrong, model=load_model("rig"))]
    assert len({repr(task) for task in (wrong, replace(wrong, rig=""), *others)}) == 3


@pytest.mark.slow
def test_a_hidden_dead_zone_is_repaired(tmp_path: Path) -> None:
    """The whole chain on one rig: what was named is right, and the controller made from the model gains by it."""
    found = run_loop(tmp_path, cases=["dead_zone"], seeds=1, seed=7, generations=3, progress=False)
    assert found["rigs"][0]["right"]
    row = next(r for r in found["summary"] if r["controller"] == "model_inverse")
    assert row["repaired"]["mean"] < 0.5 * row["wrong"]["mean"]

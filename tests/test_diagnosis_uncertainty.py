"""Bootstrap, verdict by sealed logs, and the judging of blind trials."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.estimation.fit import Fit, noise_of
from hydro_env.diagnosis.estimation.multistart import restart_friction
from hydro_env.diagnosis.estimation.noise import noise_floor
from hydro_env.diagnosis.estimation.uncertainty import bootstrap
from hydro_env.diagnosis.estimation.unknowns import less_taken
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.calibration import as_given, base_unknowns, calibrate
from hydro_env.diagnosis.stages.localisation import shape
from hydro_env.diagnosis.stages.screening import Screening, absorb, hidden_by_calibration, screen
from hydro_env.experiments import blind_trials as trials
from hydro_env.files import write_json
from hydro_env.plant import load_model
from hydro_env.practice.generate import make_practice
from hydro_env.practice.hidden import parse_effects


def _fit(rig: DynamicRig) -> Fit:
    """The noise by the model as given."""
    given = as_given(Fit(rig, {(c, s.signal): 1e-3 for c in rig.channels for s in rig.segments[c]}))
    return Fit(rig, noise_of(rig, given))


def test_bootstrap_has_the_spread_of_the_mean() -> None:
    rng = np.random.default_rng(0)
    truth, count = 2.0, 400
    noise = rng.standard_normal(count)
    matrices, sides = np.ones((count, 1, 1)), (truth + noise)[:, None]
    moves = bootstrap(matrices, sides, np.zeros((1, 1)), np.zeros(1), rng)
    assert np.std(moves) == pytest.approx(1.0 / np.sqrt(count), rel=0.2)


def test_noise_floor_of_a_signal_that_stands_still_most_of_the_time() -> None:
    rng = np.random.default_rng(1)
    value = np.zeros(6000)
    value[4000:] = 0.5 * rng.standard_normal(2000)
    assert noise_floor(value, np.ones(6000, bool), 1e-3) == pytest.approx(0.5, rel=0.15)


def test_inertia_behind_a_coupling_comes_out_of_the_calibrated_one() -> None:
    assert less_taken({"J": 5e-3, "B": 1.0}, "shaft_backlash", {"inertia": 2e-3, "gap": 0.05}) == {
        "J": pytest.approx(3e-3)
    }
    assert less_taken({"J": 5e-3}, "dead_zone", {"overlap_positive": 1e-4}) == {}


def test_either_side_of_a_rig_serves_either_channel(tmp_path: Path) -> None:
    make_practice([], duration=3.0, rate=200.0, runs=("fit_1",), base_error=0.1, seed=3).write(tmp_path)
    model = load_model("paper").with_values({"Kq": (4e-4, 3e-4), "J": (3e-3, 2e-3)})
    rig = DynamicRig(model, read_parts([tmp_path / "fit_1.csv"], None))
    requests = [Request(0, {"R": 100.0 + n}) for n in range(3)] + [
        Request(1, {"load_bias.bias": 0.1}),
        Request(1, {}),
    ]
    together = rig.predict(requests)
    whole = rig.predict([Request(None, {"R": (102.0, model.value("R", 1))}), Request(None, {})])
    np.testing.assert_array_equal(together[2][0], whole[0][0])
    np.testing.assert_array_equal(together[4][1], whole[1][1])
    for request, answer in zip(requests, together, strict=True):
        np.testing.assert_array_equal(answer[request.channel], rig.predict([request])[0][request.channel])


def test_trials_are_judged_by_name_channel_and_verdict() -> None:
    gap = {"speed_1_rpm": {"noise": 1.0, "before": 90.0, "calibrated": 40.0, "after": 1.2, "placebo": 30.0}}
    named = [{"name": "quadratic_drag", "channel": "1", "indistinguishable_from": ["line_loss"]}]
    data = {"verdict": "effects", "effects": named, "gap": {"sealed": gap}}
    row = trials.judge(data, {("line_loss", "1")}, "effects")
    assert not row["right"] and row["set"] and row["channel"] and row["sealed"] and not row["placebo"]
    row = trials.judge(data, {("line_loss", "2")}, "effects")
    assert not row["set"] and not row["channel"]
    gap["speed_1_rpm"]["after"] = 6.0
    row = trials.judge(data, {("line_loss", "1")}, "effects", form={"speed_1_rpm": 5.0})
    assert not row["sealed"] and row["sealed_form"] and row["form"] == 5.0
    row = trials.judge(data, set(), "calibration")
    assert row["alarm"] and not row["right"]
    unknown = {"verdict": "unknown", "effects": named, "gap": {"sealed": gap}}
    assert trials.judge(unknown, {("dead_zone", "1")}, "effects", unlisted=True)["right"]
    assert not trials.judge(unknown, {("quadratic_drag", "1")}, "effects")["set"]


def test_what_calibration_hides_is_declared_but_never_counted_as_a_name() -> None:
    data = {
        "verdict": "calibration", "effects": [], "gap": {"sealed": {}}, "hidden_by_calibration": {"sensor_gain": ["1"]},
    }  # fmt: skip
    row = trials.judge(data, {("sensor_gain", "1")}, "effects")
    assert row["declared_set"] and not row["set"] and not row["right"]
    assert not trials.judge(data, {("sensor_gain", "2")}, "effects")["declared_set"]
    assert trials.judge(data, {("sensor_gain", "1")}, "effects", unlisted=True)["open"]


def test_calibration_hides_a_wrong_scale_of_the_speed_and_not_a_dead_zone(tmp_path: Path) -> None:
    make_practice([], duration=4.0, rate=500.0, runs=("fit_1",), seed=3).write(tmp_path)
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "fit_1.csv"], None))
    fit = _fit(rig)
    calibrated = calibrate(fit, 2)
    found = screen(fit, calibrated, ["sensor_gain", "dead_zone", "speed_dependent_leakage"], 4.0)
    linear = {(k.effect, k.channel): k.visible for k in found}
    absorb(fit, calibrated, found)
    assert all(k.visible <= linear[k.effect, k.channel] for k in found)
    hidden = hidden_by_calibration(found)
    assert "sensor_gain" in hidden and "dead_zone" not in hidden


def test_what_calibration_takes_up_but_for_next_to_nothing_is_hidden() -> None:
    def seen(visible: float, unprojected: float) -> Screening:
        return Screening("sensor_gain", 0, {}, 0.0, visible, np.zeros(1), unprojected)

    assert seen(50.0, 1e4).hidden and not seen(50.0, 1e4).shows
    assert seen(213.0, 6.5e6).hidden and not seen(213.0, 6.5e6).shows
    assert not seen(1e4, 6.5e6).hidden and seen(1e4, 6.5e6).shows
    small = seen(10.0, 20.0)  # nothing there that calibration could take
    assert not small.hidden and not small.shows


def test_estimates_leave_a_local_minimum_of_friction(tmp_path: Path) -> None:
    make_practice([], duration=4.0, rate=500.0, runs=("fit_1",), seed=3).write(tmp_path)
    rig = DynamicRig(load_model("paper"), read_parts([tmp_path / "fit_1.csv"], None))
    fit, unknowns = _fit(rig), base_unknowns(rig, 0)
    q = np.array([{"Fc": 1.5, "Fs": 1.5, "vs": -1.0}.get(u.name, 0.0) for u in unknowns])
    found = Estimate(0, unknowns, q)
    fit.evaluate([found])
    before = found.cost
    assert not restart_friction(fit, [found])  # so far off it may be an effect that is missing
    assert restart_friction(fit, [found], whole=True) == [found] and found.cost < before
    assert not restart_friction(fit, [Estimate(0, [], np.zeros(0), simulated=found.simulated)])


def test_cases_have_seeds_of_their_own_and_loss_models_are_none() -> None:
    found = trials.cases(list(trials.GROUPS), 100)
    for case in found:  # what cannot be hidden would end the whole run
        assert bool(parse_effects(case.hidden)) == bool(case.hidden)
    assert len({c.seed for c in found}) == len(found)
    assert not any("losses" in name or "wilson" in name for c in found for name in c.hidden)


@dataclass
class _Fake:
    """In place of `run_case`: a row without a simulation."""

    runs: int = 0

    def __call__(self, case: trials.Case, **_: object) -> dict[str, object]:
        self.runs += 1
        row = {
            "group": case.group,
            "hidden": list(case.hidden),
            "seed": case.seed,
            "effects": [],
            "cpu_s": 1.0,
            "seconds": 1.0,
        }
        judged = {
            "right": True,
            "set": True,
            "channel": True,
            "alarm": False,
            "both": True,
            "sealed": True,
            "placebo": False,
        }
        return {**row, **judged, "verdict": "none", "named": [], "worst": 1.0, "form": 1.0, "gap": {}}


def test_the_commands_of_a_table_make_its_rows_and_no_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = trials.cases(["nothing", "two"], 3000, 4)
    part = [c for c in trials.cases(["quiet"], 3000, 4) if c.seed not in (12003, 12005)][:-1]
    commands = trials.commands([{"group": c.group, "seed": c.seed} for c in (*whole, *part)])
    assert len(commands) == 2
    wanted: list[trials.Case] = []
    monkeypatch.setattr(trials, "run_trials", lambda out, cases, **_: wanted.extend(cases) or [])
    for command in commands:
        monkeypatch.setattr("sys.argv", ["trials", *command.replace("DIR", str(tmp_path)).split()[3:]])
        trials._main()
    assert wanted == [*whole, *part]


def test_interrupted_trials_go_on_where_they_were(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = _Fake()
    monkeypatch.setattr(trials, "run_case", fake)
    wanted = trials.cases(["nothing", "two"], 5)
    trials.run_trials(tmp_path, wanted[:4], say=lambda text: None)
    trials.run_trials(tmp_path, wanted[3:6], say=lambda text: None, name="trials_2_of_2.json")
    rows = trials.run_trials(tmp_path, wanted, say=lambda text: None)
    assert fake.runs == len(wanted) == len(rows)
    (tmp_path / "docs").mkdir()
    trials.publish(rows, tmp_path / "docs")
    published = json.loads((tmp_path / "docs" / "trials.json").read_text())
    assert published["summary"]
    text = trials.table(published["rows"])
    assert text == trials.table(rows) and "10 of 10 (100 %)" in text


def test_what_the_true_values_leave_of_a_rig_in_another_form(tmp_path: Path) -> None:
    case = trials.Case("medium", ("flow_saturation:1",), 3)
    trials.practice_logs(case, tmp_path, duration=3.0, rate=500.0)
    form = json.loads((tmp_path / "form.json").read_text())
    # The untouched channel is explained to the noise (1 rpm), the other one not much worse: only the corner is rounded.
    assert 0.9 < form["speed_2_rpm"] < 1.1 and form["speed_2_rpm"] < form["speed_1_rpm"] < 30.0
    first = (tmp_path / "sealed.csv").stat().st_mtime_ns
    trials.practice_logs(case, tmp_path, duration=3.0, rate=500.0)
    assert (tmp_path / "sealed.csv").stat().st_mtime_ns == first


@pytest.mark.slow
@pytest.mark.parametrize("group", ["medium", "unlisted"])
def test_a_blind_trial(group: str) -> None:
    case = next(
        c
        for c in trials.cases([group], 7)
        if c.hidden == ("null_offset:2",) or c.hidden == ("null_offset:1",)
    )
    assert trials.run_case(case)["right"]


def test_the_shape_of_a_gap_tells_a_curve_from_memory() -> None:
    t = np.arange(6000) * 1e-3
    command = 40.0 * np.sin(2.0 * np.pi * t)
    overlap = shape(command, -np.clip(command, -10.0, 10.0), "command, V", "flow", 1.0)
    assert overlap.explains > 0.95
    assert next(p[1] for p in overlap.points) == pytest.approx(10.0, rel=0.01)
    loop = shape(command, np.sign(np.cos(2.0 * np.pi * t)), "command, V", "flow", 1.0)
    assert loop.explains < 0.1 and loop.with_direction > 0.95


def test_a_trial_that_two_slices_ran_counts_once(tmp_path: Path) -> None:
    rows = [{"group": g, "seed": n} for g, n in (("medium", 3), ("nothing", 7), ("medium", 2))]
    for name, own in (("trials_1_of_2.json", rows[:2]), ("trials_2_of_2.json", rows[1:])):
        write_json(tmp_path / name, {"rows": own})
    assert [r["seed"] for r in trials.rows_of(tmp_path)] == [7, 2, 3]

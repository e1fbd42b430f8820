"""Result files: what they hold, what a check finds, who is idle."""

import json
import shutil

import numpy as np
import pytest

from hydro_env.benchmark import command
from hydro_env.benchmark.command import Selection
from hydro_env.benchmark.report import scores_table
from hydro_env.benchmark.result import check, read_result
from hydro_env.benchmark.suite import load_suite
from hydro_env.errors import InputError
from hydro_env.files import to_json

SUITE = """\
protocol: true
first: 700
splits: {test_interp: 5, faulted: 6}
scenarios: [setpoint_steps]
metrics: [max_speed_difference_rpm, tracking_mae_rpm, return, valve_reversals_per_s]
"""
STILL = """\
import numpy as np

class Still:
    name = "still"
    def reset(self, num_rigs, control_period):
        pass
    def act(self, observation):
        return np.zeros((len(observation), 2))
"""


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = tmp_path_factory.mktemp("results")
    (folder / "suite.yaml").write_text(SUITE)
    (folder / "still.py").write_text(STILL)
    (folder / "training.yaml").write_text("algorithm: PPO\nperiods: 1.0e+6\nseeds: [0, 1]\n")
    command.run(
        folder, controllers=["gru", f"{folder / 'still.py'}:Still"], progress=False,
        selection=Selection(folder / "suite.yaml", declared=folder / "training.yaml"),
    )  # fmt: skip
    return folder


def scores(out):
    return json.loads((out / "scores.json").read_text())


def test_the_ends_of_the_score_take_part(out):
    rows = {
        (row["controller"], row["split"]): row["iqm"]
        for row in scores(out)["rows"]
        if row["metric"] == "normalised_score"
    }
    assert [rows["pid_tuned", split] for split in ("test_interp", "faulted")] == [0.0, 0.0]
    assert [rows["oracle", split] for split in ("test_interp", "faulted")] == [100.0, 100.0]
    assert rows["gru", "test_interp"] > 50.0
    whole = {
        row["controller"]: row["iqm"] for row in scores(out)["overall"] if row["metric"] == "normalised_score"
    }
    assert whole["pid_tuned"] == 0.0 and whole["oracle"] == 100.0
    assert whole["gru"] == pytest.approx((rows["gru", "test_interp"] + rows["gru", "faulted"]) / 2)


def test_who_stands_still_is_idle_and_last(out):
    found = scores(out)
    assert {each["controller"] for each in found["idle"]} == {"still"}
    blocks = scores_table(found).split("\n\n")
    assert len(blocks) == 3
    for block in blocks:
        assert block.splitlines()[-1].startswith("  still (idle)")


def test_a_result_file_has_all_that_a_reader_needs(out):
    found = read_result(out / "result_gru.json")
    assert found["controller"] == found["given"] == "gru" and found["file_sha256"] is None
    assert found["class"] == "signals only" and found["declared"]["periods"] == 1e6
    assert set(found["versions"]) == {"hydro_env", "physics", "splits", "reward"}
    assert found["suite"]["first"] == 700 and found["decision_us"] > 0.0
    for each in found["cases"]:
        row = next(
            row
            for row in scores(out)["rows"]
            if (row["controller"], row["metric"], row["split"]) == ("gru", "return", each["split"])
        )
        assert np.mean(np.sort(each["metrics"]["return"])[1:-1]) == pytest.approx(row["iqm"])
    # What is declared is the training of those that were given, not of those that set the ends.
    assert read_result(out / "result_oracle.json")["declared"] is None
    still = read_result(out / "result_still.json")
    assert still["given"] == "still.py:Still" and len(still["file_sha256"]) == 64 and still["idle"] == 2


@pytest.mark.parametrize("name", ["gru", "pid_tuned"])
def test_a_result_is_reproduced(out, name):
    told = check(out / f"result_{name}.json", seed=0, progress=False)
    assert any(f"{values} values of {name} are the same bit for bit" in told for values in (20, 24))


def test_the_file_of_a_controller_is_known_by_its_content(out, tmp_path):
    shutil.copy(out / "still.py", tmp_path / "other.py")
    assert "the same bit for bit" in check(
        out / "result_still.json", [f"{tmp_path / 'other.py'}:Still"], progress=False
    )
    (tmp_path / "other.py").write_text(STILL + "\n")
    for given in ([], [f"{tmp_path / 'other.py'}:Still"], ["gru"]):
        with pytest.raises(InputError, match=r"is the result of still\.py:Still, sha256 .* give that file"):
            check(out / "result_still.json", given, progress=False)


def changed(out, tmp_path, change, sign=True):
    """The result of `gru` with a change, with a digest that belongs to it or the old one."""
    from hydro_env.benchmark.result import _digest

    found = json.loads((out / "result_gru.json").read_text())
    change(found)
    if sign:
        found["sha256"] = _digest({key: value for key, value in found.items() if key != "sha256"})
    path = tmp_path / "changed.json"
    path.write_text(to_json(found))
    return path


def better(found):
    for each in found["cases"]:
        each["metrics"]["valve_reversals_per_s"][3] /= 2


def flattered(found):
    """Ends that make the score of every case 500 less what it is short of the bound."""
    from hydro_env.benchmark.cells import overall
    from hydro_env.benchmark.result import _cells

    found["score_ends"] = {place: [low - 500.0, high] for place, (low, high) in found["score_ends"].items()}
    ends = {tuple(place.split()): tuple(pair) for place, pair in found["score_ends"].items()}
    found["overall"] = {name: each.row for name, each in overall(_cells(found, "gru", False), ends).items()}


@pytest.mark.parametrize(
    "key", ["controller", "class", "versions", "declared", "suite", "decision_us", "overall", "cases"]
)
def test_a_changed_file_is_noticed(out, tmp_path, key):
    path = changed(out, tmp_path, lambda found: found.update({key: None}), sign=False)
    with pytest.raises(InputError, match="the file was changed"):
        check(path, progress=False)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (better, "valve_reversals_per_s of case 703 in .* is .* where the file has .*; 1 of [56] differ"),
        (
            lambda found: found["versions"].update(physics=0),
            "version 0 of physics, this is 1: hydro_env .* is right",
        ),
        (
            lambda found: found["overall"]["tracking_mae_rpm"].update(iqm=1.0),
            "overall tracking_mae_rpm does not follow",
        ),
        (lambda found: found["overall"].pop("normalised_score"), "overall normalised_score does not follow"),
        (lambda found: found.update(schema="x"), "schema"),
        (
            lambda found: found.update({"class": "valve bench"}),
            "class is 'valve bench', the controller's is 'signals only'",
        ),
        (lambda found: found.update({"class": "nothing"}), "unknown class 'nothing'"),
        (lambda found: found.pop("cases"), "cases is missing"),
        (lambda found: found["cases"].pop(), "are not those of every split"),
        (lambda found: found["cases"][0]["metrics"]["return"].pop(), "has not a value of each metric"),
        (
            lambda found: found["cases"][0]["metrics"].update({"return": ["a"] * 5}),
            "is 'a', should be a number",
        ),
        (lambda found: found["suite"].update(suite="paper"), "suite paper is a protocol"),
        (lambda found: found["suite"].update(dtype="float64"), "dtype is float64, should be float32"),
        (flattered, "score_ends of .* are .*, should be"),
    ],
)
def test_a_false_result_is_noticed(out, tmp_path, change, says):
    """Also by a digest that belongs to it; every message is one line."""
    with pytest.raises(InputError, match=says) as caught:
        check(changed(out, tmp_path, change), progress=False)
    assert "\n" not in str(caught.value)


def test_no_code_is_run_that_only_the_file_names(out, tmp_path, monkeypatch):
    (tmp_path / "evil.py").write_text("raise SystemExit('it ran')\n")
    monkeypatch.syspath_prepend(tmp_path)
    path = changed(out, tmp_path, lambda found: found.update(given="evil:X"))
    with pytest.raises(InputError, match="is the result of evil:X, sha256 None: give that file"):
        check(path, progress=False)


def test_a_protocol_is_not_changed(tmp_path):
    for changes in ({"splits": ["val"]}, {"scenarios": ["sine"]}, {"cases": 2}):
        with pytest.raises(InputError, match="suite paper is a protocol"):
            command.run(tmp_path / "no", controllers=["pid_tuned"], selection=Selection("paper", **changes))
    for changes in ({"plant": "rig"}, {"control_period": 0.02}, {"seed": 1}):
        with pytest.raises(InputError, match="suite paper is a protocol"):
            command.run(
                tmp_path / "no", controllers=["pid_tuned"], selection=Selection("paper"),
                conditions=command.Conditions(**changes),
            )  # fmt: skip
    assert not (tmp_path / "no").exists()


def test_a_protocol_needs_what_it_is_summed_up_by(tmp_path):
    (tmp_path / "s.yaml").write_text(SUITE.replace("return, ", ""))
    with pytest.raises(InputError, match="metrics: a protocol needs return"):
        load_suite(tmp_path / "s.yaml")


def test_the_cases_of_the_protocol_are_its_own():
    suite = load_suite("paper")
    assert suite.protocol and all(suite.first + cases <= 1000 for cases in suite.splits.values())
    others = [load_suite(name) for name in ("quick", "full")]
    assert all(other.first + cases <= suite.first for other in others for cases in other.splits.values())

"""The naming benchmark: sets that give nothing away, answers, scores, refusals, runs."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_env.cli.main import run
from hydro_env.errors import InputError
from hydro_env.experiments.naming_benchmark import dialogue, scoring, sets
from hydro_env.experiments.naming_benchmark.answers import answer, read_answers
from hydro_env.experiments.naming_benchmark.methods import chosen, run_methods
from hydro_env.files import write_json
from hydro_env.plant import CATALOGUE

EFFECT = {"name": "dead_zone", "channel": "1", "probability": 0.9}


def small_set(folder: Path, kind: str = "one") -> Path:
    """A set of one rig of four rows, of which the last two are scored."""
    rig = folder / "rigs" / "rig_001"
    rig.mkdir(parents=True)
    (folder / "truth").mkdir()
    write_json(folder / "set.json", {"schema": sets.SET_SCHEMA, "rigs": ["rig_001"]})
    write_json(folder / "truth" / "set.json", {"seed": 0})
    (rig / "commands.csv").write_text("time_s,command_1_V\n0,0\n0.1,0\n0.2,0\n0.3,0\n")
    (folder / "truth" / "rig_001.csv").write_text("time_s,speed_1_rpm,speed_2_rpm\n0.2,10,20\n0.3,10,20\n")
    hidden = [{"name": "dead_zone", "channel": "1"}] if kind in ("one", "unlisted") else []
    truth = {"schema": sets.TRUTH_SCHEMA, "rig": "rig_001", "kind": kind, "effects": hidden, "noise_rpm": 2.0}
    write_json(folder / "truth" / "rig_001.json", truth)
    return folder


def answers(folder: Path, **changes: Any) -> Path:
    folder.mkdir()
    write_json(folder / "rig_001.json", {**answer("rig_001", "effects", [EFFECT], 1.0), **changes})
    return folder


def test_an_answer_survives_writing_and_reading(tmp_path: Path) -> None:
    found = read_answers(answers(tmp_path / "mine"), ["rig_001"])
    assert found["rig_001"] == answer("rig_001", "effects", [EFFECT], 1.0)


def test_the_sealed_error_counts_the_scored_rows_over_the_noise(tmp_path: Path) -> None:
    folder = answers(tmp_path / "mine", prediction="p.csv")
    (folder / "p.csv").write_text("time_s,speed_1_rpm,speed_2_rpm\n0,99,9\n0.1,99,9\n0.2,14,20\n0.3,10,24\n")
    found = scoring.score(small_set(tmp_path / "set"), {"mine": folder})
    assert found["rows"][0]["error"] == pytest.approx(np.sqrt(8.0) / 2.0)
    assert found["rows"][0]["name"] and found["rows"][0]["channel"] and not found["rows"][0]["false_name"]


@pytest.mark.parametrize(
    ("kind", "verdict", "named", "true"),
    [
        ("one", "effects", ("load_bias", "1"), {"false_name", "channel"}),
        ("one", "effects", ("dead_zone", "2"), {"name", "first"}),
        ("unlisted", "unknown", None, {"unknown"}),
        ("unlisted", "effects", ("load_bias", "1"), {"false_name"}),
        ("nothing", "effects", ("dead_zone", "1"), {"alarm", "false_name"}),
        ("parameters", "calibration", None, set()),
    ],
)
def test_an_answer_is_judged(kind: str, verdict: str, named: tuple[str, str] | None, true: set[str]) -> None:
    hidden = [{"name": "dead_zone", "channel": "1"}] if kind in ("one", "unlisted") else []
    effects = [] if named is None else [dict(zip(("name", "channel"), named, strict=True))]
    row = scoring.judge(
        answer("r", verdict, effects, 0.0), {"rig": "r", "kind": kind, "effects": hidden}, None
    )
    assert {k for k in ("name", "first", "channel", "false_name", "alarm", "unknown") if row[k]} == true


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"schema": "x"}, "schema"),
        ({"rig": "rig_002"}, "expected 'rig_001'"),
        ({"verdict": "maybe"}, "'none', 'calibration'"),
        ({"verdict": "none"}, "names at least one"),
        ({"effects": [{"name": "dead_zon", "channel": "1"}]}, "did you mean 'dead_zone'"),
        ({"effects": [{"name": "dead_zone", "channel": "3"}]}, "channel is '3'"),
        ({"prediction": "../truth.csv"}, "a file beside it"),
        ({"model": "none.yaml"}, "model is 'none.yaml', expected the name of a file beside it"),
        ({"speed": 1}, "unknown key 'speed'"),
    ],
)
def test_a_malformed_answer_is_refused_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict[str, Any], said: str
) -> None:
    folder = answers(tmp_path / "mine", **changes)
    words = ["score", str(folder), "--set", str(small_set(tmp_path / "set")), "--out", str(tmp_path / "out")]
    assert run(["naming-benchmark", *words]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and said in text and "rig_001.json" in text
    assert not (tmp_path / "out").exists()


def test_missing_and_foreign_answers_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = answers(tmp_path / "mine")
    (folder / "rig_007.json").write_text("{}")
    words = [
        "naming-benchmark",
        "score",
        str(folder),
        "--set",
        str(small_set(tmp_path / "set")),
        "--out",
        str(tmp_path / "o"),
    ]
    assert run(words) == 2
    (folder / "rig_007.json").unlink()
    (folder / "rig_001.json").unlink()
    assert run(words) == 2
    first, second = capsys.readouterr().err.splitlines()
    assert "rig_007" in first and "1 of 1 answers are missing" in second


def test_the_first_rigs_are_scored_alone(tmp_path: Path) -> None:
    folder = answers(tmp_path / "mine")
    assert [*read_answers(folder, ["rig_001", "rig_002"], 1)] == ["rig_001"]


def test_of_several_names_the_most_probable_counts_apart() -> None:
    effects = [{"name": "load_bias", "channel": "1", "probability": 0.1}, EFFECT]
    truth = {"rig": "r", "kind": "one", "effects": [EFFECT]}
    row = scoring.judge(answer("r", "effects", effects, 0.0), truth, None)
    assert row["first"] and not row["name"] and row["false_name"]


def test_scores_are_written(tmp_path: Path) -> None:
    folder, out = answers(tmp_path / "mine"), tmp_path / "out"
    words = ["score", str(folder), "--set", str(small_set(tmp_path / "set")), "--out", str(out)]
    assert run(["naming-benchmark", *words]) == 0
    entry = json.loads((out / "naming.json").read_text())["summary"][0]
    assert entry["method"] == "mine" and entry["name"]["count"] == 1 and entry["error"] is None


@pytest.mark.parametrize("seed", range(30))
def test_candidates_hold_what_is_hidden_unless_it_is_unlisted(seed: int) -> None:
    for kind in sets.KINDS:
        drawn = sets.draw_rig(kind, np.random.default_rng(seed))
        names = {word.partition(":")[0] for word in drawn["effects"]}
        alike = names.union(*(CATALOGUE[n].indistinguishable_from for n in names))
        assert drawn["left_out"]
        if kind == "unlisted":
            assert names <= {*drawn["left_out"]}
        else:
            assert not alike & {*drawn["left_out"]}


def test_a_run_keeps_the_answers_that_are_there(tmp_path: Path) -> None:
    asked = []

    def mine(folder: Path, out: Path) -> dict[str, Any]:
        asked.append(folder.name)
        return answer(folder.name, "none", [], 0.0)

    folder, out = small_set(tmp_path / "set"), tmp_path / "out"
    run_methods({"mine": mine}, folder, out)
    run_methods({"mine": mine}, folder, out)
    assert asked == ["rig_001"] and [*read_answers(out / "mine", ["rig_001"])] == ["rig_001"]


def test_an_unknown_method_is_refused_with_those_there_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["run", "diagnose", "certify", "--set", str(tmp_path), "--out", str(tmp_path / "out")]
    assert run(["naming-benchmark", *words]) == 2
    text = capsys.readouterr().err
    assert text == "error: unknown method 'certify': known are diagnose, calibrate, ask, all\n"
    assert not (tmp_path / "out").exists()


def test_all_means_every_method() -> None:
    def mine(folder: Path, out: Path) -> dict[str, Any]:
        raise AssertionError

    assert [*chosen(["all"], {"one": mine, "two": mine})] == ["one", "two"]


@pytest.fixture(scope="module")
def asked_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("set") / "set"
    sets.make_set(folder, 1, 48000, ask=True)
    return folder


def question(answers: Path, number: int, *record: str, seconds: float = 3.0) -> Path:
    """A question of a method: a step on both valves."""
    own = answers / "rig_001"
    own.mkdir(parents=True, exist_ok=True)
    rows = [(0.0, 0.0), (0.5, 20.0), (seconds, 0.0)]
    text = "".join(f"{t},{u},{-u}\n" for t, u in rows)
    (own / f"question_{number}.csv").write_text("time_s,command_1_V,command_2_V\n" + text)
    write_json(own / f"question_{number}.json", {"record": list(record)})
    return own / f"answer_{number}.csv"


def test_a_rig_answers_with_the_sensors_that_are_asked_for(asked_set: Path, tmp_path: Path) -> None:
    first, second = question(tmp_path, 1), question(tmp_path, 2, "spool", "pressure")
    assert dialogue.play(asked_set, tmp_path) == 2
    names = [path.read_text().split("\n", 1)[0] for path in (first, second)]
    assert ["spool_1_mm" in each for each in names] == [False, True]
    before = first.read_bytes()
    assert dialogue.play(asked_set, tmp_path) == 0 and first.read_bytes() == before
    known = asked_set / "rigs" / "rig_001"
    assert not (known / "fit_1.csv").exists() and json.loads((known / "rig.json").read_text())["budget"]


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        (
            [("spool", "flow"), ("spool", "motor_pressure")],
            "question_2.csv: beyond the rig's budget of 3 sensors",
        ),
        ([()] * 4, "question_4.csv: beyond the rig's budget of 3 questions"),
        ([("spol",)], "did you mean 'spool'"),
    ],
)
def test_a_question_beyond_the_budget_is_refused(
    asked_set: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    asked: list[tuple[str, ...]],
    said: str,
) -> None:
    for number, record in enumerate(asked, 1):
        question(tmp_path, number, *record)
    assert run(["naming-benchmark", "play", str(tmp_path), "--set", str(asked_set)]) == 2
    text = capsys.readouterr().err
    assert text.count("\n") == 1 and said in text


def test_seconds_are_limited(asked_set: Path, tmp_path: Path) -> None:
    question(tmp_path, 1, seconds=20.0)  # and the last row lasts as long as the one before
    with pytest.raises(InputError, match="beyond the rig's budget of 36 seconds in all"):
        dialogue.play(asked_set, tmp_path)


def test_a_question_waits_where_the_truth_is_elsewhere(asked_set: Path, tmp_path: Path) -> None:
    """A sealed set: the method asks, who holds the truth plays, the method goes on."""
    shutil.copytree(asked_set / "rigs", tmp_path / "sealed" / "rigs")
    rig, own, seen = tmp_path / "sealed" / "rigs" / "rig_001", tmp_path / "mine" / "rig_001", []

    def diagnosed(answers: list[Path]) -> Any:
        seen.append(len(answers))
        return len(answers)

    def design(found: Any, rng: np.random.Generator) -> tuple[str, list[str]] | None:
        return None if found else ("time_s,command_1_V\n0,0\n1,10\n3,0\n", ["spool"])

    assert dialogue.converse(design, diagnosed, rig, own) is None
    assert dialogue.converse(design, diagnosed, rig, own) is None
    assert dialogue.play(asked_set, tmp_path / "mine") == 1
    assert dialogue.converse(design, diagnosed, rig, own) == 1 and seen == [0, 1]
    assert (
        dialogue.converse(design, diagnosed, asked_set / "rigs" / "rig_001", tmp_path / "at_once" / "rig_001")
        == 1
    )


def test_another_truth_than_the_published_one_is_refused(asked_set: Path, tmp_path: Path) -> None:
    shutil.copytree(asked_set, tmp_path / "set")
    path = tmp_path / "set" / "truth" / "rig_001.json"
    path.write_text(path.read_text().replace("one", "two").replace("large", "small") + " ")
    with pytest.raises(InputError, match="is not the truth whose digest"):
        sets.read_truth(tmp_path / "set", "rig_001")
    assert "seed" not in (asked_set / "set.json").read_text()

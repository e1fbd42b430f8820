"""Rigs of the other simulator: what is right of a diagnosis, and a run that goes on where it was interrupted."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from docs.evidence import four_edge_rigs
from docs.evidence.four_edge_rigs import CASES, engineers_model, judged, logs, run
from docs.evidence.four_edges import Axis
from hydro_env.plant import CATALOGUE


def _said(verdict: str, *named: str, beside: tuple[str, ...] = (), guess: bool = False) -> dict[str, Any]:
    effects = [
        {"name": n.split(":")[0], "channel": n.split(":")[1], "indistinguishable_from": list(beside)}
        for n in named
    ]
    gap = {"speed_1_rpm": {"after": 1.1, "noise": 1.0}, "pressure_1_bar": {"after": 9.0, "noise": 1.0}}
    return {"verdict": verdict, "best_guess": guess, "effects": effects, "gap": {"sealed": gap}}


@pytest.mark.parametrize(
    ("case", "said", "right", "listed", "false_name"),
    [
        ("overlap", _said("effects", "dead_zone:1"), True, True, False),
        ("overlap", _said("effects", "dead_zone:2"), False, False, True),
        ("overlap", _said("effects", "dead_zone:1", "null_offset:2"), False, False, True),
        ("overlap", _said("effects", "spring_preload:1", beside=("dead_zone",)), False, True, False),
        ("overlap", _said("effects", "spring_preload:1", guess=True), False, False, False),
        ("overlap", _said("unknown"), False, False, False),
        ("nothing", _said("calibration"), True, True, False),
        ("nothing", _said("effects", "dead_zone:1"), False, False, True),
        ("vessel at a line", _said("unknown"), True, True, False),
        ("vessel at a line", _said("calibration"), False, False, False),
        ("overlap and play", _said("effects", "dead_zone:1", "input_hysteresis:1"), True, True, False),
        ("overlap and play", _said("effects", "dead_zone:1"), False, False, False),
    ],
)
def test_what_is_right(case: str, said: dict[str, Any], right: bool, listed: bool, false_name: bool) -> None:
    row = judged(CASES[case], said)
    assert (row["right"], row["set"], row["false_name"]) == (right, listed, false_name)
    assert row["worst"] == 1.1


def test_every_case_hides_what_there_is_and_expects_names_that_there_are() -> None:
    for case in CASES.values():
        assert case.names or case.verdicts
        assert {n.split(":")[0] for n in case.names} <= {*CATALOGUE}
        for hidden in case.hidden.values():
            assert {*hidden} <= {*Axis._fields}


def test_the_same_seed_gives_the_same_logs_and_another_one_others() -> None:
    first, again, other = (logs("overlap", seed, seconds=0.5) for seed in (3, 3, 4))
    for name in first["sealed"]:
        np.testing.assert_array_equal(first["sealed"][name], again["sealed"][name])
    assert not np.array_equal(first["sealed"]["speed_1_rpm"], other["sealed"]["speed_1_rpm"])


def test_the_data_sheet_gives_a_spool_of_its_frequency_and_damping() -> None:
    model = engineers_model()
    k, m, c = (model.value(name, 0) for name in ("k", "m", "C"))
    assert np.sqrt(k / m) / (2.0 * np.pi) == pytest.approx(80.0)
    assert c / (2.0 * np.sqrt(k * m)) == pytest.approx(0.8)


def test_a_run_goes_on_where_it_was_interrupted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    def diagnosed(fit: list[Path], sealed: list[Path], **_: Any) -> Any:
        asked.append(fit[0].parent.name)
        assert all(p.exists() for p in (*fit, *sealed))
        return SimpleNamespace(as_dict=lambda: _said("calibration"))

    monkeypatch.setattr(four_edge_rigs, "diagnose", diagnosed)
    monkeypatch.setattr(four_edge_rigs, "logs", lambda name, seed: logs(name, seed, seconds=0.5))
    assert len(run(tmp_path, 1, ["nothing"], tmp_path)) == 1
    rows = run(tmp_path, 1, ["nothing", "overlap"], tmp_path)
    assert asked == ["1_nothing", "1_overlap"]
    assert [r["right"] for r in rows] == [True, False]
    assert "| overlap | 1 | dead_zone:1 | calibration | - | no | 1.10 |" in (
        tmp_path / "four_edge_rigs.md"
    ).read_text(encoding="utf-8")

"""What the script of dialogues counts."""

from __future__ import annotations

from typing import Any

from docs.evidence.dialogue import GROUPS, paired, rigs, table

COUNTS = {"base": 8, "effects": 1}


def _row(group: str, asked: list[bool], random: list[bool]) -> dict[str, Any]:
    rounds = {
        kind: [
            {
                "verdict": "effects",
                "proven": each,
                "alarm": False,
                "given": [[0.95, each]],
                "covered": {"at_90": COUNTS, "base": [9, 9], "effects": [2, 2]},
            }
            for each in own
        ]
        for kind, own in (("asked", asked), ("random", random), ("d_optimal", random))
    }
    return {"group": group, "hidden": ["dead_zone:1"], **rounds}


def test_questions_are_counted_until_a_rig_is_exact() -> None:
    rows = [
        _row("single", [True], [True]),  # not open
        _row("single", [False, True], [False, False, False, False]),  # 1 question, never
        _row("pair", [False, False, True], [False, True]),  # 2, 1
    ]
    assert paired(rows).startswith(
        "Of 2 open rigs asked questions need fewer than random ones in 1, more in 1 (p = 1); mean 1.50 and 2.50"
    )
    assert "| single: 2 | asked | 1 | 2 | 2 | 2 | 2 | 0 | 0.50 | 2 of 2 | 2 of 4, 16 of 18 |" in table(rows)


def test_a_run_that_is_stopped_has_rigs_of_every_group() -> None:
    drawn = list(rigs(680000, 10, 6, 10))
    assert len({r["seed"] for r in drawn}) == len(drawn) == 26
    assert {r["group"] for r in drawn[:6]} == {*GROUPS}
    assert all(len(r["hidden"]) == GROUPS.index("pair") + 1 for r in drawn if r["group"] == "pair")

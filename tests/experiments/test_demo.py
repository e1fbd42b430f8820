"""The demo's page: what is animated was driven, five rows of the leaderboard, a line for every term, and no network."""

from __future__ import annotations

import html
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_env.benchmark import command as benchmark
from hydro_env.controllers import make_controller
from hydro_env.controllers.rollout import roll_out
from hydro_env.experiments import demo
from hydro_env.experiments.demo import EVERY, animation, record
from tests.browser import needs_browser, shown

TITLES = {"pid_paper": "The paper's PID", "ppo": "An agent"}
SEEDS = range(4, 9)


@pytest.fixture(scope="module")
def recorded() -> dict[str, Any]:
    return record(TITLES, SEEDS, split="test_interp", scenario="setpoint_steps")


def test_what_is_animated_is_what_was_driven(recorded: dict[str, Any]) -> None:
    """The same pair of valves under both controllers, the median case of the first one."""
    peaks = {}
    for seed in SEEDS:
        trace = roll_out(make_controller("pid_paper"), [seed], mismatch="test_interp").trace
        peaks[seed] = float(np.abs(trace.difference_rpm).max())
    assert sorted(peaks.values())[2] == peaks[recorded["seed"]]
    embedded = json.JSONDecoder().raw_decode(str(animation(recorded)).partition("const D = ")[2])[0]
    assert embedded == recorded and [run["name"] for run in embedded["runs"]] == list(TITLES)
    for run in embedded["runs"]:
        trace = roll_out(make_controller(run["name"]), [recorded["seed"]], mismatch="test_interp").trace
        rows = slice(None, None, EVERY)
        np.testing.assert_allclose(np.transpose(run["speed_rpm"]), trace.speed_rpm[rows, 0], atol=0.5)
        np.testing.assert_allclose(run["ahead_deg"], trace.angle_difference_deg[rows, 0], atol=0.5)
        np.testing.assert_allclose(
            np.transpose(run["command_percent"])[:-1], 100.0 * trace.command[rows, 0], atol=0.5
        )
        np.testing.assert_allclose(embedded["setpoint_rpm"], trace.setpoint_rpm[rows, 0], atol=0.5)
        assert embedded["period_s"] == EVERY * trace.period
    assert len(str(animation(recorded))) < 25_000


@pytest.fixture(scope="module")
def page() -> str:
    names = [
        "pid_paper",
        "pid_tuned",
        "cross_coupled",
        "probing_flow",
        "bench_flow",
        "oracle",
        "ppo",
        "gru",
    ]
    scores = benchmark.run(
        None, controllers=names, selection=benchmark.Selection("quick", cases=2), progress=False
    )
    board = demo._board(scores)
    plain = {n: r["iqm"] for n in names for r in scores["rows"]
             if (r["controller"], r["scenario"], r["metric"]) == (n, *demo.BOARD[0][:2])}  # fmt: skip
    law, agent = min("cross_coupled", "probing_flow", key=plain.get), min("ppo", "gru", key=plain.get)
    assert [row["name"] for row in board["rows"]] == ["pid_paper", "pid_tuned", law, agent, "oracle"]
    assert board["agent"] == agent and board["controllers"] == len(names)
    steps = "published_rpm tables_only_rpm with_dead_zone_rpm overlap_V1_m equal_again_within_rpm equal_again_after_s"
    steps += " published_equal_again_after_s"
    load = "published_rpm simulated_rpm nominal_torque_Nm largest_command_V"
    paper = {
        "setpoint_steps": dict.fromkeys(steps.split(), 1.0),
        "load_step": dict.fromkeys(load.split(), 1.0),
    }
    overlap = {"value": 7.1e-5, "low": 6.9e-5, "high": 7.2e-5, "unit": "m"}
    found = {
        "name": "dead_zone",
        "channel": "1",
        "probability": 0.99,
        "parameters": {"overlap_positive": overlap},
    }
    true = {"overlap_positive": {"value": 7e-5}}
    hidden = [{"name": name, "channel": "1", "parameters": true} for name in ("<b>", "dead_zone")]
    finding = {"hidden": hidden, "verdict": "effects", "effects": [found], "picture": ""}
    shown = {**paper, "picture": "1", "links": []}
    return demo.page(shown, board, finding, {"all": 1.0})


def test_the_page_explains_its_terms_and_needs_no_network(page: str) -> None:
    text = html.unescape(re.sub(r"<[^>]*>", "", page)).lower()
    terms = ("peak synchronisation error", "mean absolute tracking error", "interquartile mean", "pareto front", "held-out log",
             "placebo", "privileged information", "probability", "calibrated")  # fmt: skip
    for term in terms:
        assert f"<dt>{term}</dt>" in page.lower() and text.count(term) > 1, term
    assert 'href="benchmark/scores.html"' in page and "5 of 8 rows" in page
    assert "hidden in them (&lt;b&gt; on channel 1, dead_zone on channel 1)" in page
    cells = re.findall(r"<td[^>]*>([^<]*)</td>", page)
    assert cells[-5:] == ["dead_zone.overlap_positive", "70", "71", "69 to 72", "µm"]
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", page) and "@import" not in page


def test_the_drawing_names_the_parts_of_the_rig(page: str) -> None:
    drawing = page.partition('<svg class="rig"')[2].partition("</svg>")[0]
    for part in (
        "supply",
        "valve 1",
        "valve 2",
        "motor 1",
        "motor 2",
        "load",
        "controller",
        "set-point",
        "n",
        "p",
        "i",
    ):
        assert f">{part}</text>" in drawing, part
    ids = re.findall(r'id="(\w+)"', page)
    assert set(re.findall(r'href="#(\w+)"', drawing)) <= set(ids)


@needs_browser
@pytest.mark.parametrize("still", [False, True])
def test_the_animation_runs_unless_motion_is_unwanted(page: str, tmp_path: Path, still: bool) -> None:
    (tmp_path / "index.html").write_text(page)
    options = ["--force-prefers-reduced-motion"] if still else []
    seen = shown(tmp_path / "index.html", tmp_path / "profile", *options)
    assert re.search(rf'id="play"[^>]*>{"Play" if still else "Pause"}<', seen)
    assert (
        re.findall(r'aria-label="both shafts, their speeds and commands with (\w+)', seen)[0] == "pid_paper"
    )
    differences = [int(number) for number in re.findall(r'class="number">(-?\d+) rpm<', seen)]
    assert len(differences) == 2
    data = json.JSONDecoder().raw_decode(page.partition("const D = ")[2])[0]
    first = [a - b for a, b in zip(*data["runs"][0]["speed_rpm"], strict=True)]
    row = int(re.search(r'id="at"[^>]*max="(\d+)"', seen)[1]) + 1  # type: ignore[index]
    assert row == len(first)
    if still:
        peak = max(range(row), key=lambda n: abs(first[n]))
        assert differences[0] == first[peak] and f"{peak * data['period_s']:.2f} s" in seen

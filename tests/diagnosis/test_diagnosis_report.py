"""The report's words: units of the bench, shares of the command, what is left, and about twenty lines for a terminal."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer.main

from hydro_env.cli import app
from hydro_env.diagnosis import Diagnosis, diagnose
from hydro_env.diagnosis.estimation.unknowns import base_unknown
from hydro_env.diagnosis.report import wording as words
from hydro_env.diagnosis.report.page import report_page
from hydro_env.diagnosis.report.statements import comment, remaining, sentence
from hydro_env.diagnosis.stages.naming import UNKNOWN
from hydro_env.diagnosis.stages.validation import Proofs
from hydro_env.diagnosis.stages.values import Interval, KnownParameter
from hydro_env.plant import CATALOGUE, PARAMETERS, load_model


@pytest.mark.parametrize(
    ("value", "low", "high", "unit", "text"),
    [
        (4.7e-5, 4.02e-5, 5.37e-5, "m", "47.0 um (40.2 to 53.7)"),
        (1.14e-4, 1.1391e-4, 1.1409e-4, "m", "114.0 um (113.9 to 114.1)"),
        (0.0, -2e-3, 2e-3, "m", "0 mm (-2.00 to 2.00)"),
        (0.0125, 0.012, 0.013, "s", "12.5 ms (12.0 to 13.0)"),
        (1.5e7, 1.4e7, float("inf"), "Pa", "150 bar (140 to none)"),
        (0.85, 0.8, 0.9, "1", "0.850 (0.800 to 0.900)"),
        (3.2e-11, 3e-11, 3.4e-11, "m3/(s Pa)", "3.2e-11 m3/(s Pa) (3e-11 to 3.4e-11)"),
    ],
)
def test_values_are_told_in_units_of_the_bench(
    value: float, low: float, high: float, unit: str, text: str
) -> None:
    assert words.interval(Interval(value, low, high, unit)) == text


def test_spool_positions_and_forces_are_shares_of_the_command() -> None:
    model = load_model("paper")
    full = model.value("alpha", 0) * model.value("u_rated", 0) / model.value("R", 0)
    overlap = 0.1 * full / model.value("k", 0)
    said = words.of_command("dead_zone", "overlap_positive", overlap, model, 0)
    assert said == "7.30 V, 10 % of full command"
    said = words.of_command("magnetic_hysteresis", "amplitude", 0.05 * full, model, 0)
    assert said == "3.65 V, 5 % of full command"
    assert words.of_command("input_hysteresis", "width", 3.65, model, 0) == "5 % of full command"
    assert words.of_command("sensor_gain", "gain", 1.1, model, 0) == ""


def test_every_effect_has_a_name_in_words() -> None:
    for name, effect in CATALOGUE.items():
        if not getattr(effect, "family", ""):
            assert words.title(name) != words.plain(name) or name == "magnetic_hysteresis", name


def _log(path: Path, overlap: float, seed: int) -> Path:
    """20 s of one motor at 100 Hz behind a valve with a dead zone of `overlap` V."""
    rng = np.random.default_rng(seed)
    time = np.arange(2000) * 0.01
    command = (
        25 * np.sin(0.7 * time) + 18 * np.sin(1.7 * time + seed) + 6 * np.repeat(rng.uniform(-1, 1, 20), 100)
    )
    command[:100] = 0.0
    speed, state = np.empty(2000), 0.0
    for n, target in enumerate(12.0 * (command - np.clip(command, -overlap, overlap))):
        speed[n] = state
        state += (target - state) * (1.0 - np.exp(-0.01 / 0.1))
    rows = np.column_stack([time, command, speed + rng.normal(size=2000)])
    np.savetxt(path, rows, delimiter=",", header="time_s,command_1_V,speed_1_rpm", comments="", fmt="%.5f")
    return path


@pytest.fixture(scope="module")
def found(tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    folder = tmp_path_factory.mktemp("report")
    return diagnose([_log(folder / "fit.csv", 6.0, 1)], [_log(folder / "sealed.csv", 6.0, 2)], steady=True)


def _proofs(found: Diagnosis, **changes: Any) -> Proofs:
    return dataclasses.replace(found.proofs, **changes)


def _page(found: Diagnosis) -> str:
    return report_page(found)


def test_the_terminal_says_it_all_in_about_twenty_lines(found: Diagnosis) -> None:
    text = found.summary()
    lines = text.splitlines()
    assert len(lines) <= 20
    assert lines[0] == "verdict: effects"
    assert "spool overlap (dead zone) on channel 1" in lines[1] and "the noise is" in lines[1]
    for word in (
        "% of full command",
        "where:",
        "placebo",
        "rejected",
        "known parameters",
        "medium size",
        "warning:",
    ):
        assert word in text, word


def test_what_is_left_above_the_noise_makes_a_name_a_guess(
    found: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    proof = found.proofs.held_out

    def leaving(times: float) -> Diagnosis:
        noise = proof.errors[0, "speed"]["noise"]
        errors = {
            (0, "speed"): {**proof.errors[0, "speed"], "after": times * noise, "calibrated": 10.0 * noise}
        }
        judged = dataclasses.replace(proof, errors=errors)
        return dataclasses.replace(found, proofs=_proofs(found, held_out=judged, judged=judged))

    assert not leaving(4.0).best_guess  # a reduced model leaves out more than noise
    monkeypatch.setattr(found.rig, "has_hidden_states", True)
    monkeypatch.setattr(proof.rig, "has_hidden_states", True)
    assert not leaving(1.4).best_guess and leaving(1.4).summary().startswith("verdict: effects\n")
    guess = leaving(4.0)
    lines = guess.summary().splitlines()
    assert lines[0] == "verdict: effects (best guess, not proven)" and "The model lacks" not in lines[1]
    assert "explains 85 % of the power" in lines[1] and "leaves 4 times the noise" in lines[1]
    page = _page(guess)
    assert "best guess, not proven" in page and "not as an answer" in page
    assert guess.as_dict()["best_guess"] is True


def test_a_crowded_summary_stays_within_twenty_lines(found: Diagnosis) -> None:
    proof = found.proofs.held_out
    signals = ((0, "speed"), (0, "current"), (0, "pressure"), (1, "speed"), (1, "current"), (1, "flow"))
    crowded = dataclasses.replace(
        found, warnings=[f"w{n}" for n in range(7)], effects=4 * found.effects,
        proofs=_proofs(
            found, held_out=dataclasses.replace(proof, errors=dict.fromkeys(signals, proof.errors[0, "speed"]))
        ),
    )  # fmt: skip
    lines = crowded.summary().splitlines()
    assert len(lines) <= 20 and "warning: w0" in crowded.summary() and " more in the report" in lines[-1]


def test_the_page_has_every_part_and_needs_no_network(found: Diagnosis) -> None:
    page = _page(found)
    for heading in (
        "What the model lacks", "Where the calibrated model errs", "Validation on held-out logs", "Next experiment", "Warnings",
        "why they were rejected", "Known parameters", "Which effects these logs can show",
    ):  # fmt: skip
        assert heading in page, heading
    assert page.count("<svg") >= 2
    assert not re.search(r"(src|href)=[\"']?(https?:)?//", page)
    assert "noise, 2 standard deviations" in page


def test_the_title_names_logs_model_and_day(found: Diagnosis) -> None:
    page = _page(found)
    assert re.search(r"<title>Diagnosis of fit\.csv, model paper, \d{4}-\d\d-\d\d</title>", page)
    assert "Fitted: fit.csv. Held out: sealed.csv." in page.partition("</p>")[0]


def test_a_probability_stands_beside_what_remains(found: Diagnosis) -> None:
    named, entry = found.effects[0], found.proofs.held_out.errors[0, "speed"]
    text = remaining(found, named)
    assert (
        f"{entry['after']:.3g} of {entry['calibrated']:.3g} rpm on channel 1 (noise {entry['noise']:.3g})"
        == text
    )
    page = _page(found)
    assert f"Probability {named.probability:.2f}.</strong> Remains: {text}" in page
    assert page.count("</em>: how likely these logs make it") == 1


def _commands(page: str) -> list[list[str]]:
    blocks = re.findall(r"<pre>(.*?)</pre>", page, flags=re.S)
    return [
        line.split()[1:] for block in blocks for line in block.splitlines() if line.startswith("hydro-env")
    ]


def test_what_to_do_next_are_commands_that_exist(found: Diagnosis) -> None:
    """A steady model is for logs only; one with dynamics can be driven."""
    rig = found.rig.view(has_hidden_states=True)
    fit = dataclasses.replace(found.logs.fit, rig=rig)
    driven = dataclasses.replace(found, logs=dataclasses.replace(found.logs, fit=fit))
    steady, dynamic = _commands(_page(found)), _commands(_page(driven))
    assert [words[0] for words in steady] == ["diagnose"] and "--steady" in steady[0]
    assert [words[0] for words in dynamic] == ["diagnose", "benchmark", "tune"]
    known = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    for name, *rest in steady + dynamic:
        options = {option for parameter in known[name].params for option in parameter.opts}
        assert "model.yaml" in rest and {each for each in rest if each.startswith("--")} <= options


@pytest.mark.parametrize(
    ("verdict", "said", "model"),
    [
        ("none", "The model explains these logs", "is the model as given"),
        ("calibration", "Use the calibrated values", "the values of the known parameters below"),
        ("effects", "Check the named effects on the rig", "the named effects and the values"),
        ("unknown", "Record the next experiment", "the named effects and the values"),
    ],
)
def test_every_verdict_says_what_to_do(found: Diagnosis, verdict: str, said: str, model: str) -> None:
    effects = found.effects if verdict in ("effects", "unknown") else []
    page = _page(dataclasses.replace(found, verdict=verdict, effects=effects))
    after = page.partition("<h2>What to do next</h2>")[2].partition("<h2>")[0]
    assert said in after and model in after and f"Verdict: {verdict}." in page
    assert ("What the model lacks" in page) == bool(effects)


@pytest.mark.parametrize(
    ("symbol", "factor", "sure", "said"),
    [
        ("J", 1.63, True, "moved by +63 %, more than the -26 to +35 %"),
        ("J", 0.5, True, "moved by -50 %"),
        ("J", 1.2, True, ""),
        ("J", 1.63, False, ""),
        ("D", 1.08, True, "moved by +8 %, more than the -5 to +5 %"),
        ("lag", 7.76, True, "not given: estimated from these logs alone"),
    ],
)
def test_a_known_parameter_that_moved_far_has_a_comment(
    found: Diagnosis, symbol: str, factor: float, sure: bool, said: str
) -> None:
    described = {**PARAMETERS, **found.rig.own}[symbol]
    given, unknown = described.nominal, base_unknown(described, described.nominal)
    value, width = factor * given, 0.01 if sure else 1.0
    estimate = Interval(value, value * (1 - width), value * (1 + width), described.unit)
    text = comment(
        found.rig, KnownParameter(symbol, 0, given, estimate, (unknown.value(-1.0), unknown.value(1.0)))
    )
    assert text.startswith(said) if said else text == ""


def test_the_terminal_names_known_parameters_to_check(
    found: Diagnosis, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [
        KnownParameter("J", 0, 1.0, Interval(value, value - 0.01, value + 0.01, "kg m2"), (0.74, 1.35))
        for value in (1.63, 1.2)
    ]
    rows[1] = dataclasses.replace(rows[1], symbol="Kq")
    monkeypatch.setattr(Diagnosis, "known", rows)
    assert found.model.name  # made with the parameters that the rig has, and kept
    monkeypatch.setattr(found.rig, "own", {})
    assert "J_1 +63 %, Kq_1 +20 %; check J_1: further than usual" in found.summary()


def test_an_unlikely_name_is_put_as_a_perhaps(found: Diagnosis) -> None:
    shares = {"directional_gain": 0.3, "flow_saturation": 0.3, UNKNOWN: 0.4}
    extra = dataclasses.replace(found.effects[0], name="directional_gain", shares=shares)
    text = sentence(dataclasses.replace(found, effects=[*found.effects, extra]))
    assert (
        "Perhaps also different flow gains" in text
        and "(or saturation of the flow: these logs cannot distinguish them)" in text
    )

"""The methods beside the diagnosis in the naming benchmark: what they find in made-up errors, and refusals."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from docs.evidence.naming_methods import __main__ as command
from docs.evidence.naming_methods.by_terms import certified_terms, chosen_by_regression, false_discovery
from docs.evidence.naming_methods.correction import fit_network, fit_polynomial
from docs.evidence.naming_methods.equations import Equation


def made_up(terms: int = 6) -> list[Equation]:
    """Two logs whose error is three times the third term, in noise of size one."""
    rng, found = np.random.default_rng(0), []
    for log in (0, 1):
        own = {(f"effect_{k}", "size"): rng.normal(size=2000) for k in range(terms)}
        error = 3.0 * own["effect_2", "size"] + rng.normal(size=2000)
        found.append(Equation("line", log, error, rng.uniform(-1.0, 1.0, 2000), own))
    return found


def test_certification_finds_the_term_and_nothing_in_noise() -> None:
    p, _, name = max(certified_terms(made_up()), key=lambda t: t[1])
    assert name == "effect_2" and p < 1e-6
    assert false_discovery([0.6, 0.2, 0.04], 0.05) == -1.0
    assert false_discovery([0.6, 0.03, 0.01], 0.05) == 0.03


def test_sparse_regression_finds_the_term() -> None:
    pytest.importorskip("pysindy")
    assert chosen_by_regression(made_up()) == {"effect_2": pytest.approx(1.0)}


def test_the_network_learns_a_curve() -> None:
    x = np.linspace(-1.0, 1.0, 300)[:, None]
    found = fit_network(x, np.abs(x[:, 0]))
    assert np.sqrt(np.mean((found(x) - np.abs(x[:, 0])) ** 2)) < 0.05


def test_the_polynomial_is_sparse_and_right() -> None:
    pytest.importorskip("pysindy")
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (300, 2))
    found = fit_polynomial(x, x[:, 0] * x[:, 1] ** 2)
    assert found(np.array([0.5, -0.4])) == pytest.approx(0.08, rel=0.02)


def refused(words: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    monkeypatch.setattr(sys, "argv", ["naming_methods", *words])
    with pytest.raises(SystemExit) as end:
        command.run_command(command.main)
    text = capsys.readouterr().err
    assert end.value.code == 2 and text.count("\n") == 1
    return text


def test_bad_input_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    where = ["--set", str(tmp_path / "none"), "--out", str(tmp_path / "out")]
    text = refused(["diagnose", *where], monkeypatch, capsys)
    assert text.endswith(
        "'diagnose': known are sindy, polynomial, certify, network, ask_random, ask_d_optimal, all\n"
    )
    assert "set.json" in refused(["certify", *where], monkeypatch, capsys)
    monkeypatch.setattr(command, "find_spec", lambda name: None)
    assert "'.[naming]'" in refused(["all", *where], monkeypatch, capsys)
    assert not (tmp_path / "out").exists()

"""Calibration alone: values of a rig whose base parameters are wrong, within their intervals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis import estimate
from hydro_env.errors import InputError
from hydro_env.plant import load_model
from hydro_env.practice.generate import Practice, make_practice


@pytest.fixture(scope="module")
def practice(tmp_path_factory: pytest.TempPathFactory) -> tuple[Practice, Path]:
    folder = tmp_path_factory.mktemp("practice")
    made = make_practice([], base_error=0.1, duration=6.0, rate=500.0, seed=7, runs=("fit_1",))
    made.write(folder)
    return made, folder / "fit_1.csv"


def test_base_parameters_are_found_within_their_intervals(
    practice: tuple[Practice, Path], tmp_path: Path
) -> None:
    made, log = practice
    found = estimate([log])
    assert set(found.parameters) == set(found.as_dict()["calibrated"]) and not found.warnings
    true = {name: made.true.value(p.symbol, p.channel) for name, p in found.parameters.items()}
    inside = [p.estimate.low <= true[name] <= p.estimate.high for name, p in found.parameters.items()]
    assert np.mean(inside) >= 0.85  # of 95 % intervals
    for name, p in found.parameters.items():
        assert p.estimate.low <= p.estimate.value <= p.estimate.high, name
    for left in found.residuals.values():
        assert left.after < 1.05 * left.noise and left.before > left.after
    speed = found.residuals["speed_1_rpm"]
    assert np.sqrt(np.nanmean(speed.error[0] ** 2)) == pytest.approx(speed.after)
    assert speed.time_s[0].shape == speed.error[0].shape
    found.model.to_yaml(tmp_path / "model.yaml", source="calibration of a log")
    again = load_model(tmp_path / "model.yaml")
    assert again.value("J", 0) == pytest.approx(found.parameters["J_1"].estimate.value)


def test_chosen_parameters_keep_to_their_bounds_and_the_others_as_given(
    practice: tuple[Practice, Path],
) -> None:
    _, log = practice
    given = load_model("paper").value("J", 0)
    found = estimate([log], parameters={"Kq": None, "J": (0.99 * given, 1.01 * given)})
    assert set(found.parameters) == {"J_1", "Kq_1", "J_2", "Kq_2"}
    assert 0.989 * given < found.parameters["J_1"].estimate.value < 1.011 * given
    assert found.model.pair("R") == load_model("paper").pair("R")
    bare = estimate([log], parameters=[])
    assert not bare.parameters and bare.residuals["speed_1_rpm"].after == bare.residuals["speed_1_rpm"].before
    assert any("diagnose" in text for text in bare.warnings)


@pytest.mark.parametrize(
    ("parameters", "said"),
    [
        (["inertia"], "unknown parameter 'inertia'"),
        ({"J": (1.0, 2.0)}, "no positive bounds around"),
        ({"Kq": (0.0, 1.0)}, "no positive bounds around"),
    ],
)
def test_parameters_that_cannot_be_estimated_are_said(
    practice: tuple[Practice, Path], parameters: object, said: str
) -> None:
    with pytest.raises(InputError, match=said):
        estimate([practice[1]], parameters=parameters)  # type: ignore[arg-type]

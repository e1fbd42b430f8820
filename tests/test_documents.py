"""Claims of the documents that no command prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from hydro_env.experiments.paper_rig import SETPOINT_STEPS, run_paper
from hydro_env.plant import load_model

PLANT = (Path(__file__).parent.parent / "docs" / "plant.md").read_text(encoding="utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["paper", "paper_dead_zone"])
def test_the_volume_hardly_matters(name: str) -> None:
    volumes = {"V": [[1e-4, 1e-4], [1e-3, 1e-3]]}
    peaks = run_paper(load_model(name), SETPOINT_STEPS, values=volumes, num_rigs=2).peak
    said = re.search(rf"from ([\d.]+) to ([\d.]+) rpm on `{name}`", PLANT)
    assert said is not None
    assert [round(peak, 1) for peak in peaks] == [float(number) for number in said.groups()]


def test_the_printed_readings_of_kq_agree() -> None:
    """At 730 mA the spool stands at 0.86 mm, which gives 24.5 l/min on V1."""
    model = load_model("paper")
    spool = model.value("alpha", 0) * 0.73 / model.value("k", 0)
    assert round(spool * 1e3, 2) == 0.86
    assert round(model.value("Kq", 0) * spool * 60e3, 1) == 24.5

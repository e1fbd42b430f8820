"""Logs of a healthy rig whose rows are unevenly spaced, or some of them spikes: what counts is explained to its noise."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.estimate import Estimate
from hydro_env.diagnosis.input.parts import read_parts
from hydro_env.diagnosis.models.base import Request
from hydro_env.diagnosis.models.dynamic_rig import DynamicRig
from hydro_env.diagnosis.stages.row_times import settled, without_outliers
from hydro_env.plant import load_model, simulate
from hydro_env.practice.generate import make_practice
from hydro_env.units import BAR, RPM

#: Of the rows that count: an error is the noise if it is below so many times that.
AT_NOISE = 1.15
NOISE = {"speed": RPM, "pressure": 0.05 * BAR, "current": 0.002}


def _recorded(
    folder: Path, rate: int, *, missing: float = 0.0, jitter: float = 0.0, acts: str = "since the row",
    stamps: float = 0.0, spikes: float = 0.0, height: float = 400.0,
) -> Path:  # fmt: skip
    """12 s of the model at rows that are missing or jitter (shares of a step). Commands act since the row that shows them, or at
    once; `stamps`: only the time stamps jitter."""
    rng, fine = np.random.default_rng(11), 5000
    rows = np.arange(0, 12 * fine, fine // rate)
    rows = rows[rng.random(len(rows)) >= missing]
    rows = np.unique(np.round(rows + jitter * fine / rate * rng.uniform(-1.0, 1.0, len(rows))).astype(int))
    rows = rows[(rows >= 0) & (rows < 12 * fine)]
    steps = np.repeat(rng.uniform(-50.0, 50.0, (24, 2)), fine // 2, axis=0)
    steps[: fine // 10] = 0.0
    if acts == "since the row":
        at = np.searchsorted(rows, np.arange(12 * fine), side="right") - 1
        steps = steps[rows[np.maximum(at, 0)]]
    seen = simulate("paper", steps, None, 1.0 / fine, record=("speed", "pressure", "current"))
    time = rows / fine
    time[1:] += stamps / rate * rng.uniform(-1.0, 1.0, len(rows) - 1)
    columns = {"time_s": time}
    for c in (0, 1):
        columns[f"command_{c + 1}_V"] = steps[rows, c]
        for signal, unit, size in (("speed", "rpm", RPM), ("pressure", "bar", BAR), ("current", "A", 1.0)):
            noise = NOISE[signal] * rng.normal(size=len(rows))
            columns[f"{signal}_{c + 1}_{unit}"] = (seen[signal][rows, 0, c] + noise) / size
        wrong = rng.random(len(rows)) < spikes
        columns[f"speed_{c + 1}_rpm"] += wrong * height * rng.uniform(0.55, 1.5, len(rows))
    path = folder / "log.csv"
    np.savetxt(
        path, np.column_stack(list(columns.values())), "%.9g", ",", header=",".join(columns), comments=""
    )
    return path


@pytest.mark.parametrize(
    ("rate", "how", "least"),
    [
        (1000, {"missing": 0.05}, 0.7),
        (100, {"missing": 0.05}, 0.2),
        (1000, {"jitter": 0.3}, 0.95),
        (100, {"jitter": 0.3}, 0.95),
        (1000, {"jitter": 0.3, "acts": "at once"}, 0.1),
        (1000, {"stamps": 0.2}, 0.95),
    ],
)
def test_what_counts_of_a_healthy_rig_is_explained_to_its_noise(
    tmp_path: Path, rate: int, how: dict[str, float], least: float
) -> None:
    model = load_model("paper")
    parts = read_parts([_recorded(tmp_path, rate, **how)], None)  # type: ignore[arg-type]
    parts = settled(DynamicRig(model, parts), parts)
    rig = DynamicRig(model, parts).with_parts(parts, True)
    shown = rig.predict([Request(c, {}) for c in (0, 1)])
    for c in (0, 1):
        for s in rig.segments[c]:
            error = s.error(shown[c][c])[s.used]
            assert np.sqrt(np.mean(error**2)) < AT_NOISE * NOISE[s.signal], (s.signal, c)
            assert s.used.mean() > least, (s.signal, c)


def test_line_pressures_may_have_missing_rows(tmp_path: Path) -> None:
    make_practice([], record=["line_pressures"], duration=4.0, rate=500.0, runs=("fit_1",)).write(tmp_path)
    head, *rows = (tmp_path / "fit_1.csv").read_text().splitlines()
    (tmp_path / "log.csv").write_text(
        "\n".join([head, *(row for n, row in enumerate(rows) if n % 11)]) + "\n"
    )
    parts = read_parts([tmp_path / "log.csv"], None)
    (part,) = settled(DynamicRig(load_model("paper"), parts), parts)
    assert part.uneven is not None and part.log.has("mean_line_pressure", 0)


@pytest.mark.parametrize("rate", [100, 1000])
@pytest.mark.parametrize("height", [30.0, 400.0])
def test_spikes_stand_out_of_the_calibrated_model(tmp_path: Path, rate: int, height: float) -> None:
    """One row in a hundred that is off by 2 to 5 % of the swing of the speed, or by more than ten times that."""
    path = _recorded(tmp_path, rate, spikes=0.01, height=height)
    rig = DynamicRig(load_model("paper"), read_parts([path], None)).with_parts(read_parts([path], None), True)
    better, found = without_outliers(rig, {c: Estimate(c, [], np.zeros(0)) for c in (0, 1)})
    assert all("rows of the speed of channel" in f.text for f in found)
    shown = rig.predict([Request(c, {}) for c in (0, 1)])
    for c in (0, 1):
        for before, s in zip(rig.segments[c], better.segments[c], strict=True):
            error = s.error(shown[c][c])[s.used]
            assert np.sqrt(np.mean(error**2)) < AT_NOISE * NOISE[s.signal], (s.signal, c)
            assert s.used.mean() > 0.98 and (s is before or s.signal == "speed")

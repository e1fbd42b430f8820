"""Where a free simulation runs apart, what is named is fitted to one that follows the measured speed."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from hydro_env.diagnosis.estimation.gauss_newton import solve
from hydro_env.diagnosis.logs import Logs
from hydro_env.diagnosis.models.base import Request, Segments
from hydro_env.diagnosis.stages import running_apart
from hydro_env.diagnosis.stages.candidates import Accepted, Correction, Selection
from hydro_env.diagnosis.stages.form_correction import Models
from tests.linear_rig import LinearRig, logged, time_of

ROWS, NAME = 4000, "load_bias"
SIZE, CURVE = f"{NAME}.bias", np.sin(60.0 * time_of(ROWS))


@dataclass
class Apart(LinearRig):
    """A rig whose free simulations have `drift` (n,) more, and those that follow the measured speed `left` times as much."""

    drift: np.ndarray = field(default_factory=lambda: 0.3 * CURVE + 0.1 * np.sin(7.0 * time_of(ROWS)))
    left: float = 0.0
    followed: frozenset[int] = frozenset()

    def predict(self, requests: Sequence[Request]) -> list[dict[int, np.ndarray]]:
        more = self.drift * (self.left if self.followed else 1.0)
        return [{0: found[0] + more} for found in super().predict(requests)]

    def following(self, channels: Collection[int]) -> Apart:
        return replace(self, followed=frozenset(channels))


def _models(left: float, signal: str = "pressure") -> tuple[Selection, Models]:
    """A load that is named, as a fit to free simulations of a `signal` finds it, beside a correction of the other channel."""
    fit, base = logged({SIZE: CURVE}, {SIZE: 0.2}, ROWS)
    segments = {0: Segments([replace(s, signal=signal) for s in fit.rig.segments[0]])}
    rig = Apart(fit.rig.curves, fit.rig.time, segments=segments, left=left)  # type: ignore[attr-defined]
    fit = replace(fit, rig=rig, noise={(0, signal): fit.noise[0, "speed"]})  # type: ignore[arg-type]
    named = base.with_effect(NAME, {"bias": 0.1}, 0)
    solve(fit, [named], 8)
    other = Correction("dead_zone", 1, "edge_form", named, 30.0)
    selection = Selection(
        Logs(fit, fit.rig, fit.rig), {0: base}, {0: named}, [Accepted(NAME, 0, 500.0, 30.0)], [], {}
    )
    return selection, Models({0: base}, {0: base}, {0: named}, {0: named}, {}, [other])


def test_what_is_named_is_fitted_to_simulations_that_stay_beside_the_rig() -> None:
    selection, models = _models(left=0.0)
    assert models.final[0].values(0)[SIZE] == pytest.approx(-0.1, abs=0.01)
    found = running_apart.run(selection, "effects", models)
    assert found.followed == {0} and found.fitted_to(selection.logs).rig.followed == {0}
    assert found.final[0].values(0)[SIZE] == pytest.approx(0.2, abs=0.01)
    assert found.named[0] is found.final[0] and found.corrections == models.corrections
    assert selection.estimates[0] is models.named[0]  # names were compared by free simulations


@pytest.mark.parametrize(
    ("left", "verdict", "signal"),
    [(0.8, "effects", "pressure"), (0.0, "unknown", "pressure"), (0.0, "effects", "speed")],
)
def test_what_explains_the_logs_no_better_then_is_left_as_it_is(
    left: float, verdict: str, signal: str
) -> None:
    """A speed that is followed says nothing."""
    selection, models = _models(left, signal)
    assert running_apart.run(selection, verdict, models) is models
    assert models.fitted_to(selection.logs) is selection.logs

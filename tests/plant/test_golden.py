"""The plant still gives the stored trajectories, with every effect."""

from __future__ import annotations

import json

import numpy as np

from tests import golden


def test_golden_trajectories() -> None:
    stored = json.loads(golden.PATH.read_text(encoding="utf-8"))
    assert {*stored["rows"]} == {"base", *golden.BUILT_IN}, (
        "the catalogue has other effects than the file: run `python -m tests.golden` and look at the difference"
    )
    found = golden.trajectories()
    for signal, values in found.items():
        scale = np.abs(values).max()
        for n, name in enumerate(("base", *golden.BUILT_IN)):
            error = np.abs(values[:, n] - np.array(stored["rows"][name][signal])).max()
            assert error <= 1e-6 * scale, f"{name}: {signal} is off by {error:.3g} (scale {scale:.3g})"

"""What the paper's published numbers can and cannot tell."""

import numpy as np
import pytest

from docs.evidence.paper_gap import Answer, _crossing, _values, table
from hydro_env.plant import CATALOGUE


def test_sizes_go_from_nothing_to_the_end_of_the_plausible_range() -> None:
    dead_zone = CATALOGUE["dead_zone"]
    assert _values(dead_zone, 0.0, 1) == {"overlap_positive": 0.0, "overlap_negative": 0.0}
    assert _values(dead_zone, 1.0, 1) == pytest.approx(
        {"overlap_positive": 4.5e-4, "overlap_negative": 4.5e-4}
    )
    assert _values(dead_zone, 0.5, -1) is None
    limit = CATALOGUE["driver_saturation"].parameters[0]
    assert _values(CATALOGUE["driver_saturation"], 1.0, 1) == pytest.approx({"voltage_limit": limit.low})


def test_the_size_is_read_where_the_published_difference_is_first_passed() -> None:
    shares, peaks = np.array([0.0, 0.1, 0.2, 0.5]), np.array([13.0, 75.0, 275.0, 100.0])
    found = _crossing(CATALOGUE["load_bias"], 1, shares, peaks)
    assert found == {"bias": pytest.approx(0.15 * 3.0)}
    assert _crossing(CATALOGUE["load_bias"], 1, shares, peaks / 10.0) is None


def test_the_table_says_what_stays_open() -> None:
    rows = [
        Answer(name, 1, 400.0, {"size": 1.0}, 175.0, 0.9, current, True, False)
        for name, current in (("dead_zone", 0.08), ("spring_preload", 0.04))
    ]
    text = table(rows)
    assert "cannot tell these apart" in text and "no single effect of V1 alone meets both figures" in text

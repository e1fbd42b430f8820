"""Streams of many rows give the numbers of NumPy's own generators."""

import numpy as np
import pytest

from hydro_env.streams import FEW, NormalNumbers, Streams

SEEDS = [0, 1, 7, 2**31, 2**32 - 1, 2**32, 2**63, 2**64 - 1]


def numpys(seeds, key):
    return [
        np.random.Generator(np.random.PCG64(np.random.SeedSequence([5, s], spawn_key=key))) for s in seeds
    ]


def ours(seeds, key):
    return Streams.seeded([[5] * len(seeds), seeds], [[each] * len(seeds) for each in key])


@pytest.mark.parametrize("seeds", [SEEDS, SEEDS[:FEW], [*SEEDS, 2**64, 2**128 - 1]])
def test_numbers_are_numpys(seeds):
    streams, generators = ours(seeds, (3, 2)), numpys(seeds, (3, 2))
    np.testing.assert_array_equal(streams.random((4, 5)), [g.random((4, 5)) for g in generators])
    rows = np.array([1, 3])
    np.testing.assert_array_equal(streams.random(3, rows), [generators[i].random(3) for i in rows])
    for row, generator in enumerate(generators):
        assert streams.generator(row).random() == generator.random()


@pytest.mark.parametrize("seeds", [SEEDS, SEEDS[:FEW]])
def test_normal_numbers_are_numpys(seeds):
    generators, rows = numpys(seeds, (0, 1)), np.arange(len(seeds))
    # Enough for the tail beyond the ziggurat, and an odd number of 32-bit words between two calls.
    found = NormalNumbers(len(seeds), 20_001)
    found.begin(rows, ours(seeds, (0, 1)))
    found.draw(rows)
    np.testing.assert_array_equal(
        found.numbers, [g.standard_normal(20_001, dtype=np.float32) for g in generators]
    )
    assert np.abs(found.numbers).max() > 3.66
    found.draw(rows[1:3])
    np.testing.assert_array_equal(
        found.numbers[1:3], [g.standard_normal(20_001, dtype=np.float32) for g in generators[1:3]]
    )
    found.begin(rows[:1], ours([99], (0,)))
    found.draw(rows[:2])
    again = numpys([99], (0,))[0].standard_normal(20_001, dtype=np.float32)
    np.testing.assert_array_equal(found.numbers[0], again)
    np.testing.assert_array_equal(found.numbers[1], generators[1].standard_normal(20_001, dtype=np.float32))

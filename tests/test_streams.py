"""Streams have the words of NumPy's Philox, whatever else is drawn; normal numbers are normal."""

import numpy as np
import pytest
from scipy import stats

from hydro_env.streams import Component, Streams, block, normal

SEEDS = [0, 1, 7, 2**31, 2**32, 2**63, 2**64 - 1, 2**64, 2**128 - 1]
EPISODES = [0, 1, 2, 3, 2**32, 5, 6, 2**62, 8]


def numpys(component, seed, episode, entropy=0):
    return np.random.Philox(key=seed, counter=component << 56 | episode << 64 | entropy << 128)


def uniform(words):
    return (np.asarray(words) >> np.uint64(11)) * 2.0**-53


@pytest.mark.parametrize("component", Component)
@pytest.mark.parametrize("entropy", [0, 2003, 2**128 - 1])
def test_words_are_those_of_numpys_philox(component, entropy):
    streams = Streams(component, SEEDS, EPISODES, entropy)
    theirs = [numpys(component, s, e, entropy) for s, e in zip(SEEDS, EPISODES, strict=True)]
    first = uniform([each.random_raw(20) for each in theirs]).reshape(-1, 4, 5)
    np.testing.assert_array_equal(streams.random((4, 5)), first)
    rows = np.array([1, 3])
    np.testing.assert_array_equal(
        streams.random(3, rows), uniform([theirs[i].random_raw(4)[:3] for i in rows])
    )
    np.testing.assert_array_equal(streams.random(3), uniform([each.random_raw(4)[:3] for each in theirs]))
    for row, each in enumerate(theirs):
        assert streams.generator(row).random() == np.random.Generator(each).random()


KNOWN = [  # counter, key, words: philox4x64 of ten rounds in kat_vectors of the authors' Random123
    ([0] * 4, [0] * 2, [0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B]),
    (
        [2**64 - 1] * 4, [2**64 - 1] * 2,
        [0x87B092C3013FE90B, 0x438C3C67BE8D0224, 0x9CC7D7C69CD777B6, 0xA09CAEBF594F0BA0],
    ),
    (
        [0x243F6A8885A308D3, 0x13198A2E03707344, 0xA4093822299F31D0, 0x082EFA98EC4E6C89],
        [0x452821E638D01377, 0xBE5466CF34E90C6C],
        [0xA528F45403E61D95, 0x38C72DBD566E9788, 0xA5A1610E72FD18B5, 0x57BD43B5E52B7FE6],
    ),
]  # fmt: skip


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_published_vectors(counter, key, words):
    streams = Streams(Component.PAIR, [key[1] << 64 | key[0]], [0])
    streams.counters[:] = counter
    streams.counters[:, 0] -= np.uint64(1)  # a stream begins behind its counter
    np.testing.assert_array_equal(streams.random(4)[0], uniform(np.array(words, np.uint64)))


def noise(seed, episode, steps):
    stream = Streams(Component.NOISE, [seed], [episode])
    found = np.zeros((steps, 6))
    for step, row in enumerate(found):
        words = block(stream.keys[0], stream.counters[0], step + 1)
        row[:] = [normal(words, place) for place in range(6)]
    return found


def test_normal_numbers_have_their_place_in_a_stream():
    words = numpys(Component.NOISE, 2**40, 3).random_raw(4 * 2000).reshape(-1, 4)[:, :3]
    halves = np.stack([words & np.uint64(2**32 - 1), words >> np.uint64(32)], axis=2).reshape(-1, 6)
    wanted = stats.norm.ppf((halves + 0.5) / 2**32)
    np.testing.assert_allclose(noise(2**40, 3, 2000), wanted, rtol=3e-7, atol=1e-7)


def test_normal_numbers_are_normal_and_independent():
    numbers = noise(5, 0, 40_000)
    assert stats.kstest(numbers.ravel(), "norm").pvalue > 0.01
    assert np.abs(np.corrcoef(numbers.T) - np.eye(6)).max() < 0.02
    assert np.abs(np.corrcoef(numbers[1:].T, numbers[:-1].T)[:6, 6:]).max() < 0.02


def test_streams_of_components_episodes_and_seeds_are_independent():
    drawn = [
        Streams(component, [seed], [episode], entropy).random(500)[0]
        for component in Component
        for seed in (0, 1, 2**64)
        for episode in (0, 1)
        for entropy in (0, 1, 2**64)
    ]
    off = np.corrcoef(drawn) - np.eye(len(drawn))
    assert np.abs(off).max() < 5.0 / np.sqrt(500)

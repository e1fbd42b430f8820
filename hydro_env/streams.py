"""Random numbers by counter: a number depends on its stream and its place there alone.

So nothing is kept between the steps of an episode, and neither the number of rows nor threads nor their order change a number.
The generator is Philox4x64-10 (J. K. Salmon, M. A. Moraes, R. O. Dror, D. E. Shaw: Parallel random numbers: as easy as 1, 2, 3,
SC11). The stream of a component in an episode of a seed is, word for word, that of

    numpy.random.Philox(key=seed, counter=component << 56 | episode << 64 | entropy << 128)
"""

from collections.abc import Sequence
from enum import IntEnum
from functools import partial
from math import log, prod, sqrt

import numpy as np
from numpy.typing import ArrayLike

from .arrays import AnyArray, Floats, Integers
from .jit import compiled


class Component(IntEnum):
    """What draws from a stream of its own in each episode; `CASE` is a pair of valves in a fixed list, whatever the seed, `LEVEL`
    the size of the noise."""

    PAIR, NOISE, SCENARIO, ACTIONS, CASE, LEVEL = range(6)


class Streams:
    """A stream for each of N rows: `keys` (N, 2) and `counters` (N, 4), words of 64 bits, the lowest first."""

    def __init__(
        self, component: Component, seeds: Sequence[int], episodes: ArrayLike, entropy: int = 0
    ) -> None:
        """`seeds` and `episodes`, N each; seeds and entropy are below 2**128."""
        self.keys = _words(seeds)
        self.counters = np.empty((len(seeds), 4), np.uint64)
        self.counters[:, 0] = component << 56
        self.counters[:, 1] = episodes
        self.counters[:, 2:] = _words([entropy])

    def __len__(self) -> int:
        return len(self.keys)

    def random(self, shape: int | tuple[int, ...], rows: AnyArray | slice = slice(None)) -> Floats:
        """The next numbers in [0, 1) of some rows (indices or mask): (rows, *shape). The other rows stay where they are.

        What is left of the last four words is passed over.
        """
        shape = (shape,) if isinstance(shape, int) else shape
        chosen = np.arange(len(self))[rows]
        shares = np.empty((chosen.size, prod(shape)))
        _fill_uniform(self.keys, self.counters, chosen, shares)
        return shares.reshape(chosen.size, *shape)

    def generator(self, row: int) -> np.random.Generator:
        """NumPy's own generator where the stream of a row is now; it goes on by itself."""
        key, counter = (
            sum(word << 64 * n for n, word in enumerate(each[row].tolist()))
            for each in (self.keys, self.counters)
        )
        return np.random.Generator(np.random.Philox(key=key, counter=counter))


def _words(numbers: Sequence[int]) -> Integers:
    """Numbers as two words each, the lower one first."""
    return np.array([(n & 2**64 - 1, n >> 64) for n in numbers], np.uint64).reshape(-1, 2)


_compiled = partial(compiled, nogil=True)


@_compiled
def _product(a, b):
    """The higher and the lower word of a product."""
    half, lower = np.uint64(32), np.uint64(0xFFFFFFFF)
    a1, a0, b1, b0 = a >> half, a & lower, b >> half, b & lower
    one = a1 * b0 + (a0 * b0 >> half)
    two = a0 * b1 + (one & lower)
    return a1 * b1 + (one >> half) + (two >> half), a * b


@_compiled
def block(key, counter, number):
    """The four words in the place `number`, from 1 on, behind a counter."""
    w, x, y, z = counter[0] + np.uint64(number), counter[1], counter[2], counter[3]
    one, two = key[0], key[1]
    for _ in range(10):
        high, low = _product(np.uint64(0xD2E7470EE14C6C93), w)
        other, lower = _product(np.uint64(0xCA5A826395121157), y)
        w, x, y, z = other ^ x ^ one, lower, high ^ z ^ two, low
        one, two = one + np.uint64(0x9E3779B97F4A7C15), two + np.uint64(0xBB67AE8584CAA73B)
    return w, x, y, z


@_compiled
def _fill_uniform(keys, counters, rows, out):
    """Fills row k of `out` from the stream rows[k], and moves that on."""
    for k, i in enumerate(rows):
        for place in range(0, out.shape[1], 4):
            words = block(keys[i], counters[i], 1)
            counters[i, 0] += np.uint64(1)
            for j in range(min(4, out.shape[1] - place)):
                out[k, place + j] = np.int64(words[j] >> np.uint64(11)) * 2.0**-53


@_compiled
def normal(words, place):
    """Of the words of a `block` the standard normal number in a place from 0 to 7.

    A share (n + 1/2) / 2**32 of all such numbers lies below it, n being half a word (M. J. Wichura, Algorithm AS 241: the
    percentage points of the normal distribution, Applied Statistics 37, 1988; PPND7, seven digits).
    """
    half = np.int64(words[place // 2] >> np.uint64(32 * (place % 2)) & np.uint64(0xFFFFFFFF))
    share = (half + 0.5) * 2.0**-32
    off = share - 0.5
    if abs(off) <= 0.425:
        r = 0.180625 - off * off
        above = ((59.109374720 * r + 159.29113202) * r + 50.434271938) * r + 3.3871327179
        return off * above / (((67.187563600 * r + 78.757757664) * r + 17.895169469) * r + 1.0)
    depth = sqrt(-log(min(share, 1.0 - share))) - 1.6
    size = (((0.17023821103 * depth + 1.3067284816) * depth + 2.7568153900) * depth + 1.4234372777) / (
        (0.12021132975 * depth + 0.73700164250) * depth + 1.0
    )
    return size if off > 0.0 else -size

"""NumPy's random streams for many rows at once: the same numbers as a `Generator` for each row, without one object for each.

Seeds are mixed as `numpy.random.SeedSequence` does (M. O'Neill's `seed_seq_fe`), numbers come from PCG64 (M. O'Neill, PCG: A
family of simple fast space-efficient statistically good algorithms for random number generation, HMC-CS-2014-0905: a linear
congruential generator of 128 bits, output function XSL-RR), and normal ones by the ziggurat (G. Marsaglia and W. W. Tsang, The
ziggurat method for generating random variables, Journal of Statistical Software 5(8), 2000). A stream takes 40 bytes.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import erfc, exp, log, log1p, pi, prod, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .jit import compiled

__all__ = ["NormalNumbers", "Streams"]

Words = NDArray[np.uint32]
Integers = NDArray[np.uint64]

#: So many rows take less time one by one, by NumPy's own generators.
FEW = 4
#: Turns for which a few rows draw their normal numbers at a time: a call takes a generator longer than the numbers of one turn.
_AHEAD = 32
_LAST = 2**64 - 1
#: PCG64's multiplier, high and low half.
_HIGH, _LOW = 0x2360ED051FC65DA4, 0x4385DF649FCCF645
_HALF, _WORD = np.uint64(32), np.uint64(0xFFFFFFFF)
#: Columns of the states: the state's and the increment's halves; what is left of the last 64 bits, with a bit above it if so.
_STATE_HIGH, _STATE_LOW, _STEP_HIGH, _STEP_LOW, _LEFT = range(5)


class _Unseeded(np.random.bit_generator.ISeedSequence):
    """For a generator that is put into a state at once: mixing a seed takes longer than that."""

    def generate_state(self, n_words: int, dtype: Any = np.uint32) -> NDArray[Any]:
        return np.zeros(n_words, dtype)


class Streams:
    """`states` (N, 5): one stream for each row."""

    def __init__(self, states: Integers) -> None:
        self.states = states

    @classmethod
    def seeded(cls, entropy: Sequence[Sequence[int]], key: Sequence[Sequence[int]]) -> Streams:
        """Row i is `Generator(PCG64(SeedSequence([each[i] for each in entropy], spawn_key=[each[i] for each in key])))`; columns
        of N whole numbers."""
        columns = (*entropy, *key)
        if len(columns[0]) <= FEW or max(map(max, columns)) > _LAST:
            spread = zip(zip(*entropy, strict=True), zip(*key, strict=True), strict=True)
            sources = [np.random.SeedSequence(given, spawn_key=keys) for given, keys in spread]
            return cls.of(*map(np.random.PCG64, sources))
        numbers = np.array(columns, np.uint64)
        long = numbers > _WORD  # numbers of two words
        kind = (long * 2 ** np.arange(len(columns))[:, None]).sum(axis=0)
        states = np.zeros((numbers.shape[1], 5), np.uint64)
        for each in np.unique(kind):
            rows = np.flatnonzero(kind == each)
            words = [
                _words(column[rows], bool(two[rows[0]])) for column, two in zip(numbers, long, strict=True)
            ]
            pool = [word for column in words[: len(entropy)] for word in column]
            pool += [np.zeros(rows.size, np.uint32)] * (4 - len(pool))
            pool += [word for column in words[len(entropy) :] for word in column]
            states[rows] = _start(_generate(_mix(pool)))
        return cls(states)

    @classmethod
    def of(cls, *generators: np.random.BitGenerator) -> Streams:
        """Rows that go on as these generators (PCG64) do."""
        states = np.empty((len(generators), 5), np.uint64)
        for row, generator in enumerate(generators):
            found: Any = generator.state
            state, step = found["state"]["state"], found["state"]["inc"]
            left = found["has_uint32"] << 32 | found["uinteger"]
            states[row] = state >> 64, state & _LAST, step >> 64, step & _LAST, left
        return cls(states)

    def generator(self, row: int) -> np.random.Generator:
        """NumPy's own generator where the stream of a row is now; it goes on by itself."""
        high, low, step_high, step_low, left = self.states[row].tolist()
        bits = np.random.PCG64(_Unseeded())  # type: ignore[arg-type]  # which its stubs leave out
        bits.state = {
            "bit_generator": "PCG64",
            "state": {"state": high << 64 | low, "inc": step_high << 64 | step_low},
            "has_uint32": left >> 32,
            "uinteger": left % 2**32,
        }
        return np.random.Generator(bits)

    def random(
        self, shape: int | tuple[int, ...], rows: NDArray[Any] | slice = slice(None)
    ) -> NDArray[np.float64]:
        """`Generator.random(shape)` of some rows (indices or mask): (rows, *shape). The other rows stay where they are."""
        shape = (shape,) if isinstance(shape, int) else shape
        chosen = np.arange(len(self.states))[rows]
        if chosen.size <= FEW:  # nothing has to be compiled for them
            few = [self.generator(row) for row in chosen.tolist()]
            drawn = [each.random(shape) for each in few]
            self.states[chosen] = Streams.of(*(each.bit_generator for each in few)).states
            return np.array(drawn).reshape(chosen.size, *shape)
        shares = np.empty((chosen.size, prod(shape)))
        _fill_uniform(self.states, chosen, shares)
        return shares.reshape(chosen.size, *shape)


class NormalNumbers:
    """Standard normal numbers of float32, a stream of its own to each row: `numbers` (N, n) are those drawn last.

    A few rows keep generators of NumPy, for which nothing has to be compiled.
    """

    def __init__(self, rows: int, numbers: int) -> None:
        self.numbers = np.zeros((rows, numbers), np.float32)
        self._generators: dict[int, np.random.Generator] | None = {} if rows <= FEW else None
        self._states = np.zeros((rows if rows > FEW else 0, 5), np.uint64)
        self._ahead = np.zeros((rows if rows <= FEW else 0, _AHEAD, numbers), np.float32)
        self._turn = [0] * len(self._ahead)

    def begin(self, rows: NDArray[np.int64], streams: Streams) -> None:
        """From now on these rows take their numbers from these streams."""
        if self._generators is None:
            self._states[rows] = streams.states
        else:
            for k, row in enumerate(rows.tolist()):
                self._generators[row], self._turn[row] = streams.generator(k), 0

    def draw(self, rows: NDArray[np.int64]) -> None:
        """The next numbers of these rows. Threads may draw for rows of their own side by side."""
        if self._generators is None:
            _fill_normal(self._states, rows, self.numbers)
        else:
            for row in rows.tolist():
                turn = self._turn[row]
                if turn == 0:
                    self._generators[row].standard_normal(out=self._ahead[row], dtype=np.float32)
                self.numbers[row] = self._ahead[row, turn]
                self._turn[row] = (turn + 1) % _AHEAD


# --- seeds --------------------------------------------------------------------------------------------------------
def _words(numbers: Integers, two: bool) -> list[Words]:
    """Numbers as one or two words of 32 bits, the lower one first."""
    lower = (numbers & _WORD).astype(np.uint32)
    return [lower, (numbers >> _HALF).astype(np.uint32)] if two else [lower]


def _mix(words: list[Words]) -> list[Words]:
    """The four words of the pools, from at least four words of entropy and those of the key."""
    factor = 0x43B0D7E5

    def hashed(value: Words) -> Words:
        nonlocal factor
        value = value ^ np.uint32(factor)
        factor = factor * 0x931E8875 % 2**32
        value = value * np.uint32(factor)
        return value ^ value >> np.uint32(16)

    def mixed(one: Words, other: Words) -> Words:
        value = np.uint32(0xCA01F9DD) * one - np.uint32(0x4973F715) * other
        return value ^ value >> np.uint32(16)

    pool = [hashed(words[place]) for place in range(4)]
    for source in range(4):
        for to in range(4):
            if to != source:
                pool[to] = mixed(pool[to], hashed(pool[source]))
    for source in range(4, len(words)):
        for to in range(4):
            pool[to] = mixed(pool[to], hashed(words[source]))
    return pool


def _generate(pool: list[Words]) -> Integers:
    """Four numbers (N, 4) of 64 bits from the pools."""
    factor, halves = 0x8B51F9DD, []
    for place in range(8):
        value = pool[place % 4] ^ np.uint32(factor)
        factor = factor * 0x58F38DED % 2**32
        value = value * np.uint32(factor)
        halves.append((value ^ value >> np.uint32(16)).astype(np.uint64))
    return np.stack([halves[2 * place] | halves[2 * place + 1] << _HALF for place in range(4)], axis=1)


def _start(seed: Integers) -> Integers:
    """States (N, 5) of PCG64 seeded with (N, 4): the first two as the state, the others as the increment."""
    states = np.zeros((len(seed), 5), np.uint64)
    states[:, _STEP_HIGH] = seed[:, 2] << np.uint64(1) | seed[:, 3] >> np.uint64(63)
    states[:, _STEP_LOW] = seed[:, 3] << np.uint64(1) | np.uint64(1)
    states[:, _STATE_LOW] = states[:, _STEP_LOW] + seed[:, 1]
    carried = states[:, _STATE_LOW] < seed[:, 1]
    states[:, _STATE_HIGH] = states[:, _STEP_HIGH] + seed[:, 0] + carried
    Streams(states).random(())
    return states


def _threaded(function: Any) -> Any:
    return compiled(function, nogil=True)


# --- uniform numbers ----------------------------------------------------------------------------------------------
@compiled
def _word_of_64(states, i):
    """The next 64 bits of a stream."""
    word, half = np.uint64(0xFFFFFFFF), np.uint64(32)
    high, low = states[i, _STATE_HIGH], states[i, _STATE_LOW]
    by_high, by_low = np.uint64(_HIGH), np.uint64(_LOW)
    a, b, c, d = low >> half, low & word, by_low >> half, by_low & word
    lower = a * d + (b * d >> half)
    upper = b * c + (lower & word)
    high = a * c + (lower >> half) + (upper >> half) + high * by_low + low * by_high + states[i, _STEP_HIGH]
    low = low * by_low + states[i, _STEP_LOW]
    high += np.uint64(1) if low < states[i, _STEP_LOW] else np.uint64(0)
    states[i, _STATE_HIGH], states[i, _STATE_LOW] = high, low
    turn, mixed = high >> np.uint64(58), high ^ low
    return mixed >> turn | mixed << (-turn & np.uint64(63))


@compiled
def _bits(states, i):
    """The next 32 bits of a stream: PCG64 gives twice as many at a time."""
    left = states[i, _LEFT]
    if left >> np.uint64(32):
        states[i, _LEFT] = np.uint64(0)
        return left & np.uint64(0xFFFFFFFF)
    both = _word_of_64(states, i)
    states[i, _LEFT] = np.uint64(1) << np.uint64(32) | both >> np.uint64(32)
    return both & np.uint64(0xFFFFFFFF)


@compiled
def _fill_uniform(states, rows, out):
    """Fills row k of `out` with `Generator.random()` of stream rows[k]."""
    for k in range(rows.size):
        for place in range(out.shape[1]):
            out[k, place] = np.float64(_word_of_64(states, rows[k]) >> np.uint64(11)) * 2.0**-53


# --- normal numbers -----------------------------------------------------------------------------------------------
#: Where the ziggurat's tail begins, with 256 strips.
_TAIL = 3.6541528853610088


def _strips() -> tuple[NDArray[np.float32], Words, NDArray[np.float32]]:
    """Widths of the strips, shares of them that lie inside, both for 23 bits, and the density at their ends, (256,) each."""
    density = lambda x: exp(-0.5 * x * x)  # noqa: E731
    area = _TAIL * density(_TAIL) + sqrt(0.5 * pi) * erfc(_TAIL / sqrt(2.0))
    ends = [area / density(_TAIL), _TAIL]
    while len(ends) < 256:
        ends.append(sqrt(-2.0 * log(area / ends[-1] + density(ends[-1]))))
    widths = np.array([ends[0], *ends[:0:-1]])
    inner = np.array([_TAIL, 0.0, *widths[1:-1]])
    heights = np.array([1.0, *map(density, widths[1:])])
    return (
        (widths / 2**23).astype(np.float32),
        np.rint(inner / widths * 2**23).astype(np.uint32),
        heights.astype(np.float32),
    )


_WIDTHS, _INSIDE, _HEIGHTS = _strips()
_TAIL_32, _INVERSE_TAIL_32 = np.float32(_TAIL), np.float32(1.0 / _TAIL)


@compiled
def _share(states, i):
    return np.float32(_bits(states, i) >> np.uint64(8)) * np.float32(2.0**-24)


@compiled
def _normal(states, i):
    """The next `Generator.standard_normal(dtype=float32)` of stream i."""
    while True:
        bits = _bits(states, i)
        strip, size = np.int64(bits & np.uint64(255)), np.uint32(bits >> np.uint64(9))
        value, found = np.float32(size) * _WIDTHS[strip], True
        if size >= _INSIDE[strip]:
            if strip == 0:
                while True:
                    beyond = -_INVERSE_TAIL_32 * np.float32(log1p(-_share(states, i)))
                    depth = -np.float32(log1p(-_share(states, i)))
                    if depth + depth > beyond * beyond:
                        break
                value = _TAIL_32 + beyond
                if not size >> np.uint32(8) & np.uint32(1):
                    bits &= ~np.uint64(256)
                else:
                    bits |= np.uint64(256)
            else:
                step = _HEIGHTS[strip - 1] - _HEIGHTS[strip]
                found = step * _share(states, i) + _HEIGHTS[strip] < exp(-0.5 * value * value)
        if found:
            return -value if bits & np.uint64(256) else value


@_threaded
def _fill_normal(states, rows, out):
    """Fills these rows of `out` with the next numbers of their streams."""
    for i in rows:
        for place in range(out.shape[1]):
            out[i, place] = _normal(states, i)

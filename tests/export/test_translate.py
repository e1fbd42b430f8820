"""Compiled functions as C: what Python means by them, on cases that the kernel and the laws do not all have."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from hydro_env.export.c_printer import expression, source
from hydro_env.export.fmu.build import build_library, find_compiler
from hydro_env.ir.nodes import Expr, var
from hydro_env.ir.reader import Arr, Reader, Rec, TranslationError

needs_compiler = pytest.mark.skipif(find_compiler() is None, reason="no C compiler")
SIZE = 6


class Pair(NamedTuple):
    rows: Any
    gain: Any


def whole_numbers(x, pair):
    for n in range(SIZE):
        x[n] = (n - 4) % 3 + 10 * ((n - 4) // 3)


def swaps(x, pair):
    a, b, c = x[0], x[1], 2.0
    a, b = b, a
    x[0], x[1] = a, b
    x[2] = c if a < b < 10.0 and not (a > 5.0 or b > 9.0) else -c


def views(x, pair):
    row = pair.rows[1]
    row[:] = 3.0
    pair.rows[:, 0] = pair.gain
    x[:3] = pair.rows[1, :3]
    x[3] = pair.rows[-1, -1]


def both_ways(value):
    if value > 0.0:
        return value, 1
    return -value, 0


def two_results(x, pair):
    total, last = 0.0, 0
    for sign, k in ((1.0, 1), (-1.0, 2)):
        size, positive = both_ways(sign * x[k])
        total += size * k
        last = positive
    for n in range(SIZE - 1, -1, -1):
        if n == 2:
            continue
        if n == 0:
            break
        x[n] = min(max(x[n], -0.5), 0.5, total) ** 3
    x[0] = total + last + np.argmin(x) + np.sign(x[2]) + abs(x[3])


def widens(x, pair):
    number = 1
    for _ in range(3):
        number = number / 2
    local = np.zeros((2, 2))
    local[1, 0] += number
    x[0] = local[1, 0] + local[0, 1]


def refused_loop(x, pair):
    while x[0] > 0.0:
        x[0] -= 1.0


def refused_size(x, pair):
    room = np.empty(int(x[0]))
    x[0] = room[0]


def refused_choice(x, pair):
    row = pair.rows[0]
    if x[0] > 0.0:
        row = pair.rows[1]
    x[0] = row[0]


def arguments() -> tuple[np.ndarray, Pair]:
    random = np.random.default_rng(2)
    return random.normal(size=SIZE), Pair(random.normal(size=(2, 4)), 0.7)


def translated(function: Callable[..., Any]) -> tuple[str, Reader]:
    """The call of a function in C."""
    reader = Reader()
    pair = Rec({"rows": Arr.of("double", "rows", (2, 4)), "gain": var("gain", "double")})
    called = reader.call(function, [Arr.of("double", "x", (SIZE,)), pair])
    return expression(Expr("call", "int", tuple(called.handed), called.name)), reader


@needs_compiler
@pytest.mark.parametrize("function", [whole_numbers, swaps, views, two_results, widens])
def test_c_does_what_python_does(function: Callable[..., Any], tmp_path: Path) -> None:
    call, reader = translated(function)
    seen = '__attribute__((visibility("default")))'
    entry = f"{seen} void entry(double *x, double *rows, double gain) {{ (void)rows, (void)gain, {call}; }}\n"
    (tmp_path / "code.c").write_text(source(reader, entry))
    compiler = find_compiler()
    assert compiler is not None
    build_library(compiler, [tmp_path / "code.c"], tmp_path / "code.so")
    (x, pair), (expected, other) = arguments(), arguments()
    function(expected, other)
    run = ctypes.CDLL(str(tmp_path / "code.so")).entry
    run.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_double)
    run(x.ctypes.data, pair.rows.ctypes.data, pair.gain)
    assert np.array_equal(x, expected) and np.array_equal(pair.rows, other.rows)


@pytest.mark.parametrize("function", [refused_loop, refused_size, refused_choice])
def test_what_c_cannot_say_is_refused_by_name(function: Callable[..., Any]) -> None:
    with pytest.raises(TranslationError, match=function.__name__):
        translated(function)


def test_a_call_knows_what_is_changed() -> None:
    """What a function writes to is found through the functions that it calls."""

    pair = Rec({"rows": Arr.of("double", "rows", (2, 4)), "gain": var("gain", "double")})
    for function, written in ((views, {"x", "rows"}), (swaps, {"x"})):
        assert Reader().call(function, [Arr.of("double", "x", (SIZE,)), pair]).written == written

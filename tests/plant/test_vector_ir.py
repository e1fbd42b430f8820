"""Vector instructions for statements on lanes: what they compute is what Python computes, bit for bit."""

from __future__ import annotations

import ast
import ctypes
import inspect
import textwrap
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from hydro_env.plant import vector_math
from hydro_env.plant.kernel.laws import check
from hydro_env.plant.kernel.machine_code import machine_code

LANES = 12  # three vectors of four, or six of two: not a power of two

TEXT = '''
from math import floor, sqrt

LANES = 12


def branchy(a, b):
    """If and return, one after the other."""
    c = a * 2.0
    if a > b:
        c = c - b
        if b > 0.0:
            return c ** 2
    elif not (a < -1.0 or b == 0.0):
        return -c / b if b != 0.0 else 7
    return c + (1.0 if -1.0 < a <= b and b > 0.5 else 0.25)


def rooted(a):
    return sqrt(abs(a)) + floor(a) - abs(-a)


def plain(a, b, h):
    return branchy(a, b) + h * rooted(a)


def work(cells, h) -> int:
    found = 0
    for l in range(LANES):
        a = cells[0 * LANES + l]
        b = cells[1 * LANES + l]
        grown = h * rooted(a)
        cells[2 * LANES + l] = branchy(a, b) + grown
        cells[4 * LANES + l] = h - a * b
        found += a > 3.0
    for l in range(LANES):
        cells[3 * LANES + l] = cells[2 * LANES + l] * (2.0 * h)
    return found
'''


class _Module:
    """The text as machine code (`run`) and as plain Python."""

    def __init__(self) -> None:
        # Python's `c ** 2` is the library's pow, which now and then rounds otherwise than the product that lanes take.
        by_products: dict = {}
        exec(TEXT.replace("c ** 2", "c * c"), by_products)
        self.plain = by_products["plain"]
        self._code = {single: machine_code(TEXT, single, ("work",)) for single in (False, True)}

    def run(self, cells: np.ndarray, h: float) -> bool:
        single = cells.dtype == np.float32
        real = ctypes.c_float if single else ctypes.c_double
        work = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.POINTER(real), real)(self._code[single].addresses[0])
        return bool(work(cells.ctypes.data_as(ctypes.POINTER(real)), h))


@pytest.fixture(scope="module")
def module():
    return _Module()


_NUMBER = st.one_of(st.sampled_from([0.0, -0.0, 1.0, -1.0, 0.5]), st.floats(-1e3, 1e3))
_ROW = st.lists(_NUMBER, min_size=LANES, max_size=LANES)


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None)
@given(a=_ROW, b=_ROW, h=st.floats(1e-6, 1e3))
def test_same_bits_as_python(module, a, b, h):
    cells = np.zeros(5 * LANES)
    cells[:LANES], cells[LANES : 2 * LANES] = a, b
    found = module.run(cells, h)
    expected = np.array([module.plain(x, y, h) for x, y in zip(a, b, strict=True)])
    np.testing.assert_array_equal(cells[2 * LANES : 3 * LANES], expected)
    np.testing.assert_array_equal(cells[3 * LANES : 4 * LANES], expected * (2.0 * h))
    once = [float(Fraction(h) - Fraction(x) * Fraction(y)) for x, y in zip(a, b, strict=True)]
    np.testing.assert_array_equal(cells[4 * LANES :], once)  # a product and a sum are rounded once
    assert found == any(x > 3.0 for x in a)


def test_single_precision_stays_single(module):
    cells = np.zeros(5 * LANES, np.float32)
    cells[:LANES] = 0.1
    module.run(cells, np.float32(0.5))
    assert cells[2 * LANES] == pytest.approx(module.plain(np.float32(0.1), np.float32(0.0), 0.5), rel=1e-6)


@pytest.mark.parametrize(
    ("law", "named"),
    [
        ("def law(a):\n    for i in range(3):\n        a = a + 1\n    return a", "for"),
        ("def law(a):\n    return max(a, 0.0)", "max"),
        ("def law(a):\n    return math.exp(a)", "math.exp"),
        ("def law(a):\n    return a + offset", "offset"),
        ("def law(a):\n    return [a][0]", "[a]"),
        ("def law(a):\n    return a % 2.0", "%"),
    ],
)
def test_what_cannot_run_on_lanes_is_named(law, named):
    with pytest.raises(ValueError, match="law: ") as problem:
        check(ast.parse(law).body[0], ("exp", "tanh"))
    assert named in str(problem.value)
    assert "\n" not in str(problem.value)


@pytest.mark.parametrize("name", [name for name in vector_math.__all__ if name != "sqrt"])
def test_helpers_of_laws_can_run_on_lanes(name):
    source = textwrap.dedent(inspect.getsource(getattr(vector_math, name)))
    check(ast.parse(source).body[0], vector_math.__all__)


def test_bell_is_the_bell():
    x = np.linspace(-6.0, 6.0, 2001)
    error = np.abs([vector_math.bell(value) - np.exp(-value * value) for value in x])
    assert error.max() < 2e-6
    assert error[np.abs(x) < 1.0].max() < 1e-9

"""Numbers that users give: within their limits, or one line that names these."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydro_env.errors import InputError
from hydro_env.limits import Limits

BOTH = st.booleans().map(lambda whole: Limits(1, 50, whole=whole, unit="s"))
VALUES = (
    st.none()
    | st.booleans()
    | st.floats()
    | st.integers()
    | st.binary()
    | st.lists(st.integers())
    | st.complex_numbers()
)


@given(BOTH, st.text() | st.floats().map(str) | st.integers().map(str))
def test_a_text_is_a_number_within_the_limits_or_refused(limits: Limits, text: str) -> None:
    try:
        value = limits.read(text, "--x")
    except InputError as problem:
        assert str(problem).startswith("--x is ") and str(problem).endswith("number from 1 to 50 s")
    else:
        assert 1 <= value <= 50 and isinstance(value, int if limits.whole else float)


@given(BOTH, VALUES)
def test_a_value_is_a_number_within_the_limits_or_refused(limits: Limits, value: Any) -> None:
    try:
        assert 1 <= limits.check(value, "x") <= 50 and not isinstance(value, bool)
    except InputError as problem:
        assert str(problem).startswith("x is ") and str(limits) in str(problem)


@pytest.mark.parametrize("text", ["inf", "nan", "1e400", "9" * 5000, "", "0x10"])
def test_what_is_no_number_of_ours(text: str) -> None:
    for limits in (Limits(0.0, 1e6), Limits(0, 10**12, whole=True)):
        with pytest.raises(InputError, match="expected a"):
            limits.read(text, "--x")

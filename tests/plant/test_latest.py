"""What is known last is added last, and nothing else changes."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydro_env.plant.kernel.latest import added_last

LINES = [
    "late = a / b",
    "rate = a - late",
    "force = b + (c * rate - a) - late * b",
    "other = c * a",
    "sum = (a * force - b * rate + other) * c",
    "goal = sum * b - -force",
    "after = goal + rate",
]


def values(lines, **given):
    for line in lines:
        exec(line, {"sqrt": math.sqrt}, given)
    return given


numbers = st.floats(0.5, 2.0)


@given(a=numbers, b=numbers, c=numbers)
def test_what_is_used_has_the_same_value(a, b, c):
    before, after = values(LINES, a=a, b=b, c=c), values(added_last(LINES, "late", "goal"), a=a, b=b, c=c)
    for name in ("late", "rate", "other", "goal", "after"):
        assert after[name] == pytest.approx(before[name], rel=1e-12, abs=1e-12), name
    assert "force" not in after and "sum" not in after  # nothing later uses them


def test_the_goal_waits_for_nothing_but_the_late_value():
    lines = added_last(LINES, "late", "goal")
    waits = {"late"}
    for line in lines:
        target, expression = line.split(" = ")
        if waits & set(expression.replace("(", " ").replace(")", " ").split()):
            waits.add(target)
    assert "goal__early" not in waits
    assert [line for line in lines if line.startswith("goal = ")] == [
        "goal = goal__early + goal__share * late"
    ]


@given(a=numbers, b=numbers, c=numbers)
def test_what_is_not_linear_gets_the_sum(a, b, c):
    lines = [*LINES[:3], "root = sqrt(force * force)", "square = rate * rate", *LINES[3:]]
    before, after = values(lines, a=a, b=b, c=c), values(added_last(lines, "late", "goal"), a=a, b=b, c=c)
    for name in ("late", "rate", "force", "root", "square", "goal", "after"):
        assert after[name] == pytest.approx(before[name], rel=1e-12, abs=1e-12), name


def test_a_factor_that_is_there_is_not_computed_again():
    alone = added_last(LINES, "late", "goal")
    factor = next(line for line in alone if line.startswith("goal__share"))
    again = added_last(LINES, "late", "goal", shared=True)
    assert again == [line for line in alone if line is not factor and line != factor]

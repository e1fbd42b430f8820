"""Settings of the control law: tables, mistakes in one line, a unit, a meaning and a reason for every field."""

from dataclasses import fields, is_dataclass, replace
from typing import get_args, get_type_hints

import pytest

from hydro_env.controllers.mpc.flow_controller import FlowSettings
from hydro_env.controllers.settings import from_table
from hydro_env.errors import InputError


def parts(kind):
    """A settings dataclass and those it holds."""
    yield kind
    for hint in get_type_hints(kind).values():
        for inner in (hint, *get_args(hint)):
            if is_dataclass(inner):
                yield from parts(inner)


@pytest.mark.parametrize("kind", list(parts(FlowSettings)), ids=lambda kind: kind.__name__)
def test_every_setting_has_a_unit_and_a_reason(kind):
    for each in fields(kind):
        if not any(
            is_dataclass(k)
            for k in (get_type_hints(kind)[each.name], *get_args(get_type_hints(kind)[each.name]))
        ):
            assert each.metadata["summary"], each.name
            assert isinstance(each.default, bool) or (each.metadata["unit"] and each.metadata["reason"]), (
                each.name
            )


def test_a_table_changes_what_it_names():
    given = from_table(FlowSettings, {"reference": {"rise": 12.0}, "planner": None}, "law: ")
    usual = FlowSettings()
    assert given == replace(usual, reference=replace(usual.reference, rise=12.0), planner=None)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"planer": None}, "did you mean 'planner'"),
        ({"reference": 3}, "law: reference: should be a table"),
        ({"reference": {"raet": 1.0}}, "did you mean 'rate'"),
        ({"reference": {"rate": -1.0}}, "rate -1.0 should be at least 0"),
        ({"probing": {"active": 1}}, "active 1 should be true or false"),
        ({"feedback": {"track": "much"}}, "law: feedback: track 'much' should be a number"),
    ],
)
def test_mistakes_are_named_in_one_line(table, says):
    with pytest.raises(InputError, match=says) as caught:
        from_table(FlowSettings, table, "law: ")
    assert "\n" not in str(caught.value)

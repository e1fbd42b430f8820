"""Settings of the control law: tables there and back, mistakes in one line, a unit, a meaning and a reason for every field."""

from dataclasses import fields, is_dataclass
from typing import get_args, get_type_hints

import pytest

from hydro_env.controllers.learned.flow_interface import OutputSettings
from hydro_env.controllers.learned.policy_interface import make_interface
from hydro_env.controllers.mpc.flow_controller import FlowSettings
from hydro_env.errors import InputError


def parts(kind):
    """A settings dataclass and those it holds."""
    yield kind
    for hint in get_type_hints(kind).values():
        for inner in (hint, *get_args(hint)):
            if is_dataclass(inner):
                yield from parts(inner)


@pytest.mark.parametrize("kind", [*parts(FlowSettings), OutputSettings], ids=lambda kind: kind.__name__)
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


def test_tables_come_back():
    table = {"kind": "flow", "law": {"reference": {"rise": 12.0}, "planner": None}, "outputs": {"flow": 0.05}}
    interface = make_interface(table)
    again = make_interface(interface.table())
    assert again.table() == interface.table()
    assert (again.controller.settings.reference.rise, again.controller.settings.planner) == (12.0, None)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"law": {"planer": None}}, "did you mean 'planner'"),
        ({"law": {"reference": 3}}, "law: reference: should be a table"),
        ({"law": {"feedback": {"track": "much"}}}, "law: feedback: track 'much' should be a number"),
        ({"laws": {}}, "'laws' is unknown"),
    ],
)
def test_mistakes_are_named_in_one_line(table, says):
    with pytest.raises(InputError, match=says) as caught:
        make_interface({"kind": "flow", **table})
    assert "\n" not in str(caught.value)

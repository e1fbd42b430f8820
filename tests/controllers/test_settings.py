"""Settings of the control law: a unit, a meaning and a reason for every field."""

from dataclasses import fields, is_dataclass
from typing import get_args, get_type_hints

import pytest

from hydro_env.controllers.mpc.flow_controller import FlowSettings


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

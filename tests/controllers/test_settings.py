"""Settings of the control law: a unit, a meaning and a reason for every field."""

from typing import get_type_hints

import pytest

from hydro_env.controllers.mpc.flow_controller import FlowSettings


def parts(kind):
    """The class of some settings and of those they hold."""
    yield kind
    for default in kind._field_defaults.values():
        if hasattr(default, "_fields"):
            yield from parts(type(default))


@pytest.mark.parametrize("kind", list(parts(FlowSettings)), ids=lambda kind: kind.__name__)
def test_every_setting_has_a_unit_and_a_reason(kind):
    for name, hint in get_type_hints(kind, include_extras=True).items():
        default = kind._field_defaults[name]
        if not hasattr(default, "_fields"):
            unit, summary, *reason = hint.__metadata__
            assert summary, name
            assert isinstance(default, bool) or (unit and reason and reason[0]), name

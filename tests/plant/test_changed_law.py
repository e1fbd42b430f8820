"""A file of laws that is changed while it is loaded."""

import importlib.util
import sys
from pathlib import Path

import pytest

from hydro_env.plant.kernel.laws import texts


def test_a_law_whose_file_was_changed_since_is_refused(tmp_path: Path) -> None:
    """Its text is what the file says now; kept under the identity of what is loaded it would be another law's for ever."""
    file = tmp_path / "my_laws.py"
    file.write_text(
        "def first(voltage, gain):\n    return voltage * gain\n\n\ndef second(force):\n    return force\n"
    )
    spec = importlib.util.spec_from_file_location("my_laws_changed", file)
    assert spec is not None and spec.loader is not None
    laws = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = laws
    try:
        spec.loader.exec_module(laws)
        assert texts({"first_law": laws.first})[-1].startswith("def first_law(voltage, gain):")
        file.write_text("def other(force, mass):\n    return force / mass\n\n\n" + file.read_text())
        with pytest.raises(ValueError, match="'second' was changed since it was loaded"):
            texts({"second_law": laws.second})
    finally:
        del sys.modules[spec.name]

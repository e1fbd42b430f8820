"""Modules of kernels that are read back from disk are those that would be written."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from hydro_env import jit
from hydro_env.plant import CATALOGUE, Effect
from hydro_env.plant.kernel import module_cache
from hydro_env.plant.kernel.codegen import Module, module_text
from hydro_env.plant.kernel.module_cache import module_of


@pytest.fixture
def written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Module]]:
    """An empty folder for what is kept, and the modules that are written."""
    made: list[Module] = []

    def counted(effects: tuple[Effect, ...], half: int, grouped: bool) -> Module:
        made.append(module_text(effects, half, grouped))
        return made[-1]

    monkeypatch.setattr(jit, "_folder", lambda: tmp_path)
    monkeypatch.setattr(module_cache, "module_text", counted)
    yield made


def weaker(flow, narrowing):  # type: ignore[no-untyped-def]
    return flow / (1.0 + narrowing)


def stronger(flow, narrowing):  # type: ignore[no-untyped-def]
    return flow / (1.5 + narrowing)


def test_what_is_read_back_is_what_was_written(written: list[Module]) -> None:
    for effects, half in (((), 1), (tuple(CATALOGUE.values())[:9], 8), (tuple(CATALOGUE.values())[9:18], 8)):
        first, count = module_of(effects, half, False), len(written)
        assert module_of(effects, half, False) == first == written[-1]
        assert len(written) == count
    assert len({module.text for module in written}) == len(written) == 3


def test_what_a_module_depends_on(written: list[Module], monkeypatch: pytest.MonkeyPatch) -> None:
    effect = CATALOGUE["pressure_dependent_flow"]
    one = replace(
        effect, name="edge", parameters=(replace(effect.parameters[0], name="narrowing"),), states=()
    )
    for laws in (weaker, stronger):
        module_of((replace(one, laws={"flow": laws}),), 4, False)
    assert len(written) == 2 and written[0].text != written[1].text
    module_of((replace(one, laws={"flow": weaker}),), 8, False)
    module_of((replace(one, laws={"flow": weaker}, limits={"x_max": "narrowing"}),), 4, False)
    assert len(written) == 4
    module_of((replace(one, laws={"flow": weaker}),), 4, False)
    assert len(written) == 4
    monkeypatch.setattr(module_cache, "sources_of_room", lambda file: "another version")
    module_of((replace(one, laws={"flow": weaker}),), 4, False)
    assert len(written) == 5

"""Modules of kernels, kept on disk for the next process: to write one takes ten milliseconds, and a diagnosis needs fifty."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import lru_cache
from types import FunctionType
from typing import Any

from hydro_env.jit import keep, kept, sources_of_room

from ..catalogue import Effect
from ..catalogue.effect import called_by
from .codegen import Module, module_text


def module_of(effects: tuple[Effect, ...], half: int, grouped: bool) -> Module:
    """See `codegen.module_text`."""
    depends = (
        half, grouped, [_identity(effect) for effect in effects], sources_of_room(__file__), sys.implementation.cache_tag,
    )  # fmt: skip
    name = f"{hashlib.sha256(repr(depends).encode()).hexdigest()[:32]}.json"
    found = kept(name)
    if found is not None:
        return Module(*json.loads(found))
    module = module_text(effects, half, grouped)
    keep(name, json.dumps(module).encode())
    return module


@lru_cache(maxsize=256)
def _identity(effect: Effect) -> str:
    """All that an effect is, its laws by what they do."""
    return json.dumps(effect, default=_plain)


def _plain(value: Any) -> Any:
    """What JSON cannot say by itself."""
    if isinstance(value, FunctionType):
        codes = [each.__code__ for each in (value, *called_by(value))]
        return [repr((code.co_code, code.co_consts, code.co_names, code.co_varnames)) for code in codes]
    if isinstance(value, Mapping):
        return dict(value)
    return vars(value) if is_dataclass(value) else repr(value)

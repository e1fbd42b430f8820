"""Modules of kernels, kept on disk for the next process: to write one takes ten milliseconds, and a diagnosis needs fifty."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache, lru_cache
from pathlib import Path
from types import FunctionType
from typing import Any

from hydro_env.jit import keep, kept

from ..catalogue import Effect
from ..catalogue.effect import called_by
from .codegen import Module, module_text

__all__ = ["module_of"]


def module_of(effects: tuple[Effect, ...], half: int, grouped: bool) -> Module:
    """See `codegen.module_text`."""
    depends = (
        half, grouped, [_identity(effect) for effect in effects], _writers(), sys.implementation.cache_tag,
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
    return repr(_plain(effect))


def _plain(value: Any) -> Any:
    if isinstance(value, FunctionType):
        codes = [each.__code__ for each in (value, *called_by(value))]
        return [(code.co_code, code.co_consts, code.co_names, code.co_varnames) for code in codes]
    if isinstance(value, Mapping):
        return [(key, _plain(each)) for key, each in value.items()]
    if isinstance(value, tuple | list):
        return [_plain(each) for each in value]
    return [_plain(getattr(value, f.name)) for f in fields(value)] if is_dataclass(value) else value


@cache
def _writers() -> str:
    """The sources of what writes a module."""
    folder = Path(__file__).parent
    texts = [path.read_bytes() for place in (folder, folder.parent) for path in sorted(place.glob("*.py"))]
    return hashlib.sha256(b"\0".join(texts)).hexdigest()

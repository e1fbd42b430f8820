"""Gains files: the numbers of a controller with units and how they were found (`hydro_env/gains/1`, JSON)."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError
from hydro_env.files import write_json

__all__ = ["SCHEMA", "GainsFile", "read_gains", "write_gains"]

SCHEMA = "hydro_env/gains/1"


@dataclass(frozen=True)
class GainsFile:
    """`controller` names the control law, `gains` holds a number or a number per channel for each of its
    gains.
    """

    controller: str
    gains: dict[str, float | list[float]]
    units: dict[str, str] = field(default_factory=dict)
    tuning: dict[str, Any] = field(default_factory=dict)
    name: str = ""


def read_gains(path: str | Path) -> GainsFile:
    """Reads a gains file; InputError names what is wrong with it."""
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{path}: no such gains file") from None
    except (json.JSONDecodeError, UnicodeDecodeError, OSError) as problem:
        raise InputError(f"{path}: not a gains file in JSON ({problem})") from None
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise InputError(f'{path}: key "schema" must be "{SCHEMA}"')
    if not isinstance(data.get("controller"), str) or not isinstance(data.get("gains"), dict):
        raise InputError(f'{path}: keys "controller" (a name) and "gains" (a table) are needed')
    for key, value in data["gains"].items():
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError):
            numbers = np.asarray(np.nan)
        if numbers.shape not in ((), (2,)) or not np.all(np.isfinite(numbers)):
            raise InputError(
                f'{path}: gain "{key}" must be a number or a list of two (one per channel), not {value!r}'
            )
    known = {key: data[key] for key in ("controller", "gains", "units", "tuning", "name") if key in data}
    return GainsFile(**known)


def write_gains(path: str | Path, found: GainsFile) -> None:
    """Writes a gains file atomically."""
    write_json(
        Path(path),
        {
            "schema": SCHEMA,
            "name": found.name,
            "controller": found.controller,
            "gains": found.gains,
            "units": found.units,
            "tuning": found.tuning,
        },
    )

"""Gains files: the numbers of a controller with units and how they were found (`hydro_env/gains/1`, JSON)."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from hydro_env.errors import InputError, shown
from hydro_env.files import write_json
from hydro_env.reading import read_json

__all__ = ["SCHEMA", "GainsFile", "read_gains", "write_gains"]

SCHEMA = "hydro_env/gains/1"


@dataclass(frozen=True)
class GainsFile:
    """`controller` names the control law, `gains` holds a number or a number per channel for each of its
    gains. `periods` holds gains of other control periods, {"0.005": {"gains": {...}, "tuning": {...}}} in s; those of
    `gains` belong to the period that `tuning` names. `plant` is what the controller drives wherever it is scored, for one
    that belongs to other valves; "" for the one the leaderboard is run on.
    """

    controller: str
    gains: dict[str, float | list[float]]
    units: dict[str, str] = field(default_factory=dict)
    tuning: dict[str, Any] = field(default_factory=dict)
    name: str = ""
    periods: dict[str, dict[str, Any]] = field(default_factory=dict)
    plant: str = ""

    def by_period(self) -> dict[float, dict[str, Any]]:
        """Gains by control period in s; empty where there is but one set."""
        if not self.periods:
            return {}
        own = {float(self.tuning.get("control_period_s", 0.01)): self.gains}
        return own | {float(period): dict(entry["gains"]) for period, entry in self.periods.items()}


def read_gains(path: str | Path) -> GainsFile:
    """Reads a gains file; InputError names what is wrong with it."""
    path = Path(path)
    data = read_json(path, "a gains file in JSON")
    if not isinstance(data, dict) or data.get("schema") != SCHEMA:
        raise InputError(f'{path}: key "schema" must be "{SCHEMA}"')
    if not isinstance(data.get("controller"), str) or not isinstance(data.get("gains"), dict):
        raise InputError(f'{path}: keys "controller" (a name) and "gains" (a table) are needed')
    _check(path, data["gains"], "")
    periods = data.get("periods", {})
    if not isinstance(periods, dict):
        raise InputError(f'{path}: key "periods" must be a table from control periods in s to gains')
    for period, entry in periods.items():
        if not _is_period(period):
            raise InputError(
                f'{path}: periods: {shown(period)} must be a control period in s, such as "0.005"'
            )
        if not isinstance(entry, dict) or not isinstance(entry.get("gains"), dict):
            raise InputError(f'{path}: periods: "{period}" needs a table "gains"')
        _check(path, entry["gains"], f'periods: "{period}": ')
    for key, what in (
        ("plant", "the name of a preset or of a model file"),
        ("name", "the controller's name"),
    ):
        if not isinstance(data.get(key, ""), str):
            raise InputError(f'{path}: key "{key}" must be {what}')
    for key in ("units", "tuning"):
        if not isinstance(data.get(key, {}), dict):
            raise InputError(f'{path}: key "{key}" must be a table')
    period = data.get("tuning", {}).get("control_period_s", 0.01)
    if isinstance(period, bool) or not isinstance(period, int | float) or not _is_period(period):
        raise InputError(f'{path}: tuning: "control_period_s" must be a control period in s, such as 0.01')
    known = {each.name: data[each.name] for each in fields(GainsFile) if each.name in data}
    return GainsFile(**known)


def _check(path: Path, gains: dict[str, Any], where: str) -> None:
    for key, value in gains.items():
        try:
            numbers = np.asarray(value, dtype=float)
        except (TypeError, ValueError, OverflowError):
            numbers = np.asarray(np.nan)
        if numbers.shape not in ((), (2,)) or not np.all(np.isfinite(numbers)):
            raise InputError(
                f'{path}: {where}gain "{key}" must be a number or a list of two (one per channel), not {shown(value)}'
            )


def _is_period(text: str | float) -> bool:
    try:
        return 0.0 < float(text) < 10.0
    except (ValueError, OverflowError):
        return False


def write_gains(path: str | Path, found: GainsFile) -> None:
    """Writes a gains file atomically."""
    data: dict[str, Any] = {
        "schema": SCHEMA,
        "name": found.name,
        "controller": found.controller,
        "gains": found.gains,
        "units": found.units,
        "tuning": found.tuning,
    }
    for key in ("plant", "periods"):
        if value := getattr(found, key):
            data[key] = value
    write_json(Path(path), data)

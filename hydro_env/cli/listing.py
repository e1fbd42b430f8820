"""The command `list`: the names that the other commands and the environment take."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from hydro_env.errors import InputError, suggestion
from hydro_env.files import output_folder, to_json, write_json

SCHEMA = "hydro_env/list/1"


def list_names(
    kind: Annotated[str | None, Argument(
        metavar="[KIND]", help="Only controllers, effects, presets, scenarios, splits, metrics or suites."
    )] = None,
    as_json: Annotated[bool, Option("--json", help="Print JSON, with more about each.")] = False,
    out: Annotated[Path | None, Option("--out", help="Folder to write list.json to as well.")] = None,
) -> None:  # fmt: skip
    """List controllers, effects, presets, scenarios, splits.

    Each with a line of what it is. Takes no --out unless list.json is wanted.
    """
    if kind is not None and kind not in KINDS:
        raise InputError(f"unknown kind {kind!r}: {suggestion(kind, KINDS)}")
    found = {name: entries() for name, entries in KINDS.items() if kind in (None, name)}
    data = {"schema": SCHEMA, **found}
    if out is not None:
        with output_folder(out) as folder:
            write_json(folder / "list.json", data)
    print(to_json(data, indent=1) if as_json else "\n\n".join(map(_block, found, found.values())))


def _block(kind: str, entries: list[dict[str, Any]]) -> str:
    width = max(len(entry["name"]) for entry in entries)
    return "\n".join([kind, *(f"  {entry['name']:{width}}  {entry['summary']}" for entry in entries)])


def _controllers() -> list[dict[str, Any]]:
    from hydro_env.controllers.registry import CONTROLLERS

    return [{"name": each.name, "summary": each.summary} for each in CONTROLLERS.values()]


def _effects() -> list[dict[str, Any]]:
    from hydro_env.plant.catalogue import BUILT_IN, CATALOGUE

    def parameter(p: Any) -> dict[str, Any]:
        keys = ("name", "unit", "neutral", "low", "high", "typical")
        return {key: getattr(p, key) for key in keys} | {"summary": p.title}

    return [
        {"name": each.name, "summary": each.summary, "port": each.port, "parameters": list(map(parameter, each.parameters))}
        for each in (CATALOGUE[name] for name in BUILT_IN)
    ]  # fmt: skip


def _presets() -> list[dict[str, Any]]:
    from hydro_env.plant.model_files import preset_names, preset_summary

    return [{"name": name, "summary": preset_summary(name)} for name in preset_names()]


def _scenarios() -> list[dict[str, Any]]:
    from hydro_env.tasks import SCENARIOS

    return [
        {"name": each.name, "summary": each.summary, "seconds": each.duration} for each in SCENARIOS.values()
    ]


def _splits() -> list[dict[str, Any]]:
    from hydro_env.tasks import OWN, SPLITS

    drawn = [{"name": each.name, "summary": each.summary, "pairs": each.cases} for each in SPLITS.values()]
    own = {"name": OWN, "summary": "the plant's own pair of valves; only noise differs", "pairs": 1}
    return [*drawn, own]


def _metrics() -> list[dict[str, Any]]:
    from hydro_env.tasks import METRICS

    return [{"name": each.name, "summary": each.definition, "unit": each.unit} for each in METRICS.values()]


def _suites() -> list[dict[str, Any]]:
    from hydro_env.benchmark.suite import shipped_suites

    def summary(suite: Any) -> str:
        pairs = ", ".join(f"{count} pairs of {split}" for split, count in suite.splits.items())
        return f"{pairs}; {', '.join(suite.scenarios)}"

    return [{"name": each.name, "summary": summary(each)} for each in shipped_suites().values()]


KINDS: dict[str, Callable[[], list[dict[str, Any]]]] = {
    "controllers": _controllers, "effects": _effects, "presets": _presets, "scenarios": _scenarios, "splits": _splits,
    "metrics": _metrics, "suites": _suites,
}  # fmt: skip
"""What there are names for, and the entries of each: "name", "summary" and more for JSON."""

"""The command `list`: the names that the other commands and the environment take."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from hydro_env.errors import check_known
from hydro_env.files import output_folder, to_json, write_json

SCHEMA = "hydro_env/list/1"

Entries = list[dict[str, Any]]


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
    check_known("unknown kind", () if kind is None else (kind,), KINDS)
    found = {name: entries() for name, entries in KINDS.items() if kind in (None, name)}
    data = {"schema": SCHEMA, **found}
    if out is not None:
        with output_folder(out) as folder:
            write_json(folder / "list.json", data)
    print(to_json(data, indent=1) if as_json else "\n\n".join(map(_block, found, found.values())))


def _block(kind: str, entries: Entries) -> str:
    width = max(len(entry["name"]) for entry in entries)
    return "\n".join([kind, *(f"  {entry['name']:{width}}  {entry['summary']}" for entry in entries)])


def _entries(things: Iterable[Any], *keys: str, **renamed: str) -> Entries:
    """An entry for each thing: its attributes by key, but for those that have another name than their key."""
    return [{key: getattr(each, renamed.get(key, key)) for key in keys} for each in things]


def _controllers() -> Entries:
    from hydro_env.controllers.registry import CONTROLLERS

    return _entries(CONTROLLERS.values(), "name", "summary")


def _effects() -> Entries:
    from hydro_env.plant.catalogue import BUILT_IN, CATALOGUE

    found = _entries((CATALOGUE[name] for name in BUILT_IN), "name", "summary", "port", "parameters")
    keys = ("name", "unit", "neutral", "low", "high", "typical", "summary")
    return [{**each, "parameters": _entries(each["parameters"], *keys, summary="title")} for each in found]


def _presets() -> Entries:
    from hydro_env.plant.model_files import preset_names, preset_summary

    return [{"name": name, "summary": preset_summary(name)} for name in preset_names()]


def _scenarios() -> Entries:
    from hydro_env.tasks import SCENARIOS

    return _entries(SCENARIOS.values(), "name", "summary", "seconds", seconds="duration")


def _splits() -> Entries:
    from hydro_env.tasks import OWN, SPLITS

    own = {"name": OWN, "summary": "the plant's own pair of valves; only noise differs", "pairs": 1}
    return [*_entries(SPLITS.values(), "name", "summary", "pairs", pairs="cases"), own]


def _metrics() -> Entries:
    from hydro_env.tasks import METRICS

    return _entries(METRICS.values(), "name", "summary", "unit", summary="definition")


def _suites() -> Entries:
    from hydro_env.benchmark.suite import shipped_suites

    def summary(suite: Any) -> str:
        pairs = ", ".join(f"{count} pairs of {split}" for split, count in suite.splits.items())
        return f"{pairs}; {', '.join(suite.scenarios)}"

    return [{"name": each.name, "summary": summary(each)} for each in shipped_suites().values()]


#: What there are names for, and the entries of each: "name", "summary" and more for JSON.
KINDS: dict[str, Callable[[], Entries]] = {
    "controllers": _controllers, "effects": _effects, "presets": _presets, "scenarios": _scenarios, "splits": _splits,
    "metrics": _metrics, "suites": _suites,
}  # fmt: skip

"""The suite: which splits, scenarios, cases and metrics a benchmark runs, read from YAML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field

from hydro_env.errors import InputError, shown, suggestion
from hydro_env.reading import parse_yaml, read_yaml
from hydro_env.validation import Count, FileTable, checked

__all__ = ["Suite", "check_names", "load_suite", "shipped_suites"]


class Suite(FileTable):
    """`splits` maps a split to its number of cases; `scenarios` and `metrics` are names."""

    name: str
    splits: Annotated[dict[str, Count], Field(min_length=1)]
    scenarios: Annotated[tuple[str, ...], Field(min_length=1)]
    metrics: Annotated[tuple[str, ...], Field(min_length=1)]

    def narrowed(
        self,
        splits: Iterable[str] | None = None,
        scenarios: Iterable[str] | None = None,
        cases: int | None = None,
    ) -> Suite:
        """The suite with other splits or scenarios (a split the suite lacks gets its largest number of
        cases).
        """
        chosen = list(self.splits if splits is None else splits)
        most = max(self.splits.values())
        changed = {
            "splits": {split: self.splits.get(split, most) if cases is None else cases for split in chosen},
            "scenarios": self.scenarios if scenarios is None else tuple(scenarios),
        }
        return checked(Suite, self.model_dump() | changed, "benchmark")


def shipped_suites() -> list[Suite]:
    """The suites of the package."""
    return [checked(Suite, {"name": name, **table}, "suite.yaml") for name, table in _shipped().items()]


def _shipped() -> Any:
    text = files("hydro_env.benchmark").joinpath("suite.yaml").read_text(encoding="utf-8")
    return parse_yaml(text, "suite.yaml")


def load_suite(
    spec: str | Path, *, splits: Iterable[str], scenarios: Iterable[str], metrics: Iterable[str]
) -> Suite:
    """A suite by name or YAML file. The keyword arguments are the names that exist; InputError names what
    does not.
    """
    known = {"splits": list(splits), "scenarios": list(scenarios), "metrics": list(metrics)}
    own = _shipped()
    if str(spec) in own:
        name, table, where = str(spec), own[str(spec)], "suite.yaml"
    else:
        path = Path(spec)
        if path.suffix not in (".yaml", ".yml"):
            raise InputError(
                f"unknown suite {shown(str(spec))}: {suggestion(spec, own)}, or the path of a .yaml file"
            )
        name, table, where = path.stem, read_yaml(path, "a suite in YAML"), str(path)
    named = {"name": name, **table} if isinstance(table, dict) else table
    return check_names(checked(Suite, named, where), known, where)


def check_names(suite: Suite, known: Mapping[str, Iterable[str]], where: str) -> Suite:
    """The suite itself, or an InputError that names the first thing in it that does not exist, or stands there twice."""
    for key in ("splits", "scenarios", "metrics"):
        names = list(getattr(suite, key))
        for name in names:
            if name not in known[key]:
                raise InputError(f"{where}: unknown {key[:-1]} {shown(name)}: {suggestion(name, known[key])}")
            if names.count(name) > 1:
                raise InputError(f"{where}: {key[:-1]} {shown(name)} is named more than once")
    return suite

"""The suite: which splits, scenarios, cases and metrics a benchmark runs, read from YAML."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

from hydro_env.errors import InputError, shown, suggestion
from hydro_env.reading import parse_yaml, read_yaml

__all__ = ["Suite", "load_suite", "shipped_suites"]

KEYS = ("splits", "scenarios", "metrics")


@dataclass(frozen=True)
class Suite:
    """`splits` maps a split to its number of cases; `scenarios` and `metrics` are names."""

    name: str
    splits: dict[str, int]
    scenarios: tuple[str, ...]
    metrics: tuple[str, ...]

    def narrowed(
        self,
        splits: Iterable[str] | None = None,
        scenarios: Iterable[str] | None = None,
        cases: int | None = None,
    ) -> Suite:
        """The suite with other splits or scenarios (a split the suite lacks gets its largest number of
        cases).
        """
        chosen = (
            self.splits
            if splits is None
            else {s: self.splits.get(s, max(self.splits.values())) for s in splits}
        )
        if cases is not None:
            chosen = dict.fromkeys(chosen, cases)
        return replace(
            self, splits=dict(chosen), scenarios=self.scenarios if scenarios is None else tuple(scenarios)
        )


def shipped_suites() -> list[Suite]:
    """The suites of the package."""
    own = _shipped()
    return [Suite(name, t["splits"], tuple(t["scenarios"]), tuple(t["metrics"])) for name, t in own.items()]


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
        return _checked(str(spec), own[str(spec)], known, "suite.yaml")
    path = Path(spec)
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(
            f"unknown suite {shown(str(spec))}: {suggestion(spec, own)}, or the path of a .yaml file"
        )
    return _checked(path.stem, read_yaml(path, "a suite in YAML"), known, str(path))


def check_suite(suite: Suite, known: Mapping[str, Iterable[str]], where: str) -> Suite:
    """The suite itself, or an InputError that names the first thing in it that does not exist."""
    for key in KEYS:
        names = list(getattr(suite, key))
        for name in names:
            if name not in known[key]:
                raise InputError(f"{where}: unknown {key[:-1]} {shown(name)}: {suggestion(name, known[key])}")
            if names.count(name) > 1:
                raise InputError(f"{where}: {key[:-1]} {shown(name)} is named more than once")
    for split, cases in suite.splits.items():
        if not isinstance(cases, int) or isinstance(cases, bool) or cases < 1:
            raise InputError(
                f"{where}: split {split!r} needs a number of cases of at least 1, not {shown(cases)}"
            )
    return suite


def _checked(name: str, table: Any, known: dict[str, list[str]], where: str) -> Suite:
    if not isinstance(table, dict):
        raise InputError(f"{where}: must be a table with the keys {', '.join(KEYS)}")
    for key in table:
        if key not in KEYS:
            raise InputError(f"{where}: unknown key {shown(key)}: {suggestion(key, KEYS)}")
    for key, kind, what in (
        ("splits", dict, "a table of cases per split"),
        ("scenarios", list, "a list"),
        ("metrics", list, "a list"),
    ):
        if not isinstance(table.get(key), kind) or not table[key]:
            raise InputError(f"{where}: key {key!r} must be {what}")
    suite = Suite(name, table["splits"], tuple(table["scenarios"]), tuple(table["metrics"]))
    return check_suite(suite, known, where)

"""The suite: which splits, scenarios, cases and metrics a benchmark runs, read from YAML."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

from pydantic import Field, model_validator

from hydro_env.errors import InputError, shown, suggestion
from hydro_env.reading import read_yaml, shipped_yaml
from hydro_env.tasks import METRICS, OWN, SCENARIOS, SPLITS
from hydro_env.validation import Count, FileTable, checked, known

Split = Annotated[str, known("split", (*SPLITS, OWN))]
Scenario = Annotated[str, known("scenario", SCENARIOS)]
Metric = Annotated[str, known("metric", METRICS)]

#: Who sets 0 and who sets 100 of the score. The probability of improvement is given against the first (against the first
#: controller where it does not take part).
BASELINE, BOUND = "pid_tuned", "oracle"
#: The metrics that a result is summed up by.
RETURN, PEAK, TRACKING = SCORED_BY = "return", "max_speed_difference_rpm", "tracking_mae_rpm"


class Suite(FileTable):
    """`splits` maps a split to its number of cases, counted from `first` on; `scenarios` and `metrics` are names. With `protocol`
    the controllers that set 0 and 100 of the score take part, and each gets a result file."""

    name: str
    first: Annotated[int, Field(ge=0, le=10_000)] = 0
    protocol: bool = False
    splits: Annotated[dict[Split, Count], Field(min_length=1)]
    scenarios: Annotated[tuple[Scenario, ...], Field(min_length=1)]
    metrics: Annotated[tuple[Metric, ...], Field(min_length=1)]

    @model_validator(mode="after")
    def _each_once(self) -> "Suite":
        for what, names in (("scenario", self.scenarios), ("metric", self.metrics)):
            for name in names:
                if names.count(name) > 1:
                    raise ValueError(f"{what} {shown(name)} is named more than once")
        lacking = [name for name in SCORED_BY if self.protocol and name not in self.metrics]
        if lacking:
            raise ValueError(f"metrics: a protocol needs {', '.join(lacking)}")
        for split, cases in self.splits.items():
            listed = None if split == OWN else SPLITS[split].cases
            if listed is not None and self.first + cases > listed:
                raise ValueError(
                    f"split {split!r}: {cases} cases from {self.first} on are asked for, there are {listed} pairs of valves"
                )
        return self

    def narrowed(
        self, splits: Iterable[str] | None, scenarios: Iterable[str] | None, cases: int | None
    ) -> "Suite":
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


def shipped_suites() -> dict[str, Suite]:
    """The suites of the package by name."""
    tables = shipped_yaml("hydro_env.benchmark", "suite.yaml")
    return {name: checked(Suite, {"name": name, **table}, "suite.yaml") for name, table in tables.items()}


def load_suite(spec: str | Path) -> Suite:
    """A suite by name or YAML file. InputError for anything else."""
    own, path = shipped_suites(), Path(spec)
    if str(spec) in own:
        return own[str(spec)]
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(
            f"unknown suite {shown(str(spec))}: {suggestion(spec, own)}, or the path of a .yaml file"
        )
    table = read_yaml(path, "a suite in YAML")
    return checked(Suite, {"name": path.stem, **table} if isinstance(table, dict) else table, path)

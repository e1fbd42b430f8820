"""Gains files: the numbers of a controller with units and how they were found (`hydro_env/gains/1`, JSON)."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from hydro_env.files import write_json
from hydro_env.limits import Limits
from hydro_env.reading import read_json
from hydro_env.validation import FileTable, checked, two_numbers

SCHEMA = "hydro_env/gains/1"


#: A control period, s.
PERIOD = Limits(1e-6, 10.0, unit="s")


def _per_channel(value: Any) -> Any:
    two_numbers(value)
    return value


def _period(text: str) -> str:
    PERIOD.read(text, "the control period")
    return text


def _tuned_at(tuning: dict[str, Any]) -> dict[str, Any]:
    PERIOD.check(tuning.get("control_period_s", 0.01), "control_period_s")
    return tuning


Gains = dict[str, Annotated[Any, AfterValidator(_per_channel)]]


class OtherPeriod(FileTable):
    """Gains of a control period beside that of the file."""

    gains: Gains
    tuning: dict[str, Any] = Field(default_factory=dict)


class GainsFile(FileTable):
    """`controller` names the control law, `gains` holds a number or a number per channel for each of its
    gains. `periods` holds gains of other control periods by their length in s as text, "0.005"; those of `gains` belong to
    the period that `tuning` names. `plant` is what the controller drives wherever it is scored, for one that belongs to other
    valves; "" for the one the leaderboard is run on.
    """

    FORMAT = SCHEMA

    name: str = ""
    controller: str
    gains: Gains
    units: dict[str, str] = Field(default_factory=dict)
    tuning: Annotated[dict[str, Any], AfterValidator(_tuned_at)] = Field(default_factory=dict)
    plant: str = ""
    periods: dict[Annotated[str, AfterValidator(_period)], OtherPeriod] = Field(default_factory=dict)

    def by_period(self) -> dict[float, dict[str, Any]]:
        """Gains by control period in s."""
        own = {float(self.tuning.get("control_period_s", 0.01)): self.gains}
        return own | {float(period): dict(entry.gains) for period, entry in self.periods.items()}


def read_gains(path: str | Path) -> GainsFile:
    """Reads a gains file; InputError names what is wrong with it."""
    return checked(GainsFile, read_json(path, "a gains file in JSON"), path)


def write_gains(path: str | Path, found: GainsFile) -> GainsFile:
    """Writes a gains file atomically and returns it; makes its folder if need be."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    empty = {key for key in ("plant", "periods") if not getattr(found, key)}
    write_json(Path(path), {"schema": SCHEMA, **found.model_dump(exclude=empty)})
    return found

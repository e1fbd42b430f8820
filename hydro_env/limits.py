"""Numbers that users give: of which kind they are and between which limits.

One description serves the options of all commands and the arguments of the environment, and every refusal names what is
right: "is inf, expected a number from 0.05 to 3600 s".
"""

import argparse
import math
from dataclasses import dataclass
from numbers import Integral, Real
from typing import Any

from hydro_env.errors import InputError, shown


@dataclass(frozen=True)
class Limits:
    """A number from `low` to `high`, both included; `whole`: one without fraction. `unit` is shown beside the limits."""

    low: float
    high: float
    whole: bool = False
    unit: str = ""

    def __str__(self) -> str:
        kind = "a whole number" if self.whole else "a number"
        return f"{kind} from {_short(self.low)} to {_short(self.high)}{self.unit and ' '}{self.unit}"

    def check(self, value: Any, name: str) -> Any:
        """The value as int or float. InputError that begins with `name` for what is not a number or beyond the limits."""
        fits = isinstance(value, Integral if self.whole else Real) and not isinstance(value, bool)
        if not (fits and self.low <= value <= self.high):
            raise InputError(f"{name} is {shown(value)}, expected {self}")
        return int(value) if self.whole else float(value)

    def read(self, text: str, name: str) -> Any:
        """The number that a text holds, as `check`."""
        try:
            value = (int if self.whole else float)(text)
        except ValueError:
            raise InputError(f"{name} is {shown(text)}, expected {self}") from None
        return self.check(value, name)

    def __call__(self, text: str) -> Any:
        """The same as the `type` of an option of argparse."""
        try:
            return self.read(text, "the value")
        except InputError as problem:
            raise argparse.ArgumentTypeError(str(problem)) from None


def _short(value: float) -> str:
    return str(int(value)) if math.isfinite(value) and value == int(value) else f"{value:g}"


#: Seeds that every random generator takes.
SEEDS = Limits(0, 2**32 - 1, whole=True)
#: Processes or threads.
CORES = Limits(1, 1024, whole=True)

"""What the files of users may hold: a pydantic model describes each format, and whatever is wrong is one line.

    class Suite(FileTable):
        splits: dict[str, Count]

    suite = checked(Suite, read_yaml(path, "a suite in YAML"), path)

The line names the file and the key, what was found there and what would be right; of an unknown key or name the nearest one.
"""

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from hydro_env.errors import InputError, check_known, shown

#: What pydantic says, and what engineers do.
_WORDS = {
    "a valid string": "text",
    "a valid dictionary": "a table of `name: value` lines",
    "a valid number": "a number",
    "a valid integer": "a whole number",
    "a valid boolean": "true or false",
    "a valid list": "a list",
    "a valid tuple": "a list",
}

M = TypeVar("M", bound="FileTable")


def _no_truth_value(value: Any) -> Any:
    if isinstance(value, bool):
        raise PydanticCustomError("number", "Input should be a number")
    return value


#: A number, also one that YAML takes for text, such as 1e-3; a truth value is none.
Number = Annotated[float, BeforeValidator(_no_truth_value)]
#: The same, and infinity.
NumberOrInfinity = Annotated[float, Field(allow_inf_nan=True), BeforeValidator(_no_truth_value)]
#: A whole number of at least 1.
Count = Annotated[int, BeforeValidator(_no_truth_value), Field(ge=1, le=10**15)]


def two_numbers(value: Any) -> tuple[float, float]:
    """A number, or one for each of the two channels."""
    try:
        values = [value, value] if isinstance(value, str) or np.ndim(value) == 0 else list(value)
        if len(values) != 2 or any(isinstance(each, bool) for each in values):
            raise ValueError
        pair = (float(values[0]), float(values[1]))
        if np.isnan(pair).any():
            raise ValueError
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{shown(value)} is neither a number nor one for each of the two channels") from None
    return pair


class FileTable(BaseModel):
    """A table of a file, with no keys but its fields. The key `schema` of a whole file has to be its `FORMAT`, if it has one."""

    FORMAT: ClassVar[str] = ""

    model_config = ConfigDict(frozen=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def known_keys(cls) -> Collection[str]:
        """The keys that the table may have."""
        return [field.alias or name for name, field in cls.model_fields.items()]

    @model_validator(mode="before")
    @classmethod
    def _checked_keys(cls, data: Any) -> Any:
        if isinstance(data, cls):
            return data
        if not isinstance(data, Mapping):
            found = "nothing" if data is None else shown(data)
            raise ValueError(f"expected a table of `name: value` lines, found {found}")
        check_known("unknown key", data, cls.known_keys())
        return dict(data)


def known(what: str, names: Collection[str]) -> AfterValidator:
    """For a field with one of these names: `Annotated[str, known("scenario", SCENARIOS)]`."""

    def check(name: str) -> str:
        check_known(f"unknown {what}", [name], names)
        return name

    return AfterValidator(check)


def checked(kind: type[M], data: Any, where: str | Path) -> M:
    """The content of a file as `kind`. InputError, which begins with `where`, for whatever does not fit."""
    if kind.FORMAT and isinstance(data, Mapping):
        if data.get("schema") != kind.FORMAT:
            raise InputError(f"{where}: schema is {shown(data.get('schema'))}, should be {kind.FORMAT!r}")
        data = {key: value for key, value in data.items() if key != "schema"}
    try:
        return kind.model_validate(data)
    except ValidationError as error:
        raise InputError(f"{where}: {_explain(error)}") from None


def _explain(error: ValidationError) -> str:
    """The first thing that is wrong, in one line: key, what was found, what would be right."""
    first = error.errors(include_url=False)[0]
    place = ".".join(str(part) for part in first["loc"] if part != "[key]")
    if first["type"] == "value_error":
        message = first["msg"].removeprefix("Value error, ")
        return f"{place}: {message}" if place else message
    if first["type"] == "missing":
        return f"{place} is missing"
    message = first["msg"].partition(", unable to parse")[0]
    for theirs, ours in _WORDS.items():
        message = message.replace(theirs, ours)
    _, should, right = message.partition(" should ")
    found = "empty" if first["input"] is None else shown(first["input"])
    return f"{place} is {found}, {f'should {right}' if should else message}"

"""Whatever is wrong in a file is one line: file, key, what was found, what would be right."""

from __future__ import annotations

from typing import Annotated, Any

import pytest
from pydantic import Field

from hydro_env.errors import InputError
from hydro_env.validation import Count, FileTable, Number, checked, known


class Part(FileTable):
    """A table within the file."""

    size: Annotated[Number, Field(ge=0.0, le=2.0)]
    kind: Annotated[str, known("kind", ("round", "square"))] = "round"


class Whole(FileTable):
    """A file."""

    FORMAT = "hydro_env/whole/1"

    part: Part
    count: Count = 1
    others: dict[str, Part] = Field(default_factory=dict)


GOOD: dict[str, Any] = {"schema": "hydro_env/whole/1", "part": {"size": "1e-3"}}


def test_numbers_that_yaml_takes_for_text_are_numbers() -> None:
    assert checked(Whole, GOOD, "a.yaml").part.size == 1e-3


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "hydro_env/hole/1"}, "schema is 'hydro_env/hole/1', should be 'hydro_env/whole/1'"),
        ({"part": {}}, "part.size is missing"),
        ({"part": {"size": 1, "knid": "round"}}, "part: unknown key 'knid': did you mean 'kind'?"),
        ({"part": {"size": 1, "kind": "squre"}}, "part.kind: unknown kind 'squre': did you mean 'square'?"),
        ({"part": {"size": 3}}, "part.size is 3, should be less than or equal to 2"),
        ({"part": {"size": "big"}}, "part.size is 'big', should be a number"),
        ({"part": {"size": None}}, "part.size is empty, should be a number"),
        ({"part": {"size": float("nan")}}, "part.size is nan, should be a finite number"),
        ({"part": 3}, "part: expected a table of `name: value` lines, found 3"),
        ({"count": True}, "count is True, should be a number"),
        ({"count": 1.5}, "count is 1.5, should be a whole number"),
        ({"others": {"left": {"size": []}}}, "others.left.size is [], should be a number"),
        ({"others": [1]}, "others is [1], should be a table of `name: value` lines"),
        ({10: 1}, "unknown key 10"),
    ],
)
def test_the_first_mistake_is_one_line(change: dict[Any, Any], said: str) -> None:
    with pytest.raises(InputError) as caught:
        checked(Whole, GOOD | change, "a.yaml")
    assert str(caught.value).startswith(f"a.yaml: {said}")


@pytest.mark.parametrize(("data", "found"), [(None, "nothing"), ([], r"\[\]"), (3, "3"), ("text", "'text'")])
def test_what_is_no_table_is_refused(data: Any, found: str) -> None:
    with pytest.raises(InputError, match=rf"a\.yaml: expected a table .*, found {found}$"):
        checked(Whole, data, "a.yaml")

"""One task, wherever it runs: its result, or the `Failure` that says why there is none."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hydro_env.errors import described

#: How often a task is started whose process dies.
ATTEMPTS = 3


@dataclass(frozen=True)
class Failure:
    """The result of a task that could not be done."""

    reason: str

    def __str__(self) -> str:
        return self.reason


def died(how: str) -> Failure:
    """The failure of a task whose process died in each of its attempts, at last `how`."""
    return Failure(f"its process died {ATTEMPTS} times, at last {how}")


def unsendable(where: str, problem: Exception) -> Failure:
    """The failure of a task that cannot be pickled."""
    return Failure(f"cannot be sent to {where}: {described(problem)}")


def attempt(function: Callable[[Any], Any], task: Any) -> Any:
    """The result, or the failure that says what was raised, in a user's file also where. `exit` ends the task, not the run."""
    try:
        return function(task)
    except (Exception, SystemExit) as problem:
        return Failure(described(problem))


def answer(function: Callable[[Any], Any], content: bytes) -> bytes:
    """The same with task and result pickled, as they go to another process and back."""
    result = attempt(lambda task: function(pickle.loads(task)), content)
    try:
        return pickle.dumps(result)
    except Exception as problem:
        return pickle.dumps(Failure(f"its result cannot be sent: {described(problem)}"))

"""Runs a function on many tasks: in this process, in processes of this machine, or on a Ray cluster.

    results = run(tasks, function, engine="local", jobs=4)

The results come in the order of the tasks and do not depend on the engine, as long as the function depends on its
task alone. A task whose function raises, or that takes its process down with it `ATTEMPTS` times, gives a `Failure`
that says why; the other tasks go on. A process that is killed loses nothing: its task is run again by another one.
An interruption, or the end of this process by whatever means, ends all others.

serial  one task after the other, here
local   `jobs` processes; with one job the same as serial, without the second that a process needs to start
ray     an existing cluster (`RAY_ADDRESS`, else the one `ray start` began here); its CPUs decide how many tasks run
        at once, so `jobs` has no say. Every node needs the same hydro_env, which is checked, and files that a task
        names have to lie at the same path there
"""

import contextlib
from collections.abc import Callable, Generator, Sequence
from typing import Any

from threadpoolctl import threadpool_limits
from tqdm import tqdm

from hydro_env.errors import InputError

from .store import Store
from .tasks import ATTEMPTS, Failure, attempt

__all__ = ["ATTEMPTS", "ENGINES", "Failure", "Store", "as_done", "check_engine", "run"]

ENGINES = ("serial", "local", "ray")


def run(
    tasks: Sequence[Any], function: Callable[[Any], Any], *, engine: str = "local", jobs: int = 1,
    progress: bool = True, unit: str = "task", size: Callable[[Any], int] = lambda task: 1,
    store: Store | None = None,
) -> list[Any]:  # fmt: skip
    """`function(task)` of every task, in the order of the tasks, or a `Failure` in its place.

    Args:
        tasks: what to do; picklable unless the engine is serial.
        function: a function of a module (other processes import it), or a partial of one.
        engine, jobs: see above.
        progress, unit, size: whether to show a bar, and what and how many of them a task counts for.
        store: keeps results; what it holds already is not run again.

    InputError if the engine does not exist, Ray is not there or no cluster answers. An interruption is passed on
    when all processes are gone.
    """
    check_engine(engine, jobs)  # before a progress bar or a folder appears
    missing = object()
    results: list[Any] = [missing if store is None else store.get(task, missing) for task in tasks]
    left = [place for place, result in enumerate(results) if result is missing]
    done = sum(size(task) for task, result in zip(tasks, results, strict=True) if result is not missing)
    total = sum(size(task) for task in tasks)
    with tqdm(total=total, initial=done, unit=unit, disable=not progress) as bar:
        finished = as_done([tasks[place] for place in left], function, engine=engine, jobs=jobs)
        with contextlib.closing(finished):
            for number, result in finished:
                place = left[number]
                results[place] = result
                if store is not None and not isinstance(result, Failure):
                    store.put(tasks[place], result)
                bar.update(size(tasks[place]))
    return results


def as_done(
    tasks: Sequence[Any], function: Callable[[Any], Any], *, engine: str = "local", jobs: int = 1
) -> Generator[tuple[int, Any], None, None]:
    """Place and result of every task, as they get done. Close the iterator to stop the work before its end."""
    check_engine(engine, jobs)
    if engine == "ray" and tasks:
        from .ray_engine import on_ray

        return on_ray(tasks, function)
    if engine == "local" and jobs > 1 and tasks:
        from .local import in_processes

        return in_processes(tasks, function, min(jobs, len(tasks)))
    return _here(tasks, function)


def _here(tasks: Sequence[Any], function: Callable[[Any], Any]) -> Generator[tuple[int, Any], None, None]:
    for place, task in enumerate(tasks):
        with threadpool_limits(1, "blas"):  # as in `local`
            result = attempt(function, task)
        yield place, result


def check_engine(engine: str, jobs: int = 1) -> None:
    """InputError if there is no such engine; does not look for a cluster."""
    if engine not in ENGINES:
        raise InputError(f"unknown engine {engine!r}: there are {', '.join(ENGINES)}")
    if jobs < 1:
        raise InputError(f"jobs must be at least 1, not {jobs}")

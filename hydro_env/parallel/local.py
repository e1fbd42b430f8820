"""Processes of this machine, by loky: a pool of one process each, so that it is plain which task died with it.

(In a pool of several a dead process breaks all tasks that are under way, in `concurrent.futures` as in loky. pebble names the
task, but loses it where the process dies right after it was handed out.)
"""

import multiprocessing
import os
import pickle
import re
import signal
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from typing import Any

from loky import BrokenProcessPool, ProcessPoolExecutor
from threadpoolctl import threadpool_limits

from .tasks import ATTEMPTS, answer, died, unsendable


def in_processes(
    tasks: Sequence[Any], function: Callable[[Any], Any], jobs: int
) -> Generator[tuple[int, Any], None, None]:
    """Place and result of every task as they get done by `jobs` processes. Closing it ends the processes.

    RuntimeError if the first process ends before it can do anything, as in a script without `if __name__ == "__main__":`.
    """
    waiting: deque[tuple[int, bytes, int]] = deque()  # place, pickled task, attempt
    running: dict[Any, tuple[tuple[int, bytes, int], Any]] = {}
    for place, task in enumerate(tasks):
        try:
            waiting.append((place, pickle.dumps(task), 1))
        except Exception as problem:
            yield place, unsendable("another process", problem)

    def start(pool: Any) -> None:
        """Gives a process its next task, or ends it when there is none."""
        if waiting:
            job = waiting.popleft()
            running[pool.submit(answer, function, job[1])] = job, pool
        else:
            pool.shutdown(wait=False)

    pools = [_process() for _ in range(min(jobs, len(waiting)))]
    begun = pools[0].submit(int) if pools else None
    try:
        for pool in pools:
            start(pool)
        while running:
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                (place, content, attempt), pool = running.pop(future)
                try:
                    result = pickle.loads(future.result())
                except BrokenProcessPool as death:
                    if begun is not None and begun.done() and begun.exception():
                        raise RuntimeError(f"processes cannot be started: they end {_how(death)}") from None
                    pool = _process()
                    if attempt < ATTEMPTS:
                        waiting.appendleft((place, content, attempt + 1))
                        start(pool)
                        continue
                    result = died(_how(death))
                start(pool)
                yield place, result
    finally:
        for _, pool in running.values():
            pool.shutdown(kill_workers=True)


def _process() -> Any:
    # Spawned, not forked: the threads of Numba and of torch do not survive a fork, and it is the same everywhere.
    return ProcessPoolExecutor(1, context=multiprocessing.get_context("spawn"), initializer=_begin)


def _how(death: BrokenProcessPool) -> str:
    """ "by SIGKILL" or "with exit status 3", as loky's message has it."""
    found = re.search(r"\{(\w+)\((-?\d+)\)\}", str(death))
    if found is None:
        return "of an unknown cause"
    return f"by {found[1]}" if int(found[2]) < 0 else f"with exit status {found[2]}"


def _begin() -> None:
    """What a process does before its first task."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches us too; it is the parent that ends us
    # Threads of BLAS would wait for each other in loops and take the other processes' time.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # of libraries that are still to be loaded
    threadpool_limits(1, "blas")
    threading.Thread(target=_follow, daemon=True).start()


def _follow() -> None:
    """Ends this process with its parent, in the middle of a task if need be."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)

"""Runs a function on many tasks: in this process, in processes of this machine, or on a Ray cluster.

    results = run(tasks, function, engine="local", jobs=4)

The results come in the order of the tasks and do not depend on the engine, as long as the function depends on its
task alone. A task whose function raises, or that takes its process down with it `ATTEMPTS` times, gives a `Failure`
that says why; the other tasks go on. A process that is killed loses nothing: its task is run again by another one.

serial  one task after the other, here
local   `jobs` processes; with one job the same as serial, without the second that a process needs to start
ray     an existing cluster (`RAY_ADDRESS`, else the one `ray start` began here); its CPUs decide how many tasks run
        at once, so `jobs` has no say. Every node needs the same hydro_env, which is checked, and files that a task
        names have to lie at the same path there

The processes of `local` are our own. In `concurrent.futures` and in loky (joblib) a killed process breaks the whole
pool: every task that is under way fails, and nothing says which of them did it, so a task that kills cannot be told
from its victims. `multiprocessing.Pool` waits for ever. With a pipe for each process it is plain which task died, and
a process that loses its parent, even by `kill -9`, ends. One `ProcessPoolExecutor` for each process would name the task,
too, but before Python 3.14 (`kill_workers`) it cannot stop a task that runs. Ray does all that itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import multiprocessing
import os
import pickle
import platform
import signal
import socket
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits
from tqdm import tqdm

from hydro_env.errors import InputError, to_install
from hydro_env.files import write_bytes
from hydro_env.pickles import distrust, seal, unseal

__all__ = ["ATTEMPTS", "ENGINES", "Failure", "Store", "as_done", "check_engine", "fingerprint", "run"]

ENGINES = ("serial", "local", "ray")

ATTEMPTS = 3
"""So often a task is begun whose process dies under it."""

ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
"""Environment of a process beside others: threads of BLAS would wait for each other in loops, and take the others' time."""


@dataclass(frozen=True)
class Failure:
    """The result of a task that could not be done."""

    reason: str

    def __str__(self) -> str:
        return self.reason


def run(
    tasks: Sequence[Any],
    function: Callable[[Any], Any],
    *,
    engine: str = "local",
    jobs: int = 1,
    progress: bool = True,
    unit: str = "task",
    size: Callable[[Any], int] = lambda task: 1,
    store: Store | None = None,
) -> list[Any]:
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
    check_engine(engine, jobs)
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
    if not tasks:
        return (_ for _ in ())
    if engine == "ray":
        return _on_ray(tasks, function)
    if engine == "local" and jobs > 1:
        return _in_processes(tasks, function, min(jobs, len(tasks)))
    return _here(tasks, function)


def _here(tasks: Sequence[Any], function: Callable[[Any], Any]) -> Generator[tuple[int, Any], None, None]:
    for place, task in enumerate(tasks):
        with threadpool_limits(1, "blas"):  # see `ONE_THREAD`
            result = _attempt(function, task)
        yield place, result


def check_engine(engine: str, jobs: int = 1) -> None:
    """InputError if there is no such engine; does not look for a cluster."""
    if engine not in ENGINES:
        raise InputError(f"unknown engine {engine!r}: there are {', '.join(ENGINES)}")
    if jobs < 1:
        raise InputError(f"jobs must be at least 1, not {jobs}")


@cache
def fingerprint() -> str:
    """Changes with everything of ours that a result may depend on: code and data of hydro_env, and the versions of
    what computes. (Not with the kind of CPU.)
    """
    digest = hashlib.sha256()
    root = Path(__file__).parent
    for path in sorted(root.rglob("*")):
        if path.suffix in {".py", ".yaml", ".json", ".npz"} and path.is_file():
            digest.update(f"{path.relative_to(root).as_posix()}\0".encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    versions = [metadata.version(name) for name in ("numpy", "scipy", "numba")]
    digest.update(" ".join([platform.python_version(), platform.machine(), *versions]).encode())
    return digest.hexdigest()[:16]


class Store:
    """Results of finished tasks in a folder, so that a run that was stopped goes on where it was.

    `key(task)` is a text that says everything that the result depends on except our own code, which is added here;
    None: not to be kept. The files are pickles, which run code when they are loaded: InputError for a folder that other
    users can write to.
    """

    def __init__(self, folder: str | Path, key: Callable[[Any], str | None]) -> None:
        self.folder, self._key = Path(folder), key
        try:
            if not self.folder.is_dir():
                self.folder.mkdir(parents=True)
                self.folder.chmod(self.folder.stat().st_mode & ~0o022)
            reason = distrust(self.folder)
        except OSError as problem:
            raise InputError(
                f"{folder}: cannot keep results there ({problem.strerror or problem}); name a folder that can be written"
            ) from None
        if reason:
            raise InputError(f"{folder}: holds pickles, which run code when they are loaded, and {reason}")

    def get(self, task: Any, default: Any = None) -> Any:
        """The result of an equal task, `default` if there is none that can be read."""
        path = self._path(task)
        try:
            return default if path is None else pickle.loads(unseal(path.read_bytes()))
        except Exception:  # none yet, or damaged: it is made anew
            return default

    def put(self, task: Any, result: Any) -> None:
        path = self._path(task)
        if path is not None:
            write_bytes(path, seal(pickle.dumps(result)))

    def _path(self, task: Any) -> Path | None:
        key = self._key(task)
        if key is None:
            return None
        return self.folder / f"{hashlib.sha256(f'{fingerprint()} {key}'.encode()).hexdigest()[:32]}.pickle"


def _attempt(function: Callable[[Any], Any], task: Any) -> Any:
    """The result, or the Failure that says what was raised. `sys.exit` is no way out of the run of others either."""
    try:
        return function(task)
    except (Exception, SystemExit) as problem:
        return Failure(_line(problem))


def _answer(function: Callable[[Any], Any], content: bytes) -> bytes:
    """The same with task and result pickled, as they go to another process and back."""
    result = _attempt(lambda task: function(pickle.loads(task)), content)
    try:
        return pickle.dumps(result)
    except Exception as problem:
        return pickle.dumps(Failure(f"its result cannot be sent: {_line(problem)}"))


def _line(problem: BaseException) -> str:
    return f"{type(problem).__name__}: {' '.join(str(problem).split())}"[:300]


# --- processes of this machine ---------------------------------------------------------------------------------


@dataclass
class Worker:
    """A process, our end of its pipe, and the place of the task it is at (None: none)."""

    process: Any
    pipe: Connection
    ready: bool = False
    place: int | None = None


def _in_processes(
    tasks: Sequence[Any], function: Callable[[Any], Any], jobs: int
) -> Generator[tuple[int, Any], None, None]:
    waiting = deque(range(len(tasks)))
    deaths = [0] * len(tasks)
    failed_starts = 0
    workers: list[Worker] = []
    try:
        while waiting or any(worker.place is not None for worker in workers):
            busy = sum(worker.place is not None for worker in workers)
            while len(workers) < min(jobs, busy + len(waiting)):
                workers.append(_start(function))
            for worker in workers:
                if worker.ready and worker.place is None:
                    yield from _hand_out(worker, waiting, tasks)
            if not any(worker.place is not None or not worker.ready for worker in workers):
                continue  # nothing left that could be sent
            for pipe in wait([worker.pipe for worker in workers]):
                worker = next(worker for worker in workers if worker.pipe is pipe)
                try:
                    message = worker.pipe.recv()
                except (EOFError, OSError):  # it is dead, maybe in the middle of an answer
                    workers.remove(worker)
                    end = _end(worker)
                    if worker.place is not None:
                        deaths[worker.place] += 1
                        if deaths[worker.place] < ATTEMPTS:
                            waiting.appendleft(worker.place)
                        else:
                            died = f"its process died {ATTEMPTS} times, at last {end}"
                            yield worker.place, Failure(died)
                    elif not worker.ready:
                        failed_starts += 1
                        if failed_starts == ATTEMPTS:
                            raise RuntimeError(f"processes cannot be started: they end {end}") from None
                    continue
                if worker.ready:
                    assert worker.place is not None
                    yield worker.place, pickle.loads(message)
                worker.ready, worker.place, failed_starts = True, None, 0
    finally:
        for worker in workers:
            worker.pipe.close()  # which ends those that have nothing to do
            if worker.place is not None or not worker.ready:
                worker.process.kill()
        for worker in workers:
            worker.process.join(5.0)
            worker.process.kill()
            _end(worker)


def _hand_out(
    worker: Worker, waiting: deque[int], tasks: Sequence[Any]
) -> Generator[tuple[int, Any], None, None]:
    """Gives a worker its next task; yields those that cannot be sent."""
    while waiting:
        worker.place = waiting.popleft()
        try:
            worker.pipe.send_bytes(pickle.dumps(tasks[worker.place]))
        except OSError:  # it has just died: that is seen, and the task counted, when the pipe is read
            return
        except Exception as problem:
            place, worker.place = worker.place, None
            yield place, Failure(f"cannot be sent to another process: {_line(problem)}")
        else:
            return


def _start(function: Callable[[Any], Any]) -> Worker:
    # Spawned, not forked: the threads of Numba and of torch do not survive a fork, and it is the same everywhere.
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_work, args=(theirs, function), daemon=True)
    with _environment(ONE_THREAD):
        process.start()
    theirs.close()  # so that the pipe breaks when the process dies
    return Worker(process, ours)


@contextlib.contextmanager
def _environment(values: Mapping[str, str]) -> Generator[None, None, None]:
    """Environment variables, where they are not set, for the processes that begin meanwhile."""
    added = [name for name in values if name not in os.environ]
    os.environ.update({name: values[name] for name in added})
    try:
        yield
    finally:
        for name in added:
            del os.environ[name]


def _end(worker: Worker) -> str:
    """Waits for the end of a dead worker; how it came to it."""
    worker.process.join()
    worker.pipe.close()
    code = worker.process.exitcode
    worker.process.close()
    if code is not None and code < 0:
        with contextlib.suppress(ValueError):
            return f"by {signal.Signals(-code).name}"
    return f"with exit status {code}"


def _work(pipe: Connection, function: Callable[[Any], Any]) -> None:
    """What a worker does until its parent closes the pipe or is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches us too; it is the parent that ends us
    parent = multiprocessing.parent_process()
    assert parent is not None
    threading.Thread(target=_follow, args=(parent,), daemon=True).start()
    pipe.send(None)  # ready
    while True:
        try:
            content = pipe.recv_bytes()
        except (EOFError, OSError):
            return
        pipe.send(_answer(function, content))


def _follow(parent: Any) -> None:
    """Ends this process with its parent, in the middle of a task if need be."""
    parent.join()
    os._exit(1)


# --- Ray ---------------------------------------------------------------------------------------------------------


def _on_ray(tasks: Sequence[Any], function: Callable[[Any], Any]) -> Generator[tuple[int, Any], None, None]:
    ray, ours = _cluster()
    # Ray runs a task again when its worker or node dies, not when the function raises: `_remote` catches that.
    remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1, retry_exceptions=False)(_remote)
    places: dict[Any, int] = {}
    try:
        work = ray.put((ray.cloudpickle.dumps(function), os.getcwd(), list(sys.path), fingerprint()))
        for place, task in enumerate(tasks):
            try:
                places[remote.remote(work, ray.cloudpickle.dumps(task))] = place
            except Exception as problem:
                yield place, Failure(f"cannot be sent to the cluster: {_line(problem)}")
        while places:
            (done, *_), _ = ray.wait(list(places), num_returns=1)
            try:
                result = pickle.loads(ray.get(done))
            except ray.exceptions.RayError as problem:
                result = _ray_failure(ray, problem)
            yield places.pop(done), result
    finally:
        for reference in places:  # the work was stopped
            with contextlib.suppress(Exception):
                ray.cancel(reference, force=True)
        if ours:
            ray.shutdown()


def _ray_failure(ray: Any, problem: Exception) -> Failure:
    errors = ray.exceptions
    if isinstance(problem, errors.RayTaskError):
        cause = problem.cause if isinstance(problem.cause, BaseException) else problem
        if isinstance(cause, InputError):  # another hydro_env over there: no result would be worth anything
            raise InputError(str(cause)) from None
        return Failure(_line(cause))
    return Failure(f"its process died {ATTEMPTS} times, at last by {type(problem).__name__}")


def _remote(work: tuple[bytes, str, list[str], str], task: bytes) -> bytes:
    """What runs on a node: as if started in the folder and with the modules of whoever asked for it."""
    function, folder, path, expected = work
    with contextlib.suppress(OSError):  # a node without that folder
        os.chdir(folder)
    sys.path.extend(each for each in path if each not in sys.path)
    if fingerprint() != expected:
        raise InputError(
            f"engine ray: node {platform.node()} has another hydro_env or other versions of Python, NumPy, SciPy or "
            f"Numba (fingerprint {fingerprint()}, here {expected}); install the same there"
        )
    return _answer(pickle.loads(function), task)


def _cluster() -> tuple[Any, bool]:
    """Ray, joined to a cluster, and whether it was us who joined it. InputError if that is not possible."""
    try:
        import ray
    except ImportError:
        raise InputError(f"engine ray: this needs ray: {to_install('ray')}") from None
    if ray.is_initialized():
        return ray, False
    address = os.environ.get("RAY_ADDRESS") or "auto"
    try:
        latest = Path(
            os.environ.get("RAY_TMPDIR", "/tmp"), "ray", "ray_current_cluster"
        )  # as `ray start` left it
        if address == "auto" and latest.is_file():
            _knock(latest.read_text(encoding="utf-8").strip())
        elif address != "auto":
            _knock(address)
        ray.init(address=address, log_to_driver=False, logging_level=logging.ERROR)
    except (
        Exception
    ) as problem:  # ConnectionError, RuntimeError, ValueError: as many as there are ways to fail
        ray.shutdown()
        where = "" if address == "auto" else f" at RAY_ADDRESS={address}"
        raise InputError(
            f"engine ray: no Ray cluster answers{where}; start one with `ray start --head`, or name one in RAY_ADDRESS"
        ) from problem
    return ray, True


def _knock(address: str) -> None:
    """OSError or ValueError if nobody listens at `host:port`, where Ray itself would go on trying for many minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), timeout=10.0):
        pass

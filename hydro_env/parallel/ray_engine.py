"""A Ray cluster: the way past one machine. Ray runs a task again whose worker or node dies, and cancels what is stopped."""

import contextlib
import logging
import os
import pickle
import platform
import socket
import sys
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from hydro_env.errors import InputError, described, to_install

from .store import fingerprint
from .tasks import ATTEMPTS, Failure, answer, died, unsendable


def on_ray(tasks: Sequence[Any], function: Callable[[Any], Any]) -> Generator[tuple[int, Any], None, None]:
    """Place and result of every task as they get done by a cluster. Closing it cancels the others."""
    ray, ours = _cluster()
    # Not again when the function raises: `answer` catches that.
    remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1, retry_exceptions=False)(_remote)
    places: dict[Any, int] = {}
    try:
        work = ray.put((ray.cloudpickle.dumps(function), os.getcwd(), list(sys.path), fingerprint()))
        for place, task in enumerate(tasks):
            try:
                places[remote.remote(work, ray.cloudpickle.dumps(task))] = place
            except Exception as problem:
                yield place, unsendable("the cluster", problem)
        while places:
            (done, *_), _ = ray.wait(list(places), num_returns=1)
            try:
                result = pickle.loads(ray.get(done))
            except ray.exceptions.RayError as problem:
                result = _failure(ray, problem)
            yield places.pop(done), result
    finally:
        for reference in places:  # the work was stopped
            with contextlib.suppress(Exception):
                ray.cancel(reference, force=True)
        if ours:
            ray.shutdown()


def _failure(ray: Any, problem: Exception) -> Failure:
    if not isinstance(problem, ray.exceptions.RayTaskError):
        return died(f"by {type(problem).__name__}")
    cause = problem.cause if isinstance(problem.cause, BaseException) else problem
    if isinstance(cause, InputError):  # another hydro_env over there: no result would be worth anything
        raise InputError(str(cause)) from None
    return Failure(described(cause))


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
    return answer(pickle.loads(function), task)


def _cluster() -> tuple[Any, bool]:
    """Ray, joined to a cluster, and whether it was us who joined it. InputError if that is not possible."""
    try:
        import ray
    except ImportError:
        raise InputError(f"engine ray: this needs ray: {to_install('ray')}") from None
    if ray.is_initialized():
        return ray, False
    address = os.environ.get("RAY_ADDRESS", "").removeprefix("auto")
    try:
        # The address that `ray start` left here; an OSError if there is none.
        left = Path(os.environ.get("RAY_TMPDIR", "/tmp"), "ray", "ray_current_cluster")
        _knock(address or left.read_text(encoding="utf-8").strip())
        ray.init(address=address or "auto", log_to_driver=False, logging_level=logging.ERROR)
    except Exception as problem:  # ConnectionError, RuntimeError, ValueError: as many as ways to fail
        ray.shutdown()
        where = f" at RAY_ADDRESS={address}" if address else ""
        raise InputError(
            f"engine ray: no Ray cluster answers{where}; start one with `ray start --head`, or name one in RAY_ADDRESS"
        ) from problem
    return ray, True


def _knock(address: str) -> None:
    """OSError or ValueError if nobody listens at `host:port`, where Ray itself would go on trying for many minutes."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    with socket.create_connection((host.strip("[]"), int(port)), timeout=10.0):
        pass

"""Results of finished tasks in a folder, so that a run that was stopped resumes where it was."""

import hashlib
import pickle
import platform
from collections.abc import Callable
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

from hydro_env.errors import InputError
from hydro_env.files import write_bytes
from hydro_env.pickles import distrust, sign, verified

PACKAGE = Path(__file__).parents[1]


@cache
def fingerprint() -> str:
    """Changes with everything of ours that a result may depend on: code and data of hydro_env, and the versions of
    what computes. (Not with the kind of CPU.)
    """
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in {".py", ".yaml", ".json", ".npz"} and path.is_file():
            digest.update(f"{path.relative_to(PACKAGE).as_posix()}\0".encode())
            digest.update(hashlib.sha256(path.read_bytes()).digest())
    versions = [metadata.version(name) for name in ("numpy", "scipy", "numba")]
    digest.update(" ".join([platform.python_version(), platform.machine(), *versions]).encode())
    return digest.hexdigest()[:16]


class Store:
    """A folder of results.

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
            return default if path is None else pickle.loads(verified(path.read_bytes()))
        except Exception:  # none yet, or damaged: it is computed again
            return default

    def put(self, task: Any, result: Any) -> None:
        """Keeps a result."""
        path = self._path(task)
        if path is not None:
            write_bytes(path, sign(pickle.dumps(result)))

    def _path(self, task: Any) -> Path | None:
        key = self._key(task)
        if key is None:
            return None
        return self.folder / f"{hashlib.sha256(f'{fingerprint()} {key}'.encode()).hexdigest()[:32]}.pickle"

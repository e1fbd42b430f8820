"""One run at a time in a folder."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from hydro_env.errors import InputError


@contextmanager
def alone_in(folder: Path) -> Iterator[None]:
    """Makes a folder, if need be, and keeps other processes that ask for it out of it until the block ends.

    The operating system holds the lock and frees it when the process ends, however that happens. A folder that was made here
    and is empty at the end is removed.

    Raises InputError if another process is in the folder.
    """
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / ".lock"
    lock = FileLock(path)
    try:
        lock.acquire(blocking=False)
    except Timeout:
        owner = "another process"
        with suppress(OSError):  # Windows lets nobody read a locked file
            owner = path.read_text(encoding="utf-8") or owner
        raise InputError(f"{folder}: {owner} trains here; wait for its end, or name another folder") from None
    try:
        with suppress(OSError):  # Windows, or a full disk: the lock holds, only its owner has no name
            path.write_text(f"process {os.getpid()} on {socket.gethostname()}", encoding="utf-8")
        yield
    finally:
        lock.release()
        with suppress(OSError):
            if missing and [each.name for each in folder.iterdir()] == [path.name]:
                path.unlink()
                for made in missing:
                    made.rmdir()

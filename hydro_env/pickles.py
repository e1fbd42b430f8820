"""Pickles in files: loaded only if they are whole and nobody but this user can have written them.

A pickle runs code when it is loaded, and a damaged one may load as something else. What hydro_env keeps as a pickle
(machine code, results of finished tasks, checkpoints) therefore carries a checksum and lies in a folder of the user.
"""

import hashlib
import os
import stat
from pathlib import Path

_LENGTH = hashlib.sha256().digest_size


class Damaged(ValueError):
    """Bytes that are not what was written."""


def sign(content: bytes) -> bytes:
    """The content behind its SHA-256 checksum."""
    return hashlib.sha256(content).digest() + content


def verified(data: bytes) -> bytes:
    """The content that `sign` was given. Damaged if a byte has changed or is missing."""
    content = data[_LENGTH:]
    if hashlib.sha256(content).digest() != data[:_LENGTH]:
        raise Damaged("its content does not match its checksum")
    return content


def distrust(path: Path) -> str:
    """Why others may have written a file or into a folder, with what to do; empty if only this user and root could.

    The rule is that of OpenSSH for its keys (`StrictModes`): owner and permissions of the file or folder itself.
    Systems without owners (Windows) are not checked.

    Raises OSError if there is nothing of that name.
    """
    found = path.stat()
    if not hasattr(os, "geteuid"):
        return ""
    if found.st_uid not in (0, os.geteuid()):
        return "it belongs to another user; copy it if you trust that user"
    if found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return f"other users can write there; if none has, `chmod go-w {path}`"
    return ""

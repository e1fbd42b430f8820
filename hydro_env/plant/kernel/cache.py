"""Generated modules are kept in the user's cache under a hash of their text: written once, and never stale."""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from pathlib import Path
from types import ModuleType

__all__ = ["import_text"]


def _folder() -> Path:
    """Where generated kernels are kept: $HYDRO_ENV_CACHE, else the user's cache, else a temporary folder."""
    named = os.environ.get("HYDRO_ENV_CACHE")
    base = (
        Path(named)
        if named
        else Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hydro_env"
    )
    try:
        base.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=base):
            pass
    except OSError:
        base = Path(tempfile.gettempdir()) / f"hydro_env_{os.getuid() if hasattr(os, 'getuid') else 'cache'}"
        base.mkdir(parents=True, exist_ok=True)
    return base


def import_text(text: str) -> ModuleType:
    """The module with this text, imported from the cache, where it is put if it is not there yet."""
    name = "kernel_" + hashlib.sha256(text.encode()).hexdigest()[:16]
    path = _folder() / f"{name}.py"
    if not path.exists() or path.read_text() != text:
        handle, temporary = tempfile.mkstemp(dir=path.parent, suffix=".tmp")
        with os.fdopen(handle, "w") as file:
            file.write(text)
        os.replace(temporary, path)
    specification = importlib.util.spec_from_file_location(name, path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    sys.modules[name] = module  # the compiler's cache looks its functions up there
    specification.loader.exec_module(module)
    return module

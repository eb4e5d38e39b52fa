"""numba's decorator with a private cache on disk.

Compiled code is stored below the user's own cache folder, readable by that user alone, and keyed by the
versions involved.  Where no such folder can be had, functions are compiled again in each process.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from collections.abc import Callable
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


#: files with compiled code, or with numbers that it takes in
_SOURCES = ("compiled", "events", "faces", "incoming", "kernel", "searches", "step", "tracked", "vectors")


@lru_cache(maxsize=1)
def _sources() -> str:
    """Fingerprint of every compiled source: numba itself looks at the file of the outermost function alone."""
    digest = hashlib.sha256(f"{sys.version_info[:3]} {metadata.version('numba')}".encode())
    for name in _SOURCES:
        digest.update(Path(__file__).with_name(f"{name}.py").read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path | None:
    """A folder for compiled code that belongs to this user and to nobody else, or None."""
    if "NUMBA_CACHE_DIR" in os.environ:
        return Path(os.environ["NUMBA_CACHE_DIR"])
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "uqsphere" / f"compiled-{_sources()}"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        status = folder.stat()
        if hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)):
            return None
        probe = folder / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError:
        return None
    return folder


def compiled(**options: Any) -> Callable[[Function], Function]:
    """``numba.njit`` that releases the GIL and keeps its result on disk; never fastmath, which breaks isnan."""
    import numba

    folder = cache_folder()
    if folder is not None:
        setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010 - numba makes its settings at run time
    decorator: Callable[[Function], Function] = numba.njit(
        cache=folder is not None, nogil=True, error_model="numpy", **options
    )
    return decorator

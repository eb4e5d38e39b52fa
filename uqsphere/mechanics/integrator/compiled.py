"""numba's decorator with a private cache on disk.

Compiled code is stored below the user's own cache folder, readable by that user alone, and keyed by
the versions involved.  Where no such folder can be had, functions are compiled again in each
process.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import stat
import sys
from collections.abc import Callable
from functools import lru_cache, partial
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Any

#: may be written by others
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


@lru_cache(maxsize=1)
def _sources() -> str:
    """Fingerprint of every compiled source: numba itself looks at the file of the outermost
    function alone.
    """
    digest = sha256(f"{sys.version_info[:3]} {metadata.version('numba')}".encode())
    room = Path(__file__).parent
    for source in [*sorted(room.glob("*.py")), room.parent / "yielding.py"]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path | None:
    """A folder for compiled code that belongs to this user and to nobody else, or that they named;
    None without.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        base = Path(os.environ["NUMBA_CACHE_DIR"])
    elif sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = base / "uqsphere" / f"compiled-{_sources()}"
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        status = folder.stat()
        foreign = hasattr(os, "getuid") and (
            status.st_uid != os.getuid() or status.st_mode & _BY_OTHERS
        )
        if foreign and "NUMBA_CACHE_DIR" not in os.environ:
            return None
        probe = folder / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError:
        return None
    return folder


def _cache_in(folder: Path, function: Any) -> None:
    """Keep what numba compiles in files that begin with a checksum of their name and content.

    What is damaged or foreign is compiled anew; what cannot be written, by the next process.  The
    folder goes by the sources, so that no file is out of date.
    """
    from numba.core.compiler import CompileResult
    from numba.core.serialize import dumps

    class Cache:
        cache_path = str(folder)

        def place(self, signature: object, codegen: Any) -> Path:
            key = repr((function.__module__, signature, codegen.magic_tuple()))
            return folder / f"{function.__name__}-{sha256(key.encode()).hexdigest()[:16]}.nbc"

        def load_overload(self, signature: object, target: Any) -> Any:
            path = self.place(signature, target.codegen())
            with contextlib.suppress(Exception):  # what is not ours raises as it likes
                content = path.read_bytes()
                if sha256(path.name.encode() + content[32:]).digest() == content[:32]:
                    return CompileResult._rebuild(target, *pickle.loads(content[32:]))
            return None

        def save_overload(self, signature: object, result: Any) -> None:
            path = self.place(signature, result.codegen)
            content = dumps(result._reduce())
            beside = path.with_suffix(f".{os.getpid()}")
            try:
                beside.write_bytes(sha256(path.name.encode() + content).digest() + content)
                os.replace(beside, path)
            except OSError:
                with contextlib.suppress(OSError):
                    beside.unlink()

    function._cache = Cache()


def compiled(
    function: Callable[..., Any] | None = None, *, entry: bool = False, inline: bool = False
) -> Any:
    """``numba.njit`` that releases the GIL and keeps its result on disk; of fastmath no more than
    fused multiplication and addition.

    entry: whether Python calls it, too; others need no way in from there.  inline: written into
    the one function that calls it, by which a step takes a twentieth less.
    """
    if function is None:
        return partial(compiled, entry=entry, inline=inline)
    import numba

    # nothing is allocated in compiled code, so that numba need not count the owners of arrays
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"contract"},
        "_nrt": False,
        "no_rewrites": True,
    }
    if inline:
        options["inline"] = "always"
    folder = None
    if entry:
        folder = cache_folder()
    else:
        options |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    result: Any = numba.njit(**options)(function)
    if folder is not None:
        _cache_in(folder, result)
    return result

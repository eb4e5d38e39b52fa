"""numba's decorator with a private cache on disk.

Compiled code is stored below the user's own cache folder, readable by that user alone, and keyed by the
versions involved.  Where no such folder can be had, functions are compiled again in each process.
"""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import pickle
import stat
import subprocess
import sys
from collections.abc import Callable, Iterable
from functools import lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, TypeVar, cast

Function = TypeVar("Function", bound=Callable[..., Any])


#: files with compiled code, or with numbers that it takes in
_SOURCES = ("branches", "compiled", "events", "faces", "incoming", "kernel", "searches", "step", "tracked", "vectors")
#: may be written by others
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH
#: what a process beside this one does at the first run ever
_PARTS = "from uqsphere.mechanics.integrator import compiled, kernel; compiled.compile_parts(kernel.PARTS)"


@lru_cache(maxsize=1)
def _sources() -> str:
    """Fingerprint of every compiled source: numba itself looks at the file of the outermost function alone."""
    digest = hashlib.sha256(f"{sys.version_info[:3]} {metadata.version('numba')}".encode())
    for name in _SOURCES:
        digest.update(Path(__file__).with_name(f"{name}.py").read_bytes())
    return digest.hexdigest()[:16]


def cache_folder() -> Path | None:
    """A folder for compiled code that belongs to this user and to nobody else, or that they named; None without."""
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
        foreign = hasattr(os, "getuid") and (status.st_uid != os.getuid() or status.st_mode & _BY_OTHERS)
        if foreign and "NUMBA_CACHE_DIR" not in os.environ:
            return None
        probe = folder / f".probe-{os.getpid()}"
        probe.touch()
        probe.unlink()
    except OSError:
        return None
    return folder


def _keep(folder: Path, function: Any) -> None:
    """Keep what numba compiles in files that begin with a checksum of their name and content.

    What is damaged or foreign is compiled anew; what cannot be written, by the next process.  The folder goes by the
    sources, so that no file is out of date.
    """
    from numba.core.caching import IndexDataCacheFile
    from numba.core.serialize import dumps

    class Kept(IndexDataCacheFile):
        def place(self, key: object) -> Path:
            return folder / f"{function.__name__}-{hashlib.sha256(repr((base, key)).encode()).hexdigest()[:16]}.nbc"

        def load(self, key: object) -> Any:
            path = self.place(key)
            with contextlib.suppress(Exception):  # what is not ours raises as it likes
                content = path.read_bytes()
                if hashlib.sha256(path.name.encode() + content[32:]).digest() == content[:32]:
                    return pickle.loads(content[32:])
            return None

        def save(self, key: object, data: object) -> None:
            path, content = self.place(key), dumps(data)
            beside = path.with_suffix(f".{os.getpid()}")
            try:
                beside.write_bytes(hashlib.sha256(path.name.encode() + content).digest() + content)
                os.replace(beside, path)
            except OSError:
                with contextlib.suppress(OSError):
                    beside.unlink()

    base = function._cache._impl.filename_base
    function._cache._cache_file = Kept(str(folder), base, None)


class Beside:
    """A process of its own that compiles parts of the kernel into the cache while this one compiles the rest.

    It says which parts are done, one in a line.  Where it cannot be had, or is lost, this process compiles them too.
    """

    def __init__(self) -> None:
        self.begun, self.done = False, set[str]()
        self.process: subprocess.Popen[str] | None = None

    def begin(self) -> None:
        """Start it, once, where a processor is left for it and its code is kept for this process to read."""
        own = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        if self.begun or own < 2 or cache_folder() is None:
            return
        self.begun = True
        paths = os.pathsep.join(path for path in sys.path if path)
        with contextlib.suppress(OSError):
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-c", _PARTS], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL, text=True, env={**os.environ, "PYTHONPATH": paths},
            )  # fmt: skip
            atexit.register(self.end)

    def wait(self, part: str) -> None:
        """Until it has compiled a part, or has ended."""
        while self.process and self.process.stdout and part not in self.done:
            line = self.process.stdout.readline()
            if not line:
                self.end()
            self.done.add(line.strip())

    def end(self) -> None:
        """Nothing is left of it."""
        if self.process:
            self.process.kill()
            self.process.communicate()
            self.process = None


beside = Beside()


@lru_cache(maxsize=1)
def _begin_with_numba() -> None:
    """Have `beside` begin with the first function that is compiled: the kernel is read for long before it calls one."""
    from numba.core import event

    class Begin(event.Listener):
        def on_start(self, event: object) -> None:
            beside.begin()

        def on_end(self, event: object) -> None:
            pass

    event.register("numba:compile", Begin())


def compile_parts(parts: Iterable[tuple[Any, str]]) -> None:
    """Compile parts of the kernel into the cache (`kernel.PARTS`), and say each that is done."""
    from numba import types

    kinds = {"i": types.int64, "f": types.float64, "b": types.boolean, "n": types.int64[::1]}
    kinds |= {f"{n}": types.Array(types.float64, n, "C") for n in (1, 2, 3)}
    beside.begun = True
    for function, given in parts:
        function.compile(tuple(kinds[kind] for kind in given))
        print(function.__name__, flush=True)


def compiled(part: bool = False, **options: Any) -> Callable[[Function], Function]:
    """``numba.njit`` that releases the GIL and keeps its result on disk; never fastmath, which breaks isnan.

    part: whether it is one of `kernel.PARTS`.
    """
    import numba

    folder = cache_folder()
    if folder is not None:
        setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010 - numba makes its settings at run time
    _begin_with_numba()
    decorate = numba.njit(cache=folder is not None, nogil=True, error_model="numpy", **options)

    def once(function: Function) -> Function:
        """The function, compiled once for all numbers of a kind: numba would compile it anew for every constant."""
        found = decorate(function)
        if folder is not None:
            _keep(folder, found)
        ask = found.get_call_template

        def answer(given: Iterable[Any], named: Any) -> Any:
            if part:
                beside.wait(function.__name__)
            return ask([numba.types.unliteral(kind) for kind in given], named)

        found.get_call_template = answer
        return cast("Function", found)

    return once

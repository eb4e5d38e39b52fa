"""numba's decorator with a private cache on disk.

Compiled code is stored below the user's own cache folder, readable by that user alone, and keyed by
the versions involved.  Where no such folder can be had, functions are compiled again in each
process.
"""

from __future__ import annotations

import contextlib
import gc
import os
import pickle
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from functools import lru_cache
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

#: files with compiled code, or with numbers that it takes in
_SOURCES = (
    "branches",
    "compiled",
    "events",
    "faces",
    "incoming",
    "kernel",
    "records",
    "searches",
    "step",
    "tracked",
    "vectors",
)
#: versions of numba whose inside `_compilers` knows
_TRIED = ("0.68.",)
#: may be written by others
_BY_OTHERS = stat.S_IWGRP | stat.S_IWOTH


@lru_cache(maxsize=1)
def _sources() -> str:
    """Fingerprint of every compiled source: numba itself looks at the file of the outermost
    function alone.
    """
    digest = sha256(f"{sys.version_info[:3]} {metadata.version('numba')}".encode())
    for name in _SOURCES:
        digest.update(Path(__file__).with_name(f"{name}.py").read_bytes())
    digest.update((Path(__file__).parent.parent / "yielding.py").read_bytes())
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


def _keep(folder: Path, function: Any) -> None:
    """Keep what numba compiles in files that begin with a checksum of their name and content.

    What is damaged or foreign is compiled anew; what cannot be written, by the next process.  The
    folder goes by the sources, so that no file is out of date.
    """
    from numba.core.caching import IndexDataCacheFile
    from numba.core.serialize import dumps

    class Kept(IndexDataCacheFile):
        def place(self, key: object) -> Path:
            return (
                folder
                / f"{function.__name__}-{sha256(repr((base, key)).encode()).hexdigest()[:16]}.nbc"
            )

        def load(self, key: object) -> Any:
            path = self.place(key)
            with contextlib.suppress(Exception):  # what is not ours raises as it likes
                content = path.read_bytes()
                if sha256(path.name.encode() + content[32:]).digest() == content[:32]:
                    return pickle.loads(content[32:])
            return None

        def save(self, key: object, data: object) -> None:
            path, content = self.place(key), dumps(data)
            beside = path.with_suffix(f".{os.getpid()}")
            try:
                beside.write_bytes(sha256(path.name.encode() + content).digest() + content)
                os.replace(beside, path)
            except OSError:
                with contextlib.suppress(OSError):
                    beside.unlink()

    base = function._cache._impl.filename_base
    function._cache._cache_file = Kept(str(folder), base, None)


@lru_cache(maxsize=1)
def _compilers() -> tuple[Any, Any] | None:
    """numba's compiler of inner functions, and of those that Python calls; None for a numba it was
    not tried with.

    numba optimises and translates every function with all that it calls, so that what is at the
    bottom goes through LLVM a dozen times: half of the time of a first run.  Here an inner function
    is optimised by itself, and the outermost one takes in all that it reaches and translates it
    once.  Another numba compiles in its own, slower way.
    """
    if not metadata.version("numba").startswith(_TRIED):
        return None
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler, Flags

    class Library(JITCodeLibrary):
        outermost = False

        def finalize(self) -> None:
            if self.outermost:
                for (
                    one
                ) in self._linking_libraries:  # which grows to all that is called at any depth
                    known = self._linking_libraries
                    known += [other for other in one._linking_libraries if other not in known]
                super().finalize()
            else:
                self._optimize_final_module()
                self._finalize_dynamic_globals()
                self._finalized = True

        def _optimize_functions(
            self, module: Any
        ) -> None:  # the passes over the module do the same again
            module.data_layout = self._codegen._data_layout

        def get_pointer_to_function(self, name: str) -> int:
            return int(super().get_pointer_to_function(name)) if self.outermost else 0

        @property
        def codegen(self) -> Any:
            return (
                super().codegen if self.outermost else SimpleNamespace(set_env=lambda *given: None)
            )

    class Settings(Flags):
        """Looked up with every operation: compared by a text that is made once."""

        text = ""

        def __hash__(self) -> int:
            self.text = self.text or str(self.values())
            return hash(self.text)

        def __eq__(self, other: object) -> bool:
            return self is other or (isinstance(other, Settings) and hash(self) == hash(other))

    class Inner(Compiler):
        outermost = False

        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(*given, **named)
            library = Library(self.state.targetctx.codegen(), "uqsphere")
            library.enable_object_caching()
            library.outermost = self.outermost
            self.state.library, self.state.flags = library, Settings(self.state.flags)

    class Outermost(Inner):
        outermost = True

        def compile_extra(self, function: Any) -> Any:
            collects = gc.isenabled()
            # what numba makes lives to the end: looking for what does not takes a tenth of the time
            gc.disable()
            try:
                return super().compile_extra(function)
            finally:
                if collects:
                    gc.enable()

    return Inner, Outermost


@contextlib.contextmanager
def _cache_in(folder: Path) -> Iterator[None]:
    """numba's own folder for compiled code, while one function is prepared for it."""
    import numba

    before = getattr(numba.config, "CACHE_DIR")  # noqa: B009
    setattr(numba.config, "CACHE_DIR", str(folder))  # noqa: B010 - made at run time
    try:
        yield
    finally:
        setattr(numba.config, "CACHE_DIR", before)  # noqa: B010


def compiled(
    function: Callable[..., Any] | None = None, *, entry: bool = False, **options: Any
) -> Any:
    """``numba.njit`` that releases the GIL and keeps its result on disk; never fastmath, which
    breaks isnan.

    entry: whether Python calls it, too; others need no way in from there.
    """
    if function is None:
        return lambda wrapped: compiled(wrapped, entry=entry, **options)
    import numba

    folder = cache_folder()
    # nothing is allocated in compiled code, so that numba need not count the owners of arrays
    options |= {"nogil": True, "error_model": "numpy", "_nrt": False}
    if (compilers := _compilers()) is not None:
        options["pipeline_class"] = compilers[entry]
    options |= (
        {"cache": folder is not None}
        if entry
        else {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    )
    made: Any
    if entry and folder is not None:
        with _cache_in(folder):
            made = numba.njit(**options)(function)
    else:
        made = numba.njit(**options)(function)
    if folder is not None and entry:
        _keep(folder, made)
    ask = made.get_call_template

    def once(given: Iterable[Any], named: Any) -> Any:
        """Compiled once for all numbers of a kind: numba would compile it anew for every
        constant.
        """
        return ask([numba.types.unliteral(kind) for kind in given], named)

    made.get_call_template = once
    return made

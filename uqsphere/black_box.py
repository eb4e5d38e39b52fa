"""The user's own model: loading its file, calling it, telling its states apart, and where it prints."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.errors import AccessError, ModelError, ModelRaised, ModelUnfit, UsageError, told
from uqsphere.files import read_given

if TYPE_CHECKING:
    from types import FunctionType

BlackBox = Callable[[dict[str, npt.NDArray[np.float64]]], Mapping[str, Any]]

#: bytes of a model's file: what is larger is no source
LARGEST_MODEL: Final = 16 << 20

#: folders of packages, wherever an installation has them
_INSTALLED: Final = frozenset(("site-packages", "dist-packages"))

_redirect_lock = threading.Lock()
_redirected = contextlib.ExitStack()
_depth = 0
#: forks of this process so far: a model that forks at every call is told of once
_forks = 0


def _count_fork() -> None:
    global _forks
    _forks += 1


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_parent=_count_fork)


@contextlib.contextmanager
def prints_to_stderr() -> Iterator[None]:
    """stdout carries results only: what a model, its libraries and its children print goes the way of diagnostics.

    Descriptor 1 and sys.stdout belong to the whole process: of several threads the first turns them aside and
    the last gives them back, or one would restore what another had turned.
    """
    global _depth
    with _redirect_lock:
        if _depth == 0:
            _redirected.enter_context(_aside())
        _depth += 1
    try:
        yield
    finally:
        with _redirect_lock:
            _depth -= 1
            if _depth == 0:
                _redirected.close()


@contextlib.contextmanager
def _aside() -> Iterator[None]:
    """Descriptor 1 is a copy of 2, or of nowhere where there is no 2; what C has printed goes where it was printed."""
    _flush()
    try:
        kept = os.dup(1)
    except OSError:
        kept = None  # there is no stdout to be kept clean
    else:
        try:
            os.dup2(2, 1)
        except OSError:
            with open(os.devnull, "wb") as nowhere:
                os.dup2(nowhere.fileno(), 1)
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        if kept is not None:
            _flush()
            os.dup2(kept, 1)
            os.close(kept)


def _flush() -> None:
    """Have Python's stdout and C's written out."""
    import ctypes

    with contextlib.suppress(AttributeError, OSError, ValueError):
        sys.stdout.flush()
    if os.name == "posix":
        ctypes.CDLL(None).fflush(None)


@contextlib.contextmanager
def _at_work(name: str) -> Iterator[None]:
    """While the model's own code runs: its output goes to stderr, and what it has forked does not come back."""
    process = os.getpid()
    with prints_to_stderr():
        try:
            yield
        finally:
            if os.getpid() != process:
                if _forks == 0:
                    text = (
                        f"the model {name} forked a process that came back from its call; it was ended there, and its"
                    )
                    with contextlib.suppress(OSError):
                        os.write(2, f"uqsphere: {text} answer is not taken. What a model forks ends itself\n".encode())
                os._exit(1)


def call_black_box(box: BlackBox, given: dict[str, npt.NDArray[np.float64]]) -> object:
    """What the model answers to n rows, given as columns (n,) by their names.

    Raises ModelRaised with what the model raised, and where; ModelUnfit where no call can answer.
    """
    try:
        with _at_work(told(getattr(box, "__qualname__", type(box).__name__), 60)):
            return box(given)
    except ModelUnfit:
        raise
    except (Exception, SystemExit) as error:
        raise ModelRaised(f"the model raised {type(error).__name__}: {told(error)}{where_raised(error)}") from error


def checked_reference(reference: str) -> tuple[Path, str]:
    """File and function of ``FILE.py:FUNCTION``; no function of ``FILE.toml``, which declares a program or a server.

    Raises UsageError when the reference is malformed; AccessError when there is no such file.
    """
    file, _, name = reference.rpartition(":")
    if reference.endswith(".toml"):
        file, name = reference, ""
    elif not file.endswith(".py") or not name.isidentifier():
        raise UsageError(
            f"--model takes FILE.py:FUNCTION, or FILE.toml with a program or a server, found {reference!r}"
        )
    if not Path(file).is_file():
        raise AccessError(f"the model file {file} does not exist")
    return Path(file), name


def load_black_box(reference: str) -> BlackBox:
    """The function that ``FILE.py:FUNCTION`` names, or the program or server that ``FILE.toml`` declares.

    This runs the file, or what it names: it is the only way to run foreign code.

    Raises UsageError when the reference is malformed or the function is not there; AccessError when the file cannot be
    read.
    """
    import importlib.util
    from importlib.machinery import SourceFileLoader

    path, name = checked_reference(reference)
    if not name:
        from uqsphere.external import load_external

        return load_external(path)
    spec = importlib.util.spec_from_file_location(f"uqsphere_black_box_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{path} cannot be loaded as a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        with _at_work(told(path.name, 60)):
            if isinstance(spec.loader, SourceFileLoader):
                # the file as it is now: bytecode beside it may be that of the same second
                exec(spec.loader.source_to_code(spec.loader.get_data(str(path)), str(path)), module.__dict__)
            else:
                spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ModelError(
            f"{path} raised {type(error).__name__} on loading: {told(error)}{where_raised(error)}"
        ) from error
    function = getattr(module, name, None)
    if not callable(function):
        raise UsageError(f"{path} has no function {name!r}")
    return function  # type: ignore[no-any-return]


def where_raised(error: BaseException) -> str:
    """Where in the user's code an exception began: " (bad.py, line 3)", or nothing where that is not known.

    Frames of this package, of the standard library and of what is installed are left out: nobody is to mend those.
    """
    import sysconfig
    import traceback

    rooms = {Path(__file__).parent, *(Path(sysconfig.get_path(key)) for key in ("stdlib", "purelib", "platlib"))}
    frames = [
        f
        for f in traceback.extract_tb(error.__traceback__)
        if not f.filename.startswith("<")
        and rooms.isdisjoint(Path(f.filename).parents)
        and _INSTALLED.isdisjoint(Path(f.filename).parts)
    ]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""


def model_digest(model: str | BlackBox) -> str:
    """What tells one black box from another: a digest of its file and function, or of the function's own source with
    the values that it takes from outside: defaults, closures and globals, functions among them.

    What the model reads or imports besides is not seen, nor lists, tables and objects, which may be counters or caches:
    a run that is gone on with evaluates a stored row again for those.
    """
    import hashlib

    if isinstance(model, str):
        path, name = checked_reference(model)
        if not name:
            from uqsphere.external import external_digest

            return external_digest(path)
        source = read_given(path, LARGEST_MODEL)
    else:
        name = f"{getattr(model, '__module__', '')}.{getattr(model, '__qualname__', type(model).__qualname__)}"
        source = b"\0".join(_parts_of(model, set()))
    return hashlib.sha256(source + b"\0" + name.encode()).hexdigest()[:16]


def _parts_of(value: object, seen: set[int]) -> Iterator[bytes]:
    """What a model, or a value that one takes from outside, is made of: sources, and values that cannot change.

    What can change (lists, tables, the attributes of an object, names that a function gives values to) may be a counter
    or a cache, and is left out.
    """
    import functools
    from types import FunctionType, MethodType

    if id(value) in seen:
        return
    seen.add(id(value))
    if isinstance(value, (bool, int, float, complex, str, bytes, np.generic)):
        yield repr(value).encode()
    elif isinstance(value, np.ndarray):
        yield f"{value.dtype}{value.shape}".encode() + np.ascontiguousarray(value).tobytes()
    elif isinstance(value, tuple):
        for part in value:
            yield from _parts_of(part, seen)
    elif isinstance(value, functools.partial):
        yield from _parts_of((value.func, *value.args, *sorted(value.keywords.items())), seen)
    elif isinstance(value, MethodType):
        yield from _parts_of(value.__func__, seen)
    elif isinstance(value, FunctionType):
        yield from _parts_of_function(value, seen)
    elif callable(value) and isinstance(getattr(type(value), "__call__", None), FunctionType):  # noqa: B004
        yield from _parts_of(type(value).__call__, seen)


def _parts_of_function(function: FunctionType, seen: set[int]) -> Iterator[bytes]:
    """Its source, what it takes from outside but for the names that it gives values to, and its defaults."""
    import dis
    import inspect

    with contextlib.suppress(OSError, TypeError):
        yield inspect.getsource(function).encode()
    outside = inspect.getclosurevars(function)
    counters = {
        step.argval for step in dis.get_instructions(function) if step.opname in ("STORE_DEREF", "STORE_GLOBAL")
    }
    for name, part in sorted({**outside.globals, **outside.nonlocals}.items()):
        if name not in counters:
            yield name.encode()
            yield from _parts_of(part, seen)
    yield from _parts_of((*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).items()), seen)

"""The user's own model: loading its file, telling its states apart, and where it prints."""

from __future__ import annotations

import contextlib
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from uqsphere.errors import AccessError, ModelError, UsageError

BlackBox = Callable[[dict[str, npt.NDArray[np.float64]]], Mapping[str, Any]]

_redirect_lock = threading.Lock()
_redirected: list[contextlib.redirect_stdout[Any]] = []
_depth = 0


@contextlib.contextmanager
def prints_to_stderr() -> Iterator[None]:
    """stdout carries results only: whatever a black box prints goes the way of diagnostics.

    sys.stdout belongs to the whole process: of several threads the first redirects it and the last gives
    it back, or one would restore what another had redirected.
    """
    global _depth
    with _redirect_lock:
        if _depth == 0:
            _redirected.append(contextlib.redirect_stdout(sys.stderr))
            _redirected[-1].__enter__()
        _depth += 1
    try:
        yield
    finally:
        with _redirect_lock:
            _depth -= 1
            if _depth == 0:
                _redirected.pop().__exit__(None, None, None)


def load_black_box(reference: str) -> BlackBox:
    """The function that ``FILE.py:FUNCTION`` names.  This runs the file: it is the only way to run foreign code.

    Raises
    ------
    UsageError
        When the reference is malformed or the function is not there.
    AccessError
        When the file cannot be read.
    """
    import importlib.util

    file, separator, name = reference.rpartition(":")
    if not separator or not file.endswith(".py") or not name.isidentifier():
        raise UsageError(f"--model takes FILE.py:FUNCTION, found {reference!r}")
    path = Path(file)
    if not path.is_file():
        raise AccessError(f"the model file {file} does not exist")
    spec = importlib.util.spec_from_file_location(f"uqsphere_black_box_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise UsageError(f"{file} cannot be loaded as a Python file")
    module = importlib.util.module_from_spec(spec)
    try:
        with prints_to_stderr():
            spec.loader.exec_module(module)
    except (Exception, SystemExit) as error:
        raise ModelError(f"{file} raised {type(error).__name__} on loading: {error}{where_raised(error)}") from error
    function = getattr(module, name, None)
    if not callable(function):
        raise UsageError(f"{file} has no function {name!r}")
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
        if not f.filename.startswith("<") and rooms.isdisjoint(Path(f.filename).parents)
    ]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""


def model_digest(model: str | BlackBox) -> str:
    """What tells one black box from another: a digest of its file and function, or of the function's own source.

    What the model reads or imports besides is not seen.
    """
    import hashlib
    import inspect

    if isinstance(model, str):
        file, _, name = model.rpartition(":")
        try:
            source = Path(file).read_bytes()
        except OSError as error:
            raise AccessError(f"the model file {file}: {error.strerror}") from error
    else:
        name = f"{getattr(model, '__module__', '')}.{getattr(model, '__qualname__', type(model).__qualname__)}"
        try:
            source = inspect.getsource(model).encode()
        except (OSError, TypeError):
            source = b""
    return hashlib.sha256(source + b"\0" + name.encode()).hexdigest()[:16]

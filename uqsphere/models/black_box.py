"""A model of the user's own: load it, call it for many rows at once, check what it returns, and tell two apart."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import inspect
import re
import sys
import sysconfig
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, ModelRaised, UsageError, told

#: takes columns (n,) by the names of the inputs; returns columns (n,) by the names of the outputs as a dict or a
#: DataFrame, an array (n, outputs) in the order of the study's outputs, or (n,) where there is one output
BlackBox = Callable[[dict[str, Array]], Any]

#: what is the model's own fault; Ctrl-C too in a process that nobody interrupts (`workers`)
FAULTS: tuple[type[BaseException], ...] = (Exception, SystemExit)
#: folders of packages, wherever an installation has them
_INSTALLED: Final = frozenset(("site-packages", "dist-packages"))


def parse_reference(reference: str) -> tuple[Path, str]:
    """File and function of "FILE.py:FUNCTION".

    Raises UsageError when the reference is malformed; AccessError when there is no such file.
    """
    file, _, name = reference.rpartition(":")
    if not file.endswith(".py") or not name.isidentifier():
        raise UsageError(f"a model is given as FILE.py:FUNCTION, not {told(reference, 120)!r}")
    if not Path(file).is_file():
        raise AccessError(f"the model file {file} does not exist")
    return Path(file), name


def load_black_box(reference: str) -> BlackBox:
    """The function that "FILE.py:FUNCTION" names. This runs the file, as nothing else here does.

    Raises UsageError when the reference is malformed or the file has no such function; AccessError when the file cannot
    be read; ModelError when it raises.
    """
    path, name = parse_reference(reference)
    module = ModuleType(f"uqsphere_black_box_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses and pickle look a module up by its name
    try:
        source = path.read_bytes()
    except OSError as error:
        raise AccessError(f"the model file {path} cannot be read: {error.strerror}") from error
    try:
        with contextlib.redirect_stdout(sys.stderr):
            # compiled from the file as it is: bytecode on disk may be that of the same second
            exec(compile(source, str(path), "exec"), module.__dict__)
    except FAULTS as error:
        text = f"{type(error).__name__}: {told(error)}{_place_of(error)}"
        raise ModelError(f"{path} raised {text} while it was loaded") from error
    function = getattr(module, name, None)
    if not callable(function):
        functions = [key for key, value in vars(module).items() if inspect.isfunction(value) and key[0] != "_"]
        raise UsageError(f"{path} has no function {name!r} (it has: {', '.join(functions) or 'none'})")
    return function  # type: ignore[no-any-return]


def _place_of(error: BaseException) -> str:
    """Where in the user's code an exception began: " (bad.py, line 3)"; empty where that is not known."""
    ours = {Path(__file__).parent, *(Path(sysconfig.get_path(key)) for key in ("stdlib", "purelib", "platlib"))}
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if not frame.filename.startswith("<")
        and ours.isdisjoint(Path(frame.filename).parents)
        and _INSTALLED.isdisjoint(Path(frame.filename).parts)
    ]
    return f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""


def call_black_box(box: BlackBox, names: Sequence[str], rows: Array, outputs: Sequence[str]) -> Array:
    """Answers (n, q) of a model to rows (n, d), in one call. What it prints goes to stderr.

    names : d inputs, the columns of `rows`.
    outputs : q outputs, in the order in which the study has them.

    Raises ModelRaised with what the model raised, and where; ModelError where it returned something of the wrong form.
    """
    columns = {name: rows[:, k].copy() for k, name in enumerate(names)}
    try:
        with contextlib.redirect_stdout(sys.stderr):
            returned = box(columns)
    except FAULTS as error:
        raise ModelRaised(f"the model raised {type(error).__name__}: {told(error)}{_place_of(error)}") from error
    try:
        return _table(returned, outputs, len(rows))
    except ModelError:
        raise
    except Exception as error:  # what was returned computes its content as it likes
        text = f"{type(error).__name__}: {told(error)}"
        raise ModelError(f"what the model returned cannot be read: {text}") from error


def _table(returned: Any, outputs: Sequence[str], count: int) -> Array:
    """What a model returned, as numbers (n, q)."""
    if hasattr(returned, "columns") and hasattr(returned, "iloc"):  # a DataFrame, without importing pandas
        returned = _by_index(returned, count)
        names = list(returned.columns)
        if repeated := sorted({str(name) for name in names if names.count(name) > 1}):
            raise ModelError(f"the model returned the column {told(repeated[0], 60)!r} more than once")
        returned = {name: returned[name].to_numpy() for name in names}
    if isinstance(returned, Mapping):
        missing = [name for name in outputs if name not in returned]
        if missing:
            keys = ", ".join(repr(told(key, 60)) for key in list(returned)[:6]) or "nothing"
            raise ModelError(f"the model returned no {missing[0]!r} (it returned {keys})")
        return np.stack([_column(_by_index(returned[name], count), name, count) for name in outputs], axis=1)
    if returned is None:
        raise ModelError("the model returned nothing: it must return a dict of output name -> array")
    if hasattr(returned, "index") and hasattr(returned, "iloc"):
        returned = _by_index(returned, count)
    shape = np.shape(returned)
    if shape == (count, len(outputs)) and len(shape) == 2:
        table = np.asanyarray(returned)
        return np.stack([_column(table[:, k], name, count) for k, name in enumerate(outputs)], axis=1)
    if len(outputs) == 1:
        return _column(returned, outputs[0], count)[:, None]
    listed = ", ".join(map(repr, outputs))
    raise ModelError(
        f"the model must return a dict with {listed}, or an array of shape ({count}, {len(outputs)}); "
        f"it returned {type(returned).__name__}{f' of shape {shape}' if shape else ''}"
    )


def _by_index(value: Any, count: int) -> Any:
    """A Series or DataFrame in the order of the rows, if its index numbers them; anything else as it is."""
    index = getattr(value, "index", None)
    if not hasattr(value, "iloc") or index is None or len(index) != count:
        return value
    labels = np.asarray(index)
    if labels.dtype.kind in "iu" and not np.array_equal(labels, np.arange(count)):
        places = np.argsort(labels, kind="stable")
        if np.array_equal(labels[places], np.arange(count)):
            return value.iloc[places]
    return value


def _column(value: Any, name: str, count: int) -> Array:
    """One output as numbers (n,); what a mask hides, and None, is NaN."""
    kind = np.asarray(value).dtype.kind
    if kind == "c":
        raise ModelError(f"the model's {name!r} has complex numbers: return the real part, or the absolute value")
    if kind not in "fiubO":
        raise ModelError(f"the model's {name!r} is not an array of numbers (its type is {np.asarray(value).dtype})")
    try:
        column = np.ma.MaskedArray(value, dtype=float).filled(np.nan)
    except (TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"the model's {name!r} is not an array of numbers: {told(error)}") from error
    if count == 1 and column.ndim == 0:
        column = column[None]
    if column.shape != (count,):
        hint = "; a function of one row can be wrapped by numpy.vectorize" if column.ndim == 0 else ""
        raise ModelError(
            f"the model's {name!r} must have shape ({count},), one number for each row of its inputs; "
            f"its shape is {column.shape}{hint}"
        )
    return np.asarray(column, dtype=float)


def model_digest(model: str | BlackBox) -> str:
    """What distinguishes one black box from another, 32 hexadecimal digits.

    Of a reference its file and function; of a function its source, defaults and the numbers and texts that it takes
    from outside, without those that it assigns. What it reads or imports besides is not seen.
    """
    if isinstance(model, str):
        path, name = parse_reference(model)
        parts = [path.read_bytes(), name.encode()]
    else:
        parts = list(_parts_of(model))
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "big") + part)
    return digest.hexdigest()[:32]


def _parts_of(model: Any) -> Iterator[bytes]:
    if isinstance(model, functools.partial):
        yield from _parts_of(model.func)
        yield repr((model.args, sorted(model.keywords.items()))).encode()
        return
    function = inspect.unwrap(model)
    if not inspect.isroutine(function):
        function = type(model).__call__
    function = getattr(function, "__func__", function)
    yield f"{getattr(function, '__module__', '')}.{getattr(function, '__qualname__', '')}".encode()
    try:
        source = inspect.getsource(function)
    except (OSError, TypeError):
        source = repr(getattr(getattr(function, "__code__", None), "co_code", function))
    yield source.encode()
    if not inspect.isfunction(function):
        return
    assigned = set(re.findall(r"\w+", " ".join(re.findall(r"\b(?:global|nonlocal) ([\w, ]+)", source))))
    outside = inspect.getclosurevars(function)
    for name, value in sorted({**outside.globals, **outside.nonlocals}.items()):
        if name not in assigned and isinstance(value, (bool, int, float, complex, str, bytes, tuple, np.ndarray)):
            content = value.tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
            yield name.encode() + b"=" + content
    yield repr((function.__defaults__, function.__kwdefaults__)).encode()

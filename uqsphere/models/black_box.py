"""A model of the user's own: load it, call it for many rows at once, check what it returns, and tell two apart."""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import os
import pickle
import re
import sys
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, ModelRaised, UsageError, as_text
from uqsphere.models.rows import EvaluatedRows

#: takes columns (n,) by the names of the inputs; returns columns (n,) by the names of the outputs as a dict or a
#: DataFrame, an array (n, outputs) in the order of the study's outputs, or (n,) where there is one output
BlackBox = Callable[[dict[str, Array]], Any]


def parse_reference(reference: str) -> tuple[Path, str]:
    """File and function of "FILE.py:FUNCTION". Raises UsageError for another form, AccessError for a missing file."""
    file, _, name = reference.rpartition(":")
    if not file.endswith(".py") or not name.isidentifier():
        raise UsageError(f"a model is given as FILE.py:FUNCTION, not {as_text(reference, 120)!r}")
    if not Path(file).is_file():
        raise AccessError(f"the model file {file} does not exist")
    return Path(file), name


def load_black_box(reference: str) -> BlackBox:
    """The function that "FILE.py:FUNCTION" names. This runs the file.

    Raises UsageError for another form and a missing function; AccessError where the file cannot be read; ModelError
    where it raises.
    """
    path, name = parse_reference(reference)
    module = ModuleType(f"uqsphere_black_box_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # dataclasses and pickle look a module up by its name
    if (folder := str(path.resolve().parent)) not in sys.path:
        sys.path.append(folder)  # what stands beside it can be imported, as in a script
    try:
        with _settings():
            # compiled from the file as it is: bytecode on disk may be that of the same second
            exec(compile(path.read_bytes(), str(path), "exec"), module.__dict__)
    except (Exception, SystemExit) as error:
        raise ModelError(f"{path} raised {_described(error)} while it was loaded") from error
    function = getattr(module, name, None)
    if not callable(function):
        functions = [key for key, value in vars(module).items() if inspect.isfunction(value) and key[0] != "_"]
        raise UsageError(f"{path} has no function {name!r} (it has: {', '.join(functions) or 'none'})")
    return function  # type: ignore[no-any-return]


def _described(error: BaseException) -> str:
    """An exception, and where in the user's code it began: "ValueError: too large (bad.py, line 3)"."""
    places = [
        f" ({Path(frame.filename).name}, line {frame.lineno})"
        for frame in traceback.extract_tb(error.__traceback__)
        if _is_theirs(frame.filename) and frame.filename[0] != "<"
    ]
    return f"{type(error).__name__}: {as_text(error)}{places[-1] if places else ''}"


def _is_theirs(file: str) -> bool:
    """Whether code of a file is the user's."""
    return not any(Path(file).is_relative_to(place) for place in (Path(__file__).parent, sys.prefix, sys.base_prefix))


@contextlib.contextmanager
def _settings() -> Iterator[None]:
    """What is printed goes to stderr, linear algebra has one thread, and NumPy's settings come back as they were."""
    libraries = _linear_algebra(len(sys.modules) // 64)
    with contextlib.redirect_stdout(sys.stderr), libraries.limit(limits=1, user_api="blas"), np.errstate():
        yield


@lru_cache(maxsize=1)
def _linear_algebra(modules: int) -> Any:
    """Libraries with threads of their own; looked for again when more modules are loaded, since that takes a while."""
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


@lru_cache(maxsize=4)
def _loaded(reference: str, digest: str) -> BlackBox:
    """The function of a reference, once in the life of a process."""
    if model_digest(reference) != digest:
        raise ModelError(f"the file of {as_text(reference, 120)} has changed since the run began, or is another here")
    return load_black_box(reference)


def answer_rows(
    rows: Array, *, box: str | BlackBox, digest: str, names: Sequence[str], outputs: Sequence[str]
) -> EvaluatedRows:
    """Answers of all outputs to rows (n, d); without rows the model is loaded.

    box : a function, or a reference with the digest of its file.

    Raises as `call_black_box`. A number that is not finite is no failure yet, for it may not be needed.
    """
    function, process = _loaded(box, digest) if isinstance(box, str) else box, os.getpid()
    try:
        values = call_black_box(function, names, rows, outputs) if len(rows) else np.zeros((0, len(outputs)))
    finally:
        if os.getpid() != process:
            os._exit(1)  # the model forked, and its child came back from the call
    return EvaluatedRows.plain(values)


def call_black_box(box: BlackBox, names: Sequence[str], rows: Array, outputs: Sequence[str]) -> Array:
    """Answers (n, q) of a model to rows (n, d), in one call. What it prints goes to stderr.

    names : d inputs, the columns of `rows`.
    outputs : q outputs, in the order in which the study has them.

    Raises ModelRaised with what the model raised, and where; ModelError where it returned something of the wrong form.
    """
    columns = {name: rows[:, k].copy() for k, name in enumerate(names)}
    try:
        with _settings():
            returned = box(columns)
    except (Exception, SystemExit) as error:
        raise ModelRaised(f"the model raised {_described(error)}") from error
    try:
        return _table(returned, outputs, len(rows))
    except ModelError:
        raise
    except Exception as error:  # what was returned computes its content as it likes
        raise ModelError(f"what the model returned cannot be read: {_described(error)}") from error


def _table(returned: Any, outputs: Sequence[str], count: int) -> Array:
    """What a model returned, as numbers (n, q)."""
    returned = by_index(returned, count)
    if not isinstance(returned, Mapping) and not hasattr(returned, "columns"):  # nor a DataFrame
        shape = np.shape(returned)
        if shape == (count, len(outputs)):
            returned = dict(zip(outputs, np.asanyarray(returned).T, strict=True))
        elif len(outputs) == 1:
            returned = {outputs[0]: returned}
        else:
            raise ModelError(
                f"the model must return a dict with {', '.join(map(repr, outputs))}, or an array of shape ({count}, "
                f"{len(outputs)}); it returned {type(returned).__name__}{f' of shape {shape}' if shape else ''}"
            )
    if missing := [name for name in outputs if name not in returned]:
        keys = ", ".join(repr(as_text(key, 60)) for key in list(returned)[:6]) or "nothing"
        raise ModelError(f"the model returned no {missing[0]!r} (it returned {keys})")
    return np.stack([_column(by_index(returned[name], count), name, count) for name in outputs], axis=1)


def by_index(value: Any, count: int) -> Any:
    """A Series or DataFrame in the order of the rows, if its index numbers them; anything else as it is."""
    if hasattr(value, "iloc") and len(value) == count:
        labels = np.asarray(value.index)
        if labels.dtype.kind in "iu" and np.array_equal(np.sort(labels), np.arange(count)):
            return value.iloc[np.argsort(labels)]
    return value


def _column(value: Any, name: str, count: int) -> Array:
    """One output as numbers (n,); what a mask hides, and None, is NaN."""
    given = np.asarray(value)
    try:
        if given.dtype.kind not in "fiubO":
            raise TypeError(f"its type is {given.dtype}; of complex numbers return the real part or the absolute value")
        column = given.astype(float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ModelError(f"the model's {name!r} is not an array of numbers: {as_text(error)}") from error
    if isinstance(value, np.ma.MaskedArray):
        column = np.where(value.mask, np.nan, column)
    if count == 1 and column.ndim == 0:
        return column[None]
    if column.shape != (count,):
        hint = "; a function of one row can be wrapped by numpy.vectorize" if column.ndim == 0 else ""
        raise ModelError(
            f"the model's {name!r} must have shape ({count},), one number for each row of its inputs; "
            f"its shape is {column.shape}{hint}"
        )
    return column


def model_digest(model: str | BlackBox) -> str:
    """What distinguishes one black box from another, 32 hexadecimal digits.

    Of a reference its file and function; of a function its source and defaults, and what it takes from outside but for
    what it assigns; of an object, a method or a `functools.partial` its state too. What is read or imported besides is
    not seen.
    """
    digest = hashlib.sha256()
    if isinstance(model, str):
        path, name = parse_reference(model)
        digest.update(path.read_bytes() + b"\0" + name.encode())
    else:
        _SourcePickler(SimpleNamespace(write=digest.update), 5).dump(model)
    return digest.hexdigest()[:32]


class _SourcePickler(pickle.Pickler):
    """Pickles functions and classes by their source, and a function with what it names outside of itself."""

    def reducer_override(self, value: Any) -> Any:
        if inspect.isclass(value):
            file = getattr(sys.modules.get(value.__module__), "__file__", None) or ""
            by_source = value.__module__ != "builtins" and _is_theirs(file)
            return (str, (_source(value),)) if by_source else NotImplemented
        if inspect.isfunction(value):
            function = inspect.unwrap(value)
            source = _source(function)
            assigned = re.findall(r"\w+", " ".join(re.findall(r"\b(?:global|nonlocal) ([\w, ]+)", source)))
            names = inspect.getclosurevars(function)
            outside = {
                name: part
                for name, part in sorted({**names.globals, **names.nonlocals}.items())
                if name not in assigned
                and not inspect.ismodule(part)
                and not (callable(part) and getattr(part, "__module__", None) != function.__module__)
            }
            return str, (source,), [function.__qualname__, function.__defaults__, function.__kwdefaults__, outside]
        try:
            value.__reduce_ex__(5)
        except Exception:  # what refuses to be pickled is seen by its attributes
            return str, (type(value).__qualname__,), getattr(value, "__dict__", None)
        return NotImplemented


def _source(value: Any) -> str:
    try:
        return inspect.getsource(value)
    except (OSError, TypeError):
        return str(getattr(getattr(value, "__code__", None), "co_code", value))

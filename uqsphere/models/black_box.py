"""A model of the user's own: load it, call it for many rows at once, and check what it returns."""

import contextlib
import inspect
import sys
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from uqsphere.arrays import Array, Names, is_labelled
from uqsphere.errors import ModelError, ModelRaised, UsageError, as_text
from uqsphere.files import read_given

#: takes columns (n,) by the names of the inputs; returns columns (n,) by the names of the outputs
#: as a dict or a DataFrame, an array (n, outputs) in the order of the study's outputs, or (n,)
#: where there is one output
BlackBox = Callable[[dict[str, Array]], Any]
#: bytes of a model file that is read
_LARGEST = 32 << 20


@dataclass(frozen=True)
class ModelFile:
    """A function of a Python file, with the content of the file: what was read at first is run,
    here and elsewhere.
    """

    path: Path
    name: str
    source: bytes

    def load(self) -> BlackBox:
        """The function. This runs the file.

        Raises ModelError if the file raises, UsageError if it has no such function.
        """
        module = ModuleType(f"uqsphere_black_box_{self.path.stem}")
        module.__file__ = str(self.path)
        sys.modules[module.__name__] = module  # dataclasses and pickle look a module up by its name
        folder = str(self.path.parent)
        if folder not in sys.path:
            sys.path.append(folder)  # as in a script
        try:
            exec(compile(self.source, self.path, "exec"), module.__dict__)
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # SystemExit, and exceptions of the model's own
            raise ModelError(
                f"{as_text(self.path)} raised {describe_error(error)} while it was loaded"
            ) from error
        function: BlackBox | None = getattr(module, self.name, None)
        if not callable(function):
            members = vars(module).items()
            names = [key for key, member in members if key[0] != "_" and inspect.isfunction(member)]
            raise UsageError(
                f"{as_text(self.path)} has no function {self.name!r}; its functions: "
                f"{', '.join(names) or 'none'}"
            )
        return function


def read_model(reference: str) -> ModelFile:
    """The file and function of "FILE.py:FUNCTION".

    Raises UsageError for another form; and as `read_given`.
    """
    file, _, name = reference.rpartition(":")
    if not file.endswith(".py") or not name.isidentifier():
        raise UsageError(f"the model must be FILE.py:FUNCTION, not {as_text(reference, 120)!r}")
    path = Path(file)
    return ModelFile(path.resolve(), name, read_given(path, _LARGEST))


def identity_of(box: ModelFile | BlackBox) -> bytes:
    """What distinguishes a model from others: the content of its file; of a function its value and
    the file that it is from.

    Empty for a function that cannot be pickled.  Files that either reads or imports do not count.
    """
    if isinstance(box, ModelFile):
        return box.name.encode() + b"\0" + box.source
    import cloudpickle

    file = getattr(sys.modules.get(str(getattr(box, "__module__", ""))), "__file__", None)
    with contextlib.suppress(Exception):  # pickling can raise anything
        return bytes(cloudpickle.dumps(box)) + (Path(file).read_bytes() if file else b"")
    return b""


def describe_error(error: BaseException) -> str:
    """An exception, and where in the user's code it began: "ValueError: too large (bad.py, line
    3)".
    """
    others = (str(Path(__file__).parent), sys.prefix, sys.base_prefix, "<")
    place = ""
    for frame in traceback.extract_tb(error.__traceback__):
        if not frame.filename.startswith(others):
            place = f" ({Path(frame.filename).name}, line {frame.lineno})"
    return f"{type(error).__name__}: {as_text(error)}{place}"


def call_black_box(box: BlackBox, names: Names, rows: Array, outputs: Names) -> Array:
    """Answers (n, q) of a model to rows (n, d), in one call.

    names : d inputs, the columns of `rows`.
    outputs : q outputs, in the order of the study.

    Raises ModelRaised with what the model raised, and where; ModelError if it returned something of
    the wrong form.
    """
    try:
        with np.errstate():  # what it sets of NumPy's errors is set back
            returned = box(dict(zip(names, rows.T.copy(), strict=True)))
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # SystemExit, and exceptions of the model's own
        raise ModelRaised(f"the model raised {describe_error(error)}") from error
    try:
        return _answers(returned, len(rows), outputs)
    except (ModelError, KeyboardInterrupt):
        raise
    except BaseException as error:  # reading a foreign object can raise anything
        raise ModelError(
            f"the return value of the model cannot be read: {describe_error(error)}"
        ) from error


def _answers(returned: Any, count: int, outputs: Names) -> Array:
    """What a model returned as an array (n, q); raises ModelError for the wrong form."""
    returned = by_index(returned, count)
    if is_labelled(returned):
        returned = _by_label(returned, outputs)
    if not isinstance(returned, Mapping) and not hasattr(returned, "columns"):  # nor a DataFrame
        shape = getattr(returned, "shape", ())
        if shape == (count, len(outputs)):
            returned = dict(zip(outputs, np.asanyarray(returned).T, strict=True))
        elif len(outputs) == 1 and returned is not None:
            returned = {outputs[0]: returned}
        else:
            form = type(returned).__name__
            if shape:
                form += f" of shape {shape}"
            raise ModelError(
                f"the model must return a dict with {', '.join(map(repr, outputs))}, or an array "
                f"of shape ({count}, {len(outputs)}), not {form}"
            )
    for name in outputs:
        if name not in returned:
            keys = ", ".join(repr(as_text(key, 60)) for key in list(returned)[:6]) or "nothing"
            raise ModelError(f"the model returned {keys}, but no {name!r}")
    return np.column_stack(
        [_column(by_index(returned[name], count), name, count) for name in outputs]
    )


def by_index(value: Any, count: int) -> Any:
    """A Series, DataFrame or labelled array (n,) in the order of the rows, if its index numbers
    them; anything else as it is.
    """
    if is_labelled(value) and len(value.dims) == 1:
        value = value.to_series()
    if hasattr(value, "iloc") and len(value) == count:
        labels = np.asarray(value.index)
        if labels.dtype.kind in "iu" and np.array_equal(np.sort(labels), np.arange(count)):
            return value.iloc[np.argsort(labels)]
    return value


def _by_label(array: Any, outputs: Names) -> dict[str, Any]:
    """The columns of a labelled array of two dimensions, by the coordinate that names the outputs;
    raises ModelError without one.
    """
    for dimension in filter(array.coords.__contains__, array.dims):
        labels = [*map(str, np.asarray(array.coords[dimension]))]
        if set(outputs) <= set(labels) and len(set(labels)) == len(labels):
            return {name: array.isel({dimension: labels.index(name)}) for name in outputs}
    raise ModelError(
        f"the model's {type(array).__name__} must have a coordinate with "
        f"{', '.join(map(repr, outputs))}. Return a dict of arrays instead"
    )


def _column(value: Any, name: str, count: int) -> Array:
    """One output as numbers (n,); what a mask hides, and None, is NaN."""
    try:
        answers = np.asanyarray(value)
        objects = answers.ravel().tolist() if answers.dtype == object else [answers]
        if any(map(np.iscomplexobj, objects)):
            raise TypeError("its type is complex. Return the real part or the absolute value")
        if answers.dtype.kind not in "fiubO":
            raise TypeError(f"its type is {answers.dtype}")
        mask = np.ma.getmaskarray(answers)  # type: ignore[no-untyped-call]
        column = np.where(mask, np.nan, np.ma.filled(answers, 0)).astype(float)
    except Exception as error:  # reading a foreign object can raise anything
        raise ModelError(
            f"the model's {name!r} is not an array of numbers: {describe_error(error)}"
        ) from error
    if count == 1 and column.ndim == 0:
        return column[None]
    if column.shape != (count,):
        way = ". Wrap a function of one row with numpy.vectorize" if column.ndim == 0 else ""
        raise ModelError(
            f"the model's {name!r} must have shape ({count},), one number for each row of its "
            f"inputs, not {column.shape}{way}"
        )
    return column

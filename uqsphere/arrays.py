"""Names of array types, the dataclasses of this package, and special functions loaded when they are
called.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, dataclass_transform

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Places = NDArray[np.int64]
#: two arrays that belong to each other, such as coordinates or both ends of intervals
Pair = tuple[Array, Array]
#: two numbers that belong to each other, such as the ends of a range, or mean and sd
Duo = tuple[float, float]
#: names of columns, in their order
Names = Sequence[str]
#: a number or an array of numbers: argument and result of elementwise formulas
Values = Any
#: columns by name, each a number or an array (n,)
ColumnMap = Mapping[str, Values]
#: elementwise formulas of one array
Function = Callable[[Array], Array]
#: numbers or flags of any kind, plain or in named columns
Cells = NDArray[Any]
#: decorator of formulas that are evaluated in every row, also where they are not valid or not used
quiet = np.errstate(all="ignore")


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def frozen(kind: type | None = None, **options: bool) -> Any:
    """A dataclass that does not change, whose fields are given by name: what this package hands on.

    >>> @frozen
    ... class Point:
    ...     x: float = 0.0
    >>> Point(x=1.0)
    Point(x=1.0)
    """
    return dataclass(kind, frozen=True, kw_only=True, **options)


@dataclass_transform(frozen_default=True, kw_only_default=True, field_specifiers=(field,))
def bundle(kind: type) -> Any:
    """A `frozen` dataclass that is equal to itself alone, since arrays in it have no one answer."""
    return frozen(kind, eq=False)


class _Special:
    """scipy.special, loaded at the first call of a function, since the import takes time."""

    def __getattr__(self, name: str) -> Callable[..., Array]:
        from scipy import special as functions

        function: Callable[..., Array] = getattr(functions, name)
        return function


special = _Special()


def one_thread() -> Any:
    """Linear algebra by one thread: sums in a fixed order, and no threads that wait for others."""
    from threadpoolctl import threadpool_limits

    return threadpool_limits(limits=1, user_api="blas")


def as_numbers(cells: Any) -> Array:
    """Real numbers of any shape; None is nan.

    Raises TypeError and ValueError for what are none: dates and durations, complex and masked
    ones, which NumPy would take, too.

    >>> as_numbers([1, None])
    array([ 1., nan])
    """
    if isinstance(cells, np.ma.MaskedArray):
        raise TypeError("masked arrays are not taken: leave out the rows that are masked")
    cells = np.asarray(cells)
    entries = cells.ravel().tolist() if cells.dtype == object else [cells]
    kinds = {np.asarray(entry).dtype.kind for entry in entries}
    if "c" in kinds:
        raise TypeError("found complex numbers: choose their real part or size")
    if kinds & {"m", "M"}:
        raise TypeError("found dates or durations: give numbers, such as hours from the start")
    numbers: Array = cells.astype(float)
    return numbers


def is_labelled(value: Any) -> bool:
    """Whether something is an array of xarray."""
    return all(hasattr(value, name) for name in ("dims", "coords", "to_series", "sel"))

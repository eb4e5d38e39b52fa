"""Names of the arrays that every room passes around, and special functions of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]
Places: TypeAlias = npt.NDArray[np.int64]
#: a number or an array of numbers: what elementwise formulas take, and give back of the same kind
Values: TypeAlias = Any
#: numbers or flags of any kind, plain or in columns with names: the content of one stored array
Cells: TypeAlias = npt.NDArray[Any]


class _Special:
    """scipy.special, loaded when a function of it is called: `uqsphere check` is quick without."""

    def __getattr__(self, name: str) -> Callable[..., Array]:
        from scipy import special as functions

        found: Callable[..., Array] = getattr(functions, name)
        return found


special = _Special()

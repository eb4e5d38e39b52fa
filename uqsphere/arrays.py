"""Names of the arrays that every room passes around."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]
Places: TypeAlias = npt.NDArray[np.int64]
#: a number or an array of numbers: what elementwise formulas take, and give back of the same kind
Values: TypeAlias = Any

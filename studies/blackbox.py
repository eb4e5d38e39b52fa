"""The model of ``blackbox.toml``: put your own in place of it.

It gets arrays of shape (n,) by the names of the inputs and returns arrays of shape (n,) by the
names of the outputs. It may do anything, start a program among it; a row that fails may be nan.  A
model of one row at a time loops.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def model(inputs: dict[str, Array]) -> dict[str, Array]:
    """Deflection of the tip of a cantilever under a load, F L³/(3 E I).

    >>> one = {"load": np.array([1000.0]), "length": np.array([2.0])}
    >>> one["stiffness"] = np.array([210e9])
    >>> model({**one, "inertia": np.array([2.0e-6])})["deflection"].round(6).tolist()
    [0.006349]
    """
    bending = 3.0 * inputs["stiffness"] * inputs["inertia"]
    return {"deflection": inputs["load"] * inputs["length"] ** 3 / bending}

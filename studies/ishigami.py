"""The model of ``ishigami.toml``: Ishigami and Homma (1990), y = sin x1 + 7 sin² x2 + 0.1 x3⁴ sin
x1.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def ishigami(inputs: dict[str, Array]) -> dict[str, Array]:
    """Arrays of shape (n,) in, arrays of shape (n,) out; x1, x2, x3 uniform on (-π, π).

    >>> one = {"x1": np.array([np.pi / 2]), "x2": np.array([0.0]), "x3": np.array([1.0])}
    >>> ishigami(one)["y"].tolist()
    [1.1]
    """
    x1, x2, x3 = inputs["x1"], inputs["x2"], inputs["x3"]
    return {"y": np.sin(x1) + 7.0 * np.sin(x2) ** 2 + 0.1 * x3**4 * np.sin(x1)}

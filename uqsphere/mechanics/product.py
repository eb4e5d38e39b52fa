"""The product of crushing: how fine a sphere becomes that breaks, from the energy that it was given, theory (31)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["DIAMETERS", "ENERGIES", "fineness_of", "product_fineness"]

Array = npt.NDArray[np.float64]

#: specific energies [J/kg] and sizes [m] of the drop-weight test that A and b are fitted to: 0.1 to 2.5 kWh/t,
#: 13.2 to 63 mm (Napier-Munn and others 1996, from memory)
ENERGIES: Final = (0.1 * 3600.0, 2.5 * 3600.0)
DIAMETERS: Final = (0.0132, 0.063)


def product_fineness(specific_energy: Any, A: Any, b: Any) -> Array:
    """t10 = A (1 - exp(-b Ecs)): share of the product's mass that is finer than a tenth of the particle, theory (31).

    Parameters
    ----------
    specific_energy : array
        Ecs, the energy given to the particle over its mass [J/kg], from 0.
    A : array
        The largest t10, a share in (0, 1].
    b : array
        [kg/J]; A b is the slope at small energies.

    Returns
    -------
    array
        Of the shape that the arguments broadcast to, from 0 to A.

    Valid for 0.1 to 2.5 kWh/t and particles of 13 to 63 mm, which the check ``range_of_t10`` looks at.  T. J.
    Napier-Munn, S. Morrell, R. D. Morrison, T. Kojovic, Mineral Comminution Circuits, JKMRC, 1996.

    >>> round(float(product_fineness(3600.0, 0.55, 0.8 / 3600.0)), 4)
    0.3029
    """
    return np.asarray(-np.asarray(A) * np.expm1(-np.asarray(b) * np.asarray(specific_energy)), dtype=float)


def fineness_of(columns: Mapping[str, Any]) -> Array:
    """t10 of n rows, from the columns `specific_energy`, `product.A` and `product.b`.

    Raises
    ------
    ValueError
        Where the scene has no A and b.
    """
    if "product.A" not in columns or "product.b" not in columns:
        raise ValueError("t10 needs product.A and product.b: add a table [product] with A and b")
    return product_fineness(columns["specific_energy"], columns["product.A"], columns["product.b"])

"""Output transforms: an expansion of the logarithm, root or reciprocal of an output, where that helps.

Errors are always counted in the units of the output itself, over its standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from uqsphere.arrays import Array

__all__ = ["TRANSFORMS", "Transform", "identity", "possible_transforms"]

#: what can be expanded in place of an output y, with t = sign (y - origin) > 0
TRANSFORMS: Final = ("identity", "log", "shifted log", "square root", "reciprocal")

#: how far beyond the range of its samples a transformed output may go, over that range
_MARGIN: Final = 1.0


@dataclass(frozen=True, kw_only=True)
class Transform:
    """z = (w(sign (y - origin)) - centre)/scale, with w as in `kind`; its inverse takes z within [lowest, highest].

    The bounds keep the exponential of a polynomial, which has no bounds of its own, within a range of the samples
    around them; the identity has none.  Outputs are counted in `unit`, which keeps squares of large ones finite.
    """

    kind: str
    sign: float
    origin: float
    centre: float
    scale: float
    lowest: float
    highest: float
    unit: float = 1.0

    def forward(self, outputs: Array) -> Array:
        """Standardised values of outputs."""
        return (_warp(self.kind, self.sign * (outputs / self.unit - self.origin)) - self.centre) / self.scale

    def back(self, values: Array) -> Array:
        """Outputs of standardised values."""
        if self.kind == "identity":
            return self.unit * (self.centre + self.scale * values)
        inner = self.centre + self.scale * np.minimum(np.maximum(values, self.lowest), self.highest)
        return self.unit * (self.origin + self.sign * _unwarp(self.kind, inner))

    def slope(self, values: Array) -> Array:
        """Derivative of the output with respect to the standardised value; 0 where the bounds hold it."""
        if self.kind == "identity":
            return np.full_like(values, self.unit * self.scale)
        inside = (values >= self.lowest) & (values <= self.highest)
        inner = self.centre + self.scale * np.clip(values, self.lowest, self.highest)
        if self.kind in ("log", "shifted log"):
            rate = np.exp(inner)
        elif self.kind == "square root":
            rate = 2.0 * inner
        else:
            rate = -1.0 / inner**2
        return np.where(inside, self.unit * self.sign * self.scale * rate, 0.0)


def _warp(kind: str, t: Array) -> Array:
    if kind in ("log", "shifted log"):
        return np.log(t)
    if kind == "square root":
        return np.sqrt(t)
    return 1.0 / t if kind == "reciprocal" else t


def _unwarp(kind: str, w: Array) -> Array:
    if kind in ("log", "shifted log"):
        return np.exp(w)
    if kind == "square root":
        return w * w
    return 1.0 / w if kind == "reciprocal" else w


def identity(outputs: Array) -> Transform:
    """The outputs themselves, standardised; their standard deviation must not be zero."""
    return Transform(kind="identity", sign=1.0, origin=0.0, centre=float(outputs.mean()),
                     scale=float(outputs.std()), lowest=-np.inf, highest=np.inf)  # fmt: skip


def _fitted(kind: str, outputs: Array, sign: float, origin: float) -> Transform | None:
    w = _warp(kind, sign * (outputs - origin))
    centre, scale = float(w.mean()), float(w.std())
    if not (np.isfinite(w).all() and scale > 1e-12 * abs(centre)):
        return None
    z = (w - centre) / scale
    low, high = float(z.min()), float(z.max())
    reach = _MARGIN * (high - low)
    lowest, highest = low - reach, high + reach
    if kind in ("square root", "reciprocal"):
        # w itself must stay positive
        least = 0.0 if kind == "square root" else 0.25 * float(w.min())
        lowest = max(lowest, (least - centre) / scale)
    return Transform(kind=kind, sign=sign, origin=origin, centre=centre, scale=scale, lowest=lowest, highest=highest)


def possible_transforms(outputs: Array) -> list[Transform]:
    """The identity, and the others where all outputs (n,) have one sign or, for the shifted logarithm, any.

    The shift leaves a fifth of a standard deviation below the smallest output, on the side of the shorter tail.
    """
    answer = [identity(outputs)]
    low, high, scale = float(outputs.min()), float(outputs.max()), float(outputs.std())
    sides = []
    if low > 0.0 or high < 0.0:
        sign = 1.0 if low > 0.0 else -1.0
        sides = [(kind, sign, 0.0) for kind in ("log", "square root", "reciprocal")]
    skewed = 1.0 if float(np.mean((outputs - outputs.mean()) ** 3)) >= 0.0 else -1.0
    origin = low - 0.2 * scale if skewed > 0.0 else high + 0.2 * scale
    for kind, sign, start in [*sides, ("shifted log", skewed, origin)]:
        found = _fitted(kind, outputs, sign, start)
        if found is not None:
            answer.append(found)
    return answer

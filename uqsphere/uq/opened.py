"""How far an answer reaches under other laws than the fitted ones, from the steps that it takes to each of them."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import Any, Final

import numpy as np

from uqsphere.uq.families import Array

__all__ = ["leaning", "reach", "spanned"]

#: 95 % of what the other laws move an answer by, which is known from some dozens of them
_OPEN: Final = 2.0
#: logarithm of a factor beyond which steps are counted
_FACTORS: Final = 2.0
#: laws of a copula from which on their mean is known well enough: an eighth of all
_SEVERAL: Final = 8


def reach(answer: float, moved: Array, value: float, way: str) -> tuple[float, float]:
    """How far below and above an answer the other laws reach, from its values (K,) under them and the one without.

    By `way`: "steps" of the answer itself, "factors" of a standard deviation, "shares" of the variance by their logit,
    so that more is left open above a small one than below, "squares" by the arcsine of the root: the first index of
    an input that depends on others is the square of a correlation, which may be none.
    """
    from scipy.special import expit, logit

    steps = moved - value
    unit = float(np.abs(steps).max()) or 1.0
    plain = _OPEN * unit * math.sqrt(float(np.mean((steps / unit) ** 2)))
    ways: dict[str, tuple[Any, Any]] = {
        "squares": (_angle, _share),
        "factors": (np.log, np.exp),
        "shares": (logit, expit),
    }
    if way not in ways:
        return plain, plain
    there, back = ways[way]
    with np.errstate(invalid="ignore", divide="ignore"):
        changes, centre = there(moved) - there(value), float(there(answer))
    half = _OPEN * float(np.sqrt(np.mean(changes**2)))
    if way == "squares":
        # a root has lost its sign: about a correlation near zero the laws lie on both sides of it
        above = max(_share(centre + half) - answer, plain * (answer < 0.5))
        return max(answer - _share(centre - half), 0.0), above
    # what is zero but for the noise of the design is no factor of anything
    if math.isfinite(centre) and half < _FACTORS:
        return answer - float(back(centre - half)), float(back(centre + half)) - answer
    return plain, plain


def spanned(steps: Array, copulas: Sequence[Hashable]) -> tuple[float, float] | None:
    """How far below and above steps (K,) reach under every copula that several of the laws have; None for one copula.

    Which copula is right is not drawn by chance: about the mean step of each the steps scatter as far as the laws do,
    and all these intervals are held.

    >>> spanned(np.array([1.0, -1.0] * 8 + [4.0, 2.0] * 8), ["gaussian"] * 16 + ["clayton"] * 16)
    (2.065591117977289, 5.065591117977289)
    """
    groups = [steps[[one == kind for one in copulas]] for kind in dict.fromkeys(copulas)]
    groups = [group for group in groups if group.size >= _SEVERAL]
    if len(groups) < 2:
        return None
    means = [float(group.mean()) for group in groups]
    squares = sum(float(((group - mean) ** 2).sum()) for group, mean in zip(groups, means, strict=True))
    half = _OPEN * math.sqrt(squares / (sum(group.size for group in groups) - len(groups)))
    return max(half - min(means), 0.0), max(half + max(means), 0.0)


def leaning(moved: Array, means: Array) -> tuple[float, float]:
    """What the interval of a quantile reaches further below and above than by steps, the fitted laws' values first.

    Its distance from the mean moves by factors: where the runs show too little of a tail, the interval would be short.
    """
    distance = moved - means
    with np.errstate(invalid="ignore", divide="ignore"):
        half = _OPEN * float(np.sqrt(np.mean(np.log(distance[1:] / distance[0]) ** 2)))
    if not half < _FACTORS:
        return 0.0, 0.0
    size = abs(float(distance[0]))
    out, back = size * (math.expm1(half) - half), -size * (half + math.expm1(-half))
    return (out, back) if distance[0] < 0.0 else (back, out)


def _angle(share: Array | float) -> Array:
    return np.asarray(np.arcsin(np.sqrt(np.clip(share, 0.0, 1.0))))


def _share(angle: float) -> float:
    return math.sin(min(max(angle, 0.0), 0.5 * math.pi)) ** 2

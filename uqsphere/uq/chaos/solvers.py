"""Sparse least squares: which terms enter, in which order, and how good every number of them is.

Each solver takes the candidate terms as rows with mean square 1 over the samples, and lets one after the other
in.  Whatever the rule, the coefficients are those of least squares on the terms that are in, and the error is that
of leaving a sample out, which costs no second fit: e_i/(1 - h_i), times n/(n - P) (1 + tr C⁻¹/n) to hold large sets
back (G. Blatman, B. Sudret, J. Comput. Phys. 230, 2011, 2345).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.uq.families import Array

__all__ = ["SOLVERS", "Path", "in_order", "least_angle", "matching_pursuit"]

Places = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

#: a term whose part outside the others is shorter than this share of it is no further term
_DEPENDENT: Final = 1e-7
#: an error this small, of the variance, needs no further terms
_EXACT: Final = 1e-26
#: a leverage this near one leaves nothing to judge a sample by
_LEVERAGE: Final = 1.0 - 1e-9


@dataclass(frozen=True, kw_only=True)
class Path:
    """Terms in the order in which they entered, and what is needed to cut it anywhere.

    Attributes
    ----------
    terms : rows of the candidates (k,)
    inverse, projections : coefficients of the constant and the first m terms are
        inverse[:m + 1, :m + 1] @ projections[:m + 1]
    plain, corrected : leave-one-out mean square errors (k + 1,) after 0, 1, ... k terms
    """

    terms: Places
    inverse: Array
    projections: Array
    plain: Array
    corrected: Array

    @property
    def cut(self) -> int:
        """Number of terms with the least corrected error."""
        return int(np.argmin(self.corrected))

    def coefficients(self, terms: int) -> Array:
        """Of the constant and the first `terms` terms."""
        size = terms + 1
        return np.asarray(self.inverse[:size, :size] @ self.projections[:size])

    def predictions(self, candidates: Array) -> Array:
        """Values (k + 1, n) at other samples after 0, 1, ... k terms; candidates (P, n) there."""
        rows = np.vstack([np.ones(candidates.shape[1]), candidates[self.terms]])
        return np.asarray(np.cumsum((self.inverse.T @ rows) * self.projections[:, None], axis=0))


class _Growing:
    """Least squares on a set of terms that grows, one orthogonal direction at a time."""

    def __init__(self, outputs: Array, weights: Array, most: int) -> None:
        n = outputs.size
        self.weights = weights
        self.n, self.size = n, 0
        self.directions = np.empty((most + 1, n))
        self.inverse = np.zeros((most + 1, most + 1))
        self.projections = np.empty(most + 1)
        self.residual = outputs.copy()
        self.leverage = np.zeros(n)
        self.trace = 0.0
        self.add(np.ones(n))

    def add(self, term: Array) -> bool:
        """Let a term in; False if it says nothing new."""
        k = self.size
        known = self.directions[:k]
        weights = known @ term
        rest = term - weights @ known
        again = known @ rest  # once is not orthogonal to the last digit
        rest -= again @ known
        weights = weights + again
        length = math.sqrt(float(rest @ rest))
        if not length > _DEPENDENT * math.sqrt(float(term @ term)):
            return False
        rest /= length
        self.directions[k] = rest
        column = -(self.inverse[:k, :k] @ weights) / length
        self.inverse[:k, k] = column
        self.inverse[k, k] = 1.0 / length
        self.trace += float(column @ column) + 1.0 / length**2
        self.projections[k] = rest @ self.residual
        self.residual = self.residual - self.projections[k] * rest
        self.leverage += rest * rest
        self.size += 1
        return True

    def errors(self) -> tuple[float, float]:
        """Plain and corrected leave-one-out error, weighted."""
        if self.leverage.max() > _LEVERAGE or self.size >= self.n:
            return math.inf, math.inf
        left_out = self.weights * self.residual / (1.0 - self.leverage)
        plain = float(left_out @ left_out) / self.n
        return plain, plain * self.n / (self.n - self.size) * (1.0 + self.trace)


def _walk(
    candidates: Array, outputs: Array, weights: Array, most: int, follow: Callable[[_Growing, Flags], int]
) -> Path:
    """Let terms in as `follow` names them until the corrected error has not fallen for long.

    `follow` takes what has grown so far and the mask of the terms that may still come; -1 when there is none.
    """
    most = min(most, len(candidates), outputs.size - 2)
    grown = _Growing(outputs, weights, most)
    terms: list[int] = []
    free = np.ones(len(candidates), dtype=bool)
    errors = [grown.errors()]
    least = 0
    while len(terms) < most:
        chosen = follow(grown, free)
        if chosen < 0:
            break
        free[chosen] = False
        if not grown.add(candidates[chosen]):
            continue
        terms.append(chosen)
        errors.append(grown.errors())
        if errors[-1][1] < errors[least][1]:
            least = len(terms)
        elif len(terms) - least > max(16, least // 3):
            break
        if errors[-1][1] < _EXACT:
            break
    size = grown.size
    plain, corrected = np.array(errors).T
    return Path(
        terms=np.array(terms, dtype=np.int64), inverse=grown.inverse[:size, :size],
        projections=grown.projections[:size], plain=plain, corrected=corrected,
    )  # fmt: skip


def in_order(candidates: Array, outputs: Array, weights: Array, most: int) -> Path:
    """Plain least squares: the terms as they are ordered, low degrees first."""

    def follow(grown: _Growing, free: Flags) -> int:
        return int(np.argmax(free)) if free.any() else -1

    return _walk(candidates, outputs, weights, most, follow)


def matching_pursuit(candidates: Array, outputs: Array, weights: Array, most: int) -> Path:
    """Orthogonal matching pursuit: next comes the term that is closest to what is left (Y. C. Pati, R. Rezaiifar,
    P. S. Krishnaprasad, Asilomar 1993)."""

    def follow(grown: _Growing, free: Flags) -> int:
        likeness = np.abs(candidates @ grown.residual)
        likeness[~free] = -1.0
        chosen = int(np.argmax(likeness))
        return chosen if likeness[chosen] > 0.0 else -1

    return _walk(candidates, outputs, weights, most, follow)


def least_angle(candidates: Array, outputs: Array, weights: Array, most: int) -> Path:
    """Least angle regression as the order of entry, least squares for the coefficients (B. Efron, T. Hastie,
    I. Johnstone, R. Tibshirani, Ann. Statist. 32, 2004, 407)."""
    likeness = candidates @ (outputs - outputs.mean())
    active: list[int] = []
    factor = np.zeros((0, 0))

    def follow(grown: _Growing, free: Flags) -> int:
        nonlocal likeness, factor
        if active:
            step = _equiangular(candidates, likeness, active, factor, free)
            if step is None:
                return -1
            likeness = step
        size = np.abs(likeness)
        size[~free] = -1.0
        chosen = int(np.argmax(size))
        if size[chosen] <= 0.0:
            return -1
        grew = _extended(candidates, active, factor, chosen)
        if grew is not None:
            factor = grew
            active.append(chosen)
        return chosen

    return _walk(candidates, outputs, weights, most, follow)


def _extended(candidates: Array, active: list[int], factor: Array, chosen: int) -> Array | None:
    """Inverse (k + 1, k + 1) of the Cholesky factor of the active terms' products, one term more."""
    k = len(active)
    term = candidates[chosen]
    across = candidates[active] @ term if k else np.empty(0)
    solved = factor @ across
    rest = float(term @ term - solved @ solved)
    if not rest > _DEPENDENT**2 * float(term @ term):
        return None
    length = math.sqrt(rest)
    grown = np.zeros((k + 1, k + 1))
    grown[:k, :k] = factor
    grown[k, :k] = -(solved @ factor) / length
    grown[k, k] = 1.0 / length
    return grown


def _equiangular(candidates: Array, likeness: Array, active: list[int], factor: Array, free: Flags) -> Array | None:
    """Correlations after the step on which a further term becomes as close as the active ones; None at the end."""
    signs = np.sign(likeness[active])
    weights = factor.T @ (factor @ signs)
    norm = float(signs @ weights)
    if not norm > 0.0:
        return None
    scale = 1.0 / math.sqrt(norm)
    slopes = candidates @ ((scale * weights) @ candidates[active])
    level = float(np.abs(likeness[active]).mean())
    with np.errstate(divide="ignore", invalid="ignore"):
        steps = np.concatenate([
            ((level - likeness) / (scale - slopes))[free],
            ((level + likeness) / (scale + slopes))[free],
        ])  # fmt: skip
    steps = steps[steps > 1e-15 * level]
    length = min(float(steps.min()) if steps.size else math.inf, level / scale)
    return np.asarray(likeness - length * slopes)


#: how a sparse set of terms may be found, by name; all share one signature
SOLVERS: Final[dict[str, Callable[[Array, Array, Array, int], Path]]] = {
    "least squares": in_order,
    "matching pursuit": matching_pursuit,
    "least angle": least_angle,
}

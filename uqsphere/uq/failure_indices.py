"""What a failure hangs on: shares of the inputs in where the failures lie, in standard normal space."""

from __future__ import annotations

from typing import Final

import numpy as np

from uqsphere.arrays import Array

BY_DIRECTION: Final = "squared direction of the centre of failures in standard normal space"
BY_INFORMATION: Final = "how much a failure tells of each input by itself: failures lie in several directions"

#: the failures lie in one direction if their centre is at least so far out as a plane limit state would have it
_ONE_SIDED: Final = 0.7
#: equally probable classes of an input, of which the failures take up some more than others
_CLASSES: Final = 16


def failure_shares(scores: Array, weight: Array, strength: Array | None = None) -> tuple[Array, str] | None:
    """Shares of the inputs in the failures, and how they were found.

    Where the failures lie in one direction, the shares are the squared direction cosines of their centre, which for a
    plane limit state are those of the design point.  Two opposite ways to fail have a centre that says nothing: there
    the shares are those of the Kullback-Leibler divergences of the inputs' laws given failure, input by input.

    Parameters
    ----------
    scores : (n, d) array
        Standard normal scores of the inputs.
    weight : (n,) array
        Probability of failure of each row, 0 or 1 where nothing is integrated.
    strength : (n,) array, optional
        Standard normal score of the strength below which each row fails: the strength is integrated, and is one input
        more, the last one.

    Returns
    -------
    (shares, method) or None
        Shares (d,) or (d + 1,) of sum 1, and BY_DIRECTION or BY_INFORMATION; None where no row fails, or all do, or
        where the squares of the probabilities are beneath all numbers.

    >>> scores = np.array([[2.0, 0.5], [2.0, -0.5], [0.0, 1.0], [0.0, 0.0]])
    >>> failure_shares(scores, np.array([1.0, 1.0, 0.0, 0.0]))[0].tolist()
    [1.0, 0.0]
    """
    from scipy.special import ndtr, ndtri

    n = len(weight)
    mass = float(weight.sum())
    if not mass < n or not np.square(weight).any():
        return None
    # both centres lie on one line through the origin; that of the fewer rows is seen more clearly
    fewer = weight if mass <= 0.5 * n else 1.0 - weight
    centre = fewer @ scores
    if strength is not None:
        # E[z 1(z < zeta)] = -phi(zeta), and that of the others is its opposite
        own = float(np.exp(-0.5 * strength**2).sum()) / np.sqrt(2.0 * np.pi)
        centre = np.append(centre, -own if fewer is weight else own)
    expected = n * np.exp(-0.5 * ndtri(mass / n) ** 2) / np.sqrt(2.0 * np.pi)
    length = float(np.linalg.norm(centre))
    if length >= _ONE_SIDED * expected:
        return np.square(centre / length), BY_DIRECTION
    information = [_divergence(ndtr(scores[:, k]), weight) for k in range(scores.shape[1])]
    if strength is not None:
        edges = ndtri(np.arange(_CLASSES + 1) / _CLASSES)
        below = ndtr(np.minimum(edges[:, None], strength)).sum(axis=1)
        information.append(max(_relative_entropy(np.diff(below) / mass), 0.0))
    total = sum(information)
    if not total > 0.0:
        return None
    return np.array(information) / total, BY_INFORMATION


def _divergence(levels: Array, weight: Array) -> float:
    """Divergence of the rows by weight from the uniform law of their levels (n,), less what chance alone would give."""
    classes = np.minimum((levels * _CLASSES).astype(int), _CLASSES - 1)
    mass = float(weight.sum())
    effective = mass**2 / float(np.square(weight).sum())
    found = _relative_entropy(np.bincount(classes, weights=weight, minlength=_CLASSES) / mass)
    return max(found - (_CLASSES - 1) / (2.0 * effective), 0.0)


def _relative_entropy(shares: Array) -> float:
    taken = shares[shares > 0.0]
    return float((taken * np.log(taken * len(shares))).sum())

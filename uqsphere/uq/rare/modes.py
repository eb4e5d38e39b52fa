"""How many separate parts a failure domain has, from the weighted failures of importance sampling."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array
from uqsphere.uq.rare.mixture import Mixture, component_densities
from uqsphere.uq.rare.problem import Evaluator, log_normal_density
from uqsphere.uq.rare.radial import Radial

Indices = npt.NDArray[np.int64]

__all__ = ["count_modes"]

#: candidates that are joined or told apart
MOST_CENTRES = 8
#: dimensions up to which peaks are looked for among the points themselves
MOST_DIMENSIONS = 10
#: evaluations on the two paths between two peaks
ON_PATHS = 14
#: share of the probability from which on a part counts
LEAST_SHARE = 0.01
#: a saddle lower than this many natural logarithms below the lower of two peaks separates them
DEPTH = 2.0


def count_modes(evaluator: Evaluator, points: Array, weights: Array, mixture: Mixture) -> int:
    """Number of parts of the failure domain, seen from where it is most probable.

    Peaks are failing points (n, d) whose density is greatest, at least 1.5 standard deviations apart; in many
    dimensions, where points are far from everything, the centres of the mixture's components.  Two are one where
    the density along the straight line between them, or along the arc about the origin, does not sink below the
    lower peak by more than `DEPTH` logarithms.  A part counts with a hundredth of the weight.
    """
    failing = np.asarray(np.flatnonzero(weights > 0.0), dtype=np.int64)
    if not failing.size:
        return 0
    affordable = _affordable(evaluator.left)
    if points.shape[1] > MOST_DIMENSIONS:
        kept = np.argsort(-mixture.shares, kind="stable")[:affordable]
        centres = _centres(mixture)[kept]
        belongs = component_densities([mixture.components[k] for k in kept], points[failing]).argmax(axis=1)
    else:
        order = failing[np.argsort(-log_normal_density(points[failing]), kind="stable")]
        centres = points[_peaks(points, weights, order)[:affordable]]
        belongs = ((points[failing][:, None, :] - centres[None, :, :]) ** 2).sum(axis=2).argmin(axis=1)
    if len(centres) == 1:
        return 1
    labels = _joined(evaluator, centres)
    shares = np.bincount(labels[belongs], weights=weights[failing], minlength=len(centres))
    return max(1, int((shares >= LEAST_SHARE * shares.sum()).sum()))


def _affordable(left: float) -> int:
    """Number of peaks that so many evaluations can tell apart, at least one."""
    count = MOST_CENTRES
    while count > 1 and count * (count - 1) // 2 * ON_PATHS + count > left:
        count -= 1
    return count


def _centres(mixture: Mixture) -> Array:
    """A typical point of every component; that of scattered directions lies near the origin."""
    return np.array(
        [
            c.mean * c.concentration / (c.concentration + c.mean.size) if isinstance(c, Radial) else c.mean
            for c in mixture.components
        ]
    )


def _peaks(points: Array, weights: Array, order: Indices) -> list[int]:
    """Most probable failures that lie apart; a candidate must have some weight around it."""
    total = float(weights.sum())
    chosen: list[int] = []
    remaining = order
    while remaining.size and len(chosen) < MOST_CENTRES:
        k = int(remaining[0])
        distances = np.linalg.norm(points[remaining] - points[k], axis=1)
        around = distances < 1.5
        if float(weights[remaining[around]].sum()) > 0.2 * LEAST_SHARE * total:
            chosen.append(k)
        remaining = remaining[~around]
    return chosen or [int(order[0])]


def _paths(first: Array, second: Array) -> Array:
    """Points on the straight line between two points, and on the arc about the origin just outside of them."""
    along = np.linspace(0.0, 1.0, 9)[1:-1, None]
    line = (1.0 - along) * first + along * second
    lengths = float(np.linalg.norm(first)), float(np.linalg.norm(second))
    cosine = float(first @ second) / max(lengths[0] * lengths[1], 1e-9)
    if abs(cosine) > 0.98 or min(lengths) < 1e-9:
        # opposite points have no one arc between them, nor has the origin, and that of neighbours is the line
        return np.concatenate([line, line])
    angle = math.acos(cosine)
    radius = 1.02 * ((1.0 - along) * lengths[0] + along * lengths[1])
    turned = np.sin((1.0 - along) * angle) * first / lengths[0] + np.sin(along * angle) * second / lengths[1]
    return np.concatenate([line, radius * turned / math.sin(angle)])


def _joined(evaluator: Evaluator, peaks: Array) -> Indices:
    """Labels (m,) of peaks after joining those without a saddle between them."""
    m = len(peaks)
    pairs = [(i, j) for i in range(m) for j in range(i + 1, m)]
    paths = np.concatenate([_paths(peaks[i], peaks[j]) for i, j in pairs])
    points = np.concatenate([paths, peaks])
    with np.errstate(divide="ignore"):
        heights = np.log(np.nan_to_num(evaluator.mass(evaluator.values(points)), nan=0.0))
    heights = heights + log_normal_density(points)
    tops = heights[len(paths) :]
    ridge = np.full((m, m), -np.inf)
    saddles = heights[: len(paths)].reshape(len(pairs), 2, -1).min(axis=2).max(axis=1)
    for (i, j), saddle in zip(pairs, saddles, strict=True):
        ridge[i, j] = ridge[j, i] = min(float(saddle), tops[i], tops[j])
    # the highest pass between two peaks may lead over others
    for k in range(m):
        ridge = np.maximum(ridge, np.minimum(ridge[:, k, None], ridge[None, k, :]))
    labels = np.arange(m, dtype=np.int64)
    heads: list[int] = []
    for k in np.argsort(-tops, kind="stable"):
        # a centre that does not fail is no peak: what belongs to it joins the highest
        below = [h for h in heads if not tops[k] > -np.inf or ridge[k, h] > tops[k] - DEPTH]
        if below:
            labels[k] = max(below, key=lambda h: float(ridge[k, h]))
        else:
            heads.append(int(k))
    return labels

"""Where a cheaper model is believed: an estimate of its error from the row's own numbers, and the rows it fails."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.arrays import Array, Flags

if TYPE_CHECKING:
    from uqsphere.mechanics.scene import Scene


#: what is taken for the exponents of mu and theta before anything is measured: the difference of the two forces,
#: which the massless model leaves out, grows as mu^0.45 (docs/theory.md, section 5)
PRIOR = (0.45, 0.0)
#: weight of that in measured rows: some few rows over a wide range of mu outweigh it, many over a narrow one do not
PRIOR_WEIGHT = 4.0
#: errors oscillate through zero: what is below this share of their root mean square counts as that
LEAST = 0.05
#: how far the law is put above the largest error it was fitted to, and how far mu and theta may lie outside of the rows
#: that it was fitted to: a quarter (docs/theory.md, section 5)
MARGIN = 1.25


@dataclass(frozen=True, kw_only=True)
class Fallback:
    """An error estimate of a cheaper fidelity, and the rows it leaves to `full`.

    In each of q quantities the error over a fixed scale is exp(c_0 + c_1 ln mu + c_2 ln theta) with mass number mu and
    pulse number theta of the row (no third term where no pulse ends).  A row is left to `full` if that exceeds the
    bound in any quantity, or if mu or theta lies outside the range the law was fitted in: its answer depends on nothing
    else.
    """

    coefficients: tuple[tuple[float, float, float], ...]
    bounds: tuple[float, ...]
    mass_range: tuple[float, float]
    pulse_range: tuple[float, float]

    def estimate(self, scene: Scene) -> Array:
        """Estimated error over the scale, (n, q)."""
        table = np.array(self.coefficients).T
        with np.errstate(all="ignore"):
            columns = _features(scene.scales.mass_number, scene.scales.pulse_number).T[:, :, None]
            # term by term: a product of matrices may round otherwise in a batch of another size
            return np.asarray(np.exp(columns[0] * table[0] + columns[1] * table[1] + columns[2] * table[2]))

    def doubtful(self, scene: Scene) -> Flags:
        """Rows that are left to `full`, (n,)."""
        mu, theta = scene.scales.mass_number, scene.scales.pulse_number
        with np.errstate(all="ignore"):
            believed = (self.estimate(scene) <= np.array(self.bounds)).all(axis=1)
            believed &= (mu >= self.mass_range[0]) & (mu <= self.mass_range[1])
            believed &= (theta >= self.pulse_range[0]) & (theta <= self.pulse_range[1])
        return np.asarray(~believed)


def _features(mu: Array, theta: Array) -> Array:
    """1, ln mu, ln theta in columns; an endless pulse has no third one."""
    ends = np.isfinite(theta)
    return np.stack([np.ones_like(mu), np.log(mu), np.log(np.where(ends, theta, 1.0))], axis=1)


def fit_error_law(
    mass_number: Array, pulse_number: Array, errors: Array
) -> tuple[tuple[tuple[float, float, float], ...], tuple[float, float], tuple[float, float]]:
    """The law of `Fallback` that lies above measured errors: coefficients, and ranges of mu and theta of the rows.

    Least squares in logarithms, drawn to the exponents that theory expects where the rows lie too close together to
    tell, then raised until it lies a quarter above the largest error seen.  mass_number, pulse_number (n,): mu and
    theta, which may be infinite; errors (n, q): absolute ones over the scale.

    >>> mu = np.geomspace(1e-4, 1e-2, 50)
    >>> law, _, _ = fit_error_law(mu, np.full(50, np.inf), 0.3 * mu[:, None] ** 0.5)
    >>> round(law[0][1], 2), bool(np.exp(law[0][0] + law[0][1] * np.log(1e-3)) > 0.3 * 1e-3**0.5)
    (0.5, True)
    """
    features = _features(mass_number, pulse_number)
    centre = features.mean(axis=0) * np.array([0.0, 1.0, 1.0])
    rows = features - centre
    weights = np.diag([1e-9, PRIOR_WEIGHT, PRIOR_WEIGHT])
    coefficients = []
    for column in np.abs(errors).T:
        level = max(LEAST * float(np.sqrt(np.mean(column**2))), 1e-300)
        target = np.log(np.maximum(column, level))
        found = np.linalg.solve(rows.T @ rows + weights, rows.T @ target + weights @ np.array([0.0, *PRIOR]))
        above = float((target - rows @ found).max()) + np.log(MARGIN)
        coefficients.append((float(found[0] - found @ centre + above), float(found[1]), float(found[2])))
    return (
        tuple(coefficients),
        (float(mass_number.min()) / MARGIN, float(mass_number.max()) * MARGIN),
        (float(pulse_number.min()) / MARGIN, float(pulse_number.max()) * MARGIN),
    )

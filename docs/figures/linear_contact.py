"""The linear contact of the paper's section 4 between infinite bars in closed form, theory (14)."""

from __future__ import annotations

import math

import numpy as np

from uqsphere.arrays import Array, Values


def linear_approaches(s: Values, mu: Values, theta: Values = math.inf) -> tuple[Array, Array]:
    """Scaled approaches x_1, x_2 of the linear contact in infinite bars, theory (14).

    Under a step x_1, x_2 = 1 - e^(-s) ± e^(-s/2) sin(w s)/w, w² = 2/mu - 1/4 (hyperbolic for mu >
    8, s e^(-s/2) at mu = 8); a rectangular pulse is a step minus a later one.  s: time over t_c.
    mu: M/(Z t_c) > 0.  theta: pulse length over t_c.  Valid until an approach becomes negative.
    Source: W. K. Nowacki, Engng. Trans. 42(3), 1994, (4.5) and (4.8); (4.9) lacks the decay.

    >>> x_1, x_2 = linear_approaches(30.0, 0.1)
    >>> bool(abs(x_1 - 1.0) < 1e-6), bool(abs(x_2 - 1.0) < 1e-6)
    (True, True)
    """
    s, mu, theta = np.broadcast_arrays(
        *(np.asarray(value, dtype=float) for value in (s, mu, theta))
    )
    late = np.maximum(s - theta, 0.0)
    mean = -np.expm1(-s) + np.expm1(-late)
    half = _step_difference(s, mu) - _step_difference(late, mu)
    return mean + half, mean - half


def _step_difference(s: Array, mu: Array) -> Array:
    """Half the difference of the approaches under a linear step.

    It is e^(-s/2) sin(w s)/w with w² = 2/mu - 1/4.
    """
    square = 2.0 / mu - 0.25
    swinging = square > 0.0
    w = np.sqrt(np.abs(square))
    swing = np.exp(-0.5 * s) * s * np.sinc(w * s / math.pi)
    # overdamped, mu > 8: the hyperbolic sine in decaying exponentials only, so that nothing
    # overflows
    k = np.where(swinging, 0.0, w)
    creep = np.where(k > 0.0, -np.expm1(-2.0 * k * s) / (2.0 * np.where(k > 0.0, k, 1.0)), s)
    return np.where(swinging, swing, creep * np.exp((k - 0.5) * s))

"""One step of the reference integrator: implicit collocation at 20 Radau points in extended precision.

Over a step the state X = (x_1, x_2, u) is a polynomial of degree 20 that satisfies the equations of motion at
the points c_1 ... c_20 = 1 of the right Radau rule (E. Hairer, G. Wanner, Solving Ordinary Differential Equations
II, 1996, section IV.5), in the integrated form

    X(c_i) = X(0) + h sum of a_ij F(c_j)

solved by Newton's method: matrix in double, residual in `numpy.longdouble`, so that every iteration gains the
digits that the matrix is good for.  The method is implicit and damps what it does not resolve, so a step may
be long where a stiff oscillation has died out; where it has not, the Chebyshev coefficients of the step do not
fall off and the step is refused.  Nothing is shared with the batch integrator but the equations.

Where the motion has a power t^(3/2) or t^(7/2) at the start of a step, the step is taken in sigma, t = h sigma^m.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

__all__ = ["FINE", "FINE_BASIS", "FINE_SLOPES", "NODES", "TAIL", "Piece", "chebyshev", "collocate", "evaluate"]

Array = npt.NDArray[Any]
Long = np.longdouble

#: collocation points of a step
NODES: Final = 20
#: last coefficients of an accepted step over the largest value of the state so far: extended precision, or the
#: best that this machine's longest float gives
TAIL: Final[float] = max(1e-16, 30.0 * float(np.finfo(Long).eps))
_ITERATIONS: Final = 14


def chebyshev(theta: Array, degree: int = NODES) -> Array:
    """T_0 ... T_degree of 2 theta - 1, (len(theta), degree + 1)."""
    z = 2.0 * np.asarray(theta, dtype=Long) - 1.0
    values = np.empty((len(z), degree + 1), dtype=Long)
    values[:, 0], values[:, 1] = 1.0, z
    for k in range(2, degree + 1):
        values[:, k] = 2.0 * z * values[:, k - 1] - values[:, k - 2]
    return values


def _legendre(z: Array, degree: int) -> tuple[Array, Array]:
    """P_degree and its derivative inside (-1, 1)."""
    before, value = np.ones_like(z), z.copy()
    for k in range(2, degree + 1):
        before, value = value, ((2 * k - 1) * z * value - (k - 1) * before) / k
    return value, degree * (z * value - before) / (z * z - 1.0)


def _radau() -> Array:
    """Points of the right Radau rule on (0, 1]: the roots of P_(n-1) - P_n, of which 1 is the last."""
    series = np.zeros(NODES + 1)
    series[NODES - 1], series[NODES] = 1.0, -1.0
    z = np.sort(np.polynomial.legendre.legroots(series))[:-1].astype(Long)
    for _ in range(4):
        one, two = _legendre(z, NODES - 1), _legendre(z, NODES)
        z -= (one[0] - two[0]) / (one[1] - two[1])
    return np.append(0.5 * (1.0 + z), Long(1.0))


def _inverse(matrix: Array) -> Array:
    """Inverse in extended precision: that of double, improved three times by X (2 - M X)."""
    found = np.linalg.inv(matrix.astype(float)).astype(Long)
    two = 2.0 * np.eye(len(matrix), dtype=Long)
    for _ in range(3):
        found = found @ (two - matrix @ found)
    return found


def _integrals(theta: Array, degree: int) -> Array:
    """Integrals of T_0 ... T_degree of 2 theta - 1 from 0 to theta."""
    upper, lower = chebyshev(theta, degree + 1), chebyshev(np.zeros(1), degree + 1)
    values = np.empty((len(theta), degree + 1), dtype=Long)
    values[:, 0] = theta
    values[:, 1] = 0.125 * (upper[:, 2] - lower[:, 2])
    for k in range(2, degree + 1):
        rise = upper - lower
        values[:, k] = 0.25 * (rise[:, k + 1] / (k + 1) - rise[:, k - 1] / (k - 1))
    return values


def _slopes(theta: Array) -> Array:
    """Derivatives by theta of T_0 ... T_NODES of 2 theta - 1."""
    return _both(theta)[1]


def _both(theta: Array) -> tuple[Array, Array]:
    """T_0 ... T_NODES of 2 theta - 1 and their derivatives by theta."""
    values = chebyshev(theta)
    slopes = np.zeros_like(values)
    slopes[:, 1] = 2.0
    slopes[:, 2] = 4.0 * values[:, 1] * 2.0
    for k in range(3, NODES + 1):  # T_k' = 2k T_(k-1) + k/(k-2) T_(k-2)', by z
        slopes[:, k] = 4.0 * k * values[:, k - 1] + k / Long(k - 2) * slopes[:, k - 2]
    return values, slopes


POINTS: Final = _radau()
#: values at 0 and the points -> Chebyshev coefficients
TO_SERIES: Final = _inverse(chebyshev(np.append(Long(0.0), POINTS)))
#: a_ij of the collocation
WEIGHTS: Final = _integrals(POINTS, NODES - 1) @ _inverse(chebyshev(POINTS, NODES - 1))
_WEIGHTS_DOUBLE: Final = WEIGHTS.astype(float)
#: where a step is looked at for events
FINE: Final = np.linspace(0.0, 1.0, 61).astype(Long)
FINE_BASIS: Final = chebyshev(FINE)
FINE_SLOPES: Final = _slopes(FINE)


@dataclass(frozen=True, kw_only=True)
class Piece:
    """The motion over one step: t = start + length theta^power, 0 <= theta <= 1, scaled time.

    `states` (NODES + 1, 3) are the Chebyshev coefficients of x_1, x_2, u, `waves` (NODES + 1, 2) those of the
    waves g_A and k_B that leave the faces, `tail` the size of the last coefficients over that of the state.
    """

    start: Any
    length: Any
    power: int
    states: Array
    waves: Array
    tail: float
    expected: float

    def share(self, times: Array) -> Array:
        """theta at `times`."""
        passed = np.maximum((times - self.start) / self.length, 0.0)
        return np.asarray(passed if self.power == 1 else passed ** (Long(1.0) / self.power))

    def time(self, theta: Any) -> Any:
        """Time at theta."""
        return self.start + self.length * Long(theta) ** self.power


def evaluate(series: Array, theta: Any) -> tuple[Array, Array]:
    """Values and derivatives by theta of Chebyshev series (NODES + 1, columns) at one theta, (columns,)."""
    values, slopes = _both(np.array([theta], dtype=Long))
    return (values @ series)[0], (slopes @ series)[0]


def _matrix(roots: Array, weights: Array, mass: float) -> Array:
    """Newton's matrix of a step: one minus h a_ij times the Jacobian at the points."""
    n = NODES
    matrix = np.eye(3 * n)
    mix = _WEIGHTS_DOUBLE * weights
    slopes = 1.5 * roots
    a, b = mix * slopes[:, 0], mix * slopes[:, 1]
    matrix[:n, :n] += a
    matrix[:n, 2 * n :] = mix
    matrix[n : 2 * n, n : 2 * n] += b
    matrix[n : 2 * n, 2 * n :] = -mix
    matrix[2 * n :, :n] = -a / mass
    matrix[2 * n :, n : 2 * n] = b / mass
    return matrix


def collocate(
    begin: Array, guess: Array, push: Array, start: Any, length: Any, power: int, mass: Any, sizes: Array
) -> Piece | None:
    """Solve the equations of motion over one step; None if Newton's method does not converge.

    begin (3,): state at the start.  guess (NODES, 3): first guess at the points.  push (NODES + 1, 2): the waves
    f and h at the start and the points.  sizes (3,): largest values of the states so far.
    """
    from scipy.linalg import lapack

    weights = length * power * POINTS ** (power - 1)
    state, factors, before = guess.copy(), None, np.inf
    for iteration in range(_ITERATIONS):
        pressed = np.maximum(state[:, :2], 0.0)
        roots = np.sqrt(pressed)
        force = pressed * roots
        rates = np.empty_like(state)
        rates[:, 0] = 2.0 * push[1:, 0] - force[:, 0] - state[:, 2]
        rates[:, 1] = state[:, 2] - force[:, 1] - 2.0 * push[1:, 1]
        rates[:, 2] = (force[:, 0] - force[:, 1]) / mass
        residual = (begin + WEIGHTS @ (weights[:, None] * rates) - state).astype(float)
        if not np.isfinite(residual).all():
            return None
        if factors is None:
            lu, pivots, _ = lapack.dgetrf(_matrix(roots.astype(float), weights.astype(float), float(mass)))
            factors = (lu, pivots)
        change = lapack.dgetrs(*factors, residual.T.ravel())[0].reshape(3, NODES).T
        state = state + change
        scale = np.maximum(sizes, np.abs(state).max(axis=0)) + Long(1e-300)
        moved = float((np.abs(change) / scale).max())
        if moved < 0.01 * TAIL or (moved < TAIL and moved > 0.2 * before):
            break
        if moved > 0.05 * before or iteration < 2:
            factors = None
        before = moved
    else:
        return None
    full = np.concatenate([begin[None, :], state])
    series = TO_SERIES @ full
    pressed = np.maximum(full[:, :2], 0.0)
    force = pressed * np.sqrt(pressed)
    waves = TO_SERIES @ np.stack([push[:, 0] - force[:, 0], force[:, 1] + push[:, 1]], axis=1)
    tail = float((np.abs(series[-2:]).max(axis=0) / scale).max())
    middle = float((np.abs(series[NODES // 2 - 1 : NODES // 2 + 2]).max(axis=0) / scale).max())
    return Piece(
        start=start, length=length, power=power, states=series, waves=waves,
        tail=tail, expected=max(1e-30, min(tail, 1e2 * middle * middle)),
    )  # fmt: skip

"""The first short step from a touch, where x^(3/2) has no power series in time: Runge-Kutta steps
of order 4 over h, whose ends cubics join in place of the series.
"""

from __future__ import annotations

from .compiled import compiled
from .events import value_of
from .faces import face_force
from .tracked import LANES, MASSLESS, TERMS

#: Runge-Kutta steps over a touch; its stages: shares of a step, and their weights
_TOUCH_STEPS = 4
_STAGES = ((0.0, 1.0 / 6.0), (0.5, 1.0 / 3.0), (0.5, 1.0 / 3.0), (1.0, 1.0 / 6.0))


@compiled
def _slopes(s, j, theta):
    """Right-hand side of theory (9) and (R3) for one lane, from s.trial to s.slope: x_1, x_2, u,
    U_A, -U_B.
    """
    b = LANES + j
    x_1 = s.trial[0]
    x_2 = s.trial[1]
    u = s.trial[2]
    push_a = value_of(s.push, j, theta)
    push_b = value_of(s.push, b, theta)
    force_a, _ = face_force(s, j, x_1)
    force_b, _ = face_force(s, b, x_2)
    s.slope[0] = s.there[j] * (push_a - s.gives[j] * force_a - u + s.trial[3])
    s.slope[1] = s.there[b] * (push_b - s.gives[b] * force_b + u + s.trial[4])
    s.slope[2] = (force_a - force_b) * s.inverse_mu[j]
    s.slope[3] = -s.lightness[j] * force_a
    s.slope[4] = -s.lightness[b] * force_b
    if s.mode == MASSLESS:  # both faces move alike
        s.slope[0] = s.slope[1] = 0.5 * (push_a + push_b) - force_a


@compiled
def _join(series, m, rate, end, end_rate):
    """Put the cubic through the first term and its rate, and through the end and its, into a
    column.
    """
    rise = end - series[0, m]
    series[1, m] = rate
    series[2, m] = 3.0 * rise - 2.0 * rate - end_rate
    series[3, m] = rate + end_rate - 2.0 * rise
    for k in range(4, TERMS):
        series[k, m] = 0.0


@compiled
def step_from_touch(s, j):
    """Replace the series of a lane by cubics that join both ends of its trial step, all of which
    holds.
    """
    s.theta[j] = 1.0
    b = LANES + j
    h = s.h[j]
    part = 1.0 / _TOUCH_STEPS
    columns = ((s.x, j), (s.x, b), (s.u, j), (s.free, j), (s.free, b))
    for v in range(5):
        series, m = columns[v]
        s.now[v] = s.trial[v] = series[0, m]
    _slopes(s, j, 0.0)
    for v in range(5):
        s.at_touch[v] = h * s.slope[v]
    for i in range(_TOUCH_STEPS):
        for v in range(5):
            s.mean[v] = 0.0
        for stage, weight in _STAGES:
            for v in range(5):
                s.trial[v] = s.now[v] + stage * part * h * s.slope[v]
            _slopes(s, j, (i + stage) * part)
            for v in range(5):
                s.mean[v] += weight * s.slope[v]
        for v in range(5):
            s.now[v] += part * h * s.mean[v]
            s.trial[v] = s.now[v]
    _slopes(s, j, 1.0)
    for v in range(5):
        series, m = columns[v]
        _join(series, m, s.at_touch[v], s.now[v], h * s.slope[v])
    for face in range(2):
        m = face * LANES + j
        s.force[0, m], slope = face_force(s, m, s.x[0, m])
        end, end_slope = face_force(s, m, s.now[face])
        _join(s.force, m, slope * s.at_touch[face], end, end_slope * h * s.slope[face])
    for k in range(TERMS):  # the speed of the sphere stands in both columns
        s.u[k, b] = s.u[k, j]

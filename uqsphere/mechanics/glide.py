"""Steps along the slow motion: once the fast oscillation has died out, nothing of it needs to be resolved.

For small mu the difference z = x_1 - x_2 of the approaches swings with the frequency sqrt(3 sqrt(x)/mu) and dies
out at the rate 0.75 sqrt(x).  What is left follows the waves: with m = (x_1 + x_2)/2 and D = q(x_1) - q(x_2),
theory (9) reads

    m' = f - h - (q(x_1) + q(x_2))/2        u = f + h - D/2 - z'/2        D = mu u'

Starting from z = 0, the second and the third equation give u, D and z in turn, each round a factor of about
mu smaller, all as power series over the step; the first one is integrated term by term.  The series is used where
it satisfies the equations of motion to the tolerance and where it meets the state of the row.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.compiled import compiled
from uqsphere.mechanics.series import INNER, LANES, TERMS
from uqsphere.mechanics.vectors import apart

__all__ = ["GLIDE_ROOM", "SMALL_MU", "calm_after", "glide"]

#: mass number below which the slow motion is looked for
SMALL_MU = 0.02
#: rows of working space that `glide` needs
GLIDE_ROOM = 11
#: most rounds of the iteration; each spoils the last two terms of the series
_ROUNDS = 5
#: terms that stay good after the rounds
_GOOD = 10


@compiled(**INNER)
def _value(series, k_row, theta):
    total = 0.0
    for k in range(TERMS - 1, -1, -1):
        total = total * theta + series[k_row, k]
    return total


@compiled(**INNER)
def _slope(series, k_row, theta):
    total = 0.0
    for k in range(TERMS - 1, 0, -1):
        total = total * theta + k * series[k_row, k]
    return total


@compiled(**INNER)
def _slow_mean(lane, h, push, s):
    """Integrate m for a given z; rows of s: m, z, u, x_1, x_2, sqrt(x_1), sqrt(x_2), q_1, q_2."""
    apart()
    for k in range(TERMS):
        for face in range(2):
            x, y, q = 3 + face, 5 + face, 7 + face
            s[x, k] = s[0, k] + (0.5 - face) * s[1, k]
            if k == 0:
                if not s[x, 0] > 0.0:
                    return False
                s[y, 0] = math.sqrt(s[x, 0])
            else:
                total = 0.0
                for i in range(1, k):
                    total += s[y, i] * s[y, k - i]
                s[y, k] = 0.5 * (s[x, k] - total) / s[y, 0]
            total = 0.0
            for i in range(k + 1):
                total += s[x, i] * s[y, k - i]
            s[q, k] = total
        if k < TERMS - 1:
            rate = 0.5 * (push[k, lane] + push[k, LANES + lane] - s[7, k] - s[8, k])
            s[0, k + 1] = h * rate / (k + 1.0)
    return True


@compiled(**INNER)
def _correct(lane, h, mu, push, s):
    """One round: u from the waves, D from u, z from D.  Returns the largest change of z in the step, of its terms."""
    apart()
    # s[9]: what D lacks, s[10]: the change of z
    for k in range(TERMS):
        swing = (k + 1.0) * s[1, k + 1] / h if k + 1 < TERMS else 0.0
        s[2, k] = 0.5 * (push[k, lane] - push[k, LANES + lane] - (s[7, k] - s[8, k]) - swing)
    for k in range(TERMS):
        wanted = mu * (k + 1.0) * s[2, k + 1] / h if k + 1 < TERMS else 0.0
        s[9, k] = (wanted - (s[7, k] - s[8, k])) / 0.75
    lead, change = s[5, 0] + s[6, 0], 0.0
    for k in range(TERMS):
        total = s[9, k]
        for i in range(1, k + 1):
            total -= (s[5, i] + s[6, i]) * s[10, k - i]
        s[10, k] = total / lead
        s[1, k] += s[10, k]
        if k <= _GOOD:
            change += abs(s[10, k])
    return change


@compiled(**INNER)
def _residual(lane, h, mu, push, s, theta):
    """Largest error with which the series satisfies the equations at theta, as an error of an approach."""
    apart()
    a, b, w = _value(s, 3, theta), _value(s, 4, theta), _value(s, 2, theta)
    if not (a > 0.0 and b > 0.0):
        return math.inf
    push_a, push_b = 0.0, 0.0
    for k in range(TERMS - 1, -1, -1):
        push_a, push_b = push_a * theta + push[k, lane], push_b * theta + push[k, LANES + lane]
    force_a, force_b = a * math.sqrt(a), b * math.sqrt(b)
    length = theta * h
    first = abs(_slope(s, 3, theta) / h - (push_a - force_a - w)) * length
    second = abs(_slope(s, 4, theta) / h - (push_b - force_b + w)) * length
    third = abs(mu * _slope(s, 2, theta) / h - (force_a - force_b)) / (1.5 * math.sqrt(a))
    return max(first, max(second, third))


@compiled(**INNER)
def calm_after(mu, local):
    """Time that the oscillation which a jump sets off, about mu^0.45, needs at least to fall to the tolerance."""
    apart()
    return max(0.0, math.log(mu**0.45 / local))


@compiled(**INNER)
def glide(lane, h, mu, push, x, u, root, force, size, local, gliding, s):
    """Try to replace the step of one lane by one of the slow motion: theta it may reach, 0 if none; amplitude.

    The amplitude is that of the fast oscillation that the state of the row has about the slow motion, as an
    approach; it must lie below the tolerance.  size: scale of the approaches, s (GLIDE_ROOM, TERMS): working space.
    """
    apart()
    mean, swing, speed = 0.5 * (x[0, lane] + x[0, LANES + lane]), x[0, lane] - x[0, LANES + lane], u[0, lane]
    for k in range(TERMS):
        s[1, k] = 0.0
    s[0, 0] = mean
    allowed = local * size
    for _ in range(_ROUNDS):
        if not _slow_mean(lane, h, push, s):
            return 0.0, math.inf
        change = _correct(lane, h, mu, push, s)
        if not change < mean:
            return 0.0, math.inf
        if change < 0.01 * allowed:
            break
    if not _slow_mean(lane, h, push, s):
        return 0.0, math.inf
    fast = math.sqrt(mu / (3.0 * s[5, 0]))
    amplitude = max(abs(swing - s[1, 0]), 2.0 * abs(speed - s[2, 0]) * fast)
    if not amplitude <= (2.0 if gliding else 0.5) * allowed:
        return 0.0, amplitude
    theta = 1.0
    for _ in range(12):
        if max(_residual(lane, h, mu, push, s, theta), _residual(lane, h, mu, push, s, 0.6 * theta)) <= allowed:
            break
        theta *= 0.6
    else:
        return 0.0, amplitude
    for k in range(TERMS):
        x[k, lane], x[k, LANES + lane], u[k, lane] = s[3, k], s[4, k], s[2, k]
        root[k, lane], root[k, LANES + lane] = s[5, k], s[6, k]
        force[k, lane], force[k, LANES + lane] = s[7, k], s[8, k]
    return theta, amplitude

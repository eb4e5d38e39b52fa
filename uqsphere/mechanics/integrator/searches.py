"""Places sought in one step of a row: roots, tops and passages of thresholds, on the series of the
step.

What is searched is s.piece (TERMS, 2): the part of a step's series that belongs to one lane, powers
of theta; all quantities are the scaled ones.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import face_force, stored_energy
from uqsphere.mechanics.integrator.tracked import (
    DIFFERENCE,
    ENERGY,
    FACE_B,
    LANES,
    MEAN,
    ORDER,
    POINTS,
    SHARE,
    TERMS,
)
from uqsphere.mechanics.integrator.vectors import apart

#: how closely a top is found as a share of the step: where its height matters, which hardly depends
#: on it; where the motion goes on from it
BROAD, SHARP = 1e-6, 1e-13


@compiled
def take_piece(s, j):
    """Put the step of a lane where it is searched, with its values and slopes at the points that
    are known.
    """
    for face in range(2):
        m = face * LANES + j
        for k in range(TERMS):
            s.piece[k, face] = s.x[k, m]
        for i in range(POINTS + 1):
            s.grid[face, 0, i], s.grid[face, 1, i] = s.at[i, m], s.rate[i, m]


@compiled
def value_of(series, m, theta):
    """Value of a column of a series inside a step."""
    total = 0.0
    for k in range(ORDER, -1, -1):
        total = total * theta + series[k, m]
    return total


@compiled
def both_of(series, m, theta):
    """Value of a column of a series inside a step and its derivative by theta."""
    total, rate = series[ORDER, m], 0.0
    for k in range(ORDER - 1, -1, -1):
        rate = rate * theta + total
        total = total * theta + series[k, m]
    return total, rate


@compiled
def _of_face(s, m, stored, x, d):
    """Force of a face, or what it stores, and its derivative, from the approach and its
    derivative.
    """
    found, slope = stored_energy(s, m, x) if stored else face_force(s, m, x)
    return found, slope * d


@compiled
def _combined(s, j, kind, x1, x2, d1, d2):
    """Value and derivative of a searched function of both faces from the approaches and their
    derivatives.
    """
    apart()
    stored = kind in (ENERGY, SHARE)
    a, slope_a = _of_face(s, j, stored, x1, d1)
    b, slope_b = _of_face(s, LANES + j, stored, x2, d2)
    if kind == DIFFERENCE:
        return a - b, slope_a - slope_b
    if kind == MEAN:
        return 0.5 * (a + b), 0.5 * (slope_a + slope_b)
    if kind == SHARE:
        chi_a, chi_b = s.chi[j], s.chi[LANES + j]
        return chi_a * a + chi_b * b, chi_a * slope_a + chi_b * slope_b
    return a + b, slope_a + slope_b


@compiled
def _measure(s, j, kind, theta):
    """Value and derivative of one of the searched functions inside a step."""
    if kind <= FACE_B:
        return both_of(s.piece, kind, theta)
    x1, d1 = both_of(s.piece, 0, theta)
    x2, d2 = both_of(s.piece, 1, theta)
    return _combined(s, j, kind, x1, x2, d1, d2)


@compiled
def highest_between(left, left_slope, right, right_slope):
    """What a function can reach between two ends: where the tangents meet, and a fifth for
    bends.
    """
    top = max(left, right)
    if left_slope > 0.0 and right_slope < 0.0:
        top += 1.2 * left_slope * right_slope / (right_slope - left_slope)
    return top


@compiled
def root(s, face, level, a, b):
    """Where a face passes `level` between a and b, which bracket it; regula falsi with the Illinois
    rule.
    """
    apart()
    at_a, at_b = value_of(s.piece, face, a) - level, value_of(s.piece, face, b) - level
    # an end may be the root itself, to the last bit: there is then nothing left to bracket
    if at_a == 0.0:
        return a
    if at_b == 0.0 or (at_a < 0.0) == (at_b < 0.0):
        return b
    for _ in range(100):
        if abs(b - a) < 1e-14 or at_b == at_a:
            break
        c = b - at_b * (b - a) / (at_b - at_a)
        if c == b:
            return b
        if not min(a, b) < c < max(a, b):
            c = 0.5 * (a + b)
        at_c = value_of(s.piece, face, c) - level
        if abs(c - b) < 1e-15 or at_c == 0.0:
            return c
        if (at_c < 0.0) != (at_b < 0.0):
            a, at_a = b, at_b
        else:
            at_a *= 0.5
        b, at_b = c, at_c
    return b


@compiled
def extremum(s, j, kind, a, b, slope_a, slope_b, close):
    """theta between a and b, to `close`, at which the slope of a searched function changes sign, as
    at the ends.
    """
    apart()
    for _ in range(60):
        c = b - slope_b * (b - a) / (slope_b - slope_a)
        if not min(a, b) < c < max(a, b):
            c = 0.5 * (a + b)
        _, slope_c = _measure(s, j, kind, c)
        if abs(c - b) < close or slope_c == 0.0:
            return c
        if (slope_c < 0.0) != (slope_b < 0.0):
            a, slope_a = b, slope_b
        else:
            slope_a *= 0.5
        b, slope_b = c, slope_c
    return b


@compiled
def curve(s, face, turns, theta):
    """Approach of a face inside a step and its derivative, or if it `turns` that and the next one.

    The even and the odd powers, of value and derivative, are four sums side by side: half as long a
    wait as `both_of`.
    """
    square, even, odd, even_rate, odd_rate = theta * theta, 0.0, 0.0, 0.0, 0.0
    for n in range(ORDER // 2, 0, -1):
        two, low, high = (
            2.0 * n,
            s.piece[2 * n, face],
            s.piece[2 * n + 1, face] if 2 * n < ORDER else 0.0,
        )
        if turns:
            low, high = two * low, (two + 1.0) * high
            even, odd = even * square + high, odd * square + low
            even_rate, odd_rate = (
                even_rate * square + (two - 1.0) * low,
                odd_rate * square + two * high,
            )
        else:
            even, odd = even * square + low, odd * square + high
            even_rate, odd_rate = (
                even_rate * square + (two + 1.0) * high,
                odd_rate * square + two * low,
            )
    if turns:
        return even * square + s.piece[1, face] + theta * odd, even_rate + theta * odd_rate
    even, odd = even * square + s.piece[0, face], odd * square + s.piece[1, face]
    return even + theta * odd, even_rate * square + s.piece[1, face] + theta * odd_rate


@compiled
def settle(s, face, turns, a, b, at_a, at_b, level):
    """theta between a and b at which a face passes `level`, or turns if `turns`; Newton, to the
    last bits.

    at_a, at_b: what is sought a zero of, at the ends, which bracket it.
    """
    apart()
    if at_a == 0.0:
        return a
    if at_b == 0.0 or (at_a < 0.0) == (at_b < 0.0):
        return b
    found = a + (b - a) * at_a / (at_a - at_b)
    for _ in range(60):
        off, slope = curve(s, face, turns, found)
        off -= level
        if off == 0.0:
            break
        if (off < 0.0) == (at_a < 0.0):
            a = found
        else:
            b = found
        following = found - off / slope
        if not a <= following <= b:
            following = 0.5 * (a + b)
        # the next step would be the square of this one
        if abs(following - found) < 1e-8:
            return following
        found = following
    return found


@compiled
def slowest(s, face, a, b):
    """theta between a and b at which a face is slowest, and its rate there; its second derivative
    rises through 0.
    """
    apart()
    _, low = curve(s, face, True, a)
    _, high = curve(s, face, True, b)
    found, rate = a, math.inf
    for _ in range(8):
        found = a - low * (b - a) / (high - low) if low < 0.0 < high else 0.5 * (a + b)
        rate, bow = curve(s, face, True, found)
        if rate < 0.0:
            break
        if bow < 0.0:
            a, low = found, bow
        else:
            b, high = found, bow
    return found, rate


@compiled
def passage(s, face, level, sign, begin, end):
    """First theta on the way from `begin` to `end` at which sign·(approach - level) >= 0, or
    NaN.
    """
    apart()
    width = (end - begin) / POINTS
    a = begin
    at_a, slope_a = both_of(s.piece, face, a)
    at_a, slope_a = sign * (at_a - level), sign * slope_a
    if at_a >= 0.0:
        return begin
    for k in range(1, POINTS + 1):
        b = begin + k * width if k < POINTS else end
        at_b, slope_b = both_of(s.piece, face, b)
        at_b, slope_b = sign * (at_b - level), sign * slope_b
        if at_b >= 0.0:
            return root(s, face, level, a, b)
        if (
            slope_a * width > 0.0 > slope_b * width
            and highest_between(at_a, slope_a * width, at_b, slope_b * width) >= 0.0
        ):
            # the search measures the slopes themselves, without the sign; of one face no lane
            # matters
            peak = extremum(s, 0, face, a, b, sign * slope_a, sign * slope_b, BROAD)
            if sign * (value_of(s.piece, face, peak) - level) >= 0.0:
                return root(s, face, level, a, peak)
        a, at_a, slope_a = b, at_b, slope_b
    return math.nan


@compiled
def survey(s, end):
    """Values and slopes of both faces at equal distances over [0, end]: s.grid (face, 2, POINTS +
    1).
    """
    apart()
    for face in range(2):
        for i in range(POINTS + 1):
            s.grid[face, 0, i], s.grid[face, 1, i] = both_of(s.piece, face, end * i / POINTS)


@compiled
def largest(s, j, kind, end, known):
    """Largest value in [0, end] of a searched function and its theta, or `known` and -1 if that is
    larger.

    Of the difference of the forces the size counts, of an approach no gap.
    """
    apart()
    width, place, signed = end / POINTS, -1.0, kind == DIFFERENCE
    left, left_slope = 0.0, 0.0
    for i in range(POINTS + 1):
        if kind <= FACE_B:
            right, right_slope = s.grid[kind, 0, i], s.grid[kind, 1, i]
        else:
            right, right_slope = _combined(
                s, j, kind, s.grid[0, 0, i], s.grid[1, 0, i], s.grid[0, 1, i], s.grid[1, 1, i]
            )
        if (abs(right) if signed else right) > known:
            known, place = abs(right), i * width
        sign = 1.0 if left + right >= 0.0 else -1.0
        top = highest_between(
            sign * left, sign * left_slope * width, sign * right, sign * right_slope * width
        )
        if i > 0 and top > max(known, max(abs(left), abs(right))):
            peak = extremum(s, j, kind, (i - 1) * width, i * width, left_slope, right_slope, BROAD)
            at_peak, _ = _measure(s, j, kind, peak)
            if (abs(at_peak) if signed else at_peak) > known:
                known, place = abs(at_peak), peak
        left, left_slope = right, right_slope
    return known, place


@compiled
def may_pass(s, face, sign, width, level):
    """Whether sign·approach can pass -level at all, from its values and slopes at the points of the
    grid.
    """
    apart()
    for i in range(POINTS):
        left, left_slope = sign * s.grid[face, 0, i], sign * s.grid[face, 1, i] * width
        right, right_slope = sign * s.grid[face, 0, i + 1], sign * s.grid[face, 1, i + 1] * width
        if highest_between(left, left_slope, right, right_slope) >= -level:
            return True
    return False

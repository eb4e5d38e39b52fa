"""Places sought in one step of a row: roots, tops and passages of thresholds, on the series of the step.

A piece is the part of a step's series that belongs to one lane, (2, TERMS), powers of theta; all quantities are the
scaled ones.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.integrator import tracked
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import face_force, stored_energy
from uqsphere.mechanics.integrator.tracked import CHI, INNER, LANES, ORDER
from uqsphere.mechanics.integrator.vectors import apart

#: how closely a top is found as a share of the step: where its height matters, which hardly depends on it; where the
#: motion goes on from it
BROAD, SHARP = 1e-6, 1e-13


@compiled(**INNER)
def value(piece, face, theta):
    """Approach of a face inside a step."""
    total = piece[face, ORDER]
    for k in range(ORDER - 1, -1, -1):
        total = total * theta + piece[face, k]
    return total


@compiled(**INNER)
def value_of(series, m, theta):
    """The same where the columns are the lanes or faces."""
    total = 0.0
    for k in range(ORDER, -1, -1):
        total = total * theta + series[k, m]
    return total


@compiled(**INNER)
def both(piece, face, theta):
    """Approach of a face inside a step and its derivative by theta."""
    total, rate = piece[face, ORDER], 0.0
    for k in range(ORDER - 1, -1, -1):
        rate = rate * theta + total
        total = total * theta + piece[face, k]
    return total, rate


@compiled(**INNER)
def combine_own(kind, x1, x2, d1, d2, law, lane):
    """A function of both faces that have laws of their own, or the sphere's stored energy; and its derivative."""
    apart()
    if kind == tracked.DIFFERENCE or kind == tracked.MEAN:
        force1, slope1 = face_force(law, lane, x1)
        force2, slope2 = face_force(law, LANES + lane, x2)
        if kind == tracked.DIFFERENCE:
            return force1 - force2, slope1 * d1 - slope2 * d2
        return 0.5 * (force1 + force2), 0.5 * (slope1 * d1 + slope2 * d2)
    energy1, slope1 = stored_energy(law, lane, x1)
    energy2, slope2 = stored_energy(law, LANES + lane, x2)
    if kind == tracked.SHARE:
        chi1, chi2 = law[CHI, lane], law[CHI, LANES + lane]
        return chi1 * energy1 + chi2 * energy2, chi1 * slope1 * d1 + chi2 * slope2 * d2
    return energy1 + energy2, slope1 * d1 + slope2 * d2


@compiled(**INNER, forceinline=True)
def combine(kind, mode, x1, x2, d1, d2):
    """Value and derivative of a searched function from the approaches and their derivatives, both forces x^(3/2)."""
    if kind == tracked.FACE_A:
        return x1, d1
    if kind == tracked.FACE_B:
        return x2, d2
    if x1 <= 0.0:
        x1, d1 = 0.0, 0.0
    if x2 <= 0.0:
        x2, d2 = 0.0, 0.0
    if mode == 1:
        if kind == tracked.DIFFERENCE:
            return x1 - x2, d1 - d2
        if kind == tracked.MEAN:
            return 0.5 * (x1 + x2), 0.5 * (d1 + d2)
        return 0.5 * (x1 * x1 + x2 * x2), x1 * d1 + x2 * d2
    root1, root2 = math.sqrt(x1), math.sqrt(x2)
    if kind == tracked.DIFFERENCE:
        return x1 * root1 - x2 * root2, 1.5 * (root1 * d1 - root2 * d2)
    if kind == tracked.MEAN:
        return 0.5 * (x1 * root1 + x2 * root2), 0.75 * (root1 * d1 + root2 * d2)
    return 0.4 * (x1 * x1 * root1 + x2 * x2 * root2), x1 * root1 * d1 + x2 * root2 * d2


@compiled(**INNER)
def _combined(kind, mode, x1, x2, d1, d2, own, law, lane):
    """The same, whether faces have laws of their own or not."""
    if kind > tracked.FACE_B and (own or kind == tracked.SHARE):
        return combine_own(kind, x1, x2, d1, d2, law, lane)
    return combine(kind, mode, x1, x2, d1, d2)


@compiled(**INNER)
def _measure(kind, mode, piece, theta, own, law, lane):
    """Value and derivative of one of the searched functions inside a step."""
    if kind <= tracked.FACE_B:
        return both(piece, kind, theta)
    x1, d1 = both(piece, 0, theta)
    x2, d2 = both(piece, 1, theta)
    return _combined(kind, mode, x1, x2, d1, d2, own, law, lane)


@compiled(**INNER)
def highest_between(left, left_slope, right, right_slope):
    """What a function can reach between two ends: where the tangents meet, and a fifth for bends."""
    top = max(left, right)
    if left_slope > 0.0 and right_slope < 0.0:
        top += 1.2 * left_slope * right_slope / (right_slope - left_slope)
    return top


@compiled(**INNER)
def root(piece, face, level, a, b):
    """Where a face passes `level` between a and b, which bracket it; regula falsi with the Illinois rule."""
    apart()
    at_a, at_b = value(piece, face, a) - level, value(piece, face, b) - level
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
        at_c = value(piece, face, c) - level
        if abs(c - b) < 1e-15 or at_c == 0.0:
            return c
        if (at_c < 0.0) != (at_b < 0.0):
            a, at_a = b, at_b
        else:
            at_a *= 0.5
        b, at_b = c, at_c
    return b


@compiled(**INNER)
def _extremum(kind, mode, piece, a, b, slope_a, slope_b, close, own, law, lane):
    """theta between a and b, to `close`, at which the slope of a searched function changes sign, as at the ends."""
    apart()
    for _ in range(60):
        c = b - slope_b * (b - a) / (slope_b - slope_a)
        if not min(a, b) < c < max(a, b):
            c = 0.5 * (a + b)
        _, slope_c = _measure(kind, mode, piece, c, own, law, lane)
        if abs(c - b) < close or slope_c == 0.0:
            return c
        if (slope_c < 0.0) != (slope_b < 0.0):
            a, slope_a = b, slope_b
        else:
            slope_a *= 0.5
        b, slope_b = c, slope_c
    return b


@compiled(**INNER)
def bend(piece, face, a, b, slope_a, slope_b, close):
    """The same of the approach of a face, for which no law matters."""
    return _extremum(face, 0, piece, a, b, slope_a, slope_b, close, False, piece, 0)


@compiled(**INNER)
def curve(piece, face, turns, theta):
    """Approach of a face inside a step and its derivative, or if it `turns` that and the next one.

    The even and the odd powers, of value and derivative, are four sums side by side: half as long a wait as `both`.
    """
    square, even, odd, even_rate, odd_rate = theta * theta, 0.0, 0.0, 0.0, 0.0
    for n in range(ORDER // 2, 0, -1):
        two, low, high = 2.0 * n, piece[face, 2 * n], piece[face, 2 * n + 1] if 2 * n < ORDER else 0.0
        if turns:
            low, high = two * low, (two + 1.0) * high
            even, odd = even * square + high, odd * square + low
            even_rate, odd_rate = even_rate * square + (two - 1.0) * low, odd_rate * square + two * high
        else:
            even, odd = even * square + low, odd * square + high
            even_rate, odd_rate = even_rate * square + (two + 1.0) * high, odd_rate * square + two * low
    if turns:
        return even * square + piece[face, 1] + theta * odd, even_rate + theta * odd_rate
    even, odd = even * square + piece[face, 0], odd * square + piece[face, 1]
    return even + theta * odd, even_rate * square + piece[face, 1] + theta * odd_rate


@compiled(**INNER)
def settle(piece, face, turns, a, b, at_a, at_b, level):
    """theta between a and b at which a face passes `level`, or turns if `turns`; Newton, to the last bits.

    at_a, at_b: what is sought a zero of, at the ends, which bracket it.
    """
    apart()
    if at_a == 0.0:
        return a
    if at_b == 0.0 or (at_a < 0.0) == (at_b < 0.0):
        return b
    found = a + (b - a) * at_a / (at_a - at_b)
    for _ in range(60):
        off, slope = curve(piece, face, turns, found)
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


@compiled(**INNER)
def slowest(piece, face, a, b):
    """theta between a and b at which a face is slowest, and its rate there; its second derivative rises through 0."""
    apart()
    _, low = curve(piece, face, True, a)
    _, high = curve(piece, face, True, b)
    found, rate = a, math.inf
    for _ in range(8):
        found = a - low * (b - a) / (high - low) if low < 0.0 < high else 0.5 * (a + b)
        rate, bow = curve(piece, face, True, found)
        if rate < 0.0:
            break
        if bow < 0.0:
            a, low = found, bow
        else:
            b, high = found, bow
    return found, rate


@compiled(**INNER)
def passage(piece, face, level, sign, begin, end):
    """First theta on the way from `begin` to `end` at which sign·(approach - level) >= 0, or NaN."""
    apart()
    width = (end - begin) / tracked.POINTS
    a = begin
    at_a, slope_a = both(piece, face, a)
    at_a, slope_a = sign * (at_a - level), sign * slope_a
    if at_a >= 0.0:
        return begin
    for k in range(1, tracked.POINTS + 1):
        b = begin + k * width if k < tracked.POINTS else end
        at_b, slope_b = both(piece, face, b)
        at_b, slope_b = sign * (at_b - level), sign * slope_b
        if at_b >= 0.0:
            return root(piece, face, level, a, b)
        if (
            slope_a * width > 0.0 > slope_b * width
            and highest_between(at_a, slope_a * width, at_b, slope_b * width) >= 0.0
        ):
            # the search measures the slopes themselves, without the sign; at a face no mode matters
            peak = bend(piece, face, a, b, sign * slope_a, sign * slope_b, BROAD)
            if sign * (value(piece, face, peak) - level) >= 0.0:
                return root(piece, face, level, a, peak)
        a, at_a, slope_a = b, at_b, slope_b
    return math.nan


@compiled(**INNER)
def survey(piece, end, grid):
    """Values and slopes of both faces at equal distances over [0, end]: grid (face, 2, tracked.POINTS + 1)."""
    apart()
    a, b, c, d = end * 1 / tracked.POINTS, end * 2 / tracked.POINTS, end * 3 / tracked.POINTS, end
    for face in range(2):
        at_a = at_b = at_c = at_d = piece[face, ORDER]
        rate_a = rate_b = rate_c = rate_d = 0.0
        # the points side by side: none waits for another
        for k in range(ORDER - 1, -1, -1):
            term = piece[face, k]
            rate_a, rate_b, rate_c, rate_d = rate_a * a + at_a, rate_b * b + at_b, rate_c * c + at_c, rate_d * d + at_d
            at_a, at_b, at_c, at_d = at_a * a + term, at_b * b + term, at_c * c + term, at_d * d + term
        grid[face, 0, 0], grid[face, 1, 0] = piece[face, 0], piece[face, 1]
        grid[face, 0, 1], grid[face, 0, 2], grid[face, 0, 3], grid[face, 0, 4] = at_a, at_b, at_c, at_d
        grid[face, 1, 1], grid[face, 1, 2], grid[face, 1, 3], grid[face, 1, 4] = rate_a, rate_b, rate_c, rate_d


def _largest_of(face_alone):
    """The search for a largest value, of an approach or of a function of both faces.

    Gives the largest value in [0, end] and its theta, or `known` and -1 if that is larger.  Of the difference of the
    forces the size counts, of an approach no gap.
    """

    @compiled(**INNER)
    def largest(kind, mode, piece, end, grid, known, own, law, lane):
        apart()
        width, place, signed = end / tracked.POINTS, -1.0, kind == tracked.DIFFERENCE
        left, left_slope = 0.0, 0.0
        for i in range(tracked.POINTS + 1):
            if face_alone:
                right, right_slope = grid[kind, 0, i], grid[kind, 1, i]
            else:
                right, right_slope = _combined(
                    kind, mode, grid[0, 0, i], grid[1, 0, i], grid[0, 1, i], grid[1, 1, i], own, law, lane
                )
            if (abs(right) if signed else right) > known:
                known, place = abs(right), i * width
            sign = 1.0 if left + right >= 0.0 else -1.0
            top = highest_between(sign * left, sign * left_slope * width, sign * right, sign * right_slope * width)
            if i > 0 and top > max(known, max(abs(left), abs(right))):
                peak = _extremum(
                    kind, mode, piece, (i - 1) * width, i * width, left_slope, right_slope, BROAD, own, law, lane
                )
                at_peak, _ = _measure(kind, mode, piece, peak, own, law, lane)
                if (abs(at_peak) if signed else at_peak) > known:
                    known, place = abs(at_peak), peak
            left, left_slope = right, right_slope
        return known, place

    return largest


largest_approach, largest_of_both = _largest_of(True), _largest_of(False)


@compiled(**INNER)
def may_pass(grid, face, sign, width, level):
    """Whether sign·approach can pass -level at all, from its values and slopes at the points of a grid."""
    apart()
    for i in range(tracked.POINTS):
        left, left_slope = sign * grid[face, 0, i], sign * grid[face, 1, i] * width
        right, right_slope = sign * grid[face, 0, i + 1], sign * grid[face, 1, i + 1] * width
        if highest_between(left, left_slope, right, right_slope) >= -level:
            return True
    return False

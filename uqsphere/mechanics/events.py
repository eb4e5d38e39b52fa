"""What happens inside the steps of a row: loss of contact, touch, threshold crossings, the end of the record.

`uqsphere.mechanics.lookout` says in which steps anything can happen; only those are searched, on the series of
the step, so that an event is located far better than the steps are long.  A piece is the part of a step's series
that belongs to one lane, (2, TERMS), powers of theta; all quantities are the scaled ones.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.compiled import compiled
from uqsphere.mechanics.layout import (
    DEPTH,
    DIFFERENCE,
    ENDED,
    FACE_A,
    FACE_B,
    KINDS,
    LOSS_RATE,
    LOST,
    NEAREST,
    POINTS,
    SOMETHING,
    TOUCHED_A,
    TRACKS,
    X_FIRST,
)
from uqsphere.mechanics.series import INNER, ORDER
from uqsphere.mechanics.vectors import apart

__all__ = ["after_step", "begin", "combine", "passage", "reach"]


@compiled(**INNER)
def value(piece, face, theta):
    """Approach of a face inside a step."""
    total = piece[face, ORDER]
    for k in range(ORDER - 1, -1, -1):
        total = total * theta + piece[face, k]
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
def combine(kind, mode, x1, x2, d1, d2):
    """Value and derivative of a searched function from the approaches and their derivatives."""
    if kind == FACE_A:
        return x1, d1
    if kind == FACE_B:
        return x2, d2
    if x1 <= 0.0:
        x1, d1 = 0.0, 0.0
    if x2 <= 0.0:
        x2, d2 = 0.0, 0.0
    if mode == 1:
        if kind == DIFFERENCE:
            return x1 - x2, d1 - d2
        return 0.5 * (x1 * x1 + x2 * x2), x1 * d1 + x2 * d2
    root1, root2 = math.sqrt(x1), math.sqrt(x2)
    if kind == DIFFERENCE:
        return x1 * root1 - x2 * root2, 1.5 * (root1 * d1 - root2 * d2)
    return 0.4 * (x1 * x1 * root1 + x2 * x2 * root2), x1 * root1 * d1 + x2 * root2 * d2


@compiled(**INNER)
def _measure(kind, mode, piece, theta):
    """Value and derivative of one of the searched functions inside a step."""
    if kind <= FACE_B:
        return both(piece, kind, theta)
    x1, d1 = both(piece, 0, theta)
    x2, d2 = both(piece, 1, theta)
    return combine(kind, mode, x1, x2, d1, d2)


@compiled(**INNER)
def reach(left, left_slope, right, right_slope):
    """What a function can reach between two ends: where the tangents meet, and a fifth for bends."""
    top = max(left, right)
    if left_slope > 0.0 and right_slope < 0.0:
        top += 1.2 * left_slope * right_slope / (right_slope - left_slope)
    return top


@compiled(**INNER)
def _root(piece, face, level, a, b):
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
def _extremum(kind, mode, piece, a, b, slope_a, slope_b):
    """theta between a and b at which the slope of a searched function changes sign, as it does at the ends."""
    apart()
    for _ in range(40):
        c = b - slope_b * (b - a) / (slope_b - slope_a)
        if not min(a, b) < c < max(a, b):
            c = 0.5 * (a + b)
        _, slope_c = _measure(kind, mode, piece, c)
        if abs(c - b) < 1e-6 or slope_c == 0.0:
            return c
        if (slope_c < 0.0) != (slope_b < 0.0):
            a, slope_a = b, slope_b
        else:
            slope_a *= 0.5
        b, slope_b = c, slope_c
    return b


@compiled(**INNER)
def passage(piece, face, level, sign, begin, end):
    """First theta on the way from `begin` to `end` at which sign·(approach - level) >= 0, or NaN."""
    apart()
    width = (end - begin) / POINTS
    a = begin
    at_a, slope_a = both(piece, face, a)
    at_a, slope_a = sign * (at_a - level), sign * slope_a
    if at_a >= 0.0:
        return begin
    for k in range(1, POINTS + 1):
        b = begin + k * width if k < POINTS else end
        at_b, slope_b = both(piece, face, b)
        at_b, slope_b = sign * (at_b - level), sign * slope_b
        if at_b >= 0.0:
            return _root(piece, face, level, a, b)
        if slope_a * width > 0.0 > slope_b * width and reach(at_a, slope_a * width, at_b, slope_b * width) >= 0.0:
            # the search measures the slopes themselves, without the sign; at a face no mode matters
            peak = _extremum(face, face, piece, a, b, sign * slope_a, sign * slope_b)
            if sign * (value(piece, face, peak) - level) >= 0.0:
                return _root(piece, face, level, a, peak)
        a, at_a, slope_a = b, at_b, slope_b
    return math.nan


@compiled(**INNER)
def _survey(piece, end, grid):
    """Values and slopes of both faces at equal distances over [0, end]: grid (face, 2, POINTS + 1)."""
    apart()
    for face in range(2):
        for i in range(POINTS + 1):
            grid[face, 0, i], grid[face, 1, i] = both(piece, face, end * i / POINTS)


@compiled(**INNER)
def _largest(kind, mode, piece, end, grid, known):
    """Largest absolute value of a searched function in [0, end], or `known` if that is larger."""
    apart()
    width = end / POINTS
    left, left_slope = combine(kind, mode, grid[0, 0, 0], grid[1, 0, 0], grid[0, 1, 0], grid[1, 1, 0])
    known = max(known, abs(left))
    for i in range(1, POINTS + 1):
        right, right_slope = combine(kind, mode, grid[0, 0, i], grid[1, 0, i], grid[0, 1, i], grid[1, 1, i])
        known = max(known, abs(right))
        sign = 1.0 if left + right >= 0.0 else -1.0
        top = reach(sign * left, sign * left_slope * width, sign * right, sign * right_slope * width)
        if top > max(known, max(abs(left), abs(right))):
            peak = _extremum(kind, mode, piece, (i - 1) * width, i * width, left_slope, right_slope)
            at_peak, _ = _measure(kind, mode, piece, peak)
            known = max(known, abs(at_peak))
        left, left_slope = right, right_slope
    return known


@compiled(**INNER)
def _may_pass(grid, face, sign, width, level):
    """Whether sign·approach can pass -level at all, from its values and slopes at the points of a grid."""
    apart()
    for i in range(POINTS):
        left, left_slope = sign * grid[face, 0, i], sign * grid[face, 1, i] * width
        right, right_slope = sign * grid[face, 0, i + 1], sign * grid[face, 1, i + 1] * width
        if reach(left, left_slope, right, right_slope) >= -level:
            return True
    return False


@compiled(**INNER)
def begin(track, lane):
    """Reset the trackers of a lane."""
    apart()
    for k in range(TRACKS):
        track[k, lane] = 0.0
    track[LOST, lane] = math.nan
    track[ENDED, lane] = math.nan
    track[DEPTH, lane] = math.inf
    track[NEAREST, lane] = math.inf


@compiled(**INNER)
def _both_below(piece, level, theta):
    """First theta in [0, theta] at which both approaches lie below `level`, or NaN."""
    apart()
    at = 0.0
    for _ in range(8 * POINTS):
        found = at
        for face in range(2):
            found = passage(piece, face, level, -1.0, found, theta)
            if math.isnan(found):
                return found
        if found == at:
            return found
        at = found
    return math.nan


@compiled(**INNER)
def _lowest(piece, face, end, grid):
    """Smallest local minimum of a pressed face's approach in [0, end] and its theta, or infinity."""
    apart()
    width = end / POINTS
    least, place = math.inf, 0.0
    for i in range(POINTS):
        left, right = grid[face, 1, i], grid[face, 1, i + 1]
        if left < 0.0 < right:
            found = _extremum(face, face, piece, i * width, (i + 1) * width, left, right)
            at = value(piece, face, found)
            if 0.0 < at < least:
                least, place = at, found
    return least, place


@compiled(**INNER)
def _faces(track, lane, piece, grid, theta, before, h, near, hover, graze):
    """Loss of contact or touch of either face in a step: theta at which the step ends, 2 + face or 0, and loss.

    A pressed face whose approach lingers below `hover` is as near to leaving as one that turns there.
    graze > 0: an approach that falls below it counts as a loss; graze < 0: an excursion that stays shallower than
    -graze does not.  The third result says whether a loss was counted, -1 no, else the face.
    """
    apart()
    ends, why, lost = theta, 0, -1
    for face in range(2):
        pressed = piece[face, 0] > 0.0
        if pressed and track[TOUCHED_A + face, lane] == 0.0:
            continue
        if piece[face, 0] == 0.0 and piece[face, 1] >= 0.0:  # touching just now
            continue
        level = near if pressed else 0.0
        if not _may_pass(grid, face, -1.0 if pressed else 1.0, theta / POINTS, level):
            continue
        # a face that left at the start of this step is clear of zero a little later
        clear = 1e-3 * ends if piece[face, 0] == 0.0 and piece[face, 1] < 0.0 else 0.0
        found = passage(piece, face, 0.0, -1.0 if pressed else 1.0, clear, ends)
        if not math.isnan(found):
            ends, why = found, 2 + face
            continue
        if pressed and near > 0.0:
            least, place = _lowest(piece, face, theta, grid)
            if least < near and place < ends:
                track[NEAREST, lane] = min(track[NEAREST, lane], least)
                if least < graze:
                    ends, why, lost = place, 1, face
            elif max(piece[face, 0], grid[face, 0, POINTS]) < hover:
                track[NEAREST, lane] = min(track[NEAREST, lane], grid[face, 0, POINTS])
                found = passage(piece, face, graze, -1.0, 0.0, ends) if graze > 0.0 else math.nan
                if not math.isnan(found):
                    ends, why, lost = found, 1, face
    if why > 1 and piece[why - 2, 0] > 0.0:
        face = why - 2
        _, rate = both(piece, face, ends)
        # the face now moves freely: it turns after a depth of rate²/(2 acceleration)
        bend = 0.0
        for k in range(ORDER, 1, -1):
            bend = bend * ends + k * (k - 1.0) * piece[face, k]
        depth = 0.5 * rate * rate / bend if bend > 0.0 else math.inf
        if depth >= -graze:
            lost = face
            if math.isnan(track[LOST, lane]):
                track[DEPTH, lane] = depth
    if lost >= 0 and math.isnan(track[LOST, lane]):
        track[LOST, lane] = before + ends * h
        _, rate = both(piece, lost, ends)
        track[LOSS_RATE, lane] = abs(rate) / h
    return ends, why, lost


@compiled(**INNER)
def after_step(
    mode, flags, track, lane, piece, grid, theta, before, h, echo, low, tiny, near, hover, graze, stop_at_loss,
):  # fmt: skip
    """Bring the trackers that `flags` name up to date with a step; the theta at which it ends, and what ends it.

    What ends the step: 0 nothing, 1 the record, 2 a face that lost contact or touched again while the motion
    goes on (face + 2).  `echo` is the time of the first reflected wave, `tiny` the error allowed in an approach,
    `low` > 0 the share of the largest approach below which the record ends; for the others see `_faces`.
    grid (face, 2, POINTS + 1): values and slopes over [0, theta].
    """
    apart()
    ends, why = theta, 0
    if flags & SOMETHING:
        ends, why, lost = _faces(track, lane, piece, grid, theta, before, h, near, hover, graze)
        if lost >= 0 and stop_at_loss:
            why = 1
        elif why == 1:
            ends, why = theta, 0
    if ends < theta:
        _survey(piece, ends, grid)
    known = track[FACE_A, lane]
    if flags & (1 << FACE_A):
        for face in range(2):
            known = _largest(face, mode, piece, ends, grid, known)
        track[FACE_A, lane] = known
    for kind in range(DIFFERENCE, KINDS):
        if flags & (1 << kind):
            track[kind, lane] = _largest(kind, mode, piece, ends, grid, track[kind, lane])
    for face in range(2):
        if grid[face, 0, POINTS] > max(50.0 * tiny, 2.0 * hover):
            track[TOUCHED_A + face, lane] = 1.0
    if before < echo * (1.0 - 1e-12):
        track[X_FIRST, lane] = known
    if low > 0.0:
        found = _both_below(piece, low * known, ends)
        if not math.isnan(found):
            ends, why = found, 1
            if track[LOST, lane] > before + ends * h:  # a loss after the record's end is none
                track[LOST, lane], track[DEPTH, lane] = math.nan, math.inf
    if why == 1:
        track[ENDED, lane] = before + ends * h
    return ends, why

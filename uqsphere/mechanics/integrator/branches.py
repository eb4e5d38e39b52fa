"""Where in a step a face changes its branch: a spring at its largest approach so far, virgin
loading where it turns.

What is sought is where a function of a face rises through zero: of a spring its approach less the
largest so far, of a face on virgin loading its rate with the other sign.  Values and slopes at a
few points of the step say between which of them it does; Newton's iteration on the series, for all
lanes together, settles where.  What the points leave in doubt, a dip or a bulge between them, is
looked at face by face.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.integrator import searches
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import ARMED
from uqsphere.mechanics.integrator.tracked import LANES, ORDER, PAIR, POINTS, TERMS, End
from uqsphere.mechanics.integrator.vectors import (
    apart,
    curves_at,
    elementwise,
    larger,
    row,
    size_of,
    smaller,
    where,
)

#: change of a place, as a share of the trial step, after which the next one would be rounding
_SETTLED = 1e-8
#: Newton's iterations at most; what is not settled then is looked at face by face
_ITERATIONS = 6


def _first(
    at_l,
    at_r,
    rate_l,
    rate_r,
    bow_l,
    bow_r,
    width,
    spring,
    room,
    begin,
    kind,
    start,
    left,
    right,
    left_slope,
    right_slope,
):
    """What one part of a step has to say: 1 the function rises through zero in it, 2 it may; the
    first one counts.
    """
    elastic, taken = spring > 0.0, kind > 0.0
    a, b = where(elastic, at_l - room, -rate_l), where(elastic, at_r - room, -rate_r)
    a_slope = width * where(elastic, rate_l, -2.0 * bow_l)
    b_slope = width * where(elastic, rate_r, -2.0 * bow_r)
    near = where(elastic, ARMED * room, 0.0)
    edge = larger(a, b)
    top = where(
        (a_slope > 0.0) & (b_slope < 0.0),
        edge + 1.2 * a_slope * b_slope / (b_slope - a_slope),
        edge,
    )
    # from its largest approach a spring goes down, but for a dip of a turn that hardly was one
    doubt = ((a < -near) & (top >= 0.0)) | ((a >= -near) & (b > near) & elastic)
    # a point may be the place itself, to the last bit
    found = where((a < -near) & (b >= -near), 1.0, where(doubt, 2.0, 0.0 * a))
    return (
        where(taken, kind, found),
        where(taken, start, begin),
        where(taken, left, a),
        where(taken, right, b),
        where(taken, left_slope, a_slope),
        where(taken, right_slope, b_slope),
    )


def _guessed(start, left, right, left_slope, right_slope, width, kind):
    """Where a rising function passes zero, by the cubic of its inverse; how far that may be off, 0
    if none does.
    """
    rise = right - left
    y = -left / rise
    z = 1.0 - y
    cubic = y * y * (1.0 + 2.0 * z) + y * z * rise * (z / left_slope - y / right_slope)
    share = where((left_slope > 0.0) & (right_slope > 0.0), cubic, y)
    return (start + larger(smaller(share, 1.0), 0.0)) * width, where(
        (kind > 0.0) & (kind < 2.0), 1.0, 0.0 * kind
    )


def _closer(place, change, value, slope, bend, spring, room, start, width):
    """Newton's next place, kept within its part of the step, and how far it went or would have;
    none once settled.
    """
    elastic, settled = spring > 0.0, change < _SETTLED
    following = place - where(elastic, value - room, slope) / where(elastic, slope, 2.0 * bend)
    kept = larger(smaller(following, (start + 1.0) * width), start * width)
    return where(settled, place, kept), where(settled, change, size_of(following - place))


_begin = elementwise(PAIR, 2, lambda largest, dent: (largest - dent, 0.0 * dent))
_look = elementwise(PAIR, 6, _first)
_guess = elementwise(PAIR, 2, _guessed)
_refine = elementwise(PAIR, 2, _closer)


@compiled
def _dip(s, face, level, a, b, slope_b):
    """theta at which an approach that turns at `level` and dips below it is there again; it lies
    above it at b.
    """
    apart()
    # where it turns the slope is zero but for rounding
    a += 1e-3 * (b - a)
    _, slope_a = searches.both_of(s.piece, face, a)
    if slope_a < 0.0 < slope_b:
        a = searches.extremum(s, 0, face, a, b, slope_a, slope_b, searches.SHARP)
    return searches.root(s, face, level, a, b) if searches.value_of(s.piece, face, a) < level else a


@compiled
def _spring_end(s, face, m, theta):
    """theta at which a spring is at its largest approach so far again, or NaN."""
    apart()
    room, width, found = s.room[0, m], theta / POINTS, math.nan
    for i in range(POINTS):
        left, right, begin, end = s.at[i, m], s.at[i + 1, m], i * width, (i + 1) * width
        if left >= room * (1.0 - ARMED):
            if right > room * (1.0 + ARMED):
                found = _dip(s, face, room, begin, end, s.rate[i + 1, m])
        elif right >= room * (1.0 - ARMED):
            found = searches.settle(s, face, False, begin, end, left - room, right - room, room)
        elif (
            searches.highest_between(left, width * s.rate[i, m], right, width * s.rate[i + 1, m])
            >= room
        ):
            found = searches.passage(s, face, room, 1.0, begin, end)
        if not math.isnan(found):
            break
    return found


@compiled
def _virgin_end(s, face, m, theta):
    """theta at which a face on virgin loading turns, or NaN."""
    apart()
    width = theta / POINTS
    for i in range(POINTS):
        begin, end, left, right = i * width, (i + 1) * width, s.rate[i, m], s.rate[i + 1, m]
        bow_left, bow_right = 2.0 * width * s.bow[i, m], 2.0 * width * s.bow[i + 1, m]
        if (
            left > 0.0
            and right > 0.0
            and searches.highest_between(-left, -bow_left, -right, -bow_right) > 0.0
        ):
            # a fall that is over before the next point
            end, right = searches.slowest(s, face, begin, end)
        if left > 0.0 >= right:
            return searches.settle(s, face, True, begin, end, left, right, 0.0)
    return math.nan


@compiled
def _one_by_one(s, face, m, theta):
    """theta at which a face changes its branch, or NaN; looked at part by part."""
    apart()
    for k in range(TERMS):
        s.piece[k, face] = s.x[k, m]
    return _spring_end(s, face, m, theta) if s.spring[m] > 0.0 else _virgin_end(s, face, m, theta)


@compiled
def _unsettled(s, first):
    """Whether a place of the lanes of one face is not settled."""
    found = False
    for j in range(LANES):
        found |= s.row[j] >= 0 and not s.room[3, first + j] < _SETTLED
    return found


@compiled
def _settle(s):
    """Rows of s.room: 0 a spring's largest approach above its dent; 1 what `_first` finds, 7 where,
    3 how surely.
    """
    apart()
    top, kind, start, place = (
        row(s.room, 0, 0),
        row(s.room, 1, 0),
        row(s.room, 2, 0),
        row(s.room, 7, 0),
    )
    width, change, spring = s.width, row(s.room, 3, 0), s.spring
    left, right = row(s.room, 3, 0), row(s.room, 4, 0)
    left_slope, right_slope = row(s.room, 5, 0), row(s.room, 6, 0)
    _begin(top, kind, s.largest, s.dent)
    for i in range(POINTS):
        _look(
            kind,
            start,
            left,
            right,
            left_slope,
            right_slope,
            row(s.at, i, 0),
            row(s.at, i + 1, 0),
            row(s.rate, i, 0),
            row(s.rate, i + 1, 0),
            row(s.bow, i, 0),
            row(s.bow, i + 1, 0),
            width,
            spring,
            top,
            1.0 * i,
            kind,
            start,
            left,
            right,
            left_slope,
            right_slope,
        )
    met = False
    for j in range(LANES):
        met |= s.row[j] >= 0 and (s.room[1, j] > 0.0 or s.room[1, LANES + j] > 0.0)
    if not met:
        return
    value, slope, bend = row(s.room, 4, 0), row(s.room, 5, 0), row(s.room, 6, 0)
    _guess(place, change, start, left, right, left_slope, right_slope, width, kind)
    for _ in range(_ITERATIONS):
        going = False
        for c in range(0, PAIR, LANES):
            if _unsettled(s, c):
                going = True
                curves_at(s.x, ORDER, PAIR, c, row(s.room, 7, c), value, slope, bend)
        if not going:
            return
        _refine(place, change, place, change, value, slope, bend, spring, top, start, width)


@compiled
def branch_ends(s):
    """End every lane's step where a face first changes its branch; whether any step is cut.

    s.theta receives where, s.why and s.side what ends the step.
    """
    apart()
    _settle(s)
    cut = False
    for j in range(LANES):
        if s.row[j] < 0 or s.touching[j] != 0:
            continue
        first = s.theta[j]
        for face in range(2):
            m, found = face * LANES + j, math.nan
            if s.room[1, m] == 1.0 and s.room[3, m] < _SETTLED:
                found = s.room[7, m]
            elif s.room[1, m] > 0.0:
                found = _one_by_one(s, face, m, s.theta[j])
            if found < first or (found == first and s.why[j] == End.SERIES):
                first, cut, s.why[j], s.side[j] = found, True, End.BRANCH, face
        s.theta[j] = first
    return cut

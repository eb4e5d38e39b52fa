"""What all lanes can have met in a step: the largest approach, and a warning where a search has to follow.

Values and slopes at a few points of the step bound what the approaches reach between them.  The top of a bend is
refined by Newton's iteration on the series, for all lanes together.  An energy argument (`settled`) says when
nothing that is wanted can change any more.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.compiled import compiled
from uqsphere.mechanics.events import combine, reach
from uqsphere.mechanics.layout import (
    DIFFERENCE,
    ENERGY,
    FACE_A,
    KINDS,
    POINTS,
    SOMETHING,
    TOUCHED_A,
    TOUCHED_B,
    WANT_CONTACT,
    WANT_DIFFERENCE,
    WANT_ENERGY,
    WANT_WIDTH,
)
from uqsphere.mechanics.series import INNER, LANES, ORDER, PAIR
from uqsphere.mechanics.vectors import apart, curves_at, elementwise, larger, row, size_of, smaller, where

__all__ = ["look", "settled"]


def _bounds(left, right, left_slope, right_slope, width, begin, best, top, second, place, bent, floor):
    """One part of a step: what the approach can reach above and below, where, and by a bend or at an end."""
    left_slope, right_slope = width * left_slope, width * right_slope
    # where the slope, taken as a straight line, passes zero
    share = left_slope / (left_slope - right_slope)
    rises = (left_slope > 0.0) & (right_slope < 0.0)
    falls = (left_slope < 0.0) & (right_slope > 0.0)
    edge, below = larger(left, right), smaller(left, right)
    bound = where(rises, edge - 1.2 * share * right_slope, edge)
    better = bound > top
    return (
        larger(best, edge),
        where(better, bound, top),
        larger(second, where(better, top, bound)),
        where(better, (begin + where(rises, share, 0.0)) * width, place),
        where(better, where(rises, 1.0 + begin, 0.0), bent),
        smaller(floor, where(falls, below - 1.2 * share * right_slope, below)),
    )


def _closer(place, slope, bend, bent, width):
    """Newton's step towards the top of a bend, within the part of the step in which it lies."""
    low = (bent - 1.0) * width
    kept = larger(smaller(place - 0.5 * slope / bend, low + width), low)
    return where((bent > 0.0) & (bend < 0.0), kept, place)


def _crowned(known, best, bound, second, at, slope, bend, bent):
    """Largest approach so far, with the top of a face's bend; 1 if the search has to settle it."""
    sharp = (bend < 0.0) & (size_of(0.5 * slope / bend) <= 1e-4)
    top = where((bent > 0.0) & sharp, at - 0.25 * slope * slope / bend, best)
    found = larger(larger(known, best), top)
    blunt = where(bent > 0.0, where(sharp, 0.0 * best, 1.0), 0.0)
    return found, where(bound > found, where(second > found, 1.0, blunt), 0.0)


def _signs(top_a, top_b, floor_a, floor_b, a, b, low, near, touched_a, touched_b):
    """What the larger approach can reach; 1 where contact may be lost or found, or the record may end."""
    something = (
        ((a > 0.0) & (floor_a <= near))
        | ((b > 0.0) & (floor_b <= near))
        | ((a <= 0.0) & (top_a > 0.0))
        | ((b <= 0.0) & (top_b > 0.0))
        | (larger(floor_a, floor_b) < low)
        | (touched_a + touched_b < 2.0)
    )
    return larger(top_a, top_b), where(something, 1.0, 0.0 * a)


_begin = elementwise(PAIR, 6, lambda at: (at, at - math.inf, at - math.inf, 0.0 * at, 0.0 * at, at))
_part = elementwise(LANES, 1, lambda theta: theta * (1.0 / POINTS))
_bound = elementwise(PAIR, 6, _bounds)
_refine = elementwise(PAIR, 1, _closer)
_crown = elementwise(LANES, 2, _crowned)
_sign = elementwise(LANES, 2, _signs)


@compiled(**INNER)
def look(mode, wanted, x, at, rate, track, theta, low, near, live, flags, known, crest, room):
    """What may have happened in each lane's step, as flags, and the largest approach up to its end.

    at, rate (POINTS + 1, PAIR): values and derivatives (by theta) at equal distances over [0, theta].
    low, near (LANES,): the record may end below the first; a contact may be lost below the second.  live
    (LANES,): rows in the lanes, -1 where there is none.  known, crest (LANES,): largest approach so far, and what
    it may have been in this step.  room (11, PAIR): working space.
    """
    apart()
    best, top, second, place = row(room, 0, 0), row(room, 1, 0), row(room, 2, 0), row(room, 3, 0)
    bent, floor, width, value = row(room, 4, 0), row(room, 5, 0), row(room, 6, 0), row(room, 7, 0)
    slope, bend, alarm, doubt = row(room, 8, 0), row(room, 9, 0), row(room, 10, 0), row(room, 10, LANES)
    _begin(best, top, second, place, bent, floor, row(at, 0, 0))
    for c in range(0, PAIR, LANES):
        _part(row(room, 6, c), theta)
    for i in range(POINTS):
        _bound(best, top, second, place, bent, floor, row(at, i, 0), row(at, i + 1, 0), row(rate, i, 0),
               row(rate, i + 1, 0), width, 1.0 * i, best, top, second, place, bent, floor)  # fmt: skip
    _sign(crest, alarm, top, row(room, 1, LANES), floor, row(room, 5, LANES), row(at, 0, 0), row(at, 0, LANES), low,
          near, row(track, TOUCHED_A, 0), row(track, TOUCHED_B, 0))  # fmt: skip
    higher = False
    for j in range(LANES):
        flags[j] = SOMETHING | 1 << FACE_A if room[10, j] > 0.0 else 0
        known[j] = track[FACE_A, j]
        higher |= live[j] >= 0 and crest[j] > known[j]
    if higher:
        for k in range(3):
            for c in range(0, PAIR, LANES):
                curves_at(x, ORDER, PAIR, c, place, value, slope, bend)
            if k < 2:
                _refine(place, place, slope, bend, bent, width)
        for c in range(0, PAIR, LANES):
            _crown(known, doubt, known, row(room, 0, c), row(room, 1, c), row(room, 2, c), row(room, 7, c),
                   row(room, 8, c), row(room, 9, c), row(room, 4, c))  # fmt: skip
            for j in range(LANES):
                if room[10, LANES + j] > 0.0:
                    flags[j] |= 1 << FACE_A
    if wanted & (WANT_DIFFERENCE | WANT_ENERGY):
        _look_further(mode, wanted, at, rate, track, theta, flags)


@compiled(**INNER)
def _look_further(mode, wanted, at, rate, track, theta, flags):
    """Flags of the steps in which the difference of the forces or the stored energy may be the largest so far."""
    apart()
    for kind in range(DIFFERENCE, KINDS):
        if (kind == DIFFERENCE and wanted & WANT_DIFFERENCE) or (kind == ENERGY and wanted & WANT_ENERGY):
            for i in range(POINTS):
                for j in range(LANES):
                    k = LANES + j
                    width = theta[j] / POINTS
                    left, left_slope = combine(kind, mode, at[i, j], at[i, k], width * rate[i, j], width * rate[i, k])
                    right, right_slope = combine(
                        kind, mode, at[i + 1, j], at[i + 1, k], width * rate[i + 1, j], width * rate[i + 1, k]
                    )
                    above = reach(left, left_slope, right, right_slope)
                    below = reach(-left, -left_slope, -right, -right_slope)
                    if max(above, below) > track[kind, j]:
                        flags[j] |= 1 << kind


@compiled(**INNER)
def settled(mode, wanted, track, lane, a, b, w, mu, level, tolerance):
    """Whether nothing that is wanted can change any more while the incoming wave stays at `level`.

    With f = level and h = 0 for ever, V = phi(x_1) + phi(x_2) + mu (u - level)²/2 can only fall, where
    phi' = q(x) - level and phi = 0 at its smallest: V' = -(q(x_1) - level)² - (q(x_2) - level)².  No approach
    above the one at rest can be exceeded whose phi is not below V.
    """
    apart()
    if wanted & WANT_CONTACT or (level > 0.0 and wanted & (WANT_DIFFERENCE | WANT_ENERGY | WANT_WIDTH)):
        return False
    a, b = max(a, 0.0), max(b, 0.0)
    known = track[FACE_A, lane]
    if mode == 1:
        rest = level
        stored = 0.5 * ((a - rest) ** 2 + (b - rest) ** 2) + 0.5 * mu * (w - level) ** 2
        reach = rest + math.sqrt(2.0 * stored)
        force, width = reach - rest, 0.5 * known
        energy = 0.5 * (a * a + b * b) + 0.5 * mu * w * w
    else:
        energy = 0.4 * (a * a * math.sqrt(a) + b * b * math.sqrt(b)) + 0.5 * mu * w * w
        if level > 0.0:
            rest = level ** (2.0 / 3.0)
            stored = energy - level * (a + b) + 1.2 * level * rest + 0.5 * mu * (level * level - 2.0 * level * w)
            top = known * (1.0 + 0.1 * tolerance)
            return known >= rest and 0.4 * top**2.5 - level * top + 0.6 * level * rest >= stored
        reach = (2.5 * energy) ** 0.4
        force, width = reach * math.sqrt(reach), 0.5 ** (2.0 / 3.0) * known
    if reach > known * (1.0 + 0.1 * tolerance):
        return False
    if wanted & WANT_DIFFERENCE and force > track[DIFFERENCE, lane] * (1.0 + 0.1 * tolerance):
        return False
    if wanted & WANT_ENERGY and energy > track[ENERGY, lane] * (1.0 + 0.1 * tolerance):
        return False
    return not (wanted & WANT_WIDTH and reach > width)

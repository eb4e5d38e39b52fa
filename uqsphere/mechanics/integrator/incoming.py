"""What runs towards the sphere during a step: pieces of the pulse, waves that come back, times at
which a step ends.

The waves that leave the faces are kept as power series of the steps on which they left, in a ring
as long as a round trip needs.  Over a later step they are read at Chebyshev points and fitted.
Every jump of the pulse comes back after a round trip and ends a step then too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial, chebyshev

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.tracked import LANES, ORDER, PAIR, QUEUE, TERMS, WAVE
from uqsphere.mechanics.integrator.vectors import apart, elementwise, mix, row, values_at, where

#: points over a step at which a wave that comes back is read
WAVE_THETAS = 0.5 - 0.5 * np.cos(np.pi * (np.arange(WAVE) + 0.5) / WAVE)
#: weights (point, degree) that turn the values there into Chebyshev coefficients, and (degree,
#: power) that turn those into powers of theta
WAVE_DEGREES = np.ascontiguousarray(
    np.linalg.inv(chebyshev.chebvander(2.0 * WAVE_THETAS - 1.0, WAVE - 1)).T
)
WAVE_POWERS = np.zeros((WAVE, WAVE))
for _k in range(WAVE):
    WAVE_POWERS[_k, : _k + 1] = (
        Chebyshev.basis(_k, domain=[0.0, 1.0]).convert(kind=Polynomial, domain=[-1.0, 1.0]).coef
    )
#: Chebyshev terms that are kept in any case
WAVE_LEAST = 4


_places = elementwise(WAVE, 1, lambda thetas, shift, stretch: shift + stretch * thetas)
_behind = elementwise(WAVE, 1, lambda old, new, thetas, begin: where(thetas >= begin, new, old))


@compiled
def add_echo(s, j, bar, made):
    """Add the wave that comes back from the far end of a bar, theory (5), to what runs towards its
    face.

    Terms that together stay below a tenth of the error that a step may have are left out.
    """
    apart()
    values, places, found, fit = (
        row(s.work, 0, 0),
        row(s.work, 1, 0),
        row(s.work, 2, 0),
        row(s.work, 3, 0),
    )
    begin, h, factor = s.time[j] - s.trips[bar, j], s.h[j], 2.0 * s.reflect[bar, j]
    for step in range(s.first[bar, j], s.last[bar, j] + 1):
        kept = made[j, step & (s.ring - 1)]
        inverse = 1.0 / kept.unit
        # all points are read from every step; each step keeps those behind its start
        _places(places, WAVE_THETAS, (begin - kept.began) * inverse, h * inverse)
        values_at(row(kept.wave, bar, 0), ORDER, places, found)
        from_theta = (kept.began - begin) / h if step > s.first[bar, j] else -1.0
        _behind(values, values, found, WAVE_THETAS, from_theta)
    degrees = places
    mix(values, WAVE_DEGREES, degrees)
    s.misfit[j] += abs(factor) * (abs(s.work[1, WAVE - 1]) + abs(s.work[1, WAVE - 2]))
    # terms below the error that is allowed are the joints between steps: as powers of theta they
    # would be large
    dropped, negligible = 0.0, 0.1 * s.error[j] * s.size[0, j] / h
    for k in range(WAVE - 1, WAVE_LEAST - 1, -1):
        dropped += abs(factor * s.work[1, k])
        if dropped > negligible:
            break
        s.work[1, k] = 0.0
    mix(degrees, WAVE_POWERS, fit)
    for k in range(WAVE):
        s.push[k, bar * LANES + j] += factor * s.work[3, k]


def _cubic_terms(time, h, offset, c0, c1, c2, c3):
    z = time - offset
    first, second = c1 + z * (2.0 * c2 + z * (3.0 * c3)), c2 + z * (3.0 * c3)
    square = h * h
    return (
        2.0 * (c0 + z * (c1 + z * (c2 + z * c3))),
        2.0 * h * first,
        2.0 * square * second,
        2.0 * square * h * c3,
    )


_from_cubic = elementwise(LANES, 4, _cubic_terms)


@compiled
def incident(s):
    """2 f of the pulse as a series over every lane's step, theory (4); nothing yet at face B."""
    apart()
    for k in range(TERMS):
        for m in range(PAIR):
            s.push[k, m] = 0.0
    _from_cubic(
        row(s.push, 0, 0),
        row(s.push, 1, 0),
        row(s.push, 2, 0),
        row(s.push, 3, 0),
        s.time,
        s.h,
        s.offset,
        row(s.cubic, 0, 0),
        row(s.cubic, 1, 0),
        row(s.cubic, 2, 0),
        row(s.cubic, 3, 0),
    )
    for j in range(LANES):
        if s.frequency[j] > 0.0:
            angle, phase = s.frequency[j] * s.h[j], s.frequency[j] * s.time[j]
            s.push[0, j] = 2.0 * math.sin(phase)
            s.push[1, j] = 2.0 * angle * math.cos(phase)
            for k in range(2, TERMS):
                s.push[k, j] = -s.push[k - 2, j] * angle * angle / (k * (k - 1.0))


@compiled
def enter_piece(s, j, rows):
    """Put the piece of the pulse that begins at or holds the time of a lane into it."""
    apart()
    r, pieces, piece = s.row[j], rows.coefficients.shape[1], 0
    while piece < pieces and rows.breaks[r, piece + 1] <= s.time[j]:
        piece += 1
    s.frequency[j] = 0.0
    for k in range(4):
        s.cubic[k, j] = rows.coefficients[r, piece, k] if piece < pieces else 0.0
    if piece < pieces:
        s.offset[j], s.frequency[j] = rows.breaks[r, piece], rows.frequencies[r]


@compiled
def next_break(s, j, rows):
    """The next time at which a step of a lane has to end: pulse, reflections, end of the record."""
    apart()
    best, r = s.end[j], s.row[j]
    near = s.time[j] + 1e-13 * (1.0 + s.time[j])
    for k in range(rows.breaks.shape[1]):
        if near < rows.breaks[r, k] < best:
            best = rows.breaks[r, k]
    for bar in range(2):
        while s.head[bar, j] < s.tail[bar, j] and s.queue[bar, j, s.head[bar, j] % QUEUE] <= near:
            s.head[bar, j] += 1
        if s.head[bar, j] < s.tail[bar, j]:
            best = min(best, s.queue[bar, j, s.head[bar, j] % QUEUE])
    return best


@compiled
def reflect_break(s, j):
    """Note that whatever happens now comes back after a round trip of each bar; False if there is
    no room.
    """
    apart()
    for bar in range(2):
        back = s.time[j] + s.trips[bar, j]
        if back < s.end[j]:
            if s.tail[bar, j] - s.head[bar, j] >= QUEUE:
                return False
            s.queue[bar, j, s.tail[bar, j] % QUEUE] = back
            s.tail[bar, j] += 1
    return True


@compiled
def heard(s, j, trip):
    """Whether what left at first touch is back after a round trip."""
    return s.time[j] >= trip * (1.0 - 1e-12)


@compiled
def _ended(s, j, made, n):
    kept = made[j, n & (s.ring - 1)]
    return kept.began + kept.holds


@compiled
def echo_steps(s, j, made):
    """Find the steps on which the waves left that come back during the present step; its length, if
    need be cut.
    """
    apart()
    time, h, newest = s.time[j], s.h[j], s.count[j] - 1
    near = 1e-13 * (1.0 + time)
    for bar in range(2):
        begin = time - s.trips[bar, j]
        if not heard(s, j, s.trips[bar, j]):
            s.first[bar, j] = -1
            continue
        k = max(s.first[bar, j], 0)
        while k < newest and _ended(s, j, made, k) <= begin + near:
            k += 1
        s.first[bar, j] = k
        # no more than two steps at once: a wave that took many steps to make is not smooth
        k = k if s.single[j] else min(k + 1, newest)
        h = min(h, max(_ended(s, j, made, k) - begin, 0.1 * h))
    for bar in range(2):
        k = s.first[bar, j]
        if k >= 0:
            while k < newest and _ended(s, j, made, k) < time - s.trips[bar, j] + h - near:
                k += 1
            s.last[bar, j] = k
    return h


@compiled
def echoes(s, j, made):
    """The waves that come back to a lane's faces over its trial step, which is cut to what they
    hold.
    """
    apart()
    trial = echo_steps(s, j, made)
    if trial < s.h[j]:
        shrink = trial / s.h[j]
        power = shrink
        for k in range(1, TERMS):
            s.push[k, j] *= power
            power *= shrink
        s.h[j] = trial
    for bar in range(2):
        if s.first[bar, j] >= 0:
            add_echo(s, j, bar, made)

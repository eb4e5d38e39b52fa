"""What runs towards the sphere during a step: pieces of the pulse, waves that come back, times at which a step ends.

The waves that leave the faces are kept as power series of the steps on which they left, in a ring as long as a
round trip needs.  Over a later step they are read at Chebyshev points and fitted.  Every jump of the pulse comes
back after a round trip and ends a step then too.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial, chebyshev

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.tracked import BEGAN, HOLDS, INNER, LANES, ORDER, PAIR, TERMS, UNIT_OF
from uqsphere.mechanics.integrator.vectors import apart, elementwise, mix, row, values_at, where

#: points over a step at which a wave that comes back is read
WAVE = 12
WAVE_THETAS = 0.5 - 0.5 * np.cos(np.pi * (np.arange(WAVE) + 0.5) / WAVE)
#: weights (point, degree) that turn the values there into Chebyshev coefficients, and (degree, power) that turn
#: those into powers of theta
WAVE_DEGREES = np.ascontiguousarray(np.linalg.inv(chebyshev.chebvander(2.0 * WAVE_THETAS - 1.0, WAVE - 1)).T)
WAVE_POWERS = np.zeros((WAVE, WAVE))
for _k in range(WAVE):
    WAVE_POWERS[_k, : _k + 1] = Chebyshev.basis(_k, domain=[0.0, 1.0]).convert(kind=Polynomial, domain=[-1.0, 1.0]).coef
#: Chebyshev terms that are kept in any case
WAVE_LEAST = 4
#: room for jumps that are under way in each bar
QUEUE = 2048


_places = elementwise(WAVE, 1, lambda thetas, shift, stretch: shift + stretch * thetas)
_behind = elementwise(WAVE, 1, lambda old, new, thetas, begin: where(thetas >= begin, new, old))


@compiled(**INNER)
def add_echo(made, wave, ring, bar, lane, low, high, begin, h, factor, negligible, push, work):
    """Add `factor` times a wave kept on the steps `low` to `high` to a face of `push`; begin is its time.

    made (LANES, room, KEPT) and wave (LANES·room·2, TERMS) hold the last `ring` steps of all lanes.  Returns the size
    of the fit's last two terms; terms that together stay below `negligible` are left out.
    """
    apart()
    values, places, found, fit = row(work, 0, 0), row(work, 1, 0), row(work, 2, 0), row(work, 3, 0)
    room = made.shape[1]
    for step in range(low, high + 1):
        piece = step & (ring - 1)
        began, inverse = made[lane, piece, BEGAN], 1.0 / made[lane, piece, UNIT_OF]
        # all points are read from every step; each step keeps those behind its start
        _places(places, WAVE_THETAS, (begin - began) * inverse, h * inverse)
        values_at(row(wave, 2 * (lane * room + piece) + bar, 0), ORDER, places, found)
        from_theta = (began - begin) / h if step > low else -1.0
        _behind(values, values, found, WAVE_THETAS, from_theta)
    degrees = places
    mix(values, WAVE_DEGREES, degrees)
    misfit = abs(factor) * (abs(work[1, WAVE - 1]) + abs(work[1, WAVE - 2]))
    # terms below the error that is allowed are the joints between steps: as powers of theta they would be large
    dropped = 0.0
    for k in range(WAVE - 1, WAVE_LEAST - 1, -1):
        dropped += abs(factor * work[1, k])
        if dropped > negligible:
            break
        work[1, k] = 0.0
    mix(degrees, WAVE_POWERS, fit)
    for k in range(WAVE):
        push[k, bar * LANES + lane] += factor * work[3, k]
    return misfit


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


@compiled(**INNER)
def incident(time, h, cubic, frequency, offset, push):
    """2 f of the pulse as a series over every lane's step; nothing yet at face B."""
    apart()
    for k in range(TERMS):
        for m in range(PAIR):
            push[k, m] = 0.0
    _from_cubic(row(push, 0, 0), row(push, 1, 0), row(push, 2, 0), row(push, 3, 0), time, h, offset, row(cubic, 0, 0),
                row(cubic, 1, 0), row(cubic, 2, 0), row(cubic, 3, 0))  # fmt: skip
    for j in range(LANES):
        if frequency[j] > 0.0:
            angle = frequency[j] * h[j]
            push[0, j] = 2.0 * math.sin(frequency[j] * time[j])
            push[1, j] = 2.0 * angle * math.cos(frequency[j] * time[j])
            for k in range(2, TERMS):
                push[k, j] = -push[k - 2, j] * angle * angle / (k * (k - 1.0))


@compiled(**INNER)
def enter_piece(breaks, coefficients, frequencies, row, lane, time, cubic, frequency, offset):
    """Put the piece of the pulse that begins at or holds `time` into the lane."""
    apart()
    pieces = coefficients.shape[1]
    piece = 0
    while piece < pieces and breaks[row, piece + 1] <= time:
        piece += 1
    frequency[lane] = 0.0
    for k in range(4):
        cubic[k, lane] = 0.0
    if piece < pieces:
        offset[lane] = breaks[row, piece]
        frequency[lane] = frequencies[row]
        for k in range(4):
            cubic[k, lane] = coefficients[row, piece, k]


@compiled(**INNER)
def next_break(breaks, row, time, queue, head, tail, lane, horizon):
    """The next time after `time` at which a step has to end: pulse, reflections, end of the record."""
    apart()
    best = horizon
    near = time + 1e-13 * (1.0 + time)
    for k in range(breaks.shape[1]):
        if breaks[row, k] > near and breaks[row, k] < best:
            best = breaks[row, k]
    for bar in range(2):
        while head[bar, lane] < tail[bar, lane] and queue[bar, lane, head[bar, lane] % QUEUE] <= near:
            head[bar, lane] += 1
        if head[bar, lane] < tail[bar, lane]:
            best = min(best, queue[bar, lane, head[bar, lane] % QUEUE])
    return best


@compiled(**INNER)
def reflect_break(time, trips, queue, head, tail, lane, horizon):
    """Note that whatever happens at `time` comes back after a round trip of each bar; False if there is no room."""
    apart()
    for bar in range(2):
        if time + trips[bar, lane] < horizon:
            if tail[bar, lane] - head[bar, lane] >= QUEUE:
                return False
            queue[bar, lane, tail[bar, lane] % QUEUE] = time + trips[bar, lane]
            tail[bar, lane] += 1
    return True


@compiled(**INNER)
def _ended(made, lane, n):
    return made[lane, n, BEGAN] + made[lane, n, HOLDS]


@compiled(**INNER)
def echo_steps(lane, time, h, trips, count, made, ring, first, last, alone):
    """Find the steps on which the waves left that come back during the present step; its length, if need be cut.

    alone: whether no more than one of a bar may.
    """
    apart()
    near = 1e-13 * (1.0 + time)
    for bar in range(2):
        begin = time - trips[bar, lane]
        if begin < -near:
            first[bar, lane] = -1
            continue
        k = max(first[bar, lane], 0)
        while k < count - 1 and _ended(made, lane, k & (ring - 1)) <= begin + near:
            k += 1
        first[bar, lane] = k
        # no more than two steps at once: a wave that took many steps to make is not smooth
        k = k if alone else min(k + 1, count - 1)
        h = min(h, max(_ended(made, lane, k & (ring - 1)) - begin, 0.1 * h))
    for bar in range(2):
        k = first[bar, lane]
        if k >= 0:
            while k < count - 1 and _ended(made, lane, k & (ring - 1)) < time - trips[bar, lane] + h - near:
                k += 1
            last[bar, lane] = k
    return h

"""What runs towards the sphere during a step: pieces of the pulse, waves that come back, times at
which a step ends.

The waves that leave the faces are stored as power series of the steps on which they left, in a ring
as long as a round trip needs.  Over a later step they are read at Chebyshev points and fitted.
Every jump of the pulse comes back after a round trip and ends a step then too.
"""

from __future__ import annotations

import math

from .compiled import compiled
from .faces import lower
from .lanes import WAVE_THETAS
from .tracked import LANES, ORDER, QUEUE, TERMS, WAVE


@compiled
def incident(s, j):
    """2 f of the pulse as a series over the step of a lane, theory (4)."""
    lane = s.lane[j]
    h = s.h[j]
    z = lane.time - lane.offset
    for k in range(4):
        s.push[k, j] = 2.0 * lane.cubic[k]
    for low in range(3):  # in powers of the time after z, by Horner's scheme
        for k in range(2, low - 1, -1):
            s.push[k, j] += z * s.push[k + 1, j]
    power = 1.0
    for k in range(4):
        s.push[k, j] *= power
        power *= h
    if lane.frequency > 0.0:
        angle = lane.frequency * h
        phase = lane.frequency * lane.time
        s.push[0, j] = 2.0 * math.sin(phase)
        s.push[1, j] = 2.0 * angle * math.cos(phase)
        for k in range(2, TERMS):
            s.push[k, j] = -s.push[k - 2, j] * angle * angle / (k * (k - 1.0))


@compiled
def now(lane):
    """The time of a lane, and what differs from it by rounding alone."""
    return lane.time + 1e-13 * (1.0 + lane.time)


@compiled
def enter_piece(s, j, rows):
    """Put the piece of the pulse that begins at or holds the time of a lane into it."""
    lane = s.lane[j]
    r = lane.number
    pieces = rows.coefficients.shape[1]
    piece = 0
    while piece < pieces and rows.breaks[r, piece + 1] <= now(lane):
        piece += 1
    lane.frequency = 0.0
    for k in range(4):
        lane.cubic[k] = rows.coefficients[r, piece, k] if piece < pieces else 0.0
    if piece < pieces:
        lane.offset = rows.breaks[r, piece]
        lane.frequency = rows.frequencies[r]


@compiled
def next_break(s, j, rows):
    """The next time at which a step of a lane has to end: pulse, reflections, end of the record."""
    lane = s.lane[j]
    best = lane.record_end
    r = lane.number
    near = now(lane)
    for k in range(rows.breaks.shape[1]):
        if near < rows.breaks[r, k] < best:
            best = rows.breaks[r, k]
    for bar in range(2):
        while lane.head[bar] < lane.tail[bar] and s.queue[bar, j, lane.head[bar] % QUEUE] <= near:
            lane.head[bar] += 1
        if lane.head[bar] < lane.tail[bar]:
            best = min(best, s.queue[bar, j, lane.head[bar] % QUEUE])
    return best


@compiled
def reflect_break(s, j):
    """Note that whatever happens now comes back after a round trip of each bar; False if there is
    no room.
    """
    lane = s.lane[j]
    for bar in range(2):
        back = lane.time + lane.trips[bar]
        if back < lane.record_end:
            if lane.tail[bar] - lane.head[bar] >= QUEUE:
                return False
            s.queue[bar, j, lane.tail[bar] % QUEUE] = back
            lane.tail[bar] += 1
    return True


@compiled
def heard(lane, trip):
    """Whether what left at first touch is back after a round trip."""
    return lane.time >= trip * (1.0 - 1e-12)


@compiled
def step_end(s, j, past, n):
    """Time at which an earlier step ended."""
    earlier = past[j, n & (s.ring - 1)]
    return earlier.began + earlier.holds


@compiled
def echo_steps(s, j, past):
    """Find the steps on which the waves left that come back during the trial step, which is cut to
    what they hold.
    """
    lane = s.lane[j]
    time = lane.time
    h = s.h[j]
    newest = lane.count - 1
    near = 1e-13 * (1.0 + time)
    for bar in range(2):
        begin = time - lane.trips[bar]
        if not heard(lane, lane.trips[bar]):
            lane.first[bar] = -1
            continue
        k = max(lane.first[bar], 0)
        while k < newest and step_end(s, j, past, k) <= begin + near:
            k += 1
        lane.first[bar] = k
        # no more than two steps at once: a wave that took many steps to make is not smooth
        if not lane.one_step_echo:
            k = min(k + 1, newest)
        h = min(h, max(step_end(s, j, past, k) - begin, 0.1 * h))
    for bar in range(2):
        k = lane.first[bar]
        if k >= 0:
            while k < newest and step_end(s, j, past, k) < time - lane.trips[bar] + h - near:
                k += 1
            lane.last[bar] = k
    s.h[j] = s.h[LANES + j] = h


@compiled
def read_echo(s, j, bar, past):
    """Values of the wave that comes back from the far end of a bar, theory (5), at the Chebyshev
    points of the step.
    """
    lane = s.lane[j]
    m = bar * LANES + j
    begin = lane.time - lane.trips[bar]
    i = 0
    for step in range(lane.first[bar], lane.last[bar] + 1):
        earlier = past[j, step & (s.ring - 1)]
        shift = (begin - earlier.began) / earlier.unit
        stretch = s.h[j] / earlier.unit
        # every point is read from the step that holds it
        until = 2.0
        if step < lane.last[bar]:
            until = (past[j, (step + 1) & (s.ring - 1)].began - begin) / s.h[j]
        while i < WAVE and WAVE_THETAS[i] < until:
            theta = shift + stretch * WAVE_THETAS[i]
            value = 0.0
            for k in range(ORDER, -1, -1):
                value = value * theta + earlier.wave[k, bar]
            s.echo[i, m] = value
            i += 1
    s.returns[m] = 2.0 * lane.reflect[bar]
    s.negligible[m] = 0.1 * s.error[j] * lower(s.size, j) / s.h[j]

"""The compiled batch integrator of the equations of motion, in the scaled variables of theory (9).

Rows advance in lanes: every lane has its own time and step, all lanes expand their motion into a power series
together, and a lane whose row has ended takes the next one.  A row's answer depends on nothing but the row, so
that any slice, order or number of threads gives the same bits.

A step never crosses a jump of the pulse or of one of its reflections, is never longer than a round trip, and
ends where a face leaves or touches.  The waves that leave the faces, which come back as reflections, are kept
as series until the row is done; over a later step they are read at Chebyshev points and fitted.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial, chebyshev

from uqsphere.mechanics import events
from uqsphere.mechanics.compiled import compiled
from uqsphere.mechanics.series import INNER, LANES, ORDER, PAIR, TERMS, evaluate, expand, longest, touch_off
from uqsphere.mechanics.vectors import apart, mix, values_at

__all__ = ["march"]

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
#: longest trial step over the last step: without and with waves that come back
GROWTH, GROWTH_ECHO = 4.0, 1.3
#: room for jumps that are under way in each bar
QUEUE = 2048


@compiled(**INNER)
def _echo(start, scale, wave, low, high, begin, h, factor, negligible, push, m, work):
    """Add `factor` times a wave kept on the steps `low` to `high` to a column of `push`; begin is its time.

    start, scale and wave (steps, TERMS) are those of one lane.  Returns the size of the fit's last two terms; terms
    that together stay below `negligible` are left out.
    """
    apart()
    values, places, found, fit = work[0], work[1], work[2], work[3]
    for piece in range(low, high + 1):
        inverse = 1.0 / scale[piece]
        shift = (begin - start[piece]) * inverse
        stretch = h * inverse
        # all points are read from every step; each step keeps those behind its start
        for i in range(WAVE):
            places[i] = shift + stretch * WAVE_THETAS[i]
        values_at(wave[piece], ORDER, places, found)
        from_theta = (start[piece] - begin) / h if piece > low else -1.0
        for i in range(WAVE):
            values[i] = found[i] if WAVE_THETAS[i] >= from_theta else values[i]
    degrees = places
    mix(values, WAVE_DEGREES, degrees)
    misfit = abs(factor) * (abs(degrees[WAVE - 1]) + abs(degrees[WAVE - 2]))
    # terms below the error that is allowed are the joints between steps: as powers of theta they would be large
    dropped = 0.0
    for k in range(WAVE - 1, WAVE_LEAST - 1, -1):
        dropped += abs(factor * degrees[k])
        if dropped > negligible:
            break
        degrees[k] = 0.0
    mix(degrees, WAVE_POWERS, fit)
    for k in range(WAVE):
        push[k, m] += factor * fit[k]
    return misfit


@compiled(**INNER)
def _incident(time, h, cubic, frequency, offset, push):
    """2 f of the pulse as a series over every lane's step; nothing yet at face B."""
    apart()
    for k in range(TERMS):
        for m in range(PAIR):
            push[k, m] = 0.0
    for j in range(LANES):
        z = time[j] - offset[j]
        c0, c1, c2, c3 = 2.0 * cubic[0, j], 2.0 * cubic[1, j], 2.0 * cubic[2, j], 2.0 * cubic[3, j]
        push[0, j] = c0 + z * (c1 + z * (c2 + z * c3))
        push[1, j] = h[j] * (c1 + z * (2.0 * c2 + z * 3.0 * c3))
        push[2, j] = h[j] * h[j] * (c2 + z * 3.0 * c3)
        push[3, j] = h[j] * h[j] * h[j] * c3
    for j in range(LANES):
        if frequency[j] > 0.0:
            angle = frequency[j] * h[j]
            push[0, j] = 2.0 * math.sin(frequency[j] * time[j])
            push[1, j] = 2.0 * angle * math.cos(frequency[j] * time[j])
            for k in range(2, TERMS):
                push[k, j] = -push[k - 2, j] * angle * angle / (k * (k - 1.0))


@compiled(**INNER)
def _enter_piece(breaks, coefficients, frequencies, row, lane, time, cubic, frequency, offset):
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
def _next_break(breaks, row, time, queue, head, tail, lane, horizon):
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
def _reflect_break(time, trips, queue, head, tail, lane, horizon):
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
def _echo_steps(lane, time, h, trips, count, start, length, first, last):
    """Find the steps on which the waves left that come back during the present step; its length, if need be cut."""
    apart()
    near = 1e-13 * (1.0 + time)
    for bar in range(2):
        begin = time - trips[bar, lane]
        if begin < -near:
            first[bar, lane] = -1
            continue
        k = max(first[bar, lane], 0)
        while k < count - 1 and start[k] + length[k] <= begin + near:
            k += 1
        first[bar, lane] = k
        # no more than a few steps at once: a wave that took many steps to make is not smooth
        k = min(k + 2, count - 1)
        h = min(h, max(start[k] + length[k] - begin, 0.1 * h))
    for bar in range(2):
        k = first[bar, lane]
        if k >= 0:
            while k < count - 1 and start[k] + length[k] < time - trips[bar, lane] + h - near:
                k += 1
            last[bar, lane] = k
    return h


@compiled()
def march(
    mode, wanted, mass, ends, round_trips, breaks, coefficients, frequencies, horizon, pulse_end, level, local,
    stop_at_loss, capacity, out, status, order, steps, kept_start, kept_length, kept,
):  # fmt: skip
    """Integrate rows `order` of a batch; answers go to `out` (rows, events.ANSWERS) and `status` (rows).

    mode: 0 full, 1 linear contact, 2 massless.  wanted: sum of events.WANT_*.  mass (n,): mu.  ends,
    round_trips (n, 2): R and T of the two bars (T infinite: no reflection).  breaks, coefficients, frequencies:
    the pulse in scaled time.  horizon (n,): end of the record, inf for the rule of infinite bars, which needs
    pulse_end (n,).  level (n,): scale of x that is expected at least.  local: error allowed in one step.
    kept* receive the series (x1, x2, u) of the last row if they have room (first dimension > 0).
    """
    lanes = LANES
    keeping = kept_start.shape[0] > 0
    x = np.zeros((TERMS, PAIR))
    u = np.zeros((TERMS, LANES))
    root = np.zeros((TERMS, PAIR))
    force = np.zeros((TERMS, PAIR))
    push = np.zeros((TERMS, PAIR))
    half = np.zeros(PAIR)
    at = np.zeros((events.POINTS + 1, PAIR))
    rate = np.zeros((events.POINTS + 1, PAIR))
    top, least = np.zeros(PAIR), np.zeros(PAIR)
    at_u, rate_u = np.zeros(LANES), np.zeros(LANES)
    work = np.zeros((4, WAVE))
    piece, grid = np.zeros((2, TERMS)), np.zeros((2, 2, events.POINTS + 1))
    time, h, theta, proposed = np.zeros(lanes), np.ones(lanes), np.zeros(lanes), np.zeros(lanes)
    row = np.full(lanes, -1)
    inverse_mu = np.ones(lanes)
    reflect = np.zeros((2, lanes))
    trips = np.full((2, lanes), np.inf)
    end = np.full(lanes, np.inf)
    stop = np.zeros(lanes)  # the next time at which a step has to end
    cubic, frequency, offset = np.zeros((4, lanes)), np.zeros(lanes), np.zeros(lanes)
    count, attempts = np.zeros(lanes, dtype=np.int64), np.zeros(lanes, dtype=np.int64)
    touching, flags = np.zeros(lanes, dtype=np.int64), np.zeros(lanes, dtype=np.int64)
    misfit, low, crest = np.zeros(lanes), np.zeros(lanes), np.zeros(lanes)
    queue = np.zeros((2, lanes, QUEUE))
    head, tail = np.zeros((2, lanes), dtype=np.int64), np.zeros((2, lanes), dtype=np.int64)
    # steps that hold the echo of the present step
    first, last = np.zeros((2, lanes), dtype=np.int64), np.zeros((2, lanes), dtype=np.int64)
    # uninitialised: only the pages of steps that are taken ever cost memory.  A step's series is in powers of
    # (t - start)/scale and holds over `length`
    start, length, scale = np.empty((lanes, capacity)), np.empty((lanes, capacity)), np.empty((lanes, capacity))
    crests = np.empty((lanes, capacity))
    path = np.empty((lanes, capacity, 2, TERMS))
    wave = np.empty((2, lanes, capacity, TERMS))
    track = np.zeros((events.TRACKS, lanes))
    size = np.ones((2, lanes))
    store = keeping or wanted & events.WANT_THRESHOLDS != 0
    share = events.TAIL_SHARE if mode == 1 else events.TAIL_SHARE ** (2.0 / 3.0)
    taken, live = 0, 0
    while True:
        # ---- fill idle lanes
        for j in range(lanes):
            if row[j] >= 0 or taken >= len(order):
                continue
            r = order[taken]
            taken += 1
            live += 1
            row[j] = r
            inverse_mu[j] = 1.0 / mass[r]
            end[j] = horizon[r]
            time[j] = 0.0
            count[j], attempts[j], touching[j] = 0, 0, 1
            x[0, j], x[0, LANES + j], u[0, j] = 0.0, 0.0, 0.0
            for bar in range(2):
                reflect[bar, j], trips[bar, j] = ends[r, bar], round_trips[r, bar]
                head[bar, j], tail[bar, j], first[bar, j] = 0, 0, 0
            size[0, j], size[1, j] = level[r], 0.1 * level[r]
            events.begin(track, j)
            _enter_piece(breaks, coefficients, frequencies, r, j, 0.0, cubic, frequency, offset)
            _reflect_break(0.0, trips, queue, head, tail, j, end[j])
            stop[j] = _next_break(breaks, r, 0.0, queue, head, tail, j, end[j])
            proposed[j] = 1e30
        if live == 0:
            break
        # ---- the waves over the trial steps
        for j in range(lanes):
            if row[j] < 0:
                h[j] = 0.0
                continue
            if touching[j] == 1:
                # the error of `touch_off`, a few thousandths of the force's impulse, is what limits a touch
                brief = (1e2 * local * min(1.0, 1.0 / inverse_mu[j]) * size[0, j]) ** 0.4
                proposed[j] = min(proposed[j], brief)
            left = stop[j] - time[j]
            trial = min(min(proposed[j], left), min(trips[0, j], trips[1, j]))
            attempts[j] += 1
            h[j] = trial
            misfit[j] = 0.0
        _incident(time, h, cubic, frequency, offset, push)
        for j in range(lanes):
            if row[j] >= 0 and time[j] >= min(trips[0, j], trips[1, j]) * (1.0 - 1e-12):
                trial = _echo_steps(j, time[j], h[j], trips, count[j], start[j], length[j], first, last)
                if trial < h[j]:
                    shrink = trial / h[j]
                    power = shrink
                    for k in range(1, TERMS):
                        push[k, j] *= power
                        power *= shrink
                    h[j] = trial
                for bar in range(2):
                    if trips[bar, j] <= time[j] * (1.0 + 1e-12) and first[bar, j] >= 0:
                        misfit[j] += _echo(start[j], scale[j], wave[bar, j], first[bar, j], last[bar, j],
                                           time[j] - trips[bar, j], h[j], 2.0 * reflect[bar, j],
                                           0.1 * local * size[0, j] / h[j], push, bar * LANES + j, work)  # fmt: skip
        # ---- the motion over the steps
        expand(mode, h, inverse_mu, push, x, u, root, force, half)
        longest(x, u, size, local, theta)
        for j in range(lanes):
            theta[j] = min(theta[j], 1.0)
            low[j] = (
                share * track[events.FACE_A, j]
                if end[j] == math.inf and (row[j] >= 0 and time[j] >= pulse_end[row[j]] * (1.0 - 1e-12))
                else -math.inf
            )
            if row[j] < 0:
                continue
            if touching[j] == 1:
                theta[j] = 1.0
                touch_off(mode, j, 1.0, h[j], inverse_mu[j], push, x, u, force)
            left = stop[j] - time[j]
            if theta[j] * h[j] >= left * (1.0 - 1e-10):
                theta[j] = 1.0
            elif 2.0 * theta[j] * h[j] > left:
                theta[j] = min(theta[j], 0.5 * left / h[j])
        for m in range(PAIR):
            at[0, m] = x[0, m]
            rate[0, m] = x[1, m]
        for i in range(1, events.POINTS + 1):
            evaluate(x, theta, i / events.POINTS, half, at[i], rate[i])
        evaluate(u, theta, 1.0, half, at_u, rate_u)
        events.look(mode, wanted, at, rate, track, theta, low, flags, top, least, crest)
        new = at[events.POINTS]
        for j in range(lanes):
            if row[j] < 0:
                continue
            r = row[j]
            if misfit[j] * h[j] > local * size[0, j] or not theta[j] > 0.0:
                proposed[j] = h[j] * (0.5 if theta[j] > 0.0 else 0.05)
                if proposed[j] <= 1e-15 * (1.0 + time[j]) or attempts[j] > 10 * capacity:
                    status[r] = events.STUCK
                    row[j] = -1
                    live -= 1
                continue
            before = time[j]
            at_stop = h[j] * theta[j] >= (stop[j] - before) * (1.0 - 1e-10)
            why = 0
            ending = theta[j]
            if flags[j] != 0:
                for face in range(2):
                    for k in range(TERMS):
                        piece[face, k] = x[k, face * LANES + j]
                    for i in range(events.POINTS + 1):
                        grid[face, 0, i] = at[i, face * LANES + j]
                        grid[face, 1, i] = rate[i, face * LANES + j]
                ending, why = events.after_step(
                    mode, flags[j], track, j, piece, grid, theta[j], before, h[j], min(trips[0, j], trips[1, j]),
                    share if low[j] > 0.0 else 0.0, local * size[0, j], stop_at_loss,
                )  # fmt: skip
            n = count[j]
            count[j] = n + 1
            start[j, n], scale[j, n], length[j, n], crests[j, n] = before, h[j], ending * h[j], crest[j]
            if store:
                for face in range(2):
                    for k in range(TERMS):
                        path[j, n, face, k] = x[k, face * LANES + j]
            for bar in range(2):
                if before + trips[bar, j] < end[j]:
                    for k in range(TERMS):
                        m = bar * LANES + j
                        wave[bar, j, n, k] = 0.5 * push[k, m] - force[k, m]
            if keeping and n < kept_start.shape[0]:
                power = 1.0
                kept_start[n], kept_length[n] = before, ending * h[j]
                for k in range(TERMS):
                    kept[n, 0, k] = x[k, j] * power
                    kept[n, 1, k] = x[k, LANES + j] * power
                    kept[n, 2, k] = u[k, j] * power
                    power *= ending
            touching[j] = 0
            if why >= 2:  # the motion goes on from where a face left or touched
                at_stop = False
                a, b, w = 0.0, 0.0, 0.0
                for k in range(ORDER, -1, -1):
                    a, b, w = a * ending + x[k, j], b * ending + x[k, LANES + j], w * ending + u[k, j]
                touching[j] = 1 if x[0, (why - 2) * LANES + j] <= 0.0 else 0
                new[j], new[LANES + j], at_u[j] = a, b, w
                new[(why - 2) * LANES + j] = 0.0
                if mode == 2:  # both faces move alike
                    new[j], new[LANES + j] = 0.0, 0.0
            time[j] = stop[j] if at_stop else before + ending * h[j]
            x[0, j], x[0, LANES + j], u[0, j] = new[j], new[LANES + j], at_u[j]
            size[0, j] = max(size[0, j], max(abs(x[0, j]), abs(x[0, LANES + j])))
            size[1, j] = max(size[1, j], abs(u[0, j]))
            proposed[j] = ending * h[j] * (GROWTH if time[j] < min(trips[0, j], trips[1, j]) else GROWTH_ECHO)
            done = why == 1
            if not done and at_stop:
                if time[j] >= end[j]:
                    done = True
                else:
                    proposed[j] *= GROWTH
                    _enter_piece(breaks, coefficients, frequencies, r, j, time[j], cubic, frequency, offset)
                    if not _reflect_break(time[j], trips, queue, head, tail, j, end[j]):
                        status[r] = events.CROWDED
                        row[j] = -1
                        live -= 1
                        continue
                    stop[j] = _next_break(breaks, r, time[j], queue, head, tail, j, end[j])
            if done:
                events.finish(mode, wanted, track, j, path[j], scale[j], start[j], length[j], crests[j], count[j],
                              out[r])  # fmt: skip
                status[r] = events.OK
                steps[r] = count[j]
                row[j] = -1
                live -= 1
            elif count[j] >= capacity:
                status[r] = events.FULL
                row[j] = -1
                live -= 1

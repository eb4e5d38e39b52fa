"""The compiled batch integrator of the equations of motion, in the scaled variables of theory (9).

Rows advance in lanes: every lane has its own time and step, all lanes go through the stages of the
Runge–Kutta step together, and a lane whose row has ended takes the next one.  A row's answer depends on
nothing but the row, so that any slice, order or number of threads gives the same bits.

A step never crosses a jump of the pulse or of one of its reflections, and is never longer than a round
trip.  The polynomials of a row's steps are kept until the row is done: thresholds are searched on them, and
the waves that leave the faces, which come back as reflections, are kept beside them.
"""

from __future__ import annotations

import math

import numpy as np

from uqsphere.mechanics import events
from uqsphere.mechanics.compiled import compiled
from uqsphere.mechanics.tableau import (
    DENSE_ROW,
    FIVE_ROW,
    NODES,
    STAGES,
    TERM_COLUMN,
    TERM_GROUPS,
    TERM_WEIGHT,
    THREE_ROW,
    WAVE_FIT,
    WAVE_NODES,
)

__all__ = ["march"]

LANES = 16
#: x1, x2 and u of all lanes stand one behind the other, so that one long loop serves all three
X1, X2, U, WIDTH = 0, LANES, 2 * LANES, 3 * LANES
WAVE = len(WAVE_NODES)
WAVE_THETAS = 0.5 * (1.0 + WAVE_NODES)
ASCENDING_STAGE = np.argsort(NODES, kind="stable")
ASCENDING = NODES[ASCENDING_STAGE]
GROWTH = 5.0
SAFETY = 0.9


@compiled()
def _echoes(start, length, wave, bar, lane, low, high, begin, h, thetas, out):  # type: ignore[no-untyped-def]
    """Values of a wave kept on the steps `low` to `high` of a lane, at begin + theta h for ascending thetas."""
    taken = 0
    for piece in range(low, high + 1):
        # all points up to the end of this piece; whatever rounding leaves over belongs to the last one
        scale = 2.0 / length[lane, piece]
        shift = (begin - start[lane, piece]) * scale - 1.0
        until = taken
        while until < len(thetas) and (piece == high or shift + thetas[until] * h * scale <= 1.0):
            until += 1
        # the coefficients are named one by one so that the loop over the points runs in vector registers
        c0, c1 = wave[bar, lane, piece, 0], wave[bar, lane, piece, 1]
        c2, c3 = wave[bar, lane, piece, 2], wave[bar, lane, piece, 3]
        c4, c5 = wave[bar, lane, piece, 4], wave[bar, lane, piece, 5]
        c6, c7 = wave[bar, lane, piece, 6], wave[bar, lane, piece, 7]
        c8, c9 = wave[bar, lane, piece, 8], wave[bar, lane, piece, 9]
        for i in range(taken, until):
            x = shift + thetas[i] * h * scale
            high_part = c5 + x * (c6 + x * (c7 + x * (c8 + x * c9)))
            out[i] = c0 + x * (c1 + x * (c2 + x * (c3 + x * (c4 + x * high_part))))
        taken = until


@compiled()
def _forces(  # type: ignore[no-untyped-def]
    push, time, step, cubic, frequency, offset, reflect, trips, first, last, start, length, wave, echo,
):  # fmt: skip
    """2 f and 2 h at every stage of every lane: the pulse, and the waves that come back; theory (4), (5)."""
    for i in range(STAGES):
        for l in range(LANES):
            x = time[l] + NODES[i] * step[l] - offset[l]
            push[i, 0, l] = 2.0 * (cubic[0, l] + x * (cubic[1, l] + x * (cubic[2, l] + x * cubic[3, l])))
            push[i, 1, l] = 0.0
    for l in range(LANES):
        if frequency[l] > 0.0:
            for i in range(STAGES):
                push[i, 0, l] = 2.0 * math.sin(frequency[l] * (time[l] + NODES[i] * step[l]))
        for bar in range(2):
            if first[bar, l] >= 0:
                _echoes(start, length, wave, bar, l, first[bar, l], last[bar, l], time[l] - trips[bar, l],
                        step[l], ASCENDING, echo)  # fmt: skip
                for i in range(STAGES):
                    push[ASCENDING_STAGE[i], bar, l] += 2.0 * reflect[bar, l] * echo[i]


@compiled()
def _sum(row, slope, out):  # type: ignore[no-untyped-def]
    """Weighted sum over the slopes, for all states of all lanes; `row` names the weights."""
    for m in range(WIDTH):
        out[m] = 0.0
    for g in range(0, 4 * TERM_GROUPS[row], 4):
        slope_0, slope_1 = TERM_COLUMN[row, g], TERM_COLUMN[row, g + 1]
        slope_2, slope_3 = TERM_COLUMN[row, g + 2], TERM_COLUMN[row, g + 3]
        weight_0, weight_1 = TERM_WEIGHT[row, g], TERM_WEIGHT[row, g + 1]
        weight_2, weight_3 = TERM_WEIGHT[row, g + 2], TERM_WEIGHT[row, g + 3]
        for m in range(WIDTH):
            out[m] += (
                weight_0 * slope[slope_0, m] + weight_1 * slope[slope_1, m]
                + weight_2 * slope[slope_2, m] + weight_3 * slope[slope_3, m]
            )  # fmt: skip


@compiled()
def _stages(mode, state, step, inverse_mu, push, slope, trial, new):  # type: ignore[no-untyped-def]
    """All stages of one step of every lane: slopes (stages, WIDTH) and the state at its end."""
    for i in range(STAGES):
        _sum(i, slope, trial)
        for c in range(3):
            for l in range(LANES):
                trial[c * LANES + l] = state[c * LANES + l] + step[l] * trial[c * LANES + l]
        # the equations of motion, theory (9)
        if mode == 0:
            for l in range(LANES):
                x1 = max(trial[X1 + l], 0.0)
                x2 = max(trial[X2 + l], 0.0)
                force_a = x1 * math.sqrt(x1)
                force_b = x2 * math.sqrt(x2)
                slope[i, X1 + l] = push[i, 0, l] - force_a - trial[U + l]
                slope[i, X2 + l] = trial[U + l] - force_b - push[i, 1, l]
                slope[i, U + l] = (force_a - force_b) * inverse_mu[l]
        elif mode == 1:
            for l in range(LANES):
                force_a = max(trial[X1 + l], 0.0)
                force_b = max(trial[X2 + l], 0.0)
                slope[i, X1 + l] = push[i, 0, l] - force_a - trial[U + l]
                slope[i, X2 + l] = trial[U + l] - force_b - push[i, 1, l]
                slope[i, U + l] = (force_a - force_b) * inverse_mu[l]
        else:
            for l in range(LANES):
                x1 = max(trial[X1 + l], 0.0)
                rate = 0.5 * (push[i, 0, l] - push[i, 1, l]) - x1 * math.sqrt(x1)
                slope[i, X1 + l] = rate
                slope[i, X2 + l] = rate
                slope[i, U + l] = 0.0
        if i == 12:  # the stages that follow overwrite `trial`
            for m in range(WIDTH):
                new[m] = trial[m]


@compiled()
def _weigh(slope, step, new, scale, local, error, factor, five, three):  # type: ignore[no-untyped-def]
    """Error of every lane's step over what is allowed, and the factor for the next step."""
    _sum(FIVE_ROW, slope, five)
    _sum(THREE_ROW, slope, three)
    for l in range(LANES):
        size_x = max(scale[0, l], max(abs(new[X1 + l]), abs(new[X2 + l])))
        size_u = max(scale[1, l], abs(new[U + l]))
        fifth = max(max(abs(five[X1 + l]), abs(five[X2 + l])) / size_x, abs(five[U + l]) / size_u)
        third = max(max(abs(three[X1 + l]), abs(three[X2 + l])) / size_x, abs(three[U + l]) / size_u)
        bottom = local * math.sqrt(fifth * fifth + 0.01 * third * third)
        estimate = step[l] * fifth * fifth / bottom if bottom > 0.0 else 0.0
        # an overflow, or not a number, is a step far too long
        error[l] = estimate if estimate < 1e8 else 1e8
        factor[l] = SAFETY / math.sqrt(math.sqrt(math.sqrt(max(error[l], 1e-9))))


@compiled()
def _polynomials(slope, step, state, dense):  # type: ignore[no-untyped-def]
    """Coefficients (8, WIDTH) of the step's polynomials in theta."""
    for m in range(WIDTH):
        dense[0, m] = state[m]
    for k in range(1, 8):
        _sum(DENSE_ROW + k - 1, slope, dense[k])
        for c in range(3):
            for l in range(LANES):
                dense[k, c * LANES + l] *= step[l]


@compiled()
def _leaving(  # type: ignore[no-untyped-def]
    mode, lane, n, before, h, path, cubic, frequency, offset, reflect, trips, first, last, start, length, wave,
    end, echo, samples,
):  # fmt: skip
    """Keep the waves that leave the faces during step n, where they come back before the record ends."""
    for bar in range(2):
        if before + trips[bar, lane] >= end[lane]:
            continue
        if first[bar, lane] >= 0:
            _echoes(start, length, wave, bar, lane, first[bar, lane], last[bar, lane], before - trips[bar, lane],
                    h, WAVE_THETAS, echo)  # fmt: skip
            for k in range(WAVE):
                echo[k] *= reflect[bar, lane]
        else:
            for k in range(WAVE):
                echo[k] = 0.0
        if bar == 0:
            for k in range(WAVE):
                x = before + WAVE_THETAS[k] * h - offset[lane]
                echo[k] += cubic[0, lane] + x * (cubic[1, lane] + x * (cubic[2, lane] + x * cubic[3, lane]))
            if frequency[lane] > 0.0:
                for k in range(WAVE):
                    echo[k] += math.sin(frequency[lane] * (before + WAVE_THETAS[k] * h))
        c0, c1 = path[lane, n, bar, 0], path[lane, n, bar, 1]
        c2, c3 = path[lane, n, bar, 2], path[lane, n, bar, 3]
        c4, c5 = path[lane, n, bar, 4], path[lane, n, bar, 5]
        c6, c7 = path[lane, n, bar, 6], path[lane, n, bar, 7]
        sign = -1.0 if bar == 0 else 1.0
        for k in range(WAVE):
            t = WAVE_THETAS[k]
            x = max(c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * (c6 + t * c7)))))), 0.0)
            force = x if mode == 1 else x * math.sqrt(x)
            samples[k] = echo[k] + sign * force
            echo[k] = 0.0
        for j in range(WAVE):
            sample = samples[j]
            for k in range(WAVE):
                echo[k] += WAVE_FIT[j, k] * sample
        for k in range(WAVE):
            wave[bar, lane, n, k] = echo[k]


@compiled()
def _enter_piece(breaks, coefficients, frequencies, row, lane, time, cubic, frequency, offset):  # type: ignore[no-untyped-def]
    """Put the piece of the pulse that begins at or holds `time` into the lane."""
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


@compiled()
def _next_break(breaks, row, time, queue, head, tail, lane, horizon):  # type: ignore[no-untyped-def]
    """The next time after `time` at which a step has to end: pulse, reflections, end of the record."""
    best = horizon
    near = time + 1e-13 * (1.0 + time)
    for k in range(breaks.shape[1]):
        if breaks[row, k] > near and breaks[row, k] < best:
            best = breaks[row, k]
    for bar in range(2):
        while head[bar, lane] < tail[bar, lane] and queue[bar, lane, head[bar, lane] % queue.shape[2]] <= near:
            head[bar, lane] += 1
        if head[bar, lane] < tail[bar, lane]:
            candidate = queue[bar, lane, head[bar, lane] % queue.shape[2]]
            if candidate < best:
                best = candidate
    return best


@compiled()
def _reflect_break(time, trips, queue, head, tail, lane, horizon):  # type: ignore[no-untyped-def]
    """Note that whatever happens at `time` comes back after a round trip of each bar; False if there is no room."""
    for bar in range(2):
        if time + trips[bar, lane] < horizon:
            if tail[bar, lane] - head[bar, lane] >= queue.shape[2]:
                return False
            queue[bar, lane, tail[bar, lane] % queue.shape[2]] = time + trips[bar, lane]
            tail[bar, lane] += 1
    return True


@compiled()
def march(  # type: ignore[no-untyped-def]
    mode, mass, ends, round_trips, breaks, coefficients, frequencies, horizon, pulse_end, level, tolerance,
    stop_at_loss, capacity, out, status, order, steps, kept_start, kept_length, kept,
):  # fmt: skip
    """Integrate rows `order` of a batch; answers go to `out` (rows, events.ANSWERS) and `status` (rows).

    mode: 0 full, 1 linear contact, 2 massless.  mass (n,): mu.  ends, round_trips (n, 2): R and T of the two
    bars (T infinite: no reflection).  breaks, coefficients, frequencies: the pulse in scaled time.  horizon
    (n,): end of the record, inf for the rule of infinite bars, which needs pulse_end (n,).  level (n,): scale
    of x that is expected at least.  kept* receive the polynomials (x1, x2, u) of the last row if they have
    room (first dimension > 0).
    """
    lanes = LANES
    state = np.zeros(WIDTH)
    trial = np.zeros(WIDTH)
    new = np.zeros(WIDTH)  # state at the end of the step
    samples = np.zeros(WAVE)
    slope = np.zeros((STAGES, WIDTH))
    push = np.zeros((STAGES, 2, lanes))
    dense = np.zeros((8, WIDTH))
    error = np.zeros(lanes)
    factor = np.zeros(lanes)
    five = np.zeros(WIDTH)
    three = np.zeros(WIDTH)
    ends_of = np.zeros((events.KINDS, 4, lanes))
    echo = np.zeros(STAGES)
    time = np.zeros(lanes)
    step = np.full(lanes, 1.0)
    proposed = np.zeros(lanes)
    row = np.full(lanes, -1)
    inverse_mu = np.ones(lanes)
    reflect = np.zeros((2, lanes))
    trips = np.full((2, lanes), np.inf)
    end = np.full(lanes, np.inf)
    stop = np.zeros(lanes)  # the next time at which a step has to end
    cubic = np.zeros((4, lanes))
    frequency = np.zeros(lanes)
    offset = np.zeros(lanes)
    count = np.zeros(lanes, dtype=np.int64)
    attempts = np.zeros(lanes, dtype=np.int64)
    queue = np.zeros((2, lanes, 2048))
    head = np.zeros((2, lanes), dtype=np.int64)
    tail = np.zeros((2, lanes), dtype=np.int64)
    first = np.zeros((2, lanes), dtype=np.int64)  # steps that hold the echo of the present step
    last = np.zeros((2, lanes), dtype=np.int64)
    # uninitialised: only the pages of steps that are taken ever cost memory
    start = np.empty((lanes, capacity))
    length = np.empty((lanes, capacity))
    states = 3 if kept_start.shape[0] > 0 else 2
    path = np.empty((lanes, capacity, states, 8))
    wave = np.empty((2, lanes, capacity, WAVE))
    track = np.zeros((lanes, events.TRACKS))
    scale = np.ones((2, lanes))
    local = 0.1 * tolerance
    taken = 0
    live = 0
    while True:
        # ---- fill idle lanes
        for l in range(lanes):
            if row[l] >= 0 or taken >= len(order):
                continue
            r = order[taken]
            taken += 1
            live += 1
            row[l] = r
            inverse_mu[l] = 1.0 / mass[r]
            end[l] = horizon[r]
            time[l] = 0.0
            count[l] = 0
            attempts[l] = 0
            for c in range(3):
                state[c * LANES + l] = 0.0
            for bar in range(2):
                reflect[bar, l] = ends[r, bar]
                trips[bar, l] = round_trips[r, bar]
                head[bar, l] = 0
                tail[bar, l] = 0
                first[bar, l] = 0
            scale[0, l] = level[r]
            scale[1, l] = 1e-3
            events.begin(track, l)
            _enter_piece(breaks, coefficients, frequencies, r, l, 0.0, cubic, frequency, offset)
            _reflect_break(0.0, trips, queue, head, tail, l, end[l])
            stop[l] = _next_break(breaks, r, 0.0, queue, head, tail, l, end[l])
            proposed[l] = (local * min(1.0, mass[r])) ** 0.4
        if live == 0:
            break
        # ---- choose the steps
        for l in range(lanes):
            if row[l] < 0:
                step[l] = 0.0
                continue
            h = min(proposed[l], min(trips[0, l], trips[1, l]))
            left = stop[l] - time[l]
            if h >= left * (1.0 - 1e-10):
                h = left
            elif 2.0 * h > left:
                h = 0.5 * left
            step[l] = h
            attempts[l] += 1
            for bar in range(2):
                begin = time[l] - trips[bar, l]
                near = 1e-13 * (1.0 + time[l])
                if begin < -near:
                    first[bar, l] = -1
                    continue
                k = max(first[bar, l], 0)
                while k < count[l] - 1 and start[l, k] + length[l, k] <= begin + near:
                    k += 1
                first[bar, l] = k
                while k < count[l] - 1 and start[l, k] + length[l, k] < begin + h - near:
                    k += 1
                last[bar, l] = k
        # ---- one step of every lane
        _forces(push, time, step, cubic, frequency, offset, reflect, trips, first, last, start, length, wave, echo)
        _stages(mode, state, step, inverse_mu, push, slope, trial, new)
        _weigh(slope, step, new, scale, local, error, factor, five, three)
        _polynomials(slope, step, state, dense)
        events.look_at_ends(mode, state, new, slope, step, ends_of)
        for l in range(lanes):
            if row[l] < 0:
                continue
            r = row[l]
            if error[l] > 1.0:
                proposed[l] = step[l] * max(0.2, factor[l])
                if proposed[l] <= 1e-15 * (1.0 + time[l]) or attempts[l] > 40 * capacity:
                    status[r] = events.STUCK
                    row[l] = -1
                    live -= 1
                continue
            n = count[l]
            h = step[l]
            start[l, n] = time[l]
            length[l, n] = h
            for c in range(path.shape[2]):
                for k in range(8):
                    path[l, n, c, k] = dense[k, c * LANES + l]
            if time[l] + min(trips[0, l], trips[1, l]) < end[l]:
                _leaving(mode, l, n, time[l], h, path, cubic, frequency, offset, reflect, trips, first, last,
                         start, length, wave, end, echo, samples)  # fmt: skip
            count[l] = n + 1
            before = time[l]
            at_stop = h == stop[l] - before
            time[l] = stop[l] if at_stop else before + h
            for c in range(3):
                state[c * LANES + l] = new[c * LANES + l]
            scale[0, l] = max(scale[0, l], max(abs(new[X1 + l]), abs(new[X2 + l])))
            scale[1, l] = max(scale[1, l], abs(new[U + l]))
            grown = h * min(GROWTH, max(0.2, factor[l]))
            proposed[l] = max(proposed[l], grown) if at_stop else grown
            # ---- what happened in the step
            done = events.after_step(
                mode, track, l, path, n, ends_of, before, h, min(trips[0, l], trips[1, l]), pulse_end[r],
                not math.isfinite(horizon[r]), local * scale[0, l], stop_at_loss,
            )  # fmt: skip
            if not done and at_stop:
                if time[l] >= end[l]:
                    done = True
                else:
                    _enter_piece(breaks, coefficients, frequencies, r, l, time[l], cubic, frequency, offset)
                    if not _reflect_break(time[l], trips, queue, head, tail, l, end[l]):
                        status[r] = events.CROWDED
                        row[l] = -1
                        live -= 1
                        continue
                    stop[l] = _next_break(breaks, r, time[l], queue, head, tail, l, end[l])
            if done:
                events.finish(mode, track, l, start, length, path, count[l], out[r])
                status[r] = events.OK
                steps[r] = count[l]
                if kept_start.shape[0] >= count[l]:  # asked for
                    for k in range(count[l]):
                        kept_start[k] = start[l, k]
                        kept_length[k] = length[l, k]
                        for c in range(3):
                            for m in range(8):
                                kept[k, c, m] = path[l, k, c, m]
                row[l] = -1
                live -= 1
            elif count[l] >= capacity:
                status[r] = events.FULL
                row[l] = -1
                live -= 1

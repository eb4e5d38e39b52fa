"""What happens inside the step of a lane: loss of contact, touch, change of branch, largest values.

Everything here is plain code for one lane.  Bounds of both approaches (`lanes.survey`) say in which
steps nothing can happen; only the others are searched, on the series of the step, so that an event
is located far better than the steps are long.  What is searched is s.piece, the part of the series
that belongs to the lane, in powers of theta.
"""

from __future__ import annotations

import math

import numpy as np

from uqsphere.mechanics.integrator import tracked
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import (
    ARMED,
    approach_at,
    face_force,
    face_yielded,
    stored_energy,
)
from uqsphere.mechanics.integrator.incoming import heard
from uqsphere.mechanics.integrator.tracked import (
    DIFFERENCE,
    ENERGY,
    FACE_A,
    FACE_B,
    KINDS,
    LANES,
    MASSLESS,
    MEAN,
    ORDER,
    PAIR,
    POINTS,
    SHARE,
    TERMS,
    WAVE,
    End,
)

#: Runge-Kutta steps over a touch
_TOUCH_STEPS = 4
#: change of a place, as a share of the trial step, below which a search is over
_SETTLED = 1e-8


# --- one root, one turn, one passage


@compiled
def value_of(series, m, theta):
    """Value of a column of a series inside a step."""
    total = 0.0
    for k in range(ORDER, -1, -1):
        total = total * theta + series[k, m]
    return total


@compiled
def take_piece(s, j):
    """Put the step of a lane where it is searched."""
    s.lane = j
    for face in range(2):
        for k in range(TERMS):
            s.piece[face, k] = s.x[k, face * LANES + j]


@compiled
def approach_of(s, face, theta):
    """Approach of a face inside the step that is searched, and its derivative by theta."""
    x, rate = s.piece[face, ORDER], 0.0
    for k in range(ORDER - 1, -1, -1):
        rate = rate * theta + x
        x = x * theta + s.piece[face, k]
    return x, rate


@compiled
def _both(s, kind, x_a, x_b, rate_a, rate_b):
    """Value and derivative of a function of both faces from the approaches and their
    derivatives.
    """
    if kind in (ENERGY, SHARE):
        (a, slope_a), (b, slope_b) = (
            stored_energy(s, s.lane, x_a),
            stored_energy(s, LANES + s.lane, x_b),
        )
    else:
        (a, slope_a), (b, slope_b) = face_force(s, s.lane, x_a), face_force(s, LANES + s.lane, x_b)
    of_a, of_b = 1.0, 1.0
    if kind == DIFFERENCE:
        of_b = -1.0
    elif kind == MEAN:
        of_a, of_b = 0.5, 0.5
    elif kind == SHARE:
        of_a, of_b = s.chi[s.lane], s.chi[LANES + s.lane]
    return of_a * a + of_b * b, of_a * slope_a * rate_a + of_b * slope_b * rate_b


@compiled
def _measure(s, kind, theta):
    """Value and derivative of one of the functions that are followed inside the step."""
    if kind <= FACE_B:
        return approach_of(s, kind, theta)
    x_a, rate_a = approach_of(s, FACE_A, theta)
    x_b, rate_b = approach_of(s, FACE_B, theta)
    return _both(s, kind, x_a, x_b, rate_a, rate_b)


@compiled
def highest_between(left, left_slope, right, right_slope):
    """What a function can reach between two ends: where the tangents meet, and a fifth for
    bends.
    """
    top = max(left, right)
    if left_slope > 0.0 > right_slope:
        top += 1.2 * left_slope * right_slope / (right_slope - left_slope)
    return top


@compiled
def root(s, face, level, sign, a, b):
    """theta between a and b at which sign (approach - level) rises through 0, by Newton's
    method.
    """
    theta = b
    for _ in range(60):
        x, rate = approach_of(s, face, theta)
        off, slope = sign * (x - level), sign * rate
        if off == 0.0:
            break
        if off > 0.0:
            b = theta
        else:
            a = theta
        following = theta - off / slope
        if not a <= following <= b:
            following = 0.5 * (a + b)
        change, theta = abs(following - theta), following
        if change < 1e-12:
            break
    return theta


@compiled
def turn(s, kind, a, b, slope_a, slope_b):
    """theta between a and b at which the slope of what is followed changes sign, as at the ends."""
    for _ in range(60):
        theta = b - slope_b * (b - a) / (slope_b - slope_a)
        if not min(a, b) < theta < max(a, b):
            theta = 0.5 * (a + b)
        if abs(theta - b) < _SETTLED:
            return theta
        _, slope = _measure(s, kind, theta)
        if (slope < 0.0) != (slope_b < 0.0):
            a, slope_a = b, slope_b
        else:
            slope_a *= 0.5
        b, slope_b = theta, slope
        if slope == 0.0:
            break
    return b


@compiled
def passage(s, face, level, sign, begin, end):
    """First theta from `begin` to `end` at which sign (approach - level) >= 0, or inf."""
    width = (end - begin) / POINTS
    left, left_slope = 0.0, 0.0
    for i in range(POINTS + 1):
        b = begin + i * width if i < POINTS else end
        x, rate = approach_of(s, face, b)
        right, right_slope = sign * (x - level), sign * rate * width
        a = b - width
        if right >= 0.0:
            if i == 0:
                return begin
            return root(s, face, level, sign, a, b)
        if (
            i > 0
            and left_slope > 0.0 > right_slope
            and highest_between(left, left_slope, right, right_slope) >= 0.0
        ):
            top = turn(s, face, a, b, sign * left_slope, sign * right_slope)
            if sign * (approach_of(s, face, top)[0] - level) >= 0.0:
                return root(s, face, level, sign, a, top)
        left, left_slope = right, right_slope
    return math.inf


@compiled
def _summit(s, kind, end, known):
    """Largest value in [0, end] of what is followed and its theta, or `known` and -1 if that is
    larger.

    Of the difference of the forces the size counts.
    """
    j, width, place, signed = s.lane, end / POINTS, -1.0, kind == DIFFERENCE
    left, left_slope = 0.0, 0.0
    for i in range(POINTS + 1):
        if kind <= FACE_B:
            m = kind * LANES + j
            right, right_slope = s.at[i, m], s.rate[i, m]
        else:
            b = LANES + j
            right, right_slope = _both(s, kind, s.at[i, j], s.at[i, b], s.rate[i, j], s.rate[i, b])
        if (abs(right) if signed else right) > known:
            known, place = abs(right), i * width
        sign = 1.0
        if signed and left + right < 0.0:
            sign = -1.0
        bound = highest_between(
            sign * left, sign * left_slope * width, sign * right, sign * right_slope * width
        )
        if i > 0 and bound > max(known, max(sign * left, sign * right)):
            peak = turn(s, kind, (i - 1) * width, i * width, left_slope, right_slope)
            value = sign * _measure(s, kind, peak)[0]
            if value > known:
                known, place = value, peak
        left, left_slope = right, right_slope
    return known, place


# --- events


@compiled
def is_quiet(s, j):
    """Whether no contact or branch can change in the step of a lane, no record end, and nothing
    that is followed grow.
    """
    for face in range(2):
        m = face * LANES + j
        top, floor = s.top[m], s.floor[m]
        if s.touched[face, j] == 0.0:
            return False
        if (floor <= s.near[j]) if s.x[0, m] > 0.0 else (top > 0.0):
            return False
        if s.has_laws and (
            s.spring[m] == 0.0
            or top >= (s.largest[m] - s.dent[m]) * (1.0 - ARMED)
            or (top > s.peak[face, j] and not face_yielded(s, m))
        ):
            return False
        if not s.has_laws and top > s.peak[FACE_A, j]:
            return False
    return max(s.floor[j], s.floor[LANES + j]) >= s.low[j]


@compiled
def _first_event(s, j):
    """theta at which the step of a lane ends, and why: its series, a contact or a branch that
    changes.
    """
    ends = s.theta[j]
    for face in range(2):
        m, at = face * LANES + j, math.inf
        if s.x[0, m] > 0.0:
            if s.touched[face, j] > 0.0 and s.floor[m] <= s.near[j]:
                _note_graze(s, j, face, ends)
                at = passage(s, face, 0.0, -1.0, 0.0, ends)
        elif (s.x[0, m] < 0.0 or s.x[1, m] < 0.0) and s.top[m] > 0.0:
            # a face that left at the start of this step is clear of zero a little later
            clear = 0.0
            if s.x[0, m] == 0.0:
                clear = 1e-3 * ends
            at = passage(s, face, 0.0, 1.0, clear, ends)
        if at <= ends:
            ends, s.why[j], s.side[j] = at, End.CONTACT, face
        if s.has_laws and not s.touching[j]:
            at = _virgin_end(s, face, ends) if s.spring[m] == 0.0 else _spring_end(s, face, ends)
            if at < ends or (at == ends and s.why[j] == End.SERIES):
                ends, s.why[j], s.side[j] = at, End.BRANCH, face
    if s.why[j] == End.CONTACT and s.x[0, s.side[j] * LANES + j] > 0.0 and math.isnan(s.lost[j]):
        s.lost[j] = s.time[j] + ends * s.h[j]
        _note_loss(s, j, ends)
    return ends


@compiled
def _spring_end(s, face, end):
    """theta at which a spring is at its largest approach so far again, or inf."""
    m = face * LANES + s.lane
    largest = s.largest[m] - s.dent[m]
    if s.top[m] < largest * (1.0 - ARMED):
        return math.inf
    if s.x[0, m] < largest * (1.0 - ARMED):
        return passage(s, face, largest, 1.0, 0.0, end)
    # from its largest approach a spring goes down, but for a dip of a turn that hardly was one
    width, i = end / POINTS, 1
    while i <= POINTS and approach_of(s, face, i * width)[0] <= largest * (1.0 + ARMED):
        i += 1
    if i > POINTS:
        return math.inf
    # where it turns the slope is zero but for rounding
    begin = max(i - 1.0, 1e-3) * width
    x, rate = approach_of(s, face, begin)
    if rate < 0.0:
        begin = turn(s, face, begin, i * width, rate, approach_of(s, face, i * width)[1])
        x, _ = approach_of(s, face, begin)
    if x >= largest:
        return begin
    return root(s, face, largest, 1.0, begin, i * width)


@compiled
def _virgin_end(s, face, end):
    """theta at which a face on virgin loading turns, or inf."""
    width, left, bow_left = end / POINTS, s.piece[face, 1], 2.0 * s.piece[face, 2]
    for i in range(1, POINTS + 1):
        begin, theta = (i - 1) * width, i * width
        right, bow = 0.0, 0.0
        for k in range(ORDER, 0, -1):
            bow = bow * theta + right
            right = right * theta + k * s.piece[face, k]
        if left > 0.0:
            if right > 0.0 and bow_left < 0.0 < bow:
                # a fall that may be over before the next point: where the rate is least
                low, high = begin, theta
                for _ in range(30):
                    if highest_between(-left, -bow_left * width, -right, -bow * width) <= 0.0:
                        break
                    middle = 0.5 * (low + high)
                    rate, bend = 0.0, 0.0
                    for k in range(ORDER, 0, -1):
                        bend = bend * middle + rate
                        rate = rate * middle + k * s.piece[face, k]
                    if rate <= 0.0:
                        return turn(s, face, begin, middle, left, rate)
                    if bend < 0.0:
                        low = middle
                    else:
                        high = middle
            if right <= 0.0:
                return turn(s, face, begin, theta, left, right)
        left, bow_left = right, bow
    return math.inf


@compiled
def _note_loss(s, j, ends):
    """How far the error of the approach moves a loss of contact; whether it may undo it."""
    face = s.side[j]
    rate, bow = 0.0, 0.0
    for k in range(ORDER, 0, -1):
        bow = bow * ends + rate
        rate = rate * ends + k * s.piece[face, k]
    s.blur[j] = s.faint[j] * s.h[j] / -rate
    # how deep a gap opens before the approach turns, or the waves jump
    depth = -rate * ((s.stop[j] - s.time[j]) / s.h[j] - ends)
    if bow > 0.0:
        depth = min(depth, 0.5 * rate * rate / bow)
    if depth < s.faint[j]:
        s.grazed[j] = 0.0
    elif s.lost[j] - s.grazed[j] < 2.0 * s.blur[j]:
        s.grazed[j] = s.lost[j]  # it went straight through


@compiled
def _note_graze(s, j, face, ends):
    """When the approach of a face first comes so near to zero, before any loss, that its error may
    decide on one.
    """
    if s.wanted & tracked.TO_THE_END and math.isnan(s.lost[j]) and math.isnan(s.grazed[j]):
        at = passage(s, face, s.faint[j], -1.0, 0.0, ends)
        if at < math.inf:
            s.grazed[j] = s.time[j] + s.h[j] * at


@compiled
def _both_below(s, level, end):
    """First theta in [0, end] at which both approaches lie below `level`, or inf."""
    at = 0.0
    for _ in range(8 * POINTS):
        before = at
        for face in range(2):
            at = passage(s, face, level, -1.0, at, end)
            if at == math.inf:
                return at
        if at == before:
            return at
    return math.inf


@compiled
def after_step(s, j):
    """Bring what is followed of a row up to date with its step; the share of the trial step at
    which it ends.

    s.why and s.side receive what ends it.
    """
    ends, echoed = s.theta[j], heard(s, j, s.back[j])
    s.places[0], s.places[1] = -1.0, -1.0
    quiet, kinds = is_quiet(s, j), 0
    if s.wanted & OF_BOTH:
        kinds = _may_grow(s, j)
    if not quiet or kinds:
        take_piece(s, j)
    if not quiet:
        ends = _first_event(s, j)
        if ends < s.theta[j]:
            for i in range(POINTS + 1):
                for face in range(2):
                    m = face * LANES + j
                    s.at[i, m], s.rate[i, m] = approach_of(s, face, ends * i / POINTS)
        highest = max(s.peak[FACE_A, j], s.peak[FACE_B, j])
        for face in range(2):
            m = face * LANES + j
            if s.has_laws and face_yielded(s, m):
                # on virgin loading it is at its deepest at the end
                if s.spring[m] == 0.0:
                    s.places[face] = ends
            else:
                # faces that are alike share the largest approach so far
                to = face if s.has_laws else FACE_A
                s.peak[to, j], s.places[face] = _summit(s, face, ends, s.peak[to, j])
                highest = max(highest, s.peak[to, j])
            # above it a face has touched
            if s.at[POINTS, m] > max(50.0 * s.error[j], 2.0 * s.requested) * s.size[2 * face, j]:
                s.touched[face, j] = 1.0
        if not echoed:
            s.x_first[FACE_A, j], s.x_first[FACE_B, j] = s.peak[FACE_A, j], s.peak[FACE_B, j]
    for kind in range(DIFFERENCE, KINDS):
        if kinds & (1 << kind):
            s.peak[kind, j] = _summit(s, kind, ends, s.peak[kind, j])[0]
    if not quiet and s.low[j] > 0.0:  # the record ends below a share of the largest approach
        low = s.low[j]
        if not s.by_law[j]:
            low = s.share * highest
        at = _both_below(s, low, ends)
        if at <= ends:
            ends, s.why[j], s.ended[j] = at, End.RECORD, s.time[j] + at * s.h[j]
            if s.lost[j] > s.ended[j]:  # a loss after the record's end is none
                s.lost[j] = math.nan
    if s.rigged:
        for face in range(2):
            if s.places[face] >= 0.0:
                other = value_of(s.force, (1 - face) * LANES + j, s.places[face])
                s.other[face, j], s.chatter[j] = max(other, 0.0), s.touches[j]
    if s.wanted & tracked.WANT_CARRIED:
        _note_squared_forces(s, j, ends)
    if s.wanted & tracked.WANT_DURATION:
        _note_impulse(s, j, ends)
    return ends


#: functions of both faces whose largest values are followed
OF_BOTH = tracked.WANT_DIFFERENCE | tracked.WANT_ENERGY | tracked.WANT_SHARE | tracked.WANT_MEAN


@compiled
def _may_grow(s, j):
    """Functions of both faces (bits) that may be the largest so far in the step of a lane."""
    a, b, kinds, wanted = j, LANES + j, 0, s.wanted
    if wanted & (tracked.WANT_MEAN | tracked.WANT_DIFFERENCE):
        force_a, force_b = face_force(s, a, s.top[a])[0], face_force(s, b, s.top[b])[0]
        if wanted & tracked.WANT_MEAN and 0.5 * (force_a + force_b) > s.peak[MEAN, j]:
            kinds |= 1 << MEAN
        if wanted & tracked.WANT_DIFFERENCE:
            apart = force_a - face_force(s, b, s.floor[b])[0]
            apart = max(apart, force_b - face_force(s, a, s.floor[a])[0])
            if apart > s.peak[DIFFERENCE, j]:
                kinds |= 1 << DIFFERENCE
    if wanted & (tracked.WANT_ENERGY | tracked.WANT_SHARE):
        stored_a, stored_b = stored_energy(s, a, s.top[a])[0], stored_energy(s, b, s.top[b])[0]
        if wanted & tracked.WANT_ENERGY and stored_a + stored_b > s.peak[ENERGY, j]:
            kinds |= 1 << ENERGY
        if (
            wanted & tracked.WANT_SHARE
            and s.chi[a] * stored_a + s.chi[b] * stored_b > s.peak[SHARE, j]
        ):
            kinds |= 1 << SHARE
    return kinds


#: Gauss points and weights of a step, exact to the power 23: further terms are below the tolerance
_NODES, _WEIGHTS = (
    0.5 * (array + shift)
    for array, shift in zip(np.polynomial.legendre.leggauss(WAVE), (1.0, 0.0), strict=True)
)


@compiled
def _read(s, series, m, thetas):
    """Put the values of a column of a series at WAVE places of the step to s.work."""
    for i in range(WAVE):
        value = 0.0
        for k in range(TERMS):
            value = value * thetas[i] + series[ORDER - k, m]
        s.work[i] = value


@compiled
def _note_impulse(s, j, theta):
    """Add the integral of the mean force over a step.

    The series of the forces err as those of the approaches do, by a share of the largest one.
    While the impulse is less than a fiftieth of that it is summed over forces of the approaches, in
    z with t = z²: smooth from a touch on.
    """
    impulse = 0.0
    if s.touching[j] or 50.0 * s.impulse[j] < max(s.size[0, j], s.size[2, j]):
        for i in range(WAVE):
            s.nodes[i] = theta * _NODES[i] * _NODES[i]
        for m in range(j, PAIR, LANES):
            _read(s, s.x, m, s.nodes)
            for i in range(WAVE):
                impulse += _WEIGHTS[i] * _NODES[i] * face_force(s, m, s.work[i])[0]
    else:
        for k in range(ORDER, -1, -1):
            mean = 0.5 * (s.force[k, j] + s.force[k, LANES + j])
            impulse = impulse * theta + mean / (k + 1.0)
    s.impulse[j] += impulse * theta * s.h[j]


@compiled
def _note_squared_forces(s, j, theta):
    """Add the integrals of both squared forces over a step up to theta."""
    for i in range(WAVE):
        s.nodes[i] = theta * _NODES[i]
    for face in range(2):
        _read(s, s.force, face * LANES + j, s.nodes)
        total = 0.0
        for i in range(WAVE):
            total += _WEIGHTS[i] * s.work[i] * s.work[i]
        s.carried[face, j] += total * theta * s.h[j]


@compiled
def next_touch(s, j):
    """How long until a gap closes while no force acts: inf if both grow for ever, NaN while a face
    is pressed.
    """
    closing = math.inf
    for face in range(2):
        m = face * LANES + j
        if s.x[0, m] > 0.0:
            return math.nan
        rate = s.there[m] * (s.free[0, m] + (2.0 * face - 1.0) * s.u[0, j])
        if rate > 0.0:
            closing = min(closing, -s.x[0, m] / rate)
    return closing


@compiled
def first_at(s, j, made, level):
    """Time at which the larger approach of a row first reaches `level`.

    Where faces have laws of their own `level` is a force: what approach that is follows from the
    branch of a step.
    """
    for n in range(s.count[j]):
        kept = made[j, n]
        if kept.crest < level:
            continue
        end, best = min(kept.holds, s.ended[j] - kept.began) / kept.unit, math.inf
        for face in range(2):
            height, spring = level, kept.spring[face]
            if s.has_laws and spring > 0.0:
                height = (level / spring) ** (2.0 / 3.0)
            elif s.has_laws:
                height = approach_at(s, face * LANES + j, level) - kept.dent[face]
            for k in range(TERMS):
                s.piece[face, k] = kept.path[face, k]
            best = min(best, passage(s, face, height, 1.0, 0.0, end))
        if best < math.inf:
            return kept.began + best * kept.unit
    return math.nan


# --- The first short step from a touch, where x^(3/2) has no power series in time: Runge-Kutta
# steps of order 4 over h.


@compiled
def _slopes(s, j, theta, state):
    """Right-hand side of theory (9) and (R3) for one lane: of x_1, x_2, u, U_A, -U_B."""
    x1, x2, u, w1, w2 = state
    k = LANES + j
    push_a, push_b = value_of(s.push, j, theta), value_of(s.push, k, theta)
    force_a, force_b = face_force(s, j, x1)[0], face_force(s, k, x2)[0]
    if s.mode == MASSLESS:
        rate = 0.5 * (push_a + push_b) - force_a
        return rate, rate, 0.0, 0.0, 0.0
    return (
        s.there[j] * (push_a - s.gives[j] * force_a - u + w1),
        s.there[k] * (push_b - s.gives[k] * force_b + u + w2),
        (force_a - force_b) * s.inverse_mu[j],
        -s.lightness[j] * force_a,
        -s.lightness[k] * force_b,
    )


@compiled
def _moved(state, share, slopes):
    """state + share·slopes."""
    x1, x2, u, w1, w2 = state
    d1, d2, du, e1, e2 = slopes
    return x1 + share * d1, x2 + share * d2, u + share * du, w1 + share * e1, w2 + share * e2


@compiled
def _join(series, m, left, right):
    """Put the cubic through values and slopes at 0 and 1 into a column of a series."""
    (begin, rate), (end, end_rate) = left, right
    rise = end - begin
    series[0, m] = begin
    series[1, m] = rate
    series[2, m] = 3.0 * rise - 2.0 * rate - end_rate
    series[3, m] = rate + end_rate - 2.0 * rise
    for k in range(4, TERMS):
        series[k, m] = 0.0


@compiled
def step_from_touch(s, j):
    """Replace the series of a lane over its trial step by cubics that join both ends."""
    b, h = LANES + j, s.h[j]
    d, theta, part = h / _TOUCH_STEPS, 0.0, 1.0 / _TOUCH_STEPS
    state = s.x[0, j], s.x[0, b], s.u[0, j], s.free[0, j], s.free[0, b]
    old, begin = state, _slopes(s, j, 0.0, state)
    slopes = begin
    for i in range(_TOUCH_STEPS):
        theta = i * part
        second = _slopes(s, j, theta + 0.5 * part, _moved(state, 0.5 * d, slopes))
        third = _slopes(s, j, theta + 0.5 * part, _moved(state, 0.5 * d, second))
        fourth = _slopes(s, j, theta + part, _moved(state, d, third))
        both = _moved(second, 1.0, third)
        state = _moved(_moved(_moved(state, d / 6.0, slopes), d / 3.0, both), d / 6.0, fourth)
        slopes = _slopes(s, j, theta + part, state)
    _join(s.x, j, (old[0], h * begin[0]), (state[0], h * slopes[0]))
    _join(s.x, b, (old[1], h * begin[1]), (state[1], h * slopes[1]))
    _join(s.u, j, (old[2], h * begin[2]), (state[2], h * slopes[2]))
    _join(s.u, b, (old[2], h * begin[2]), (state[2], h * slopes[2]))
    _join(s.free, j, (old[3], h * begin[3]), (state[3], h * slopes[3]))
    _join(s.free, b, (old[4], h * begin[4]), (state[4], h * slopes[4]))
    for m in range(j, PAIR, LANES):
        end, rate = (state[0], slopes[0]) if m == j else (state[1], slopes[1])
        (left, by_left), (right, by_right) = face_force(s, m, s.x[0, m]), face_force(s, m, end)
        _join(s.force, m, (left, by_left * s.x[1, m]), (right, by_right * h * rate))

"""What happens inside the step of a lane: loss of contact, touch, change of branch, largest values.

Everything here is plain code for one lane.  Bounds of both approaches (`lanes.survey`) say in which
steps nothing can happen; only the others are searched, on the series of the step, so that an event
is located far better than the steps are long.

What is searched is a value over theta, the share of the trial step, by its kind: an approach, its
rate, or a function of both approaches.  Two searches serve all events: `passage`, where a value
first crosses a level, and `turn`, where its slope changes sign.  `after_step` looks in this order

    first event     a contact that is lost or found (an approach crosses zero); a spring at its
                    largest approach again, virgin loading that turns (its rate crosses zero)
    largest values  up to there
    end of record   both approaches below a share of the largest
    integrals       of the forces and of their squares, up to there
"""

from __future__ import annotations

import math
from math import inf, nan

import numpy as np

from . import tracked
from .compiled import compiled
from .faces import (
    ARMED,
    approach_at,
    face_force,
    face_yielded,
    higher,
    lower,
    stored_energy,
    tail_level,
)
from .lanes import OF_POWERS
from .tracked import (
    ADDED_UP,
    DIFFERENCE,
    ENERGY,
    FACE_B,
    KINDS,
    LANES,
    ORDER,
    PAIR,
    POINTS,
    SPHERE_ENERGY,
    TERMS,
    WAVE,
    End,
)

#: change of a place, as a share of the trial step, below which a search is over
_SETTLED = 1e-8
#: steps of Newton's method to a peak at most
_STEPS_TO_PEAK = 4
#: Gauss points and weights of a step, exact to the power 23: further terms are below the tolerance
NODES, WEIGHTS = (
    0.5 * (array + shift)
    for array, shift in zip(np.polynomial.legendre.leggauss(WAVE), (1.0, 0.0), strict=True)
)
#: kind of what is followed that is the rate of the approach of A; that of B is the next one
RATE = KINDS


# --- one root, one turn, one passage, one peak


@compiled
def value_of(series, m, theta):
    """Value of a column of a series inside a step."""
    total = 0.0
    for k in range(ORDER, -1, -1):
        total = total * theta + series[k, m]
    return total


@compiled
def rise_of(series, m, theta):
    """Value of a column of a series inside a step, and its derivative by theta."""
    value = series[ORDER, m]
    rate = 0.0
    for k in range(ORDER - 1, -1, -1):
        rate = rate * theta + value
        value = value * theta + series[k, m]
    return value, rate


@compiled
def _bend_of(s, m, theta):
    """First and second derivative of an approach by theta."""
    rate = 0.0
    bend = 0.0
    for k in range(ORDER, 0, -1):
        bend = bend * theta + rate
        rate = rate * theta + k * s.x[k, m]
    return rate, bend


@compiled
def _both(s, j, kind, at_a, at_b):
    """Value and derivative of a function of both faces from those of their approaches."""
    (x_a, rate_a), (x_b, rate_b) = at_a, at_b
    b = LANES + j
    weight_a = weight_b = 1.0
    if kind in (ENERGY, SPHERE_ENERGY):
        value_a, slope_a = stored_energy(s, j, x_a)
        value_b, slope_b = stored_energy(s, b, x_b)
        if kind == SPHERE_ENERGY:
            weight_a = s.chi[j]
            weight_b = s.chi[b]
    else:
        value_a, slope_a = face_force(s, j, x_a)
        value_b, slope_b = face_force(s, b, x_b)
        if kind == DIFFERENCE:
            weight_b = -1.0
        else:
            weight_a = weight_b = 0.5
    slope = weight_a * slope_a * rate_a + weight_b * slope_b * rate_b
    return weight_a * value_a + weight_b * value_b, slope


@compiled
def _measure(s, j, kind, theta):
    """Value and derivative of what is followed inside the step, or of the rate of an approach."""
    if kind <= FACE_B:
        return rise_of(s.x, kind * LANES + j, theta)
    if kind >= RATE:
        return _bend_of(s, (kind - RATE) * LANES + j, theta)
    return _both(s, j, kind, rise_of(s.x, j, theta), rise_of(s.x, LANES + j, theta))


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
def root(s, j, kind, level, sign, a, b):
    """theta between a and b at which sign (value - level) rises through 0, by Newton's method."""
    theta = b
    for _ in range(60):
        value, slope = _measure(s, j, kind, theta)
        off = sign * (value - level)
        if off == 0.0:
            break
        if off > 0.0:
            b = theta
        else:
            a = theta
        following = theta - off / (sign * slope)
        if not a <= following <= b:
            following = 0.5 * (a + b)
        change = abs(following - theta)
        theta = following
        if change < 1e-12:
            break
    return theta


@compiled
def turn(s, j, kind, begin, end):
    """theta between two places, each with the slope there, at which the slope of what is followed
    changes sign, as at the ends.
    """
    (a, slope_a), (b, slope_b) = begin, end
    for _ in range(60):
        theta = b - slope_b * (b - a) / (slope_b - slope_a)
        if not min(a, b) < theta < max(a, b):
            theta = 0.5 * (a + b)
        if abs(theta - b) < _SETTLED:
            return theta
        _, slope = _measure(s, j, kind, theta)
        if (slope < 0.0) != (slope_b < 0.0):
            a = b
            slope_a = slope_b
        else:
            slope_a *= 0.5
        b = theta
        slope_b = slope
        if slope == 0.0:
            break
    return b


@compiled
def passage(s, j, kind, level, sign, begin, end):
    """First theta from `begin` to `end` at which sign (value - level) >= 0, or inf."""
    width = (end - begin) / POINTS
    left = 0.0
    left_slope = 0.0
    for i in range(POINTS + 1):
        b = begin + i * width if i < POINTS else end
        value, slope = _measure(s, j, kind, b)
        right = sign * (value - level)
        right_slope = sign * slope * width
        a = b - width
        if right >= 0.0:
            if i == 0:
                return begin
            return root(s, j, kind, level, sign, a, b)
        if (
            i > 0
            and left_slope > 0.0 > right_slope
            and highest_between(left, left_slope, right, right_slope) >= 0.0
        ):
            top = turn(s, j, kind, (a, sign * left_slope), (b, sign * right_slope))
            value, _ = _measure(s, j, kind, top)
            if sign * (value - level) >= 0.0:
                return root(s, j, kind, level, sign, a, top)
        left = right
        left_slope = right_slope
    return inf


@compiled
def _deepest(s, j, m, ending, deepest):
    """Largest approach of a face in [0, ending] and its theta, or `deepest` and -1 if that is
    larger.

    A peak between two nodes is that of the cubic through both, mended by Newton's method on the
    series until what is left is a thousandth of the error of the step.
    """
    width = ending / POINTS
    place = -1.0
    allowed = 1e-3 * s.error[j] * s.size[m]
    for i in range(POINTS + 1):
        if s.at[i, m] > deepest:
            deepest = s.at[i, m]
            place = i * width
    if s.top[m] <= deepest:
        return deepest, place
    for i in range(1, POINTS + 1):
        left = s.at[i - 1, m]
        left_slope = s.rate[i - 1, m] * width
        right = s.at[i, m]
        right_slope = s.rate[i, m] * width
        if not left_slope > 0.0 > right_slope:
            continue
        if highest_between(left, left_slope, right, right_slope) <= deepest:
            continue
        begin = (i - 1) * width
        rise = right - left
        bow = 3.0 * rise - 2.0 * left_slope - right_slope
        twist = left_slope + right_slope - 2.0 * rise
        between = left_slope / (math.sqrt(bow * bow - 3.0 * left_slope * twist) - bow)
        theta = begin + between * width
        for _ in range(_STEPS_TO_PEAK):
            peak = s.x[ORDER, m]
            rate = 0.0
            bend = 0.0
            for k in range(ORDER - 1, -1, -1):
                bend = bend * theta + rate
                rate = rate * theta + peak
                peak = peak * theta + s.x[k, m]
            step = -0.5 * rate / bend
            if not (bend < 0.0 and begin < theta + step < begin + width):
                theta = turn(s, j, m // LANES, (begin, left_slope), (i * width, right_slope))
                peak = value_of(s.x, m, theta)
                break
            theta += step
            peak += 0.5 * rate * step
            if rate * step * abs(step) < allowed * width:
                break
        if peak > deepest:
            deepest = peak
            place = theta
    return deepest, place


@compiled
def _highest(s, j, kind, ending, highest):
    """Largest size in [0, ending] of a function of both faces, or `highest` if that is larger.

    Only the difference of the forces may be negative.
    """
    b = LANES + j
    width = ending / POINTS
    left = 0.0
    left_slope = 0.0
    for i in range(POINTS + 1):
        at_a = (s.at[i, j], s.rate[i, j])
        at_b = (s.at[i, b], s.rate[i, b])
        right, right_slope = _both(s, j, kind, at_a, at_b)
        highest = max(highest, abs(right))
        sign = 1.0
        if left + right < 0.0:
            sign = -1.0
        bound = highest_between(
            sign * left, sign * left_slope * width, sign * right, sign * right_slope * width
        )
        if i > 0 and bound > max(highest, max(sign * left, sign * right)):
            theta = turn(s, j, kind, ((i - 1) * width, left_slope), (i * width, right_slope))
            peak, _ = _measure(s, j, kind, theta)
            highest = max(highest, sign * peak)
        left = right
        left_slope = right_slope
    return highest


# --- events


@compiled
def _set_loss_level(s, j):
    """What an approach may err by, and the approach below which a loss of contact is looked for.

    `faint`, that error, is the tolerance of this look times the scale of the larger approach, times
    the share that is left of the error allowed in one step (less once a face has yielded, and from
    `kernel.FREE_STEPS` on).  In a look closer than what is requested every step may have erred by
    as much, and all one way.  Only a face that has been well above what is faint
    (`was_pressed`) can lose contact.
    """
    lane = s.lane[j]
    steps = 0
    if s.tolerance < s.requested:
        steps = lane.count
    lane.faint = (1.0 + steps) * s.tolerance * s.error[j] / s.local * higher(s.size, j)
    lane.loss_level = max(lane.faint, max(ADDED_UP * s.error[j], s.requested) * lower(s.size, j))
    if s.rigged and not math.isnan(lane.lost):
        lane.loss_level = 0.0  # only the first loss of contact is an answer of its own


@compiled
def _first_event(s, j):
    """theta at which the step of a lane ends, and why: its series, a contact or a branch that
    changes.
    """
    lane = s.lane[j]
    ending = s.theta[j]
    for face in range(2):
        m = face * LANES + j
        at = inf
        if s.x[0, m] > 0.0:
            if lane.was_pressed[face] > 0.0 and s.floor[m] <= lane.loss_level:
                _note_graze(s, j, face, ending)
                at = passage(s, j, face, 0.0, -1.0, 0.0, ending)
        elif (s.x[0, m] < 0.0 or s.x[1, m] < 0.0) and s.top[m] > 0.0:
            # a face that left at the start of this step is clear of zero a little later
            clear = 0.0
            if s.x[0, m] == 0.0:
                clear = 1e-3 * ending
            at = passage(s, j, face, 0.0, 1.0, clear, ending)
        if at <= ending:
            ending = at
            lane.ended_by = End.TOUCHED
            if s.x[0, m] > 0.0:
                lane.ended_by = End.LOST
            lane.side = face
        if s.has_laws and not lane.from_touch:
            at = _branch_end(s, j, face, ending)
            if at < ending or (at == ending and lane.ended_by == End.SERIES):
                ending = at
                lane.ended_by = End.BRANCH
                lane.side = face
    return ending


@compiled
def _branch_end(s, j, face, ending):
    """theta at which a face changes its branch, or inf: on virgin loading it turns; a spring is at
    its largest approach so far again.
    """
    m = face * LANES + j
    width = ending / POINTS
    if s.spring[m] == 0.0:
        for i in range(POINTS):
            begin = i * width
            rate, _ = _bend_of(s, m, begin)
            if rate > 0.0:  # where the loading begins the rate may be zero but for rounding
                return passage(s, j, RATE + face, 0.0, -1.0, begin, ending)
        return inf
    largest = s.largest[m] - s.dent[m]
    if s.top[m] < largest * (1.0 - ARMED):
        return inf
    if s.x[0, m] < largest * (1.0 - ARMED):
        return passage(s, j, face, largest, 1.0, 0.0, ending)
    # from its largest approach a spring goes down; after a shallow turn it may come up through it
    # again within the step
    for i in range(1, POINTS + 1):
        theta = i * width
        above, above_rate = rise_of(s.x, m, theta)
        if above > largest * (1.0 + ARMED):
            # where it turns the slope is zero but for rounding
            begin = max(i - 1.0, 1e-3) * width
            _, rate = rise_of(s.x, m, begin)
            if rate < 0.0:
                begin = turn(s, j, face, (begin, rate), (theta, above_rate))
            return passage(s, j, face, largest, 1.0, begin, theta)
    return inf


@compiled
def _note_loss(s, j, ending):
    """A loss of contact, and how far the error of the approach may move it: by its blur; the first
    one back to `grazed`, when the approach first came so near to zero.

    `grazed` is set to the time of the loss where the approach went straight through; to 0, so that
    the loss counts as moved by all of its time (`solve._undecided`), where the error may undo it.
    """
    lane = s.lane[j]
    rate, bow = _bend_of(s, lane.side * LANES + j, ending)
    lane.parted = lane.time + ending * s.h[j]
    lane.parted_blur = lane.faint * s.h[j] / -rate
    if not math.isnan(lane.lost):
        return
    lane.lost = lane.parted
    lane.blur = lane.parted_blur
    # how deep a gap opens before the approach turns, or the waves jump
    depth = -rate * ((lane.next_jump - lane.time) / s.h[j] - ending)
    if bow > 0.0:
        depth = min(depth, 0.5 * rate * rate / bow)
    if depth < lane.faint:
        lane.grazed = 0.0
    elif lane.lost - lane.grazed < 2.0 * lane.blur:
        lane.grazed = lane.lost


@compiled
def _note_graze(s, j, face, ending):
    """When the approach of a face first comes so near to zero, before any loss, that its error may
    decide on one.
    """
    lane = s.lane[j]
    if s.wanted & tracked.BY_LOSS and math.isnan(lane.lost) and math.isnan(lane.grazed):
        at = passage(s, j, face, lane.faint, -1.0, 0.0, ending)
        if at < inf:
            lane.grazed = lane.time + s.h[j] * at


@compiled
def _end_in_tail(s, j, ending):
    """theta at which a step ends between infinite bars once the pulse is over: where the record
    does, with both approaches below a share of the largest, if that comes first.
    """
    lane = s.lane[j]
    lane.record_level = tail_level(s, j)
    at = _both_below(s, j, lane.record_level, ending)
    if at <= ending:
        ending = at
        lane.ended_by = End.RECORD
        _end_sooner(s, j, ending)
    return ending


@compiled
def _both_below(s, j, level, ending):
    """First theta in [0, ending] at which both approaches lie below `level`, or inf."""
    if higher(s.floor, j) >= level:
        return inf
    at = 0.0
    for _ in range(8 * POINTS):
        before = at
        for face in range(2):
            at = passage(s, j, face, level, -1.0, at, ending)
            if at == inf:
                return at
        if at == before:
            return at
    return inf


@compiled
def _end_sooner(s, j, ending):
    """What `lanes.survey` says of a step, up to an event that ends it."""
    for i in range(POINTS + 1):
        for m in range(j, PAIR, LANES):
            s.at[i, m], s.rate[i, m] = rise_of(s.x, m, ending * i / POINTS)
    s.u_at_end[j] = value_of(s.u, j, ending)
    if not s.wanted & tracked.WANT_DURATION:
        return
    for m in range(j, PAIR, LANES):
        impulse = 0.0
        for k in range(ORDER, -1, -1):
            impulse = impulse * ending + s.force[k, m] * OF_POWERS[k]
        s.step_impulse[m] = impulse * ending


@compiled
def after_step(s, j):
    """Bring what is followed of a row up to date with its step; the share of the trial step at
    which it ends.

    Largest values come first, since the tail in which a record ends is a share of them; integrals
    last, when it is known where the step ends.

    lane.ended_by and lane.side receive what ends it.
    """
    lane = s.lane[j]
    _set_loss_level(s, j)
    ending = _first_event(s, j)
    if ending < s.theta[j]:
        _end_sooner(s, j, ending)
    _note_approaches(s, j, ending)
    _note_largest(s, j, ending)
    if not s.rigged and lane.record_end == inf and lane.time >= lane.pulse_end:
        ending = _end_in_tail(s, j, ending)
    if lane.ended_by == End.LOST:
        _note_loss(s, j, ending)
    if s.wanted & tracked.WANT_AFTER:
        _note_squared_forces(s, j, ending)
    if s.wanted & tracked.WANT_DURATION:
        _note_impulse(s, j, ending)
    return ending


@compiled
def _note_approaches(s, j, ending):
    """The largest approach of each face so far, and the force of the other face there."""
    lane = s.lane[j]
    for face in range(2):
        m = face * LANES + j
        place = -1.0
        if face_yielded(s, m):
            if s.spring[m] == 0.0:
                place = ending  # on virgin loading it is at its deepest at the end
        elif s.top[m] > lane.peak[face]:
            lane.peak[face], place = _deepest(s, j, m, ending, lane.peak[face])
        if not s.has_laws:  # faces that are alike share the largest approach so far
            lane.peak[1 - face] = lane.peak[face]
        # a face is pressed well above what is faint: above half of the errors that may add up
        if s.at[POINTS, m] > max(0.5 * ADDED_UP * s.error[j], 2.0 * s.requested) * s.size[m]:
            lane.was_pressed[face] = 1.0
        if place >= 0.0:
            lane.retouches_at_value = lane.retouches
            if s.rigged:
                lane.other[face] = max(value_of(s.force, (1 - face) * LANES + j, place), 0.0)
                lane.retouches_at_peak = lane.retouches


@compiled(inline=True)
def _note_largest(s, j, ending):
    """The largest values of functions of both faces so far."""
    lane = s.lane[j]
    for kind in range(DIFFERENCE, KINDS):
        if follows(s, kind) and _bound(s, j, kind) > lane.peak[kind]:
            before = lane.peak[kind]
            lane.peak[kind] = _highest(s, j, kind, ending, before)
            # a difference behind the last largest force does not count
            if kind > DIFFERENCE and lane.peak[kind] > before:
                lane.retouches_at_value = lane.retouches


@compiled
def follows(s, kind):
    """Whether the largest value of a function of both faces is wanted."""
    return s.wanted & (1 << (kind - 1)) != 0


@compiled
def _bound(s, j, kind):
    """What a function of both faces can reach at most in the step of a lane."""
    b = LANES + j
    top_a = (s.top[j], 0.0)
    top_b = (s.top[b], 0.0)
    if kind == DIFFERENCE:
        above, _ = _both(s, j, kind, top_a, (s.floor[b], 0.0))
        below, _ = _both(s, j, kind, (s.floor[j], 0.0), top_b)
        return max(above, -below)
    return _both(s, j, kind, top_a, top_b)[0]


@compiled
def _note_impulse(s, j, theta):
    """Add the integral of the mean force over a step.

    The series of the forces err as those of the approaches do, by a share of the largest one.
    While the impulse is less than a fiftieth of that it is summed over forces of the approaches, in
    z with t = z²: smooth from a touch on.
    """
    lane = s.lane[j]
    impulse = 0.5 * (s.step_impulse[j] + s.step_impulse[LANES + j])
    if lane.from_touch or 50.0 * lane.impulse < higher(s.size, j):
        impulse = 0.0
        for m in range(j, PAIR, LANES):
            for i in range(WAVE):
                x = value_of(s.x, m, theta * NODES[i] * NODES[i])
                force, _ = face_force(s, m, x)
                impulse += WEIGHTS[i] * NODES[i] * force
        impulse *= theta
    lane.impulse += impulse * s.h[j]


@compiled
def _note_squared_forces(s, j, theta):
    """Add the integrals of both squared forces over a step up to theta."""
    lane = s.lane[j]
    for face in range(2):
        total = 0.0
        for i in range(WAVE):
            force = value_of(s.force, face * LANES + j, theta * NODES[i])
            total += WEIGHTS[i] * force * force
        lane.carried[face] += total * theta * s.h[j]


@compiled
def first_at(s, j, past, level):
    """Time at which the larger approach of a row that is done first reaches `level`.

    Where faces have laws of their own `level` is a force: what approach that is follows from the
    branch of a step.
    """
    lane = s.lane[j]
    for n in range(lane.count):
        earlier = past[j, n]
        if earlier.crest < level:
            continue
        ending = earlier.holds / earlier.unit
        best = inf
        for face in range(2):
            m = face * LANES + j
            height = level
            spring = earlier.spring[face]
            if s.has_laws and spring > 0.0:
                height = (level / spring) ** (2.0 / 3.0)
            elif s.has_laws:
                height = approach_at(s, m, level) - earlier.dent[face]
            for k in range(TERMS):
                s.x[k, m] = earlier.path[face, k]
            best = min(best, passage(s, j, face, height, 1.0, 0.0, ending))
        if best < inf:
            return earlier.began + best * earlier.unit
    return nan

"""What happens inside the steps of a row: loss of contact, touch, threshold crossings, the end of
the record.

`look` says for all lanes in which steps anything can happen; only those are searched by
`after_step`, on the series of the step, so that an event is located far better than the steps are
long.  `finish` sums up a row whose record has ended.
"""

from __future__ import annotations

import math

import numpy as np

from uqsphere.mechanics.integrator import searches, tracked
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import (
    approach_at,
    face_force,
    face_yielded,
    largest_approach,
    largest_force,
    most_stored,
    on_virgin_loading,
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
    LINEAR,
    MEAN,
    ORDER,
    PAIR,
    POINTS,
    SHARE,
    TERMS,
    WAVE,
    End,
)
from uqsphere.mechanics.integrator.vectors import (
    apart,
    curves_at,
    elementwise,
    larger,
    part,
    root_of,
    row,
    size_of,
    smaller,
    values_at,
    where,
)


@compiled
def begin(s, j):
    """Nothing is known yet of the row of a lane."""
    apart()
    for kind in range(KINDS):
        s.peak[kind, j] = 0.0
    for face in range(2):
        s.touched[face, j], s.x_first[face, j], s.other[face, j], s.carried[face, j] = (
            0.0,
            0.0,
            0.0,
            0.0,
        )
    s.lost[j], s.ended[j], s.parted[j], s.duration[j] = math.nan, math.nan, math.nan, math.nan
    s.grazed[j], s.blur[j] = math.nan, 0.0
    s.unloadings[j], s.touches[j], s.chatter[j], s.impulse[j] = 0.0, 0.0, 0.0, 0.0
    s.counted[j], s.counted_peak[j] = 0.0, 0.0


@compiled
def _both_below(s, level, theta):
    """First theta in [0, theta] at which both approaches lie below `level`, or NaN."""
    apart()
    at = 0.0
    for _ in range(8 * POINTS):
        found = at
        for face in range(2):
            found = searches.passage(s, face, level, -1.0, found, theta)
            if math.isnan(found):
                return found
        if found == at:
            return found
        at = found
    return math.nan


@compiled
def _faces(s, j):
    """Loss of contact or touch of either face in a step: theta at which the step ends, and the face
    or -1.
    """
    apart()
    ends, met = s.theta[j], -1
    for face in range(2):
        start, rate = s.piece[0, face], s.piece[1, face]
        pressed = start > 0.0
        # a face that touches at the start, or is pressed and has not touched before, meets nothing
        if (pressed and s.touched[face, j] == 0.0) or (start == 0.0 and rate >= 0.0):
            continue
        level, sign = (s.near[j], -1.0) if pressed else (0.0, 1.0)
        if not searches.may_pass(s, face, sign, s.theta[j] / POINTS, level):
            continue
        if pressed:
            _note_graze(s, j, face, ends)
        # a face that left at the start of this step is clear of zero a little later
        clear = 1e-3 * ends if start == 0.0 and rate < 0.0 else 0.0
        found = searches.passage(s, face, 0.0, sign, clear, ends)
        if not math.isnan(found):
            ends, met = found, face
    if met >= 0 and s.piece[0, met] > 0.0 and math.isnan(s.lost[j]):
        s.lost[j] = s.time[j] + ends * s.h[j]
        _note_loss(s, j, met, ends)
    return ends, met


@compiled
def _note_loss(s, j, face, ends):
    """How far the error of the approach moves a loss of contact; whether it may undo it."""
    apart()
    rate, bow = searches.curve(s, face, True, ends)
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
    apart()
    if s.wanted & tracked.TO_THE_END and math.isnan(s.lost[j]) and math.isnan(s.grazed[j]):
        s.grazed[j] = s.time[j] + s.h[j] * searches.passage(s, face, s.faint[j], -1.0, 0.0, ends)


@compiled
def _largest(s, j, ends):
    """The largest values of a step into the trackers that the lane's flags name; s.places: where,
    see `after_step`.
    """
    apart()
    known = max(s.peak[FACE_A, j], s.peak[FACE_B, j])
    if s.flags[j] & (1 << FACE_A):
        for face in range(2):
            if s.has_laws and face_yielded(s, face * LANES + j):
                s.places[face] = -1.0
                continue
            # faces that are alike share the largest approach so far
            least, to = (s.peak[face, j], face) if s.has_laws else (known, 0)
            s.peak[to, j], s.places[face] = searches.largest(s, j, face, ends, least)
            known = max(known, s.peak[to, j])
    for kind in range(DIFFERENCE, KINDS):
        if s.flags[j] & (1 << kind):
            s.peak[kind, j] = searches.largest(s, j, kind, ends, s.peak[kind, j])[0]
    return known


@compiled
def after_step(s, j):
    """Bring the trackers that a lane's flags name up to date with its step; the theta at which it
    ends.

    s.why and s.side receive what ends it, if anything does.  s.places (2,) receive the theta of a
    face's largest approach so far, or -1: one that has yielded is at its deepest on virgin loading.
    """
    apart()
    searches.take_piece(s, j)
    ends, before, met = s.theta[j], s.time[j], -1
    if s.flags[j] & tracked.SOMETHING:
        ends, met = _faces(s, j)
        if met >= 0:
            s.why[j], s.side[j] = End.CONTACT, met
    if ends < s.theta[j]:
        searches.survey(s, ends)
    known = _largest(s, j, ends)
    least = max(50.0 * s.error[j], 2.0 * s.requested) * s.size[0, j]  # above it a face has touched
    for face in range(2):
        if s.grid[face, 0, POINTS] > least:
            s.touched[face, j] = 1.0
        if not heard(s, j, s.back[j]):
            s.x_first[face, j] = s.peak[face, j]
    if s.low[j] > 0.0:  # the record ends below a share of the largest approach
        found = _both_below(s, s.low[j] if s.by_law[j] else s.share * known, ends)
        if not math.isnan(found):
            ends, s.why[j] = found, End.RECORD
            if s.lost[j] > before + ends * s.h[j]:  # a loss after the record's end is none
                s.lost[j] = math.nan
    if ends < s.theta[j] and s.why[j] == End.BRANCH:
        s.why[j] = End.SERIES
    if s.why[j] == End.RECORD:
        s.ended[j] = before + ends * s.h[j]
    return ends


# --- What all lanes can have met in a step: the largest approach, and a warning where a search has
# to follow. Values and slopes at a few points of the step bound what the approaches reach between
# them.  The top of a bend is refined by Newton's iteration on the series, for all lanes together.
# An energy argument (`no_later_peak`) says when nothing that is wanted can change any more.


def _bounds(
    left, right, left_slope, right_slope, width, begin, best, top, second, place, bent, floor
):
    """One part of a step: what the approach can reach above and below, where, and by a bend or at
    an end.
    """
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
    """What the larger approach can reach; 1 where contact may be lost or found, or the record may
    end.
    """
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
_bound = elementwise(PAIR, 6, _bounds)
_refine = elementwise(PAIR, 1, _closer)
_crown = elementwise(LANES, 2, _crowned)
_sign = elementwise(LANES, 2, _signs)
# both forces, what they store, and the derivatives of both
_pressed = elementwise(
    PAIR,
    4,
    lambda x, rate, spring, linear: (
        (pressed := larger(x, 0.0)),
        (force := where(linear > 0.0, pressed, spring * pressed * (side := root_of(pressed)))),
        where(linear > 0.0, 0.5, 0.4 + 0.0 * x) * force * pressed,
        force * rate,
        where(x > 0.0, where(linear > 0.0, rate, 1.5 * spring * side * rate), 0.0),
    )[1:],
)


def _span(a, b, slope_a, slope_b, sign, width, reached, left, left_slope):
    """What |a + sign b| can reach between two points, and its value and slope at the later one."""
    right, right_slope = a + sign * b, width * (slope_a + sign * slope_b)
    share = 1.2 * left_slope * right_slope / (right_slope - left_slope)
    above, below = larger(left, right), 0.0 - smaller(left, right)
    above = where((left_slope > 0.0) & (right_slope < 0.0), above + share, above)
    below = where((left_slope < 0.0) & (right_slope > 0.0), below - share, below)
    return larger(reached, larger(above, below)), right, right_slope


_spanned = elementwise(LANES, 3, _span)
#: functions of both faces whose largest values are searched for
_SEARCHED = tracked.WANT_DIFFERENCE | tracked.WANT_ENERGY | tracked.WANT_SHARE | tracked.WANT_MEAN


@compiled
def _alarmed(s):
    """Flags of the steps that must be searched; whether an approach may be the largest of its row
    so far.
    """
    apart()
    higher = False
    for j in range(LANES):
        s.flags[j] = tracked.SOMETHING | 1 << FACE_A if s.alarm[j] > 0.0 else 0
        s.known[j] = s.peak[FACE_A, j]
        higher |= s.row[j] >= 0 and s.crest[j] > s.known[j]
        if s.has_laws:
            s.known[LANES + j] = s.peak[FACE_B, j]
            higher |= s.row[j] >= 0 and s.top[LANES + j] > s.known[LANES + j]
    return higher


@compiled
def look(s):
    """What may have happened in each lane's step, as flags, and the largest approach up to its end.

    s.known (PAIR,), s.crest (LANES,): largest approach of each face so far (of both where they are
    alike), and what it may have been in this step; s.top (PAIR,): bounds of the approaches;
    s.place, s.bent: where a bend lies.
    """
    apart()
    best, second, floor, width, value = (
        row(s.room, 0, 0),
        row(s.room, 2, 0),
        row(s.room, 5, 0),
        s.width,
        s.value,
    )
    slope, bend, place, bent, top = s.slope, s.bend, s.place, s.bent, s.top
    _begin(best, top, second, place, bent, floor, row(s.at, 0, 0))
    for i in range(POINTS):
        _bound(
            best,
            top,
            second,
            place,
            bent,
            floor,
            row(s.at, i, 0),
            row(s.at, i + 1, 0),
            row(s.rate, i, 0),
            row(s.rate, i + 1, 0),
            width,
            1.0 * i,
            best,
            top,
            second,
            place,
            bent,
            floor,
        )
    _sign(
        s.crest,
        s.alarm,
        part(top, 0),
        part(top, LANES),
        row(s.room, 5, 0),
        row(s.room, 5, LANES),
        row(s.at, 0, 0),
        row(s.at, 0, LANES),
        s.low,
        s.near,
        row(s.touched, 0, 0),
        row(s.touched, 1, 0),
    )
    if _alarmed(s):
        for k in range(3):
            for c in range(0, PAIR, LANES):
                curves_at(s.x, ORDER, PAIR, c, part(place, c), value, slope, bend)
            if k < 2:
                _refine(place, place, slope, bend, bent, width)
        for c in range(0, PAIR, LANES):
            face = part(s.known, c if s.has_laws else 0)
            _crown(
                face,
                s.alarm,
                face,
                row(s.room, 0, c),
                part(top, c),
                row(s.room, 2, c),
                part(value, c),
                part(slope, c),
                part(bend, c),
                part(bent, c),
            )
            for j in range(LANES):
                if s.alarm[j] > 0.0:
                    s.flags[j] |= 1 << FACE_A
    if s.wanted & _SEARCHED:
        _look_further(s)


@compiled
def _look_further(s):
    """Flags of the steps in which a function of both faces may be the largest so far."""
    apart()
    force, stored, power, rate = (
        row(s.room, 0, 0),
        row(s.room, 2, 0),
        row(s.room, 5, 0),
        row(s.room, 6, 0),
    )
    for kind in range(3):
        for j in range(LANES):
            s.reach[kind, j] = 0.0
    for i in range(POINTS + 1):
        _pressed(
            force,
            stored,
            power,
            rate,
            row(s.at, i, 0),
            row(s.rate, i, 0),
            s.spring,
            1.0 * (s.mode == LINEAR),
        )
        for j in range(LANES if s.has_laws else 0):
            if s.by_law[j] and on_virgin_loading(s, j):
                for m in range(j, PAIR, LANES):
                    found, slope = face_force(s, m, s.at[i, m])
                    s.room[0, m], s.room[6, m] = found, slope * s.rate[i, m]
        for kind in range(3):
            a, b = (2, 5) if kind == 1 else (0, 6)
            _spanned(
                row(s.reach, kind, 0),
                row(s.left, kind, 0),
                row(s.left_slope, kind, 0),
                row(s.room, a, 0),
                row(s.room, a, LANES),
                row(s.room, b, 0),
                row(s.room, b, LANES),
                -1.0 if kind == 0 else 1.0,
                s.width,
                row(s.reach, kind, 0),
                row(s.left, kind, 0),
                row(s.left_slope, kind, 0),
            )
        if i == 0:
            for kind in range(3):
                for j in range(LANES):
                    s.reach[kind, j] = 0.0
    for j in range(LANES):
        energy = most_stored(s, j) if s.by_law[j] else s.reach[1, j]
        if s.wanted & tracked.WANT_DIFFERENCE and s.reach[0, j] > s.peak[DIFFERENCE, j]:
            s.flags[j] |= 1 << DIFFERENCE
        if s.wanted & tracked.WANT_ENERGY and energy > s.peak[ENERGY, j]:
            s.flags[j] |= 1 << ENERGY
        if s.wanted & tracked.WANT_SHARE and most_stored(s, j) > s.peak[SHARE, j]:
            s.flags[j] |= 1 << SHARE
        if s.wanted & tracked.WANT_MEAN and 0.5 * s.reach[2, j] > s.peak[MEAN, j]:
            s.flags[j] |= 1 << MEAN


@compiled
def no_higher_approach(s, j):
    """Whether no approach can exceed the largest so far while the incoming wave stays as it is.

    With f = level and h = 0 for ever, V = phi(x_1) + phi(x_2) + mu (u - level)²/2 can only fall,
    where phi' = q(x) - level and phi = 0 at its smallest: V' = -(q(x_1) - level)² - (q(x_2) -
    level)².  No approach above the one at rest can be exceeded whose phi is not below V.  Faces
    with laws of their own are all springs now: what yields takes energy and brings none back.
    """
    apart()
    level, slack = s.steady[j], 1.0 + 0.1 * s.error[j]
    if level < 0.0:
        return False
    stored = 0.5 * s.mass[j] * (s.u[0, j] - level) ** 2
    least, rest, least_phi = math.inf, level, 0.5 * level * level
    for m in range(j, PAIR, LANES):
        spring, reached = s.spring[m], max(s.x[0, m], 0.0)
        if spring == 0.0:
            return False
        if level > 0.0 and s.mode != LINEAR:
            rest = (level / spring) ** (2.0 / 3.0)
            least_phi = 0.6 * level * rest
        top = (largest_approach(s, m) - s.dent[m] if s.has_laws else s.peak[FACE_A, j]) * slack
        if top < rest * slack:
            return False
        least = min(least, stored_energy(s, m, top)[0] - level * top + least_phi)
        stored += stored_energy(s, m, reached)[0] - level * reached + least_phi
    return not least < stored


#: mass number below which the sphere swings many times while the force dies out
_LIGHT = 0.02


@compiled
def _stays_pressed(s, j):
    """Whether no contact can be lost any more in the tail between infinite bars, whose impulse is
    then (x_1 + x_2)/2, (Q2).

    The difference of the approaches swings with the frequency sqrt(3 k sqrt(m)/mu) about their mean
    m.  While m falls its amplitude grows no faster than 1/m^(1/8), by a half until the record ends.
    """
    apart()
    b, low = LANES + j, s.low[j]
    least = min(s.x[0, j], s.x[0, b])
    if not (low > 0.0 and least > 0.0 and s.mass[j] < _LIGHT and s.spring[j] == s.spring[b]):
        return False
    stiffness = 1.0 if s.mode == LINEAR else 1.5 * s.spring[j] * math.sqrt(least)
    swing = (s.x[0, j] - s.x[0, b]) ** 2 + 2.0 * s.mass[j] * s.u[0, j] ** 2 / stiffness
    return 4.0 * swing < low * low


@compiled
def no_later_peak(s, j):
    """Whether no largest value that is wanted can change any more while the incoming wave stays as
    it is.
    """
    apart()
    wanted, slack = s.wanted, 1.0 + 0.1 * s.error[j]
    if wanted & tracked.WANT_CONTACT or (s.steady[j] > 0.0 and wanted & _SEARCHED):
        return False
    if wanted & tracked.WANT_DURATION and not _stays_pressed(s, j):
        return False
    if not no_higher_approach(s, j):
        return False
    if not wanted & _SEARCHED:
        return True
    energy, stiffest = 0.5 * s.mass[j] * s.u[0, j] ** 2, 0.0
    for m in range(j, PAIR, LANES):
        energy += stored_energy(s, m, max(s.x[0, m], 0.0))[0]
        stiffest = max(stiffest, s.spring[m])
    force = math.sqrt(2.0 * energy) if s.mode == LINEAR else stiffest**0.4 * (2.5 * energy) ** 0.6
    return not (
        (wanted & tracked.WANT_DIFFERENCE and force > s.peak[DIFFERENCE, j] * slack)
        or (wanted & tracked.WANT_MEAN and force > s.peak[MEAN, j] * slack)
        or (wanted & tracked.WANT_ENERGY and energy > s.peak[ENERGY, j] * slack)
        or (wanted & tracked.WANT_SHARE and energy > s.peak[SHARE, j] * slack)
    )


# --- Answers of a row whose record has ended: what was tracked, and the times at which thresholds
# were passed.


@compiled
def _first_at(s, j, made, level):
    """Time at which the larger approach first reaches `level`.

    Where faces have laws of their own `level` is a force: what approach that is follows from the
    branch of a step.
    """
    apart()
    virgin_a = approach_at(s, j, level) if s.has_laws else level
    virgin_b = approach_at(s, LANES + j, level) if s.has_laws else level
    for n in range(s.count[j]):
        kept = made[j, n]
        if kept.crest < level:
            continue
        end, best = min(kept.holds, s.ended[j] - kept.began) / kept.unit, math.nan
        for face in range(2):
            height = virgin_b if face == 1 else virgin_a
            if s.has_laws:
                spring = kept.spring[face]
                height = (
                    (level / spring) ** (2.0 / 3.0) if spring > 0.0 else height - kept.dent[face]
                )
            for k in range(TERMS):
                s.piece[k, face] = kept.path[face, k]
            found = searches.passage(s, face, height, 1.0, 0.0, end)
            if math.isnan(best) or found < best:
                best = found
        if not math.isnan(best):
            return kept.began + best * kept.unit
    return math.nan


#: Gauss points and weights of a step, exact to the power 23: further terms are below the tolerance
_NODES, _WEIGHTS = (
    0.5 * (array + shift)
    for array, shift in zip(np.polynomial.legendre.leggauss(WAVE), (1.0, 0.0), strict=True)
)


@compiled
def _read(s, series, m):
    """Values of a column of a series at the places s.work[0], to s.work[1]."""
    for k in range(TERMS):
        s.room[0, k] = series[k, m]
    values_at(row(s.room, 0, 0), ORDER, row(s.work, 0, 0), row(s.work, 1, 0))


_press = elementwise(
    WAVE, 1, lambda x, spring: spring * (pressed := larger(x, 0.0)) * root_of(pressed)
)


@compiled
def note_impulse(s, j, theta):
    """Add the integral of the mean force over a step.

    The series of the forces err as those of the approaches do, by a share of the largest one.
    While the impulse is less than a fiftieth of that it is summed over forces of the approaches, in
    z with t = z²: smooth from a touch on.
    """
    apart()
    impulse = 0.0
    if s.touching[j] > 0.0 or 50.0 * s.impulse[j] < max(s.size[0, j], s.size[2, j]):
        for i in range(WAVE):
            s.work[0, i] = theta * _NODES[i] * _NODES[i]
        for m in range(j, PAIR, LANES):
            _read(s, s.x, m)
            hertz = s.spring[m] > 0.0 and s.mode != LINEAR
            if hertz:
                _press(row(s.work, 1, 0), row(s.work, 1, 0), s.spring[m])
            for i in range(WAVE):
                force = s.work[1, i] if hertz else face_force(s, m, s.work[1, i])[0]
                impulse += _WEIGHTS[i] * _NODES[i] * force
    else:
        power = 0.5
        for k in range(TERMS):
            impulse += (s.force[k, j] + s.force[k, LANES + j]) * power / (k + 1.0)
            power *= theta
    s.impulse[j] += impulse * theta * s.h[j]


@compiled
def note_duration(s, j, settled):
    """Impulse over peak of the mean force up to now, (Q1), if that peak has grown since it was last
    noted: later contacts that press less do not count.

    settled: the waves are over, and what is still pressed dies out with the impulse that (Q2) says.
    """
    if s.wanted & tracked.WANT_DURATION and not s.peak[MEAN, j] <= s.counted_peak[j]:
        left = 0.5 * (s.x[0, j] + s.x[0, LANES + j]) if settled else 0.0
        s.duration[j] = (s.impulse[j] + left) / s.peak[MEAN, j]
        s.counted[j], s.counted_peak[j] = s.time[j], s.peak[MEAN, j]


@compiled
def finish(s, j, made, out):
    """Answers of a row that has ended, in scaled variables."""
    apart()
    lost, parted = not math.isnan(s.lost[j]), not math.isnan(s.parted[j])
    for face in range(2):
        # of faces that are alike the larger is followed
        of, other = (face, s.other[face, j]) if s.has_laws else (0, math.nan)
        out[tracked.ANSWER_FACES + face] = (
            largest_approach(s, face * LANES + j) if s.has_laws else s.peak[0, j]
        )
        out[tracked.ANSWER_FIRSTS + face], out[tracked.ANSWER_OTHERS + face] = (
            s.x_first[of, j],
            other,
        )
    out[tracked.ANSWER_UNLOADINGS], out[tracked.ANSWER_TOUCHES] = s.unloadings[j], s.chatter[j]
    out[tracked.ANSWER_X_MAX] = max(out[tracked.ANSWER_FACES], out[tracked.ANSWER_FACES + 1])
    out[tracked.ANSWER_X_FIRST] = max(s.x_first[0, j], s.x_first[1, j])
    out[tracked.ANSWER_END], out[tracked.ANSWER_DURATION] = s.ended[j], s.duration[j]
    out[tracked.ANSWER_COUNTED] = s.counted[j]
    out[tracked.ANSWER_CONTACT] = s.lost[j] if lost else s.ended[j]
    out[tracked.ANSWER_CONTACT_CENSORED] = 0.0 if lost else 1.0
    out[tracked.ANSWER_GRAZED], out[tracked.ANSWER_BLUR] = s.grazed[j], s.blur[j]
    out[tracked.ANSWER_PARTING] = s.parted[j] if parted else s.ended[j]
    for kind in range(DIFFERENCE, KINDS):
        if s.wanted & (1 << (kind - 1)):
            out[_ANSWER_OF[kind]] = s.peak[kind, j]
    if s.wanted & tracked.WANT_CARRIED:
        out[tracked.ANSWER_CARRIED], out[tracked.ANSWER_CARRIED + 1] = (
            s.carried[0, j],
            s.carried[1, j],
        )
    if s.wanted & tracked.WANT_RISE:
        top = largest_force(s, j) if s.has_laws else out[tracked.ANSWER_X_MAX]
        power = 1.0 if s.mode == LINEAR or s.has_laws else 2.0 / 3.0
        tenth, nine = (
            _first_at(s, j, made, top * 0.1**power),
            _first_at(s, j, made, top * 0.9**power),
        )
        out[tracked.ANSWER_RISE] = nine - tenth
    out[tracked.ANSWER_SPEED] = s.u[0, j]
    out[tracked.ANSWER_SPEEDS], out[tracked.ANSWER_SPEEDS + 1] = s.free[0, j], -s.free[0, LANES + j]


#: columns of the answers that largest values go to
_ANSWER_OF = (
    tracked.ANSWER_FACES,
    tracked.ANSWER_FACES + 1,
    tracked.ANSWER_DIFFERENCE,
    tracked.ANSWER_ENERGY,
    tracked.ANSWER_SHARE,
    tracked.ANSWER_MEAN,
)


# --- What is known of the faces of a row whose faces have laws of their own, and the end of a rig
# without bars.


@compiled
def note_peaks(s, j):
    """The force of the other face where a face's approach is the largest so far, at s.places; -1:
    it is not.
    """
    apart()
    for face in range(2):
        if s.places[face] >= 0.0:
            s.other[face, j] = max(
                searches.value_of(s.force, (1 - face) * LANES + j, s.places[face]), 0.0
            )
            s.chatter[j] = s.touches[j]


@compiled
def note_squared_forces(s, j, theta):
    """Add the integrals of both squared forces over a step up to theta."""
    apart()
    for i in range(WAVE):
        s.work[0, i] = theta * _NODES[i]
    for face in range(2):
        _read(s, s.force, face * LANES + j)
        total = 0.0
        for i in range(WAVE):
            total += _WEIGHTS[i] * s.work[1, i] * s.work[1, i]
        s.carried[face, j] += total * theta * s.h[j]


@compiled
def next_touch(s, j):
    """How long until a gap closes while no force acts: inf if both grow for ever, NaN while a face
    is pressed.
    """
    apart()
    closing = math.inf
    for face in range(2):
        m = face * LANES + j
        if s.x[0, m] > 0.0:
            return math.nan
        rate = s.there[m] * (s.free[0, m] + (2.0 * face - 1.0) * s.u[0, j])
        if rate > 0.0:
            closing = min(closing, -s.x[0, m] / rate)
    return closing

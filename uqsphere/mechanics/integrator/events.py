"""What happens inside the steps of a row: loss of contact, touch, threshold crossings, the end of the record.

`look` says for all lanes in which steps anything can happen; only those are searched by `after_step`, on the series of
the step, so that an event is located far better than the steps are long.  `finish` sums up a row whose record has
ended.  A piece is the part of a step's series that belongs to one lane, (2, TERMS), powers of theta; all quantities are
the scaled ones.
"""

from __future__ import annotations

import math

import numpy as np

from uqsphere.mechanics.integrator import searches, tracked
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import (
    approach_at,
    face_yielded,
    largest_approach,
    largest_force,
    most_stored,
    of_its_own,
)
from uqsphere.mechanics.integrator.tracked import INNER, LANES, ORDER, PAIR
from uqsphere.mechanics.integrator.vectors import (
    apart,
    curves_at,
    elementwise,
    larger,
    row,
    size_of,
    smaller,
    values_at,
    where,
)


@compiled(**INNER)
def begin(track, lane):
    """Reset the trackers of a lane."""
    apart()
    for k in range(tracked.TRACKS):
        track[k, lane] = 0.0
    track[tracked.LOST, lane] = math.nan
    track[tracked.ENDED, lane] = math.nan
    track[tracked.PARTED, lane] = math.nan
    track[tracked.DURATION, lane] = math.nan


@compiled(**INNER)
def _both_below(piece, level, theta):
    """First theta in [0, theta] at which both approaches lie below `level`, or NaN."""
    apart()
    at = 0.0
    for _ in range(8 * tracked.POINTS):
        found = at
        for face in range(2):
            found = searches.passage(piece, face, level, -1.0, found, theta)
            if math.isnan(found):
                return found
        if found == at:
            return found
        at = found
    return math.nan


@compiled(**INNER)
def _note_loss(track, lane, piece, lost, ends, before, h):
    """The first loss of contact of a row."""
    apart()
    if math.isnan(track[tracked.LOST, lane]):
        track[tracked.LOST, lane] = before + ends * h
        _, rate = searches.both(piece, lost, ends)
        track[tracked.LOSS_RATE, lane] = abs(rate) / h


@compiled(**INNER)
def _touching_just_now(track, lane, piece, face):
    """Whether a face touches at the start of a step, or is pressed and has not touched before: nothing to be met."""
    if piece[face, 0] > 0.0:
        return track[tracked.TOUCHED_A + face, lane] == 0.0
    return piece[face, 0] == 0.0 and piece[face, 1] >= 0.0


@compiled(**INNER)
def _faces(track, lane, piece, grid, theta, before, h, near):
    """Loss of contact or touch of either face in a step: theta at which the step ends, 2 + face or 0, and loss.

    near: approach above zero from which on a face is looked at.  The third result: the face that is lost, or -1.
    """
    apart()
    ends, why = theta, 0
    for face in range(2):
        pressed = piece[face, 0] > 0.0
        if _touching_just_now(track, lane, piece, face):
            continue
        level = near if pressed else 0.0
        if not searches.may_pass(grid, face, -1.0 if pressed else 1.0, theta / tracked.POINTS, level):
            continue
        # a face that left at the start of this step is clear of zero a little later
        clear = 1e-3 * ends if piece[face, 0] == 0.0 and piece[face, 1] < 0.0 else 0.0
        found = searches.passage(piece, face, 0.0, -1.0 if pressed else 1.0, clear, ends)
        if not math.isnan(found):
            ends, why = found, 2 + face
    if why > 1 and piece[why - 2, 0] > 0.0:
        _note_loss(track, lane, piece, why - 2, ends, before, h)
        return ends, why, why - 2
    return ends, why, -1


@compiled(**INNER)
def _largest(mode, flags, track, lane, piece, grid, places, ends, yielding, law):
    """The largest values of a step into the trackers that `flags` name; the largest approach so far."""
    apart()
    own = yielding and of_its_own(law, lane)
    known = max(track[tracked.FACE_A, lane], track[tracked.FACE_B, lane])
    if flags & (1 << tracked.FACE_A):
        for face in range(2):
            if yielding and face_yielded(law, face * LANES + lane):
                places[face] = -1.0
                continue
            # faces that are alike share the largest approach so far
            least = track[tracked.FACE_A + face, lane] if yielding else known
            found, places[face] = searches.largest_approach(face, mode, piece, ends, grid, least, own, law, lane)
            track[tracked.FACE_A + (face if yielding else 0), lane], known = found, max(known, found)
    for kind in range(tracked.DIFFERENCE, tracked.KINDS):
        if flags & (1 << kind):
            track[kind, lane], _ = searches.largest_of_both(
                kind, mode, piece, ends, grid, track[kind, lane], own, law, lane
            )
    return known


@compiled(**INNER)
def _note_touch(track, lane, grid, least, first):
    """Faces that have been pressed by more than `least`, and the largest approach of the first passage."""
    for face in range(2):
        if grid[face, 0, tracked.POINTS] > least:
            track[tracked.TOUCHED_A + face, lane] = 1.0
        if first:
            track[tracked.X_FIRST + face, lane] = track[tracked.FACE_A + face, lane]


@compiled(part=True, **INNER)
def after_step(
    mode, flags, track, lane, piece, grid, places, theta, before, h, echo, low, least, near, stop_at_loss, yielding,
    law,
):  # fmt: skip
    """Bring the trackers that `flags` name up to date with a step; the theta at which it ends, and what ends it.

    What ends the step: 0 nothing, 1 the record, 2 a face that lost contact or touched again while the motion goes on
    (face + 2).  `echo` is the time of the first reflected wave, `least` the approach above which a face has touched,
    `low` > 0 the share of the largest approach below which the record ends; near: see `_faces`.
    grid (face, 2, POINTS + 1): values and slopes over [0, theta]; room.  places (2,) receive the theta of a face's
    largest approach so far, or -1: one that has yielded is at its deepest on virgin loading.
    """
    apart()
    ends, why = theta, 0
    if flags & tracked.SOMETHING:
        ends, why, lost = _faces(track, lane, piece, grid, theta, before, h, near)
        if lost >= 0 and stop_at_loss:
            why = 1
    if ends < theta:
        searches.survey(piece, ends, grid)
    known = _largest(mode, flags, track, lane, piece, grid, places, ends, yielding, law)
    _note_touch(track, lane, grid, least, before < echo * (1.0 - 1e-12))
    if low > 0.0:
        found = _both_below(piece, low * known, ends)
        if not math.isnan(found):
            ends, why = found, 1
            if track[tracked.LOST, lane] > before + ends * h:  # a loss after the record's end is none
                track[tracked.LOST, lane] = math.nan
    if why == 1:
        track[tracked.ENDED, lane] = before + ends * h
    return ends, why


# --- What all lanes can have met in a step: the largest approach, and a warning where a search has to follow.
# Values and slopes at a few points of the step bound what the approaches reach between them.  The top of a bend is
# refined by Newton's iteration on the series, for all lanes together.  An energy argument (`decided`) says when
# nothing that is wanted can change any more.


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
_part = elementwise(LANES, 1, lambda theta: theta * (1.0 / tracked.POINTS))
_bound = elementwise(PAIR, 6, _bounds)
_refine = elementwise(PAIR, 1, _closer)
_crown = elementwise(LANES, 2, _crowned)
_sign = elementwise(LANES, 2, _signs)
#: functions of both faces whose largest values are searched for
_SEARCHED = tracked.WANT_DIFFERENCE | tracked.WANT_ENERGY | tracked.WANT_SHARE | tracked.WANT_MEAN
#: what the end of the record decides
_TO_THE_END = tracked.WANT_CONTACT | tracked.WANT_DURATION


@compiled(**INNER)
def _alarmed(track, live, flags, known, crest, room, yielding):
    """Flags of the steps that must be searched; whether an approach may be the largest of its row so far."""
    apart()
    higher = False
    for j in range(LANES):
        flags[j] = tracked.SOMETHING | 1 << tracked.FACE_A if room[10, j] > 0.0 else 0
        known[0, j] = track[tracked.FACE_A, j]
        higher |= live[j] >= 0 and crest[j] > known[0, j]
        if yielding:
            known[0, LANES + j] = track[tracked.FACE_B, j]
            higher |= live[j] >= 0 and room[1, LANES + j] > known[0, LANES + j]
    return higher


@compiled(part=True, **INNER)
def look(
    mode, wanted, x, at, rate, track, theta, low, near, live, flags, known, crest, room, yielding, law,
):  # fmt: skip
    """What may have happened in each lane's step, as flags, and the largest approach up to its end.

    at, rate (tracked.POINTS + 1, PAIR): values and derivatives (by theta) at equal distances over [0, theta].  low,
    near (LANES,): the record may end below the first; a contact may be lost below the second.  live (LANES,): rows in
    the lanes, -1 where there is none.  known (1, PAIR), crest (LANES,): largest approach of each face so far (of both
    where they are alike), and what it may have been in this step.  room (11, PAIR): working space, from whose rows 3
    and 4 the caller reads where a bend lies.
    """
    apart()
    best, top, second, place = row(room, 0, 0), row(room, 1, 0), row(room, 2, 0), row(room, 3, 0)
    bent, floor, width, value = row(room, 4, 0), row(room, 5, 0), row(room, 6, 0), row(room, 7, 0)
    slope, bend, alarm, doubt = row(room, 8, 0), row(room, 9, 0), row(room, 10, 0), row(room, 10, LANES)
    _begin(best, top, second, place, bent, floor, row(at, 0, 0))
    for c in range(0, PAIR, LANES):
        _part(row(room, 6, c), theta)
    for i in range(tracked.POINTS):
        _bound(best, top, second, place, bent, floor, row(at, i, 0), row(at, i + 1, 0), row(rate, i, 0),
               row(rate, i + 1, 0), width, 1.0 * i, best, top, second, place, bent, floor)  # fmt: skip
    _sign(crest, alarm, top, row(room, 1, LANES), floor, row(room, 5, LANES), row(at, 0, 0), row(at, 0, LANES), low,
          near, row(track, tracked.TOUCHED_A, 0), row(track, tracked.TOUCHED_B, 0))  # fmt: skip
    if _alarmed(track, live, flags, known, crest, room, yielding):
        for k in range(3):
            for c in range(0, PAIR, LANES):
                curves_at(x, ORDER, PAIR, c, row(room, 3, c), value, slope, bend)
            if k < 2:
                _refine(place, place, slope, bend, bent, width)
        for c in range(0, PAIR, LANES):
            face = row(known, 0, c if yielding else 0)
            _crown(face, doubt, face, row(room, 0, c), row(room, 1, c), row(room, 2, c), row(room, 7, c),
                   row(room, 8, c), row(room, 9, c), row(room, 4, c))  # fmt: skip
            for j in range(LANES):
                if room[10, LANES + j] > 0.0:
                    flags[j] |= 1 << tracked.FACE_A
    if wanted & _SEARCHED:
        _look_further(mode, wanted, at, rate, track, theta, flags, room, yielding, law)


@compiled(**INNER)
def _look_further(mode, wanted, at, rate, track, theta, flags, room, yielding, law):
    """Flags of the steps in which a function of both faces may be the largest so far."""
    apart()
    if wanted & tracked.WANT_DIFFERENCE:
        _look_for_difference(mode, at, rate, track, theta, flags, room, yielding, law)
    if wanted & tracked.WANT_ENERGY:
        _look_for_energy(mode, at, rate, track, theta, flags, room, yielding, law)
    if wanted & tracked.WANT_SHARE:
        for j in range(LANES):
            if most_stored(law, j, room[1]) > track[tracked.SHARE, j]:
                flags[j] |= 1 << tracked.SHARE
    if wanted & tracked.WANT_MEAN:
        _look_for_mean(mode, at, rate, track, theta, flags, room, yielding, law)


def _look_for(kind):
    """The function that does so for one function of both faces: as a constant its number costs no time."""

    @compiled(**INNER)
    def look_for(mode, at, rate, track, theta, flags, room, yielding, law):
        apart()
        for i in range(tracked.POINTS):
            for j in range(LANES):
                k = LANES + j
                width = theta[j] / tracked.POINTS
                left, left_slope = searches.combine(
                    kind, mode, at[i, j], at[i, k], width * rate[i, j], width * rate[i, k]
                )
                right, right_slope = searches.combine(
                    kind, mode, at[i + 1, j], at[i + 1, k], width * rate[i + 1, j], width * rate[i + 1, k]
                )
                above = searches.highest_between(left, left_slope, right, right_slope)
                below = searches.highest_between(-left, -left_slope, -right, -right_slope)
                if max(above, below) > track[kind, j]:
                    flags[j] |= 1 << kind
        for j in range(LANES):
            if yielding and of_its_own(law, j):
                flags[j] &= ~(1 << kind)
                if kind != tracked.ENERGY:
                    _look_at_forces(kind, at, rate, track, theta, flags, j, law)
                elif most_stored(law, j, room[1]) > track[kind, j]:
                    flags[j] |= 1 << kind

    return look_for


@compiled(**INNER)
def _look_at_forces(kind, at, rate, track, theta, flags, j, law):
    """The same of one lane whose faces have laws of their own."""
    apart()
    k, width, left, left_slope = LANES + j, theta[j] / tracked.POINTS, 0.0, 0.0
    for i in range(tracked.POINTS + 1):
        right, right_slope = searches.combine_own(
            kind, at[i, j], at[i, k], width * rate[i, j], width * rate[i, k], law, j
        )
        above = searches.highest_between(left, left_slope, right, right_slope)
        below = searches.highest_between(-left, -left_slope, -right, -right_slope)
        if i > 0 and max(above, below) > track[kind, j]:
            flags[j] |= 1 << kind
        left, left_slope = right, right_slope


_look_for_difference, _look_for_energy = _look_for(tracked.DIFFERENCE), _look_for(tracked.ENERGY)
_look_for_mean = _look_for(tracked.MEAN)


@compiled(**INNER)
def decided(mode, wanted, track, lane, a, b, w, mu, level, tolerance):
    """Whether nothing that is wanted can change any more while the incoming wave stays at `level`.

    With f = level and h = 0 for ever, V = phi(x_1) + phi(x_2) + mu (u - level)²/2 can only fall, where
    phi' = q(x) - level and phi = 0 at its smallest: V' = -(q(x_1) - level)² - (q(x_2) - level)².  No approach
    above the one at rest can be exceeded whose phi is not below V.
    """
    apart()
    if wanted & _TO_THE_END or (level > 0.0 and wanted & _SEARCHED):
        return False
    a, b = max(a, 0.0), max(b, 0.0)
    known = track[tracked.FACE_A, lane]
    if mode == 1:
        rest = level
        stored = 0.5 * ((a - rest) ** 2 + (b - rest) ** 2) + 0.5 * mu * (w - level) ** 2
        reach = rest + math.sqrt(2.0 * stored)
        force = reach - rest
        energy = 0.5 * (a * a + b * b) + 0.5 * mu * w * w
    else:
        energy = 0.4 * (a * a * math.sqrt(a) + b * b * math.sqrt(b)) + 0.5 * mu * w * w
        if level > 0.0:
            rest = level ** (2.0 / 3.0)
            stored = energy - level * (a + b) + 1.2 * level * rest + 0.5 * mu * (level * level - 2.0 * level * w)
            top = known * (1.0 + 0.1 * tolerance)
            return known >= rest and 0.4 * top**2.5 - level * top + 0.6 * level * rest >= stored
        reach = (2.5 * energy) ** 0.4
        force = reach * math.sqrt(reach)
    if reach > known * (1.0 + 0.1 * tolerance):
        return False
    if wanted & tracked.WANT_DIFFERENCE and force > track[tracked.DIFFERENCE, lane] * (1.0 + 0.1 * tolerance):
        return False
    if wanted & tracked.WANT_ENERGY and energy > track[tracked.ENERGY, lane] * (1.0 + 0.1 * tolerance):
        return False
    return not (wanted & tracked.WANT_MEAN and force > track[tracked.MEAN, lane] * (1.0 + 0.1 * tolerance))


@compiled(**INNER)
def _may_grow(wanted, track, lane, force, energy, slack):
    """Whether a function of both faces that is wanted may come to more than before, by the most force and energy."""
    apart()
    return (
        (wanted & tracked.WANT_DIFFERENCE and force > track[tracked.DIFFERENCE, lane] * slack)
        or (wanted & tracked.WANT_MEAN and force > track[tracked.MEAN, lane] * slack)
        or (wanted & tracked.WANT_ENERGY and energy > track[tracked.ENERGY, lane] * slack)
        or (wanted & tracked.WANT_SHARE and energy > track[tracked.SHARE, lane] * slack)
    )


@compiled(**INNER)
def decided_own(wanted, track, lane, x, w, mu, level, tolerance, law):
    """The same of faces with laws of their own, all springs now: what yields takes energy and brings none back."""
    apart()
    if wanted & _TO_THE_END or (level > 0.0 and wanted & _SEARCHED):
        return False
    slack = 1.0 + 0.1 * tolerance
    stored, energy, least, stiffest = 0.5 * mu * (w - level) ** 2, 0.5 * mu * w * w, math.inf, 0.0
    for face in range(2):
        m = face * LANES + lane
        spring, reached = law[tracked.SPRING, m], max(x[0, m], 0.0)
        if spring == 0.0:
            return False
        top = largest_approach(law, m, track[tracked.FACE_A + face, lane]) - law[tracked.DENT, m]
        rest, stiffest = (level / spring) ** (2.0 / 3.0), max(stiffest, spring)
        if top < rest:
            return False
        top *= slack
        least = min(least, 0.4 * spring * top**2.5 - level * top + 0.6 * level * rest)
        stored += 0.4 * spring * reached**2.5 - level * reached + 0.6 * level * rest
        energy += 0.4 * spring * reached**2.5
    if least < stored:
        return False
    force = stiffest**0.4 * (2.5 * energy) ** 0.6
    return not _may_grow(wanted, track, lane, force, energy, slack)


# --- Answers of a row whose record has ended: what was tracked, and the times at which thresholds were passed.

#: columns of the answers that largest values go to
_ANSWER_OF = (
    tracked.ANSWER_FACES, tracked.ANSWER_FACES + 1, tracked.ANSWER_DIFFERENCE, tracked.ANSWER_ENERGY,
    tracked.ANSWER_SHARE, tracked.ANSWER_MEAN,
)  # fmt: skip


@compiled(**INNER)
def _first_at(level, ended, path, branches, made, count, lane, yielding, law):
    """Time at which the larger approach first reaches `level`; arrays of one lane.

    Of faces with laws of their own `level` is a force: what approach that is follows from the branch of a step, its
    spring (0 on virgin loading) and dent, branches (steps, 2, 2).
    """
    apart()
    virgin_a = approach_at(law, lane, level) if yielding else level
    virgin_b = approach_at(law, LANES + lane, level) if yielding else level
    for n in range(count):
        if made[n, tracked.CREST] < level:
            continue
        began, unit = made[n, tracked.BEGAN], made[n, tracked.UNIT_OF]
        end, best = min(made[n, tracked.HOLDS], ended - began) / unit, math.nan
        for face in range(2):
            height = virgin_b if face == 1 else virgin_a
            if yielding:
                spring, dent = branches[n, face, 0], branches[n, face, 1]
                height = (level / spring) ** (2.0 / 3.0) if spring > 0.0 else height - dent
            found = searches.passage(path[n], face, height, 1.0, 0.0, end)
            if math.isnan(best) or found < best:
                best = found
        if not math.isnan(best):
            return began + best * unit
    return math.nan


@compiled(**INNER)
def _finish_faces(track, lane, out, yielding, law):
    """What is known of each face; larger approach and larger force of both, in units of the approach where alike."""
    apart()
    for face in range(2):
        m, known = face * LANES + lane, track[tracked.FACE_A + face, lane]
        out[tracked.ANSWER_FACES + face] = largest_approach(law, m, known) if yielding else known
        out[tracked.ANSWER_FIRSTS + face] = track[tracked.X_FIRST + face, lane]
        if yielding:
            out[tracked.ANSWER_OTHERS + face] = track[tracked.OTHER + face, lane]
        else:  # of faces that are alike the larger is followed
            out[tracked.ANSWER_FACES + face] = track[tracked.FACE_A, lane]
            out[tracked.ANSWER_FIRSTS + face] = track[tracked.X_FIRST, lane]
    out[tracked.ANSWER_UNLOADINGS], out[tracked.ANSWER_TOUCHES] = track[tracked.UNLOADINGS, lane], 0.0
    out[tracked.ANSWER_X_MAX] = max(out[tracked.ANSWER_FACES], out[tracked.ANSWER_FACES + 1])
    out[tracked.ANSWER_X_FIRST] = max(track[tracked.X_FIRST, lane], track[tracked.X_FIRST + 1, lane])
    if yielding:
        out[tracked.ANSWER_TOUCHES] = track[tracked.CHATTER, lane]
        return largest_force(law, lane, track[tracked.FACE_A, lane], track[tracked.FACE_B, lane])
    return out[tracked.ANSWER_X_MAX]


@compiled(**INNER)
def note_duration(track, lane, x, law, yielding, settled):
    """Impulse over peak of the mean force up to now: adding (3), I = integral of (f - h) less the mean approach.

    x (TERMS, PAIR): approaches now above their dents; settled: what is still pressed dies out and counts, dents stay.
    """
    apart()
    impulse = 0.5 * track[tracked.PUSHED, lane]
    for m in range(lane, PAIR, LANES):
        impulse -= 0.5 * ((0.0 if settled else x[0, m]) + (law[tracked.DENT, m] if yielding else 0.0))
    track[tracked.DURATION, lane] = impulse / track[tracked.MEAN, lane]


@compiled(**INNER)
def note_momentum(track, lane, u, free, rig, mass, speed, rigs):
    """The same of any other rig from the speeds, (R9): what A has given and the sphere has not kept went to B."""
    apart()
    given = 0.0
    if rig[tracked.RIG_LIGHTNESS, lane] > 0.0:
        given = (rigs[tracked.RIG_SPEED, 0] - free[0, lane]) / rig[tracked.RIG_LIGHTNESS, lane]
    impulse = given - 0.5 * mass * (u[0, lane] - speed)
    track[tracked.DURATION, lane] = impulse / track[tracked.MEAN, lane]


@compiled(part=True, **INNER)
def finish(mode, wanted, track, lane, path, branches, made, count, out, yielding, law):
    """Answers of a row that has ended, in scaled variables; path, branches and what was made of its lane's steps."""
    apart()
    ended = track[tracked.ENDED, lane]
    power = 1.0 if mode == 1 or yielding else 2.0 / 3.0
    top = _finish_faces(track, lane, out, yielding, law)
    out[tracked.ANSWER_END] = ended
    lost = not math.isnan(track[tracked.LOST, lane])
    out[tracked.ANSWER_CONTACT] = track[tracked.LOST, lane] if lost else ended
    out[tracked.ANSWER_CONTACT_CENSORED] = 0.0 if lost else 1.0
    out[tracked.ANSWER_LOSS_RATE] = track[tracked.LOSS_RATE, lane] if lost else math.nan
    parted = not math.isnan(track[tracked.PARTED, lane])
    out[tracked.ANSWER_PARTING] = track[tracked.PARTED, lane] if parted else ended
    out[tracked.ANSWER_DURATION] = track[tracked.DURATION, lane]
    for kind in range(tracked.DIFFERENCE, tracked.KINDS):
        if wanted & (1 << (kind - 1)):
            out[_ANSWER_OF[kind]] = track[kind, lane]
    if wanted & tracked.WANT_CARRIED:
        for face in range(2):
            out[tracked.ANSWER_CARRIED + face] = track[tracked.CARRIED + face, lane]
    if wanted & tracked.WANT_RISE:
        tenth = _first_at(top * 0.1**power, ended, path, branches, made, count, lane, yielding, law)
        nine = _first_at(top * 0.9**power, ended, path, branches, made, count, lane, yielding, law)
        out[tracked.ANSWER_RISE] = nine - tenth


# --- What is known of the faces of a row whose faces have laws of their own, and the end of a rig without bars.


@compiled(**INNER)
def note_peaks(track, lane, force, places):
    """The force of the other face where a face's approach is the largest so far, at `places`; -1: it is not."""
    apart()
    for face in range(2):
        if places[face] >= 0.0:
            track[tracked.OTHER + face, lane] = max(
                searches.value_of(force, (1 - face) * LANES + lane, places[face]), 0.0
            )
            track[tracked.CHATTER, lane] = track[tracked.TOUCHES, lane]


#: Gauss points of a step: exact to the power 23 of the squared force, whose further terms are below the tolerance
_NODES, _WEIGHTS = (array.copy() for array in np.polynomial.legendre.leggauss(12))


@compiled(**INNER)
def note_carried(track, lane, force, length, theta, work):
    """Add the integrals of both squared forces over a step up to theta; work (3, TERMS): room."""
    apart()
    places, values, series = row(work, 0, 0), row(work, 1, 0), row(work, 2, 0)
    for i in range(12):
        work[0, i] = 0.5 * theta * (1.0 + _NODES[i])
    for face in range(2):
        for k in range(tracked.TERMS):
            work[2, k] = force[k, face * LANES + lane]
        values_at(series, ORDER, places, values)
        total = 0.0
        for i in range(12):
            total += _WEIGHTS[i] * work[1, i] * work[1, i]
        track[tracked.CARRIED + face, lane] += 0.5 * total * theta * length


@compiled(**INNER)
def next_touch(lane, x, u, free, rig):
    """How long until a gap closes while no force acts: inf if both grow for ever, NaN while a face is pressed."""
    apart()
    closing = math.inf
    for face in range(2):
        m = face * LANES + lane
        if x[0, m] > 0.0:
            return math.nan
        rate = rig[tracked.RIG_THERE, m] * (free[0, m] + (2.0 * face - 1.0) * u[0, lane])
        if rate > 0.0:
            closing = min(closing, -x[0, m] / rate)
    return closing

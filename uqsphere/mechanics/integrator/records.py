"""When a record ends, and what a row comes to whose record has ended.

`status_of_record` is asked behind each step.  A record ends

    of infinite bars  once the pulse is over, when both forces first are below a share of the
                      largest, unless a horizon is set (`events._end_in_tail`)
    of a rig          when every gap is open and none can close again (`flights.fly_on`)
    of bars           at a loss of contact behind which no approach can be higher, or the faces can
                      squeeze the sphere no harder, unless the whole record is asked for
                      (`no_higher_approach`, `no_harder_squeeze`)
    of any row        at `Scene.record_end`, where a rig that is still pressed has no answer; or
                      as soon as no largest value that is wanted can grow, and nothing else that
                      is wanted can change (`no_later_peak`)

For the last reason, and for `no_higher_approach`, the waves have to be steady: of bars once the
pulse is over where no echo comes back; of a rig where no far end has R < 0.

The record of two bars ends at the first loss of contact after which the faces can no longer squeeze
the sphere harder than they have.  With s = (x_A + x_B)/2 the sphere's motion drops out of (9),

    s' = (f - h) - (q_A + q_B)/2 <= (f - h) - k s^(3/2),

since x^(3/2) is convex; k is the softer face's.  Where no far end has R < 0, contact only takes
from the waves: those under way, sent round without any contact, bound all later ones.  While both
faces press, neither approach exceeds 2 s, and no force k_i (2 s)^(3/2).  Faces that have yielded
are springs up to their largest force so far, so that the bound holds below it.

A loss of one face ends no record either while the sphere's own speed may still press the other one
harder than before.  Later blows of the loose sphere, which an echo throws against one end, are no
squeeze between two: they are not bounded, and a run looks for them apart (`solve.later_loading`).
Scaled variables.
"""

from __future__ import annotations

import math
from math import inf

from . import tracked
from .compiled import compiled
from .events import first_at, follows, highest_between, rise_of
from .faces import is_pressed, largest_approach, largest_force, stored_energy
from .flights import closing_rate, rate_error
from .incoming import step_end
from .tracked import (
    CELLS,
    DIFFERENCE,
    ENERGY,
    FACE_A,
    FACE_B,
    GOES_ON,
    KINDS,
    LANES,
    LINEAR,
    MASSLESS,
    MEAN,
    OK,
    PAIR,
    SPHERE_ENERGY,
    STILL_PRESSED,
    End,
)

#: parts of a step of which a wave is bounded one by one
_PARTS = 2
#: cells of all round trips that are followed at most: cells of each bar are as wide as that needs
_MOST_CELLS = 16 * CELLS
#: mass number below which the sphere swings many times while the force dies out
_LIGHT = 0.02


@compiled
def _bound_waves(s, j, bar, past):
    """Bounds of the wave that a bar sends back during the next round trip, in cells of time.

    s.cell_end, s.cell_wave (2, CELLS): when each cell ends, and the wave in it at most.  Returns
    how many there are.  Parts of short steps have a cell in common, as wide as the room asks for:
    how many steps the tolerance takes must not decide whether a record ends.
    """
    lane = s.lane[j]
    trip = lane.trips[bar]
    least = max(trip / (CELLS - 2.0), 2.0 * (lane.record_end - lane.time) / _MOST_CELLS)
    count = 0
    start = lane.time
    begin = lane.time - trip
    if begin < 0.0:  # nothing has left the face before first touch
        s.cell_end[bar, 0] = trip
        s.cell_wave[bar, 0] = 0.0
        begin = 0.0
        count = 1
    n = max(lane.first[bar], 0)
    while n < lane.count - 1 and step_end(s, j, past, n) <= begin:
        n += 1
    for step in range(n, lane.count):
        earlier = past[j, step & (s.ring - 1)]
        if earlier.began + trip >= lane.record_end:
            break
        first = max(begin - earlier.began, 0.0) / earlier.unit
        last = earlier.holds / earlier.unit
        width = (last - first) / _PARTS
        left, left_slope = rise_of(earlier.wave, bar, first)
        for part in range(1, _PARTS + 1):
            theta = first + part * width
            right, right_slope = rise_of(earlier.wave, bar, theta)
            top = highest_between(left, width * left_slope, right, width * right_slope)
            end = earlier.began + earlier.unit * theta + trip
            if count > 0 and s.cell_end[bar, count - 1] < start + least:
                count -= 1
                top = max(top, s.cell_wave[bar, count])
            elif count > 0:
                start = s.cell_end[bar, count - 1]
            s.cell_wave[bar, count] = top
            s.cell_end[bar, count] = end
            left = right
            left_slope = right_slope
            count += 1
    return count


@compiled
def _after(s, squeeze, drive, stiffness, length):
    """s after a time under a wave, at most, by two tangents of k s^(3/2), which lie below it.

    The tangent at s is close at first, the one at the state of rest for long times.
    """
    if squeeze < 0.0:
        if drive * length <= -squeeze:
            return squeeze + drive * length
        length += squeeze / drive
        squeeze = 0.0
    if s.mode == LINEAR:
        return drive + (squeeze - drive) * math.exp(-length)
    side = stiffness * math.sqrt(squeeze)
    rate = 1.5 * side
    decay = length
    if rate * length > 1e-9:
        decay = -math.expm1(-rate * length) / rate
    after = squeeze + (drive - side * squeeze) * decay
    if drive > 0.0:
        rest = (drive / stiffness) ** (2.0 / 3.0)
        rate = 1.5 * stiffness * math.sqrt(rest)
        after = min(after, rest + (squeeze - rest) * math.exp(-rate * length))
    return after


@compiled
def _largest_squeeze(s, j):
    """s at which a face may reach the largest force of the row so far, and the softer stiffness.

    0 where a face is yielding now.
    """
    lane = s.lane[j]
    soft = 1.0
    largest = max(lane.peak[FACE_A], lane.peak[FACE_B])
    if s.has_laws:
        force = largest_force(s, j)
        soft = inf
        stiff = 0.0
        for m in range(j, PAIR, LANES):
            force = min(force, s.peak_force[m])
            soft = min(soft, s.spring[m])
            stiff = max(stiff, s.spring[m])
        largest = (force / stiff) ** (2.0 / 3.0)
        if soft == 0.0:
            return 0.0, 1.0
    if s.mode != MASSLESS:
        largest *= 0.5
    return largest, soft


@compiled
def _approach_after_loss(s, j, theta):
    """Approach that the sphere's own speed gives one face where the step ended, at theta, with the
    loss of the other; 0 if that falls already.
    """
    lane = s.lane[j]
    m = (1 - lane.side) * LANES + j
    x = s.x[0, m]
    _, slope = rise_of(s.x, m, theta)
    if s.spring[m] == 0.0 or x <= 0.0 or slope <= 0.0:
        return 0.0
    rate = slope / s.h[j]
    energy = lane.mass * rate * rate
    if s.mode == LINEAR:
        return math.sqrt(x * x + energy)
    return (x * x * math.sqrt(x) + 1.25 * energy / s.spring[m]) ** 0.4


@compiled
def no_harder_squeeze(s, j, theta, past):
    """Whether the faces of two bars can no longer squeeze the sphere harder than they have, at a
    loss of contact.

    theta: at which the step ended.  False where it cannot be told: while
    the pulse comes in, a face yields, or a far end has R < 0.
    """
    lane = s.lane[j]
    largest, stiffness = _largest_squeeze(s, j)
    squeeze = 0.5 * (s.x[0, j] + s.x[0, LANES + j])
    if lane.time < lane.pulse_end or squeeze > largest:
        return False
    if _approach_after_loss(s, j, theta) > 2.0 * largest:
        return False
    highest = 0.0
    for bar in range(2):
        s.cells[bar] = 0
        if lane.trips[bar] < inf:
            if lane.reflect[bar] < 0.0:
                return False
            s.cells[bar] = _bound_waves(s, j, bar, past)
        top = 0.0
        for i in range(s.cells[bar]):
            top = max(top, s.cell_wave[bar, i])
        highest += lane.reflect[bar] * top
    rest = highest
    if s.mode != LINEAR:
        rest = (highest / stiffness) ** (2.0 / 3.0)
    if rest <= largest or s.cells[0] + s.cells[1] == 0:
        return True
    return _stays_below(s, j, squeeze, largest, stiffness)


@compiled
def _stays_below(s, j, squeeze, largest, stiffness):
    """Whether s stays below `largest` up to the latest end of the record under the bounds of the
    waves."""
    lane = s.lane[j]
    time = lane.time
    at_start = squeeze
    # whether the same waves come again: no end takes from them, and both send them at once
    alike = s.cells[0] == 0 or s.cells[1] == 0
    alike = alike or abs(lane.trips[0] - lane.trips[1]) < 1e-9 * lane.trips[0]
    for bar in range(2):
        s.cell[bar] = 0
        s.cell_shift[bar] = 0.0
        s.cell_weight[bar] = lane.reflect[bar]
        alike = alike and (s.cells[bar] == 0 or lane.reflect[bar] == 1.0)
    for _ in range(_MOST_CELLS):
        until = lane.record_end
        drive = 0.0
        for bar in range(2):
            if s.cells[bar] > 0:
                until = min(until, s.cell_end[bar, s.cell[bar]] + s.cell_shift[bar])
                drive += s.cell_weight[bar] * s.cell_wave[bar, s.cell[bar]]
        if until > time:
            squeeze = _after(s, squeeze, drive, stiffness, until - time)
            time = until
        if squeeze > largest:
            return False
        if time >= lane.record_end:
            return True
        wrapped = False
        for bar in range(2):
            if s.cells[bar] == 0 or s.cell_end[bar, s.cell[bar]] + s.cell_shift[bar] > time:
                continue
            s.cell[bar] += 1
            if s.cell[bar] == s.cells[bar]:
                s.cell[bar] = 0
                s.cell_shift[bar] += lane.trips[bar]
                s.cell_weight[bar] *= lane.reflect[bar]
                wrapped = True
        if wrapped and alike and s.cell[0] == 0 and s.cell[1] == 0:
            if squeeze <= at_start:  # the same waves come again, to a looser sphere
                return True
            at_start = squeeze
    return False


@compiled
def _energy_left(s, j, level):
    """Energy of the faces and bodies of a row that may still press, of the sphere relative to a
    speed.

    s.presses: which faces may.  A body that has left presses no more once it moves away faster than
    all energy of the others could send the sphere after it.
    """
    mass = s.lane[j].mass
    energy = 0.5 * mass * (s.u[0, j] - level) ** 2
    for m in range(j, PAIR, LANES):
        s.presses[m] = s.there[m]
        energy += stored_energy(s, m, max(s.x[0, m], 0.0))[0]
        if s.lightness[m] > 0.0:
            energy += 0.5 * s.free[0, m] ** 2 / s.lightness[m]
    for m in range(j, PAIR, LANES):
        speed = s.free[0, m]
        if s.lightness[m] > 0.0 and s.x[0, m] <= 0.0 and speed < 0.0:
            others = energy - 0.5 * speed * speed / s.lightness[m]
            if mass * speed * speed > 2.0 * others:
                s.presses[m] = 0.0
                energy = others
    return energy


@compiled
def no_higher_approach(s, j):
    """Whether no approach can exceed the largest so far while the incoming wave stays as it is.

    With f = level and h = 0 for ever, V = phi(x_1) + phi(x_2) + mu (u - level)²/2 can only fall,
    where phi' = q(x) - level and phi = 0 at its smallest: V' = -(q(x_1) - level)² - (q(x_2) -
    level)².  No approach above the one at rest can be exceeded whose phi is not below V.  Faces
    with laws of their own are all springs now: what yields takes energy and brings none back.
    In other rigs level is 0, and V the energy of all bodies: V' = -(zeta q + 2 h) q at a rod, where
    h >= 0 if R >= 0, since its echoes then only pull its end away; this holds while faces are
    pressed, too.
    """
    lane = s.lane[j]
    level = lane.steady_level
    slack = 1.0 + 0.1 * s.error[j]
    if s.rigged and min(lane.reflect[0], lane.reflect[1]) >= 0.0:
        level = 0.0
    if level == tracked.CHANGING:
        return False
    stored = _energy_left(s, j, level)
    least = inf
    rest = level
    least_phi = 0.5 * level * level
    for m in range(j, PAIR, LANES):
        if s.presses[m] == 0.0:
            continue
        spring = s.spring[m]
        if spring == 0.0:
            return False
        if level > 0.0 and s.mode != LINEAR:
            rest = (level / spring) ** (2.0 / 3.0)
            least_phi = 0.6 * level * rest
        top = slack * (largest_approach(s, m) - s.dent[m])
        if top < rest * slack:
            return False
        least = min(least, stored_energy(s, m, top)[0] - level * top + least_phi)
        stored += least_phi - level * max(s.x[0, m], 0.0)
    return not least < stored


@compiled
def _stays_pressed(s, j):
    """Whether no contact can be lost any more in the tail between infinite bars, whose impulse is
    then (x_1 + x_2)/2, (Q2).

    The difference of the approaches swings with the frequency sqrt(3 k sqrt(m)/mu) about their mean
    m.  Its energy over its frequency stays (an adiabatic invariant): the amplitude grows as
    1/m^(1/8), by a half until m has fallen to where the record ends.
    """
    lane = s.lane[j]
    b = LANES + j
    low = lane.record_level
    least = min(s.x[0, j], s.x[0, LANES + j])
    if not (low > 0.0 and least > 0.0 and lane.mass < _LIGHT and s.spring[j] == s.spring[b]):
        return False
    stiffness = 1.0
    if s.mode != LINEAR:
        stiffness = 1.5 * s.spring[j] * math.sqrt(least)
    swing = (s.x[0, j] - s.x[0, b]) ** 2 + 2.0 * lane.mass * s.u[0, j] ** 2 / stiffness
    return 4.0 * swing < low * low


@compiled
def no_later_peak(s, j):
    """Whether no largest value that is wanted can change any more while the incoming wave stays as
    it is, and nothing else is wanted that may.
    """
    lane = s.lane[j]
    wanted = s.wanted
    slack = 1.0 + 0.1 * s.error[j]
    if wanted & tracked.WANT_CONTACT or (lane.steady_level > 0.0 and wanted & tracked.OF_BOTH):
        return False
    if s.rigged and wanted & (tracked.WANT_DURATION | tracked.WANT_AFTER):
        return False
    if wanted & tracked.WANT_DURATION and not _stays_pressed(s, j):
        return False
    if not no_higher_approach(s, j):
        return False
    energy = _energy_left(s, j, 0.0)
    stiffest = 0.0
    for m in range(j, PAIR, LANES):
        stiffest = max(stiffest, s.spring[m])
    force = math.sqrt(2.0 * energy)
    if s.mode != LINEAR:
        force = stiffest**0.4 * (2.5 * energy) ** 0.6
    for kind in range(DIFFERENCE, KINDS):
        reached = force
        if kind in (ENERGY, SPHERE_ENERGY):
            reached = energy
        if follows(s, kind) and reached > lane.peak[kind] * slack:
            return False
    return True


@compiled
def status_of_record(s, j, ending, past, ahead):
    """Status with which a record ends where its step has ended, or `GOES_ON`.

    ending: share of the trial step.  ahead: `flights.fly_on`, NaN while a face is pressed.
    """
    lane = s.lane[j]
    if lane.ended_by == End.RECORD or ahead == inf:
        return OK
    if lane.ended_by == End.LOST and s.stop_at_loss:
        note_loading(s, j, 0.0)
        if no_higher_approach(s, j) or no_harder_squeeze(s, j, ending, past):
            return OK
    if lane.time >= lane.record_end:
        if s.rigged and is_pressed(s, j):
            return STILL_PRESSED
        return OK
    if not lane.from_touch and no_later_peak(s, j):
        return OK
    return GOES_ON


@compiled
def note_loading(s, j, left):
    """What counts up to the first loss of contact after a peak, if that has grown since it was last
    noted: impulse over peak of the mean force, (Q1); the largest difference of the forces, by their
    peak.  Later contacts that press less do not count, however long the record goes on for them.

    So it is noted at the losses of bars whose record may end at one.  Otherwise (in a rig, or where
    the record has to be whole) it is noted once, at the end of the record, and all contacts count.

    left: the impulse by which what is still pressed dies out once the waves are over, (Q2).
    """
    lane = s.lane[j]
    if s.wanted & tracked.WANT_DURATION and not lane.peak[MEAN] <= lane.counted_peak:
        lane.duration = (lane.impulse + left) / lane.peak[MEAN]
        lane.counted = lane.time
        lane.counted_peak = lane.peak[MEAN]
    force = largest_force(s, j)
    if force > lane.counted_force:
        lane.difference = lane.peak[DIFFERENCE]
        lane.counted_force = force


@compiled
def finish(s, j, past, out):
    """Answers of a row that has ended, in scaled variables."""
    lane = s.lane[j]
    # the tail between infinite bars, in which both faces are pressed, belongs to the record
    left = 0.0
    if not s.rigged and lane.record_end == inf and min(s.x[0, j], s.x[0, LANES + j]) > 0.0:
        left = 0.5 * (s.x[0, j] + s.x[0, LANES + j])
    note_loading(s, j, left)
    ended = step_end(s, j, past, lane.count - 1)
    out.steps = lane.count
    for face in range(2):
        m = face * LANES + j
        out.x[face] = largest_approach(s, m)
        out.x_first[face] = lane.x_first[face]
        if s.has_laws:
            out.other[face] = lane.other[face]
        if s.wanted & tracked.WANT_AFTER:
            out.carried[face] = lane.carried[face]
        out.end_speed[face] = s.side_sign[m] * s.free[0, m]
    out.sphere_speed = s.u[0, j]
    if s.wanted & tracked.WANT_DIFFERENCE:
        out.difference = lane.difference
    if s.wanted & tracked.WANT_MEAN:
        out.mean_force = lane.peak[MEAN]
    if s.wanted & tracked.WANT_ENERGY:
        out.stored = lane.peak[ENERGY]
    if s.wanted & tracked.WANT_SPHERE_ENERGY:
        out.stored_sphere = lane.peak[SPHERE_ENERGY]
    out.duration = lane.duration
    out.counted = lane.counted
    out.contact = ended
    out.contact_censored = 1.0
    if not math.isnan(lane.lost):
        out.contact = lane.lost
        out.contact_censored = 0.0
    out.blur = lane.blur
    out.grazed = lane.grazed
    out.parting = ended
    if not math.isnan(lane.parted):
        out.parting = lane.parted
    out.parting_blur = lane.parted_blur
    for face in range(2):
        if s.rigged and abs(closing_rate(s, j, face)) < rate_error(s, j, face):
            out.parting_blur = inf
    if s.wanted & tracked.WANT_RISE:
        top = max(out.x[0], out.x[1])
        power = 2.0 / 3.0
        if s.has_laws:
            top = largest_force(s, j)
        if s.has_laws or s.mode == LINEAR:
            power = 1.0
        tenth = first_at(s, j, past, top * 0.1**power)
        out.rise = first_at(s, j, past, top * 0.9**power) - tenth
    out.ended = ended
    out.unloadings = lane.unloadings
    out.touches = lane.retouches_at_peak
    out.regained = lane.retouches_at_value
    if s.rigged:
        out.regained = lane.retouches

"""The compiled batch integrator of the equations of motion, in the scaled variables of theory (9).

Rows advance in lanes: every lane has its own time and step, all lanes expand their motion into a
power series together, and a lane whose row has ended takes the next one.  A row's answer depends on
nothing but the row, so that any slice, order or number of threads gives the same bits.

A step never crosses a jump of the pulse or of one of its reflections, is never longer than a round
trip, and ends where a face leaves or touches.  One round of `march` takes every lane one step:

    enter    idle lanes take the next rows
    waves    how long the step may be, and what runs towards the sphere in it, theory (4) and (5)
    expand   the motion as a power series, theory (9) or (R3); how far it holds
    meet     where in the step a face may leave, touch, yield or be pressed deepest
    turn     a step that does not hold is tried again, shorter; of one that holds the end, what is
    kept and the next
             state; a row that is decided leaves its lane
"""

from __future__ import annotations

import math
from typing import NamedTuple

from uqsphere.arrays import Array
from uqsphere.mechanics.integrator import events, incoming, records, step, tracked
from uqsphere.mechanics.integrator.branches import branch_ends
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import (
    MOST_TURNS,
    face_force,
    follows_law,
    largest_approach,
    most_force,
    new_faces,
    on_virgin_loading,
    press_deeper,
    switch,
    tail_level,
    within_spring,
    wrong_branch,
)
from uqsphere.mechanics.integrator.searches import value_of
from uqsphere.mechanics.integrator.tracked import (
    FACE_A,
    FULL,
    LANES,
    LINEAR,
    MASSLESS,
    PAIR,
    POINTS,
    TERMS,
    End,
)
from uqsphere.mechanics.integrator.vectors import apart

#: longest trial step over the last step: without and with waves that come back, for which a step
#: that fails costs the reading of the waves anew
GROWTH, GROWTH_ECHO = 4.0, 1.3
#: steps a row may take at most: one that takes more has status 5
LIMIT = 1 << 20
#: fate of a row that is not done; the others are its status
GOES_ON = -1
#: steps whose errors may all go one way: a step at rest lacks up to 0.003 tolerances of energy
#: (sweep, balances)
FREE_STEPS = 1 << 10


class Rows(NamedTuple):
    """What is to be integrated, n rows in scaled variables.

    mass (n,): mu.  ends, round_trips (n, 2): R and T of the two bars (T infinite: no reflection).
    breaks, coefficients, frequencies: the pulse in scaled time.  horizon (n,): end of the record,
    inf for the rule of infinite bars, which needs pulse_end (n,).  level (n,): scale of x that is
    expected at least.  laws (n, tracked.LAWS, 2): of faces that yield or differ; (n, 0, 2): both
    forces are x^(3/2).  rigs (n, tracked.RIGS, 2), speed (n,): what stands at the poles where it is
    not two bars, with `laws`, and u at the start; such a record ends when the bodies part. (n, 0,
    2): bars.
    """

    mass: Array
    ends: Array
    round_trips: Array
    breaks: Array
    coefficients: Array
    frequencies: Array
    horizon: Array
    pulse_end: Array
    level: Array
    laws: Array
    rigs: Array
    speed: Array


@compiled(entry=True)
def march(rows, order, lanes, made, kept, out, status, steps):
    """Integrate rows `order` of a batch; answers go to `out` (rows, tracked.ANSWERS), `status` and
    `steps` (rows,).

    lanes (1,): tracked.LANE with what is asked; made (LANES, room): tracked.STEP; kept (len(order),
    room): tracked.PATH, the series of every row, where there is room for them.
    """
    s, taken, live = lanes[0], 0, 0
    while True:
        for j in range(LANES if live < LANES else 0):
            while s.row[j] < 0 and taken < len(order):
                s.place_in_order[j] = taken
                _enter(s, j, order[taken], rows)
                taken += 1
                if s.fate[j] != GOES_ON:
                    _leave(s, j, made, out, status, steps)
        _waves(s, made)
        virgin = _expand(s)
        _meet(s, virgin)
        live = 0
        for j in range(LANES):
            if s.row[j] < 0:
                continue
            if _holds(s, j):
                ending = _events(s, j)
                _keep(s, j, ending, made)
                if s.keeping and s.count[j] <= kept.shape[1]:
                    _give_out(s, j, ending, kept[s.place_in_order[j], s.count[j] - 1])
                if _turn(s, j, ending, made):
                    _jump(s, j, rows)
                _judge(s, j)
            if s.fate[j] != GOES_ON:
                _leave(s, j, made, out, status, steps)
            live += s.row[j] >= 0
        if live == 0 and taken >= len(order):
            break
    return taken


@compiled
def _leave(s, j, made, out, status, steps):
    """The row of a lane is done: its status, and its answers if it has any."""
    apart()
    r = s.row[j]
    status[r], s.row[j] = s.fate[j], -1
    if s.fate[j] != tracked.OK:
        return
    steps[r] = s.count[j]
    if math.isnan(s.ended[j]):
        last = made[j, (s.count[j] - 1) & (s.ring - 1)]
        s.ended[j] = last.began + last.holds
    # the tail between infinite bars, in which both faces are pressed, belongs to the record
    pressed = min(s.x[0, j], s.x[0, LANES + j]) > 0.0
    events.note_duration(s, j, not s.rigged and pressed and s.end[j] == math.inf)
    events.finish(s, j, made, out[r])


# --- enter


@compiled
def _enter(s, j, r, rows):
    """Put the start of a row into a lane: first touch, or what moves towards the sphere."""
    apart()
    s.row[j], s.count[j], s.attempts[j], s.touching[j], s.fate[j] = r, 0, 0, 1.0, GOES_ON
    s.mass[j], s.inverse_mu[j], s.quickest[j] = rows.mass[r], 1.0 / rows.mass[r], 1.0 / rows.mass[r]
    s.inertia[j] = rows.mass[r] if s.mode == FULL else math.inf
    s.time[j], s.end[j], s.proposed[j], s.error[j], s.single[j] = (
        0.0,
        rows.horizon[r],
        1e30,
        s.local,
        0,
    )
    s.x[0, j], s.x[0, LANES + j], s.u[0, j] = 0.0, 0.0, 0.0
    for bar in range(2):
        s.reflect[bar, j], s.trips[bar, j] = rows.ends[r, bar], rows.round_trips[r, bar]
        s.head[bar, j], s.tail[bar, j], s.first[bar, j], s.last[bar, j] = 0, 0, 0, 0
    s.back[j] = min(s.trips[0, j], s.trips[1, j])
    tailed = not s.rigged and s.end[j] == math.inf
    s.fades[j] = rows.pulse_end[r] * (1.0 - 1e-12) if tailed else math.inf
    s.pulse_end[j] = rows.pulse_end[r] * (1.0 - 1e-12)
    s.size[0, j], s.size[1, j], s.size[2, j] = rows.level[r], 0.1 * rows.level[r], rows.level[r]
    events.begin(s, j)
    incoming.enter_piece(s, j, rows)
    incoming.reflect_break(s, j)
    s.stop[j] = incoming.next_break(s, j, rows)
    s.on_slow[j], s.calm[j] = 0.0, step.decay_time(s, j)
    s.steady[j] = 1.0 if rows.breaks[r, -1] == math.inf and s.back[j] == math.inf else -1.0
    s.by_law[j] = 0
    if s.has_laws:
        new_faces(s, j, rows.laws[r])
        s.turned_at[j], s.turned_at[LANES + j] = -1.0, -1.0
        s.by_law[j] = follows_law(s, j)
    if s.rigged:
        _enter_rig(s, j, rows.rigs[r], rows.speed[r])
        if not events.next_touch(s, j) < math.inf and rows.breaks[r, -1] == 0.0:
            s.fate[j] = tracked.NEVER_CLOSES


@compiled
def _enter_rig(s, j, given, speed):
    """Put what stands at a row's poles into a lane; how quickly its lightest body and stiffest face
    answer a force.
    """
    quickest, stiffest = s.inverse_mu[j], 0.0
    s.u[0, j] = speed
    s.size[1, j] *= min(1.0, s.inverse_mu[j])  # a heavy sphere moves slowly
    for face in range(2):
        m, lightness = face * LANES + j, given[tracked.RIG_LIGHTNESS, face]
        s.gives[m], s.lightness[m] = given[tracked.RIG_GIVES, face], lightness
        s.there[m], s.free[0, m] = given[tracked.RIG_THERE, face], given[tracked.RIG_SPEED, face]
        s.size[2 * face, j] *= min(1.0, s.stiffness[m] ** (-2.0 / 3.0))
        s.size[3 + face, j] = 0.1 * min(1.0, lightness) if lightness > 0.0 else 1.0
        if s.there[m] == 0.0:
            s.touched[face, j] = 1.0
        else:
            quickest, stiffest = max(quickest, lightness), max(stiffest, s.stiffness[m])
    s.quickest[j] = max(quickest, 1.0) * max(stiffest, 1.0)


# --- waves


@compiled
def _waves(s, made):
    """The steps that are tried, and the waves that run towards the sphere in them, theory (4) and
    (5).
    """
    apart()
    for j in range(LANES):
        s.h[j], s.misfit[j] = 0.0, 0.0
        if s.row[j] >= 0:
            _try(s, j)
    incoming.incident(s)
    for j in range(LANES):
        if s.row[j] >= 0 and incoming.heard(s, j, s.back[j]):
            incoming.echoes(s, j, made)


@compiled
def _try(s, j):
    """The trial step of a lane; the approaches below which a record ends, a contact may be lost or
    nearly is.
    """
    scale = min(s.size[0, j], s.size[2, j]) if s.rigged else s.size[0, j]
    if s.touching[j] > 0.0:
        # the error of `step_from_touch`, a few thousandths of the force's impulse, is what limits a
        # touch
        brief = (1e2 * s.error[j] * min(1.0, 1.0 / s.quickest[j]) * scale) ** 0.4
        # the wave that presses has to be followed as well
        smooth = 0.5 * math.sqrt(math.sqrt(min(1e3 * s.error[j], 1e-2))) * (s.stop[j] - s.time[j])
        s.proposed[j] = min(s.proposed[j], min(brief, smooth))
    s.h[j] = min(min(s.proposed[j], s.stop[j] - s.time[j]), s.back[j])
    # an approach errs by less than the tolerance; in a row that is looked at again all steps may
    # err one way
    largest = max(s.size[0, j], s.size[2, j]) if s.rigged else scale
    steps = s.count[j] if s.tolerance < s.requested else 0
    s.faint[j] = (1.0 + steps) * s.tolerance * s.error[j] / s.local * largest
    s.near[j] = max(s.faint[j], max(100.0 * s.error[j], s.requested) * scale)
    if s.rigged and not math.isnan(
        s.lost[j]
    ):  # only the first loss of contact is an answer of its own
        s.near[j] = 0.0
    s.low[j] = -math.inf
    if s.time[j] >= s.fades[j]:
        s.low[j] = (
            tail_level(s, j)
            if s.by_law[j]
            else s.share * max(s.peak[FACE_A, j], s.peak[tracked.FACE_B, j])
        )


# --- expand


@compiled
def _expand(s):
    """The motion over the trial steps as power series, and the shares of them that hold; whether
    faces yield now.
    """
    apart()
    by_law, virgin, light = False, False, s.mode == FULL and not s.rigged
    for j in range(LANES if s.has_laws else 0):
        if s.by_law[j] and s.row[j] >= 0:
            by_law = True
            virgin |= on_virgin_loading(s, j)
    step.expand(s, by_law, virgin)
    step.longest(s)
    for j in range(LANES):
        s.why[j], s.switched[j] = End.SERIES, 0
        if s.row[j] < 0:
            continue
        if s.touching[j] > 0.0:
            s.theta[j] = 1.0
            step.step_from_touch(s, j)
            continue
        if s.by_law[j]:
            s.switched[j] = _against_branch(s, j)
            if s.switched[j]:
                continue
        yields = s.by_law[j] and on_virgin_loading(s, j)
        if (
            light
            and s.inverse_mu[j] * step.SMALL_MU > 1.0
            and s.time[j] >= s.calm[j]
            and not yields
        ):
            step.follow_slow(s, j)
    step.cut_at_stop(s)
    return virgin


@compiled
def _against_branch(s, j):
    """Faces (bits) that what jumped has turned against their branch, unless they are at rest where
    both meet.
    """
    apart()
    wrong = 0
    for face in range(2):
        m = face * LANES + j
        rests = s.turned_at[m] == s.time[j] and s.turns[m] >= MOST_TURNS
        if not rests and wrong_branch(s, m, s.h[j], 1e-4 * s.error[j] * s.size[0, j]):
            wrong |= 1 << face
    return wrong


@compiled
def _switch(s, j):
    """Bring those faces to their other branch, on which the step is made again."""
    apart()
    s.error[j] = min(s.error[j], s.closer * s.local)
    for face in range(2):
        m = face * LANES + j
        if s.switched[j] & (1 << face):
            s.turns[m] = s.turns[m] + 1.0 if s.turned_at[m] == s.time[j] else 1.0
            s.x[0, m], s.turned_at[m] = switch(s, m, s.x[0, m]), s.time[j]


# --- meet


@compiled
def _meet(s, virgin):
    """What the steps may meet: branches that end them, doubts, and flags of what has to be
    searched.
    """
    apart()
    if s.mode != LINEAR and not s.rigged:
        step.keep_root(s)
    step.inside(s, virgin)
    if s.has_laws and branch_ends(s):
        step.inside(s, False)
    step.speeds(s)
    if s.mode != LINEAR:
        step.wrong_roots(s)
    events.look(s)
    step.doubt(s)


@compiled
def _holds(s, j):
    """Whether the step of a lane holds; else it is made again, on the other branch of a face or
    shorter, or the row given up."""
    apart()
    if s.has_laws:
        if s.switched[j]:
            _switch(s, j)
            return False
        reached = within_spring(s, j) if s.touching[j] > 0.0 else 1.0
        if reached < 1.0:
            s.proposed[j] = reached * s.h[j]
            return False
    crossed = s.crosses[j] > 0.0
    if s.rigged:
        crossed = s.touching[j] == 0.0 and s.mode != LINEAR and _root_is_wrong(s, j)
    if not crossed and not s.unfit[j] > 0.0:
        return True
    s.attempts[j] += 1
    s.proposed[j] = s.h[j] * (0.5 * s.theta[j] if crossed else 0.5 if s.theta[j] > 0.0 else 0.05)
    if not crossed and s.theta[j] > 0.0 and not s.single[j]:
        # a wave bends where the step that made it ends: what does not fit is tried again up to
        # there
        s.single[j] = max(s.last[0, j] - s.first[0, j], s.last[1, j] - s.first[1, j]) > 0
        s.proposed[j] = s.h[j] if s.single[j] else s.proposed[j]
    if s.proposed[j] <= 1e-15 * (1.0 + s.time[j]) or s.attempts[j] > 10 * LIMIT:
        s.fate[j] = tracked.STUCK
    return False


@compiled
def _root_is_wrong(s, j):
    """Whether the impulse by which the series of a step may be off because a face nearly left is
    too much for a rig.
    """
    least, impulse = min(min(s.size[0, j], s.size[2, j]), s.mass[j] * s.size[1, j]), 0.0
    for face in range(2):
        m = face * LANES + j
        impulse = max(impulse, s.h[j] * s.theta[j] * s.wrong[m] * s.stiffness[m])
        if s.lightness[m] > 0.0:
            least = min(least, s.size[3 + face, j] / s.lightness[m])
    return impulse > 100.0 * s.error[j] * least


# --- turn


@compiled
def _turn(s, j, ending, made):
    """The state from which the next step of a lane starts, or the end of its row; whether the waves
    jump.
    """
    apart()
    reaches = records.approach_alone(s, j, ending)
    before, at_stop = s.time[j], s.h[j] * s.theta[j] >= (s.stop[j] - s.time[j]) * (1.0 - 1e-10)
    _move_on(s, j, ending)
    at_stop = at_stop and s.why[j] < End.CONTACT
    s.time[j] = s.stop[j] if at_stop else before + ending * s.h[j]
    _propose(s, j, ending, at_stop)
    done = s.why[j] == End.RECORD
    if s.rigged and s.touching[j] == 0.0:
        ahead = events.next_touch(s, j)
        if ahead < math.inf:  # free flight is linear in time: one step to the touch
            s.proposed[j] = 1.001 * ahead
        elif ahead == math.inf:
            s.proposed[j] = 1e30
            done = s.time[j] >= records.echoes_have_acted(s, j)
    left = s.why[j] == End.CONTACT and s.touching[j] == 0.0
    if left and s.stop_at_loss and not s.rigged:
        events.note_duration(s, j, False)
        done = events.no_higher_approach(s, j) or records.no_harder_squeeze(s, j, reaches, made)
    if done:
        s.fate[j] = tracked.OK
    elif at_stop and s.time[j] >= s.end[j]:
        pressed = max(s.x[0, j], s.x[0, LANES + j]) > 0.0
        s.fate[j] = tracked.STILL_PRESSED if s.rigged and pressed else tracked.OK
    return at_stop and s.fate[j] == GOES_ON


@compiled
def _judge(s, j):
    """Whether nothing that is wanted can change any more, or there is no more room."""
    if s.fate[j] != GOES_ON:
        return
    if s.steady[j] >= 0.0 and s.touching[j] == 0.0 and not s.rigged and events.no_later_peak(s, j):
        s.fate[j] = tracked.OK
        return
    # the first step that is read again: of the whole path, or of the waves of a round trip
    oldest = 0 if s.store or s.keeping else s.count[j]
    for bar in range(2):
        if s.trips[bar, j] < math.inf and s.time[j] < s.end[j]:
            oldest = min(oldest, max(s.first[bar, j], 0))
    if s.count[j] - oldest >= s.capacity or s.count[j] >= LIMIT:
        s.fate[j] = tracked.FULL_ROOM


@compiled
def _events(s, j):
    """Bring what is followed of a row up to date with its step; the share of the trial step at
    which it ends.
    """
    ending = s.theta[j]
    if s.has_laws:
        for face in range(2):
            m = face * LANES + j
            raised = s.known[m] > s.peak[face, j]
            s.places[face] = (s.place[m] if s.bent[m] > 0.0 else ending) if raised else -1.0
    if s.flags[j] != 0:
        ending = events.after_step(s, j)
    if s.flags[j] & (1 << FACE_A) == 0:
        for face in range(2 if s.has_laws else 1):
            s.peak[face, j] = s.known[face * LANES + j]
            if not incoming.heard(s, j, s.back[j]):
                s.x_first[face, j] = s.peak[face, j]
    if s.rigged:
        for face in range(2):
            if s.spring[face * LANES + j] == 0.0:  # on virgin loading it is at its deepest
                s.places[face] = ending
        events.note_peaks(s, j)
    if s.wanted & tracked.WANT_CARRIED:
        events.note_squared_forces(s, j, ending)
    if s.wanted & tracked.WANT_DURATION:
        events.note_impulse(s, j, ending)
    return ending


@compiled
def _keep(s, j, ending, made):
    """Store what is read again of this step: the path, and the waves that leave, f - P/Z of theory
    (5).
    """
    n = s.count[j]
    one = made[j, n & (s.ring - 1)]
    s.count[j] += 1
    if (
        s.by_law[j] and s.count[j] > FREE_STEPS
    ):  # errors to one side add up: of so many steps no more than a logarithm
        s.error[j] *= 1.0 - 1.0 / s.count[j]
    one.began, one.holds, one.unit, one.crest = s.time[j], ending * s.h[j], s.h[j], s.crest[j]
    if s.store:
        if s.has_laws:
            one.crest = most_force(s, j)
        for face in range(2):
            m = face * LANES + j
            one.spring[face], one.dent[face] = s.spring[m], s.dent[m]
            for k in range(TERMS):
                one.path[face, k] = s.x[k, m]
    for bar in range(2):
        m = bar * LANES + j
        if s.time[j] + s.trips[bar, j] < s.end[j]:
            for k in range(TERMS):
                one.wave[bar, k] = 0.5 * s.push[k, m] - s.gives[m] * s.force[k, m]


@compiled
def _give_out(s, j, ending, path):
    """The step as a `Motion` has it."""
    apart()
    path.start, path.length = s.time[j], ending * s.h[j]
    power, k_of = 1.0, LANES + j
    for k in range(TERMS):
        path.series[0, k], path.series[1, k] = s.x[k, j] * power, s.x[k, k_of] * power
        path.series[2, k] = s.u[k, j] * power
        path.series[3, k], path.series[4, k] = s.force[k, j] * power, s.force[k, k_of] * power
        power *= ending
    for face in range(2 if s.has_laws else 0):
        # the series of a force ends a power of the step before that of its approach: what is left
        # out at the end of the step goes to the last term, which errs by a fortieth of it inside
        m = face * LANES + j
        left_out = face_force(s, m, value_of(s.x, m, ending))[0] - value_of(s.force, m, ending)
        path.series[3 + face, TERMS - 1] += left_out
        path.series[face, 0] += s.dent[m]


@compiled
def _move_on(s, j, ending):
    """The state at the end of a step, on the branch and with the contact that follow it."""
    why, touched = s.why[j], s.side[j] * LANES + j
    if ending < s.theta[j]:
        s.at_u[j] = value_of(s.u, j, ending)
        for m in range(j, PAIR, LANES):
            s.at[POINTS, m] = value_of(s.x, m, ending)
    s.touching[j], s.single[j] = 0.0, 0
    if why == End.CONTACT:
        if s.x[0, touched] <= 0.0:
            s.touching[j], s.touches[j] = 1.0, s.touches[j] + 1.0
        else:
            s.parted[j] = s.time[j] + ending * s.h[j]
        for m in range(j, PAIR, LANES):
            if m == touched or s.mode == MASSLESS:  # both faces move alike
                s.at[POINTS, m] = 0.0
    elif why == End.BRANCH:
        s.by_law[j], s.error[j] = 1, min(s.error[j], s.closer * s.local)
        before = s.at[POINTS, touched]
        s.at[POINTS, touched] = switch(s, touched, before)
        if s.mode == MASSLESS:
            other = LANES + 2 * j - touched
            switch(s, other, s.at[POINTS, touched])
            s.at[POINTS, other] = s.at[POINTS, touched]
    s.x[0, j], s.x[0, LANES + j], s.u[0, j] = s.at[POINTS, j], s.at[POINTS, LANES + j], s.at_u[j]
    if s.rigged:
        for face in range(2):
            m = face * LANES + j
            s.free[0, m] = value_of(s.free, m, ending)
            s.size[3 + face, j] = max(s.size[3 + face, j], abs(s.free[0, m]))
            # what opens says nothing of the approaches
            s.size[2 * face, j] = max(s.size[2 * face, j], s.x[0, m])
    else:
        s.size[0, j] = max(s.size[0, j], max(abs(s.x[0, j]), abs(s.x[0, LANES + j])))
    s.size[1, j] = max(s.size[1, j], abs(s.u[0, j]))
    if s.by_law[j]:
        press_deeper(s, j)
        for face in range(0 if incoming.heard(s, j, s.back[j]) else 2):
            s.x_first[face, j] = largest_approach(s, face * LANES + j)


@compiled
def _propose(s, j, ending, at_stop):
    """How long the next step may be."""
    # what an echo cut short at a joint of its steps is tried again beyond it
    kept_up = s.proposed[j] if ending == 1.0 and not at_stop else 0.0
    longer = ending * s.h[j] * (GROWTH_ECHO if incoming.heard(s, j, s.back[j]) else GROWTH)
    s.proposed[j] = max(longer, kept_up)
    if s.why[j] == End.BRANCH:  # a face on its other branch moves on as smoothly as before
        s.proposed[j] = max(s.proposed[j], s.h[j])


@compiled
def _jump(s, j, rows):
    """Go on from a jump of the waves, unless too many of them are under way."""
    apart()
    if s.on_slow[j] > 0.0:  # what jumps sets off the fast oscillation
        s.proposed[j] = min(s.proposed[j], math.sqrt(s.mass[j]))
    s.on_slow[j], s.calm[j] = 0.0, s.time[j] + step.decay_time(s, j)
    s.proposed[j] *= GROWTH
    incoming.enter_piece(s, j, rows)
    if s.time[j] >= rows.breaks[s.row[j], -1] and s.back[j] == math.inf:
        s.steady[j] = 0.0
    if not incoming.reflect_break(s, j):
        s.fate[j] = tracked.CROWDED
    s.stop[j] = incoming.next_break(s, j, rows)

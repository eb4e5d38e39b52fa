"""The compiled batch integrator of the equations of motion, in the scaled variables of theory (9).

Rows advance in lanes: every lane has its own time and step, all lanes expand their motion into a
power series together, and a lane whose row has ended takes the next one.  A row's answer depends on
nothing but the row, so that any slice, order or number of threads gives the same bits.

A step never crosses a jump of the pulse or of one of its reflections, is never longer than a round
trip, and ends where a face leaves, touches or changes its branch.  One round of `march` takes every
lane one step:

    enter     idle lanes take the next rows
    waves     how long the step may be; what runs towards the sphere in it, theory (4) and (5)
    series    the motion as a power series, theory (9) or (R3), and how far it holds (`lanes`);
              from a touch, where it has none, by Runge-Kutta (`touch`)
    holds     a step that does not hold is tried again, shorter or on the other branch of a face
    events    where in the step a face leaves, touches, yields or is pressed deepest (`events`)
    keep      what is read again of it: the waves that leave, the path
    go on     the next state (`_move_on`), the round trips of a rig in which nothing happens
              (`flights`), the next length (`_propose`) and jump of the waves (`_jump`)
    end       whether the record ends there (`records.status_of_record`): then the lane leaves
              (`_leave`) with its answers (`records.finish`); so it does for want of room (`_room`)

Names that mean the same everywhere: `s`, all lanes (`tracked.STATE`); `j`, the number of a lane,
and `lane`, what it knows (`tracked.LANE`); `face`, 0 at A and 1 at B, and `m`, its column in the
arrays of `s`, face LANES + j; `past`, the steps that are read again; `theta`, a share of the trial
step, whose length is s.h[j]; `ending`, the share at which the step ends.

`tracked` lists all fields with their units and who writes them.
"""

from __future__ import annotations

import math
from math import inf, nan

from . import events, flights, incoming, lanes, records, touch, tracked
from .compiled import compiled
from .faces import (
    MOST_SWITCHES,
    face_force,
    higher,
    largest_approach,
    lower,
    most_force,
    new_face,
    press_deeper,
    start_series,
    switch,
    within_spring,
    wrong_branch,
)
from .tracked import FULL, GOES_ON, LANES, LINEAR, MASSLESS, OK, PAIR, POINTS, TERMS, End

#: longest trial step over the last step: without and with waves that come back, for which a step
#: that fails costs the reading of the waves anew
GROWTH, GROWTH_ECHO = 4.0, 1.3
#: steps a row may take at most: one that takes more is given up
LIMIT = 1 << 20
#: steps tried at one time before a row is given up: one that fails is halved 50 times at most, and
#: one that holds may have no length
ATTEMPTS = 1_000
#: errors allowed in one step that the series of the root may part from the root at the step's end,
#: as the impulse of that difference over the whole step.  At 100 a light sphere between bars, whose
#: speed errs by as much at every near loss, had P_max 27 tolerances off (campaign sweep, each
#: quantity alone)
_APART, _APART_IN_RIGS = 3.0, 100.0
#: a step from a touch joins both ends by cubics.  The force of x = t moves a body by 0.4 t^2.5 of
#: `lane.quickest`, from which a cubic is off by 0.011 inside a step of h: 0.0044 h^2.5, less than
#: half of h^2.5 over this number, which is what one step may err by
_BY_FORCE = 100.0
#: under a wave 2 f = 2 sin(pi t/L) that lasts for L it is off by pi³/192 (h/L)^4 L, 0.16 (h/L)^4 L:
#: ten errors of a step, by which the few touches of a row may err, at 16 (h/L)^4 = 1000 errors.  At
#: loose tolerances h is a sixth of L at most
_BY_WAVE, _ARCH = 1e3, 1e-2
#: steps whose errors may all go one way: a step at rest lacks up to 0.003 tolerances of energy
#: (sweep, balances)
FREE_STEPS = 1 << 10


@compiled(entry=True)
def march(rows, order, state, past, paths, out):
    """Integrate rows `order` of a batch; what they come to goes to `out` (n,): tracked.ANSWER.

    state (1,): tracked.STATE with what is asked; past (LANES, room): tracked.STEP, those that are
    read again; paths (len(order), room): tracked.PATH, the series of every row, where there is room
    for them.
    """
    s = state[0]
    taken = 0
    live = 0
    while True:
        for j in range(LANES if live < LANES else 0):
            lane = s.lane[j]
            while lane.number < 0 and taken < len(order):
                _enter(s, j, order[taken], rows)
                lane.place_in_order = taken
                taken += 1
                if lane.fate != GOES_ON:
                    _leave(s, j, past, out)
        _waves(s, past)
        _series(s)
        live = 0
        for j in range(LANES):
            lane = s.lane[j]
            if lane.number < 0:
                continue
            if _holds(s, j):
                ending = events.after_step(s, j)
                _keep(s, j, ending, past)
                if s.wanted & tracked.WANT_MOTION:
                    _give_out(s, j, ending, paths)
                _go_on(s, j, ending, past, rows)
            if lane.fate != GOES_ON:
                _leave(s, j, past, out)
            live += lane.number >= 0
        if live == 0 and taken >= len(order):
            break


@compiled
def _leave(s, j, past, out):
    """Free the lane of a row that goes on no more: its status, and its answers if it has any."""
    lane = s.lane[j]
    answer = out[lane.number]
    answer.status = lane.fate
    lane.number = -1
    if lane.fate == OK:
        records.finish(s, j, past, answer)


# --- enter


@compiled
def _enter(s, j, r, rows):
    """Put the start of a row into a lane: first touch, or what moves towards the sphere."""
    s.lane[j] = s.blank[0]
    lane = s.lane[j]
    pulse_end = rows.breaks[r, -1]
    lane.number = r
    lane.mass = rows.mass[r]
    lane.record_end = rows.record_end[r]
    lane.pulse_end = pulse_end * (1.0 - 1e-12)
    s.error[j] = s.local
    s.inverse_mu[j] = 1.0 / lane.mass
    if s.mode == MASSLESS:
        s.inverse_mu[j] = 0.0
    # first guesses: scales that are too small cost steps, too large ones accuracy
    level = 0.1  # scale of x that is expected at least
    heavy = 1.0  # a heavy sphere moves slowly
    if s.rigged:
        heavy = min(1.0, s.inverse_mu[j])
    else:
        level *= min(1.0, pulse_end)
    s.u_size[j] = 0.1 * level * heavy
    for face in range(2):
        _set_up_face(s, j, face, rows, level)
    lane.by_law = s.stiffness[j] != 1.0 or s.stiffness[LANES + j] != 1.0
    quickest = max(max(1.0 / lane.mass, 1.0), higher(s.lightness, j))
    lane.quickest = quickest * max(1.0, higher(s.stiffness, j))
    lane.first_echo = min(lane.trips[0], lane.trips[1])
    if pulse_end == inf and lane.first_echo == inf:
        lane.steady_level = 1.0
    _jump(s, j, rows)  # at first touch the waves begin
    closes = 0.0
    for face in range(2):
        closes = max(closes, flights.closing_rate(s, j, face))
    if s.rigged and closes <= 0.0:
        lane.fate = tracked.NEVER_CLOSES


@compiled
def _set_up_face(s, j, face, rows, level):
    """What stands at a pole of a row, and the law of the face there, before first touch."""
    lane = s.lane[j]
    m = face * LANES + j
    pole = rows.poles[lane.number, face]
    new_face(s, m, pole)
    lane.reflect[face] = rows.reflections[lane.number, face]
    lane.trips[face] = rows.round_trips[lane.number, face]
    lane.was_pressed[face] = 1.0 - pole.there
    s.gives[m] = pole.gives
    s.lightness[m] = pole.lightness
    s.there[m] = pole.there
    s.free[0, m] = pole.speed
    s.x[0, m] = 0.0
    s.u[0, m] = rows.speed[lane.number]
    s.size[m] = level * min(1.0, pole.stiffness ** (-2.0 / 3.0))
    s.free_size[m] = 1.0
    if pole.lightness > 0.0:
        s.free_size[m] = 0.1 * min(1.0, pole.lightness)


# --- waves


@compiled(inline=True)
def _waves(s, past):
    """The steps that are tried, and the waves that run towards the sphere in them, theory (4) and
    (5).
    """
    for k in range(TERMS):
        for m in range(PAIR):
            s.push[k, m] = 0.0
    echoing_a = False
    echoing_b = False
    for m in range(PAIR):
        s.returns[m] = 0.0
        s.misfit[m] = 0.0
    for j in range(LANES):
        lane = s.lane[j]
        if lane.number < 0:
            s.h[j] = s.h[LANES + j] = 0.0
            continue
        _try_length(s, j)
        heard = incoming.heard(lane, lane.first_echo)
        if heard:
            incoming.echo_steps(s, j, past)
        incoming.incident(s, j)
        for bar in range(2):
            if heard and lane.first[bar] >= 0:
                incoming.read_echo(s, j, bar, past)
                echoing_a = echoing_a or bar == 0
                echoing_b = echoing_b or bar == 1
    if echoing_a:
        lanes.fit_echoes_at_a(s)
    if echoing_b:
        lanes.fit_echoes_at_b(s)


@compiled
def _try_length(s, j):
    """The length of the trial step of a lane."""
    lane = s.lane[j]
    left = lane.next_jump - lane.time
    if lane.from_touch:
        brief = (_BY_FORCE * s.error[j] * (1.0 / lane.quickest) * lower(s.size, j)) ** 0.4
        # the wave that presses may bend over what is left up to its next jump
        bend = min(_BY_WAVE * s.error[j], _ARCH)
        smooth = 0.5 * math.sqrt(math.sqrt(bend)) * left
        lane.proposed = min(lane.proposed, min(brief, smooth))
    s.h[j] = s.h[LANES + j] = min(min(lane.proposed, left), lane.first_echo)


# --- series


@compiled(inline=True)
def _series(s):
    """The motion over the trial steps as power series, and the shares of them that hold."""
    for j in range(LANES):
        lane = s.lane[j]
        if lane.number >= 0 and (lane.by_law or s.mode == LINEAR):
            start_series(s, j)
            start_series(s, LANES + j)
    lanes.expand(s, s.lanes)
    lanes.reach(s)
    for j in range(LANES):
        lane = s.lane[j]
        if lane.number >= 0:
            if lane.from_touch:
                touch.step_from_touch(s, j)
            _choose(s, j)
            _allow_root(s, j)
    lanes.shorten_to_roots(s)
    lanes.survey(s)


@compiled
def _choose(s, j):
    """The share of the trial step that is taken: it ends at `next_jump`, or halfway to it where
    little would be left.
    """
    lane = s.lane[j]
    lane.ended_by = End.SERIES
    theta = min(s.theta[j], 1.0)
    left = lane.next_jump - lane.time
    if theta * s.h[j] >= left * (1.0 - 1e-10):
        theta = 1.0
    elif 2.0 * theta * s.h[j] > left:
        theta = min(theta, 0.5 * left / s.h[j])
    s.theta[j] = s.theta[LANES + j] = theta


@compiled(inline=True)
def _allow_root(s, j):
    """The impulse by which a step may err because the series of its root has parted from the
    root.
    """
    lane = s.lane[j]
    if s.mode == LINEAR or lane.from_touch:  # no root, or cubics in place of the series
        s.wrong_allowed[j] = inf
        return
    allowed = lower(s.size, j)
    if s.mode == FULL:
        allowed = min(allowed, lane.mass * s.u_size[j])
    for m in range(j, PAIR, LANES):
        if s.lightness[m] > 0.0:
            allowed = min(allowed, s.free_size[m] / s.lightness[m])
    parts = _APART
    if s.rigged:
        parts = _APART_IN_RIGS
    s.wrong_allowed[j] = parts * s.error[j] * allowed


# --- holds


@compiled(inline=True)
def _holds(s, j):
    """Whether the step of a lane holds; else it is tried again, on the other branch of a face or
    shorter, or the row given up.
    """
    lane = s.lane[j]
    lane.attempts += 1
    if lane.attempts > ATTEMPTS:
        lane.fate = tracked.STUCK
        return False
    if lane.from_touch:
        reached = within_spring(s, j)
        if reached < 1.0:
            lane.proposed = reached * s.h[j]
            return False
    elif lane.by_law and _change_branch(s, j):
        return False
    again = _length_again(s, j)
    if again == inf:
        return True
    lane.proposed = again
    if again <= 1e-15 * (1.0 + lane.time):
        lane.fate = tracked.STUCK
    return False


@compiled(inline=True)
def _length_again(s, j):
    """The length with which a step whose series do not hold is tried again; inf where they do."""
    lane = s.lane[j]
    sum_at_end = s.at[POINTS, j] + s.at[POINTS, LANES + j]
    left_out = (s.misfit[j] + s.misfit[LANES + j]) * s.h[j]
    if s.excess[j] > 1.0:  # the root's series has parted from the root
        return 0.5 * s.theta[j] * s.h[j]
    if not (s.theta[j] > 0.0 and abs(sum_at_end) < inf):  # a series has overflowed
        return 0.05 * s.h[j]
    if not left_out > s.error[j] * lower(s.size, j):
        return inf
    # an echo is not fitted: a wave bends where the step that sent it ends.  It is tried again up to
    # there, then shorter
    joints = max(lane.last[0] - lane.first[0], lane.last[1] - lane.first[1])
    if joints > 0 and not lane.one_step_echo:
        lane.one_step_echo = 1
        return s.h[j]
    return 0.5 * s.h[j]


@compiled
def _change_branch(s, j):
    """Bring faces that what jumped has set against their branch to the other one, on which the
    step is tried again; whether there are any.

    Faces at rest where both branches meet stay.
    """
    lane = s.lane[j]
    beyond = 1e-4 * s.error[j]
    changed = False
    for m in range(j, PAIR, LANES):
        if s.switched_at[m] != lane.time:
            s.switches[m] = 0.0
        if s.switches[m] < MOST_SWITCHES and wrong_branch(s, m, s.h[j], beyond * s.size[m]):
            s.switches[m] += 1.0
            s.switched_at[m] = lane.time
            switch(s, m)
            changed = True
    return changed


# --- keep and go on


@compiled(inline=True)
def _keep(s, j, ending, past):
    """Store what is read again of this step: the path, and the waves that leave, f - P/Z at A and
    -(h + P/Z) at B, theory (4) and (5).
    """
    lane = s.lane[j]
    n = lane.count
    step = past[j, n & (s.ring - 1)]
    lane.count += 1
    step.began = lane.time
    step.holds = ending * s.h[j]
    step.unit = s.h[j]
    if s.wanted & tracked.WANT_RISE:
        step.crest = higher(s.top, j)
        if s.has_laws:
            step.crest = most_force(s, j)
        for face in range(2):
            m = face * LANES + j
            step.spring[face] = s.spring[m]
            step.dent[face] = s.dent[m]
            for k in range(TERMS):
                step.path[face, k] = s.x[k, m]
    for bar in range(2):
        m = bar * LANES + j
        if lane.time + lane.trips[bar] < lane.record_end:
            for k in range(TERMS):
                step.wave[k, bar] = 0.5 * s.push[k, m] - s.gives[m] * s.force[k, m]


@compiled(inline=True)
def _give_out(s, j, ending, paths):
    """The step as a `Motion` has it, if there is room."""
    lane = s.lane[j]
    if lane.count > paths.shape[1]:
        return
    path = paths[lane.place_in_order, lane.count - 1]
    path.start = lane.time
    path.length = ending * s.h[j]
    for face in range(2):
        m = face * LANES + j
        power = 1.0
        for k in range(TERMS):
            path.series[face, k] = s.x[k, m] * power
            path.series[2, k] = s.u[k, m] * power
            path.series[3 + face, k] = s.force[k, m] * power
            power *= ending
        if s.has_laws:
            # the series of a force ends a power of the step before that of its approach: what is
            # left out at the end of the step goes to the last term, which errs by a fortieth of it
            # inside
            if s.x[0, m] >= 0.0:  # a gap that closes by rounding has no force
                force, _ = face_force(s, m, events.value_of(s.x, m, ending))
                path.series[3 + face, TERMS - 1] += force - events.value_of(s.force, m, ending)
            path.series[face, 0] += s.dent[m]


@compiled(inline=True)
def _go_on(s, j, ending, past, rows):
    """The state from which the next step of a lane starts, with what it may err, or the end of its
    row.

    The state moves on before the time: what it asks of echoes is as of the start of the step.  The
    next touch is looked for from the new state and time, which move on once more by round trips in
    which none can come; the fate of the row depends on it.
    """
    lane = s.lane[j]
    # a step that an event cuts short does not reach a jump; where a record ends in the tail
    # (`End.RECORD`) no jump is left
    left = lane.next_jump - lane.time
    at_jump = lane.ended_by == End.SERIES and s.h[j] * s.theta[j] >= left * (1.0 - 1e-10)
    if lane.by_law and lane.count > FREE_STEPS:
        # step n may err by 1/n: errors that all go one way add up to no more than a logarithm
        s.error[j] *= 1.0 - 1.0 / lane.count
    _move_on(s, j, ending)
    _widen_scales(s, j)
    if lane.time + ending * s.h[j] > lane.time:
        lane.attempts = 0
    lane.time += ending * s.h[j]
    if at_jump:
        lane.time = lane.next_jump
    ahead = nan
    if s.rigged and not lane.from_touch:
        ahead = flights.fly_on(s, j, past)
    _propose(s, j, ending, at_jump, ahead)
    crowded = at_jump and lane.time < lane.record_end and not _jump(s, j, rows)
    lane.fate = records.status_of_record(s, j, ending, past, ahead)
    if lane.fate == GOES_ON:
        lane.fate = _room(s, j, crowded)


@compiled(inline=True)
def _room(s, j, crowded):
    """Status with which a row is given up for want of room, or `GOES_ON`."""
    lane = s.lane[j]
    if crowded:
        return tracked.CROWDED
    # the first step that is read again: of the whole path, or of the waves of a round trip
    oldest = lane.count
    if s.wanted & tracked.WHOLE_PATH:
        oldest = 0
    for bar in range(2):
        if lane.trips[bar] < inf and lane.time < lane.record_end:
            oldest = min(oldest, max(lane.first[bar], 0))
    if lane.count >= LIMIT:
        return tracked.TOO_MANY_STEPS
    if lane.count - oldest >= s.capacity:
        return tracked.FULL_ROOM
    return GOES_ON


@compiled
def _move_on(s, j, ending):
    """The state at the end of a step, on the branch and with the contact that follow it."""
    lane = s.lane[j]
    s.u[0, j] = s.u[0, LANES + j] = s.u_at_end[j]
    lane.from_touch = 0
    lane.one_step_echo = 0
    if lane.ended_by == End.TOUCHED:
        lane.from_touch = 1
        lane.retouches += 1.0
    for m in range(j, PAIR, LANES):
        s.x[0, m] = s.at[POINTS, m]
        if m == lane.side * LANES + j or s.mode == MASSLESS:  # both faces move alike
            if lane.ended_by == End.BRANCH:
                switch(s, m)
            elif lane.ended_by in (End.LOST, End.TOUCHED):
                s.x[0, m] = 0.0
        if s.rigged:
            s.free[0, m] = events.value_of(s.free, m, ending)
    if lane.by_law:
        press_deeper(s, j)
    if not incoming.heard(lane, lane.first_echo):
        for face in range(2):
            lane.x_first[face] = largest_approach(s, face * LANES + j)


@compiled(inline=True)
def _widen_scales(s, j):
    """The scales by which errors are allowed: the largest values so far."""
    s.u_size[j] = max(s.u_size[j], abs(s.u[0, j]))
    if not s.rigged:
        s.size[j] = max(s.size[j], max(abs(s.x[0, j]), abs(s.x[0, LANES + j])))
        s.size[LANES + j] = s.size[j]
        return
    for m in range(j, PAIR, LANES):
        s.free_size[m] = max(s.free_size[m], abs(s.free[0, m]))
        # what opens says nothing of the approaches
        s.size[m] = max(s.size[m], s.x[0, m])


@compiled(inline=True)
def _propose(s, j, ending, at_jump, ahead):
    """How long the next step may be; ahead: `flights.fly_on`, NaN while a face is pressed."""
    lane = s.lane[j]
    # what an echo cut short at a joint of its steps is tried again beyond it
    before = 0.0
    growth = GROWTH
    if ending == 1.0 and not at_jump:
        before = lane.proposed
    if incoming.heard(lane, lane.first_echo):
        growth = GROWTH_ECHO
    lane.proposed = max(ending * s.h[j] * growth, before)
    if lane.ended_by == End.BRANCH:  # a face on its other branch moves on as smoothly as before
        lane.proposed = max(lane.proposed, s.h[j])
    if 0.0 < ahead < inf:  # free flight is linear in time: one step to the touch, or an echo's
        lane.proposed = 1.001 * ahead


@compiled
def _jump(s, j, rows):
    """Go on from first touch, or from a jump of the waves; whether there is room for those that
    come back.
    """
    lane = s.lane[j]
    lane.proposed *= GROWTH
    incoming.enter_piece(s, j, rows)
    if incoming.now(lane) >= rows.breaks[lane.number, -1] and lane.first_echo == inf:
        lane.steady_level = 0.0
    has_room = incoming.reflect_break(s, j)
    lane.next_jump = incoming.next_break(s, j, rows)
    return has_room

"""The compiled batch integrator of the equations of motion, in the scaled variables of theory (9).

Rows advance in lanes: every lane has its own time and step, all lanes expand their motion into a power series
together, and a lane whose row has ended takes the next one.  A row's answer depends on nothing but the row, so
that any slice, order or number of threads gives the same bits.

A step never crosses a jump of the pulse or of one of its reflections, is never longer than a round trip, and
ends where a face leaves or touches.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from uqsphere.mechanics.integrator import events, incoming, tracked
from uqsphere.mechanics.integrator.branches import branch_ends
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import (
    MOST_TURNS,
    face_force,
    largest_approach,
    may_be_wrong,
    most_force,
    new_faces,
    of_its_own,
    on_virgin_loading,
    press_deeper,
    switch,
    tail_level,
    within_spring,
    wrong_branch,
)
from uqsphere.mechanics.integrator.searches import value_of
from uqsphere.mechanics.integrator.step import (
    SCALES,
    SLOW_ROOM,
    SMALL_MU,
    cut_at_stop,
    decay_time,
    doubt,
    evaluate,
    evaluate_bent,
    expand,
    expand_plain,
    expand_virgin,
    longest,
    root_error,
    slow_step,
    start_points,
    step_from_touch,
    step_from_touch_plain,
    try_step,
)
from uqsphere.mechanics.integrator.tracked import LANES, PAIR, TERMS
from uqsphere.mechanics.integrator.vectors import bare
from uqsphere.mechanics.integrator.vectors import row as row_of

#: longest trial step over the last step: without and with waves that come back, for which a step that fails costs the
#: reading of the waves anew
GROWTH, GROWTH_ECHO = 4.0, 1.3
#: steps a row may take at most: one that takes more has status 5
LIMIT = 1 << 20
#: steps whose errors may all go one way: a step at rest lacks up to 0.003 tolerances of energy (sweep, balances)
FREE_STEPS = 1 << 10


@compiled(**tracked.INNER)
def enter_rig(lane, given, speed, x, u, free, rig, law, size, track, inverse_mu):
    """Put what stands at a row's poles into a lane; how quickly its lightest body and stiffest face answer a force."""
    quickest, stiffest = inverse_mu, 0.0
    u[0, lane] = speed
    size[1, lane] *= min(1.0, inverse_mu)  # a heavy sphere moves slowly
    for face in range(2):
        m = face * LANES + lane
        for k in range(tracked.RIGS):
            rig[k, m] = given[k, face]
        free[0, m] = given[tracked.RIG_SPEED, face]
        lightness, stiffness = given[tracked.RIG_LIGHTNESS, face], law[tracked.STIFFNESS, m]
        size[2 * face, lane] *= min(1.0, stiffness ** (-2.0 / 3.0))
        size[3 + face, lane] = 0.1 * min(1.0, lightness) if lightness > 0.0 else 1.0
        if given[tracked.RIG_THERE, face] == 0.0:
            track[tracked.TOUCHED_A + face, lane] = 1.0
        else:
            quickest, stiffest = max(quickest, lightness), max(stiffest, stiffness)
    return max(quickest, 1.0) * max(stiffest, 1.0)


@compiled(**tracked.INNER)
def wrong_root(lane, length, branch, mass, local, rig, law, size):
    """Impulse by which the series of a step may be off because a face nearly left in it, and what is allowed."""
    allowed = min(size[0, lane], size[2, lane]), mass * size[1, lane]
    least, impulse = min(allowed[0], allowed[1]), 0.0
    for face in range(2):
        m = face * LANES + lane
        impulse = max(impulse, length * branch[m] * law[tracked.STIFFNESS, m])
        if rig[tracked.RIG_LIGHTNESS, m] > 0.0:
            least = min(least, size[3 + face, lane] / rig[tracked.RIG_LIGHTNESS, m])
    return impulse, 100.0 * local * least


@compiled()
def march(
    mode, wanted, mass, ends, round_trips, breaks, coefficients, frequencies, horizon, pulse_end, level, laws, rigs,
    speed, local, closer, asked, stop_at_loss, capacity, out, status, order, steps, kept_start, kept_length, kept,
):  # fmt: skip
    """Integrate rows `order` of a batch; answers go to `out` (rows, tracked.ANSWERS) and `status` (rows).

    mode: 0 full, 1 linear contact, 2 massless.  wanted: sum of tracked.WANT_*.  mass (n,): mu.  ends,
    round_trips (n, 2): R and T of the two bars (T infinite: no reflection).  breaks, coefficients, frequencies:
    the pulse in scaled time.  horizon (n,): end of the record, inf for the rule of infinite bars, which needs
    pulse_end (n,).  level (n,): scale of x that is expected at least.  local: error allowed in one step, asked: in the
    answers; closer: share of the first once a face has yielded.  capacity: steps kept of one row.  kept* (len(order),
    steps, ...) receive the series (x1, x2, u, q1, q2) of every row where they have room for steps.  laws (n,
    tracked.LAWS, 2): of faces that yield or differ; (n, 0, 2): both forces are x^(3/2). rigs (n, tracked.RIGS, 2),
    speed (n,): what stands at the poles where it is not two bars, with `laws`, and u at the start; such a record ends
    when the bodies part.  (n, 0, 2): bars.
    """
    lanes, last_point = LANES, tracked.POINTS
    keeping = kept_start.shape[1] > 0
    # numba counts the owners of an array at every call it is passed to: here they are held once for all
    owned = (
        np.zeros((TERMS, PAIR)), np.zeros((TERMS, LANES)), np.zeros((TERMS, PAIR)), np.zeros((TERMS, PAIR)),
        np.zeros((TERMS, PAIR)), np.zeros((tracked.POINTS + 1, PAIR)), np.zeros((tracked.POINTS + 1, PAIR)),
        np.zeros((11, PAIR)), np.zeros((4, incoming.WAVE)), np.zeros((2, TERMS)), np.full((2, lanes), np.inf),
        np.zeros((4, lanes)), np.zeros((2, lanes, incoming.QUEUE)), np.zeros((2, lanes), dtype=np.int64),
        np.zeros((2, lanes), dtype=np.int64), np.zeros((2, lanes), dtype=np.int64),
        np.zeros((2, lanes), dtype=np.int64), np.zeros((tracked.TRACKS, lanes)), np.ones((SCALES, lanes)),
        np.zeros((4, 2, tracked.POINTS + 1)), np.zeros((3, PAIR)), np.zeros((28, lanes)),
        np.zeros((4, lanes), dtype=np.int64), np.zeros((tracked.NUMBERS, PAIR)), np.zeros((TERMS, PAIR)),
        np.zeros((1, PAIR)), np.zeros((tracked.RIGS, PAIR)), np.zeros((TERMS, PAIR)), np.full(2, -1.0),
        np.zeros((TERMS, PAIR)), np.zeros((3, TERMS)), np.zeros((tracked.POINTS + 1, PAIR)),
    )  # fmt: skip
    # faces that yield: their law, the series of the logarithm in it, a divisor; see `faces`
    law, log, inverse_root, sloped = bare(owned[23]), bare(owned[24]), bare(owned[25][0]), bare(owned[29])
    carried_room, bow = bare(owned[30]), bare(owned[31])
    yielding, switched, own, turned = (
        laws.shape[1] > 0,
        np.zeros(lanes, dtype=np.bool_),
        np.zeros(lanes, dtype=np.bool_),
        np.zeros((2, PAIR)),
    )
    # what stands at the poles, the series of U_A and -U_B, where in a step faces are pressed deepest
    rig, free, places = bare(owned[26]), bare(owned[27]), bare(owned[28])
    rigged = rigs.shape[1] > 0
    if not yielding:
        wanted &= ~tracked.WANT_SHARE
    for m in range(PAIR):
        rig[tracked.RIG_GIVES, m], rig[tracked.RIG_THERE, m] = 1.0, 1.0
    x, u, root, force, push = bare(owned[0]), bare(owned[1]), bare(owned[2]), bare(owned[3]), bare(owned[4])
    at, rate, room, work, piece = bare(owned[5]), bare(owned[6]), bare(owned[7]), bare(owned[8]), bare(owned[9])
    trips, cubic, queue = bare(owned[10]), bare(owned[11]), bare(owned[12])
    track, size, grid, columns = bare(owned[17]), bare(owned[18]), bare(owned[19]), bare(owned[20])
    half, branch, known = bare(columns[0]), bare(columns[1]), bare(columns[2:3])
    head, tail = bare(owned[13]), bare(owned[14])
    # steps that hold the echo of the present step
    first, last = bare(owned[15]), bare(owned[16])
    numbers, counts = owned[21], owned[22]
    at_u, rate_u, time, h = bare(numbers[0]), bare(numbers[1]), bare(numbers[2]), bare(numbers[3])
    theta, proposed, inverse_mu, frequency = bare(numbers[4]), bare(numbers[5]), bare(numbers[6]), bare(numbers[7])
    offset, misfit, low, near = bare(numbers[8]), bare(numbers[9]), bare(numbers[10]), bare(numbers[11])
    crest, end, quickest = bare(numbers[13]), bare(numbers[14]), bare(numbers[12])
    stop = bare(numbers[15])  # the next time at which a step has to end
    steady = bare(numbers[16])  # the wave that comes in from now on for ever, or -1
    reflect = bare(numbers[17:19])
    # 1 where a lane has a row, starts from a touch, follows the slow motion; what a step's end may be doubted for
    busy, touching, on_slow = bare(numbers[19]), bare(numbers[20]), bare(numbers[21])
    crosses, unfit = bare(numbers[22]), bare(numbers[23])
    # of a lane's row: mu, inf where the sphere has no mass; the first echo; when it can be heard, the pulse is over
    inertia, back, heard = bare(numbers[24]), bare(numbers[25]), bare(numbers[26])
    fades = bare(numbers[27])
    row, count, attempts, flags = bare(counts[0]), bare(counts[1]), bare(counts[2]), bare(counts[3])
    place, meets = np.zeros(lanes, dtype=np.int64), np.zeros(lanes, np.int64)
    # time before which the fast oscillation cannot have died out
    calm, slow_room = np.zeros(lanes), np.zeros((SLOW_ROOM, TERMS))
    error, alone = np.zeros(lanes), np.zeros(lanes, dtype=np.bool_)
    row[:] = -1
    inverse_mu[:] = 1.0
    # uninitialised: only the pages of steps that are taken ever cost memory.  A step's series is in powers of
    # (t - BEGAN)/UNIT_OF and holds over HOLDS.  With room for a power of two of steps all lanes would share a few lines
    # of the processor's cache, 8 numbers each
    room_of_lane = capacity + 8
    kept_steps = (
        np.empty((lanes, room_of_lane, tracked.KEPT)), np.empty((lanes, room_of_lane, 3, TERMS)),
        np.empty((lanes * room_of_lane * 2, TERMS)), np.empty((lanes, room_of_lane, 2, 2)),
    )  # fmt: skip
    made = bare(kept_steps[0])
    # series of the approaches; of faces with laws of their own the spring and the dent of a step beside them
    path, wave, branches = bare(kept_steps[1]), bare(kept_steps[2]), bare(kept_steps[3])
    store = wanted & tracked.WANT_RISE != 0
    timed = wanted & tracked.WANT_DURATION != 0
    share = tracked.TAIL_SHARE if mode == 1 else tracked.TAIL_SHARE ** (2.0 / 3.0)
    taken, live = 0, 0
    # how many steps are read again: all that there is room for, or the last one alone
    ring = capacity if store or keeping or np.isfinite(round_trips).any() else 1
    while True:
        # ---- fill idle lanes
        for j in range(lanes if live < lanes else 0):
            if row[j] >= 0 or taken >= len(order):
                continue
            r, place[j] = order[taken], taken
            taken += 1
            live += 1
            row[j] = r
            inverse_mu[j] = 1.0 / mass[r]
            end[j] = horizon[r]
            time[j] = 0.0
            count[j], attempts[j], touching[j] = 0, 0, 1.0
            x[0, j], x[0, LANES + j], u[0, j] = 0.0, 0.0, 0.0
            for bar in range(2):
                reflect[bar, j], trips[bar, j] = ends[r, bar], round_trips[r, bar]
                head[bar, j], tail[bar, j], first[bar, j] = 0, 0, 0
            back[j] = min(trips[0, j], trips[1, j])
            heard[j], inertia[j] = back[j] * (1.0 - 1e-12), mass[r] if mode == 0 else math.inf
            fades[j] = pulse_end[r] * (1.0 - 1e-12) if not rigged and end[j] == math.inf else math.inf
            size[0, j], size[1, j], size[2, j] = level[r], 0.1 * level[r], level[r]
            quickest[j] = inverse_mu[j]
            events.begin(track, j)
            incoming.enter_piece(breaks, coefficients, frequencies, r, j, 0.0, cubic, frequency, offset)
            incoming.reflect_break(0.0, trips, queue, head, tail, j, end[j])
            stop[j] = incoming.next_break(breaks, r, 0.0, queue, head, tail, j, end[j])
            proposed[j] = 1e30
            error[j], alone[j] = local, False
            on_slow[j], calm[j] = 0.0, decay_time(mass[r], local)
            if yielding:
                new_faces(law, j, laws[r])
                turned[0, j], turned[0, LANES + j] = -1.0, -1.0
                own[j] = of_its_own(law, j)
            steady[j] = (
                1.0 if breaks[r, -1] == math.inf and trips[0, j] == math.inf and trips[1, j] == math.inf else -1.0
            )
            if rigged:
                quickest[j] = enter_rig(j, rigs[r], speed[r], x, u, free, rig, law, size, track, inverse_mu[j])
                if not events.next_touch(j, x, u, free, rig) < math.inf and breaks[r, -1] == 0.0:
                    status[r] = tracked.NEVER_CLOSES
                    row[j] = -1
                    live -= 1
        if live == 0 and taken >= len(order):
            break
        # ---- the waves over the trial steps
        for j in range(lanes):
            busy[j] = 1.0 if row[j] >= 0 else 0.0
            if touching[j] > 0.0 and row[j] >= 0:
                # the error of `step_from_touch`, a few thousandths of the force's impulse, is what limits a touch
                brief = (1e2 * error[j] * min(1.0, 1.0 / quickest[j]) * size[0, j]) ** 0.4
                if rigged:
                    brief = (1e2 * error[j] * min(1.0, 1.0 / quickest[j]) * min(size[0, j], size[2, j])) ** 0.4
                # the wave that presses has to be followed as well
                smooth = 0.5 * math.sqrt(math.sqrt(min(1e3 * error[j], 1e-2))) * (stop[j] - time[j])
                proposed[j] = min(proposed[j], min(brief, smooth))
        try_step(h, low, near, misfit, proposed, stop, time, back, busy, fades, share, track, error, asked, size)
        for j in range(lanes if yielding else 0):
            if own[j] and time[j] >= fades[j]:
                low[j] = tail_level(law, j, track[tracked.FACE_A, j], track[tracked.FACE_B, j], tracked.TAIL_SHARE)
            if rigged:  # only the first loss of contact is an answer of its own
                lost = not math.isnan(track[tracked.LOST, j])
                closest = max(100.0 * error[j], asked) * min(size[0, j], size[2, j])
                near[j] = 0.0 if lost else closest
        incoming.incident(time, h, cubic, frequency, offset, push)
        for j in range(lanes):
            if row[j] >= 0 and time[j] >= heard[j]:
                trial = incoming.echo_steps(j, time[j], h[j], trips, count[j], made, ring, first, last, alone[j])
                if trial < h[j]:
                    shrink = trial / h[j]
                    power = shrink
                    for k in range(1, TERMS):
                        push[k, j] *= power
                        power *= shrink
                    h[j] = trial
                for bar in range(2):
                    if trips[bar, j] <= time[j] * (1.0 + 1e-12) and first[bar, j] >= 0:
                        misfit[j] += incoming.add_echo(made, wave, ring, bar, j, first[bar, j], last[bar, j],
                                              time[j] - trips[bar, j], h[j], 2.0 * reflect[bar, j],
                                              0.1 * error[j] * size[0, j] / h[j], push, work)  # fmt: skip
        # ---- the motion over the steps
        apart, virgin = False, False
        if yielding:
            for j in range(lanes):
                if own[j] and row[j] >= 0:
                    apart = True
                    virgin |= on_virgin_loading(law, j)
        if virgin:
            expand_virgin(mode, h, inverse_mu, push, x, u, root, force, half, apart, law, log, inverse_root, rigged,
                          rig, free, sloped)  # fmt: skip
        elif apart or rigged:
            expand(mode, h, inverse_mu, push, x, u, root, force, half, apart, law, log, inverse_root, rigged, rig, free,
                   sloped)  # fmt: skip
        else:
            expand_plain(mode, h, inverse_mu, push, x, u, root, force, half, apart, law, log, inverse_root, rigged,
                         rig, free, sloped)  # fmt: skip
        longest(x, u, free, size, rigged, error, theta)
        for j in range(lanes):
            if row[j] < 0:
                continue
            if own[j] and touching[j] == 0.0:
                # what jumped may have turned a face against its branch: the step is made again on the other one
                for m in range(j, PAIR, LANES):
                    if turned[0, m] != time[j]:
                        turned[0, m], turned[1, m] = time[j], 0.0
                    doubtful = turned[1, m] < MOST_TURNS and may_be_wrong(law, m, x, h[j])
                    if doubtful and wrong_branch(law, m, x, h[j], 1e-4 * error[j] * size[0, j], track, j):
                        switched[j], error[j] = True, min(error[j], closer * local)
                        turned[1, m] += 1.0
            if touching[j] > 0.0:
                theta[j] = 1.0
                if own[j] or rigged:
                    step_from_touch(mode, j, h[j], inverse_mu[j], push, x, u, force, yielding, law, rig, free)
                else:
                    step_from_touch_plain(mode, j, h[j], inverse_mu[j], push, x, u, force, yielding, law, rig, free)
            elif (
                mode == 0
                and not rigged
                and inverse_mu[j] * SMALL_MU > 1.0
                and time[j] >= calm[j]
                and not (own[j] and on_virgin_loading(law, j))
            ):
                slow, swing = 0.0, math.inf
                springs = (law[tracked.SPRING, j], law[tracked.SPRING, LANES + j]) if own[j] else (1.0, 1.0)
                # on the slow motion the forces differ by mu u', and u' is of the order of one
                if abs(force[0, j] - force[0, LANES + j]) < 10.0 * mass[row[j]]:
                    slow, swing = slow_step(
                        j,
                        h[j],
                        mass[row[j]],
                        push,
                        x,
                        u,
                        root,
                        force,
                        size[0, j],
                        error[j],
                        on_slow[j] > 0.0,
                        slow_room,
                        springs,
                    )
                on_slow[j] = 1.0 if slow > 0.0 else 0.0
                if slow > 0.0:
                    theta[j] = slow
                elif swing < math.inf:
                    # the oscillation needs this long to die out
                    rate_of_decay = 0.75 * math.sqrt(max(x[0, j], x[0, LANES + j]))
                    calm[j] = time[j] + max(4.0 * h[j], 0.9 * math.log(swing / (error[j] * size[0, j])) / rate_of_decay)
                else:
                    calm[j] = time[j] + 8.0 * h[j]
        cut_at_stop(theta, h, stop, time)
        start_points(at, rate, bow, x)
        for i in range(1, tracked.POINTS + 1):
            if virgin:
                evaluate_bent(x, theta, i / tracked.POINTS, half, row_of(at, i, 0), row_of(rate, i, 0),
                              row_of(bow, i, 0))  # fmt: skip
            else:
                evaluate(x, theta, i / tracked.POINTS, half, row_of(at, i, 0), row_of(rate, i, 0))
        if yielding and branch_ends(row, touching, x, at, rate, bow, theta, law, piece, room, meets):
            for i in range(1, tracked.POINTS + 1):
                evaluate(x, theta, i / tracked.POINTS, half, row_of(at, i, 0), row_of(rate, i, 0))
        evaluate(u, theta, 1.0, half, at_u, rate_u)
        if mode != 1:
            root_error(root, theta, half, at, law, branch, row_of(room, 0, 0), row_of(room, 1, 0))
        events.look(mode, wanted, x, at, rate, track, theta, low, near, row, flags, known, crest, room, yielding, law)
        doubt(crosses, unfit, h, theta, columns, error, size, inertia, touching, on_slow, misfit)
        for j in range(lanes):
            if row[j] < 0:
                continue
            r = row[j]
            if yielding:
                if switched[j]:
                    switched[j] = False
                    continue
                reached = within_spring(law, j, x, room[1]) if touching[j] > 0.0 else 1.0
                if reached < 1.0:
                    proposed[j] = reached * h[j]
                    continue
            crossed = crosses[j] > 0.0
            if rigged:
                impulse, allowed = wrong_root(j, h[j] * theta[j], branch, mass[row[j]], error[j], rig, law, size)
                crossed = touching[j] == 0.0 and mode != 1 and impulse > allowed
            if crossed or unfit[j] > 0.0:
                attempts[j] += 1
                proposed[j] = h[j] * (0.5 * theta[j] if crossed else 0.5 if theta[j] > 0.0 else 0.05)
                if not crossed and theta[j] > 0.0 and not alone[j]:
                    # a wave bends where the step that made it ends: what does not fit is tried again up to there
                    alone[j] = max(last[0, j] - first[0, j], last[1, j] - first[1, j]) > 0
                    proposed[j] = h[j] if alone[j] else proposed[j]
                if proposed[j] <= 1e-15 * (1.0 + time[j]) or attempts[j] > 10 * LIMIT:
                    status[r] = tracked.STUCK
                    row[j] = -1
                    live -= 1
                continue
            before = time[j]
            at_stop = h[j] * theta[j] >= (stop[j] - before) * (1.0 - 1e-10)
            why = 0
            ending = theta[j]
            if yielding:
                for m in range(j, PAIR, LANES):
                    raised = known[0, m] > track[tracked.FACE_A + m // LANES, j]
                    places[m // LANES] = (room[3, m] if room[4, m] > 0.0 else ending) if raised else -1.0
            if flags[j] != 0:
                for face in range(2):
                    for k in range(TERMS):
                        piece[face, k] = x[k, face * LANES + j]
                    for i in range(tracked.POINTS + 1):
                        grid[face, 0, i] = at[i, face * LANES + j]
                        grid[face, 1, i] = rate[i, face * LANES + j]
                quiet = share if low[j] > 0.0 else 0.0
                if own[j] and low[j] > 0.0:
                    quiet = low[j] / max(
                        max(track[tracked.FACE_A, j], track[tracked.FACE_B, j]), max(known[0, j], known[0, LANES + j])
                    )
                ending, why = events.after_step(
                    mode, flags[j], track, j, piece, grid, places, theta[j], before, h[j],
                    back[j], quiet, max(50.0 * error[j], 2.0 * asked) * size[0, j], near[j],
                    stop_at_loss and not rigged, yielding, law,
                )  # fmt: skip
            if why == 0 and ending == theta[j]:
                why = meets[j]
            if flags[j] & (1 << tracked.FACE_A) == 0:
                track[tracked.FACE_A, j] = known[0, j]
                if before < heard[j]:
                    track[tracked.X_FIRST, j] = known[0, j]
                if yielding:
                    track[tracked.FACE_B, j] = known[0, LANES + j]
                    if before < heard[j]:
                        track[tracked.X_FIRST + 1, j] = known[0, LANES + j]
            if rigged:
                for face in range(2):
                    if law[tracked.SPRING, face * LANES + j] == 0.0:  # on virgin loading it is at its deepest
                        places[face] = ending
                events.note_peaks(track, j, force, places)
            if wanted & tracked.WANT_CARRIED:
                events.note_carried(track, j, force, h[j], ending, carried_room)
            n = count[j] & (ring - 1)
            if timed and not rigged:
                power = ending * h[j]
                for k in range(TERMS):
                    track[tracked.PUSHED, j] += (push[k, j] + push[k, LANES + j]) * power / (k + 1.0)
                    power *= ending
            count[j] += 1
            if own[j] and count[j] > FREE_STEPS:  # errors to one side add up: of so many steps no more than a logarithm
                error[j] *= 1.0 - 1.0 / count[j]
            made[j, n, tracked.BEGAN], made[j, n, tracked.HOLDS] = before, ending * h[j]
            made[j, n, tracked.UNIT_OF], made[j, n, tracked.CREST] = h[j], crest[j]
            if yielding and store:
                made[j, n, tracked.CREST] = most_force(law, j, room[1])
            if store:
                for face in range(2):
                    m = face * LANES + j
                    for k in range(TERMS):
                        path[j, n, face, k] = x[k, m]
                    if yielding:
                        branches[j, n, face, 0], branches[j, n, face, 1] = law[tracked.SPRING, m], law[tracked.DENT, m]
            for bar in range(2):
                if before + trips[bar, j] < end[j]:
                    gives = rig[tracked.RIG_GIVES, bar * LANES + j]
                    for k in range(TERMS):
                        m = bar * LANES + j
                        wave[2 * (j * room_of_lane + n) + bar, k] = 0.5 * push[k, m] - gives * force[k, m]
            if keeping and n < kept_start.shape[1]:
                power, at_row = 1.0, place[j]
                kept_start[at_row, n], kept_length[at_row, n] = before, ending * h[j]
                for k in range(TERMS):
                    kept[at_row, n, 0, k] = x[k, j] * power
                    kept[at_row, n, 1, k] = x[k, LANES + j] * power
                    kept[at_row, n, 2, k] = u[k, j] * power
                    kept[at_row, n, 3, k] = force[k, j] * power
                    kept[at_row, n, 4, k] = force[k, LANES + j] * power
                    power *= ending
                if yielding:
                    # the series of a force ends a power of the step before that of its approach: what is left out at
                    # the end of the step goes to the last term, which errs by a fortieth of it inside
                    for m in range(j, PAIR, LANES):
                        left_out = face_force(law, m, value_of(x, m, ending))[0] - value_of(force, m, ending)
                        kept[at_row, n, 3 + m // LANES, TERMS - 1] += left_out
                    kept[at_row, n, 0, 0] += law[tracked.DENT, j]
                    kept[at_row, n, 1, 0] += law[tracked.DENT, LANES + j]
            touching[j], alone[j] = 0.0, False
            if ending < theta[j]:
                at_u[j] = value_of(u, j, ending)
                for m in range(j, PAIR, LANES):
                    at[last_point, m] = value_of(x, m, ending)
            if why >= 2:  # the motion goes on from where a face left or touched
                at_stop = False
                touching[j] = 1.0 if why < 4 and x[0, (why - 2) * LANES + j] <= 0.0 else 0.0
                if why < 4 and touching[j] > 0.0:
                    track[tracked.TOUCHES, j] += 1.0
                elif why < 4:
                    track[tracked.PARTED, j] = before + ending * h[j]
                if why < 4:
                    at[last_point, (why - 2) * LANES + j] = 0.0
                else:
                    own[j], error[j], m = True, min(error[j], closer * local), (why % 2) * LANES + j
                    at[last_point, m] = switch(law, m, at[last_point, m], track, j)
                    if mode == 2:
                        switch(law, (LANES + 2 * j) - m, at[last_point, m], track, j)
                        at[last_point, j] = at[last_point, LANES + j] = at[last_point, m]
                if mode == 2 and why < 4:  # both faces move alike
                    at[last_point, j], at[last_point, LANES + j] = 0.0, 0.0
            time[j] = stop[j] if at_stop else before + ending * h[j]
            x[0, j], x[0, LANES + j], u[0, j] = at[last_point, j], at[last_point, LANES + j], at_u[j]
            if rigged:
                for m in range(j, PAIR, LANES):
                    free[0, m] = value_of(free, m, ending)
                    size[3 + m // LANES, j] = max(size[3 + m // LANES, j], abs(free[0, m]))
            if own[j]:
                press_deeper(law, j, x)
                if before < heard[j]:
                    for face in range(2):
                        known_face = track[tracked.FACE_A + face, j]
                        track[tracked.X_FIRST + face, j] = largest_approach(law, face * LANES + j, known_face)
            if rigged:  # what opens says nothing of the approaches
                size[0, j], size[2, j] = max(size[0, j], x[0, j]), max(size[2, j], x[0, LANES + j])
            else:
                size[0, j] = max(size[0, j], max(abs(x[0, j]), abs(x[0, LANES + j])))
            size[1, j] = max(size[1, j], abs(u[0, j]))
            # what an echo cut short at a joint of its steps is tried again beyond it
            kept_up = proposed[j] if ending == 1.0 and not at_stop else 0.0
            proposed[j] = ending * h[j] * (GROWTH if time[j] < back[j] else GROWTH_ECHO)
            proposed[j] = max(proposed[j], kept_up)
            if why >= 4:  # a face on its other branch moves on as smoothly as before
                proposed[j] = max(proposed[j], h[j])
            done = why == 1
            if rigged and touching[j] == 0.0:
                ahead = events.next_touch(j, x, u, free, rig)
                if ahead < math.inf:  # free flight is linear in time: one step to the touch
                    proposed[j] = 1.001 * ahead
                elif ahead == math.inf:
                    proposed[j] = 1e30
                    done = back[j] == math.inf or (at_stop and time[j] >= heard[j])
            if not done and at_stop:
                if time[j] >= end[j]:
                    done = True
                    if rigged and max(x[0, j], x[0, LANES + j]) > 0.0:
                        status[r] = tracked.STILL_PRESSED
                        row[j] = -1
                        live -= 1
                        continue
                else:
                    if on_slow[j] > 0.0:  # what jumps sets off the fast oscillation
                        proposed[j] = min(proposed[j], math.sqrt(mass[r]))
                    on_slow[j], calm[j] = 0.0, time[j] + decay_time(mass[r], error[j])
                    proposed[j] *= GROWTH
                    incoming.enter_piece(breaks, coefficients, frequencies, r, j, time[j], cubic, frequency, offset)
                    if time[j] >= breaks[r, -1] and trips[0, j] == math.inf and trips[1, j] == math.inf:
                        steady[j] = 0.0
                    if not incoming.reflect_break(time[j], trips, queue, head, tail, j, end[j]):
                        status[r] = tracked.CROWDED
                        row[j] = -1
                        live -= 1
                        continue
                    stop[j] = incoming.next_break(breaks, r, time[j], queue, head, tail, j, end[j])
            if not done and steady[j] >= 0.0 and touching[j] == 0.0 and not rigged:
                if own[j]:
                    done = events.decided_own(wanted, track, j, x, u[0, j], mass[r], steady[j], error[j], law)
                else:
                    done = events.decided(
                        mode, wanted, track, j, x[0, j], x[0, LANES + j], u[0, j], mass[r], steady[j], error[j]
                    )
            if done and math.isnan(track[tracked.ENDED, j]):
                track[tracked.ENDED, j] = before + made[j, n, tracked.HOLDS]
            never_lost = math.isnan(track[tracked.LOST, j])
            if (
                timed
                and not rigged
                and math.isnan(track[tracked.DURATION, j])
                and (done or (stop_at_loss and not never_lost))
            ):
                # the tail between infinite bars belongs to the record
                events.note_duration(track, j, x, law, yielding, never_lost and end[j] == math.inf)
            if timed and rigged and done:
                events.note_momentum(track, j, u, free, rig, mass[r], speed[r], rigs[r])
            if done:
                events.finish(mode, wanted, track, j, path[j], branches[j], made[j], count[j], out[r], yielding, law)
                out[r, tracked.ANSWER_SPEED] = u[0, j]
                out[r, tracked.ANSWER_SPEEDS], out[r, tracked.ANSWER_SPEEDS + 1] = free[0, j], -free[0, LANES + j]
                status[r] = tracked.OK
                steps[r] = count[j]
                row[j] = -1
                live -= 1
                continue
            # what is read again must still be there: the whole path, or the waves of a round trip
            oldest = 0 if store or keeping else count[j]
            for bar in range(2):
                if trips[bar, j] < math.inf and time[j] < end[j]:
                    oldest = min(oldest, max(first[bar, j], 0))
            if count[j] - oldest >= capacity or count[j] >= LIMIT:
                status[r] = tracked.FULL
                row[j] = -1
                live -= 1
    return len(owned) + len(kept_steps)


#: parts that `compiled.Beside` compiles, as `march` comes upon them, with their arguments: i, f, b numbers, n an array
#: of integers, 1 to 3 arrays of so many dimensions
PARTS: tuple[tuple[Any, str], ...] = (
    (branch_ends, "n122221222n"),
    (events.look, "ii2222111nn212b2"),
    (events.after_step, "ii2i231fffffffbb2"),
    (events.finish, "ii2i332i1b2"),
)

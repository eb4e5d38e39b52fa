"""The law of a face that yields, inside the integrator: spring, virgin loading, free (theory
(C14)).

Where faces are alike and elastic the force of each is q = x^(3/2) of its approach x, with the
stiffness 1 and no onset.  Where they differ, it is kappa x^(3/2).  A face that yields has a largest
approach so far, x_m, and a dent x_r.  The integrator's variable is the approach above the dent, x -
x_r:

    spring   q = k (x - x_r)^(3/2)   until x rises through x_m (then virgin loading) or falls
                                     through x_r (then free)
    virgin   q = q_y L(x/x_y)        until dx/dt falls through 0: a spring with a new dent
    free     q = 0                   until x rises through x_r

The elastic face is the spring with x_r = 0 and x_m = x_y.  Virgin loading is linear in x, y =
sqrt(x) and l = ln((y + base)/...), so that its series costs one recurrence more:

    q = constant + by_x x + by_root y + by_log l
    l' (y + base) = y'        base = (b - 1) sqrt(x_y)

The state s has these numbers of each face of every lane, m = face LANES + lane (`tracked.STATE`);
scaled variables.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.yielding import first_loading

from .compiled import compiled
from .tracked import LANES, LINEAR, PAIR, TAIL_SHARE

#: share of x_m by which an approach has to fall below it before it can rise through it again
ARMED = 1e-13
#: dx/dt that has no sign, scaled: a turn leaves so little
STILL = 1e-10
#: switches to the other branch and back at one time, beyond which a face is at rest where both
#: meet: the force of both is the same there, and rounding would choose between them for ever
MOST_SWITCHES = 8


@compiled
def _select(condition, a, b):
    """`np.where` of numbers."""
    return a if condition else b


#: the law of first loading, compiled
_virgin_force, _virgin_slope, _virgin_area, _area_shape, _ = first_loading(_select, compiled)


@compiled
def lower(column, j):
    """The lower number of both faces of a lane."""
    return min(column[j], column[LANES + j])


@compiled
def higher(column, j):
    """The higher number of both faces of a lane."""
    return max(column[j], column[LANES + j])


@compiled
def is_pressed(s, j):
    """Whether any face of a lane is pressed."""
    return max(s.x[0, j], s.x[0, LANES + j]) > 0.0


@compiled
def new_face(s, m, pole):
    """A face before anything has yielded; pole: tracked.POLE, onset inf where it stays elastic."""
    _be_spring(s, m, pole.stiffness)
    s.dent[m] = 0.0
    s.switched_at[m] = -1.0
    s.onset[m] = pole.onset
    s.softening[m] = pole.softening
    s.pile_up[m] = pole.pile_up
    s.stiffness[m] = pole.stiffness
    s.largest[m] = s.onset[m]
    s.unit_force[m] = pole.stiffness * s.onset[m] ** 1.5
    s.peak_force[m] = s.unit_force[m]
    s.chi[m] = pole.chi


@compiled
def _be_spring(s, m, stiffness):
    """A face whose force is `stiffness` x^(3/2) of its approach above the dent."""
    s.spring[m] = s.hertz[m] = stiffness
    s.shift[m] = s.base[m] = s.constant[m] = s.start[m] = s.inverse[m] = 0.0
    s.by_x[m] = s.by_root[m] = s.by_log[m] = 0.0


@compiled
def press_on(s, m):
    """A spring whose approach rises through the largest so far: virgin loading."""
    s.spring[m] = 0.0
    onset = s.onset[m]
    b = s.softening[m]
    force = s.unit_force[m]
    side = math.sqrt(onset)
    s.shift[m] = s.dent[m]
    s.hertz[m] = 0.0
    s.by_x[m] = 1.5 * force * (1.0 + b) / onset
    s.by_root[m] = -3.0 * force * b * b / side
    s.by_log[m] = 3.0 * force * b * b * (b - 1.0)
    s.constant[m] = force * (1.0 - 1.5 * (1.0 + b) + 3.0 * b * b) + s.by_x[m] * s.dent[m]
    s.base[m] = (b - 1.0) * side


@compiled
def let_go(s, m, above):
    """Virgin loading that ends at `above` the dent: a spring with a new dent; returns the approach
    above that.
    """
    approach = above + s.dent[m]
    onset = s.onset[m]
    largest = max(approach, s.largest[m])
    force = _virgin_force(largest / onset, s.softening[m])
    area = _virgin_area(largest / onset, s.softening[m], s.pile_up[m])
    recovered = onset * force / math.sqrt(area)
    s.peak_force[m] = s.unit_force[m] * force
    s.largest[m] = largest
    s.dent[m] = largest - recovered
    _be_spring(s, m, s.peak_force[m] / (recovered * math.sqrt(recovered)))
    return approach - s.dent[m]


@compiled
def switch(s, m):
    """Put a face on its other branch, where it stands now.

    From its first yield on a row has an error of its own in one step.
    """
    j = m % LANES
    s.lane[j].by_law = 1
    s.error[j] = min(s.error[j], s.yielded_share * s.local)
    if s.spring[m] > 0.0:
        press_on(s, m)
        s.x[0, m] = s.largest[m] - s.dent[m]
    else:
        s.lane[j].unloadings += 1.0
        s.x[0, m] = let_go(s, m, s.x[0, m])


@compiled
def press_deeper(s, j):
    """The largest approach of faces on virgin loading, at the end of a step."""
    for m in range(j, PAIR, LANES):
        if s.spring[m] == 0.0:
            s.largest[m] = max(s.largest[m], s.x[0, m] + s.dent[m])


@compiled
def face_yielded(s, m):
    """Whether a face has yielded, or does."""
    return s.spring[m] == 0.0 or s.largest[m] > s.onset[m]


@compiled
def log_start(s, m, root):
    """l at the start of a step on virgin loading, from y."""
    return math.log((root + s.base[m]) / (s.softening[m] * math.sqrt(s.onset[m])))


@compiled
def start_series(s, m):
    """What the series of a force needs of the start of a step: the linear contact, virgin
    loading.
    """
    if s.mode == LINEAR:
        s.hertz[m] = 0.0
        s.by_x[m] = 0.0
        if s.x[0, m] > 0.0:
            s.by_x[m] = 1.0
    elif s.spring[m] == 0.0:
        s.start[m] = s.constant[m]
        s.inverse[m] = 0.0
        if s.by_log[m] != 0.0:
            side = math.sqrt(s.x[0, m] + s.shift[m])
            s.start[m] += s.by_log[m] * log_start(s, m, side)
            s.inverse[m] = 1.0 / (side + s.base[m])


@compiled
def face_force(s, m, above):
    """Force of a face and its derivative by the approach, `above` the dent."""
    if s.spring[m] > 0.0:
        if above <= 0.0:
            return 0.0, 0.0
        if s.mode == LINEAR:
            return above, 1.0
        side = s.spring[m] * math.sqrt(above)
        return side * above, 1.5 * side
    root = math.sqrt(max(above + s.shift[m], 1e-300))
    force = s.constant[m] + s.by_x[m] * above + s.by_root[m] * root
    slope = s.by_root[m]
    if s.by_log[m] != 0.0:
        force += s.by_log[m] * log_start(s, m, root)
        slope += s.by_log[m] / (root + s.base[m])
    return force, s.by_x[m] + 0.5 * slope / root


@compiled
def approach_at(s, m, force):
    """Approach at which virgin loading reaches a force, by Newton's method from that of Hertz,
    which lies below.

    Hertz and what follows the onset are convex.
    """
    wanted = force / s.unit_force[m]
    b = s.softening[m]
    z = wanted ** (2.0 / 3.0)
    for _ in range(60):
        change = (wanted - _virgin_force(z, b)) / _virgin_slope(z, b)
        z += change
        if abs(change) <= 1e-15 * z:
            break
    return z * s.onset[m]


@compiled
def stored_energy(s, m, above):
    """Elastic energy of a face and its derivative by the approach, (C10), in units of P_c
    alpha_c.
    """
    force, slope = face_force(s, m, above)
    if s.spring[m] > 0.0:
        return (0.5 if s.mode == LINEAR else 0.4) * force * max(above, 0.0), force
    onset = s.onset[m]
    b = s.softening[m]
    z = max((above + s.shift[m]) / onset, 1.0)
    area = _virgin_area(z, b, s.pile_up[m])
    recovered = onset * (force / s.unit_force[m]) / math.sqrt(area)
    # dA/dz of (C6) is C - (C - 1) g/(g + y - 1)
    pile_up = s.pile_up[m]
    g = _area_shape(b, s.pile_up[m])
    widens = pile_up
    if g > 0.0:
        widens -= (pile_up - 1.0) * g / (g + math.sqrt(z) - 1.0)
    return 0.4 * force * recovered, 0.4 * recovered * (
        2.0 * slope - 0.5 * force * widens / (area * onset)
    )


@compiled
def largest_approach(s, m):
    """Largest approach of a face so far: a tracked one while it has not yielded."""
    if face_yielded(s, m):
        return s.largest[m]
    return s.lane[m % LANES].peak[m // LANES]


@compiled
def largest_force(s, j):
    """Largest force of a row so far, from the largest approaches of its faces while they have not
    yielded.
    """
    lane = s.lane[j]
    found = 0.0
    for face in range(2):
        m = face * LANES + j
        if s.spring[m] == 0.0:
            found = max(found, face_force(s, m, s.largest[m] - s.dent[m])[0])
        elif s.largest[m] > s.onset[m]:
            found = max(found, s.peak_force[m])
        else:
            # of a face that has yielded this would be Hertz's force at its depth, which it never
            # had
            found = max(found, s.stiffness[m] * lane.peak[face] ** 1.5)
    return found


@compiled
def tail_level(s, j):
    """Approach above the dents below which both forces are TAIL_SHARE of the largest so far."""
    lane = s.lane[j]
    if not lane.by_law:
        return s.tail * max(lane.peak[0], lane.peak[1])
    stiffest = 0.0
    for m in range(j, PAIR, LANES):
        stiffest = max(stiffest, max(s.spring[m], s.stiffness[m]))
    return (TAIL_SHARE * largest_force(s, j) / stiffest) ** (2.0 / 3.0)


@compiled
def wrong_branch(s, m, length, beyond):
    """Whether the motion of a face starts against its branch.

    length: of the trial step, whose series changes its first term with the dent.  A spring that
    rises from its largest approach but turns before it is `beyond` it, as the error of a turn may
    leave it, stays one.
    """
    still = STILL * length
    x = s.x[0, m]
    rate = s.x[1, m]
    bow = s.x[2, m]
    if s.spring[m] == 0.0:
        return rate < -still or (rate <= still and bow < 0.0)
    rises = bow > 0.0 if rate <= still else rate * rate > -4.0 * bow * beyond
    return x >= (s.largest[m] - s.dent[m]) * (1.0 - ARMED) and rate >= -still and rises


@compiled
def most_force(s, j):
    """The larger force of lane j at most while its approaches stay below their bounds, s.top."""
    found = 0.0
    for m in range(j, PAIR, LANES):
        found = max(found, face_force(s, m, s.top[m])[0])
    return found * (1.0 + 1e-9)


@compiled
def within_spring(s, j):
    """theta at which a step from a touch ends before a spring is at its largest approach so far; 1:
    none gets there.

    The force beyond is another one.
    """
    theta = 1.0
    for m in range(j, PAIR, LANES):
        rest = s.largest[m] - s.dent[m] - s.x[0, m]
        reach = s.top[m] - s.x[0, m]
        if s.spring[m] > 0.0 and reach > rest > ARMED * s.largest[m]:
            theta = min(theta, 0.9 * rest / reach)
    return theta

"""The law of a face that yields, inside the integrator: spring, virgin loading, free (theory (C14)).

Where faces are alike and elastic the force of each is q = x^(3/2) of its approach x, and no code here runs.  Where they
differ, it is kappa x^(3/2).  A face that yields has a largest approach so far, x_m, and a dent x_r.  The integrator's
variable is the approach above the dent, x - x_r:

    spring   q = k (x - x_r)^(3/2)      until x rises through x_m (to virgin loading) or falls through x_r (free)
    virgin   q = q_y L(x/x_y)           until dx/dt falls through 0: a spring with a new dent
    free     q = 0                      until x rises through x_r

The elastic face is the spring with x_r = 0 and x_m = x_y.  Virgin loading is linear in x, y = sqrt(x) and
l = ln((y + base)/...), so that its series costs one recurrence more:

    q = constant + by_x x + by_root y + by_log l        l' (y + base) = y'        base = (b - 1) sqrt(x_y)

`law` holds these numbers of every lane and face, (NUMBERS, PAIR); scaled variables.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.tracked import (
    BASE,
    BY_LOG,
    BY_ROOT,
    BY_X,
    CHI,
    CONSTANT,
    DENT,
    HERTZ,
    INNER,
    LANES,
    LARGEST,
    LAW_ONSET,
    LAW_PILE_UP,
    LAW_SHARE,
    LAW_SOFTENING,
    LAW_STIFFNESS,
    ONSET,
    PEAK,
    PILE_UP,
    SHIFT,
    SOFTENING,
    SPRING,
    STIFFNESS,
    UNIT,
    UNLOADINGS,
)
from uqsphere.mechanics.integrator.vectors import apart

#: share of x_m by which an approach has to fall below it before it can rise through it again
ARMED = 1e-13
#: dx/dt that has no sign, scaled: a turn leaves so little
STILL = 1e-10
#: turns to the other branch and back at one time, beyond which a face is at rest where both meet: the force of both is
#: the same there, and rounding would choose between them for ever
MOST_TURNS = 8


@compiled(**INNER)
def _bend(t):
    """G(t) = t²/2 - t + ln(1 + t), see `uqsphere.mechanics.yielding`; what cancels here is 1e-12 of a force."""
    if t > 0.02:
        return 0.5 * t * t - t + math.log1p(t)
    total = 0.0
    for k in range(12, 2, -1):
        total = 1.0 / k - t * total
    return total * t * t * t


@compiled(**INNER)
def _virgin_force(z, b):
    """L at z >= 1, (C5)."""
    s = math.sqrt(z) - 1.0
    force = 1.0 + 3.0 * s + (1.5 if b == 0.0 else 3.0) * s * s
    return force + 3.0 * b * b * (b - 1.0) * _bend(s / b) if b > 0.0 else force


@compiled(**INNER)
def _virgin_area(z, b, pile_up):
    """A at z >= 1, (C6)."""
    s, g = math.sqrt(z) - 1.0, 5.0
    if pile_up > 1.0:
        g = min(5.0, pile_up * b * b / ((pile_up - 1.0) * (1.0 + b)))
    if g == 0.0:
        return 1.0 + pile_up * s * (2.0 + s)
    area = 1.0 + 2.0 * s + s * s * (1.0 + (pile_up - 1.0) / g)
    return area + 2.0 * (pile_up - 1.0) * g * (g - 1.0) * _bend(s / g)


@compiled(**INNER)
def new_faces(law, lane, given):
    """Both faces of a row before anything has yielded; given (LAWS, 2), onset inf where a face stays elastic."""
    apart()
    for face in range(2):
        m = face * LANES + lane
        for k in range(law.shape[0]):
            law[k, m] = 0.0
        onset, stiffness = given[LAW_ONSET, face], given[LAW_STIFFNESS, face]
        law[ONSET, m], law[SOFTENING, m], law[PILE_UP, m] = onset, given[LAW_SOFTENING, face], given[LAW_PILE_UP, face]
        law[STIFFNESS, m], law[SPRING, m], law[LARGEST, m] = stiffness, stiffness, onset
        law[UNIT, m], law[HERTZ, m] = stiffness * onset**1.5, stiffness
        law[PEAK, m], law[CHI, m] = law[UNIT, m], given[LAW_SHARE, face]


@compiled(**INNER)
def press_on(law, m):
    """A spring whose approach rises through the largest so far: virgin loading."""
    apart()
    law[SPRING, m] = 0.0
    onset, b = law[ONSET, m], law[SOFTENING, m]
    force, side = law[UNIT, m], math.sqrt(onset)
    law[SHIFT, m], law[HERTZ, m] = law[DENT, m], 0.0
    law[BY_X, m] = 1.5 * force * (1.0 + b) / onset
    law[BY_ROOT, m] = -3.0 * force * b * b / side
    law[BY_LOG, m] = 3.0 * force * b * b * (b - 1.0)
    law[CONSTANT, m] = force * (1.0 - 1.5 * (1.0 + b) + 3.0 * b * b) + law[BY_X, m] * law[DENT, m]
    law[BASE, m] = (b - 1.0) * side


@compiled(**INNER)
def let_go(law, m, above):
    """Virgin loading that ends at `above` the dent: a spring with a new dent; returns the approach above that."""
    apart()
    approach, onset = above + law[DENT, m], law[ONSET, m]
    largest = max(approach, law[LARGEST, m])
    force = _virgin_force(largest / onset, law[SOFTENING, m])
    area = _virgin_area(largest / onset, law[SOFTENING, m], law[PILE_UP, m])
    recovered = onset * force / math.sqrt(area)
    law[PEAK, m] = law[UNIT, m] * force
    law[LARGEST, m], law[DENT, m] = largest, largest - recovered
    law[SPRING, m] = law[PEAK, m] / (recovered * math.sqrt(recovered))
    law[HERTZ, m] = law[SPRING, m]
    law[SHIFT, m], law[BY_X, m], law[BY_ROOT, m], law[BY_LOG, m], law[CONSTANT, m] = 0.0, 0.0, 0.0, 0.0, 0.0
    return approach - law[DENT, m]


@compiled(**INNER)
def switch(law, m, above, track, lane):
    """The other branch of a face at `above` its dent; returns the approach above the dent that it has then."""
    if law[SPRING, m] > 0.0:
        press_on(law, m)
        return law[LARGEST, m] - law[DENT, m]
    track[UNLOADINGS, lane] += 1.0
    return let_go(law, m, above)


@compiled(**INNER)
def press_deeper(law, lane, x):
    """The largest approach of faces on virgin loading, at the end of a step."""
    for face in range(2):
        m = face * LANES + lane
        if law[SPRING, m] == 0.0:
            law[LARGEST, m] = max(law[LARGEST, m], x[0, m] + law[DENT, m])


@compiled(**INNER)
def on_virgin_loading(law, lane):
    """Whether a face of a lane yields now."""
    return law[SPRING, lane] == 0.0 or law[SPRING, LANES + lane] == 0.0


@compiled(**INNER)
def face_yielded(law, m):
    """Whether a face has yielded, or does."""
    return law[SPRING, m] == 0.0 or law[LARGEST, m] > law[ONSET, m]


@compiled(**INNER)
def of_its_own(law, lane):
    """Whether the force of a face of a lane is no longer x^(3/2): it has yielded, or the faces differ."""
    for face in range(2):
        m = face * LANES + lane
        if law[STIFFNESS, m] != 1.0 or face_yielded(law, m):
            return True
    return False


@compiled(**INNER)
def log_start(law, m, root):
    """l at the start of a step on virgin loading, from y."""
    return math.log((root + law[BASE, m]) / (law[SOFTENING, m] * math.sqrt(law[ONSET, m])))


@compiled(**INNER)
def face_force(law, m, above):
    """Force of a face and its derivative by the approach, `above` the dent."""
    if law[SPRING, m] > 0.0:
        if above <= 0.0:
            return 0.0, 0.0
        side = law[SPRING, m] * math.sqrt(above)
        return side * above, 1.5 * side
    root = math.sqrt(max(above + law[SHIFT, m], 1e-300))
    force, slope = law[CONSTANT, m] + law[BY_X, m] * above + law[BY_ROOT, m] * root, law[BY_ROOT, m]
    if law[BY_LOG, m] != 0.0:
        force += law[BY_LOG, m] * log_start(law, m, root)
        slope += law[BY_LOG, m] / (root + law[BASE, m])
    return force, law[BY_X, m] + 0.5 * slope / root


@compiled(**INNER)
def _virgin(law, m, approach):
    """Force of a face at its largest approach so far, and its derivative; elastic below the onset."""
    onset, z = law[ONSET, m], approach / law[ONSET, m]
    if z <= 1.0:
        side = law[STIFFNESS, m] * math.sqrt(approach)
        return side * approach, 1.5 * side
    b, y = law[SOFTENING, m], math.sqrt(z)
    # (C4)
    slope = 1.5 * ((1.0 + b) * y - 1.0) / (y + b - 1.0) if b > 0.0 else 1.5
    return law[UNIT, m] * _virgin_force(z, b), law[UNIT, m] * slope / onset


@compiled(**INNER)
def approach_at(law, m, force):
    """Approach at which virgin loading reaches a force, by Newton's method from that of Hertz, which lies below.

    Hertz and what follows the onset are convex.
    """
    apart()
    found = (force / law[STIFFNESS, m]) ** (2.0 / 3.0)
    for _ in range(60):
        reached, slope = _virgin(law, m, found)
        following = found - (reached - force) / slope
        if abs(following - found) <= 1e-15 * found:
            break
        found = following
    return found


@compiled(**INNER)
def stored_energy(law, m, above):
    """Elastic energy of a face and its derivative by the approach, (C10), in units of P_c alpha_c."""
    force, slope = face_force(law, m, above)
    if law[SPRING, m] > 0.0:
        return 0.4 * force * max(above, 0.0), force
    onset, b = law[ONSET, m], law[SOFTENING, m]
    z = max((above + law[SHIFT, m]) / onset, 1.0)
    area = _virgin_area(z, b, law[PILE_UP, m])
    recovered = onset * (force / law[UNIT, m]) / math.sqrt(area)
    # dA/dz of (C6) is C - (C - 1) g/(g + y - 1)
    pile_up, g = law[PILE_UP, m], 5.0
    if pile_up > 1.0:
        g = min(5.0, pile_up * b * b / ((pile_up - 1.0) * (1.0 + b)))
    widens = pile_up - ((pile_up - 1.0) * g / (g + math.sqrt(z) - 1.0) if g > 0.0 else 0.0)
    return 0.4 * force * recovered, 0.4 * recovered * (2.0 * slope - 0.5 * force * widens / (area * onset))


@compiled(**INNER)
def largest_approach(law, m, known):
    """Largest approach of a face so far, where `known` is that while it has not yielded."""
    return law[LARGEST, m] if face_yielded(law, m) else known


@compiled(**INNER)
def largest_force(law, lane, known_a, known_b):
    """Largest force of a row so far, from the largest approaches of its faces while they have not yielded."""
    found = 0.0
    for face in range(2):
        m = face * LANES + lane
        if law[SPRING, m] == 0.0:
            found = max(found, face_force(law, m, law[LARGEST, m] - law[DENT, m])[0])
        elif law[LARGEST, m] > law[ONSET, m]:
            found = max(found, law[PEAK, m])
        else:
            # of a face that has yielded this would be Hertz's force at its depth, which it never had
            found = max(found, law[STIFFNESS, m] * (known_b if face == 1 else known_a) ** 1.5)
    return found


@compiled(**INNER)
def tail_level(law, lane, known_a, known_b, share):
    """Approach above the dents below which both forces are `share` of the largest so far."""
    stiffest = 0.0
    for face in range(2):
        m = face * LANES + lane
        stiffest = max(stiffest, max(law[SPRING, m], law[STIFFNESS, m]))
    return (share * largest_force(law, lane, known_a, known_b) / stiffest) ** (2.0 / 3.0)


@compiled(**INNER)
def wrong_branch(law, m, x, length, beyond, track, lane):
    """Bring a face whose motion starts against its branch to the other one; whether it was.

    x (TERMS, PAIR): the series of the step, of length `length`; its first term is changed with the dent.  A spring that
    rises from its largest approach but turns before it is `beyond` it, as the error of a turn may leave it, stays one.
    """
    apart()
    still = STILL * length
    if law[SPRING, m] == 0.0:
        if x[1, m] < -still or (x[1, m] <= still and x[2, m] < 0.0):
            x[0, m] = switch(law, m, x[0, m], track, lane)
            return True
        return False
    room = law[LARGEST, m] - law[DENT, m]
    rises = x[2, m] > 0.0 if x[1, m] <= still else x[1, m] * x[1, m] > -4.0 * x[2, m] * beyond
    if x[0, m] >= room * (1.0 - ARMED) and x[1, m] >= -still and rises:
        x[0, m] = switch(law, m, x[0, m], track, lane)
        return True
    return False


@compiled(**INNER)
def may_be_wrong(law, m, x, length):
    """Whether `wrong_branch` has to look at a face."""
    if law[SPRING, m] == 0.0:
        return x[1, m] <= STILL * length
    return x[0, m] >= (law[LARGEST, m] - law[DENT, m]) * (1.0 - ARMED)


@compiled(**INNER)
def most_force(law, lane, top):
    """The larger force of a lane at most, while its approaches stay below `top` (PAIR,)."""
    found = 0.0
    for m in range(lane, 2 * LANES, LANES):
        found = max(found, face_force(law, m, top[m])[0])
    return found * (1.0 + 1e-9)


@compiled(**INNER)
def most_stored(law, lane, top):
    """Elastic energy that a lane stores at most while its approaches stay below `top` (PAIR,)."""
    found = 0.0
    for m in range(lane, 2 * LANES, LANES):
        found += stored_energy(law, m, top[m])[0]
    return found


@compiled(**INNER)
def within_spring(law, lane, x, top):
    """Share of a step from a touch that ends before a spring is at its largest approach so far; 1: none gets there.

    The force beyond is another one.  x (TERMS, PAIR): approaches at the start; top (PAIR,): bounds of them in the step.
    """
    share = 1.0
    for m in range(lane, 2 * LANES, LANES):
        rest = law[LARGEST, m] - law[DENT, m] - x[0, m]
        if law[SPRING, m] > 0.0 and top[m] - x[0, m] > rest > ARMED * law[LARGEST, m]:
            share = min(share, 0.9 * rest / (top[m] - x[0, m]))
    return share

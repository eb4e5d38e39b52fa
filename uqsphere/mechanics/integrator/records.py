"""When a record ends: of a rig once its echoes have acted, of bars once no harder squeeze can come.

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

from uqsphere.mechanics.integrator import searches
from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import face_yielded, largest_force, on_virgin_loading
from uqsphere.mechanics.integrator.tracked import (
    CELLS,
    FACE_A,
    FACE_B,
    LANES,
    LINEAR,
    MASSLESS,
    ORDER,
    End,
)
from uqsphere.mechanics.integrator.vectors import apart

#: parts of a step of which a wave is bounded one by one
_PARTS = 2
#: cells of all round trips that are followed at most; a row that needs more goes on
_MOST_CELLS = 4096


@compiled
def echoes_have_acted(s, j):
    """Time from which no echo can close the gaps of a rig again that both grow.

    A contact sends compression into a bar.  A far end with R >= 0 sends it back as tension, which
    only opens the gap.  One with R < 0 sends back compression; what the gap's free end returns of
    that comes back as tension, and so on with alternating signs: two round trips after the last
    contact every echo of it has come once with either sign, each later one is weaker (|R| <= 1),
    and the gap has grown in between.
    """
    wait = 0.0
    for bar in range(2):
        if s.reflect[bar, j] < 0.0 and s.trips[bar, j] < math.inf:
            wait = max(wait, 2.0 * s.trips[bar, j])
    return s.parted[j] + wait * (1.0 + 1e-12) if wait > 0.0 else -math.inf


@compiled
def _wave(kept, bar, theta):
    """The wave that left a face in a kept step, and its derivative, at a share of the step."""
    value, slope = kept.wave[bar, ORDER], 0.0
    for k in range(ORDER - 1, -1, -1):
        slope = slope * theta + value
        value = value * theta + kept.wave[bar, k]
    return value, slope


@compiled
def _bound_waves(s, j, bar, made):
    """Bounds of the wave that a bar sends back during the next round trip, in cells of time.

    s.cell_end, s.cell_wave (2, CELLS): when each cell ends, and the wave in it at most.  Returns
    how many there are, or -1 for too many.
    """
    apart()
    trip, newest, count = s.trips[bar, j], s.count[j] - 1, 0
    begin = s.time[j] - trip
    if begin < 0.0:  # nothing has left the face before first touch
        s.cell_end[bar, 0], s.cell_wave[bar, 0] = trip, 0.0
        begin, count = 0.0, 1
    n = max(s.first[bar, j], 0)
    while n < newest:
        kept = made[j, n & (s.ring - 1)]
        if kept.began + kept.holds > begin:
            break
        n += 1
    for step in range(n, newest + 1):
        kept = made[j, step & (s.ring - 1)]
        if kept.began + trip >= s.end[j]:
            break
        if count + _PARTS > CELLS:
            return -1
        first, last = max(begin - kept.began, 0.0) / kept.unit, kept.holds / kept.unit
        width = (last - first) / _PARTS
        left, left_slope = _wave(kept, bar, first)
        for part in range(1, _PARTS + 1):
            theta = first + part * width
            right, right_slope = _wave(kept, bar, theta)
            s.cell_wave[bar, count] = searches.highest_between(
                left, width * left_slope, right, width * right_slope
            )
            s.cell_end[bar, count] = kept.began + kept.unit * theta + trip
            left, left_slope, count = right, right_slope, count + 1
    return count


@compiled
def _after(s, j, squeeze, drive, stiffness, length):
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
    decay = -math.expm1(-rate * length) / rate if rate * length > 1e-9 else length
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
    apart()
    if not s.has_laws:
        largest = max(s.peak[FACE_A, j], s.peak[FACE_B, j])
        return (largest if s.mode == MASSLESS else 0.5 * largest), 1.0
    if on_virgin_loading(s, j):
        return 0.0, 1.0
    force, soft, stiff = largest_force(s, j), math.inf, 0.0
    for m in range(j, 2 * LANES, LANES):
        elastic_to = s.peak_force[m] if face_yielded(s, m) else s.unit_force[m]
        force = min(force, elastic_to)
        soft, stiff = min(soft, s.spring[m]), max(stiff, s.spring[m])
    approach = (force / stiff) ** (2.0 / 3.0)
    return (approach if s.mode == MASSLESS else 0.5 * approach), soft


@compiled
def approach_alone(s, j, theta):
    """Approach that the sphere's own speed gives one face where a step ends with the loss of the
    other; 0 if that falls already.
    """
    m = (1 - s.side[j]) * LANES + j
    x, slope = searches.both_of(s.x, m, theta)
    if s.why[j] != End.CONTACT or s.spring[m] == 0.0 or x <= 0.0 or slope <= 0.0:
        return 0.0
    rate = slope / s.h[j]
    energy = s.mass[j] * rate * rate
    if s.mode == LINEAR:
        return math.sqrt(x * x + energy)
    return (x * x * math.sqrt(x) + 1.25 * energy / s.spring[m]) ** 0.4


@compiled
def no_harder_squeeze(s, j, alone, made):
    """Whether the faces of two bars can no longer squeeze the sphere harder than they have, at a
    loss of contact.

    alone: what the sphere reaches at the other face alone.  False where it cannot be told: while
    the pulse comes in, a face yields, or a far end has R < 0.
    """
    apart()
    largest, stiffness = _largest_squeeze(s, j)
    squeeze = 0.5 * (s.x[0, j] + s.x[0, LANES + j])
    if s.time[j] < s.pulse_end[j] or squeeze > largest or alone > 2.0 * largest:
        return False
    cells_a, cells_b, highest = 0, 0, 0.0
    for bar in range(2):
        count = 0
        if s.trips[bar, j] < math.inf:
            if s.reflect[bar, j] < 0.0:
                return False
            count = _bound_waves(s, j, bar, made)
        if count < 0:
            return False
        top = 0.0
        for i in range(count):
            top = max(top, s.cell_wave[bar, i])
        highest += s.reflect[bar, j] * top if count > 0 else 0.0
        if bar == 0:
            cells_a = count
        else:
            cells_b = count
    rest = highest if s.mode == LINEAR else (highest / stiffness) ** (2.0 / 3.0)
    if rest <= largest or cells_a + cells_b == 0:
        return True
    return _stays_below(s, j, squeeze, largest, stiffness, cells_a, cells_b)


@compiled
def _stays_below(s, j, squeeze, largest, stiffness, cells_a, cells_b):
    """Whether s stays below `largest` up to the horizon under the bounds of the waves."""
    apart()
    time, end, at_start, alike = s.time[j], s.end[j], squeeze, False
    if cells_a == 0 or cells_b == 0:
        alike = s.reflect[1 if cells_a == 0 else 0, j] == 1.0
    elif abs(s.trips[0, j] - s.trips[1, j]) < 1e-9 * s.trips[0, j]:
        alike = s.reflect[0, j] == 1.0 and s.reflect[1, j] == 1.0
    weight_a, weight_b, shift_a, shift_b = s.reflect[0, j], s.reflect[1, j], 0.0, 0.0
    a, b = 0, 0
    for _ in range(_MOST_CELLS):
        until_a = s.cell_end[0, a] + shift_a if cells_a > 0 else math.inf
        until_b = s.cell_end[1, b] + shift_b if cells_b > 0 else math.inf
        until = min(min(until_a, until_b), end)
        drive = weight_a * s.cell_wave[0, a] if cells_a > 0 else 0.0
        drive += weight_b * s.cell_wave[1, b] if cells_b > 0 else 0.0
        if until > time:
            squeeze = _after(s, j, squeeze, drive, stiffness, until - time)
            time = until
        if squeeze > largest:
            return False
        if time >= end:
            return True
        wrapped = False
        if until_a <= time:
            a += 1
            if a == cells_a:
                a, shift_a, weight_a = 0, shift_a + s.trips[0, j], weight_a * s.reflect[0, j]
                wrapped = True
        if until_b <= time:
            b += 1
            if b == cells_b:
                b, shift_b, weight_b = 0, shift_b + s.trips[1, j], weight_b * s.reflect[1, j]
                wrapped = True
        if wrapped and alike and a == 0 and b == 0:
            if squeeze <= at_start:  # the same waves come again, to a looser sphere
                return True
            at_start = squeeze
    return False

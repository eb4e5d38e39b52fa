"""The open gaps of a rig: whether and when one closes again, and the round trips in which none can.

The gaps of a rig open and close evenly while no force acts, but for the echoes in its bar.  What a
face sends out while its gap is open comes back as the same wave times R, so that from then on every
round trip repeats the last one, times R.  A contact sends compression into a bar:

    R >= 0   comes back as tension, which only opens the gap.  One that grows without echoes never
             closes.  One that does not closes in the end where R < 1; where R = 1, only if a round
             trip closes it by more than the echoes open it
    R < 0    comes back as compression, and what the gap's free end returns of that as tension, with
             alternating signs: two round trips after the last contact every echo of it has come
             once with either sign, each later one is weaker, and the gap has grown in between

A gap that closes in the end may do so after a million round trips: those in which it cannot are
passed in one leap (`_leap`).  Scaled variables.
"""

from __future__ import annotations

import math
from math import inf, nan

from .compiled import compiled
from .events import NODES, WEIGHTS, rise_of
from .faces import is_pressed
from .tracked import ADDED_UP, LANES, TERMS, WAVE

#: round trips after which a gap that has not closed never does: its rate is zero but for rounding
_FOREVER = 1e9


@compiled
def fly_on(s, j, past):
    """Move a rig of which no face is pressed on by the round trips in which no gap can close.

    Returns how long it then is until one closes while no force acts: inf if none closes again, at
    most a round trip as long as an echo may close one, NaN while a face is pressed.
    """
    lane = s.lane[j]
    if is_pressed(s, j):
        return nan
    ahead = inf
    for face in range(2):
        rate = closing_rate(s, j, face)
        if lane.trips[face] < inf:
            never, trips, opens = _round_trips_open(s, j, face, past, ahead)
            if trips > 0:
                _leap(s, j, face, past, trips, opens)
            if not never:
                ahead = min(ahead, lane.trips[face])
        elif rate > 0.0:
            ahead = min(ahead, -s.x[0, face * LANES + j] / rate)
    return ahead


@compiled
def closing_rate(s, j, face):
    """Rate at which a gap closes while no force acts, but for echoes."""
    m = face * LANES + j
    return s.there[m] * (s.free[0, m] + (2.0 * face - 1.0) * s.u[0, j])


@compiled
def rate_error(s, j, face):
    """What the errors of single steps may add up to in the rate at which a gap closes; 0 where
    nothing stands.
    """
    m = face * LANES + j
    scale = s.u_size[j]
    if s.lightness[m] > 0.0:
        scale += s.free_size[m]
    return s.there[m] * ADDED_UP * s.error[j] * scale


@compiled
def _opened_by_echoes(s, j, bar, past):
    """How much the echoes of the last round trip open the gap at a bar in the next one."""
    lane = s.lane[j]
    begin = lane.time - lane.trips[bar]
    opens = 0.0
    for step in range(lane.first[bar], lane.count):
        earlier = past[j, step & (s.ring - 1)]
        first = max(begin - earlier.began, 0.0) / earlier.unit
        width = max(earlier.holds / earlier.unit - first, 0.0)
        for i in range(WAVE):
            wave, _ = rise_of(earlier.wave, bar, first + width * NODES[i])
            opens -= 2.0 * lane.reflect[bar] * WEIGHTS[i] * wave * width * earlier.unit
    return opens


@compiled
def _round_trips_open(s, j, bar, past, ahead):
    """Whether the gap at the bar of a rig never closes again while no force acts; if it does, the
    whole round trips in which no gap can close, and how much echoes open it in the first of them.

    ahead: until the other one closes.
    """
    lane = s.lane[j]
    rate = closing_rate(s, j, bar)
    trip = lane.trips[bar]
    waited = lane.time >= lane.parted + 2.0 * trip * (1.0 + 1e-12)
    if lane.reflect[bar] < 0.0:
        return waited and rate <= 0.0, 0, 0.0
    if not waited or (rate <= 0.0 and ahead == inf):
        return rate <= 0.0, 0, 0.0
    # each round trip repeats what is left of the echoes of the last one, which only open
    opens = _opened_by_echoes(s, j, bar, past)
    trips = _trips_open(-s.x[0, bar * LANES + j], rate * trip, opens, lane.reflect[bar])
    never = trips > _FOREVER
    trips = min(min(trips, _FOREVER), min(ahead, lane.record_end - lane.time) / trip)
    whole = math.ceil(trips) - 1
    if whole < 1 or (never and ahead == inf):
        return never, 0, 0.0
    return False, whole, opens


@compiled
def _trips_open(gap, closes, opens, reflects):
    """Round trips for which a gap stays open, at least.

    It closes by `closes` in each without echoes; these open it by `opens` in the first one, and by
    `reflects` times as much in each that follows.
    """
    if closes <= 0.0:
        return inf
    # it stays open while it exceeds what it closes by; and, where it was open all over the last
    # round trip, until it is as wide after n more as R^n of it: the n powers of R that the echoes
    # then add up to exceed n - n (n - 1) (1 - R)/2; for ever where R is 1, since division by zero
    # is infinite here
    trips = gap / closes
    holds = opens + (1.0 - reflects) * gap
    if holds > closes:
        trips = max(trips, 1.0 + 2.0 * (1.0 - closes / holds) / (1.0 - reflects))
    return trips


@compiled
def _leap(s, j, bar, past, trips, opens):
    """Move the bodies of a rig and the waves in its bar on by round trips, each of which repeats
    the echoes of the last one times R; opens: by how much they open the gap in the first one.

    The steps that these waves left in move with them.  All lie behind the last loss of contact,
    two round trips ago or more, so that no force was first reached in one (`events.first_at`).
    """
    lane = s.lane[j]
    reflects = lane.reflect[bar]
    length = trips * lane.trips[bar]
    left = reflects**trips  # share of the waves
    if reflects < 1.0:
        opens *= (1.0 - left) / (1.0 - reflects)
    else:
        opens *= trips
    s.x[0, bar * LANES + j] -= opens
    for face in range(2):
        s.x[0, face * LANES + j] += length * closing_rate(s, j, face)
    for step in range(lane.first[bar], lane.count):
        earlier = past[j, step & (s.ring - 1)]
        earlier.began += length
        for k in range(TERMS):
            earlier.wave[k, bar] *= left
    lane.time += length
    lane.next_jump = min(lane.next_jump + length, lane.record_end)

"""Answers of a row whose record has ended: what was tracked, and the times at which thresholds were passed."""

from __future__ import annotations

import math

from uqsphere.mechanics.compiled import compiled
from uqsphere.mechanics.events import passage
from uqsphere.mechanics.layout import (
    ANSWER_CONTACT,
    ANSWER_CONTACT_CENSORED,
    ANSWER_DEPTH,
    ANSWER_DIFFERENCE,
    ANSWER_END,
    ANSWER_ENERGY,
    ANSWER_LOSS_RATE,
    ANSWER_NEAREST,
    ANSWER_RISE,
    ANSWER_RISES,
    ANSWER_WIDTH,
    ANSWER_WIDTH_CENSORED,
    ANSWER_WIDTHS,
    ANSWER_X_FIRST,
    ANSWER_X_MAX,
    DEPTH,
    DIFFERENCE,
    ENDED,
    ENERGY,
    FACE_A,
    LOSS_RATE,
    LOST,
    NEAREST,
    WANT_DIFFERENCE,
    WANT_ENERGY,
    WANT_RISE,
    WANT_WIDTH,
    X_FIRST,
)
from uqsphere.mechanics.series import INNER
from uqsphere.mechanics.vectors import apart

__all__ = ["finish"]


@compiled(**INNER)
def _outermost(path, scale, start, length, crest, count, ended, level, backward):
    """Time at which the larger approach first reaches `level`, or last on the way back; arrays of one lane."""
    apart()
    for i in range(count):
        n = count - 1 - i if backward else i
        if crest[n] < level:
            continue
        end = min(length[n], ended - start[n]) / scale[n]
        a, b = (end, 0.0) if backward else (0.0, end)
        best = math.nan
        for face in range(2):
            found = passage(path[n], face, level, 1.0, a, b)
            if math.isnan(best) or (found > best if backward else found < best):
                best = found
        if not math.isnan(best):
            return start[n] + best * scale[n]
    return math.nan


@compiled(**INNER)
def _passages(mode, wanted, path, scale, start, length, crest, count, ended, largest, shift):
    """Width, whether it is censored, and rise of the larger force, its thresholds times `shift`; NaN if not wanted."""
    apart()
    power = 1.0 if mode == 1 else 2.0 / 3.0
    width, censored, rise = math.nan, 0.0, math.nan
    if wanted & WANT_WIDTH:
        half = largest * 0.5**power * shift
        above = _outermost(path, scale, start, length, crest, count, ended, half, False)
        below = _outermost(path, scale, start, length, crest, count, ended, half, True)
        # the last crossing is the record's end itself where the force is still above
        width, censored = below - above, 1.0 if below >= ended * (1.0 - 1e-14) else 0.0
    if wanted & WANT_RISE:
        tenth = _outermost(path, scale, start, length, crest, count, ended, largest * 0.1**power * shift, False)
        nine = _outermost(path, scale, start, length, crest, count, ended, largest * 0.9**power * shift, False)
        rise = nine - tenth
    return width, censored, rise


@compiled(**INNER)
def finish(mode, wanted, track, lane, path, scale, start, length, crest, count, unsure, out):
    """Answers of a row that has ended, in scaled variables; path, scale, start, length, crest of its lane.

    unsure: share by which a threshold may be off.
    """
    apart()
    ended = track[ENDED, lane]
    if math.isnan(ended):
        newest = (count - 1) % len(start)
        ended = start[newest] + length[newest]
    largest = track[FACE_A, lane]
    out[ANSWER_X_MAX] = largest
    out[ANSWER_X_FIRST] = track[X_FIRST, lane]
    out[ANSWER_END] = ended
    lost = not math.isnan(track[LOST, lane])
    out[ANSWER_CONTACT] = track[LOST, lane] if lost else ended
    out[ANSWER_CONTACT_CENSORED] = 0.0 if lost else 1.0
    out[ANSWER_LOSS_RATE] = track[LOSS_RATE, lane] if lost else math.nan
    if wanted & WANT_DIFFERENCE:
        out[ANSWER_DIFFERENCE] = track[DIFFERENCE, lane]
    if wanted & WANT_ENERGY:
        out[ANSWER_ENERGY] = track[ENERGY, lane]
    out[ANSWER_DEPTH], out[ANSWER_NEAREST] = track[DEPTH, lane], track[NEAREST, lane]
    if wanted & (WANT_WIDTH | WANT_RISE) == 0:
        return
    for k in range(3):
        # each threshold is also taken a little lower and higher: where it is then passed one oscillation sooner or
        # later, the answer is a jump
        shift = 1.0 + (k - 1.0) * unsure
        width, censored, rise = _passages(mode, wanted, path, scale, start, length, crest, count, ended, largest, shift)
        if k == 1:
            out[ANSWER_WIDTH], out[ANSWER_WIDTH_CENSORED], out[ANSWER_RISE] = width, censored, rise
        else:
            side = k // 2
            out[ANSWER_WIDTHS + side], out[ANSWER_RISES + side] = width, rise

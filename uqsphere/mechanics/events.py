"""What happens inside the steps of a row: peaks, loss of contact, threshold crossings.

All searches run on the polynomials of a step, in theta = 0 ... 1, so that an event is located far better
than the steps are long.  The functions are compiled and work on the scaled variables of theory (9).
"""

from __future__ import annotations

import math

import numpy as np

from uqsphere.mechanics.compiled import compiled

__all__ = ["ANSWERS", "after_step", "begin", "finish", "value"]

#: status of a row
OK, DOMAIN, TOO_LONG_PULSE, STUCK, CROWDED, FULL, NOT_FINITE = range(7)

# trackers of a lane while its row runs
X_MAX, D_MAX, W_MAX, TOUCHED_A, TOUCHED_B, LOST, X_FIRST, ENDED = range(8)
TRACKS = 8

# answers of a row, scaled: approach, force difference, energy, times
(ANSWER_X_MAX, ANSWER_X_FIRST, ANSWER_DIFFERENCE, ANSWER_ENERGY, ANSWER_CONTACT, ANSWER_CONTACT_CENSORED,
 ANSWER_WIDTH, ANSWER_WIDTH_CENSORED, ANSWER_RISE, ANSWER_END) = range(10)  # fmt: skip
ANSWERS = 10

#: what the searches look at: approach of either face, difference of the forces, stored energy
FACE_A, FACE_B, DIFFERENCE, ENERGY = range(4)
KINDS = 4
#: forces below this share of the largest end the record on infinite bars
TAIL_SHARE = 0.01
#: points at which a step is scanned before an event is refined
SCAN = 6


@compiled()
def value(path, lane, n, state, theta):  # type: ignore[no-untyped-def]
    """State 0, 1 or 2 (x1, x2, u) of a lane inside its step n."""
    total = path[lane, n, state, 7]
    for k in range(6, -1, -1):
        total = total * theta + path[lane, n, state, k]
    return total


@compiled()
def slope(path, lane, n, state, theta):  # type: ignore[no-untyped-def]
    """Its derivative by theta."""
    total = 7.0 * path[lane, n, state, 7]
    for k in range(6, 0, -1):
        total = total * theta + k * path[lane, n, state, k]
    return total


@compiled()
def _combine(kind, mode, x1, x2, d1, d2):  # type: ignore[no-untyped-def]
    """Value and derivative of a searched function from the approaches and their derivatives."""
    if kind == FACE_A:
        return x1, d1
    if kind == FACE_B:
        return x2, d2
    if x1 <= 0.0:
        x1, d1 = 0.0, 0.0
    if x2 <= 0.0:
        x2, d2 = 0.0, 0.0
    if mode == 1:
        if kind == DIFFERENCE:
            return x1 - x2, d1 - d2
        return 0.5 * (x1 * x1 + x2 * x2), x1 * d1 + x2 * d2
    root1 = math.sqrt(x1)
    root2 = math.sqrt(x2)
    if kind == DIFFERENCE:
        return x1 * root1 - x2 * root2, 1.5 * (root1 * d1 - root2 * d2)
    return 0.4 * (x1 * x1 * root1 + x2 * x2 * root2), x1 * root1 * d1 + x2 * root2 * d2


@compiled()
def look_at_ends(mode, state, new, slopes, step, ends):  # type: ignore[no-untyped-def]
    """Value and derivative (by theta) of every searched function at both ends of every lane's step.

    ends : (KINDS, 4, lanes), in the order value and derivative at the start, value and derivative at the end.
    """
    lanes = len(step)
    for kind in range(KINDS):
        for l in range(lanes):
            k = lanes + l
            ends[kind, 0, l], ends[kind, 1, l] = _combine(
                kind, mode, state[l], state[k], step[l] * slopes[0, l], step[l] * slopes[0, k]
            )
            ends[kind, 2, l], ends[kind, 3, l] = _combine(
                kind, mode, new[l], new[k], step[l] * slopes[12, l], step[l] * slopes[12, k]
            )


@compiled()
def _measure(kind, mode, path, lane, n, theta):  # type: ignore[no-untyped-def]
    """Value and derivative of one of the searched functions inside a step."""
    return _combine(
        kind, mode, value(path, lane, n, 0, theta), value(path, lane, n, 1, theta),
        slope(path, lane, n, 0, theta), slope(path, lane, n, 1, theta),
    )  # fmt: skip


@compiled()
def _largest(kind, mode, path, lane, n, ends, theta_end, known):  # type: ignore[no-untyped-def]
    """Largest absolute value of a searched function in [0, theta_end], or `known` if that is larger."""
    left, left_slope, right, right_slope = ends[kind, 0, lane], ends[kind, 1, lane], ends[kind, 2, lane], ends[kind, 3, lane]
    # a function whose ends and slopes cannot carry it above what is known is not searched
    top = max(abs(left), abs(right))
    if top + 0.3 * (abs(left_slope) + abs(right_slope)) <= known:
        return known
    if theta_end < 1.0:
        right, right_slope = _measure(kind, mode, path, lane, n, theta_end)
        top = max(abs(left), abs(right))
    best = max(known, top)
    # nor one whose slope keeps its sign and stays well away from zero
    _, middle_slope = _measure(kind, mode, path, lane, n, 0.5 * theta_end)
    steepest = max(abs(left_slope), max(abs(middle_slope), abs(right_slope)))
    if left_slope * middle_slope > 0.0 and middle_slope * right_slope > 0.0 and (
        min(abs(left_slope), min(abs(middle_slope), abs(right_slope))) > 0.3 * steepest
    ):
        return best
    a, slope_a = 0.0, left_slope
    for k in range(1, SCAN + 1):
        b = theta_end * k / SCAN
        at_b, slope_b = _measure(kind, mode, path, lane, n, b)
        best = max(best, abs(at_b))
        if slope_a * slope_b < 0.0:
            low, high = a, b
            for _ in range(26):
                middle = 0.5 * (low + high)
                at_middle, s_middle = _measure(kind, mode, path, lane, n, middle)
                best = max(best, abs(at_middle))
                if s_middle * slope_a > 0.0:
                    low = middle
                else:
                    high = middle
        a, slope_a = b, slope_b
    return best


@compiled()
def _upper(path, lane, n, theta):  # type: ignore[no-untyped-def]
    """The larger approach of the two faces: it carries the larger force."""
    return max(value(path, lane, n, 0, theta), value(path, lane, n, 1, theta))


@compiled()
def _crossing(path, lane, n, face, level, a, b):  # type: ignore[no-untyped-def]
    """Where a face (or the larger of both, face = -1) passes `level` between a and b, which bracket it."""
    at_a = (_upper(path, lane, n, a) if face < 0 else value(path, lane, n, face, a)) - level
    at_b = (_upper(path, lane, n, b) if face < 0 else value(path, lane, n, face, b)) - level
    side = 0
    for _ in range(100):
        if abs(b - a) < 1e-14 or at_b == at_a:
            break
        c = b - at_b * (b - a) / (at_b - at_a)
        if not min(a, b) < c < max(a, b):
            c = 0.5 * (a + b)
        at_c = (_upper(path, lane, n, c) if face < 0 else value(path, lane, n, face, c)) - level
        if at_c == 0.0:
            return c
        # regula falsi with the Illinois rule: the end that stays is halved
        if at_c * at_b < 0.0:
            a, at_a = b, at_b
            side = 0
        else:
            if side == 1:
                at_a *= 0.5
            side = 1
        b, at_b = c, at_c
    return b


@compiled()
def _loss(path, lane, n, face, ends):  # type: ignore[no-untyped-def]
    """First theta at which a pressed face loses contact, or 2."""
    left, slope_left, right, slope_right = ends[face, 0, lane], ends[face, 1, lane], ends[face, 2, lane], ends[face, 3, lane]
    if right > 0.0 and not (
        slope_left < 0.0 and slope_right > 0.0 and min(left, right) < 0.3 * (abs(slope_left) + abs(slope_right))
    ):
        return 2.0
    a = 0.0
    for k in range(1, SCAN + 1):
        b = k / SCAN
        if value(path, lane, n, face, b) <= 0.0:
            return _crossing(path, lane, n, face, 0.0, a, b)
        # a dip below zero between two scanned points: look at its lowest point
        if slope(path, lane, n, face, a) < 0.0 and slope(path, lane, n, face, b) > 0.0:
            low, high = a, b
            for _ in range(50):
                middle = 0.5 * (low + high)
                if slope(path, lane, n, face, middle) < 0.0:
                    low = middle
                else:
                    high = middle
            if value(path, lane, n, face, low) <= 0.0:
                return _crossing(path, lane, n, face, 0.0, a, low)
        a = b
    return 2.0


@compiled()
def begin(track, lane):  # type: ignore[no-untyped-def]
    """Reset the trackers of a lane."""
    for k in range(TRACKS):
        track[lane, k] = 0.0
    track[lane, LOST] = math.nan
    track[lane, ENDED] = math.nan


@compiled()
def after_step(  # type: ignore[no-untyped-def]
    mode, track, lane, path, n, ends, before, h, echo, pulse_end, open_ended, tiny, stop_at_loss,
):  # fmt: skip
    """Bring the trackers up to date with an accepted step; True when the record ends inside it.

    `echo` is the time of the first reflected wave, `tiny` the error allowed in an approach.
    """
    theta_end = 1.0
    done = False
    for face in range(2):
        if track[lane, TOUCHED_A + face] > 0.0:
            theta = _loss(path, lane, n, face, ends)
            if theta <= 1.0:
                if math.isnan(track[lane, LOST]) or before + theta * h < track[lane, LOST]:
                    track[lane, LOST] = before + theta * h
                if stop_at_loss:
                    theta_end = min(theta_end, theta)
                    done = True
                elif ends[face, 2, lane] <= 0.0:
                    track[lane, TOUCHED_A + face] = 0.0
        elif ends[face, 2, lane] > 50.0 * tiny:
            track[lane, TOUCHED_A + face] = 1.0
    largest = max(_largest(FACE_A, mode, path, lane, n, ends, theta_end, track[lane, X_MAX]), 0.0)
    if mode != 2:
        largest = _largest(FACE_B, mode, path, lane, n, ends, theta_end, largest)
        track[lane, D_MAX] = _largest(DIFFERENCE, mode, path, lane, n, ends, theta_end, track[lane, D_MAX])
    track[lane, X_MAX] = largest
    track[lane, W_MAX] = _largest(ENERGY, mode, path, lane, n, ends, theta_end, track[lane, W_MAX])
    if before < echo * (1.0 - 1e-12):
        track[lane, X_FIRST] = largest
    if done:
        track[lane, ENDED] = before + theta_end * h
        return True
    if open_ended and before + h > pulse_end * (1.0 + 1e-12):
        level = largest * (TAIL_SHARE if mode == 1 else TAIL_SHARE ** (2.0 / 3.0))
        if max(ends[FACE_A, 2, lane], ends[FACE_B, 2, lane]) < level:
            theta = 0.0
            if _upper(path, lane, n, 0.0) > level:
                theta = _crossing(path, lane, n, -1, level, 0.0, 1.0)
            track[lane, ENDED] = before + theta * h
            return True
    return False


@compiled()
def _plausible(path, lane, n, theta_end, level):  # type: ignore[no-untyped-def]
    """Whether the larger approach can reach `level` inside a step at all."""
    for face in range(2):
        reach = max(path[lane, n, face, 0], value(path, lane, n, face, theta_end))
        if reach + 0.3 * theta_end * (abs(path[lane, n, face, 1]) + abs(slope(path, lane, n, face, theta_end))) >= level:
            return True
    return False


@compiled()
def _first_above(path, lane, count, last_theta, level, start, length):  # type: ignore[no-untyped-def]
    """Time at which the larger approach first reaches `level`."""
    for n in range(count):
        theta_end = last_theta if n == count - 1 else 1.0
        if not _plausible(path, lane, n, theta_end, level):
            continue
        a = 0.0
        for k in range(SCAN + 1):
            b = theta_end * k / SCAN
            if _upper(path, lane, n, b) >= level:
                theta = b if k == 0 else _crossing(path, lane, n, -1, level, a, b)
                return start[lane, n] + theta * length[lane, n]
            a = b
    return math.nan


@compiled()
def _last_above(path, lane, count, last_theta, level, start, length):  # type: ignore[no-untyped-def]
    """Time at which the larger approach is last at `level`."""
    for n in range(count - 1, -1, -1):
        theta_end = last_theta if n == count - 1 else 1.0
        if not _plausible(path, lane, n, theta_end, level):
            continue
        b = theta_end
        for k in range(SCAN, -1, -1):
            a = theta_end * k / SCAN
            if _upper(path, lane, n, a) >= level:
                theta = a if k == SCAN else _crossing(path, lane, n, -1, level, a, b)
                return start[lane, n] + theta * length[lane, n]
            b = a
    return math.nan


@compiled()
def finish(mode, track, lane, start, length, path, count, out):  # type: ignore[no-untyped-def]
    """Answers of a row that has ended, in scaled variables."""
    n = count - 1
    ended = track[lane, ENDED]
    if math.isnan(ended):
        ended = start[lane, n] + length[lane, n]
    last_theta = min(1.0, (ended - start[lane, n]) / length[lane, n])
    largest = track[lane, X_MAX]
    out[ANSWER_X_MAX] = largest
    out[ANSWER_X_FIRST] = track[lane, X_FIRST]
    out[ANSWER_DIFFERENCE] = track[lane, D_MAX]
    out[ANSWER_ENERGY] = track[lane, W_MAX]
    out[ANSWER_END] = ended
    lost = not math.isnan(track[lane, LOST])
    out[ANSWER_CONTACT] = track[lane, LOST] if lost else ended
    out[ANSWER_CONTACT_CENSORED] = 0.0 if lost else 1.0
    power = 1.0 if mode == 1 else 2.0 / 3.0
    half = largest * 0.5**power
    above = _first_above(path, lane, count, last_theta, half, start, length)
    if _upper(path, lane, n, last_theta) >= half:
        out[ANSWER_WIDTH] = ended - above
        out[ANSWER_WIDTH_CENSORED] = 1.0
    else:
        out[ANSWER_WIDTH] = _last_above(path, lane, count, last_theta, half, start, length) - above
        out[ANSWER_WIDTH_CENSORED] = 0.0
    tenth = _first_above(path, lane, count, last_theta, largest * 0.1**power, start, length)
    nine = _first_above(path, lane, count, last_theta, largest * 0.9**power, start, length)
    out[ANSWER_RISE] = nine - tenth


@compiled()
def sample(path, start, length, times, out):  # type: ignore[no-untyped-def]
    """States (x1, x2, u) of kept steps at ascending `times`; out (len(times), 3)."""
    n = 0
    for i in range(len(times)):
        while n < len(start) - 1 and times[i] > start[n] + length[n]:
            n += 1
        theta = (times[i] - start[n]) / length[n]
        for c in range(3):
            out[i, c] = value(path, 0, n, c, theta)


def empty_answers(rows: int) -> np.ndarray:
    """Room for the answers of `rows` rows, not a number until a row is done."""
    return np.full((rows, ANSWERS), np.nan)

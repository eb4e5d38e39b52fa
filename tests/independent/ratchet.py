"""A second integrator of bars whose faces yield, compiled: DOP853 with events, waves kept at Chebyshev points.

It shares nothing with the product but the inputs: the states (C14) and the closed forms of the law are written out
anew, the motion is E. Hairer's explicit method of order 8 with its own interpolant, every event is located on that and
the step made again to it, and the answers are read off the steps.  Far ends, every pulse, any faces alike or not.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numba
import numpy as np
import numpy.typing as npt
from scipy.integrate._ivp import dop853_coefficients as dop

from tests.independent.reference import Reference, Unaffordable, _jumps, problem_of
from uqsphere.mechanics.scene import Scene

Array = npt.NDArray[Any]

_A, _B, _C = dop.A.copy(), dop.B.copy(), dop.C.copy()
_E3, _E5, _D = dop.E3.copy(), dop.E5.copy(), dop.D.copy()
#: points of a step at which the waves that leave the faces are kept, and where it is looked at for events
NODES: Final = 10
_NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(NODES) / (NODES - 1.0))
_WEIGHTS = np.where((np.arange(NODES) == 0) | (np.arange(NODES) == NODES - 1), 0.5, 1.0) * (-1.0) ** np.arange(NODES)
LOOKS: Final = 24
SPRING, VIRGIN = 0, 1
# numbers of a face: state, onset, b, pile-up, largest, dent, spring, unloadings, 1 once it was pressed
_STATE, _ONSET, _B_, _C_, _LARGEST, _DENT, _STIFF, _COUNT, _PRESSED = range(9)


@numba.njit(cache=True)
def _law(z: float, b: float, c: float) -> tuple[float, float, float]:
    """L, A, W of (C5) to (C7) at z >= 1."""
    y = math.sqrt(z)
    if b == 0.0:
        return 1 + 1.5 * (z - 1), 1 + c * (z - 1), 0.4 + (z - 1) + 0.75 * (z - 1) ** 2
    log = math.log1p((y - 1) / b)
    force = 1 + 1.5 * (1 + b) * (z - 1) - 3 * b * b * (y - 1 - (b - 1) * log)
    g = 5.0 if c == 1.0 else min(5.0, c * b * b / ((c - 1) * (1 + b)))
    area = 1 + c * (z - 1) - 2 * (c - 1) * g * (y - 1 - (g - 1) * math.log1p((y - 1) / g))
    rest = (z - (b - 1) ** 2) * log - (z - 1) / 2 + (b - 1) * (y - 1)
    work = 0.4 + (z - 1) + 0.75 * (1 + b) * (z - 1) ** 2
    return force, area, work - 3 * b * b * (2 / 3 * (z**1.5 - 1) - (z - 1) - (b - 1) * rest)


@numba.njit(cache=True)
def _force(face: Array, x: float) -> float:
    if face[_STATE] == VIRGIN:
        return face[_ONSET] ** 1.5 * _law(max(x / face[_ONSET], 1.0), face[_B_], face[_C_])[0]
    above = x - face[_DENT]
    return face[_STIFF] * above * math.sqrt(above) if above > 0.0 else 0.0


@numba.njit(cache=True)
def _turn(face: Array, x: float) -> None:
    """The other branch of a face, at x."""
    if face[_STATE] == SPRING:
        face[_STATE] = VIRGIN
        return
    face[_STATE], face[_LARGEST] = SPRING, max(x, face[_LARGEST])
    force, area, _ = _law(face[_LARGEST] / face[_ONSET], face[_B_], face[_C_])
    back = face[_ONSET] * force / math.sqrt(area)
    face[_DENT], face[_STIFF] = face[_LARGEST] - back, face[_ONSET] ** 1.5 * force / back**1.5
    face[_COUNT] += 1.0


@numba.njit(cache=True)
def _stored(face: Array, x: float) -> float:
    """Elastic energy of a face, (C10)."""
    force = _force(face, x)
    if face[_STATE] == SPRING:
        return 0.4 * force * max(x - face[_DENT], 0.0)
    ratio, area, _ = _law(max(x / face[_ONSET], 1.0), face[_B_], face[_C_])
    return 0.4 * force * face[_ONSET] * ratio / math.sqrt(area)


@numba.njit(cache=True)
def _pulse(breaks: Array, cubics: Array, frequency: float, piece: int, t: float) -> float:
    if piece >= len(cubics):
        return 0.0
    if frequency > 0.0:
        return math.sin(frequency * t)
    z = t - breaks[piece]
    return cubics[piece, 0] + z * (cubics[piece, 1] + z * (cubics[piece, 2] + z * cubics[piece, 3]))


@numba.njit(cache=True)
def _returning(t, inside, starts, lengths, waves, bar, from_, count):
    """The wave that left a face at t, read on the step that `inside` lies in; from_: a step at or before it."""
    n = from_
    while n < count - 1 and starts[n] + lengths[n] < inside:
        n += 1
    theta = (t - starts[n]) / lengths[n]
    top, bottom = 0.0, 0.0
    for k in range(len(_NODES)):
        off = theta - _NODES[k]
        if off == 0.0:
            return waves[n, bar, k]
        share = _WEIGHTS[k] / off
        top += share * waves[n, bar, k]
        bottom += share
    return top / bottom


@numba.njit(cache=True)
def _rates(t, middle, y, out, push, mu, faces, breaks, cubics, frequency, piece, trips, ends, starts, lengths, waves,
           from_, count):  # fmt: skip
    push[0], push[1] = _pulse(breaks, cubics, frequency, piece, t), 0.0
    for bar in range(2):
        if ends[bar] != 0.0 and middle > trips[bar]:
            left = t - trips[bar]
            inside = left + 1e-9 * (middle - t)
            push[bar] += ends[bar] * _returning(left, inside, starts, lengths, waves, bar, from_[bar], count)
    q1, q2 = _force(faces[0], y[0]), _force(faces[1], y[1])
    out[0] = 2.0 * push[0] - q1 - y[2]
    out[1] = y[2] - q2 - 2.0 * push[1]
    out[2] = (q1 - q2) / mu
    return q1, q2


@numba.njit(cache=True)
def _dense(dense: Array, y: Array, theta: float, out: Array) -> None:
    for s in range(3):
        total = 0.0
        for i in range(7):
            total += dense[6 - i, s]
            total *= theta if i % 2 == 0 else 1.0 - theta
        out[s] = y[s] + total


@numba.njit(cache=True)
def _march(mu, faces, breaks, cubics, frequency, trips, ends, jumps, record, rtol, kept, starts, lengths, waves,
           series, laws):  # fmt: skip
    """Steps until the record ends; their starts, lengths, waves (n, 2, NODES), series (n, 8, 3), laws (n, 2, 9).

    Returns how many, the end, the face that let go or -1, 0 or -1 where the room does not do.
    """
    t, y, n, at_jump = 0.0, np.zeros(3), 0, 0
    h, stages, push = 1e-6, np.zeros((16, 3)), np.zeros(2)
    new, found, rate, dense = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros((7, 3))
    from_, scale, peak, piece = np.zeros(2, dtype=np.int64), np.zeros(3), 0.0, 0
    forced = -1.0
    scale[0], scale[1], scale[2] = 1e-4, 1e-4, 1e-4
    for _ in range(20 * kept):
        if n == kept:
            break
        stop = jumps[at_jump] if at_jump < len(jumps) else record
        h = min(h, min(trips[0], trips[1]))
        if forced > 0.0:
            h = forced
        last = forced <= 0.0 and t + h >= stop * (1.0 - 1e-14)
        if last:
            h = stop - t
        middle = t + 0.5 * h
        piece = 0
        while piece < len(cubics) and breaks[piece + 1] <= middle:
            piece += 1
        for bar in range(2):
            if ends[bar] != 0.0 and middle > trips[bar]:
                while from_[bar] + 1 < n and starts[from_[bar] + 1] <= t - trips[bar]:
                    from_[bar] += 1
        rest = (mu, faces, breaks, cubics, frequency, piece, trips, ends, starts, lengths, waves, from_, n)
        _rates(t, middle, y, stages[0], push, *rest)
        turned = False
        for k in range(2):
            face, off = faces[k], stages[0, k]
            if (face[_STATE] == VIRGIN and off < -1e-11) or (
                face[_STATE] == SPRING and off > 1e-11 and y[k] >= face[_LARGEST] * (1.0 - 1e-13)
            ):
                _turn(face, y[k])
                turned = True
        if turned:
            continue
        for s in range(1, 13):
            for i in range(3):
                total = 0.0
                for k in range(s):
                    total += (_A[s, k] if s < 12 else _B[k]) * stages[k, i]
                new[i] = y[i] + h * total
            _rates(t + (_C[s] if s < 12 else 1.0) * h, middle, new, stages[s], push, *rest)
        five, three = 0.0, 0.0
        for i in range(3):
            unit = rtol * max(scale[i], max(abs(y[i]), abs(new[i])))
            e5, e3 = 0.0, 0.0
            for k in range(13):
                e5 += _E5[k] * stages[k, i]
                e3 += _E3[k] * stages[k, i]
            five += (e5 / unit) ** 2
            three += (e3 / unit) ** 2
        error = 0.0 if five == 0.0 else h * five / math.sqrt(3.0 * (five + 0.01 * three))
        if error > 1.0 and forced <= 0.0:
            h *= max(0.2, 0.9 * error**-0.125)
            if h < 1e-15 * (1.0 + t):
                return n, t, -1, -2
            continue
        for s in range(13, 16):
            for i in range(3):
                total = 0.0
                for k in range(s):
                    total += _A[s, k] * stages[k, i]
                found[i] = y[i] + h * total
            _rates(t + _C[s] * h, middle, found, stages[s], push, *rest)
        for i in range(3):
            change = new[i] - y[i]
            dense[0, i] = change
            dense[1, i] = h * stages[0, i] - change
            dense[2, i] = 2.0 * change - h * (stages[12, i] + stages[0, i])
            for d in range(4):
                total = 0.0
                for k in range(16):
                    total += _D[d, k] * stages[k, i]
                dense[3 + d, i] = h * total
        # ---- the first event
        met, where, before = -1, 1.0, 0.0
        for i in range(1, LOOKS + 1):
            if forced > 0.0:
                break
            theta = i / LOOKS
            _dense(dense, y, theta, found)
            _rates(t + theta * h, middle, found, rate, push, *rest)
            for k in range(2):
                if _met(faces[k], found[k], rate[k]):
                    met = k
            if met >= 0:
                low, high = before, theta
                for _ in range(60):
                    mid = 0.5 * (low + high)
                    _dense(dense, y, mid, found)
                    _rates(t + mid * h, middle, found, rate, push, *rest)
                    hit = False
                    for k in range(2):
                        if _met(faces[k], found[k], rate[k]):
                            hit, met = True, k
                    if hit:
                        high = mid
                    else:
                        low = mid
                where = high
                break
            before = theta
        if met >= 0 and where < 1.0 - 1e-12:
            forced = where * h  # the step is made again to there
            continue
        was_forced, forced = forced > 0.0, -1.0
        # ---- kept
        starts[n], lengths[n] = t, h
        for k in range(2):
            for i in range(9):
                laws[n, k, i] = faces[k, i]
        for s in range(3):
            series[n, 0, s] = y[s]
            for d in range(7):
                series[n, 1 + d, s] = dense[d, s]
        for i in range(NODES):
            _dense(dense, y, _NODES[i], found)
            q1, q2 = _rates(t + _NODES[i] * h, middle, found, rate, push, *rest)
            waves[n, 0, i], waves[n, 1, i] = push[0] - q1, q2 + push[1]
            peak = max(peak, max(q1, q2))
        n += 1
        t = stop if last else t + h
        for i in range(3):
            y[i] = new[i]
            scale[i] = max(scale[i], abs(y[i]))
        for k in range(2):
            face = faces[k]
            if y[k] - face[_DENT] > 1e-9 * max(scale[0], scale[1]) > 0.0:
                face[_PRESSED] = 1.0
            if face[_STATE] == VIRGIN:
                face[_LARGEST] = max(face[_LARGEST], y[k])
        over = math.isinf(record) and starts[n - 1] >= breaks[-1] * (1.0 - 1e-12)
        if over and not math.isnan(_tail(starts, lengths, series, laws, n, _quiet(faces, peak))):
            return n, t, -1, 0
        if met >= 0 or was_forced:
            _rates(t, t, y, rate, push, *rest)
            for k in range(2):
                face = faces[k]
                if face[_STATE] == SPRING and face[_PRESSED] > 0.0 and y[k] - face[_DENT] <= 1e-12 * scale[k]:
                    return n, t, k, 0
                if (face[_STATE] == VIRGIN and abs(rate[k]) <= 1e-9) or (
                    face[_STATE] == SPRING and rate[k] > 0.0 and y[k] >= face[_LARGEST] * (1.0 - 1e-12)
                ):
                    _turn(face, y[k])
        h *= min(3.0, max(0.3, 0.9 * max(error, 1e-12) ** -0.125))
        if last:
            if at_jump >= len(jumps):
                return n, t, -1, 0
            at_jump += 1
            h = min(h, 1e-3)
    return n, t, -1, -1


@numba.njit(cache=True)
def _quiet(faces: Array, peak: float) -> float:
    """Approach above the dents below which neither force can be more than 1 % of the largest: the stiffer face's."""
    return (0.01 * peak / max(1.0, max(faces[0, _STIFF], faces[1, _STIFF]))) ** (2.0 / 3.0)


@numba.njit(cache=True)
def _higher(series, laws, n, theta, out):
    """The higher of both approaches above the dents at theta of step n."""
    _dense(series[n, 1:], series[n, 0], theta, out)
    return max(out[0] - laws[n, 0, _DENT], out[1] - laws[n, 1, _DENT])


@numba.njit(cache=True)
def _tail(starts, lengths, series, laws, count, level):
    """First time in the last step at which both approaches above the dents are below a level, or NaN.

    Where one falls as the other rises the higher one has an edge, which may be below the level between two looks.
    """
    out, seen, n = np.zeros(3), np.zeros(LOOKS + 3), count - 1
    seen[0] = seen[-1] = math.inf
    for i in range(LOOKS + 1):
        seen[i + 1] = _higher(series, laws, n, i / LOOKS, out)
    low, high = 0.0, math.nan
    for i in range(LOOKS + 1):
        begin, end = max(i - 1.0, 0.0) / LOOKS, min(i + 1.0, LOOKS) / LOOKS
        if seen[i + 1] < level:
            low, high = begin, i / LOOKS
            break
        if seen[i + 1] < 2.0 * level and seen[i + 1] <= min(seen[i], seen[i + 2]):
            a, b = begin, end
            for _ in range(40):
                one, two = a + 0.382 * (b - a), a + 0.618 * (b - a)
                if _higher(series, laws, n, one, out) < _higher(series, laws, n, two, out):
                    b = two
                else:
                    a = one
            if _higher(series, laws, n, 0.5 * (a + b), out) < level:
                low, high = begin, 0.5 * (a + b)
                break
    for _ in range(60):
        mid = 0.5 * (low + high)
        if _higher(series, laws, n, mid, out) >= level:
            low = mid
        else:
            high = mid
    return starts[n] + high * lengths[n]


@numba.njit(cache=True)
def _met(face: Array, x: float, rate: float) -> bool:
    """Whether a face has left its branch: turned, begun to yield again, or let go."""
    if face[_STATE] == VIRGIN:
        return rate < -1e-10
    if x >= face[_LARGEST] * (1.0 + 1e-13):
        return True
    return face[_PRESSED] > 0.0 and x < face[_DENT]


@numba.njit(cache=True)
def _at(series, laws, n, theta, out):
    """Largest force, difference, stored energy and both approaches at theta of step n."""
    _dense(series[n, 1:], series[n, 0], theta, out)
    q1, q2 = _force(laws[n, 0], out[0]), _force(laws[n, 1], out[1])
    return max(q1, q2), abs(q1 - q2), _stored(laws[n, 0], out[0]) + _stored(laws[n, 1], out[1]), out[0], out[1]


@numba.njit(cache=True)
def _top(series, laws, n, kind, look, out):
    """The largest of one of these around a look, by golden sections."""
    low, high, best = max(0.0, (look - 1.0) / LOOKS), min(1.0, (look + 1.0) / LOOKS), -math.inf
    for _ in range(40):
        one, two = low + 0.382 * (high - low), low + 0.618 * (high - low)
        first, second = _at(series, laws, n, one, out)[kind], _at(series, laws, n, two, out)[kind]
        low, high = (low, two) if first > second else (one, high)
        best = max(best, max(first, second))
    return best


@numba.njit(cache=True)
def _tops(series, laws, count):
    """Largest force, difference and energy of all steps."""
    best, out, seen = np.zeros(3), np.zeros(3), np.zeros((LOOKS + 1, 3))
    for n in range(count):
        for i in range(LOOKS + 1):
            seen[i, 0], seen[i, 1], seen[i, 2], _, _ = _at(series, laws, n, i / LOOKS, out)
        for kind in range(3):
            for i in range(LOOKS + 1):
                beside = max(seen[max(i - 1, 0), kind], seen[min(i + 1, LOOKS), kind])
                if seen[i, kind] >= max(0.98 * best[kind], beside):
                    best[kind] = max(best[kind], max(seen[i, kind], _top(series, laws, n, kind, i, out)))
    return best


@numba.njit(cache=True)
def _crossing(starts, lengths, series, laws, count, level, backward):
    """First time, or last, at which the larger force passes a level; the record's end if it is above there."""
    out, end = np.zeros(3), starts[count - 1] + lengths[count - 1]
    if backward and _at(series, laws, count - 1, 1.0, out)[0] >= level:
        return end
    for k in range(count):
        n = count - 1 - k if backward else k
        for i in range(LOOKS):
            a, b = (1.0 - i / LOOKS, 1.0 - (i + 1) / LOOKS) if backward else (i / LOOKS, (i + 1) / LOOKS)
            if _at(series, laws, n, b, out)[0] >= level:
                for _ in range(60):
                    mid = 0.5 * (a + b)
                    if _at(series, laws, n, mid, out)[0] >= level:
                        b = mid
                    else:
                        a = mid
                return starts[n] + b * lengths[n]
    return math.nan


def refer(scene: Scene, row: int, *, budget: int = 20_000, rtol: float = 1e-11) -> Reference:
    """Answers of one row by this integrator, as those of `tests.independent.reference.refer`.

    Raises
    ------
    tests.independent.reference.Unaffordable
        If it takes more than `budget` steps.
    """
    problem, law, scales = problem_of(scene, row), scene.partners[0], scene.scales
    assert law is not None
    assert law.face is not None
    given = law.face.at(row)
    onset = float(given.onset_approach[0] / scales.approach[row])
    b = float(given.softening[0])
    faces = np.zeros((2, 9))
    faces[:, _ONSET] = faces[:, _LARGEST] = onset
    faces[:, _B_], faces[:, _C_], faces[:, _STIFF] = 0.0 if abs(b) < 1e-12 else b, float(given.pile_up[0]), 1.0
    record = float(problem.record)
    jumps = np.array([float(time) for time, _ in _jumps(problem, min(record, 1e9))])
    starts, lengths = np.zeros(budget), np.zeros(budget)
    waves, series, laws = np.empty((budget, 2, NODES)), np.empty((budget, 8, 3)), np.empty((budget, 2, 9))
    first_echo = float(problem.first_echo)
    count, end, lost, status = _march(
        float(problem.mass), faces, problem.breaks.astype(float), problem.cubics.astype(float),
        float(problem.frequency), problem.trips.astype(float), problem.ends.astype(float), jumps, record,
        rtol, budget, starts, lengths, waves, series, laws,
    )  # fmt: skip
    if status != 0:
        raise Unaffordable(f"status {status} after {count} steps")
    top, difference, energy = _tops(series, laws, count)
    if math.isinf(record) and lost < 0:  # the tail rule ends the record inside the last step
        end = _tail(starts, lengths, series, laws, count, _quiet(faces, top))
    unit, force, time = float(scales.approach[row]), float(scales.force[row]), float(scales.time[row])
    reach, early = (
        [_deepest(series, laws, starts, count, k, until) for k in range(2)] for until in (math.inf, first_echo)
    )
    where = (starts, lengths, series, laws, count)
    rise = _crossing(*where, 0.9 * top, False) - _crossing(*where, 0.1 * top, False)
    radius = float(scales.effective_radius[row])
    p_y, hardness = float(given.onset[0]), float(given.hardness[0])
    parts = [_told(x / onset, b, float(given.pile_up[0]), p_y, hardness, onset) for x in reach]
    values = {
        "p_max": max(part["centre"] for part in parts),
        "P_max": force * top,
        "alpha_max": unit * max(reach),
        "dent": unit * max(part["dent"] for part in parts),
        "plastic_work": force * unit * sum(part["plastic"] for part in parts),
        "time_to_first_loss": time * end,
        "rise_time": time * rise,
        "first_peak": max(_told(x / onset, b, float(given.pile_up[0]), p_y, hardness, onset)["centre"] for x in early),
        "force_imbalance": difference / top,
        "energy": force * unit * energy,
        "a_max": math.sqrt(radius * unit * max(part["area"] for part in parts)),
        "loading_rate": 0.8 * force * top / (time * rise),
        "specific_energy": force * unit * energy / float(scales.mass[row]),
    }
    return Reference(
        values=values, censored={"time_to_first_loss": lost < 0}, record=time * end,
        dips=(), steps=count, tail=rtol,
    )  # fmt: skip


@numba.njit(cache=True)
def _deepest(series, laws, starts, count, k, until):
    """Largest approach of a face in the steps that begin before a time."""
    best, out, seen = 0.0, np.zeros(3), np.zeros(LOOKS + 1)
    for n in range(count):
        if starts[n] >= until * (1.0 - 1e-12):
            break
        ends = max(series[n, 0, k], series[n, 0, k] + series[n, 1, k])
        if laws[n, k, _STATE] == VIRGIN or laws[n, k, _COUNT] > 0:
            best = max(best, ends if laws[n, k, _STATE] == VIRGIN else laws[n, k, _LARGEST])
            continue
        if ends < 0.5 * best:
            continue
        for i in range(LOOKS + 1):
            seen[i] = _at(series, laws, n, i / LOOKS, out)[3 + k]
        for i in range(LOOKS + 1):
            if seen[i] >= max(0.98 * best, max(seen[max(i - 1, 0)], seen[min(i + 1, LOOKS)])):
                best = max(best, max(seen[i], _top(series, laws, n, 3 + k, i, out)))
    return best


def _told(z: float, b: float, c: float, p_y: float, hardness: float, onset: float) -> dict[str, float]:
    """Centre pressure, a²/r_eff, dent and plastic work (scaled) of a face pressed to z, (C8), (C11), (C12)."""
    if z <= 1.0:
        return {"centre": p_y * math.sqrt(z), "dent": 0.0, "plastic": 0.0, "area": z * onset}
    force, area, work = _law(z, 0.0 if abs(b) < 1e-12 else b, c)
    mean = 2.0 / 3.0 * p_y * force / area
    rest = (hardness - mean) * (hardness - p_y) / (hardness - 2.0 / 3.0 * p_y)
    return {
        "centre": hardness - rest,
        "area": area * onset,
        "dent": (z - force / math.sqrt(area)) * onset,
        "plastic": onset**2.5 * (work - 0.4 * force**2 / math.sqrt(area)),
    }

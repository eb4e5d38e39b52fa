"""Closed forms in infinite bars: the massless sphere under a rectangle or a step, and the linear contact.

All functions are elementwise in the scaled variables of theory (8): approach x over alpha_c, time s over t_c.
`solve_closed` gives every quantity of interest of the massless model in SI without integrating anything.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from functools import lru_cache
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics.integrator.tracked import (
    ABOVE_SHARE,
    ANSWER_ABOVE,
    ANSWER_CONTACT,
    ANSWER_CONTACT_CENSORED,
    ANSWER_DIFFERENCE,
    ANSWER_END,
    ANSWER_ENERGY,
    ANSWER_FACES,
    ANSWER_FIRSTS,
    ANSWER_GAP,
    ANSWER_IMPULSE,
    ANSWER_MEAN,
    ANSWER_PARTING,
    ANSWER_RISE,
    ANSWER_WIDTH,
    ANSWER_WIDTH_CENSORED,
    ANSWER_X_FIRST,
    ANSWER_X_MAX,
    TAIL_SHARE,
    empty_answers,
)
from uqsphere.mechanics.outputs import Answers, answers_of
from uqsphere.mechanics.scene import Scene

#: columns of the approaches of faces A and B
_BOTH_FACES: Final = (ANSWER_FACES, ANSWER_FACES + 1, ANSWER_FIRSTS, ANSWER_FIRSTS + 1)
#: approach and time below which the logarithms of (11) cancel and its series in x^(3/2) is the better way, and its
#: terms: the next one is 0.1^(1.5 13)/20.5, below the rounding of a double
_SERIES_BELOW: Final = 0.1
_SERIES_TERMS: Final = 12


def _series(x: Array) -> Array:
    """s(x) = sum over k of x^(1 + 3k/2)/(1 + 3k/2), the geometric series of 1/(1 - x^(3/2)) integrated."""
    power = x * np.sqrt(x)
    total = np.zeros_like(x)
    for k in range(_SERIES_TERMS, -1, -1):
        total = total * power + 1.0 / (1.0 + 1.5 * k)
    return x * total


def _time_at_root(root: Array, minus_log: Array) -> Array:
    """s of theory (11) from y = sqrt(x) and -ln(1 - y).

    The difference of the two angles of (11) is taken as one, atan(sqrt(3) y/(2 + y)): nothing cancels.
    """
    angle = np.arctan(math.sqrt(3.0) * root / (2.0 + root))
    return (2.0 / 3.0) * (minus_log + 0.5 * np.log1p(root + root * root) - math.sqrt(3.0) * angle)


def loading_time(x: Values) -> Array:
    """Scaled time s at which the massless sphere has the approach x, theory (11).

    s(x) = (2/3) [-ln(1-y) + ln(1+y+y²)/2 - sqrt(3) (atan((2y+1)/sqrt(3)) - pi/6)], y = sqrt(x).

    Parameters
    ----------
    x : array, 0 <= x <= 1
        Approach over alpha_c; 1 is reached after infinite time.

    Raises
    ------
    ValueError
        For an approach outside 0 to 1, which a step pulse never builds up.

    Source: W. K. Nowacki, Engng. Trans. 42(3), 1994, (3.3), integrated by partial fractions.

    >>> float(loading_time(0.5).round(12))
    0.591935816248
    """
    x = np.asarray(x, dtype=float)
    if not bool(np.all((x >= 0.0) & (x <= 1.0))):
        raise ValueError("the approach of a loading must lie between 0 and 1 (in units of alpha_c)")
    small = np.minimum(x, _SERIES_BELOW)
    root = np.sqrt(x)
    with np.errstate(divide="ignore"):
        closed = _time_at_root(root, -np.log1p(-root))
    return np.where(x < _SERIES_BELOW, _series(small), closed)


@lru_cache(maxsize=1)
def _table() -> tuple[Array, Array]:
    """Times and z = -ln(1 - sqrt(x)) of a loading, so close that one round of Newton's iteration finishes it."""
    z = np.concatenate([np.linspace(0.3, 4.0, 24_000), np.linspace(4.0, 100.0, 8_000)[1:]])
    return _time_at_root(-np.expm1(-z), z), z


def loading_approach(s: Values) -> Array:
    """Scaled approach x of the massless sphere at the time s of an endless step; inverse of `loading_time`.

    Newton's iteration in z = -ln(1 - sqrt(x)), in which s is nearly a straight line, and Halley's in x itself
    where s is small; a fixed number of rounds for all elements together, error below 1e-14.

    Parameters
    ----------
    s : array, s >= 0
        Time over t_c; infinity is allowed and gives 1.

    Raises
    ------
    ValueError
        For a time before the first touch.

    >>> loading_approach([0.0, 0.8193410, np.inf]).round(6).tolist()
    [0.0, 0.629961, 1.0]
    """
    s = np.asarray(s, dtype=float)
    if not bool(np.all(s >= 0.0)):
        raise ValueError("the time of a loading must not be negative")
    # beyond s = 60 the approach is 1 to the last bit
    large = np.clip(s, _SERIES_BELOW, 60.0)
    z = np.interp(large, *_table())
    y = -np.expm1(-z)
    z = z - (_time_at_root(y, z) - large) * (1.0 + y + y * y) / (2.0 * y)
    approach = np.square(np.expm1(-z))
    early = s < _SERIES_BELOW
    if not early.any():
        return np.asarray(approach)
    small = np.minimum(s, _SERIES_BELOW)
    x = small - 0.4 * small**2.5
    for _ in range(2):
        excess = _series(x) - small
        root = np.sqrt(x)
        x = x - excess * (1.0 - x * root) / (1.0 - 0.75 * excess * root)
    return np.asarray(np.where(early, x, approach))


def relaxing_approach(start: Values, after: Values) -> Array:
    """Scaled approach a time `after` the end of the pulse: x = [x_*^(-1/2) + after/2]^(-2), theory (12).

    Parameters
    ----------
    start : array, x_* > 0
        Approach at the end of the pulse, over alpha_c.
    after : array, >= 0
        Time since the end of the pulse, over t_c.

    >>> float(relaxing_approach(loading_approach(0.8), 5.2).round(7))
    0.0667757
    """
    return np.asarray((1.0 / np.sqrt(start) + 0.5 * np.asarray(after, dtype=float)) ** -2.0)


def relaxing_time(start: Values, x: Values) -> Array:
    """Scaled time in which the approach falls from `start` to x after the pulse; inverse of (12)."""
    return np.asarray(2.0 * (1.0 / np.sqrt(x) - 1.0 / np.sqrt(start)))


def massless_approach(s: Values, theta: Values) -> Array:
    """Scaled approach x(s) of the massless sphere under a rectangular pulse of length theta (inf: a step).

    >>> massless_approach([0.4, 0.8, 6.0], 0.8).round(6).tolist()
    [0.363053, 0.620178, 0.066776]
    """
    s, theta = np.broadcast_arrays(np.asarray(s, dtype=float), np.asarray(theta, dtype=float))
    loading = loading_approach(np.minimum(s, theta))
    over = s > theta
    after = np.where(over, s - np.where(over, theta, 0.0), 0.0)
    return np.where(over, relaxing_approach(np.where(over, loading, 1.0), after), loading)


def _step_difference(s: Array, mu: Array) -> Array:
    """e^(-s/2) sin(w s)/w with w² = 2/mu - 1/4: half the difference of the approaches under a linear step."""
    square = 2.0 / mu - 0.25
    swinging = square > 0.0
    w = np.sqrt(np.abs(square))
    swing = np.exp(-0.5 * s) * s * np.sinc(w * s / math.pi)
    # overdamped, mu > 8: the hyperbolic sine in decaying exponentials only, so that nothing overflows
    k = np.where(swinging, 0.0, w)
    creep = np.where(k > 0.0, -np.expm1(-2.0 * k * s) / (2.0 * np.where(k > 0.0, k, 1.0)), s)
    return np.where(swinging, swing, creep * np.exp((k - 0.5) * s))


def linear_approaches(s: Values, mu: Values, theta: Values = math.inf) -> tuple[Array, Array]:
    """Scaled approaches x_1, x_2 of the linear contact, infinite bars, theory (14): a step less a later one.

    x_1, x_2 = 1 - e^(-s) ± e^(-s/2) sin(w s)/w, w² = 2/mu - 1/4; hyperbolic for mu > 8, s e^(-s/2) at mu = 8.
    It holds until an approach turns negative: a spring could pull, a contact cannot.

    Parameters
    ----------
    s : array
        Time over t_c.
    mu : array, > 0
        Mass number M/(Z t_c).
    theta : array, > 0
        Length of a rectangular pulse over t_c, infinite for a step.

    Source: W. K. Nowacki, Engng. Trans. 42(3), 1994, (4.5) and (4.8); (4.9) lacks the decay of the swing.

    >>> x_1, x_2 = linear_approaches(30.0, 0.1)
    >>> bool(abs(x_1 - 1.0) < 1e-6), bool(abs(x_2 - 1.0) < 1e-6)
    (True, True)
    """
    s, mu, theta = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (s, mu, theta)))
    late = np.maximum(s - theta, 0.0)
    mean = -np.expm1(-s) + np.expm1(-late)
    half = _step_difference(s, mu) - _step_difference(late, mu)
    return mean + half, mean - half


def closed_form_applies(scene: Scene, fidelity: str) -> bool:
    """Whether `solve_closed` has the answer: massless, infinite bars, rectangular or step pulse.

    The `linear` contact has its history in closed form, but its peaks are roots of transcendental equations.
    """
    plain = scene.shape in ("rectangular", "step") and scene.striker_ratio is None
    yields = scene.contact_law == "plastic" and scene.contact_dynamics == "path"
    return fidelity == "massless" and scene.infinite and plain and not yields


def solve_closed(scene: Scene, fidelity: str = "massless", quantities: Collection[str] | None = None) -> Answers:
    """Quantities of interest of n scenes in closed form, with the same names as `dynamics.solve`.

    Both forces are equal and rise until the pulse ends, theory (11), then die out, theory (12): the largest
    force is that at the end of the pulse or of the record.  Contact is never lost, so that contact_time is
    always censored at the end of the record: the horizon, or where the force is down to 1 % of the largest.
    Only the named `quantities`, or all, are answered.

    Raises
    ------
    ValueError
        Where `closed_form_applies` is false.
    """
    if not closed_form_applies(scene, fidelity):
        raise ValueError(
            f"no closed form for {fidelity!r} with a {scene.shape} pulse and infinite = {scene.infinite} "
            "(there is one for massless, a rectangular or step pulse, infinite bars)"
        )
    status = scene.status.copy()
    good = status == 0
    scales = scene.scales
    with np.errstate(all="ignore"):
        theta = np.where(good, scales.pulse_number, 1.0)
        horizon = np.where(good, scene.record_end / scales.time, 1.0)
    scaled = np.where(good[:, None], _scaled_answers(theta, horizon), np.nan)
    return answers_of(scene, scaled, status, np.zeros(len(scene), dtype=np.int64), quantities=quantities)


def scaled_answers(scene: Scene) -> Array:
    """Scaled answers (n, ANSWERS) of `outputs.answers_of` for scenes inside the domain."""
    return _scaled_answers(scene.scales.pulse_number, scene.record_end / scene.scales.time)


def _scaled_answers(theta: Array, horizon: Array) -> Array:
    """Scaled answers (n, ANSWERS) of `outputs.answers_of`: approaches, force difference, energy, times."""
    loaded = np.minimum(theta, horizon)
    peak = loading_approach(loaded)
    tail = theta + relaxing_time(peak, peak * TAIL_SHARE ** (2.0 / 3.0))
    ended = np.where(np.isfinite(horizon), horizon, tail)
    half = 0.5 ** (2.0 / 3.0)
    half_again = theta + relaxing_time(peak, peak * half)
    still_above = half_again >= ended
    width = np.minimum(half_again, ended) - loading_time(peak * half)
    tenth = peak * ABOVE_SHARE ** (2.0 / 3.0)
    above = np.minimum(theta + relaxing_time(peak, tenth), ended) - loading_time(tenth)
    # x' = f - q: the impulse is that of the pulse less what is left of the approach
    left = np.where(ended > theta, relaxing_approach(peak, np.maximum(ended - theta, 0.0)), peak)
    rise = loading_time(peak * 0.9 ** (2.0 / 3.0)) - loading_time(peak * 0.1 ** (2.0 / 3.0))
    answers = empty_answers(len(peak))
    answers[:, (ANSWER_X_MAX, ANSWER_X_FIRST, *_BOTH_FACES)] = peak[:, None]
    answers[:, ANSWER_DIFFERENCE], answers[:, ANSWER_CONTACT_CENSORED] = 0.0, 1.0
    answers[:, ANSWER_ENERGY], answers[:, ANSWER_MEAN] = 2.0 * 0.4 * peak**2.5, peak**1.5
    answers[:, (ANSWER_CONTACT, ANSWER_END, ANSWER_PARTING)] = ended[:, None]
    answers[:, ANSWER_WIDTH], answers[:, ANSWER_WIDTH_CENSORED], answers[:, ANSWER_RISE] = width, still_above, rise
    answers[:, ANSWER_IMPULSE], answers[:, ANSWER_ABOVE] = (loaded - left) / peak**1.5, above
    answers[:, ANSWER_GAP] = 0.0
    return answers

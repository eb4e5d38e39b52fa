"""One step of the equations of motion as a power series in time, for all lanes of the integrator at once.

The motion between two jumps of the waves is analytic as long as a pressed face stays pressed, so its Taylor
series about the start of a step follows from recurrences for products and square roots (R. Barrio, Appl. Math.
Comput. 163, 2005, 525; A. Jorba, M. Zou, Experimental Mathematics 14, 2005, 99).  With theta = 0 ... 1 over the
length h of the step, theory (9) reads for the coefficients

    (k+1) x_1[k+1] = h (2 f[k] - q_1[k] - u[k])          q = x y,  y² = x:
    (k+1) x_2[k+1] = h (u[k] - q_2[k] - 2 h_B[k])        2 y[0] y[k] = x[k] - sum of y[j] y[k-j], 0 < j < k
    (k+1) u[k+1]   = h (q_1[k] - q_2[k])/mu              q[k] = sum of x[j] y[k-j], 0 <= j <= k

The series serves three ends at once: it makes the step, it says how long the step may be, and it is the motion
inside the step.  Arrays are (coefficient, lane); what exists at both faces has the lanes of face A first, then
those of face B.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import face_force, log_start
from uqsphere.mechanics.integrator.searches import value, value_of
from uqsphere.mechanics.integrator.tracked import (
    BASE,
    BY_LOG,
    BY_ROOT,
    BY_X,
    CONSTANT,
    FACE_A,
    FACE_B,
    HERTZ,
    INNER,
    LANES,
    ORDER,
    PAIR,
    RIG_GIVES,
    RIG_LIGHTNESS,
    RIG_THERE,
    SHIFT,
    SPRING,
    TERMS,
)
from uqsphere.mechanics.integrator.vectors import (
    apart,
    curves_at,
    derivatives_at,
    elementwise,
    larger,
    products,
    root_of,
    row,
    size_of,
    smaller,
    where,
)

#: share of the radius of convergence that a step may use: 0.85^16 is 0.07 (docs/theory.md, section 5)
_CIRCLE = 0.85
#: states with a scale of their own: x_1, u, x_2, U_A, U_B
SCALES = 5
#: Runge-Kutta steps over a touch
_TOUCH_STEPS = 4


# the parts of the recurrences that are done column by column
_first_root = elementwise(
    PAIR, 2, lambda x: (root_of(larger(x, 0.0)), where(x > 0.0, 0.5 / root_of(larger(x, 1e-300)), 0.0))
)
_shifted_root = elementwise(
    PAIR,
    3,
    lambda x, shift, by_log, base: (
        (root := root_of(larger(x + shift, 0.0))),
        where(x + shift > 0.0, 0.5 / root_of(larger(x + shift, 1e-300)), 0.0),
        where((by_log < 0.0) | (by_log > 0.0), 1.0 / (root + base), 0.0),
    ),
)
# of a face on virgin loading (inverse > 0) the terms of the logarithm stand in the place of those of x, so that one
# product with the root's serves both
_beside = elementwise(PAIR, 1, lambda x, inverse: where(inverse > 0.0, 0.0 * x, x))
_any_branch = elementwise(
    PAIR,
    2,
    lambda product, hertz, x, by_x, root, by_root, by_log, inverse, k, share: (
        hertz * product + by_x * x + by_root * root + by_log * (log := (k * root - product) * inverse) * share,
        where(inverse > 0.0, log, x),
    ),
)
_virgin_start = elementwise(
    PAIR,
    1,
    lambda product, hertz, x, by_x, root, by_root, by_log, log, constant: (
        hertz * product + by_x * x + by_root * root + by_log * log + constant
    ),
)
_stiffer = elementwise(PAIR, 1, lambda force, spring: spring * force)
_odd_root = elementwise(PAIR, 1, lambda x, total, half: (x - 2.0 * total) * half)
_even_root = elementwise(PAIR, 1, lambda x, total, middle, half: (x - 2.0 * total - middle * middle) * half)
_spring = elementwise(PAIR, 1, lambda x, first: where(first > 0.0, x, 0.0))
_next_x = elementwise(
    LANES,
    3,
    lambda push_a, push_b, force_a, force_b, u, h, inverse_mu, share: (
        h * share * (push_a - force_a - u),
        h * share * (push_b - force_b + u),
        h * share * inverse_mu * (force_a - force_b),
    ),
)
_next_of_rig = elementwise(
    LANES,
    5,
    lambda push_a, push_b, force_a, force_b, u, w_a, w_b, gives_a, gives_b, light_a, light_b, there_a, there_b, h,
    inverse_mu, share: (
        h * share * there_a * (push_a + w_a - gives_a * force_a - u),
        h * share * there_b * (push_b + w_b - gives_b * force_b + u),
        h * share * inverse_mu * (force_a - force_b),
        0.0 - h * share * light_a * force_a,
        0.0 - h * share * light_b * force_b,
    ),
)  # fmt: skip
_next_massless = elementwise(
    LANES,
    3,
    lambda push_a, push_b, force_a, u, h, share: (
        (rate := h * share * (0.5 * (push_a + push_b) - force_a)),
        rate,
        0.0 * u,
    ),
)


@compiled(**INNER, forceinline=True)  # what a call hands over costs as much as the work
def _branches(k, x, root, force_k, law, log, inverse, start):
    """The k-th term of the forces where a face may be on virgin loading; start: room for the logarithm itself."""
    log_k, x_k, root_k, scale = row(log, k, 0), row(x, k, 0), row(root, k, 0), 1.0 * k
    _beside(log_k, x_k, inverse)
    products(log, root, k, 0, k + 1, force_k)
    if k > 0:
        _any_branch(force_k, log_k, force_k, row(law, HERTZ, 0), x_k, row(law, BY_X, 0), root_k, row(law, BY_ROOT, 0),
                    row(law, BY_LOG, 0), inverse, scale, 1.0 / scale)  # fmt: skip
        return
    for m in range(PAIR):
        start[0, m] = log_start(law, m, root[0, m]) if law[BY_LOG, m] != 0.0 else 0.0
    _virgin_start(force_k, force_k, row(law, HERTZ, 0), x_k, row(law, BY_X, 0), root_k, row(law, BY_ROOT, 0),
                  row(law, BY_LOG, 0), row(start, 0, 0), row(law, CONSTANT, 0))  # fmt: skip


# push (TERMS, PAIR): 2 f and -2 h_B.  A face whose approach is not positive carries no force.  yielding: whether faces
# have a law of their own; law: see `uqsphere.mechanics.integrator.faces`; log (TERMS, PAIR): k times the k-th term of l
# on virgin loading, else of x; inverse (PAIR,), start (TERMS, PAIR): room.  rigged, rig (RIGS, PAIR): whether something
# else than a bar stands at a pole, and what; free (TERMS, PAIR): the series of U_A and -U_B.
def _expand_of(plain, on_law):
    """The function that fills the series of x (TERMS, PAIR), u (TERMS, LANES), root = sqrt(x) and force = q(x).

    From their first terms.  plain: in steps in which no face has a law of its own, between bars; on_law: in those in
    which faces are on virgin loading.
    """

    @compiled(**INNER)
    def expand(
        mode, h, inverse_mu, push, x, u, root, force, half, yielding, law, log, inverse, rigged, rig, free, start,
    ):  # fmt: skip
        apart()
        if yielding and not plain:
            _shifted_root(row(root, 0, 0), half, inverse, row(x, 0, 0), row(law, SHIFT, 0), row(law, BY_LOG, 0),
                          row(law, BASE, 0))  # fmt: skip
        else:
            _first_root(row(root, 0, 0), half, row(x, 0, 0))
        for k in range(TERMS):
            x_k, force_k = row(x, k, 0), row(force, k, 0)
            if mode == 1:
                _spring(force_k, x_k, row(x, 0, 0))
            else:
                if k > 0:
                    root_k = row(root, k, 0)
                    products(root, root, k, 1, (k + 1) // 2, root_k)
                    if k % 2 == 0:
                        _even_root(root_k, x_k, root_k, row(root, k // 2, 0), half)
                    else:
                        _odd_root(root_k, x_k, root_k, half)
                if on_law:
                    _branches(k, x, root, force_k, law, log, inverse, start)
                else:
                    products(x, root, k, 0, k + 1, force_k)
                    if yielding and not plain:
                        _stiffer(force_k, force_k, row(law, SPRING, 0))
            if k == ORDER:
                break
            share = 1.0 / (k + 1.0)
            push_a, push_b = row(push, k, 0), row(push, k, LANES)
            x_a, x_b, u_next = row(x, k + 1, 0), row(x, k + 1, LANES), row(u, k + 1, 0)
            if mode == 2:
                _next_massless(x_a, x_b, u_next, push_a, push_b, force_k, row(u, k, 0), h, share)
            elif rigged and not plain:
                _next_of_rig(x_a, x_b, u_next, row(free, k + 1, 0), row(free, k + 1, LANES), push_a, push_b, force_k,
                             row(force, k, LANES), row(u, k, 0), row(free, k, 0), row(free, k, LANES),
                             row(rig, RIG_GIVES, 0), row(rig, RIG_GIVES, LANES), row(rig, RIG_LIGHTNESS, 0),
                             row(rig, RIG_LIGHTNESS, LANES), row(rig, RIG_THERE, 0), row(rig, RIG_THERE, LANES), h,
                             inverse_mu, share)  # fmt: skip
            else:
                _next_x(
                    x_a, x_b, u_next, push_a, push_b, force_k, row(force, k, LANES), row(u, k, 0), h, inverse_mu, share
                )

    return expand


expand_plain, expand, expand_virgin = _expand_of(True, False), _expand_of(False, False), _expand_of(False, True)


def _root_16(a):
    return root_of(root_of(root_of(root_of(a))))


def _larger_of(a, b, c, d):
    return larger(larger(size_of(a), size_of(b)), larger(size_of(c), size_of(d)))


def _by_terms(before, last, local):
    """theta at which theta^15 before + theta^16 last = local, by one step of a fixed-point iteration."""
    guess = smaller(_root_16(local / (before + last + 1e-300)), 8.0)
    two = guess * guess
    four = two * two
    eight = four * four
    reached = eight * four * two * guess * (before + guess * last)
    return guess * _root_16(local / (reached + 1e-300))


def _reached(x_11, y_11, x_12, y_12, x_15, y_15, x_16, y_16, u_15, u_16, scale_x, scale_u, local):
    before = larger(larger(size_of(x_15), size_of(y_15)) / scale_x, size_of(u_15) / scale_u)
    last = larger(larger(size_of(x_16), size_of(y_16)) / scale_x, size_of(u_16) / scale_u)
    theta = _by_terms(before, last, local)
    # where a face nearly leaves, x = 0 lies close to the real axis: the last terms may still be small beyond the
    # circle in which the series holds, and its radius follows from how they grow over four powers
    late = _larger_of(x_15, y_15, x_16, y_16)
    radius = root_of(root_of(_larger_of(x_11, y_11, x_12, y_12) / (late + 1e-300)))
    bounded = where(late > 1e-3 * local * scale_x, smaller(theta, _CIRCLE * radius), theta)
    # a series that has overflowed says nothing, except that the step was far too long
    return where(before + last < 1e200, bounded, 0.0)


def _radius(x_11, x_12, late):
    return root_of(root_of(larger(size_of(x_11), size_of(x_12)) / (late + 1e-300)))


def _reached_of_rig(x_11, y_11, x_12, y_12, x_15, y_15, x_16, y_16, u_15, u_16, v_15, w_15, v_16, w_16, scale_x,
                    scale_y, scale_u, scale_v, scale_w, local):  # fmt: skip
    """The same where every state has a scale of its own: both approaches, speeds of the sphere and of the partners."""
    before = larger(larger(size_of(x_15) / scale_x, size_of(y_15) / scale_y), size_of(u_15) / scale_u)
    last = larger(larger(size_of(x_16) / scale_x, size_of(y_16) / scale_y), size_of(u_16) / scale_u)
    before = larger(before, larger(size_of(v_15) / scale_v, size_of(w_15) / scale_w))
    last = larger(last, larger(size_of(v_16) / scale_v, size_of(w_16) / scale_w))
    theta = _by_terms(before, last, local)
    late_x, late_y = larger(size_of(x_15), size_of(x_16)), larger(size_of(y_15), size_of(y_16))
    theta = where(late_x > 1e-3 * local * scale_x, smaller(theta, _CIRCLE * _radius(x_11, x_12, late_x)), theta)
    theta = where(late_y > 1e-3 * local * scale_y, smaller(theta, _CIRCLE * _radius(y_11, y_12, late_y)), theta)
    return where(before + last < 1e200, theta, 0.0)


_longest = elementwise(LANES, 1, _reached)
_longest_of_rig = elementwise(LANES, 1, _reached_of_rig)


@compiled(**INNER)
def longest(x, u, free, scale, rigged, local, theta):
    """theta (LANES,) up to which the last two terms of every series stay below `local` times its scale.

    scale (SCALES, LANES): of x_1, u, x_2, U_A, U_B; without rigs the faces are alike.
    """
    apart()
    fourth, third, before, last = ORDER - 5, ORDER - 4, ORDER - 1, ORDER
    if rigged:
        _longest_of_rig(theta, row(x, fourth, 0), row(x, fourth, LANES), row(x, third, 0), row(x, third, LANES),
                        row(x, before, 0), row(x, before, LANES), row(x, last, 0), row(x, last, LANES),
                        row(u, before, 0), row(u, last, 0), row(free, before, 0), row(free, before, LANES),
                        row(free, last, 0), row(free, last, LANES), row(scale, 0, 0), row(scale, 2, 0),
                        row(scale, 1, 0), row(scale, 3, 0), row(scale, 4, 0), local)  # fmt: skip
        return
    _longest(theta, row(x, fourth, 0), row(x, fourth, LANES), row(x, third, 0), row(x, third, LANES),
             row(x, before, 0), row(x, before, LANES), row(x, last, 0), row(x, last, LANES), row(u, before, 0),
             row(u, last, 0), row(scale, 0, 0), row(scale, 1, 0), local)  # fmt: skip


# --- What a step may be and whether it holds, for all lanes: nothing here depends on a lane's neighbours.

_tried = elementwise(
    LANES,
    4,
    lambda proposed, stop, time, back, busy, fades, share, face_a, face_b, error, asked, scale: (
        where(busy > 0.0, smaller(smaller(proposed, stop - time), back), 0.0),
        where(time >= fades, share * larger(face_a, face_b), -math.inf),
        larger(100.0 * error, asked) * scale,
        0.0 * busy,
    ),
)
_cut = elementwise(
    LANES,
    1,
    lambda theta, h, stop, time: where(
        smaller(theta, 1.0) * h >= (left := stop - time) * (1.0 - 1e-10),
        1.0,
        where(2.0 * smaller(theta, 1.0) * h > left, smaller(smaller(theta, 1.0), 0.5 * left / h), smaller(theta, 1.0)),
    ),
)
_doubted = elementwise(
    LANES,
    2,
    lambda h, theta, branch_a, branch_b, error, scale, speed, inertia, touching, on_slow, misfit: (
        where(
            (touching + on_slow < 0.5)
            & (
                h * theta * larger(branch_a, branch_b) > smaller(100.0 * error * scale, 100.0 * error * inertia * speed)
            ),
            1.0,
            0.0 * h,
        ),
        where(misfit * h > error * scale, 1.0, where(theta > 0.0, 0.0 * h, 1.0)),
    ),
)
_same = elementwise(PAIR, 3, lambda x, rate, bow: (x, rate, bow))


@compiled(**INNER)
def try_step(h, low, near, misfit, proposed, stop, time, back, busy, fades, share, track, error, asked, size):
    """The steps h that are tried, 0 where a lane has no row; where a record may end, a contact count as lost."""
    _tried(h, low, near, misfit, proposed, stop, time, back, busy, fades, share, row(track, FACE_A, 0),
           row(track, FACE_B, 0), error, asked, row(size, 0, 0))  # fmt: skip


@compiled(**INNER)
def cut_at_stop(theta, h, stop, time):
    """Cut steps where they have to end: at `stop`, or halfway to it where little would be left."""
    _cut(theta, theta, h, stop, time)


@compiled(**INNER)
def doubt(crosses, unfit, h, theta, columns, error, size, inertia, touching, on_slow, misfit):
    """1 where a step may have gone through a loss of contact, and where its waves do not fit or it is none.

    columns: its row 1 is what `root_error` found.
    """
    _doubted(crosses, unfit, h, theta, row(columns, 1, 0), row(columns, 1, LANES), error, row(size, 0, 0),
             row(size, 1, 0), inertia, touching, on_slow, misfit)  # fmt: skip


@compiled(**INNER)
def start_points(at, rate, bow, x):
    """Values, derivatives and half the second ones at the start of a step."""
    _same(row(at, 0, 0), row(rate, 0, 0), row(bow, 0, 0), row(x, 0, 0), row(x, 1, 0), row(x, 2, 0))


@compiled(**INNER)
def evaluate(x, theta, share, place, at, rate):
    """Series x (TERMS, columns) and its derivative by theta at share·theta, every lane at its own theta.

    at, rate: rows of `columns` numbers.
    """
    apart()
    for j in range(LANES):
        place[j] = share * theta[j]
    for c in range(0, x.shape[1], LANES):
        derivatives_at(x, ORDER, x.shape[1], c, place, at, rate)


@compiled(**INNER)
def evaluate_bent(x, theta, share, place, at, rate, bend):
    """The same with half the second derivative; bits of `at` and `rate` are those of `evaluate`."""
    apart()
    for j in range(LANES):
        place[j] = share * theta[j]
    for c in range(0, PAIR, LANES):
        curves_at(x, ORDER, PAIR, c, place, at, rate, bend)


_unlike = elementwise(
    PAIR,
    1,
    lambda begin, root, x, shift: where(
        (begin > 0.0) & (x > 0.0), x * size_of(root - root_of(larger(x + shift, 0.0))), 0.0
    ),
)


@compiled(**INNER)
def root_error(root, theta, place, at, law, found, value, slope):
    """found (PAIR,): by how much the force of the series of sqrt(x) differs at the step's end from that of x.

    Past a point where a face nearly leaves, x has two complex roots so close to the real axis that the series
    walks between them and goes on, smoothly, with -sqrt(x).  at: approaches at the step's ends, first and last.
    """
    apart()
    evaluate(root, theta, 1.0, place, value, slope)
    _unlike(found, row(at, 0, 0), value, row(at, at.shape[0] - 1, 0), row(law, SHIFT, 0))


@compiled(**INNER)
def _own_forces(law, j, x1, x2):
    """Forces of faces with laws of their own."""
    apart()
    return face_force(law, j, x1)[0], face_force(law, LANES + j, x2)[0]


@compiled(**INNER)
def _moved(state, share, slopes):
    """state + share·slopes."""
    x1, x2, u, w1, w2 = state
    d1, d2, du, e1, e2 = slopes
    return x1 + share * d1, x2 + share * d2, u + share * du, w1 + share * e1, w2 + share * e2


@compiled(**INNER)
def _mean_slopes(first, second, third, fourth):
    """Six times the slopes that a step of Runge and Kutta takes."""
    a1, a2, a3, a4, a5 = first
    b1, b2, b3, b4, b5 = second
    c1, c2, c3, c4, c5 = third
    d1, d2, d3, d4, d5 = fourth
    return (
        a1 + 2.0 * (b1 + c1) + d1,
        a2 + 2.0 * (b2 + c2) + d2,
        a3 + 2.0 * (b3 + c3) + d3,
        a4 + 2.0 * (b4 + c4) + d4,
        a5 + 2.0 * (b5 + c5) + d5,
    )


@compiled(**INNER)
def _join(series, m, theta, left, left_slope, right, right_slope):
    """Put the cubic through values and slopes (by theta) at 0 and theta into a column of a series."""
    rise = (right - left) / theta
    series[0, m] = left
    series[1, m] = left_slope
    series[2, m] = (3.0 * rise - 2.0 * left_slope - right_slope) / theta
    series[3, m] = (left_slope + right_slope - 2.0 * rise) / (theta * theta)
    for k in range(4, TERMS):
        series[k, m] = 0.0


def _touch_of(plain):
    """The function that takes a first short step of one lane from a touch, where x^(3/2) has no power series in time.

    Runge-Kutta steps of order 4 over h; the series of the lane are replaced by cubics that join both ends.  plain: for
    a lane whose faces have no laws of their own, between bars.
    """

    @compiled(**INNER)
    def slopes(mode, inverse_mu, push_a, push_b, state, own, law, poles, j):
        """Right-hand side of theory (9) and (R3) for one lane: of x_1, x_2, u, U_A, -U_B."""
        x1, x2, u, w1, w2 = state
        gives_a, gives_b, light_a, light_b, there_a, there_b = poles
        pressed_a, pressed_b = max(x1, 0.0), max(x2, 0.0)
        if not plain and own:
            force_a, force_b = _own_forces(law, j, x1, x2)
        elif mode == 1:
            force_a, force_b = pressed_a, pressed_b
        else:
            force_a, force_b = pressed_a * math.sqrt(pressed_a), pressed_b * math.sqrt(pressed_b)
        if mode == 2:
            rate = 0.5 * (push_a + push_b) - force_a
            return rate, rate, 0.0, 0.0, 0.0
        return (
            there_a * (push_a - gives_a * force_a - u + w1),
            there_b * (push_b - gives_b * force_b + u + w2),
            (force_a - force_b) * inverse_mu,
            -light_a * force_a,
            -light_b * force_b,
        )

    @compiled(**INNER)
    def step_from_touch(mode, j, h, inverse_mu, push, x, u, force, yielding, law, rig, free):
        apart()
        own, k = yielding and not plain, LANES + j
        state = x[0, j], x[0, k], u[0, j], free[0, j], free[0, k]
        # zeta, 1/mu_i and 1 or 0 of both poles
        poles = 1.0, 1.0, 0.0, 0.0, 1.0, 1.0
        if not plain:
            poles = (rig[RIG_GIVES, j], rig[RIG_GIVES, k], rig[RIG_LIGHTNESS, j], rig[RIG_LIGHTNESS, k],
                     rig[RIG_THERE, j], rig[RIG_THERE, k])  # fmt: skip
        old, d = state, h / _TOUCH_STEPS
        begin = slopes(mode, inverse_mu, push[0, j], push[0, k], state, own, law, poles, j)
        last = begin
        for i in range(_TOUCH_STEPS):
            t = 1.0 * i / _TOUCH_STEPS
            half, full = t + 0.5 / _TOUCH_STEPS, t + 1.0 / _TOUCH_STEPS
            first = last
            mid_a, mid_b = value_of(push, j, half), value_of(push, k, half)
            second = slopes(mode, inverse_mu, mid_a, mid_b, _moved(state, 0.5 * d, first), own, law, poles, j)
            third = slopes(mode, inverse_mu, mid_a, mid_b, _moved(state, 0.5 * d, second), own, law, poles, j)
            end_a, end_b = value_of(push, j, full), value_of(push, k, full)
            fourth = slopes(mode, inverse_mu, end_a, end_b, _moved(state, d, third), own, law, poles, j)
            state = _moved(state, d / 6.0, _mean_slopes(first, second, third, fourth))
            last = slopes(mode, inverse_mu, end_a, end_b, state, own, law, poles, j)
        _join(x, j, 1.0, old[0], h * begin[0], state[0], h * last[0])
        _join(x, k, 1.0, old[1], h * begin[1], state[1], h * last[1])
        _join(u, j, 1.0, old[2], h * begin[2], state[2], h * last[2])
        if not plain:
            _join(free, j, 1.0, old[3], h * begin[3], state[3], h * last[3])
            _join(free, k, 1.0, old[4], h * begin[4], state[4], h * last[4])
        for face in range(2):
            m = face * LANES + j
            left, right = (old[0], state[0]) if face == 0 else (old[1], state[1])
            left_slope, right_slope = x[1, m], h * (last[0] if face == 0 else last[1])
            left, left_slope = (left, left_slope) if left > 0.0 else (0.0, 0.0)
            right, right_slope = (right, right_slope) if right > 0.0 else (0.0, 0.0)
            if own:
                left_force, left_rate = face_force(law, m, left)
                right_force, right_rate = face_force(law, m, right)
                _join(force, m, 1.0, left_force, left_rate * left_slope, right_force, right_rate * right_slope)
            elif mode == 1:
                _join(force, m, 1.0, left, left_slope, right, right_slope)
            else:
                _join(force, m, 1.0, left * math.sqrt(left), 1.5 * math.sqrt(left) * left_slope,
                      right * math.sqrt(right), 1.5 * math.sqrt(right) * right_slope)  # fmt: skip

    return step_from_touch


step_from_touch, step_from_touch_plain = _touch_of(False), _touch_of(True)


# --- Steps along the slow motion: once the fast oscillation has died out, nothing of it needs to be resolved.
# For small mu the difference z = x_1 - x_2 of the approaches swings with the frequency sqrt(3 sqrt(x)/mu) and dies
# out at the rate 0.75 sqrt(x).  What is left follows the waves: with m = (x_1 + x_2)/2 and D = q(x_1) - q(x_2),
# theory (9) reads
#
# m' = f - h - (q(x_1) + q(x_2))/2        u = f + h - D/2 - z'/2        D = mu u'
#
# Starting from z = 0, the second and the third equation give u, D and z in turn, each round a factor of about
# mu smaller, all as power series over the step; the first one is integrated term by term.  The series is used where
# it satisfies the equations of motion to the tolerance and where it meets the state of the row.
# Faces that have yielded are springs of different stiffness k_1, k_2 above their dents: equal forces then mean
# z = tilt m, from which the rounds start.

#: mass number below which the slow motion is looked for
SMALL_MU = 0.02
#: rows of working space that `slow_step` needs
SLOW_ROOM = 11
#: most rounds of the iteration; each spoils the last two terms of the series
_ROUNDS = 5
#: terms that stay good after the rounds
_GOOD = 10


@compiled(**INNER)
def _slope(series, k_row, theta):
    total = 0.0
    for k in range(TERMS - 1, 0, -1):
        total = total * theta + k * series[k_row, k]
    return total


@compiled(**INNER)
def _slow_mean(lane, h, push, s, springs, tilt):
    """Integrate m for a given z; rows of s: m, z, u, x_1, x_2, sqrt(x_1), sqrt(x_2), q_1, q_2."""
    apart()
    for k in range(TERMS):
        if tilt != 0.0:
            s[1, k] = tilt * s[0, k]
        for face in range(2):
            x, y, q = 3 + face, 5 + face, 7 + face
            s[x, k] = s[0, k] + (0.5 - face) * s[1, k]
            if k == 0:
                if not s[x, 0] > 0.0:
                    return False
                s[y, 0] = math.sqrt(s[x, 0])
            else:
                total = 0.0
                for i in range(1, k):
                    total += s[y, i] * s[y, k - i]
                s[y, k] = 0.5 * (s[x, k] - total) / s[y, 0]
            total = 0.0
            for i in range(k + 1):
                total += s[x, i] * s[y, k - i]
            s[q, k] = springs[face] * total
        if k < TERMS - 1:
            rate = 0.5 * (push[k, lane] + push[k, LANES + lane] - s[7, k] - s[8, k])
            s[0, k + 1] = h * rate / (k + 1.0)
    return True


@compiled(**INNER)
def _correct(lane, h, mu, push, s, springs):
    """One round: u from the waves, D from u, z from D.  Returns the largest change of z in the step, of its terms."""
    apart()
    # s[9]: what D lacks, s[10]: the change of z
    for k in range(TERMS):
        swing = (k + 1.0) * s[1, k + 1] / h if k + 1 < TERMS else 0.0
        s[2, k] = 0.5 * (push[k, lane] - push[k, LANES + lane] - (s[7, k] - s[8, k]) - swing)
    for k in range(TERMS):
        wanted = mu * (k + 1.0) * s[2, k + 1] / h if k + 1 < TERMS else 0.0
        s[9, k] = (wanted - (s[7, k] - s[8, k])) / 0.75
    stiff_1, stiff_2 = springs
    lead, change = stiff_1 * s[5, 0] + stiff_2 * s[6, 0], 0.0
    for k in range(TERMS):
        total = s[9, k]
        for i in range(1, k + 1):
            total -= (stiff_1 * s[5, i] + stiff_2 * s[6, i]) * s[10, k - i]
        s[10, k] = total / lead
        s[1, k] += s[10, k]
        if k <= _GOOD:
            change += abs(s[10, k])
    return change


@compiled(**INNER)
def _residual(lane, h, mu, push, s, springs, theta):
    """Largest error with which the series satisfies the equations at theta, as an error of an approach."""
    apart()
    a, b, w = value(s, 3, theta), value(s, 4, theta), value(s, 2, theta)
    if not (a > 0.0 and b > 0.0):
        return math.inf
    push_a, push_b = 0.0, 0.0
    for k in range(TERMS - 1, -1, -1):
        push_a, push_b = push_a * theta + push[k, lane], push_b * theta + push[k, LANES + lane]
    force_a, force_b = springs[0] * (a * math.sqrt(a)), springs[1] * (b * math.sqrt(b))
    length = theta * h
    first = abs(_slope(s, 3, theta) / h - (push_a - force_a - w)) * length
    second = abs(_slope(s, 4, theta) / h - (push_b - force_b + w)) * length
    third = abs(mu * _slope(s, 2, theta) / h - (force_a - force_b)) / (1.5 * springs[0] * math.sqrt(a))
    return max(first, max(second, third))


@compiled(**INNER)
def decay_time(mu, local):
    """Time that the oscillation which a jump sets off, about mu^0.45, needs at least to fall to the tolerance."""
    apart()
    return max(0.0, math.log(mu**0.45 / local))


@compiled(**INNER)
def slow_step(lane, h, mu, push, x, u, root, force, size, local, on_slow, s, springs):
    """Try to replace the step of one lane by one of the slow motion: theta it may reach, 0 if none; amplitude.

    The amplitude is that of the fast oscillation that the state of the row has about the slow motion, as an
    approach; it must lie below the tolerance.  size: scale of the approaches, s (SLOW_ROOM, TERMS): working space;
    springs: factors of x^(3/2) at the faces.
    """
    apart()
    mean, swing, speed = 0.5 * (x[0, lane] + x[0, LANES + lane]), x[0, lane] - x[0, LANES + lane], u[0, lane]
    for k in range(TERMS):
        s[1, k] = 0.0
    s[0, 0] = mean
    allowed = local * size
    tilt = 0.0
    if springs[0] != springs[1]:
        ratio = (springs[1] / springs[0]) ** (2.0 / 3.0)
        tilt = 2.0 * (ratio - 1.0) / (ratio + 1.0)
    for _ in range(_ROUNDS):
        if not _slow_mean(lane, h, push, s, springs, tilt):
            return 0.0, math.inf
        tilt = 0.0
        change = _correct(lane, h, mu, push, s, springs)
        if not change < mean:
            return 0.0, math.inf
        if change < 0.01 * allowed:
            break
    if not _slow_mean(lane, h, push, s, springs, tilt):
        return 0.0, math.inf
    fast = math.sqrt(mu / (3.0 * springs[0] * s[5, 0]))
    amplitude = max(abs(swing - s[1, 0]), 2.0 * abs(speed - s[2, 0]) * fast)
    if not amplitude <= (2.0 if on_slow else 0.5) * allowed:
        return 0.0, amplitude
    theta = 1.0
    for _ in range(12):
        if (
            max(
                _residual(lane, h, mu, push, s, springs, theta),
                _residual(lane, h, mu, push, s, springs, 0.6 * theta),
            )
            <= allowed
        ):
            break
        theta *= 0.6
    else:
        return 0.0, amplitude
    for k in range(TERMS):
        x[k, lane], x[k, LANES + lane], u[k, lane] = s[3, k], s[4, k], s[2, k]
        root[k, lane], root[k, LANES + lane] = s[5, k], s[6, k]
        force[k, lane], force[k, LANES + lane] = s[7, k], s[8, k]
    return theta, amplitude

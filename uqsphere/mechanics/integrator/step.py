"""One step of the equations of motion as a power series in time, for all lanes of the integrator at
once.

The motion between two jumps of the waves is analytic as long as a pressed face stays pressed, so
its Taylor series about the start of a step follows from recurrences for products and square roots
(R. Barrio, Appl. Math. Comput. 163, 2005, 525; A. Jorba, M. Zou, Experimental Mathematics 14, 2005,
99).  With theta = 0 ... 1 over the length h of the step, theory (9) reads for the coefficients

    (k+1) x_1[k+1] = h (2 f[k] - q_1[k] - u[k])          q = x y,  y² = x:
    (k+1) x_2[k+1] = h (u[k] - q_2[k] - 2 h_B[k])        2 y[0] y[k] = x[k] - sum of y[j] y[k-j], 0
    < j < k (k+1) u[k+1]   = h (q_1[k] - q_2[k])/mu              q[k] = sum of x[j] y[k-j], 0 <= j
    <= k

The series serves three ends at once: it makes the step, it says how long the step may be, and it is
the motion inside the step.  Arrays are (coefficient, lane); what exists at both faces has the lanes
of face A first, then those of face B.  Between other partners than bars the equations are (R3), see
`uqsphere.mechanics.integrator.solve`.
"""

from __future__ import annotations

import math

from uqsphere.mechanics.integrator.compiled import compiled
from uqsphere.mechanics.integrator.faces import face_force, log_start
from uqsphere.mechanics.integrator.searches import both_of, value_of
from uqsphere.mechanics.integrator.tracked import (
    LANES,
    LINEAR,
    MASSLESS,
    ORDER,
    PAIR,
    POINTS,
    TERMS,
)
from uqsphere.mechanics.integrator.vectors import (
    apart,
    curves_at,
    derivatives_at,
    elementwise,
    larger,
    part,
    products,
    root_of,
    row,
    size_of,
    smaller,
    where,
)

#: share of the radius of convergence that a step may use: 0.85^16 is 0.07 (docs/theory.md, section
#: 5)
_CIRCLE = 0.85
#: Runge-Kutta steps over a touch
_TOUCH_STEPS = 4


# the parts of the recurrences that are done column by column
_first_root = elementwise(
    PAIR,
    2,
    lambda x: (root_of(larger(x, 0.0)), where(x > 0.0, 0.5 / root_of(larger(x, 1e-300)), 0.0)),
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
# of a face on virgin loading (inverse > 0) the terms of the logarithm stand in the place of those
# of x, so that one product with the root's serves both
_beside = elementwise(PAIR, 1, lambda x, inverse: where(inverse > 0.0, 0.0 * x, x))
_any_branch = elementwise(
    PAIR,
    2,
    lambda product, hertz, x, by_x, root, by_root, by_log, inverse, k, share: (
        hertz * product
        + by_x * x
        + by_root * root
        + by_log * (log := (k * root - product) * inverse) * share,
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
_even_root = elementwise(
    PAIR, 1, lambda x, total, middle, half: (x - 2.0 * total - middle * middle) * half
)
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
    lambda push_a, push_b, force_a, force_b, u, w_a, w_b, gives_a, gives_b, light_a, light_b, there_a, there_b, h, inverse_mu, share: (  # noqa: E501
        h * share * there_a * (push_a + w_a - gives_a * force_a - u),
        h * share * there_b * (push_b + w_b - gives_b * force_b + u),
        h * share * inverse_mu * (force_a - force_b),
        0.0 - h * share * light_a * force_a,
        0.0 - h * share * light_b * force_b,
    ),
)
_next_massless = elementwise(
    LANES,
    3,
    lambda push_a, push_b, force_a, u, h, share: (
        (rate := h * share * (0.5 * (push_a + push_b) - force_a)),
        rate,
        0.0 * u,
    ),
)


@compiled(forceinline=True)  # what a call hands over costs as much as the work
def _branches(s, k):
    """The k-th term of the forces where a face may be on virgin loading, (C5)."""
    log_k, x_k, root_k, force_k, scale = (
        row(s.log, k, 0),
        row(s.x, k, 0),
        row(s.root, k, 0),
        row(s.force, k, 0),
        1.0 * k,
    )
    _beside(log_k, x_k, s.inverse)
    products(s.log, s.root, k, 0, k + 1, force_k)
    if k > 0:
        _any_branch(
            force_k,
            log_k,
            force_k,
            s.hertz,
            x_k,
            s.by_x,
            root_k,
            s.by_root,
            s.by_log,
            s.inverse,
            scale,
            1.0 / scale,
        )
        return
    for m in range(PAIR):
        s.start[m] = log_start(s, m, s.root[0, m]) if s.by_log[m] != 0.0 else 0.0
    _virgin_start(
        force_k, force_k, s.hertz, x_k, s.by_x, root_k, s.by_root, s.by_log, s.start, s.constant
    )


@compiled
def expand(s, by_law, virgin):
    """Fill the series of x, u, root = sqrt(x) and force = q(x) from their first terms, theory (9)
    and (R3).

    s.push: 2 f and -2 h_B.  A face whose approach is not positive carries no force.  by_law:
    whether forces follow laws of faces, virgin: whether one is on virgin loading; s.log is then k
    times the k-th term of l there, else of x.
    """
    apart()
    x, u, root, force, free = s.x, s.u, s.root, s.force, s.free
    if by_law:
        _shifted_root(row(root, 0, 0), s.half, s.inverse, row(x, 0, 0), s.shift, s.by_log, s.base)
    else:
        _first_root(row(root, 0, 0), s.half, row(x, 0, 0))
    for k in range(TERMS):
        x_k, root_k, force_k = row(x, k, 0), row(root, k, 0), row(force, k, 0)
        if s.mode == LINEAR:
            _spring(force_k, x_k, row(x, 0, 0))
        else:
            if k > 0:
                products(root, root, k, 1, (k + 1) // 2, root_k)
                if k % 2 == 0:
                    _even_root(root_k, x_k, root_k, row(root, k // 2, 0), s.half)
                else:
                    _odd_root(root_k, x_k, root_k, s.half)
            if virgin:
                _branches(s, k)
            else:
                products(x, root, k, 0, k + 1, force_k)
                if by_law:
                    _stiffer(force_k, force_k, s.spring)
        if k == ORDER:
            break
        share, u_k, force_b = 1.0 / (k + 1.0), row(u, k, 0), row(force, k, LANES)
        push_a, push_b = row(s.push, k, 0), row(s.push, k, LANES)
        x_a, x_b, u_next = row(x, k + 1, 0), row(x, k + 1, LANES), row(u, k + 1, 0)
        if s.mode == MASSLESS:
            _next_massless(x_a, x_b, u_next, push_a, push_b, force_k, u_k, s.h, share)
        elif s.rigged:
            _next_of_rig(
                x_a,
                x_b,
                u_next,
                row(free, k + 1, 0),
                row(free, k + 1, LANES),
                push_a,
                push_b,
                force_k,
                force_b,
                u_k,
                row(free, k, 0),
                row(free, k, LANES),
                part(s.gives, 0),
                part(s.gives, LANES),
                part(s.lightness, 0),
                part(s.lightness, LANES),
                part(s.there, 0),
                part(s.there, LANES),
                s.h,
                s.inverse_mu,
                share,
            )
        else:
            _next_x(
                x_a, x_b, u_next, push_a, push_b, force_k, force_b, u_k, s.h, s.inverse_mu, share
            )


def _root_16(a):
    return root_of(root_of(root_of(root_of(a))))


def _larger_of(a, b, c, d):
    return larger(larger(size_of(a), size_of(b)), larger(size_of(c), size_of(d)))


def _by_terms(before, last, local):
    """theta at which theta^15 before + theta^16 last = local, by one step of a fixed-point
    iteration.
    """
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
    # where a face nearly leaves, x = 0 lies close to the real axis: the last terms may still be
    # small beyond the circle in which the series holds, and its radius follows from how they grow
    # over four powers
    late = _larger_of(x_15, y_15, x_16, y_16)
    radius = root_of(root_of(_larger_of(x_11, y_11, x_12, y_12) / (late + 1e-300)))
    bounded = where(late > 1e-3 * local * scale_x, smaller(theta, _CIRCLE * radius), theta)
    # a series that has overflowed says nothing, except that the step was far too long
    return where(before + last < 1e200, bounded, 0.0)


def _radius(x_11, x_12, late):
    return root_of(root_of(larger(size_of(x_11), size_of(x_12)) / (late + 1e-300)))


def _reached_of_rig(
    x_11,
    y_11,
    x_12,
    y_12,
    x_15,
    y_15,
    x_16,
    y_16,
    u_15,
    u_16,
    v_15,
    w_15,
    v_16,
    w_16,
    scale_x,
    scale_y,
    scale_u,
    scale_v,
    scale_w,
    local,
):
    """The same where every state has a scale of its own: both approaches, speeds of the sphere and
    of the partners.
    """
    before = larger(
        larger(size_of(x_15) / scale_x, size_of(y_15) / scale_y), size_of(u_15) / scale_u
    )
    last = larger(larger(size_of(x_16) / scale_x, size_of(y_16) / scale_y), size_of(u_16) / scale_u)
    before = larger(before, larger(size_of(v_15) / scale_v, size_of(w_15) / scale_w))
    last = larger(last, larger(size_of(v_16) / scale_v, size_of(w_16) / scale_w))
    theta = _by_terms(before, last, local)
    late_x, late_y = larger(size_of(x_15), size_of(x_16)), larger(size_of(y_15), size_of(y_16))
    theta = where(
        late_x > 1e-3 * local * scale_x,
        smaller(theta, _CIRCLE * _radius(x_11, x_12, late_x)),
        theta,
    )
    theta = where(
        late_y > 1e-3 * local * scale_y,
        smaller(theta, _CIRCLE * _radius(y_11, y_12, late_y)),
        theta,
    )
    return where(before + last < 1e200, theta, 0.0)


_longest = elementwise(LANES, 1, _reached)
_longest_of_rig = elementwise(LANES, 1, _reached_of_rig)


@compiled
def longest(s):
    """theta up to which the last two terms of every series stay below the error allowed, times its
    scale.

    s.size (SCALES, LANES): scales of x_1, u, x_2, U_A, U_B; without rigs the faces are alike.
    """
    apart()
    x, u, free, size = s.x, s.u, s.free, s.size
    fourth, third, before, last = ORDER - 5, ORDER - 4, ORDER - 1, ORDER
    if s.rigged:
        _longest_of_rig(
            s.theta,
            row(x, fourth, 0),
            row(x, fourth, LANES),
            row(x, third, 0),
            row(x, third, LANES),
            row(x, before, 0),
            row(x, before, LANES),
            row(x, last, 0),
            row(x, last, LANES),
            row(u, before, 0),
            row(u, last, 0),
            row(free, before, 0),
            row(free, before, LANES),
            row(free, last, 0),
            row(free, last, LANES),
            row(size, 0, 0),
            row(size, 2, 0),
            row(size, 1, 0),
            row(size, 3, 0),
            row(size, 4, 0),
            s.error,
        )
        return
    _longest(
        s.theta,
        row(x, fourth, 0),
        row(x, fourth, LANES),
        row(x, third, 0),
        row(x, third, LANES),
        row(x, before, 0),
        row(x, before, LANES),
        row(x, last, 0),
        row(x, last, LANES),
        row(u, before, 0),
        row(u, last, 0),
        row(size, 0, 0),
        row(size, 1, 0),
        s.error,
    )


# --- What a step may be and whether it holds, for all lanes: nothing here depends on a lane's
# neighbours.

_cut = elementwise(
    LANES,
    1,
    lambda theta, h, stop, time: where(
        smaller(theta, 1.0) * h >= (left := stop - time) * (1.0 - 1e-10),
        1.0,
        where(
            2.0 * smaller(theta, 1.0) * h > left,
            smaller(smaller(theta, 1.0), 0.5 * left / h),
            smaller(theta, 1.0),
        ),
    ),
)
#: errors allowed in one step that the series of the root may part from the root at the step's end,
#: as the impulse of that difference over the whole step.  At 100 a light sphere, whose speed errs
#: by as much at every near loss, had P_max 27 tolerances off (campaign sweep, each quantity alone)
_APART = 3.0


def _impulse(h, theta, wrong_a, wrong_b, error, scale, speed, inertia):
    """Impulse by which a step errs at most whose root's series parts from the root, over what may
    be.
    """
    allowed = _APART * error * smaller(scale, inertia * speed)
    return h * theta * larger(wrong_a, wrong_b) / allowed


def _shortened(theta, h, wrong_a, wrong_b, error, scale, speed, inertia, touching, on_slow):
    """The share of a step up to which the root's series holds, if what grows is its last term."""
    excess = _impulse(h, theta, wrong_a, wrong_b, error, scale, speed, inertia)
    shorter = theta * larger(0.5, 0.95 / _root_16(larger(excess, 1.0)))
    return where((touching + on_slow < 0.5) & (excess > 1.0), shorter, theta)


def _doubts(h, theta, wrong_a, wrong_b, error, scale, speed, inertia, touching, on_slow, misfit):
    """1 where a step has gone through a loss of contact; 1 where its waves do not fit, or where it
    is none.
    """
    excess = _impulse(h, theta, wrong_a, wrong_b, error, scale, speed, inertia)
    return (
        where((touching + on_slow < 0.5) & (excess > 1.0), 1.0, 0.0 * h),
        where(misfit * h > error * scale, 1.0, where(theta > 0.0, 0.0 * h, 1.0)),
    )


_shorten = elementwise(LANES, 1, _shortened)
_doubted = elementwise(LANES, 2, _doubts)
_same = elementwise(PAIR, 3, lambda x, rate, bow: (x, rate, bow))


@compiled
def cut_at_stop(s):
    """Cut steps where they have to end: at `stop`, or halfway to it where little would be left."""
    _cut(s.theta, s.theta, s.h, s.stop, s.time)


@compiled
def doubt(s):
    """1 where a step may have gone through a loss of contact, and where its waves do not fit or it
    is none.
    """
    apart()
    _doubted(
        s.crosses,
        s.unfit,
        s.h,
        s.theta,
        part(s.wrong, 0),
        part(s.wrong, LANES),
        s.error,
        row(s.size, 0, 0),
        row(s.size, 1, 0),
        s.inertia,
        s.touching,
        s.on_slow,
        s.misfit,
    )


@compiled
def inside(s, bent):
    """Values, derivatives and, if `bent`, half the second ones of the approaches at equal distances
    over the step.
    """
    apart()
    for j in range(LANES):
        s.width[j] = s.width[LANES + j] = s.theta[j] * (1.0 / POINTS)
    _same(
        row(s.at, 0, 0),
        row(s.rate, 0, 0),
        row(s.bow, 0, 0),
        row(s.x, 0, 0),
        row(s.x, 1, 0),
        row(s.x, 2, 0),
    )
    for i in range(1, POINTS + 1):
        for j in range(LANES):
            s.place_of[j] = i / POINTS * s.theta[j]
        at, rate = row(s.at, i, 0), row(s.rate, i, 0)
        for c in range(0, PAIR, LANES):
            if bent:
                curves_at(s.x, ORDER, PAIR, c, s.place_of, at, rate, row(s.bow, i, 0))
            else:
                derivatives_at(s.x, ORDER, PAIR, c, s.place_of, at, rate)


_unlike = elementwise(
    PAIR,
    1,
    lambda begin, root, x, shift: where(
        (begin > 0.0) & (x > 0.0), x * size_of(root - root_of(larger(x + shift, 0.0))), 0.0
    ),
)


@compiled
def wrong_roots(s):
    """s.wrong (PAIR,): by how much the force of the series of sqrt(x) differs at the step's end
    from that of x.

    Past a point where a face nearly leaves, x has two complex roots so close to the real axis that
    the series walks between them and goes on, smoothly, with -sqrt(x).
    """
    apart()
    value, slope = row(s.room, 0, 0), row(s.room, 1, 0)
    for c in range(0, PAIR, LANES):
        derivatives_at(s.root, ORDER, PAIR, c, s.theta, value, slope)
    _unlike(s.wrong, row(s.at, 0, 0), value, row(s.at, POINTS, 0), s.shift)


@compiled
def keep_root(s):
    """Shorten the steps at whose ends the root's series has parted from the root."""
    apart()
    value, slope, end = row(s.room, 0, 0), row(s.room, 1, 0), row(s.room, 2, 0)
    for _ in range(3):
        for c in range(0, PAIR, LANES):
            derivatives_at(s.root, ORDER, PAIR, c, s.theta, value, slope)
            derivatives_at(s.x, ORDER, PAIR, c, s.theta, end, slope)
        _unlike(s.wrong, row(s.x, 0, 0), value, end, s.shift)
        for j in range(LANES):
            s.place_of[j] = s.theta[j]
        _shorten(
            s.theta,
            s.theta,
            s.h,
            part(s.wrong, 0),
            part(s.wrong, LANES),
            s.error,
            row(s.size, 0, 0),
            row(s.size, 1, 0),
            s.inertia,
            s.touching,
            s.on_slow,
        )
        shorter = False
        for j in range(LANES):
            shorter |= s.theta[j] < s.place_of[j] and s.row[j] >= 0
        if not shorter:
            break


@compiled
def speeds(s):
    """The sphere's speed at the steps' ends."""
    apart()
    derivatives_at(s.u, ORDER, LANES, 0, s.theta, s.at_u, s.rate_u)


# --- The first short step from a touch, where x^(3/2) has no power series in time: Runge-Kutta
# steps of order 4 over h.


@compiled
def _slopes(s, j, push_a, push_b, state):
    """Right-hand side of theory (9) and (R3) for one lane: of x_1, x_2, u, U_A, -U_B."""
    x1, x2, u, w1, w2 = state
    k = LANES + j
    force_a, force_b = face_force(s, j, x1)[0], face_force(s, k, x2)[0]
    if s.mode == MASSLESS:
        rate = 0.5 * (push_a + push_b) - force_a
        return rate, rate, 0.0, 0.0, 0.0
    return (
        s.there[j] * (push_a - s.gives[j] * force_a - u + w1),
        s.there[k] * (push_b - s.gives[k] * force_b + u + w2),
        (force_a - force_b) * s.inverse_mu[j],
        -s.lightness[j] * force_a,
        -s.lightness[k] * force_b,
    )


@compiled
def _moved(state, share, slopes):
    """state + share·slopes."""
    x1, x2, u, w1, w2 = state
    d1, d2, du, e1, e2 = slopes
    return x1 + share * d1, x2 + share * d2, u + share * du, w1 + share * e1, w2 + share * e2


@compiled
def _join(series, m, left, left_slope, right, right_slope):
    """Put the cubic through values and slopes at 0 and 1 into a column of a series."""
    rise = right - left
    series[0, m] = left
    series[1, m] = left_slope
    series[2, m] = 3.0 * rise - 2.0 * left_slope - right_slope
    series[3, m] = left_slope + right_slope - 2.0 * rise
    for k in range(4, TERMS):
        series[k, m] = 0.0


@compiled
def step_from_touch(s, j):
    """Replace the series of a lane over its trial step by cubics that join both ends."""
    apart()
    k, d = LANES + j, s.h[j] / _TOUCH_STEPS
    state = s.x[0, j], s.x[0, k], s.u[0, j], s.free[0, j], s.free[0, k]
    old, begin = state, _slopes(s, j, s.push[0, j], s.push[0, k], state)
    last = begin
    for i in range(_TOUCH_STEPS):
        t = 1.0 * i / _TOUCH_STEPS
        half, full = t + 0.5 / _TOUCH_STEPS, t + 1.0 / _TOUCH_STEPS
        mid_a, mid_b = value_of(s.push, j, half), value_of(s.push, k, half)
        end_a, end_b = value_of(s.push, j, full), value_of(s.push, k, full)
        second = _slopes(s, j, mid_a, mid_b, _moved(state, 0.5 * d, last))
        third = _slopes(s, j, mid_a, mid_b, _moved(state, 0.5 * d, second))
        fourth = _slopes(s, j, end_a, end_b, _moved(state, d, third))
        state = _moved(
            _moved(_moved(state, d / 6.0, last), d / 3.0, _moved(second, 1.0, third)),
            d / 6.0,
            fourth,
        )
        last = _slopes(s, j, end_a, end_b, state)
    h = s.h[j]
    _join(s.x, j, old[0], h * begin[0], state[0], h * last[0])
    _join(s.x, k, old[1], h * begin[1], state[1], h * last[1])
    _join(s.u, j, old[2], h * begin[2], state[2], h * last[2])
    _join(s.free, j, old[3], h * begin[3], state[3], h * last[3])
    _join(s.free, k, old[4], h * begin[4], state[4], h * last[4])
    for m in range(j, PAIR, LANES):
        end, rate = (state[0], last[0]) if m == j else (state[1], last[1])
        (left, left_slope), (right, right_slope) = (
            face_force(s, m, s.x[0, m]),
            face_force(s, m, end),
        )
        _join(s.force, m, left, left_slope * s.x[1, m], right, right_slope * h * rate)


# --- Steps along the slow motion: once the fast oscillation has died out, nothing of it needs to be
# resolved. For small mu the difference z = x_1 - x_2 of the approaches swings with the frequency
# sqrt(3 sqrt(x)/mu) and dies out at the rate 0.75 sqrt(x).  What is left follows the waves: with m
# = (x_1 + x_2)/2 and D = q(x_1) - q(x_2), theory (9) reads
#
# m' = f - h - (q(x_1) + q(x_2))/2        u = f + h - D/2 - z'/2        D = mu u'
#
# Starting from z = 0, the second and the third equation give u, D and z in turn, each round a
# factor of about mu smaller, all as power series over the step; the first one is integrated term by
# term.  The series is used where it satisfies the equations of motion to the tolerance and where it
# meets the state of the row. Faces that have yielded are springs of different stiffness k_1, k_2
# above their dents: equal forces then mean z = tilt m, from which the rounds start.

#: mass number below which the slow motion is looked for
SMALL_MU = 0.02
#: most rounds of the iteration; each spoils the last two terms of the series
_ROUNDS = 5
#: terms that stay good after the rounds
_GOOD = 10
#: columns of s.slow (TERMS, SLOW_ROOM): m, z, u, x_1, x_2, sqrt(x_1), sqrt(x_2), q_1, q_2, the
#: change of z
_M, _Z, _U, _X, _Y, _Q, _CHANGE = 0, 1, 2, 3, 5, 7, 9


@compiled
def _slow_mean(s, j, tilt):
    """Integrate m for a given z; False where a face is not pressed."""
    apart()
    d, push, h = s.slow, s.push, s.h[j]
    for k in range(TERMS):
        if tilt != 0.0:
            d[k, _Z] = tilt * d[k, _M]
        for face in range(2):
            x, y, q = _X + face, _Y + face, _Q + face
            d[k, x] = d[k, _M] + (0.5 - face) * d[k, _Z]
            if k == 0:
                if not d[0, x] > 0.0:
                    return False
                d[0, y] = math.sqrt(d[0, x])
            else:
                total = 0.0
                for i in range(1, k):
                    total += d[i, y] * d[k - i, y]
                d[k, y] = 0.5 * (d[k, x] - total) / d[0, y]
            total = 0.0
            for i in range(k + 1):
                total += d[i, x] * d[k - i, y]
            d[k, q] = s.spring[face * LANES + j] * total
        if k < TERMS - 1:
            rate = 0.5 * (push[k, j] + push[k, LANES + j] - d[k, _Q] - d[k, _Q + 1])
            d[k + 1, _M] = h * rate / (k + 1.0)
    return True


@compiled
def _correct(s, j):
    """One round: u from the waves, D from u, z from D.  Returns the largest change of z in the
    step, of its terms.
    """
    apart()
    d, push, h, mu = s.slow, s.push, s.h[j], s.mass[j]
    stiff_1, stiff_2 = s.spring[j], s.spring[LANES + j]
    for k in range(TERMS):
        swing = (k + 1.0) * d[k + 1, _Z] / h if k + 1 < TERMS else 0.0
        d[k, _U] = 0.5 * (push[k, j] - push[k, LANES + j] - (d[k, _Q] - d[k, _Q + 1]) - swing)
    lead, change = stiff_1 * d[0, _Y] + stiff_2 * d[0, _Y + 1], 0.0
    for k in range(TERMS):
        wanted = mu * (k + 1.0) * d[k + 1, _U] / h if k + 1 < TERMS else 0.0
        total = (wanted - (d[k, _Q] - d[k, _Q + 1])) / 0.75
        for i in range(1, k + 1):
            total -= (stiff_1 * d[i, _Y] + stiff_2 * d[i, _Y + 1]) * d[k - i, _CHANGE]
        d[k, _CHANGE] = total / lead
        d[k, _Z] += d[k, _CHANGE]
        if k <= _GOOD:
            change += abs(d[k, _CHANGE])
    return change


@compiled
def _residual(s, j, theta):
    """Largest error with which the series satisfies the equations at theta, as an error of an
    approach.
    """
    apart()
    (a, rate_a), (b, rate_b) = both_of(s.slow, _X, theta), both_of(s.slow, _X + 1, theta)
    w, rate_w = both_of(s.slow, _U, theta)
    if not (a > 0.0 and b > 0.0):
        return math.inf
    h, push_a, push_b = s.h[j], value_of(s.push, j, theta), value_of(s.push, LANES + j, theta)
    force_a, force_b = s.spring[j] * (a * math.sqrt(a)), s.spring[LANES + j] * (b * math.sqrt(b))
    first = abs(rate_a / h - (push_a - force_a - w)) * theta * h
    second = abs(rate_b / h - (push_b - force_b + w)) * theta * h
    third = abs(s.mass[j] * rate_w / h - (force_a - force_b)) / (1.5 * s.spring[j] * math.sqrt(a))
    return max(first, max(second, third))


@compiled
def decay_time(s, j):
    """Time that the oscillation which a jump sets off, about mu^0.45, needs at least to fall to the
    tolerance.
    """
    apart()
    return max(0.0, math.log(s.mass[j] ** 0.45 / s.error[j]))


@compiled
def _slow_step(s, j):
    """Try to replace the step of one lane by one of the slow motion: theta it may reach, 0 if none;
    amplitude.

    The amplitude is that of the fast oscillation that the state of the row has about the slow
    motion, as an approach; it must lie below the tolerance.
    """
    apart()
    d, k = s.slow, LANES + j
    mean, swing, speed = 0.5 * (s.x[0, j] + s.x[0, k]), s.x[0, j] - s.x[0, k], s.u[0, j]
    for i in range(TERMS):
        d[i, _Z] = 0.0
    d[0, _M] = mean
    allowed, tilt = s.error[j] * s.size[0, j], 0.0
    if s.spring[j] != s.spring[k]:
        ratio = (s.spring[k] / s.spring[j]) ** (2.0 / 3.0)
        tilt = 2.0 * (ratio - 1.0) / (ratio + 1.0)
    for _ in range(_ROUNDS):
        if not _slow_mean(s, j, tilt):
            return 0.0, math.inf
        tilt, change = 0.0, _correct(s, j)
        if not change < mean:
            return 0.0, math.inf
        if change < 0.01 * allowed:
            break
    if not _slow_mean(s, j, 0.0):
        return 0.0, math.inf
    fast = math.sqrt(s.mass[j] / (3.0 * s.spring[j] * d[0, _Y]))
    amplitude = max(abs(swing - d[0, _Z]), 2.0 * abs(speed - d[0, _U]) * fast)
    if not amplitude <= (2.0 if s.on_slow[j] > 0.0 else 0.5) * allowed:
        return 0.0, amplitude
    theta = 1.0
    for _ in range(12):
        if max(_residual(s, j, theta), _residual(s, j, 0.6 * theta)) <= allowed:
            break
        theta *= 0.6
    else:
        return 0.0, amplitude
    for i in range(TERMS):
        s.x[i, j], s.x[i, k], s.u[i, j] = d[i, _X], d[i, _X + 1], d[i, _U]
        s.root[i, j], s.root[i, k] = d[i, _Y], d[i, _Y + 1]
        s.force[i, j], s.force[i, k] = d[i, _Q], d[i, _Q + 1]
    return theta, amplitude


@compiled
def follow_slow(s, j):
    """A step of the slow motion where the row is on it; else when to look for it again."""
    apart()
    slow, swing = 0.0, math.inf
    # on the slow motion the forces differ by mu u', and u' is of the order of one
    if abs(s.force[0, j] - s.force[0, LANES + j]) < 10.0 * s.mass[j]:
        slow, swing = _slow_step(s, j)
    s.on_slow[j] = 1.0 if slow > 0.0 else 0.0
    if slow > 0.0:
        s.theta[j] = slow
    elif swing < math.inf:
        # the oscillation needs this long to die out
        rate_of_decay = 0.75 * math.sqrt(max(s.x[0, j], s.x[0, LANES + j]))
        dying = 0.9 * math.log(swing / (s.error[j] * s.size[0, j])) / rate_of_decay
        s.calm[j] = s.time[j] + max(4.0 * s.h[j], dying)
    else:
        s.calm[j] = s.time[j] + 8.0 * s.h[j]

"""What all lanes do together, in plain loops over columns: series, step lengths, nodes, echoes.

The motion between two jumps of the waves is analytic as long as a pressed face stays pressed, so
its Taylor series about the start of a step follows from recurrences for products and square roots
(R. Barrio, Appl. Math. Comput. 163, 2005, 525; A. Jorba, M. Zou, Experimental Mathematics 14, 2005,
99).  With theta = 0 ... 1 over the length h of the step, theory (9) and (R3) read

    (k+1) x[k+1] = h (push[k] + free[k] - gives force[k] -+ u[k])     push: 2 f at A, -2 h at B
    (k+1) u[k+1] = h/mu (force_A[k] - force_B[k])                     free: U_A, -U_B
    2 y[0] y[k]  = x[k] - sum of y[j] y[k-j], 0 < j < k               y = sqrt(x)
    force[k]     = sum of x[j] y[k-j], 0 <= j <= k                    force = x^(3/2)

and on virgin loading (`faces`) with l = ln(y + base): k y[k] = sum of j l[j] y[k-j] + base k l[k].

LLVM turns a loop over columns into vector instructions where it can see that nothing overlaps (all
fields belong to one record), where every inner loop has a length known when compiling (one function
for each power), and where 32 columns are enough not to be unrolled before.  Columns are the faces A
of all lanes, then their faces B; what belongs to a lane stands in both of its columns.  Every
column goes through the same instructions: the bits of a row do not depend on its lane.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial, chebyshev

from .compiled import compiled
from .tracked import LANES, LINEAR, MASSLESS, ORDER, PAIR, POINTS, TERMS, WANT_DURATION, WAVE

#: share of the radius of convergence that a step may use: 0.85^16 is 0.07 (docs/theory.md, section
#: 5)
_CIRCLE = 0.85
#: times a step is shortened at most because the series of its root has parted from the root: the
#: series stays as it is, while a step that is tried again (`kernel._holds`) costs one of its own
_SHORTER = 3
#: integrals of the powers of theta from 0 to 1
OF_POWERS = 1.0 / np.arange(1.0, TERMS + 1.0)


@compiled
def _roots(s, k):
    """The k-th coefficients of roots and forces from the sums over the lower ones."""
    if k == 0:
        for c in range(PAIR):
            x = s.x[0, c]
            above = x + s.shift[c]
            root = math.sqrt(max(above, 0.0))
            s.root[0, c] = root
            s.first_root[c] = root
            s.half[c] = 0.5 / root if above > 0.0 else 0.0
            beside = x if s.spring[c] > 0.0 else 0.0
            s.first_beside[c] = beside
            s.beside[0, c] = beside
            s.force[0, c] = (
                s.hertz[c] * (x * root) + s.by_x[c] * x + s.by_root[c] * root + s.start[c]
            )
    elif not s.has_laws and s.mode != LINEAR:
        for c in range(PAIR):
            x = s.x[k, c]
            root = (x - s.squares[c]) * s.half[c]
            s.root[k, c] = root
            s.beside[k, c] = x
            s.force[k, c] = s.products[c] + s.first_beside[c] * root + x * s.first_root[c]
    else:
        part = 1.0 / k
        for c in range(PAIR):
            x = s.x[k, c]
            root = (x - s.squares[c]) * s.half[c]
            products = s.products[c] + s.first_beside[c] * root
            log = (k * root - products) * s.inverse[c]
            s.root[k, c] = root
            s.beside[k, c] = x if s.spring[c] > 0.0 else log
            s.force[k, c] = (
                s.hertz[c] * (products + x * s.first_root[c])
                + s.by_x[c] * x
                + s.by_root[c] * root
                + s.by_log[c] * (part * log)
            )


@compiled
def _next_terms(s, k, lanes):
    """The coefficients k + 1 of the motion, (9) or (R3)."""
    part = 1.0 / (k + 1.0)
    if s.rigged:
        for c in range(PAIR):
            h = s.h[c] * part
            force = s.force[k, c]
            rate = s.push[k, c] + s.free[k, c] - s.gives[c] * force - s.side_sign[c] * s.u[k, c]
            s.x[k + 1, c] = h * s.there[c] * rate
            s.free[k + 1, c] = -h * s.lightness[c] * force
    else:
        for c in range(PAIR):
            rate = s.push[k, c] - s.force[k, c] - s.side_sign[c] * s.u[k, c]
            s.x[k + 1, c] = s.h[c] * part * rate
    if s.mode == MASSLESS:  # both faces move alike, and u stays 0
        for j in range(lanes):
            rate = 0.5 * (s.push[k, j] + s.push[k, LANES + j]) - s.force[k, j]
            x = s.h[j] * part * rate
            s.x[k + 1, j] = x
            s.x[k + 1, LANES + j] = x
    for j in range(lanes):  # a constant would be unrolled
        u = s.h[j] * part * s.inverse_mu[j] * (s.force[k, j] - s.force[k, LANES + j])
        s.u[k + 1, j] = u
        s.u[k + 1, LANES + j] = u


def _sums(low, high):
    """A function for the sums over products of lower coefficients that the k-th ones need, low <= k
    < high: one for each power, found by halving.
    """
    if high - low > 1:
        middle = (low + high) // 2
        lower = _sums(low, middle)
        upper = _sums(middle, high)

        @compiled
        def choose(s, k):
            if k < middle:
                lower(s, k)
            else:
                upper(s, k)

        return choose

    @compiled
    def sums(s, k):
        for c in range(PAIR):
            squares = 0.0
            products = 0.0
            for i in range(1, low):
                root = s.root[low - i, c]
                squares += s.root[i, c] * root
                products += s.beside[i, c] * root
            s.squares[c] = squares
            s.products[c] = products

    return sums


#: for every power
_all_sums = _sums(0, TERMS)


@compiled
def expand(s, lanes):
    """The series of x, u, free, root and force from their first terms."""
    for k in range(TERMS):
        _all_sums(s, k)
        _roots(s, k)
        if k < ORDER:
            _next_terms(s, k, lanes)


@compiled
def reach(s):
    """theta up to which the last two terms of every series stay below the error allowed, times its
    scale.

    Where a face nearly leaves, x = 0 lies close to the real axis: the last terms may still be small
    beyond the circle in which the series holds, and its radius follows from how they grow over four
    powers.
    """
    for j in range(LANES):
        error = s.error[j]
        before = abs(s.u[ORDER - 1, j]) / s.u_size[j]
        last = abs(s.u[ORDER, j]) / s.u_size[j]
        circle = math.inf
        for face in range(2):
            c = face * LANES + j
            early = max(abs(s.x[ORDER - 5, c]), abs(s.x[ORDER - 4, c]))
            x_before = abs(s.x[ORDER - 1, c])
            x_last = abs(s.x[ORDER, c])
            late = max(x_before, x_last)
            holds = _CIRCLE * math.sqrt(math.sqrt(early / (late + 1e-300)))
            circle = min(circle, holds) if late > 1e-3 * error * s.size[c] else circle
            free = s.free_size[c]
            before = max(before, max(x_before / s.size[c], abs(s.free[ORDER - 1, c]) / free))
            last = max(last, max(x_last / s.size[c], abs(s.free[ORDER, c]) / free))
        # theta^15 before + theta^16 last = error, by one step of a fixed-point iteration
        t = math.sqrt(math.sqrt(math.sqrt(math.sqrt(error / (before + last + 1e-300)))))
        t = min(t, 8.0)
        t_4 = t * t * (t * t)
        t_15 = t_4 * t_4 * t_4 * (t * t * t)
        sum_15 = t_15 * (before + t * last)
        t *= math.sqrt(math.sqrt(math.sqrt(math.sqrt(error / (sum_15 + 1e-300)))))
        t = min(t, circle)
        # a series that has overflowed says nothing, except that the step was far too long
        s.theta[j] = t if before + last < 1e200 else 0.0


@compiled
def _root_ends(s):
    """s.wrong: by how much the force of the series of sqrt(x) differs at the step's end from that
    of x.

    Past a point where a face nearly leaves, x has two complex roots so close to the real axis that
    the series walks between them and goes on, smoothly, with -sqrt(x).
    """
    for c in range(PAIR):
        z = s.theta[c]
        x = s.x[ORDER, c]
        root = s.root[ORDER, c]
        for k in range(1, TERMS):
            x = x * z + s.x[ORDER - k, c]
            root = root * z + s.root[ORDER - k, c]
        wrong = x * abs(root - math.sqrt(max(x + s.shift[c], 0.0))) * s.stiffness[c]
        s.wrong[c] = wrong if min(x, s.x[0, c]) > 0.0 else 0.0


@compiled
def shorten_to_roots(s):
    """Shorten the steps at whose ends the root's series has parted from the root.

    s.excess: the impulse of that difference over the whole step, over what is allowed.
    """
    for attempt in range(_SHORTER + 1):
        _root_ends(s)
        shorter = False
        for j in range(LANES):
            wrong = max(s.wrong[j], s.wrong[LANES + j])
            s.excess[j] = s.h[j] * s.theta[j] * wrong / s.wrong_allowed[j]
            if attempt < _SHORTER and s.excess[j] > 1.0 and s.lane[j].number >= 0:
                # if what grows is its last term
                theta = s.theta[j] * max(0.5, 0.95 * s.excess[j] ** (-1.0 / ORDER))
                s.theta[j] = s.theta[LANES + j] = theta
                shorter = True
        if not shorter:
            break


@compiled
def survey(s):
    """Approaches and rates at the nodes of every step, and their bounds between them; speeds at its
    end and impulses of the forces over it.  An event that ends it sooner replaces them.
    """
    for c in range(PAIR):
        s.at[0, c] = s.x[0, c]
        s.rate[0, c] = s.x[1, c]
    for i in range(1, POINTS + 1):
        for c in range(PAIR):
            z = i / POINTS * s.theta[c]
            x = s.x[ORDER, c]
            rate = 0.0
            for k in range(1, TERMS):
                rate = rate * z + x
                x = x * z + s.x[ORDER - k, c]
            s.at[i, c] = x
            s.rate[i, c] = rate
    for c in range(PAIR):
        u = 0.0
        for k in range(TERMS):
            u = u * s.theta[c] + s.u[ORDER - k, c]
        s.u_at_end[c] = u
    if s.wanted & WANT_DURATION:
        for c in range(PAIR):
            impulse = 0.0
            for k in range(TERMS):
                impulse = impulse * s.theta[c] + s.force[ORDER - k, c] * OF_POWERS[ORDER - k]
            s.step_impulse[c] = impulse * s.theta[c]
    for c in range(PAIR):
        width = s.theta[c] / POINTS
        top = s.at[0, c]
        floor = s.at[0, c]
        for i in range(1, POINTS + 1):
            left = s.at[i - 1, c]
            right = s.at[i, c]
            a = width * s.rate[i - 1, c]
            b = width * s.rate[i, c]
            # where the tangents meet, and a fifth for bends
            bow = 1.2 * a * b / (b - a) if a * b < 0.0 else 0.0
            top = max(top, max(left, right) + max(bow, 0.0))
            floor = min(floor, min(left, right) + min(bow, 0.0))
        s.top[c] = top
        s.floor[c] = floor


# --- waves that come back

#: points over a step at which a wave that comes back is read
WAVE_THETAS = 0.5 - 0.5 * np.cos(np.pi * (np.arange(WAVE) + 0.5) / WAVE)
#: weights (degree, point) that turn the values there into Chebyshev coefficients, and (power,
#: degree) that turn those into powers of theta
_TO_DEGREES = np.linalg.inv(chebyshev.chebvander(2.0 * WAVE_THETAS - 1.0, WAVE - 1))
_TO_POWERS = np.zeros((WAVE, WAVE))
for _k in range(WAVE):
    _TO_POWERS[: _k + 1, _k] = (
        Chebyshev.basis(_k, domain=[0.0, 1.0]).convert(kind=Polynomial, domain=[-1.0, 1.0]).coef
    )
_TO_DEGREES = np.ascontiguousarray(_TO_DEGREES)
#: Chebyshev terms that stay in any case
_LEAST = 4


def _fit_echoes(first):
    """A function for the faces whose columns begin at `first`, that adds the waves read at
    Chebyshev points, s.echo times s.returns, to what runs towards them.

    Terms that together stay below s.negligible are joints between steps: as powers of theta they
    would be large.
    """
    behind = first + LANES

    @compiled
    def fit_echoes(s):
        for degree in range(WAVE):
            for c in range(first, behind):
                total = 0.0
                for i in range(WAVE):
                    total += _TO_DEGREES[degree, i] * s.echo[i, c]
                s.degrees[degree, c] = total * s.returns[c]
        for c in range(first, behind):
            s.misfit[c] = abs(s.degrees[WAVE - 1, c]) + abs(s.degrees[WAVE - 2, c])
            dropped = 0.0
            for back in range(WAVE - _LEAST):
                term = s.degrees[WAVE - 1 - back, c]
                dropped += abs(term)
                s.degrees[WAVE - 1 - back, c] = term if dropped > s.negligible[c] else 0.0
        for k in range(WAVE):
            for c in range(first, behind):
                total = s.push[k, c]
                for degree in range(WAVE):
                    total += _TO_POWERS[k, degree] * s.degrees[degree, c]
                s.push[k, c] = total

    return fit_echoes


fit_echoes_at_a = _fit_echoes(0)
fit_echoes_at_b = _fit_echoes(LANES)

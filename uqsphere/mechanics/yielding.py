"""Plastic contact: one family of laws from Hertz through metal plasticity and Thornton's law to a
crushed cap.

A contact is elastic up to the onset, the approach alpha_y at which the peak Hertz pressure is
`onset` (p_y).  Beyond it the force departs smoothly from Hertz and its slope tends to pi r_eff C H,
with the hardness H and the pile-up factor C (a² -> C r_eff alpha).  Unloading follows Hertz with
another curvature, from the largest approach down to the residual indentation.

Every function is elementwise on arrays in SI or in scaled numbers of the contact: z =
alpha/alpha_y, L = P/P_y, A = a²/(r_eff alpha_y).  Numbering (C...) of docs/theory.md.  With s =
sqrt(z) - 1 the force is written as

    L = 1 + 3 s + 3 s² + 3 b² (b - 1) G(s/b),      G(t) = t²/2 - t + ln(1 + t) = t³/3 - t⁴/4 + ...

which is (C5) without its cancellation: (1 + s)³, Hertz, as b grows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Places, Values, frozen, quiet

from . import contact
from .roots import newton

#: terms of the series of G and of its integrals below `_NEAR`, where the closed forms cancel; the
#: rest is 0.1^16/18 of the first term
_TERMS = 18
_NEAR = 0.1
#: hardness over yield strength of a metal (Jackson and Green 2005)
FLOW = 2.84
#: pile-up factor of a perfectly plastic body (Jackson and Green 2005), and of a flat cap: a² = 2 r
#: alpha
METAL_PILE_UP = 8.0 / 3.0
CAP_PILE_UP = 2.0


#: formula of numbers or of arrays
Formula = Callable[..., Any]


def metal_onset(yield_strength: Array | float, nu: Array | float) -> Array:
    """Onset pressure p_y [Pa] of a metal under a sphere: 1.295 exp(0.736 nu) Y.

    Source: Jackson and Green, J. Tribol. 127 (2005) 343, von Mises along the axis; 1.61 Y at nu =
    0.3.

    >>> round(float(metal_onset(1.0, 0.3)), 3)
    1.615
    """
    return 1.295 * np.exp(0.736 * nu) * yield_strength


class ContactParameters(NamedTuple):
    """Contact parameters of a body, (n,): onset p_y [Pa] (inf: elastic), hardness [Pa], pile-up."""

    onset: Array
    hardness: Array
    pile_up: Array

    def with_finite_onset(self, modulus: Array) -> ContactParameters:
        """The parameters with an onset out of reach in rows that are elastic, far above E* [Pa]."""
        onset, hardness, pile_up = self
        elastic = np.isinf(onset)
        never = 1e3 * modulus
        return ContactParameters(
            np.where(elastic, never, onset),
            np.where(elastic, never, hardness),
            np.where(elastic, 1.0, pile_up),
        )


def metal_body(yield_strength: Array, nu: Array) -> ContactParameters:
    """A metal by its yield strength [Pa] and Poisson ratio; elastic where the strength is NaN."""
    onset = metal_onset(yield_strength, nu)
    return ContactParameters(
        np.where(np.isfinite(onset), onset, np.inf),
        FLOW * yield_strength,
        np.full(np.shape(onset), METAL_PILE_UP),
    )


def softer(one: ContactParameters, other: ContactParameters) -> ContactParameters:
    """The parameters of the body with the lower onset, row by row."""
    first = one.onset <= other.onset
    pairs = zip(one, other, strict=True)
    return ContactParameters._make(np.where(first, a, b) for a, b in pairs)


def first_loading(select: Formula, compiled: Formula) -> tuple[Formula, ...]:
    """The formulas (C4) to (C7), stated once for arrays and for the compiled integrator: force,
    slope, area, its g, and work, functions of z = alpha/alpha_y, b and C.

    select: function of (condition, a, b) that returns a where the condition holds, else b:
    `np.where` for arrays.  compiled: decorator of every formula.
    """

    @compiled
    def bend(t: Values, moment: int) -> Values:
        """G(t) = t²/2 - t + ln(1 + t) for moment 0; its integral from 0 for 1, of t G for 2."""
        near = np.minimum(t, _NEAR)
        series = 0.0 * near
        for k in range(_TERMS, 2, -1):
            term = 1.0 / k
            if moment > 0:
                term = 1.0 / (k * (k + moment))
            series = term - near * series
        series = series * near ** (3 + moment)
        log = np.log1p(t)
        if moment == 0:
            far = 0.5 * t * t - t + log
        elif moment == 1:
            far = t**3 / 6.0 - 0.5 * t * t + (1.0 + t) * log - t
        else:
            far = t**4 / 8.0 - t**3 / 3.0 + 0.5 * (t * t - 1.0) * log - 0.25 * t * t + 0.5 * t
        return select(t < _NEAR, series, far)

    @compiled
    def force(z: Values, b: Values) -> Values:
        """L = P/P_y, (C5); Hertz below onset."""
        s = np.sqrt(np.maximum(z, 1.0)) - 1.0
        rest = select(b > 0.0, b * b * (b - 1.0) * bend(s / b, 0), -0.5 * s * s)
        beyond = 1.0 + 3.0 * s + 3.0 * s * s + 3.0 * rest
        elastic = np.maximum(z, 0.0)
        return select(z > 1.0, beyond, elastic * np.sqrt(elastic))

    @compiled
    def slope(z: Values, b: Values) -> Values:
        """dL/dz, (C4)."""
        y = np.sqrt(np.maximum(z, 1.0))
        beyond = select(b > 0.0, 1.5 * ((1.0 + b) * y - 1.0) / (y + b - 1.0), 1.5)
        return select(z > 1.0, beyond, 1.5 * np.sqrt(np.maximum(z, 0.0)))

    @compiled
    def area_shape(b: Values, c: Values) -> Values:
        """g of (C6)."""
        return select(c > 1.0, np.minimum(5.0, c * b * b / ((c - 1.0) * (1.0 + b))), 5.0)

    @compiled
    def area(z: Values, b: Values, c: Values) -> Values:
        """A = a²/(r_eff alpha_y), (C6)."""
        s = np.sqrt(np.maximum(z, 1.0)) - 1.0
        g = area_shape(b, c)
        rest = s * s * (1.0 + (c - 1.0) / g) + 2.0 * (c - 1.0) * g * (g - 1.0) * bend(s / g, 0)
        beyond = select(g > 0.0, 1.0 + 2.0 * s + rest, 1.0 + c * s * (2.0 + s))
        return select(z > 1.0, beyond, np.maximum(z, 0.0))

    @compiled
    def work(z: Values, b: Values) -> Values:
        """W = the integral of L from 0 to z, (C7), in P_y alpha_y."""
        s = np.sqrt(np.maximum(z, 1.0)) - 1.0
        t = s / b
        softening = b**3 * (b - 1.0) * (bend(t, 1) + b * bend(t, 2))
        rest = select(b > 0.0, softening, -(s**3) / 6.0 - s**4 / 8.0)
        beyond = 0.4 + 2.0 * s + 4.0 * s**2 + 4.0 * s**3 + 1.5 * s**4 + 6.0 * rest
        return select(z > 1.0, beyond, 0.4 * np.maximum(z, 0.0) ** 2.5)

    return force, slope, area, area_shape, work


_force, _slope, _area, _, _work = first_loading(np.where, quiet)


class Press(NamedTuple):
    """State of a contact at its largest approach, (n,) each in SI; named as columns of answers are.

    alpha_max, P_max, a_max: approach, force and radius there.  p_mean, p_max: mean pressure, and
    that of the centre.  p_hertz: peak pressure of an elastic contact at the same force.  dent_left:
    residual indentation.  stored: elastic energy.  dissipated: plastic work.
    """

    alpha_max: Array
    P_max: Array
    a_max: Array
    p_mean: Array
    p_max: Array
    p_hertz: Array
    dent_left: Array
    stored: Array
    dissipated: Array


@frozen
class Face:
    """Contact law of n rows: onset p_y, hardness H >= p_y [Pa], pile-up C (1 to 3), E*, r_eff [m].

    Source: docs/theory.md (C2) to (C13); b = 0 and C = 1 is Thornton, J. Appl. Mech. 64 (1997) 383,
    with p_y = H.
    """

    onset: Array
    hardness: Array
    pile_up: Array
    modulus: Array
    effective_radius: Array

    def at(self, rows: int | Places) -> Face:
        """The law of some rows."""
        picked = np.atleast_1d(rows)
        return Face(**{name: column[picked] for name, column in vars(self).items()})

    @property
    def softening(self) -> Array:
        """b of (C3): 0 for Thornton, infinite for Hertz."""
        return self.pile_up * self.hardness / self.onset - 1.0

    @property
    @quiet
    def valid(self) -> Values:
        """Rows with valid parameters: b = 0, or 0.2 <= b <= 100.

        Between 0 and 0.2 the law has a singularity near onset; above 100 it is Hertz's to rounding.
        """
        b = self.softening
        ordered = (self.pile_up >= 1.0) & (self.onset > 0.0) & (self.hardness >= self.onset)
        return ordered & ((np.abs(b) < 1e-12) | ((b >= 0.2) & (b <= 100.0)))

    @property
    def onset_approach(self) -> Array:
        """alpha_y [m], (C2)."""
        ratio: Array = np.square(0.5 * math.pi * self.onset / self.modulus)
        return self.effective_radius * ratio

    @property
    def onset_force(self) -> Array:
        """P_y [N], (C2)."""
        return (2.0 / 3.0) * math.pi * self.onset * self.effective_radius * self.onset_approach

    def force(self, depth: Array) -> Values:
        """L = P/P_y at z on first loading, (C5); Hertz below onset."""
        return _force(depth, self.softening)

    def slope(self, depth: Array) -> Values:
        """dL/dz on first loading, (C4)."""
        return _slope(depth, self.softening)

    def area(self, depth: Array) -> Values:
        """A = a²/(r_eff alpha_y) at z on first loading, (C6)."""
        return _area(depth, self.softening, self.pile_up)

    def work(self, depth: Array) -> Values:
        """W = the integral of L from 0 to z, (C7), in P_y alpha_y."""
        return _work(depth, self.softening)

    def depth_at(self, force: Array) -> Array:
        """z at which first loading reaches the force P [N]."""
        ratio = np.maximum(force, 0.0) / self.onset_force
        beyond = np.maximum(ratio, 1.0)
        # b = 0 is the softest law, with the largest depth; L is convex
        start = 1.0 + (beyond - 1.0) / 1.5
        depth = newton(lambda z: (self.force(z) - beyond) / self.slope(z), start, 1.0)
        return np.where(ratio > 1.0, depth, np.cbrt(np.square(ratio)))

    def depth_of_energy(self, energy: Array) -> Array:
        """z at which first loading has taken an energy [J], W(z) P_y alpha_y, (R23)."""
        work = energy / (self.onset_force * self.onset_approach)
        # b = 0 goes deepest, W = 0.4 + (z - 1) + 0.75 (z - 1)²; W is convex, so that Newton's
        # method converges from above
        beyond = np.maximum(work, 0.4)
        start = 1.0 + (np.sqrt(1.0 + 3.0 * (beyond - 0.4)) - 1.0) / 1.5
        depth = newton(lambda z: (self.work(z) - beyond) / self.force(z), start, 1.0)
        return np.where(work > 0.4, depth, (work / 0.4) ** 0.4)

    @quiet
    def recovery(self, depth: Array) -> Array:
        """alpha_e/alpha_y: the approach recovered by unloading from z, (C8)."""
        beyond = self.force(depth) / np.sqrt(self.area(depth))
        return np.where(depth > 1.0, beyond, np.maximum(depth, 0.0))

    @quiet
    def pressed(self, depth: Array) -> Press:
        """The state of the contact at the largest approach z alpha_y."""
        ratio = self.force(depth)
        area = self.area(depth)
        recovered = self.recovery(depth)
        alpha_y = self.onset_approach
        force_y = self.onset_force
        force = ratio * force_y
        p_y = self.onset
        hardness = self.hardness
        mean = np.where(depth > 0.0, (2.0 / 3.0) * p_y * ratio / area, 0.0)
        beyond = hardness - (hardness - mean) * (hardness - p_y) / (hardness - (2.0 / 3.0) * p_y)
        stored = 0.4 * ratio * recovered
        return Press(
            alpha_max=depth * alpha_y,
            P_max=force,
            a_max=np.sqrt(area * self.effective_radius * alpha_y),
            p_mean=mean,
            p_max=np.where(depth > 1.0, beyond, p_y * np.sqrt(np.maximum(depth, 0.0))),
            p_hertz=contact.pressure_at_force(force, self.modulus, self.effective_radius),
            dent_left=np.where(depth > 1.0, (depth - recovered) * alpha_y, 0.0),
            stored=stored * force_y * alpha_y,
            dissipated=np.where(depth > 1.0, (self.work(depth) - stored) * force_y * alpha_y, 0.0),
        )

"""Closed forms: massless sphere in infinite bars, linear contact, impact with one contact, slow
loading.

Between bars all functions are elementwise in the scaled variables of theory (8): approach x over
alpha_c, time s over t_c.  A normal impact of a sphere of mass M at speed v on a half-space, a free
mass, a thin plate or a bar end is in SI.  With P = beta alpha^1.5 every result is a power of the
inputs (Hertz 1882; Johnson, Contact Mechanics, 1985, 11.4), except for the waves in a plate or bar:
a counter-body that moves at P/Z has one similarity number, lam = beta^0.4 M^0.6 v^0.2/Z (Zener,
Phys. Rev. 59 (1941) 669), and its results are tabulated.  A contact that yields follows from the
energy balance.  Equation numbers (R...) refer to docs/theory.md.
"""

import math
from collections.abc import Callable, Collection
from functools import cache
from pathlib import Path

import numpy as np
from numpy.polynomial.chebyshev import chebval
from numpy.polynomial.polynomial import polyval

from uqsphere.arrays import Array, ColumnMap, Flags, Pair, Values, quiet

from . import contact
from .integrator.tracked import TAIL_SHARE
from .outputs import SceneAnswers, answers_from, merged_answers
from .rigs import LARGEST_LAM
from .roots import newton
from .scene import Partner, Scene
from .yielding import Face

#: approach and time below which the logarithms of (11) cancel and its series in x^(3/2) is the
#: better way, and its terms: the next one is 0.1^(1.5 13)/20.5, below the rounding of a double
_SERIES_BELOW = 0.1
_SERIES_TERMS = 12


def _series(x: Array) -> Values:
    """s(x) = sum over k of x^(1 + 3k/2)/(1 + 3k/2), the geometric series of 1/(1 - x^(3/2))
    integrated.
    """
    coefficients = 1.0 / (1.0 + 1.5 * np.arange(_SERIES_TERMS + 1))
    return x * polyval(x * np.sqrt(x), coefficients)


def _time_at_root(root: Array, minus_log: Array) -> Array:
    """s of theory (11) from y = sqrt(x) and -ln(1 - y).

    The difference of the two angles of (11) is taken as one, atan(sqrt(3) y/(2 + y)): nothing
    cancels.
    """
    angle = np.arctan(math.sqrt(3.0) * root / (2.0 + root))
    return (2.0 / 3.0) * (minus_log + 0.5 * np.log1p(root + root * root) - math.sqrt(3.0) * angle)


@quiet
def loading_time(x: Values) -> Array:
    """Scaled time s at which the massless sphere has the approach x, 0 <= x <= 1, theory (11).

    s(x) = (2/3) [-ln(1-y) + ln(1+y+y²)/2 - sqrt(3) (atan((2y+1)/sqrt(3)) - pi/6)], y = sqrt(x); the
    time to x = 1 is infinite.
    Source: W. K. Nowacki, Engng. Trans. 42(3), 1994, (3.3), integrated by partial fractions.

    >>> float(loading_time(0.5).round(12))
    0.591935816248
    """
    x = np.asarray(x, float)
    root = np.sqrt(x)
    closed = _time_at_root(root, -np.log1p(-root))
    return np.where(x < _SERIES_BELOW, _series(np.minimum(x, _SERIES_BELOW)), closed)


@cache
def _table() -> Pair:
    """Times and z = -ln(1 - sqrt(x)) of a loading, so close that one round of Newton's iteration
    finishes it.
    """
    z = np.concatenate([np.linspace(0.3, 4.0, 24_000), np.linspace(4.0, 100.0, 8_000)[1:]])
    return _time_at_root(-np.expm1(-z), z), z


def loading_approach(s: Values) -> Array:
    """Scaled approach x of the massless sphere at time s >= 0 of a step; inverse of `loading_time`.

    Newton's method in z = -ln(1 - sqrt(x)), in which s is nearly linear, and Halley's in x for
    small s, with a fixed number of iterations; error below 1e-14.

    >>> loading_approach([0.0, 0.8193410, np.inf]).round(6).tolist()
    [0.0, 0.629961, 1.0]
    """
    s = np.asarray(s, float)
    # beyond s = 60 the approach is 1 to the last bit
    large = np.clip(s, _SERIES_BELOW, 60.0)
    z = np.interp(large, *_table())
    y = -np.expm1(-z)
    z = z - (_time_at_root(y, z) - large) * (1.0 + y + y * y) / (2.0 * y)
    small = np.minimum(s, _SERIES_BELOW)
    x = small - 0.4 * small**2.5
    for _ in range(2):
        excess = _series(x) - small
        root = np.sqrt(x)
        x = x - excess * (1.0 - x * root) / (1.0 - 0.75 * excess * root)
    return np.where(s < _SERIES_BELOW, x, np.square(np.expm1(-z)))


def relaxing_approach(start: Values, after: Values) -> Values:
    """Scaled approach after the pulse: x = [x_*^(-1/2) + after/2]^(-2), theory (12).

    start: x_* at the end of the pulse.  after: time since then over t_c.

    >>> float(relaxing_approach(loading_approach(0.8), 5.2).round(7))
    0.0667757
    """
    return (1.0 / np.sqrt(start) + 0.5 * after) ** -2.0


@quiet
def massless_approach(s: Values, theta: Values) -> Array:
    """Scaled approach of the massless sphere under a rectangular pulse of length theta.

    An infinite theta is a step.

    >>> massless_approach([0.4, 0.8, 6.0], 0.8).round(6).tolist()
    [0.363053, 0.620178, 0.066776]
    """
    s = np.asarray(s, float)
    theta = np.asarray(theta, float)
    loading = loading_approach(np.minimum(s, theta))
    relaxing = relaxing_approach(loading, np.maximum(s - theta, 0.0))
    return np.where(s > theta, relaxing, loading)


def _massless(scene: Scene) -> ColumnMap:
    """A massless sphere between infinite bars, under a rectangular or step pulse.

    Both forces are equal and increase until the pulse ends, theory (11), then decay, theory (12),
    so that the peak is at the end of the pulse or of the evaluation window.  Contact is never lost:
    time_to_first_loss is always censored at the end of the window, the horizon or the time at which
    the force has decayed to 1 % of the peak.
    """
    theta = scene.scales.pulse_number
    horizon = scene.record_end / scene.scales.time
    loaded = np.minimum(theta, horizon)
    peak = loading_approach(loaded)
    # the force falls to its share by (12)
    tail = theta + 2.0 / np.sqrt(peak) * (TAIL_SHARE ** (-1.0 / 3.0) - 1.0)
    ended = np.where(np.isfinite(horizon), horizon, tail)
    # x' = f - q: the impulse is that of the pulse minus the remaining approach, zero at the end of
    # the tail
    after = np.maximum(ended - theta, 0.0)
    remaining = np.where(np.isfinite(horizon), relaxing_approach(peak, after), 0.0)
    return {
        **dict.fromkeys(("x_max", "x_a", "x_b"), peak),
        **dict.fromkeys(("contact", "ended", "parting"), ended),
        "difference": 0.0,
        "contact_censored": 1.0,
        "stored": 2.0 * 0.4 * peak**2.5,
        "mean_force": peak**1.5,
        "duration": (loaded - remaining) / peak**1.5,
        "rise": loading_time(peak * 0.9 ** (2.0 / 3.0)) - loading_time(peak * 0.1 ** (2.0 / 3.0)),
    }


#: columns of the table: restitution, peak force, contact time, rise time
_COLUMNS = ("restitution", "force", "duration", "rise")


@cache
def _impact_table() -> Array:
    """Coefficients of `_COLUMNS` over lam in [0, 3] as Chebyshev series, (k, 4); force and times in
    units of (R13).
    """
    return np.loadtxt(Path(__file__).with_name("impact_table.csv"), delimiter=",", skiprows=1)


def elastic_impact(lam: Values) -> ColumnMap:
    """Restitution, peak force, contact time and rise time at lam, (R10) to (R13); NaN above 3.

    Force in beta^0.4 M*^0.6 v^1.2, times in (M*²/(beta² v))^0.2.  Above 3 a plate is punched.

    >>> round(float(elastic_impact(np.zeros(1))["force"][0]), 4)
    1.1433
    """
    inside = np.where(lam <= LARGEST_LAM, lam, np.nan)
    values = chebval(2.0 * inside / LARGEST_LAM - 1.0, _impact_table())
    return dict(zip(_COLUMNS, values, strict=True))


def _elastic(scene: Scene, ahead: Partner, force: Array) -> ColumnMap:
    """`_COLUMNS` of an impact of unit force `force` on a counter-body.

    Also `radiated`, the integral of q²: the lost energy is radiated, (1 - e²)/2 = lam times it.
    """
    lam: Values = 0.0
    if ahead.kind in ("bar", "plate"):
        lam = force / (scene.scales.speed * ahead.impedance)
    at = elastic_impact(lam)
    return {**at, "radiated": (1.0 - np.square(at["restitution"])) / (2.0 * lam)}


# --- scenes ---------------------------------------------------------------------------------------


#: relative increase of the peak force by the mass M of a sphere under a drop weight m, 0.70
#: (M/m)^0.45, (R16): fitted to the integrator for M/m = 3e-7 to 3e-3
_SWING, _SWING_POWER = 0.70, 0.45
#: rows solved together, so that their columns stay in the processor's cache
_BLOCK_ROWS = 8192


def closed_form_rows(scene: Scene, fidelity: str = "full") -> Flags:
    """Rows that `solve_closed` applies to, (n,).

    A massless sphere between infinite bars under a rectangular or step pulse, or under a drop
    weight; all rows under slow loading; impacts with one contact and no reflected wave during
    contact.
    """
    return _closed_form(scene, fidelity)[1]


@quiet
def _closed_form(scene: Scene, fidelity: str) -> tuple[Callable[[Scene], ColumnMap], Flags]:
    """The closed form of the rig of a scene, and the rows that it applies to, (n,)."""
    every = np.ones(len(scene), bool)
    full, massless = (fidelity == model for model in ("full", "massless"))
    if scene.setup.by_press:
        return _pressed, every & full
    if scene.by_wave:
        plain = scene.shape in ("rectangular", "step") and scene.striker_ratio is None
        infinite = scene.infinite and scene.contact_law == "hertz"
        return _massless, every & (massless and infinite and plain)
    free = scene.horizon is None
    if scene.setup.weight_falls:
        elastic = all(partner.face is None for partner in scene.there)
        return _light, every & (massless and free and elastic and not np.any(scene.reflections))
    behind, ahead = scene.partners
    if behind is not None or not (free and full):
        return _impact, ~every
    if ahead.face is not None:
        # plastic contact and radiated waves together have no closed form
        return _impact, every & (ahead.kind in ("thick", "mass"))
    duration = scene.scales.time * _elastic(scene, ahead, scene.scales.force)["duration"]
    return _impact, ~(duration > scene.echoes[:, 1])


@quiet
def solve_closed(
    scene: Scene, fidelity: str = "full", quantities: Collection[str] | None = None
) -> SceneAnswers:
    """Quantities of interest of n scenes in closed form, as `integrator.solve`.

    Raises ValueError for a scene with a row that is not in `closed_form_rows`.
    """
    closed_form, applies = _closed_form(scene, fidelity)
    if not applies.all():
        raise ValueError(
            "closed forms need fidelity = 'full' with slow loading or an impact on one body, or "
            "'massless' with a drop weight on elastic contacts or a rectangular or step pulse in "
            "infinite bars"
        )
    if len(scene) > _BLOCK_ROWS:
        blocks = np.split(np.arange(len(scene)), range(_BLOCK_ROWS, len(scene), _BLOCK_ROWS))
        return merged_answers(
            *((rows, solve_closed(scene.at(rows), fidelity, quantities)) for rows in blocks)
        )
    closed = closed_form(scene)
    # closed forms have a single force peak, and no grazing contact
    first = closed["x_max"]
    columns = {"status": scene.status, "steps": 0, "grazes": 0.0, "x_first": first, **closed}
    tracked = {name: np.broadcast_to(value, (len(scene),)) for name, value in columns.items()}
    return answers_from(scene, tracked, quantities=quantities)


def _light(scene: Scene) -> ColumnMap:
    """Drop weight on a light sphere: contacts in series, (R15) and (R13), peaks raised by (R16)."""
    scales, (behind, ahead) = scene.scales, scene.there
    softness = behind.hertz_constant ** (-2.0 / 3.0) + ahead.hertz_constant ** (-2.0 / 3.0)
    both = softness**-1.5
    # (R6); m where the anvil is fixed
    moved = behind.mass / (1.0 + behind.mass / ahead.mass)
    force = both**0.4 * moved**0.6 * scales.speed**1.2
    at = _elastic(scene, ahead, force)
    time = contact.approach_at_force(force, both) / (scales.speed * scales.time)
    q = at["force"] * force / scales.force
    slow_a = q ** (2.0 / 3.0)
    slow_b = (q * behind.hertz_constant / ahead.hertz_constant) ** (2.0 / 3.0)
    # the sphere oscillates between the contacts: their peaks are higher, the energies hardly
    raised = (1.0 + _SWING * (scales.mass / moved) ** _SWING_POWER) ** (2.0 / 3.0)
    share = behind.mass / (behind.mass + ahead.mass)
    return {
        **dict.fromkeys(("x_max", "x_a"), raised * slow_a),
        "x_b": raised * slow_b,
        **dict.fromkeys(("other_a", "other_b", "mean_force"), q),
        "difference": 0.0,
        "duration": (1.0 + at["restitution"]) / at["force"] * time,
        "stored": 0.4 * q * (slow_a + slow_b),
        "stored_sphere": 0.4 * q * (behind.share * slow_a + ahead.share * slow_b),
        "rise": at["rise"] * time,
        "end_speed_a": share - (1.0 - share) * at["restitution"],
        "carried_b": at["radiated"] * force**2 * time / scales.force**2,
        **_over(at["duration"] * time),
    }


def _over(time: Array) -> ColumnMap:
    """Times of an impact, which ends by itself at a time over t_c, with a single contact."""
    return {
        **dict.fromkeys(("contact", "parting", "ended"), time),
        **dict.fromkeys(("contact_censored", "touches"), 0.0),
    }


def _impact(scene: Scene) -> ColumnMap:
    """An impact on one body in scaled variables, in the centre-of-mass frame.

    Elastic by (R13); plastic with the depth by (R23) and times by quadrature.
    """
    scales = scene.scales
    ahead = scene.struck
    face = ahead.face
    if face is None:
        at = _elastic(scene, ahead, scales.force)
        restitution = at["restitution"]
        peak = at["force"]
        x = peak ** (2.0 / 3.0)
        rest = {
            "stored": 0.4 * peak * x,
            "rise": at["rise"],
            # momentum: each body leaves with e times its speed in the centre-of-mass frame
            "duration": (1.0 + restitution) / peak,
            "carried_b": at["radiated"],
            **_over(at["duration"]),
        }
    else:
        moved = scales.mass / (1.0 + scales.mass / ahead.mass)
        depth = face.depth_of_energy(0.5 * moved * np.square(scales.speed))
        state = face.pressed(depth)
        restitution = np.sqrt(state.stored / (state.stored + state.dissipated))
        to_scaled = face.onset_approach / scales.approach
        x = depth * to_scaled
        rising = (face.depth_at(share * state.P_max) for share in (0.1, 0.9))
        low, high, first = (_loading(face, depth, start) for start in (*rising, 0.0))
        # unloading follows Hertz from alpha_e, and ends at the rebound speed
        up = face.recovery(depth) * to_scaled / restitution
        rest = {
            "stored": state.stored / (scales.force * scales.approach),
            "duration": (1.0 + restitution) * scales.force / state.P_max,
            "rise": (low - high) * to_scaled,
            **_over(first * to_scaled + up * _UNLOADING),
        }
    share = scales.mass / (scales.mass + ahead.mass)
    return {
        "x_max": x,
        "x_b": x,
        # speeds after the impact, over the closing speed
        "end_speed": share - (1.0 - share) * restitution,
        "end_speed_b": share * (1.0 + restitution),
        **rest,
    }


#: integral of dx/sqrt(1 - x^2.5) from 0 to 1: time of unloading over alpha_e/v, (R11)
_UNLOADING = 1.4716375921624


def _loading(face: Face, depth: Array, start: Values) -> Array:
    """Time of loading from z = start to the top z_m over alpha_y/v: the integral of dz/sqrt(1 -
    W(z)/W(z_m)).

    With z = z_m cos²(t) the integrand is smooth at both ends; it bends at the onset, where the
    range is cut.
    """
    # Gauss points below and above the onset: analytic in the angle, 1e-12 at all depths
    nodes, weights = np.array(np.polynomial.legendre.leggauss(24))[:, :, None]
    total = np.zeros_like(depth)
    work = face.work(depth)
    low = np.zeros_like(depth)
    for bound in (np.maximum(start, 1.0), start):
        high = np.arccos(np.sqrt(np.minimum(bound / depth, 1.0)))
        half = 0.5 * (high - low)
        angle = low + half * (nodes + 1.0)
        left = 1.0 - face.work(depth * np.square(np.cos(angle))) / work
        integrand = np.sin(2.0 * angle) / np.sqrt(np.maximum(left, 1e-300))
        total += half * depth * (weights * np.where(angle > 0.0, integrand, 0.0)).sum(axis=0)
        low = high
    return total


def _pressed(scene: Scene) -> ColumnMap:
    """Slow loading in scaled variables: statics with equal forces and one contact law."""
    scales = scene.scales
    c = scene.columns
    partner = scene.struck
    softness = 1.0 / scene.column("platens.machine_stiffness", np.inf)
    if "platens.force" in c:
        force = c["platens.force"]
    else:
        force = _force_at(partner, c["platens.displacement"], softness)
    face = partner.face

    def pressed(force: Array) -> Pair:
        """Approach and energy of one contact."""
        if face is None:
            approach = contact.approach_at_force(force, partner.hertz_constant)
            return approach, 0.4 * force * approach
        state = face.pressed(face.depth_at(force))
        return state.alpha_max, state.stored

    approach, stored = pressed(force)
    if "platens.loading_rate" in c:
        rise = 0.8 * force / c["platens.loading_rate"]
    else:  # both contacts and the machine give way
        way = 2.0 * (pressed(0.9 * force)[0] - pressed(0.1 * force)[0]) + 0.8 * force * softness
        rise = way / scene.column("platens.speed")
    return {
        **dict.fromkeys(("x_max", "x_a", "x_b"), approach / scales.approach),
        **dict.fromkeys(("other_a", "other_b", "mean_force"), force / scales.force),
        **dict.fromkeys(("difference", "ended"), 0.0),
        "stored": 2.0 * stored / (scales.force * scales.approach),
        "rise": rise / scales.time,
    }


def _force_at(partner: Partner, displacement: Array, softness: Array) -> Array:
    """Force [N] at a displacement [m] of two contacts and a machine; Newton's method."""
    face = partner.face
    scale = partner.effective_radius
    unit = partner.hertz_constant * scale**1.5
    if face is not None:
        scale = face.onset_approach
        unit = face.onset_force
    wanted = displacement / scale
    stiff = softness * unit / scale

    def force(depth: Array) -> Array:
        return depth**1.5 if face is None else face.force(depth)

    def step(depth: Array) -> Array:
        slope = 1.5 * np.sqrt(depth) if face is None else face.slope(depth)
        return (2.0 * depth + stiff * force(depth) - wanted) / (2.0 + stiff * slope)

    return unit * force(newton(step, 0.5 * wanted, 0.0))

"""The paper's formulas as printed, for comparison with the corrected ones; never used to compute.

W. K. Nowacki, Engng. Trans. 42(3), 263–279, 1994; docs/errata.md says what is wrong with each.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Values

from .closed_form import massless_approach, solve_closed
from .integrator.solve import motion, solve
from .outputs import OUTPUTS, SceneAnswers
from .scene import STATUS, STRIKER_COLUMNS, Scene

#: the value of (3.8); the integral it stands for diverges
DURATION_FACTOR = 6.715
#: integral of sin^(3/2)(pi x) from 0 to 1: Gamma(5/4)/(sqrt(pi) Gamma(7/4))
_SINE_IMPULSE = math.gamma(1.25) / (math.sqrt(math.pi) * math.gamma(1.75))
#: relative error of the integration of the full model
_TOLERANCE = 1e-8
#: end of an endless step, in t_c, by which the approach has settled to nine digits
_SETTLED = 30.0
#: what is wrong with each formula
_LONG_PULSE = "holds for a long pulse only"
_SINE = "from (3.9), a sine of the duration (3.8); the approach rises monotonically"
_LOSS = (
    "(3.8) is the value of an integral that diverges; a massless sphere in infinite bars never "
    "loses contact"
)


class PaperValue(NamedTuple):
    """One quantity by the paper's printed formula, by the corrected one, and by the full model.

    quantity: its key.  name: what it is called.  printed, corrected, full: values in SI, NaN where
    there is none.  `corrected` is the paper's own idealisation put right: a massless sphere in
    infinite bars under a rectangular pulse.  `full` is the scene as it is: with the sphere's mass,
    reflections and the shape of the pulse.  unit_of: the entry of `OUTPUTS` whose unit people read.
    note: the equation, and what is wrong with it.
    """

    quantity: str
    name: str
    printed: float
    corrected: float
    full: float
    unit_of: str
    note: str


def contact_duration(approach: Values, speed: Values) -> Values:
    """t_k - t_1 = 6.715 alpha_max/v0 [s], (3.8); the integral behind it diverges."""
    return DURATION_FACTOR * approach / speed


def approach(time: Values, peak: Values, duration: Values) -> Values:
    """alpha(t) = alpha_max sin(pi t/t_k) [m], (3.9), from first touch to the end of contact."""
    return np.where(time < duration, peak * np.sin(math.pi * np.minimum(time / duration, 1.0)), 0.0)


def rise_time(duration: Values) -> Values:
    """Time [s] from 10 % to 90 % of the peak of P = P_max sin^(3/2)(pi t/t_k), implied by (3.9)."""
    return duration / math.pi * (math.asin(0.9 ** (2.0 / 3.0)) - math.asin(0.1 ** (2.0 / 3.0)))


def equivalent_duration(duration: Values) -> Values:
    """Impulse over peak force [s] of P = P_max sin^(3/2)(pi t/t_k), implied by (3.9).

    It is B(5/4, 1/2)/pi = 0.5564 t_k.
    """
    return _SINE_IMPULSE * duration


def approach_after_pulse(
    after: Values, start: Values, impedance: Values, hertz_constant: Values
) -> Values:
    """alpha = [alpha_*^(-1/2) + beta (t - t2)/(F0 rho c0)]^(-2) [m], (3.16); lacks a factor 1/2."""
    return (1.0 / np.sqrt(start) + hertz_constant * after / impedance) ** -2.0


def compare_with_paper(scene: Scene) -> tuple[PaperValue, ...]:
    """The paper's printed values beside the corrected ones and the full model's, for the first row.

    Returns one `PaperValue` a formula, in the order of the paper.  ValueError if it lies outside
    the domain of the model.
    """
    scene = scene.at(slice(1))
    (status,) = scene.status.tolist()
    if status:
        raise ValueError(f"row 0 cannot be compared: {STATUS[status]}")
    horizon = None
    if scene.shape == "step":
        horizon = scene.horizon or float(scene.record_end[0])
    corrected = solve_closed(_in_infinite_bars(scene, horizon), "massless")
    full = solve(scene, tolerance=_TOLERANCE)
    scales = scene.scales.at(0)
    speed = float(scene.columns["striker.speed"][0])
    # (3.6): alpha_max = (v0 F0 rho c0/(2 beta))^(2/3), where v0 F0 rho c0/2 is P_c
    alpha = (scales.force / scales.hertz_constant) ** (2.0 / 3.0)
    # (5.1), (5.3) with 1/E* = pi (k0 + k), (5.4)
    radius = math.sqrt(alpha * scales.effective_radius)
    force = (4.0 / 3.0) * scales.modulus * alpha * radius
    pressure = 1.5 * force / (math.pi * radius**2)
    duration = contact_duration(alpha, speed)
    loss = _LOSS
    if math.isnan(_number(full, "time_to_first_loss")):
        loss += f"; not over within the evaluation window of {1e6 * full.record[0]:.4g} us"

    def of(quantity: str, printed: float, note: str) -> PaperValue:
        return PaperValue(
            quantity=quantity,
            name=OUTPUTS[quantity].called,
            printed=float(printed),
            corrected=_number(corrected, quantity),
            full=_number(full, quantity),
            unit_of=quantity,
            note=note,
        )

    peak = of("p_max", pressure, f"(5.4) with (3.6) {_LONG_PULSE}")
    return (
        of("alpha_max", alpha, f"(3.6) {_LONG_PULSE}"),
        of("a_max", radius, f"(5.1) with (3.6) {_LONG_PULSE}"),
        of("P_max", force, f"(5.3) with (3.6) {_LONG_PULSE}"),
        peak,
        of("force_imbalance", 0.0, "(3.1) neglects the mass of the sphere"),
        _mean_pressure(peak, "mean_pressure", 1.0, "peak force"),
        _mean_pressure(peak, "mean_pressure_at_half_approach", 0.5, "half the approach"),
        of("contact_duration", equivalent_duration(duration), _SINE),
        of("time_to_first_loss", duration, loss),
        of("rise_time", rise_time(duration), _SINE),
        *_approaches(scene, alpha, duration),
    )


def _mean_pressure(peak: PaperValue, quantity: str, fraction: float, at: str) -> PaperValue:
    """While alpha = f alpha_max the mean is (2/3) p_max f by (5.9), in place of f^(1/2)."""
    right = 2.0 / 3.0 * math.sqrt(fraction)
    return peak._replace(
        quantity=quantity,
        name=f"mean contact pressure at {at}",
        printed=(2.0 / 3.0) * peak.printed * fraction,
        corrected=right * peak.corrected,
        full=right * peak.full,
        unit_of="p_mean",
        note=f"(5.9) is proportional to f, here {fraction:g}, in place of its square root",
    )


def _approaches(scene: Scene, alpha: float, duration: float) -> list[PaperValue]:
    """Approaches at single instants, and the plateau of the linear contact."""
    scales = scene.scales.at(0)
    time = scales.time
    theta = scales.pulse_number
    beta = scales.hertz_constant
    course = motion(scene, 0, tolerance=_TOLERANCE)

    def at(key: str, name: str, s: float, printed: Values, note: str) -> PaperValue:
        """The approach at the time s over t_c; no full value after the end of the motion."""
        full = math.nan
        if s <= course.end:
            full = float(course.states_at(np.array([s * time]))[0, :2].mean())
        return PaperValue(
            quantity=key,
            name=f"approach at {name} = {s * time * 1e6:.4g} us",
            printed=float(printed),
            corrected=alpha * float(massless_approach(s, theta)),
            full=full,
            unit_of="alpha_max",
            note=note,
        )

    sine = "(3.9) is a sine; the approach follows theory (11)"
    values = [at("approach_at_t_c", "t_c", 1.0, approach(time, alpha, duration), sine)]
    if math.isfinite(theta):
        printed = approach_after_pulse(
            time, alpha * float(massless_approach(theta, theta)), scales.impedance, beta
        )
        fall = "(3.16) lacks a factor 1/2, so that the approach falls twice as fast"
        values.append(at("approach_after_pulse", "t_i + t_c", theta + 1.0, printed, fall))
    # (4.10): alpha -> v0/lambda_1 under a step, lambda_1 = k/(F0 rho c0)
    stiffness = beta * math.sqrt(alpha)
    plateau = PaperValue(
        quantity="linear_plateau",
        name="approach after an endless step, linear contact",
        printed=2.0 * scales.force / stiffness,
        corrected=scales.force / stiffness,
        full=_settled(scene),
        unit_of="alpha_max",
        note="(4.10) lacks a factor 1/2; stiffness: secant of Hertz at alpha_max",
    )
    return [*values, plateau]


def _number(answers: SceneAnswers, quantity: str) -> float:
    """A quantity of the only row, NaN if the evaluation window ended before it was decided."""
    if quantity in answers.censored and answers.censored[quantity][0]:
        return math.nan
    return float(answers.values[quantity][0])


def _in_infinite_bars(scene: Scene, horizon: float | None) -> Scene:
    """The scene in infinite bars, for a striker of the bars' material: under a rectangular pulse of
    its length, or under a step up to a horizon [s].
    """
    columns = {
        name: column
        for name, column in scene.columns.items()
        if not name.startswith("pulse.") and name not in STRIKER_COLUMNS
    }
    shape = "step"
    if horizon is None:
        shape = "rectangular"
        columns["pulse.duration"] = scene.scales.duration
    return replace(
        scene,
        columns=columns,
        shape=shape,
        infinite=True,
        first_loading_only=False,
        whole_record=False,
        horizon=horizon,
        record=None,
    )


def _settled(scene: Scene) -> float:
    """Approach [m] of the full model at the end of an endless step in infinite bars."""
    scales = scene.scales.at(0)
    horizon = _SETTLED * max(1.0, scales.mass_number) * scales.time
    course = motion(_in_infinite_bars(scene, horizon), 0, tolerance=_TOLERANCE)
    return float(course.states_at(np.array([horizon]))[0, :2].mean())

"""The paper's formulas as printed, for comparison with the corrected ones; never used to compute.

W. K. Nowacki, Engng. Trans. 42(3), 263–279, 1994; docs/errata.md says what is wrong with each.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Values
from uqsphere.mechanics.closed_form import massless_approach, solve_closed
from uqsphere.mechanics.integrator.solve import Motion, motion, solve
from uqsphere.mechanics.outputs import OUTPUTS, SceneAnswers
from uqsphere.mechanics.scene import STATUS, STRIKER_COLUMNS, Scene
from uqsphere.units import UNITS

#: the value of (3.8); the integral it stands for diverges
DURATION_FACTOR: Final = 6.715
#: integral of sin^(3/2)(pi x) from 0 to 1: Gamma(5/4)/(sqrt(pi) Gamma(7/4))
_SINE_IMPULSE: Final = math.gamma(1.25) / (math.sqrt(math.pi) * math.gamma(1.75))
#: end of an endless step, in t_c, by which the approach has settled to nine digits
_SETTLED: Final = 30.0


@dataclass(frozen=True, kw_only=True)
class PaperValue:
    """One quantity by the paper's printed formula, by the corrected one, and by the full model.

    quantity: its key.  name: what it is called.  printed, corrected, full: values in SI, None where
    there is none.  `corrected` is the paper's own idealisation put right: a massless sphere in
    infinite bars under a rectangular pulse.  `full` is the scene as it is: with the sphere's mass,
    reflections and the shape of the pulse.  unit_of: the entry of `OUTPUTS` whose unit people read.
    note: the equation, and what is wrong with it.
    """

    quantity: str
    name: str
    printed: float
    corrected: float | None
    full: float | None
    unit_of: str
    note: str


@dataclass(frozen=True, kw_only=True)
class PaperLine:
    """A `PaperValue` as people read it: numbers in `unit`, None where there is no value."""

    name: str
    printed: float
    corrected: float | None
    unit: str
    note: str


def peak_approach(speed: Values, impedance: Values, hertz_constant: Values) -> Values:
    """alpha_max = (v0 F0 rho c0/(2 beta))^(2/3) [m], (3.6); reached only by a long pulse."""
    return np.cbrt(np.square(0.5 * speed * impedance / hertz_constant))


def contact_radius(approach: Values, radius: Values) -> Values:
    """r_k = (alpha_max r)^(1/2) [m], (5.1)."""
    return np.sqrt(approach * radius)


def peak_force(approach: Values, contact_radius: Values, modulus: Values) -> Values:
    """P_max = 4 alpha_max r_k/(3 pi (k0 + k)) [N], (5.3), with 1/E* = pi (k0 + k)."""
    return (4.0 / 3.0) * modulus * approach * contact_radius


def peak_pressure(force: Values, contact_radius: Values) -> Values:
    """p_max = 3 P_max/(2 pi r_k²) [Pa], (5.4)."""
    return 1.5 * force / (math.pi * np.square(contact_radius))


def mean_pressure(pressure: Values, fraction: Values) -> Values:
    """Mean contact pressure [Pa] while alpha = f alpha_max, (5.9): (2/3) p_max f, not f^(1/2)."""
    return (2.0 / 3.0) * pressure * fraction


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


def linear_plateau(speed: Values, impedance: Values, stiffness: Values) -> Values:
    """alpha -> v0/lambda_1 [m] under a step, (4.10), lambda_1 = k/(F0 rho c0); twice too large."""
    return speed * impedance / stiffness


def paper_line(value: PaperValue) -> PaperLine:
    """A value as people read it, in display units; the note gives the full model's value."""
    entry = OUTPUTS[value.unit_of]
    unit = entry.display or entry.unit
    factor = 1.0 / UNITS[entry.dimension].get(unit, 1.0)
    corrected = None
    if value.corrected is not None:
        corrected = value.corrected * factor
    note = value.note
    if value.full is not None:
        note += f"; full model: {value.full * factor:.4g} {unit}".rstrip()
    return PaperLine(
        name=value.name, printed=value.printed * factor, corrected=corrected, unit=unit, note=note
    )


def compare_with_paper(
    scene: Scene, row: int = 0, *, tolerance: float = 1e-8
) -> tuple[PaperValue, ...]:
    """The paper's printed values beside the corrected ones and the full model's, for one row.

    tolerance: relative error of the integration of the full model.  Returns one `PaperValue` a
    formula.  ValueError if the row lies outside the domain of the model.
    """
    row = range(len(scene))[row]
    if scene.status[row] != 0:
        raise ValueError(f"row {row} cannot be compared: {STATUS[int(scene.status[row])]}")
    scene = scene.at(np.array([row]))
    return _Comparison(scene, tolerance).values()


class _Comparison:
    """One row of a scene, computed three ways."""

    def __init__(self, scene: Scene, tolerance: float) -> None:
        scales = scene.scales
        self.scene, self.tolerance = scene, tolerance
        self.speed = float(scene.columns["striker.speed"][0])
        self.impedance = float(scales.impedance[0])
        self.beta = float(scales.hertz_constant[0])
        self.alpha = float(peak_approach(self.speed, self.impedance, self.beta))
        self.corrected = solve_closed(_idealised(scene))
        self.full = solve(scene, tolerance=tolerance)

    def values(self) -> tuple[PaperValue, ...]:
        """All formulas in the order of the paper."""
        return (*self._peaks(), *self._mean_pressures(), *self._times(), *self._approaches())

    def _value(self, quantity: str, printed: float, note: str) -> PaperValue:
        """A quantity of interest."""
        return PaperValue(
            quantity=quantity,
            name=OUTPUTS[quantity].meaning.partition(":")[0],
            printed=printed,
            corrected=_number(self.corrected, quantity),
            full=_number(self.full, quantity),
            unit_of=quantity,
            note=note,
        )

    def _peaks(self) -> list[PaperValue]:
        scales = self.scene.scales
        radius = float(contact_radius(self.alpha, scales.effective_radius[0]))
        force = float(peak_force(self.alpha, radius, scales.modulus[0]))
        self.pressure = float(peak_pressure(force, radius))
        return [
            self._value("alpha_max", self.alpha, "(3.6) holds for a long pulse only"),
            self._value("a_max", radius, "(5.1) with (3.6) holds for a long pulse only"),
            self._value("P_max", force, "(5.3) with (3.6) holds for a long pulse only"),
            self._value("p_max", self.pressure, "(5.4) with (3.6) holds for a long pulse only"),
            self._value("force_imbalance", 0.0, "(3.1) neglects the mass of the sphere"),
        ]

    def _mean_pressures(self) -> list[PaperValue]:
        """At one instant p ~ f^(1/2) holds, in place of the printed p ~ f."""
        corrected, full = _number(self.corrected, "p_max"), _number(self.full, "p_max")
        values = []
        for fraction, quantity, name in (
            (1.0, "mean_pressure", "mean contact pressure at peak force"),
            (0.5, "mean_pressure_at_half_approach", "mean contact pressure at half the approach"),
        ):
            right = 2.0 / 3.0 * math.sqrt(fraction)
            note = f"(5.9) is proportional to f, here {fraction:g}, in place of its square root"
            values.append(
                PaperValue(
                    quantity=quantity,
                    name=name,
                    printed=float(mean_pressure(self.pressure, fraction)),
                    corrected=None if corrected is None else right * corrected,
                    full=None if full is None else right * full,
                    unit_of="p_mean",
                    note=note,
                )
            )
        return values

    def _times(self) -> list[PaperValue]:
        duration = float(contact_duration(self.alpha, self.speed))
        loss = "(3.8) is the value of an integral that diverges; a massless sphere in infinite bars"
        loss += " never loses contact"
        if _number(self.full, "time_to_first_loss") is None:
            end = 1e6 * self.full.record[0]
            loss += f"; not over within the evaluation window of {end:.4g} us"
        return [
            self._value(
                "contact_duration",
                float(equivalent_duration(duration)),
                "from (3.9), a sine of the duration (3.8); the approach rises monotonically",
            ),
            self._value("time_to_first_loss", duration, loss),
            self._value(
                "rise_time",
                float(rise_time(duration)),
                "from (3.9), a sine of the duration (3.8); the approach rises monotonically",
            ),
        ]

    def _approaches(self) -> list[PaperValue]:
        """Approaches at single instants, and the plateau of the linear contact."""
        time = float(self.scene.scales.time[0])
        theta = float(self.scene.scales.pulse_number[0])
        course = motion(self.scene, 0, tolerance=self.tolerance)
        duration = contact_duration(self.alpha, self.speed)
        values = [
            PaperValue(
                quantity="approach_at_t_c",
                name=f"approach at t_c = {time * 1e6:.4g} us",
                printed=float(approach(time, self.alpha, duration)),
                corrected=self.alpha * float(massless_approach(1.0, theta)),
                full=_approach_at(course, time),
                unit_of="alpha_max",
                note="(3.9) is a sine; the approach follows theory (11)",
            )
        ]
        if math.isfinite(theta):
            start = self.alpha * float(massless_approach(theta, theta))
            after = (theta + 1.0) * time
            printed = approach_after_pulse(time, start, self.impedance, self.beta)
            values.append(
                PaperValue(
                    quantity="approach_after_pulse",
                    name=f"approach at t_i + t_c = {after * 1e6:.4g} us",
                    printed=float(printed),
                    corrected=self.alpha * float(massless_approach(theta + 1.0, theta)),
                    full=_approach_at(course, after),
                    unit_of="alpha_max",
                    note="(3.16) lacks a factor 1/2, so that the approach falls twice as fast",
                )
            )
        stiffness = self.beta * math.sqrt(self.alpha)
        values.append(
            PaperValue(
                quantity="linear_plateau",
                name="approach after an endless step, linear contact",
                printed=float(linear_plateau(self.speed, self.impedance, stiffness)),
                corrected=0.5 * self.speed * self.impedance / stiffness,
                full=_settled(self.scene, self.tolerance),
                unit_of="alpha_max",
                note="(4.10) lacks a factor 1/2; stiffness: secant of Hertz at alpha_max",
            )
        )
        return values


def _number(answers: SceneAnswers, quantity: str) -> float | None:
    """A quantity of the only row, None if the evaluation window ended before it was decided."""
    if quantity in answers.censored and answers.censored[quantity][0]:
        return None
    return float(answers.values[quantity][0])


def _approach_at(course: Motion, time: float) -> float | None:
    """Mean approach [m] of both contacts at a time [s], None after the end of the motion."""
    if time > course.end:
        return None
    return float(course.states_at(np.array([time]))[0, :2].mean())


def _idealised(scene: Scene) -> Scene:
    """The scene in infinite bars under a rectangular pulse of its length, or under its step."""
    if scene.shape == "step":
        return _in_infinite_bars(scene, "step", scene.horizon or float(scene.record_end[0]))
    return _in_infinite_bars(scene, "rectangular", None)


def _in_infinite_bars(scene: Scene, shape: str, horizon: float | None) -> Scene:
    """The scene with an ideal pulse in infinite bars, for a striker of the bars' material."""
    columns = {
        name: column
        for name, column in scene.columns.items()
        if not name.startswith("pulse.") and name not in STRIKER_COLUMNS
    }
    if shape != "step":
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


def _settled(scene: Scene, tolerance: float) -> float:
    """Approach [m] of the full model at the end of an endless step in infinite bars."""
    scales = scene.scales
    horizon = _SETTLED * max(1.0, float(scales.mass_number[0])) * float(scales.time[0])
    course = motion(_in_infinite_bars(scene, "step", horizon), 0, tolerance=tolerance)
    return float(course.states_at(np.array([horizon]))[0, :2].mean())

"""The paper's formulas as they are printed, to be compared with the corrected ones; never used to
compute.

W. K. Nowacki, Engng. Trans. 42(3), 263–279, 1994; what is wrong with each is in docs/errata.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from uqsphere.arrays import Values
from uqsphere.mechanics.closed_form import massless_approach, solve_closed
from uqsphere.mechanics.integrator.solve import motion, solve
from uqsphere.mechanics.scene import STATUS, STRIKER_COLUMNS, Scene

#: the value of (3.8); the integral it stands for diverges
DURATION_FACTOR: Final = 6.715
#: integral of sin^(3/2)(pi x) from 0 to 1: Gamma(5/4)/(sqrt(pi) Gamma(7/4))
_SINE: Final = math.gamma(1.25) / (math.sqrt(math.pi) * math.gamma(1.75))
#: end of an endless step, in t_c, by which the approach has settled to nine digits
_SETTLED: Final = 30.0


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """One quantity by the paper's printed formula, the corrected one and the full model; SI, None:
    no value.

    `corrected` is the paper's own idealisation put right: a massless sphere in infinite bars under
    a rectangular pulse; `full` is the scene as it is: the sphere's mass, reflections, the pulse's
    shape.
    """

    quantity: str
    unit: str
    as_printed: float | None
    corrected: float | None
    full: float | None
    note: str

    @property
    def error(self) -> float | None:
        """The printed value over that of the full model, less 1; None where either is missing or
        zero.
        """
        if self.as_printed is None or not self.full:
            return None
        return self.as_printed / self.full - 1.0


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


def mean_pressure(pressure: Values, share: Values) -> Values:
    """Mean pressure over the contact [Pa] while alpha = f alpha_max, (5.9): (2/3) p_max f, not
    f^(1/2).
    """
    return (2.0 / 3.0) * pressure * share


def contact_duration(approach: Values, speed: Values) -> Values:
    """t_k - t_1 = 6.715 alpha_max/v0 [s], (3.8); the integral behind it diverges."""
    return DURATION_FACTOR * approach / speed


def approach(time: Values, peak: Values, duration: Values) -> Values:
    """alpha(t) = alpha_max sin(pi t/t_k) [m], (3.9), from first touch to the end of contact, then
    zero.
    """
    return np.where(time < duration, peak * np.sin(math.pi * np.minimum(time / duration, 1.0)), 0.0)


def rise_time(duration: Values) -> Values:
    """Time [s] from 10 % to 90 % of the largest force on P = P_max sin^(3/2)(pi t/t_k), which (3.9)
    means.
    """
    return duration / math.pi * (math.asin(0.9 ** (2.0 / 3.0)) - math.asin(0.1 ** (2.0 / 3.0)))


def equivalent_duration(duration: Values) -> Values:
    """Impulse over peak [s] of P = P_max sin^(3/2)(pi t/t_k), which (3.9) means: B(5/4, 1/2)/pi =
    0.5564 t_k.
    """
    return _SINE * duration


def approach_after_pulse(
    after: Values, start: Values, impedance: Values, hertz_constant: Values
) -> Values:
    """alpha = [alpha_*^(-1/2) + beta (t - t2)/(F0 rho c0)]^(-2) [m], (3.16); the divisor 2 is
    missing.
    """
    return (1.0 / np.sqrt(start) + hertz_constant * after / impedance) ** -2.0


def linear_plateau(speed: Values, impedance: Values, stiffness: Values) -> Values:
    """alpha -> v0/lambda_1 [m] under a step, (4.10), with lambda_1 = k/(F0 rho c0); twice the right
    value.
    """
    return speed * impedance / stiffness


def compare(scene: Scene, row: int = 0, *, tolerance: float = 1e-8) -> list[Comparison]:
    """What the paper prints, the corrected massless value and the full model's for one row of a
    scene.

    ValueError if the row lies outside the domain of the model.
    """
    row = range(len(scene))[row]
    if scene.status[row] != 0:
        raise ValueError(f"row {row} cannot be compared: {STATUS[int(scene.status[row])]}")
    scene = replace(scene, columns={name: column[[row]] for name, column in scene.columns.items()})
    return [*_peaks(scene, tolerance), *_times(scene, tolerance), *_instants(scene, tolerance)]


def _idealised(scene: Scene) -> Scene:
    """The scene in infinite bars under a rectangular pulse of the same length, or under the same
    step.
    """
    columns = {
        name: column
        for name, column in scene.columns.items()
        if not name.startswith("pulse.") and name not in STRIKER_COLUMNS
    }
    if scene.shape == "step":
        horizon = scene.horizon or float(scene.record_end[0])
        return replace(
            scene, columns=columns, infinite=True, first_loading_only=False, horizon=horizon
        )
    columns["pulse.duration"] = scene.scales.duration
    return replace(
        scene,
        columns=columns,
        shape="rectangular",
        infinite=True,
        first_loading_only=False,
        horizon=None,
    )


def _scalars(scene: Scene) -> tuple[float, float, float, float]:
    """v0, Z, beta and the printed alpha_max of the only row."""
    scales = scene.scales
    speed = float(scene.columns["striker.speed"][0])
    impedance, beta = float(scales.impedance[0]), float(scales.hertz_constant[0])
    return speed, impedance, beta, float(peak_approach(speed, impedance, beta))


def _peaks(scene: Scene, tolerance: float) -> list[Comparison]:
    """Approach, contact radius, force, pressures, energy."""
    _, _, _, alpha = _scalars(scene)
    radius = float(contact_radius(alpha, scene.scales.effective_radius[0]))
    force = float(peak_force(alpha, radius, scene.scales.modulus[0]))
    pressure = float(peak_pressure(force, radius))
    corrected, full = (
        solve_closed(_idealised(scene)).values,
        solve(scene, tolerance=tolerance).values,
    )
    printed: list[tuple[str, str, float | None, str]] = [
        ("p_max", "Pa", pressure, "(5.4) with (3.6), (5.1) and (5.3): the limit of a long pulse"),
        ("P_max", "N", force, "(5.3), equal to (3.7) times the section: the limit of a long pulse"),
        ("alpha_max", "m", alpha, "(3.6): the limit of a long pulse"),
        ("a_max", "m", radius, "(5.1)"),
        ("energy", "J", None, "not in the paper"),
        ("force_imbalance", "", 0.0, "(3.1): none without mass"),
    ]
    rows = [
        Comparison(
            quantity=name,
            unit=unit,
            as_printed=value,
            corrected=float(corrected[name][0]),
            full=float(full[name][0]),
            note=note,
        )
        for name, unit, value, note in printed
    ]
    # one instant of the right law, p ~ f^(1/2), against the printed p ~ f: the models differ by
    # p_max alone
    for share, name in ((1.0, "mean_pressure"), (0.5, "mean_pressure_at_half_approach")):
        right = 2.0 / 3.0 * math.sqrt(share)
        rows.append(
            Comparison(
                quantity=name,
                unit="Pa",
                as_printed=float(mean_pressure(pressure, share)),
                corrected=right * float(corrected["p_max"][0]),
                full=right * float(full["p_max"][0]),
                note=f"(5.9) at f = {share:g}; the correct law goes with the square root of f",
            )
        )
    return rows


def _times(scene: Scene, tolerance: float) -> list[Comparison]:
    """Contact duration, time to the first loss, rise."""
    speed, _, _, alpha = _scalars(scene)
    duration = float(contact_duration(alpha, speed))
    corrected, full = solve_closed(_idealised(scene)), solve(scene, tolerance=tolerance)
    printed = [
        (
            "contact_duration",
            float(equivalent_duration(duration)),
            "impulse over peak of sin^(3/2) by (3.9)",
        ),
        (
            "time_to_first_loss",
            duration,
            "(3.8); the massless sphere in infinite bars never loses contact",
        ),
        ("rise_time", float(rise_time(duration)), "10 % to 90 % of sin^(3/2) by (3.9)"),
    ]
    rows = []
    for name, value, note in printed:
        seen = [
            None
            if name in answers.censored and answers.censored[name][0]
            else float(answers.values[name][0])
            for answers in (corrected, full)
        ]
        late = f"; not over within the record of {full.record[0]:.4g} s" if seen[1] is None else ""
        rows.append(
            Comparison(
                quantity=name,
                unit="s",
                as_printed=value,
                corrected=seen[0],
                full=seen[1],
                note=note + late,
            )
        )
    return rows


def _instants(scene: Scene, tolerance: float) -> list[Comparison]:
    """Approaches at single instants, half of what the bar ends have come closer; and the linear
    plateau.
    """
    speed, impedance, beta, alpha = _scalars(scene)
    time, theta = float(scene.scales.time[0]), float(scene.scales.pulse_number[0])
    found = motion(scene, 0, tolerance=tolerance)

    def full(s: float) -> float | None:
        if s > found.end:
            return None
        return float(found.states_at(np.array([s * time]))[0, :2].mean())

    rows = [
        Comparison(
            quantity="approach_at_t_c",
            unit="m",
            as_printed=float(approach(time, alpha, contact_duration(alpha, speed))),
            corrected=alpha * float(massless_approach(1.0, theta)),
            full=full(1.0),
            note=f"(3.9) at t_c = {time * 1e6:.4g} us; the loading is no sine but theory (11)",
        )
    ]
    if math.isfinite(theta):
        start = alpha * float(massless_approach(theta, theta))
        rows.append(
            Comparison(
                quantity="approach_after_pulse",
                unit="m",
                as_printed=float(approach_after_pulse(time, start, impedance, beta)),
                corrected=alpha * float(massless_approach(theta + 1.0, theta)),
                full=full(theta + 1.0),
                note=(
                    f"(3.16) at t_i + t_c = {(theta + 1.0) * time * 1e6:.4g} us, from the "
                    "corrected alpha_*"
                ),
            )
        )
    stiffness = beta * math.sqrt(alpha)
    rows.append(
        Comparison(
            quantity="linear_plateau",
            unit="m",
            as_printed=float(linear_plateau(speed, impedance, stiffness)),
            corrected=0.5 * speed * impedance / stiffness,
            full=_settled(scene, tolerance),
            note="(4.10) with the secant stiffness; full: end of an endless step in infinite bars",
        )
    )
    return rows


def _settled(scene: Scene, tolerance: float) -> float:
    """Approach [m] to which the full model settles under an endless step in infinite bars."""
    columns = {
        name: column for name, column in scene.columns.items() if not name.startswith("pulse.")
    }
    horizon = _SETTLED * max(1.0, float(scene.scales.mass_number[0])) * float(scene.scales.time[0])
    endless = replace(
        scene,
        columns=columns,
        shape="step",
        infinite=True,
        first_loading_only=False,
        horizon=horizon,
    )
    found = motion(endless, 0, tolerance=tolerance)
    return float(found.states_at(np.array([horizon]))[0, :2].mean())

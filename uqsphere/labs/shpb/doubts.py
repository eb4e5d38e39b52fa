"""What a record says against its own numbers: striker, bending, impulse, inertia, strength.

Every check doubts the peaks that it concerns, and widens their intervals to what it would allow.
"""

import math

import numpy as np
from scipy.optimize import lsq_linear

from uqsphere.arrays import Array
from uqsphere.uq import LEVEL_TEXT

from .mending import Signal
from .peaks import NORMAL, Peaks, stretch

#: difference between two gauges of a bar over the wave that is a gross fault
_GROSS = 0.25
#: relative width of an interval beyond which a number is poorly determined; difference of the
#: faces that is doubted even where their intervals overlap
_WIDE, _APART = 0.3, 0.2
#: striker speeds [m/s] of real tests; relative difference from the given speed that is a fault
_STRUCK, _SPEED_ERROR = (0.1, 100.0), 0.1
#: difference of the forces over their mean that counts as equilibrium
EQUILIBRIUM = 0.05
#: misfit of inertia and gain beyond which they do not explain the forces
_MISFIT = 0.05


def check_striker(peaks: Peaks, incident: Signal, measured: float | None) -> None:
    """Compare the incident wave with the striker speed [m/s], given or possible (in place)."""
    strain = incident.wave.peak
    speed = 2.0 * incident.bar.wave_speed * strain
    text = (
        f"an incident wave of {strain * 1e6:.4g} microstrain corresponds to a striker of "
        f"{speed:.3g} m/s"
    )
    if not measured:
        incident.changes.add(
            "an error common to both bars (gain, E, diameter) does not show in a record; "
            "record.striker_speed checks the gains",
            "gains",
        )
        if not _STRUCK[0] <= speed <= _STRUCK[1]:
            for face in peaks:
                peaks.doubt(face, f"{text}: is a unit or a gain wrong?")
    elif abs(speed - measured) > _SPEED_ERROR * measured:
        text += f", not {measured:.3g} m/s: a gain or a unit is wrong"
        for face, peak in peaks.items():
            peaks.doubt(face, text, peak.low * measured / speed, peak.high * measured / speed)


def check_bending(peaks: Peaks, face: str, spread: Array, step: float, wave: float) -> None:
    """Compare the gauges of the bar of a face (in place).

    spread (n,) : half their difference [N] at steps [s]; wave : force of the wave that they record
    [N].
    """
    peak = peaks[face]
    at = round(peak.time / step)
    bending = spread[max(at - 3, 0) : at + 4].mean()
    if 2.0 * bending > _GROSS * wave:
        bar = "incident" if face == "A" else "receiving"
        peaks.doubt(
            face,
            f"the gauges of the {bar} bar differ by {2.0 * bending / wave:.0%} of the wave there",
            peak.low - bending,
            peak.high + bending,
        )


def check_impulse(
    peaks: Peaks, motion: Array, step: float, gains_sd: float, zeros_sd: float, heaviest: float
) -> float | None:
    """Compare the impulses of both faces until B falls to half its largest force (in place).

    The forces differ by the inertia of the specimen, P_A - P_B = M dv/dt, and by an error of gain,
    g P_B.  The approaches of both contacts go with P^(2/3), so that the velocity v of the specimen
    is the mean of the faces' less half of c d/dt (P_A^(2/3) - P_B^(2/3)).  M, c and g follow by
    least squares from this equation, integrated twice over time.  Impulses that differ by more than
    the gains, with and without a mass up to `heaviest` [kg], are a doubt.

    motion (4, n) : forces at A and B [N], A being NaN where it is not known, and velocities of the
        faces of both bars [m/s], at steps [s].
    gains_sd, zeros_sd : sums over both faces of the relative standard deviations of the gains, and
        of the standard deviations of the zeros [N].

    Returns the mass [kg] whose inertia explains the difference, None if none does.
    """
    largest = peaks["B"]
    first, last = stretch(motion[1], 0.5 * largest.value, round(largest.time / step))
    if last - first <= 2:
        return None
    force_a, force_b = motion[:2, first:last]
    known = np.isfinite(force_a)
    plain = force_a[known].sum() / max(force_b[known].sum(), 1e-300)
    allowed = NORMAL * (gains_sd + zeros_sd / largest.value)
    factors = [plain]
    last = max(last, round(peaks["A"].time / step) + 1)
    if np.isfinite(motion[0, :last]).all():
        mass, gain, misfit = _fit_inertia(motion[:, :last], step, heaviest)
        if misfit <= _MISFIT:
            factors.append(1.0 + gain)
            if abs(gain) <= allowed:
                return mass
    if abs(plain - 1.0) > allowed:
        text = f"A has {plain:.3g} times the impulse of B: check gains, zeros and arrivals"
        for face, peak in peaks.items():
            ends = [peak.value * factor for factor in factors]
            if face != "B":
                ends = [peak.value / max(factor, 1e-3) for factor in factors]
            peaks.doubt(face, text, *ends)
    return None


def _fit_inertia(motion: Array, step: float, heaviest: float) -> tuple[float, float, float]:
    """Mass [kg], relative error of gain, and largest misfit over the largest integral of B."""
    force_a, force_b, velocity_a, velocity_b = motion
    way = step * np.cumsum(0.5 * (velocity_a + velocity_b))
    approach_a, approach_b = np.cbrt(np.square(np.maximum(motion[:2], 0.0)))
    impulses = step**2 * np.cumsum(np.cumsum(force_b))
    difference = step**2 * np.cumsum(np.cumsum(force_a - force_b))
    columns = np.column_stack([way, approach_b - approach_a, impulses])
    scale = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    bounds = ([0.0, -np.inf, -np.inf], [heaviest * scale[0], np.inf, np.inf])
    fitted = lsq_linear(columns / scale, difference, bounds, method="bvls").x / scale
    mass, _, gain = fitted
    misfit = np.abs(difference - columns @ fitted).max() / np.abs(impulses).max()
    # no specimen moves faster than a ball that the faster face hits
    momentum = np.abs(step * np.cumsum(force_a - (1.0 + gain) * force_b)).max()
    fastest = 2.0 * np.abs(motion[2:]).max()
    beyond = (momentum - mass * fastest) / np.abs(step * np.cumsum(force_b)).max()
    return mass, gain, max(misfit, beyond)


def check_specimen(
    peaks: Peaks, pressed: float, strongest: float | None, mass: float | None
) -> list[str]:
    """Compare the peaks with each other, and with what is possible (in place).

    pressed, strongest : forces of the incident wave and of the specimen [N].
    mass : of the specimen whose inertia explains that the faces differ [kg], None without one.

    Returns a note on a specimen that is not in equilibrium.
    """
    before = dict(peaks)
    for face, peak in before.items():
        if peak.low > 2.0 * pressed:
            peaks.doubt(
                face,
                f"an incident wave of {pressed * 1e-3:.4g} kN causes at most twice this force, "
                f"{2.0 * pressed * 1e-3:.4g} kN",
                2.0 * pressed,
            )
        if strongest and peak.low > strongest:
            peaks.doubt(
                face,
                f"the specimen bears at most {strongest * 1e-3:.4g} kN (specimen.strongest)",
                strongest,
            )
    if "A" not in before:
        return []
    a = before["A"]
    b = before["B"]
    both = f"A {a.value * 1e-3:.4g}, B {b.value * 1e-3:.4g} kN"
    apart = abs(a.value - b.value) / max(a.value, b.value)
    differ = a.low > b.high or b.low > a.high or apart > _APART
    uncommon = before["mean"].value < (1.0 - EQUILIBRIUM) * 0.5 * (a.value + b.value)
    if mass is None:
        if differ:
            text = f"the faces differ by {apart:.0%} ({both})"
            for face in peaks:
                peaks.doubt(face, text, a.low, b.low, a.high, b.high)
        if uncommon:
            peaks.doubt(
                "mean",
                f"the peaks of the faces are {abs(a.time - b.time) * 1e6:.4g} us apart: the mean "
                "has no common peak",
                a.high,
                b.high,
            )
    elif differ or uncommon or apart > EQUILIBRIUM:
        return [
            f"the specimen is not in equilibrium ({both}): its inertia, about {mass * 1e3:.2g} g, "
            "explains the difference. B is the force at the far face"
        ]
    return []


def check_widths(peaks: Peaks) -> None:
    """Doubt forces whose intervals are wide, as all other checks leave them; the mean takes the
    doubts of each face as those of that face (in place).
    """
    for face, peak in dict(peaks).items():
        width = peak.high - peak.low
        if _WIDE * peak.value < width < math.inf:
            half = 0.5 * width / peak.value
            peaks.doubt(face, f"poorly determined: its {LEVEL_TEXT} interval is ±{half:.0%}")
    if "mean" not in peaks:
        return
    for face in ("A", "B"):
        for text in peaks[face].doubts:
            if text not in peaks["mean"].doubts:
                peaks.doubt("mean", f"{face}: {text}")

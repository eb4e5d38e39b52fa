"""How far a composite solution would come: the slow massless motion with the oscillation of a light sphere upon it.

    x_1,2 = m(s) ± z(s)/2,   z = C mu^0.45 m^(-1/8) exp(-0.75 ∫ sqrt(m) ds) cos(phi + ∫ sqrt(3 sqrt(m)/mu) ds)

m is the massless loading; the amplitude is that of an oscillator whose frequency changes slowly (frequency times
the square of the amplitude is kept, but for the damping); C and phi come from the touch, where s is of the order
of mu^0.4 and the motion without parameters.  When the pulse ends, dz/ds drops by 2.

    python -m tests.campaigns.composite
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from uqsphere.bench.scenes import scattered_scene
from uqsphere.mechanics.closed_form import loading_approach
from uqsphere.mechanics.integrator.solve import integrate
from uqsphere.mechanics.scene import Scene

__all__ = ["composite_peak", "peak_errors"]

Array = npt.NDArray[np.float64]

#: amplitude and phase that the touch leaves, fitted to the integrated motion at mu = 1e-6 (rms 4e-5 of the amplitude)
AMPLITUDE, PHASE = -1.41697, 1.68651


@lru_cache(maxsize=4)
def _integrals(end: float) -> tuple[Array, Array, Array]:
    """Times, phase times sqrt(mu), and damping of the loading up to `end`."""
    from scipy.integrate import cumulative_simpson

    times = np.concatenate([np.geomspace(1e-10, 1e-3, 4000), np.linspace(1e-3, end, 200_001)[1:]])
    root = np.sqrt(loading_approach(times))
    phase = cumulative_simpson(np.sqrt(3.0 * root), x=times, initial=0.0)
    return times, phase, cumulative_simpson(0.75 * root, x=times, initial=0.0)


def composite_peak(mu: float, theta: float) -> float:
    """Largest scaled approach under a rectangular pulse on infinite bars, by the composite solution; theta up to 4."""
    times, phase, damping = _integrals(4.0)
    s = np.linspace(max(0.3 * theta, theta - 12.0 * np.sqrt(mu)), theta, 4000)
    mean = loading_approach(s)
    swing = AMPLITUDE * mu**0.45 * mean**-0.125 * np.exp(-np.interp(s, times, damping))
    swing *= np.cos(PHASE + np.interp(s, times, phase) / np.sqrt(mu))
    frequency = np.sqrt(3.0 * np.sqrt(mean[-1]) / mu)
    after = np.linspace(0.0, np.pi / frequency, 2000)
    relaxed = (mean[-1] ** -0.5 + 0.5 * after) ** -2.0
    speed = (swing[-1] - swing[-2]) / (s[-1] - s[-2]) - 2.0
    coasting = swing[-1] * np.cos(frequency * after) + speed / frequency * np.sin(frequency * after)
    return float(max((mean + 0.5 * np.abs(swing)).max(), (relaxed + 0.5 * np.abs(coasting)).max()))


def peak_errors(mu: float, count: int = 40) -> tuple[float, float, float]:
    """Largest error of p_max by `massless` and by the composite, its median, over pulses of 1.5 to 3.5 t_c."""
    theta = np.linspace(1.5, 3.5, count)
    base = scattered_scene(1, mu=mu, theta=1.0)
    columns = {name: np.repeat(column[:1], count) for name, column in base.columns.items()}
    scale = base.scales
    columns["sphere.density"] *= mu / scale.mass_number[0]
    columns["striker.length"] *= theta / scale.pulse_number[0]
    scene = Scene(columns=columns, infinite=True)
    exact = integrate(scene, tolerance=1e-9, quantities=("p_max",)).answers[:, 0]
    light = np.abs(np.sqrt(loading_approach(theta) / exact) - 1.0)
    composite = np.abs(np.sqrt([composite_peak(mu, t) for t in theta] / exact) - 1.0)
    return float(light.max()), float(composite.max()), float(np.median(composite))


def main() -> None:
    """Print the table."""
    print("| mu | massless, worst | composite, worst | composite, median |")
    print("|---|---|---|---|")
    for mu in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2):
        light, worst, median = peak_errors(mu)
        print(f"| {mu:.0e} | {light:.1e} | {worst:.1e} | {median:.1e} |")


if __name__ == "__main__":
    main()

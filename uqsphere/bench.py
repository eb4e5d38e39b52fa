"""Speed against error: the integrator next to general ones, and a run as it doubles its rows."""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable, Sequence
from functools import lru_cache
from importlib import metadata
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.mechanics import contact
from uqsphere.mechanics.scene import Scene
from uqsphere.models.scene import solve_scene

if TYPE_CHECKING:
    import pandas as pd

    from uqsphere.study import Study

#: granite of 20 mm between long steel bars of 40 mm; density and striker set mass and pulse number
_NUMBERS: Final = {
    "sphere.E": 52e9, "sphere.nu": 0.25, "sphere.radius": 10e-3, "sphere.density": 2650.0,
    "bars.E": 210e9, "bars.nu": 0.3, "bars.density": 7850.0, "bars.diameter": 40e-3,
    "striker.speed": 1.0, "striker.length": 1.0,
}  # fmt: skip
#: tolerance of the reference
_REFERENCE: Final = 1e-12
#: time over t_c after the pulse in which the last peak falls: what is left of the sphere's swing is smaller
_AFTER: Final = 0.6


def scattered_scene(count: int, *, mu: float = 3e-3, theta: float = 3.0, seed: int = 0) -> Scene:
    """Infinite bars, rectangular pulse; lognormal E, radius and speed (10, 2, 10 %) about mu and theta."""
    rng = np.random.default_rng(seed)
    columns = {name: np.full(count, number) for name, number in _NUMBERS.items()}
    for name, scatter in (("sphere.E", 0.1), ("sphere.radius", 0.02), ("striker.speed", 0.1)):
        columns[name] = columns[name] * np.exp(scatter * rng.standard_normal(count))
    centre = Scene(columns={name: np.array([number]) for name, number in _NUMBERS.items()}, infinite=True).scales
    columns["sphere.density"] *= mu / centre.mass_number[0]
    columns["striker.length"] *= theta / centre.pulse_number[0]
    return Scene(columns=columns, infinite=True)


# --- contenders: each gives the largest pressure (n,) [Pa] of a scene by `scattered_scene` ----------------------------
#
# Scaled by P_c, alpha_c, t_c and V_c (docs/theory.md): x_1' = 2 f - q_1 - u, x_2' = u - q_2, mu u' = q_1 - q_2 with
# q = max(x, 0)^(3/2), and f = 1 while the pulse lasts.


def _by_kernel(scene: Scene, tolerance: float) -> Array:
    return solve_scene(scene, tolerance=tolerance, threads=1, quantities=("p_max",)).values["p_max"]


def _pressure(scene: Scene, largest: Array) -> Array:
    scales = scene.scales
    force = scales.force * largest**1.5
    return np.asarray(contact.pressure_at_force(force, scales.modulus, scales.effective_radius))


def _by_scipy(scene: Scene, tolerance: float) -> Array:
    """DOP853 as a good user would: a piece before and one after the end of the pulse, peaks by events."""
    from scipy.integrate import solve_ivp

    solve: Any = solve_ivp

    def largest(mu: float, theta: float) -> float:
        state, peak = np.zeros(3), 0.0
        for f, begin, end in ((1.0, 0.0, theta), (0.0, theta, theta + _AFTER)):

            def slope(t: float, y: Array, f: float = f) -> list[float]:
                q1, q2 = max(y[0], 0.0) ** 1.5, max(y[1], 0.0) ** 1.5
                return [2.0 * f - q1 - y[2], y[2] - q2, (q1 - q2) / mu]

            rates = [lambda t, y, k=k, slope=slope: slope(t, y)[k] for k in (0, 1)]
            solution = solve(slope, (begin, end), state, "DOP853", events=rates, rtol=tolerance, atol=0.01 * tolerance)
            state = solution.y[:, -1]
            peak = max([peak, *state[:2], *(float(y[k]) for k in (0, 1) for y in solution.y_events[k])])
        return peak

    scales = scene.scales
    pairs = zip(scales.mass_number.tolist(), scales.pulse_number.tolist(), strict=True)
    return _pressure(scene, np.array([largest(mu, theta) for mu, theta in pairs]))


@lru_cache(maxsize=1)
def _compiled() -> Callable[[Array, Array, float], Array]:
    """DOP853 in numba, its stages unrolled: what a good programmer would write who does not mind compiling.

    Coefficients and the estimate of the error are SciPy's (Hairer, Norsett, Wanner, Solving ODEs I, 1993, II.10).
    """
    import numba
    from scipy.integrate import DOP853

    njit = numba.njit(error_model="numpy")

    def combination(weights: Array, name: str) -> str:
        return " + ".join(f"{w!r} * {name}{j}" for j, w in enumerate(weights.tolist()) if w) or "0.0"

    lines = ["def step(f, mu, a, b, u, h):", "    p0, q0, r0 = rate(f, mu, a, b, u)"]
    for k, weights in enumerate([*DOP853.A[1:12, :12], DOP853.B], start=1):
        shift = [f"{state} + h * ({combination(weights, name)})" for state, name in zip("abu", "pqr", strict=True)]
        end = k == 12
        lines.append(f"    x, y, z = {', '.join(shift)}")
        lines.append(
            f"    p{k}, q{k}, r{k} = rate(f, mu, x, y, z)" if not end else "    p12, q12, r12 = rate(f, mu, x, y, z)"
        )
    for name in ("E5", "E3"):
        lines.append(f"    {name} = ({', '.join(combination(getattr(DOP853, name), stage) for stage in 'pqr')})")
    lines.append("    return (x, y, z), (p12, q12), E5, E3")

    @njit  # type: ignore[untyped-decorator, unused-ignore]
    def rate(f: float, mu: float, a: float, b: float, u: float) -> tuple[float, float, float]:
        p, q = max(a, 0.0), max(b, 0.0)
        p, q = p * math.sqrt(p), q * math.sqrt(q)
        return 2.0 * f - p - u, u - q, (p - q) / mu

    scope: dict[str, Any] = {"rate": rate}
    exec("\n".join(lines), scope)
    step = njit(scope["step"])

    @njit  # type: ignore[untyped-decorator, unused-ignore]
    def largest(masses: Array, pulses: Array, tolerance: float) -> Array:
        peaks = np.zeros(len(masses))
        for row in range(len(masses)):
            mu, a, b, u = masses[row], 0.0, 0.0, 0.0
            for piece in range(2):
                f, left = (1.0, pulses[row]) if piece == 0 else (0.0, _AFTER)
                begin, second, _ = rate(f, mu, a, b, u)
                h = 1e-3
                while left > 0.0:
                    h = min(h, left)
                    (x, y, z), (rx, ry), five, three = step(f, mu, a, b, u, h)
                    fifth = third = 0.0
                    for old, new, e5, e3 in (
                        (a, x, five[0], three[0]),
                        (b, y, five[1], three[1]),
                        (u, z, five[2], three[2]),
                    ):
                        scale = tolerance * (0.01 + max(abs(old), abs(new)))
                        fifth += (e5 / scale) ** 2
                        third += (e3 / scale) ** 2
                    bottom = math.sqrt((fifth + 0.01 * third) * 3.0)
                    error = h * fifth / bottom if bottom > 0.0 else 0.0
                    if error > 1.0:
                        h *= max(0.2, 0.9 * error**-0.125)
                        continue
                    peaks[row] = max(peaks[row], x, y)
                    for k, start, end in ((0, begin, rx), (1, second, ry)):
                        # the step to a peak that may be the largest, by the Illinois rule on the rate at its end;
                        # a rate of 1e-6 leaves 1e-12 of the peak
                        low, high, at = 0.0, h, 0.0
                        hopeful = start > 0.0 > end and max(a, b) + start * h > peaks[row]
                        while hopeful and abs(end) > 1e-6 and abs(start) > 1e-6:
                            at = (low * end - high * start) / (end - start)
                            tops, rates, _, _ = step(f, mu, a, b, u, at)
                            if rates[k] > 0.0:
                                low, start, end = at, rates[k], 0.5 * end
                            else:
                                high, end, start = at, rates[k], 0.5 * start
                            peaks[row] = max(peaks[row], tops[k])
                    a, b, u, begin, second, left = x, y, z, rx, ry, left - h
                    h *= min(10.0, 0.9 * error**-0.125) if error > 0.0 else 10.0
        return peaks

    return largest


def _by_numba(scene: Scene, tolerance: float) -> Array:
    scales = scene.scales
    return _pressure(scene, _compiled()(scales.mass_number, scales.pulse_number, tolerance))


#: who is compared: what computes, what sets the accuracy, its values, and the share of the rows that are taken
_CONTENDERS: Final[dict[str, tuple[Callable[[Scene, float], Array], str, tuple[float, ...], float]]] = {
    "uqsphere": (_by_kernel, "tolerance", (1e-4, 1e-6, 1e-8, 1e-10), 1.0),
    "numba DOP853": (_by_numba, "tolerance", (1e-4, 1e-6, 1e-8, 1e-10), 1.0),
    "scipy DOP853": (_by_scipy, "tolerance", (1e-4, 1e-6, 1e-8, 1e-10), 0.01),
}


def bench(*, rows: int = 1024, rounds: int = 3) -> pd.DataFrame:
    """Processor time of one thread against error in p_max, between infinite bars, for every contender.

    rows : of the scene; scipy takes a hundredth, at least two.
    rounds : each contender is timed so often, in turn; the shortest counts. The first call is not timed.

    Returns a DataFrame with a row for each contender and setting: contender, setting, seconds_per_row [s],
    median_error, largest_error (relative, against the integrator at 1e-12), rows.
    """
    import pandas as pd

    scene = scattered_scene(max(rows, 2))
    reference = _by_kernel(scene, _REFERENCE)
    entries: dict[tuple[str, float], dict[str, Any]] = {}
    for turn in range(rounds + 1):
        for name, (solve, kind, settings, share) in _CONTENDERS.items():
            count = max(2, int(share * len(scene)))
            part = scene.at(slice(count))
            for setting in settings:
                began = time.process_time()
                pressures = solve(part, setting)
                seconds = (time.process_time() - began) / count
                if turn == 0:
                    error = np.abs(pressures / reference[:count] - 1.0)
                    entries[name, setting] = {
                        "contender": name, "setting": f"{kind} {setting:g}", "seconds_per_row": math.inf,
                        "median_error": float(np.median(error)), "largest_error": float(error.max()), "rows": count,
                    }  # fmt: skip
                else:
                    entry = entries[name, setting]
                    entry["seconds_per_row"] = min(entry["seconds_per_row"], seconds)
    return pd.DataFrame(entries.values())


def times_as_fast(frame: pd.DataFrame, rival: str, error: float) -> float:
    """How many times as many seconds a rival takes at a median error, both read off log-log lines.

    NaN where the rival or uqsphere was not measured on both sides of the error.
    """

    def seconds(name: str) -> float:
        rows = frame[frame["contender"] == name].sort_values("median_error")
        errors, taken = np.log(rows["median_error"].clip(lower=1e-16)), np.log(rows["seconds_per_row"])
        return float(np.exp(np.interp(math.log(error), errors, taken, left=np.nan, right=np.nan)))

    return seconds(rival) / seconds("uqsphere")


def run_history(study: Study | None = None, **options: Any) -> pd.DataFrame:
    """Accuracy of a run as its rows double: model_runs, and error, the largest half-width over what was required.

    study : granite, as shipped, if None.
    **options : of `uqsphere.run`.
    """
    import pandas as pd

    import uqsphere
    from uqsphere.study import load_study, shipped_studies

    study = load_study(shipped_studies()["granite"]) if study is None else study
    reached: Sequence[dict[str, float]] = uqsphere.run(study, **options).results["accuracy"]["reached"]
    return pd.DataFrame(
        {"model_runs": [int(r["runs"]) for r in reached], "error": [float(r["error"]) for r in reached]}
    )


def bench_text(*, rows: int = 1024, rounds: int = 3) -> str:
    """Both tables, with the machine and the versions."""
    frame, history = bench(rows=rows, rounds=rounds), run_history()
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in ("numpy", "scipy", "numba"))
    shown = frame.assign(microseconds_per_row=frame["seconds_per_row"] * 1e6).drop(columns="seconds_per_row")
    lines = [f"p_max between infinite bars, one thread; Python {platform.python_version()}, {versions}", ""]
    lines += [shown.to_string(index=False, float_format="{:.2g}".format), ""]
    for rival in ("numba DOP853", "scipy DOP853"):
        lines.append(f"{rival} takes {times_as_fast(frame, rival, 1e-6):,.3g} times as long at a median error of 1e-6")
    lines += ["", "a run of granite: error over what is required, as its rows double", ""]
    return "\n".join([*lines, history.to_string(index=False, float_format="{:.2g}".format)])

"""Speed against error: the integrator beside SciPy's DOP853 and the same method compiled by numba,
and the quantities of shipped studies.

python -m tests.campaigns.speed --rows 512

The compiled contender has every stage written out, as a good user would generate it, finds peaks by
secants on steps of its own method, and runs in this process.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numba
import numpy as np
import pandas as pd
from scipy.integrate import DOP853

from tests.campaigns import options, table
from uqsphere.arrays import Array
from uqsphere.bench import AFTER, bench, bench_study, compared, peak_pressure, scattered_scene
from uqsphere.mechanics.scene import Scene
from uqsphere.study import load_study, shipped_studies

_STAGES = DOP853.n_stages
_STATE = ("x", "y", "u")


def _weighted(weights: Array, state: str) -> str:
    terms = [f"{float(w)!r} * {state}{k}" for k, w in enumerate(weights) if w != 0.0]
    return " + ".join(terms)


def _slopes(k: int, values: dict[str, str]) -> Iterator[str]:
    """Lines that set the slopes of stage k at the values of the state."""
    yield f"a, b = max({values['x']}, 0.0), max({values['y']}, 0.0)"
    yield "q, p = a * sqrt(a), b * sqrt(b)"
    yield f"x{k}, y{k}, u{k} = 2.0 * f - q - {values['u']}, {values['u']} - p, (q - p) / mu"


def _source() -> str:
    """The text of a step from the state (x, y, u) of length h, with all stages written out."""
    lines = [*_slopes(0, {name: name for name in _STATE})]
    for k in range(1, _STAGES):
        lines += _slopes(k, {s: f"({s} + h * ({_weighted(DOP853.A[k, :k], s)}))" for s in _STATE})
    lines += [f"{s}_new = {s} + h * ({_weighted(DOP853.B, s)})" for s in _STATE]
    lines += _slopes(_STAGES, {s: f"{s}_new" for s in _STATE})
    lines.append("fifth = third = 0.0")
    for s in _STATE:
        lines += [
            f"scale = atol + rtol * max(abs({s}), abs({s}_new))",
            f"fifth += (({_weighted(DOP853.E5, s)}) / scale) ** 2",
            f"third += (({_weighted(DOP853.E3, s)}) / scale) ** 2",
        ]
    lines.append("norm = abs(h) * fifth / sqrt(3.0 * max(fifth + 0.01 * third, 1e-300))")
    lines.append(f"return x_new, y_new, u_new, x{_STAGES}, y{_STAGES}, norm")
    body = "\n".join(f"    {line}" for line in lines)
    return f"def step(x, y, u, h, f, mu, rtol, atol):\n{body}\n"


def _compiled() -> Callable[..., Array]:
    """Largest approaches of rows by their mu and theta."""
    scope = {"sqrt": np.sqrt}
    exec(_source(), scope)
    step = numba.njit(scope["step"])

    @numba.njit
    def peak_in(x, y, u, h, f, mu, rtol, atol, face):
        """The approach of a face where its rate changes sign within a step: the secant method."""
        low, high, top = 0.0, h, 0.0
        first = step(x, y, u, 1e-12 * h, f, mu, rtol, atol)[3 + face]
        last = step(x, y, u, h, f, mu, rtol, atol)[3 + face]
        for _ in range(8):
            middle = high - last * (high - low) / (last - first)
            state = step(x, y, u, middle, f, mu, rtol, atol)
            top, rate = max(top, state[face]), state[3 + face]
            if rate > 0.0:
                low, first = middle, rate
            else:
                high, last = middle, rate
            if abs(rate) < 1e-3 * rtol:
                break
        return top

    @numba.njit
    def largest(mus, thetas, after, tolerance):
        peaks = np.zeros(len(mus))
        for row in range(len(mus)):
            mu, x, y, u, peak = mus[row], 0.0, 0.0, 0.0, 0.0
            for piece in range(2):
                f, end = (1.0, thetas[row]) if piece == 0 else (0.0, after)
                t, h = 0.0, min(0.05 * np.sqrt(mu), end)
                a, b = max(x, 0.0), max(y, 0.0)
                rates = (2.0 * f - a * np.sqrt(a) - u, u - b * np.sqrt(b))
                while t < end:
                    h = min(h, end - t)
                    new = step(x, y, u, h, f, mu, tolerance, 0.01 * tolerance)
                    factor = 0.9 * max(new[5], 1e-16) ** (-1.0 / 8.0)
                    if new[5] > 1.0:
                        h *= max(0.2, factor)
                        continue
                    for face in range(2):
                        if rates[face] > 0.0 and new[3 + face] < 0.0:
                            top = peak_in(x, y, u, h, f, mu, tolerance, 0.01 * tolerance, face)
                            peak = max(peak, top)
                    t += h
                    x, y, u, rates = new[0], new[1], new[2], (new[3], new[4])
                    peak = max(peak, x, y)
                    h *= min(10.0, factor)
            peaks[row] = peak
        return peaks

    return largest


def by_numba(largest: Callable[..., Array]) -> Callable[[Scene, float], Array]:
    """The compiled contender."""

    def solved(scene: Scene, tolerance: float) -> Array:
        scales = scene.scales
        return peak_pressure(
            scene, largest(scales.mass_number, scales.pulse_number, AFTER, tolerance)
        )

    return solved


def measured(rows: int) -> pd.DataFrame:
    """The table of `uqsphere bench`, with the compiled contender and the whole record."""
    scene = scattered_scene(rows)
    entries = compared("numba DOP853", by_numba(_compiled()), scene)
    study = load_study(shipped_studies()["granite"], ["model.whole_record=true"])
    whole = bench_study(study, rows=rows)
    whole = whole[whole["quantity"].isin(["p_max", "contact_duration"])]
    whole = whole.assign(case="granite, whole record")
    return pd.concat([pd.DataFrame(entries), bench(rows=rows), whole], ignore_index=True)


def as_table(frame: pd.DataFrame) -> str:
    """Microseconds a row (largest error) of every case and quantity, by tolerance."""
    tolerances = frame["tolerance"].unique()
    rows = []
    for (case, quantity), part in frame.groupby(["case", "quantity"], sort=False):
        cells = [
            f"{line.microseconds_per_row:,.3g} ({line.largest_error:.0e})"
            if line.microseconds_per_row < 1000.0
            else f"{line.microseconds_per_row:,.0f} ({line.largest_error:.0e})"
            for line in part.itertuples()
        ]
        rows.append([case, f"`{quantity}`", *cells])
    return table(["case", "quantity", *(f"{tolerance:g}" for tolerance in tolerances)], rows)


def main() -> None:
    asked = options(__doc__, rows=512)
    print(as_table(measured(asked.rows)))


if __name__ == "__main__":
    main()

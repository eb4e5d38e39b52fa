"""A compiled Taylor integrator of another house, heyoka, on scene A: the nearest rival.  No package of this project's:
install it beside.

    python -m tests.campaigns.compiled_rival

prints microseconds a row by tolerance, its own peaks found or left out.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from uqsphere.arrays import Array
from uqsphere.bench import AFTER, scattered_scene
from uqsphere.mechanics.integrator.solve import scaled_arguments
from uqsphere.mechanics.scene import Scene


@dataclass(frozen=True, kw_only=True)
class Compiled:
    """A compiled rival on scene A: its peaks (rows,), how to find them, and how to integrate without looking."""

    peaks: Array
    find_peaks: Callable[[], None]
    integrate_alone: Callable[[], None]


def _touched(mu: Array, start: float) -> Array:
    """State (3, n) at a small time, by the series about the touch: x1 = 2 s, u = (2/5) 2^(3/2) s^(5/2)/mu."""
    speed = 0.4 * 2.0**1.5 * start**2.5 / mu
    return np.stack([np.full(len(mu), 2.0 * start - 0.4 * 2.0**1.5 * start**2.5), speed * start / 3.5, speed])


def solve_heyoka(scene: Scene, rows: int, tolerance: float) -> Compiled:
    """Scene A by heyoka in batches as wide as the machine's vectors.

    The peaks come from its own event detection, the roots of the rates of both faces; its callbacks are Python,
    which is what a user of the package has.  The integration without them finds no peak: what the compiled code
    itself costs.
    """
    import heyoka

    x1, x2, u = heyoka.make_vars("x1", "x2", "u")
    push = 2.0 * heyoka.par[1]
    q1, q2 = x1 * heyoka.sqrt(x1), x2 * heyoka.sqrt(x2)
    rates = (push - q1 - u, u - q2)
    system = [(x1, rates[0]), (x2, rates[1]), (u, (q1 - q2) / heyoka.par[0])]
    batch = int(heyoka.recommended_simd_size())
    arguments = scaled_arguments(scene, np.arange(rows))
    start = 1e-4
    highest = np.zeros((2, batch))
    peaks = np.zeros(rows)

    def watch(face: int) -> Any:
        def seen(solver: Any, time: float, sign: int, lane: int) -> None:
            solver.update_d_output(np.full(batch, time))
            highest[face, lane] = max(highest[face, lane], solver.d_output[face, lane])

        return heyoka.nt_event_batch(rates[face], seen, direction=heyoka.event_direction.negative)

    def build(**events: Any) -> Any:
        return heyoka.taylor_adaptive_batch(
            system, np.ones((3, batch)), pars=np.ones((2, batch)), tol=tolerance, compact_mode=False, **events
        )

    def run(solver: Any) -> None:
        for first in range(0, rows, batch):
            chosen = np.minimum(np.arange(first, first + batch), rows - 1)
            mu, end = arguments["mass"][chosen], np.asarray(arguments["pulse_end"][chosen])
            solver.set_time(start)
            solver.state[:] = _touched(mu, start)
            solver.pars[0], solver.pars[1] = mu, 1.0
            highest[:] = 0.0
            solver.propagate_until(end)
            at_end = solver.state[:2].max(axis=0)
            solver.pars[1] = 0.0
            solver.propagate_until(end + AFTER)
            peaks[chosen] = np.maximum(at_end, highest.max(axis=0))

    alone, watching = build(), build(nt_events=[watch(0), watch(1)])
    run(watching)
    return Compiled(peaks=peaks.copy(), find_peaks=lambda: run(watching), integrate_alone=lambda: run(alone))


def main() -> None:
    """Print what a row costs."""
    for tolerance in (1e-3, 1e-6, 1e-9, 1e-12):
        rival = solve_heyoka(scattered_scene(64), 64, tolerance)
        for name, run in (("peaks", rival.find_peaks), ("no peaks", rival.integrate_alone)):
            begin = time.process_time()
            for _ in range(5):
                run()
            print(f"{tolerance:.0e} {name}: {(time.process_time() - begin) / 5 / 64 * 1e6:.1f} us a row")


if __name__ == "__main__":
    main()

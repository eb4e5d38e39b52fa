"""The paper's "numerical instability" (end of its section 4), reproduced: a step too long for a stiff oscillation.

The linear contact under a step pulse, theory (14), integrated by the classical Runge-Kutta method of order 4 with a
fixed step, as one would by hand.  The difference of the approaches swings with w = sqrt(2/mu - 1/4) per t_c; the
method is stable up to a step of about 2.8/w, whatever the accuracy that is wanted.

    python -m uqsphere.bench.instability docs/figures/instability.svg
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.closed_form import linear_approaches

if TYPE_CHECKING:
    from uqsphere.report.canvas import Picture

__all__ = ["fixed_steps", "instability_figure"]

Array = npt.NDArray[np.float64]
#: mass number of the example; a rig of 40 mm bars and a 20 mm sphere has about this
MU = 1e-3


def fixed_steps(mu: float, step: float, end: float) -> tuple[Array, Array]:
    """Times and approach at face A of the linear contact under a step pulse, by Runge-Kutta steps of one length.

    Ends early where the approach has grown beyond a hundred times its final value.
    """

    def slopes(y: Array) -> Array:
        return np.array([2.0 - y[0] - y[2], y[2] - y[1], (y[0] - y[1]) / mu])

    times, values, state = [0.0], [0.0], np.zeros(3)
    while times[-1] < end and abs(state[0]) < 100.0:
        first = slopes(state)
        second = slopes(state + 0.5 * step * first)
        third = slopes(state + 0.5 * step * second)
        state = state + step / 6.0 * (first + 2.0 * second + 2.0 * third + slopes(state + step * third))
        times.append(times[-1] + step)
        values.append(float(state[0]))
    return np.array(times), np.array(values)


def instability_figure() -> Picture:
    """Approach at face A over time: exact, and with steps below and above the limit of stability."""
    from uqsphere.report.canvas import BLUE, GREY, ORANGE, RED, Picture, new_figure

    figure, (panel,) = new_figure(3.4)
    s = np.linspace(0.0, 3.0, 3000)
    panel.plot(s, linear_approaches(s, MU)[0], color=GREY, linewidth=1.0, label="exact")
    swing = np.sqrt(2.0 / MU - 0.25)
    shown = ((0.02, BLUE, "-", "o"), (0.06, ORANGE, "--", "s"), (0.07, RED, "-.", "^"))
    for step, colour, line, mark in shown:
        times, values = fixed_steps(MU, step, 3.0)
        inside = np.abs(values) < 2.4
        panel.plot(times[inside], values[inside], color=colour, linestyle=line, marker=mark, markersize=3.0,
                   linewidth=1.0, label=f"step {step:g} t_c, w h = {swing * step:.1f}")  # fmt: skip
    panel.set_xlabel("time over t_c")
    panel.set_ylabel("approach at face A over alpha_c")
    panel.set_ylim(-0.4, 2.4)
    panel.legend(loc="lower right", ncols=2)
    return Picture(
        name="instability", title="The numerical instability of the paper's section 4", figure=figure,
        finding="A step of 0.07 t_c, ample for the rise of the force, runs away; 0.06 t_c does not, and 0.02 is right.",
    )  # fmt: skip


def main() -> None:
    """Write the figure to the file named."""
    from uqsphere.report.canvas import render, style

    with style():
        Path(sys.argv[1]).write_text(render(instability_figure()), encoding="utf-8")


if __name__ == "__main__":
    main()

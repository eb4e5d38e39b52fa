"""The paper's "numerical instability" (end of its section 4), reproduced: a step too long for a
stiff oscillation.

The linear contact under a step pulse, theory (14), integrated by the classical Runge-Kutta method
of order 4 with a fixed step, as one would by hand.  The difference of the approaches swings with w
= sqrt(2/mu - 1/4) per t_c; the method is stable up to a step of about 2.8/w, whatever the accuracy
that is wanted.

The paper says that the instability vanishes for lambda_1 = 0.  It does not: without the bars'
damping the limit is 2 sqrt(2)/w with w = sqrt(2/mu), a little less than before, and the
oscillation, which the bars would have damped, goes on for ever while both approaches grow without
bound.

    python -m docs.figures.instability docs/figures/instability.svg
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from docs.figures.linear_contact import linear_approaches

if TYPE_CHECKING:
    from docs.figures.canvas import Picture

Array = npt.NDArray[np.float64]
#: mass number of the example; a rig of 40 mm bars and a 20 mm sphere has about this
MU = 1e-3
#: length of the figure over t_c
_END = 1.5


def fixed_steps(mu: float, step: float, end: float, *, bars: bool = True) -> tuple[Array, Array]:
    """Times and difference of the approaches, linear contact, step pulse, by Runge-Kutta steps of
    one length.

    bars: False for lambda_1 = 0 in (2.9) of the paper, where no wave carries anything away.  Ends
    early where an approach has grown beyond a hundred times what it should come to.
    """

    def slopes(y: Array) -> Array:  # approaches, and their rates where the bars do not give them
        if bars:
            return np.array([2.0 - y[0] - y[2], y[2] - y[1], (y[0] - y[1]) / mu, 0.0])
        pull = (y[0] - y[1]) / mu
        return np.array([y[2], y[3], -pull, pull])

    state = np.zeros(4) if bars else np.array([0.0, 0.0, 2.0, 0.0])
    times, values = [0.0], [0.0]
    while times[-1] < end and np.abs(state).max() < 1e4:
        first = slopes(state)
        second = slopes(state + 0.5 * step * first)
        third = slopes(state + 0.5 * step * second)
        state = state + step / 6.0 * (
            first + 2.0 * second + 2.0 * third + slopes(state + step * third)
        )
        times.append(times[-1] + step)
        values.append(float(state[0] - state[1]))
    return np.array(times), np.array(values)


def exact_difference(mu: float, times: Array, *, bars: bool = True) -> Array:
    """Difference of the approaches that `fixed_steps` should find: theory (14), or 2 sin(w s)/w
    without the bars.
    """
    if bars:
        first, second = linear_approaches(times, mu)
        return np.asarray(first - second)
    swing = np.sqrt(2.0 / mu)
    return np.asarray(2.0 * np.sin(swing * times) / swing)


def instability_figure() -> Picture:
    """Difference of the approaches with steps below and above the limit, with the bars and for
    lambda_1 = 0.
    """
    from docs.figures.canvas import BLUE, GREY, ORANGE, RED, Picture, new_figure

    figure, panels = new_figure(5.6, rows=2, sharex=True)
    s = np.linspace(0.0, _END, 3000)
    shown = ((0.01, BLUE, "none", "o"), (0.06, ORANGE, "--", "s"), (0.07, RED, "-.", "^"))
    for panel, bars in zip(panels, (True, False), strict=True):
        panel.plot(s, exact_difference(MU, s, bars=bars), color=GREY, linewidth=1.0, label="exact")
        swing = np.sqrt(2.0 / MU - (0.25 if bars else 0.0))
        for step, colour, line, mark in shown:
            times, values = fixed_steps(MU, step, _END, bars=bars)
            shown_until = int(np.argmax(np.append(np.abs(values), np.inf) > 0.5)) + 1
            times, values = times[:shown_until], values[:shown_until]
            panel.plot(
                times,
                values,
                color=colour,
                linestyle=line,
                marker=mark,
                markersize=3.5,
                linewidth=1.0,
                label=f"step {step:g} t_c, w h = {swing * step:.2f}",
            )
        panel.set_ylim(-0.2, 0.3)
        panel.set_ylabel("(alpha_1 - alpha_2)/alpha_c")
        panel.set_title(
            "with the bars" if bars else "lambda_1 = 0: without the bars and their damping"
        )
    panels[0].legend(loc="upper right", ncols=2)
    panels[-1].set_xlabel("time over t_c")
    return Picture(
        name="instability",
        title="The numerical instability of the paper's section 4",
        figure=figure,
        finding="A step of 0.07 t_c, ample for the rise of the force, runs away with the bars and "
        "without them;"
        " 0.06 t_c does not, but is no better than no oscillation at all; 0.01 t_c follows it.",
    )


def main() -> None:
    """Write the figure to the file named."""
    from docs.figures.canvas import render, style

    with style():
        Path(sys.argv[1]).write_text(render(instability_figure()), encoding="utf-8")


if __name__ == "__main__":
    main()

"""What the paper's printed equations would give, beside the right ones, as the figure of the
errata.

python -m docs.figures.errata docs/figures/errata.svg
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from docs.figures.linear_contact import linear_approaches
from uqsphere.mechanics import as_printed
from uqsphere.mechanics.closed_form import massless_approach

if TYPE_CHECKING:
    from docs.figures.canvas import Picture

#: pulse length over t_c of the massless example, mass number of the linear one
THETA: Final = 0.8
MU: Final = 0.3


def errata_figure() -> Picture:
    """Approach by (3.9) and (3.16), by (4.9), and pressure by (5.8), as printed and corrected."""
    from docs.figures.canvas import BLUE, GREY, ORANGE, Picture, new_figure

    figure, panels = new_figure(8.4, rows=3)
    right: dict[str, Any]
    wrong: dict[str, Any]
    right, wrong = (
        {"color": BLUE, "label": "right"},
        {"color": ORANGE, "linestyle": "--", "label": "as printed"},
    )

    # t_c = 2 alpha_c/v0, so that with alpha_c = 1 and v0 = 2 times are over t_c; then beta/Z is 1
    s = np.linspace(0.0, 5.0, 600)
    panels[0].plot(s, massless_approach(s, THETA), **right)
    duration = as_printed.contact_duration(1.0, 2.0)
    panels[0].plot(s, as_printed.approach(s, 1.0, duration), **wrong)
    start = float(massless_approach(THETA, THETA))
    tail = s[s >= THETA]
    panels[0].plot(
        tail,
        as_printed.approach_after_pulse(tail - THETA, start, 1.0, 1.0),
        color=GREY,
        linestyle=":",
        label="tail (3.16) as printed",
    )
    panels[0].set_title(f"(3.9), (3.16): massless sphere, pulse of {THETA:g} t_c")
    panels[0].set_ylabel("alpha/alpha_c")
    panels[0].set_xlabel("time over t_c")

    # beta = Z = v0 = 1 in the paper's units: lambda_1 = 1, h = 1/2
    t = np.linspace(0.0, 6.0, 600)
    both, _ = linear_approaches(t, MU)
    panels[1].plot(t, 0.5 * both, **right)
    swing = np.sqrt(2.0 / MU - 0.25)
    settled = 0.5 * (1.0 - np.exp(-t))
    decaying = 0.5 * both - settled
    panels[1].plot(t, settled + decaying * np.exp(0.5 * t), **wrong)
    panels[1].plot(t, 2.0 * settled, color=GREY, linestyle=":", label="(4.10) as printed")
    panels[1].set_title(f"(4.9), (4.10): linear contact under a step, swing {swing:.2g}/t_c")
    panels[1].set_ylabel("alpha_1 lambda_1/v0")
    panels[1].set_xlabel("time times lambda_1")

    place = np.linspace(0.0, 1.0, 400)
    share = 0.5
    panels[2].plot(place, np.sqrt(np.clip(share - place**2, 0.0, None)), **right)
    panels[2].plot(place, share * np.sqrt(1.0 - place**2), **wrong)
    panels[2].set_title("(5.8): pressure when the approach is half of its largest")
    panels[2].set_ylabel("p/p_max")
    panels[2].set_xlabel("distance from the centre over the largest contact radius")
    for panel in panels:
        panel.legend(loc="best")
    return Picture(
        name="errata",
        title="Printed equations beside the right ones",
        figure=figure,
        finding="As printed the massless sphere is unloaded by a sine although it never loses "
        "contact, the tail falls"
        " twice as fast, the oscillation of a linear contact never dies, its plateau is twice as "
        "high, and"
        " the pressure keeps the largest contact radius and is too low in the centre.",
    )


def main() -> None:
    """Write the figure to the file named."""
    from docs.figures.canvas import render, style

    with style():
        Path(sys.argv[1]).write_text(render(errata_figure()), encoding="utf-8")


if __name__ == "__main__":
    main()

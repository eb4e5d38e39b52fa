"""The contact time of the granite study in the two numbers through which E, nu, radius and speed act.

Every dot is a row of the study, at its mass number mu and its length of the pulse over t_c.  The time of the first loss
of contact is smooth in them but for rows in which a face all but loses contact and comes off late.  These lie on a
comb, a tooth for every swing of the sphere between its contacts: no polynomial in the inputs follows it, a table in the
two numbers does (`uqsphere/runner/similarity.py`).

    python -m docs.figures.two_numbers docs/figures/two-numbers.svg
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.special import ndtri

import uqsphere
from uqsphere.model import scene_of
from uqsphere.report.figures.canvas import BLUE, RED, Picture, legend_above, new_figure, render, style
from uqsphere.uq.points import sobol_points

#: rows that are computed, and how many of those that are not late are drawn
ROWS, SHOWN = 1 << 16, 1000


def two_numbers_figure(rows: int = ROWS) -> tuple[Picture, str]:
    """The figure, and its numbers in a sentence: the share of late losses, the times on either side, the gaps."""
    study = uqsphere.load_study("studies/granite.toml")
    inputs = study.inputs()
    inputs = inputs.only(tuple(name for name in inputs.names if not name.startswith("limits.")))
    points = sobol_points(dimension=len(inputs.names), count=rows, seed=study.seed, task="two numbers", replicate=0)
    values = dict(zip(inputs.names, inputs.physical(ndtri(points)).T, strict=True))
    found = uqsphere.evaluate(study, values, quantities=("contact_time", "impulse_time", "first_gap"), tolerance=1e-6)
    lost, gaps = found["contact_time"].to_numpy(), found["first_gap"].to_numpy()
    scene = scene_of(study, values, rows)
    mass, length = scene.scales.mass_number, scene.pulse.breaks[:, -1] / scene.scales.time
    order = np.argsort(lost)
    tail = lost[order][int(0.99 * rows) :]
    at = int(np.argmax(np.diff(tail)))  # the emptiest stretch parts late losses from the others
    late = lost > tail[at]
    micro, share = 1e6 * tail, 1.0 - lost[~late].var() / lost.var()
    scatter = {name: 100.0 * float(found[name].std() / found[name].mean()) for name in ("contact_time", "impulse_time")}
    said = (
        f"{100.0 * late.mean():.2g} % of {rows:,} rows lose contact late, from {micro[at + 1]:,.0f} us after first "
        f"touch on, all others by {micro[at]:,.0f} us; the late ones carry {100.0 * share:.0f} % of the variance. "
        f"contact_time scatters by {scatter['contact_time']:.1f} %, impulse_time by {scatter['impulse_time']:.1f} %. "
        f"Of the first gaps {100.0 * (gaps < 1e-6).mean():.2g} % stay below 1 um; the median is "
        f"{1e6 * np.nanmedian(gaps):.0f} um."
    )
    shown = np.flatnonzero(~late)[:SHOWN]
    figure, (above, below) = new_figure(6.4, rows=2, sharex=True)
    for axes, vertical in ((above, 1e3 * mass), (below, 1e6 * lost)):
        axes.plot(length[shown], vertical[shown], ".", color=BLUE, markersize=1.5)
        axes.plot(length[late], vertical[late], ".", color=RED, markersize=3.0)
    above.set_ylabel("mass number mu [1e-3]")
    below.set_ylabel("contact_time [us]")
    below.set_xlabel("length of the pulse over t_c")
    handles = [above.plot([], [], "o", color=c, markersize=4, label=t)[0] for c, t in ((BLUE, "others"), (RED, "late"))]
    legend_above(above, 2, handles)
    return Picture(name="two-numbers", title="The contact time in its two numbers", finding=said, figure=figure), said


def main() -> None:
    """Write the figure to the file named, and print its numbers."""
    with style():
        picture, said = two_numbers_figure()
        Path(sys.argv[1]).write_text(render(picture), encoding="utf-8")
    print(said)


if __name__ == "__main__":
    main()

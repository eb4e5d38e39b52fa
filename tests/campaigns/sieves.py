"""Families of t_n against sieve curves of rocks: misfit as published, and with the exponent fitted to the other half.

    UQSPHERE_RECORDS=FOLDER python -m tests.campaigns.sieves --figure docs/figures/sieves.svg

reads rae_sieve.csv of that folder (A. S. P. Rae and others, cylinders broken between bars, 2020 and 2021,
github.com/ASprae/Dynamic-Strength-and-Fragmentation): a name, d [mm], t10 and shares finer than eight sieves.  t10 is
given; what is compared is every other t_n.  What was not recovered, up to 15 %, counts as finer than the finest sieve:
curves of which that is more than half of t10 are told apart, for no family can have such a floor.
"""

from __future__ import annotations

import csv
import os
import re
import sys
from pathlib import Path

import numpy as np

from tests.campaigns import options
from uqsphere.feed.product import Curve, fit_alpha
from uqsphere.report.figures.canvas import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Picture,
    legend_above,
    name_rows,
    new_figure,
    render,
    style,
)

ROCKS = {
    "SeeSst": "Seeberger sandstone", "TaQu": "Taunus quartzite", "SaLi": "Savonnières limestone",
    "CaMa": "Carrara marble", "Malsburg": "Malsburg granite", "Maggia Gneiss (Pa": "Maggia gneiss, along",
    "Maggia Gneiss (Pe": "Maggia gneiss, across",
}  # fmt: skip
PUBLISHED = {"trr, 0.8": Curve(alpha=0.8), "trr, 1": Curve(alpha=1.0), "milin": Curve(law="milin")}
FITTED = "trr, fitted to the other half"
#: a flat prior, so that the fitted exponent is that of the curves alone
FLAT = (0.0, 1e6)


def read(path: Path) -> dict[str, np.ndarray]:
    """Rows (d [m], t10, passing of every sieve) by rock, and the sieves [m] by the key ''."""
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    header, *rows = csv.reader(lines)
    sieves = [1e-3 * float(re.search(r"[\d.]+", name).group()) for name in header[3:]]  # type: ignore[union-attr]
    found: dict[str, list[list[float]]] = {}
    for row in rows:
        rock = next(name for key, name in ROCKS.items() if row[0].startswith(key))
        found.setdefault(rock, []).append([1e-3 * float(row[1]), *(float(cell) for cell in row[2:])])
    return {"": np.array(sieves), **{rock: np.array(some) for rock, some in found.items()}}


def misfit(curve: Curve, rows: np.ndarray, sieves: np.ndarray) -> float:
    """Root of the mean square of t_n over the sieves but those at n <= 1, in percentage points."""
    errors = [curve.passing(row[0] / sieves, row[1]) - row[2:] for row in rows]
    return 100.0 * float(np.sqrt(np.mean(np.square(errors))))


def compare(data: dict[str, np.ndarray]) -> list[tuple[str, int, dict[str, float], tuple[float, float]]]:
    """Of every rock its curves, the misfit of every family, and the exponents of both halves."""
    sieves, found = data[""], []
    for rock, rows in data.items():
        if not rock or len(rows) < 2:
            continue
        halves, errors, alphas = (rows[0::2], rows[1::2]), [], []
        for k, half in enumerate(halves):
            other = halves[1 - k]
            rng = np.random.default_rng(1)
            alpha, _, _ = fit_alpha(other[:, :1] / sieves, other[:, 1], other[:, 2:], 10, rng, FLAT)
            errors.append(misfit(Curve(alpha=alpha), half, sieves) ** 2 * len(half))
            alphas.append(alpha)
        misfits = {name: misfit(curve, rows, sieves) for name, curve in PUBLISHED.items()}
        misfits[FITTED] = float(np.sqrt(sum(errors) / len(rows)))
        found.append((rock, len(rows), misfits, (alphas[0], alphas[1])))
    return found


def without_floor(data: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The curves whose finest sieve has at most half of t10."""
    kept = {rock: rows[rows[:, -1] <= 0.5 * rows[:, 1]] for rock, rows in data.items() if rock}
    return {"": data[""], **kept}


def table(found: list[tuple[str, int, dict[str, float], tuple[float, float]]]) -> str:
    names = [*PUBLISHED, FITTED]
    lines = [f"| rock | curves | {' | '.join(names)} | exponents |", "|---|---|" + "---|" * (len(names) + 1)]
    for rock, count, misfits, alphas in found:
        cells = " | ".join(f"{misfits[name]:.0f}" for name in names)
        lines.append(f"| {rock} | {count} | {cells} | {alphas[0]:.2f}, {alphas[1]:.2f} |")
    return "\n".join(lines)


def picture(found: list[tuple[str, int, dict[str, float], tuple[float, float]]]) -> Picture:
    """Misfits by rock."""
    with style():
        figure, (axes,) = new_figure(1.2 + 0.42 * len(found))
        for name, mark, colour in zip([*PUBLISHED, FITTED], "os^D", (BLUE, GREY, ORANGE, RED), strict=True):
            values = [misfits[name] for _, _, misfits, _ in found]
            axes.plot(values, range(len(found)), mark, color=colour, label=name, linestyle="none")
        name_rows(axes, [rock for rock, *_ in found])
        axes.set_xlim(0.0, None)
        axes.set_xlabel("root mean square of t_n beside its curve [percentage points]")
        axes.grid(True, axis="x")
        legend_above(axes, 4)
    finding = "No published family holds for every rock; the exponent fitted to other curves of the rock comes nearest."
    return Picture(
        name="sieves", title="Families of t_n against sieve curves of six rocks", finding=finding, figure=figure
    )


def main(arguments: list[str]) -> None:
    chosen = options(__doc__, arguments, figure=Path)
    data = read(Path(os.environ["UQSPHERE_RECORDS"]) / "rae_sieve.csv")
    found, kept = compare(data), compare(without_floor(data))
    print(table(found), "\nwithout curves that have a floor:\n", table(kept), sep="\n")
    if chosen.figure is not None:
        chosen.figure.write_text(render(picture(kept)), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])

"""Granite and limestone between bars by Hertz, with yield at the end of the motion, and with yield inside it.

    python -m docs.figures.contact_laws docs/figures/contact_laws.svg

prints the tables of docs/theory.md and draws the figure: the shipped studies at 512 points of their laws and eight
speeds, which stand in every row.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.arrays import Array
from uqsphere.model import scene_of, solve_scene
from uqsphere.runner.evaluate import draw
from uqsphere.study import load_study
from uqsphere.uq.law import Law

if TYPE_CHECKING:
    from uqsphere.report.figures.canvas import Picture
    from uqsphere.study import Study

STUDIES: Final = Path(__file__).parents[2] / "studies"
#: name -> study, what is set in it, its speed [m/s], and the probability whose speed is asked for
CASES: Final = {
    "granite, maraging 1900 MPa": ("granite", (), 0.66, 0.01),
    "granite, 4340 steel 834 MPa": ("granite", ("bars.material=steel",), 0.5, 0.01),
    "limestone, 4340 steel, pole crushes": ("limestone_ball_slow", (), 0.6, 0.5),
}
#: law -> contact law, where it is solved
LAWS: Final = {"hertz": ("hertz", "path"), "stage 1": ("plastic", "elastic"), "stage 2": ("plastic", "path")}
ROWS: Final = 512
#: demands whose error is told row by row
DEMANDS: Final = ("p_max", "p_hertz", "core_tension", "specific_energy", "specific_energy_sphere")
PLASTIC: Final = ("contact.law=plastic", "limits.crushing.strength_is=pressure")


def sample_of(study: Study) -> tuple[dict[str, Array], Array]:
    """Inputs of the rows but the speed, and what they tell of the normal score of the strength."""
    names = [name for name in study.random if name != "striker.speed"]
    inputs = study.inputs()
    joint = inputs.only(names)
    points = draw(joint, seed=study.seed, task="laws", start=0, count=ROWS, replicates=1)
    weights, _ = inputs.regression(f"limits.{study.limits[0].name}.strength", names)
    shift = joint.scores(points.scores.reshape(ROWS, len(names))) @ weights
    return {name: points.input(name)[0] for name in names}, shift


def answers(study: Study, law: str, speed: float, further: tuple[str, ...] = ()) -> tuple[dict[str, Array], float]:
    """p_max, p_hertz, P_max and dent of the rows at a speed, what else is asked for, and the time of a row [s]."""
    columns = sample_of(study)[0] | {"striker.speed": np.full(ROWS, speed)}
    contact, dynamics = LAWS[law]
    scene = replace(scene_of(study, columns, ROWS), contact_law=contact, contact_dynamics=dynamics)
    asked = (*dict.fromkeys(("p_max", "p_hertz", "P_max", *further)), *(("dent",) if contact == "plastic" else ()))
    begin = time.perf_counter()
    found = solve_scene(scene, "full", tolerance=1e-6, threads=1, quantities=asked)
    return {name: found.values[name] for name in asked}, (time.perf_counter() - begin) / ROWS


def probability(study: Study, pressures: Array) -> float:
    """That the pressure exceeds the strength of the study's limit, given what the inputs tell of it."""
    from scipy.special import ndtr, ndtri

    limit = study.limits[0]
    assert isinstance(limit.strength, Law)
    columns, shift = sample_of(study)
    _, remaining = study.inputs().regression(f"limits.{limit.name}.strength", list(columns))
    return float(np.mean(ndtr((ndtri(limit.strength.cdf(pressures)) - shift) / remaining)))


def speed_at(study: Study, law: str, quantity: str, wanted: float, speeds: Array) -> float:
    """Speed at which the probability is `wanted`, by straight lines in the logarithms; NaN where there is none."""
    found = np.array([max(probability(study, answers(study, law, v)[0][quantity]), 1e-300) for v in speeds])
    if not found.min() < wanted < found.max():
        return float("nan")
    return float(np.exp(np.interp(np.log(wanted), np.log(found), np.log(speeds))))


def rows() -> list[tuple[str, ...]]:
    """The table: case, law, p_max, P_max, dent, probabilities by either pressure, speeds, time of a row."""
    table = []
    for name, (file, settings, speed, wanted) in CASES.items():
        study = load_study(STUDIES / f"{file}.toml", (*settings, *PLASTIC))
        speeds = speed * np.geomspace(0.4, 4.0, 8)
        for law in LAWS:
            answers(study, law, speed)  # loads what is compiled
            found, cost = answers(study, law, speed)
            told = [probability(study, found[key]) for key in ("p_hertz", "p_max")]
            at = [speed_at(study, law, key, wanted, speeds) for key in ("p_hertz", "p_max")]
            dent = 1e6 * float(found["dent"].mean()) if "dent" in found else 0.0
            table.append((
                f"{name}, {speed:g} m/s", law, f"{found['p_max'].mean() / 1e9:.3f}", f"{found['P_max'].mean():.0f}",
                f"{dent:.2f}", f"{told[0]:.3g}", f"{told[1]:.2g}",
                *("none" if np.isnan(v) else f"{v:.3f}" for v in at), f"{1e6 * cost:.0f}",
            ))  # fmt: skip
    return table


def errors() -> list[tuple[str, ...]]:
    """The table of errors: case, law, and of every demand its median, least and largest error beside the path [%]."""
    table = []
    for name, (file, settings, speed, _) in CASES.items():
        study = load_study(STUDIES / f"{file}.toml", (*settings, *PLASTIC))
        found = {law: answers(study, law, speed, DEMANDS)[0] for law in LAWS}
        for law in list(LAWS)[:2]:
            ratios = [100.0 * (found[law][key] / found["stage 2"][key] - 1.0) + 0.0 for key in DEMANDS]
            told = (f"{np.median(r):+.1f} ({r.min():+.1f} to {r.max():+.1f})" for r in ratios)
            table.append((f"{name}, {speed:g} m/s", law, *told))
    return table


def laws_figure() -> Picture:
    """Mean pressures over the speed, by the three laws: granite between 834 MPa bars, limestone whose poles crush."""
    from uqsphere.report.figures.canvas import BLUE, GREY, ORANGE, RED, Picture, new_figure

    cases = {
        "granite, 4340 steel 834 MPa": "granite, bars of 834 MPa yield",
        "limestone, 4340 steel, pole crushes": "limestone, its poles crush",
    }
    speeds = np.geomspace(0.02, 3.0, 12)
    figure, panels = new_figure(5.6, rows=2, sharex=True)
    shown = (
        ("hertz", "p_max", GREY, "-", "Hertz"),
        ("stage 2", "p_hertz", BLUE, "--", "what the force is by Hertz, bars yield"),
        ("stage 2", "p_max", RED, "-", "true pressure, yield inside the motion"),
        ("stage 1", "p_max", ORANGE, ":", "true pressure, yield at the end"),
    )
    for panel, (case, title) in zip(panels, cases.items(), strict=True):
        file, settings, _, _ = CASES[case]
        study = load_study(STUDIES / f"{file}.toml", (*settings, *PLASTIC))
        for law, key, colour, line, label in shown:
            means = [answers(study, law, v)[0][key].mean() / 1e9 for v in speeds]
            panel.plot(speeds, means, color=colour, linestyle=line, label=label)
        panel.set_xscale("log")
        panel.set_xticks([0.02, 0.1, 0.5, 2.0], ["0.02", "0.1", "0.5", "2"])
        panel.set_xticks([], minor=True)
        panel.set_ylabel("mean of p_max [GPa]")
        panel.set_title(title)
    panels[-1].set_xlabel("speed of the striker [m/s]")
    panels[0].legend(loc="upper left")
    return Picture(
        name="contact_laws", title="Granite of 20 mm and limestone of 16 mm between steel bars", figure=figure,
        finding="The force hardly moves where a face yields; the true pressure stays below its hardness.",
    )  # fmt: skip


def main() -> None:
    """Print the table and write the figure to the file named."""
    from uqsphere.report.figures.canvas import render, style

    print("| case | law | p_max GPa | P_max N | dent um | P_f by p_hertz | P_f by p_max | speed by p_hertz m/s | "
          "speed by p_max m/s | us a row |\n|---|---|---|---|---|---|---|---|---|---|")  # fmt: skip
    for row in rows():
        print("| " + " | ".join(row) + " |")
    print(f"\n| case | law | {' | '.join(DEMANDS)} |\n|{'---|' * (2 + len(DEMANDS))}")
    for row in errors():
        print("| " + " | ".join(row) + " |")
    with style():
        Path(sys.argv[1]).write_text(render(laws_figure()), encoding="utf-8")


if __name__ == "__main__":
    main()

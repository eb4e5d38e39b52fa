"""The laboratory sheet of a test: one HTML page, and the forces and the pulse as CSV."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.labs.files import JsonObject, csv_text
from uqsphere.uq import LEVEL_TEXT

from .document import RecordDocument
from .peaks import NORMAL
from .waves import Reading

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FACES = {
    "A": "largest force at A, two waves",
    "B": "largest force at B, one wave",
    "mean": "mean of both, three waves",
}
_DRAWN = {"A": ("A, two waves", "#0072b2"), "B": ("B, one wave", "#d55e00")}


def rows(test: Reading) -> list[tuple[str, str, str]]:
    """Name, value, and interval or remark of every number; doubts stand below their number."""
    lines = []
    for face, peak in test.peaks.items():
        high = "not known"
        if math.isfinite(peak.high):
            high = f"{peak.high * 1e-3:.4g}"
        value = f"{peak.value * 1e-3:.4g} kN"
        if peak.doubts:
            value = f"DOUBTED {value}"
        ends = f"{peak.low * 1e-3:.4g} to {high} kN"
        lines.append((f"{FACES[face]}, at {peak.time * 1e6:.4g} us", value, ends))
        lines += [("", "doubt", doubt) for doubt in peak.doubts]
    lines += [("not given", "", reason) for reason in test.withheld]
    lines += [("note", "", note) for note in test.notes]
    if test.energies:
        waves = {name: f"{energy:.4g} J" for name, energy in test.energies.items()}
        absorbed = waves.pop("absorbed")
        text = ", ".join(f"{energy} {name}" for name, energy in waves.items())
        lines.append(("energy absorbed", absorbed, text))
    if test.balanced is not None:
        part = "of the rise from half the largest force"
        lines.append(("forces within 5 % of their mean", f"{test.balanced:.0%}", part))
    lines.append(("loading rate", f"{test.loading_rate * 1e-9:.4g} kN/us", ""))
    lines.append(("first touch", f"{test.touch * 1e6:.1f} us", "in the record"))
    return lines


def document(test: Reading) -> JsonObject:
    """A test as plain JSON, SI."""
    forces = {
        face: {**peak._asdict(), "sound": not peak.doubts} for face, peak in test.peaks.items()
    }
    for force in forces.values():
        if math.isinf(force["high"]):
            force["high"] = None
    return {
        "forces": forces,
        "energy": test.energies,
        "withheld": test.withheld,
        "notes": test.notes,
        "balanced_share": test.balanced,
        "loading_rate": test.loading_rate,
        "first_touch": test.touch,
        "step": test.step,
        "mending": [change._asdict() for change in test.changes],
    }


def written(test: Reading, asked: RecordDocument) -> dict[str, str]:
    """The files of a test: forces with the ends of their 95 % intervals, the incident pulse as a
    study takes it, compression positive from rest to rest, and the sheet as one self-contained
    page.
    """
    from jinja2 import Environment

    from uqsphere.report.figures import svg

    forces = {"time [us]": test.forces["B"].time * 1e6}
    for face, course in test.forces.items():
        half = NORMAL * course.sd
        forces[f"{face} [kN]"] = course.force * 1e-3
        forces[f"{face} low [kN]"] = (course.force - half) * 1e-3
        forces[f"{face} high [kN]"] = (course.force + half) * 1e-3
    pulse = {
        "time [us]": test.step * np.arange(len(test.pulse)) * 1e6,
        "strain [microstrain]": test.pulse * 1e6,
    }
    bars = {}
    for name, bar in (("incident bar", asked.incident_bar), ("receiving bar", asked.receiving_bar)):
        values = bar.model_dump(exclude_none=True)
        for key, value in values.items():
            if isinstance(value, float):
                values[key] = f"{value:.5g}"
        bars[name] = ", ".join(f"{key} {value}" for key, value in values.items() if value != "")
    template = Path(__file__).with_name("sheet.html").read_text("utf-8")
    page = Environment(autoescape=True).from_string(template)
    sheet = page.render(
        test=test,
        asked=asked,
        rows=rows(test),
        figure=svg(_draw_forces, test),
        bars=bars,
        level=LEVEL_TEXT,
        doubted=any(peak.doubts for peak in test.peaks.values()),
    )
    return {"forces.csv": csv_text(forces), "pulse.csv": csv_text(pulse), "sheet.html": sheet}


def _draw_forces(axes: "Axes", test: Reading) -> None:
    for face, course in test.forces.items():
        part = course.part(slice(None, None, max(1, len(course.force) // 2000)))
        name, colour = _DRAWN[face]
        t = part.time * 1e6
        f = part.force * 1e-3
        half = NORMAL * part.sd * 1e-3
        axes.fill_between(t, f - half, f + half, color=colour, alpha=0.2, linewidth=0)
        axes.plot(t, f, color=colour, linewidth=1.0, label=name)
    for peak in test.peaks.values():
        axes.axvline(peak.time * 1e6, color="#888888", linewidth=0.5, linestyle=":")
    axes.set_xlabel("time after first touch [us]")
    axes.set_ylabel("force [kN]")
    axes.legend()

"""The model beside published measurements: predicted over measured, with both uncertainties; nothing is fitted.

`measured.csv` has what was published, what was seen of each source, and the inputs.  Every row is shown; one whose
inputs were not published, or for which there is no model, says so in place of a number.  Real records are read from
the folder that ``UQSPHERE_RECORDS`` names, with what their authors published.
"""

from __future__ import annotations

import csv
import math
import os
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.console import table
from uqsphere.materials import library
from uqsphere.mechanics.bars import phase_speed
from uqsphere.store import csv_text, write_atomically
from uqsphere.uq.estimate import NORMAL

if TYPE_CHECKING:
    from uqsphere.report.figures.canvas import Picture

#: standard deviations of inputs that their sources give without one, relative: moduli, yield strengths (judgement)
_MODULUS_SD, _YIELD_SD = 0.02, 0.05
#: standard deviation of a Poisson's ratio of steel or titanium that was not published (0.28 to 0.34)
_NU_SD: Final = 0.015
#: bars of the laboratory whose records are read: E [Pa], density [kg/m³], nu, diameter [m]; gauges [m]
_TITANIUM: Final = {"bars.E": 110e9, "bars.density": 4430.0, "bars.nu": 0.33, "bars.diameter": 0.05}
_GAUGES, _LENGTH = (1.25, 1.0), 2.5

#: a row of measured.csv by the names of its columns
Row = Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Compared:
    """One published number and what is computed for it, both with a standard deviation in its unit; `why` there is no
    prediction where it is NaN."""

    name: str
    group: str
    quantity: str
    unit: str
    measured: float
    measured_sd: float
    predicted: float
    predicted_sd: float
    source: str
    seen: str
    why: str = ""

    @property
    def ratio(self) -> float:
        """Predicted over measured."""
        return self.predicted / self.measured

    @property
    def ratio_sd(self) -> float:
        """Standard deviation of the ratio, from both."""
        return abs(self.ratio) * math.hypot(self.predicted_sd / self.predicted, self.measured_sd / self.measured)


_BLOW: Final = """
title = "measured"
seed = 1
[sphere]
E = "{E1_GPa} GPa"
nu = {nu1}
density = "{density1} kg/m3"
radius = "{radius1_mm} mm"
[rig]
kind = "{rig}"
speed = "{speed_m_s} m/s"
[{body}]
{kind}E = "{E2_GPa} GPa"
nu = {nu2}
density = "{density2} kg/m3"
{more}
[contact]
law = "{law}"
[analysis]
quantities = ["restitution", "contact_time"]
"""


def _blow(row: Row, quantity: str, varied: Mapping[str, float]) -> tuple[float, float]:
    """A quantity of a sphere that strikes a block or its like, and what scatter in E and yield strength makes of it."""
    from uqsphere.model import evaluate
    from uqsphere.study import load_study

    alike = "two" in row["bodies"]
    body, law = ("other" if alike else "target"), ("plastic" if row["yield2_MPa"] else "hertz")
    more = f'radius = "{row["radius1_mm"]} mm"' if alike else (
        f'yield_strength = "{row["yield2_MPa"]} MPa"' if row["yield2_MPa"] else "")  # fmt: skip
    text = _BLOW.format(**row, body=body, law=law, more=more, kind="" if alike else 'kind = "thick"\n',
                        rig="sphere_on_sphere" if alike else "impact")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.toml"
        path.write_text(text, encoding="utf-8")
        study = load_study(path)
    means = study.at_means()
    names = {f"{body}.E": varied["E"], **({"target.yield_strength": varied["yield"]} if law == "plastic" else {})}
    names = {name: share for name, share in names.items() if name in means}
    values = {name: np.full(1 + len(names), means[name]) for name in names}
    for k, (name, share) in enumerate(names.items(), start=1):
        values[name][k] *= 1.0 + share
    found = np.asarray(evaluate(study, values, (quantity,))[quantity], dtype=float)
    return float(found[0]), float(np.sqrt(np.square(found[1:] - found[0]).sum()))


def _struck(row: Row, quantity: str, scale: float = 1.0) -> tuple[float, float]:
    shares = {"E": float(row["E2_sd_GPa"]) / float(row["E2_GPa"]) if row["E2_sd_GPa"] else _MODULUS_SD,
              "yield": _YIELD_SD}  # fmt: skip
    value, sd = _blow(row, quantity, shares)
    return scale * value, scale * sd


def _wave_speed(row: Row, rows: Sequence[Row]) -> tuple[float, float]:
    """c0 = sqrt(E/rho) of the handbook."""
    speed = math.sqrt(1e9 * float(row["E1_GPa"]) / float(row["density1"]))
    return speed, 0.5 * _MODULUS_SD * speed


def _dispersion(row: Row, rows: Sequence[Row]) -> tuple[float, float]:
    """Phase speed of the first mode over c0; the spread of a ratio nu that was not published."""
    nu, wave = float(row["nu1"]), [math.pi * float(row["diameter_over_wavelength"])]
    value = float(phase_speed(wave, nu)[0])
    return value, abs(float(phase_speed(wave, nu + _NU_SD)[0]) - value) if "not said" in row["bodies"] else 0.0


def _slow_strength(row: Row, rows: Sequence[Row]) -> tuple[float, float]:
    """A dynamic strength by the slow ones of the same rock, as they are: what a study without rate_0 does."""
    rock = row["bodies"].partition(" cylinder")[0]
    slow = [float(one["value"]) for one in rows if one["group"] == "slow strength" and one["bodies"].startswith(rock)]
    return float(np.mean(slow)), float(np.std(slow, ddof=1))


def _crushing_load(row: Row, rows: Sequence[Row]) -> tuple[float, float]:
    """The load of the ball of 10 mm carried to another size at a fixed Hertz pressure, with the square of the size."""
    known = next(float(one["value"]) for one in rows if one["id"] == "TB_10")
    return known * (float(row["radius1_mm"]) / 5.0) ** 2, 0.0


def _fracture_energy(row: Row, rows: Sequence[Row]) -> tuple[float, float]:
    """The median that the library has for a single particle of the rock [J/kg]."""
    known = library()["sphere"][row["bodies"].partition(" ")[0]].properties["fracture_energy"]
    size = 2e-3 * float(row["radius1_mm"])
    value = known.value * (1.0 + (known.further["size"] / size) ** known.further["exponent"])
    low, high = known.range or (known.value, known.value)
    return value, value * (high - low) / (2.0 * NORMAL * known.value)


#: group -> what predicts it: value and standard deviation in the unit of the row
_MODELS: Final[dict[str, Callable[[Row, Sequence[Row]], tuple[float, float]]]] = {
    "restitution": lambda row, rows: _struck(row, "restitution"),
    "contact time": lambda row, rows: _struck(row, "contact_time", 1e6),
    "wave speed": _wave_speed,
    "dispersion": _dispersion,
    "dynamic strength": _slow_strength,
    "crushing load": _crushing_load,
    "fracture energy": _fracture_energy,
    # load over radius at a fixed Hertz pressure: P = pi³ p³ R²/(6 E*²)
    "exponent": lambda row, rows: (2.0, 0.0),
}
#: why a group has no prediction
_WITHOUT: Final = {
    "slow strength": "goes into the dynamic ones",
    "": "its inputs (size, speed or material) were not published, or there is no model of it",
}


def compare() -> list[Compared]:
    """Every published number beside its prediction, real records last where their folder is known."""
    text = resources.files("uqsphere.bench").joinpath("measured.csv").read_text(encoding="utf-8")
    rows = list(csv.DictReader(text.splitlines()))
    found = []
    for row in rows:
        value, sd = math.nan, math.nan
        if row["group"] in _MODELS:
            value, sd = _MODELS[row["group"]](row, rows)
        known = row["value"].replace(".", "", 1).isdecimal()
        found.append(Compared(
            name=row["id"], group=row["group"] or "not computed", quantity=row["quantity"], unit=row["unit"],
            measured=float(row["value"]) if known else math.nan, measured_sd=float(row["sd"] or 0.0),
            predicted=value, predicted_sd=sd, source=row["source"], seen=row["seen"],
            why="" if math.isfinite(value) else _WITHOUT[row["group"]],
        ))  # fmt: skip
    folder = os.environ.get("UQSPHERE_RECORDS")
    return found + (_records(Path(folder)) if folder else [])


def _records(folder: Path) -> list[Compared]:
    """Largest force and absorbed energy of real records beside what their authors published."""
    from uqsphere.records.inverse import Rig
    from uqsphere.records.laboratory import read_test
    from uqsphere.records.pulse import Bar
    from uqsphere.records.record import Wiring, make_record, mend
    from uqsphere.records.table import read_table

    speed = math.sqrt(_TITANIUM["bars.E"] / _TITANIUM["bars.density"])
    rig = Rig(bar=Bar(radius=0.5 * _TITANIUM["bars.diameter"], wave_speed=speed, nu=_TITANIUM["bars.nu"]),
              incident_gauge=_GAUGES[0], receiving_gauge=_GAUGES[1], incident_length=_LENGTH,
              receiving_length=_LENGTH, correct_dispersion=True)  # fmt: skip
    volts = Wiring(gauge_factor=1.99, excitation=5.0, amplification=400.0)
    found = []
    with open(folder / "published.csv", encoding="utf-8", newline="") as stream:
        for row in csv.DictReader(stream):
            record = mend(make_record(read_table(folder / row["record"]), 2, wiring=volts))
            read = read_test(record, rig, _TITANIUM, sphere=False)
            assert read.energies is not None
            force, energy = read.peaks["B"], read.energies[1]
            share = float(row["strength_sd_MPa"]) / float(row["strength_MPa"])
            asked = float(row["peak_force_kN_strength_times_area"]), float(row["absorbed_energy_J"])
            name = row["record"].partition("_Ti")[0]
            # energies go with the square of strains, whose gains are known to 1 %
            doubt = 0.02 * (energy.incident + energy.reflected + energy.transmitted) / math.sqrt(3.0)
            for what, unit, value, sd, published, published_sd in (
                ("force", "kN", force.value * 1e-3, (force.high - force.low) / 3.92e3, asked[0],
                 share * asked[0]),
                ("energy", "J", energy.absorbed, doubt, asked[1], 0.0),
            ):  # fmt: skip
                found.append(Compared(
                    name=name, group=f"record: {what}", quantity=what, unit=unit, measured=published,
                    measured_sd=published_sd, predicted=value, predicted_sd=sd,
                    source="Rae and others 2020/2021, github.com/ASprae/Dynamic-Strength-and-Fragmentation",
                    seen="raw record and published table",
                ))  # fmt: skip
    return found


def summary(found: Sequence[Compared]) -> list[tuple[str, ...]]:
    """Rows by group: points, sources, mean of the ratio and its scatter, its ends, share within both uncertainties."""
    rows: list[tuple[str, ...]] = []
    for group in dict.fromkeys(one.group for one in found):
        points = [one for one in found if one.group == group]
        ratios = np.array([one.ratio for one in points])
        if not np.isfinite(ratios).any():
            rows.append((group, str(len(points)), "", "", points[0].why))
            continue
        within = [abs(one.ratio - 1.0) < NORMAL * one.ratio_sd for one in points if one.ratio_sd > 0.0]
        share = f"{np.mean(within):.0%}" if within else "none given"
        rows.append((group, str(len(points)), f"{ratios.mean():.3f} ± {ratios.std():.3f}",
                     f"{ratios.min():.3f} to {ratios.max():.3f}", share))  # fmt: skip
    return rows


def measured_figure(found: Sequence[Compared]) -> Picture:
    """Predicted against measured over logarithmic axes, with 95 % intervals, each group over its own largest."""
    from uqsphere.report.figures import canvas

    figure, (axes,) = canvas.new_figure(4.6)
    axes.axline((1.0, 1.0), (2.0, 2.0), color=canvas.INK, linewidth=0.8)
    groups = list(dict.fromkeys(one.group for one in found if math.isfinite(one.ratio)))
    colours = (canvas.BLUE, canvas.ORANGE, canvas.GREEN, canvas.RED, canvas.PURPLE, canvas.GREY, canvas.INK)
    for k, group in enumerate(groups):
        colour, mark = colours[k % len(colours)], canvas.MARKS[(k + k // len(colours)) % len(canvas.MARKS)]
        points = [one for one in found if one.group == group]
        unit = max(one.measured for one in points)
        x = np.array([one.measured for one in points]) / unit
        y = np.array([one.predicted for one in points]) / unit
        wide = np.array([[NORMAL * one.measured_sd, NORMAL * one.predicted_sd] for one in points]).T / unit
        wide = np.minimum(wide, 0.9 * np.stack([x, y]))
        axes.errorbar(x, y, xerr=wide[0], yerr=wide[1], color=colour, marker=mark, markersize=4.0, linestyle="none",
                      linewidth=0.7, label=group)  # fmt: skip
    axes.set_xscale("log")
    axes.set_yscale("log")
    ticks = [0.02, 0.05, 0.1, 0.2, 0.5, 1.0]
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    canvas.frame(axes, x="measured, over the largest of its group", y="predicted, over the same", grid=True, legend=3)
    count = sum(math.isfinite(one.ratio) for one in found)
    finding = f"{count} published numbers beside what is computed for them; nothing was fitted."
    return canvas.Picture(name="measured", title="Predicted against measured", figure=figure, finding=finding)


def run_measured(folder: Path) -> dict[str, object]:
    """Write measured.csv and measured.svg, and say what they show."""
    from uqsphere.report.figures.canvas import render, style

    found = compare()
    head = ["name", "group", "quantity", "unit", "measured", "measured_sd", "predicted", "predicted_sd", "ratio",
            "ratio_sd", "why", "source", "seen"]  # fmt: skip
    lines = [["" if isinstance(value, float) and math.isnan(value) else value for value in
              (getattr(one, name) for name in head)] for one in found]  # fmt: skip
    with style():
        figure = render(measured_figure(found))
    write_atomically(folder / "measured.csv", csv_text(head, lines))
    write_atomically(folder / "measured.svg", figure)
    rows = summary(found)
    header = ("group", "points", "predicted over measured", "from, to", "within both 95 %")
    return {"text": table(header, rows), "groups": [dict(zip(header, row, strict=True)) for row in rows]}

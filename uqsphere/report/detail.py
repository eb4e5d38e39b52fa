"""The files of one scene over time: its course as a table and as pictures."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from uqsphere.mechanics.history import view_field
from uqsphere.mechanics.stress.tables import outside
from uqsphere.quantities import reading_units, unit_that_reads
from uqsphere.report import bar_figures, canvas
from uqsphere.report.field_figure import draw_field, field_rows
from uqsphere.report.stress_figure import stress_figure
from uqsphere.report.timelines import history_figure, xt_figure
from uqsphere.store import csv_text, write_atomically
from uqsphere.study import Study

if TYPE_CHECKING:
    from uqsphere.mechanics.history import History

__all__ = ["units_of_history", "write_history"]

#: columns of history.csv and the fields of History they come from
_COLUMNS = {
    "time [s]": "time",
    "force_a [N]": "force_a",
    "force_b [N]": "force_b",
    "pressure_a [Pa]": "pressure_a",
    "pressure_b [Pa]": "pressure_b",
    "approach_a [m]": "approach_a",
    "approach_b [m]": "approach_b",
    "sphere_velocity [m/s]": "velocity",
    "incident_wave [m/s]": "incident",
    "returning_wave [m/s]": "returning",
    "wave_leaving_a [m/s]": "leaving_a",
    "wave_leaving_b [m/s]": "leaving_b",
}


def write_history(found: History, study: Study, folder: Path) -> list[Path]:
    """Table and pictures of a history in `folder`; the paths.

    history.csv, history.svg, xt.svg; field.csv, field.svg; forces.svg and, where the gauges allow it, bar_forces.csv;
    gauges.csv, gauges.svg where there are gauges; stress.svg within the range of its tables.
    """
    with reading_units(units_of_history(found)):
        return _write(found, study, folder)


def units_of_history(found: History) -> dict[str, str]:
    """The units in which forces, pressures and the tension in the core of one scene read well."""
    pressure = found.hardest_contact[1]
    peaks = [peak.force for peak in (found.first_peak, found.later_peak) if peak is not None]
    return {
        "P_max": unit_that_reads("P_max", peaks),
        "p_max": unit_that_reads("p_max", [pressure]),
        # of some twentieth of the pressure
        "core_tension": unit_that_reads("core_tension", [0.05 * pressure]),
    }


def _write(found: History, study: Study, folder: Path) -> list[Path]:
    scene = found.motion.scene
    columns = [getattr(found, field) for field in _COLUMNS.values()]
    rows = np.stack(columns, axis=1).tolist()
    contents = {
        "history.csv": csv_text(list(_COLUMNS), rows),
        "history.svg": history_figure(found),
        "xt.svg": xt_figure(scene, found),
    }
    contents |= _bars(found)
    ratio, pressure = found.hardest_contact
    nu = float(scene.columns["sphere.nu"][found.motion.row])
    if not outside(ratio, nu):
        contents["stress.svg"] = stress_figure(ratio, nu, pressure)
    for name, text in contents.items():
        write_atomically(folder / name, text)
    return [folder / name for name in contents]


def _bars(found: History) -> dict[str, str]:
    """What the bars see, by file name."""
    contents = {"field.csv": csv_text(*field_rows(found))}
    pictures = [draw_field(view_field(found)), bar_figures.draw_forces(found)]
    if found.gauges:
        contents["gauges.csv"] = csv_text(*bar_figures.gauge_rows(found))
        pictures.append(bar_figures.draw_gauges(found))
    forces = bar_figures.force_rows(found)
    if forces is not None:
        contents["bar_forces.csv"] = csv_text(*forces)
    return contents | {f"{picture.name}.svg": canvas.render(picture) for picture in pictures}

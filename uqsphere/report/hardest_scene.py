"""The hardest of the scenes that were followed over time: what its bars see, and the stress inside its sphere."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np

from uqsphere.mechanics.history import FieldView
from uqsphere.mechanics.stress.tables import outside
from uqsphere.report.canvas import Picture
from uqsphere.report.contents import Contents
from uqsphere.report.field_figure import draw_field
from uqsphere.report.stress_figure import stress_picture

__all__ = ["bars_figure", "stress_inside_figure"]

#: of the stored places and instants every so-manieth goes into the file of the figure
_STRIDES: Final = (3, 2)


def bars_figure(contents: Contents) -> Picture | None:
    """Stress in both bars over place and time; None where no scene was followed."""
    stored = (contents.courses or {}).get("hardest", {}).get("bars")
    if stored is None:
        return None
    view = FieldView.from_document(stored)
    every, other = _STRIDES
    places, times, stress = view.places[::every], view.times[::other], view.stress[::other, ::every]
    x, t = np.meshgrid(places, times)
    rows = zip(x.ravel().tolist(), t.ravel().tolist(), stress.ravel().tolist(), strict=True)
    return replace(
        draw_field(view),
        name="bars-hardest",
        header=("place [m]", "time [s]", "axial stress, tension positive [Pa]"),
        rows=tuple(rows),
    )


def stress_inside_figure(contents: Contents) -> Picture | None:
    """Half sections of the sphere at its largest pressure; None where the tables of the stress do not reach."""
    contact = (contents.courses or {}).get("hardest", {}).get("contact")
    if contact is None or outside(contact["ratio"], contact["nu"]):
        return None
    return replace(stress_picture(contact["ratio"], contact["nu"], contact["pressure"]), name="stress-hardest")

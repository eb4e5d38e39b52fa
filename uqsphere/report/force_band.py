"""The contact force over time as a band over many scenes, with the hardest of them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from uqsphere.mechanics.validity import RULES
from uqsphere.quantities import display_unit
from uqsphere.report import canvas
from uqsphere.report.canvas import BLUE, INK, ORANGE, RED, Picture
from uqsphere.report.contents import Contents
from uqsphere.report.tables import Table, thousands
from uqsphere.report.wording import input_name, value_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["force_band_figure", "force_band_finding", "force_band_heading", "hardest_table", "hardest_words"]

#: contact pressure over the yield strength of the bars at which they yield
YIELD_ONSET: Final = float(next(rule.limit for rule in RULES if rule.name == "bar_yield_contact"))
_FACES: Final = (("force_a", "incident face A", BLUE), ("force_b", "receiving face B", ORANGE))


def force_band_figure(contents: Contents) -> Picture | None:
    """Median and 5 to 95 % of the force at both faces, one above the other; None where no scene was followed."""
    courses = contents.courses
    if courses is None:
        return None
    seconds = np.array(courses["time"], dtype=float)
    unit, factor = ("ms", 1e3) if seconds[-1] >= 2e-3 else ("µs", 1e6)
    largest = max(max(courses["hardest"][face]) for face, _, _ in _FACES)
    force_unit, scale = display_unit("P_max")
    with canvas.style():
        figure, axes = canvas.new_figure(5.0, rows=2, sharex=True, sharey=True)
        for place, (face, words, colour) in zip(axes, _FACES, strict=True):
            low, middle, high = (np.array(courses[face][level]) * scale for level in ("0.05", "0.5", "0.95"))
            t = seconds * factor
            place.fill_between(t, low, high, color=colour, alpha=0.30, linewidth=0.0)
            place.plot(t, middle, color=colour)
            place.plot(t, np.array(courses["hardest"][face]) * scale, color=RED, linestyle="--", linewidth=1.2)
            place.set_ylabel(f"force [{force_unit}]")
            place.annotate(words, (0.99, 0.97), xycoords="axes fraction", ha="right", va="top", color=INK)
            place.grid()
            place.set_xlim(0.0, t[-1])
            place.set_ylim(0.0, 1.12 * largest * scale)
        axes[-1].set_xlabel(f"time since first touch [{unit}]")
        _legend(axes[0])
    return Picture(
        name="force-band",
        title="Contact force over time",
        finding=force_band_finding(contents),
        figure=figure,
    )


def _legend(axes: Axes) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles = [
        Line2D([], [], color=BLUE, label="median"),
        Patch(facecolor=BLUE, alpha=0.30, label="5 to 95 %"),
        Line2D([], [], color=RED, linestyle="--", linewidth=1.2, label="the hardest scene"),
    ]
    axes.legend(handles=handles, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, borderaxespad=0.2, borderpad=0.0)


def force_band_finding(contents: Contents) -> str:
    """How high the force rises, when, and by how much the hardest scene exceeds that."""
    courses = contents.courses
    if courses is None:
        return ""
    seconds = np.array(courses["time"], dtype=float)
    medians = {face: np.array(courses[face]["0.5"]) for face, _, _ in _FACES}
    face = max(medians, key=lambda f: float(medians[f].max()))
    k = int(np.argmax(medians[face]))
    low, high = (float(courses[face][level][k]) for level in ("0.05", "0.95"))
    hardest = max(max(courses["hardest"][f]) for f, _, _ in _FACES)
    letter = face[-1].upper()
    return (
        f"The median force is largest at face {letter}, {value_text(float(medians[face][k]), 'P_max', 4)} after "
        f"{value_text(float(seconds[k]), 'contact_time', 4)}; nine in ten scenes lie between "
        f"{value_text(low, 'P_max', 4)} and {value_text(high, 'P_max', 4)} at that instant. {hardest_words(contents)} "
        f"reaches {value_text(hardest, 'P_max', 4)}.{beyond_yield(contents)}"
    )


def force_band_heading(contents: Contents) -> str:
    """The heading over the forces, with the largest median."""
    if contents.courses is None:
        return "Force over time"
    largest = max(float(np.max(contents.courses[face]["0.5"])) for face, _, _ in _FACES)
    return f"Force over time: in the median up to {value_text(largest, 'P_max', 4)}"


def hardest_words(contents: Contents) -> str:
    """Which scene is called the hardest."""
    courses = contents.courses
    assert courses is not None
    among, by = courses["hardest"].get("among"), courses["hardest"].get("by")
    if not among or by == "the largest force":
        return f"The hardest of the {courses['scenes']} scenes that were followed over time, not of all samples,"
    return f"The hardest of all {thousands(among)} samples, by {by},"


def beyond_yield(contents: Contents) -> str:
    """That the bars yield under the sphere in the hardest scene, where they do."""
    contact = (contents.courses or {}).get("hardest", {}).get("contact")
    strength = contents.at_mean("bars.yield_strength")
    if contact is None or strength is None or contact["pressure"] <= YIELD_ONSET * strength:
        return ""
    return (
        f" There the contact pressure of {value_text(contact['pressure'], 'p_max', 3)} is "
        f"{contact['pressure'] / strength:.2f} times the yield strength of the bars, which yield from {YIELD_ONSET:g} "
        "times on: what is shown of this scene is that of bars that stay elastic."
    )


def hardest_table(contents: Contents) -> Table | None:
    """The inputs of the hardest scene beside their means."""
    if contents.courses is None:
        return None
    rows = []
    for name, value in contents.courses["hardest"]["inputs"].items():
        mean = contents.results["inputs"].get(name, {}).get("mean")
        rows.append((input_name(name), value_text(float(value), name, 4), value_text(mean, name, 4)))
    return Table(
        caption="Inputs of the hardest scene",
        header=("input", "in the hardest scene", "mean"),
        rows=tuple(rows),
        note="Exact: one scene, and the means of the laws.",
    )

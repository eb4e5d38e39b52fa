"""Whether the criteria that a study uses stay inside the range of their formulas and tables, theory section 9.

Outside the range of a table the ratio at its edge is used, and outside the range of a formula the formula itself, so
that a demand is never absent.  How many samples that concerns is a check like those of `mechanics.validity`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from uqsphere.mechanics.criteria import CRITERIA, Criterion, Demands, in_range
from uqsphere.mechanics.dynamics import Answers
from uqsphere.mechanics.product import DIAMETERS, ENERGIES
from uqsphere.mechanics.scene import Scene, answered
from uqsphere.mechanics.validity import Check

__all__ = ["check_ranges"]

Array = npt.NDArray[np.float64]

#: how the ranges are called, and the column or parameter that each is of
_WORDS: Final = {"a/r": "a/r", "sphere.nu": "nu", "modulus": "m"}


def check_ranges(
    scene: Scene, answers: Answers, quantities: Collection[str], demands: Demands | None = None
) -> list[Check]:
    """One check per criterion whose demand is among the quantities, named ``range_of_`` and the quantity.

    Parameters
    ----------
    scene, answers : a batch and its answers, with `p_max` and `a_max` among them
    quantities : names of quantities of interest; those that are no criterion with a range are passed over
    demands : further quantities, name -> (criterion, parameters); those of the scene if None

    Each row is judged at its largest force; one that breaks earlier never comes so far.
    """
    demands = scene.demands if demands is None else demands
    plain: dict[str, tuple[str, Mapping[str, float]]] = {
        entry.quantity: (name, {})
        for name, entry in CRITERIA.items()
        # the range of the contact pressure is that of Hertz, which has a check of its own
        if entry.quantity is not None and entry.ranges and name != "contact_pressure"
    }
    known: dict[str, tuple[str, Mapping[str, float]]] = {**plain, **dict(demands)}
    good = answered(answers.status)
    found = [
        _check(name, CRITERIA[known[name][0]], known[name][1], scene, answers, good)
        for name in dict.fromkeys(quantities)
        if name in known and CRITERIA[known[name][0]].ranges
    ]
    return [*found, *([_product(scene, answers, good)] if "t10" in quantities else [])]


def _product(scene: Scene, answers: Answers, good: npt.NDArray[np.bool_]) -> Check:
    """The fineness against the energies and sizes that its A and b are fitted to."""
    energy, size = answers.values["specific_energy"], 2.0 * scene.columns["sphere.radius"]
    allowed = "0.1 to 2.5 kWh/t, 13 to 63 mm"
    if not good.any():
        return _none("range_of_t10")
    outside = [(energy < ENERGIES[0]) | (energy > ENERGIES[1]), (size < DIAMETERS[0]) | (size > DIAMETERS[1])]
    share = float(((outside[0] | outside[1]) & good).sum() / good.sum())
    lowest, highest = float(energy[good].min()), float(energy[good].max())
    worst = lowest if ENERGIES[0] / lowest > highest / ENERGIES[1] else highest
    if share == 0.0:
        text = f"t10 is used where A and b are measured ({allowed})"
    else:
        spans = (f"{lowest / 3600.0:.3g} to {highest / 3600.0:.3g} kWh/t",
                 f"{1e3 * size[good].min():.3g} to {1e3 * size[good].max():.3g} mm")  # fmt: skip
        left = " and ".join(span for span, which in zip(spans, outside, strict=True) if which[good].any())
        text = f"in {_which(share)} scenes t10 is outside the range of the drop-weight tests ({allowed}): found {left}"
    return Check(check="range_of_t10", share_information=0.0, share_warning=share, share_failure=0.0, worst=worst,
                 text=text)  # fmt: skip


def _which(share: float) -> str:
    return "all" if share == 1.0 else f"{100.0 * share:.3g} % of the"


def _none(name: str) -> Check:
    return Check(check=name, share_information=0.0, share_warning=0.0, share_failure=0.0, worst=None,
                 text="not checked: no scene was computed")  # fmt: skip


def _check(
    quantity: str,
    criterion: Criterion,
    parameters: Mapping[str, float],
    scene: Scene,
    answers: Answers,
    good: npt.NDArray[np.bool_],
) -> Check:
    name = f"range_of_{quantity}"
    columns = {**scene.columns, **answers.values}
    if not good.any():
        return _none(name)
    outside = ~in_range(criterion, columns, parameters) & good
    share = float(outside.sum() / good.sum())
    parts = [_part(key, bounds, columns, parameters, good) for key, bounds in criterion.ranges.items()]
    excess = max(parts, key=lambda part: part[0])
    if share == 0.0:
        text = f"{criterion.name} is used inside its range ({criterion.range_text})"
    else:
        left = ", ".join(words for beyond, _, words in parts if beyond > 0.0)
        text = (
            f"in {_which(share)} scenes {criterion.name} is outside its range ({criterion.range_text}): {left}; its "
            f"value there is {_meaning(criterion)}"
        )
    return Check(check=name, share_information=0.0, share_warning=share, share_failure=0.0, worst=excess[1], text=text)


def _meaning(criterion: Criterion) -> str:
    return (
        "that at the edge of its table"
        if "equal forces" in criterion.range_text
        else "that of the formula all the same"
    )


def _part(
    key: str, bounds: tuple[float, float], columns: Mapping[str, Any], parameters: Mapping[str, float], good: Any
) -> tuple[float, float, str]:
    """How far beyond the bounds over their distance, the value furthest out, and that in words."""
    if key == "a/r":
        values = np.asarray(columns["a_max"] / columns["sphere.radius"], dtype=float)[good]
    elif key in parameters:
        values = np.array([parameters[key]], dtype=float)
    else:
        values = np.asarray(columns[key], dtype=float)[good]
    low, high = bounds
    least, most = float(values.min()), float(values.max())
    below, above = low - least, most - high
    worst = least if below > max(above, 0.0) else most
    found = f"{least:.3g} to {most:.3g}" if min(below, above) > 0.0 else f"{worst:.3g}"
    return max(below, above) / (high - low), worst, f"{_WORDS.get(key, key)} reaches {found}"

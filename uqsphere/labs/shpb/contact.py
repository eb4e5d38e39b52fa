"""The contact law of a sphere that yields, from a slow load-unload record between two flat platens.

The two faces are alike, so that the platens close by twice the approach of one; each follows the
law of a face that yields (theory, C5 to C8).
E*, p_y, H, C and the displacement of first touch follow by least squares over the displacement.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final, Literal

import numpy as np
from pydantic import Field
from scipy.optimize import least_squares
from scipy.special import stdtrit

from uqsphere.arrays import Array
from uqsphere.errors import UsageError
from uqsphere.labs.files import Length, Section, in_unit
from uqsphere.labs.shpb.recorded import read_recorded
from uqsphere.materials import library
from uqsphere.mechanics.contact import hertz_constant, pressure_at_force
from uqsphere.mechanics.yielding import Face

#: samples without which no law is fitted, and the most that are used
_LEAST, _MOST = 30, 1500
#: forces below this share of the largest are left out; a record that ends above the second is not
#: unloaded
_QUIET, _UNLOADED = 0.01, 0.5
#: shares of the largest force at which the search for the onset begins
_BEGINNINGS: Final = (0.03, 0.15, 0.5)
#: bounds of H/p_y and of the pile-up
_RATIO, _PILE_UP = (1.2, 50.0), (1.0, 3.0)
#: upper over lower end of an interval beyond which a number is not determined
_OPEN: Final = 30.0

Stiffness = Annotated[float, in_unit("stiffness"), Field(gt=0.0)]


class ContactDocument(Section):
    """An input file of `uqsphere shpb fit-contact`.

    displacement, force : columns by heading or number; units stand in the heading or in `*_unit`.
    machine_stiffness : of the machine, taken off the displacement.
    platens : "rigid", or a material of the library for bars: E of the sphere follows from E* with
        `nu`.
    pile_up : where it is known; a record that was not unloaded does not tell it.
    """

    title: str = ""
    file: str
    diameter: Length
    displacement: str | int = 1
    force: str | int = 2
    displacement_unit: str = ""
    force_unit: str = ""
    machine_stiffness: Stiffness | None = None
    platens: str = "rigid"
    nu: float = Field(default=0.25, ge=0.0, lt=0.5)
    pile_up: float | None = Field(default=None, ge=1.0, le=3.0)
    compression: Literal["positive", "negative"] = "positive"


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """A number with its 95 % interval, SI."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class ContactFit:
    """The law of the faces; `misfit` rms of the displacement [m], `depth` largest approach over
    that of the onset.
    """

    onset_pressure: Fitted
    hardness: Fitted
    pile_up: Fitted
    modulus: Fitted
    sphere_modulus: Fitted | None
    depth: float
    misfit: float
    samples: int
    notes: tuple[str, ...]

    def lines(self) -> str:
        """The lines of a study."""
        numbers = [
            (
                f'{name} = "{v.value * 1e-9:.4g} GPa"    # {v.low * 1e-9:.4g} to '
                f"{v.high * 1e-9:.4g} "
                "GPa"
            )
            for name, v in (("onset_pressure", self.onset_pressure), ("hardness", self.hardness))
        ]
        pile_up = (
            f"pile_up = {self.pile_up.value:.4g}    # {self.pile_up.low:.3g} to "
            f"{self.pile_up.high:.3g}"
        )
        return "\n".join(["[contact]", 'law = "plastic"', *numbers, pile_up, ""])

    def rows(self) -> list[tuple[str, str, str]]:
        """Name, value and 95 % interval."""
        rows = []
        for name, v in (
            ("onset pressure", self.onset_pressure),
            ("hardness", self.hardness),
            ("pile-up", self.pile_up),
            ("reduced modulus E*", self.modulus),
            ("E of the sphere", self.sphere_modulus),
        ):
            if v is not None:
                unit, scale = ("", 1.0) if v is self.pile_up else (" GPa", 1e-9)
                ends = f"{v.low * scale:.4g} to {v.high * scale:.4g}{unit}"
                rows.append((name, f"{v.value * scale:.4g}{unit}", ends))
        return [
            *rows,
            (
                "misfit of the displacement",
                f"{self.misfit * 1e6:.2g} um",
                f"{self.samples} samples",
            ),
        ]


def load_loading(asked: ContactDocument, folder: Path) -> tuple[Array, Array, list[str]]:
    """Displacement [m] and force [N] in the order in which they were taken, (n,), and notes;
    UsageError for others.
    """
    table, _ = read_recorded(folder / asked.file)
    displacement = table.numbers(
        asked.displacement, "length", asked.displacement_unit or None, key="displacement"
    )
    force = table.numbers(asked.force, "force", asked.force_unit or None, key="force")
    table.check()
    sign = 1.0 if asked.compression == "positive" else -1.0
    return sign * displacement, sign * force, table.notes


def face_approach(
    force: Array,
    largest: Array,
    radius: float,
    modulus: float,
    onset: float,
    hardness: float,
    pile_up: float,
) -> Array:
    """Approach of a face [m] at forces [N], given the largest force so far [N], (n,)."""
    law = {
        "onset": onset,
        "hardness": hardness,
        "pile_up": pile_up,
        "modulus": modulus,
        "effective_radius": radius,
    }
    face = Face(**{name: np.full(1, value) for name, value in law.items()})
    depth, below = face.depth_at(force), force < largest * (1.0 - 1e-12)
    deepest = face.depth_at(largest[below])
    share = np.cbrt(np.square(np.maximum(force[below], 0.0) / largest[below]))
    depth[below] = deepest - face.recovery(deepest) * (1.0 - share)
    return np.asarray(depth * face.onset_approach)


def fit_contact(displacement: Array, force: Array, asked: ContactDocument) -> ContactFit:
    """Onset, hardness and pile-up of the faces of a sphere.

    Raises UsageError for a record that was not pressed, not unloaded, too short, or elastic
        throughout.
    """
    compliance = 1.0 / asked.machine_stiffness if asked.machine_stiffness else 0.0
    displacement = displacement - compliance * force
    top, radius = int(np.argmax(force)), 0.5 * asked.diameter
    if not force[top] > 0.0:
        raise UsageError(
            "the force is never positive: is compression negative in the file (compression = "
            '"negative")?'
        )
    pressed = displacement[: top + 1]
    if len(pressed) < 3 or not (pressed - pressed.mean()) @ force[: top + 1] > 0.0:
        raise UsageError(
            "the displacement does not grow with the force: turn it, or machine_stiffness is too "
            "low"
        )
    if np.median(np.abs(np.diff(displacement))) > 0.2 * np.ptp(displacement):
        raise UsageError(
            "the displacement jumps back and forth: put the samples in the order in which they "
            "were taken"
        )
    if asked.pile_up is None and force[top:].min() > _UNLOADED * force[top]:
        raise UsageError(
            "the record is not unloaded, which hardness and pile-up need: unload, or give pile_up"
        )
    kept = np.flatnonzero(force > _QUIET * force[top])
    if len(kept) < _LEAST:
        raise UsageError(
            f"{len(kept)} samples above {_QUIET:.0%} of the largest force, {_LEAST} are required"
        )
    largest = np.maximum.accumulate(force)
    kept = kept[np.unique(np.linspace(0, len(kept) - 1, min(len(kept), _MOST)).astype(int))]
    force, largest, displacement = force[kept], largest[kept], displacement[kept]
    scale, known = float(np.ptp(displacement)), asked.pile_up

    def residual(x: Array) -> Array:
        modulus, onset, ratio = (math.exp(v) for v in x[:3])
        pile_up = x[4] if known is None else known
        alpha = face_approach(force, largest, radius, modulus, onset, onset * ratio, pile_up)
        return np.asarray((displacement - 2.0 * alpha) / scale - x[3])

    best = None
    for share in _BEGINNINGS:
        early = (force <= max(0.15, share) * force.max()) & (force >= largest)
        rows = np.stack([np.cbrt(np.square(force[early])), np.ones(int(early.sum()))], axis=1)
        slope, touch = (
            np.linalg.lstsq(rows, displacement[early], rcond=None)[0]
            if len(rows) > 3
            else (0.0, 0.0)
        )
        if not slope > 0.0:
            slope, touch = scale / float(np.cbrt(force.max() ** 2)), float(displacement.min())
        modulus = (2.0 / slope) ** 1.5 / float(hertz_constant(1.0, radius))
        onset = float(pressure_at_force(share * force.max(), modulus, radius))
        start = np.array(
            [math.log(modulus), math.log(onset), math.log(2.0), touch / scale, 2.0][
                : 4 + (known is None)
            ]
        )
        low = [start[0] - 3.0, start[1] - 5.0, math.log(_RATIO[0]), -3.0, _PILE_UP[0]][: len(start)]
        high = [start[0] + 3.0, start[1] + 5.0, math.log(_RATIO[1]), 3.0, _PILE_UP[1]][: len(start)]
        found = least_squares(
            residual, np.clip(start, low, high), bounds=(low, high), x_scale="jac", xtol=1e-10
        )
        if best is None or found.cost < best.cost:
            best = found
    assert best is not None
    x, left = best.x, best.fun
    modulus, onset, ratio = (math.exp(v) for v in x[:3])
    alpha_y = radius * (0.5 * math.pi * onset / modulus) ** 2
    pile_up = float(x[4]) if known is None else known
    deepest = face_approach(
        force.max()[None], force.max()[None], radius, modulus, onset, onset * ratio, pile_up
    )
    depth = float(deepest[0]) / alpha_y
    # residuals that follow each other count for fewer
    alike = float(left[1:] @ left[:-1]) / max(float(left @ left), 1e-300)
    alike = alike if alike > 2.0 / math.sqrt(len(left)) else 0.0
    free = len(left) - len(x)
    jacobian = np.asarray(best.jac)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(left @ left) / free
    covariance *= (1.0 + alike) / max(1.0 - alike, 0.02)
    reach = float(stdtrit(free, 0.975))

    def interval(value: float, weights: Sequence[float]) -> Fitted:
        of = np.array([*weights, *[0.0] * (len(x) - len(weights))])
        spread = reach * math.sqrt(max(float(of @ covariance @ of), 0.0))
        return Fitted(value=value, low=value * math.exp(-spread), high=value * math.exp(spread))

    fitted = interval(modulus, [1.0])
    half = reach * math.sqrt(max(float(covariance[4, 4]), 0.0)) if known is None else 0.0
    notes = []
    hard = interval(onset * ratio, [0.0, 1.0, 1.0])
    if hard.high > _OPEN * hard.low:
        notes.append("the record does not determine the hardness: press harder")
    onset_range = interval(onset, [0.0, 1.0])
    undetermined, misfit = (
        onset_range.high > _OPEN * onset_range.low,
        float(np.sqrt(np.mean(np.square(left)))),
    )
    if undetermined and misfit > 0.01:
        raise UsageError(
            "no law of a contact follows this record: is the force free of offset, steps, clipping?"
        )
    if undetermined or depth < 1.5:
        reached = float(pressure_at_force(force.max(), modulus, radius))
        raise UsageError(
            f"hardly beyond Hertz, whose pressure reaches {reached / 1e9:.3g} GPa: press harder"
        )
    if alike > 0.0:
        notes.append(
            f"neighbouring residuals are correlated ({alike:.2g}), as by a drift; intervals are "
            "widened"
        )
    return ContactFit(
        onset_pressure=onset_range,
        hardness=hard,
        modulus=fitted,
        pile_up=Fitted(value=pile_up, low=max(pile_up - half, 1.0), high=min(pile_up + half, 3.0)),
        sphere_modulus=_sphere_modulus(fitted, asked, notes, onset_range),
        depth=depth,
        misfit=scale * misfit,
        samples=len(left),
        notes=tuple(notes),
    )


def _sphere_modulus(
    reduced: Fitted, asked: ContactDocument, notes: list[str], onset: Fitted
) -> Fitted | None:
    """E of the sphere from E* and the platens: 1/E* = (1-nu²)/E + (1-nu_p²)/E_p."""
    soft = 0.0
    if asked.platens != "rigid":
        known = {**library()["bars"], **library()["plates"]}
        if asked.platens not in known:
            raise UsageError(f"platens = {asked.platens!r}: allowed are rigid, {', '.join(known)}")
        plate = {key: entry.value for key, entry in known[asked.platens].properties.items()}
        soft = (1.0 - plate["nu"] ** 2) / plate["E"]
        if onset.high > 1.2 * plate.get("yield_strength", math.inf):
            notes.append("the platens yield near this onset too: what was fitted may be theirs")
    rest = [1.0 / m - soft for m in (reduced.value, reduced.low, reduced.high)]
    if min(rest) <= 0.0:
        return None
    value, low, high = ((1.0 - asked.nu**2) / compliance for compliance in rest)
    return Fitted(value=value, low=low, high=high)

"""The contact law of a sphere that yields, from a slow load-unload record between flat platens.

The two faces are alike, so that the platens approach by twice the approach of one face; each
follows the law of a face that yields (theory, C5 to C8).  E*, p_y, H, C and the displacement of
first touch follow by least squares of the displacement.
"""

import math
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from scipy.optimize import least_squares

from uqsphere.arrays import Array, Values, frozen
from uqsphere.errors import UsageError
from uqsphere.labs.files import Length, PoissonRatio, Positive, Section, in_unit
from uqsphere.materials import library, materials_of
from uqsphere.mechanics.contact import hertz_constant, pressure_at_force
from uqsphere.mechanics.yielding import Face
from uqsphere.quantities import lookup
from uqsphere.tables import TableError
from uqsphere.uq import student

from .recorder import read_recorded

#: fewest and most samples that are fitted
_LEAST, _MOST = 30, 1500
#: share of the largest force below which samples are left out, and to which a record must unload
_QUIET, _UNLOADED = 0.01, 0.5
#: shares of the largest force at which the search for the onset begins
_BEGINNINGS = (0.03, 0.15, 0.5)
#: bounds of the pile-up
_PILE_UP = (1.0, 3.0)
#: bounds of what is fitted: of ln E* and ln p_y about their beginnings, of ln H/p_y, of the
#: displacement of first touch over the range of displacements, and of the pile-up
_BOUNDS = np.array(
    [
        [-3.0, -5.0, math.log(1.2), -3.0, _PILE_UP[0]],
        [3.0, 5.0, math.log(50.0), 3.0, _PILE_UP[1]],
    ]
)
#: ratio of the ends of an interval beyond which a number is not determined
_OPEN = 30.0

Stiffness = Annotated[Positive, in_unit("stiffness")]


class ContactDocument(Section):
    """An input file of `uqsphere shpb fit-contact`.

    sheet : of a workbook (default: the first with data).
    displacement, force : columns by heading or number; units in the heading or in `*_unit`.
    machine_stiffness : its displacement is subtracted.
    platens : "rigid", or a material of the library for bars; E of the sphere follows from E* and
        `nu`.
    pile_up : required for a record that was not unloaded.
    """

    title: str = ""
    file: str
    sheet: str = ""
    diameter: Length
    displacement: str | int = 1
    force: str | int = 2
    displacement_unit: str = ""
    force_unit: str = ""
    machine_stiffness: Stiffness = math.inf
    platens: Literal["rigid", *materials_of("bars", "plates")] = "rigid"  # type: ignore[valid-type]
    nu: PoissonRatio = 0.25
    pile_up: float | None = Field(default=None, ge=1.0, le=3.0, strict=True)
    compression: Literal["positive", "negative"] = "positive"


@dataclass(frozen=True)
class Fitted:
    """A number with its 95 % interval, SI."""

    value: float
    low: float
    high: float

    def in_gpa(self) -> tuple[str, str]:
        """A pressure and its interval as texts."""
        ends = f"{self.low * 1e-9:.4g} to {self.high * 1e-9:.4g} GPa"
        return f"{self.value * 1e-9:.4g} GPa", ends


@frozen
class ContactFit:
    """The law of the faces.

    depth : largest approach over that of the onset.
    misfit : rms error of the displacement [m].
    """

    onset_pressure: Fitted
    hardness: Fitted
    pile_up: Fitted
    modulus: Fitted
    sphere_modulus: Fitted | None
    depth: float
    misfit: float
    samples: int
    notes: list[str]

    def lines(self) -> str:
        """The lines of a study."""
        onset, onset_ends = self.onset_pressure.in_gpa()
        hardness, hardness_ends = self.hardness.in_gpa()
        return f"""\
[contact]
law = "plastic"
onset_pressure = "{onset}"    # {onset_ends}
hardness = "{hardness}"    # {hardness_ends}
pile_up = {self.pile_up.value:.4g}    # {self.pile_up.low:.3g} to {self.pile_up.high:.3g}
"""

    def rows(self) -> list[tuple[str, str, str]]:
        """Name, value and 95 % interval."""
        moduli = {
            "onset pressure": self.onset_pressure,
            "hardness": self.hardness,
            "reduced modulus E*": self.modulus,
            "E of the sphere": self.sphere_modulus,
        }
        misfit = f"{self.misfit * 1e6:.2g} um"
        ends = f"{self.pile_up.low:.4g} to {self.pile_up.high:.4g}"
        return [
            *((name, *number.in_gpa()) for name, number in moduli.items() if number),
            ("pile-up", f"{self.pile_up.value:.4g}", ends),
            ("misfit of the displacement", misfit, f"{self.samples} samples"),
        ]


def load_loading(asked: ContactDocument, folder: Path) -> tuple[Array, Array, Array, list[str]]:
    """The samples (n,) of the record of an input file that are fitted, in its order: displacement
    [m], force [N] and the largest force so far [N]; and notes.

    Raises UsageError for a table without displacement and force, and for a record without
        compression or unloading, or of too few samples.
    """
    table, _ = read_recorded(folder / asked.file, asked.sheet)
    table = replace(table, unit_keys={key: f"{key}_unit" for key in ("displacement", "force")})
    displacement = table.numbers(
        asked.displacement, "length", asked.displacement_unit, key="displacement"
    )
    force = table.numbers(asked.force, "force", asked.force_unit, key="force")
    table.check()
    if asked.compression == "negative":
        displacement = -displacement
        force = -force
    displacement = displacement - force / asked.machine_stiffness
    top = np.argmax(force)
    if not force[top] > 0.0:
        raise TableError(
            "the force is never positive. Is compression negative in the file (compression = "
            '"negative")?',
            "compression",
        )
    pressed = displacement[: top + 1]
    if len(pressed) < 3 or not (pressed - pressed.mean()) @ force[: top + 1] > 0.0:
        raise TableError(
            "the displacement does not grow with the force. Change its sign, or raise "
            "machine_stiffness",
            "displacement",
        )
    if np.median(np.abs(np.diff(displacement))) > 0.2 * np.ptp(displacement):
        raise UsageError(
            "the displacement jumps back and forth. Put the samples in the order of the record"
        )
    if not asked.pile_up and force[top:].min() > _UNLOADED * force[top]:
        raise TableError(
            "the record is not unloaded, which hardness and pile-up need. Unload, or set pile_up",
            "pile_up",
        )
    kept = np.flatnonzero(force > _QUIET * force[top])
    if len(kept) < _LEAST:
        raise UsageError(
            f"{len(kept)} samples above {_QUIET:.0%} of the largest force, {_LEAST} are required"
        )
    moved = np.ptp(displacement[kept])
    if moved > asked.diameter:
        raise TableError(
            f"the displacement goes over {moved * 1e3:.3g} mm, more than the diameter. Is it in "
            "another unit (displacement_unit)?",
            "displacement",
        )
    kept = kept[np.linspace(0, len(kept) - 1, min(len(kept), _MOST)).astype(int)]
    return displacement[kept], force[kept], np.maximum.accumulate(force)[kept], table.notes


def face_approach(force: Array, largest: Array, face: Face) -> Array:
    """Approach of a face [m] at forces >= 0 [N], given the largest force so far [N], (n,)."""
    deepest = face.depth_at(largest)
    # unloading is Hertz's; without it the share is 1
    share: Array = np.cbrt(np.square(force / largest))
    return (deepest - face.recovery(deepest) * (1.0 - share)) * face.onset_approach


def fit_contact(asked: ContactDocument, folder: Path) -> ContactFit:
    """Onset, hardness and pile-up of the faces of a sphere, from the record of an input file.

    Raises UsageError as `load_loading`, and for a record that is elastic throughout, or that no law
        fits.
    """
    displacement, force, largest, notes = load_loading(asked, folder)
    scale = np.ptp(displacement)
    highest = force.max()
    radius: Values = 0.5 * asked.diameter

    def law_of(x: Array) -> Face:
        """The law of logarithms of E*, onset and H/p_y, of the touch, and of the pile-up if it is
        free."""
        # numbers of numpy: a pile-up of 1 divides by zero
        modulus, onset, ratio = np.exp(x[:3])
        pile_up: Values = asked.pile_up or x[4]
        return Face(
            modulus=modulus,
            onset=onset,
            hardness=onset * ratio,
            pile_up=pile_up,
            effective_radius=radius,
        )

    def residual(x: Array) -> Array:
        approach = face_approach(force, largest, law_of(x))
        return np.asarray((displacement - 2.0 * approach) / scale - x[3])

    free = slice(4 if asked.pile_up else 5)
    fits = []
    for share in _BEGINNINGS:
        early = (force <= max(0.15, share) * highest) & (force >= largest)
        slope = 0.0
        if early.sum() > 3:
            slope, touch = np.polyfit(np.cbrt(np.square(force[early])), displacement[early], 1)
        if not slope > 0.0:
            slope = scale / np.cbrt(highest**2)
            touch = displacement.min()
        modulus = (2.0 / slope) ** 1.5 / hertz_constant(1.0, radius)
        onset = pressure_at_force(share * highest, modulus, radius)
        centre = np.array([math.log(modulus), math.log(onset), 0.0, 0.0, 0.0])
        bounds = (centre + _BOUNDS)[:, free]
        begin = np.clip([*centre[:2], math.log(2.0), touch / scale, 2.0][free], *bounds)
        fits.append(least_squares(residual, begin, bounds=bounds, x_scale="jac", xtol=1e-10))
    best = min(fits, key=lambda fitted: fitted.cost)
    left = best.fun
    count = len(left)
    law = law_of(best.x)
    depth = float(law.depth_at(highest))
    # correlated residuals count for fewer
    squares = 2.0 * best.cost
    correlation = float(left[1:] @ left[:-1]) / max(squares, 1e-300)
    if correlation <= 2.0 / math.sqrt(count):
        correlation = 0.0
    spare = count - len(best.x)
    jacobian = np.asarray(best.jac)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * squares / spare
    covariance *= (1.0 + correlation) / max(1.0 - correlation, 0.02)

    def reach_of(first: int, behind: int) -> float:
        """Half the 95 % interval of the sum of some parameters; 0 for none."""
        variance = covariance[first:behind, first:behind].sum()
        return student(spare + 1.0) * math.sqrt(max(variance, 0.0))

    def interval(value: Values, first: int, behind: int) -> Fitted:
        factor = math.exp(reach_of(first, behind))
        return Fitted(value, value / factor, value * factor)

    modulus = interval(law.modulus, 0, 1)
    onset = interval(law.onset, 1, 2)
    hardness = interval(law.hardness, 1, 3)
    misfit = math.sqrt(squares / count)
    undetermined = onset.high > _OPEN * onset.low
    if undetermined and misfit > 0.01:
        raise UsageError(
            "no contact law fits this record. Check the force for an offset, steps or clipping"
        )
    if undetermined or depth < 1.5:
        reached = pressure_at_force(highest, modulus.value, radius)
        raise UsageError(
            f"the record is hardly beyond Hertz (pressure up to {reached / 1e9:.3g} GPa): press "
            "harder"
        )
    if hardness.high > _OPEN * hardness.low:
        notes.append("the record does not determine the hardness: press harder")
    for key, number in {"onset_pressure": onset, "hardness": hardness}.items():
        least, most = lookup(f"contact.{key}").plausible
        if not least <= number.value <= most:
            notes.append(f"{key} = {number.in_gpa()[0]} is unusual. Are the units right?")
    if correlation > 0.0:
        notes.append(
            f"neighbouring residuals are correlated ({correlation:.2g}), for example by a drift: "
            "the intervals are widened"
        )
    pile_up: Values = law.pile_up
    half = reach_of(4, 5)
    # E of the sphere: 1/E* = (1-nu²)/E + (1-nu_p²)/E_p
    soft = 0.0
    sphere_modulus = None
    if asked.platens != "rigid":
        properties = library()[asked.platens].properties
        plate = {key: entry.value for key, entry in properties.items()}
        soft = (1.0 - plate["nu"] ** 2) / plate["E"]
        if onset.high > 1.2 * plate.get("yield_strength", math.inf):
            notes.append(
                "the platens yield near this onset too: the fitted law may be that of the platens"
            )
    compliances = 1.0 / np.array(astuple(modulus)) - soft
    if compliances.min() > 0.0:
        sphere_modulus = Fitted(*(1.0 - asked.nu**2) / compliances)
    return ContactFit(
        onset_pressure=onset,
        hardness=hardness,
        modulus=modulus,
        pile_up=Fitted(pile_up, *np.clip([pile_up - half, pile_up + half], *_PILE_UP)),
        sphere_modulus=sphere_modulus,
        depth=depth,
        misfit=scale * misfit,
        samples=count,
        notes=notes,
    )

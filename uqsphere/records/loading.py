"""What a slow test on a sphere says of its contact: onset, hardness and pile-up from force against displacement.

A sphere is pressed between two flat platens and let go.  Its two faces are alike, so that the platens close by twice
the approach: on virgin loading that of (C5), below the largest force so far that of (C9).  Reduced modulus, onset,
hardness, pile-up and the displacement of first touch follow by least squares, weighted by the noise that displacement
and force are found to have, with 95 % intervals from the curvature at the optimum, wider where neighbouring residuals
are alike.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import least_squares, nnls
from scipy.special import stdtrit

from uqsphere.arrays import Array
from uqsphere.mechanics.contact import hertz_constant, pressure_at_force
from uqsphere.mechanics.yielding import CAP_PILE_UP, Face
from uqsphere.records.table import RecordError, place_of, read_table
from uqsphere.units import UNITS

#: samples without which no law is fitted, and the most that are used: more are thinned evenly
_LEAST, _MOST = 30, 1500
#: forces below this share of the largest are left out: the approach is too steep in the force there
_QUIET: Final = 0.01
#: a record that ends above this share of its largest force has not been unloaded
_UNLOADED: Final = 0.5
#: shares of the largest force at which the search for the onset begins
_BEGINNINGS: Final = (0.03, 0.15, 0.5)
#: places of the virgin curve between which it is interpolated by cubic pieces, to 1e-7
_PLACES: Final = 120
#: bounds of H/p_y and of the pile-up; softening 0 < b < 0.2 is kept out by the least of the first
_RATIO, _PILE_UP = (1.2, 50.0), (1.0, 3.0)
#: evaluations after which the beginnings are compared
_SHORT: Final = 8
#: depth of the largest approach below which nothing can be said of a law that has hardly begun
_BEGUN: Final = 1.5
#: upper over lower end of an interval beyond which a number is not told
_OPEN: Final = 30.0
#: median step of the displacement, over its range, beyond which samples are out of order
_JUMP: Final = 0.2


@dataclass(frozen=True, kw_only=True)
class Loading:
    """A slow test: displacement of the platens [m] and force [N] in the order in which they were taken, (n,) each."""

    displacement: Array
    force: Array
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Fitted:
    """One number with its 95 % interval, SI."""

    value: float
    low: float
    high: float

    @property
    def open(self) -> bool:
        """Whether the test does not tell it."""
        return self.high > _OPEN * self.low


@dataclass(frozen=True, kw_only=True)
class ContactFit:
    """The law of the faces that a slow test has.

    `onset`, `hardness` [Pa], `pile_up`, `modulus` E* [Pa]; `depth` z and `dent` [m] of a face at the largest force,
    `misfit` root mean square of the displacement's residuals [m], `alike` correlation of those of neighbouring samples
    (0 where it is no more than chance), `samples` used.
    """

    onset: Fitted
    hardness: Fitted
    pile_up: Fitted
    modulus: Fitted
    depth: float
    dent: float
    misfit: float
    alike: float
    samples: int


def read_loading(path: str | Path, *, columns: Sequence[str] = (), units: Sequence[str] = ("", "")) -> Loading:
    """Displacement and force of a file; their units from its header unless given.

    Raises RecordError for a file that is no table, unknown columns or units, cells without a number, too few samples,
    or a test that was not pressed.
    """
    table = read_table(path)
    if not columns and len(table.names) == 2:
        columns = table.names
    if len(columns) != 2:
        listed = ", ".join(table.names)
        raise RecordError(f"name two columns, displacement and force, by --columns D,F; the file has {listed}")
    at, found = [place_of(table, name) for name in columns], []
    for place, dimension, unit, what in zip(at, ("length", "force"), units, ("displacement", "force"), strict=True):
        ending = table.names[place].rpartition("_")[2]
        used = unit or table.units[place] or (ending if ending in UNITS[dimension] else "")
        if used not in UNITS[dimension]:
            said = f"the {what} has the unit {used!r}" if used else f"the {what} has no unit"
            known = ", ".join(u for u in UNITS[dimension] if u.isascii())
            raise RecordError(
                f"{said}: name it in the header, as in {what} [{next(iter(UNITS[dimension]))}], or by --{what}-unit "
                f"(units: {known})"
            )
        values = table.values[:, place]
        if np.isnan(values).any():
            row = int(np.argmax(np.isnan(values))) + 1
            raise RecordError(f"row {row} has no number in {table.names[place]!r}: take it out")
        found.append(values * UNITS[dimension][used])
    return Loading(displacement=found[0], force=found[1], notes=table.notes)


@dataclass(frozen=True, kw_only=True)
class _Test:
    """The samples that are fitted: displacement less that of the machine [m], force and largest force so far [N]."""

    displacement: Array
    force: Array
    largest: Array
    radius: float
    pile_up: float | None
    weight: Array

    def face(self, parameters: Array, count: int) -> Face:
        modulus, onset, ratio = np.exp(parameters[:3])
        pile_up = parameters[4] if self.pile_up is None else self.pile_up
        numbers = onset, onset * ratio, pile_up, modulus, self.radius
        return Face(**{name: np.full(count, value) for name, value in zip(_NAMES, numbers, strict=True)})

    def approach(self, parameters: Array) -> tuple[Array, Array]:
        """Approach of a face [m] at every force and its slope [m/N], on virgin loading or below the largest so far."""
        one = self.face(parameters, 1)
        top = max(float(self.force.max() / one.onset_force[0]), 1.0 + 1e-9)
        # the law of b = 0 is the softest: its depth is the largest
        face = self.face(parameters, _PLACES)
        depths = np.square(np.linspace(1.0, math.sqrt(1.0 + (top - 1.0) / 1.5), _PLACES))
        virgin = CubicHermiteSpline(face.force(depths), depths, 1.0 / face.slope(depths))

        def depth(force: Array) -> Array:
            ratio = force / one.onset_force[0]
            return np.where(ratio > 1.0, virgin(np.maximum(ratio, 1.0)), np.cbrt(np.square(ratio)))

        pressed = depth(self.force)
        slope = 1.0 / (one.onset_force[0] * one.slope(pressed))
        below = self.force < self.largest * (1.0 - 1e-12)
        peaks, place = np.unique(self.largest[below], return_inverse=True)
        deepest = depth(peaks)
        recovered = self.face(parameters, len(peaks)).recovery(deepest)
        share = np.cbrt(np.square(self.force[below] / self.largest[below]))
        pressed[below] = deepest[place] - recovered[place] * (1.0 - share)
        slope[below] = (2.0 / 3.0) * recovered[place] * share / self.force[below]
        return np.asarray(pressed * one.onset_approach[0]), np.asarray(slope * one.onset_approach[0])

    def residual(self, parameters: Array) -> Array:
        """Displacement as measured less that of the law, over the spread of the measured ones, weighted."""
        gap = self.displacement - 2.0 * self.approach(parameters)[0]
        return np.asarray(self.weight * (gap / self.scale - parameters[3]))

    def weighed(self, parameters: Array) -> _Test:
        """The same with the weights that noise of the displacement and of the force has, as the residuals show it."""
        slope = 2.0 * self.approach(parameters)[1] / self.scale * self.force.max()
        square = np.square(self.residual(parameters) / self.weight)
        noise, _ = nnls(np.stack([np.ones_like(slope), np.square(slope)], axis=1), square)
        variance = noise[0] + noise[1] * np.square(slope)
        if not variance.min() > 0.0:
            return self
        return replace(self, weight=np.sqrt(variance.min() / variance))

    @property
    def scale(self) -> float:
        return float(np.ptp(self.displacement))


_NAMES: Final = ("onset", "hardness", "pile_up", "modulus", "effective_radius")


def fit_contact(
    loading: Loading, *, diameter: float, compliance: float = 0.0, pile_up: float | None = None
) -> ContactFit:
    """Onset, hardness and pile-up of the faces of a sphere from a slow test between two flat platens.

    diameter : of the sphere [m].
    compliance : of the machine [m/N], taken off the displacement.
    pile_up : where it is known; a test that was not unloaded does not tell it.

    Raises RecordError for a test that was not pressed, not unloaded, too short, or elastic throughout.

    Valid for r_eff = diameter/2, equal faces, and a body whose law does not depend on the rate; theory (C5), (C9).
    """
    test = _prepared(loading, diameter, compliance, pile_up)
    begun = min((_search(test, share) for share in _BEGINNINGS), key=lambda found: float(found[1] @ found[1]))
    test = test.weighed(_fit(test, begun[0])[0])
    parameters, residual, jacobian = _fit(test, begun[0])
    face = test.face(parameters, 1)
    depth = face.depth_at(np.array([test.force.max()]))
    if depth[0] < _BEGUN:
        reached = float(pressure_at_force(test.force.max(), math.exp(parameters[0]), test.radius))
        raise RecordError(
            f"the contact is hardly beyond Hertz, whose pressure reaches {reached / 1e9:.3g} GPa at the largest force: "
            "its onset lies near or above that; press harder"
        )
    values, spreads = _intervals(test, parameters, residual, jacobian)
    names = ("modulus", "onset", "hardness", "pile_up")
    fitted = {
        name: Fitted(value=v, low=low, high=high) for name, v, (low, high) in zip(names, values, spreads, strict=True)
    }
    misfit = test.scale * float(np.sqrt(np.mean(np.square(residual / test.weight))))
    if fitted["onset"].open:
        worst = test.force[np.argmax(np.abs(residual / test.weight))] / test.force.max()
        raise RecordError(
            f"no law of a contact follows this record: it is off by {1e6 * misfit:.2g} um, most at {worst:.0%} of the "
            "largest force; is the force free of an offset, of steps, and never cut off? Take such parts out"
        )
    return ContactFit(
        **fitted,
        depth=float(depth[0]),
        dent=float(face.pressed(depth).dent[0]),
        misfit=misfit,
        alike=_alike(residual),
        samples=len(residual),
    )


def _prepared(loading: Loading, diameter: float, compliance: float, pile_up: float | None) -> _Test:
    """The samples to fit; raises RecordError where they are no test."""
    force, displacement = loading.force, loading.displacement - compliance * loading.force
    top = int(np.argmax(force))
    if not force[top] > 0.0:
        raise RecordError("the force is never positive: is compression negative in this file? Turn its sign")
    if np.median(np.abs(np.diff(displacement))) > _JUMP * np.ptp(displacement):
        raise RecordError(
            "the displacement jumps back and forth: put the samples in the order in which they were taken"
        )
    pressed = displacement[: top + 1]
    if not (pressed - pressed.mean()) @ force[: top + 1] > 0.0:
        raise RecordError(
            "the displacement does not grow while the force does: turn its sign, or the stiffness given for the "
            "machine is too low"
        )
    if pile_up is None and force[top:].min() > _UNLOADED * force[top]:
        raise RecordError(
            "the test is not unloaded, without which hardness and pile-up cannot be told apart: let the sphere go, or "
            "say what is known by --pile-up"
        )
    kept = np.flatnonzero(force > _QUIET * force[top])
    if len(kept) < _LEAST:
        raise RecordError(f"found {len(kept)} samples above {_QUIET:.0%} of the largest force, {_LEAST} are due")
    largest = np.maximum.accumulate(force)
    kept = kept[np.unique(np.linspace(0, len(kept) - 1, min(len(kept), _MOST)).astype(int))]
    return _Test(displacement=displacement[kept], force=force[kept], largest=largest[kept], radius=0.5 * diameter,
                 pile_up=pile_up, weight=np.ones(len(kept)))  # fmt: skip


def _search(test: _Test, share: float) -> tuple[Array, Array, Array]:
    """Parameters (ln E*, ln p_y, ln H/p_y, first touch, pile-up), residuals and Jacobian from one beginning."""
    # Hertz through the smallest forces: the displacement is linear in force^(2/3)
    early = test.force <= max(_BEGINNINGS[1], share) * test.force.max()
    early &= test.force >= test.largest
    rows = np.stack([np.cbrt(np.square(test.force[early])), np.ones(int(early.sum()))], axis=1)
    slope, touch = np.linalg.lstsq(rows, test.displacement[early], rcond=None)[0] if len(rows) > 3 else (0.0, 0.0)
    if not slope > 0.0:
        slope, touch = np.ptp(test.displacement) / np.cbrt(test.force.max() ** 2), float(test.displacement.min())
    modulus = (2.0 / slope) ** 1.5 / hertz_constant(1.0, test.radius)
    onset = float(pressure_at_force(share * test.force.max(), modulus, test.radius))
    touch = float(np.clip(touch / test.scale, -2.9, 2.9))
    start = np.array([math.log(modulus), math.log(onset), math.log(2.0), touch, CAP_PILE_UP])
    return _fit(test, start if test.pile_up is None else start[:4], _SHORT)


def _fit(test: _Test, start: Array, most: int = 200) -> tuple[Array, Array, Array]:
    """Parameters, residuals and Jacobian at the optimum near `start`."""
    low = [start[0] - 3.0, start[1] - 5.0, math.log(_RATIO[0]), -3.0, _PILE_UP[0]][: len(start)]
    high = [start[0] + 3.0, start[1] + 5.0, math.log(_RATIO[1]), 3.0, _PILE_UP[1]][: len(start)]
    found = least_squares(test.residual, np.clip(start, low, high), bounds=(low, high), x_scale="jac",
                          xtol=1e-9, ftol=1e-9, max_nfev=most)  # fmt: skip
    return found.x, found.fun, np.asarray(found.jac)


def _alike(residual: Array) -> float:
    """Correlation of neighbouring residuals; 0 within two standard errors of none."""
    found = float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-300)
    return found if found > 2.0 / math.sqrt(len(residual)) else 0.0


def _intervals(
    test: _Test, parameters: Array, residual: Array, jacobian: Array
) -> tuple[list[float], list[tuple[float, float]]]:
    """E*, p_y, H and C with their 95 % intervals; a number at its bound is taken as known."""
    free = len(residual) - len(parameters)
    alike = _alike(residual)
    # residuals that follow each other count for fewer
    wider = (1.0 + alike) / max(1.0 - alike, 0.02)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(residual @ residual) / free * wider
    reach = float(stdtrit(free, 0.975))
    of = np.zeros((4, len(parameters)))
    of[0, 0] = of[1, 1] = of[2, 1] = of[2, 2] = 1.0
    logs = of[:3] @ parameters
    spread = reach * np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", of, covariance, of), 0.0))
    values = np.exp(logs).tolist()
    bands = [(math.exp(max(a - d, -700.0)), math.exp(min(a + d, 700.0))) for a, d in zip(logs, spread[:3], strict=True)]
    if test.pile_up is not None:
        return [*values, test.pile_up], [*bands, (test.pile_up, test.pile_up)]
    c, d = float(parameters[4]), reach * math.sqrt(max(float(covariance[4, 4]), 0.0))
    return [*values, c], [*bands, (max(c - d, _PILE_UP[0]), min(c + d, _PILE_UP[1]))]

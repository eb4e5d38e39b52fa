"""Tests of single particles: between which energies the first fracture energy of every specimen
lies."""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from uqsphere.arrays import Array, Flags, Names, Values
from uqsphere.documents import WORDS
from uqsphere.errors import UsageError
from uqsphere.quantities import lookup
from uqsphere.tables import Table, TableError

from . import laws
from .document import AT_FAILURE, MEASURED, RIGS, ComminutionDocument
from .energies import particle_energies

_BROKE = WORDS["outcomes"]
#: relative difference within which two sizes in order are the same
_SAME = 0.005
_MOST_BLOWS = 10_000
#: keys that give the units of columns
_UNIT_KEYS = {
    **dict.fromkeys(("diameter", "mesh_lower", "mesh_upper"), "diameter_unit"),
    **dict.fromkeys(MEASURED, "unit"),
    "mass": "mass_unit",
    "stiffness": "stiffness_unit",
}


class Specimens(NamedTuple):
    """Specimens (s,) with the blows (s, K) [J/kg] that each had, 0 for none.

    broke : whether the last blow broke it.
    exact : whether it broke at an energy that is known.
    weight : number of such particles.
    """

    diameter: Array
    blows: Array
    broke: Flags
    exact: Flags
    weight: Array
    notes: Names = ()

    @property
    def last(self) -> Array:
        """(s,) energy of the last blow [J/kg]."""
        return self.blows[self._is_last]

    @property
    def _is_last(self) -> Values:
        """(s, K) whether a blow is the last one of its specimen."""
        number = np.count_nonzero(self.blows, axis=1, keepdims=True)
        return np.arange(self.blows.shape[1]) == number - 1

    @property
    def repeated(self) -> Flags:
        """(s,) whether a specimen was hit more than once."""
        return np.asarray(self.blows[:, 1:].any(axis=1))

    @property
    def sizes(self) -> dict[float, Flags]:
        """The specimens (s,) of each tested size [m], rising."""
        logs = np.log(self.diameter)
        ordered = np.sort(logs)
        starts = ordered[1:][np.diff(ordered) > _SAME]
        part = np.searchsorted(starts, logs, side="right")
        groups = [part == k for k in range(len(starts) + 1)]
        return {np.exp(logs[group].mean()): group for group in groups}

    def bounds(self, gamma: Array) -> Array:
        """(low, high] of the first fracture energy, (2, ..., s), for gamma (...); equal where it is
        known exactly."""
        exponent = gamma[..., None]
        breaking = self._is_last & self.broke[:, None]
        survived = laws.survivor_bound(np.where(breaking, 0.0, self.blows), exponent)
        ended = np.where(self.broke, laws.survivor_bound(self.blows, exponent), np.inf)
        return np.where(self.exact, self.last, [survived, ended])


def load_tests(asked: ComminutionDocument, folder: Path) -> Specimens:
    """The specimens of the table of an input file.

    Raises UsageError with the lines of impossible rows, and for tests that bound no energy.
    """
    import pandas as pd

    want = asked.tests
    table = want.read(folder, _UNIT_KEYS)
    for column, value in want.where.items():
        if isinstance(value, str):
            cells: Any = table.texts(column, "where")
        else:
            cells = table.numbers(column, key="where")
        kept = [row for row, cell in enumerate(cells) if cell == value]
        table = replace(table, rows=[table.rows[row] for row in kept], lines=table.lines[kept])
    count = len(table)
    if not count:
        raise TableError(f"{table.name}: tests.where selects no row", "where")
    # a column, or the geometric mean of two sieves
    sieves = ("diameter",) if want.diameter else ("mesh_lower", "mesh_upper")
    ends = [
        table.numbers(getattr(want, key), "length", want.diameter_unit, key=key) for key in sieves
    ]
    diameter = np.sqrt(ends[0] * ends[-1])
    particles = blows = np.ones(count)
    if want.particles:
        particles = table.numbers(want.particles, key="particles")
    if want.blows:
        blows = table.numbers(want.blows, key="blows")
    if want.broken:
        broken = table.numbers(want.broken, key="broken")
    else:
        allowed = f"one of {', '.join(_BROKE)}"
        broken = table.flags(want.outcome, "outcome", allowed, _BROKE) * particles
    rig = np.full(count, want.rig)
    if want.rig_column:
        rig = np.array(table.texts(want.rig_column, "rig_column"))
    at_failure = np.isin(rig, AT_FAILURE)
    # rows of one name are the series of blows on one particle
    specimen = pd.Series(range(count))
    if want.specimen:
        specimen = pd.Series(pd.factorize(np.array(table.texts(want.specimen, "specimen")))[0])
    for message, wrong in {
        f"rig must be one of {', '.join(RIGS)}": ~np.isin(rig, RIGS),
        "the size must be above 0": np.min(ends, axis=0) <= 0.0,
        "particles must be a whole number of at least 1": (particles % 1 > 0) | (particles < 1),
        "broken must be between 0 and particles": (broken < 0) | (broken > particles),
        f"blows must be from 1 to {_MOST_BLOWS:,}": (blows < 1) | (blows > _MOST_BLOWS),
        "a press tests a particle once: blows need drop_weight, impact or drop": at_failure
        & (blows > 1),
        "a specimen is hit again after it broke": specimen.duplicated(keep="last").to_numpy()
        & (broken > 0),
        "a specimen that is hit again must be one particle": specimen.duplicated(
            keep=False
        ).to_numpy()
        & (particles > 1),
    }.items():
        table.refuse("", message, wrong)
    energy, notes = particle_energies(asked, table, diameter, rig)
    table.finish()
    # every blow, by specimen and number
    struck = specimen.repeat(blows.astype(int).tolist())
    number = struck.groupby(struck).cumcount()
    series = np.zeros((struck.max() + 1, number.max() + 1))
    series[struck, number] = energy[struck.index]
    # groups have broken and whole particles
    last = specimen.index.to_series().groupby(specimen).last().to_numpy()
    numbers = np.column_stack([broken, particles - broken])[last]
    places, whole = np.nonzero(numbers)
    rows = last[places]
    broke = whole == 0
    tests = Specimens(
        diameter=diameter[rows],
        blows=series[places],
        broke=broke,
        exact=broke & at_failure[rows] & ~series[places, 1:].any(axis=1),
        weight=numbers[places, whole],
        notes=table.notes + notes + _odd_rows(table, diameter, energy),
    )
    if not tests.broke.any():
        raise UsageError(
            "every particle survived: nothing bounds the fracture energy from above; test at "
            "higher energies"
        )
    if (tests.broke & ~tests.exact & ~tests.repeated).all():
        raise UsageError(
            "every particle broke at its first blow: nothing bounds it from below; test at lower "
            "energies"
        )
    return tests


def _odd_rows(table: Table, diameter: Array, energy: Array) -> list[str]:
    """A note on sizes that are unusual, else on rows 5 robust deviations from a line of ln e over
    ln d.
    """
    least, most = lookup("sphere.radius").plausible
    odd = (diameter < 2.0 * least) | (diameter > 2.0 * most)
    what = "the size is unusual"
    if len(table) >= 8 and not odd.any():
        x = np.log(diameter)
        left = np.log(energy)
        if np.ptp(x) > 0.05:
            left -= np.polyfit(x, left, 1)[0] * x
        away = np.abs(left - np.median(left))
        odd = away > 5.0 * max(1.4826 * np.median(away), 0.05)
        what = "the energy lies far from the others"
    if not odd.any():
        return []
    lines = ", ".join(map(str, table.lines[odd][:8]))
    return [f"line {lines}: {what}: is its unit right?"]

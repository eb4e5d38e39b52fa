"""Tests of single particles: between which energies the first fracture energy of every specimen
lies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.errors import UsageError
from uqsphere.labs.comminution import laws
from uqsphere.labs.comminution.document import ComminutionDocument, TestsTable
from uqsphere.labs.comminution.energies import particle_energies
from uqsphere.tables import Table, read_table

#: rigs that record the energy at failure; the others record the energy offered
AT_FAILURE: Final = ("platens", "load_cell", "bars")
_OFFERING: Final = ("drop_weight", "impact", "drop")
_BROKE: Final = {
    "broke": True,
    "broken": True,
    "1": True,
    "yes": True,
    "true": True,
    "survived": False,
    "0": False,
    "no": False,
    "false": False,
    "stopped": False,
}
#: relative difference within which two sizes are the same
_SAME: Final = 0.005
_MOST_BLOWS: Final = 10_000


@dataclass(frozen=True, kw_only=True, eq=False)
class Specimens:
    """Specimens (s,) with the blows (s, K) [J/kg] that each had, 0 for none.

    broke : whether the last blow broke it.
    exact : whether its energy at failure is known.
    weight : number of such particles.
    """

    diameter: Array
    blows: Array
    broke: Flags
    exact: Flags
    weight: Array
    notes: tuple[str, ...] = ()

    @property
    def last(self) -> Array:
        """(s,) energy of the last blow [J/kg]."""
        return np.asarray(self.blows[np.arange(len(self.blows)), self._last_blow])

    @property
    def _last_blow(self) -> Places:
        return np.asarray(np.maximum((self.blows > 0).sum(axis=1) - 1, 0))

    @property
    def repeated(self) -> Flags:
        """(s,) whether a specimen was hit more than once."""
        return np.asarray((self.blows > 0).sum(axis=1) > 1)

    @property
    def sizes(self) -> tuple[float, ...]:
        """The tested sizes [m], rising."""
        ordered = np.sort(self.diameter)
        parts = np.split(ordered, np.flatnonzero(np.diff(np.log(ordered)) > _SAME) + 1)
        return tuple(float(np.exp(np.log(part).mean())) for part in parts)

    def bounds(self, gamma: Array) -> tuple[Array, Array]:
        """(low, high] of the first fracture energy (..., s) for gamma (...); equal where it is
        known exactly."""
        exponent = np.asarray(gamma, dtype=float)[..., None]
        before = self.blows.copy()
        before[np.arange(len(before)), self._last_blow] = 0.0
        survived = laws.survivor_bound(np.where(self.broke[:, None], before, self.blows), exponent)
        ended = np.where(self.broke, laws.survivor_bound(self.blows, exponent), np.inf)
        known = self.exact & self.broke
        return np.where(known, self.last, survived), np.where(known, self.last, ended)


@dataclass(frozen=True, kw_only=True, eq=False)
class _Rows:
    """Rows (n,) of a table of tests.

    names : specimens; at_failure : whether the energy is that at failure; particles, broken :
    numbers of particles; blows : equal blows of the row.
    """

    table: Table
    names: list[str]
    diameter: Array
    energy: Array
    at_failure: Flags
    particles: Array
    broken: Array
    blows: Places


@dataclass(frozen=True, kw_only=True)
class _Specimen:
    """One specimen, or several alike: its blows [J/kg] in order."""

    diameter: float
    blows: list[float]
    broke: bool
    exact: bool
    weight: float


def load_tests(asked: ComminutionDocument, folder: Path) -> Specimens:
    """The specimens of the table of an input file.

    Raises UsageError with the lines of impossible rows, and for tests that bound no energy.
    """
    want = asked.tests
    table = _chosen(read_table(folder / want.file), want)
    diameter = _diameters(table, want)
    particles = blows = np.ones(len(diameter))
    if want.particles is not None:
        particles = table.numbers(want.particles)
    if want.blows is not None:
        blows = table.numbers(want.blows)
    if want.broken is not None:
        broken = table.numbers(want.broken)
    else:
        allowed = f"one of {', '.join(_BROKE)}"
        broken = table.flags(str(want.outcome), "outcome", _BROKE, allowed) * particles
    rig = np.full(len(diameter), want.rig)
    if want.rig_column is not None:
        rig = np.array(table.texts(want.rig_column))
    at_failure = np.isin(rig, AT_FAILURE)
    complete = ~np.isnan(diameter + particles + broken + blows)

    def refuse(text: str, wrong: Flags) -> None:
        table.refuse("", text, np.asarray(wrong & complete))

    rigs = (*AT_FAILURE, *_OFFERING)
    refuse(f"rig must be one of {', '.join(rigs)}", ~np.isin(rig, rigs))
    refuse("the size must be above 0", diameter <= 0.0)
    whole = particles == np.round(particles)
    refuse("particles must be a whole number of at least 1", ~whole | (particles < 1))
    refuse("broken must be between 0 and particles", (broken < 0) | (broken > particles))
    refuse(f"blows must be from 1 to {_MOST_BLOWS:,}", (blows < 1) | (blows > _MOST_BLOWS))
    refuse(
        "a press tests a particle once: blows need drop_weight, impact or drop",
        at_failure & (blows > 1),
    )
    energy, notes = particle_energies(asked, table, diameter, rig)
    table.refuse("", "the energy must be above 0", energy <= 0.0)
    names = [str(row) for row in range(len(energy))]
    if want.specimen is not None:
        names = table.texts(want.specimen)
    table.finish()
    rows = _Rows(
        table=table,
        names=names,
        diameter=diameter,
        energy=energy,
        at_failure=at_failure,
        particles=particles,
        broken=broken,
        blows=blows.astype(int),
    )
    made = _specimens(rows, [*table.notes, *notes, *_odd_rows(rows)])
    _check_bounded(made)
    return made


def _chosen(table: Table, want: TestsTable) -> Table:
    """The rows that `tests.where` selects."""
    for column, value in want.where.items():
        cells = table.texts(column) if isinstance(value, str) else table.numbers(column)
        kept = [row for row, cell in enumerate(cells) if cell == value]
        table = replace(
            table,
            rows=[table.rows[row] for row in kept],
            lines=[table.lines[row] for row in kept],
        )
    if not len(table):
        raise UsageError(f"{table.name}: tests.where selects no row")
    return table


def _diameters(table: Table, want: TestsTable) -> Array:
    """Diameters (n,) [m]: a column, or the geometric mean of two sieves."""
    unit = want.diameter_unit or None
    if want.diameter is not None:
        return table.numbers(want.diameter, "length", unit, key="diameter")
    lower = table.numbers(str(want.mesh_lower), "length", unit, key="diameter")
    upper = table.numbers(str(want.mesh_upper), "length", unit, key="diameter")
    return np.asarray(np.sqrt(lower * upper))


def _odd_rows(rows: _Rows) -> list[str]:
    """A note on rows 5 robust deviations from a line of ln e over ln d."""
    if len(rows.energy) < 8:
        return []
    x, y = np.log(rows.diameter), np.log(rows.energy)
    slope, middle = 0.0, float(np.median(y))
    if np.ptp(x) > 0.05:
        slope, middle = np.polyfit(x, y, 1)
    left = y - middle - slope * x
    away = np.abs(left - np.median(left))
    odd = away > 5.0 * max(1.4826 * float(np.median(away)), 0.05)
    if not odd.any():
        return []
    lines = ", ".join(map(str, np.array(rows.table.lines)[odd][:8]))
    return [f"line {lines}: the energy lies far from the others: is its unit right?"]


def _specimens(rows: _Rows, notes: list[str]) -> Specimens:
    """Rows of one name as the series of blows on one particle; groups as broken and unbroken
    ones."""
    order: dict[str, list[int]] = {}
    for row, name in enumerate(rows.names):
        order.setdefault(name, []).append(row)
    specimens: list[_Specimen] = []
    for group in order.values():
        _check_series(rows, group)
        blows: list[float] = []
        for row in group:
            blows += [float(rows.energy[row])] * int(rows.blows[row])
        last = group[-1]
        broken, survived = rows.broken[last], rows.particles[last] - rows.broken[last]
        for number, broke in ((broken, True), (survived, False)):
            if number > 0:
                specimens.append(
                    _Specimen(
                        diameter=float(rows.diameter[last]),
                        blows=blows,
                        broke=broke,
                        exact=bool(rows.at_failure[last]) and len(blows) == 1,
                        weight=float(number),
                    )
                )
    every = np.zeros((len(specimens), max(len(specimen.blows) for specimen in specimens)))
    for row, specimen in enumerate(specimens):
        every[row, : len(specimen.blows)] = specimen.blows
    return Specimens(
        diameter=np.array([specimen.diameter for specimen in specimens]),
        blows=every,
        broke=np.array([specimen.broke for specimen in specimens]),
        exact=np.array([specimen.exact for specimen in specimens]),
        weight=np.array([specimen.weight for specimen in specimens]),
        notes=tuple(notes),
    )


def _check_series(rows: _Rows, group: list[int]) -> None:
    """Refuse blows on a broken particle, and on several at once."""
    table = rows.table
    if len(group) == 1:
        return
    early = [row for row in group[:-1] if rows.broken[row] > 0]
    if early:
        raise UsageError(
            f"{table.name}: line {table.lines[early[0]]}: a specimen is hit again after it broke"
        )
    if (rows.particles[group] > 1).any():
        raise UsageError(
            f"{table.name}: line {table.lines[group[0]]}: a specimen that is hit again must be one "
            "particle"
        )


def _check_bounded(tests: Specimens) -> None:
    """Refuse tests that leave the fracture energy open on one side."""
    if not tests.broke.any():
        raise UsageError(
            "every particle survived: nothing bounds the fracture energy from above; test at "
            "higher energies"
        )
    if tests.broke.all() and not tests.exact.any() and not tests.repeated.any():
        raise UsageError(
            "every particle broke at its first blow: nothing bounds it from below; test at lower "
            "energies"
        )

"""Tests of single particles: between which energies the first fracture energy of every specimen
lies."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from uqsphere.arrays import Array, Flags
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
        return np.asarray((self.blows * self._is_last).sum(axis=1))

    @property
    def _is_last(self) -> Flags:
        """(s, K) whether a blow is the last one of its specimen."""
        number = (self.blows > 0).sum(axis=1, keepdims=True)
        return np.asarray(np.arange(self.blows.shape[1]) == np.maximum(number - 1, 0))

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
        breaking = self._is_last & self.broke[:, None]
        survived = laws.survivor_bound(np.where(breaking, 0.0, self.blows), exponent)
        ended = np.where(self.broke, laws.survivor_bound(self.blows, exponent), np.inf)
        known = self.exact & self.broke
        return np.where(known, self.last, survived), np.where(known, self.last, ended)


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
    rigs = (*AT_FAILURE, *_OFFERING)
    whole = particles == np.round(particles)
    for message, wrong in {
        f"rig must be one of {', '.join(rigs)}": ~np.isin(rig, rigs),
        "the size must be above 0": diameter <= 0.0,
        "particles must be a whole number of at least 1": ~whole | (particles < 1),
        "broken must be between 0 and particles": (broken < 0) | (broken > particles),
        f"blows must be from 1 to {_MOST_BLOWS:,}": (blows < 1) | (blows > _MOST_BLOWS),
        "a press tests a particle once: blows need drop_weight, impact or drop": at_failure
        & (blows > 1),
    }.items():
        table.refuse("", message, wrong & complete)
    energy, notes = particle_energies(asked, table, diameter, rig)
    table.refuse("", "the energy must be above 0", energy <= 0.0)
    names = [str(row) for row in range(len(energy))]
    if want.specimen is not None:
        names = table.texts(want.specimen)
    table.finish()
    rows = pd.DataFrame(
        {
            "line": table.lines,
            "diameter": diameter,
            "energy": energy,
            "at_failure": at_failure,
            "particles": particles,
            "broken": broken,
            "blows": blows.astype(int),
        }
    )
    made = _specimens(rows, names, table.name)
    _check_bounded(made)
    return replace(made, notes=(*table.notes, *notes, *_odd_rows(rows)))


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
    sieves = [want.diameter]
    if want.diameter is None:
        sieves = [want.mesh_lower, want.mesh_upper]
    unit = want.diameter_unit or None
    sizes = [table.numbers(str(name), "length", unit, key="diameter") for name in sieves]
    return np.asarray(np.sqrt(sizes[0] * sizes[-1]))


def _odd_rows(rows: pd.DataFrame) -> list[str]:
    """A note on rows 5 robust deviations from a line of ln e over ln d."""
    if len(rows) < 8:
        return []
    x, y = np.log(rows["diameter"].to_numpy()), np.log(rows["energy"].to_numpy())
    slope, middle = 0.0, float(np.median(y))
    if np.ptp(x) > 0.05:
        slope, middle = np.polyfit(x, y, 1)
    left = y - middle - slope * x
    away = np.abs(left - np.median(left))
    odd = away > 5.0 * max(1.4826 * float(np.median(away)), 0.05)
    if not odd.any():
        return []
    lines = ", ".join(map(str, rows["line"][odd][:8]))
    return [f"line {lines}: the energy lies far from the others: is its unit right?"]


def _specimens(rows: pd.DataFrame, names: list[str], file: str) -> Specimens:
    """Rows of one name as the series of blows on one particle; groups as broken and unbroken
    ones."""
    series, specimens = list[Array](), list[dict[str, Any]]()
    for _, group in rows.groupby(pd.Index(names), sort=False):
        early = group[:-1][group["broken"][:-1] > 0]
        if len(early):
            raise UsageError(
                f"{file}: line {early['line'].iloc[0]}: a specimen is hit again after it broke"
            )
        if len(group) > 1 and (group["particles"] > 1).any():
            raise UsageError(
                f"{file}: line {group['line'].iloc[0]}: a specimen that is hit again must be one "
                "particle"
            )
        blows, last = np.repeat(group["energy"].to_numpy(), group["blows"]), group.iloc[-1]
        numbers = {True: last["broken"], False: last["particles"] - last["broken"]}
        exact = last["at_failure"] and len(blows) == 1
        for broke, number in numbers.items():
            if number > 0:
                series.append(blows)
                specimens.append(
                    {"diameter": last["diameter"], "broke": broke, "exact": exact, "weight": number}
                )
    every = np.zeros((len(series), max(map(len, series))))
    for row, blows in zip(every, series, strict=True):
        row[: len(blows)] = blows
    columns: dict[str, Any] = {
        str(name): column.to_numpy() for name, column in pd.DataFrame(specimens).items()
    }
    return Specimens(blows=every, **columns)


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

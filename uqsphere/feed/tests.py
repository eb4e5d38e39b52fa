"""Tests of single particles: what each specimen went through, and between which energies its fracture energy lies.

A row is one blow or one compression.  Of platens, load cells and bars it gives the energy at failure, so that the
first fracture energy e of the particle is known; of weights and throws it gives what was offered, so that e lies at or
below it (broke) or above it (survived).  Rows of the same specimen are blows on the same particle, in their order.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags, Values
from uqsphere.feed import laws
from uqsphere.mechanics import contact

#: rigs by their names, and whether the energy of a row is that at failure (else what was offered)
TEST_RIGS: Final = {
    "platens": True, "load_cell": True, "bars": True,
    "drop_weight": False, "impact": False, "drop": False, "sphere_on_sphere": False,
}  # fmt: skip
#: rigs in which the particle itself is thrown: of what is offered it takes its share of the contact
THROWN: Final = ("impact", "drop", "sphere_on_sphere")
#: sizes that differ by no more than this are one: what a caliper tells apart on a lump
SAME_SIZE: Final = 0.005
#: blows that one specimen can have had in one row
MOST_BLOWS: Final = 10_000


@dataclass(frozen=True, kw_only=True)
class RowFault:
    """A row of a table of tests that cannot be: `row` counts from 0, `key` names the column."""

    row: int
    key: str
    message: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows:
    """A table of tests in SI, (n,) each: `energy` [J/kg] is the particle's own, `broken` of `particles` broke.

    `specimen` numbers the particles; rows of one number are blows on one particle.
    """

    rig: npt.NDArray[np.str_]
    diameter: Array
    energy: Array
    particles: npt.NDArray[np.int64]
    broken: npt.NDArray[np.int64]
    blows: npt.NDArray[np.int64]
    specimen: npt.NDArray[np.int64]


@dataclass(frozen=True, kw_only=True, eq=False)
class Specimens:
    """Specimens with the series of blows that each had, (s,) and (s, K).

    diameter [m] : (s,);  weight : how many particles alike a specimen stands for
    energies [J/kg], counts : (s, K) blows in their order, 0 where there is none
    broke : whether the last of them broke it;  exact : whether its energy at failure is known
    """

    diameter: Array
    energies: Array
    counts: npt.NDArray[np.int64]
    broke: Flags
    exact: Flags
    weight: Array

    def __len__(self) -> int:
        return len(self.diameter)

    @property
    def particles(self) -> int:
        """How many particles were tested."""
        return int(self.weight.sum())

    @property
    def repeated(self) -> Flags:
        """(s,) whether a specimen was hit more than once."""
        return np.asarray(self.counts.sum(axis=1) > 1)

    @property
    def last(self) -> Array:
        """(s,) energy of the last blow [J/kg]."""
        at = np.maximum((self.counts > 0).sum(axis=1) - 1, 0)
        return np.asarray(self.energies[np.arange(len(self)), at])

    @property
    def before(self) -> npt.NDArray[np.int64]:
        """(s, K) counts without the row that ended the series: blows that are known to have been survived."""
        at = np.maximum((self.counts > 0).sum(axis=1) - 1, 0)
        counts = self.counts.copy()
        counts[np.arange(len(self)), at] = 0
        return counts

    @property
    def sizes(self) -> tuple[float, ...]:
        """The sizes that were tested [m], those that differ by less than `SAME_SIZE` as one, in rising order."""
        ordered = np.sort(self.diameter)
        parts = np.split(ordered, np.flatnonzero(np.diff(np.log(ordered)) > SAME_SIZE) + 1)
        return tuple(float(p[0]) if p[0] == p[-1] else float(np.exp(np.log(p).mean())) for p in parts)

    def at(self, rows: npt.NDArray[np.int64] | Flags) -> Specimens:
        """Some of the specimens."""
        return Specimens(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})

    def join(self, other: Specimens) -> Specimens:
        """These specimens and others, of as many blows at the most."""
        pairs = ((field.name, getattr(self, field.name), getattr(other, field.name)) for field in fields(self))
        return Specimens(**{name: np.concatenate([own, more]) for name, own, more in pairs})

    def gathered(self) -> Specimens:
        """Specimens that are alike taken together, by their weights."""
        table = np.column_stack([self.diameter, self.broke, self.exact, self.energies, self.counts])
        _, first, place = np.unique(table, axis=0, return_index=True, return_inverse=True)
        weight = np.bincount(place.ravel(), weights=self.weight)
        order = np.argsort(first)
        return replace(self.at(first[order]), weight=np.asarray(weight[order], dtype=float))


def make_specimens(diameter: Values, energy: Values, *, broke: Values = True, exact: Values = True) -> Specimens:
    """Tests of one blow each, every one on a particle of its own.

    >>> made = make_specimens([0.01, 0.02], [100.0, 50.0], broke=[True, False])
    >>> made.sizes, made.particles
    ((0.01, 0.02), 2)
    """
    d, e, b, x = np.broadcast_arrays(np.asarray(diameter, dtype=float), np.asarray(energy, dtype=float), broke, exact)
    return Specimens(diameter=d.copy(), energies=e[:, None].copy(), counts=np.ones((d.size, 1), dtype=np.int64),
                 broke=b.astype(bool), exact=x.astype(bool), weight=np.ones(d.size))  # fmt: skip


def specimens_of(rows: Rows) -> Specimens:
    """The specimens of a table that `faults_of` finds nothing wrong with."""
    _, first, place = np.unique(rows.specimen, return_index=True, return_inverse=True)
    order = np.argsort(place, kind="stable")
    parts = np.split(order, np.flatnonzero(np.diff(place[order])) + 1)
    at_failure = np.isin(rows.rig, [rig for rig, known in TEST_RIGS.items() if known])
    if all(len(part) == 1 for part in parts):
        base = Specimens(diameter=rows.diameter, energies=rows.energy[:, None], counts=rows.blows[:, None],
                         broke=rows.broken > 0, exact=at_failure, weight=rows.particles.astype(float))  # fmt: skip
        return _with_both(base, rows.broken, rows.particles)
    longest = max(len(part) for part in parts)
    shape = (len(parts), longest)
    energies, counts = np.zeros(shape), np.zeros(shape, dtype=np.int64)
    last = np.array([part[-1] for part in parts])
    for k, part in enumerate(parts):
        energies[k, : len(part)], counts[k, : len(part)] = rows.energy[part], rows.blows[part]
    alone = np.array([len(part) == 1 for part in parts])
    base = Specimens(
        diameter=rows.diameter[first], energies=energies, counts=counts, broke=rows.broken[last] > 0,
        exact=at_failure[last] & (alone | (rows.broken[last] == 0)),
        weight=rows.particles[last].astype(float),
    )  # fmt: skip
    return _with_both(base, rows.broken[last], rows.particles[last])


def _with_both(tests: Specimens, broken: npt.NDArray[np.int64], particles: npt.NDArray[np.int64]) -> Specimens:
    """Of particles alike those that broke and those that did not, each by its weight."""
    mixed = (broken > 0) & (broken < particles)
    survived = replace(tests.at(mixed), broke=np.zeros(int(mixed.sum()), dtype=bool),
                       weight=(particles - broken)[mixed].astype(float))  # fmt: skip
    return replace(tests, weight=np.where(broken > 0, broken, particles).astype(float)).join(survived)


def faults_of(rows: Rows) -> list[RowFault]:
    """Every row that cannot be: an energy of nothing, more broken than there were, a particle hit after it broke."""
    plain = (
        ("diameter", ~(np.isfinite(rows.diameter) & (rows.diameter > 0.0)), "the size must be above 0"),
        ("energy", ~(np.isfinite(rows.energy) & (rows.energy > 0.0)), "the energy must be above 0"),
        ("particles", rows.particles < 1, "particles must be 1 or more"),
        ("broken", (rows.broken > rows.particles) | (rows.broken < 0), "broken must lie from 0 to particles"),
        ("blows", (rows.blows < 1) | (rows.blows > MOST_BLOWS), f"blows must lie from 1 to {MOST_BLOWS:,}"),
        ("blows", (rows.rig == "platens") & (rows.blows > 1), "platens press once: blows belong to weights and throws"),
    )
    found = [
        RowFault(row=int(row), key=key, message=message)
        for key, wrong, message in plain
        for row in np.flatnonzero(wrong)
    ]
    ended: set[int] = set()
    again = np.bincount(rows.specimen, minlength=1)[rows.specimen] > 1
    for row in np.flatnonzero(again).tolist():
        one = int(rows.specimen[row])
        if one in ended:
            found.append(RowFault(row=row, key="specimen", message="this specimen is hit again after it broke"))
        elif rows.particles[row] > 1:
            said = "a specimen that is hit again is one particle"
            found.append(RowFault(row=row, key="particles", message=said))
        if rows.broken[row]:
            ended.add(one)
    return sorted(found, key=lambda fault: fault.row)


def particle_energy(
    kind: str, measured: Values, *, rig: Sequence[str], meaning: str, mass: Array, diameter: Array, share: Values,
    stiffness: Values = np.nan,
) -> Array:  # fmt: skip
    """e [J/kg] that the particle itself takes up, of what a table has, (n,).

    kind : "energy" [J], "specific_energy" [J/kg], "speed" [m/s] or "force" [N]
    meaning : "sphere" (its own), "contact" (all bodies of all contacts), "input" (what was offered)
    share : the particle's share of the energy of a contact, `laws.particle_share`
    stiffness : K_e = E* [Pa] of the contact, for forces

    A force is a contact energy by Hertz, a speed is offered.  Of an offered energy a particle that is thrown takes its
    share, as it does between slow platens; a weight's is credited to it whole, as the drop-weight test does.
    """
    value = np.asarray(measured, dtype=float)
    if kind == "force":
        density = mass / contact.sphere_mass(0.5 * diameter, 1.0)
        found, meaning = laws.energy_of_force(value, diameter, stiffness, density), "contact"
    elif kind == "speed":
        found, meaning = 0.5 * value * value, "input"
    else:
        found = value / mass if kind == "energy" else value
    if meaning == "sphere":
        return np.asarray(found)
    whole = np.asarray([meaning == "input" and one == "drop_weight" for one in rig])
    return np.asarray(np.where(whole, found, found * share))


def unbounded(tests: Specimens) -> str:
    """Why tests bound no law, in words; empty where they do."""
    if not tests.broke.any():
        return "every particle survived: nothing bounds the fracture energy from above"
    if tests.broke.all() and not tests.exact.any() and not tests.before.any():
        return "every particle broke at what it was offered: nothing bounds the fracture energy from below"
    return ""

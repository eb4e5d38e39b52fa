"""Tests of single particles: between which energies the first fracture energy of every specimen
lies.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags
from uqsphere.errors import UsageError
from uqsphere.labs.comminution import laws
from uqsphere.labs.comminution.document import ComminutionDocument, Elastic
from uqsphere.tables import Table, read_table

#: rigs whose energy is that at failure; in the others it is what was offered
AT_FAILURE: Final = ("platens", "load_cell", "bars")
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
#: sizes that differ by no more than this are one
_SAME: Final = 0.005


@dataclass(frozen=True, kw_only=True, eq=False)
class Specimens:
    """Specimens (s,) with the blows (s, K) [J/kg] that each had, 0 for none; NaN-free.

    broke : whether the last blow broke it;  exact : whether its energy at failure is known;  weight
        : particles alike.
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
        at = np.maximum((self.blows > 0).sum(axis=1) - 1, 0)
        return np.asarray(self.blows[np.arange(len(self.blows)), at])

    @property
    def repeated(self) -> Flags:
        """(s,) whether a specimen was hit more than once."""
        return np.asarray((self.blows > 0).sum(axis=1) > 1)

    @property
    def sizes(self) -> tuple[float, ...]:
        """The sizes that were tested [m], rising."""
        ordered = np.sort(self.diameter)
        parts = np.split(ordered, np.flatnonzero(np.diff(np.log(ordered)) > _SAME) + 1)
        return tuple(float(np.exp(np.log(part).mean())) for part in parts)

    def bounds(self, gamma: Array) -> tuple[Array, Array]:
        """(low, high] of the first fracture energy (..., s) for gamma (...); equal where it is
        known exactly.
        """
        g = np.asarray(gamma, dtype=float)[..., None]
        before = self.blows.copy()
        at = np.maximum((self.blows > 0).sum(axis=1) - 1, 0)
        before[np.arange(len(before)), at] = 0.0
        survived = laws.survivor_bound(np.where(self.broke[:, None], before, self.blows), g)
        ended = np.where(self.broke, laws.survivor_bound(self.blows, g), np.inf)
        known = self.exact & self.broke
        return np.where(known, self.last, survived), np.where(known, self.last, ended)


def load_tests(asked: ComminutionDocument, folder: Path) -> Specimens:
    """The specimens of the table of an input file; UsageError with the lines of rows that cannot
    be.
    """
    table, want = read_table(folder / asked.tests.file), asked.tests
    for column, value in want.where.items():
        texts = table.texts(column) if isinstance(value, str) else table.numbers(column)
        kept = [k for k, cell in enumerate(texts) if cell == value]
        table = replace(
            table, rows=[table.rows[k] for k in kept], lines=[table.lines[k] for k in kept]
        )
    if not len(table):
        raise UsageError(f"{table.name}: no row is left (tests.where)")
    if want.diameter is not None:
        diameter = table.numbers(
            want.diameter, "length", want.diameter_unit or None, key="diameter"
        )
    else:
        low, high = (
            table.numbers(str(c), "length", want.diameter_unit or None, key="diameter")
            for c in (want.mesh_lower, want.mesh_upper)
        )
        diameter = np.sqrt(low * high)
    one = np.ones(len(diameter))
    particles = one if want.particles is None else table.numbers(want.particles)
    count = one if want.blows is None else table.numbers(want.blows)
    if want.broken is not None:
        broken = table.numbers(want.broken)
    else:
        broken = (
            table.flags(str(want.outcome), "outcome", _BROKE, f"one of {', '.join(_BROKE)}")
            * particles
        )
    rig = (
        np.full(len(diameter), want.rig)
        if want.rig_column is None
        else np.array(table.texts(want.rig_column))
    )
    known = (*AT_FAILURE, "drop_weight", "impact", "drop")
    for wrong, text in (
        (~np.isin(rig, known), f"rig: one of {', '.join(known)}"),
        (diameter <= 0.0, "the size must be above 0"),
        (
            (particles < 1) | (particles != np.round(particles)),
            "particles: a whole number of 1 or more",
        ),
        ((broken < 0) | (broken > particles), "broken lies from 0 to particles"),
        ((count < 1) | (count > 10_000), "blows lie from 1 to 10,000"),
        (
            np.isin(rig, AT_FAILURE) & (count > 1),
            "a press tests once: blows belong to weights and throws",
        ),
    ):
        table.refuse("", text, np.asarray(wrong) & ~np.isnan(diameter + particles + broken + count))
    energy, notes = _energies(asked, table, diameter, rig)
    table.refuse("", "the energy must be above 0", energy <= 0.0)
    names = (
        [str(k) for k in range(len(energy))]
        if want.specimen is None
        else table.texts(want.specimen)
    )
    table.finish()
    notes = [*table.notes, *notes, *_odd_rows(table, diameter, energy)]
    return _specimens(
        table,
        names,
        diameter,
        energy,
        np.isin(rig, AT_FAILURE),
        particles,
        broken,
        count.astype(int),
        notes,
    )


def stiffness(body: Elastic) -> float:
    """k = E/(1 - nu²) [Pa] of a body; UsageError where it has none."""
    if body.E is None or body.nu is None:
        raise UsageError(
            "material, tests.partner and feed.impact_surface need E and nu, or a material of the "
            "library"
        )
    return body.E / (1.0 - body.nu**2)


def _energies(
    asked: ComminutionDocument, table: Table, diameter: Array, rig: np.ndarray
) -> tuple[Array, list[str]]:
    """The particle's own energy per mass [J/kg] of every row."""
    want, own, notes = asked.tests, asked.material, []
    if want.mass is not None:
        mass = table.numbers(want.mass, "mass", want.mass_unit or None, key="mass")
    else:
        if own.density is None:
            raise UsageError("material.density is required, or a column tests.mass")
        mass = laws.mass_of(diameter, own.density)
    share = 1.0
    partner = want.partner
    if partner is not None:
        share = laws.particle_share(stiffness(own), stiffness(partner))
    meaning = want.energy_is
    if want.specific_energy is not None:
        found = table.numbers(
            want.specific_energy, "specific_energy", want.unit or None, key="energy"
        )
    elif want.energy is not None:
        found = table.numbers(want.energy, "energy", want.unit or None, key="energy") / mass
    elif want.speed is not None:
        found, meaning = (
            0.5 * table.numbers(want.speed, "speed", want.unit or None, key="energy") ** 2,
            "input",
        )
    else:
        assert want.force is not None
        force, meaning = (
            table.numbers(want.force, "force", want.unit or None, key="energy"),
            "contact",
        )
        if want.stiffness is not None:
            modulus = table.numbers(
                want.stiffness, "pressure", want.stiffness_unit or None, key="stiffness"
            )
        else:
            compliance = 1.0 / stiffness(own) + (
                1.0 / stiffness(partner) if partner is not None else 0.0
            )
            modulus = np.full(len(force), 1.0 / compliance)
            notes.append(
                "the stiffness of intact rock is assumed: energies of broken rock are 2 to 3 "
                "times larger"
            )
        found = laws.energy_of_force(force, diameter, modulus, mass)
    if meaning == "sphere":
        return found, notes
    if partner is None and meaning == "contact":
        notes.append(
            "no tests.partner: the whole energy of the contacts is taken as the particle's own"
        )
    # a falling weight's energy is credited to the particle whole, as the drop-weight test does
    taken = np.where((meaning == "input") & (rig == "drop_weight"), 1.0, share)
    return found * taken, notes


def _odd_rows(table: Table, diameter: Array, energy: Array) -> list[str]:
    """Rows that lie 5 robust deviations from a line of ln e over ln d."""
    if len(energy) < 8:
        return []
    x, y = np.log(diameter), np.log(energy)
    slope, middle = np.polyfit(x, y, 1) if np.ptp(x) > 0.05 else (0.0, float(np.median(y)))
    left = y - middle - slope * x
    scale = 1.4826 * float(np.median(np.abs(left - np.median(left))))
    odd = np.abs(left - np.median(left)) > 5.0 * max(scale, 0.05)
    lines = ", ".join(map(str, np.array(table.lines)[odd][:8]))
    return (
        [f"line {lines}: the energy lies far from the others: is its unit right?"]
        if odd.any()
        else []
    )


def _specimens(
    table: Table,
    names: list[str],
    diameter: Array,
    energy: Array,
    known: Flags,
    particles: Array,
    broken: Array,
    count: np.ndarray,
    notes: list[str],
) -> Specimens:
    """Rows of one name as the series of blows on one particle; groups as those that broke and those
    that did not.
    """
    lines = table.lines
    order: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        order.setdefault(name, []).append(k)
    found: list[tuple[float, list[float], bool, bool, float]] = []
    for group in order.values():
        if len(group) > 1:
            early = [k for k in group[:-1] if broken[k] > 0]
            if early:
                raise UsageError(
                    f"{table.name}: line {lines[early[0]]}: a specimen is hit again after it broke"
                )
            if (particles[group] > 1).any():
                raise UsageError(
                    f"{table.name}: line {lines[group[0]]}: a specimen hit again is one particle"
                )
        series = [float(energy[k]) for k in group for _ in range(int(count[k]))]
        last = group[-1]
        exact = bool(known[last]) and len(series) == 1
        if broken[last] > 0:
            found.append((float(diameter[last]), series, True, exact, float(broken[last])))
        if broken[last] < particles[last]:
            found.append(
                (float(diameter[last]), series, False, exact, float(particles[last] - broken[last]))
            )
    blows = np.zeros((len(found), max(len(one[1]) for one in found)))
    for k, one in enumerate(found):
        blows[k, : len(one[1])] = one[1]
    made = Specimens(
        diameter=np.array([one[0] for one in found]),
        blows=blows,
        broke=np.array([one[2] for one in found]),
        exact=np.array([one[3] for one in found]),
        weight=np.array([one[4] for one in found]),
        notes=tuple(notes),
    )
    if not made.broke.any():
        raise UsageError(
            "every particle survived: nothing bounds its energy from above; test at higher energies"
        )
    if made.broke.all() and not made.exact.any() and not made.repeated.any():
        raise UsageError(
            "every particle broke at its first blow: nothing bounds it from below; test at lower "
            "energies"
        )
    return made

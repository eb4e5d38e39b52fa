"""Tables of tests of single particles: columns by the names that a study gives them, every faulty cell with its line.

One reader for [tests], which `uqsphere fit` makes a law of fracture energy from, and for strengths of a limit that are
read from tests (`uqsphere.study.sphere_tests`).
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags
from uqsphere.feed.tests import TEST_RIGS, THROWN, Rows, Specimens, faults_of, particle_energy, specimens_of, unbounded
from uqsphere.mechanics import contact
from uqsphere.study.columns import LARGEST_TESTS, Observations, open_observations, unit_factor
from uqsphere.study.document import Document
from uqsphere.study.faults import Findings, Misplaced, Place, Raw, one_of, shown, unknown
from uqsphere.study.numbers import plain_quantity, read_number
from uqsphere.study.particle_tables import ENERGY_OF, TestColumns, TestsTable, known_platens
from uqsphere.units import Quantity, UnitError, parse_value
from uqsphere.uq import Law

if TYPE_CHECKING:
    from uqsphere.feed.infer import Request
    from uqsphere.feed.likelihood import Prior
    from uqsphere.feed.product import Fineness
    from uqsphere.study.study import Particles

#: columns of which every row has one: dimension of each
MEASURED: Final = {"force": "force", "energy": "energy", "specific_energy": "specific_energy", "speed": "speed"}
_BROKE: Final = {"broke": True, "broken": True, "1": True, "yes": True, "true": True, "survived": False, "0": False,
                 "no": False, "false": False}  # fmt: skip


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """A table of tests as it stands, in SI, (n,) each; `kind` says which of `MEASURED` a row has its value in."""

    lines: npt.NDArray[np.int64]
    rig: npt.NDArray[np.str_]
    diameter: Array
    kind: npt.NDArray[np.str_]
    value: Array
    broken: npt.NDArray[np.int64]
    particles: npt.NDArray[np.int64]
    blows: npt.NDArray[np.int64]
    specimen: npt.NDArray[np.int64]
    mass: Array | None = None
    stiffness: Array | None = None
    rate: Array | None = None
    t10: Array | None = None
    sieves: tuple[float, ...] = ()
    passing: Array | None = None

    @property
    def at_failure(self) -> Flags:
        """Rows whose rig gives the energy at failure, not what was offered."""
        return np.array([TEST_RIGS[str(rig)] for rig in self.rig], dtype=bool)


def share_of(E: float, nu: float, partner: tuple[float, float]) -> float:
    """A particle's share of the energy of its contact with a partner of a Young's modulus and a Poisson ratio."""
    from uqsphere.feed.laws import particle_share

    return float(particle_share(E, nu, *partner))


@dataclass(frozen=True, kw_only=True, eq=False)
class TestsPlan:
    """What a study has of tests: the specimens, how they are fitted, the rows that were sieved, all in words."""

    specimens: Specimens
    request: Request
    rows: int
    of: Mapping[str, str]
    meaning: Mapping[str, Raw]
    fineness: Fineness | None = None


# --- the table --------------------------------------------------------------------------------------------


def read_measured(
    table: TestColumns, file: str, place: Place, findings: Findings, *, key: str = "file", rig: str | None = None
) -> Measured | None:
    """The columns of a table of tests; None, with every fault noted, where something is wrong.

    `rig` stands for one that the table does not name, whose tests all ended with a failure unless they say otherwise.
    """
    if not _check_table(table, place, findings, rig):
        return None
    found = None
    with findings.noting(place):
        cells = open_observations(file, findings.folder, key, LARGEST_TESTS)
        for column, text in table.where.items():
            own = cells.texts(column, "where")
            cells.lines = [line for line, cell in zip(cells.lines, own, strict=True) if cell == text]
        if not cells.lines:
            said = f" with {', '.join(f'{k} = {shown(v)}' for k, v in table.where.items())}" if table.where else ""
            raise Misplaced(f"{shown(cells.name)} has no row{said}", "where" if table.where else key)
        found = _columns(table, cells, rig)
        if not cells.report(place, findings):
            return None
    return found


def _check_table(table: TestColumns, place: Place, findings: Findings, rig: str | None) -> bool:
    """Whether the columns that must be named are, with their units; what is missing is noted."""
    kinds = [kind for kind in MEASURED if getattr(table, kind) is not None]
    energies = bool({"energy", "specific_energy"} & set(kinds))
    sized = table.diameter is not None or None not in (table.mesh_lower, table.mesh_upper)
    due = {
        "diameter": (sized, 'add diameter = "diameter_mm", or one length, or mesh_lower and mesh_upper'),
        "energy": (bool(kinds), f"name the column of one of {one_of(MEASURED)}"),
        "rig": ((rig or table.rig) is not None, f"say what the tests were made in, {one_of(TEST_RIGS)}"),
        "outcome": ((rig or table.outcome or table.broken) is not None, 'name a column of "broke" or "survived"'),
        "energy_is": (not energies or table.energy_is is not None, f"say what the energies are, {one_of(ENERGY_OF)}"),
    }
    if table.diameter is not None and table.mesh_lower is not None:
        findings.add((*place, "mesh_lower"), "diameter is given too: leave one of them out")
    if table.energy_is is not None and not energies:
        findings.add((*place, "energy_is"), "energy_is belongs to a column of energies: leave it out")
    for key, (there, said) in due.items():
        if not there:
            findings.lack((*place, key), f"{key} is missing: {said}")
    _check_units(table, place, findings)
    return findings.clean(place)


def _check_units(table: TestColumns, place: Place, findings: Findings) -> None:
    for key, example in _UNITS.items():
        unit = f"{key}_unit"
        if getattr(table, key) is not None and getattr(table, unit) is None:
            findings.lack((*place, unit), f'{unit} is missing: add {unit} = "{example}"')


#: an example of the unit that a column must have
_UNITS: Final = {"force": "kN", "energy": "J", "specific_energy": "J/kg", "speed": "m/s", "mass": "g"}


def _columns(table: TestColumns, cells: Observations, rig: str | None) -> Measured:
    """Every column of the rows that count; raises Misplaced where one is missing."""
    n = len(cells.lines)
    kind, value = _values(table, cells)
    particles = cells.counts(table.particles, "particles")
    broken = particles
    if table.broken is not None:
        broken = cells.counts(table.broken, "broken")
    elif table.outcome is not None:
        broke = cells.words(table.outcome, "outcome", _BROKE, '"broke" or "survived", or 1 and 0,')
        broken = np.where(broke, particles, 0)
    elif (stopped := getattr(table, "censored", None)) is not None:
        broken = np.where(cells.stopped(stopped, "censored"), 0, particles)
    specimen = np.arange(n)
    if table.specimen is not None:
        names = cells.texts(table.specimen, "specimen")
        number: dict[str, int] = {}
        # a row without a name is a particle of its own
        specimen = np.array([number.setdefault(name or f"\0{row}", len(number)) for row, name in enumerate(names)])
    t10, sieves, passing = _fineness(table, cells)
    measured = Measured(
        lines=np.array([line for line, _ in cells.lines]), rig=_rigs(table, cells, rig), kind=kind, value=value,
        diameter=_diameters(table, cells), broken=broken, particles=particles, specimen=specimen,
        blows=cells.counts(table.blows, "blows"), t10=t10, sieves=sieves, passing=passing,
        mass=_positive(table, cells, "mass"), stiffness=_positive(table, cells, "stiffness"),
        rate=_positive(table, cells, "rate", least="from"),
    )  # fmt: skip
    bad = {line for line, _, _ in cells.faults}
    for fault in faults_of(_rows_of(measured, np.where(np.isfinite(value), value, 1.0))):
        if cells.lines[fault.row][0] not in bad or fault.key == "specimen":
            cells.note(fault.row, str(kind[fault.row]) if fault.key == "energy" else fault.key, fault.message)
    return measured


def _rows_of(measured: Measured, energy: Array) -> Rows:
    return Rows(rig=measured.rig, diameter=measured.diameter, energy=energy, particles=measured.particles,
                broken=measured.broken, blows=measured.blows, specimen=measured.specimen)  # fmt: skip


def _values(table: TestColumns, cells: Observations) -> tuple[npt.NDArray[np.str_], Array]:
    """Kind and value of every row, of which it has one."""
    kinds = [kind for kind in MEASURED if getattr(table, kind) is not None]
    factors = {k: unit_factor(getattr(table, f"{k}_unit"), _quantity(k), f"{k}_unit") for k in kinds}
    found = np.stack([cells.numbers(getattr(table, k), k, factors[k], blank=len(kinds) > 1) for k in kinds])
    there = np.isfinite(found)
    for row in np.flatnonzero(there.sum(axis=0) != 1).tolist() if len(kinds) > 1 else ():
        given = [kind for kind, is_there in zip(kinds, there[:, row], strict=True) if is_there]
        said = f"{' and '.join(given)} stand in one row: one is due" if given else f"one of {one_of(kinds)} is due"
        cells.note(row, kinds[-1], said)
    at = there.argmax(axis=0)
    value, kind = found[at, np.arange(found.shape[1])], np.array(kinds)[at]
    for key in kinds:
        _refuse_below(cells, np.where(kind == key, value, 1.0), key, factors[key])
    return kind, value


def _refuse_below(cells: Observations, values: Array, key: str, factor: float, least: str = "above") -> None:
    """Note the values that are not above 0, or not from 0 upwards."""
    wrong = values < 0.0 if least == "from" else values <= 0.0
    words = f"{_quantity(key).meaning} must be {least} 0, found"
    cells.refuse(wrong, key, lambda row: f"{words} {values[row] / factor:g}")


def _quantity(key: str) -> Quantity:
    """What a column holds."""
    dimension, meaning = _HOLDS[key]
    return Quantity(name=key, symbol=key, dimension=dimension, meaning=f"the {meaning}")


#: column -> dimension and meaning
_HOLDS: Final = {
    "force": ("force", "force at failure"), "energy": ("energy", "energy"), "speed": ("speed", "speed"),
    "specific_energy": ("specific_energy", "energy"), "diameter": ("length", "diameter"), "mass": ("mass", "mass"),
    "stiffness": ("pressure", "stiffness"), "mesh_lower": ("length", "sieve"), "mesh_upper": ("length", "sieve"),
    "rate": ("loading_rate", "loading rate"),
}  # fmt: skip


def _positive(table: TestColumns, cells: Observations, key: str, unit: str = "", least: str = "above") -> Array | None:
    """A column of numbers above zero; None where the table has none."""
    column = getattr(table, key, None)
    if column is None:
        return None
    unit = unit or f"{key}_unit"
    factor = unit_factor(getattr(table, unit), _quantity(key), unit)
    found = cells.numbers(column, key, factor)
    _refuse_below(cells, found, key, factor, least)
    return found


def _diameters(table: TestColumns, cells: Observations) -> Array:
    """Sizes [m]: a column, one length, or the geometric mean of two sieves."""
    if table.diameter is None:
        lower, upper = (_positive(table, cells, key, "mesh_unit") for key in ("mesh_lower", "mesh_upper"))
        assert lower is not None
        assert upper is not None
        said = "the sieve that held a particle must be finer than that it passed"
        cells.refuse(lower >= upper, "mesh_lower", lambda row: said)
        return np.sqrt(np.abs(lower * upper))
    try:
        same = parse_value(table.diameter, "length")
    except UnitError:
        found = _positive(table, cells, "diameter")
        assert found is not None
        return found
    if same <= 0.0:
        raise Misplaced(f"found {shown(table.diameter)}: the diameter must be above 0", "diameter")
    return np.full(len(cells.lines), same)


def _rigs(table: TestColumns, cells: Observations, rig: str | None) -> npt.NDArray[np.str_]:
    """The rig of every row."""
    if not isinstance(table.rig, Mapping):
        return np.full(len(cells.lines), table.rig or rig)
    found = cells.texts(table.rig["column"], "rig")
    strange = np.array([name not in TEST_RIGS for name in found], dtype=bool)
    cells.refuse(strange, "rig", lambda row: unknown("rig", found[row], TEST_RIGS))
    return np.where(strange, "platens", found)


def _fineness(table: TestColumns, cells: Observations) -> tuple[Array | None, tuple[float, ...], Array | None]:
    """t10, sieves from the coarsest and what passes them, as shares; nan where a cell is empty."""
    factor = 0.01 if table.t10_unit == "%" else 1.0
    top = "100 %" if factor < 1.0 else "1"
    columns: list[tuple[float, str, str]] = []
    for text, column in table.passing.items():
        try:
            columns.append((parse_value(text, "length"), column, "passing"))
        except UnitError as error:
            raise Misplaced(str(error), "passing", text) from None
    columns.sort(reverse=True)
    shares = {}
    for key, column in [("t10", table.t10)] * (table.t10 is not None) + [(name, name) for _, name, _ in columns]:
        where = "t10" if key == "t10" else "passing"
        found = cells.numbers(str(column), where, factor, blank=True)
        what = "t10" if where == "t10" else f"the share in {shown(str(column))}"
        said = f"{what} must lie between 0 and {top}, found"
        wrong = (found < 0.0) | (found > 1.0 + 1e-12)
        cells.refuse(wrong, where, lambda row, of=found, text=said: f"{text} {of[row] / factor:g}")  # type: ignore[misc]
        shares[key] = found
    if not columns:
        return shares.get("t10"), (), None
    passing = np.stack([shares[column] for _, column, _ in columns], axis=1)
    finer = np.array([(np.diff(row[np.isfinite(row)]) > 1e-12).any() for row in passing])
    cells.refuse(finer, "passing", lambda row: "more passes a finer sieve than a coarser one")
    return shares.get("t10"), tuple(size for size, _, _ in columns), passing


# --- [tests] ----------------------------------------------------------------------------------------------


def read_tests(document: Document, particles: Particles | None, findings: Findings) -> TestsPlan | None:
    """The tests of a study; None, with every fault noted, where it has none that can be used."""
    table, place = document.tests, ("tests",)
    if table is None:
        return None
    request = _request(table, document, place, findings)
    measured = read_measured(table, table.file, place, findings) if table.file else None
    if measured is None or particles is None or request is None:
        return None
    share, stiffness = _shares(table, measured, particles, place, findings)
    if not findings.clean(place):
        return None
    own, offered = _energies(table, measured, particles.density, share, stiffness)
    specimens = specimens_of(_rows_of(measured, own))
    if why := unbounded(specimens):
        if not {"e_inf", "C"} & set(request.priors):
            due = "give a prior of its level, prior = { e_inf = … } or { C = … }, which is then all that is known"
            findings.add((*place, "outcome" if table.outcome else "broken"), f"{why}: {due}")
            return None
        findings.warn(place, f"{why}: the level of the law is the prior's")
    if table.mesh_lower is not None:
        findings.warn((*place, "mesh_lower"), "sizes scatter within their sieves: that scatter is part of sigma")
    return TestsPlan(
        specimens=specimens, request=request, rows=len(own), of=_words(table, measured),
        meaning=_meaning(table, findings), fineness=_fineness_of(measured, own, offered, table),
    )  # fmt: skip


def _energies(
    table: TestsTable, measured: Measured, density: float, share: Array, stiffness: Array
) -> tuple[Array, Array]:
    """Energies [J/kg] of every row: what the particle took up, and what was offered or held by both bodies."""
    mass = measured.mass
    if mass is None:
        mass = np.asarray(contact.sphere_mass(0.5 * measured.diameter, density))
    own, offered = np.empty(len(mass)), np.empty(len(mass))
    for kind in dict.fromkeys(measured.kind.tolist()):
        rows = measured.kind == kind
        for found, part in ((own, share), (offered, np.ones_like(share))):
            found[rows] = particle_energy(
                kind, measured.value[rows], rig=measured.rig[rows].tolist(), meaning=str(table.energy_is),
                mass=mass[rows], diameter=measured.diameter[rows], share=part[rows], stiffness=stiffness[rows],
            )  # fmt: skip
    return own, offered


def _shares(
    table: TestsTable, measured: Measured, particles: Particles, place: Place, findings: Findings
) -> tuple[Array, Array]:
    """The particle's share of a contact's energy, and K_e, of every row; what is missing for them is noted."""
    forces = measured.kind == "force"
    thrown = np.isin(measured.rig, THROWN)
    meant = np.where(forces, "contact", np.where(measured.kind == "speed", "input", str(table.energy_is)))
    needs = (meant == "contact") | ((meant == "input") & (measured.rig != "drop_weight"))
    alike = measured.rig == "sphere_on_sphere"
    partner = _partner(table.platens)
    if (needs & ~alike).any() and partner is None and findings.clean((*place, "platens")):
        thing = "thrown at" if thrown.any() else "tested between"
        said = f'platens is missing: say what the particles were {thing}, "steel", "rigid" or a table of E and nu'
        findings.add((*place, "platens"), said)
    if forces.any() and measured.stiffness is None:
        if not table.assume_intact:
            why = "rocks touch at asperities, where they are often several times softer than the intact rock"
            said = f"stiffness is missing: {why}; name its column, or set assume_intact = true"
            findings.add((*place, "stiffness"), said)
        else:
            said = "forces become energies with the stiffness of the intact rock: with half of it they are 1.6 times"
            findings.warn((*place, "assume_intact"), f"{said} as large")
    E, nu = partner or (math.inf, 0.3)
    n, own = len(measured.value), particles.E / (1.0 - particles.nu**2)
    other = np.where(alike, own, E / (1.0 - nu * nu))
    stiffness = 1.0 / (1.0 / own + 1.0 / other)
    share = np.where(alike, 0.5, share_of(particles.E, particles.nu, (E, nu)))
    if measured.stiffness is not None:
        # of the particle's own stiffness that was measured: k_p = K_e k_s/(k_s - K_e)
        stiffness = measured.stiffness
        share = 1.0 - stiffness / other
        for row in np.flatnonzero(share <= 0.0)[:1].tolist():
            found = f"line {measured.lines[row]}: K_e of {stiffness[row] / 1e9:.4g} GPa"
            findings.add((*place, "stiffness"), f"{found} is above that of the platens alone")
    return np.broadcast_to(share, n), np.broadcast_to(stiffness, n)


def _partner(raw: Raw) -> tuple[float, float] | None:
    """E and nu of what the particles were tested between; None where the table does not say."""
    if isinstance(raw, Mapping):
        try:
            return parse_value(raw["E"], "pressure"), float(raw["nu"])
        except (UnitError, TypeError, ValueError):
            return None
    return None if raw in (None, "bars") else known_platens(raw)


def _request(table: TestsTable, document: Document, place: Place, findings: Findings) -> Request | None:
    """How the tests are fitted; None, with the faults noted, where that cannot be."""
    from uqsphere.feed.infer import Request

    if table.size == "weakest_link" and table.law != "weibull":
        findings.add((*place, "size"), 'size = "weakest_link" belongs to law = "weibull": take "power"')
    priors, gamma = {}, _gamma(table, place, findings)
    known = [name for name in _PRIORS if table.size != "class" or name not in ("e_inf", "C")]
    for name, raw in table.prior.items():
        if name not in known:
            findings.add((*place, "prior", name), unknown("parameter", name, known))
        elif (prior := _prior(raw, name, (*place, "prior", name), findings)) is not None:
            priors[name] = prior
    if not (gamma is None or isinstance(gamma, float)):
        priors["gamma"], gamma = gamma, None
    if not findings.clean(place):
        return None
    ratio = math.inf if table.ratio == "inf" else float(table.ratio)
    return Request(
        law=table.law, size=table.size, ratio=ratio, gamma=gamma, priors=priors, seed=document.seed,
        title=document.title, made_up=table.made_up,
    )  # fmt: skip


def _gamma(table: TestsTable, place: Place, findings: Findings) -> Prior | float | None:
    """The exponent of damage or its prior; None where the tests are to tell it, or with the fault noted."""
    at = (*place, "gamma")
    reading = None if table.gamma == "fit" else read_number(table.gamma, at, plain_quantity("gamma"), findings)
    if reading is None:
        return None
    if isinstance(reading.value, Law):
        return _prior(table.gamma, "gamma", at, findings)
    if not 1.0 <= reading.value <= 20.0:
        findings.add(at, f"found {reading.value:g}: gamma lies from 1 to 20, mostly from 3 to 5.4")
    return float(reading.value)


#: parameters whose prior a study can give, and their dimensions
_PRIORS: Final = {
    "e_inf": "specific_energy", "C": "number", "d0": "length", "phi": "number", "sigma": "number",
    "modulus": "number", "gamma": "number", "f_mat": "number", "threshold": "number",
}  # fmt: skip


def _prior(raw: Raw, name: str, place: Place, findings: Findings) -> Prior | None:
    """A lognormal law as centre and scatter of the logarithm."""
    from uqsphere.feed.likelihood import Prior

    quantity = Quantity(name=name, symbol=name, dimension=_PRIORS[name], meaning=f"the prior of {name}")
    reading = read_number(raw, place, quantity, findings)
    if reading is None:
        return None
    law = reading.value
    if not isinstance(law, Law) or law.family.name != "lognormal" or math.isfinite(law.upper) or law.lower > 0.0:
        said = "a prior is a lognormal law without bounds, such as"
        findings.add(place, f'{said} {{ dist = "lognormal", log_mean = 0.0, log_sd = 0.45 }}')
        return None
    return Prior(centre=law.parameters["log_mean"], sd=law.parameters["log_sd"])


def _words(table: TestsTable, measured: Measured) -> dict[str, str]:
    """What the tests are, for people."""
    kinds = ", ".join(dict.fromkeys(kind.replace("_", " ") for kind in measured.kind.tolist()))
    rigs = ", ".join(dict.fromkeys(rig.replace("_", " ") for rig in measured.rig.tolist()))
    chosen = {"rows": ", ".join(f"{column} = {text}" for column, text in table.where.items())} if table.where else {}
    meant = {"energy": str(table.energy_is)} if table.energy_is else {}
    return {"file": table.file, "rig": rigs, "measured": kinds, **meant, **chosen}


def _meaning(table: TestsTable, findings: Findings) -> dict[str, Raw]:
    """The table and a digest of its file, for the hash of the study."""
    rows = open_observations(table.file, findings.folder, "file", LARGEST_TESTS)
    text = "\n".join(",".join(row) for row in [rows.header, *(row for _, row in rows.lines)])
    plain = {key: dict(part) if isinstance(part, Mapping) else part for key, part in asdict(table).items()}
    return {"table": plain, "rows": hashlib.sha256(text.encode()).hexdigest()}


def _fineness_of(measured: Measured, own: Array, offered: Array, table: TestsTable) -> Fineness | None:
    """Rows that broke with a t10 or with what passed sieves; a particle that is pressed is offered what it takes."""
    from uqsphere.feed.product import Fineness

    if measured.t10 is None and measured.passing is None:
        return None
    n = len(own)
    t10 = np.full(n, np.nan) if measured.t10 is None else measured.t10
    passing = np.full((n, 0), np.nan) if measured.passing is None else measured.passing
    given = np.where(measured.at_failure | (table.energy_is == "sphere"), own, offered)
    keep = (measured.broken > 0) & (np.isfinite(t10) | np.isfinite(passing).any(axis=1))
    return Fineness(diameter=measured.diameter[keep], offered=given[keep], t10=t10[keep],
                    sieves=np.array(measured.sieves), passing=passing[keep])  # fmt: skip

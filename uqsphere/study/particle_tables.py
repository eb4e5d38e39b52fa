"""Tables of single particles, declared once: columns of tests, strengths read from tests, a feed and its product."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Final

from pydantic.dataclasses import dataclass

from uqsphere.feed.tests import TEST_RIGS
from uqsphere.study.faults import Raw, one_of, shown, suggestion
from uqsphere.study.tables import (
    CLOSED,
    Check,
    Flag,
    Length,
    Node,
    Number,
    Positive,
    Real,
    Share,
    Text,
    Whole,
    among,
    fixed,
    key,
    within,
)
from uqsphere.units import UNITS

#: what an energy per mass, or a strength in it, can mean, and the quantity that is then held against it
ENERGY_OF: Final = {
    "contact": "specific_energy",
    "sphere": "specific_energy_sphere",
    "input": "specific_impact_energy",
}
LAWS: Final = ("average", "lognormal", "weibull", "vogel_peukert")
SIZES: Final = ("tavares", "king", "power", "class", "weakest_link")
_SHARES: Final = ("%", "share")


def platen_words() -> tuple[str, ...]:
    """What a strength can have been measured between, but for a table of `E` and `nu`."""
    from uqsphere.materials import library

    return "bars", "rigid", *library()["bars"]


def _either(words: Sequence[str], *keys: str) -> Node:
    """The schema of one of some words, or a table with some keys."""
    return {"anyOf": [{"enum": list(words)}, {"type": "object", "required": list(keys)}]}


def known_platens(name: str) -> tuple[float, float]:
    """Young's modulus [Pa], infinite if rigid, and Poisson ratio of one of these words, which is not `bars`."""
    from uqsphere.materials import library

    entry = {} if name == "rigid" else library()["bars"][name].properties
    return (entry["E"].value, entry["nu"].value) if entry else (math.inf, 0.3)


def _platens(value: Raw) -> Raw:
    if not isinstance(value, Mapping):
        return among(platen_words).look(value)
    if set(value) != {"E", "nu"}:
        raise ValueError(f"found a table of {one_of(list(value)) if value else 'nothing'}: E and nu are due")
    return value


def _rig(value: Raw) -> Raw:
    if isinstance(value, Mapping) and set(value) == {"column"} and isinstance(value["column"], str):
        return value
    if not isinstance(value, str) or value not in TEST_RIGS:
        near = suggestion(value, TEST_RIGS) if isinstance(value, str) else ""
        raise ValueError(f'found {shown(value)}, allowed: {one_of(TEST_RIGS)}, or {{ column = "rig" }}{near}')
    return value


def _ratio(value: Raw) -> Raw:
    if value != "inf" and (isinstance(value, bool) or not isinstance(value, (int, float)) or not value > 1.0):
        raise ValueError(f'found {shown(value)}: a number above 1 or "inf" is due')
    return value


def _texts(value: Mapping[str, Raw]) -> Mapping[str, Raw]:
    for name, text in value.items():
        if not isinstance(text, str):
            raise ValueError(f"{name}: found {shown(text)}, where a text in quotes is due")
    return value


Platens = Annotated[Raw, Check(_platens, lambda: _either(platen_words(), "E", "nu"), first=True)]
Rig = Annotated[Raw, Check(_rig, lambda: _either(TEST_RIGS, "column"), first=True)]
Ratio = Annotated[Raw, Check(_ratio, lambda: {"anyOf": [{"const": "inf"}, {"type": "number"}]}, first=True)]
Texts = Annotated[Mapping[str, Raw], Check(_texts)]


Lengths = Annotated[Text, among(tuple(UNITS["length"]))] | None


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class TestColumns:
    """What the columns of a table of tests are called: a row is one blow or one compression."""

    rig: Rig | None = key(
        f'what the particles were tested in: {one_of(TEST_RIGS)}; or a column, `{{ column = "rig" }}`'
    )
    diameter: Text | None = key("column of diameters, of the sphere of equal volume, or one length")
    diameter_unit: Lengths = key("unit of the diameters")
    mesh_lower: Text | None = key("in place of `diameter`: column of the sieve that held them; d is the geometric mean")
    mesh_upper: Text | None = key("column of the sieve that they passed")
    mesh_unit: Lengths = key("unit of the sieves")
    mass: Text | None = key("column of masses", default_is="a sphere of the density")
    mass_unit: Annotated[Text, among(tuple(UNITS["mass"]))] | None = key("unit of the masses")
    force: Text | None = key("column of forces at failure")
    force_unit: Annotated[Text, among(tuple(UNITS["force"]))] | None = key("unit of the forces")
    energy: Text | None = key("column of energies; every row has one of force, energy and speed")
    energy_unit: Annotated[Text, among(tuple(UNITS["energy"]))] | None = key("unit of the energies")
    specific_energy: Text | None = key("column of energies per mass")
    specific_energy_unit: Annotated[Text, among(tuple(UNITS["specific_energy"]))] | None = key("unit of these")
    speed: Text | None = key("column of closing speeds: `v²/2` per mass was offered")
    speed_unit: Annotated[Text, among(tuple(UNITS["speed"]))] | None = key("unit of the speeds")
    energy_is: Annotated[Text, among(tuple(ENERGY_OF))] | None = key(
        'what the energies are: `"sphere"` (the particle\'s own), `"contact"` (of both bodies) or `"input"` (offered)',
        default_is="required with a column of energies",
    )
    outcome: Text | None = key("column of `broke` or `survived`, or 1 and 0", default_is="required but for a strength")
    specimen: Text | None = key("column of names: rows of one name are blows on one particle, in their order")
    blows: Text | None = key("column of numbers: the blow was repeated so often, the outcome is that of the last")
    stiffness: Text | None = key("column of K_e, the reduced modulus of the contact in this test; needed with forces")
    stiffness_unit: Annotated[Text, among(tuple(UNITS["pressure"]))] = key("unit of K_e", "GPa")
    assume_intact: Flag = key("takes K_e from `E` and `nu` of the intact rock, which is often too stiff", False)
    t10: Text | None = key("column of the mass share of the broken finer than a tenth of the particle")
    t10_unit: Annotated[Text, among(_SHARES)] = key("`%` or `share`", "%")
    passing: Texts = key('columns of mass shares finer than sieves, `{ "2 mm" = "p2" }`, in `t10_unit`', {})
    particles: Text | None = key("column of numbers: the row stands for so many particles alike")
    broken: Text | None = key("with `particles`: column of how many of them broke, in place of `outcome`")
    where: Texts = key('rows that count, by the text of a column: `{ material = "ore A" }`', {})
    platens: Platens | None = key(
        "what the particles were tested between, or thrown at: `bars`, `rigid`, a material of bars, or a table of `E` "
        "and `nu`",
        default_is="`bars` of the study for a strength; else required where a share of the energy is to be taken",
    )
    made_up: Flag = key("the tests were made up, so that no verdict is established by them", False)


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class TestsTable(TestColumns):
    """Tests of single particles, which `uqsphere fit` makes a law of fracture energy from."""

    file: Text = key("CSV beside the study: comma, semicolon or tab; lines with `#` are comments",
                     due='add file = "tests.csv"')  # fmt: skip
    law: Annotated[Text, among(LAWS)] = key(
        f"law of the fracture energy: {one_of(LAWS)}; the first carries both by their scores",
        "average",
    )
    ratio: Ratio = key('E_max over E50 of the lognormal law; `"inf"`: no bound', 4.0)
    size: Annotated[Text, among(SIZES)] = key(
        f"law of the size: {one_of(SIZES)}; `class`: every size has an E50 of its own; `weakest_link`: Weibull's alone",
        "tavares",
    )
    gamma: Number = key('damage by repeated blows: a number, a lognormal law (the prior), or `"fit"`', "fit")
    prior: Mapping[str, Raw] = key("lognormal laws of parameters in place of the house's priors, by name", {})


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class SphereTestsTable(TestColumns):
    """A strength from the forces, or the energies, at which spheres broke."""

    dist: Annotated[Text, among(("empirical",))] | None = key("`empirical`, with `file`; or `tests`")
    file: Text | None = key("CSV beside the study", default_is="that of `tests`")
    tests: Text | None = key("CSV beside the study, in place of `dist` and `file`")
    rate: Text | None = key("column of loading rates")
    rate_unit: Annotated[Text, among(tuple(UNITS["loading_rate"]))] | None = key("unit of the loading rates")
    censored: Text | None = key("column of flags: tests stopped before a failure; or `outcome` in its place")
    fit: Text = key("the law that is fitted to the strengths", "weibull")
    unbiased: Flag = key("takes the bias of few tests out of the modulus or the scatter", False)


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class FitStrengthTable:
    """A strength that `uqsphere fit` has found: its draws are what few tests leave open."""

    fit: Text = key("folder beside the study that `uqsphere fit` wrote", due='add fit = "limestone-fit"')


# --- a feed and its product -----------------------------------------------------------------------------

#: share finer than a size, by name
SIZE_LAWS: Final = ("rosin_rammler", "gaudin_schuhmann", "lognormal", "table")
#: what t10 follows from, and families of t_n, as `uqsphere.feed.product` has them
FORMS: Final = ("jk", "tavares", "tavares_own", "shi_kojovic")
CURVES: Final = ("trr", "milin", "beta")
#: A and b that the tests are to tell
FROM_TESTS: Final = "tests"
#: most blows, and classes of sizes
_MOST_BLOWS, _MOST_CLASSES = 1000, 200


def _three(values: tuple[Raw, ...]) -> tuple[tuple[float, float, float], ...]:
    """Rows of a table of incomplete beta functions: n above 1, both parameters above 0, n rising."""
    rows = []
    for row in values:
        usable = isinstance(row, (list, tuple)) and len(row) == 3
        usable = usable and all(isinstance(v, (int, float)) and not isinstance(v, bool) for v in row)
        if not usable or not (row[0] > 1.0 and row[1] > 0.0 and row[2] > 0.0 and math.isfinite(sum(row))):
            raise ValueError("a row is [n, alpha_n, beta_n]: n above 1, both parameters above 0")
        rows.append((float(row[0]), float(row[1]), float(row[2])))
    if any(row[0] >= after[0] for row, after in pairwise(rows)) or any(row[0] == 10.0 for row in rows):
        raise ValueError("n must rise from row to row; 10 is t10 itself and has no row")
    return tuple(rows)


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class MaterialTable:
    """What particles are of, where the study has no sphere; laws enter by their means."""

    name: Text | None = key("name from `uqsphere list materials`; fills what is not given")
    E: Number = key("Young's modulus", default_is="from the material")
    nu: Number = key("Poisson ratio", default_is="from the material")
    density: Number = key("density", default_is="from the material")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class SizesTable:
    """How the mass of the feed is spread over sizes, and the classes that it is cut into."""

    law: Annotated[Text, among(SIZE_LAWS)] = key(
        "`rosin_rammler`, `gaudin_schuhmann`, `lognormal` or `table`", "", due='add law = "rosin_rammler"'
    )
    d63: Length | None = key("`rosin_rammler`: size that 63.2 % is finer than")
    n: Positive | None = key("`rosin_rammler`, `gaudin_schuhmann`: exponent")
    d50: Length | None = key("`lognormal`: median by mass")
    log_sd: Positive | None = key("`lognormal`: standard deviation of ln d")
    file: Text | None = key("`table`: CSV beside the study")
    sieve: Text = key("`table`: column of sieves", "sieve_mm")
    sieve_unit: Annotated[Text, among(tuple(UNITS["length"]))] = key("`table`: unit of the sieves", "mm")
    passing: Text = key("`table`: column of shares finer, in %", "passing_percent")
    top: Length | None = key("largest size: what is coarser is cut", default_is="largest sieve; else required")
    ratio: Annotated[Real, within(1.0, 4.0)] = key("of one sieve to the next", 2.0**0.5, default_is="`1.41421356`")
    classes: Annotated[Whole, within(1, _MOST_CLASSES, closed=True)] = key("classes; what is finer is the rest", 14)


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class EnergyTable:
    """What a blow offers: one of its keys, a value or a law (a spectrum: every blow of every particle is drawn)."""

    specific: Number = key("energy per mass, the same for all sizes, such as `100 J/kg`")
    energy: Number = key("energy of a blow, the same for all sizes: a ball that falls")
    speed: Number = key("closing speed square to the face: `v²/2` per mass")
    drop_height: Number = key("height of a fall: `g h` per mass, drag left out")
    service: Text | None = key("a `[service.NAME]` of the study: its closing speed and its partner")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class OnTable:
    """What the particles are hit by, for the share of the energy that they take up."""

    material: Text | None = key("a material of bars or plates; fills `E` and `nu`")
    E: Annotated[float, fixed("pressure", "E")] | None = key("Young's modulus", default_is="from the material")
    nu: Annotated[Real, within(0.0, 0.5)] | None = key("Poisson ratio", default_is="from the material")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class GoalTable:
    """What must break, and how sure that must be."""

    broken: Share = key("least share of the feed that must break", 0.0, due="add broken = 0.9")
    at_least: Share = key("least probability of that", 0.95)


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class FeedTable:
    """A feed of particles and the blows that it gets."""

    sizes: SizesTable | None = key("the size distribution, see below", due='add sizes = { law = "rosin_rammler", … }')
    energy: EnergyTable | None = key("what a blow offers, see below", due='add energy = { specific = "100 J/kg" }')
    blows: Annotated[Whole, within(1, _MOST_BLOWS, closed=True)] = key("blows that every particle gets", 1)
    on: OnTable | None = key("what the particles are hit by, see below", default_is="the energy is the particle's own")
    progeny: Annotated[Text, among(("out", "again"))] = key(
        '`"out"`: fragments leave; `"again"`: they are fresh particles that get the blows that are left', "out"
    )
    rest: Annotated[Text, among(("stays", "breaks"))] = key(
        "what becomes of particles finer than the last sieve", "stays"
    )
    lot: Annotated[float, fixed("mass", "m")] | None = key(
        "mass of a lot, whose particles scatter", default_is="no scatter beside ignorance"
    )
    fines: Length | None = key("sieve whose passing is asked for")
    goal: GoalTable | None = key("what must break, `{ broken = 0.9, at_least = 0.95 }`; exit code 3 unless it is met")


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class CurveTable:
    """The family that gives the product's curve from t10."""

    law: Annotated[Text, among(CURVES)] = key("`trr`, `milin` or `beta`", "trr")
    alpha: Number = key(
        "`trr`: exponent, value or law", default_is="fitted to sieve columns of the tests, else lognormal about 0.6"
    )
    table: Annotated[tuple[Raw, ...], Check(_three)] = key("`beta`: rows `[n, alpha_n, beta_n]`", ())
    discrepancy: Annotated[Real, within(0.0, 0.5, closed=True)] | None = key(
        "standard deviation of `t_n` about the family, at 0.5", default_is="that of the fit, else 0.05"
    )


@dataclass(frozen=True, kw_only=True, config=CLOSED)
class ProductTable:
    """How fine the product of crushing is."""

    A: Number = key('largest `t10`, a share with its unit: `"55 %"`', due='add A = "55 %"')
    b: Number = key(
        'how fast `t10` rises with the specific energy, such as `"0.8 t/kWh"`; a plain number in another `form`',
        due='add b = "0.8 t/kWh"',
    )
    form: Annotated[Text, among(FORMS)] = key(
        "what `t10` follows from: `jk` (energy offered), `tavares` (over the median of those that break), "
        "`tavares_own` (over each one's), `shi_kojovic` (excess over all blows); feeds alone take more than `jk`",
        "jk",
    )
    threshold: Annotated[Real, within(0.0, closed=True)] = key("`shi_kojovic`: d W_min in J m/kg", 0.0)
    curve: CurveTable | None = key("the family of the product's curve, see below", default_is="`trr`")

"""Tables of particles, their feed and their product, declared once as those of `uqsphere.study.document` are."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Final

from pydantic import ConfigDict
from pydantic.dataclasses import dataclass

from uqsphere.study.faults import Raw
from uqsphere.study.tables import Check, Fixed, Number, Real, Text, Whole, among, key, within
from uqsphere.units import UNITS, Quantity

#: share finer than a size, by name
SIZE_LAWS: Final = ("rosin_rammler", "gaudin_schuhmann", "lognormal", "table")
#: what t10 follows from, and families of t_n, as `uqsphere.feed.product` has them
FORMS: Final = ("jk", "tavares", "tavares_own", "shi_kojovic")
CURVES: Final = ("trr", "milin", "beta")
#: A and b that the tests are to tell
FROM_TESTS: Final = "tests"
#: most blows, and classes of sizes
_MOST_BLOWS, _MOST_CLASSES = 1000, 200


def _plain(dimension: str, symbol: str) -> Fixed:
    return Fixed(Quantity(name=dimension, symbol=symbol, dimension=dimension, meaning=f"the {dimension}"))


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


_Share = Annotated[Real, within(0.0, 1.0)]
_Positive = Annotated[Real, within(0.0)]
_Length = Annotated[float, _plain("length", "d")]
_CLOSED: Final = ConfigDict(extra="forbid", defer_build=True)


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class MaterialTable:
    """What particles are of, where the study has no sphere; laws enter by their means."""

    name: Text | None = key("name from `uqsphere list materials`; fills what is not given")
    E: Number = key("Young's modulus", default_is="from the material")
    nu: Number = key("Poisson ratio", default_is="from the material")
    density: Number = key("density", default_is="from the material")


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class SizesTable:
    """How the mass of the feed is spread over sizes, and the classes that it is cut into."""

    law: Annotated[Text, among(SIZE_LAWS)] = key(
        "`rosin_rammler`, `gaudin_schuhmann`, `lognormal` or `table`", "", due='add law = "rosin_rammler"'
    )
    d63: _Length | None = key("`rosin_rammler`: size that 63.2 % is finer than")
    n: _Positive | None = key("`rosin_rammler`, `gaudin_schuhmann`: exponent")
    d50: _Length | None = key("`lognormal`: median by mass")
    log_sd: _Positive | None = key("`lognormal`: standard deviation of ln d")
    file: Text | None = key("`table`: CSV beside the study")
    sieve: Text = key("`table`: column of sieves", "sieve_mm")
    sieve_unit: Annotated[Text, among(tuple(UNITS["length"]))] = key("`table`: unit of the sieves", "mm")
    passing: Text = key("`table`: column of shares finer, in %", "passing_percent")
    top: _Length | None = key("largest size: what is coarser is cut", default_is="largest sieve; else required")
    ratio: Annotated[Real, within(1.0, 4.0)] = key("of one sieve to the next", 2.0**0.5, default_is="`1.41421356`")
    classes: Annotated[Whole, within(1, _MOST_CLASSES, closed=True)] = key("classes; what is finer is the rest", 14)


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class EnergyTable:
    """What a blow offers: one of its keys, a value or a law (a spectrum: every blow of every particle is drawn)."""

    specific: Number = key("energy per mass, the same for all sizes, such as `100 J/kg`")
    energy: Number = key("energy of a blow, the same for all sizes: a ball that falls")
    speed: Number = key("closing speed square to the face: `v²/2` per mass")
    drop_height: Number = key("height of a fall: `g h` per mass, drag left out")
    service: Text | None = key("a `[service.NAME]` of the study: its closing speed and its partner")


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class OnTable:
    """What the particles are hit by, for the share of the energy that they take up."""

    material: Text | None = key("a material of bars or plates; fills `E` and `nu`")
    E: Annotated[float, _plain("pressure", "E")] | None = key("Young's modulus", default_is="from the material")
    nu: Annotated[Real, within(0.0, 0.5)] | None = key("Poisson ratio", default_is="from the material")


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class GoalTable:
    """What must break, and how sure that must be."""

    broken: _Share = key("least share of the feed that must break", 0.0, due="add broken = 0.9")
    at_least: _Share = key("least probability of that", 0.95)


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
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
    lot: Annotated[float, _plain("mass", "m")] | None = key(
        "mass of a lot, whose particles scatter", default_is="no scatter beside ignorance"
    )
    fines: _Length | None = key("sieve whose passing is asked for")
    goal: GoalTable | None = key("what must break, `{ broken = 0.9, at_least = 0.95 }`; exit code 3 unless it is met")


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
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


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
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

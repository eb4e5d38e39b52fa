"""Criteria of fracture: what of a loaded sphere is compared with which strength.

Each criterion is one record with one signature: columns of the impact model (SI, one row per
sample) and its own parameters go in, a column of demand comes out, and the sphere breaks where the
demand exceeds the strength.  The strength stays outside: it is a number or a law of the study.
`in_range` says row by row where the formula has been left; a demand is given there too, for an
absent number would pass for a survival.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Values
from uqsphere.mechanics import contact, stress
from uqsphere.units import Quantity

Columns = Mapping[str, Values]
Parameters = Mapping[str, float]
#: further quantities: name -> criterion and its parameters
Demands = Mapping[str, tuple[str, Parameters]]


#: Auerbach's constant of a ring crack, P_C = A K_Ic²/E r (Lawn 1998)
AUERBACH: Final = 8.6e3
#: an energy above the largest fracture energy breaks every particle; the demand stays a finite
#: number
_CERTAIN: Final = 1e9


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A number that belongs to a criterion, with the bounds of its meaning (the bounds themselves
    excluded).
    """

    name: str
    dimension: str
    meaning: str
    lower: float = 0.0
    upper: float = math.inf


#: every parameter of every criterion
PARAMETERS: Final[dict[str, Parameter]] = {
    part.name: part
    for part in (
        Parameter(
            name="modulus", dimension="number", lower=1.0, upper=1e3, meaning="Weibull modulus m"
        ),
        Parameter(
            name="reference_volume",
            dimension="volume",
            meaning="volume the strength is measured on",
        ),
        Parameter(
            name="reference_area", dimension="area", meaning="area the strength is measured on"
        ),
        Parameter(
            name="largest_energy",
            dimension="specific_energy",
            meaning="largest specific fracture energy",
        ),
        Parameter(
            name="rate_0",
            dimension="strain_rate",
            meaning="strain rate at which the strength is doubled",
        ),
    )
}


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """One criterion.

    name, meaning, formula, source, range_text: texts; range_text says in words what `ranges` says
    in numbers. dimension, symbol, display: of demand and strength, as of a `Quantity`; measures:
    what the demand is; strength: what it is held against.  needs: columns, by the names of the
    nomenclature.  formula_of: function of (columns, parameters), the demand (n,) without the effect
    of rate.  quantity: the quantity of interest that is this demand with no parameter given; also:
    those that are the same of another part of the record.  parameters, optional: names in
    `PARAMETERS` that must, and may, be given.  ranges: closed ranges of columns, of "a/r", and of
    parameters. follows, place: as of a `Quantity`.
    """

    name: str
    meaning: str
    formula: str
    source: str
    range_text: str
    dimension: str
    symbol: str
    display: str
    measures: str
    strength: str
    needs: tuple[str, ...]
    formula_of: Callable[[Columns, Parameters], Array]
    quantity: str | None = None
    also: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    follows: str = "force"
    place: str = ""

    def needs_with(self, parameters: Parameters) -> tuple[str, ...]:
        """Columns that the demand is made from with these parameters."""
        return (*self.needs, *(("loading_rate", "P_max") if "rate_0" in parameters else ()))


class _Face(Mapping[str, Values]):
    """Columns of one face: its own, and those of the row beside."""

    def __init__(self, own: Columns, row: Columns) -> None:
        self._own, self._row = own, row

    def __getitem__(self, name: str) -> Values:
        return self._own[name] if name in self._own else self._row[name]

    def __contains__(self, name: object) -> bool:
        return name in self._own or name in self._row

    def __iter__(self) -> Iterator[str]:
        return iter({**self._own, **self._row})

    def __len__(self) -> int:
        return len({*self._own, *self._row})


def demand(
    criterion: Criterion, columns: Columns, parameters: Parameters = MappingProxyType({})
) -> Array:
    """The demand of n rows, in SI, to be compared with the criterion's strength.

    With `rate_0` the strength grows with the strain rate of each sample; that is taken off the
    demand, which leaves the comparison as it is.  ValueError for a parameter that is missing, not
    known to the criterion, or outside its bounds.

    >>> rows = {"p_max": np.array([1e9]), "a_max": 1e-3, "sphere.radius": 0.01, "sphere.nu": 0.25}
    >>> round(float(demand(CRITERIA["core_tension"], rows)[0]) / 1e6, 2)
    9.86
    """
    missing = [name for name in criterion.parameters if name not in parameters]
    if missing:
        raise ValueError(f"the criterion {criterion.name} needs {missing[0]}")
    for name, value in parameters.items():
        if name not in (*criterion.parameters, *criterion.optional):
            allowed = ", ".join((*criterion.parameters, *criterion.optional)) or "none"
            raise ValueError(
                f"the criterion {criterion.name} has no {name} (its parameters: {allowed})"
            )
        bounds = PARAMETERS[name]
        if not bounds.lower < value < bounds.upper:
            raise ValueError(
                f"{name} must lie between {bounds.lower:g} and {bounds.upper:g}, found {value!r}"
            )
    # faces that are not alike are looked at one by one, each with what presses at the other pole
    faces = [_Face(side, columns) for side in columns["sides"]] if "sides" in columns else [columns]
    demands = [
        np.atleast_1d(np.asarray(criterion.formula_of(face, parameters), dtype=float))
        for face in faces
    ]
    found = np.asarray(np.maximum.reduce(demands))
    if "rate_0" in parameters:
        found = found / dynamic_increase(strain_rate(columns), parameters["rate_0"])
    return found


def ranges_of(
    criterion: Criterion, columns: Columns, parameters: Parameters = MappingProxyType({})
) -> Iterator[tuple[str, Array, float, float]]:
    """What a criterion has a range of: its name, its values, (n,) or (1,), and the two ends of the
    range.
    """
    for name, (low, high) in criterion.ranges.items():
        value = (
            _ratio(columns)
            if name == "a/r"
            else parameters[name]
            if name in parameters
            else columns.get(name)
        )
        if value is not None:
            yield name, np.atleast_1d(np.asarray(value, dtype=float)), low, high


def in_range(
    criterion: Criterion, columns: Columns, parameters: Parameters = MappingProxyType({})
) -> Flags:
    """Which of n rows lie inside the range of the criterion."""
    inside = np.ones(np.shape(np.atleast_1d(columns[criterion.needs[0]])), dtype=bool)
    for _, value, low, high in ranges_of(criterion, columns, parameters):
        inside &= (value >= low) & (value <= high)
    return inside


def _ratio(columns: Columns) -> Array:
    return np.asarray(columns["a_max"] / np.asarray(columns["sphere.radius"], dtype=float))


def _pressure(columns: Columns, name: str = "p_field") -> Array:
    """Pressure that the stress inside, or at the rim, follows from [Pa]: of Hertz, for the same
    force and circle.
    """
    return np.asarray(columns[name if name in columns else "p_max"])


def _central_force(columns: Columns) -> Array:
    """Force that the centre and the equator feel [N]: the mean of both poles', exactly, (R19);
    P_max where equal.
    """
    return np.asarray(columns["force_at_centre" if "force_at_centre" in columns else "P_max"])


def _tabulated(name: str) -> Callable[[Columns, Parameters], Array]:
    def formula(columns: Columns, parameters: Parameters) -> Array:
        return _pressure(columns) * stress.ratio(name, _ratio(columns), columns["sphere.nu"])

    return formula


def _between(one: Array, two: Array, columns: Columns) -> Array:
    """What one pole's force does alone, what both do if equal, and by `balance` what they do as
    they are. (R20).

    On the axis the field is the sum of two, but for the place of its largest value; a weakest-link
    integral lies below, for a norm is convex.
    """
    return np.asarray(one + (two - one) * columns["balance"])


def _core(columns: Columns, parameters: Parameters) -> Array:
    ratio, nu = _ratio(columns), columns["sphere.nu"]
    field = stress.core_ratio(ratio, nu)[0]
    if "balance" in columns:
        field = _between(stress.ratio("core_one", ratio, nu), field, columns)
    return _pressure(columns) * field


def _equator(columns: Columns, parameters: Parameters) -> Array:
    ratio = np.square(_ratio(columns))
    found = (
        _pressure(columns) * ratio * stress.ratio("equator", _ratio(columns), columns["sphere.nu"])
    )
    if "force_at_centre" in columns:
        found = found * (_central_force(columns) / columns["P_max"])
    return np.asarray(found)


def strain_rate(columns: Columns) -> Array:
    """Mean strain rate of the core while the force rises [1/s]: core_tension/E times
    loading_rate/P_max.

    The core tension is taken to rise in proportion with the force.
    """
    growth = np.asarray(columns["loading_rate"]) / np.asarray(columns["P_max"])
    return np.asarray(_core(columns, {}) / np.asarray(columns["sphere.E"]) * growth)


def dynamic_increase(rate: Values, rate_0: Values) -> Array:
    """Strength at a strain rate over the quasi-static one: 1 + (rate/rate_0)^(2/3).

    Kimberley, Ramesh and Daphalapurkar, Acta Materialia 61 (2013) 3509, from memory; rate_0 of 150
    to 300 1/s in compression for four rocks: Rae and others (2021).

    >>> float(dynamic_increase(0.0, 200.0)), float(dynamic_increase(200.0, 200.0))
    (1.0, 2.0)
    """
    return np.asarray(
        1.0 + np.cbrt(np.square(np.maximum(rate, 0.0) / np.asarray(rate_0, dtype=float)))
    )


def ring_crack_toughness(force: Values, radius: Values, E: Values) -> Array:
    """Toughness at which a ring crack just becomes a cone: K = sqrt(P E/(A r)) [Pa sqrt(m)], A =
    8600.

    Auerbach's law P_C = A K_Ic² r/E turned round, so that force, size and stiffness stand on the
    side of the demand.
    """
    return np.asarray(np.sqrt(np.asarray(force) * E / (AUERBACH * np.asarray(radius))))


def hiramatsu_oka_tension(force: Values, radius: Values) -> Array:
    """0.9 P/D² [Pa], the tensile strength that irregular lumps are credited with in practice."""
    return np.asarray(0.9 * np.asarray(force) / np.square(2.0 * np.asarray(radius)))


def truncated_energy(energy: Values, largest: Values) -> Array:
    """E_max E/(E_max - E): what a fracture energy, bounded by E_max, becomes so that its law is
    lognormal.

    At E_max and above everything breaks; the number returned there, 1e9 E_max, lies beyond any
    strength.

    >>> truncated_energy([50.0, 200.0], 100.0).tolist()
    [100.0, 100000000000.0]
    """
    e, top = (np.asarray(part, dtype=float) for part in np.broadcast_arrays(energy, largest))
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(e < top, np.minimum(top * e / (top - e), _CERTAIN * top), _CERTAIN * top)


def equivalent_tension(
    pressure: Values,
    contact_ratio: Values,
    nu: Values,
    modulus: Values,
    size_ratio: Values,
    *,
    over: str = "volume",
) -> Array:
    """sigma_eq = (∫ max(sigma_phi, 0)^m dV/V_0)^(1/m) [Pa]; `over` is volume or surface, size_ratio
    V/V_0 or S/S_0.

    With a strength of modulus m and scale sigma_0 for the reference size, P_f = 1 -
    exp(-(sigma_eq/sigma_0)^m).  With `_one` after it, of one pole's force alone.
    """
    field = stress.ratio(over, contact_ratio, nu, modulus)
    return np.asarray(
        np.asarray(pressure) * field * np.asarray(size_ratio) ** (1.0 / np.asarray(modulus))
    )


def _weakest(over: str) -> Callable[[Columns, Parameters], Array]:
    def formula(columns: Columns, parameters: Parameters) -> Array:
        radius = np.asarray(columns["sphere.radius"])
        if over == "volume":
            size = 4.0 / 3.0 * math.pi * radius**3 / parameters["reference_volume"]
        else:
            size = 4.0 * math.pi * radius**2 / parameters["reference_area"]
        given = (
            _pressure(columns),
            _ratio(columns),
            columns["sphere.nu"],
            parameters["modulus"],
            size,
        )
        two = equivalent_tension(*given, over=over)
        if "balance" not in columns:
            return two
        share = {"balance": np.minimum(columns["balance"], 1.0)}
        return _between(equivalent_tension(*given, over=f"{over}_one"), two, share)

    return formula


def _weakest_rim(columns: Columns, parameters: Parameters) -> Array:
    ratio, nu, m = _ratio(columns), columns["sphere.nu"], parameters["modulus"]
    size = (
        4.0
        * math.pi
        * np.square(np.asarray(columns["sphere.radius"]))
        / parameters["reference_area"]
    )
    field = stress.half_space_rim(ratio, nu, m) * stress.ratio("rim", ratio, nu, m)
    if "balance" in columns:
        # each rim is a hazard of its own, that of an equal force half of both: it goes with a²
        # p_0^m
        other = np.minimum(columns["balance"], 1.0) ** ((m + 2.0) / 3.0)
        field = field * (0.5 * (1.0 + other)) ** (1.0 / m)
    return np.asarray(_pressure(columns) * field * size ** (1.0 / m))


def _energy_criterion(name: str, symbol: str, of: str) -> Criterion:
    """The fracture energy of one of the three energies of (R22); which one a strength means has to
    be said.
    """

    def energy(columns: Columns, parameters: Parameters) -> Array:
        found = np.asarray(columns[name], dtype=float)
        return (
            truncated_energy(found, parameters["largest_energy"])
            if "largest_energy" in parameters
            else found
        )

    return Criterion(
        name=name,
        quantity=name,
        symbol=symbol,
        display="J/kg",
        measures="specific energy, stretched so that a bounded fracture energy becomes lognormal",
        follows="energy" if name != "specific_impact_energy" else "",
        meaning=f"energy {of} per mass",
        formula="W/M, or E_max (W/M)/(E_max - W/M)",
        dimension="specific_energy",
        strength="specific fracture energy, lognormal (with E_max: upper-truncated)",
        source="Tavares and King, Int. J. Miner. Process. 54 (1998) 1, from memory",
        range_text="that of the contact",
        needs=(name,),
        optional=("largest_energy",),
        formula_of=energy,
    )


_FIELD: Final = ("p_max", "a_max", "sphere.radius", "sphere.nu")
_SERIES: Final = "Legendre series of the sphere under Hertz pressure on two caps, theory section 6"
_TABLE: Final = MappingProxyType({"a/r": stress.CONTACT_RATIO, "sphere.nu": stress.POISSON})
_TABLE_TEXT: Final = "0.005 <= a/r <= 0.3, 0 <= nu <= 0.5, equal forces"
_WEIBULL_TABLE: Final = MappingProxyType(
    {"a/r": stress.CONTACT_RATIO, "sphere.nu": stress.POISSON_WEIBULL, "modulus": stress.MODULUS}
)
_WEIBULL_TEXT: Final = "0.005 <= a/r <= 0.3, 0 <= nu <= 0.4, 2 <= m <= 50, equal forces"
_RATE: Final = ("rate_0",)

#: every criterion by name
CRITERIA: Final[dict[str, Criterion]] = {
    entry.name: entry
    for entry in (
        Criterion(
            name="contact_pressure",
            quantity="p_max",
            symbol="p_max",
            display="GPa",
            measures="largest contact pressure at either face",
            place="contact",
            also=("first_peak",),
            meaning="largest contact pressure",
            formula="p_max",
            dimension="pressure",
            strength="contact strength, 0.5 to 1 times the hardness (not the uniaxial strength)",
            source="Johnson, Contact Mechanics, 1985, section 6.2",
            range_text="a/r <= 0.3",
            needs=("p_max", "a_max", "sphere.radius"),
            ranges={"a/r": (0.0, 0.3)},
            formula_of=lambda columns, parameters: np.asarray(columns["p_max"], dtype=float),
        ),
        Criterion(
            name="edge_tension",
            quantity="edge_tension",
            symbol="sigma_e",
            display="GPa",
            measures="largest radial tension at the rim of the contact",
            place="rim",
            meaning="radial tension at the rim of the contact",
            formula="(1 - 2 nu)/3 p_max, or (1 - 2 nu)/2 p_mean beyond yield",
            dimension="pressure",
            strength="tensile strength of the surface",
            source="Johnson, Contact Mechanics, 1985, section 3.4; half space",
            range_text="a/r <= 0.05; far too severe where the stress is steep (see ring_crack)",
            needs=_FIELD,
            ranges={"a/r": (0.0, 0.05), "sphere.nu": (0.0, 0.5)},
            formula_of=lambda columns, parameters: np.asarray(
                contact.edge_tension(_pressure(columns, "p_rim"), np.asarray(columns["sphere.nu"]))
            ),
        ),
        Criterion(
            name="ring_crack",
            quantity="ring_crack_toughness",
            symbol="K_ring",
            display="MPa.sqrt(m)",
            measures="fracture toughness at which a ring crack just grows into a cone",
            place="rim",
            meaning="ring crack that grows into a cone, by fracture mechanics",
            formula="sqrt(P_max E/(8600 r))",
            dimension="toughness",
            strength="fracture toughness K_Ic",
            source="Lawn, J. Am. Ceram. Soc. 81 (1998) 1977, from memory; Auerbach's law",
            range_text="a/r <= 0.2; surface flaws of about 0.01 to 0.1 a",
            needs=("P_max", "a_max", "sphere.radius", "sphere.E"),
            ranges={"a/r": (0.0, 0.2)},
            formula_of=lambda columns, parameters: ring_crack_toughness(
                columns["P_max"], columns["sphere.radius"], columns["sphere.E"]
            ),
        ),
        Criterion(
            name="core_tension",
            quantity="core_tension",
            symbol="sigma_core",
            display="MPa",
            measures="largest hoop tension on the axis inside the sphere",
            place="core",
            meaning="largest hoop tension on the axis",
            formula="p_max f(a/r, nu)",
            dimension="pressure",
            strength="tensile strength",
            source=_SERIES,
            range_text=_TABLE_TEXT,
            needs=_FIELD,
            optional=_RATE,
            ranges=_TABLE,
            formula_of=_core,
        ),
        Criterion(
            name="centre_tension",
            quantity="centre_tension",
            symbol="sigma_c",
            display="MPa",
            measures="tension at the centre of the sphere at the largest force",
            place="core",
            meaning="tension at the centre, point loads",
            formula="21 P_max/(pi (7 + 5 nu) D²)",
            dimension="pressure",
            strength="tensile strength",
            source="degree 2 of the series, theory (19)",
            range_text="a/r <= 0.2",
            needs=("P_max", *_FIELD, "mean_force"),
            optional=_RATE,
            ranges={"a/r": (0.0, 0.2), "sphere.nu": (0.0, 0.5)},
            formula_of=lambda columns, parameters: np.asarray(
                contact.centre_tension(
                    _central_force(columns),
                    np.asarray(columns["sphere.radius"]),
                    np.asarray(columns["sphere.nu"]),
                )
            ),
        ),
        Criterion(
            name="equatorial_tension",
            quantity="equatorial_tension",
            symbol="sigma_eq",
            display="MPa",
            measures="hoop tension on the sphere's surface half-way between the contacts",
            place="core",
            meaning="hoop tension on the surface at the equator",
            formula="p_max (a/r)² f(a/r, nu)",
            dimension="pressure",
            strength="tensile strength of the surface",
            source=_SERIES,
            range_text=_TABLE_TEXT,
            needs=(*_FIELD, "mean_force"),
            optional=_RATE,
            ranges=_TABLE,
            formula_of=_equator,
        ),
        Criterion(
            name="hiramatsu_oka",
            quantity="hiramatsu_oka_tension",
            symbol="sigma_HO",
            display="MPa",
            measures="tensile stress 0.9 P/D² that lumps of rock are credited with in practice",
            place="core",
            meaning="tensile stress as used in practice for lumps of rock",
            formula="0.9 P_max/D²",
            dimension="pressure",
            strength="point-load (Hiramatsu-Oka) strength",
            source="Hiramatsu and Oka, Int. J. Rock Mech. Min. Sci. 3 (1966) 89",
            range_text="a/r <= 0.2",
            needs=("P_max", "a_max", "sphere.radius", "mean_force"),
            optional=_RATE,
            ranges={"a/r": (0.0, 0.2)},
            formula_of=lambda columns, parameters: hiramatsu_oka_tension(
                _central_force(columns), columns["sphere.radius"]
            ),
        ),
        Criterion(
            name="grain_tension",
            quantity="grain_tension",
            symbol="sigma_F",
            display="MPa",
            measures="nominal tension P/D² of a grain between two platens",
            place="core",
            meaning="tension by which grains of sand and rockfill are ranked in crushing tests",
            formula="P_max/D²",
            dimension="pressure",
            strength="characteristic stress of crushing tests on grains (37 % survive it)",
            source=(
                "McDowell and Bolton, Geotechnique 48 (1998) 667, abstract seen; Jaeger 1967, "
                "from memory"
            ),
            range_text="a/r <= 0.2",
            needs=("P_max", "a_max", "sphere.radius", "mean_force"),
            optional=_RATE,
            ranges={"a/r": (0.0, 0.2)},
            formula_of=lambda columns, parameters: np.asarray(
                _central_force(columns) / np.square(2.0 * np.asarray(columns["sphere.radius"]))
            ),
        ),
        Criterion(
            name="weakest_link_volume",
            meaning="flaws in the volume opened by the hoop tension",
            symbol="sigma_V",
            display="MPa",
            measures=(
                "uniform tension in the reference volume that is as dangerous as the hoop "
                "tension in the sphere"
            ),
            place="core",
            formula="(∫ max(sigma_phi, 0)^m dV/V_0)^(1/m)",
            dimension="pressure",
            strength="Weibull strength of modulus m of the reference volume",
            source=f"Weibull 1939; {_SERIES}",
            range_text=_WEIBULL_TEXT,
            needs=_FIELD,
            parameters=("modulus", "reference_volume"),
            optional=_RATE,
            ranges=_WEIBULL_TABLE,
            formula_of=_weakest("volume"),
        ),
        Criterion(
            name="weakest_link_surface",
            meaning="flaws in the surface opened by the hoop tension",
            symbol="sigma_S",
            display="MPa",
            measures=(
                "uniform tension in the reference area that is as dangerous as that in the "
                "sphere's surface"
            ),
            place="core",
            formula="(∫ max(sigma_phi, 0)^m dS/S_0)^(1/m)",
            dimension="pressure",
            strength="Weibull strength of modulus m of the reference area",
            source=f"Weibull 1939; {_SERIES}",
            range_text=_WEIBULL_TEXT,
            needs=_FIELD,
            parameters=("modulus", "reference_area"),
            optional=_RATE,
            ranges=_WEIBULL_TABLE,
            formula_of=_weakest("surface"),
        ),
        Criterion(
            name="weakest_link_rim",
            meaning="flaws in the surface around both contacts opened by the radial tension",
            symbol="sigma_rim",
            display="MPa",
            measures=(
                "uniform tension in the reference area that is as dangerous as that around the "
                "contacts"
            ),
            place="rim",
            formula="(∫ max(sigma_t, 0)^m dS/S_0)^(1/m), sigma_t the largest so far",
            dimension="pressure",
            strength="Weibull strength of modulus m of the reference area",
            source=f"Oh and Finnie, J. Mech. Phys. Solids 15 (1967) 401, from memory; {_SERIES}",
            range_text=_WEIBULL_TEXT,
            needs=_FIELD,
            parameters=("modulus", "reference_area"),
            ranges=_WEIBULL_TABLE,
            formula_of=_weakest_rim,
        ),
        *(
            _energy_criterion(name, symbol, of)
            for name, symbol, of in (
                ("specific_energy", "E'", "stored in both contacts, of both bodies"),
                ("specific_energy_sphere", "E_s'", "that is the sphere's share of both contacts"),
                ("specific_impact_energy", "E_in'", "that the blow offers"),
            )
        ),
        Criterion(
            name="subsurface_shear",
            quantity="subsurface_shear",
            symbol="tau_max",
            display="MPa",
            measures="largest shear stress on the axis, below the contact",
            place="below",
            meaning="largest shear stress on the axis",
            formula="p_max f(a/r, nu)",
            dimension="pressure",
            strength="shear strength (yield, crushing below contact)",
            source=_SERIES,
            range_text=_TABLE_TEXT,
            needs=_FIELD,
            ranges=_TABLE,
            formula_of=_tabulated("shear"),
        ),
    )
}

#: Demands of criteria by the criterion; a study adds the limit's name,
#: ``weakest_link_volume.NAME``.
DEMANDS: Final[dict[str, Quantity]] = {
    name: Quantity(
        name=name,
        symbol=entry.symbol,
        dimension=entry.dimension,
        display=entry.display,
        follows=entry.follows,
        fracture=True,
        place=entry.place,
        needs=entry.needs,
        meaning=f"{entry.measures} over the increase of strength by its rate"
        if entry.optional == _RATE and entry.quantity is not None
        else entry.measures,
    )
    for name, entry in CRITERIA.items()
}

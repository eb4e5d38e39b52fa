"""Fracture criteria: which demand of a loaded sphere is compared with which strength.

All criteria have one signature: from columns of the impact model (SI, one row per sample) and their
own parameters they compute a column of demand.  The sphere breaks where the demand exceeds the
strength, a number or a distribution of the study.  `in_range` marks the rows outside the range of
the formula; the demand is computed there too, since a missing number would count as survival.
"""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Values
from uqsphere.mechanics import contact, stress
from uqsphere.units import Quantity

ColumnMap = Mapping[str, Values]
Parameters = Mapping[str, float]
#: further quantities: name -> criterion and its parameters
Demands = Mapping[str, tuple[str, Parameters]]


#: Auerbach's constant of a ring crack, P_C = A K_Ic²/E r (Lawn 1998)
AUERBACH: Final = 8.6e3
#: demand, over the largest fracture energy, of energies that break every particle
_CERTAIN: Final = 1e9


@dataclass(frozen=True, kw_only=True)
class Parameter:
    """A parameter of a criterion, with its bounds (exclusive)."""

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

    name, meaning, formula, source, range_text: texts; range_text describes `ranges`.  dimension,
    symbol, display: of demand and strength, as of a `Quantity`.  measures: meaning of the demand.
    strength: meaning of the strength it is compared with.  needs: columns, by the names of the
    nomenclature.  formula_of: function of (columns, parameters) that returns the demand, (n,),
    without the rate effect.  quantity: the quantity of interest that equals this demand without
    parameters; also: quantities that equal it over another part of the evaluation window.
    parameters, optional: required and optional names of `PARAMETERS`.  ranges: closed ranges of
    columns, of "a/r", and of parameters.  follows, place: as of a `Quantity`.
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
    formula_of: Callable[[ColumnMap, Parameters], Array]
    quantity: str | None = None
    also: tuple[str, ...] = ()
    parameters: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    follows: str = "force"
    place: str = ""

    def needs_with(self, parameters: Parameters) -> tuple[str, ...]:
        """Columns that the demand needs with these parameters."""
        if "rate_0" in parameters:
            return (*self.needs, "loading_rate", "P_max")
        return self.needs


def demand(
    criterion: Criterion, columns: ColumnMap, parameters: Parameters = MappingProxyType({})
) -> Array:
    """The demand of n rows [SI], to be compared with the criterion's strength.

    With `rate_0` the strength increases with the strain rate of each sample; the demand is divided
    by the increase instead, which is the same comparison.

    Raises ValueError for a parameter that is missing, unknown, or outside its bounds.

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
                f"{name} is not a parameter of the criterion {criterion.name} (allowed: {allowed})"
            )
        bounds = PARAMETERS[name]
        if not bounds.lower < value < bounds.upper:
            raise ValueError(
                f"{name} must be between {bounds.lower:g} and {bounds.upper:g}, not {value!r}"
            )
    contacts: list[ColumnMap] = [columns]
    if "sides" in columns:
        # contacts that differ, each with the force at the other one; the rest is that of the row
        contacts = [ChainMap(side, columns) for side in columns["sides"]]  # type: ignore[arg-type]
    demands = [
        np.atleast_1d(np.asarray(criterion.formula_of(contact_columns, parameters), dtype=float))
        for contact_columns in contacts
    ]
    largest = np.asarray(np.maximum.reduce(demands))
    if "rate_0" in parameters:
        return largest / dynamic_increase(strain_rate(columns), parameters["rate_0"])
    return largest


def ranges_of(
    criterion: Criterion, columns: ColumnMap, parameters: Parameters = MappingProxyType({})
) -> Iterator[tuple[str, Array, float, float]]:
    """Ranges of a criterion: the name, its values, (n,) or (1,), and both ends of the range."""
    for name, (low, high) in criterion.ranges.items():
        if name == "a/r":
            value: Values | None = _ratio(columns)
        elif name in parameters:
            value = parameters[name]
        else:
            value = columns.get(name)
        if value is not None:
            yield name, np.atleast_1d(np.asarray(value, dtype=float)), low, high


def in_range(
    criterion: Criterion, columns: ColumnMap, parameters: Parameters = MappingProxyType({})
) -> Flags:
    """Rows inside the range of the criterion, (n,)."""
    inside = np.ones(np.shape(np.atleast_1d(columns[criterion.needs[0]])), dtype=bool)
    for _, value, low, high in ranges_of(criterion, columns, parameters):
        inside &= (value >= low) & (value <= high)
    return inside


def _ratio(columns: ColumnMap) -> Array:
    return np.asarray(columns["a_max"] / np.asarray(columns["sphere.radius"], dtype=float))


def _pressure(columns: ColumnMap, name: str = "p_field") -> Array:
    """Hertz pressure of the same force and contact circle [Pa], from which stresses follow."""
    if name in columns:
        return np.asarray(columns[name])
    return np.asarray(columns["p_max"])


def _central_force(columns: ColumnMap) -> Array:
    """Force that loads the centre and the equator [N]: the mean of both contacts, exactly, (R19).

    It is P_max if both are equal.
    """
    if "force_at_centre" in columns:
        return np.asarray(columns["force_at_centre"])
    return np.asarray(columns["P_max"])


def _tabulated(name: str) -> Callable[[ColumnMap, Parameters], Array]:
    def formula(columns: ColumnMap, parameters: Parameters) -> Array:
        return _pressure(columns) * stress.ratio(name, _ratio(columns), columns["sphere.nu"])

    return formula


def _between(one: Array, two: Array, columns: ColumnMap) -> Array:
    """Stress under unequal forces, (R20): `one` of one force alone, `two` of two equal forces.

    On the axis the field is the sum of two, except for the location of its peak; a weakest-link
    integral is lower, since a norm is convex.
    """
    return np.asarray(one + (two - one) * columns["balance"])


def _core(columns: ColumnMap, parameters: Parameters) -> Array:
    ratio, nu = _ratio(columns), columns["sphere.nu"]
    field = stress.core_ratio(ratio, nu)[0]
    if "balance" in columns:
        field = _between(stress.ratio("core_one", ratio, nu), field, columns)
    return _pressure(columns) * field


def _equator(columns: ColumnMap, parameters: Parameters) -> Array:
    ratio = np.square(_ratio(columns))
    field = stress.ratio("equator", _ratio(columns), columns["sphere.nu"])
    tension = _pressure(columns) * ratio * field
    if "force_at_centre" in columns:
        tension = tension * (_central_force(columns) / columns["P_max"])
    return np.asarray(tension)


def strain_rate(columns: ColumnMap) -> Array:
    """Mean strain rate of the core during loading [1/s]: core_tension/E loading_rate/P_max.

    The core tension is taken as proportional to the force.
    """
    growth = np.asarray(columns["loading_rate"]) / np.asarray(columns["P_max"])
    return np.asarray(_core(columns, {}) / np.asarray(columns["sphere.E"]) * growth)


def dynamic_increase(rate: Values, rate_0: Values) -> Array:
    """Strain-rate strengthening factor: 1 + (rate/rate_0)^(2/3).

    Kimberley, Ramesh and Daphalapurkar, Acta Materialia 61 (2013) 3509, from memory; rate_0 of 110
    to 760 1/s fits seven rocks in compression (Rae and others 2020, 2021; docs/validation.md),
    measured on cylinders under compression and applied to tensions for want of tensile tests.

    >>> float(dynamic_increase(0.0, 200.0)), float(dynamic_increase(200.0, 200.0))
    (1.0, 2.0)
    """
    return np.asarray(
        1.0 + np.cbrt(np.square(np.maximum(rate, 0.0) / np.asarray(rate_0, dtype=float)))
    )


def ring_crack_toughness(force: Values, radius: Values, E: Values) -> Array:
    """Toughness at which a ring crack just becomes a cone crack [Pa sqrt(m)].

    K = sqrt(P E/(A r)), A = 8600: Auerbach's law P_C = A K_Ic² r/E solved for the toughness.
    """
    return np.asarray(np.sqrt(np.asarray(force) * E / (AUERBACH * np.asarray(radius))))


def hiramatsu_oka_tension(force: Values, radius: Values) -> Array:
    """0.9 P/D² [Pa], the tensile stress used in practice for irregular lumps."""
    return np.asarray(0.9 * np.asarray(force) / np.square(2.0 * np.asarray(radius)))


def truncated_energy(energy: Values, largest: Values) -> Array:
    """E_max E/(E_max - E): an upper-truncated lognormal fracture energy as a lognormal one.

    At E_max and above every particle breaks; there 1e9 E_max is returned, above any strength.

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
    """Equivalent tension of the weakest link [Pa]: (∫ max(sigma_phi, 0)^m dV/V_0)^(1/m).

    over: `volume` or `surface`; with the suffix `_one` for the force at one contact alone.
    size_ratio: V/V_0 or S/S_0.  With a strength of modulus m and scale sigma_0 for the reference
    size, P_f = 1 - exp(-(sigma_eq/sigma_0)^m).
    """
    field = stress.ratio(over, contact_ratio, nu, modulus)
    return np.asarray(pressure) * field * np.asarray(size_ratio) ** (1.0 / np.asarray(modulus))


def _weakest(over: str) -> Callable[[ColumnMap, Parameters], Array]:
    def formula(columns: ColumnMap, parameters: Parameters) -> Array:
        radius = np.asarray(columns["sphere.radius"])
        if over == "volume":
            size = 4.0 / 3.0 * math.pi * radius**3 / parameters["reference_volume"]
        else:
            size = 4.0 * math.pi * radius**2 / parameters["reference_area"]
        equivalent = partial(
            equivalent_tension,
            _pressure(columns),
            _ratio(columns),
            columns["sphere.nu"],
            parameters["modulus"],
            size,
        )
        two = equivalent(over=over)
        if "balance" not in columns:
            return two
        balance = {"balance": np.minimum(columns["balance"], 1.0)}
        return _between(equivalent(over=f"{over}_one"), two, balance)

    return formula


def _weakest_rim(columns: ColumnMap, parameters: Parameters) -> Array:
    ratio, nu, m = _ratio(columns), columns["sphere.nu"], parameters["modulus"]
    surface = 4.0 * math.pi * np.square(np.asarray(columns["sphere.radius"]))
    size = surface / parameters["reference_area"]
    field = stress.half_space_rim(ratio, nu, m) * stress.ratio("rim", ratio, nu, m)
    if "balance" in columns:
        # each rim is a hazard by itself, half of both under equal forces, proportional to a² p_0^m
        other = np.minimum(columns["balance"], 1.0) ** ((m + 2.0) / 3.0)
        field = field * (0.5 * (1.0 + other)) ** (1.0 / m)
    return np.asarray(_pressure(columns) * field * size ** (1.0 / m))


def _energy_criterion(name: str, symbol: str, of: str, follows: str = "energy") -> Criterion:
    """A fracture energy by one of the three definitions of (R22)."""

    def energy(columns: ColumnMap, parameters: Parameters) -> Array:
        specific = np.asarray(columns[name], dtype=float)
        if "largest_energy" in parameters:
            return truncated_energy(specific, parameters["largest_energy"])
        return specific

    return Criterion(
        name=name,
        quantity=name,
        symbol=symbol,
        display="J/kg",
        measures="specific energy: with largest_energy, E_max w/(E_max - w)",
        follows=follows,
        meaning=f"energy {of}, per sphere mass",
        formula="W/M, or E_max (W/M)/(E_max - W/M)",
        dimension="specific_energy",
        strength="specific fracture energy, lognormal (with E_max: upper-truncated)",
        source="Tavares and King, Int. J. Miner. Process. 54 (1998) 1, from memory",
        range_text="that of the contact law",
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
            measures="peak contact pressure",
            place="contact",
            also=("first_peak",),
            meaning="peak contact pressure",
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
            measures="peak radial tension at the contact rim",
            place="rim",
            meaning="radial tension at the contact rim",
            formula="(1 - 2 nu)/3 p_max, or (1 - 2 nu)/2 p_mean beyond yield",
            dimension="pressure",
            strength="tensile strength of the surface",
            source="Johnson, Contact Mechanics, 1985, section 3.4; half space",
            range_text="a/r <= 0.05; far too severe for steep stress gradients (see ring_crack)",
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
            measures="ring-crack toughness: at which a ring crack just grows into a cone crack",
            place="rim",
            meaning="growth of a ring crack into a cone crack (fracture mechanics)",
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
            measures="core tension: peak hoop tension on the axis of the sphere",
            place="core",
            meaning="peak hoop tension on the axis",
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
            measures="centre tension at peak force",
            place="core",
            meaning="tension at the centre of the sphere under point loads",
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
            measures="equatorial tension: hoop tension on the surface midway between the contacts",
            place="core",
            meaning="hoop tension on the surface at the equator of the sphere",
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
            measures="Hiramatsu-Oka tension: 0.9 P/D², as used for lumps of rock",
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
            measures="grain tension: nominal tension P/D² between two platens",
            place="core",
            meaning="nominal tension that ranks sand and rockfill grains in crushing tests",
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
            meaning="volume flaws opened by the hoop tension (weakest link)",
            symbol="sigma_V",
            display="MPa",
            measures="equivalent tension in the reference volume: of equal failure probability",
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
            meaning="surface flaws opened by the hoop tension (weakest link)",
            symbol="sigma_S",
            display="MPa",
            measures="equivalent tension in the reference area: of equal failure probability",
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
            meaning="surface flaws around the contacts opened by the radial tension (weakest link)",
            symbol="sigma_rim",
            display="MPa",
            measures="equivalent rim tension in the reference area: of equal failure probability",
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
        _energy_criterion("specific_energy", "E'", "stored elastically in both contacts"),
        _energy_criterion("specific_energy_sphere", "E_s'", "absorbed by the sphere"),
        _energy_criterion("specific_impact_energy", "E_in'", "of the impact", follows=""),
        Criterion(
            name="subsurface_shear",
            quantity="subsurface_shear",
            symbol="tau_max",
            display="MPa",
            measures="peak shear stress below the contact",
            place="below",
            meaning="peak shear stress on the axis, below the contact",
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


def _demand_meaning(entry: Criterion) -> str:
    """Meaning of a demand; criteria with a rate effect say that they include it."""
    if entry.optional == _RATE and entry.quantity is not None:
        name = entry.measures.partition(":")[0]
        return f"{name} divided by the strain-rate strengthening factor"
    return entry.measures


#: demands of criteria by the criterion; a study adds the limit's name,
#: ``weakest_link_volume.NAME``
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
        meaning=_demand_meaning(entry),
    )
    for name, entry in CRITERIA.items()
}

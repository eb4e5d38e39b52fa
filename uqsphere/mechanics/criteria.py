"""Fracture criteria: which demand of a loaded sphere is compared with which strength.

Every criterion is an entry of ``criteria.toml`` and a formula: from columns of the impact model
(SI, one row per sample) and its own parameters it computes a column of demand.  The sphere breaks
where the demand exceeds the strength, a number or a distribution of the study.  `in_range` marks
the rows inside the range of the formula; the demand is computed outside too, since a missing number
would count as survival.
"""

from __future__ import annotations

import math
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType

import numpy as np

from uqsphere.arrays import Array, Flags, Values
from uqsphere.mechanics import contact, stress
from uqsphere.mechanics.inputs import declared
from uqsphere.units import Quantity

ColumnMap = Mapping[str, Values]
Parameters = Mapping[str, float]
#: further quantities: name -> criterion and its parameters
Demands = Mapping[str, tuple[str, Parameters]]
Formula = Callable[[ColumnMap, Parameters], Array]


#: Auerbach's constant of a ring crack, P_C = A K_Ic²/E r (Lawn 1998)
AUERBACH = 8.6e3
#: demand, over the largest fracture energy, of energies that break every particle
_CERTAIN = 1e9
#: every parameter of every criterion
PARAMETERS: dict[str, Quantity] = {
    name: Quantity(
        name=name, symbol="", dimension=dimension, meaning=meaning, lower=lower, upper=upper
    )
    for name, dimension, meaning, lower, upper in (
        ("modulus", "number", "Weibull modulus m", 1.0, 1e3),
        ("reference_volume", "volume", "volume the strength is measured on", 0.0, math.inf),
        ("reference_area", "area", "area the strength is measured on", 0.0, math.inf),
        ("largest_energy", "specific_energy", "largest specific fracture energy", 0.0, math.inf),
        ("rate_0", "strain_rate", "strain rate at which the strength is doubled", 0.0, math.inf),
    )
}


@dataclass(frozen=True, kw_only=True)
class Criterion:
    """One criterion; fields as explained in criteria.toml."""

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


#: every criterion by name
CRITERIA = {
    name: Criterion(name=name, **entry) for name, entry in declared("criteria.toml").items()
}


def _demand_quantity(name: str, entry: Criterion) -> Quantity:
    """The nomenclature of a demand; with a rate effect its meaning says that it is included."""
    meaning = entry.measures
    if "rate_0" in entry.optional and entry.quantity is not None:
        label = meaning.partition(":")[0]
        meaning = f"{label} divided by the strain-rate strengthening factor"
    return Quantity(
        name=name,
        symbol=entry.symbol,
        dimension=entry.dimension,
        display=entry.display,
        follows=entry.follows,
        fracture=True,
        place=entry.place,
        needs=entry.needs,
        meaning=meaning,
    )


#: demands of criteria by the criterion; a study adds the limit's name,
#: ``weakest_link_volume.NAME``
DEMANDS = {name: _demand_quantity(name, entry) for name, entry in CRITERIA.items()}


def demand(
    criterion: Criterion, columns: ColumnMap, parameters: Parameters = MappingProxyType({})
) -> Array:
    """The demand of n rows [SI], to be compared with the criterion's strength.

    With `rate_0` the strength increases with the strain rate of each sample; the demand is divided
    by the increase instead, which is the same comparison: 1 + (rate/rate_0)^(2/3) by Kimberley,
    Ramesh and Daphalapurkar, Acta Materialia 61 (2013) 3509, from memory; rate_0 of 110 to 760 1/s
    fits seven rocks in compression (Rae and others 2020, 2021; docs/validation.md), measured on
    cylinders under compression and applied to tensions for want of tensile tests.

    >>> rows = {"p_max": np.array([1e9]), "a_max": 1e-3, "sphere.radius": 0.01, "sphere.nu": 0.25}
    >>> round(float(demand(CRITERIA["core_tension"], rows)[0]) / 1e6, 2)
    9.86
    """
    contacts: list[ColumnMap] = [columns]
    if "sides" in columns:
        # contacts that differ, each with the force at the other one; the rest is that of the row
        contacts = [ChainMap(side, columns) for side in columns["sides"]]  # type: ignore[arg-type]
    formula = FORMULAS[criterion.name]
    demands = [np.atleast_1d(formula(of_contact, parameters)) for of_contact in contacts]
    largest = np.asarray(np.maximum.reduce(demands))
    if "rate_0" in parameters:
        rate = np.maximum(strain_rate(columns), 0.0)
        return np.asarray(largest / (1.0 + np.cbrt(np.square(rate / parameters["rate_0"]))))
    return largest


def ranges_of(
    criterion: Criterion, columns: ColumnMap, parameters: Parameters = MappingProxyType({})
) -> Iterator[tuple[str, Array, float, float]]:
    """Ranges of a criterion: the name, its values, (n,) or (1,), and both ends of the range."""
    own = {**parameters, "a/r": columns["a_max"] / columns["sphere.radius"]}
    for name, (low, high) in criterion.ranges.items():
        values = ChainMap(own, columns)[name]  # type: ignore[arg-type]
        yield name, np.atleast_1d(values), low, high


def in_range(
    criterion: Criterion, columns: ColumnMap, parameters: Parameters = MappingProxyType({})
) -> Flags:
    """Rows inside the range of the criterion, (n,)."""
    inside = np.ones(len(columns["a_max"]), dtype=bool)
    for _, value, low, high in ranges_of(criterion, columns, parameters):
        inside &= (value >= low) & (value <= high)
    return inside


# --- formulas: functions of the columns of one contact, and of the parameters ---------------------


def _first(columns: ColumnMap, name: str, default: str) -> Array:
    """A column, or another one where it is not given."""
    return np.asarray(columns[name if name in columns else default])


def _field(columns: ColumnMap) -> tuple[Array, Array, Array]:
    """Hertz pressure of the same force and contact circle [Pa], a/r and nu: stresses follow."""
    pressure = _first(columns, "p_field", "p_max")
    return pressure, columns["a_max"] / columns["sphere.radius"], columns["sphere.nu"]


def _central_force(columns: ColumnMap) -> Array:
    """Force that loads the centre and the equator [N]: the mean of both contacts, exactly, (R19).

    It is P_max if both are equal.
    """
    return _first(columns, "force_at_centre", "P_max")


def _edge_tension(columns: ColumnMap, parameters: Parameters) -> Array:
    pressure = _first(columns, "p_rim", "p_max")
    return np.asarray(contact.edge_tension(pressure, columns["sphere.nu"]))


def _ring_crack(columns: ColumnMap, parameters: Parameters) -> Array:
    """Toughness at which a ring crack just becomes a cone crack [Pa sqrt(m)].

    K = sqrt(P E/(A r)), A = 8600: Auerbach's law P_C = A K_Ic² r/E solved for the toughness.
    """
    force, E, radius = (columns[name] for name in ("P_max", "sphere.E", "sphere.radius"))
    return np.asarray(np.sqrt(force * E / (AUERBACH * radius)))


def _between(one: Array, two: Array, balance: Array) -> Array:
    """Stress under unequal forces, (R20): `one` of one force alone, `two` of two equal forces.

    On the axis the field is the sum of two, except for the location of its peak; a weakest-link
    integral is lower, since a norm is convex.
    """
    return np.asarray(one + (two - one) * balance)


def _core(columns: ColumnMap, parameters: Parameters) -> Array:
    pressure, ratio, nu = _field(columns)
    tension = stress.core_ratio(ratio, nu)[0]
    if "balance" in columns:
        tension = _between(stress.ratio("core_one", ratio, nu), tension, columns["balance"])
    return pressure * tension


def _centre(columns: ColumnMap, parameters: Parameters) -> Array:
    radius = columns["sphere.radius"]
    nu = columns["sphere.nu"]
    return np.asarray(contact.centre_tension(_central_force(columns), radius, nu))


def _equator(columns: ColumnMap, parameters: Parameters) -> Array:
    pressure, ratio, nu = _field(columns)
    tension = pressure * np.square(ratio) * stress.ratio("equator", ratio, nu)
    if "force_at_centre" in columns:
        tension = tension * (_central_force(columns) / columns["P_max"])
    return np.asarray(tension)


def _nominal(columns: ColumnMap, parameters: Parameters, factor: float) -> Array:
    """A factor times P/D² [Pa]; 0.9 is the practice for irregular lumps."""
    return np.asarray(factor * _central_force(columns) / np.square(2.0 * columns["sphere.radius"]))


def _shear(columns: ColumnMap, parameters: Parameters) -> Array:
    pressure, ratio, nu = _field(columns)
    return pressure * stress.ratio("shear", ratio, nu)


def strain_rate(columns: ColumnMap) -> Array:
    """Mean strain rate of the core during loading [1/s]: core_tension/E loading_rate/P_max.

    The core tension is taken as proportional to the force.
    """
    growth = columns["loading_rate"] / columns["P_max"]
    return np.asarray(_core(columns, {}) / columns["sphere.E"] * growth)


def _weakest_link(columns: ColumnMap, parameters: Parameters, over: str) -> Array:
    """Equivalent tension of the weakest link [Pa]: (∫ max(sigma_phi, 0)^m dV/V_0)^(1/m).

    over: `volume` or `surface`.  With a strength of modulus m and scale sigma_0 for the reference
    size, P_f = 1 - exp(-(sigma_eq/sigma_0)^m).
    """
    pressure, ratio, nu = _field(columns)
    m = parameters["modulus"]
    radius = columns["sphere.radius"]
    if over == "volume":
        size = 4.0 / 3.0 * math.pi * radius**3 / parameters["reference_volume"]
    else:
        size = 4.0 * math.pi * radius**2 / parameters["reference_area"]
    growth = size ** (1.0 / m)
    two = pressure * stress.ratio(over, ratio, nu, m) * growth
    if "balance" not in columns:
        return np.asarray(two)
    one = pressure * stress.ratio(f"{over}_one", ratio, nu, m) * growth
    return _between(one, two, np.minimum(columns["balance"], 1.0))


def _weakest_rim(columns: ColumnMap, parameters: Parameters) -> Array:
    pressure, ratio, nu = _field(columns)
    m = parameters["modulus"]
    surface = 4.0 * math.pi * np.square(columns["sphere.radius"])
    tension = stress.half_space_rim(ratio, nu, m) * stress.ratio("rim", ratio, nu, m)
    if "balance" in columns:
        # each rim is a hazard by itself, half of both under equal forces, proportional to a² p_0^m
        other = np.minimum(columns["balance"], 1.0) ** ((m + 2.0) / 3.0)
        tension = tension * (0.5 * (1.0 + other)) ** (1.0 / m)
    size = surface / parameters["reference_area"]
    return np.asarray(pressure * tension * size ** (1.0 / m))


def _specific_energy(columns: ColumnMap, parameters: Parameters, name: str) -> Array:
    """A fracture energy w by one of the three definitions of (R22).

    With a largest energy it is E_max w/(E_max - w): an upper-truncated lognormal fracture energy as
    a lognormal one.  At E_max and above every particle breaks; there 1e9 E_max is returned, above
    any strength.
    """
    energy: Array = columns[name]
    if "largest_energy" not in parameters:
        return energy
    top = parameters["largest_energy"]
    with np.errstate(divide="ignore", invalid="ignore"):
        equivalent = np.minimum(top * energy / (top - energy), _CERTAIN * top)
        return np.where(energy < top, equivalent, _CERTAIN * top)


#: formula of every criterion, without the rate effect
FORMULAS: dict[str, Formula] = {
    "contact_pressure": lambda columns, parameters: columns["p_max"],
    "edge_tension": _edge_tension,
    "ring_crack": _ring_crack,
    "core_tension": _core,
    "centre_tension": _centre,
    "equatorial_tension": _equator,
    "hiramatsu_oka": partial(_nominal, factor=0.9),
    "grain_tension": partial(_nominal, factor=1.0),
    "weakest_link_volume": partial(_weakest_link, over="volume"),
    "weakest_link_surface": partial(_weakest_link, over="surface"),
    "weakest_link_rim": _weakest_rim,
    "subsurface_shear": _shear,
    **{
        name: partial(_specific_energy, name=name)
        for name in ("specific_energy", "specific_energy_sphere", "specific_impact_energy")
    },
}

"""Fracture criteria: which demand of a loaded sphere is compared with which strength.

Every criterion is an entry of ``criteria.toml`` and a formula: from columns of the impact model
(SI, one row per sample) and its own parameters it computes a column of demand.  The sphere breaks
where the demand exceeds the strength, a number or a distribution of the study.  `ranges_of`
tells the range of the formula; the demand is computed outside too, since a missing number would
count as survival.
"""

import math
from collections import ChainMap
from collections.abc import Callable, Iterator, Mapping
from dataclasses import field, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from uqsphere.arrays import Array, ColumnMap, Duo, Names, Values, frozen, quiet
from uqsphere.units import Quantity

from . import contact, stress
from .inputs import declared

Parameters = Mapping[str, float]
#: further quantities: name -> criterion and its parameters
Demands = Mapping[str, tuple[str, Parameters]]


#: Auerbach's constant of a ring crack, P_C = A K_Ic²/E r (Lawn 1998)
AUERBACH = 8.6e3
#: demand, over the largest fracture energy, of energies that break every particle
CERTAIN = 1e9
#: every parameter of every criterion
PARAMETERS = declared("parameters.toml", Quantity)


@frozen
class Criterion(Quantity):
    """One criterion, a quantity as its demand is one; fields as explained in criteria.toml."""

    formula: str
    source: str
    range_text: str
    measures: str
    strength: str
    quantity: str | None = None
    also: Names = ()
    parameters: Names = ()
    optional: Names = ()
    ranges: Mapping[str, Duo] = field(default_factory=dict)
    follows: str = "force"
    fracture: bool = True

    def needs_with(self, parameters: Parameters) -> Names:
        """Columns that the demand needs with these parameters."""
        if "rate_0" in parameters:
            return (*self.needs, "loading_rate", "P_max")
        return self.needs


#: every criterion by name
CRITERIA = declared("criteria.toml", Criterion)


def _demand_quantity(entry: Criterion) -> Quantity:
    """The nomenclature of a demand; with a rate effect its meaning says that it is included."""
    quantity = replace(entry, meaning=entry.measures)
    if "rate_0" in entry.optional and entry.quantity is not None:
        meaning = f"{quantity.called} divided by the strain-rate strengthening factor"
        return replace(quantity, meaning=meaning)
    return quantity


#: demands of criteria by the criterion; a study adds the limit's name,
#: ``weakest_link_volume.NAME``
DEMANDS = {name: _demand_quantity(entry) for name, entry in CRITERIA.items()}


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
    # contacts that differ, each with the force at the other one; the rest is that of the row
    sides = columns.get("sides", [{}])
    formula = FORMULAS[criterion.name]
    demands = [np.atleast_1d(formula(_chain(parameters, side, columns))) for side in sides]
    largest: Array = np.maximum.reduce(demands)
    if "rate_0" in parameters:
        rate = np.maximum(strain_rate(columns), 0.0)
        largest = largest / (1.0 + (rate / parameters["rate_0"]) ** (2.0 / 3.0))
    return largest


def _chain(*maps: ColumnMap) -> ColumnMap:
    """The columns of several maps, of the first one that has a name."""
    return ChainMap(*maps)  # type: ignore[arg-type]


def ranges_of(
    criterion: Criterion, columns: ColumnMap, parameters: Parameters
) -> Iterator[tuple[str, Array, float, float]]:
    """Ranges of a criterion: the name, its values, (n,) or (1,), and both ends of the range."""
    ratio = {"a/r": columns["a_max"] / columns["sphere.radius"]}
    for name, (low, high) in criterion.ranges.items():
        yield name, np.atleast_1d(_chain(parameters, ratio, columns)[name]), low, high


# --- formulas: functions of the columns of one contact, and of the parameters, by their names -----


def _first(c: ColumnMap, name: str, default: str) -> Values:
    """A column, or another one where it is not given."""
    return c[name if name in c else default]


def _field(c: ColumnMap) -> tuple[Values, Values, Values]:
    """Hertz pressure of the same force and contact circle [Pa], a/r and nu: stresses follow."""
    return _first(c, "p_field", "p_max"), c["a_max"] / c["sphere.radius"], c["sphere.nu"]


def _central_force(c: ColumnMap) -> Values:
    """Force that loads the centre and the equator [N]: the mean of both contacts, exactly, (R19).

    It is P_max if both are equal.
    """
    return _first(c, "force_at_centre", "P_max")


def _between(one: Values, two: Values, balance: Values) -> Values:
    """Stress under unequal forces, (R20): `one` of one force alone, `two` of two equal forces.

    On the axis the field is the sum of two, except for the location of its peak; a weakest-link
    integral is lower, since a norm is convex.
    """
    return one + (two - one) * balance


def _stress(c: ColumnMap, name: str) -> Values:
    """A stress of the tables [Pa]."""
    pressure, ratio, nu = _field(c)
    return pressure * stress.ratio(name, ratio, nu)


def _core(c: ColumnMap) -> Values:
    pressure, ratio, nu = _field(c)
    tension = stress.core_ratio(ratio, nu)
    if "balance" in c:
        tension = _between(stress.ratio("core_one", ratio, nu), tension, c["balance"])
    return pressure * tension


def _equator(c: ColumnMap) -> Values:
    tension = _stress(c, "equator") * np.square(c["a_max"] / c["sphere.radius"])
    if "force_at_centre" in c:
        tension = tension * (_central_force(c) / c["P_max"])
    return tension


def _nominal(c: ColumnMap, factor: float = 1.0) -> Values:
    """A factor times P/D² [Pa]; 0.9 is the practice for irregular lumps."""
    return factor * _central_force(c) / np.square(2.0 * c["sphere.radius"])


def strain_rate(c: ColumnMap) -> Values:
    """Mean strain rate of the core during loading [1/s]: core_tension/E loading_rate/P_max.

    The core tension is taken as proportional to the force.
    """
    return _core(c) / c["sphere.E"] * (c["loading_rate"] / c["P_max"])


def _weakest_link(c: ColumnMap, over: str) -> Values:
    """Equivalent tension of the weakest link [Pa]: (∫ max(sigma_phi, 0)^m dV/V_0)^(1/m).

    over: `volume` or `surface`.  With a strength of modulus m and scale sigma_0 for the reference
    size, P_f = 1 - exp(-(sigma_eq/sigma_0)^m).
    """
    pressure, ratio, nu = _field(c)
    m = c["modulus"]
    radius = c["sphere.radius"]
    if over == "volume":
        size = 4.0 / 3.0 * math.pi * radius**3 / c["reference_volume"]
    else:
        size = 4.0 * math.pi * radius**2 / c["reference_area"]
    tension = stress.ratio(over, ratio, nu, m)
    if "balance" in c:
        one = stress.ratio(f"{over}_one", ratio, nu, m)
        tension = _between(one, tension, np.minimum(c["balance"], 1.0))
    return pressure * tension * size ** (1.0 / m)


def _weakest_rim(c: ColumnMap) -> Values:
    pressure, ratio, nu = _field(c)
    m = c["modulus"]
    surface = 4.0 * math.pi * np.square(c["sphere.radius"])
    tension = stress.half_space_rim(ratio, nu, m) * stress.ratio("rim", ratio, nu, m)
    if "balance" in c:
        # each rim is a hazard by itself, half of both under equal forces, proportional to a² p_0^m
        other = np.minimum(c["balance"], 1.0) ** ((m + 2.0) / 3.0)
        tension = tension * (0.5 * (1.0 + other)) ** (1.0 / m)
    return pressure * tension * (surface / c["reference_area"]) ** (1.0 / m)


@quiet
def _specific_energy(c: ColumnMap, name: str) -> Values:
    """A fracture energy w by one of the three definitions of (R22).

    With a largest energy it is E_max w/(E_max - w): an upper-truncated lognormal fracture energy as
    a lognormal one.  At E_max and above every particle breaks; there 1e9 E_max is returned, above
    any strength.
    """
    energy = c[name]
    if "largest_energy" not in c:
        return energy
    top = c["largest_energy"]
    equivalent = np.minimum(top * energy / (top - energy), CERTAIN * top)
    return np.where(energy < top, equivalent, CERTAIN * top)


#: formula of every criterion, without the rate effect
FORMULAS: dict[str, Callable[[ColumnMap], Values]] = {
    "contact_pressure": lambda c: c["p_max"],
    "edge_tension": lambda c: contact.edge_tension(_first(c, "p_rim", "p_max"), c["sphere.nu"]),
    # toughness [Pa sqrt(m)] at which a ring crack just becomes a cone crack, K = sqrt(P E/(A r)):
    # Auerbach's law P_C = A K_Ic² r/E, A = 8600, solved for the toughness
    "ring_crack": lambda c: np.sqrt(c["P_max"] * c["sphere.E"] / (AUERBACH * c["sphere.radius"])),
    "core_tension": _core,
    "centre_tension": lambda c: contact.centre_tension(
        _central_force(c), c["sphere.radius"], c["sphere.nu"]
    ),
    "equatorial_tension": _equator,
    "hiramatsu_oka": partial(_nominal, factor=0.9),
    "grain_tension": _nominal,
    "weakest_link_volume": partial(_weakest_link, over="volume"),
    "weakest_link_surface": partial(_weakest_link, over="surface"),
    "weakest_link_rim": _weakest_rim,
    "subsurface_shear": lambda c: _stress(c, "shear"),
    **{
        name: partial(_specific_energy, name=name)
        for name in ("specific_energy", "specific_energy_sphere", "specific_impact_energy")
    },
}

"""Quantities of interest: what each is, how it follows from what was integrated, and the answers of a batch in SI.

A quantity is one entry of `OUTPUTS` or, if it is what a criterion of fracture compares with a strength, the entry of
that criterion in `uqsphere.mechanics.criteria`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places, Values
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CRITERIA, Criterion, Demands, demand, product_fineness
from uqsphere.mechanics.integrator.tracked import NOT_FINITE, SCALED
from uqsphere.mechanics.scene import Scene, answered
from uqsphere.units import Quantity

#: scale factors of a scene that formulas read beside its own columns
_SCALES: Final = ("modulus", "effective_radius", "hertz_constant", "mass", "force", "approach", "time")


def _of_criterion(entry: Criterion) -> Quantity:
    return Quantity(
        name=str(entry.quantity), symbol=entry.symbol, dimension=entry.dimension, display=entry.display,
        meaning=entry.measures, follows=entry.follows, fracture=True, place=entry.place, needs=entry.needs,
        formula=lambda columns: demand(entry, columns),
    )  # fmt: skip


#: Every quantity of interest that the impact model answers.
OUTPUTS: Final[dict[str, Quantity]] = {entry.name: entry for entry in (
    Quantity(name="p_max", symbol="p_max", dimension="pressure", display="GPa", follows="force", fracture=True,
             meaning="largest contact pressure at either face", place="contact",
             needs=("P_max", "modulus", "effective_radius"),
             formula=lambda c: contact.pressure_at_force(c["P_max"], c["modulus"], c["effective_radius"])),
    Quantity(name="p_hertz", symbol="p_H", dimension="pressure", display="GPa", follows="force", fracture=True,
             meaning="pressure that the largest force is by Hertz, yield or not", place="contact",
             needs=("P_max", "modulus", "effective_radius"),
             formula=lambda c: contact.pressure_at_force(c["P_max"], c["modulus"], c["effective_radius"])),
    Quantity(name="P_max", symbol="P_max", dimension="force", display="kN", follows="force", fracture=True,
             meaning="largest contact force at either face", needs=("force", "x_max"),
             formula=lambda c: c["force"] * c["x_max"] ** c["power"]),
    Quantity(name="alpha_max", symbol="alpha_max", dimension="length", display="um", follows="force",
             meaning="approach of sphere and bar at the largest force", needs=("approach", "x_max"),
             formula=lambda c: c["approach"] * c["x_max"]),
    Quantity(name="a_max", symbol="a_max", dimension="length", display="mm", follows="force",
             meaning="radius of the contact circle at the largest force",
             needs=("P_max", "hertz_constant", "effective_radius"),
             formula=lambda c: contact.contact_radius(
                 contact.approach_at_force(c["P_max"], c["hertz_constant"]), c["effective_radius"])),
    Quantity(name="mean_pressure", symbol="p_m", dimension="pressure", display="GPa", follows="force", place="contact",
             meaning="mean pressure over the contact circle at the largest force, as hardness is measured",
             needs=("P_max", "a_max"), formula=lambda c: c["P_max"] / (np.pi * np.square(c["a_max"]))),
    Quantity(name="contact_time", symbol="t_contact", dimension="time", display="us", rough=24_000,
             meaning="time from first touch to the first loss of contact at either face", needs=("time", "contact"),
             censored="contact_censored",
             formula=lambda c: c["time"] * c["contact"]),
    Quantity(name="pulse_width", symbol="t_width", dimension="time", display="us", rough=16_000,
             meaning="time between the first and the last crossing of half the largest force", needs=("time", "width"),
             censored="width_censored",
             formula=lambda c: c["time"] * c["width"]),
    Quantity(name="rise_time", symbol="t_rise", dimension="time", display="us", rough=16_000,
             meaning="time between the first crossings of 10 % and 90 % of the largest force", needs=("time", "rise"),
             formula=lambda c: c["time"] * c["rise"]),
    Quantity(name="loading_rate", symbol="dP/dt", dimension="loading_rate", display="MN/s", rough=16_000,
             meaning="mean loading rate, 0.8 P_max over the rise time", needs=("P_max", "rise_time"),
             formula=lambda c: 0.8 * c["P_max"] / c["rise_time"]),
    Quantity(name="first_peak", symbol="p_first", dimension="pressure", display="GPa", follows="force", fracture=True,
             meaning="largest contact pressure before the first reflected wave returns", early=True, place="contact",
             needs=("force", "x_first", "modulus", "effective_radius"),
             formula=lambda c: contact.pressure_at_force(
                 c["force"] * c["x_first"] ** c["power"], c["modulus"], c["effective_radius"])),
    Quantity(name="force_imbalance", symbol="|P_A-P_B|/P_max", dimension="number", rough=50_000,
             meaning="largest difference of the two contact forces over the largest force",
             needs=("difference", "x_max"), formula=lambda c: c["difference"] / c["x_max"] ** c["power"]),
    Quantity(name="energy", symbol="W", dimension="energy", display="J", follows="energy", fracture=True,
             meaning="largest elastic energy stored in both contacts", needs=("force", "approach", "stored"),
             formula=lambda c: c["force"] * c["approach"] * c["stored"]),
    Quantity(name="specific_energy", symbol="W/M", dimension="specific_energy", display="J/kg", follows="energy",
             meaning="largest elastic energy stored in both contacts, per mass of the sphere", fracture=True,
             needs=("energy", "mass"), formula=lambda c: c["energy"] / c["mass"]),
    Quantity(name="t10", symbol="t10", dimension="share", display="%", upper=1.0, follows="energy",
             meaning="share of the product finer than a tenth of the sphere, if it breaks (needs [product])",
             needs=("specific_energy", "product.A", "product.b"),
             formula=lambda c: product_fineness(c["specific_energy"], c["product.A"], c["product.b"])),
)}  # fmt: skip
OUTPUTS.update(
    (entry.quantity, _of_criterion(entry))
    for entry in CRITERIA.values()
    if entry.quantity is not None and entry.quantity not in OUTPUTS
)


class Columns(Mapping[str, Any]):
    """Columns of n rows by name, (n,) each: what is known, and every quantity of `OUTPUTS`, computed when read."""

    def __init__(self, known: Mapping[str, Any]) -> None:
        self._known = dict(known)

    def __getitem__(self, name: str) -> Values:
        if name not in self._known:
            formula = OUTPUTS[name].formula
            assert formula is not None
            with np.errstate(all="ignore"):
                self._known[name] = formula(self)
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)


def columns_of(scene: Scene, rows: Places | slice = slice(None)) -> dict[str, Any]:
    """Numbers and scale factors of some rows of a scene."""
    scales = {name: getattr(scene.scales, name)[rows] for name in _SCALES}
    return {**{name: column[rows] for name, column in scene.columns.items()}, **scales}


def _roots(name: str, demands: Demands) -> set[str]:
    """What the integrator has to know for a quantity: names of `SCALED`, and inputs that may be absent."""
    if name in demands:
        key, parameters = demands[name]
        needs: tuple[str, ...] = CRITERIA[key].needs_with(parameters)
    elif name in OUTPUTS:
        needs = OUTPUTS[name].needs
    else:
        return {name}
    return set().union(*(_roots(need, demands) for need in needs))


def wishes(quantities: Collection[str] | None, demands: Demands = MappingProxyType({})) -> int:
    """What an integrator has to follow for these quantities and demands, or for all: sum of tracked.WANT_*."""
    names = OUTPUTS if quantities is None else quantities
    wanted = 0
    for name in set().union(*(_roots(name, demands) for name in names)) & SCALED.keys():
        wanted |= SCALED[name][1]
    return wanted


def follows_force(quantity: str) -> bool:
    """Whether a slow test tells the quantity from the force at failure alone.

    >>> follows_force("core_tension"), follows_force("contact_time")
    (True, False)
    """
    return quantity in OUTPUTS and OUTPUTS[quantity].follows != "" and "product.A" not in _roots(quantity, {})


def at_force(force: Values, known: Mapping[str, Any]) -> Columns:
    """Columns of n spheres that are loaded slowly up to a force [N].

    Parameters
    ----------
    force : (n,) array
        At both faces [N].
    known : mapping of str to arrays
        `modulus`, `effective_radius`, `hertz_constant`, `mass`, and what the criteria read of the sphere.
    """
    approach = contact.approach_at_force(force, known["hertz_constant"])
    columns = Columns({
        **known, "P_max": force, "alpha_max": approach,
        "energy": 2.0 * contact.contact_energy(approach, known["hertz_constant"]),
    })  # fmt: skip
    return Columns({**columns, "first_peak": columns["p_max"]})


# --- answers of a batch -------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Quantities of interest of n rows.

    Attributes
    ----------
    values : mapping of str to (n,) array
        The quantities asked for, all of `OUTPUTS` by default, SI; NaN where `status` is not 0 or 7.
    censored : mapping of str to (n,) array of bool
        For contact_time and pulse_width: the record ended first, the value is a lower bound.
    status : (n,) array of int
        0, or a code of `uqsphere.mechanics.scene.STATUS`; rows of 0 and of 7 have values.
    record : (n,) array
        End of the record [s], or the time after which nothing that was asked for could change.
    steps : (n,) array of int
        Steps of the integrator.
    others : mapping of str to (n,) array
        Where the status is 7, the quantities if contact is decided the other way; NaN elsewhere, empty if no
        row is undecided.
    """

    values: Mapping[str, Array]
    censored: Mapping[str, Flags]
    status: Places
    record: Array
    steps: Places
    others: Mapping[str, Array] = field(default_factory=dict)


def _absent(scene: Scene, quantity: str) -> set[str]:
    """Numbers that a quantity needs and a scene does not have."""
    return {name for name in _roots(quantity, scene.demands) if "." in name} - scene.columns.keys()


def _value(scene: Scene, columns: Columns, quantity: str) -> Array:
    if absent := sorted(_absent(scene, quantity)):
        tables = " and ".join(sorted({f"[{name.partition('.')[0]}]" for name in absent}))
        raise ValueError(f"{quantity} needs {' and '.join(absent)}: add them in the table {tables}")
    if quantity not in scene.demands:
        return np.asarray(columns[quantity])
    key, parameters = scene.demands[quantity]
    return demand(CRITERIA[key], columns, parameters)


def answers_of(
    scene: Scene,
    scaled: Array,
    status: Places,
    steps: Places,
    *,
    linear: bool = False,
    quantities: Collection[str] | None = None,
) -> Answers:
    """Answers in SI from scaled ones; `linear`: force is proportional to the approach, pressure follows by Hertz.

    Parameters
    ----------
    scaled : (n, ANSWERS) array
        Columns as `uqsphere.mechanics.integrator.tracked.SCALED` numbers them.
    quantities : collection of str, optional
        Names of `OUTPUTS` or of the scene's demands; all that the scene has the numbers for if None.

    A row one of whose quantities is not finite has failed.

    Raises
    ------
    ValueError
        For a quantity that needs numbers which the scene does not have.
    """
    tracked = {name: scaled[:, column] for name, (column, _) in SCALED.items()}
    columns = Columns({**columns_of(scene), **tracked, "power": 1.0 if linear else 1.5})
    if quantities is None:
        quantities = [*(name for name in OUTPUTS if not _absent(scene, name)), *scene.demands]
    values = {name: _value(scene, columns, name) for name in quantities}
    finite = np.logical_and.reduce([np.isfinite(value) for value in (columns["x_max"], *values.values())])
    status = np.where(answered(status) & ~finite, NOT_FINITE, status)
    bad = ~answered(status)
    values = {name: np.where(bad, np.nan, value) for name, value in values.items()}
    censored = {
        name: (columns[OUTPUTS[name].censored] > 0.0) & ~bad
        for name in values
        if name in OUTPUTS and OUTPUTS[name].censored
    }
    record = np.asarray(scene.scales.time * columns["ended"])
    return Answers(values=values, censored=censored, status=status, record=record, steps=steps)


# --- the path to fracture -----------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Path:
    """How a quantity that a sphere can break by follows its loading.

    Attributes
    ----------
    over : str
        `force` or `energy`: the quantity rises with the largest one so far.
    criterion : str or None
        Key of `CRITERIA` whose formula it is; None for the force or energy itself.
    parameters : mapping of str to float
        Those of the criterion without `rate_0`, whose factor is one number per sample.
    early : bool
        Only what comes before the first reflected wave counts.
    """

    over: str
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    early: bool = False


_BY_CRITERION: Final = {quantity: key for key, c in CRITERIA.items() for quantity in (c.quantity, *c.also)}
#: quantities of interest whose exceedance can mean fracture
PATHS: Final[dict[str, Path]] = {
    name: Path(over=entry.follows, criterion=_BY_CRITERION.get(name), early=entry.early)
    for name, entry in OUTPUTS.items()
    if entry.fracture
}


def path_of(quantity: str, demands: Demands = MappingProxyType({})) -> Path | None:
    """How a quantity or the demand of a criterion follows the loading; None where its exceedance is no fracture.

    >>> path_of("p_max").over, path_of("specific_energy").over, path_of("contact_time")
    ('force', 'energy', None)
    """
    if quantity not in demands:
        return PATHS.get(quantity)
    key, parameters = demands[quantity]
    kept = {name: value for name, value in parameters.items() if name != "rate_0"}
    return Path(over=CRITERIA[key].follows, criterion=key, parameters=kept)

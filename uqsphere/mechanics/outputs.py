"""Quantities of interest: their definitions, and the answers of a batch of scenes in SI.

A quantity is one entry of `OUTPUTS`; the demand of a fracture criterion is the entry of that
criterion in `uqsphere.mechanics.criteria`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import MappingProxyType
from typing import Final, TypeAlias, TypeVar

import numpy as np
import numpy.typing as npt

from uqsphere.arrays import Array, Flags, Places, Values
from uqsphere.mechanics import contact
from uqsphere.mechanics.criteria import CRITERIA, Criterion, Demands, demand
from uqsphere.mechanics.integrator.tracked import DOMAIN, NOT_FINITE, SCALED
from uqsphere.mechanics.rigs import wave_loss
from uqsphere.mechanics.scene import Partner, Scene, answered
from uqsphere.mechanics.yielding import Press
from uqsphere.units import Quantity

_Kind = TypeVar("_Kind", bound=np.generic)
#: source of a column: numbers, a function that computes them when read, or the columns of all
#: contacts
ColumnSource: TypeAlias = "float | Array | Callable[[], Values] | list[Columns]"
#: scale factors of a scene that formulas read in addition to its columns
_SCALES: Final = (
    "modulus",
    "effective_radius",
    "hertz_constant",
    "mass",
    "force",
    "approach",
    "time",
    "speed",
)


def _hertz_pressure(columns: Mapping[str, Values], force: Values) -> Values:
    """p_0 of the contact that gives the scale factors, at a force [N]."""
    return contact.pressure_at_force(force, columns["modulus"], columns["effective_radius"])


def _of_criterion(entry: Criterion) -> Quantity:
    return Quantity(
        name=str(entry.quantity),
        symbol=entry.symbol,
        dimension=entry.dimension,
        display=entry.display,
        meaning=entry.measures,
        follows=entry.follows,
        fracture=True,
        place=entry.place,
        needs=entry.needs,
        formula=lambda columns: demand(entry, columns),
    )


#: every quantity of interest of the impact model
OUTPUTS: Final[dict[str, Quantity]] = {
    entry.name: entry
    for entry in (
        Quantity(
            name="p_max",
            symbol="p_max",
            dimension="pressure",
            display="GPa",
            follows="force",
            fracture=True,
            meaning="peak contact pressure: the larger of both contacts",
            place="contact",
            needs=("P_max", "modulus", "effective_radius"),
            formula=lambda c: _hertz_pressure(c, c["P_max"]),
        ),
        Quantity(
            name="P_max",
            symbol="P_max",
            dimension="force",
            display="kN",
            follows="force",
            fracture=True,
            meaning="peak contact force: the larger of both contacts",
            needs=("force", "x_max"),
            formula=lambda c: c["force"] * c["x_max"] ** c["power"],
        ),
        Quantity(
            name="p_hertz",
            symbol="p_H",
            dimension="pressure",
            display="GPa",
            follows="force",
            fracture=True,
            meaning="elastic-equivalent pressure: p_0 by Hertz at P_max; may exceed the hardness",
            place="contact",
            needs=("P_max", "modulus", "effective_radius"),
            formula=lambda c: _hertz_pressure(c, c["P_max"]),
        ),
        Quantity(
            name="alpha_max",
            symbol="alpha_max",
            dimension="length",
            display="um",
            follows="force",
            meaning="approach at peak force: of the sphere and the counter-body",
            needs=("approach", "x_max"),
            formula=lambda c: c["approach"] * c["x_max"],
        ),
        Quantity(
            name="a_max",
            symbol="a_max",
            dimension="length",
            display="mm",
            follows="force",
            meaning="contact radius at peak force",
            needs=("P_max", "hertz_constant", "effective_radius"),
            formula=lambda c: contact.contact_radius(
                contact.approach_at_force(c["P_max"], c["hertz_constant"]), c["effective_radius"]
            ),
        ),
        Quantity(
            name="p_mean",
            symbol="p_m",
            dimension="pressure",
            display="GPa",
            follows="force",
            place="contact",
            meaning="mean contact pressure at peak force: as hardness is measured",
            needs=("P_max", "a_max"),
            formula=lambda c: c["P_max"] / (np.pi * np.square(c["a_max"])),
        ),
        Quantity(
            name="dent",
            symbol="dent",
            dimension="length",
            display="um",
            closed=True,
            meaning="residual indentation depth: the deeper of both contacts",
            needs=("dent_left",),
        ),
        Quantity(
            name="mean_force_max",
            symbol="P_mean",
            dimension="force",
            display="kN",
            meaning="peak mean contact force: max of (P_A + P_B)/2",
            needs=("force", "mean_force"),
            formula=lambda c: c["force"] * c["mean_force"],
        ),
        Quantity(
            name="contact_duration",
            symbol="t_eq",
            dimension="time",
            display="us",
            meaning="equivalent contact duration: impulse of the mean contact force / its peak",
            needs=("time", "duration"),
            formula=lambda c: c["time"] * c["duration"],
        ),
        Quantity(
            name="time_to_first_loss",
            symbol="t_loss",
            dimension="time",
            display="us",
            meaning="time to first contact loss: from first touch, at either contact",
            needs=("time", "contact"),
            censored="contact_censored",
            formula=lambda c: c["time"] * c["contact"],
        ),
        Quantity(
            name="loaded_time",
            symbol="t_loaded",
            dimension="time",
            display="us",
            meaning="contact time: from first touch until the bodies separate for good",
            needs=("time", "parting"),
            formula=lambda c: c["time"] * c["parting"],
        ),
        Quantity(
            name="rise_time",
            symbol="t_rise",
            dimension="time",
            display="us",
            meaning="rise time: from 10 % to 90 % of the peak force, first crossings",
            needs=("time", "rise"),
            formula=lambda c: c["time"] * c["rise"],
        ),
        Quantity(
            name="loading_rate",
            symbol="dP/dt",
            dimension="loading_rate",
            display="MN/s",
            meaning="mean loading rate: 0.8 P_max / rise time",
            needs=("P_max", "rise_time"),
            formula=lambda c: 0.8 * c["P_max"] / c["rise_time"],
        ),
        Quantity(
            name="first_peak",
            symbol="p_first",
            dimension="pressure",
            display="GPa",
            follows="force",
            fracture=True,
            meaning="first peak pressure: before the first reflected wave returns",
            early=True,
            place="contact",
            needs=("force", "x_first", "modulus", "effective_radius"),
            formula=lambda c: _hertz_pressure(c, c["force"] * c["x_first"] ** c["power"]),
        ),
        Quantity(
            name="force_imbalance",
            symbol="|P_A-P_B|/P_max",
            dimension="number",
            meaning="force imbalance: max |P_A - P_B| / P_max",
            needs=("difference", "x_max"),
            formula=lambda c: c["difference"] / c["x_max"] ** c["power"],
        ),
        Quantity(
            name="retouches",
            symbol="n_t",
            dimension="number",
            closed=True,
            meaning="number of recontacts before peak force",
            needs=("touches",),
        ),
        Quantity(
            name="energy",
            symbol="W",
            dimension="energy",
            display="J",
            follows="energy",
            fracture=True,
            meaning="peak elastic energy in both contacts",
            needs=("force", "approach", "stored"),
            formula=lambda c: c["force"] * c["approach"] * c["stored"],
        ),
        Quantity(
            name="specific_energy",
            symbol="W/M",
            dimension="specific_energy",
            display="J/kg",
            follows="energy",
            meaning="specific peak elastic energy: of both contacts, per sphere mass",
            fracture=True,
            needs=("energy", "mass"),
            formula=lambda c: c["energy"] / c["mass"],
        ),
        Quantity(
            name="energy_sphere",
            symbol="W_s",
            dimension="energy",
            display="J",
            follows="energy",
            fracture=True,
            meaning="energy absorbed by the sphere: its part of the peak energy, with plastic work",
            needs=("energy", "modulus", "sphere.nu", "sphere.E", "stored_sphere"),
            formula=lambda c: (
                c["modulus"] * (1.0 - np.square(c["sphere.nu"])) / c["sphere.E"] * c["energy"]
            ),
        ),
        Quantity(
            name="specific_energy_sphere",
            symbol="W_s/M",
            dimension="specific_energy",
            display="J/kg",
            follows="energy",
            fracture=True,
            needs=("energy_sphere", "mass"),
            meaning="specific energy absorbed by the sphere: per sphere mass",
            formula=lambda c: c["energy_sphere"] / c["mass"],
        ),
        Quantity(
            name="impact_energy",
            symbol="E_in",
            dimension="energy",
            display="J",
            needs=("offered",),
            fracture=True,
            meaning="impact energy: kinetic energy of the drop weight, or of relative motion",
        ),
        Quantity(
            name="specific_impact_energy",
            symbol="E_in/M",
            dimension="specific_energy",
            display="J/kg",
            meaning="specific impact energy: per sphere mass",
            fracture=True,
            needs=("impact_energy", "mass"),
            formula=lambda c: c["impact_energy"] / c["mass"],
        ),
        Quantity(
            name="rebound_speed",
            symbol="v_r",
            dimension="speed",
            display="m/s",
            lower=-math.inf,
            meaning="rebound speed: of the sphere, or of the drop weight",
            needs=("speed", "leaving"),
            formula=lambda c: c["speed"] * c["leaving"],
        ),
        Quantity(
            name="restitution",
            symbol="e",
            dimension="number",
            lower=-math.inf,
            meaning="coefficient of restitution: of a drop weight, its rebound / impact speed",
            needs=("parting_speed",),
        ),
        Quantity(
            name="transmitted_energy",
            symbol="W_t",
            dimension="energy",
            display="J",
            closed=True,
            meaning="radiated energy: elastic waves in the counter-bodies",
            needs=("carried_off", "carried_a", "carried_b"),
        ),
        Quantity(
            name="plastic_work",
            symbol="D",
            dimension="energy",
            display="J",
            closed=True,
            meaning="plastic work: of both contacts",
            needs=("dissipated",),
        ),
    )
}
OUTPUTS.update(
    (entry.quantity, _of_criterion(entry))
    for entry in CRITERIA.values()
    if entry.quantity is not None and entry.quantity not in OUTPUTS
)


class Columns(Mapping[str, Values]):
    """Columns of n rows by name, (n,) each, and every quantity of `OUTPUTS`, computed when read.

    sources: columns, or functions without arguments that return them.
    """

    def __init__(self, sources: Mapping[str, ColumnSource]) -> None:
        self._sources = dict(sources)

    def __getitem__(self, name: str) -> Values:
        source = self._sources.get(name)
        if source is None or callable(source):
            with np.errstate(all="ignore"):
                if source is None:
                    source = partial(self._computed, OUTPUTS[name])
                self._sources[name] = source()
        return self._sources[name]

    def _computed(self, entry: Quantity) -> Values:
        """A quantity of interest; without a formula it equals the column that it needs."""
        if entry.formula is None:
            return self[entry.needs[0]]
        return entry.formula(self)

    def __contains__(self, name: object) -> bool:
        return name in self._sources

    def __iter__(self) -> Iterator[str]:
        return iter(self._sources)

    def __len__(self) -> int:
        return len(self._sources)


def columns_of(scene: Scene, rows: Places | slice = slice(None)) -> dict[str, ColumnSource]:
    """Numbers and scale factors of some rows of a scene."""
    scales = {name: getattr(scene.scales, name)[rows] for name in _SCALES}
    return {**{name: column[rows] for name, column in scene.columns.items()}, **scales}


def _roots(names: Iterable[str], demands: Demands) -> set[str]:
    """What quantities and demands are computed from: names of `SCALED`, and inputs that may be
    absent.
    """
    roots = set()
    for name in names:
        if name in demands:
            key, parameters = demands[name]
            roots |= _roots(CRITERIA[key].needs_with(parameters), demands)
        elif name in OUTPUTS:
            roots |= _roots(OUTPUTS[name].needs, demands)
        else:
            roots.add(name)
    return roots


def wishes(quantities: Collection[str] | None, demands: Demands = MappingProxyType({})) -> int:
    """Flags `tracked.WANT_*` of what the integrator must track for quantities and demands.

    quantities: all of `OUTPUTS` if None.
    """
    wanted = 0
    if quantities is None:
        quantities = OUTPUTS.keys()
    for name in _roots(quantities, demands) & SCALED.keys():
        wanted |= SCALED[name][1]
    return wanted


def follows_force(quantity: str) -> bool:
    """Whether the force at failure in a slow test determines the quantity.

    >>> follows_force("core_tension"), follows_force("contact_duration")
    (True, False)
    """
    return quantity in OUTPUTS and OUTPUTS[quantity].follows != ""


def pressures_of(press: Press, modulus: Values, radius: Values, takes: Values) -> dict[str, Array]:
    """Pressures and contact radius of a contact that yields.

    `p_field` is the Hertz pressure of the same force on the same circle, from which the stress
    inside the sphere follows.  `p_rim` is the same, except where the sphere `takes` the plastic
    work: there the rim tension is at most Hertz's for the same force.
    """
    field = 1.5 * press.mean
    rim = np.where(
        np.asarray(takes) > 0.0, contact.pressure_at_force(press.force, modulus, radius), field
    )
    return {
        "p_max": press.centre,
        "p_mean": press.mean,
        "p_field": field,
        "p_rim": rim,
        "a_max": press.radius,
    }


def pressed_to(scene: Scene, rows: Places, force: Array) -> dict[str, Array]:
    """Columns of rows loaded to a force [N], for contacts that yield; empty if none does."""
    if scene.faces is None:
        return {}
    face = scene.faces.at(rows)
    state = face.pressed(face.depth_at(force))
    pressures = pressures_of(state, face.modulus, face.effective_radius, scene.struck.takes[rows])
    return {"alpha_max": state.approach, **pressures}


# --- contacts that differ, or yield ---------------------------------------------------------------


def _side(scene: Scene, pole: int, x: Array) -> dict[str, ColumnSource]:
    """Columns of one contact at its peak approach x alpha_c: force, pressures, radius, energy."""
    partner, scales = scene.partners[pole], scene.scales
    assert partner is not None
    modulus, radius, beta = partner.modulus, partner.effective_radius, partner.hertz_constant
    approach = scales.approach * x
    force = scales.force * (x * np.sqrt(x))
    if partner is not scene.struck:
        force = force * (beta / scales.hertz_constant)
    if (face := partner.face) is None:
        elastic = Columns({"p": lambda: contact.pressure_at_force(force, modulus, radius)})
        return {
            "P_max": force,
            "alpha_max": approach,
            "a_max": lambda: contact.contact_radius(approach, radius),
            "p_mean": lambda: 2.0 / 3.0 * elastic["p"],
            **dict.fromkeys(("p_max", "p_hertz", "p_field", "p_rim"), lambda: elastic["p"]),
            **dict.fromkeys(("dent_left", "dissipated"), lambda: np.zeros(len(scene))),
            "stored": lambda: contact.contact_energy(approach, beta),
        }
    state = face.pressed(approach / face.onset_approach)
    return {
        **pressures_of(state, modulus, radius, partner.takes),
        "P_max": state.force,
        "alpha_max": state.approach,
        "p_hertz": contact.pressure_at_force(state.force, modulus, radius),
        "dent_left": state.dent,
        "dissipated": state.plastic,
        "stored": state.stored,
    }


#: columns of a row that are the largest over its contacts, each separately
_LARGEST: Final = ("P_max", "alpha_max", "a_max", "p_max", "p_mean", "p_hertz", "dent_left")
#: force at the other contact when A, or B, is at its peak
_OPPOSITE: Final = ("force_b_at_a", "force_a_at_b")


def _of_faces(scene: Scene, tracked: Mapping[str, Array]) -> dict[str, ColumnSource]:
    """Columns of contacts that differ or yield: of each contact ("sides"), and of the row."""
    if scene.by_wave and scene.struck.face is None:
        return {}
    force, unit = scene.scales.force, scene.scales.force * scene.scales.approach
    poles = [pole for pole, partner in enumerate(scene.partners) if partner is not None]
    sides = [_face(scene, pole, tracked) for pole in poles]

    def largest(column: str, of: Sequence[Columns] = sides) -> Array:
        return np.asarray(np.maximum.reduce([side[column] for side in of]))

    def first_peak() -> Array:
        firsts = [Columns(_side(scene, pole, tracked[f"x_first_{'ab'[pole]}"])) for pole in poles]
        return largest("p_max", firsts)

    def energy() -> Values:
        if "stored" in tracked:
            return unit * tracked["stored"]
        # under slow loading both contacts reach their peak together
        return sum(side["stored"] for side in sides)

    def energy_of_sphere() -> Values:
        """chi of the energy in each contact, and plastic work where the sphere itself yields."""
        contacts = list(zip(scene.there, sides, strict=True))
        if len(sides) == 1 or scene.by_wave:
            elastic = scene.struck.share * energy()
        elif "stored_sphere" in tracked:
            elastic = unit * tracked["stored_sphere"]
        else:
            elastic = sum(partner.share * side["stored"] for partner, side in contacts)
        if all(partner.face is None for partner in scene.there):
            return elastic
        return elastic + sum(
            np.where(partner.takes > 0.0, partner.takes * side["dissipated"], 0.0)
            for partner, side in contacts
        )

    columns: dict[str, ColumnSource] = {
        "sides": sides,
        **{column: partial(largest, column) for column in _LARGEST},
        "energy": energy,
        "energy_sphere": energy_of_sphere,
        "dissipated": lambda: sum(side["dissipated"] for side in sides),
    }
    if "x_first_a" in tracked or "x_first_b" in tracked:
        columns["first_peak"] = first_peak
    if len(sides) == 1:
        # a single contact loads the centre by half
        names = ("mean_force_max", "force_at_centre")
        return columns | dict.fromkeys(names, lambda: 0.5 * sides[0]["P_max"])
    if "difference" in tracked:
        columns["force_imbalance"] = lambda: force * tracked["difference"] / largest("P_max")
    if not scene.by_wave:
        columns["force_at_centre"] = lambda: force * tracked["mean_force"]
    return columns


def _face(scene: Scene, pole: int, tracked: Mapping[str, Array]) -> Columns:
    """The columns of one contact.

    The stress inside the sphere depends on the force at the other contact as well: `balance` is
    that force over the contact's own, at its peak.
    """
    side = _side(scene, pole, tracked[f"x_{'ab'[pole]}"])
    if not scene.by_wave:
        other: Values = 0.0
        if len(scene.there) == 2:
            other = scene.scales.force * tracked[_OPPOSITE[pole]]
        pressed = Columns(side)["P_max"]
        side["balance"] = np.where(pressed > 0.0, other / pressed, 0.0)
    return Columns(side)


def _of_impact(scene: Scene, tracked: Mapping[str, Array]) -> dict[str, ColumnSource]:
    """Columns of an impact: its energy, speeds after it, energy radiated as waves."""
    if not scene.setup.by_impact:
        return {}
    scales, (behind, ahead) = scene.scales, scene.partners
    radiated = _radiated_fraction(scene, tracked)

    def impact_energy() -> Values:
        # P_c alpha_c = m V_c², (R5)
        return 0.5 * scales.force * scales.approach

    def carried() -> Values:
        if radiated is not None:
            return radiated * impact_energy()
        total = np.zeros(len(scene))
        for partner, name in ((behind, "carried_a"), (ahead, "carried_b")):
            if partner is not None and _carrying([partner]) and name in tracked:
                total = total + scales.force**2 * scales.time / partner.impedance * tracked[name]
        return total

    columns: dict[str, ColumnSource] = {"offered": impact_energy, "carried_off": carried}
    if "end_speed" in tracked and behind is None:
        back, parting = -tracked["end_speed"], tracked["end_speed_b"] - tracked["end_speed"]
        if radiated is not None:
            back = parting = np.sqrt(np.maximum(np.square(parting) - radiated, 0.0))
        return columns | {"leaving": back, "parting_speed": parting}
    if "end_speed_a" in tracked:
        return columns | dict.fromkeys(("leaving", "parting_speed"), -tracked["end_speed_a"])
    return columns


def loss_to_waves(scene: Scene) -> Array | None:
    """Fraction of the impact energy that a thick target radiates, (n,), (R14).

    The compliance is that of nu = 1/4.  None for other targets, or without a density.
    Source: S. C. Hunter, J. Mech. Phys. Solids 5 (1957) 162, from memory.
    """
    partner = scene.partners[1]
    if partner is None or scene.partners[0] is not None or partner.kind != "thick":
        return None
    table, c = partner.table, scene.columns
    if f"{table}.density" not in c:
        return None
    scales, density = scene.scales, c[f"{table}.density"]
    with np.errstate(all="ignore"):
        shear_speed = np.sqrt(c[f"{table}.E"] / (2.0 * (1.0 + c[f"{table}.nu"]) * density))
        return wave_loss(scales.hertz_constant, scales.mass, scales.speed, density, shear_speed)


def _radiated_fraction(scene: Scene, tracked: Mapping[str, Array]) -> Array | None:
    """Fraction of the impact energy that a thick target radiates, (R14), at most what the contact
    leaves; None where it is not known.
    """
    loss = loss_to_waves(scene)
    if loss is None or "end_speed" not in tracked:
        return loss
    return np.asarray(np.minimum(loss, np.square(tracked["end_speed"])))


def _carrying(partners: Iterable[Partner]) -> bool:
    """Whether a counter-body radiates waves by its impedance."""
    return any(partner.kind in ("bar", "plate") for partner in partners)


#: columns that some scenes do not have: the columns, which scenes, and why
_LACKING: Final[tuple[tuple[tuple[str, ...], Callable[[Scene], bool], str], ...]] = (
    (
        ("difference",),
        lambda s: s.setup.contacts == 1,
        "there is only one contact, so that the imbalance is 1 by definition",
    ),
    (
        ("parting", "touches"),
        lambda s: s.by_wave,
        "between bars, reflected waves load the sphere again and again",
    ),
    (("carried_off",), lambda s: s.by_wave, "bars carry waves in both directions; see history"),
    (
        ("offered", "leaving", "parting_speed"),
        lambda s: not s.setup.by_impact,
        "this rig loads the sphere by a wave or slowly, not by impact",
    ),
    (
        ("carried_off",),
        lambda s: s.setup.by_impact and loss_to_waves(s) is None and not _carrying(s.there),
        "the counter-bodies radiate no waves (for a thick target, set its density)",
    ),
    (
        ("parting", "touches", "contact", "duration", "carried_off"),
        lambda s: s.setup.by_press,
        "platens load slowly and stay in contact",
    ),
    (
        ("rise",),
        lambda s: (
            s.setup.by_press
            and s.columns.keys().isdisjoint(("platens.speed", "platens.loading_rate"))
        ),
        'the platens have no speed; set speed, for example "1 mm/min", or loading_rate',
    ),
    (
        ("x_first",),
        lambda s: not s.by_wave and not any(np.any(one.reflection) for one in s.there),
        "no reflected wave returns to the sphere",
    ),
    (
        ("dent_left", "dissipated"),
        lambda s: all(one.face is None for one in s.there),
        'both bodies are elastic; set contact.law = "plastic"',
    ),
)


def absent_in(scene: Scene, quantity: str) -> str:
    """Why a scene does not have a quantity of interest, in words; empty if it has it."""
    roots = _roots([quantity], scene.demands)
    missing = sorted({name for name in roots if "." in name} - scene.columns.keys())
    if missing:
        return f"{quantity} needs {' and '.join(missing)}; add them to the study"
    for names, applies, why in _LACKING:
        if not roots.isdisjoint(names) and applies(scene):
            return why
    return ""


# --- answers of a batch ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class SceneAnswers:
    """Quantities of interest of n rows, (n,) arrays.

    values: the requested quantities, SI; NaN where `status` is not 0.  censored: of
    time_to_first_loss, whether the evaluation window ended first, so that the value is a lower
    bound.  grazes: whether rounding decides when contact is first lost.  status: a key of
    `scene.STATUS`.  record: end of the evaluation window [s], or the time after which no requested
    quantity could change.  steps: of the integrator.
    """

    values: Mapping[str, Array]
    censored: Mapping[str, Flags]
    grazes: Flags
    status: Places
    record: Array
    steps: Places

    def at(self, rows: Places | Flags | slice) -> SceneAnswers:
        """The answers of some of the rows."""
        return SceneAnswers(
            values={name: column[rows] for name, column in self.values.items()},
            censored={name: column[rows] for name, column in self.censored.items()},
            grazes=self.grazes[rows],
            status=self.status[rows],
            record=self.record[rows],
            steps=self.steps[rows],
        )


def _value(scene: Scene, columns: Columns, quantity: str) -> Array:
    why = absent_in(scene, quantity)
    if why.startswith(quantity):
        raise ValueError(why)
    if why:
        raise ValueError(f"{quantity} is not available: {why}")
    if quantity not in scene.demands:
        return np.asarray(columns[quantity])
    key, parameters = scene.demands[quantity]
    return demand(CRITERIA[key], columns, parameters)


def answers_from(
    scene: Scene,
    tracked: Mapping[str, Array],
    status: Places,
    steps: Places,
    *,
    linear: bool = False,
    quantities: Collection[str] | None = None,
) -> SceneAnswers:
    """Answers in SI from scaled results of the integrator or of a closed form.

    tracked: columns of `tracked.SCALED` by name, (n,) each.  linear: the force is proportional to
    the approach; the pressure follows from the force by Hertz.  quantities: all available ones if
    None.  A row with a quantity that is not finite gets the status `NOT_FINITE`.

    Raises ValueError for a quantity that the scene does not have.
    """
    with np.errstate(all="ignore"):
        made = {**_of_faces(scene, tracked), **_of_impact(scene, tracked)}
    columns = Columns({**columns_of(scene), **tracked, "power": 1.0 if linear else 1.5, **made})
    if quantities is None:
        quantities = (*(name for name in OUTPUTS if not absent_in(scene, name)), *scene.demands)
    values = {name: _value(scene, columns, name) for name in quantities}
    finite = np.logical_and.reduce(
        [np.isfinite(value) for value in (columns["x_max"], *values.values())]
    )
    status = np.where(answered(status) & ~finite, NOT_FINITE, status)
    status = np.where(answered(status) & _wider_than_its_rod(scene, made), DOMAIN, status)
    bad = ~answered(status)
    values = {name: np.where(bad, np.nan, value) for name, value in values.items()}
    censored = {
        name: (columns[OUTPUTS[name].censored] > 0.0) & ~bad
        for name in values
        if name in OUTPUTS and OUTPUTS[name].censored
    }
    record = np.asarray(scene.scales.time * columns["ended"])
    # closed forms have no grazing contacts
    grazes = tracked.get("grazed", np.zeros(len(scene))) > 0.0
    return SceneAnswers(
        values=values, censored=censored, grazes=grazes, status=status, record=record, steps=steps
    )


def _wider_than_its_rod(scene: Scene, made: Mapping[str, ColumnSource]) -> Flags:
    """Rows of rigs without a wave whose contact is wider than the end of a bar, (n,)."""
    wider = np.zeros(len(scene), dtype=bool)
    sides = made.get("sides")
    if scene.by_wave or not isinstance(sides, list):
        return wider
    for partner, side in zip(scene.there, sides, strict=True):
        if partner.kind == "bar":
            with np.errstate(invalid="ignore"):
                wider |= 2.0 * side["a_max"] > scene.columns[f"{partner.table}.diameter"]
    return wider


def merged_answers(*parts: tuple[Places, SceneAnswers]) -> SceneAnswers:
    """Answers of one batch from parts, each with its rows, that together are all rows."""
    places = np.concatenate([rows for rows, _ in parts])
    answers = [part for _, part in parts]
    merged = SceneAnswers(
        values=_joined([part.values for part in answers]),
        censored=_joined([part.censored for part in answers]),
        grazes=np.concatenate([part.grazes for part in answers]),
        status=np.concatenate([part.status for part in answers]),
        record=np.concatenate([part.record for part in answers]),
        steps=np.concatenate([part.steps for part in answers]),
    )
    if np.all(places[1:] > places[:-1]):
        return merged
    return merged.at(np.argsort(places))


def _joined(tables: Sequence[Mapping[str, npt.NDArray[_Kind]]]) -> dict[str, npt.NDArray[_Kind]]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


# --- the path to fracture -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class LoadingPath:
    """How a fracture quantity follows the loading.

    over: it increases with the peak `force` or `energy` so far; empty: with neither.  criterion:
    the criterion whose formula it is; None for the force or energy itself, to a `power`.
    parameters: of the criterion without `rate_0`, whose factor is one number per sample.  early:
    only the time before the first reflected wave counts.
    """

    over: str
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    early: bool = False
    power: float = 1.0


_BY_CRITERION: Final = {
    quantity: key for key, c in CRITERIA.items() for quantity in (c.quantity, *c.also)
}
#: the elastic-equivalent pressure is proportional to the cube root of the force
_POWERS: Final = {"p_hertz": 1.0 / 3.0}
#: how each fracture quantity follows the loading
PATHS: Final[dict[str, LoadingPath]] = {
    name: LoadingPath(
        over=entry.follows,
        criterion=_BY_CRITERION.get(name),
        early=entry.early,
        power=_POWERS.get(name, 1.0),
    )
    for name, entry in OUTPUTS.items()
    if entry.fracture
}


def path_of(quantity: str, demands: Demands = MappingProxyType({})) -> LoadingPath | None:
    """How a quantity or a demand follows the loading; None if it does not mean fracture.

    >>> path_of("p_max").over, path_of("specific_energy").over, path_of("contact_duration")
    ('force', 'energy', None)
    """
    if quantity not in demands:
        path = PATHS.get(quantity)
        # the impact energy does not increase during the loading
        if path is None or not path.over:
            return None
        return path
    key, parameters = demands[quantity]
    kept = {name: value for name, value in parameters.items() if name != "rate_0"}
    return LoadingPath(over=CRITERIA[key].follows, criterion=key, parameters=kept)

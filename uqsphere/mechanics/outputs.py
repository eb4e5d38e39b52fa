"""Quantities of interest: what each is, how it follows from what was integrated, and the answers of
a batch in SI.

A quantity is one entry of `OUTPUTS` or, if it is what a criterion of fracture compares with a
strength, the entry of that criterion in `uqsphere.mechanics.criteria`.
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
from uqsphere.mechanics.rigs import Partner, loss_to_waves
from uqsphere.mechanics.scene import Scales, Scene, answered
from uqsphere.mechanics.yielding import Press
from uqsphere.units import Quantity

_Kind = TypeVar("_Kind", bound=np.generic)
#: what a column is given as: numbers, a function that is called when it is read, or the columns of
#: every face
Known: TypeAlias = "float | Array | Callable[[], Values] | list[Columns]"
#: scale factors of a scene that formulas read beside its own columns
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


#: Every quantity of interest that the impact model answers.
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
            meaning="peak contact pressure: the larger of both faces",
            place="contact",
            needs=("P_max", "modulus", "effective_radius"),
            formula=lambda c: contact.pressure_at_force(
                c["P_max"], c["modulus"], c["effective_radius"]
            ),
        ),
        Quantity(
            name="P_max",
            symbol="P_max",
            dimension="force",
            display="kN",
            follows="force",
            fracture=True,
            meaning="largest contact force at either face",
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
            meaning="elastic (Hertz) pressure at peak force: what that force would give without "
            "yield; a measure "
            "of the force, as strengths from forces are, so it may exceed the hardness",
            place="contact",
            needs=("P_max", "modulus", "effective_radius"),
            formula=lambda c: contact.pressure_at_force(
                c["P_max"], c["modulus"], c["effective_radius"]
            ),
        ),
        Quantity(
            name="alpha_max",
            symbol="alpha_max",
            dimension="length",
            display="um",
            follows="force",
            meaning="approach of sphere and bar at the largest force",
            needs=("approach", "x_max"),
            formula=lambda c: c["approach"] * c["x_max"],
        ),
        Quantity(
            name="a_max",
            symbol="a_max",
            dimension="length",
            display="mm",
            follows="force",
            meaning="radius of the contact circle at the largest force",
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
            meaning=(
                "mean pressure over the contact circle at the largest force, as hardness is "
                "measured"
            ),
            needs=("P_max", "a_max"),
            formula=lambda c: c["P_max"] / (np.pi * np.square(c["a_max"])),
        ),
        Quantity(
            name="dent",
            symbol="dent",
            dimension="length",
            display="um",
            closed=True,
            meaning="depth of the larger dent that stays at either face",
            needs=("dent_left",),
        ),
        Quantity(
            name="mean_force_max",
            symbol="P_mean",
            dimension="force",
            display="kN",
            meaning="largest mean of the forces at the two poles, as the centre feels it",
            needs=("force", "mean_force"),
            formula=lambda c: c["force"] * c["mean_force"],
        ),
        Quantity(
            name="contact_duration",
            symbol="t_eq",
            dimension="time",
            display="us",
            meaning=(
                "equivalent contact duration: impulse of the mean force of both faces over its peak"
            ),
            needs=("time", "duration"),
            formula=lambda c: c["time"] * c["duration"],
        ),
        Quantity(
            name="time_to_first_loss",
            symbol="t_loss",
            dimension="time",
            display="us",
            meaning="time from first touch to the first loss of contact at either face",
            needs=("time", "contact"),
            censored="contact_censored",
            formula=lambda c: c["time"] * c["contact"],
        ),
        Quantity(
            name="loaded_time",
            symbol="t_loaded",
            dimension="time",
            display="us",
            meaning="time from first touch until the bodies part for good",
            needs=("time", "parting"),
            formula=lambda c: c["time"] * c["parting"],
        ),
        Quantity(
            name="rise_time",
            symbol="t_rise",
            dimension="time",
            display="us",
            meaning="time between the first crossings of 10 % and 90 % of the largest force",
            needs=("time", "rise"),
            formula=lambda c: c["time"] * c["rise"],
        ),
        Quantity(
            name="loading_rate",
            symbol="dP/dt",
            dimension="loading_rate",
            display="MN/s",
            meaning="mean loading rate, 0.8 P_max over the rise time",
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
            meaning="largest contact pressure before the first reflected wave returns",
            early=True,
            place="contact",
            needs=("force", "x_first", "modulus", "effective_radius"),
            formula=lambda c: contact.pressure_at_force(
                c["force"] * c["x_first"] ** c["power"], c["modulus"], c["effective_radius"]
            ),
        ),
        Quantity(
            name="force_imbalance",
            symbol="|P_A-P_B|/P_max",
            dimension="number",
            meaning="largest difference of the two contact forces over the largest force",
            needs=("difference", "x_max"),
            formula=lambda c: c["difference"] / c["x_max"] ** c["power"],
        ),
        Quantity(
            name="retouches",
            symbol="n_t",
            dimension="number",
            closed=True,
            meaning="contacts lost and found again before the largest force",
            needs=("touches",),
        ),
        Quantity(
            name="energy",
            symbol="W",
            dimension="energy",
            display="J",
            follows="energy",
            fracture=True,
            meaning="largest elastic energy stored in both contacts",
            needs=("force", "approach", "stored"),
            formula=lambda c: c["force"] * c["approach"] * c["stored"],
        ),
        Quantity(
            name="specific_energy",
            symbol="W/M",
            dimension="specific_energy",
            display="J/kg",
            follows="energy",
            meaning="largest elastic energy stored in both contacts, per mass of the sphere",
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
            meaning=(
                "the sphere's share of the largest energy in both contacts, its plastic work "
                "included"
            ),
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
            meaning=(
                "the sphere's share of the largest energy in both contacts, per mass of the sphere"
            ),
            formula=lambda c: c["energy_sphere"] / c["mass"],
        ),
        Quantity(
            name="impact_energy",
            symbol="E_in",
            dimension="energy",
            display="J",
            needs=("offered",),
            fracture=True,
            meaning="kinetic energy of the impact: of the weight, or of the bodies that meet",
        ),
        Quantity(
            name="specific_impact_energy",
            symbol="E_in/M",
            dimension="specific_energy",
            display="J/kg",
            meaning="kinetic energy that the blow offers, per mass of the sphere",
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
            meaning="speed at which the sphere, or the weight, flies back",
            needs=("speed", "leaving"),
            formula=lambda c: c["speed"] * c["leaving"],
        ),
        Quantity(
            name="restitution",
            symbol="e",
            dimension="number",
            lower=-math.inf,
            meaning=(
                "coefficient of restitution: of a drop weight, its own rebound speed over its "
                "impact speed"
            ),
            needs=("parting_speed",),
        ),
        Quantity(
            name="transmitted_energy",
            symbol="W_t",
            dimension="energy",
            display="J",
            closed=True,
            meaning="energy that the partners carry off as waves",
            needs=("carried_off", "carried_a", "carried_b"),
        ),
        Quantity(
            name="plastic_work",
            symbol="D",
            dimension="energy",
            display="J",
            closed=True,
            meaning="work that both faces have dissipated by yielding",
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
    """Columns of n rows by name, (n,) each: what is known, and every quantity of `OUTPUTS`,
    computed when read.

    What is known may be a function without arguments, which is called when its column is read for
    the first time.
    """

    def __init__(self, known: Mapping[str, Known]) -> None:
        self._known = dict(known)

    def __getitem__(self, name: str) -> Values:
        found = self._known.get(name)
        if found is None or callable(found):
            with np.errstate(all="ignore"):
                if found is not None:
                    self._known[name] = found()
                else:
                    entry = OUTPUTS[name]
                    # without a formula it is what it needs
                    self._known[name] = (
                        self[entry.needs[0]] if entry.formula is None else entry.formula(self)
                    )
        return self._known[name]

    def __contains__(self, name: object) -> bool:
        return name in self._known

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)


def columns_of(scene: Scene, rows: Places | slice = slice(None)) -> dict[str, Known]:
    """Numbers and scale factors of some rows of a scene."""
    scales = {name: getattr(scene.scales, name)[rows] for name in _SCALES}
    return {**{name: column[rows] for name, column in scene.columns.items()}, **scales}


def _roots(name: str, demands: Demands) -> set[str]:
    """What the integrator has to know for a quantity: names of `SCALED`, and inputs that may be
    absent.
    """
    if name in demands:
        key, parameters = demands[name]
        needs = CRITERIA[key].needs_with(parameters)
    elif name in OUTPUTS:
        needs = OUTPUTS[name].needs
    else:
        return {name}
    return set().union(*(_roots(need, demands) for need in needs))


def roots_of(quantities: Iterable[str], demands: Demands) -> set[str]:
    """What the integrator has to know for quantities and demands: names of `SCALED`, and inputs
    that may be absent.
    """
    return set().union(*(_roots(name, demands) for name in quantities))


def wishes(quantities: Collection[str] | None, demands: Demands = MappingProxyType({})) -> int:
    """What an integrator has to follow for these quantities and demands, or for all:
    tracked.WANT_*.
    """
    wanted = 0
    asked = OUTPUTS.keys() if quantities is None else quantities
    for name in roots_of(asked, demands) & SCALED.keys():
        wanted |= SCALED[name][1]
    return wanted


def follows_force(quantity: str) -> bool:
    """Whether a slow test tells the quantity from the force at failure alone.

    >>> follows_force("core_tension"), follows_force("contact_duration")
    (True, False)
    """
    return quantity in OUTPUTS and OUTPUTS[quantity].follows != ""


def pressures_of(press: Press, modulus: Values, radius: Values, takes: Values) -> dict[str, Array]:
    """Pressures and circle of a face that has a law.

    `p_field` is the Hertz pressure of the same force on the same circle: the stress inside an
    elastic sphere follows from that, at the rim whatever the pressure's shape.  `p_rim` is the
    same, but where the sphere `takes` the plastic work: its rim has at most the tension that Hertz
    has for the force.
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
    """Columns of rows whose faces are pressed to a force [N] by the law that yields; none where
    nothing does.
    """
    if scene.faces is None:
        return {}
    face = scene.faces.at(rows)
    state = face.pressed(face.depth_at(force))
    pressures = pressures_of(state, face.modulus, face.effective_radius, scene.struck.takes[rows])
    return {"alpha_max": state.approach, **pressures}


# --- faces that are not alike ---------------------------------------------------------------------


def _side(scene: Scene, pole: int, x: Array) -> dict[str, Known]:
    """What the face at a pole has taken at its largest approach, x alpha_c: force, pressures,
    circle, dent, work.
    """
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


#: columns of a row that are the largest over its faces, each on its own
_LARGEST: Final = ("P_max", "alpha_max", "a_max", "p_max", "p_mean", "p_hertz", "dent_left")
#: the force at the other pole when a face is at its peak
_OPPOSITE: Final = {"a": "force_b_at_a", "b": "force_a_at_b"}


def _of_faces(scene: Scene, tracked: Mapping[str, Array]) -> dict[str, Known]:
    """Columns of a scene whose faces are not alike, or yield: each face's own ("sides") and those
    of the row.
    """
    if scene.by_wave and scene.struck.face is None:
        return {}
    poles = {name: pole for pole, name in enumerate("ab") if scene.partners[pole] is not None}
    sides = [_face(scene, name, tracked) for name in poles]
    found: dict[str, Known] = {column: partial(_largest, sides, column) for column in _LARGEST}
    if "x_first_a" in tracked or "x_first_b" in tracked:
        found["first_peak"] = lambda: _largest(
            [
                Columns(_side(scene, pole, tracked[f"x_first_{name}"]))
                for name, pole in poles.items()
            ],
            "p_max",
        )
    more = _of_forces(scene, tracked, sides) | _energies(scene, tracked, sides)
    return {"sides": sides} | found | more


def _face(scene: Scene, name: str, tracked: Mapping[str, Array]) -> Columns:
    """The columns of one face.

    Inside the sphere the stress depends on what presses at the other pole as well: `balance` is
    that force over the face's own, at its peak.
    """
    side = _side(scene, "ab".index(name), tracked[f"x_{name}"])
    if not scene.by_wave:
        other = 0.0 if len(scene.there) == 1 else scene.scales.force * tracked[_OPPOSITE[name]]
        pressed = Columns(side)["P_max"]
        side["balance"] = np.where(pressed > 0.0, other / pressed, 0.0)
    return Columns(side)


def _of_forces(
    scene: Scene, tracked: Mapping[str, Array], sides: Sequence[Columns]
) -> dict[str, Known]:
    """What the forces at both poles are together: with one contact its own, and half of it at the
    centre.
    """
    force, found = scene.scales.force, dict[str, Known]()
    if len(sides) == 1:
        found["mean_force_max"] = lambda: 0.5 * sides[0]["P_max"]
    elif "difference" in tracked:
        found["force_imbalance"] = lambda: force * tracked["difference"] / _largest(sides, "P_max")
    if not scene.by_wave:
        found["force_at_centre"] = found.get("mean_force_max") or (
            lambda: force * tracked["mean_force"]
        )
    return found


def _largest(sides: Sequence[Columns], column: str) -> Array:
    return np.asarray(np.maximum.reduce([side[column] for side in sides]))


def _energies(
    scene: Scene, tracked: Mapping[str, Array], sides: Sequence[Columns]
) -> dict[str, Known]:
    """Energy in both contacts and what they dissipate, and the sphere's share of them
    (`_energy_of_sphere`).
    """
    unit = scene.scales.force * scene.scales.approach

    def energy() -> Values:
        # platens press both faces to their largest together
        return (
            unit * tracked["stored"]
            if "stored" in tracked
            else sum(side["stored"] for side in sides)
        )

    return {
        "energy": energy,
        "energy_sphere": lambda: _energy_of_sphere(scene, tracked, sides, energy),
        "dissipated": lambda: sum(side["dissipated"] for side in sides),
    }


def _energy_of_sphere(
    scene: Scene,
    tracked: Mapping[str, Array],
    sides: Sequence[Columns],
    energy: Callable[[], Values],
) -> Values:
    """chi of what is stored at each face, and what the sphere dissipates: all where it yields
    itself.
    """
    faces = list(zip(scene.there, sides, strict=True))
    if len(sides) == 1 or scene.by_wave:
        own = scene.struck.share * energy()
    elif "stored_sphere" not in tracked:
        own = sum(partner.share * side["stored"] for partner, side in faces)
    else:
        own = scene.scales.force * scene.scales.approach * tracked["stored_sphere"]
    if all(partner.face is None for partner in scene.there):
        return own
    return own + sum(
        np.where(one.takes > 0.0, one.takes * side["dissipated"], 0.0) for one, side in faces
    )


def _of_impact(scene: Scene, tracked: Mapping[str, Array]) -> dict[str, Known]:
    """Columns of an impact: its energy, speeds after it, energy radiated as waves."""
    if not scene.setup.by_impact:
        return {}
    scales, (behind, ahead) = scene.scales, scene.partners
    # P_c alpha_c = m V_c², (R5)
    impact_energy = partial(_half, scales)
    columns: dict[str, Known] = {"offered": impact_energy}
    radiated = _radiated_fraction(scene, tracked)
    if "end_speed" in tracked and behind is None:
        back, parting = -tracked["end_speed"], tracked["end_speed_b"] - tracked["end_speed"]
        if radiated is not None:
            parting = np.sqrt(np.maximum(np.square(parting) - radiated, 0.0))
            back = parting
        columns |= {"leaving": back, "parting_speed": parting}
    elif "end_speed_a" in tracked:
        columns |= dict.fromkeys(("leaving", "parting_speed"), -tracked["end_speed_a"])

    def carried() -> Values:
        if radiated is not None:
            return radiated * impact_energy()
        total = np.zeros(len(scene))
        for partner, name in ((behind, "a"), (ahead, "b")):
            if partner is not None and _carrying([partner]) and f"carried_{name}" in tracked:
                unit = scales.force**2 * scales.time / partner.impedance
                total = total + unit * tracked[f"carried_{name}"]
        return total

    return columns | {"carried_off": carried}


def _radiated_fraction(scene: Scene, tracked: Mapping[str, Array]) -> Array | None:
    """Fraction of the impact energy that a thick target radiates, (R14), at most what the contact
    leaves; None where it is not known.
    """
    loss = loss_to_waves(scene)
    if loss is None or "end_speed" not in tracked:
        return loss
    return np.asarray(np.minimum(loss, np.square(tracked["end_speed"])))


def _carrying(partners: Iterable[Partner]) -> bool:
    """Whether one of them carries off waves."""
    return any(one.kind in ("bar", "plate") for one in partners)


def _half(scales: Scales) -> Array:
    """Kinetic energy of the blow [J]."""
    return 0.5 * scales.force * scales.approach


#: columns that formulas read and some scenes do not have, which scenes, and why not
_LACKING: Final[tuple[tuple[tuple[str, ...], Callable[[Scene], bool], str], ...]] = (
    (
        ("difference",),
        lambda s: s.setup.contacts == 1,
        "with one contact the other force is nothing: the imbalance is 1 by definition",
    ),
    (
        ("parting", "touches"),
        lambda s: s.by_wave,
        "between bars echoes load the sphere again and again",
    ),
    (("carried_off",), lambda s: s.by_wave, "bars carry waves both ways: history shows them"),
    (
        ("offered", "leaving", "parting_speed"),
        lambda s: not s.setup.by_impact,
        "no body meets the sphere with a speed: a wave, or a slow press, loads it",
    ),
    (
        ("carried_off",),
        lambda s: s.setup.by_impact and loss_to_waves(s) is None and not _carrying(s.there),
        "what stands at the poles carries nothing off here (a thick target: give its density)",
    ),
    (
        ("parting", "touches", "contact", "duration", "carried_off"),
        lambda s: s.setup.by_press,
        "platens press slowly and stay",
    ),
    (
        ("rise",),
        lambda s: (
            s.setup.by_press
            and s.columns.keys().isdisjoint(("platens.speed", "platens.loading_rate"))
        ),
        'how fast the platens press is not given: add speed = "1 mm/min" or loading_rate',
    ),
    (
        ("x_first",),
        lambda s: not s.by_wave and not any(np.any(one.reflection) for one in s.there),
        "no wave comes back to the sphere",
    ),
    (
        ("dent_left", "dissipated"),
        lambda s: all(one.face is None for one in s.there),
        'both bodies are elastic: law = "plastic" in the table [contact] is required',
    ),
)


def absent_in(scene: Scene, quantity: str) -> str:
    """Why a scene does not have a quantity of interest, in words; empty where it has it."""
    roots = _roots(quantity, scene.demands)
    if missing := sorted({name for name in roots if "." in name} - scene.columns.keys()):
        tables = " and ".join(sorted({f"[{name.partition('.')[0]}]" for name in missing}))
        return f"{quantity} needs {' and '.join(missing)}: add them in the table {tables}"
    return next(
        (why for names, where, why in _LACKING if not roots.isdisjoint(names) and where(scene)), ""
    )


# --- answers of a batch ---------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Answers:
    """Quantities of interest of n rows, (n,) arrays.

    values: the quantities asked for, SI; NaN where `status` is not 0.  censored: of
    time_to_first_loss, whether the record ended first and the value is a lower bound.  grazes:
    whether rounding decides on the first loss. status: 0, or a code of `scene.STATUS`.  record: its
    end [s], or the time after which nothing that was asked for could change.  steps: of the
    integrator.
    """

    values: Mapping[str, Array]
    censored: Mapping[str, Flags]
    grazes: Flags
    status: Places
    record: Array
    steps: Places

    def at(self, rows: Places | Flags | slice) -> Answers:
        """The answers of some of the rows."""
        return Answers(
            values={name: column[rows] for name, column in self.values.items()},
            censored={name: column[rows] for name, column in self.censored.items()},
            grazes=self.grazes[rows],
            status=self.status[rows],
            record=self.record[rows],
            steps=self.steps[rows],
        )


def _value(scene: Scene, columns: Columns, quantity: str) -> Array:
    if why := absent_in(scene, quantity):
        raise ValueError(why if why.startswith(quantity) else f"{quantity} is absent: {why}")
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
) -> Answers:
    """Answers in SI from the columns of `tracked.SCALED` by name, (n,) each: a closed form gives
    those that it has.

    linear: force is proportional to the approach, pressure follows by Hertz.  quantities: all if
    None.  A row one of whose quantities is not finite has failed.  ValueError for one that needs
    numbers which are not there.
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
    grazes = (
        tracked.get("grazed", np.zeros(len(scene))) > 0.0
    )  # a closed form knows no loss that is in doubt
    return Answers(
        values=values, censored=censored, grazes=grazes, status=status, record=record, steps=steps
    )


def _wider_than_its_rod(scene: Scene, made: Mapping[str, Known]) -> Flags:
    """Rows of a rig other than bars whose contact is wider than the end of a bar that it is on."""
    found = np.zeros(len(scene), dtype=bool)
    sides = made.get("sides")
    for partner, side in zip(scene.there, sides if isinstance(sides, list) else (), strict=False):
        if partner.kind == "bar" and not scene.by_wave:
            with np.errstate(invalid="ignore"):
                found |= 2.0 * side["a_max"] > scene.columns[f"{partner.table}.diameter"]
    return found


def merged_answers(*parts: tuple[Places, Answers]) -> Answers:
    """Answers of one batch from those of some of its rows each; together they are all of them."""
    places, found = np.concatenate([rows for rows, _ in parts]), [part for _, part in parts]
    whole = Answers(
        values=_joined([part.values for part in found]),
        censored=_joined([part.censored for part in found]),
        grazes=np.concatenate([part.grazes for part in found]),
        status=np.concatenate([part.status for part in found]),
        record=np.concatenate([part.record for part in found]),
        steps=np.concatenate([part.steps for part in found]),
    )
    return whole if np.all(places[1:] > places[:-1]) else whole.at(np.argsort(places))


def _joined(tables: Sequence[Mapping[str, npt.NDArray[_Kind]]]) -> dict[str, npt.NDArray[_Kind]]:
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


# --- the path to fracture -------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Path:
    """How a quantity that a sphere can break by follows its loading.

    over: it rises with the largest `force` or `energy` so far; empty: with neither.  criterion:
    whose formula it is; None for the force or energy itself, to a `power`.  parameters: of the
    criterion without `rate_0`, whose factor is one number per sample.  early: only what comes
    before the first reflected wave counts.
    """

    over: str
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    early: bool = False
    power: float = 1.0


_BY_CRITERION: Final = {
    quantity: key for key, c in CRITERIA.items() for quantity in (c.quantity, *c.also)
}
#: what the force is by Hertz goes with its third root, yield or not
_POWERS: Final = {"p_hertz": 1.0 / 3.0}
#: quantities of interest whose exceedance can mean fracture
PATHS: Final[dict[str, Path]] = {
    name: Path(
        over=entry.follows,
        criterion=_BY_CRITERION.get(name),
        early=entry.early,
        power=_POWERS.get(name, 1.0),
    )
    for name, entry in OUTPUTS.items()
    if entry.fracture
}


def path_of(quantity: str, demands: Demands = MappingProxyType({})) -> Path | None:
    """How a quantity or the demand of a criterion follows the loading; None where its exceedance is
    no fracture.

    >>> path_of("p_max").over, path_of("specific_energy").over, path_of("contact_duration")
    ('force', 'energy', None)
    """
    if quantity not in demands:
        # what a blow offers is there before it: nothing that rises along the loading
        return PATHS[quantity] if quantity in PATHS and PATHS[quantity].over else None
    key, parameters = demands[quantity]
    kept = {name: value for name, value in parameters.items() if name != "rate_0"}
    return Path(over=CRITERIA[key].follows, criterion=key, parameters=kept)

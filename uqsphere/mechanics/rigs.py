"""The rigs: the counter-bodies at the two poles of the sphere, and what loads it.

A counter-body gives way by its impedance (a bar, a thin plate), by its mass, or not at all (a thick
block, a platen).  Its contact with the sphere has a reduced modulus, a radius and, if it yields, a
contact law.  A new rig is one entry of `RIGS`; the keys of its tables are in `forms.FORMS`.
Equation numbers (R...) and (C...) refer to docs/theory.md; SI units.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import TYPE_CHECKING, Final, Literal, TypedDict

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.yielding import CAP_PILE_UP, ContactParameters, Face, metal_body, softer

if TYPE_CHECKING:
    from uqsphere.mechanics.scene import Scene

#: keys of the three parameters of a contact law
LAW: Final = ("onset_pressure", "hardness", "pile_up")


@dataclass(frozen=True, kw_only=True)
class Partner:
    """The counter-body at one contact; (n,) each.

    table: table of the study with its numbers.  kind: `bar`, `plate`, `thick`, `mass` or `platen`.
    modulus, effective_radius, hertz_constant: E* [Pa], r_eff [m] and beta [N/m^1.5] of the contact.
    share: chi = E* (1 - nu²)/E, the sphere's fraction of the elastic energy, (R22).  impedance: Z
    [N s/m], infinite if it is rigid.  mass: [kg], infinite if it is not free.  speed: V [m/s] at
    first touch, positive from A to B.  round_trip, reflection: of a bar and its far end; infinite
    and 0 without a reflected wave.  face: its contact law if it yields.  takes: the sphere's
    fraction of the plastic work, 1 if the sphere itself yields.
    """

    table: str
    kind: str
    modulus: Array
    effective_radius: Array
    hertz_constant: Array
    share: Array
    impedance: Array
    mass: Array
    speed: Array
    round_trip: Array
    reflection: Array
    face: Face | None
    takes: Array


def plate_impedance(E: Values, nu: Values, density: Values, thickness: Values) -> Array:
    """Z = (4/sqrt 3) h² sqrt(rho E/(1 - nu²)) [N s/m] of a thin unbounded plate, (R2).

    Source: C. Zener, Phys. Rev. 59 (1941) 669, from memory.
    """
    stiffness = np.sqrt(density * E / (1.0 - nu * nu))
    return np.asarray(4.0 / math.sqrt(3.0) * np.square(thickness) * stiffness)


def partner_of(scene: Scene, table: str, kind: str, speed: Array | None = None) -> Partner:
    """The counter-body of a table of the scene; not finite in rows outside the domain."""
    c = scene.columns
    face_E = c.get(f"{table}.insert_E", scene.column(f"{table}.E"))
    face_nu = c.get(f"{table}.insert_nu", scene.column(f"{table}.nu"))
    mass = _everywhere(np.inf, scene)
    if kind == "mass":
        mass = _mass(scene, table)
    with np.errstate(all="ignore"):
        modulus = contact.reduced_modulus(
            c["sphere.E"], c["sphere.nu"], face_E, face_nu, rigid_bars=scene.rigid_contact
        )
        share = np.asarray(modulus * (1.0 - np.square(c["sphere.nu"])) / c["sphere.E"])
        radius = contact.effective_radius(c["sphere.radius"], _face_radius(scene, table))
        return Partner(
            table=table,
            kind=kind,
            modulus=modulus,
            effective_radius=radius,
            hertz_constant=contact.hertz_constant(modulus, radius),
            share=share,
            impedance=_impedance(scene, table, kind),
            mass=mass,
            speed=_everywhere(0.0, scene) if speed is None else speed,
            **_law(scene, table, modulus, radius),
            **_echo(scene, table, kind),
        )


def _everywhere(value: float, scene: Scene) -> Array:
    """One number in every row, (n,), without a copy."""
    return np.broadcast_to(np.float64(value), (len(scene),))


def _face_radius(scene: Scene, table: str) -> Array:
    if table == "bars":
        return scene.column("bars.end_radius", np.inf)
    if table == "other":
        return scene.column("other.radius")
    if table == "hammer" and scene.options.get("hammer.shape") == "ball":
        return 0.5 * scene.column("hammer.diameter")
    return scene.column(f"{table}.face_radius", np.inf)


def _impedance(scene: Scene, table: str, kind: str) -> Array:
    if kind not in ("bar", "plate"):
        return _everywhere(np.inf, scene)
    E, nu, density = (scene.column(f"{table}.{key}") for key in ("E", "nu", "density"))
    if kind == "bar":
        return np.asarray(bars.impedance(E, density, scene.column(f"{table}.diameter")))
    return plate_impedance(E, nu, density, scene.column(f"{table}.thickness"))


def _mass(scene: Scene, table: str) -> Array:
    """Mass of a free counter-body: as given, or of a ball."""
    if table == "other":
        return np.asarray(
            contact.sphere_mass(scene.column("other.radius"), scene.column("other.density"))
        )
    if table == "hammer" and scene.options.get("hammer.shape") == "ball":
        radius = 0.5 * scene.column("hammer.diameter")
        return np.asarray(contact.sphere_mass(radius, scene.column("hammer.density")))
    return scene.column(f"{table}.mass")


def _echo(scene: Scene, table: str, kind: str) -> dict[str, Array]:
    """Round trip and reflection of a rod; those of the two Hopkinson bars are in `Scene`."""
    if kind != "bar" or table == "bars" or f"{table}.length" not in scene.columns:
        return {"round_trip": _everywhere(np.inf, scene), "reflection": _everywhere(0.0, scene)}
    E, density, length = (scene.column(f"{table}.{key}") for key in ("E", "density", "length"))
    # the far end is free unless it is given
    reflection = scene.column(f"{table}.end", bars.END_COEFFICIENTS["free"])
    return {"round_trip": np.asarray(bars.round_trip(length, E, density)), "reflection": reflection}


def _column(columns: Mapping[str, Array], name: str, default: Values) -> Array:
    """A column, or `default` in every row."""
    if name in columns:
        return columns[name]
    return np.full(len(next(iter(columns.values()))), default)


def body_of(columns: Mapping[str, Array], table: str, rigid: bool = False) -> ContactParameters:
    """Contact parameters of a counter-body: as given, else of a metal; infinite onset if rigid."""
    strength, nu = (
        columns.get(f"{table}.insert_{key}", _column(columns, f"{table}.{key}", np.nan))
        for key in ("yield_strength", "nu")
    )
    if rigid:
        strength = np.full_like(nu, np.nan)
    body = _with_columns(columns, table, metal_body(strength, nu))
    if rigid:
        return body._replace(onset=np.full_like(nu, np.inf))
    return body


def _with_columns(
    columns: Mapping[str, Array], table: str, body: ContactParameters
) -> ContactParameters:
    """Contact parameters with those that a table gives."""
    return ContactParameters(
        *(columns.get(f"{table}.{key}", value) for key, value in zip(LAW, body, strict=True))
    )


def sphere_body(columns: Mapping[str, Array]) -> ContactParameters:
    """Contact parameters of the sphere, which is elastic without an onset pressure."""
    defaults = (np.inf, np.inf, CAP_PILE_UP)
    return ContactParameters(
        *(
            _column(columns, f"sphere.{key}", value)
            for key, value in zip(LAW, defaults, strict=True)
        )
    )


def law_of(
    columns: Mapping[str, Array], table: str, *, rigid: bool = False, at_onset: bool = False
) -> ContactParameters:
    """Contact parameters: of the softer body in each row, unless [contact] gives them."""
    body = softer(body_of(columns, table, rigid), sphere_body(columns))
    body = _with_columns(columns, "contact", body)
    if at_onset:
        return body._replace(hardness=body.onset)
    return body


def softest_partner(scene: Scene) -> ContactParameters:
    """Contact parameters of the counter-body that yields first in each row."""
    tables = dict.fromkeys(partner.table for partner in scene.there)
    return reduce(softer, [body_of(scene.columns, table, scene.rigid_contact) for table in tables])


class _Law(TypedDict):
    face: Face | None
    takes: Array


def _law(scene: Scene, table: str, modulus: Array, radius: Array) -> _Law:
    """The contact law of a counter-body, if any row can yield."""
    elastic = _Law(face=None, takes=_everywhere(0.0, scene))
    if scene.contact_law != "plastic":
        return elastic
    numbers = law_of(
        scene.columns, table, rigid=scene.rigid_contact, at_onset=scene.hardness_at_onset
    )
    if np.isinf(numbers.onset).all():
        return elastic
    face = Face(**numbers._asdict(), modulus=modulus, effective_radius=radius)
    body = body_of(scene.columns, table, scene.rigid_contact)
    sphere_yields = sphere_body(scene.columns).onset < body.onset
    return _Law(face=face, takes=np.where(sphere_yields, 1.0, 0.0))


#: gravity [m/s²]; drag coefficient of a sphere and density of air [kg/m³] (from memory)
GRAVITY: Final = 9.80665
_DRAG, _AIR = 0.45, 1.2
#: largest lam (force over Z and speed) of a plate or bar end; beyond it a plate is punched, (R13)
LARGEST_LAM: Final = 3.0
#: ranges of M/m_A and kappa in which the equations are solved
MASS_RATIO: Final = (1e-7, 1e3)
STIFFNESS_RATIO: Final = (1e-3, 1e3)
#: compliance of a half-space under a harmonic point load, nu = 1/4, times rho c_s³ (Reissner;
#: Miller and Pursey 1954)
_RADIATION: Final = 0.1486
#: radiated fraction of the impact energy over D beta^1.2 M^-0.2 v^0.6 for Hertz's P(t), (R14)
_PULSE: Final = 3.80584


@dataclass(frozen=True, kw_only=True)
class Rig:
    """One rig: a set-up that loads the sphere.

    title: as it stands in the description of a study.  meaning: one sentence.  behind, ahead:
    tables of the counter-bodies at contacts A and B; empty where the sphere is free.  kinds: their
    kinds; empty where the study chooses (`target.kind`, `anvil.kind`).  loading: `wave`, a pulse
    that arrives through the bar at A; `impact`, bodies that meet with a speed; `press`, slow
    loading.  mover: table with the speed at first touch, `striker`, `rig` (the sphere moves) or
    `hammer`; empty for slow loading.
    """

    name: str
    title: str
    meaning: str
    behind: str
    ahead: str
    kinds: tuple[str, str]
    loading: Literal["wave", "impact", "press"] = "impact"
    mover: str = ""

    @property
    def by_wave(self) -> bool:
        """Whether a stress wave loads the sphere."""
        return self.loading == "wave"

    @property
    def by_impact(self) -> bool:
        """Whether bodies meet with a speed; their record ends when they part."""
        return self.loading == "impact"

    @property
    def by_press(self) -> bool:
        """Whether the sphere is loaded slowly."""
        return self.loading == "press"

    @property
    def sphere_moves(self) -> bool:
        """Whether the sphere itself has the impact speed."""
        return self.mover == "rig"

    @property
    def weight_falls(self) -> bool:
        """Whether a drop weight has the impact speed."""
        return self.mover == "hammer"

    @property
    def contacts(self) -> int:
        """Number of contacts of the sphere."""
        return 2 if self.behind else 1

    @property
    def tables(self) -> tuple[str, ...]:
        """Tables of a study that belong to this rig."""
        tables = dict.fromkeys((self.behind, self.ahead))
        if self.by_wave:
            tables |= dict.fromkeys(("striker", "pulse"))
        return tuple(name for name in tables if name)

    def may_have(self, kind: str) -> bool:
        """Whether a counter-body of this rig is, or can be chosen to be, of a kind."""
        poles = zip((self.behind, self.ahead), self.kinds, strict=True)
        return any(table and fixed in ("", kind) for table, fixed in poles)

    def kind(self, pole: int, options: Values) -> str:
        """Kind of the counter-body at a contact; `thick` unless the study chooses another."""
        table = (self.behind, self.ahead)[pole]
        return self.kinds[pole] or str(options.get(f"{table}.kind", "thick"))


#: every rig, declared once
RIGS: Final[dict[str, Rig]] = {
    rig.name: rig
    for rig in (
        Rig(
            name="bars",
            title="between Hopkinson bars",
            meaning="a sphere between two bars, one of which a striker hits",
            behind="bars",
            ahead="bars",
            kinds=("bar", "bar"),
            loading="wave",
            mover="striker",
        ),
        Rig(
            name="impact",
            title="impact on a body",
            meaning="a sphere strikes a thick block, a plate, the end of a bar or a free mass",
            behind="",
            ahead="target",
            kinds=("", ""),
            mover="rig",
        ),
        Rig(
            name="sphere_on_sphere",
            title="sphere on sphere",
            meaning="a sphere strikes another sphere",
            behind="",
            ahead="other",
            kinds=("", "mass"),
            mover="rig",
        ),
        Rig(
            name="drop_weight",
            title="drop weight",
            meaning="a weight falls on a sphere that rests on an anvil",
            behind="hammer",
            ahead="anvil",
            kinds=("mass", ""),
            mover="hammer",
        ),
        Rig(
            name="load_cell",
            title="impact load cell",
            meaning="a weight falls on a sphere that rests on a long rod with a gauge",
            behind="hammer",
            ahead="rod",
            kinds=("mass", "bar"),
            mover="hammer",
        ),
        Rig(
            name="platens",
            title="between platens",
            meaning="a sphere is pressed slowly between two platens",
            behind="platens",
            ahead="platens",
            kinds=("platen", "platen"),
            loading="press",
        ),
    )
}


#: the rig of a study that names none
DEFAULT_RIG: Final = "bars"


def drop_speed(height: Values, radius: Values, density: Values) -> Array:
    """Speed [m/s] of a sphere after a fall of h [m] in air: v² = v_t² (1 - exp(-2 g h/v_t²))."""
    terminal = terminal_speed(radius, density) ** 2
    exponent = -2.0 * GRAVITY * np.asarray(height, dtype=float) / terminal
    return np.asarray(np.sqrt(-terminal * np.expm1(exponent)))


def terminal_speed(radius: Values, density: Values) -> Array:
    """Terminal speed v_t [m/s] of a sphere in air: v_t² = 8 r rho g/(3 C_D rho_air)."""
    return np.asarray(np.sqrt(8.0 * radius * density * GRAVITY / (3.0 * _DRAG * _AIR)))


def closing_speed(scene: Scene) -> Array:
    """Normal closing speed, (n,) [m/s]: as given, or after a fall."""
    rig, c = RIGS[scene.rig], scene.columns
    with np.errstate(all="ignore"):
        if f"{rig.mover}.drop_height" not in c:
            speed = scene.column(f"{rig.mover}.speed")
        elif rig.sphere_moves:
            speed = drop_speed(c["rig.drop_height"], c["sphere.radius"], c["sphere.density"])
        else:
            # the drag on a drop weight depends on its shape; it is small
            speed = np.sqrt(2.0 * GRAVITY * c[f"{rig.mover}.drop_height"])
        if "rig.angle" in c:
            speed = speed * np.sin(c["rig.angle"])
        return np.asarray(speed)


def partners_of(scene: Scene) -> tuple[Partner | None, Partner | None]:
    """Counter-bodies behind (A) and ahead (B) of the sphere; None without a contact."""
    rig = RIGS[scene.rig]
    if rig.behind == rig.ahead:
        partner = partner_of(scene, rig.behind, rig.kinds[0])
        if not rig.by_wave:
            return partner, partner
        trips, ends = scene.round_trips, scene.reflections
        incident = replace(partner, round_trip=trips[:, 0], reflection=ends[:, 0])
        receiving = replace(partner, round_trip=trips[:, 1], reflection=ends[:, 1])
        return incident, receiving
    ahead = partner_of(scene, rig.ahead, rig.kind(1, scene.options))
    if not rig.behind:
        return None, ahead
    return partner_of(scene, rig.behind, rig.kind(0, scene.options), scene.closing_speed), ahead


def speeds_at_touch(scene: Scene) -> Array:
    """Speeds of sphere and counter-bodies A, B at first touch, (n, 3) [m/s], from A to B. (R7)."""
    rig = RIGS[scene.rig]
    start = np.zeros((len(scene), 3))
    if rig.sphere_moves:
        start[:, 0] = scene.closing_speed
    elif rig.weight_falls:
        start[:, 1] = scene.closing_speed
    return start


def outside(scene: Scene) -> Array:
    """Rows of a rig without a wave that are outside the domain of its equations, (n,)."""
    rig, scales = scene.setup, scene.scales
    rows = np.zeros(len(scene), dtype=bool)
    behind, ahead = scene.partners
    with np.errstate(all="ignore"):
        for partner in scene.there:
            struck_bar = rig.contacts == 1 and partner.kind == "bar"
            if partner.kind == "plate" or struck_bar:
                rows |= ~(scales.force / (partner.impedance * scales.speed) <= LARGEST_LAM)
        if behind is not None and ahead is not None:
            rows |= _beyond(ahead.hertz_constant / behind.hertz_constant, STIFFNESS_RATIO)
            if rig.weight_falls:
                rows |= _beyond(scales.mass / behind.mass, MASS_RATIO)
        if "platens.displacement" in scene.columns:
            rows |= scene.columns["platens.displacement"] >= scene.columns["sphere.radius"]
    return rows


def _beyond(ratio: Array, bounds: tuple[float, float]) -> Array:
    return np.asarray(~((ratio >= bounds[0]) & (ratio <= bounds[1])))


def wave_loss(
    hertz_constant: Values, mass: Values, speed: Values, density: Values, shear_speed: Values
) -> Array:
    """Fraction of the impact energy that a half-space radiates, (R14).

    Source: S. C. Hunter, J. Mech. Phys. Solids 5 (1957) 162.
    """
    compliance = _RADIATION / (density * np.asarray(shear_speed) ** 3)
    contact_factor = np.asarray(hertz_constant) ** 1.2 * mass**-0.2
    return np.asarray(_PULSE * compliance * contact_factor * np.asarray(speed) ** 0.6)


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

"""What stands at a pole of the sphere: a bar, a plate, a thick block, a free mass or a platen.

A partner gives way by its impedance (a bar, a thin plate), by its mass, or not at all (a thick block, a platen); its
contact with the sphere has a reduced modulus, a radius and, where it yields, a law of its own.  Numbering (R...) and
(C...) of docs/theory.md; SI.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING, Final, TypedDict

import numpy as np

from uqsphere.arrays import Array, Values
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.damage import Softening, critical_approach
from uqsphere.mechanics.yielding import CAP_PILE_UP, Body, Face, metal_body, softer

if TYPE_CHECKING:
    from uqsphere.mechanics.scene import Scene

#: kinds of partners that a study may choose for a target or an anvil, and those that a rig chooses itself
PARTNER_KINDS: Final = ("thick", "plate", "bar", "mass")
#: the three numbers of the law of a face, by their keys
LAW: Final = ("onset_pressure", "hardness", "pile_up")


@dataclass(frozen=True, kw_only=True)
class Partner:
    """What stands at one pole; (n,) each.

    Attributes
    ----------
    table, kind : str
        Table of the study that its numbers stand in; `bar`, `plate`, `thick`, `mass` or `platen`.
    modulus, effective_radius, hertz_constant : (n,) arrays
        E* [Pa], r_eff [m] and beta [N/m^1.5] of this face.
    share : (n,) array
        chi = E* (1 - nu²)/E, the sphere's share of the elastic energy of this face, (R22).
    impedance, mass : (n,) arrays
        Z [kg/s], infinite where it does not give way; mass [kg], infinite where it is not free.
    speed : (n,) array
        V at first touch [m/s], positive from pole A to pole B.
    round_trip, reflection : (n,) arrays
        Of a bar [s] and of its far end; infinite and 0 where nothing returns.
    face : Face, Softening or None
        The law of a face that yields or takes damage; None: elastic.
    takes : (n,) array
        The sphere's share of what such a face dissipates: 1 where it is the sphere that yields, chi of damage.
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
    face: Face | Softening | None
    takes: Array


def plate_impedance(E: Values, nu: Values, density: Values, thickness: Values) -> Array:
    """Z = (4/sqrt 3) h² sqrt(rho E/(1 - nu²)) [N s/m] of a thin unbounded plate: it gives way at P/Z. (R2).

    Source: C. Zener, Phys. Rev. 59 (1941) 669, from memory.
    """
    return np.asarray(4.0 / math.sqrt(3.0) * np.square(thickness) * np.sqrt(density * E / (1.0 - nu * nu)))


def partner_of(scene: Scene, table: str, kind: str, speed: Array | None = None) -> Partner:
    """The partner whose numbers stand in a table of the scene; not finite where a row has no meaning."""
    c = scene.columns
    face_E, face_nu = (
        c[f"{table}.insert_{key}"] if f"{table}.insert_{key}" in c else scene.column(f"{table}.{key}")
        for key in ("E", "nu")
    )
    with np.errstate(all="ignore"):
        modulus = contact.reduced_modulus(
            c["sphere.E"], c["sphere.nu"], face_E, face_nu, rigid_bars=scene.rigid_contact
        )
        share = np.asarray(modulus * (1.0 - np.square(c["sphere.nu"])) / c["sphere.E"])
        if scene.stiffness_left is not None:
            # what blows have softened is the sphere: the partner's share goes down with the stiffness
            modulus, share = modulus * scene.stiffness_left, 1.0 - scene.stiffness_left * (1.0 - share)
        radius = contact.effective_radius(c["sphere.radius"], _face_radius(scene, table))
        return Partner(
            table=table,
            kind=kind,
            modulus=modulus,
            effective_radius=radius,
            hertz_constant=contact.hertz_constant(modulus, radius),
            share=share,
            impedance=_impedance(scene, table, kind),
            mass=_mass(scene, table) if kind == "mass" else _everywhere(np.inf, scene),
            speed=_everywhere(0.0, scene) if speed is None else speed,
            **_law(scene, table, modulus, radius, share),
            **_echo(scene, table, kind),
        )


def _everywhere(value: float, scene: Scene) -> Array:
    """One number in every row, (n,), without room of its own."""
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
    """Mass of a free partner: as given, or that of the ball it is."""
    if table == "other":
        return np.asarray(contact.sphere_mass(scene.column("other.radius"), scene.column("other.density")))
    if table == "hammer" and scene.options.get("hammer.shape") == "ball":
        radius = 0.5 * scene.column("hammer.diameter")
        return np.asarray(contact.sphere_mass(radius, scene.column("hammer.density")))
    return scene.column(f"{table}.mass")


def _echo(scene: Scene, table: str, kind: str) -> dict[str, Array]:
    """Round trip and reflection of a bar of a rig; those of the two bars of `bars` are columns of their own."""
    if kind != "bar" or table == "bars" or f"{table}.length" not in scene.columns:
        return {"round_trip": _everywhere(np.inf, scene), "reflection": _everywhere(0.0, scene)}
    E, density, length = (scene.column(f"{table}.{key}") for key in ("E", "density", "length"))
    # a far end that nobody names is free, as that of a rod that stands on nothing
    reflection = scene.column(f"{table}.end", bars.END_COEFFICIENTS["free"])
    return {"round_trip": np.asarray(bars.round_trip(length, E, density)), "reflection": reflection}


def _given(columns: Mapping[str, Array], name: str, default: Values) -> Array:
    """A column, or `default` in every row."""
    return columns.get(name, np.full(len(next(iter(columns.values()))), default))


def body_of(columns: Mapping[str, Array], table: str, rigid: bool = False) -> Body:
    """What the partner of a table has of the law of its face: given, or that of a metal; infinite where rigid."""
    strength, nu = (
        columns.get(f"{table}.insert_{key}", _given(columns, f"{table}.{key}", np.nan))
        for key in ("yield_strength", "nu")
    )
    metal = metal_body(np.full_like(nu, np.nan) if rigid else strength, nu)
    found = Body(*(columns.get(f"{table}.{key}", own) for key, own in zip(LAW, metal, strict=True)))
    return found._replace(onset=np.full_like(nu, np.inf)) if rigid else found


def sphere_body(columns: Mapping[str, Array]) -> Body:
    """What the sphere has of the law of a face; it stays elastic where no onset is given."""
    usual = (np.inf, np.inf, CAP_PILE_UP)
    return Body(*(_given(columns, f"sphere.{key}", own) for key, own in zip(LAW, usual, strict=True)))


def law_of(columns: Mapping[str, Array], table: str, *, rigid: bool = False, at_onset: bool = False) -> Body:
    """The law of a face: of its softer body, row by row, but for what [contact] gives."""
    numbers = softer(body_of(columns, table, rigid), sphere_body(columns))
    found = Body(*(columns.get(f"contact.{key}", own) for key, own in zip(LAW, numbers, strict=True)))
    return found._replace(hardness=found.onset) if at_onset else found


def softest_partner(scene: Scene) -> Body:
    """What the partner that yields first has of the law, row by row; infinite where none has an onset."""
    tables = dict.fromkeys(partner.table for partner in scene.there)
    return reduce(softer, [body_of(scene.columns, table, scene.rigid_contact) for table in tables])


class _Law(TypedDict):
    face: Face | Softening | None
    takes: Array


def _law(scene: Scene, table: str, modulus: Array, radius: Array, share: Array) -> _Law:
    """The law of a face that takes damage, or yields: of its softer body, row by row, but for what [contact] gives."""
    elastic = _Law(face=None, takes=_everywhere(0.0, scene))
    if scene.contact_law == "damage":
        c, beta = scene.columns, contact.hertz_constant(modulus, radius)
        energy = c["contact.fracture_energy"] * contact.sphere_mass(c["sphere.radius"], c["sphere.density"])
        if scene.stiffness_left is not None:
            energy = energy * scene.stiffness_left
        critical = critical_approach(energy / scene.contacts, share, beta, c["contact.gamma"])
        law = Softening(
            critical=critical, gamma=c["contact.gamma"], modulus=modulus, effective_radius=radius, hertz_constant=beta
        )
        return _Law(face=law, takes=share)
    if scene.contact_law != "plastic":
        return elastic
    numbers = law_of(scene.columns, table, rigid=scene.rigid_contact, at_onset=scene.hardness_at_onset)
    if np.isinf(numbers.onset).all():
        return elastic
    face = Face(**numbers._asdict(), modulus=modulus, effective_radius=radius)
    crushed = sphere_body(scene.columns).onset < body_of(scene.columns, table, scene.rigid_contact).onset
    return _Law(face=face, takes=np.where(crushed, 1.0, 0.0))

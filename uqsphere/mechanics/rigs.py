"""The rigs: the counter-bodies at the two poles of the sphere, and what loads it.

A counter-body gives way by its impedance (a bar, a thin plate), by its mass, or not at all (a thick
block, a platen).  Its contact with the sphere has a reduced modulus, a radius and, if it yields, a
contact law.

A new rig of known tables is one entry of ``rigs.toml``.  A new table also needs its keys in
``forms.toml``, their numbers in ``inputs.toml``, and its keys in a study
(`uqsphere.study.document`).
Equation numbers (R...) and (C...) refer to docs/theory.md; SI units.
"""

import math

import numpy as np

from uqsphere.arrays import ColumnMap, Names, Values, frozen

from .inputs import declared
from .yielding import CAP_PILE_UP, ContactParameters, metal_body, softer

#: keys of the three parameters of a contact law
LAW = ("onset_pressure", "hardness", "pile_up")


def plate_impedance(E: Values, nu: Values, density: Values, thickness: Values) -> Values:
    """Z = (4/sqrt 3) h² sqrt(rho E/(1 - nu²)) [N s/m] of a thin unbounded plate, (R2).

    Source: C. Zener, Phys. Rev. 59 (1941) 669, from memory.
    """
    stiffness = np.sqrt(density * E / (1.0 - nu * nu))
    return 4.0 / math.sqrt(3.0) * np.square(thickness) * stiffness


def body_of(columns: ColumnMap, table: str, rigid: bool) -> ContactParameters:
    """Contact parameters of a counter-body: as given, else of a metal; infinite onset if rigid."""
    none = np.full(len(columns["sphere.E"]), np.nan)
    strength, nu = (
        columns.get(f"{table}.insert_{key}", columns.get(f"{table}.{key}", none))
        for key in ("yield_strength", "nu")
    )
    body = _with_columns(columns, table, metal_body(none if rigid else strength, nu))
    if rigid:
        return body._replace(onset=np.full_like(nu, np.inf))
    return body


def sphere_body(columns: ColumnMap) -> ContactParameters:
    """Contact parameters of the sphere, which is elastic without an onset pressure."""
    elastic = np.full(len(columns["sphere.E"]), np.inf)
    pile_up = np.full_like(elastic, CAP_PILE_UP)
    return _with_columns(columns, "sphere", ContactParameters(elastic, elastic, pile_up))


def law_of(
    columns: ColumnMap, body: ContactParameters, *, at_onset: bool = False
) -> ContactParameters:
    """Contact parameters of sphere and counter-body: of the softer one in each row, unless
    [contact] gives them; with the hardness `at_onset`.
    """
    law = _with_columns(columns, "contact", softer(body, sphere_body(columns)))
    return law._replace(hardness=law.onset) if at_onset else law


def _with_columns(columns: ColumnMap, table: str, body: ContactParameters) -> ContactParameters:
    """Contact parameters with those that a table gives."""
    pairs = zip(LAW, body, strict=True)
    return ContactParameters._make(columns.get(f"{table}.{key}", value) for key, value in pairs)


#: gravity [m/s²]; drag coefficient of a sphere and density of air [kg/m³] (from memory)
GRAVITY = 9.80665
_DRAG, _AIR = 0.45, 1.2
#: largest lam (force over Z and speed) of a plate or bar end; beyond it a plate is punched, (R13)
LARGEST_LAM = 3.0
#: ranges of M/m_A and kappa in which the equations are solved
MASS_RATIO = (1e-7, 1e3)
STIFFNESS_RATIO = (1e-3, 1e3)


@frozen
class Rig:
    """One rig: a set-up that loads the sphere, an entry of ``rigs.toml``.

    title: as it stands in the description of a study. behind, ahead: tables of the counter-bodies
    at contacts A and B; empty where the sphere is free. kinds: their kinds; empty where the study
    chooses (`target.kind`, `anvil.kind`). mover: table with the speed that loads the sphere:
    `striker`, whose pulse arrives through the bar at A; `rig`, where the sphere itself moves, or
    `hammer`, for bodies that meet with a speed; empty for slow loading.
    """

    name: str
    title: str
    behind: str
    ahead: str
    kinds: tuple[str, str]
    mover: str = ""

    @property
    def by_wave(self) -> bool:
        """Whether a stress wave loads the sphere."""
        return self.mover == "striker"

    @property
    def by_impact(self) -> bool:
        """Whether bodies meet with a speed; their record ends when they part."""
        return self.sphere_moves or self.weight_falls

    @property
    def by_press(self) -> bool:
        """Whether the sphere is loaded slowly."""
        return not self.mover

    @property
    def sphere_moves(self) -> bool:
        """Whether the sphere itself has the impact speed."""
        return self.mover == "rig"

    @property
    def weight_falls(self) -> bool:
        """Whether a drop weight has the impact speed."""
        return self.mover == "hammer"

    @property
    def tables(self) -> Names:
        """Tables of a study that belong to this rig."""
        of_wave = ("striker", "pulse") if self.by_wave else ()
        return tuple(dict.fromkeys(filter(None, (self.behind, self.ahead, *of_wave))))

    def kind(self, pole: int, options: Values) -> str:
        """Kind of the counter-body at a contact; `thick` unless the study chooses another."""
        table = (self.behind, self.ahead)[pole]
        return self.kinds[pole] or str(options.get(f"{table}.kind", "thick"))


#: every rig by its name
RIGS = declared("rigs.toml", Rig)
#: the rig of a study that names none
DEFAULT_RIG = "bars"


def drop_speed(height: Values, radius: Values, density: Values) -> Values:
    """Speed [m/s] of a sphere after a fall of h [m] in air: v² = v_t² (1 - exp(-2 g h/v_t²))."""
    terminal = terminal_speed(radius, density) ** 2
    return np.sqrt(-terminal * np.expm1(-2.0 * GRAVITY * height / terminal))


def terminal_speed(radius: Values, density: Values) -> Values:
    """Terminal speed v_t [m/s] of a sphere in air: v_t² = 8 r rho g/(3 C_D rho_air)."""
    return np.sqrt(8.0 * radius * density * GRAVITY / (3.0 * _DRAG * _AIR))

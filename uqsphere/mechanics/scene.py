"""Batches of scenes: n rows of numbers in columns, with the scale factors that follow from them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from functools import cached_property
from math import inf, nan
from typing import NamedTuple

import numpy as np

from uqsphere.arrays import Array, Duo, Flags, Pair, Places, Values, frozen, quiet

from . import bars, contact
from .criteria import Demands
from .forms import FORMS, kinds_of, needs_of
from .inputs import INPUTS
from .integrator.tracked import DOMAIN, NEVER_CLOSES, TOO_LONG_PULSE
from .pulses import SHAPES, STRIKER_SHAPES, MeasuredPulse, Pulse, build_pulse
from .rigs import (
    DEFAULT_RIG,
    GRAVITY,
    LARGEST_LAM,
    MASS_RATIO,
    RIGS,
    STIFFNESS_RATIO,
    Rig,
    body_of,
    drop_speed,
    law_of,
    plate_impedance,
    sphere_body,
)
from .yielding import ContactParameters, Face

#: what the status of a row means; only rows with status 0 have values
STATUS = {
    0: "ok",
    1: "outside the domain of the model (invalid size, modulus, Poisson ratio or pulse; sphere "
    "wider than its bar; contact wider than its rod; punched plate; hardness below the onset "
    "pressure)",
    2: "the pulse is longer than the round trip of the incident bar, with the striker still on it",
    3: "the integrator did not reach the tolerance",
    4: "too many reflections before the end of the evaluation window",
    5: "too many steps before the end of the evaluation window",
    6: "the result is not finite",
    11: "the bodies never meet: the closing speed is not positive",
    12: "the bodies were still in contact at the horizon; set a later model.horizon",
}
#: shortest pulse and round trip over t_c that double precision resolves
_SHORTEST = 1e-9


def answered(status: Places) -> Values:
    """Rows with values, (n,)."""
    return status == 0


#: last parts of columns that are used in validity checks only if the contact law is elastic
_CHECKED_ONLY = (
    "yield_strength",
    "insert_yield_strength",
    "insert_thickness",
    "width",
    "onset_pressure",
    "hardness",
    "pile_up",
)
#: columns of a striker that differs from the bars
STRIKER_COLUMNS = frozenset({"striker.E", "striker.density", "striker.diameter"})


class Scales(NamedTuple):
    """Scale factors and similarity numbers of n rows, theory (8) and (10), (R4) to (R6); SI.

    `modulus`, `effective_radius` and `hertz_constant` are those of contact A, or B if there is no
    A.
    """

    modulus: Values
    effective_radius: Values
    hertz_constant: Values
    mass: Values
    impedance: Values
    force: Values
    approach: Values
    time: Values
    mass_number: Values
    duration: Values
    speed: Values

    def at(self, rows: int | Places) -> Scales:
        """Those of some rows, or of one."""
        return Scales._make(column[rows] for column in self)

    @property
    def pulse_number(self) -> Values:
        """theta = t_i/t_c."""
        return self.duration / self.time


@frozen
class Partner:
    """The counter-body at one contact; (n,) each.

    pole: `a` or `b`, of contact A or B.  table: table of the study with its numbers.  kind: `bar`,
    `plate`, `thick`, `mass` or `platen`.
    modulus, effective_radius, hertz_constant: E* [Pa], r_eff [m] and beta [N/m^1.5] of the contact.
    share: chi = E* (1 - nu²)/E, the sphere's fraction of the elastic energy, (R22).  impedance: Z
    [N s/m], infinite if it is rigid.  mass: [kg], infinite if it is not free.  round_trip,
    reflection: of a bar and its far end; infinite and 0 without a reflected wave.  body: its own
    contact parameters.  face: the law of the contact if it yields.  takes: the sphere's fraction of
    the plastic work, 1 if the sphere itself yields.
    """

    pole: str
    table: str
    kind: str
    modulus: Array
    effective_radius: Array
    hertz_constant: Array
    share: Array
    impedance: Array
    mass: Array
    round_trip: Array
    reflection: Array
    body: ContactParameters
    face: Face | None
    takes: Array


@frozen
class Scene:
    """n scenes that share their structure and differ in their numbers.

    columns: (n,) arrays [SI] by their dotted path in `inputs.INPUTS`.  shape: of the incident
    pulse, a key of `pulses.SHAPES` or `measured`.  infinite: without reflected waves.
    rigid_contact: the bars are rigid in the contact, 1/E* = (1 - nu²)/E.  first_loading_only: the
    evaluation window ends when the first reflected wave returns.  whole_record: between bars it
    extends to the horizon, recontacts included.  horizon: its end [s]; None: the rule of
    docs/theory.md.  contact_law: `hertz` or `plastic`.  hardness_at_onset: the hardness equals the
    onset pressure in every row (Thornton's law).  record: the pulse of `measured`, the same in
    every row except for its gain; `striker.speed` is then 2 c0 times its peak strain and gain.
    rig: a key of `rigs.RIGS`; shape, infinite, first_loading_only and record belong to rigs loaded
    by a wave.  options: words of the study, ``target.kind``, ``anvil.kind``, ``hammer.shape``.
    demands: further quantities, name -> criterion and its parameters.

    Raises ValueError for a missing, unknown or misshapen column, an unknown word, or an evaluation
    window without an end.
    """

    columns: Mapping[str, Array]
    shape: str = "rectangular"
    infinite: bool = False
    rigid_contact: bool = False
    first_loading_only: bool = False
    whole_record: bool = False
    horizon: float | None = None
    demands: Demands = field(default_factory=dict)
    contact_law: str = "hertz"
    hardness_at_onset: bool = False
    record: MeasuredPulse | None = None
    rig: str = DEFAULT_RIG
    options: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, word, allowed in (
            ("rig", self.rig, RIGS),
            ("pulse shape", self.shape, (*SHAPES, "measured")),
            ("contact law", self.contact_law, FORMS["contact"]),
        ):
            if word not in allowed:
                raise ValueError(f"unknown {name} {word!r} (allowed: {', '.join(allowed)})")
        missing = ", ".join(self._missing_columns())
        if missing:
            raise ValueError(f"columns are missing: {missing}")
        unknown = self.columns.keys() - INPUTS.keys()
        if unknown:
            raise ValueError(f"unknown columns: {', '.join(sorted(unknown))}")
        if (self.shape == "measured") != (self.record is not None):
            raise ValueError("the shape 'measured' needs a record, and other shapes take none")
        if self.shape not in STRIKER_SHAPES and not STRIKER_COLUMNS.isdisjoint(self.columns):
            raise ValueError(
                f"a {self.shape} pulse does not depend on the striker's material or diameter"
            )
        if self.by_wave and self.shape == "step" and self.horizon is None and self.infinite:
            raise ValueError("a step pulse in infinite bars needs a horizon")
        if self.horizon is not None and not 0.0 < self.horizon < inf:
            raise ValueError(f"horizon must be positive and finite, not {self.horizon!r} s")
        shapes = {np.shape(column) for column in self.columns.values()}
        if shapes != {(len(self),)}:
            raise ValueError(
                f"all columns must have the same shape (n,), not {sorted(map(str, shapes))}"
            )

    def _missing_columns(self) -> Iterator[str]:
        """Required columns that are not given."""
        kinds = kinds_of(
            self.rig,
            self.shape,
            timed="pulse.duration" in self.columns,
            infinite=self.infinite,
            options=self.options,
        )
        for table in ("sphere", *self.setup.tables, "rig"):
            form = FORMS[table].get(kinds.get(table, ""), "")
            for keys in needs_of(form):
                names = [f"{table}.{key}" for key in keys]
                if self.columns.keys().isdisjoint(names):
                    yield names[0]

    def __len__(self) -> int:
        return np.size(next(iter(self.columns.values())))

    def at(self, rows: Places | slice) -> Scene:
        """The scene of some of its rows."""
        return replace(self, columns={name: column[rows] for name, column in self.columns.items()})

    def column(self, name: str, default: float = nan) -> Array:
        """A column, or `default` in every row."""
        return self.columns.get(name, np.full(len(self), default))

    def numbers(self, table: str, keys: str) -> list[Array]:
        """Columns of a table by their keys, separated by spaces; NaN where one is not given."""
        return [self.column(f"{table}.{key}") for key in keys.split()]

    @property
    def setup(self) -> Rig:
        """The entry of its rig in `rigs.RIGS`."""
        return RIGS[self.rig]

    @property
    def by_wave(self) -> bool:
        """Whether a stress wave loads the sphere, between bars."""
        return self.setup.by_wave

    @property
    def by_hertz(self) -> bool:
        """Whether both contacts follow Hertz with one constant."""
        return self.by_wave and self.struck.face is None

    # --- the pulse --------------------------------------------------------------------------------

    @cached_property
    def pulse(self) -> Pulse:
        """The incident pulse of every row, times in seconds; of no length without a wave."""
        if not self.by_wave:
            return build_pulse("rectangular", np.zeros(len(self)))
        if self.record is not None:
            return self.record.pulse(len(self))
        numbers = {
            name.removeprefix("pulse."): column
            for name, column in self.columns.items()
            if name.startswith("pulse.")
        }
        if self.striker_ratio is not None:
            numbers["striker_ratio"] = self.striker_ratio
        return build_pulse(self.shape, self._duration, numbers)

    @property
    @quiet
    def _duration(self) -> Values:
        """Length of the pulse, (n,) [s]; infinite for a step, and without a wave."""
        if not self.by_wave or self.shape == "step":
            return np.full(len(self), inf)
        if self.record is not None:
            return np.full(len(self), self.record.duration)
        if "pulse.duration" in self.columns:
            return self.columns["pulse.duration"]
        return bars.round_trip(self.columns["striker.length"], *self._striker)

    @property
    def _striker(self) -> Pair:
        """E and density of the striker, (n,) each: the bars' if omitted."""
        c = self.columns
        E = c.get("striker.E", c["bars.E"])
        return E, c.get("striker.density", c["bars.density"])

    @cached_property
    @quiet
    def striker_ratio(self) -> Values | None:
        """Impedance ratio of striker and bars, (n,); None for a striker of the bars' kind."""
        if STRIKER_COLUMNS.isdisjoint(self.columns):
            return None
        diameter = self.columns.get("striker.diameter", self.columns["bars.diameter"])
        return bars.impedance(*self._striker, diameter) / self.scales.impedance

    # --- the counter-bodies -----------------------------------------------------------------------

    @cached_property
    def partners(self) -> tuple[Partner | None, Partner]:
        """Counter-bodies at contact A (behind the sphere; None without a contact) and B (ahead)."""
        behind = _partner(self, 0) if self.setup.behind else None
        return behind, _partner(self, 1)

    @property
    def there(self) -> tuple[Partner, ...]:
        """The counter-bodies, A first."""
        return tuple(filter(None, self.partners))

    @property
    def struck(self) -> Partner:
        """The counter-body whose contact gives the scale factors: A, or B if there is no A."""
        return self.there[0]

    @cached_property
    def round_trips(self) -> Array:
        """Round trips of the bars at A and B, (n, 2) [s]; infinite without a bar, or its length."""
        return self._of_partners("round_trip", inf)

    @cached_property
    def reflections(self) -> Array:
        """Velocity reflection coefficients of the far ends, (n, 2); 0 without a reflected wave."""
        return self._of_partners("reflection", 0.0)

    def _of_partners(self, name: str, absent: float) -> Array:
        """A number of both counter-bodies, (n, 2); `absent` without one."""
        none = np.full(len(self), absent)
        return np.stack([getattr(p, name, none) for p in self.partners], axis=1)

    @cached_property
    def echoes(self) -> Values:
        """Round trips of the waves that come back from A and B, (n, 2) [s]; infinite where none
        does.
        """
        return np.where(self.reflections != 0.0, self.round_trips, inf)

    @cached_property
    def first_echo(self) -> Values:
        """Arrival of the first reflected wave at the sphere, (n,) [s]; infinite without one."""
        return self.echoes.min(axis=1)

    @cached_property
    def record_end(self) -> Array:
        """Latest end of the evaluation window, (n,) [s]; infinite if another rule ends it.

        Between bars it is finite in all rows inside the domain or in none: by the horizon, or as
        bars that are not `infinite` have lengths.  The integrator relies on it
        (`solve._local_errors`).
        """
        ends = np.full(len(self), self.horizon or inf)
        if self.horizon is None and self.by_wave and not self.infinite:
            ends = 8.0 * self.round_trips.max(axis=1)
        if self.first_loading_only:
            ends = np.minimum(ends, self.first_echo)
        return ends

    # --- speeds and scale factors -----------------------------------------------------------------

    @cached_property
    @quiet
    def closing_speed(self) -> Array:
        """Normal closing speed of an impact, (n,) [m/s]: as given, or after a fall."""
        c = self.columns
        mover = self.setup.mover
        if f"{mover}.drop_height" not in c:
            speed = self.column(f"{mover}.speed")
        elif self.setup.sphere_moves:
            speed = drop_speed(c["rig.drop_height"], c["sphere.radius"], c["sphere.density"])
        else:
            # the drag on a drop weight depends on its shape; it is small
            speed = np.sqrt(2.0 * GRAVITY * c[f"{mover}.drop_height"])
        if "rig.angle" in c:
            speed = speed * np.sin(c["rig.angle"])
        return speed

    @cached_property
    def start(self) -> Array:
        """Speeds of sphere and counter-bodies A, B at first touch, (n, 3) [m/s], A to B. (R7)."""
        start = np.zeros((len(self), 3))
        if self.setup.sphere_moves:
            start[:, 0] = self.closing_speed
        elif self.setup.weight_falls:
            start[:, 1] = self.closing_speed
        return start

    @cached_property
    @quiet
    def scales(self) -> Scales:
        """Scale factors of every row; not finite in rows outside the domain.

        An impact has V_c and P_c = beta^0.4 m^0.6 V_c^1.2, (R5), with the mass m of the drop
        weight, or the reduced mass of sphere and counter-body.  For slow loading V_c = 1, and P_c
        is the force at an approach of one radius.
        """
        c, (behind, ahead), struck = self.columns, self.partners, self.struck
        beta = struck.hertz_constant
        mass = contact.sphere_mass(c["sphere.radius"], c["sphere.density"])
        if self.by_wave:
            speed = 0.5 * c["striker.speed"]
            force = ahead.impedance * speed
        elif self.setup.by_press:
            speed = np.ones(len(self))
            force = beta * c["sphere.radius"] ** 1.5
        else:
            speed = self.closing_speed
            moved = behind.mass if behind else mass / (1.0 + mass / struck.mass)
            # one root for the three powers: m³ v⁶ beta²
            impulse = moved * speed * speed
            force = (beta * beta * impulse * impulse * impulse) ** 0.2
        approach = contact.approach_at_force(force, beta)
        time = approach / speed
        return Scales(
            modulus=struck.modulus,
            effective_radius=struck.effective_radius,
            hertz_constant=beta,
            mass=mass,
            impedance=ahead.impedance,
            force=force,
            approach=approach,
            time=time,
            mass_number=mass * speed / (force * time),
            duration=self._duration,
            speed=speed,
        )

    # --- the domain -------------------------------------------------------------------------------

    @cached_property
    @quiet
    def status(self) -> Places:
        """Status of every row before the integration, (n,): see `STATUS`."""
        inside = self._valid_numbers() & self._in_range()
        codes = np.where(inside, 0, DOMAIN)
        if self.setup.by_impact:
            codes[self.closing_speed <= 0.0] = NEVER_CLOSES
        if self.by_wave and not self.infinite:
            too_long = self.pulse.end > self.echoes[:, 0] * (1.0 + 1e-9)
            codes[inside & too_long] = TOO_LONG_PULSE
        return codes

    def _valid_numbers(self) -> Flags:
        """Rows whose numbers, scale factors and contact laws are valid, (n,)."""
        inside = np.ones(len(self), bool)
        for name, column in self.columns.items():
            if name.partition(".")[2] in _CHECKED_ONLY and self.contact_law == "hertz":
                continue
            allowed = INPUTS[name].allows(column)
            if name.endswith(("end_radius", "face_radius", "onset_pressure", "hardness")):
                allowed |= column == inf
            inside &= allowed
        scales = self.scales
        for number in (scales.mass_number, scales.force, scales.approach, scales.time):
            inside &= (number > 0.0) & (number < inf)
        inside &= ~(np.fmin(scales.duration, self.first_echo) < _SHORTEST * scales.time)
        for partner in self.there:
            if partner.face is not None:
                inside &= partner.face.valid
        return inside

    def _in_range(self) -> Flags:
        """Rows inside the domain of the equations of their rig, (n,)."""
        c, scales, (behind, ahead) = self.columns, self.scales, self.partners
        if self.by_wave:
            return self.pulse.valid & ~(2.0 * c["sphere.radius"] > c["bars.diameter"])
        inside = np.ones(len(self), bool)
        for partner in self.there:
            # it is 0 for a body without waves, and a rod under a weight is not limited
            if behind is None or partner.kind == "plate":
                inside &= scales.force / (partner.impedance * scales.speed) <= LARGEST_LAM
        if behind is not None:
            inside &= _between(ahead.hertz_constant / behind.hertz_constant, STIFFNESS_RATIO)
            if self.setup.weight_falls:
                inside &= _between(scales.mass / behind.mass, MASS_RATIO)
        if "platens.displacement" in c:
            inside &= ~(c["platens.displacement"] >= c["sphere.radius"])
        return inside


def _between(ratio: Array, bounds: Duo) -> Flags:
    return (ratio >= bounds[0]) & (ratio <= bounds[1])


@quiet
def _partner(scene: Scene, pole: int) -> Partner:
    """The counter-body at contact A (0) or B (1); not finite in rows outside the domain."""
    c = scene.columns
    rig = scene.setup
    table = (rig.behind, rig.ahead)[pole]
    kind = rig.kind(pole, scene.options)
    E, nu, density = scene.numbers(table, "E nu density")
    rigid = np.full(len(scene), inf)
    still = np.zeros(len(scene))
    impedance = mass = round_trip = rigid
    reflection = takes = still
    end_radius = scene.column(f"{table}.{'end' if scene.by_wave else 'face'}_radius", inf)
    ball = table == "other" or scene.options.get(f"{table}.shape") == "ball"
    if table == "other":
        end_radius = c["other.radius"]
    elif ball:
        end_radius = 0.5 * c[f"{table}.diameter"]
    face_E = c.get(f"{table}.insert_E", E)
    if scene.rigid_contact:
        face_E = rigid
    modulus = contact.reduced_modulus(
        c["sphere.E"], c["sphere.nu"], face_E, c.get(f"{table}.insert_nu", nu)
    )
    radius = contact.effective_radius(c["sphere.radius"], end_radius)
    if kind == "bar":
        impedance = bars.impedance(E, density, c[f"{table}.diameter"])
        bar = ("incident_", "receiving_")[pole] if scene.by_wave else ""
        if f"{table}.{bar}length" in c:
            round_trip = bars.round_trip(c[f"{table}.{bar}length"], E, density)
            if not scene.infinite:
                end = "absorbing" if bar == "receiving_" else "free"
                reflection = scene.column(f"{table}.{bar}end", bars.END_COEFFICIENTS[end])
    elif kind == "plate":
        impedance = plate_impedance(E, nu, density, c[f"{table}.thickness"])
    elif ball:
        mass = contact.sphere_mass(end_radius, density)
    elif kind == "mass":
        mass = c[f"{table}.mass"]
    body = body_of(c, table, scene.rigid_contact)
    face = None
    if scene.contact_law == "plastic":
        law = law_of(c, body, at_onset=scene.hardness_at_onset)
        if not np.isinf(law.onset).all():
            law = law.with_finite_onset(modulus)
            face = Face(**law._asdict(), modulus=modulus, effective_radius=radius)
            takes = np.where(sphere_body(c).onset < body.onset, 1.0, 0.0)
    return Partner(
        pole="ab"[pole],
        table=table,
        kind=kind,
        modulus=modulus,
        effective_radius=radius,
        hertz_constant=contact.hertz_constant(modulus, radius),
        share=modulus * (1.0 - np.square(c["sphere.nu"])) / c["sphere.E"],
        impedance=impedance,
        mass=mass,
        round_trip=round_trip,
        reflection=reflection,
        body=body,
        face=face,
        takes=takes,
    )

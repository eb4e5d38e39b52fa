"""Batches of scenes: n rows of numbers in columns, with the scale factors that follow from them."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.forms import FORMS, kinds_of, needs_of
from uqsphere.mechanics.inputs import INPUTS
from uqsphere.mechanics.integrator.tracked import DOMAIN, NEVER_CLOSES, TOO_LONG_PULSE
from uqsphere.mechanics.pulses import SHAPES, STRIKER_SHAPES, MeasuredPulse, Pulse, build_pulse
from uqsphere.mechanics.rigs import (
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
from uqsphere.mechanics.yielding import Face

#: what the status of a row means; only rows with status 0 have values
STATUS: dict[int, str] = {
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
_SHORTEST: Final = 1e-9


def answered(status: Places) -> Flags:
    """Rows with values, (n,)."""
    return np.asarray(status == 0)


#: last parts of columns that are used in validity checks only if the contact law is elastic
_CHECKED_ONLY: Final = (
    "yield_strength",
    "insert_yield_strength",
    "insert_thickness",
    "width",
    "onset_pressure",
    "hardness",
    "pile_up",
)
#: columns of a striker that differs from the bars
STRIKER_COLUMNS: Final = frozenset({"striker.E", "striker.density", "striker.diameter"})


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scale factors and similarity numbers of n rows, theory (8) and (10), (R4) to (R6); SI.

    `modulus`, `effective_radius` and `hertz_constant` are those of contact A, or B if there is no
    A.
    """

    modulus: Array
    effective_radius: Array
    hertz_constant: Array
    mass: Array
    impedance: Array
    force: Array
    approach: Array
    time: Array
    mass_number: Array
    duration: Array
    speed: Array

    @property
    def pulse_number(self) -> Array:
        """theta = t_i/t_c."""
        return self.duration / self.time


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


@dataclass(frozen=True, kw_only=True)
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
    demands: Mapping[str, tuple[str, Mapping[str, float]]] = field(default_factory=dict)
    contact_law: str = "hertz"
    hardness_at_onset: bool = False
    record: MeasuredPulse | None = None
    rig: str = DEFAULT_RIG
    options: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check_word("rig", self.rig, RIGS)
        _check_word("pulse shape", self.shape, (*SHAPES, "measured"))
        _check_word("contact law", self.contact_law, FORMS["contact"])
        missing = self._missing_columns()
        if missing:
            raise ValueError(f"columns are missing: {', '.join(missing)}")
        unknown = [name for name in self.columns if name not in INPUTS]
        if unknown:
            raise ValueError(f"unknown columns: {', '.join(unknown)}")
        self._check_pulse()
        shapes = {np.shape(column) for column in self.columns.values()}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise ValueError(
                f"all columns must have the same shape (n,), not {sorted(map(str, shapes))}"
            )

    def _check_pulse(self) -> None:
        """Raise ValueError for a pulse, or an evaluation window, that contradicts itself."""
        if (self.shape == "measured") != (self.record is not None):
            raise ValueError("the shape 'measured' needs a record, and other shapes take none")
        if self.shape not in STRIKER_SHAPES and not STRIKER_COLUMNS.isdisjoint(self.columns):
            raise ValueError(
                f"a {self.shape} pulse does not depend on the striker's material or diameter"
            )
        if self.by_wave and self.shape == "step" and self.horizon is None and self.infinite:
            raise ValueError("a step pulse in infinite bars needs a horizon")
        if self.horizon is not None and not 0.0 < self.horizon < np.inf:
            raise ValueError(f"horizon must be positive and finite, not {self.horizon!r} s")

    def _missing_columns(self) -> list[str]:
        """Required columns that are not given."""
        kinds = kinds_of(
            self.rig,
            self.shape,
            timed="pulse.duration" in self.columns,
            infinite=self.infinite,
            options=self.options,
        )
        missing = []
        for table in ("sphere", *self.setup.tables, "rig"):
            form = FORMS[table].get(kinds.get(table, ""), "")
            for keys in needs_of(form):
                names = [f"{table}.{key}" for key in keys]
                if self.columns.keys().isdisjoint(names):
                    missing.append(names[0])
        return missing

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def at(self, rows: Places | slice) -> Scene:
        """The scene of some of its rows."""
        return replace(self, columns={name: column[rows] for name, column in self.columns.items()})

    def column(self, name: str, default: float = np.nan) -> Array:
        """A column, or `default` in every row."""
        return np.asarray(self.columns.get(name, np.full(len(self), default)), dtype=float)

    @property
    def setup(self) -> Rig:
        """The entry of its rig in `rigs.RIGS`."""
        return RIGS[self.rig]

    @property
    def by_wave(self) -> bool:
        """Whether a stress wave loads the sphere, between bars."""
        return self.setup.by_wave

    # --- the pulse --------------------------------------------------------------------------------

    @cached_property
    def pulse(self) -> Pulse:
        """The incident pulse of every row, times in seconds; zero in rigs without a wave."""
        if not self.by_wave:
            zeros = np.zeros(len(self))
            return Pulse(
                breaks=np.zeros((len(self), 2)),
                coefficients=np.zeros((len(self), 1, 4)),
                frequency=zeros,
                valid=zeros == 0.0,
            )
        if self.record is not None:
            return self.record.pulse(len(self))
        numbers = {
            name.removeprefix("pulse."): column
            for name, column in self.columns.items()
            if name.startswith("pulse.") and name != "pulse.duration"
        }
        if self.striker_ratio is not None:
            numbers["striker_ratio"] = self.striker_ratio
        return build_pulse(self.shape, self._duration, numbers)

    @property
    def _duration(self) -> Array:
        """Length of the pulse, (n,) [s]; infinite for a step, and without a wave."""
        if not self.by_wave or self.shape == "step":
            return np.full(len(self), np.inf)
        if self.record is not None:
            return np.full(len(self), self.record.duration)
        if "pulse.duration" in self.columns:
            return self.columns["pulse.duration"]
        with np.errstate(all="ignore"):
            return np.asarray(
                2.0 * self.columns["striker.length"] / bars.wave_speed(*self._striker)
            )

    @property
    def _striker(self) -> tuple[Array, Array]:
        """E and density of the striker, (n,) each: the bars' if omitted."""
        c = self.columns
        E = c.get("striker.E", c["bars.E"])
        return E, c.get("striker.density", c["bars.density"])

    @cached_property
    def striker_ratio(self) -> Array | None:
        """Impedance ratio of striker and bars, (n,); None for a striker of the bars' kind."""
        if STRIKER_COLUMNS.isdisjoint(self.columns):
            return None
        with np.errstate(all="ignore"):
            diameter = self.columns.get("striker.diameter", self.columns["bars.diameter"])
            return np.asarray(bars.impedance(*self._striker, diameter) / self.scales.impedance)

    # --- the counter-bodies -----------------------------------------------------------------------

    @cached_property
    def partners(self) -> tuple[Partner | None, Partner | None]:
        """Counter-bodies at contact A (behind the sphere) and B (ahead), None without a contact."""
        rig = self.setup
        if rig.by_wave:
            partner = _partner(self, rig.behind, "bar")
            ends = zip(self.round_trips.T, self.reflections.T, strict=True)
            incident, receiving = (
                replace(partner, round_trip=trip, reflection=end) for trip, end in ends
            )
            return incident, receiving
        ahead = _partner(self, rig.ahead, rig.kind(1, self.options))
        if not rig.behind:
            return None, ahead
        if rig.by_press:
            return ahead, ahead
        behind = _partner(self, rig.behind, rig.kind(0, self.options))
        return replace(behind, speed=self.closing_speed), ahead

    @property
    def there(self) -> tuple[Partner, ...]:
        """The counter-bodies, A first."""
        return tuple(partner for partner in self.partners if partner is not None)

    @property
    def struck(self) -> Partner:
        """The counter-body whose contact gives the scale factors: A, or B if there is no A."""
        return self.there[0]

    @property
    def faces(self) -> Face | None:
        """The contact law of `struck` (of both bars), (n,) each; None if elastic."""
        return self.struck.face

    @cached_property
    def round_trips(self) -> Array:
        """Round trips of the bars at A and B, (n, 2) [s]; infinite without a bar, or its length."""
        if not self.by_wave:
            return self._of_poles("round_trip", np.inf)
        E, density = self.columns["bars.E"], self.columns["bars.density"]
        lengths = [self.column(f"bars.{bar}_length", np.inf) for bar in ("incident", "receiving")]
        with np.errstate(all="ignore"):
            return np.stack([bars.round_trip(length, E, density) for length in lengths], axis=1)

    @cached_property
    def reflections(self) -> Array:
        """Velocity reflection coefficients of the far ends, (n, 2); 0 without a reflected wave."""
        if not self.by_wave:
            return self._of_poles("reflection", 0.0)
        if self.infinite:
            return np.zeros((len(self), 2))
        incident = self.column("bars.incident_end", bars.END_COEFFICIENTS["free"])
        receiving = self.column("bars.receiving_end", bars.END_COEFFICIENTS["absorbing"])
        return np.stack([incident, receiving], axis=1)

    def _of_poles(self, name: str, default: float) -> Array:
        """A number of the counter-bodies at A and B, (n, 2); `default` without a contact."""
        columns = np.full((len(self), 2), default)
        for pole, partner in enumerate(self.partners):
            if partner is not None:
                columns[:, pole] = getattr(partner, name)
        return columns

    @cached_property
    def first_echo(self) -> Array:
        """Arrival of the first reflected wave at the sphere, (n,) [s]; infinite without one."""
        arrivals = np.where(self.reflections != 0.0, self.round_trips, np.inf)
        return np.asarray(arrivals.min(axis=1))

    @cached_property
    def record_end(self) -> Array:
        """Latest end of the evaluation window, (n,) [s]; infinite if another rule ends it."""
        if self.horizon is not None:
            ends = np.full(len(self), self.horizon)
        elif self.infinite or not self.by_wave:
            ends = np.full(len(self), np.inf)
        else:
            ends = 8.0 * self.round_trips.max(axis=1)
        if self.first_loading_only:
            ends = np.minimum(ends, self.first_echo)
        return ends

    # --- speeds and scale factors -----------------------------------------------------------------

    @cached_property
    def closing_speed(self) -> Array:
        """Normal closing speed of an impact, (n,) [m/s]: as given, or after a fall."""
        c, mover = self.columns, self.setup.mover
        with np.errstate(all="ignore"):
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
    def scales(self) -> Scales:
        """Scale factors of every row; not finite in rows outside the domain."""
        c, face = self.columns, self.struck
        with np.errstate(all="ignore"):
            mass = contact.sphere_mass(c["sphere.radius"], c["sphere.density"])
            impedance = (self.partners[1] or face).impedance
            if self.by_wave:
                speed = 0.5 * c["striker.speed"]
                force = impedance * speed
            else:
                speed, force = self._impact_scales(mass)
            approach = contact.approach_at_force(force, face.hertz_constant)
            time = approach / speed
            mass_number = mass * speed / (force * time)
            if self.by_wave:
                mass_number = mass / (impedance * time)
        return Scales(
            modulus=face.modulus,
            effective_radius=face.effective_radius,
            hertz_constant=face.hertz_constant,
            mass=mass,
            impedance=impedance,
            force=force,
            approach=approach,
            time=time,
            mass_number=mass_number,
            duration=self._duration,
            speed=speed,
        )

    def _impact_scales(self, mass: Array) -> tuple[Array, Array]:
        """V_c and P_c = beta^0.4 m^0.6 V_c^1.2, (R5), of an impact.

        m is the mass of the drop weight, or the reduced mass of sphere and counter-body.  For slow
        loading V_c = 1, and P_c is the force at an approach of one radius.
        """
        face, behind, beta = self.struck, self.partners[0], self.struck.hertz_constant
        if self.setup.by_press:
            return np.ones(len(self)), beta * self.columns["sphere.radius"] ** 1.5
        speed = self.closing_speed
        if behind is None:
            moved = mass / (1.0 + mass / face.mass)
        else:
            moved = behind.mass
        # one root for the three powers: m³ v⁶ beta²
        impulse = moved * speed * speed
        return speed, (beta * beta * impulse * impulse * impulse) ** 0.2

    # --- the domain -------------------------------------------------------------------------------

    @cached_property
    def status(self) -> Places:
        """Status of every row before the integration, (n,): see `STATUS`."""
        codes = np.zeros(len(self), dtype=np.int64)
        with np.errstate(all="ignore"):
            codes[~self._in_domain()] = DOMAIN
            if not self.by_wave:
                codes[self._outside()] = DOMAIN
                if self.setup.by_impact:
                    codes[self.closing_speed <= 0.0] = NEVER_CLOSES
                return codes
            codes[2.0 * self.columns["sphere.radius"] > self.columns["bars.diameter"]] = DOMAIN
            codes[~self.pulse.valid] = DOMAIN
            if not self.infinite:
                too_long = self.pulse.end > self.round_trips[:, 0] * (1.0 + 1e-9)
                codes[(codes == 0) & too_long & (self.reflections[:, 0] != 0.0)] = TOO_LONG_PULSE
        return codes

    def _in_domain(self) -> Flags:
        """Rows whose numbers, scale factors and contact laws are valid, (n,)."""
        inside = np.ones(len(self), dtype=bool)
        for name, column in self.columns.items():
            if name.partition(".")[2] in _CHECKED_ONLY and self.contact_law == "hertz":
                continue
            allowed = np.asarray(INPUTS[name].allows(column))
            if name.endswith(("end_radius", "face_radius", "onset_pressure", "hardness")):
                allowed |= column == np.inf
            inside &= allowed
        scales = self.scales
        for number in (scales.mass_number, scales.force, scales.approach, scales.time):
            inside &= np.isfinite(number) & (number > 0.0)
        inside &= ~(scales.duration < _SHORTEST * scales.time)
        for partner in self.there:
            if partner.face is not None:
                inside &= partner.face.valid
        if any(partner.kind == "bar" for partner in self.there):
            brief = self.round_trips < _SHORTEST * scales.time[:, None]
            inside &= ~(brief & (self.reflections != 0.0)).any(axis=1)
        return inside

    def _outside(self) -> Flags:
        """Rows of a rig without a wave that are outside the domain of its equations, (n,)."""
        scales, (behind, ahead) = self.scales, self.partners
        rows = np.zeros(len(self), dtype=bool)
        for partner in self.there:
            if partner.kind == "plate" or (behind is None and partner.kind == "bar"):
                rows |= ~(scales.force / (partner.impedance * scales.speed) <= LARGEST_LAM)
        if behind is not None and ahead is not None:
            rows |= _beyond(ahead.hertz_constant / behind.hertz_constant, STIFFNESS_RATIO)
            if self.setup.weight_falls:
                rows |= _beyond(scales.mass / behind.mass, MASS_RATIO)
        if "platens.displacement" in self.columns:
            rows |= self.columns["platens.displacement"] >= self.columns["sphere.radius"]
        return rows


def _check_word(name: str, word: str, allowed: Collection[str]) -> None:
    """Raise ValueError for a word that is not allowed."""
    if word not in allowed:
        raise ValueError(f"unknown {name} {word!r} (allowed: {', '.join(allowed)})")


def _beyond(ratio: Array, bounds: tuple[float, float]) -> Flags:
    return ~((ratio >= bounds[0]) & (ratio <= bounds[1]))


def _partner(scene: Scene, table: str, kind: str) -> Partner:
    """The counter-body of a table, at rest; not finite in rows outside the domain."""
    c = scene.columns
    E, nu, density = (scene.column(f"{table}.{key}") for key in ("E", "nu", "density"))
    rigid, still = (np.broadcast_to(np.float64(value), len(scene)) for value in (np.inf, 0.0))
    impedance = mass = round_trip = rigid
    reflection = still
    ball = _ball_radius(scene, table)
    face_radius = scene.column(f"{table}.{'end' if table == 'bars' else 'face'}_radius", np.inf)
    with np.errstate(all="ignore"):
        modulus = contact.reduced_modulus(
            c["sphere.E"],
            c["sphere.nu"],
            c.get(f"{table}.insert_E", E),
            c.get(f"{table}.insert_nu", nu),
            rigid_bars=scene.rigid_contact,
        )
        radius = contact.effective_radius(c["sphere.radius"], face_radius if ball is None else ball)
        if kind == "bar":
            impedance = bars.impedance(E, density, scene.column(f"{table}.diameter"))
            # round trips and ends of the two Hopkinson bars differ: `Scene.partners`
            if f"{table}.length" in c:
                round_trip = bars.round_trip(c[f"{table}.length"], E, density)
                reflection = scene.column(f"{table}.end", bars.END_COEFFICIENTS["free"])
        elif kind == "plate":
            impedance = plate_impedance(E, nu, density, scene.column(f"{table}.thickness"))
        elif kind == "mass":
            mass = scene.column(f"{table}.mass")
            if ball is not None:
                mass = np.asarray(contact.sphere_mass(ball, density))
        face, takes = _law(scene, table, modulus, radius)
        return Partner(
            table=table,
            kind=kind,
            modulus=modulus,
            effective_radius=radius,
            hertz_constant=contact.hertz_constant(modulus, radius),
            share=np.asarray(modulus * (1.0 - np.square(c["sphere.nu"])) / c["sphere.E"]),
            impedance=impedance,
            mass=mass,
            speed=still,
            round_trip=round_trip,
            reflection=reflection,
            face=face,
            takes=still if takes is None else takes,
        )


def _ball_radius(scene: Scene, table: str) -> Array | None:
    """Radius of a counter-body that is a ball, (n,) [m]; None for another."""
    if table == "other":
        return scene.columns["other.radius"]
    if table == "hammer" and scene.options.get("hammer.shape") == "ball":
        return 0.5 * scene.columns["hammer.diameter"]
    return None


def _law(
    scene: Scene, table: str, modulus: Array, radius: Array
) -> tuple[Face, Array] | tuple[None, None]:
    """The contact law of a counter-body, if any row can yield, and the rows whose sphere yields."""
    if scene.contact_law != "plastic":
        return None, None
    c, rigid = scene.columns, scene.rigid_contact
    numbers = law_of(c, table, rigid=rigid, at_onset=scene.hardness_at_onset)
    if np.isinf(numbers.onset).all():
        return None, None
    sphere_yields = sphere_body(c).onset < body_of(c, table, rigid).onset
    face = Face(**numbers._asdict(), modulus=modulus, effective_radius=radius)
    return face, np.where(sphere_yields, 1.0, 0.0)

"""Batches of scenes: n rows of numbers in columns, with the scale factors that follow from them.

`INPUTS` declares every number that a scene can have.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places, Values
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.forms import FORMS, kinds_of, needs_of
from uqsphere.mechanics.integrator.tracked import NEVER_CLOSES
from uqsphere.mechanics.pulses import SHAPES, STRIKER_SHAPES, MeasuredPulse, Pulse, build_pulse
from uqsphere.mechanics.rigs import (
    DEFAULT_RIG,
    RIGS,
    Partner,
    Rig,
    closing_speed,
    outside,
    partners_of,
    speeds_at_touch,
)
from uqsphere.mechanics.yielding import Face
from uqsphere.units import Quantity

#: one degree of an angle [rad]
_DEGREE: Final = math.pi / 180.0
#: tables of counter-bodies -> index of their symbols, and name
_BODIES: Final = {
    "target": ("t", "target"),
    "anvil": ("a", "anvil"),
    "other": ("2", "other sphere"),
    "hammer": ("h", "drop weight"),
    "rod": ("r", "rod"),
    "platens": ("p", "platens"),
}


#: usual moduli [Pa] and Poisson ratios: of spheres and bars, and of bodies that may be rubber
_STIFF: Final = ((1e9, 6e11), (0.05, 0.45))
_ANY: Final = ((1e6, 1e12), (0.05, 0.5))


def _elastic(
    table: str, index: str, name: str, usual: tuple[tuple[float, float], ...] = _STIFF
) -> tuple[Quantity, ...]:
    """Young's modulus, Poisson ratio and density of a body."""
    of, (moduli, ratios) = f"_{index}" if index else "", usual
    return (
        Quantity(
            name=f"{table}.E",
            symbol=f"E{of}",
            dimension="pressure",
            display="GPa",
            plausible=moduli,
            meaning=f"Young's modulus of the {name}",
        ),
        Quantity(
            name=f"{table}.nu",
            symbol=f"nu{of}",
            dimension="number",
            lower=-1.0,
            upper=0.5,
            plausible=ratios,
            meaning=f"Poisson ratio of the {name}",
        ),
        Quantity(
            name=f"{table}.density",
            symbol=f"rho{of}",
            dimension="density",
            display="kg/m3",
            plausible=(500.0, 2e4),
            meaning=f"density of the {name}",
        ),
    )


def _law_of(table: str, index: str, name: str) -> tuple[Quantity, ...]:
    """The three parameters of a contact that yields."""
    of = f",{index}" if index else ""
    return (
        Quantity(
            name=f"{table}.onset_pressure",
            symbol=f"p_y{of}",
            dimension="pressure",
            display="GPa",
            plausible=(1e8, 2e10),
            meaning=(
                f"onset pressure of the {name}: peak Hertz pressure p_0 at the start of yield or "
                "crushing"
            ),
        ),
        Quantity(
            name=f"{table}.hardness",
            symbol=f"H_{index}" if index else "H",
            dimension="pressure",
            display="GPa",
            plausible=(1e8, 5e10),
            meaning=f"hardness of the {name}: mean contact pressure at full plasticity",
        ),
        Quantity(
            name=f"{table}.pile_up",
            symbol=f"C_{index}" if index else "C",
            dimension="number",
            lower=1.0,
            upper=3.0,
            closed=True,
            plausible=(1.0, 3.0),
            meaning=f"pile-up factor of the {name}: a²/(r alpha) far beyond yield",
        ),
    )


def _numbers_of(table: str) -> tuple[Quantity, ...]:
    """Material and contact parameters of a counter-body."""
    index, name = _BODIES[table]
    return (
        *_elastic(table, index, name, _ANY),
        Quantity(
            name=f"{table}.yield_strength",
            symbol=f"Y_{index}",
            dimension="pressure",
            display="MPa",
            plausible=(1e6, 1e10),
            meaning=f"yield strength of the {name}",
        ),
        *_law_of(table, index, name),
    )


def _struck(table: str) -> tuple[Quantity, ...]:
    """All numbers of a target or an anvil, whose shape depends on its kind."""
    index, name = _BODIES[table]
    return (
        *_numbers_of(table),
        Quantity(
            name=f"{table}.thickness",
            symbol=f"h_{index}",
            dimension="length",
            display="mm",
            plausible=(1e-4, 1.0),
            meaning=f"plate thickness of the {name}",
        ),
        Quantity(
            name=f"{table}.width",
            symbol=f"w_{index}",
            dimension="length",
            display="mm",
            plausible=(1e-2, 10.0),
            meaning=f"plate width of the {name}: for a validity check only",
        ),
        *_rod(table),
        _heavy(table),
        _rounded(table),
    )


def _rod(table: str) -> tuple[Quantity, ...]:
    index, name = _BODIES[table]
    return (
        Quantity(
            name=f"{table}.diameter",
            symbol=f"d_{index}",
            dimension="length",
            display="mm",
            plausible=(1e-3, 0.5),
            meaning=f"diameter of the {name}",
        ),
        Quantity(
            name=f"{table}.length",
            symbol=f"l_{index}",
            dimension="length",
            display="m",
            plausible=(0.05, 30.0),
            meaning=f"length of the {name}: infinite if omitted",
        ),
        Quantity(
            name=f"{table}.end",
            symbol=f"R_{index}",
            dimension="number",
            lower=-1.0,
            upper=1.0,
            closed=True,
            plausible=(-1.0, 1.0),
            meaning=f"velocity reflection coefficient of the {name}'s far end",
        ),
    )


def _heavy(table: str) -> Quantity:
    index, name = _BODIES[table]
    return Quantity(
        name=f"{table}.mass",
        symbol=f"m_{index}",
        dimension="mass",
        display="kg",
        lower=1e-6,
        upper=1e5,
        closed=True,
        plausible=(1e-3, 1e4),
        meaning=f"mass of the {name}",
    )


def _rounded(table: str) -> Quantity:
    index, name = _BODIES[table]
    return Quantity(
        name=f"{table}.face_radius",
        symbol=f"R_f,{index}",
        dimension="length",
        display="mm",
        plausible=(1e-3, 1e3),
        meaning=f"face radius of the {name}: flat if omitted",
    )


def _moving(table: str, symbol: str, meaning: str) -> tuple[Quantity, ...]:
    """An impact speed, or a drop height."""
    return (
        Quantity(
            name=f"{table}.speed",
            symbol=symbol,
            dimension="speed",
            display="m/s",
            lower=1e-3,
            upper=300.0,
            closed=True,
            plausible=(1e-2, 150.0),
            meaning=meaning,
        ),
        Quantity(
            name=f"{table}.drop_height",
            symbol="h_drop",
            dimension="length",
            display="m",
            lower=1e-6,
            upper=1e3,
            closed=True,
            plausible=(1e-3, 100.0),
            meaning="drop height",
        ),
    )


#: every number of a scene, fixed or random, by its dotted path in the study file
INPUTS: Final[dict[str, Quantity]] = {
    entry.name: entry
    for entry in (
        *_elastic("sphere", "", "sphere"),
        Quantity(
            name="sphere.radius",
            symbol="r",
            dimension="length",
            display="mm",
            plausible=(1e-4, 0.1),
            meaning="radius of the sphere",
        ),
        *_law_of("sphere", "", "sphere")[:2],
        *_elastic("bars", "b", "bars"),
        Quantity(
            name="bars.diameter",
            symbol="d_b",
            dimension="length",
            display="mm",
            plausible=(1e-3, 0.2),
            meaning="diameter of both bars",
        ),
        Quantity(
            name="bars.incident_length",
            symbol="l_1",
            dimension="length",
            display="m",
            plausible=(0.05, 30.0),
            meaning="length of the incident bar",
        ),
        Quantity(
            name="bars.receiving_length",
            symbol="l_3",
            dimension="length",
            display="m",
            plausible=(0.05, 30.0),
            meaning="length of the receiving bar",
        ),
        Quantity(
            name="bars.incident_end",
            symbol="R_1",
            dimension="number",
            lower=-1.0,
            upper=1.0,
            closed=True,
            plausible=(-1.0, 1.0),
            meaning="velocity reflection coefficient of the incident bar's far end",
        ),
        Quantity(
            name="bars.receiving_end",
            symbol="R_3",
            dimension="number",
            lower=-1.0,
            upper=1.0,
            closed=True,
            plausible=(-1.0, 1.0),
            meaning="velocity reflection coefficient of the receiving bar's far end",
        ),
        Quantity(
            name="bars.end_radius",
            symbol="r_end",
            dimension="length",
            display="mm",
            plausible=(1e-3, 1e3),
            meaning="radius of rounded bar ends: flat if omitted",
        ),
        Quantity(
            name="bars.yield_strength",
            symbol="Y_b",
            dimension="pressure",
            display="MPa",
            plausible=(1e7, 5e9),
            meaning="yield strength of the bars",
        ),
        Quantity(
            name="bars.insert_E",
            symbol="E_i",
            dimension="pressure",
            display="GPa",
            plausible=(1e9, 1.2e12),
            meaning="Young's modulus of inserts between bars and sphere",
        ),
        Quantity(
            name="bars.insert_nu",
            symbol="nu_i",
            dimension="number",
            lower=-1.0,
            upper=0.5,
            plausible=(0.05, 0.45),
            meaning="Poisson ratio of the inserts",
        ),
        Quantity(
            name="bars.insert_yield_strength",
            symbol="Y_i",
            dimension="pressure",
            display="MPa",
            plausible=(1e7, 1e10),
            meaning="yield strength of the inserts",
        ),
        Quantity(
            name="bars.insert_thickness",
            symbol="t_i",
            dimension="length",
            display="mm",
            plausible=(1e-4, 0.2),
            meaning="thickness of the inserts",
        ),
        *_law_of("bars", "b", "bars"),
        Quantity(
            name="striker.speed",
            symbol="v_0",
            dimension="speed",
            display="m/s",
            plausible=(1e-3, 50.0),
            meaning="striker speed",
        ),
        Quantity(
            name="striker.length",
            symbol="l_0",
            dimension="length",
            display="m",
            plausible=(0.01, 5.0),
            meaning="striker length",
        ),
        Quantity(
            name="striker.E",
            symbol="E_s",
            dimension="pressure",
            display="GPa",
            plausible=(1e9, 6e11),
            meaning="Young's modulus of the striker: the bars' if omitted",
        ),
        Quantity(
            name="striker.density",
            symbol="rho_s",
            dimension="density",
            display="kg/m3",
            plausible=(500.0, 2e4),
            meaning="density of the striker: the bars' if omitted",
        ),
        Quantity(
            name="striker.diameter",
            symbol="d_s",
            dimension="length",
            display="mm",
            plausible=(1e-3, 0.2),
            meaning="diameter of the striker: the bars' if omitted",
        ),
        Quantity(
            name="pulse.duration",
            symbol="t_i",
            dimension="time",
            display="us",
            plausible=(1e-6, 1e-2),
            meaning="duration of the pulse: at half height for a trapezoid",
        ),
        Quantity(
            name="pulse.rise",
            symbol="t_rise",
            dimension="time",
            display="us",
            closed=True,
            plausible=(0.0, 1e-3),
            meaning="rise time of a trapezoidal pulse",
        ),
        Quantity(
            name="pulse.fall",
            symbol="t_fall",
            dimension="time",
            display="us",
            closed=True,
            plausible=(0.0, 1e-3),
            meaning="fall time of a trapezoidal pulse",
        ),
        Quantity(
            name="pulse.t1",
            symbol="t_1",
            dimension="time",
            display="us",
            plausible=(1e-6, 1e-2),
            meaning="time of the first peak of a two-peak pulse",
        ),
        Quantity(
            name="pulse.level1",
            symbol="g_1",
            dimension="number",
            plausible=(0.1, 2.0),
            meaning="level of the first peak, relative to v_0/2",
        ),
        Quantity(
            name="pulse.t2",
            symbol="t_2",
            dimension="time",
            display="us",
            plausible=(1e-6, 1e-2),
            meaning="time of the second peak of a two-peak pulse",
        ),
        Quantity(
            name="pulse.level2",
            symbol="g_2",
            dimension="number",
            plausible=(0.1, 2.0),
            meaning="level of the second peak, relative to v_0/2",
        ),
        Quantity(
            name="pulse.valley",
            symbol="g_v",
            dimension="number",
            plausible=(0.0, 2.0),
            closed=True,
            meaning="level midway between the peaks of a two-peak pulse",
        ),
        Quantity(
            name="pulse.gain",
            symbol="G",
            dimension="number",
            plausible=(0.5, 2.0),
            meaning="gain of a measured pulse: true over measured strain",
        ),
        *_law_of("contact", "", "softer body of a contact"),
        *_moving("rig", "v", "closing speed"),
        Quantity(
            name="rig.angle",
            symbol="phi",
            dimension="angle",
            display="deg",
            lower=5.0 * _DEGREE,
            upper=90.0 * _DEGREE,
            closed=True,
            plausible=(20.0 * _DEGREE, 90.0 * _DEGREE),
            meaning="impact angle from the surface: 90 deg is normal impact",
        ),
        *_struck("target"),
        *_struck("anvil"),
        *_numbers_of("other"),
        Quantity(
            name="other.radius",
            symbol="r_2",
            dimension="length",
            display="mm",
            plausible=(1e-4, 0.1),
            meaning="radius of the other sphere",
        ),
        *_moving("hammer", "v_h", "impact speed of the drop weight"),
        *_numbers_of("hammer"),
        _heavy("hammer"),
        Quantity(
            name="hammer.diameter",
            symbol="d_h",
            dimension="length",
            display="mm",
            plausible=(1e-3, 0.5),
            meaning="diameter of the falling ball",
        ),
        _rounded("hammer"),
        *_numbers_of("rod"),
        *_rod("rod"),
        *_numbers_of("platens"),
        Quantity(
            name="platens.force",
            symbol="F",
            dimension="force",
            display="kN",
            plausible=(1.0, 1e6),
            meaning="maximum force of the platens",
        ),
        Quantity(
            name="platens.displacement",
            symbol="delta",
            dimension="length",
            display="um",
            plausible=(1e-6, 1e-2),
            meaning="crosshead displacement after first contact: alternative to the force",
        ),
        Quantity(
            name="platens.speed",
            symbol="v_p",
            dimension="speed",
            display="mm/s",
            plausible=(1e-8, 1.0),
            meaning="closing speed of the platens",
        ),
        Quantity(
            name="platens.loading_rate",
            symbol="dF/dt",
            dimension="loading_rate",
            display="kN/s",
            plausible=(1.0, 1e7),
            meaning="loading rate at the maximum force: alternative to the speed",
        ),
        Quantity(
            name="platens.machine_stiffness",
            symbol="k",
            dimension="stiffness",
            display="kN/mm",
            plausible=(1e5, 1e10),
            meaning="stiffness of the testing machine: rigid if omitted",
        ),
    )
}

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
class Scene:
    """n scenes that share their structure and differ in their numbers.

    columns: (n,) arrays [SI] by their dotted path in `INPUTS`.  shape: of the incident pulse, a key
    of `pulses.SHAPES` or `measured`.  infinite: without reflected waves.  rigid_contact: the bars
    are rigid in the contact, 1/E* = (1 - nu²)/E.  first_loading_only: the evaluation window ends
    when the first reflected wave returns.  whole_record: between bars it extends to the horizon,
    recontacts included.  horizon: its end [s]; None: the rule of docs/theory.md.  contact_law:
    `hertz` or `plastic`.  hardness_at_onset: the hardness equals the onset pressure in every row
    (Thornton's law).  record: the pulse of `measured`, the same in every row except for its gain;
    `striker.speed` is then 2 c0 times its peak strain and gain.  rig: a key of `rigs.RIGS`; shape,
    infinite, first_loading_only and record belong to rigs loaded by a wave.  options: words of the
    study, ``target.kind``, ``anvil.kind``, ``hammer.shape``.  demands: further quantities, name ->
    criterion and its parameters.

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

    @property
    def setup(self) -> Rig:
        """The entry of its rig in `rigs.RIGS`."""
        return RIGS[self.rig]

    @property
    def by_wave(self) -> bool:
        """Whether a stress wave loads the sphere, between bars."""
        return RIGS[self.rig].by_wave

    def at(self, rows: Places | slice) -> Scene:
        """The scene of some of its rows."""
        return replace(self, columns={name: column[rows] for name, column in self.columns.items()})

    def column(self, name: str, default: Values = np.nan) -> Array:
        """A column, or `default` in every row."""
        column = self.columns.get(name)
        if column is None:
            return np.full(len(self), default)
        return np.asarray(column, dtype=float)

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
        return build_pulse(self.shape, self.scales.duration, numbers)

    @cached_property
    def striker_ratio(self) -> Array | None:
        """Impedance ratio of striker and bars, (n,); None for a striker of the bars' kind."""
        if STRIKER_COLUMNS.isdisjoint(self.columns):
            return None
        with np.errstate(all="ignore"):
            diameter = self.columns.get("striker.diameter", self.columns["bars.diameter"])
            return np.asarray(bars.impedance(*self._striker, diameter) / self.scales.impedance)

    @property
    def _striker(self) -> tuple[Array, Array]:
        """E and density of the striker, (n,) each: the bars' if omitted."""
        columns = self.columns
        E = columns.get("striker.E", columns["bars.E"])
        density = columns.get("striker.density", columns["bars.density"])
        return E, density

    @cached_property
    def round_trips(self) -> Array:
        """Round trips of the bars at A and B, (n, 2) [s]; infinite without a bar, or its length."""
        if not self.by_wave:
            trips = np.full((len(self), 2), np.inf)
            for pole, partner in enumerate(self.partners):
                if partner is not None:
                    trips[:, pole] = partner.round_trip
            return trips
        E, density = self.columns["bars.E"], self.columns["bars.density"]
        lengths = [self.column(f"bars.{bar}_length", np.inf) for bar in ("incident", "receiving")]
        with np.errstate(all="ignore"):
            return np.stack([bars.round_trip(length, E, density) for length in lengths], axis=1)

    @cached_property
    def reflections(self) -> Array:
        """Velocity reflection coefficients of the far ends, (n, 2); 0 without a reflected wave."""
        if not self.by_wave:
            reflections = np.zeros((len(self), 2))
            for pole, partner in enumerate(self.partners):
                if partner is not None:
                    reflections[:, pole] = partner.reflection
            return reflections
        if self.infinite:
            return np.zeros((len(self), 2))
        return np.stack(
            [
                self.column("bars.incident_end", bars.END_COEFFICIENTS["free"]),
                self.column("bars.receiving_end", bars.END_COEFFICIENTS["absorbing"]),
            ],
            axis=1,
        )

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

    @cached_property
    def partners(self) -> tuple[Partner | None, Partner | None]:
        """Counter-bodies at contact A (behind the sphere) and B (ahead), None without a contact."""
        return partners_of(self)

    @property
    def there(self) -> tuple[Partner, ...]:
        """The counter-bodies, A first."""
        return tuple(partner for partner in self.partners if partner is not None)

    @property
    def contacts(self) -> int:
        """Number of contacts of the sphere."""
        return self.setup.contacts

    @property
    def struck(self) -> Partner:
        """The counter-body whose contact gives the scale factors: A, or B if there is no A."""
        return self.there[0]

    @cached_property
    def closing_speed(self) -> Array:
        """Normal closing speed of an impact, (n,) [m/s]."""
        return closing_speed(self)

    @cached_property
    def start(self) -> Array:
        """Speeds of sphere and counter-bodies A, B at first touch, (n, 3) [m/s], from A to B."""
        return speeds_at_touch(self)

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

    @property
    def _duration(self) -> Array:
        """Length of the pulse, (n,) [s]; infinite for a step, and without a wave."""
        if not self.by_wave or self.shape == "step":
            return np.full(len(self), np.inf)
        if self.record is not None:
            return np.full(len(self), self.record.duration)
        with np.errstate(all="ignore"):
            width = 2.0 * self.column("striker.length") / bars.wave_speed(*self._striker)
        return self.columns.get("pulse.duration", np.asarray(width))

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

    @property
    def faces(self) -> Face | None:
        """The contact law of `struck` (of both bars), (n,) each; None if elastic."""
        return self.struck.face

    @cached_property
    def status(self) -> Places:
        """Status of every row before the integration, (n,): see `STATUS`."""
        codes = np.zeros(len(self), dtype=np.int64)
        with np.errstate(all="ignore"):
            codes[~self._in_domain()] = 1
            if not self.by_wave:
                codes[outside(self)] = 1
                if self.setup.by_impact:
                    codes[self.closing_speed <= 0.0] = NEVER_CLOSES
                return codes
            codes[2.0 * self.columns["sphere.radius"] > self.columns["bars.diameter"]] = 1
            codes[~self.pulse.valid] = 1
            if not self.infinite:
                too_long = self.pulse.end > self.round_trips[:, 0] * (1.0 + 1e-9)
                codes[(codes == 0) & too_long & (self.reflections[:, 0] != 0.0)] = 2
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


def _check_word(name: str, word: str, allowed: Collection[str]) -> None:
    """Raise ValueError for a word that is not allowed."""
    if word not in allowed:
        raise ValueError(f"unknown {name} {word!r} (allowed: {', '.join(allowed)})")

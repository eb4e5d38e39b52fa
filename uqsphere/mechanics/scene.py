"""A batch of scenes: sphere, bars, striker and pulse in columns of n rows, and the scales that
follow from them.

`INPUTS` declares every number that a scene can have.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
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
#: tables of partners -> what their symbols have as index, and what they are called
_BODIES: Final = {
    "target": ("t", "target"),
    "anvil": ("a", "anvil"),
    "other": ("2", "other sphere"),
    "hammer": ("h", "weight"),
    "rod": ("r", "rod"),
    "platens": ("p", "platens"),
}


#: usual moduli [Pa] and Poisson ratios of spheres and bars, and of what may be rubber
_STIFF: Final = ((1e9, 6e11), (0.05, 0.45))
_ANY: Final = ((1e6, 1e12), (0.05, 0.5))


def _elastic(
    table: str, index: str, name: str, usual: tuple[tuple[float, float], ...] = _STIFF
) -> tuple[Quantity, ...]:
    """E, nu and density of a body."""
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
    """The three numbers of a face that yields."""
    of = f",{index}" if index else ""
    return (
        Quantity(
            name=f"{table}.onset_pressure",
            symbol=f"p_y{of}",
            dimension="pressure",
            display="GPa",
            plausible=(1e8, 2e10),
            meaning=f"centre pressure at which the {name} begins to yield or to crush",
        ),
        Quantity(
            name=f"{table}.hardness",
            symbol=f"H_{index}" if index else "H",
            dimension="pressure",
            display="GPa",
            plausible=(1e8, 5e10),
            meaning=f"mean pressure of the {name} that flows fully (its hardness)",
        ),
        Quantity(
            name=f"{table}.pile_up",
            symbol=f"C_{index}" if index else "C",
            dimension="number",
            lower=1.0,
            upper=3.0,
            closed=True,
            plausible=(1.0, 3.0),
            meaning=f"pile-up of the {name}: a²/(r alpha) far beyond yield",
        ),
    )


def _numbers_of(table: str) -> tuple[Quantity, ...]:
    """What every partner of a rig can have: its material, and the law of its face."""
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
    """What a target or an anvil can have beside: its shape, by its kind."""
    index, name = _BODIES[table]
    return (
        *_numbers_of(table),
        Quantity(
            name=f"{table}.thickness",
            symbol=f"h_{index}",
            dimension="length",
            display="mm",
            plausible=(1e-4, 1.0),
            meaning=f"thickness of the {name}, a plate",
        ),
        Quantity(
            name=f"{table}.width",
            symbol=f"w_{index}",
            dimension="length",
            display="mm",
            plausible=(1e-2, 10.0),
            meaning=f"width of the {name}, a plate (for a check only)",
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
            meaning=f"length of the {name}, a bar (absent: nothing comes back)",
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
        meaning=f"radius of the {name}'s rounded face (flat: absent)",
    )


def _moving(table: str, symbol: str, meaning: str) -> tuple[Quantity, ...]:
    """A speed, or the height of a fall."""
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
            meaning="height of the fall",
        ),
    )


#: Every number of a scene that a study can fix or scatter, by its dotted path in the study file.
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
            meaning="radius of rounded bar ends (flat ends: absent)",
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
        *_law_of("bars", "b", "bars' faces"),
        Quantity(
            name="striker.speed",
            symbol="v_0",
            dimension="speed",
            display="m/s",
            plausible=(1e-3, 50.0),
            meaning="speed of the striker",
        ),
        Quantity(
            name="striker.length",
            symbol="l_0",
            dimension="length",
            display="m",
            plausible=(0.01, 5.0),
            meaning="length of the striker",
        ),
        Quantity(
            name="striker.E",
            symbol="E_s",
            dimension="pressure",
            display="GPa",
            plausible=(1e9, 6e11),
            meaning="Young's modulus of the striker (absent: that of the bars)",
        ),
        Quantity(
            name="striker.density",
            symbol="rho_s",
            dimension="density",
            display="kg/m3",
            plausible=(500.0, 2e4),
            meaning="density of the striker (absent: that of the bars)",
        ),
        Quantity(
            name="striker.diameter",
            symbol="d_s",
            dimension="length",
            display="mm",
            plausible=(1e-3, 0.2),
            meaning="diameter of the striker (absent: that of the bars)",
        ),
        Quantity(
            name="pulse.duration",
            symbol="t_i",
            dimension="time",
            display="us",
            plausible=(1e-6, 1e-2),
            meaning="duration of the pulse (at half height for a trapezoid)",
        ),
        Quantity(
            name="pulse.rise",
            symbol="t_rise",
            dimension="time",
            display="us",
            closed=True,
            plausible=(0.0, 1e-3),
            meaning="rise of a trapezoidal pulse",
        ),
        Quantity(
            name="pulse.fall",
            symbol="t_fall",
            dimension="time",
            display="us",
            closed=True,
            plausible=(0.0, 1e-3),
            meaning="fall of a trapezoidal pulse",
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
            meaning="level of the first peak over v_0/2",
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
            meaning="level of the second peak over v_0/2",
        ),
        Quantity(
            name="pulse.valley",
            symbol="g_v",
            dimension="number",
            plausible=(0.0, 2.0),
            closed=True,
            meaning="level half-way between the peaks of a two-peak pulse",
        ),
        Quantity(
            name="pulse.gain",
            symbol="G",
            dimension="number",
            plausible=(0.5, 2.0),
            meaning="true strain over that of a measured pulse",
        ),
        *_law_of("contact", "", "softer face"),
        *_moving("rig", "v", "speed at which the bodies close"),
        Quantity(
            name="rig.angle",
            symbol="phi",
            dimension="angle",
            display="deg",
            lower=5.0 * _DEGREE,
            upper=90.0 * _DEGREE,
            closed=True,
            plausible=(20.0 * _DEGREE, 90.0 * _DEGREE),
            meaning="angle between the path and the surface, 90 deg: square on",
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
        *_moving("hammer", "v_h", "speed of the weight"),
        *_numbers_of("hammer"),
        _heavy("hammer"),
        Quantity(
            name="hammer.diameter",
            symbol="d_h",
            dimension="length",
            display="mm",
            plausible=(1e-3, 0.5),
            meaning="diameter of a ball that falls",
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
            meaning="force up to which the platens press",
        ),
        Quantity(
            name="platens.displacement",
            symbol="delta",
            dimension="length",
            display="um",
            plausible=(1e-6, 1e-2),
            meaning="way of the crosshead from first touch, in place of the force",
        ),
        Quantity(
            name="platens.speed",
            symbol="v_p",
            dimension="speed",
            display="mm/s",
            plausible=(1e-8, 1.0),
            meaning="speed at which the platens close",
        ),
        Quantity(
            name="platens.loading_rate",
            symbol="dF/dt",
            dimension="loading_rate",
            display="kN/s",
            plausible=(1.0, 1e7),
            meaning="rate of the force at its end, in place of the speed",
        ),
        Quantity(
            name="platens.machine_stiffness",
            symbol="k",
            dimension="stiffness",
            display="kN/mm",
            plausible=(1e5, 1e10),
            meaning="stiffness of the machine (absent: rigid)",
        ),
    )
}

#: what the status of a row means; only rows of 0 have numbers
STATUS: dict[int, str] = {
    0: "ok",
    1: "outside the domain of the model (a size, modulus, ratio or pulse without meaning, a "
    "sphere wider than its bar, "
    "a contact wider than its rod, a plate that is punched, a face whose hardness is below its "
    "onset)",
    2: "the pulse is longer than the round trip of the incident bar, so the striker is still on it",
    3: "the integrator could not reach the tolerance",
    4: "too many reflections before the end of the record",
    5: "too many steps before the end of the record",
    6: "the answer is not finite",
    11: "the bodies never close: a speed that is not positive",
    12: "the record ended while the bodies were still pressed: give a later horizon",
}
#: shortest pulse and round trip over t_c: a double tells times of the record apart to 1e-16 of it
_SHORTEST: Final = 1e-9


def answered(status: Places) -> Flags:
    """Whether rows have numbers that may be used, (n,)."""
    return np.asarray(status == 0)


#: last parts of columns that serve validity checks only, where nothing yields
_CHECKED_ONLY: Final = (
    "yield_strength",
    "insert_yield_strength",
    "insert_thickness",
    "width",
    "onset_pressure",
    "hardness",
    "pile_up",
)
#: what makes a striker another bar than the others
STRIKER_COLUMNS: Final = frozenset({"striker.E", "striker.density", "striker.diameter"})


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scale factors and similarity numbers of n rows, theory (8) and (10), (R4) to (R6); SI.

    `modulus`, `effective_radius` and `hertz_constant` are those of the face that is struck first, A
    if both are.
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

    columns: (n,) arrays [SI] by their dotted path in `INPUTS`.  shape: of the incident pulse, of
    `pulses.SHAPES` or `measured`.  infinite: no wave comes back from the far ends.  rigid_contact:
    the bars do not yield in the contact, 1/E* = (1 - nu²)/E.  first_loading_only: the record ends
    when the first reflected wave returns; whole_record: that of bars goes on after the first loss
    of contact, to the horizon, contacts regained included.  horizon: its end [s]; None: the rule of
    docs/theory.md.  demands: further quantities, name -> criterion and its parameters.
    hardness_at_onset: the hardness is the onset, row by row (Thornton's law).  record: the pulse of
    `measured`, the same in every row but for its gain; `striker.speed` is then 2 c0 times its peak
    strain and gain.  rig: of `rigs.RIGS`; shape, infinite, first_loading_only and record belong to
    `bars`.  options: words of the study, ``target.kind``, ``anvil.kind``, ``hammer.shape``.
    ValueError for a missing or misshapen column, an unknown word, or a record without an end.
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
        words = (
            ("rig", self.rig, RIGS),
            ("pulse shape", self.shape, SHAPES | {"measured": None}),
            ("contact law", self.contact_law, FORMS["contact"]),
        )
        for what, found, allowed in words:
            if found not in allowed:
                raise ValueError(f"unknown {what} {found!r} (allowed: {', '.join(allowed)})")
        if missing := self._absent:
            raise ValueError(f"the scene lacks {', '.join(missing)}")
        if unknown := [name for name in self.columns if name not in INPUTS]:
            raise ValueError(f"unknown numbers of a scene: {', '.join(unknown)}")
        for contradicts, why in _CONTRADICTIONS:
            if contradicts(self):
                raise ValueError(why.format(self))
        rows = {np.shape(column) for column in self.columns.values()}
        if len(rows) != 1 or len(next(iter(rows))) != 1:
            raise ValueError(f"every column must have shape (n,), found {sorted(map(str, rows))}")

    @property
    def _absent(self) -> list[str]:
        """Columns without which there is no such scene."""
        kinds = kinds_of(
            self.rig,
            self.shape,
            timed="pulse.duration" in self.columns,
            infinite=self.infinite,
            options=self.options,
        )
        tables = ["sphere", *self.setup.tables, "rig"]
        needs = [
            (table, need)
            for table in tables
            for need in needs_of(FORMS[table].get(kinds.get(table, ""), ""))
        ]
        return [
            f"{table}.{need[0]}"
            for table, need in needs
            if not any(f"{table}.{key}" in self.columns for key in need)
        ]

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
        found = self.columns.get(name)
        return np.full(len(self), default) if found is None else np.asarray(found, dtype=float)

    @cached_property
    def pulse(self) -> Pulse:
        """The incident pulse of every row, times in seconds; one that is nothing where no wave
        comes in.
        """
        if not self.by_wave:
            none = np.zeros(len(self))
            return Pulse(
                breaks=np.zeros((len(self), 2)),
                coefficients=np.zeros((len(self), 1, 4)),
                frequency=none,
                valid=none == 0.0,
            )
        if self.record is not None:
            return self.record.pulse(len(self))
        numbers = {
            name.removeprefix("pulse."): column
            for name, column in self.columns.items()
            if name.startswith("pulse.") and name != "pulse.duration"
        }
        if (ratio := self.striker_ratio) is not None:
            numbers["striker_ratio"] = ratio
        return build_pulse(self.shape, self.scales.duration, numbers)

    @cached_property
    def striker_ratio(self) -> Array | None:
        """Impedance of the striker over that of the bars, (n,); None for a striker like the
        bars.
        """
        if STRIKER_COLUMNS.isdisjoint(self.columns):
            return None
        with np.errstate(all="ignore"):
            diameter = self.columns.get("striker.diameter", self.columns["bars.diameter"])
            return np.asarray(bars.impedance(*self._striker, diameter) / self.scales.impedance)

    @property
    def _striker(self) -> tuple[Array, Array]:
        """E and density of the striker, (n,) each: the bars' where it has none of its own."""
        own = [
            self.columns.get(f"striker.{key}", self.columns[f"bars.{key}"])
            for key in ("E", "density")
        ]
        return own[0], own[1]

    @cached_property
    def round_trips(self) -> Array:
        """Round trips of the bars at A and B, (n, 2) [s]; infinite where there is no bar, or one
        without length.
        """
        if not self.by_wave:
            none = np.full(len(self), np.inf)
            return np.stack(
                [none if one is None else one.round_trip for one in self.partners], axis=1
            )
        E, density = self.columns["bars.E"], self.columns["bars.density"]
        lengths = [self.column(f"bars.{bar}_length", np.inf) for bar in ("incident", "receiving")]
        with np.errstate(all="ignore"):
            return np.stack([bars.round_trip(length, E, density) for length in lengths], axis=1)

    @cached_property
    def reflections(self) -> Array:
        """Velocity reflection coefficients of the far ends, (n, 2); 0 where nothing comes back."""
        if not self.by_wave:
            none = np.zeros(len(self))
            return np.stack(
                [none if one is None else one.reflection for one in self.partners], axis=1
            )
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
        """Time at which the first reflected wave returns to the sphere, (n,) [s]; infinite if none
        does.
        """
        return np.asarray(np.where(self.reflections != 0.0, self.round_trips, np.inf).min(axis=1))

    @cached_property
    def record_end(self) -> Array:
        """End of the record, (n,) [s]; infinite where the rule of infinite bars, or parting, ends
        it.
        """
        if self.horizon is not None:
            ends = np.full(len(self), self.horizon)
        elif self.infinite or not self.by_wave:
            ends = np.full(len(self), np.inf)
        else:
            ends = 8.0 * self.round_trips.max(axis=1)
        return np.minimum(ends, self.first_echo) if self.first_loading_only else ends

    @cached_property
    def partners(self) -> tuple[Partner | None, Partner | None]:
        """What stands behind the sphere (pole A) and ahead of it (B); None: nothing."""
        return partners_of(self)

    @property
    def there(self) -> tuple[Partner, ...]:
        """The partners that there are, A first."""
        return tuple(one for one in self.partners if one is not None)

    @property
    def contacts(self) -> int:
        """Faces at which the sphere is pressed."""
        return self.setup.contacts

    @property
    def struck(self) -> Partner:
        """The partner whose face the scale factors are those of: the one that is struck first, A if
        both are.
        """
        return self.there[0]

    @cached_property
    def closing_speed(self) -> Array:
        """Speed at which the bodies of a blow meet, square to the face, (n,) [m/s]."""
        return closing_speed(self)

    @cached_property
    def start(self) -> Array:
        """Speeds of sphere and partners A and B at first touch, (n, 3) [m/s], positive from A to
        B.
        """
        return speeds_at_touch(self)

    @cached_property
    def scales(self) -> Scales:
        """Scale factors of every row; not finite where a row has no meaning."""
        c, face = self.columns, self.struck
        with np.errstate(all="ignore"):
            mass = contact.sphere_mass(c["sphere.radius"], c["sphere.density"])
            impedance = (self.partners[1] or face).impedance
            if self.by_wave:
                speed = 0.5 * c["striker.speed"]
                force = impedance * speed
            else:
                speed, force = self._blow(mass)
            approach = contact.approach_at_force(force, face.hertz_constant)
            time = approach / speed
            momentum = impedance * time if self.by_wave else force * time
            return Scales(
                modulus=face.modulus,
                effective_radius=face.effective_radius,
                hertz_constant=face.hertz_constant,
                mass=mass,
                impedance=impedance,
                force=force,
                approach=approach,
                time=time,
                mass_number=(mass if self.by_wave else mass * speed) / momentum,
                duration=self._duration,
                speed=speed,
            )

    @property
    def _duration(self) -> Array:
        """Length of the pulse, (n,) [s]; infinite for a step, and where no wave comes in."""
        if not self.by_wave or self.shape == "step":
            return np.full(len(self), np.inf)
        if self.record is not None:
            return np.full(len(self), self.record.duration)
        with np.errstate(all="ignore"):
            width = 2.0 * self.column("striker.length") / bars.wave_speed(*self._striker)
        return self.columns.get("pulse.duration", np.asarray(width))

    def _blow(self, mass: Array) -> tuple[Array, Array]:
        """V_c and P_c = beta^0.4 m^0.6 V_c^1.2, (R5), m the reduced mass of the sphere, or the
        weight's; of platens 1, and a force of theirs."""
        face, behind, beta = self.struck, self.partners[0], self.struck.hertz_constant
        if self.setup.by_press:
            return np.ones(len(self)), beta * self.columns["sphere.radius"] ** 1.5
        speed = self.closing_speed
        moved = mass / (1.0 + mass / face.mass) if behind is None else behind.mass
        # one root for the three powers: m³ v⁶ beta²
        impulse = moved * speed * speed
        return speed, (beta * beta * impulse * impulse * impulse) ** 0.2

    @property
    def faces(self) -> Face | None:
        """The law of the face that is struck first, of both of `bars`, where it yields, (n,) each;
        None: elastic.
        """
        return self.struck.face

    @cached_property
    def status(self) -> Places:
        """Status of every row before anything is integrated, (n,): see `STATUS`."""
        codes = np.zeros(len(self), dtype=np.int64)
        for name, column in self.columns.items():
            if name.partition(".")[2] in _CHECKED_ONLY and self.contact_law == "hertz":
                continue
            inside = np.asarray(INPUTS[name].allows(column))
            if name.endswith(("end_radius", "face_radius", "onset_pressure", "hardness")):
                inside |= column == np.inf
            codes[~inside] = 1
        with np.errstate(all="ignore"):
            scales = self.scales
            for number in (scales.mass_number, scales.force, scales.approach, scales.time):
                codes[~(np.isfinite(number) & (number > 0.0))] = 1
            # what is shorter than this beside t_c is lost in the rounding of the times
            codes[scales.duration < _SHORTEST * scales.time] = 1
            for face in (one.face for one in self.there if one.face is not None):
                codes[~face.valid] = 1
            if any(one.kind == "bar" for one in self.there):
                brief = (self.round_trips < _SHORTEST * scales.time[:, None]) & (
                    self.reflections != 0.0
                )
                codes[brief.any(axis=1)] = 1
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


#: what the words of a scene and its columns may not be together, and why
_CONTRADICTIONS: Final[tuple[tuple[Callable[[Scene], bool], str], ...]] = (
    (
        lambda s: (s.shape == "measured") != (s.record is not None),
        "a record belongs to the shape 'measured', and that shape needs one",
    ),
    (
        lambda s: s.shape not in STRIKER_SHAPES and not STRIKER_COLUMNS.isdisjoint(s.columns),
        "a {0.shape} pulse does not follow from the striker's material or diameter",
    ),
    (
        lambda s: s.by_wave and s.shape == "step" and s.horizon is None and s.infinite,
        "a step pulse never ends: the record needs a horizon",
    ),
    (
        lambda s: s.horizon is not None and not 0.0 < s.horizon < np.inf,
        "the horizon must be positive and finite, found {0.horizon!r} s",
    ),
)

"""A batch of scenes: sphere, bars, striker and pulse in columns of n rows, and the scales that follow from them.

`INPUTS` declares every number that a scene can have.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from uqsphere.arrays import Array, Flags, Places
from uqsphere.mechanics import bars, contact
from uqsphere.mechanics.pulses import (
    PARAMETERS,
    SHAPES,
    STRIKER_SHAPES,
    MeasuredPulse,
    Pulse,
    build_pulse,
    noise_names,
)
from uqsphere.mechanics.yielding import CAP_PILE_UP, Body, Face, metal_body, softer
from uqsphere.units import Quantity

#: Every number of a scene that a study can fix or scatter, by its dotted path in the study file.
INPUTS: Final[dict[str, Quantity]] = {entry.name: entry for entry in (
    Quantity(name="sphere.E", symbol="E", dimension="pressure", display="GPa", plausible=(1e9, 6e11),
             meaning="Young's modulus of the sphere"),
    Quantity(name="sphere.nu", symbol="nu", dimension="number", lower=-1.0, upper=0.5, plausible=(0.05, 0.45),
             meaning="Poisson ratio of the sphere"),
    Quantity(name="sphere.radius", symbol="r", dimension="length", display="mm", plausible=(1e-4, 0.1),
             meaning="radius of the sphere"),
    Quantity(name="sphere.density", symbol="rho", dimension="density", display="kg/m3", plausible=(500.0, 2e4),
             meaning="density of the sphere"),
    Quantity(name="sphere.onset_pressure", symbol="p_y", dimension="pressure", display="GPa", plausible=(1e8, 2e10),
             meaning="contact pressure at which the sphere begins to yield or to crush"),
    Quantity(name="sphere.hardness", symbol="H", dimension="pressure", display="GPa", plausible=(1e8, 5e10),
             meaning="mean pressure at which the sphere flows or crushes fully (indentation hardness)"),
    Quantity(name="bars.E", symbol="E_b", dimension="pressure", display="GPa", plausible=(1e9, 6e11),
             meaning="Young's modulus of the bars"),
    Quantity(name="bars.nu", symbol="nu_b", dimension="number", lower=-1.0, upper=0.5, plausible=(0.05, 0.45),
             meaning="Poisson ratio of the bars"),
    Quantity(name="bars.density", symbol="rho_b", dimension="density", display="kg/m3", plausible=(500.0, 2e4),
             meaning="density of the bars"),
    Quantity(name="bars.diameter", symbol="d_b", dimension="length", display="mm", plausible=(1e-3, 0.2),
             meaning="diameter of both bars"),
    Quantity(name="bars.incident_length", symbol="l_1", dimension="length", display="m", plausible=(0.05, 30.0),
             meaning="length of the incident bar"),
    Quantity(name="bars.receiving_length", symbol="l_3", dimension="length", display="m", plausible=(0.05, 30.0),
             meaning="length of the receiving bar"),
    Quantity(name="bars.incident_end", symbol="R_1", dimension="number", lower=-1.0, upper=1.0, closed=True,
             plausible=(-1.0, 1.0), meaning="velocity reflection coefficient of the incident bar's far end"),
    Quantity(name="bars.receiving_end", symbol="R_3", dimension="number", lower=-1.0, upper=1.0, closed=True,
             plausible=(-1.0, 1.0), meaning="velocity reflection coefficient of the receiving bar's far end"),
    Quantity(name="bars.end_radius", symbol="r_end", dimension="length", display="mm", plausible=(1e-3, 1e3),
             meaning="radius of rounded bar ends (flat ends: absent)"),
    Quantity(name="bars.yield_strength", symbol="Y_b", dimension="pressure", display="MPa", plausible=(1e7, 5e9),
             meaning="yield strength of the bars"),
    Quantity(name="bars.insert_E", symbol="E_i", dimension="pressure", display="GPa", plausible=(1e9, 1.2e12),
             meaning="Young's modulus of inserts between bars and sphere"),
    Quantity(name="bars.insert_nu", symbol="nu_i", dimension="number", lower=-1.0, upper=0.5, plausible=(0.05, 0.45),
             meaning="Poisson ratio of the inserts"),
    Quantity(name="bars.insert_yield_strength", symbol="Y_i", dimension="pressure", display="MPa",
             plausible=(1e7, 1e10), meaning="yield strength of the inserts"),
    Quantity(name="bars.insert_thickness", symbol="t_i", dimension="length", display="mm", plausible=(1e-4, 0.2),
             meaning="thickness of the inserts"),
    Quantity(name="striker.speed", symbol="v_0", dimension="speed", display="m/s", plausible=(1e-3, 50.0),
             meaning="speed of the striker"),
    Quantity(name="striker.length", symbol="l_0", dimension="length", display="m", plausible=(0.01, 5.0),
             meaning="length of the striker"),
    Quantity(name="striker.E", symbol="E_s", dimension="pressure", display="GPa", plausible=(1e9, 6e11),
             meaning="Young's modulus of the striker (absent: that of the bars)"),
    Quantity(name="striker.density", symbol="rho_s", dimension="density", display="kg/m3", plausible=(500.0, 2e4),
             meaning="density of the striker (absent: that of the bars)"),
    Quantity(name="striker.diameter", symbol="d_s", dimension="length", display="mm", plausible=(1e-3, 0.2),
             meaning="diameter of the striker (absent: that of the bars)"),
    Quantity(name="pulse.duration", symbol="t_i", dimension="time", display="us", plausible=(1e-6, 1e-2),
             meaning="duration of the pulse (at half height for a trapezoid)"),
    Quantity(name="pulse.rise", symbol="t_rise", dimension="time", display="us", closed=True, plausible=(0.0, 1e-3),
             meaning="rise of a trapezoidal pulse"),
    Quantity(name="pulse.fall", symbol="t_fall", dimension="time", display="us", closed=True, plausible=(0.0, 1e-3),
             meaning="fall of a trapezoidal pulse"),
    Quantity(name="pulse.t1", symbol="t_1", dimension="time", display="us", plausible=(1e-6, 1e-2),
             meaning="time of the first peak of a two-peak pulse"),
    Quantity(name="pulse.level1", symbol="g_1", dimension="number", plausible=(0.1, 2.0),
             meaning="level of the first peak over v_0/2"),
    Quantity(name="pulse.t2", symbol="t_2", dimension="time", display="us", plausible=(1e-6, 1e-2),
             meaning="time of the second peak of a two-peak pulse"),
    Quantity(name="pulse.level2", symbol="g_2", dimension="number", plausible=(0.1, 2.0),
             meaning="level of the second peak over v_0/2"),
    Quantity(name="pulse.valley", symbol="g_v", dimension="number", plausible=(0.0, 2.0), closed=True,
             meaning="level half-way between the peaks of a two-peak pulse"),
    Quantity(name="pulse.gain", symbol="G", dimension="number", plausible=(0.5, 2.0),
             meaning="true strain over that of a measured pulse"),
    Quantity(name="product.A", symbol="A", dimension="share", display="%", lower=1e-3, upper=1.0, closed=True,
             plausible=(0.2, 1.0), meaning="largest product fineness t10"),
    Quantity(name="product.b", symbol="b", dimension="mass_per_energy", display="t/kWh",
             plausible=(0.1 / 3600.0, 10.0 / 3600.0), meaning="how fast the product fineness rises with the energy"),
    Quantity(name="contact.onset_pressure", symbol="p_y", dimension="pressure", display="GPa", plausible=(1e8, 2e10),
             meaning="centre pressure at which a face begins to yield or to crush"),
    Quantity(name="contact.hardness", symbol="H", dimension="pressure", display="GPa", plausible=(1e8, 5e10),
             meaning="mean pressure of a face that flows fully (indentation hardness)"),
    Quantity(name="contact.pile_up", symbol="C", dimension="number", lower=1.0, upper=3.0, closed=True,
             plausible=(1.0, 3.0), meaning="pile-up: a² over r times the approach, far beyond yield"),
    Quantity(name="contact.gamma", symbol="gamma", dimension="number", lower=2.0, upper=8.0, closed=True,
             plausible=(2.0, 8.0), meaning="exponent of the sphere's damage"),
    Quantity(name="contact.fracture_energy", symbol="E_f", dimension="specific_energy", display="J/kg",
             plausible=(0.1, 1e5), meaning="specific fracture energy of the sphere"),
    *(Quantity(name=name, symbol=f"xi_{j}", dimension="number", lower=-math.inf, plausible=(-8.0, 8.0),
               meaning=f"noise of a measured pulse, mode {j}, over its standard deviation")
      for j, name in enumerate(noise_names(), start=1)),
)}  # fmt: skip

#: Laws of the contact: elastic, with yield of the softer body, with damage of the sphere.
CONTACT_LAWS: Final = ("hertz", "plastic", "damage")

#: what the status of a row means; only rows of 0 and of 7 have numbers
STATUS: dict[int, str] = {
    0: "ok",
    1: "outside the domain of the model (a size, modulus, ratio or pulse without meaning, a sphere wider than its bar)",
    2: "the pulse is longer than the round trip of the incident bar, so the striker is still on it",
    3: "the integrator could not reach the tolerance",
    4: "too many reflections before the end of the record",
    5: "too many steps before the end of the record",
    6: "the answer is not finite",
    7: "an event comes at one of several times, and less than the tolerance decides which: the answer may jump",
}
#: shortest pulse and round trip over t_c: a double tells times of the record apart to 1e-16 of it
_SHORTEST: Final = 1e-9
#: the status of a row that has two answers
UNDECIDED: Final = 7


def answered(status: Places) -> Flags:
    """Whether rows have numbers that may be used, (n,)."""
    return np.asarray((status == 0) | (status == UNDECIDED))


#: columns without which there is no scene, and those of finite bars
_NEEDED: Final = (
    "sphere.E", "sphere.nu", "sphere.radius", "sphere.density",
    "bars.E", "bars.nu", "bars.density", "bars.diameter", "striker.speed",
)  # fmt: skip
_NEEDED_FINITE: Final = ("bars.incident_length", "bars.receiving_length", "bars.incident_end", "bars.receiving_end")
#: columns that serve validity checks only where nothing yields
_CHECKED_ONLY: Final = frozenset({
    "bars.yield_strength", "bars.insert_yield_strength", "bars.insert_thickness",
    "sphere.onset_pressure", "sphere.hardness",
})  # fmt: skip
#: what makes a striker another bar than the others
STRIKER_COLUMNS: Final = frozenset({"striker.E", "striker.density", "striker.diameter"})


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scale factors and similarity numbers of n rows, theory (8) and (10); SI."""

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

    @property
    def pulse_number(self) -> Array:
        """theta = t_i/t_c."""
        return self.duration / self.time


@dataclass(frozen=True, kw_only=True)
class Scene:
    """n scenes that share their structure and differ in their numbers.

    Attributes
    ----------
    columns : mapping of str to (n,) array
        Numbers by their dotted path in `INPUTS`, SI.
    shape : str
        Shape of the incident pulse, one of `uqsphere.mechanics.pulses.SHAPES`.
    infinite : bool
        No wave comes back from the far ends.
    rigid_contact : bool
        The bars do not yield in the contact: 1/E* = (1 - nu²)/E.
    first_loading_only : bool
        End the record when the first reflected wave returns.
    horizon : float or None
        End of the record [s]; None: the rule of docs/theory.md.
    demands : mapping of str to (str, mapping)
        Further quantities: name -> criterion of `uqsphere.mechanics.criteria` and its parameters.
    contact_law : str
        A key of `CONTACT_LAWS`.
    contact_dynamics : str
        Of a law that yields: ``path``, inside the equations of motion, or ``elastic``, from the largest force alone.
    hardness_at_onset : bool
        The hardness is the onset, row by row (Thornton's law).
    record : MeasuredPulse or None
        The pulse of the shape ``measured``, the same in every row but for its noise and gain; `striker.speed` is
        then 2 c0 times its peak strain and gain.

    Raises
    ------
    ValueError
        For a missing or misshapen column, an unknown shape, or a record without an end.
    """

    columns: Mapping[str, Array]
    shape: str = "rectangular"
    infinite: bool = False
    rigid_contact: bool = False
    first_loading_only: bool = False
    horizon: float | None = None
    demands: Mapping[str, tuple[str, Mapping[str, float]]] = field(default_factory=dict)
    contact_law: str = "hertz"
    contact_dynamics: str = "path"
    hardness_at_onset: bool = False
    record: MeasuredPulse | None = None

    def __post_init__(self) -> None:
        if self.shape not in SHAPES and self.record is None:
            raise ValueError(f"unknown pulse shape {self.shape!r} (allowed: {', '.join(SHAPES)})")
        if self.contact_law not in CONTACT_LAWS:
            raise ValueError(f"unknown contact law {self.contact_law!r} (allowed: {', '.join(CONTACT_LAWS)})")
        if (self.shape == "measured") != (self.record is not None):
            raise ValueError("a record belongs to the shape 'measured', and that shape needs one")
        if self.shape not in STRIKER_SHAPES and not STRIKER_COLUMNS.isdisjoint(self.columns):
            raise ValueError(f"a {self.shape} pulse does not follow from the striker's material or diameter")
        if missing := [name for name in self._needed if name not in self.columns]:
            raise ValueError(f"the scene lacks {', '.join(missing)}")
        if unknown := [name for name in self.columns if name not in INPUTS]:
            raise ValueError(f"unknown numbers of a scene: {', '.join(unknown)}")
        if self.shape == "step" and self.horizon is None and self.infinite:
            raise ValueError("a step pulse never ends: the record needs a horizon")
        if self.horizon is not None and not 0.0 < self.horizon < np.inf:
            raise ValueError(f"the horizon must be positive and finite, found {self.horizon!r} s")
        rows = {np.shape(column) for column in self.columns.values()}
        if len(rows) != 1 or len(next(iter(rows))) != 1:
            raise ValueError(f"every column must have shape (n,), found {sorted(map(str, rows))}")

    @property
    def _needed(self) -> tuple[str, ...]:
        """Columns without which there is no such scene."""
        timed = self.shape in ("step", "measured") or "pulse.duration" in self.columns
        return (
            *_NEEDED,
            *(() if self.infinite else _NEEDED_FINITE),
            *(f"pulse.{name}" for name in PARAMETERS.get(self.shape, ())),
            *(() if timed else ("striker.length",)),
        )

    def __len__(self) -> int:
        return len(next(iter(self.columns.values())))

    def column(self, name: str, default: float = np.nan) -> Array:
        """A column, or `default` in every row."""
        found = self.columns.get(name)
        return np.full(len(self), default) if found is None else np.asarray(found, dtype=float)

    @cached_property
    def pulse(self) -> Pulse:
        """The incident pulse of every row, times in seconds."""
        if self.record is not None:
            return self.record.pulse(len(self), self.columns)
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
        """Impedance of the striker over that of the bars, (n,); None for a striker like the bars."""
        if STRIKER_COLUMNS.isdisjoint(self.columns):
            return None
        with np.errstate(all="ignore"):
            return np.asarray(bars.impedance(*self._striker, self._striker_diameter) / self.scales.impedance)

    @property
    def _striker(self) -> tuple[Array, Array]:
        """E and density of the striker, (n,) each: the bars' where it has none of its own."""
        own = [self.columns.get(f"striker.{key}", self.columns[f"bars.{key}"]) for key in ("E", "density")]
        return own[0], own[1]

    @property
    def _striker_diameter(self) -> Array:
        return self.columns.get("striker.diameter", self.columns["bars.diameter"])

    @cached_property
    def round_trips(self) -> Array:
        """Round trips of incident and receiving bar, (n, 2) [s]; infinite where a bar has no length."""
        E, density = self.columns["bars.E"], self.columns["bars.density"]
        lengths = [self.column(f"bars.{bar}_length", np.inf) for bar in ("incident", "receiving")]
        with np.errstate(all="ignore"):
            return np.stack([bars.round_trip(length, E, density) for length in lengths], axis=1)

    @cached_property
    def reflections(self) -> Array:
        """Velocity reflection coefficients of the far ends, (n, 2); 0 on infinite bars."""
        if self.infinite:
            return np.zeros((len(self), 2))
        return np.stack([self.column("bars.incident_end"), self.column("bars.receiving_end")], axis=1)

    @cached_property
    def first_echo(self) -> Array:
        """Time at which the first reflected wave returns to the sphere, (n,) [s]; infinite if none does."""
        return np.asarray(np.where(self.reflections != 0.0, self.round_trips, np.inf).min(axis=1))

    @cached_property
    def record_end(self) -> Array:
        """End of the record, (n,) [s]; infinite where the rule of infinite bars ends it."""
        if self.horizon is not None:
            ends = np.full(len(self), self.horizon)
        elif self.infinite:
            ends = np.full(len(self), np.inf)
        else:
            ends = 8.0 * self.round_trips.max(axis=1)
        return np.minimum(ends, self.first_echo) if self.first_loading_only else ends

    @cached_property
    def scales(self) -> Scales:
        """Scale factors of every row; not finite where a row has no meaning."""
        c = self.columns
        with np.errstate(all="ignore"):
            modulus = contact.reduced_modulus(
                c["sphere.E"],
                c["sphere.nu"],
                c.get("bars.insert_E", c["bars.E"]),
                c.get("bars.insert_nu", c["bars.nu"]),
                rigid_bars=self.rigid_contact,
            )
            radius = contact.effective_radius(c["sphere.radius"], self.column("bars.end_radius", np.inf))
            beta = contact.hertz_constant(modulus, radius)
            mass = contact.sphere_mass(c["sphere.radius"], c["sphere.density"])
            impedance = bars.impedance(c["bars.E"], c["bars.density"], c["bars.diameter"])
            speed = c["striker.speed"]
            force = 0.5 * impedance * speed
            approach = contact.approach_at_force(force, beta)
            time = 2.0 * approach / speed
            if self.shape == "step":
                duration = np.full(len(self), np.inf)
            elif self.record is not None:
                duration = np.full(len(self), self.record.duration)
            else:
                wave_speed = bars.wave_speed(*self._striker)
                duration = self.columns.get("pulse.duration", 2.0 * self.column("striker.length") / wave_speed)
            return Scales(
                modulus=modulus,
                effective_radius=radius,
                hertz_constant=beta,
                mass=mass,
                impedance=impedance,
                force=force,
                approach=approach,
                time=time,
                mass_number=mass / (impedance * time),
                duration=duration,
            )

    @cached_property
    def bodies(self) -> tuple[Body, Body]:
        """What yields at a face: bar end or insert, and sphere; (n,) each, an onset that is not given infinite."""
        strength = self.column("bars.insert_yield_strength") if self.inserted else self.column("bars.yield_strength")
        bar = metal_body(strength, self.columns.get("bars.insert_nu", self.columns["bars.nu"]))
        if self.rigid_contact:
            bar = bar._replace(onset=np.full(len(self), np.inf))
        sphere = Body(
            self.column("sphere.onset_pressure", np.inf),
            self.column("sphere.hardness", np.inf),
            np.full(len(self), CAP_PILE_UP),
        )
        return bar, sphere

    @property
    def inserted(self) -> bool:
        """Whether inserts with a yield strength of their own stand between bars and sphere."""
        return "bars.insert_yield_strength" in self.columns

    @cached_property
    def faces(self) -> Face | None:
        """The law of both faces where they yield, (n,) each: that of the softer body, but for what [contact] gives."""
        if self.contact_law != "plastic":
            return None
        c, own, scales = self.columns, softer(*self.bodies), self.scales
        onset = c.get("contact.onset_pressure", own.onset)
        return Face(
            onset=onset,
            hardness=onset if self.hardness_at_onset else c.get("contact.hardness", own.hardness),
            pile_up=c.get("contact.pile_up", own.pile_up),
            modulus=scales.modulus,
            effective_radius=scales.effective_radius,
        )

    @cached_property
    def status(self) -> Places:
        """Status of every row before anything is integrated, (n,): see `STATUS`."""
        codes = np.zeros(len(self), dtype=np.int64)
        for name, column in self.columns.items():
            if name in _CHECKED_ONLY and self.contact_law == "hertz":
                continue
            bound = INPUTS[name]
            inside = (column >= bound.lower) & (column <= bound.upper)
            if not bound.closed:
                inside &= (column != bound.lower) & (column != bound.upper)
            if name == "bars.end_radius":
                inside |= column == np.inf
            codes[~inside] = 1
        with np.errstate(all="ignore"):
            codes[2.0 * self.columns["sphere.radius"] > self.columns["bars.diameter"]] = 1
            scales = self.scales
            for number in (scales.mass_number, scales.force, scales.approach, scales.time):
                codes[~(np.isfinite(number) & (number > 0.0))] = 1
            codes[~self.pulse.valid] = 1
            # what is shorter than this beside t_c is lost in the rounding of the times
            codes[scales.duration < _SHORTEST * scales.time] = 1
            if (faces := self.faces) is not None:
                # b between 0 and 0.2 has a singularity near onset; above 100 the face is Hertz's but for rounding
                b = faces.softening
                codes[~((faces.pile_up >= 1.0) & (faces.onset > 0.0) & (faces.hardness >= faces.onset))] = 1
                codes[~((np.abs(b) < 1e-12) | ((b >= 0.2) & (b <= 100.0)))] = 1
            brief = (self.round_trips < _SHORTEST * scales.time[:, None]) & (self.reflections != 0.0)
            codes[brief.any(axis=1)] = 1
            if not self.infinite:
                too_long = self.pulse.end > self.round_trips[:, 0] * (1.0 + 1e-9)
                codes[(codes == 0) & too_long & (self.reflections[:, 0] != 0.0)] = 2
        return codes

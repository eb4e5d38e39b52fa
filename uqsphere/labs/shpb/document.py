"""The input file of a record: bars with their gauges, the file, the specimen."""

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator

from uqsphere.documents import Fault, within
from uqsphere.labs.files import (
    Density,
    Force,
    Length,
    Mass,
    PoissonRatio,
    Positive,
    Pressure,
    Section,
    Speed,
    Time,
    from_library,
    in_unit,
)
from uqsphere.units import parse_value

#: density [kg/m³] of the heaviest specimen, where only its size is known
_HEAVIEST = 8000.0

Columns = Annotated[
    tuple[str | int, ...], BeforeValidator(lambda v: (v,) if isinstance(v, str | int) else v)
]


Volts = Annotated[
    Positive,
    BeforeValidator(lambda raw: parse_value(raw, "voltage") if isinstance(raw, str) else raw),
]


class BarTable(Section):
    """A bar and its gauge; omitted keys of the receiving bar default to the incident bar's, except
    `gauge`.

    gauge : distance from the face of the specimen.
    end : `free` if the far end reflects waves, `absorbing` if it does not.
    unit : of the signal, if its heading has none: strain, microstrain, V, mV ...
    gauge_factor, excitation [V], amplification, active_arms : of the Wheatstone bridge, eps =
        4 U/(k N U_0 A).
    gain_sd : relative standard deviation of the gain.
    """

    gauge: Length
    material: str | None = None
    E: Pressure
    density: Density
    nu: PoissonRatio = 0.3
    diameter: Length
    length: Length | None = None
    end: Literal["free", "absorbing"] = "free"
    unit: str = ""
    gauge_factor: Positive = 2.0
    excitation: Volts | None = None
    amplification: Positive = 1.0
    active_arms: Positive = 1.0
    gain_sd: float = Field(default=0.01, ge=0.0, lt=1.0)

    @property
    def wave_speed(self) -> float:
        """c0 = sqrt(E/rho) [m/s]."""
        return math.sqrt(self.E / self.density)

    @property
    def passage(self) -> float:
        """Time [s] in which a wave goes from the gauge to the specimen, or back."""
        return self.gauge / self.wave_speed

    @property
    def stiffness(self) -> float:
        """E A [N]: force per strain."""
        return self.E * math.pi * self.diameter**2 / 4.0

    @property
    def strain_per_volt(self) -> float:
        """eps/U = 4/(k N U_0 A) of the bridge."""
        return 4.0 / (
            self.gauge_factor * self.active_arms * (self.excitation or 1.0) * self.amplification
        )

    @property
    def echo(self) -> float:
        """Time [s] in which a wave goes from the gauge to the far end and back."""
        if self.end == "absorbing" or not self.length:
            return math.inf
        return 2.0 * (self.length - self.gauge) / self.wave_speed


class RecordTable(Section):
    """The file and its columns, by heading or by number from 1; several gauges of a bar as a list.

    more_files : further channels of the recorder, one file each, with the same layout and clock.
    sheet : of workbooks (default: the first with data).
    reflected : column of the reflected wave, if the three waves have a column each.
    aligned : each wave was cut out and begins at its own foot: gauge distances are not used.
    polarity : sign of compression in the file (default: the incident wave is compression).
    striker_speed : of a striker like the incident bar; its wave has the strain v/(2 c0).
    dispersion : whether waves are moved from gauge to face by the first mode of a bar; else they
        keep their shape.
    window : begin and end of the incident wave at its gauge.
    """

    file: str
    more_files: tuple[str, ...] = ()
    sheet: str = ""
    time: str | int | None = None
    incident: Columns = ()
    reflected: Columns = ()
    receiving: Columns = ()
    time_unit: str = ""
    sample_interval: Annotated[Positive, in_unit("time")] = 0.0
    aligned: bool = False
    polarity: Literal["auto", "tension", "compression"] = "auto"
    striker_speed: Speed | None = None
    dispersion: bool = True
    window: tuple[Time, Time] | None = None


class SpecimenTable(Section):
    """The specimen: a sphere, or a cylinder where `length` is given.

    mass, density : the inertia that lets the forces at both faces differ.
    strongest : a force that no such specimen carries.
    """

    name: str = "specimen"
    diameter: Length | None = None
    length: Length | None = None
    mass: Mass | None = None
    density: Density | None = None
    strongest: Force | None = None

    def heaviest(self, widest: float) -> float:
        """The largest mass [kg] that the specimen may have.

        Its own mass where it is known, else a sphere or cylinder of steel of its size, else a
        sphere of steel as wide as the bar, `widest` [m].
        """
        if self.mass:
            return 1.02 * self.mass
        diameter = self.diameter or widest
        volume = math.pi / 6.0 * diameter**3
        if self.length:
            volume = math.pi / 4.0 * diameter**2 * self.length
        if not (self.density and self.diameter):
            return _HEAVIEST * volume
        return 1.02 * (self.density * volume)


class RecordDocument(Section):
    """An input file of `uqsphere shpb records`."""

    title: str = ""
    incident_bar: BarTable
    receiving_bar: BarTable
    record: RecordTable
    specimen: SpecimenTable = SpecimenTable()

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any) -> Any:
        """Complete the receiving bar by the incident one, and materials by their numbers."""
        if not isinstance(data.get("incident_bar"), dict):
            return data
        with within("incident_bar"):
            incident = from_library(data["incident_bar"], "bars")
        with within("receiving_bar"):
            receiving = from_library(data.get("receiving_bar", {}), "bars")
        if isinstance(receiving, dict):
            shared = {key: value for key, value in incident.items() if key != "gauge"}
            receiving = shared | receiving
        return {**data, "incident_bar": incident, "receiving_bar": receiving}

    @model_validator(mode="after")
    def _whole(self) -> "RecordDocument":
        for name in ("incident_bar", "receiving_bar"):
            bar = getattr(self, name)
            if bar.length and bar.gauge > bar.length:
                raise Fault(
                    f"must be on the bar of {bar.length:g} m, not at {bar.gauge:g} m",
                    name,
                    "gauge",
                )
        return self

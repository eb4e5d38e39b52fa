"""The input file of a record: bars with their gauges, the file, the specimen."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from uqsphere.errors import AccessError, UsageError
from uqsphere.materials import library
from uqsphere.units import UnitError, parse_value


def _in(dimension: str) -> BeforeValidator:
    def parse(text: object) -> float:
        try:
            return parse_value(text, dimension)
        except UnitError as error:
            raise ValueError(str(error)) from None

    return BeforeValidator(parse)


Length = Annotated[float, _in("length"), Field(gt=0.0)]
Pressure = Annotated[float, _in("pressure"), Field(gt=0.0)]
Density = Annotated[float, _in("density"), Field(gt=0.0)]
Force = Annotated[float, _in("force"), Field(gt=0.0)]
Speed = Annotated[float, _in("speed"), Field(gt=0.0)]
Time = Annotated[float, _in("time")]
Columns = Annotated[tuple[str | int, ...], BeforeValidator(lambda v: (v,) if isinstance(v, (str, int)) else v)]


class Section(BaseModel):
    """A table of the file: no key that is not known, nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class BarTable(Section):
    """A bar and its gauge; what a receiving bar leaves out is that of the incident bar, but for `gauge`.

    gauge : distance from the specimen's face.
    end : whether the far end reflects (`free`) or sends nothing back (`absorbing`).
    unit : of the signal, where the heading has none; strain, microstrain, V, mV ...
    gauge_factor, excitation [V], amplification, active_arms : eps = 4 U/(k N U_0 A) of a Wheatstone bridge.
    gain_sd : relative standard deviation of the gain.
    """

    gauge: Length
    material: str | None = None
    E: Pressure | None = None
    nu: float | None = Field(default=None, ge=0.0, lt=0.5)
    density: Density | None = None
    diameter: Length | None = None
    length: Length | None = None
    end: Literal["free", "absorbing"] | None = None
    unit: str | None = None
    gauge_factor: float | None = Field(default=None, gt=0.0)
    excitation: float | None = Field(default=None, gt=0.0)
    amplification: float | None = Field(default=None, gt=0.0)
    active_arms: float | None = Field(default=None, gt=0.0)
    gain_sd: float | None = Field(default=None, ge=0.0, lt=1.0)

    @property
    def wave_speed(self) -> float:
        """c0 = sqrt(E/rho) [m/s]."""
        assert self.E is not None
        assert self.density is not None
        return math.sqrt(self.E / self.density)

    @property
    def stiffness(self) -> float:
        """E A [N]: force per strain."""
        assert self.E is not None
        assert self.diameter is not None
        return self.E * math.pi * self.diameter**2 / 4.0

    @property
    def echo(self) -> float:
        """Time from a wave at the gauge on its way out until its echo from the far end is there [s]."""
        if self.end == "absorbing" or self.length is None:
            return math.inf
        return 2.0 * (self.length - self.gauge) / self.wave_speed


_DEFAULTS: dict[str, Any] = {
    "nu": 0.3, "end": "free", "gauge_factor": 2.0, "amplification": 1.0, "active_arms": 1.0, "gain_sd": 0.01,
    "unit": "",
}  # fmt: skip


class RecordTable(Section):
    """The file and its columns, by heading or number from 1 on; several gauges of a bar as a list.

    reflected : where the three waves stand in columns of their own.
    aligned : each of the three waves begins at its own foot (they were cut out): distances do not count.
    more_files : other channels of the same recorder, one file each, in the same layout and on the same clock.
    polarity : sign of compression in the file; `auto`: the incident wave presses.
    window : times between which the incident wave passes its gauge.
    """

    file: str
    more_files: tuple[str, ...] = ()
    time: str | int | None = None
    incident: Columns = ()
    reflected: Columns = ()
    receiving: Columns = ()
    time_unit: str = ""
    sample_interval: Time | None = None
    aligned: bool = False
    polarity: Literal["auto", "tension", "compression"] = "auto"
    window: tuple[Time, Time] | None = None


class SpecimenTable(Section):
    """The specimen; `strongest`: a force that no such specimen bears."""

    name: str = "specimen"
    diameter: Length | None = None
    length: Length | None = None
    strongest: Force | None = None


class RecordDocument(Section):
    """An input file of `uqsphere shpb records`."""

    title: str = ""
    incident_bar: BarTable
    receiving_bar: BarTable
    record: RecordTable
    specimen: SpecimenTable = SpecimenTable()
    striker_speed: Speed | None = None

    @model_validator(mode="before")
    @classmethod
    def _complete(cls, data: Any) -> Any:
        """The receiving bar takes over what it leaves out; materials become numbers."""
        if not isinstance(data, dict) or not isinstance(data.get("incident_bar"), dict):
            return data
        incident = {**_DEFAULTS, **data["incident_bar"]}
        given = data.get("receiving_bar", {})
        given = given if isinstance(given, dict) else {}
        shared = {key: value for key, value in incident.items() if key != "gauge"}
        receiving = {**_from_library(shared), **_from_library(given)}
        return {**data, "incident_bar": _from_library(incident), "receiving_bar": receiving}

    @model_validator(mode="after")
    def _whole(self) -> RecordDocument:
        for name, bar in (("incident_bar", self.incident_bar), ("receiving_bar", self.receiving_bar)):
            for key in ("E", "density", "diameter"):
                if getattr(bar, key) is None:
                    raise ValueError(f"{name}.{key} is required" + ("" if key == "diameter" else ", or a material"))
            if bar.length is not None and bar.gauge > bar.length:
                raise ValueError(f"{name}: the gauge at {bar.gauge:g} m does not sit on a bar of {bar.length:g} m")
        return self


def _from_library(table: dict[str, Any]) -> dict[str, Any]:
    """A bar with the numbers of its material where it does not give its own."""
    name = table.get("material")
    if name is None:
        return table
    known = library()["bars"]
    if name not in known:
        raise ValueError(f"material {name!r} is not known for bars: {', '.join(known)}")
    numbers = {key: known[name].properties[key].value for key in ("E", "nu", "density")}
    units = {"E": "Pa", "density": "kg/m3"}
    taken = {key: f"{value!r} {units[key]}" if key in units else value for key, value in numbers.items()}
    return {**table, **{key: value for key, value in taken.items() if key not in table or key == "nu"}}


Document = TypeVar("Document", bound=BaseModel)


def load_document(path: Path, kind: Callable[..., Document]) -> Document:
    """An input file as its document; UsageError with every fault, AccessError where it cannot be read."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise AccessError(f"{path}: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError, ValueError) as error:
        raise UsageError(f"{path}: {error}") from None
    try:
        return kind(**data)
    except ValidationError as error:
        faults = []
        for one in error.errors():
            place = ".".join(str(part) for part in one["loc"]) or "file"
            faults.append(f"{path}: {place}: {one['msg'].removeprefix('Value error, ')}")
        raise UsageError("\n".join(faults)) from None

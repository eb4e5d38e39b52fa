"""The tables of a study file as pydantic models: what can stand there, what it means, and its value in SI.

A number knows its quantity by its table and key.  What the tables say of each other is looked at in
`uqsphere.study.check`; the JSON schema and docs/study-file.md are made from these models.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    Strict,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
    model_validator,
)

from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.quantities import INPUTS, format_value
from uqsphere.units import UNITS, Quantity, UnitError, bare_number, parse_value
from uqsphere.uq import Law, LawError, discrete_law, make_law
from uqsphere.uq.families import DIMENSIONAL, FAMILIES, family_named

if TYPE_CHECKING:
    from uqsphere.study.study import Tested

Place = tuple[str | int, ...]
#: what loads the sphere, and the tables that belong to each rig
RIG_TABLES: Final[dict[str, tuple[str, ...]]] = {
    "bars": ("bars", "striker", "pulse", "insert"),
    "impact": ("target",),
    "sphere_on_sphere": ("other",),
    "drop_weight": ("hammer", "anvil"),
    "load_cell": ("hammer", "rod"),
    "platens": ("platens",),
}
#: tables whose numbers are entries of `uqsphere.quantities.INPUTS`
SCENE: Final = ("sphere", "contact", "rig", *dict.fromkeys(t for tables in RIG_TABLES.values() for t in tables))
_FACE: Final = "density yield_strength onset_pressure hardness pile_up"
BAR_ENDS: Final = {"free": 1.0, "absorbing": 0.0, "fixed": -1.0}
#: a standard deviation over the mean that is worth a warning, and that is refused
_WIDE, _TOO_WIDE = 1.0, 1000.0
#: a share of a law outside what has a meaning that is worth a warning
NOTABLE: Final = 1e-6


# --- faults and words ----------------------------------------------------------------------------------------------


class Fault(ValueError):
    """A fault of one part of a value: `at` is the way to it."""

    def __init__(self, message: str, *at: str | int) -> None:
        super().__init__(message)
        self.at: Place = tuple(part for part in at if part != "")


@contextmanager
def within(*at: str | int) -> Iterator[None]:
    """A fault inside lies on the way `at`."""
    try:
        yield
    except Fault as error:
        raise Fault(str(error), *at, *error.at) from None


@dataclass(kw_only=True)
class Reader:
    """The folder of a study, outside of which no file is read; the table being read; warnings and faults met."""

    folder: Path = Path()
    table: str = ""
    warnings: list[str] = field(default_factory=list)
    faults: list[tuple[Place, str]] = field(default_factory=list)
    spoiled: set[Place] = field(default_factory=set)
    above: set[Place] = field(default_factory=set)
    #: files that the study has read, by the names it gives them
    files: dict[str, Path] = field(default_factory=dict)

    def warn(self, place: Place, message: str) -> None:
        """Note what a user should know and what does not stop the study, once."""
        text = f"{path_of(place)}: {message}" if place else message
        if text not in self.warnings:
            self.warnings.append(text)

    def clean(self, *place: str | int) -> bool:
        """Whether nothing at, above or below a place is known to be faulty."""
        return place not in self.above and not any(place[:n] in self.spoiled for n in range(len(place) + 1))

    def spoil(self, place: Place) -> None:
        """Remember a place as faulty."""
        self.spoiled.add(place)
        self.above |= {place[:n] for n in range(len(place))}

    def note(self, at: Place | str, message: str) -> None:
        """Keep a fault, unless one is known at its place, or above or below it."""
        place: Place = tuple(at.split(".")) if isinstance(at, str) else at
        if self.clean(*place):
            self.faults.append((place, message))
        self.spoil(place)

    @contextmanager
    def noting(self, *place: str | int) -> Iterator[None]:
        """A fault inside is noted as one of a place."""
        try:
            yield
        except Fault as error:
            self.note((*place, *error.at), str(error))


def path_of(place: Place) -> str:
    """A place as users write it.

    >>> path_of(("dependence", 0, "of"))
    'dependence[0].of'
    """
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")


def shown(value: object, longest: int = 60) -> str:
    """A value of a file as its message shows it."""
    if isinstance(value, Mapping | list | tuple):
        return "a table" if isinstance(value, Mapping) else "an array"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return bare_number(value)
    if not isinstance(value, str):
        return f"a {type(value).__name__}"
    text = json.dumps("".join(c if c.isprintable() else "?" for c in value[: 2 * longest]), ensure_ascii=False)
    return text if len(text) <= longest else f"{text[: longest - 1]}…"


def one_of(words: Iterable[str]) -> str:
    """Words as a list in a sentence.

    >>> one_of(["a", "b", "c"])
    'a, b or c'
    """
    *first, last = list(words) or ["none"]
    return f"{', '.join(first)} or {last}" if first else last


def suggestion(word: object, known: Iterable[str]) -> str:
    """A hint at the known word that was likely meant."""
    near = get_close_matches(str(word)[:80], list(known), n=1)
    return f"; did you mean '{near[0]}'?" if near else ""


def unknown(what: str, word: object, known: Iterable[str], most: int = 40) -> str:
    """The message for a word that is none of those known."""
    names = list(known)
    return f"unknown {what} {shown(word)}, known: {one_of(names[:most])}{suggestion(word, names)}"


# --- numbers -------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Number:
    """A number in SI: value or law, the law's parameters as given, whether its data are synthetic, tests behind it."""

    value: float | Law
    given: Mapping[str, float] = field(default_factory=dict)
    synthetic: bool = False
    tested: Tested | None = None

    @property
    def mean(self) -> float:
        """The value, or the law's mean before truncation."""
        return self.value.nominal_mean() if isinstance(self.value, Law) else self.value


def plain_quantity(name: str, meaning: str = "", lower: float = -math.inf) -> Quantity:
    """The entry of a number without unit: a black-box input, say."""
    return Quantity(name=name, symbol=name, dimension="number", lower=lower, meaning=meaning or name)


def number_path(table: str, key: str) -> str:
    """The name of a number in the nomenclature: inserts stand there among the numbers of the bars."""
    return f"bars.insert_{key}" if table == "insert" else f"{table}.{key}"


def number_place(path: str) -> Place:
    """Where a number of the scene stands in a file.

    >>> number_place("bars.insert_E"), number_place("sphere.E")
    (('insert', 'E'), ('sphere', 'E'))
    """
    return tuple(path.replace("bars.insert_", "insert.").split("."))


def bounds_in_words(quantity: Quantity) -> str:
    """Where the values of a quantity must lie."""
    low, high = (format_value(end, quantity.name) for end in (quantity.lower, quantity.upper))
    if math.isfinite(quantity.upper):
        way = f"from {low} to {high}" if quantity.closed else f"between {low} and {high}, both excluded"
        return f"{quantity.meaning} must lie {way}"
    return f"{quantity.meaning} must be {'at least' if quantity.closed else 'above'} {low}"


def value_of(raw: object, quantity: Quantity, *, bounded: bool = True) -> float:
    """SI value of a fixed number; raises Fault where it is none, or outside the bounds of its meaning."""
    if isinstance(raw, str) and quantity.name.endswith(("_end", ".end")):
        if raw not in BAR_ENDS:
            found = f"found {shown(raw)}, allowed: {one_of(BAR_ENDS)}, or a number in [-1, 1]"
            raise Fault(found + suggestion(raw, BAR_ENDS))
        return BAR_ENDS[raw]
    if isinstance(raw, bool) or not isinstance(raw, int | float | str) or len(str(raw)) > 200:
        unit = "" if quantity.dimension == "number" else " with its unit in quotes"
        raise Fault(f"found {shown(raw)}, where a number{unit} is required")
    try:
        value = parse_value(raw, quantity.dimension, _likely_unit(raw, quantity))
    except UnitError as error:
        raise Fault(str(error)) from None
    if bounded and not quantity.allows(value):
        raise Fault(f"found {shown(raw)}: {bounds_in_words(quantity)}")
    return value


def _likely_unit(raw: float | str, quantity: Quantity) -> str:
    """The unit to suggest for a number without one: that people read, or the first that makes it usual."""
    try:
        bare = float(raw)
    except (ValueError, OverflowError):
        return quantity.display
    (low, high), factors = quantity.plausible, UNITS[quantity.dimension]
    usual = (u for u in (quantity.display, *factors) if low <= bare * factors.get(u, 1.0) <= high)
    return next(usual, quantity.display)


def number_of(raw: object, quantity: Quantity, reader: Reader, place: Place) -> Number:
    """Value or law of what a file has; raises Fault."""
    if not isinstance(raw, Mapping):
        found = Number(value=value_of(raw, quantity))
    elif "file" in raw or "draws" in raw or raw.get("dist") == "empirical":
        from uqsphere.study.strength import observed_law

        found = observed_law(raw, quantity, reader, place)
    elif raw.get("dist") == "discrete":
        found = _discrete(raw, quantity, place[0] == "limits")
    else:
        found = _law_of(raw, quantity)
    warn_unusual(found.mean, quantity, reader, place)
    if isinstance(found.value, Law):
        _check_law(found.value, found.given, quantity, reader, place)
    return found


def warn_unusual(value: float, quantity: Quantity, reader: Reader, place: Place) -> None:
    """Warn of a value (SI) outside the usual range of its quantity."""
    if not quantity.plausible[0] <= value <= quantity.plausible[1]:
        said, low, high = (format_value(v, quantity.name) for v in (value, *quantity.plausible))
        reader.warn(place, f"{said} is unusual (usual: {low} to {high}); is the unit right?")


def _law_of(raw: Mapping[str, Any], quantity: Quantity) -> Number:
    kind, ends = raw.get("dist"), ("mean", "mode", "lower", "upper")
    if kind is None:
        near = suggestion(next(iter(raw), ""), ["dist"])
        raise Fault(f'a distribution is required, such as {{ dist = "normal", … }}: the table has no dist{near}')
    if (family := family_named(kind) if isinstance(kind, str) else None) is None:
        raise Fault(f"found {shown(kind)}, known distributions: {one_of(FAMILIES)}{suggestion(kind, FAMILIES)}", "dist")
    keys = (*family.keys, "lower", "upper")
    if (strange := next((key for key in raw if key not in ("dist", *keys)), None)) is not None:
        said = f"{shown(strange)} does not belong to the distribution {family.name}, which takes {one_of(keys)}"
        raise Fault(said + suggestion(strange, keys), strange)
    # a scatter is suggested in the unit that stands beside it
    words = [word for key in ends for word in str(raw.get(key)).split()[-1:]]
    beside = next((word for word in words if word in UNITS[quantity.dimension]), quantity.display)
    given: dict[str, float] = {}
    for key in keys:
        if key not in raw:
            continue
        entry = quantity if key in DIMENSIONAL else plain_quantity(quantity.name)
        if key not in ends and entry.dimension != "number":
            entry = replace(entry, plausible=(0.0, math.inf), display=beside)
        with within(key):
            given[key] = value_of(raw[key], entry, bounded=False)
    bounds = given.pop("lower", None), given.pop("upper", None)
    try:
        return Number(value=make_law(family.name, given, *bounds), given=given)
    except LawError as error:
        spoken = (error.key == "" or error.key in DIMENSIONAL) and any(map(str.isdigit, error.message))
        said = f" (numbers in {quantity.unit})" if spoken and quantity.unit else ""
        raise Fault(f"{error.message}{said}", error.key if error.key in raw else "") from None


def _discrete(raw: Mapping[str, Any], quantity: Quantity, limit: bool) -> Number:
    if limit:
        raise Fault("a strength has a density, or is a column of observations: discrete is for inputs", "dist")
    if (strange := next((key for key in raw if key not in ("dist", "values", "weights")), None)) is not None:
        raise Fault(f"{shown(strange)} does not belong to the distribution discrete: values and weights do", strange)
    for key in ("values", "weights"):
        if not isinstance(raw.get(key, []), list):
            raise Fault(f"found {shown(raw[key])}, where a list is required, such as [1, 2, 3]", key)
    with within("values"):
        values = [value_of(one, quantity) for one in raw.get("values", [])]
    try:
        weights = raw.get("weights")
        if not all(type(one) in (int, float) for one in weights or ()):
            raise LawError("weights are whole numbers, one for each of the values", "weights")
        return Number(value=discrete_law(values, weights))
    except LawError as error:
        raise Fault(error.message, error.key if error.key in raw else "") from None


def _check_law(law: Law, given: Mapping[str, float], quantity: Quantity, reader: Reader, place: Place) -> None:
    """Refuse a law outside what has a meaning, or too wide to compute with; warn of tails, wide and cut-off laws."""
    name, centre, middle, scatter = quantity.name, law.nominal_mean(), law.mean(), law.sd()
    if not quantity.allows(centre):
        raise Fault(f"the distribution has its mean at {format_value(centre, name)}: {bounds_in_words(quantity)}")
    ends = {"lower": law.lower, "upper": law.upper}
    for key, end in ends.items() if law.family.bounded else ():
        if not quantity.lower <= end <= quantity.upper:
            raise Fault(f"{format_value(end, name)}: {bounds_in_words(quantity)}", key)
    cov = max(scatter / abs(middle) if middle and scatter is not None else 0.0, given.get("cov", 0.0))
    if cov > _TOO_WIDE and not any(map(math.isfinite, ends.values())):
        said = f"the standard deviation is {cov:.3g} times the mean, at most {_TOO_WIDE:g} can be computed with"
        at = next((key for key in ("cov", "sd", "log_sd", "shape", "modulus") if key in given), "")
        raise Fault(f'{said}; write a share, such as cov = 0.12 or "12 %"', at)
    if cov > _WIDE:
        share = f'; 15 % is written 0.15 or "15 %", so {bare_number(cov)} % is {cov / 100:g}' * ("cov" in given)
        reader.warn(place, f"the standard deviation is {cov:.3g} times the mean: is that meant?{share}")
    if (mean := given.get("mean")) is not None and not law.lower <= mean <= law.upper:
        key, side = ("lower", "below") if mean < law.lower else ("upper", "above")
        bound = format_value(ends[key], name)
        said = f"the mean {format_value(mean, name)} lies {side} the bound {bound}"
        reader.warn((*place, key), f"{said}: only a tail of the distribution is sampled")
    if law.family.bounded or not law.mass:
        return
    import numpy as np

    outside = 0.0
    if law.lower < quantity.lower:
        outside += float(law.cdf(np.array([quantity.lower]))[0])
    if law.upper > quantity.upper:
        outside += float(law.sf(np.array([quantity.upper]))[0])
    if outside > NOTABLE:
        said = (
            f"a share of {outside:.2g} of the distribution lies where it has no meaning ({bounds_in_words(quantity)})"
        )
        effect = "these samples count as failed evaluations; " if name in INPUTS else ""
        reader.warn(place, f"{said}; {effect}truncate it with lower or upper")


# --- what a key can hold -------------------------------------------------------------------------------------------


def _number(raw: Any, info: ValidationInfo) -> Any:
    """A number of the scene, by its table and key; None for a flat face, raw where the table has no such number."""
    reader, key = info.context, str(info.field_name)
    if reader is None or (path := number_path(reader.table, key)) not in INPUTS:
        return raw
    if (key, raw) == ("face_radius", "flat") or (path, raw) == ("contact.hardness", "onset"):
        return None if raw == "flat" else raw
    return number_of(raw, INPUTS[path], reader, (reader.table, key))


def _fixed(dimension: str, meaning: str = "", lower: float = 0.0, upper: float = math.inf) -> Any:
    """The mark of a fixed number with its unit; what Python gives is in SI already."""
    quantity = Quantity(name=dimension, symbol="", dimension=dimension, lower=lower, upper=upper,
                        meaning=f"the {meaning or dimension}")  # fmt: skip

    def read(raw: Any, info: ValidationInfo) -> Any:
        return raw if info.context is None or raw is None else value_of(raw, quantity)

    return BeforeValidator(read), WithJsonSchema({"dimension": dimension})


def _parameter(name: str) -> Any:
    part = PARAMETERS[name]
    return _fixed(part.dimension, part.meaning, part.lower, part.upper)


def _percent(raw: Any) -> Any:
    return value_of(raw, plain_quantity("share")) if isinstance(raw, str) and raw.rstrip().endswith("%") else raw


def _real(kind: type = float, **bounds: Any) -> Any:
    """The mark of a plain number within bounds, which may be a percentage unless it is whole."""
    return Field(strict=True, **bounds), *([BeforeValidator(_percent)] if kind is float else [])


def _unique(values: tuple[Any, ...]) -> tuple[Any, ...]:
    if (twice := next((k for k, value in enumerate(values) if value in values[:k]), None)) is not None:
        raise Fault(f"{shown(values[twice])} is named twice", twice)
    return values


def _policy(raw: Any) -> Any:
    """One of three words, or the share of failed evaluations that is left out at most."""
    if isinstance(raw, str) and raw in POLICIES:
        return raw
    share = _percent(raw)
    if isinstance(share, int | float) and 0.0 < share < 1.0:
        return share
    words = ", ".join(f'"{word}"' for word in POLICIES)
    raise Fault(f'found {shown(raw)}, allowed: {words}, or the largest share to leave out, such as "5 %"')


def _several(least: int = 1, most: int = 200) -> Any:
    """The mark of a list with so many entries, each once."""
    return Field(min_length=least, max_length=most), AfterValidator(_unique)


def key(meaning: str | None, default: Any = None, *, usual: str = "") -> Any:
    """A key: its meaning in one clause (None: that of its quantity), its default, and that in words if need be."""
    held = {"default_factory": default} if isinstance(default, type) else {"default": default}
    return Field(**held, description=meaning, json_schema_extra={"usual": usual})


def due(meaning: str) -> Any:
    """A key that must be given."""
    return Field(description=meaning, json_schema_extra={"usual": "required"})


Flag = Annotated[bool, Strict()]
Name = Annotated[str, Field(pattern="^[A-Za-z_][A-Za-z0-9_-]{0,63}$")]
Num = Annotated[Any, BeforeValidator(_number)]
Share = Annotated[float, *_real(gt=0.0, lt=1.0)]
POLICIES: Final = ("abort", "bound", "drop")
OnFailure = Annotated[
    str | float, BeforeValidator(_policy), WithJsonSchema({"anyOf": [{"enum": [*POLICIES]}, {"type": "number"}]})
]
Shares = Annotated[tuple[Share, ...], *_several()]
Positive = Annotated[float, *_real(gt=0.0)]
Correlation = Annotated[float, *_real(gt=-1.0, lt=1.0)]
Names = Annotated[tuple[str, ...], *_several()]
Pair = Annotated[tuple[str, ...], *_several(2, 2)]
Seconds = Annotated[float, *_fixed("time")]
Length = Annotated[float, *_fixed("length")]
_Method = Literal["auto", "qmc", "pce", "sobol", "form", "importance", "subset", "morris", "delta", "pawn", "hdmr"]
_METHODS: Final = one_of(f"`{method}`" for method in get_args(_Method)[1:])
Methods = Annotated[
    tuple[_Method, ...], *_several(), BeforeValidator(lambda raw: [raw] if isinstance(raw, str) else raw)
]


class Table(BaseModel):
    """A table of a study: no key beyond those declared."""

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True, protected_namespaces=())


# --- the scene -----------------------------------------------------------------------------------------------------


class Sphere(Table):
    """The sphere."""

    material: str | None = key("name from `uqsphere list materials`: fills `E`, `nu`, `density` that are not given")
    E: Num = None
    nu: Num = None
    density: Num = None
    radius: Num = key("radius, not diameter; the sphere must fit its bars", usual="required")
    onset_pressure: Num = key(None, usual="from the material, else elastic")
    hardness: Num = key(None, usual="from the material")


class Face(Table):
    """What every body has that the sphere touches."""

    material: str | None = key("fills `E`, `nu`, `density`, `yield_strength` that are not given")
    E: Num = None
    nu: Num = None
    density: Num = None
    yield_strength: Num = key("for the validity checks, and the law of a `plastic` contact")
    onset_pressure: Num = key(None, usual="from `yield_strength`")
    hardness: Num = key(None, usual="from `yield_strength`")
    pile_up: Num = key("`a²` over `r` times the approach far beyond yield, 1 to 3", usual="8/3")


class Bars(Face):
    """Both bars, alike in material and diameter."""

    diameter: Num = key("diameter of the bars", usual="required")
    incident_length: Num = key("length of the incident bar", usual="required unless `infinite`")
    receiving_length: Num = key("length of the receiving bar", usual="required unless `infinite`")
    incident_end: Num = key('`"free"`, `"absorbing"`, `"fixed"`, or a reflection coefficient', usual='`"free"`')
    receiving_end: Num = key("the same of the receiving bar", usual='`"absorbing"`')
    end_radius: Num = key("radius of rounded ends at the sphere", usual="flat")
    infinite: Flag = key("no reflections", False)
    rigid_contact: Flag = key("leaves the bars out of the contact stiffness, `1/E* = (1 - nu²)/E`", False)


class Striker(Table):
    """The striker; `E`, `density` and `diameter` of one that is no piece of the bars."""

    material: str | None = key("a material of bars, for `E` and `density`", usual="that of the bars")
    speed: Num = key("speed `v_0`; the pulse has the particle speed `v_0/2`", usual="required")
    length: Num = key("gives the pulse its duration `2 l_0/c_0`", usual="required without `pulse.duration`")
    E: Num = None
    density: Num = None
    diameter: Num = None


class Pulse(Table):
    """The incident pulse; each shape has keys of its own."""

    preset: Literal["very_short", "short", "long"] | None = key("a pulse of the paper's Fig. 2, in place of `shape`")
    shape: Literal["rectangular", "trapezoid", "ramp", "half_sine", "two_peak", "step", "measured"] = key(
        "shape of the pulse", "rectangular")  # fmt: skip
    duration: Num = key("duration", usual="from the striker")
    rise: Num = key("`trapezoid`, `ramp`: rise")
    fall: Num = key("`trapezoid`: fall")
    t1: Num = key("`two_peak`: time of the first peak")
    level1: Num = key("`two_peak`: its level over `v_0/2`")
    t2: Num = key("`two_peak`: time of the second peak")
    level2: Num = key("`two_peak`: its level over `v_0/2`")
    valley: Num = key("`two_peak`: level half-way between", usual="0.75 of the lower peak")
    file: str | None = key("`measured`: table of time and strain (compression positive), a file beside the study")
    columns: Pair = key("`measured`: names of both columns", (), usual="the first two")
    units: Pair = key("`measured`: units of time, and of strain or volts", (), usual="of the headings")
    factor: float | None = key("`measured`: strain of one volt")
    gain: Num = key("`measured`: true strain over that of the record")


class Contact(Table):
    """The law of the contacts."""

    law: Literal["hertz", "plastic"] = key('`"hertz"`, or `"plastic"`: the softer body yields or crushes', "hertz")
    onset_pressure: Num = key("centre pressure at which a face begins to yield", usual="of the softer body")
    hardness: Num = key('mean pressure of a face that flows fully, or `"onset"`', usual="of the softer body")
    pile_up: Num = key("`a²` over `r` times the approach far beyond yield, 1 to 3", usual="8/3 of a metal, else 2")


class Rig(Table):
    """What loads the sphere; `speed` or `drop_height` where the sphere itself moves."""

    kind: Literal["bars", "impact", "sphere_on_sphere", "drop_weight", "load_cell", "platens"] = key(
        "what loads the sphere", "bars")  # fmt: skip
    speed: Num = key('closing speed of `impact` and `sphere_on_sphere`; a rotor\'s tip: `"1450 rpm at 0.9 m"`')
    drop_height: Num = key("in its place: height that the sphere falls from through air")
    angle: Num = key("between path and surface, above 5 deg", usual='`"90 deg"`, square on')


class Partner(Face):
    """A body that touches the sphere: [target] or [anvil], [other], [hammer], [rod], [platens] or [insert]."""

    kind: Literal["thick", "plate", "bar", "mass"] | None = key(
        'target, anvil: `"thick"`, a `"plate"` that bends, end of a `"bar"`, `"mass"`', usual='`"thick"`')  # fmt: skip
    thickness: Num = key("plate, insert: thickness", usual="required for a plate")
    width: Num = key("plate: width, for the check of its edges")
    mass: Num = key("mass, hammer: its mass", usual="required, or a ball")
    diameter: Num = key("bar, rod, ball: diameter", usual="required")
    length: Num = key("bar, rod: length; a bar without it returns nothing", usual="required for a rod")
    end: Num = key("bar, rod: far end, as the ends of bars", usual='`"free"`')
    face_radius: Num = key("target, anvil, hammer: radius of a rounded face", usual='`"flat"`')
    radius: Num = key("other: radius of the other sphere", usual="required")
    shape: Literal["ball"] | None = key('hammer: `"ball"`: mass and `face_radius` follow from the `diameter`')
    speed: Num = key("hammer: speed at the sphere; platens: speed of the crosshead")
    drop_height: Num = key("hammer: height that it falls from, in place of `speed`")
    gauge: Length | None = key("rod: distance of the gauge from the sphere, for `history`")
    force: Num = key("platens: largest force")
    displacement: Num = key("platens: largest approach of both contacts, in place of `force`")
    loading_rate: Num = key("platens: loading rate, in place of `speed`")
    machine_stiffness: Num = key("platens: stiffness of the machine in series", usual="rigid")


#: by table and kind: what it needs (one of both, where a bar stands between), and what else it takes (* anything)
FORMS: Final[dict[str, tuple[str, str]]] = {
    "sphere": ("E nu density radius", "*"), "insert": ("E", "nu yield_strength thickness"),
    "bars": ("E nu density diameter incident_length receiving_length", "*"),
    "bars infinite": ("E nu density diameter", "*"),
    "striker": ("speed", "*"), "striker timed": ("speed length", "*"), "striker measured": ("", "E density diameter"),
    "pulse rectangular": ("", "duration"), "pulse half_sine": ("", "duration"), "pulse step": ("", ""),
    "pulse trapezoid": ("rise fall", "duration"), "pulse ramp": ("rise", "duration"),
    "pulse two_peak": ("t1 level1 t2 level2", "duration valley"),
    "pulse measured": ("file", "columns units factor gain"),
    "rig impact": ("speed|drop_height", "angle"), "rig sphere_on_sphere": ("speed|drop_height", "angle"),
    "target thick": ("E nu", f"{_FACE} face_radius"),
    "target plate": ("E nu density thickness", f"{_FACE} width face_radius"),
    "target bar": ("E nu density diameter", f"{_FACE} length end face_radius"),
    "target mass": ("E nu mass", f"{_FACE} face_radius"),
    "hammer": ("E nu mass speed|drop_height", f"{_FACE} face_radius"),
    "hammer ball": ("E nu density diameter speed|drop_height", _FACE),
    "other": ("E nu density radius", _FACE), "rod": ("E nu density diameter length", f"{_FACE} end gauge"),
    "platens": ("E nu force|displacement", f"{_FACE} speed loading_rate machine_stiffness"),
}  # fmt: skip


class Gauge(Table):
    """A strain gauge: its bar, and its distance from the sphere [m]."""

    bar: Literal["incident", "receiving", "rod"] = due('`"rod"` in a load cell')
    position: Length = due("distance from the sphere")


class ModelChoice(Table):
    """Which mechanics, and how precisely; `horizon` [s]."""

    fidelity: Literal["full", "massless", "linear"] = key('`"full"`; of the paper: `"massless"`, `"linear"`', "full")
    tolerance: Annotated[float, *_real(ge=1e-12, le=1e-2)] = key("relative error of the integration", 1e-6)
    first_loading_only: Flag = key("end the record when the first reflected wave is back", False)
    whole_record: Flag = key("go on after the first loss of contact, to the horizon (bars; 3 to 75 times the time)",
                             False)  # fmt: skip
    horizon: Seconds | None = key("latest end of the record", usual="eight round trips of the longer bar")
    compare_with_paper: Flag = key("adds the paper's printed massless formulas and the corrected ones", False)


# --- limits and what is asked --------------------------------------------------------------------------------------


class LimitTable(Table):
    """A strength, and the quantity or criterion that is held against it."""

    quantity: str | None = key("a quantity of `uqsphere list quantities`", usual="required, or `criterion`")
    criterion: Literal[*CRITERIA] | None = key("in place of `quantity`: one of `uqsphere list criteria`")  # type: ignore[valid-type]
    strength: Any = due("value, distribution, or a file with tests or draws")
    strength_is: Literal["hertz", "pressure"] | None = key(
        '`"hertz"`: computed from a force by Hertz; `"pressure"`: the true one', usual="required if `plastic`"
    )
    aim: Literal["survive", "break"] = key("the quantity must stay below the strength, or exceed it", "survive")
    target: Share | None = key('largest accepted failure probability, `0.01` or `"1 %"`')
    model_factor: Any = key("factor on the quantity for what the model leaves out; may scatter", usual="`1`")
    fracture: Flag | None = key("whether exceeding it breaks the sphere", usual="by the quantity")
    energy_is: Literal["contact", "sphere", "input"] | None = key(
        "of `specific_energy`: stored in both bodies, in the sphere, or offered", usual="required but for bars"
    )
    modulus: Annotated[float, *_parameter("modulus")] | None = key(
        "Weibull modulus of a weakest link", usual="that of the strength")  # fmt: skip
    reference_volume: Annotated[float, *_parameter("reference_volume")] | None = key("volume of a volume strength")
    reference_area: Annotated[float, *_parameter("reference_area")] | None = key("area of a surface strength")
    largest_energy: Annotated[float, *_parameter("largest_energy")] | None = key("upper bound of a fracture energy")
    rate_0: Annotated[float, *_parameter("rate_0")] | None = key("strain rate at which a slow strength is doubled")
    platens: Any = key('what it was measured between: `"bars"`, `"rigid"`, a material, or `E` and `nu`', usual="rigid")

    @model_validator(mode="after")
    def _one_demand(self) -> LimitTable:
        if self.quantity is None and self.criterion is None:
            raise Fault('quantity is missing: add quantity = "p_max", say, or a criterion', "quantity")
        if self.quantity is not None and self.criterion is not None:
            raise Fault("quantity and criterion both say what is compared: leave one of them out", "quantity")
        if self.energy_is is not None and self.criterion != "specific_energy":
            raise Fault("energy_is belongs to the criterion specific_energy: leave it out", "energy_is")
        return self


class Observations(Table):
    """A distribution from a file beside the study: a column, crushing tests of spheres, or the draws of a fit."""

    dist: Literal["empirical"] | None = key("may be left out where a file is named")
    file: str | None = key("CSV or .xlsx beside the study")
    draws: str | None = key(
        "in its place: draws of a fit, with columns `distribution` (lognormal or weibull), `scale`, `shape`, and if "
        "need be `least`, `bound`, `tests`, and their `diameter` with a `size_exponent`")  # fmt: skip
    decimal: Literal[".", ","] | None = key("decimal mark, where a column can be read both ways")
    column: str | None = key("column of observations, in the quantity itself")
    unit: str | None = key("its unit", usual="that of the heading")
    force: str | None = key("in place of `column`: forces at which spheres broke between platens")
    force_unit: str | None = key("unit of the forces", usual="that of the heading")
    diameter: str | None = key("column of their diameters, or one length", usual="required with `force`")
    diameter_unit: str | None = key("unit of the diameters", usual="that of the heading")
    rate: str | None = key("column of loading rates, with their unit in the heading")
    platens: Any = key(
        'what it was measured between: `"bars"`, `"rigid"`, a material, or `E` and `nu`', "bars")  # fmt: skip
    censored: str | None = key("column of flags: 1 for a test stopped before a failure (right-censored)")
    count: str | None = key("column of numbers of equal tests", usual="one a row")
    modulus: Positive | None = key("Weibull modulus of the tests that is known; then few failures, or none, are enough")
    fit: str | None = key("`kde`, `steps`, or a distribution", usual="`weibull` of forces, else `kde`")
    unbiased: Flag = key("takes the bias of few tests out of the modulus or the scatter", False)
    synthetic: Flag = key("the observations are synthetic, so that no verdict is established by them", False)
    lower: Any = None
    upper: Any = None


class Dependence(Table):
    """One rank correlation, Spearman's or Kendall's, for every pair of the names; `dof` of a Student t copula."""

    of: Annotated[tuple[str, ...], *_several(2, 1_000)] = due("random numbers, two or more")
    spearman: Correlation | None = key("Spearman's rank correlation; or `kendall`", usual="required")
    kendall: Correlation | None = key("Kendall's rank correlation, in its place")
    copula: Literal["gaussian", "student_t"] = key('`"gaussian"`, or `"student_t"` with `dof`', "gaussian")
    dof: Annotated[float, *_real(ge=1.0, le=1000.0)] | None = key("degrees of freedom of a `student_t`")

    @model_validator(mode="after")
    def _one_strength(self) -> Dependence:
        if self.spearman is not None and self.kendall is not None:
            raise Fault("spearman is given too: one of them says how strong the dependence is", "kendall")
        if self.spearman is None and self.kendall is None:
            raise Fault("spearman is missing: add a rank correlation between -1 and 1, or kendall in its place")
        if self.copula == "student_t" and self.dof is None:
            raise Fault("dof is missing: a Student t copula needs its degrees of freedom, 4 say")
        if self.copula != "student_t" and self.dof is not None:
            raise Fault(f'dof belongs to copula = "student_t", the copula here is {shown(self.copula)}', "dof")
        return self


class Accuracy(Table):
    """Half-widths of the 95 % intervals: mean and quantile over sd, sobol absolute, probability relative."""

    mean: Positive = 0.005
    quantile: Positive = 0.02
    sobol: Positive = 0.02
    probability: Positive = 0.05


class Budget(Table):
    """Where a run stops at the latest; `time` [s]."""

    evaluations: Annotated[int, *_real(int, gt=0)] = 2_000_000
    time: Seconds = 600.0


class Analysis(Table):
    """What is asked, how precisely, and at what cost; `cost` and `time_limit` [s] of one black-box evaluation."""

    quantities: Names = key(
        "what is answered to the accuracy below; quantities of limits are described beside", (),
        usual='`["p_max", "contact_duration"]`; outputs of a black box')  # fmt: skip
    accuracy: Accuracy = key(
        "half-widths of 95 % intervals: mean and quantile over the standard deviation, sobol absolute, probability "
        "relative", Accuracy)  # fmt: skip
    budget: Budget = key("the latest end of the run", Budget, usual='`{ evaluations = 2_000_000, time = "10 min" }`')
    quantiles: Shares = key("probabilities of the quantiles", (0.01, 0.05, 0.5, 0.95, 0.99))
    methods: Methods = key(f"`auto`, or some of {_METHODS}", ("auto",))
    second_order: Flag = key("Sobol' indices of all pairs of inputs as well", False)
    failure_modes: Literal["all", "given"] = key(
        '`"all"`: a rock is judged by failure modes without a limit too, by library strengths', "all")  # fmt: skip
    on_failure: OnFailure = key(
        'failed evaluations: `"bound"` counts each once as exceeding and once as not; `"drop"` leaves out up to 1 %, '
        'a share such as `"5 %"` up to that', "abort")  # fmt: skip
    cost: Seconds | None = key("time of one evaluation of a black box", usual="measured")
    time_limit: Seconds | None = key("longest time of one evaluation of a black box; a longer one has failed")

    @property
    def policy(self) -> str:
        """What becomes of failed evaluations: abort, bound or drop."""
        return self.on_failure if isinstance(self.on_failure, str) else "drop"

    @property
    def drop_limit(self) -> float:
        """The largest share of failed evaluations that is left out."""
        return 0.01 if isinstance(self.on_failure, str) else self.on_failure


class MarginsTable(Table):
    """The inverse question: at which value of one number is a failure probability reached?"""

    solve: str = due('the free number: `"striker.speed"`, `"limits.NAME.strength"`')
    between: Annotated[tuple[Any, ...], *_several(2, 2)] = due("lowest and highest value")
    for_probability: Shares = key("probabilities that the quantity exceeds the strength", (0.01, 0.1, 0.5, 0.9, 0.99))


class Outputs(Table):
    """What a black box answers."""

    names: Annotated[tuple[Name, ...], *_several()] = due('names of the outputs, `["y"]`')


class Document(Table):
    """A study file."""

    title: str = key("heading of the report; not part of the study's hash", "", usual="the file's name")
    seed: Annotated[int, *_real(int, ge=0)] = key("the same seed gives the same answers", 0)
    sphere: Sphere | None = None
    bars: Bars | None = None
    striker: Striker | None = None
    pulse: Pulse | None = None
    contact: Contact | None = None
    rig: Rig | None = None
    target: Partner | None = None
    anvil: Partner | None = None
    other: Partner | None = None
    hammer: Partner | None = None
    rod: Partner | None = None
    platens: Partner | None = None
    insert: Partner | None = None
    model: ModelChoice | None = None
    inputs: Annotated[dict[Name, Any], Field(max_length=1000)] | None = None
    outputs: Outputs | None = None
    limits: dict[Name, LimitTable] = Field(default_factory=dict, max_length=50)
    dependence: tuple[Dependence, ...] = Field(default=(), max_length=100)
    gauges: tuple[Gauge, ...] = Field(default=(), max_length=20)
    analysis: Analysis = Field(default_factory=Analysis)
    margins: MarginsTable | None = None

    @field_validator(*SCENE, mode="before")
    @classmethod
    def _enter(cls, raw: Any, info: ValidationInfo) -> Any:
        """Tell the numbers of a table whose they are."""
        if info.context is not None:
            info.context.table = info.field_name
        return raw


# --- what pydantic finds, in the words of a study ------------------------------------------------------------------

_FOUND: Final = {
    "string_type": "where a text in quotes is required", "bool_type": "where true or false is required",
    "int_type": "where a whole number is required", "float_type": "where a number is required",
    "float_parsing": "where a number is required", "tuple_type": "where an array is required",
    "dict_type": "where a table is required", "model_type": "where a table is required",
    "greater_than": "it must be above {gt:g}", "greater_than_equal": "it must be at least {ge:g}",
    "less_than": "it must be below {lt:g}", "less_than_equal": "it must be at most {le:g}",
    "string_pattern_mismatch": "a name takes up to 64 letters, digits, _ and -, and begins with a letter",
    "too_short": "{min_length} or more are required", "too_long": "at most {max_length} are allowed",
}  # fmt: skip


def fault_text(fault: Any, place: Place, table: Any = Document) -> tuple[str, str]:
    """What to say of one fault that pydantic reports, and the key that was meant where one is unknown."""
    for part in place[:-1]:
        table = _table_in(table.model_fields[part].annotation) or table if part in table.model_fields else table
    kind, name, context = fault["type"], str(place[-1]) if place else "", fault.get("ctx", {})
    found = f"found {shown(fault['input'])}"
    if kind == "value_error":
        return str(context["error"]), ""
    if kind == "missing":
        return f"{name} is missing: {table.model_fields[name].description.replace('`', '')}", ""
    if kind == "extra_forbidden":
        near = suggestion(name, table.model_fields)
        known = near or f"; known here: {one_of(table.model_fields)}"
        return f"unknown key {shown(name)}{known}", near.split("'")[1] if near else ""
    if kind == "literal_error":
        words = re.findall(r"'([^']*)'", context["expected"])
        return f"{found}, allowed: {one_of(words)}{suggestion(fault['input'], words)}", ""
    if kind.startswith("too_"):
        found = f"found {context['actual_length']} {name}"
    return f"{found}, {_FOUND.get(kind, 'which cannot stand here').format(**context)}", ""


def _table_in(annotation: Any) -> Any:
    """The table that a key holds, one or several; None for a value."""
    if isinstance(annotation, type) and issubclass(annotation, Table):
        return annotation
    return next((found for part in get_args(annotation) if (found := _table_in(part))), None)

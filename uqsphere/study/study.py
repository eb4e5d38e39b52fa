"""What a study is: the frozen nouns that everything above the parser works with, all values in SI."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import numpy as np

from uqsphere.arrays import Array
from uqsphere.files import Json
from uqsphere.materials import Material, Property, library
from uqsphere.mechanics.bars import section
from uqsphere.mechanics.contact import sphere_mass
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.outputs import OUTPUTS, PATHS
from uqsphere.mechanics.pulses import MeasuredPulse
from uqsphere.quantities import INPUTS
from uqsphere.study.document import Accuracy, Analysis, Dependence, Gauge, ModelChoice
from uqsphere.study.numbers import SHARE_WORTH_A_WORD, Tested
from uqsphere.uq import Law, make_law

if TYPE_CHECKING:
    from chaospy import Distribution

    from uqsphere.feed.answers import FeedPlan
    from uqsphere.study.tests import TestsPlan
    from uqsphere.uq import Dependence as Tie
    from uqsphere.uq import Joint
    from uqsphere.uq.interop import SalibDesign


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A strength that a quantity is held against; strength in SI, model_factor a plain number.

    With a criterion, `quantity` is its demand with these parameters (SI), by a name of the limit's own.  `fracture`:
    whether exceeding it breaks the sphere; None leaves that to the quantity.  `platens`: E (infinite: rigid) and nu of
    what the strength was measured between, in a test that is not the study's own rig; None: it is not carried.
    `tested`: what the tests behind the strength were done at, if it has such.
    """

    name: str
    quantity: str
    strength: Law | float
    aim: str = "survive"
    model_factor: Law | float = 1.0
    target: float | None = None
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    fracture: bool | None = None
    platens: tuple[float, float] | None = None
    tested: Tested | None = None


@dataclass(frozen=True, kw_only=True)
class Margins:
    """The inverse question: the values along the axis with these probabilities of exceeding each limit.

    `family` asks for a curve at each of some values of another number of the scene; `bars_elastic` for the value at
    which the bars yield; `against` for the curves over that quantity too.
    """

    axis: Axis
    for_probability: tuple[float, ...] = (0.01, 0.1, 0.5, 0.9, 0.99)
    family: Family | None = None
    bars_elastic: bool = False
    against: str | None = None


@dataclass(frozen=True, kw_only=True)
class Family:
    """Another number of the scene and the values (SI) at which each curve is drawn again."""

    path: str
    values: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class EndImpedance:
    """Impedance of a bar's far end [kg/s], real and imaginary part, over ascending frequencies [Hz]."""

    frequency: tuple[float, ...]
    real: tuple[float, ...]
    imaginary: tuple[float, ...]


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a default came from, and whether that source was seen."""

    text: str
    seen: bool


@dataclass(frozen=True, kw_only=True)
class Particles:
    """What particles are of: E [Pa], nu, density [kg/m³], and the name of the material where it has one."""

    E: float
    nu: float
    density: float
    name: str = ""


class _FromTables(type):
    """Calls a class with the tables of a study file, as well as with the parts of a study that was read."""

    #: reads the tables; set where studies are read, since that needs this class
    read: ClassVar[Callable[..., Study]]

    def __call__(cls, *positional: Any, **given: Any) -> Any:
        if "path" in given:
            return super().__call__(*positional, **given)
        if positional:
            raise TypeError("Study takes the tables of a study file by their names: Study(inputs={...}, ...)")
        outputs = given.get("outputs")
        if isinstance(outputs, str | list | tuple):
            given["outputs"] = {"names": [outputs] if isinstance(outputs, str) else list(outputs)}
        return cls.read(given)


@dataclass(frozen=True, kw_only=True)
class Study(metaclass=_FromTables):
    """A validated study: `Study(title=..., inputs=..., outputs=..., limits=..., margins=..., analysis=...)`.

    The arguments are the tables of a study file as mappings, with laws of this package, of scipy.stats or chaospy where
    a number scatters, and `outputs` a name or several; they make the same document, which `text` has.  A file is read
    by `load_study`.

    >>> from scipy import stats
    >>> Study(inputs={"load": stats.norm(3.0, 0.5)}, outputs="y", limits={"high": {"quantity": "y", "strength": 5.0,
    ...       "aim": "survive"}}, analysis={"budget": {"evaluations": 1000}}, title="A beam")
    <Study 'A beam': 1 random input, limits high, black box>

    fixed : every fixed number by dotted path (black box: bare name), SI, defaults included; a bar end is its velocity
    reflection coefficient.  What a scene does not have (lengths of infinite bars, a striker's length beside a pulse of
    its own duration, the radius of flat bar ends) is absent.
    random : mapping of str to Law; every scattered number, in the order of the file.
    given : mapping of str to mapping; the parameters of each law as the file gives them, in SI (``mean`` and ``cov``,
    say); `Law.with_mean` reads it.  The keys are those of `random` and ``limits.NAME.strength``,
    ``limits.NAME.model_factor``.
    warnings : what a user should know and what does not stop the study.
    record : MeasuredPulse or None; the pulse of a measured record; `striker.speed` then follows from it and is none of
    the numbers.
    overrides : what was set from outside the file, as PATH=VALUE; its effect is in the other attributes.
    gauges : tuple of Gauge; where `uqsphere history` puts gauges; no answer of a run depends on them.
    receiving_damper : EndImpedance or None; the receiving bar's far end against frequency, which only `uqsphere
    history` can follow.
    services : mapping of str to Study; the machines that are asked, each a study of its own.
    made_up : the random numbers whose observations the file calls made up.
    particles : Particles or None; what the particles of tests and of a feed are of, where the file has any.
    feed : FeedPlan or None; what is asked of a feed, which `uqsphere feed` answers.
    tests : TestsPlan or None; tests of single particles, which `uqsphere fit` makes a law of.
    """

    title: str
    seed: int
    path: Path
    text: str
    black_box: bool
    fixed: Mapping[str, float]
    random: Mapping[str, Law]
    given: Mapping[str, Mapping[str, float]]
    options: Mapping[str, str | bool | int]
    materials: Mapping[str, str]
    sources: Mapping[str, Source]
    model: ModelChoice
    limits: tuple[Limit, ...]
    dependence: tuple[Dependence, ...]
    analysis: Analysis
    margins: Margins | None
    outputs: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    overrides: tuple[str, ...] = ()
    record: MeasuredPulse | None = None
    gauges: tuple[Gauge, ...] = ()
    receiving_damper: EndImpedance | None = None
    made_up: tuple[str, ...] = ()
    services: Mapping[str, Study] = field(default_factory=dict)
    particles: Particles | None = None
    feed: FeedPlan | None = None
    tests: TestsPlan | None = None

    @property
    def rig(self) -> str:
        """What loads the sphere: `bars`, `impact`, ..., or `none` where only the services are run."""
        return str(self.options.get("rig.kind", "bars"))

    @property
    def parts(self) -> dict[str, Study]:
        """Every study that is run: the rig's own by an empty name, where it has one, and the services."""
        return {**({} if self.rig == "none" else {"": self}), **self.services}

    def __repr__(self) -> str:
        parts = [f"{len(self.random)} random input{'' if len(self.random) == 1 else 's'}"]
        parts += [f"limits {', '.join(limit.name for limit in self.limits)}"] if self.limits else []
        parts += [f"services {', '.join(self.services)}"] if self.services else []
        return f"<Study {self.title!r}: {', '.join([*parts, 'black box' if self.black_box else self.rig])}>"

    @property
    def hash(self) -> str:
        """SHA-256 of the meaning: the same where two files differ only in title, gauges, comments or layout."""
        meaning = {key: value for key, value in self.resolved().items() if key not in ("title", "gauges")}
        text = json.dumps(meaning, sort_keys=True, separators=(",", ":"), allow_nan=False, ensure_ascii=True)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def demands(self) -> dict[str, tuple[str, Mapping[str, float]]]:
        """Quantities that a limit's criterion adds: name -> criterion and its parameters."""
        return {limit.quantity: (limit.criterion, limit.parameters) for limit in self.limits if limit.criterion}

    def laws(self) -> dict[str, Law]:
        """Every random variable and its law: inputs in file order, then strengths and model factors."""
        laws = dict(self.random)
        for limit in self.limits:
            for part, value in (("strength", limit.strength), ("model_factor", limit.model_factor)):
                if isinstance(value, Law):
                    laws[f"limits.{limit.name}.{part}"] = value
        return laws

    def inputs(self) -> Joint:
        """The random variables of `laws` with their dependence, as the uncertainty side reads them."""
        from uqsphere.uq import make_joint

        laws = self.laws()
        return make_joint(tuple(laws), tuple(laws.values()), [tie_of(group) for group in self.dependence])

    def to_chaospy(self) -> Distribution:
        """The joint law of the random inputs as a distribution of chaospy; `uqsphere.uq.interop.joint_to_chaospy`."""
        from uqsphere.uq.interop import joint_to_chaospy

        return joint_to_chaospy(self.inputs().only(tuple(self.random)))

    def to_salib(self, count: int = 1024, *, second: bool = False) -> SalibDesign:
        """The study's own design of Sobol' indices as a problem and rows of SALib; `uqsphere.uq.interop.to_salib`."""
        from uqsphere.uq.interop import to_salib

        return to_salib(self.inputs().only(tuple(self.random)), count, second=second, seed=self.seed)

    def at_means(self) -> dict[str, float]:
        """Every number of the scene (or black-box input), the random ones at their nominal mean; SI."""
        return {**self.fixed, **{name: law.nominal_mean() for name, law in self.random.items()}}

    def _model_json(self) -> dict[str, Json] | None:
        """The mechanics; `stochastic` came later, and changes the hash of a study that has it alone."""
        if self.black_box:
            return {"stochastic": True} if self.model.stochastic else None
        return {name: value for name, value in asdict(self.model).items() if name != "stochastic"}

    def resolved(self) -> dict[str, Json]:
        """The study as plain JSON values: SI, every default explicit, no infinities."""
        laws, later = self.laws(), dict[str, Json]()
        # the order of the random variables decides which point of a sequence goes to which of them
        meaning = {
            "title": self.title,
            "seed": self.seed,
            "kind": "black box" if self.black_box else "scene",
            "fixed": dict(self.fixed),
            "random": {name: law_json(law, self.given.get(name, {})) for name, law in laws.items()},
            "order": list(laws),
            "options": dict(self.options),
            "materials": dict(self.materials),
            "sources": {name: asdict(source) for name, source in self.sources.items()},
            "model": self._model_json(),
            "limits": {limit.name: _limit_json(limit) for limit in self.limits},
            "dependence": [_tie_json(group) for group in self.dependence],
            "analysis": _analysis_json(self.analysis),
            "margins": _margins_json(self.margins),
            "outputs": self.outputs,
        }
        for name in ("record", "receiving_damper"):
            later[name] = asdict(found) if (found := getattr(self, name)) is not None else None
        later["gauges"] = [asdict(gauge) for gauge in self.gauges]
        later["services"] = {name: own.hash for name, own in self.services.items()}
        later["made_up"] = self.made_up
        later["feed"] = self.feed and dict(self.feed.meaning)
        later["tests"] = self.tests and dict(self.tests.meaning)
        plain: dict[str, Json] = json.loads(json.dumps(meaning | {key: own for key, own in later.items() if own}))
        return plain


def tie_of(group: Dependence) -> Tie:
    """A dependence as the uncertainty side reads it."""
    from uqsphere.uq import Dependence as Tie

    return Tie(of=group.of, spearman=group.spearman, kendall=group.kendall, copula=group.copula, dof=group.dof)


def _tie_json(group: Dependence) -> dict[str, Json]:
    """What was given, and nothing else: a key that is new must not change the hash of a study without it."""
    keys = ("of", "copula", "spearman", "kendall", "dof")
    return {key: own for key in keys if (own := getattr(group, key)) is not None}


def _margins_json(margins: Margins | None) -> dict[str, Json] | None:
    """What was asked, and nothing else, as with dependence."""
    if margins is None:
        return None
    axis = margins.axis
    own = {"solve": axis.path, "between": (axis.low, axis.high), **asdict(margins)}
    return {key: value for key, value in own.items() if key != "axis" and value not in (None, False)}


def _analysis_json(analysis: Analysis) -> dict[str, Json]:
    """The request; keys that came later only where they are given, so that they change no other study's hash."""
    table = asdict(analysis)
    if analysis.accuracy.curve == Accuracy.curve:
        del table["accuracy"]["curve"]
    table["accuracy"] = {key: value for key, value in table["accuracy"].items() if math.isfinite(value)}
    later: dict[str, Json] = {
        "cost": None, "rows_per_call": None, "at_once": 1, "time_limit": None, "ways": Analysis.ways, "fields": {},
    }  # fmt: skip
    return {key: value for key, value in table.items() if key not in later or value != later[key]}


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def law_json(law: Law, given: Mapping[str, float]) -> dict[str, Json]:
    return {
        "dist": law.family.name,
        "parameters": dict(law.parameters),
        "given": dict(given),
        "lower": _finite(law.lower),
        "upper": _finite(law.upper),
        "data": list(law.data),
        **({"censored": list(law.censored)} if law.censored else {}),
        **({"draws": [list(draw) for draw in law.draws]} if law.draws else {}),
    }


def _limit_json(limit: Limit) -> dict[str, Json]:
    def fixed(value: Law | float) -> float | str:
        return "random" if isinstance(value, Law) else value

    return {
        "quantity": limit.quantity,
        "strength": fixed(limit.strength),
        "aim": limit.aim,
        "model_factor": fixed(limit.model_factor),
        "target": limit.target,
        **({"criterion": limit.criterion, "parameters": dict(limit.parameters)} if limit.criterion else {}),
        **({} if limit.fracture is None else {"fracture": limit.fracture}),
        **({} if limit.platens is None else {"platens": [_finite(value) for value in limit.platens]}),
    }


# --- all ways in which a rock sphere can break --------------------------------------------------------------


#: the ways, by the place in the sphere where each begins, and the criterion that is assumed for it
_WAYS: Final = {"contact": "contact_pressure", "rim": "ring_crack", "core": "weakest_link_volume",
                "energy": "specific_energy"}  # fmt: skip
#: what the ways are called
_CALLED: Final = {"contact": "contact pressure", "rim": "ring crack", "core": "core tension",
                  "energy": "fracture energy"}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Way:
    """A way to break with an assumed strength: its limit, and the strength at both ends of the library's 95 % range."""

    called: str
    limit: Limit
    weak: Law
    strong: Law
    source: str
    seen: bool


@dataclass(frozen=True, kw_only=True)
class Ways:
    """The ways that a study has no limit for: those assumed, and why the others are not judged."""

    assumed: tuple[Way, ...] = ()
    not_judged: Mapping[str, str] = field(default_factory=dict)


def breaks_by(limit: Limit) -> str:
    """Which way of `_WAYS` a limit is on; "force" for one on the force itself, empty where it is no fracture.

    >>> breaks_by(Limit(name="a", quantity="core_tension", strength=1e7))
    'core'
    """
    if limit.criterion is None and limit.quantity not in PATHS:
        return ""
    entry = OUTPUTS[limit.quantity] if limit.criterion is None else CRITERIA[limit.criterion]
    return "energy" if entry.follows == "energy" else entry.place or "force"


def means_fracture(limit: Limit) -> bool:
    """Whether a limit is on a way to break; one that must break means it, also where it is not counted twice."""
    return breaks_by(limit) != "" and (limit.fracture is not False or limit.aim == "break")


def ways_of(study: Study) -> Ways:
    """The ways beside the limits of a study; none for what is no rock, and where ``[analysis] ways = "given"``."""
    rock = library()["sphere"].get(study.materials.get("sphere", ""))
    given = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if study.black_box or study.analysis.ways == "given" or rock is None or not rock.rock or not given:
        return Ways()
    assumed, not_judged = [], {}
    for place, called in _CALLED.items():
        if place in given:
            continue
        found = _assumed(rock, place, 2.0 * study.at_means()["sphere.radius"])
        if isinstance(found, str):
            not_judged[called] = found
        else:
            assumed.append(found)
    return Ways(assumed=tuple(assumed), not_judged=not_judged)


def _assumed(rock: Material, place: str, diameter: float) -> Way | str:
    """The way with the strength of the library for particles of a diameter [m], or why there is none."""
    key = {"contact": "contact_strength", "rim": "fracture_toughness", "core": "tensile_strength",
           "energy": "fracture_energy"}[place]  # fmt: skip
    entry, own = rock.properties.get(key), {}
    if entry is None or entry.range is None:
        if place == "core" and entry is not None:
            return "no strength: the library's tensile strength is of no known volume"
        return f"no strength: neither the study nor the library has one for {rock.title.lower()}"
    if place == "core":
        # the strength of a specimen says nothing of a volume that is a million times smaller, but by the size law
        modulus = rock.properties.get("weibull_modulus")
        if "volume" not in entry.further or modulus is None:
            return "no strength: a tensile strength needs its volume and a Weibull modulus to be carried to the core"
        own = {"modulus": modulus.value, "reference_volume": entry.further["volume"]}
    laws = [_law(place, entry, value, own, diameter) for value in (entry.range[0], entry.value, entry.range[1])]
    name, criterion = f"{_CALLED[place]} (assumed)", CRITERIA[_WAYS[place]]
    quantity = criterion.quantity if criterion.quantity and not own else f"{criterion.name}.{name}"
    limit = Limit(name=name, quantity=quantity, strength=laws[1], criterion=criterion.name if own else None,
                  parameters=own)  # fmt: skip
    return Way(called=_CALLED[place], limit=limit, weak=laws[0], strong=laws[2], source=entry.source, seen=entry.seen)


def _law(place: str, entry: Property, value: float, own: Mapping[str, float], diameter: float) -> Law:
    """The law of specimens whose typical strength is a value: Weibull's by its modulus, else lognormal."""
    if place == "core":
        return make_law("weibull", {"mean": value, "modulus": own["modulus"]})
    if place == "energy":
        # the median of particles of this size (Tavares and King 1998, equation 15)
        median = value * (1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"])
        return make_law("lognormal", {"log_mean": math.log(median), "log_sd": entry.cov})
    return make_law("lognormal", {"mean": value, "cov": entry.cov})


# --- the free scalar of an inverse question: where it may lie, and what of a study it moves ------------


#: kinetic energy of the striker over the mass of the sphere: a free scalar that is no number of the file
ENERGY: Final = "striker.specific_energy"
SPEED: Final = "striker.speed"
_LIMITS, _STRENGTH = "limits.", ".strength"


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A scalar that is free between two values (SI).

    `kind`: a "number" of the scene or of the model's inputs (the mean of its law, where it scatters), the "energy" of
    the striker over the mass of each row's sphere, or the mean "strength" of a limit, all its values in proportion.
    """

    path: str
    low: float
    high: float
    kind: Literal["number", "energy", "strength"] = "number"

    @property
    def limit(self) -> str | None:
        """The limit whose strength is free."""
        return limit_of(self.path) if self.kind == "strength" else None

    @property
    def moves_rows(self) -> bool:
        """Whether the answers of the model depend on the scalar; else the rows of one value serve all."""
        return self.kind != "strength"

    @property
    def logarithmic(self) -> bool:
        """Whether the scalar is positive, so that it is taken in ratios."""
        return self.low > 0.0

    def grid(self, count: int) -> list[float]:
        """`count` values from one end to the other, in equal ratios or steps."""
        return spaced(self.low, self.high, count)

    def value(self, share: Array | float) -> Array:
        """The value a share of the way from one end to the other, in ratios or steps."""
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)

    def germ(self, value: float) -> float:
        """The place of a value as a number in [-1, 1], the inverse of `value`."""
        low, high = self.low, self.high
        if self.logarithmic:
            low, high, value = math.log(low), math.log(high), math.log(value)
        return 2.0 * (value - low) / (high - low) - 1.0

    def move(self, study: Study, value: float) -> Study:
        """The study whose rows are drawn where the scalar has a value: itself, unless the scalar is one of its numbers.

        Raises LawError where a random number has no law with this mean.
        """
        return with_number(study, self.path, value) if self.kind == "number" else study

    def place(self, study: Study, physical: Array, value: float) -> tuple[tuple[str, ...], Array]:
        """Names and values (R, n, d) of the random inputs, drawn from the moved study, where the scalar has a value.

        An energy is imposed on every row by its own speed, which keeps its ratio to its mean where it scatters.
        """
        names = tuple(study.random)
        if self.kind != "energy":
            return names, physical
        speed = _speed_at_energy(study, physical, value)
        if SPEED not in names:
            return (*names, SPEED), np.concatenate([physical, speed[:, :, None]], axis=2)
        physical = physical.copy()
        physical[:, :, names.index(SPEED)] = speed
        return names, physical

    def demand_factor(self, limit: Limit, value: float) -> float:
        """What the demands of a limit are multiplied by where the scalar has a value, in place of its free strength."""
        if self.limit != limit.name:
            return 1.0
        nominal = limit.strength.nominal_mean() if isinstance(limit.strength, Law) else limit.strength
        return nominal / value

    def fix(self, study: Study, limit: Limit, value: float) -> tuple[Study, Limit] | str:
        """The study and a limit with the scalar at a value, an energy as that of the mean scene; or why there is none.

        Raises LawError as `move`.
        """
        if self.kind == "strength":
            if self.limit == limit.name and isinstance(limit.model_factor, Law):
                return "the strength is the free number and the model factor is random"
            if self.limit == limit.name and not isinstance(limit.model_factor, Law):
                limit = replace(limit, model_factor=limit.model_factor * self.demand_factor(limit, value))
            return study, limit
        if self.kind == "number":
            return self.move(study, value), limit
        if SPEED in study.random and "mean" not in study.given[SPEED]:
            return "the speed scatters by a law that is not given by its mean"
        means = study.at_means()
        return with_number(
            study, SPEED, float(np.sqrt(2.0 * value * _sphere_mass(means) / _striker_mass(means)))
        ), limit


def make_axis(path: str, low: float, high: float, *, limits: Mapping[str, str], black_box: bool) -> Axis:
    """The axis of a path; `limits` has the quantities of the limits by the paths of their strengths."""
    if path in limits:
        return Axis(path=path, low=low, high=high, kind="strength")
    return Axis(path=path, low=low, high=high, kind="energy" if path == ENERGY and not black_box else "number")


# --- paths of the random variables of limits -----------------------------------------------------------


def strength_name(limit: str) -> str:
    """The path of a limit's strength."""
    return f"{_LIMITS}{limit}{_STRENGTH}"


def limit_of(path: str) -> str | None:
    """The limit that a strength or a model factor belongs to; None for a number of the scene.

    >>> limit_of("limits.crushing.strength"), limit_of("striker.speed")
    ('crushing', None)
    """
    return path.removeprefix(_LIMITS).rpartition(".")[0] if path.startswith(_LIMITS) else None


def quantity_of(path: str, limits: Mapping[str, str]) -> str:
    """The name whose unit a number has: a strength that of its limit's quantity, by the limits' names.

    >>> quantity_of("limits.crushing.strength", {"crushing": "p_max"}), quantity_of("striker.speed", {})
    ('p_max', 'striker.speed')
    """
    return limits.get(limit_of(path) or "", path) if path.endswith(_STRENGTH) else path


# --- moving ------------------------------------------------------------------------------------------------


def spaced(low: float, high: float, count: int) -> list[float]:
    """`count` values from low to high in equal ratios, or in equal steps where they are not positive."""
    inner = np.geomspace(low, high, count) if low > 0.0 else np.linspace(low, high, count)
    return [low, *(float(value) for value in inner[1:-1]), high]


def with_number(study: Study, path: str, value: float) -> Study:
    """The study with a number at `value`: the mean of its law, or the number itself."""
    if path in study.random:
        moved = _kept_inside(study.random[path].with_mean(value, study.given[path]), path)
        return replace(study, random={**study.random, path: moved})
    return replace(study, fixed={**study.fixed, path: value})


def _kept_inside(law: Law, path: str) -> Law:
    """A moved law, cut where its number has no meaning if a share of it that counts has come to lie there.

    A height of 12 mm with a standard deviation of 0.5 mm is never negative; one of 0.2 mm with the same often would be.
    """
    quantity = INPUTS.get(path)
    if quantity is None:
        return law
    low = np.array([quantity.lower])
    if law.lower < quantity.lower and float(law.cdf(low)[0]) > SHARE_WORTH_A_WORD:
        law = replace(law, lower=quantity.lower)
    return law


def _sphere_mass(of: Mapping[str, float] | Mapping[str, Array]) -> Array:
    return np.asarray(sphere_mass(of["sphere.radius"], of["sphere.density"]))


def _striker_mass(of: Mapping[str, float] | Mapping[str, Array]) -> Array:
    return np.asarray(of["bars.density"] * section(of["bars.diameter"]) * of["striker.length"])


def _speed_at_energy(study: Study, physical: Array, energy: float) -> Array:
    """Speeds (R, n) at which the striker's kinetic energy is `energy` times the mass of each row's sphere."""
    names = tuple(study.random)
    columns = {name: np.full(physical.shape[:2], value) for name, value in study.fixed.items()}
    columns |= {name: np.asarray(physical[:, :, k]) for k, name in enumerate(names)}
    speed = np.sqrt(2.0 * energy * _sphere_mass(columns) / _striker_mass(columns))
    if SPEED in study.random:
        speed = speed * columns[SPEED] / study.random[SPEED].nominal_mean()
    return np.asarray(speed)

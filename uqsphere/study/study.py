"""What a study is: the frozen nouns that everything above the parser works with, all values in SI."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, TypedDict, Unpack

import numpy as np

from uqsphere.arrays import Array, special
from uqsphere.files import Json
from uqsphere.materials import Material, library
from uqsphere.mechanics.criteria import CRITERIA
from uqsphere.mechanics.outputs import OUTPUTS, PATHS
from uqsphere.mechanics.pulses import MeasuredPulse
from uqsphere.quantities import INPUTS
from uqsphere.study.document import NOTABLE, Analysis, Dependence, Gauge, ModelChoice
from uqsphere.uq import Law, make_law

if TYPE_CHECKING:
    from chaospy import Distribution
    from pandas import DataFrame

    from uqsphere.results import Run
    from uqsphere.uq import Dependence as Tie
    from uqsphere.uq import Joint
    from uqsphere.uq.interop import SalibDesign


@dataclass(frozen=True, kw_only=True)
class Tested:
    """Crushing tests of spheres behind a strength: what was measured, and the law of the force at failure.

    diameter: the mean one [m], to which `law` belongs.  forces [N], diameters [m], suspended: of every test.  platens:
    E [Pa], infinite if rigid, and nu.  sphere: E, nu, density and what else
    `uqsphere.study.strength.equivalent_force` takes.  law: of the
    force at failure of a sphere of `diameter`.
    exponent: that force goes with the diameter to this power; size: the law that says so, "weakest link" or "none".
    The draws of a lab have a diameter and an exponent alone.
    """

    diameter: float
    forces: tuple[float, ...] = ()
    diameters: tuple[float, ...] = ()
    suspended: tuple[bool, ...] = ()
    platens: tuple[float, float] = (math.inf, 0.3)
    sphere: Mapping[str, float] = field(default_factory=dict)
    law: Law | None = None
    exponent: float = 2.0
    size: str = "none"


@dataclass(frozen=True, kw_only=True)
class Limit:
    """A strength that a quantity is held against; strength in SI, model_factor a plain number.

    With a criterion, `quantity` is its demand with these parameters (SI), by a name of the limit's own.  `fracture`:
    whether exceeding it breaks the sphere; None leaves that to the quantity.  `platens`: E (infinite: rigid) and nu of
    what the strength was measured between, in a test that is not the study's own rig; None: it is not transferred.
    `tested`: the crushing tests behind the strength, if it has such; `uqsphere.study.strength` makes their forces
    comparable with those of a row.
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
    """The inverse question: the values along the axis with these probabilities of exceeding each limit."""

    axis: Axis
    for_probability: tuple[float, ...] = (0.01, 0.1, 0.5, 0.9, 0.99)


@dataclass(frozen=True, kw_only=True)
class Source:
    """Where a default came from, and whether that source was seen."""

    text: str
    seen: bool


class Tables(TypedDict, total=False):
    """The arguments of `Study`: the tables of a study file, with distributions where a number scatters."""

    title: str
    seed: int
    sphere: Mapping[str, Any]
    bars: Mapping[str, Any]
    striker: Mapping[str, Any]
    pulse: Mapping[str, Any]
    contact: Mapping[str, Any]
    rig: Mapping[str, Any]
    target: Mapping[str, Any]
    anvil: Mapping[str, Any]
    other: Mapping[str, Any]
    hammer: Mapping[str, Any]
    rod: Mapping[str, Any]
    platens: Mapping[str, Any] | str
    insert: Mapping[str, Any]
    model: Mapping[str, Any]
    inputs: Mapping[str, Any]
    outputs: str | Sequence[str] | Mapping[str, Any]
    limits: Mapping[str, Mapping[str, Any]]
    dependence: Sequence[Mapping[str, Any]]
    gauges: Sequence[Mapping[str, Any]]
    analysis: Mapping[str, Any]
    margins: Mapping[str, Any]


@dataclass(frozen=True, kw_only=True, init=False, repr=False)
class Study:
    """A validated study: `Study(title=..., inputs=..., outputs=..., limits=..., margins=..., analysis=...)`.

    The arguments are the tables of a study file as mappings, with laws of this package, of scipy.stats or chaospy where
    a number scatters, and `outputs` a name or several; they make the same document, which `text` has.  A file is read
    by `load_study`.

    >>> from scipy import stats
    >>> Study(inputs={"load": stats.norm(3.0, 0.5)}, outputs="y", limits={"high": {"quantity": "y", "strength": 5.0,
    ...       "aim": "survive"}}, analysis={"budget": {"evaluations": 1000}}, title="A beam")
    <Study 'A beam': 1 random input, limits high, black box>

    fixed, random : every number by dotted path (black box: bare name), SI, defaults included, in the order of the file;
    a bar end is its velocity reflection coefficient.  What a scene does not have (lengths of infinite bars, say) is
    absent.
    given : the parameters of each law as the file gives them, in SI, strengths and model factors too; `Law.with_mean`
    reads them.
    record : the pulse of a measured record, from which `striker.speed` then follows.
    made_up : the random numbers whose observations the file calls synthetic.
    overrides : what was set from outside the file, as PATH=VALUE; its effect is in the other attributes.
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
    files: tuple[tuple[str, Path], ...] = ()
    made_up: tuple[str, ...] = ()

    def __init__(self, **tables: Unpack[Tables]) -> None:
        given: dict[str, Any] = {**tables}
        if "path" not in given:
            from uqsphere.study.load import load_study
            from uqsphere.uq.foreign import of_salib

            outputs = given.get("outputs")
            if isinstance(outputs, str | list | tuple):
                given["outputs"] = {"names": [outputs] if isinstance(outputs, str) else list(outputs)}
            if isinstance(given.get("inputs"), Mapping):
                given["inputs"] = of_salib(given["inputs"])
            given = vars(load_study(given))
        names = [entry.name for entry in fields(self)]
        if strange := given.keys() - set(names):
            raise TypeError(f"Study has no {min(strange)}")
        for entry in fields(self):
            object.__setattr__(self, entry.name, given.get(entry.name, entry.default))

    @property
    def rig(self) -> str:
        """What loads the sphere: `bars`, `impact`, ..."""
        return str(self.options.get("rig.kind", "bars"))

    def __repr__(self) -> str:
        parts = [f"{len(self.random)} random input{'' if len(self.random) == 1 else 's'}"]
        parts += [f"limits {', '.join(limit.name for limit in self.limits)}"] if self.limits else []
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

    def joint(self) -> Distribution:
        """The joint law of the random inputs as a distribution of chaospy; `uqsphere.uq.interop.joint_to_chaospy`."""
        from uqsphere.uq.interop import joint_to_chaospy

        return joint_to_chaospy(self.inputs().only(tuple(self.random)))

    def sample(self, count: int) -> DataFrame:
        """Independent rows of every random number, strengths too, SI: the same for the same seed."""
        from pandas import DataFrame

        from uqsphere.uq import random_generator

        joint = self.inputs()
        normals = random_generator(seed=self.seed, task="study sample").standard_normal((count, len(joint.names)))
        return DataFrame(joint.physical(normals), columns=list(joint.names))

    def design(self, count: int) -> DataFrame:
        """Rows of the random inputs for a solver elsewhere, SI: points of a scrambled Sobol' sequence, spread evenly.

        More rows continue fewer.  Their answers, in columns by the names of the outputs, are for `analyse`.

        >>> Study(inputs={"x": {"dist": "uniform", "lower": 0.0, "upper": 1.0}}, outputs="y").design(4).shape
        (4, 1)
        """
        from pandas import DataFrame

        from uqsphere.uq import sobol_points

        joint = self.inputs().only(tuple(self.random))
        points = sobol_points(dimension=len(joint.names), count=count, seed=self.seed, task="slow", replicate=0)
        return DataFrame(joint.physical(np.asarray(special.ndtri(points))), columns=list(joint.names))

    def analyse(self, frame: DataFrame, *, out: str | Path | None = None) -> Run:
        """The run of a black-box study whose rows were answered elsewhere: every analysis, without calling a model.

        frame : random inputs and outputs by their names, 16 rows or more drawn as the study says (`design`, `sample`,
            measurements); a row without an answer is nan, and counts as `analysis.on_failure` says.

        An event rarer than 3 in the number of rows is in no interval, and the answers say so.
        """
        from uqsphere.run import run

        return run(self, rows=frame, out=out)

    def to_salib(self, count: int = 1024, *, second: bool = False) -> SalibDesign:
        """The study's own design of Sobol' indices as a problem and rows of SALib; `uqsphere.uq.interop.to_salib`."""
        from uqsphere.uq.interop import to_salib

        return to_salib(self.inputs().only(tuple(self.random)), count, second=second, seed=self.seed)

    def at_means(self) -> dict[str, float]:
        """Every number of the scene (or black-box input), the random ones at their nominal mean; SI."""
        return {**self.fixed, **{name: law.nominal_mean() for name, law in self.random.items()}}

    def resolved(self) -> dict[str, Json]:
        """The study as plain JSON values: SI, every default explicit, no infinities."""
        laws, margins = self.laws(), self.margins
        meaning = {
            "title": self.title,
            "seed": self.seed,
            "kind": "black box" if self.black_box else "scene",
            "fixed": dict(self.fixed),
            "random": {name: _law_json(law, self.given.get(name, {})) for name, law in laws.items()},
            # the order of the random variables decides which point of a sequence goes to which of them
            "order": list(laws),
            "options": dict(self.options),
            "materials": dict(self.materials),
            "sources": {name: asdict(source) for name, source in self.sources.items()},
            "model": None if self.black_box else self.model.model_dump(),
            "limits": {limit.name: _limit_json(limit) for limit in self.limits},
            "dependence": [group.model_dump() for group in self.dependence],
            "analysis": self.analysis.model_dump(),
            "margins": None if margins is None else {
                "solve": margins.axis.path, "between": [margins.axis.low, margins.axis.high],
                "for_probability": margins.for_probability,
            },
            "outputs": self.outputs,
            "record": None if self.record is None else asdict(self.record),
            "gauges": [gauge.model_dump() for gauge in self.gauges],
            "made_up": self.made_up,
        }  # fmt: skip
        plain: dict[str, Json] = json.loads(json.dumps(meaning))
        return plain


# completion in a shell reads the signature
Study.__signature__ = Signature(  # type: ignore[attr-defined]
    [Parameter(key, Parameter.KEYWORD_ONLY, default=None) for key in Tables.__annotations__]
)


def tie_of(group: Dependence) -> Tie:
    """A dependence as the uncertainty side reads it."""
    from uqsphere.uq import Dependence as Tie

    return Tie(**group.model_dump())


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _law_json(law: Law, given: Mapping[str, float]) -> dict[str, Json]:
    """A law as plain JSON values, with its parameters as the file gives them."""
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

    tested = limit.tested
    tests = None if tested is None else {
        "forces": tested.forces, "diameters": tested.diameters, "suspended": tested.suspended,
        "platens": [_finite(value) for value in tested.platens], "size": tested.size, "exponent": tested.exponent,
    }  # fmt: skip
    return {
        "quantity": limit.quantity, "strength": fixed(limit.strength), "aim": limit.aim,
        "model_factor": fixed(limit.model_factor), "target": limit.target, "criterion": limit.criterion,
        "parameters": dict(limit.parameters), "fracture": limit.fracture, "tests": tests,
        "platens": limit.platens and [_finite(value) for value in limit.platens],
    }  # fmt: skip


# --- failure modes: the ways in which a rock sphere can break ------------------------------------------------------


#: by the place in the sphere where each begins: what it is called, the criterion that is assumed for it, and the
#: library's strength
_FAILURE_MODES: Final = {
    "contact": ("contact pressure", "contact_pressure", "contact_strength"),
    "rim": ("ring crack", "ring_crack", "fracture_toughness"),
    "core": ("core tension", "weakest_link_volume", "tensile_strength"),
    "energy": ("fracture energy", "specific_energy", "fracture_energy"),
}


@dataclass(frozen=True, kw_only=True)
class FailureMode:
    """A failure mode with an assumed strength: its limit, and the strength at both ends of the library's 95 % range."""

    called: str
    limit: Limit
    weak: Law
    strong: Law
    source: str
    seen: bool


@dataclass(frozen=True, kw_only=True)
class FailureModes:
    """The failure modes that a study has no limit for: those assumed, and why the others are not judged."""

    assumed: tuple[FailureMode, ...] = ()
    not_judged: Mapping[str, str] = field(default_factory=dict)


def breaks_by(limit: Limit) -> str:
    """Which of `_FAILURE_MODES` a limit is on; "force" for one on the force itself, empty where it is no fracture.

    >>> breaks_by(Limit(name="a", quantity="core_tension", strength=1e7))
    'core'
    """
    if limit.criterion is None and limit.quantity not in PATHS:
        return ""
    entry = OUTPUTS[limit.quantity] if limit.criterion is None else CRITERIA[limit.criterion]
    return "energy" if entry.follows == "energy" else entry.place or "force"


def means_fracture(limit: Limit) -> bool:
    """Whether a limit is on a failure mode; one that must break means it, also where it is not counted twice."""
    return breaks_by(limit) != "" and (limit.fracture is not False or limit.aim == "break")


def failure_modes_of(study: Study) -> FailureModes:
    """The failure modes that have no limit, with assumed strengths; none for what is no rock, or is not to be."""
    rock = library()["sphere"].get(study.materials.get("sphere", ""))
    given = {breaks_by(limit) for limit in study.limits if means_fracture(limit)}
    if study.black_box or study.analysis.failure_modes == "given" or rock is None or not rock.rock or not given:
        return FailureModes()
    assumed, not_judged = [], {}
    for place, (called, *_) in _FAILURE_MODES.items():
        if place not in given:
            found = _assumed(rock, place, 2.0 * study.at_means()["sphere.radius"])
            if isinstance(found, FailureMode):
                assumed.append(found)
            else:
                not_judged[called] = f"no strength: {found}"
    return FailureModes(assumed=tuple(assumed), not_judged=not_judged)


def _assumed(rock: Material, place: str, diameter: float) -> FailureMode | str:
    """The failure mode with the strength of the library for particles of a diameter [m], or why there is none."""
    called, assumed, key = _FAILURE_MODES[place]
    entry, modulus, own = rock.properties.get(key), rock.properties.get("weibull_modulus"), {}
    if entry is None or entry.range is None:
        if place == "core" and entry is not None:
            return "the library's tensile strength is of no known volume"
        return f"neither the study nor the library has one for {rock.title.lower()}"
    if place == "core":
        # the strength of a specimen says nothing of a volume that is a million times smaller, but by the size law
        if "volume" not in entry.further or modulus is None:
            return "a tensile strength needs its volume and a Weibull modulus to be carried to the core"
        own = {"modulus": modulus.value, "reference_volume": entry.further["volume"]}

    def law(value: float) -> Law:
        """Specimens whose typical strength is a value: Weibull's by its modulus, else lognormal."""
        if place == "core":
            return make_law("weibull", {"mean": value, "modulus": own["modulus"]})
        if place == "energy":
            # the median of particles of this size (Tavares and King 1998, equation 15)
            median = value * (1.0 + (entry.further["size"] / diameter) ** entry.further["exponent"])
            return make_law("lognormal", {"log_mean": math.log(median), "log_sd": entry.cov})
        return make_law("lognormal", {"mean": value, "cov": entry.cov})

    name, criterion, (low, high) = f"{called} (assumed)", CRITERIA[assumed], entry.range
    quantity = criterion.quantity if criterion.quantity and not own else f"{criterion.name}.{name}"
    limit = Limit(name=name, quantity=quantity, strength=law(entry.value), criterion=criterion.name if own else None,
                  parameters=own)  # fmt: skip
    return FailureMode(
        called=called, limit=limit, weak=law(low), strong=law(high), source=entry.source, seen=entry.seen
    )


# --- the free number of an inverse question: where it may lie, and what of a study it moves ------------------------


@dataclass(frozen=True, kw_only=True)
class Axis:
    """A number that is free between two values (SI).

    `kind`: a "number" of the scene or of the model's inputs (the mean of its law, where it scatters), or the mean
    "strength" of a limit, all its values in proportion.
    """

    path: str
    low: float
    high: float
    kind: Literal["number", "strength"] = "number"

    @property
    def limit(self) -> str | None:
        """The limit whose strength is free."""
        return limit_of(self.path) if self.kind == "strength" else None

    @property
    def moves_rows(self) -> bool:
        """Whether the answers of the model depend on the number; else the rows of one value serve all."""
        return self.kind != "strength"

    @property
    def logarithmic(self) -> bool:
        """Whether the number is positive, so that it is taken in ratios."""
        return self.low > 0.0

    def grid(self, count: int) -> list[float]:
        """`count` values from one end to the other, in equal ratios or steps."""
        inner = (
            np.geomspace(self.low, self.high, count) if self.logarithmic else np.linspace(self.low, self.high, count)
        )
        return [self.low, *map(float, inner[1:-1]), self.high]

    def value(self, share: Array | float) -> Array:
        """The value a share of the way from one end to the other, in ratios or steps."""
        if self.logarithmic:
            return np.asarray(self.low * (self.high / self.low) ** share)
        return np.asarray(self.low + (self.high - self.low) * share)

    def move(self, study: Study, value: float) -> Study:
        """The study whose rows are sampled where the number has a value: itself, unless it is one of its numbers.

        Raises LawError where a random number has no law with this mean.
        """
        return with_number(study, self.path, value) if self.moves_rows else study

    def demand_factor(self, limit: Limit, value: float) -> float:
        """What the demands of a limit are multiplied by where the number has a value, in place of its free strength."""
        if self.limit != limit.name:
            return 1.0
        nominal = limit.strength.nominal_mean() if isinstance(limit.strength, Law) else limit.strength
        return nominal / value


def strength_name(limit: str) -> str:
    """The path of a limit's strength."""
    return f"limits.{limit}.strength"


def limit_of(path: str) -> str | None:
    """The limit that a strength or a model factor belongs to; None for a number of the scene.

    >>> limit_of("limits.crushing.strength"), limit_of("striker.speed")
    ('crushing', None)
    """
    return path.removeprefix("limits.").rpartition(".")[0] if path.startswith("limits.") else None


def with_number(study: Study, path: str, value: float) -> Study:
    """The study with a number at `value`: the mean of its law, or the number itself.

    A moved law is cut where its number has no meaning if a notable share of it has come to lie there: a height of 12 mm
    with a standard deviation of 0.5 mm is never negative; one of 0.2 mm with the same often would be.
    """
    if path not in study.random:
        return replace(study, fixed={**study.fixed, path: value})
    law = study.random[path].with_mean(value, study.given[path])
    low = INPUTS[path].lower if path in INPUTS else -math.inf
    if law.lower < low and float(law.cdf(np.array([low]))[0]) > NOTABLE:
        law = replace(law, lower=low)
    return replace(study, random={**study.random, path: law})

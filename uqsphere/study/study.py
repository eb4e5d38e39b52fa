"""What a study is: the frozen nouns that everything above the parser works with, all values in
SI.
"""

import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import field, fields, is_dataclass, replace
from inspect import Parameter, Signature
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import BaseModel

from uqsphere.arrays import Array, Names, Values, frozen
from uqsphere.documents import path_of, within
from uqsphere.files import Json
from uqsphere.materials import Property
from uqsphere.mechanics.criteria import CRITERIA, Demands
from uqsphere.mechanics.crushing import Demand
from uqsphere.mechanics.outputs import OUTPUTS
from uqsphere.mechanics.pulses import MeasuredPulse
from uqsphere.mechanics.rigs import DEFAULT_RIG, RIGS, Rig
from uqsphere.mechanics.scene import Scene
from uqsphere.quantities import INPUTS
from uqsphere.uq import Dependence, Joint, Law, make_joint
from uqsphere.uq.families import Family

from .document import Aim, Analysis, Document, Gauge, Margins, ModelChoice, Words
from .values import NOTABLE, Number, Tested, mean_of

#: failure probability that is allowed where a study says nothing at all
DEFAULT_TARGET = 0.01


@frozen
class Limit:
    """A strength that a quantity is held against; strength in SI, model_factor a plain number.

    With a criterion, `quantity` is its demand with these parameters (SI), by a name of the limit's
    own.  `target` is the largest failure probability that is allowed; a limit without one of its
    own (`has_target` is false, and there is no verdict) takes over what `default_target` says.
    `fracture`: whether exceeding it breaks the sphere; None leaves that to the quantity.
    `tested`: the crushing tests behind the strength, if it has such;
    `uqsphere.propagation.design` makes their forces comparable with those of a row.
    """

    name: str
    quantity: str
    strength: Law | float
    aim: Aim = "survive"
    model_factor: Law | float = 1.0
    target: float = DEFAULT_TARGET
    has_target: bool = False
    criterion: str | None = None
    parameters: Mapping[str, float] = field(default_factory=dict)
    fracture: bool | None = None
    tested: Tested | None = None

    @property
    def demand(self) -> Demand:
        """What is held against the strength: a quantity, or a criterion with its parameters."""
        if not self.criterion:
            return self.quantity
        return self.criterion, self.parameters

    @property
    def subject(self) -> str:
        """Its name in the table of answers."""
        return f"limits.{self.name}"

    @property
    def strength_name(self) -> str:
        """The path of its strength."""
        return f"limits.{self.name}.strength"

    @property
    def resistance(self) -> Law | float:
        """What demands are held against: the distribution of the force of its crushing tests, or
        its strength.
        """
        return (self.tested and self.tested.law) or self.strength

    @property
    def by_force(self) -> bool:
        """Whether it is held against the force of crushing tests, or against draws with a law of
        size.
        """
        return bool(self.tested and (self.tested.law or self.tested.exponent))

    @property
    def column(self) -> str:
        """The column of a sample that it is held against."""
        if self.by_force:
            return f"limits.{self.name}.test_force"
        return self.quantity

    @property
    def allowable(self) -> float:
        """The probability of exceedance at which the target is just met."""
        return float(self.missed(self.target))

    @property
    def negligible(self) -> float:
        """A failure probability below which its digits do not matter."""
        if self.has_target:
            return 0.01 * self.target
        return 1e-8

    def missed(self, probability: Values) -> Values:
        """The failure probability at probabilities of exceedance, or the other way round: its
        complement for a sphere that must break.

        >>> Limit(name="broken", quantity="P_max", strength=1e3, aim="break").missed(0.75)
        0.25
        """
        if self.aim == "break":
            return 1.0 - probability
        return probability

    @property
    def needs_modulus(self) -> bool:
        """Whether the criterion is a weakest link, which has a Weibull modulus."""
        return self.criterion is not None and "modulus" in CRITERIA[self.criterion].parameters


@frozen(init=False, repr=False)
class Study:
    """A validated study in SI units; files are read by `load_study`.

    Parameters
    ----------
    **tables : str, int or mapping
        `title`, `seed` and the tables of a study file by their names (`inputs`, `outputs`,
        `limits`, `margins`, `analysis`, ...), with distributions of this package, of scipy.stats or
        chaospy where a number is random; `outputs` may be a name or a list of names.

    Raises
    ------
    StudyError
        Lists every error that was found.

    Attributes
    ----------
    fixed, random : mapping
        Every number by its dotted path (black box: bare name) in the order of the file, defaults
        included; a bar end is its velocity reflection coefficient.  Numbers that a scene does not
        have (lengths of infinite bars) are absent.
    record : MeasuredPulse or None
        The pulse of a measured record, from which `striker.speed` follows.
    text : str
        The study as a file.
    made_up : tuple of str
        Random numbers from synthetic data.
    caveats : tuple
        Code, key and text of warnings that prevent a verdict.
    overrides : tuple of str
        Values set from outside the file, as PATH=VALUE; the other attributes include them.

    Examples
    --------
    >>> from scipy import stats
    >>> high = {"quantity": "y", "strength": 5.0, "aim": "survive"}
    >>> Study(inputs={"load": stats.norm(3.0, 0.5)}, outputs="y", limits={"high": high},
    ...       analysis={"budget": {"evaluations": 1000}}, title="A beam")
    <Study 'A beam': 1 random input, limits high, black box>
    """

    title: str
    seed: int
    path: Path
    text: str
    black_box: bool
    fixed: Mapping[str, float]
    random: Mapping[str, Law]
    options: Mapping[str, Json]
    materials: Mapping[str, str]
    sources: Mapping[str, Property]
    model: ModelChoice
    limits: tuple[Limit, ...]
    dependence: tuple[Dependence, ...]
    analysis: Analysis
    margins: Margins | None
    outputs: Names
    warnings: Names
    overrides: Names
    record: MeasuredPulse | None
    gauges: tuple[Gauge, ...]
    files: tuple[tuple[str, Path], ...]
    made_up: Names
    caveats: tuple[tuple[str, str, str], ...]

    def __init__(self, **tables: Any) -> None:
        if "path" not in tables:
            from uqsphere.uq.foreign import of_salib

            from .load import load_study

            tables = {key: table for key, table in tables.items() if table is not None}
            outputs = tables.get("outputs")
            inputs = tables.get("inputs")
            if isinstance(outputs, str):
                outputs = [outputs]
            if isinstance(outputs, list | tuple):
                tables["outputs"] = {"names": outputs}
            if isinstance(inputs, Mapping):
                tables["inputs"] = of_salib(inputs)
            tables = dict(vars(load_study(tables)))
        for name in tables.keys() ^ {entry.name for entry in fields(self)}:
            raise TypeError(f"Study has no {name}")
        vars(self).update(tables)

    @property
    def rig(self) -> str:
        """What loads the sphere: `bars`, `impact`, ..."""
        return str(self.options.get("rig.kind", DEFAULT_RIG))

    @property
    def moving(self) -> Margins | None:
        """The margins whose free number moves the rows of the model; None without, and where it is
        a strength.
        """
        if not self.margins or self.margins.limit:
            return None
        return self.margins

    def __repr__(self) -> str:
        noun = "input" if len(self.random) == 1 else "inputs"
        parts = [f"{len(self.random)} random {noun}"]
        if self.limits:
            parts.append(f"limits {', '.join(limit.name for limit in self.limits)}")
        parts.append("black box" if self.black_box else self.rig)
        return f"<Study {self.title!r}: {', '.join(parts)}>"

    def _repr_html_(self) -> str:
        """Inputs and strengths as read, for a notebook."""
        from uqsphere.report.study import study_html

        return study_html(self)

    @property
    def hash(self) -> str:
        """SHA-256 of the meaning: the same where two files differ only in title, gauges, comments
        or layout.
        """
        return _digest(self.meaning())

    @property
    def scene(self) -> str:
        """A name of what its history shows: every number at its mean, in its rig and model."""
        meaning = self.meaning()
        scene = {key: meaning[key] for key in ("options", "record", "model")}
        # a mean follows from the parameters of its law to rounding
        scene["numbers"] = {name: f"{mean:.9g}" for name, mean in self.at_means().items()}
        return f"scene {_digest(scene)}"

    def changed_keys(self, other: Self) -> list[str]:
        """The dotted keys whose meaning differs in another study; those that leave the hash alone
        are not among them.

        >>> box = {"outputs": "y", "seed": 1}
        >>> Study(inputs={"x": 1.0}, **box).changed_keys(Study(inputs={"x": 2.0}, **box))
        ['x']
        """
        before, after = (_keys(study.meaning()) for study in (self, other))
        changed = [key for key in before | after if before.get(key, ...) != after.get(key, ...)]
        # the order of the variables follows from the variables
        return [key for key in changed if key != "order"] or changed

    @property
    def demands(self) -> Demands:
        """Quantities that a limit's criterion adds: name -> criterion and its parameters."""
        return {
            limit.quantity: (limit.criterion, limit.parameters)
            for limit in self.limits
            if limit.criterion
        }

    def laws(self) -> dict[str, Law]:
        """Every random variable and its law: inputs in file order, then strengths and model
        factors.
        """
        laws = dict(self.random)
        for limit in self.limits:
            for part in ("strength", "model_factor"):
                value = getattr(limit, part)
                if isinstance(value, Law):
                    laws[f"limits.{limit.name}.{part}"] = value
        return laws

    def inputs(self) -> Joint:
        """The random variables of `laws` with their dependence, as the uncertainty side reads
        them.
        """
        return make_joint(self.laws(), self.dependence)

    def source_of(self, name: str) -> tuple[str, bool]:
        """Where a number comes from, and whether it was read there; the study itself if it says
        nothing else.
        """
        source = self.sources.get(name)
        if source is None:
            return "study", True
        return source.source, source.seen

    def moved(self, value: float) -> "Study":
        """The study with its free number at a value, the mean of its law or the number itself; the
        study itself where that is no number of its rows.

        A moved law is cut where its number has no meaning if a notable share of it has come to lie
        there: a height of 12 mm with a standard deviation of 0.5 mm is never negative; one of
        0.2 mm with the same often would be.

        Raises LawError where a random number has no law with this mean.
        """
        if self.moving is None:
            return self
        path = self.moving.solve
        if path not in self.random:
            return replace(self, fixed={**self.fixed, path: value})
        law = self.random[path].with_mean(value)
        if path in INPUTS:
            low = INPUTS[path].lower
            if law.lower < low and law.cdf(low) > NOTABLE:
                law = replace(law, lower=low)
        return replace(self, random={**self.random, path: law})

    def demand_factor(self, limit: Limit, value: float) -> float:
        """What the demands of a limit are multiplied by where the free number has a value, in place
        of its free strength; nan is the plan.
        """
        margins = self.margins
        if margins is None or margins.limit != limit.name or math.isnan(value):
            return 1.0
        return mean_of(limit.strength) / value

    def at_means(self) -> dict[str, float]:
        """Every number of the scene (or black-box input), the random ones at their nominal mean;
        SI.
        """
        return {**self.fixed, **{name: law.nominal_mean() for name, law in self.random.items()}}

    def meaning(self) -> dict[str, Json]:
        """The meaning of the study as plain JSON values: SI, every default explicit, no infinities;
        without title, gauges and what is read from the file as it stands.
        """
        content = plain(self)
        for key in ("title", "gauges", "path", "text", "warnings", "caveats", "overrides", "files"):
            del content[key]
        # the order of the random variables decides which point of a sequence goes to which of them
        return {**content, "order": list(self.laws())}


# completion in a shell reads the signature
Study.__signature__ = Signature(  # type: ignore[attr-defined]
    [Parameter(key, Parameter.KEYWORD_ONLY, default=None) for key in Document.model_fields]
)


def _keys(meaning: Mapping[str, Json]) -> dict[str, Json]:
    """The values of a study by their dotted keys: numbers by their paths, parts of tables by table
    and key.
    """
    keys = dict[str, Json]()
    for table, content in meaning.items():
        if table in ("fixed", "random", "options"):
            keys |= content
        elif table == "limits":
            for limit in content:
                keys |= {
                    f"limits.{limit['name']}.{key}": value
                    for key, value in limit.items()
                    if key != "name"
                }
        elif isinstance(content, dict):
            keys |= {f"{table}.{key}": value for key, value in content.items()}
        else:
            keys[table] = content
    return keys


def _digest(content: Json) -> str:
    text = json.dumps(content, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def plain(value: Any) -> Json:
    """A value as JSON has it: laws and tables by their parts, null for what is not finite."""
    if isinstance(value, Family):
        return value.name
    if isinstance(value, BaseModel):
        value = dict(value)
    elif is_dataclass(value):
        value = {entry.name: getattr(value, entry.name) for entry in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def default_target(limits: Iterable[Limit], margins: Margins | None, aim: str) -> float:
    """The target of a limit, or of an assumed failure mode, that has none of its own.

    It is the least target of the study's limits of the same aim; without these the least
    probability of failure at which `margins.for_probability` asks for a margin, and without margins
    `DEFAULT_TARGET`.
    """
    targets = [limit.target for limit in limits if limit.has_target and limit.aim == aim]
    if not targets and margins:
        # a sphere that must break fails where its strength is not exceeded
        targets = [1.0 - p if aim == "break" else p for p in margins.for_probability]
    return min(targets, default=DEFAULT_TARGET)


def scene_with(columns: Mapping[str, Array], study: "Study | Draft", model: ModelChoice) -> Scene:
    """The scenes of some columns (n,) under the words of a study; raises ValueError as `Scene`."""
    word = study.options.get
    return Scene(
        columns=columns,
        rig=word("rig.kind", DEFAULT_RIG),
        options=study.options,
        shape=word("pulse.shape", "rectangular"),
        infinite=word("bars.infinite", False),
        rigid_contact=word("bars.rigid_contact", False),
        first_loading_only=model.first_loading_only,
        whole_record=model.whole_record,
        horizon=model.horizon,
        demands=study.demands,
        contact_law=word("contact.law", "hertz"),
        hardness_at_onset="contact.hardness" in study.options,
        record=study.record,
    )


# --- a study while it is read ---------------------------------------------------------------------


class Draft:
    """What is understood of a study.

    folder : that of the study, outside of which no file is read; files: those it has read, by the
        names it gives them.
    data : the tables as the file has them; document: the same, validated.
    box : whether it is a black box.
    numbers : by dotted path (black box: bare name) in the order of the file, strengths and model
        factors last.
    scene : the one row at its means.
    place : what is read at the moment; warnings: the code that each holds a verdict by, by place
        and text.
    """

    document: Words
    record: MeasuredPulse | None = None
    scene: Scene | None = None
    margins: Margins | None = None

    def __init__(self, folder: Path, data: dict[str, Any], box: bool) -> None:
        self.folder, self.data, self.box = folder, data, box
        self.place = ""
        self.numbers = dict[str, Number]()
        self.options = dict[str, Json]()
        self.materials = dict[str, str]()
        self.sources = dict[str, Property]()
        self.limits = dict[str, Limit]()
        self.demands = dict[str, Any]()
        self.dependence = list[Dependence]()
        self.warnings = dict[tuple[str, str], str]()
        self.files = dict[str, Path]()

    @property
    def rig(self) -> Rig:
        """What loads the sphere."""
        return RIGS[self.document.rig.kind]

    @property
    def plastic(self) -> bool:
        """Whether contacts can yield."""
        return "contact.law" in self.options

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names that can be requested."""
        return self.document.outputs.names if self.box else tuple(OUTPUTS)

    def gauges(self) -> dict[str, Gauge]:
        """The gauges by their places in the study, that of a rod first."""
        gauges = {f"gauges[{k}]": gauge for k, gauge in enumerate(self.document.gauges)}
        rod = self.document.rod.gauge
        if not rod:
            return gauges
        return {"rod.gauge": Gauge.model_construct(bar="rod", position=rod), **gauges}

    @contextmanager
    def within(self, *at: str | int) -> Iterator[None]:
        """What is noted inside, and a fault that is raised, lies on the way `at`."""
        above = self.place
        self.place = path_of(above, *at)
        try:
            with within(*at):
                yield
        finally:
            self.place = above

    def warn(self, message: str, *at: str | int, holds: str = "") -> None:
        """Note what a user should know of a place and what does not stop the study, once.

        holds : code of the caveat by which no verdict is established, `unit`, `plausibility` or
            `rate`
        """
        self.warnings.setdefault((path_of(self.place, *at), message), holds)

    @property
    def contact_modulus(self) -> float:
        """The mean E* [Pa] of the contacts in the rig."""
        assert self.scene is not None
        return float(np.mean([partner.modulus[0] for partner in self.scene.there]))

    def mean(self, path: str) -> float:
        """A number at its nominal mean; NaN, for which no comparison holds, where there is none."""
        if path in self.numbers:
            return self.numbers[path].mean
        return math.nan

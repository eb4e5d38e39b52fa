"""The shape of a study file: which tables and keys there are, and which kind of value each takes.

Everything may be absent here and numbers are taken as they come: what is due, what a number means and how
values go together is asked in `uqsphere.study.resolve`, where a fault in one part does not hide those of
the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from copy import deepcopy
from typing import Any, Final, Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from uqsphere.study.faults import Findings, Place, nearest, one_of, shown, suggestion

__all__ = [
    "AccuracyTable",
    "AnalysisTable",
    "BarsTable",
    "BudgetTable",
    "DependenceTable",
    "Document",
    "FamilyTable",
    "GaugeTable",
    "LimitTable",
    "MarginsTable",
    "ModelTable",
    "OutputsTable",
    "ProductTable",
    "PulseTable",
    "SphereTable",
    "StrikerTable",
    "ToleranceTable",
    "read_document",
]

#: A number of the scene as the file has it: a number, a text with a unit, or the table of a distribution.
Number = Any

PulseShape = Literal["rectangular", "trapezoid", "ramp", "half_sine", "two_peak", "step", "measured"]
Fidelity = Literal["auto", "massless", "linear", "full"]
Aim = Literal["survive", "break"]
OnFailure = Literal["abort", "bound", "drop"]


class Table(BaseModel):
    """A table of the file: no key beyond those listed, no conversion of one kind of value into another."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, protected_namespaces=(), defer_build=True)


class SphereTable(Table):
    material: str | None = None
    E: Number = None
    nu: Number = None
    radius: Number = None
    density: Number = None


class BarsTable(Table):
    material: str | None = None
    E: Number = None
    nu: Number = None
    density: Number = None
    yield_strength: Number = None
    diameter: Number = None
    incident_length: Number = None
    receiving_length: Number = None
    incident_end: Number = None
    receiving_end: Number = None
    receiving_damper: Any = None
    end_radius: Number = None
    infinite: bool = False
    rigid_contact: bool = False


class StrikerTable(Table):
    material: str | None = None
    E: Number = None
    density: Number = None
    diameter: Number = None
    speed: Number = None
    length: Number = None


class PulseTable(Table):
    preset: str | None = None
    shape: PulseShape = "rectangular"
    duration: Number = None
    rise: Number = None
    fall: Number = None
    t1: Number = None
    level1: Number = None
    t2: Number = None
    level2: Number = None
    valley: Number = None
    # of a measured record
    file: str | None = None
    columns: list[str] | None = None
    time_unit: str | None = None
    unit: str | None = None
    gauge_factor: float | None = None
    excitation: float | None = None
    amplification: float | None = None
    active_arms: float | None = None
    polarity: str | None = None
    window: list[Any] | None = None
    correct_dispersion: bool | None = None
    gauge_distance: Any = None
    gain: Number = None
    noise: bool | None = None


class ProductTable(Table):
    A: Number = None
    b: Number = None


class ModelTable(Table):
    fidelity: Fidelity = "auto"
    tolerance: float = 1e-6
    first_loading_only: bool = False
    horizon: Any = None
    compare_with_paper: bool = False


class LimitTable(Table):
    quantity: str | None = None
    criterion: str | None = None
    modulus: Any = None
    reference_volume: Any = None
    reference_area: Any = None
    largest_energy: Any = None
    rate_0: Any = None
    strength: Number = None
    aim: Aim = "survive"
    model_factor: Number = None
    target: float | None = None
    fracture: bool | None = None


class DependenceTable(Table):
    of: list[str] | None = None
    copula: str = "gaussian"
    spearman: float | None = None
    kendall: float | None = None
    dof: float | None = None


class GaugeTable(Table):
    bar: Any = None
    position: Any = None


class AccuracyTable(Table):
    mean: float = 0.002
    quantile: float = 0.01
    sobol: float = 0.01
    probability: float = 0.05


class BudgetTable(Table):
    evaluations: int = 2_000_000
    time: Any = "10 min"
    exhaust: bool = False


class ToleranceTable(Table):
    coverage: float = 0.95
    confidence: float = 0.95
    runs: int | None = None


class AnalysisTable(Table):
    quantities: list[str] | None = None
    accuracy: AccuracyTable = Field(default_factory=AccuracyTable)
    budget: BudgetTable = Field(default_factory=BudgetTable)
    quantiles: list[float] = Field(default_factory=lambda: [0.01, 0.05, 0.5, 0.95, 0.99])
    methods: Any = "auto"
    cost: Any = None
    on_failure: OnFailure = "abort"
    rows_per_call: int | None = None
    time_limit: Any = None
    second_order: bool = False
    groups: dict[str, list[str]] = Field(default_factory=dict)
    tolerance_intervals: ToleranceTable | None = None


class FamilyTable(Table):
    path: str | None = None
    values: list[Any] | None = None


class MarginsTable(Table):
    solve: str | None = None
    between: list[Any] | None = None
    for_probability: list[float] = Field(default_factory=lambda: [0.01, 0.1, 0.5, 0.9, 0.99])
    for_survival: list[float] | None = None
    for_fracture: list[float] | None = None
    family: FamilyTable | None = None
    bars_elastic: bool = False
    against: str | None = None


class OutputsTable(Table):
    names: list[str] | None = None


class Document(Table):
    title: str = ""
    seed: int = 0
    sphere: SphereTable | None = None
    bars: BarsTable | None = None
    striker: StrikerTable | None = None
    pulse: PulseTable | None = None
    product: ProductTable | None = None
    model: ModelTable | None = None
    inputs: dict[str, Number] | None = None
    outputs: OutputsTable | None = None
    limits: dict[str, LimitTable] = Field(default_factory=dict)
    dependence: list[DependenceTable] = Field(default_factory=list)
    gauges: list[GaugeTable] = Field(default_factory=list)
    analysis: AnalysisTable = Field(default_factory=AnalysisTable)
    margins: MarginsTable | None = None


_TABLES: Final[dict[str, type[Table]]] = {
    "sphere": SphereTable,
    "bars": BarsTable,
    "striker": StrikerTable,
    "pulse": PulseTable,
    "product": ProductTable,
    "model": ModelTable,
    "outputs": OutputsTable,
    "limits": LimitTable,
    "dependence": DependenceTable,
    "gauges": GaugeTable,
    "analysis": AnalysisTable,
    "margins": MarginsTable,
    "family": FamilyTable,
    "accuracy": AccuracyTable,
    "budget": BudgetTable,
    "tolerance_intervals": ToleranceTable,
}

#: pydantic's name of a fault -> what is due there
_DUE: Final = {
    "string_type": "a text in quotes",
    "bool_type": "true or false",
    "int_type": "a whole number",
    "float_type": "a number",
    "list_type": "an array",
    "dict_type": "a table",
    "model_type": "a table",
}
_MOST_SUGGESTIONS: Final = 50


def read_document(data: dict[str, Any], findings: Findings) -> Document:
    """The tables of the file, without those parts that were faulty; each fault is noted."""
    left = deepcopy(data)
    # Taking a faulty part out can bring up one fault more at the most per level, so that a few turns do.
    for _ in range(8):
        try:
            return Document.model_validate(left)
        except ValidationError as error:
            faults = error.errors(include_url=False, include_context=False)
        for count, fault in enumerate(faults):
            place: Place = tuple(fault["loc"])
            if findings.touched(place):
                _take_out(left, place)
                continue
            suggest = count < _MOST_SUGGESTIONS
            findings.add(place, _describe(fault["type"], place, fault["input"], suggest))
            _take_out(left, place)
            if suggest and fault["type"] == "extra_forbidden":
                # The key that was meant is not missing: it is misspelt, which has been said.
                meant = nearest(str(place[-1]), known_keys(place[:-1]))
                findings.spoiled.update([(*place[:-1], meant)] if meant else [])
    return Document()


def known_keys(place: Place) -> list[str]:
    """The keys that the table at `place` can hold."""
    if not place:
        return list(Document.model_fields)
    # A limit goes by a name of the user's, dependence and gauges by number: the table above says what they are.
    named = place[0] if place[0] in ("limits", "dependence", "gauges") else place[-1]
    table = _TABLES.get(str(named))
    return list(table.model_fields) if table else []


def _describe(kind: str, place: Place, value: object, suggest: bool) -> str:
    key = str(place[-1])
    if kind == "extra_forbidden":
        known = [name for name in known_keys(place[:-1]) if name not in ("file", "correct_dispersion")]
        near = suggestion(key, known) if suggest else ""
        return f"unknown key {shown(key)}{near or f'; known here: {one_of(known)}'}"
    if kind == "literal_error":
        words = _words(place)
        if not isinstance(value, str):
            return f"found {shown(value)}, a word is due: {one_of(words)}"
        return f"found {shown(value)}, allowed: {one_of(words)}{suggestion(value, words)}"
    due = _DUE.get(kind)
    return f"found {shown(value)}, where {due} is due" if due else f"found {shown(value)}, which cannot stand here"


def _words(place: Place) -> list[str]:
    choices: Mapping[str, Any] = {
        "shape": PulseShape,
        "fidelity": Fidelity,
        "aim": Aim,
        "on_failure": OnFailure,
    }
    return [str(word) for word in get_args(choices[str(place[-1])])]


def _take_out(data: Any, place: Place) -> None:
    """Remove what stands at `place`; an array goes as a whole with one faulty element of it."""
    node = data
    for depth, part in enumerate(place[:-1]):
        child = _child(node, part)
        if isinstance(child, list) and depth + 2 == len(place):
            index = place[-1]
            if part in ("dependence", "gauges") and isinstance(index, int):
                child[index] = {}
            elif isinstance(node, dict):
                node.pop(part, None)
            return
        node = child
    if isinstance(node, dict):
        node.pop(place[-1], None)


def _child(node: Any, part: str | int) -> Any:
    if isinstance(node, dict):
        return node.get(part)
    return node[part] if isinstance(node, list) and isinstance(part, int) and part < len(node) else None

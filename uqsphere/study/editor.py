"""The JSON schema of a study file: what editors complete and underline while a study is written.

It is made from the same tables as the parser reads, and says less: how numbers go together, only
`load_study` knows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, get_args

from uqsphere.materials import material_names
from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS
from uqsphere.mechanics.pulses import PRESETS, noise_names
from uqsphere.quantities import INPUTS, OUTPUTS, UNITS, Quantity, units_of
from uqsphere.records.record import SIGNAL_UNITS
from uqsphere.study.document import Aim, Fidelity, OnFailure
from uqsphere.study.gauges import GAUGE_BARS, MOST_GAUGES
from uqsphere.study.numbers import BAR_ENDS
from uqsphere.study.requests import METHODS
from uqsphere.study.scene import PULSE_KEYS
from uqsphere.study.study import Accuracy, Budget
from uqsphere.uq.elliptical import COPULAS, LEAST_DOF, MOST_DOF
from uqsphere.uq.law import LAWS

__all__ = ["build_schema"]

Node = dict[str, Any]

_NUMBER: Final = r"^\s*[+-]?(\d(_?\d)*\.?(\d(_?\d)*)?|\.\d(_?\d)*)([eE][+-]?\d+)?\s*"
_NAME: Final = "^[A-Za-z_][A-Za-z0-9_-]{0,63}$"
_SHARE: Final[Node] = {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1}
_FLAG: Final[Node] = {"type": "boolean"}


def build_schema() -> Node:
    """Schema of both forms of a study, JSON-ready (draft 2020-12)."""
    dimensions = {quantity.dimension for quantity in (*INPUTS.values(), *OUTPUTS.values())} | {"time"}
    dimensions |= {part.dimension for part in PARAMETERS.values()}
    properties = {
        "title": _text("what the study is about"),
        "seed": {"type": "integer", "minimum": 0, "description": "seed of every random number of the run"},
        "sphere": _section("sphere", required=("radius",), material=_material("sphere")),
        "bars": _section(
            "bars",
            required=("diameter",),
            material=_material("bars"),
            receiving_damper=_text("CSV of the receiving bar's far end: frequency, impedance_real, impedance_imag"),
            infinite=_FLAG | {"description": "no reflections from the far ends"},
            rigid_contact=_FLAG | {"description": "the bars do not yield in the contact"},
        ),
        "striker": _section("striker", required=("speed",), material=_material("bars")),
        "pulse": _section(
            "pulse",
            (),
            shape=_words(PULSE_KEYS, "shape of the incident pulse"),
            preset=_words(PRESETS, "a pulse of the paper's Fig. 2, in place of shape"),
            **_record(),
        ),
        "product": _section("product", required=("A", "b")),
        "model": _model(),
        "inputs": _named(_number_or_law("number"), "inputs of a black box") | {"minProperties": 1},
        "outputs": _table({"names": _list(_text("name of an output"))}, ("names",)),
        "limits": _named(_limit(), "strengths that quantities are held against"),
        "dependence": {"type": "array", "items": _dependence()},
        "gauges": {"type": "array", "items": _gauge(), "maxItems": MOST_GAUGES},
        "analysis": _analysis(),
        "margins": _margins(),
    }
    measured = {"pulse": {"properties": {"shape": {"const": "measured"}}, "required": ["shape"]}}
    driven = [{"required": ["striker"]}, {"properties": measured, "required": ["pulse"]}]
    scene = {"required": ["sphere", "bars"], "anyOf": driven, "not": {"anyOf": _present("inputs", "outputs")}}
    parts = _present("sphere", "bars", "striker", "pulse", "product", "model", "gauges")
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "uqsphere study",
        **_table(properties, ()),
        "anyOf": [scene, {"required": ["inputs", "outputs"], "not": {"anyOf": parts}}],
        "$defs": {
            **{name: _dimension(name) for name in sorted(dimensions)},
            **{f"{name}_law": {"anyOf": [_law(kind, name) for kind in LAWS]} for name in sorted(dimensions)},
        },
    }


def _present(*names: str) -> list[Node]:
    return [{"required": [name]} for name in names]


def _table(properties: Mapping[str, Node], required: Sequence[str]) -> Node:
    node: Node = {"type": "object", "properties": dict(properties), "additionalProperties": False}
    return node | {"required": list(required)} if required else node


def _named(item: Node, description: str) -> Node:
    node = {"type": "object", "patternProperties": {_NAME: item}, "additionalProperties": False}
    return node | {"description": description}


def _text(description: str) -> Node:
    return {"type": "string", "description": description}


def _words(words: Any, description: str) -> Node:
    return {"enum": list(words), "description": description}


def _list(item: Node, least: int = 1) -> Node:
    return {"type": "array", "items": item, "minItems": least}


def _material(kind: str) -> Node:
    return _words(material_names(kind), "material of the library, whose values stand in where none is given")


def _dimension(name: str) -> Node:
    """A fixed number: a text with a unit, or a plain number where there is no unit."""
    if name == "number":
        return {"type": "number"}
    units = "|".join(_escaped(unit) for unit in units_of(name))
    example = f"1.5 {units_of(name)[0]}"
    return {"type": "string", "pattern": f"{_NUMBER}({units})\\s*$", "examples": [example]}


def _escaped(unit: str) -> str:
    return "".join(f"\\{letter}" if letter in "^/." else letter for letter in unit)


def _law(kind: str, dimension: str) -> Node:
    """The table of one distribution for a quantity of a dimension."""
    specification = LAWS[kind]
    value = {"$ref": f"#/$defs/{dimension}"}
    properties: dict[str, Node] = {"dist": {"const": kind}}
    for key in (*specification.keys, "lower", "upper"):
        properties[key] = value if key in specification.dimensional else {"type": "number"}
    required = ["dist", *(("lower", "upper") if specification.bounded else ())]
    if kind == "empirical":
        properties |= {"file": _text("CSV beside the study"), "column": _text("column of the CSV")}
        properties["fit"] = {"enum": ["kde", "steps", *(name for name in LAWS if name != "empirical")]}
        properties |= {
            "censored": _text("column of flags: tests stopped before a failure"),
            "unbiased": {"type": "boolean"},
            "force": _text("column of forces at failure of spheres, in place of column"),
            "diameter": _text("column of diameters, or one length"),
            "rate": _text("column of loading rates"),
            "platens": _text("bars, rigid, or a material of bars"),
            **{f"{key}_unit": _text(f"unit of the column {key}") for key in ("force", "diameter", "rate")},
        }
        required += ["file"]
        if dimension != "number":
            properties["unit"] = _words(units_of(dimension), "unit of the column")
        plain = ["column"] if dimension == "number" else ["column", "unit"]
        either = [{"required": plain}, {"required": ["force", "force_unit", "diameter"]}]
        return _table(properties, required) | {"anyOf": either}
    node = _table(properties, required)
    alternatives = [{"required": list(keys)} for keys in specification.alternatives if keys]
    return node | {"anyOf": alternatives} if alternatives else node


def _number_or_law(dimension: str) -> Node:
    return {"anyOf": [{"$ref": f"#/$defs/{dimension}"}, {"$ref": f"#/$defs/{dimension}_law"}]}


def _section(name: str, required: Sequence[str] = (), **others: Node) -> Node:
    properties = dict(others)
    for path, quantity in INPUTS.items():
        section, key = path.split(".")
        if section == name and path not in noise_names():
            properties[key] = _scalar(quantity)
    return _table(properties, required)


def _record() -> dict[str, Node]:
    """Keys of a measured pulse that are no numbers of the scene."""
    positive = {"type": "number", "exclusiveMinimum": 0}
    return {
        "file": _text("record beside the study, with columns of time and strain"),
        "columns": _list(_text("name of a column: time, then strain"), least=2),
        "time_unit": _words(UNITS["time"], "unit of the time"),
        "unit": _words(SIGNAL_UNITS, "unit of the signal"),
        "gauge_factor": positive | {"description": "of the gauges"},
        "excitation": positive | {"description": "supply of the bridge [V]"},
        "amplification": positive | {"description": "of the signal"},
        "active_arms": positive | {"description": "1 quarter, 2 half bridge, 2 (1 + nu) with gauges across"},
        "polarity": _words(("auto", "tension", "compression"), "what is positive in the record"),
        "window": _list({"$ref": "#/$defs/time"}, least=2) | {"maxItems": 2},
        "correct_dispersion": _FLAG | {"description": "carry the wave from the gauge to the sphere"},
        "gauge_distance": {"$ref": "#/$defs/length"},
        "noise": _FLAG | {"description": "the noise of the record becomes random inputs"},
    }


def _scalar(quantity: Quantity) -> Node:
    unit = f" [{quantity.unit}]" if quantity.unit else ""
    node = _number_or_law(quantity.dimension)
    if quantity.symbol in ("R_1", "R_3"):
        node["anyOf"].insert(0, {"enum": list(BAR_ENDS)})
    return node | {"description": f"{quantity.meaning}, {quantity.symbol}{unit}"}


def _model() -> Node:
    return _table(
        {
            "fidelity": _words(get_args(Fidelity), "which mechanics"),
            "tolerance": {
                "type": "number",
                "minimum": 1e-12,
                "maximum": 1e-2,
                "description": "relative error",
            },
            "first_loading_only": _FLAG | {"description": "the record ends at the first return of a reflected wave"},
            "horizon": {"$ref": "#/$defs/time", "description": "end of the record"},
            "compare_with_paper": _FLAG | {"description": "show the formulas as printed beside the corrected ones"},
        },
        (),
    )


def _limit() -> Node:
    known = ", ".join(OUTPUTS)
    strengths = sorted({quantity.dimension for quantity in OUTPUTS.values()})
    strength = {"anyOf": [choice for name in strengths for choice in _number_or_law(name)["anyOf"]]}
    criterion = {
        name: {"$ref": f"#/$defs/{part.dimension}", "description": part.meaning} for name, part in PARAMETERS.items()
    }
    node = _table(
        {
            "criterion": _words(CRITERIA, "in place of quantity: how the sphere breaks"),
            **criterion,
            "quantity": _text(f"what must stay below, or exceed, the strength: {known}, or an output of a black box"),
            "strength": strength | {"description": "the strength, in the unit of the quantity"},
            "aim": _words(get_args(Aim), "survive: stay below the strength; break: exceed it"),
            "model_factor": _number_or_law("number") | {"description": "discrepancy of the model on this quantity"},
            "target": _SHARE | {"description": "largest accepted probability of missing the aim"},
            "fracture": _FLAG | {"description": "whether exceeding it breaks the sphere"},
        },
        ("strength",),
    )
    return node | {"oneOf": _present("quantity", "criterion")}


def _gauge() -> Node:
    position = {"$ref": "#/$defs/length", "description": "distance of the gauge from the sphere"}
    return _table({"bar": _words(GAUGE_BARS, "which bar"), "position": position}, ("bar", "position"))


def _dependence() -> Node:
    correlation = {"type": "number", "exclusiveMinimum": -1, "exclusiveMaximum": 1}
    table = _table(
        {
            "of": _list(_text("random input"), least=2),
            "copula": _words(COPULAS, "how they depend"),
            "spearman": correlation | {"description": "rank correlation of every pair"},
            "kendall": correlation | {"description": "in place of spearman: Kendall's rank correlation of every pair"},
            "dof": {
                "type": "number",
                "minimum": LEAST_DOF,
                "maximum": MOST_DOF,
                "description": "degrees of freedom of a Student t copula",
            },
        },
        ("of",),
    )
    return table | {"oneOf": [{"required": ["spearman"]}, {"required": ["kendall"]}]}


def _analysis() -> Node:
    positive = {"type": "number", "exclusiveMinimum": 0}
    budget: dict[str, Node] = {
        "evaluations": {"type": "integer", "minimum": 1, "default": Budget().evaluations},
        "exhaust": _FLAG | {"default": False},
        "time": {"$ref": "#/$defs/time"},
    }
    accuracy = {key: positive | {"default": getattr(Accuracy(), key)} for key in Accuracy.__dataclass_fields__}
    methods = {"anyOf": [{"const": "auto"}, {"const": ["auto"]}, _list({"enum": list(METHODS)})]}
    return _table(
        {
            "quantities": _list(_text(f"quantity of interest: {', '.join(OUTPUTS)}, or an output of a black box")),
            "accuracy": _table(accuracy, ()) | {"description": "half-widths of the 95 % intervals"},
            "budget": _table(budget, ()) | {"description": "where the run stops at the latest"},
            "quantiles": _list(_SHARE),
            "methods": methods,
            "on_failure": _words(get_args(OnFailure), "what a failed evaluation does"),
        },
        (),
    )


def _margins() -> Node:
    end = {"type": ["number", "string"]}
    return _table(
        {
            "solve": _text("the number that is free, such as striker.speed"),
            "between": {"type": "array", "items": end, "minItems": 2, "maxItems": 2},
            "for_probability": _list(_SHARE),
            "for_survival": _list(_SHARE),
            "for_fracture": _list(_SHARE),
            "family": _table({"path": _text("number of the scene"), "values": _list({})}, ["path", "values"]),
            "bars_elastic": {"type": "boolean"},
            "against": {"type": "string", "enum": ["specific_energy"]},
        },
        ("solve", "between"),
    )

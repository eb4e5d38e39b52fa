"""What results.json, manifest.json and study.resolved.json look like, and where one does not look like that.

A shape is a function of a node and its place that returns what is wrong with it, or an empty text.  Entries
that no shape names may be there: later versions add some.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import Any, Final

__all__ = ["ESTIMATE", "MANIFEST", "MOST_ENTRIES", "RESOLVED", "RESULTS", "SAMPLES", "fault_of"]

Shape = Callable[[Any, str], str]

#: entries of one table or list, and characters of one name
MOST_ENTRIES: Final = 100_000
LONGEST_NAME: Final = 5000


def _said(node: Any) -> str:
    words = {dict: "a table", list: "a list", str: "a text", bool: "true or false", type(None): "nothing"}
    return words.get(type(node), "a number")


def fault_of(node: Any, shape: Shape) -> str:
    """Where and how a document differs from its shape, or an empty text."""
    return shape(node, "").removeprefix(".")


def number(node: Any, place: str) -> str:
    return "" if isinstance(node, (int, float)) and not isinstance(node, bool) else f"{place}: found {_said(node)}"


def count(node: Any, place: str) -> str:
    whole = isinstance(node, int) and not isinstance(node, bool) and node >= 0
    return "" if whole else f"{place}: a count is due"


def share(node: Any, place: str) -> str:
    return number(node, place) or ("" if 0.0 <= node <= 1.0 else f"{place}: found {node}, no share")


def text(node: Any, place: str) -> str:
    return "" if isinstance(node, str) else f"{place}: found {_said(node)}, a text is due"


def flag(node: Any, place: str) -> str:
    return "" if isinstance(node, bool) else f"{place}: found {_said(node)}, true or false is due"


def anything(node: Any, place: str) -> str:
    return ""


def maybe(shape: Shape) -> Shape:
    """Null, or the shape."""
    return lambda node, place: "" if node is None else shape(node, place)


def word(*allowed: Any) -> Shape:
    """One of the words, or of the constants."""
    return lambda node, place: (
        ""
        if any(node is a or (isinstance(a, str) and node == a) for a in allowed)
        else f"{place}: not one of {allowed}"
    )


def many(shape: Shape, least: int = 0, most: int = MOST_ENTRIES) -> Shape:
    """A list of one shape."""

    def look(node: Any, place: str) -> str:
        if not isinstance(node, list) or not least <= len(node) <= most:
            return f"{place}: a list is due, of at most {most} entries" if least == 0 else f"{place}: a list is due"
        return next((fault for k, entry in enumerate(node) if (fault := shape(entry, f"{place}[{k}]"))), "")

    return look


def named(shape: Shape, most: int = 5000, names: Callable[[str], bool] | None = None) -> Shape:
    """A table whose entries have one shape."""

    def look(node: Any, place: str) -> str:
        if not isinstance(node, dict) or len(node) > most:
            return f"{place}: a table is due, of at most {most} entries"
        for key, entry in node.items():
            if not key or len(key) > LONGEST_NAME or (names is not None and not names(key)):
                return f"{place}: {key[:60]!r} is no name there"
            fault = shape(entry, f"{place}.{key}")
            if fault:
                return fault
        return ""

    return look


def table(required: Mapping[str, Shape], optional: Mapping[str, Shape] | None = None) -> Shape:
    """A table with certain entries."""

    def look(node: Any, place: str) -> str:
        if not isinstance(node, dict):
            return f"{place}: found {_said(node)}, a table is due"
        lacking = [key for key in required if key not in node]
        if lacking:
            return f"{place}: it lacks {', '.join(lacking)}"
        for key, shape in (*required.items(), *(optional or {}).items()):
            if key in node:
                fault = shape(node[key], f"{place}.{key}")
                if fault:
                    return fault
        return ""

    return look


def both(*shapes: Shape) -> Shape:
    """All of the shapes."""
    return lambda node, place: next((fault for shape in shapes if (fault := shape(node, place))), "")


def _is_share(key: str) -> bool:
    return bool(re.fullmatch(r"\d(?:\.\d+)?(?:e-\d+)?", key)) and 0.0 < float(key) < 1.0


def _ordered(node: Any, place: str) -> str:
    """An interval is not upside down, and a value has its reason where it is absent."""
    if node["low"] is not None and node["high"] is not None and node["low"] > node["high"]:
        return f"{place}: its interval ends before it begins"
    return ""


ESTIMATE: Final = both(
    table(
        {key: maybe(number) for key in ("value", "low", "high", "std_error")} | {"method": text, "evaluations": number},
        {"reason": maybe(text)},
    ),
    _ordered,
)


def _probable(node: Any, place: str) -> str:
    """An estimate of a probability; its interval may reach a little beyond by rounding."""
    fault = ESTIMATE(node, place)
    bad = "" if fault else next((k for k in ("value",) if node[k] is not None and not 0.0 <= node[k] <= 1.0), "")
    return fault or (f"{place}.{bad}: found {node[bad]}, no probability" if bad else "")


_ESTIMATES: Final = named(ESTIMATE)
_IGNORANCE: Final = maybe(
    table(
        {"from": many(table({"input": text, "tests": count}))},
        {"reason": text, "miss": many(share, 2, 2), "alone": named(many(share, 2, 2)), "met": word(True, False, None)},
    )
)


def _opened(node: Any, place: str) -> str:
    """What tests leave open of a probability: its range, or the reason why that is not known."""
    fault = _IGNORANCE(node, place)
    if fault or node is None or "reason" in node:
        return fault
    lacking = [key for key in ("miss", "alone", "met") if key not in node]
    return f"{place}: it lacks {', '.join(lacking)}" if lacking else ""


def _measured(node: Any, place: str) -> str:
    """What to measure first; the rows hang on whether a variance or a probability is meant."""
    row = {"input": text, "tests": count, "observations": maybe(count)}
    by = {"sway": ESTIMATE, "share": number} if node.get("of") == "probability" else {"share": ESTIMATE}
    whole = table({"of": text, "wanted": number, "method": text, "rows": many(table(row | by))})
    return whole(node, place) if node.get("rows") else table({"rows": many(anything)})(node, place)


_MEASURE: Final = maybe(both(table({}), _measured))


def _paired(node: Any, place: str) -> str:
    """First and total indices of the same inputs; Shapley effects have Kucherenko's indices beside them."""
    if set(node["first"]) != set(node["total"]):
        return f"{place}: first and total are of different inputs"
    if node.get("shapley") and "kucherenko" not in node:
        return f"{place}: it lacks kucherenko"
    if node.get("shapley") and any(set(row) != set(node["shapley"]) for row in node["kucherenko"].values()):
        return f"{place}: shapley and kucherenko are of different inputs"
    return ""


_SHARED: Final[dict[str, Shape]] = {
    "shapley": _ESTIMATES,
    "kucherenko": table({"first": _ESTIMATES, "total": _ESTIMATES}),
    "second": _ESTIMATES,
    "groups": named(_ESTIMATES, names=lambda key: key in ("first", "total")),
}
_SENSITIVITY: Final = both(
    table(
        {"first": _ESTIMATES, "total": _ESTIMATES},
        {**_SHARED, "surrogate": table({}, {"kind": maybe(text), "error": maybe(number)}),
         "check": table({}, {"text": text, "agree": word(True, False, None)}), "delta": _ESTIMATES, "pawn": _ESTIMATES,
         "pawn_threshold": maybe(number), "measure_first": _MEASURE},
    ),
    _paired,
)  # fmt: skip
_GIVEN: Final = table(
    {
        "mean": ESTIMATE,
        "quantiles": table({"0.05": ESTIMATE, "0.95": ESTIMATE}),
        "law": table({"mean": maybe(number), "quantiles": table({"0.05": number, "0.95": number})}),
    }
)
_DRIVERS: Final = both(
    table(
        {"of": text, "first": _ESTIMATES, "total": _ESTIMATES},
        {**_SHARED, "explained": maybe(ESTIMATE), "given_failure": maybe(named(_GIVEN))},
    ),
    _paired,
)


def _assumption(node: Any, place: str) -> str:
    """A row of what a verdict takes for granted: with whom a strength depends, or what of its law is put instead."""
    plain = number if node.get("assumption") in ("modulus", "cov") else text
    own = {"with": many(text)} if node.get("assumption") == "dependence" else {"taken": plain, "instead": plain}
    return table(own)(node, place)


_ASSUMED: Final = many(
    both(
        table({"assumption": word("dependence", "modulus", "cov", "law"), "miss": _probable,
               "met": word(True, False, None)}),
        _assumption,
    ),
    most=100,
)  # fmt: skip
_LIMIT: Final = table(
    {
        "quantity": text,
        "aim": word("survive", "break"),
        "target": maybe(share),
        "exceedance": _probable,
        "miss": _probable,
        "reliability_index": maybe(number),
        "margin": table(dict.fromkeys(("median", "0.05", "0.95"), ESTIMATE)),
        "design_point": maybe(named(number)),
        "governing_inputs": maybe(named(number)),
        "met": word(True, False, None),
    },
    {
        "reliability_index_interval": maybe(many(maybe(number), 2, 2)),
        "design_point_reason": maybe(text),
        "design_points": maybe(count),
        "modes": maybe(count),
        "checks": many(text),
        "ignorance": _opened,
        "assumed": _ASSUMED,
        "tests_to_settle": table({"tests": maybe(count), "confidence": share}, {"reason": text}),
        "drivers": maybe(_DRIVERS),
        "measure_first": _MEASURE,
    },
)
_TOLERANCE: Final = table(
    {"coverage": number, "confidence": number, "runs": count, "upper": maybe(number), "lower": maybe(number),
     "between": maybe(many(number, 2, 2))},
    {"reason": maybe(text)},
)  # fmt: skip
_CHECK: Final = table(
    {"check": text, "share": share, "worst": maybe(number), "text": text},
    {f"share_{grade}": share for grade in ("information", "warning", "failure")},
)
_CONSIDERED: Final = table({"error": named(maybe(number)), "correlation": named(maybe(number)), "cost": number})
_MODEL: Final = table(
    {
        "chosen": text,
        "why": text,
        "measured_error": named(maybe(number)),
        "evaluations": named(count),
        "failures": count,
    },
    {
        "failure_reasons": named(count, names=lambda key: bool(re.fullmatch(r"-?\d{1,6}", key))),
        "numbers": named(maybe(number)),
        "considered": named(_CONSIDERED),
        "fallback_share": maybe(share),
        "control": table({}, {"text": text, "indices": text}),
        "saved": table({}, {"full_evaluations": number, "text": text}),
        "undecided": count,
    },
)
_SPEED: Final = table(
    {"method": text, "quantity": text, "evaluations": count, "error": maybe(number), "error_kind": text}
)
_PAPER: Final = table(
    {"quantity": text, "unit": text, "note": text} | {key: maybe(number) for key in ("as_printed", "corrected", "full")}
)
_QUANTITY: Final = table(
    {"unit": text, "mean": ESTIMATE, "sd": ESTIMATE, "quantiles": named(ESTIMATE, names=_is_share),
     "censored_share": _probable},
    {"tolerance": maybe(_TOLERANCE), "ignorance": anything},
)  # fmt: skip

#: an accuracy: what was asked, what was reached, and what the rest would take
_QUESTION: Final = table(
    {"quantity": text, "question": text, "asked": number, "reached": maybe(number), "met": maybe(flag),
     "evaluations": maybe(count), "needed": maybe(number), "text": text},
)  # fmt: skip
_CURVE: Final = {
    "unit": text,
    "values": named(ESTIMATE, names=_is_share),
    "curve": many(both(many(number, 4, 4), lambda n, p: share(n[1], p)), most=10_000),
}
_RESULTS: Final = table(
    {
        "study": table({"title": text, "hash": text, "seed": count}),
        "versions": named(text),
        "inputs": named(table({"dist": text, "mean": maybe(number), "sd": maybe(number), "unit": text})),
        "quantities": named(_QUANTITY, 500),
        "sensitivity": named(_SENSITIVITY, 500),
        "limits": named(_LIMIT, 200),
        "margins": named(
            table(
                {"solve": text, **_CURVE},
                {"against": table({"quantity": text, **_CURVE}, {"reason": text}),
                 "validity": table({"value": number, "samples": count, "checks": many(_CHECK, most=100)}),
                 "band": table({"half_width": number, "asked": number, "evaluations": count},
                               {"needed": maybe(number)}),
                 "steps": table(dict.fromkeys(("step", "asked", "evaluations", "needed"), number)),
                 "bars": table({}, {"yields_at": named(share, names=_is_share)})},
            ),
            200,
        ),
        "model": _MODEL,
        "validity": many(_CHECK, most=100),
        "speed_error": many(_SPEED, most=20_000),
        "accuracy": table({"met": flag, "missed": many(text)},
                          {"stopped_by": named(text), "questions": many(_QUESTION, most=20_000)}),
    },
    {"warnings": many(text, most=1000), "paper": many(_PAPER, most=100)},
)  # fmt: skip


def _belonging(node: Any, place: str) -> str:
    """Margins are those of limits."""
    strange = [name for name in node["margins"] if name not in node["limits"]]
    return f"{place}.margins.{strange[0][:60]}: there is no such limit" if strange else ""


#: the content of results.json
RESULTS: Final = both(_RESULTS, _belonging)

#: the content of manifest.json
MANIFEST: Final = table(
    {},
    {
        "versions": named(text),
        "platform": named(text),
        "hash": text,
        "evaluations": count,
        "evaluations_reused": count,
        "seconds": named(number),
        "speed_error_seconds": many(number, most=20_000),
        "stopped_by_time": flag,
        "interrupted": flag,
        "executor": table({"kind": text, "workers": count, "why": text}, {"seconds_per_evaluation": maybe(number)}),
        "damaged_chunks": many(text),
        "finished": text,
    },
)

_LAW: Final = table(
    {"dist": text, "parameters": named(number), "given": named(number), "lower": maybe(number), "upper": maybe(number),
     "data": many(number)}
)  # fmt: skip

#: the content of study.resolved.json
RESOLVED: Final = table(
    {
        "kind": word("scene", "black box"),
        "fixed": named(number),
        "random": named(_LAW),
        "limits": named(
            table({"quantity": text, "aim": word("survive", "break"), "target": maybe(share),
                   "strength": lambda n, p: "" if n == "random" else number(n, p),
                   "model_factor": lambda n, p: "" if n == "random" else number(n, p)}), 200
        ),
        "analysis": table(
            {
                "quantities": many(text, most=500),
                "on_failure": word("abort", "bound", "drop"),
                "accuracy": table(dict.fromkeys(("mean", "quantile", "sobol", "probability"), number)),
                "budget": table({"evaluations": count, "time": number}),
            },
            {"rows_per_call": maybe(count), "time_limit": maybe(number)},
        ),
    },
    {
        "hash": text,
        "title": text,
        "written_by": text,
        "seed": count,
        "options": named(anything),
        "materials": named(text),
        "sources": named(table({"text": text, "seen": flag})),
        "dependence": many(
            table({"of": many(text, 1), "copula": text}, dict.fromkeys(("spearman", "kendall", "dof"), maybe(number))),
            most=1000,
        ),
        "overrides": many(text, most=1000),
        "model_reference": maybe(text),
    },
)  # fmt: skip

#: the content of samples.json
SAMPLES: Final = table({"inputs": many(text, most=5000), "quantities": many(text, most=500)})

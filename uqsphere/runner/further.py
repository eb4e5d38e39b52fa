"""Rows of the speed-error table for the answers that no stage pursues: they have the error that they come out with."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Final

import numpy as np

from uqsphere.quantities import format_value

__all__ = ["FURTHER", "further_rows"]

#: what each kind of error is called, and the accuracy of the study that it is measured by
FURTHER: Final[dict[str, str]] = {
    "half-width of the worst value over the spread of the curve": "quantile",
    "half-width of the probability of fracture over itself": "probability",
    "largest half-width of a share of the limits": "sobol",
    "half-width of the worst median at fracture over its spread": "quantile",
    "largest half-width of Borgonovo's delta": "sobol",
    "largest half-width of PAWN": "sobol",
    "largest half-width of an index of missing the aim": "sobol",
    "half-width of the worst mean of an input where the aim is missed, over its standard deviation": "mean",
}
_VALUE, _FRACTURE, _SHARE, _MEDIAN, _DELTA, _PAWN, _MISSING, _THERE = FURTHER
#: one standard deviation to either side of a median, and what the 5 and 95 % quantiles lie apart in those
_LOW, _HIGH, _APART = 0.1587, 0.8413, 3.29


def further_rows(results: Mapping[str, Any]) -> list[tuple[str, dict[str, Any]]]:
    """(part of the run, row) for every answer of results.json that has an interval and no course."""
    rows: list[tuple[str, dict[str, Any]]] = []

    def add(part: str, quantity: str, kind: str, estimates: Iterable[Any], scale: float | None = 1.0) -> None:
        known = [e for e in estimates if e and e.get("value") is not None and e.get("low") is not None]
        if not known or not scale or not scale > 0.0:
            return
        worst = max(known, key=_half)
        if _half(worst) > 0.0:
            rows.append(
                (
                    part,
                    {
                        "method": worst["method"],
                        "quantity": quantity,
                        "evaluations": int(worst["evaluations"]),
                        "error": _half(worst) / scale,
                        "error_kind": kind,
                    },
                )
            )

    for name, entry in results["margins"].items():
        for at, curve in _curves(entry):
            add("margins", f"margins.{name}{at}", _VALUE, curve["values"].values(), _spread(curve["curve"]))
    fracture = results.get("fracture") or {}
    for key in ("union", "first_loading"):
        estimate = fracture.get(key) or {}
        # of one limit it is the limit's own
        if key != "union" or len(fracture.get("limits", ())) > 1:
            add("fracture", f"fracture.{key}", _FRACTURE, [estimate], estimate.get("value"))
    if fracture.get("curve"):
        add("fracture", "fracture.curve", _VALUE, fracture["values"].values(), _spread(fracture["curve"]))
    if len(fracture.get("limits", ())) > 1:
        add("fracture", "fracture.governed_by", _SHARE, (fracture.get("governed_by") or {}).values())
    for name in ("time", "force", "energy", "imbalance", "t10"):
        found = fracture.get(name) or {}
        low, high = ((found.get("quantiles", {}).get(p) or {}).get("value") for p in ("0.05", "0.95"))
        if low is not None and high is not None:
            add("fracture", f"fracture.{name}", _MEDIAN, [found["median"]], (float(high) - float(low)) / _APART)
    for name, entry in results["sensitivity"].items():
        add("drivers", name, _DELTA, (entry.get("delta") or {}).values())
        add("drivers", name, _PAWN, (entry.get("pawn") or {}).values())
    for name, limit in results["limits"].items():
        drivers = limit.get("drivers") or {}
        add(
            "drivers",
            f"limits.{name}",
            _MISSING,
            [e for k in ("first", "total") for e in (drivers.get(k) or {}).values()],
        )
        add("drivers", f"limits.{name}", _MISSING, [drivers.get("explained")])
        means = [_over(one) for one in (drivers.get("given_failure") or {}).values()]
        add("drivers", f"limits.{name}", _THERE, means)
    return rows


def _half(estimate: Mapping[str, Any]) -> float:
    return 0.5 * float(estimate["high"] - estimate["low"])


def _curves(entry: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """The curve of a limit, and those of its family, by what is added to its name."""
    yield "", entry
    family = entry.get("family")
    if not family:
        return
    for member in family["members"]:
        yield f" at {family['path']} {format_value(member['value'], family['path'])}", member


def _spread(curve: Sequence[Sequence[float]]) -> float | None:
    """Half of what lies between the two values a standard deviation to either side; None where it does not rise so."""
    if len(curve) < 2:
        return None
    values, probabilities = (np.array([row[k] for row in curve], dtype=float) for k in (0, 1))
    if probabilities[0] > probabilities[-1]:
        values, probabilities = values[::-1], probabilities[::-1]
    if not probabilities[0] <= _LOW < _HIGH <= probabilities[-1]:
        return None
    order = np.argsort(probabilities, kind="stable")
    low, high = np.interp([_LOW, _HIGH], probabilities[order], values[order])
    return 0.5 * abs(float(high - low))


def _over(described: Mapping[str, Any]) -> Mapping[str, Any] | None:
    """The mean of an input over its standard deviation."""
    mean: Mapping[str, Any] = described.get("mean") or {}
    sd = (described.get("sd") or {}).get("value")
    if not sd or mean.get("value") is None or mean.get("low") is None:
        return None
    return {**mean, **{key: mean[key] / sd for key in ("value", "low", "high")}}

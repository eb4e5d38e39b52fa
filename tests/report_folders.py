"""Small result folders made by hand, for tests of the report that need no run."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uqsphere.report.contents import Contents
from uqsphere.results import Results
from uqsphere.results.entries import Est, Resolved

RNG_SEED = 7
ROWS = 400


def html_errors(page: str) -> list[tuple[object, str]]:
    """Places and codes of what is no valid HTML on a page, and ids that it gives twice."""
    html5lib = pytest.importorskip("html5lib")
    parser = html5lib.HTMLParser(strict=False)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        parser.parse(page)
    ids = re.findall(r"<[^>]*\sid=\"([^\"]*)\"", page)
    return [(place, code) for place, code, _ in parser.errors] + [(i, "twice") for i in set(ids) if ids.count(i) > 1]


def _est(value: float, low: float, high: float, error: float, method: str = "by hand") -> dict[str, Any]:
    return {"value": value, "low": low, "high": high, "std_error": error, "method": method, "evaluations": ROWS}


def estimate(value: float | None, half: float = 0.01, reason: str = "not asked for") -> dict[str, Any]:
    """An EST of results.json."""
    if value is None:
        nothing = dict.fromkeys(("value", "low", "high", "std_error"))
        return nothing | {"method": "by hand", "evaluations": 0, "reason": reason}
    return _est(value, value - half, value + half, half / 2.0)


def _quantity(values: np.ndarray, censored: np.ndarray) -> dict[str, Any]:
    share, sd = float(censored.mean()), float(values.std())
    known = sd > 0.0 and share < 1.0

    def est(value: float, half: float) -> dict[str, Any]:
        return estimate(float(value) if known else None, half * sd, "the record ends before it")

    return {
        "unit": "Pa",
        "mean": est(values.mean(), 0.01),
        "sd": est(sd, 0.02),
        "quantiles": {p: est(np.quantile(values, float(p)), 0.03) for p in ("0.05", "0.5", "0.95")},
        "censored_share": _est(share, share, min(1.0, share + 0.01), 0.001, "share"),
    }


def _sensitivity(inputs: list[str], scatter: bool) -> dict[str, Any]:
    if not scatter:
        nothing = {name: estimate(None, reason="no input of the model is random") for name in inputs}
        check = {"text": "no input is random"}
        return {"first": nothing, "total": nothing, "surrogate": {"kind": None}, "check": check}
    shares = 2.0 ** -np.arange(1.0, len(inputs) + 1.0)
    return {
        "first": {n: estimate(float(s)) for n, s in zip(inputs, shares, strict=True)},
        "total": {n: estimate(float(s) + 0.005) for n, s in zip(inputs, shares, strict=True)},
        "surrogate": {"kind": "polynomial chaos", "error": 0.01, "evaluations": ROWS},
        "check": {"agree": True, "text": "Sampling and surrogate agree."},
    }


def with_pairs(folder: Path) -> Path:
    """The same folder with indices of pairs and of groups, and with a band of forces."""
    path = folder / "results.json"
    results = json.loads(path.read_text(encoding="utf-8"))
    for entry in results["sensitivity"].values():
        names = list(entry["first"])
        pairs = [(a, b) for k, a in enumerate(names) for b in names[k + 1 :]]
        entry["second"] = {f"{a}|{b}": estimate(0.04 / (1 + k)) for k, (a, b) in enumerate(pairs)}
        entry["groups"] = {"first": {"all": estimate(0.9)}, "total": {"all": estimate(0.95)}}
    path.write_text(json.dumps(results), encoding="utf-8")
    time = np.linspace(0.0, 1e-3, 50)
    middle = 5e3 * np.sin(np.pi * time / 1e-3)
    face = {"0.05": (0.9 * middle).tolist(), "0.5": middle.tolist(), "0.95": (1.1 * middle).tolist()}
    hardest = {"inputs": {"striker.speed": 0.52}, "force_a": (1.2 * middle).tolist(), "force_b": middle.tolist()}
    courses = {"time": time.tolist(), "force_a": face, "force_b": face, "hardest": hardest, "scenes": 64}
    (folder / "courses.json").write_text(json.dumps(courses), encoding="utf-8")
    return folder


def limit(
    miss: float,
    target: float | None,
    met: bool | None,
    *,
    quantity: str = "p_max",
    aim: str = "survive",
    half: float = 0.0005,
) -> dict[str, Any]:
    """An entry of results["limits"]."""
    exceedance = miss if aim == "survive" else 1.0 - miss
    return {
        "quantity": quantity,
        "aim": aim,
        "target": target,
        "exceedance": estimate(exceedance, half),
        "miss": estimate(miss, half),
        "reliability_index": 2.4,
        "reliability_index_interval": [2.38, 2.42],
        "margin": {"0.05": estimate(1.2), "median": estimate(1.5), "0.95": estimate(1.8)},
        "design_point": None,
        "governing_inputs": {"sphere.E": 0.3, "limits.x.strength": 0.7},
        "met": met,
    }


def _margins(names: list[str]) -> dict[str, Any]:
    from scipy.special import ndtr

    speeds = np.geomspace(0.1, 5.0, 15)
    p = ndtr(3.0 * np.log(speeds / 1.5))
    curve = [[float(v), float(q), 0.9 * float(q), min(1.0, 1.1 * float(q))] for v, q in zip(speeds, p, strict=True)]
    entry = {
        "solve": "striker.speed",
        "unit": "m/s",
        "curve": curve,
        "values": {"0.1": estimate(0.978), "0.5": estimate(1.5), "0.9": estimate(None, reason="not reached")},
    }
    return dict.fromkeys(names, entry)


def _law(dist: str, parameters: dict[str, float], **given: float) -> dict[str, Any]:
    return {"dist": dist, "parameters": parameters, "given": given, "lower": None, "upper": None, "data": []}


_LAW = _law("lognormal", {"log_mean": 24.67, "log_sd": 0.12}, mean=52e9, cov=0.12)
_SPEED = _law("normal", {"mean": 0.5, "sd": 0.01}, mean=0.5, cov=0.02)
_STRENGTH = _law("weibull", {"modulus": 12.0, "scale": 4.17e9, "threshold": 0.0}, modulus=12.0, mean=4e9)


def write_folder(
    folder: Path,
    *,
    title: str = "A study",
    quantities: tuple[str, ...] = ("p_max",),
    inputs: tuple[str, ...] = ("sphere.E", "striker.speed"),
    limits: dict[str, Any] | None = None,
    censored: float = 0.0,
    scatter: bool = True,
    margins: bool = True,
    **more: Any,
) -> Path:
    """A finished run's folder; `more` replaces entries of results.json."""
    limits = {} if limits is None else limits
    rng = np.random.default_rng(RNG_SEED)
    d, q = len(inputs), len(quantities)
    rows = np.zeros((ROWS, d + 2 * q + 1))
    rows[:, :d] = rng.normal(size=(ROWS, d))
    rows[:, d : d + q] = 2.8e9 + (2e8 * rng.normal(size=(ROWS, q)) if scatter else 0.0)
    rows[: round(censored * ROWS), d + q : d + 2 * q] = 1.0
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / "samples.npy", rows)
    kinds = ("half-width of the mean over the standard deviation", "largest half-width of an index")
    history = [
        {"method": method, "quantity": name, "evaluations": n, "error": 2.0 / n, "error_kind": kind}
        for name in quantities
        for method, kind in zip(("sampling", "pick and freeze"), kinds, strict=True)
        for n in (100, 200, 400)
    ]
    random = {name: (_SPEED if name == "striker.speed" else _LAW) for name in inputs} if scatter else {}
    random |= {f"limits.{name}.strength": _STRENGTH for name in limits}
    results = {
        "schema_version": 1,
        "study": {"title": title, "hash": "0" * 64, "seed": 1},
        "versions": {"uqsphere": "0.1.0", "python": "3.11.0"},
        "inputs": {name: {"dist": law["dist"], "mean": 1.0, "sd": 0.1, "unit": ""} for name, law in random.items()},
        "quantities": {name: _quantity(rows[:, d + k], rows[:, d + q + k]) for k, name in enumerate(quantities)},
        "sensitivity": {name: _sensitivity(list(inputs), scatter) for name in quantities},
        "limits": limits,
        "margins": _margins(list(limits)) if margins else {},
        "model": {
            "chosen": "full",
            "why": "asked for",
            "measured_error": {},
            "evaluations": {"full": ROWS},
            "failures": 0,
            "failure_reasons": {},
            "numbers": {"mu_median": 3.4e-4},
        },
        "validity": [
            {
                "check": "small_contact",
                "share": 0.0,
                "share_information": 0.0,
                "share_warning": 0.0,
                "share_failure": 0.0,
                "worst": 0.1,
                "text": "contact small against the sphere",
            }
        ],
        "speed_error": history,
        "accuracy": {"met": True, "missed": [], "stopped_by": {"sampling": "accuracy"}},
        "warnings": [],
        "paper": [],
    }
    results |= more
    resolved = {
        "hash": "0" * 64,
        "title": title,
        "seed": 1,
        "kind": "scene",
        "random": random,
        "fixed": {"sphere.density": 2650.0},
        "limits": {
            name: {
                "quantity": entry["quantity"],
                "strength": "random",
                "aim": entry["aim"],
                "model_factor": 1.0,
                "target": entry["target"],
            }
            for name, entry in limits.items()
        },
        "sources": {"sphere.density": {"text": "a handbook", "seen": False}},
        "options": {"bars.infinite": False},
        "materials": {},
        "dependence": [],
        "margins": None,
        "analysis": {
            "quantities": list(quantities),
            "on_failure": "abort",
            "methods": ["auto"],
            "accuracy": {"mean": 0.002, "quantile": 0.01, "sobol": 0.01, "probability": 0.05},
            "budget": {"evaluations": 1000, "time": 60.0},
        },
    }
    manifest = {
        "seconds": {"total": 1.5},
        "speed_error_seconds": [0.1 * (k + 1) for k in range(len(history))],
        "evaluations": ROWS,
        "evaluations_reused": 0,
        "stopped_by_time": False,
        "platform": {"system": "any"},
    }
    documents = {
        "results": results,
        "manifest": manifest,
        "study.resolved": resolved,
        "samples": {"inputs": list(inputs), "quantities": list(quantities)},
    }
    for name, document in documents.items():
        (folder / f"{name}.json").write_text(json.dumps(document, allow_nan=False), encoding="utf-8")
    return folder


def put(contents: Contents, changes: dict[str, Any]) -> Contents:
    """The contents with other entries in their documents, by places such as "results/limits/x/met"."""
    documents = {name: getattr(contents, name).document() for name in ("results", "resolved")}
    for place, value in changes.items():
        node, *between, last = (int(key) if key.isdigit() else key for key in place.split("/"))
        where: Any = documents[str(node)]
        for key in between:
            where = where[key]
        where[last] = value
    return replace(
        contents,
        results=Results.model_validate(documents["results"]),
        resolved=Resolved.model_validate(documents["resolved"]),
    )


def est(value: float | None, half: float = 0.01, reason: str = "not asked for") -> Est:
    """An estimate as the report reads it."""
    return Est.model_validate(estimate(value, half, reason))

"""What an engineer reads first: assumptions, where bars yield, reserve, one name for the event, numbers of tests."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_folders import est, estimate, limit, write_folder
from scipy.special import ndtr

from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.figures.fragility import lognormal_scores
from uqsphere.report.phrases import safe_side
from uqsphere.report.tables import answer_checks_table, margins_table
from uqsphere.results.entries import LognormalEntry, MarginEntry

_CHECK = {
    "check": "bar_yield_contact", "share": 0.56, "share_information": 0.0, "share_warning": 0.56, "share_failure": 0.0,
    "worst": 1.8, "text": "in 56 % of the rows the bars yield",
}  # fmt: skip


def _margin(value: float, probability: float, aim_rising: bool = True) -> dict[str, Any]:
    curve = [[0.1, 1e-6, 0.0, 1e-5], [0.6, 0.01, 0.009, 0.011], [2.0, 0.95, 0.94, 0.96], [3.0, 0.99, 0.98, 1.0]]
    return {
        "solve": "striker.speed", "unit": "m/s", "curve": curve, "values": {f"{probability:g}": estimate(value, 0.002)},
        "probability": probability, "value": estimate(value, 0.002),
        "split": {"scatter": 0.24, "ignorance": None, "numerical": 8e-4},
        "bars": {
            "yield_strength": 1.9e9, "pulse_stress": 6e6, "pulse_elastic": True, "pulse_value": 97.5,
            "contact_probability": 0.01, "contact": estimate(0.3, 0.002), "yields_at": {f"{probability:g}": 0.56},
        },
        "validity": {"value": value, "samples": 128, "checks": [_CHECK]},
    }  # fmt: skip


def _with_margins(folder: Path, margins: dict[str, Any]) -> Contents:
    path = folder / "results.json"
    path.write_text(json.dumps({**json.loads(path.read_text("utf-8")), "margins": margins}), "utf-8")
    return read_contents(folder)


@pytest.fixture
def two(tmp_path: Path) -> Contents:
    """The same strength to survive and to break, from 20 tests."""
    opened = {
        "from": [{"input": "limits.y.strength", "tests": 20}],
        "miss": [0.9988, 0.9999],
        "alone": {},
        "met": False,
    }
    left = {**limit(0.9995, 0.05, False, aim="break", half=1e-5), "ignorance": opened}
    right = _margin(1.793, 0.95)
    right["ignorance"] = {
        "tests": 20, "stopped": 3, "laws": 200, "low": 1.68, "high": 1.96, "sure": 1.924, "confidence": 0.95,
        "mean_law": 1.8, "sd_log": 0.04, "beyond": 0.0,
    }  # fmt: skip
    right["more_tests"] = {"tests": 20, "known_to": 0.05, "to_know_the_value": 29, "to_settle": 7}
    fracture = {"limits": ["x"], "left_out": ["y"], "union": estimate(0.002, 1e-6)}
    folder = write_folder(tmp_path, limits={"x": limit(0.002, 0.01, True), "y": left}, fracture=fracture)
    return _with_margins(folder, {"x": _margin(0.6585, 0.01), "y": right})


@pytest.mark.parametrize(
    ("value", "half", "most", "expected"),
    [
        (0.65852, 0.0012, True, "0.658 m/s"),
        (0.65852, 0.0012, False, "0.659 m/s"),
        (0.6581, 0.0012, True, "0.658 m/s"),
        (1.2, 0.1, True, "1.2 m/s"),
        (123.7, 20.0, True, "120 m/s"),
    ],
)
def test_a_limit_is_rounded_to_the_safe_side(value: float, half: float, most: bool, expected: str) -> None:
    assert safe_side(est(value, half), "striker.speed", at_most=most) == expected


def test_the_lognormal_curve_is_not_drawn_where_it_would_mislead() -> None:
    x = np.array([0.5, 0.7, 1.0, 1.4])
    z = np.log(x) / 0.25
    curve = np.stack([x, ndtr(z)], axis=1)
    fitted = LognormalEntry(median=est(1.0), dispersion=est(0.25), rising=True)
    entry = MarginEntry(solve="x", unit="", values={}, curve=(), lognormal=fitted)
    assert np.isfinite(lognormal_scores(entry, curve)).all()
    curve[0, 1] *= 50.0
    assert np.isnan(lognormal_scores(entry, curve)).tolist() == [True, False, False, False]


def test_the_table_of_margins_says_where_the_bars_yield(two: Contents) -> None:
    table = margins_table(two, "y")
    assert table.header == (
        "probability", "what the tests leave open (95 %)", "value (95 % interval of the computation alone)",
        "bars yield under the sphere",
    )  # fmt: skip
    assert table.rows[0][1] == "1.68 m/s to 1.96 m/s"
    assert table.rows[0][3] == "56 %"
    checks = answer_checks_table(two, "y")
    assert "At the answer for “y”, 1.793 m/s, on 128 rows" in checks.caption

"""What is stored of the bars over place and time, and read again for the report."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import uqsphere
from uqsphere.mechanics.field import field_grid
from uqsphere.mechanics.history import FieldView, view_field

GRANITE = Path(__file__).resolve().parent.parent / "studies" / "granite.toml"


@pytest.fixture(scope="module")
def view() -> FieldView:
    return view_field(uqsphere.history(uqsphere.load_study(GRANITE)), places=30, times=40)


def test_the_grid_lies_within_the_bars_and_has_the_stress_of_the_field(view: FieldView) -> None:
    history = uqsphere.history(uqsphere.load_study(GRANITE))
    assert view.stress.shape == (40, 30)
    assert -view.reach[0] < view.places[0] < 0.0 < view.places[-1] < view.reach[1]
    assert view.begin < view.times[0] < view.times[-1] < view.last
    assert np.array_equal(view.stress, field_grid(history.motion, view.places, view.times).stress)
    # granite's bars are 1.5 m long; the struck end is free, the other one absorbs
    assert view.reach[0] == pytest.approx(1.5)
    assert view.returns[0] == pytest.approx(3.0 / view.wave_speed)
    assert math.isinf(view.returns[1])


def test_what_is_stored_is_read_again(view: FieldView) -> None:
    document = json.loads(json.dumps(view.as_document(), allow_nan=False))
    again = FieldView.from_document(document)
    assert np.abs(again.stress - view.stress).max() <= 500.0
    assert again.as_document() == document
    assert (again.reach, again.returns, again.tensions) == (view.reach, view.returns, view.tensions)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("stress_kpa", ["1 2", "3"]),
        ("stress_kpa", ["1 nan"]),
        ("stress_kpa", []),
        ("reach", [1.0, -1.0]),
        ("reach", [1.0]),
        ("last", -1e9),
        ("wave_speed", 0.0),
        ("record_end", "late"),
        ("tensions", [{"bar": "third", "position": 0.0, "time": 0.0}]),
    ],
)
def test_what_nobody_wrote_is_refused(view: FieldView, key: str, value: Any) -> None:
    document = copy.deepcopy(view.as_document())
    document[key] = value
    with pytest.raises((ValueError, TypeError)):
        FieldView.from_document(document)

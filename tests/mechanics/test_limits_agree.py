"""Models and scenes that must meet in a limit."""

from __future__ import annotations

import pytest
from scenes import EXAMPLE, example

from uqsphere.mechanics.integrator.solve import solve
from uqsphere.mechanics.scene import Scene

#: a sphere of 10 mm between bars of 12 mm: heavy enough for both faces and echoes
HEAVY = {
    **EXAMPLE,
    "sphere.E": 60e9,
    "sphere.radius": 5e-3,
    "bars.E": 200e9,
    "bars.diameter": 0.012,
    "bars.incident_length": 0.4,
    "bars.receiving_length": 0.4,
    "striker.speed": 5.0,
    "striker.length": 0.1,
}
WITHOUT_ENDS = {
    name: number for name, number in HEAVY.items() if not name.endswith(("length", "end"))
}


def value(scene: Scene, name: str, fidelity: str = "full") -> float:
    return float(
        solve(scene, fidelity=fidelity, tolerance=1e-9, quantities=(name,)).values[name][0]
    )


def test_infinite_bars_are_long_bars_before_the_first_echo() -> None:
    long = example(
        numbers={**HEAVY, "bars.incident_length": 50.0, "bars.receiving_length": 50.0}, horizon=3e-3
    )
    infinite = example(numbers={**WITHOUT_ENDS, "striker.length": 0.1}, infinite=True, horizon=3e-3)
    names = ("p_max", "first_peak", "force_imbalance", "energy", "rise_time", "contact_duration")
    one, two = (solve(scene, tolerance=1e-9, quantities=names).values for scene in (long, infinite))
    for name in names:
        assert one[name][0] == pytest.approx(two[name][0], rel=1e-7), name


def test_bars_that_reflect_nothing_are_infinite() -> None:
    dull = example(
        numbers={**HEAVY, "bars.incident_end": 0.0, "bars.receiving_end": 0.0}, horizon=5e-4
    )
    infinite = example(numbers={**WITHOUT_ENDS, "striker.length": 0.1}, infinite=True, horizon=5e-4)
    for name in ("p_max", "energy", "force_imbalance", "contact_duration"):
        assert value(dull, name) == pytest.approx(value(infinite, name), rel=1e-12), name


def test_the_first_loading_ends_at_the_echo() -> None:
    first = example(numbers=HEAVY, first_loading_only=True)
    assert value(first, "p_max") == value(first, "first_peak")
    assert value(first, "p_max") == pytest.approx(
        value(example(numbers=HEAVY), "first_peak"), rel=1e-7
    )

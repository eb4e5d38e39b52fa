"""The target of a limit is decided once, and everything that reads a study reads it there."""

from __future__ import annotations

import pytest

from uqsphere.propagation.design import Design
from uqsphere.study import Limit, Study, load_study, shipped_studies

BOX = {"outputs": "y", "inputs": {"x": {"dist": "normal", "mean": 0.0, "sd": 1.0}}}


def limits(**targets: object) -> dict[str, object]:
    return {name: {"quantity": "y", "strength": 2.0, **keys} for name, keys in targets.items()}


@pytest.mark.parametrize(
    ("given", "margins", "target"),
    [
        ({"a": {}, "b": {"target": 0.2}, "c": {"target": 0.05}}, None, 0.05),
        ({"a": {}, "b": {"target": 0.2, "aim": "break"}}, None, 0.01),
        ({"a": {}}, {"solve": "x", "between": [-1.0, 1.0], "for_probability": [0.3, 0.1]}, 0.1),
        # at 0.75 of exceedance a quarter of the spheres that must break do not
        (
            {"a": {"aim": "break"}},
            {"solve": "x", "between": [-1.0, 1.0], "for_probability": [0.5, 0.75]},
            0.25,
        ),
        ({"a": {}}, None, 0.01),
        ({"a": {"target": 0.4}, "b": {"target": 0.2}}, None, 0.4),
    ],
)
def test_a_limit_without_a_target_takes_the_least_of_its_aim(given, margins, target):
    study = Study(**BOX, limits=limits(**given), margins=margins)
    first = study.limits[0]
    assert first.target == target
    assert first.has_target == ("target" in given["a"])


def test_a_target_allows_its_complement_where_the_sphere_must_break():
    survive = Limit(name="a", quantity="y", strength=1.0, target=0.03)
    broken = Limit(name="a", quantity="y", strength=1.0, target=0.03, aim="break")
    assert (survive.allowable, broken.allowable) == (0.03, 0.97)
    assert survive.missed(0.2) == 0.2
    assert broken.missed(0.2) == 0.8


def test_assumed_modes_take_the_least_target_of_the_limits():
    path = shipped_studies()["granite"]
    further = ("limits.soft.quantity='p_max'", "limits.soft.strength='5 GPa'")
    hertz = ("limits.soft.strength_is='hertz'",)
    study = load_study(path, (*further, *hertz, "limits.soft.target=0.001"))
    modes = Design.of(study).modes
    assert modes
    assert {mode.limit.target for mode in modes} == {0.001}

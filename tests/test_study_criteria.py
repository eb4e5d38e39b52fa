"""Criteria in a study: what is understood, what is refused, and what the model then answers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uqsphere import load_study
from uqsphere.errors import StudyError
from uqsphere.mechanics.criteria import CRITERIA, demand
from uqsphere.model import answer_scene
from uqsphere.quantities import lookup
from uqsphere.study import Study

SCENE = """
[sphere]
material = "granite"
radius = { dist = "normal", mean = "10 mm", cov = 0.02 }
[bars]
material = "maraging_steel"
diameter = "40 mm"
infinite = true
[striker]
speed = "1 m/s"
length = "0.4 m"
[limits.split]
"""
WEIBULL = 'strength = { dist = "weibull", scale = "40 MPa", modulus = 9 }\n'
VOLUME = 'criterion = "weakest_link_volume"\nreference_volume = "1 cm3"\n'


def study(limit: str, tmp_path: Path) -> Study:
    path = tmp_path / "study.toml"
    path.write_text(SCENE + limit, encoding="utf-8")
    return load_study(path)


def test_a_criterion_without_parameters_is_its_quantity(tmp_path: Path) -> None:
    limit = study('criterion = "ring_crack"\nstrength = "1.2 MPa.sqrt(m)"\n', tmp_path).limits[0]
    assert (limit.quantity, limit.criterion, limit.strength) == ("ring_crack_toughness", None, 1.2e6)
    other = study('quantity = "ring_crack_toughness"\nstrength = "1.2 MPa.sqrt(m)"\n', tmp_path)
    assert other.limits[0] == limit


def test_the_modulus_is_that_of_the_strength(tmp_path: Path) -> None:
    found = study(VOLUME + WEIBULL, tmp_path)
    assert found.limits[0].parameters == {"modulus": 9.0, "reference_volume": pytest.approx(1e-6)}
    assert found.limits[0].quantity == "weakest_link_volume.split"
    assert "weakest_link_volume.split" in found.analysis.quantities
    assert lookup("weakest_link_volume.split").unit == "Pa"
    same = study(VOLUME + "modulus = 9\n" + WEIBULL, tmp_path)
    assert same.hash == found.hash
    assert study(VOLUME.replace("1 cm3", "2 cm3") + WEIBULL, tmp_path).hash != found.hash


def test_a_strength_that_is_no_weibull_law_is_worth_a_word(tmp_path: Path) -> None:
    assert not study(VOLUME + WEIBULL, tmp_path).warnings
    found = study(VOLUME + 'modulus = 9\nstrength = "40 MPa"\n', tmp_path)
    assert any("weakest link" in text for text in found.warnings)


@pytest.mark.parametrize(
    ("limit", "words"),
    [
        ('criterion = "weakest_link"\n' + WEIBULL, 'unknown criterion "weakest_link"'),
        ('criterion = "core_tension"\nquantity = "p_max"\n' + WEIBULL, "leave one of them out"),
        ('criterion = "weakest_link_volume"\n' + WEIBULL, "reference_volume is missing"),
        (VOLUME + 'strength = "40 MPa"\n', "modulus is missing"),
        (VOLUME + "modulus = 8\n" + WEIBULL, "the strength has the modulus 9"),
        (VOLUME + "modulus = 0.5\n" + WEIBULL, "Weibull modulus m must lie between 1"),
        (VOLUME + 'reference_area = "1 cm2"\n' + WEIBULL, "takes no reference_area"),
        (VOLUME.replace("1 cm3", "0 cm3") + WEIBULL, "must be above 0"),
        (VOLUME.replace("1 cm3", "1 cm2") + WEIBULL, "unknown unit 'cm2' for a volume"),
        ('quantity = "p_max"\nmodulus = 8\n' + WEIBULL, "modulus belongs to a criterion"),
        ('criterion = "subsurface_shear"\nrate_0 = "200 1/s"\n' + WEIBULL, "takes no rate_0"),
        (VOLUME + WEIBULL.replace("MPa", "kN"), "unknown unit 'kN' for a pressure"),
    ],
)
def test_what_is_wrong_is_said_once(limit: str, words: str, tmp_path: Path) -> None:
    with pytest.raises(StudyError, match=words) as caught:
        study(limit, tmp_path)
    assert str(caught.value).count("\n") < 4


def test_a_black_box_has_no_criterion(tmp_path: Path) -> None:
    path = tmp_path / "box.toml"
    path.write_text('[inputs]\nx = 1.0\n[outputs]\nnames = ["y"]\n[limits.high]\ncriterion = "core_tension"\n'
                    "strength = 1.0\n", encoding="utf-8")  # fmt: skip
    with pytest.raises(StudyError, match="belongs to the impact model"):
        load_study(path)


@pytest.mark.parametrize("fidelity", ["massless", "full"])
def test_the_model_answers_the_demand(fidelity: str, tmp_path: Path) -> None:
    limits = VOLUME + WEIBULL + '[limits.rate]\ncriterion = "core_tension"\nrate_0 = "200 1/s"\n' + WEIBULL
    found = study(limits, tmp_path)
    names = ["p_max", "P_max", "a_max", "loading_rate", "weakest_link_volume.split", "core_tension.rate"]
    radius = np.array([[0.009], [0.011]])
    values = answer_scene(found, ["sphere.radius"], radius, names, fidelity=fidelity).values
    columns = dict(zip(names, values.T, strict=True)) | {"sphere.radius": radius[:, 0]}
    columns |= {name: np.full(2, found.at_means()[name]) for name in ("sphere.nu", "sphere.E")}
    wanted = demand(CRITERIA["weakest_link_volume"], columns, {"modulus": 9.0, "reference_volume": 1e-6})
    assert columns["weakest_link_volume.split"] == pytest.approx(wanted, rel=1e-12)
    assert columns["core_tension.rate"] == pytest.approx(
        demand(CRITERIA["core_tension"], columns, {"rate_0": 200.0}), rel=1e-5
    )
    # what a demand needs is followed although nobody asked for it
    alone = answer_scene(found, ["sphere.radius"], radius, ["core_tension.rate"], fidelity=fidelity).values
    assert alone[:, 0] == pytest.approx(columns["core_tension.rate"], rel=1e-5)

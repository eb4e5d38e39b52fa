"""Strengths from crushing tests in a study, and what an inverse question may ask: right, and every fault told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uqsphere.errors import StudyError
from uqsphere.mechanics.contact import pressure_at_force, reduced_modulus
from uqsphere.study import ENERGY, Study, load_study

SCENE = """
[sphere]
E = "60 GPa"
nu = 0.25
density = "2700 kg/m3"
radius = { dist = "normal", mean = "10 mm", cov = 0.01 }
[bars]
material = "steel"
diameter = "40 mm"
incident_length = "2 m"
receiving_length = "2 m"
[striker]
speed = { dist = "normal", mean = "0.5 m/s", cov = 0.03 }
length = "0.5 m"
"""
TESTS = 'strength = { dist = "empirical", file = "t.csv", force = "F", force_unit = "kN", diameter = "D", diameter_unit = "mm", censored = "stop" }'  # noqa: E501
CSV = "F,D,stop\n6,20,0\n7,20.2,0\n5,19.8,0\n8,20,1\n6.5,20,0\n7.5,20,no\n8,20,yes\n"
MARGINS = '[margins]\nsolve = "striker.speed"\nbetween = ["0.1 m/s", "5 m/s"]\n'
Load = Callable[..., Study]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def with_parts(
        strength: str = TESTS, csv: str = CSV, quantity: str = 'quantity = "p_max"', margins: str = ""
    ) -> Study:
        (tmp_path / "t.csv").write_text(csv)
        text = f"{SCENE}\n[limits.a]\n{quantity}\n{strength}\ntarget = 0.01\n{margins}"
        (tmp_path / "study.toml").write_text(text)
        return load_study(tmp_path / "study.toml")

    return with_parts


def test_forces_become_pressures_by_hertz(load: Load) -> None:
    law = load().limits[0].strength
    assert law.family.name == "weibull"
    modulus = reduced_modulus(60e9, 0.25, 205e9, 0.29)
    study = load()
    modulus = reduced_modulus(60e9, 0.25, study.fixed["bars.E"], study.fixed["bars.nu"])
    forces, diameters = np.array([5e3, 6e3, 6.5e3, 7e3, 7.5e3]), np.array([19.8, 20.0, 20.0, 20.2, 20.0]) * 1e-3
    assert law.data == pytest.approx(np.sort(pressure_at_force(forces, modulus, 0.5 * diameters)), rel=1e-12)
    assert law.censored == pytest.approx([pressure_at_force(8e3, modulus, 10e-3)] * 2, rel=1e-12)


def test_every_kind_of_demand(load: Load) -> None:
    force = load(quantity='quantity = "P_max"').limits[0].strength
    assert force.data == pytest.approx([5e3, 6e3, 6.5e3, 7e3, 7.5e3])
    rigid = TESTS.replace('diameter = "D", diameter_unit = "mm"', 'diameter = "20 mm", platens = "rigid"')
    assert load(rigid).limits[0].strength.data[0] > load().limits[0].strength.data[0]
    practice = load(quantity='criterion = "hiramatsu_oka"').limits[0].strength
    assert practice.data[0] == pytest.approx(0.9 * 5e3 / 19.8e-3**2)
    flaws = load(quantity='criterion = "weakest_link_volume"\nreference_volume = "1 cm3"').limits[0]
    # the modulus that makes the demand is the one that the tests give
    assert flaws.parameters["modulus"] == flaws.strength.parameters["modulus"]
    assert (
        load(TESTS.replace(" }", ', fit = "lognormal", unbiased = true }')).limits[0].strength.family.name
        == "lognormal"
    )


def test_the_bias_is_taken_out_on_request(load: Load) -> None:
    plain, corrected = (
        load(TESTS.replace(" }", f", unbiased = {word} }}")).limits[0].strength for word in ("false", "true")
    )
    assert corrected.parameters["modulus"] < plain.parameters["modulus"]
    assert corrected.parameters["scale"] == plain.parameters["scale"]


@pytest.mark.parametrize(
    ("change", "csv", "says"),
    [
        (("", ""), "F,D,stop\n", "has no row"),
        (("", ""), "F,D,stop\n6,20,1\n7,20,1\n", "all 2 tests were stopped"),
        (("", ""), "F,D,stop\n6,20,0\n-7,20,0\n", r"t\.csv:3: the force at failure must be above 0, found -7"),
        (("", ""), "F,D,stop\n6,20,0\n7,0,0\n", "the diameter must be above 0"),
        (("", ""), "F,D,stop\n6,20,0\n7,20,1\n", "only one failure"),
        (("", ""), "F,D,stop\n6,20,0\n7,20,maybe\n", "0 or 1"),
        (("", ""), "F,D\n6,20\n7,20\n", 'column "stop" is not in'),
        (("", ""), "F,D,stop\n6,20,0\nx,20,0\n", "finite number is due"),
        (('"F"', '"f"'), CSV, "strength.force: the column \"f\" is not in"),
        ((', force_unit = "kN"', ""), CSV, "add force_unit"),
        (('"kN"', '"mm"'), CSV, "force_unit: found \"mm\""),
        ((', diameter = "D", diameter_unit = "mm"', ""), CSV, "diameter is missing"),
        (("censored", "cencored"), CSV, "did you mean 'censored'"),
        ((" }", ', platens = "stel" }'), CSV, "did you mean 'steel'"),
        ((" }", ', fit = "kde" }'), CSV, "weibull"),
        ((" }", ', unbiased = 1 }'), CSV, "true or false"),
        (('"t.csv"', '"../t.csv"'), CSV, "own folder only"),
    ],
)  # fmt: skip
def test_tests_refused(load: Load, change: tuple[str, str], csv: str, says: str) -> None:
    with pytest.raises(StudyError, match=says):
        load(TESTS.replace(*change, 1) if change[0] else TESTS, csv)


@pytest.mark.parametrize(
    ("strength", "says"),
    [
        ('strength = { dist = "weibull", mean = "4 GPa", modulus = 0 }', "modulus must be positive, found 0"),
        ('strength = { dist = "weibull", mean = "4 GPa", modulus = -3 }', "modulus must be positive, found -3"),
        ('strength = { dist = "empirical", file = "t.csv", column = "F", unit = "GPa", censored = "stop" }', "stopped"),
        ('strength = { dist = "empirical", file = "t.csv", column = "F", unit = "GPa", unbiased = true }', "bias"),
    ],
)
def test_strengths_refused(load: Load, strength: str, says: str) -> None:
    with pytest.raises(StudyError, match=says):
        load(strength)


def test_plain_columns_may_hold_stopped_tests(load: Load) -> None:
    column = 'strength = { dist = "empirical", file = "t.csv", column = "F", unit = "GPa", fit = "weibull", censored = "stop" }'  # noqa: E501
    law = load(column).limits[0].strength
    assert (len(law.data), len(law.censored)) == (5, 2)
    with pytest.raises(StudyError, match="all 2 tests were stopped"):
        load(column, "F,stop\n1,1\n2,1\n")


def test_inverse_questions(load: Load) -> None:
    margins = load(margins=MARGINS + "for_survival = [0.999]\nfor_fracture = [0.95]\nfor_probability = [0.5]\n").margins
    assert margins.for_probability == pytest.approx((0.001, 0.5, 0.95))
    family = load(margins=MARGINS + 'family = { path = "sphere.radius", values = ["12 mm", "8 mm"] }\n').margins.family
    assert family.values == pytest.approx((0.008, 0.012))
    strength = 'between = ["1 GPa", "9 GPa"]'
    found = load(margins=f'[margins]\nsolve = "limits.a.strength"\n{strength}\n').margins
    assert (found.axis.low, found.axis.high) == pytest.approx((1e9, 9e9))
    energy = load(margins=f'[margins]\nsolve = "{ENERGY}"\nbetween = ["1 J/kg", "50 J/kg"]\n').margins
    assert (energy.axis.low, energy.axis.high, energy.axis.kind) == (1.0, 50.0, "energy")
    quantities = load(quantity='quantity = "P_max"', margins=MARGINS + "bars_elastic = true\n").analysis.quantities
    assert quantities == ("P_max", "p_max")


@pytest.mark.parametrize(
    ("margins", "says"),
    [
        (MARGINS + "for_probability = [0.0, 0.5]\n", "between 0 and 1, both excluded"),
        (MARGINS + "for_survival = [1.0]\n", "for_survival.*both excluded"),
        (MARGINS + "for_fracture = [-0.1]\n", "for_fracture.*both excluded"),
        (MARGINS.replace("0.1 m/s", "9 m/s"), "the lower value must come first"),
        (MARGINS.replace("0.1 m/s", "0 m/s"), "speed of the striker must be above 0"),
        (MARGINS.replace("speed", "sped"), "did you mean"),
        (MARGINS + 'family = { path = "striker.speed", values = ["1 m/s"] }\n', "is the free number itself"),
        (MARGINS + 'family = { path = "sphere.size", values = ["1 mm"] }\n', "is no number of this scene"),
        (MARGINS + 'family = { path = "sphere.radius", values = ["8 mm", "8 mm"] }\n', "named twice"),
        (MARGINS + 'family = { path = "sphere.radius", values = ["8 s"] }\n', "unknown unit"),
        (MARGINS + 'family = { path = "sphere.radius" }\n', "values is missing"),
        ('[margins]\nsolve = "limits.a.strength"\nbetween = ["-1 GPa", "9 GPa"]\n', "must be above 0"),
    ],
)
def test_inverse_questions_refused(load: Load, margins: str, says: str) -> None:
    with pytest.raises(StudyError, match=says):
        load(margins=margins)


def test_a_family_over_a_number_that_is_faulty_is_no_second_fault() -> None:
    file = Path(__file__).parents[1] / "studies" / "limestone_margin.toml"
    with pytest.raises(StudyError, match="no unit") as caught:
        load_study(file, ["sphere.radius=10"])
    assert len(caught.value.problems) == 1


def test_slow_tests_in_a_quick_rig_are_told_of(load: Load) -> None:
    slow = 'criterion = "core_tension"'
    assert any("slow tests in a quick rig" in text for text in load(quantity=slow).warnings)
    quick = load(quantity=f"{slow}\nrate_0 = '200 1/s'")
    assert not any("slow tests in a quick rig" in text for text in quick.warnings)

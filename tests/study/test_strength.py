"""Strengths from crushing tests: the values they reached, the force that is worth a row, and what is implausible."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from uqsphere.errors import StudyError
from uqsphere.mechanics import contact
from uqsphere.study import Study, load_study
from uqsphere.study.strength import Demand, equivalent_force, test_force
from uqsphere.uq import Law

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
TESTS = (
    'strength = { file = "t.csv", force = "F", force_unit = "kN", diameter = "D", diameter_unit = "mm", '
    'censored = "stop" }'
)
CSV = "F,D,stop\n6,20,0\n7,20.2,0\n5,19.8,0\n8,20,1\n6.5,20,0\n7.5,20,no\n8,20.0,yes\n"
Load = Callable[..., Study]
STEEL = (205e9, 0.29)


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def with_parts(
        strength: str = TESTS, csv: str = CSV, quantity: str = 'quantity = "p_max"', scene: str = SCENE
    ) -> Study:
        (tmp_path / "t.csv").write_text(csv)
        (tmp_path / "study.toml").write_text(f"{scene}\n[limits.a]\n{quantity}\n{strength}\ntarget = 0.01\n")
        return load_study(tmp_path / "study.toml")

    return with_parts


def test_forces_become_pressures_by_hertz(load: Load) -> None:
    study = load()
    law = study.limits[0].strength
    assert isinstance(law, Law)
    modulus = contact.reduced_modulus(60e9, 0.25, study.fixed["bars.E"], study.fixed["bars.nu"])
    forces, diameters = np.array([5e3, 6e3, 6.5e3, 7e3, 7.5e3]), np.array([19.8, 20.0, 20.0, 20.2, 20.0]) * 1e-3
    pressures = np.sort(np.asarray(contact.pressure_at_force(forces, modulus, 0.5 * diameters)))
    assert law.data == pytest.approx(pressures, rel=1e-12)
    assert law.censored == pytest.approx([float(contact.pressure_at_force(8e3, modulus, 10e-3))] * 2, rel=1e-12)


def test_the_tests_themselves_are_kept(load: Load) -> None:
    tested = load().limits[0].tested
    assert tested is not None
    assert tested.law is not None
    assert sorted(tested.forces) == pytest.approx([5e3, 6e3, 6.5e3, 7e3, 7.5e3, 8e3, 8e3])
    assert tested.suspended == (False, False, False, True, False, False, True)
    assert tested.diameter == pytest.approx(20e-3, rel=1e-3)
    assert tested.law.family.name == "weibull"
    # area of the contact's surroundings: F = F_0 (D/D_0)^(2 - 2/m)
    assert tested.size == "weakest link"
    assert tested.exponent == pytest.approx(2.0 - 2.0 / tested.law.parameters["modulus"], rel=1e-10)


def test_every_kind_of_demand(load: Load) -> None:
    assert load(quantity='quantity = "P_max"').limits[0].strength.data == pytest.approx([5e3, 6e3, 6.5e3, 7e3, 7.5e3])
    rigid = TESTS.replace('diameter = "D", diameter_unit = "mm"', 'diameter = "20 mm", platens = "rigid"')
    assert load(rigid).limits[0].strength.data[0] > load().limits[0].strength.data[0]
    practice = load(quantity='criterion = "hiramatsu_oka"').limits[0].strength
    assert practice.data[0] == pytest.approx(0.9 * 5e3 / 19.8e-3**2)
    flaws = load(quantity='criterion = "weakest_link_volume"\nreference_volume = "1 cm3"').limits[0]
    # the modulus that makes the demand is the one that the tests give
    assert flaws.parameters["modulus"] == flaws.strength.parameters["modulus"]
    lognormal = load(TESTS.replace(" }", ', fit = "lognormal", unbiased = true }')).limits[0]
    assert lognormal.strength.family.name == "lognormal"
    assert lognormal.tested is not None
    assert lognormal.tested.size == "none"


FORCE, RADIUS = np.array([800.0, 5e3, 40e3]), np.array([4e-3, 10e-3, 20e-3])
SPHERE = {"E": np.array([50e9, 60e9, 75e9]), "nu": np.array([0.2, 0.25, 0.3]), "density": 2700.0}


def _closed() -> dict[str, np.ndarray]:
    """Value of each criterion at those forces by its own formula."""
    E, nu, D = SPHERE["E"], SPHERE["nu"], 2.0 * RADIUS
    modulus = 1.0 / ((1.0 - nu**2) / E + (1.0 - STEEL[1] ** 2) / STEEL[0])
    pressure = (6.0 * FORCE * modulus**2 / (np.pi**3 * RADIUS**2)) ** (1.0 / 3.0)
    approach = (9.0 * FORCE**2 / (16.0 * modulus**2 * RADIUS)) ** (1.0 / 3.0)
    mass = SPHERE["density"] * np.pi * D**3 / 6.0
    both = 2.0 * 0.4 * FORCE * approach
    return {
        "P_max": FORCE, "p_max": pressure, "p_hertz": pressure, "edge_tension": (1.0 - 2.0 * nu) / 3.0 * pressure,
        "ring_crack_toughness": np.sqrt(FORCE * E / (8600.0 * RADIUS)), "grain_tension": FORCE / D**2,
        "centre_tension": 21.0 * FORCE / (np.pi * (7.0 + 5.0 * nu) * D**2),
        "specific_energy_sphere": modulus * (1.0 - nu**2) / E * both / mass, "specific_impact_energy": both / mass,
    }  # fmt: skip


@pytest.mark.parametrize("quantity", _closed())
def test_the_equivalent_force_is_the_closed_form(quantity: str) -> None:
    value = _closed()[quantity]
    found = equivalent_force(Demand(quantity=quantity, parameters={}), value, SPHERE, RADIUS, STEEL)
    assert found == pytest.approx(FORCE, rel=1e-11)


@pytest.mark.parametrize("pole", [{}, {"onset_pressure": 1e9, "hardness": 2.5e9}], ids=["elastic", "yielding"])
@pytest.mark.parametrize(
    ("quantity", "criterion", "parameters"),
    [
        ("core_tension", None, {}),
        ("subsurface_shear", None, {}),
        ("equatorial_tension", None, {}),
        ("p_hertz", None, {}),
        ("specific_energy_sphere", None, {}),
        ("w", "weakest_link_volume", {"modulus": 9.0, "reference_volume": 1e-6}),
        ("w", "weakest_link_rim", {"modulus": 9.0, "reference_area": 1e-4}),
    ],
)
def test_it_gives_back_the_value(
    quantity: str, criterion: str | None, parameters: dict[str, float], pole: dict[str, float]
) -> None:
    from uqsphere.study.strength import _reached, _state

    demand = Demand(quantity=quantity, criterion=criterion, parameters=parameters)
    force = np.array([500.0, 3e3, 20e3])
    value = _reached(_state(force, {**SPHERE, **pole}, RADIUS, STEEL), demand)
    found = equivalent_force(demand, value, {**SPHERE, **pole}, RADIUS, STEEL)
    assert found == pytest.approx(force, rel=1e-8)


def test_with_test_and_use_alike_the_share_broken_is_that_of_the_tests(load: Load) -> None:
    """Whatever E and nu of the rows: only the force and the size count."""
    limit = load(quantity='criterion = "core_tension"').limits[0]
    tested = limit.tested
    assert tested is not None
    assert tested.law is not None
    from uqsphere.study.strength import _reached, _state

    rng = np.random.default_rng(3)
    n = 400
    sphere = {"E": rng.uniform(30e9, 90e9, n), "nu": rng.uniform(0.15, 0.4, n), "density": 2700.0}
    force, radius = rng.uniform(4e3, 9e3, n), np.full(n, 0.5 * tested.diameter)
    value = _reached(_state(force, sphere, radius, tested.platens), Demand(quantity=limit.quantity, parameters={}))
    assert test_force(limit, value, sphere, radius) == pytest.approx(force, rel=1e-9)
    # a sphere twice as large bears the force that the weakest link of its volume lets it
    larger = test_force(limit, value, sphere, 2.0 * radius)
    own = equivalent_force(limit, value, sphere, 2.0 * radius, tested.platens)
    m = tested.law.parameters["modulus"]
    assert tested.law.sf(larger) == pytest.approx(
        np.exp(-8.0 * (own / 4.0 / tested.law.parameters["scale"]) ** m), rel=1e-9
    )


@pytest.mark.parametrize(
    ("change", "csv", "says"),
    [
        (("", ""), "F,D,stop\n", "has no row"),
        (("", ""), "F,D,stop\n6,20,1\n7,20.1,1\n", "all 2 tests were stopped"),
        (("", ""), "F,D,stop\n6,20,0\n-7,20,0\n", "strength.force: t.csv: line 3: the force must be above 0"),
        (("", ""), "F,D,stop\n6,20,0\n7,0,0\n", "the diameter must be above 0"),
        (("", ""), "F,D,stop\n6,20,0\n7,20,1\n", "only one failure"),
        (("", ""), "F,D,stop\n6,20,0\n7,20,maybe\n", "0 or 1"),
        (("", ""), "F,D\n6,20\n7,20\n", "column 'stop' is not in"),
        (("", ""), "F,D,stop\n6,20,0\nx,20,0\n", "where a number is required"),
        (('"F"', '"f"'), CSV, "strength.force: the column 'f' is not in"),
        ((', force_unit = "kN"', ""), CSV, "add force_unit"),
        (('"kN"', '"mm"'), CSV, "force_unit: found 'mm'"),
        ((', diameter = "D", diameter_unit = "mm"', ""), CSV, "diameter is missing"),
        (("censored", "cencored"), CSV, "did you mean 'censored'"),
        ((" }", ', platens = "stel" }'), CSV, "did you mean 'steel'"),
        ((" }", ', fit = "kde" }'), CSV, "need a fit"),
        (('"t.csv"', '"../t.csv"'), CSV, "own folder only"),
        (('"t.csv"', '"u.csv"'), CSV, 'there is no file "u.csv" beside the study; did you mean'),
    ],
)
def test_tests_refused(load: Load, change: tuple[str, str], csv: str, says: str) -> None:
    with pytest.raises(StudyError) as caught:
        load(TESTS.replace(*change) if change[0] else TESTS, csv)
    assert says in str(caught.value)
    assert "limits.a.strength" in str(caught.value)


ROWS = [
    "11.9,2830",
    "11.9,2260",
    "11.6,2200",
    "12.5,3050",
    "12.5,2890",
    "12.2,2710",
    "11.3,2780",
    "12.2,2980",
    "11.2,1360",
    "11.6,2060",
    "12.1,2530",
    "12.2,2180",
]
PELLET = SCENE.replace('"60 GPa"', '"20 GPa"').replace('"10 mm"', '"6 mm"')
FORCES = (
    'strength = { file = "t.csv", force = "F", force_unit = "N", diameter = "D", diameter_unit = "mm", '
    'platens = "steel" }'
)

#: how tests go wrong, and what is warned of: unit key, rows, phrase (empty: nothing but what is usual)
IMPLAUSIBLE = {
    "as they were": (("", ""), ROWS, ""),
    "kN for N": (('"N"', '"kN"'), ROWS, "usual are 0.2 to 500 MPa: is the unit N?"),
    "MN for N": (('"N"', '"MN"'), ROWS, "is the unit N?"),
    "cm for mm": (('"mm"', '"cm"'), ROWS, "mean diameter of 119"),
    "a decimal slip": (("", ""), ["11.9,28300", *ROWS[1:]], "line 2 (10.8 times the median): far from the other rows"),
    "rows pasted twice": (("", ""), ROWS * 2, "repeat earlier rows: pasted twice?"),
    "a mean row": (("", ""), [*ROWS, "11.9,2486"], "line 14 is the mean of the rows above"),
}  # fmt: skip


@pytest.mark.parametrize(("change", "rows", "says"), IMPLAUSIBLE.values(), ids=IMPLAUSIBLE)
def test_implausible_tests_are_warned_of(load: Load, change: tuple[str, str], rows: list[str], says: str) -> None:
    strength = FORCES.replace(*change) if change[0] else FORCES
    warnings = load(strength, "\n".join(["D,F", *rows]), 'criterion = "core_tension"', PELLET).warnings
    odd = [text for text in warnings if "slow tests" not in text]
    assert any(says in text for text in odd) if says else odd == [], odd


def test_a_shape_that_no_law_has_is_warned_of(load: Load) -> None:
    rng = np.random.default_rng(5)
    rows = [
        f"12.{k % 10},{force:.0f}" for k, force in enumerate([*rng.normal(1000, 20, 20), *rng.normal(4000, 80, 20)])
    ]
    warnings = load(FORCES, "\n".join(["D,F", *rows]), 'criterion = "core_tension"', PELLET).warnings
    assert any("neither a Weibull nor a lognormal" in text for text in warnings)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('E = "60 GPa"', 'E = "20 MPa"', "sphere.E: 0.02 GPa is unusual"),
        ("cov = 0.03", "cov = 15", "15 times the mean"),
        ('"2700 kg/m3"', '"3.7 kg/m3"', "sphere.density: 3.7 kg/m3 is unusual"),
        ('strength = "4 GPa"', 'strength = "4 Pa"', "limits.a.strength: 4e-09 GPa is unusual"),
        ('quantity = "p_max"\nstrength = "4 GPa"', 'quantity = "specific_energy"\nstrength = "200 '
                                                   'kJ/kg"', "2e+05 J/kg is unusual"),
    ],
)  # fmt: skip
def test_unusual_numbers_are_warned_of(old: str, new: str, says: str, tmp_path: Path) -> None:
    text = f'{SCENE}\n[limits.a]\nquantity = "p_max"\nstrength = "4 GPa"\n'
    assert old in text
    study = load_study(tmp_path / "s.toml", text=text.replace(old, new))
    assert any(says in warning for warning in study.warnings), study.warnings
    assert load_study(tmp_path / "s.toml", text=text).warnings == ()


def test_draws_are_a_strength(load: Load, tmp_path: Path) -> None:
    (tmp_path / "draws.csv").write_text(
        "distribution,scale_J/kg,shape,bound,tests,diameter [mm]\nlognormal,100,0.5,0,30,20\n"
        "lognormal,120,0.6,0.2,30,20\nweibull,110,2,0,30,20\n"
    )
    limit = load(
        'strength = { draws = "draws.csv" }', quantity='criterion = "specific_energy"\nenergy_is = "sphere"'
    ).limits[0]
    law = limit.strength
    assert isinstance(law, Law)
    assert len(law.draws) == 3
    x = np.array([60.0, 100.0, 200.0])
    from scipy import stats

    bounded = stats.norm.cdf((np.log(x / 120) - np.log1p(-0.2 * x / 120)) / 0.6)
    mean = (stats.lognorm(0.5, scale=100).cdf(x) + bounded + stats.weibull_min(2, scale=110).cdf(x)) / 3.0
    assert law.cdf(x) == pytest.approx(mean, abs=1e-6)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ('column = "F", unit = "GPa", fit = "weibull"', ""),
        ('column = "F", fit = "weibull"', "the unit of the column 'F' is missing"),
        ('column = "G", unit = "GPa"', "column 'G' is not in"),
        ('unit = "GPa"', "column is missing"),
    ],
)
def test_a_column_of_strengths(load: Load, keys: str, says: str) -> None:
    strength = f'strength = {{ dist = "empirical", file = "t.csv", {keys} }}'
    if not says:
        assert load(strength).limits[0].strength.family.name == "weibull"
        return
    with pytest.raises(StudyError) as caught:
        load(strength)
    assert says in str(caught.value)

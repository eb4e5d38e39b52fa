"""Strengths from crushing tests: the values they reached, the force that is worth a row, and what
is implausible.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from uqsphere.errors import StudyError
from uqsphere.mechanics import contact
from uqsphere.mechanics.crushing import Demand, force_at, value_at
from uqsphere.models.model import Model
from uqsphere.propagation.design import Design, demands_of
from uqsphere.propagation.tables import evaluate
from uqsphere.report.study import described
from uqsphere.study import Limit, Study, load_study
from uqsphere.uq import Law, Sample
from uqsphere.uq.fitting import modulus_of

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
    'strength = { file = "t.csv", force = "F", force_unit = "kN", diameter = "D", diameter_unit '
    '= "mm", '
    'censored = "stop" }'
)
CSV = "F,D,stop\n6,20,0\n7,20.2,0\n5,19.8,0\n8,20,1\n6.5,20,0\n7.5,20,no\n8,20.0,yes\n"
Load = Callable[..., Study]
STEEL = (205e9, 0.29)


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def with_parts(
        strength: str = TESTS,
        csv: str = CSV,
        quantity: str = 'quantity = "p_max"',
        scene: str = SCENE,
    ) -> Study:
        (tmp_path / "t.csv").write_text(csv)
        (tmp_path / "study.toml").write_text(
            f"{scene}\n[limits.a]\n{quantity}\n{strength}\ntarget = 0.01\n"
        )
        return load_study(tmp_path / "study.toml")

    return with_parts


def test_forces_become_pressures_by_hertz(load: Load) -> None:
    study = load()
    law = study.limits[0].strength
    assert isinstance(law, Law)
    modulus = contact.reduced_modulus(60e9, 0.25, study.fixed["bars.E"], study.fixed["bars.nu"])
    forces, diameters = (
        np.array([5e3, 6e3, 6.5e3, 7e3, 7.5e3]),
        np.array([19.8, 20.0, 20.0, 20.2, 20.0]) * 1e-3,
    )
    pressures = np.sort(np.asarray(contact.pressure_at_force(forces, modulus, 0.5 * diameters)))
    assert law.data == pytest.approx(pressures, rel=1e-12)
    assert law.censored == pytest.approx(
        [float(contact.pressure_at_force(8e3, modulus, 10e-3))] * 2, rel=1e-12
    )


def test_the_tests_themselves_are_kept(load: Load) -> None:
    tested = load().limits[0].tested
    assert tested is not None
    assert tested.law is not None
    assert sorted(tested.forces) == pytest.approx([5e3, 6e3, 6.5e3, 7e3, 7.5e3, 8e3, 8e3])
    assert tested.diameter == pytest.approx(20e-3, rel=1e-3)
    assert tested.law.family.name == "weibull"
    # area of the contact's surroundings: F = F_0 (D/D_0)^(2 - 2/m)
    assert tested.exponent == pytest.approx(2.0 - 2.0 / tested.law.parameters["modulus"], rel=1e-10)


def test_every_kind_of_demand(load: Load) -> None:
    assert load(quantity='quantity = "P_max"').limits[0].strength.data == pytest.approx(
        [5e3, 6e3, 6.5e3, 7e3, 7.5e3]
    )
    rigid = TESTS.replace(
        'diameter = "D", diameter_unit = "mm"', 'diameter = "20 mm", platens = "rigid"'
    )
    assert load(rigid).limits[0].strength.data[0] > load().limits[0].strength.data[0]
    practice = load(quantity='criterion = "hiramatsu_oka"').limits[0].strength
    assert practice.data[0] == pytest.approx(0.9 * 5e3 / 19.8e-3**2)
    flaws = load(quantity='criterion = "weakest_link_volume"\nreference_volume = "1 cm3"').limits[0]
    # the modulus that makes the demand is the one that the tests give
    assert flaws.parameters["modulus"] == flaws.strength.parameters["modulus"]
    lognormal = load(TESTS.replace(" }", ', fit = "lognormal", unbiased = true }')).limits[0]
    assert lognormal.strength.family.name == "lognormal"
    assert lognormal.tested is not None
    assert lognormal.tested.exponent == 2.0


def test_counts_and_a_known_modulus(load: Load) -> None:
    counted = load(
        TESTS.replace(" }", ', count = "n" }'), "F,D,stop,n\n6,20,0,2\n7,20,0,1\n8,20,1,40\n"
    ).limits[0]
    each = load(csv="F,D,stop\n6,20,0\n6,20,0\n7,20,0\n" + "8,20,1\n" * 40).limits[0]
    assert counted.tested == each.tested
    for criterion in ("contact_pressure", "hiramatsu_oka"):
        none = load(
            TESTS.replace(" }", ", modulus = 8 }"),
            "F,D,stop\n6,20,1\n7,20,1\n",
            f'criterion = "{criterion}"',
        )
        tested, law = none.limits[0].tested, none.limits[0].strength
        assert modulus_of(tested.law) == 8.0
        # p ~ F^(1/3): a force of the modulus 8 is a pressure of 24
        assert modulus_of(law) == pytest.approx(
            24.0 if criterion == "contact_pressure" else 8.0, rel=0.05
        )
        # no failure at 6 and 7 kN: half of the laws put the scale above that of one failure in 0.69
        scales = np.array([draw[2] for draw in tested.law.draws])
        assert np.median(scales) == pytest.approx(
            ((6e3**8 + 7e3**8) / np.log(2.0)) ** 0.125, rel=1e-3
        )


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
        "P_max": FORCE,
        "p_max": pressure,
        "p_hertz": pressure,
        "edge_tension": (1.0 - 2.0 * nu) / 3.0 * pressure,
        "ring_crack_toughness": np.sqrt(FORCE * E / (8600.0 * RADIUS)),
        "grain_tension": FORCE / D**2,
        "centre_tension": 21.0 * FORCE / (np.pi * (7.0 + 5.0 * nu) * D**2),
        "specific_energy_sphere": modulus * (1.0 - nu**2) / E * both / mass,
        "specific_impact_energy": both / mass,
    }


@pytest.mark.parametrize("quantity", _closed())
def test_the_equivalent_force_is_the_closed_form(quantity: str) -> None:
    value = _closed()[quantity]
    found = force_at(value, quantity, SPHERE, RADIUS, STEEL)
    assert found == pytest.approx(FORCE, rel=1e-11)


@pytest.mark.parametrize(
    "pole",
    [{}, {"onset_pressure": 1e9, "hardness": 2.5e9, "pile_up": 2.0, "takes": 1.0}],
    ids=["elastic", "yielding"],
)
@pytest.mark.parametrize(
    "demand",
    [
        "core_tension",
        "subsurface_shear",
        "equatorial_tension",
        "p_hertz",
        "specific_energy_sphere",
        ("weakest_link_volume", {"modulus": 9.0, "reference_volume": 1e-6}),
        ("weakest_link_rim", {"modulus": 9.0, "reference_area": 1e-4}),
    ],
)
def test_it_gives_back_the_value(demand: Demand, pole: dict[str, float]) -> None:
    force = np.array([500.0, 3e3, 20e3])
    value = value_at(force, demand, {**SPHERE, **pole}, RADIUS, STEEL)
    assert force_at(value, demand, {**SPHERE, **pole}, RADIUS, STEEL) == pytest.approx(
        force, rel=1e-8
    )


BASALT = """
sphere = { E = %s, nu = %s, density = "2900 kg/m3", radius = "7.5 mm" }
%s
[limits.a]
%s
target = 0.5
strength = { file = "b.csv", force = "F", force_unit = "kN", diameter = "15 mm", \
platens = "maraging_steel" }
"""
TESTED = (
    "F\n7.42\n9.85\n8.31\n6.20\n8.77\n10.42\n7.95\n6.88\n9.10\n8.02\n5.61\n8.54\n7.13\n9.47\n8.66\n"
)
PLATENS = (
    'rig = { kind = "platens" }\nplatens = { material = "maraging_steel", force = "7.228 kN" }'
)
BARS = (
    'bars = { material = "maraging_steel", diameter = "25 mm", incident_length = "2 m", '
    'receiving_length = "2 m" }\n'
    'striker = { speed = "2 m/s", length = "0.3 m" }'
)
WIDE = (
    '{ dist = "uniform", lower = "50 GPa", upper = "90 GPa" }',
    '{ dist = "uniform", lower = 0.15, upper = 0.35 }',
)
PLASTIC = 'contact = { law = "plastic", onset_pressure = "2 GPa", hardness = "6 GPa" }'
ENERGY = 'criterion = "specific_energy"\nenergy_is = '
DEMANDS = [
    *(
        f'criterion = "{name}"'
        for name in (
            "edge_tension",
            "ring_crack",
            "core_tension",
            "centre_tension",
            "equatorial_tension",
            "hiramatsu_oka",
            "grain_tension",
            "subsurface_shear",
        )
    ),
    'criterion = "weakest_link_volume"\nreference_volume = "1 cm3"',
    'criterion = "weakest_link_surface"\nreference_area = "1 cm2"',
]


def evaluated(
    tmp_path: Path, scatter: tuple[str, str], rig: str, demand: str
) -> tuple[Limit, Sample, np.ndarray]:
    """The limit, 16 x 8 rows, and the forces in the tests that they are worth."""
    (tmp_path / "b.csv").write_text(TESTED)
    study = load_study(tmp_path / "s.toml", text=BASALT % (*scatter, rig, demand))
    design = Design.of(study)
    sample = evaluate(design, Model(design.study), design.points(8))
    return study.limits[0], sample, sample.answer(study.limits[0].column)


@pytest.mark.parametrize("contact", ["", PLASTIC], ids=["elastic", "yielding"])
@pytest.mark.parametrize("rig", [PLATENS, BARS], ids=["platens", "bars"])
def test_with_test_and_use_alike_only_the_force_counts(
    rig: str, contact: str, tmp_path: Path
) -> None:
    """Whatever E and nu of the rows: the equivalent test force is the row's own, by every
    criterion.
    """
    quiet = f'{rig}\n{contact}\nanalysis.quantities = ["P_max"]'
    pressure = 'criterion = "contact_pressure"' + ('\nstrength_is = "hertz"' if contact else "")
    energies = [ENERGY + '"sphere"', ENERGY + '"contact"'] if rig == PLATENS else []
    for demand in (pressure, *DEMANDS, *energies):
        _, sample, force = evaluated(tmp_path, WIDE, quiet, demand)
        assert force == pytest.approx(sample.answer("P_max"), rel=1e-6), demand


def test_the_share_broken_is_that_of_the_tests_for_any_scatter(tmp_path: Path) -> None:
    """By hand: the likeliest Weibull law of the 15 forces breaks 22.7 % at 7.228 kN."""
    by_hand = stats.weibull_min(7.3147, scale=8700.29).cdf(7228.0)
    assert by_hand == pytest.approx(0.2271, abs=1e-4)
    core = 'criterion = "core_tension"'
    for scatter in (('"70 GPa"', "0.25"), WIDE):
        limit, _, force = evaluated(tmp_path, scatter, PLATENS, core)
        assert limit.tested.law.cdf(force) == pytest.approx(by_hand, abs=1e-5)
    shares = []
    for nu in ("0.25", '{ dist = "beta", mean = 0.25, sd = 0.03, lower = 0.05, upper = 0.45 }'):
        modulus = '{ dist = "lognormal", mean = "70 GPa", cov = 0.1 }'
        limit, _, force = evaluated(tmp_path, (modulus, nu), BARS, core)
        shares.append(limit.tested.law.cdf(force).mean())
    # E moves the load, and so the share; nu does so by a fifth of a percent of a point
    assert all(0.22 < share < 0.25 for share in shares)
    assert abs(shares[1] - shares[0]) < 0.004


def hertz(E: Any, nu: float, E_2: float, nu_2: float, radius: Any) -> tuple[Any, Any]:
    """beta of F = beta alpha^1.5, and the sphere's share of the energy."""
    star = 1.0 / ((1.0 - nu**2) / E + (1.0 - nu_2**2) / E_2)
    return 4.0 / 3.0 * star * np.sqrt(radius), star * (1.0 - nu**2) / E


def by_hand_between_bars() -> float:
    """Basalt, 2 m/s: a mass between two springs F = beta a^1.5 and two impedances, while the pulse
    lasts.
    """
    beta, _ = hertz(70e9, 0.25, 190e9, 0.3, 7.5e-3)
    wave, mass = math.sqrt(190e9 / 8000.0), 2900.0 * 4.0 / 3.0 * math.pi * 7.5e-3**3
    impedance = 8000.0 * wave * math.pi * 12.5e-3**2

    def rates(_: float, y: np.ndarray) -> list[float]:
        push = beta * np.maximum(y[:2], 0.0) ** 1.5
        return [
            2.0 - push[0] / impedance - y[2],
            y[2] - push[1] / impedance,
            (push[0] - push[1]) / mass,
        ]

    path = solve_ivp(
        rates, (0.0, 0.6 / wave), [0.0, 0.0, 0.0], rtol=1e-9, atol=1e-12, max_step=1e-7
    ).y
    return float(beta * path[:2].max() ** 1.5)


def by_hand_of_pellets(normals: np.ndarray) -> tuple[np.ndarray, float]:
    """A fall through 1 m of air onto steel, F = beta^0.4 (5 W/2)^0.6; P(broken) by the likeliest
    law of the forces.
    """
    u = np.sqrt(math.log1p(0.15**2))
    E, radius, height = (
        20e9 * np.exp(u * normals[0] - u * u / 2.0),
        6e-3 + 0.25e-3 * normals[1],
        1.0 + 0.05 * normals[2],
    )

    work = (
        3700.0 * 4.0 / 3.0 * math.pi * radius**3 * 9.80665 * height * 0.992
    )  # a percent for the air
    force = hertz(E, 0.2, 205e9, 0.29, radius)[0] ** 0.4 * (2.5 * work) ** 0.6
    diameter, broke = np.array(
        [[float(c) for c in row.split(",")] for row in ALL_PELLETS.split()]
    ).T
    m = 5.0
    for _ in range(40):
        m, _, scale = stats.weibull_min.fit(
            broke * (diameter.mean() / diameter) ** (2.0 - 2.0 / m), floc=0.0
        )
    at = force * (1e-3 * diameter.mean() / (2.0 * radius)) ** (2.0 - 2.0 / m)
    return at, float(stats.weibull_min(m, scale=scale).cdf(at).mean())


def by_hand_of_a_hammer(normals: np.ndarray) -> tuple[np.ndarray, float]:
    """40 kg at 30 m/s: W = m_r v²/2 in both contacts, the sphere's share of it; P(broken),
    lognormal 160 J/kg.
    """
    u = np.sqrt(math.log1p(0.15**2))
    E, radius, speed = (
        60e9 * np.exp(u * normals[0] - u * u / 2.0),
        12.5e-3 + 0.5e-3 * normals[1],
        30.0 + 1.5 * normals[2],
    )

    ratio = 2800.0 * 4.0 / 3.0 * math.pi * radius**3 / 40.0
    energy = 0.5 * speed**2 / (1.0 + ratio) * hertz(E, 0.25, 190e9, 0.28, radius)[1]
    strength = stats.lognorm(math.sqrt(math.log(1.25)), scale=160.0 / math.sqrt(1.25))
    return energy, float(strength.cdf(energy).mean())


SPHERES = {
    "pellets": """sphere = { E = { dist = "lognormal", mean = "20 GPa", cov = 0.15 },
 nu = 0.2, density = "3700 kg/m3", radius = { dist = "normal", mean = "6 mm", sd = "0.25 mm" } }
rig = { kind = "impact", drop_height = { dist = "normal", mean = "1 m", cov = "5 %" } }
target = { material = "steel" }
limits.a = { criterion = "contact_pressure", target = "1 %",
 strength = { file = "p.csv", force = "F", force_unit = "N", diameter = "D",
 diameter_unit = "mm", platens = "steel" } }""",
    "hammer": """sphere = { E = { dist = "lognormal", mean = "60 GPa", cov = 0.15 },
 nu = 0.25, density = "2800 kg/m3", radius = { dist = "normal", mean = "12.5 mm", sd = "0.5 mm" } }
rig = { kind = "impact", speed = { dist = "normal", mean = "30 m/s", cov = 0.05 } }
target = { E = "190 GPa", nu = 0.28, density = "7870 kg/m3", kind = "mass", mass = "40 kg" }
limits.a = { criterion = "specific_energy", energy_is = "sphere", aim = "break",
 strength = { dist = "lognormal", mean = "160 J/kg", cov = 0.5 } }""",
}
ALL_PELLETS = """11.9,2830 11.9,2260
11.6,2200 12.5,3050 12.5,2890 12.2,2710 11.3,2780 12.2,2980 11.2,1360
11.6,2060 12.1,2530 12.2,2180 12.1,2860 11.7,3820 12.3,3630 11.7,1950 11.8,2370 12.3,2810 11.8,1860
11.8,3370 11.6,2520 12.2,1720
12,3600 11.1,1960 12,1980"""


def test_a_basalt_between_bars_is_the_one_by_hand(tmp_path: Path) -> None:
    *_, force = evaluated(
        tmp_path,
        ('"70 GPa"', "0.25"),
        f'{BARS}\ncontact.law = "hertz"',
        'criterion = "core_tension"',
    )
    assert force == pytest.approx(by_hand_between_bars(), rel=1e-3)
    assert force == pytest.approx(7228.0, rel=2e-3)


@pytest.mark.parametrize("case", SPHERES)
def test_pellets_and_a_hammer_are_those_by_hand(case: str, tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("\n".join(["D,F", *ALL_PELLETS.split()]))
    text = SPHERES[case].replace(",\n", ",")
    study = load_study(tmp_path / "s.toml", ["contact.law=hertz"], text=text)
    design = Design.of(study)
    sample = evaluate(design, Model(design.study), design.points(256))
    limit = study.limits[0]
    names = ("sphere.E", "sphere.radius", "rig.drop_height" if case == "pellets" else "rig.speed")
    normals = np.array([sample.scores[:, :, sample.names.index(name)].ravel() for name in names])
    rows, share = (by_hand_of_pellets if case == "pellets" else by_hand_of_a_hammer)(normals)
    assert sample.answer(limit.column).ravel() == pytest.approx(rows, rel=2e-3)
    assert limit.resistance.cdf(demands_of(limit, sample)).mean() == pytest.approx(share, rel=0.01)


def test_rows_and_the_free_number_have_one_size_law(load: Load, tmp_path: Path) -> None:
    """A sphere of another size breaks at F (D/D_0)^(2 - 3/m), by the weakest link of its volume,
    whoever asks.
    """
    core = 'criterion = "core_tension"'
    tested = load(quantity=core).limits[0].tested
    m = tested.law.parameters["modulus"]
    assert tested.exponent == pytest.approx(2.0 - 3.0 / m, rel=1e-10)
    forces = []
    for radius, moves in ((9e-3, True), (9e-3, False), (9.5e-3, False)):
        scene = SCENE.replace(
            '{ dist = "normal", mean = "10 mm", cov = 0.01 }',
            "'10 mm'" if moves else f"'{radius} m'",
        )
        study = load(quantity=core, scene=scene)
        design = Design.of(study)
        points = design.points(8)
        if moves:
            column = np.full(points.scores.shape[:2], radius)
            points = replace(
                points,
                names=(*points.names, "sphere.radius"),
                inputs=np.dstack([points.inputs, column]),
            )
        sample = evaluate(design, Model(design.study), points)
        forces.append(sample.answer(study.limits[0].column))
    assert forces[0] == pytest.approx(forces[1], rel=1e-9)
    assert forces[2] != pytest.approx(forces[1], rel=1e-3)


def test_a_force_of_tests_of_another_size_is_not_sent_to_a_fit(load: Load) -> None:
    scene = SCENE.replace('{ dist = "normal", mean = "10 mm", cov = 0.01 }', '"16 mm"')
    for kind in ("weibull", "lognormal"):
        tests = TESTS.replace(" }", f', fit = "{kind}" }}')
        with pytest.raises(StudyError, match="a force has no size law") as caught:
            load(tests, quantity='quantity = "P_max"', scene=scene)
        assert "set fit" not in str(caught.value)


@pytest.mark.parametrize(
    ("strength", "radius", "between", "says"),
    [
        ('fit = "lognormal"', "16 mm", "", "no size law covers more than 50 %"),
        ('fit = "lognormal"', "12 mm", '["8 mm", "14 mm"]', ""),
        (
            'fit = "lognormal"',
            "12 mm",
            '["8 mm", "16 mm"]',
            "margins.between: the tests of a have a mean diameter",
        ),
        (
            'fit = "lognormal"',
            '{ dist = "normal", mean = "12 mm", cov = 0.2 }',
            "",
            "the sphere of 35",
        ),
        ('fit = "weibull"', "12 mm", '["8 mm", "26 mm"]', ""),
        ("draws", "10 mm", '["8 mm", "26 mm"]', "fit again with strength_at of this size"),
        ("draws", "16 mm", "", "fit again with strength_at of this size"),
    ],
)
def test_sizes_beyond_half_as_much_need_a_law(
    strength: str, radius: str, between: str, says: str, load: Load, tmp_path: Path
) -> None:
    (tmp_path / "draws.csv").write_text(
        "distribution,scale [GPa],shape,diameter [mm]\nlognormal,4,0.1,20\n"
    )
    tests = (
        TESTS.replace(" }", f", {strength} }}")
        if strength != "draws"
        else 'strength = { draws = "draws.csv" }'
    )
    own = radius if radius.startswith("{") else f'"{radius}"'
    scene = SCENE.replace('{ dist = "normal", mean = "10 mm", cov = 0.01 }', own)
    scene = (
        f'margins = {{ solve = "sphere.radius", between = {between} }}\n' if between else ""
    ) + scene
    if not says:
        assert (
            load(tests, quantity='criterion = "contact_pressure"', scene=scene).margins is not None
        )
        return
    with pytest.raises(StudyError) as caught:
        load(tests, quantity='criterion = "contact_pressure"', scene=scene)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("change", "csv", "says"),
    [
        (("", ""), "F,D,stop\n", "has no row"),
        (("", ""), "F,D,stop\n6,20,1\n7,20.1,1\n", "all 2 tests are right-censored"),
        (
            ("", ""),
            "F,D,stop\n6,20,0\n-7,20,0\n",
            "strength.force: t.csv: line 3: the force must be above 0",
        ),
        (("", ""), "F,D,stop\n6,20,0\n7,0,0\n", "the diameter must be above 0"),
        (("", ""), "F,D,stop\n6,20,0\n7,20,1\n", "only one failure"),
        (("", ""), "F,D,stop\n6,20,0\n7,20,maybe\n", "0 or 1"),
        (("", ""), "F,D,stop\n6,20,0\n6,20,0\n6,20,0\n", "all 3 observations are equal"),
        (
            (" }", ', count = "n" }'),
            "F,D,stop,n\n6,20,0,2\n7,20,0,1.5\n",
            "line 3: count must be a positive integer",
        ),
        (("", ""), "F,D\n6,20\n7,20\n", "column 'stop' is not in"),
        (("", ""), "F,D,stop\n6,20,0\nx,20,0\n", "is not a number"),
        (('"F"', '"f"'), CSV, "strength.force: the column 'f' is not in"),
        ((', force_unit = "kN"', ""), CSV, "add force_unit"),
        (('"kN"', '"mm"'), CSV, "force_unit: force_unit must be one of N, mN"),
        ((', diameter = "D", diameter_unit = "mm"', ""), CSV, "diameter is missing"),
        (("censored", "cencored"), CSV, "did you mean 'censored'"),
        ((" }", ', platens = "stel" }'), CSV, "did you mean 'steel'"),
        ((" }", ', lower = "1 GPa" }'), CSV, "strength.lower: lower is not used with force = …"),
        (
            ('diameter = "D", diameter_unit = "mm"', 'diameter = "20 furlong"'),
            CSV,
            "diameter: unknown unit",
        ),
        ((" }", ', fit = "kde" }'), CSV, "need a fit"),
        (('"t.csv"', '"../t.csv"'), CSV, "a relative path inside the study's folder"),
        (('"t.csv"', '"a/../t.csv"'), CSV, "a relative path inside the study's folder"),
        (('"t.csv"', '"u.csv"'), CSV, 'there is no file "u.csv" beside the study; did you mean'),
    ],
)
def test_tests_refused(load: Load, change: tuple[str, str], csv: str, says: str) -> None:
    with pytest.raises(StudyError) as caught:
        load(TESTS.replace(*change) if change[0] else TESTS, csv)
    assert says in str(caught.value)
    assert "limits.a.strength" in str(caught.value)


ROWS = ALL_PELLETS.split()[:12]
PELLET = SCENE.replace('"60 GPa"', '"20 GPa"').replace('"10 mm"', '"6 mm"')
PELLET += '[contact]\nlaw = "hertz"\n'
FORCES = (
    'strength = { file = "t.csv", force = "F", force_unit = "N", diameter = "D", diameter_unit = '
    '"mm", '
    'platens = "steel" }'
)

#: how tests go wrong, and what is warned of: unit key, rows, phrase (empty: nothing but what is
#: usual)
IMPLAUSIBLE = {
    "as they were": (("", ""), ROWS, ""),
    "kN for N": (('"N"', '"kN"'), ROWS, "usual are 0.2 to 500 MPa: is the unit N?"),
    "MN for N": (('"N"', '"MN"'), ROWS, "is the unit N?"),
    "cm for mm": (
        ('"mm"', '"cm"'),
        ROWS,
        "more than a factor of three, the first is 119 mm: is the unit mm?",
    ),
    "three tests": (("", ""), ROWS[:3], "only 3 observations: the epistemic uncertainty is large"),
    "a decimal slip": (
        ("", ""),
        ["11.9,28300", *ROWS[1:]],
        "line 2 (11.3 times the median): far from the other rows",
    ),
    "a slip of a diameter": (
        ("", ""),
        ["119,2830", *ROWS[1:]],
        "line 2 (0.0119 times the median): far from the other",
    ),
    "rows pasted twice": (("", ""), ROWS * 2, "repeat earlier rows: pasted twice?"),
    "one wide sphere": (
        ("", ""),
        [*ROWS, "119,2830"],
        "1 of 13 diameters differ from the sphere's by more than a factor of three",
    ),
    "a mean row": (("", ""), [*ROWS, "", "11.9,2486"], "line 14: empty, left out. If a mean"),
}


@pytest.mark.parametrize(("change", "rows", "says"), IMPLAUSIBLE.values(), ids=IMPLAUSIBLE)
def test_implausible_tests_are_warned_of(
    load: Load, change: tuple[str, str], rows: list[str], says: str
) -> None:
    strength = FORCES.replace(*change) if change[0] else FORCES
    warnings = load(
        strength, "\n".join(["D,F", *rows]), 'criterion = "core_tension"', PELLET
    ).warnings
    odd = [text for text in warnings if "quasi-static" not in text]
    assert any(says in text for text in odd) if says else odd == [], odd


@pytest.mark.parametrize(
    ("aim", "held", "says"), [("survive", [], "conservative"), ("break", ["rate"], "fewer would")]
)
def test_quasi_static_tests_hold_what_is_to_break(
    load: Load, aim: str, held: list[str], says: str
) -> None:
    study = load(FORCES, "\n".join(["D,F", *ROWS]), f'criterion = "core_tension"\naim = "{aim}"')
    assert [code for code, _, _ in study.caveats if code == "rate"] == held
    assert any(says in text and "limits.a.rate_0" in text for text in study.warnings), (
        study.warnings
    )


def test_tests_at_the_rate_of_the_rig_need_no_column_of_rates() -> None:
    changes = ['limits.whole.rate_0="200 1/s"']
    study = load_study("studies/limestone_margin.toml", changes)
    assert [place for _, place, _ in study.caveats] == ["limits.crushed.strength"]


def test_a_size_law_that_does_not_agree_is_refused(load: Load) -> None:
    with pytest.raises(StudyError, match="did not converge"):
        load(FORCES, "\n".join(["D,F", *ROWS, "119,283000"]), 'criterion = "core_tension"', PELLET)


def test_a_shape_that_no_law_has_is_warned_of(load: Load) -> None:
    rng = np.random.default_rng(5)
    rows = [
        f"12.{k % 10},{force:.0f}"
        for k, force in enumerate([*rng.normal(1000, 20, 20), *rng.normal(4000, 80, 20)])
    ]
    warnings = load(
        FORCES, "\n".join(["D,F", *rows]), 'criterion = "core_tension"', PELLET
    ).warnings
    assert any("neither a Weibull nor a lognormal" in text for text in warnings)


def test_rounded_tests_are_no_shape_of_their_own(load: Load) -> None:
    forces = np.random.default_rng(5).lognormal(7.0, 0.1, 200)
    rows = [f"12,{50.0 * np.round(force / 50.0):.0f}" for force in forces]
    warnings = load(
        FORCES, "\n".join(["D,F", *rows]), 'criterion = "core_tension"', PELLET
    ).warnings
    assert not any("neither a Weibull nor a lognormal" in text for text in warnings)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('E = "60 GPa"', 'E = "20 MPa"', "sphere.E: 0.02 GPa is unusual"),
        ("cov = 0.03", "cov = 15", "coefficient of variation is 15"),
        ('"2700 kg/m3"', '"3.7 kg/m3"', "sphere.density: 3.7 kg/m3 is unusual"),
        ('strength = "4 GPa"', 'strength = "4 Pa"', "limits.a.strength: 4e-09 GPa is unusual"),
        ('strength = "4 GPa"', 'strength = "4 MPa"', "limits.a.strength: 0.004 GPa is unusual"),
        (
            'quantity = "p_max"\nstrength = "4 GPa"',
            'criterion = "core_tension"\nstrength = "26 GPa"',
            "usual: 0.1 MPa",
        ),
        (
            'quantity = "p_max"\nstrength = "4 GPa"',
            'quantity = "specific_energy"\nstrength = "200 kJ/kg"',
            "200000 J/kg is unusual",
        ),
    ],
)
def test_unusual_numbers_are_warned_of(old: str, new: str, says: str, tmp_path: Path) -> None:
    text = f'{SCENE}\n[limits.a]\nquantity = "p_max"\nstrength = "4 GPa"\n'
    assert old in text
    study = load_study(tmp_path / "s.toml", text=text.replace(old, new))
    assert any(says in warning for warning in study.warnings), study.warnings
    assert load_study(tmp_path / "s.toml", text=text).warnings == ()


def test_draws_are_a_strength(load: Load, tmp_path: Path) -> None:
    (tmp_path / "draws.csv").write_text(
        "distribution,scale_J/kg,shape,bound,tests,diameter_mm\nlognormal,100,0.5,0,30,20\n"
        "lognormal,120,0.6,0.2,30,20\nweibull,110,2,0,30,20\n"
    )
    limit = load(
        'strength = { draws = "draws.csv" }',
        quantity='criterion = "specific_energy"\nenergy_is = "sphere"',
    ).limits[0]
    law = limit.strength
    assert isinstance(law, Law)
    assert len(law.draws) == 3
    assert limit.tested is not None
    assert limit.tested.diameter == pytest.approx(20e-3)
    x = np.array([60.0, 100.0, 200.0])
    bounded = stats.norm.cdf((np.log(x / 120) - np.log1p(-0.2 * x / 120)) / 0.6)
    mean = (
        stats.lognorm(0.5, scale=100).cdf(x) + bounded + stats.weibull_min(2, scale=110).cdf(x)
    ) / 3.0
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


def test_check_shows_the_tests_and_their_law(load: Load, tmp_path: Path) -> None:
    (tmp_path / "draws.csv").write_text(
        "distribution,scale [MPa],shape,tests\nlognormal,40,0.1,36\n"
    )
    for strength, says in (
        (
            FORCES,
            [
                "25  ",
                "1.36 to 3.82 kN on 11.1 to 12.5 mm",
                "weibull, modulus 7.0",
                " to 9.0",
                "MPa",
            ],
        ),
        ('strength = { draws = "draws.csv" }', ["36  ", "draws", "33.9 to 47.2 MPa"]),
    ):
        study = load(
            strength, "\n".join(["D,F", *ALL_PELLETS.split()]), 'criterion = "core_tension"', PELLET
        )
        line = next(line for line in described(study).splitlines() if line.startswith("a "))
        assert [part for part in says if part not in line] == [], line

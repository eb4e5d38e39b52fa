"""Criteria of fracture: units, monotone demands, ranges, size and rate, and the exceedance of a
weakest link.
"""

from __future__ import annotations

import math
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
from scenes import example

from tests.campaigns.stress_tables import hoop_field
from uqsphere.mechanics import contact, criteria, stress
from uqsphere.mechanics.criteria import CRITERIA, PARAMETERS, demand, ranges_of
from uqsphere.mechanics.fracture import path_of
from uqsphere.mechanics.integrator.solve import solve
from uqsphere.quantities import OUTPUTS
from uqsphere.units import UNITS

#: length, mass and time exponents of a dimension
EXPONENTS = {
    "pressure": (-1, 1, -2),
    "force": (1, 1, -2),
    "length": (1, 0, 0),
    "specific_energy": (2, 0, -2),
    "toughness": (-0.5, 1, -2),
    "volume": (3, 0, 0),
    "area": (2, 0, 0),
    "strain_rate": (0, 0, -1),
    "loading_rate": (1, 1, -3),
    "number": (0, 0, 0),
}
DIMENSIONS = {
    "p_max": "pressure",
    "P_max": "force",
    "a_max": "length",
    "specific_energy": "specific_energy",
    "specific_energy_sphere": "specific_energy",
    "specific_impact_energy": "specific_energy",
    "loading_rate": "loading_rate",
    "sphere.radius": "length",
    "sphere.nu": "number",
    "sphere.E": "pressure",
}
GIVEN = {
    "modulus": 8.0,
    "reference_volume": 1e-6,
    "reference_area": 1e-4,
    "largest_energy": 500.0,
    "rate_0": 200.0,
}


def rows(force: Any = 20e3, *, radius: float = 0.01, nu: float = 0.22) -> dict[str, Any]:
    """Columns of a Hertz contact on rigid flats under a force [N]."""
    force, E, density = np.atleast_1d(np.asarray(force, dtype=float)), 52e9, 2650.0
    modulus = E / (1.0 - nu**2)
    beta = float(contact.hertz_constant(modulus, radius))
    approach = contact.approach_at_force(force, beta)
    energy = 2.0 * contact.contact_energy(approach, beta) / contact.sphere_mass(radius, density)
    return {
        "p_max": contact.pressure_at_force(force, modulus, radius),
        "P_max": force,
        "a_max": contact.contact_radius(approach, radius),
        **dict.fromkeys(
            ("specific_energy", "specific_energy_sphere", "specific_impact_energy"), energy
        ),
        "loading_rate": force / 60e-6,
        "sphere.radius": np.full(len(force), radius),
        "sphere.nu": np.full(len(force), nu),
        "sphere.E": np.full(len(force), E),
    }


def given(name: str) -> dict[str, float]:
    """Every parameter that a criterion takes."""
    entry = CRITERIA[name]
    return {key: GIVEN[key] for key in (*entry.parameters, *entry.optional)}


@pytest.mark.parametrize("name", CRITERIA)
def test_a_change_of_units_changes_the_demand_as_its_unit_says(name: str) -> None:
    def scaled(dimension: str) -> float:
        length, mass, time = EXPONENTS[dimension]
        return float(3.0**length * 7.0**mass * 0.4**time)

    columns, parameters = rows(), given(name)
    other = {key: value * scaled(DIMENSIONS[key]) for key, value in columns.items()}
    changed = {key: value * scaled(PARAMETERS[key].dimension) for key, value in parameters.items()}
    expected = demand(CRITERIA[name], columns, parameters) * scaled(CRITERIA[name].dimension)
    assert demand(CRITERIA[name], other, changed) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("name", CRITERIA)
def test_a_demand_grows_with_the_force(name: str) -> None:
    columns = rows(np.geomspace(5.0, 2e5, 300))
    entry = CRITERIA[name]
    found = demand(entry, columns, {key: GIVEN[key] for key in entry.parameters})
    assert found.shape == (300,)
    assert np.all(np.isfinite(found))
    assert np.all(found > 0.0)
    assert np.all(np.diff(found) > 0.0)


@pytest.mark.parametrize("name", CRITERIA)
def test_every_criterion_says_what_it_is(name: str) -> None:
    entry = CRITERIA[name]
    assert entry.name == name
    assert entry.dimension in UNITS
    assert all((entry.meaning, entry.formula, entry.source, entry.range_text, entry.strength))
    assert set(entry.needs) <= {*DIMENSIONS, "mean_force"}
    assert {*entry.parameters, *entry.optional} <= PARAMETERS.keys()
    if entry.quantity is not None:
        assert OUTPUTS[entry.quantity].dimension == entry.dimension
        assert not entry.parameters


def test_core_tension_lies_between_centre_and_practice() -> None:
    columns = rows(np.array([2e3, 20e3, 60e3]))
    core, centre = (demand(CRITERIA[name], columns) for name in ("core_tension", "centre_tension"))
    assert np.all(core > centre)
    # at the largest contact of the table both are nearly one
    wide = rows(
        float(
            contact.hertz_force(0.3**2 * 0.01, contact.hertz_constant(52e9 / (1 - 0.22**2), 0.01))
        )
    )
    assert demand(CRITERIA["core_tension"], wide) == pytest.approx(
        demand(CRITERIA["hiramatsu_oka"], wide) * 0.86, rel=0.05
    )


def test_the_weakest_of_many_links_breaks_with_the_weibull_probability() -> None:
    """P_f = 1 - exp(-(sigma_eq/sigma_0)^m) is the chance that the weakest of many links breaks: by
    drawing them.
    """
    modulus, reference = 6.0, 1e-6
    columns = rows(30e3)
    parameters = {"modulus": modulus, "reference_volume": reference}
    equivalent = demand(CRITERIA["weakest_link_volume"], columns, parameters)[0]
    sigma_0 = 0.9 * float(equivalent)
    field = hoop_field(float(columns["a_max"][0] / 0.01), nodes=6, growth=2.5)
    hoop = np.maximum(field.hoop(0.22) * columns["p_max"][0], 0.0).ravel()
    volume = field.weight.ravel() * 4.0 / 3.0 * math.pi * 0.01**3
    rng = np.random.default_rng(7)
    draws = 4000
    # strength of a link of volume v: sigma_0 (v/V_0)^(-1/m) times a unit Weibull variable
    broken = 0
    for _ in range(draws):
        strength = sigma_0 * (reference / volume * rng.exponential(size=len(volume))) ** (
            1.0 / modulus
        )
        broken += bool(np.any(hoop > strength))
    expected = 1.0 - math.exp(-((equivalent / sigma_0) ** modulus))
    assert 0.05 < expected < 0.95
    assert broken / draws == pytest.approx(
        expected, abs=4.0 * math.sqrt(expected * (1.0 - expected) / draws)
    )


def test_size_effect() -> None:
    """Spheres of one shape of load, twice the size: the demand grows by 8^(1/m), as strength would
    fall.
    """
    small, large = rows(10e3), rows(40e3, radius=0.02)
    assert small["p_max"] == pytest.approx(large["p_max"], rel=1e-12)
    parameters = {"modulus": 9.0, "reference_volume": 1e-6}
    ratio = demand(CRITERIA["weakest_link_volume"], large, parameters) / demand(
        CRITERIA["weakest_link_volume"], small, parameters
    )
    assert ratio == pytest.approx(8.0 ** (1.0 / 9.0), rel=1e-12)
    area = {"modulus": 9.0, "reference_area": 1e-4}
    for name in ("weakest_link_surface", "weakest_link_rim"):
        ratio = demand(CRITERIA[name], large, area) / demand(CRITERIA[name], small, area)
        assert ratio == pytest.approx(4.0 ** (1.0 / 9.0), rel=1e-12)


def test_rate_raises_the_strength_of_its_own_sample() -> None:
    columns = rows(np.array([1e3, 50e3]))
    entry = CRITERIA["core_tension"]
    slow, fast = demand(entry, columns), demand(entry, columns, {"rate_0": 200.0})
    rate = criteria.strain_rate(columns)
    assert slow / fast == pytest.approx(1.0 + (rate / 200.0) ** (2.0 / 3.0), rel=1e-12)
    assert rate == pytest.approx(slow / 52e9 / 60e-6, rel=1e-12)


def test_a_truncated_energy_is_lognormal_after_the_change() -> None:
    """Probability at E of the bounded law is that of a lognormal at E_max E/(E_max - E); all break
    at E_max.
    """
    columns = {"specific_energy": np.array([1.0, 100.0, 499.999, 500.0, 9e9])}
    found = demand(CRITERIA["specific_energy"], columns, {"largest_energy": 500.0})
    assert found[:2] == pytest.approx([500.0 / 499.0, 125.0], rel=1e-12)
    assert np.all(np.diff(found[:4]) > 0.0)
    assert np.all(np.isfinite(found))
    assert found[3] == found[4] > 1e10
    assert demand(CRITERIA["specific_energy"], columns)[1] == 100.0


def test_ring_cracks_follow_auerbach() -> None:
    # P_C = A K_Ic² r/E
    force = 8600.0 * 0.7e6**2 * np.array([0.005, 0.01]) / 70e9
    columns = {"P_max": force, "sphere.radius": np.array([0.005, 0.01]), "sphere.E": 70e9}
    toughness = demand(CRITERIA["ring_crack"], columns)
    assert toughness == pytest.approx([0.7e6] * 2, rel=1e-12)


def inside(criterion, columns, parameters=MappingProxyType({})):
    """Rows inside all ranges of a criterion."""
    ranges = ranges_of(criterion, columns, parameters)
    return np.all(
        [
            np.broadcast_to((low <= values) & (values <= high), columns["a_max"].shape)
            for _, values, low, high in ranges
        ],
        axis=0,
    )


def test_ranges_are_checked_row_by_row() -> None:
    columns = {**rows(np.array([1.0, 20e3, 20e3])), "sphere.nu": np.array([0.2, 0.2, 0.45])}
    columns["a_max"] = np.array([1e-5, 1e-3, 1e-3])
    assert inside(CRITERIA["core_tension"], columns).tolist() == [False, True, True]
    parameters = {"modulus": 8.0, "reference_volume": 1e-6}
    assert inside(CRITERIA["weakest_link_volume"], columns, parameters).tolist() == [
        False,
        True,
        False,
    ]
    parameters["modulus"] = 80.0
    assert not inside(CRITERIA["weakest_link_volume"], columns, parameters).any()


def test_every_criterion_has_a_formula_and_the_range_of_its_table() -> None:
    assert criteria.FORMULAS.keys() == CRITERIA.keys()
    for entry in CRITERIA.values():
        if "Legendre" in entry.source:
            weakest_link = "modulus" in entry.parameters
            nu = stress.POISSON_WEIBULL if weakest_link else stress.POISSON
            assert tuple(entry.ranges["a/r"]) == stress.CONTACT_RATIO
            assert tuple(entry.ranges["sphere.nu"]) == nu
            assert not weakest_link or tuple(entry.ranges["modulus"]) == stress.MODULUS


def test_the_tension_of_a_grain_is_that_of_practice_over_its_factor() -> None:
    columns = rows()
    found = demand(CRITERIA["grain_tension"], columns)
    assert found == pytest.approx(demand(CRITERIA["hiramatsu_oka"], columns) / 0.9, rel=1e-12)
    assert OUTPUTS["grain_tension"].place == "core"
    assert path_of("grain_tension") is not None


def test_the_model_answers_them_for_every_fidelity() -> None:
    scene = example(rows=2, striker_speed=[0.5, 2.0])
    own = {
        c.quantity: key
        for key, c in CRITERIA.items()
        if c.follows == "force" and c.quantity not in (None, "p_max")
    }
    names = ("p_max", "P_max", "a_max", *own)
    for fidelity in ("massless", "linear", "full"):
        found = solve(scene, fidelity=fidelity, tolerance=1e-6, quantities=names).values
        columns = {name: found[name] for name in ("p_max", "P_max", "a_max")}
        columns |= {
            name: scene.columns[name] for name in ("sphere.radius", "sphere.nu", "sphere.E")
        }
        for name, criterion in own.items():
            assert found[name] == pytest.approx(demand(CRITERIA[criterion], columns), rel=1e-12)

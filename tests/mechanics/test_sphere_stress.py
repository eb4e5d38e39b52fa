"""The stress inside the sphere: field equations, boundary values, limits, and values with a
source.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from tests.campaigns.stress_series import (
    Load,
    load_coefficients,
    pressure_on_surface,
    series_stress,
    surface_stress,
)
from tests.campaigns.stress_tables import (
    SHAPES,
    axis_series,
    exact,
    hoop_field,
    largest_hoop,
    load_on_axis,
    rim_tension,
    surface_integrals,
    volume_integrals,
)
from tests.independent import elements
from tests.independent.elements import compare
from uqsphere.mechanics import stress
from uqsphere.mechanics.contact import centre_tension

Array = npt.NDArray[np.float64]

UNEVEN = Load(contact_ratio=(0.2, 0.15), pressure=(1.0, 0.7))
NODES = 14


def differentiation(low: float, high: float) -> tuple[Array, Array]:
    """Chebyshev points on [low, high] and the matrix that differentiates a polynomial through
    them.
    """
    x = np.cos(np.pi * np.arange(NODES) / (NODES - 1))
    ends = np.where((np.arange(NODES) == 0) | (np.arange(NODES) == NODES - 1), 2.0, 1.0) * (
        -1.0
    ) ** np.arange(NODES)
    gaps = x[:, None] - x[None, :] + np.eye(NODES)
    matrix = ends[:, None] / ends[None, :] / gaps
    matrix -= np.diag(matrix.sum(axis=1))
    return 0.5 * (low + high) + 0.5 * (high - low) * x, 2.0 / (high - low) * matrix


def patches() -> list[tuple[float, float]]:
    """Places inside: near a contact, in the core, near the equator, near the other contact."""
    return [(0.70, 0.25), (0.55, 0.35), (0.30, 1.1), (0.85, 1.5), (0.75, 2.9)]


def resultant(load: Load) -> float:
    """Force of the load along the axis, over p_0 r²: each cap presses with (2/3) pi a² p_0."""
    forces = [
        2.0 / 3.0 * math.pi * a**2 * p
        for a, p in zip(load.contact_ratio, load.pressure, strict=True)
    ]
    return forces[0] - forces[1]


@pytest.mark.parametrize("place", patches())
@pytest.mark.parametrize("load", [Load.balanced(0.1), UNEVEN], ids=["equal", "unequal"])
def test_forces_on_a_volume_balance_to_1e_10(load: Load, place: tuple[float, float]) -> None:
    r, by_r = differentiation(place[0] - 0.03, place[0] + 0.03)
    t, by_t = differentiation(place[1] - 0.05, place[1] + 0.05)
    s = series_stress(r[:, None], t[None, :], load, 0.27, tolerance=1e-15)
    cot = 1.0 / np.tan(t)
    # of unequal forces the rest is mass times acceleration, evenly over the volume
    body = 0.0 if load.is_balanced else 3.0 / (4.0 * math.pi) * resultant(load)
    along_r = (
        by_r @ s.radial
        + (s.shear @ by_t.T + 2.0 * s.radial - s.polar - s.azimuthal + s.shear * cot) / r[:, None]
        + body * np.cos(t)
    )
    along_t = (
        by_r @ s.shear
        + (s.polar @ by_t.T + (s.polar - s.azimuthal) * cot + 3.0 * s.shear) / r[:, None]
        - body * np.sin(t)
    )
    assert max(np.abs(along_r).max(), np.abs(along_t).max()) < 1e-10


@pytest.mark.parametrize("place", patches())
@pytest.mark.parametrize("load", [Load.balanced(0.1), UNEVEN], ids=["equal", "unequal"])
def test_strains_belong_to_displacements(load: Load, place: tuple[float, float]) -> None:
    nu = 0.27
    r, by_r = differentiation(place[0] - 0.04, place[0] + 0.04)
    t, by_t = differentiation(place[1] - 0.06, place[1] + 0.06)
    s = series_stress(r[:, None], t[None, :], load, nu, tolerance=1e-15)
    cot, r = 1.0 / np.tan(t), r[:, None]
    along, across, around = (
        s.radial - nu * (s.polar + s.azimuthal),
        s.polar - nu * (s.radial + s.azimuthal),
        s.azimuthal - nu * (s.radial + s.polar),
    )
    shear = 2.0 * (1.0 + nu) * s.shear
    first = (
        cot * (around @ by_t.T)
        - cot**2 * (across - around)
        + by_r @ (r * around)
        - along
        - shear * cot
    )
    second = (
        r * (by_r @ (by_r @ (r * across)))
        + along @ by_t.T @ by_t.T
        - r * (by_r @ along)
        - by_r @ (r * shear) @ by_t.T
    )
    assert np.abs(first).max() < 1e-9
    assert np.abs(second).max() < 2e-7


def test_the_load_is_met_and_the_rest_of_the_surface_is_free() -> None:
    angle = np.array([0.03, 0.09, 0.4, 1.2, 2.0, 2.7, 3.08])
    found = series_stress(1.0, angle, UNEVEN, 0.27)
    wanted = pressure_on_surface(angle, UNEVEN)
    assert wanted[1] == pytest.approx(math.sqrt(1.0 - (math.sin(0.09) / 0.2) ** 2), rel=1e-14)
    assert found.shear == pytest.approx(0.0, abs=1e-9)
    assert found.radial == pytest.approx(-wanted, abs=2e-4)
    assert np.all(np.abs(found.radial + wanted) < found.truncation)


def test_the_surface_is_the_end_of_the_inside() -> None:
    angle = np.array([0.02, 0.1, 0.35, 1.0, 2.0, 2.6, 3.05])
    on_it = surface_stress(angle, UNEVEN, 0.3)
    depth = np.array([0.004, 0.006, 0.008, 0.010, 0.012])
    # the polynomial through five depths, at depth 0
    weight = [np.prod([e / (e - d) for e in depth if e != d]) for d in depth]
    inside = series_stress(1.0 - depth[:, None], angle, UNEVEN, 0.3)
    assert on_it.polar == pytest.approx(weight @ inside.polar, abs=3e-5)
    assert on_it.azimuthal == pytest.approx(weight @ inside.azimuthal, abs=3e-5)


def test_terms_left_out_are_bounded() -> None:
    point = (np.array([0.9, 0.97]), np.array([0.05, 0.3]))
    exact, rough = (
        series_stress(*point, Load.balanced(0.1), 0.25, tolerance=tolerance)
        for tolerance in (1e-15, 1e-5)
    )
    error = np.max(
        [
            np.abs(getattr(exact, k) - getattr(rough, k))
            for k in ("radial", "polar", "azimuthal", "shear")
        ],
        0,
    )
    assert np.all(error <= rough.truncation)
    assert 0.0 < rough.truncation.max() < 1e-2


@pytest.mark.parametrize("nu", [0.0, 0.1, 0.25, 0.5])
def test_point_loads_at_the_centre(nu: float) -> None:
    ratio = 5e-4
    force = 2.0 / 3.0 * math.pi * ratio**2
    found = series_stress(0.0, 0.0, Load.balanced(ratio), nu)
    assert float(found.polar) == pytest.approx(float(centre_tension(force, 1.0, nu)), rel=1e-6)


@pytest.mark.parametrize(("ratio", "value"), [(0.3, 0.0353), (0.1, 0.0099), (0.01, 0.0086)])
def test_core_tension_has_the_values_of_an_independent_code(ratio: float, value: float) -> None:
    assert largest_hoop(load_on_axis(ratio), ratio, 0.25)[0] == pytest.approx(value, abs=5e-5)


@pytest.mark.parametrize("nu", [0.0, 0.25, 0.4])
def test_small_contacts_tend_to_the_half_space(nu: float) -> None:
    """Hertz on the axis, Johnson (3.45): both stresses, extrapolated from two contacts to a/r =
    0.
    """
    depth = np.array([1.0, 1.5, 1.97, 3.0])
    ratios = (0.002, 0.001, 0.0005)
    values = []
    for ratio in ratios:
        u = (1.0 - depth * ratio) ** 2
        load = load_on_axis(ratio)
        values.append(
            [
                [float(np.sum(part * x ** np.arange(len(part)))) for x in u]
                for part in axis_series(load, nu)
            ]
        )
    coarse, middle, fine = (np.array(value) for value in values)
    limit = (8.0 * fine - 6.0 * middle + coarse) / 3.0
    hoop = -(1.0 + nu) * (1.0 - depth * np.arctan(1.0 / depth)) + 0.5 / (1.0 + depth**2)
    assert limit[0] == pytest.approx(hoop, abs=1e-6)
    assert limit[1] == pytest.approx(-1.0 / (1.0 + depth**2), abs=1e-6)


def test_the_rim_tends_to_the_edge_tension() -> None:
    """(1 - 2 nu)/3 p_0 (a/rho)² just outside the contact, theory (17)."""
    ratio = 0.005
    beside = surface_stress(
        np.arcsin(np.array([1.05, 2.0]) * ratio), Load.balanced(ratio), 0.25, terms=60_000
    )
    assert beside.polar * [1.05**2, 4.0] == pytest.approx(0.5 / 3.0, rel=0.04)
    assert beside.azimuthal == pytest.approx(-beside.polar, rel=0.1)


def test_equal_faces_are_two_unequal_halves() -> None:
    here, there = (
        Load(contact_ratio=(0.1, 0.1), pressure=pressure) for pressure in ((1.0, 0.0), (0.0, 1.0))
    )
    point = (np.array([0.2, 0.7]), np.array([0.4, 2.0]))
    parts = [series_stress(*point, load, 0.2) for load in (here, there, Load.balanced(0.1))]
    for name in ("radial", "polar", "azimuthal", "shear"):
        assert getattr(parts[0], name) + getattr(parts[1], name) == pytest.approx(
            getattr(parts[2], name), abs=1e-13
        )
    assert load_coefficients(Load.balanced(0.1), 9)[1::2] == pytest.approx(np.zeros(5), abs=0.0)


def test_principal_stresses() -> None:
    s = series_stress(
        np.array([0.0, 0.9, 0.5]), np.array([0.0, 0.2, 1.0]), Load.balanced(0.1), 0.25
    )
    upper, lower, around = s.principal
    assert upper + lower == pytest.approx(s.radial + s.polar, rel=1e-13)
    assert upper * lower == pytest.approx(s.radial * s.polar - s.shear**2, abs=1e-15)
    assert np.all(s.tension >= np.maximum(upper, around) - 1e-16)


@pytest.mark.parametrize("ratio", [0.3, 0.08])
def test_the_grid_of_the_weakest_link_holds_the_series(ratio: float) -> None:
    field = hoop_field(ratio)
    hoop = field.hoop(0.2)
    i, j = (np.linspace(5, n - 5, 6).astype(int) for n in hoop.shape)
    exact = series_stress(
        field.radius[i][:, None], field.angle[j], Load.balanced(ratio), 0.2
    ).azimuthal
    deep = field.radius[i] < 1.0 - 0.5 * ratio
    assert hoop[np.ix_(i, j)][deep] == pytest.approx(exact[deep], abs=1e-11)
    assert float(field.weight.sum()) == pytest.approx(1.0, rel=1e-13)
    far = field.angle > 2.0 * ratio
    exact_surface = surface_stress(field.angle, Load.balanced(ratio), 0.2).azimuthal
    assert field.surface_hoop(0.2)[far] == pytest.approx(exact_surface[far], abs=1e-7)


def test_weakest_link_against_a_plain_sum() -> None:
    """Brute force: points evenly spread over half a meridian, without any grading."""
    ratio, nu, moduli = 0.25, 0.2, (3.0, 10.0)
    r, t = (np.arange(100) + 0.5) / 100.0, (np.arange(80) + 0.5) / 80.0 * 0.5 * math.pi
    hoop = np.maximum(
        series_stress(r[:, None], t, Load.balanced(ratio), nu, tolerance=1e-6).azimuthal, 0.0
    )
    weight = 3.0 * (r**2 / 100.0)[:, None] * (np.sin(t) * 0.5 * math.pi / 80.0)
    plain = [float(np.sum(weight * hoop**m)) ** (1.0 / m) for m in moduli]
    field = hoop_field(ratio)
    assert volume_integrals(field, nu, moduli) == pytest.approx(plain, rel=5e-4)
    on_it = np.maximum(surface_stress(t, Load.balanced(ratio), nu).azimuthal, 0.0)
    area = np.sin(t) * 0.5 * math.pi / 80.0
    plain = [float(np.sum(area * on_it**m)) ** (1.0 / m) for m in moduli]
    assert surface_integrals(field, nu, moduli) == pytest.approx(plain, rel=5e-4)


# --- the tables against the series they were made from, at random points, and the way they are read


#: the error that the tables state
STATED = 1e-6


def random_points(count: int, most_nu: float = 0.5) -> list[tuple[float, float]]:
    """Places in the table, with its corners."""
    rng = np.random.default_rng(20261121)
    low, high = (math.log(bound) for bound in stress.CONTACT_RATIO)
    inside = np.exp(rng.uniform(low, high, count)), rng.uniform(0.0, most_nu, count)
    corners = [(a, nu) for a in stress.CONTACT_RATIO for nu in (0.0, most_nu)]
    return [*corners, *((float(a), float(nu)) for a, nu in zip(*inside, strict=True))]


@pytest.mark.parametrize("name", [name for name, shape in SHAPES.items() if len(shape) == 2])
def test_tables_of_the_axis_and_the_equator(name: str) -> None:
    points = random_points(10)
    found = stress.ratio(name, *np.array(points).T)
    wanted = np.array([exact(name, *point) for point in points])
    assert np.abs(found / wanted - 1.0).max() < STATED


@pytest.mark.parametrize("name", ["volume", "surface", "volume_one", "surface_one"])
def test_tables_of_the_weakest_link(name: str) -> None:
    integrals = volume_integrals if name.startswith("volume") else surface_integrals
    one = name.endswith("one")
    moduli = np.array(
        [2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 50.0] if one else [2.0, 2.7, 5.0, 8.3, 15.0, 31.0, 50.0]
    )
    # of one force alone the ends of m are rougher
    most = 2.0 * STATED * np.array([10.0, *[1.0] * 5, 50.0] if one else [1.0] * 7)
    for ratio, nu in (
        random_points(4, 0.4)[4:] if one else [(0.3, 0.0), (0.3, 0.4), *random_points(8, 0.4)[4:]]
    ):
        wanted = integrals(hoop_field(ratio, nodes=20, growth=1.4, one_sided=one), nu, moduli)
        found = np.array([float(stress.ratio(name, ratio, nu, m)) for m in moduli])
        assert (np.abs(found / wanted - 1.0) < most).all(), (ratio, nu)


def test_fields_of_one_force_are_those_of_the_theory() -> None:
    """Rounded values of an independent calculation: R_1 on the axis (R20), H^(1/m) of the volume
    (R21).
    """
    for nu, wanted in {
        0.2: (1.0012, 1.0052, 1.0010, 0.9675, 0.9092, 0.7629),
        0.25: (1.0018, 1.0074, 0.9992, 0.9557, 0.8898, 0.7399),
        0.3: (1.0030, 1.0106, 0.9944, 0.9393, 0.8671, 0.7163),
    }.items():
        ratio = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3])
        found = stress.ratio("core_one", ratio, nu) / stress.core_ratio(ratio, nu)
        assert found == pytest.approx(wanted, abs=6e-5)
    moduli = np.array([3.0, 5.0, 8.0, 12.0, 20.0])
    for ratio, wanted in {
        0.1: (0.616, 0.745, 0.879, 0.932, 0.961),
        0.2: (0.577, 0.630, 0.693, 0.753, 0.813),
    }.items():
        one, two = (
            np.array([float(stress.ratio(name, ratio, 0.25, m)) for m in moduli])
            for name in ("volume_one", "volume")
        )
        assert one / two == pytest.approx(wanted, abs=6e-4)


def test_the_core_is_continuous_where_its_place_reaches_the_centre() -> None:
    ratio = np.linspace(0.22, 0.3, 401)
    tension = stress.core_ratio(ratio, 0.45)
    reached = ratio * stress.ratio("core_depth", ratio, 0.45) >= 1.0
    assert reached.any()
    assert not reached.all()
    slope = np.diff(tension) / np.diff(ratio)
    assert np.abs(np.diff(slope)).max() < 0.02 * np.abs(slope).max()
    # never below the centre, which lies on the axis
    assert np.all(tension >= stress.centre_ratio(ratio, np.full(401, 0.45)) * (1.0 - 1e-6))


def test_outside_the_nearest_ratio_is_taken() -> None:
    for name in ("core", "shear"):
        assert stress.ratio(name, [1e-4, 0.9], [0.2, 0.2]) == pytest.approx(
            stress.ratio(name, [0.005, 0.3], 0.2)
        )
    assert np.isnan(stress.ratio("core", [np.nan], [0.2])).all()


def test_the_rim_against_the_series_step_by_step() -> None:
    """A contact that grows in steps of 5 % up to a/r = 0.3: the largest tension at each place,
    summed by trapezoids.
    """
    grown, poisson = 0.3 * np.exp(-0.05 * np.arange(36)), [0.1, 0.25]
    sine = np.concatenate([grown[::-1], np.geomspace(0.3, 1.0, 150)[1:]])
    seen = np.zeros((len(sine), 2))
    for ratio in grown:
        outside = sine >= ratio * (1.0 - 1e-12)
        z = np.sqrt(np.maximum(np.log(sine[outside] / ratio), 0.0) / math.log(1.0 / ratio))
        seen[outside] = np.maximum(
            seen[outside], ratio / 0.3 * rim_tension(float(ratio), z, poisson)
        )
    for m in (5.0, 9.0):
        totals = np.trapezoid(seen**m * sine[:, None], np.arcsin(np.minimum(sine, 1.0)), axis=0)
        found = stress.half_space_rim(0.3, poisson, m) * stress.ratio("rim", 0.3, poisson, m)
        assert found == pytest.approx(totals ** (1.0 / m), rel=2e-3)


def test_the_rim_of_a_small_contact_is_that_of_the_half_space() -> None:
    ratios = np.array([0.005, 0.05, 0.3])
    share = stress.ratio("rim", ratios, 0.2, 9.0)
    assert 0.98 < share[0] < 1.0
    assert np.all(np.diff(share) < 0.0)
    # in the half space: what lies outside, and what the contact has grown over
    s = np.geomspace(1e-4, 1.0, 200_001)
    seen = 0.2 * np.where(s < 0.005, s / 0.005, (0.005 / s) ** 2)
    total = float(np.trapezoid(seen**9.0 * s, s)) ** (1.0 / 9.0)
    assert float(stress.half_space_rim(0.005, 0.2, 9.0)) == pytest.approx(total, rel=1e-5)


# --- the series of the stress against finite elements that know nothing of it ---------------------


@pytest.fixture(scope="module")
def fine() -> elements.Comparison:
    return compare(count=24, finest=0.04)


def test_series_and_elements_meet_as_the_mesh_is_refined(fine: elements.Comparison) -> None:
    coarse = compare(count=12, finest=0.08)
    # every stress is compared, that of the core and that of the rim's surroundings, and the two
    # come together
    assert len(fine.place) > 3 * len(coarse.place)
    assert fine.median < 4e-4
    assert fine.worst < 0.03
    assert fine.median < 0.3 * coarse.median
    assert fine.worst < 0.6 * coarse.worst


def test_the_largest_tension_inside_is_that_of_the_table(fine: elements.Comparison) -> None:
    inside = np.hypot(*fine.place.T) < 0.9
    assert fine.elements[inside].max() == pytest.approx(fine.core, rel=2e-3)

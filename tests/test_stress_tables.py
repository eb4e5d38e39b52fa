"""The tables against the series they were made from, at random points, and the way they are read."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from uqsphere.mechanics.stress import tables
from uqsphere.mechanics.stress.make_tables import (
    SHAPES,
    axis_series,
    exact,
    hoop_field,
    load_on_axis,
    pack,
    rim_tension,
    surface_integrals,
    volume_integrals,
)

#: the error that the tables state
STATED = 1e-6


def random_points(count: int, most_nu: float = 0.5) -> list[tuple[float, float]]:
    """Places in the table, with its corners."""
    rng = np.random.default_rng(20261121)
    low, high = (math.log(bound) for bound in tables.CONTACT_RATIO)
    inside = np.exp(rng.uniform(low, high, count)), rng.uniform(0.0, most_nu, count)
    corners = [(a, nu) for a in tables.CONTACT_RATIO for nu in (0.0, most_nu)]
    return [*corners, *((float(a), float(nu)) for a, nu in zip(*inside, strict=True))]


@pytest.mark.parametrize("name", [name for name, shape in SHAPES.items() if len(shape) == 2])
def test_tables_of_the_axis_and_the_equator(name: str) -> None:
    points = random_points(25)
    found = tables.ratio(name, *np.array(points).T)
    wanted = np.array([exact(name, *point) for point in points])
    assert np.abs(found / wanted - 1.0).max() < STATED


@pytest.mark.parametrize(("name", "integrals"), [("volume", volume_integrals), ("surface", surface_integrals)])
def test_tables_of_the_weakest_link(name: str, integrals: object) -> None:
    moduli = np.array([2.0, 2.7, 5.0, 8.3, 15.0, 31.0, 50.0])
    for ratio, nu in [(0.3, 0.0), (0.3, 0.4), *random_points(8, 0.4)[4:]]:
        field = hoop_field(ratio, nodes=20, growth=1.4)
        wanted = integrals(field, nu, moduli)  # type: ignore[operator]
        found = tables.ratio(name, np.full(7, ratio), nu, moduli)
        assert np.abs(found / wanted - 1.0).max() < 2.0 * STATED, (ratio, nu)


@pytest.mark.parametrize(("name", "integrals"), [("volume", volume_integrals), ("surface", surface_integrals)])
def test_tables_of_one_force_alone(name: str, integrals: object) -> None:
    moduli = np.array([2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 50.0])
    for ratio, nu in random_points(4, 0.4)[4:]:
        wanted = integrals(hoop_field(ratio, nodes=18, growth=1.45, one_sided=True), nu, moduli)  # type: ignore[operator]
        found = tables.ratio(f"{name}_one", np.full(7, ratio), nu, moduli)
        error = np.abs(found / wanted - 1.0)
        assert error[0] < 2e-5
        assert error[1:6].max() < 2e-6
        assert error[6] < 1e-4


def test_fields_of_one_force_are_those_of_the_theory() -> None:
    """Rounded values of an independent calculation: R_1 on the axis (R20), H^(1/m) of the volume (R21)."""
    for nu, wanted in {
        0.2: (1.0012, 1.0052, 1.0010, 0.9675, 0.9092, 0.7629),
        0.25: (1.0018, 1.0074, 0.9992, 0.9557, 0.8898, 0.7399),
        0.3: (1.0030, 1.0106, 0.9944, 0.9393, 0.8671, 0.7163),
    }.items():
        ratio = np.array([0.02, 0.05, 0.1, 0.15, 0.2, 0.3])
        found = tables.ratio("core_one", ratio, nu) / tables.core_ratio(ratio, nu)[0]
        assert found == pytest.approx(wanted, abs=6e-5)
    moduli = np.array([3.0, 5.0, 8.0, 12.0, 20.0])
    for ratio, wanted in {0.1: (0.616, 0.745, 0.879, 0.932, 0.961), 0.2: (0.577, 0.630, 0.693, 0.753, 0.813)}.items():
        one, two = (tables.ratio(name, np.full(5, ratio), 0.25, moduli) for name in ("volume_one", "volume"))
        assert one / two == pytest.approx(wanted, abs=6e-4)


def test_one_modulus_for_all_rows_is_the_same_as_a_column() -> None:
    ratio = np.array([0.01, 0.1, 0.29])
    one, many = (tables.ratio("volume", ratio, 0.2, m) for m in (7.0, np.full(3, 7.0)))
    assert one == pytest.approx(many, rel=1e-12)


def test_the_core_is_continuous_where_its_place_reaches_the_centre() -> None:
    ratio = np.linspace(0.22, 0.3, 401)
    tension, depth = tables.core_ratio(ratio, 0.45)
    reached = depth == 1.0
    assert reached.any()
    assert not reached.all()
    slope = np.diff(tension) / np.diff(ratio)
    assert np.abs(np.diff(slope)).max() < 0.02 * np.abs(slope).max()
    # never below the centre, which lies on the axis
    assert np.all(tension >= tables.centre_ratio(ratio, np.full(401, 0.45)) * (1.0 - 1e-6))


def test_the_depth_is_where_the_series_has_its_maximum() -> None:
    tension, depth = tables.core_ratio(0.07, 0.2)
    hoop = axis_series(load_on_axis(0.07), 0.2)[0]
    at = [float(np.sum(hoop * (1.0 - d) ** (2.0 * np.arange(len(hoop))))) for d in depth * np.array([0.97, 1.0, 1.03])]
    assert at[1] == pytest.approx(float(tension), rel=STATED)
    assert at[1] > max(at[0], at[2])


def test_outside_the_nearest_ratio_is_taken_and_said() -> None:
    for name in ("core", "shear"):
        assert tables.ratio(name, [1e-4, 0.9], [0.2, 0.2]) == pytest.approx(tables.ratio(name, [0.005, 0.3], 0.2))
    assert tables.outside([1e-4, 0.1, 0.9], 0.2).tolist() == [True, False, True]
    assert tables.outside(0.1, [-0.1, 0.45]).tolist() == [True, False]
    assert tables.outside(0.1, [0.3, 0.45], 10.0).tolist() == [False, True]
    assert np.isnan(tables.ratio("core", [np.nan], [0.2])).all()


def test_tension_falls_short_of_the_largest_value() -> None:
    """An equivalent stress over the whole volume lies below the largest hoop tension and rises with m towards it."""
    moduli = np.linspace(2.0, 50.0, 40)
    for ratio in (0.01, 0.1, 0.3):
        found = tables.ratio("volume", np.full(40, ratio), 0.2, moduli)
        assert np.all(np.diff(found) > 0.0)
        assert found[-1] < float(tables.core_ratio(ratio, 0.2)[0])


def test_the_rim_against_the_series_step_by_step() -> None:
    """A contact that grows in steps of 3 % up to a/r = 0.3: the largest tension at each place, summed by trapezoids."""
    grown, poisson = 0.3 * np.exp(-0.03 * np.arange(60)), [0.1, 0.25]
    sine = np.concatenate([grown[::-1], np.geomspace(0.3, 1.0, 150)[1:]])
    seen = np.zeros((len(sine), 2))
    for ratio in grown:
        outside = sine >= ratio * (1.0 - 1e-12)
        z = np.sqrt(np.maximum(np.log(sine[outside] / ratio), 0.0) / math.log(1.0 / ratio))
        seen[outside] = np.maximum(seen[outside], ratio / 0.3 * rim_tension(float(ratio), z, poisson))
    for m in (5.0, 9.0):
        totals = np.trapezoid(seen**m * sine[:, None], np.arcsin(np.minimum(sine, 1.0)), axis=0)
        found = tables.half_space_rim(0.3, poisson, m) * tables.ratio("rim", 0.3, poisson, m)
        assert found == pytest.approx(totals ** (1.0 / m), rel=2e-3)


def test_the_rim_of_a_small_contact_is_that_of_the_half_space() -> None:
    ratios = np.array([0.005, 0.05, 0.3])
    share = tables.ratio("rim", ratios, 0.2, 9.0)
    assert 0.98 < share[0] < 1.0
    assert np.all(np.diff(share) < 0.0)
    # in the half space: what lies outside, and what the contact has grown over
    s = np.geomspace(1e-4, 1.0, 200_001)
    seen = 0.2 * np.where(s < 0.005, s / 0.005, (0.005 / s) ** 2)
    total = float(np.trapezoid(seen**9.0 * s, s)) ** (1.0 / 9.0)
    assert float(tables.half_space_rim(0.005, 0.2, 9.0)) == pytest.approx(total, rel=1e-5)


def test_packing_keeps_what_it_says() -> None:
    values = np.exp(np.random.default_rng(1).normal(size=(4, 5)))
    packed = json.loads(json.dumps(pack(values)))
    matrix = np.zeros(packed["shape"])
    for index, row in enumerate(packed["rows"]):
        matrix[index, : len(row)] = np.array(row) * packed["unit"]
    nodes = tables.chebyshev_nodes((4, 5))
    table = tables.Table(name="test", coefficients=matrix)
    assert table(nodes[0][:, None], nodes[1][None, :]) == pytest.approx(values, rel=1e-8)

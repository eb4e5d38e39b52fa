"""Surrogates beyond their runs: how far they are drawn in, and what the variance is made of then."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from uqsphere.arrays import Array
from uqsphere.given.answers import given_answers, trusted_from
from uqsphere.uq.augmented import Trusted, trust
from uqsphere.uq.augmented_indices import reaching, trusted_indices
from uqsphere.uq.augmented_sets import group_indices, pair_indices
from uqsphere.uq.beyond_runs import shares_within, within_runs
from uqsphere.uq.estimate import Estimate, absent
from uqsphere.uq.expansion import fit_chaos, germ_points, predict
from uqsphere.uq.expansion.expansion import Border
from uqsphere.uq.joint import Joint
from uqsphere.uq.law import make_law
from uqsphere.uq.points import sobol_points
from uqsphere.uq.released import believed

NORMAL = ("normal", "normal")


def normals(count: int, seed: int, dimension: int = 2) -> Array:
    return np.asarray(ndtri(sobol_points(dimension=dimension, count=count, seed=seed, task="design", replicate=0)))


def trusted_of(function: Callable[[Array], Array], points: Array, germs: tuple[str, ...] = NORMAL) -> Trusted:
    outputs, half = function(points), len(points) // 2
    before = fit_chaos(points[:half], outputs[:half], germs)
    return trust(fit_chaos(points, outputs, germs), points, outputs, before)


def bump(z: Array) -> Array:
    """x + 1/(1 + c²) of a Cauchy c: 1/9 of its variance is that of c."""
    c = np.tan(np.pi * (ndtr(z[:, 0]) - 0.5))
    return np.asarray(z[:, 1] + 1.0 / (1.0 + c * c))


def tangled(z: Array) -> Array:
    return np.asarray(z[:, 0] + 0.4 * z[:, 0] ** 2 + 0.5 * z[:, 0] * z[:, 1] + 0.3 * z[:, 2])


@pytest.mark.parametrize("germs", [("normal",) * 3, ("uniform", "normal", "uniform")])
def test_parts_off_the_coefficients_are_those_of_the_values_drawn_in(germs: tuple[str, ...]) -> None:
    """First and total shares by pick and freeze of the drawn-in surrogate itself, at 2^16 points."""
    points = germ_points(normals(48, 4, 3), germs)
    outputs = tangled(points)
    chaos = fit_chaos(points, outputs, germs, plain=True)
    one = trust(chaos, points, outputs)
    assert one.chaos.plain
    one = replace(one, error=0.01, scatter=0.0, points=0.6 * points)
    rng = np.random.default_rng(1)
    a, b = (germ_points(rng.standard_normal((65_536, 3)), germs) for _ in range(2))
    for along, shares in enumerate(shares_within(one, [[0], [1], [2], [0, 1, 2]])[1:]):
        assert shares[3] == pytest.approx([1.0, 1.0], rel=1e-12)
        for j in range(3):
            mixed = a.copy()
            mixed[:, j] = b[:, j]
            values = []
            for where in (a, b, mixed):
                inner = within_runs(one, where, predict(chaos, where), [along])
                assert inner is not None
                values.append(inner)
            f, g, h = values
            variance = float(np.var(np.concatenate([f, g])))
            first, total = float(np.mean((g - g.mean()) * (h - f))) / variance, float(np.mean((f - h) ** 2)) / variance
            assert shares[j] == pytest.approx([first, 0.5 * total], abs=0.02)


def test_shares_sampled_are_those_off_the_coefficients() -> None:
    """The same surrogate once more, as two pieces of which one is never met."""
    one = replace(trusted_of(tangled, normals(48, 4, 3), ("normal",) * 3), error=0.01, scatter=0.0)
    piece, groups = one.chaos.pieces[0], [[0], [1], [2], [0, 1]]
    split = replace(one.chaos, pieces=(piece, piece), border=Border(kind="axis", axis=0, at=99.0))
    for change in (one, replace(one, points=0.6 * one.points)):
        plain, sampled = shares_within(change, groups), shares_within(replace(change, chaos=split), groups)
        assert sampled == pytest.approx(plain, abs=0.03)
        assert sampled[1:] - sampled[0] == pytest.approx(plain[1:] - plain[0], abs=0.02)


def test_the_share_drawn_in_grows_like_polynomials_of_the_degree_do() -> None:
    one = trusted_of(bump, normals(64, 14))
    end = one.points[:, 0].max()
    steps = np.array([[end, 0.0], [1.02 * end, 0.0], [1.5 * end, 0.0]])
    values = predict(one.chaos, steps)

    def share(error: float) -> Array:
        doubted = replace(one, error=error, scatter=math.sqrt(error) * one.scatter / math.sqrt(one.error))
        inner = within_runs(doubted, steps, values)
        assert inner is not None
        return np.asarray((inner - values)[1:] / (values[0] - values[1:]))

    little, more = share(1e-12), share(1e-10)
    assert more[0] / little[0] == pytest.approx(10.0, rel=1e-6)
    assert little[1] > 50.0 * little[0]
    assert share(one.error)[1] == pytest.approx(1.0)


def _hold(found: list[Estimate], truth: float) -> list[bool]:
    return [e.low is not None and e.high is not None and e.low <= truth <= e.high for e in found]


def test_indices_of_an_output_that_levels_off_are_held() -> None:
    """64 runs: 31 % of the intervals of x + 1/(1 + c²) held without, 56 % by the ratio of the standard deviations."""
    hits = []
    for seed in (14, 71, 72, 84, 97, 101, 103, 137):
        one = trusted_of(bump, normals(64, seed))
        assert one.usable
        found, (closed, _) = trusted_indices(one, seed), group_indices(one, [[0], [1]], seed)
        hits += _hold([found["first"][0], found["total"][0], closed[0]], 1.0 / 9.0)
        hits += _hold([found["first"][1], closed[1]], 8.0 / 9.0)
        hits += _hold(pair_indices(one, [(0, 1)], seed), 0.0)
    assert np.mean(hits) >= 0.9


def test_what_levels_off_moves_no_index_that_does_not_hang_on_it() -> None:
    """Of arctan(c) x all variance is that of both together, whatever arctan(c) does beyond the runs."""

    def product(z: Array) -> Array:
        return np.asarray(np.pi * (ndtr(z[:, 0]) - 0.5) * z[:, 1])

    one = trusted_of(product, normals(32, 2))
    assert one.usable
    found = trusted_indices(one)
    assert max(e.half_width for e in (*found["first"], *found["total"], *pair_indices(one, [(0, 1)]))) < 2e-3


def test_shares_of_a_variance_that_is_not_known_are_not_given() -> None:
    one = trusted_of(bump, normals(32, 21))
    large = np.concatenate([normals(1024, seed) for seed in range(16)])
    told = believed(one, large, (16, 1024), np.random.default_rng(1), ())
    assert told.spread is None
    gone = replace(told.description, sd=absent("it does not converge", "surrogate", 32))
    found = replace(told, description=gone).indices(trusted_indices(one))
    assert {e.reason for row in found.values() for e in row} == {"the variance that it is a share of is not known"}


def test_an_index_without_interval_stays_without() -> None:
    one = trusted_of(bump, normals(64, 14))
    nothing = replace(trusted_indices(one)["first"][0], value=None, low=None, high=None, reason="none")
    assert reaching([nothing], np.array([[0.2], [0.1], [0.4]])) == [nothing]


def test_answers_of_given_tables_reach_inwards_too() -> None:
    """tanh(2 a) + b of normal inputs, 100 rows of its own: what holds for designed runs holds for these."""
    law = make_law("normal", {"mean": 0.0, "sd": 1.0})
    laws = Joint(names=("a", "b"), laws=(law, law))
    hits = []
    for seed in (1, 3, 14, 21, 25, 32, 33, 34):
        scores = np.random.default_rng(seed).standard_normal((100, 2))
        one = trusted_from(scores, np.tanh(2.0 * scores[:, 0]) + scores[:, 1], NORMAL)
        assert one.usable
        found = given_answers(one, laws, None, quantiles=(), seed=1, task="levels off")
        hits += _hold([found[order]["a"].whole for order in ("first", "total")], 0.388477)
        hits += _hold([found["statistics"]["sd"].whole], 1.0 / math.sqrt(1.0 - 0.388477))
    assert np.mean(hits) >= 0.8

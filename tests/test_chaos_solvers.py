"""Solvers of sparse regression: recovery, and errors of samples left out against fits made anew."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from uqsphere.uq.expansion.choice import deal
from uqsphere.uq.expansion.germs import grown, hyperbolic_indices, nested, orthonormal_values, products, skipping
from uqsphere.uq.expansion.solvers import SOLVERS, Task, least_angles, solve_rows

SPARSE = ("matching pursuit", "forward selection", "least angles", "subspace pursuit")


def legendre_basis(n: int, dimension: int, degree: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (n, dimension))
    indices = hyperbolic_indices(dimension, degree, 1.0, 10_000)
    assert indices is not None
    return indices, products([orthonormal_values("uniform", x, degree) for x in points.T], indices)


def task_of(basis: np.ndarray, values: np.ndarray, folds: np.ndarray, most: int | None = None, sizes=()) -> Task:
    return Task(basis=basis, values=values, folds=folds, most=most or values.size // 2, sizes=sizes,
                error=lambda predicted: float(np.mean((predicted - values) ** 2) / np.var(values)))  # fmt: skip


@pytest.mark.parametrize("name", SPARSE)
@pytest.mark.parametrize("terms", [1, 5])
def test_sparse_polynomials_are_found_among_more_candidates_than_samples(name: str, terms: int) -> None:
    indices, basis = legendre_basis(80, 5, 4)
    assert len(indices) > 80
    rng = np.random.default_rng(terms)
    wanted = np.sort(1 + rng.choice(len(indices) - 1, terms, replace=False))
    values = 3.0 + rng.choice([-1.0, 1.0], terms) * rng.uniform(1.0, 2.0, terms) @ basis[wanted]
    active, error = SOLVERS[name](task_of(basis, values, deal(80, 5))).best()
    assert set(wanted.tolist()) <= set(active.tolist())
    assert active[0] == 0
    assert error < 1e-24
    coefficients = solve_rows(basis[active], values)
    np.testing.assert_allclose(coefficients @ basis[active], values, atol=1e-12)


def test_least_squares_takes_whole_sets() -> None:
    found = nested(2, 1.0, 5, 100)
    assert found is not None
    indices, sizes = found
    points = np.random.default_rng(3).uniform(-1.0, 1.0, (60, 2))
    basis = products([orthonormal_values("uniform", x, 5) for x in points.T], indices)
    values = points[:, 0] ** 2 * points[:, 1]
    active, error = SOLVERS["least squares"](task_of(basis, values, deal(60, 5), sizes=sizes)).best()
    assert active.size == 10  # total degree 3 in two inputs
    assert error < 1e-24


def greedy_anew(basis: np.ndarray, values: np.ndarray, steps: int, orthogonal: bool) -> list[int]:
    """Matching pursuit as the textbook has it: every step solves every least-squares problem again."""
    order = [0]
    for _ in range(steps - 1):
        kept = basis[order]
        residual = values - np.linalg.lstsq(kept.T, values, rcond=None)[0] @ kept
        scores = []
        for row in range(len(basis)):
            if row in order:
                scores.append(-1.0)
            elif orthogonal:
                trial = basis[[*order, row]]
                left = values - np.linalg.lstsq(trial.T, values, rcond=None)[0] @ trial
                scores.append(float(residual @ residual - left @ left))
            else:
                scores.append(abs(float(basis[row] @ residual)) / float(np.linalg.norm(basis[row])))
        order.append(int(np.argmax(scores)))
    return order


@pytest.mark.parametrize(("name", "orthogonal"), [("matching pursuit", False), ("forward selection", True)])
@pytest.mark.parametrize("count", [4, 24])
def test_errors_of_samples_left_out_are_those_of_fits_made_anew(name: str, orthogonal: bool, count: int) -> None:
    n, steps = 24, 6  # folds of one sample: leave-one-out, terms chosen anew each time
    _, basis = legendre_basis(n, 2, 4)
    rng = np.random.default_rng(5)
    values = np.exp(basis[1] * 0.5) * np.cos(basis[2]) + 0.1 * rng.standard_normal(n)
    folds = np.arange(n) % count
    path = SOLVERS[name](task_of(basis, values, folds, most=steps))
    assert path.order.tolist() == greedy_anew(basis, values, steps, orthogonal)
    for size in range(1, steps + 1):
        predicted = np.empty(n)
        for fold in range(count):
            seen = folds != fold
            rows = greedy_anew(basis[:, seen], values[seen], size, orthogonal)
            coefficients = np.linalg.lstsq(basis[rows][:, seen].T, values[seen], rcond=None)[0]
            predicted[~seen] = coefficients @ basis[rows][:, ~seen]
        assert path.errors[size - 1] == pytest.approx(np.mean((predicted - values) ** 2) / np.var(values), rel=1e-9)


def angles_anew(basis: np.ndarray, values: np.ndarray, steps: int) -> list[int]:
    """Least-angle regression with the equiangular direction from the inverse of the Gram matrix (Efron 2004)."""
    x = basis[1:] - basis[1:].mean(axis=1, keepdims=True)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    fit, y = np.zeros(values.size), values - values.mean()
    active = [int(np.argmax(np.abs(x @ y)))]
    while len(active) < steps - 1:
        c = x @ (y - fit)
        height = np.abs(c[active]).max()
        np.testing.assert_allclose(np.abs(c[active]), height, rtol=1e-8)
        rows = np.sign(c[active])[:, None] * x[active]
        inverse = np.linalg.inv(rows @ rows.T)
        scale = inverse.sum() ** -0.5
        direction = scale * inverse.sum(axis=0) @ rows
        a = x @ direction
        steps_to = {
            row: min(s for s in ((height - c[row]) / (scale - a[row]), (height + c[row]) / (scale + a[row])) if s > 0)
            for row in range(len(x))
            if row not in active
        }
        nearest = min(steps_to, key=steps_to.__getitem__)
        fit = fit + steps_to[nearest] * direction
        active.append(nearest)
    return [0, *(row + 1 for row in active)]


def test_least_angles_take_the_textbooks_order() -> None:
    for seed in range(5):
        _, basis = legendre_basis(40, 3, 3, seed)
        values = np.exp(0.7 * basis[1] - 0.4 * basis[2]) + np.abs(basis[3])
        path = least_angles(task_of(basis, values, deal(40, 5), most=10))
        assert path.order.tolist() == angles_anew(basis, values, 10)


@pytest.mark.parametrize("name", SOLVERS)
def test_dependent_and_repeated_rows_do_no_harm(name: str) -> None:
    _, basis = legendre_basis(50, 2, 3)
    twice = np.concatenate([basis, basis[1:], basis[1:2] + basis[2:3]])
    values = basis[1] + 2.0 * basis[4]
    active, error = SOLVERS[name](task_of(twice, values, deal(50, 5), sizes=(3, 6, 10))).best()
    assert error < 1e-20
    assert np.linalg.matrix_rank(twice[active]) == active.size


@pytest.mark.parametrize("name", SOLVERS)
def test_one_term_and_few_samples(name: str) -> None:
    _, basis = legendre_basis(6, 2, 1)
    path = SOLVERS[name](task_of(basis, np.arange(6.0), deal(6, 3), most=1, sizes=(1, 3)))
    active, error = path.best()
    assert active.tolist() == [0]
    assert 1.0 <= error < 3.0


def test_folds_are_even_and_the_same_every_time() -> None:
    for n, count in ((7, 5), (64, 10), (256, 5), (3, 5)):
        folds = deal(n, count)
        assert np.array_equal(folds, deal(n, count))
        numbers = np.bincount(folds)
        assert numbers.size == min(n, count)
        assert numbers.max() - numbers.min() <= 1


def test_grown_sets_hold_what_lies_below_and_admissible_neighbours() -> None:
    active = np.array([[0, 0, 0], [2, 1, 0], [0, 0, 1]])
    found = {tuple(row) for row in grown(active, np.array([1.0, 0.5, 0.1]), 15, 1000).tolist()}
    below = set(itertools.product(range(3), range(2), [0])) | {(0, 0, 1)}
    assert below <= found
    for row in found - below:  # a neighbour: everything just below it is there
        lower = [(*row[:j], k - 1, *row[j + 1 :]) for j, k in enumerate(row) if k]
        assert all(low in below for low in lower)
    assert {(3, 0, 0), (0, 2, 0), (1, 0, 1), (0, 1, 1), (0, 0, 2)} <= found
    assert (1, 1, 1) not in found  # (1, 0, 1) and (0, 1, 1) are not there yet
    few = grown(active, np.array([1.0, 0.5, 0.1]), 15, 4)
    assert few[:3].tolist() == active.tolist()
    assert len(few) == 4
    assert grown(active, np.ones(3), 2, 1000).max() == 2


def test_terms_two_degrees_above_are_those_of_inputs_in_use() -> None:
    active = np.array([[0, 0, 0], [2, 0, 0], [4, 0, 1]])
    assert skipping(active, 15).tolist() == [[4, 0, 0], [4, 0, 3], [6, 0, 1]]
    assert skipping(active, 4).tolist() == [[4, 0, 0], [4, 0, 3]]
    assert skipping(np.zeros((1, 2), dtype=np.int64), 15).shape == (0, 2)


@pytest.mark.parametrize("name", ["matching pursuit", "forward selection", "least angles"])
def test_terms_chosen_without_a_fold_are_those_chosen_on_the_other_samples(name: str) -> None:
    _, basis = legendre_basis(60, 3, 4, seed=5)
    values = np.exp(basis[1]) + basis[5] * basis[8]
    folds = deal(60, 5)
    path = SOLVERS[name](task_of(basis, values, folds))
    active, _ = path.best()
    for fold, chosen in enumerate(path.chosen_without()):
        seen = folds != fold
        alone = SOLVERS[name](task_of(basis[:, seen], values[seen], deal(int(seen.sum()), 5), most=30))
        known = min(len(chosen), len(alone.order))
        assert chosen[:known].tolist() == alone.order[:known].tolist()
        assert len(chosen) <= len(active)
    assert len(path.chosen_without()) == 5
    assert SOLVERS["subspace pursuit"](task_of(basis, values, folds)).chosen_without() == []

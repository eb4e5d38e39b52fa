"""Columns of a table that others give exactly are named, and no expansion is fitted to them."""

from __future__ import annotations

import numpy as np
import pytest

from uqsphere.arrays import Array
from uqsphere.given import Data, analyse_data, analysis_text
from uqsphere.given.table import combinations

RNG = np.random.default_rng(5)
X = RNG.normal(size=(120, 3))
A, B, C = X.T


@pytest.mark.parametrize(
    ("last", "text"),
    [
        (A + B, "s is an exact linear combination of other columns, s = a + b:"),
        (2.0 * A - B + 5.0, "s = 5 + 2 a - b:"),
        (1e9 * (B - 0.25 * C), "s = 1e+09 b - 2.5e+08 c:"),
        (-B - A, "s = - a - b:"),
        (3.0 - 2.0 * C, "s tells the same as c: leave one of them out"),
    ],
)
def test_a_column_that_others_give_is_named(last: Array, text: str) -> None:
    (found,) = combinations(np.column_stack([X, last]))
    assert text in found.text(["a", "b", "c", "s"])


def test_figures_as_a_file_has_them_are_enough() -> None:
    table = np.array([[float(f"{value:.8g}") for value in row] for row in np.column_stack([X, A + B])])
    assert [one.column for one in combinations(table)] == [3]


@pytest.mark.parametrize("last", [A + B + 1e-4 * RNG.normal(size=120), A * B, np.ones(120), np.exp(A)])
def test_a_column_of_its_own_is_not(last: Array) -> None:
    assert combinations(np.column_stack([X, last])) == []


def test_few_rows_are_no_combination() -> None:
    assert combinations(RNG.normal(size=(6, 8))) == []


def test_the_analysis_says_so() -> None:
    x = np.column_stack([X, A + B])
    found = analyse_data(Data(x=x, y=(A + 2.0 * B + C)[:, None], inputs=("a", "b", "c", "s"), outputs=("y",)))
    assert found["combinations"][0].startswith("s is an exact linear combination of other columns, s = a + b")
    chaos = found["sensitivity"]["y"]["chaos"]
    assert not chaos["usable"]
    assert chaos["reason"] == found["combinations"][0]
    assert "s = a + b" in " ".join(analysis_text(found, 80).split())

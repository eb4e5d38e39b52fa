"""Swings, waterfalls, sides of a limit and pairs against what is known of samples made for it."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_folders import limit, put, write_folder

from uqsphere.report import build_report
from uqsphere.report.contents import Contents, Samples, read_contents
from uqsphere.report.figures.limits import sides_of
from uqsphere.report.figures.swings import swings

N = 8000


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> Contents:
    """A demand that is linear in two independent normal inputs: 3 a - b, in GPa around 3."""
    folder = write_folder(tmp_path_factory.mktemp("f"), limits={"x": limit(0.05, 0.1, True)})
    rng = np.random.default_rng(3)
    a, b = rng.normal(size=(2, N))
    values = 3e9 + 1e8 * (3.0 * a - b)
    samples = {"p_max": Samples(values=values, censored=np.zeros(N, dtype=bool))}
    return replace(read_contents(folder), samples=samples, points={"sphere.E": a, "striker.speed": b})


def test_swings_of_censored_or_few_samples_are_not_shown(contents: Contents) -> None:
    late = replace(contents.samples["p_max"], censored=np.arange(N) < 0.2 * N)
    assert swings(replace(contents, samples={"p_max": late}), "p_max") == []
    few = Samples(values=np.arange(300.0), censored=np.zeros(300, dtype=bool))
    points = {name: x[:300] for name, x in contents.points.items()}
    assert swings(replace(contents, samples={"p_max": few}, points=points), "p_max") == []


def test_a_dependent_strength_follows_its_input(contents: Contents) -> None:
    tie = {"of": ["sphere.E", "limits.x.strength"], "copula": "gaussian", "spearman": 0.6, "kendall": None}
    tied = put(contents, {"resolved/dependence": [tie]})
    sides = sides_of(tied, "x")
    assert sides is not None
    ranks = np.array([np.argsort(np.argsort(v)) for v in (sides.x, sides.strength)], dtype=float)
    assert np.corrcoef(ranks)[0, 1] == pytest.approx(0.6, abs=0.02)
    other = put(contents, {"resolved/dependence": [{**tie, "copula": "clayton"}]})
    assert sides_of(other, "x") is None


def test_numbers_of_a_figure_are_a_file_beside_it(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, limits={"x": limit(0.0075, 0.01, True)})
    page = build_report(folder).read_text(encoding="utf-8")
    for path in (folder / "figures").glob("*.csv"):
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        assert len(rows) > 1
        assert len({len(row) for row in rows}) == 1
        assert path.with_suffix(".svg").is_file()
        assert f"figures/{path.name}" in page

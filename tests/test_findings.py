"""Swings, waterfalls, sides of a limit and pairs against what is known of samples made for it."""

from __future__ import annotations

import csv
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_folders import estimate, limit, put, with_pairs, write_folder
from scipy.stats import norm, weibull_min

from uqsphere.report import build_report
from uqsphere.report.contents import Contents, Samples, read_contents
from uqsphere.report.figures.indices import pair_figure, pair_finding
from uqsphere.report.figures.limits import sides_of, surface_finding
from uqsphere.report.figures.swings import swings, tornado_finding, waterfall_figure, waterfall_finding, waterfall_table

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


def test_swings_are_those_of_a_linear_demand(contents: Contents) -> None:
    first, second = swings(contents, "p_max")
    assert (first.name, second.name) == ("sphere.E", "striker.speed")
    # the mean of the highest tenth of a normal variable; the median of the sum is that of a to first order
    tail = norm.pdf(norm.ppf(0.9)) / 0.1
    for swing, slope in ((first, 3e8), (second, -1e8)):
        for end, sign in ((swing.at_low, -1.0), (swing.at_high, 1.0)):
            assert end[1] < end[0] < end[2]
            assert end[0] == pytest.approx(3e9 + sign * slope * tail, abs=2.0 * (end[2] - end[1]))
        assert swing.seen
    assert "from 2." in tornado_finding(contents, "p_max")


def test_swings_of_censored_or_few_samples_are_not_shown(contents: Contents) -> None:
    late = replace(contents.samples["p_max"], censored=np.arange(N) < 0.2 * N)
    assert swings(replace(contents, samples={"p_max": late}), "p_max") == []
    few = Samples(values=np.arange(300.0), censored=np.zeros(300, dtype=bool))
    points = {name: x[:300] for name, x in contents.points.items()}
    assert swings(replace(contents, samples={"p_max": few}, points=points), "p_max") == []


def test_the_waterfall_leads_from_the_median_to_the_bad_end(contents: Contents) -> None:
    picture, table = waterfall_figure(contents, "x"), waterfall_table(contents, "x")
    assert picture is not None
    assert table is not None
    factors = [float(row[1]) for row in picture.rows[1:-1]]
    assert 1.5 * math.prod(factors) == pytest.approx(1.2)  # margins of the folder: 1.5 and 1.2
    assert math.log(factors[0]) / math.log(1.2 / 1.5) == pytest.approx(0.7)  # the strength's importance factor
    assert table.rows[-1][2] == "1.2"
    assert "strength of “x” takes 70 %" in waterfall_finding(contents, "x")


def test_as_many_samples_miss_the_aim_as_the_law_says(contents: Contents) -> None:
    sides = sides_of(contents, "x")
    assert sides is not None
    assert sides.name == "sphere.E"
    # the strength of the folder is Weibull, independent of the inputs
    known = float(weibull_min.cdf(contents.samples["p_max"].values, 12.0, scale=4.17e9).mean())
    assert sides.missed.mean() == pytest.approx(known, abs=4.0 * math.sqrt(known / N))
    assert (sides.demand > sides.strength).tolist() == sides.missed.tolist()
    assert "lie in the upper half of Young's modulus of the sphere" in surface_finding(contents, "x")


def test_a_dependent_strength_follows_its_input(contents: Contents) -> None:
    tie = {"of": ["sphere.E", "limits.x.strength"], "copula": "gaussian", "spearman": 0.6, "kendall": None}
    tied = put(contents, {"resolved/dependence": [tie]})
    sides = sides_of(tied, "x")
    assert sides is not None
    ranks = np.array([np.argsort(np.argsort(v)) for v in (sides.x, sides.strength)], dtype=float)
    assert np.corrcoef(ranks)[0, 1] == pytest.approx(0.6, abs=0.02)
    other = put(contents, {"resolved/dependence": [{**tie, "copula": "clayton"}]})
    assert sides_of(other, "x") is None


def test_pairs_are_named_with_their_share_and_refused_with_their_reason(tmp_path: Path) -> None:
    found = read_contents(with_pairs(write_folder(tmp_path)))
    text = pair_finding(found, "p_max")
    assert text.startswith("Young's modulus of the sphere and speed of the striker together carry 4 % of the variance")
    nothing = {"first": {}, "total": {}, "second": {"a|b": estimate(None, reason="beyond the budget")}}
    absent = put(found, {"results/sensitivity": {"p_max": nothing}})
    assert pair_finding(absent, "p_max").endswith("is not known: beyond the budget.")
    assert pair_figure(absent, "p_max") is None


def test_numbers_of_a_figure_are_a_file_beside_it(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, limits={"x": limit(0.0075, 0.01, True)})
    page = build_report(folder).read_text(encoding="utf-8")
    for path in (folder / "figures").glob("*.csv"):
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        assert len(rows) > 1
        assert len({len(row) for row in rows}) == 1
        assert path.with_suffix(".svg").is_file()
        assert f"figures/{path.name}" in page

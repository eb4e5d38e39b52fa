"""The pages of a fit and of a feed: the brief, the figures and their numbers, what is marked."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np
import pytest
from report_folders import html_errors
from test_population import fed, scattered

from uqsphere.feed import laws
from uqsphere.feed.answers import FeedPlan, answer_feed
from uqsphere.feed.fit import FitEntry
from uqsphere.feed.product import Fineness, ProductPlan
from uqsphere.feed.tests import make_specimens
from uqsphere.report.feed import feed_page, fit_page

TRUTH = {"e_inf": 40.0, "d0": 0.02, "phi": 0.9}
MOST_WORDS = 180


@pytest.fixture(scope="module")
def made():
    rng = np.random.default_rng(2)
    d = np.repeat([0.008, 0.016, 0.032, 0.056], [12, 10, 10, 8])
    energy = laws.median_energy("tavares", d, TRUTH) * np.exp(0.5 * rng.standard_normal(d.size))
    broke = np.ones(d.size, dtype=bool)
    broke[[3, 17, 30]] = False
    tests = make_specimens(d, energy, broke=broke, exact=broke)
    posterior = scattered(400)
    fitted = FitEntry(law="lognormal", size="tavares", ratio=4.0, tested=(0.008, 0.056), made_up=True, title="Rock")
    plan = FeedPlan(
        feed=fed(3, 100.0, lot=50.0, fines=0.004), product=ProductPlan(A=0.55, b=0.8 / 3600.0), goal=(0.5, 0.95),
        of={"sizes": "Rosin-Rammler", "energy": "blows of 100 J/kg"},
    )  # fmt: skip
    found = answer_feed(posterior, fitted, plan, title="A quarry <b>")
    return found.entry, fitted, posterior, tests


def brief_of(page):
    text = re.search(r'<section class="brief".*?</section>', page, re.DOTALL).group()
    return html.unescape(re.sub(r"<[^>]+>", " ", text)).replace("\xa0", " ")


def test_the_brief_has_three_numbers_the_verdict_and_few_words(made):
    files = feed_page(*made)
    brief = brief_of(files["report.html"])
    assert len(brief.split()) <= MOST_WORDS
    assert "made up" in brief
    entry = made[0]
    assert f"{100 * entry.broken.value:.3g}" in brief
    assert f"{1e3 * entry.p80.value:.3g}" in brief
    assert entry.goal.verdict == "not established"
    assert "lamp not-established on" in files["report.html"]
    assert "the machine takes more" in brief
    assert "A quarry &lt;b&gt;" in files["report.html"]
    assert "<script" not in files["report.html"]
    assert html_errors(files["report.html"]) == []


def test_every_figure_has_its_drawing_and_its_numbers(made):
    files = feed_page(*made)
    for name in ("tests", "size", "classes", "product"):
        assert files[f"figures/{name}.svg"].startswith("<?xml")
        assert len(files[f"figures/{name}.csv"].splitlines()) > 4
    entry = made[0]
    rows = [line.split(",") for line in files["figures/classes.csv"].splitlines()[1:]]
    assert [float(row[2]) for row in rows] == pytest.approx([one.broken.value for one in entry.classes])
    assert "from memory, not checked at the source" in files["report.html"]


def test_scatter_and_ignorance_stand_apart_and_sizes_beyond_the_tests_are_marked(made):
    page = html.unescape(feed_page(*made)["report.html"])
    assert "sd: ignorance" in page
    assert "sd: scatter" in page
    beyond = [one for one in made[0].classes if one.extrapolated]
    assert beyond
    assert page.count(" *</th>") == len(beyond)


def test_a_fit_has_a_page_of_its_own(made):
    _, fitted, posterior, tests = made
    page = fit_page(fitted, posterior, tests)["report.html"]
    assert len(brief_of(page).split()) <= MOST_WORDS
    assert "What the tests tell" in page
    assert html_errors(page) == []


def test_offered_energies_are_drawn_by_their_levels(made):
    entry, fitted, posterior, _ = made
    rng = np.random.default_rng(1)
    energy = np.repeat([50.0, 100.0, 200.0], 20)
    tests = make_specimens(0.02, energy, broke=rng.random(60) < 0.5, exact=False)
    rows = feed_page(entry, fitted, posterior, tests)["figures/tests.csv"].splitlines()
    assert sum("offered" in row for row in rows) == 3


def test_a_and_b_and_alpha_come_from_the_tests_where_the_study_has_none(made):
    rng = np.random.default_rng(3)
    offered = 3600.0 * np.geomspace(0.2, 2.0, 12)
    fine = 0.5 * -np.expm1(-1.0 * offered / 3600.0) * np.exp(0.05 * rng.standard_normal(12))
    sieves = np.array([0.016, 0.004, 0.001])
    n = 0.04 / sieves
    passing = -np.expm1((9.0 / (n - 1.0)) ** 0.45 * np.log1p(-fine[:, None]))
    told = Fineness(diameter=np.full(12, 0.04), offered=offered, t10=fine, sieves=sieves, passing=passing)
    _, fitted, posterior, _ = made
    plan = FeedPlan(feed=fed(1, 1000.0), product=ProductPlan())
    entry = answer_feed(posterior, fitted, plan, told).entry
    assert entry.product["A b"].low < 0.5 / 3600.0 < entry.product["A b"].high
    assert entry.product["alpha"].value == pytest.approx(0.45, rel=0.1)
    assert "12 sieve curves" in entry.sources["alpha"]
    nothing = answer_feed(posterior, fitted, plan).entry
    assert nothing.p80.value is None
    assert "no [product]" in nothing.p80.reason
    assert nothing.broken.value == pytest.approx(entry.broken.value)
    with pytest.raises(ValueError, match="fragments"):
        answer_feed(posterior, fitted, replace(plan, feed=fed(1, 1000.0, progeny="again")))


@pytest.mark.parametrize(
    ("least", "sure", "tested", "converged", "verdict"),
    [
        (0.5, 0.95, (0.0004, 0.08), True, "met"),
        (0.999, 0.95, (0.0004, 0.08), True, "not met"),
        (0.5, 0.95, (0.0004, 0.08), False, "not established"),
        (0.5, 0.95, (0.001, 0.002), True, "not established"),
    ],
)
def test_a_target_is_judged_by_draws_sizes_and_the_fit(least, sure, tested, converged, verdict):
    posterior = replace(scattered(400), tested=tested)
    fitted = FitEntry(law="lognormal", size="tavares", ratio=4.0, tested=tested, converged=converged)
    plan = FeedPlan(feed=fed(3), product=ProductPlan(A=0.5, b=1e-4), goal=(least, sure))
    goal = answer_feed(posterior, fitted, plan).entry.goal
    assert goal.verdict == verdict
    assert (verdict == "met") == (not goal.reasons) or verdict == "not met"

"""The campaigns count what they say: truths of their models, references, verdicts, and what is kept of them."""

from __future__ import annotations

import html
import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from docs.figures import errata
from docs.figures.instability import MU, exact_difference, fixed_steps
from reports import publish
from tests.campaigns import coverage, given, links, mutate
from tests.campaigns.coverage import LEAST, POOLED, QUANTILES, coverage_models, coverage_rows, pooled, reference
from uqsphere.errors import UsageError
from uqsphere.given import analyse_runs
from uqsphere.mechanics import stress
from uqsphere.model import answer_scene
from uqsphere.report.figures.canvas import style
from uqsphere.runner.evaluate import draw
from uqsphere.study import load_study, shipped_studies
from uqsphere.uq.expansion import fit_chaos, judge

MODELS = {model.name: model for model in coverage_models()}
KEPT = Path(__file__).parent.parent / "reports"


def test_every_mutant_has_its_file_its_line_and_its_tests() -> None:
    for one in mutate.read_mutants():
        assert one.before in (mutate.ROOT / "uqsphere" / one.file).read_text(encoding="utf-8"), one
        assert all((mutate.ROOT / "tests" / test.partition("::")[0]).is_file() for test in one.tests.split()), one


def test_every_campaign_can_be_begun_as_its_documents_have_it() -> None:
    """In a process of its own: beside tests the folder of the tests is on the path as well."""
    names = [f"tests.campaigns.{path.stem}" for path in (mutate.ROOT / "tests" / "campaigns").glob("[a-z]*.py")]
    done = subprocess.run([sys.executable, "-c", f"import {', '.join(names)}"], cwd=mutate.ROOT, text=True,
                          capture_output=True, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert len(names) > 20


# --- coverage -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", MODELS)
def test_exact_answers_are_those_of_many_points(name: str) -> None:
    """Closed forms and stored references against 2^14 points in each of eight replicates."""
    model = MODELS[name]
    truths = {
        "moments": (model.mean, model.sd),
        "quantiles": tuple(model.quantiles[p] for p in QUANTILES),
        "first": model.first,
        "total": model.total,
    }
    for kind, answers in reference(model, count=2**14, replicates=8).items():
        for (value, error), truth in zip(answers, truths[kind], strict=True):
            # 5 errors of eight replicates, and the last digit of a stored reference
            assert abs(value - truth) <= 5.0 * error + 2e-6 * max(1e-3, abs(truth)), kind


@pytest.fixture(scope="module")
def rows():
    chosen = [MODELS[name] for name in ("ishigami", "g-function", "linear", "lognormal")]
    return coverage_rows(repetitions=25, models=chosen, sample_sizes=(128,), index_sizes=(64,), seed=77)


def test_intervals_of_a_run_hold_the_truth_as_often_as_they_say(rows) -> None:
    for row in pooled(rows):
        # inputs of a model share their points: 100 repetitions are what is independent
        error = math.sqrt(0.95 * 0.05 / row.repetitions)
        assert POOLED[0] - 4.0 * error <= row.covered <= min(1.0, POOLED[1] + 4.0 * error), row
        assert 0.85 < row.width < 1.5
    for row in rows:
        assert row.covered >= LEAST - 4.0 * math.sqrt(LEAST * (1.0 - LEAST) / row.repetitions), row
    assert "| all |" in coverage.summary(rows)


# --- given data -----------------------------------------------------------------------------------


def test_shares_by_hand() -> None:
    """A sum with a tie; and a product of independent scores, whose first indices are zero."""
    correlation = np.array([[1.0, 0.7, 0.0], [0.7, 1.0, 0.0], [0.0, 0.0, 1.0]])
    found = given.shares_of(given.closed_effects(correlation, np.ones(3), np.zeros((3, 3))), 3)
    for order, truths in (("shapley", (1.7, 1.7, 1.0)), ("first", (2.89, 2.89, 1.0)), ("total", (0.51, 0.51, 1.0))):
        assert found[order] == pytest.approx(np.array(truths) / 4.4)
    product = given.shares_of(given.closed_effects(np.eye(2), np.zeros(2), np.array([[0.0, 0.5], [0.5, 0.0]])), 2)
    assert product["first"] == pytest.approx((0.0, 0.0))
    assert product["shapley"] == pytest.approx((0.5, 0.5))


@pytest.mark.parametrize("name", ["product, Gaussian ties", "linear, Clayton tie", "two humps, kernel density"])
def test_models_with_ties_have_the_answers_that_they_state(name: str) -> None:
    model = given.model_of(name)
    y = given._runs(model, 40_000, 1).y[:, 0]
    assert abs(y.mean() - model.mean) < 4.0 * model.sd / 200.0
    assert y.std() == pytest.approx(model.sd, rel=0.02)
    for p, truth in model.quantiles.items():
        assert np.mean(y <= truth) == pytest.approx(p, abs=4.0 * np.sqrt(p * (1.0 - p) / 40_000))
    assert sum(model.indices.get("shapley", (1.0,))) == pytest.approx(1.0)


def test_an_expansion_over_a_kernel_density_is_refused() -> None:
    """Of 11 tables whose laws were kernel densities the sd of the expansion held in 5."""
    found, _ = analyse_runs(given._runs(given.model_of("two humps, kernel density"), 200, 3))
    assert "kde" in {entry["chosen"] for entry in found["inputs"].values()}
    expansion = found["sensitivity"]["y"]["chaos"]
    assert not expansion["usable"]
    assert "kernel density" in expansion["reason"]
    assert found["outputs"]["y"]["expansion"] is None
    assert found["outputs"]["y"]["sd"]["value"] is not None


# --- a contact time that jumps --------------------------------------------------------------------

GRAZING = """
seed = 4
[sphere]
material = "alumina"
radius = "10 mm"
[bars]
material = "pmma"
diameter = "20 mm"
infinite = true
[striker]
speed  = { dist = "normal", mean = "5 m/s", cov = 0.02 }
length = { dist = "normal", mean = "130 mm", cov = 0.02 }
[analysis]
quantities = ["contact_time"]
"""


def test_a_contact_time_that_jumps_has_no_expansion(tmp_path: Path) -> None:
    """Contact is just lost, or just kept until the next swing; an expansion would be smooth there."""
    (tmp_path / "grazing.toml").write_text(GRAZING, encoding="utf-8")
    study = load_study(tmp_path / "grazing.toml")
    drawn = draw(study.inputs().only(study.random), seed=5, task="test", start=0, count=192, replicates=1)
    times = answer_scene(study, tuple(study.random), drawn.inputs[0], ("contact_time",)).values[:, 0]
    gap = np.diff(np.sort(times)).max()
    assert gap > 0.2 * times.mean()
    assert not judge(fit_chaos(drawn.scores[0], times, ("normal", "normal"))).usable


# --- the weakest link -----------------------------------------------------------------------------


def test_the_rim_is_nearly_all_that_the_principal_tension_sees() -> None:
    found = links.compare_links(links.principal_field(0.14, 0.22, 30), 0.14, 9.0)
    # the hoop tension is that of the tables, to the error of the trapezoidal rule
    assert found.hoop == pytest.approx(float(stress.ratio("volume", 0.14, 0.22, 9.0)), rel=0.04)
    assert found.surface_hoop == pytest.approx(float(stress.ratio("surface", 0.14, 0.22, 9.0)), rel=0.04)
    assert found.principal > 3.0 * found.hoop
    assert found.in_zone > 0.999
    # where the rim is left out, the two say nearly the same
    assert found.hoop * 0.99 < found.beyond < 1.1 * found.hoop


# --- the paper's equations ------------------------------------------------------------------------


@pytest.mark.parametrize(("bars", "limit"), [(True, 2.852), (False, 2.0 * math.sqrt(2.0))])
def test_longest_stable_step_of_the_numerical_instability(bars: bool, limit: float) -> None:
    swing = math.sqrt(2.0 / MU - (0.25 if bars else 0.0))

    def runs_away(step: float) -> bool:
        """Whether the error grows over a thousand steps rather than staying of the order of the swing."""
        times, values = fixed_steps(MU, step, 1000.0 * step, bars=bars)
        return bool(np.abs(values - exact_difference(MU, times, bars=bars)).max() > 1.0)

    assert runs_away(1.01 * limit / swing)
    assert not runs_away(0.99 * limit / swing)
    errors = []
    for step in (0.004, 0.002):
        times, values = fixed_steps(MU, step, 1.0, bars=bars)
        errors.append(np.abs(values - exact_difference(MU, times, bars=bars)).max())
    assert errors[0] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.15)


def test_the_figure_of_the_errata_shows_what_they_say() -> None:
    with style():
        massless, linear, pressure = errata.errata_figure().figure.axes
        right, printed, tail = (line.get_xydata() for line in massless.lines)
        assert printed[:, 1].max() == pytest.approx(1.0, abs=1e-3)
        assert printed[-1, 1] == 0.0 < right[-1, 1]
        # as if twice the time had passed
        at = np.interp(errata.THETA + 2.0, right[:, 0], right[:, 1])
        assert np.interp(errata.THETA + 1.0, tail[:, 0], tail[:, 1]) == pytest.approx(at, abs=1e-3)
        swinging = linear.lines[1].get_xydata()
        late = swinging[swinging[:, 0] > 3.0, 1]
        assert late.max() - late.min() == pytest.approx(2.0 * 0.197, abs=0.03)
        assert linear.lines[2].get_xydata()[-1, 1] == pytest.approx(2.0 * linear.lines[0].get_xydata()[-1, 1], rel=0.02)
        assert pressure.lines[0].get_xydata()[0, 1] == pytest.approx(0.5**0.5)
        assert pressure.lines[1].get_xydata()[0, 1] == pytest.approx(0.5)


# --- published reports ----------------------------------------------------------------------------


def test_one_is_made_with_what_it_needs_and_no_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    small = publish.Published(study="as_printed", evaluations=3_000, about="a question")
    monkeypatch.setattr(publish, "REPORTS", {"small": small})
    pages = publish.publish(tmp_path / "reports", ["small"])
    folder = tmp_path / "reports" / "small"
    assert pages == [folder / "report.html"]
    assert {path.name for path in folder.iterdir()} == {
        "brief.html",
        "report.html",
        "results.json",
        "study.toml",
        "tables",
    }
    text = pages[0].read_text("utf-8")
    assert str(tmp_path) not in text
    for table in re.findall(r"tables/([\w.-]+\.csv)", text):
        assert (folder / "tables" / table).is_file(), table
    assert "[small](small/report.html) | a question |" in (tmp_path / "reports" / "README.md").read_text("utf-8")
    with pytest.raises(UsageError, match="granit"):
        publish.publish(tmp_path, ["granit"])


@pytest.mark.parametrize("name", publish.REPORTS)
def test_what_is_kept_is_of_the_shipped_study(name: str) -> None:
    entry, folder = publish.REPORTS[name], KEPT / name
    results = json.loads((folder / "results.json").read_text("utf-8"))
    study = load_study(shipped_studies()[entry.study],
                       [f"analysis.budget.evaluations={entry.evaluations}", 'analysis.budget.time="12 h"'])  # fmt: skip
    assert results["study"]["hash"] == study.hash, "the study was changed: python -m reports.publish"
    assert sum(results["model"]["evaluations"].values()) <= entry.evaluations
    page = (folder / "report.html").read_text("utf-8")
    assert len(page.encode()) < 1_200_000
    title = study.title.replace("'", "’")  # as the page sets it
    assert title in html.unescape(page).replace("\u00a0", " ")
    assert not list(folder.rglob("*.npy"))


def test_the_list_is_that_of_the_reports() -> None:
    assert (KEPT / "README.md").read_text("utf-8") == publish.index_text(KEPT)
    assert (KEPT / publish.BENCHMARK / "bench.md").is_file()

"""A run in a notebook: the same decision, figures and tables as on its page."""

import re
from pathlib import Path

import pytest

from uqsphere import history, load_study
from uqsphere.quantities import lookup
from uqsphere.report import page_files
from uqsphere.report.history import history_rows
from uqsphere.report.sentences import decision_texts
from uqsphere.results import Run
from uqsphere.results.types import Results

STUDIES = Path(__file__).parents[2] / "studies"
REPORTS = sorted((Path(__file__).parents[2] / "reports").glob("*/results.json"))


@pytest.mark.slow
@pytest.mark.parametrize("path", REPORTS, ids=lambda path: path.parent.name)
def test_a_run_shows_itself_as_its_page_does(path: Path) -> None:
    results = Results.model_validate_json(path.read_bytes())
    html = Run(results=results)._repr_html_()
    assert "<html" not in html
    page = page_files(results, [])["report.html"]
    pictures = set(re.findall(r'aria-label="([^"]+)"', html))
    assert len(pictures) >= 2
    assert pictures <= set(re.findall(r'aria-label="([^"]+)"', page))
    for text in decision_texts(results):
        assert text.decision.verdict in html


def test_a_page_leaves_the_figures_of_the_user_as_they_are() -> None:
    import matplotlib.pyplot as plt

    before = plt.get_backend()
    plt.switch_backend("pdf")
    try:
        page_files(Results.model_validate_json(REPORTS[0].read_bytes()), [])
        assert plt.get_backend() == "pdf"
    finally:
        plt.switch_backend(before)


def test_an_impact_shows_the_numbers_that_were_given() -> None:
    # its rows were those of the means, whatever the speed
    study = load_study(STUDIES / "granite.toml")
    slow, fast = (
        dict(history_rows(history(study, {"striker.speed": speed}, points=200)))
        for speed in (0.5, 1.0)
    )
    peak = lookup("p_max").meaning
    assert float(fast[peak].split()[0]) > 1.1 * float(slow[peak].split()[0])


def test_an_impact_on_a_rod_that_loses_little_of_a_wave_is_shown_on_to_its_end() -> None:
    # after 100,000 round trips of the rod the sphere strikes it again: there were too many steps
    changes = ["rod.end=0.9999", "rod.length=0.3 m"]
    study = load_study(STUDIES / "quartz_load_cell.toml", changes)
    course = history(study, points=200)
    assert course.horizon > 11.0
    assert [change.kind for change in course.changes] == ["lost", "lost", "found", "lost"]
    (gauge,) = course.gauges
    assert -3e-5 < gauge.strain.min() < -1e-5
    rows = dict(history_rows(course))
    lost = float(rows[lookup("loaded_time").meaning].split()[0])
    assert lost == pytest.approx(1e6 * course.changes[-1].time, rel=1e-4)


def test_a_study_shows_inputs_and_strengths() -> None:
    html = load_study(STUDIES / "limestone_margin.toml")._repr_html_()
    assert "<html" not in html
    for text in ("sphere.E", "60\N{NO-BREAK SPACE}GPa", "whole", "6.3 to 12.0"):
        assert text in html


def test_a_scene_shows_its_events_and_figures() -> None:
    html = history(load_study(STUDIES / "granite.toml"))._repr_html_()
    for title in ("Contact force [kN]", "Contact pressure [GPa]", "Stress in the bars"):
        assert title in html
    assert "time to force equilibrium" in html

"""The paper's formulas as printed: they must stay wrong in the way the errata say, and be reported so."""

from __future__ import annotations

import csv
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from report_folders import limit, with_pairs, write_folder
from scenes import ENDLESS, example
from scipy.integrate import quad
from scipy.optimize import brentq

import uqsphere
from uqsphere.mechanics import as_printed
from uqsphere.mechanics.closed_form import loading_time, relaxing_approach, solve_closed
from uqsphere.mechanics.integrator import solve as dynamics
from uqsphere.mechanics.scene import Scene
from uqsphere.report import build_report
from uqsphere.report.chapters import build_chapters
from uqsphere.report.contents import read_contents
from uqsphere.report.page import GLOSSARY, _distinct, _numbers_of, margin_boxes, unbroken, words_used
from uqsphere.results.entries import Manifest

SCENE = example(numbers=ENDLESS, infinite=True)


@pytest.fixture(scope="module")
def table():
    return {row.quantity: row for row in as_printed.compare(SCENE)}


def test_where_6_715_comes_from():
    """Twice the time to 0.8904 alpha_max; the integral as it is printed, with x³/2, makes it 4.726."""
    assert 4.0 * loading_time(0.8904) == pytest.approx(as_printed.DURATION_FACTOR, abs=1e-3)
    literal, _ = quad(lambda x: 1.0 / (1.0 - 0.5 * x**3), 0.0, 1.0)
    assert 4.0 * literal == pytest.approx(4.726, abs=1e-3)


def test_widths_of_the_printed_force_curve():
    """Against the curve itself: alpha^(3/2) by (3.9)."""

    def force(t):
        return float(as_printed.approach(t, 1.0, 1.0)) ** 1.5

    first, last = brentq(lambda t: force(t) - 0.5, 0.0, 0.5), brentq(lambda t: force(t) - 0.5, 0.5, 1.0)
    assert as_printed.pulse_width(1.0) == pytest.approx(last - first, rel=1e-10)
    low, high = brentq(lambda t: force(t) - 0.1, 0.0, 0.5), brentq(lambda t: force(t) - 0.9, 0.0, 0.5)
    assert as_printed.rise_time(1.0) == pytest.approx(high - low, rel=1e-10)
    assert force(1.1) == 0.0


def test_the_missing_factor_two_after_the_pulse():
    """Printed, the approach falls as if twice the time had passed."""
    printed = as_printed.approach_after_pulse(3.0, 0.7, 1.0, 1.0)
    assert printed == pytest.approx(float(relaxing_approach(0.7, 6.0)), rel=1e-12)


def test_peaks_are_those_of_an_endless_step(table):
    scales = SCENE.scales
    step = replace(SCENE, shape="step", horizon=60.0 * float(scales.time[0]),
                   columns={k: v for k, v in SCENE.columns.items() if k != "striker.length"})  # fmt: skip
    endless = solve_closed(step).values
    for name in ("p_max", "P_max", "alpha_max", "a_max"):
        assert table[name].as_printed == pytest.approx(endless[name][0], rel=1e-12)
        assert table[name].as_printed > table[name].corrected
    assert table["P_max"].as_printed == pytest.approx(float(scales.force[0]), rel=1e-12)


def test_values_of_the_table(table):
    full = dynamics.solve(SCENE, tolerance=1e-8).values
    closed = solve_closed(SCENE).values
    for name in ("p_max", "P_max", "alpha_max", "a_max", "pulse_width", "rise_time", "energy"):
        assert table[name].full == full[name][0]
        assert table[name].corrected == closed[name][0]
    assert table["energy"].as_printed is None
    assert table["energy"].error is None
    # contact is not lost within the record, whatever (3.8) says
    assert (table["contact_time"].corrected, table["contact_time"].full) == (None, None)
    assert "not over within the record" in table["contact_time"].note
    half = table["mean_pressure_at_half_approach"]
    assert half.as_printed == pytest.approx(table["p_max"].as_printed / 3.0, rel=1e-12)
    assert half.corrected == pytest.approx(table["p_max"].corrected * 2.0 / 3.0 * math.sqrt(0.5), rel=1e-12)


def test_the_linear_plateau_is_printed_twice_too_high(table):
    row = table["linear_plateau"]
    assert row.as_printed == pytest.approx(2.0 * row.corrected, rel=1e-12)
    assert row.full == pytest.approx(row.corrected, rel=1e-6)
    assert row.error == pytest.approx(1.0, rel=1e-5)


def test_a_light_sphere_confirms_the_corrected_values():
    """With mu -> 0 the full model meets the corrected column, and not the printed one."""
    columns = {**SCENE.columns, "sphere.density": np.array([20.0])}
    found = as_printed.compare(replace(SCENE, columns=columns), tolerance=1e-6)
    rows = {row.quantity: row for row in found}
    for name in ("p_max", "approach_at_t_c", "approach_after_pulse", "linear_plateau", "mean_pressure"):
        assert rows[name].full == pytest.approx(rows[name].corrected, rel=1e-2)
        assert abs(rows[name].error) > 0.2


def test_every_row_names_its_equation(table):
    assert all("(" in row.note for row in table.values() if row.as_printed is not None)


def test_other_pulses_and_finite_bars_are_compared_with_the_rectangle():
    finite = {"bars.incident_length": 1.5, "bars.receiving_length": 1.5, "bars.incident_end": 1.0,
              "bars.receiving_end": 1.0, "pulse.rise": 25e-6, "pulse.fall": 25e-6}  # fmt: skip
    columns = {**SCENE.columns, **{name: np.array([value]) for name, value in finite.items()}}
    rows = {r.quantity: r for r in as_printed.compare(Scene(columns=columns, shape="trapezoid"))}
    assert rows["p_max"].corrected == pytest.approx(solve_closed(SCENE).values["p_max"][0], rel=1e-12)
    assert rows["p_max"].full > 1.1 * rows["p_max"].corrected  # the reload
    assert rows["contact_time"].full is not None


def test_a_row_without_meaning_is_refused():
    columns = {**SCENE.columns, "sphere.nu": np.array([0.7])}
    with pytest.raises(ValueError, match="outside the domain"):
        as_printed.compare(replace(SCENE, columns=columns))


# --- the page on paper, its words, and the numbers behind its figures -----------------------------


STUDIES = Path(__file__).parents[1] / "studies"


def page_of(folder: Path) -> str:
    return build_report(folder).read_text(encoding="utf-8")


def test_every_figure_has_its_numbers_in_a_file(tmp_path: Path) -> None:
    settings = ("analysis.budget.evaluations=12_000", "model.tolerance=1e-3", "analysis.quantiles=[0.05, 0.5, 0.95]",
                "analysis.accuracy={mean=0.5, quantile=0.9, sobol=0.9, probability=0.5}")  # fmt: skip
    folder = uqsphere.run(uqsphere.load_study(STUDIES / "granite.toml", settings), out=tmp_path / "run").folder
    page = page_of(folder)
    contents = read_contents(folder)
    blocks = [b for c in _distinct(build_chapters(contents)) for b in c.blocks if b.picture is not None]
    names = [b.picture.name for b in blocks if b.picture is not None]
    kinds = {"fragility", "distribution", "sensitivity", "force-band",
             "bars-hardest", "stress-hardest", "convergence", "speed"}  # fmt: skip
    assert kinds <= {next((kind for kind in kinds if name.startswith(kind)), name) for name in names}
    for block in blocks:
        files = _numbers_of(block)
        assert files, block.heading
        assert f"numbers: {', '.join(files)}." in page
        for name in files:
            if name.endswith(".csv"):
                rows = list(csv.reader((folder / name).read_text("utf-8").splitlines()))
                assert len(rows) > 1, name
                assert {len(row) for row in rows} == {len(rows[0])}, name
    # the hardest is that of all samples, by a quantity of the run
    hardest = contents.courses["hardest"] if contents.courses else {}
    values = contents.samples[hardest["by"]].values
    k = int(np.argmax(values))
    assert hardest["among"] >= len(values)
    if hardest["among"] == len(values):
        assert all(contents.points[name][k] == value for name, value in hardest["inputs"].items())
    assert hardest["contact"]["pressure"] >= contents.samples["p_max"].values.max() * (1.0 - 1e-3)


def test_the_margins_of_paper_hold_title_day_and_number(tmp_path: Path) -> None:
    sheet = margin_boxes('a"}</style>\\ <b>', Manifest(finished="2026-01-31"))
    assert "counter(page)" in sheet
    assert "run of 2026\\2d 01\\2d 31" in sheet
    assert not set("<>&") & set(sheet)
    assert sheet.count('"') % 2 == 0
    assert "run of" not in margin_boxes("a", Manifest())
    page = page_of(write_folder(tmp_path, title='</style><script>alert("x")</script>'))
    assert page.count("</style>") == 1
    assert "<script" not in page


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("12,345 of 1,234,567 rows", "12_345 of 1_234_567 rows"),
        ("a[1,200] and 0.1,200 and 1,2", "a[1_200] and 0.1,200 and 1,2"),
        ("1.2 × 10⁻⁴ (1.1 × 10⁻⁴ to 1.3 × 10⁻⁴)", "1.2~×~10⁻⁴ (1.1~×~10⁻⁴~to~1.3~×~10⁻⁴)"),
        ("5 kN (4 to 6) here", "5~kN (4~to~6) here"),
        ("(as far as to the end)", "(as far as to the end)"),
    ],
)
def test_numbers_stay_on_one_line_with_one_kind_of_thousands(text: str, kept: str) -> None:
    assert unbroken(text).replace("\u00a0", "~").replace("\u202f", "_") == kept


def test_commands_are_left_as_they_are(tmp_path: Path) -> None:
    folder = write_folder(tmp_path)
    path = folder / "study.resolved.json"
    path.write_text(path.read_text("utf-8").replace('"materials"', '"overrides": ["a=[1,200]"], "materials"'), "utf-8")
    assert "--set &#39;a=[1,200]&#39;" in page_of(folder)


def test_only_words_that_the_page_uses_are_explained(tmp_path: Path) -> None:
    names = [name for name, _, _ in GLOSSARY]
    assert len(set(names)) == len(names)
    assert words_used("<style>.Shapley {}</style><p>nothing of it</p>") == []
    assert [word for word, _ in words_used("<p>by Shapley effects, the surrogate</p>")] == [
        "Shapley effect",
        "surrogate",
    ]
    page = page_of(write_folder(tmp_path, limits={"x": limit(0.0075, 0.01, True)}))
    shown = re.search(r'<dl class="words">(.*?)</dl>', page, re.DOTALL)
    found = re.findall(r"<dt>(.*?)</dt>", shown[1])
    assert {"quantile", "coefficient of variation"} & set(found)
    assert "PAWN" not in found
    before = re.sub(r"<svg.*?</svg>", "", page[: page.index('<section id="words">')], flags=re.DOTALL)
    for word in ("surrogate", "violin", "copula", "Kucherenko"):
        assert (word in before.lower()) == any(word in name.lower() for name in found), word


def test_no_heading_is_said_twice(tmp_path: Path) -> None:
    page = page_of(with_pairs(write_folder(tmp_path, limits={"x": limit(0.0075, 0.01, True)})))
    parts = re.findall(r"<h3>([^<]*)</h3>(.*?)(?=<h3>|</main>)", page, re.DOTALL)
    assert len(parts) > 5
    for heading, rest in parts:
        assert f"<caption>{heading}</caption>" not in rest

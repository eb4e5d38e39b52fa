"""What a run is forecast to take, what its account says of it, and what a band that is too wide would take."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from conftest import SUM

import uqsphere
from uqsphere.runner.campaign import cost_of
from uqsphere.runner.forecast import forecast, plan_run, plan_text
from uqsphere.runner.questions.curves import KIND, Band
from uqsphere.study import Study, load_study

#: between what is likely and what is taken
FACTOR = 2.0
STUDIES = Path(__file__).parents[1] / "studies"


# --- bands ------------------------------------------------------------------------------------------------


def test_a_band_that_is_too_wide_says_what_it_would_take() -> None:
    cost = cost_of([(1000, 8.0), (4000, 4.0)])
    text = Band(half_width=0.08, asked=0.02, evaluations=4000, cost=cost, share=0.05).missed()
    assert "half-width 0.08 of the smaller side of its probability, asked 0.02" in text
    assert "about 64,000 evaluations would reach it" in text
    assert "a budget of about 1,300,000" in text


# --- forecasts --------------------------------------------------------------------------------------------


#: parts of a plan in the order of the columns of docs/validation.md
COLUMNS = ("pilot", "sampling", "rare events", "margins", "fracture", "sensitivity", "ways to break")
#: contact times may jump so much that their indices take more; of a load cell the sampling is over sooner
FAR = (
    *(
        (name, "sampling")
        for name in (
            "granite",
            "granite_three_ways",
            "limestone_drop_weight",
            "limestone_margin",
            "limestone_three_ways",
            "quartz_load_cell",
        )
    ),
    ("granite_10mm_test", "sensitivity"),
)


def measured() -> dict[str, dict[str, tuple[int, int]]]:
    """Likely and taken evaluations of every part, by study, as docs/validation.md has them."""
    text = (STUDIES.parent / "docs" / "validation.md").read_text("utf-8").split("## Planned and taken")[1]
    found = {}
    for line in re.findall(r"^\| `.*$", text.split("\n## ")[0], re.MULTILINE):
        name, *cells = (cell.strip(" `") for cell in line.strip("|").split("|"))
        pairs = zip(COLUMNS, cells, strict=False)
        found[name] = {
            part: (int(likely), int(taken))
            for part, cell in pairs
            if cell
            for likely, taken in [cell.replace(",", "").split("/")]
        }
    return found


def test_every_shipped_study_is_measured() -> None:
    studies = {path.stem: load_study(path) for path in STUDIES.glob("*.toml")}
    # a study without a rig of its own is planned service by service
    assert set(measured()) == {name for name, study in studies.items() if study.rig != "none"}


@pytest.mark.parametrize("name", sorted(measured()))
def test_likely_numbers_are_within_a_factor_of_two_of_the_shipped_studies(name: str) -> None:
    study = load_study(STUDIES / f"{name}.toml")
    planned = {part.name: part for part in forecast(study, study.analysis.budget.evaluations)}
    assert set(measured()[name]) == set(planned)
    for part, (likely, taken) in measured()[name].items():
        assert planned[part].likely == likely, part
        assert taken <= planned[part].most, part
        if (name, part) not in FAR:
            assert taken / FACTOR <= likely <= FACTOR * taken, part


def test_a_finer_quantile_takes_more_and_the_most_is_no_less_than_likely(study_from: Callable[..., Study]) -> None:
    sizes = []
    for asked in (0.1, 0.03, 0.01):
        parts = forecast(study_from(f"analysis.accuracy.quantile={asked}", text=SUM))
        assert all(part.most >= part.likely for part in parts)
        sizes.append(next(part.likely for part in parts if part.name == "sampling"))
    assert sizes[0] < sizes[1] < sizes[2]


def test_the_plan_is_the_sum_of_its_parts(study_from: Callable[..., Study]) -> None:
    study = study_from(text=SUM)
    plan = plan_run(study)
    assert plan["evaluations"] == sum(part["likely"] for part in plan["parts"]) <= plan["most"] <= 9000
    text = plan_text(study, plan)
    found = re.search(r"evaluations: about ([0-9,]+), at most ([0-9,]+)", text)
    for told, number in zip(found.groups(), (plan["evaluations"], plan["most"]), strict=True):
        assert int(told.replace(",", "")) == pytest.approx(number, rel=6e-3)
    assert "margins" in text


def test_a_plan_warns_of_quantities_that_may_be_rough() -> None:
    """The indices of a contact time took 4.3 times what was likely."""
    told = {}
    for name in ("granite", "limestone_margin", "limestone_ball_slow"):
        study = load_study(STUDIES / f"{name}.toml")
        told[name] = plan_text(study, plan_run(study)).split("\n")[0]
    assert told["limestone_ball_slow"].endswith("(several times the first where contact_time is rough)")
    assert "rough" not in told["limestone_margin"]
    # nothing is left to go on with where the budget is all but what is likely
    study = load_study(STUDIES / "limestone_ball_slow.toml", ("analysis.budget.evaluations=20_000",))
    assert "rough" not in plan_text(study, plan_run(study))


# --- the account ------------------------------------------------------------------------------------------


def test_the_account_adds_up(study_from: Callable[..., Study], tmp_path: Path) -> None:
    study = study_from(text=SUM)
    found = uqsphere.run(study, out=tmp_path / "r", model=lambda x: {"y": x["a"] + x["b"]})
    results = found.results.document()
    parts = {row["part"]: row for row in results["plan"]["parts"]}
    assert sum(row["taken"] for row in parts.values()) == sum(results["model"]["evaluations"].values())
    assert parts["sampling"]["taken"] == results["quantities"]["y"]["mean"]["evaluations"]
    curve = [row for row in results["speed_error"] if row["quantity"] == "margins.high"]
    bands = [row for row in curve if row["error_kind"] == KIND]
    assert bands
    assert len(curve) == len(bands) + 1
    band = results["margins"]["high"]["band"]
    assert band["half_width"] == bands[-1]["error"]
    missed = [text for text in results["accuracy"]["missed"] if "band of the curve" in text]
    assert bool(missed) == (band["half_width"] > band["asked"])
    assert len(found.manifest.speed_error_seconds) == len(results["speed_error"])

"""The brief: one sheet whose numbers are those of results.json, in at most 180 words, on a screen and on paper."""

from __future__ import annotations

import html
from dataclasses import replace
from pathlib import Path

import pytest
from report_folders import estimate, limit, put, write_folder

from uqsphere.cli import main
from uqsphere.mechanics.validity import RULES
from uqsphere.report import brief, phrases
from uqsphere.report.brief import Answer, Axis, Mode, make_brief, ranged, share_span, span
from uqsphere.report.cautions import check_words
from uqsphere.report.contents import read_contents
from uqsphere.report.phrases import short_share

STUDY = """
title = "Two ways"
seed = 7
[sphere]
material = "granite"
E = { dist = "lognormal", mean = "52 GPa", cov = 0.1 }
radius = "10 mm"
[bars]
material = "maraging_steel"
diameter = "40 mm"
infinite = true
[striker]
speed = "0.5 m/s"
length = "0.8 m"
[limits.contact]
quantity = "p_max"
strength = { dist = "weibull", mean = "4 GPa", modulus = 12 }
target = 0.01
[limits.core]
criterion = "core_tension"
strength = { dist = "lognormal", mean = "30 MPa", cov = 0.2 }
target = 0.01
[analysis]
quantities = ["p_max"]
accuracy = { mean = 0.02, quantile = 0.05, sobol = 0.05, probability = 0.1 }
budget = { evaluations = 40000 }
[margins]
solve = "striker.speed"
between = ["0.1 m/s", "5 m/s"]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    home = tmp_path_factory.mktemp("brief")
    (home / "s.toml").write_text(STUDY)
    assert main(["run", str(home / "s.toml"), "--out", str(home / "run")]) in (0, 3)
    assert main(["report", str(home / "run"), "--brief", "--pdf"]) == 0
    return home / "run"


def test_the_sheet_says_what_the_results_say(folder: Path) -> None:
    contents = read_contents(folder)
    answer = make_brief(contents).answers[0]
    limits = contents.results.limits
    misses = [float(limit.miss.value or 0.0) for limit in limits.values()]
    solved = [contents.results.margins[name].value.number for name in limits]
    solved += [float(way.answer) for way in contents.results.verdicts[0].judged if way.answer is not None]
    own = [mode for mode in answer.modes if not mode.assumed]
    assert {mode.limit for mode in own} == set(limits)
    assert [mode.miss for mode in own] == sorted(misses, reverse=True)
    judged = [way for way in contents.results.verdicts[0].judged if way.assumed]
    assert {mode.miss for mode in answer.modes if mode.assumed} == {way.miss.value for way in judged}
    page = html.unescape((folder / "brief.html").read_text())
    assert span(solved) in answer.second[1]
    for miss in misses:
        assert short_share(miss, 0.01).replace("\u00a0", " ") in page.replace("\u00a0", " ")
    assert "core tension" in page
    assert "contact pressure" in page


def test_the_next_measurement_tells_the_ways_apart(folder: Path) -> None:
    measure = make_brief(read_contents(folder)).measure
    count, where = measure[0].split(" spheres at ")
    assert 5 <= int(count) <= 20
    assert where.endswith("m/s")
    assert "rules out" in measure[1]
    assert measure[1].endswith("else the lower number holds.")


def test_a_limit_that_is_no_fracture_is_a_check(tmp_path: Path) -> None:
    """Yield of the bars stood among the ways of breaking, in their range and as what drives them."""
    bars = {**limit(0.63, 0.05, False), "governing_inputs": {"sphere.E": 0.99}}
    fracture = {"limits": ["core"], "left_out": ["bars"], "union": estimate(0.04)}
    contents = read_contents(write_folder(tmp_path, limits={"bars": bars, "core": limit(0.04, 0.1, True)}))
    found = make_brief(put(contents, {"results/fracture": fracture}))
    (answer,) = found.answers
    assert [mode.limit for mode in answer.modes] == ["core"]
    assert (answer.big, answer.verdict, answer.target) == ("4.0", "met", 0.1)
    assert answer.checks == ("“bars” exceeded: 63\u00a0% (not met: at most 5 %)",)
    assert found.driven != "bars"


def test_checks_are_told_with_what_they_do_to_the_answer(tmp_path: Path) -> None:
    rules = [rule.name for rule in RULES if rule.warning is not None or rule.failure is not None]
    assert all(check_words(name) != name.replace("_", " ") for name in rules)
    for check, aim, followed, effect in (
        ("bar_yield_contact", "survive", True, "fewer break than stated"),
        ("bar_yield_pulse", "break", True, "fewer break than stated"),
        ("small_contact", "survive", True, "effect unknown"),
        ("force_balance", "survive", False, "effect unknown"),
        ("force_balance", "survive", True, ""),
        ("reachable", "break", True, "more break if it was computed from a force by Hertz (strength_is)"),
    ):
        contents = read_contents(
            write_folder(tmp_path / f"{check}{aim}{followed}", limits={"x": limit(0.01, 0.2, True, aim=aim)})
        )
        broken = {"check": check, "share": 0.2, "share_warning": 0.2, "share_failure": 0.0, "worst": 1.0, "text": "t"}
        moved = {"results/validity": [broken], "results/model/chosen": "full" if followed else "massless"}
        told = [caution.text for caution in make_brief(put(contents, moved)).cautions if "(20 %)" in caution.text]
        assert [text.partition("): ")[2] for text in told] == ([f"{effect}."] if effect else [])


def test_a_way_without_a_number_opens_the_safe_end() -> None:
    """What breaks more than is allowed at every value looked at leaves nothing to promise."""
    axis = Axis(path="striker.speed", words="striker speed", unit="m/s", factor=1.0, planned=0.6)
    tested = Mode(limit="whole", name="Core tension", place="core", miss=0.002, broken=0.002, at_target=0.9)
    worse = Mode(limit="", name="Ring crack", place="rim", miss=0.9, broken=0.9, assumed=True)
    curve = ((0.05, 0.4), (2.0, 0.999))
    for aim, modes, told in (
        ("survive", (tested,), "0.90"),
        ("survive", (tested, worse), "under 0.60–0.90"),
        ("survive", (tested, replace(worse, curve=curve)), "under 0.050–0.90"),
        ("break", (tested, worse), "over 0.90"),
        ("break", (tested, replace(worse, curve=curve)), "0.90–over 2.0"),
    ):
        answer = Answer(question="", big="", unit="", note="", aim=aim, axis=axis, target=0.01, modes=modes)
        assert ranged(answer) == told


def test_a_way_along_which_no_rows_were_left_is_said_to_be_left_out() -> None:
    axis = Axis(path="striker.speed", words="striker speed", unit="m/s", factor=1.0, planned=0.2)
    modes = (Mode(limit="contact", name="Contact pressure", place="contact", miss=0.002, at_target=0.42),
             Mode(limit="core", name="Core tension", place="core", miss=0.001, at_target=1.4),
             Mode(limit="", name="Ring crack", place="rim", miss=0.004, assumed=True))  # fmt: skip
    answer = Answer(question="", big="", unit="", note="", axis=axis, target=0.1, modes=modes)
    second = brief._second(answer)
    assert second is not None
    assert second[2] == "ring crack left out"
    solved = brief._solved(answer)
    assert solved is not None
    assert solved.note.endswith("Ring crack left out.")
    curved = replace(answer, modes=(*modes[:2], replace(modes[2], curve=((0.1, 0.0), (1.0, 0.5)), at_target=0.3)))
    assert (brief._second(curved) or ("",) * 3)[2] == "by way of breaking"
    assert phrases.capital("sphere.hardness: 6 GPa") == "sphere.hardness: 6 GPa"


def test_a_way_that_was_not_seen_has_its_bound() -> None:
    unseen = Mode(limit="f", name="f", place="", miss=0.0, high=0.26)
    answer = Answer(question="", big="", unit="", note="", aim="survive", axis=None, target=None, modes=(unseen,))
    assert share_span(answer.misses, None) == "0–26"

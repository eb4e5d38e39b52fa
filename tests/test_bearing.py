"""What a broken assumption says about the answer: every rule has words, and a direction only where theory has one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from report_folders import limit, put, write_folder

from uqsphere.mechanics.validity import RULES
from uqsphere.report.assumptions import bearing, breach
from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.verdict import cautions, glances
from uqsphere.results.entries import CheckEntry


def with_check(tmp_path: Path, check: str, text: str = "text", **limits: dict[str, Any]) -> Contents:
    contents = read_contents(write_folder(tmp_path, limits=limits))
    broken = {"check": check, "share": 0.2, "share_warning": 0.2, "share_failure": 0.0, "worst": 1.0, "text": text}
    return put(contents, {"results/validity": [broken]})


def test_every_rule_has_words_for_its_breach() -> None:
    for rule in RULES:
        if rule.warning is not None or rule.failure is not None:
            check = CheckEntry(check=rule.name, share=0.1, worst=None, text="", share_warning=0.1)
            assert rule.name.replace("_", " ") not in breach(check, "warning")


@pytest.mark.parametrize(
    ("check", "aim", "words"),
    [
        ("bar_yield_contact", "survive", "is smaller than stated"),
        ("bar_yield_contact", "break", "is larger than stated"),
        ("bar_yield_pulse", "survive", "is smaller than stated"),
        ("force_balance", "survive", "does not move"),
        ("small_contact", "survive", "in which direction is not known"),
    ],
)
def test_a_warning_says_how_it_moves_the_probability(tmp_path: Path, check: str, aim: str, words: str) -> None:
    contents = with_check(tmp_path, check, x=limit(0.0075, 0.2, True, aim=aim))
    assert words in bearing(contents, check)
    (told,) = [text for text in cautions(contents) if "Validity warning" in text]
    assert words in told
    assert "(20 % of the samples)" in told


def test_forces_of_a_massless_sphere_are_balanced_by_assumption(tmp_path: Path) -> None:
    contents = with_check(tmp_path, "force_balance", x=limit(0.0075, 0.2, True))
    assert "not known" in bearing(put(contents, {"results/model/chosen": "massless"}), "force_balance")


def test_a_check_at_fracture_counts_those_that_break(tmp_path: Path) -> None:
    text = "in 58 % of the specimens that break the two forces differ"
    contents = with_check(tmp_path, "force_balance", text, x=limit(0.0075, 0.2, True))
    valid = next(glance.answer for glance in glances(contents) if glance.question == "Model valid?")
    assert "the two contact forces differ" in valid
    (told,) = [text for text in cautions(contents) if "Validity warning" in text]
    assert "(20 % of the specimens that break)" in told

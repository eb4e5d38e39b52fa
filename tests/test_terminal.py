"""What the terminal shows fits it, with names of any length, and has the numbers of the page."""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

import pytest
from report_folders import limit, write_folder

from uqsphere.cli.run import Progress
from uqsphere.console import screen_width, table, wrap, writable
from uqsphere.report.brief import LINES, summary_of
from uqsphere.report.compare import compare_folders, comparison_text
from uqsphere.report.contents import read_contents

WIDTHS = (60, 80, 120)
NAME = "Quetschfestigkeitsgrenzwertüberschreitung"


def longest(text: str) -> int:
    return max(map(len, text.split("\n")))


@pytest.mark.parametrize("width", WIDTHS)
def test_the_answers_fit_the_terminal(width: int, tmp_path: Path) -> None:
    limits = {
        f"{NAME}_{k}": limit(0.0123 + 0.1 * k, 0.02, not k, aim="survive" if k < 2 else "break") for k in range(5)
    }
    text = summary_of(read_contents(write_folder(tmp_path, limits=limits)), width)
    assert longest(text) <= width
    assert len(text.split("\n")) <= LINES


def test_nothing_is_parted_but_by_the_width(tmp_path: Path) -> None:
    contents = read_contents(write_folder(tmp_path, limits={NAME: limit(0.0123, 0.02, True)}))
    whole, narrow = (re.sub(r"\s+", "", summary_of(contents, width)) for width in (400, 60))
    assert whole == narrow
    assert "1.2%" in whole
    assert "\x1b" not in whole


@pytest.mark.parametrize("width", WIDTHS)
def test_a_comparison_fits_the_terminal(width: int, tmp_path: Path) -> None:
    name = NAME
    before = write_folder(tmp_path / "before", limits={name: limit(0.0123, 0.02, True)})
    after = write_folder(tmp_path / "after", limits={name: limit(0.0301, 0.02, False)})
    found = compare_folders(before, after)
    before_side = found.before.model_copy(update={"folder": "before-results"})
    after_side = found.after.model_copy(update={"folder": "after-results"})
    found = found.model_copy(update={"before": before_side, "after": after_side})
    text = comparison_text(found, width)
    assert longest(text) <= width
    assert "NOT MET" in text
    assert "0.01230 (0.01180 to 0.01280)" in comparison_text(found, 200)


def test_a_table_gives_way_to_numbers_last() -> None:
    text = table(("of", "value"), [("Quetschfestigkeitsgrenzwertüberschreitung", "0.20160 (0.20126 to 0.20194) %")], 50)
    assert longest(text) <= 50
    assert "0.20160 (0.20126 to 0.20194) %" in text
    assert re.sub(r"\s|0.*%", "", text) == "ofvalueQuetschfestigkeitsgrenzwertüberschreitung"


def test_a_sentence_is_wrapped_and_loses_nothing() -> None:
    text = "limits.Quetschfestigkeitsgrenzwertüberschreitung.strength is what to measure first\x1b[31m"
    found = wrap(text, 24)
    assert longest(found) <= 24
    assert re.sub(r"\s", "", found) == text.replace(" ", "").replace("\x1b", "?")


def test_a_terminal_without_the_signs_gets_plain_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO(), encoding="ascii"))
    assert writable("−2.5 × 10⁻⁷ (−3.1 × 10⁻⁷ to 0) µs") == "-2.5e-7 (-3.1e-7 to 0) us"


def test_the_width_is_that_of_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "132")
    assert screen_width() == 132
    monkeypatch.setenv("COLUMNS", "3")
    assert screen_width() == 40


class Screen(io.StringIO):
    """A terminal's side of stderr."""

    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("width", WIDTHS)
def test_the_bar_and_the_accuracy_below_it_fit_the_terminal(width: int, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("TERM", "xterm")
    now = 100.0
    monkeypatch.setattr("uqsphere.cli.run.time.monotonic", lambda: now)
    progress = Progress(evaluations=2_000_000, seconds=600.0, asked={"mean": 0.01}, began=now, started=now)
    kind = "half-width of the mean over the standard deviation"
    names = ("p_max", "contact_time", NAME)
    progress.reached([{"quantity": n, "error": 0.02 + k, "error_kind": kind} for k, n in enumerate(names)])
    progress("sampling", 1, 131_072)
    screen.seek(0)
    screen.truncate()
    now += 30.0
    progress("sampling", 65_536, 131_072)
    first, second = screen.getvalue().split("\n")
    assert len(first.strip("\r")) == width - 1
    assert "sampling: 65,536 of 131,072 evaluations" in first
    # the remaining time of the stage where there is room for it, and the accuracy of the worst quantity at least
    assert ("30 s left" in first) == (width >= 80)
    below, up = second.split("\x1b[A")
    assert up == "\r"
    assert len(below) == width - 1
    assert f"error over what was asked: {NAME} 2e+02".startswith(below.strip().strip("…")[:59])
    progress.finish()
    assert screen.getvalue().endswith("\r\n\n")

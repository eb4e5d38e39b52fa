"""Two runs side by side: intervals of differences, verdicts over many answers, text, JSON and page."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from report_folders import limit, write_folder

from uqsphere.cli import main
from uqsphere.report.compare import compare_folders, comparison_text, difference_interval, judge_together

EXACT = 1e-12
ORDINARY = st.floats(-1e6, 1e6, allow_nan=False)
HALF = st.floats(1e-3, 1e3)


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path]:
    """Two folders whose limit has moved from 1.2 % to 3 %."""
    before = write_folder(tmp_path / "before", limits={"crushing": limit(0.0123, 0.02, True)})
    after = write_folder(tmp_path / "after", limits={"crushing": limit(0.0301, 0.02, False)})
    return before, after


# --- the interval of a difference -----------------------------------------------------------------


def test_symmetric_intervals_add_in_quadrature() -> None:
    found = difference_interval((10.0, 9.7, 10.3), (11.0, 10.6, 11.4))
    assert found[:3] == pytest.approx((1.0, 0.5, 1.5), rel=EXACT)
    # 1.96 standard errors are 0.5, so that 1.0 is 3.92 of them
    assert found[3] == pytest.approx(math.erfc(2.0 * 1.959963984540054 / math.sqrt(2.0)), rel=EXACT)


def test_crooked_intervals_are_taken_by_the_side_that_counts() -> None:
    # Zou and Donner: the lower end takes b's lower and a's upper half, the upper end the other two
    _, low, high, _ = difference_interval((1.0, 0.9, 1.4), (2.0, 1.7, 2.1))
    assert low == pytest.approx(1.0 - math.hypot(0.3, 0.4), rel=EXACT)
    assert high == pytest.approx(1.0 + math.hypot(0.1, 0.1), rel=EXACT)


@given(ORDINARY, HALF, HALF, ORDINARY, HALF, HALF)
def test_the_other_way_round_the_signs_change(
    a: float, a_low: float, a_high: float, b: float, b_low: float, b_high: float
) -> None:
    first, second = (a, a - a_low, a + a_high), (b, b - b_low, b + b_high)
    one, other = difference_interval(first, second), difference_interval(second, first)
    assert one[:3] == (-other[0], -other[2], -other[1])
    assert one[3] == other[3]
    assert one[1] <= one[0] <= one[2]
    # outside the interval exactly where it is significant at 95 %
    if abs(one[3] - 0.05) > 1e-9:
        assert (one[3] < 0.05) == (one[1] > 0.0 or one[2] < 0.0)


def test_coverage_of_the_interval_of_a_difference() -> None:
    rng = np.random.default_rng(5)
    runs, hits = 4000, 0
    a, b = rng.normal(1.0, 0.1, runs), rng.normal(1.3, 0.2, runs)
    for x, y in zip(a, b, strict=True):
        _, low, high, _ = difference_interval((x, x - 0.196, x + 0.196), (y, y - 0.392, y + 0.392))
        hits += low <= 0.3 <= high
    share = hits / runs
    assert abs(share - 0.95) < 4.0 * math.sqrt(0.95 * 0.05 / runs)


# --- many answers at once -------------------------------------------------------------------------


def test_of_answers_that_did_not_move_hardly_any_is_called_changed() -> None:
    rng = np.random.default_rng(11)
    families, false = 1000, 0
    for _ in range(families):
        verdicts = judge_together(list(rng.uniform(size=40)))
        false += "changed" in verdicts
    assert false / families < 0.05 + 4.0 * math.sqrt(0.05 * 0.95 / families)


def test_holm_steps_down_and_stops() -> None:
    # 0.05/4, 0.05/3, 0.05/2, 0.05
    assert judge_together([0.012, 0.03, 0.016, 0.9]) == ["changed", "perhaps", "changed", "not seen"]
    assert judge_together([0.013, 0.0166, 0.024, 0.04]) == ["perhaps"] * 4
    assert judge_together([None, 0.04]) == ["not known", "changed"]


# --- folders --------------------------------------------------------------------------------------


def test_what_moved_and_what_did_not(pair: tuple[Path, Path]) -> None:
    compared = compare_folders(*pair)
    found = compared.document()
    by_name = {(c["name"], c["statistic"]): c for c in found["changes"]}
    miss = by_name[("limits.crushing", "probability of missing the aim")]
    assert (miss["difference"], miss["verdict"]) == (pytest.approx(0.0178, rel=1e-9), "changed")
    assert miss["relative"] == pytest.approx(0.0178 / 0.0123, rel=1e-9)
    assert by_name[("p_max", "mean")]["verdict"] == "not seen"
    assert found["limits"] == [
        {
            "limit": "crushing",
            "before": True,
            "after": False,
            "verdict_before": "met",
            "verdict_after": "not met",
            "target_before": 0.02,
            "target_after": 0.02,
        }
    ]
    assert not found["identical"]
    text = comparison_text(compared)
    assert "The verdict on crushing is another one." in text
    assert "NOT MET" in text


def test_a_run_beside_itself(pair: tuple[Path, Path]) -> None:
    found = compare_folders(pair[0], pair[0]).document()
    assert found["identical"]
    assert found["causes"] == []
    assert {c["verdict"] for c in found["changes"]} <= {"not seen", "the same", "not known"}


def test_inputs_that_were_changed_are_named(pair: tuple[Path, Path]) -> None:
    path = pair[1] / "study.resolved.json"
    resolved = json.loads(path.read_text())
    resolved["fixed"]["sphere.density"] = 2700.0
    resolved["random"]["striker.speed"]["given"] = {"mean": 0.6, "cov": 0.02}
    resolved["analysis"]["accuracy"]["mean"] = 0.001
    path.write_text(json.dumps(resolved))
    causes = {c["what"]: (c["before"], c["after"]) for c in compare_folders(*pair).document()["causes"]}
    assert causes["sphere.density"] == ("2650 kg/m3", "2700 kg/m3")
    assert causes["striker.speed"] == ("normal: mean 0.5, cov 0.02 (m/s)", "normal: mean 0.6, cov 0.02 (m/s)")
    assert causes["analysis.accuracy.mean"] == ("0.002", "0.001")


def test_answers_of_one_run_alone_are_named(tmp_path: Path, pair: tuple[Path, Path]) -> None:
    other = write_folder(tmp_path / "other", quantities=("P_max",))
    found = compare_folders(pair[0], other).document()
    assert any("p_max: mean" in text for text in found["only_before"])
    assert any("P_max: mean" in text for text in found["only_after"])
    assert found["limits"] == []


# --- the command and the page ---------------------------------------------------------------------


def page_of(pair: tuple[Path, Path], out: Path, capsys: pytest.CaptureFixture[str]) -> tuple[str, dict[str, Any]]:
    assert main(["compare", str(pair[0]), str(pair[1]), "--out", str(out), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    return Path(document["page"]).read_text(encoding="utf-8"), document


def test_the_page_is_whole_and_fetches_nothing(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text, document = page_of(pair, tmp_path / "page.html", capsys)
    assert document["page"].endswith("page.html")
    assert text.startswith("<!DOCTYPE html>") or "<!DOCTYPE html>" in text[:50]
    assert not re.findall(r"<(?:script|link|iframe|img|object)\b|src=|https?://(?!www\.w3\.org)", text)
    assert text.count("<svg") >= 2
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))
    assert "met → not met" in text


def test_the_page_escapes_what_a_stranger_wrote(
    pair: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("results.json", "study.resolved.json"):
        path = pair[1] / name
        path.write_text(
            path.read_text().replace("crushing", "<b onload=x>\\u001b[31m").replace("A study", "</style><script>")
        )
    before = write_folder(tmp_path / "again", limits={"<b onload=x>\u001b[31m": limit(0.0123, 0.02, True)})
    text, _ = page_of((before, pair[1]), tmp_path / "out", capsys)
    assert "<b onload" not in text
    assert "<script" not in text
    assert "\u001b" not in text
    assert (tmp_path / "out" / "compare.html").is_file()


def test_the_terminal_is_not_steered(pair: tuple[Path, Path], capsys: pytest.CaptureFixture[str]) -> None:
    path = pair[1] / "results.json"
    path.write_text(path.read_text().replace("A study", "\\u001b]0;owned\\u0007\\u009b31m"))
    for more in ([], ["--json"]):
        assert main(["compare", *map(str, pair), *more]) == 0
        captured = capsys.readouterr()
        assert all(c.isprintable() or c == "\n" for c in captured.out)
    assert json.loads(captured.out)["after"]["title"] == "\u001b]0;owned\u0007\u009b31m"

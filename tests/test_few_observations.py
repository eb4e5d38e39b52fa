"""Laws made from a handful of observations: the study warns, and the terminal says what they leave open."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

import uqsphere
from uqsphere.report.terminal import summary_of
from uqsphere.results import Results
from uqsphere.study import load_study
from uqsphere.study.study import Study

STUDY = """
[inputs]
a = { dist = "empirical", file = "tests.csv", column = "a", fit = "normal" }
b = { dist = "normal", mean = 0, sd = 1 }
[outputs]
names = ["y"]
[analysis]
methods = ["qmc"]
budget = { evaluations = 9000 }
accuracy = { mean = 0.1, quantile = 0.5 }
"""


def study_of(folder: Path, count: int) -> Study:
    lines = "\n".join(str(k + 1) for k in range(count))
    (folder / "tests.csv").write_text(f"a\n{lines}\n", "utf-8")
    (folder / "s.toml").write_text(STUDY, "utf-8")
    return load_study(folder / "s.toml")


@pytest.mark.parametrize(("count", "words"), [(2, "cannot be told"), (3, "beside the answers"), (9, "beside the")])
def test_a_handful_of_observations_is_warned_of(count: int, words: str, tmp_path: Path) -> None:
    (warning,) = study_of(tmp_path, count).warnings
    assert warning.startswith(f"inputs.a.file: found {count} observations")
    assert words in warning


def test_ten_observations_are_not(tmp_path: Path) -> None:
    assert study_of(tmp_path, 10).warnings == ()


def ran(folder: Path, count: int) -> tuple[dict[str, Any], str]:
    study = study_of(folder, count)
    results = dict(
        uqsphere.run(study, out=folder / "r", model=lambda rows: {"y": rows["a"] + rows["b"]}).results.document()
    )
    return results, " ".join(summary_of(Results.model_validate(results), 80).split())


def test_two_observations_leave_open_what_cannot_be_told(tmp_path: Path) -> None:
    results, text = ran(tmp_path, 2)
    assert "y: what the tests leave open (a: 2) is not in its intervals: 2 observations do not tell" in text
    assert results["warnings"]


def test_eight_observations_leave_open_what_student_says(tmp_path: Path) -> None:
    results, text = ran(tmp_path, 8)
    assert "y: what the tests leave open (a: 8) puts its mean between" in text
    values = np.arange(1.0, 9.0)
    half = float(stats.t(7).ppf(0.975)) * float(np.std(values, ddof=1)) / 8.0**0.5
    assert results["quantities"]["y"]["ignorance"]["mean"] == pytest.approx([4.5 - half, 4.5 + half], abs=0.2 * half)


def test_four_observations_leave_open_more_than_rows_can_say(tmp_path: Path) -> None:
    """Rows of the fitted law hardly reach the laws at the ends, and would make two thirds of Student's interval."""
    results, text = ran(tmp_path, 4)
    assert "mean" not in results["quantities"]["y"]["ignorance"]
    assert "leave open laws that lie too far from the rows that were sampled" in text

"""Distributions from a CSV of the user's tests: read in SI, and only from the study's own folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from test_broken_studies import BASE

from uqsphere.errors import StudyError
from uqsphere.study import Study, load_study

Load = Callable[..., Study]


@pytest.fixture
def load(tmp_path: Path) -> Load:
    def with_stiffness(new: str) -> Study:
        assert BASE.count(LOGNORMAL) == 1
        (tmp_path / "study.toml").write_text(BASE.replace(LOGNORMAL, new))
        return load_study(tmp_path / "study.toml")

    return with_stiffness


EMPIRICAL = 'E = { dist = "empirical", file = "tests.csv", column = "E", unit = "GPa", fit = "steps" }'
LOGNORMAL = 'E = { dist = "lognormal", mean = "52 GPa", cov = 0.12 }'


def test_empirical_law_from_a_csv(load: Load, tmp_path: Path) -> None:
    (tmp_path / "tests.csv").write_bytes("\ufeffE , name\r\n50, a\r\n\r\n54,b\r\n58.5,c\r\n".encode())
    law = load(EMPIRICAL).random["sphere.E"]
    assert law.data == pytest.approx((50e9, 54e9, 58.5e9), rel=1e-12)
    (tmp_path / "sub").mkdir()
    (tmp_path / "tests.csv").rename(tmp_path / "sub" / "t.csv")
    (tmp_path / "tests.csv").symlink_to(tmp_path / "sub" / "t.csv")
    fitted = EMPIRICAL.replace('fit = "steps"', 'fit = "lognormal"')
    assert load(fitted).random["sphere.E"].family.name == "lognormal"


@pytest.mark.parametrize(
    ("change", "csv", "says"),
    [
        (('"tests.csv"', '"/etc/passwd"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"../tests.csv"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"C:\\\\tests.csv"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"https://example.org/t.csv"'), "E\n1\n2\n", "own folder only"),
        (('"tests.csv"', '"link.csv"'), "E\n1\n2\n", "leaves the study's folder"),
        (('"tests.csv"', '"test.csv"'), "E\n1\n2\n", "did you mean 'tests.csv'"),
        (('"tests.csv"', '"."'), "E\n1\n2\n", "cannot be read as a file"),
        (('"tests.csv"', "3"), "E\n1\n2\n", "found 3, where a text in quotes is due"),
        (("", ""), "F,e\n1,2\n2,3\n", "column \"E\" is not in"),
        (("", ""), "E,E\n1,2\n2,3\n", "twice or more"),
        (("", ""), "E\n1\nx\n", "line 3 .*: found \"x\""),
        (("", ""), "E\n1\ninf\n", "finite number is due"),
        (("", ""), "E,F\n1,2\n,3\n", "finite number is due"),
        (("", ""), "E\n1\n", "found 1 value"),
        (("", ""), "E\n1\n1\n", "no scatter|scatter"),
        (("", ""), "", "is empty"),
        (("", ""), "E\n" + "1\n2\n" * 300_000, "larger than 1 MiB"),
        (("", ""), b"E\n\xff\n", "not UTF-8"),
        ((', unit = "GPa"', ""), "E\n1\n2\n", "unit of the column is missing"),
        (('"GPa"', '"mm"'), "E\n1\n2\n", "sphere.E.unit: found \"mm\""),
        (('"steps"', '"stepps"'), "E\n1\n2\n", "sphere.E.fit"),
        (('"steps"', "3"), "E\n1\n2\n", "sphere.E.fit"),
        ((', column = "E"', ""), "E\n1\n2\n", "column is missing"),
        ((', column = "E"', ', column = "E", mean = "5 GPa"'), "E\n1\n2\n", "sphere.E.mean"),
    ],
)  # fmt: skip
def test_empirical_law_refused(
    load: Load, tmp_path: Path, change: tuple[str, str], csv: str | bytes, says: str
) -> None:
    (tmp_path / "tests.csv").write_bytes(csv if isinstance(csv, bytes) else csv.encode())
    outside = tmp_path.parent / f"{tmp_path.name}-outside.csv"
    outside.write_text("E\n1\n2\n")
    (tmp_path / "link.csv").symlink_to(outside)
    with pytest.raises(StudyError, match=says) as caught:
        load(EMPIRICAL.replace(*change) if change[0] else EMPIRICAL)
    assert len(caught.value.problems) == 1

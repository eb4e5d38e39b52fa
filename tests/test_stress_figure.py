"""The picture of the stress inside the sphere."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from uqsphere import history, load_study
from uqsphere.mechanics.stress.tables import core_ratio
from uqsphere.report.figures.history import write_history
from uqsphere.report.figures.scene import stress_figure, stress_picture
from uqsphere.study import shipped_studies


def test_it_says_what_the_table_says() -> None:
    picture = stress_picture(0.1, 0.25, 2.5e9)
    assert f"{float(core_ratio(0.1, 0.25)[0]) * 2500:.1f} MPa" in picture.finding
    axes = picture.figure.axes[0]
    mark = next(line for line in axes.lines if line.get_marker() == "o")
    assert mark.get_ydata()[0] == pytest.approx(1.0 - float(core_ratio(0.1, 0.25)[1]))


def test_it_is_the_same_file_twice_and_well_formed() -> None:
    first = stress_figure(0.2, 0.2, 1e9)
    assert first == stress_figure(0.2, 0.2, 1e9)
    assert ElementTree.fromstring(first).tag.endswith("svg")
    assert "nan" not in first


@pytest.mark.parametrize(("ratio", "nu"), [(0.4, 0.2), (0.001, 0.2), (0.1, -0.1)])
def test_outside_the_tables_there_is_none(ratio: float, nu: float) -> None:
    with pytest.raises(ValueError, match="outside the tables"):
        stress_picture(ratio, nu, 1e9)


def test_a_history_brings_it_along(tmp_path: Path) -> None:
    study = load_study(shipped_studies()["granite"])
    found = history(study)
    written = {path.name for path in write_history(found, study, tmp_path)}
    assert "stress.svg" in written
    largest = max(found.pressure_a.max(), found.pressure_b.max())
    assert f"{np.format_float_positional(largest / 1e9, 3, fractional=False, trim='-')} GPa" in (
        tmp_path / "stress.svg"
    ).read_text(encoding="utf-8")

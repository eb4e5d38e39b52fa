"""Sentences and digits of a report that must be true of its run: drivers, ways to fail, interactions."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from report_folders import limit, write_folder

from uqsphere.report.contents import Contents, read_contents
from uqsphere.report.drivers import design_table
from uqsphere.report.figures.canvas import new_figure
from uqsphere.report.figures.swings import Swing, _swing_bar


def with_limit(folder: Path, **more: Any) -> Contents:
    """The contents of a folder with one limit that has these entries too."""
    return read_contents(write_folder(folder, limits={"x": {**limit(0.0075, 0.01, True), **more}}))


@pytest.mark.parametrize(("share", "text"), [(0.9979, "99.8 %"), (0.99993, "99.99 %"), (0.98, "98 %"), (1.0, "100 %")])
def test_an_importance_factor_is_no_power_of_ten(tmp_path: Path, share: float, text: str) -> None:
    contents = with_limit(
        tmp_path,
        design_point={"sphere.E": 5e10},
        governing_inputs={"sphere.E": share, "limits.x.strength": 1.0 - share},
    )
    table = design_table(contents, "x")
    assert table is not None
    assert table.rows[0][3] == text


@pytest.mark.parametrize(("low", "boxes"), [(1.1, 2), (4.5, 0)])
def test_a_number_on_a_bar_can_be_read(low: float, boxes: int) -> None:
    """Where both ends of an input lie below the middle, the nearer number stands on the longer bar."""
    swing = Swing(name="b", below=0.8, above=1.2, at_low=(low, low, low), at_high=(2.97, 2.9, 3.0))
    figure, (axes,) = new_figure(2.0)
    _swing_bar(axes, 0, swing, 3.3, "y")
    assert sum(text.get_bbox_patch() is not None for text in axes.texts) == boxes
    figure.clear()

"""The same study into the same folder: it is taken again; another one is refused, and what differs
is named.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import pytest

import uqsphere
from uqsphere import Study
from uqsphere.errors import FolderError
from uqsphere.report import summary

LOOSE = "analysis.accuracy={ mean = 1, quantile = 1, sobol = 1, probability = 1 }"
#: evaluations, 1000 of others: one black box is answered by expansions of as many rows, the other
#: by its rows
FEW = {"blackbox": 400, "ishigami": 5000}
SHIPPED = sorted(
    path for path in Path("studies").glob("*.toml") if not path.name.startswith("lab_")
)
MODELS = {"blackbox": "studies/blackbox.py:model", "ishigami": "studies/ishigami.py:ishigami"}


@pytest.mark.slow
@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_every_shipped_study_runs_again_into_its_folder_and_once_more_after_an_interruption(
    path, tmp_path
):
    budget = f"analysis.budget.evaluations={FEW.get(path.stem, 1000)}"
    study = uqsphere.load_study(path, (LOOSE, budget))
    model = MODELS.get(path.stem)
    first = uqsphere.run(study, model, out=tmp_path)
    asked = []
    # rows of a scene are asked for in one piece or two
    pieces = 3 if model else 0

    def interrupted() -> bool:
        asked.append(1)
        return len(asked) > pieces

    with contextlib.suppress(KeyboardInterrupt):  # where there is nothing to answer with yet
        uqsphere.run(study, model, out=tmp_path, stop=interrupted)
    assert len(asked) > pieces
    again = uqsphere.run(study, model, out=tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    log = (tmp_path / "log.txt").read_text(encoding="utf-8")
    assert first.results.study.hash == again.results.study.hash == study.hash
    assert study.hash[:12] in page
    assert log.count(study.hash) == 3
    assert again.answers["value"].equals(first.answers["value"])
    assert summary(again.results)


BOX = {"inputs": {"a": {"dist": "normal", "mean": 1.0, "sd": 0.1}, "b": 2.0}, "outputs": "y"}
HIGH = {"high": {"quantity": "y", "strength": 5.0, "aim": "survive", "target": 0.1}}


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"inputs": {**BOX["inputs"], "b": 3.0}}, "changed: b"),
        (
            {"inputs": {**BOX["inputs"], "a": {"dist": "normal", "mean": 1.0, "sd": 0.2}}},
            "changed: a",
        ),
        ({"limits": {"high": {**HIGH["high"], "target": 0.2}}}, "changed: limits.high.target"),
        ({"seed": 7}, "changed: seed"),
        ({"analysis": {"accuracy": {"mean": 0.01}}}, "changed: analysis.accuracy"),
    ],
)
def test_a_changed_study_is_refused_and_names_what_changed(changes, named, tmp_path):
    def model(x):
        return {"y": x["a"] * x["b"]}

    uqsphere.run(Study(**BOX, limits=HIGH), model, out=tmp_path)
    with pytest.raises(FolderError, match=named):
        uqsphere.run(Study(**{**BOX, "limits": HIGH, **changes}), model, out=tmp_path)
    uqsphere.run(Study(**BOX, limits=HIGH), model, out=tmp_path)

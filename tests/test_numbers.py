"""The answers of three studies at smoke size are the ones they were, to 1e-9.

Where a change is meant to move them: `python .ci/same_numbers.py . --round tests/data/numbers.json`.
"""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

import pytest

import uqsphere

sys.path.insert(0, str(Path(__file__).parent.parent / ".ci"))
from same_numbers import CASES, ROOT, ROUNDED, rounded

KEPT = json.loads((Path(__file__).parent / "data" / "numbers.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("case", [case for case in CASES if case.name in ROUNDED], ids=lambda case: case.name)
def test_answers_are_those_that_were(case, tmp_path: Path) -> None:
    study = uqsphere.load_study(ROOT / case.study, case.settings)
    model = case.model and str(ROOT / case.model)
    run = uqsphere.run(study, out=tmp_path / "r", model=model, threads=1)
    results = json.loads((run.folder / "results.json").read_text(encoding="utf-8"))
    for part, kept in KEPT[case.name].items():
        found = dict(rounded(results[part]))
        assert found.keys() == kept.keys(), part
        moved = {path: (kept[path], value) for path, value in found.items()
                 if not math.isclose(value, kept[path], rel_tol=1e-9, abs_tol=1e-12)}  # fmt: skip
        assert not moved, f"{part}: {len(moved)} numbers moved"

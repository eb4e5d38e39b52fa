"""Rigs and failure modes are declared once: a new entry works in a whole run, with its page."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from uqsphere.mechanics.failure_modes import FAILURE_MODES, FailureMode, modes_by_place
from uqsphere.mechanics.rigs import RIGS

PACKAGE = Path(__file__).parents[2] / "uqsphere"

#: a rig is added before anything else of the package is read, as an entry in the file would be
NEW_RIG = """
from dataclasses import replace
from uqsphere.mechanics import rigs

old = rigs.RIGS["load_cell"]
rigs.RIGS["bench"] = replace(old, name="bench", title="on a bench")

import uqsphere
study = uqsphere.load_study({study!r}, ["analysis.budget.evaluations=1024", "rig.kind=bench"])
uqsphere.run(study, out={out!r})
"""


def test_a_new_rig_is_one_entry(tmp_path: Path) -> None:
    study = str(PACKAGE.parent / "studies" / "quartz_load_cell.toml")
    program = NEW_RIG.format(study=study, out=str(tmp_path / "run"))
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr[-2000:]
    results = json.loads((tmp_path / "run" / "results.json").read_text(encoding="utf-8"))
    assert results["study"]["kind"] == "bench"
    page = next((tmp_path / "run").glob("*.html")).read_text(encoding="utf-8")
    assert "on a bench" in page


def test_a_new_failure_mode_is_one_entry(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import uqsphere

    mode = FailureMode(
        place="below",
        name="subsurface crushing",
        gloss="rock is crushed below a contact",
        criterion="subsurface_shear",
        strength="contact_strength",
    )
    monkeypatch.setitem(FAILURE_MODES, "below", mode)
    path = PACKAGE.parent / "studies" / "granite.toml"
    study = uqsphere.load_study(path, ["analysis.budget.evaluations=1024"])
    uqsphere.run(study, out=tmp_path / "run")
    results = json.loads((tmp_path / "run" / "results.json").read_text(encoding="utf-8"))
    assert results["study"]["modes"]["subsurface crushing"]["mode"] == "subsurface crushing"
    page = next((tmp_path / "run").glob("*.html")).read_text(encoding="utf-8")
    assert "subsurface crushing" in page


def test_no_file_compares_a_rig_with_a_quoted_name() -> None:
    """Names of rigs stand in `rigs.toml`; elsewhere a rig is asked what it is."""
    quoted = re.compile(rf'\brig\b[^\n"]{{0,12}}"({"|".join(RIGS)})"')
    places = [
        f"{path.relative_to(PACKAGE)}: {line.strip()}"
        for path in PACKAGE.rglob("*.py")
        if "labs" not in path.parts and "integrator" not in path.parts
        for line in path.read_text(encoding="utf-8").splitlines()
        if quoted.search(line)
    ]
    assert places == []


def test_two_failure_modes_at_one_place_are_refused() -> None:
    crushing = FAILURE_MODES["contact"]
    with pytest.raises(ValueError, match="at 'contact': contact crushing and spalling"):
        modes_by_place([crushing, replace(crushing, name="spalling")])

"""The shipped studies, each run at smoke size to its report: sane numbers, and those that are known."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest

import uqsphere
from tests.campaigns.pages import hard_sentences, plain, printed, read, words
from uqsphere.report import build_report
from uqsphere.report.brief import LINES, make_brief, summary_of
from uqsphere.report.compare import compare_folders
from uqsphere.report.contents import read_contents
from uqsphere.report.page import build_brief, on_one_sheet, typeset
from uqsphere.report.phrases import loud, short_share
from uqsphere.runner.questions import indices

STUDIES = Path(uqsphere.__file__).parent.parent / "studies"
SMOKE = (
    "analysis.accuracy={mean=0.5, quantile=0.9, sobol=0.9, probability=0.9}", 'analysis.methods=["pce"]',
    "analysis.budget.evaluations=8_000", "analysis.quantiles=[0.05, 0.5, 0.95]",
)  # fmt: skip
ROUGH = ("model.tolerance=1e-3",)

#: study -> overrides, range of the mean of its first quantity (SI)
CASES: dict[str, tuple[tuple[str, ...], tuple[float, float]]] = {
    "granite": (ROUGH, (2.74e9, 2.80e9)),
    "limestone_ball_slow": (ROUGH, (1.2e9, 1.4e9)),
    "glass_bead_small_bar": (ROUGH, (2.4e9, 3.0e9)),
    "granite_force": ((*ROUGH, "analysis.fields={ force_a=24, force_b=24 }"), (5.4e3, 5.5e3)),
    "granite_three_ways": (ROUGH, (2.74e9, 2.80e9)),
    "limestone_three_ways": (ROUGH, (0.9e9, 2.0e9)),
    "as_printed": (ROUGH, (3.2e9, 3.9e9)),
    "blackbox": ((), (6.3e-3, 6.4e-3)),
    "ishigami": ((), (3.4, 3.6)),
    "gauge_records": (ROUGH, (2.2e9, 2.5e9)),
    "limestone_margin": (ROUGH, (1.2e7, 1.4e7)),
    "granite_10mm_test": (ROUGH, (1.0e4, 1.3e4)),
    "limestone_chute_rotor": ((), (1.6e7, 1.7e7)),
    "limestone_feed": (ROUGH, (6.2e9, 7.0e9)),
    "limestone_drop_weight": (ROUGH, (2.2e9, 2.6e9)),
    "quartz_load_cell": (ROUGH, (98.0, 108.0)),
}

#: studies whose limits are to be exceeded
MEANT = ("glass_bead_small_bar", "granite_10mm_test", "quartz_load_cell")
#: studies whose page is counted on paper too
PRINTED = ("granite", "limestone_chute_rotor")


def small_run(name: str, folder: Path) -> dict[str, Any]:
    overrides, _ = CASES[name]
    study = uqsphere.load_study(STUDIES / f"{name}.toml", [*SMOKE, *overrides])
    model = f"{STUDIES / name}.py:{'model' if name == 'blackbox' else name}" if study.black_box else None
    run = uqsphere.run(study, out=folder, model=model)
    assert build_report(run.folder).stat().st_size < 1_000_000
    agree(run.folder, name)
    # where services alone are run, the first of them
    return next(iter(run.results.parts.values())).document()


def squeezed(text: str) -> str:
    return re.sub(r"\W", "", text)


def agree(folder: Path, name: str) -> None:
    """Page, brief, terminal, comparison and paper say the same in value, sense and wording: they show one `Brief`."""
    contents = read_contents(folder)
    found, told = make_brief(contents), summary_of(contents, 80)
    sheet = build_brief(folder).read_text("utf-8")
    claimed = [answer.question for answer in found.answers] + [answer.big for answer in found.answers]
    claimed += [f"{a.second[0]} {a.second[1]}" for a in found.answers if a.second]
    claimed += [mode.name for mode in found.modes] + list(found.measure or ())
    rows = [
        (mode.name, short_share(mode.miss, a.target))
        for a in found.answers
        for mode in a.modes
        if mode.miss is not None
    ]
    page = folder / "report.html"
    texts = {"brief": read(sheet), "terminal": told, "page": read(page.read_text("utf-8"))}
    document, zoom = on_one_sheet(sheet)
    texts["paper"] = printed(document)
    for where, text in texts.items():
        for claim in claimed:
            assert squeezed(claim) in squeezed(text), (name, where, claim)
        for way, chance in rows:
            # a way has its own share beside it, here as everywhere
            assert re.search(rf"{re.escape(way)}†?\W*?(?:0\.1 1 10 %)?\W*{re.escape(plain(chance))}", plain(text)), (
                name, where, way, chance)  # fmt: skip
    for text in (texts["brief"], texts["page"]):
        for caution in found.first_cautions:
            assert squeezed(caution) in squeezed(text), (name, caution)
    # the verdict is that of results.json, on the light as in the terminal and the comparison
    for answer in found.answers:
        if answer.verdict:
            assert f"verdict: {loud(answer.verdict)}" in told
            assert f'class="light" role="img" aria-label="Verdict: {answer.verdict}' in sheet
    part = next(iter(contents.services.values()), contents)
    kept = {limit: entry.word for limit, entry in part.results.limits.items()}
    side = compare_folders(folder, folder)
    side = next(iter(side.services.values()), side)
    assert {one.limit: one.verdict_after for one in side.limits} == kept
    assert not (hard := hard_sentences(page.read_text("utf-8"))), (name, hard)
    assert len(told.split("\n")) <= LINES
    assert words(texts["brief"]) <= 180, texts["brief"]
    assert "<script" not in sheet
    assert "http" not in sheet.replace("http-equiv", "")
    assert len(document.pages) == 1, name
    assert zoom > 0.8, (name, zoom)
    if name in PRINTED:
        whole = typeset(page.read_text("utf-8"))
        assert len(whole.pages) <= 6
        assert words(printed(whole)) <= 1800


def test_every_shipped_study_is_tried() -> None:
    assert {path.stem for path in STUDIES.glob("*.toml")} == set(CASES)


@pytest.mark.parametrize("name", CASES)
def test_a_shipped_study_is_answered(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # the fewest designs whose expansions tell how far they are off
    monkeypatch.setattr(indices, "FITS", 4)
    found = small_run(name, tmp_path / "r")
    numbers_are_sane(name, found)
    indices_share_out_the_variance(found)
    for own, limit in found["limits"].items():
        assert limit["aim"] == ("break" if name in MEANT or own == "crushed" else "survive")
        if limit["aim"] == "break":
            assert limit["miss"]["value"] == pytest.approx(1.0 - limit["exceedance"]["value"], rel=1e-9)
    # the paper stands beside the corrected model
    rows = found["paper"]
    assert bool(rows) == (name == "as_printed")
    assert not rows or {"as_printed", "corrected", "full"} <= set(rows[0])
    assert not rows or any(row["as_printed"] != row["corrected"] for row in rows)


def numbers_are_sane(name: str, found: dict[str, Any]) -> None:
    first = next(iter(found["quantities"].values()))
    low, high = CASES[name][1]
    assert low < first["mean"]["value"] < high
    for entry in found["quantities"].values():
        values = [e["value"] for e in entry["quantiles"].values() if e["value"] is not None]
        assert values == sorted(values)
        assert entry["sd"]["value"] > 0.0
        assert 0.0 <= entry["censored_share"]["value"] <= 1.0
    for limit in found["limits"].values():
        for which in ("exceedance", "miss"):
            assert 0.0 <= limit[which]["low"] <= limit[which]["value"] <= limit[which]["high"] <= 1.0
        shares = limit["governing_inputs"]
        assert shares is None or sum(shares.values()) == pytest.approx(1.0)
    for margin in found["margins"].values():
        assert all(0.0 <= low <= p <= high <= 1.0 for _, p, low, high in margin["curve"])
    assert all(0.0 <= check["share"] <= 1.0 for check in found["validity"])
    assert found["model"]["failures"] == 0
    json.dumps(found, allow_nan=False)


def indices_share_out_the_variance(found: dict[str, Any]) -> None:
    for entry in found["sensitivity"].values():
        first = [e for e in entry["first"].values() if e["value"] is not None]
        total = [e for e in entry["total"].values() if e["value"] is not None]
        if not first:
            assert all(e["reason"] for e in entry["first"].values())
            continue
        slack = 4.0 * sum(e["std_error"] for e in (*first, *total))
        assert sum(e["value"] for e in first) <= 1.0 + slack
        assert sum(e["value"] for e in total) >= 1.0 - slack
        assert all(a["value"] <= b["value"] + slack for a, b in zip(first, total, strict=True))

"""The what-if panel: what it carries, that its script agrees with a run, and that it answers in a real browser."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_folders import limit, write_folder
from test_browser import BROWSER
from test_report import Reader

import uqsphere
from tests.campaigns.panel import NODE, Setting, agrees, ask, compare, panel_of
from uqsphere.report import build_report
from uqsphere.report.contents import read_contents
from uqsphere.report.whatif import _law, panels
from uqsphere.results.entries import SurfaceEntry
from uqsphere.runner import sliders
from uqsphere.study.study import ways_of
from uqsphere.uq.law import make_law

STUDY = Path("studies/granite.toml")


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small run with a strength that depends on an input, and with rows around it."""
    place = tmp_path_factory.mktemp("panel")
    study = uqsphere.load_study(STUDY, ("margins.for_probability=[0.01]", "limits.crushing.fracture=false"))
    study = replace(study, analysis=replace(study.analysis, budget=replace(study.analysis.budget, evaluations=20_000)))
    return uqsphere.run(study, out=place / "run").folder


def test_the_policy_knows_the_script_and_nothing_of_it_asks_the_net(tmp_path: Path) -> None:
    folder = write_folder(tmp_path, limits={"x": limit(0.01, 0.02, True)})
    reader = Reader(build_report(folder).read_text(encoding="utf-8"))
    data, script = reader.scripts
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = next(a["content"] for t, a in reader.tags if t == "meta" and a.get("http-equiv"))
    assert policy == f"default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{digest}'"
    assert json.loads(data)["limits"]
    assert not re.search(r"fetch|XMLHttp|WebSocket|import|eval\b|Function\(|document\.write|https?:", script)


@pytest.mark.skipif(not NODE, reason="no node on this machine")
def test_settings_agree_with_full_runs(run_folder: Path, tmp_path: Path) -> None:
    data = panel_of(run_folder)
    assert data["absent"] == ""
    base = ask(data, [Setting(strength={}, at={}), Setting(strength={}, at={"sphere.radius": 0.02})])
    known = read_contents(run_folder).results.limits["crushing"].miss
    assert (base[0]["value"], base[0]["low"]) == pytest.approx((known.value, known.low), rel=1e-6)
    assert base[1] is None
    settings = [
        Setting(strength={"mean": 4.3e9, "scatter": 10.0, "spearman": 0.2}, at={}),
        Setting(strength={"scatter": 14.0}, at={"sphere.radius": 0.0085, "bars.diameter": 0.036}),
    ]
    rows = compare(STUDY, data, settings, tmp_path, 8000)
    assert [found["kind"] for _, found, _ in rows] == ["exact", "estimate"]
    assert all(agrees(found, run) for _, found, run in rows)
    # what another setting answers is no agreement
    assert not agrees(rows[0][1], rows[1][2])


def test_surfaces_are_their_polynomial_and_sliders_move_the_laws() -> None:
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (400, 2))
    logs = 1.0 + 0.5 * points[:, 0] - 0.3 * points[:, 0] * points[:, 1] + 0.2 * points[:, 1] ** 2
    found = sliders._surface(points, np.exp(logs), np.ones(400, dtype=bool))
    assert isinstance(found, SurfaceEntry)
    terms = zip(found.powers, found.coefficients, strict=True)
    assert sum(c * (points**powers).prod(axis=1) for powers, c in terms) == pytest.approx(logs, abs=1e-6)
    study = uqsphere.load_study(STUDY, ["sphere.E={ dist = 'lognormal', mean = '52 GPa', cov = 0.12 }"])
    stiff = sliders._slider(study, "sphere.E", 52e9, (40e9, 60e9))
    size = sliders._slider(study, "sphere.radius", 0.01, (0.008, 0.013))
    assert stiff is not None
    assert size is not None
    assert stiff.spreads == pytest.approx([np.sqrt(np.log1p(0.12**2))] * len(stiff.nodes))
    ways = ways_of(study).assumed
    told = sliders._ways(study, ways, [size], {way.limit.quantity: found for way in ways})
    # a larger sphere is weaker
    assert all(np.all(np.diff(way.scales["sphere.radius"]) < 0.0) for way in told.values() if way.scales)
    assert any(way.scales for way in told.values())


@pytest.mark.skipif(not NODE, reason="no node on this machine")
@pytest.mark.parametrize("dist", ["weibull", "lognormal", "normal"])
def test_other_laws_are_asked_as_the_run_asks_them(run_folder: Path, dist: str) -> None:
    data = panel_of(run_folder)
    law = make_law(dist, {"mean": 4e9, **({"modulus": 12.0} if dist == "weibull" else {"cov": 0.1})})
    contents = read_contents(run_folder)
    demands = contents.samples[data["limits"][0]["quantity"]].values
    data["limits"][0]["law"] = _law(law, np.log(demands))
    data["limits"][0]["tie"]["spearman"] = 0.0
    data["limits"][0]["miss"] = [float(np.mean(law.cdf(demands)))] * 3
    found = ask(data, [Setting(strength={"mean": 4.4e9, **({"scatter": 9.0} if dist == "weibull" else {})}, at={})])[0]
    given = {"mean": 4.4e9, "modulus": 9.0} if dist == "weibull" else {"mean": 4.4e9, "cov": 0.1}
    assert found["value"] == pytest.approx(float(np.mean(make_law(dist, given).cdf(demands))), rel=2e-3)


def test_a_panel_that_cannot_be_says_why(run_folder: Path) -> None:
    contents = read_contents(run_folder)
    known = contents.results.limits["crushing"]
    off = known.model_copy(update={"miss": known.miss.model_copy(update={"value": 0.5, "low": 0.49, "high": 0.51})})
    results = contents.results.model_copy(update={"limits": {"crushing": off}})
    found = panels(replace(contents, results=results))[0]
    assert (found.data, found.reason) == ("", "its rows do not tell the answer of the run")
    older = json.loads(panels(replace(contents, sliders=None))[0].data)
    assert older["sliders"] == []
    assert "older" in older["absent"]


_DRIVE = """<script>(() => {
  const ranges = [...document.querySelectorAll('.whatif input[type=range]')];
  const shown = () => document.querySelector('.whatif .big').textContent;
  const before = shown(), [panel] = uqsphereWhatIf.panels;
  const speed = ranges.find(r => r.id.includes('speed'));
  for (let k = 0; k < 200; k++) {
    speed.value = 350 + k;
    speed.dispatchEvent(new Event('input'));
    panel.update();
  }
  const after = shown();
  speed.value = 1000;
  speed.dispatchEvent(new Event('input'));
  panel.update();
  const end = document.createElement('pre');
  end.id = 'found';
  const panel_ = document.querySelector('.whatif'), command = panel_.querySelector('pre').textContent;
  end.textContent = JSON.stringify({ before, after, grey: shown(), hidden: panel_.hidden, command });
  document.body.append(end);
})()</script></body>"""


@pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")
def test_the_panel_answers_in_a_browser(run_folder: Path, tmp_path: Path) -> None:
    page = build_report(run_folder).read_text(encoding="utf-8")
    found = drive(page, tmp_path)
    assert not found["hidden"]
    assert found["before"].replace("\xa0", " ") == "0.20 %"
    assert found["after"] != found["before"]
    assert found["grey"] == "no answer"
    assert re.search(r"--set 'striker\.speed\.mean=\"[\d.]+ m/s\"'", found["command"])


def drive(page: str, place: Path) -> dict[str, Any]:
    """What the panel of a page shows while its speed is moved; its policy would let no other script run."""
    file = place / "driven.html"
    text = re.sub(r'<meta http-equiv="Content-Security-Policy"[^>]*>', "", page)
    file.write_text(text.replace("</body>", _DRIVE), encoding="utf-8")
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", "--timeout=20000"]
    done = subprocess.run([*command, f"--user-data-dir={place / 'profile'}", file.as_uri()], capture_output=True,
                          text=True, timeout=300, check=False)  # fmt: skip
    result = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert result, done.stderr[-2000:]
    found: dict[str, Any] = json.loads(html.unescape(result[1]))
    return found

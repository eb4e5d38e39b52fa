"""The pages under axe-core: no violation; skipped where no package brings the rules, or there is no Chromium.

Any package that holds `axe.min.js` will do: `pip install --no-deps axe-playwright-python`, which is not imported.
"""

from __future__ import annotations

import html
import json
import re
import subprocess
from importlib.util import find_spec
from pathlib import Path

import pytest
from report_folders import limit, with_pairs, write_folder
from test_browser import BROWSER

from uqsphere.report import build_report
from uqsphere.report.compare import compare_folders, write_page

_POLICY = re.compile(r'<meta http-equiv="Content-Security-Policy"[^>]*>')
_RUN = (
    "<script>{rules}</script><script>axe.run(document, {{resultTypes: ['violations']}}).then(found => {{"
    "document.body.textContent = ''; const end = document.createElement('pre'); end.id = 'found';"
    "end.textContent = JSON.stringify([found.passes.length, found.violations.map(v => [v.id, v.help,"
    "v.nodes.map(n => n.html.slice(0, 120))])]); document.body.append(end); }})</script></body>"
)


def rules() -> str:
    for package in ("axe_playwright_python", "axe_core_python"):
        found = find_spec(package)
        for place in (found.submodule_search_locations or []) if found else []:
            if (Path(place) / "axe.min.js").is_file():
                return (Path(place) / "axe.min.js").read_text(encoding="utf-8")
    return ""


def violations(page: str, place: Path, *, dark: bool) -> list[object]:
    # the page's own policy lets no script run: this copy has none
    text = _POLICY.sub("", page).replace("</body>", _RUN.format(rules=rules().replace("</script", "<\\/script")))
    file = place / "axe.html"
    file.write_text(text, encoding="utf-8")
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", "--virtual-time-budget=60000"]
    command += [f"--user-data-dir={place / 'profile'}", f"--blink-settings=preferredColorScheme={0 if dark else 1}"]
    done = subprocess.run([*command, file.as_uri()], capture_output=True, text=True, timeout=300, check=False)
    result = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert result, done.stderr[-2000:]
    passed, found = json.loads(html.unescape(result[1]))
    assert passed > 20
    return list(found)


@pytest.mark.skipif(not BROWSER or not rules(), reason="no Chromium, or no package with axe.min.js")
def test_no_page_violates_a_rule(tmp_path: Path) -> None:
    folders = [
        with_pairs(write_folder(tmp_path / name, limits={"crushing": limit(miss, 0.01, True)}))
        for name, miss in (("one", 0.0075), ("two", 0.0035))
    ]
    report = build_report(folders[0]).read_text(encoding="utf-8")
    compared = write_page(*folders, compare_folders(*folders), tmp_path / "compare.html").read_text(encoding="utf-8")
    for page in (report, compared):
        assert violations(page, tmp_path, dark=False) == []
    assert violations(report, tmp_path, dark=True) == []
    assert violations(report.replace('<html lang="en">', "<html>"), tmp_path, dark=False) != []

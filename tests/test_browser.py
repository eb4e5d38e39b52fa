"""The page in a real browser: widths from a telephone to a desk, light and dark; skipped where there is no Chromium."""

from __future__ import annotations

import base64
import html
import json
import re
import shutil
import subprocess
import warnings
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
from report_folders import html_errors, limit, with_pairs, write_folder

from uqsphere.report import build_report
from uqsphere.report.compare import compare_folders, write_page
from uqsphere.report.page import build_brief

BROWSER = next((path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), "")
LONG = "Schwingungsdämpferhalterungsverschraubungsvorspannkraft"
#: a frame of each width holds the untouched page, so that its own policy is in force
WIDTHS = (320, 768, 1280)
#: contrast of WCAG 2.2, level AA, for body texts; large texts need 3
LEAST_CONTRAST = 4.5

PROBE = """
<!DOCTYPE html><meta charset="utf-8"><title>probe</title><body><script>
const widths = %WIDTHS%, source = %PAGE%;
const found = {};
function colour(text) {
  const parts = text.match(/[\\d.]+/g).map(Number);
  return [parts[0], parts[1], parts[2], parts.length > 3 ? parts[3] : 1];
}
function light([r, g, b]) {
  const f = c => (c /= 255) <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  return 0.2126 * f(r) + 0.7152 * f(g) + 0.0722 * f(b);
}
function behind(element, view) {
  for (let e = element; e; e = e.parentElement) {
    const c = colour(view.getComputedStyle(e).backgroundColor);
    if (c[3] > 0.99) return c;
  }
  return [255, 255, 255, 1];
}
function own(element) {
  return [...element.childNodes].filter(n => n.nodeType === 3).map(n => n.data.trim()).join(' ').trim();
}
function probe(frame) {
  const page = frame.contentDocument, view = frame.contentWindow, all = [...page.body.querySelectorAll('*')];
  const out = { wide: page.documentElement.scrollWidth, loaded: view.performance.getEntriesByType('resource').length,
    spilled: [], dim: [], lost: [], mute: [], unnamed: [], headings: [], twice: [], stacked: [], dark:
    view.matchMedia('(prefers-color-scheme: dark)').matches };
  const ids = new Map();
  for (const e of page.querySelectorAll('[id]')) ids.set(e.id, (ids.get(e.id) || 0) + 1);
  out.twice = [...ids].filter(([, n]) => n > 1).map(([id]) => id);
  for (const e of all) {
    const svg = e.namespaceURI.includes('svg'), text = own(e);
    if (e.closest('.hidden, .skip') || (svg && e.tagName !== 'svg')) continue;
    if (text) {
      const style = view.getComputedStyle(e), a = light(colour(style.color)), b = light(behind(e, view));
      const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
      if (contrast < %CONTRAST%) out.dim.push([text.slice(0, 40), contrast]);
      const box = e.getBoundingClientRect(), range = page.createRange();
      for (const node of e.childNodes) {
        if (node.nodeType !== 3 || !node.data.trim()) continue;
        range.selectNodeContents(node);
        const ink = range.getBoundingClientRect();
        if (ink.right > box.right + 1.5) out.spilled.push(text.slice(0, 60));
        if (!e.closest('.scroll, .drawing') && ink.right > page.documentElement.clientWidth + 1)
          out.spilled.push('beyond the page: ' + text.slice(0, 60));
      }
    }
  }
  for (const a of page.querySelectorAll('a'))
    if (!a.getAttribute('href').startsWith('#') || !page.getElementById(a.getAttribute('href').slice(1)))
      out.lost.push(a.getAttribute('href'));
  for (const s of page.querySelectorAll('svg, img')) {
    if (s.getAttribute('aria-hidden') === 'true') continue;
    const ids = (s.getAttribute('aria-labelledby') || '').split(' ');
    const words = ids.map(id => page.getElementById(id)?.textContent || '');
    if (s.getAttribute('role') !== 'img' || words.length < 1 || words.some(w => w.length < 4)) out.mute.push(s.id);
  }
  for (const e of page.querySelectorAll('[tabindex], nav, section, [role=region], [role=group]'))
    if (!e.getAttribute('aria-label') && !e.getAttribute('aria-labelledby') && !e.querySelector('h2'))
      out.unnamed.push(e.outerHTML.slice(0, 60));
  for (const e of page.querySelectorAll('th')) if (!e.scope) out.unnamed.push(e.outerHTML.slice(0, 60));
  for (const e of page.querySelectorAll('table'))
    if (!e.caption && !e.getAttribute('aria-label')) out.unnamed.push(e.outerHTML.slice(0, 60));
  out.headings = [...page.querySelectorAll('h1, h2, h3, h4')].map(h => +h.tagName[1]);
  for (const s of page.querySelectorAll('svg')) {
    const boxes = [...s.querySelectorAll('text')].map(t => [t.textContent, t.getBoundingClientRect()]);
    const whole = s.getBoundingClientRect();
    for (const [k, [words, b]] of boxes.entries()) {
      if (b.right > whole.right + 2 || b.left < whole.left - 2) out.stacked.push(s.id + ' cuts ' + words);
      for (const [others, c] of boxes.slice(k + 1)) {
        const across = Math.min(b.right, c.right) - Math.max(b.left, c.left);
        const up = Math.min(b.bottom, c.bottom) - Math.max(b.top, c.top);
        if (across > 1 && up > 0.35 * Math.min(b.height, c.height)) out.stacked.push(`${s.id}: ${words} on ${others}`);
      }
    }
  }
  return out;
}
function next(k) {
  if (k === widths.length) {
    document.body.textContent = '';
    const end = document.createElement('pre');
    end.id = 'found'; end.textContent = JSON.stringify(found);
    document.body.append(end);
    return;
  }
  const frame = document.createElement('iframe');
  frame.style = `border:0;height:900px;width:${widths[k]}px`;
  frame.onload = () => { found[widths[k]] = probe(frame); frame.remove(); next(k + 1); };
  frame.srcdoc = source;
  document.body.append(frame);
}
next(0);
</script>
"""


def look(page: Path, place: Path, *, dark: bool) -> tuple[dict[str, Any], str]:
    """What the probe finds at every width, and what the browser wrote to its console."""
    text = json.dumps(page.read_text(encoding="utf-8")).replace("</", "<\\/")
    probe = PROBE.replace("%WIDTHS%", json.dumps(WIDTHS)).replace("%CONTRAST%", str(LEAST_CONTRAST))
    file = place / "probe.html"
    file.write_text(probe.replace("%PAGE%", text), encoding="utf-8")
    command = [BROWSER, "--headless", "--no-sandbox", "--disable-gpu", "--dump-dom", "--enable-logging=stderr", "--v=0"]
    command += [f"--user-data-dir={place / 'profile'}", "--window-size=1400,1000", "--virtual-time-budget=20000"]
    command += [f"--blink-settings=preferredColorScheme={0 if dark else 1}", "--host-resolver-rules=MAP * ~NOTFOUND"]
    done = subprocess.run([*command, file.as_uri()], capture_output=True, text=True, timeout=120, check=False)
    result = re.search(r'<pre id="found">(.*?)</pre>', done.stdout, re.DOTALL)
    assert result, done.stderr[-2000:]
    from html import unescape

    return json.loads(unescape(result[1])), "\n".join(re.findall(r".*CONSOLE.*", done.stderr))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = write_folder(tmp_path_factory.mktemp("plain"), limits={"crushing": limit(0.0075, 0.01, True)})
    return build_report(with_pairs(folder))


@pytest.fixture(scope="module")
def crowded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Twenty inputs, German names of 300 letters, three limits."""
    inputs = ("striker.speed", *(f"{LONG}{'e' * (k % 5)} {k}" for k in range(19)))
    names = (LONG * 5, f"{LONG} der Kugel")
    limits = {f"{LONG} {k}": limit(0.0075, 0.01, True, quantity=names[0]) for k in range(3)}
    folder = write_folder(
        tmp_path_factory.mktemp("crowded"), title=LONG * 6, quantities=names, inputs=inputs, limits=limits
    )
    return build_report(with_pairs(folder))


@pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")
@pytest.mark.parametrize("dark", [False, True], ids=["light", "dark"])
@pytest.mark.parametrize("which", ["plain", "crowded"])
def test_the_page_holds_in_a_browser(request: pytest.FixtureRequest, tmp_path: Path, which: str, dark: bool) -> None:
    found, console = look(request.getfixturevalue(which), tmp_path, dark=dark)
    assert console == ""
    assert set(found) == {str(width) for width in WIDTHS}
    for width, seen in found.items():
        assert seen["dark"] is dark
        assert seen["loaded"] == 0  # no request leaves the page
        assert seen["wide"] <= int(width), f"the page is {seen['wide']} px wide in {width} px"
        for flaw in ("spilled", "dim", "lost", "mute", "unnamed", "twice", "stacked"):
            assert seen[flaw] == [], (flaw, width)
        levels = seen["headings"]
        assert levels[0] == 1
        assert levels.count(1) == 1
        assert all(after - before <= 1 for before, after in pairwise(levels))


def test_the_pages_are_valid_html(plain: Path, crowded: Path, tmp_path: Path) -> None:
    compared = write_page(plain.parent, crowded.parent, compare_folders(plain.parent, crowded.parent), tmp_path)
    for page in (plain, crowded, build_brief(plain.parent), build_brief(crowded.parent), compared):
        assert html_errors(page.read_text(encoding="utf-8")) == [], page
        assert page.stat().st_size < 1_000_000
    assert html_errors('<p id="a"><p id="a"></b>') != []


def test_the_document_is_typeset_without_the_network(plain: Path) -> None:
    pytest.importorskip("weasyprint", exc_type=(ImportError, OSError))
    from uqsphere.report.page import build_pdf

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        document = build_pdf(plain.parent).read_bytes()
    assert document.startswith(b"%PDF-")
    assert len(document) > 20_000


def test_pictures_in_the_page_are_typeset_and_nothing_else_is_read(tmp_path: Path) -> None:
    pytest.importorskip("weasyprint", exc_type=(ImportError, OSError))
    from uqsphere.report.page import typeset

    dot = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="
    (tmp_path / "dot.png").write_bytes(base64.b64decode(dot))

    def pictures(address: str) -> int:
        page = (
            f'<p>before</p><svg width="9" height="9"><image width="9" height="9" href="{address}"/></svg><p>after</p>'
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            return int(typeset(page).write_pdf(uncompressed_pdf=True).count(b"/Subtype /Image"))

    assert pictures(f"data:image/png;base64,{dot}") > 0
    assert pictures((tmp_path / "dot.png").as_uri()) == 0


def test_a_missing_typesetter_is_told_with_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    import sys

    from uqsphere.errors import UsageError
    from uqsphere.report.page import check_pdf

    monkeypatch.setitem(sys.modules, "weasyprint", None)
    with pytest.raises(UsageError, match=r"pip install 'uqsphere\[pdf\]'"):
        check_pdf()


@pytest.mark.skipif(not BROWSER, reason="no Chromium on this machine")
def test_the_probe_sees_what_is_wrong(plain: Path, tmp_path: Path) -> None:
    flaws = (
        '<p style="white-space:nowrap">' + "W" * 300 + '</p><p style="color:#bbb">pale</p><a href="#nowhere">x</a>'
        '<svg role="img"><text x="5" y="9">one</text><text x="6" y="9">two</text></svg>'
        '<table><tr><th>t</th></tr></table><p id="same"></p><p id="same"></p><script>1</script></main>'
    )
    page = tmp_path / "flawed.html"
    page.write_text(plain.read_text(encoding="utf-8").replace("</main>", flaws, 1), encoding="utf-8")
    found, console = look(page, tmp_path, dark=False)
    assert "Content Security Policy" in console
    for flaw in ("spilled", "dim", "lost", "mute", "unnamed", "twice", "stacked"):
        assert found["320"][flaw], flaw
    assert found["320"]["wide"] > 320


# --- the pages under axe-core: no violation; skipped where no package brings the rules, or there is no Chromium


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

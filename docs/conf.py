"""The site of the documentation: the pages beside this file, the Python interface, the published reports.

sphinx-build -W docs site
"""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT))

project = "uqsphere"
release = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]["version"]
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = f"uqsphere {release}"
# report.html and brief.html of every published run, as they are
html_extra_path = ["../reports"]
exclude_patterns = ["figures/*.py"]
# links are checked by tests/test_docs.py, those to the published reports among them
suppress_warnings = ["myst.xref_missing", "myst.header"]
myst_heading_anchors = 4
napoleon_use_rtype = False
autodoc_typehints = "signature"
autodoc_member_order = "bysource"

#: links of the README to pages of this folder, and of pages to the reports that lie in the root of the site
_MOVED = ((re.compile(r"\]\(docs/"), "]("), (re.compile(r"\]\((?:\.\./)?reports/"), "]("))
_LINK = re.compile(r"^\| \[([\w-]+)\]\(\1/report\.html\) \| (.*?) \|", re.MULTILINE)


def _with_links(app: Sphinx, name: str, source: list[str]) -> None:
    """The README is the first page; the gallery lists the published reports; links go where things lie on the site."""
    if name == "index":
        source[0] = (ROOT / "README.md").read_text("utf-8") + source[0]
    if name == "gallery":
        found = _LINK.findall((ROOT / "reports" / "README.md").read_text("utf-8"))
        source[0] += "".join(f"\n## {about[:1].upper()}{about[1:]}\n\n{_links(folder)}\n" for folder, about in found)
    for pattern, instead in _MOVED:
        source[0] = pattern.sub(instead, source[0])


def _links(folder: str) -> str:
    """What is published of a study, its brief first, and that in the page."""
    place = ROOT / "reports" / folder
    names = {"brief.html": "brief", "report.html": "report", "study.toml": "study file"}
    listed = " · ".join(
        f'<a href="{folder}/{file}">{word}</a>' for file, word in names.items() if (place / file).is_file()
    )
    brief = f'<iframe src="{folder}/brief.html" title="Brief: {folder}" width="100%" height="560"></iframe>'
    return listed + ("\n\n" + brief if (place / "brief.html").is_file() else "")


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _with_links)

"""What the site takes from outside docs/: the README as its first page, and the pages for
contributors."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

from mkdocs.structure.files import File, Files

ROOT: Final = Path(__file__).parents[2]
#: pages of the site by their files in the repository
PAGES: Final = {
    "README.md": "index.md",
    ".github/CONTRIBUTING.md": "contributing.md",
    ".github/SECURITY.md": "security.md",
}
LINK: Final = re.compile(r"\]\((?!https?:|#)([^)#]+\.md)(#[^)]*)?\)")
PICTURE: Final = re.compile(r"\]\(docs/(figures/[^)]+)\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that lie elsewhere."""
    for source, page in PAGES.items():
        text = (ROOT / source).read_text(encoding="utf-8")
        text = LINK.sub(lambda match, base=(ROOT / source).parent: _link(match, base), text)
        files.append(File.generated(config, page, content=PICTURE.sub(r"](\1)", text)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Turn links to pages outside docs/ into links to their copies."""
    return LINK.sub(lambda match: _link(match, ROOT / "docs"), markdown)


def _link(match: re.Match[str], base: Path) -> str:
    path = (base / match[1]).resolve()
    if not path.is_file() or ROOT not in path.parents:
        return match[0]
    source = path.relative_to(ROOT).as_posix()
    page = PAGES.get(source, source.removeprefix("docs/"))
    return f"]({page}{match[2] or ''})"

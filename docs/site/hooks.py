"""What the site takes from outside docs/: the README as its first page, and the files that pages
link to: studies, published reports, notebooks, data."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, Final

from mkdocs.structure.files import File, Files

ROOT: Final = Path(__file__).parents[2]
#: a link to a file of the repository that is not a page of the site
LINK: Final = re.compile(r"\]\((?!https?:|#)([^)#]+)(#[^)]*)?\)")


def on_files(files: Files, config: Any) -> Files:
    """Add the first page, made from the README."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    files.append(File.generated(config, "index.md", content=text.replace("](docs/", "](")))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Keep links between pages; a link to another file of the repository becomes a copy of it."""

    def target(match: re.Match[str]) -> str:
        path = match[1]
        if path.endswith(".md") or files.get_file_from_path(path) is not None:
            return match[0]
        for base in (ROOT / "docs", ROOT):
            source = (base / path).resolve()
            if source.is_file() and ROOT in source.parents:
                inside = f"files/{source.relative_to(ROOT).as_posix()}"
                if files.get_file_from_path(inside) is None:
                    files.append(File.generated(config, inside, content=source.read_bytes()))
                return f"]({inside})"
        return match[0]

    return LINK.sub(target, markdown)

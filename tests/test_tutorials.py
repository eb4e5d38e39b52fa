"""Every command and number of the tutorials is executed, in the way of the README's tour.

``python tests/test_tutorials.py PAGE.md`` writes what the commands print into a page, to be read before it is kept.
"""

from __future__ import annotations

import re
import sys
import tempfile
from pathlib import Path

import pytest
from test_readme import ROOT, console_blocks, differences, run

PAGES = sorted((ROOT / "docs").glob("tutorial-*.md"))


def files_of(page: Path) -> dict[str, str]:
    """Files that a page shows: blocks whose first line is a comment with the name of a file."""
    blocks = re.findall(
        r"^```(?:toml|python|c|text)\n((?:#|//) ([\w.]+)\n.*?)^```$", page.read_text("utf-8"), re.DOTALL | re.MULTILINE
    )
    return {name: text for text, name in blocks}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.stem)
def test_a_tutorial_is_what_the_commands_print(page: Path, tmp_path: Path) -> None:
    assert len(console_blocks(page)) > 4
    for name, text in files_of(page).items():
        (tmp_path / name).write_text(text, encoding="utf-8")
    assert not differences(page, tmp_path)


def test_there_is_one_for_everybody() -> None:
    assert [page.stem for page in PAGES] == [
        "tutorial-black-box", "tutorial-engineer", "tutorial-experimentalist", "tutorial-machines",
        "tutorial-quarry",
    ]  # fmt: skip


if __name__ == "__main__":
    for page in map(Path, sys.argv[1:]):
        place, text = Path(tempfile.mkdtemp()), page.read_text("utf-8")
        for name, content in files_of(page).items():
            (place / name).write_text(content, encoding="utf-8")
        for command, old in console_blocks(page):
            if "..." not in old:
                text = text.replace(f"$ {command}\n{old}", f"$ {command}\n{run(command, place).strip()}\n".lstrip(), 1)
        page.write_text(text, encoding="utf-8")
        print(page, place)

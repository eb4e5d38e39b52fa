"""The worked additions of the contributors' page run as they stand."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / ".github" / "CONTRIBUTING.md").read_text(encoding="utf-8")
ADDITIONS = dict(re.findall(r"(?ms)^### ([^\n]+)\n.*?^```python\n(.*?)^```", PAGE))


def test_there_are_three_additions() -> None:
    assert list(ADDITIONS) == ["A distribution", "A failure mode", "A rig"]


@pytest.mark.slow
@pytest.mark.parametrize("title", ADDITIONS)
def test_an_addition_is_one_entry(title: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-W", "error", "-c", ADDITIONS[title]],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert ended.returncode == 0, ended.stderr[-2000:]

"""Apply every mutant to a copy of the tree, one at a time, and see whether its tests notice.

    python tests/mutants/run.py                    all of them; exit 1 if one survives without a reason
    python tests/mutants/run.py contact estimates  those whose file has one of these words in it

Prints one line per mutant and the counts at the end.  The tests that a mutant is held against are run on the
unchanged copy first: a test that fails anyway catches nothing.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from mutants import EQUIVALENT, MUTANTS

ROOT = Path(__file__).parent.parent.parent
#: seconds after which a mutant that hangs counts as caught
_LONGEST = 600


def tests_pass(tree: Path, tests: str) -> bool:
    """Whether the test files pass in a copy of the tree."""
    paths = [str(tree / "tests" / name) for name in tests.split()]
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", "--no-header",
               f"--rootdir={tree}", *paths]  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": str(tree), "PYTHONDONTWRITEBYTECODE": "1", "MPLBACKEND": "Agg"}
    try:
        done = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=_LONGEST)
    except subprocess.TimeoutExpired:
        return False
    if done.returncode not in (0, 1, 2):
        raise RuntimeError(f"{tests}: pytest ended with {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return done.returncode == 0


def copy_tree(place: Path) -> Path:
    """A copy of what tests need."""
    tree = place / "tree"
    tree.mkdir()
    for name in ("uqsphere", "tests", "studies", "docs"):
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("pyproject.toml", "README.md", "constraints.txt", "CHANGELOG.md"):
        shutil.copy2(ROOT / name, tree / name)
    return tree


def main(words: list[str]) -> int:
    """The command line."""
    chosen = [m for m in MUTANTS if not words or any(word in m[0] for word in words)]
    caught = equivalent = 0
    survivors: list[str] = []
    sound: dict[str, bool] = {}
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="uqsphere-mutants-") as name:
        tree = copy_tree(Path(name))
        for number, (file, before, after, tests) in enumerate(chosen, 1):
            path = tree / "uqsphere" / file
            text = path.read_text(encoding="utf-8")
            if text.count(before) < 1:
                raise SystemExit(f"{file} no longer has {before!r}: bring the mutant up to date")
            if tests not in sound:
                sound[tests] = tests_pass(tree, tests)
            if not sound[tests]:
                raise SystemExit(f"{tests} fails on the unchanged tree")
            path.write_text(text.replace(before, after, 1), encoding="utf-8")
            seen = not tests_pass(tree, tests)
            path.write_text(text, encoding="utf-8")
            if seen:
                caught += 1
                word = "caught"
            elif after in EQUIVALENT:
                equivalent += 1
                word = f"equivalent ({EQUIVALENT[after]})"
            else:
                survivors.append(f"{file}: {before!r} -> {after!r} ({tests})")
                word = "SURVIVES"
            print(f"{number}/{len(chosen)} {word}: {file}: {before[:50]!r} -> {after[:50]!r}", flush=True)
    print(f"{len(chosen)} made, {caught} caught, {equivalent} equivalent, {len(survivors)} survive, "
          f"{time.monotonic() - began:.0f} s")  # fmt: skip
    for text in survivors:
        print(f"survives: {text}")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

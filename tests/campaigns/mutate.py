"""Apply every mutant to a copy of the tree, one at a time, and see whether its tests notice.

    python tests/campaigns/mutate.py                    all of them; exit 1 if one survives without a reason
    python tests/campaigns/mutate.py contact estimates  those whose file has one of these words in it

Prints one line per mutant and the counts at the end.  The tests that a mutant is held against are run on the
unchanged copy first: a test that fails anyway catches nothing.  Tests run in forks of this process, which has loaded
what they all need and nothing of the tree; so this needs a POSIX system.
"""

from __future__ import annotations

import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from mutants import EQUIVALENT, MUTANTS

ROOT = Path(__file__).parent.parent.parent
#: seconds of processor after which a mutant that hangs counts as caught
_LONGEST = 600
#: what most tests load; numba is not used before the fork, which it would not survive
_COMMON = ("pytest", "numpy", "scipy.stats", "scipy.special", "scipy.optimize", "pandas", "numba",
           "threadpoolctl", "filelock")  # fmt: skip


def tests_pass(tree: Path, tests: str) -> bool:
    """Whether the test files pass in a copy of the tree."""
    words = ["-x", "-q", "-p", "no:xdist", "-p", "no:cacheprovider", "--no-header", f"--rootdir={tree}",
             *(str(tree / "tests" / name) for name in tests.split())]  # fmt: skip
    said = tree.parent / "said.txt"
    child = os.fork()
    if child == 0:
        _run_tests(tree, words, said)
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code not in (0, 1, 2) and code > 0:
        raise RuntimeError(f"{tests}: pytest ended with {code}\n{said.read_text()[-4000:]}")
    return code == 0


def _run_tests(tree: Path, words: list[str], said: Path) -> None:
    """The life of a fork: never returns."""
    code = 4
    try:
        handle = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(handle, 1)
        os.dup2(handle, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (_LONGEST, _LONGEST + 10))
        os.chdir(tree)
        os.environ.update({"PYTHONPATH": str(tree), "MPLBACKEND": "Agg", "PYTHONDONTWRITEBYTECODE": "1"})
        sys.dont_write_bytecode = True
        sys.path[0] = str(tree)
        import pytest

        code = int(pytest.main(words))
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


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
    for file, before, *_ in chosen:
        if before not in (ROOT / "uqsphere" / file).read_text(encoding="utf-8"):
            raise SystemExit(f"{file} no longer has {before!r}: bring the mutant up to date")
    for name in _COMMON:
        __import__(name)
    caught = equivalent = 0
    survivors: list[str] = []
    sound: dict[str, bool] = {}
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="uqsphere-mutants-") as name:
        tree = copy_tree(Path(name))
        for number, (file, before, after, tests) in enumerate(chosen, 1):
            path = tree / "uqsphere" / file
            text = path.read_text(encoding="utf-8")
            if tests not in sound:
                sound[tests] = tests_pass(tree, tests)
            if not sound[tests]:
                survivors.append(f"{tests} fails on the unchanged tree")
                print(f"{number}/{len(chosen)} {survivors[-1]}", flush=True)
                continue
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

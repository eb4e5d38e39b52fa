"""Apply every mutant to a copy of the tree, one at a time, and see whether its tests notice.

    python -m tests.campaigns.mutate                    all of them; exit 1 if one survives without a reason
    python -m tests.campaigns.mutate contact estimates  those whose file has one of these words in it

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
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parent.parent.parent
LIST = Path(__file__).with_name("mutants.txt")
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


@dataclass(frozen=True)
class Mutant:
    """One fault: file, what stands there, what is put in its place, test files, and why it cannot be seen, if so."""

    file: str
    before: str
    after: str
    tests: str
    excuse: str = ""


def read_mutants() -> list[Mutant]:
    """The list beside this file."""
    found, file, tests = [], "", ""
    for line in LIST.read_text(encoding="utf-8").splitlines():
        if line.startswith("["):
            file, _, tests = line[1:].partition("] ")
        elif file and line:
            before, after, *excuse = (part.replace("\\n", "\n") for part in line.split("  =>  "))
            found.append(Mutant(file, before, after, tests, *excuse))
    return found


def main(words: list[str]) -> int:
    """The command line."""
    chosen = [one for one in read_mutants() if not words or any(word in one.file for word in words)]
    for one in chosen:
        if one.before not in (ROOT / "uqsphere" / one.file).read_text(encoding="utf-8"):
            raise SystemExit(f"{one.file} no longer has {one.before!r}: bring the mutant up to date")
    for name in _COMMON:
        __import__(name)
    counts: Counter[str] = Counter()
    sound: dict[str, bool] = {}
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="uqsphere-mutants-") as name:
        tree = copy_tree(Path(name))
        for number, one in enumerate(chosen, 1):
            path = tree / "uqsphere" / one.file
            text = path.read_text(encoding="utf-8")
            if one.tests not in sound:
                sound[one.tests] = tests_pass(tree, one.tests)
            path.write_text(text.replace(one.before, one.after, 1), encoding="utf-8")
            seen = sound[one.tests] and not tests_pass(tree, one.tests)
            path.write_text(text, encoding="utf-8")
            word = "caught" if seen else "equivalent" if one.excuse else "SURVIVES"
            counts[word] += 1
            told = "" if sound[one.tests] else " (its tests fail without it)"
            print(f"{number}/{len(chosen)} {word}{told}: {one.file}: {one.before!r} -> {one.after!r}", flush=True)
    print(f"{len(chosen)} made, {dict(counts)}, {time.monotonic() - began:.0f} s")
    return 1 if counts["SURVIVES"] else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

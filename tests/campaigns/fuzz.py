"""Mutated studies through `uqsphere check`: each ends with exit code 0, 2 or 6.

    python -m tests.campaigns.fuzz [--studies 20000] [--seed 1]

A study is a shipped one with one to four edits of its lines and values: taken out, doubled,
swapped, taken from another study, or replaced by a value of another kind.  Printed: how often each
code was met, and every other one with its file.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import re
import tempfile
from collections import Counter
from pathlib import Path
from unittest.mock import patch

import numpy as np

from uqsphere.cli import main
from uqsphere.study import shipped_studies

VALUES = (
    '"1 mm"',
    '"3 GPa"',
    '"0.5 m/s"',
    "0",
    "-1",
    "1e400",
    "nan",
    "12",
    '"15 %"',
    "true",
    "[]",
    "{}",
    "[1, 2]",
    '""',
    '{ dist = "normal", mean = "1 m", sd = "2 m" }',
    '{ dist = "weibull", mean = 3, modulus = 0.1 }',
    '"p_max"',
    '{ dist = "scipy.gamma", a = 1e9 }',
    '{ file = "none.csv", force = "F", diameter = "D" }',
    '"plastic"',
    '"x"',
    '{ draws = "../d.csv" }',
    "1979-05-27",
    '"1e308 m"',
    '"step"',
    '"bars"',
    '"ball"',
    "99999999999999999999",
    '"measured"',
    "[[1]]",
)
VALUE = re.compile(r'("[^"\n]*"|\{[^{}\n]*\}|\[[^\[\]\n]*\]|(?<== )[-+.\w]+)')


def mutated(texts: list[str], rng: np.random.Generator) -> str:
    """A study with one to four edits."""

    def pick(items: list[str] | tuple[str, ...]) -> str:
        return items[rng.integers(len(items))]

    lines = pick(texts).splitlines()
    for _ in range(rng.integers(1, 5)):
        at, edit = int(rng.integers(len(lines))), rng.integers(7)
        if edit == 0:
            del lines[at : at + 1 + int(rng.integers(3))]
        elif edit == 1:
            lines.insert(int(rng.integers(len(lines))), lines[at])
        elif edit == 2:
            lines.insert(at, pick(pick(texts).splitlines()))
        elif edit == 3:
            lines[at] = "".join(c for c in lines[at] if rng.random() > 0.05)
        elif found := list(VALUE.finditer(lines[at])):
            span = found[int(rng.integers(len(found)))].span()
            other = pick(VALUES) if edit < 6 else pick(VALUE.findall(pick(texts)))
            lines[at] = lines[at][: span[0]] + other + lines[at][span[1] :]
        lines = lines or [""]
    return "\n".join(lines)


def fuzz(studies: int, seed: int) -> Counter[int]:
    """How often each exit code was met."""
    texts = [path.read_text(encoding="utf-8") for path in shipped_studies().values()]
    rng, codes = np.random.default_rng(seed), Counter[int]()
    # the rows that check runs for its time need no thousand repetitions
    with (
        tempfile.TemporaryDirectory() as folder,
        patch("uqsphere.report.study.cost", lambda study: ""),
    ):
        for path in shipped_studies().values():
            for table in path.parent.glob("*.csv"):
                (Path(folder) / table.name).write_bytes(table.read_bytes())
        for _ in range(studies):
            text = mutated(texts, rng)
            (Path(folder) / "study.toml").write_text(text, encoding="utf-8")
            with (
                contextlib.redirect_stdout(io.StringIO()),
                contextlib.redirect_stderr(io.StringIO()) as said,
            ):
                code = main(["check", f"{folder}/study.toml"])
            codes[code] += 1
            if code not in (0, 2, 6):
                print(f"exit code {code}: {said.getvalue()[-2000:]}\n{text}\n{'-' * 100}")
    return codes


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--studies", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=1)
    given = parser.parse_args()
    for code, count in sorted(fuzz(given.studies, given.seed).items()):
        print(f"exit code {code}: {count} of {given.studies}")

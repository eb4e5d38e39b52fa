"""Mutated studies, tables and workbooks at the doors of `uqsphere check`, in this process.

Each mutant must be accepted or refused with a message: exit code 0, 2 or 3, no traceback, no
internal error, and at most `MOST` seconds of CPU.  Run by `python -m tests.campaigns.fuzz [COUNT]
[SEED] [1]`, the 1 for the trial run that tells the cost; prints the mutants that failed, with their
seeds, and a table of codes.
"""

from __future__ import annotations

import contextlib
import io
import random
import sys
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path
from unittest.mock import patch

from uqsphere.cli import main
from uqsphere.study import shipped_studies

#: CPU seconds that a mutant may take
MOST = 5.0
ALLOWED = {0, 2, 3}
VALUES = (
    "0x" + "f" * 3700,
    "1e308",
    "-1e308",
    "1e-320",
    "nan",
    "inf",
    "-0.0",
    "true",
    '""',
    '"52 gpa"',
    '"1e999 m"',
    '"-3 m/s"',
    '"' + "x" * 2000 + '"',
    "[]",
    "[[]]",
    "{}",
    '{ dist = "normal", mean = 1.0, sd = 1e300 }',
    '{ dist = "weibull", scale = 1.0, modulus = 1e-9 }',
    '{ dist = "scipy.nct", df = 1e-9, nc = 1e9 }',
    '{ dist = "discrete", values = [1, 1], weights = [0, 0] }',
    '{ file = "tests.csv", column = "x" }',
    '{ file = "t\\tests.csv", column = "x" }',
    '"\\u202e\\u001b[2J"',
    "'''\n'''",
    "2026-01-01",
)
CELLS = (
    "", "#N/A", "#DIV/0!", "1e308", "1e999", "-1", "0", "1,234.5", "1.234,5", "7,4", "nan", "=A1",
    '"', '"a\nb"', "\x00", "5 kN", "mean", "# x", "x" * 3000, "\t", ";", "−5", "１２",
)  # fmt: skip
HEADINGS = (
    "F [10 kN]", "F [KN]", "", "F", "F [kN", "[kN]", "F_kN_kN", "F (kN) [N]", "1", "x" * 5000,
    "F in 10 kN", "F [kN] [kN]", "F/kN", "[", "]", "F [%]", "\u202eF [kN]",
)  # fmt: skip
STUDY = """
[sphere]
material = "limestone"
radius = "6 mm"
[rig]
kind = "impact"
drop_height = "1 m"
[target]
kind = "thick"
material = "steel"
[limits.a]
criterion = "core_tension"
strength = { file = "FILE", force = "F", diameter = "D", force_unit = "kN", diameter_unit = "mm" }
target = 0.02
"""


def mutated_text(text: str, rng: random.Random) -> str:
    """A study with one to three changes of lines, values or characters."""
    lines = text.split("\n")
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(lines))
        key, sign, _ = lines[place].partition("=")
        match rng.randrange(7):
            case 0 if sign:
                lines[place] = f"{key}= {rng.choice(VALUES)}"
            case 1:
                del lines[place]
                lines = lines or [""]
            case 2:
                lines.insert(place, lines[rng.randrange(len(lines))])
            case 3 if lines[place]:
                at = rng.randrange(len(lines[place]))
                lines[place] = lines[place][:at] + chr(rng.randrange(1, 0x2100)) + lines[place][at:]
            case 4:
                lines.insert(place, f"{rng.choice('abcxyz')}{rng.randrange(99)} = 1")
            case 5:
                lines.insert(place, rng.choice(("[", "]", "{", "[[limits.a]]", "[limits.a.b.c]")))
            case _ if sign:
                lines[place] = f"{key}= {rng.choice(lines).partition('=')[2] or '0'}"
    return "\n".join(lines)


def mutated_rows(rng: random.Random) -> list[list[str]]:
    """A table of tests with one to four changes of cells, rows or headings."""
    rows = [["F", "D"], *([f"{rng.gauss(6.0, 1.0):.2f}", "12"] for _ in range(12))]
    for _ in range(rng.randint(1, 4)):
        row = rng.choice(rows)
        match rng.randrange(6):
            case 0 if row:
                row[rng.randrange(len(row))] = rng.choice(CELLS)
            case 1:
                rows[0] = [rng.choice(HEADINGS), "D"]
            case 2:
                rows.insert(rng.randrange(len(rows)), [rng.choice(CELLS)] * rng.randrange(4))
            case 3:
                rows.remove(row)
            case 4:
                row.append(rng.choice(CELLS))
            case _:
                rows.append(["mean", "12"])
        rows = rows or [[]]
    return rows


def as_file(rows: list[list[str]], folder: Path, rng: random.Random) -> str:
    """Write a table as a text or a workbook; returns the name of the file."""
    if rng.random() < 0.3:
        from openpyxl import Workbook
        from openpyxl.utils.exceptions import IllegalCharacterError

        book = Workbook()
        with contextlib.suppress(IllegalCharacterError, ValueError):
            for row in rows:
                book.active.append([_cell(cell) for cell in row])
        if rng.random() < 0.3:
            book.create_sheet("other").append(["F", "D"])
        book.save(folder / "t.xlsx")
        return "t.xlsx"
    divider = rng.choice(",;\t")
    text = rng.choice(("\n", "\r\n", "\r")).join(divider.join(row) for row in rows)
    coding = rng.choice(("utf-8", "utf-8-sig", "utf-16", "cp1252"))
    data = text.encode(coding, "replace")
    if rng.random() < 0.1:
        place = rng.randrange(len(data) + 1)
        data = data[:place] + bytes([rng.randrange(256)]) + data[place:]
    (folder / "t.csv").write_bytes(data)
    return "t.csv"


def _cell(cell: str) -> float | str:
    try:
        return float(cell)
    except ValueError:
        return cell


def tried(seed: int, folder: Path) -> tuple[object, float, str]:
    """Exit code, CPU seconds and messages of `uqsphere check` on a mutant."""
    rng = random.Random(seed)
    if rng.random() < 0.5:
        path = rng.choice(sorted(shipped_studies().values()))
        for other in path.parent.glob("*.csv"):
            (folder / other.name).write_bytes(other.read_bytes())
        text = mutated_text(path.read_text("utf-8"), rng)
    else:
        text = STUDY.replace("FILE", as_file(mutated_rows(rng), folder, rng))
    study = folder / "study.toml"
    study.write_text(text, encoding="utf-8", errors="replace")
    said, began = io.StringIO(), time.process_time()
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said):
            code: object = main(["check", str(study)])
    except BaseException as error:
        code = f"raised {type(error).__name__}: {str(error)[:200]}"
    return code, time.process_time() - began, said.getvalue()


def campaign(
    count: int, first: int = 0, *, trial: bool = False
) -> tuple[Counter[object], list[str]]:
    """Codes of mutants by their number, and what failed; `trial`: with the run for the cost."""
    codes: Counter[object] = Counter()
    failures = []
    with (
        tempfile.TemporaryDirectory() as name,
        warnings.catch_warnings(),
        contextlib.ExitStack() as patches,
    ):
        if not trial:  # the rows that check runs for its time need no thousand repetitions
            patches.enter_context(patch("uqsphere.report.study.cost", lambda study: ""))
        warnings.simplefilter("error", RuntimeWarning)  # none may reach the terminal
        for seed in range(first, first + count):
            code, seconds, said = tried(seed, Path(name))
            codes[code] += 1
            if code not in ALLOWED or seconds > MOST or "internal error" in said:
                failures.append(f"seed {seed}: {code}, {seconds:.1f} s: {said[-300:]}")
    return codes, failures


if __name__ == "__main__":
    arguments = [int(argument) for argument in sys.argv[1:]]
    codes, failures = campaign(*(arguments or [2000])[:2], trial=len(arguments) > 2)
    print(*failures, sep="\n")
    print(dict(codes))
    sys.exit(1 if failures else 0)

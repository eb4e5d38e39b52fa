"""Mutated studies, tables and workbooks at the doors of `uqsphere check`, in this process.

Each mutant must be accepted or refused with a message: exit code 0, 2 or 3, no traceback, no
internal error, and at most `MOST` seconds of CPU.  Run by `python -m tests.campaigns.fuzz [COUNT]
[SEED] [1]`, the 1 for the rows that `check` times; prints the mutants that failed, with their
seeds, and a table of codes.
"""

from __future__ import annotations

import contextlib
import datetime
import gzip
import io
import random
import re
import sys
import tempfile
import time
import warnings
import zipfile
from collections import Counter
from pathlib import Path
from typing import Any
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
    "2026-01-01T00:00:00Z",
    "07:30:00",
    "1e400",
    "-1e-400",
    "1_000.5",
    "0o777",
    "0b" + "1" * 2000,
    "NaN",
    "Infinity",
    '"nan m"',
    '"inf GPa"',
    '"0x10 mm"',
    '"1e5000 mm"',
    '"1,5 mm"',
    '"1.234,5 mm"',
    '"1 234 mm"',
    '"1\'234 mm"',
    '"5\u00a0mm"',
    '"5 \u00b5m"',
    '"5 \u03bcm"',
    '"\u22125 mm"',
    '"\uff15 mm"',
    '"5 mm\u200b"',
    '"5 \u043cm"',
    '"5 %%"',
    '"%"',
    '"5 N/mm\u00b2"',
    '"1450 rpm at 0 m"',
    '"1e200 rpm at 1e200 m"',
    '"rpm at"',
    '"5..7 mm"',
    '"5 mm ± 1 mm"',
    "[1, [2, [3, [4]]]]",
    '[{ dist = "normal" }, { dist = "normal" }]',
    '{ dist = "normal", mean = "5 mm", "mean" = "6 mm" }',
    '{ "dist" = "normal", mean = 1.0, cov = 0.1, lower = 2.0, upper = 1.0 }',
    '{ dist.dist = "normal" }',
    '{ dist = "beta", alpha = 1e-300, beta = 1e300, lower = 0, upper = 1 }',
    '{ dist = "student_t", dof = 1e-9, location = 0, scale = 1 }',
    '{ dist = "scipy.levy_stable", alpha = 1.0, beta = 0.1 }',
    '{ dist = "scipy.os", x = 1 }',
    '{ file = "." }',
    '{ file = "", column = "" }',
    '{ file = "tests.csv", column = "x", sheet = "S" }',
    '{ draws = "tests.csv" }',
    '{ file = "tests.csv", force = "F", diameter = "1e-320 m" }',
)
CELLS = (
    "", "#N/A", "#DIV/0!", "1e308", "1e999", "-1", "0", "1,234.5", "1.234,5", "7,4", "nan", "=A1",
    '"', '"a\nb"', "\x00", "5 kN", "mean", "# x", "x" * 3000, "\t", ";", "−5", "１２",
    "2026-01-01", "01.02.2026", "12:30", "1e5000", "-1e-5000", "0x1F", "1_000", "1 234", "1'234",
    "1\u00a0234,5", "5\u200b", "\ufeff5", "(5)", "5-", "+5", "++5", "5e", ".", ",", "5 000 N", "<5",
    "~5", "5*", "TRUE", "inf", "-Infinity", "NaN", "NULL", "\x1a", "\u2028", "5/2", "½", "٣",
)  # fmt: skip
HEADINGS = (
    "F [10 kN]", "F [KN]", "", "F", "F [kN", "[kN]", "F_kN_kN", "F (kN) [N]", "1", "x" * 5000,
    "F in 10 kN", "F [kN] [kN]", "F/kN", "[", "]", "F [%]", "\u202eF [kN]",
    "F\u00a0[kN]", "F [ｋN]", "F [кN]", "F [kN²]", "F [kN/mm]", "F (kN", "F,D", " F ", "'F'", "F;D",
    "F [" + "[" * 500, "F" + " [kN]" * 100, "f", "ﬀ", "F [1e3 N]", "F [N x 1e3]", "#F", "=F", "D",
)  # fmt: skip
#: characters that look like others
ALIKE = (
    str.maketrans("-", "−"),
    str.maketrans(" ", "\u00a0"),
    str.maketrans("aeopE", "аеорЕ"),
    str.maketrans(".", ","),
    str.maketrans("0123456789", "０１２３４５６７８９"),
    str.maketrans('"', "“"),
    str.maketrans("=", "＝"),
    str.maketrans("u", "μ"),
)
QUOTES = ('"{}"', "'{}'", "[{}]", "{{ x = {} }}", "{0} {0}", "{},", "-{}", "{}e999", "+{}", "# {}")
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
strength = { file = "FILE", force = "F", diameter = "D", platens = "rigid" }
target = 0.02
"""


def mutated_text(text: str, rng: random.Random) -> str:
    """A study with one to three changes of lines, values or characters."""
    lines = text.split("\n")
    for _ in range(rng.randint(1, 3)):
        place = rng.randrange(len(lines))
        key, sign, _ = lines[place].partition("=")
        match rng.randrange(10):
            case 7 if sign:  # a key in quotes, twice, or dotted
                name = key.strip()
                lines[place] = rng.choice(
                    (
                        f'"{name}" {sign}{lines[place].partition("=")[2]}',
                        f"{lines[place]}\n{lines[place]}",
                        f"{name}.mean = 1\n{name}.mean = 2",
                        f"{name}.dist = 'normal'\n{name}.mean = 1.0\n{name}.sd = 0.1",
                        f"'' = 1\n{lines[place]}",
                    )
                )
            case 8:
                lines[place] = lines[place].translate(rng.choice(ALIKE))
            case 9 if sign:
                value = lines[place].partition("=")[2]
                lines[place] = f"{key}= {rng.choice(QUOTES).format(value.strip())}"
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


def mutated_rows(rng: random.Random, table: list[list[str]] | None = None) -> list[list[str]]:
    """A table, of tests where none is given, with some changes of cells, rows or headings."""
    tests = ([f"{rng.gauss(6.0, 1.0):.2f}", "12"] for _ in range(12))
    rows = table or [[rng.choice(("F", "F [kN]")), "D [mm]"], *tests]
    for _ in range(rng.randint(0, 4)):
        row = rng.choice(rows)
        match rng.randrange(6):
            case 0 if row:
                row[rng.randrange(len(row))] = rng.choice(CELLS)
            case 1:
                rows[0] = [rng.choice(HEADINGS), rng.choice(("D", "D [mm]"))]
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
    """Write a table as a text, a workbook or something else; returns the name of the file."""
    kind = rng.random()
    if kind < 0.35:
        (folder / "t.xlsx").write_bytes(damaged_book(as_book(rows, rng), rng))
        return "t.xlsx"
    divider = rng.choice(",;\t|  ")
    text = rng.choice(("\n", "\r\n", "\r", "\n\n", "\x0b")).join(divider.join(row) for row in rows)
    data = disguised(text, rng)
    if rng.random() < 0.1:
        place = rng.randrange(len(data) + 1)
        data = data[:place] + bytes([rng.randrange(256)]) + data[place:]
    if kind < 0.9:
        (folder / "t.csv").write_bytes(data)
        return "t.csv"
    return as_something_else(data, folder, rng)


def disguised(text: str, rng: random.Random) -> bytes:
    """A text in one of many encodings, with or without marks, blanks or bytes that are wrong."""
    coding = rng.choice(
        (
            "utf-8",
            "utf-8",
            "utf-8-sig",
            "utf-16",
            "utf-16-le",
            "utf-32",
            "cp1252",
            "latin-1",
            "cp437",
        )
    )
    data = text.encode(coding, "replace")
    match rng.randrange(12):
        case 0:
            return b"\xef\xbb\xbf" * 2 + data
        case 1:
            return data.replace(b"\n", b"\r\n")
        case 2:
            return data + b"\0" * rng.randrange(5)
        case 3:
            return data + b"\x1a"
        case 4:
            return data[: rng.randrange(len(data) + 1)]
        case 5:
            return b"sep=;\n" + data
        case 6:
            return b"\n" * rng.randrange(50) + data
    return data


def as_something_else(data: bytes, folder: Path, rng: random.Random) -> str:
    """A file that is no table: packed, a link, a folder, an old workbook, a database, a page."""
    path = folder / f"else{rng.randrange(9)}.csv"
    if path.is_dir():
        path.rmdir()
    path.unlink(missing_ok=True)
    match rng.randrange(9):
        case 0:
            path.write_bytes(gzip.compress(data))
        case 1:
            path.symlink_to("/etc/hostname")
        case 2:
            path.symlink_to(path.name)
        case 3:
            path.symlink_to("t.csv")
        case 4:
            path.mkdir()
        case 5:
            path.write_bytes(b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + rng.randbytes(500))
        case 6:
            path.write_bytes(b"SQLite format 3\0" + rng.randbytes(500))
        case 7:
            path.write_bytes(b"<html><table><tr><td>F</td><td>D</td></tr></table></html>")
        case _:
            path.write_bytes(b"%PDF-1.7\n" + rng.randbytes(500))
    return path.name


def as_book(rows: list[list[str]], rng: random.Random) -> bytes:
    """A workbook of a table, with what people have in workbooks."""
    from openpyxl import Workbook
    from openpyxl.utils.exceptions import IllegalCharacterError

    book, stream = Workbook(), io.BytesIO()
    sheet = book.active
    with contextlib.suppress(IllegalCharacterError, ValueError):
        for row in rows:
            sheet.append([_cell(cell, rng) for cell in row])
    match rng.randrange(8):
        case 0:
            sheet.merge_cells(f"A{rng.randrange(1, 5)}:B{rng.randrange(5, 9)}")
        case 1:
            book.create_sheet("other", rng.randrange(2)).append(["F", "D"])
        case 2:
            book.create_sheet("shown")
            sheet.sheet_state = rng.choice(("hidden", "veryHidden"))
        case 3:
            _chart(book)
        case 4:
            sheet.cell(1_048_576, 16_384, "far")
        case 5:
            sheet.column_dimensions["A"].hidden = True
            sheet["A2"].number_format = rng.choice(("0 %", "yyyy-mm-dd", "hh:mm", "@", "General"))
    book.save(stream)
    return stream.getvalue()


def _chart(book: Any) -> None:
    """A sheet that is a chart, before the others."""
    from openpyxl.chart import BarChart, Reference

    chart = BarChart()
    chart.add_data(Reference(book.active, min_col=1, min_row=1, max_row=2))
    book.create_chartsheet("a chart", 0).add_chart(chart)


def damaged_book(data: bytes, rng: random.Random) -> bytes:
    """A workbook without one of its parts, with one that is cut or changed, or as it is."""
    if rng.random() < 0.6:
        return data
    whole, stream = zipfile.ZipFile(io.BytesIO(data)), io.BytesIO()
    hurt = rng.choice(whole.namelist())
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as copy:
        for name in whole.namelist():
            part = whole.read(name)
            if name == hurt:
                place = rng.randrange(len(part) + 1)
                part = rng.choice(
                    (
                        b"",
                        part[:place],
                        part[:place] + rng.randbytes(3) + part[place:],
                        part.replace(b"t=", b"u="),
                        part.replace(b"<v>", b"<v>9"),
                        re.sub(rb'r="[A-Z]+[0-9]+"', b'r="ZZZZ1"', part),
                    )
                )
                if rng.random() < 0.3:
                    continue
            copy.writestr(name, part)
    content = stream.getvalue()
    return content if rng.random() < 0.9 else content[: rng.randrange(len(content))]


def _cell(cell: str, rng: random.Random) -> object:
    if rng.random() < 0.02:
        day = datetime.datetime(2026, 1, 2, 3, 4)
        return rng.choice((day, day.date(), day.time(), True, None, 10**17, "=1/0", "=NOW()"))
    try:
        return float(cell)
    except ValueError:
        return cell


#: a column of observations, draws of a fit, and the record of a pulse
COLUMN = """
[inputs]
x = { file = "FILE", column = "F [kN]", KEYS }
[outputs]
names = ["y"]
"""
KEYS = (
    'fit = "weibull"', 'fit = "lognormal"', 'fit = "kde"', 'fit = "steps"', 'fit = "gumbel"',
    'fit = "frechet"', 'fit = "gamma"', 'fit = "beta", lower = 0, upper = 100', 'fit = "normal"',
    'fit = "exponential"', 'fit = "rayleigh"', 'fit = "weibull", unbiased = true', "modulus = 8",
    'fit = "weibull", censored = "D [mm]"', 'fit = "normal", count = "D [mm]"', 'decimal = ","',
    "lower = 5", 'sheet = "other"', 'modulus = 8, censored = "D [mm]"', "modulus = 1e300",
)  # fmt: skip
DRAWS = STUDY[: STUDY.index("strength")] + 'strength = { draws = "FILE" }\n'
PULSE = """
[sphere]
material = "granite"
radius = "5 mm"
[bars]
material = "steel"
diameter = "20 mm"
incident_length = "2 m"
receiving_length = "2 m"
incident_end = "absorbing"
[pulse]
shape = "measured"
file = "FILE"
"""


def of_table(folder: Path, rng: random.Random) -> str:
    """A study of a mutated table."""
    match rng.randrange(5):
        case 0:
            text = as_file(mutated_rows(rng), folder, rng)
            return COLUMN.replace("FILE", text).replace("KEYS", rng.choice(KEYS))
        case 1:
            kinds = rng.choice((["weibull"], ["lognormal"], ["weibull", "lognormal"]))
            rows = [["distribution", "scale [MPa]", "shape", "tests"]]
            rows += [[rng.choice(kinds), f"{rng.gauss(5, 1):.2f}", "8", "20"] for _ in range(9)]
            return DRAWS.replace("FILE", as_file(mutated_rows(rng, rows), folder, rng))
        case 2:
            rows = [["t [us]", "e [1]"]]
            rows += [[f"{2 * k}", f"{min(k, 60 - k, 20) * 1e-5:.6f}"] for k in range(61)]
            return PULSE.replace("FILE", as_file(mutated_rows(rng, rows), folder, rng))
    text = STUDY.replace("FILE", as_file(mutated_rows(rng), folder, rng))
    if rng.random() < 0.5:
        text = text.replace("}", ', force_unit = "kN", diameter_unit = "mm" }')
    return text


def tried(seed: int, folder: Path) -> tuple[object, float, str]:
    """Exit code, CPU seconds and messages of `uqsphere check` on a mutant."""
    rng = random.Random(seed)
    if rng.random() < 0.5:
        path = rng.choice(sorted(shipped_studies().values()))
        for other in path.parent.glob("*.csv"):
            (folder / other.name).write_bytes(other.read_bytes())
        text = mutated_text(path.read_text("utf-8"), rng)
    else:
        text = of_table(folder, rng)
    study = folder / "study.toml"
    study.write_bytes(
        disguised(text, rng) if rng.random() < 0.2 else text.encode("utf-8", "replace")
    )
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
    """Codes of mutants by their number, and what failed; `trial`: with the rows for its time."""
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

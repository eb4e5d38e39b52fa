"""What a study or a table may be given: read, or refused by its own reason.

A reason is a statement: each refusal stands beside another cause, which must not be told in the
same words.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from uqsphere.documents import MOST_FAULTS
from uqsphere.errors import UqsphereError
from uqsphere.study import Study, load_study
from uqsphere.tables import LARGEST_NUMBER, TableError, read_table, unit_in_heading

FORCES = (6.1, 7.4, 5.2, 8.3, 6.8, 7.9, 5.9, 6.4, 7.1, 8.8)
SCENE = """
[sphere]
material = "granite"
radius = "10 mm"
[bars]
material = "maraging_steel"
diameter = "40 mm"
incident_length = "1.5 m"
receiving_length = "1.5 m"
[striker]
speed = "0.5 m/s"
length = "0.8 m"
[limits.crushing]
quantity = "p_max"
strength = { file = "tests.csv", force = "force", diameter = "diameter", platens = "rigid" }
"""
BOX = """
[inputs]
a = { dist = "normal", mean = 0.0, sd = 1.0 }
[outputs]
names = ["y"]
"""


def sheet(rows: list[list[Any]], path: Path, titles: Mapping[str, list[list[Any]]] | None = None):
    from openpyxl import Workbook

    book = Workbook()
    for title, own in (titles or {"Sheet": rows}).items():
        page = book.active if page_is_new(book) else book.create_sheet()
        page.title = title
        for row in own:
            page.append(row)
    book.save(path)


def page_is_new(book: Any) -> bool:
    return book.active.title == "Sheet" and book.active.max_row == 1 and len(book.worksheets) == 1


def table_of(forces: Any = FORCES, head: str = "force [kN],diameter [mm]") -> list[str]:
    return [head, *(f"{force},20" for force in forces)]


def study_of(folder: Path, *changes: tuple[str, str], lines: list[str] | None = None) -> Study:
    (folder / "tests.csv").write_text("\n".join(lines or table_of()) + "\n")
    text = SCENE
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    return load_study(folder / "study.toml", text=text)


def forces_of(study: Study) -> list[float]:
    tested = study.limits[0].tested
    assert tested is not None
    return [force / 1e3 for force in tested.forces]


def refusal(call: Callable[[], object]) -> str:
    with pytest.raises(UqsphereError) as caught:
        call()
    return str(caught.value)


# --- tables ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", ["#DIV/0!", "#N/A", "#VALUE!", "#REF!", "#NAME?", "#NUM!", "#NV"])
@pytest.mark.parametrize("row", ["{},20", "7.1,{}"])
def test_an_error_of_a_spreadsheet_is_no_comment(tmp_path: Path, error: str, row: str) -> None:
    lines = table_of()
    lines[4] = row.format(error)
    assert f"line 5: {'force' if row[0] == '{' else 'diameter'}" in refusal(
        lambda: study_of(tmp_path, lines=lines)
    )
    # a comment is none of it, and told
    lines[4] = "# broken before the test"
    study = study_of(tmp_path, lines=lines)
    assert len(forces_of(study)) == 9
    assert any("line 5: comments (#), left out" in warning for warning in study.warnings)


def test_an_empty_cell_of_one_column_is_no_empty_line(tmp_path: Path) -> None:
    changes = (('force = "force", diameter = "diameter"', 'column = "s [MPa]"'),)
    strength = ('platens = "rigid"', 'fit = "weibull"')
    lines = ["s [MPa]", "30", "34", "", "36", "33", "31"]
    text = refusal(lambda: study_of(tmp_path, *changes, strength, lines=lines))
    assert "line 4: s [MPa]: an empty cell" in text
    # those at the end are nothing, and in a table of two columns they are told
    study_of(tmp_path, *changes, strength, lines=[*lines[:3], *lines[4:], "", ""])
    two = table_of()
    two.insert(4, "")
    study = study_of(tmp_path, lines=two)
    assert len(forces_of(study)) == 10
    assert any("line 5: empty, left out" in warning for warning in study.warnings)


def test_a_mean_behind_an_empty_line_is_asked_about(tmp_path: Path) -> None:
    mean = f"{np.mean(FORCES):.2f},20"
    study = study_of(tmp_path, lines=[*table_of(), "", mean])
    asked = "line 12: empty, left out. If a mean stands below, delete it"
    assert any(asked in warning for warning in study.warnings)


@pytest.mark.parametrize(
    ("heading", "words"),
    [
        ("force [10 kN]", "has the factor '10'. Multiply the values by it and write [kN]"),
        ("force [x1000 N]", "has the factor 'x1000'"),
        ("force /10 kN", "has the factor '10'"),
        ("force [KN]", "'KN' is not a unit of this column; did you mean 'kN'?"),
        ("force [lbs]", "'lbs' is not a unit of this column; did you mean 'lbf'?"),
        ("force [kips]", "'kips' is not a unit of this column ("),
        ("force_Kn", "'Kn' is not a unit of this column; did you mean 'kN'?"),
        ("force", "the unit of the column 'force' is missing"),
        ("kN", "is 'kN' its unit? Write a name and [kN]"),
    ],
)
def test_a_unit_is_missing_unknown_or_has_a_factor(
    tmp_path: Path, heading: str, words: str
) -> None:
    change = ('force = "force"', f'force = "{heading}"')
    text = refusal(
        lambda: study_of(tmp_path, change, lines=table_of(head=f"{heading},diameter [mm]"))
    )
    assert words in text
    assert "[N]" not in text or "missing" in text  # no heading that makes it 1,000 times wrong
    other = "another"
    change = ('force = "force"', f'force = "{other}"')
    assert words not in refusal(
        lambda: study_of(tmp_path, change, lines=table_of(head=f"{heading},diameter [mm]"))
    )


@pytest.mark.parametrize(
    ("heading", "dimension", "unit"),
    [
        ("stress N/mm", "length", None),
        ("stress_N_mm", "length", None),
        ("energy J/mm", "length", None),
        ("speed in/s", "time", None),
        ("stress N/mm2", "pressure", "N/mm2"),
        # a symbol and its unit
        ("Weg s/mm", "length", "mm"),
        ("time t/ms", "time", "ms"),
        ("U V/mV", "voltage", "mV"),
        ("normal force N/kN", "force", "kN"),
    ],
)
def test_a_compound_unit_is_none_of_its_parts(
    heading: str, dimension: str, unit: str | None
) -> None:
    assert unit_in_heading(heading, dimension)[1] == unit


@pytest.mark.parametrize(
    ("key", "cells", "bounds", "says"),
    [
        ("strength", "s [GPa]\n4\n-4\n5\n6\n", "", "line 3: the strength against p_hertz must be"),
        ("strength", "s [GPa]\n4\n7\n5\n6\n", 'lower = "5 GPa"', "from 4e+09 to 7e+09 lie outside"),
        ("strength", "s [GPa]\n4\n7\n5\n6\n", 'upper = "6 GPa"', "from 4e+09 to 7e+09 lie outside"),
        ("radius", "s [mm]\n9\n0\n10\n11\n", "", "line 3: radius of the sphere must be above 0"),
    ],
)
def test_an_observation_has_a_meaning_and_lies_within_its_bounds(
    tmp_path: Path, key: str, cells: str, bounds: str, says: str
) -> None:
    """The law was cut, though the tests show what was cut off."""
    number = ", ".join(filter(None, ['{ file = "tests.csv", column = "s"', bounds])) + " }"
    old = SCENE[SCENE.index(f"{key} =") :].partition("\n")[0]
    text = SCENE.replace(old, f"{key} = {number}")
    (tmp_path / "tests.csv").write_text(cells)
    assert says in refusal(lambda: load_study(tmp_path / "study.toml", text=text))


def test_a_rate_of_tests_is_not_negative(tmp_path: Path) -> None:
    rate = ('platens = "rigid"', 'platens = "rigid", rate = "rate"')
    rows = [f"{force},20,{k - 1}" for k, force in enumerate(FORCES)]
    lines = ["force [kN],diameter [mm],rate [kN/s]", *rows]
    text = refusal(lambda: study_of(tmp_path, rate, lines=lines))
    assert "line 2: the rate must be above 0" in text
    lines[1] = "6,20,0"
    assert study_of(tmp_path, rate, lines=lines).limits


def test_a_title_stands_above_the_headings(tmp_path: Path) -> None:
    change = ('"tests.csv"', '"tests.xlsx"')
    rows: list[list[Any]] = [[], [None, "Campaign of May"], [], [None, "force", "diameter"]]
    rows += [[None, "kN", "mm"], *([None, force, 20.0] for force in FORCES)]
    sheet(rows, tmp_path / "tests.xlsx")
    study = study_of(tmp_path, change)
    assert forces_of(study) == pytest.approx(FORCES)
    assert any("line 2: above the headings, left out" in warning for warning in study.warnings)
    # a cell beyond the headings has another cause
    rows[7].append("cracked")
    sheet(rows, tmp_path / "tests.xlsx")
    text = refusal(lambda: study_of(tmp_path, change))
    assert "line 8: more cells than headings" in text
    assert "a title?" not in text
    assert "comma" not in text


def test_the_preamble_of_an_instrument_stands_above_the_headings(tmp_path: Path) -> None:
    lines = ["Model,TDS 2014", "Record Length,10", "Sample Interval,1e-6,s", "force,diameter"]
    (tmp_path / "t.csv").write_text("\n".join([*lines, "kN,mm", *table_of()[1:]]))
    table = read_table(tmp_path / "t.csv")
    assert table.numbers("force", "force").tolist() == pytest.approx([1e3 * f for f in FORCES])
    assert table.numbers("diameter", "length").tolist() == pytest.approx([0.02] * 10)
    assert "lines 1, 2, 3: above the headings, left out" in table.notes[0]


def test_formulas_and_sheets_of_a_workbook(tmp_path: Path) -> None:
    change = ('"tests.csv"', '"tests.xlsx"')
    head = ["force [kN]", "diameter [mm]"]
    plain = [head, *([force, 20.0] for force in FORCES)]
    formula = [head, *([f"={force}*1", 20.0] for force in FORCES[:2]), *plain[3:]]
    sheet(formula, tmp_path / "tests.xlsx")
    text = refusal(lambda: study_of(tmp_path, change))
    assert "lines 2, 3: force: a formula without a stored value" in text
    sheet([head, [None, 20.0], *plain[2:]], tmp_path / "tests.xlsx")
    text = refusal(lambda: study_of(tmp_path, change))
    assert "line 2: force: an empty cell" in text
    assert "a formula without" not in text
    # a column of formulas alone: rows that held nothing else were left out without a word
    (tmp_path / "one").mkdir()
    sheet([["x"], *[[f"={k}"] for k in range(3)], [1.0], [2.0]], tmp_path / "one" / "t.xlsx")
    table = read_table(tmp_path / "one" / "t.xlsx")
    table.numbers("x")
    with pytest.raises(TableError, match="lines 2, 3, 4: x: a formula without a stored value"):
        table.check()
    # data on another sheet
    pages = {"Notes": [["see the other sheet"]], "Data": plain}
    sheet([], tmp_path / "tests.xlsx", pages)
    text = refusal(lambda: study_of(tmp_path, change))
    assert "the sheet 'Notes' is read; other sheets: 'Data' (sheet = \"Data\")" in text
    named = (change, ('diameter = "diameter"', 'diameter = "diameter", sheet = "Data"'))
    assert forces_of(study_of(tmp_path, *named)) == pytest.approx(FORCES)
    wrong = (change, ('diameter = "diameter"', 'diameter = "diameter", sheet = "data"'))
    text = refusal(lambda: study_of(tmp_path, *wrong))
    assert "there is no sheet 'data' in 'tests.xlsx', which has 'Notes', 'Data'" in text
    text = refusal(lambda: study_of(tmp_path, *named[1:]))
    assert "sheet belongs to workbooks" in text


@pytest.mark.parametrize("value", ["1e308", "-1e308", "1e151"])
@pytest.mark.parametrize("fit", ["kde", "gumbel", "normal", "steps", "lognormal"])
def test_a_number_without_a_square_is_refused_with_its_column(
    tmp_path: Path, value: str, fit: str
) -> None:
    (tmp_path / "t.csv").write_text(f"x\n{value}\n5\n6\n7\n8\n")
    law = f'{{ file = "t.csv", column = "x", fit = "{fit}" }}'
    text = BOX.replace('{ dist = "normal", mean = 0.0, sd = 1.0 }', law)
    message = refusal(lambda: load_study(tmp_path / "study.toml", text=text))
    assert "line 2: x: a number is too large" in message
    assert abs(float(value)) > LARGEST_NUMBER


def test_a_workbook_of_very_many_cells_is_refused_at_once(tmp_path: Path) -> None:
    """What is repeated packs well: 20 MB of cells in 0.1 MB."""
    import shutil
    import zipfile

    sheet([["x"], [1.0]], tmp_path / "t.xlsx")
    cells = "".join(f'<row r="{k}"><c r="A{k}"><v>1</v></c></row>' for k in range(1, 500_001))
    with (
        zipfile.ZipFile(tmp_path / "t.xlsx") as small,
        zipfile.ZipFile(tmp_path / "large.xlsx", "w", zipfile.ZIP_DEFLATED) as large,
    ):
        for item in small.infolist():
            content = small.read(item)
            if item.filename.startswith("xl/worksheets/"):
                start = content.index(b"<sheetData>") + len(b"<sheetData>")
                end = content.index(b"</sheetData>")
                content = content[:start] + cells.encode() + content[end:]
            large.writestr(item.filename, content)
    began = time.process_time()
    with pytest.raises(TableError, match=r"more than 400,000 cells\. Save the sheet as CSV"):
        read_table(tmp_path / "large.xlsx")
    assert time.process_time() - began < 5.0
    shutil.copy(tmp_path / "t.xlsx", tmp_path / "large.xlsx")
    assert read_table(tmp_path / "large.xlsx").numbers("x").tolist() == [1.0]


# --- studies --------------------------------------------------------------------------------------

HEXADECIMAL = "0x" + "f" * 3700


@pytest.mark.parametrize(
    "text",
    [
        f"seed = {HEXADECIMAL}\n{BOX}",
        f"title = {HEXADECIMAL}\n{BOX}",
        f"other = {HEXADECIMAL}\n{BOX}",
        BOX.replace("0.0", HEXADECIMAL),
        BOX.replace("sd = 1.0", f"sd = {HEXADECIMAL}"),
        f"{BOX}b = {HEXADECIMAL}\n",
        f"{BOX}[analysis]\nbudget = {{ evaluations = {HEXADECIMAL} }}\n",
        f'{BOX}[limits.a]\nquantity = "y"\nstrength = {HEXADECIMAL}\n',
        f'{BOX}[limits.a]\nquantity = "y"\nstrength = 1.0\ntarget = {HEXADECIMAL}\n',
        f'{BOX}[[dependence]]\nof = ["a", "b"]\nspearman = {HEXADECIMAL}\n',
    ],
)
def test_a_long_hexadecimal_number_is_refused_with_its_key(text: str) -> None:
    message = refusal(lambda: load_study(text=text))
    assert message.endswith("this whole number is too large")
    decimal = text.replace(HEXADECIMAL, "1" * 5000)
    assert "too large" not in refusal(lambda: load_study(text=decimal))


@pytest.mark.parametrize(
    "text",
    [
        BOX + "".join(f"k{k} = 1\n" for k in range(8000)),
        "".join(f"k{k} = 1\n" for k in range(8000)) + BOX,
        BOX.replace("sd = 1.0", "sd = 1.0, " + ", ".join(f"k{k} = 1" for k in range(4000))),
        BOX + "[limits.a]\n" + "".join(f"k{k} = 1\n" for k in range(8000)),
    ],
)
def test_refusing_many_keys_is_cheap(text: str) -> None:
    began = time.process_time()
    message = refusal(lambda: load_study(text=text))
    assert time.process_time() - began < 5.0
    assert len(message.splitlines()) <= MOST_FAULTS + 1


def test_shapes_that_no_law_has_are_refused_at_once() -> None:
    began = time.process_time()
    law = '{ dist = "scipy.nct", df = 1e-9, nc = 1e9 }'
    text = BOX.replace('{ dist = "normal", mean = 0.0, sd = 1.0 }', law)
    assert "df must be between 1e-4 and 1e5" in refusal(lambda: load_study(text=text))
    assert time.process_time() - began < 5.0
    other = text.replace("df = 1e-9, nc = 1e9", "df = 4.0, nc = 1.0, x = 1.0")
    assert "must be between" not in refusal(lambda: load_study(text=other))


@pytest.mark.parametrize(
    ("text", "words", "other"),
    [
        (
            BOX + '[limits.a]\nquantity = "y"\nstrength = { dist = "normal",\n mean = 1.0 }\n',
            "a table in braces stands on one line",
            BOX + '[limits.a]\nquantity = "y\n',
        ),
        (
            BOX.replace(
                '{ dist = "normal", mean = 0.0, sd = 1.0 }',
                '{ file = "d\\tests.csv", column = "a" }',
            ),
            "has a control character",
            BOX.replace(
                '{ dist = "normal", mean = 0.0, sd = 1.0 }',
                '{ file = "d/tests.csv", column = "a" }',
            ),
        ),
        (
            SCENE.replace('radius = "10 mm"', 'diameter = "20 mm"'),
            'unknown key "diameter": give radius, which is half of it',
            SCENE.replace('radius = "10 mm"', 'radii = "20 mm"'),
        ),
        (
            SCENE.replace('radius = "10 mm"', 'radius = "10 mm"\nG = "20 GPa"'),
            'unknown key "G": give E = 2 G (1 + nu)',
            SCENE.replace('radius = "10 mm"', 'radius = "10 mm"\nK = "20 GPa"'),
        ),
        (
            SCENE.replace('radius = "10 mm"', 'radius = "10 mm"\nE = "52 gpa"'),
            'did you mean "52 GPa"?',
            SCENE.replace('radius = "10 mm"', 'radius = "10 mm"\nE = "52 kg"'),
        ),
        *(
            (
                SCENE.replace('radius = "10 mm"', f'radius = "{text}"'),
                "is a range. Write a distribution",
                SCENE.replace('radius = "10 mm"', 'radius = "10 -mm"'),
            )
            for text in ("9-11 mm", "9 mm - 11 mm", "10 ± 1 mm", "9 to 11 mm", "9…11 mm")
        ),
        (
            BOX.replace("normal", "gaussian"),
            "did you mean 'normal'?",
            BOX.replace("normal", "bell"),
        ),
        (
            BOX.replace("mean", "mu"),
            "did you mean 'mean'?",
            BOX.replace("mean", "middle"),
        ),
        (BOX.replace(" }", ", }"), "no comma stands before }", BOX.replace(" }", ",, x }")),
        (
            BOX.replace('["y"]', '["y"];'),
            "no ; stands at the end of a line",
            BOX.replace('["y"]', '["y"] x'),
        ),
        (
            BOX.replace("[outputs]", "// what it answers\n[outputs]"),
            "a comment begins with #",
            BOX.replace("[outputs]", "? what it answers\n[outputs]"),
        ),
        (
            BOX.replace("names = ", "names: "),
            "a key and its value are separated by =",
            BOX.replace("names = ", "names "),
        ),
    ],
)
def test_a_slip_is_told_with_its_way_out(text: str, words: str, other: str) -> None:
    assert words in refusal(lambda: load_study(text=text))
    assert words not in refusal(lambda: load_study(text=other))


def test_file_names_reach_the_terminal_clean(tmp_path: Path) -> None:
    name = "e\x1b[2J\x1b]0;x\x07\u202e.csv"
    (tmp_path / name).write_text("x\n1\nbad\n2\n")
    table = read_table(tmp_path / name)
    table.numbers("x")
    assert refusal(table.check).isprintable()
    study = tmp_path / name.replace("csv", "toml")
    study.write_text(BOX + "[nothing]\n")
    assert refusal(lambda: load_study(study)).isprintable()
    assert refusal(lambda: load_study(tmp_path / "e\x1b[2J.toml")).isprintable()


@pytest.mark.parametrize(
    ("unit", "near"), [("KN", "kN"), ("lbs", "lbf"), ("kg", "kgf"), ("GN", ""), ("kips", "")]
)
def test_the_unit_of_a_key_is_offered(tmp_path: Path, unit: str, near: str) -> None:
    change = ('force = "force"', f'force = "force", force_unit = "{unit}"')
    lines = table_of(head="force,diameter [mm]")
    text = refusal(lambda: study_of(tmp_path, change, lines=lines))
    assert f"force_unit must be one of N, mN, kN, MN, kgf, tf, lbf, not '{unit}'" in text
    assert text.endswith(f"did you mean '{near}'?" if near else f"'{unit}'")
    # no unit at all is another cause
    assert "must be one of" not in refusal(lambda: study_of(tmp_path, lines=lines))

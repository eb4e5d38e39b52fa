"""Tables as they come from instruments and Excel: read alike, or refused with their lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from uqsphere.errors import StudyError
from uqsphere.study import load_study
from uqsphere.tables import TableError, read_table, unit_in_heading

PLAIN = "D,F\n14.9,7.42\n15.1,9.85\n15,8.31\n"

#: the same three tests, as various people save them
ALIKE = {
    "commas": PLAIN.encode(),
    "mark, CRLF, quotes": b'\xef\xbb\xbf"D","F"\r\n"14.9","7.42"\r\n15.1,9.85\r\n15,8.31\r\n',
    "German Excel": b"D;F\n14,9;7,42\n15,1;9,85\n15;8,31\n",
    "tabs": PLAIN.replace(",", "\t").encode(),
    "UTF-16": PLAIN.replace(",", "\t").encode("utf-16"),
    "comments, blanks": ("# made by hand\n\n" + PLAIN + "\n,\n").encode(),
    "marks of Unicode in a note": (
        "D,F,n\n14.9,7.42,a\u2028b\n15.1,9.85,\x0b\n15,8.31,\x85\n".encode()
    ),
    "Excel's own first line": b"sep=;\nD;F\n14,9;7,42\n15,1;9,85\n15;8,31\n",
    "empty last column": b"D,F,\n14.9,7.42,\n15.1,9.85,\n15,8.31,\n",
}


@pytest.mark.parametrize("data", ALIKE.values(), ids=ALIKE)
def test_one_table_in_many_forms(data: bytes, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(data)
    table = read_table(tmp_path / "t.csv")
    assert table.numbers("F", "force", "kN").tolist() == pytest.approx(
        [7420.0, 9850.0, 8310.0], rel=1e-15
    )
    assert table.numbers("D", "length", "mm").tolist() == pytest.approx(
        [14.9e-3, 15.1e-3, 15e-3], rel=1e-15
    )
    table.finish()


def test_a_workbook_that_shows_percentages_is_noted(tmp_path: Path) -> None:
    """A sheet shows 5 % where it holds 0.05: below [%] a factor of a hundred would lie between."""
    from openpyxl import Workbook

    book = Workbook()
    book.active.append(["t [s]", "strain [%]"])
    for k in range(3):
        book.active.append([k, 0.05 * (k + 1)])
    book.save(tmp_path / "t.xlsx")
    assert not read_table(tmp_path / "t.xlsx").notes
    for k in range(3):
        book.active.cell(k + 2, 2).number_format = "0.0%"
    book.save(tmp_path / "t.xlsx")
    table = read_table(tmp_path / "t.xlsx")
    assert table.notes == ["t.xlsx: cells that show a percentage are read as shares, 5 % as 0.05"]
    assert table.numbers("strain", "strain").tolist() == [0.0005, 0.001, 0.0015]


def test_a_workbook_and_windows_text(tmp_path: Path) -> None:
    from openpyxl import Workbook

    book = Workbook()
    for row in [["Größe [mm]", "Kraft_kN"], [14.9, 7.42], [15.1, 9.85], [None, None]]:
        book.active.append(row)
    book.save(tmp_path / "t.xlsx")
    (tmp_path / "t.csv").write_bytes("Größe [mm];Kraft_kN\n14,9;7,42\n15,1;9,85\n".encode("cp1252"))
    for name in ("t.xlsx", "t.csv"):
        table = read_table(tmp_path / name)
        assert table.numbers("Größe", "length").tolist() == pytest.approx([14.9e-3, 15.1e-3])
        assert table.numbers("Kraft", "force").tolist() == pytest.approx([7420.0, 9850.0])
    assert "cp1252" in table.notes[0]
    (tmp_path / "u.csv").write_text("D,F,note\nmm,kN,-\n14.9,7.42,total loss\n")
    book.create_sheet("more").append(["x"])
    book.save(tmp_path / "t.xlsx")
    assert (
        "t.xlsx: the sheet 'Sheet' is read; other sheets: 'more'"
        in read_table(tmp_path / "t.xlsx").notes[0]
    )
    table = read_table(tmp_path / "u.csv")
    assert table.numbers("F", "force").tolist() == [7420.0]
    table.finish()


def test_workbooks_that_are_larger_than_they_seem(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One cell in the last place of a sheet; a sheet that unpacks to more than is read; zeros are
    no empty rows.
    """
    from openpyxl import Workbook

    book, path = Workbook(), tmp_path / "t.xlsx"
    for row in [["D", "F"], [0, 0], [1, 2]]:
        book.active.append(row)
    book.save(path)
    assert read_table(path).numbers("F").tolist() == [0.0, 2.0]
    book.active["XFD1048576"] = 1
    book.save(path)
    with pytest.raises(TableError, match="line 1048576: more cells than headings"):
        read_table(path)
    monkeypatch.setattr("uqsphere.tables.LARGEST", 1000)
    with pytest.raises(TableError, match="unpacks to"):
        read_table(path)


@pytest.mark.parametrize(
    ("heading", "dimension", "found"),
    [
        ("force/kN", "force", ("force", "kN")),
        ("force (kN)", "force", ("force", "kN")),
        ("force [kN]", "force", ("force", "kN")),
        ("force in kN", "force", ("force", "kN")),
        ("force, kN", "force", ("force", "kN")),
        ("mean_rate_kN_s", "loading_rate", ("mean_rate", "kN/s")),
        ("specific energy (J/kg)", "specific_energy", ("specific energy", "J/kg")),
        ("force_kN", "length", ("force_kN", None)),
        ("m", "length", ("m", None)),
        ("force (peak) [kN]", "force", ("force (peak)", "kN")),
        ("force [kN] (peak)", "force", ("force", "kN")),
        ("K_Ic [MPa.sqrt(m)]", "toughness", ("K_Ic", "MPa.sqrt(m)")),
        ("P10 in kN", "force", ("P10", "kN")),
        ("run 10 [mm]", "length", ("run 10", "mm")),
        # a factor is never dropped
        ("stress [10 MPa]", "pressure", ("stress [10 MPa]", None)),
        ("stress [x10 MPa]", "pressure", ("stress [x10 MPa]", None)),
        ("stress [10^3 MPa]", "pressure", ("stress [10^3 MPa]", None)),
        ("stress [MPa x 10]", "pressure", ("stress [MPa x 10]", None)),
        ("stress x 10 [MPa]", "pressure", ("stress x 10 [MPa]", None)),
        ("stress [MPa] (n=10)", "pressure", ("stress", "MPa")),
        ("stress (MPa) x 10", "pressure", ("stress (MPa) x 10", None)),
        ("stress /10 MPa", "pressure", ("stress /10 MPa", None)),
        ("stress in 10 MPa", "pressure", ("stress in 10 MPa", None)),
        ("stress, 10 MPa", "pressure", ("stress, 10 MPa", None)),
        ("stress_1e3_MPa", "pressure", ("stress_1e3_MPa", None)),
        ("time [0.1 us]", "time", ("time [0.1 us]", None)),
        ("force[x1000 N]", "force", ("force[x1000 N]", None)),
        # a unit of another quantity is none of this one
        ("energy_J/kg", "mass", ("energy_J/kg", None)),
        ("energy J per kg", "mass", ("energy J per kg", None)),
        ("rate_kN_s", "time", ("rate_kN_s", None)),
        ("v m/s", "time", ("v m/s", None)),
        ("Masse m/kg", "mass", ("Masse m", "kg")),
        # an inner diameter is no inch
        ("D_in", "length", ("D_in", None)),
        ("D [in]", "length", ("D", "in")),
    ],
)
def test_units_in_headings(heading: str, dimension: str, found: tuple[str, str | None]) -> None:
    assert unit_in_heading(heading, dimension) == found


#: text of the table, and what its one message says
FAULTY = {
    "an empty cell": ("D,F\n14.9,7.42\n15.1,\n15,8\n15,\n", "t.csv: lines 3, 5: F: an empty cell"),
    "a text": (
        "D,F\n14.9,7.42\n15.1,broken\n",
        "line 3: F: 'broken' is not a number",
    ),
    "a unit in a cell": ("D,F\n14.9,7.42 kN\n", "line 2: F: '7.42 kN' is not a number"),
    "a mark of thousands": ("D;F\n14,9;1.234,5\n15;7,4\n", "line 2: F: a mark of thousands"),
    "a thousands dot among whole numbers": (
        "D,F\n14,2.830\n15,2260\n",
        "line 2: F: '2.830' beside '2260': a mark of thousands?",
    ),
    "thousands dots beside decimal commas": (
        "D;F\n14,9;2.830\n15,1;2.260\n",
        "lines 2, 3: F: a mark of thousands",
    ),
    "thousands commas beside points": (
        'D,F\n14.9,"2,830"\n15.1,"2,260"\n',
        "lines 2, 3: F: a mark of thousands",
    ),
    "whole numbers beside thousands dots": (
        "D;F\n14;2.830\n15;950\n",
        "'2.830' beside '950': a mark of thousands?",
    ),
    "pasted with its headings": (
        "D,F\n1,2\nD,F\n1,2\n",
        "t.csv: line 3: the headings are repeated; pasted twice?",
    ),
    "comma or thousands": ("D;F\n14;2,830\n15;2,260\n", 'add decimal = ","'),
    "two decimal marks": ("D;F\n14;2,83\n15;2.26\n", "decimal point and comma in one column"),
    "summary rows": (
        "n;F\n1;7.42\n2;9.85\nMittelwert;8.6\nsd;1.7\n",
        "lines 4, 5: this is a summary row",
    ),
    "summary rows of other languages": (
        "n;F\n1;7.42\n2;9.85\npromedio;8.6\nÉcart-type;1.7\nØ;2\n",
        "lines 4, 5, 6: this is a summary row",
    ),
    "errors of spreadsheets": (
        "F\n1\n#¡DIV/0!\n2\n#GETTING_DATA\n#DIV/0\n",
        "lines 3, 5, 6: F: '#¡DIV/0!' is not a number",
    ),
    "columns divided by bars": ("D|F\n1|2\n", "divide columns by commas, semicolons or tabs"),
    "a decimal comma in one column": ("F\n14,9\n15,1\n", "A decimal comma between commas?"),
    "a decimal comma between commas": ("D,F\n14,9,7,42\n", "line 2: more cells than headings"),
    "a decimal comma in one row": ("D,F\n14.9,7.42\n14,9,7\n", "Save the file with semicolons"),
    "a unit of another system in a row": ("F,D\nkips,in\n3,1\n", "'kips' is not a unit of this"),
    "a factor in a row of units": ("F,D\n10 kN,mm\n3,1\n", "has the factor '10'. Multiply"),
    "no such column": ("D,G\n1,2\n", "the column 'F' is not in 't.csv', which has 'D', 'G'"),
    "a column twice": ("F,F\n1,2\n", "'F' is twice or more in"),
    "headings alone": ("D,F\n", "no row below its headings"),
    "nothing": ("\n\n", "'t.csv' is empty"),
    "bytes": ("\0\0\0\1\2\3", "is not a text file"),
    "too large": ("D,F\n1,1e999\n", "a number is too large"),
    "a text in quotes over two lines": (
        'D,F\n1,"2\n3",4\n',
        "a text in quotes extends over several lines",
    ),
    "a long text": (
        "D,F\n1," + "x" * 5000 + "\n",
        "line 2: F: '" + "x" * 59 + "…' is not a number",
    ),
    "a long line": (
        "D,F\n1,2" + " " * 200_000 + "\n",
        "a line of 200,003 characters; 100,000 are read at most",
    ),
    "many columns": (
        "F" + ",x" * 9000 + "\n1" + ",2" * 9000,
        "9,001 columns; 2,000 are read at most",
    ),
    "a long heading": ("F" + "_" * 90_000 + "\n1", "the column 'F' is not in"),
}


@pytest.mark.parametrize(("text", "said"), FAULTY.values(), ids=FAULTY)
def test_faults_name_their_lines(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_bytes(text.encode())

    def read() -> None:
        table = read_table(tmp_path / "t.csv")
        table.numbers("F", "force" if "mm" in text or "kips" in text else "number", key="force")
        table.finish()

    with pytest.raises(TableError) as caught:
        read()
    assert said in str(caught.value)


def test_all_faults_of_a_kind_are_one_message(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("D,F\n" + "1,\n" * 30 + "x,2\n")
    table = read_table(tmp_path / "t.csv")
    for name in ("D", "F"):
        table.numbers(name)
    with pytest.raises(TableError) as caught:
        table.finish()
    lines = str(caught.value).splitlines()
    assert len(lines) == 2
    assert "lines 2, 3, 4, 5, 6, 7, 8, 9 and 22 more: F: an empty cell" in lines[1]


def test_rows_pasted_twice_are_noted(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    rows = [
        f"{d:.1f},{f:.0f}"
        for d, f in zip(rng.normal(12, 0.4, 25), rng.normal(2500, 600, 25), strict=True)
    ]
    for more, said in (
        (rows, "repeat earlier rows: pasted twice?"),
        ([], None),
        (["12.0,3000"] * 30, None),  # stopped at one load
    ):
        (tmp_path / "t.csv").write_text("\n".join(["D,F", *rows, *more]))
        table = read_table(tmp_path / "t.csv")
        table.numbers("F")
        table.finish()
        assert [said in note for note in table.notes] == ([True] if said else [])


@pytest.mark.parametrize(
    ("above", "lines"),
    [
        ("Tests of May, granite\n", "line 1"),
        ("Operator,Smith\nRate [1/s],2.5\n\n", "lines 1, 2"),
        ("Brazilian tests\nLab,X\n", "lines 1, 2"),
    ],
)
def test_headings_with_units_stand_below_a_preamble(above: str, lines: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"{above}probe,F [kN]\na,1\nb,2\n")
    table = read_table(tmp_path / "t.csv")
    assert table.numbers("F", "force").tolist() == [1000.0, 2000.0]
    assert f"{lines}: above the headings, left out" in table.notes[0]


def test_units_come_from_the_key_or_the_heading_and_must_agree(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("F [kN],D\n1,2\n")
    table = read_table(tmp_path / "t.csv")
    assert table.numbers("F", "force", key="force").tolist() == [1000.0]
    for unit, said in (
        ("N", "the heading 'F [kN]' has 'kN'"),
        ("mm", "force_unit must be one of N, mN, kN"),
    ):
        with pytest.raises(TableError) as caught:
            table.numbers("F", "force", unit, key="force")
        assert said in str(caught.value)
        assert caught.value.key == "force_unit"
    with pytest.raises(TableError, match='or add diameter_unit = "m"'):
        table.numbers("D", "length", key="diameter")


def test_a_column_without_a_heading_has_its_number(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("n,,,x\n1,a,2,3\n3,4,5,6\n")
    box = '[inputs]\nx = { file = "t.csv", column = "2" }\n[outputs]\nnames = ["y"]\n'
    with pytest.raises(StudyError, match=r"t\.csv: line 2: column 2: 'a' is not a number"):
        load_study(tmp_path / "s.toml", text=box)
    with pytest.raises(TableError, match=r"unit of the column 'column 3'.*\"column 3 \[m\]\""):
        read_table(tmp_path / "t.csv").numbers(3, "length")

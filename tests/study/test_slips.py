"""Slips of units, of columns and of fractions: the first words of a refusal name the slip, and
cautions name the line of their key.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from uqsphere.errors import StudyError
from uqsphere.study import Study, load_study

SCENE = """\
[sphere]
material = "limestone"
radius = "6 mm"
[bars]
material = "steel"
diameter = "40 mm"
incident_length = "2 m"
receiving_length = "2 m"
[striker]
speed = "0.5 m/s"
length = "0.5 m"
[limits.a]
criterion = "core_tension"
strength = { file = "t.csv", force = "F", diameter = "D", platens = "rigid", UNITS }
target = 0.02
"""
PLAIN = SCENE[: SCENE.index("strength =")] + 'strength = "4 MPa"\n' + SCENE[SCENE.index("target") :]
FORCES = np.array([2.55, 2.45, 2.76, 2.54, 2.29, 2.64, 3.02, 2.88, 2.22, 1.99, 2.25, 2.52])
DIAMETERS = np.array([11.5, 12.0, 11.9, 12.1, 12.2, 11.8, 12.0, 12.3, 11.7, 12.1, 11.9, 12.0])
#: forces and diameters as they stand in the file, the units of the study, and what is asked
SLIPS = {
    "a force 1,000 times too large": (
        (np.r_[1e3 * FORCES[:1], FORCES[1:]], DIAMETERS),
        ("kN", "mm"),
        "line 2: the force is 1,0",
    ),
    "a diameter in um": (
        (FORCES, np.r_[1e3 * DIAMETERS[:1], DIAMETERS[1:]]),
        ("kN", "mm"),
        "line 2: the diameter is 9",
    ),
    "columns swapped": ((DIAMETERS, FORCES), ("kN", "mm"), "force and diameter swapped?"),
    "N given as kN": ((1e3 * FORCES, DIAMETERS), ("kN", "mm"), "is the unit N?"),
    "mm given as m": ((FORCES, 1e-3 * DIAMETERS), ("kN", "mm"), "is the unit m?"),
}


def refused(folder: Path, text: str) -> str:
    with pytest.raises(StudyError) as caught:
        load_study(folder / "study.toml", text=text)
    return str(caught.value)


def of_tests(
    folder: Path, columns: tuple[np.ndarray, np.ndarray], units: tuple[str, str], heading: bool
) -> str:
    """The study of a table of tests, whose units are keys or stand in its headings."""
    force, diameter = units
    head, keys = "F,D", f'force_unit = "{force}", diameter_unit = "{diameter}"'
    if heading:
        head, keys = f"F [{force}],D [{diameter}]", "synthetic = false"
    rows = [f"{F:.6g},{D:.6g}" for F, D in zip(*columns, strict=True)]
    (folder / "t.csv").write_text("\n".join([head, *rows]) + "\n")
    return SCENE.replace("UNITS", keys)


@pytest.mark.parametrize("heading", [True, False])
def test_a_slip_in_the_tests_is_asked_about_first(tmp_path: Path, heading: bool) -> None:
    messages = {
        name: refused(tmp_path, of_tests(tmp_path, columns, units, heading))
        for name, (columns, units, _) in SLIPS.items()
    }
    for name, (_, _, words) in SLIPS.items():
        message = messages.pop(name)
        assert message.index(words) < message.index("As it is, "), message
        # another slip is asked about in its own words
        assert not [other for other in messages.values() if words in other]
        messages[name] = message


def test_tests_in_order_are_not_asked_about(tmp_path: Path) -> None:
    study = load_study(
        tmp_path / "study.toml",
        text=of_tests(tmp_path, (FORCES, DIAMETERS), ("kN", "mm"), heading=True),
    )
    assert not [caveat for caveat in study.caveats if caveat[0] == "unit"]
    # a criterion that cannot say it is told by itself
    broad = of_tests(tmp_path, (20 * FORCES, DIAMETERS), ("kN", "mm"), heading=True)
    message = refused(tmp_path, broad)
    assert "insensitive" in message
    assert "As it is" not in message


def test_a_radius_in_m_is_asked_about_before_the_bar(tmp_path: Path) -> None:
    text = PLAIN.replace("6 mm", "6 m")
    message = refused(tmp_path, text)
    assert message.startswith(f"{tmp_path}/study.toml:3: sphere.radius: 6000 mm is unusual")
    assert "bars.diameter must be at least 12000 mm" in message
    thick = PLAIN.replace("6 mm", "30 mm")
    assert "is unusual" not in refused(tmp_path, thick)
    # what no number can bring about stands alone
    assert "is unusual" not in refused(tmp_path, text.replace("target = 0.02", "target = 2"))


@pytest.mark.parametrize(
    ("value", "words", "hint"),
    [
        ("5", "must be a fraction above 0 and below 1", 'did you mean "5 %"?'),
        ("1", "must be a fraction above 0 and below 1", 'did you mean "1 %"?'),
        ('"2"', "must be a fraction above 0 and below 1", 'did you mean "2 %"?'),
        ("0", 'such as 0.02 or "2 %", not 0', ""),
        ('"200 %"', 'such as 0.02 or "2 %", not "200 %"', ""),
        ('"1,5 %"', "has a decimal comma", ""),
        ("true", "must be a number, not true", ""),
    ],
)
@pytest.mark.parametrize(
    "key", ["limits.a.target", "analysis.quantiles", "analysis.on_failure", "for_probability"]
)
def test_a_fraction_says_how_it_is_written(
    tmp_path: Path, key: str, value: str, words: str, hint: str
) -> None:
    text = PLAIN.replace("target = 0.02\n", "")
    if key == "limits.a.target":
        text += f"target = {value}\n"
    elif key == "for_probability":
        text += "[margins]\nsolve = 'striker.speed'\nbetween = ['1 m/s', '2 m/s']\n"
        text += f"for_probability = [0.1, {value}]\n"
    else:
        name, listed = key.split(".")[1], key.endswith("s")
        text += f"[analysis]\n{name} = {f'[{value}]' if listed else value}\n"
    if key == "analysis.on_failure" and value == '"2"':
        words, hint = "must be 'abort', 'bound' or 'drop'", ""
    if key == "analysis.on_failure" and value == '"1,5 %"':
        words = "has a decimal comma"
    message = refused(tmp_path, text)
    assert len(message.splitlines()) == 1, message
    assert words in message
    assert hint in message
    assert ("did you mean" in message) == bool(hint)


def test_a_key_that_was_not_written_is_not_named() -> None:
    long = {"material": "steel", "diameter": "40 mm", "incident_length": "2 m"}
    scene = {
        "bars": {**long, "receiving_length": "2 m"},
        "striker": {"speed": "1 m/s", "length": "0.5 m"},
    }
    sphere = {"material": "granite", "radius": "6 mm"}
    with pytest.raises(StudyError, match=r"sphere\.nu: Poisson ratio of the sphere must be"):
        Study(**scene, sphere={**sphere, "nu": stats.triang(0.9, -2.0, 2.3)})
    table = {"dist": "triangular", "lower": -2.0, "upper": 0.3, "mode": 0.2}
    with pytest.raises(StudyError, match=r"sphere\.nu\.lower: Poisson ratio of the sphere must be"):
        Study(**scene, sphere={**sphere, "nu": table})


def test_a_caution_names_the_line_of_its_key(tmp_path: Path) -> None:
    text = PLAIN.replace('"0.5 m/s"', '"0.2 mm/s"')
    text = text.replace("4 MPa", "4 Pa")
    study = load_study(tmp_path / "s.toml", text=text)
    assert [warning.partition(" is ")[0] for warning in study.warnings] == [
        "s.toml:10: striker.speed: 0.0002 m/s",
        "s.toml:14: limits.a.strength: 4e-06 MPa",
        "s.toml:14: limits.a.strength: 4e-06 MPa",
    ]
    # one without a key has no line, and tables have no file
    tables = {
        "inputs": {"x": {"dist": "normal", "mean": 1.0, "sd": 1.5}},
        "outputs": "y",
    }
    (warning,) = Study(**tables).warnings
    assert warning.startswith("inputs.x: the coefficient of variation is 1.5")


LOOKALIKES = {
    "a minus sign": ('"6 mm"', '"\N{MINUS SIGN}6 mm"', "must be above 0 mm"),
    "a full-width digit": ('"6 mm"', '"\uff16 mm"', "U+FF16 is FULLWIDTH DIGIT SIX"),
    "a Cyrillic letter": ('"6 mm"', '"6 \u043cm"', "U+043C is CYRILLIC SMALL LETTER EM"),
    "a blank that cannot be seen": ('"6 mm"', '"6 mm\u200b"', "U+200B is ZERO WIDTH SPACE"),
    "a blank in a key": ("radius =", "radius\u00a0=", "U+00A0 is NO-BREAK SPACE"),
    "a sign in a key": ("radius =", "radius \uff1d", "U+FF1D is FULLWIDTH EQUALS SIGN"),
    "another unit": ('"6 mm"', '"6 kN"', "unknown unit 'kN' for a length (units:"),
}


def test_a_character_that_looks_like_another_is_named(tmp_path: Path) -> None:
    messages = [refused(tmp_path, PLAIN.replace(a, b, 1)) for a, b, _ in LOOKALIKES.values()]
    for k, (_, _, words) in enumerate(LOOKALIKES.values()):
        assert [words in message for message in messages] == [k == j for j in range(len(messages))]


def test_cells_with_marks_and_dates(tmp_path: Path) -> None:
    columns = of_tests(tmp_path, (FORCES, DIAMETERS), ("kN", "mm"), heading=True)
    text = (tmp_path / "t.csv").read_text()
    # two byte order marks, and minus signs of a typesetter
    (tmp_path / "t.csv").write_text("\ufeff\ufeff" + text.replace("2.45", "2.45e\N{MINUS SIGN}0"))
    study = load_study(tmp_path / "study.toml", text=columns)
    assert study.limits[0].tested is not None
    assert study.limits[0].tested.forces[1] == 2450.0
    for cell, words in (
        ("2026-01-02 00:00:00", "in the format of a date"),
        ("２.45", "U+FF12 is FULLWIDTH DIGIT TWO"),
        ("2.45e306", "a number is too large\n"),  # and no further fault of it
        ("2.45 kN", "'2.45 kN' is not a number\n"),
    ):
        (tmp_path / "t.csv").write_text(text.replace("2.45", cell))
        message = refused(tmp_path, columns) + "\n"
        assert words in message
        assert "t.csv: line 3: F: " in message


def test_a_link_is_not_called_a_path(tmp_path: Path) -> None:
    text = of_tests(tmp_path, (FORCES, DIAMETERS), ("kN", "mm"), heading=True)
    folder = tmp_path / "study"
    folder.mkdir()
    link = folder / "t.csv"
    link.symlink_to(tmp_path / "t.csv")
    assert '"t.csv" is a link to a file outside' in refused(folder, text)
    link.unlink()
    link.symlink_to(folder / "nothing.csv")
    message = refused(folder, text)
    assert 'there is no file "t.csv"' in message
    assert "did you mean" not in message
    assert "must be a relative path" in refused(folder, text.replace('"t.csv"', '"../t.csv"'))


def test_a_hidden_sheet_is_read_last(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from openpyxl import Workbook

    text = of_tests(tmp_path, (FORCES, DIAMETERS), ("kN", "mm"), heading=True)
    text = text.replace("t.csv", "t.xlsx")
    book = Workbook()
    hidden, visible = book.active, book.create_sheet("Tests")
    hidden.sheet_state = "hidden"
    for factor, sheet in ((100.0, hidden), (1.0, visible)):
        sheet.append(["F [kN]", "D [mm]"])
        for row in zip(factor * FORCES, DIAMETERS, strict=True):
            sheet.append([float(cell) for cell in row])
    book.save(tmp_path / "t.xlsx")
    study = load_study(tmp_path / "study.toml", text=text)
    assert study.limits[0].tested is not None
    assert study.limits[0].tested.forces[0] == 2550.0
    book.remove(visible)
    book.create_sheet("Empty")
    for row in hidden.iter_rows(min_row=2, max_col=1):
        row[0].value /= 100.0
    book.save(tmp_path / "t.xlsx")
    study = load_study(tmp_path / "study.toml", text=text)
    assert any("the hidden sheet 'Sheet' is read" in warning for warning in study.warnings)


def test_what_mutants_found(tmp_path: Path) -> None:
    box = '[inputs]\nx = {{ file = "t.csv", column = "x", {} }}\n[outputs]\nnames = ["y"]\n'.format
    (tmp_path / "t.csv").write_text("x\n5.27\n3.21\n7.46\n5.69\n4.51\n")
    for keys, words, other in (
        ("modulus = 1e300", "modulus: must be less than or equal to 1000", "modulus = -1"),
        ("modulus = 1e-300", "modulus: must be greater than or equal to 0.1", "modulus = 1e300"),
        ('decimal = ","', "'5.27' is not a number with decimal = ','", 'decimal = "x"'),
    ):
        assert words in refused(tmp_path, box(keys))
        assert words not in refused(tmp_path, box(other))
    # a text of two bytes a character that has lost one
    (tmp_path / "t.csv").write_bytes(b"\xff\xfe\0" + "x\n1\n2\n".encode("utf-16-le"))
    assert "is not a text file" in refused(tmp_path, box("lower = 0"))
    (tmp_path / "t.csv").write_bytes("x\n1\n2\n1.5\n".encode("utf-16"))
    assert load_study(tmp_path / "study.toml", text=box("lower = 0")).random["x"].data

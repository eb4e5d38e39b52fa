"""Files that labs are given: what is wrong with them stands at the key that names them."""

import shutil
from pathlib import Path

import pytest

from uqsphere.cli import main

STUDIES = Path(__file__).parents[2] / "studies"
SIEVES = '{ law = "table", file = "sieves.csv", sieve = "size", passing = "passing" }'
TESTS = ("comminution fit", "lab_limestone_feed")
RECORDS = ("shpb records", "lab_gauge_records")
FEED = '{ law = "rosin_rammler", d63 = "28 mm", n = 1.2, top = "63 mm" }'


def refused(
    folder: Path, capsys: pytest.CaptureFixture[str], command: str, template: str, *change: str
) -> str:
    """The error of a command with a changed template, told at the last line that is changed."""
    for path in STUDIES.glob(f"{template}*"):
        shutil.copy(path, folder)
    file = folder / f"{template}.toml"
    before = file.read_text()
    file.write_text(before.replace(*change, 1))
    line = before[: before.index(change[0])].count("\n") + change[1].count("\n") + 1
    assert main([*command.split(), str(file), "--out", str(folder / "out")]) == 2
    told = capsys.readouterr()
    assert not told.out
    assert not (folder / "out").exists()
    place, _, message = told.err.partition(": ")
    assert place == f"{file}:{line}"
    return message


@pytest.mark.parametrize(
    ("lab", "before", "after", "message"),
    [
        (TESTS, '"diameter_mm"', '"d"', "tests.diameter: the column 'd' is not in"),
        (
            TESTS,
            'diameter        = "diameter_mm"',
            'mesh_lower = "diameter_mm"\nmesh_upper = "d"',
            "tests.mesh_upper: the column 'd' is not in",
        ),
        (TESTS, '"energy_J_kg"', '"test"', "tests.specific_energy: the unit of the column 'test'"),
        (TESTS, '"energy_J_kg"', '"energy_J_kg"\nunit = "N"', "tests.unit: unit must be one of J/"),
        (TESTS, '"outcome"', '"test"', "tests.outcome: lab_limestone_feed_tests.csv: lines 4, 5"),
        (TESTS, '"outcome"', '"outcome"\nwhere = { x = 1 }', "tests.where: the column 'x' is not"),
        (TESTS, "[material]\nmaterial = ", "[material]  #", "material: density is required, or"),
        (
            TESTS,
            '"sphere"',
            '"contact"\npartner = { E = "1 GPa" }',
            "tests.partner: E and nu, or a material",
        ),
        (RECORDS, '"time [us]"', '"t"', "record.time: the column 't' is not in"),
        (RECORDS, '"incident [microstrain]"', '"t"', "record.incident: the column 't' is not in"),
        (
            RECORDS,
            '"receiving [microstrain]"',
            '["time [us]", 7]',
            "record.receiving: the column '7' is",
        ),
        (
            RECORDS,
            "dispersion = false",
            'window = ["1 s", "2 s"]',
            "record.window: record.window must be [begin, end] within",
        ),
        (
            RECORDS,
            '"time [us]"',
            '"time [us]"\ntime_unit = "N"',
            "record.time_unit: the unit of time must be",
        ),
        (
            RECORDS,
            "[receiving_bar]",
            '[receiving_bar]\nunit = "N"',
            "receiving_bar.unit: receiving: its unit must be strain",
        ),
    ],
)
def test_faults_of_tables_are_told_at_their_keys(
    lab: tuple[str, str],
    before: str,
    after: str,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert refused(tmp_path, capsys, *lab, before, after).startswith(message)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("size [mm],share\n1,0.5\n", "feed.sizes.passing: the column 'passing' is not in"),
        ("size,passing\n1,0.5\n", "feed.sizes.sieve: the unit of the column 'size' is missing"),
        ("size [mm],passing\n1,x\n", "feed.sizes.passing: sieves.csv: line 2: passing: 'x' is"),
        ("size [mm],passing\n2,1\n2,1\n", "feed.sizes.passing: sieves.csv: line 3: the sieves"),
        ("size [mm],passing\n2,1\n0,0\n", "feed.sizes.passing: sieves.csv: line 3: the sieves"),
        ("size [mm],passing\n1,40\n2,130\n", "feed.sizes.passing: sieves.csv: line 3: the"),
        ("", "feed.sizes.file: 'sieves.csv' is empty"),
    ],
)
def test_columns_of_sieves_are_told_at_their_keys(
    text: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "sieves.csv").write_text(text)
    told = refused(tmp_path, capsys, "comminution feed", "lab_limestone_feed", FEED, SIEVES)
    assert told.startswith(message)


@pytest.mark.parametrize(
    ("command", "file", "other"),
    [
        (
            "run",
            "lab_gauge_records.toml",
            "6: incident_bar: this is an input file of `uqsphere shpb",
        ),
        (
            "check",
            "lab_limestone_feed.toml",
            "10: tests: this is an input file of `uqsphere commin",
        ),
        ("shpb records", "granite.toml", "8: sphere: this is an input file of `uqsphere run`"),
        ("shpb fit-contact", "ishigami.toml", "7: inputs: this is an input file of `uqsphere run`"),
        ("comminution feed", "lab_gauge_records.toml", "6: incident_bar: this is an input file of"),
    ],
)
def test_a_file_of_another_command_names_it(
    command: str, file: str, other: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*command.split(), str(STUDIES / file)]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"{STUDIES / file}:{other}")
    assert len(told.splitlines()) == 1


@pytest.mark.parametrize(
    ("heads", "keys", "message"),
    [
        ("x,F [N]", "", "slow.toml:1: displacement: the unit of the column 'x' is missing."),
        ("x [mm],F", 'force_unit = "kPa"', "slow.toml:4: force_unit: force_unit must be one of N,"),
        ("x [m],F [N]", "", "slow.toml:1: displacement: the displacement goes over 38 mm, more"),
        ("x [mm],F [N]", 'force = "f"', "slow.toml:4: force: the column 'f' is not in"),
    ],
)
def test_columns_of_a_slow_test_are_told_at_their_keys(
    heads: str,
    keys: str,
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = "".join(f"{k / 1000},{k}\n" for k in [*range(40), 0])
    Path("slow.csv").write_text(f"{heads}\n{rows}")
    Path("slow.toml").write_text(f'# a test\nfile = "slow.csv"\ndiameter = "10 mm"\n{keys}\n')
    assert main(["shpb", "fit-contact", "slow.toml"]) == 2
    assert capsys.readouterr().err.startswith(message)


@pytest.mark.parametrize(
    ("command", "template", "place"),
    [(*TESTS, "11: tests.file: "), (*RECORDS, "18: record.file: ")],
)
def test_a_file_that_is_missing_is_told_at_its_key(
    command: str, template: str, place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = shutil.copy(STUDIES / f"{template}.toml", tmp_path)
    assert main([*command.split(), str(file)]) == 6
    told = capsys.readouterr().err
    assert told.startswith(f"{file}:{place}")
    assert "there is no such file" in told


def test_a_row_that_is_asked_about_is_told_where_no_law_fits(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A number of a wrong unit is the cause, and not a prior."""
    shutil.copy(STUDIES / "lab_limestone_feed.toml", tmp_path)
    tests = (STUDIES / "lab_limestone_feed_tests.csv").read_text()
    (tmp_path / "lab_limestone_feed_tests.csv").write_text(tests.replace(",216,", ",216e30,"))
    assert main(["comminution", "fit", str(tmp_path / "lab_limestone_feed.toml")]) == 2
    told = capsys.readouterr().err
    assert told.startswith("note: line 4: the energy lies far from the others: is its unit right?")


def test_an_empty_record_and_a_file_in_place_of_a_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for path in STUDIES.glob("lab_gauge_records*"):
        shutil.copy(path, tmp_path)
    command = ["shpb", "records", str(tmp_path / "lab_gauge_records.toml"), "--out"]
    (tmp_path / "out").touch()
    assert main([*command, str(tmp_path / "out")]) == 5
    told = capsys.readouterr()
    assert "largest force at B" in told.out
    assert "out is not a directory. Choose another with --out" in told.err
    (tmp_path / "lab_gauge_records_test.csv").write_text("")
    assert main([*command, str(tmp_path / "new")]) == 2
    assert "record.file: 'lab_gauge_records_test.csv' is empty" in capsys.readouterr().err


def test_the_keys_that_an_error_asks_for_are_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from openpyxl import Workbook

    rows = (STUDIES / "lab_limestone_feed_tests.csv").read_text().splitlines()[1:]
    book = Workbook()
    book.active.append(["a", "cover"])
    book.active.append(["of", 1])
    tests = book.create_sheet("tests")
    for row in rows:
        tests.append(row.split(","))
    book.save(tmp_path / "tests.xlsx")
    file = '"lab_limestone_feed_tests.csv"'
    text = (STUDIES / "lab_limestone_feed.toml").read_text().replace(file, '"tests.xlsx"')
    path = tmp_path / "asked.toml"
    path.write_text(text)
    command = ["comminution", "fit", str(path), "--out", str(tmp_path / "out")]
    assert main(command) == 2
    assert '(sheet = "tests")' in capsys.readouterr().err
    text = text.replace('"tests.xlsx"', '"tests.xlsx"\nsheet = "tests"')
    path.write_text(text)
    assert main(command) == 0
    sieves = 'law = "table", file = "s.csv", sieve = "s", passing = "p"'
    (tmp_path / "s.csv").write_text("s [mm];p\n16,125;50\n63,125;100\n")
    command[1] = "feed"
    for more, code, said in (
        ("", 2, "feed.sizes.sieve: s.csv: lines 2, 3: s: '16,125' can be a decimal comma or"),
        (', decimal = ","', 0, "passing reaches 100, percent are taken"),
    ):
        path.write_text(text.replace(FEED, f"{{ {sieves}{more} }}"))
        assert main(command) == code
        assert said in capsys.readouterr().err

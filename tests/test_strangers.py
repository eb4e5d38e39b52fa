"""A study or a result folder from a stranger: nothing is followed, waited for, run, or believed."""

from __future__ import annotations

import json
import os
import pickle
import stat
import subprocess
import sys
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_folders import limit, write_folder

from tests.campaigns.trust import guarded, tried
from uqsphere.cli import main
from uqsphere.console import plain_lines
from uqsphere.errors import AccessError, FolderError
from uqsphere.files import array_of, chunk_of, is_device_name, load_document, plain_files, read_whole, refuse_links
from uqsphere.report.contents import read_contents
from uqsphere.results import read_results
from uqsphere.results.tables import tables
from uqsphere.runner.api import logged
from uqsphere.store import csv_text, open_store, write_atomically
from uqsphere.study import load_study

FOLDER_COMMANDS = ("show", "report", "export", "verify", "compare")


def command(name: str, folder: Path) -> list[str]:
    more = {"export": ["--format", "csv"], "compare": [str(folder)]}
    return [name, str(folder), *more.get(name, [])]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return write_folder(tmp_path / "run", limits={"crushing": limit(0.0123, 0.02, True)})


# --- files ----------------------------------------------------------------------------------------


def test_links_pipes_folders_and_giants_are_refused(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("text")
    (tmp_path / "link").symlink_to(tmp_path / "plain")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "place").mkdir()
    assert read_whole(tmp_path / "plain") == b"text"
    with pytest.raises(FolderError, match="link"):
        read_whole(tmp_path / "link")
    with pytest.raises(FolderError, match="not a plain file"):
        read_whole(tmp_path / "pipe")  # a reader that waits for a writer would hang here
    handles = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else 0
    for _ in range(3):
        with pytest.raises((FolderError, AccessError)):
            read_whole(tmp_path / "place")
    assert not handles or len(os.listdir("/proc/self/fd")) == handles
    with pytest.raises(FolderError, match="at most 3"):
        read_whole(tmp_path / "plain", 3)
    with pytest.raises(AccessError, match="no such file"):
        read_whole(tmp_path / "nothing")


@pytest.mark.parametrize(
    "text", ["NaN", "[Infinity]", "[-Infinity]", "1e999", "9" * 30, '"\\ud800"', "[" * 100_000, '{"a": 1', "\ufeff{}"]
)
def test_json_that_no_run_writes(tmp_path: Path, text: str) -> None:
    (tmp_path / "x.json").write_text(text, encoding="utf-8")
    with pytest.raises(FolderError, match="damaged"):
        load_document(tmp_path / "x.json")


def header(text: str, length: int = 118) -> bytes:
    return b"\x93NUMPY\x01\x00" + length.to_bytes(2, "little") + text.encode().ljust(length - 1) + b"\n"


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x93NUMPY",
        pickle.dumps([1]),
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999, 9), }") + bytes(80),
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }") + bytes(80),
        header("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }") + pickle.dumps([1]),
        header("{'descr': '<f8', 'fortran_order': True, 'shape': (2, 2), }") + bytes(32),
        header("{'descr': '>f8', 'fortran_order': False, 'shape': (2,), }") + bytes(16),
        header("{'descr': '<f8', 'fortran_order': False, 'shape': (2,), }") + bytes(17),
        header("{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (2,), }") + bytes(16),
        header("__import__('os').system('touch owned')") + bytes(16),
        header("(" * 110) + bytes(16),
    ],
)
def test_arrays_are_as_long_as_their_bytes(data: bytes) -> None:
    with pytest.raises(ValueError):  # noqa: PT011
        array_of(data)


@pytest.mark.parametrize(
    "columns",
    [
        "[('a', '|O')]",
        "[('a', '<f4')]",
        "[('a', '>f8')]",
        "[('a', '<U2')]",
        "[('a', [('b', '<f8')])]",
        "[('a', '<f8'), ('', '|V8')]",
        "{'names': ['a'], 'formats': ['<f8'], 'offsets': [8]}",
        "{'names': ['a', 'b'], 'formats': ['<f8', '<f8'], 'offsets': [0, 4], 'itemsize': 16}",
        "[('a', '<f8', (0,))]",
        "[('a', '<f8', (999999999,))]",
        "[]",
    ],
)
def test_a_table_has_plain_columns_and_nothing_else(columns: str) -> None:
    data = header(f"{{'descr': {columns}, 'fortran_order': False, 'shape': (2,), }}", 182) + bytes(32)
    with pytest.raises(ValueError):  # noqa: PT011
        chunk_of(data)


def test_a_table_comes_back_as_a_chunk_and_is_no_plain_array(tmp_path: Path) -> None:
    kinds = [("values", "<f8", (3,)), ("steps", "<i8"), ("flags", "u1", (2,)), ("censored", "?")]
    values = np.zeros(5, dtype=kinds)
    values["values"][2] = (1.0, np.nan, -0.0)
    values["censored"][1] = True
    np.save(tmp_path / "x.npy", values)
    data = (tmp_path / "x.npy").read_bytes()
    found = chunk_of(data)
    assert (found.dtype, found.tobytes()) == (values.dtype, values.tobytes())
    with pytest.raises(ValueError, match="array of"):
        array_of(data)
    with pytest.raises(ValueError, match="bytes"):
        chunk_of(data[:-1])


def test_device_names_are_known_on_every_system() -> None:
    devices = ["NUL", "nul.csv", "con", "Aux.toml", "COM1.csv", "lpt9", "prn .csv", "conin$", "tests.csv.", "x "]
    assert all(is_device_name(name) for name in devices)
    assert not any(is_device_name(name) for name in ["null.csv", "com.csv", "com10", "console", "a.nul", ".csv"])


@pytest.mark.parametrize(
    "name", ["NUL", "con.csv", "/etc/passwd", "../x.csv", "C:x.csv", "a/../../x.csv", "link.csv", "\\\\host\\x"]
)
def test_a_study_reads_no_device_and_nothing_outside(tmp_path: Path, name: str) -> None:
    from uqsphere.errors import StudyError

    home = tmp_path / "home"
    home.mkdir()
    (tmp_path / "x.csv").write_text("load\n1\n2\n3\n")
    for stem in ("NUL", "con.csv"):
        (home / stem).write_text("load\n1\n2\n3\n")
    (home / "link.csv").symlink_to(tmp_path / "x.csv")
    text = f"[inputs]\nx = {{ dist = 'empirical', file = '{name}', column = 'load' }}\n[outputs]\nnames = ['y']\n"
    (home / "s.toml").write_text(text)
    with pytest.raises(StudyError, match=r"own folder|leaves the study|device"):
        load_study(home / "s.toml")


# --- folders that lead out --------------------------------------------------------------------------


@pytest.mark.parametrize("name", FOLDER_COMMANDS)
@pytest.mark.parametrize("part", ["figures", "tables", "export", "evaluations", ".lock", "log.jsonl"])
def test_a_folder_that_leads_out_is_refused(folder: Path, tmp_path: Path, part: str, name: str) -> None:
    outside = tmp_path / "outside"
    outside.mkdir()
    target = outside / "precious" if part.startswith((".", "log")) else outside
    if target != outside:
        target.write_text("precious")
    (folder / part).symlink_to(target)
    assert main(command(name, folder)) == 5
    assert {path.name: path.read_text() for path in outside.iterdir()} == (
        {} if target == outside else {"precious": "precious"}
    )


def test_a_run_does_not_go_into_a_folder_that_leads_out(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "outside").mkdir()
    (folder / "evaluations").symlink_to(tmp_path / "outside")
    with pytest.raises(FolderError, match="lead out"):
        open_store(folder, {}, "", "0" * 64)


# the files that each command reads
READ_FILES = {
    "show": ["results.json", "study.toml"],
    "report": ["results.json", "study.toml", "study.resolved.json", "samples.npy", "samples.json"],
    "compare": ["results.json", "study.resolved.json"],
    "verify": ["results.json", "study.resolved.json"],
    "export": ["results.json", "samples.npy", "samples.json"],
}


@pytest.mark.parametrize(("name", "file"), [(name, file) for name, files in READ_FILES.items() for file in files])
def test_a_pipe_where_a_file_is_due_makes_nobody_wait(folder: Path, file: str, name: str) -> None:
    assert set(READ_FILES) == set(FOLDER_COMMANDS)
    (folder / file).unlink(missing_ok=True)
    os.mkfifo(folder / file)
    assert main(command(name, folder)) == 5


@pytest.mark.parametrize(("name", "told"), [("../secret.csv", []), ("own.csv", ["2 tests"])])
def test_the_study_of_a_folder_names_no_file_outside(folder: Path, tmp_path: Path, name: str, told: list[str]) -> None:
    for path in (tmp_path / "secret.csv", folder / "own.csv"):
        path.write_text("load\n1\n\n2\n")
    strength = f"[limits.crushing]\nstrength = {{ file = '{name}', column = 'load' }}\n"
    (folder / "study.toml").write_text(strength)
    assert [text[:7] for text in read_contents(folder).tests.values()] == told


def test_entries_are_counted_before_they_are_sorted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("uqsphere.files.MOST_FILES", 3)
    with pytest.raises(FolderError, match="more than 3 files"):
        list(plain_files(folder))
    refuse_links(folder)


# --- damage deep inside -----------------------------------------------------------------------------


def every_place(node: Any, place: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The way to every entry of a document, of long lists the first two."""
    found = []
    entries = (
        list(node.items()) if isinstance(node, dict) else list(enumerate(node))[:2] if isinstance(node, list) else []
    )
    for key, value in entries:
        found += [(*place, key), *every_place(value, (*place, key))]
    return found


@pytest.mark.parametrize("file", ["results.json", "study.resolved.json"])
def test_no_damage_anywhere_is_an_internal_error(folder: Path, file: str) -> None:
    """One kind of junk in every place, each kind in turn."""
    from uqsphere.report.brief import summary_of
    from uqsphere.report.compare import compare_folders, comparison_text
    from uqsphere.report.tables import inputs_table, limits_table, model_table, repeat_rows

    whole = json.loads((folder / file).read_text())
    refused = 0
    for place, junk in zip(every_place(whole), cycle((None, "x", -1, {})), strict=False):
        document = json.loads(json.dumps(whole))
        node = document
        for key in place[:-1]:
            node = node[key]
        node[place[-1]] = junk
        (folder / file).write_text(json.dumps(document))
        try:
            contents = read_contents(folder)
            for part in (summary_of, inputs_table, limits_table, model_table, repeat_rows):
                part(contents)
            comparison_text(compare_folders(folder, folder))
        except FolderError:
            refused += 1
    assert refused > len(every_place(whole)) / 8


def test_what_does_not_fit_together_is_damage_and_can_be_looked_at(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stumble(*arguments: Any) -> None:
        raise KeyError("nothing \x1b[2J")

    monkeypatch.setattr("uqsphere.report.build_report", stumble)
    assert main(["report", str(folder)]) == 5
    said = capsys.readouterr().err
    assert "UQSPHERE_DEBUG=1" in said
    assert "\x1b" not in said
    monkeypatch.setenv("UQSPHERE_DEBUG", "1")
    with pytest.raises(KeyError):
        main(["report", str(folder)])


# --- what is written --------------------------------------------------------------------------------


@pytest.mark.parametrize("mask", [0o022, 0o077, 0o000])
def test_nobody_reads_more_than_the_user_lets_them(tmp_path: Path, mask: int) -> None:
    code = f"import os; os.umask({mask})\nfrom pathlib import Path\nfrom uqsphere.store import write_atomically\n"
    code += f"write_atomically(Path({str(tmp_path / 'd' / 'x')!r}), 'text')"
    subprocess.run([sys.executable, "-c", code], check=True)
    assert stat.S_IMODE((tmp_path / "d" / "x").stat().st_mode) == 0o644 & ~mask


def test_a_temporary_file_is_private(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    modes = []
    replace = os.replace

    def look(source: Any, target: Any) -> None:
        modes.append(stat.S_IMODE(os.stat(source).st_mode))
        replace(source, target)

    before = os.fsync
    monkeypatch.setattr(
        os, "fsync", lambda handle: modes.append(stat.S_IMODE(os.fstat(handle).st_mode)) or before(handle)
    )
    monkeypatch.setattr(os, "replace", look)
    write_atomically(tmp_path / "x", "text")
    assert modes[0] == 0o600


@pytest.mark.parametrize("start", list("=+-@\t\r\n＝＋－＠"))
def test_no_cell_is_a_formula(start: str) -> None:
    rows = csv_text([f"{start}head"], [[f"{start}cmd|' /c calc'!A0", -1.5, "a=b"]]).splitlines()
    assert not any(cell.lstrip('"').startswith(start) for row in rows[:2] for cell in row.split(",")[:1])
    assert ",-1.5,a=b" in csv_text(["a"], [["x", -1.5, "a=b"]])


def test_exported_columns_are_no_formulas(folder: Path) -> None:
    names = json.loads((folder / "samples.json").read_text())
    names["inputs"][0] = "=HYPERLINK(1)"
    (folder / "samples.json").write_text(json.dumps(names))
    for name, text in tables(read_results(folder)).items():
        write_atomically(folder / "tables" / name, text)
    assert main(["export", str(folder), "--format", "csv"]) == 0
    assert (folder / "export" / "samples.csv").read_text().startswith("'=HYPERLINK(1)")


@pytest.mark.parametrize("evil", ["\x1b[31m", "\x9b31m", "\r", "\u202e", "\u2028", "\x07", "\ud800"])
def test_errors_and_json_do_not_steer_the_terminal(
    folder: Path, tmp_path: Path, evil: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert all(c.isprintable() or c == "\n" for c in plain_lines(f"a{evil}\nb"))
    (tmp_path / "s.toml").write_bytes(f'title = "x{evil}"\nodd{evil} = 1\n'.encode("utf-8", "surrogatepass"))
    assert main(["check", str(tmp_path / "s.toml")]) == 2
    assert all(c.isprintable() or c == "\n" for c in capsys.readouterr().err)
    if evil == "\ud800":
        return
    results = json.loads((folder / "results.json").read_text())
    results["study"]["title"] = f"x{evil}y"
    (folder / "results.json").write_text(json.dumps(results))
    for more in ([], ["--json"]):
        assert main(["show", str(folder), *more]) == 0
        out = capsys.readouterr().out
        assert all(c.isprintable() or c == "\n" for c in out)
    assert json.loads(out)["study"]["title"] == f"x{evil}y"


# --- the log ----------------------------------------------------------------------------------------


def lines_of(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]


def test_a_run_leaves_a_log_that_can_be_read_by_line(finished: Path) -> None:
    lines = lines_of(finished)
    assert [lines[0]["event"], lines[-2]["event"], lines[-1]["event"]] == ["started", "counted", "finished"]
    assert {"evaluated", "verdict"} <= {line["event"] for line in lines}
    assert lines[-2]["evaluations"] > 0
    seconds = [line["seconds"] for line in lines]
    assert seconds == sorted(seconds)


def test_the_log_says_how_a_run_failed_and_stops_no_run(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), logged(tmp_path):
        raise ZeroDivisionError("why")
    assert [line["event"] for line in lines_of(tmp_path)] == ["started", "ended"]
    assert lines_of(tmp_path)[-1]["error"] == "ZeroDivisionError"
    with logged(tmp_path / "nowhere") as log:
        log.write("lost")
    target = tmp_path / "precious"
    target.write_text("precious")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "log.jsonl").symlink_to(target)
    with logged(tmp_path / "d"):
        pass
    assert target.read_text() == "precious"


@pytest.mark.filterwarnings("ignore:Glyph:UserWarning")
@pytest.mark.parametrize("evil", ["\x1b[2J", "\x00", "\ufffe", "\x0b"])
def test_no_name_breaks_a_figure(evil: str) -> None:
    from xml.etree import ElementTree

    from uqsphere.report.figures.canvas import Picture, new_figure, render

    figure, (axes,) = new_figure(2.0)
    axes.set_yticks([0.0, 1.0], labels=["a", f"b{evil}c"])
    axes.set_title(f"d{evil}e")
    drawn = ElementTree.fromstring(render(Picture(name="x", title="t", finding=f"f{evil}g", figure=figure)).encode())
    text = "".join(drawn.itertext())
    assert "c" in text
    assert evil not in text


# --- a short stretch of the fuzzing that `tests.campaigns` does at length, and proof that it sees what it looks for


#: numbered from elsewhere than a long run begins
START = 10**9


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("part", "count", "codes"), [("studies", 150, {0, 2}), ("folders", 30, {0, 5, 6})])
def test_damage_gives_its_exit_codes_and_nothing_else(part: str, count: int, codes: set[int]) -> None:
    found = tried(part, count, start=START)
    assert found["failures"] == 0
    assert codes - {6} <= set(found["codes"]) <= codes


def test_writes_elsewhere_processes_and_pickles_are_seen(tmp_path: Path) -> None:
    import pickle
    import subprocess

    inside, outside = tmp_path / "inside", tmp_path / "outside"
    inside.mkdir()
    outside.mkdir()
    with guarded(inside) as seen:
        (inside / "x").write_text("x")
        assert seen == []
        (outside / "x").write_text("x")
        os.rename(outside / "x", inside / "y")
        subprocess.run(["true"], check=True)
        pickle.loads(pickle.dumps(Path))
        assert len({text.split()[0] for text in seen}) == 4

"""The command line: what commands say, write and return."""

import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from uqsphere.arrays import Array, Names
from uqsphere.cli import EXIT_CODES, LABS, main
from uqsphere.models.model import Model
from uqsphere.models.rows import EvaluatedRows
from uqsphere.report.study import described
from uqsphere.study import load_study, shipped_studies

STUDIES = Path(__file__).parents[1] / "studies"
COMMANDS = [
    "new",
    "check",
    "run",
    "report",
    "compare",
    "history",
    "verify",
    "list",
    "schema",
    "bench",
]


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_new_writes_nothing_where_one_of_its_files_has_other_content(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("limestone_tests.csv").write_text("force [N]\n1\n")
    assert main(["new", "limestone_rotor"]) == 2
    assert "limestone_tests.csv exists with other content" in capsys.readouterr().err
    assert [path.name for path in Path().iterdir()] == ["limestone_tests.csv"]


def test_new_accepts_an_identical_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["new", "limestone_chute"]) == 0
    assert main(["new", "limestone_rotor"]) == 0
    assert "limestone_tests.csv is already there" in capsys.readouterr().out


@pytest.mark.parametrize("template", ["lab_gauge_records", "lab_limestone_feed", "ishigami"])
def test_new_names_a_next_command_that_works(
    template: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["new", template]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    assert main(shlex.split(last.removeprefix("next: uqsphere "))) == 0


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["new", "granit"], "did you mean 'granite'"),
        (["rnu", "x.toml"], "did you mean 'run'"),
        (["list", "material"], "did you mean 'materials'"),
        (["check", "x.toml", "--out", "y"], "unknown option --out; see uqsphere check --help"),
    ],
)
def test_a_slip_of_the_pen_gets_a_hint(
    words: list[str], hint: str, capsys: pytest.CaptureFixture[str]
) -> None:
    try:
        code = main(words)
    except SystemExit as end:
        code = int(end.code or 0)
    assert code == 2
    assert hint in capsys.readouterr().err


def test_a_study_is_read_from_standard_input(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As a file is: a mark of the byte order is no part of it, whatever the terminal's encoding."""
    content = (STUDIES / "ishigami.toml").read_bytes()

    def check(given: bytes) -> int:
        given_in_c = io.TextIOWrapper(io.BytesIO(given), "ascii", errors="surrogateescape")
        monkeypatch.setattr("sys.stdin", given_in_c)
        return main(["check", "-"])

    for given in (content, b"\xef\xbb\xbf" + content, content.replace(b"\n", b"\r\n")):
        assert check(given) == 0
        assert "the study is valid" in capsys.readouterr().out
    for given, says in (
        (content.replace(b"[inputs]", b"[inputs"), "stdin:"),
        (b'title = "a"\n# \xb5\n' + content, "stdin:2: byte 0xb5 is not UTF-8 text"),
        (bytes(2 << 20), "stdin: at most 1 MiB are read"),
    ):
        assert check(given) == 2
        assert capsys.readouterr().err.startswith(says)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_has_an_example(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        main([command, "--help"])
    assert f"  uqsphere {command}" in capsys.readouterr().out.partition("example")[2]


def test_help_lists_every_command_and_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 2
    text = capsys.readouterr().out
    assert all(f"  {name}" in text for name in (*COMMANDS, *LABS))
    assert all(f"  {code:<4}{meaning}" in text for code, meaning in EXIT_CODES.items())


@pytest.mark.parametrize(
    ("line", "words"),
    [("uqsphere ru", ["run"]), ("uqsphere new ishi", ["ishigami"])],
)
def test_a_shell_completes_commands_and_templates(line: str, words: list[str]) -> None:
    pytest.importorskip("argcomplete")
    asked = {"_ARGCOMPLETE": "1", "_ARGCOMPLETE_STDOUT_FILENAME": "words", "COMP_LINE": line}
    subprocess.run(
        [sys.executable, "-c", "from uqsphere.__main__ import program; program()"],
        env={**os.environ, **asked, "COMP_POINT": str(len(line)), "_ARGCOMPLETE_IFS": " "},
        check=False,
    )
    assert Path("words").read_text().split() == words


def test_check_tells_long_sources_below_its_table() -> None:
    text = described(load_study(shipped_studies()["granite"]))
    table, notes = text.split("\n[1] ")
    assert max(map(len, table.splitlines())) < 100
    assert "Inco databook" not in table
    assert (
        "bars.E                 190 GPa     –         –                   fixed         [1]" in text
    )
    assert "Inco databook" in notes


def test_list_tells_the_keys_of_every_distribution(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "distributions"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line.split()) > 1 for line in lines)
    assert "uniform       lower, upper" in lines


SQUARE = """
title = "A square"
inputs.a = { dist = "normal", mean = 3.0, sd = 1.0 }
outputs.names = ["y"]
"""


@pytest.mark.parametrize(
    ("line", "says"),
    [
        ("analysis.quantiles = 0.5", "must be an array, [...]"),
        ('margins = { solve = "a", between = [1.0] }', "at least 2 items, not an array of 1"),
        ('limits = { quantity = "y" }', "must be a table with a name, [limits.NAME]"),
        ('limits = [{ quantity = "y" }]', "must be a table in single brackets"),
    ],
)
def test_a_value_of_another_form_is_told_the_form(
    line: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("square.toml").write_text(SQUARE + line)
    assert main(["check", "square.toml"]) == 2
    (text,) = capsys.readouterr().err.splitlines()
    assert text.startswith("square.toml:5: ")
    assert says in text


def test_a_check_names_no_more_runs_than_the_budget(capsys: pytest.CaptureFixture[str]) -> None:
    Path("square.toml").write_text(f"{SQUARE}analysis.budget.evaluations = 300")
    assert main(["check", "square.toml"]) == 0
    assert "makes one design: at most 300 model runs" in capsys.readouterr().out


def test_a_check_says_how_long_a_run_takes_by_64_rows(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    evaluate = Model.evaluate

    def counted(model: Model, names: Names, rows: Array, columns: Names) -> EvaluatedRows:
        asked.append(len(rows))
        return evaluate(model, names, rows, columns)

    monkeypatch.setattr(Model, "evaluate", counted)
    assert main(["new", "granite"]) == 0
    assert main(["check", "granite.toml"]) == 0
    assert asked == [64, 64]
    said = capsys.readouterr().out
    assert re.search(r"A run starts with 10,496 model runs \(.* about [\d.]+ s\)", said)
    assert "at most 2,000,000 model runs in 600 s (analysis.budget)" in said
    # a run makes its first size whatever the budget, and a slow model one design
    assert main(["check", "granite.toml", "--set", "analysis.budget.evaluations=100"]) == 0
    said = capsys.readouterr().out
    [first, most] = re.search(r"starts with (\d+) .* at most (\d+) model runs", said).groups()
    assert int(first) == int(most) > 100
    assert main(["new", "blackbox"]) == 0
    for budget in ("analysis.budget.evaluations=100", 'analysis.cost="10 s"'):
        assert main(["check", "blackbox.toml", "--set", budget]) == 0
        assert "A run makes one design: at most 100" in capsys.readouterr().out


@pytest.mark.parametrize("at", ["uqsphere.cli", "uqsphere.study", "numba", "exit"])
def test_an_interruption_is_told_in_one_line_wherever_it_comes(at: str) -> None:
    """While modules are loaded as well, and where a compiled one makes another error of it."""
    words = ["history", str(STUDIES / "quartz_load_cell.toml")]
    if at == "exit":
        words = ["list", "materials"]
    code = f"""
import builtins, os, signal, sys, time
load = builtins.__import__
def interrupted(name, *more, **named):
    if name == "uqsphere.study" == {at!r}:
        try:
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(1.0)
        except KeyboardInterrupt:
            raise ImportError("initialization failed") from None
    if name == {at!r}:
        exec("raise KeyboardInterrupt")
    return load(name, *more, **named)
builtins.__import__ = interrupted
if {at!r} == "exit":
    import gc
    gc.freeze = lambda: exec("raise KeyboardInterrupt")
from uqsphere.__main__ import program
sys.argv = ["uqsphere", *{words!r}]
program()
"""
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60
    )
    assert ended.returncode == 130
    assert [line for line in ended.stderr.splitlines() if "warning" not in line] == ["interrupted"]

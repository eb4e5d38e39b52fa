"""Every command with right and wrong input: exit code, what goes to stdout, and never a traceback."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import uqsphere
from uqsphere.cli import main
from uqsphere.study import shipped_studies

STUDIES = Path(uqsphere.__file__).parent.parent / "studies"
GRANITE = str(STUDIES / "granite.toml")
#: overrides that put the small study into its closed form
QUICK = ("--set", "bars.infinite=true", "--set", "model.fidelity=massless", "--set", 'analysis.quantities=["p_max"]',
         "--set", 'analysis.methods=["sobol"]', "--set", "limits.crushing.fracture=false")  # fmt: skip
SLOW_MODEL = """\
import time
def f(inputs):
    print("a word")
    time.sleep({sleep})
    return {{"y": inputs["x1"] + inputs["x2"] ** 2}}
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, small_text: str, box_text: str) -> Path:
    """A folder to work in, with the small study and a black box."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("UQSPHERE_DEBUG", raising=False)
    (tmp_path / "small.toml").write_text(small_text)
    (tmp_path / "box.toml").write_text(box_text)
    (tmp_path / "model.py").write_text(SLOW_MODEL.format(sleep=0))
    return tmp_path


class Answer:
    """What a command gave."""

    def __init__(self, code: int, captured: Any) -> None:
        self.code, self.out, self.err = code, captured.out, captured.err
        assert "Traceback" not in self.err + self.out
        assert "internal error" not in self.err

    def document(self) -> Any:
        """The one JSON document on stdout."""
        return json.loads(self.out)


@pytest.fixture
def ask(place: Path, capsys: pytest.CaptureFixture[str]) -> Any:
    def run(*arguments: str) -> Answer:
        capsys.readouterr()
        return Answer(main(arguments), capsys.readouterr())

    return run


# --- usage ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments",
    [
        (), ("nonsense",), ("run",), ("run", "a", "b"), ("check", GRANITE, "--nonsense"), ("export", "x"),
        ("export", "x", "--format", "docx"), ("list",), ("list", "sins"), ("run", GRANITE, "-j", "two"),
        ("run", GRANITE, "--resume", "--fresh"), ("run", "small.toml", "-j", "0"), ("new", "basalt", "-o", "x.toml"),
        ("run", "box.toml"), ("run", "small.toml", "--model", "model.py:f"), ("run", "box.toml", "--model", "model.py"),
        ("run", "box.toml", "--model", "model.py:g"), ("history", "box.toml"),
        ("check", "small.toml", "--set", "nonsense"), ("check", "small.toml", "--set", "striker.sped=1"),
        ("check", "small.toml", "--set", "striker.speed=5"), ("check", "small.toml", "--set", "sphere.nu=0.6"),
    ],
    ids=lambda arguments: " ".join(arguments).replace(GRANITE, "granite.toml") or "nothing",
)  # fmt: skip
def test_wrong_usage_is_exit_2_and_leaves_nothing(ask: Any, place: Path, arguments: tuple[str, ...]) -> None:
    before = sorted(path.name for path in place.iterdir())
    answer = ask(*arguments)
    assert answer.code == 2
    assert answer.out == ""
    assert answer.err.strip()
    assert sorted(path.name for path in place.iterdir()) == before


@pytest.mark.parametrize("budget", ["", "10", "soon", "-5 s", "0 s", "nan s", "1e400 s", "3 kg", "10 min 5 s"])
def test_a_budget_that_is_none(ask: Any, place: Path, budget: str) -> None:
    answer = ask("run", "small.toml", f"--budget={budget}")
    assert (answer.code, answer.out) == (2, "")
    assert "--budget" in answer.err
    assert not (place / "small-results").exists()


@pytest.mark.parametrize("text", ["", "title = ", "title = 'x'\nspeed = 3\n", "\x00", "[sphere]\nE = '52 Gpa'\n"])
@pytest.mark.parametrize("command", ["check", "run", "history"])
def test_a_broken_study_is_told_with_its_place(ask: Any, place: Path, text: str, command: str) -> None:
    (place / "broken.toml").write_text(text)
    answer = ask(command, "broken.toml", *(["--out", "r"] if command != "check" else []))
    assert (answer.code, answer.out) == (2, "")
    assert answer.err.startswith("broken.toml:")
    assert not (place / "r").exists()


def test_files_that_are_not_there(ask: Any) -> None:
    for arguments in (("check", "none.toml"), ("run", "none.toml"), ("history", "none.toml"),
                      ("run", "box.toml", "--model", "none.py:f"), ("new", "-o", "none/x.toml")):  # fmt: skip
        answer = ask(*arguments)
        assert (answer.code, answer.out) == (6, ""), arguments
    for command in ("check", "run", "history"):  # a folder where a file is due is wrong usage
        answer = ask(command, ".")
        assert (answer.code, answer.out) == (2, ""), command


# --- new, check, list, schema, doctor --------------------------------------------------------------


@pytest.mark.parametrize("template", [path.stem for path in sorted(STUDIES.glob("*.toml"))])
def test_new_writes_a_study_that_checks(ask: Any, place: Path, template: str) -> None:
    assert ask("new", template, "-o", "mine.toml").code == 0
    assert (place / "mine.toml").read_bytes() == (STUDIES / f"{template}.toml").read_bytes()
    answer = ask("check", "mine.toml")
    assert answer.code == 0
    assert "is valid" in " ".join(answer.out.split())


def test_new_never_overwrites(ask: Any, place: Path) -> None:
    (place / "mine.toml").write_text("precious")
    assert ask("new", "blackbox").code == 0
    answer = ask("new", "blackbox")
    assert (answer.code, answer.out) == (2, "")
    assert (place / "blackbox.toml").read_bytes() == (STUDIES / "blackbox.toml").read_bytes()
    answer = ask("new", "-o", "mine.toml")
    assert (answer.code, answer.out) == (2, "")
    assert (place / "mine.toml").read_text() == "precious"
    (place / "ishigami.py").write_text("precious")
    assert ask("new", "ishigami", "-o", "other.toml").code == 0
    assert (place / "ishigami.py").read_text() == "precious"


def test_check_prints_the_plan(ask: Any) -> None:
    answer = ask("check", GRANITE)
    assert answer.code == 0
    for text in ("sphere.E", "mu = ", "theta = ", "evaluations: about", "time: about"):
        assert text in answer.out
    document = ask("check", GRANITE, "--json").document()
    assert document["plan"]["evaluations"] > 1000
    assert document["plan"]["scene"]["mu"] > 0.0
    assert document["hash"] == uqsphere.load_study(GRANITE).hash


@pytest.mark.parametrize("what", ["materials", "models", "quantities", "criteria"])
def test_lists(ask: Any, what: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "1000")
    answer = ask("list", what)
    assert answer.code == 0
    assert answer.err == ""
    document = ask("list", what, "--json").document()
    headings = {entry["material"] for entry in document} if what == "materials" else ()
    assert len(answer.out.splitlines()) == len(document) + len(headings) + 1
    if what == "quantities":
        assert [entry["name"] for entry in document][:2] == ["p_max", "P_max"]


def test_schema_and_doctor(ask: Any) -> None:
    assert ask("schema").document()["$schema"].startswith("https://json-schema.org/")
    assert ask("doctor", "--json").document()["missing"] == []
    assert "numpy" in ask("doctor").out


@pytest.mark.parametrize("arguments", [("--help",), ("--version",), ("run", "--help")])
def test_help_and_version(place: Path, capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 0
    assert "uqsphere" in capsys.readouterr().out


# --- run ------------------------------------------------------------------------------------------


def test_run_show_report_export(ask: Any, place: Path) -> None:
    command = ("run", "small.toml", *QUICK, "--set", "analysis.accuracy.quantile=1e-4",
               "--set", "analysis.budget.evaluations=20_000")  # fmt: skip
    answer = ask(*command)
    assert answer.code == 0  # for an accuracy that is missed a warning is enough
    assert "accuracy not reached" in answer.err
    assert "Contact pressure" in answer.out
    assert (place / "small-results" / "report.html").is_file()
    shown = ask("show", "small-results")
    assert shown.code == 0
    assert shown.err == ""
    assert shown.out.strip() in answer.out
    (place / "small-results" / "report.html").unlink()
    built = ask("report", "small-results", "--json")
    assert Path(built.document()["report"]).is_file()
    for form in ("csv", "json", "parquet"):
        written = ask("export", "small-results", "--format", form, "--json").document()["written"]
        assert all(Path(path).stat().st_size > 0 and path.endswith(form) for path in written)
        assert {Path(path).stem for path in written} >= {"samples", "limits", "sensitivity", "quantities"}
    lines = (place / "small-results" / "export" / "samples.csv").read_text().splitlines()
    rows = json.loads((place / "small-results" / "export" / "samples.json").read_text())
    assert len(lines) == len(rows) + 1
    assert float(lines[1].split(",")[0]) == pytest.approx(rows[0]["sphere.E"], rel=1e-14)
    # the folder is that of this study and of nothing else, unless it is asked to be
    assert ask(*command, "--set", "seed=77").code == 5
    command += ("--set", "limits.crushing.target=1e-5")
    refused = ask(*command)
    assert refused.code == 5
    assert "--extend" in refused.err
    missed = ask(*command, "--extend", "--json")
    assert missed.code == 3
    results = json.loads((place / "small-results" / "results.json").read_text())
    assert missed.document() == ask("show", "small-results", "--json").document() == results
    assert results["limits"]["crushing"]["met"] is False


def test_foreign_folders_are_exit_5(ask: Any, place: Path) -> None:
    (place / "mine").mkdir()
    (place / "mine" / "thesis.txt").write_text("precious")
    for folder in ("mine", "small.toml"):
        answer = ask("run", "small.toml", *QUICK, "--out", folder, "--fresh")
        assert (answer.code, answer.out) == (5, ""), folder
    assert os.listdir(place / "mine") == ["thesis.txt"]


@pytest.mark.parametrize("command", [("show",), ("report",), ("export", "--format", "csv")])
def test_folders_that_hold_no_run_are_exit_5(ask: Any, place: Path, command: tuple[str, ...]) -> None:
    (place / "empty").mkdir()
    for folder in ("empty", "none", "small.toml"):
        answer = ask(command[0], folder, *command[1:])
        assert (answer.code, answer.out) == (5, ""), folder


def test_history(ask: Any, place: Path) -> None:
    answer = ask("history", "small.toml")
    assert answer.code == 0
    assert "largest contact pressure" in answer.out
    infinite = ask("history", "small.toml", "--set", "bars.infinite=true", "--json")
    assert infinite.code == 0
    assert infinite.document()["theta"] > 0.0
    step = ask("history", "small.toml", "--set", "bars.infinite=true", "--set", 'pulse={shape="step"}',
               "--set", "model.horizon=1 ms", "--json")  # fmt: skip
    assert step.document()["theta"] is None


# --- black boxes ----------------------------------------------------------------------------------


def test_a_black_box_runs_and_its_prints_are_no_result(place: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "box.toml", "--model", "model.py:f", "--json"]) == 0
    out, err = capfd.readouterr()
    assert json.loads(out)["model"]["chosen"] == "black box"
    assert "a word" in err


@pytest.mark.parametrize(
    ("body", "code"),
    [("return {'y': inputs['x1'] * float('nan')}", 4), ("raise RuntimeError('no')", 4), ("return 3", 4)],
)
def test_a_black_box_that_fails(place: Path, capsys: pytest.CaptureFixture[str], body: str, code: int) -> None:
    (place / "model.py").write_text(f"def f(inputs):\n    {body}\n")
    assert main(["run", "box.toml", "--model", "model.py:f"]) == code
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.splitlines()[-1].startswith("uqsphere: ")
    assert "Traceback" not in captured.err


# --- terminals, pipes, interruptions --------------------------------------------------------------


def test_an_interrupted_run_says_how_to_go_on(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from uqsphere.cli.run import Progress

    def interrupt(self: Progress, stage: str, done: int, total: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Progress, "__call__", interrupt)
    command = ["run", "small.toml", *QUICK, "--out", "my results", "--fresh"]
    assert main(command) == 130
    captured = capsys.readouterr()
    assert captured.out == ""
    expected = "uqsphere run small.toml --set bars.infinite=true"
    (line,) = [line for line in captured.err.splitlines() if expected in line]
    assert "'my results'" in line
    assert "--fresh" not in line  # which would drop what is kept
    assert len(list((place / "my results" / "evaluations").glob("sampling.*"))) == 1


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_signals_keep_what_is_done(place: Path, number: int, code: int) -> None:
    (place / "model.py").write_text(SLOW_MODEL.format(sleep=0.5))
    arguments = [sys.executable, "-m", "uqsphere", "run", "box.toml", "--model", "model.py:f", "--out", "r"]
    arguments += ["--set", "analysis.rows_per_call=2048"]  # the first stage in one call
    with subprocess.Popen(arguments, cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as running:
        assert running.stderr.readline() == "a word\n"  # it is at work
        running.send_signal(number)
        out, err = running.communicate(timeout=60)
    assert running.returncode == code
    if number == signal.SIGINT:  # once: what is there is told
        assert "user’s model · 2 048 rows" in out.replace("\N{NO-BREAK SPACE}", " ").replace(
            "\N{NARROW NO-BREAK SPACE}", " "
        )
        assert "Ctrl-C again stops at once" in err
        assert json.loads((place / "r" / "manifest.json").read_text())["interrupted"] is True
        assert "The run was interrupted" in (place / "r" / "report.html").read_text(encoding="utf-8")
    else:
        assert out == ""
    assert "uqsphere run box.toml --model model.py:f --out r" in err
    assert "Traceback" not in err
    assert not list((place / "r").glob(".*json*"))


def test_a_pipe_gets_plain_text_and_a_closed_one_no_complaint(finished: Path, place: Path) -> None:
    program = f"'{sys.executable}' -m uqsphere"
    command = f"{program} show '{finished}'; {program} list materials | true"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False, timeout=60)
    assert done.stdout
    assert "\x1b" not in done.stdout
    assert done.stderr == ""


def test_a_full_disk_behind_stdout_is_exit_6(place: Path) -> None:
    full = Path("/dev/full")
    assert full.exists()
    with full.open("w") as target:
        done = subprocess.run([sys.executable, "-m", "uqsphere", "list", "quantities"], stdout=target,
                              stderr=subprocess.PIPE, text=True, check=False, timeout=60)  # fmt: skip
    assert done.returncode == 6
    assert "Traceback" not in done.stderr
    assert "Exception" not in done.stderr


def test_a_terminal_without_the_characters(place: Path, small_text: str) -> None:
    (place / "small.toml").write_text(small_text.replace('"Small"', '"Größe µm²"'), encoding="utf-8")
    narrow = {**os.environ, "PYTHONIOENCODING": "ascii", "PYTHONUTF8": "0", "LC_ALL": "C"}
    for more in ([], ["--json"]):
        done = subprocess.run([sys.executable, "-m", "uqsphere", "check", "small.toml", *more], cwd=place, env=narrow,
                              capture_output=True, text=True, timeout=60, check=False)  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["title"] == "Größe µm²"


def test_the_debug_switch_shows_the_place(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from uqsphere.cli import studies as commands

    def fail(chosen: Any) -> int:
        raise RuntimeError("broken")

    monkeypatch.setattr(commands, "command_schema", fail)
    assert main(["schema"]) == 1
    monkeypatch.setenv("UQSPHERE_DEBUG", "1")
    with pytest.raises(RuntimeError, match="broken"):
        main(["schema"])


def test_nothing_is_written_beside_the_study(ask: Any, place: Path) -> None:
    shutil.copytree(STUDIES, place / "shipped")
    before = {path: path.stat().st_mtime_ns for path in (place / "shipped").iterdir()}
    assert ask("check", "shipped/granite.toml").code == 0
    assert {path: path.stat().st_mtime_ns for path in (place / "shipped").iterdir()} == before


def test_templates_are_listed_with_what_they_are(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["list", "templates", "--json"]) == 0
    found = {row["template"]: row["kind"] for row in json.loads(capsys.readouterr().out)}
    assert set(found) == set(shipped_studies())
    assert (found["blackbox"], found["limestone_chute_rotor"], found["granite"]) == (
        "model of your own", "services", "impact",
    )  # fmt: skip

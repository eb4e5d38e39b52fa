"""Every command, output and `>>>` line of README.md and the tutorials is executed, in order, in one
folder a page, which is empty at first.

A ```console block has commands behind "$ " and what they print; "..." stands for anything.  A
```toml or ```python block whose first line is a comment with a file's name is that file.  In
```python blocks `>>>` lines are doctests.
"""

import contextlib
import doctest
import io
import json
import re
import shlex
from pathlib import Path

import pytest

from uqsphere import cli

ROOT = Path(__file__).parent.parent.parent
LONGEST = "tutorial-engineer"
PAGES = [
    page
    for page in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
    if re.search(r"^(>>> |```console)", page.read_text("utf-8"), re.M)
]
FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
#: exit codes of commands that are meant: a verdict that is not "met", a study that is refused
MEANT = (0, 2, 3)


def blocks(text: str) -> list[tuple[str, str]]:
    """Language and body of every fenced block."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", text, re.M | re.S)


def commands(body: str) -> list[tuple[str, str]]:
    """Command and expected output of a console block; a line that ends in a backslash goes on."""
    parts = re.split(r"^\$ ", body.replace("\\\n", " "), flags=re.M)[1:]
    return [
        (command, expected) for command, _, expected in (part.partition("\n") for part in parts)
    ]


def execute(command: str, capsys: pytest.CaptureFixture[str]) -> str:
    """What a command prints, on both streams, notes of progress left out."""
    words = shlex.split(command)
    if words[0] == "cat":
        return "".join(Path(name).read_text("utf-8") for name in words[1:])
    assert words[0] == "uqsphere", f"no command of these pages: {command}"
    capsys.readouterr()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("COLUMNS", "80")
        try:
            code = cli.main(words[1:])
        except SystemExit as end:
            code = int(end.code or 0)
    out, err = capsys.readouterr()
    assert code in MEANT, f"{command}: exit code {code}\n{err}"
    notes = re.compile(r"^([Cc]ompiling |warning: |[\d,]+ runs, )")
    return "".join(line for line in err.splitlines(keepends=True) if not notes.match(line)) + out


def page_cases() -> list[object]:
    """Every page; the one that runs the most scenes is slow."""
    cases = [pytest.param(page, id=page.stem) for page in PAGES if page.stem != LONGEST]
    slow = [page for page in PAGES if page.stem == LONGEST]
    return cases + [pytest.param(page, id=LONGEST, marks=pytest.mark.slow) for page in slow]


@pytest.mark.parametrize("page", page_cases())
def test_page_says_what_happens(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "Agg")
    checker, parser, names, ran = doctest.OutputChecker(), doctest.DocTestParser(), {}, 0
    for language, body in blocks(page.read_text("utf-8")):
        name = re.match(r"# (\S+\.(?:toml|py|csv))\n", body)
        if name and not body.startswith(">>>"):
            Path(name[1]).write_text(
                body.partition("\n")[2] if name[1].endswith("csv") else body, "utf-8"
            )
        elif language == "console":
            for command, expected in commands(body):
                got = execute(command, capsys)
                said = re.sub(r"\s*\.\.\.\s*", "...", expected)
                assert checker.check_output(said, got, FLAGS), f"$ {command}\n{got}"
                ran += 1
        elif language == "python" and ">>>" in body:
            test = parser.get_doctest(body, names, page.name, str(page), 0)
            runner, report = doctest.DocTestRunner(optionflags=FLAGS), io.StringIO()
            with contextlib.redirect_stderr(io.StringIO()):
                runner.run(test, out=report.write, clear_globs=False)
            names = test.globs
            assert runner.failures == 0, report.getvalue()
            ran += 1
    assert ran >= 3


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:`newshape`:DeprecationWarning")
@pytest.mark.parametrize(
    "notebook", sorted((ROOT / "docs").glob("*.ipynb")), ids=lambda path: path.stem
)
def test_a_notebook_prints_what_it_shows(notebook: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import matplotlib.pyplot as plt

    monkeypatch.chdir(ROOT)
    names: dict[str, object] = {}
    for cell in json.loads(notebook.read_text("utf-8"))["cells"]:
        if cell["cell_type"] == "code":
            with contextlib.redirect_stdout(io.StringIO()) as printed:
                exec("".join(cell["source"]), names)
            texts = [output["text"] for output in cell["outputs"] if "text" in output]
            assert printed.getvalue() == "".join(map("".join, texts))
            figures = [
                output for output in cell["outputs"] if "image/png" in output.get("data", {})
            ]
            assert len(figures) == len(plt.get_fignums()), "python docs/notebooks.py"
            plt.close("all")


def test_links_and_pictures_are_there() -> None:
    for page in [*PAGES, *(ROOT / "docs").glob("*.md")]:
        for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text("utf-8")):
            assert "://" in target or (page.parent / target).exists(), f"{page.name}: {target}"

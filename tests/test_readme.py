"""Every command and number of the README's tour is executed.  ``python tests/test_readme.py`` prints what they give."""

from __future__ import annotations

import doctest
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
from contextlib import chdir, redirect_stderr, redirect_stdout
from itertools import takewhile
from pathlib import Path
from unittest import mock

import pytest

from uqsphere.cli import main

ROOT = Path(__file__).parent.parent
README = ROOT / "README.md"
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def console_blocks(page: Path = README) -> list[tuple[str, str]]:
    """(command, expected output) pairs of a page's console blocks, in order; a command ends where no line goes on."""
    pairs = []
    for block in re.findall(r"^```console\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE):
        for piece in re.split(r"^\$ ", block, flags=re.MULTILINE)[1:]:
            command, _, output = piece.partition("\n")
            while command.endswith("\\"):
                more, _, output = output.partition("\n")
                command = f"{command}\n{more}"
            pairs.append((command, output))
    return pairs


def run(command: str, folder: Path) -> str:
    """What a command prints on both streams, progress left out; `uqsphere` at its beginning runs in this process."""
    environment = {
        **os.environ,
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "LC_ALL": "C.UTF-8",
        "COLUMNS": "80",
    }
    alone = command.startswith("uqsphere ") and command.count("uqsphere ") == 1
    line = f"{answered(command, folder, environment)}\n{command}" if alone else command
    done = subprocess.run(
        ["bash", "-c", line], cwd=folder, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode in (0, 2, 3, 4), (command, done.stderr)
    progress = re.compile(r"[\w-]+: [\d,]+ of [\d,]+ evaluations")
    messages = [line for line in done.stderr.splitlines() if not progress.match(line)]
    return "\n".join([*messages, done.stdout])


def answered(command: str, folder: Path, environment: dict[str, str]) -> str:
    """A function of the shell that answers as `uqsphere` does here: a process of its own takes seconds to load.

    What the line makes of its streams and its exit code is left to the shell.
    """
    words = shlex.shlex(command.replace("\\\n", " "), posix=True, punctuation_chars="|>;&")
    words.whitespace_split, words.commenters = True, ""
    arguments = list(takewhile(lambda word: not set(word) <= set("|>;&"), words))
    if arguments[-1] == "2" and "2>" in command:  # the number of the stream that goes elsewhere
        arguments.pop()
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with chdir(folder), mock.patch.dict(os.environ, environment), redirect_stdout(out), redirect_stderr(err):
        try:
            code = main(arguments[1:])
        except SystemExit as error:
            code = error.code
    place = Path(tempfile.mkdtemp(dir=folder, prefix="."))
    for name, stream in (("out", out), ("err", err)):
        stream.flush()
        (place / name).write_bytes(stream.buffer.getvalue())
    return f"uqsphere() {{ cat '{place}/out'; cat '{place}/err' >&2; return {code or 0}; }}"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tour")


def differences(page: Path, folder: Path) -> list[str]:
    """The commands of a page, run in order in `folder`, that print something else than the page says."""
    checker = doctest.OutputChecker()
    wrong = []
    for command, expected in console_blocks(page):
        found = run(command, folder)
        if not checker.check_output(expected, found, FLAGS):
            wrong.append(f"$ {command}\nexpected:\n{expected}\nfound:\n{found}")
    return wrong


def test_the_tour_is_what_the_commands_print(folder: Path) -> None:
    assert not differences(README, folder)


def test_the_readme_has_its_two_commands_and_a_figure() -> None:
    text = README.read_text(encoding="utf-8")
    blocks = re.findall(r"^```sh\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    assert len(blocks) == 2
    assert "uqsphere run studies/granite_three_ways.toml" in blocks[0]
    assert "pytest" in blocks[1]
    for picture in re.findall(r"!\[.+?\]\((.+?)\)", text):
        assert (ROOT / picture).is_file()
    for page in re.findall(r"\]\((docs/.+?)\)", text):
        assert (ROOT / page).is_file()


if __name__ == "__main__":
    place = Path(tempfile.mkdtemp())
    for line, _ in console_blocks():
        print(f"$ {line}\n{run(line, place)}\n")

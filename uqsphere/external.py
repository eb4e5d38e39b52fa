"""Models that are programs of their own or servers: what a file declares of them, and the call of one run.

A file `NAME.toml` with the table `[model]` is given where a Python function would be (`--model NAME.toml`); a study
itself stays data and runs nothing.  A program gets a scratch folder for each row, in which its input file is filled in
from a template; its outputs are read from what it prints or writes.  A server speaks the UM-Bridge protocol, version
1.0 (Seelinger et al., J. Open Source Softw. 8 (2023) 4748).
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Final
from urllib.error import URLError
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from uqsphere.arrays import Array
from uqsphere.errors import AccessError, ModelError, ModelUnfit, StudyError, told
from uqsphere.files import TooLarge, read_given
from uqsphere.study.document import Names, Seconds
from uqsphere.study.faults import Findings, Raw, one_of, shown
from uqsphere.study.tables import Text, Whole, key, read_table, several, within
from uqsphere.study.text import locate, parse_text, read_text

#: bytes of a template, of what a program declares to depend on (each file), of an output and of an answer of a server
LARGEST: Final = 1 << 30
_LARGEST_OUTPUT: Final = 64 << 20
#: `{{name}}` or `{{name:.6e}}`
_PLACE: Final = re.compile(r"\{\{\s*([^{}:\s]+)\s*(?::([^{}]*))?\}\}")
_CLOSED: Final = ConfigDict(extra="forbid", defer_build=True)
#: characters of what a program printed last that a message repeats
_TOLD: Final = 200


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class OutputTable:
    """Where a number stands: in a text by a pattern, in a CSV by its column, in JSON by its path."""

    file: Text = key("file in the folder of the run", "stdout", default_is="what the program prints")
    pattern: Text | None = key("regular expression; its first group, in its last match, is the number", None)
    column: Text | None = key("column of a CSV with a header", None)
    row: int = key("row of that column, from 0; negative from the end", -1)
    path: Text | None = key('way from the top of a JSON document, as `"stress.max"` or `"nodes.3.u"`', None)

    def number(self, text: str) -> float:
        """The number in a text; ValueError says why there is none."""
        if self.pattern is not None:
            found = re.findall(self.pattern, text, re.MULTILINE)
            if not found:
                raise ValueError(f"nothing matches {shown(self.pattern)}")
            last = found[-1]
            return float((last[0] if isinstance(last, tuple) else last).replace("D", "E").replace("d", "e"))
        if self.column is not None:
            rows = list(csv.DictReader(text.splitlines(), skipinitialspace=True))
            if not rows or self.column not in rows[0]:
                raise ValueError(f"no column {shown(self.column)} (there is {one_of([*rows[0]] if rows else [])})")
            return float(rows[self.row][self.column])
        node = json.loads(text)
        for part in str(self.path).split("."):
            node = node[int(part)] if isinstance(node, list) else node[part]
        return float(node)


@dataclass(frozen=True, kw_only=True, config=_CLOSED)
class ModelTable:
    """A program with its files, or a server; `time_limit` [s]."""

    command: Annotated[tuple[Text, ...], several(0, "words", 1000)] = key(
        "the program and its arguments, each a text; a program beside this file is found; no shell is used", ()
    )
    template: Text | None = key("a file in which `{{name}}` or `{{name:.6e}}` stands for an input", None)
    input: Text | None = key("name of the filled template in the run's folder", None, default_is="that of the template")
    depends: tuple[Text, ...] = key("files linked into each run's folder; they belong to the fingerprint", ())
    time_limit: Annotated[Seconds, within(0.0)] | None = key("time after which a run is ended, a time", None)
    tries: Annotated[Whole, within(1, 10, closed=True)] = key("how often a run that failed is tried", 1)
    scratch: Text | None = key(
        "folder of the runs' folders, beside this file; those of failed runs stay", None, default_is="temporary"
    )
    outputs: Mapping[Text, OutputTable] | None = key("an entry for each output of a program", None)
    server: Text | None = key("address of an UM-Bridge server", None)
    name: Text = key("name of the server's model", "forward")
    inputs: Names | None = key("inputs in the order in which the server takes them", None)
    answers: Names | None = key("outputs in the order in which the server gives them", None)
    config: Mapping[Text, Raw] = Field(default_factory=dict, description="what the server's model is told besides")


@dataclass(frozen=True, kw_only=True, config=ConfigDict(defer_build=True))
class _File:
    model: ModelTable = ModelTable()


class _Unread(ValueError):
    """A program ended well, and an output is not where it was declared."""


class Program:
    """A model that is a program: called with columns (n,), it runs once for each row.

    An output that two rows in a row lack for the same cause, before any row had an answer in this
    process, is declared wrongly: ModelUnfit says so.
    """

    def __init__(self, table: ModelTable, folder: Path) -> None:
        self.table, self.folder = table, folder
        self.__qualname__ = table.command[0]
        self.template = None if table.template is None else read_given(folder / table.template, LARGEST).decode()
        self.scratch = None if table.scratch is None else folder / table.scratch
        self.answered, self.unread = False, ""

    def __call__(self, inputs: Mapping[str, Array]) -> dict[str, Array]:
        """One number for each row and output; NaN where the program failed, which is said on stderr."""
        outputs = self.table.outputs or {}
        count = len(next(iter(inputs.values())))
        found = {name: np.full(count, np.nan) for name in outputs}
        for k in range(count):
            row = {name: float(column[k]) for name, column in inputs.items()}
            for again in range(self.table.tries):
                try:
                    with self._folder(row, again) as place:
                        numbers = self._run(row, place)
                except (ValueError, OSError) as error:
                    if again == 0:
                        self._judge(error.__cause__)
                    print(f"{Path(self.table.command[0]).name}: {told(error, 2 * _TOLD)}", file=sys.stderr)
                    continue
                for name, number in numbers.items():
                    found[name][k] = number
                self.answered = True
                break
        return found

    def _judge(self, cause: BaseException | None) -> None:
        """Raise ModelUnfit over the second row in a row without an output for one cause, where none has answered."""
        last, self.unread = self.unread, str(cause) if isinstance(cause, _Unread) else ""
        if self.unread == last != "" and not self.answered:
            raise ModelUnfit(
                f"model.outputs: {told(last, 2 * _TOLD)}, in two runs of {self.__qualname__}, and none has answered"
            )

    @contextlib.contextmanager
    def _folder(self, row: Mapping[str, float], again: int) -> Iterator[Path]:
        """A folder of one's own, which goes when the run has answered and stays, if it has a name, when it failed."""
        mark = hashlib.sha256(repr(sorted(row.items())).encode()).hexdigest()[:12]
        if self.scratch is not None:
            self.scratch.mkdir(parents=True, exist_ok=True)
        place = Path(tempfile.mkdtemp(prefix=f"{mark}-{again}-", dir=self.scratch))
        try:
            yield place
        except (ValueError, OSError, AccessError, TooLarge) as error:
            if self.scratch is None:
                shutil.rmtree(place, ignore_errors=True)
                raise ValueError(str(error)) from error
            raise ValueError(f"{error}; kept in {place}") from error
        except BaseException:
            shutil.rmtree(place, ignore_errors=True)
            raise
        shutil.rmtree(place, ignore_errors=True)

    def _run(self, row: Mapping[str, float], place: Path) -> dict[str, float]:
        """The outputs of one row; ValueError, OSError or AccessError where there are none."""
        for name in self.table.depends:
            source, link = (self.folder / name).resolve(), place / Path(name).name
            try:
                link.symlink_to(source)
            except OSError:  # a system without links
                shutil.copy2(source, link)
        if self.template is not None:
            name = self.table.input or Path(str(self.table.template)).name
            (place / name).write_text(filled(self.template, row), encoding="utf-8")
        words = [filled(word, row) for word in self.table.command]
        beside = (self.folder / words[0]).resolve()
        if beside.is_file():
            words[0] = str(beside)
        _carry_out(words, place, self.table.time_limit)
        texts: dict[str, str] = {}
        numbers = {}
        for name, where in (self.table.outputs or {}).items():
            if where.file not in texts:
                if not (place / where.file).is_file():
                    raise _Unread(f"{where.file}: there is no such file")
                texts[where.file] = read_given(place / where.file, _LARGEST_OUTPUT).decode(errors="replace")
            try:
                numbers[name] = where.number(texts[where.file])
            except (ValueError, LookupError, TypeError) as error:
                raise _Unread(f"{name} is not in {where.file}: {error}") from error
        return numbers


class Server:
    """A model behind an address: called with columns (n,), it asks once for each row."""

    def __init__(self, table: ModelTable) -> None:
        self.table, self.__qualname__ = table, table.name
        self.sizes: list[int] | None = None

    def __call__(self, inputs: Mapping[str, Array]) -> dict[str, Array]:
        """One number for each row and output; raises ModelError with what the server says is wrong."""
        table = self.table
        names, answers = table.inputs or tuple(inputs), table.answers or ()
        missing = [name for name in names if name not in inputs]
        if missing:
            raise ModelError(f"model.inputs names {missing[0]!r}, which is no input of the study")
        cuts = np.cumsum(self._sizes(len(names)))[:-1]
        rows = np.stack([np.asarray(inputs[name], dtype=float) for name in names], axis=1)
        found = np.full((len(rows), len(answers)), np.nan)
        for k, row in enumerate(rows):
            parts = [part.tolist() for part in np.split(row, cuts)]
            given = [number for part in self._ask("Evaluate", input=parts)["output"] for number in part]
            if len(given) != len(answers):
                raise ModelError(f"{table.name} gave {len(given)} outputs, {len(answers)} are named in model.answers")
            found[k] = given
        return {name: found[:, k] for k, name in enumerate(answers)}

    def _sizes(self, count: int) -> list[int]:
        """How many of its `count` inputs each vector holds that the server takes; asked once."""
        if self.sizes is None:
            self.sizes = [int(size) for size in self._ask("InputSizes")["inputSizes"]]
            if sum(self.sizes) != count:
                raise ModelError(f"{self.table.name} takes {sum(self.sizes)} inputs, {count} are named in model.inputs")
        return self.sizes

    def _ask(self, what: str, **more: Raw) -> dict[str, Raw]:
        """The answer to one request."""
        table = self.table
        text, kind = json.dumps({"name": table.name, "config": dict(table.config), **more}), "application/json"
        request = Request(f"{str(table.server).rstrip('/')}/{what}", text.encode(), {"Content-Type": kind})
        try:
            with urlopen(request, timeout=table.time_limit) as answer:
                found = json.loads(answer.read(_LARGEST_OUTPUT))
        except URLError as error:
            body = error.read(_LARGEST_OUTPUT) if hasattr(error, "read") else b""
            with contextlib.suppress(ValueError, LookupError, TypeError):
                said = told(json.loads(body)["error"]["message"])
                raise ModelError(f"the server {table.server} says: {said}") from error
            raise ModelError(f"the server {table.server} does not answer: {told(error.reason)}") from error
        except (OSError, ValueError) as error:
            raise ModelError(f"the server {table.server} does not answer as UM-Bridge does: {told(error)}") from error
        if not isinstance(found, dict) or "error" in found:
            raise ModelError(f"the server {table.server} says: {told(found)}")
        return found


def filled(text: str, row: Mapping[str, float]) -> str:
    """A text with numbers in place of its marks; ModelUnfit names a mark that is no input, or has no such format.

    >>> filled("E = {{E}}, v = {{v:.2e}}", {"E": 0.1, "v": 12.0})
    'E = 0.1, v = 1.20e+01'
    """

    def put(found: re.Match[str]) -> str:
        name, form = found.groups()
        if name not in row:
            raise ModelUnfit(f"{found.group()}: there is no input {name!r}, but {one_of(list(row))}")
        try:
            return format(row[name], form.strip()) if form else repr(row[name])
        except ValueError as error:
            raise ModelUnfit(f"{found.group()}: {error}") from None

    return _PLACE.sub(put, text)


def _carry_out(words: Sequence[str], place: Path, limit: float | None) -> None:
    """Run a program in a folder; what it prints stands there in the files stdout and stderr."""
    with (place / "stdout").open("wb") as out, (place / "stderr").open("wb") as err:
        try:
            process = subprocess.Popen(
                words, cwd=place, stdin=subprocess.DEVNULL, stdout=out, stderr=err, start_new_session=True
            )
        except OSError as error:  # no row of inputs is to blame
            raise ModelUnfit(f"model.command: {words[0]} cannot be started: {error.strerror or error}") from error
        try:
            code = process.wait(limit)
        except subprocess.TimeoutExpired:
            raise ValueError(f"took longer than model.time_limit, {limit:g} s") from None
        finally:
            if os.name == "posix":  # what it started goes with it
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
            process.wait()
    if code:
        with (place / "stderr").open("rb") as err:
            err.seek(-min(_TOLD, err.seek(0, os.SEEK_END)), os.SEEK_END)
            said = err.read().decode(errors="replace").strip()
        ended = f"was ended by signal {-code}" if code < 0 else f"ended with {code}"
        raise ValueError(f"{ended}{': ' if said else ''}{said}")


def read_model(path: Path) -> ModelTable:
    """The table of a file, checked.

    Raises StudyError with every fault, line and column; AccessError where the file cannot be read.
    """
    text = read_text(path)
    findings = Findings(folder=path.parent)
    table = read_table(_File, parse_text(text, path), findings).model
    for key_of, message in _lacking(table):
        if findings.clean(("model", key_of)):
            findings.add(("model", key_of), message)
    for name, where in (table.outputs or {}).items():
        given = [kind for kind in ("pattern", "column", "path") if getattr(where, kind) is not None]
        if len(given) != 1 and findings.clean(("model", "outputs", name)):
            findings.add(("model", "outputs", name), "one of pattern, column or path is due")
        if where.pattern is not None:
            try:
                groups = re.compile(where.pattern).groups
            except re.error as error:
                findings.add(("model", "outputs", name, "pattern"), f"no regular expression: {error}")
            else:
                if groups == 0:
                    findings.add(("model", "outputs", name, "pattern"), "a group in parentheses marks the number")
    if findings.faults:
        raise StudyError(str(path), findings.problems(locate(text)))
    return table


def _lacking(table: ModelTable) -> Iterator[tuple[str, str]]:
    """What a table needs and has not, or has and cannot use: key and message."""
    if bool(table.command) == (table.server is not None):
        yield "command", "a program, command, or an address, server: one of them is due"
    elif table.server is not None:
        if urlsplit(table.server).scheme not in ("http", "https"):
            yield "server", f'found {shown(table.server)}, an address such as "http://localhost:4242" is due'
        if table.answers is None:
            yield "answers", "the names of the server's outputs are due, in its order"
    elif not table.outputs:
        yield "outputs", 'an entry for each output is due, such as y = { pattern = "y = (\\\\S+)" }'


def load_external(path: Path) -> Program | Server:
    """The model that a file declares; raises as `read_model`."""
    table = read_model(path)
    return Server(table) if table.server is not None else Program(table, path.resolve().parent)


def external_digest(path: Path) -> str:
    """What tells one declared model from another: the file, template, program beside it and what it depends on."""
    table = read_model(path)
    found = hashlib.sha256(read_given(path, LARGEST))
    beside = [] if not table.command or not (path.parent / table.command[0]).is_file() else [table.command[0]]
    for name in (*([table.template] if table.template else []), *beside, *table.depends):
        found.update(b"\0" + name.encode() + b"\0" + read_given(path.parent / name, LARGEST))
    return found.hexdigest()[:16]

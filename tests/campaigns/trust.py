"""What a stranger may send and what may go wrong on the way: studies, folders, kills, disks.

    python -m tests.campaigns.trust                               all parts at a tenth of their numbers, as one table
    python -m tests.campaigns.trust studies --count 20000         one part

Studies are sentences of the grammar that `uqsphere schema` prints, whole or grafted into shipped studies, with
words that do not belong there; of one that passes a value is spoilt, which must not pass.  Folders are those of runs,
with files missing, cut, exchanged, or in their place a link, a pipe, a socket, a folder, what is huge or of another
kind.  Commands run in this process under guard: exit code, texts, time, and every write outside one folder.
Runs, or the workers of a cluster on this machine, are killed at random moments; a model that writes down its calls
shows what was evaluated twice.  `disks` are small ones in memory, which take root to mount.  The same seed gives the
same anywhere, but for moments.  Faulty models and closed streams are tests: test_faulty_models.py, test_edges.py.
"""

from __future__ import annotations

import collections
import contextlib
import functools
import hashlib
import io
import json
import os
import random
import re
import resource
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns import options, table, tell
from tests.conftest import BOX, MARGINS, SMALL

ROOT = Path(__file__).parent.parent.parent
#: where folders are made: in memory, if the system has such a place
MEMORY = "/dev/shm" if os.path.isdir("/dev/shm") else None

# --- commands under guard --------------------------------------------------------------------------

#: exit codes that damaged input may give
ALLOWED = (0, 2, 5, 6)
#: seconds that a command may take: of its own work, and all in all on a machine that has other things to do
LONGEST, PATIENCE = 60.0, 600.0
#: bytes of address space that a command may take, which is what a small machine has
MEMORY_LIMIT = 6 << 30

_roots: list[str] = []
_seen: list[str] = []
#: what opening a stranger's file never has a reason to do
_NEVER = ("socket.connect", "socket.bind", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn",
          "pickle.find_class", "os.symlink", "os.link", "ctypes.dlopen")  # fmt: skip
#: position of the path, or of both paths, among the arguments of an event
_WRITES = {"os.mkdir": (0,), "os.rename": (0, 1), "os.remove": (0,), "os.rmdir": (0,), "os.truncate": (0,),
           "os.chmod": (0,), "os.chown": (0,), "os.utime": (0,), "shutil.rmtree": (0,)}  # fmt: skip
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND


def _is_inside(path: Any) -> bool:
    if not isinstance(path, (str, bytes, os.PathLike)):
        return True  # a file that is open already
    real = os.path.realpath(os.fsdecode(path))
    return any(real == root or real.startswith(root + os.sep) for root in _roots) or real == os.devnull


def _hook(event: str, arguments: tuple[Any, ...]) -> None:
    if not _roots:
        return
    if event in _NEVER:
        _seen.append(f"{event} {arguments!r:.200}")
    elif event == "open":
        path, mode, flags = (*arguments, None, None, None)[:3]
        writes = bool(flags and flags & _WRITING) if mode is None else any(c in str(mode) for c in "wax+")
        if writes and not _is_inside(path):
            _seen.append(f"open {path!r} {mode!r} {flags!r}")
    elif event in _WRITES:
        for k in _WRITES[event]:
            path = arguments[k]
            if event in ("os.remove", "os.rmdir") and isinstance(arguments[-1], int) and arguments[-1] >= 0:
                path = f"/proc/self/fd/{arguments[-1]}/{os.fsdecode(path)}"  # relative to an open folder
            # a link is taken away or replaced itself, not what it leads to
            if not _is_inside(os.path.dirname(path) if event in ("os.rename", "os.remove") else path):
                _seen.append(f"{event} {path!r}")


@functools.cache
def _install() -> None:
    sys.addaudithook(_hook)


@contextlib.contextmanager
def guarded(*roots: Path) -> Iterator[list[str]]:
    """Writes outside `roots`, processes, connections and unpickling, as they are asked for."""
    _install()
    _seen.clear()
    _roots[:] = [os.path.realpath(root) for root in roots]
    try:
        yield _seen
    finally:
        _roots.clear()


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command did; `note` is worth a line of its own."""

    code: int
    out: str = ""
    err: str = ""
    seconds: float
    forbidden: tuple[str, ...] = ()
    note: str = ""


class Hang(BaseException):
    """The command takes too long."""


def _too_long(number: int, frame: Any) -> None:
    raise Hang


def watched(arguments: Sequence[str], *roots: Path, do: Callable[[list[str]], int] | None = None) -> Outcome:
    """Run one command here, or else `do`; a hang is cut off."""
    from uqsphere import cli

    out, err = io.StringIO(), io.StringIO()
    before = signal.signal(signal.SIGALRM, _too_long)
    started = time.process_time()
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    code = -1
    # beside another thread nothing is done in a copy of the process, where it would not be seen
    over = threading.Event()
    threading.Thread(target=over.wait, daemon=True).start()
    with guarded(*roots) as seen:
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = (do or cli.main)(list(arguments))
        except Hang:
            code = -2
        except BaseException as error:
            err.write(f"{type(error).__name__}: {error}")
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
            over.set()
        forbidden = tuple(seen)
    seconds = time.process_time() - started
    return Outcome(code=code, out=out.getvalue(), err=err.getvalue(), seconds=seconds, forbidden=forbidden)


def faults_of(outcome: Outcome, allowed: Sequence[int] = ALLOWED) -> list[str]:
    """What is wrong with an outcome; empty if nothing is."""
    faults = []
    if outcome.code == -2:
        faults.append("hangs")
    elif outcome.seconds > LONGEST:
        faults.append(f"takes {outcome.seconds:.1f} s")
    if outcome.code not in (-2, *allowed):
        faults.append(f"exit code {outcome.code}: {outcome.err[-300:]}")
    if "Traceback" in outcome.err or "internal error" in outcome.err:
        faults.append(f"traceback: {outcome.err[-300:]}")
    if "MemoryError" in outcome.err or "out of memory" in outcome.err:
        faults.append(f"takes memory: {outcome.err[-300:]}")
    if outcome.code not in (0, -1, -2) and not outcome.err.strip():
        faults.append("says nothing")
    steering = {c for c in outcome.out + outcome.err if not c.isprintable() and c != "\n"}
    if steering:
        faults.append(f"steers the terminal with {sorted(steering)!r}")
    return faults + [f"forbidden: {text}" for text in outcome.forbidden]


# --- studies --------------------------------------------------------------------------------------


class Word(str):
    """What stands in the file as it is, and is no value of JSON."""


#: what a parser of studies has to think about
WORDS = [
    *map(Word, ("nan", "inf", "-inf", "1e400", "0x7f", "1_000", "1979-05-27", "07:32:00", "9223372036854775808")),
    *(0, -0.0, -1, 1, 1e308, -1e308, 5e-324, 2**63 - 1, True, False, "", "x", "nan GPa", "1e300 GPa", "-3 mm", "1 kg"),
    *("a\x1b[31m", "\u202e", "\u2028", "\x00", "=cmd()", "<script>", "../x.csv", "/etc/passwd", "NUL", "a" * 9999),
    *([], {}, [[]], [1, "a"], {"": 1}, {"dist": "normal"}, {"dist": "empirical", "file": "tests.csv", "column": "x"}),
    *("striker.speed", "sphere.E", "p_max", "y", "x1", "limits.a.strength"),
]  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Grammar:
    """Sentences of a JSON schema; one value in `strange` is a word that is none of it, or what is due elsewhere."""

    schema: dict[str, Any]
    generator: np.random.Generator
    strange: int

    def pick(self, choices: Sequence[Any]) -> Any:
        """One of them."""
        return choices[int(self.generator.integers(len(choices)))]

    def one_in(self, number: int) -> bool:
        """Whether that happened."""
        return bool(self.generator.integers(number) == 0)

    def whole(self, node: dict[str, Any]) -> dict[str, Any]:
        """A node with what it refers to and one of its alternatives in it."""
        while any(key in node for key in ("$ref", "anyOf", "oneOf")):
            node = dict(node)
            if "$ref" in node:
                other = self.schema["$defs"][node.pop("$ref").rsplit("/", 1)[-1]]
            else:
                other = self.pick(node.pop("anyOf" if "anyOf" in node else "oneOf"))
            node = _merged(other, node)
        return node

    def value(self, node: dict[str, Any], depth: int = 0) -> Any:
        """What the schema allows there, or else a word, or what it allows elsewhere."""
        if self.one_in(self.strange):
            node = self.pick(list(self.schema["$defs"].values()))
            if self.one_in(2):
                return self.pick(WORDS)
        node = self.whole(node)
        if "const" in node or "enum" in node:
            return node["const"] if "const" in node else self.pick(node["enum"])
        kind = node.get("type", "string")
        if kind == "object" or "properties" in node:
            return self.table(node, depth)
        if kind == "array":
            least = node.get("minItems", 0)
            count = int(self.generator.integers(least, max(least, min(4, node.get("maxItems", 4))) + 1))
            return [self.value(node.get("items", {}), depth + 1) for _ in range(count)]
        if kind == "boolean":
            return self.one_in(2)
        if kind in ("number", "integer"):
            ends = [node[key] for key in ("minimum", "exclusiveMinimum", "maximum", "exclusiveMaximum") if key in node]
            number = self.pick([*ends, 0.5, 1.0, 3, 20, float(10.0 ** self.generator.uniform(-6, 6))])
            return int(min(number, 1e6)) if kind == "integer" else number
        if "pattern" in node and "examples" in node:  # a number with its unit
            units = re.search(r"\\s\*\(([^()]*(?:\\\([^()]*\\\)[^()]*)*)\)\\s\*\$$", node["pattern"])
            unit = self.pick(units[1].split("|")).replace("\\", "") if units else ""
            return f"{10.0 ** self.generator.uniform(-3, 3):.3g} {unit}"
        return node.get("default", self.pick([w for w in WORDS if isinstance(w, str) and not isinstance(w, Word)]))

    def table(self, node: dict[str, Any], depth: int) -> dict[str, Any]:
        """What is required, some of what is possible, and names of one's own."""
        found = {}
        for name, entry in node.get("properties", {}).items():
            if name in node.get("required", ()) or self.one_in(4 + 2 * depth):
                found[name] = self.value(entry, depth + 1)
        free = [*node.get("patternProperties", {}).values()]
        if isinstance(node.get("additionalProperties"), dict):
            free.append(node["additionalProperties"])
        for entry in free:
            for name in {
                self.pick(["a", "b", "x1", "x2", "E", "nan"]) for _ in range(int(self.generator.integers(1, 3)))
            }:
                found[name] = self.value(entry, depth + 1)
        return found

    def study(self, whole: Sequence[dict[str, Any]]) -> dict[str, Any]:
        """A sentence of its own, or one to three branches of one grafted into a study that is right."""
        if self.one_in(3):
            return dict(self.table(self.whole(self.schema), 0))
        found = json.loads(json.dumps(self.pick(whole), default=str))
        for _ in range(int(self.generator.integers(1, 4))):
            name = self.pick([*found, *self.schema["properties"]])
            new = self.value(self.schema["properties"].get(name, {}))
            if isinstance(new, dict) and isinstance(found.get(name), dict) and new and not self.one_in(4):
                some = self.pick(list(new))  # one entry, so that the rest is still as it was
                inner = found[name].get(some)
                both = isinstance(inner, dict) and isinstance(new[some], dict)
                found[name][some] = {**inner, **new[some]} if both else new[some]
            else:
                found[name] = new
        return dict(found)


def _merged(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    found = {**one, **other}
    for key in ("properties", "patternProperties"):
        if key in one and key in other:
            names = {**one[key], **other[key]}
            found[key] = {n: _merged(one[key].get(n, {}), other[key].get(n, {})) for n in names}
    if "required" in one or "required" in other:
        found["required"] = [*one.get("required", ()), *other.get("required", ())]
    return found


def as_toml(value: Any, top: bool = True) -> str:
    """A document as TOML, tables in a line."""
    if isinstance(value, dict):
        rows = [f"{json.dumps(key)} = {as_toml(entry, False)}" for key, entry in value.items()]
        return "\n".join(rows) + "\n" if top else "{ " + ", ".join(rows) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(as_toml(entry, False) for entry in value) + "]"
    if isinstance(value, float):
        return repr(value)
    return str(value) if isinstance(value, Word) else json.dumps(value, default=str)


def damage_bytes(data: bytes, generator: np.random.Generator) -> bytes:
    """Up to eight bytes in the place of up to eight others, or nothing from there on."""
    at, gone = int(generator.integers(len(data) + 1)), int(generator.integers(9))
    return data[:at] + (generator.bytes(int(generator.integers(9))) + data[at + gone :] if gone else b"")


def damage_json(document: Any, generator: np.random.Generator) -> Any:
    """An entry anywhere in a document taken out, or replaced by another, or by what does not belong there."""
    places: list[tuple[Any, Any]] = []
    nodes = [document]
    for node in nodes:
        if isinstance(node, (dict, list)):
            places += [(node, key) for key in (node if isinstance(node, dict) else range(len(node)))]
            nodes += list(node.values() if isinstance(node, dict) else node)
    strange = [word for word in WORDS if not isinstance(word, Word)]
    if places:
        parent, key = places[int(generator.integers(len(places)))]
        kind = int(generator.integers(3))
        if kind == 0:
            del parent[key]
        else:
            parent[key] = (
                nodes[int(generator.integers(len(nodes)))] if kind == 1 else strange[generator.integers(len(strange))]
            )
    return document


@contextlib.contextmanager
def a_place() -> Iterator[Path]:
    """A folder in memory; commands in it share one parser, which takes longer to build than most studies to check."""
    from uqsphere import cli

    build, parser = cli.build_parser, cli.build_parser()
    with tempfile.TemporaryDirectory(dir=MEMORY) as name:
        cli.build_parser = lambda: parser
        try:
            yield Path(name)
        finally:
            cli.build_parser = build


class Studies:
    """Studies by number: the same for the same seed."""

    def __init__(self, seed: int) -> None:
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            from uqsphere.cli import main

            main(["schema"])
        texts = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "studies").glob("*.toml"))]
        self.whole = [tomllib.loads(text) for text in (*texts, SMALL + MARGINS, BOX)]
        self.schema, self.seed = json.loads(out.getvalue()), seed

    def __call__(self, number: int) -> bytes:
        """One of them."""
        generator = np.random.default_rng([self.seed, number])
        grammar = Grammar(schema=self.schema, generator=generator, strange=1000 if number % 2 else 20)
        data = as_toml(grammar.study(self.whole)).encode("utf-8", "surrogatepass")
        return damage_bytes(data, generator) if number % 16 == 0 else data


#: how each fault of a study begins: file, line, column and key
_NAMED = re.compile(
    r"^(\S*study\.toml:\d+:\d+: (\S.*?: |… and \d+ more faults)|uqsphere: \S+?\.\w+: |warning: \S.*?: )"
)
Trial = Callable[[int], tuple[Outcome, list[str]]]


def check_study(data: bytes, place: Path) -> tuple[Outcome, list[str]]:
    """Check one file; the outcome and what is wrong with it: a refusal that names no key, too."""
    (place / "study.toml").write_bytes(data)
    found = watched(["check", str(place / "study.toml"), "--json"], place)
    faults = faults_of(found, (0, 2))
    if found.code == 0 and not isinstance(json.loads(found.out), dict):
        faults.append("stdout is no document")
    if found.code == 2:
        faults += [f"names no key: {line}" for line in found.err.splitlines() if not _NAMED.match(line)][:1]
    return found, faults


def spoil(document: dict[str, Any], generator: np.random.Generator) -> str:
    """Put what no key takes in the place of a value anywhere in a document; its key."""
    node: Any = document
    while True:
        key = list(node)[int(generator.integers(len(node)))] if isinstance(node, dict) else 0
        below = node[key]
        if not below or not isinstance(below[0] if isinstance(below, list) else below, dict):
            node[key] = {"\u2028": [1]}
            return str(key)
        node = below


def study_trials(seed: int, place: Path) -> Trial:
    """Studies through `check`, and those that pass once more with a value that cannot."""
    make = Studies(seed)
    (place / "tests.csv").write_text("x\n" + "\n".join(str(1.0 + 0.1 * k) for k in range(30)) + "\n")

    def trial(number: int) -> tuple[Outcome, list[str]]:
        data = make(number)
        found, faults = check_study(data, place)
        document = tomllib.loads(data.decode()) if found.code == 0 else {}
        if document:
            key = spoil(document, np.random.default_rng([seed, number, 1]))
            again, more = check_study(as_toml(document).encode(), place)
            faults += more + [f"whatever stands at {key} passes"] * (again.code == 0)
        return found, faults

    return trial


def run_of(study: Any, **more: Any) -> int:
    """A run as Python has it, without its page; the exit code that a command would have."""
    import uqsphere
    from uqsphere.errors import UqsphereError

    try:
        uqsphere.run(study, **more)
        return 0
    except UqsphereError as error:
        print(error, file=sys.stderr)
        return error.exit_code


#: what a study of a run is made to be content with
TINY = ("analysis.budget.evaluations=300", 'analysis.budget.time="5 s"')


def run_trials(seed: int, place: Path) -> Trial:
    """Studies that `check` lets pass, through a run as Python has it; those of models of one's own with a sum."""
    make, following = Studies(seed), iter(range(10**9))
    (place / "tests.csv").write_text("x\n" + "\n".join(str(1.0 + 0.1 * k) for k in range(30)) + "\n")

    import uqsphere
    from uqsphere.errors import UqsphereError
    from uqsphere.mechanics.integrator.compiled import cache_folder

    def trial(number: int) -> tuple[Outcome, list[str]]:
        while True:
            (place / "study.toml").write_bytes(make(next(following)))
            with contextlib.suppress(UqsphereError):
                study = uqsphere.load_study(place / "study.toml", TINY)
                break

        def model(rows: dict[str, Any]) -> dict[str, Any]:
            return dict.fromkeys(study.quantities, sum(np.asarray(column) for column in rows.values()))

        shutil.rmtree(place / "run", ignore_errors=True)
        run = {"out": place / "run", "threads": 1, "model": model if study.black_box else None}
        found = watched([], place, cache_folder() or place, do=lambda _: run_of(study, **run))
        faults = faults_of(found, (0, 2, 4))
        return found, [one for one in faults if "dlopen" not in one and "find_class" not in one]  # compiled code

    return trial


# --- result folders --------------------------------------------------------------------------------

#: commands and how often each is tried among 100 folders; the report draws figures, verify repeats runs: they take long
COMMANDS = {"show": 30, "export": 20, "compare": 20, "verify": 14, "resume": 15, "report": 1}


def _write(path: Path, data: bytes) -> None:
    shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink(missing_ok=True)
    path.write_bytes(data)


def _socket(path: Path) -> None:
    with contextlib.closing(socket.socket(socket.AF_UNIX)) as one, contextlib.chdir(path.parent):
        one.bind(path.name)


def _huge(path: Path) -> None:
    with open(path, "wb") as file:
        file.truncate(1 << 40)  # a file of holes


#: what is put in the place of a file, by the path that it had and a folder outside
PUT: dict[str, Callable[[Path, Path], object]] = {
    "missing": lambda path, outside: None,
    "link out": lambda path, outside: path.symlink_to(outside / "secret.json"),
    "link to itself": lambda path, outside: path.symlink_to(path),
    "link to a folder": lambda path, outside: path.symlink_to(outside),
    "pipe": lambda path, outside: os.mkfifo(path),
    "socket": lambda path, outside: _socket(path),
    "folder": lambda path, outside: path.mkdir(),
    "huge": lambda path, outside: _huge(path),
    "empty": lambda path, outside: path.write_bytes(b""),
    "binary": lambda path, outside: path.write_bytes(bytes(range(256)) * 9),
    "device": lambda path, outside: path.symlink_to("/dev/zero"),
    "list": lambda path, outside: path.write_text("[[]]"),
    "deep": lambda path, outside: path.write_text("[" * 100_000),
    "not a number": lambda path, outside: path.write_text('{"a": NaN}'),
}


def damage_folder(folder: Path, other: Path, outside: Path, generator: np.random.Generator) -> str:
    """Damage a folder in place, once or twice; what was done."""
    done = []
    for _ in range(int(generator.integers(1, 3))):
        paths = sorted(path for path in folder.rglob("*") if path.is_symlink() or path.is_file())
        if not paths:
            break
        top = [path for path in paths if path.parent == folder]  # half of the damage to what every command reads
        some = top if top and generator.integers(2) else paths
        path = some[int(generator.integers(len(some)))]
        plain = path.is_file() and not path.is_symlink() and path.stat().st_size < 1 << 30
        kind = int(generator.integers(6)) if plain else 5
        data = path.read_bytes() if kind <= 2 else b""
        if kind == 0 and path.suffix == ".json":
            with contextlib.suppress(ValueError, RecursionError):
                _write(path, json.dumps(damage_json(json.loads(data), generator), default=str).encode())
            done.append(f"entry of {path.name}")
        elif kind <= 1:
            _write(path, damage_bytes(data, generator))
            done.append(f"bytes of {path.name}")
        elif kind == 2:
            second = paths[int(generator.integers(len(paths)))]
            if second.is_file() and not second.is_symlink() and second.stat().st_size < 1 << 30:
                _write(path, second.read_bytes())
                _write(second, data)
            done.append(f"{path.name} and {second.name} exchanged")
        elif kind == 3 and (other / path.name).is_file():
            _write(path, (other / path.name).read_bytes())
            done.append(f"{path.name} of another run")
        elif kind == 4:
            name = str(generator.choice(["evaluations", "tables", "figures", "export", "services"]))
            if not (folder / name).is_symlink():
                shutil.rmtree(folder / name, ignore_errors=True)
                (folder / name).unlink(missing_ok=True)
                (folder / name).symlink_to(outside)
            done.append(f"{name} leads out")
        else:
            name = str(generator.choice(list(PUT)))
            path.unlink()
            PUT[name](path, outside)
            done.append(f"{path.name}: {name}")
    return ", ".join(done)


def _arguments(command: str, folder: Path, other: Path) -> list[str]:
    more = {"export": ["--format", "csv"], "compare": [str(other)], "verify": ["--chunks", "1", "--json"]}
    return [command, str(folder), *more.get(command, [])]


def folder_trials(seed: int, place: Path) -> Trial:
    """Folders of two runs, damaged, through the commands that look at them and the one that goes on."""
    from uqsphere.store import read_sums, write_sums
    from uqsphere.study import load_study

    quick = SMALL.replace('"0.4 m"', '"1 m"').replace('fidelity = "full"', 'fidelity = "massless"')
    quick = quick.replace("[bars]", "[bars]\ninfinite = true").replace('quantities = ["p_max", "contact_time"]', "")
    quick = re.sub(r"incident_.*|receiving_.*", "", quick).replace("[analysis]", '[analysis]\nmethods = ["qmc"]')
    seeds = []
    for name, text in (("one", quick), ("two", quick.replace("seed = 5", "seed = 6"))):
        (place / f"{name}.toml").write_text(text, encoding="utf-8")
        found = watched(["run", str(place / f"{name}.toml"), "--out", str(place / name), "-j", "1"], Path("/"))
        if found.code not in (0, 3):
            raise RuntimeError(found.err)
        seeds.append(place / name)
    expected = {folder: answers_of(folder) for folder in seeds}
    studies = {folder: load_study(folder.with_suffix(".toml")) for folder in seeds}
    for command in ("verify", "export", "report", "compare"):  # what is loaded on first use is no part of what is tried
        shutil.copytree(seeds[0], place / "warm", dirs_exist_ok=True)
        watched(_arguments(command, place / "warm", seeds[1]), Path("/"))
    folder, outside, temporary = place / "folder", place / "outside", place / "temporary"
    temporary.mkdir()
    outside.mkdir()
    (outside / "secret.json").write_text('{"secret": "do not tell"}')

    def trial(number: int) -> tuple[Outcome, list[str]]:
        generator = np.random.default_rng([seed, number])
        source, other = (seeds[k] for k in generator.permutation(2))
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(source, folder)
        told = damage_folder(folder, other, outside, generator)
        with contextlib.suppress(Exception):  # checksums that fit, as a stranger could make them
            if generator.integers(2):
                write_sums(folder, [name for name in read_sums(folder) if (folder / name).is_file()])
                told += ", forged"
        command = str(generator.choice(list(COMMANDS), p=np.array(list(COMMANDS.values())) / 100.0))
        before, tempfile.tempdir = tempfile.tempdir, str(temporary)
        try:
            do = (lambda _: run_of(studies[source], out=folder, threads=1)) if command == "resume" else None
            found = watched(_arguments(command, folder, other), folder, temporary, do=do)
        finally:
            tempfile.tempdir = before
        faults = faults_of(found, (0, 3, 5, 6) if command == "resume" else (0, 5, 6))
        if command == "resume" and found.code in (0, 3) and answers_of(folder) != expected[source]:
            faults.append("goes on to other answers")
        if [path.name for path in outside.iterdir()] != ["secret.json"] or "do not tell" in found.out + found.err:
            faults.append("reads or writes outside the folder")
        if list(temporary.iterdir()):
            faults.append("leaves temporary files behind")
        return found, [f"{command}, {told}: {fault}" for fault in faults]

    return trial


# --- kills ----------------------------------------------------------------------------------------

CASE = """\
title = "killed"
seed = 3
[inputs]
x1 = {{ dist = "uniform", lower = 0.0, upper = 1.0 }}
x2 = {{ dist = "normal", mean = 0.0, sd = 1.0 }}
[outputs]
names = ["y"]
[limits.high]
quantity = "y"
strength = 4.0
[analysis]
methods = ["sobol"]
{limit}quantiles = [0.5]
accuracy = {{ mean = 0.1, quantile = 0.1, sobol = 0.5, probability = 0.5 }}
"""
#: a call is one line of its file when it begins, and one when it ends; appended, so that processes share the file
COUNTED = """\
import hashlib, os, time
import numpy as np
LOG = os.path.join(os.path.dirname(os.path.abspath(__file__)), "calls.log")

def tell(text):
    with open(LOG, "ab", buffering=0) as log:
        log.write(text.encode())

def f(inputs):
    rows = np.stack([inputs["x1"], inputs["x2"]], axis=1)
    name = hashlib.sha256(rows.tobytes()).hexdigest()[:16]
    tell(f"begin {{name}} {{len(rows)}} {{os.getpid()}}\\n")
    time.sleep({sleep} * len(rows))
    value = rows[:, 0] + rows[:, 1] ** 2
    tell(f"end {{name}} {{len(rows)}} {{os.getpid()}}\\n")
    return {{"y": value}}
"""


@dataclass(kw_only=True)
class Kills:
    """What killing came to: how often, runs that ended, those with other bytes, rows of all kinds, and exit codes.

    `repeated` counts rows whose answer was stored and that were evaluated again; `unstored` those whose call had ended
    when the run was killed and whose answer had not reached its file.
    """

    kills: int = 0
    runs: int = 0
    unequal: int = 0
    repeated: int = 0
    unstored: int = 0
    evaluations: int = 0
    codes: list[int] = field(default_factory=list)

    def ended(self, code: int, equal: bool, evaluations: int) -> None:
        """Count a run that ended."""
        self.runs += 1
        self.codes.append(code)
        self.unequal += int(code != 0 or not equal)
        self.evaluations += evaluations

    def outcome(self, began: float) -> tuple[Outcome, list[str]]:
        """As a trial has it."""
        faults = [f"other bytes ({self.unequal})"] * bool(self.unequal)
        faults += [f"{self.repeated} stored rows evaluated again"] * bool(self.repeated)
        note = f"{self.kills} kills, {self.runs} runs, {self.unstored} of {self.evaluations} rows lost"
        return Outcome(code=max(self.codes), seconds=time.process_time() - began, note=note), faults


def write_case(folder: Path, sleep: float, *, processes: bool = False) -> Path:
    """A black box that writes down its calls, and its study; `sleep` is what a row takes.

    processes : have it evaluated in processes of its own, which a limit of time needs however cheap a row is.
    """
    folder.mkdir(parents=True, exist_ok=True)
    limit = 'time_limit = "1 min"\n' if processes else ""
    (folder / "killed.toml").write_text(CASE.format(limit=limit), encoding="utf-8")
    (folder / "killed.py").write_text(COUNTED.format(sleep=sleep), encoding="utf-8")
    return folder


def answers_of(folder: Path) -> str:
    """One digest of everything that must not depend on how a run came about."""
    digest = hashlib.sha256()
    for path in [folder / "results.json", folder / "samples.npy", *sorted((folder / "tables").iterdir())]:
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def rows_of(case: Path) -> int:
    """Rows whose calls have ended."""
    log = case / "calls.log"
    lines = log.read_text().splitlines() if log.exists() else []
    return sum(int(line.split()[2]) for line in lines if line.startswith("end"))


def _begin(case: Path, *more: str) -> subprocess.Popen[bytes]:
    """A run of the case, in a process that can be killed."""
    line = ["run", str(case / "killed.toml"), "--model", f"{case / 'killed.py'}:f", "--out", str(case / "r"), *more]
    return subprocess.Popen([sys.executable, "-m", "uqsphere", *line], stdout=subprocess.DEVNULL,
                            stderr=subprocess.DEVNULL)  # fmt: skip


def _clear(case: Path) -> None:
    shutil.rmtree(case / "r", ignore_errors=True)
    (case / "calls.log").unlink(missing_ok=True)


def _whole(case: Path, *more: str) -> tuple[str, float, int]:
    """Answers of a run that nobody disturbs, its seconds, and its evaluations."""
    _clear(case)
    began = time.monotonic()
    if code := _begin(case, *more).wait():
        raise RuntimeError(f"a run that nobody disturbs ends with {code}")
    return answers_of(case / "r"), time.monotonic() - began, rows_of(case)


def _stored(case: Path) -> int:
    """Rows in the chunk files of a result folder; parts of a chunk that is whole by now count once."""
    files = {path.name.rsplit("_", 1)[0]: path for path in (case / "r" / "evaluations").glob("*.npy")}
    bases = {key: re.sub(r"\.p\d+-\d+$", "", key) for key in files}
    return sum(len(np.load(files[key])) for key, base in bases.items() if base == key or base not in files)


def kill_runs(case: Path, times: int, *, seed: int = 1, jobs: str = "2") -> Kills:
    """Kill a run at random moments until it finishes, begin a new one, and so on, for a number of kills.

    Answers are held against those of a run that nobody disturbs.  After each kill the rows that are stored are counted:
    with the calls that had ended by then this says what had been evaluated and not stored.
    """
    rng, found = random.Random(seed), Kills()
    whole, seconds, evaluations = _whole(case, "-j", jobs)
    _clear(case)
    lost = 0
    while True:
        began, fresh = time.monotonic(), not (case / "calls.log").exists()
        process = _begin(case, "-j", jobs)
        try:
            code = process.wait(timeout=rng.uniform(0.0, seconds) if found.kills < times else None)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            found.kills += 1
            _settle(case)
            lost = rows_of(case) - _stored(case)
            continue
        if fresh:  # the machine may be busier than it was, or less: moments are drawn from the life of the last run
            seconds = time.monotonic() - began
        made = rows_of(case)
        found.ended(code, code == 0 and answers_of(case / "r") == whole, made)
        # rows whose answers were stored are among the stored ones once: whatever ended more than once and was not lost
        found.unstored += lost
        found.repeated += max(0, made - evaluations - lost)
        if found.kills >= times:
            return found
        lost = 0
        _clear(case)


def _settle(case: Path) -> None:
    """Wait until workers whose run was killed have gone: they end when their input does."""
    before = -1
    for _ in range(100):
        size = (case / "calls.log").stat().st_size if (case / "calls.log").exists() else 0
        if size == before:
            return
        before = size
        time.sleep(0.05)


def kill_trials(seed: int, place: Path) -> Trial:
    """Runs that are killed five times and gone on with until they end; every other one has processes for its model."""

    def trial(number: int) -> tuple[Outcome, list[str]]:
        case = write_case(place / str(number % 2), 0.0005, processes=bool(number % 2))
        return kill_runs(case, 5, seed=1000 * seed + number, jobs="2").outcome(time.process_time())

    return trial


@contextlib.contextmanager
def _killing(cluster: Any, rng: random.Random, found: Kills, times: int, pause: float) -> Iterator[None]:
    """A thread that kills a worker now and then."""
    over = threading.Event()

    def kill() -> None:
        while not over.wait(rng.uniform(0.2 * pause, pause)):
            alive = [w.pid for w in cluster.workers.values() if getattr(w, "pid", None)]
            if alive and found.kills < times:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(rng.choice(alive), signal.SIGKILL)
                    found.kills += 1

    thread = threading.Thread(target=kill, daemon=True)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def worker_trials(seed: int, place: Path) -> Trial:
    """Workers of a Dask cluster that are killed five times while runs go on."""

    def trial(number: int) -> tuple[Outcome, list[str]]:
        import uqsphere
        from uqsphere.runner.workers import dask_cluster

        rng, found, began = random.Random(1000 * seed + number), Kills(), time.process_time()
        case = write_case(place / "case", 0.001)
        whole, seconds, evaluations = _whole(case)
        study = uqsphere.load_study(case / "killed.toml")
        with dask_cluster("local", 2) as executor:
            while found.kills < 5:
                _clear(case)
                with _killing(executor.client.cluster, rng, found, 5, 0.3 * seconds):
                    uqsphere.run(study, out=case / "r", model=f"{case / 'killed.py'}:f", executor=executor)
                made = rows_of(case)
                found.ended(0, answers_of(case / "r") == whole, made)
                found.unstored += made - evaluations
        return found.outcome(began)

    return trial


@contextlib.contextmanager
def _workers(count: int, dask: bool) -> Iterator[Any]:
    """Processes of this machine, or workers of a cluster on it."""
    from uqsphere.runner.workers import LocalWorkers, dask_cluster

    with dask_cluster("local", count) if dask else contextlib.closing(LocalWorkers(count)) as executor:
        yield executor


def scale_trials(seed: int, place: Path) -> Trial:
    """A run whose rows take a while and no processor, with 1, 2, 4, 8 workers of each kind: bytes and seconds."""
    import uqsphere

    # the first has everybody awake
    cases, digests = [write_case(place / "quick", 0.0), write_case(place / "case", 0.005)], set[str]()

    def trial(number: int) -> tuple[Outcome, list[str]]:
        count, dask = 2 ** (number % 4), number % 8 >= 4
        with _workers(count, dask) as executor:
            for case in cases:
                _clear(case)
                began = time.perf_counter()
                study = uqsphere.load_study(case / "killed.toml")
                uqsphere.run(study, out=case / "r", model=f"{case / 'killed.py'}:f", executor=executor)
        seconds = time.perf_counter() - began
        digests.add(answers_of(case / "r"))
        note = f"{count} {'workers of a cluster' if dask else 'processes'}: {seconds:.1f} s"
        return Outcome(code=0, seconds=seconds, note=note), ["other bytes"] * (len(digests) - 1)

    return trial


# --- disks ------------------------------------------------------------------------------------------


def _command(line: str, place: Path) -> Outcome:
    """A line of the shell, `uqsphere` in it."""
    line, began = line.replace("uqsphere", f"{sys.executable} -m uqsphere"), os.times()
    done = subprocess.run(["bash", "-c", line], cwd=place, capture_output=True, text=True, check=False,
                          timeout=PATIENCE)  # fmt: skip
    seconds = sum(os.times()[2:4]) - sum(began[2:4])  # of the processor, those of children
    return Outcome(code=done.returncode, out=done.stdout, err=done.stderr, seconds=seconds)


def disk_trials(seed: int, place: Path) -> Trial:
    """Disks that are full sooner or later: code 6, and the same bytes where a run goes on with more room."""
    case, disk = write_case(place / "case", 0.0), place / "disk"
    disk.mkdir()
    whole = _whole(case)[0]
    line = f"uqsphere run killed.toml --model killed.py:f --out {disk}/r"

    def trial(number: int) -> tuple[Outcome, list[str]]:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={4 << number % 10}k", "none", disk], check=True)
        try:
            found = _command(line, case)
            faults = faults_of(found, (0, 6))
            if found.code == 0 and answers_of(disk / "r") != whole:
                faults.append("ends well with other answers")
            subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
            again = _command(line, case)
            if again.code != 0 or answers_of(disk / "r") != whole:
                faults.append(f"does not go on: {again.err[-300:]}")
        finally:
            subprocess.run(["umount", disk], check=True)
        return found, [f"{4 << number % 10} kB: {fault}" for fault in faults]

    return trial


#: every part, and how many of it there are
PARTS: dict[str, tuple[Callable[[int, Path], Trial], int]] = {
    "studies": (study_trials, 20_000), "runs": (run_trials, 300), "folders": (folder_trials, 5_000),
    "kills": (kill_trials, 6), "workers": (worker_trials, 10), "scale": (scale_trials, 8),
    "disks": (disk_trials, 10),
}  # fmt: skip


def tried(part: str, count: int, *, seed: int = 1, start: int = 0, keep: Path | None = None) -> dict[str, Any]:
    """What the trials of a part came to."""
    codes: collections.Counter[int] = collections.Counter()
    failures, slowest, began = 0, 0.0, time.process_time()
    with a_place() as place:
        trial = PARTS[part][0](seed, place)
        for number in range(start, start + count):
            found, faults = trial(number)
            codes[found.code] += 1
            slowest = max(slowest, found.seconds)
            if found.note:
                tell(f"{part} {seed}/{number}: {found.note}")
            if faults:
                failures += 1
                tell(f"{part} {seed}/{number}: {'; '.join(faults)[:600]}")
                if keep is not None and (place / "study.toml").exists():
                    keep.mkdir(parents=True, exist_ok=True)
                    shutil.copy(place / "study.toml", keep / f"{part}-{seed}-{number}.toml")
    return {"part": part, "done": count, "codes": dict(sorted(codes.items())), "failures": failures,
            "slowest": slowest, "seconds": time.process_time() - began}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Print a row for each part; exit code 1 if anything failed."""
    chosen = options(__doc__, arguments, words=PARTS, count=int, seed=1, start=0, keep=Path)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
    sys.dont_write_bytecode = True  # which is no write of a command's
    rows = []
    for part in chosen.words or PARTS:
        count = chosen.count or (PARTS[part][1] if chosen.words else -(-PARTS[part][1] // 10))
        found = tried(part, count, seed=chosen.seed, start=chosen.start, keep=chosen.keep)
        codes = ", ".join(f"{code}: {number:,}" for code, number in found["codes"].items())
        rows.append((part, f"{found['done']:,}", codes, found["failures"], f"{found['slowest']:.1f}",
                     f"{found['seconds']:.0f}"))  # fmt: skip
    print(table(("part", "number", "exit codes", "faults", "slowest, s", "processor, s"), rows))
    return int(any(row[3] for row in rows))


if __name__ == "__main__":
    sys.exit(main())

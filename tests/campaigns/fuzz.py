"""Damaged study files through `uqsphere check`, and damaged result folders through the commands that look at them.

    python -m tests.campaigns.fuzz studies --count 1000000 --seed 1          a long run; prints what it found
    python -m tests.campaigns.fuzz folders --seconds 60                      time-boxed

The same seed gives the same damage on every machine.  Studies are damaged on the level of words and of bytes in turn; a
failing one is written to --keep DIR.  Files of folders are damaged on the level of bytes, or of the entries of a JSON
document; links, pipes and huge headers are put in their place.  Half of the damaged folders get checksums that fit, as
a stranger could make them.  Commands run in this process under guard: exit code, texts, time, and every write outside
one folder.
"""

from __future__ import annotations

import argparse
import collections
import contextlib
import copy
import gc
import io
import json
import os
import re
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns import tell
from tests.conftest import BOX, MARGINS, SMALL
from tests.report_folders import limit, write_folder

ROOT = Path(__file__).parent.parent.parent
#: where folders are made: in memory, if the system has such a place
MEMORY = "/dev/shm" if os.path.isdir("/dev/shm") else None

# --- damage ---------------------------------------------------------------------------------------

_SINGLE = """
0 -0 1 -1 1e308 1e-308 5e-324 9223372036854775807 -9223372036854775808 1e400 nan inf -inf 0x7f 1_000 true false
"" "0" "auto" "full" "massless" "linear" "free" "fixed" "break" [] {} [[]] 1979-05-27 07:32:00 ''' # =cmd() <script>
sphere bars striker pulse model limits dependence analysis margins inputs outputs E nu radius density material
diameter speed length shape rise fall target quantity strength aim of spearman kendall copula dof quantities accuracy
budget quantiles methods on_failure solve between for_probability lower upper mean sd cov a.b.c.d.e.f.g.h
"""
#: what a parser of studies has to think about
WORDS = [
    *_SINGLE.split(),
    *('"1 m/s"', '"1e300 GPa"', '"-3 mm"', '"10 min"', '"nan GPa"', '"1e-320 m"', "[1, 2", '"""', '"a\\nb"', "\r"),
    *("{ a = 1 }", '{ dist = "normal", mean = 1, sd = 1 }', '{ dist = "normal", mean = 0, cov = 1 }'),
    *('{ dist = "uniform", lower = 0, upper = 0 }', '{ dist = "uniform", lower = -1e308, upper = 1e308 }'),
    *('{ dist = "lognormal", mean = 1, cov = 1e9 }', '{ dist = "weibull", mean = 1, modulus = 1e-3 }'),
    '{ dist = "beta", alpha = 1e-300, beta = 1e300, lower = 0, upper = 1 }',
    *('{ dist = "empirical", file = "tests.csv", column = "x" }', '{ dist = "empirical", file = "/etc/passwd" }'),
    *('{ dist = "empirical", file = "../x.csv", column = "x" }', '{ dist = "empirical", file = "NUL", column = "x" }'),
    *('{ dist = "frechet", shape = 0.1, scale = 1 }', '{ dist = "student_t", dof = 0.5, location = 0, scale = 1 }'),
    *("\\u202e", "\\u0000", "\x1b[31m", "\u2028", "\ufeff"),
]
_TOKEN = re.compile(r'"[^"\n]*"|[A-Za-z_][\w-]*|[-+]?[\d.][\w.+-]*|[\[\]{}=,.#\n]')

NUMBERS: list[Any] = [
    *(0, -1, 1, 2**63, -(2**63), 10**400, 0.0, -0.0, 1e308, -1e308, 5e-324, float("nan"), float("inf"), True, False),
    *(None, "", "x", "\x1b[2J", "=1+1", "<script>alert(1)</script>", "\ud800", "\u202e", "a" * 5000, [], {}, [[]]),
    *({"value": 1}, {"": None}, [None], [1, "a"], {"std_error": 1}),
]


def _pick(generator: np.random.Generator, choices: Sequence[Any]) -> Any:
    return choices[int(generator.integers(len(choices)))]


def damage_bytes(data: bytes, generator: np.random.Generator) -> bytes:
    """One to three flips, cuts, doublings or insertions."""
    out = bytearray(data)
    for _ in range(int(generator.integers(1, 4))):
        at = int(generator.integers(len(out) + 1))
        length = int(generator.integers(1, 40))
        kind = int(generator.integers(6))
        if kind == 0 and out:
            out[min(at, len(out) - 1)] ^= 1 << int(generator.integers(8))
        elif kind == 1:
            del out[at : at + length]
        elif kind == 2:
            out[at:at] = out[at : at + length] * int(generator.integers(1, 4))
        elif kind == 3:
            out[at:at] = generator.integers(0, 256, size=length, dtype=np.uint8).tobytes()
        elif kind == 4:
            del out[at:]
        elif out:
            out[min(at, len(out) - 1)] = int(generator.integers(256))
    return bytes(out)


def damage_text(text: str, others: Sequence[str], generator: np.random.Generator) -> str:
    """One to four changes that mostly leave the syntax alone: words, values, lines, pieces of other studies."""
    for _ in range(int(generator.integers(1, 5))):
        lines = text.split("\n")
        kind = int(generator.integers(7))
        at = int(generator.integers(len(lines)))
        if kind <= 2:
            tokens = list(_TOKEN.finditer(text))
            if tokens:
                token = _pick(generator, tokens)
                new = _pick(generator, WORDS) if kind < 2 else _pick(generator, tokens).group()
                text = text[: token.start()] + new + text[token.end() :]
            continue
        if kind == 3:
            head, equals, _ = lines[at].partition("=")
            lines[at] = f"{head}{equals} {_pick(generator, WORDS)}" if equals else lines[at]
        elif kind == 4:
            del lines[at]
        elif kind == 5:
            lines.insert(int(generator.integers(len(lines))), lines[at])
        else:
            donor = _pick(generator, others).split("\n")
            start = int(generator.integers(len(donor)))
            lines[at:at] = donor[start : start + int(generator.integers(1, 8))]
        text = "\n".join(lines)
    return text


def _places(node: Any, found: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    for key, value in node.items() if isinstance(node, dict) else enumerate(node):
        found.append((node, key))
        if isinstance(value, (dict, list)):
            _places(value, found)
    return found


def damage_json(document: Any, generator: np.random.Generator) -> Any:
    """One or two entries anywhere in a document taken out, renamed, or replaced by what does not belong there."""
    for _ in range(int(generator.integers(1, 3))):
        places = _places(document, []) if isinstance(document, (dict, list)) else []
        if not places:
            return _pick(generator, NUMBERS)
        parent, key = _pick(generator, places)
        kind = int(generator.integers(5))
        if kind == 0:
            del parent[key]
        elif kind == 1 and isinstance(parent, dict):
            parent[str(_pick(generator, NUMBERS))] = parent.pop(key)
        elif kind == 2:
            other, name = _pick(generator, places)
            value = other[name] if (name in other if isinstance(other, dict) else name < len(other)) else None
            parent[key] = copy.deepcopy(value)
        else:
            parent[key] = copy.deepcopy(_pick(generator, NUMBERS))  # the next damage may go into it
    return document


# --- commands under guard --------------------------------------------------------------------------

#: exit codes that damaged input may give
ALLOWED = (0, 2, 5, 6)
#: seconds that a command may take: of its own work, and all in all on a machine that has other things to do
LONGEST, PATIENCE = 5.0, 120.0

_roots: list[str] = []
_seen: list[str] = []
#: what opening a stranger's file never has a reason to do
_NEVER = ("socket.connect", "socket.bind", "subprocess.Popen", "os.system", "os.exec", "os.posix_spawn",
          "pickle.find_class",          "os.symlink", "os.link", "ctypes.dlopen")  # fmt: skip
#: position of the path, or of both paths, among the arguments of an event
_WRITES = {"os.mkdir": (0,), "os.rename": (0, 1), "os.remove": (0,), "os.rmdir": (0,), "os.truncate": (0,),
           "os.chmod": (0,), "os.chown": (0,), "os.utime": (0,), "shutil.rmtree": (0,)}  # fmt: skip
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
_installed = False


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
            if not _is_inside(path):
                _seen.append(f"{event} {path!r}")


@contextlib.contextmanager
def guarded(*roots: Path) -> Iterator[list[str]]:
    """Writes outside `roots`, processes, connections and unpickling, as they are asked for."""
    global _installed
    if not _installed:
        sys.addaudithook(_hook)
        _installed = True
    _seen.clear()
    _roots[:] = [os.path.realpath(root) for root in roots]
    try:
        yield _seen
    finally:
        _roots.clear()


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What a command did."""

    arguments: tuple[str, ...]
    code: int
    out: str
    err: str
    seconds: float
    forbidden: tuple[str, ...]


class Hang(BaseException):
    """The command takes too long."""


def _too_long(number: int, frame: Any) -> None:
    raise Hang


@contextlib.contextmanager
def one_parser() -> Iterator[None]:
    """Commands share one command-line parser: building it takes longer than checking most of the damaged studies."""
    from uqsphere import cli

    build = cli.build_parser
    parser = build()
    cli.build_parser = lambda: parser
    try:
        yield
    finally:
        cli.build_parser = build


def watched(arguments: Sequence[str], *roots: Path) -> Outcome:
    """Run one command here; a hang is cut off."""
    from uqsphere.cli import main

    out, err = io.StringIO(), io.StringIO()
    before = signal.signal(signal.SIGALRM, _too_long)
    started = time.process_time()
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    code = -1
    with guarded(*roots) as seen:
        try:
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                code = main(list(arguments))
        except Hang:
            code = -2
        except BaseException as error:
            code = -1
            err.write(f"{type(error).__name__}: {error}")
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            signal.signal(signal.SIGALRM, before)
        forbidden = tuple(seen)
    return Outcome(arguments=tuple(arguments), code=code, out=out.getvalue(), err=err.getvalue(),
                   seconds=time.process_time() - started, forbidden=forbidden)  # fmt: skip


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
    if outcome.code not in (0, -1, -2) and not outcome.err.strip():
        faults.append("says nothing")
    steering = {c for c in outcome.out + outcome.err if not c.isprintable() and c != "\n"}
    if steering:
        faults.append(f"steers the terminal with {sorted(steering)!r}")
    return faults + [f"forbidden: {text}" for text in outcome.forbidden]


# --- studies --------------------------------------------------------------------------------------

#: a comment that has no quote in it, so that no text in quotes is taken for one
_COMMENT = re.compile(r"""(?m)(?:^|[ \t]+)#[^"'\n]*$""")


def seeds() -> list[str]:
    """Studies to damage: those that are shipped and those of the tests, but for one without their comments.

    Damage to a comment changes nothing, and a third of the shipped studies is comments.
    """
    shipped = [path.read_text(encoding="utf-8") for path in sorted((ROOT / "studies").glob("*.toml"))]
    return [shipped[0], *(_COMMENT.sub("", text) for text in (*shipped, SMALL + MARGINS, BOX))]


def make_study(number: int, seed: int, texts: list[str]) -> bytes:
    """The damaged study of a number: the same for the same seed."""
    generator = np.random.default_rng([seed, number])
    text = texts[int(generator.integers(len(texts)))]
    if generator.integers(4):
        text = damage_text(text, texts, generator)
        return text.encode("utf-8", "surrogatepass")
    return damage_bytes(text.encode(), generator)


def try_study(data: bytes, folder: Path) -> tuple[Outcome, list[str]]:
    """Check one file; the outcome and what is wrong with it."""
    path = folder / "study.toml"
    path.write_bytes(data)
    found = watched(["check", str(path), "--json"], folder)
    faults = faults_of(found)
    if found.code == 0:
        try:
            json.loads(found.out)
        except ValueError as error:
            faults.append(f"stdout is no JSON: {error}")
    return found, faults


# --- result folders --------------------------------------------------------------------------------

DOCUMENTS = ("results.json", "study.resolved.json", "manifest.json", "samples.json")
FILES = (*DOCUMENTS, "samples.npy", "study.toml", "SHA256SUMS")
#: commands and how often each is tried among 100 folders; the report draws figures, verify repeats runs: they take long
COMMANDS = {"show": 44, "show --json": 14, "export": 14, "compare": 17, "verify": 10, "report": 1}


def make_seeds(place: Path) -> list[Path]:
    """Whole result folders to damage: two made by hand, and one of a run."""
    import uqsphere

    (place / "box.toml").write_text(BOX, encoding="utf-8")
    seeds = [
        write_folder(place / "plain", limits={"crushing": limit(0.0123, 0.05, True)}),
        write_folder(place / "rich", quantities=("p_max", "contact_time"), censored=0.2,
                     limits={"a": limit(1e-3, 1e-2, True), "b": limit(0.4, 0.1, False, aim="break"),
                             "c": limit(0.01, 0.01, None)}),
    ]  # fmt: skip
    study = uqsphere.load_study(place / "box.toml")
    uqsphere.run(study, out=place / "run", model=lambda x: {"y": x["x1"] + 0.1 * x["x2"]})
    return [*seeds, place / "run"]


def damage_folder(folder: Path, generator: np.random.Generator) -> str:
    """Damage one copy of a folder in place; what was done."""
    there = [name for name in FILES if (folder / name).is_file()]
    kind = int(generator.integers(10))
    name = str(generator.choice([n for n in there if n in DOCUMENTS]))
    path = folder / name
    if kind <= 5:
        weights = {"results.json": 6.0, "study.resolved.json": 2.0}
        odds = np.array([weights.get(n, 1.0) for n in DOCUMENTS])
        path = folder / str(generator.choice(DOCUMENTS, p=odds / odds.sum()))
        document = damage_json(json.loads(path.read_text(encoding="utf-8")), generator)
        _write(path, json.dumps(document).encode())
        return f"entry of {path.name}"
    if kind <= 7:
        path = folder / str(generator.choice(there))
        _write(path, damage_bytes(path.read_bytes(), generator))
        return f"bytes of {path.name}"
    if kind == 8:
        return _trap(folder, there, generator)
    chunks = sorted((folder / "evaluations").glob("*.npy")) if (folder / "evaluations").is_dir() else []
    if chunks:
        path = chunks[int(generator.integers(len(chunks)))]
        _write(path, damage_bytes(path.read_bytes(), generator))
        return f"chunk {path.name}"
    path.unlink()
    return f"{path.name} gone"


def _write(path: Path, data: bytes) -> None:
    """Put a file in the place of one that shares its content with the seed."""
    path.unlink(missing_ok=True)
    path.write_bytes(data)


def _trap(folder: Path, there: list[str], generator: np.random.Generator) -> str:
    """A link, a pipe, a folder or a lying header where a file is due; a link where a folder is due."""
    kind = int(generator.integers(6))
    path = folder / str(generator.choice(there))
    outside = folder.parent / "outside"
    if kind == 0:
        path.unlink()
        path.symlink_to(outside / "secret.json")
    elif kind == 1:
        path.unlink()
        os.mkfifo(path)
    elif kind == 2:
        path.unlink()
        path.mkdir()
    elif kind == 3:
        name = str(generator.choice(["evaluations", "tables", "figures", "export"]))
        shutil.rmtree(folder / name, ignore_errors=True)
        (folder / name).symlink_to(outside)
        return f"{name} leads out"
    elif kind == 4:
        header = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999999, 4), }"
        _write(folder / "samples.npy", header.ljust(127) + b"\n" + b"\0" * 64)
        return "samples.npy lies about its size"
    else:
        import pickle

        _write(folder / "samples.npy", pickle.dumps([1, 2, 3]))
        return "samples.npy is a pickle"
    return f"trap for {path.name}"


def forge(folder: Path) -> None:
    """Checksums that fit what is there now."""
    from uqsphere.errors import UqsphereError
    from uqsphere.runner.sums import read_sums, write_sums

    try:
        sums = read_sums(folder)
        if sums:
            write_sums(folder, [name for name in sums if (folder / name).is_file()])
    except (UqsphereError, OSError):
        pass


def _arguments(command: str, folder: Path, other: Path, place: Path) -> list[str]:
    words = command.split()
    if words[0] == "export":
        return ["export", str(folder), "--format", "csv"]
    if words[0] == "compare":
        return ["compare", str(folder), str(other)]
    if words[0] == "verify":
        return ["verify", str(folder), "--chunks", "1", "--json"]
    return [words[0], str(folder), *words[1:]]


def try_folder(number: int, seed: int, seeds: list[Path], place: Path) -> tuple[Outcome, list[str], str]:
    """Damage one folder and look at it with one command; the outcome, its faults, and what was done."""
    generator = np.random.default_rng([seed, number])
    source = seeds[int(generator.integers(len(seeds)))]
    folder = place / "folder"
    if folder.is_symlink() or folder.exists():
        shutil.rmtree(folder)
    shutil.copytree(source, folder, copy_function=os.link)
    outside = place / "outside"
    shutil.rmtree(outside, ignore_errors=True)
    outside.mkdir()
    (outside / "secret.json").write_text('{"secret": "do not tell"}')
    done = damage_folder(folder, generator)
    if generator.integers(2):
        forge(folder)
        done += ", forged"
    command = str(generator.choice(list(COMMANDS), p=np.array(list(COMMANDS.values())) / 100.0))
    temporary = place / "temporary"
    temporary.mkdir(exist_ok=True)
    before = tempfile.tempdir
    tempfile.tempdir = str(temporary)
    try:
        found = watched(_arguments(command, folder, source, place), folder, temporary)
    finally:
        tempfile.tempdir = before
    faults = faults_of(found)
    if [path.name for path in outside.iterdir()] != ["secret.json"] or "do not tell" in found.out + found.err:
        faults.append("reads or writes outside the folder")
    if list(temporary.iterdir()):
        faults.append("leaves temporary files behind")
    return found, faults, f"{source.name}: {done}: {command}"


# --- long runs ------------------------------------------------------------------------------------


@contextlib.contextmanager
def study_trials(seed: int, keep: Path | None) -> Iterator[Callable[[int], tuple[Outcome, list[str], str]]]:
    """Trials of studies by number; a failing file is kept."""
    texts = seeds()
    with tempfile.TemporaryDirectory(dir=MEMORY) as name, one_parser():
        folder = Path(name)
        (folder / "tests.csv").write_text("x\n" + "\n".join(str(1.0 + 0.1 * k) for k in range(30)) + "\n")

        def trial(number: int) -> tuple[Outcome, list[str], str]:
            data = make_study(number, seed, texts)
            found, faults = try_study(data, folder)
            if faults and keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"study-{seed}-{number}.toml").write_bytes(data)
            return found, faults, ""

        for number in range(10):
            trial(number)
        yield trial


@contextlib.contextmanager
def folder_trials(seed: int, keep: Path | None) -> Iterator[Callable[[int], tuple[Outcome, list[str], str]]]:
    """Trials of folders by number."""
    with tempfile.TemporaryDirectory(dir=MEMORY) as name, one_parser():
        place = Path(name)
        (place / "seeds").mkdir()
        whole = make_seeds(place / "seeds")
        for command in COMMANDS:  # imports and caches are no part of what is looked at
            shutil.copytree(whole[0], place / "warm", dirs_exist_ok=True)
            watched(_arguments(command, place / "warm", whole[1], place), place)
        yield lambda number: try_folder(number, seed, whole, place)


TRIALS = {"studies": study_trials, "folders": folder_trials}


def fuzz(
    what: str, count: int, *, seconds: float = float("inf"), seed: int = 1, start: int = 0, keep: Path | None = None
) -> dict[str, Any]:
    """Damage and look until the count or the time is reached."""
    codes: collections.Counter[int] = collections.Counter()
    done = failures = 0
    slowest: tuple[float, str] = (0.0, "")
    with TRIALS[what](seed, keep) as trial:
        gc.freeze()  # what is loaded by now stays: looking through it again and again is a quarter of the time
        began = time.monotonic()
        for number in range(start, start + count):
            if time.monotonic() - began > seconds:
                break
            found, faults, told = trial(number)
            codes[found.code] += 1
            done += 1
            slowest = max(slowest, (round(found.seconds, 3), told))
            if done % 10_000 == 0:
                tell(f"{done} {what}, {dict(sorted(codes.items()))}, {failures} failures, slowest {slowest}")
            if faults:
                failures += 1
                tell(f"{seed}/{number}: {told}: {'; '.join(faults)[:600]}")
    return {"done": done, "codes": dict(sorted(codes.items())), "failures": failures, "slowest": slowest,
            "seconds": round(time.monotonic() - began, 1)}  # fmt: skip


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=TRIALS)
    parser.add_argument("--count", type=int, default=10**9)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    chosen = parser.parse_args()
    found = fuzz(
        chosen.what, chosen.count, seconds=chosen.seconds, seed=chosen.seed, start=chosen.start, keep=chosen.keep
    )
    print(json.dumps(found))
    return 1 if found["failures"] else 0


if __name__ == "__main__":
    sys.exit(main())

"""Damaged result folders through show, export, compare, verify and report.

    python -m tests.campaigns.fuzz_folders --count 100000 --seed 1     a long run; prints what it found
    python -m tests.campaigns.fuzz_folders --seconds 60                time-boxed

Files are damaged on the level of bytes, or of the entries of a JSON document; links, pipes and huge headers are
put in their place.  Half of the damaged folders get checksums that fit, as a stranger could make them.
"""

from __future__ import annotations

import argparse
import collections
import gc
import json
import os
import shutil
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from tests.campaigns.fuzz_mutate import damage_bytes, damage_json
from tests.campaigns.fuzz_watch import Outcome, faults_of, one_parser, watched
from tests.report_folders import limit, write_folder

DOCUMENTS = ("results.json", "study.resolved.json", "manifest.json", "samples.json")
#: folders after which a long run says how far it is
REPORTED = 1000
FILES = (*DOCUMENTS, "samples.npy", "study.toml", "SHA256SUMS")
#: commands and how often each is tried among 100 folders; the report draws figures, verify repeats runs: they are dear
COMMANDS = {"show": 44, "show --json": 14, "export": 14, "compare": 17, "verify": 10, "report": 1}


def make_seeds(place: Path) -> list[Path]:
    """Whole result folders to damage: two made by hand, and one of a run."""
    import uqsphere
    from tests.conftest import BOX

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


def fuzz(count: int, seconds: float, seed: int, start: int, verbose: bool) -> dict[str, Any]:
    """Damage and look until the count or the time is reached."""
    began = time.monotonic()
    codes: collections.Counter[int] = collections.Counter()
    commands: collections.Counter[str] = collections.Counter()
    misfits = done = failures = 0
    slowest = (0.0, "")
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as name, one_parser():
        place = Path(name)
        (place / "seeds").mkdir()
        seeds = make_seeds(place / "seeds")
        for command in COMMANDS:  # imports and caches are no part of what is looked at
            shutil.copytree(seeds[0], place / "warm", dirs_exist_ok=True)
            watched(_arguments(command, place / "warm", seeds[1], place), place)
        gc.freeze()  # what is loaded by now stays, and is not looked through again
        for number in range(start, start + count):
            if time.monotonic() - began > seconds:
                break
            found, faults, what = try_folder(number, seed, seeds, place)
            codes[found.code] += 1
            commands[found.arguments[0]] += 1
            slowest = max(slowest, (round(found.seconds, 3), what))
            misfits += "does not fit together" in found.err
            if "does not fit together" in found.err and verbose:
                print(f"misfit {seed}/{number}: {what}: {found.err[:300]}", file=sys.stderr, flush=True)
            done += 1
            if done % REPORTED == 0:
                print(f"{done} folders, {dict(sorted(codes.items()))}, {failures} failures, slowest {slowest}",
                      file=sys.stderr, flush=True)  # fmt: skip
            if faults:
                failures += 1
                print(f"{seed}/{number}: {what}: {'; '.join(faults)[:600]}", file=sys.stderr, flush=True)
    return {"done": done, "codes": dict(sorted(codes.items())), "commands": dict(commands), "failures": failures,
            "caught by the guard": misfits, "slowest": slowest,
            "seconds": round(time.monotonic() - began, 1)}  # fmt: skip


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10**9)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--verbose", action="store_true", help="tell also what the guard caught")
    chosen = parser.parse_args()
    found = fuzz(chosen.count, chosen.seconds, chosen.seed, chosen.start, chosen.verbose)
    print(json.dumps(found))
    return 1 if found["failures"] else 0


if __name__ == "__main__":
    sys.exit(main())

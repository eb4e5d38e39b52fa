"""Damaged study files through `uqsphere check`.

    python -m tests.campaigns.fuzz_studies --count 1000000 --seed 1            a long run; prints what it found
    python -m tests.campaigns.fuzz_studies --seconds 60                        time-boxed
    python -m tests.campaigns.fuzz_studies --engine atheris --seconds 600      guided by coverage, if atheris is there

A failing file is written to --keep DIR.  Files damaged on the level of words and of bytes take turns.
"""

from __future__ import annotations

import argparse
import collections
import gc
import json
import os
import re
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from tests.campaigns.fuzz_mutate import damage_bytes, damage_text
from tests.campaigns.fuzz_watch import Outcome, faults_of, one_parser, watched
from tests.conftest import BOX, MARGINS, SMALL

ROOT = Path(__file__).parent.parent.parent
#: a comment that has no quote in it, so that no text in quotes is taken for one
_COMMENT = re.compile(r"""(?m)(?:^|[ \t]+)#[^"'\n]*$""")
#: files after which a long run says how far it is
REPORTED = 10_000


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


def fuzz(count: int, seconds: float, seed: int, start: int, keep: Path | None) -> dict[str, object]:
    """Damage and check until the count or the time is reached."""
    texts = seeds()
    began = time.monotonic()
    codes: collections.Counter[int] = collections.Counter()
    failures: list[str] = []
    slowest = 0.0
    done = 0
    place = "/dev/shm" if os.path.isdir("/dev/shm") else None
    with tempfile.TemporaryDirectory(dir=place) as name, one_parser():
        folder = Path(name)
        (folder / "tests.csv").write_text("x\n" + "\n".join(str(1.0 + 0.1 * k) for k in range(30)) + "\n")
        for number in range(start, start + count):
            if time.monotonic() - began > seconds:
                break
            data = make_study(number, seed, texts)
            found, faults = try_study(data, folder)
            codes[found.code] += 1
            slowest = max(slowest, found.seconds)
            done += 1
            if done % REPORTED == 0:
                print(f"{done} files, {dict(sorted(codes.items()))}, {len(failures)} failures, slowest {slowest:.3f} s",
                      file=sys.stderr, flush=True)  # fmt: skip
            if faults:
                failures.append(f"{seed}/{number}: {'; '.join(faults)}")
                print(failures[-1], file=sys.stderr, flush=True)
                if keep is not None:
                    keep.mkdir(parents=True, exist_ok=True)
                    (keep / f"study-{seed}-{number}.toml").write_bytes(data)
    return {"done": done, "codes": dict(sorted(codes.items())), "failures": len(failures), "slowest": round(slowest, 3),
            "seconds": round(time.monotonic() - began, 1)}  # fmt: skip


def _guided(seconds: float, keep: Path | None) -> None:
    import atheris

    with atheris.instrument_imports(include=["uqsphere.study", "uqsphere.quantities"]):
        import uqsphere.cli  # noqa: F401
    folder = Path(tempfile.mkdtemp(dir="/dev/shm" if os.path.isdir("/dev/shm") else None))

    def one(data: bytes) -> None:
        _found, faults = try_study(data, folder)
        if faults:
            if keep is not None:
                keep.mkdir(parents=True, exist_ok=True)
                (keep / f"study-atheris-{time.time_ns()}.toml").write_bytes(data)
            raise AssertionError("; ".join(faults))

    corpus = folder / "corpus"
    corpus.mkdir()
    for k, text in enumerate(seeds()):
        (corpus / f"{k}.toml").write_text(text, encoding="utf-8")
    atheris.Setup([sys.argv[0], f"-max_total_time={int(seconds)}", "-max_len=8000", str(corpus)], one)
    atheris.Fuzz()


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=10**9)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--engine", choices=("seeded", "atheris"), default="seeded")
    parser.add_argument("--keep", type=Path)
    chosen = parser.parse_args()
    if chosen.engine == "atheris":
        _guided(chosen.seconds, chosen.keep)
        return 0
    fuzz(10, float("inf"), chosen.seed, 0, None)
    gc.freeze()  # what is loaded by now stays: looking through it again and again is a quarter of the time
    found = fuzz(chosen.count, chosen.seconds, chosen.seed, chosen.start, chosen.keep)
    print(json.dumps(found))
    return 1 if found["failures"] else 0


if __name__ == "__main__":
    sys.exit(main())

"""Whether two states of the code give the same numbers, bit by bit.

    python .ci/same_numbers.py BEFORE [AFTER] [--quick] [--only NAME ...] [--threads 1 2]
    python .ci/same_numbers.py COMMIT --save FOLDER
    python .ci/same_numbers.py COMMIT --round tests/data/numbers.json

BEFORE and AFTER are commits, folders with the package in them, or a folder that `--save` wrote; AFTER is this working
tree unless given.  Commits are checked out beside the repository and run with this interpreter and its packages.  Every
study of `studies/` and of `.ci/studies/` is run at a smoke budget with each number of threads, and every
number and key of results.json and tables/*.csv is compared.  Versions, times and texts are not; `--words` compares
identifiers too (strings without a space), `--within` asks instead whether each answer lies in the other's interval, for
changes that are meant to move numbers.  A stored folder brings its own copies of the studies.

Exit codes: 0 the same, 1 not the same (differences by study and path), 2 not run.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
#: paths whose content says which code ran, not what it found
APART = ("results.json.versions", "results.json.study.hash")
#: differences that are printed of one study
PRINTED = 20

SMOKE = "analysis.accuracy={ mean = 0.02, quantile = 0.05, sobol = 0.05, probability = 0.1 }"
WORSE = "analysis.accuracy={ mean = 0.05, quantile = 0.1, sobol = 0.1, probability = 0.2 }"


@dataclass(frozen=True, kw_only=True)
class Case:
    """One run: a study, what is set in it, and the function of its model."""

    name: str
    study: str
    model: str | None = None
    settings: tuple[str, ...] = ()
    quick: bool = False


def _scene(study: str, evaluations: int, *more: str, name: str = "", quick: bool = False) -> Case:
    settings = (f"analysis.budget.evaluations={evaluations}", WORSE if quick else SMOKE, *more)
    return Case(name=name or study, study=f"studies/{study}.toml", settings=settings, quick=quick)


def _box(study: str, function: str, *settings: str, name: str = "", quick: bool = False) -> Case:
    path, model = f".ci/studies/{study}.toml", f".ci/studies/boxes.py:{function}"
    return Case(name=name or study, study=path, model=model, settings=settings, quick=quick)


CASES = (
    _scene("granite", 20_000, name="granite_quick", quick=True),
    _scene("granite", 60_000),
    _scene("granite_three_ways", 40_000),
    _scene("granite_10mm_test", 20_000),
    _scene("limestone_ball_slow", 20_000),
    _scene("limestone_three_ways", 40_000),
    _scene("glass_bead_small_bar", 20_000),
    _scene("gauge_records", 20_000),
    _scene("as_printed", 20_000),
    _scene("limestone_margin", 40_000),
    _scene(
        "granite",
        40_000,
        "margins={ solve = 'limits.crushing.strength', between = ['1 GPa', '8 GPa'] }",
        name="granite_strength",
    ),
    _scene(
        "granite_three_ways",
        40_000,
        "margins.solve=striker.specific_energy",
        "margins.between=['1 J/kg', '2 kJ/kg']",
        "margins.against=specific_energy",
        name="granite_energy",
    ),
    _scene(
        "granite",
        40_000,
        "margins=null",
        "analysis.second_order=true",
        "analysis.methods=['qmc', 'sobol', 'form', 'importance', 'subset']",
        name="granite_methods",
    ),
    Case(
        name="ishigami",
        study="studies/ishigami.toml",
        model="studies/ishigami.py:ishigami",
        settings=("analysis.cost=1 us", "analysis.budget.evaluations=40000", SMOKE),
        quick=True,
    ),
    _box("expensive", "ishigami", quick=True),
    _box(
        "expensive",
        "ishigami",
        "margins={ solve = 'limits.high.strength', between = [1.0, 15.0], for_probability = [0.05, 0.5] }",
        name="expensive_strength",
    ),
    _box(
        "dependent", "beam", "dependence=null", "analysis.cost=10 s", "analysis.budget.time=40 h", name="expensive_beam"
    ),
    _box("expensive_rare", "margin"),
    _box("expensive_rough", "rough"),
    _box("expensive_few", "rough"),
    _box("rare", "margin"),
    _box("dependent", "beam", quick=True),
    _box("tails", "tails"),
    _box("failures", "holes"),
)

#: studies whose rounded answers stand in tests/data/numbers.json, and what of them
ROUNDED = ("granite_quick", "ishigami", "expensive")
PARTS = ("inputs", "quantities", "sensitivity", "limits", "margins", "fracture")

#: runs every case in one process: the compiled loop is loaded once
RUNNER = """
import json, sys, time
root, studies, out, jobs = sys.argv[1:]
sys.path[:0] = [root]
import uqsphere
if not uqsphere.__file__.startswith(root):
    sys.exit(f"{uqsphere.__file__} was imported, not the package of {root}")
for case, threads in json.loads(jobs):
    begun = time.monotonic()
    folder = f"{out}/{case['name']}-{threads}"
    try:
        study = uqsphere.load_study(f"{studies}/{case['study']}", tuple(case["settings"]))
        model = f"{studies}/{case['model']}" if case["model"] else None
        uqsphere.run(study, out=folder, model=model, threads=threads)
    except Exception as error:
        open(f"{folder}.failed", "w").write(f"{type(error).__name__}: {error}")
    print(f"  {case['name']}-{threads}: {time.monotonic() - begun:.1f} s", file=sys.stderr, flush=True)
"""


# --- runs -----------------------------------------------------------------------------------------


@contextlib.contextmanager
def checked_out(commit: str, place: Path) -> Iterator[Path]:
    """A worktree of a commit."""
    subprocess.run(["git", "-C", str(ROOT), "worktree", "add", "--quiet", "--detach", str(place), commit], check=True)
    try:
        yield place
    finally:
        subprocess.run(["git", "-C", str(ROOT), "worktree", "remove", "--force", str(place)], check=True)


def run_cases(tree: Path, cases: list[Case], threads: list[int], studies: Path, out: Path) -> None:
    """Run the cases with the package in `tree`; `out/NAME-THREADS` keeps results.json and tables."""
    jobs = json.dumps([(asdict(case), count) for count in threads for case in cases])
    environment = {**os.environ, "MPLBACKEND": "Agg"}
    with tempfile.TemporaryDirectory() as place:
        command = [sys.executable, "-c", RUNNER, str(tree), str(studies), place, jobs]
        subprocess.run(command, check=True, cwd=place, env=environment)
        for case in cases:
            for count in threads:
                name = f"{case.name}-{count}"
                (out / name).mkdir(parents=True)
                if (Path(place) / f"{name}.failed").is_file():
                    shutil.copy(Path(place) / f"{name}.failed", out / name / "failed")
                    continue
                shutil.copy(Path(place) / name / "results.json", out / name)
                shutil.copytree(Path(place) / name / "tables", out / name / "tables")


def keep_studies(cases: list[Case], place: Path) -> None:
    """Copy the studies with their models and data, so that both sides are asked the same."""
    for folder in {Path(case.study).parent for case in cases}:
        shutil.copytree(ROOT / folder, place / folder, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
    (place / "cases.json").write_text(json.dumps([asdict(case) for case in cases], indent=1))


def stored_cases(place: Path) -> list[Case]:
    """The cases that a stored folder was made from."""
    rows = json.loads((place / "cases.json").read_text())
    return [Case(**{**row, "settings": tuple(row["settings"])}) for row in rows]


# --- comparison -----------------------------------------------------------------------------------


def read_run(folder: Path) -> dict[str, Any]:
    """Everything of a stored run that is compared, by file."""
    if (folder / "failed").is_file():
        return {"failed": (folder / "failed").read_text()}
    found: dict[str, Any] = {"results.json": json.loads((folder / "results.json").read_text())}
    for path in sorted((folder / "tables").glob("*.csv")):
        with open(path, newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
        found[path.name] = {"columns": dict.fromkeys(rows[0]), "rows": [_cells(rows[0], row) for row in rows[1:]]}
    return found


def _cells(columns: list[str], row: list[str]) -> dict[str, Any]:
    return {column: _number(cell) for column, cell in zip(columns, row, strict=True)}


def _number(cell: str) -> Any:
    try:
        return float(cell)
    except ValueError:
        return cell


def differences(before: Any, after: Any, path: str = "", *, words: bool = False) -> Iterator[str]:
    """Every place where two documents differ in a key, a number, or in what kind of thing stands there."""
    if path in APART:
        return
    if isinstance(before, dict) and isinstance(after, dict):
        for key in [*before, *(key for key in after if key not in before)]:
            inner = f"{path}.{key}" if path else str(key)
            if key not in after:
                yield f"{inner}: gone"
            elif key not in before:
                yield f"{inner}: new"
            else:
                yield from differences(before[key], after[key], inner, words=words)
    elif isinstance(before, list) and isinstance(after, list):
        if len(before) != len(after):
            yield f"{path}: {len(before)} items, now {len(after)}"
        for place, (one, other) in enumerate(zip(before, after, strict=False)):
            yield from differences(one, other, f"{path}[{place}]", words=words)
    elif isinstance(before, str) and isinstance(after, str):
        if words and before != after and " " not in before + after:
            yield f"{path}: {before!r}, now {after!r}"
    elif type(before) is bool or type(after) is bool or not _numbers(before, after):
        if type(before) is not type(after) or before != after:
            yield f"{path}: {before!r}, now {after!r}"
    elif before != after:
        yield f"{path}: {before!r}, now {after!r} (relative {abs(after - before) / max(abs(before), 1e-300):.1e})"


def _numbers(*values: Any) -> bool:
    return all(isinstance(value, (int, float)) for value in values)


def estimates(document: Any, path: str = "") -> Iterator[tuple[str, dict[str, Any]]]:
    """Every estimate with an interval, by its path."""
    if isinstance(document, dict):
        if isinstance(document.get("low"), float) and isinstance(document.get("high"), float):
            yield path, document
        for key, value in document.items():
            yield from estimates(value, f"{path}.{key}" if path else str(key))


def apart(before: dict[str, Any], after: dict[str, Any]) -> tuple[list[str], int]:
    """Estimates of two runs neither of which lies in the other's interval, and how many were compared."""
    ours, found = dict(estimates(before)), []
    pairs = [(path, ours[path], other) for path, other in estimates(after) if path in ours]
    for path, one, other in pairs:
        inside = one["low"] <= other["value"] <= one["high"] or other["low"] <= one["value"] <= other["high"]
        if not inside:
            was = f"{one['value']:.6g} ({one['low']:.6g} to {one['high']:.6g})"
            found.append(f"{path}: {was}, now {other['value']:.6g} "
                         f"({other['low']:.6g} to {other['high']:.6g})")  # fmt: skip
    return found, len(pairs)


def compare(before: Path, after: Path, names: list[str], words: bool, within: bool) -> int:
    """Print the differences by run; how many runs differ."""
    unlike = 0
    for name in names:
        one, other = read_run(before / name), read_run(after / name)
        if within and "failed" not in one | other:
            found, compared = apart(one["results.json"], other["results.json"])
            told = f"{len(found)} of {compared} estimates lie apart"
        else:
            found = list(differences(one, other, words=words))
            parts = Counter(re.sub(r"^results\.json\.", "", line).split(".")[0].split("[")[0] for line in found)
            told = ", ".join(f"{part} {count}" for part, count in parts.items()) or "the same"
        print(f"{name}: {told}")
        for line in found[:PRINTED]:
            print(f"    {line}")
        if len(found) > PRINTED:
            print(f"    and {len(found) - PRINTED} more")
        unlike += bool(found)
    return unlike


def rounded(results: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Every number of a document by its path, to twelve digits."""
    if isinstance(results, (dict, list)):
        inner = results.items() if isinstance(results, dict) else enumerate(results)
        for key, value in inner:
            yield from rounded(value, f"{path}.{key}" if path else str(key))
    elif isinstance(results, (int, float)) and not isinstance(results, bool):
        yield path, float(f"{results:.12g}")


def write_rounded(folder: Path, target: Path) -> None:
    """Keep the rounded answers of the studies in `ROUNDED`, for the tests."""
    found = {
        case.name: {
            part: dict(rounded(content))
            for part, content in read_run(folder / f"{case.name}-1")["results.json"].items()
            if part in PARTS
        }
        for case in CASES
        if case.name in ROUNDED
    }
    target.write_text(json.dumps(found, indent=0).replace("\n}", "}") + "\n", encoding="utf-8")


# --- command --------------------------------------------------------------------------------------


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="Whether two states of the code give the same numbers, bit by bit.")
    parser.add_argument("before", help="a commit, a folder with the package, or a folder that --save wrote")
    parser.add_argument("after", nargs="?", default=str(ROOT), help="the same (default: this working tree)")
    parser.add_argument("--quick", action="store_true", help="few small studies, with one thread")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="these studies")
    parser.add_argument("--threads", nargs="+", type=int, help="numbers of threads (default 1 2; quick: 1)")
    parser.add_argument("--words", action="store_true", help="compare identifiers too")
    parser.add_argument("--within", action="store_true", help="whether answers lie in each other's intervals instead")
    parser.add_argument("--save", type=Path, metavar="FOLDER", help="run BEFORE and keep its answers for later")
    parser.add_argument(
        "--round", type=Path, metavar="FILE", help="run BEFORE and keep its rounded answers for the tests"
    )
    chosen = parser.parse_args(arguments)
    if chosen.round:
        chosen.only, chosen.threads = ROUNDED, [1]
    stored = (Path(chosen.before) / "cases.json").is_file()
    cases = stored_cases(Path(chosen.before)) if stored else list(CASES)
    cases = [case for case in cases if (case.name in chosen.only if chosen.only else case.quick or not chosen.quick)]
    threads = chosen.threads or ([1] if chosen.quick else [1, 2])
    if not cases:
        parser.error("no such study")
    with contextlib.ExitStack() as held:
        place = chosen.save or Path(held.enter_context(tempfile.TemporaryDirectory()))
        place.mkdir(parents=True, exist_ok=True)

        def answers(side: str, studies: Path, out: Path) -> Path:
            if (Path(side) / "cases.json").is_file():
                return Path(side)
            tree = Path(side).resolve()
            if not (tree / "uqsphere").is_dir():
                tree = held.enter_context(
                    checked_out(side, Path(held.enter_context(tempfile.TemporaryDirectory())) / "t")
                )
            print(f"running {side}", file=sys.stderr)
            run_cases(tree, cases, threads, studies.resolve(), out)
            return out

        studies = Path(chosen.before) if stored else place
        if not stored:
            keep_studies(cases, place)
        before = answers(chosen.before, studies, place if chosen.save else place / "before")
        if chosen.round:
            write_rounded(before, chosen.round)
        if chosen.save or chosen.round:
            return 0
        after = answers(chosen.after, studies, place / "after")
        names = [f"{case.name}-{count}" for count in threads for case in cases]
        unlike = compare(before, after, names, chosen.words, chosen.within)
    print("the same numbers" if not unlike else f"{unlike} of {len(names)} runs differ")
    return 1 if unlike else 0


if __name__ == "__main__":
    sys.exit(main())

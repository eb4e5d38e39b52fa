"""Mutants: one change in one place of a module, and whether the tests of its room notice it.

    python -m tests.campaigns.mutants [ROOM...] [--number 12] [--seed 1]

A comparison is turned or its boundary moved, a sign, an operator or a number changed, a condition
negated, in a copy of the tree; the tests of the room that name the module (all, if none does) run
until the first that fails.  One that hangs is caught.  Survivors are printed with their places.
Modules with compiled kernels are left out.
"""

from __future__ import annotations

import ast
import contextlib
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tests.campaigns import options, table, tell

ROOT = Path(__file__).parents[2]
#: modules of a room (patterns in `uqsphere/`), and its tests (patterns in `tests/`)
ROOMS = {
    "mechanics": ("mechanics/[bcfpvy]*.py", "mechanics/test_*.py"),
    "uq": ("uq/**/*.py", "uq/test_*.py"),
    "study": ("study/*.py", "study/test_*.py"),
    "models": ("models/*.py", "models/test_*.py"),
    "propagation": ("propagation/*.py", "propagation/test_*.py"),
    "labs": ("labs/**/*.py", "labs/test_*.py"),
}
TURNED: dict[type[ast.AST], tuple[type[Any], ...]] = {
    ast.Lt: (ast.GtE, ast.LtE),
    ast.LtE: (ast.Gt, ast.Lt),
    ast.Gt: (ast.LtE, ast.GtE),
    ast.GtE: (ast.Lt, ast.Gt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
    ast.Add: (ast.Sub,),
    ast.Sub: (ast.Add,),
    ast.Mult: (ast.Div,),
    ast.Div: (ast.Mult,),
    ast.And: (ast.Or,),
    ast.Or: (ast.And,),
    ast.USub: (ast.UAdd,),
    ast.Not: (ast.UAdd,),
}


def mutations(tree: ast.AST) -> Iterator[tuple[ast.AST, str, Any]]:
    """Node, field and new value of every change."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            yield node, "value", node.value * 2 if node.value not in (0, 1) else 1 - node.value
        elif isinstance(node, ast.Compare) and len(node.ops) == 1:
            yield from ((node, "ops", [other()]) for other in TURNED[type(node.ops[0])])
        elif isinstance(node, (ast.BinOp, ast.BoolOp, ast.UnaryOp)):
            yield from ((node, "op", other()) for other in TURNED.get(type(node.op), ()))
        elif isinstance(node, ast.If):
            yield node, "test", ast.UnaryOp(ast.Not(), node.test)


def related(tree: Path, module: Path, pattern: str) -> tuple[str, ...]:
    """Test files that name a module, its own first, and the examples of its folder."""
    stem, files = module.stem, sorted((tree / "tests").glob(pattern))
    named = [file for file in files if re.search(rf"\b{stem}\b", file.read_text("utf-8"))] or files
    return (
        *map(str, sorted(named, key=lambda file: (stem not in file.stem, file.stat().st_size))),
        str(module.parent),
    )


def caught(tree: Path, tests: tuple[str, ...], most: float) -> bool:
    """Whether the tests fail, or take more seconds than `most`."""
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n0", "-p", "no:cacheprovider", *tests]
    with contextlib.suppress(subprocess.TimeoutExpired):
        here = {**os.environ, "PYTHONPATH": str(tree)}
        return (
            subprocess.run(
                command, cwd=tree, env=here, capture_output=True, timeout=most
            ).returncode
            != 0
        )
    return True


def main(arguments: Sequence[str] | None = None) -> None:
    given, rows = options(__doc__, arguments, words=tuple(ROOMS), number=12, seed=1), []
    with tempfile.TemporaryDirectory() as folder:
        tree = shutil.copytree(
            ROOT, Path(folder) / "tree", ignore=shutil.ignore_patterns(".git", ".venv")
        )
        for room in given.words or ROOMS:
            modules, pattern = ROOMS[room]
            seconds, found = dict[tuple[str, ...], float](), list[bool]()
            places = [
                (path, k)
                for path in sorted((tree / "uqsphere").glob(modules))
                for k, _ in enumerate(mutations(ast.parse(path.read_text())))
            ]
            for path, k in random.Random(f"{given.seed} {room}").sample(places, given.number):
                tests, text = related(tree, path, pattern), path.read_text()
                if tests not in seconds:
                    begun = time.perf_counter()
                    if caught(tree, tests, 3600.0):
                        raise SystemExit(f"the tests of {path.name} fail without a mutant")
                    seconds[tests] = time.perf_counter() - begun
                node, name, value = list(mutations(changed := ast.parse(text)))[k]
                before = ast.unparse(node)
                setattr(node, name, value)
                path.write_text(ast.unparse(ast.fix_missing_locations(changed)))
                found.append(caught(tree, tests, 60.0 + 5.0 * seconds[tests]))
                path.write_text(text)
                if not found[-1]:
                    tell(
                        f"{path.relative_to(tree)}:{getattr(node, 'lineno', 0)}: {before} -> "
                        f"{ast.unparse(node)}"
                    )
            rows.append([room, len(found), sum(found), f"{sum(found) / len(found):.0%}"])
            tell(table(["room", "mutants", "caught", "share"], rows))


if __name__ == "__main__":
    main()

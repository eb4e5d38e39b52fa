"""The floors of the house: a module imports from floors below its own, and from its own floor, never from above."""

from __future__ import annotations

import ast
import subprocess
from pathlib import Path

import pytest

import uqsphere

ROOT = Path(uqsphere.__file__).parent

#: floor of every module or package; those with the same number in different rooms must not import each other
FLOORS = {
    "uqsphere.errors": 0,
    "uqsphere.arrays": 0,
    "uqsphere.units": 1,
    "uqsphere.files": 1,
    "uqsphere.mechanics": 2,
    "uqsphere.uq": 2,
    "uqsphere.quantities": 3,
    "uqsphere.materials": 3,
    "uqsphere.records": 3,
    "uqsphere.black_box": 3,
    "uqsphere.study": 4,
    "uqsphere.model": 6,
    "uqsphere.store": 6,
    "uqsphere.console": 6,
    "uqsphere.results": 7,
    "uqsphere.runner": 8,
    "uqsphere.report": 9,
    "uqsphere.given": 9,
    "uqsphere.bench": 10,
    "uqsphere.planning": 10,
    "uqsphere.cli": 11,
    "uqsphere.__main__": 12,
}
#: the root names the package's version and hands out its public names lazily: every floor may read the version
PUBLIC = "uqsphere"

MODULES = {
    ".".join(("uqsphere", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__"): path
    for path in sorted(ROOT.rglob("*.py"))
}


def room_of(module: str) -> str | None:
    """The entry of FLOORS that a module belongs to."""
    parts = module.split(".")
    room = ".".join(parts[:2])
    return room if room in FLOORS else None


def imported(text: str, module: str) -> set[str]:
    """Modules of the package that a source imports anywhere, functions and TYPE_CHECKING included."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module} imports relatively: write the whole path"
            base = node.module or ""
            found |= {f"{base}.{name.name}" if base == PUBLIC else base for name in node.names}
    return {name for name in found if name == PUBLIC or name.startswith(f"{PUBLIC}.")}


def faults_of(module: str, imports: set[str]) -> list[str]:
    """Imports that go up, or across between rooms of one floor."""
    here = room_of(module)
    assert here is not None, f"{module} stands on no floor: add it to FLOORS where it belongs"
    faults = []
    for target in sorted(imports - {PUBLIC}):
        there = room_of(target)
        assert there is not None, f"{module} imports {target}, which stands on no floor"
        across = FLOORS[there] == FLOORS[here] and there != here
        if FLOORS[there] > FLOORS[here] or across:
            faults.append(f"{module} -> {target}")
    return faults


@pytest.mark.parametrize("module", [name for name in MODULES if name != PUBLIC])
def test_imports_point_down(module: str) -> None:
    assert faults_of(module, imported(MODULES[module].read_text(encoding="utf-8"), module)) == []


def test_every_floor_is_lived_on() -> None:
    assert {room_of(module) for module in MODULES if module != PUBLIC} == set(FLOORS)


def test_the_root_imports_nothing_when_it_is_imported() -> None:
    tree = ast.parse(MODULES[PUBLIC].read_text(encoding="utf-8"))
    eager = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
    names = {node.module if isinstance(node, ast.ImportFrom) else node.names[0].name for node in eager}
    assert names == {"__future__", "typing"}


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("uqsphere.mechanics.contact", "from uqsphere.uq.law import mean"),
        ("uqsphere.uq.joint", "def f():\n    import uqsphere.mechanics.scene"),
        ("uqsphere.study.text", "from uqsphere import runner"),
        ("uqsphere.model", "from uqsphere.store import Store"),
        ("uqsphere.errors", "from uqsphere.quantities import UNITS"),
    ],
)
def test_a_wrong_import_is_found(module: str, line: str) -> None:
    assert len(faults_of(module, imported(line, module))) == 1


def test_files_stay_readable() -> None:
    long = {name: lines for name, path in MODULES.items() if (lines := path.read_text("utf-8").count("\n")) >= 800}
    assert not long


def test_the_top_level_is_as_agreed() -> None:
    """What is kept there is told by git; a stray file is found before it goes out."""
    top = ROOT.parent
    kept = subprocess.run(["git", "ls-files"], cwd=top, capture_output=True, text=True, check=True).stdout.splitlines()
    names = {name.partition("/")[0] for name in kept}
    agreed = {
        "pyproject.toml",
        "uqsphere",
        "tests",
        "studies",
        "reports",
        "README.md",
        "docs",
        "CHANGELOG.md",
        "LICENSE",
    }
    assert {name for name in names if not name.startswith(".")} == agreed | {"constraints.txt"}

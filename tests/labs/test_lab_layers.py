"""The labs stand beside the product: nothing of it imports them, and they import public names only."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[2] / "uqsphere"
LAB_FILES = sorted((HOUSE / "labs").rglob("*.py"))
#: modules of the product that labs may use, and names where only some of a module are public
ALLOWED = {
    "uqsphere", "uqsphere.arrays", "uqsphere.errors", "uqsphere.materials", "uqsphere.mechanics.contact",
    "uqsphere.mechanics.bars", "uqsphere.quantities", "uqsphere.study", "uqsphere.tables", "uqsphere.units",
    "uqsphere.uq",
}  # fmt: skip


def imported(path: Path) -> list[tuple[str, str]]:
    """Module and name of every import of a file."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path.name}: imports are absolute"
            found += [(node.module or "", alias.name) for alias in node.names]
    return found


def test_nothing_of_the_product_imports_a_lab() -> None:
    for path in HOUSE.rglob("*.py"):
        if path not in LAB_FILES:
            names = {f"{module}.{name}" for module, name in imported(path)}
            assert not [one for one in names if one.startswith("uqsphere.labs")], path


@pytest.mark.parametrize("path", LAB_FILES, ids=lambda p: str(p.relative_to(HOUSE)))
def test_a_lab_imports_public_names_only(path: Path) -> None:
    for module, name in imported(path):
        if module.partition(".")[0] == "uqsphere" and not module.startswith("uqsphere.labs"):
            assert module in ALLOWED, f"{module} is not public"
            assert not name.startswith("_")


def test_the_lab_commands_need_no_heavy_import_for_their_help() -> None:
    import subprocess
    import sys

    code = (
        "import sys; from uqsphere.labs.shpb.cli import main; from uqsphere.labs.comminution.cli import main as other; "
        "main(['--help']); other(['--help']); "
        "print([m for m in ('pandas', 'matplotlib', 'scipy.stats', 'scipy.optimize') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=HOUSE.parent)
    assert done.stdout.splitlines()[-1] == "[]"

"""The labs stand beside the product: nothing of it imports them, and they import public names
only.
"""

from __future__ import annotations

import ast
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

HOUSE = Path(__file__).parents[2] / "uqsphere"
LAB_FILES = sorted((HOUSE / "labs").rglob("*.py"))
#: modules of the product that labs may use, and names where only some of a module are public
ALLOWED = {
    "uqsphere",
    "uqsphere.arrays",
    "uqsphere.documents",
    "uqsphere.errors",
    "uqsphere.materials",
    "uqsphere.mechanics.contact",
    "uqsphere.mechanics.bars",
    "uqsphere.mechanics.roots",
    "uqsphere.mechanics.yielding",
    "uqsphere.quantities",
    "uqsphere.report.figures",
    "uqsphere.report.tables",
    "uqsphere.results.folder",
    "uqsphere.study",
    "uqsphere.tables",
    "uqsphere.units",
    "uqsphere.uq",
    "uqsphere.uq.curve",
}


def imported(path: Path) -> list[tuple[str, str]]:
    """Module and name of every import of a file."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [(alias.name, "") for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level != 1:  # 1: of the lab itself
            assert node.level == 0, f"{path.name}: imports from elsewhere are absolute"
            found += [(node.module or "", alias.name) for alias in node.names]
    return found


@pytest.mark.parametrize("path", LAB_FILES, ids=lambda p: str(p.relative_to(HOUSE)))
def test_a_lab_imports_public_names_only(path: Path) -> None:
    for module, name in imported(path):
        if module.partition(".")[0] == "uqsphere" and not module.startswith("uqsphere.labs"):
            assert module in ALLOWED, f"{module} is not public"
            assert not name.startswith("_")


def test_the_lab_commands_need_no_heavy_import_for_their_help() -> None:
    code = (
        "import sys, uqsphere.labs.comminution.cli\n"
        "from uqsphere.labs.files import run_command\n"
        "try: run_command('shpb', '--help')\n"
        "except SystemExit: "
        "print([m for m in ('pandas', 'matplotlib', 'scipy.stats', 'scipy.optimize') if m in "
        "sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=HOUSE.parent
    )
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_product_stands_without_the_labs(tmp_path: Path) -> None:
    """Every module imports, a study loads, and the labs' commands are unknown, where `labs/` is
    deleted.
    """
    shutil.copytree(
        HOUSE, tmp_path / "uqsphere", ignore=shutil.ignore_patterns("labs", "__pycache__")
    )
    code = (
        "import pkgutil, importlib, sys, uqsphere; "
        "names = [m.name for m in pkgutil.walk_packages(uqsphere.__path__, 'uqsphere.') if "
        "'__main__' not in m.name]; "
        "[importlib.import_module(name) for name in names]; "
        "from uqsphere.cli import main; "
        "print(uqsphere.__file__, len(uqsphere.load_study(sys.argv[1]).limits)); main(['shpb'])"
    )
    study = HOUSE.parent / "studies/limestone_margin.toml"
    alone = {"PATH": "", "PYTHONPATH": str(tmp_path), "HOME": str(tmp_path)}
    command = [sys.executable, "-c", code, str(study)]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=tmp_path, check=False, env=alone
    )
    assert done.returncode == 2
    assert "unknown command 'shpb'" in done.stderr
    assert done.stdout.split() == [str(tmp_path / "uqsphere" / "__init__.py"), "2"]

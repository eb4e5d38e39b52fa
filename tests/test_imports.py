"""Heavy packages are loaded when they are needed and not before."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import uqsphere

ROOT = Path(uqsphere.__file__).parent
STUDIES = ROOT.parent / "studies"
HEAVY = ("scipy.stats", "pandas", "chaospy", "SALib", "matplotlib", "numba")
#: the files that may import each of these
HOMES = {
    "chaospy": {"uq/expansion/germs.py"},
    "numpoly": {"uq/expansion/germs.py"},
    "numba": {"mechanics/integrator/compiled.py", "mechanics/integrator/vectors.py"},
}

PROBE = """
import sys
from uqsphere.cli import main
try:
    code = main({arguments!r})
except SystemExit as error:
    code = error.code
heavy = [name for name in {heavy!r} if name in sys.modules]
print("\\nHEAVY", code, heavy, file=sys.stderr)
"""


def heavy_after(*arguments: str) -> str:
    """Exit code and the heavy packages that a fresh process has loaded after a command."""
    code = PROBE.format(arguments=list(arguments), heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    return done.stderr.strip().splitlines()[-1]


@pytest.mark.parametrize(
    "arguments",
    [
        ("--help",),
        ("run", "--help"),
        ("--version",),
        ("check", str(STUDIES / "granite.toml")),
        ("check", str(STUDIES / "granite.toml"), "--json"),
        ("check", str(STUDIES / "limestone_ball_slow.toml")),
        ("check", str(STUDIES / "ishigami.toml")),
        ("list", "quantities"),
        ("schema",),
    ],
    ids=" ".join,
)
def test_nothing_heavy_is_loaded(arguments: tuple[str, ...]) -> None:
    assert heavy_after(*arguments) == "HEAVY 0 []"


def test_help_loads_no_numbers() -> None:
    code = "import sys; from uqsphere.cli import build_parser; build_parser()"
    code += "; print({'numpy', 'pydantic'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "set()"


def test_the_probe_sees_what_is_loaded() -> None:
    assert "numba" in heavy_after("history", str(STUDIES / "granite.toml"), "--set", "model.tolerance=1e-4")


def imports_at_top(tree: ast.Module) -> set[str]:
    """Packages imported when the module is; what stands below TYPE_CHECKING never runs."""
    found: set[str] = set()
    todo: list[ast.stmt] = list(tree.body)
    while todo:
        node = todo.pop()
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module} | {f"{node.module}.{name.name}" for name in node.names}
        elif isinstance(node, ast.If) and not (isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"):
            todo += [*node.body, *node.orelse]
        elif isinstance(node, (ast.ClassDef, ast.With, ast.Try)):
            todo += node.body
    return found


def is_heavy(name: str) -> bool:
    return any(name == heavy or name.startswith(f"{heavy}.") for heavy in (*HEAVY, "numpoly", "jinja2"))


@pytest.mark.parametrize("path", sorted(ROOT.rglob("*.py")), ids=lambda path: str(path.relative_to(ROOT)))
def test_heavy_packages_are_imported_in_functions(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert [name for name in imports_at_top(tree) if is_heavy(name)] == []


@pytest.mark.parametrize("package", HOMES)
def test_a_heavy_package_has_one_home(package: str) -> None:
    users = set()
    for path, text in ((path, path.read_text(encoding="utf-8")) for path in ROOT.rglob("*.py")):
        for node in ast.walk(ast.parse(text)) if package in text else ():
            names = [n.name for n in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.split(".")[0] == package for name in names):
                users.add(str(path.relative_to(ROOT)))
    assert users <= HOMES[package], f"{package} is imported in {sorted(users)}"


def test_a_heavy_import_at_the_top_is_found() -> None:
    assert is_heavy(next(iter(imports_at_top(ast.parse("import numba")))))
    assert any(is_heavy(name) for name in imports_at_top(ast.parse("from scipy import stats")))
    assert not any(is_heavy(name) for name in imports_at_top(ast.parse("def f():\n    import numba")))


def test_runs_need_no_chaospy(tmp_path: Path) -> None:
    """Its dependency numpoly comes as source: without a compiler it is not there."""
    code = f"""
import sys
sys.modules["chaospy"] = sys.modules["numpoly"] = None
import numpy as np, uqsphere
from uqsphere.errors import UsageError
study = uqsphere.load_study({str(STUDIES / "ishigami.toml")!r}, ("analysis.budget.evaluations=9000",))
box = lambda rows: {{"y": np.sin(rows["x1"]) + rows["x2"] * rows["x3"]}}
assert uqsphere.run(study, out={str(tmp_path / "r")!r}, model=box).results.sensitivity
from uqsphere.uq.expansion import law_germ
try:
    law_germ("x", quantile=np.sqrt, density=lambda x: 2.0 * x, lower=0.0, upper=1.0)
except UsageError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert "needs chaospy" in done.stdout


def test_doctor_says_what_a_system_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    from uqsphere.cli.doctor import examine

    monkeypatch.setattr("uqsphere.runner.results.versions", lambda: {"numpy": "2.0", "chaospy": "missing"})
    for name, said in (("linux", "apt install gcc"), ("darwin", "xcode-select"), ("win32", "winget"), ("aix", "one")):
        monkeypatch.setattr(sys, "platform", name)
        (entry,) = [entry for entry in examine()["checks"] if entry["check"] == "packages"]
        assert not entry["ok"]
        assert said in entry["text"]

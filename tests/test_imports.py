"""Heavy packages are loaded when they are needed and not before."""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import uqsphere

ROOT = Path(uqsphere.__file__).parent
STUDIES = ROOT.parent / "studies"
HEAVY = ("scipy.stats", "pandas", "chaospy", "SALib", "matplotlib", "numba")
#: the files that may import each of these
HOMES = {
    "chaospy": {"uq/interop.py"},
    "numpoly": {"uq/interop.py"},
    "SALib": {"uq/interop.py", "runner/questions/further.py"},
    "numba": {"mechanics/integrator/compiled.py", "mechanics/integrator/vectors.py"},
}

PROBE = """
import sys
from collections.abc import Iterator
from uqsphere.cli import main
codes = set()
for line in {lines!r}:
    try:
        codes.add(main(line))
    except SystemExit as error:
        codes.add(error.code)
heavy = [name for name in {heavy!r} if name in sys.modules]
print("\\nHEAVY", sorted(codes), heavy, file=sys.stderr)
"""


def heavy_after(*lines: list[str]) -> str:
    """Exit codes and the heavy packages that a fresh process has loaded after some commands."""
    code = PROBE.format(lines=list(lines), heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    return done.stderr.strip().splitlines()[-1]


def test_nothing_heavy_is_loaded() -> None:
    """By any of these, one after the other in one process."""
    lines = [["--help"], ["run", "--help"], ["--version"], ["list", "quantities"], ["schema"]]
    lines += [["check", str(STUDIES / f"{name}.toml")] for name in ("granite", "limestone_ball_slow", "ishigami")]
    assert heavy_after(*lines, ["check", str(STUDIES / "granite.toml"), "--json"]) == "HEAVY [0] []"


def test_help_loads_no_numbers() -> None:
    code = "import sys; from uqsphere.cli import build_parser; build_parser()"
    code += "; print({'numpy', 'pydantic'} & {*sys.modules})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert done.stdout.strip() == "set()"


def test_the_probe_sees_what_is_loaded(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("a,y\n" + "".join(f"{k},{k * k % 7}\n" for k in range(9)))
    assert "scipy.stats" in heavy_after(["analyse", str(tmp_path / "t.csv"), "--inputs", "a", "--outputs", "y"])


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


def test_heavy_packages_are_imported_in_functions() -> None:
    found = {path: imports_at_top(ast.parse(path.read_text(encoding="utf-8"))) for path in ROOT.rglob("*.py")}
    assert [(path, name) for path, names in found.items() for name in names if is_heavy(name)] == []


def _running(tree: ast.AST) -> Iterator[ast.AST]:
    """Every node but those below TYPE_CHECKING."""
    for node in ast.iter_child_nodes(tree):
        if not (isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)):
            yield node
            yield from _running(node)


@pytest.mark.parametrize("package", HOMES)
def test_a_heavy_package_has_one_home(package: str) -> None:
    users = set()
    for path, text in ((path, path.read_text(encoding="utf-8")) for path in ROOT.rglob("*.py")):
        for node in _running(ast.parse(text)) if package in text else ():
            names = [n.name for n in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            if any(name.split(".")[0] == package for name in names):
                users.add(str(path.relative_to(ROOT)))
    assert users <= HOMES[package], f"{package} is imported in {sorted(users)}"


def test_runs_need_no_chaospy(tmp_path: Path) -> None:
    """Its dependency numpoly comes as source: without a compiler it is not there."""
    code = f"""
import sys
from collections.abc import Iterator
sys.modules["chaospy"] = sys.modules["numpoly"] = None
import numpy as np, uqsphere
from uqsphere.errors import UsageError
study = uqsphere.load_study({str(STUDIES / "ishigami.toml")!r}, ("analysis.budget.evaluations=9000",))
box = lambda rows: {{"y": np.sin(rows["x1"]) + rows["x2"] * rows["x3"]}}
assert uqsphere.run(study, out={str(tmp_path / "r")!r}, model=box).results.sensitivity
from uqsphere.uq.interop import load_chaospy
try:
    load_chaospy()
except UsageError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True)
    assert "needs chaospy" in done.stdout


def test_doctor_says_what_a_system_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    from uqsphere.cli.data import examine

    monkeypatch.setattr("uqsphere.runner.results.versions", lambda: {"numpy": "2.0", "chaospy": "missing"})
    for name, said in (("linux", "apt install gcc"), ("darwin", "xcode-select"), ("win32", "winget"), ("aix", "one")):
        monkeypatch.setattr(sys, "platform", name)
        (entry,) = [entry for entry in examine()["checks"] if entry["check"] == "packages"]
        assert not entry["ok"]
        assert said in entry["text"]


# --- the floors of the house: a module imports from floors below its own, and from its own floor, never from above


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
    "uqsphere.feed": 3,
    "uqsphere.study": 4,
    "uqsphere.external": 5,
    "uqsphere.black_box": 6,
    "uqsphere.model": 7,
    "uqsphere.store": 7,
    "uqsphere.console": 7,
    "uqsphere.results": 8,
    "uqsphere.runner": 9,
    "uqsphere.report": 10,
    "uqsphere.given": 11,
    "uqsphere.analysis": 12,
    "uqsphere.bench": 11,
    "uqsphere.planning": 11,
    "uqsphere.cli": 12,
    "uqsphere.__main__": 13,
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


def test_imports_point_down() -> None:
    texts = {name: path.read_text(encoding="utf-8") for name, path in MODULES.items() if name != PUBLIC}
    assert [fault for name, text in texts.items() for fault in faults_of(name, imported(text, name))] == []
    assert {room_of(name) for name in texts} == set(FLOORS)


def test_the_root_imports_nothing_when_it_is_imported() -> None:
    tree = ast.parse(MODULES[PUBLIC].read_text(encoding="utf-8"))
    eager = [node for node in tree.body if isinstance(node, (ast.Import, ast.ImportFrom))]
    names = {node.module if isinstance(node, ast.ImportFrom) else node.names[0].name for node in eager}
    assert names == {"__future__", "typing"}


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
        "CITATION.cff",
        "LICENSE",
    }
    assert {name for name in names if not name.startswith(".")} == agreed | {"constraints.txt"}

"""The layers of the house: a room imports only what stands before it; labs stand beside, and
nothing needs them.
"""

import ast
from pathlib import Path

import uqsphere

LAYERS = (
    "arrays errors",
    "units files documents tables materials",
    "mechanics uq",
    "quantities",
    "study",
    "models",
    "results",
    "propagation",
    "report exchange",
    "bench analysis labs",
    "cli",
    "__init__ __main__",
)
#: a run draws its own page, and studies and opened runs show themselves in a notebook
LATE = {("results", "report"), ("propagation", "report"), ("study", "report")}


def module_of(path: Path, node: ast.ImportFrom) -> str:
    """The module that names are imported from, in full."""
    if not node.level:
        return node.module or ""
    package = path.relative_to(Path(uqsphere.__file__).parents[1]).parts[: -node.level]
    return ".".join([*package, *filter(None, [node.module])])


def test_rooms_import_only_what_stands_before_them() -> None:
    rank = {room: level for level, rooms in enumerate(LAYERS) for room in rooms.split()}
    root = Path(uqsphere.__file__).parent
    for path in root.rglob("*.py"):
        room = path.relative_to(root).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom):
                continue
            module = module_of(path, node).split(".")
            if module[0] != "uqsphere":
                continue
            names = [alias.name for alias in node.names]
            for other in module[1:2] or names:
                known = other == room or other not in rank or (room, other) in LATE
                before = known or rank[other] < rank[room] or rank[other] == rank[room] <= 1
                assert before, f"{path}:{node.lineno}: {room} imports {other}"


def test_modules_of_a_run_import_each_other_in_one_direction() -> None:
    # imports inside functions, and of types alone, count
    folder = Path(uqsphere.__file__).parent / "propagation"
    modules = {path.stem for path in folder.glob("*.py")}
    imports: dict[str, set[str]] = {name: set() for name in modules}
    for name in modules:
        for node in ast.walk(ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))):
            if not isinstance(node, ast.ImportFrom):
                continue
            module = module_of(folder / f"{name}.py", node)
            if not module.startswith("uqsphere.propagation"):
                continue
            parts = module.split(".")[2:]
            names = parts[:1] or [alias.name for alias in node.names]
            imports[name] |= modules.intersection(names)
    waiting = set(modules)
    while free := {name for name in waiting if not imports[name] & waiting}:
        waiting -= free
    assert not waiting, f"these import each other in a circle: {sorted(waiting)}"

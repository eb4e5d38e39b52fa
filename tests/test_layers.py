"""The layers of the house: a room imports only what stands before it; labs stand beside, and nothing needs them."""

import ast
from pathlib import Path

import uqsphere

LAYERS = (
    "arrays errors", "units files tables materials", "mechanics uq", "quantities", "study", "models", "results", "run",
    "report", "bench analysis labs", "__init__ __main__ cli",
)  # fmt: skip
#: a run draws its own page, and an opened run its plots
LATE = {("results", "report"), ("run", "report")}


def test_rooms_import_only_what_stands_before_them() -> None:
    rank = {room: level for level, rooms in enumerate(LAYERS) for room in rooms.split()}
    root = Path(uqsphere.__file__).parent
    for path in root.rglob("*.py"):
        room = path.relative_to(root).parts[0].removesuffix(".py")
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if not (isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] == "uqsphere"):
                continue
            names = [alias.name for alias in node.names]
            for other in [node.module.split(".")[1]] if "." in (node.module or "") else names:
                own = (
                    other == room or other not in rank or (room, other) in LATE or (room, other) == ("__main__", "cli")
                )
                lower = rank.get(other, -1) < rank[room] or (rank[other] == rank[room] and rank[room] in (0, 1))
                assert own or lower, f"{path}:{node.lineno}: {room} imports {other}"
                assert room != "labs" or not any(name.startswith("_") for name in names), (
                    f"{path}:{node.lineno}: {names}"
                )

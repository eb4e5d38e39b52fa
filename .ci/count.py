"""What the code amounts to: lines, files, and how far it keeps to the bounds of its own style.

    python .ci/count.py [--list] [ROOT]

`--list` names what is beyond each bound.  Counted are all lines of a file, comments and blank ones too.  Imports are
all that run, at the head of a file or inside a function; those under TYPE_CHECKING count for a reader (files that
import more than 15 modules) but make no cycle.  Complexity is McCabe's number with everything counted that divides the
way: each branch, loop, handler, case, assertion, comprehension and its conditions, further operand of `and` and `or`,
and nested function.  A numeric constant is a name in capitals at the head of a module, bound to numbers alone; a
dictionary or tuple of numbers is one.
"""

from __future__ import annotations

import argparse
import ast
import io
import sys
import tokenize
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

PACKAGE = "uqsphere"
#: bounds of docs/architecture.md
LINES_OF_FILE, IMPORTS, LINES_OF_FUNCTION, COMPLEXITY, PARAMETERS = 800, 15, 60, 15, 8
#: the compiled loop: numbers of a scene pass through it by position
KERNEL = f"{PACKAGE}.mechanics."
PAGES = (".html", ".js", ".css", ".j2", ".jinja", ".svg")
EVIDENCE = ("campaigns", "independent")


@dataclass(kw_only=True)
class Module:
    """One file of the package and what is counted in it."""

    name: str
    path: Path
    lines: int
    tree: ast.Module
    runs: set[str] = field(default_factory=set)
    reads: set[str] = field(default_factory=set)


def read_modules(root: Path) -> dict[str, Module]:
    """Every module of the package, with the project's modules that it imports."""
    found = {}
    for path in sorted((root / PACKAGE).rglob("*.py")):
        parts = path.relative_to(root).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        text = path.read_text(encoding="utf-8")
        found[name] = Module(name=name, path=path, lines=text.count("\n"), tree=ast.parse(text))
    for module in found.values():
        for node, typing_only in _imports(module.tree):
            for target in _targets(node, module, found):
                module.reads.add(target)
                if not typing_only:
                    module.runs.add(target)
    return found


def _imports(tree: ast.AST, typing_only: bool = False) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            yield node, typing_only
        elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            for inner in node.body:
                yield from _imports(ast.Module(body=[inner], type_ignores=[]), True)
        else:
            yield from _imports(node, typing_only)


def _targets(node: ast.Import | ast.ImportFrom, module: Module, found: dict[str, Module]) -> set[str]:
    if isinstance(node, ast.Import):
        names = {alias.name for alias in node.names}
    else:
        base = node.module or ""
        if node.level:
            is_package = module.path.name == "__init__.py"
            parts = module.name.split(".")
            parts = parts[: len(parts) - node.level + is_package]
            base = ".".join([*parts, base] if base else parts)
        # `from package import module` names the module, `from module import name` the module it is from
        names = {inner if (inner := f"{base}.{alias.name}") in found else base for alias in node.names}
    return {name for name in names if name in found and name != module.name}


def cycles(modules: dict[str, Module]) -> list[list[str]]:
    """Groups of modules that import each other, at whatever depth (Tarjan)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    groups = []

    def visit(name: str) -> None:
        order[name] = low[name] = len(order)
        stack.append(name)
        for target in sorted(modules[name].runs):
            if target not in order:
                visit(target)
                low[name] = min(low[name], low[target])
            elif target in stack:
                low[name] = min(low[name], order[target])
        if low[name] == order[name]:
            group = stack[stack.index(name) :]
            del stack[stack.index(name) :]
            if len(group) > 1:
                groups.append(sorted(group))

    sys.setrecursionlimit(10_000)
    for name in modules:
        if name not in order:
            visit(name)
    return groups


def functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    """Every function and method."""
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            yield node


def complexity(function: ast.AST) -> int:
    """One, and one for every place where the way through a function divides."""
    divides = (ast.If, ast.IfExp, ast.For, ast.While, ast.ExceptHandler, ast.match_case, ast.Assert)
    count = 1
    for node in ast.walk(function):
        if node is function:
            continue
        count += isinstance(node, (*divides, ast.FunctionDef, ast.Lambda))
        if isinstance(node, ast.BoolOp):
            count += len(node.values) - 1
        elif isinstance(node, ast.comprehension):
            count += 1 + len(node.ifs)
    return count


def parameters(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    """Parameters of a function, `self` and `cls` aside."""
    given = function.args
    names = [argument.arg for argument in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    return len(names) - (names[:1] in (["self"], ["cls"])) + bool(given.vararg) + bool(given.kwarg)


def uses_of_any(path: Path) -> int:
    """Uses of `Any`, imports aside."""
    text = path.read_text(encoding="utf-8")
    tokens = tokenize.generate_tokens(io.StringIO(text).readline)
    return sum(
        token.type == tokenize.NAME and token.string == "Any" and "import" not in token.line for token in tokens
    ) + sum("Any" in annotation for annotation in _quoted(ast.parse(text)))


def _quoted(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        annotation = getattr(node, "annotation", None) or getattr(node, "returns", None)
        if isinstance(annotation, ast.Constant) and isinstance(annotation.value, str):
            yield annotation.value


def constants(tree: ast.Module) -> list[str]:
    """Names in capitals that a module binds to numbers alone."""
    names = []
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets, value = node.targets, node.value
        elif isinstance(node, ast.AnnAssign) and node.value is not None:
            targets, value = [node.target], node.value
        else:
            continue
        bound = [inner for target in targets for inner in ast.walk(target) if isinstance(inner, ast.Name)]
        if _numeric(value):
            names += [inner.id for inner in bound if inner.id.strip("_").isupper()]
    return names


def _numeric(value: ast.expr) -> bool:
    """Whether an expression holds numbers and names of other constants alone, at least one number."""
    keys = {id(inner) for node in ast.walk(value) if isinstance(node, ast.Dict) for inner in node.keys}
    literals = [node for node in ast.walk(value) if isinstance(node, ast.Constant) and id(node) not in keys]
    numbers = [node for node in literals if type(node.value) in (int, float)]
    return bool(numbers) and len(numbers) == len(literals) and not _builds(value)


def _builds(value: ast.expr) -> bool:
    """Whether something other than a number is made: a call that is not mathematics, a comprehension, a lambda."""
    for node in ast.walk(value):
        if isinstance(node, (ast.Lambda, ast.ListComp, ast.DictComp, ast.SetComp, ast.GeneratorExp, ast.JoinedStr)):
            return True
        if isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[0] not in ("math", "np", "float", "int"):
            return True
    return False


def single_importers(modules: dict[str, Module]) -> list[str]:
    """Modules that one other module alone imports."""
    importers: dict[str, set[str]] = {name: set() for name in modules}
    for module in modules.values():
        for target in module.reads:
            importers[target].add(module.name)
    return [name for name, who in importers.items() if len(who) == 1 and not name.endswith("__main__")]


def size(paths: list[Path]) -> tuple[int, int]:
    """Lines and files."""
    return sum(path.read_text(encoding="utf-8", errors="replace").count("\n") for path in paths), len(paths)


def count(root: Path) -> list[tuple[str, str, list[str]]]:
    """Rows of what is counted, the number, and what is beyond the bound."""
    modules = read_modules(root)
    tests = sorted((root / "tests").rglob("*.py"))
    evidence = [path for path in tests if path.relative_to(root / "tests").parts[0] in EVIDENCE]
    pages = [path for path in (root / PACKAGE).rglob("*") if path.suffix in PAGES]
    rows: list[tuple[str, str, list[str]]] = []

    def row(what: str, listed: list[str], number: str = "") -> None:
        rows.append((what, number or str(len(listed)), listed))

    for what, paths in (
        ("product", [module.path for module in modules.values()]),
        ("tests", [path for path in tests if path not in evidence]),
        ("evidence (tests/campaigns, tests/independent)", evidence),
        ("templates and page scripts", pages),
    ):
        row(f"{what}: lines in files", [], "{:,} in {}".format(*size(paths)))
    folders = Counter[str]()
    for module in modules.values():
        folders[module.path.relative_to(root / PACKAGE).parts[0]] += module.lines
    row("product by folder", [f"{lines:6,}  {name}" for name, lines in folders.most_common()])
    found = cycles(modules)
    groups = [" ".join(group) for group in found]
    row("import cycles (modules in them)", groups, f"{len(found)} ({sum(map(len, found))})")
    files = {name: module.lines for name, module in modules.items()}
    row(f"files above {LINES_OF_FILE} lines", _above(files, LINES_OF_FILE))
    imports = {name: len(module.reads) for name, module in modules.items()}
    row(f"files that import more than {IMPORTS} of the project's modules", _above(imports, IMPORTS))
    row("modules with a single importer", single_importers(modules))
    every = {f"{m.name}:{f.lineno} {f.name}": f for m in modules.values() for f in functions(m.tree)}
    lines_of = {name: (f.end_lineno or f.lineno) - f.lineno + 1 for name, f in every.items()}
    row(f"functions above {LINES_OF_FUNCTION} lines", _above(lines_of, LINES_OF_FUNCTION))
    row(f"functions above complexity {COMPLEXITY}", _above({n: complexity(f) for n, f in every.items()}, COMPLEXITY))
    open_to = {name: parameters(f) for name, f in every.items() if not name.startswith(KERNEL)}
    row(f"functions with more than {PARAMETERS} parameters, mechanics aside", _above(open_to, PARAMETERS))
    uses = {name: uses_of_any(module.path) for name, module in modules.items()}
    row("uses of Any", _above(uses, 0), f"{sum(uses.values()):,}")
    tuned = {name: constants(module.tree) for name, module in modules.items()}
    told = [f"{name}: {', '.join(names)}" for name, names in tuned.items() if names]
    row("numeric constants of modules", told, str(sum(map(len, tuned.values()))))
    return rows


def _above(found: dict[str, int], bound: int) -> list[str]:
    """What is above a bound, the most first."""
    return [f"{name} {n}" for name, n in sorted(found.items(), key=lambda item: -item[1]) if n > bound]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description="What the code amounts to.")
    parser.add_argument("root", nargs="?", type=Path, default=Path(__file__).resolve().parent.parent)
    parser.add_argument("--list", action="store_true", help="name what is beyond each bound")
    chosen = parser.parse_args(arguments)
    for what, number, listed in count(chosen.root):
        print(f"{number:>16}  {what}")
        if chosen.list:
            for line in listed:
                print(f"{'':18}  {line}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

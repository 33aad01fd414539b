"""What the sources of the package say of themselves, read by ast without importing them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = "surrofe2"
Function = ast.FunctionDef | ast.AsyncFunctionDef


def sources() -> dict[str, ast.Module]:
    """Tree of each file by its path below the package, as in "rve/rve_law.py"."""
    folder = ROOT / PACKAGE
    return {
        path.relative_to(folder).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("*.py"))
    }


def line_counts() -> dict[str, int]:
    """Lines of each file."""
    folder = ROOT / PACKAGE
    return {
        name: len((folder / name).read_text(encoding="utf-8").splitlines()) for name in sources()
    }


def module_of(name: str) -> str:
    """ "rve/__init__.py" → "surrofe2.rve"."""
    parts = [PACKAGE, *Path(name).with_suffix("").parts]
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def import_graph(trees: dict[str, ast.Module]) -> dict[str, set[str]]:
    """Modules of the package that each imports anywhere, under TYPE_CHECKING and in functions too.

    `from package import name` is an import of package.name where that is a module, else of the
    package. That an import runs the __init__ of the packages above is not counted.
    """
    modules = {module_of(name) for name in trees}
    graph: dict[str, set[str]] = {}
    for name, tree in trees.items():
        found = graph.setdefault(module_of(name), set())
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                found.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                assert not node.level, f"{name}: relative import"
                for alias in node.names:
                    inner = f"{node.module}.{alias.name}"
                    found.add(inner if inner in modules else str(node.module))
        found &= modules
        found.discard(module_of(name))
    return graph


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Strongly connected components of more than one module, each sorted (Tarjan)."""
    order: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found = []

    def visit(module: str) -> None:
        order[module] = low[module] = len(order)
        stack.append(module)
        for other in graph[module]:
            if other not in order:
                visit(other)
                low[module] = min(low[module], low[other])
            elif other in stack:
                low[module] = min(low[module], order[other])
        if low[module] == order[module]:
            k = stack.index(module)
            component = sorted(stack[k:])
            del stack[k:]
            if len(component) > 1:
                found.append(component)

    for module in graph:
        if module not in order:
            visit(module)
    return sorted(found)


def is_kernel(function: Function) -> bool:
    """Whether numba compiles it."""
    decorators = [ast.unparse(each).split("(")[0] for each in function.decorator_list]
    return any(name in ("kernel", "parallel_kernel", "intrinsic") for name in decorators)


def functions(tree: ast.Module) -> Iterator[Function]:
    """All functions and methods."""
    return (node for node in ast.walk(tree) if isinstance(node, Function))


def count_arguments(function: Function) -> int:
    """Without self and cls."""
    given = function.args
    names = [each.arg for each in (*given.posonlyargs, *given.args)]
    own = bool(names) and names[0] in ("self", "cls")
    return len(names) - own + len(given.kwonlyargs)


def local_imports(tree: ast.Module) -> Iterator[str]:
    """Top packages that functions import, the package's own by the whole name."""
    for function in functions(tree):
        for node in ast.walk(function):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [str(node.module)]
            for name in names:
                yield name if name.startswith(PACKAGE) else name.split(".")[0]


def introspections(tree: ast.Module) -> Iterator[str]:
    """Calls of getattr and hasattr, and of inspect.signature."""
    for node in ast.walk(tree):
        called = ast.unparse(node.func) if isinstance(node, ast.Call) else ""
        if called in ("getattr", "hasattr", "inspect.signature"):
            yield called
        elif isinstance(node, ast.ImportFrom) and node.module == "inspect":
            yield "inspect"

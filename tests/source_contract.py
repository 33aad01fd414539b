"""What the sources of the package say of themselves, read by ast without importing them."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[1]
PACKAGE = "surrofe2"


def sources() -> dict[str, ast.Module]:
    """Tree of each file by its path below the package, as in "rve/rve_law.py"."""
    folder = ROOT / PACKAGE
    return {
        path.relative_to(folder).as_posix(): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(folder.rglob("*.py"))
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
    """Strongly connected components of more than one module, each sorted."""
    names = sorted(graph)
    links = np.array([[other in graph[name] for other in names] for name in names])
    count, labels = connected_components(csr_array(links), connection="strong")
    groups = [
        [n for n, label in zip(names, labels, strict=True) if label == k] for k in range(count)
    ]
    return sorted(group for group in groups if len(group) > 1)


def local_imports(tree: ast.Module) -> Iterator[str]:
    """Top packages that functions import, the package's own by the whole name."""
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        for node in ast.walk(function):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [str(node.module)]
            for name in names:
                yield name if name.startswith(PACKAGE) else name.split(".")[0]

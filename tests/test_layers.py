"""The contract of the sources: layers, no circles, and every file described where its room is.

The import contract of the layers stands in pyproject.toml.
"""

import ast
import re
import sys
from pathlib import Path

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from tests.conftest import ROOT
from tests.processes import python

PACKAGE = ROOT / "surrofe2"


def test_layers_point_one_way():
    python(Path(sys.executable).with_name("lint-imports"), "--no-cache", cwd=ROOT)


def test_every_file_is_named_where_its_room_is_described():
    """In docs/architecture.md and in the first words of the room; none is named that is gone."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    described = {
        room: set(re.findall(r"`([a-z_0-9]+)`", line))
        for line in page.splitlines()
        for room in re.findall(r"^\| `((?:surrofe2|[a-z_]+|[a-z_]+/[a-z]+)/)` \|", line)
    }
    files = {}
    for path in PACKAGE.rglob("*.py"):
        if not path.stem.startswith("__"):
            folder = path.parent.relative_to(PACKAGE).as_posix()
            room = "surrofe2/" if folder == "." else f"{folder}/"
            files.setdefault(room, set()).add(path.stem)
    assert described == files
    for room, names in files.items():
        if room != "surrofe2/":
            source = (PACKAGE / room / "__init__.py").read_text(encoding="utf-8")
            words = set(re.findall(r"\w+", ast.get_docstring(ast.parse(source)) or ""))
            assert not names - words, room


def test_no_files_import_each_other_in_a_circle():
    """Nor under TYPE_CHECKING or in functions. An import counts as one of the module named, not of
    the packages above it.
    """
    trees = {
        ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): ast.parse(
            path.read_text(encoding="utf-8")
        )
        for path in PACKAGE.rglob("*.py")
    }
    graph = {name: imports(tree, trees) - {name} for name, tree in sorted(trees.items())}
    links = np.array([[other in found for other in graph] for found in graph.values()])
    _, labels = connected_components(csr_array(links), connection="strong")
    sizes = np.bincount(labels)
    assert not [name for name, label in zip(graph, labels, strict=True) if sizes[label] > 1]


def imports(tree, modules):
    """The modules of the package that a file imports."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                found.add(inner if inner in modules else str(node.module))
    return found & set(modules)

"""The contract of the sources: layers, no circles, no import inside a function but what is heavy.

The import contract of the layers stands in pyproject.toml.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.source_contract import ROOT, circles, import_graph, local_imports, sources

HEAVY = {
    *("torch", "matplotlib", "meshio", "scipy", "skfem", "distributed", "mpi4py", "numba"),
    # of the package what brings torch, numba or scikit-fem, where most commands only read files
    *("surrofe2.problem.bar", "surrofe2.workflow.cell_fields", "surrofe2.workflow.laws"),
    "surrofe2.surrogate.training",
    *("surrofe2.workflow.report", "surrofe2.workflow.surfaces"),
}
"""What a function may import."""


@pytest.fixture(scope="module")
def trees():
    return sources()


def test_layers_point_one_way():
    lint = Path(sys.executable)
    done = subprocess.run(
        [lint.with_name("lint-imports"), "--no-cache"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_every_file_is_named_where_its_room_is_described():
    """In docs/architecture.md and in the first words of the room; none is named that is gone."""
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    described = {
        room: set(re.findall(r"`([a-z_0-9]+)`", line))
        for line in page.splitlines()
        for room in re.findall(r"^\| `((?:surrofe2|[a-z_]+|[a-z_]+/[a-z]+)/)` \|", line)
    }
    package, files = ROOT / "surrofe2", {}
    for path in package.rglob("*.py"):
        if not path.stem.startswith("__"):
            folder = path.parent.relative_to(package).as_posix()
            room = "surrofe2/" if folder == "." else f"{folder}/"
            files.setdefault(room, set()).add(path.stem)
    assert described == files
    for room, names in files.items():
        if room != "surrofe2/":
            source = (package / room / "__init__.py").read_text(encoding="utf-8")
            words = set(re.findall(r"\w+", ast.get_docstring(ast.parse(source)) or ""))
            assert not names - words, room


def test_no_files_import_each_other_in_a_circle(trees):
    found = circles(import_graph(trees))
    assert not found, "modules that import each other, under TYPE_CHECKING or in functions too"


def test_functions_import_nothing_but_what_is_heavy(trees):
    found = {name: set(local_imports(tree)) - HEAVY for name, tree in trees.items()}
    wrong = {name: imports for name, imports in found.items() if imports}
    assert not wrong

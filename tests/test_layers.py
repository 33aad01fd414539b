"""The contract of the sources: layers, no circles, whole files, short argument lists, plain calls.

The import contract stands in pyproject.toml; the other rules stand here. A list of exceptions names
what does not keep a rule today. The lists may only become shorter, and an exception that is no
longer needed must go. Those that stay carry their reason.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.source_contract import (
    ROOT,
    circles,
    count_arguments,
    functions,
    import_graph,
    introspections,
    is_kernel,
    line_counts,
    local_imports,
    sources,
)

MOST_LINES, MOST_ARGUMENTS = 350, 8
HEAVY = ("torch", "matplotlib", "meshio", "distributed", "mpi4py")
"""What a function may import."""

CIRCLES: tuple[set[str], ...] = ()
"""Modules that import each other today."""

LONG_KERNELS = 12
"""Kernels with more than eight arguments, at most: the innermost level of each."""
LONG_FUNCTIONS = {"run"}
"""Functions with more than eight arguments. run: the options of a command."""

INTROSPECTION = {
    "public_names.py": "public names are imported when they are asked for",
    "simd.py": "instructions of llvmlite by name",
    "cli/__init__.py": "commands are imported when they are called; streams of other programs",
}
"""Files that call getattr or hasattr, and why they may."""


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


def test_no_files_import_each_other_in_a_circle(trees):
    found = circles(import_graph(trees))
    new = [circle for circle in found if not any(known.issuperset(circle) for known in CIRCLES)]
    assert not new, "modules that import each other, under TYPE_CHECKING or in functions too"


def test_circles_are_found():
    graph = {"a": {"b"}, "b": {"c", "d"}, "c": {"a"}, "d": {"e"}, "e": set(), "f": {"a"}}
    assert circles(graph) == [["a", "b", "c"]]


def test_no_file_is_longer_than_it_may_be():
    long = {name: count for name, count in line_counts().items() if count > MOST_LINES}
    assert not long


def test_no_function_takes_more_than_eight_arguments(trees):
    long = [
        (name, each.name, is_kernel(each))
        for name, tree in trees.items()
        for each in functions(tree)
        if count_arguments(each) > MOST_ARGUMENTS
    ]
    others = [(name, each) for name, each, kernel in long if not kernel]
    assert [both for both in others if both[1] not in LONG_FUNCTIONS] == []
    assert sum(kernel for _, _, kernel in long) <= LONG_KERNELS


def test_functions_import_nothing_but_what_is_heavy(trees):
    found = {name: set(local_imports(tree)) - set(HEAVY) for name, tree in trees.items()}
    wrong = {name: imports for name, imports in found.items() if imports}
    assert not wrong


def test_types_of_our_own_are_not_asked_what_they_have(trees):
    found = {name: set(introspections(tree)) for name, tree in trees.items()}
    wrong = {name: calls for name, calls in found.items() if calls and name not in INTROSPECTION}
    assert not wrong

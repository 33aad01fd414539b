"""Heavy libraries are imported by what needs them: those of training, and scikit-fem by meshes."""

from __future__ import annotations

import subprocess
import sys

import pytest

HELP = """
import sys
sys.argv = ["surrofe2", "--help"]
from surrofe2.cli import main
try:
    main()
except SystemExit:
    pass
"""
READING = ("surrofe2.cli.run", "surrofe2.cli.compare", "surrofe2.cache.cached_law",
           "surrofe2.store.surrogates")  # fmt: skip


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (HELP, "torch numba skfem numpy scipy h5py matplotlib pydantic"),
        ("import surrofe2", "torch sklearn skfem scipy.sparse meshio"),
        (f"import {', '.join(READING)}", "torch sklearn scipy.stats scipy.spatial"),
        ("import surrofe2.cli.compare", "torch numba skfem"),
        ("import surrofe2.problem.mesh", "meshio"),
    ],
    ids=["help", "the package", "runs, tables and comparisons", "comparisons", "meshes"],
)
def test_a_fresh_process_imports_nothing_heavy(code, heavy):
    code += (
        f"\nimport sys; print('heavy:', *[name for name in {heavy.split()} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "heavy:"

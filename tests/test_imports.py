"""Heavy libraries are imported by what needs them: those of training, and scikit-fem by meshes."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("torch", "sklearn", "scipy.stats")


def heavy_imports(code, *arguments, heavy=HEAVY):
    """Which of the heavy libraries a fresh process has imported after running code."""
    code += f"\nimport sys; print(*[name for name in {heavy} if name in sys.modules], sep=',')"
    done = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=True,
    )
    return done.stdout.splitlines()[-1]


def test_training_imports_them():
    assert heavy_imports("import surrofe2.surrogate.training") == "torch,sklearn,scipy.stats"


@pytest.mark.parametrize(
    "module",
    ["cli", "cli.run", "cli.compare", "cli.generate", "store.surrogates"],
)
def test_what_help_runs_tables_and_comparisons_need_does_not(module):
    assert heavy_imports(f"import surrofe2.{module}") == ""


def test_only_what_has_a_mesh_imports_scikit_fem():
    for code in ("import surrofe2", "from surrofe2.cli import main"):
        assert heavy_imports(code, heavy=("skfem", "scipy.sparse", "meshio")) == ""
    assert heavy_imports("import surrofe2.problem.mesh", heavy=("skfem", "meshio")) == "skfem"


def test_help_imports_nothing_heavy():
    code = "import sys; sys.argv = ['surrofe2', '--help']\nfrom surrofe2.cli import main\n"
    code += "try:\n    main()\nexcept SystemExit:\n    pass"
    heavy = ("torch", "numba", "skfem", "numpy", "scipy", "h5py", "matplotlib", "pydantic")
    assert heavy_imports(code, heavy=heavy) == ""

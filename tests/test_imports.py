"""What trains surrogates is imported by training alone: torch, scikit-learn and scipy.stats."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("torch", "sklearn", "scipy.stats")


def heavy_imports(code, *arguments):
    """Which of the heavy libraries a fresh process has imported after running code."""
    code += f"\nimport sys; print(*[name for name in {HEAVY} if name in sys.modules], sep=',')"
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
    ["cli", "cli.run", "cli.compare", "cli.generate", "io.surrogates"],
)
def test_what_help_runs_tables_and_comparisons_need_does_not(module):
    assert heavy_imports(f"import surrofe2.{module}") == ""

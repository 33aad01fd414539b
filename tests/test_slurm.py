"""The scripts for SLURM are whole, and on the page about them."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDER = ROOT / "examples" / "slurm"
SCRIPTS = sorted(FOLDER.glob("*.sh"))


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.stem)
def test_a_script_is_whole_and_on_the_page(script):
    subprocess.run(["bash", "-n", script], check=True)
    page = (ROOT / "docs" / "scaling.md").read_text(encoding="utf-8")
    assert f"{{literalinclude}} ../examples/slurm/{script.name}\n" in page

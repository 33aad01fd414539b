"""Runs against each other; it only reads files, and needs no numerics."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.report.comparison import Comparison, compare, write_comparison_plot
from surrofe2.store.run_folder import read_run
from surrofe2.store.store import digest, keep

_THIN = 20
"""Plant cells across, beyond which free sides matter less than 2.5 %."""
COMPARISON_FILES = ("comparison.json", "comparison.png")


def compare_runs(
    folders: Sequence[str | Path], out: str | Path, *, fresh: bool = False
) -> Comparison:
    """Compare the runs in these folders; comparison.json and comparison.png go into `out`."""
    out = Path(out)
    runs = [read_run(folder) for folder in folders]
    result = compare(runs)
    of = {run.name: digest(run.folder / "run.json")[:16] for run in runs}

    def make() -> dict[str, Any]:
        write_comparison_plot(out / COMPARISON_FILES[1], runs)
        return result.to_dict()

    keep(out / COMPARISON_FILES[0], {"of": of}, make, folder=out, fresh=fresh)
    return result


def missing_notes(folders: Sequence[str | Path]) -> list[str]:
    """What FE² without a surface law misses beside a full tissue, by docs/explanation/trusted.md.

    Said of one square plant cell, the law of whose sides is known, and of thin tissue alone.
    """
    records = {run.name: run.record for run in map(read_run, folders)}
    if all(record.law != "tissue" for record in records.values()):
        return []
    notes = []
    for name, record in records.items():
        cell, problem = record.recipe.get("cell", {}), record.problem
        is_square = (cell.get("arrangement"), cell.get("cells")) == ("square", 1)
        if record.law == "tissue" or problem.get("surface") or not is_square:
            continue
        low, high = np.array(problem["extent"])
        across = (high - low).min() / cell["cell_side"]
        if across <= _THIN:
            notes.append(
                f"{name}: surface: none; a strip of {across:.3g} plant cells is "
                f"{20.0 / across:.2g} to {50.0 / across:.2g} % too stiff; section [surface] with "
                'on = "free" gives its sides a law'
            )
    return notes

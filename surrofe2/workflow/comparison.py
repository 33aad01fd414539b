"""Runs against each other, two or more folders."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from surrofe2.base.errors import InputError
from surrofe2.report.comparison import Comparison, write_comparison_plot
from surrofe2.report.comparison import compare as compare_stored
from surrofe2.store.run_folder import read_run
from surrofe2.store.store import digest, keep

COMPARISON_FILES = ("comparison.json", "comparison.png")


def compare_runs(
    folders: Sequence[str | Path], out: str | Path, *, fresh: bool = False
) -> Comparison:
    """Compare the runs in these folders; comparison.json and comparison.png go into `out`."""
    out = Path(out)
    runs = [read_run(folder) for folder in folders]
    result = compare_stored(runs)
    of = {run.folder.name: digest(run.folder / "run.json")[:16] for run in runs}

    def make() -> dict[str, Any]:
        write_comparison_plot(out / COMPARISON_FILES[1], runs)
        return result.to_dict()

    keep(out / COMPARISON_FILES[0], {"of": of}, make, folder=out, fresh=fresh)
    return result


def missing_notes(folders: Sequence[str | Path]) -> list[str]:
    """What FE² without a surface law is expected to miss, beside a full tissue."""
    records = [read_run(folder).record for folder in folders]
    if all(record.law != "tissue" for record in records):
        return []
    # what solves RVEs: reading files needs none of it
    from surrofe2.workflow.cell_fields import recipes_of
    from surrofe2.workflow.laws import kept_reference
    from surrofe2.workflow.surfaces import missing_sentence

    found = []
    for folder, record in zip(folders, records, strict=True):
        with suppress(InputError):  # a law without plant cells
            for recipe in recipes_of(record).values():
                sentence = missing_sentence(record, recipe, kept_reference)
                found += [] if sentence is None else [f"{Path(folder).name}: {sentence}"]
    return found

"""Runs against each other, two or more folders."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from surrofe2.errors import InputError
from surrofe2.io.files import is_there, write_json
from surrofe2.io.lock import folder_lock, locked_folder
from surrofe2.io.run_folder import file_fingerprint, read_run
from surrofe2.report.comparison import Comparison
from surrofe2.report.comparison import compare as compare_stored
from surrofe2.report.comparison_plot import write_comparison_plot
from surrofe2.workflow.cell_fields import recipes_of
from surrofe2.workflow.laws import kept_reference
from surrofe2.workflow.surfaces import missing_sentence

COMPARISON_FILES = ("comparison.json", "comparison.png")


def compare_runs(
    folders: Sequence[str | Path], out: str | Path, *, fresh: bool = False
) -> Comparison:
    """Compare the runs in these folders; comparison.json and comparison.png go into `out`."""
    out = Path(out)
    runs = [read_run(folder) for folder in folders]
    result = compare_stored(runs)
    of = {run.folder.name: file_fingerprint(run.folder / "run.json") for run in runs}
    path = out / COMPARISON_FILES[0]
    if fresh or folder_lock(out).exists() or not is_there(path, {"of": of}):
        with locked_folder(out):
            if fresh or not is_there(path, {"of": of}):
                write_comparison_plot(out / COMPARISON_FILES[1], result, runs)
                write_json(path, {**result.to_dict(), "of": of})
    return result


def missing_notes(folders: Sequence[str | Path]) -> list[str]:
    """What FE² without a surface law is expected to miss, beside a full tissue."""
    records = [read_run(folder).record for folder in folders]
    if all(record.law != "tissue" for record in records):
        return []
    found = []
    for folder, record in zip(folders, records, strict=True):
        with suppress(InputError):  # a law without plant cells
            for recipe in recipes_of(record).values():
                sentence = missing_sentence(record, recipe, kept_reference)
                found += [] if sentence is None else [f"{Path(folder).name}: {sentence}"]
    return found

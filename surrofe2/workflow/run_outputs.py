"""What a cached run leaves for the next one: its table and its true answers (the harvest)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from surrofe2.cache import StressTable
from surrofe2.cache.protocols import OnTrueAnswer
from surrofe2.cache.table.ellipsoids import merged
from surrofe2.io.files import check_same
from surrofe2.io.harvest import HarvestHeader, HarvestWriter
from surrofe2.io.run_folder import file_fingerprint
from surrofe2.io.tables import check_table, read_table, stored, write_table
from surrofe2.recipe import Recipe

TABLE, HARVEST = "table.h5", "harvest.h5"


class RunOutputs:
    """Writes table and harvest of a run along with its checkpoints.

    Attributes:
        on_true_answer: what `CachedLaw` gives true answers to, or None where nothing is harvested.
    """

    def __init__(self, recipe: Recipe, folder: Path, harvest: bool) -> None:
        self.recipe, self.folder = recipe, folder
        self.on_true_answer: OnTrueAnswer | None = self._take if harvest else None
        self._writer: HarvestWriter | None = None

    def store(self, table: StressTable | None) -> None:
        """Write what there is now."""
        if self._writer is not None:
            self._writer.flush()
        if table is not None:
            write_table(self.folder / TABLE, stored(table, self.recipe.to_dict()))

    def _take(self, F: Any, F_dot: Any, stress: Any, status: Any, why: Any) -> None:
        if self._writer is None:
            self._writer = self._open()
        self._writer(F, F_dot, stress, status, why)

    def _open(self) -> HarvestWriter:
        recipe = self.recipe
        header = HarvestHeader(
            cell=recipe.cell,
            rve=asdict(recipe.rve),
            recipe=recipe.to_dict(),
        )
        return HarvestWriter(self.folder / HARVEST, header)


def counts_of(table: StressTable | None) -> dict[str, int]:
    """What became of a table, for the record of a run."""
    if table is None:
        return {}
    changed = {name.removeprefix("table_"): count for name, count in table.counts.items()}
    return {"table_records": table.size, **{f"table_{name}": n for name, n in changed.items()}}


def merge_tables(files: Sequence[Path], out: Path, *, fresh: bool = False) -> int:
    """Write the records of all files into one; how many there are.

    Ellipsoids are tested for the smallest tolerance of the files.

    Raises:
        MismatchError: they are not of the same cell parameters and initialisation, or `out` is of
            other files, and not `fresh`.
    """
    of = {"files": [file_fingerprint(path) for path in files]}
    if out.exists() and not fresh:
        kept = read_table(out)
        check_same(out, of, kept.recipe)
        return len(kept.records.centre)
    tables = [read_table(path) for path in files]
    first = tables[0]
    tolerance = min(each.tolerance for each in tables)
    images = 4 if first.cell.symmetry == "D4" else 1
    records = first.records
    for path, more in zip(files[1:], tables[1:], strict=True):
        check_table(path, more, first.cell, first.initialisation)
        records = merged(records, more.records, tolerance, images)
    sources = {"merged": [each.recipe for each in tables], **of}
    write_table(out, replace(first, records=records, tolerance=tolerance, recipe=sources))
    return len(records.centre)

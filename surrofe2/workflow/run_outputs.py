"""Tables and harvests of runs: kept with their checkpoints, written at their end, merged."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

from numpy.typing import NDArray

from surrofe2.cache import StressTable
from surrofe2.cache.branches import part_of, within
from surrofe2.cache.protocols import OnTrueAnswer
from surrofe2.recipe import Recipe
from surrofe2.store.samples import HarvestWriter, Origin
from surrofe2.store.tables import stored, write_table

TABLE, HARVEST = "table.h5", "harvest.h5"


def of_cell(file: str, cell: str) -> str:
    """The file's name with that of the cell, "" of the only one: harvest-skin.h5."""
    name, dot, kind = file.rpartition(".")
    return f"{name}-{cell}{dot}{kind}" if cell else file


class RunOutputs:
    """Tables and harvests of a run, of each cell its own, written when it ends.

    Until then true answers are kept in memory and in checkpoints, so that a harvest has exactly
    those of the run that it belongs to.
    """

    def __init__(self, recipe: Recipe, folder: Path, harvest: bool) -> None:
        self.recipe, self.folder = recipe, folder
        self._harvest = harvest
        self._writers: dict[str, HarvestWriter] = {}

    def taker(self, part: Recipe) -> OnTrueAnswer | None:
        """What a `CachedLaw` of the recipe's only cell, or of one of them, gives true answers to;
        None where nothing is harvested."""
        if not self._harvest:
            return None
        cell = part.cell_name or ""
        self._writers[cell] = HarvestWriter(self.folder / of_cell(HARVEST, cell), origin_of(part))
        return self._writers[cell]

    def to_arrays(self) -> dict[str, NDArray]:
        """The true answers so far, for `restore`."""
        arrays: dict[str, NDArray] = {}
        for cell, writer in self._writers.items():
            arrays |= within(f"of {cell}", writer.to_arrays())
        return arrays

    def restore(self, arrays: Mapping[str, NDArray]) -> None:
        """Have these true answers and no others."""
        for cell, writer in self._writers.items():
            writer.restore(part_of(arrays, f"of {cell}"))

    def store(self, tables: Mapping[str, StressTable], seconds: float = 0.0) -> None:
        """Write what there is now, each file whole, and what it took so far."""
        for writer in self._writers.values():
            writer.flush(seconds)
        for name, table in tables.items():
            found = stored(table, self.recipe.to_dict(), seconds)
            write_table(self.folder / of_cell(TABLE, name), found)


def origin_of(recipe: Recipe) -> Origin:
    """Where answers for a recipe come from."""
    return Origin(cell=recipe.cell, rve=asdict(recipe.rve), recipe=recipe.to_dict())


def counts_with(tables: Mapping[str, StressTable], before: Mapping[str, int]) -> dict[str, int]:
    """The counts of a run with what became of its tables; their RVE solves are among all."""
    counts: Counter[str] = Counter()
    for table in tables.values():
        changed = {f"table_{name.removeprefix('table_')}": n for name, n in table.counts.items()}
        counts.update({"table_records": table.size, **changed})
    solves = before.get("rve_solves", 0) + counts.get("table_rve_solves", 0)
    return {**before, **counts, **({"rve_solves": solves} if tables else {})}

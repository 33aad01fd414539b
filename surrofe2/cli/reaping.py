"""What a cached run leaves for the next one: its table and its harvest, in the run folder."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from surrofe2.cache import StressTable
    from surrofe2.cache.protocols import Keep
    from surrofe2.io.harvest import HarvestWriter
    from surrofe2.recipe import Recipe

TABLE, HARVEST = "table.h5", "harvest.h5"


class Reaping:
    """Writes table and harvest of a run along with its checkpoints.

    Attributes:
        keep: what `CachedLaw` gives true answers to, or None where nothing is harvested.
    """

    def __init__(self, recipe: Recipe, folder: Path, harvest: bool) -> None:
        self.recipe, self.folder = recipe, folder
        self.keep: Keep | None = self._take if harvest else None
        self._writer: HarvestWriter | None = None

    def resume(self, table: StressTable | None) -> None:
        """Let the table know what it did at the last checkpoint."""
        from surrofe2.io.tables import check_table, read_table

        path = self.folder / TABLE
        if table is not None and path.exists():
            stored = read_table(path)
            check_table(path, stored, table.cell, table.initialisation)
            table.restore(stored.records)

    def store(self, table: StressTable | None) -> None:
        """Write what there is now."""
        from surrofe2.io.tables import stored, write_table

        if self._writer is not None:
            self._writer.flush()
        if table is not None:
            write_table(self.folder / TABLE, stored(table, self.recipe.to_dict()))

    def _take(self, F: Any, F_dot: Any, stress: Any, status: Any, why: Any) -> None:
        if self._writer is None:
            self._writer = self._open()
        self._writer(F, F_dot, stress, status, why)

    def _open(self) -> HarvestWriter:
        from importlib.metadata import version

        from surrofe2.io.harvest import HarvestHeader, HarvestWriter

        recipe = self.recipe
        header = HarvestHeader(
            cell=recipe.cell,
            rve=asdict(recipe.rve),
            version=version("surrofe2"),
            recipe=recipe.to_dict(),
        )
        return HarvestWriter(self.folder / HARVEST, header)


def counts_of(table: StressTable | None) -> dict[str, int]:
    """What became of a table, for the record of a run."""
    if table is None:
        return {}
    changed = {name.removeprefix("table_"): count for name, count in table.counts.items()}
    return {"table_records": table.size, **{f"table_{name}": n for name, n in changed.items()}}

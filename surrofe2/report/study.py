"""The results of a study: panels of one figure, one table, its numbers, and their files.

Plain data, so that a study draws nothing and a drawing computes nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surrofe2.base.sampling import SamplingRange
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import load_recipe
from surrofe2.report.tables import Table, to_csv
from surrofe2.run.charts import Panel, draw_panels, encoded
from surrofe2.store.store import keep, write_bytes, write_text

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class NamedCell:
    """A plant cell by the name of its source.

    Attributes:
        cell: its parameters.
        name: name of the source.
        source: "preset" or "recipe".
        range: `[range]` of the recipe; None: it has none.
    """

    cell: CellParameters
    name: str
    source: str = "preset"
    range: SamplingRange | None = None

    @classmethod
    def of(cls, name: str) -> NamedCell:
        """Return the plant cell of a preset, or of a recipe where the name ends in .toml."""
        if not name.endswith(".toml"):
            return cls(CellParameters.preset(name), name)
        study = load_recipe(name).study()
        return cls(study.cell.parameters, Path(name).stem, "recipe", study.cell.range)

    def identity(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        """Return all on which numbers about the cell depend.

        Args:
            asked: settings of the study besides the cell.
        """
        return {
            "version": version("surrofe2"),
            self.source: self.name,
            "cell": self.cell.to_dict(),
            "asked": asked,
        }

    def __str__(self) -> str:
        return f"{self.source} “{self.name}”"


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A finished study.

    Attributes:
        title: of the figure.
        panels: charts of the figure, row by row.
        columns: number of panels in a row.
        drawing: a figure that is no chart and takes the place of panels.
        table: the table for people; in JSON it is "rows".
        results: further numbers for JSON.
    """

    title: str
    panels: tuple[Panel, ...] = ()
    columns: int = 1
    drawing: Figure | None = None
    table: Table[Any]
    results: Mapping[str, Any] = field(default_factory=dict)

    def to_csv(self) -> str:
        """Return all points of the panels as CSV; without panels, the table."""
        if not self.panels:
            return self.table.to_csv()
        rows = (
            (panel.title, panel.x_label, panel.y_label, curve.words, x, y)
            for panel in self.panels
            for curve in panel.curves
            for x, y in zip(curve.x, curve.y, strict=True)
        )
        return to_csv(("panel", "x is", "y is", "curve", "x", "y"), rows)


def keep_study(
    out: Path,
    name: str,
    of: NamedCell,
    asked: Mapping[str, Any],
    make: Callable[[], Study],
    *,
    fresh: bool = False,
) -> tuple[Study | None, list[Path]]:
    """Make a study and write figure, points, table and at last its numbers, unless they are there.

    Its files are NAME-CELL.png, .csv, .md and .json in `out`.

    Args:
        asked: settings of the study besides the cell.
        make: makes the study.

    Returns:
        The study, or None where it was there; and its files.

    Raises:
        MismatchError: it is there by other settings, and not `fresh`.
    """
    stem = f"{name}-{of.name}"
    png = out / f"{stem}.png"
    csv = out / f"{stem}.csv"
    md = out / f"{stem}.md"
    json = out / f"{stem}.json"
    studies: list[Study] = []  # the study, once it is made

    def compute() -> dict[str, Any]:
        """Make the study, write its other files, and return the entries of the last, the JSON."""
        study = make()
        studies.append(study)
        write_text(md, study.table.to_markdown())
        write_text(csv, study.to_csv())
        title = f"{study.title}, {of}"
        figure = study.drawing or draw_panels(study.panels, study.columns, title=title)
        write_bytes(png, encoded(figure, "png"))
        return {
            "study": stem,
            "title": " ".join(study.title.split()),
            "units": {"length": "µm", "time": "µs", "mass": "ng", **study.table.units},
            "results": {**study.results, "rows": study.table.to_records()},
            "fingerprint": of.cell.fingerprint,
        }

    keep(json, of.identity(asked), compute, fresh=fresh)
    return next(iter(studies), None), [png, csv, md, json]

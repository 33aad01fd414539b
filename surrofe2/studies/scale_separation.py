"""FE² against the full tissue as the bar grows from 8 to 32 plant cells a side (past the paper).

A bar of n × n plant cells is 25 n µm wide, its body force 0.2 · 16/n µm/µs² and its times n/16 of
those of 16 × 16, so that strains stay alike and only the rates fall, with 1/n. What FE² gets wrong
is of three kinds: the mesh (falls with the size of elements), the finite size of plant cells (falls
with 1/n), and the initialisation. From three meshes, each with half the elements of the next, the
first is taken out by Aitken's extrapolation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.studies.bar_runs import COMPARED, TISSUE, BarCase, BarRun, compare_bar

SIZES = (8, 16, 32)
"""Plant cells a side."""
MESHES = (4, 8, 16)
"""Elements a side."""
METHOD = "slow-manifold"
LIMIT = "mesh limit"


def scaled_load_case(n: int, duration: float = 250.0) -> LoadCase:
    """The paper's bar at n × n plant cells of 25 µm; `duration` is that at 16 × 16, µs."""
    side, scale = 25.0 * n, n / 16.0
    return LoadCase(
        width=side,
        height=side,
        body_force=(0.0, -0.2 / scale),
        duration=duration * scale,
        watched=(side, 0.5 * side),
        output_interval=0.5 * scale,
    )


def cases(
    cell: CellParameters,
    preset: str,
    sizes: Sequence[int] = SIZES,
    meshes: Sequence[int] = MESHES,
    duration: float = 250.0,
) -> list[BarCase]:
    """The tissue and FE² on each mesh for each size, cheap ones first."""
    found = []
    for n in sizes:
        load_case = scaled_load_case(n, duration)
        found.append(BarCase(cell=cell, preset=preset, method=TISSUE, load_case=load_case))
        found += [
            BarCase(cell=cell, preset=preset, method=METHOD, load_case=load_case, elements=(m, m))
            for m in meshes
        ]
    return found


@dataclass(frozen=True, slots=True)
class Row:
    """A run, or the limit of a bar's runs on finer and finer meshes, which has deviations alone.

    mesh: elements a side; 0 for the tissue. off: of period, first minimum and decrement from the
    tissue of the same size, % by name.
    """

    plant_cells: int
    mesh: int | None
    run: BarRun | None
    off: dict[str, float]

    @property
    def name(self) -> str:
        """How tables call it."""
        return LIMIT if self.run is None else self.run.name


def deviations(runs: Sequence[BarRun]) -> list[Row]:
    """A row for each run, and one for each limit, size by size."""
    rows = []
    for n in dict.fromkeys(run.case.plant_cells[0] for run in runs):
        of_size = [run for run in runs if run.case.plant_cells[0] == n]
        tissue = next(run for run in of_size if run.case.elements is None)
        found = [
            Row(n, (run.case.elements or (0,))[0], run, dict(compare_bar(run, tissue).off))
            for run in of_size
        ]
        rows += [*found, *_mesh_limit(n, found)]
    return rows


def _mesh_limit(n: int, rows: list[Row]) -> list[Row]:
    """The row that the three finest meshes tend to, where they do."""
    by_mesh = {row.mesh: row.off for row in rows if row.mesh}
    meshes = sorted(by_mesh)[-3:]
    if len(meshes) < 3 or any(2 * a != b for a, b in pairwise(meshes)):
        return []
    limit = {each.name: aitken(*(by_mesh[m][each.name] for m in meshes)) for each in COMPARED}
    return [Row(n, None, None, limit)]


def aitken(a: float, b: float, c: float) -> float:
    """Limit of a geometric approach a, b, c, …; NaN where they do not approach one."""
    first, second = b - a, c - b
    if not 0.0 < second / first < 0.9 if first else True:
        return float("nan")
    return float(c + second**2 / (first - second))


def _compared(each: Quantity[BarRun]) -> tuple[Quantity[Row], ...]:
    """Its value, for people with lengths and times scaled to 16 × 16 plant cells; its deviation."""

    def value(row: Row) -> float | None:
        return None if row.run is None else each.get(row.run)

    def scaled(row: Row) -> float | None:
        return None if row.run is None else each.get(row.run) * 16.0 / row.plant_cells

    off: Quantity[Row] = Quantity(
        f"{each.name} off", "%", "+.2f", lambda row: row.off.get(each.name)
    )
    if not each.unit:
        return Quantity(each.name, "", each.format, value), off
    shown = Quantity(f"{each.name} × 16/n", each.unit, each.format, scaled)
    return Quantity(each.name, each.unit, None, value), shown, off


QUANTITIES: tuple[Quantity[Row], ...] = (
    Quantity("plant cells a side", "", "d", lambda row: row.plant_cells),
    Quantity("run", "", "", lambda row: row.name),
    *(quantity for each in COMPARED for quantity in _compared(each)),
    Quantity("fit residual", "µm", None, lambda row: row.run and row.run.fit.residual),
    Quantity("time", "s", ".0f", lambda row: row.run and row.run.seconds),
)


def describe(runs: Sequence[BarRun]) -> Study:
    """Deviation of period, first minimum and decrement over the number of plant cells a side."""
    rows, case = deviations(runs), runs[0].case
    return Study(
        name=f"scales-{case.preset}",
        title="FE² against the full tissue as the bar grows\n"
        f"(strains alike, preset “{case.preset}”)",
        panels=tuple(_panel(rows, each.name) for each in COMPARED),
        columns=len(COMPARED),
        table=Table(QUANTITIES, rows),
    )


def _panel(rows: list[Row], quantity: str) -> Panel:
    curves = []
    for mesh in dict.fromkeys(row.mesh for row in rows if row.off):
        of_mesh = [row for row in rows if row.mesh == mesh]
        label = LIMIT if mesh is None else f"{mesh} × {mesh} elements"
        n = np.array([float(row.plant_cells) for row in of_mesh])
        curves.append(Curve(label, n, np.array([row.off[quantity] for row in of_mesh])))
    return Panel(
        title=f"{METHOD}: {quantity}",
        x_label="plant cells a side",
        y_label="FE² over tissue − 1 (%)",
        curves=tuple(curves),
        log_x=True,
        x_ticks=tuple(sorted({float(row.plant_cells) for row in rows})),
        zero=True,
    )

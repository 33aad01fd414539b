"""FE² against the full tissue as the bar grows from 8 to 32 plant cells a side (past the paper).

A bar of n × n plant cells is 25 n µm wide, its body force 0.2 · 16/n µm/µs² and its times n/16 of
those of 16 × 16, so that strains stay alike and only the rates fall, with 1/n. What FE² gets wrong
is of three kinds: the mesh (falls with the size of elements), the finite size of plant cells (falls
with 1/n), and the initialisation. From three meshes, each with half the elements of the next, the
first is taken out by Aitken's extrapolation.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import Curve, Panel
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.studies.bar_runs import (
    COMPARED,
    TISSUE,
    BarCase,
    BarRun,
    ComparedBar,
    compare_bar,
    deviation,
    of_run,
)

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


def deviations(runs: Sequence[BarRun]) -> list[ComparedBar]:
    """A row for each run, and one for the limit of each bar's meshes, size by size."""
    rows = []
    for n in dict.fromkeys(run.case.plant_cells[0] for run in runs):
        of_size = [run for run in runs if run.case.plant_cells[0] == n]
        tissue = next(run for run in of_size if run.case.elements is None)
        found = [compare_bar(run, tissue) for run in of_size]
        rows += found
        finest = sorted((row for row in found if mesh_of(row)), key=mesh_of)[-3:]
        meshes = [mesh_of(row) for row in finest]
        if len(meshes) == 3 and all(2 * a == b for a, b in pairwise(meshes)):
            limit = {
                each.name: aitken(*(row.off[each.name] for row in finest)) for each in COMPARED
            }
            rows.append(ComparedBar(n, None, limit))
    return rows


def mesh_of(row: ComparedBar) -> int:
    """Elements a side; 0 for the tissue and the limit."""
    return row.run.case.elements[0] if row.run and row.run.case.elements else 0


def aitken(a: float, b: float, c: float) -> float:
    """Limit of a geometric approach a, b, c, …; NaN where they do not approach one."""
    first, second = b - a, c - b
    if not 0.0 < second / first < 0.9 if first else True:
        return float("nan")
    return float(c + second**2 / (first - second))


def _scaled(each: Quantity[BarRun]) -> Quantity[ComparedBar]:
    """Lengths and times for people, scaled to 16 × 16 plant cells."""
    if not each.unit:
        return of_run(each.name, "", str(each.format), each.get)
    return of_run(
        f"{each.name} × 16/n",
        each.unit,
        str(each.format),
        lambda run: each.get(run) * 16.0 / run.case.plant_cells[0],
    )


QUANTITIES: tuple[Quantity[ComparedBar], ...] = (
    Quantity("plant cells a side", "", "d", lambda row: row.plant_cells),
    Quantity("run", "", "", lambda row: row.run.name if row.run else LIMIT),
    *(quantity for each in COMPARED for quantity in (_scaled(each), deviation(each.name, "+.2f"))),
    of_run("first minimum", "µm", None, lambda run: run.minimum[1]),
    of_run("period", "µs", None, lambda run: run.fit.first.period),
    of_run("fit residual", "µm", None, lambda run: run.fit.residual),
    of_run("time", "s", ".0f", lambda run: run.seconds),
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


def _panel(rows: list[ComparedBar], quantity: str) -> Panel:
    curves: dict[str, list[tuple[float, float]]] = {}
    for row in rows:
        if row.off:
            mesh = mesh_of(row)
            label = f"{mesh} × {mesh} elements" if mesh else LIMIT
            curves.setdefault(label, []).append((float(row.plant_cells), row.off[quantity]))
    return Panel(
        title=f"{METHOD}: {quantity}",
        x_label="plant cells a side",
        y_label="FE² over tissue − 1 (%)",
        curves=tuple(Curve(label, *np.array(xy).T) for label, xy in curves.items()),
        log_x=True,
        x_ticks=tuple(sorted({float(row.plant_cells) for row in rows})),
        zero=True,
    )

"""FE² against the full tissue of plant cells with a uniform fluid: Voronoi cells and squares.

Bars of 16 × 16 plant cells bend under the paper's load and under a tenth of it, by which FE²
oscillates about its state of rest; strips of 16 plant cells along and n across are pulled by 3 %
and held. Sides are whole RVEs at rest, so that tissue and mesh have one area. FE² has RVEs on the
slow manifold, for bars of squares also with the surface law. Of Voronoi cells each seed is an
arrangement of its own, for RVE and tissue alike: the table ends with mean and standard deviation
over seeds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isqrt

import numpy as np

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import NamedCell, Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.store.samples import kept_reference
from validation.bars import ABSOLUTE_TOLERANCE, BAR, RELATIVE_TOLERANCE
from validation.case import FE2, SURFACE, TISSUE, Case, Row, Setting, compare, curves_of, off_panel
from validation.tissues import ALONG, DURATION, RAMP, STRIP

PER_RVE, SEEDS = 16, (1, 2, 3)
"""Voronoi cells of an RVE, and their arrangements."""
ACROSS, STRETCH = (8, 16), 0.03
"""Strips: plant cells across, and what they are pulled by."""
WIDE = 4
"""Plant cells along an element of a strip, which is as wide as an RVE."""
COARSE, FINE = 4, 8
"""Elements per side of bars. On the fine mesh elements are half as wide as RVEs of Voronoi cells:
it is for small loads, where RVEs cost nothing, and for squares."""
SMALL, LOAD = "bar, a tenth of the load", "bar, full load"
FACTORS = {SMALL: 0.1, LOAD: 1.0}
SQUARES = "squares"
BENDING_MEASURES = "first minimum", "period", "decrement"


def kinds_of(of: NamedCell, seeds: Sequence[int] = SEEDS) -> list[NamedCell]:
    """Voronoi cells of each seed, and squares, all with a uniform fluid."""
    voronoi = [
        replace(
            of.cell, arrangement="voronoi", cells=PER_RVE, arrangement_seed=seed, fluid="uniform"
        )
        for seed in seeds
    ]
    names = [f"{of.name}, Voronoi {seed}" for seed in seeds]
    squares = replace(of.cell, fluid="uniform")
    named = zip([*voronoi, squares], [*names, f"{of.name}, {SQUARES}"], strict=True)
    return [NamedCell(cell, name, of.source) for cell, name in named]


def sides(cell: CellParameters, along: int, across: int) -> tuple[float, float]:
    """Length and height of so many plant cells in whole RVEs at rest, µm."""
    lattice, per_side = kept_reference(cell).lattice, isqrt(cell.cells)
    return float(lattice[0, 0] * along / per_side), float(lattice[1, 1] * across / per_side)


def bar(of: NamedCell, name: str, method: str, mesh: int = COARSE) -> Case:
    """The paper's bar at its load or a tenth of it, watched by the mean motion of its free end."""
    width, height = sides(of.cell, ALONG, ALONG)
    table = {
        "mesh": {"width": width, "height": height, "elements": [mesh, mesh]},
        "conditions": {
            "clamp": {"kind": "fixed", "on": "left"},
            # watches the mean displacement of its boundary
            "end": {"kind": "traction", "on": "right", "traction": [0.0, 0.0]},
            "load": {"kind": "body_force", "acceleration": [0.0, -0.2 * FACTORS[name]]},
        },
        "macro": {
            "relative_tolerance": RELATIVE_TOLERANCE,
            "absolute_tolerance": ABSOLUTE_TOLERANCE,
            "record_dissipation": False,
        },
        "tissue": {"frames": 2},
        "time": {"duration": 250.0, "output_interval": 0.5, "frames": 2},
        "watch": {"end": [width, 0.5 * height]},
    }  # fmt: skip
    return Case(
        problem=f"{name}, {of.name}", of=of, across=ALONG, method=method, table=table,
        measures=("period", "decrement") if name == SMALL else BENDING_MEASURES, mean="right",
        linear=name == SMALL,
    )  # fmt: skip


def strip(of: NamedCell, n: int, method: str) -> Case:
    """Pulled by 3 % and held."""
    width, height = sides(of.cell, ALONG, n)
    ramp = {"kind": "ramp", "end": RAMP, "smooth": True}
    table = {
        "mesh": {"width": width, "height": height, "elements": [ALONG // WIDE, max(n // WIDE, 1)]},
        "conditions": {
            "clamp": {"kind": "fixed", "on": "left"},
            "grip": {
                "kind": "prescribed_motion", "on": "right", "amplitude": ramp,
                "displacement": [STRETCH * width, 0.0],
            },
        },
        "macro": {"record_dissipation": False},
        "tissue": {"frames": 2},
        "time": {"duration": DURATION, "output_interval": 0.5, "frames": 2},
    }  # fmt: skip
    return Case(
        problem=f"{STRIP}, {of.name}", of=of, across=n, method=method, table=table,
        measures=("held force",), axis=0, force="grip", even=True,
    )  # fmt: skip


def cases(of: NamedCell, sizes: Sequence[int] = ACROSS) -> list[Case]:
    """All runs of bars and strips of each arrangement."""
    of_all = []
    for each in kinds_of(of):
        for name in FACTORS:
            is_quick = name == SMALL or each.cell.cells == 1
            meshes = (COARSE, FINE) if is_quick else (COARSE,)
            of_all.append(bar(each, name, TISSUE))
            of_all += [bar(each, name, FE2, mesh) for mesh in meshes]
            if each.cell.cells == 1:  # the surface law is of one square plant cell
                of_all.append(bar(each, name, SURFACE))
        of_all += [strip(each, n, way) for n in sizes for way in (TISSUE, FE2)]
    return of_all


@dataclass(frozen=True, slots=True)
class Line:
    """How far FE² is from the tissue in a measure: of one arrangement, or over several."""

    problem: str
    arrangement: str
    across: int
    run: str
    measure: str
    value: float | None
    tissue: float | None
    off: float
    scatter: float | None = None


LINES: tuple[Quantity[Line], ...] = (
    Quantity("problem", "", "", lambda line: line.problem),
    Quantity("cells", "", "", lambda line: line.arrangement),
    Quantity("plant cells across", "", "d", lambda line: line.across),
    Quantity("run", "", "", lambda line: line.run),
    Quantity("measure", "µm, µs, µN", "", lambda line: line.measure),
    Quantity("value", "", ".5g", lambda line: line.value),
    Quantity("full tissue", "", ".5g", lambda line: line.tissue),
    Quantity("off", "%", "+.2f", lambda line: line.off),
    Quantity("scatter", "%", ".2f", lambda line: line.scatter),
)


def lines_of(rows: Sequence[Row]) -> list[Line]:
    """Rows of FE², and behind them mean and standard deviation over the seeds of each problem."""
    lines = []
    seeds: dict[tuple[str, int, str, str], list[float]] = {}
    for row in rows:
        if row.off is None:
            continue
        problem, _, cells = row.case.problem.rpartition(", ")
        problem = problem.rpartition(", ")[0]
        what = row.case.across, row.run_name, row.measure
        lines.append(Line(problem, cells, *what, row.value, row.tissue, row.off))
        if cells != SQUARES:
            seeds.setdefault((problem, *what), []).append(row.off)
    for (problem, across, run, measure), off in seeds.items():
        if len(off) > 1:
            mean, scatter = float(np.mean(off)), float(np.std(off, ddof=1))
            name = f"Voronoi, {len(off)} seeds"
            lines.append(Line(problem, name, across, run, measure, None, None, mean, scatter))
    return lines


def irregular_tissue(setting: Setting) -> Study:
    """How far FE² is from tissues of Voronoi cells and of squares."""
    runs = setting.runs(cases(setting.of, setting.sizes or ACROSS))
    rows = compare(runs)
    drawn = [
        (run.case.problem, run.case.across) for run in runs if run.case.problem.startswith(BAR)
    ]
    strips = [row for row in rows if row.case.problem.startswith(STRIP)]
    forces = off_panel("force of strips", strips, "held force", lambda row: row.case.of.name)
    shown = dict.fromkeys(drawn)
    return Study(
        title="FE² against the full tissue of plant cells with a uniform fluid",
        panels=(forces, *curves_of(runs, shown)),
        columns=2,
        table=Table(LINES, lines_of(rows)),
    )

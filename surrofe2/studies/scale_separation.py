"""FE² against the full tissue as the bar grows from 8 to 32 plant cells a side (past the paper).

A bar of n × n plant cells is 25 n µm wide, its body force 0.2 · 16/n µm/µs² and its times n/16 of
those of 16 × 16, so that strains stay alike and only the rates fall, with 1/n. What FE² gets wrong
is of three kinds: the mesh (falls with the size of elements), the finite size of plant cells (falls
with 1/n), and the initialisation. From three meshes, each with half the elements of the next, the
first is taken out by Aitken's extrapolation.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Curve, Panel, Study
from surrofe2.studies.bar_comparison import TISSUE, BarRun, figures
from surrofe2.studies.bar_pieces import Piece

SIZES = (8, 16, 32)
"""Plant cells a side."""
MESHES = (4, 8, 16)
"""Elements a side."""
METHODS = ("slow-manifold",)
QUANTITIES = {"period": "period", "first_minimum": "first minimum", "decrement": "decrement"}
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


def pieces(
    cell: CellParameters,
    preset: str,
    sizes: tuple[int, ...] = SIZES,
    meshes: tuple[int, ...] = MESHES,
    methods: tuple[str, ...] = METHODS,
    duration: float = 250.0,
) -> list[tuple[int, Piece]]:
    """(plant cells a side, piece) of all runs, cheap ones first."""
    found = []
    for n in sizes:
        load_case = scaled_load_case(n, duration)
        common: dict[str, Any] = {"cell": cell, "preset": preset, "load_case": load_case}
        found.append((n, Piece(method=TISSUE, **common)))
        for mesh in meshes:
            found += [(n, Piece(method=m, elements=(mesh, mesh), **common)) for m in methods]
    return found


def deviations(runs: Mapping[int, list[BarRun]]) -> list[dict[str, Any]]:
    """A row for each run: its figures, and how far they are from the tissue's, %.

    Args:
        runs: plant cells a side to the runs of that bar, its tissue among them.
    """
    rows = []
    for n, of_size in runs.items():
        tissue = next(run for run in of_size if run.elements is None)
        for run in of_size:
            mesh = 0 if run.elements is None else run.elements[0]
            rows.append(
                {"plant_cells": n, "mesh": mesh, "method": run.method} | figures(run, tissue)
            )
        for method in {run.method: None for run in of_size if run.elements is not None}:
            rows += _mesh_limit(n, method, [r for r in rows if r["plant_cells"] == n])
    return rows


def _mesh_limit(n: int, method: str, rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The row that the three finest meshes tend to, where they do."""
    of_method = sorted((r for r in rows if r["method"] == method), key=lambda r: r["mesh"])[-3:]
    meshes = [row["mesh"] for row in of_method]
    if len(meshes) < 3 or any(2 * a != b for a, b in pairwise(meshes)):
        return []
    limit: dict[str, Any] = {"plant_cells": n, "mesh": LIMIT, "method": method}
    for key in QUANTITIES:
        name = f"{key}_deviation_percent"
        limit[name] = aitken(*(row[name] for row in of_method))
    return [limit]


def aitken(a: float, b: float, c: float) -> float:
    """Limit of a geometric approach a, b, c, …; NaN where they do not approach one."""
    first, second = b - a, c - b
    if not 0.0 < second / first < 0.9 if first else True:
        return float("nan")
    return float(c + second**2 / (first - second))


def describe(rows: list[dict[str, Any]], preset: str, name: str, **settings: Any) -> Study:
    """Deviation of period, first minimum and decrement over the number of plant cells a side."""
    compared = [row for row in rows if row["method"] != TISSUE]
    methods = list(dict.fromkeys(row["method"] for row in compared))
    columns = (
        "plant_cells", "mesh", "method", "first_minimum", "period", "decrement", "fit_residual",
        *(f"{key}_deviation_percent" for key in QUANTITIES), "seconds",
    )  # fmt: skip
    return Study(
        name=name,
        title=f"FE² against the full tissue as the bar grows\n(strains alike, preset “{preset}”)",
        panels=tuple(
            _panel([row for row in compared if row["method"] == method], key, word, method)
            for method in methods
            for key, word in QUANTITIES.items()
        ),
        columns=len(QUANTITIES),
        table={column: [row.get(column, float("nan")) for row in rows] for column in columns},
        results={"rows": rows},
        units={"first_minimum": "µm", "period": "µs", "decrement": "1, a period"},
        settings=settings,
        shown=_shown(rows),
    )


def _shown(rows: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Lengths and times scaled to 16 × 16 plant cells, so that bars can be compared."""

    def scaled(row: dict[str, Any], key: str) -> str:
        return f"{row[key] * 16.0 / row['plant_cells']:.2f}" if key in row else "–"

    def off(row: dict[str, Any], key: str) -> str:
        value = row.get(f"{key}_deviation_percent")
        return "–" if value is None or np.isnan(value) else f"{value:+.2f}"

    return {
        "plant cells": [f"{row['plant_cells']} × {row['plant_cells']}" for row in rows],
        "run": [_run_of(row) for row in rows],
        "first minimum × 16/n (µm)": [scaled(row, "first_minimum") for row in rows],
        "off (%)": [off(row, "first_minimum") for row in rows],
        "period × 16/n (µs)": [scaled(row, "period") for row in rows],
        "period off (%)": [off(row, "period") for row in rows],
        "decrement": [f"{row['decrement']:.4f}" if "decrement" in row else "–" for row in rows],
        "decrement off (%)": [off(row, "decrement") for row in rows],
        "time (s)": [f"{row['seconds']:.0f}" if "seconds" in row else "–" for row in rows],
    }


def _run_of(row: dict[str, Any]) -> str:
    if row["method"] == TISSUE:
        return "full tissue"
    where = row["mesh"] if row["mesh"] == LIMIT else f"{row['mesh']} × {row['mesh']}"
    return f"{row['method']}, {where}"


def _panel(rows: list[dict[str, Any]], key: str, word: str, method: str) -> Panel:
    curves = []
    for mesh in dict.fromkeys(row["mesh"] for row in rows):
        of_mesh = [row for row in rows if row["mesh"] == mesh]
        label = LIMIT if mesh == LIMIT else f"{mesh} × {mesh} elements"
        n = np.array([float(row["plant_cells"]) for row in of_mesh])
        off = np.array([row[f"{key}_deviation_percent"] for row in of_mesh])
        curves.append(Curve(label, n, off))
    return Panel(
        title=f"{method}: {word}",
        x_label="plant cells a side",
        y_label="FE² over tissue − 1 (%)",
        curves=tuple(curves),
        log_x=True,
        x_ticks=tuple(dict.fromkeys(float(row["plant_cells"]) for row in rows)),
        zero=True,
    )

"""FE² against the full tissue in other problems, and in thin tissue with the law of its free sides.

A strip of 16 plant cells along and n across is pulled by 3 % and held; a block of as many is
pressed by 2 % between two plates; a cantilever twice as long as it is high, whose upper quarter has
walls half as stiff again, bends under a weight by which strains do not depend on its size. FE² has
RVEs on the slow manifold. Forces are means over the last quarter, where the boundary rests.

Thin: strips of n plant cells across and 16 along are clamped at one end and pulled along their
length by a small body force; one of 4 across bends under its weight; bars are the paper's. FE² has
an element for each plant cell, at most 16 each way, and oscillates about its state of rest.
"""

from __future__ import annotations

from typing import Any

from surrofe2.report.study import NamedCell, Study
from surrofe2.report.tables import Table
from validation.bars import BAR, MICRO_STEP, bar
from validation.case import (
    FE2,
    ROWS,
    SURFACE,
    TISSUE,
    Case,
    Setting,
    compare,
    compared_panels,
    off_panel,
)

ALONG, SKIN = 16, 4
"""Plant cells: length of strip and block; of the cantilever's height, as a quarter is skin."""
SIZES, THIN_SIZES = (4, 8, 16, 24), (2, 4, 8, 16)
STIFFER = 1.5
"""Wall stiffness of the skin over that of the parenchyma."""
DURATION, RAMP, BENDING = 60.0, 45.0, 18.75
"""µs: strip and block, in which the boundary moves, and the cantilever per plant cell across."""
WEIGHT = 0.4
"""µm/µs² times plant cells across: acceleration of the cantilever."""
STRIP, BLOCK, SKINNED = "tensile strip", "block between plates", "skin over parenchyma"
OVER_SIZE = {
    "held force": "force of strip and block",
    "first minimum": "first minimum of the cantilever",
    "period": "period of the cantilever",
}
"""Measures drawn over the number of plant cells across, with the titles of their panels."""
PULLED, CANTILEVER = "strip, pulled", "cantilever"
BENT, MOST_ELEMENTS = 4, 16
"""Plant cells across the thin cantilever; elements each way."""


def _problem(of: NamedCell, name: str, n: int, method: str, **given: Any) -> Case:
    """One of the three problems; `given`: its tables and what is read off its run."""
    duration = BENDING * n if name == SKINNED else DURATION
    table = {
        "macro": {"record_dissipation": False},
        "tissue": {"frames": 2},
        "time": {"duration": duration, "output_interval": 0.5, "frames": 2},
        **given.pop("table"),
    }
    return Case(problem=name, of=of, across=n, method=method, table=table, **given)


def strip(of: NamedCell, n: int, method: str) -> Case:
    """Pulled by 3 % and held."""
    side = of.cell.cell_side
    long, ramp = ALONG * side, {"kind": "ramp", "end": RAMP, "smooth": True}
    table = {
        "mesh": {"width": long, "height": n * side, "elements": [ALONG // 2, max(n // 2, 1)]},
        "conditions": {
            "clamp": {"kind": "fixed", "on": "left"},
            "grip": {
                "kind": "prescribed_motion", "on": "right", "amplitude": ramp,
                "displacement": [0.03 * long, 0.0],
            },
        },
    }  # fmt: skip
    read = {"measures": ("held force",), "axis": 0, "force": "grip", "even": True}
    return _problem(of, STRIP, n, method, table=table, **read)


def block(of: NamedCell, n: int, method: str) -> Case:
    """Pressed by 2 % between two plates."""
    side = of.cell.cell_side
    long, ramp = ALONG * side, {"kind": "ramp", "end": RAMP, "smooth": True}
    table = {
        "mesh": {"width": n * side, "height": long, "elements": [max(n // 2, 1), ALONG // 2]},
        "bodies": {
            "support": {"plane": {"normal": [0, 1]}, "on": "bottom", "position": [0, 0]},
            "plate": {
                "plane": {"normal": [0, -1]}, "on": "top", "position": [0, long],
                "displacement": [0.0, -0.02 * long], "amplitude": ramp,
            },
        },
    }  # fmt: skip
    read = {"measures": ("held force",), "force": "plate", "even": True}
    return _problem(of, BLOCK, n, method, table=table, **read)


def skinned(of: NamedCell, n: int, method: str) -> Case:
    """A cantilever whose upper quarter is stiffer, n a multiple of 4."""
    width, height = 2 * n * of.cell.cell_side, n * of.cell.cell_side
    cell = of.cell.to_dict()
    skin = {**cell, "wall_stiffness": STIFFER * of.cell.wall_stiffness}
    table = {
        "cells": {
            "skin": {**skin, "regions": ["skin"]},
            "parenchyma": {**cell, "regions": ["rest"]},
        },
        "mesh": {
            "width": width, "height": height, "elements": [16, 8],
            "regions": {"skin": {"box": [0.0, 0.75 * height, width, height]}},
        },
        "conditions": {
            "clamp": {"kind": "fixed", "on": "left"},
            "weight": {"kind": "body_force", "acceleration": [0.0, -WEIGHT / n]},
        },
        "watch": {"end": [width, 0.5 * height]},
    }  # fmt: skip
    return _problem(of, SKINNED, n, method, table=table, measures=("first minimum", "period"))


def problem_cases(of: NamedCell, sizes: tuple[int, ...] = SIZES) -> list[Case]:
    """Both runs of strip and block at each size, and of the skin where it has whole rows."""
    found = [(make, n) for n in sizes for make in (strip, block)]
    found += [(skinned, n) for n in sizes if n % SKIN == 0]
    return [make(of, n, method) for make, n in found for method in (TISSUE, FE2)]


def problems(setting: Setting) -> Study:
    """How far FE² is from the tissue in each problem."""
    runs = setting.runs(problem_cases(setting.of, setting.sizes or SIZES))
    rows = compare(runs)
    largest = {run.case.problem: run.case.across for run in runs}
    panels = [panel for name, n in largest.items() for panel in compared_panels(runs, name, n)]
    for measure, title in OVER_SIZE.items():
        panels.append(off_panel(title, rows, measure, lambda row: row.case.problem))
    return Study(
        title="FE² against the full tissue: strip, plates and skin",
        panels=tuple(panels),
        columns=3,
        table=Table(ROWS, rows),
    )


def thin_strip(of: NamedCell, shape: str, n: int, method: str) -> Case:
    """Pulled along its length by 0.05 µm/µs² or bent by 0.005 µm/µs²."""
    pulled, side = shape == PULLED, of.cell.cell_side
    width, height = ALONG * side, n * side
    table = {
        "load": {
            "width": width,
            "height": height,
            "body_force": [0.05, 0.0] if pulled else [0.0, -0.005],
            "duration": 100.0 if pulled else 400.0,
            "watched": [width, 0.5 * height],
        },
        "macro": {"elements": [ALONG, min(n, MOST_ELEMENTS)]},
        "tissue": {"micro_step": MICRO_STEP, "frames": 2},
    }
    return Case(
        problem=shape, of=of, across=n, method=method, table=table,
        measures=("period", "decrement"), axis=0 if pulled else 1, linear=True, even=pulled,
    )  # fmt: skip


def thin_cases(
    of: NamedCell, sizes: tuple[int, ...] = THIN_SIZES, bars: tuple[int, ...] = ()
) -> list[Case]:
    """Each strip, the cantilever and bars of so many plant cells, by all methods."""
    methods = TISSUE, FE2, SURFACE
    shapes = [(PULLED, n) for n in sizes] + [(CANTILEVER, BENT)]
    found = [thin_strip(of, shape, n, method) for shape, n in shapes for method in methods]
    return found + [
        bar(of, method, min(n, MOST_ELEMENTS), n, linear=True) for n in bars for method in methods
    ]


def thin(setting: Setting) -> Study:
    """How far FE² is from the tissue with and without the surface law."""
    sizes = setting.sizes or THIN_SIZES
    runs = setting.runs(thin_cases(setting.of, sizes, setting.meshes or ()))
    rows = compare(runs)
    pulled = [row for row in rows if row.case.problem == PULLED]
    drawn = [(PULLED, sizes[0]), (CANTILEVER, BENT), *((BAR, n) for n in setting.meshes or ())]
    panels = [panel for name, n in drawn for panel in compared_panels(runs, name, n)]
    for measure in ("period", "decrement"):
        title = f"{measure} of pulled strips"
        panels.append(off_panel(title, pulled, measure, lambda row: row.case.method))
    return Study(
        title="Thin tissue: FE² with and without the surface law of its free sides",
        panels=tuple(panels),
        columns=3,
        table=Table(ROWS, rows),
    )

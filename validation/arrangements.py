"""Irregular plant cells: how many equilibria their fluid has, what Cauchy–Born is worth there.

docs/validation/arrangements.md has the table and the picture.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from matplotlib.figure import Figure

from surrofe2.base.simd import TILE
from surrofe2.plant_cell.arrangement import start_positions
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.figures import Colours, draw_cells
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import VERMILION
from surrofe2.rve import RveLaw
from surrofe2.rve.unit_cell import SAME_ENERGY, Equilibria, equilibria_in
from validation.case import Setting

SHOWN = (("square", 1), ("square", 9), ("hexagon", 9), ("voronoi", 9))
MEASURED = (("square", 1), ("hexagon", 1), ("hexagon", 4), ("voronoi", 9))
POINTS, SIZE = 16, 0.02
"""Deformations at which Cauchy–Born is measured, and how far from I their entries are."""


@dataclass(frozen=True, slots=True)
class Measured:
    """An arrangement: equilibria found from `starts` random starts, largest stress among them in
    µN/µm, and the RMS error of Cauchy–Born relative to the elastic stress, at Ḟ = 0."""

    name: str
    starts: int
    stable: int
    distinct: int
    largest_stress: float
    cauchy_born: float


QUANTITIES: tuple[Quantity[Measured], ...] = (
    Quantity("arrangement", "", "", lambda row: row.name),
    Quantity("random starts", "", "d", lambda row: row.starts),
    Quantity("stable", "", "d", lambda row: row.stable),
    Quantity("distinct equilibria", "", "d", lambda row: row.distinct),
    Quantity("largest stress among them", "µN/µm", ".3g", lambda row: row.largest_stress),
    Quantity("Cauchy–Born, RMS error", "%", ".3g", lambda row: 100.0 * row.cauchy_born),
)


def arrangements(setting: Setting) -> Study:
    """The table, and the relaxed references as a picture."""
    many = MEASURED[:2] if setting.quick else MEASURED
    rows = [measure(setting.of.cell, arrangement, cells) for arrangement, cells in many]
    return Study(
        title="Irregular plant cells at rest",
        drawing=picture(setting.of.cell),
        table=Table(QUANTITIES, rows),
    )


@cache
def law(cell: CellParameters, arrangement: str, cells: int, initialisation: str) -> RveLaw:
    """An RVE of so many plant cells, its reference found once."""
    cell = replace(cell, arrangement=arrangement, cells=cells)
    return RveLaw(cell, initialisation=initialisation)


def measure(cell: CellParameters, arrangement: str, cells: int) -> Measured:
    """Equilibria at the reference's rest length and box, from fluid put at random; Cauchy–Born."""
    this = law(cell, arrangement, cells, "elastic")
    starts = np.array([start_positions(this.cell, k, at_random=True) for k in range(2 * TILE)])
    found = equilibria_in(this.cell, this.reference.lattice, this.rest_length, starts)
    chosen = distinct(found)

    F = np.eye(2) + SIZE * np.random.default_rng(0).uniform(-1.0, 1.0, (POINTS, 2, 2))
    born, elastic = (
        law(cell, arrangement, cells, name).respond(F, np.zeros_like(F))
        for name in ("cauchy-born", "elastic")
    )
    both = (born.status == 0) & (elastic.status == 0)
    error, stress = (born.stress - elastic.stress)[both], elastic.stress[both]
    return Measured(
        name=f"{cells} {arrangement}",
        starts=len(starts),
        stable=int(found.stable.sum()),
        distinct=len(chosen),
        largest_stress=float(np.abs(found.stress[chosen]).max(initial=0.0)),
        cauchy_born=float(np.linalg.norm(error) / np.linalg.norm(stress)),
    )


def distinct(equilibria: Equilibria) -> list[int]:
    """One of each group of stable equilibria of one energy, by rising energy."""
    chosen: list[int] = []
    for k in np.argsort(np.where(equilibria.stable, equilibria.energy, np.inf), kind="stable"):
        if not equilibria.stable[k]:
            break
        energy = equilibria.energy[k]
        if not chosen or energy - equilibria.energy[chosen[-1]] > SAME_ENERGY * abs(energy):
            chosen.append(int(k))
    return chosen


def picture(cell: CellParameters) -> Figure:
    """The relaxed references with the copies around them, and the periodic boxes."""
    figure = Figure(figsize=(12.5, 3.2), layout="constrained")
    places = figure.subplots(1, len(SHOWN))
    still = np.zeros((1, 2, 2))
    all_seen = [law(cell, *each, "elastic").particles(np.eye(2)[None], still) for each in SHOWN]
    half = 0.6 * max(float(abs(seen.lattice).sum(axis=1).max()) for seen in all_seen)
    # one scale for all, by which they can be compared
    stretch = np.concatenate([seen.stretch[0] for seen in all_seen])
    pressure = np.concatenate([seen.pressure[0] for seen in all_seen])
    walls = Colours.of("wall length / rest length", stretch)
    fluid = Colours.of("fluid pressure (MPa)", pressure, "Blues")
    for axes, seen, (arrangement, cells) in zip(places, all_seen, SHOWN, strict=True):
        (_, lines), (_, inside) = draw_cells(axes, seen, 0, half)
        walls.paint(lines, lines.get_array())
        fluid.paint(inside, inside.get_array())
        first = seen.position[0][seen.is_wall].mean(axis=0) - 0.25 * seen.lattice.sum(axis=1)
        box = first + np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]) @ seen.lattice.T
        axes.plot(*box.T, "--", color=VERMILION, linewidth=1.2)
        name = arrangement.capitalize() if arrangement == "voronoi" else arrangement
        unit = "cell" if cells == 1 else "cells"
        axes.set_title(f"{cells} {name} {unit}\n{len(seen.is_wall)} particles", fontsize=9)
    fluid.bar(list(places), inside)
    walls.bar(list(places), lines)
    return figure

"""Irregular tissue: how large an RVE must be, and one pressure against particles.

Moduli at rest of Voronoi cells over the number of plant cells in an RVE: mean and scatter of
several seeds, and how far they are from isotropic. docs/validation/irregular.md has the tables.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.questions.moduli import cell_moduli
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from validation.case import Setting

Array = NDArray[np.float64]

SIZES = (4, 9, 25, 49)
"""Plant cells in an RVE."""
SEEDS = (1, 2, 3, 4, 5)
SPH_SEEDS = (1, 2)
"""Of nine Voronoi cells with SPH fluid, whose reference state takes half a minute and more."""
_MANDEL = np.array([1.0, 1.0, np.sqrt(2.0)])
_DILATION = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)


@dataclass(frozen=True, slots=True)
class Isotropic:
    """The nearest isotropic moduli of a matrix C, µN/µm, and the rest of C over all of it."""

    bulk: float
    shear: float
    anisotropy: float


def nearest_isotropic(C: Array) -> Isotropic:
    """Moduli K and G of the isotropic matrix nearest to C (3, 3) in Voigt's order.

    In Mandel's form, in which rotations are orthogonal, C = 2 K J + 2 G (I − J) + rest with J the
    dilation's projection. K and G do not depend on the axes, and neither does |rest|/|C|.
    """
    mandel = C * np.outer(_MANDEL, _MANDEL)
    J = np.outer(_DILATION, _DILATION)
    twice_K = float(np.sum(J * mandel))
    twice_G = 0.5 * (float(np.trace(mandel)) - twice_K)
    nearest = twice_K * J + twice_G * (np.eye(3) - J)
    rest = float(np.linalg.norm(mandel - nearest) / np.linalg.norm(mandel))
    return Isotropic(0.5 * twice_K, 0.5 * twice_G, rest)


@dataclass(frozen=True, slots=True)
class Measured:
    """Moduli of an arrangement over its seeds, (s,) each."""

    arrangement: str
    fluid: str
    cells: int
    bulk: Array
    shear: Array
    anisotropy: Array

    @property
    def name(self) -> str:
        """How tables name it."""
        return f"{self.cells} {self.arrangement}"


def scatter(values: Array) -> float | None:
    """Standard deviation over the mean, %; None of a single value."""
    if len(values) < 2:
        return None
    return 100.0 * float(values.std(ddof=1) / values.mean())


QUANTITIES: tuple[Quantity[Measured], ...] = (
    Quantity("plant cells", "", "", lambda row: row.name),
    Quantity("fluid", "", "", lambda row: row.fluid),
    Quantity("seeds", "", "d", lambda row: len(row.bulk)),
    Quantity("K", "µN/µm", ".4g", lambda row: row.bulk.mean()),
    Quantity("scatter of K", "%", ".2g", lambda row: scatter(row.bulk)),
    Quantity("G", "µN/µm", ".4g", lambda row: row.shear.mean()),
    Quantity("scatter of G", "%", ".2g", lambda row: scatter(row.shear)),
    Quantity("anisotropy", "%", ".2g", lambda row: 100.0 * row.anisotropy.mean()),
    Quantity("largest", "%", ".2g", lambda row: 100.0 * row.anisotropy.max()),
)


def measure(cell: CellParameters, seeds: tuple[int, ...]) -> Measured:
    """The moduli at rest of an arrangement's seeds; squares and hexagons have one."""
    found = []
    for seed in seeds:
        print(f"{cell.cells} {cell.arrangement}, {cell.fluid}, seed {seed}", flush=True)
        moduli = cell_moduli(replace(cell, arrangement_seed=seed), "elastic")
        found.append(nearest_isotropic(moduli.elastic))
    return Measured(
        arrangement=cell.arrangement,
        fluid=cell.fluid,
        cells=cell.cells,
        bulk=np.array([each.bulk for each in found]),
        shear=np.array([each.shear for each in found]),
        anisotropy=np.array([each.anisotropy for each in found]),
    )


def irregular(setting: Setting) -> Study:
    """Voronoi cells of every size and seed; squares, hexagons and Voronoi cells by both fluids."""
    cell = setting.of.cell
    sizes = setting.sizes or (SIZES[:2] if setting.quick else SIZES)
    seeds = SEEDS[:2] if setting.quick else SEEDS
    by_size = [measure(_arranged(cell, "voronoi", "uniform", n), seeds) for n in sizes]
    regular = [
        measure(_arranged(cell, arrangement, fluid, 1), (1,))
        for arrangement in ("square", "hexagon")
        for fluid in ("uniform", "sph")
    ]
    of_particles = []
    # SPH fluid of living Voronoi cells comes to no rest.
    if not setting.quick and setting.of.name in ("printed", "water"):
        of_particles = [measure(_arranged(cell, "voronoi", "sph", 9), SPH_SEEDS)]
    return Study(
        title="Moduli of irregular tissue over the plant cells of an RVE",
        panels=(
            _panel("bulk modulus (µN/µm)", [(row.cells, row.bulk) for row in by_size]),
            _panel("shear modulus (µN/µm)", [(row.cells, row.shear) for row in by_size]),
            _panel("anisotropy (%)", [(row.cells, 100.0 * row.anisotropy) for row in by_size]),
        ),
        columns=3,
        table=Table(QUANTITIES, [*by_size, *regular, *of_particles]),
    )


def _arranged(cell: CellParameters, arrangement: str, fluid: str, cells: int) -> CellParameters:
    """The plant cell in another arrangement and with another fluid of the same turgor.

    Where a preset has a sound speed for each fluid, it is the preset's.
    """
    for name in ("apple", "potato"):
        if cell == CellParameters.preset(name):
            cell = CellParameters.preset(name, fluid=fluid)
    return replace(cell, arrangement=arrangement, fluid=fluid, cells=cells)


def _panel(label: str, values: list[tuple[int, Array]]) -> Panel:
    """Values of all seeds and their mean over the plant cells in an RVE."""
    cells = np.array([float(n) for n, _ in values])
    mean = Curve("mean of the seeds", cells, np.array([each.mean() for _, each in values]))
    each_seed = tuple(
        Curve(f"seed {SEEDS[k]}", cells, np.array([each[k] for _, each in values]))
        for k in range(len(values[0][1]))
    )
    return Panel("plant cells in an RVE", label, (mean, *each_seed), x_ticks=tuple(cells))

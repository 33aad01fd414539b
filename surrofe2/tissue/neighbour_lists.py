"""Lists of the pairs that may interact, tile by tile, made from where the particles are now.

A pair kind is listed for a tile if in any of its lanes the two particles are within the list's
reach: the cut-off and a skin. Partners in other plant cells become images, local particles that
follow the own ones; they are gathered before forces are summed, and what they feel is folded back
to their owners by a list that each owner reads alone, so that threads never meet.

With ū the mean displacement of a cell's own particles since the listing, and d the largest
|u − ū| anywhere, particles of neighbouring cells A and B have moved against one another by at most
2 d + |ū_B − ū_A|. While that is within the skin everywhere, and as particles of cells k columns or
rows apart are listed up to the cut-off and k skins, no unlisted pair is within the cut-off.
"""

from __future__ import annotations

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.errors import SimulationError
from surrofe2.simd import TILE
from surrofe2.tissue.layout import Tissue
from surrofe2.tissue.list_assembly import Grid, Lists, assemble
from surrofe2.tissue.pair_kinds import RINGS, PairKinds, make_pair_kinds

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


def make_grid(tissue: Tissue, kinds: PairKinds) -> Grid:
    """Who is whose neighbour."""
    column = tissue.column[:, None] + kinds.shifts[:, 0]
    row = tissue.row[:, None] + kinds.shifts[:, 1]
    n, m = tissue.place.shape
    wrap = np.zeros((*column.shape, 2))
    if tissue.periodic:
        wrap[..., 0], column = np.divmod(column, n)
        wrap[..., 1], row = np.divmod(row, m)
    inside = (column >= 0) & (column < n) & (row >= 0) & (row < m)
    inside &= (tissue.column >= 0)[:, None]
    place = np.where(
        inside, tissue.place[np.where(inside, column, 0), np.where(inside, row, 0)], -1
    )
    exists = tissue.exists.astype(np.float64)
    count = exists.sum(axis=1)
    return Grid(
        place=_tiled(place),
        wrap=_tiled(wrap),
        exists=exists,
        per_count=np.where(count > 0, 1.0 / np.maximum(count, 1.0), 0.0),
        next_shifts=np.flatnonzero(abs(kinds.shifts).max(axis=1) == 1),
    )


def _tiled(values: NDArray) -> NDArray:
    """(places, …) → (tiles, …, TILE)."""
    return np.ascontiguousarray(np.moveaxis(values.reshape(-1, TILE, *values.shape[1:]), 1, -1))


class Lister:
    """Makes `Lists` for one tissue."""

    def __init__(self, tissue: Tissue, skin: float) -> None:
        self._tissue = tissue
        self._skin = skin
        self.kinds = make_pair_kinds(tissue.cell)
        rings = abs(self.kinds.shifts).max(axis=1)[self.kinds.shift]
        self._reach = tissue.cell.repulsion_cutoff + skin * np.maximum(rings, 1)
        self.grid = make_grid(tissue, self.kinds)
        self._share = pair_shares(tissue, self.kinds, self.grid)

    def make(self, x: Array, lattice: Array) -> Lists:
        """Lists at positions x (tiles, 2, own, TILE) with periods `lattice` (2, 2), µm.

        Raises:
            SimulationError: positions are not finite, or plant cells with two others between
                them come so close that lists could miss a pair.
        """
        kinds = self.kinds
        self._check_apart(x)
        close = np.zeros((len(x), len(kinds.i)), dtype=np.bool_)
        mark_close(
            x, kinds.i, kinds.j, kinds.shift, self._reach, self.grid.place, self.grid.wrap,
            lattice, close,
        )  # fmt: skip
        close[:, : kinds.bonds] = True
        return assemble(self._tissue, kinds, self.grid, self._share, close, self._skin)

    def _check_apart(self, x: Array) -> None:
        """Plant cells further apart than RINGS must be out of each other's reach."""
        grid, tissue = self.grid, self._tissue
        if not np.isfinite(x).all():
            raise SimulationError("tissue: positions are not finite; lower tissue.micro_step")
        weight = grid.exists * grid.per_count[:, None]
        centre = (x * weight[:, None]).sum(axis=2)
        extent = np.hypot(*np.moveaxis((x - centre[:, :, None]) * grid.exists[:, None], 1, 0)).max()
        if tissue.periodic:
            return
        there = tissue.column >= 0
        centres = np.moveaxis(centre, 1, 2).reshape(-1, 2)[there]
        at = np.stack([tissue.column, tissue.row], axis=1)[there]
        near = tissue.cell.repulsion_cutoff + 2.0 * extent
        pairs = cKDTree(centres).query_pairs(near + self._skin * at.max(), output_type="ndarray")
        i, j = pairs.T
        rings = abs(at[i] - at[j]).max(axis=1)
        distance = np.hypot(*(centres[i] - centres[j]).T)
        if (distance < near + self._skin * rings)[rings > RINGS].any():
            raise SimulationError(
                f"tissue: plant cells with {RINGS} others between them come within reach of each "
                "other; the tissue has collapsed: lower the load or tissue.micro_step"
            )


def pair_shares(tissue: Tissue, kinds: PairKinds, grid: Grid) -> Array:
    """(tiles, bonds + lines, TILE): 1, ½ on the tissue's boundary, 0 where a particle lacks."""
    kinds_on_lines = kinds.bonds + kinds.lines
    axis, line = kinds.line[:kinds_on_lines].T
    exists = np.moveaxis(tissue.exists, 1, 2).reshape(-1, tissue.own)
    share = np.zeros((len(tissue.column), kinds_on_lines))
    place = np.moveaxis(grid.place, 1, 2).reshape(-1, len(kinds.shifts))
    for k in range(kinds_on_lines):
        there = place[:, kinds.shift[k]]
        share[:, k] = exists[:, kinds.i[k]] & (there >= 0) & exists[there, kinds.j[k]]
        if not tissue.periodic:
            across = (tissue.row if axis[k] == 0 else tissue.column) + line[k]
            outer = (across == 0) | (across == tissue.cells[1 - axis[k]])
            share[outer, k] *= 0.5
    return np.ascontiguousarray(
        np.moveaxis(share.reshape(tissue.tiles, TILE, kinds_on_lines), 1, -1)
    )


def bonded_particles(tissue: Tissue) -> Ints:
    """(b, 2) numbers of the particles that wall springs join."""
    kinds = make_pair_kinds(tissue.cell)
    place = make_grid(tissue, kinds).place
    number = np.full(tissue.mass.size, -1)
    number[tissue.where] = np.arange(tissue.particles)
    tile, lane = np.indices((tissue.tiles, TILE))
    pairs = []
    for k in range(kinds.bonds):
        there = place[:, kinds.shift[k]]
        first = number[(tile * tissue.own + kinds.i[k]) * TILE + lane]
        flat = (there // TILE * tissue.own + kinds.j[k]) * TILE + there % TILE
        second = np.where(there >= 0, number[np.where(there >= 0, flat, 0)], -1)
        both = (first >= 0) & (second >= 0)
        pairs.append(np.stack([first[both], second[both]], axis=1))
    return np.concatenate(pairs)


@parallel_kernel
def mark_close(x, i, j, shift, reach, place, wrap, lattice, close):
    """close (tiles, kinds): whether any lane has that pair within its `reach`."""
    for t in numba.prange(x.shape[0]):
        _mark_close_in_tile(t, x, i, j, shift, reach, place[t], wrap[t], lattice, close[t])


@kernel
def _mark_close_in_tile(t, x, i, j, shift, reach, place, wrap, lattice, close):
    for k in range(i.shape[0]):
        s = shift[k]
        for lane in range(TILE):
            there = place[s, lane]
            if there < 0:
                continue
            tile, other = there // TILE, there % TILE
            rx = x[tile, 0, j[k], other] - x[t, 0, i[k], lane]
            ry = x[tile, 1, j[k], other] - x[t, 1, i[k], lane]
            rx += lattice[0, 0] * wrap[s, 0, lane] + lattice[0, 1] * wrap[s, 1, lane]
            ry += lattice[1, 0] * wrap[s, 0, lane] + lattice[1, 1] * wrap[s, 1, lane]
            if rx * rx + ry * ry <= reach[k] * reach[k]:
                close[k] = True
                break

"""Layout of the arrays of kernels: plant cells as SIMD lanes, and the constants kernels need.

Structure of arrays, cells last, in tiles of `TILE` cells. Cells of one topology share the pair
lists, so a pair is computed for a whole tile at once with neither gather nor branch::

    x[tile, axis, particle, lane]    axis: 0, 1    particle: own 0..n-1, then images    lane: a cell

Within kernels, arrays of one tile lack the first index.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.block_pattern import Pattern
from surrofe2.plant_cell.pair_lists import Patch
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.simd import TILE


class Constants(NamedTuple):
    """What the pair laws need of `CellParameters`, ready for use in kernels (µm, µs, ng)."""

    wall_stiffness: float
    rest_length: float
    wall_damping: float
    repulsion: float
    cutoff: float
    contact_damping: float
    smoothing_length: float
    fluid_mass: float
    sound_speed_squared: float
    viscosity: float


class Topology(NamedTuple):
    """Pair lists of a `Patch` for kernels; its matrices are dense.

    fluid_start, fluid_pair_start: (cells + 1,) where each plant cell's fluid and pairs begin.
    """

    bonds: NDArray[np.int32]
    contacts: NDArray[np.int32]
    fluid_pairs: NDArray[np.int32]
    owner: NDArray[np.int32]
    image_offset: NDArray[np.float64]
    particles: int
    walls: int
    fluid_start: NDArray[np.int32]
    fluid_pair_start: NDArray[np.int32]


class SparseTopology(NamedTuple):
    """A `Topology` and the `Pattern` of its matrices in one: numba takes no tuple of tuples."""

    bonds: NDArray[np.int32]
    contacts: NDArray[np.int32]
    fluid_pairs: NDArray[np.int32]
    owner: NDArray[np.int32]
    image_offset: NDArray[np.float64]
    particles: int
    walls: int
    fluid_start: NDArray[np.int32]
    fluid_pair_start: NDArray[np.int32]
    group: NDArray[np.int32]
    place: NDArray[np.int32]
    row_start: NDArray[np.int64]
    first: NDArray[np.int32]
    width: NDArray[np.int32]
    offset: NDArray[np.int32]
    start: NDArray[np.int64]
    lower: NDArray[np.int32]
    lower_start: NDArray[np.int32]
    upper: NDArray[np.int32]
    upper_start: NDArray[np.int32]
    unknown: NDArray[np.int32]
    size: int


def make_constants(cell: CellParameters, rest_length: float) -> Constants:
    """Constants of eqs. (1), (2), (8), (9) for one set of parameters."""
    m, k, strength = cell.wall_particle_mass, cell.wall_stiffness, cell.repulsion_strength
    return Constants(
        wall_stiffness=k,
        rest_length=float(rest_length),
        wall_damping=cell.wall_damping_ratio * 2.0 * np.sqrt(m * k),
        repulsion=strength,
        cutoff=cell.repulsion_cutoff,
        contact_damping=cell.contact_damping_ratio * 2.0 * np.sqrt(6.0 * strength * m),
        smoothing_length=cell.smoothing_length,
        fluid_mass=cell.fluid_mass,
        sound_speed_squared=cell.sound_speed**2,
        viscosity=cell.viscosity,
    )


def make_topology(patch: Patch) -> Topology:
    """Kernel form of a patch, with dense matrices."""
    counts = np.diff(patch.fluid_start).astype(np.int64)
    return Topology(
        bonds=patch.bonds,
        contacts=patch.contacts,
        fluid_pairs=patch.fluid_pairs,
        owner=patch.owner,
        image_offset=np.ascontiguousarray(patch.shift @ patch.lattice.T),
        particles=patch.particles,
        walls=patch.walls,
        fluid_start=patch.fluid_start,
        fluid_pair_start=np.append(0, np.cumsum(counts * (counts - 1) // 2)).astype(np.int32),
    )


def make_sparse(topology: Topology, pattern: Pattern) -> SparseTopology:
    """The same with sparse matrices."""
    return SparseTopology(**topology._asdict(), **pattern._asdict())


def tiles_for(points: int) -> int:
    """Number of tiles that hold `points` cells."""
    return -(-points // TILE)


def pack(values: NDArray[Any]) -> NDArray[Any]:
    """(n, …) → (tiles, …, TILE); the last tile is filled up with copies of the last point."""
    n = len(values)
    if n % TILE:
        values = values[np.minimum(np.arange(tiles_for(n) * TILE), n - 1)]
    tiles = values.reshape(-1, TILE, *values.shape[1:])
    return np.ascontiguousarray(tiles.transpose(0, *range(2, tiles.ndim), 1))


def unpack(tiles: NDArray[Any], points: int) -> NDArray[Any]:
    """(tiles, …, TILE) → (n, …); inverse of `pack`."""
    lanes = tiles.transpose(0, tiles.ndim - 1, *range(1, tiles.ndim - 1))
    return np.ascontiguousarray(lanes.reshape(-1, *lanes.shape[2:])[:points])


def put_points(tiles: NDArray[Any], index: NDArray[np.intp], part: NDArray[Any]) -> None:
    """Overwrite the points `index` of packed `tiles` by the first points of packed `part`."""
    tile, lane = np.divmod(index, TILE)
    from_tile, from_lane = np.divmod(np.arange(len(index)), TILE)
    tiles[tile, ..., lane] = part[from_tile, ..., from_lane]

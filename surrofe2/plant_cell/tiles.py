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

from surrofe2.compilation import kernel
from surrofe2.plant_cell.block_pattern import Pattern, make_pattern
from surrofe2.plant_cell.pair_lists import Patch
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.simd import TILE

Reals = NDArray[np.float64]
Ints = NDArray[np.int32]


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
    """Pair lists of a `Patch`.

    fluid_start, fluid_pair_start: (cells + 1,) where each plant cell's fluid and pairs begin.
    """

    bonds: Ints
    contacts: Ints
    fluid_pairs: Ints
    owner: Ints
    image_offset: Reals
    particles: int
    walls: int
    fluid_start: Ints
    fluid_pair_start: Ints


class RveTopology(NamedTuple):
    """A `Topology`, its area and the `Pattern` of its matrices: numba takes no tuple of tuples.

    area: of the reference, µm².
    """

    bonds: Ints
    contacts: Ints
    fluid_pairs: Ints
    owner: Ints
    image_offset: Reals
    particles: int
    walls: int
    fluid_start: Ints
    fluid_pair_start: Ints
    area: float
    group: Ints
    column: Ints
    first: Ints
    width: Ints
    start: Ints
    offset: Ints
    lower: Ints
    lower_start: Ints
    upper: Ints
    upper_start: Ints
    block: Ints
    stride: Ints
    size: int


class Workspace(NamedTuple):
    """Scratch of one tile: local material positions z, x, v, f (2, local, TILE), and its fluid.

    slope: (pairs, TILE) W′/|r| of fluid pairs; volume: (fluid, TILE) 1/ρ.
    """

    z: Reals
    x: Reals
    v: Reals
    f: Reals
    slope: Reals
    volume: Reals


@kernel
def make_workspace(topology):
    """Uninitialised scratch for one tile."""
    local = topology.particles + topology.owner.shape[0]
    return Workspace(
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((topology.fluid_pairs.shape[0], TILE)),
        np.empty((topology.particles - topology.walls, TILE)),
    )


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


def make_topology(patch: Patch, pattern: Pattern | None = None) -> RveTopology:
    """Kernel form of a patch; matrices are dense, one group of all particles, unless it is said."""
    counts = np.diff(patch.fluid_start).astype(np.int64)
    contiguous = np.ascontiguousarray  # kernels are compiled for one layout
    lists = Topology(
        bonds=contiguous(patch.bonds),
        contacts=contiguous(patch.contacts),
        fluid_pairs=contiguous(patch.fluid_pairs),
        owner=contiguous(patch.owner),
        image_offset=contiguous(patch.shift @ patch.lattice.T),
        particles=patch.particles,
        walls=patch.walls,
        fluid_start=contiguous(patch.fluid_start),
        fluid_pair_start=np.append(0, np.cumsum(counts * (counts - 1) // 2)).astype(np.int32),
    )
    if pattern is None:
        pattern = make_pattern(np.zeros(patch.particles, dtype=np.int32), [])
    return RveTopology(**lists._asdict(), area=patch.area, **pattern._asdict())


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

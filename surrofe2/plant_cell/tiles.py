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

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import TILE
from surrofe2.plant_cell.parameters import CellParameters

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
    """Who interacts, by local indices; at its end, how matrices lie, which is a `Pattern`.

    Its fields are repeated here, for parallel kernels do not accept a tuple within a tuple.

    bonds, contacts, fluid_pairs: (·, 2) local i, j, the first an own particle.
    bond_weight, contact_weight: (·,) part of a pair's force and damping that acts: ½ where one of
        the two walls is missing, along a slab's outer walls.
    particles, of which `walls` come first: own.
    owner, image_offset: (g,) own particle of each image, (g, 2) µm from there to it; image k has
        the local index particles + k.
    fluid_start, fluid_pair_start: (cells + 1,) where each plant cell's fluid, counted from the
        first of all, and its pairs begin.
    area: of the reference, µm².
    """

    bonds: Ints
    contacts: Ints
    fluid_pairs: Ints
    bond_weight: Reals
    contact_weight: Reals
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

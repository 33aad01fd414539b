"""Elastic energy of a tissue, of which the forces at rest are the negative gradient."""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.forces import add_central_energy, fluid_specific_volume
from surrofe2.simd import TILE, store


@parallel_kernel
def stored_energy(x, lists, grid, fluid, c, energy):
    """energy (tiles, TILE): springs ½ k (|r| − l₀)², contacts, fluid Σ m c_s² ln ρ, in pJ.

    x: (tiles + 1, 2, local, TILE) with images set.
    """
    for t in numba.prange(energy.shape[0]):
        _stored_in_tile(t, x, lists, grid, fluid, c, energy)


@kernel
def _stored_in_tile(t, x, lists, grid, fluid, c, energy):
    here, end = lists.starts[t], lists.starts[t + 1]
    mine = energy[t : t + 1]
    store(0.0, mine, 0)
    rows = slice(here[1], end[1])
    add_central_energy(x[t], lists.bonds[rows], lists.bond_share[rows], True, c, mine)
    rows = slice(here[2], end[2])
    add_central_energy(x[t], lists.lines[rows], lists.line_share[rows], False, c, mine)
    add_central_energy(x[t], lists.contacts[here[3] : end[3]], None, False, c, mine)
    if t < lists.fluid_tiles:
        _add_fluid(x[t], grid.exists[t], fluid, c, energy[t])


@kernel
def _add_fluid(x, exists, fluid, c, energy):
    slope = np.empty((fluid.fluid_pairs.shape[0], TILE))
    volume = np.empty((fluid.particles - fluid.walls, TILE))
    fluid_specific_volume(x, fluid, c, slope, volume)
    for p in range(volume.shape[0]):
        for lane in range(TILE):
            mass = exists[fluid.walls + p, lane] * c.fluid_mass
            energy[lane] -= mass * c.sound_speed_squared * np.log(volume[p, lane])

"""Elastic energy of a tissue, of which the forces at rest are the negative gradient."""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.plant_cell.contact import contact_energy
from surrofe2.plant_cell.forces import difference, fluid_specific_volume
from surrofe2.plant_cell.simd import TILE, inverse_root, load, spread, store
from surrofe2.plant_cell.wall import wall_energy


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
    store(0.0, energy, t)
    bonds, lines = slice(here[1], end[1]), slice(here[2], end[2])
    _add_bonds(x[t], lists.bonds[bonds], lists.bond_share[bonds], c, energy, t)
    _add_shared_contacts(x[t], lists.lines[lines], lists.line_share[lines], c, energy, t)
    _add_contacts(x[t], lists.contacts[here[3] : end[3]], c, energy, t)
    if t < lists.fluid_tiles:
        _add_fluid(x[t], grid.exists[t], fluid, c, energy[t])


@kernel
def _add_bonds(x, bonds, share, c, energy, t):
    total = spread(0.0)
    for k in range(bonds.shape[0]):
        rx, ry = difference(x, bonds[k, 0], bonds[k, 1])
        square = rx * rx + ry * ry
        total += load(share, k) * wall_energy(square * inverse_root(square), c)
    store(load(energy, t) + total, energy, t)


@kernel
def _add_shared_contacts(x, contacts, share, c, energy, t):
    total = spread(0.0)
    for k in range(contacts.shape[0]):
        rx, ry = difference(x, contacts[k, 0], contacts[k, 1])
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        total += load(share, k) * contact_energy(square * inverse, inverse, c)
    store(load(energy, t) + total, energy, t)


@kernel
def _add_contacts(x, contacts, c, energy, t):
    total = spread(0.0)
    for k in range(contacts.shape[0]):
        rx, ry = difference(x, contacts[k, 0], contacts[k, 1])
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        total += contact_energy(square * inverse, inverse, c)
    store(load(energy, t) + total, energy, t)


@kernel
def _add_fluid(x, exists, fluid, c, energy):
    slope = np.empty((fluid.fluid_pairs.shape[0], TILE))
    volume = np.empty((fluid.particles - fluid.walls, TILE))
    fluid_specific_volume(x, fluid, c, slope, volume)
    for p in range(volume.shape[0]):
        for lane in range(TILE):
            mass = exists[fluid.walls + p, lane] * c.fluid_mass
            energy[lane] -= mass * c.sound_speed_squared * np.log(volume[p, lane])

"""Particle forces of a tile of plant cells: the pair laws of eqs. (1), (2), (8) summed up.

Kernels work on local particles, own ones first, then images: x, v, f are (2, local, TILE) in µm,
µm/µs, µN. `fold_images` adds what images feel to their owners.
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel, pair_law
from surrofe2.plant_cell.contact import contact_energy, contact_force
from surrofe2.plant_cell.fluid import fluid_coefficients
from surrofe2.plant_cell.simd import TILE, inverse_root, load, spread, store
from surrofe2.plant_cell.sph_kernel import spline, spline_slope
from surrofe2.plant_cell.wall import wall_energy, wall_force


@pair_law
def difference(x, i, j):
    """x_j − x_i, both components."""
    return load(x, 0, j) - load(x, 0, i), load(x, 1, j) - load(x, 1, i)


@pair_law
def add_pair(f, i, j, fx, fy):
    """f on i, −f on j."""
    store(load(f, 0, i) + fx, f, 0, i)
    store(load(f, 1, i) + fy, f, 1, i)
    store(load(f, 0, j) - fx, f, 0, j)
    store(load(f, 1, j) - fy, f, 1, j)


@kernel
def add_bond_forces(x, v, f, bonds, c):
    """Add wall tensions (eq. 1) to f."""
    for k in range(bonds.shape[0]):
        i, j = bonds[k, 0], bonds[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        a = wall_force(square * inverse, (rx * wx + ry * wy) * inverse, c) * inverse
        add_pair(f, i, j, a * rx, a * ry)


@kernel
def add_contact_forces(x, v, f, contacts, c):
    """Add contact repulsion (eq. 2) to f."""
    for k in range(contacts.shape[0]):
        i, j = contacts[k, 0], contacts[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        rate = (rx * wx + ry * wy) * inverse
        a = contact_force(square * inverse, inverse, rate, c) * inverse
        add_pair(f, i, j, a * rx, a * ry)


@kernel
def add_fluid_forces(x, v, f, topology, c, slope, volume):
    """Add pressure and viscous forces (eq. 8) to f.

    Scratch, filled here: slope (pairs, TILE) W′/|r|; volume (fluid, TILE) 1/ρ.
    """
    pairs, first = topology.fluid_pairs, topology.walls
    fluid_specific_volume(x, topology, c, slope, volume)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        volume_i, volume_j = load(volume, i - first), load(volume, j - first)
        a, b = fluid_coefficients(load(slope, k), volume_i, volume_j, c)
        add_pair(f, i, j, a * rx + b * wx, a * ry + b * wy)


@kernel
def fluid_specific_volume(x, topology, c, slope, volume):
    """volume = 1/ρ of eq. (7) and slope = W′/|r| of every fluid pair."""
    pairs, first = topology.fluid_pairs, topology.walls
    h = c.smoothing_length
    own = c.fluid_mass * spline(spread(0.0), h)
    for p in range(volume.shape[0]):
        store(own, volume, p)
    for k in range(pairs.shape[0]):
        p, q = pairs[k, 0] - first, pairs[k, 1] - first
        rx, ry = difference(x, pairs[k, 0], pairs[k, 1])
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        s = square * inverse * (1.0 / h)
        store(spline_slope(s, h) * inverse, slope, k)
        density = c.fluid_mass * spline(s, h)
        store(load(volume, p) + density, volume, p)
        store(load(volume, q) + density, volume, q)
    for p in range(volume.shape[0]):
        store(1.0 / load(volume, p), volume, p)


@kernel
def add_forces(x, v, f, topology, c, slope, volume):
    """Add all forces on local particles to f."""
    add_bond_forces(x, v, f, topology.bonds, c)
    add_contact_forces(x, v, f, topology.contacts, c)
    add_fluid_forces(x, v, f, topology, c, slope, volume)


@kernel
def fold_images(f, topology):
    """Add the forces on images to their owners; own particles then feel the whole force."""
    own = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        store(load(f, 0, i) + load(f, 0, own + k), f, 0, i)
        store(load(f, 1, i) + load(f, 1, own + k), f, 1, i)


@kernel
def elastic_energy(x, topology, c, energy):
    """energy (1, TILE): stored energy of bonds, contacts and fluid (Σ m c_s² ln ρ), pJ."""
    slope = np.empty((topology.fluid_pairs.shape[0], TILE))
    volume = np.empty((topology.particles - topology.walls, TILE))
    fluid_specific_volume(x, topology, c, slope, volume)
    total = spread(0.0)
    for k in range(topology.bonds.shape[0]):
        rx, ry = difference(x, topology.bonds[k, 0], topology.bonds[k, 1])
        square = rx * rx + ry * ry
        total += wall_energy(square * inverse_root(square), c)
    for k in range(topology.contacts.shape[0]):
        rx, ry = difference(x, topology.contacts[k, 0], topology.contacts[k, 1])
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        total += contact_energy(square * inverse, inverse, c)
    store(total, energy, 0)
    for p in range(volume.shape[0]):
        for lane in range(TILE):
            energy[0, lane] -= c.fluid_mass * c.sound_speed_squared * np.log(volume[p, lane])

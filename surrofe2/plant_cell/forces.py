"""Forces of a tile of plant cells: eqs. (1), (2), (8) summed up.

Kernels work on local particles, own ones first, then images: x, v, f are (2, local, TILE) in µm,
µm/µs, µN. `fold_images` adds what images feel to their owners. A central pair is a bond between
wall neighbours (eq. 1) or a contact (eq. 2); `is_bond` is the same for all pairs of a list.
Tension t > 0 pulls the two together; the force on i is t n, n = r/|r|.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, inverse_root, load, spread, store
from surrofe2.plant_cell.pair_laws import (
    contact,
    contact_energy,
    fluid_coefficients,
    spline,
    spline_slope,
    tension,
    wall,
    wall_energy,
    within,
)

# Pairs and their sums


class Workspace(NamedTuple):
    """Scratch of one tile: local material positions z, x, v, f (2, local, TILE), and its fluid.

    slope: (pairs, TILE) W′/|r| of fluid pairs; volume: (fluid, TILE) 1/ρ.
    """

    z: Array
    x: Array
    v: Array
    f: Array
    slope: Array
    volume: Array


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


class Pair(NamedTuple):
    """r = x_j − x_i and w = v_j − v_i, lanes each.

    length is |r|, inverse 1/|r|, (nx, ny) = r/|r|, rate n·w.
    """

    rx: float
    ry: float
    wx: float
    wy: float
    nx: float
    ny: float
    length: float
    inverse: float
    rate: float


@pair_law
def difference(x, i, j):
    """x_j − x_i, both components."""
    return load(x, 0, j) - load(x, 0, i), load(x, 1, j) - load(x, 1, i)


@pair_law
def norm(rx, ry):
    """(|r|, 1/|r|)."""
    square = rx * rx + ry * ry
    inverse = inverse_root(square)
    return square * inverse, inverse


@pair_law
def pair_at(x, v, i, j):
    """The `Pair` of particles i and j; what a kernel does not use of it costs nothing."""
    rx, ry = difference(x, i, j)
    wx, wy = difference(v, i, j)
    length, inverse = norm(rx, ry)
    rate = (rx * wx + ry * wy) * inverse
    return Pair(rx, ry, wx, wy, rx * inverse, ry * inverse, length, inverse, rate)


@pair_law
def add_pair(f, i, j, fx, fy):
    """f on i, −f on j."""
    store(load(f, 0, i) + fx, f, 0, i)
    store(load(f, 1, i) + fy, f, 1, i)
    store(load(f, 0, j) - fx, f, 0, j)
    store(load(f, 1, j) - fy, f, 1, j)


@pair_law
def central_law(pair, is_bond, weight, c):
    """Weight that acts, and (t, ∂t/∂|r|, γ, ∂γ/∂|r|): the tension is that times t + γ n·w.

    t alone is elastic. One weight for all of them is 0 beyond the cut-off: one selection of lanes.
    """
    if is_bond:
        elastic, stiffness, damping, _ = wall(pair.length, c)
        law = elastic, spread(stiffness), spread(damping), spread(0.0)
        acting = spread(weight)
    else:
        law = contact(pair.length, pair.inverse, c)
        acting = within(pair.length, weight, c)
    return acting, law


@kernel
def add_central_forces(x, v, f, pairs, weight, is_bond, c):
    """Add wall tensions (eq. 1) or contact repulsion (eq. 2) to f.

    weight (pairs,) scales the whole force of a pair: ½ where one of the two walls is missing
    (docs/theory.md, walls at a free boundary); c(r) keeps the parameter m_wall.
    """
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(x, v, i, j)
        acting, law = central_law(pair, is_bond, weight[k], c)
        a = acting * pair.inverse * tension(law, pair.rate)
        add_pair(f, i, j, a * pair.rx, a * pair.ry)


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
        length, inverse = norm(rx, ry)
        s = length * (1.0 / h)
        store(spline_slope(s, h) * inverse, slope, k)
        density = c.fluid_mass * spline(s, h)
        store(load(volume, p) + density, volume, p)
        store(load(volume, q) + density, volume, q)
    for p in range(volume.shape[0]):
        store(1.0 / load(volume, p), volume, p)


@kernel
def local_forces(work, topology, c):
    """work.f at work.x and work.v: forces on own particles and, not yet folded, on images."""
    work.f[:] = 0.0
    x, v, f = work.x, work.v, work.f
    add_central_forces(x, v, f, topology.bonds, topology.bond_weight, True, c)
    add_central_forces(x, v, f, topology.contacts, topology.contact_weight, False, c)
    add_fluid_forces(x, v, f, topology, c, work.slope, work.volume)


@kernel
def fold_images(f, topology):
    """Add the forces on images to their owners; own particles then feel the whole force."""
    own = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        store(load(f, 0, i) + load(f, 0, own + k), f, 0, i)
        store(load(f, 1, i) + load(f, 1, own + k), f, 1, i)


@kernel
def add_central_energy(x, pairs, weight, is_bond, c, energy):
    """Add the stored energy of bonds or contacts, pJ, to energy (1, TILE); weight as above."""
    total = spread(0.0)
    for k in range(pairs.shape[0]):
        rx, ry = difference(x, pairs[k, 0], pairs[k, 1])
        length, inverse = norm(rx, ry)
        energy_of = wall_energy(length, c) if is_bond else contact_energy(length, inverse, c)
        total += weight[k] * energy_of
    store(load(energy, 0) + total, energy, 0)


@kernel
def elastic_energy(work, topology, c, energy):
    """energy (1, TILE) at work.x: of bonds, contacts and fluid, Σ m c_s² ln ρ, pJ."""
    x, volume = work.x, work.volume
    store(0.0, energy, 0)
    add_central_energy(x, topology.bonds, topology.bond_weight, True, c, energy)
    add_central_energy(x, topology.contacts, topology.contact_weight, False, c, energy)
    fluid_specific_volume(x, topology, c, work.slope, volume)
    for p in range(volume.shape[0]):
        for lane in range(TILE):
            energy[0, lane] -= c.fluid_mass * c.sound_speed_squared * np.log(volume[p, lane])

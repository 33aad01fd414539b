"""Particle forces of many plant cells at once: the pair laws of eqs. (1), (2), (8) summed up.

Layout in `lanes`. Every kernel works on local particles (own ones, then images); `fold_images`
adds what images feel to their owners.
"""

from __future__ import annotations

import numpy as np

from surrofe2.plant_cell.contact import contact_energy, contact_force
from surrofe2.plant_cell.fluid import fluid_coefficients
from surrofe2.plant_cell.lanes import kernel
from surrofe2.plant_cell.sph_kernel import spline, spline_slope
from surrofe2.plant_cell.wall import wall_energy, wall_force


@kernel
def add_bond_forces(x, v, f, bonds, c):
    """Add wall tensions (eq. 1) to f; x, v, f: (2, local, lanes)."""
    for k in range(bonds.shape[0]):
        i, j = bonds[k, 0], bonds[k, 1]
        for lane in range(x.shape[2]):
            rx, ry = x[0, j, lane] - x[0, i, lane], x[1, j, lane] - x[1, i, lane]
            wx, wy = v[0, j, lane] - v[0, i, lane], v[1, j, lane] - v[1, i, lane]
            length = np.sqrt(rx * rx + ry * ry)
            inverse = 1.0 / length
            a = wall_force(length, (rx * wx + ry * wy) * inverse, c) * inverse
            f[0, i, lane] += a * rx
            f[1, i, lane] += a * ry
            f[0, j, lane] -= a * rx
            f[1, j, lane] -= a * ry


@kernel
def add_contact_forces(x, v, f, contacts, c):
    """Add contact repulsion (eq. 2) to f; x, v, f: (2, local, lanes)."""
    for k in range(contacts.shape[0]):
        i, j = contacts[k, 0], contacts[k, 1]
        for lane in range(x.shape[2]):
            rx, ry = x[0, j, lane] - x[0, i, lane], x[1, j, lane] - x[1, i, lane]
            wx, wy = v[0, j, lane] - v[0, i, lane], v[1, j, lane] - v[1, i, lane]
            length = np.sqrt(rx * rx + ry * ry)
            inverse = 1.0 / length
            a = contact_force(length, (rx * wx + ry * wy) * inverse, c) * inverse
            f[0, i, lane] += a * rx
            f[1, i, lane] += a * ry
            f[0, j, lane] -= a * rx
            f[1, j, lane] -= a * ry


@kernel
def add_fluid_forces(x, v, f, topology, c, slope, volume):
    """Add pressure and viscous forces (eq. 8) to f.

    Scratch, filled here: slope (pairs, lanes) W′/|r|; volume (fluid, lanes) 1/ρ.
    """
    pairs, first = topology.fluid_pairs, topology.walls
    fluid_specific_volume(x, topology, c, slope, volume)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        for lane in range(x.shape[2]):
            a, b = fluid_coefficients(slope[k, lane], volume[p, lane], volume[q, lane], c)
            fx = a * (x[0, j, lane] - x[0, i, lane]) + b * (v[0, j, lane] - v[0, i, lane])
            fy = a * (x[1, j, lane] - x[1, i, lane]) + b * (v[1, j, lane] - v[1, i, lane])
            f[0, i, lane] += fx
            f[1, i, lane] += fy
            f[0, j, lane] -= fx
            f[1, j, lane] -= fy


@kernel
def fluid_specific_volume(x, topology, c, slope, volume):
    """volume = 1/ρ of eq. (7) and slope = W′/|r| of every fluid pair."""
    pairs, first = topology.fluid_pairs, topology.walls
    h = c.smoothing_length
    volume[:] = c.fluid_mass * spline(0.0, h)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        for lane in range(x.shape[2]):
            rx, ry = x[0, j, lane] - x[0, i, lane], x[1, j, lane] - x[1, i, lane]
            length = np.sqrt(rx * rx + ry * ry)
            s = length / h
            density = c.fluid_mass * spline(s, h)
            slope[k, lane] = spline_slope(s, h) / length
            volume[p, lane] += density
            volume[q, lane] += density
    for p in range(volume.shape[0]):
        for lane in range(x.shape[2]):
            volume[p, lane] = 1.0 / volume[p, lane]


@kernel
def add_forces(x, v, f, topology, c, slope, volume):
    """Add all forces on local particles to f; x, v, f: (2, local, lanes) in µm, µm/µs, µN."""
    add_bond_forces(x, v, f, topology.bonds, c)
    add_contact_forces(x, v, f, topology.contacts, c)
    add_fluid_forces(x, v, f, topology, c, slope, volume)


@kernel
def fold_images(f, topology):
    """Add the forces on images to their owners; own particles then feel the whole force."""
    own = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        for axis in range(2):
            for lane in range(f.shape[2]):
                f[axis, i, lane] += f[axis, own + k, lane]


@kernel
def elastic_energy(x, topology, c, energy):
    """energy (lanes,): stored energy of bonds, contacts and fluid (Σ m c_s² ln ρ), pJ."""
    lanes = x.shape[2]
    energy[:] = 0.0
    slope = np.empty((topology.fluid_pairs.shape[0], lanes))
    volume = np.empty((topology.particles - topology.walls, lanes))
    fluid_specific_volume(x, topology, c, slope, volume)
    for p in range(volume.shape[0]):
        for lane in range(lanes):
            energy[lane] -= c.fluid_mass * c.sound_speed_squared * np.log(volume[p, lane])
    for k in range(topology.bonds.shape[0]):
        i, j = topology.bonds[k, 0], topology.bonds[k, 1]
        for lane in range(lanes):
            length = np.hypot(x[0, j, lane] - x[0, i, lane], x[1, j, lane] - x[1, i, lane])
            energy[lane] += wall_energy(length, c)
    for k in range(topology.contacts.shape[0]):
        i, j = topology.contacts[k, 0], topology.contacts[k, 1]
        for lane in range(lanes):
            length = np.hypot(x[0, j, lane] - x[0, i, lane], x[1, j, lane] - x[1, i, lane])
            energy[lane] += contact_energy(length, c)

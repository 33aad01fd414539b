"""How the elastic equilibrium moves with F, and how these motions change with F in turn.

With x_el = F z_el and f_el(x_el) = 0, K the elastic Jacobian and V_m = ∂x_el/∂F_m::

    K F ∂z_el/∂F_m = −(∂f_el/∂F_m at fixed z),      K V_m = 0
    K ∂V_n/∂F_m = −K̇ V_m,                           K̇: change of K along V_n

K V_m = 0 on own particles, V_m reaching over images with the affine part E_m Z; what changes
in V_n is the same for a particle and its images. The columns m are F_xx, xy, yx, yy.
"""

from __future__ import annotations

import numpy as np

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.force_derivatives import add_stiffness_rates
from surrofe2.rve.block_lu import COLUMNS, factorise, solve_columns, solved_columns
from surrofe2.rve.newton import move, set_elastic_jacobian
from surrofe2.rve.particle_state import map_affine


@kernel
def equilibrium_modes(work, F, topology, c, matrices):
    """modes (4, 2, own, TILE) = ∂z_el/∂F_m; leaves the factorised elastic Jacobian behind."""
    map_affine(F, work.z, work.x)
    set_elastic_jacobian(work, F, topology, c, matrices.matrix, matrices.columns)
    factorise(matrices.matrix, topology, True)
    steps = solved_columns(matrices, 0, topology)
    modes = np.zeros((COLUMNS, 2, topology.particles, TILE))
    for m in range(COLUMNS):
        move(steps[m], F, modes[m])
    return modes


@kernel
def along(fields, tensor):
    """Σ_m tensor_m fields[m] over xx, xy, yx, yy: of modes and Ḟ, y = ∂z_el/∂F : Ḟ."""
    total = np.zeros(fields.shape[1:])
    for m in range(COLUMNS):
        factor = load(tensor, m // 2, m % 2)
        for axis in range(2):
            for i in range(total.shape[1]):
                store(load(total, axis, i) + factor * load(fields, m, axis, i), total, axis, i)
    return total


@kernel
def set_velocities(z, y, F, rate, topology, v):
    """v = Ḟ z + F y for local particles; an image has the y of its owner."""
    own = topology.particles
    map_affine(rate, z, v)
    xx, xy, yx, yy = load(F, 0, 0), load(F, 0, 1), load(F, 1, 0), load(F, 1, 1)
    for i in range(v.shape[1]):
        k = i if i < own else topology.owner[i - own]
        yi, yj = load(y, 0, k), load(y, 1, k)
        store(load(v, 0, i) + xx * yi + xy * yj, v, 0, i)
        store(load(v, 1, i) + yx * yi + yy * yj, v, 1, i)


@kernel
def unit_velocities(z, modes, F, topology):
    """V (4, 2, local, TILE) = ∂x_el/∂F_m, images included."""
    velocities = np.empty((COLUMNS, 2, z.shape[1], TILE))
    unit = np.zeros((COLUMNS, 2, 2, TILE))
    for m in range(COLUMNS):
        unit[m, m // 2, m % 2] = 1.0
        set_velocities(z, modes[m], F, unit[m], topology, velocities[m])
    return velocities


@kernel
def velocity_slopes(work, units, topology, c, lu):
    """(4, 2, local, TILE) = ∂v/∂F_m at work.x of v = Σ Ḟ_n V_n in work.v; lu of K."""
    slopes, rates = np.zeros_like(units), np.zeros_like(units)
    add_stiffness_rates(work, units, rates, topology, c)
    steps = np.empty((COLUMNS, 2 * topology.particles - 2, TILE))
    fold_columns(rates, topology, steps)
    solve_columns(lu, steps, topology, False)
    subtract_columns(steps, topology, slopes)
    return slopes


@kernel
def fold_columns(fields, topology, columns):
    """columns (4, 2n − 2, TILE): fields (4, 2, local, TILE) with what images feel, unless held."""
    own = topology.particles
    for m in range(COLUMNS):
        for axis in range(2):
            for i in range(1, own):
                store(load(fields, m, axis, i), columns, m, 2 * i - 2 + axis)
            for k in range(topology.owner.shape[0]):
                i = topology.owner[k]
                if i > 0:
                    row = 2 * i - 2 + axis
                    value = load(columns, m, row) + load(fields, m, axis, own + k)
                    store(value, columns, m, row)


@kernel
def subtract_columns(columns, topology, fields):
    """fields −= columns of own particles, and for images those of their owners."""
    own = topology.particles
    for m in range(COLUMNS):
        for k in range(fields.shape[2]):
            i = k if k < own else topology.owner[k - own]
            if i > 0:
                for axis in range(2):
                    value = load(fields, m, axis, k) - load(columns, m, 2 * i - 2 + axis)
                    store(value, fields, m, axis, k)

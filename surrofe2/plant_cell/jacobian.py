"""Exact derivatives of the particle forces, for a tile of cells at once.

With r = F Z and w = Ḟ Z for every pair (Z: material distance, images included), the force on i is
f(r, w), and with positions moved by δx at fixed (F, Ḟ), velocities follow as L δx, L = Ḟ F⁻¹::

    δf = (∂f/∂r + ∂f/∂w L) δr                        `jacobian`
    δf = ∂f/∂r δF Z + ∂f/∂w δḞ Z  at fixed Z         `load`

The fluid's density couples all fluid of a cell: δf += (∂f/∂ρ)(∂ρ/∂x) δx.

Layout (`lanes` last)::

    jacobian[2 i + a, 2 j + b, lane] = ∂f_ia/∂x_jb     i, j: own particles
    load[2 i + a, 2 b + c, lane]     = ∂f_ia/∂F_bc,    load[2 i + a, 4 + 2 b + c, lane]: ∂/∂Ḟ_bc
"""

from __future__ import annotations

import numpy as np

from surrofe2.plant_cell.contact import contact_force, contact_slopes
from surrofe2.plant_cell.fluid import fluid_coefficients, fluid_volume_slopes
from surrofe2.plant_cell.forces import fluid_specific_volume
from surrofe2.plant_cell.lanes import TILE, kernel, pair_law
from surrofe2.plant_cell.sph_kernel import spline_curvature
from surrofe2.plant_cell.wall import wall_force, wall_slopes


@pair_law
def central_slopes(tension, by_length, by_rate, length, rate, nx, ny, wx, wy):
    """∂(t n)/∂r as (xx, xy, yx, yy); ∂(t n)/∂w is by_rate n ⊗ n."""
    over = tension / length
    along = by_length - over
    ux = along * nx + by_rate * (wx - rate * nx) / length
    uy = along * ny + by_rate * (wy - rate * ny) / length
    return over + nx * ux, nx * uy, ny * ux, over + ny * uy


@kernel
def _scatter(i, j, j_own, rr, rw, L, Z, jacobian, load):
    """Spread ∂f/∂r = rr and ∂f/∂w = rw (4, TILE) of one pair."""
    for lane in range(TILE):
        lxx, lxy, lyx, lyy = L[0, 0, lane], L[0, 1, lane], L[1, 0, lane], L[1, 1, lane]
        zx, zy = Z[0, j, lane] - Z[0, i, lane], Z[1, j, lane] - Z[1, i, lane]
        for a in range(2):
            rx, ry, wx, wy = rr[2 * a, lane], rr[2 * a + 1, lane], rw[2 * a, lane], rw[2 * a + 1, lane]
            kx = rx + wx * lxx + wy * lyx
            ky = ry + wx * lxy + wy * lyy
            jacobian[2 * i + a, 2 * j_own, lane] += kx
            jacobian[2 * i + a, 2 * j_own + 1, lane] += ky
            jacobian[2 * i + a, 2 * i, lane] -= kx
            jacobian[2 * i + a, 2 * i + 1, lane] -= ky
            jacobian[2 * j_own + a, 2 * i, lane] += kx
            jacobian[2 * j_own + a, 2 * i + 1, lane] += ky
            jacobian[2 * j_own + a, 2 * j_own, lane] -= kx
            jacobian[2 * j_own + a, 2 * j_own + 1, lane] -= ky
            for row, sign in ((2 * i + a, 1.0), (2 * j_own + a, -1.0)):
                load[row, 0, lane] += sign * rx * zx
                load[row, 1, lane] += sign * rx * zy
                load[row, 2, lane] += sign * ry * zx
                load[row, 3, lane] += sign * ry * zy
                load[row, 4, lane] += sign * wx * zx
                load[row, 5, lane] += sign * wx * zy
                load[row, 6, lane] += sign * wy * zx
                load[row, 7, lane] += sign * wy * zy


@kernel
def _add_central(x, v, L, Z, pairs, is_bond, topology, c, jacobian, load):
    own = topology.particles
    rr, rw = np.empty((4, TILE)), np.empty((4, TILE))
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        j_own = j if j < own else topology.owner[j - own]
        for lane in range(TILE):
            rx, ry = x[0, j, lane] - x[0, i, lane], x[1, j, lane] - x[1, i, lane]
            wx, wy = v[0, j, lane] - v[0, i, lane], v[1, j, lane] - v[1, i, lane]
            length = np.sqrt(rx * rx + ry * ry)
            nx, ny = rx / length, ry / length
            rate = nx * wx + ny * wy
            if is_bond:
                tension = wall_force(length, rate, c)
                by_length, by_rate = wall_slopes(c)
            else:
                tension = contact_force(length, rate, c)
                by_length, by_rate = contact_slopes(length, rate, c)
            xx, xy, yx, yy = central_slopes(
                tension, by_length, by_rate, length, rate, nx, ny, wx, wy
            )
            rr[0, lane], rr[1, lane], rr[2, lane], rr[3, lane] = xx, xy, yx, yy
            rw[0, lane] = by_rate * nx * nx
            rw[1, lane] = by_rate * nx * ny
            rw[2, lane] = by_rate * nx * ny
            rw[3, lane] = by_rate * ny * ny
        _scatter(i, j, j_own, rr, rw, L, Z, jacobian, load)


@kernel
def _add_fluid(x, v, L, Z, topology, c, jacobian, load):
    pairs, first = topology.fluid_pairs, topology.walls
    fluid = topology.particles - first
    h = c.smoothing_length
    slope = np.empty((pairs.shape[0], TILE))
    volume = np.empty((fluid, TILE))
    fluid_specific_volume(x, topology, c, slope, volume)
    by_density = np.zeros((2 * fluid, fluid, TILE))
    density_by_x = np.zeros((fluid, 2 * fluid, TILE))
    density_by_load = np.zeros((fluid, 4, TILE))
    rr, rw = np.empty((4, TILE)), np.empty((4, TILE))
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        p, q = i - first, j - first
        for lane in range(TILE):
            rx, ry = x[0, j, lane] - x[0, i, lane], x[1, j, lane] - x[1, i, lane]
            wx, wy = v[0, j, lane] - v[0, i, lane], v[1, j, lane] - v[1, i, lane]
            length = np.sqrt(rx * rx + ry * ry)
            nx, ny = rx / length, ry / length
            steep = slope[k, lane]
            volume_i, volume_j = volume[p, lane], volume[q, lane]
            a, b = fluid_coefficients(steep, volume_i, volume_j, c)
            bend = (spline_curvature(length / h, h) - steep) / length
            da, db = fluid_coefficients(bend, volume_i, volume_j, c)
            rr[0, lane] = a + (da * rx + db * wx) * nx
            rr[1, lane] = (da * rx + db * wx) * ny
            rr[2, lane] = (da * ry + db * wy) * nx
            rr[3, lane] = a + (da * ry + db * wy) * ny
            rw[0, lane], rw[1, lane], rw[2, lane], rw[3, lane] = b, 0.0, 0.0, b

            a_i, b_i = fluid_volume_slopes(steep, volume_j, c)
            a_j, b_j = fluid_volume_slopes(steep, volume_i, c)
            fxi = -volume_i * volume_i * (a_i * rx + b_i * wx)
            fyi = -volume_i * volume_i * (a_i * ry + b_i * wy)
            fxj = -volume_j * volume_j * (a_j * rx + b_j * wx)
            fyj = -volume_j * volume_j * (a_j * ry + b_j * wy)
            by_density[2 * p, p, lane] += fxi
            by_density[2 * p + 1, p, lane] += fyi
            by_density[2 * p, q, lane] += fxj
            by_density[2 * p + 1, q, lane] += fyj
            by_density[2 * q, p, lane] -= fxi
            by_density[2 * q + 1, p, lane] -= fyi
            by_density[2 * q, q, lane] -= fxj
            by_density[2 * q + 1, q, lane] -= fyj

            gx, gy = c.fluid_mass * steep * rx, c.fluid_mass * steep * ry
            zx, zy = Z[0, j, lane] - Z[0, i, lane], Z[1, j, lane] - Z[1, i, lane]
            for s in (p, q):
                density_by_x[s, 2 * q, lane] += gx
                density_by_x[s, 2 * q + 1, lane] += gy
                density_by_x[s, 2 * p, lane] -= gx
                density_by_x[s, 2 * p + 1, lane] -= gy
                density_by_load[s, 0, lane] += gx * zx
                density_by_load[s, 1, lane] += gx * zy
                density_by_load[s, 2, lane] += gy * zx
                density_by_load[s, 3, lane] += gy * zy
        _scatter(i, j, j, rr, rw, L, Z, jacobian, load)
    row = 2 * first
    for m in range(2 * fluid):
        for s in range(fluid):
            for n in range(2 * fluid):
                for lane in range(TILE):
                    jacobian[row + m, row + n, lane] += (
                        by_density[m, s, lane] * density_by_x[s, n, lane]
                    )
            for n in range(4):
                for lane in range(TILE):
                    load[row + m, n, lane] += by_density[m, s, lane] * density_by_load[s, n, lane]


@kernel
def force_jacobian(x, v, L, Z, topology, c, jacobian, load):
    """Fill jacobian (2n, 2n, TILE) and load (2n, 8, TILE) at local x, v, Z (2, local, TILE).

    L: (2, 2, TILE) velocity gradient that velocities follow; zero for the elastic Hessian (with
    v = 0), whose negative `jacobian` then is.
    """
    jacobian[:] = 0.0
    load[:] = 0.0
    _add_central(x, v, L, Z, topology.bonds, True, topology, c, jacobian, load)
    _add_central(x, v, L, Z, topology.contacts, False, topology, c, jacobian, load)
    _add_fluid(x, v, L, Z, topology, c, jacobian, load)

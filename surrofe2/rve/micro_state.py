"""Evaluating the particles of RVEs that follow (F, Ḟ): forces, residual, stress.

Unknowns are material positions z, so that x = F z moves along with F, and velocities v = Ḟ z are
affine: v = L x. z of particle 0, a wall corner, stays at the origin.
"""

from __future__ import annotations

import numpy as np

from surrofe2.plant_cell.forces import add_forces, fold_images
from surrofe2.plant_cell.lanes import kernel


@kernel
def set_images(z, topology):
    """Fill the image part of local material positions z (2, local, lanes) from its own part."""
    own = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        for axis in range(2):
            offset = topology.image_offset[k, axis]
            for lane in range(z.shape[2]):
                z[axis, own + k, lane] = z[axis, i, lane] + offset


@kernel
def map_affine(F, z, x):
    """x = F z for local particles; F (2, 2, lanes), z and x (2, local, lanes)."""
    for i in range(z.shape[1]):
        for lane in range(z.shape[2]):
            x[0, i, lane] = F[0, 0, lane] * z[0, i, lane] + F[0, 1, lane] * z[1, i, lane]
            x[1, i, lane] = F[1, 0, lane] * z[0, i, lane] + F[1, 1, lane] * z[1, i, lane]


@kernel
def local_forces(x, v, topology, c, f, slope, volume):
    """f (2, local, lanes): forces on own particles and, not yet folded, on images."""
    f[:] = 0.0
    add_forces(x, v, f, topology, c, slope, volume)


@kernel
def cauchy_stress(x, f, F, area, stress):
    """Virial stress (eq. 57b) from unfolded local forces: σ = −1/V Σ_k f_k ⊗ x_k, µN/µm.

    Every pair adds f and −f to its two local particles, so the sum over pairs of f ⊗ r is minus
    the sum over local particles of force ⊗ position. V = det F times the reference area.
    """
    for lane in range(x.shape[2]):
        xx = xy = yx = yy = 0.0
        for k in range(x.shape[1]):
            xx -= f[0, k, lane] * x[0, k, lane]
            xy -= f[0, k, lane] * x[1, k, lane]
            yx -= f[1, k, lane] * x[0, k, lane]
            yy -= f[1, k, lane] * x[1, k, lane]
        volume = area * (F[0, 0, lane] * F[1, 1, lane] - F[0, 1, lane] * F[1, 0, lane])
        stress[0, 0, lane] = xx / volume
        stress[0, 1, lane] = xy / volume
        stress[1, 0, lane] = yx / volume
        stress[1, 1, lane] = yy / volume


@kernel
def mean_force(f, own, residual):
    """residual (lanes,): mean over own particles of the folded force's magnitude, µN."""
    residual[:] = 0.0
    for i in range(own):
        for lane in range(f.shape[2]):
            fx, fy = f[0, i, lane], f[1, i, lane]
            residual[lane] += np.sqrt(fx * fx + fy * fy) / own


@kernel
def evaluate(z, F, rate, topology, c, area, x, v, f, slope, volume, stress, residual):
    """Forces (folded), stress and mean force at z with affine velocities v = rate z."""
    set_images(z, topology)
    map_affine(F, z, x)
    map_affine(rate, z, v)
    local_forces(x, v, topology, c, f, slope, volume)
    cauchy_stress(x, f, F, area, stress)
    fold_images(f, topology)
    mean_force(f, topology.particles, residual)


@kernel
def list_covers(F, z, reference, reach, cutoff, covered):
    """covered (tiles, TILE): whether no pair beyond the list's reach can be within the cut-off.

    Unlisted pairs have |Z| > reach in the reference (n, 2). With particles at most d from there
    in material coordinates, |r| ≥ s_min(F) (reach − 2 d).
    """
    for t in range(z.shape[0]):
        for lane in range(z.shape[3]):
            farthest = 0.0
            for i in range(reference.shape[0]):
                dx = z[t, 0, i, lane] - reference[i, 0]
                dy = z[t, 1, i, lane] - reference[i, 1]
                farthest = max(farthest, dx * dx + dy * dy)
            a, b = F[t, 0, 0, lane], F[t, 0, 1, lane]
            d, e = F[t, 1, 0, lane], F[t, 1, 1, lane]
            smallest = 0.5 * (np.hypot(a + e, b - d) - np.hypot(a - e, b + d))
            covered[t, lane] = smallest * (reach - 2.0 * np.sqrt(farthest)) >= cutoff

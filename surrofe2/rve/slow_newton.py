"""Slow-manifold positions by Newton's method, where a kept factorisation does not get there.

Near a bifurcation one mode of the cell is soft: the viscous forces move the particles far along
it, and the elastic Jacobian at z_el, which `slow_manifold.follow` keeps, misleads. Here the
velocities v = Ḟ z_el + F y follow from one exact solve, y = ∂z_el/∂F : Ḟ, and f(F z, v) = 0 is
solved with the Jacobian of the moment.
"""

from __future__ import annotations

import numba
import numpy as np

from surrofe2.compilation import kernel, parallel_kernel
from surrofe2.rve.elastic_modes import equilibrium_modes, material_rate
from surrofe2.rve.micro_state import keep_lane, make_workspace, place
from surrofe2.rve.newton_steps import newton_loop
from surrofe2.rve.slow_manifold import set_fluctuation, set_velocities
from surrofe2.rve.systems import make_matrices
from surrofe2.simd import TILE


@parallel_kernel
def newton_slow(
    F, rate, z, elastic, fluctuation, topology, c, area, tolerance, stress, iterations
):  # fmt: skip
    """z, v − L x and stress from z_el in lanes with iterations ≤ 0, in place; (tiles, …, TILE).

    iterations becomes the number of force evaluations there, or −1.
    """
    for t in numba.prange(z.shape[0]):
        _newton_tile(
            F[t], rate[t], z[t], elastic[t], fluctuation[t], topology, c, area, tolerance,
            stress[t], iterations[t],
        )  # fmt: skip


@kernel
def _newton_tile(
    F, rate, z, elastic, fluctuation, topology, c, area, tolerance, stress, iterations
):  # fmt: skip
    work, matrices = make_workspace(topology), make_matrices(topology)
    still, beyond = np.zeros((2, 2, TILE)), np.empty_like(fluctuation)
    wanted = iterations <= 0
    place(work, elastic, F, topology)
    y = material_rate(equilibrium_modes(work, F, topology, c, matrices), rate)
    set_velocities(work.z, y, F, rate, topology, work.v)
    newton_loop(work, matrices, F, still, False, topology, c, area, tolerance, stress, iterations)
    set_fluctuation(work.v, work.z, rate, beyond)
    for k in range(TILE):
        if wanted[k] and iterations[k] > 0:
            keep_lane(work.z, k, z)
            keep_lane(beyond, k, fluctuation)

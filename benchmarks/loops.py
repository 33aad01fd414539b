"""Kernels repeated inside one compiled call, so that no call from Python is in the clock.

Arrays are in tiles, (tiles, …, TILE), as in `surrofe2.plant_cell.tiles`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.plain_forces import evaluate_plainly, make_plain_workspace
from surrofe2.base.compilation import compiled
from surrofe2.base.simd import TILE
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.jacobian import force_jacobian
from surrofe2.plant_cell.tiles import make_workspace
from surrofe2.rve.particle_state import Drive, evaluate, map_affine, set_images

loop = compiled(cache=False)


@loop
def repeat_evaluation(
    times: int, z: Any, F: Any, rate: Any, topology: Any, c: Any, forces: Any
) -> None:
    """All that a solver asks for: images, x = F z, forces, stress, mean force."""
    own = topology.particles
    work = make_workspace(topology)
    stress, residual = np.empty((2, 2, TILE)), np.empty((1, TILE))
    for _ in range(times):
        for t in range(z.shape[0]):
            work.z[:, :own] = z[t]
            evaluate(work, Drive(F[t], rate[t]), True, topology, c, stress, residual)
            forces[t] = work.f[:, :own]


@loop
def repeat_forces(times: int, z: Any, F: Any, rate: Any, topology: Any, c: Any) -> None:
    """Forces alone, of one tile whose images stand ready."""
    work = make_workspace(topology)
    work.z[:, : topology.particles] = z[0]
    set_images(work.z, topology)
    map_affine(F[0], work.z, work.x)
    map_affine(rate[0], work.z, work.v)
    for _ in range(times):
        for _ in range(z.shape[0]):
            local_forces(work, topology, c)
            fold_images(work.f, topology)


@loop
def repeat_plain_evaluation(
    times: int, z: Any, F: Any, rate: Any, topology: Any, c: Any, area: float, forces: Any
) -> None:
    """The plain twin of `repeat_evaluation`; arrays have points first and no lanes."""
    work = make_plain_workspace(topology)
    for _ in range(times):
        for p in range(z.shape[0]):
            evaluate_plainly(work, z[p], F[p], rate[p], topology, c, area)
            forces[p] = work.f[: topology.particles]


@loop
def repeat_jacobian(
    times: int, z: Any, F: Any, rate: Any, L: Any, topology: Any, c: Any, jacobian: Any
) -> None:
    """∂f/∂x of every tile, without the held particle, into jacobian (tiles, size, TILE)."""
    own = topology.particles
    work = make_workspace(topology)
    columns = np.empty((0, 8, TILE))
    for _ in range(times):
        for t in range(z.shape[0]):
            work.z[:, :own] = z[t]
            set_images(work.z, topology)
            map_affine(F[t], work.z, work.x)
            map_affine(rate[t], work.z, work.v)
            force_jacobian(work, L[t], topology, c, jacobian[t], columns)


@loop
def central_differences(
    z: Any, F: Any, rate: Any, inverse: Any, topology: Any, c: Any, step: float, jacobian: Any
) -> None:
    """The same by two force evaluations a column; inverse (tiles, 2, 2, TILE): F⁻¹."""
    own = topology.particles
    work = make_workspace(topology)
    stress, residual = np.empty((2, 2, TILE)), np.empty((1, TILE))
    for t in range(z.shape[0]):
        for i in range(own):
            for axis in range(2):
                column = 2 * i + axis
                for sign in (1.0, -1.0):
                    work.z[:, :own] = z[t]
                    work.z[:, i] += sign * step * inverse[t, :, axis]
                    evaluate(work, Drive(F[t], rate[t]), True, topology, c, stress, residual)
                    for j in range(own):
                        for b in range(2):
                            change = sign * work.f[b, j] / (2.0 * step)
                            if sign > 0.0:
                                jacobian[t, 2 * j + b, column] = change
                            else:
                                jacobian[t, 2 * j + b, column] += change

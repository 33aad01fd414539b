"""Equilibria of an arrangement of plant cells in a given box, from many starts at once.

Starts are lanes of tiles: each settles from where it is put, dashpots on, then Newton finds the
equilibrium (65) at F, and its energy tells equilibria apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.errors import InputError
from surrofe2.plant_cell.forces import elastic_energy
from surrofe2.plant_cell.tiles import Constants, pack, unpack
from surrofe2.rve.constrained_runs import iterate
from surrofe2.rve.factors import Factors
from surrofe2.rve.newton import SOLVE, newton
from surrofe2.rve.particle_state import map_affine, set_images
from surrofe2.rve.systems import AnyTopology, empty_factors
from surrofe2.simd import TILE

Array = NDArray[np.float64]

RELAXED = 1e-10
_SETTLING_STEP, _SETTLING_LIMIT = 1e-3, 300_000
_SETTLED = 1e-4
"""Mean force, µN, low enough that Newton stays in the basin: irregular cells have many."""
SAME_ENERGY = 1e-7
"""Equilibria whose energies differ relatively by less are the same or images of each other."""


@dataclass(frozen=True, slots=True)
class Equilibria:
    """Elastic equilibria of k points.

    Attributes:
        z: (k, 2, particles) material positions, µm.
        stress: (k, 2, 2) Cauchy stress, µN/µm.
        energy: (k,) stored energy of the RVE, pJ; NaN where none was found.
        found, stable: (k,).
        factors: factorisations there, in tiles.
    """

    z: Array
    stress: Array
    energy: Array
    found: NDArray[np.bool_]
    stable: NDArray[np.bool_]
    factors: Factors


def settle(
    topology: AnyTopology, constants: Constants, mass: Array, area: float, starts: Array
) -> tuple[Array, NDArray[np.bool_]]:
    """Where particles come to rest at F = I from `starts` (k, n, 2), and whether they did."""
    x = np.ascontiguousarray(np.moveaxis(pack(starts), 2, 1))
    unit = np.ascontiguousarray(np.broadcast_to(np.eye(2)[..., None], (len(x), 2, 2, TILE)))
    residual, iterations = np.empty((len(x), 1, TILE)), np.empty((len(x), TILE), dtype=np.int32)
    iterate(
        unit, np.zeros_like(unit), x, np.zeros_like(x), mass, topology, constants, area,
        _SETTLING_STEP, _SETTLED, _SETTLING_LIMIT, np.empty_like(unit), residual, iterations,
    )  # fmt: skip
    k = len(starts)
    return np.swapaxes(unpack(x, k), 1, 2).copy(), unpack(iterations, k) >= 0


def relax(
    topology: AnyTopology, constants: Constants, area: float, starts: Array, F: Array
) -> Equilibria:
    """Elastic equilibria at F (k, 2, 2) by Newton from material positions (k, 2, n)."""
    points = len(starts)
    z, tensors = pack(starts), pack(F)
    tiles, factors = len(z), empty_factors(topology, len(z))
    stress = np.full((tiles, 2, 2, TILE), np.nan)
    iterations = np.zeros((tiles, TILE), dtype=np.int32)
    stable, energy = np.zeros((tiles, TILE), dtype=np.bool_), np.empty((tiles, 1, TILE))
    newton(
        tensors, np.zeros_like(tensors), z, factors.address, np.full(tiles, SOLVE, dtype=np.int8),
        topology, constants, area, RELAXED, stress, iterations, stable,
    )  # fmt: skip
    _energies(tensors, z, topology, constants, energy)
    found = unpack(iterations, points) > 0
    return Equilibria(
        unpack(z, points),
        unpack(stress, points),
        np.where(found, unpack(energy, points)[:, 0], np.nan),
        found,
        found & unpack(stable, points),
        factors,
    )


def lowest(equilibria: Equilibria) -> int:
    """The stable equilibrium of least energy; among equal ones the first.

    Raises:
        InputError: none is stable.
    """
    if not equilibria.stable.any():
        raise InputError(
            "cell: no stable equilibrium of the undeformed RVE was found; check "
            "fluid_particle_mass, wall_stiffness and repulsion_strength, or take another "
            "arrangement_seed"
        )
    energy = np.where(equilibria.stable, equilibria.energy, np.inf)
    return int(np.flatnonzero(energy <= energy.min() + SAME_ENERGY * abs(energy.min()))[0])


def distinct(equilibria: Equilibria) -> list[int]:
    """One of each group of stable equilibria of one energy, by rising energy."""
    chosen: list[int] = []
    for k in np.argsort(np.where(equilibria.stable, equilibria.energy, np.inf), kind="stable"):
        if not equilibria.stable[k]:
            break
        energy = equilibria.energy[k]
        if not chosen or energy - equilibria.energy[chosen[-1]] > SAME_ENERGY * abs(energy):
            chosen.append(int(k))
    return chosen


@kernel
def _energies(F, z, topology, c, energy):
    local = topology.particles + topology.owner.shape[0]
    here, x = np.empty((2, local, TILE)), np.empty((2, local, TILE))
    for t in range(z.shape[0]):
        here[:, : topology.particles] = z[t]
        set_images(here, topology)
        map_affine(F[t], here, x)
        elastic_energy(x, topology, c, energy[t])

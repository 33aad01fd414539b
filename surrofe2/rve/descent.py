"""The way down the elastic energy E of an RVE that has met the end of its branch.

Newton's, with the modulus of every eigenvalue of the Hessian H = Σ λ q qᵀ::

    δx = Σ q (q·f)/|λ|,  halved until E falls,        f = −∂E/∂x

Where H is positive definite that is H⁻¹ f, and eigenvalues need not be known. At rest in a saddle f
says nothing, and the kick is the part of a fixed pattern w that lies in the unstable directions,
δx ∝ Σ_{λ<0} |λ| q (q·w): it depends neither on the sign nor on the choice of eigenvectors that
numpy returns. w is fixed in material coordinates, so a rotated RVE leaves along the rotated
direction. Which of two mirrored branches is reached is w's choice, and a reflected RVE may choose
the other.

Forces and Hessian are by x of all particles but the held one, ordered x₁, y₁, x₂, … as everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numba
import numpy as np
import scipy  # scipy.linalg is loaded where an RVE leaves its branch
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel, parallel_kernel
from surrofe2.base.simd import TILE, load, spread, store, where_less
from surrofe2.plant_cell.block_pattern import Pattern, make_pattern
from surrofe2.plant_cell.forces import difference, elastic_energy, fold_images, local_forces
from surrofe2.plant_cell.tiles import Constants, make_workspace, pack, tiles_for, unpack
from surrofe2.rve.near_contacts import NearContacts
from surrofe2.rve.newton import move, set_elastic_jacobian
from surrofe2.rve.particle_state import place, place_images

Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.intp]

RESTING = 1e-4
"""Mean particle force below which a minimum is left to Newton's method, µN."""
KICK = 0.2
"""Longest displacement of a particle out of a saddle, µm."""
DOWN = 0.4
"""Longest displacement of a particle in one step down, µm."""
PAIRED = 0.02
"""Distance of fluid particles below which they count as one, µm."""
LEAST = 1e-12
"""Stiffness of a mode that counts as one, over the largest of a particle."""
STEPS, HALVINGS = 100, 30
"""Steps down to a minimum, and halvings of each, after which there is none."""
ROAM = 2.0
"""How far particles may move, µm, before contacts are listed anew."""


class Found(NamedTuple):
    """What there is after a step, of RVEs in tiles.

    energy: (tiles, 1, TILE) E, pJ. falls: (tiles, TILE) whether it is lower than before.
    forces: (tiles, 2n − 2, TILE) f = −∂E/∂x, µN. slope: (tiles, (2n − 2)², TILE) −H, µN/µm.
    nearest: (tiles, 1, TILE) smallest square of a distance of fluid particles, µm².
    """

    energy: Reals
    falls: Flags
    forces: Reals
    slope: Reals
    nearest: Reals


@parallel_kernel
def go_down(F, z, step, topology, c, found):
    """Move z (tiles, 2, n, TILE) by the step δx (tiles, 2n − 2, TILE), in place.

    The step is halved until E falls below the energy `found` before; else z stays.
    """
    for t in numba.prange(z.shape[0]):
        here = Found(
            found.energy[t], found.falls[t], found.forces[t], found.slope[t], found.nearest[t]
        )
        _go_down_tile(F[t], z[t], step[t], topology, c, here)


@kernel
def _go_down_tile(F, z, step, topology, c, found):
    work, no_columns = make_workspace(topology), np.empty((0, 8, TILE))
    trial, energy, falls = np.empty((1, TILE)), found.energy, found.falls
    falls[:] = False
    for _ in range(HALVINGS):
        place(work, z, F, topology)
        move(step, F, work.z)
        place_images(work, F, topology)
        elastic_energy(work.x, topology, c, trial)
        left = 0
        for k in range(TILE):
            if falls[k]:
                continue
            if trial[0, k] < energy[0, k]:
                falls[k] = True
                energy[0, k] = trial[0, k]
            else:
                step[:, k] *= 0.5
                left += 1
        if left == 0:
            break
    for k in range(TILE):
        if not falls[k]:
            step[:, k] = 0.0
    move(step, F, z)
    place(work, z, F, topology)
    set_elastic_jacobian(work, F, topology, c, found.slope, no_columns)
    local_forces(work, topology, c)
    fold_images(work.f, topology)
    for i in range(1, topology.particles):
        store(load(work.f, 0, i), found.forces, 2 * i - 2)
        store(load(work.f, 1, i), found.forces, 2 * i - 1)
    nearest = spread(np.inf)
    for k in range(topology.fluid_pairs.shape[0]):
        rx, ry = difference(work.x, topology.fluid_pairs[k, 0], topology.fluid_pairs[k, 1])
        square = rx * rx + ry * ry
        nearest = where_less(square, nearest, square, nearest)
    store(nearest, found.nearest, 0)


@cache
def dense_pattern(particles: int) -> Pattern:
    """Of full matrices, whatever those of a topology are: all eigenvalues are wanted."""
    return make_pattern(np.zeros(particles, dtype=np.int32), [])


@dataclass(frozen=True, slots=True)
class Landscape:
    """Elastic energy of m RVEs at deformations F (m, 2, 2)."""

    F: Reals
    contacts: NearContacts
    constants: Constants

    def paired(self, z: Reals) -> Flags:
        """(m,) whether two fluid particles of an RVE at z (m, 2, n) have met.

        That is SPH's pairing instability. The model's forces between fluid particles vanish with
        their distance, so such a pair is an equilibrium of the numbers and none of the tissue.
        """
        walls = self.contacts.topology.walls
        i, j = (self.contacts.topology.fluid_pairs - walls).T
        x = self.F @ z[:, :, walls:]
        apart = x[:, :, i] - x[:, :, j]
        nearest: Reals = (apart * apart).sum(axis=1).min(axis=1, initial=np.inf)
        return nearest < PAIRED**2


class Descent:
    """k of the RVEs of a landscape on their way down.

    Args:
        index: (k,) which. z: (k, 2, n) where they begin. energy: (k,) what is to be fallen below.

    Attributes:
        found: what there is where they are.
    """

    def __init__(self, landscape: Landscape, index: Index, z: Reals, energy: Reals) -> None:
        self.landscape, self.F = landscape, landscape.F[index]
        self._F, self._z = pack(self.F), pack(z)
        tiles, free = tiles_for(len(z)), 2 * z.shape[2] - 2
        self.found = Found(
            energy=pack(energy[:, None]),
            falls=np.empty((tiles, TILE), dtype=np.bool_),
            forces=np.empty((tiles, free, TILE)),
            slope=np.empty((tiles, free * free, TILE)),
            nearest=np.empty((tiles, 1, TILE)),
        )
        self._topology, self._room = landscape.contacts.topology, 0.0

    @property
    def z(self) -> Reals:
        """(k, 2, n) where they are."""
        return unpack(self._z, len(self.F))

    @property
    def energy(self) -> Reals:
        """(k,) pJ."""
        return unpack(self.found.energy, len(self.F))[:, 0]

    @property
    def goes_on(self) -> Flags:
        """(k,) whether the last step has led down and no two fluid particles have met."""
        goes_on: Flags = self.found.falls & (self.found.nearest[:, 0] >= PAIRED**2)
        return unpack(goes_on, len(self.F))

    def go(self, step: Reals) -> None:
        """Take the step (k, 2n − 2), µm, which moves particles by no more than `DOWN`."""
        if self._room < DOWN:
            near, self._room = self.landscape.contacts, ROAM
            topology = near.within(self.F, self.z, np.full(len(self.F), ROAM))
            self._topology = topology._replace(**dense_pattern(topology.particles)._asdict())
        self._room -= float(_lengths(step).max())
        constants = self.landscape.constants
        go_down(self._F, self._z, pack(step), self._topology, constants, self.found)

    def next_step(self, k: int) -> tuple[Reals, bool]:
        """That of RVE k, see `_step`."""
        tile, lane = divmod(k, TILE)
        slope = self.found.slope[tile, :, lane]
        return _step(self.F[k], self.found.forces[tile, :, lane], -slope)


def descend(
    landscape: Landscape, z: Reals, most: NDArray[np.int_] | int = STEPS
) -> tuple[Reals, Flags, NDArray[np.int_]]:
    """From z (m, 2, n) down to a minimum of E, in at most so many steps.

    Returns:
        z there, (m,) whether it is one: mean force below `RESTING`, Hessian positive definite; and
        (m,) how many steps were tried.
    """
    z, found, tried = z.copy(), np.zeros(len(z), dtype=np.bool_), np.zeros(len(z), dtype=np.int_)
    limit, energy = np.minimum(np.full(len(z), most), STEPS), np.full(len(z), np.inf)
    # The first step has no length: it finds energy, forces and Hessian where the descent begins.
    active, step = np.arange(len(z)), np.zeros((len(z), 2 * z.shape[2] - 2))
    while len(active):
        # Whenever an RVE stops, those that go on are packed into tiles again.
        down = Descent(landscape, active, z[active], energy[active])
        goes_on = np.ones(len(active), dtype=np.bool_)
        while goes_on.all():
            down.go(step)
            goes_on = down.goes_on & (tried[active] < limit[active])
            for k in np.flatnonzero(goes_on).tolist():
                step[k], found[active[k]] = down.next_step(k)
                tried[active[k]] += 1
                goes_on[k] = not found[active[k]]
        z[active], energy[active] = down.z, down.energy
        active, step = active[goes_on], step[goes_on]
    return z, found, tried


def _step(F: Reals, forces: Reals, values: Reals) -> tuple[Reals, bool]:
    """(2n − 2,) Newton's step, or the kick out of a saddle at rest; whether this is a minimum."""
    hessian = values.reshape(len(forces), -1)
    resting = bool(_lengths(forces[None]).mean() < RESTING)
    factor, not_definite = scipy.linalg.lapack.dpotrf(hessian, clean=False)
    if not not_definite:
        if resting:
            return forces, True
        step = scipy.linalg.lapack.dpotrs(factor, forces)[0]
    else:
        step = over_saddle(F, forces, hessian, resting)
    step = step * min(DOWN / max(_lengths(step[None]).max(), 1e-300), 1.0)
    return step, False


def over_saddle(F: Reals, forces: Reals, hessian: Reals, resting: bool) -> Reals:
    """H⁻¹ f with the sign of the unstable modes turned, or, `resting`, the kick along these."""
    # The unstable modes alone: all of them take twice as long, and a solution does for the others.
    stiffness, modes = scipy.linalg.eigh(
        hessian, subset_by_value=(-np.inf, 0.0), driver="evr", check_finite=False
    )
    if resting:
        step = modes @ (-stiffness * (modes.T @ _pattern(F, len(forces))))
        return step * (KICK / max(_lengths(step[None]).max(), 1e-300))
    least = LEAST * np.abs(np.diagonal(hessian)).max()  # a particle that touches nothing stays
    shifted = hessian + least * np.eye(len(forces))
    step = scipy.linalg.lapack.dsysv(shifted, forces)[2]
    turned = 1.0 / np.maximum(-stiffness, least) - 1.0 / (stiffness + least)
    return step + modes @ (turned * (modes.T @ forces))


def _pattern(F: Reals, free: int) -> Reals:
    """(free,) displacements that single out one of mirrored branches, whatever F (2, 2)."""
    angle = np.arange(1, free // 2 + 1) * np.sqrt(2.0)
    return (F @ np.stack([np.cos(angle), np.sin(2.0 * angle)])).T.ravel()


def _lengths(vectors: Reals) -> Reals:
    """(m, n − 1) of vectors (m, 2n − 2)."""
    pairs = vectors.reshape(len(vectors), vectors.shape[1] // 2, 2)
    lengths: Reals = np.sqrt((pairs * pairs).sum(axis=2))
    return lengths

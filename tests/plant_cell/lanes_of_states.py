"""One cell in every lane of a tile, in another state each."""

from __future__ import annotations

import numpy as np

from surrofe2.base.simd import TILE
from surrofe2.plant_cell import derivatives, forces
from surrofe2.plant_cell.arrangement import start_positions
from surrofe2.plant_cell.block_matrices import dense_pattern
from surrofe2.plant_cell.neighbours import make_neighbours
from surrofe2.plant_cell.pair_laws import make_constants
from surrofe2.plant_cell.pair_sums import Workspace
from surrofe2.plant_cell.parameters import CellParameters
from tests.plant_cell.twin import Twin

REST = 1.9


class Patch:
    """An RVE, in every lane another state: material positions z (TILE, n, 2), F, Ḟ.

    x, v: (2, local, TILE) of local particles, whose `owners` are own ones. Matrices are dense.
    """

    def __init__(self, preset: str, seed: int = 0, **changes) -> None:
        rng = np.random.default_rng(seed)
        self.cell = CellParameters.preset(preset, **changes)
        base, self.lattice = start_positions(self.cell), self.cell.tessellation.lattice
        topology = make_neighbours(self.cell, base, self.lattice).topology
        dense = dense_pattern(topology.particles, topology.pressures)
        self.topology = topology._replace(**dense._asdict())
        self.constants = make_constants(self.cell, REST)
        if self.cell.is_one_square and self.cell.fluid == "sph":
            self.twin = Twin(self.cell, REST)
        self.z = base + 0.1 * rng.uniform(-1, 1, (TILE, *base.shape))
        self.F = np.eye(2) + 0.08 * rng.uniform(-1, 1, (TILE, 2, 2))
        self.F_dot = 0.01 * rng.uniform(-1, 1, (TILE, 2, 2))
        self.owners = np.append(np.arange(self.topology.particles), self.topology.owner)
        self.x, self.v = self.local(self.z, self.F), self.local(self.z, self.F_dot)

    def local(self, z, tensor):
        """(2, local, TILE): tensor applied to own particles and images."""
        offset = np.pad(self.topology.image_offset, ((z.shape[1], 0), (0, 0)))
        everyone = z[:, self.owners] + offset
        return np.ascontiguousarray(np.einsum("lab,lpb->apl", tensor, everyone))

    def workspace(self, x, v, z=None):
        """`Workspace` with particles at local x and v; z is local, too."""
        fluid = self.topology.particles - self.topology.walls
        scratch = np.empty((len(self.topology.fluid_pairs), TILE)), np.empty((fluid, TILE))
        return Workspace(x if z is None else z, x, v, np.zeros_like(x), *scratch)

    def jacobian(self, F_dot):
        """(2n − 2, 2n − 2, TILE) without the held particle and pressures, and (2n, 8, TILE)."""
        n, identity = self.topology.particles, np.broadcast_to(np.eye(2), self.F.shape)
        J, load = np.empty((self.topology.size, TILE)), np.empty((2 * n, 8, TILE))
        L = np.ascontiguousarray(np.moveaxis(F_dot @ np.linalg.inv(self.F), 0, -1))
        at = (self.local(self.z, tensor) for tensor in (self.F, F_dot, identity))
        derivatives.force_jacobian(self.workspace(*at), L, self.topology, self.constants, J, load)
        size, free = 2 * n - 2 + 2 * self.topology.pressures, 2 * n - 2
        J = np.moveaxis(J.reshape(size, size, TILE), -1, 0)
        follow = np.linalg.solve(J[:, free:, free:], J[:, free:, :free])
        return np.moveaxis(J[:, :free, :free] - J[:, :free, free:] @ follow, 0, -1), load

    def local_forces(self, x, v):
        """(2, local, TILE)."""
        work = self.workspace(x, v)
        forces.local_forces(work, self.topology, self.constants)
        return work.f

    def forces(self, z=None, F=None, F_dot=None, fold=True):
        """(TILE, n, 2)."""
        z = self.z if z is None else z
        x = self.local(z, self.F if F is None else F)
        f = self.local_forces(x, self.local(z, self.F_dot if F_dot is None else F_dot))
        if fold:
            forces.fold_images(f, self.topology)
        return np.moveaxis(f[:, : self.topology.particles], -1, 0).swapaxes(1, 2)

    def elastic_rates(self, x, v):
        """f and its rate (2, local, TILE), elastic, of local particles."""
        work, rate = self.workspace(x, v), np.empty_like(x)
        derivatives.elastic_forces_and_rates(
            work, rate, np.empty_like(work.volume), self.topology, self.constants
        )
        return work.f, rate

    def gradients(self, weights):
        by_x, by_v = np.zeros_like(weights), np.zeros_like(weights)
        work = self.workspace(self.x, self.v)
        derivatives.add_force_gradients(work, weights, by_x, by_v, self.topology, self.constants)
        return by_x, by_v

    def energy(self, z, F):
        energy = np.empty((1, TILE))
        x = self.local(z, F)
        forces.elastic_energy(self.workspace(x, x), self.topology, self.constants, energy)
        return energy[0]

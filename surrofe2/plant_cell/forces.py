"""Forces and energy of a tile of plant cells: walls, contacts and fluid summed up.

Fluid is that of SPH particles or one pressure for each plant cell; the list of the other is empty.
`fold_images` adds what images feel to their owners.
"""

from __future__ import annotations

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import load, store
from surrofe2.plant_cell.central_pairs import add_central_energy, add_central_forces
from surrofe2.plant_cell.sph_fluid import add_sph_energy, add_sph_forces
from surrofe2.plant_cell.uniform_fluid import add_uniform_energy, add_uniform_forces


@kernel
def local_forces(workspace, topology, constants):
    """Fill workspace.f with the forces at x and v of the workspace, µN, not folded yet.

    workspace: `Workspace`. topology: `Topology`. constants: `Constants`.
    """
    workspace.f[:] = 0.0
    x = workspace.x
    v = workspace.v
    f = workspace.f
    add_central_forces(x, v, f, topology.bonds, topology.bond_weight, True, constants)
    add_central_forces(x, v, f, topology.contacts, topology.contact_weight, False, constants)
    add_sph_forces(x, v, f, topology, constants, workspace.slope, workspace.volume)
    add_uniform_forces(x, v, f, topology, constants)


@kernel
def fold_images(f, topology):
    """Add the forces on images to their owners, which then have the whole force.

    f: (2, local, TILE), own particles first.
    """
    particles = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        store(load(f, 0, i) + load(f, 0, particles + k), f, 0, i)
        store(load(f, 1, i) + load(f, 1, particles + k), f, 1, i)


@kernel
def elastic_energy(workspace, topology, constants, energy):
    """Fill energy (1, TILE) with that of bonds, contacts and fluid at workspace.x, pJ."""
    x = workspace.x
    store(0.0, energy, 0)
    add_central_energy(x, topology.bonds, topology.bond_weight, True, constants, energy)
    add_central_energy(x, topology.contacts, topology.contact_weight, False, constants, energy)
    add_sph_energy(x, topology, constants, workspace.slope, workspace.volume, energy)
    add_uniform_energy(x, topology, constants, energy)

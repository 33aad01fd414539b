"""Exact derivatives of the particle forces, for a tile of plant cells at once.

With r = F Z and w = Ḟ Z for every pair (Z: material distance, images included), the force on i is
f(r, w). Each term of the forces states its slopes once, and three passes contract them:

- `force_jacobian`, matrices, lanes last. With L = Ḟ F⁻¹ and positions moved by δx at fixed (F, Ḟ)::

      δf = (∂f/∂r + ∂f/∂w L) δr                        `matrix`, see `Pattern`
      δf = ∂f/∂r δF Z + ∂f/∂w δḞ Z  at fixed Z         `columns`
      columns[2 i + a, 2 b + c, lane]  ∂f_ia/∂F_bc;    columns[2 i + a, 4 + 2 b + c, lane]: ∂/∂Ḟ_bc

- `add_force_gradients`: the transposed slopes, those of weighted sums Σ_k φ_k·f_k by x and v, for
  four φ at once.
- `elastic_forces_and_rates`: slopes along one direction, elastic forces f and ḟ = ∂f/∂x · v.

`add_stiffness_rates` adds K̇ u, the change of the elastic stiffness K = ∂f/∂x along v, times u.

In all of them `workspace` is a `Workspace`, `topology` a `Topology`, `constants` are `Constants`.
"""

from __future__ import annotations

from surrofe2.base.compilation import kernel
from surrofe2.plant_cell.central_pairs import (
    add_central_gradients,
    add_central_jacobian,
    add_central_rates,
    add_central_stiffness_rates,
)
from surrofe2.plant_cell.sph_fluid import (
    add_sph_gradients,
    add_sph_jacobian,
    add_sph_rates,
    add_sph_stiffness_rates,
)
from surrofe2.plant_cell.uniform_fluid import (
    add_uniform_gradients,
    add_uniform_jacobian,
    add_uniform_rates,
    add_uniform_stiffness_rates,
)


@kernel
def force_jacobian(workspace, L, topology, constants, matrix, columns):
    """Fill matrix (size, TILE) and columns (2n, 8, TILE) at x, v and z of the workspace.

    L: (2, 2, TILE) velocity gradient that velocities follow. With L and v zero, `matrix` is the
        negative elastic Hessian.
    columns: without rows if these slopes are not wanted.
    """
    matrix[:] = 0.0
    columns[:] = 0.0
    # bonds, then contacts; one call in a loop, so that its machine code is made once
    for kind in range(2):
        is_bond = kind == 0
        pairs = topology.bonds
        weight = topology.bond_weight
        if not is_bond:
            pairs = topology.contacts
            weight = topology.contact_weight
        add_central_jacobian(
            workspace, L, pairs, weight, is_bond, topology, constants, matrix, columns
        )
    add_sph_jacobian(workspace, L, topology, constants, matrix, columns)
    add_uniform_jacobian(workspace, topology, constants, matrix, columns)


@kernel
def add_force_gradients(workspace, weights, by_x, by_v, topology, constants):
    """Add the slopes of Σ_k φ_k·f_k with x to by_x and with v to by_v, for four φ in `weights`.

    At workspace.x and workspace.v; weights, by_x, by_v: (4, 2, local, TILE).
    """
    bonds = topology.bonds
    contacts = topology.contacts
    add_central_gradients(
        workspace, weights, by_x, by_v, bonds, topology.bond_weight, True, constants
    )
    add_central_gradients(
        workspace, weights, by_x, by_v, contacts, topology.contact_weight, False, constants
    )
    add_sph_gradients(workspace, weights, by_x, by_v, topology, constants)
    add_uniform_gradients(workspace, weights, by_x, by_v, topology, constants)


@kernel
def elastic_forces_and_rates(workspace, f_rate, volume_rate, topology, constants):
    """Fill workspace.f with elastic forces, and f_rate with their rates along workspace.v.

    workspace.f, f_rate: (2, local, TILE), µN and µN/µs; forces on images are not yet folded.
    volume_rate: (fluid, TILE) scratch.
    """
    workspace.f[:] = 0.0
    f_rate[:] = 0.0
    add_central_rates(workspace, f_rate, topology.bonds, topology.bond_weight, True, constants)
    add_central_rates(
        workspace, f_rate, topology.contacts, topology.contact_weight, False, constants
    )
    add_sph_rates(workspace, f_rate, volume_rate, topology, constants)
    add_uniform_rates(workspace, f_rate, topology, constants)


@kernel
def add_stiffness_rates(workspace, u, f, topology, constants):
    """Add K̇ u to f for four fields u, with K̇ the rate of the elastic stiffness along workspace.v.

    At workspace.x; u, f: (4, 2, local, TILE).
    """
    add_central_stiffness_rates(
        workspace, u, f, topology.bonds, topology.bond_weight, True, constants
    )
    add_central_stiffness_rates(
        workspace, u, f, topology.contacts, topology.contact_weight, False, constants
    )
    add_sph_stiffness_rates(workspace, u, f, topology, constants)
    add_uniform_stiffness_rates(workspace, u, f, topology, constants)

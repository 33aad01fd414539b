"""Walls and contacts, eqs. (1) and (2): energy, forces and their derivatives.

A central pair is a bond between wall neighbours (eq. 1) or a contact (eq. 2); `is_bond` is the same
for all pairs of a list. Tension t > 0 pulls the two together; the force on i is t n, n = r/|r|.
"""

from __future__ import annotations

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import load, spread, store
from surrofe2.plant_cell.pair_laws import (
    contact,
    contact_bend,
    contact_energy,
    tension,
    wall,
    wall_energy,
    within,
)
from surrofe2.plant_cell.pair_sums import (
    FIELDS,
    add_field_pair,
    add_pair,
    add_pair_jacobian,
    add_pair_load,
    add_transposed,
    difference,
    field_difference,
    norm,
    pair_at,
)


@pair_law
def central_law(pair, is_bond, weight, constants):
    """Return the weight that acts, and (t, ∂t/∂|r|, γ, ∂γ/∂|r|) of a bond or contact.

    The tension is weight · (t + γ n·w), of which t is elastic. Beyond the cut-off the weight is 0,
    so that one selection of lanes switches all four off.
    """
    if is_bond:
        elastic, stiffness, damping, _ = wall(pair.length, constants)
        # as lanes, like those of a contact: in numba both branches must have one type
        law = elastic, spread(stiffness), spread(damping), spread(0.0)
        acting = spread(weight)
    else:
        law = contact(pair.length, pair.inverse, constants)
        acting = within(pair.length, weight, constants)
    return acting, law


@kernel
def add_central_forces(x, v, f, pairs, weight, is_bond, constants):
    """Add wall tensions (eq. 1) or contact repulsion (eq. 2) to f (2, local, TILE), µN.

    x, v: (2, local, TILE) positions, µm, and velocities, µm/µs. pairs: (pairs, 2) local particles.
    weight: (pairs,) scales the whole force of a pair: ½ where one of the two walls is missing
        (docs/theory.md, walls at a free boundary). The damping in it is by the whole wall mass.
    """
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        pair = pair_at(x, v, i, j)
        acting, law = central_law(pair, is_bond, weight[k], constants)
        tension_over_length = acting * pair.inverse * tension(law, pair.rate)
        add_pair(f, i, j, tension_over_length * pair.rx, tension_over_length * pair.ry)


@kernel
def add_central_energy(x, pairs, weight, is_bond, constants, energy):
    """Add the stored energy of bonds or contacts, pJ, to energy (1, TILE); weight as above."""
    total = spread(0.0)
    for k in range(pairs.shape[0]):
        rx, ry = difference(x, pairs[k, 0], pairs[k, 1])
        length, inverse = norm(rx, ry)
        energy_of = (
            wall_energy(length, constants)
            if is_bond
            else contact_energy(length, inverse, constants)
        )
        total += weight[k] * energy_of
    store(load(energy, 0) + total, energy, 0)


@pair_law
def central_slopes(pair, is_bond, weight, constants):
    """Return (∂f/∂r, ∂f/∂w) of a bond or contact, each as (xx, xy, yx, yy).

    With f = T n and T = t + γ s, s = n·w::

        ∂f/∂w = γ n ⊗ n
        ∂f/∂r = T/|r| I + n ⊗ [(t′ + γ′ s − T/|r|) n + γ (w − s n)/|r|]
    """
    acting, law = central_law(pair, is_bond, weight, constants)
    _, stiffness, damping, damping_slope = law
    nx = pair.nx
    ny = pair.ny
    by_rate = acting * damping
    over = acting * tension(law, pair.rate) * pair.inverse
    along = acting * (stiffness + damping_slope * pair.rate) - over
    ux = along * nx + by_rate * (pair.wx - pair.rate * nx) * pair.inverse
    uy = along * ny + by_rate * (pair.wy - pair.rate * ny) * pair.inverse
    cross = by_rate * nx * ny
    rr = (over + nx * ux, nx * uy, ny * ux, over + ny * uy)
    return rr, (by_rate * nx * nx, cross, cross, by_rate * ny * ny)


@kernel
def add_central_jacobian(
    workspace, L, pairs, weight, is_bond, topology, constants, matrix, columns
):
    """Add the slopes of these pairs' forces to matrix and columns; see `force_jacobian`.

    pairs: (pairs, 2) local particles. weight: (pairs,) as of `add_central_forces`.
    """
    particles = topology.particles
    owner = topology.owner
    # taken out of the tuple before the loop: within it, numba would count references to them
    block = topology.block
    stride = topology.stride
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        j_own = j if j < particles else owner[j - particles]
        pair = pair_at(workspace.x, workspace.v, i, j)
        rr, rw = central_slopes(pair, is_bond, weight[k], constants)
        add_pair_jacobian(matrix, block, stride, L, i, j_own, rr, rw)
        if columns.shape[0] > 0:
            add_pair_load(columns, workspace.z, i, j, j_own, rr, rw)


@kernel
def add_central_gradients(workspace, weights, by_x, by_v, pairs, weight, is_bond, constants):
    """Add slopes of Σ φ·f over these pairs to by_x and by_v; see `add_force_gradients`."""
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        pair = pair_at(workspace.x, workspace.v, i, j)
        rr, rw = central_slopes(pair, is_bond, weight[k], constants)
        for m in range(FIELDS):
            px, py = field_difference(weights, m, i, j)
            add_transposed(by_x, m, i, j, rr, px, py)
            add_transposed(by_v, m, i, j, rw, px, py)


@kernel
def add_central_rates(workspace, f_rate, pairs, weight, is_bond, constants):
    """Add elastic forces to workspace.f, and their rates along workspace.v to f_rate.

    Both are (2, local, TILE). With a = t/|r| and s = n·w, f = a r and ḟ = (t′ − a) s n + a w.
    """
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        pair = pair_at(workspace.x, workspace.v, i, j)
        acting, (elastic, stiffness, _, _) = central_law(pair, is_bond, weight[k], constants)
        over = acting * elastic * pair.inverse
        along = (acting * stiffness - over) * pair.rate * pair.inverse
        add_pair(workspace.f, i, j, over * pair.rx, over * pair.ry)
        gx = along * pair.rx + over * pair.wx
        gy = along * pair.ry + over * pair.wy
        add_pair(f_rate, i, j, gx, gy)


@kernel
def add_central_stiffness_rates(workspace, u, f, pairs, weight, is_bond, constants):
    """Add K̇ u to f for the FIELDS fields u, f (FIELDS, 2, local, TILE); K̇ is K's rate along v.

    With b = t′ − t/|r|, s = n·w, p = u_j − u_i and ṅ = (w − s n)/|r|::

    K̇ p = b s/|r| p + (t″ − b/|r|) s (n·p) n + b [(n·p) ṅ + (ṅ·p) n]
    """
    for k in range(pairs.shape[0]):
        i = pairs[k, 0]
        j = pairs[k, 1]
        pair = pair_at(workspace.x, workspace.v, i, j)
        nx = pair.nx
        ny = pair.ny
        inverse = pair.inverse
        rate = pair.rate
        acting, (elastic, stiffness, _, _) = central_law(pair, is_bond, weight[k], constants)
        b = acting * (stiffness - elastic * inverse)
        across = b * rate * inverse
        along = -across
        # a spring has t″ = 0
        if not is_bond:
            along += acting * contact_bend(inverse, constants) * rate
        # b ṅ
        turn_x = b * (pair.wx - rate * nx) * inverse
        turn_y = b * (pair.wy - rate * ny) * inverse
        for m in range(FIELDS):
            px, py = field_difference(u, m, i, j)
            stretch = nx * px + ny * py
            by_n = along * stretch + turn_x * px + turn_y * py
            fx = across * px + by_n * nx + stretch * turn_x
            fy = across * py + by_n * ny + stretch * turn_y
            add_field_pair(f, m, i, j, fx, fy)

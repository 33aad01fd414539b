"""Bonds and contacts along wall lines, each with its share lane by lane (model.md, Forces).

A share is 1 inside the tissue, ½ on its boundary, where one of the two walls is missing, and 0 in
lanes without that pair. It scales the whole force; c(r) keeps the parameter m_wall.
"""

from __future__ import annotations

from surrofe2.compilation import kernel
from surrofe2.plant_cell.contact import contact_force
from surrofe2.plant_cell.forces import add_pair, difference
from surrofe2.plant_cell.simd import inverse_root, load
from surrofe2.plant_cell.wall import wall_force


@kernel
def add_shared_bond_forces(x, v, f, bonds, share, c):
    """Add wall tensions (eq. 1) times `share` (bonds, TILE) to f."""
    for k in range(bonds.shape[0]):
        i, j = bonds[k, 0], bonds[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        tension = wall_force(square * inverse, (rx * wx + ry * wy) * inverse, c)
        a = load(share, k) * tension * inverse
        add_pair(f, i, j, a * rx, a * ry)


@kernel
def add_shared_contact_forces(x, v, f, contacts, share, c):
    """Add contact repulsion (eq. 2) times `share` (contacts, TILE) to f."""
    for k in range(contacts.shape[0]):
        i, j = contacts[k, 0], contacts[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        square = rx * rx + ry * ry
        inverse = inverse_root(square)
        rate = (rx * wx + ry * wy) * inverse
        a = load(share, k) * contact_force(square * inverse, inverse, rate, c) * inverse
        add_pair(f, i, j, a * rx, a * ry)

"""Pair forces along n = r/|r|: a bond between wall neighbours (eq. 1) or a contact (eq. 2).

Tension t > 0 pulls the two together; the force on i is t n. `is_bond` is the same for all pairs of
a list.
"""

from __future__ import annotations

from surrofe2.compilation import pair_law
from surrofe2.plant_cell.contact import (
    contact_bend,
    contact_elastic,
    contact_energy,
    contact_force,
    contact_slopes,
)
from surrofe2.plant_cell.wall import wall_energy, wall_force
from surrofe2.simd import spread


@pair_law
def central_tension(pair, is_bond, c):
    """t(|r|, n·w), µN."""
    if is_bond:
        tension = wall_force(pair.length, pair.rate, c)
    else:
        tension = contact_force(pair.length, pair.inverse, pair.rate, c)
    return tension


@pair_law
def central_slopes(pair, is_bond, c):
    """(t, ∂t/∂|r|, ∂t/∂(n·w))."""
    tension = central_tension(pair, is_bond, c)
    if is_bond:
        by_length, by_rate = spread(c.wall_stiffness), spread(c.wall_damping)
    else:
        by_length, by_rate = contact_slopes(pair.length, pair.inverse, pair.rate, c)
    return tension, by_length, by_rate


@pair_law
def central_elastic(pair, is_bond, c):
    """(t, t′, t″) by |r|, dashpots off."""
    if is_bond:
        tension = wall_force(pair.length, 0.0, c)
        slope, bend = spread(c.wall_stiffness), spread(0.0)
    else:
        tension, slope = contact_elastic(pair.length, pair.inverse, c)
        bend = contact_bend(pair.length, pair.inverse, c)
    return tension, slope, bend


@pair_law
def central_energy(length, inverse, is_bond, c):
    """Stored energy, pJ."""
    if is_bond:
        energy = wall_energy(length, c)
    else:
        energy = contact_energy(length, inverse, c)
    return energy

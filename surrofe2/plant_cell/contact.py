"""Contact repulsion of wall particles from fluid and from walls not bonded to them (eq. 2).

Tension on i along n (negative: repulsion) for |r| < x₀, else 0, as settled in model.md::

    t = −[λ (|r|⁻⁶ − x₀⁻⁶) − c(|r|) n·w]
    c(r) = 2 √(6 λ m_wall / r⁷) (1 − (r/x₀)⁶) · damping ratio

The factor 1 − (r/x₀)⁶ is ours: the printed dashpot jumps at the cut-off. The paper prints x·v
for n·w.
"""

from __future__ import annotations

import numpy as np

from surrofe2.plant_cell.lanes import pair_law


@pair_law
def contact_force(length, rate, c):
    """Tension [µN] at |r| = `length` (µm), n·w = `rate` (µm/µs)."""
    inverse = 1.0 / length
    inverse_2 = inverse * inverse
    inverse_6 = inverse_2 * inverse_2 * inverse_2
    beyond = 1.0 / c.cutoff**6
    square = length * length
    fade = square * square * square * beyond
    damping = c.contact_damping * inverse_2 * inverse * np.sqrt(inverse) * (1.0 - fade)
    tension = damping * rate - c.repulsion * (inverse_6 - beyond)
    return tension if length < c.cutoff else 0.0


@pair_law
def contact_slopes(length, rate, c):
    """(∂t/∂|r|, ∂t/∂(n·w)) of the tension."""
    inverse = 1.0 / length
    inverse_2 = inverse * inverse
    inverse_6 = inverse_2 * inverse_2 * inverse_2
    beyond = 1.0 / c.cutoff**6
    critical = c.contact_damping * inverse_2 * inverse * np.sqrt(inverse)
    square = length * length
    fade = square * square * square * beyond
    damping = critical * (1.0 - fade)
    damping_slope = critical * inverse * (-3.5 * (1.0 - fade) - 6.0 * fade)
    slope = damping_slope * rate + 6.0 * c.repulsion * inverse_6 * inverse
    inside = length < c.cutoff
    return slope if inside else 0.0, damping if inside else 0.0


@pair_law
def contact_energy(length, c):
    """Stored energy of a contact, pJ: λ [r⁻⁵/5 + r x₀⁻⁶ − 6/5 x₀⁻⁵]."""
    energy = c.repulsion * (
        0.2 / length**5 + length / c.cutoff**6 - 1.2 / c.cutoff**5
    )
    return energy if length < c.cutoff else 0.0

"""Contact repulsion of wall particles from fluid and from walls not bonded to them (eq. 2).

Tension on i along n (negative: repulsion) for |r| < x₀, else 0, docs/theory.md (2)::

    t = −[λ (|r|⁻⁶ − x₀⁻⁶) − c(|r|) n·w]
    c(r) = 2 √(6 λ m_wall / r⁷) (1 − (r/x₀)⁶) · damping ratio

The factor 1 − (r/x₀)⁶ is ours: the printed dashpot jumps at the cut-off. The paper prints x·v
for n·w.
"""

from __future__ import annotations

from surrofe2.compilation import pair_law
from surrofe2.simd import inverse_root, where_less


@pair_law
def contact_force(length, inverse, rate, c):
    """Tension [µN] at |r| = `length`, its reciprocal `inverse`, n·w = `rate`; µm, µm/µs."""
    inverse_3 = inverse * inverse * inverse
    inverse_6 = inverse_3 * inverse_3
    beyond = 1.0 / c.cutoff**6
    cube = length * length * length
    damping = c.contact_damping * inverse_3 * inverse_root(length) * (1.0 - cube * cube * beyond)
    tension = damping * rate - c.repulsion * (inverse_6 - beyond)
    return where_less(length, c.cutoff, tension, 0.0)


@pair_law
def contact_slopes(length, inverse, rate, c):
    """(∂t/∂|r|, ∂t/∂(n·w)) of the tension."""
    inverse_3 = inverse * inverse * inverse
    cube = length * length * length
    fade = cube * cube * (1.0 / c.cutoff**6)
    critical = c.contact_damping * inverse_3 * inverse_root(length)
    damping = critical * (1.0 - fade)
    damping_slope = critical * inverse * (-3.5 * (1.0 - fade) - 6.0 * fade)
    slope = damping_slope * rate + 6.0 * c.repulsion * inverse_3 * inverse_3 * inverse
    inside_slope = where_less(length, c.cutoff, slope, 0.0)
    return inside_slope, where_less(length, c.cutoff, damping, 0.0)


@pair_law
def contact_elastic(length, inverse, c):
    """Tension without the dashpot, and its slope ∂t/∂|r|."""
    inverse_3 = inverse * inverse * inverse
    inverse_6 = inverse_3 * inverse_3
    tension = c.repulsion * (1.0 / c.cutoff**6 - inverse_6)
    slope = 6.0 * c.repulsion * inverse_6 * inverse
    return where_less(length, c.cutoff, tension, 0.0), where_less(length, c.cutoff, slope, 0.0)


@pair_law
def contact_bend(length, inverse, c):
    """∂²t/∂|r|² without the dashpot."""
    inverse_4 = inverse * inverse * inverse * inverse
    bend = -42.0 * c.repulsion * inverse_4 * inverse_4
    return where_less(length, c.cutoff, bend, 0.0)


@pair_law
def contact_energy(length, inverse, c):
    """Stored energy of a contact, pJ: λ [r⁻⁵/5 + r x₀⁻⁶ − 6/5 x₀⁻⁵]."""
    inverse_5 = inverse * inverse * inverse * inverse * inverse
    energy = c.repulsion * (0.2 * inverse_5 + length * (1.0 / c.cutoff**6) - 1.2 / c.cutoff**5)
    return where_less(length, c.cutoff, energy, 0.0)

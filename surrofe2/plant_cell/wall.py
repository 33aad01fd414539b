"""Wall spring and dashpot between bonded wall neighbours (eq. 1; docs/theory.md, walls).

Force on i with r = x_j − x_i, n = r/|r|, w = v_j − v_i::

    f = [k_w (|r| − l₀) + γ n·w] n

The paper prints γ x·v, which critical damping contradicts, with the sign of x_i − x_j.
"""

from __future__ import annotations

from surrofe2.compilation import pair_law


@pair_law
def wall_force(length, rate, c):
    """Tension [µN] of a bond of length |r| (µm) that stretches at n·w = `rate` (µm/µs)."""
    return c.wall_stiffness * (length - c.rest_length) + c.wall_damping * rate


@pair_law
def wall_energy(length, c):
    """Stored energy of a bond, pJ."""
    stretch = length - c.rest_length
    return 0.5 * c.wall_stiffness * stretch * stretch

"""Pair laws: walls, contacts, fluid, and the kernel by which the fluid is smoothed.

Formulas are those of docs/theory.md, forces. The paper prints γ x·v in (1), which critical damping
contradicts, with the sign of x_i − x_j. The factor 1 − (r/x₀)⁶ of the contacts' dashpot in (2) is
ours, for the printed one jumps at the cut-off. The viscous part of (8), in Morris's form, is not
central: it makes torque. The spline (5) has no branch: with q₊ = max(q, 0) and s = r/h,
W = σ/h² [(2 − s)₊³/4 − (1 − s)₊³].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.compilation import pair_law
from surrofe2.base.simd import inverse_root, where_less
from surrofe2.plant_cell.parameters import CellParameters

SIGMA = 10.0 / (7.0 * np.pi)
_SPRING = 2.5
"""Length of the paper's wall springs, µm."""


class Constants(NamedTuple):
    """What the pair laws need of `CellParameters`, ready for use in kernels (µm, µs, ng).

    scale: by which solvers multiply the lengths that bound their steps: a wall spring's over 2.5 µm
        with a uniform fluid; 1 with SPH fluid, whose particles would meet.
    """

    wall_stiffness: float
    rest_length: float
    wall_damping: float
    repulsion: float
    cutoff: float
    contact_damping: float
    smoothing_length: float
    fluid_mass: float
    sound_speed_squared: float
    sap_modulus: float
    viscosity: float
    scale: float


def make_constants(cell: CellParameters, rest_length: float) -> Constants:
    """Constants of eqs. (1), (2), (8), (9) for one set of parameters."""
    m = cell.wall_particle_mass
    k = cell.wall_stiffness
    strength = cell.repulsion_strength
    return Constants(
        wall_stiffness=k,
        rest_length=float(rest_length),
        wall_damping=cell.wall_damping_ratio * 2.0 * np.sqrt(m * k),
        repulsion=strength,
        cutoff=cell.repulsion_cutoff,
        contact_damping=cell.contact_damping_ratio * 2.0 * np.sqrt(6.0 * strength * m),
        smoothing_length=cell.smoothing_length,
        fluid_mass=cell.fluid_mass,
        sound_speed_squared=cell.sound_speed**2,
        sap_modulus=cell.sap_bulk_modulus * cell.tissue_thickness,
        viscosity=cell.viscosity,
        scale=cell.spring_length / _SPRING if cell.has_uniform_fluid else 1.0,
    )


@pair_law
def wall(length, c):
    """(t, ∂t/∂|r|, γ, ∂γ/∂|r|) of a bond, whose tension is t + γ n·w, µN; µm, µm/µs."""
    tension = c.wall_stiffness * (length - c.rest_length)
    return tension, c.wall_stiffness, c.wall_damping, 0.0


@pair_law
def wall_energy(length, c):
    """Stored energy of a bond, pJ."""
    stretch = length - c.rest_length
    return 0.5 * c.wall_stiffness * stretch * stretch


@pair_law
def contact(length, inverse, c):
    """As `wall` for a contact at |r| = `length`, its reciprocal `inverse`, within the cut-off.

    What a kernel does not use of the four costs nothing.
    """
    inverse_3 = inverse * inverse * inverse
    inverse_6 = inverse_3 * inverse_3
    beyond = 1.0 / c.cutoff**6
    cube = length * length * length
    fade = cube * cube * beyond
    critical = c.contact_damping * inverse_3 * inverse_root(length)
    tension = c.repulsion * (beyond - inverse_6)
    stiffness = 6.0 * c.repulsion * inverse_6 * inverse
    damping = critical * (1.0 - fade)
    damping_slope = critical * inverse * (-3.5 * (1.0 - fade) - 6.0 * fade)
    return tension, stiffness, damping, damping_slope


@pair_law
def tension(law, rate):
    """Of a bond or contact whose `law` is as of `wall`, µN, at n·w = rate."""
    return law[0] + law[2] * rate


@pair_law
def within(length, value, c):
    """The value where a contact acts, 0 beyond the cut-off."""
    return where_less(length, c.cutoff, value, 0.0)


@pair_law
def contact_bend(inverse, c):
    """∂²t/∂|r|² of a contact without its dashpot, within the cut-off."""
    inverse_4 = inverse * inverse * inverse * inverse
    return -42.0 * c.repulsion * inverse_4 * inverse_4


@pair_law
def contact_energy(length, inverse, c):
    """Stored energy of a contact, pJ: λ [r⁻⁵/5 + r x₀⁻⁶ − 6/5 x₀⁻⁵]."""
    inverse_5 = inverse * inverse * inverse * inverse * inverse
    energy = c.repulsion * (0.2 * inverse_5 + length * (1.0 / c.cutoff**6) - 1.2 / c.cutoff**5)
    return within(length, energy, c)


@pair_law
def fluid_coefficients(slope_over_length, volume_i, volume_j, c):
    """(a, b) of f = a r + b w, with volume = 1/ρ in µm²/ng and slope_over_length = W′/|r|."""
    weight = c.fluid_mass * c.fluid_mass * slope_over_length
    pressure = weight * c.sound_speed_squared * (volume_i + volume_j)
    viscous = -2.0 * weight * c.viscosity * volume_i * volume_j
    return pressure, viscous


@pair_law
def fluid_volume_slopes(slope_over_length, other_volume, c):
    """∂(a, b)/∂(1/ρ_i) at fixed positions, with other_volume = 1/ρ_j."""
    weight = c.fluid_mass * c.fluid_mass * slope_over_length
    return weight * c.sound_speed_squared, -2.0 * weight * c.viscosity * other_volume


@pair_law
def spline(s, h):
    """W in 1/µm² at s = r/h; lanes."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h) * (0.25 * outer * outer * outer - inner * inner * inner)


@pair_law
def spline_slope(s, h):
    """dW/dr in 1/µm³."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h * h) * (3.0 * inner * inner - 0.75 * outer * outer)


@pair_law
def spline_curvature(s, h):
    """d²W/dr² in 1/µm⁴."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h * h * h) * (1.5 * outer - 6.0 * inner)


@pair_law
def spline_bend(slope_over_length, length, inverse, h):
    """d(W′/|r|)/d|r| in 1/µm⁵, of W′/|r|, |r| and 1/|r|."""
    return (spline_curvature(length * (1.0 / h), h) - slope_over_length) * inverse

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
"""Factor σ by which the spline W has the integral 1 in the plane."""
_SPRING = 2.5
"""Length of the paper's wall springs, µm."""


class Constants(NamedTuple):
    """Constants of the pair laws by `CellParameters`, ready for use in kernels.

    wall_stiffness, rest_length, wall_damping: k_w, µN/µm, l₀, µm, and γ, µN µs/µm, of (1).
    repulsion, cutoff: λ, µN µm⁶, and x₀, µm, of (2).
    contact_damping: 2 √(6 λ m_w) ζ_c of (2), µN µs µm^(5/2).
    smoothing_length, fluid_mass: h, µm, and mass of an SPH particle, ng.
    sound_speed_squared: c_s², µm²/µs².
    sap_modulus: K of (A49), µN/µm.
    viscosity: µ, ng/µs.
    scale: factor of the lengths that bound the steps of solvers. With a uniform fluid, the length
        of a wall spring over the paper's; with SPH fluid 1, for its particles would meet otherwise.
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
    """Return the constants of eqs. (1), (2), (8), (9) for one set of parameters.

    rest_length: l₀, µm. Factors that do not change with distance are multiplied out: γ of (1), and
    2 √(6 λ m_w) ζ_c of c(r) in (2).
    """
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
def wall(length, constants):
    """Return (t, ∂t/∂|r|, γ, ∂γ/∂|r|) of a bond, whose tension is t + γ n·w, µN (eq. 1).

    length: |r|, lanes, µm. constants: `Constants`.
    """
    tension = constants.wall_stiffness * (length - constants.rest_length)
    return tension, constants.wall_stiffness, constants.wall_damping, 0.0


@pair_law
def wall_energy(length, constants):
    """Return the stored energy of a bond, ½ k (|r| − l₀)², pJ."""
    stretch = length - constants.rest_length
    return 0.5 * constants.wall_stiffness * stretch * stretch


@pair_law
def contact(length, inverse, constants):
    """Return (t, ∂t/∂|r|, γ, ∂γ/∂|r|) of a contact within the cut-off x₀, as `wall` does (eq. 2).

    t = λ (x₀⁻⁶ − |r|⁻⁶), γ = γ₀ |r|^(−7/2) (1 − (|r|/x₀)⁶). What a kernel does not use of the four
    costs nothing.

    length, inverse: |r| and 1/|r|, lanes.
    """
    inverse_3 = inverse * inverse * inverse
    inverse_6 = inverse_3 * inverse_3
    beyond = 1.0 / constants.cutoff**6
    cube = length * length * length
    fade = cube * cube * beyond
    critical = constants.contact_damping * inverse_3 * inverse_root(length)
    tension = constants.repulsion * (beyond - inverse_6)
    stiffness = 6.0 * constants.repulsion * inverse_6 * inverse
    damping = critical * (1.0 - fade)
    damping_slope = critical * inverse * (-3.5 * (1.0 - fade) - 6.0 * fade)
    return tension, stiffness, damping, damping_slope


@pair_law
def tension(law, rate):
    """Return the tension t + γ n·w of a bond or contact, µN; `rate` is n·w.

    law: (t, ∂t/∂|r|, γ, ∂γ/∂|r|), as `wall` and `contact` return it.
    """
    t, _, damping, _ = law
    return t + damping * rate


@pair_law
def within(length, value, constants):
    """Return the value where a contact acts, and 0 beyond the cut-off."""
    return where_less(length, constants.cutoff, value, 0.0)


@pair_law
def contact_bend(inverse, constants):
    """Return ∂²t/∂|r|² = −42 λ |r|⁻⁸ of a contact's elastic tension, within the cut-off."""
    inverse_4 = inverse * inverse * inverse * inverse
    return -42.0 * constants.repulsion * inverse_4 * inverse_4


@pair_law
def contact_energy(length, inverse, constants):
    """Return the stored energy of a contact, pJ: λ [r⁻⁵/5 + r x₀⁻⁶ − 6/5 x₀⁻⁵]."""
    inverse_5 = inverse * inverse * inverse * inverse * inverse
    energy = constants.repulsion * (
        0.2 * inverse_5 + length * (1.0 / constants.cutoff**6) - 1.2 / constants.cutoff**5
    )
    return within(length, energy, constants)


@pair_law
def fluid_coefficients(slope_over_length, volume_i, volume_j, constants):
    """Return (a, b) of the force f = a r + b w on the first particle of a fluid pair (eq. 8).

    The pressure gives a = m² c_s² (W′/|r|) (V_i + V_j), the viscosity b = −2 m² µ (W′/|r|) V_i V_j.

    slope_over_length: W′/|r|. volume_i, volume_j: V = 1/ρ, µm²/ng.
    """
    weight = constants.fluid_mass * constants.fluid_mass * slope_over_length
    pressure = weight * constants.sound_speed_squared * (volume_i + volume_j)
    viscous = -2.0 * weight * constants.viscosity * volume_i * volume_j
    return pressure, viscous


@pair_law
def fluid_volume_slopes(slope_over_length, other_volume, constants):
    """Return ∂(a, b)/∂V_i of `fluid_coefficients` at fixed positions; other_volume is V_j."""
    weight = constants.fluid_mass * constants.fluid_mass * slope_over_length
    pressure_slope = weight * constants.sound_speed_squared
    viscous_slope = -2.0 * weight * constants.viscosity * other_volume
    return pressure_slope, viscous_slope


@pair_law
def spline(s, h):
    """Return the smoothing kernel W (eq. 5) at s = r/h, lanes, 1/µm²."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h) * (0.25 * outer * outer * outer - inner * inner * inner)


@pair_law
def spline_slope(s, h):
    """Return dW/dr at s = r/h, lanes, 1/µm³."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h * h) * (3.0 * inner * inner - 0.75 * outer * outer)


@pair_law
def spline_curvature(s, h):
    """Return d²W/dr² at s = r/h, lanes, 1/µm⁴."""
    outer = where_less(s, 2.0, 2.0 - s, 0.0)
    inner = where_less(s, 1.0, 1.0 - s, 0.0)
    return SIGMA / (h * h * h * h) * (1.5 * outer - 6.0 * inner)


@pair_law
def spline_bend(slope_over_length, length, inverse, h):
    """Return d(W′/|r|)/d|r| = (W″ − W′/|r|)/|r|, 1/µm⁵, from W′/|r|, |r| and 1/|r|."""
    return (spline_curvature(length * (1.0 / h), h) - slope_over_length) * inverse

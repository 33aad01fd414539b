"""Viscous cell fluid by smoothed particle hydrodynamics (eqs. 5 to 9).

Density by summation over the fluid of the same plant cell, the particle itself included; pressure
p = c_s² ρ with no reference density, so p_i/ρ_i² = c_s²/ρ_i. Force on i::

    f = m² (W′/|r|) [c_s² (1/ρ_i + 1/ρ_j) r − 2µ/(ρ_i ρ_j) w]

The viscous part (Morris form) is not central: it makes torque. The elastic part is the gradient
of Σ m c_s² ln ρ_i.
"""

from __future__ import annotations

from surrofe2.compilation import pair_law


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

"""Pair laws and the forces of a tile of plant cells: eqs. (1), (2), (8) summed up.

Formulas are those of docs/theory.md, forces. The paper prints γ x·v in (1), which critical damping
contradicts, with the sign of x_i − x_j. The factor 1 − (r/x₀)⁶ of the contacts' dashpot in (2) is
ours, for the printed one jumps at the cut-off. The viscous part of (8), in Morris's form, is not
central: it makes torque. The spline (5) has no branch: with q₊ = max(q, 0) and s = r/h,
W = σ/h² [(2 − s)₊³/4 − (1 − s)₊³].

Kernels work on local particles, own ones first, then images: x, v, f are (2, local, TILE) in µm,
µm/µs, µN. `fold_images` adds what images feel to their owners. A central pair is a bond between
wall neighbours (eq. 1) or a contact (eq. 2); `is_bond` is the same for all pairs of a list.
Tension t > 0 pulls the two together; the force on i is t n, n = r/|r|.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel, pair_law
from surrofe2.base.simd import TILE, inverse_root, load, spread, store, where_less
from surrofe2.plant_cell.parameters import CellParameters

Reals = NDArray[np.float64]

SIGMA = 10.0 / (7.0 * np.pi)


class Constants(NamedTuple):
    """What the pair laws need of `CellParameters`, ready for use in kernels (µm, µs, ng)."""

    wall_stiffness: float
    rest_length: float
    wall_damping: float
    repulsion: float
    cutoff: float
    contact_damping: float
    smoothing_length: float
    fluid_mass: float
    sound_speed_squared: float
    viscosity: float


def make_constants(cell: CellParameters, rest_length: float) -> Constants:
    """Constants of eqs. (1), (2), (8), (9) for one set of parameters."""
    m, k, strength = cell.wall_particle_mass, cell.wall_stiffness, cell.repulsion_strength
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
        viscosity=cell.viscosity,
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
    inverse_6, beyond = inverse_3 * inverse_3, 1.0 / c.cutoff**6
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


# Pairs and their sums


class Workspace(NamedTuple):
    """Scratch of one tile: local material positions z, x, v, f (2, local, TILE), and its fluid.

    slope: (pairs, TILE) W′/|r| of fluid pairs; volume: (fluid, TILE) 1/ρ.
    """

    z: Reals
    x: Reals
    v: Reals
    f: Reals
    slope: Reals
    volume: Reals


@kernel
def make_workspace(topology):
    """Uninitialised scratch for one tile."""
    local = topology.particles + topology.owner.shape[0]
    return Workspace(
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((2, local, TILE)),
        np.empty((topology.fluid_pairs.shape[0], TILE)),
        np.empty((topology.particles - topology.walls, TILE)),
    )


class Pair(NamedTuple):
    """r = x_j − x_i and w = v_j − v_i, lanes each.

    length is |r|, inverse 1/|r|, (nx, ny) = r/|r|, rate n·w.
    """

    rx: float
    ry: float
    wx: float
    wy: float
    nx: float
    ny: float
    length: float
    inverse: float
    rate: float


@pair_law
def difference(x, i, j):
    """x_j − x_i, both components."""
    return load(x, 0, j) - load(x, 0, i), load(x, 1, j) - load(x, 1, i)


@pair_law
def norm(rx, ry):
    """(|r|, 1/|r|)."""
    square = rx * rx + ry * ry
    inverse = inverse_root(square)
    return square * inverse, inverse


@pair_law
def pair_at(x, v, i, j):
    """The `Pair` of particles i and j; what a kernel does not use of it costs nothing."""
    rx, ry = difference(x, i, j)
    wx, wy = difference(v, i, j)
    length, inverse = norm(rx, ry)
    rate = (rx * wx + ry * wy) * inverse
    return Pair(rx, ry, wx, wy, rx * inverse, ry * inverse, length, inverse, rate)


@pair_law
def add_pair(f, i, j, fx, fy):
    """f on i, −f on j."""
    store(load(f, 0, i) + fx, f, 0, i)
    store(load(f, 1, i) + fy, f, 1, i)
    store(load(f, 0, j) - fx, f, 0, j)
    store(load(f, 1, j) - fy, f, 1, j)


@pair_law
def central_law(pair, is_bond, weight, c):
    """Weight that acts, and (t, ∂t/∂|r|, γ, ∂γ/∂|r|): the tension is that times t + γ n·w.

    t alone is elastic. One weight for all of them is 0 beyond the cut-off: one selection of lanes.
    """
    if is_bond:
        elastic, stiffness, damping, _ = wall(pair.length, c)
        law = elastic, spread(stiffness), spread(damping), spread(0.0)
        acting = spread(weight)
    else:
        law = contact(pair.length, pair.inverse, c)
        acting = within(pair.length, weight, c)
    return acting, law


@kernel
def add_central_forces(x, v, f, pairs, weight, is_bond, c):
    """Add wall tensions (eq. 1) or contact repulsion (eq. 2) to f.

    weight (pairs,) scales the whole force of a pair: ½ where one of the two walls is missing
    (docs/theory.md, walls at a free boundary); c(r) keeps the parameter m_wall.
    """
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        pair = pair_at(x, v, i, j)
        acting, law = central_law(pair, is_bond, weight[k], c)
        a = acting * pair.inverse * tension(law, pair.rate)
        add_pair(f, i, j, a * pair.rx, a * pair.ry)


@kernel
def add_fluid_forces(x, v, f, topology, c, slope, volume):
    """Add pressure and viscous forces (eq. 8) to f.

    Scratch, filled here: slope (pairs, TILE) W′/|r|; volume (fluid, TILE) 1/ρ.
    """
    pairs, first = topology.fluid_pairs, topology.walls
    fluid_specific_volume(x, topology, c, slope, volume)
    for k in range(pairs.shape[0]):
        i, j = pairs[k, 0], pairs[k, 1]
        rx, ry = difference(x, i, j)
        wx, wy = difference(v, i, j)
        volume_i, volume_j = load(volume, i - first), load(volume, j - first)
        a, b = fluid_coefficients(load(slope, k), volume_i, volume_j, c)
        add_pair(f, i, j, a * rx + b * wx, a * ry + b * wy)


@kernel
def fluid_specific_volume(x, topology, c, slope, volume):
    """volume = 1/ρ of eq. (7) and slope = W′/|r| of every fluid pair."""
    pairs, first = topology.fluid_pairs, topology.walls
    h = c.smoothing_length
    own = c.fluid_mass * spline(spread(0.0), h)
    for p in range(volume.shape[0]):
        store(own, volume, p)
    for k in range(pairs.shape[0]):
        p, q = pairs[k, 0] - first, pairs[k, 1] - first
        rx, ry = difference(x, pairs[k, 0], pairs[k, 1])
        length, inverse = norm(rx, ry)
        s = length * (1.0 / h)
        store(spline_slope(s, h) * inverse, slope, k)
        density = c.fluid_mass * spline(s, h)
        store(load(volume, p) + density, volume, p)
        store(load(volume, q) + density, volume, q)
    for p in range(volume.shape[0]):
        store(1.0 / load(volume, p), volume, p)


@kernel
def local_forces(work, topology, c):
    """work.f at work.x and work.v: forces on own particles and, not yet folded, on images."""
    work.f[:] = 0.0
    x, v, f = work.x, work.v, work.f
    add_central_forces(x, v, f, topology.bonds, topology.bond_weight, True, c)
    add_central_forces(x, v, f, topology.contacts, topology.contact_weight, False, c)
    add_fluid_forces(x, v, f, topology, c, work.slope, work.volume)


@kernel
def fold_images(f, topology):
    """Add the forces on images to their owners; own particles then feel the whole force."""
    own = topology.particles
    for k in range(topology.owner.shape[0]):
        i = topology.owner[k]
        store(load(f, 0, i) + load(f, 0, own + k), f, 0, i)
        store(load(f, 1, i) + load(f, 1, own + k), f, 1, i)


@kernel
def add_central_energy(x, pairs, weight, is_bond, c, energy):
    """Add the stored energy of bonds or contacts, pJ, to energy (1, TILE); weight as above."""
    total = spread(0.0)
    for k in range(pairs.shape[0]):
        rx, ry = difference(x, pairs[k, 0], pairs[k, 1])
        length, inverse = norm(rx, ry)
        energy_of = wall_energy(length, c) if is_bond else contact_energy(length, inverse, c)
        total += weight[k] * energy_of
    store(load(energy, 0) + total, energy, 0)


@kernel
def elastic_energy(work, topology, c, energy):
    """energy (1, TILE) at work.x: of bonds, contacts and fluid, Σ m c_s² ln ρ, pJ."""
    x, volume = work.x, work.volume
    store(0.0, energy, 0)
    add_central_energy(x, topology.bonds, topology.bond_weight, True, c, energy)
    add_central_energy(x, topology.contacts, topology.contact_weight, False, c, energy)
    fluid_specific_volume(x, topology, c, work.slope, volume)
    for p in range(volume.shape[0]):
        for lane in range(TILE):
            energy[0, lane] -= c.fluid_mass * c.sound_speed_squared * np.log(volume[p, lane])

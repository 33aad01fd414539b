"""A look into RVEs: their particles, forces, pressures and walls at given points.

Everything is computed from positions by the pair laws of docs/theory.md in plain numpy, so it is
also an independent check of the kernels: the virial of these forces is the law's stress.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy  # scipy.sparse is loaded where particles are looked at
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.plant_cell.arrangement import make_arrangement, rim_areas
from surrofe2.plant_cell.neighbours import Topology
from surrofe2.rve.unit_cell import UnitCell


@dataclass(frozen=True, slots=True)
class Particles:
    """The particles of n RVEs, walls first, then SPH fluid, of one periodic unit each.

    Where arrays of the fluid have f columns, these are its SPH particles, or the plant cells if
    their fluid is uniform.

    Attributes:
        F, F_dot: (n, 2, 2) deformation and rate.
        position: (n, p, 2) µm.
        velocity: (n, p, 2) µm/µs.
        force: (n, p, 2) total force on each particle, zero but for the solver's tolerance, µN.
        density: (n, f) density of the fluid, ng/µm².
        pressure: (n, f) pressure of the fluid, MPa.
        bonds: (b, 2) own wall particles i, j that a wall spring joins.
        bond_shift: (b, 2) lattice shift of the image of j that is joined.
        tension: (n, b) tension of each spring, µN.
        stretch: (n, b) length of each spring over its rest length.
        contact_pressure: (n, walls) largest force of the fluid on one side of the wall particle
            per area of wall, MPa. Its length is that at rest with SPH fluid, whose particles push
            at a few places; with a uniform fluid it is the stretched one, so that this is its
            pressure but for viscosity.
        area_ratio: (n, cells) area within the walls over that in the reference.
        stress: (n, 2, 2) Cauchy stress as the virial of all pairs, µN/µm.
        wall_stress, fluid_stress: (n, 2, 2) parts of it by pairs of two wall particles, and by
            pairs of two fluid particles.
        is_wall: (p,) whether a particle is a wall particle.
        fluid_cell: (f,) plant cell of the fluid.
        rims: wall particles around each plant cell, and their shifts (a, b), (k, 3) each.
        lattice: (2, 2) periods of the reference, its columns, µm; they move along with F.
    """

    F: Array
    F_dot: Array
    position: Array
    velocity: Array
    force: Array
    density: Array
    pressure: Array
    bonds: Index
    bond_shift: Index
    tension: Array
    stretch: Array
    contact_pressure: Array
    area_ratio: Array
    stress: Array
    wall_stress: Array
    fluid_stress: Array
    is_wall: Flags
    fluid_cell: Index
    rims: tuple[NDArray[np.int32], ...]
    lattice: Array

    def extremes(self) -> dict[str, Array]:
        """Return figures of how near tissue is to bruising, (n,) each, by name with its unit.

        They are the largest value, mean or range over an RVE.
        """
        return {
            "largest_wall_stretch": self.stretch.max(axis=1),
            "largest_wall_tension_uN": self.tension.max(axis=1),
            "mean_fluid_pressure_MPa": self.pressure.mean(axis=1),
            "lowest_fluid_pressure_MPa": self.pressure.min(axis=1),
            "highest_fluid_pressure_MPa": self.pressure.max(axis=1),
            "smallest_cell_area_ratio": self.area_ratio.min(axis=1),
            "largest_cell_area_ratio": self.area_ratio.max(axis=1),
            "largest_contact_pressure_MPa": self.contact_pressure.max(axis=1),
        }


class _Pairs(NamedTuple):
    """Pairs of particles in n RVEs.

    i, j: (k,) own particles. shift: (k, 2) lattice shift of j.
    r, w: (n, k, 2) x_j − x_i, µm, and v_j − v_i, µm/µs. length: (n, k) |r|, µm.
    rate: (n, k) rate of the length, µm/µs.
    """

    i: Index
    j: Index
    shift: Index
    r: Array
    w: Array
    length: Array
    rate: Array


def look_into(unit: UnitCell, F: Array, F_dot: Array, z: Array, fluctuation: Array) -> Particles:
    """Compute the particles of RVEs at material positions z, with velocities Ḟ z + fluctuation.

    Args:
        F, F_dot: (n, 2, 2).
        z: (n, p, 2) material positions, x = F z, µm.
        fluctuation: (n, p, 2) µm/µs.
    """
    cell = unit.cell
    topology = unit.topology
    lattice = unit.reference.lattice
    arrangement = make_arrangement(cell)
    x = np.einsum("nij,npj->npi", F, z)
    v = np.einsum("nij,npj->npi", F_dot, z) + fluctuation
    force = np.zeros_like(x)
    area = (np.linalg.det(F) * topology.area)[:, None, None]

    def pairs_of(listed: NDArray[np.int32]) -> _Pairs:
        """Return the pairs that are listed by local particles (k, 2)."""
        return _pairs(unit, listed, x, v, F, F_dot)

    def act(pairs: _Pairs, forces: Array) -> Array:
        """Add forces (n, k, 2) on i, and their opposites on j, to `force`.

        Returns:
            (n, k, 2, 2) the virial of each pair as stress, µN/µm.
        """
        force[:] += _summed(pairs.i, forces, topology.particles)
        force[:] -= _summed(pairs.j, forces, topology.particles)
        return np.einsum("nki,nkj->nkij", forces, pairs.r) / area[:, None]

    # walls, (1)
    bonds = pairs_of(topology.bonds)
    tension = cell.wall_stiffness * (bonds.length - unit.rest_length)
    tension += unit.constants.wall_damping * bonds.rate
    bond_stress = act(bonds, (tension / bonds.length)[:, :, None] * bonds.r).sum(axis=1)

    # contacts, (2)
    contacts = pairs_of(topology.contacts)
    tension_over_length = _contact_tension(unit, contacts) / contacts.length
    pushes = tension_over_length[:, :, None] * contacts.r
    contact_stress = act(contacts, pushes)
    # walls are numbered before fluid
    between_walls = np.maximum(contacts.i, contacts.j) < topology.walls

    starts = topology.fluid_start.astype(np.int64)
    if topology.pressures:
        fluid_cell = np.arange(topology.pressures)
        density, pressure, fluid_stress, pushed = _uniform_fluid(unit, x, v, F, F_dot, force)
    else:
        fluid_cell = np.repeat(np.arange(starts.size - 1), np.diff(starts))
        fluid = pairs_of(topology.fluid_pairs)
        density, forces = _sph_fluid(unit, fluid)
        pressure = cell.sound_speed**2 * density
        fluid_stress = act(fluid, forces).sum(axis=1)
        pushed = _push_on_walls(topology, contacts, pushes, fluid_cell) / unit.rest_length
    rims = rim_areas(arrangement.rims, x, F @ lattice)
    at_rest = rim_areas(arrangement.rims, unit.position, lattice)
    return Particles(
        F=F,
        F_dot=F_dot,
        position=x,
        velocity=v,
        force=force,
        density=density,
        # in the plane pressures are forces per length; over the thickness of the tissue, in MPa
        pressure=pressure / cell.tissue_thickness,
        bonds=np.stack([bonds.i, bonds.j], axis=1),
        bond_shift=bonds.shift,
        tension=tension,
        stretch=bonds.length / unit.rest_length,
        contact_pressure=pushed / cell.tissue_thickness,
        area_ratio=rims / at_rest,
        stress=bond_stress + contact_stress.sum(axis=1) + fluid_stress,
        wall_stress=bond_stress + contact_stress[:, between_walls].sum(axis=1),
        fluid_stress=fluid_stress,
        is_wall=np.arange(topology.particles) < topology.walls,
        fluid_cell=fluid_cell,
        rims=arrangement.rims,
        lattice=lattice,
    )


def _pairs(
    unit: UnitCell, listed: NDArray[np.int32], x: Array, v: Array, F: Array, rate: Array
) -> _Pairs:
    """Return the pairs of local particles `listed` (k, 2), with owners instead of images.

    x, v: (n, p, 2). F, rate: (n, 2, 2).
    """
    owner = np.append(np.arange(unit.topology.particles), unit.topology.owner)
    # own particles have no shift
    shifts = np.pad(unit.neighbours.shift, ((unit.topology.particles, 0), (0, 0))).astype(np.int64)
    i, j = owner[listed].T
    shift = shifts[listed[:, 1]] - shifts[listed[:, 0]]
    offset = shift @ unit.reference.lattice.T
    r = x[:, j] - x[:, i] + offset @ F.transpose(0, 2, 1)
    w = v[:, j] - v[:, i] + offset @ rate.transpose(0, 2, 1)
    length = np.linalg.norm(r, axis=2)
    return _Pairs(i, j, shift, r, w, length, np.einsum("nki,nki->nk", r, w) / length)


def _contact_tension(unit: UnitCell, pairs: _Pairs) -> Array:
    """Return the tension (n, k) of contacts, eq. (2), µN; repulsion is negative."""
    constants = unit.constants
    r = pairs.length
    fade = (r / constants.cutoff) ** 6
    spring = constants.repulsion * (r**-6 - constants.cutoff**-6)
    dashpot = constants.contact_damping * r**-3.5 * (1.0 - fade) * pairs.rate
    return np.where(r < constants.cutoff, dashpot - spring, 0.0)


def _uniform_fluid(
    unit: UnitCell, x: Array, v: Array, F: Array, rate: Array, force: Array
) -> tuple[Array, Array, Array, Array]:
    """Compute a uniform fluid, and add its forces on walls to `force` (n, p, 2).

    See docs/theory.md, uniform fluid, and `plant_cell.uniform_fluid`.

    Returns:
        Densities and pressures (n, cells), stress (n, 2, 2), and the largest pressure on each
        particle, (n, p).
    """
    topology = unit.topology
    lattice = unit.reference.lattice
    cell = unit.cell
    rims = make_arrangement(unit.cell).rims
    area = rim_areas(rims, x, F @ lattice)
    modulus = cell.sap_bulk_modulus * cell.tissue_thickness
    density = topology.fluid_mass / area
    pressure = cell.sound_speed**2 * density + modulus * (topology.rest_area / area - 1.0)
    virial = np.zeros_like(F)
    pushed = np.zeros(force.shape[:2])
    for k, rim in enumerate(rims):
        offset = rim[:, 1:] @ lattice.T
        corner = x[:, rim[:, 0]] + offset @ F.transpose(0, 2, 1)
        speed = v[:, rim[:, 0]] + offset @ rate.transpose(0, 2, 1)
        # g_k, half the way from the particle before to the one after, turned outwards
        along = 0.5 * (np.roll(corner, -1, axis=1) - np.roll(corner, 1, axis=1))
        normal = np.stack([along[..., 1], -along[..., 0]], axis=-1)
        L = np.einsum("nka,nkb->nab", speed, normal) / area[:, k, None, None]
        dilation = pressure[:, k] + cell.viscosity * L.trace(axis1=1, axis2=2)
        stress = dilation[:, None, None] * np.eye(2) - cell.viscosity * (L + L.transpose(0, 2, 1))
        push = normal @ stress
        force += _summed(rim[:, 0].astype(np.int64), push, topology.particles)
        virial -= np.einsum("nka,nkb->nab", push, corner)
        # across the wall, over the length that the particle stands for, stretched as it is
        sides = (push * normal).sum(axis=2) / (normal * normal).sum(axis=2)
        np.maximum.at(pushed.T, rim[:, 0], sides.T)
    return density, pressure, virial / (np.linalg.det(F) * topology.area)[:, None, None], pushed


def _sph_fluid(unit: UnitCell, pairs: _Pairs) -> tuple[Array, Array]:
    """Return densities (n, f) of SPH fluid, eq. (7), and forces (n, k, 2) on i, eq. (8)."""
    cell = unit.cell
    h = unit.constants.smoothing_length
    s = pairs.length / h
    # σ/h² of (5), which is also W(0): ¼ · 2³ − 1³ = 1
    scale = 10.0 / (7.0 * np.pi) / h**2
    outer = np.maximum(2.0 - s, 0.0)
    inner = np.maximum(1.0 - s, 0.0)
    kernel = scale * (0.25 * outer**3 - inner**3)
    slope = scale / h * (3.0 * inner**2 - 0.75 * outer**2) / pairs.length
    walls = unit.topology.walls
    mass = unit.constants.fluid_mass
    i = pairs.i - walls
    j = pairs.j - walls
    n_fluid = unit.topology.particles - walls
    density = mass * (scale + _summed(i, kernel, n_fluid) + _summed(j, kernel, n_fluid))
    a = 1.0 / density[:, i]
    b = 1.0 / density[:, j]
    # coefficients of r and of w in (8)
    along = mass**2 * slope * cell.sound_speed**2 * (a + b)
    against = -2.0 * mass**2 * slope * unit.constants.viscosity * a * b
    return density, along[:, :, None] * pairs.r + against[:, :, None] * pairs.w


def _push_on_walls(topology: Topology, pairs: _Pairs, pushes: Array, fluid_cell: Index) -> Array:
    """Return the largest force (n, walls) of the fluid of one plant cell on wall particles, µN.

    A plant cell and its image, which lie on both sides of a wall, count as two.

    Args:
        pairs: contacts.
        pushes: (n, k, 2) forces on their first particles, µN.
        fluid_cell: (f,) plant cell of each fluid particle.
    """
    i_is_wall = pairs.i < topology.walls
    j_is_wall = pairs.j < topology.walls
    of_wall_and_fluid = np.flatnonzero(i_is_wall != j_is_wall)
    i = pairs.i[of_wall_and_fluid]
    j = pairs.j[of_wall_and_fluid]
    wall_first = i_is_wall[of_wall_and_fluid]
    wall = np.where(wall_first, i, j)
    fluid = np.where(wall_first, j, i) - topology.walls
    shift = np.where(wall_first, 1, -1)[:, None] * pairs.shift[of_wall_and_fluid]
    # a side of a wall particle: the particle, the plant cell beside it, and the shift of that
    sides = np.column_stack([wall, fluid_cell[fluid], shift])
    unique_sides, side = np.unique(sides, axis=0, return_inverse=True)
    on_wall = pushes[:, of_wall_and_fluid] * np.where(wall_first, 1.0, -1.0)[:, None]
    total = np.linalg.norm(_summed(side.ravel(), on_wall, len(unique_sides)), axis=2)
    largest = np.zeros((topology.walls, len(pushes)))
    np.maximum.at(largest, unique_sides[:, 0], total.T)
    return largest.T


def _summed(target: Index, values: Array, size: int) -> Array:
    """Return sums (n, size, …) of values (n, k, …) by their targets (k,), numbers below size."""
    entries = np.ones(target.size), (target, np.arange(target.size))
    matrix = scipy.sparse.csr_matrix(entries, (size, target.size))
    sums = matrix @ values.swapaxes(0, 1).reshape(target.size, -1)
    return np.asarray(sums).reshape(size, len(values), *values.shape[2:]).swapaxes(0, 1)

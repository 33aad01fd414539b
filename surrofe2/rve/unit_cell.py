"""An RVE at rest: its reference state settled, its neighbours, its factorisation at F = I.

The paper starts "from this cell in its equilibrium state", and its tissue measures an exact
multiple of the cell: so the wall rest length l₀ follows from σ(I, 0) = 0 with particles relaxed.
Irregular cells also need the shape of the box at its given area (regular ones need no change of
shape, by symmetry); the stress of an elastic equilibrium is symmetric, so these three numbers free
it. Where starts lead to several equilibria, the stable one of least energy is taken, at the l₀ of
one square cell and in the box as it was laid out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import scipy  # scipy.optimize and scipy.linalg are loaded where a state has to be settled

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE, pack, tiles_for, unpack
from surrofe2.plant_cell.arrangement import (
    Arrangement,
    ReferenceState,
    make_arrangement,
    start_positions,
)
from surrofe2.plant_cell.neighbours import Near, Neighbours, Topology, make_neighbours
from surrofe2.plant_cell.pair_laws import Constants, make_constants
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve.constrained_runs import Stepping, iterate
from surrofe2.rve.newton import SOLVE, newton, renew
from surrofe2.rve.rve_state import (
    Drive,
    Factors,
    RveState,
    empty_answer,
    stored_energy,
)

STARTS = TILE
"""Starts from which irregular plant cells are relaxed: as many as a tile solves at once."""
FREE_OF_STRESS = 1e-11
"""Largest stress of the reference over c_s² times the density of the tissue."""
RELAXED = 1e-10
"""Mean force, µN, at which Newton's method stops."""
SAME_ENERGY = 1e-7
"""Equilibria whose energies differ relatively by less are the same or images of each other."""
_FIRST_GUESS = 0.5
"""First guess of l₀ of one square cell, over the length of a spring. It is 0.55 with `printed` and
0.93 with `water`."""
_TRIALS = 200
"""Most evaluations of the stress in the search for l₀ and the box."""
_DIFFERENCE = 1e-5
"""Relative step of the differences that this search takes the slopes of stress by."""
_SETTLED_STRESS = 1e-14
"""Relative change of l₀ and the box at which the search ends."""
_SETTLING_STEP = 1e-3
"""Time step in which particles come to rest, µs."""
_SETTLING_LIMIT = 300_000
"""Most of these steps."""
_SETTLED = {"square": 1.0, "hexagon": 1.0, "voronoi": 1e-4}
"""Mean force, µN, at which Newton's method takes over. It must stay in the basin of the equilibrium
that particles approach, and irregular cells have many."""


@dataclass(frozen=True, slots=True)
class UnitCell:
    """Reference state of an RVE, with its neighbours and factors.

    Attributes:
        cell: parameters of its plant cells.
        reference: relaxed positions, lattice and rest length.
        constants: constants of its pair laws.
        neighbours: everyone who can interact.
        near: the contacts near the reference, one tile.
        factors: factors at the reference, one tile.
    """

    cell: CellParameters
    reference: ReferenceState
    constants: Constants
    neighbours: Neighbours
    near: Near
    factors: Factors

    @property
    def position(self) -> Array:
        """Relaxed reference positions (n, 2), µm; particle 0 is a wall corner at 0."""
        return self.reference.position

    @property
    def rest_length(self) -> float:
        """Wall rest length l₀, µm, at which the reference is free of stress."""
        return self.reference.rest_length

    @property
    def topology(self) -> Topology:
        """Everyone who can interact."""
        return self.neighbours.topology

    def rest_state(self, points: int, of: str) -> RveState:
        """Return the state of n RVEs at F = I, Ḟ = 0 in the reference, with the factors there.

        of: name of the law that it is a state of.
        """
        tiles = tiles_for(points)
        z = np.repeat(self.near.z, tiles, axis=0)
        F = np.repeat(self.near.F, tiles, axis=0)
        return RveState(
            of=of,
            points=points,
            z=z,
            F=F,
            F_dot=np.zeros_like(F),
            factors=self.factors.repeated(tiles),
            near=replace(self.near, F=F, z=z),
            iterations=np.zeros((tiles, TILE), dtype=np.int32),
            has_left=np.zeros((tiles, TILE), dtype=np.bool_),
        )


@lru_cache(maxsize=32)
def make_unit_cell(cell: CellParameters, reference: ReferenceState | None = None) -> UnitCell:
    """Make the RVE of `cell` around its reference state, which is settled here if it is None.

    Raises:
        InputError: no positive rest length balances the turgor, or no stable equilibrium exists.
        MismatchError: the reference is of another cell.
    """
    if reference is None:
        # by the reference, which is one object in its cache: both ways to ask share one unit cell
        return make_unit_cell(cell, settle_reference(cell))
    reference.check_belongs_to(cell)
    position = reference.position
    if len(position) != make_arrangement(cell).particles:
        raise InputError("reference: another number of particles; settle it again")
    return unit_around(cell, reference, make_neighbours(cell, position, reference.lattice))


def unit_around(
    cell: CellParameters, reference: ReferenceState, neighbours: Neighbours
) -> UnitCell:
    """Make the RVE of particles at rest in `reference`, with their neighbours and factors.

    Raises:
        InputError: the reference is not stable.
    """
    constants = make_constants(cell, reference.rest_length)
    z = pack(reference.position.T[None])
    identity = pack(np.eye(2)[None])
    near = neighbours.near(identity, z)
    drive = Drive(identity, np.zeros_like(identity))
    factors = Factors.empty(drive, z, near.topology)
    stable = renew(drive, z, factors.address, np.array([True]), near.topology, constants)
    if not stable.all():
        raise InputError("reference: not a stable equilibrium of this cell; settle it again")
    return UnitCell(cell, reference, constants, neighbours, near, factors)


@lru_cache(maxsize=32)
def settle_reference(cell: CellParameters) -> ReferenceState:
    """Relax plant cells at F = I and find the rest length (and box) that frees them of stress.

    Raises:
        InputError: no positive rest length balances the turgor, or no stable equilibrium exists.
    """
    if cell.sap_bulk_modulus > 0.0:
        # at rest the sap is neither compressed nor expanded, so it makes no difference
        drained = settle_reference(replace(cell, sap_bulk_modulus=0.0))
        return replace(drained, fingerprint=cell.fingerprint)
    irregular = cell.arrangement == "voronoi"
    # squares take no statistics of shape; one seed, so that all of them share one entry of the
    # cache
    one_square = replace(
        cell,
        arrangement="square",
        cells=1,
        arrangement_seed=1,
        area_variation=0.0,
        elongation=1.0,
        elongation_direction=0.0,
    )
    guess = _FIRST_GUESS * cell.spring_length
    if not cell.is_one_square:
        guess = settle_reference(one_square).rest_length
    lattice = make_arrangement(cell).tessellation.lattice
    # SPH particles in irregular cells come to rest in several ways
    several = irregular and not cell.has_uniform_fluid
    starts = [start_positions(cell, k) for k in range(STARTS if several else 1)]
    equilibria = equilibria_in(cell, lattice, guess, np.array(starts))
    best = lowest(equilibria, cell) if several else 0
    return _free_of_stress(cell, equilibria.z[best], guess, irregular)


def resettled(cell: CellParameters, near: ReferenceState) -> ReferenceState:
    """Settle the reference of a cell of squares or hexagons, from that of almost the same cell."""
    lattice_of_cell = make_arrangement(cell).tessellation.lattice
    stretch = np.linalg.solve(near.lattice.T, lattice_of_cell.T)
    z = np.ascontiguousarray((near.position @ stretch).T)
    return _free_of_stress(cell, z, near.rest_length, irregular=False)


class Equilibria(NamedTuple):
    """Elastic equilibria of k points, as far as they were found.

    z: (k, 2, particles) material positions, µm.
    stress: (k, 2, 2) Cauchy stress, µN/µm.
    energy: (k,) elastic energy of the RVE, pJ; NaN where none was found.
    iterations: (k,) evaluations of forces; not positive where none was found, see `rve_state`.
    is_solved, stable: (k,) whether there is an equilibrium, and whether it is stable.
    """

    z: Array
    stress: Array
    energy: Array
    iterations: Index
    is_solved: Flags
    stable: Flags

    def take(self, index: Index) -> Equilibria:
        """Return the equilibria of the points `index`."""
        return Equilibria._make(values[index] for values in self)


def equilibria_in(
    cell: CellParameters,
    lattice: Array,
    rest_length: float,
    starts: Array,
    arrangement: Arrangement | None = None,
) -> Equilibria:
    """Settle particles from `starts` (k, n, 2) into equilibria at F = I of a box and an l₀.

    SPH particles come to rest in time first; those of starts that do not are left out.

    Args:
        lattice: (2, 2) box, its columns the periods, µm. Starts are in the arrangement's own box
            and are deformed to this one.
        rest_length: l₀, µm.
        arrangement: an arrangement instead of the cell's own.
    """
    arrangement = arrangement or make_arrangement(cell)
    lattice_of_cell = arrangement.tessellation.lattice
    moved = starts @ np.linalg.solve(lattice_of_cell.T, lattice.T)
    drained = replace(cell, sap_bulk_modulus=0.0)  # the area at rest is the one that is sought here
    constants = make_constants(drained, rest_length)
    unit = np.broadcast_to(np.eye(2), (len(moved), 2, 2))
    if cell.has_uniform_fluid:  # Newton's method converges from straight walls
        topology = make_neighbours(cell, moved[0], lattice, arrangement=arrangement).topology
        return relax(topology, constants, np.swapaxes(moved, 1, 2), unit)
    # dashpots that the explicit step bears; where the cell rests does not depend on them
    damped = replace(
        cell,
        wall_damping_ratio=min(cell.wall_damping_ratio, 1.0),
        contact_damping_ratio=min(cell.contact_damping_ratio, 1.0),
    )
    damped_constants = make_constants(damped, rest_length)
    settled = _settled(cell, lattice, damped_constants, moved, arrangement)
    topology = make_neighbours(cell, settled[0], lattice, arrangement=arrangement).topology
    return relax(topology, constants, np.swapaxes(settled, 1, 2), unit[: len(settled)])


def relax(
    topology: Topology,
    constants: Constants,
    starts: Array,
    F: Array,
    tolerance: float = RELAXED,
    task: int = SOLVE,
) -> Equilibria:
    """Solve for equilibria at F (k, 2, 2) by Newton's method from material positions (k, 2, n).

    Args:
        tolerance: mean force at which an equilibrium counts as found, µN.
        task: `SOLVE`, or `SEEK` near the starts; see `newton`.
    """
    points = len(starts)
    z = pack(starts)
    tensors = pack(F)
    drive = Drive(tensors, np.zeros_like(tensors))
    answer = empty_answer(len(z))
    factors = Factors.empty(drive, z, topology)
    tasks = np.full(len(z), task, dtype=np.int8)
    newton(drive, z, factors.address, tasks, topology, constants, tolerance, answer)
    z = unpack(z, points)
    iterations = unpack(answer.iterations, points)
    is_solved = iterations > 0
    energy = np.where(is_solved, stored_energy(F, z, topology, constants), np.nan)
    stable = is_solved & unpack(answer.stable, points)
    stress = unpack(answer.stress, points)
    return Equilibria(z, stress, energy, iterations, is_solved, stable)


def _advice(cell: CellParameters) -> str:
    """Say what to change where an undeformed RVE has no rest.

    The seed decides where irregular plant cells come to rest; the others depend on constants.
    """
    if cell.arrangement == "voronoi":
        advice = f"take another arrangement_seed than {cell.arrangement_seed}, or more cells"
        return advice if cell.has_uniform_fluid else f'{advice}, or fluid = "uniform"'
    if cell.has_uniform_fluid:
        return (
            "check fluid_particle_mass and wall_stiffness, of living tissue turgor and wall_modulus"
        )
    return "check fluid_particle_mass, wall_stiffness, repulsion_strength and the damping ratios"


def lowest(equilibria: Equilibria, cell: CellParameters) -> int:
    """Return the number of the stable equilibrium of least energy; of equal ones the first.

    Raises:
        InputError: none is stable.
    """
    if not equilibria.stable.any():
        raise InputError(
            f"cell: no stable equilibrium of the undeformed RVE was found; {_advice(cell)}"
        )
    energy = np.where(equilibria.stable, equilibria.energy, np.inf)
    is_lowest = energy <= energy.min() + SAME_ENERGY * abs(energy.min())
    return int(np.flatnonzero(is_lowest)[0])


def _settled(
    cell: CellParameters,
    lattice: Array,
    constants: Constants,
    starts: Array,
    arrangement: Arrangement,
) -> Array:
    """Return where particles come to rest at F = I from `starts` (k, n, 2), for those that do.

    Raises:
        InputError: none comes to rest.
    """
    neighbours = make_neighbours(cell, starts[0], lattice, arrangement=arrangement)
    mass = neighbours.mass.copy()
    walls = mass[: arrangement.walls]
    np.maximum(walls, cell.wall_particle_mass, out=walls)  # outer walls may be light
    x = np.ascontiguousarray(np.moveaxis(pack(starts), 2, 1))
    unit = pack(np.broadcast_to(np.eye(2), (len(starts), 2, 2)))
    drive = Drive(unit, np.zeros_like(unit))
    v = np.zeros_like(x)
    answer = empty_answer(len(x))
    stepping = Stepping(_SETTLING_STEP, _SETTLED[cell.arrangement], _SETTLING_LIMIT)
    iterate(drive, x, v, mass, neighbours.topology, constants, stepping, answer)
    is_at_rest = unpack(answer.iterations, len(starts)) >= 0
    if not is_at_rest.any():
        raise InputError(
            "cell: the undeformed RVE does not come to rest "
            f"(mean force {answer.residual.min():.3g} µN); {_advice(cell)}"
        )
    return np.swapaxes(unpack(x, len(starts)), 1, 2)[is_at_rest]


def _free_of_stress(
    cell: CellParameters, z: Array, rest_length: float, irregular: bool
) -> ReferenceState:
    """Solve for l₀ and, of irregular cells, the box's shape by which the stress vanishes.

    The unknowns u are l₀ in spring lengths and, of irregular cells, two strains, of which the
    shape F is the exponential of a symmetric matrix without a trace, so that areas stay.

    Args:
        z: (2, n) material positions near the equilibrium, µm.
        rest_length: first guess of l₀, µm.

    Raises:
        InputError: there is no such l₀, it is not positive, or the equilibrium is not stable.
    """
    lattice = make_arrangement(cell).tessellation.lattice
    topology = make_neighbours(cell, z.T, lattice).topology
    tolerance = FREE_OF_STRESS * cell.density * cell.sound_speed**2
    # where the next solve begins: at the equilibrium of the last
    z_start = z[None].copy()
    not_free = (
        f"cell: no wall rest length and box free the undeformed RVE of stress; {_advice(cell)}"
    )

    def shape(u: Array) -> Array:
        """Return the deformation F (2, 2) of the box."""
        if not irregular:
            return np.eye(2)
        return np.asarray(scipy.linalg.expm([[u[1], u[2]], [u[2], -u[1]]]))

    def stress(u: Array) -> Array:
        """Return sum, difference and shear of the stress, as many as there are unknowns."""
        constants = make_constants(cell, u[0] * cell.spring_length)
        equilibrium = relax(topology, constants, z_start, shape(u)[None])
        if not equilibrium.is_solved[0]:
            raise InputError(not_free)
        z_start[:] = equilibrium.z
        s = equilibrium.stress[0]
        return np.array([s[0, 0] + s[1, 1], s[0, 0] - s[1, 1], s[0, 1] + s[1, 0]])[: len(u)]

    u = np.zeros(3 if irregular else 1)
    u[0] = rest_length / cell.spring_length
    # the relative step of scipy's differences is the root of its `eps`
    options = {"xtol": _SETTLED_STRESS, "maxfev": _TRIALS, "eps": _DIFFERENCE**2}
    u = scipy.optimize.root(stress, u, method="hybr", options=options).x
    if not u[0] > 0.0:
        raise InputError(
            f"cell: the turgor needs a wall rest length of {u[0]:.3g} spring lengths; it must be "
            "positive: lower fluid_particle_mass or sound_speed, or raise wall_stiffness"
        )
    if not np.abs(stress(u)).max() <= tolerance:
        raise InputError(not_free)
    F = shape(u)
    l0 = float(u[0] * cell.spring_length)
    # the deformed box becomes the reference, at F = I
    relaxed = z_start[0].T @ F.T
    box = F @ lattice
    topology = make_neighbours(cell, relaxed, box).topology
    final = relax(topology, make_constants(cell, l0), relaxed.T[None], np.eye(2)[None])
    # raises where it is not stable
    lowest(final, cell)
    return ReferenceState(cell.fingerprint, final.z[0].T.copy(), box, l0)

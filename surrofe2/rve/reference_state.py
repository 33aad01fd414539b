"""Settles the reference state of an RVE: plant cells relaxed at F = I, in a box free of stress.

The paper starts "from this cell in its equilibrium state", and its tissue measures an exact
multiple of the cell: so the wall rest length l₀ follows from σ(I, 0) = 0 with particles relaxed.
Irregular cells also need the shape of the box at its given area (symmetry frees the others of
it); the stress of an elastic equilibrium is symmetric, so these three numbers free it. Where
starts lead to several equilibria, the stable one of least energy is taken, at the l₀ of one
square cell and in the box as it was laid out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import scipy  # scipy.optimize and scipy.linalg are loaded where a state has to be settled
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.plant_cell.arrangement import make_arrangement, start_positions
from surrofe2.plant_cell.block_pattern import make_pattern, sparse_pays
from surrofe2.plant_cell.pair_lists import WHOLE_CELLS, Patch, interacting_groups, make_patches
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.plant_cell.tiles import (
    Constants,
    RveTopology,
    make_constants,
    make_topology,
    pack,
    unpack,
)
from surrofe2.rve.constrained_runs import Stepping, iterate_tile
from surrofe2.rve.newton import SOLVE, newton, solve_tiles
from surrofe2.rve.particle_state import Drive, answer_of, drive_of, empty_answer, energies
from surrofe2.rve.rve_state import Factors
from surrofe2.simd import TILE

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

STARTS = TILE
"""Starts of irregular plant cells."""
FREE_OF_STRESS = 1e-11
"""Largest stress of the reference over c_s² times the fluid's mass per area."""
RELAXED = 1e-10
"""Mean force, µN, at which Newton's method stops."""
SAME_ENERGY = 1e-7
"""Equilibria whose energies differ relatively by less are the same or images of each other."""
_FIRST_GUESS = 0.5
"""l₀ of one square cell over the length of a spring."""
_TRIALS, _DIFFERENCE, _SETTLED_STRESS = 200, 1e-5, 1e-14
_SETTLING_STEP, _SETTLING_LIMIT = 1e-3, 300_000
_SETTLED = {"square": 1.0, "hexagon": 1.0, "voronoi": 1e-4}
"""Mean force, µN, low enough that Newton stays in the basin: irregular cells have many."""
_NOT_FREE = (
    "cell: no wall rest length and box free the undeformed RVE of stress; check "
    "fluid_particle_mass, wall_stiffness and repulsion_strength, or take another arrangement_seed"
)


@lru_cache(maxsize=32)
def settle_reference(cell: CellParameters) -> ReferenceState:
    """Relax plant cells at F = I and find the rest length (and box) that frees them of stress.

    Raises:
        InputError: no positive rest length balances the turgor, or no stable equilibrium exists.
    """
    irregular = cell.arrangement == "voronoi"
    one_square = replace(cell, arrangement="square", cells=1, arrangement_seed=1)
    guess = _FIRST_GUESS * cell.spring_length
    if not cell.is_one_square:
        guess = settle_reference(one_square).rest_length
    lattice = make_arrangement(cell).tessellation.lattice
    starts = [start_positions(cell, k) for k in range(STARTS if irregular else 1)]
    found = equilibria_in(cell, lattice, guess, np.array(starts))
    best = lowest(found) if irregular else 0
    return _free_of_stress(cell, found.z[best], guess, irregular)


def make_topologies(
    cell: CellParameters, patches: tuple[Patch, ...], *, sparse: bool | None = None
) -> tuple[RveTopology, ...]:
    """Pair lists for kernels; matrices sparse where that pays, unless it is said."""
    pattern = make_pattern(*interacting_groups(make_arrangement(cell), patches[-1]))
    in_groups = sparse or (sparse is None and sparse_pays(pattern))
    return tuple(make_topology(patch, pattern if in_groups else None) for patch in patches)


@dataclass(frozen=True, slots=True)
class Equilibria:
    """Elastic equilibria of k points.

    Attributes:
        z: (k, 2, particles) material positions, µm.
        stress: (k, 2, 2) Cauchy stress, µN/µm.
        energy: (k,) stored energy of the RVE, pJ; NaN where none was found.
        found, stable: (k,).
    """

    z: Array
    stress: Array
    energy: Array
    found: Flags
    stable: Flags


def equilibria_in(
    cell: CellParameters, lattice: Array, rest_length: float, starts: Array
) -> Equilibria:
    """Equilibria at F = I of a given box and l₀ into which `starts` (k, n, 2) settle.

    Args:
        lattice: (2, 2); starts are given in the arrangement's own box and deformed to this one.

    Raises:
        InputError: no start comes to rest.
    """
    own = make_arrangement(cell).tessellation.lattice
    moved = starts @ np.linalg.solve(own.T, lattice.T)
    constants = make_constants(cell, rest_length)
    settled = _settled(cell, lattice, constants, moved)
    patches = make_patches(cell, settled[0], lattice, WHOLE_CELLS)
    unit = np.broadcast_to(np.eye(2), (len(settled), 2, 2))
    (topology,) = make_topologies(cell, patches)
    return relax(topology, constants, np.swapaxes(settled, 1, 2), unit)


def relax(topology: RveTopology, constants: Constants, starts: Array, F: Array) -> Equilibria:
    """Elastic equilibria at F (k, 2, 2) by Newton from material positions (k, 2, n)."""
    points = len(starts)
    z, tensors = pack(starts), pack(F)
    factors, answer = Factors.empty(len(z), topology), empty_answer(len(z))
    drive, task = Drive(tensors, np.zeros_like(tensors)), np.full(len(z), SOLVE, dtype=np.int8)
    solve_tiles(newton, drive, z, factors.address, task, topology, constants, RELAXED, answer)
    energy = np.empty((len(z), 1, TILE))
    energies(tensors, z, topology, constants, energy)
    found = unpack(answer.iterations, points) > 0
    return Equilibria(
        unpack(z, points),
        unpack(answer.stress, points),
        np.where(found, unpack(energy, points)[:, 0], np.nan),
        found,
        found & unpack(answer.stable, points),
    )


def lowest(equilibria: Equilibria) -> int:
    """The stable equilibrium of least energy; among equal ones the first.

    Raises:
        InputError: none is stable.
    """
    if not equilibria.stable.any():
        raise InputError(
            "cell: no stable equilibrium of the undeformed RVE was found; check "
            "fluid_particle_mass, wall_stiffness and repulsion_strength, or take another "
            "arrangement_seed"
        )
    energy = np.where(equilibria.stable, equilibria.energy, np.inf)
    return int(np.flatnonzero(energy <= energy.min() + SAME_ENERGY * abs(energy.min()))[0])


def _settled(cell: CellParameters, lattice: Array, constants: Constants, starts: Array) -> Array:
    """Where particles come to rest at F = I from `starts` (k, n, 2), of those that do."""
    patches = make_patches(cell, starts[0], lattice, WHOLE_CELLS)
    (topology,) = make_topologies(cell, patches)
    x = np.ascontiguousarray(np.moveaxis(pack(starts), 2, 1))
    unit = pack(np.broadcast_to(np.eye(2), (len(starts), 2, 2)))
    drive, v, answer = Drive(unit, np.zeros_like(unit)), np.zeros_like(x), empty_answer(len(x))
    stepping = Stepping(_SETTLING_STEP, _SETTLED[cell.arrangement], _SETTLING_LIMIT)
    for t in range(len(x)):
        at, said = drive_of(drive, t), answer_of(answer, t)
        iterate_tile(at, x[t], v[t], patches[0].mass, topology, constants, stepping, said)
    rested = unpack(answer.iterations, len(starts)) >= 0
    if not rested.any():
        raise InputError(
            "cell: the undeformed RVE does not come to rest "
            f"(mean force {answer.residual.min():.3g} µN); check fluid_particle_mass, "
            "wall_stiffness and the damping ratios"
        )
    return np.swapaxes(unpack(x, len(starts)), 1, 2)[rested]


def _free_of_stress(
    cell: CellParameters, z: Array, rest_length: float, irregular: bool
) -> ReferenceState:
    """Solve for l₀ and, of irregular cells, the box's shape: F = exp of a traceless matrix."""
    lattice = make_arrangement(cell).tessellation.lattice
    patches = make_patches(cell, z.T, lattice)
    topology = make_topologies(cell, patches)[-1]
    tolerance = FREE_OF_STRESS * cell.density * cell.sound_speed**2
    at = z[None].copy()

    def shape(u: Array) -> Array:
        return (
            np.asarray(scipy.linalg.expm([[u[1], u[2]], [u[2], -u[1]]])) if irregular else np.eye(2)
        )

    def stress(u: Array) -> Array:
        constants = make_constants(cell, u[0] * cell.spring_length)
        found = relax(topology, constants, at, shape(u)[None])
        if not found.found[0]:
            raise InputError(_NOT_FREE)
        at[:] = found.z
        s = found.stress[0]
        return np.array([s[0, 0] + s[1, 1], s[0, 0] - s[1, 1], s[0, 1] + s[1, 0]])[: len(u)]

    u = np.zeros(3 if irregular else 1)
    u[0] = rest_length / cell.spring_length
    options = {"xtol": _SETTLED_STRESS, "maxfev": _TRIALS, "eps": _DIFFERENCE**2}
    u = scipy.optimize.root(stress, u, method="hybr", options=options).x
    if not u[0] > 0.0:
        raise InputError(
            f"cell: the turgor needs a wall rest length of {u[0]:.3g} spring lengths; it must be "
            "positive: lower fluid_particle_mass or sound_speed, or raise wall_stiffness"
        )
    if not np.abs(stress(u)).max() <= tolerance:
        raise InputError(_NOT_FREE)
    F, l0 = shape(u), float(u[0] * cell.spring_length)
    relaxed, box = at[0].T @ F.T, F @ lattice
    topology = make_topologies(cell, make_patches(cell, relaxed, box))[0]
    final = relax(topology, make_constants(cell, l0), relaxed.T[None], np.eye(2)[None])
    lowest(final)
    return ReferenceState(cell.fingerprint, final.z[0].T.copy(), box, l0)

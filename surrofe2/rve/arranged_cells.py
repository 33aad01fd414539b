"""Reference state of any arrangement of plant cells: relaxed, in a box free of stress.

Unknowns are the wall rest length l₀ and the shape of the box at its given area (for irregular
cells; symmetry frees squares and hexagons of it). Particles are relaxed at each trial; the stress
of an elastic equilibrium is symmetric, so three numbers free it: Newton with a Jacobian by
differences, renewed by Broyden's formula. Where starts lead to several equilibria, the stable one
of least energy is taken, at the l₀ of one square cell and in the box as it was laid out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from surrofe2.errors import InputError
from surrofe2.plant_cell.arranged_patch import (
    Candidates,
    Unlisted,
    arranged_patch,
    candidates,
)
from surrofe2.plant_cell.arrangements import (
    Arrangement,
    make_arrangement,
    random_positions,
    start_positions,
)
from surrofe2.plant_cell.block_pattern import Pattern, make_pattern
from surrofe2.plant_cell.geometry import Patch
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tiles import make_constants, make_sparse, make_topology
from surrofe2.rve.equilibria import Equilibria, lowest, relax, settle
from surrofe2.rve.systems import AnyTopology, sparse_pays
from surrofe2.simd import TILE

Array = NDArray[np.float64]

LEVELS = ((1.2, 1.2), (1.4, 1.4), (3.0, 1.4))
"""Reach of lists in cut-offs: of pairs in one plant cell, and of wall pairs in none together."""
_FARTHEST = 3.0
_WHOLE_CELLS = ((np.inf, 1.4),)
"""One list that serves wherever the fluid of a plant cell is."""
STARTS = TILE
FREE_OF_STRESS = 1e-11
"""Largest stress of the reference over c_s² times the fluid's mass per area."""
_TRIALS = 60
_DIFFERENCE = 1e-5


@dataclass(frozen=True, slots=True)
class Lists:
    """Pair lists of rising reach around reference positions, and what each leaves out."""

    patches: tuple[Patch, ...]
    topologies: tuple[AnyTopology, ...]
    unlisted: tuple[Unlisted, ...]


@dataclass(frozen=True, slots=True)
class Reference:
    """Positions (n, 2), lattice (2, 2), l₀, the equilibrium in that box, and its pair lists."""

    position: Array
    lattice: Array
    rest_length: float
    equilibrium: Equilibria
    lists: Lists


def make_lists(
    cell: CellParameters,
    position: Array,
    lattice: Array,
    *,
    sparse: bool | None = None,
    levels: tuple[tuple[float, float], ...] = LEVELS,
) -> Lists:
    """Pair lists of an arrangement; matrices sparse where that pays, unless it is said."""
    arrangement, cutoff = make_arrangement(cell), cell.repulsion_cutoff
    every = candidates(arrangement, position, lattice, _FARTHEST * cutoff)
    pattern = _pattern(arrangement, every, levels[-1][1] * cutoff)
    if sparse is None:
        sparse = sparse_pays(pattern)
    made = [
        arranged_patch(cell, arrangement, position, lattice, every, a * cutoff, b * cutoff)
        for a, b in levels
    ]
    patches = tuple(patch for patch, _ in made)
    topologies: tuple[AnyTopology, ...] = tuple(make_topology(patch) for patch in patches)
    if sparse:
        topologies = tuple(make_sparse(make_topology(patch), pattern) for patch in patches)
    rests = tuple(replace(rest, reach=_FARTHEST * cutoff) for _, rest in made)
    return Lists(patches, topologies, rests)


def find_reference(cell: CellParameters, guess: float) -> Reference:
    """The stress-free reference of an arrangement, l₀ sought from `guess`, µm.

    Raises:
        InputError: no rest length balances the turgor, or no equilibrium is stable.
    """
    irregular = cell.arrangement == "voronoi"
    arrangement = make_arrangement(cell)
    lattice = arrangement.tessellation.lattice
    starts = start_set(cell, STARTS if irregular else 1)
    found = equilibria_in(cell, lattice, guess, starts)
    best = found.z[lowest(found)].T
    reference = _free_of_stress(cell, best, lattice, guess, irregular)
    lowest(reference.equilibrium)
    return reference


def start_set(cell: CellParameters, count: int, *, at_random: bool = False) -> Array:
    """(count, n, 2) positions to settle from, the same for the same parameters, µm."""
    place = random_positions if at_random else start_positions
    return np.array(
        [place(cell, np.random.default_rng([cell.arrangement_seed, k])) for k in range(count)]
    )


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
    lists = make_lists(cell, moved[0], lattice, levels=_WHOLE_CELLS)
    patch = lists.patches[-1]
    settled, rested = settle(lists.topologies[-1], constants, patch.mass, patch.area, moved)
    if not rested.any():
        raise InputError(
            "cell: the undeformed RVE does not come to rest; check fluid_particle_mass, "
            "wall_stiffness and the damping ratios"
        )
    settled = settled[rested]
    lists = make_lists(cell, settled[0], lattice, levels=_WHOLE_CELLS)
    unit = np.broadcast_to(np.eye(2), (len(settled), 2, 2))
    z = np.swapaxes(settled, 1, 2)
    return relax(lists.topologies[-1], constants, patch.area, z, unit)


def _free_of_stress(
    cell: CellParameters, position: Array, lattice: Array, rest_length: float, irregular: bool
) -> Reference:
    """Solve for l₀ and, of irregular cells, the box's shape: F = exp of a traceless matrix."""
    lists = make_lists(cell, position, lattice)
    topology, area = lists.topologies[-1], lists.patches[0].area
    spring = cell.cell_side / cell.wall_springs_per_side
    count = 3 if irregular else 1
    scale = cell.density * cell.sound_speed**2
    z = position.T[None].copy()

    def shape(u: Array) -> Array:
        return np.asarray(expm([[u[1], u[2]], [u[2], -u[1]]])) if irregular else np.eye(2)

    def residual(u: Array) -> Array:
        found = relax(topology, make_constants(cell, u[0] * spring), area, z, shape(u)[None])
        if not found.found[0]:
            return np.full(count, np.nan)
        z[:] = found.z
        s = found.stress[0]
        return np.array([s[0, 0] + s[1, 1], s[0, 0] - s[1, 1], s[0, 1] + s[1, 0]])[:count]

    u = np.zeros(count)
    u[0] = rest_length / spring
    u = _broyden(residual, u, FREE_OF_STRESS * scale)
    if not u[0] > 0.0:
        raise InputError(
            f"cell: the turgor needs a wall rest length of {u[0]:.3g} spring lengths; it must be "
            "positive: lower fluid_particle_mass or sound_speed, or raise wall_stiffness"
        )
    F, l0 = shape(u), float(u[0] * spring)
    relaxed, box = z[0].T @ F.T, F @ lattice
    here = make_lists(cell, relaxed, box)
    final = relax(
        here.topologies[0], make_constants(cell, l0), area, relaxed.T[None], np.eye(2)[None]
    )
    return Reference(final.z[0].T.copy(), box, l0, final, here)


def _broyden(residual, u, tolerance):
    """Zero of a function of few unknowns, by Broyden's good method from a difference Jacobian."""
    value = residual(u)
    slope = np.stack(
        [(residual(u + _DIFFERENCE * e) - value) / _DIFFERENCE for e in np.eye(len(u))], axis=1
    )
    for _ in range(_TRIALS):
        if not np.isfinite(value).all() or not np.isfinite(slope).all():
            break
        if np.abs(value).max() <= tolerance:
            return u
        step = -np.linalg.solve(slope, value)
        step *= min(1.0, 0.05 / np.abs(step).max())
        after = residual(u + step)
        slope += np.outer(after - value - slope @ step, step) / (step @ step)
        u, value = u + step, after
    raise InputError(
        "cell: no wall rest length and box free the undeformed RVE of stress; check "
        "fluid_particle_mass and wall_stiffness, or take another arrangement_seed"
    )


def _pattern(arrangement: Arrangement, every: Candidates, reach_apart: float) -> Pattern:
    """Groups: the wall particles of an edge, the fluid of a plant cell."""
    fluid = np.repeat(np.arange(len(arrangement.fluid_counts)), arrangement.fluid_counts)
    labels = np.concatenate([arrangement.wall_group, arrangement.wall_group.max() + 1 + fluid])
    first_fluid = int(arrangement.wall_group.max()) + 1
    pairs = set()
    for k, rim in enumerate(arrangement.rims):
        around = {int(arrangement.wall_group[i]) for i, _ in rim} | {first_fluid + k}
        pairs |= {(g, h) for g in around for h in around}
    near = every.common | (every.distance <= reach_apart)
    pairs |= {(int(labels[i]), int(labels[j])) for i, j in every.pairs[near]}
    pairs |= {(int(labels[i]), int(labels[j])) for i, j, _ in arrangement.bonds}
    return make_pattern(labels, pairs)

"""Far loads: the equilibrium followed in steps from a known one, over bifurcations.

See docs/theory.md, stability.
The way is straight in F, dashpots off, from where z is known to where it is asked for. A step
from one stable equilibrium to the next is halved where Newton's method fails, where the state it
finds is unstable, or where particles jump. The shortest step that still fails in this way has met
the end of its branch: from there the RVE goes down its energy to a stable state (`bifurcation`),
and the way goes on along that branch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.tiles import pack, tiles_for, unpack
from surrofe2.rve.bifurcation import Landscape, Reals, descend, paired
from surrofe2.rve.factors import Factors
from surrofe2.rve.newton import SOLVE, newton, solve_tiles
from surrofe2.rve.particle_state import list_covers
from surrofe2.rve.systems import AnyTopology, empty_factors
from surrofe2.rve.unit_cell import UnitCell
from surrofe2.simd import TILE
from surrofe2.tensors import rotation, transpose

LONGEST, SHORTEST = 0.05, 0.004
"""Longest step, and the one that is not halved any further: largest change of an entry of F."""
JUMP = 1.0
"""Material displacement of a particle, µm, that no step along one branch makes."""
FAR = 0.15
"""Largest entry of |U − I| up to which a cold solve may go from F = I in one step."""
ROOM = 1.5
"""How much farther particles may move, µm, on a walk that is begun with a list of contacts."""


def is_far(F: Reals) -> NDArray[np.bool_]:
    """(tiles, TILE) whether F (tiles, 2, 2, TILE) is too far from I to be reached in one step."""
    flat = unpack(F, len(F) * TILE)
    U = transpose(rotation(flat)) @ flat
    return pack(np.abs(U - np.eye(2)).max(axis=(1, 2)) > FAR)


def has_room(unit: UnitCell, level: int, F: Reals, z: Reals) -> NDArray[np.bool_]:
    """(tiles, TILE) whether a walk from z to F may be begun with the contacts of `level`."""
    covered = np.empty((len(F), TILE), dtype=np.bool_)
    reach = unit.patches[level].reach - 2.0 * ROOM
    list_covers(F, z, unit.position, reach, unit.cell.repulsion_cutoff, covered)
    return covered


class Solved(NamedTuple):
    """What Newton's method found at m points, points first; see `direct.newton`."""

    z: Reals
    stress: Reals
    iterations: NDArray[np.int32]
    stable: NDArray[np.bool_]
    factors: Factors

    @property
    def good(self) -> NDArray[np.bool_]:
        """(m,) whether it is a stable equilibrium."""
        return (self.iterations > 0) & self.stable


@dataclass(frozen=True, slots=True)
class Walked:
    """The end of the way of m points.

    Attributes:
        solved: at the end of the way; of no meaning for points that have not arrived.
        arrived: (m,) whether a stable equilibrium was found at the end.
        unstable: (m,) whether the way ended at an equilibrium with no stable one below it.
        left: (m,) whether a branch was left on the way.
        newton_solves: how many it took.
    """

    solved: Solved
    arrived: NDArray[np.bool_]
    unstable: NDArray[np.bool_]
    left: NDArray[np.bool_]
    newton_solves: int


class Walker:
    """Follows equilibria of one unit cell with one list of contacts."""

    def __init__(self, unit: UnitCell, topology: AnyTopology, tolerance: float) -> None:
        self.unit, self.topology, self.tolerance = unit, topology, tolerance

    def walk(self, start: Reals, end: Reals, z: Reals) -> Walked:
        """From z (m, 2, n) at F = `start` to F = `end`, (m, 2, 2) each.

        A rotation of F between the two is made at once: it leaves z as it is.
        """
        z, count, solves = z.copy(), len(z), 0
        start = rotation(end) @ transpose(rotation(start)) @ start
        way = np.maximum(np.abs(end - start).max(axis=(1, 2)), SHORTEST)
        longest, shortest = np.minimum(1.0, LONGEST / way), SHORTEST / way
        done, step = np.zeros(count), np.minimum(longest, 0.5)
        left, arrived, unstable = np.zeros((3, count), dtype=np.bool_)
        active = np.arange(count)
        while len(active):
            part = np.minimum(done[active] + step[active], 1.0)
            t = part[:, None, None]
            F = (1.0 - t) * start[active] + t * end[active]
            trial = self.newton(F, z[active])
            solves += len(active)
            good, there = trial.good & ~_jumped(trial.z, z[active]), trial.z
            stuck = np.flatnonzero(~good & (step[active] <= shortest[active]))
            if len(stuck):
                unstable[active[stuck]] = trial.iterations[stuck] > 0
                there[stuck], good[stuck] = self._leave(F, z[active], trial, stuck)
                left[active[stuck]] |= good[stuck]
                solves += len(stuck)
            lost = np.isin(np.arange(len(active)), stuck) & ~good
            z[active[good]] = there[good]
            done[active[good]] = part[good]
            step[active] = np.where(
                good,
                np.minimum(2.0 * step[active], longest[active]),
                np.maximum(0.5 * step[active], shortest[active]),
            )
            arrived[active] = good & (part >= 1.0)
            active = active[~arrived[active] & ~lost]
        return Walked(self.newton(end, z), arrived, unstable & ~arrived, left, solves + count)

    def newton(self, F: Reals, z: Reals) -> Solved:
        """The elastic equilibrium by Newton's method from z (m, 2, n)."""
        count = len(z)
        tiles = tiles_for(count)
        packed = pack(z)
        factors, task = empty_factors(self.topology, tiles), np.full(tiles, SOLVE, dtype=np.int8)
        stress = np.full((tiles, 2, 2, TILE), np.nan)
        iterations = np.zeros((tiles, TILE), dtype=np.int32)
        stable = np.zeros((tiles, TILE), dtype=np.bool_)
        solve_tiles(
            newton, pack(F), pack(np.zeros_like(F)), packed, factors.address, task, self.topology,
            self.unit.constants, self.unit.area, self.tolerance, stress, iterations, stable,
        )  # fmt: skip
        return Solved(
            z=unpack(packed, count),
            stress=unpack(stress, count),
            iterations=unpack(iterations, count),
            stable=unpack(stable, count),
            factors=factors,
        )

    def _leave(
        self, F: Reals, z: Reals, trial: Solved, stuck: NDArray[np.intp]
    ) -> tuple[Reals, NDArray[np.bool_]]:
        """z of the points `stuck` in a stable state, and whether there is one.

        Down from the unstable equilibrium, or, where none was found or it lies far off, from the
        last stable one.
        """
        saddle = (trial.iterations > 0) & ~trial.stable & ~_jumped(trial.z, z)
        begin = np.where(saddle[:, None, None], trial.z, z)[stuck]
        landscape = Landscape.of(F[stuck], self.topology, self.unit.constants)
        below, found = descend(landscape, begin)
        solved = self.newton(F[stuck], below)
        found &= solved.good & ~paired(landscape, solved.z, np.arange(len(stuck)))
        return solved.z, found


def _jumped(z: Reals, before: Reals) -> NDArray[np.bool_]:
    jumped: NDArray[np.bool_] = np.abs(z - before).max(axis=(1, 2)) > JUMP
    return jumped

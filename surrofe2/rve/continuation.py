"""Far loads: the elastic equilibrium followed in steps, over bifurcations.

See docs/theory.md, stability. The path is straight in F, dashpots off, from where z is known to
where it is asked for. A step from one stable equilibrium to the next is halved where Newton's
method fails, where the state it finds is unstable, or where particles jump. The shortest step that
still fails has met the end of its branch: from there particles move down the elastic energy to a
minimum, see `descent`, and the path goes on along that branch.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.simd import TILE
from surrofe2.base.tensors import rotation, transpose
from surrofe2.plant_cell.tiles import pack, unpack
from surrofe2.rve.descent import Landscape, descend
from surrofe2.rve.near_contacts import NearContacts
from surrofe2.rve.newton import SEEK, SEEK_LIMIT, newton
from surrofe2.rve.particle_state import ASTRAY, Drive, empty_answer
from surrofe2.rve.unit_cell import UnitCell

Reals = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.intp]

LONGEST, SHORTEST = 0.05, 0.004
"""Longest step, and the one that is not halved any further: largest change of an entry of F."""
JUMP = 1.0
"""Material displacement of a particle, µm, that no step along one branch makes."""
FAR = 0.15
"""Largest entry of |U − I| up to which a cold solve may go from F = I in one step."""
EFFORT, OF_STEP_DOWN = 2700, 10
"""Newton iterations on the path of a point after which it is given up; a step down counts ten."""


def is_far(F: Reals) -> Flags:
    """(tiles, TILE) whether F (tiles, 2, 2, TILE) is too far from I to be reached in one step."""
    flat = unpack(F, len(F) * TILE)
    U = transpose(rotation(flat)) @ flat
    return pack(np.abs(U - np.eye(2)).max(axis=(1, 2)) > FAR)


class Path(NamedTuple):
    """How far m points have come from F = `start` to F = `end`, (m, 2, 2) each.

    z: (m, 2, n) their equilibria there.
    done: (m,) the part of the path. step: the next step, as such a part.
    effort: (m,) what it took, in Newton iterations.
    left: (m,) whether a branch was left.
    """

    start: Reals
    end: Reals
    z: Reals
    done: Reals
    step: Reals
    effort: NDArray[np.int_]
    left: Flags

    @classmethod
    def between(cls, start: Reals, end: Reals, z: Reals) -> Path:
        """From z (m, 2, n) at F = `start`; a rotation between the two F is made at once."""
        start, count = rotation(end) @ transpose(rotation(start)) @ start, len(z)
        effort, left = np.zeros(count, dtype=np.int_), np.zeros(count, dtype=np.bool_)
        path = cls(start, end.copy(), z.copy(), np.zeros(count), np.full(count, 0.5), effort, left)
        return path._replace(step=np.minimum(path.step, path.part_of(LONGEST)))

    def part_of(self, change: float) -> Reals:
        """(m,) the part of the path on which F changes by so much, at most 1."""
        length = np.abs(self.end - self.start).max(axis=(1, 2))
        part: Reals = change / np.maximum(length, change)
        return part

    def take(self, index: Index) -> Path:
        """That of the points `index`."""
        return Path(
            self.start[index], self.end[index], self.z[index], self.done[index], self.step[index],
            self.effort[index], self.left[index],
        )  # fmt: skip

    def put(self, index: Index, other: Path) -> None:
        """Let the points `index` be where those of the `other` are."""
        for mine, new in zip(self, other, strict=True):
            mine[index] = new


@dataclass(frozen=True, slots=True)
class Equilibria:
    """Elastic equilibria of k points near where they were sought.

    Attributes:
        z: (k, 2, particles) material positions, µm.
        iterations: (k,) force evaluations.
        found, stable: (k,).
    """

    z: Reals
    iterations: NDArray[np.int_]
    found: Flags
    stable: Flags

    def take(self, index: Index) -> Equilibria:
        """Those of the points `index`."""
        return Equilibria(
            self.z[index], self.iterations[index], self.found[index], self.stable[index]
        )


@dataclass(frozen=True, slots=True)
class Followed:
    """The end of the path of m points.

    Attributes:
        arrived: (m,) whether a stable equilibrium was found at the end.
        unstable: (m,) whether the path ended at an equilibrium with no stable one below it.
        newton_solves: how many it took.
    """

    arrived: Flags
    unstable: Flags
    newton_solves: int


class Continuation:
    """Follows equilibria of one unit cell, with its longest list of contacts."""

    def __init__(self, unit: UnitCell, tolerance: float) -> None:
        self.constants, self.tolerance = unit.constants, tolerance
        self.contacts = NearContacts(unit.patches[-1].topology, unit.cell.repulsion_cutoff)

    def follow(self, path: Path) -> Followed:
        """Go on to the end of the path; it is left where the points have come to."""
        # `active` numbers points of the path; `stuck` and masks like `good` number the active ones.
        longest, shortest = path.part_of(LONGEST), path.part_of(SHORTEST)
        arrived, unstable = path.done >= 1.0, np.zeros(len(path.z), dtype=np.bool_)
        active, solves = np.flatnonzero(~arrived & (path.effort < EFFORT)), 0
        while len(active):
            z = path.z[active]
            F, trial, good = self._next(path, active, shortest[active])
            part, there = np.minimum(path.done[active] + path.step[active], 1.0), trial.z
            solves += len(active)
            at_shortest = path.step[active] <= shortest[active]
            stuck = np.flatnonzero(~good & at_shortest)
            if len(stuck):
                unstable[active[stuck]] = trial.found[stuck]
                begin, spare = trial.take(stuck), EFFORT - path.effort[active[stuck]]
                there[stuck], good[stuck], tried = self._leave(F[stuck], z[stuck], begin, spare)
                path.effort[active[stuck]] += OF_STEP_DOWN * tried
                solves += len(stuck)
            lost = np.isin(np.arange(len(active)), stuck) & ~good
            ahead = active[good]
            path.left[ahead] |= np.isin(np.flatnonzero(good), stuck)
            path.z[ahead], path.done[ahead] = there[good], part[good]
            arrived[ahead] = part[good] >= 1.0
            step = path.step[active] * np.where(good, 2.0, 0.5)
            path.step[active] = np.clip(step, shortest[active], longest[active])
            active = active[~arrived[active] & ~lost & (path.effort[active] < EFFORT)]
        return Followed(arrived, unstable & ~arrived, solves)

    def newton(self, F: Reals, z: Reals) -> Equilibria:
        """The elastic equilibrium near z (m, 2, n) by Newton's method."""
        law = self.contacts.within(F, z, ASTRAY * np.linalg.norm(F, axis=(1, 2))), self.constants
        points, z, tensors = len(z), pack(z), pack(F)
        answer, tiles = empty_answer(len(z)), len(z)
        drive, task = Drive(tensors, np.zeros_like(tensors)), np.full(tiles, SEEK, dtype=np.int8)
        unused = np.zeros(tiles, dtype=np.intp)
        newton(drive, z, unused, task, *law, self.tolerance, answer)
        iterations = unpack(answer.iterations, points)
        found = iterations > 0
        stable = found & unpack(answer.stable, points)
        count = np.where(iterations == -1, SEEK_LIMIT, np.abs(iterations))
        return Equilibria(unpack(z, points), count, found, stable)

    def _next(self, path: Path, active: Index, shortest: Reals) -> tuple[Reals, Equilibria, Flags]:
        """The next step of the `active` points, halved as often as a tile has room to try at once.

        Returns:
            F and what was found there, and whether that is the next equilibrium of the branch;
            the path's step is the one that was taken, its effort that of all before it, too.
        """
        # a tile solves eight points for the price of one: its free lanes try shorter steps at once
        count, tries = len(active), max(TILE // len(active), 1)
        step = np.maximum(path.step[active, None] * 0.5 ** np.arange(tries), shortest[:, None])
        part = np.minimum(path.done[active, None] + step, 1.0)[:, :, None, None]
        F = (1.0 - part) * path.start[active, None] + part * path.end[active, None]
        z = np.repeat(path.z[active], tries, axis=0)
        trial = self.newton(F.reshape(-1, 2, 2), z)
        good = (trial.stable & ~_jumped(trial.z, z)).reshape(count, tries)
        effort = path.effort[active, None] + trial.iterations.reshape(count, tries).cumsum(axis=1)
        last = good | (step <= shortest[:, None]) | (effort >= EFFORT)
        last[:, -1] = True
        taken, every = last.argmax(axis=1), np.arange(count)
        path.step[active], path.effort[active] = step[every, taken], effort[every, taken]
        return F[every, taken], trial.take(tries * every + taken), good[every, taken]

    def _leave(
        self, F: Reals, z: Reals, trial: Equilibria, spare: NDArray[np.int_]
    ) -> tuple[Reals, Flags, NDArray[np.int_]]:
        """z of points in a stable state, whether there is one, and how many steps down it took.

        Down from the unstable equilibrium, or, where none was found or it lies far off, from the
        last stable one.
        """
        saddle = trial.found & ~trial.stable & ~_jumped(trial.z, z)
        begin = np.where(saddle[:, None, None], trial.z, z)
        landscape = Landscape(F, self.contacts, self.constants)
        below, found, tried = descend(landscape, begin, np.maximum(spare // OF_STEP_DOWN, 1))
        solved = self.newton(F, below)
        there = np.where(solved.found[:, None, None], solved.z, below)
        found &= solved.stable & ~landscape.paired(there)
        return there, found, tried


def _jumped(z: Reals, before: Reals) -> Flags:
    jumped: Flags = np.abs(z - before).max(axis=(1, 2)) > JUMP
    return jumped

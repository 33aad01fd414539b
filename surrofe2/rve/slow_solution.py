"""What one call finds on the slow manifold; see `slow_manifold`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.simd import TILE
from surrofe2.law.stress_law import Array, Status
from surrofe2.rve.newton import SKIP, SOLVE, newton
from surrofe2.rve.particle_state import Answer, Drive, empty_answer
from surrofe2.rve.slow_manifold import Moving, follow, newton_slow, renew_slow
from surrofe2.rve.solve import Solution
from surrofe2.rve.tangents import KINDS, affine_tangents, slow_tangents

_OK = int(Status.OK)


class SlowSolution(Solution):
    """`Solution` where velocities are those of the elastic equilibrium as F moves.

    At a bifurcation the slopes of that equilibrium have no bound, and neither have the velocities.
    From there on, where the state's `left` says so, they are affine as in constrained runs.
    """

    def solve(self) -> None:
        """Warm where possible, else from a fresh elastic equilibrium."""
        before, iterations = self.before, self.answer.iterations
        moving = Moving(before.z.copy(), before.relaxed.copy(), before.beyond_affine.copy())
        self.state = replace(
            self.state, z=moving.z, elastic=moving.elastic, fluctuation=moving.fluctuation
        )
        iterations[:] = -1
        if not self.cold:
            at, address = Drive(before.F, before.F_dot), self.state.factors.address
            follow(self.given, moving, at, address, *self.law, self.settings.tolerance, self.answer)
        lost = iterations < 0
        if lost.any():
            self._follow_anew(moving, lost)
        if self.state.left.any():
            self._hold_back(moving)

    def _follow_anew(self, moving: Moving, lost: NDArray[np.bool_]) -> None:
        """Where the warm start missed: from a fresh elastic equilibrium."""
        before, iterations, F = self.before, self.answer.iterations, self.drive.F
        lanes = lost[:, None, None, :]
        elastic = np.where(lanes, before.relaxed, moving.elastic)
        self._newton_where_open(elastic, before.relaxed)
        found = lost & (iterations > 0) & (self.status == _OK)
        tiles = np.asarray(lost.any(axis=1))
        factors = self.state.factors.renewed(tiles)
        self.state = replace(self.state, factors=factors)
        renew_slow(F, elastic, factors.address, tiles, *self.law, np.empty_like(lost))
        # these tiles alone are followed again, and lanes of them that were warm keep what they have
        lost_here, here = lost[tiles], lanes[tiles]
        part = Moving(
            np.where(lanes, elastic, moving.z)[tiles], elastic[tiles], moving.fluctuation[tiles]
        )
        given, answer = Drive(*(each[tiles] for each in self.given)), empty_answer(len(lost_here))
        at, address = Drive(given.F, np.where(here, 0.0, given.rate)), factors.address[tiles]
        follow(given, part, at, address, *self.law, self.settings.tolerance, answer)
        self._newton_slow(given, part, answer, lost_here & found[tiles] & (answer.iterations < 0))
        whole = moving.z, moving.elastic, moving.fluctuation, self.answer.stress
        for kept, new in zip(whole, (*part, answer.stress), strict=True):
            kept[tiles] = np.where(here, new, kept[tiles])
        iterations[tiles] = np.where(lost_here, answer.iterations, iterations[tiles])
        self.status[lost & ~found & (self.status == _OK)] = Status.NOT_CONVERGED
        missed = lost & found & (iterations < 0)
        if missed.any():
            self.state = replace(self.state, left=self.state.left | missed)

    def _hold_back(self, moving: Moving) -> None:
        """Positions with affine velocities where a bifurcation was met."""
        iterations = self.answer.iterations
        wanted = self.state.left & (self.status == _OK)
        counts = np.where(wanted, -1, 1).astype(np.int32)
        answer = empty_answer(len(counts))._replace(iterations=counts)
        tiles = np.asarray(wanted.any(axis=1))
        task, z = np.where(tiles, SOLVE, SKIP).astype(np.int8), moving.elastic.copy()
        scratch, tolerance = self.state.factors.renewed(tiles), self.settings.tolerance
        newton(self.given, z, scratch.address, task, *self.law, tolerance, answer)
        lanes = wanted[:, None, None, :]
        np.copyto(moving.z, z, where=lanes)
        np.copyto(moving.fluctuation, 0.0, where=lanes)
        np.copyto(self.answer.stress, answer.stress, where=lanes)
        spent = np.where(counts > 0, np.abs(iterations) + counts, counts)
        np.copyto(iterations, spent, where=wanted)
        self.newton_solves += int(wanted.sum())
        self.status[wanted & (counts < 0)] = Status.NOT_CONVERGED

    def _newton_slow(
        self, given: Drive, moving: Moving, answer: Answer, soft: NDArray[np.bool_]
    ) -> None:
        """Where z_el is stable but so soft that `follow` misses z."""
        if soft.any():
            counts = np.where(soft, 0, 1).astype(np.int32)
            own = answer._replace(iterations=counts)
            newton_slow(given, moving, *self.law, self.settings.tolerance, own)
            answer.iterations[soft] = counts[soft]

    def _all_tangents(self) -> Array:
        values, state = np.empty((len(self.status), 2, 2, 8, TILE)), self.state
        slow_tangents(self.given, state.z, state.relaxed, *self.law, values)
        if state.left.any():
            affine = np.empty_like(values)
            kind = KINDS.index("constrained-runs")
            affine_tangents(self.given, state.z, kind, *self.law, affine)
            np.copyto(values, affine, where=state.left[:, None, None, None, :])
        return values


def solution_kind(initialisation: str) -> type[Solution]:
    """What `solve_rves` is to find."""
    return SlowSolution if initialisation == "slow-manifold" else Solution

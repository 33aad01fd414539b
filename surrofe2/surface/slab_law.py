"""The surface law of a tissue's free sides, by slabs of plant cells and the bulk beside them.

docs/theory.md, surface law: the bulk is stretched along x, its normal stress across is zero. The
stretch across follows by (A41); with initialisation "elastic" it stays where it was at rest."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.errors import InputError
from surrofe2.base.simd import pack, unpack
from surrofe2.law.stress_law import Status, Tangents
from surrofe2.law.surface_law import SurfaceResponse
from surrofe2.plant_cell.arrangement import ReferenceState
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import Drive
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.solve import Solved, solve_rves
from surrofe2.surface.slab import bend, make_slab

ROWS = 8
"""Plant cells across a slab; what its sides feel of each other falls to a fifth with each."""
_REST_LIMIT, _RESTING = 30, 1e-12
_NEWTON_LIMIT = 20
_DONE = 1e-12
"""Newton's method stops at so small a step of λ₂."""
_DIFFERENCE = 1e-4
"""Of λ, by which s is differenced."""


class SideFree(NamedTuple):
    """The bulk at n points with stretch λ along its free side.

    F, F_dot: (n, 2, 2) diagonal. P: (n,) P₁₁, µN/µm. slopes: (2, n) of P₁₁ by λ and λ̇ where the
    stretch across follows. valid: (n,) whether there is such a state. follow: (2, 2, n), [k, m] how
    F₂₂ and Ḟ₂₂ follow λ and λ̇.
    """

    F: Array
    F_dot: Array
    P: Array
    slopes: Array
    valid: Flags
    follow: Array


def side_free(law: RveLaw, stretch: Array, rate: Array) -> SideFree:
    """The bulk at stretches λ and rates λ̇ (n,) along x with P₂₂ = 0."""
    n, zero = len(stretch), np.zeros(len(stretch))
    lower, upper = stretch - _DIFFERENCE, stretch + _DIFFERENCE
    across, s = _at_rest(law, np.concatenate([stretch, lower, upper]))
    across, (s, before, after) = across[:n], s.reshape(3, n)
    bend, across_rate = (after - before) / (upper - lower), s * rate
    follow = np.array([[s, zero], [bend * rate, s]])
    if law.initialisation != "elastic":
        across = _solve_across(law, stretch, across, rate, across_rate)
        tangents = _respond(law, stretch, across, rate, across_rate)[1]
        follow[0] = 0.0
        follow[0] = -slopes(tangents, follow, 1) / tangents.P_by_F[:, 1, 1, 1, 1]
    P, tangents, valid = _respond(law, stretch, across, rate, across_rate)
    F, F_dot = diagonal(stretch, across), diagonal(rate, across_rate)
    valid &= np.isfinite(across)
    return SideFree(F, F_dot, P[:, 0], slopes(tangents, follow, 0), valid, follow)


def slopes(tangents: Tangents, follow: Array, a: int) -> Array:
    """(2, n) ∂P_aa by λ and λ̇, where F₂₂ and Ḟ₂₂ follow."""
    by_F, by_rate = tangents.P_by_F[:, a, a], tangents.P_by_F_dot[:, a, a]
    along = np.stack([by_F[:, 0, 0], by_rate[:, 0, 0]])
    return along + by_F[:, 1, 1] * follow[0] + by_rate[:, 1, 1] * follow[1]


def diagonal(first: Array, second: Array) -> Array:
    """(n, 2, 2) with these (n,) on the diagonal."""
    tensors = np.zeros((len(first), 2, 2))
    tensors[:, 0, 0], tensors[:, 1, 1] = first, second
    return tensors


def _at_rest(law: RveLaw, along: Array) -> tuple[Array, Array]:
    """λ₂ and s = dλ₂/dλ, (n,) each."""
    still = np.zeros_like(along)
    across = _solve_across(law, along, np.ones_like(along), still, still)
    slope = _respond(law, along, across, still, still)[1].P_by_F[:, 1, 1]
    return across, -slope[:, 0, 0] / slope[:, 1, 1]


def _solve_across(
    law: RveLaw, along: Array, across: Array, rate: Array, across_rate: Array
) -> Array:
    """λ₂ (n,) at which P₂₂ = 0, by Newton's method from `across`; NaN where it is not found."""
    across = across.copy()
    for _ in range(_NEWTON_LIMIT):
        P, tangents, valid = _respond(law, along, across, rate, across_rate)
        step = np.where(valid, P[:, 1] / tangents.P_by_F[:, 1, 1, 1, 1], 0.0)
        across -= step
        if np.abs(step).max(initial=0.0) < _DONE:
            return np.where(valid, across, np.nan)
    return np.where(np.abs(step) < np.sqrt(_DONE), across, np.nan)


def _respond(
    law: RveLaw, along: Array, across: Array, rate: Array, across_rate: Array
) -> tuple[Array, Tangents, Flags]:
    """P₁₁ and P₂₂ (n, 2), tangents, and where they are valid; λ₂ may be NaN."""
    known = np.isfinite(across) & (along > 0.0) & (across > 0.0)
    F = diagonal(np.where(known, along, 1.0), np.where(known, across, 1.0))
    F_dot = diagonal(rate, np.where(known, across_rate, 0.0))
    answer = law.respond(F, F_dot, tangents=True)
    stress = answer.stress
    P = np.stack([stress[:, 0, 0] * F[:, 1, 1], stress[:, 1, 1] * F[:, 0, 0]], axis=1)
    tangents = answer.tangents
    assert tangents is not None
    return P, tangents, known & (answer.status == 0)


def rows_across(cells: float) -> int:
    """Rows of the slab for a tissue of so many plant cells across: its sides are as near.

    Thin tissue thus has the law of its own thickness, and all from `ROWS` on has the same.
    """
    return min(max(1, round(cells)), ROWS)


class SlabPoint(NamedTuple):
    """A slab and the bulk beside it at n points: resultant (n,) of the slab, µN; the bulk; the
    solution of the slab's particles; and where (n,) both have an answer.
    """

    resultant: Array
    bulk: SideFree
    solution: Solved
    valid: Flags


class SlabLaw:
    """P_s(λ, λ̇): half of what a slab's resultant has beyond that of the bulk with a free side.

    Args:
        cell: one square plant cell, or the name of a preset.
        settings: initialisation and tolerance; solver direct.
        initialisation: instead of that of the settings.
        rows: plant cells across the slab; from 6 on the law does not depend on it.
        reference: the cell's settled reference state; None: it is settled here.

    Raises:
        InputError: not one square plant cell, solver iterated, or no stable slab.
        MismatchError: `reference` is of another cell."""

    def __init__(
        self,
        cell: CellParameters | str,
        settings: RveSettings | None = None,
        *,
        initialisation: str | None = None,
        rows: int = ROWS,
        reference: ReferenceState | None = None,
    ) -> None:
        if rows < 1:
            raise InputError(f"rows: {rows}; a slab must have at least 1")
        self.law = RveLaw(cell, settings, initialisation=initialisation, reference=reference)
        if not self.law.has_tangents:
            raise InputError("rve.solver: 'iterated'; for a surface law it must be direct")
        self.cell = self.law.cell
        self.rows = rows
        self.unit = make_slab(self.cell, self.law.reference, rows)

    @property
    def initialisation(self) -> str:
        """How slab and bulk are put into their states."""
        return self.law.initialisation

    @property
    def mass(self) -> float:
        """Mass of an outer wall beyond half an inner one, ng/µm."""
        cell = self.cell
        inner = cell.wall_springs_per_side * cell.wall_particle_mass / cell.cell_side
        return 0.5 * (cell.outer_wall - 1.0) * inner

    @property
    def width(self) -> float:
        """Length of side over which it takes the mean stretch: of a plant cell, µm."""
        return self.cell.cell_side

    @cached_property
    def depth(self) -> float:
        """Depth at which the slab's two sides must act for it to be as stiff in bending as it is,
        between a plant cell above the outline and the slab's middle, µm.

        Raises:
            InputError: the slab has no state of rest, straight or bent.
        """
        stretch, surface, bulk = self.rest(self.rows)
        at = self.point(stretch, 0.0 * stretch)
        z = unpack(at.solution.state.z, 1)[0].T
        half, across = 0.5 * self.thickness, bulk.F[0, 1, 1]
        stiffness, _ = bend(self.unit, bulk.F[0], z)
        assert surface.tangent is not None
        lacking = 0.5 * (stiffness / across**2 - 2.0 / 3.0 * half**3 * bulk.slopes[0, 0])
        farthest = half + self.cell.cell_side
        square = np.clip(lacking / surface.tangent[0], 0.0, farthest**2)
        return float(half - np.sqrt(square))

    @property
    def thickness(self) -> float:
        """Of as much bulk as the slab stands for, µm."""
        return self.rows * self.cell.cell_side

    def respond(
        self, stretch: Any, stretch_rate: Any, *, tangents: bool = False
    ) -> SurfaceResponse:
        """Tension at n points; see `SurfaceLaw.respond`."""
        at = self.point(np.asarray(stretch, np.float64), np.asarray(stretch_rate, np.float64))
        tension = 0.5 * (at.resultant - self.thickness * at.bulk.P)
        tension[~at.valid] = np.nan
        if not tangents:
            return SurfaceResponse(tension)
        height, beside = self.unit.reference.lattice[1, 1], self.thickness * at.bulk.slopes
        of_slab = height * slopes(at.solution.tangents(), at.bulk.follow, 0)
        return SurfaceResponse(tension, *(0.5 * (of_slab - beside)))

    def point(self, stretch: Array, rate: Array) -> SlabPoint:
        """Slab and bulk at stretches and rates (n,)."""
        bulk = side_free(self.law, stretch, rate)
        known = bulk.valid[:, None, None]
        F, F_dot = np.where(known, bulk.F, np.eye(2)), np.where(known, bulk.F_dot, 0.0)
        start = self.unit.rest_state(len(F), "slab")
        drive = Drive(pack(F), pack(F_dot))
        solution = solve_rves(self.unit, self.law.settings, drive, start, cold=True)
        stress = unpack(solution.answer.stress, len(F))
        resultant = self.unit.reference.lattice[1, 1] * stress[:, 0, 0] * F[:, 1, 1]
        valid = bulk.valid & (unpack(solution.status, len(F)) == Status.OK)
        return SlabPoint(resultant, bulk, solution, valid)

    def rest(self, across: int) -> tuple[Array, SurfaceResponse, SideFree]:
        """Stretch (1,) of a strip of `across` plant cells without load, its surface and bulk.

        Raises:
            InputError: the strip has no state of rest.
        """
        stretch, still = np.ones(1), np.zeros(1)
        for _ in range(_REST_LIMIT):
            surface = self.respond(stretch, still, tangents=True)
            bulk = side_free(self.law, stretch, still)
            assert surface.tangent is not None
            height = across * self.cell.cell_side
            force = height * bulk.P + 2.0 * surface.tension
            slope = height * bulk.slopes[0] + 2.0 * surface.tangent
            if not surface.valid[0] or not slope[0] > 0.0:
                break
            step = force / slope
            if abs(step[0]) < _RESTING:
                return stretch, surface, bulk
            stretch = stretch - step
        raise InputError(f"surface: a strip of {across} plant cells finds no rest")

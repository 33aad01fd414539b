"""The surface law of a tissue's free sides, by slabs of plant cells and the bulk beside them.

docs/theory.md, surface law: the bulk is stretched along x, its normal stress across is zero. The
stretch across follows by (A41); with initialisation "elastic" it stays where it was at rest.
"""

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
"""Plant cells across a slab: what its sides feel of each other falls to a fifth with each."""
# Newton's method for a strip without load: its most steps, and the step of λ at which it is done.
_REST_LIMIT = 30
_RESTING = 1e-12
# Newton's method for the stretch across: its most steps, and the step of λ₂ at which it is done.
_NEWTON_LIMIT = 20
_DONE = 1e-12
# The change of λ by which s = dλ₂/dλ is differenced.
_DIFFERENCE = 1e-4


class SideFree(NamedTuple):
    """The bulk at n points with stretch λ along its free side.

    Attributes:
        F: (n, 2, 2) diagonal deformation gradient.
        F_dot: (n, 2, 2) its rate, diagonal, 1/µs.
        P: (n,) P₁₁, µN/µm.
        slopes: (2, n) slopes of P₁₁ by λ and λ̇, with the stretch across that follows them.
        valid: (n,) whether there is such a state.
        follow: (2, 2, n) slopes of F₂₂ (row 0) and Ḟ₂₂ (row 1) by λ and λ̇.
    """

    F: Array
    F_dot: Array
    P: Array
    slopes: Array
    valid: Flags
    follow: Array


def side_free(law: RveLaw, stretch: Array, rate: Array) -> SideFree:
    """Solve the bulk at stretches λ and rates λ̇ (n,) along x, with P₂₂ = 0."""
    n = len(stretch)
    zero = np.zeros(n)
    lower = stretch - _DIFFERENCE
    upper = stretch + _DIFFERENCE
    # One call for the three stretches, since RVEs are solved eight at a time.
    all_across, all_s = _at_rest(law, np.concatenate([stretch, lower, upper]))
    across = all_across[:n]
    s, s_lower, s_upper = all_s.reshape(3, n)
    s_slope = (s_upper - s_lower) / (upper - lower)
    across_rate = s * rate  # λ̇₂ = s λ̇, (A41)
    follow = np.array([[s, zero], [s_slope * rate, s]])
    if law.initialisation != "elastic":
        # λ₂ follows at once, so that P₂₂ stays zero: its slopes are −∂P₂₂/(∂P₂₂/∂F₂₂)
        across = _solve_across(law, stretch, across, rate, across_rate)
        _, tangents, _ = _respond(law, stretch, across, rate, across_rate)
        follow[0] = 0.0
        follow[0] = -slopes(tangents, follow, 1) / tangents.P_by_F[:, 1, 1, 1, 1]
    P, tangents, valid = _respond(law, stretch, across, rate, across_rate)
    return SideFree(
        F=diagonal(stretch, across),
        F_dot=diagonal(rate, across_rate),
        P=P[:, 0],
        slopes=slopes(tangents, follow, 0),
        valid=valid & np.isfinite(across),
        follow=follow,
    )


def slopes(tangents: Tangents, follow: Array, a: int) -> Array:
    """Return ∂P_aa by λ and λ̇, (2, n), where F₂₂ and Ḟ₂₂ follow as in `SideFree`."""
    by_F = tangents.P_by_F[:, a, a]
    by_rate = tangents.P_by_F_dot[:, a, a]
    along = np.stack([by_F[:, 0, 0], by_rate[:, 0, 0]])
    return along + by_F[:, 1, 1] * follow[0] + by_rate[:, 1, 1] * follow[1]


def diagonal(first: Array, second: Array) -> Array:
    """Return tensors (n, 2, 2) with these values (n,) on the diagonal."""
    tensors = np.zeros((len(first), 2, 2))
    tensors[:, 0, 0] = first
    tensors[:, 1, 1] = second
    return tensors


def _at_rest(law: RveLaw, along: Array) -> tuple[Array, Array]:
    """Return λ₂ at rest and s = dλ₂/dλ, (n,) each, at stretches λ = `along`."""
    still = np.zeros_like(along)
    across = _solve_across(law, along, np.ones_like(along), still, still)
    _, tangents, _ = _respond(law, along, across, still, still)
    P22_by_F = tangents.P_by_F[:, 1, 1]
    return across, -P22_by_F[:, 0, 0] / P22_by_F[:, 1, 1]


def _solve_across(
    law: RveLaw, along: Array, across: Array, rate: Array, across_rate: Array
) -> Array:
    """Solve P₂₂ = 0 for λ₂ (n,) by Newton's method from `across`; NaN where that fails."""
    across = across.copy()
    for _ in range(_NEWTON_LIMIT):
        P, tangents, valid = _respond(law, along, across, rate, across_rate)
        step = np.where(valid, P[:, 1] / tangents.P_by_F[:, 1, 1, 1, 1], 0.0)
        across -= step
        if np.abs(step).max(initial=0.0) < _DONE:
            return np.where(valid, across, np.nan)
    # Steps may end at rounding above _DONE; half the digits are enough then.
    return np.where(np.abs(step) < np.sqrt(_DONE), across, np.nan)


def _respond(
    law: RveLaw, along: Array, across: Array, rate: Array, across_rate: Array
) -> tuple[Array, Tangents, Flags]:
    """Return P₁₁ and P₂₂ (n, 2), the tangents, and whether (n,) they are valid; λ₂ may be NaN."""
    known = np.isfinite(across) & (along > 0.0) & (across > 0.0)
    F = diagonal(np.where(known, along, 1.0), np.where(known, across, 1.0))
    F_dot = diagonal(rate, np.where(known, across_rate, 0.0))
    answer = law.respond(F, F_dot, tangents=True)
    assert answer.tangents is not None
    stress = answer.stress
    P = np.stack([stress[:, 0, 0] * F[:, 1, 1], stress[:, 1, 1] * F[:, 0, 0]], axis=1)
    return P, answer.tangents, known & (answer.status == 0)


def rows_across(cells: float) -> int:
    """Return the rows of the slab whose law a tissue of `cells` plant cells across has.

    Thin tissue has the law of a slab as thin as itself; from `ROWS` on all tissue has the same.
    """
    return min(max(1, round(cells)), ROWS)


class SlabPoint(NamedTuple):
    """A slab and the bulk beside it at n points.

    Attributes:
        resultant: (n,) resultant of the slab, µN.
        bulk: the bulk at the same stretch.
        solution: the solution of the slab's particles.
        valid: (n,) whether both have a state.
    """

    resultant: Array
    bulk: SideFree
    solution: Solved
    valid: Flags


class SlabLaw:
    """P_s(λ, λ̇): half of what a slab's resultant has beyond that of the bulk with a free side.

    Args:
        cell: one square plant cell, or the name of a preset.
        settings: initialisation and tolerance; the solver must be direct.
        initialisation: initialisation that replaces that of the settings.
        rows: plant cells across the slab; from 6 on the law hardly depends on it.
        reference: the cell's settled reference state; None: it is settled here.

    Raises:
        InputError: not one square plant cell, solver iterated, or no stable slab.
        MismatchError: `reference` is of another cell.
    """

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
        """The initialisation of slab and bulk."""
        return self.law.initialisation

    @property
    def mass(self) -> float:
        """Mass of an outer wall beyond half an inner one, ng/µm."""
        cell = self.cell
        inner_wall = cell.wall_springs_per_side * cell.wall_particle_mass / cell.cell_side
        # Two plant cells share an inner wall, so half of it belongs to the bulk.
        return 0.5 * (cell.outer_wall - 1.0) * inner_wall

    @property
    def width(self) -> float:
        """Length of side over which the law takes the mean stretch: that of a plant cell, µm."""
        return self.cell.cell_side

    @cached_property
    def depth(self) -> float:
        """Depth at which the two sides act so that the slab is as stiff in bending as it is, µm.

        It is (A46), between a plant cell above the outline and the slab's middle.

        Raises:
            InputError: the slab has no state of rest, straight or bent.
        """
        stretch, surface, bulk = self.rest(self.rows)
        assert surface.tangent is not None
        at_rest = self.point(stretch, 0.0 * stretch)
        z = unpack(at_rest.solution.state.z, 1)[0].T
        stiffness, _ = bend(self.unit, bulk.F[0], z)
        half = 0.5 * self.thickness
        across = bulk.F[0, 1, 1]
        # stiffness that bulk of the slab's height lacks, for each of the two sides
        bulk_stiffness = 2.0 / 3.0 * half**3 * bulk.slopes[0, 0]
        lacking = 0.5 * (stiffness / across**2 - bulk_stiffness)
        farthest = half + self.cell.cell_side
        square_of_lever = np.clip(lacking / surface.tangent[0], 0.0, farthest**2)
        return float(half - np.sqrt(square_of_lever))

    @property
    def thickness(self) -> float:
        """Thickness of the bulk that the slab stands for, µm."""
        return self.rows * self.cell.cell_side

    def respond(
        self, stretch: Any, stretch_rate: Any, *, tangents: bool = False
    ) -> SurfaceResponse:
        """Compute the tension at n points; see `SurfaceLaw.respond`."""
        stretch = np.asarray(stretch, np.float64)
        stretch_rate = np.asarray(stretch_rate, np.float64)
        points = self.point(stretch, stretch_rate)
        tension = 0.5 * (points.resultant - self.thickness * points.bulk.P)
        tension[~points.valid] = np.nan
        if not tangents:
            return SurfaceResponse(tension)
        height = self.unit.reference.lattice[1, 1]
        slab_slopes = height * slopes(points.solution.tangents(), points.bulk.follow, 0)
        bulk_slopes = self.thickness * points.bulk.slopes
        by_stretch, by_rate = 0.5 * (slab_slopes - bulk_slopes)
        return SurfaceResponse(tension, by_stretch, by_rate)

    def point(self, stretch: Array, rate: Array) -> SlabPoint:
        """Solve slab and bulk at stretches and rates (n,)."""
        bulk = side_free(self.law, stretch, rate)
        # The slab has the stretch across of the bulk beside it; where there is none it is at rest.
        known = bulk.valid[:, None, None]
        F = np.where(known, bulk.F, np.eye(2))
        F_dot = np.where(known, bulk.F_dot, 0.0)
        start = self.unit.rest_state(len(F), "slab")
        drive = Drive(pack(F), pack(F_dot))
        solution = solve_rves(self.unit, self.law.settings, drive, start, cold=True)
        stress = unpack(solution.answer.stress, len(F))
        # P₁₁ of the box, gap included, times its height
        resultant = self.unit.reference.lattice[1, 1] * stress[:, 0, 0] * F[:, 1, 1]
        is_solved = unpack(solution.status, len(F)) == Status.OK
        return SlabPoint(resultant, bulk, solution, valid=bulk.valid & is_solved)

    def rest(self, across: int) -> tuple[Array, SurfaceResponse, SideFree]:
        """Solve a strip of `across` plant cells without load.

        Returns its stretch (1,), and its surface and bulk there.

        Raises:
            InputError: the strip has no state of rest.
        """
        stretch = np.ones(1)
        still = np.zeros(1)
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

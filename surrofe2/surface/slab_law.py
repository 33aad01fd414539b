"""The surface law of a tissue's free sides, by true slabs (docs/theory.md, surface law)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.law.stress_law import Status
from surrofe2.law.surface_law import SurfaceResponse
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.plant_cell.tiles import pack, unpack
from surrofe2.rve.particle_state import Drive
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import rest_state
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.slow_solution import solution_kind
from surrofe2.rve.solve import Solution, solve_rves
from surrofe2.surface.bent_slab import bend
from surrofe2.surface.side_free import SideFree, side_free
from surrofe2.surface.slab import make_slab

Array = NDArray[np.float64]

ROWS = 8
"""Plant cells across a slab; what its sides feel of each other falls to a fifth with each."""
_LIMIT, _RESTING = 30, 1e-12


def rows_across(cells: float) -> int:
    """Rows of the slab for a tissue of so many plant cells across: its sides are as near.

    Thin tissue thus has the law of its own thickness, and all from `ROWS` on has the same.
    """
    return min(max(1, round(cells)), ROWS)


@dataclass(frozen=True, slots=True)
class SlabPoint:
    """A slab and the bulk beside it at n points.

    Attributes:
        resultant: (n,) force along the slab, µN.
        bulk: what as much bulk would be.
        solution: of the slab's particles.
        valid: (n,) whether both have an answer.
    """

    resultant: Array
    bulk: SideFree
    solution: Solution
    valid: NDArray[np.bool_]


class SlabLaw:
    """P_s(λ, λ̇): half of what a slab's resultant has beyond that of the bulk with a free side.

    Args:
        cell: one square plant cell.
        settings: initialisation and tolerance; solver direct.
        initialisation: instead of that of the settings.
        rows: plant cells across the slab; from 6 on the law does not depend on it, see
            `rows_across`.
        reference: the cell's settled reference state; None: it is settled here.

    Raises:
        InputError: not one square plant cell, solver iterated, or no stable slab.
        MismatchError: `reference` is of another cell.
    """

    def __init__(
        self,
        cell: CellParameters,
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
        self.cell, self.rows = cell, rows
        self.unit = make_slab(cell, self.law.reference, rows)

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
        lacking = 0.5 * (stiffness / across**2 - 2.0 / 3.0 * half**3 * bulk.by_stretch[0])
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
            return SurfaceResponse(tension, at.valid)
        bulk, height = at.bulk, self.unit.reference.lattice[1, 1]
        slopes = bulk.follow.slopes(at.solution.tangents(), 0, 0)
        by_stretch, by_rate = (
            0.5 * (height * slab - self.thickness * beside)
            for slab, beside in zip(slopes, (bulk.by_stretch, bulk.by_rate), strict=True)
        )
        return SurfaceResponse(tension, at.valid, by_stretch, by_rate)

    def point(self, stretch: Array, rate: Array) -> SlabPoint:
        """Slab and bulk at stretches and rates (n,)."""
        bulk = side_free(self.law, stretch, rate)
        known = bulk.valid[:, None, None]
        F, F_dot = np.where(known, bulk.F, np.eye(2)), np.where(known, bulk.F_dot, 0.0)
        start = rest_state(self.unit.position, self.unit.factors, len(F), "slab")
        drive = Drive(pack(F), pack(F_dot))
        kind = solution_kind(self.law.initialisation)
        solution = solve_rves(kind, self.unit, self.law.settings, drive, start, cold=True)
        stress = unpack(solution.answer.stress, len(F))
        resultant = self.unit.reference.lattice[1, 1] * stress[:, 0, 0] * F[:, 1, 1]
        valid = bulk.valid & (unpack(solution.status, len(F)) == Status.OK)
        return SlabPoint(resultant, bulk, solution, valid)

    def missing_cells(self, across: int) -> float:
        """By how many plant cells a long strip of `across` ones is softer than as much bulk.

        The strip is at rest under its surface's tension; bulk is so at λ = 1.

        Raises:
            InputError: the strip has no state of rest.
        """
        side = self.cell.cell_side
        stiff = side_free(self.law, np.ones(1), np.zeros(1)).by_stretch
        _, surface, bulk = self.rest(across)
        assert surface.tangent is not None
        slope = across * side * bulk.by_stretch + 2.0 * surface.tangent
        return float(across - slope[0] / (side * stiff[0]))

    def rest(self, across: int) -> tuple[Array, SurfaceResponse, SideFree]:
        """Stretch (1,) of a strip of `across` plant cells without load, its surface and bulk.

        Raises:
            InputError: the strip has no state of rest.
        """
        stretch, still = np.ones(1), np.zeros(1)
        for _ in range(_LIMIT):
            surface = self.respond(stretch, still, tangents=True)
            bulk = side_free(self.law, stretch, still)
            assert surface.tangent is not None
            height = across * self.cell.cell_side
            force = height * bulk.P + 2.0 * surface.tension
            slope = height * bulk.by_stretch + 2.0 * surface.tangent
            if not surface.valid[0] or not slope[0] > 0.0:
                break
            step = force / slope
            if abs(step[0]) < _RESTING:
                return stretch, surface, bulk
            stretch = stretch - step
        raise InputError(f"surface: a strip of {across} plant cells finds no rest")

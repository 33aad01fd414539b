"""The RVE in its reference state: periodic plant cells, relaxed, free of stress.

The paper starts "from this cell in its equilibrium state", and its tissue measures an exact
multiple of the cell: so the wall rest length l₀ follows from σ(I, 0) = 0 with particles relaxed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import root_scalar

from surrofe2.errors import InputError
from surrofe2.plant_cell.arranged_patch import Unlisted
from surrofe2.plant_cell.geometry import Patch, even_positions, square_patch
from surrofe2.plant_cell.lanes import Constants, make_constants, make_topology, pack
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve.arranged_cells import find_reference
from surrofe2.rve.constrained_runs import iterate_tile
from surrofe2.rve.direct import SOLVE, newton
from surrofe2.rve.factors import Factors
from surrofe2.rve.systems import AnyTopology
from surrofe2.simd import TILE

REACHES = (1.2, 1.4, 2.0, 3.0)
"""Lists of contacts, in cut-offs; the shortest that provably covers a deformation serves."""
_RELAXED = 1e-10
_FIRST_GUESS = 0.5
_SETTLING_STEP, _SETTLED, _SETTLING_LIMIT = 1e-3, 1.0, 200_000


@dataclass(frozen=True, slots=True)
class UnitCell:
    """Reference state of an RVE.

    Attributes:
        position: (n, 2) relaxed reference positions, µm; particle 0 is a wall corner at 0.
        rest_length: wall rest length l₀, µm, at which the reference is free of stress.
        patches, topologies: pair lists of rising reach.
        unlisted: what each list leaves out; None where its reach alone has to tell.
        factors: factorisation at the reference, one tile.
    """

    cell: CellParameters
    position: NDArray[np.float64]
    rest_length: float
    constants: Constants
    patches: tuple[Patch, ...]
    topologies: tuple[AnyTopology, ...]
    factors: Factors
    unlisted: tuple[Unlisted | None, ...]

    @property
    def area(self) -> float:
        """Reference area, µm²."""
        return self.patches[0].area


@lru_cache(maxsize=32)
def make_unit_cell(cell: CellParameters) -> UnitCell:
    """Relax plant cells at F = I and find the rest length (and box) that frees them of stress.

    Raises:
        InputError: no positive rest length balances the turgor, or no stable equilibrium exists.
    """
    if not cell.is_one_square:
        return _arranged_unit_cell(cell)
    spring = cell.cell_side / cell.wall_springs_per_side
    start = even_positions(cell)
    patch = square_patch(cell, start, reach=REACHES[-1] * cell.repulsion_cutoff)
    guess = [_descend(patch, make_constants(cell, _FIRST_GUESS * spring), start)]

    def pressure(relative_length: float) -> float:
        constants = make_constants(cell, relative_length * spring)
        guess[0], stress, _, _ = _relax(patch, constants, guess[0])
        return float(np.trace(stress))

    found = root_scalar(
        pressure, method="secant", x0=_FIRST_GUESS, x1=0.95 * _FIRST_GUESS, xtol=1e-14, maxiter=30
    )
    if not (found.converged and found.root > 0.0):
        raise InputError(
            f"cell: the turgor needs a wall rest length of {found.root:.3g} spring lengths; it "
            "must be positive: lower fluid_particle_mass or sound_speed, or raise wall_stiffness"
        )
    rest_length = float(found.root * spring)
    constants = make_constants(cell, rest_length)
    position, _, factors, stable = _relax(patch, constants, guess[0])
    if not stable:
        raise InputError(
            "cell: the equilibrium of the undeformed cell is unstable; "
            "check fluid_particle_mass, wall_stiffness and repulsion_strength"
        )
    patches = tuple(
        square_patch(cell, position, reach=factor * cell.repulsion_cutoff) for factor in REACHES
    )
    topologies = tuple(make_topology(p) for p in patches)
    unlisted = (None,) * len(patches)
    return UnitCell(cell, position, rest_length, constants, patches, topologies, factors, unlisted)


def _arranged_unit_cell(cell: CellParameters) -> UnitCell:
    one_square = make_unit_cell(replace(cell, arrangement="square", cells=1, arrangement_seed=1))
    reference = find_reference(cell, one_square.rest_length)
    lists, found = reference.lists, reference.equilibrium
    return UnitCell(
        cell,
        reference.position,
        reference.rest_length,
        make_constants(cell, reference.rest_length),
        lists.patches,
        lists.topologies,
        found.factors,
        lists.unlisted,
    )


def _descend(patch: Patch, constants: Constants, start: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions (n, 2) into which the particles settle at F = I from `start`, dashpots on."""
    x = np.ascontiguousarray(np.swapaxes(pack(start[None]), 1, 2))[0]
    v = np.zeros_like(x)
    unit = pack(np.eye(2)[None])[0]
    residual, iterations = np.empty((1, TILE)), np.empty(TILE, dtype=np.int32)
    iterate_tile(
        unit, np.zeros_like(unit), x, v, patch.mass, make_topology(patch), constants, patch.area,
        _SETTLING_STEP, _SETTLED, _SETTLING_LIMIT, np.empty((2, 2, TILE)), residual, iterations,
    )  # fmt: skip
    if iterations[0] < 0:
        raise InputError(
            "cell: the undeformed cell does not come to rest "
            f"(mean force {residual[0, 0]:.3g} µN); check fluid_particle_mass, wall_stiffness "
            "and the damping ratios"
        )
    return x[:, :, 0].T.copy()


def _relax(
    patch: Patch, constants: Constants, start: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], Factors, bool]:
    """Elastic equilibrium at F = I: positions (n, 2), stress (2, 2), factors, whether stable."""
    z = pack(start[None])
    z = np.ascontiguousarray(np.swapaxes(z, 1, 2))
    unit = np.ascontiguousarray(pack(np.eye(2)[None]))
    still = np.zeros_like(unit)
    factors = Factors.empty(1, 2 * len(start) - 2)
    stress = np.empty((1, 2, 2, TILE))
    iterations = np.zeros((1, TILE), dtype=np.int32)
    stable = np.zeros((1, TILE), dtype=np.bool_)
    newton(
        unit, still, z, factors.address, np.full(1, SOLVE, dtype=np.int8),
        make_topology(patch), constants, patch.area, _RELAXED, stress, iterations, stable,
    )  # fmt: skip
    if iterations[0, 0] < 0:
        raise InputError(
            "cell: no equilibrium of the undeformed cell was found; "
            "check fluid_particle_mass, wall_stiffness and repulsion_strength"
        )
    return z[0, :, :, 0].T.copy(), stress[0, :, :, 0].copy(), factors, bool(stable[0, 0])

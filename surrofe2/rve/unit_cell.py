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
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tiles import Constants, make_constants, make_topology, pack
from surrofe2.rve.arranged_cells import find_reference, make_lists
from surrofe2.rve.constrained_runs import iterate_tile
from surrofe2.rve.factors import Factors
from surrofe2.rve.newton import SOLVE, newton, renew
from surrofe2.rve.reference_state import ReferenceState
from surrofe2.rve.systems import AnyTopology, empty_factors
from surrofe2.simd import TILE

REACHES = (1.2, 1.4, 2.0, 3.0)
"""Lists of contacts, in cut-offs; the shortest that provably covers a deformation serves."""
_RELAXED = 1e-10
_FIRST_GUESS = 0.5
_SETTLING_STEP, _SETTLED, _SETTLING_LIMIT = 1e-3, 1.0, 200_000


@dataclass(frozen=True, slots=True)
class UnitCell:
    """An RVE ready to be solved: its reference state, and what kernels need of it.

    Attributes:
        reference: relaxed positions, lattice and rest length.
        patches, topologies: pair lists of rising reach.
        unlisted: what each list leaves out; None where its reach alone has to tell.
        factors: factorisation at the reference, one tile.
    """

    cell: CellParameters
    reference: ReferenceState
    constants: Constants
    patches: tuple[Patch, ...]
    topologies: tuple[AnyTopology, ...]
    factors: Factors
    unlisted: tuple[Unlisted | None, ...]

    @property
    def position(self) -> NDArray[np.float64]:
        """(n, 2) relaxed reference positions, µm; particle 0 is a wall corner at 0."""
        return self.reference.position

    @property
    def rest_length(self) -> float:
        """Wall rest length l₀, µm, at which the reference is free of stress."""
        return self.reference.rest_length

    @property
    def area(self) -> float:
        """Reference area, µm²."""
        return self.patches[0].area


@lru_cache(maxsize=32)
def make_unit_cell(cell: CellParameters, reference: ReferenceState | None = None) -> UnitCell:
    """The RVE of `cell` around its reference state, which is settled unless it is given.

    Raises:
        InputError: no positive rest length balances the turgor, or no stable equilibrium exists.
        MismatchError: the reference is of another cell.
    """
    if reference is None:
        return make_unit_cell(cell, settle_reference(cell))
    reference.check_belongs_to(cell)
    position, lattice = reference.position, reference.lattice
    patches: tuple[Patch, ...]
    topologies: tuple[AnyTopology, ...]
    unlisted: tuple[Unlisted | None, ...]
    if cell.is_one_square:
        patches = tuple(
            square_patch(cell, position, reach=factor * cell.repulsion_cutoff) for factor in REACHES
        )
        topologies = tuple(make_topology(p) for p in patches)
        unlisted = (None,) * len(patches)
    else:
        lists = make_lists(cell, position, lattice)
        patches, topologies, unlisted = lists.patches, lists.topologies, lists.unlisted
    constants = make_constants(cell, reference.rest_length)
    factors = _reference_factors(position, topologies[0], constants)
    return UnitCell(cell, reference, constants, patches, topologies, factors, unlisted)


@lru_cache(maxsize=32)
def settle_reference(cell: CellParameters) -> ReferenceState:
    """Relax plant cells at F = I and find the rest length (and box) that frees them of stress.

    Raises:
        InputError: no positive rest length balances the turgor, or no stable equilibrium exists.
    """
    if not cell.is_one_square:
        one = settle_reference(replace(cell, arrangement="square", cells=1, arrangement_seed=1))
        found = find_reference(cell, one.rest_length)
        return ReferenceState(cell.fingerprint, found.position, found.lattice, found.rest_length)
    spring = cell.cell_side / cell.wall_springs_per_side
    start = even_positions(cell)
    patch = square_patch(cell, start, reach=REACHES[-1] * cell.repulsion_cutoff)
    guess = [_descend(patch, make_constants(cell, _FIRST_GUESS * spring), start)]

    def pressure(relative_length: float) -> float:
        constants = make_constants(cell, relative_length * spring)
        guess[0], stress, _ = _relax(patch, constants, guess[0])
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
    position, _, stable = _relax(patch, constants, guess[0])
    if not stable:
        raise InputError(
            "cell: the equilibrium of the undeformed cell is unstable; "
            "check fluid_particle_mass, wall_stiffness and repulsion_strength"
        )
    return ReferenceState(cell.fingerprint, position, patch.lattice, rest_length)


def _reference_factors(
    position: NDArray[np.float64], topology: AnyTopology, constants: Constants
) -> Factors:
    """Factorisation at F = I, one tile."""
    z = np.ascontiguousarray(
        np.broadcast_to(position.T[None, ..., None], (1, 2, len(position), TILE))
    )
    unit = pack(np.eye(2)[None])
    factors = empty_factors(topology, 1)
    stable = np.empty((1, TILE), dtype=np.bool_)
    renew(unit, np.zeros_like(unit), z, factors, np.array([True]), topology, constants, stable)
    if not stable.all():
        raise InputError("reference: not a stable equilibrium of this cell; have it settled anew")
    return factors


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
) -> tuple[NDArray[np.float64], NDArray[np.float64], bool]:
    """Elastic equilibrium at F = I: positions (n, 2), stress (2, 2), whether stable."""
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
    return z[0, :, :, 0].T.copy(), stress[0, :, :, 0].copy(), bool(stable[0, 0])

"""An RVE ready to be solved: its reference state, pair lists and factorisation at F = I."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.plant_cell.arrangement import make_arrangement
from surrofe2.plant_cell.pair_lists import Patch, make_patches
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.plant_cell.tiles import Constants, RveTopology, make_constants, pack
from surrofe2.rve.newton import renew
from surrofe2.rve.particle_state import Drive
from surrofe2.rve.reference_state import make_topologies, settle_reference
from surrofe2.rve.rve_state import Factors
from surrofe2.simd import TILE

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class UnitCell:
    """Reference state of an RVE, and what kernels need of it.

    Attributes:
        reference: relaxed positions, lattice and rest length.
        patches, topologies: pair lists of rising reach; the shortest that provably covers a
            deformation serves.
        factors: factorisation at the reference, one tile.
    """

    cell: CellParameters
    reference: ReferenceState
    constants: Constants
    patches: tuple[Patch, ...]
    topologies: tuple[RveTopology, ...]
    factors: Factors

    @property
    def position(self) -> Array:
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
    position = reference.position
    if len(position) != make_arrangement(cell).particles:
        raise InputError("reference: another number of particles; have it settled anew")
    patches = make_patches(cell, position, reference.lattice)
    topologies = make_topologies(cell, patches)
    constants = make_constants(cell, reference.rest_length)
    z = np.repeat(np.ascontiguousarray(position.T)[None, ..., None], TILE, axis=-1)
    unit = pack(np.eye(2)[None])
    factors = Factors.empty(1, topologies[0])
    drive = Drive(unit, np.zeros_like(unit))
    stable = renew(drive, z, factors, np.array([True]), topologies[0], constants)
    if not stable.all():
        raise InputError("reference: not a stable equilibrium of this cell; have it settled anew")
    return UnitCell(cell, reference, constants, patches, topologies, factors)

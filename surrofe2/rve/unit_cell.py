"""An RVE ready to be solved: its reference state, pair lists and factorisation at F = I."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.errors import InputError
from surrofe2.plant_cell.arrangement import make_arrangement
from surrofe2.plant_cell.pair_lists import Patch, make_patches
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.plant_cell.tiles import Constants, make_constants, pack
from surrofe2.rve.factors import Factors
from surrofe2.rve.newton import renew
from surrofe2.rve.particle_state import list_covers
from surrofe2.rve.reference_state import make_topologies, settle_reference
from surrofe2.rve.systems import AnyTopology, empty_factors
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
    topologies: tuple[AnyTopology, ...]
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

    def covered(self, level: int, F: Array, z: Array) -> NDArray[np.bool_]:
        """(tiles, TILE): whether the contacts that list `level` holds are all there can be.

        First by the bound of `list_covers`; where that is too coarse, the pairs up to a longer
        reach that the list leaves out are looked at one by one.
        """
        patch, cutoff = self.patches[level], self.cell.repulsion_cutoff
        covered = np.empty((len(F), TILE), dtype=np.bool_)
        list_covers(F, z, self.position, patch.reach, cutoff, covered)
        if covered.all():
            return covered
        farther, apart = np.empty_like(covered), np.empty_like(covered)
        unlisted = patch.unlisted
        list_covers(F, z, self.position, unlisted.reach, cutoff, farther)
        _all_apart(F, z, unlisted.pairs, unlisted.offset, cutoff, apart)
        return covered | (farther & apart)


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
    factors, stable = empty_factors(topologies[0], 1), np.empty((1, TILE), dtype=np.bool_)
    every = np.array([True])
    renew(unit, np.zeros_like(unit), z, factors, every, topologies[0], constants, stable)
    if not stable.all():
        raise InputError("reference: not a stable equilibrium of this cell; have it settled anew")
    return UnitCell(cell, reference, constants, patches, topologies, factors)


@kernel
def _all_apart(F, z, pairs, offset, cutoff, apart):
    apart[:] = True
    for t in range(z.shape[0]):
        for k in range(pairs.shape[0]):
            i, j = pairs[k, 0], pairs[k, 1]
            for lane in range(TILE):
                rx = z[t, 0, j, lane] + offset[k, 0] - z[t, 0, i, lane]
                ry = z[t, 1, j, lane] + offset[k, 1] - z[t, 1, i, lane]
                px = F[t, 0, 0, lane] * rx + F[t, 0, 1, lane] * ry
                py = F[t, 1, 0, lane] * rx + F[t, 1, 1, lane] * ry
                if px * px + py * py < cutoff * cutoff:
                    apart[t, lane] = False

"""The warm start of an RVE law: what its particles did at the last point in time."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.lanes import pack, put_points, unpack
from surrofe2.plant_cell.simd import TILE
from surrofe2.rve.unit_cell import UnitCell

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RveState:
    """Particles of n RVEs in tiles, at the deformation they were solved at.

    Attributes:
        points: n; the last tile is filled up with copies.
        z: (tiles, 2, particles, TILE) material positions, x = F z, µm.
        fluctuation: same shape, v − L x, µm/µs; zero for affine velocities.
        elastic: same shape, z of the elastic equilibrium that "slow-manifold" starts from.
        F, F_dot: (tiles, 2, 2, TILE) where z was solved.
        lu, slopes: kept factorisation and prediction, see `direct`.
        iterations: (tiles, TILE) force evaluations of the last solve.
    """

    points: int
    z: Reals
    fluctuation: Reals
    elastic: Reals
    F: Reals
    F_dot: Reals
    lu: NDArray[np.float32]
    slopes: Reals
    iterations: NDArray[np.int32]

    def take(self, index: NDArray[np.intp]) -> RveState:
        """The state of the points `index` alone."""
        parts = {
            item.name: pack(unpack(getattr(self, item.name), self.points)[index])
            for item in fields(self)
            if item.name != "points"
        }
        return RveState(points=len(index), **parts)

    def put(self, index: NDArray[np.intp], part: RveState) -> RveState:
        """This state with the points `index` replaced by those of `part`."""
        parts = {}
        for item in fields(self):
            if item.name != "points":
                mine = getattr(self, item.name).copy()
                put_points(mine, index, getattr(part, item.name))
                parts[item.name] = mine
        return RveState(points=self.points, **parts)


def rest_state(unit: UnitCell, points: int) -> RveState:
    """n RVEs in the reference state at F = I, Ḟ = 0."""

    def everywhere(value: NDArray[Any]) -> NDArray[Any]:
        tiles = -(-points // TILE)
        lanes = np.broadcast_to(value[..., None], (*value.shape, TILE))
        return np.ascontiguousarray(np.broadcast_to(lanes, (tiles, *lanes.shape)))

    z = everywhere(unit.position.T)
    identity = everywhere(np.eye(2))
    return RveState(
        points=points,
        z=z,
        fluctuation=np.zeros_like(z),
        elastic=z,
        F=identity,
        F_dot=np.zeros_like(identity),
        lu=everywhere(unit.factors.lu[0, :, :, 0]),
        slopes=everywhere(unit.factors.slopes[0, :, :, 0]),
        iterations=np.zeros((len(z), TILE), dtype=np.int32),
    )

"""The warm start of an RVE law: what its particles did at the last point in time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.tiles import pack, put_points, tiles_for, unpack
from surrofe2.rve.factors import Factors
from surrofe2.rve.unit_cell import UnitCell
from surrofe2.simd import TILE

Reals = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RveState:
    """Particles of n RVEs in tiles, at the deformation they were solved at.

    Attributes:
        points: n; the last tile is filled up with copies.
        z: (tiles, 2, particles, TILE) material positions, x = F z, µm.
        fluctuation: same shape, v − L x, µm/µs; None: zero, velocities are affine.
        elastic: same shape, z of the elastic equilibrium that "slow-manifold" starts from;
            None: z itself.
        F, F_dot: (tiles, 2, 2, TILE) where z was solved.
        factors: kept factorisation and prediction, see `direct`.
        iterations: (tiles, TILE) force evaluations of the last solve.
        left: (tiles, TILE) whether the RVE left its branch at a bifurcation on its way here; None:
            nowhere.
        is_checked: whether every point was found stable at this very z, its factors made there.
    """

    points: int
    z: Reals
    fluctuation: Reals | None
    elastic: Reals | None
    F: Reals
    F_dot: Reals
    factors: Factors
    iterations: NDArray[np.int32]
    left: NDArray[np.bool_] | None = None
    is_checked: bool = False

    @property
    def relaxed(self) -> Reals:
        """z of the elastic equilibrium."""
        return self.z if self.elastic is None else self.elastic

    @property
    def beyond_affine(self) -> Reals:
        """v − L x."""
        return np.zeros_like(self.z) if self.fluctuation is None else self.fluctuation

    @property
    def left_points(self) -> NDArray[np.bool_]:
        """(points,) `left`."""
        return unpack(flags(self), self.points)

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All of it, for `from_arrays`; shared blocks of factors once."""
        arrays = {
            "points": np.array(self.points),
            "z": self.z,
            "F": self.F,
            "F_dot": self.F_dot,
            "iterations": self.iterations,
            "is_checked": np.array(self.is_checked),
            **self.factors.to_arrays(),
        }
        for name, values in (
            ("fluctuation", self.fluctuation), ("elastic", self.elastic), ("left", self.left),
        ):  # fmt: skip
            if values is not None:
                arrays[name] = values
        return arrays

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> RveState:
        """The state whose `to_arrays` gave these, to the bit."""
        return cls(
            points=int(arrays["points"]),
            z=arrays["z"],
            fluctuation=arrays.get("fluctuation"),
            elastic=arrays.get("elastic"),
            F=arrays["F"],
            F_dot=arrays["F_dot"],
            factors=Factors.from_arrays(arrays),
            iterations=arrays["iterations"],
            left=arrays.get("left"),
            is_checked=bool(arrays["is_checked"]),
        )

    def take(self, index: NDArray[np.intp]) -> RveState:
        """The state of the points `index` alone."""
        if len(index) == self.points and (index == np.arange(self.points)).all():
            return self

        def taken(tiles: NDArray[Any]) -> NDArray[Any]:
            return pack(unpack(tiles, self.points)[index])

        return RveState(
            points=len(index),
            z=taken(self.z),
            fluctuation=None if self.fluctuation is None else taken(self.fluctuation),
            elastic=None if self.elastic is None else taken(self.elastic),
            F=taken(self.F),
            F_dot=taken(self.F_dot),
            factors=self.factors.take(index),
            iterations=taken(self.iterations),
            left=None if self.left is None else taken(self.left),
            is_checked=self.is_checked,
        )

    def put(self, index: NDArray[np.intp], part: RveState) -> RveState:
        """This state with the points `index` replaced by those of `part`."""
        index, row = with_copies(index, self.points)
        part = part.take(row)

        def put(mine: NDArray[Any], theirs: NDArray[Any]) -> NDArray[Any]:
            mine = mine.copy()
            put_points(mine, index, theirs)
            return mine

        affine = self.fluctuation is None and part.fluctuation is None
        at_rest = self.elastic is None and part.elastic is None
        on_branch = self.left is None and part.left is None
        return RveState(
            points=self.points,
            z=put(self.z, part.z),
            fluctuation=None if affine else put(self.beyond_affine, part.beyond_affine),
            elastic=None if at_rest else put(self.relaxed, part.relaxed),
            F=put(self.F, part.F),
            F_dot=put(self.F_dot, part.F_dot),
            factors=self.factors.put(index, part.factors),
            iterations=put(self.iterations, part.iterations),
            left=None if on_branch else put(flags(self), flags(part)),
            is_checked=self.is_checked and part.is_checked,
        )


def with_copies(index: NDArray[np.intp], points: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """`index` and, if the last point is in it, the lanes that fill its tile up with copies of it.

    The second array says which place of the given `index` each comes from.
    """
    place = np.arange(len(index))
    last = place[index == points - 1]
    copies = np.arange(points, tiles_for(points) * TILE if len(last) else points)
    return np.append(index, copies), np.append(place, np.repeat(last, len(copies)))


def flags(state: RveState) -> NDArray[np.bool_]:
    """`left` of a state, (tiles, TILE)."""
    on_branch = np.zeros(state.iterations.shape, dtype=np.bool_)
    return on_branch if state.left is None else state.left


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
        fluctuation=None,
        elastic=None,
        F=identity,
        F_dot=np.zeros_like(identity),
        factors=unit.factors.repeated(len(z)),
        iterations=np.zeros((len(z), TILE), dtype=np.int32),
    )

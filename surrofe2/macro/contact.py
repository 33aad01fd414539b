"""Contact of a boundary with a rigid body: a smooth penalty and Coulomb friction.

Contact acts at three points of each side, by unloaded length. With the gap g of a point,

    p = k φ(−g),   φ(d) = 0 (d ≤ 0),  d²/2δ (0 < d < δ),  d − δ/2 (d ≥ δ),

a pressure with a continuous slope that is the slope of an energy. Friction is −µ p w/√(w² + s²) in
the direction of the sliding velocity w, s being the slip speed: a force that follows Coulomb's law
where sliding is fast and creeps where it is slow. The body takes the opposite forces, so momentum
is kept to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy  # scipy.sparse is loaded where a body is touched
from numpy.typing import NDArray

from surrofe2.macro.forces import Matrix, Slopes, side_points
from surrofe2.macro.rigid_bodies import RigidBody, Shape

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Contact:
    """The contact force of one rigid body.

    Attributes:
        name: of the body. row: that of its displacement among those of the nodes.
        shape: its outline. position: (2,) at t = 0, µm.
        sides: (m, k) nodes of the sides that may touch it.
        points: (m, 3, 2) reference positions. lengths: (m, 3). shapes: (3, k).
        stiffness: k, µN/µm². smoothing: δ, µm.
        friction: µ. slip_speed: s, µm/µs.
    """

    name: str
    row: int
    shape: Shape
    position: Array
    sides: Index
    points: Array
    lengths: Array
    shapes: Array
    stiffness: float
    smoothing: float
    friction: float
    slip_speed: float

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """As of `Force`."""
        force = np.zeros(u.shape)
        gap, normal, _ = self._gaps(u)
        if not (gap < 0.0).any():
            return force
        pressure, _ = self._pressure(gap)
        traction = pressure[:, None] * normal
        if self.friction:
            tangent, sliding = self._sliding(normal, v)
            drag = self.friction * pressure * sliding / np.hypot(sliding, self.slip_speed)
            traction = traction - drag[:, None] * tangent
        at_points = traction.reshape(*self.lengths.shape, 2) * self.lengths[:, :, None]
        np.add.at(force, self.sides, np.einsum("mqi,qa->mai", at_points, self.shapes))
        force[self.row] -= at_points.sum(axis=(0, 1))
        return force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        """As of `Force`."""
        gap, normal, curvature = self._gaps(u)
        touching = np.flatnonzero(gap < 0.0)
        if not touching.size:
            return None
        pressure, slope = self._pressure(gap)
        outer = np.einsum("ni,nj->nij", normal, normal)
        # ∂(p n)/∂x with ∂g/∂x = n and ∂p/∂g = −slope.
        by_x = -slope[:, None, None] * outer
        by_x += (pressure * curvature)[:, None, None] * (np.eye(2) - outer)
        by_v = np.zeros_like(by_x)
        if self.friction:
            tangent, w = self._sliding(normal, v)
            size = np.hypot(w, self.slip_speed)
            relative = (v[self.sides].transpose(0, 2, 1) @ self.shapes.T).transpose(0, 2, 1)
            relative = relative.reshape(-1, 2) - v[self.row]
            along = w / size
            by_x += (
                self.friction
                * (slope * along)[:, None, None]
                * np.einsum("ni,nj->nij", tangent, normal)
            )
            # The frame turns with the point: ∂n/∂x = κ τ τᵀ, ∂τ/∂x = −κ n τᵀ.
            by_x += (
                self.friction
                * (pressure * along * curvature)[:, None, None]
                * np.einsum("ni,nj->nij", normal, tangent)
            )
            towards = np.einsum("ni,ni->n", relative, normal)
            steep = self.friction * pressure * self.slip_speed**2 / size**3
            both = np.einsum("ni,nj->nij", tangent, tangent)
            by_x += (steep * curvature * towards)[:, None, None] * both
            by_v = -steep[:, None, None] * both
        n = u.size
        return self._assembled(-by_x, touching, n), self._assembled(-by_v, touching, n)

    def penetration(self, u: Array) -> float:
        """Deepest penetration of any point, µm."""
        return float(max(0.0, -self._gaps(u)[0].min()))

    def energy(self, u: Array) -> float:
        """Energy stored in the penalty, pJ."""
        d, delta = np.maximum(-self._gaps(u)[0], 0.0), self.smoothing
        far = 0.5 * d**2 - 0.5 * delta * d + delta**2 / 6.0
        density = self.stiffness * np.where(d < delta, d**3 / (6.0 * delta), far)
        return float(density @ self.lengths.ravel())

    def _gaps(self, u: Array) -> tuple[Array, Array, Array]:
        moved = self.points + np.einsum("qa,mai->mqi", self.shapes, u[self.sides])
        return self.shape.gap((moved - self.position - u[self.row]).reshape(-1, 2))

    def _pressure(self, gap: Array) -> tuple[Array, Array]:
        """Pressure and its slope by the depth."""
        d, delta = np.maximum(-gap, 0.0), self.smoothing
        near = d < delta
        pressure = np.where(near, d**2 / (2.0 * delta), d - 0.5 * delta)
        return self.stiffness * pressure, self.stiffness * np.where(near, d / delta, 1.0)

    def _sliding(self, normal: Array, v: Array) -> tuple[Array, Array]:
        """(n, 2) tangents and (n,) sliding velocities along them."""
        tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        moving = np.einsum("qa,mai->mqi", self.shapes, v[self.sides]).reshape(-1, 2)
        return tangent, np.einsum("ni,ni->n", moving - v[self.row], tangent)

    def _assembled(self, blocks: Array, touching: Index, size: int) -> Matrix:
        """Σ L B ⊗ (N, −1) (N, −1)ᵀ over the points that touch, (size, size)."""
        side, q = np.divmod(touching, 3)
        weights = np.column_stack([self.shapes[q], -np.ones(len(q))])
        rows = np.column_stack([self.sides[side], np.full(len(q), self.row)])
        unknowns = (2 * rows[:, :, None] + np.arange(2)).reshape(len(q), -1)
        scaled = self.lengths.ravel()[touching, None, None] * blocks[touching]
        matrices = np.einsum("pa,pb,pij->paibj", weights, weights, scaled)
        n = unknowns.shape[1]
        row, column = np.repeat(unknowns, n, axis=1), np.tile(unknowns, (1, n))
        return scipy.sparse.csc_matrix(
            (matrices.ravel(), (row.ravel(), column.ravel())), shape=(size, size)
        )


def make_contact(
    body: RigidBody, row: int, nodes: Array, sides: Index, modulus: float, wave_speed: float
) -> Contact:
    """The contact of `body` with sides (m, k); defaults from the tissue's modulus (µN/µm)."""
    lengths, shape, _ = side_points(nodes, sides)
    size = float(lengths.sum() / len(sides))
    return Contact(
        name=body.name,
        row=row,
        shape=body.shape,
        position=np.array(body.position),
        sides=sides,
        points=np.einsum("qa,mai->mqi", shape, nodes[sides]),
        lengths=lengths,
        shapes=shape,
        stiffness=20.0 * modulus / size if body.stiffness is None else body.stiffness,
        smoothing=0.01 * size if body.smoothing is None else body.smoothing,
        friction=body.friction,
        slip_speed=1e-3 * wave_speed if body.slip_speed is None else body.slip_speed,
    )

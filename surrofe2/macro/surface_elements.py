"""Line elements along free sides, whose tension a surface law gives (docs/theory.md, surface law).

With S the undeformed length along a side, g = ∂x/∂S, λ = |g|, n = g/λ and λ̇ = n·ġ, the force on
node a and its slopes are

    f_a = −∫ P_s(λ, λ̇) n N_a′ dS,
    −∂f_a/∂u_b = ∫ N_a′ N_b′ [∂P_s/∂λ n⊗n + ∂P_s/∂λ̇ n⊗(ġ − λ̇ n)/λ + P_s/λ (I − n⊗n)] dS,
    −∂f_a/∂v_b = ∫ N_a′ N_b′ ∂P_s/∂λ̇ n⊗n dS,

by one point on a side of two nodes, two Gauss points on one of three. f·v = −∫ P_s λ̇ dS at the same
points. The unknowns count from the rest under surface tension, g from the undeformed state.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy  # scipy.sparse is loaded where a force has slopes
from numpy.typing import NDArray

from surrofe2.compilation import kernel
from surrofe2.macro.forces import Slopes
from surrofe2.macro.free_sides import FreeSides, free_sides
from surrofe2.macro.problem import SURFACE, Problem
from surrofe2.surface_law import SurfaceResponse

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class SurfaceForce:
    """The force of all free sides.

    Attributes:
        sides: which they are.
        slopes_of_shape: (m, q, k) N_a′ by the undeformed length, 1/µm.
        weights: (m, q) undeformed length of each point, µm.
        directions: (m, q, 2) g where the unknowns are zero.
        points: of each law, numbers of its points.
    """

    sides: FreeSides
    slopes_of_shape: Array
    weights: Array
    directions: Array
    points: tuple[Index, ...]

    @property
    def name(self) -> str:
        """As of `Force`."""
        return SURFACE

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """As of `Force`; NaN where a law has no answer."""
        g, stretch, rate = self._stretches(u, v)
        tension = self._ask(stretch, rate).tension
        force: Array = side_forces(
            self.sides.nodes, self.slopes_of_shape, self.weights, g, stretch, tension, len(u)
        )
        return force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes:
        """As of `Force`."""
        g, stretch, rate = self._stretches(u, v)
        answer = self._ask(stretch, rate, tangents=True)
        assert answer.tangent is not None
        assert answer.rate_tangent is not None
        n = g / stretch[:, None]
        along = np.einsum("pi,pj->pij", n, n)
        across = np.eye(2) - along
        g_dot = np.einsum("mqa,mai->mqi", self.slopes_of_shape, v[self.sides.nodes]).reshape(-1, 2)
        turning = np.einsum("pi,pj->pij", n, (g_dot - rate[:, None] * n) / stretch[:, None])
        by_g = answer.tangent[:, None, None] * along + answer.rate_tangent[:, None, None] * turning
        by_g += (answer.tension / stretch)[:, None, None] * across
        by_g_dot = answer.rate_tangent[:, None, None] * along
        return self._assembled(by_g, u.size), self._assembled(by_g_dot, u.size)

    def dissipation_rates(self, u: Array, v: Array) -> Array:
        """(b,) ∫ (P_s(λ, λ̇) − P_s(λ, 0)) λ̇ dS along each of `FreeSides.names`, pJ/µs."""
        _, stretch, rate = self._stretches(u, v)
        excess = self._ask(stretch, rate).tension - self._ask(stretch, 0.0 * rate).tension
        power = (self.weights * (excess * rate).reshape(self.weights.shape)).sum(axis=1)
        return np.bincount(self.sides.boundary, power, len(self.sides.names)).astype(np.float64)

    def from_rest(self, u: Array) -> SurfaceForce:
        """The same with unknowns that count from the displacement u (n, 2)."""
        moved = np.einsum("mqa,mai->mqi", self.slopes_of_shape, u[self.sides.nodes])
        return replace(self, directions=self.directions + moved)

    def mass(self, inside: Array) -> tuple[Array, Index, Index]:
        """Entries, rows and columns of the mass excess, ng, as of `Discretisation.mass`.

        Args:
            inside: (n_el,) factor of the sides beside each element.
        """
        per_length = np.array([law.mass for law in self.sides.laws])[self.sides.law]
        per_length = per_length * inside[self.sides.elements]
        lengths = (self.weights.sum(axis=1) * per_length)[:, None, None]
        blocks = lengths * _UNIT_MASS[self.sides.nodes.shape[1]]
        row, column = np.broadcast_arrays(
            self.sides.nodes[:, :, None], self.sides.nodes[:, None, :]
        )
        return blocks.ravel(), row.ravel(), column.ravel()

    def refusal(self, nodes: Array, u: Array, v: Array) -> str:
        """Where a law has no answer, and for which stretch."""
        _, stretch, rate = self._stretches(u, v)
        p = int(np.argmin(self._ask(stretch, rate).valid))
        x, y = nodes[self.sides.nodes[p // self.weights.shape[1]][:2]].mean(axis=0)
        return (
            f"free side at ({x:.6g}, {y:.6g}) µm, stretch {stretch[p]:.6g}, rate {rate[p]:.6g} "
            "1/µs: its surface law has no answer there"
        )

    def _stretches(self, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """(p, 2) g, (p,) λ and λ̇."""
        g, stretch, rate = side_stretches(
            self.sides.nodes, self.slopes_of_shape, self.directions, u, v
        )
        return g, stretch, rate

    def _ask(self, stretch: Array, rate: Array, *, tangents: bool = False) -> SurfaceResponse:
        laws = self.sides.laws
        if len(laws) == 1:
            return laws[0].respond(stretch, rate, tangents=tangents)
        tension, by_stretch, by_rate = np.zeros((3, stretch.size))
        valid = np.zeros(stretch.size, dtype=bool)
        for law, own in zip(laws, self.points, strict=True):
            answer = law.respond(stretch[own], rate[own], tangents=tangents)
            tension[own], valid[own] = answer.tension, answer.valid
            if answer.tangent is not None and answer.rate_tangent is not None:
                by_stretch[own], by_rate[own] = answer.tangent, answer.rate_tangent
        return SurfaceResponse(tension, valid, by_stretch, by_rate)

    def _assembled(self, by_g: Array, size: int) -> scipy.sparse.csc_matrix:
        """Σ w N_a′ N_b′ of matrices (p, 2, 2), (size, size)."""
        slopes, nodes = self.slopes_of_shape, self.sides.nodes
        by_g = by_g.reshape(*self.weights.shape, 2, 2)
        blocks = np.einsum("mq,mqa,mqb,mqij->maibj", self.weights, slopes, slopes, by_g)
        unknowns = (2 * nodes[:, :, None] + np.arange(2)).reshape(len(nodes), -1)
        row, column = np.broadcast_arrays(unknowns[:, :, None], unknowns[:, None, :])
        entries = blocks.ravel(), (row.ravel(), column.ravel())
        return scipy.sparse.csc_matrix(entries, shape=(size, size))


_UNIT_MASS = {
    2: np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0,
    3: np.array([[4.0, -1.0, 2.0], [-1.0, 4.0, 2.0], [2.0, 2.0, 16.0]]) / 30.0,
}
"""∫ N_a N_b over a side of length 1, of a curved one as if it were straight."""


def make_surface(problem: Problem) -> SurfaceForce:
    """The free sides of a problem that has a surface, at the undeformed mesh."""
    sides = free_sides(problem)
    k, corners = sides.nodes.shape[1], problem.mesh.nodes[sides.nodes]
    s, rule = np.polynomial.legendre.leggauss(k - 1)
    if k == 2:
        by_s = np.tile([-0.5, 0.5], (1, 1))
    else:
        by_s = np.stack([s - 0.5, s + 0.5, -2.0 * s], axis=1)
    along = np.einsum("qa,mai->mqi", by_s, corners)
    length = np.linalg.norm(along, axis=2)
    points = np.arange(length.size).reshape(length.shape)
    return SurfaceForce(
        sides=replace(sides, nodes=np.ascontiguousarray(sides.nodes)),
        slopes_of_shape=by_s / length[:, :, None],
        weights=length * rule,
        directions=along / length[:, :, None],
        points=tuple(points[sides.law == each].ravel() for each in range(len(sides.laws))),
    )


@kernel
def side_stretches(sides: Any, slopes: Any, directions: Any, u: Any, v: Any) -> Any:
    """g = g₀ + Σ_a u_a N_a′, λ = |g| and λ̇ = g·Σ_a v_a N_a′/λ at all points of all sides.

    Args:
        sides: (m, k) rows of u and v. slopes: (m, q, k) N_a′. directions: (m, q, 2) g₀.

    Returns:
        (m q, 2), (m q,) and (m q,).
    """
    m, n_q, k = slopes.shape
    g, stretch, rate = np.empty((m * n_q, 2)), np.empty(m * n_q), np.empty(m * n_q)
    for e in range(m):
        for q in range(n_q):
            p = n_q * e + q
            gx, gy, wx, wy = directions[e, q, 0], directions[e, q, 1], 0.0, 0.0
            for a in range(k):
                row, slope = sides[e, a], slopes[e, q, a]
                gx += slope * u[row, 0]
                gy += slope * u[row, 1]
                wx += slope * v[row, 0]
                wy += slope * v[row, 1]
            length = np.sqrt(gx * gx + gy * gy)
            g[p, 0], g[p, 1] = gx, gy
            stretch[p], rate[p] = length, (gx * wx + gy * wy) / length
    return g, stretch, rate


@kernel
def side_forces(
    sides: Any, slopes: Any, weights: Any, g: Any, stretch: Any, tension: Any, n: Any
) -> Any:
    """f_a = −Σ_q w P_s g/λ N_a′, (n, 2) µN; sides add up in their order."""
    m, n_q, k = slopes.shape
    force = np.zeros((n, 2))
    for e in range(m):
        for q in range(n_q):
            p = n_q * e + q
            pull = weights[e, q] * tension[p] / stretch[p]
            for a in range(k):
                row, slope = sides[e, a], slopes[e, q, a]
                force[row, 0] -= pull * slope * g[p, 0]
                force[row, 1] -= pull * slope * g[p, 1]
    return force

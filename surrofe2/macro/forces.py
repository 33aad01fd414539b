"""Forces on the nodes besides the tissue's own: loads, follower pressure, foundations, contact.

The first are forms of scikit-fem over facets, whose unknowns are numbered as ours.

A force knows its slopes, which Newton's method needs. Unknown 2 a + i is component i of node a; the
positions of rigid bodies are numbered on after the nodes of the mesh.

Contact of a boundary with a rigid body is a smooth penalty, a dashpot and Coulomb friction. The law
stands in `contact_law`; it acts at three points of each side. Without its dashpot the boundary's
nodes would bounce off a stiff spring, for they have a mass and the true boundary has none. Where
nothing has a velocity friction follows from the sliding Δ since the last equilibrium and the
friction τ of that: τ + k Δ, at most µ p, so that a point sticks to the body by the spring k or
slips by Coulomb's law. The body takes the opposite forces, so momentum is kept to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import scipy.sparse
import skfem
from numpy.typing import NDArray
from skfem.quadrature import get_quadrature
from skfem.refdom import RefLine

from surrofe2.macro.elements import assembled
from surrofe2.problem import contact_law
from surrofe2.problem.amplitude import ONE, Amplitude, Proportional
from surrofe2.problem.conditions import (
    BodyForce,
    DrivenCondition,
    Foundation,
    Pressure,
    Traction,
)
from surrofe2.problem.mesh import boundary, region
from surrofe2.problem.problem import Problem, label
from surrofe2.problem.rigid_bodies import RigidBody, Shape, check_outside

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Matrix = Any
"""Sparse by columns, or dense where it is small."""
SIDES = {2: skfem.ElementLineP1(), 3: skfem.ElementLineP2()}
"""By the number of nodes of a side."""
Slopes = tuple[Matrix, Matrix]


class Force(Protocol):
    """A force on nodes and rigid bodies.

    Attributes:
        name: of the condition it comes from.
    """

    @property
    def name(self) -> str: ...

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """(n, 2) µN at displacement u and velocity v (n, 2); `within` as of `Amplitude`."""

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        """−∂f/∂u and −∂f/∂v, (2 n, 2 n); None where both are zero."""


@dataclass(frozen=True, slots=True)
class LinearForce:
    """f = A(t) (f₀ − K u − C v): dead loads, follower pressure, springs and dashpots.

    Attributes:
        dead: (n, 2) f₀, µN. slopes_at_one: K and C (2 n, 2 n), µN/µm and µN µs/µm; None: zero.
    """

    name: str
    dead: Array
    amplitude: Amplitude = ONE
    slopes_at_one: Slopes | None = None

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        force = self.dead
        if self.slopes_at_one is not None:
            K, C = self.slopes_at_one
            force = force - (K @ u.ravel() + C @ v.ravel()).reshape(u.shape)
        return self.amplitude.at(t, within)[0] * force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        if self.slopes_at_one is None:
            return None
        factor, (K, C) = self.amplitude.at(t, within)[0], self.slopes_at_one
        return factor * K, factor * C


def facet_basis(mesh: skfem.Mesh, facets: Index) -> skfem.FacetBasis:
    """Displacements along outer facets."""
    return skfem.FacetBasis(mesh, skfem.ElementVector(mesh.elem()), facets=facets)


def traction_load(mesh: skfem.Mesh, facets: Index, traction: tuple[float, float]) -> Array:
    """(n_nodes, 2) ∫ N_a t dL over reference facets, µN."""
    form = skfem.LinearForm(lambda v, w: traction[0] * v[0] + traction[1] * v[1])
    load: Array = form.assemble(facet_basis(mesh, facets)).reshape(-1, 2)
    return load


def pressure_load(mesh: skfem.Mesh, facets: Index, pressure: float) -> tuple[Array, Matrix]:
    """f₀ (n_nodes, 2) and B (2 n_nodes, 2 n_nodes) of a follower pressure.

    f = −p ∫ v · cof(I + ∇u) n dL: the current normal times length is the cofactor of F times the
    reference normal n times length, and in the plane the cofactor is linear in F.
    """

    def work(u: Any, v: Any, w: Any) -> Any:
        (xx, xy), (yx, yy) = u.grad
        return -pressure * (v[0] * (yy * w.n[0] - yx * w.n[1]) + v[1] * (xx * w.n[1] - xy * w.n[0]))

    basis = facet_basis(mesh, facets)
    dead = skfem.LinearForm(lambda v, w: -pressure * (v[0] * w.n[0] + v[1] * w.n[1]))
    slope = skfem.BilinearForm(work).assemble(basis)
    return dead.assemble(basis).reshape(-1, 2), slope


def foundation_matrix(mesh: skfem.Mesh, facets: Index, components: str) -> Matrix:
    """(2 n_nodes, 2 n_nodes) ∫ N_a N_b dL over reference facets for the components, µm."""
    x, y = float("x" in components), float("y" in components)
    form = skfem.BilinearForm(lambda u, v, w: x * u[0] * v[0] + y * u[1] * v[1])
    return form.assemble(facet_basis(mesh, facets))


def side_points(nodes: Array, sides: Index) -> tuple[Array, Array]:
    """Quadrature along sides: (m, 3) lengths and (3, k) shape functions, as `facet_basis` has it.

    Args:
        nodes: (n, 2) reference positions, µm.
        sides: (m, k) nodes of each side.
    """
    k = sides.shape[1]
    points, weights = get_quadrature(RefLine, 4)
    found = [SIDES[k].lbasis(points, a) for a in range(k)]
    shape, slopes = (np.stack([np.ravel(each[part]) for each in found], axis=1) for part in (0, 1))
    along = np.einsum("qa,mai->mqi", np.broadcast_to(slopes, shape.shape), nodes[sides])
    return np.linalg.norm(along, axis=2) * weights, shape


def make_loads(
    problem: Problem,
    mass_of: Callable[[Array], Matrix],
    n: int,
    proportional: bool,
) -> list[Force]:
    """The forces of the conditions and on free bodies, on n rows.

    Args:
        mass_of: the mass (2 n_nodes, 2 n_nodes) of a share (n_el,) of each element.
        proportional: as of `make_system`.
    """
    mesh, loads = problem.mesh, list[Force]()
    n_nodes = mesh.p.shape[1]

    def rows(load: Array) -> Array:
        """(n, 2), zero for bodies."""
        return np.pad(load, ((0, n - n_nodes), (0, 0)))

    def square(matrix: Matrix) -> Matrix:
        """(2 n, 2 n), zero for bodies."""
        grown = scipy.sparse.csc_matrix(matrix)
        grown.resize(2 * n, 2 * n)
        return grown

    for condition in problem.conditions:
        name, where = label(condition), f"{condition.kind()}.on"
        amplitude = condition.amplitude if isinstance(condition, DrivenCondition) else ONE
        amplitude = Proportional() if proportional else amplitude
        match condition:
            case BodyForce():
                inside = np.zeros(mesh.nelements)
                inside[region(mesh, condition.on, where)] = 1.0
                pulled = np.tile(condition.acceleration, n_nodes)
                load = (mass_of(inside) @ pulled).reshape(-1, 2)
                loads.append(LinearForce(name, rows(load), amplitude))
            case Traction():
                load = traction_load(mesh, boundary(mesh, condition.on, where), condition.traction)
                loads.append(LinearForce(name, rows(load), amplitude))
            case Pressure():
                facets = boundary(mesh, condition.on, where)
                unloaded, slope = pressure_load(mesh, facets, condition.pressure)
                slopes = -square(slope), 0.0 * square(slope)
                loads.append(LinearForce(name, rows(unloaded), amplitude, slopes))
            case Foundation():
                facets = boundary(mesh, condition.on, where)
                base = square(foundation_matrix(mesh, facets, condition.components))
                slopes = condition.stiffness * base, condition.damping * base
                loads.append(LinearForce(name, np.zeros((n, 2)), ONE, slopes))
    for k, body in enumerate(problem.bodies):
        if body.mass is not None and any(body.acceleration):
            load = np.zeros((n, 2))
            load[n_nodes + k] = body.mass * np.array(body.acceleration)
            amplitude = Proportional() if proportional else ONE
            loads.append(LinearForce(f"{body.name} load", load, amplitude))
    return loads


MODULI, ONSET, DAMPING = 200.0, 0.04, 0.5
"""Defaults: k by modulus over the length h of a side, k δ by modulus, c by the critical damping of
the mass by which k moves the boundary of a mesh, ρ h/√12 a length."""

_TOUCHING = 0.01
"""Of a side: the depth or gap at which a body begins in touch."""


@dataclass(frozen=True, slots=True)
class Grip:
    """An equilibrium: displacement u (n, 2), µm, and friction (m,) at all points, µN/µm."""

    u: Array
    drag: Array


@dataclass(frozen=True, slots=True)
class Contact:
    """The contact force of one rigid body.

    Attributes:
        name: of the body. row: that of its displacement among those of the nodes.
        shape: its outline. position: (2,) at t = 0, µm.
        sides: (m, k) nodes of the sides that may touch it.
        points: (m, 3, 2) reference positions. lengths: (m, 3). shapes: (3, k).
        stiffness: k, µN/µm². smoothing: δ, µm. damping: c, µN µs/µm².
        friction: µ. slip_speed: s, µm/µs.
        grip: the last equilibrium, in quasi-static runs.
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
    damping: float
    friction: float
    slip_speed: float
    grip: Grip | None = None

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        force = np.zeros(u.shape)
        gap, normal, _ = self._gaps(u)
        if not (gap < 0.0).any():
            return force
        pressure, *_ = self._pressure(-gap, -_dot(self._relative(v), normal))
        traction = pressure[:, None] * normal
        if self.friction:
            drag, *_ = self._drag(pressure, _dot(self._slid(u, v), _turned(normal)))
            traction -= drag[:, None] * _turned(normal)
        at_points = traction.reshape(*self.lengths.shape, 2) * self.lengths[:, :, None]
        np.add.at(force, self.sides, np.einsum("mqi,qa->mai", at_points, self.shapes))
        force[self.row] -= at_points.sum(axis=(0, 1))
        return force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        gap, normal, curvature = self._gaps(u)
        touching = np.flatnonzero(gap < 0.0)
        if not touching.size:
            return None
        tangent, relative = _turned(normal), self._relative(v)
        sliding = _dot(relative, tangent)
        pressure, by_depth, by_closing = self._pressure(-gap, -_dot(relative, normal))
        # ∂g/∂x = n; the frame turns with the point: ∂n/∂x = κ τ τᵀ, ∂τ/∂x = −κ n τᵀ.
        p_by_x = -by_depth[:, None] * normal - (by_closing * curvature * sliding)[:, None] * tangent
        p_by_v = -by_closing[:, None] * normal
        both = _outer(tangent, tangent)
        by_x = _outer(normal, p_by_x) + (pressure * curvature)[:, None, None] * both
        by_v = _outer(normal, p_by_v)
        if self.friction:
            slid = self._slid(u, v)
            drag, by_pressure, by_sliding = self._drag(pressure, _dot(slid, tangent))
            along = by_pressure[:, None] * tangent
            by_x -= _outer(along, p_by_x)
            by_x += (by_sliding * curvature * _dot(slid, normal))[:, None, None] * both
            by_x += (drag * curvature)[:, None, None] * _outer(normal, tangent)
            by_v -= _outer(along, p_by_v)
            moved = by_v if self.grip is None else by_x
            moved -= by_sliding[:, None, None] * both
        n = u.size
        return self._assembled(-by_x, touching, n), self._assembled(-by_v, touching, n)

    def drag(self, u: Array) -> Array:
        """(m,) friction at all points at rest, µN/µm."""
        gap, normal, _ = self._gaps(u)
        pressure, *_ = self._pressure(-gap, 0.0 * gap)
        found, *_ = self._drag(pressure, _dot(self._slid(u, 0.0 * u), _turned(normal)))
        return found

    def penetration(self, u: Array) -> float:
        """Deepest penetration of any point, µm."""
        return float(max(0.0, -self._gaps(u)[0].min()))

    def check_start(self) -> None:
        """Refuse a body that begins with a part of the tissue deep inside it.

        Raises:
            InputError: naming the place.
        """
        points = self.points.reshape(-1, 2)
        check_outside(self.name, self.shape, self.position, points, self._touching)

    def blocked(self, motions: Array) -> Array:
        """(p, k) of motions (2 n, k): what the points that touch at the start, or almost, move
        against the body along its normal, and along its surface where friction resists.
        """
        u = np.zeros((len(motions) // 2, 2))
        gap, normal, _ = self._gaps(u)
        near, found = gap <= self._touching, list[Array]()
        for direction in (normal, _turned(normal))[: 2 if self.friction else 1]:
            columns = (self._relative(w.reshape(-1, 2)) for w in motions.T)
            found.append(np.stack([_dot(w, direction)[near] for w in columns], axis=1))
        return np.concatenate(found)

    @property
    def _touching(self) -> float:
        """Depth or gap at which a body may begin and counts as touching, µm."""
        return _TOUCHING * float(self.lengths.sum()) / len(self.sides)

    def energy(self, u: Array) -> float:
        """Energy stored in the springs, pJ."""
        depth = np.maximum(-self._gaps(u)[0], 0.0)
        density = contact_law.stored(depth, self.stiffness, self.smoothing)
        return float(density @ self.lengths.ravel())

    def _gaps(self, u: Array) -> tuple[Array, Array, Array]:
        moved = self.points + np.einsum("qa,mai->mqi", self.shapes, u[self.sides])
        return self.shape.gap((moved - self.position - u[self.row]).reshape(-1, 2))

    def _relative(self, v: Array) -> Array:
        """(n, 2) velocity of the points relative to the body."""
        moving = np.einsum("qa,mai->mqi", self.shapes, v[self.sides]) - v[self.row]
        return moving.reshape(-1, 2)

    def _pressure(self, depth: Array, closing: Array) -> tuple[Array, Array, Array]:
        """Pressure and its slopes by the depth and by the speed of closing."""
        law = self.stiffness, self.smoothing, self.damping
        return contact_law.pressure(np.maximum(depth, 0.0), closing, law)

    def _slid(self, u: Array, v: Array) -> Array:
        """(n, 2) velocity relative to the body, or displacement since the grip."""
        return self._relative(v if self.grip is None else u - self.grip.u)

    def _drag(self, pressure: Array, sliding: Array) -> tuple[Array, Array, Array]:
        """Friction per length against sliding, and its slopes by pressure and by sliding."""
        if self.grip is not None:
            limit = self.friction * pressure
            tried = self.grip.drag + self.stiffness * sliding
            sticks = abs(tried) <= limit
            slips = np.where(sticks, 0.0, self.friction * np.sign(tried))
            return np.clip(tried, -limit, limit), slips, np.where(sticks, self.stiffness, 0.0)
        return contact_law.friction(pressure, sliding, (self.friction, self.slip_speed))

    def _assembled(self, blocks: Array, touching: Index, size: int) -> Matrix:
        """Σ L B ⊗ (N, −1) (N, −1)ᵀ over the points that touch, (size, size)."""
        side, q = np.divmod(touching, 3)
        weights = np.column_stack([self.shapes[q], -np.ones(len(q))])
        rows = np.column_stack([self.sides[side], np.full(len(q), self.row)])
        scaled = self.lengths.ravel()[touching, None, None] * blocks[touching]
        return assembled(np.einsum("pa,pb,pij->paibj", weights, weights, scaled), rows, size)


def _dot(a: Array, b: Array) -> Array:
    """(n,) of (n, 2) vectors."""
    return np.einsum("ni,ni->n", a, b)


def _outer(a: Array, b: Array) -> Array:
    """(n, 2, 2) of (n, 2) vectors."""
    return a[:, :, None] * b[:, None, :]


def _turned(normal: Array) -> Array:
    """(n, 2) tangents."""
    return np.stack([-normal[:, 1], normal[:, 0]], axis=1)


def make_contact(
    body: RigidBody, row: int, nodes: Array, sides: Index, modulus: float, density: float
) -> Contact:
    """The contact of `body` with sides (m, k) of a tissue of this modulus (µN/µm) and density."""
    lengths, shape = side_points(nodes, sides)
    size = float(lengths.sum() / len(sides))
    stiffness = MODULI * modulus / size if body.stiffness is None else body.stiffness
    critical = 2.0 * np.sqrt(stiffness * density * size / np.sqrt(12.0))
    slip_speed = 1e-3 * np.sqrt(modulus / density)
    return Contact(
        name=body.name,
        row=row,
        shape=body.shape,
        position=np.array(body.position),
        sides=sides,
        points=np.einsum("qa,mai->mqi", shape, nodes[sides]),
        lengths=lengths,
        shapes=shape,
        stiffness=stiffness,
        smoothing=ONSET * modulus / stiffness if body.smoothing is None else body.smoothing,
        damping=float(DAMPING * critical if body.damping is None else body.damping),
        friction=body.friction,
        slip_speed=float(slip_speed if body.slip_speed is None else body.slip_speed),
    )

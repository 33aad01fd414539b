"""Forces on the nodes besides the tissue's own: loads, follower pressure, foundations, contact.

Forces along sides are forms of scikit-fem over facets, whose unknowns are numbered as ours: 2 a + i
is component i of node a. The positions of rigid bodies are numbered on after the nodes of the mesh.
A force knows its slopes, which Newton's method needs.

Contact of a boundary with a rigid body acts at three points of each side by `contact_law`, and at
more where a rounding of the body would fit between two of them. Friction follows from the sliding
Δ since the last equilibrium or the end of the last step, and from the spring's friction τ there: it
is τ + k Δ, at most µ p, so that a point sticks to the body by the spring k or slips by Coulomb's
law; in time a dashpot acts beside the spring. With a slip speed, friction in time is a function of
the sliding velocity instead, by which points creep. The body takes the opposite forces, so momentum
is kept to rounding."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
import scipy.sparse
import skfem

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.macro.elements import (
    Matrix,
    for_components,
    sparse_rows,
    summed,
    with_transpose,
)
from surrofe2.problem import contact_law
from surrofe2.problem.amplitude import ONE, Amplitude, Proportional
from surrofe2.problem.conditions import (
    BodyForce,
    DrivenCondition,
    Foundation,
    PointForce,
    Pressure,
    Traction,
)
from surrofe2.problem.mesh import boundary, element_nodes, nodes_on, region
from surrofe2.problem.problem import Problem, label
from surrofe2.problem.rigid_bodies import RigidBody, Shape, check_outside

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
        factor = self.amplitude.at(t, within)[0]
        K, C = self.slopes_at_one
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
    x = float("x" in components)
    y = float("y" in components)
    form = skfem.BilinearForm(lambda u, v, w: x * u[0] * v[0] + y * u[1] * v[1])
    return form.assemble(facet_basis(mesh, facets))


def make_loads(problem: Problem, mass_of: Callable[[Array], Matrix], n: int) -> list[Force]:
    """The forces of the conditions and on free bodies, on n rows.

    Args:
        mass_of: the mass (2 n_nodes, 2 n_nodes) of a share (n_el,) of each element.
    """
    mesh = problem.mesh
    loads = list[Force]()
    n_nodes = mesh.p.shape[1]

    def add(name: str, dead: Array, amplitude: Amplitude, *slopes: Matrix) -> None:
        dead = np.pad(dead, ((0, n - len(dead)), (0, 0)))
        K_and_C = [scipy.sparse.csc_matrix(slope) for slope in slopes]
        for slope in K_and_C:
            slope.resize(2 * n, 2 * n)
        loads.append(LinearForce(name, dead, amplitude, (*K_and_C,) if K_and_C else None))

    for condition in problem.conditions:
        name = label(condition)
        where = f"{condition.kind()}.on"
        amplitude = condition.amplitude if isinstance(condition, DrivenCondition) else ONE
        match condition:
            case BodyForce():
                inside = np.zeros(mesh.nelements)
                inside[region(mesh, condition.on, where)] = 1.0
                pulled = np.tile(condition.acceleration, n_nodes)
                add(name, (mass_of(inside) @ pulled).reshape(-1, 2), amplitude)
            case Traction():
                facets = boundary(mesh, condition.on, where)
                add(name, traction_load(mesh, facets, condition.traction), amplitude)
            case PointForce():
                load = np.zeros((n, 2))
                load[nodes_on(mesh, condition.on, where)] = condition.force
                add(name, load, amplitude)
            case Pressure():
                facets = boundary(mesh, condition.on, where)
                unloaded, slope = pressure_load(mesh, facets, condition.pressure)
                add(name, unloaded, amplitude, -slope, 0.0 * slope)
            case Foundation():
                facets = boundary(mesh, condition.on, where)
                base = foundation_matrix(mesh, facets, condition.components)
                slopes = condition.stiffness * base, condition.damping * base
                add(name, np.zeros((n, 2)), ONE, *slopes)
    for k, body in enumerate(problem.bodies):
        if body.mass is not None and any(body.acceleration):
            load = np.zeros((n, 2))
            load[n_nodes + k] = body.mass * np.array(body.acceleration)
            grows = isinstance(body.amplitude, Proportional)
            add(f"{body.name} load", load, body.amplitude if grows else ONE)
    return loads


MODULI = 200.0
ONSET = 0.04
DAMPING = 0.5
"""Defaults: k by modulus over the length h of a side, k δ by modulus, c by the critical damping of
the mass by which k moves the boundary of a mesh, ρ h/√12 a length."""

FEWEST_POINTS = 3
MOST_POINTS = 40
"""Contact points of a side."""
_TOUCHING = 0.01
"""Of a side: the depth or gap at which a body begins in touch."""


@dataclass(frozen=True, slots=True)
class Grip:
    """An equilibrium or the end of a time step, from which points stick or slip.

    Attributes:
        u: (n, 2) displacement, µm.
        drag: (p,) friction of the springs, µN/µm.
        slips: (p,) 0 of a point that sticks, else the sign of its sliding, while a correction of
            Newton's method holds them; None: Coulomb's law says so at every displacement.
    """

    u: Array
    drag: Array
    slips: Array | None = None


@dataclass(frozen=True, slots=True)
class Contact:
    """The contact force of one rigid body with p points of a boundary.

    Attributes:
        name: of the body. shape: its outline. position: (2,) at t = 0, µm.
        relative: (p, n) from the displacement of nodes and bodies to that of the points relative
            to the body; by_component: that of `for_components`, and its transpose.
        points: (p, 2) reference positions. lengths: (p,) µm. side: mean length of a side, µm.
        stiffness: k, µN/µm². smoothing: δ, µm. damping: c, µN µs/µm².
        friction: µ. slip_speed: s, µm/µs; None: points stick.
        grip: the last equilibrium or the end of the last step; None: friction in time with a slip
            speed.
    """

    name: str
    shape: Shape
    position: Array
    relative: Matrix
    by_component: tuple[Matrix, Matrix]
    points: Array
    lengths: Array
    side: float
    stiffness: float
    smoothing: float
    damping: float
    friction: float
    slip_speed: float | None
    grip: Grip | None

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        gap, normal, _ = self._gaps(u)
        if not self._acting(gap).any():
            return np.zeros(u.shape)
        relative = self.relative @ v
        pressure, *_ = self._pressure(-gap, -_dot(relative, normal))
        traction = pressure[:, None] * normal
        if self.friction:
            tangent = _turned(normal)
            moved = _dot(self._moved(u), tangent)
            drag, *_ = self._drag(pressure, moved, _dot(relative, tangent))
            traction -= drag[:, None] * tangent
        force: Array = self.relative.T @ (self.lengths[:, None] * traction)
        return force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        gap, normal, curvature = self._gaps(u)
        acting = self._acting(gap)
        if not acting.any():
            return None
        tangent = _turned(normal)
        relative = self.relative @ v
        sliding = _dot(relative, tangent)
        pressure, by_depth, by_closing = self._pressure(-gap, -_dot(relative, normal))
        # ∂g/∂x = n; the frame turns with the point: ∂n/∂x = κ τ τᵀ, ∂τ/∂x = −κ n τᵀ.
        p_by_x = -by_depth[:, None] * normal - (by_closing * curvature * sliding)[:, None] * tangent
        p_by_v = -by_closing[:, None] * normal
        both = _outer(tangent, tangent)
        by_x = _outer(normal, p_by_x) + (pressure * curvature)[:, None, None] * both
        by_v = _outer(normal, p_by_v)
        if self.friction:
            moved = self._moved(u)
            drags = self._drag(pressure, _dot(moved, tangent), sliding)
            drag, by_pressure, by_moved, by_sliding = drags
            along = by_pressure[:, None] * tangent
            turned = by_moved * _dot(moved, normal) + by_sliding * _dot(relative, normal)
            by_x -= _outer(along, p_by_x)
            by_x += (turned * curvature - by_moved)[:, None, None] * both
            by_x += (drag * curvature)[:, None, None] * _outer(normal, tangent)
            by_v -= _outer(along, p_by_v)
            by_v -= by_sliding[:, None, None] * both
        lengths = np.where(acting, self.lengths, 0.0)[:, None, None]
        S = self.by_component
        return summed(S, -lengths * by_x), summed(S, -lengths * by_v)

    @property
    def sticks(self) -> bool:
        """Tell whether points stick until they slip, so that friction depends on the way."""
        return self.friction > 0.0 and self.grip is not None

    def gripped(self, u: Array, v: Array) -> Contact:
        """Return the same after a step that ends at u and v (n, 2); its force there stays."""
        if not self.sticks:
            return self
        return replace(self, grip=Grip(u, self.drag(u, v)))

    def drag(self, u: Array, v: Array) -> Array:
        """(p,) friction of the springs at all points, µN/µm; zeros without a grip."""
        gap, normal, _ = self._gaps(u)
        if self.grip is None:
            return np.zeros(len(gap))
        pressure, *_ = self._pressure(-gap, -_dot(self.relative @ v, normal))
        limit = self.friction * pressure
        return np.clip(self._tried(_dot(self._moved(u), _turned(normal))), -limit, limit)

    def held(self, u: Array, part: float = 0.0) -> Contact:
        """The same with points that stick or slip as they do at u, until they are held again.

        Args:
            part: 0 to 1; points that are held already change only where their friction is off by
                this part of what it is off by at most, since all together may swing for ever.
        """
        assert self.grip is not None
        gap, normal, _ = self._gaps(u)
        pressure, *_ = self._pressure(-gap, 0.0 * gap)
        limit = self.friction * pressure
        tried = self._tried(_dot(self._moved(u), _turned(normal)))
        slips = np.where(tried < 0.0, -1.0, 1.0)
        slips[(abs(tried) <= limit) & (limit > 0.0)] = 0.0
        before = self.grip.slips
        if before is not None:
            # A point that slid the other way sticks first, or Newton's method throws it to and fro.
            slips[(before * slips < 0.0) & (limit > 0.0)] = 0.0
            acts = np.where(before == 0.0, tried, before * limit)
            off = np.where(slips == before, 0.0, abs(np.clip(tried, -limit, limit) - acts))
            stays = off < part * off.max(initial=0.0)
            slips[stays] = before[stays]
        return replace(self, grip=replace(self.grip, slips=slips))

    def penetration(self, u: Array) -> float:
        """Deepest penetration of any point, µm."""
        return float(max(0.0, -self._gaps(u)[0].min()))

    def check_start(self) -> None:
        """An `InputError` if the body begins with a part of the tissue deep inside it."""
        check_outside(self.name, self.shape, self.position, self.points, _TOUCHING * self.side)

    def blocked(self, motions: Array) -> Array:
        """(q, k) of motions (2 n, k): what the points that touch at the start, or almost, move
        against the body along its normal, and along its surface where friction resists.
        """
        gap, normal, _ = self._gaps(np.zeros((len(motions) // 2, 2)))
        near = gap <= _TOUCHING * self.side
        moved = (self.by_component[0] @ motions).reshape(len(gap), 2, -1)
        directions = (normal, _turned(normal))[: 2 if self.friction else 1]
        return np.concatenate([np.einsum("pi,pik->pk", each, moved)[near] for each in directions])

    def energy(self, u: Array) -> float:
        """Energy stored in the springs, pJ."""
        depth = np.maximum(-self._gaps(u)[0], 0.0)
        density = contact_law.stored(depth, self.stiffness, self.smoothing)
        return float(density @ self.lengths)

    def _gaps(self, u: Array) -> tuple[Array, Array, Array]:
        return self.shape.gap(self.points + self.relative @ u - self.position)

    def _acting(self, gap: Array) -> Flags:
        """(p,) points that touch, or are held to the body."""
        acting = gap < 0.0
        if self.grip is not None and self.grip.slips is not None:
            acting |= self.grip.slips == 0.0
        return acting

    def _pressure(self, depth: Array, closing: Array) -> tuple[Array, Array, Array]:
        """Pressure and its slopes by the depth and by the speed of closing."""
        law = self.stiffness, self.smoothing, self.damping
        return contact_law.pressure(np.maximum(depth, 0.0), closing, law)

    def _moved(self, u: Array) -> Array:
        """(p, 2) displacement relative to the body since the grip, µm; zeros without one."""
        if self.grip is None:
            return np.zeros(self.points.shape)
        return np.asarray(self.relative @ (u - self.grip.u))

    def _drag(
        self, pressure: Array, moved: Array, sliding: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Friction per length, and its slopes by the pressure, by what the point has moved along
        the body since the grip, and by the sliding velocity."""
        if self.grip is None:
            assert self.slip_speed is not None
            law = self.friction, self.slip_speed
            drag, by_pressure, by_sliding = contact_law.friction(pressure, sliding, law)
            return drag, by_pressure, 0.0 * drag, by_sliding
        limit = self.friction * pressure
        tried = self._tried(moved)
        slips = self.grip.slips
        if slips is not None:
            sticks = slips == 0.0
            drag = np.where(sticks, tried, slips * limit)
            stiffness = np.where(sticks, self.stiffness, 0.0)
            return drag, self.friction * slips, stiffness, 0.0 * drag
        slips = np.where(abs(tried) <= limit, 0.0, np.sign(tried))
        spring = np.where(slips == 0.0, tried, slips * limit)
        total = spring + self.damping * sliding
        beyond = np.where(abs(total) < limit, 0.0, np.sign(total))
        inside = beyond == 0.0
        return (
            np.where(inside, total, beyond * limit),
            self.friction * np.where(inside, slips, beyond),
            np.where(inside & (slips == 0.0), self.stiffness, 0.0),
            np.where(inside, self.damping, 0.0),
        )

    def _tried(self, moved: Array) -> Array:
        """(p,) friction of the springs if all points stuck since the grip, µN/µm."""
        assert self.grip is not None
        return self.grip.drag + self.stiffness * moved


def _dot(a: Array, b: Array) -> Array:
    """(n,) of (n, 2) vectors."""
    return np.einsum("ni,ni->n", a, b)


def _outer(a: Array, b: Array) -> Array:
    """(n, 2, 2) of (n, 2) vectors."""
    return a[:, :, None] * b[:, None, :]


def _turned(normal: Array) -> Array:
    """(n, 2) tangents."""
    return np.stack([-normal[:, 1], normal[:, 0]], axis=1)


def check_bodies(problem: Problem) -> None:
    """Check that no rigid body begins with a part of the tissue deep inside it; an `InputError`
    names the first that does."""
    n_nodes = int(element_nodes(problem.mesh).max()) + 1
    n = n_nodes + len(problem.bodies)
    for k, body in enumerate(problem.bodies, n_nodes):
        make_contact(problem, body, k, n, modulus=1.0, density=1.0).check_start()


def contact_points(mesh: skfem.Mesh, facets: Index, shape: Shape) -> tuple[int, float]:
    """Return how many contact points each of these sides has for a body of this shape, and how far
    two neighbours of the longest side are apart at most, µm."""
    longest = float(facet_basis(mesh, facets).dx.sum(axis=1).max())
    points = points_per_side(shape, longest)
    return points, contact_gap(points, longest)


def points_per_side(shape: Shape, side: float) -> int:
    """Return how many contact points a side of this length has, µm: so many that a rounding of the
    body does not fit between two of them, from `FEWEST_POINTS` up to `MOST_POINTS`."""
    radius = getattr(shape, "radius", np.inf)
    wanted = FEWEST_POINTS
    while wanted < MOST_POINTS and contact_gap(wanted, side) > radius:
        wanted += 1
    return wanted


def contact_gap(points: int, side: float) -> float:
    """The largest distance between neighbouring contact points of a side, µm."""
    places, _ = np.polynomial.legendre.leggauss(points)
    return float(0.5 * side * np.diff(places).max())


def make_contact(
    problem: Problem, body: RigidBody, row: int, n: int, modulus: float, density: float
) -> Contact:
    """The contact of `body`, `row` of n, with a tissue of this modulus (µN/µm) and density."""
    mesh = problem.mesh
    facets = boundary(mesh, body.on, f"{body.name}.on")
    per_side, _ = contact_points(mesh, facets, body.shape)
    basis = skfem.FacetBasis(mesh, mesh.elem(), facets=facets, intorder=2 * per_side - 1)
    side = float(basis.dx.sum() / len(facets))
    nodes = np.repeat(element_nodes(mesh)[mesh.f2t[0, facets]], len(basis.W), axis=0)
    shapes = np.stack([np.ravel(each[0]) for each in basis.basis], axis=1)
    columns = np.insert(nodes, 0, row, axis=1)
    relative = sparse_rows(columns, np.insert(shapes, 0, -1.0, axis=1), n)
    relative.eliminate_zeros()
    stiffness = MODULI * modulus / side if body.stiffness is None else body.stiffness
    critical = 2.0 * np.sqrt(stiffness * density * side / np.sqrt(12.0))
    points = np.asarray(basis.global_coordinates()).reshape(2, -1).T
    sticks = body.slip_speed is None
    return Contact(
        name=body.name,
        shape=body.shape,
        position=np.array(body.position),
        relative=relative,
        by_component=with_transpose(for_components(relative)),
        points=points,
        lengths=basis.dx.ravel(),
        side=side,
        stiffness=stiffness,
        smoothing=ONSET * modulus / stiffness if body.smoothing is None else body.smoothing,
        damping=float(DAMPING * critical if body.damping is None else body.damping),
        friction=body.friction,
        slip_speed=body.slip_speed,
        grip=Grip(np.zeros((n, 2)), np.zeros(len(points))) if sticks else None,
    )

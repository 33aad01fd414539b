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
is kept to rounding.
"""

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

Slopes = tuple[Matrix, Matrix]  # K = −∂f/∂u and C = −∂f/∂v, (2 n, 2 n) each


class Force(Protocol):
    """A force on nodes and rigid bodies, of which there are n in all.

    Attributes:
        name: name of the condition that it comes from.
    """

    @property
    def name(self) -> str: ...

    def at(self, t: float, within: float, u: Array, v: Array) -> Array:
        """Compute the force (n, 2), µN, at displacement u and velocity v (n, 2).

        `within` is a time in the step, by which amplitudes with jumps know their side of it, see
        `Amplitude`.
        """

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        """Compute −∂f/∂u and −∂f/∂v, (2 n, 2 n); None where both are zero."""


@dataclass(frozen=True, slots=True)
class LinearForce:
    """A force f = A(t) (f₀ − K u − C v): dead loads, follower pressure, springs and dashpots.

    Attributes:
        name: name of the condition.
        dead: (n, 2) f₀, µN.
        amplitude: A.
        slopes_at_one: K and C (2 n, 2 n) where A is 1, µN/µm and µN µs/µm; None: both are zero.
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
        factor, _, _ = self.amplitude.at(t, within)
        return factor * force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        if self.slopes_at_one is None:
            return None
        factor, _, _ = self.amplitude.at(t, within)
        K, C = self.slopes_at_one
        return factor * K, factor * C


def facet_basis(mesh: skfem.Mesh, facets: Index) -> skfem.FacetBasis:
    """Make scikit-fem's basis of displacements along outer facets."""
    return skfem.FacetBasis(mesh, skfem.ElementVector(mesh.elem()), facets=facets)


def traction_load(mesh: skfem.Mesh, facets: Index, traction: tuple[float, float]) -> Array:
    """Compute the nodal forces ∫ N_a t dL (n_nodes, 2) of a traction over reference facets, µN."""
    form = skfem.LinearForm(lambda v, w: traction[0] * v[0] + traction[1] * v[1])
    load: Array = form.assemble(facet_basis(mesh, facets)).reshape(-1, 2)
    return load


def pressure_load(mesh: skfem.Mesh, facets: Index, pressure: float) -> tuple[Array, Matrix]:
    """Compute f₀ (n_nodes, 2) and B (2 n_nodes, 2 n_nodes) of a follower pressure, f = f₀ + B u.

    f = −p ∫ v · cof(I + ∇u) n dL: the current normal times length is the cofactor of F times the
    reference normal n times length, and in the plane the cofactor is linear in F.
    """

    def work(u: Any, v: Any, w: Any) -> Any:
        """Return the integrand of B: the power of the pressure on cof(∇u) n."""
        (xx, xy), (yx, yy) = u.grad
        return -pressure * (v[0] * (yy * w.n[0] - yx * w.n[1]) + v[1] * (xx * w.n[1] - xy * w.n[0]))

    basis = facet_basis(mesh, facets)
    dead = skfem.LinearForm(lambda v, w: -pressure * (v[0] * w.n[0] + v[1] * w.n[1]))
    slope = skfem.BilinearForm(work).assemble(basis)
    return dead.assemble(basis).reshape(-1, 2), slope


def foundation_matrix(mesh: skfem.Mesh, facets: Index, components: str) -> Matrix:
    """Compute ∫ N_a N_b dL (2 n_nodes, 2 n_nodes) over reference facets for the components, µm."""
    # a component that is not held has the weight 0
    weight_x = float("x" in components)
    weight_y = float("y" in components)
    form = skfem.BilinearForm(lambda u, v, w: weight_x * u[0] * v[0] + weight_y * u[1] * v[1])
    return form.assemble(facet_basis(mesh, facets))


def make_loads(problem: Problem, mass_of: Callable[[Array], Matrix], n: int) -> list[Force]:
    """Make the forces of the conditions, and those on free bodies.

    Args:
        mass_of: the mass (2 n_nodes, 2 n_nodes) of a fraction (n_el,) of each element.
        n: rows of a force, the nodes and then the bodies.
    """
    mesh = problem.mesh
    loads = list[Force]()
    n_nodes = mesh.p.shape[1]

    def add(name: str, dead: Array, amplitude: Amplitude, *slopes: Matrix) -> None:
        """Add a force to the list, with its arrays extended from the nodes to all rows."""
        dead = np.pad(dead, ((0, n - len(dead)), (0, 0)))
        K_and_C = [scipy.sparse.csc_matrix(slope) for slope in slopes]
        for slope in K_and_C:
            slope.resize(2 * n, 2 * n)
        both = (K_and_C[0], K_and_C[1]) if K_and_C else None
        loads.append(LinearForce(name, dead, amplitude, both))

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
                K = condition.stiffness * base
                C = condition.damping * base
                add(name, np.zeros((n, 2)), ONE, K, C)
    for k, body in enumerate(problem.bodies):
        if body.mass is not None and any(body.acceleration):
            load = np.zeros((n, 2))
            load[n_nodes + k] = body.mass * np.array(body.acceleration)
            # a load factor scales the weight of a body, too; a course in time is of its motion
            is_scaled = isinstance(body.amplitude, Proportional)
            add(f"{body.name} load", load, body.amplitude if is_scaled else ONE)
    return loads


# Defaults of a contact: k by modulus over the length h of a side, k δ by modulus, c by the critical
# damping of the mass by which k moves the boundary of a mesh, ρ h/√12 a length.
MODULI = 200.0
ONSET = 0.04
DAMPING = 0.5
# Fewest and most contact points of a side.
FEWEST_POINTS = 3
MOST_POINTS = 40
# Depth or gap, as a fraction of a side, at which a body begins in touch.
_TOUCHING = 0.01


@dataclass(frozen=True, slots=True)
class Grip:
    """The state from which points stick or slip: an equilibrium, or the end of a time step.

    Attributes:
        u: (n, 2) displacement, µm.
        drag: (p,) friction of the springs, µN/µm.
        slips: (p,) 0 of a point that sticks, else the sign of its sliding, while a correction of
            Newton's method holds them; None: Coulomb's law decides at every displacement.
    """

    u: Array
    drag: Array
    slips: Array | None = None


@dataclass(frozen=True, slots=True)
class Contact:
    """The contact force of one rigid body with p points of a boundary.

    Attributes:
        name: name of the body.
        shape: its outline.
        position: (2,) its position at t = 0, µm.
        relative: (p, n) matrix from the displacement of nodes and bodies to that of the points
            relative to the body.
        by_component: that matrix for both components (`for_components`), and its transpose.
        points: (p, 2) reference positions, µm.
        lengths: (p,) length of side that each point stands for, µm.
        side: mean length of a side, µm.
        stiffness: k, µN/µm².
        smoothing: δ, µm.
        damping: c, µN µs/µm².
        friction: µ.
        slip_speed: s, µm/µs; None: points stick.
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
        """Return the forces on nodes and body at time t; see `Force`."""
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
            traction -= drag[:, None] * tangent  # friction acts against the sliding
        force: Array = self.relative.T @ (self.lengths[:, None] * traction)
        return force

    def slopes(self, t: float, within: float, u: Array, v: Array) -> Slopes | None:
        """Return the derivatives of `at` by u and v; None where no point is near the body."""
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
        """True if points stick until they slip, so that friction depends on the path."""
        return self.friction > 0.0 and self.grip is not None

    def gripped(self, u: Array, v: Array) -> Contact:
        """Return the same contact after a step that ends at u and v (n, 2); its friction there
        stays.
        """
        if not self.sticks:
            return self
        return replace(self, grip=Grip(u, self.drag(u, v)))

    def drag(self, u: Array, v: Array) -> Array:
        """Compute the friction of the springs at all points, (p,), µN/µm; zeros without a grip."""
        gap, normal, _ = self._gaps(u)
        if self.grip is None:
            return np.zeros(len(gap))
        pressure, *_ = self._pressure(-gap, -_dot(self.relative @ v, normal))
        limit = self.friction * pressure
        return np.clip(self._tried(_dot(self._moved(u), _turned(normal))), -limit, limit)

    def held(self, u: Array, part: float = 0.0) -> Contact:
        """Return the contact with points that stick or slip as they do at u, until they are held
        again.

        Args:
            u: (n, 2) displacement, µm.
            part: 0 to 1. Points that are held already change only where their friction is off by at
                least this fraction of the largest such error, since all together may swing for
                ever.
        """
        assert self.grip is not None
        gap, normal, _ = self._gaps(u)
        pressure, *_ = self._pressure(-gap, 0.0 * gap)
        limit = self.friction * pressure
        tried = self._tried(_dot(self._moved(u), _turned(normal)))
        slips = np.where(tried < 0.0, -1.0, 1.0)  # all slip; below, those within the limit stick
        slips[(abs(tried) <= limit) & (limit > 0.0)] = 0.0
        before = self.grip.slips
        if before is not None:
            # A point that slid the other way sticks first, or Newton's method throws it to and fro.
            slips[(before * slips < 0.0) & (limit > 0.0)] = 0.0
            # the friction as it is held so far: of a point that sticks, and of one that slips
            held_drag = np.where(before == 0.0, tried, before * limit)
            error = abs(np.clip(tried, -limit, limit) - held_drag)
            off = np.where(slips == before, 0.0, error)
            stays = off < part * off.max(initial=0.0)
            slips[stays] = before[stays]
        return replace(self, grip=replace(self.grip, slips=slips))

    def penetration(self, u: Array) -> float:
        """Return the deepest penetration of any point, µm."""
        return float(max(0.0, -self._gaps(u)[0].min()))

    def check_start(self) -> None:
        """Raise an `InputError` if the body begins with a part of the tissue deep inside it."""
        check_outside(self.name, self.shape, self.position, self.points, _TOUCHING * self.side)

    def blocked(self, motions: Array) -> Array:
        """Compute what the points that touch at the start, or almost, move against the body.

        Args:
            motions: (2 n, k), k motions of all nodes and bodies.

        Returns:
            (q, k) displacement along the normals, and along the surface where friction resists.
        """
        gap, normal, _ = self._gaps(np.zeros((len(motions) // 2, 2)))
        near = gap <= _TOUCHING * self.side
        moved = (self.by_component[0] @ motions).reshape(len(gap), 2, -1)
        blocked = [np.einsum("pi,pik->pk", normal, moved)[near]]
        if self.friction:
            blocked.append(np.einsum("pi,pik->pk", _turned(normal), moved)[near])
        return np.concatenate(blocked)

    def energy(self, u: Array) -> float:
        """Compute the energy stored in the springs, pJ."""
        depth = np.maximum(-self._gaps(u)[0], 0.0)
        density = contact_law.stored(depth, self.stiffness, self.smoothing)
        return float(density @ self.lengths)

    def _gaps(self, u: Array) -> tuple[Array, Array, Array]:
        """Compute gap (p,) µm, normal (p, 2) and curvature (p,) 1/µm of the body at all points."""
        return self.shape.gap(self.points + self.relative @ u - self.position)

    def _acting(self, gap: Array) -> Flags:
        """Return (p,) flags: points that touch, or are held to the body."""
        acting = gap < 0.0
        if self.grip is not None and self.grip.slips is not None:
            acting |= self.grip.slips == 0.0
        return acting

    def _pressure(self, depth: Array, closing: Array) -> tuple[Array, Array, Array]:
        """Compute the pressure and its slopes by the depth and by the speed of closing, (p,)
        each.
        """
        law = (self.stiffness, self.smoothing, self.damping)
        return contact_law.pressure(np.maximum(depth, 0.0), closing, law)

    def _moved(self, u: Array) -> Array:
        """Return (p, 2), the displacement relative to the body since the grip, µm; zeros without
        one.
        """
        if self.grip is None:
            return np.zeros(self.points.shape)
        return np.asarray(self.relative @ (u - self.grip.u))

    def _drag(
        self, pressure: Array, moved: Array, sliding: Array
    ) -> tuple[Array, Array, Array, Array]:
        """Compute friction per length and its slopes at all points.

        Args:
            pressure: (p,) µN/µm.
            moved: (p,) displacement along the body since the grip, µm.
            sliding: (p,) velocity along the body, µm/µs.

        Returns:
            Friction (p,), and its slopes by the pressure, by `moved` and by `sliding`.
        """
        if self.grip is None:
            assert self.slip_speed is not None
            law = (self.friction, self.slip_speed)
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
        # Coulomb's law limits the spring's friction first, then that of spring and dashpot together
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
        """Compute the friction of the springs if all points stuck since the grip, (p,), µN/µm."""
        assert self.grip is not None
        return self.grip.drag + self.stiffness * moved


def _dot(a: Array, b: Array) -> Array:
    """Compute the dot products (n,) of vectors (n, 2)."""
    return np.einsum("ni,ni->n", a, b)


def _outer(a: Array, b: Array) -> Array:
    """Compute the outer products (n, 2, 2) of vectors (n, 2)."""
    return a[:, :, None] * b[:, None, :]


def _turned(normal: Array) -> Array:
    """Return the tangents (n, 2) to normals, turned counterclockwise."""
    return np.stack([-normal[:, 1], normal[:, 0]], axis=1)


def check_bodies(problem: Problem) -> None:
    """Check that no rigid body begins with a part of the tissue deep inside it.

    Raises:
        InputError: naming the first body that does.
    """
    n_nodes = int(element_nodes(problem.mesh).max()) + 1
    n = n_nodes + len(problem.bodies)
    for k, body in enumerate(problem.bodies, n_nodes):
        # the start depends on shapes and places alone, so any stiffness will do
        make_contact(problem, body, k, n, modulus=1.0, density=1.0).check_start()


def contact_points(mesh: skfem.Mesh, facets: Index, shape: Shape) -> tuple[int, float]:
    """Return the number of contact points of a side, and the largest distance between two of them.

    Args:
        facets: the sides; the longest one decides.
        shape: outline of the body.

    Returns:
        The number, and the distance in µm.
    """
    longest = float(facet_basis(mesh, facets).dx.sum(axis=1).max())
    points = points_per_side(shape, longest)
    return points, contact_gap(points, longest)


def points_per_side(shape: Shape, side: float) -> int:
    """Return the number of contact points of a side of this length, µm.

    It is so large that a rounding of the body does not fit between two of them, from
    `FEWEST_POINTS` up to `MOST_POINTS`.
    """
    radius = getattr(shape, "radius", np.inf)
    wanted = FEWEST_POINTS
    while wanted < MOST_POINTS and contact_gap(wanted, side) > radius:
        wanted += 1
    return wanted


def contact_gap(points: int, side: float) -> float:
    """Return the largest distance between neighbouring contact points of a side, µm."""
    places, _ = np.polynomial.legendre.leggauss(points)
    return float(0.5 * side * np.diff(places).max())


def make_contact(
    problem: Problem,
    body: RigidBody,
    row: int,
    n: int,
    modulus: float,
    density: float,
    onset_modulus: float | None = None,
) -> Contact:
    """Make the contact of a body with a boundary of the tissue.

    Args:
        row: number of the body among the n rows of nodes and bodies.
        modulus, density: those of the tissue, µN/µm and ng/µm², from which defaults follow.
        onset_modulus: modulus that replaces it for the onset of a contact of stated stiffness,
            µN/µm; None: the same.
    """
    mesh = problem.mesh
    facets = boundary(mesh, body.on, f"{body.name}.on")
    per_side, _ = contact_points(mesh, facets, body.shape)
    basis = skfem.FacetBasis(mesh, mesh.elem(), facets=facets, intorder=2 * per_side - 1)
    side = float(basis.dx.sum() / len(facets))
    nodes = np.repeat(element_nodes(mesh)[mesh.f2t[0, facets]], len(basis.W), axis=0)
    shapes = np.stack([np.ravel(values) for (values,) in basis.basis], axis=1)
    # the displacement of a point, N_a u_a, less that of the body
    columns = np.insert(nodes, 0, row, axis=1)
    relative = sparse_rows(columns, np.insert(shapes, 0, -1.0, axis=1), n)
    relative.eliminate_zeros()
    stiffness = MODULI * modulus / side if body.stiffness is None else body.stiffness
    critical = 2.0 * np.sqrt(stiffness * density * side / np.sqrt(12.0))
    smoothing = body.smoothing
    if smoothing is None:
        # A stated stiffness is one for this tissue. Where volume does not change, tissue yields by
        # its shape, and an onset by the modulus of its volume would be far too wide.
        if body.stiffness is None or onset_modulus is None:
            onset_modulus = modulus
        smoothing = ONSET * onset_modulus / stiffness
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
        smoothing=smoothing,
        damping=float(DAMPING * critical if body.damping is None else body.damping),
        friction=body.friction,
        slip_speed=body.slip_speed,
        grip=Grip(np.zeros((n, 2)), np.zeros(len(points))) if sticks else None,
    )

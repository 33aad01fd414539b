"""A problem made discrete: unknowns, mass, prescribed motion and forces.

The rows of displacement and velocity (n, 2) are the nodes of the mesh and then the rigid bodies.
Unknown 2 a + i is component i of row a; those that are held or prescribed are no unknowns of the
motion. y holds the displacement of the free unknowns, then their velocity.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypeVar

import numpy as np
import scipy.sparse

from surrofe2.base.arrays import Array, Index
from surrofe2.base.errors import InputError
from surrofe2.law.stress_law import StressLaw
from surrofe2.macro.elements import Discretisation, Matrix, make_discretisation, n_points_of
from surrofe2.macro.forces import Contact, Force, Grip, make_contact, make_loads, traction_load
from surrofe2.macro.free_sides import SurfaceForce, make_surface
from surrofe2.macro.mass import mass_solver, tissue_mass
from surrofe2.macro.outer_sides import OuterSides
from surrofe2.problem.conditions import Condition, InitialVelocity
from surrofe2.problem.mesh import facet_nodes, facets_of, nodes_on, region
from surrofe2.problem.problem import (
    SURFACE,
    Problem,
    Support,
    check_loads,
    displacement_of,
    supports_of,
    without_overlap,
)

T = TypeVar("T", Contact, SurfaceForce)


NO_IMPULSES = np.empty(0)  # of no bodies, or at rest

# Strain by which the moduli of a law are computed, as a difference.
_PROBE_STRAIN = 1e-4
# A modulus of uniaxial strain over that of pure shear from which on a tissue's volume hardly
# changes: below 8 in drained tissue of turgor down to 0.05 MPa, above 170 with undrained sap.
_UNDRAINED = 20.0


class Works(NamedTuple):
    """The works of all that acts on a tissue, pJ, or their powers, pJ/µs.

    The works of all forces and of the supports, less the internal one, are that of inertia.

    Attributes:
        internal: work of the internal force, which the tissue takes up.
        forces: (k,) work of each of `System.forces`.
        motion: work of the forces that move supports.
        inertia: work of M ü, the gain of kinetic energy.
        impulses: (2 b,) x and y of the impulse of each of b bodies on the tissue, µN µs, or of
            their forces, µN; empty at rest. They are no works, but are summed in the same way.
    """

    internal: float
    forces: Array
    motion: float = 0.0
    inertia: float = 0.0
    impulses: Array = NO_IMPULSES

    @property
    def row(self) -> Array:
        """The works and impulses in one row (k + 3 + 2 b,), for arithmetic and for columns.

        It has the works in the order of `names_of_works`, then impulses as `names_of_impulses`.
        """
        works = [self.internal, *self.forces, self.motion, self.inertia]
        return np.array([*works, *self.impulses])


@dataclass(frozen=True, slots=True)
class System:
    """A discrete problem: what does not change during a step.

    Attributes:
        problem: the problem that it is made of.
        discretisation: its finite elements.
        mass_of: mass (2 n_nodes, 2 n_nodes) of a fraction (n_el,) of each element and its sides,
            ng.
        mass: (2 n, 2 n) ng, of n nodes and bodies.
        free_mass: (m, m) mass between the free unknowns, ng.
        free: (m,) unknowns that move freely, increasing.
        supports: supports, which hold or move the other unknowns.
        forces: all forces besides the tissue's own; that of free sides is the last.
        solve_mass: inverse of the mass of the free unknowns, applied to (m,).
        initial_velocity: (n, 2) µm/µs.
        outer_sides: outer sides of the tissue, which may meet.
        probes: (k, n) weights of the displacements that are recorded: of watched points, and of
            means of boundaries that are acted on, by unloaded length.
        probe_names: (k,) their names.
        rest: (n, 2) displacement of the mesh at rest under surface tension alone, from which all
            others count, µm; None: none.
        moving: supports that move.
        contacts: the contacts among the forces.
        n_rows: n, number of nodes and rigid bodies.
    """

    problem: Problem
    discretisation: Discretisation
    mass_of: Callable[[Array], Matrix]
    mass: Matrix
    free_mass: Matrix
    free: Index
    supports: tuple[Support, ...]
    forces: tuple[Force, ...]
    solve_mass: Callable[[Array], Array]
    initial_velocity: Array
    outer_sides: OuterSides
    probes: Array
    probe_names: tuple[str, ...]
    rest: Array | None = None
    moving: tuple[Support, ...] = field(init=False)
    contacts: tuple[Contact, ...] = field(init=False)
    n_rows: int = field(init=False)

    def __post_init__(self) -> None:
        contacts = tuple(force for force in self.forces if isinstance(force, Contact))
        object.__setattr__(self, "contacts", contacts)
        moving = tuple(support for support in self.supports if support.largest.any())
        object.__setattr__(self, "moving", moving)
        object.__setattr__(self, "n_rows", int(self.mass.shape[0]) // 2)

    @property
    def surface(self) -> SurfaceForce | None:
        """The force of the free sides, which is the last one; None where they have no law."""
        last = self.forces[-1] if self.forces else None
        return last if isinstance(last, SurfaceForce) else None

    def under(self, problem: Problem) -> System:
        """Return the system of a problem that differs only in how much and when it loads or moves.

        Sizes and courses of loads and motions, initial velocities, and times may be others.
        """
        supports = _supports(problem)
        n = self.n_rows
        loads = make_loads(problem, self.mass_of, n)
        others = [force for force in self.forces if isinstance(force, Contact | SurfaceForce)]
        return replace(
            self,
            problem=problem,
            supports=supports,
            forces=(*loads, *others),
            initial_velocity=_initial_velocity(problem, supports, n),
        )

    def with_forces(self, kind: type[T], change: Callable[[T], Force]) -> System:
        """Return the same system with each force of a kind changed."""
        forces = []
        for force in self.forces:
            forces.append(change(force) if isinstance(force, kind) else force)
        return replace(self, forces=tuple(forces))

    def gripped(self, u: Array, drags: Mapping[str, Array]) -> System:
        """Return the system with contacts whose points stick from the displacement u (n, 2) on.

        Args:
            drags: friction of the springs there, µN/µm, by name of the body; contacts of other
                bodies stay as they are, since those with a slip speed do not stick in time.
        """

        def change(contact: Contact) -> Contact:
            """Return a contact with its new grip, where it has one."""
            if contact.name not in drags:
                return contact
            return replace(contact, grip=Grip(u, drags[contact.name]))

        return self.with_forces(Contact, change)

    @property
    def drags(self) -> dict[str, Array]:
        """Friction of the springs at the last grip, µN/µm, by name of a body whose points stick."""
        drags = {}
        for contact in self.contacts:
            if contact.sticks and contact.grip is not None:
                drags[contact.name] = contact.grip.drag
        return drags

    def from_rest(self, rest: Array) -> System:
        """Return the same system with displacements that count from `rest` (n, 2)."""
        return replace(
            self.with_forces(SurfaceForce, lambda force: force.from_rest(rest)), rest=rest
        )

    def from_mesh(self, u: Array) -> Array:
        """Return (n, 2), the displacement of the mesh where u counts from the rest."""
        return u if self.rest is None else u + self.rest

    def spread(self, y: Array, t: float, within: float) -> tuple[Array, Array]:
        """Return displacement and velocity (n, 2) of all rows, from y (2 m,) and the prescribed
        motion.

        `within` is a time in the step, by which amplitudes with jumps know their side of it.
        """
        u = np.zeros(2 * self.n_rows)
        v = np.zeros(2 * self.n_rows)
        m = self.free.size
        u[self.free] = y[:m]
        v[self.free] = y[m:]
        for support in self.moving:
            value, rate, _ = support.amplitude.at(t, within)
            u[support.unknowns] = value * support.largest
            v[support.unknowns] = rate * support.largest
        return u.reshape(-1, 2), v.reshape(-1, 2)

    def pick(self, rows: Array) -> Array:
        """Return the free unknowns (m,) of rows (n, 2)."""
        return rows.ravel()[self.free]

    def inertia(self, a: Array) -> Array:
        """Return mass times rows (n, 2)."""
        return np.asarray(self.mass @ a.ravel()).reshape(-1, 2)

    def prescribed_acceleration(self, t: float, within: float) -> Array | None:
        """Return (n, 2), the acceleration of supports that move, zero elsewhere; None if none
        accelerates.
        """
        if not self.moving:
            return None
        a = np.zeros(2 * self.n_rows)
        accelerates = False
        for support in self.moving:
            _, _, second = support.amplitude.at(t, within)
            a[support.unknowns] = second * support.largest
            accelerates |= second != 0.0
        return a.reshape(-1, 2) if accelerates else None

    def start(self, within: float) -> tuple[Array, Array]:
        """Return y at t = 0, and the row of works of what sets supports into motion.

        Raises:
            InputError: as of `Problem.check_course`.
        """
        self.problem.check_course()
        velocity = self.pick(self.initial_velocity)
        y = np.concatenate([np.zeros(self.free.size), velocity])
        return self._driven(y, self.initial_velocity, 0.0, within)

    def across_corner(self, y: Array, t: float, before: float, after: float) -> tuple[Array, Array]:
        """Return y behind a corner of an amplitude, and the row of works of the jump.

        Where a prescribed velocity jumps, the free velocities follow so that the momentum of every
        free unknown is kept. `before` and `after` are times within the pieces on both sides.
        """
        _, v_before = self.spread(y, t, before)
        return self._driven(y, v_before, t, after)

    def _driven(self, y: Array, v: Array, t: float, after: float) -> tuple[Array, Array]:
        """Return y with the velocities behind a jump of the supports', and the row of works of the
        jump.

        Args:
            v: (n, 2) velocities before the jump, µm/µs.
            after: a time within the piece of the amplitudes behind it, µs.
        """
        none = np.zeros(len(self.forces))
        no_impulses = np.zeros(len(self.names_of_impulses))
        _, v_of_supports = self.spread(y, t, after)
        jump = v_of_supports - v
        jump.ravel()[self.free] = 0.0
        if not jump.any():
            return y, Works(0.0, none, impulses=no_impulses).row
        m = self.free.size
        y = y.copy()
        y[m:] -= self.solve_mass(self.pick(self.inertia(jump)))
        _, v_after = self.spread(y, t, after)
        # The impulse acts on the supports alone, at the mean of both velocities.
        gained = 0.5 * float(np.vdot(v_after + v, self.inertia(v_after - v)))
        return y, Works(0.0, none, gained, gained, no_impulses).row

    @property
    def names_of_works(self) -> tuple[str, ...]:
        """The names of the works in `Works.row`."""
        return "internal", *(force.name for force in self.forces), "motion", "inertia"

    @property
    def names_of_impulses(self) -> tuple[str, ...]:
        """The names of the impulses in `Works.row`."""
        return tuple(f"{contact.name} {axis}" for contact in self.contacts for axis in "xy")

    def pushes(self, forces: Array) -> Array:
        """Return the resultants (2 b,) of b bodies on the tissue, µN, from all forces (k, n, 2)."""
        if not self.contacts:
            return NO_IMPULSES
        tissue = slice(0, len(self.discretisation.nodes))
        pushes = [
            acting[tissue].sum(axis=0)
            for force, acting in zip(self.forces, forces, strict=True)
            if isinstance(force, Contact)
        ]
        return np.concatenate(pushes)

    @property
    def force_names(self) -> tuple[str, ...]:
        """Supports and forces whose resultants on the tissue are recorded."""
        names = [support.name for support in self.holding]
        names += [force.name for force in self.forces]
        return tuple(names)

    @property
    def holding(self) -> tuple[Support, ...]:
        """The supports of the tissue; what holds a rigid body acts on the tissue by its contact."""
        of_nodes = 2 * len(self.discretisation.nodes)
        return tuple(support for support in self.supports if (support.unknowns < of_nodes).any())

    def resultants(self, forces: Array, reaction: Array) -> Array:
        """Compute the resultants (k, 2) of supports and forces, µN, in the order of `force_names`.

        Args:
            forces: (f, n, 2) all forces.
            reaction: (n, 2) force of all supports, µN.
        """
        holding = self.holding
        held = np.zeros((len(holding), 2 * self.n_rows))
        for part, support in zip(held, holding, strict=True):
            part[support.unknowns] = reaction.ravel()[support.unknowns]
        of_forces = forces[:, : len(self.discretisation.nodes)].sum(axis=1)
        return np.concatenate([held.reshape(-1, self.n_rows, 2).sum(axis=1), of_forces])

    @property
    def regions(self) -> dict[str, Index]:
        """Elements of the regions by name, and of the whole tissue under the name ``""``."""
        mesh = self.problem.mesh
        return {"": np.arange(mesh.nelements), **(mesh.subdomains or {})}

    @property
    def dissipating(self) -> tuple[str, ...]:
        """Names of the parts whose dissipation is recorded: regions, and free sides by boundary."""
        sides = () if self.surface is None else self.surface.sides.names
        return *self.regions, *(f"{SURFACE} {name}" for name in sides)

    def identity(self) -> dict[str, Array]:
        """Return digests of the parts that decide the motion, without law and settings, by name."""
        problem = self.problem
        space = self.discretisation
        mesh = self.problem.mesh
        held = [support.unknowns for support in self.supports]
        named = {}
        for name, facets in (mesh.boundaries or {}).items():
            named[name] = facet_nodes(mesh, facets)
        for name in mesh.subdomains or {}:
            named[name] = region(mesh, name)
        parts: dict[str, list[Any]] = {
            "mesh": [space.nodes, space.elements, [*named], *named.values()],
            "density": [self.mass @ np.ones(2 * self.n_rows)],
            "conditions": [problem.conditions, self.free, self.initial_velocity, *held],
            "bodies": [problem.bodies],
            "output times": [problem.output_interval, *(problem.times or ())],
            "watched points": [[*problem.watched.items()]],
        }
        if self.surface is not None:
            free = self.surface.sides
            parts["surface"] = [free.names, free.nodes, free.law]
        return {name: _digest(part) for name, part in parts.items()}


def _digest(contents: list[Any]) -> Array:
    """Return the SHA-256 of contents as (32,) bytes, kept as numbers for HDF5."""
    digest = hashlib.sha256()
    for content in contents:
        if isinstance(content, np.ndarray):
            digest.update(content.tobytes())
        else:
            digest.update(repr(content).encode())
    return np.array([*digest.digest()], dtype=np.float64)


def system_of(problem: Problem, law: StressLaw) -> System:
    """Make the system of a problem with the law's density, and its moduli for contact."""
    n_points = n_points_of(problem.mesh)
    modulus = _modulus(law, n_points) if problem.bodies else 1.0
    onset_modulus = modulus
    if any(body.stiffness is not None and body.smoothing is None for body in problem.bodies):
        by_shape = _shape_modulus(law, n_points)
        if modulus > _UNDRAINED * by_shape:
            onset_modulus = by_shape
    return make_system(problem, law.density, modulus=modulus, onset_modulus=onset_modulus)


def _modulus(law: StressLaw, n_points: int) -> float:
    """Compute the largest modulus of uniaxial strain at rest of any point, µN/µm."""
    moduli = [0.0]
    # a difference of two answers, since a law need not have tangents
    still = np.zeros((n_points, 2, 2))
    for k in (0, 1):
        F = np.tile(np.eye(2), (n_points, 1, 1))
        before = law.respond(F, still).stress[:, k, k]
        F[:, k, k] += _PROBE_STRAIN
        after = law.respond(F, still).stress[:, k, k]
        moduli.append(float(np.nanmax(after - before)) / _PROBE_STRAIN)
    return max(moduli)


def _shape_modulus(law: StressLaw, n_points: int) -> float:
    """Compute the largest modulus by which a point resists extension at constant area, µN/µm.

    It is the difference of the normal stresses over the strain, four shear moduli where a tissue is
    isotropic: the modulus with free sides of tissue whose volume does not change.
    """
    still = np.zeros((n_points, 2, 2))
    F = np.tile(np.eye(2), (n_points, 1, 1))
    before = law.respond(F, still).stress
    F[:, 0, 0] += _PROBE_STRAIN
    F[:, 1, 1] = 1.0 / F[:, 0, 0]
    gained = law.respond(F, still).stress - before
    return float(np.nanmax(gained[:, 0, 0] - gained[:, 1, 1])) / _PROBE_STRAIN


def make_system(
    problem: Problem,
    density: Array | float,
    *,
    modulus: float = 1.0,
    onset_modulus: float | None = None,
) -> System:
    """Make a problem discrete on its mesh.

    Args:
        density: mass per reference area, ng/µm², one or (n_points,).
        modulus: modulus of the tissue, µN/µm, from which defaults of contact follow.
        onset_modulus: modulus for the onset of contacts of stated stiffness, µN/µm; None: the same.

    Raises:
        InputError: a condition names what the mesh has not, or two hold the same component.
    """
    mesh = problem.mesh
    space = make_discretisation(problem.mesh)
    per_element = np.broadcast_to(density, space.n_points)[:: space.points_per_element]
    n_nodes = len(space.nodes)
    n = len(space.nodes) + len(problem.bodies)
    surface = [] if problem.surface is None else [make_surface(problem, space, n)]

    def assembled_mass(share: Array) -> Matrix:
        """Assemble the mass of a fraction (n_el,) of each element and its free sides."""
        tissue = tissue_mass(mesh, share * per_element)
        return sum((side.mass(mesh, share) for side in surface), tissue)

    whole = assembled_mass(np.ones(mesh.nelements))

    def mass_of(share: Array) -> Matrix:
        """Return the mass of a fraction of each element; that of all is there already."""
        return whole if (share == 1.0).all() else assembled_mass(share)

    # a body that is moved has no mass; any one will do, since it is no free unknown
    of_bodies = [1.0 if body.mass is None else body.mass for body in problem.bodies]
    diagonal = scipy.sparse.diags(np.repeat(of_bodies, 2))
    mass = scipy.sparse.csc_matrix(scipy.sparse.block_diag([whole, diagonal]))
    supports = _supports(problem)
    held = [support.unknowns for support in supports]
    free = np.setdiff1d(np.arange(2 * n), np.concatenate(held) if held else [])
    if not free.size:
        raise InputError("conditions: they hold or move every node; leave one free")
    free_mass = scipy.sparse.csc_matrix(mass[free][:, free])
    heaviest = float(per_element.max())
    forces = [
        *make_loads(problem, mass_of, n),
        *(
            make_contact(problem, body, n_nodes + k, n, modulus, heaviest, onset_modulus)
            for k, body in enumerate(problem.bodies)
        ),
        *surface,
    ]
    probes = _probes(problem, space, n)
    return System(
        problem=problem,
        discretisation=space,
        mass_of=mass_of,
        mass=mass,
        free_mass=free_mass,
        free=free,
        supports=supports,
        forces=tuple(forces),
        solve_mass=mass_solver(free_mass, free),
        initial_velocity=_initial_velocity(problem, supports, n),
        outer_sides=OuterSides.of(mesh),
        probes=np.stack([*probes.values()]),
        probe_names=tuple(probes),
    )


def check_conditions(problem: Problem) -> None:
    """Check that supports agree, and that no load acts on nothing but what they hold or move.

    Raises:
        InputError: naming the first condition that does not.
    """
    _supports(problem)


def _supports(problem: Problem) -> tuple[Support, ...]:
    """Return the supports of the conditions and of bodies without mass."""
    mesh = problem.mesh

    def places_of(condition: Condition) -> Index:
        """Return the nodes on which a condition acts."""
        return nodes_on(mesh, condition.on, f"{condition.kind()}.on")

    supports = supports_of(problem, places_of)
    check_loads(problem, supports, places_of)
    for k, body in enumerate(problem.bodies):
        if body.mass is None:
            unknowns = 2 * (mesh.p.shape[1] + k) + np.arange(2)
            values = np.array(body.displacement)
            supports.append(Support(f"{body.name} position", unknowns, values, body.amplitude))
    return without_overlap(supports, mesh.p.T)


def _probes(problem: Problem, space: Discretisation, n: int) -> dict[str, Array]:
    """Return the weights (n,) of displacements that are recorded, by name."""
    probes = dict[str, Array]()
    mesh = problem.mesh
    for name, point in problem.watched.items():
        position = np.array(point, dtype=np.float64)
        nodes, weights = space.locate(position, f"watched.{name}")
        probes[f"displacement {name}"] = np.bincount(nodes, weights, n).astype(np.float64)
    for name in problem.acted_boundaries():
        load = traction_load(mesh, facets_of(mesh, name), (1.0, 1.0))[:, 0]
        probes[f"mean displacement {name}"] = np.pad(load / load.sum(), (0, n - load.size))
    for place in problem.acted_nodes():
        probes[displacement_of(place)] = np.eye(1, n, place.node(mesh, "on")).ravel()
    return probes


def _initial_velocity(problem: Problem, supports: tuple[Support, ...], n: int) -> Array:
    """Return the velocities (n, 2) at t = 0; what is held has none."""
    velocity = np.zeros((n, 2))
    for condition in problem.conditions:
        if isinstance(condition, InitialVelocity):
            nodes = nodes_on(problem.mesh, condition.on, "initial_velocity.on")
            velocity[nodes] = condition.velocity
    for k, body in enumerate(problem.bodies):
        if body.mass is not None:
            velocity[problem.mesh.p.shape[1] + k] = body.velocity
    # what moves jumps from this velocity to that of its motion; what is held has none
    for support in supports:
        velocity.ravel()[support.unknowns[support.largest == 0.0]] = 0.0
    return velocity

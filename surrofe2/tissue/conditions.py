"""A problem translated to particles: which are held, driven and loaded, or may touch which body.

Each wall particle along the outline of the tissue stands for a place on the outline of the mesh
(`outline.on_outline`). A boundary is those particles whose places lie on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.simd import pack
from surrofe2.problem.amplitude import ONE, Amplitude
from surrofe2.problem.conditions import (
    BodyForce,
    Condition,
    Foundation,
    InitialVelocity,
    Pressure,
    Traction,
)
from surrofe2.problem.mesh import boundary
from surrofe2.problem.problem import Problem, Support, check_loads, supports_of, without_overlap
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.tissue.external_forces import (
    NO_BODIES,
    NO_DRIVEN,
    NO_MOTION,
    BodyContacts,
    DrivenParticles,
    OutlineForces,
)
from surrofe2.tissue.layout import Tissue
from surrofe2.tissue.outline import area_within, on_outline, outlines, rings_of

_LOADS = (BodyForce, Traction, Pressure, Foundation)
# Contact, unless a body states its own; without a dashpot, as particles of a boundary have mass.
STIFFNESS = 4.0
"""Stiffness of contact, over the wall stiffness per length of a spring. It is eight times that by
which the wall along a boundary holds its particles."""
SMOOTHING = 0.002
"""Depth over which contact sets in, in lengths of a spring."""
SLIP = 1e-6
"""Slip speed of friction, over the wave speed."""
TOUCHING = 0.01
"""Depth at which a body may begin, over the side of a plant cell."""
_LEVEL = 1e-6
"""Detour by which a place still lies between two points, µm."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """A problem on the particles of a tissue.

    Raises:
        InputError: a boundary has no particles, or two supports take one component differently.
    """

    problem: Problem
    tissue: Tissue

    def boundary(self, name: str) -> Index:
        """Return the numbers of the wall particles of a boundary, increasing.

        Raises:
            InputError: there are none.
        """
        indices = np.unique(self._outer[:, 0])
        mesh = self.problem.mesh
        points = self.outline_places[indices]
        part = self.problem.boundaries.get(name)
        if part is not None:
            indices = indices[part.holds(points)]
        else:
            # a point is on a side of the mesh if the way over it is no detour between the ends
            begin, end = mesh.p.T[mesh.facets[:, boundary(mesh, name)]]
            to_begin = np.linalg.norm(points[:, None] - begin, axis=2)
            to_end = np.linalg.norm(points[:, None] - end, axis=2)
            detour = to_begin + to_end - np.linalg.norm(end - begin, axis=1)
            indices = indices[detour.min(axis=1) < _LEVEL]
        if not indices.size:
            raise InputError(f"boundary {name}: it holds no wall particle of the outline")
        return indices

    def lengths(self, name: str) -> Array:
        """Return the unloaded length of the outline that each particle of a boundary stands for.

        (k,) in the order of `boundary`, µm: half of the bonds on both sides of it.
        """
        pairs = self._pairs_on(name)
        places = self.outline_places
        halves = 0.5 * np.linalg.norm(places[pairs[:, 1]] - places[pairs[:, 0]], axis=1)
        total = np.bincount(pairs.ravel(), np.repeat(halves, 2), self.tissue.particles)
        return np.asarray(total[self.boundary(name)])

    def places(self, condition: Condition) -> Index:
        """Return the numbers of the particles that a condition acts on, increasing."""
        if condition.on in (self.problem.mesh.boundaries or {}):
            return self.boundary(str(condition.on))
        return np.flatnonzero(self._part_of(condition) > 0.0)

    @cached_property
    def supports(self) -> tuple[Support, ...]:
        """The components of particles that are held or moved, beside which every load acts."""
        supports = supports_of(self.problem, self.places)
        check_loads(self.problem, supports, self.places)
        return without_overlap(supports, self.outline_places, "particle")

    @property
    def held(self) -> Flags:
        """True where a support takes a component of a particle, (particles, 2)."""
        held = np.zeros((self.tissue.particles, 2), dtype=np.bool_)
        for support in self.supports:
            held.flat[support.unknowns] = True
        return held

    @property
    def moving(self) -> list[Support]:
        """Supports that move."""
        return [support for support in self.supports if support.largest.any()]

    @property
    def motions(self) -> list[Amplitude]:
        """Amplitudes of supports that move, then of bodies that do."""
        bodies = [body.amplitude for body in self.problem.bodies if body.moves]
        return [support.amplitude for support in self.moving] + bodies

    @property
    def loads(self) -> list[BodyForce | Traction | Pressure | Foundation]:
        """Conditions that exert forces, supports aside."""
        return [each for each in self.problem.conditions if isinstance(each, _LOADS)]

    @property
    def load_amplitudes(self) -> list[Amplitude]:
        """Amplitudes of the loads; that of a foundation is always 1."""
        return [ONE if isinstance(each, Foundation) else each.amplitude for each in self.loads]

    def dead_loads(self) -> Array:
        """Return the dead loads (loads, particles, 2) at amplitude 1, µN; 0 for other loads."""
        mass = self.tissue.to_particles(self.tissue.mass)
        forces = np.zeros((len(self.loads), self.tissue.particles, 2))
        for force, load in zip(forces, self.loads, strict=True):
            if isinstance(load, BodyForce):
                force[:] = np.outer(self._part_of(load) * mass, load.acceleration)
            elif isinstance(load, Traction):
                force[self.boundary(load.on)] = np.outer(self.lengths(load.on), load.traction)
        return forces

    def driven(self) -> DrivenParticles:
        """Return the motion of the supports that move, numbered as in `motions`."""
        if not self.moving:
            return NO_DRIVEN
        # unknown 2 i + axis is a component of particle i
        i, axis = np.divmod(np.concatenate([each.unknowns for each in self.moving]), 2)
        sizes = [len(each.unknowns) for each in self.moving]
        return DrivenParticles(
            at=np.insert(self.tissue.address[i], 1, axis, axis=1),
            motion=np.repeat(np.arange(len(sizes)), sizes),
            largest=np.concatenate([each.largest for each in self.moving]),
            mass=self.tissue.to_particles(self.tissue.mass)[i],
            before=np.zeros(len(i)),
            work=np.zeros(1),
        )

    def bodies(self, offset: Array) -> BodyContacts:
        """Return the bodies at t = 0, before they move.

        Args:
            offset: (particles, 2) vectors from particles to their places on the outline that bodies
                meet, µm.
        """
        bodies = self.problem.bodies
        if not bodies:
            return NO_BODIES
        touching = [self.boundary(body.on) for body in bodies]
        particles = np.concatenate(touching)
        moves = np.array([body.moves for body in bodies])
        # motions of bodies are numbered behind those of supports
        motion = len(self.moving) + np.cumsum(moves) - 1
        return BodyContacts(
            starts=np.cumsum([0, *map(len, touching)]),
            at=self.tissue.address[particles],
            length=np.concatenate([self.lengths(body.on) for body in bodies]),
            offset=offset[particles],
            outline=np.array([body.shape.outline for body in bodies]),
            law=np.array([self.contact_law(body) for body in bodies]),
            rubs=any(body.friction for body in bodies),
            x=np.array([body.position for body in bodies]),
            v=np.array([body.velocity if body.mass else (0.0, 0.0) for body in bodies]),
            force=np.zeros((len(bodies), 2)),
            impulse=np.zeros((len(bodies), 2)),
            stored=np.zeros(len(bodies)),
            depth=np.zeros(len(bodies)),
            per_mass=np.array([1.0 / body.mass if body.mass else 0.0 for body in bodies]),
            pull=np.array([body.acceleration for body in bodies]),
            motion=np.where(moves, motion, NO_MOTION),
            largest=np.array([body.displacement for body in bodies]),
            work=np.zeros(3),
            pressed=np.zeros((len(particles), 3)),
            lost=np.zeros((len(particles), 4)),
        )

    def contact_law(self, body: RigidBody) -> tuple[float, float, float, float, float]:
        """Return stiffness, smoothing, damping, friction and slip speed of a body's contact."""
        cell = self.tissue.cell
        wall_stiffness = max(each.wall_stiffness for each in self.tissue.constants)
        sound_speed_squared = max(each.sound_speed_squared for each in self.tissue.constants)
        stiffness = body.stiffness
        if stiffness is None:
            stiffness = STIFFNESS * wall_stiffness / cell.spring_length
        smoothing = body.smoothing
        if smoothing is None:
            smoothing = SMOOTHING * cell.spring_length
        slip_speed = body.slip_speed
        if slip_speed is None:
            # the speed of waves in tissue: of walls in a row, and of the fluid that they enclose
            walls = wall_stiffness * cell.spring_length / cell.cell_side / cell.density
            slip_speed = float(SLIP * np.sqrt(walls + sound_speed_squared))
        return stiffness, smoothing, body.damping or 0.0, body.friction, slip_speed

    def stiffest(self) -> tuple[float, float]:
        """Return the largest stiffness and damping over mass of a particle of the outline.

        They are those of contact and foundations, in 1/µs² and 1/µs; friction is implicit.
        """
        mass = self.tissue.to_particles(self.tissue.mass)
        total = np.zeros((2, self.tissue.particles))
        for body in self.problem.bodies:
            lengths = self.lengths(body.on)
            stiffness_of_body, _, damping_of_body, *_ = self.contact_law(body)
            law = np.array([[stiffness_of_body], [damping_of_body]])
            total[:, self.boundary(body.on)] += law * lengths
            if body.mass is not None:
                # a light body oscillates on all particles that it touches
                total += law * lengths.sum() / body.mass * mass
        for base in self.loads:
            if isinstance(base, Foundation):
                law = np.array([[base.stiffness], [base.damping]])
                total[:, self.boundary(base.on)] += law * self.lengths(base.on)
        stiffness, damping = (total / mass).max(axis=1)
        return float(stiffness), float(damping)

    def outline(self, relaxed: Array, offset: Array) -> OutlineForces:
        """Return follower pressures and foundations.

        With a uniform fluid, pressure acts on the polygons of the walls, as that of the sap does;
        else on the outline that the problem states, as it moves.

        Args:
            relaxed: (particles, 2) positions at rest without load, µm.
            offset: (particles, 2) vectors from particles to their places on the outline, µm.
        """
        bonds = [np.empty((0, 2), dtype=np.int64)]
        loads_of_bonds: list[int] = []
        pressures: list[float] = []
        feet = [np.empty(0, dtype=np.int64)]  # particles on springs
        loads_of_feet: list[int] = []
        stiffnesses = [np.empty((0, 2))]
        dampings = [np.empty((0, 2))]
        for number, load in enumerate(self.loads):
            if isinstance(load, Pressure):
                pairs = self._pairs_on(load.on)
                bonds.append(pairs)
                loads_of_bonds += [number] * len(pairs)
                pressures += [load.pressure] * len(pairs)
            elif isinstance(load, Foundation):
                particles = self.boundary(load.on)
                lengths = self.lengths(load.on)
                acts = np.array([float(axis in load.components) for axis in "xy"])
                feet.append(particles)
                loads_of_feet += [number] * len(particles)
                stiffnesses.append((lengths * load.stiffness)[:, None] * acts)
                dampings.append((lengths * load.damping)[:, None] * acts)
        ends = np.concatenate(bonds).ravel()
        on_springs = np.concatenate(feet)
        owners = np.append(np.repeat(loads_of_bonds, 2), loads_of_feet).astype(np.int64)
        offset_of_ends = offset[ends]
        if self.tissue.cell.has_uniform_fluid:
            offset_of_ends = np.zeros_like(offset_of_ends)
        return OutlineForces(
            at=self.tissue.address[np.append(ends, on_springs)],
            load=owners,
            pressure=np.array(pressures, dtype=np.float64),
            offset=offset_of_ends,
            home=relaxed[on_springs],
            stiffness=np.concatenate(stiffnesses),
            damping=np.concatenate(dampings),
            force=np.zeros((len(owners), 2)),
            before=np.zeros((len(owners), 2)),
            total=np.zeros((len(self.loads), 2)),
            work=np.zeros(len(self.loads)),
        )

    def velocity(self) -> Array:
        """Return the velocities (particles, 2) at t = 0 of what moves freely, µm/µs."""
        v = np.zeros((self.tissue.particles, 2))
        for condition in self.problem.conditions:
            if isinstance(condition, InitialVelocity):
                v[self.places(condition)] = condition.velocity
        # a support wins over an initial velocity
        v[self.held] = 0.0
        return v

    def _part_of(self, condition: Condition) -> Array:
        """Return which fraction of a particle is of the plant cells that a condition acts on.

        (particles,); it is 1 for all if the condition names no region.

        Raises:
            InputError: a region holds no plant cell.
        """
        tissue = self.tissue
        name = condition.on
        if name is None:
            return np.ones(tissue.particles)
        is_there = tissue.kind >= 0
        inside = np.zeros_like(is_there)
        inside[is_there] = self.problem.cells_inside(str(name), tissue.middles[is_there])
        if not inside.any():
            raise InputError(f"region {name}: it holds the middle of no plant cell")
        inside_share = tissue.to_particles(pack(tissue.shares(inside)))
        present_share = tissue.to_particles(pack(tissue.shares(is_there)))
        return inside_share / present_share

    def _pairs_on(self, name: str) -> Index:
        """Return the bonds (k, 2) along the outline whose two particles are on a boundary."""
        return self._outer[np.isin(self._outer, self.boundary(name)).all(axis=1)]

    @cached_property
    def outline_places(self) -> Array:
        """Places on the outline of the mesh that particles stand for, (particles, 2), µm.

        Those of walls that are not along the outline are where they are laid out.
        """
        places = self.tissue.laid_out
        rings_of_mesh = outlines(self.problem.mesh)
        mesh_has_outside = any(area_within([ring]) >= 0.0 for ring in rings_of_mesh)
        mesh_has_holes = any(area_within([ring]) < 0.0 for ring in rings_of_mesh)
        for ring in rings_of(self._outer):
            is_hole = area_within([places[ring]]) < 0.0
            # an air space that the mesh does not have is on none of its sides
            has_counterpart = mesh_has_holes if is_hole else mesh_has_outside
            if has_counterpart:
                places[ring] = on_outline(places[ring], rings_of_mesh)
        return places

    @cached_property
    def _outer(self) -> Index:
        """Bonds along the outline (k, 2), the tissue on their left."""
        return self.tissue.outline()

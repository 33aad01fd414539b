"""A problem made particles: who is held, driven and loaded, and who may touch which body.

A boundary is the wall particles along the outline whose places on the outline of the mesh it holds.
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
from surrofe2.problem.problem import Problem, Support, supports_of, without_overlap
from surrofe2.problem.rigid_bodies import RigidBody
from surrofe2.tissue.external_forces import (
    NO_BODIES,
    NO_DRIVEN,
    BodyContacts,
    DrivenParticles,
    OutlineForces,
)
from surrofe2.tissue.layout import Tissue
from surrofe2.tissue.outline import area_within, on_outline, outlines, rings_of

_LOADS = (BodyForce, Traction, Pressure, Foundation)
STIFFNESS = 4.0
SMOOTHING = 0.002
SLIP = 1e-6
"""Of contact: by the wall stiffness over a spring's length, eight times what the wall along a
boundary holds its particles by; of a spring's length, over which contact sets in; of the wave
speed, the slip speed. There is no dashpot unless stated: a boundary of particles has its mass."""
TOUCHING = 0.01
"""Of a plant cell: the depth at which a body may begin."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """A problem on the particles of a tissue.

    Raises:
        InputError: a boundary has no particles, or two supports take one component differently.
    """

    problem: Problem
    tissue: Tissue

    def boundary(self, name: str) -> Index:
        """Numbers of the wall particles of a boundary, increasing."""
        indices = np.unique(self._outer[:, 0])
        mesh = self.problem.mesh
        points = self.outline_places[indices]
        part = self.problem.boundaries.get(name)
        if part is not None:
            indices = indices[part.holds(points)]
        else:  # on a side of the mesh: no detour between its ends
            begin, end = mesh.p.T[mesh.facets[:, boundary(mesh, name)]]
            by_way = sum(np.linalg.norm(points[:, None] - each, axis=2) for each in (begin, end))
            detour = by_way - np.linalg.norm(end - begin, axis=1)
            indices = indices[detour.min(axis=1) < 1e-6]
        if not indices.size:
            raise InputError(f"boundary {name}: it holds no wall particle of the outline")
        return indices

    def lengths(self, name: str) -> Array:
        """(k,) unloaded length of the outline that each particle of a boundary stands for, µm."""
        pairs = self._pairs_on(name)
        places = self.outline_places
        halves = 0.5 * np.linalg.norm(places[pairs[:, 1]] - places[pairs[:, 0]], axis=1)
        total = np.bincount(pairs.ravel(), np.repeat(halves, 2), self.tissue.particles)
        return np.asarray(total[self.boundary(name)])

    def places(self, condition: Condition) -> Index:
        """Numbers of the particles of a boundary or a region, increasing."""
        if condition.on in (self.problem.mesh.boundaries or {}):
            return self.boundary(str(condition.on))
        return np.flatnonzero(self._part_of(condition) > 0.0)

    @cached_property
    def supports(self) -> tuple[Support, ...]:
        """Components of particles that are held or moved."""
        supports = supports_of(self.problem, self.places)
        return without_overlap(supports, self.outline_places, "particle")

    @property
    def held(self) -> Flags:
        """(particles, 2) components that supports take."""
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
        """Of the loads; a foundation is always there."""
        return [ONE if isinstance(each, Foundation) else each.amplitude for each in self.loads]

    def dead_loads(self) -> Array:
        """(loads, particles, 2) µN at amplitude 1."""
        mass = self.tissue.to_particles(self.tissue.mass)
        forces = np.zeros((len(self.loads), self.tissue.particles, 2))
        for force, load in zip(forces, self.loads, strict=True):
            if isinstance(load, BodyForce):
                force[:] = np.outer(self._part_of(load) * mass, load.acceleration)
            elif isinstance(load, Traction):
                force[self.boundary(load.on)] = np.outer(self.lengths(load.on), load.traction)
        return forces

    def driven(self) -> DrivenParticles:
        """Motion of the supports that move, numbered as in `motions`."""
        if not self.moving:
            return NO_DRIVEN
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
        """The bodies at t = 0, before they move.

        Args:
            offset: (particles, 2) by which the outline that bodies meet is off the particles, µm.
        """
        bodies = self.problem.bodies
        if not bodies:
            return NO_BODIES
        touching = [self.boundary(body.on) for body in bodies]
        everyone = np.concatenate(touching)
        moves = np.array([body.moves for body in bodies])
        return BodyContacts(
            starts=np.cumsum([0, *map(len, touching)]),
            at=self.tissue.address[everyone],
            length=np.concatenate([self.lengths(body.on) for body in bodies]),
            offset=offset[everyone],
            outline=np.array([body.shape.outline for body in bodies]),
            law=np.array([self.contact_law(body) for body in bodies]),
            rubs=any(body.friction for body in bodies),
            x=np.array([body.position for body in bodies]),
            v=np.array([body.velocity if body.mass else (0.0, 0.0) for body in bodies]),
            force=np.zeros((len(bodies), 2)),
            stored=np.zeros(len(bodies)),
            depth=np.zeros(len(bodies)),
            per_mass=np.array([1.0 / body.mass if body.mass else 0.0 for body in bodies]),
            pull=np.array([body.acceleration for body in bodies]),
            motion=np.where(moves, len(self.moving) + np.cumsum(moves) - 1, -1),
            largest=np.array([body.displacement for body in bodies]),
            work=np.zeros(3),
            pressed=np.zeros((len(everyone), 3)),
            lost=np.zeros((len(everyone), 4)),
        )

    def contact_law(self, body: RigidBody) -> tuple[float, float, float, float, float]:
        """Stiffness, smoothing, damping, friction and slip speed of a body's contact."""
        cell = self.tissue.cell
        walls = max(each.wall_stiffness for each in self.tissue.constants)
        # Waves in tissue: walls in a row, and what they enclose.
        sound = max(each.sound_speed_squared for each in self.tissue.constants)
        wave = np.sqrt(walls * cell.spring_length / cell.cell_side / cell.density + sound)
        usual = STIFFNESS * walls / cell.spring_length
        return (
            usual if body.stiffness is None else body.stiffness,
            SMOOTHING * cell.spring_length if body.smoothing is None else body.smoothing,
            body.damping or 0.0,
            body.friction,
            float(SLIP * wave) if body.slip_speed is None else body.slip_speed,
        )

    def stiffest(self) -> tuple[float, float]:
        """Largest stiffness and damping by mass that act on a particle of the outline.

        In 1/µs² and 1/µs, of contact and foundations; friction is implicit.
        """
        mass = self.tissue.to_particles(self.tissue.mass)
        total = np.zeros((2, self.tissue.particles))
        for body in self.problem.bodies:
            lengths = self.lengths(body.on)
            k, _, c, *_ = self.contact_law(body)
            law = np.array([[k], [c]])
            total[:, self.boundary(body.on)] += law * lengths
            if body.mass is not None:
                total += law * lengths.sum() / body.mass * mass
        for base in self.loads:
            if isinstance(base, Foundation):
                law = np.array([[base.stiffness], [base.damping]])
                total[:, self.boundary(base.on)] += law * self.lengths(base.on)
        stiffness, damping = (total / mass).max(axis=1)
        return float(stiffness), float(damping)

    def outline(self, relaxed: Array, offset: Array) -> OutlineForces:
        """Follower pressures and foundations; `relaxed` (particles, 2) positions, µm.

        With a uniform fluid pressure acts on the polygons of the walls, as that of the sap does;
        else on the outline that the problem states, as it moves.
        """
        pressed = [
            (n, load.pressure, *bond)
            for n, load in enumerate(self.loads) if isinstance(load, Pressure)
            for bond in self._pairs_on(load.on)
        ]  # fmt: skip
        based = [
            (n, i, *(length * size * float(axis in load.components)
                     for size in (load.stiffness, load.damping) for axis in "xy"))
            for n, load in enumerate(self.loads) if isinstance(load, Foundation)
            for i, length in zip(self.boundary(load.on), self.lengths(load.on), strict=True)
        ]  # fmt: skip
        bonds = np.array(pressed).reshape(-1, 4)
        feet = np.array(based).reshape(-1, 6)
        bonded = bonds[:, 2:].ravel().astype(np.int64)
        base = feet[:, 1].astype(np.int64)
        owners = np.append(np.repeat(bonds[:, 0], 2), feet[:, 0])
        everyone = np.append(bonded, base)
        nothing = np.zeros((len(owners), 2))
        pressed_off = offset[bonded]
        if self.tissue.cell.has_uniform_fluid:
            pressed_off = np.zeros_like(pressed_off)
        return OutlineForces(
            at=self.tissue.address[everyone],
            load=owners.astype(np.int64),
            pressure=bonds[:, 1].copy(),
            offset=pressed_off,
            home=relaxed[base],
            stiffness=feet[:, 2:4].copy(),
            damping=feet[:, 4:].copy(),
            force=nothing,
            before=nothing.copy(),
            total=np.zeros((len(self.loads), 2)),
            work=np.zeros(len(self.loads)),
        )

    def velocity(self) -> Array:
        """(particles, 2) at t = 0, µm/µs, of what moves freely."""
        v = np.zeros((self.tissue.particles, 2))
        for condition in self.problem.conditions:
            if isinstance(condition, InitialVelocity):
                v[self.places(condition)] = condition.velocity
        v[self.held] = 0.0
        return v

    def _part_of(self, condition: Condition) -> Array:
        """(particles,) part of each that belongs to plant cells of a region; without one, all."""
        tissue = self.tissue
        name = condition.on
        if name is None:
            return np.ones(tissue.particles)
        is_there = tissue.kind >= 0
        inside = np.zeros_like(is_there)
        inside[is_there] = self.problem.cells_inside(str(name), tissue.middles[is_there])
        if not inside.any():
            raise InputError(f"region {name}: it holds the middle of no plant cell")
        mine, whole = (tissue.shares(each) for each in (inside, is_there))
        return tissue.to_particles(pack(mine)) / tissue.to_particles(pack(whole))

    def _pairs_on(self, name: str) -> Index:
        """(k, 2) bonds along the outline whose two particles are on a boundary."""
        return self._outer[np.isin(self._outer, self.boundary(name)).all(axis=1)]

    @cached_property
    def outline_places(self) -> Array:
        """(particles, 2) places on the outline that particles along it stand for; of other walls,
        where they are laid out, µm."""
        places = self.tissue.laid_out
        stated = outlines(self.problem.mesh)
        around_holes = {area_within([ring]) < 0.0 for ring in stated}
        for ring in rings_of(self._outer):
            # an air space that the mesh does not have is on none of its sides
            if (area_within([places[ring]]) < 0.0) in around_holes:
                places[ring] = on_outline(places[ring], stated)
        return places

    @cached_property
    def _outer(self) -> Index:
        """(k, 2) bonds along the outline, the tissue on their left."""
        return self.tissue.outline()

"""A problem made particles: who is held, driven and loaded, and who may touch which body.

A boundary is the wall particles along the outline whose places on the grid of walls it holds.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.simd import TILE
from surrofe2.tissue.acting import NO_DRIVE, NO_PLATES, Drive, Plates
from surrofe2.tissue.layout import Tissue, shares
from surrofe2.tissue.pair_lists import bonded_particles
from surrofe2.tissue.problem import Body, Load, Part, TissueProblem, middles_of

Array = NDArray[np.float64]
Index = NDArray[np.int64]
STIFFNESS, SMOOTHING = 4.0, 0.002
"""Of contact: by the wall stiffness over a spring's length, eight times what the wall along a
boundary holds its particles by; and of a spring's length, over which contact sets in."""


@dataclass(frozen=True, eq=False)
class Conditions:
    """A problem on the particles of a tissue.

    Raises:
        InputError: a boundary has no particles, or two supports take one component differently.
    """

    problem: TissueProblem
    tissue: Tissue

    def boundary(self, name: str) -> Index:
        """Numbers of the wall particles of a boundary, increasing."""
        found = np.flatnonzero(self._outer & self._held_by(self.problem.boundaries[name]))
        if not found.size:
            raise InputError(f"boundary {name}: it holds no wall particle of the outline")
        return found

    def lengths(self, name: str) -> Array:
        """(k,) unloaded length of the outline that each particle of a boundary stands for, µm."""
        inside = np.zeros(self.tissue.particles, dtype=np.bool_)
        inside[self.boundary(name)] = True
        pairs = self._bonds[inside[self._bonds].all(axis=1)]
        half = 0.5 * self.tissue.cell.spring_length
        ends: Array = np.bincount(pairs.ravel(), minlength=len(inside)).astype(np.float64)
        return half * ends[self.boundary(name)]

    @property
    def held(self) -> NDArray[np.bool_]:
        """(particles, 2) components that supports take."""
        held = np.zeros((self.tissue.particles, 2), dtype=np.bool_)
        for support in self.problem.supports:
            held[self.boundary(support.on)] |= np.array(support.components)
        return held

    def components(self) -> list[tuple[Index, Index]]:
        """Of each support the particles and axes of its components, each owned by one support.

        Raises:
            InputError: two supports move one component differently.
        """
        owner: dict[tuple[int, int], tuple[str, float, object]] = {}
        found = []
        for support in self.problem.supports:
            mine = []
            for axis in (0, 1):
                for i in self.boundary(support.on) if support.components[axis] else ():
                    claim = support.name, support.displacement[axis], support.amplitude
                    other = owner.setdefault((int(i), axis), claim)
                    if other is claim:
                        mine.append((int(i), axis))
                    elif other[1:] != claim[1:] and (other[1] or claim[1]):
                        x, y = self.tissue.outline[i]
                        raise InputError(
                            f"{support.name}: component {'xy'[axis]} of the particle at "
                            f"({x:.6g}, {y:.6g}) µm; {other[0]} prescribes it otherwise"
                        )
            both = np.array(mine, dtype=np.int64).reshape(-1, 2)
            found.append((both[:, 0], both[:, 1]))
        return found

    def loads(self) -> Array:
        """(loads, particles, 2) µN at amplitude 1; one of nothing where there is none."""
        found = [self._load(each) for each in self.problem.loads]
        return np.array(found) if found else np.zeros((1, self.tissue.particles, 2))

    def drive(self) -> Drive:
        """Motion of the supports that move, numbered as in `TissueProblem.motions`."""
        rows, mass = [], self.tissue.mass.reshape(-1)[self.tissue.where]
        moving = [each for each in self.problem.supports if each.moves]
        for support, (i, axis) in zip(self.problem.supports, self.components(), strict=True):
            if support.moves:
                motion = np.full(len(i), moving.index(support))
                rows.append((i, axis, motion, np.array(support.displacement)[axis]))
        if not rows:
            return NO_DRIVE._replace(work=np.zeros(1))
        i, axis, motion, largest = (np.concatenate(column) for column in zip(*rows, strict=True))
        tile, own, lane = self._address(i).T
        at = np.stack([tile, axis, own, lane], axis=1)
        return Drive(at, motion, largest, mass[i], np.zeros(len(i)), np.zeros(1))

    def plates(self, offset: Array) -> Plates:
        """The bodies at t = 0, before they move.

        Args:
            offset: (particles, 2) by which the outline that bodies meet is off the particles, µm.
        """
        bodies = self.problem.bodies
        if not bodies:
            return NO_PLATES._replace(work=np.zeros(2))
        touching = [self.boundary(body.on) for body in bodies]
        everyone = np.concatenate(touching)
        moves = np.array([body.moves for body in bodies])
        first = sum(support.moves for support in self.problem.supports)
        stiffness, smoothing = zip(*map(self.penalty, bodies), strict=True)
        return Plates(
            starts=np.cumsum([0, *map(len, touching)]),
            at=self._address(everyone),
            length=np.concatenate([self.lengths(body.on) for body in bodies]),
            offset=offset[everyone],
            outline=np.array([_outline(body) for body in bodies]),
            stiffness=np.array(stiffness),
            smoothing=np.array(smoothing),
            x=np.array([body.position for body in bodies]),
            v=np.array([body.velocity if body.mass else (0.0, 0.0) for body in bodies]),
            force=np.zeros((len(bodies), 2)),
            stored=np.zeros(len(bodies)),
            depth=np.zeros(len(bodies)),
            per_mass=np.array([1.0 / body.mass if body.mass else 0.0 for body in bodies]),
            pull=np.array([body.acceleration for body in bodies]),
            motion=np.where(moves, first + np.cumsum(moves) - 1, -1),
            largest=np.array([body.displacement for body in bodies]),
            work=np.zeros(2),
        )

    def penalty(self, body: Body) -> tuple[float, float]:
        """Stiffness in µN/µm² and smoothing in µm of a body's contact."""
        cell, wall = self.tissue.cell, max(each.wall_stiffness for each in self.tissue.types)
        usual = STIFFNESS * wall / cell.spring_length
        return (
            usual if body.stiffness is None else body.stiffness,
            SMOOTHING * cell.spring_length if body.smoothing is None else body.smoothing,
        )

    def largest_contact_frequency(self) -> float:
        """Largest k L/m of a particle that touches bodies, 1/µs²; 0 without bodies."""
        mass = self.tissue.mass.reshape(-1)[self.tissue.where]
        total = np.zeros(self.tissue.particles)
        for body in self.problem.bodies:
            total[self.boundary(body.on)] += self.penalty(body)[0] * self.lengths(body.on)
            if body.mass is not None:
                total += self.penalty(body)[0] * self.lengths(body.on).sum() / body.mass * mass
        return float((total / mass).max())

    def velocity(self) -> Array:
        """(particles, 2) at t = 0, µm/µs, of what moves freely."""
        v = np.zeros((self.tissue.particles, 2))
        for on, velocity in self.problem.velocities:
            boundary = on in self.problem.boundaries
            v[self.boundary(str(on)) if boundary else self._part_of(on) > 0.0] = velocity
        v[self.held] = 0.0
        return v

    def _load(self, load: Load) -> Array:
        if not any(load.traction):
            mass = self.tissue.mass.reshape(-1)[self.tissue.where]
            return (self._part_of(load.on) * mass)[:, None] * np.array(load.acceleration)
        found = np.zeros((self.tissue.particles, 2))
        on = str(load.on)
        found[self.boundary(on)] = self.lengths(on)[:, None] * np.array(load.traction)
        return found

    def _part_of(self, region: str | None) -> Array:
        """(particles,) part of each that belongs to plant cells of a region; of None, all."""
        tissue = self.tissue
        if region is None:
            return np.ones(tissue.particles)
        middles = middles_of(tissue.cells, tissue.cell.cell_side)
        inside = self.problem.regions[region].holds(middles).reshape(tissue.cells)
        mine, whole = (
            shares(tissue.cell, filled, tissue.column, tissue.row)
            for filled in (inside, np.ones(tissue.cells, dtype=np.bool_))
        )
        part = np.divide(mine, whole, out=np.zeros_like(whole), where=whole > 0.0)
        tiled = np.moveaxis(part.reshape(tissue.tiles, TILE, tissue.own), 1, 2)
        return np.ascontiguousarray(tiled).reshape(-1)[tissue.where]

    def _address(self, i: Index) -> Index:
        """(k, 3) tile, own particle and lane of particles."""
        row, lane = np.divmod(self.tissue.where[i], TILE)
        return np.ascontiguousarray(np.stack([*np.divmod(row, self.tissue.own), lane], axis=1))

    def _held_by(self, part: Part) -> NDArray[np.bool_]:
        held = np.zeros(self.tissue.particles, dtype=np.bool_)
        held[self._outer] = part.holds(self.tissue.outline[self._outer])
        return held

    @cached_property
    def _outer(self) -> NDArray[np.bool_]:
        """(particles,) which lie on the outline."""
        side, (n, m) = self.tissue.cell.cell_side, self.tissue.cells
        x, y = (self.tissue.outline / side).T
        walls = np.isfinite(x)
        slack = 1e-9
        ends = (x < slack) | (x > n - slack) | (y < slack) | (y > m - slack)
        return walls & ends

    @cached_property
    def _bonds(self) -> Index:
        """(b, 2) bonded particles."""
        return bonded_particles(self.tissue)


def _outline(body: Body) -> tuple[float, float, float]:
    size = float(np.hypot(*body.normal))
    x, y = (body.normal[0] / size, body.normal[1] / size) if size else (0.0, 0.0)
    return x, y, body.radius

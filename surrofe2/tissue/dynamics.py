"""Dynamics of all particles of a tissue, with pair lists that follow them."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numba
import numpy as np

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.errors import SimulationError
from surrofe2.base.simd import TILE
from surrofe2.tissue.external_forces import (
    BY_MOTION,
    BY_PULL,
    LOST,
    NO_BODIES,
    NO_DRIVEN,
    NO_OUTLINE,
    BodyContacts,
    DrivenParticles,
    OutlineForces,
)
from surrofe2.tissue.kernels import Particles, Watch, elastic_energy, leap
from surrofe2.tissue.layout import NOWHERE, Tissue
from surrofe2.tissue.pair_lists import DAMPING, ELASTIC, WHOLE, Factors, PairLister

TILES_PER_THREAD = 4
"""Least tiles per thread; with fewer, threads wait too long for each other, twice per step."""


class Works(NamedTuple):
    """Works, pJ, and impulses since they were last taken.

    Attributes:
        loads: (loads,) work of each load.
        impulses: (2 b,) x and y of the impulse of each body on the tissue, µN µs. They are no
            works, but are summed in the same way.
        bodies: work of the acceleration of bodies, such as gravity.
        motion: work of what moves supports and bodies.
        contact_dissipated: energy lost in contact.
        dissipated: energy lost in the tissue.
    """

    loads: Array
    impulses: Array
    bodies: float = 0.0
    motion: float = 0.0
    contact_dissipated: float = 0.0
    dissipated: float = 0.0

    @property
    def row(self) -> Array:
        """The works of loads, then the other works, then the impulses, (loads + 4 + 2 b,)."""
        others = self.bodies, self.motion, self.contact_dissipated, self.dissipated
        return np.array([*self.loads, *others, *self.impulses])


class TissueDynamics:
    """Positions and velocities of all particles, moved in place by leapfrog steps.

    Args:
        tissue: the particles.
        skin: reach of pair lists beyond the cut-off, µm; it changes the cost only.
        held: (particles, 2) True for components that do not move by their forces; None: none.
        loads: (loads, particles, 2) dead loads at amplitude 1, µN; None: none.
        driven: prescribed motion of components that are held.

    Attributes:
        counts: `force_evaluations` and `list_builds` so far.
        free: (particles, 2) True for components that move freely.
        mass: (particles,) ng.
        loads, driven: arguments of the same names.
        bodies, outline: rigid bodies, and forces on the outline; at first there are none.
    """

    def __init__(
        self,
        tissue: Tissue,
        *,
        skin: float = 2.0,
        held: Flags | None = None,
        loads: Array | None = None,
        driven: DrivenParticles = NO_DRIVEN,
    ) -> None:
        self.tissue = tissue
        self.counts: Counter[str] = Counter()
        self._lister = PairLister(tissue, skin)
        self.driven = driven
        self.bodies: BodyContacts = NO_BODIES
        self.outline: OutlineForces = NO_OUTLINE
        self.mass = tissue.to_particles(tissue.mass)
        shape = tissue.particles, 2
        self.free = np.ones(shape, dtype=np.bool_) if held is None else ~held
        self.loads = np.zeros((0, *shape)) if loads is None else loads
        # own particles alone, until `_put` lays out local ones
        still = np.zeros(tissue.start.shape)
        self._particles = Particles(
            x=tissue.start,
            v=still,
            f=still,
            per_mass=tissue.to_tiles(self.free / self.mass[:, None]),
            loads=np.array([*map(tissue.to_tiles, self.loads)]).reshape(-1, *tissue.start.shape),
            work=np.zeros((len(self.loads), tissue.tiles, TILE)),
        )
        self._put(self.x, self.v)

    @property
    def x(self) -> Array:
        """Positions (particles, 2), µm."""
        return self.tissue.to_particles(self._particles.x)

    @property
    def v(self) -> Array:
        """Velocities (particles, 2), µm/µs."""
        return self.tissue.to_particles(self._particles.v)

    @property
    def f(self) -> Array:
        """Forces of the last step (particles, 2), without dead loads, µN."""
        return self.tissue.to_particles(self._particles.f)

    def take_works(self) -> Works:
        """Return the works and impulses since they were last taken.

        What is lost in the tissue is not in them.
        """
        works = Works(
            loads=self._particles.work.sum(axis=(1, 2)) + self.outline.work,
            impulses=self.bodies.impulse.flatten(),
            bodies=self.bodies.work[BY_PULL],
            motion=self.bodies.work[BY_MOTION] + self.driven.work[0],
            contact_dissipated=self.bodies.work[LOST],
        )
        for part in (self._particles, self.driven, self.bodies, self.outline):
            part.work[:] = 0.0
        self.bodies.impulse[:] = 0.0
        return works

    def place(self, x: Array, v: Array | None = None) -> None:
        """Put particles at x (particles, 2) with velocities v; None: at rest."""
        self._put(x, np.zeros_like(x) if v is None else v, self._watch.listed)
        # The present lists are kept if they miss no pair; forces measure how far particles are
        # from where they were listed, and make new lists otherwise.
        self.forces(with_outline=False)

    def start(self, velocity: Array, rates: Array) -> float:
        """Set particles that have been at rest into motion.

        Args:
            velocity: (particles, 2) velocities of those that move freely, µm/µs.
            rates: (motions,) rates of prescribed amplitudes, 1/µs.

        Returns:
            Work of the impulse on driven particles, pJ: ½ m v², as it acts at the mean velocity.
        """
        driven = self.driven
        bodies = self.bodies
        # all tiles but the last, which never changes
        tissue = self.tissue
        self._particles.v[:-1, :, : tissue.particles_per_period] = tissue.to_tiles(velocity)
        v_driven = rates[driven.motion] * driven.largest
        self._particles.v[tuple(driven.at.T)] = v_driven
        is_driven = bodies.motion >= 0
        bodies.v[is_driven] = rates[bodies.motion[is_driven], None] * bodies.largest[is_driven]
        return 0.5 * float(driven.mass @ v_driven**2)

    def leap(
        self,
        kicks: Array,
        drifts: Array,
        amplitudes: Array | None = None,
        speeds: Array | None = None,
        *,
        factors: Factors = WHOLE,
        retained: float = 1.0,
        with_outline: bool = True,
    ) -> None:
        """Make the steps v += kicks[k] a(x, v), x += drifts[k] v.

        Pair lists are made again whenever they could miss a pair.

        Args:
            kicks, drifts: (steps,) µs.
            amplitudes: (steps, loads) amplitudes of loads; None: all zero.
            speeds: (steps, motions) mean rates of prescribed amplitudes, 1/µs; None: all zero.
            factors: factors on elastic and damping forces between particles.
            retained: part of v that a step leaves before its kick.
            with_outline: whether bodies and forces on the outline act.

        Raises:
            SimulationError: positions are no longer finite, or the tissue has collapsed.
        """
        count = len(kicks)
        bodies = self.bodies if with_outline else NO_BODIES
        outline = self.outline if with_outline else NO_OUTLINE
        if amplitudes is None:
            amplitudes = np.zeros((count, len(self.loads)))
        if speeds is None:
            motions = 1 + max([*self.driven.motion, *self.bodies.motion], default=-1)
            speeds = np.zeros((count, motions))
        steps: tuple[Array, ...] = np.stack([kicks, drifts], axis=1), amplitudes, speeds
        renewed = False
        # a setting of the whole process, so it is restored at the end
        allowed = numba.get_num_threads()
        numba.set_num_threads(max(1, min(allowed, self.tissue.tiles // TILES_PER_THREAD)))
        try:
            while len(steps[0]):
                if renewed:
                    self._put(self.x, self.v)
                completed = leap(
                    self._particles, self._lists, self._constants[factors], self._lister.cells,
                    self.driven, bodies, outline, self._watch, steps, retained,
                )  # fmt: skip
                self.counts["force_evaluations"] += completed
                # not even new lists bear one step
                if renewed and completed == 0:
                    raise SimulationError("tissue: particles fly apart within a step")
                steps = tuple(values[completed:] for values in steps)
                renewed = True  # steps that remain need new lists
        finally:
            numba.set_num_threads(allowed)

    def forces(
        self,
        factors: Factors = WHOLE,
        *,
        with_outline: bool = True,
        amplitudes: Array | None = None,
    ) -> Array:
        """Compute forces (particles, 2) without dead loads, µN, by a step of no length.

        Args:
            factors, with_outline: as for `leap`.
            amplitudes: (loads,) amplitudes of follower pressures; None: all zero.
        """
        amplitudes_of_step = None if amplitudes is None else amplitudes[None]
        no_length = np.zeros(1)
        self.leap(
            no_length, no_length, amplitudes_of_step, factors=factors, with_outline=with_outline
        )
        return self.f

    def dissipation_rate(self) -> float:
        """Compute the power that dashpots and viscosity take, −Σ v·f of their forces, pJ/µs."""
        return -float(np.sum(self.v * self.forces(DAMPING, with_outline=False)))

    def elastic_energy(self, amplitudes: Array | None = None) -> float:
        """Compute the stored energy, pJ; that of the fluid is counted from ρ = 1 ng/µm².

        It sets the forces, too, also those on bodies and on the outline. Arguments as for `forces`.
        """
        self.forces(amplitudes=amplitudes)
        energy = np.empty((self.tissue.tiles, TILE))
        constants = self._constants[WHOLE]
        cells = self._lister.cells
        elastic_energy(self._particles.x, self._lists, constants, cells, energy)
        return float(energy.sum())

    def kinetic_energy(self) -> float:
        """Compute the kinetic energy ½ Σ m v² of particles and free bodies, pJ."""
        bodies = self.bodies
        free = bodies.per_mass > 0.0
        of_bodies = np.sum(bodies.v[free] ** 2 / bodies.per_mass[free, None])
        return 0.5 * float(np.sum(self.mass[:, None] * self.v**2) + of_bodies)

    def _put(self, x: Array, v: Array, listed: Array | None = None) -> None:
        """Put particles at x with velocities v, both (particles, 2), and set up their lists.

        listed: (tiles, 2, own, TILE) positions at which the present lists were made, which are
            kept; None: new lists are made.
        """
        tissue = self.tissue
        tiles = self.tissue.tiles
        particles = self.tissue.particles_per_period
        own_x = tissue.to_tiles(x, tissue.start)
        if listed is None:
            listed = own_x
            self._lists, constants = self._lister.make(listed)
            every = WHOLE, ELASTIC, DAMPING
            self._constants = {factors: constants.times(factors) for factors in every}
            self.counts["list_builds"] += 1
        # a tile more than there are, which never changes: see `kernels`
        shape = (tiles + 1, 2, self._lists.local, TILE)
        local_x = np.full(shape, NOWHERE)
        local_v = np.zeros(shape)
        local_x[:-1, :, :particles] = own_x
        local_v[:-1, :, :particles] = tissue.to_tiles(v)
        self._particles = self._particles._replace(x=local_x, v=local_v, f=np.zeros(shape))
        self._watch = Watch(
            listed=listed,
            mean=np.zeros((tiles, 2, TILE)),
            spread=np.zeros((tiles, TILE)),
            apart=np.zeros((tiles, TILE)),
        )

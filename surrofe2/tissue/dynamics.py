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
"""For fewer, another thread is not worth the waiting for each other, twice a step."""


class Works(NamedTuple):
    """Works since they were last taken, pJ.

    Attributes:
        loads: (loads,) of the loads. bodies: of `acceleration` on bodies.
        motion: of what moves supports and bodies.
        contact_dissipated: lost in contact. dissipated: lost in the tissue.
    """

    loads: Array
    bodies: float = 0.0
    motion: float = 0.0
    contact_dissipated: float = 0.0
    dissipated: float = 0.0

    @property
    def row(self) -> Array:
        """(loads + 4,) all of them, in this order."""
        lost = self.contact_dissipated, self.dissipated
        return np.array([*self.loads, self.bodies, self.motion, *lost])


class TissueDynamics:
    """Positions and velocities, moved in place by leapfrog steps.

    Args:
        tissue: the particles.
        skin: by how much pair lists reach beyond the cut-off, µm; it changes the cost only.
        held: (particles, 2) which components do not move by their forces; None: none.
        loads: (loads, particles, 2) forces on each at amplitude 1, µN; None: none.
        driven: motion of some that are held.

    Attributes:
        counts: `force_evaluations` and `list_builds` so far.
        free: (particles, 2) which components move freely.
        mass: (particles,) ng.
        loads, driven: as above.
        bodies, outline: rigid bodies, and what acts on the outline; at first there are none.
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
        """(particles, 2) positions, µm."""
        return self.tissue.to_particles(self._particles.x)

    @property
    def v(self) -> Array:
        """(particles, 2) velocities, µm/µs."""
        return self.tissue.to_particles(self._particles.v)

    @property
    def f(self) -> Array:
        """(particles, 2) forces of the last step, without dead loads, µN."""
        return self.tissue.to_particles(self._particles.f)

    def take_works(self) -> Works:
        """Return the works since they were last taken, without what is lost in the tissue."""
        of_bodies, moving_bodies, in_contact = self.bodies.work
        works = Works(
            loads=self._particles.work.sum(axis=(1, 2)) + self.outline.work,
            bodies=of_bodies,
            motion=moving_bodies + self.driven.work[0],
            contact_dissipated=in_contact,
        )
        for each in (self._particles, self.driven, self.bodies, self.outline):
            each.work[:] = 0.0
        return works

    def place(self, x: Array, v: Array | None = None) -> None:
        """Put particles at x with velocities v (None: at rest)."""
        self._put(x, np.zeros_like(x) if v is None else v, self._watch.listed)
        # lists stay until they may miss a pair; this measures how far particles are from there
        self.forces(with_outline=False)

    def start(self, velocity: Array, rates: Array) -> float:
        """Set particles, at rest until now, into motion; the work of the impulse on driven ones.

        Args:
            velocity: (particles, 2) of those that move freely, µm/µs.
            rates: (motions,) of prescribed motion, 1/µs. An impulse acts at the mean velocity.
        """
        driven = self.driven
        bodies = self.bodies
        self._particles.v[:-1, :, : self.tissue.own] = self.tissue.to_tiles(velocity)
        led = rates[driven.motion] * driven.largest
        self._particles.v[tuple(driven.at.T)] = led
        moved = bodies.motion >= 0
        bodies.v[moved] = rates[bodies.motion[moved], None] * bodies.largest[moved]
        return 0.5 * float(driven.mass @ led**2)

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
        """Steps v += kicks[k] a(x, v), x += drifts[k] v; each leaves the part `retained` of v.

        Args:
            amplitudes: (steps, loads). speeds: (steps, motions). None: all zero.
            factors: on elastic and damping forces between particles.
            with_outline: whether bodies and what acts on the outline are there.

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
        allowed = numba.get_num_threads()
        numba.set_num_threads(max(1, min(allowed, self.tissue.tiles // TILES_PER_THREAD)))
        try:
            while len(steps[0]):
                if renewed:
                    self._put(self.x, self.v)
                taken = leap(
                    self._particles, self._lists, self._constants[factors], self._lister.cells,
                    self.driven, bodies, outline, self._watch, steps, retained,
                )  # fmt: skip
                self.counts["force_evaluations"] += taken
                if renewed and taken == 0:
                    raise SimulationError("tissue: particles fly apart within a step")
                steps = tuple(each[taken:] for each in steps)
                renewed = True
        finally:
            numba.set_num_threads(allowed)

    def forces(
        self,
        factors: Factors = WHOLE,
        *,
        with_outline: bool = True,
        amplitudes: Array | None = None,
    ) -> Array:
        """(particles, 2) forces without dead loads, µN.

        Args:
            factors, with_outline: as of `leap`. amplitudes: (loads,) of follower pressures.
        """
        at_once = None if amplitudes is None else amplitudes[None]
        nothing = np.zeros(1)
        self.leap(nothing, nothing, at_once, factors=factors, with_outline=with_outline)
        return self.f

    def dissipation_rate(self) -> float:
        """Power that dashpots and viscosity take, pJ/µs: −Σ v·f of those forces alone."""
        return -float(np.sum(self.v * self.forces(DAMPING, with_outline=False)))

    def elastic_energy(self, amplitudes: Array | None = None) -> float:
        """Stored energy, pJ; fluid's part is counted from ρ = 1 ng/µm². Arguments as of `forces`.

        Also sets the forces, those on bodies and on the outline.
        """
        self.forces(amplitudes=amplitudes)
        energy = np.empty((self.tissue.tiles, TILE))
        constants = self._constants[WHOLE]
        cells = self._lister.cells
        elastic_energy(self._particles.x, self._lists, constants, cells, energy)
        return float(energy.sum())

    def kinetic_energy(self) -> float:
        """½ Σ m v² of particles and free bodies, pJ."""
        bodies = self.bodies
        free = bodies.per_mass > 0.0
        of_bodies = np.sum(bodies.v[free] ** 2 / bodies.per_mass[free, None])
        return 0.5 * float(np.sum(self.mass[:, None] * self.v**2) + of_bodies)

    def _put(self, x: Array, v: Array, listed: Array | None = None) -> None:
        """Put particles with the lists made at `listed` (tiles, 2, own, TILE), or new ones."""
        tissue = self.tissue
        tiles = self.tissue.tiles
        particles = self.tissue.own
        own_x = tissue.to_tiles(x, tissue.start)
        if listed is None:
            listed = own_x
            self._lists, constants = self._lister.make(listed)
            every = WHOLE, ELASTIC, DAMPING
            self._constants = {factors: constants.times(factors) for factors in every}
            self.counts["list_builds"] += 1
        shape = (tiles + 1, 2, self._lists.local, TILE)
        there = np.full(shape, NOWHERE)
        rate = np.zeros(shape)
        there[:-1, :, :particles] = own_x
        rate[:-1, :, :particles] = tissue.to_tiles(v)
        self._particles = self._particles._replace(x=there, v=rate, f=np.zeros(shape))
        mean = np.zeros((tiles, 2, TILE))
        nothing = np.zeros((tiles, TILE))
        self._watch = Watch(listed, mean, nothing, nothing.copy())

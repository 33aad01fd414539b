"""The history of a tissue run: recorded at output times, kept as plain arrays that carry it on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from time import perf_counter
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.errors import InputError
from surrofe2.load_case import LoadCase
from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.pair_lists import bonded_particles
from surrofe2.tissue.settings import TissueSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueState:
    """A run at an output time: all that is needed to carry it on, bit by bit, and its results.

    Attributes:
        relaxed, x, v: (particles, 2) the unloaded equilibrium,
            positions and velocities, µm and µm/µs. listed: (particles, 2) positions at which the
            pair lists in use were made.
        elastic: stored energy of the unloaded tissue, pJ.
        watched: (rows, 2) displacement; energies: (4, rows) kinetic, elastic, load, dissipated.
        frame_t: (k,); frame_displacement, frame_velocity: (k, particles, 2).
        identity: numbers that a run to be resumed must share.
        steps, force_evaluations, list_builds: counts. relaxation_time, run_time: s.
    """

    relaxed: Array
    x: Array
    v: Array
    listed: Array
    elastic: float
    watched: Array
    energies: Array
    frame_t: Array
    frame_displacement: Array
    frame_velocity: Array
    identity: Array
    steps: int
    force_evaluations: int
    list_builds: int
    relaxation_time: float
    run_time: float

    @property
    def rows(self) -> int:
        """Output times passed."""
        return len(self.watched)

    def to_arrays(self) -> dict[str, NDArray]:
        """One array for each field."""
        return {name: np.array(value) for name, value in asdict(self).items()}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray]) -> TissueState:
        """The state whose `to_arrays` gave `arrays`.

        Raises:
            InputError: one of them is missing.
        """
        values: dict[str, Any] = {}
        for item in fields(cls):
            if item.name not in arrays:
                raise InputError(f"tissue state: no {item.name!r}; the checkpoint is incomplete")
            value = np.asarray(arrays[item.name])
            values[item.name] = value.item() if value.ndim == 0 else value
        return cls(**values)


@dataclass(frozen=True, slots=True)
class ParticleFrames:
    """Particle fields at k times: t (k,) µs; displacement, velocity (k, particles, 2)."""

    t: Array
    displacement: Array
    velocity: Array


@dataclass(frozen=True, slots=True)
class TissueRun:
    """A run, or with `finished` False the part of it that was computed.

    Attributes:
        curve: displacement of the watched particle from the unloaded equilibrium.
        energies: by name, (m,) pJ at the output times: `kinetic`; `elastic`, since the unloaded
            equilibrium; `load` work; `dissipated` by dashpots and viscosity; `balance`, load −
            kinetic − elastic − dissipated, zero but for the error of the time integration.
        position: (particles, 2) the unloaded equilibrium, µm; walls first.
        bonds: (b, 2) bonded wall particles. is_wall: (particles,).
        frames: particle fields at a few times.
        wall_time: s, `total`, `relaxation` and `run`.
        counts: `steps`, `force_evaluations`, `list_builds`, `particles`, `particle_steps`.
    """

    curve: DisplacementCurve
    energies: dict[str, Array]
    position: Array
    bonds: NDArray[np.int64]
    is_wall: NDArray[np.bool_]
    frames: ParticleFrames
    wall_time: dict[str, float]
    counts: dict[str, int]
    threads: int
    finished: bool


class Recorder:
    """Takes down what a run finds; its state is replaced as a whole, so no interrupt tears it."""

    def __init__(
        self,
        load_case: LoadCase,
        settings: TissueSettings,
        dynamics: TissueDynamics,
        identity: Array,
    ) -> None:
        self._dynamics = dynamics
        self._identity = identity
        self._t = load_case.output_times()
        self._frame_times = np.linspace(0.0, load_case.duration, settings.frames)
        start = dynamics.tissue.to_particles(dynamics.tissue.start)
        self._watched = int(np.hypot(*(start - np.array(load_case.watched)).T).argmin())
        self._created = perf_counter()
        self.state: TissueState

    def begin(self) -> None:
        """Record the unloaded equilibrium at t = 0, in which the tissue rests."""
        dynamics = self._dynamics
        relaxed, v = dynamics.x, dynamics.v
        relaxation_time = perf_counter() - self._created
        self._started = perf_counter()
        dynamics.counts.clear()
        still = np.zeros((1, *relaxed.shape))
        self.state = TissueState(
            relaxed=relaxed,
            x=relaxed,
            v=v,
            listed=dynamics.listed,
            elastic=dynamics.elastic_energy(),
            watched=np.zeros((1, 2)),
            energies=np.zeros((4, 1)),
            frame_t=np.zeros(1),
            frame_displacement=still,
            frame_velocity=still,
            identity=self._identity,
            steps=0,
            force_evaluations=0,
            list_builds=0,
            relaxation_time=relaxation_time,
            run_time=0.0,
        )

    def restore(self, state: TissueState) -> None:
        """Go on from where `state` was taken."""
        dynamics = self._dynamics
        dynamics.place(state.x, state.v, state.listed)
        dynamics.counts.clear()
        dynamics.counts.update(
            force_evaluations=state.force_evaluations, list_builds=state.list_builds
        )
        self.state = state
        self._started = perf_counter() - state.run_time

    def record(self, steps: int, work: float, lost: float) -> None:
        """Record the next output time, `steps` after the last; work and lost energy since, pJ."""
        dynamics, before = self._dynamics, self.state
        row = before.rows
        x, v = dynamics.x, dynamics.v
        u = x - before.relaxed
        energies = np.array(
            [
                dynamics.kinetic_energy(),
                dynamics.elastic_energy() - before.elastic,
                before.energies[2, -1] + work,
                before.energies[3, -1] + lost,
            ]
        )
        state = replace(
            before,
            x=x,
            v=v,
            listed=dynamics.listed,
            watched=np.vstack([before.watched, u[self._watched]]),
            energies=np.column_stack([before.energies, energies]),
            steps=before.steps + steps,
            force_evaluations=dynamics.counts["force_evaluations"],
            list_builds=dynamics.counts["list_builds"],
            run_time=perf_counter() - self._started,
        )
        if self._frames_due(self._t[row]) > self._frames_due(self._t[row - 1]):
            state = replace(
                state,
                frame_t=np.append(state.frame_t, self._t[row]),
                frame_displacement=np.concatenate([state.frame_displacement, u[None]]),
                frame_velocity=np.concatenate([state.frame_velocity, v[None]]),
            )
        self.state = state

    def run(self, *, finished: bool) -> TissueRun:
        """The results so far."""
        state, tissue = self.state, self._dynamics.tissue
        names = ("kinetic", "elastic", "load", "dissipated")
        energies = dict(zip(names, state.energies, strict=True))
        kinetic, elastic, load, dissipated = state.energies
        return TissueRun(
            curve=DisplacementCurve(self._t[: state.rows], state.watched),
            energies=energies | {"balance": load - kinetic - elastic - dissipated},
            position=state.relaxed,
            bonds=bonded_particles(tissue),
            is_wall=np.arange(tissue.particles) < tissue.wall_particles,
            frames=ParticleFrames(state.frame_t, state.frame_displacement, state.frame_velocity),
            wall_time={
                "total": state.relaxation_time + state.run_time,
                "relaxation": state.relaxation_time,
                "run": state.run_time,
            },
            counts={
                "steps": state.steps,
                "force_evaluations": state.force_evaluations,
                "list_builds": state.list_builds,
                "particles": tissue.particles,
                "particle_steps": tissue.particles * state.steps,
            },
            threads=numba.get_num_threads(),
            finished=finished,
        )

    def _frames_due(self, t: float) -> int:
        return int(np.searchsorted(self._frame_times, t * (1.0 + 1e-12), side="right"))

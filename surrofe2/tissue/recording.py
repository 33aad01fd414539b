"""Collecting the results of a tissue run, output time by output time."""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.load_case import LoadCase
from surrofe2.tissue.motion import Motion
from surrofe2.tissue.neighbour_lists import bonded_particles
from surrofe2.tissue.results import ParticleFrames, TissueRun, TissueState
from surrofe2.tissue.settings import TissueSettings

Array = NDArray[np.float64]


class TissueRecorder:
    """Results up to the last output time; `state` is replaced as a whole, so it is never torn."""

    def __init__(
        self, load_case: LoadCase, settings: TissueSettings, motion: Motion, identity: Array
    ) -> None:
        self._motion = motion
        self._identity = identity
        self._t = load_case.output_times()
        self._frame_times = np.linspace(0.0, load_case.duration, settings.frames)
        start = motion.tissue.to_particles(motion.tissue.start)
        self._watched = int(np.hypot(*(start - np.array(load_case.watched)).T).argmin())
        self._created = perf_counter()
        self.state: TissueState

    @property
    def rows(self) -> int:
        """Output times recorded."""
        return self.state.rows

    def begin(self) -> None:
        """Record the unloaded equilibrium at t = 0, in which `motion` rests."""
        motion = self._motion
        relaxed, v = motion.x, motion.v
        relaxation_time = perf_counter() - self._created
        self._started = perf_counter()
        motion.counts.clear()
        still = np.zeros_like(relaxed)
        self.state = TissueState(
            rows=1,
            relaxed=relaxed,
            x=relaxed,
            v=v,
            listed=motion.listed,
            elastic=motion.elastic_energy(),
            watched=np.zeros((1, 2)),
            energies=np.zeros((4, 1)),
            frame_t=np.zeros(1),
            frame_displacement=still[None],
            frame_velocity=still[None],
            identity=self._identity,
            steps=0,
            force_evaluations=0,
            list_builds=0,
            relaxation_time=relaxation_time,
            run_time=0.0,
        )

    def restore(self, state: TissueState) -> None:
        """Go on from where `state` was taken."""
        motion = self._motion
        motion.place(state.x, state.v, state.listed)
        motion.counts.clear()
        motion.counts.update(
            force_evaluations=state.force_evaluations, list_builds=state.list_builds
        )
        self.state = state
        self._started = perf_counter() - state.run_time

    def record(self, steps: int, work: float, lost: float) -> None:
        """Record the next output time, `steps` after the last; work and lost energy since, pJ."""
        motion, before = self._motion, self.state
        row = before.rows
        x, v = motion.x, motion.v
        u = x - before.relaxed
        energies = np.array(
            [
                motion.kinetic_energy(),
                motion.elastic_energy() - before.elastic,
                before.energies[2, -1] + work,
                before.energies[3, -1] + lost,
            ]
        )
        state = replace(
            before,
            rows=row + 1,
            x=x,
            v=v,
            listed=motion.listed,
            watched=np.vstack([before.watched, u[self._watched]]),
            energies=np.column_stack([before.energies, energies]),
            steps=before.steps + steps,
            force_evaluations=motion.counts["force_evaluations"],
            list_builds=motion.counts["list_builds"],
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
        state, tissue = self.state, self._motion.tissue
        kinetic, elastic, load, dissipated = state.energies
        return TissueRun(
            curve=DisplacementCurve(self._t[: state.rows], state.watched),
            energies={
                "kinetic": kinetic,
                "elastic": elastic,
                "load": load,
                "dissipated": dissipated,
                "balance": load - kinetic - elastic - dissipated,
            },
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

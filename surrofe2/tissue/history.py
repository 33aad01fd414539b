"""The history of a tissue run: recorded at output times, kept as plain arrays that carry it on."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import ClassVar

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import clock
from surrofe2.problem.problem import label
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.run.journal import (
    Journal,
    RunState,
    curves_of,
    frame_series,
    history_of,
    named_columns,
)
from surrofe2.run.views import Facts, ViewedRun, course
from surrofe2.tissue.conditions import Conditions
from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.pair_lists import bonded_particles
from surrofe2.tissue.settings import TissueSettings

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueState(RunState):
    """A run at an output time: all that is needed to carry it on, bit by bit, and its results.

    Attributes:
        relaxed, x, v: (particles, 2) the unloaded equilibrium, positions and velocities, µm and
            µm/µs. listed: (particles, 2) positions at which the pair lists in use were made.
        elastic: stored energy of the unloaded tissue, pJ; resting: (k, 2) forces there, µN.
        bodies: (2, b, 2) position and velocity of rigid bodies.
        journal: ``rows`` (r, c) at the output times passed, the columns of `columns_of`;
            ``frames.…`` as of `ParticleFrames`.
        identity: numbers that a run to be resumed must share.
        seconds: of `relaxation` and `run`. counts: `steps`, `force_evaluations`, `list_builds`.
    """

    SERIES: ClassVar[tuple[str, ...]] = (
        "rows", "frames.t", "frames.displacement", "frames.velocity"
    )  # fmt: skip

    relaxed: Array
    x: Array
    v: Array
    listed: Array
    elastic: float
    resting: Array
    bodies: Array
    journal: Journal
    identity: Array
    seconds: dict[str, float]
    counts: dict[str, int]

    @property
    def rows(self) -> int:
        """Output times passed."""
        return self.journal.lengths["rows"]


@dataclass(frozen=True, slots=True)
class ParticleFrames:
    """Particle fields at k times: t (k,) µs; displacement, velocity (k, particles, 2)."""

    t: Array
    displacement: Array
    velocity: Array


@dataclass(frozen=True, slots=True)
class TissueRun(ViewedRun):
    """A run, or with `finished` False the part of it that was computed.

    Attributes:
        curve: displacement of the first watched particle from the unloaded equilibrium; `curves`
            by name that of all.
        energies: by name, (m,) pJ at the output times: `kinetic`; `internal`, the work of the
            internal forces, and of that `elastic`, stored since the unloaded equilibrium; the work
            of each load, and `motion`, that of what moves supports and bodies; `contact`, stored,
            and `contact dissipated`; `dissipated` by dashpots and viscosity; `balance`, what work
            and first kinetic energy exceed the others by, the error of the time integration.
        history: by name, (m,), as of a finite-element run: forces on the tissue in µN since the
            unloaded equilibrium, mean displacement of boundaries, position and penetration of
            bodies in µm.
        position: (particles, 2) the unloaded equilibrium, µm; walls first.
        bonds: (b, 2) bonded wall particles. is_wall: (particles,).
        frames: particle fields at a few times.
        wall_time: s, `total`, `relaxation` and `run`.
        counts: `steps`, `force_evaluations`, `list_builds`, `particles`, `particle_steps`.
    """

    curve: DisplacementCurve
    curves: dict[str, DisplacementCurve]
    energies: dict[str, Array]
    history: dict[str, Array]
    position: Array
    bonds: NDArray[np.int64]
    is_wall: NDArray[np.bool_]
    frames: ParticleFrames
    wall_time: dict[str, float]
    counts: dict[str, int]
    threads: int
    finished: bool

    def facts(self) -> Facts:
        return {
            "particles": f"{self.counts['particles']:,}",
            **course(self.curve, self.wall_time, self.counts),
            "finished": "yes" if self.finished else "no",
        }


_COUNTS = ("steps", "force_evaluations", "list_builds")
_WORKS = ("bodies", "motion", "contact dissipated", "dissipated")
"""What `Recorder.record` takes besides the works of loads."""


def columns_of(conditions: Conditions) -> list[str]:
    """What a row of the history holds: vectors by component, then numbers."""
    problem = conditions.problem
    vectors = [f"displacement {name}" for name in problem.watched]
    vectors += [f"mean displacement {name}" for name in problem.acted_boundaries()]
    vectors += [f"force {name}" for name in conditions.acting]
    vectors += [f"position {body.name}" for body in problem.bodies]
    both = [f"{name} {axis}" for name in vectors for axis in "xy"]
    depths = [f"penetration {body.name}" for body in problem.bodies]
    works = [*(label(each) for each in conditions.loads), *_WORKS]
    energies = ["kinetic", "elastic", "contact", *works]
    return [*both, *depths, *(f"energy {name}" for name in energies)]


class Recorder:
    """Takes down what a run finds; its state is replaced as a whole, so no interrupt tears it."""

    def __init__(
        self,
        conditions: Conditions,
        settings: TissueSettings,
        dynamics: TissueDynamics,
        identity: Array,
    ) -> None:
        self._dynamics = dynamics
        self._conditions, problem = conditions, conditions.problem
        self._identity = identity
        self._t = problem.output_times()
        self._frame_times = np.linspace(0.0, problem.duration, settings.frames)
        tissue = dynamics.tissue
        start = tissue.to_particles(tissue.start)
        self._watched = [
            int(np.hypot(*(start - np.array(at)).T).argmin()) for at in problem.watched.values()
        ]
        self._means = [
            (conditions.boundary(name), conditions.lengths(name))
            for name in problem.acted_boundaries()
        ]
        self._created = clock()
        self._state: TissueState

    def begin(self, velocity: Array, rates: Array) -> None:
        """Record the tissue at rest and, with the velocities of `TissueDynamics.start`, t = 0."""
        dynamics = self._dynamics
        relaxed = dynamics.x
        self._started = clock()
        dynamics.counts.clear()
        elastic = dynamics.elastic_energy()
        resting = self._forces(0.0, np.zeros(len(self._conditions.loads)))
        works = np.zeros(len(self._conditions.loads) + len(_WORKS))
        works[-3] = dynamics.start(velocity, rates)
        v = dynamics.v
        state = TissueState(
            relaxed=relaxed,
            x=relaxed,
            v=v,
            listed=dynamics.listed,
            elastic=elastic,
            resting=resting,
            bodies=np.stack([dynamics.bodies.x, dynamics.bodies.v]),
            journal=Journal.of({}),
            identity=self._identity,
            seconds={"relaxation": self._started - self._created},
            counts={},
        )
        rows = {"rows": self._row(0.0, state, works)[None]}
        rows |= frame_series(ParticleFrames(np.zeros(1), 0.0 * relaxed[None], v[None]))
        self._state = self._with_counts(replace(state, journal=Journal.of(rows)))

    def restore(self, state: TissueState) -> None:
        """Continue from where `state` was taken."""
        dynamics = self._dynamics
        dynamics.bodies.x[:], dynamics.bodies.v[:] = state.bodies
        dynamics.place(state.x, state.v, state.listed)
        dynamics.counts = Counter(state.counts)
        self._state = replace(state, journal=state.journal.copy())
        self._started = clock() - state.seconds["run"]

    def record(self, steps: int, works: Array) -> None:
        """Record the next output time, `steps` after the last.

        Args:
            works: (loads + 4,) since then, of the loads, of `acceleration` on bodies, of what moves
                supports and bodies, lost in contact and in the tissue, pJ.
        """
        dynamics, before = self._dynamics, self._state
        dynamics.counts["steps"] += steps
        row, t = before.rows, self._t[before.rows]
        x, v = dynamics.x, dynamics.v
        works = before.journal["rows"][-1, -len(works) :] + works
        journal = before.journal.written({"rows": self._row(t, before, works)[None]})
        if self._frames_due(t) > self._frames_due(self._t[row - 1]):
            frame = ParticleFrames(np.array([t]), (x - before.relaxed)[None], v[None])
            journal = journal.written(frame_series(frame))
        bodies = np.stack([dynamics.bodies.x, dynamics.bodies.v])
        self._state = self._with_counts(
            replace(before, x=x, v=v, listed=dynamics.listed, bodies=bodies, journal=journal)
        )

    @property
    def rows(self) -> int:
        """Output times passed."""
        return self._state.rows

    @property
    def may_be_kept(self) -> bool:
        """Always: what is recorded is replaced as a whole."""
        return True

    def checkpoint(self) -> TissueState:
        """The state at the last output time recorded."""
        return replace(self._state, journal=self._state.journal.copy())

    def _with_counts(self, state: TissueState) -> TissueState:
        counts = {name: self._dynamics.counts[name] for name in _COUNTS}
        seconds = state.seconds | {"run": clock() - self._started}
        return replace(state, counts=counts, seconds=seconds)

    def _row(self, t: float, before: TissueState, works: Array) -> Array:
        """What `columns_of` lists; works: since t = 0, else as of `record`."""
        dynamics, bodies = self._dynamics, self._dynamics.bodies
        u = dynamics.x - before.relaxed
        factors = self._factors(t)
        kinetic = dynamics.kinetic_energy()
        elastic = dynamics.elastic_energy(factors) - before.elastic
        free = bodies.per_mass > 0.0
        kinetic += 0.5 * float(((bodies.v[free] ** 2).sum(axis=1) / bodies.per_mass[free]).sum())
        start = np.array([body.position for body in self._conditions.problem.bodies])
        vectors = [
            u[self._watched],
            np.array([length @ u[i] / length.sum() for i, length in self._means]),
            self._forces(t, factors) - before.resting,
            bodies.x - start.reshape(-1, 2),
        ]
        energies = [kinetic, elastic, bodies.stored.sum(), *works]
        return np.concatenate([*(part.ravel() for part in vectors), bodies.depth, energies])

    def _factors(self, t: float) -> Array:
        """(loads,) amplitudes."""
        return np.array([each.at(t, t)[0] for each in self._conditions.load_amplitudes])

    def _forces(self, t: float, factors: Array) -> Array:
        """(k, 2) resultants on the tissue of supports, loads and bodies at the last forces, µN.

        Supports give what their particles need: M a − forces − loads.
        """
        dynamics = self._dynamics
        needed, pulled = -dynamics.f, dynamics.outline.total.copy()
        for n, factor in enumerate(factors):
            pull = factor * dynamics.loads[n]
            needed -= pull
            pulled[n] += pull.sum(axis=0)
        reactions = []
        for support in self._conditions.supports:
            i, axis = np.divmod(support.unknowns, 2)
            second = support.amplitude.at(t, t)[2] * support.largest
            force = needed[i, axis] + dynamics.mass[i] * second
            reactions.append(np.bincount(axis, force, 2))
        return np.array([*reactions, *pulled, *dynamics.bodies.force])

    def run(self, finished: bool) -> TissueRun:
        """The results so far."""
        state, tissue = self._state, self._dynamics.tissue
        problem = self._conditions.problem
        columns = named_columns(columns_of(self._conditions), state.journal["rows"])
        curves = curves_of(self._t[: state.rows], columns)
        begin = "energy "
        energies = {
            name.removeprefix(begin): columns[name] for name in columns if name.startswith(begin)
        }
        lost = ("kinetic", "elastic", "contact", "contact dissipated", "dissipated")
        signs = {name: -1.0 if name in lost else 1.0 for name in energies}
        balance = np.sum([signs[name] * column for name, column in energies.items()], axis=0)
        energies["balance"] = balance - balance[0]
        internal = energies["elastic"] + energies["dissipated"]
        energies = {"kinetic": energies["kinetic"], "internal": internal, **energies}
        if not any(body.mass is not None for body in problem.bodies):
            del energies["bodies"]
        if not self._conditions.motions:
            del energies["motion"]
        if not problem.bodies:
            del energies["contact"], energies["contact dissipated"]
        return TissueRun(
            curve=next(iter(curves.values())),
            curves=curves,
            energies=energies,
            history=history_of(columns),
            position=state.relaxed,
            bonds=bonded_particles(tissue),
            is_wall=np.arange(tissue.particles) < tissue.wall_particles,
            frames=ParticleFrames(**state.journal.part("frames")),
            wall_time={"total": sum(state.seconds.values()), **state.seconds},
            counts={
                **state.counts,
                "particles": tissue.particles,
                "particle_steps": tissue.particles * state.counts["steps"],
            },
            threads=numba.get_num_threads(),
            finished=finished,
        )

    def _frames_due(self, t: float) -> int:
        return int(np.searchsorted(self._frame_times, t * (1.0 + 1e-12), side="right"))

"""The full microscopic tissue under load, from start to end: `simulate_tissue`.

Time stepping is leapfrog with one force evaluation per step (docs/theory.md, full tissue). It
begins and ends with half a kick where positions and velocities are needed at one time: at every
sample of the energies.

While the tissue relaxes, supports are held and bodies are away. Displacements, forces and energies
count from there. Bodies meet the outline that the problem states: a particle touches one where its
place on that outline, moved by its displacement, does.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, ClassVar, NamedTuple

import numba
import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.clock import clock
from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.plant_cell.arrangement import ReferenceState, make_arrangement
from surrofe2.plant_cell.outlined import Outlined
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.tessellation import centroid
from surrofe2.problem.amplitude import Amplitude
from surrofe2.problem.mesh import extent
from surrofe2.problem.problem import Problem, label
from surrofe2.problem.rigid_bodies import check_outside
from surrofe2.run.journal import (
    Journal,
    RunState,
    check_frames,
    curves_of,
    frame_series,
    history_of,
    named_columns,
    part_of,
)
from surrofe2.run.loop import carry_out
from surrofe2.run.views import Facts, ViewedRun, course
from surrofe2.tissue.conditions import TOUCHING, Conditions
from surrofe2.tissue.dynamics import TissueDynamics, Works
from surrofe2.tissue.layout import make_tissue, middles_of, stretch_of
from surrofe2.tissue.outline import are_within, area_within, outlines
from surrofe2.tissue.relaxation import (
    LONGEST,
    OF_LIMIT,
    outlined_tissue,
    relax,
    rounded_step,
    stable_step,
    stable_step_of,
)
from surrofe2.tissue.settings import TissueSettings

Cells = CellParameters | Sequence[CellParameters]
References = ReferenceState | Sequence[ReferenceState]

DEFAULTS = TissueSettings()
_STATE = 5
"""Version of the contents of a state; a run is not resumed from one of another version."""
_ROUNDING = 1e-12
"""Relative difference up to which two times are the same, but for rounding."""
_ROUNDING_OF_STEPS = 1e-9
"""The same for steps that a user states, and numbers of steps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueState(RunState):
    """A run at an output time: all that is needed to continue it, bit by bit, and its results.

    Attributes:
        relaxed: (particles, 2) positions in the unloaded equilibrium, µm.
        x, v: (particles, 2) positions, µm, and velocities, µm/µs.
        resting: (k, 2) forces on the unloaded tissue, see `Recorder._forces`, µN.
        bodies: (2, b, 2) positions and velocities of rigid bodies.
        journal: ``rows`` (r, c), a row for each output time passed, with the columns of
            `columns_of`; ``frames.…`` as of `ParticleFrames`.
        identity: numbers that a run to be resumed must share.
        seconds, counts: as of `TissueRun`.
    """

    SERIES: ClassVar[tuple[str, ...]] = (
        "rows", "frames.t", "frames.displacement", "frames.velocity"
    )  # fmt: skip

    relaxed: Array
    x: Array
    v: Array
    resting: Array
    bodies: Array
    journal: Journal
    identity: Array
    seconds: dict[str, float]
    counts: dict[str, int]

    @property
    def rows(self) -> int:
        """Number of output times passed."""
        return self.journal.lengths["rows"]


@dataclass(frozen=True, slots=True)
class ParticleFrames:
    """Particle fields at k times.

    t: (k,) µs. displacement: (k, particles, 2) µm. velocity: (k, particles, 2) µm/µs.
    """

    t: Array
    displacement: Array
    velocity: Array


class Particles(NamedTuple):
    """The particles that fields belong to.

    position: (particles, 2) positions in the unloaded equilibrium, µm.
    bonds: (b, 2) bonded wall particles.
    is_wall: (particles,) whether a particle is a wall particle.
    """

    position: Array
    bonds: Index
    is_wall: Flags


KeepFrame = Callable[[ParticleFrames, int, Particles], None]
"""A function that takes particle fields at one time, and the number of frames before it."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class TissueRun(ViewedRun):
    """A run, or with `finished` False the part of it that was computed.

    Attributes:
        curve: displacement of the first watched particle from the unloaded equilibrium.
        curves: displacements of all watched particles by name.
        energies: energies and works at the output times by name, (m,) pJ:

            - `kinetic`;
            - `internal`, the work of the internal forces, and the parts of it: `elastic`, stored
              since the unloaded equilibrium, and `dissipated` by dashpots and viscosity;
            - the work of each load, of `bodies` by their acceleration, and of `motion` by what
              moves supports and bodies;
            - `contact`, stored, and `contact dissipated`;
            - `balance`, works and first kinetic energy less all others: the error of the time
              integration.
        history: other results by name, (m,), as in a finite-element run: forces on the tissue
            since the unloaded equilibrium, µN, mean displacement of boundaries, position and
            penetration of bodies, µm, impulses of bodies on the tissue since t = 0, summed over the
            steps, µN µs.
        position: (particles, 2) positions in the unloaded equilibrium, µm; walls first.
        bonds: (b, 2) bonded wall particles.
        is_wall: (particles,) whether a particle is a wall particle.
        frames: particle fields at a few times; if `keep_frame` took them, their times alone.
        wall_time: `total`, `relaxation` and `run`, s.
        counts: `steps`, `force_evaluations`, `particles`, `particle_steps`.
        threads: number of threads.
    """

    position: Array
    bonds: Index
    is_wall: Flags
    frames: ParticleFrames
    wall_time: dict[str, float]
    counts: dict[str, int]
    threads: int
    finished: bool

    def facts(self) -> Facts:
        """Return what a notebook shows of the run, by name."""
        return {
            "particles": f"{self.counts['particles']:,}",
            **course(self.curve, self.wall_time, self.counts),
            "finished": "yes" if self.finished else "no",
        }


_COUNTS = ("steps", "force_evaluations")
"""Counts that a state keeps."""
_WORKS = ("bodies", "motion", "contact dissipated", "dissipated")
"""Names in results of the entries of `Works` behind those of loads."""
_TAKEN = ("kinetic", "elastic", "contact", "contact dissipated", "dissipated")
"""Energies that take up works, in the balance of a run."""


def columns_of(conditions: Conditions) -> list[str]:
    """Return the names of the columns of the history: vectors by component, then numbers."""
    problem = conditions.problem
    supports = [each.name for each in conditions.supports]
    bodies = [body.name for body in problem.bodies]
    loads = [label(each) for each in conditions.loads]
    vectors = [f"displacement {name}" for name in problem.watched]
    vectors += [f"mean displacement {name}" for name in problem.acted_boundaries()]
    vectors += [f"force {name}" for name in (*supports, *loads, *bodies)]
    vectors += [f"position {name}" for name in bodies]
    both = [f"{name} {axis}" for name in vectors for axis in "xy"]
    energies = ["kinetic", "elastic", "contact", *loads, *_WORKS]
    depths = [f"penetration {name}" for name in bodies]
    impulses = [f"impulse {name} {axis}" for name in bodies for axis in "xy"]
    return [*both, *depths, *(f"energy.{name}" for name in energies), *impulses]


class Recorder:
    """Recorder of a run's results; its state is replaced as a whole, so no interrupt tears it."""

    may_be_kept = True  # a run may be stopped after any record, and resumed

    def __init__(
        self,
        conditions: Conditions,
        settings: TissueSettings,
        dynamics: TissueDynamics,
        keep_frame: KeepFrame | None = None,
    ) -> None:
        self._conditions = conditions
        self._dynamics = dynamics
        self._keep_frame = keep_frame
        self.identity = identity(conditions, settings)
        problem = conditions.problem
        tissue = conditions.tissue
        self._t = problem.output_times()
        frames = np.linspace(0.0, problem.duration, settings.frames)
        # the first output times that are not before the times of frames
        self._frame_rows = np.searchsorted(self._t * (1.0 + _ROUNDING), frames)
        start = tissue.to_particles(tissue.start)
        self._watched = []
        for point in problem.watched.values():
            distance = np.hypot(*(start - point).T)
            self._watched.append(distance.argmin())
        # particles of boundaries and the lengths by which their displacements are averaged
        self._averaged = []
        for name in problem.acted_boundaries():
            self._averaged.append((conditions.boundary(name), conditions.lengths(name)))
        self._created = clock()
        self.state: TissueState

    def begin(self) -> None:
        """Record the tissue at rest and, with its first velocities, t = 0."""
        dynamics = self._dynamics
        conditions = self._conditions
        relaxed = dynamics.x
        self._started = clock()
        # relaxation does not count
        dynamics.counts.clear()
        dynamics.forces()
        resting = self._forces(0.0, np.zeros(len(conditions.loads)))
        rates = []
        for amplitude in conditions.motions:
            _, rate, _ = amplitude.at(0.0, 0.0)
            rates.append(rate)
        work_of_impulse = dynamics.start(conditions.velocity(), np.array(rates))
        self.state = TissueState(
            relaxed=relaxed,
            x=relaxed,
            v=dynamics.v,
            resting=resting,
            bodies=np.stack([dynamics.bodies.x, dynamics.bodies.v]),
            journal=Journal.of({"rows": np.empty((0, len(columns_of(conditions))))}),
            identity=self.identity,
            seconds={"relaxation": self._started - self._created},
            counts={},
        )
        nothing = Works(
            loads=np.zeros(len(conditions.loads)),
            impulses=np.zeros(2 * len(conditions.problem.bodies)),
        )
        self.record(0, nothing._replace(motion=work_of_impulse))

    def restore(self, state: TissueState) -> None:
        """Continue from `state`, a checkpoint of this run."""
        dynamics = self._dynamics
        dynamics.bodies.x[:], dynamics.bodies.v[:] = state.bodies
        dynamics.place(state.x, state.v)
        dynamics.counts = Counter(state.counts)
        self.state = replace(state, journal=state.journal.copy())
        self._started = clock() - state.seconds["run"]

    def record(self, steps: int, works: Works) -> None:
        """Record the next output time.

        steps, works: number of steps and works since the last output time.
        """
        dynamics = self._dynamics
        before = self.state
        dynamics.counts["steps"] += steps
        row = before.rows
        t = self._t[row]
        x = dynamics.x
        v = dynamics.v
        u = x - before.relaxed
        # rows end with the works and impulses since t = 0; the first has none before it
        works_since_last = works.row
        total = before.journal["rows"][-1:, -works_since_last.size :].sum(axis=0)
        total = total + works_since_last
        journal = before.journal.written({"rows": self._row(t, u, total)[None]})
        if row in self._frame_rows:
            frame = ParticleFrames(np.array([t]), u[None], v[None])
            is_taken = self._keep_frame is not None
            if self._keep_frame is not None:
                count = journal.lengths.get("frames.t", 0)
                self._keep_frame(frame, count, self._particles(before.relaxed))
            journal = journal.written(frame_series(frame, times_alone=is_taken))
        self.state = replace(
            before,
            x=x,
            v=v,
            bodies=np.stack([dynamics.bodies.x, dynamics.bodies.v]),
            journal=journal,
            counts={name: dynamics.counts[name] for name in _COUNTS},
            seconds=before.seconds | {"run": clock() - self._started},
        )

    def _particles(self, position: Array) -> Particles:
        """Return the particles, at these positions (particles, 2) in the unloaded equilibrium."""
        tissue = self._dynamics.tissue
        return Particles(position, tissue.bonds(), tissue.is_wall)

    def checkpoint(self) -> TissueState:
        """Return the state at the last output time recorded."""
        return replace(self.state, journal=self.state.journal.copy())

    def _row(self, t: float, u: Array, works: Array) -> Array:
        """Return a row of the history, with the columns of `columns_of`.

        Stored energy is not counted from t = 0 here.

        Args:
            t: time, µs.
            u: (particles, 2) displacements, µm.
            works: (loads + 4 + 2 b,) works and impulses of b bodies since t = 0, see `Works.row`.
        """
        dynamics = self._dynamics
        bodies = self._dynamics.bodies
        conditions = self._conditions
        factors = _values_at(conditions.load_amplitudes, t)
        kinetic = dynamics.kinetic_energy()
        elastic = dynamics.elastic_energy(factors)
        vectors = [*u[self._watched]]
        for particles, length in self._averaged:
            vectors.append(length @ u[particles] / length.sum())
        vectors += [*(self._forces(t, factors) - self.state.resting)]
        start = np.array([body.position for body in conditions.problem.bodies])
        vectors += [*(bodies.x - start.reshape(-1, 2))]
        contact = bodies.stored.sum()
        return np.array([*np.ravel(vectors), *bodies.depth, kinetic, elastic, contact, *works])

    def _forces(self, t: float, factors: Array) -> Array:
        """Return the resultants (k, 2) on the tissue of supports, loads and bodies, µN.

        They are at the last forces that were computed. A support exerts what its particles need
        for their motion, M a − forces − loads.

        Args:
            t: time, µs.
            factors: (loads,) amplitudes at that time.
        """
        dynamics = self._dynamics
        needed = -dynamics.f
        pulled = dynamics.outline.total.copy()
        for n, factor in enumerate(factors):
            pull = factor * dynamics.loads[n]
            needed -= pull
            pulled[n] += pull.sum(axis=0)
        reactions = []
        for support in self._conditions.supports:
            i, axis = np.divmod(support.unknowns, 2)
            _, _, second_derivative = support.amplitude.at(t, t)
            acceleration = second_derivative * support.largest
            force = needed[i, axis] + dynamics.mass[i] * acceleration
            reactions.append(np.bincount(axis, force, 2))
        return np.array([*reactions, *pulled, *dynamics.bodies.force])

    def run(self, finished: bool) -> TissueRun:
        """Return the results so far."""
        state = self.state
        tissue = self._dynamics.tissue
        problem = self._conditions.problem
        columns = named_columns(columns_of(self._conditions), state.journal["rows"])
        curves = curves_of(self._t[: state.rows], columns)
        energies = part_of(columns, "energy")
        energies["elastic"] = energies["elastic"] - energies["elastic"][0]
        signed = [-energy if name in _TAKEN else energy for name, energy in energies.items()]
        balance = np.sum(signed, axis=0)
        energies["balance"] = balance - balance[0]
        internal = energies["elastic"] + energies["dissipated"]
        energies = {"kinetic": energies["kinetic"], "internal": internal, **energies}
        # columns that are always zero are left out of results
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
            **self._particles(state.relaxed)._asdict(),
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


def _values_at(amplitudes: Sequence[Amplitude], t: float) -> Array:
    """Return the values (k,) of amplitudes at time t, µs."""
    values = []
    for amplitude in amplitudes:
        value, _, _ = amplitude.at(t, t)
        values.append(value)
    return np.array(values)


def simulate_tissue(
    problem: Problem,
    cell: Cells,
    settings: TissueSettings = DEFAULTS,
    *,
    reference: References = (),
    kind: Index | None = None,
    outlined: Outlined | None = None,
    progress: Callable[[float, float], None] | None = None,
    checkpoint: Callable[[TissueState], None] | None = None,
    checkpoint_interval: float = 30.0,
    resume: TissueState | None = None,
    keep_frame: KeepFrame | None = None,
) -> TissueRun:
    """Simulate the motion of all particles of a tissue, which is first relaxed without load.

    Args:
        problem: mesh, loads and supports. The mesh counts as its outline alone; a rectangle of
            square cells must hold whole cells. A boundary is the wall particles on its sides, a
            region the plant cells whose middles it holds, a watched point the nearest particle.
        cell: the plant cell that the tissue is made of, or several of one size and arrangement.
        reference: reference state of the cell, as the RVE law of the same cell has it, or several.
        kind: (columns, rows, cells) number of the type of each plant cell of each RVE, −1 where
            there is none, see `plant_cells_within`; (columns, rows) with one cell per RVE.
        outlined: walls along the outlines of an image, instead of `kind`; the tissue has the plant
            cells whose middles the mesh holds. Its `reference` is computed where there is none.
        progress: called with (t, duration) in µs at every output time.
        checkpoint: called at output times with the state of the run when `checkpoint_interval`
            seconds have passed since the last call, and upon an interrupt, before it takes effect.
        resume: a state that `checkpoint` got from a run of the same tissue, load and step; the
            results are those of the uninterrupted run, bit by bit.
        keep_frame: called with particle fields at each of their times. Results and states of
            checkpoints then have their times alone.

    Raises:
        InputError: the cells do not fill the mesh, the problem contradicts itself, or the step
            is longer than the stable one.
        SimulationError: the tissue collapses, or the step is too long for it; `partial` is the
            `TissueRun` up to there (None before the loaded run begins).
        MismatchError: `resume` is of another run, or of one with `keep_frame` while there is none
            now; `reference` is of another cell.
    """
    if outlined is None:
        conditions = make_conditions(problem, cell, reference, kind)
    else:
        conditions = outlined_conditions(problem, cell, outlined, reference)
    settings = with_step(settings, conditions)
    problem.check_course()
    dynamics = held_and_loaded(conditions, settings)
    recorder = Recorder(conditions, settings, dynamics, keep_frame)
    if resume is None:
        if progress is not None:
            progress(0.0, problem.duration)
        meet_bodies(dynamics, conditions, relax(dynamics, settings.residual))
        recorder.begin()
    elif np.array_equal(resume.identity, recorder.identity):
        check_frames(resume.journal, are_taken=keep_frame is not None)
        meet_bodies(dynamics, conditions, resume.relaxed)
        recorder.restore(resume)
    else:
        raise MismatchError(
            "resume: cells, load, step or output times are not those of the checkpoint; start a "
            "new run"
        )

    def steps() -> Iterator[float]:
        """Move from one output time to the next, record it, and yield it."""
        # from the last output time that was recorded
        for start, end in pairwise(problem.output_times().tolist()[recorder.state.rows - 1 :]):
            recorder.record(*advance(dynamics, conditions, settings, start, end))
            yield end

    try:
        return carry_out(
            steps(), recorder, recorder.run, problem.duration,
            progress=progress, checkpoint=checkpoint, interval=checkpoint_interval,
        )  # fmt: skip
    except SimulationError as error:
        step = settings.micro_step or 0.0
        limit = step_at_rest(conditions)
        remedy = "lower the load, or the step"
        default = rounded_step(limit)
        if step > default:
            remedy = f"the step is too long; leave it out or take {default:g}"
        message = (
            f"{error}; tissue.micro_step is {step:.3g} µs, at rest this cell bears "
            f"{limit:.3g} µs: {remedy}"
        )
        raise SimulationError(message, partial=error.partial) from error


def make_conditions(
    problem: Problem, cell: Cells, reference: References, kind: Index | None = None
) -> Conditions:
    """Make the conditions of a problem on the particles of its tissue.

    Arguments and errors are those of `simulate_tissue`.
    """
    types = [cell] if isinstance(cell, CellParameters) else cell
    references = [reference] if isinstance(reference, ReferenceState) else reference
    origin, inside = plant_cells_within(problem, types[0], references[0])
    kind = np.where(inside, 0, -1) if kind is None else kind.reshape(*kind.shape[:2], -1)
    if kind.shape != inside.shape or not np.array_equal(kind >= 0, inside):
        raise InputError(
            f"tissue: kinds {kind.shape}; it has {inside.sum()} plant cells in {inside.shape[0]} × "
            f"{inside.shape[1]} RVEs of {inside.shape[2]}, and −1 must stand for all others"
        )
    if kind.max() >= len(types):
        raise InputError(f"tissue: kinds up to {kind.max()}; there are {len(types)} types of cells")
    tissue = make_tissue(types, references, kind, origin.tolist())
    return _with_bodies_outside(Conditions(problem, tissue))


def outlined_conditions(
    problem: Problem, cell: Cells, outlined: Outlined, reference: References = ()
) -> Conditions:
    """Make the conditions of a problem on the particles of a tissue with the outlines of an image.

    The tissue has the plant cells whose middles the mesh holds.

    Args:
        reference: reference state of such a tissue; none: it is computed.

    Raises:
        InputError: there are several types of plant cells, or the cells' area is not the mesh's.
    """
    types = [cell] if isinstance(cell, CellParameters) else cell
    if len(types) > 1:
        raise InputError(f"image: {len(types)} types of cells; the outlines of an image take one")
    if not types[0].has_uniform_fluid:
        raise InputError("image: cell.fluid is sph; the outlines of an image take uniform")
    tessellation = outlined.arrangement.tessellation
    rings = outlines(problem.mesh)
    middles = [centroid(tessellation.corners(k)) for k in range(len(tessellation.polygons))]
    within = are_within(np.array(middles), rings)
    inside = outlined.is_cell & within
    # enclosed air; the outside is on the left of a clockwise way, whose area is negative
    spaces = ~outlined.is_cell & within & (tessellation.areas > 0.0)
    width, height = 0.5 * tessellation.lattice.diagonal()
    _check_filled(
        "mesh",
        area_within(rings),
        int(inside.sum()),
        float(tessellation.areas[inside | spaces].sum()),
        f"the image is {width:.6g} × {height:.6g} µm, from (0, 0); take a mesh that its cells fill",
    )
    kind = np.where(inside, 0, -1)[None, None]
    references = [reference] if isinstance(reference, ReferenceState) else reference
    known = references[0] if references else None
    tissue = outlined_tissue(types[0], kind, outlined.arrangement, known)
    return _with_bodies_outside(Conditions(problem, tissue))


def _with_bodies_outside(conditions: Conditions) -> Conditions:
    """Return the conditions; raise InputError if a body begins within the tissue."""
    for body in conditions.problem.bodies:
        points = conditions.outline_places[conditions.boundary(body.on)]
        allowed = TOUCHING * conditions.tissue.cell.cell_side
        check_outside(body.name, body.shape, np.array(body.position), points, allowed)
    return conditions


def step_at_rest(conditions: Conditions) -> float:
    """Return the longest stable step at rest of all types of plant cells, with outer forces, µs."""
    tissue = conditions.tissue
    outside = conditions.stiffest()
    if tissue.arrangement.wall_of_bond is not None:
        # plant cells along the outlines of an image are all different
        return stable_step_of(tissue, outside)
    types = zip(tissue.types, tissue.references, strict=True)
    return min(stable_step(cell, reference, outside) for cell, reference in types)


def step_note(settings: TissueSettings, conditions: Conditions) -> str:
    """Return a note on the step that undrained sap requires, and on the step without it.

    Args:
        settings: settings with a step, as `with_step` returns them.
    """
    tissue = conditions.tissue
    outside = conditions.stiffest()
    modulus = max(cell.sap_bulk_modulus for cell in tissue.types)
    if tissue.arrangement.wall_of_bond is not None:
        constants = tuple(each._replace(sap_modulus=0.0) for each in tissue.constants)
        drained = [stable_step_of(replace(tissue, constants=constants), outside)]
        return _step_sentence(settings, modulus, step_at_rest(conditions), drained)
    drained = []
    for cell, reference in zip(tissue.types, tissue.references, strict=True):
        # the reference is the same: at rest the sap is neither compressed nor expanded
        drained_cell = replace(cell, sap_bulk_modulus=0.0)
        same = replace(reference, fingerprint=drained_cell.fingerprint)
        drained.append(stable_step(drained_cell, same, outside))
    return _step_sentence(settings, modulus, step_at_rest(conditions), drained)


def _step_sentence(
    settings: TissueSettings, modulus: float, limit: float, drained: Sequence[float]
) -> str:
    """Return the note of `step_note`.

    Args:
        modulus: bulk modulus of the sap, MPa.
        limit: longest stable step with it, µs.
        drained: longest stable steps of each type without it, µs.
    """
    return (
        f"tissue.micro_step: {settings.micro_step:.3g} µs; undrained sap (sap_bulk_modulus "
        f"{modulus:g} MPa) bears {limit:.3g} µs at rest, drained sap would bear "
        f"{min(drained):.3g} µs"
    )


def with_step(settings: TissueSettings, conditions: Conditions) -> TissueSettings:
    """Return the settings with a stable step where they state none.

    Raises:
        InputError: they state a step too close to the limit of stability at rest. With a longer one
            motion could grow without bound, and without an error.
    """
    limit = step_at_rest(conditions)
    step = settings.micro_step
    longest = OF_LIMIT * limit
    default = rounded_step(limit)
    if step is None:
        return replace(settings, micro_step=default)
    if step > longest * (1.0 + _ROUNDING_OF_STEPS):
        raise InputError(
            f"tissue.micro_step: {step:.4g} µs; at most {longest:.4g}, as the limit of stability "
            f"at rest is {limit:.4g} µs with all that acts; leave it out or take {default:g}"
        )
    return settings


def plant_cells_within(
    problem: Problem, cell: CellParameters, reference: ReferenceState, section: str = "mesh"
) -> tuple[Index, Flags]:
    """Return the plant cells at rest whose middles a mesh holds.

    Args:
        section: section of the recipe that states the extent, for messages.

    Returns:
        Column and row of the first RVE (2,), and (columns, rows, cells) whether each plant cell
        from there on is within the mesh.

    Raises:
        InputError: square cells do not fill a rectangle, the cells' area is not the mesh's, or a
            condition acts on a node of the mesh, which a tissue has not.
    """
    for place in problem.acted_nodes():
        raise InputError(
            f"conditions: one acts {place}, on a node of the mesh; a tissue of particles takes "
            "boundaries and regions alone"
        )
    mesh = problem.mesh
    low, high = extent(problem.mesh)
    rings = outlines(mesh)
    if cell.arrangement == "square" and _is_rectangle(rings, high):
        _check_whole_squares(high, cell, section)
    # RVEs that may have plant cells within the mesh: those around the corners of its extent
    lattice = reference.lattice
    corners = np.array([(x, y) for x in (low[0], high[0]) for y in (low[1], high[1])])
    in_periods = np.linalg.solve(lattice, corners.T)
    first = np.floor(in_periods.min(axis=1)).astype(np.int64) - _MARGIN
    periods = np.ceil(in_periods.max(axis=1)).astype(np.int64) + _MARGIN - first
    arrangement = make_arrangement(cell)
    middles = middles_of(arrangement, reference, first, periods.tolist())
    middles = middles + _ASIDE * cell.cell_side
    inside = are_within(middles.reshape(-1, 2), rings).reshape(middles.shape[:3])
    area = area_within(rings)
    areas = arrangement.tessellation.areas
    filled = float((inside * areas).sum() * np.linalg.det(stretch_of(arrangement, lattice)))
    sides = f"{lattice[0, 0]:.6g} × {lattice[1, 1]:.6g} µm"
    hint = f"take sides of whole RVEs, {sides}, or a larger tissue"
    _check_filled(section, area, int(inside.sum()), filled, hint)
    # without the columns and rows around that have none
    has_cells = np.asarray(inside.any(axis=2))
    columns = np.flatnonzero(has_cells.any(axis=1))
    rows = np.flatnonzero(has_cells.any(axis=0))
    inside = inside[columns[0] : columns[-1] + 1, rows[0] : rows[-1] + 1]
    return first + np.array([columns[0], rows[0]]), inside


def _check_filled(section: str, area: float, count: int, filled: float, hint: str) -> None:
    """Raise InputError unless the plant cells have nearly the area of the mesh.

    Args:
        area: area of the mesh, µm².
        count, filled: number of the plant cells, and their area, µm².
        hint: end of the message, which says what to do.
    """
    if abs(filled - area) > _MOST_OFF * area:
        raise InputError(
            f"{section}: its {area:.6g} µm² hold the middles of {count} plant cells of "
            f"{filled:.6g} µm²; both areas may differ by {100 * _MOST_OFF:g} %: {hint}"
        )


_MARGIN = 2
"""RVEs around the extent of a mesh that may have plant cells within."""
_ASIDE = np.array([1e-7, 0.7e-7])
"""Shift of middles, in sides of a plant cell, so that none lies exactly on a side of a mesh. Its
components differ for the sake of diagonal sides."""
_MOST_OFF = 0.02
"""Relative difference by which the area of plant cells may differ from that of the mesh."""
_LEVEL = 1e-9
"""Relative difference up to which two lengths or areas are the same, but for rounding."""


def _is_rectangle(rings: list[Array], high: Array) -> bool:
    """Return whether the outline is that of [0, width] × [0, height]; high: (2,) these two."""
    slack = _LEVEL * high.max()
    is_within = all((ring > -slack).all() and (ring < high + slack).all() for ring in rings)
    return is_within and abs(area_within(rings) - high.prod()) < _LEVEL * high.prod()


def _check_whole_squares(high: Array, cell: CellParameters, section: str) -> None:
    """Raise InputError unless width and height (2,) are whole numbers of plant cells."""
    for name, length in zip(("width", "height"), high.tolist(), strict=True):
        count = round(length / cell.cell_side)
        if count < 1 or abs(count * cell.cell_side - length) > _LEVEL * length:
            few = int(length / cell.cell_side)
            near = " or ".join(f"{k * cell.cell_side:g}" for k in (few, few + 1) if k)
            hint = ": change it or give --cells N M" if section == "load" else f": take {near}"
            raise InputError(
                f"{section}.{name}: {length:g}; a tissue needs a whole number of plant cells of "
                f"{cell.cell_side:g} µm{hint}"
            )


def held_and_loaded(conditions: Conditions, settings: TissueSettings) -> TissueDynamics:
    """Make the dynamics of a tissue in its repeated reference, with supports and dead loads.

    Bodies, follower pressures and foundations come with `meet_bodies`, once it has relaxed.
    """
    return TissueDynamics(
        conditions.tissue,
        skin=settings.skin,
        held=conditions.held,
        loads=conditions.dead_loads(),
        driven=conditions.driven(),
    )


def meet_bodies(dynamics: TissueDynamics, conditions: Conditions, relaxed: Array) -> None:
    """Add bodies, follower pressures and foundations to the dynamics.

    relaxed: (particles, 2) positions at rest without load, µm.
    """
    offset = conditions.outline_places - relaxed
    dynamics.bodies = conditions.bodies(offset)
    dynamics.outline = conditions.outline(relaxed, offset)


def advance(
    dynamics: TissueDynamics,
    conditions: Conditions,
    settings: TissueSettings,
    start: float,
    end: float,
) -> tuple[int, Works]:
    """Move from t = start to end, µs; return the number of steps, and the works.

    Works are summed over the steps; the dissipated power is integrated by the trapezoidal rule over
    samples. Both are of second order in the step.
    """
    longest = settings.micro_step or LONGEST
    fewest_steps = int(np.ceil((end - start) / longest * (1.0 - _ROUNDING_OF_STEPS)))
    # samples of equal numbers of steps; −(−a // b) rounds up
    samples = -(-fewest_steps // settings.energy_steps)
    count = -(-fewest_steps // samples)
    length = (end - start) / samples
    step = length / count
    # a sample begins and ends with half a kick, and the last kick has no drift behind it
    kicks = np.full(count + 1, step)
    drifts = np.full(count + 1, step)
    kicks[[0, -1]] *= 0.5
    drifts[-1] = 0.0
    motions = conditions.motions
    dynamics.take_works()
    dissipated = 0.0
    rate = dynamics.dissipation_rate()
    for k in range(samples):
        times = start + k * length + step * np.arange(count + 1)
        amplitudes = np.array([_values_at(conditions.load_amplitudes, t) for t in times])
        values = np.array([_values_at(motions, t) for t in times])
        # Each drift ends where the motion leads; the last kick, without a drift, at its rate.
        last_rates = []
        for amplitude in motions:
            _, last_rate, _ = amplitude.at(times[-1], times[-1])
            last_rates.append(last_rate)
        speeds = np.concatenate([np.diff(values, axis=0) / step, [last_rates]])
        dynamics.leap(kicks, drifts, amplitudes, speeds)
        rate_before = rate
        rate = dynamics.dissipation_rate()
        dissipated += 0.5 * length * (rate_before + rate)
    works = dynamics.take_works()._replace(dissipated=dissipated)
    if not np.isfinite(works.row).all():
        raise SimulationError("tissue: the motion is not finite")
    return samples * count, works


def identity(conditions: Conditions, settings: TissueSettings) -> Array:
    """Return numbers that two runs share if one may continue where the other stopped.

    They are the bytes of a digest of all that decides a run.
    """
    problem = conditions.problem
    tissue = conditions.tissue
    outputs = problem.output_interval, *(problem.times or ())
    stated = problem.conditions, problem.bodies, problem.duration, *outputs
    watched = [*problem.watched.items()]
    digest = hashlib.sha256(repr((_STATE, stated, watched, tissue.constants, settings)).encode())
    arrays: list[Any] = [tissue.mass, tissue.kind, tissue.start]
    arrays += [conditions.boundary(name) for name in problem.acted_boundaries()]
    arrays += [conditions.held, conditions.dead_loads(), conditions.velocity()]
    for array in arrays:
        digest.update(array.tobytes())
    return np.array(list(digest.digest()), dtype=np.float64)

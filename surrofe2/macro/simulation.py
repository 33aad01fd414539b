"""A macro run from start to end: `simulate`, and its result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numba
import numpy as np
import skfem

from surrofe2.base.arrays import Array, Index
from surrofe2.base.clock import clock
from surrofe2.base.compilation import one_blas_thread
from surrofe2.base.errors import MismatchError, SimulationError
from surrofe2.base.units import LENGTH, NONE, RATE, STRESS, TIME, VELOCITY
from surrofe2.law.stress_law import StressLaw
from surrofe2.macro.elements import displacement_basis
from surrofe2.macro.equations_of_motion import EquationsOfMotion, NoStress, Switched
from surrofe2.macro.generalised_alpha import GeneralisedAlpha
from surrofe2.macro.history import (
    NOTHING,
    Frames,
    KeepFrame,
    MacroState,
    MetRange,
    Recorder,
    columns_of,
)
from surrofe2.macro.rest import begin_at_rest
from surrofe2.macro.settings import SECTION_6_2, MacroSettings
from surrofe2.macro.system import System, system_of
from surrofe2.macro.time_stepping import DormandPrince, Method, Stepper
from surrofe2.problem.problem import Problem
from surrofe2.run.journal import check_frames, curves_of, history_of, named_columns
from surrofe2.run.loop import Progress, carry_out
from surrofe2.run.views import Facts, ViewedRun, course


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class MacroRun(ViewedRun):
    """A run, or with `finished` False the part of it that was computed.

    Attributes:
        curve: displacement of the first watched point at the output times.
        curves: displacements of all watched points by name.
        energies: by name, (m,) arrays in pJ at the output times:

            kinetic: kinetic energy.
            internal, and names of conditions: work of the internal and of all other forces since
                t = 0, integrated along with the equations of motion by the same method.
            elastic: internal − dissipated.
            motion: work of prescribed motion.
            surface: work of the surface tension of free sides.
            contact: energy stored in contact.
            contact dissipated: what its dashpots and friction took. Both together are minus the
                work of bodies.
            numerical: what the method and its interpolation dissipated, the work of inertia M ü −
                gain of kinetic energy.
            balance: all other works − gain of kinetic energy − internal − numerical, zero to
                rounding or Newton's tolerance.
            dissipated: work of the stress in excess of σ(F, 0), by the trapezoidal rule from
                samples at the ends of steps (second order), NaN where not recorded; by region
                ``dissipated NAME``, by boundary with a surface law ``dissipated surface NAME``.
        history: by name, (m,) arrays at the output times: mean displacement of boundaries (µm),
            forces of supports, surface loads and bodies on the tissue (µN), positions and
            penetration of bodies (µm), impulses of bodies on the tissue since t = 0 (µN µs). Forces
            are linear between ends of steps, impulses are integrated along the steps.
        nodes: (n_nodes, 2) reference positions, µm.
        elements: (n_el, 4 or 6) nodes of each element.
        rest: (n_nodes, 2) displacement of a tissue with free sides when it comes to rest before the
            run, from which all others count, µm; (0, 2) without.
        frames: whole fields at a few times; of those that `keep_frame` took the times alone.
        met: extremes of deformation and rate.
        largest_displacement: largest displacement of any node at the end of a step, µm.
        wall_time: seconds, `total`, `law` (inside the stress law) and `macro` (the rest); and
            `cpu`, of all threads of this process.
        counts: `steps` accepted that stand, on the way to them `rejected_steps` as too inaccurate,
            `failed_trials` without stress or turned back by the law, `right_hand_sides`,
            `stress_calls` and `stress_points` of those, `dissipation_points` and
            `dissipation_failures` of the calls for σ(F, 0), which come on top.
        effort: sums of what the law's answers cost, those for dissipation included.
        rolled_back: the same counts and sums, over what an audited law took back.
        cache: report of an audited law on this run, as of its end; None of other laws.
        decisions: decisions of an audited law on windows of steps of this run; None of other laws.
        threads: number that numba could use.
        finished: whether the end of the problem was reached.
        problem, law, settings: arguments of the call of `simulate`.
    """

    nodes: Array
    elements: Index
    rest: Array
    frames: Frames
    met: MetRange
    largest_displacement: float
    wall_time: dict[str, float]
    counts: dict[str, int]
    effort: dict[str, int]
    rolled_back: dict[str, int]
    threads: int
    finished: bool
    problem: Problem
    law: StressLaw
    settings: MacroSettings
    cache: Mapping[str, Any] | None = None
    decisions: Sequence[Mapping[str, Any]] | None = None

    def facts(self) -> Facts:
        """Return what a notebook shows of the run."""
        remark = self.settings.remark(self.largest_displacement)
        return {
            "law": self.law,
            "mesh": f"{len(self.elements)} elements, {len(self.nodes)} nodes",
            **course(self.curve, self.wall_time, self.counts),
            "finished": "yes" if self.finished else "no",
            **({"remark": remark} if remark else {}),
        }

    def fields_over_time(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the whole fields and their coordinates, as xarray takes them."""
        frames = self.frames
        entries = dict[str, Any]()
        for name, place, values, unit in (
            ("displacement", "node", frames.displacement, LENGTH),
            ("velocity", "node", frames.velocity, VELOCITY),
            ("stress", "element", frames.stress, STRESS),
            ("F", "element", frames.F, NONE),
            ("F_dot", "element", frames.F_dot, RATE),
        ):
            axes = ("axis",) if values.ndim == 3 else ("row", "column")
            entries[f"field {name}"] = ("frame", place, *axes), values, {"units": unit}
        entries["elements"] = ("element", "corner"), self.elements
        where = {
            "frame": ("frame", frames.t[: len(frames.displacement)], {"units": TIME}),
            "position": (("node", "axis"), self.nodes, {"units": LENGTH}),
        }
        return entries, where

    @property
    def basis(self) -> skfem.Basis:
        """scikit-fem's basis of displacements, made at every access."""
        return displacement_basis(self.problem.mesh)

    def displacement(self, frame: int = -1) -> Array:
        """Return the displacement of a frame as a nodal vector (2 n_nodes,) of `basis`, µm.

        Examples:
            The strain that scikit-fem computes from it, by component, element and quadrature point:

            >>> from skfem.helpers import sym_grad
            >>> from surrofe2 import LoadCase, RveLaw, simulate
            >>> run = simulate(LoadCase(elements=(2, 2), duration=5.0), RveLaw("apple"))
            >>> strain = sym_grad(run.basis.interpolate(run.displacement()))
            >>> strain.shape
            (2, 2, 4, 9)
        """
        return self.frames.displacement[frame].ravel()

    def __repr__(self) -> str:
        end = "finished" if self.finished else "unfinished"
        return (
            f"<MacroRun: {len(self.elements)} elements, {self.counts['steps']} steps in "
            f"{self.wall_time['total']:.3g} s, {end}; {self.curve!r}>"
        )


def simulate(
    problem: Problem,
    law: StressLaw,
    settings: MacroSettings = SECTION_6_2,
    *,
    system: System | None = None,
    progress: Progress = None,
    checkpoint: Callable[[MacroState], None] | None = None,
    checkpoint_interval: float = 30.0,
    resume: MacroState | None = None,
    closing: Callable[[int, int], None] | None = None,
    keep_frame: KeepFrame | None = None,
) -> MacroRun:
    """Compute the motion of a tissue under all that acts on it (sections 4 and 6.2).

    M ü = forces − ∫ σ ∇N dv, the stress by selective reduced integration, in time by
    Dormand–Prince 5(4) or, with `settings.integrator` "implicit", by generalised-α, for which the
    law must give tangents. The law is called for all points at once; a step with a point that has
    no stress, or whose end the law does not accept, is tried again at half the length.

    Args:
        problem: the tissue and what acts on it.
        law: any stress law; its density times the area is the mass.
        settings: tolerances, and what is recorded.
        system: of this problem and law, where runs share one (`System.under`); None: it is made.
        progress: called with (t, duration) in µs after every step; True: a line of the standard
            error shows it.
        checkpoint: called with the state of the run every `checkpoint_interval` seconds, less often
            where that takes long, and upon an interrupt, which then continues; but not in a step
            that the law has been asked to commit, of which it may have recorded a part.
        checkpoint_interval: s.
        resume: a state that `checkpoint` was given, of the same problem and density. The results
            are those of the uninterrupted run to the bit where the law resumes from
            `MacroState.law_state`, or has no state; else it starts cold.
        closing: called with how many answers the closing audit of an audited law has compared, and
            of how many, after each batch at the end of the run.
        keep_frame: takes whole fields as they come, which are then neither in the results nor in
            the states of checkpoints, except for their times.

    Raises:
        InputError: `checkpoint_interval` is negative, the problem names what its mesh has not, or
            the integrator is "implicit" and the law has no tangents.
        SimulationError: ten halvings in a row found no acceptable step, or the error asks for
            steps below rounding; `partial` is the `MacroRun` up to there (None if the law fails
            already where the run starts).
        MismatchError: `resume` is of another run, or of one that gave its fields to `keep_frame`,
            and there is none now.

    Examples:
        A piece of apple flesh, clamped on the left, swings under a load that comes at once:

        >>> from surrofe2 import BodyForce, Fixed, Problem, RveLaw, rectangle, simulate
        >>> load = BodyForce(name="load", acceleration=(0.0, -0.01))  # µm/µs²
        >>> bar = Problem(
        ...     mesh=rectangle(2000.0, 1000.0, (2, 1)),
        ...     conditions=(Fixed(on="left"), load),
        ...     duration=50.0,
        ...     watched={"tip": (2000.0, 500.0)},
        ... )
        >>> run = simulate(bar, RveLaw("apple"))
        >>> print(f"{run.curve.displacement[-1, 1]:.1f} µm")  # of the first watched point
        -13.3 µm
        >>> sorted(run.energies)
        ['balance', 'dissipated', 'elastic', 'internal', 'kinetic', 'load', 'numerical']
    """
    inputs = (problem, law, settings)
    system = system or system_of(problem, law)
    for contact in system.contacts:
        contact.check_start()
    if resume is not None:
        _check_same_run(resume, system, settings)
        check_frames(resume.journal, are_taken=keep_frame is not None)
    begin = clock()
    equations = EquationsOfMotion(system, law, t=0.0 if resume is None else resume.t)
    if problem.surface is not None:
        with one_blas_thread():
            begin_at_rest(equations, problem, settings, resume)
        system = equations.system
    recorder = Recorder(equations, settings, resume, begin, keep_frame)
    # BLAS only adds up vectors here; its threads would take cores from those of the law.
    with one_blas_thread():
        stepper = _make_stepper(equations, settings, recorder, resume)
        return carry_out(
            _steps(stepper, equations, settings, recorder, resume, closing),
            recorder,
            lambda finished: _make_run(system, recorder, inputs, finished),
            problem.duration,
            progress=progress,
            checkpoint=checkpoint,
            interval=checkpoint_interval,
        )


def _steps(
    stepper: Stepper,
    equations: EquationsOfMotion,
    settings: MacroSettings,
    recorder: Recorder,
    resume: MacroState | None,
    closing: Callable[[int, int], None] | None,
) -> Iterator[float]:
    """Make steps to the end of the run, some of them again where an audited law says so, and at the
    end the batches of its closing audit.
    """
    recorder.watch(resume)
    equations.is_committing = False
    while stepper.now.t < recorder.end:
        failure = None
        try:
            recorder.record(stepper.advance(), stepper)
        except SimulationError as error:  # wrong answers of a surrogate may have led there
            failure = error
        back = recorder.settle(final=failure is not None or stepper.now.t >= recorder.end)
        if back is not None:
            equations.go_to(back.t)
            stepper = _make_stepper(equations, settings, recorder, back)
        elif failure is not None:
            raise failure
        yield stepper.now.t
    while recorder.close(closing):
        yield stepper.now.t


def make_method(equations: EquationsOfMotion, settings: MacroSettings) -> Method:
    """Make the time integration that `settings` ask for."""
    if settings.integrator == "implicit":
        return GeneralisedAlpha(equations, settings)
    tolerances = (settings.absolute_tolerance, settings.relative_tolerance)
    # with contact, steps must also keep energy
    mass = equations.system.free_mass if equations.system.contacts else None
    return DormandPrince(equations.evaluate, *tolerances, mass)


def _make_stepper(
    equations: EquationsOfMotion,
    settings: MacroSettings,
    recorder: Recorder,
    resume: MacroState | None,
) -> Stepper:
    """Make a stepper at t = 0, which is recorded, or at the state to resume from.

    Raises:
        SimulationError: the law has no stress at the start.
    """
    method = make_method(equations, settings)
    tally = equations.tally
    end = recorder.end
    if resume is None:
        y, work = equations.system.start(equations.within)
        try:
            start = equations.begin(0.0, y)
        except (NoStress, Switched) as failure:
            raise SimulationError(f"the run cannot start: {failure}") from failure
        stepper = Stepper(equations, method, settings, end, start)
        recorder.begin(stepper, work)
        return stepper
    tally.counts = Counter(resume.counts)
    tally.effort = Counter(resume.effort)
    tally.law_seconds = resume.wall_time["law"]
    start = equations.resume(resume.t, resume.y, resume.stress, resume.law_state, resume.drags)
    return Stepper(equations, method, settings, end, start, resume.next_step, resume.memory)


def _make_run(
    system: System,
    recorder: Recorder,
    inputs: tuple[Problem, StressLaw, MacroSettings],
    finished: bool,
) -> MacroRun:
    """Make the result of a run from what was recorded; `inputs` are those of `simulate`."""
    report = recorder.report(finished=finished)
    state = recorder.state()
    problem, law, settings = inputs
    columns = named_columns(columns_of(system, in_time=True), state.journal["rows"])
    t = columns["t"]
    kinetic = columns["kinetic"]
    internal = columns["work internal"]
    curves = curves_of(t, columns)
    samples = state.journal["samples"]
    works = {
        name.removeprefix("work "): column
        for name, column in columns.items()
        if name.startswith("work ") and (name != "work motion" or system.moving)
    }
    works.pop("internal")
    inertia = works.pop("inertia")
    contact = {}
    if system.contacts:
        work_of_contacts = sum(works[body.name] for body in system.contacts)
        stored = columns["contact"]
        contact = {"contact": stored, "contact dissipated": -work_of_contacts - stored}
    dissipated = {}
    for k, name in enumerate(system.dissipating, 1):  # the first column is the time
        # the whole tissue has the empty name
        dissipated[f"dissipated {name}".strip()] = _dissipated(t, samples[:, [0, k]])
    return MacroRun(
        curve=next(iter(curves.values())),
        energies={
            "kinetic": kinetic,
            "internal": internal,
            "elastic": internal - dissipated["dissipated"],
            **works,
            **contact,
            **dissipated,
            "numerical": inertia - inertia[0] - kinetic + kinetic[0],
            "balance": sum(works.values()) - internal - inertia,
        },
        curves=curves,
        history=history_of(columns),
        nodes=system.discretisation.nodes,
        elements=system.discretisation.elements,
        rest=state.rest[: len(system.discretisation.nodes)],
        frames=state.frames,
        met=MetRange.of(state.extremes),
        largest_displacement=state.largest_displacement,
        wall_time=state.wall_time,
        counts=state.counts,
        effort=state.effort,
        rolled_back=state.rolled_back,
        threads=numba.get_num_threads(),
        finished=finished,
        problem=problem,
        law=law,
        settings=settings,
        cache=report.cache,
        decisions=report.decisions,
    )


def _dissipated(t: Array, samples: Array) -> Array:
    """Integrate a rate of dissipation up to the output times, (r,) pJ.

    The rate is linear between samples, as it is for fields. Behind the last sample, and without
    any, the energy is NaN, except at t = 0.

    Args:
        samples: (s, 2) time and rate, µs and pJ/µs.
    """
    if not len(samples):
        return np.where(t == 0.0, 0.0, np.nan)
    sampled, rate = samples.T
    times = np.union1d(sampled, t[t <= sampled[-1]])
    rates = np.interp(times, sampled, rate)
    energy = np.cumsum(0.5 * np.diff(times) * (rates[1:] + rates[:-1]))
    return np.interp(t, times, np.append(0.0, energy), right=np.nan)


def _check_same_run(state: MacroState, system: System, settings: MacroSettings) -> None:
    """Check that a state to resume from is of this problem and integrator.

    At a corner of an amplitude every method begins again, so there the integrator may change.

    Raises:
        MismatchError: naming the part that differs.
    """
    begun = "implicit" if state.memory.size else "explicit"
    corner = state.t in system.problem.corners()
    if state.t > 0.0 and begun != settings.integrator and not corner:
        raise MismatchError(
            f"resume: macro.integrator: {settings.integrator}; the checkpoint is of an {begun} "
            "run: resume with that or start over"
        )
    now = system.identity()
    for name in state.identity | now:
        if not np.array_equal(state.identity.get(name, NOTHING), now.get(name, NOTHING)):
            raise MismatchError(f"resume: {name}: not that of the checkpoint; start over")

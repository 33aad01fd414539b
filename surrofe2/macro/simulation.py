"""A macro run from start to end: `simulate`, and what it hands back."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from time import monotonic

import numba
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from surrofe2.displacement_curve import DisplacementCurve
from surrofe2.errors import InputError, MismatchError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.macro.discretisation import Discretisation, make_discretisation
from surrofe2.macro.dormand_prince import DormandPrince
from surrofe2.macro.equations_of_motion import EquationsOfMotion
from surrofe2.macro.generalised_alpha import GeneralisedAlpha
from surrofe2.macro.history import Frames, MacroState, MetRange, Recorder
from surrofe2.macro.settings import SECTION_6_2, MacroSettings
from surrofe2.macro.time_stepping import Method, Stepper
from surrofe2.stress_law import StressLaw

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MacroRun:
    """A run, or with `finished` False the part of it that was computed.

    Attributes:
        curve: displacement of the watched point at the output times.
        energies: by name, (m,) arrays in pJ at the output times: `kinetic` energy; `internal`
            and `load`, the work of the internal and of the load forces since t = 0, integrated
            along with the equations of motion by the same method; `balance`, load − kinetic −
            internal, zero but for the error of the time integration; `dissipated`, the work of
            the stress in excess of σ(F, 0), from samples at the ends of steps joined by a
            monotone cubic (second order or better), NaN where not recorded.
        nodes: (n_nodes, 2) reference positions, µm; quads: (n_el, 4) their nodes.
        frames: whole fields at a few times.
        met: extremes of deformation and rate.
        wall_time: seconds, `total`, `law` (inside the stress law) and `macro` (the rest).
        counts: `steps` accepted, `rejected_steps` as too inaccurate, `failed_trials` without
            stress or turned back by the law, `right_hand_sides`, `stress_calls` and
            `stress_points` of those, `dissipation_points` and `dissipation_failures` of the
            questions for σ(F, 0), which come on top.
        effort: sums of what the law's answers say they cost, those for dissipation included.
        threads: that numba could use.
        finished: whether the end of the load case was reached.
    """

    curve: DisplacementCurve
    energies: dict[str, Array]
    nodes: Array
    quads: NDArray[np.int64]
    frames: Frames
    met: MetRange
    wall_time: dict[str, float]
    counts: dict[str, int]
    effort: dict[str, int]
    threads: int
    finished: bool


def simulate(
    load_case: LoadCase,
    law: StressLaw,
    settings: MacroSettings = SECTION_6_2,
    *,
    progress: Callable[[float, float], None] | None = None,
    checkpoint: Callable[[MacroState], None] | None = None,
    checkpoint_interval: float = 30.0,
    resume: MacroState | None = None,
) -> MacroRun:
    """Motion of the clamped bar under its body force (sections 4 and 6.2).

    M ü = ∫ ρ N g dV − ∫ σ ∇N dv on bilinear quadrilaterals, the stress by selective reduced
    integration, in time by Dormand–Prince 5(4) or, with `settings.integrator` "implicit", by
    generalised-α, for which the law must give tangents. The law is asked at five points an
    element, all at once; a step with a point that has no stress, or whose end the law does not
    accept, is tried again at half the length.

    Args:
        load_case: the bar, its load, the duration and what is watched.
        law: any stress law; its density times the area is the mass.
        settings: mesh, tolerances, what is kept.
        progress: called with (t, duration) in µs after every step.
        checkpoint: called with the state of the run when `checkpoint_interval` seconds have
            passed since it last was, and upon an interrupt, which then goes its way; but not
            where that comes while the law commits a step, of which it may have taken down a part.
        checkpoint_interval: s.
        resume: a state that `checkpoint` was given, of the same load case, mesh and density.
            The results are those of the uninterrupted run to the bit where the law goes on from
            `MacroState.law_state`, or has no state; else it starts cold.

    Raises:
        InputError: `checkpoint_interval` is negative, or the integrator is "implicit" and the law
            has no tangents.
        SimulationError: ten halvings in a row found no acceptable step, or the error asks for
            steps below rounding; `partial` is the `MacroRun` up to there (None if the law fails
            already where the run starts).
        MismatchError: `resume` is of another run.
    """
    if not checkpoint_interval >= 0.0:
        raise InputError(
            f"checkpoint_interval: {checkpoint_interval}; it must be a number of at least 0"
        )
    discretisation = make_discretisation(load_case, settings.elements, law.density)
    if resume is not None:
        _check_same_run(resume, discretisation, load_case, settings)
    equations = EquationsOfMotion(discretisation, law, load_case.amplitude_at)
    recorder = Recorder(equations, load_case, settings, resume)
    stepper = _make_stepper(equations, settings, load_case.duration, resume)
    if resume is None:
        recorder.begin(stepper)
    last_checkpoint = monotonic()
    try:
        # BLAS has vectors to add up here; its threads would stand in the way of those of the law.
        with threadpool_limits(1, user_api="blas"):
            while stepper.now.t < load_case.duration:
                recorder.record(stepper.advance(), stepper)
                if progress is not None:
                    progress(stepper.now.t, load_case.duration)
                if checkpoint is not None and monotonic() - last_checkpoint >= checkpoint_interval:
                    checkpoint(recorder.checkpoint())
                    last_checkpoint = monotonic()
    except SimulationError as error:
        partial = _make_run(discretisation, recorder.state(), finished=False)
        raise SimulationError(str(error), partial=partial) from error
    except KeyboardInterrupt:
        if checkpoint is not None and not equations.is_committing:
            checkpoint(recorder.checkpoint())
        raise
    return _make_run(discretisation, recorder.state(), finished=True)


def make_method(equations: EquationsOfMotion, settings: MacroSettings) -> Method:
    """The time integration that `settings` ask for."""
    if settings.integrator == "implicit":
        return GeneralisedAlpha(equations, settings)
    tolerances = settings.absolute_tolerance, settings.relative_tolerance
    return DormandPrince(equations.evaluate, *tolerances)


def _make_stepper(
    equations: EquationsOfMotion, settings: MacroSettings, end: float, resume: MacroState | None
) -> Stepper:
    """A stepper at rest at t = 0, or where `resume` was taken."""
    method, tally = make_method(equations, settings), equations.tally
    if resume is None:
        start = equations.begin(0.0, np.zeros(4 * len(equations.discretisation.free)))
        return Stepper(equations, method, settings, end, start)
    tally.counts, tally.effort = Counter(resume.counts), Counter(resume.effort)
    tally.law_seconds = resume.wall_time["law"]
    going_on = equations.resume(resume.t, resume.y, resume.stress, resume.law_state)
    return Stepper(equations, method, settings, end, going_on, resume.next_step, resume.memory)


def _make_run(discretisation: Discretisation, state: MacroState, finished: bool) -> MacroRun:
    """The results that `state` holds."""
    t, *displacement, kinetic, internal, load = state.rows.T
    return MacroRun(
        curve=DisplacementCurve(t, np.stack(displacement, axis=1)),
        energies={
            "kinetic": kinetic,
            "internal": internal,
            "load": load,
            "dissipated": _dissipated(t, state.samples),
            "balance": load - kinetic - internal,
        },
        nodes=discretisation.nodes,
        quads=discretisation.quads,
        frames=state.frames,
        met=MetRange.of(state.extremes),
        wall_time=state.wall_time,
        counts=state.counts,
        effort=state.effort,
        threads=numba.get_num_threads(),
        finished=finished,
    )


def _dissipated(t: Array, samples: Array) -> Array:
    """(r,) ∫ rate dt at the output times.

    A monotone cubic stays between its samples, so the work of a rate that is never negative
    never falls.
    """
    if len(samples) < 2:
        return np.where(t == 0.0, 0.0, np.nan)
    begin, rate = samples.T
    return integral_of_monotone_cubic(begin, rate, t)


def integral_of_monotone_cubic(x: Array, y: Array, t: Array) -> Array:
    """Integral from x[0] to t of the cubic by Fritsch and Butland through (x, y), NaN beyond x.

    That of scipy's PchipInterpolator, whose import takes a third of a cached run.
    """
    h, rise = np.diff(x), np.diff(y)
    slope = rise / h
    d = np.zeros(len(x))
    if len(x) == 2:
        d[:] = slope
    else:
        before, after = slope[:-1], slope[1:]
        alike = before * after > 0.0
        w = np.stack([2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]])[:, alike]
        d[1:-1][alike] = w.sum(axis=0) / (w[0] / before[alike] + w[1] / after[alike])
        d[0] = _end_slope(h[0], h[1], slope[0], slope[1])
        d[-1] = _end_slope(h[-1], h[-2], slope[-1], slope[-2])
    whole = h * (y[:-1] + y[1:]) / 2.0 + h**2 * (d[:-1] - d[1:]) / 12.0
    sums = np.concatenate([[0.0], np.cumsum(whole)])
    k = np.clip(np.searchsorted(x, t, side="right") - 1, 0, len(h) - 1)
    s = (t - x[k]) / h[k]
    values = y[k] * (s - s**3 + s**4 / 2.0) + y[k + 1] * (s**3 - s**4 / 2.0)
    slopes = d[k] * (s**2 / 2.0 - 2.0 * s**3 / 3.0 + s**4 / 4.0)
    slopes += d[k + 1] * (s**4 / 4.0 - s**3 / 3.0)
    inside = (t >= x[0]) & (t <= x[-1])
    return np.where(inside, sums[k] + h[k] * (values + h[k] * slopes), np.nan)


def _end_slope(h: float, next_h: float, slope: float, next_slope: float) -> float:
    """Slope of a parabola through the last three points, kept monotone."""
    d = ((2.0 * h + next_h) * slope - h * next_slope) / (h + next_h)
    if d * slope <= 0.0:
        return 0.0
    return 3.0 * slope if slope * next_slope < 0.0 and abs(d) > 3.0 * abs(slope) else d


def _check_same_run(
    state: MacroState, discretisation: Discretisation, load_case: LoadCase, settings: MacroSettings
) -> None:
    begun = "implicit" if state.memory.size else "explicit"
    if state.t > 0.0 and begun != settings.integrator:
        raise MismatchError(
            f"resume: macro.integrator: {settings.integrator}; the checkpoint is of an {begun} "
            "run: resume with that or run anew"
        )
    for name, there, here in (
        ("mesh", state.nodes, discretisation.nodes),
        ("load or density", state.load, discretisation.load),
        ("amplitude of the load", state.amplitude, np.reshape(load_case.amplitude, (-1, 2))),
        ("output times", state.rows[:, 0], load_case.output_times()[: len(state.rows)]),
    ):
        if there.shape != here.shape or not np.allclose(there, here, rtol=1e-12, atol=0.0):
            raise MismatchError(f"resume: the {name} is not that of the checkpoint; run anew")

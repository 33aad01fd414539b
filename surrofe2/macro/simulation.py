"""A macro run from start to end: `simulate`."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from time import monotonic

import numpy as np
from threadpoolctl import threadpool_limits

from surrofe2.errors import InputError, MismatchError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.macro.implicit import ImplicitStepper
from surrofe2.macro.mesh import Bar, make_bar
from surrofe2.macro.recording import Recorder
from surrofe2.macro.results import MacroRun, make_run
from surrofe2.macro.right_hand_side import RightHandSide, Tally, TrialError
from surrofe2.macro.settings import SECTION_6_2, MacroSettings
from surrofe2.macro.state import MacroState
from surrofe2.macro.time_integration import MAX_HALVINGS, Stepper
from surrofe2.stress_law import StressLaw


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
            passed since it last was, and upon an interrupt, which then goes its way.
        checkpoint_interval: s.
        resume: a state that `checkpoint` was given, of the same load case, mesh and density.
            The law starts cold, so a law with a history must not be resumed; the results of one
            without a state are those of the uninterrupted run to the bit.

    Raises:
        InputError: `checkpoint_interval` is negative, or the integrator is "implicit" and the law
            has no tangents.
        SimulationError: ten halvings in a row found no acceptable step; `partial` is the
            `MacroRun` up to there (None if the law fails already where the run starts).
        MismatchError: `resume` is of another run.
    """
    if not checkpoint_interval >= 0.0:
        raise InputError(
            f"checkpoint_interval: {checkpoint_interval}; it must be a number of at least 0"
        )
    bar = make_bar(load_case, settings.elements, law.density)
    tally = Tally()
    right_hand_side = RightHandSide(bar, law, load_case.amplitude_at, tally)
    recorder = Recorder(right_hand_side, load_case, settings, resume)
    stepper = _start(right_hand_side, recorder, load_case, settings, resume)
    t = stepper.start.t
    last_checkpoint = monotonic()
    try:
        # BLAS has vectors to add up here; its threads would stand in the way of those of the law.
        with threadpool_limits(1, user_api="blas"):
            while t < load_case.duration:
                step = stepper.advance()
                recorder.record(step)
                t = step.t
                if progress is not None:
                    progress(t, load_case.duration)
                if checkpoint is not None and monotonic() - last_checkpoint >= checkpoint_interval:
                    checkpoint(recorder.state())
                    last_checkpoint = monotonic()
    except TrialError as failure:
        raise SimulationError(
            f"no time step succeeds after {MAX_HALVINGS} halvings: {failure}",
            partial=make_run(bar, recorder.state(), finished=False),
        ) from None
    except SimulationError as error:
        partial = make_run(bar, recorder.state(), finished=False)
        raise SimulationError(str(error), partial=partial) from error
    except KeyboardInterrupt:
        if checkpoint is not None:
            checkpoint(recorder.state())
        raise
    return make_run(bar, recorder.state(), finished=True)


def _start(
    right_hand_side: RightHandSide,
    recorder: Recorder,
    load_case: LoadCase,
    settings: MacroSettings,
    resume: MacroState | None,
) -> Stepper | ImplicitStepper:
    """A stepper at rest at t = 0, or where `resume` was taken, and the recorder to go with it."""
    t, y, first_step = 0.0, np.zeros(4 * len(right_hand_side.bar.free)), None
    if resume is not None:
        _check_same_run(resume, right_hand_side.bar, load_case)
        _check_same_integrator(resume, settings)
        t, y, first_step = resume.t, resume.y, resume.next_step
        tally = right_hand_side.tally
        tally.counts, tally.effort = Counter(resume.counts), Counter(resume.effort)
        tally.law_seconds = resume.wall_time["law"]
    place = (right_hand_side, t, y, load_case.duration, settings, first_step)
    stepper: Stepper | ImplicitStepper
    try:
        if settings.integrator == "implicit":
            stepper = ImplicitStepper(*place, memory=resume.memory if resume else None)
        else:
            stepper = Stepper(*place)
    except TrialError as failure:
        raise SimulationError(f"the run cannot start: {failure}") from None
    if resume is None:
        recorder.begin(stepper.start, stepper.next_step, stepper.memory)
    else:
        recorder.restore(resume)
    return stepper


def _check_same_integrator(state: MacroState, settings: MacroSettings) -> None:
    there = "implicit" if state.memory.size else "explicit"
    if there != settings.integrator:
        raise MismatchError(
            f"resume: macro.integrator: {settings.integrator}; the checkpoint is of an {there} "
            "run: resume with that or run anew"
        )


def _check_same_run(state: MacroState, bar: Bar, load_case: LoadCase) -> None:
    times = load_case.output_times()
    amplitude = np.array(load_case.amplitude).reshape(-1, 2)
    for name, there, here in (
        ("mesh", state.nodes, bar.nodes),
        ("load or density", state.load, bar.load),
        ("amplitude of the load", state.amplitude, amplitude),
        ("output times", state.output_t, times[: state.output_t.size]),
        ("number of unknowns", np.array(state.y.size), np.array(4 * len(bar.free))),
    ):
        if there.shape != here.shape or not np.allclose(there, here, rtol=1e-12, atol=0.0):
            raise MismatchError(f"resume: the {name} is not that of the checkpoint; run anew")

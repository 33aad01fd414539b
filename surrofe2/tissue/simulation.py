"""The full microscopic tissue under load, from start to end: `simulate_tissue`.

Leapfrog with lagged velocities in the dashpots, one force evaluation a step::

    v_{k+1/2} = v_{k−1/2} + Δt [f(x_k, v_{k−1/2}) + load(t_k)]/m,    x_{k+1} = x_k + Δt v_{k+1/2}

begun and ended with half a kick where positions and velocities are wanted at one time: at every
sample of the energies. Because v_{k−1/2} stands for v_k in velocity-dependent forces, the method
is first order in Δt; without damping it is second order. Stable to about 2.4e-3 µs with critical
damping (docs/theory.md), which limits the step before accuracy does: `stable_step`. On the paper's
bar the default of 2e-3 µs moves the watched point by less than 1e-4 µm in the first 30 µs, 3e-6 of
its way, by comparison with steps of 1e-3 and 5e-4.

Supports are held and bodies are away while the tissue relaxes. Displacements, forces and energies
count from there. Bodies meet the outline that the problem states: a particle touches one where its
place on the grid of walls, moved by its displacement, does.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError, MismatchError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.run.loop import carry_out, check_interval
from surrofe2.tissue.conditions import Conditions
from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.history import Recorder, TissueRun, TissueState, columns_of
from surrofe2.tissue.layout import Tissue, make_mixed_tissue
from surrofe2.tissue.problem import TissueProblem, as_problem
from surrofe2.tissue.relaxation import relax
from surrofe2.tissue.settings import TissueSettings
from surrofe2.tissue.stable_step import LONGEST, rounded_step, safe_step, stable_step

Array = NDArray[np.float64]
Cells = CellParameters | Sequence[CellParameters]
References = ReferenceState | Sequence[ReferenceState]

DEFAULTS = TissueSettings()


def simulate_tissue(
    problem: TissueProblem | LoadCase,
    cell: Cells,
    settings: TissueSettings = DEFAULTS,
    *,
    reference: References,
    progress: Callable[[float, float], None] | None = None,
    checkpoint: Callable[[TissueState], None] | None = None,
    checkpoint_interval: float = 30.0,
    resume: TissueState | None = None,
) -> TissueRun:
    """Motion of all particles of a tissue, such as the bar of a load case.

    The tissue is first relaxed without load; displacements count from there.

    Args:
        problem: the tissue's extent, a whole number of plant cells, what happens to it, the
            duration and what is watched: the particles nearest to the watched points.
        cell: the plant cell that the tissue is made of, or those of `TissueProblem.kind`.
        reference: its reference state, as the RVE law of the same cell has it, or theirs.
        progress: called with (t, duration) in µs at every output time.
        checkpoint: called at output times with the state of the run when `checkpoint_interval`
            seconds have passed since it last was, and upon an interrupt, which then goes its way.
        resume: a state that `checkpoint` was given by a run of the same tissue, load and step;
            the results are those of the uninterrupted run, bit by bit.

    Raises:
        InputError: the cells do not fill the extent, the problem contradicts itself, or the step
            is longer than the tissue bears.
        SimulationError: the tissue collapses, or the step is too long for it; `partial` is the
            `TissueRun` up to there (None before the loaded run begins).
        MismatchError: `resume` is of another run, `reference` of another cell.
    """
    check_interval(checkpoint_interval)
    conditions = make_conditions(problem, cell, reference)
    problem, tissue = conditions.problem, conditions.tissue
    bears = step_at_rest(conditions, cell, reference)
    settings = with_step(settings, bears)
    check_motions(problem)
    dynamics = held_and_loaded(conditions, settings)
    numbers = identity(problem, tissue, settings)
    recorder = Recorder(conditions, settings, dynamics, numbers)
    if resume is None:
        if progress is not None:
            progress(0.0, problem.duration)
        relax(dynamics, settings.residual)
    elif not np.array_equal(resume.identity, numbers):
        raise MismatchError(
            "resume: cells, load, step or output times are not those of the checkpoint; run anew"
        )
    meet_bodies(dynamics, conditions, dynamics.x if resume is None else resume.relaxed)
    if resume is None:
        rates = [each.at(0.0, 0.0)[1] for each in problem.motions]
        recorder.begin(conditions.velocity(), np.array(rates))
    else:
        recorder.restore(resume)
    try:
        return carry_out(
            _steps(recorder, dynamics, problem, settings),
            recorder,
            problem.duration,
            progress=progress,
            checkpoint=checkpoint,
            interval=checkpoint_interval,
        )
    except SimulationError as error:
        message = f"{error}; {_about_step(settings, bears)}"
        raise SimulationError(message, partial=error.partial) from error


def _steps(
    recorder: Recorder, dynamics: TissueDynamics, problem: TissueProblem, settings: TissueSettings
) -> Iterator[float]:
    """From one output time to the next, to the end of the run."""
    times = problem.output_times().tolist()
    for start, end in pairwise(times[recorder.rows - 1 :]):
        recorder.record(*advance(dynamics, problem, settings, start, end))
        yield end


def make_conditions(
    given: TissueProblem | LoadCase, cell: Cells, reference: References
) -> Conditions:
    """A problem on the particles of its tissue; arguments as of `simulate_tissue`."""
    problem = as_problem(given)
    types = [cell] if isinstance(cell, CellParameters) else cell
    references = [reference] if isinstance(reference, ReferenceState) else reference
    cells = cells_that_fill(problem, types[0])
    kind = np.zeros(cells, dtype=np.int64) if problem.kind is None else problem.kind
    if kind.shape != cells or not 0 <= kind.min() <= kind.max() < len(types):
        raise InputError(
            f"tissue: kinds {kind.shape} up to {kind.max()}; it has {cells[0]} × {cells[1]} plant "
            f"cells of {len(types)} types"
        )
    conditions = Conditions(problem, make_mixed_tissue(types, references, kind))
    conditions.check_bodies()
    return conditions


def step_at_rest(conditions: Conditions, cell: Cells, reference: References) -> float:
    """The longest step, µs, that each type of plant cell bears, with what acts on the outline."""
    types = [cell] if isinstance(cell, CellParameters) else cell
    references = [reference] if isinstance(reference, ReferenceState) else reference
    outside = conditions.stiffest()
    return min(stable_step(*each, outside) for each in zip(types, references, strict=True))


def with_step(settings: TissueSettings, bears: float) -> TissueSettings:
    """The settings with a step that the tissue bears where they state none.

    Raises:
        InputError: they state one too close to the limit that it `bears` at rest: it could grow to
            any size without an error.
    """
    step, longest = settings.micro_step, safe_step(bears)
    if step is None:
        return replace(settings, micro_step=rounded_step(bears))
    if step > longest * (1.0 + 1e-9):
        raise InputError(
            f"tissue.micro_step: {step:.4g} µs; at most {longest:.4g}, as the limit of stability "
            f"at rest is {bears:.4g} µs with all that acts; leave it out or take "
            f"{rounded_step(bears):g}"
        )
    return settings


def _about_step(settings: TissueSettings, limit: float) -> str:
    """The step against the longest that the tissue bears at rest, and what to change."""
    step, default = settings.micro_step or 0.0, rounded_step(limit)
    beside = f"tissue.micro_step is {step:.3g} µs, at rest this cell bears {limit:.3g} µs"
    if step > default:
        return f"{beside}: the step is too long; leave it out or take {default:g}"
    return f"{beside}: lower the load, or the step"


def cells_that_fill(
    problem: TissueProblem | LoadCase, cell: CellParameters, section: str = "load"
) -> tuple[int, int]:
    """Plant cells in x and y.

    Args:
        section: of the recipe that states the extent.

    Raises:
        InputError: no whole number of them fills the rectangle.
    """
    counts = []
    for name, extent in (("width", problem.width), ("height", problem.height)):
        count = round(extent / cell.cell_side)
        if count < 1 or abs(count * cell.cell_side - extent) > 1e-9 * extent:
            low = int(extent / cell.cell_side)
            near = " or ".join(f"{n * cell.cell_side:g}" for n in (low, low + 1) if n)
            hint = ": change it or give --cells N M" if section == "load" else f": take {near}"
            raise InputError(
                f"{section}.{name}: {extent:g}; a tissue needs a whole number of plant cells of "
                f"{cell.cell_side:g} µm{hint}"
            )
        counts.append(count)
    return counts[0], counts[1]


def check_motions(problem: TissueProblem) -> None:
    """Refuse prescribed motion that does not begin at rest where the tissue is.

    Raises:
        InputError: naming the support or body.
    """
    named = [each.name for each in problem.supports if each.moves]
    named += [each.name for each in problem.moved_bodies]
    for name, amplitude in zip(named, problem.motions, strict=True):
        for t in (0.0, *amplitude.corners()):
            before, after = (amplitude.at(t, t + side)[0] for side in (-1e-9, 1e-9))
            jump = after if t <= 0.0 else after - before
            if abs(jump) > 1e-9 and t < problem.duration:
                raise InputError(
                    f"{name}.amplitude: jumps by {jump:g} at t = {max(t, 0.0):g} µs; a prescribed "
                    "motion must begin at 0 and not jump"
                )


def held_and_loaded(conditions: Conditions, settings: TissueSettings) -> TissueDynamics:
    """The tissue at rest in its repeated reference, with its supports and loads, without bodies."""
    return TissueDynamics(
        conditions.tissue,
        skin=settings.skin,
        held=conditions.held,
        load=conditions.loads(),
        drive=conditions.drive(),
    )


def meet_bodies(dynamics: TissueDynamics, conditions: Conditions, relaxed: Array) -> None:
    """Let all act on the outline; `relaxed` (particles, 2): where it is unloaded, µm."""
    offset = conditions.tissue.outline - relaxed
    dynamics.plates = conditions.plates(offset)
    dynamics.edges = conditions.edges(relaxed, offset)


def advance(
    dynamics: TissueDynamics,
    problem: TissueProblem,
    settings: TissueSettings,
    start: float,
    end: float,
) -> tuple[int, Array]:
    """Move from t = start to end, µs; steps taken, and works as of `Recorder.record`.

    Works are summed over the steps; the dissipated power is integrated by the trapezoidal rule over
    samples. Both are of second order in the step.
    """
    longest = settings.micro_step or LONGEST
    total = int(np.ceil((end - start) / longest * (1.0 - 1e-9)))
    samples = -(-total // settings.energy_steps)
    count = -(-total // samples)
    length = (end - start) / samples
    step = length / count
    kicks, drifts = np.full(count + 1, step), np.full(count + 1, step)
    kicks[[0, -1]] *= 0.5
    drifts[-1] = 0.0
    loads, motions = [each.amplitude for each in problem.loads], problem.motions
    drive, plates, edges = dynamics.drive, dynamics.plates, dynamics.edges
    works = np.zeros(len(loads) + 4)
    for each in (drive, plates, edges):
        each.work[:] = 0.0
    dynamics.take_load_work()
    rate = dynamics.dissipation_rate()
    for k in range(samples):
        t = start + k * length + step * np.arange(count + 1)
        amplitudes = np.array([[each.at(at, at)[0] for each in loads] for at in t])
        values = np.array([[each.at(at, at)[0] for each in motions] for at in t])
        # Each drift ends where the motion leads; the last kick, without a drift, at its rate.
        last = [each.at(t[-1], t[-1])[1] for each in motions]
        speeds = np.concatenate([np.diff(values, axis=0) / step, [last]])
        if not loads:
            amplitudes = np.zeros((len(t), 1))
        dynamics.leap(kicks, drifts, amplitudes, speeds)
        rate_before, rate = rate, dynamics.dissipation_rate()
        works[-1] += 0.5 * length * (rate_before + rate)
    works[: len(loads)] = dynamics.take_load_work()[: len(loads)] + edges.work
    works[-4:-1] = plates.work
    works[-3] += drive.work[0]
    if not np.isfinite(works).all():
        raise SimulationError("tissue: the motion is not finite")
    return samples * count, works


def identity(problem: TissueProblem, tissue: Tissue, settings: TissueSettings) -> Array:
    """Numbers that two runs share if one may go on where the other stopped."""
    told = repr((replace(problem, kind=None), tissue.types, settings, columns_of(problem)))
    told += repr([tissue.mass.tobytes(), tissue.kind.tobytes()])
    return np.array(list(hashlib.sha256(told.encode()).digest()), dtype=np.float64)

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

from surrofe2.base.errors import InputError, MismatchError, SimulationError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.problem.mesh import extent
from surrofe2.problem.problem import Problem
from surrofe2.run.loop import carry_out
from surrofe2.tissue.conditions import Conditions
from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.history import Recorder, TissueRun, TissueState, columns_of
from surrofe2.tissue.layout import make_mixed_tissue
from surrofe2.tissue.relaxation import LONGEST, relax, rounded_step, safe_step, stable_step
from surrofe2.tissue.settings import TissueSettings

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Cells = CellParameters | Sequence[CellParameters]
References = ReferenceState | Sequence[ReferenceState]

DEFAULTS = TissueSettings()
_STATE = 2
"""Version of what a state holds."""


def simulate_tissue(
    problem: Problem,
    cell: Cells,
    settings: TissueSettings = DEFAULTS,
    *,
    reference: References,
    kind: Index | None = None,
    progress: Callable[[float, float], None] | None = None,
    checkpoint: Callable[[TissueState], None] | None = None,
    checkpoint_interval: float = 30.0,
    resume: TissueState | None = None,
) -> TissueRun:
    """Motion of all particles of a tissue, such as the bar of a load case.

    The tissue is first relaxed without load; displacements count from there.

    Args:
        problem: on a rectangle [0, width] × [0, height] of whole plant cells; its elements do not
            matter. A boundary is the wall particles on its sides, a region the plant cells whose
            middles it holds, a watched point the nearest particle.
        cell: the plant cell that the tissue is made of, or several of one size.
        reference: its reference state, as the RVE law of the same cell has it, or theirs.
        kind: (n, m) which of several each plant cell is.
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
    conditions = make_conditions(problem, cell, reference, kind)
    bears = step_at_rest(conditions, cell, reference)
    settings = with_step(settings, bears)
    problem.check_course()
    dynamics = held_and_loaded(conditions, settings)
    numbers = identity(conditions, settings)
    recorder = Recorder(conditions, settings, dynamics, numbers)
    if resume is None:
        if progress is not None:
            progress(0.0, problem.duration)
        relax(dynamics, settings.residual)
    elif not np.array_equal(resume.identity, numbers):
        raise MismatchError(
            "resume: cells, load, step or output times are not those of the checkpoint; start a "
            "new run"
        )
    meet_bodies(dynamics, conditions, dynamics.x if resume is None else resume.relaxed)
    if resume is None:
        rates = [each.at(0.0, 0.0)[1] for each in conditions.motions]
        recorder.begin(conditions.velocity(), np.array(rates))
    else:
        recorder.restore(resume)
    try:
        return carry_out(
            _steps(recorder, dynamics, conditions, settings),
            recorder,
            recorder.run,
            problem.duration,
            progress=progress,
            checkpoint=checkpoint,
            interval=checkpoint_interval,
        )
    except SimulationError as error:
        message = f"{error}; {_about_step(settings, bears)}"
        raise SimulationError(message, partial=error.partial) from error


def _steps(
    recorder: Recorder, dynamics: TissueDynamics, conditions: Conditions, settings: TissueSettings
) -> Iterator[float]:
    """From one output time to the next, to the end of the run."""
    times = conditions.problem.output_times().tolist()
    for start, end in pairwise(times[recorder.rows - 1 :]):
        recorder.record(*advance(dynamics, conditions, settings, start, end))
        yield end


def make_conditions(
    problem: Problem, cell: Cells, reference: References, kind: Index | None = None
) -> Conditions:
    """A problem on the particles of its tissue; arguments as of `simulate_tissue`."""
    types = [cell] if isinstance(cell, CellParameters) else cell
    references = [reference] if isinstance(reference, ReferenceState) else reference
    cells = cells_that_fill(problem, types[0])
    kind = np.zeros(cells, dtype=np.int64) if kind is None else kind
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
    problem: Problem, cell: CellParameters, section: str = "mesh"
) -> tuple[int, int]:
    """Plant cells in x and y.

    Args:
        section: of the recipe that states the extent.

    Raises:
        InputError: no whole number of them fills the mesh, or it is no rectangle.
    """
    mesh, (low, high) = problem.mesh, extent(problem.mesh)
    ends = mesh.p[:, mesh.facets[:, mesh.boundary_facets()]]
    on_a_side = [(abs(ends.T - side) < 1e-9 * high.max()).all(axis=1) for side in (0.0 * low, high)]
    if abs(low).max() > 1e-9 * high.max() or not np.any(on_a_side, axis=(0, 2)).all():
        raise InputError("mesh: a full tissue needs a rectangle [0, width] × [0, height]")
    counts = []
    for name, length in zip(("width", "height"), high.tolist(), strict=True):
        count = round(length / cell.cell_side)
        if count < 1 or abs(count * cell.cell_side - length) > 1e-9 * length:
            few = int(length / cell.cell_side)
            near = " or ".join(f"{n * cell.cell_side:g}" for n in (few, few + 1) if n)
            hint = ": change it or give --cells N M" if section == "load" else f": take {near}"
            raise InputError(
                f"{section}.{name}: {length:g}; a tissue needs a whole number of plant cells of "
                f"{cell.cell_side:g} µm{hint}"
            )
        counts.append(count)
    return counts[0], counts[1]


def held_and_loaded(conditions: Conditions, settings: TissueSettings) -> TissueDynamics:
    """The tissue at rest in its repeated reference, with its supports and loads, without bodies."""
    return TissueDynamics(
        conditions.tissue,
        skin=settings.skin,
        held=conditions.held,
        load=conditions.dead_loads(),
        driven=conditions.driven(),
    )


def meet_bodies(dynamics: TissueDynamics, conditions: Conditions, relaxed: Array) -> None:
    """Let all act on the outline; `relaxed` (particles, 2): where it is unloaded, µm."""
    offset = conditions.tissue.outline - relaxed
    dynamics.bodies = conditions.bodies(offset)
    dynamics.outline = conditions.outline(relaxed, offset)


def advance(
    dynamics: TissueDynamics,
    conditions: Conditions,
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
    loads, motions = conditions.load_amplitudes, conditions.motions
    dynamics.take_works()
    dissipated, rate = 0.0, dynamics.dissipation_rate()
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
        dissipated += 0.5 * length * (rate_before + rate)
    works = np.append(dynamics.take_works(), dissipated)
    if not np.isfinite(works).all():
        raise SimulationError("tissue: the motion is not finite")
    return samples * count, works


def identity(conditions: Conditions, settings: TissueSettings) -> Array:
    """Numbers that two runs share if one may continue where the other stopped."""
    problem, tissue = conditions.problem, conditions.tissue
    stated = problem.conditions, problem.bodies, problem.duration, problem.output_interval
    digest = hashlib.sha256(repr((_STATE, stated, tissue.constants, settings)).encode())
    digest.update(repr([*columns_of(conditions), *problem.watched.items()]).encode())
    sides = [conditions.boundary(name) for name in problem.acted_boundaries()]
    acts = conditions.held, conditions.dead_loads(), conditions.velocity()
    for array in (tissue.mass, tissue.kind, *sides, *acts):
        digest.update(array.tobytes())
    return np.array(list(digest.digest()), dtype=np.float64)

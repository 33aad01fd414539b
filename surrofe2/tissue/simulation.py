"""The full microscopic tissue under load, from start to end: `simulate_tissue`.

Leapfrog with lagged velocities in the dashpots, one force evaluation a step::

    v_{k+1/2} = v_{k−1/2} + Δt [f(x_k, v_{k−1/2}) + load(t_k)]/m,    x_{k+1} = x_k + Δt v_{k+1/2}

begun and ended with half a kick where positions and velocities are wanted at one time: at every
sample of the energies. Because v_{k−1/2} stands for v_k in velocity-dependent forces, the method
is first order in Δt; without damping it is second order. Stable to about 2.4e-3 µs with critical
damping (docs/theory.md), which limits the step before accuracy does: `stable_step`. On the paper's
bar the default of 2e-3 µs moves the watched point by less than 1e-4 µm in the first 30 µs, 3e-6 of
its way, by comparison with steps of 1e-3 and 5e-4.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import monotonic

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError, MismatchError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.history import Recorder, TissueRun, TissueState
from surrofe2.tissue.layout import Tissue, make_tissue
from surrofe2.tissue.relaxation import relax
from surrofe2.tissue.settings import TissueSettings
from surrofe2.tissue.stable_step import LONGEST, default_micro_step, stable_step

Array = NDArray[np.float64]

DEFAULTS = TissueSettings()


def simulate_tissue(
    load_case: LoadCase,
    cell: CellParameters,
    settings: TissueSettings = DEFAULTS,
    *,
    reference: ReferenceState,
    progress: Callable[[float, float], None] | None = None,
    checkpoint: Callable[[TissueState], None] | None = None,
    checkpoint_interval: float = 30.0,
    resume: TissueState | None = None,
) -> TissueRun:
    """Motion of all particles of a tissue clamped at x = 0 under a body force.

    The tissue is first relaxed without load; displacements count from there.

    Args:
        load_case: the tissue's extent, a whole number of plant cells, its load, the duration and
            what is watched: the particle nearest to the watched point.
        cell: the plant cell that the tissue is made of.
        reference: its reference state, as the RVE law of the same cell has it.
        progress: called with (t, duration) in µs at every output time.
        checkpoint: called at output times with the state of the run when `checkpoint_interval`
            seconds have passed since it last was, and upon an interrupt, which then goes its way.
        resume: a state that `checkpoint` was given by a run of the same tissue, load and step;
            the results are those of the uninterrupted run, bit by bit.

    Raises:
        InputError: the cells do not fill the load case's extent.
        SimulationError: the step is too long or the tissue collapses; `partial` is the
            `TissueRun` up to there (None before the loaded run begins).
        MismatchError: `resume` is of another run, `reference` of another cell.
    """
    if not checkpoint_interval >= 0.0:
        raise InputError(
            f"checkpoint_interval: {checkpoint_interval}; it must be a number of at least 0"
        )
    tissue = make_tissue(cell, reference, cells_that_fill(load_case, cell))
    settings = with_step(settings, cell, reference)
    dynamics = clamped_and_loaded(load_case, tissue, settings)
    numbers = identity(load_case, tissue, settings)
    recorder = Recorder(load_case, settings, dynamics, numbers)
    if resume is None:
        if progress is not None:
            progress(0.0, load_case.duration)
        relax(dynamics, settings.residual)
        recorder.begin()
    else:
        if not np.array_equal(resume.identity, numbers):
            raise MismatchError(
                "resume: cells, load, step or output times are not those of the checkpoint; "
                "run anew"
            )
        recorder.restore(resume)
    times = load_case.output_times()
    last_checkpoint = monotonic()
    try:
        for row in range(recorder.state.rows, len(times)):
            steps, work, lost = advance(
                dynamics, load_case, settings, float(times[row - 1]), float(times[row])
            )
            recorder.record(steps, work, lost)
            if progress is not None:
                progress(float(times[row]), load_case.duration)
            if checkpoint is not None and monotonic() - last_checkpoint >= checkpoint_interval:
                checkpoint(recorder.state)
                last_checkpoint = monotonic()
    except SimulationError as error:
        said = f"{error}; {_about_step(settings, cell, reference)}"
        raise SimulationError(said, partial=recorder.run(finished=False)) from error
    except KeyboardInterrupt:
        if checkpoint is not None:
            checkpoint(recorder.state)
        raise
    return recorder.run(finished=True)


def with_step(
    settings: TissueSettings, cell: CellParameters, reference: ReferenceState
) -> TissueSettings:
    """The settings with the cell's own step where they state none."""
    if settings.micro_step is not None:
        return settings
    return replace(settings, micro_step=default_micro_step(cell, reference))


def _about_step(settings: TissueSettings, cell: CellParameters, reference: ReferenceState) -> str:
    """The step against the longest that the cell bears at rest, and what to change."""
    step, limit = settings.micro_step or 0.0, stable_step(cell, reference)
    default = default_micro_step(cell, reference)
    beside = f"tissue.micro_step is {step:.3g} µs, at rest this cell bears {limit:.3g} µs"
    if step > default:
        return f"{beside}: the step is too long; leave it out or take {default:g}"
    return f"{beside}: lower the load, or the step"


def cells_that_fill(load_case: LoadCase, cell: CellParameters) -> tuple[int, int]:
    """Plant cells in x and y.

    Raises:
        InputError: no whole number of them fills the load case's rectangle.
    """
    counts = []
    for name, extent in (("width", load_case.width), ("height", load_case.height)):
        count = round(extent / cell.cell_side)
        if count < 1 or abs(count * cell.cell_side - extent) > 1e-9 * extent:
            raise InputError(
                f"load.{name}: {extent:g}; a tissue needs a whole number of plant cells of "
                f"{cell.cell_side:g} µm: change it or give --cells N M"
            )
        counts.append(count)
    return counts[0], counts[1]


def clamped_and_loaded(
    load_case: LoadCase, tissue: Tissue, settings: TissueSettings
) -> TissueDynamics:
    """The tissue at rest in its repeated reference, held at x = 0."""
    x = tissue.to_particles(tissue.start)
    mass = tissue.mass.reshape(-1)[tissue.where]
    # The relaxed reference puts the left wall at x = 0 but for rounding.
    at_left = abs(x[:, 0]) < 1e-6 * tissue.cell.cell_side
    held = at_left & (np.arange(len(x)) < tissue.wall_particles)
    load = mass[:, None] * np.array(load_case.body_force)
    return TissueDynamics(tissue, skin=settings.skin, held=held, load=load)


def advance(
    dynamics: TissueDynamics,
    load_case: LoadCase,
    settings: TissueSettings,
    start: float,
    end: float,
) -> tuple[int, float, float]:
    """Move from t = start to end, µs; steps taken, work of the load and dissipated energy, pJ.

    The work of a body force of amplitude a between two samples is ā load·Δx, exact where a is
    constant; the dissipated power is integrated by the trapezoidal rule, second order in the step.
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
    work, lost = 0.0, 0.0
    x, rate = dynamics.x, dynamics.dissipation_rate()
    for k in range(samples):
        t = start + k * length + step * np.arange(count + 1)
        amplitudes = np.array([load_case.amplitude_at(each) for each in t])
        dynamics.leap(kicks, drifts, amplitudes)
        x_before, rate_before, x, rate = x, rate, dynamics.x, dynamics.dissipation_rate()
        mean = 0.5 * (amplitudes[0] + amplitudes[-1])
        work += mean * float(np.sum(dynamics.load * (x - x_before)))
        lost += 0.5 * length * (rate_before + rate)
    if not (np.isfinite(work) and np.isfinite(lost)):
        raise SimulationError("tissue: the motion is not finite")
    return samples * count, work, lost


def identity(load_case: LoadCase, tissue: Tissue, settings: TissueSettings) -> Array:
    """Numbers that two runs share if one may go on where the other stopped."""
    amplitude = np.array(load_case.amplitude, dtype=np.float64).ravel()
    return np.array(
        [*tissue.cells, *tissue.constants, tissue.cell.wall_particle_mass, *load_case.body_force,
         *load_case.watched, load_case.output_interval, settings.micro_step or LONGEST,
         settings.skin, settings.energy_steps, *amplitude]
    )  # fmt: skip

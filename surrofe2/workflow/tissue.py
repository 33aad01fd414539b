"""The full microscopic tissue of a recipe, into a run folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from surrofe2.base.arrays import Index
from surrofe2.base.clock import seconds_compiling
from surrofe2.base.errors import InputError
from surrofe2.base.units import time_text
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import Problem
from surrofe2.recipe.recipe import Recipe, kinds_of_cells
from surrofe2.run.loop import Report, no_report
from surrofe2.store.fields import FrameWriter, fields_of_particles, particle_writer
from surrofe2.store.run_folder import CHECKPOINT_INTERVAL, RunFolder, RunRecord, write_curves
from surrofe2.store.samples import kept_reference
from surrofe2.tissue import TissueRun, TissueState, simulate_tissue
from surrofe2.tissue.layout import middles_of
from surrofe2.tissue.simulation import (
    ParticleFrames,
    Particles,
    make_conditions,
    plant_cells_within,
    step_note,
    with_step,
)
from surrofe2.workflow.inputs import inputs_of
from surrofe2.workflow.run import new_record


def tissue_of(
    recipe: Recipe,
) -> tuple[Problem, list[CellParameters], Index]:
    """The problem of a recipe, its plant cells, and which of these each one of the tissue is, as
    `simulate_tissue` takes it.

    Raises:
        InputError: naming what a tissue of particles does not take.
    """
    problem, section = recipe.problem(), "load" if recipe.is_bar else "mesh"
    cells = [each.parameters for each in recipe.cells.values()]
    with recipe.named(InputError):
        problem.check_course()
        reference = kept_reference(cells[0])
        origin, inside = plant_cells_within(problem, cells[0], reference, section)
        kind = np.where(inside, 0, -1)
        middles = middles_of(cells[0], reference, origin, inside.shape[:2])
        kind[inside] = kinds_of_cells(problem, recipe.cells, middles[inside])
        return problem, cells, kind


def step_notes(recipe: Recipe) -> Iterator[tuple[str, bool]]:
    """A message on the step that undrained sap makes a tissue take, and that it is no warning."""
    if not any(each.parameters.sap_bulk_modulus > 0.0 for each in recipe.cells.values()):
        return
    problem, cells, kind = tissue_of(recipe)
    references = [kept_reference(cell) for cell in cells]
    conditions = make_conditions(problem, cells, references, kind)
    yield step_note(with_step(recipe.tissue, conditions), conditions), False


def run_tissue(
    recipe: Recipe,
    folder: Path,
    *,
    fresh: bool = False,
    report: Report = no_report,
) -> RunRecord:
    """Run the recipe's problem on a tissue of plant cells and write the run folder.

    Raises:
        SimulationError: the run could not be carried on; the folder holds it up to there.
    """
    recipe = replace(recipe, rest=None)  # in time, whatever the recipe states
    problem, cells, kind = tissue_of(recipe)
    references = [kept_reference(cell) for cell in cells]
    conditions = make_conditions(problem, cells, references, kind)
    recipe = replace(recipe, tissue=with_step(recipe.tissue, conditions))
    before = seconds_compiling()
    state: TissueState | None = None
    frames: FrameWriter | None = None

    def store(record: RunRecord, run: TissueRun) -> RunRecord:
        write_curves(folder, run.curves, run.history, run.energies)
        writer = frames
        if writer is None:  # the run had ended before its last checkpoint
            writer = particle_writer(folder, run.position, run.bonds, run.is_wall)
            writer.resume(run.frames.t.tolist())
        writer.close()
        return replace(
            record,
            wall_time={**run.wall_time, "compilation": seconds_compiling() - before},
            counts=run.counts,
            threads=run.threads,
        )

    def keep(frame: ParticleFrames, count: int, of: Particles) -> None:
        nonlocal frames
        if frames is None:
            frames = particle_writer(folder, *of)
            if state is not None:
                frames.resume(state.journal["frames.t"].tolist())
        frames.write(count, float(frame.t[0]), *fields_of_particles(frame))

    def checkpoint(at: TissueState) -> None:
        if frames is not None:  # first: whoever resumes needs all that this state had recorded
            frames.flush()
        run.checkpoint(at.to_arrays())

    of = {"initialisation": "none", "solver": "leapfrog", "seed": None}
    record = new_record(recipe, "tissue", **of)
    inputs = inputs_of(recipe, "tissue")
    with RunFolder.open(folder, record, store, inputs=inputs, fresh=fresh) as run:
        if run.is_finished:
            return run.record
        state = run.restored(TissueState.from_arrays)
        result = simulate_tissue(
            problem,
            cells,
            recipe.tissue,
            reference=references,
            kind=kind,
            progress=lambda t, duration: report(t, "" if t > 0.0 else "relaxing without load"),
            checkpoint=checkpoint,
            checkpoint_interval=CHECKPOINT_INTERVAL,
            resume=state,
            keep_frame=keep,
        )
        run.finish(result)
    return run.record


def tissue_summary(record: RunRecord) -> str:
    """What a finished run did and what it cost."""
    wall, counts = record.wall_time, record.counts
    rate = counts["particle_steps"] / max(wall["run"], 1e-9) / 1e6
    return (
        f"{record.duration:g} µs of {counts['particles']} particles in "
        f"{time_text(wall['total'])} (relaxation {time_text(wall['relaxation'])}, run "
        f"{time_text(wall['run'])}; compilation {time_text(wall.get('compilation', 0.0))} "
        f"besides), {counts['steps']} steps, {rate:.3g} million particle-steps/s"
    )

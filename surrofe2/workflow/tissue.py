"""The full microscopic tissue of a recipe, into a run folder."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from surrofe2.base.arrays import Index
from surrofe2.base.clock import seconds_compiling
from surrofe2.base.errors import FileError, InputError
from surrofe2.base.units import time_text
from surrofe2.plant_cell.arrangement import ReferenceState, make_arrangement
from surrofe2.plant_cell.outlined import Outlined, outline_cells
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.problem import Problem
from surrofe2.questions.cell_image import measure_cells
from surrofe2.recipe.recipe import ImageSettings, Recipe, kinds_of_cells
from surrofe2.run.loop import Report, no_report
from surrofe2.store.fields import FrameWriter, fields_of_particles, particle_writer
from surrofe2.store.labelled_image import read_labels
from surrofe2.store.run_folder import CHECKPOINT_INTERVAL, RunFolder, RunRecord, write_curves
from surrofe2.store.samples import kept_reference
from surrofe2.tissue import TissueRun, TissueState, simulate_tissue
from surrofe2.tissue.conditions import Conditions
from surrofe2.tissue.layout import middles_of
from surrofe2.tissue.simulation import (
    ParticleFrames,
    Particles,
    make_conditions,
    outlined_conditions,
    plant_cells_within,
    step_note,
    with_step,
)
from surrofe2.workflow.inputs import inputs_of
from surrofe2.workflow.run import new_record

_MOST_SIZE = 1.2
"""By which factor the width of an image's cells may differ from that of the recipe's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueParts:
    """What `simulate_tissue` takes of a recipe.

    Attributes:
        kind: which of the cells each plant cell of the tissue is; None where an image outlines it.
        outlined: walls along the outlines of an image, or None.
        notes: sentences on what of the image the tissue has not as it is.
    """

    problem: Problem
    cells: list[CellParameters]
    kind: Index | None
    outlined: Outlined | None
    notes: tuple[str, ...]

    @property
    def references(self) -> list[ReferenceState]:
        """Reference states of the cells; none are needed where an image outlines the tissue."""
        return [] if self.kind is None else [kept_reference(cell) for cell in self.cells]

    def conditions(self) -> Conditions:
        """Make the problem on the particles of the tissue.

        Raises:
            InputError: naming what a tissue of particles does not take.
        """
        if self.outlined is not None:
            return outlined_conditions(self.problem, self.cells, self.outlined)
        return make_conditions(self.problem, self.cells, self.references, self.kind)


def tissue_of(recipe: Recipe) -> TissueParts:
    """Return the problem of a recipe, its plant cells, and where each of these is in the tissue.

    Raises:
        FileError: its image cannot be read.
        InputError: naming what a tissue of particles does not take.
    """
    problem = recipe.problem()
    section = "load" if recipe.is_bar else "mesh"
    cells = [each.parameters for each in recipe.cells.values()]
    kind: Index | None = None
    outlined: Outlined | None = None
    notes: tuple[str, ...] = ()
    with recipe.named(FileError, InputError):
        problem.check_course()
        if recipe.image is not None:
            outlined, notes = _outlined(recipe.image, recipe.path.parent, cells[0])
        else:
            reference = kept_reference(cells[0])
            origin, inside = plant_cells_within(problem, cells[0], reference, section)
            kind = np.where(inside, 0, -1)
            arrangement = make_arrangement(cells[0])
            middles = middles_of(arrangement, reference, origin, inside.shape[:2])
            kind[inside] = kinds_of_cells(problem, recipe.cells, middles[inside])
    return TissueParts(problem=problem, cells=cells, kind=kind, outlined=outlined, notes=notes)


def _outlined(
    image: ImageSettings, folder: Path, cell: CellParameters
) -> tuple[Outlined, tuple[str, ...]]:
    """Walls along the outlines of an image, and sentences on what was made of it."""
    cells = measure_cells(read_labels(folder / image.file), image.pixel, image.line)
    outlined = outline_cells(cells.labels, image.pixel, cell.spring_length)
    notes = []
    if not 1.0 / _MOST_SIZE < cells.cell_size / cell.cell_side < _MOST_SIZE:
        notes.append(
            f"its cells are {cells.cell_size:.4g} µm wide, [cell] has {cell.cell_side:.4g} µm: "
            "`surrofe2 cells IMAGE --out` writes one of their size"
        )
    if cells.cut:
        notes.append(
            f"cells that the border of the image cuts, closed by a wall there: {cells.cut}"
        )
    if cells.holes:
        notes.append(
            f"air spaces: {cells.holes}, {100.0 * cells.hole_fraction:.2g} % of the image; a "
            "pressure on the outline does not act in them, so it is not that of a bath"
        )
    if cells.pieces:
        notes.append(f"cells in pieces, of which the largest is taken: {cells.pieces}")
    if cells.small + outlined.dissolved:
        number = cells.small + outlined.dissolved
        notes.append(f"regions too small for springs, given to the nearest others: {number}")
    if outlined.enclosed:
        notes.append(f"regions within one cell, given to it: {outlined.enclosed}")
    return outlined, tuple(f"image: {note}" for note in notes)


def tissue_notes(recipe: Recipe) -> Iterator[tuple[str, bool]]:
    """Messages on a tissue, each with whether it is a warning.

    They are on the step that undrained sap makes it take, and on what was made of an image.
    """
    is_undrained = any(each.parameters.sap_bulk_modulus > 0.0 for each in recipe.cells.values())
    if recipe.image is None and not is_undrained:
        return
    parts = tissue_of(recipe)
    for note in parts.notes:
        yield note, False
    if is_undrained:
        conditions = parts.conditions()
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
    parts = tissue_of(recipe)
    with recipe.named(InputError):
        conditions = parts.conditions()
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
            parts.problem,
            parts.cells,
            recipe.tissue,
            reference=conditions.tissue.references,
            kind=parts.kind,
            outlined=parts.outlined,
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
    wall = record.wall_time
    counts = record.counts
    rate = counts["particle_steps"] / max(wall["run"], 1e-9) / 1e6
    return (
        f"{record.duration:g} µs of {counts['particles']} particles in "
        f"{time_text(wall['total'])} (relaxation {time_text(wall['relaxation'])}, run "
        f"{time_text(wall['run'])}; compilation {time_text(wall.get('compilation', 0.0))} "
        f"besides), {counts['steps']} steps, {rate:.3g} million particle-steps/s"
    )

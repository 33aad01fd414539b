"""The full microscopic tissue of a recipe, into a run folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

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

# The width of an image's cells may differ from that of the recipe's by this factor.
_MOST_SIZE = 1.2


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueParts:
    """The arguments of `simulate_tissue` for a recipe.

    Attributes:
        problem: what acts on the tissue.
        cells: parameters of its kinds of plant cells.
        kind: number of the kind of each plant cell of the tissue; None where an image outlines it.
        outlined: walls along the outlines of an image, or None.
        notes: notes on what of the image the tissue does not have as it is.
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
    cells = [cell.parameters for cell in recipe.cells.values()]
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
    """Make walls along the outlines of an image, and notes on what was made of it."""
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
    """Iterate over notes on a tissue, each with whether it is a warning.

    They are on the step that undrained sap makes it take, and on what was made of an image.
    """
    is_undrained = any(cell.parameters.sap_bulk_modulus > 0.0 for cell in recipe.cells.values())
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
    record = new_record(recipe, "tissue", initialisation="none", solver="leapfrog", seed=None)
    job = _TissueJob(
        recipe=recipe,
        parts=parts,
        references=conditions.tissue.references,
        folder=folder,
        record=record,
        inputs=inputs_of(recipe, "tissue"),
        report=report,
    )
    return RunFolder.compute(folder, job, fresh=fresh)


@dataclass(slots=True, kw_only=True)
class _TissueJob:
    """A run of all particles as a `Job`.

    Attributes:
        recipe, parts: the tissue that is computed.
        references: reference states of the tissue's cells.
        folder: the run folder.
        record: the record that the run begins with.
        inputs: contents, by name, of the files from which it can be repeated.
        report: is called with the time, µs.
        compiled_before: seconds in which kernels had been compiled when it began.
        frames: writer of whole fields; None until the first frame.
        frame_times: times of the frames that a checkpoint counts, µs.
    """

    recipe: Recipe
    parts: TissueParts
    references: Sequence[ReferenceState]
    folder: Path
    record: RunRecord
    inputs: Mapping[str, bytes]
    report: Report
    compiled_before: float = field(default_factory=seconds_compiling)
    frames: FrameWriter | None = None
    frame_times: list[float] | None = None

    def restored(self, arrays: dict[str, NDArray]) -> TissueState:
        """Return the state that a checkpoint holds, and note its frames."""
        state = TissueState.from_arrays(arrays)
        self.frame_times = state.journal["frames.t"].tolist()
        return state

    def compute(self, run: RunFolder, state: TissueState | None) -> TissueRun:
        """Run to the end."""
        return simulate_tissue(
            self.parts.problem,
            self.parts.cells,
            self.recipe.tissue,
            reference=self.references,
            kind=self.parts.kind,
            outlined=self.parts.outlined,
            progress=lambda t, duration: self.report(t, "" if t > 0.0 else "relaxing without load"),
            checkpoint=partial(self._checkpoint, run),
            checkpoint_interval=CHECKPOINT_INTERVAL,
            resume=state,
            keep_frame=self._keep,
        )

    def _keep(self, frame: ParticleFrames, count: int, of: Particles) -> None:
        """Write a frame as the next after `count` others."""
        if self.frames is None:
            self.frames = particle_writer(self.folder, *of)
            if self.frame_times is not None:
                self.frames.resume(self.frame_times)
        self.frames.write(count, float(frame.t[0]), *fields_of_particles(frame))

    def _checkpoint(self, run: RunFolder, state: TissueState) -> None:
        """Write a checkpoint with the frames that belong to its state."""
        if self.frames is not None:  # first: a run that resumes needs all that this state recorded
            self.frames.flush()
        run.checkpoint(state.to_arrays())

    def store(self, record: RunRecord, result: TissueRun) -> RunRecord:
        """Write the results, whole or not, and return the record with what they cost."""
        write_curves(self.folder, result.curves, result.history, result.energies)
        if self.frames is None:  # the run had ended before its last checkpoint
            self.frames = particle_writer(
                self.folder, result.position, result.bonds, result.is_wall
            )
            self.frames.resume(result.frames.t.tolist())
        self.frames.close()
        compilation = seconds_compiling() - self.compiled_before
        return replace(
            record,
            wall_time={**result.wall_time, "compilation": compilation},
            counts=result.counts,
            threads=result.threads,
        )

    def close(self) -> None:
        """Leave all: a run of particles keeps nothing that only an unfinished one needs."""


def tissue_summary(record: RunRecord) -> str:
    """Summarise a finished run and its cost."""
    wall = record.wall_time
    counts = record.counts
    rate = counts["particle_steps"] / max(wall["run"], 1e-9) / 1e6
    return (
        f"{record.duration:g} µs of {counts['particles']} particles in "
        f"{time_text(wall['total'])} (relaxation {time_text(wall['relaxation'])}, run "
        f"{time_text(wall['run'])}; compilation {time_text(wall.get('compilation', 0.0))} "
        f"besides), {counts['steps']} steps, {rate:.3g} million particle-steps/s"
    )

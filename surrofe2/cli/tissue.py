"""`surrofe2 tissue`: the full microscopic tissue under a recipe's load case, into a run folder."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from surrofe2.cli.console import duration, progress, say
from surrofe2.cli.options import RecipeFile, ReplaceRun, ResumeRun, RunFolder, Threads
from surrofe2.cli.run_records import keeping_run, new_record
from surrofe2.errors import InputError, SimulationError

if TYPE_CHECKING:
    from surrofe2.io.runs import RunRecord
    from surrofe2.recipe import Recipe
    from surrofe2.tissue import Tissue, TissueRun

CHECKPOINT_INTERVAL = 5.0  # s
LAW = "tissue"


def run_tissue(
    recipe: Recipe,
    folder: Path,
    *,
    threads: int | None = None,
    resume: bool = False,
    force: bool = False,
    report: Callable[[float, str], None] = lambda t, note: None,
) -> RunRecord:
    """Run the recipe's load case on a tissue of plant cells and write the run folder.

    A run that fails or is interrupted leaves what it computed, and its record says how it ended.

    Args:
        report: called with the time reached in µs and a remark.

    Raises:
        SimulationError: the run could not be carried on; the folder holds it up to there.
    """
    from surrofe2.cli.laws import use_threads
    from surrofe2.io.checkpoints import read_checkpoint, write_checkpoint
    from surrofe2.io.runs import ended, open_run_folder, write_record
    from surrofe2.tissue import TissueState, simulate_tissue

    used = use_threads(threads)
    cells = cells_of(recipe)
    record = new_record(recipe, LAW, used)
    record = replace(record, initialisation="none", solver="leapfrog", seed=None)
    earlier = open_run_folder(folder, record, resume=resume, force=force)
    if earlier is not None and earlier.status == "finished":
        return earlier
    checkpoint, of = folder / "checkpoint.h5", "a tissue run"
    state = None
    if earlier is not None and checkpoint.exists():
        state = TissueState.from_arrays(read_checkpoint(checkpoint, of))
    write_record(folder, record)
    tissue = build_tissue(recipe, cells)
    compilation = warm_up(tissue)
    try:
        done = simulate_tissue(
            recipe.load,
            tissue,
            recipe.tissue,
            progress=lambda t, duration: report(t, "" if t > 0.0 else "relaxing without load"),
            checkpoint=lambda state: write_checkpoint(checkpoint, state.to_arrays(), of),
            checkpoint_interval=CHECKPOINT_INTERVAL,
            resume=state,
        )
    except SimulationError as error:
        record = ended(record, "failed", str(error))
        _store(folder, record, cast("TissueRun | None", error.partial), compilation)
        raise
    except KeyboardInterrupt:
        write_record(folder, ended(record, "interrupted"))
        raise
    record = _store(folder, ended(record, "finished"), done, compilation)
    checkpoint.unlink(missing_ok=True)
    return record


def cells_of(recipe: Recipe) -> tuple[int, int]:
    """Plant cells in x and y that fill the load case's rectangle.

    Raises:
        InputError: no whole number of them does.
    """
    side = recipe.cell.cell_side
    counts = []
    for name in ("width", "height"):
        extent = getattr(recipe.load, name)
        count = round(extent / side)
        if count < 1 or abs(count * side - extent) > 1e-9 * extent:
            raise InputError(
                f"load.{name}: {extent:g}; a tissue needs a whole number of plant cells of "
                f"{side:g} µm: change it or give --cells N M"
            )
        counts.append(count)
    return counts[0], counts[1]


def resized(recipe: Recipe, cells: tuple[int, int]) -> Recipe:
    """The recipe on a rectangle of so many plant cells, its watched point moved along.

    Raises:
        InputError: less than one in a direction.
    """
    if min(cells) < 1:
        raise InputError(f"--cells: {cells[0]} {cells[1]}; both must be at least 1")
    load, side = recipe.load, recipe.cell.cell_side
    width, height = cells[0] * side, cells[1] * side
    watched = load.watched[0] * width / load.width, load.watched[1] * height / load.height
    changed = replace(load, width=width, height=height, watched=watched)
    return replace(recipe, load=changed)


def build_tissue(recipe: Recipe, cells: tuple[int, int]) -> Tissue:
    """Copies of the plant cell whose periodic unit is free of stress."""
    from surrofe2.rve import RveLaw
    from surrofe2.tissue import make_tissue

    law = RveLaw(recipe.cell)
    return make_tissue(recipe.cell, law.reference_position, law.rest_length, cells)


def warm_up(tissue: Tissue) -> float:
    """Ask for forces and energy once, so that compilation is not in the clock; seconds it took."""
    from surrofe2.tissue import Motion

    begin = time.perf_counter()
    Motion(tissue).elastic_energy()
    return time.perf_counter() - begin


def _store(folder: Path, record: RunRecord, run: TissueRun | None, compilation: float) -> RunRecord:
    """Write everything of a run; run.json last, so that a finished record has all its files."""
    from surrofe2.io.runs import write_curve, write_energies, write_record
    from surrofe2.io.tissue_fields import write_particle_fields

    if run is not None:
        write_curve(folder, run.curve)
        write_energies(folder, run.curve.t, run.energies)
        write_particle_fields(folder, run.position, run.bonds, run.is_wall, run.frames)
        record = replace(
            record,
            wall_time={**run.wall_time, "compilation": compilation},
            counts=run.counts,
            threads=run.threads,
        )
    write_record(folder, record)
    return record


def tissue(
    recipe: RecipeFile,
    out: RunFolder,
    cells: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="N M",
            help="Plant cells in x and y, which then set the extent; default: those that fill "
            "the recipe's.",
        ),
    ] = None,
    micro_step: Annotated[
        float | None, typer.Option(metavar="DT", help="Longest step in µs; default: the recipe's.")
    ] = None,
    threads: Threads = None,
    resume: ResumeRun = False,
    force: ReplaceRun = False,
) -> None:
    """Run the recipe's load case on all particles of the tissue: what FE² approximates.

    Walls at the free boundary are single; particles at x = 0 are held. The tissue is relaxed
    without load, then loaded. DIR receives run.json (configuration, costs), curve.csv (t in µs,
    displacement of the watched particle in µm), energies.csv (pJ) and fields.xdmf for ParaView.

    Example: [bold]surrofe2 tissue data/bending-bar.toml --out out/tissue[/bold]

    Next: [bold]surrofe2 compare out/tissue out/rve --out out/comparison[/bold]
    """
    # Its threads meet every 0.1 ms; they must not fall asleep in between, as others should.
    os.environ.setdefault("GOMP_SPINCOUNT", "20000")
    from surrofe2.recipe import load_recipe

    study = load_recipe(recipe)
    if cells is not None:
        study = resized(study, cells)
    if micro_step is not None:
        study = replace(study, tissue=replace(study.tissue, micro_step=micro_step))
    with keeping_run(out), progress("full tissue", study.load.duration, "µs") as report:
        record = run_tissue(study, out, threads=threads, resume=resume, force=force, report=report)
    say(f"{out}: {tissue_summary(record)}")


def tissue_summary(record: RunRecord) -> str:
    """What a finished run did and what it cost."""
    wall, counts = record.wall_time, record.counts
    rate = counts["particle_steps"] / max(wall["run"], 1e-9) / 1e6
    return (
        f"{record.recipe['load']['duration']:g} µs of {counts['particles']} particles in "
        f"{duration(wall['total'])} (relaxation {duration(wall['relaxation'])}, run "
        f"{duration(wall['run'])}; compilation {duration(wall.get('compilation', 0.0))} before), "
        f"{counts['steps']} steps, {rate:.3g} million particle-steps/s"
    )

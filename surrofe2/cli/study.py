"""`surrofe2 new`, `check`, `study` and `grid`: a recipe, what it needs, all of it, many of it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from surrofe2.base.errors import InputError, SimulationError, quoted
from surrofe2.base.units import rough_number, rough_time
from surrofe2.cli import console
from surrofe2.cli.compare import REPORT, show_comparison
from surrofe2.recipe.entries import listed_values
from surrofe2.recipe.recipe import CellStudy, Recipe
from surrofe2.recipe.schema import TEMPLATES, write_recipe
from surrofe2.report.comparison import compare_runs
from surrofe2.run.loop import Stage
from surrofe2.store.run_folder import RunRecord
from surrofe2.workflow import check as checking
from surrofe2.workflow import scale
from surrofe2.workflow.generate import data_summary
from surrofe2.workflow.grid import GRID_TABLES, run_grid
from surrofe2.workflow.laws import open_study, recipe_notes, use_threads
from surrofe2.workflow.rest import (
    extent_of,
    notes_of,
    response_lines,
    study_by_method,
    summary_of,
)
from surrofe2.workflow.run import sharp_bodies, sharp_notes
from surrofe2.workflow.train import is_trained, large_errors, learn, training_summary
from surrofe2.workflow.workers import executor_of


def new(
    name: Annotated[Path, typer.Argument(metavar="NAME", help="Recipe name; .toml is appended.")],
    example: Annotated[
        str, typer.Option(metavar="KIND", help=f"{', '.join(TEMPLATES)}; default: bar.")
    ] = "bar",
    fresh: console.Fresh = False,
) -> None:
    """Write a recipe to start from, with unit and meaning of each key.

    bar is the paper's bending bar, strip one that is pulled and held, contact a block between
    two plates, mesh a mesh file of your own, voronoi irregular plant cells, cells several kinds of
    plant cell by region.

    Example: surrofe2 new press --example contact

    Next: surrofe2 check press.toml
    """
    path = name if name.suffix == ".toml" else name.with_name(f"{name.name}.toml")
    first, *others = write_recipe(path, example, fresh=fresh)
    beside = "".join(f", with {other}" for other in others)
    console.done(first, f"recipe of {TEMPLATES[example]}{beside}", timed=False)
    console.print_line(f"next: surrofe2 check {path}, after changes; then generate, train, run")


def check(
    recipe: console.RecipeFile,
    only: Annotated[
        bool, typer.Option("--only", help="Read the recipe and its files; no dry run.")
    ] = False,
    margin: Annotated[
        float, typer.Option(metavar="X", help="Strain and rate beyond what was met, as a fraction.")
    ] = checking.MARGIN,
    seconds: Annotated[
        float, typer.Option(min=0.0, metavar="S", help="Processor time of the dry runs, s.")
    ] = checking.SECONDS,
    threads: console.Threads = None,
) -> None:
    """Check a recipe: its faults, the range it needs, how long it takes, which law to take.

    Reports everything that is wrong with the recipe, its mesh, names and files, and what each
    boundary and region of the mesh holds; each plant cell both as an experiment would tell of it
    (size, turgor, walls) and by its constants; the time scales of tissue and loads, and so whether
    to run in time or at rest. Then a dry run or rest by the tangents of the RVE at rest proposes
    the [range], to be copied into the recipe, on a coarser mesh where the recipe's takes too long.
    It knows neither stiffening nor loss of stability; the margin is for that. The number
    of RVEs to solve and the time of one give the order of magnitude of a run by RVEs, beside which
    stands what all particles of the tissue would take. Elements that are smaller than a plant cell,
    or than an RVE is wide, are warned of. Nothing is written.

    Example: surrofe2 check data/large-bar.toml

    Next: surrofe2 study data/large-bar.toml
    """
    faults = checking.recipe_faults(recipe)
    if not faults:
        study = open_study(recipe, threads)
        console.show_notes(recipe_notes(study))
        mesh, merged = checking.checked_mesh(study)
        # a recipe may be for RVEs alone: what a surrogate lacks is reported, and is no fault
        faults = checking.study_faults(mesh, ("rve",))
    for message in faults:
        console.print_warning(message)
    if faults:
        raise InputError(f"{recipe}: {len(faults)} problem{'s' * (len(faults) > 1)} found")
    _show_content(study, mesh, merged)
    if only:
        console.done(recipe, "no problem found")
        return
    scales = checking.scales_of(study)
    console.print_line(f"time scales: {scales.sentence}")
    is_rest = study.rest is not None or scales.is_slow
    what, extent = ("rest", (1.0, "loads")) if is_rest else ("run", (study.duration, "µs"))
    with console.working(f"dry {what}", *extent, "nothing was changed") as report:
        if is_rest:
            run = checking.dry_rest(study, seconds, report)
        else:
            run = checking.dry_run(study, seconds, report)
        by_rves = checking.seconds_by_rves(study, run)
        particles = scale.all_particles(mesh)
    _show_ranges(run, margin)
    remark = None if is_rest else study.macro.remark(run.displacement)
    if remark is not None:
        console.print_warning(remark)
    console.print_line(
        f"{run.points:,} points, about {rough_number(run.calls, 2)} evaluations of the stress: "
        f"{rough_number(run.solves)} RVE solves. The {what} would take "
        f"about {rough_time(by_rves / 2.0)} to {rough_time(2.0 * by_rves)} by --law rve"
    )
    console.show_notes(scale.sap_notes(study))
    console.print_line(scale.particles_sentence(particles))
    advised = checking.advised_law(study, by_rves, at_rest=is_rest)
    advice = f"use --law {advised}"
    if is_rest and study.rest is None:
        advice = f"quasi-static: use `surrofe2 rest {recipe} --law {advised}`, or state [rest]"
    if not is_rest and particles.is_possible and particles.seconds < by_rves:
        advice = f"use `surrofe2 tissue {recipe}`: all particles take less than FE²"
    # without the seconds of the check, which would read as those of the law
    console.done(recipe, advice, timed=False)


def _show_content(study: Recipe, mesh: Recipe, merged: int) -> None:
    """Print what mesh and cells of a recipe are, and warnings about them.

    Args:
        study: the recipe.
        mesh: the recipe with the mesh that is checked; see `checking.checked_mesh`.
        merged: how often its elements were merged, two each way into one; 0: never.
    """
    if merged:
        along, across = mesh.mesh.elements or (0, 0)
        console.print_line(f"the mesh is large: checked with {along} × {across} elements")
    for line in (*checking.parts_of_mesh(mesh), *checking.lines_of_cells(study)):
        console.print_line(line)
    without = [
        of_cell.section("range")
        for of_cell in study.studies().values()
        if of_cell.cell.range is None
    ]
    if without:
        console.print_line(f"No [{without[0]}]: only `--law rve` can run this recipe.")
    else:
        for message in checking.study_faults(mesh, ("rve", "cached")):
            console.print_line(f"not by --law cached or surrogate: {message}")
    for message, _ in sharp_notes(sharp_bodies(mesh.problem())):
        console.print_warning(message)
    for message in scale.scale_warnings(mesh, merged):
        console.print_warning(message)


def _show_ranges(run: checking.DryRun, margin: float) -> None:
    """Print the [range] of each cell that a dry run proposes; all but its entries are comments."""
    if run.omitted:
        console.print_line(f"# this range holds only a part of the run; left out: {run.omitted}")
    for cell, met in run.met.items():
        low, high = met.stretch
        try:
            section = checking.range_section(checking.proposed_range(met, margin), cell)
            for line in section.splitlines():
                console.print_line(line)
        except InputError as error:
            console.print_warning(str(error))
        console.print_line(
            f"# by the quadratic law of the RVE at rest: met stretch {low:.4g} to {high:.4g}, "
            f"shear {met.shear:.3g}, rate {met.rate:.3g} 1/µs; margin {100.0 * margin:g} %"
        )


def study(
    recipe: console.RecipeFile,
    out: console.OutFolder = None,
    law: Annotated[
        Literal["cached", "table"],
        typer.Option(
            metavar="LAW",
            help="Beside full FE²: cached, by the surrogate; or table, which needs no training.",
        ),
    ] = "cached",
    true: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="A full run to compare with; then none is made."),
    ] = None,
    without_true: Annotated[
        bool, typer.Option("--without-true", help="No full run, so nothing to compare with.")
    ] = False,
    fresh: console.Fresh = False,
    threads: console.Threads = None,
) -> None:
    """All of a recipe: data set, training, full run, cached run, comparison.

    Runs every missing step, and resumes one that was interrupted. DIR receives a run folder
    for each law, rve and cached, the comparison, and all of it on one page, report.html; data set
    and surrogate are the recipe's.

    Example: surrofe2 study data/bending-bar.toml

    Before a long one: surrofe2 check data/bending-bar.toml
    """
    from surrofe2.report.page import write_report  # here, since `check` needs no matplotlib

    if true is not None and without_true:
        raise InputError("--true: not with --without-true; leave one of them out")
    stated = open_study(recipe, threads)
    console.show_notes(recipe_notes(stated))
    console.show_notes(scale.sap_notes(stated))
    folder = console.folder_of(out, recipe)
    laws = (law,) if true is not None or without_true else ("rve", law)
    first = 3 if law == "cached" else 1
    last = first - 1 + len(laws)
    folders = [] if true is None else [true]
    records = list[RunRecord]()
    kept = "finished steps, samples and iterations, and the run's last checkpoint are kept"
    with console.on_interrupt(kept), console.stages() as stage:
        faults = checking.study_faults(stated, laws, fresh=fresh)
        if faults:
            more = f"; and {len(faults) - 1} more, see `surrofe2 check`" if faults[1:] else ""
            raise InputError(f"{faults[0]}{more}")
        if law == "cached":
            for cell_study in stated.studies().values():
                _learn(cell_study, last, fresh, stage)
        for k, law_of_run in enumerate(laws, first):
            run_folder = folder / law_of_run
            with stage(f"{k}/{last} run by {law_of_run}", *extent_of(stated)) as report:
                record = study_by_method(stated, law_of_run, run_folder, fresh=fresh, report=report)
            for line in response_lines(run_folder, record):
                console.print_line(f"{k}/{last} {line}")
            console.print_line(f"{k}/{last} {run_folder}: {summary_of(record)}")
            records.append(record)
            folders.append(run_folder)
        # the comparison is made again: it takes no time, and its table is what people come for
        out = folder / "comparison"
        several = len(folders) > 1
        comparison = compare_runs(folders, out, fresh=True) if several else None
        page = write_report(folders, folder / REPORT)
        console.print_line(f"{page}: all of it on one page")
    if comparison is not None:
        show_comparison(comparison)
    # Runs by several laws may have the same to say of their mesh and bodies.
    notes = dict.fromkeys(note for record in records for note in notes_of(record, stated))
    console.show_notes(note for note in notes if note[1] or comparison is None)
    console.done(folder, "all steps done")


def _learn(cell_study: CellStudy, last: int, fresh: bool, stage: Stage) -> None:
    """Make the data set and the surrogate of a cell, whatever is missing of both."""
    path = cell_study.training_path()
    has_data = cell_study.data_path().exists()
    if not (fresh or has_data) and is_trained(cell_study):  # it needs no data set
        console.print_line(f"2/{last} surrogate {path}: already trained")
        return
    data, trained = learn(cell_study, fresh=fresh, stage=stage)
    console.print_line(f"1/{last} data set {data.path}: {data_summary(data)}")
    console.print_line(f"2/{last} surrogate {path}: {training_summary(trained)}")
    for line in trained.bound.splitlines():
        console.print_line(line)
    warning = large_errors(cell_study, trained)
    if warning is not None:
        console.print_warning(warning)


def grid(
    recipe: console.RecipeFile,
    entries: Annotated[
        list[str],
        typer.Option(
            "--set",
            metavar="KEY=VALUES",
            help="An entry of the recipe and its values: A,B,… or FIRST:LAST:COUNT, at equal "
            "ratios FIRST:LAST:COUNT:log; may be repeated.",
        ),
    ],
    law: Annotated[
        str, typer.Option(metavar="LAW,…", help="Of rve, cached, table and surrogate.")
    ] = "rve",
    quantity: Annotated[
        list[str] | None,
        typer.Option(
            metavar="COLUMN[:WHAT]",
            help="Of each run, e.g. 'force grip y:slope'; WHAT is maximum, end, slope, work or "
            "period; may be repeated. Default: the peak of each force over its displacement.",
        ),
    ] = None,
    out: console.OutFolder = None,
    workers: console.Workers = 0,
    scheduler: console.Scheduler = None,
    form: console.PictureFormat = "png",
    threads: console.Threads = None,
    fresh: console.Fresh = False,
) -> None:
    """Run the recipe with all combinations of values: a parameter study.

    Each combination runs by each law; a new data set and surrogate are made only where a change
    affects the cell or its range. With --law rve,cached the table has the errors and the speed-up
    of the cache. DIR receives a run folder for each, grid.csv, grid.json and grid.png
    (with --format pdf or svg).

    Example: surrofe2 grid data/bending-bar.toml --set cell.wall_stiffness=3000:5000:8

    Errors over the tolerance: surrofe2 grid RECIPE --law rve,cached
    --set cache.tolerance=1e-4:1e-1:7:log
    """
    values: dict[str, list[Any]] = {}
    for entry in entries:
        name, sign, text = entry.partition("=")
        if not sign or name in values:
            why = "it is there twice" if sign else "it must be KEY=VALUES"
            raise InputError(f"--set: {quoted(entry)}; {why}")
        values[name] = listed_values(name, text)
    use_threads(threads)
    folder = console.folder_of(out, recipe)
    kept = console.on_interrupt(f"{folder} keeps what is finished")
    with kept, executor_of(workers, scheduler) as executor:
        result = run_grid(
            recipe,
            values,
            folder,
            laws=law.split(","),
            quantities=quantity or (),
            threads=threads,
            executor=executor,
            form=form,
            fresh=fresh,
            stage=console.progress,
        )
    title = f"{recipe.name}, {len(result.rows)} runs"
    console.show_table(title, result.table)
    console.done(folder, f"{len(result.rows)} runs, {', '.join(GRID_TABLES)}, grid.{form}")
    if result.failed:
        name, message = next(iter(result.failed.items()))
        raise SimulationError(
            f"{len(result.failed)} of {len(result.rows)} runs failed, {name} first: {message}"
        )

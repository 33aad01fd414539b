"""`surrofe2 run`: the macroscopic tissue by a chosen stress law, into a run folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from surrofe2.cli.cache_notes import cache_notes, cache_report, resume_cache
from surrofe2.cli.console import complain, duration, progress, say
from surrofe2.cli.options import (
    Initialisation,
    RecipeFile,
    ReplaceRun,
    ResumeRun,
    RunFolder,
    SurrogateFile,
    Threads,
)
from surrofe2.cli.reaping import Reaping, counts_of
from surrofe2.cli.run_records import keeping_run, new_record
from surrofe2.errors import SimulationError

if TYPE_CHECKING:
    from surrofe2.cache import StressTable
    from surrofe2.cli.laws import ChosenLaw
    from surrofe2.io.runs import RunRecord
    from surrofe2.macro import MacroRun
    from surrofe2.recipe import Recipe

CHECKPOINT_INTERVAL = 5.0  # s


def run_study(
    recipe: Recipe,
    kind: str,
    folder: Path,
    *,
    chosen: ChosenLaw | None = None,
    surrogate_file: Path | None = None,
    tables: Sequence[Path] = (),
    harvest: bool = True,
    threads: int | None = None,
    resume: bool = False,
    force: bool = False,
    report: Callable[[float, str], None] = lambda t, note: None,
) -> RunRecord:
    """Run the recipe's load case by the law called `kind` and write the run folder.

    A run that fails or is interrupted leaves what it computed, and its record says how it ended.

    Args:
        chosen: the law to use, where it is not the recipe's.
        tables: files of tables to start from; the run's own is written into the folder.
        harvest: whether true answers of a cached run are kept in the folder.
        report: called with the time reached in µs and a remark.

    Raises:
        SimulationError: the run could not be carried on; the folder holds it up to there.
    """
    from surrofe2.cli.laws import choose_law, use_threads, warm_up
    from surrofe2.io.checkpoints import read_checkpoint, write_checkpoint
    from surrofe2.io.runs import ended, open_run_folder, write_record
    from surrofe2.macro import MacroState, simulate

    used = use_threads(threads)
    reaping = Reaping(recipe, folder, harvest and kind in ("cached", "table"))
    chosen = chosen or choose_law(recipe, kind, surrogate_file, tables, reaping.keep)
    record = new_record(recipe, kind, used, chosen.surrogate)
    earlier = open_run_folder(folder, record, resume=resume, force=force)
    if earlier is not None and earlier.status == "finished":
        return earlier
    checkpoint, of = folder / "checkpoint.h5", f"a {kind} run"
    state = None
    if earlier is not None and checkpoint.exists():
        state = MacroState.from_arrays(read_checkpoint(checkpoint, of))
        reaping.resume(chosen.table)
    if earlier is not None and earlier.cache is not None:
        resume_cache(chosen.law, earlier.cache)
    write_record(folder, record)

    def store_checkpoint(state: MacroState) -> None:
        reaping.store(chosen.table)
        write_checkpoint(checkpoint, state.to_arrays(), of)
        write_record(folder, replace(record, cache=cache_report(chosen.law)))

    try:
        compilation = warm_up(chosen.parts, recipe.macro, chosen.table)
        done = simulate(
            recipe.load,
            chosen.law,
            recipe.macro,
            progress=lambda t, duration: report(t, ""),
            checkpoint=store_checkpoint,
            checkpoint_interval=CHECKPOINT_INTERVAL,
            resume=state,
        )
    except SimulationError as error:
        record = replace(ended(record, "failed", str(error)), cache=cache_report(chosen.law))
        reaping.store(chosen.table)
        partial = cast("MacroRun | None", error.partial)
        _store(folder, record, partial, compilation, chosen.table)
        raise
    except KeyboardInterrupt:
        cache = cache_report(chosen.law)
        write_record(folder, replace(ended(record, "interrupted"), cache=cache))
        raise
    reaping.store(chosen.table)
    record = replace(ended(record, "finished"), cache=cache_report(chosen.law, whole=True))
    record = _store(folder, record, done, compilation, chosen.table)
    checkpoint.unlink(missing_ok=True)
    return record


def _store(
    folder: Path,
    record: RunRecord,
    run: MacroRun | None,
    compilation: float,
    table: StressTable | None = None,
) -> RunRecord:
    """Write everything of a run; run.json last, so that a finished record has all its files."""
    from surrofe2.io.fields import write_fields
    from surrofe2.io.runs import write_curve, write_energies, write_record

    if run is not None:
        write_curve(folder, run.curve)
        write_energies(folder, run.curve.t, run.energies)
        write_fields(folder, run.nodes, run.quads, run.frames)
        record = replace(
            record,
            wall_time={**run.wall_time, "compilation": compilation},
            counts={**run.counts, **run.effort, **counts_of(table)},
            met=_met(run),
            threads=run.threads,
        )
    write_record(folder, record)
    return record


def _met(run: MacroRun) -> dict[str, Any]:
    summary = {"stretch": run.met.stretch, "shear": run.met.shear, "rate": run.met.rate}
    return asdict(run.met) | summary


def run(
    recipe: RecipeFile,
    law: Annotated[
        Literal["rve", "surrogate", "cached", "table"],
        typer.Option(
            help="True RVEs, the surrogate alone, the surrogate with RVEs where it is out of "
            "its range, or a table that learns from RVEs as it goes, without any training."
        ),
    ],
    out: RunFolder,
    surrogate: SurrogateFile = None,
    table: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE",
            help="Table (.h5) to start from, e.g. table.h5 of an earlier run; more than one are "
            "merged. Default: an empty one.",
        ),
    ] = None,
    harvest: Annotated[
        bool, typer.Option(help="Keep the true answers of cached runs in DIR/harvest.h5.")
    ] = True,
    initialisation: Initialisation = None,
    solver: Annotated[
        str | None, typer.Option(help="How constrained runs are solved; default: the recipe's.")
    ] = None,
    integrator: Annotated[
        Literal["explicit", "implicit"] | None,
        typer.Option(help="Time integration (implicit: not --law table); default: the recipe's."),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            metavar="X",
            help="Cached: allowed error of a stress relative to the spread of stress; default: "
            "the recipe's.",
        ),
    ] = None,
    audit: Annotated[
        float | None,
        typer.Option(
            metavar="SHARE",
            help="Cached: share of its answers that RVEs check, 1: all; default: the recipe's.",
        ),
    ] = None,
    threads: Threads = None,
    resume: ResumeRun = False,
    force: ReplaceRun = False,
) -> None:
    """Run the recipe's load case: a tissue clamped at its left, pulled by a body force.

    DIR receives run.json (configuration, costs), curve.csv (t in µs, displacement of the watched
    point in µm), energies.csv (pJ) and fields.xdmf for ParaView; with --law table the table, with
    --law cached or table the harvest of true stresses.

    Example: [bold]surrofe2 run data/bending-bar.toml --law cached --out out/cached[/bold]

    Next: [bold]surrofe2 compare out/rve out/cached --out out/comparison[/bold]
    """
    from surrofe2.recipe import load_recipe

    study = change_rve(load_recipe(recipe), initialisation, solver)
    study = change_cache(study, tolerance, audit)
    if integrator is not None:
        study = replace(study, macro=replace(study.macro, integrator=integrator))
    with keeping_run(out), progress(f"run by {law}", study.load.duration, "µs") as report:
        record = run_study(
            study,
            law,
            out,
            surrogate_file=surrogate,
            tables=table or (),
            harvest=harvest,
            threads=threads,
            resume=resume,
            force=force,
            report=report,
        )
    say(f"{out}: {summary(record)}")
    for sentence, is_warning in cache_notes(record):
        (complain if is_warning else say)(sentence)


def change_rve(recipe: Recipe, initialisation: str | None, solver: str | None) -> Recipe:
    """The recipe with another way to initialise its RVEs."""
    usual = recipe.rve
    rve = replace(
        usual,
        initialisation=initialisation or usual.initialisation,
        solver=solver or usual.solver,
    )
    return replace(recipe, rve=rve)


def change_cache(recipe: Recipe, tolerance: float | None, audit: float | None) -> Recipe:
    """The recipe with another tolerance or audit of the cache."""
    usual = recipe.cache
    cache = replace(
        usual,
        tolerance=usual.tolerance if tolerance is None else tolerance,
        audit=usual.audit if audit is None else audit,
    )
    return replace(recipe, cache=cache)


def summary(record: RunRecord) -> str:
    """What a finished run did and what it cost."""
    wall, counts = record.wall_time, record.counts
    return (
        f"{record.recipe['load']['duration']:g} µs by {record.law} in "
        f"{duration(wall['total'])} (law {duration(wall['law'])}, macro {duration(wall['macro'])}; "
        f"compilation {duration(wall.get('compilation', 0.0))} before), {costs(counts)}"
    )


def costs(counts: Mapping[str, int]) -> str:
    """Stress points, RVE solves and, for cached laws, hits and fallbacks by reason."""
    asked = counts["stress_points"] + counts.get("dissipation_points", 0)
    text = f"{asked} stresses, {counts.get('rve_solves', 0)} RVE solves"
    if "hits" not in counts:
        return text
    reasons = [
        f"{n} {name.removeprefix('fallbacks_').replace('_', ' ')}"
        for name, n in counts.items()
        if name.startswith("fallbacks_") and n
    ]
    fallbacks = f"{counts.get('fallbacks', 0)} fallbacks"
    text += f", {counts['hits']} hits, {fallbacks}" + (
        f" ({', '.join(reasons)})" if reasons else ""
    )
    records = counts.get("table_records")
    return text if records is None else f"{text}, table of {records} records"

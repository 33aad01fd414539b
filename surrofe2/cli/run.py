"""`surrofe2 run`: the macroscopic tissue by a chosen stress law, into a run folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

import typer

from surrofe2.cli.console import InterruptedWork, duration, progress, say
from surrofe2.errors import SimulationError

if TYPE_CHECKING:
    from surrofe2.cli.laws import ChosenLaw
    from surrofe2.config import Recipe
    from surrofe2.io.runs import RunRecord
    from surrofe2.macro import MacroRun

CHECKPOINT_INTERVAL = 5.0  # s


def run_study(
    recipe: Recipe,
    kind: str,
    folder: Path,
    *,
    chosen: ChosenLaw | None = None,
    surrogate_file: Path | None = None,
    threads: int | None = None,
    resume: bool = False,
    force: bool = False,
    report: Callable[[float, str], None] = lambda t, note: None,
) -> RunRecord:
    """Run the recipe's load case by the law called `kind` and write the run folder.

    A run that fails or is interrupted leaves what it computed, and its record says how it ended.

    Args:
        chosen: the law to use, where it is not the recipe's.
        report: called with the time reached in µs and a remark.

    Raises:
        SimulationError: the run could not be carried on; the folder holds it up to there.
    """
    from surrofe2.cli.laws import choose_law, use_threads, warm_up
    from surrofe2.io.checkpoints import read_checkpoint, write_checkpoint
    from surrofe2.io.runs import ended, open_run_folder, write_record
    from surrofe2.macro import MacroState, simulate

    used = use_threads(threads)
    chosen = chosen or choose_law(recipe, kind, surrogate_file)
    record = new_record(recipe, kind, chosen, used)
    earlier = open_run_folder(folder, record, resume=resume, force=force)
    if earlier is not None and earlier.status == "finished":
        return earlier
    checkpoint, of = folder / "checkpoint.h5", f"a {kind} run"
    state = None
    if earlier is not None and checkpoint.exists():
        state = MacroState.from_arrays(read_checkpoint(checkpoint, of))
    write_record(folder, record)
    compilation = warm_up(chosen.parts)
    try:
        done = simulate(
            recipe.load,
            chosen.law,
            recipe.macro,
            progress=lambda t, duration: report(t, ""),
            checkpoint=lambda state: write_checkpoint(checkpoint, state.to_arrays(), of),
            checkpoint_interval=CHECKPOINT_INTERVAL,
            resume=state,
        )
    except SimulationError as error:
        record = ended(record, "failed", str(error))
        _store(folder, record, cast("MacroRun | None", error.partial), compilation)
        raise
    except KeyboardInterrupt:
        write_record(folder, ended(record, "interrupted"))
        raise
    record = _store(folder, ended(record, "finished"), done, compilation)
    checkpoint.unlink(missing_ok=True)
    return record


def new_record(recipe: Recipe, kind: str, chosen: ChosenLaw, threads: int) -> RunRecord:
    """The record of a run by the law called `kind` that is about to start."""
    from datetime import UTC, datetime
    from importlib.metadata import version

    from surrofe2.cli.platforms import describe_platform
    from surrofe2.io.runs import RunRecord

    return RunRecord(
        status="running",
        recipe=recipe.to_dict(),
        law=kind,
        initialisation=recipe.rve.initialisation,
        solver=recipe.rve.solver,
        package_version=version("surrofe2"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        cell_fingerprint=recipe.cell.fingerprint,
        threads=threads,
        seed=recipe.samples.seed,
        surrogate=chosen.surrogate,
        platform=describe_platform(),
    )


def _store(folder: Path, record: RunRecord, run: MacroRun | None, compilation: float) -> RunRecord:
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
            counts={**run.counts, **run.effort},
            met=_met(run),
            threads=run.threads,
        )
    write_record(folder, record)
    return record


def _met(run: MacroRun) -> dict[str, Any]:
    summary = {"stretch": run.met.stretch, "shear": run.met.shear, "rate": run.met.rate}
    return asdict(run.met) | summary


def run(
    recipe: Annotated[Path, typer.Argument(metavar="RECIPE", help="The study's TOML file.")],
    law: Annotated[
        Literal["rve", "surrogate", "cached"],
        typer.Option(
            help="True RVEs, the surrogate alone, or the surrogate with RVEs where it "
            "is out of its range."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="The run folder to write.")],
    surrogate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Surrogate (.pt); default: the recipe's.")
    ] = None,
    initialisation: Annotated[
        str | None, typer.Option(help="How RVEs are initialised; default: the recipe's.")
    ] = None,
    solver: Annotated[
        str | None, typer.Option(help="How constrained runs are solved; default: the recipe's.")
    ] = None,
    integrator: Annotated[
        Literal["explicit", "implicit"] | None,
        typer.Option(help="Time integration (implicit: --law rve); default: the recipe's."),
    ] = None,
    threads: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="Threads; default: all cores.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue the interrupted run in DIR.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the run in DIR.")] = False,
) -> None:
    """Run the recipe's load case: a tissue clamped at its left, pulled by a body force.

    DIR receives run.json (configuration, costs), curve.csv (t in µs, displacement of the watched
    point in µm), energies.csv (pJ) and fields.xdmf for ParaView.

    Example: [bold]surrofe2 run data/bending-bar.toml --law cached --out out/cached[/bold]

    Next: [bold]surrofe2 compare out/rve out/cached --out out/comparison[/bold]
    """
    from surrofe2.config import load_recipe

    study = change_rve(load_recipe(recipe), initialisation, solver)
    if integrator is not None:
        study = replace(study, macro=replace(study.macro, integrator=integrator))
    try:
        with progress(f"run by {law}", study.load.duration, "µs") as report:
            record = run_study(
                study,
                law,
                out,
                surrogate_file=surrogate,
                threads=threads,
                resume=resume,
                force=force,
                report=report,
            )
    except KeyboardInterrupt:
        raise InterruptedWork(
            f"{out} keeps the run up to its last checkpoint; continue it by the same command "
            "with --resume"
        ) from None
    say(f"{out}: {summary(record)}")


def change_rve(recipe: Recipe, initialisation: str | None, solver: str | None) -> Recipe:
    """The recipe with another way to initialise its RVEs."""
    usual = recipe.rve
    rve = replace(
        usual,
        initialisation=initialisation or usual.initialisation,
        solver=solver or usual.solver,
    )
    return replace(recipe, rve=rve)


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
    return f"{text}, {counts['hits']} hits, {fallbacks}" + (
        f" ({', '.join(reasons)})" if reasons else ""
    )

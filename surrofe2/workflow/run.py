"""A recipe's problem by a stress law, and the folder that it is written to."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from surrofe2.base.compilation import seconds_compiling
from surrofe2.base.errors import InputError
from surrofe2.base.sampling import out_of_range
from surrofe2.base.units import time_text
from surrofe2.cache.branches import part_of, within
from surrofe2.macro import MacroRun, MacroState, simulate
from surrofe2.recipe.recipe import Recipe
from surrofe2.report.comparison import audit_sentence
from surrofe2.store.hdf5 import read_seconds
from surrofe2.store.run_folder import (
    CHECKPOINT_INTERVAL,
    RunFolder,
    RunRecord,
    caches_of,
    write_events,
)
from surrofe2.workflow.cell_laws import (
    NO_FILES,
    cache_report,
    choose_laws,
    decisions_of,
    law_arrays,
    law_state,
)
from surrofe2.workflow.laws import kept_reference
from surrofe2.workflow.progress import Report, no_report
from surrofe2.workflow.run_outputs import (
    RunOutputs,
    new_record,
    problem_record,
    with_results,
    write_results,
)
from surrofe2.workflow.surfaces import with_surface

MOST_IMPLICIT_STEPS = 3000
"""Of a tissue that rings; after as many the phase was three tolerances off (docs/theory.md)."""


def run_study(
    recipe: Recipe,
    kind: str,
    folder: Path,
    *,
    surrogates: Mapping[str, Path] = NO_FILES,
    tables: Sequence[Path] = (),
    harvest: bool = True,
    fresh: bool = False,
    report: Report = no_report,
) -> RunRecord:
    """Run the recipe's problem by the law called `kind` and write the run folder.

    Args:
        surrogates: files by name of the cell, instead of the recipe's.
        tables: files of tables to start from; the run's own are written into the folder.
        harvest: whether true answers of a cached run are kept in the folder.
        report: called with the time reached in µs.

    Raises:
        SimulationError: the run could not be carried on; the folder holds it up to there.
    """
    if kind == "table" and recipe.macro.integrator == "implicit":
        raise InputError(
            "macro.integrator: implicit; not with --law table, which has no tangents: take --law "
            "cached, surrogate or rve, or --integrator explicit"
        )
    problem = recipe.problem()
    before = seconds_compiling()
    outputs = RunOutputs(recipe, folder, harvest and kind in ("cached", "table"))
    chosen = choose_laws(recipe, kind, problem.mesh, surrogates, tables, outputs.taker)
    problem = with_surface(recipe, problem, kept_reference)
    earlier = sum(read_seconds(each) or 0.0 for each in tables)

    def store(record: RunRecord, result: MacroRun) -> RunRecord:
        record = with_results(record, result, chosen.tables)
        wall = {**record.wall_time, "compilation": seconds_compiling() - before}
        outputs.store(chosen.tables, earlier + wall.get("total", 0.0))
        write_results(folder, result)
        return replace(record, wall_time=wall)

    def checkpoint(state: MacroState) -> None:
        arrays = within("macro", state.to_arrays())
        arrays |= within("law", law_arrays(chosen.law, state.law_state))
        arrays |= within("harvest", outputs.to_arrays())
        run.checkpoint(arrays, cache_report(chosen.law))
        decisions = decisions_of(chosen.law)
        if decisions:
            write_events(folder, decisions)

    record = replace(new_record(recipe, kind, chosen.surrogate), problem=problem_record(problem))
    with RunFolder.open(folder, record, store, fresh=fresh) as run:
        if run.is_finished:
            return run.record
        state: MacroState | None = None
        with run.restoring() as arrays:
            if arrays is not None:
                macro, law = (part_of(arrays, name) for name in ("macro", "law"))
                state = MacroState.from_arrays(macro)
                state = replace(state, law_state=law_state(chosen.law, law))
                outputs.restore(part_of(arrays, "harvest"))
                run.cache = cache_report(chosen.law)
        report(0.0, "loading kernels")
        try:
            with recipe.named(InputError):
                result = simulate(
                    problem,
                    chosen.law,
                    recipe.macro,
                    progress=lambda t, duration: report(t, ""),
                    checkpoint=checkpoint,
                    checkpoint_interval=CHECKPOINT_INTERVAL,
                    resume=state,
                )
        except KeyboardInterrupt:
            outputs.store(chosen.tables)
            raise
        run.finish(result)
    return run.record


def contact_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """A sentence on each rigid body that was touched, with whether it is a warning.

    One is where the penetration exceeds a hundredth of an element's side.
    """
    of = record.problem
    if not of.get("penetration"):
        return
    (x0, y0), (x1, y1) = of["extent"]
    side = ((x1 - x0) * (y1 - y0) / of["elements"]) ** 0.5
    for name, depth in of["penetration"].items():
        if depth > 0.01 * side:
            wish = f"; a larger bodies.{name}.stiffness would lessen it"
            yield f"contact: {name} penetrates by {depth:.2g} µm{wish}", True
        elif depth > 0.0:
            yield f"contact: {name} penetrates by {depth:.2g} µm", False


def step_notes(record: RunRecord, recipe: Recipe) -> Iterator[tuple[str, bool]]:
    """A warning where so many implicit steps were taken that their errors of phase may count."""
    steps = record.counts["steps"]
    if recipe.macro.integrator == "implicit" and steps > MOST_IMPLICIT_STEPS:
        yield (
            f"implicit: {steps} steps; where tissue rings so long, their errors of phase may add "
            "up to more than three tolerances, and explicit steps are more accurate and fewer",
            True,
        )


def rank_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """What share of a run on several ranks rank 0 took for itself: it bounds what more can do."""
    if record.ranks is None:
        return
    wall, of = record.wall_time, record.ranks
    total, away = wall["total"], of["computing"] + of["messages"]
    shares = {
        "assembly and time stepping on rank 0": wall["macro"],
        "what the law decides there": max(0.0, wall["law"] - away),
        "computing on all ranks": of["computing"],
        "messages": of["messages"],
    }
    parts = ", ".join(f"{name} {100.0 * each / total:.0f} %" for name, each in shares.items())
    yield (
        f"ranks: {of['ranks']} of {of['threads']} threads; {parts} of {time_text(total)}; "
        f"{of['tasks']} exchanges",
        False,
    )


def run_summary(record: RunRecord) -> str:
    """What a finished run did and what it cost."""
    wall, counts = record.wall_time, record.counts
    return (
        f"{record.duration:g} µs by {record.law} in "
        f"{time_text(wall['total'])} (law {time_text(wall['law'])}, "
        f"macro {time_text(wall['macro'])}; "
        f"compilation {time_text(wall.get('compilation', 0.0))} besides), {costs(counts)}"
    )


def costs(counts: Mapping[str, int]) -> str:
    """Stress points, RVE solves and, for cached laws, hits and fallbacks by reason."""
    asked = counts["stress_points"] + counts.get("dissipation_points", 0)
    text = f"{asked} stresses, {counts.get('rve_solves', 0)} RVE solves"
    if "hits" not in counts:
        return text
    parts = {"audits": counts.get("audits", 0), "for the table": counts.get("table_rve_solves", 0)}
    of_these = [f"{n} {name}" for name, n in parts.items() if n]
    text += f" ({', '.join(of_these)})" if of_these else ""
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


def cache_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Sentences on audits and trust of a run, each with whether it is a warning."""
    for name, cache in caches_of(record.cache).items():
        of = name and f"{name}: "
        yield f"{of}audit: {audit_sentence(cache)}", False
        left = cache.get("left_range")
        if left:
            quantity, most = max(left.items(), key=lambda item: item[1]["points"])
            points = sum(each["points"] for each in left.values())
            far = out_of_range(quantity, most["farthest"], most["bound"])
            yield (
                f"{of}out of range: {most['points']} of {points} fallbacks by {far} at worst",
                False,
            )
        for event in cache["trust"]["events"]:
            yield f"{of}cache, step {event['step']}: {event['finding']}", True

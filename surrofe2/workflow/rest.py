"""A tissue at rest under its loads, into a run folder, and its small oscillations about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.base.clock import Meter, seconds_compiling
from surrofe2.base.errors import InputError
from surrofe2.base.units import time_text
from surrofe2.base.versions import describe_platform
from surrofe2.law.stress_law import state_arrays, state_of
from surrofe2.macro import MetRange, Rest, find_modes, find_rest
from surrofe2.macro.elements import make_discretisation
from surrofe2.macro.rest import RestState
from surrofe2.recipe.recipe import Recipe
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.run.journal import part_of, within
from surrofe2.run.loop import Report, Stage, no_report, no_stage
from surrofe2.store.run_folder import (
    CHECKPOINT_INTERVAL,
    RunFolder,
    RunRecord,
    write_curves,
)
from surrofe2.store.store import keep
from surrofe2.workflow import laws
from surrofe2.workflow.run import FrameFiles, new_record, problem_record, with_rest

STATES = {"unloaded": 0.0, "loaded": 1.0}
"""Factor of the loads by the name of the state whose modes are asked for."""


def rest_study(
    recipe: Recipe,
    folder: Path,
    *,
    factor: float = 1.0,
    load_steps: int = 10,
    fresh: bool = False,
    report: Report = no_report,
) -> RunRecord:
    """Load the recipe's tissue in steps, to `factor` times all loads, and write the run folder.

    What was found before a failure or an interrupt is written, and the same call resumes there.

    Raises:
        SimulationError: a load step finds no equilibrium.
    """
    problem = recipe.problem()
    law = laws.law_by_region(recipe, problem.mesh, laws.true_law)
    problem = laws.with_surface(recipe, problem)
    timer, before = Meter(), seconds_compiling()
    frames = FrameFiles(folder, make_discretisation(problem.mesh), law)

    def store(record: RunRecord, rest: Rest) -> RunRecord:
        forces = rest.journal["forces"]
        by_name = {
            f"force {name} {axis}": forces[:, k, i]
            for k, name in enumerate(rest.system.force_names)
            for i, axis in enumerate("xy")
        }
        path = {"": DisplacementCurve(rest.path[:, 0], rest.path[:, 1:])}
        write_curves(folder, path, by_name, rest.energies, is_rest=True)
        frames.close()
        wall = {"total": timer.seconds, "compilation": seconds_compiling() - before}
        met = {"watched": rest.watched.tolist(), **MetRange.of(rest.extremes).to_dict()}
        record = with_rest(record, rest.system.rest)
        return replace(record, wall_time=wall, counts=rest.counts, met=met)

    def checkpoint(rest: Rest) -> None:
        run.partial = rest
        frames.flush()  # first: whoever resumes needs all that this state had recorded
        arrays = within("rest", rest.to_arrays()) | {"seconds": np.array(timer.seconds)}
        run.checkpoint(arrays | within("law", state_arrays(law, rest.law_state)))

    def restore(arrays: dict[str, NDArray]) -> RestState:
        nonlocal timer
        timer = Meter(float(arrays["seconds"]))
        state = RestState.from_arrays(part_of(arrays, "rest"))
        return replace(state, law_state=state_of(law, part_of(arrays, "law")))

    stated = {**recipe.to_dict(), "rest": {"factor": factor, "load_steps": load_steps}}
    record = new_record(recipe, "rve", recipe=stated, problem=problem_record(problem))
    with RunFolder.open(folder, record, store, fresh=fresh) as run:
        if run.is_finished:
            return run.record
        timer = Meter()
        state = run.restored(restore)
        if state is not None:
            frames.resume(state.journal["frames.t"], state.journal["frames.point_t"])
        with recipe.named(InputError):
            rest = find_rest(
                problem,
                law,
                recipe.macro,
                factor=factor,
                load_steps=load_steps,
                progress=lambda at, end: report(at / end if end else 1.0, ""),
                checkpoint=checkpoint,
                checkpoint_interval=CHECKPOINT_INTERVAL,
                resume=state,
                keep_frame=frames.keep,
            )
        run.finish(rest)
    return run.record


def rest_summary(record: RunRecord) -> str:
    """Where the tissue came to rest and what it cost."""
    counts, end = record.counts, record.recipe["rest"]
    u_x, u_y = record.met["watched"]
    return (
        f"at rest under {end['factor']:g} times the load, watched point at ({u_x:.4g}, {u_y:.4g}) "
        f"µm, in {time_text(record.wall_time['total'])}: {counts['load_steps']} load steps, "
        f"{counts['halvings']} halvings, {counts['factorisations']} Newton corrections"
    )


def modes_study(
    recipe: Recipe,
    methods: Sequence[str],
    count: int,
    out: Path | None = None,
    *,
    fresh: bool = False,
    stage: Stage = no_stage,
) -> dict[str, Any]:
    """The slowest oscillations about both states of `STATES`, by state and initialisation.

    With everything needed to compute them again; `out`: a JSON file in which they are kept.
    """
    identity = {
        "version": version("surrofe2"),
        "recipe": recipe.to_dict(),
        "asked": {"initialisations": methods, "count": count},
    }

    def make() -> dict[str, Any]:
        states: dict[str, dict[str, Any]] = {state: {} for state in STATES}
        with stage("modes", float(len(methods) * len(STATES)), "states") as report:
            for k, method in enumerate(methods):
                for j, (state, factor) in enumerate(STATES.items()):
                    states[state][method] = _modes_of(recipe, method, factor, count)
                    report(len(STATES) * k + j + 1.0, method)
        return {
            "fingerprint": recipe.fingerprint,
            "threads": numba.get_num_threads(),
            "platform": describe_platform(),
            "units": _UNITS,
            "states": states,
        }

    return make() if out is None else keep(out, identity, make, fresh=fresh)[0]


_UNITS = {
    "watched": "µm, displacement of the watched point at rest",
    "period": "µs",
    "frequency": "1/µs",
    "decrement": "1, logarithmic, per period",
    "damping_ratio": "1",
    "creeping": "1/µs, real eigenvalues found on the way",
}


def _modes_of(recipe: Recipe, method: str, factor: float, count: int) -> dict[str, Any]:
    problem = recipe.problem()
    study = replace(recipe, rve=replace(recipe.rve, initialisation=method))
    law = laws.law_by_region(study, problem.mesh, laws.true_law)
    with recipe.named(InputError):
        problem = laws.with_surface(study, problem)
        rest = find_rest(problem, law, recipe.macro, factor=factor, load_steps=4)
    modes = find_modes(rest, count)
    return {
        "watched": rest.watched,
        "period": modes.periods,
        "frequency": modes.frequencies,
        "decrement": modes.decrements,
        "damping_ratio": modes.damping_ratios,
        "creeping": modes.creeping,
        "stable": modes.stable,
    }

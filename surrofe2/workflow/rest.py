"""The rest of a recipe's tissue, in a run folder, and small oscillations about it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Index
from surrofe2.base.clock import Meter, seconds_compiling
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.units import number, time_text
from surrofe2.base.versions import describe_platform
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import StressLaw, StressResponse
from surrofe2.macro import MetRange, Rest, find_modes, find_rest
from surrofe2.macro.answer_error import answer_error, corrected
from surrofe2.macro.elements import make_discretisation
from surrofe2.macro.forces import check_bodies
from surrofe2.macro.rest import RestState
from surrofe2.macro.settings import RestSettings
from surrofe2.problem import Problem
from surrofe2.recipe.recipe import CellName, Recipe, TimeSettings, changed
from surrofe2.report.comparison import buckling_sentence
from surrofe2.run.journal import FRAME_TIMES, part_of, within
from surrofe2.run.loop import Report, Stage, no_report, no_stage
from surrofe2.run.responses import nominal
from surrofe2.store.run_folder import (
    CHECKPOINT_INTERVAL,
    RunFolder,
    RunRecord,
    is_rest,
    read_run,
    write_curves,
)
from surrofe2.store.store import keep
from surrofe2.workflow import laws
from surrofe2.workflow.inputs import inputs_of
from surrofe2.workflow.run import (
    FrameFiles,
    LawOfRun,
    buckled,
    cache_notes,
    cache_report,
    closing_notes,
    costs,
    crossed,
    crossing_notes,
    decisions_of,
    law_of_run,
    new_record,
    problem_record,
    run_notes,
    run_study,
    run_summary,
    sharp_notes,
    thickness_of,
    with_costs,
    with_rest,
    write_decisions,
)
from surrofe2.workflow.time_scales import relaxation_notes, relaxed

# Entry of a record's `met`: by how much displacements and forces are off, see `answer_error`.
ANSWER = "error_of_answer"
# RVEs that a rest may take for that error, even where it has solved fewer itself.
MOST_FOR_ERROR = 1024
# States whose modes may be asked for by name, each with its factor of the loads.
STATES = {"unloaded": 0.0, "loaded": 1.0}


def rest_study(
    recipe: Recipe,
    folder: Path,
    kind: str = "rve",
    *,
    factor: float | None = None,
    load_steps: int | None = None,
    surrogates: Mapping[CellName, Path] = MappingProxyType({}),
    tables: Sequence[Path] = (),
    correct: bool = False,
    fresh: bool = False,
    report: Report = no_report,
) -> RunRecord:
    """Load the recipe's tissue in steps, by the law called `kind`, and write the run folder.

    What was computed before a failure or an interrupt is written, and the same call resumes there.

    Args:
        folder: the run folder.
        kind: law as of `--law`.
        factor: of all loads and prescribed motions, at the end; None: that of the recipe's [rest].
        load_steps: to begin with; None: those of the recipe's [rest].
        surrogates, tables: as of `run_study`.
        correct: keep the state after the Newton correction that gives the error of the answer, for
            which RVEs are solved at all points.
        fresh: whether a run that is there is replaced.
        report: called with the fraction of the load, and words on what is done.

    Raises:
        InputError: nothing is there to correct, as RVEs answer everywhere.
        SimulationError: a load step finds no equilibrium.
    """
    if correct and kind == "rve":
        raise InputError(
            "--correct: not with --law rve, whose answer has no error by a surrogate; leave it out"
        )
    if kind == "table":
        laws.check_solver(recipe)
    settings = changed(recipe.rest or RestSettings(), factor=factor, load_steps=load_steps)
    recipe = replace(recipe, rest=settings)
    problem = recipe.problem()
    with recipe.named(InputError):
        check_bodies(problem)
    of_run = law_of_run(recipe, problem, kind, folder, surrogates, tables)
    problem = laws.with_surface(recipe, problem)
    described = problem_record(problem, thickness_of(recipe))
    record = new_record(recipe, kind, surrogate=of_run.surrogate, problem=described)
    if correct:
        stated = {**record.recipe["rest"], "correct": True}
        record = replace(record, recipe={**record.recipe, "rest": stated})
    job = _RestJob(
        recipe=recipe,
        problem=problem,
        kind=kind,
        settings=settings,
        correct=correct,
        of_run=of_run,
        record=record,
        inputs=inputs_of(recipe, kind, surrogates, tables),
        frames=FrameFiles(folder, make_discretisation(problem.mesh), of_run.law),
        report=report,
    )
    return RunFolder.compute(folder, job, fresh=fresh)


@dataclass(slots=True, kw_only=True)
class _RestJob:
    """A rest by load steps as a `Job`.

    Attributes:
        recipe, problem: the problem that is computed, the surface law included.
        kind: name of the law.
        settings: load steps.
        correct: whether the corrected state is kept.
        of_run: the law, and the files that it fills.
        record: the record that the rest begins with.
        inputs: contents, by name, of the files from which it can be repeated.
        frames: files of whole fields.
        report: is called with the fraction of the load.
        compiled_before: seconds in which kernels had been compiled when it began.
        timer: seconds of all calls.
        answered: entries of the record on the error of the answer.
    """

    recipe: Recipe
    problem: Problem
    kind: str
    settings: RestSettings
    correct: bool
    of_run: LawOfRun
    record: RunRecord
    inputs: Mapping[str, bytes]
    frames: FrameFiles
    report: Report
    compiled_before: float = field(default_factory=seconds_compiling)
    timer: Meter = field(default_factory=Meter)
    answered: dict[str, Any] = field(default_factory=dict)

    def restored(self, arrays: dict[str, NDArray]) -> RestState:
        """Return the state that a checkpoint holds, and continue its frames and harvests."""
        self.timer = Meter(float(arrays["seconds"]))
        state = RestState.from_arrays(part_of(arrays, "rest"))
        self.frames.resume(state.journal["frames.t"], state.journal["frames.point_t"])
        return replace(state, law_state=self.of_run.restored(arrays))

    def compute(self, run: RunFolder, state: RestState | None) -> Rest:
        """Compute the rest and, where a surrogate answered, the error of its answer."""
        law = self.of_run.law
        if state is None:
            self.timer = Meter()  # the time to open the folder is no part of the rest
        else:
            run.cache = cache_report(law)
        with self.recipe.named(InputError):
            rest = find_rest(
                self.problem,
                law,
                self.recipe.macro,
                factor=self.settings.factor,
                load_steps=self.settings.load_steps,
                progress=lambda load, end: self.report(load / end if end else 1.0, ""),
                checkpoint=partial(self._checkpoint, run),
                checkpoint_interval=CHECKPOINT_INTERVAL,
                resume=state,
                closing=lambda done, count: self.report(1.0, f"closing audit: {done} of {count}"),
                keep_frame=self.frames.keep,
            )
        if self.kind != "rve":
            self._checkpoint(run, rest)  # RVEs of its error may take as long as the rest did
            true = laws.law_by_region(self.recipe, self.problem.mesh, laws.true_law)
            rest = _with_error(
                rest, law, true, self.answered, self.frames, self.correct, self.report
            )
        return rest

    def _checkpoint(self, run: RunFolder, rest: Rest) -> None:
        """Write a checkpoint with the files that belong to its state."""
        law = self.of_run.law
        run.partial = rest
        self.frames.flush()  # first: a rest that resumes needs all that this state had recorded
        arrays = within("rest", rest.to_arrays()) | {"seconds": np.array(self.timer.seconds)}
        run.checkpoint(arrays | self.of_run.to_arrays(rest.law_state), cache_report(law))
        self.frames.remove_surplus()
        write_decisions(run.folder, decisions_of(law))

    def store(self, record: RunRecord, rest: Rest) -> RunRecord:
        """Write the results, whole or not, and return the record with what they met and cost."""
        folder = self.of_run.folder
        history = rest.history | nominal(rest.history, record.problem["places"])
        write_curves(folder, rest.curves, history, rest.energies, is_rest=True)
        self.frames.close()
        write_decisions(folder, rest.decisions)
        self.of_run.write_learnt(self.timer.seconds)
        record = with_costs(with_rest(record, rest.system.rest), rest, self.of_run.tables)
        wall = {
            "total": self.timer.seconds,
            "law": rest.law_seconds,
            "macro": self.timer.seconds - rest.law_seconds,
            "compilation": seconds_compiling() - self.compiled_before,
        }
        met = {"watched": rest.watched.tolist(), **MetRange.of(rest.extremes).to_dict()}
        met |= buckled(rest.path[:, 0], rest.history, len(rest.F))
        met |= crossed(rest.path[:, 0], rest.history)
        met |= self.answered
        if self.recipe.time != TimeSettings():  # a rest whose recipe states times of loads
            met |= relaxed(self.recipe, self.problem)
        return replace(record, wall_time=wall, met=met)

    def close(self) -> None:
        """Remove frames that the rest took back."""
        self.frames.remove_surplus()


def _with_error(
    rest: Rest,
    law: StressLaw,
    true: StressLaw,
    answered: dict[str, Any],
    frames: FrameFiles,
    correct: bool,
    report: Report,
) -> Rest:
    """Compute the error of a rest's answer, and correct the rest if that is wanted.

    RVEs are solved at all points only where they are no more than the rest itself has solved, or
    where the rest shall be corrected.

    Args:
        law: by which the rest was found.
        true: the law of RVEs.
        answered: receives the entries of the record on the error.
        frames: receives the frame of the corrected state.
    """

    def true_stress(points: Index, F: Array) -> StressResponse:
        """Compute RVEs' stresses at rest at some points."""
        part = true.at(points) if isinstance(true, RegionalLaw) else true
        return part.respond(F, np.zeros_like(F))

    def progress(done: int, count: int) -> None:
        """Report how many RVEs are solved."""
        report(1.0, f"error of the answer: {done} of {count} RVEs")

    solved = rest.effort.get("rve_solves", 0)
    most = None if correct else max(solved, MOST_FOR_ERROR)
    try:
        error = answer_error(rest, law, true_stress, most=most, progress=progress)
    except SimulationError as failure:
        answered[ANSWER] = {"unknown": str(failure)}
        return rest
    names = rest.system.force_names
    answered[ANSWER] = {
        "elements": error.elements,
        "of": error.of,
        "rve_solves": error.solved,
        "residual": error.residual,
        "displacement": error.largest,
        "watched": error.watched.tolist(),
        "watched_interval": error.watched_interval.tolist(),
        "forces": dict(zip(names, error.forces.tolist(), strict=True)),
        "forces_interval": dict(zip(names, error.forces_interval.tolist(), strict=True)),
        "corrected": correct,
    }
    if not correct:
        return rest
    kept, frame = corrected(rest, law, error)
    lengths = rest.journal.lengths
    frames.keep(frame, *(lengths[name] - 1 for name in FRAME_TIMES))
    return kept


def error_sentence(record: RunRecord) -> str:
    """Say how wrong the answer of a rest is; empty where that is not known."""
    error = record.met.get(ANSWER)
    if not error:
        return ""
    if "unknown" in error:
        return str(error["unknown"])
    is_whole = error["elements"] == error["of"]
    where = f"all {error['of']:,} elements"
    if not is_whole:
        where = f"a random sample of {error['elements']:,} of {error['of']:,} elements"
    parts = []
    if error["displacement"] is not None:
        parts.append(f"displacements by at most {number(error['displacement'], 2)} µm")
    of_watched = zip(error["watched"], error["watched_interval"], strict=True)
    parts.append(f"the watched point by ({_with_intervals(of_watched)}) µm")
    forces = error["forces"]
    name = max(forces, key=lambda force: max(map(abs, forces[force])), default="")
    if name:
        of_force = zip(forces[name], error["forces_interval"][name], strict=True)
        parts.append(f"force {name} by ({_with_intervals(of_force)}) µN")
    does = "was, and is corrected," if error["corrected"] else "is"
    text = f"error of the answer, by RVEs at {where}: it {does} off in {', '.join(parts)}"
    return text if is_whole else f"{text}, with 95 % confidence"


def _with_intervals(pairs: Iterable[tuple[float, float]]) -> str:
    """Write estimates with their half widths; those of all elements have none."""
    texts = []
    for estimate, half_width in pairs:
        text = f"{estimate:.2g}"
        if half_width:
            text += f" ± {half_width:.2g}"
        texts.append(text)
    return ", ".join(texts)


def study_by_method(recipe: Recipe, kind: str, folder: Path, **options: Any) -> RunRecord:
    """Compute the recipe's problem by the method that it states.

    That is by load steps where it has a [rest], else in time. `options` are those that `run_study`
    and `rest_study` have in common.
    """
    compute = run_study if recipe.rest is None else rest_study
    return compute(recipe, kind=kind, folder=folder, **options)


def extent_of(recipe: Recipe) -> tuple[float, str]:
    """Return what the progress of `study_by_method` counts up to, and its unit."""
    return (recipe.duration, "µs") if recipe.rest is None else (1.0, "loads")


def summary_of(record: RunRecord) -> str:
    """Summarise a run or rest and its cost."""
    return rest_summary(record) if is_rest(record) else run_summary(record)


def notes_of(record: RunRecord, recipe: Recipe) -> Iterator[tuple[str, bool]]:
    """Iterate over notes on a run or rest, each with whether it is a warning."""
    return rest_notes(record) if is_rest(record) else run_notes(record, recipe)


def response_lines(folder: Path, record: RunRecord) -> list[str]:
    """Describe each force of a run or rest over its displacement: peak, first slope, work."""
    if not record.problem.get("places"):
        return []
    return [response.sentence for response in read_run(folder, finished=False).responses]


def rest_summary(record: RunRecord) -> str:
    """Summarise where the tissue came to rest, the cost, and whether walls have buckled."""
    counts = record.counts
    end = record.recipe["rest"]
    wall = record.wall_time
    u_x, u_y = record.met["watched"]
    back = Counter(record.rolled_back)
    text = (
        f"at rest under {end['factor']:g} times the load by {record.law}, watched point at "
        f"({u_x:.4g}, {u_y:.4g}) µm, in {time_text(wall['total'])} (law "
        f"{time_text(wall['law'])}): {counts['load_steps']} load steps, "
        f"{counts['halvings']} halvings, {counts['factorisations']} Newton corrections, "
        f"{costs(counts)}"
    )
    if back:
        text += f"; rolled back: {back['load_steps']} load steps, {costs(back)}"
    buckling = buckling_sentence(record)
    return f"{text}; {buckling}" if buckling else text


def rest_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Iterate over notes on a rest, each with whether it is a warning.

    They are on sharp bodies, outer sides that meet, free sides and the cache.
    """
    yield from sharp_notes(record.problem.get("sharp", {}))
    yield from crossing_notes(record)
    yield from relaxation_notes(record.met)
    yield from laws.surface_notes(record)
    yield from cache_notes(record)
    yield from closing_notes(record)
    sentence = error_sentence(record)
    if sentence:
        yield sentence, "unknown" in record.met[ANSWER]


def modes_study(
    recipe: Recipe,
    methods: Sequence[str],
    count: int,
    out: Path | None = None,
    *,
    fresh: bool = False,
    stage: Stage = no_stage,
) -> dict[str, Any]:
    """Compute the slowest oscillations about both states of `STATES`, by state and initialisation.

    The result has everything needed to compute them again.

    Args:
        methods: initialisations of RVEs.
        count: number of oscillations.
        out: JSON file in which they are kept; None: nowhere.
        fresh: whether a file that is there is replaced.
        stage: reports the states.
    """
    identity = {
        "version": version("surrofe2"),
        "recipe": recipe.to_dict(),
        "asked": {"initialisations": methods, "count": count},
    }

    def make() -> dict[str, Any]:
        """Compute the oscillations, and return the content of the file."""
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


# Units and meaning of the numbers of a state.
_UNITS = {
    "watched": "µm, displacement of the watched point at rest",
    "period": "µs",
    "frequency": "1/µs",
    "decrement": "1, logarithmic, per period",
    "damping_ratio": "1",
    "creeping": "1/µs, real eigenvalues found on the way",
}


def _modes_of(recipe: Recipe, method: str, factor: float, count: int) -> dict[str, Any]:
    """Compute the oscillations about the rest at a factor of the loads."""
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

"""Runs of a recipe's problem in time by a stress law, and the folder that they are written to.

A run leaves its record; curves, energies, fields and decisions; and of a cached run the tables and
the answers of RVEs, which are kept with its checkpoints and written at its end. Runs computed in
Python are written by `save_run`.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.clock import seconds_compiling
from surrofe2.base.errors import InputError
from surrofe2.base.sampling import out_of_range
from surrofe2.base.units import number, time_text
from surrofe2.cache import CachedLaw, StressTable
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import AuditedLaw, StressLaw, state_arrays, state_of
from surrofe2.macro import MacroRun, MacroState, Rest, simulate
from surrofe2.macro.elements import (
    Discretisation,
    deformation_gradient,
    make_discretisation,
    n_points_of,
)
from surrofe2.macro.forces import contact_points
from surrofe2.macro.history import Frames
from surrofe2.plant_cell.parameters import PRESETS
from surrofe2.problem import Problem
from surrofe2.problem.conditions import PointForce, PrescribedMotion, Pressure, Traction
from surrofe2.problem.mesh import NodeAt, boundary, element_nodes, extent, length_of
from surrofe2.problem.problem import displacement_of, label, sections_of
from surrofe2.ranks.distributed_law import own_part
from surrofe2.ranks.driver import driver_at_work
from surrofe2.recipe.recipe import CellName, CellStudy, Recipe
from surrofe2.report.comparison import (
    BUCKLED,
    audit_sentence,
    buckling_sentence,
    closing_sentence,
    fallback_reasons,
)
from surrofe2.run.journal import BEYOND, CROSSINGS, part_of, within
from surrofe2.run.loop import Report, no_report
from surrofe2.run.responses import nominal
from surrofe2.rve import RveLaw
from surrofe2.store import fields
from surrofe2.store.hdf5 import origin, read_seconds
from surrofe2.store.run_folder import (
    CHECKPOINT_INTERVAL,
    HARVEST,
    TABLE,
    RunFolder,
    RunRecord,
    caches_of,
    describe_origin,
    earlier_run,
    is_rest,
    of_cell,
    write_curves,
    write_events,
)
from surrofe2.store.samples import HarvestWriter
from surrofe2.store.store import plain
from surrofe2.store.tables import write_table
from surrofe2.surrogate import SurrogateLaw
from surrofe2.workflow import laws
from surrofe2.workflow.inputs import inputs_of
from surrofe2.workflow.time_scales import relaxation_notes, relaxed

# Points that are not trusted, for each hit, from which on a run advises what to change.
MANY_UNTRUSTED = 0.1
# Implicit steps of a tissue that rings, after which the phase was three tolerances off
# (docs/theory.md).
MOST_IMPLICIT_STEPS = 3000
# Penetration of a body, as a fraction of the side of an element, from which on a run warns.
_DEEP = 0.01
# Entry of a record's `met`: the time, µs, or load factor, from which outer sides cross.
CROSSED = "outer_sides_cross_from"


def run_study(
    recipe: Recipe,
    kind: str,
    folder: Path,
    *,
    surrogates: Mapping[CellName, Path] = MappingProxyType({}),
    tables: Sequence[Path] = (),
    fresh: bool = False,
    report: Report = no_report,
) -> RunRecord:
    """Run the recipe's problem by the law called `kind` and write the run folder.

    RVE answers are kept in memory and in checkpoints until the run ends, so that a harvest has
    exactly those of the run that it belongs to.

    Args:
        kind: law as of `--law`: "rve", "cached", "table" or "surrogate".
        folder: the run folder.
        surrogates: files by name of the cell, instead of the recipe's.
        tables: files of tables to start from, each for the cells whose answers it has; the run's
            own are written into the folder.
        fresh: whether a run that is there is replaced.
        report: called with the time, µs, and words on what is done.

    Raises:
        SimulationError: the run could not be carried on; the folder holds it up to there.
    """
    if kind == "table":
        laws.check_solver(recipe)
    recipe = replace(recipe, rest=None)  # in time, whatever the recipe states
    compiled_before = seconds_compiling()
    problem = recipe.problem()
    with recipe.named(InputError):
        problem.check_course()
    of_run = law_of_run(recipe, problem, kind, folder, surrogates, tables)
    problem = laws.with_surface(recipe, problem)
    described = problem_record(problem, thickness_of(recipe))
    record = new_record(recipe, kind, surrogate=of_run.surrogate, problem=described)
    job = _TimeRun(
        recipe=recipe,
        problem=problem,
        of_run=of_run,
        record=record,
        inputs=inputs_of(recipe, kind, surrogates, tables),
        frames=FrameFiles(folder, make_discretisation(problem.mesh), of_run.law),
        compiled_before=compiled_before,
        report=report,
    )
    return RunFolder.compute(folder, job, fresh=fresh)


@dataclass(frozen=True, slots=True, kw_only=True)
class _TimeRun:
    """A run in time as a `Job`.

    Attributes:
        recipe, problem: the problem that is computed, the surface law included.
        of_run: the law, and the files that it fills.
        record: the record that the run begins with.
        inputs: contents, by name, of the files from which the run can be repeated.
        frames: files of whole fields.
        compiled_before: seconds in which kernels had been compiled when it began.
        report: is called with the time, µs.
    """

    recipe: Recipe
    problem: Problem
    of_run: LawOfRun
    record: RunRecord
    inputs: Mapping[str, bytes]
    frames: FrameFiles
    compiled_before: float
    report: Report

    def restored(self, arrays: Mapping[str, NDArray]) -> MacroState:
        """Return the state that a checkpoint holds, and continue its frames and harvests."""
        state = MacroState.from_arrays(part_of(arrays, "macro"))
        self.frames.resume(state.journal["frames.t"], state.journal["frames.point_t"])
        return replace(state, law_state=self.of_run.restored(arrays))

    def compute(self, run: RunFolder, state: MacroState | None) -> MacroRun:
        """Run to the end; an interrupt leaves harvests and tables written."""
        law = self.of_run.law
        duration = self.problem.duration
        if state is not None:
            run.cache = cache_report(law)
        self.report(0.0, "loading kernels")
        try:
            with self.recipe.named(InputError):
                return simulate(
                    self.problem,
                    law,
                    self.recipe.macro,
                    progress=lambda t, duration: self.report(t, ""),
                    checkpoint=partial(self._checkpoint, run),
                    checkpoint_interval=CHECKPOINT_INTERVAL,
                    resume=state,
                    closing=lambda done, count: self.report(
                        duration, f"closing audit: {done} of {count}"
                    ),
                    keep_frame=self.frames.keep,
                )
        except KeyboardInterrupt:
            self.of_run.write_learnt()
            raise

    def _checkpoint(self, run: RunFolder, state: MacroState) -> None:
        """Write a checkpoint with the files that belong to its state."""
        law = self.of_run.law
        arrays = within("macro", state.to_arrays()) | self.of_run.to_arrays(state.law_state)
        self.frames.flush()  # first: a run that resumes needs all that this state had recorded
        run.checkpoint(arrays, cache_report(law))
        self.frames.remove_surplus()
        write_decisions(run.folder, decisions_of(law))

    def store(self, record: RunRecord, result: MacroRun) -> RunRecord:
        """Write the results, whole or not, and return the record with what they met and cost."""
        folder = self.of_run.folder
        record = with_results(record, result, self.of_run.tables)
        compilation = seconds_compiling() - self.compiled_before
        wall = {**record.wall_time, "compilation": compilation}
        self.of_run.write_learnt(wall.get("total", 0.0))
        history = {**result.history, **nominal(result.history, record.problem["places"])}
        write_curves(folder, result.curves, history, result.energies)
        self.frames.close()
        write_decisions(folder, result.decisions)
        met = record.met
        if result.curve.t[-1] >= self.problem.duration:
            met = {**met, **relaxed(self.recipe, self.problem, result.energies)}
        return replace(record, wall_time=wall, met=met)

    def close(self) -> None:
        """Remove frames that the run took back."""
        self.frames.remove_surplus()


@dataclass(frozen=True, slots=True)
class LawOfRun:
    """The law of a run or rest, and the files that it fills in their folder.

    Attributes:
        recipe, folder: those of the run.
        law: of all points.
        surrogate: the record of its surrogates; None where it has none.
        harvests: files of the answers of RVEs, by name of the cell.
        tables: tables that learn, by name of the cell.
        earlier: seconds that the tables took with which it began.
    """

    recipe: Recipe
    folder: Path
    law: StressLaw
    surrogate: dict[str, Any] | None
    harvests: Mapping[CellName, HarvestWriter]
    tables: Mapping[CellName, StressTable]
    earlier: float

    def write_learnt(self, seconds: float | None = None) -> None:
        """Write harvests and tables.

        Args:
            seconds: what they took in this run; None: not known yet, since the run will resume.
        """
        total = 0.0 if seconds is None else self.earlier + seconds
        for writer in self.harvests.values():
            writer.flush(total)
        for name, table in self.tables.items():
            path = self.folder / of_cell(TABLE, name)
            write_table(path, table, self.recipe.to_dict(), total)

    def to_arrays(self, law_state: Any) -> dict[str, NDArray]:
        """Return all that a checkpoint must have of harvests and of the committed `law_state`."""
        arrays = within("law", state_arrays(self.law, law_state))
        for cell, writer in self.harvests.items():
            arrays |= within(f"harvest of {cell or ''}", writer.to_arrays())
        return arrays

    def restored(self, arrays: Mapping[str, NDArray]) -> Any:
        """Return the state whose `to_arrays` are among these arrays; continue the harvests."""
        law_state = state_of(self.law, part_of(arrays, "law"))
        for cell, writer in self.harvests.items():
            writer.restore(part_of(arrays, f"harvest of {cell or ''}"))
        return law_state


def law_of_run(
    recipe: Recipe,
    problem: Problem,
    kind: str,
    folder: Path,
    surrogates: Mapping[CellName, Path],
    tables: Sequence[Path],
) -> LawOfRun:
    """Make the law called `kind` for a run in a folder; arguments as of `run_study`."""
    harvests: dict[CellName, HarvestWriter] = {}
    chosen: dict[CellName, laws.ChosenLaw] = {}
    tables_of = laws.files_by_cell(recipe, tables, "--table")
    for name, study in recipe.studies().items():
        if kind in ("cached", "table"):
            harvests[name] = HarvestWriter(folder / of_cell(HARVEST, name), origin_of(study))
        chosen[name] = laws.choose_law(
            study, kind, surrogates.get(name), tables_of[name], harvests.get(name)
        )
    learnt = {}
    learning_tables = {}
    for name, choice in chosen.items():
        if choice.surrogate:
            learnt[name] = choice.surrogate
        if choice.table is not None:
            learning_tables[name] = choice.table
    return LawOfRun(
        recipe=recipe,
        folder=folder,
        law=laws.law_by_region(recipe, problem.mesh, lambda study: chosen[study.name].law),
        surrogate=laws.surrogate_record(learnt),
        harvests=harvests,
        tables=learning_tables,
        earlier=sum(read_seconds(path) or 0.0 for path in tables),
    )


def cache_report(law: StressLaw) -> dict[str, Any] | None:
    """Return the report of a cached law so far; None of other laws.

    Of several cells it has theirs under `cells` by name.
    """
    return law.history() if isinstance(law, AuditedLaw) else None


def decisions_of(law: StressLaw) -> list[dict[str, Any]] | None:
    """Return a law's decisions on windows of steps so far; None of a law that makes none."""
    return law.decisions if isinstance(law, AuditedLaw) else None


def write_decisions(folder: Path, decisions: Sequence[Mapping[str, Any]] | None) -> None:
    """Write the event log of an audited law; None: the law decides nothing."""
    if decisions is not None:
        write_events(folder, decisions)


def origin_of(study: CellStudy) -> dict[str, Any]:
    """Return where stresses of a plant cell come from, as entries of a header."""
    cell = study.cell.parameters
    rve = study.recipe.rve
    return origin(cell, rve.initialisation, rve=asdict(rve), recipe=study.to_dict())


def new_record(recipe: Recipe, law: str, /, **entries: Any) -> RunRecord:
    """Make the record of a run that is about to start.

    Args:
        law: name of the law.
        entries: further entries of the record, or others than the recipe's.
    """
    seeds = [cell.samples.seed for cell in recipe.cells.values()]
    known = {
        "recipe": recipe.to_dict(),
        "initialisation": recipe.rve.initialisation,
        "solver": recipe.rve.solver,
        "cell_fingerprint": recipe.fingerprint,
        "seed": seeds[0] if len(seeds) == 1 else None,
    }
    return RunRecord(status="running", law=law, **describe_origin(), **(known | entries))


def save_run(run: MacroRun, folder: str | Path, *, fresh: bool = False) -> RunRecord:
    """Write the run folder that the command `surrofe2 run` would write; `read_run` reads it back.

    `surrofe2 compare` and `zoom` take it like any other; but it has no checkpoint to continue from.

    Args:
        fresh: write over whatever run the folder holds.

    Raises:
        FileError: the folder cannot be written, or has files but no run.
        MismatchError: it has a run of other settings.
    """
    folder = Path(folder)
    record = _record_of(run)

    def store(record: RunRecord, result: MacroRun) -> RunRecord:
        """Write the results, and return the record with their cost."""
        record = with_results(record, result)
        write_results(folder, result)
        return record

    if not fresh:
        earlier_run(folder, record)
    with RunFolder.open(folder, record, store, fresh=True) as kept:
        kept.finish(run)
    return kept.record


def write_results(folder: Path, run: MacroRun) -> None:
    """Write curve.csv, history.csv, energies.csv, fields, points and, of a cached run, events.

    Fields that the run gave away as they came are not written.
    """
    write_curves(folder, run.curves, run.history, run.energies)
    if len(run.frames.displacement):
        files = FrameFiles(folder, make_discretisation(run.problem.mesh), run.law)
        for frame in run.frames.one_by_one():
            files.keep(frame, *files.counts)
        files.close()
    write_decisions(folder, run.decisions)


class FrameFiles:
    """The files of whole fields of a run or a rest, which are written as they come.

    They are fields of nodes and elements, and points of the law, whose F and Ḟ follow from the
    displacement of nodes.
    """

    def __init__(self, folder: Path, space: Discretisation, law: StressLaw) -> None:
        self._space = space
        cell = laws.cell_of_elements(law, len(space.elements))
        self._fields = fields.element_writer(folder, space.nodes, space.elements, cell)
        position = space.point_positions()
        self._points = fields.point_writer(folder, position, space.points_per_element)

    @property
    def counts(self) -> tuple[int, int]:
        """Numbers of frames so far: of fields, and of points."""
        return self._fields.count, self._points.count

    def resume(self, times: Array, point_times: Array) -> None:
        """Continue behind the frames at these times; see `FrameWriter.resume`."""
        self._fields.resume(times.tolist())
        self._points.resume(point_times.tolist())

    def keep(self, frame: Frames, count: int, point_count: int) -> None:
        """Write a frame, and the points if it has them; see `macro.history.KeepFrame`."""
        self._fields.write(count, float(frame.t[0]), *fields.fields_of_elements(frame))
        if not len(frame.point_t):
            return
        u = frame.displacement[0]
        v = frame.velocity[0]
        F, F_dot, _ = deformation_gradient(self._space, u, v)
        at_points = {
            fields.DISPLACEMENT_NAME: self._space.at_points(u),
            fields.VELOCITY_NAME: self._space.at_points(v),
            fields.F_NAME: F,
            fields.F_DOT_NAME: F_dot,
            fields.STRESS_NAME: frame.point_stress[0],
            fields.SOURCE_NAME: frame.point_source[0],
            fields.RISK_NAME: frame.point_risk[0],
            **fields.invariants(frame.point_stress[0]),
        }
        self._points.write(point_count, float(frame.point_t[0]), at_points, {})

    def flush(self) -> None:
        """Write the frames that wait."""
        self._fields.flush()
        self._points.flush()

    def remove_surplus(self) -> None:
        """Remove frames that the run took back, once no checkpoint counts them."""
        self._fields.remove_surplus()
        self._points.remove_surplus()

    def close(self) -> None:
        """Complete the files: no more frames come."""
        self._fields.close()
        self._points.close()


def with_results(
    record: RunRecord, run: MacroRun, tables: Mapping[CellName, StressTable] = MappingProxyType({})
) -> RunRecord:
    """Return the record with what a run, whole or not, met and cost.

    Args:
        tables: tables that learnt in it; the seconds of their first records count as the run's.
    """
    driver = driver_at_work()
    begun = sum(table.seconds for table in tables.values())
    record = with_costs(record, run, tables)
    penetration = {}
    for name, depth in run.history.items():
        if name.startswith("penetration "):
            penetration[name.removeprefix("penetration ")] = float(depth.max(initial=0.0))
    wall = dict(run.wall_time)
    for part in ("total", "law"):
        if part in wall:
            wall[part] += begun
    return replace(
        with_rest(
            replace(record, problem={**record.problem, "penetration": penetration}), run.rest
        ),
        ranks=None if driver is None else driver.report(),
        wall_time=wall,
        met={
            **run.met.to_dict(),
            "displacement": run.largest_displacement,
            **buckled(run.curve.t, run.history, n_points_of(run.problem.mesh)),
            **crossed(run.curve.t, run.history),
        },
        threads=run.threads,
    )


def with_costs(
    record: RunRecord, run: MacroRun | Rest, tables: Mapping[CellName, StressTable]
) -> RunRecord:
    """Return the record with what the answers of the law cost, and what its caches report."""
    counts = Counter({**run.counts, **run.effort})
    back = Counter(run.rolled_back)
    # audits and what tables learn are RVE solves like others, and named besides
    for report in caches_of(run.cache).values():
        audit = report["audit"]
        audits = audit["audited"] + report["closing_audit"]["audited"]
        counts.update(rve_solves=audits, audits=audits)
        back.update(rve_solves=audit["rolled_back"], audits=audit["rolled_back"])
    for table in tables.values():
        changed = {f"table_{name.removeprefix('table_')}": n for name, n in table.counts.items()}
        counts.update(changed, table_records=table.size)
        counts["rve_solves"] += changed.get("table_rve_solves", 0)
    return replace(
        record,
        counts=dict(counts),
        rolled_back={name: n for name, n in back.items() if n},
        cache=run.cache,
    )


def with_rest(record: RunRecord, rest: np.ndarray | None) -> RunRecord:
    """Return the record with how far free sides moved a tissue before the run, µm."""
    surface = record.problem.get("surface")
    if not surface or rest is None:
        return record
    moved = float(np.linalg.norm(rest, axis=1).max(initial=0.0))
    return replace(record, problem={**record.problem, "surface": {**surface, "rest": moved}})


def problem_record(problem: Problem, thickness: float | None = None) -> dict[str, Any]:
    """Describe a problem for a record: counts of its mesh by name, and what acts on it.

    Args:
        thickness: of the tissue, µm; None where its cells have several.
    """
    mesh = problem.mesh
    low, high = extent(mesh)
    return {
        "nodes": mesh.p.shape[1],
        "elements": mesh.nelements,
        "nodes_per_element": element_nodes(mesh).shape[1],
        "points": n_points_of(mesh),
        "extent": [low.tolist(), high.tolist()],
        "boundaries": {name: len(sides) for name, sides in (mesh.boundaries or {}).items()},
        "regions": {name: len(elements) for name, elements in (mesh.subdomains or {}).items()},
        "conditions": [label(condition) for condition in problem.conditions],
        "bodies": [body.name for body in problem.bodies],
        "watched": {name: list(point) for name, point in problem.watched.items()},
        "places": _places(problem, thickness),
        "sharp": sharp_bodies(problem),
        **({"surface": laws.surface_record(problem)} if problem.surface is not None else {}),
    }


def thickness_of(recipe: Recipe) -> float | None:
    """Return the thickness of the tissue, µm; None where its cells have several."""
    thicknesses = {cell.parameters.tissue_thickness for cell in recipe.cells.values()}
    return thicknesses.pop() if len(thicknesses) == 1 else None


def sharp_bodies(problem: Problem) -> dict[str, list[float]]:
    """Find bodies that are sharper than the contact points of their boundary are apart.

    Returns:
        By name of the body the radius of its rounding and that distance, µm.
    """
    mesh = problem.mesh
    sharp: dict[str, list[float]] = {}
    for body in problem.bodies:
        facets = boundary(mesh, body.on, f"bodies.{body.name}.on")
        _, gap = contact_points(mesh, facets, body.shape)
        radius = float(getattr(body.shape, "radius", np.inf))
        if gap > radius:
            sharp[body.name] = [radius, gap]
    return sharp


def sharp_notes(sharp: Mapping[str, Sequence[float]]) -> Iterator[tuple[str, bool]]:
    """Warn of each body that the mesh is too coarse for; see `sharp_bodies`."""
    for name, (radius, gap) in sharp.items():
        yield (
            f"contact: {name} has a rounding of {number(radius)} µm and may press between contact "
            f"points, which are {number(gap)} µm apart; make the elements there "
            f"{number(gap / radius, 2)} times smaller, or the rounding larger",
            True,
        )


def _places(problem: Problem, thickness: float | None) -> dict[str, dict[str, Any]]:
    """Describe, by name of a motion, surface load or body, what its nominal stress and strain need.

    See `run.responses`.
    """
    mesh = problem.mesh
    low, high = extent(mesh)
    known = mesh.boundaries or {}
    columns: dict[str, str] = {}  # displacement by name of what acts
    sections: dict[str, float | None] = {}
    for condition in problem.conditions:
        if not isinstance(condition, PrescribedMotion | Traction | Pressure | PointForce):
            continue
        name = label(condition)
        if isinstance(condition.on, NodeAt):
            columns[name] = displacement_of(condition.on)
            sections[name] = None
        elif condition.on in known:
            columns[name] = f"mean displacement {condition.on}"
            sections[name] = length_of(mesh, boundary(mesh, condition.on, name))
    for body in problem.bodies:
        columns[body.name] = f"position {body.name}"
        sections[body.name] = length_of(mesh, boundary(mesh, body.on, body.name))
    places = {}
    for name, column in columns.items():
        places[name] = {
            "displacement": column,
            "section": sections[name],
            "length": (high - low).tolist(),
            "thickness": thickness,
        }
    return places


def _record_of(run: MacroRun) -> RunRecord:
    """Make the record of a run that no recipe stated."""
    entries: dict[CellName, dict[str, Any]] = {}
    sections: dict[str, Any] = {}
    if isinstance(run.law, RegionalLaw):
        entries |= {name: _law_entries(law) for name, law in run.law.laws.items()}
        sections["cells"] = {
            name: {**entry["cell"], "rve": entry["rve"], "regions": [name]}
            for name, entry in entries.items()
        }
    else:
        only = _law_entries(run.law)
        entries[None] = only
        if only["cell"]:
            sections = {"cell": only["cell"], "rve": only["rve"]}
    caches = [entry["cache"] for entry in entries.values() if entry["cache"]]
    if caches:
        sections["cache"] = caches[0]
    sections |= {**_stated_problem(run.problem), "macro": asdict(run.settings)}
    learnt = {name: entry["surrogate"] for name, entry in entries.items() if entry["surrogate"]}

    def joined(values: Iterable[str]) -> str:
        """Join values by commas, equal ones once."""
        return ", ".join(dict.fromkeys(values))

    return RunRecord(
        status="running",
        recipe=plain({"recipe": None, **sections}),
        law=joined(entry["kind"] for entry in entries.values()),
        initialisation=joined(
            entry["rve"].get("initialisation", "none") for entry in entries.values()
        ),
        solver=joined(entry["rve"].get("solver", "none") for entry in entries.values()),
        cell_fingerprint=" ".join(entry["fingerprint"] for entry in entries.values()),
        surrogate=laws.surrogate_record(learnt),
        problem=problem_record(run.problem),
        **describe_origin(),
    )


def _law_entries(law: Any) -> dict[str, Any]:
    """Describe a law: its kind and fingerprint, and what it is made of by section of a recipe."""
    law = own_part(law)
    if isinstance(law, CachedLaw):
        learnt = _law_entries(law.surrogate)["surrogate"]
        kind = "cached" if learnt else "table"
        cache = asdict(law.settings)
        return {**_law_entries(law.fallback), "kind": kind, "cache": cache, "surrogate": learnt}
    entries: dict[str, Any] = {"kind": type(law).__name__, "fingerprint": "none"}
    entries |= {name: {} for name in ("cell", "rve", "cache", "surrogate")}
    if isinstance(law, RveLaw | SurrogateLaw):
        preset = next((name for name, known in PRESETS.items() if known == law.cell), "own")
        entries["cell"] = {"preset": preset, **law.cell.to_dict()}
        entries["fingerprint"] = law.cell.fingerprint
    if isinstance(law, RveLaw):
        entries |= {"kind": "rve", "rve": asdict(law.settings)}
    elif isinstance(law, SurrogateLaw):
        learnt = law.network.fingerprint(law.range)
        entries["surrogate"] = {"file": "none", "fingerprint": learnt, "errors": law.errors}
        entries |= {"kind": "surrogate", "rve": {"initialisation": law.initialisation}}
    return entries


def _stated_problem(problem: Problem) -> dict[str, Any]:
    """Describe a problem as a recipe states it, its mesh by extent, elements and digest."""
    low, high = extent(problem.mesh)
    digest = hashlib.sha256()
    for part in (problem.mesh.p.T, element_nodes(problem.mesh)):
        digest.update(np.ascontiguousarray(part).tobytes())
    width, height = (high - low).tolist()
    elements = problem.mesh.nelements
    mesh = {"file": None, "width": width, "height": height, "elements": elements}
    acts = sections_of(problem.conditions, problem.bodies, problem.watched)
    time = {
        "duration": problem.duration,
        "output_interval": problem.output_interval,
        "output_times": problem.times,
    }
    sides = {} if problem.surface is None else {"surface": {"on": problem.surface.on}}
    return {"mesh": {**mesh, "sha256": digest.hexdigest()}, **acts, "time": time, **sides}


def run_notes(record: RunRecord, recipe: Recipe) -> Iterator[tuple[str, bool]]:
    """Iterate over notes on a run, each with whether it is a warning.

    They are on tolerance, steps, contact, free sides, cache and ranks. The last one of a cached run
    is the guarantee of its closing audit.
    """
    steps = record.counts["steps"]
    described = record.problem
    yield from tolerance_notes(record, recipe)
    yield from relaxation_notes(record.met)
    if recipe.macro.integrator == "implicit" and steps > MOST_IMPLICIT_STEPS:
        yield (
            f"implicit: {steps} steps; where tissue rings so long, their errors of phase may add "
            "up to more than three tolerances, and explicit steps are more accurate and fewer",
            True,
        )
    (x_low, y_low), (x_high, y_high) = described["extent"]
    area = (x_high - x_low) * (y_high - y_low)
    side = (area / described["elements"]) ** 0.5  # of an element, about
    for name, depth in described.get("penetration", {}).items():
        if depth > 0.0:
            is_deep = depth > _DEEP * side
            wish = f"; a larger bodies.{name}.stiffness would lessen it" if is_deep else ""
            yield f"contact: {name} penetrates by {depth:.2g} µm{wish}", is_deep
    yield from sharp_notes(described.get("sharp", {}))
    yield from crossing_notes(record)
    yield from laws.surface_notes(record)
    yield from cache_notes(record)
    yield from _rank_notes(record)
    yield from closing_notes(record)


def _rank_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Say where the time of a run on several ranks went.

    What rank 0 takes for itself bounds what more ranks can gain.
    """
    if record.ranks is None:
        return
    wall = record.wall_time
    ranks = record.ranks
    total = wall["total"]
    away = ranks["computing"] + ranks["messages"]
    seconds = {
        "assembly and time stepping on rank 0": wall["macro"],
        "what the law decides there": max(0.0, wall["law"] - away),
        "computing on all ranks": ranks["computing"],
        "messages": ranks["messages"],
    }
    parts = ", ".join(f"{name} {100.0 * s / total:.0f} %" for name, s in seconds.items())
    yield (
        f"ranks: {ranks['ranks']} of {ranks['threads']} threads; {parts} of "
        f"{time_text(total)}; {ranks['tasks']} exchanges",
        False,
    )


def closing_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Say what the closing audit of a cached run guarantees, of each cell; no warnings."""
    for name, cache in caches_of(record.cache).items():
        sentence = closing_sentence(cache)
        if sentence:
            whose = f"{name}: " if name else ""
            yield f"{whose}closing audit: {sentence}", False


def buckled(t: Array, history: Mapping[str, Array], points: int) -> dict[str, Any]:
    """Describe points beyond a bifurcation for a record's `met`.

    Returns:
        Their largest number, that of all points, and the time or load factor from which on there
        are any; nothing where the law cannot tell.
    """
    beyond = history.get(BEYOND)
    if beyond is None:
        return {}
    times_beyond = t[np.flatnonzero(beyond)]
    begin = float(times_beyond[0]) if times_beyond.size else None
    return {BUCKLED: {"points": int(beyond.max(initial=0.0)), "of": points, "from": begin}}


def crossed(t: Array, history: Mapping[str, Array]) -> dict[str, Any]:
    """Return the entry of a record's `met` on outer sides that cross, where some do.

    It is the time or load factor from which they cross.
    """
    crossings = history.get(CROSSINGS)
    if crossings is None:
        return {}
    return {CROSSED: float(t[np.flatnonzero(crossings)[0]])}


def crossing_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Warn where outer sides of the tissue meet, between which there is no contact."""
    begin = record.met.get(CROSSED)
    if begin is not None:
        when = f"load factor {begin:.4g}" if is_rest(record) else f"t = {begin:.4g} µs"
        yield (
            f"outer sides of the tissue cross each other from {when} on; there is no contact of "
            "tissue with tissue, so use the results up to there",
            True,
        )


def tolerance_notes(record: RunRecord, recipe: Recipe) -> Iterator[tuple[str, bool]]:
    """Warn where the absolute tolerance is not small against the largest displacement."""
    remark = recipe.macro.remark(record.met.get("displacement", 0.0))
    if remark is not None:
        yield remark, True


def run_summary(record: RunRecord) -> str:
    """Summarise a finished run and its cost."""
    wall = record.wall_time
    counts = record.counts
    back = Counter(record.rolled_back)
    buckling = buckling_sentence(record)
    text = (
        f"{record.duration:g} µs by {record.law} in "
        f"{time_text(wall['total'])} (law {time_text(wall['law'])}, "
        f"macro {time_text(wall['macro'])}; "
        f"compilation {time_text(wall.get('compilation', 0.0))} besides), {costs(counts)}"
    )
    if back:
        text += f"; rolled back: {back['steps']} steps, {costs(back)}"
    if buckling:
        text += f"; {buckling}"
    return text


def costs(counts: Mapping[str, int]) -> str:
    """List stress points, RVE solves and, of cached laws, hits and fallbacks by reason."""
    asked = counts["stress_points"] + counts.get("dissipation_points", 0)
    text = f"{asked:,} stresses, {counts.get('rve_solves', 0):,} RVE solves"
    if "hits" not in counts:
        return text
    parts = {"audits": counts.get("audits", 0), "for the table": counts.get("table_rve_solves", 0)}
    of_these = [f"{n:,} {name}" for name, n in parts.items() if n]
    text += f" ({', '.join(of_these)})" if of_these else ""
    fallbacks = f"{counts.get('fallbacks', 0):,} fallbacks{fallback_reasons(counts)}"
    text += f", {counts['hits']:,} hits, {fallbacks}"
    records = counts.get("table_records")
    return text if records is None else f"{text}, table of {records} records"


def cache_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Iterate over notes on audits and trust of a run, each with whether it is a warning."""
    for name, cache in caches_of(record.cache).items():
        whose = "" if name is None else f"{name}: "
        yield f"{whose}audit: {audit_sentence(cache)}", False
        left_range = cache.get("left_range")
        if left_range:
            quantity, most = max(left_range.items(), key=lambda item: item[1]["points"])
            points = sum(of_quantity["points"] for of_quantity in left_range.values())
            excess = out_of_range(quantity, most["farthest"], most["bound"])
            yield (
                f"{whose}out of range: {most['points']} of {points} fallbacks by {excess} at worst",
                False,
            )
        for event in cache["trust"]["events"]:
            yield f"{whose}cache, step {event['step']}: {event['finding']}", True
    counts = record.counts
    untrusted = counts.get("fallbacks_not_trusted", 0)
    if record.law == "cached" and untrusted > MANY_UNTRUSTED * counts.get("hits", 0):
        yield (
            f"not trusted: at {untrusted:,} points the surrogate's error bound is above the "
            "tolerance; state more samples ([samples] count) and train again, let `surrofe2 "
            "refine` sample what the run meets, or allow a larger [cache] tolerance",
            True,
        )

"""What a run leaves in its folder, be it run by a command or from Python.

Its record; curves, energies, fields and decisions; and of a cached run the tables and the answers
of RVEs, which are kept with its checkpoints and written at its end.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache import CachedLaw, StressTable
from surrofe2.cache.branches import part_of, within
from surrofe2.cache.protocols import OnTrueAnswer
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import StressLaw
from surrofe2.macro import MacroRun
from surrofe2.macro.discretisation import Discretisation, make_discretisation, n_points_of
from surrofe2.macro.frames import Frames
from surrofe2.macro.internal_force import deformation_gradient
from surrofe2.plant_cell.parameters import PRESETS, CellParameters
from surrofe2.problem import Problem
from surrofe2.problem.mesh import element_nodes, extent
from surrofe2.problem.problem import label, sections_of
from surrofe2.ranks.distributed_law import own_part
from surrofe2.ranks.driver import driver_at_work
from surrofe2.recipe.recipe import Recipe
from surrofe2.rve import RveLaw
from surrofe2.store.fields import (
    DISPLACEMENT_NAME,
    F_DOT_NAME,
    F_NAME,
    RISK_NAME,
    SOURCE_NAME,
    STRESS_NAME,
    VELOCITY_NAME,
    write_fields,
    write_point_fields,
)
from surrofe2.store.run_folder import (
    RunRecord,
    caches_of,
    describe_origin,
    open_run_folder,
    write_curves,
    write_events,
    write_record,
)
from surrofe2.store.samples import HarvestWriter, Origin
from surrofe2.store.store import locked_folder, plain
from surrofe2.store.tables import write_table
from surrofe2.surrogate import SurrogateLaw
from surrofe2.workflow.cell_laws import (
    cache_report,
    cell_of_elements,
    decisions_of,
    surrogate_record,
)
from surrofe2.workflow.surfaces import surface_record

TABLE, HARVEST = "table.h5", "harvest.h5"
NO_TABLES: Mapping[str, StressTable] = MappingProxyType({})


def of_cell(file: str, cell: str) -> str:
    """The file's name with that of the cell, "" of the only one: harvest-skin.h5."""
    name, dot, kind = file.rpartition(".")
    return f"{name}-{cell}{dot}{kind}" if cell else file


class RunOutputs:
    """Tables and harvests of a run, of each cell its own, written when it ends.

    Until then true answers are kept in memory and in checkpoints, so that a harvest has exactly
    those of the run that it belongs to.
    """

    def __init__(self, recipe: Recipe, folder: Path, harvest: bool) -> None:
        self.recipe, self.folder = recipe, folder
        self._harvest = harvest
        self._writers: dict[str, HarvestWriter] = {}

    def taker(self, part: Recipe) -> OnTrueAnswer | None:
        """What a `CachedLaw` of the recipe's only cell, or of one of them, gives true answers to;
        None where nothing is harvested."""
        if not self._harvest:
            return None
        cell = part.cell_name
        self._writers[cell] = HarvestWriter(self.folder / of_cell(HARVEST, cell), origin_of(part))
        return self._writers[cell]

    def to_arrays(self) -> dict[str, NDArray]:
        """The true answers so far, for `restore`."""
        arrays: dict[str, NDArray] = {}
        for cell, writer in self._writers.items():
            arrays |= within(f"of {cell}", writer.to_arrays())
        return arrays

    def restore(self, arrays: Mapping[str, NDArray]) -> None:
        """Have these true answers and no others."""
        for cell, writer in self._writers.items():
            writer.restore(part_of(arrays, f"of {cell}"))

    def store(self, tables: Mapping[str, StressTable], seconds: float = 0.0) -> None:
        """Write what there is now, each file whole, and what it took so far."""
        for writer in self._writers.values():
            writer.flush(seconds)
        for name, table in tables.items():
            path = self.folder / of_cell(TABLE, name)
            write_table(path, table, self.recipe.to_dict(), seconds)


def origin_of(recipe: Recipe) -> Origin:
    """Where answers for a recipe come from."""
    return Origin(cell=recipe.cell, rve=asdict(recipe.rve), recipe=recipe.to_dict())


def new_record(recipe: Recipe, law: str, surrogate: Mapping[str, Any] | None = None) -> RunRecord:
    """The record of a run by the law of this name that is about to start."""
    return RunRecord(
        status="running",
        recipe=recipe.to_dict(),
        law=law,
        initialisation=recipe.rve.initialisation,
        solver=recipe.rve.solver,
        cell_fingerprint=recipe.fingerprint,
        seed=None if len(recipe.cells) > 1 else recipe.samples.seed,
        surrogate=surrogate,
        **describe_origin(),
    )


def save_run(run: MacroRun, folder: str | Path, *, fresh: bool = False) -> RunRecord:
    """Write the run folder that the command `surrofe2 run` would write; `read_run` reads it back.

    `surrofe2 compare` and `zoom` take it like any other; there is nothing to continue from.

    Args:
        fresh: write over whatever run the folder holds.

    Raises:
        FileError: the folder cannot be written, or has files but no run.
        MismatchError: it has a run of other settings.
    """
    folder = Path(folder)
    record = with_results(_record_of(run), run)
    with locked_folder(folder):
        begun = replace(record, status="running")
        if open_run_folder(folder, begun, fresh=fresh) is not None:
            write_record(folder, begun)
        write_results(folder, run)
        write_record(folder, record)
    return record


def write_results(folder: Path, run: MacroRun) -> None:
    """Write curve.csv, history.csv, energies.csv, fields, points and, of a cached run, events."""
    write_curves(folder, run)
    cell = cell_of_elements(run.law, len(run.elements))
    write_fields(folder, run.nodes, run.elements, run.frames, cell)
    write_points(folder, make_discretisation(run.problem.mesh), run.frames)
    decisions = decisions_of(run.law)
    if decisions is not None:
        write_events(folder, decisions)


def write_points(folder: Path, space: Discretisation, frames: Frames) -> None:
    """Write points.xdmf and points.h5: the law's points, F and Ḟ by the displacement of nodes."""
    at = np.isin(frames.t, frames.point_t)
    u, v = frames.displacement[at], frames.velocity[at]
    moved = [deformation_gradient(space, *motion) for motion in zip(u, v, strict=True)]
    write_point_fields(
        folder,
        space.point_positions(),
        frames.point_t,
        {
            DISPLACEMENT_NAME: np.stack([space.at_points(each) for each in u]),
            VELOCITY_NAME: np.stack([space.at_points(each) for each in v]),
            F_NAME: np.stack([F for F, _, _ in moved]),
            F_DOT_NAME: np.stack([F_dot for _, F_dot, _ in moved]),
            STRESS_NAME: frames.point_stress,
            SOURCE_NAME: frames.point_source,
            RISK_NAME: frames.point_risk,
        },
        space.points_per_element,
    )


def with_results(
    record: RunRecord, run: MacroRun, tables: Mapping[str, StressTable] = NO_TABLES
) -> RunRecord:
    """The record with what a run, whole or not, met and cost, and what its tables began with."""
    driver, begun = driver_at_work(), sum(table.seconds for table in tables.values())
    problem = {**record.problem, "penetration": penetrations(run)}
    cache = cache_report(run.law, whole=run.finished)  # which audits what still waits
    wall = {k: v + begun if k in ("total", "law") else v for k, v in run.wall_time.items()}
    return replace(
        with_rest(replace(record, problem=problem), run.rest),
        ranks=None if driver is None else driver.report(),
        wall_time=wall,
        counts=_counts(run, cache, tables),
        cache=cache,
        met=run.met.to_dict(),
        threads=run.threads,
    )


def _counts(
    run: MacroRun, cache: Mapping[str, Any] | None, tables: Mapping[str, StressTable]
) -> dict[str, int]:
    """What a run counted; audits and what tables learn are RVE solves like others, and named."""
    counts = Counter({**run.counts, **run.effort})
    if cache is not None:
        audits = sum(each["audit"]["audited"] for each in caches_of(cache).values())
        counts.update(rve_solves=audits, audits=audits)
    for table in tables.values():
        changed = {f"table_{name.removeprefix('table_')}": n for name, n in table.counts.items()}
        counts.update(table_records=table.size, rve_solves=changed.get("table_rve_solves", 0))
        counts.update(changed)
    return dict(counts)


def with_rest(record: RunRecord, rest: np.ndarray | None) -> RunRecord:
    """The record with how far free sides moved a tissue before the run, `System.rest`, µm."""
    surface = record.problem.get("surface")
    if not surface or rest is None:
        return record
    moved = float(np.linalg.norm(rest, axis=1).max(initial=0.0))
    return replace(record, problem={**record.problem, "surface": {**surface, "rest": moved}})


def penetrations(run: MacroRun) -> dict[str, float]:
    """Largest penetration of each rigid body, µm."""
    return {
        name.removeprefix("penetration "): float(depth.max(initial=0.0))
        for name, depth in run.history.items()
        if name.startswith("penetration ")
    }


def problem_record(problem: Problem) -> dict[str, Any]:
    """What a problem consists of: counts of its mesh by name, and what acts on it."""
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
        "watched": {name: list(at) for name, at in problem.watched.items()},
        **({"surface": surface_record(problem)} if problem.surface is not None else {}),
    }


def _record_of(run: MacroRun) -> RunRecord:
    """The record of a run that no recipe stated."""
    laws = run.law.laws if isinstance(run.law, RegionalLaw) else {"": run.law}
    found = {name: _law_entries(law) for name, law in laws.items()}
    if isinstance(run.law, RegionalLaw):
        sections: dict[str, Any] = {"cells": {}}
        for name, each in found.items():
            sections["cells"][name] = {**each["cell"], "rve": each["rve"], "regions": [name]}
    else:
        sections = {k: found[""][k] for k in ("cell", "rve")} if found[""]["cell"] else {}
    sections |= next(({"cache": each["cache"]} for each in found.values() if each["cache"]), {})
    sections |= {**_stated_problem(run.problem), "macro": asdict(run.settings)}
    learnt = {name: each["surrogate"] for name, each in found.items() if each["surrogate"]}

    def joined(values: Iterable[str]) -> str:
        return ", ".join(dict.fromkeys(values))

    return RunRecord(
        status="finished" if run.finished else "failed",
        recipe=plain({"recipe": None, **sections}),
        law=joined(each["kind"] for each in found.values()),
        initialisation=joined(each["rve"].get("initialisation", "none") for each in found.values()),
        solver=joined(each["rve"].get("solver", "none") for each in found.values()),
        cell_fingerprint=" ".join(each["fingerprint"] for each in found.values()),
        surrogate=surrogate_record(learnt),
        problem=problem_record(run.problem),
        **describe_origin(),
    )


def _law_entries(law: StressLaw) -> dict[str, Any]:
    """A law as run.json has it: kind, fingerprint, and by section of a recipe what it is made of.

    Of a law that is not of this package, the name of its class.
    """
    law = own_part(law)
    sections: dict[str, Any] = {"cell": {}, "rve": {}, "cache": {}, "surrogate": {}}
    match law:
        case RveLaw():
            found = {"kind": "rve", "rve": asdict(law.settings), **_cell_entries(law.cell)}
        case SurrogateLaw():
            learnt = {
                "file": "none",
                "fingerprint": law.network.fingerprint(law.range),
                "errors": law.errors,
            }
            rve = {"initialisation": law.initialisation}
            found = {"kind": "surrogate", "rve": rve, "surrogate": learnt}
            found |= _cell_entries(law.cell)
        case CachedLaw():
            found = {**_law_entries(law.fallback), "kind": "table", "cache": asdict(law.settings)}
            known = law.surrogate
            if isinstance(known, SurrogateLaw):
                found |= {"kind": "cached", "surrogate": _law_entries(known)["surrogate"]}
        case _:
            found = {"kind": type(law).__name__, "fingerprint": "none"}
    return sections | found


def _cell_entries(cell: CellParameters) -> dict[str, Any]:
    """A cell as a recipe has it, and its fingerprint."""
    preset = next((name for name, known in PRESETS.items() if known == cell), "own")
    return {"cell": {"preset": preset, **cell.to_dict()}, "fingerprint": cell.fingerprint}


def _stated_problem(problem: Problem) -> dict[str, Any]:
    """A problem as a recipe has it, its mesh by extent, number of elements and digest."""
    low, high = extent(problem.mesh)
    digest = hashlib.sha256()
    for part in (problem.mesh.p.T, element_nodes(problem.mesh)):
        digest.update(np.ascontiguousarray(part).tobytes())
    (width, height), elements = (high - low).tolist(), problem.mesh.nelements
    mesh = {"file": None, "width": width, "height": height, "elements": elements}
    acts = sections_of(problem.conditions, problem.bodies, problem.watched)
    time = {"duration": problem.duration, "output_interval": problem.output_interval}
    sides = {} if problem.surface is None else {"surface": {"on": problem.surface.on}}
    return {"mesh": {**mesh, "sha256": digest.hexdigest()}, **acts, "time": time, **sides}

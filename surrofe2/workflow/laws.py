"""The stress law of a run: chosen by name, its parts read from files; of one cell or several.

And the law of free sides: tabulated once, kept, given to a problem.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
import skfem
from threadpoolctl import threadpool_limits

from surrofe2.base.arrays import Array
from surrofe2.base.clock import Meter
from surrofe2.base.environment import cores
from surrofe2.base.errors import FileError, InputError, MismatchError
from surrofe2.base.kernel_cache import cache_folder
from surrofe2.cache import CachedLaw, StressTable, sampled_spread
from surrofe2.cache.protocols import Fallback, OnTrueAnswer
from surrofe2.cache.table.records import merged
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import StressLaw
from surrofe2.law.surface_law import SurfaceLaw
from surrofe2.macro.free_sides import free_sides
from surrofe2.problem import Problem, Surface
from surrofe2.problem.mesh import extent
from surrofe2.ranks.distributed_law import shared
from surrofe2.recipe.recipe import CellName, CellStudy, Recipe, load_recipe
from surrofe2.rve import RveLaw
from surrofe2.store.hdf5 import read_seconds
from surrofe2.store.run_folder import RunRecord
from surrofe2.store.samples import kept_reference
from surrofe2.store.store import digest
from surrofe2.store.surrogates import check_surrogate, content_fingerprint, read_surrogate
from surrofe2.store.tables import (
    check_surface,
    check_table,
    read_surface,
    read_table,
    write_surface,
)
from surrofe2.surface.slab_law import SlabLaw, rows_across
from surrofe2.surface.tabulated import TabulatedSurface, table_within
from surrofe2.surrogate.piola import QuadraticLaw

# Lowest and highest stretch, and rate (1/µs), of a surface table where the recipe has no range.
SURFACE_RANGE = (0.94, 1.04, 0.01)
# Where it has one, the table reaches beyond it: by so much stretch, and to so many times the rate.
_MARGIN = 0.01
_FASTER = 1.5
# Least rate by which a surface table is made, 1/µs, since the range of a rest may have 0.
_LEAST_RATE = 1e-4


def true_law(study: CellStudy) -> RveLaw:
    """Make the RVEs of a plant cell, around their kept reference state, see `kept_reference`."""
    parameters = study.cell.parameters
    return RveLaw(parameters, study.recipe.rve, reference=kept_reference(parameters))


def quadratic_law(study: CellStudy) -> QuadraticLaw:
    """Make the law of the tangents at rest of a plant cell's RVE."""
    direct = replace(study.recipe.rve, solver="direct")  # iterated RVEs have no tangents
    return QuadraticLaw.of(true_law(replace(study, recipe=replace(study.recipe, rve=direct))))


@dataclass(frozen=True, slots=True)
class ChosenLaw:
    """The law of a cell, chosen by its name.

    Attributes:
        law: the law.
        surrogate: record of its surrogate, or of the tables that it began with; None of others.
        table: the table that it learns; None of others.
    """

    law: StressLaw
    surrogate: Mapping[str, Any] | None = None
    table: StressTable | None = None


def check_solver(recipe: Recipe) -> None:
    """Refuse tables of RVEs without tangents."""
    if recipe.rve.solver == "iterated":
        raise InputError('rve.solver: "iterated"; tables need tangents, so "direct"')


def choose_law(
    study: CellStudy,
    kind: str,
    surrogate_file: Path | None = None,
    tables: Sequence[Path] = (),
    on_true_answer: OnTrueAnswer | None = None,
) -> ChosenLaw:
    """Make the law called `kind` of a plant cell, by default with the surrogate of the recipe.

    RVEs are on all ranks where this process drives several. A run by a table starts from `tables`.

    Raises:
        FileError: the surrogate is not there or cannot be read.
        InputError: tables for a law that takes none.
        MismatchError: surrogate or table are of other cell parameters or initialisation.
    """
    if tables and kind != "table":
        raise InputError(f"--table: not with --law {kind}; it must be table")
    if kind == "rve":
        return ChosenLaw(shared(true_law(study)))
    if kind == "table":
        rve = shared(true_law(study))
        table = make_table(study, rve, tables)
        law = CachedLaw(table, rve, study.recipe.cache, on_true_answer)
        return ChosenLaw(law, _record_of(tables), table)
    path = surrogate_file or study.training_path()
    if surrogate_file is None and not path.exists():
        raise FileError(
            f"{path}: cannot be read: no such file; make it with `surrofe2 train "
            f"{study.recipe.path}`"
        )
    surrogate = read_surrogate(path)
    record = {
        "file": path.name,
        "fingerprint": content_fingerprint(path),
        "errors": surrogate.errors,
        "seconds": dict(surrogate.seconds),
    }
    check_surrogate(path, surrogate, study.cell.parameters, study.recipe.rve.initialisation)
    if kind == "surrogate":
        return ChosenLaw(surrogate, record)
    law = CachedLaw(surrogate, shared(true_law(study)), study.recipe.cache, on_true_answer)
    return ChosenLaw(law, record)


def make_table(study: CellStudy, law: Fallback, files: Sequence[Path] = ()) -> StressTable:
    """Make a table of a plant cell, with the records of these files, or of the undeformed state.

    Its `seconds` are what these records took. The spread of the stress is that of the first file,
    or of samples.

    Raises:
        MismatchError: a file is of other cell parameters or initialisation.
    """
    recipe = study.recipe
    wanted = study.sampling_range()
    meter = Meter()
    tables = [read_table(path) for path in files]
    for path, stored in zip(files, tables, strict=True):
        check_table(path, stored, study.cell.parameters, recipe.rve.initialisation)
    spread = tables[0].stress_spread if tables else sampled_spread(law, wanted)
    tolerance = recipe.table.tolerance * spread
    most = recipe.table.most_records
    table = StressTable(law, tolerance, wanted, spread, most_records=most)
    for stored in tables:
        table.restore(merged(table.records, stored.records, tolerance, table.images))
    if not table.size:
        table.learn_rest()
    table.seconds = meter.seconds
    return table


def _record_of(tables: Sequence[Path]) -> dict[str, Any] | None:
    """Return the record of the tables that a law began with; None of no table."""
    if not tables:
        return None
    names = [path.name for path in tables]
    fingerprints = [digest(path)[:16] for path in tables]
    seconds = {str(path): read_seconds(path) for path in tables}
    is_known = None not in seconds.values()
    return {
        "file": ", ".join(names),
        "fingerprint": " ".join(fingerprints),
        "errors": {},
        "seconds": seconds if is_known else {},
    }


def surrogates_by_cell(recipe: Recipe, files: Sequence[Path]) -> dict[CellName, Path]:
    """Sort files of surrogates by the cells that they were trained for, at most one for each.

    Raises:
        InputError: two files are of one cell.
    """
    files_of = files_by_cell(recipe, files, "--surrogate")
    for name, paths in files_of.items():
        if len(paths) > 1:
            of = "the recipe's only cell" if name is None else f"cell {name}"
            raise InputError(f"--surrogate: {paths[0]} and {paths[1]}; both are of {of}, give one")
    return {name: paths[0] for name, paths in files_of.items() if paths}


def files_by_cell(recipe: Recipe, files: Sequence[Path], option: str) -> dict[CellName, list[Path]]:
    """Sort the files of --surrogate or --table by the cells whose RVEs they are of.

    Raises:
        MismatchError: a file has the parameters and initialisation of none of several cells.
    """
    if len(recipe.cells) == 1:  # whether they are of it is seen where they are taken
        return {name: [*files] for name in recipe.cells}
    files_of: dict[CellName, list[Path]] = {name: [] for name in recipe.cells}
    for path in files:
        stored = read_table(path) if option == "--table" else read_surrogate(path)
        same_method = stored.initialisation == recipe.rve.initialisation
        names = [
            name
            for name, cell in recipe.cells.items()
            if same_method and cell.parameters == stored.cell
        ]
        if not names:
            cells = ", ".join(str(name) for name in recipe.cells)
            raise MismatchError(
                f"{option}: {path}; cell parameters {stored.cell.fingerprint} by "
                f"{stored.initialisation} are of none of the cells {cells}"
            )
        for name in names:
            files_of[name].append(path)
    return files_of


def cell_of_elements(law: StressLaw, elements: int) -> Array | None:
    """Return the number (elements,) of the law of each element; None where there is one for all."""
    if not isinstance(law, RegionalLaw):
        return None
    numbers = np.empty(elements)
    for k, points in enumerate(law.points.values()):
        numbers[points * elements // law.density.size] = k
    return numbers


def law_by_region(
    recipe: Recipe, mesh: skfem.Mesh, law_of: Callable[[CellStudy], StressLaw]
) -> StressLaw:
    """Make the law of a recipe's cell, or of its cells, each at the points of its regions."""
    points = recipe.points_of_cells(mesh)
    if not points:  # [cell] fills all of them
        return law_of(recipe.study())
    return RegionalLaw({name: law_of(CellStudy(recipe, name)) for name in points}, points)


def surrogate_record(
    surrogates: Mapping[CellName, Mapping[str, Any]],
) -> dict[str, Any] | None:
    """Return what to record of surrogates by name of the cell; None where there is none."""
    if not surrogates:
        return None
    if None in surrogates:
        return dict(surrogates[None])
    return {
        "file": ", ".join(record["file"] for record in surrogates.values()),
        "fingerprint": " ".join(record["fingerprint"] for record in surrogates.values()),
        "errors": {name: record["errors"] for name, record in surrogates.items()},
        "seconds": {
            f"{part} of {name}": seconds
            for name, record in surrogates.items()
            for part, seconds in record.get("seconds", {}).items()
        },
    }


def with_surface(recipe: Recipe, problem: Problem) -> Problem:
    """Return the problem with the surface law of its plant cells, if the recipe has a [surface]."""
    if recipe.surface is None:
        return problem
    low, high = extent(problem.mesh)
    thickness = (high - low).min()

    def law_of(study: CellStudy) -> SurfaceLaw:
        """Make the surface law of a cell."""
        return cell_surface(study, float(thickness / study.cell.parameters.cell_side))

    points = recipe.points_of_cells(problem.mesh)
    if not points:  # [cell] fills all of them
        return replace(problem, surface=Surface(law=law_of(recipe.study()), on=recipe.surface.on))
    laws = {name: law_of(CellStudy(recipe, name)) for name in points}
    n_q = sum(map(len, points.values())) // problem.mesh.nelements  # points of an element
    elements = {name: np.unique(points_of_cell // n_q) for name, points_of_cell in points.items()}
    return replace(problem, surface=Surface(law=laws, on=recipe.surface.on, regions=elements))


def cell_surface(study: CellStudy, across: float) -> TabulatedSurface:
    """Read or make the table of the surface law of a tissue that is `across` plant cells thick."""
    cell = study.cell.parameters
    method = study.recipe.rve.initialisation
    rows = rows_across(across)
    low, high, rate = SURFACE_RANGE
    samples = study.cell.range
    if samples is not None:
        shortest, longest = samples.stretch
        low = shortest - _MARGIN
        high = float(np.hypot(longest, samples.shear)) + _MARGIN  # a sheared side is longer, too
        rate = _FASTER * max(samples.rate, _LEAST_RATE)

    def slab() -> SlabLaw:
        """Make the law that is tabulated."""
        reference = kept_reference(cell)
        return SlabLaw(cell, initialisation=method, reference=reference, rows=rows)

    of = f"{cell.fingerprint}-{cell.outer_wall:g}-{method}-{rows}"
    path = cache_folder() / "surfaces" / f"{of}-{low:.6g}-{high:.6g}-{rate:.6g}.h5"
    try:
        table = read_surface(path)
        check_surface(path, table, cell, method)
    except (FileError, MismatchError):
        table = table_within(slab(), (low, high), rate)
        with suppress(FileError):  # a folder that cannot be written keeps nothing
            write_surface(path, table, study.to_dict())
    return replace(table, rows=rows, beyond=cache(slab))


def surface_record(problem: Problem) -> dict[str, Any]:
    """Describe the free sides of a problem with a surface law, and their laws, for a record."""
    assert problem.surface is not None
    sides = free_sides(problem)
    law = problem.surface.law
    laws = law if isinstance(law, Mapping) else {"": law}  # JSON has no other key for no name
    return {
        "on": problem.surface.on,
        "sides": len(sides.nodes),
        "oblique": int((sides.oblique > 0.0).sum()),
        "largest_angle": float(sides.oblique.max()),
        "laws": {name: _law_record(surface_law) for name, surface_law in laws.items()},
    }


def _law_record(law: SurfaceLaw) -> dict[str, Any]:
    """Describe a surface law for a record."""
    if not isinstance(law, TabulatedSurface | SlabLaw):
        return {"kind": type(law).__name__}
    names = ["initialisation", "rows"]
    if isinstance(law, TabulatedSurface):
        names += ["stretch", "rate", "error", "spread"]
    return {
        "kind": "slab" if isinstance(law, SlabLaw) else "table",
        "cell_fingerprint": law.cell.fingerprint,
        "outer_wall": law.cell.outer_wall,
        **{name: getattr(law, name) for name in names},
    }


def recipe_notes(recipe: Recipe) -> Iterator[tuple[str, bool]]:
    """Iterate over notes on the recipe's cells, each with whether it is a warning.

    Cells that had SPH fluid in earlier versions may have a uniform one by default, and constants
    are not taken where a measurement determines them.
    """
    for name, cell in recipe.cells.items():
        section = "cell" if name is None else f"cells.{name}"
        for constant, measured in cell.overruled.items():
            yield f"{section}.{constant}: not taken, as {section}.{measured} determines it", True
    unnamed = [cell for cell in recipe.cells.values() if not cell.names_fluid]
    changed = [cell for cell in unnamed if cell.parameters.has_uniform_fluid]
    if changed:
        names = sorted({f"{cell.preset}, {cell.parameters.arrangement}" for cell in changed})
        yield (
            f"fluid: uniform, the default of {'; '.join(names)}; earlier versions had "
            'fluid = "sph" there',
            False,
        )


def surface_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Iterate over notes on the free sides of a run, each with whether it is a warning."""
    surface = record.problem.get("surface")
    if not surface:
        return
    on = surface["on"] if isinstance(surface["on"], str) else ", ".join(surface["on"])
    yield (
        f"surface: {surface['sides']} sides ({on}); at rest moved by {surface['rest']:.2g} µm",
        False,
    )
    if surface["oblique"]:
        yield (
            f"surface: {surface['oblique']} sides are oblique to the rows of plant cells, by up to "
            f"{surface['largest_angle']:.3g}°; they take the law of the nearer direction",
            True,
        )


def open_study(path: Path, threads: int | None) -> Recipe:
    """Read the recipe of a study, for which so many threads are used."""
    recipe = load_recipe(path)
    use_threads(threads)
    return recipe


def use_threads(wanted: int | None) -> None:
    """Limit numba, BLAS and torch to so many threads; None: as many as they have.

    Raises:
        InputError: more than the process may use.
    """
    if wanted is None:
        return
    available = min(cores(), numba.config.NUMBA_NUM_THREADS)
    if wanted > available:
        raise InputError(
            f"--threads: {wanted}; this process may use {available}: it has {cores()} of "
            f"{os.cpu_count()} cores, by affinity and CPU quota, and NUMBA_NUM_THREADS is "
            f"{numba.config.NUMBA_NUM_THREADS}"
        )
    # processes that this one starts read these
    os.environ["OMP_NUM_THREADS"] = str(wanted)
    os.environ["OPENBLAS_NUM_THREADS"] = str(wanted)
    numba.set_num_threads(wanted)
    threadpool_limits(wanted)

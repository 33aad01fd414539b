"""The surface law of a recipe's plant cells: tabulated once, kept, given to a problem."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from surrofe2.base.compilation import cache_folder
from surrofe2.base.errors import FileError, MismatchError
from surrofe2.law.surface_law import SurfaceLaw
from surrofe2.macro.free_sides import free_sides
from surrofe2.problem import Problem, Surface
from surrofe2.problem.mesh import extent
from surrofe2.recipe.recipe import Recipe
from surrofe2.store.run_folder import RunRecord
from surrofe2.store.tables import check_surface, read_surface, write_surface
from surrofe2.surface.slab_law import SlabLaw, rows_across
from surrofe2.surface.tabulated import TabulatedSurface, table_within
from surrofe2.workflow.laws import kept_reference

STRETCH, RATE = (0.94, 1.04), 0.01
"""Range of a table where the recipe has none; rate in 1/µs."""
_MARGIN, _FASTER = 0.01, 1.5


def with_surface(recipe: Recipe, problem: Problem) -> Problem:
    """The problem with the surface law of its plant cells, if the recipe has a [surface]."""
    if recipe.surface is None:
        return problem
    low, high = extent(problem.mesh)
    thickness = (high - low).min()
    laws: dict[str, SurfaceLaw] = {
        name: cell_surface(part, float(thickness / part.cell.cell_side))
        for name, part in recipe.parts().items()
    }
    if "" in laws:
        return replace(problem, surface=Surface(law=laws[""], on=recipe.surface.on))
    share = problem.mesh.nelements
    points = recipe.points_of_cells(problem.mesh)
    n_q = sum(map(len, points.values())) // share
    elements = {name: np.unique(own // n_q) for name, own in points.items()}
    return replace(problem, surface=Surface(law=laws, on=recipe.surface.on, regions=elements))


def cell_surface(recipe: Recipe, across: float) -> TabulatedSurface:
    """The surface law of a recipe's only cell, `across` plant cells: its table, kept or made."""
    cell, method, (stretch, rate) = recipe.cell, recipe.rve.initialisation, _bounds(recipe)
    rows = rows_across(across)

    def slab() -> SlabLaw:
        reference = kept_reference(cell)
        return SlabLaw(cell, initialisation=method, reference=reference, rows=rows)

    (low, high), of = stretch, f"{cell.fingerprint}-{cell.outer_wall:g}-{method}-{rows}"
    path = cache_folder() / "surfaces" / f"{of}-{low:.6g}-{high:.6g}-{rate:.6g}.h5"
    table = None
    if path.exists():
        with suppress(FileError, MismatchError):
            table = read_surface(path)
            check_surface(path, table, cell, method)
    if table is None:
        table = table_within(slab(), stretch, rate)
        with suppress(FileError):  # a folder that cannot be written keeps nothing
            write_surface(path, table, recipe.to_dict())
    return replace(table, rows=rows, beyond=cache(slab))


def surface_record(problem: Problem) -> dict[str, Any]:
    """The free sides of a problem with a surface law, and whose law they have."""
    assert problem.surface is not None
    sides, law = free_sides(problem), problem.surface.law
    laws = law if isinstance(law, Mapping) else {"": law}
    return {
        "on": problem.surface.on,
        "sides": len(sides.nodes),
        "oblique": int((sides.oblique > 0.0).sum()),
        "largest_angle": float(sides.oblique.max()),
        "laws": {name: _law_record(each) for name, each in laws.items()},
    }


def _law_record(law: SurfaceLaw) -> dict[str, Any]:
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


def surface_notes(record: RunRecord) -> Iterator[tuple[str, bool]]:
    """Sentences on the free sides of a run, each with whether it is a warning."""
    found = record.problem.get("surface")
    if not found:
        return
    on = found["on"] if isinstance(found["on"], str) else ", ".join(found["on"])
    yield f"surface: {found['sides']} sides ({on}); at rest moved by {found['rest']:.2g} µm", False
    if found["oblique"]:
        yield (
            f"surface: {found['oblique']} sides are oblique to the rows of plant cells, by up to "
            f"{found['largest_angle']:.3g}°; they take the law of the nearer direction",
            True,
        )


def _bounds(recipe: Recipe) -> tuple[tuple[float, float], float]:
    """Range of a table: that of the recipe's samples, and more."""
    if recipe.range is None:
        return STRETCH, RATE
    low, high = recipe.range.stretch
    longest = float(np.hypot(high, recipe.range.shear))
    return (low - _MARGIN, longest + _MARGIN), _FASTER * max(recipe.range.rate, 1e-4)

"""The stress law of tissue of several cell types, from the law of each: chosen, stored, reported.

Of a recipe with one cell all is as `laws` has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import skfem
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.cache import CachedLaw
from surrofe2.cache.branches import part_of, within
from surrofe2.cache.protocols import OnTrueAnswer
from surrofe2.law.regional_law import RegionalLaw
from surrofe2.law.stress_law import StressLaw
from surrofe2.ranks.distributed_law import DistributedLaw
from surrofe2.recipe.recipe import Recipe
from surrofe2.rve import RveLaw
from surrofe2.store.surrogates import read_surrogate
from surrofe2.store.tables import StoredTable, read_table
from surrofe2.surrogate import SurrogateLaw
from surrofe2.workflow.laws import ChosenLaw, choose_law

Array = NDArray[np.float64]
Taker = Callable[[Recipe], OnTrueAnswer | None]
"""What takes the true answers of a cell."""

NO_FILES: Mapping[str, Path] = MappingProxyType({})


def choose_laws(
    recipe: Recipe,
    kind: str,
    mesh: skfem.Mesh,
    surrogates: Mapping[str, Path] = NO_FILES,
    tables: Sequence[Path] = (),
    taker: Taker = lambda recipe: None,
) -> ChosenLaw:
    """The law called `kind` of each cell of a recipe, each at the points of its regions.

    Args:
        surrogates: files by name of the cell, in the place of the recipe's; see `files_by_cell`.
        tables: files to start from, each for the cells whose answers it has.

    Raises:
        MismatchError: a surrogate or a table is of other cell parameters or initialisation.
    """
    of_cells = _by_cell(recipe, tables, read_table, "--table")
    chosen = {
        name: choose_law(part, kind, surrogates.get(name), of_cells[name], taker(part))
        for name, part in recipe.parts().items()
    }
    return ChosenLaw(
        law_by_region(recipe, mesh, lambda part: chosen[part.cell_name].law),
        surrogate_record({name: each.surrogate for name, each in chosen.items() if each.surrogate}),
        {name: table for each in chosen.values() for name, table in each.tables.items()},
    )


def files_by_cell(recipe: Recipe, files: Sequence[Path]) -> dict[str, Path]:
    """Files of surrogates by name of the cells that they were trained for.

    Raises:
        InputError: two are for one cell.
        MismatchError: one is for none of the cells.
    """
    found = _by_cell(recipe, files, read_surrogate, "--surrogate")
    for name, paths in found.items():
        if len(paths) > 1:
            of = f"cell {name}" if name else "the recipe's only cell"
            raise InputError(f"--surrogate: {paths[0]} and {paths[1]}; both are of {of}, give one")
    return {name: paths[0] for name, paths in found.items() if paths}


def _by_cell(
    recipe: Recipe,
    files: Sequence[Path],
    read: Callable[[Path], SurrogateLaw | StoredTable],
    option: str,
) -> dict[str, list[Path]]:
    """Files by name of the cells whose parameters and initialisation they have."""
    parts = recipe.parts()
    if len(parts) == 1:  # whether they are of it is seen where they are taken
        return {name: [*files] for name in parts}
    found: dict[str, list[Path]] = {name: [] for name in parts}
    for path in files:
        stored = read(path)
        of = stored.cell, stored.initialisation
        own = [name for name, part in parts.items() if of == (part.cell, part.rve.initialisation)]
        if not own:
            raise MismatchError(
                f"{option}: {path}; cell parameters {stored.cell.fingerprint} by "
                f"{stored.initialisation} are of none of the cells {', '.join(parts)}"
            )
        for name in own:
            found[name].append(path)
    return found


def cell_of_elements(law: StressLaw, elements: int) -> Array | None:
    """(elements,) number of the law that each element asks; None where there is one for all."""
    if not isinstance(law, RegionalLaw):
        return None
    found = np.empty(elements)
    for k, points in enumerate(law.points.values()):
        found[points * elements // law.density.size] = k
    return found


def law_by_region(
    recipe: Recipe, mesh: skfem.Mesh, law_of: Callable[[Recipe], StressLaw]
) -> StressLaw:
    """The law of a recipe's cell, or of its cells, each at the points of its regions."""
    laws = {name: law_of(part) for name, part in recipe.parts().items()}
    return laws[""] if "" in laws else RegionalLaw(laws, recipe.points_of_cells(mesh))


def surrogate_record(surrogates: Mapping[str, Mapping[str, Any]]) -> dict[str, Any] | None:
    """What to record of the surrogates of several cells, or of the only one, called ""."""
    if not surrogates:
        return None
    if "" in surrogates:
        return dict(surrogates[""])
    return {
        "file": ", ".join(each["file"] for each in surrogates.values()),
        "fingerprint": " ".join(each["fingerprint"] for each in surrogates.values()),
        "errors": {name: each["errors"] for name, each in surrogates.items()},
        "seconds": {
            f"{part} of {name}": seconds
            for name, each in surrogates.items()
            for part, seconds in each.get("seconds", {}).items()
        },
    }


def law_arrays(law: StressLaw, state: Any) -> dict[str, NDArray]:
    """What a law must know to go on from the committed `state`, to the bit."""
    if isinstance(law, CachedLaw):
        return law.to_arrays(state)
    if isinstance(law, RveLaw | DistributedLaw) and state is not None:
        arrays: dict[str, NDArray] = state.to_arrays()
        return arrays
    if not isinstance(law, RegionalLaw):
        return {}
    arrays = {}
    states = [None] * len(law.laws) if state is None else state
    for (name, each), own in zip(law.laws.items(), states, strict=True):
        arrays |= within(name, law_arrays(each, own))
    return arrays


def law_state(law: StressLaw, arrays: Mapping[str, NDArray]) -> Any:
    """The committed state whose `law_arrays` these are; None of a law that keeps none."""
    if isinstance(law, CachedLaw):
        return law.from_arrays(arrays)
    if isinstance(law, RveLaw | DistributedLaw) and arrays:
        return law.state_from_arrays(arrays)
    if not isinstance(law, RegionalLaw):
        return None
    states = [law_state(each, part_of(arrays, name)) for name, each in law.laws.items()]
    return None if all(state is None for state in states) else tuple(states)


def cache_report(law: StressLaw, *, whole: bool = False) -> dict[str, Any] | None:
    """What a cached law has to report, of several cells under `cells` by name; None of others.

    Args:
        whole: the run is over: audit what waits.
    """
    if isinstance(law, CachedLaw):
        return law.report() if whole else law.history()
    if not isinstance(law, RegionalLaw):
        return None
    found = {name: cache_report(each, whole=whole) for name, each in law.laws.items()}
    return {"cells": found} if all(found.values()) else None


def decisions_of(law: StressLaw) -> list[dict[str, Any]] | None:
    """The decisions of a cached law on chunks of steps, of several cells each with its name, in
    the order of time; None of other laws."""
    if isinstance(law, CachedLaw):
        return law.decisions
    if not isinstance(law, RegionalLaw):
        return None
    found = [
        {"cell": name, **line}
        for name, each in law.laws.items()
        for line in decisions_of(each) or ()
    ]
    return sorted(found, key=lambda line: float(line["t"])) if law.is_audited else None

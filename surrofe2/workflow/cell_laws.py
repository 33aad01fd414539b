"""The stress law of tissue of several cell types, from the law of each: chosen, stored, reported.

Of a recipe with one cell all is as `laws` has it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from surrofe2.cache import CachedLaw
from surrofe2.cache.branches import part_of, within
from surrofe2.cache.protocols import OnTrueAnswer
from surrofe2.errors import InputError
from surrofe2.macro.mesh import Mesh
from surrofe2.recipe import Recipe
from surrofe2.regional_law import RegionalLaw
from surrofe2.stress_law import StressLaw
from surrofe2.workflow.laws import ChosenLaw, choose_law

Taker = Callable[[Recipe], OnTrueAnswer | None]
"""What takes the true answers of a cell."""


def choose_laws(
    recipe: Recipe,
    kind: str,
    mesh: Mesh,
    surrogate_file: Path | None = None,
    tables: Sequence[Path] = (),
    taker: Taker = lambda recipe: None,
) -> ChosenLaw:
    """The law called `kind` of each cell of a recipe, each at the points of its regions.

    Raises:
        InputError: tables, or one surrogate file, for several cells.
        MismatchError: a surrogate is of other cell parameters or initialisation.
    """
    if not recipe.types:
        return choose_law(recipe, kind, surrogate_file, tables, taker(recipe))
    if kind == "table" or tables or recipe.table.enabled:
        raise InputError(
            f"{recipe.path.name}: cells: {', '.join(recipe.types)}; tables know one cell: use "
            "--law rve or cached, without [table] enabled"
        )
    if surrogate_file is not None:
        raise InputError(
            f"--surrogate: {surrogate_file}; the recipe has the cells {', '.join(recipe.types)}: "
            "give each its cells.NAME.training.file"
        )
    chosen = {
        name: choose_law(part, kind, on_true_answer=taker(part))
        for name, part in recipe.parts().items()
    }
    laws = {name: each.law for name, each in chosen.items()}
    return ChosenLaw(
        RegionalLaw(laws, recipe.points_of_cells(mesh)),
        tuple(part for each in chosen.values() for part in each.parts),
        _record_of({name: each.surrogate for name, each in chosen.items() if each.surrogate}),
    )


def law_by_region(recipe: Recipe, mesh: Mesh, law_of: Callable[[Recipe], StressLaw]) -> StressLaw:
    """The law of a recipe's cell, or of its cells, each at the points of its regions."""
    if not recipe.types:
        return law_of(recipe)
    laws = {name: law_of(part) for name, part in recipe.parts().items()}
    return RegionalLaw(laws, recipe.points_of_cells(mesh))


def _record_of(surrogates: Mapping[str, Mapping[str, Any]]) -> dict[str, Any] | None:
    if not surrogates:
        return None
    return {
        "file": ", ".join(each["file"] for each in surrogates.values()),
        "fingerprint": " ".join(each["fingerprint"] for each in surrogates.values()),
        "errors": {name: each["errors"] for name, each in surrogates.items()},
    }


def law_arrays(law: StressLaw, state: Any) -> dict[str, NDArray]:
    """What cached laws must know to go on from the committed `state`; of other laws nothing."""
    if isinstance(law, CachedLaw):
        return law.to_arrays(state)
    if not isinstance(law, RegionalLaw):
        return {}
    arrays: dict[str, NDArray] = {}
    for (name, each), own in zip(law.laws.items(), state, strict=True):
        arrays |= within(name, law_arrays(each, own))
    return arrays


def law_state(law: StressLaw, arrays: Mapping[str, NDArray]) -> Any:
    """The committed state whose `law_arrays` these are; None where a law starts cold."""
    if isinstance(law, CachedLaw):
        return law.from_arrays(arrays)
    if not isinstance(law, RegionalLaw):
        return None
    states = [law_state(each, part_of(arrays, name)) for name, each in law.laws.items()]
    return None if all(state is None for state in states) else tuple(states)


def cache_report(law: StressLaw, *, whole: bool = False) -> dict[str, Any] | None:
    """What a cached law has to report, of several cells under `cells` by name; None of others.

    Args:
        whole: the run is over: audit what waits and say what true RVEs would have cost.
    """
    if isinstance(law, CachedLaw):
        return law.report() if whole else law.history()
    if not isinstance(law, RegionalLaw):
        return None
    found = {name: cache_report(each, whole=whole) for name, each in law.laws.items()}
    return {"cells": found} if all(found.values()) else None

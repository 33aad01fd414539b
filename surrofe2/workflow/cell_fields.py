"""What happens in the plant cells of a run: extremes of all elements at all frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import FileError, InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.recipe.recipe import Recipe, make_recipe
from surrofe2.rve import RveLaw
from surrofe2.store.fields import (
    CELL,
    F_DOT_NAME,
    F_NAME,
    StoredFields,
    add_to_elements,
    read_fields,
)
from surrofe2.store.run_folder import RunRecord, read_record
from surrofe2.store.store import locked_folder
from surrofe2.workflow.laws import true_law

Array = NDArray[np.float64]

_AT_ONCE = 512
"""RVEs whose particles are computed together: 40 MB for one plant cell each."""


def recipes_of(record: RunRecord) -> dict[str, Recipe]:
    """Cell and initialisation of a run as a recipe for each of its cells by name, "" of one.

    Raises:
        InputError: the run was by a law without plant cells.
    """
    stored = record.recipe
    cells: Mapping[str, Any] = stored.get("cells") or {"": stored.get("cell", {})}
    if not all("preset" in cell for cell in cells.values()):
        raise InputError(
            f"law: {record.law}; it has no plant cells to look into, as rve and cached have"
        )
    names = {item.name for item in fields(CellParameters)}
    return {
        name: make_recipe(
            {
                "cell": {key: cell[key] for key in names & cell.keys()},
                "rve": cell.get("rve") or stored["rve"],
            }
        )
        for name, cell in cells.items()
    }


def read_motion(folder: Path) -> StoredFields:
    """The mesh of a run, F and Ḟ of its elements, and their plant cells where there are several.

    Raises:
        FileError: fields.h5 is missing, damaged, or without Ḟ.
    """
    return read_fields(folder, (F_DOT_NAME, F_NAME), (CELL,))


def cell_numbers(motion: StoredFields, recipes: Mapping[str, Recipe]) -> NDArray[np.int64]:
    """(e,) number of the recipe of each element's cell.

    Raises:
        FileError: there are several cells and the fields do not say which is where.
    """
    if len(recipes) == 1:
        return np.zeros(len(motion.cells), np.int64)
    if CELL not in motion.values:
        raise FileError(f"fields.h5: no {CELL} of elements in it; run it again with --fresh")
    return motion.values[CELL][0].astype(np.int64)


def add_cell_fields(folder: Path) -> int:
    """Add `Particles.extremes` of every element and frame to the fields of a run.

    They are of true RVEs with the mean F and Ḟ of the element, NaN where one has no stress.

    Returns:
        How many RVEs were solved.

    Raises:
        FileError: the folder has no run with fields of elements.
    """
    recipes = recipes_of(read_record(folder))
    with locked_folder(folder):
        motion = read_motion(folder)
        F, F_dot = motion.values[F_NAME], motion.values[F_DOT_NAME]
        numbers = cell_numbers(motion, recipes)
        values: dict[str, Array] = {}
        for k, recipe in enumerate(recipes.values()):
            own = numbers == k
            found = extremes_of(true_law(recipe), F[:, own], F_dot[:, own])
            for name, of_cell in found.items():
                values.setdefault(name, np.full(F.shape[:2], np.nan))[:, own] = of_cell
        add_to_elements(folder, values)
    return F.size // 4


def extremes_of(law: RveLaw, F_of: Array, F_dot_of: Array) -> dict[str, Array]:
    """`Particles.extremes` at F, Ḟ (m, e, 2, 2), by name; (m, e), NaN where there is no stress."""
    F, F_dot = F_of.reshape(-1, 2, 2), F_dot_of.reshape(-1, 2, 2)
    found: dict[str, Array] = {}
    for begin in range(0, len(F), _AT_ONCE):
        part = slice(begin, begin + _AT_ONCE)
        answer = law.respond(F[part], F_dot[part])
        good = np.flatnonzero(answer.status == 0)
        if not good.size:
            continue
        seen = law.particles(F[part][good], F_dot[part][good], answer.state.take(good))
        for name, values in seen.extremes().items():
            found.setdefault(name, np.full(len(F), np.nan))[begin + good] = values
    return {name: values.reshape(F_of.shape[:2]) for name, values in found.items()}

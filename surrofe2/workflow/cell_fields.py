"""What happens in the plant cells of a run: extremes of all elements at all frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.io.fields import add_to_elements, read_element_motion
from surrofe2.io.run_folder import RunRecord, read_record
from surrofe2.recipe import Recipe, make_recipe
from surrofe2.rve import RveLaw
from surrofe2.workflow.laws import true_law

Array = NDArray[np.float64]

_AT_ONCE = 512
"""RVEs whose particles are computed together: 40 MB for one plant cell each."""


def recipe_of(record: RunRecord) -> Recipe:
    """Cell and initialisation of a run as a recipe.

    Raises:
        InputError: the run has several cells.
    """
    types = record.recipe.get("cells")
    if types:
        raise InputError(
            f"cells: {', '.join(types)}; a look into the cells needs a run with one [cell]"
        )
    return make_recipe({name: record.recipe[name] for name in ("cell", "rve")})


def add_cell_fields(folder: Path) -> int:
    """Add `Particles.extremes` of every element and frame to the fields of a run.

    They are of true RVEs with the mean F and Ḟ of the element, NaN where one has no stress.

    Returns:
        How many RVEs were solved.

    Raises:
        FileError: the folder has no run with fields of elements.
    """
    motion = read_element_motion(folder)
    values = extremes_of(true_law(recipe_of(read_record(folder))), motion.F, motion.F_dot)
    add_to_elements(folder, values)
    return int(motion.F.size) // 4


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

"""What is wrong with a recipe, all of it where it can be told, before anything is computed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from surrofe2.base.errors import FileError, InputError, MismatchError
from surrofe2.recipe.recipe import Recipe, load_recipe
from surrofe2.store.samples import check_harvest, read_data_set, read_harvest
from surrofe2.store.surrogates import check_surrogate, read_surrogate
from surrofe2.workflow.samples import check_data


def recipe_faults(path: Path) -> list[str]:
    """A sentence on each entry of a recipe that cannot be what it says, all in one go."""
    try:
        load_recipe(path)
    except (FileError, InputError) as error:
        if not error.faults:
            return [str(error)]
        return [f"{path.name}: {fault}" for fault in error.faults]
    return []


def study_faults(recipe: Recipe, laws: Sequence[str], *, fresh: bool = False) -> list[str]:
    """What keeps a study of a recipe, that loads, from its end: mesh, names, range, files.

    Args:
        fresh: data set and surrogate that are there do not count.
    """
    checks: list[Callable[[], Any]] = [recipe.problem, partial(_check_table, recipe, laws)]
    for part in recipe.parts().values():
        if laws != ("rve",):
            checks.append(part.sampling_range)
        if "cached" in laws:
            checks += [part.data_path, part.training_path]
            checks += [partial(_check_harvest, part, path) for path in part.added_paths()]
            checks += [] if fresh else [partial(_check_kept, part)]
    return [sentence for check in checks for sentence in _refusal(check)]


def _check_table(recipe: Recipe, laws: Sequence[str]) -> None:
    if "table" in laws and recipe.rve.solver == "iterated":
        raise InputError('rve.solver: "iterated"; tables need tangents, so "direct"')
    if "table" in laws and recipe.macro.integrator == "implicit":
        raise InputError('macro.integrator: "implicit"; tables have no tangents; take "explicit"')


def _check_harvest(part: Recipe, path: Path) -> None:
    check_harvest(path, read_harvest(path), part.cell, part.rve.initialisation)


def _check_kept(part: Recipe) -> None:
    """Whether data set and surrogate, as far as they are there and whole, are of this recipe."""
    if part.range is None or part.samples.file is None or part.training_file is None:
        return  # told by another check
    data, trained = part.data_path(), part.training_path()
    if data.exists():
        with suppress(InputError):  # it is not finished, and goes on
            check_data(part, read_data_set(data), data)
    if trained.exists():
        found = read_surrogate(trained)
        check_surrogate(trained, found, part.cell, part.rve.initialisation)


def _refusal(check: Callable[[], Any]) -> list[str]:
    try:
        check()
    except (FileError, InputError, MismatchError) as error:
        return [str(error)]
    return []


def refuse_faults(recipe: Recipe, laws: Sequence[str], *, fresh: bool = False) -> None:
    """Refuse a study that could not come to its end.

    Raises:
        InputError: naming the first of what is wrong.
    """
    faults = study_faults(recipe, laws, fresh=fresh)
    if faults:
        more = f"; and {len(faults) - 1} more, see `surrofe2 check`" if faults[1:] else ""
        raise InputError(f"{faults[0]}{more}")

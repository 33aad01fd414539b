"""What is wrong with a recipe, all of it where it can be told, before anything is computed."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from surrofe2.base.errors import FileError, InputError, MismatchError
from surrofe2.recipe.recipe import Recipe, load_recipe, make_recipe
from surrofe2.store.samples import check_harvest, read_data_set, read_harvest
from surrofe2.store.surrogates import check_surrogate, read_surrogate
from surrofe2.workflow.samples import check_data

_MOST_ROUNDS = 50
_ANY_MESH = {"width": 100.0, "height": 100.0, "elements": [4, 4]}
_ANY_CONDITION = {"kind": "fixed", "on": "left"}


def recipe_faults(path: Path) -> list[str]:
    """A sentence on each entry of a recipe that cannot be what it says, all in one go.

    After each the entry is left out, or its section where that cannot do without, and the rest is
    read again; so what such a section says besides may stay no_report.
    """
    try:
        load_recipe(path)
    except (FileError, InputError) as error:
        first = str(error)
    else:
        return []
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return [first]
    told: dict[str, str] = {}
    for _ in range(_MOST_ROUNDS):
        try:
            make_recipe(table, path)
            break
        except (FileError, InputError) as error:
            name = str(error).partition(": ")[0]
            names = name.split(".")
            if name in told:  # it is needed: no more of its section
                names = names[:1]
            told.setdefault(name, f"{path.name}: {error}")
            if not _leave_out(table, names):
                break
    return [*told.values()]


def _leave_out(table: dict[str, Any], names: Sequence[str]) -> bool:
    """Take out the entry that is called so, or the section that lacks it; whether there was one.

    What has a name of its own ([conditions.NAME], [mesh.regions.NAME]) goes as a whole; a mesh or a
    condition becomes another one, since there must be some.
    """
    names = names[: 3 if names[1:2] in (["regions"], ["boundaries"]) else 2]
    while names:
        *above, last = names
        inner: Any = table
        for name in above:
            inner = inner.get(name) if isinstance(inner, dict) else None
        if isinstance(inner, dict) and last in inner:
            was = inner.pop(last)
            if names == ["mesh"] and isinstance(was, dict) and was != _ANY_MESH:
                parts = ("regions", "boundaries")
                inner[last] = _ANY_MESH | {name: was[name] for name in parts if name in was}
            elif above == ["conditions"] and was != _ANY_CONDITION:
                inner[last] = dict(_ANY_CONDITION)
            return True
        names = above
    return False


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

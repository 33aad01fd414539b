"""Choosing and warming up the stress law of a run."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surrofe2.errors import InputError, MismatchError

if TYPE_CHECKING:
    from surrofe2.config import Recipe
    from surrofe2.stress_law import StressLaw

LAWS = ("rve", "surrogate", "cached")


@dataclass(frozen=True, slots=True)
class ChosenLaw:
    """A law, the laws it is made of, and what to record of its surrogate."""

    law: StressLaw
    parts: tuple[StressLaw, ...]
    surrogate: Mapping[str, Any] | None = None


def choose_law(recipe: Recipe, kind: str, surrogate_file: Path | None = None) -> ChosenLaw:
    """The law called `kind` for a recipe; its surrogate from `surrogate_file` or the recipe.

    Raises:
        MismatchError: the surrogate was trained for other cell parameters or initialisation.
    """
    from surrofe2.rve import RveLaw

    if kind == "rve":
        rve = RveLaw.from_settings(recipe.cell, recipe.rve)
        return ChosenLaw(rve, (rve,))
    from surrofe2.cache import CachedLaw
    from surrofe2.io.runs import file_fingerprint
    from surrofe2.surrogate import SurrogateLaw

    path = surrogate_file or recipe.training_path()
    surrogate = SurrogateLaw.load(path)
    record = {"file": path.name, "fingerprint": file_fingerprint(path), "errors": surrogate.errors}
    _check_surrogate(recipe, surrogate, path)
    if kind == "surrogate":
        return ChosenLaw(surrogate, (surrogate,), record)
    rve = RveLaw.from_settings(recipe.cell, recipe.rve)
    return ChosenLaw(CachedLaw(surrogate, fallback=rve), (surrogate, rve), record)


def _check_surrogate(recipe: Recipe, surrogate: Any, path: Path) -> None:
    if surrogate.cell != recipe.cell:
        here, there = recipe.cell.to_dict(), surrogate.cell.to_dict()
        name = next(key for key in here if here[key] != there[key])
        raise MismatchError(
            f"{path}: trained for cell.{name} = {there[name]}, the recipe has {here[name]}; "
            "train a surrogate for this recipe"
        )
    if surrogate.initialisation != recipe.rve.initialisation:
        raise MismatchError(
            f"{path}: trained for initialisation {surrogate.initialisation}, the run has "
            f"{recipe.rve.initialisation}; train a surrogate for this recipe"
        )


def warm_up(laws: tuple[StressLaw, ...]) -> float:
    """Ask each law once, so that compilation is not in the run's clock; seconds it took."""
    import numpy as np

    begin = time.perf_counter()
    F = np.array([[[1.0, 1e-3], [0.0, 1.0]]])
    for law in laws:
        answer = law.respond(F, 0.0 * F)
        law.respond(F, 0.0 * F, law.accept(F, 0.0 * F, answer).state)
    return time.perf_counter() - begin


def use_threads(wanted: int | None) -> int:
    """Limit numba, BLAS and torch to so many threads (None: all cores); the number used."""
    available = os.cpu_count() or 1
    if wanted is None:
        return available
    if wanted > available:
        raise InputError(f"--threads: {wanted}; this machine has {available} cores")
    # Read by the libraries that are not loaded yet; those that are, are told below.
    os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = str(wanted)
    import numba
    from threadpoolctl import threadpool_limits

    numba.set_num_threads(wanted)
    threadpool_limits(wanted)
    return wanted

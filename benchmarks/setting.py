"""What the benchmarks are run on: mode, laws, recipes, deformations."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from surrofe2 import CachedLaw, CellParameters, RveLaw, SurrogateLaw
from surrofe2.base.errors import MismatchError
from surrofe2.cache import CacheSettings
from surrofe2.recipe.recipe import load_recipe
from surrofe2.rve import RveSettings
from surrofe2.rve.unit_cell import UnitCell, make_unit_cell
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.train import train_surrogate

if TYPE_CHECKING:
    from surrofe2.recipe.recipe import Recipe

T = TypeVar("T")
Array = NDArray[np.float64]

ROOT = Path(__file__).parents[1]
PRESETS = ("printed", "water")
RECIPES = {"printed": "bending-bar.toml", "water": "bending-bar-water.toml"}
SPREAD = {"printed": 0.08, "water": 0.04}
"""Largest entry of F − I at which RVEs of a preset must be solved."""
RATE = 0.01
"""Largest entry of Ḟ there, 1/µs."""
POINTS = 80
"""RVEs of the bar of 4 × 4 elements."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A run of the benchmarks.

    Attributes:
        quick: less of everything; limits that are set for the whole bar are not judged.
        out: folder for results and for surrogates, which are kept for the next time.
    """

    quick: bool
    out: Path

    def pick(self, full: T, quick: T) -> T:
        """The value for this mode."""
        return quick if self.quick else full

    def if_full(self, limit: float) -> float | None:
        """A limit that holds for the full workload alone."""
        return None if self.quick else limit

    def recipe(self, preset: str) -> Recipe:
        """The shipped recipe of the bar, its files in `out`; in quick mode with less training."""
        name = RECIPES[preset]
        shipped = load_recipe(ROOT / "data" / name)
        if self.quick:
            shipped = shipped.with_cell(
                samples=replace(shipped.samples, count=2048),
                training=replace(shipped.training, iterations=60, bound=0.0),
            )
        stem = f"{Path(name).stem}{self.pick('', '-quick')}"
        self.out.mkdir(parents=True, exist_ok=True)
        return replace(shipped, path=self.out / name).with_cell(
            samples=replace(shipped.samples, file=f"{stem}.h5"),
            training_file=f"{stem}-surrogate.h5",
        )

    def surrogate(self, preset: str) -> SurrogateLaw:
        """The surrogate of `recipe`, generated and trained unless it is in `out` already."""
        recipe = self.recipe(preset)
        if not recipe.training_path().exists():
            print(f"    training {recipe.training_path().name}, once")
        try:
            generate_data_set(recipe)
            return train_surrogate(recipe).surrogate
        except MismatchError as error:
            print(f"    {error}: made anew")
            generate_data_set(recipe, fresh=True)
            return train_surrogate(recipe, fresh=True).surrogate

    def cached(self, preset: str, tolerance: float = CacheSettings().tolerance) -> CachedLaw:
        """That surrogate with true RVEs to fall back to."""
        return cached(self.surrogate(preset), preset, tolerance)


def cached(surrogate: SurrogateLaw, preset: str, tolerance: float) -> CachedLaw:
    """A surrogate with true RVEs to fall back to; no audits."""
    settings = CacheSettings(tolerance=tolerance, audit=0.0)
    return CachedLaw(surrogate, fallback=rve(preset), settings=settings)


@cache
def rve(preset: str, **settings: Any) -> RveLaw:
    """The RVE law of a preset."""
    return RveLaw(CellParameters.preset(preset), RveSettings(**settings))


def unit_cell(preset: str) -> UnitCell:
    """The RVE of a preset in its reference state."""
    return make_unit_cell(CellParameters.preset(preset))


def deformations(preset: str, points: int, seed: int = 0) -> tuple[Array, Array]:
    """Random F and Ḟ (points, 2, 2), uniform over the range at which RVEs must be solved."""
    rng = np.random.default_rng(seed)
    F = np.eye(2) + SPREAD[preset] * rng.uniform(-1.0, 1.0, (points, 2, 2))
    return F, RATE * rng.uniform(-1.0, 1.0, (points, 2, 2))


def micro_states(preset: str, points: int, seed: int = 0) -> Array:
    """Material positions (tiles, 2, particles, TILE) within 0.1 µm of the reference's."""
    z = rve(preset).rest_state(points).z
    return z + 0.1 * np.random.default_rng(seed).uniform(-1.0, 1.0, z.shape)

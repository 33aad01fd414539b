"""Does the cache accept any state with an error above its tolerance? A search for the worst.

From the worst of `STATES` states of the sampling range a (1 + 1) evolution strategy climbs, once
the error over its bound, once the error over what is allowed, among accepted states only. What a
whole search finds goes into docs/measured.json.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.measured import MEASURED, Bench, merge
from surrofe2.base.sampling import SamplingRange
from surrofe2.base.tensors import stress_error, unrotated
from surrofe2.cache import CacheSettings
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.deformation_paths import (
    DeformationPaths,
    random_walks,
    true_stress,
)
from surrofe2.workflow.generate import generate_data_set
from surrofe2.workflow.train import train_surrogate
from validation.case import Setting

Array = NDArray[np.float64]

STATES, STARTS, GENERATIONS = 100_000, 400, 60
_STEP = 0.3  # first step / distance from rest, in half widths
_GROWTH = 1.5  # of a step that succeeds; one in five does where its length stays
_GOALS = {"over_bound": "error / bound", "over_tolerance": "error / allowed"}


class Judged(NamedTuple):
    """States by U₁₁, U₂₂, U₁₂ and the entries of RᵀḞ in half widths, (n, 7), and their errors.

    over_bound, over_tolerance: (n,) error over its bound, and over what is allowed; −1 where the
    cache does not accept, infinite where the RVE has no stress.
    """

    at: Array
    over_bound: Array
    over_tolerance: Array

    def of(self, chosen: NDArray[np.int64]) -> Judged:
        """These states."""
        return Judged(*(part[chosen] for part in self))


class Search:
    """What a surrogate with the tolerances of a cache accepts, and how wrong it is."""

    def __init__(self, surrogate: SurrogateLaw, law: RveLaw, settings: CacheSettings) -> None:
        self.law, self.range = law, surrogate.range
        self.surrogate = surrogate.with_tolerance(settings.tolerance, settings.relative)
        self.allowed = settings.tolerance * surrogate.stress_spread

    def judge(self, at: Array) -> Judged:
        """Errors at states (n, 7)."""
        F, F_dot = to_state(at, self.range)
        stress, status, risk = self.surrogate.lookup(F, F_dot, 1.0)
        kept = np.flatnonzero(status == 0)
        over_bound, over_tolerance = np.full((2, len(at)), -1.0)
        if len(kept):
            path = DeformationPaths("worst", F[None, kept], F_dot[None, kept], np.arange(len(kept)))
            true, unknown = true_stress(path, self.law)
            error = stress_error(stress[kept], true)
            error /= self.surrogate.local_tolerance(F[kept], F_dot[kept])
            error[unknown != 0] = np.inf
            over_tolerance[kept] = error / self.allowed
            over_bound[kept] = over_tolerance[kept] / risk[kept]
        return Judged(at, over_bound, over_tolerance)

    def climb(self, starts: Judged, goal: str, generations: int, seed: int) -> Judged:
        """The best that each start came to."""
        rng, best = np.random.default_rng(seed), starts
        step = _STEP * np.sqrt((best.at**2).mean(axis=1))
        for _ in range(generations):
            moved = best.at + step[:, None] * rng.standard_normal(best.at.shape)
            new = self.judge(np.clip(moved, -1.0, 1.0))
            better = new._asdict()[goal] > best._asdict()[goal]
            step = step * np.where(better, _GROWTH, _GROWTH**-0.25)
            best = Judged(
                *(
                    np.where(better.reshape(-1, *(1,) * (one.ndim - 1)), one, other)
                    for one, other in zip(new, best, strict=True)
                )
            )
        return best


def to_state(at: Array, range: SamplingRange) -> tuple[Array, Array]:
    """F = U and F_dot (n, 2, 2) of states (n, 7)."""
    middle, half = _box(range)
    stretch = middle + half * at[:, :3]
    F = np.ascontiguousarray(stretch[:, [0, 2, 2, 1]].reshape(-1, 2, 2))
    return F, range.rate * at[:, 3:].reshape(-1, 2, 2)


def from_state(F: Array, F_dot: Array, range: SamplingRange) -> Array:
    """(n, 7), the inverse of `to_state`, F being symmetric."""
    middle, half = _box(range)
    stretch = F.reshape(-1, 4)[:, [0, 3, 1]]
    return np.hstack([(stretch - middle) / half, F_dot.reshape(-1, 4) / range.rate])


def _box(range: SamplingRange) -> tuple[Array, Array]:
    low, high = range.stretch
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    return np.array([middle, middle, 0.0]), np.array([half, half, range.shear])


class Found(NamedTuple):
    """A goal: its largest value among random states and after climbing, and what was climbed to.

    above: states whose error is above what is allowed, random and climbed to.
    """

    goal: str
    random: float
    climbed: float
    above: int
    accepted: float
    """Fraction of the random states that the cache accepts."""
    values: Array


QUANTITIES: tuple[Quantity[Found], ...] = (
    Quantity("measure", "", "", lambda row: _GOALS[row.goal]),
    Quantity("accepted", "%", ".1f", lambda row: 100.0 * row.accepted),
    Quantity("largest of all", "", ".2g", lambda row: row.random),
    Quantity("largest climbed to", "", ".2g", lambda row: row.climbed),
    Quantity("above what is allowed", "", "d", lambda row: row.above),
)


def search(found: Search, states: int, starts: int, generations: int) -> list[Found]:
    """What both goals come to."""
    walks = random_walks(found.range, states, 2, seed=7)
    U, A, _ = unrotated(walks.F[-1], walks.F_dot[-1])
    random = found.judge(from_state(U, A, found.range))
    accepted, rows = float((random.over_bound >= 0.0).mean()), []
    for goal in _GOALS:
        value = random._asdict()[goal]
        best = found.climb(random.of(np.argsort(value)[-starts:]), goal, generations, seed=8)
        climbed = best._asdict()[goal]
        above = (random.over_tolerance > 1.0).sum() + (best.over_tolerance > 1.0).sum()
        rows.append(
            Found(goal, float(value.max()), float(climbed.max()), int(above), accepted, climbed)
        )
    return rows


def worst_answer(setting: Setting) -> Study:
    """The search with the surrogate of the preset's shipped recipe, trained where it is not yet."""
    recipe = setting.recipe()
    generate_data_set(recipe)
    surrogate = train_surrogate(recipe).surrogate
    effort = (2000, 20, 5) if setting.quick else (STATES, STARTS, GENERATIONS)
    rows = search(Search(surrogate, RveLaw(recipe.cell, recipe.rve), CacheSettings()), *effort)
    if not setting.quick:
        publish(setting, rows)
    curves = (
        Curve(_GOALS[row.goal], np.linspace(0.0, 100.0, row.values.size), np.sort(row.values),
              markers=False)
        for row in rows
    )  # fmt: skip
    return Study(
        title="The worst states that a search finds among those that the cache accepts",
        panels=(Panel("states climbed to (%)", "error over bound or allowed", tuple(curves)),),
        table=Table(QUANTITIES, rows),
    )


def publish(setting: Setting, rows: list[Found]) -> None:
    """Record what a whole search found, for docs/trust.md."""
    preset = setting.of.name
    bench = Bench(False, setting.out, f"python -m validation worst-answer --cell {preset}")
    name = f"trust.{preset}.search"
    bench.add(f"{name}.accepted", 100.0 * rows[0].accepted, "%", "states that the cache accepts")
    for row in rows:
        about = f"largest {_GOALS[row.goal]}"
        bench.add(f"{name}.{row.goal}", row.random, "", f"{about} of all states")
        bench.add(f"{name}.{row.goal}_climbed", row.climbed, "", f"{about} that a search finds")
    above = max(row.above for row in rows)
    bench.add(f"{name}.above", above, "", "states above what is allowed", at_most=0.0)
    merge(MEASURED, bench.figures)

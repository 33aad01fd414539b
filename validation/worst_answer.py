"""Does the cache accept any state with an error above its tolerance? A search for the worst.

From the worst of `STATES` states of the sampling range a (1 + 1) evolution strategy climbs the
error over what is allowed, among accepted states only. What a whole search finds goes into
docs/measured.json.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.measured import MEASURED, Bench, merge
from benchmarks.pages import write_figures
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


class Search:
    """What a surrogate with the tolerances of a cache accepts, and how wrong it is."""

    def __init__(self, surrogate: SurrogateLaw, law: RveLaw, settings: CacheSettings) -> None:
        self.law, self.range = law, surrogate.range
        self.surrogate = surrogate.with_tolerance(settings.tolerance, settings.relative)
        self.allowed = settings.tolerance * surrogate.stress_spread

    def judge(self, at: Array) -> Array:
        """Error over what is allowed (n,) at states (n, 7), see `to_state`.

        −1 where the cache does not accept, infinite where the RVE has no stress.
        """
        F, F_dot = to_state(at, self.range)
        stress, status, _ = self.surrogate.lookup(F, F_dot, 1.0)
        kept = np.flatnonzero(status == 0)
        found = np.full(len(at), -1.0)
        if len(kept):
            path = DeformationPaths("worst", F[None, kept], F_dot[None, kept], np.arange(len(kept)))
            truth = true_stress(path, self.law)
            error = stress_error(stress[kept], truth.stress)
            error /= self.allowed * self.surrogate.local_tolerance(F[kept], F_dot[kept])
            error[truth.status != 0] = np.inf
            found[kept] = error
        return found

    def climb(self, at: Array, generations: int, seed: int) -> Array:
        """The largest error over what is allowed that each start (n, 7) came to."""
        rng, best, value = np.random.default_rng(seed), at, self.judge(at)
        step = _STEP * np.sqrt((at**2).mean(axis=1))
        for _ in range(generations):
            moved = np.clip(best + step[:, None] * rng.standard_normal(best.shape), -1.0, 1.0)
            new = self.judge(moved)
            better = new > value
            step = step * np.where(better, _GROWTH, _GROWTH**-0.25)
            best = np.where(better[:, None], moved, best)
            value = np.where(better, new, value)
        return value


def to_state(at: Array, range: SamplingRange) -> tuple[Array, Array]:
    """F = U and F_dot (n, 2, 2) of states (n, 7): U₁₁, U₂₂, U₁₂ and RᵀḞ in half widths."""
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
    """Largest error over what is allowed, of random states and of those climbed to.

    above: states whose error is above what is allowed, random and climbed to. accepted: fraction
    of the random states that the cache accepts. values: what each start climbed to.
    """

    random: float
    climbed: float
    above: int
    accepted: float
    values: Array


QUANTITIES: tuple[Quantity[Found], ...] = (
    Quantity("accepted", "%", ".1f", lambda row: 100.0 * row.accepted),
    Quantity("largest error / allowed, random", "", ".2g", lambda row: row.random),
    Quantity("climbed to", "", ".2g", lambda row: row.climbed),
    Quantity("above what is allowed", "", "d", lambda row: row.above),
)


def search(found: Search, states: int, starts: int, generations: int) -> Found:
    """What climbing from the worst of random states comes to."""
    walks = random_walks(found.range, states, 2, seed=7)
    U, A, _ = unrotated(walks.F[-1], walks.F_dot[-1])
    at = from_state(U, A, found.range)
    random = found.judge(at)
    climbed = found.climb(at[np.argsort(random)[-starts:]], generations, seed=8)
    above = int((random > 1.0).sum() + (climbed > 1.0).sum())
    accepted = float((random >= 0.0).mean())
    return Found(float(random.max()), float(climbed.max()), above, accepted, climbed)


def worst_answer(setting: Setting) -> Study:
    """The search with the surrogate of the preset's shipped recipe, trained where it is not yet."""
    study = setting.study()
    generate_data_set(study)
    surrogate = train_surrogate(study).surrogate
    rve = RveLaw(study.cell.parameters, study.recipe.rve)
    effort = (2000, 20, 5) if setting.quick else (STATES, STARTS, GENERATIONS)
    found = search(Search(surrogate, rve, CacheSettings()), *effort)
    if not setting.quick:
        publish(setting, found)
    share = np.linspace(0.0, 100.0, found.values.size)
    curve = Curve("error / allowed", share, np.sort(found.values), markers=False)
    return Study(
        title="The worst states that a search finds among those that the cache accepts",
        panels=(Panel("states climbed to (%)", "error / allowed error", (curve,)),),
        table=Table(QUANTITIES, (found,)),
    )


def publish(setting: Setting, found: Found) -> None:
    """Record what a whole search found, for docs/trust.md."""
    preset = setting.of.name
    bench = Bench(False, setting.out, f"python -m validation worst-answer --cell {preset}")
    name, about = f"trust.{preset}.search", "largest error / allowed"
    bench.add(f"{name}.accepted", 100.0 * found.accepted, "%", "states that the cache accepts")
    bench.add(f"{name}.over_tolerance", found.random, "", f"{about} of all states")
    climbed = f"{about} that a search finds"
    bench.add(f"{name}.over_tolerance_climbed", found.climbed, "", climbed)
    bench.add(f"{name}.above", found.above, "", "states above what is allowed", at_most=0.0)
    merge(MEASURED, bench.figures)
    write_figures()

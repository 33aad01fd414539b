"""Does the cache accept any state with an error above its tolerance? A search for the worst.

From the worst of `STATES` states of the sampling range a (1 + 1) evolution strategy climbs, once
the error over its bound, once the error over what is allowed, among accepted states only.
`make accept-cache` writes its section of docs/trust.md.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.row import Row
from benchmarks.setting import ROOT, Array, Setting, rve
from benchmarks.trust import PRESETS, SEARCH, TOLERANCE, with_search
from surrofe2.cache import CacheSettings
from surrofe2.io.files import write_text
from surrofe2.rve import RveLaw
from surrofe2.sampling import SamplingRange
from surrofe2.surrogate import SurrogateLaw
from surrofe2.surrogate.deformation_paths import (
    DeformationPaths,
    random_corners,
    random_small_states,
    random_states,
    true_stress,
)
from surrofe2.tensors import stress_error

TITLE = "The worst states that a search finds among those that the cache accepts"
STATES, STARTS, GENERATIONS = 100_000, 400, 60
_KINDS = {random_states: 0.5, random_corners: 0.25, random_small_states: 0.25}
_STEP = 0.3  # first step / distance from rest, in half widths
_GROWTH = 1.5  # of a step that succeeds; one in five does where its length stays


class Judged(NamedTuple):
    """States by U₁₁, U₂₂, U₁₂ and the entries of RᵀḞ in half widths, (n, 7), and their errors.

    over_bound, over_tolerance: (n,) error over its bound, and over what is allowed; −1 where the
    cache does not accept, infinite where the RVE has no stress.
    """

    at: Array
    over_bound: Array
    over_tolerance: Array

    def of(self, chosen: NDArray) -> Judged:
        """These states."""
        return Judged(*(part[chosen] for part in self))


class Search:
    """What a surrogate that is held to the tolerances of a cache accepts, and how wrong it is."""

    def __init__(self, surrogate: SurrogateLaw, law: RveLaw, settings: CacheSettings) -> None:
        self.law, self.range = law, surrogate.range
        self.surrogate = surrogate.held_to(settings.tolerance, settings.relative)
        self.allowed = settings.tolerance * surrogate.stress_spread

    def judge(self, at: Array) -> Judged:
        """Errors at states (n, 7)."""
        F, F_dot = to_state(at, self.range)
        stress, status, bound = self.surrogate.lookup(F, F_dot, self.allowed)
        kept = np.flatnonzero(status == 0)
        over_bound, over_tolerance = np.full((2, len(at)), -1.0)
        if len(kept):
            path = DeformationPaths("climb", F[None, kept], F_dot[None, kept], np.arange(len(kept)))
            true, unknown = true_stress(path, self.law)
            error = stress_error(stress[kept], true)
            error *= self.surrogate.weight(F[kept], F_dot[kept], self.allowed)
            error[unknown != 0] = np.inf
            over_bound[kept], over_tolerance[kept] = error / bound[kept], error / self.allowed
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


def search(
    preset: str, surrogate: SurrogateLaw, states: int, starts: int, generations: int
) -> dict[str, float]:
    """The largest ratios among random states and after climbing, and how many were accepted."""
    found = Search(surrogate, rve(preset), CacheSettings(tolerance=TOLERANCE))
    kinds = [kind(surrogate.range, int(n * states), 7).states for kind, n in _KINDS.items()]
    at = np.concatenate([from_state(*each, surrogate.range) for each in kinds])
    random = found.judge(at)
    told = {"accepted": float((random.over_bound >= 0.0).mean())}
    above = random.over_tolerance > 1.0
    for goal in ("over_bound", "over_tolerance"):
        value = random._asdict()[goal]
        best = found.climb(random.of(np.argsort(value)[-starts:]), goal, generations, seed=8)
        told[f"{goal}_random"] = float(value.max())
        told[f"{goal}_climbed"] = float(best._asdict()[goal].max())
        told[f"{goal}_above"] = int((best.over_tolerance > 1.0).sum())
    return told | {"above": int(above.sum())}


def run(setting: Setting) -> list[Row]:
    """The search for both presets; its section of docs/trust.md."""
    rows, found = [], {}
    effort = setting.pick((STATES, STARTS, GENERATIONS), (2000, 20, 5))
    for preset in setting.pick(PRESETS, PRESETS[:1]):
        told = found[preset] = search(preset, setting.surrogate(preset), *effort)
        above = told["above"] + told["over_bound_above"] + told["over_tolerance_above"]
        rows.append(
            Row(
                name=f"{preset}: largest error that a search finds / what is allowed",
                value=max(told["over_tolerance_climbed"], told["over_tolerance_random"]),
                unit="",
                limit=1.0,
                note=f"{above:g} above; error over bound up to {told['over_bound_climbed']:.3g}",
            )
        )
    if not setting.quick:
        page = ROOT / "docs" / "trust.md"
        write_text(page, with_search(page.read_text(encoding="utf-8"), _section(found)))
    return rows


def _section(found: Mapping[str, Mapping[str, float]]) -> str:
    lines = [
        "| preset | accepted | error / bound: of all | climbed | error / allowed: of all | climbed "
        "| above |",
        "|" + " --- |" * 7,
    ]
    for preset, told in found.items():
        above = told["above"] + told["over_bound_above"] + told["over_tolerance_above"]
        ratios = [
            f"{told[f'{goal}_{stage}']:.2g}"
            for goal in ("over_bound", "over_tolerance")
            for stage in ("random", "climbed")
        ]
        lines.append(
            f"| {preset} | {100.0 * told['accepted']:.1f} % | {' | '.join(ratios)} | {above:g} |"
        )
    return (
        f"{SEARCH}\n\nHalf of {STATES:,} states are random, a quarter in corners, a quarter near "
        "rest. Where the cache accepts one, its answer is compared with a true RVE. From the "
        f"{STARTS} worst an evolution strategy climbs over {GENERATIONS} generations, once the "
        "error over its bound, once the error over what is allowed, among accepted states. "
        "`python -m benchmarks --only climb` does it.\n\n" + "\n".join(lines) + "\n"
    )

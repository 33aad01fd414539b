"""The bulk beside a free side: stretched along x, its normal stress across zero.

The stretch across follows: where all is at rest, P₂₂(λ, λ₂) = 0 gives λ₂ and s = dλ₂/dλ. In motion
λ̇₂ = s λ̇, as the thickness is one more of the positions that follow (docs/theory.md, surface law),
and λ₂ solves P₂₂ = 0 with these rates. With initialisation "elastic" λ₂ stays where it was at rest,
as its particles do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.law.stress_law import Tangents
from surrofe2.rve.rve_law import RveLaw

Array = NDArray[np.float64]

LIMIT = 20
_DONE = 1e-12
"""Newton's method stops at so small a step of λ₂."""
_DIFFERENCE = 1e-4
"""Of λ, by which s is differenced."""


@dataclass(frozen=True, slots=True)
class Follow:
    """How F₂₂ and Ḟ₂₂ follow the stretch λ and its rate, (n,) each."""

    F_by_stretch: Array
    F_by_rate: Array
    rate_by_stretch: Array
    rate_by_rate: Array

    def slopes(self, tangents: Tangents, a: int, b: int) -> tuple[Array, Array]:
        """(∂P_ab/∂λ, ∂P_ab/∂λ̇), (n,) each, where F and Ḟ follow."""
        by_F, by_rate = tangents.P_by_F[:, a, b], tangents.P_by_F_dot[:, a, b]
        by_stretch = by_F[:, 0, 0] + by_F[:, 1, 1] * self.F_by_stretch
        by_stretch += by_rate[:, 1, 1] * self.rate_by_stretch
        along = by_rate[:, 0, 0] + by_F[:, 1, 1] * self.F_by_rate
        return by_stretch, along + by_rate[:, 1, 1] * self.rate_by_rate


@dataclass(frozen=True, slots=True)
class SideFree:
    """The bulk at n points.

    Attributes:
        F, F_dot: (n, 2, 2) diagonal.
        P: (n,) P₁₁, µN/µm. by_stretch, by_rate: (n,) its slopes as the side follows.
        valid: (n,) whether there is such a state.
        follow: how the stretch across follows.
    """

    F: Array
    F_dot: Array
    P: Array
    by_stretch: Array
    by_rate: Array
    valid: NDArray[np.bool_]
    follow: Follow


def side_free(law: RveLaw, stretch: Array, rate: Array) -> SideFree:
    """The bulk at stretches λ and rates λ̇ (n,) along x with P₂₂ = 0."""
    n = len(stretch)
    lower, upper = stretch - _DIFFERENCE, stretch + _DIFFERENCE
    along = np.concatenate([stretch, lower, upper])
    across, s = _at_rest(law, along)
    across, (s, before, after) = across[:n], s.reshape(3, n)
    bend = (after - before) / (upper - lower)
    across_rate, zero = s * rate, np.zeros(n)
    if law.initialisation == "elastic":
        follow = Follow(s, zero, bend * rate, s)
    else:
        across = _solve_across(law, stretch, across, rate, across_rate)
        only_rates = Follow(zero, zero, bend * rate, s)
        found = _respond(law, stretch, across, rate, across_rate)
        by_stretch, by_rate = only_rates.slopes(found[1], 1, 1)
        stiffness = found[1].P_by_F[:, 1, 1, 1, 1]
        follow = Follow(-by_stretch / stiffness, -by_rate / stiffness, bend * rate, s)
    P, tangents, valid = _respond(law, stretch, across, rate, across_rate)
    slopes = follow.slopes(tangents, 0, 0)
    return SideFree(
        diagonal(stretch, across),
        diagonal(rate, across_rate),
        P[:, 0],
        *slopes,
        valid & np.isfinite(across),
        follow,
    )


def diagonal(first: Array, second: Array) -> Array:
    """(n, 2, 2) with these (n,) on the diagonal."""
    tensors = np.zeros((len(first), 2, 2))
    tensors[:, 0, 0], tensors[:, 1, 1] = first, second
    return tensors


def _at_rest(law: RveLaw, along: Array) -> tuple[Array, Array]:
    """λ₂ and s = dλ₂/dλ, (n,) each."""
    still = np.zeros_like(along)
    across = _solve_across(law, along, np.ones_like(along), still, still)
    slope = _respond(law, along, across, still, still)[1].P_by_F[:, 1, 1]
    return across, -slope[:, 0, 0] / slope[:, 1, 1]


def _solve_across(
    law: RveLaw, along: Array, across: Array, rate: Array, across_rate: Array
) -> Array:
    """λ₂ (n,) at which P₂₂ = 0, by Newton's method from `across`; NaN where it is not found."""
    across = across.copy()
    for _ in range(LIMIT):
        P, tangents, valid = _respond(law, along, across, rate, across_rate)
        step = np.where(valid, P[:, 1] / tangents.P_by_F[:, 1, 1, 1, 1], 0.0)
        across -= step
        if np.abs(step).max(initial=0.0) < _DONE:
            return np.where(valid, across, np.nan)
    return np.where(np.abs(step) < np.sqrt(_DONE), across, np.nan)


def _respond(
    law: RveLaw, along: Array, across: Array, rate: Array, across_rate: Array
) -> tuple[Array, Tangents, NDArray[np.bool_]]:
    """P₁₁ and P₂₂ (n, 2), tangents, and where they are valid; λ₂ may be NaN."""
    known = np.isfinite(across) & (along > 0.0) & (across > 0.0)
    F = diagonal(np.where(known, along, 1.0), np.where(known, across, 1.0))
    F_dot = diagonal(rate, np.where(known, across_rate, 0.0))
    answer = law.respond(F, F_dot, tangents=True)
    stress = answer.stress
    P = np.stack([stress[:, 0, 0] * F[:, 1, 1], stress[:, 1, 1] * F[:, 0, 0]], axis=1)
    tangents = answer.tangents
    assert tangents is not None
    return P, tangents, known & (answer.status == 0)

"""Signs that a surrogate is broken which no audit sees: silence, one answer, a dead bound."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.stress_law import Status
from surrofe2.tensors import transpose

Array = NDArray[np.float64]

SILENT_STEPS, SILENT_POINTS = 20, 1000
"""Accepted steps and points from the start of a run, at rest, that should have had a hit. Later
silence may be honest: the tissue left the range, or what the tolerance allows."""
PATIENCE_WITH_LEARNERS = 40
"""As many times longer is waited for a surrogate that begins empty and learns."""
EVERY = 5
"""Steps between looks at the answers."""
LOOKS = 3
"""Looks in a row that must find the same fault."""
_DISTINCT = 1e-3
"""Spread of FᵀF from which points are different questions."""

_REASONS = {
    Status.OUT_OF_RANGE: "out of range",
    Status.NOT_FINITE: "not finite",
    Status.NOT_TRUSTED: "not trusted",
}


class CollapseWatch:
    """Looks at accepted answers; each `look` returns a sentence once something is wrong."""

    def __init__(self, *, learns: bool) -> None:
        self._patience = PATIENCE_WITH_LEARNERS if learns else 1
        self._steps = self._silent_steps = self._silent_points = 0
        self._one_answer = self._dead_bound = 0
        self._bound: float | None = None
        self._has_hit = False

    def look(
        self,
        F: Array,
        stress: Array,
        bound: Array,
        hits: NDArray[np.intp],
        why: NDArray[np.int8],
        tolerance: float,
    ) -> str | None:
        """Take note of an accepted step.

        Args:
            F, stress: (n, 2, 2) of all points. bound: (n,), used at hits alone.
            hits: (k,) points the surrogate answered; why: (n − k,) why it did not, elsewhere.
            tolerance: that bounds were compared with, µN/µm.
        """
        self._steps += 1
        if not len(hits):
            return None if self._has_hit else self._silence(why)
        self._has_hit = True
        if self._steps % EVERY or not _differ(F[hits]):
            return None
        self._one_answer = self._one_answer + 1 if _is_one_answer(stress[hits]) else 0
        if self._one_answer >= LOOKS:
            return f"the surrogate gave one answer at {len(hits)} different deformations"
        moved = self._bound_moved(bound[hits], tolerance)
        self._dead_bound = 0 if moved else self._dead_bound + 1
        if self._dead_bound >= LOOKS:
            return f"the surrogate's bound stands still at {self._bound:.3g} µN/µm"
        return None

    def _silence(self, why: NDArray[np.int8]) -> str | None:
        self._silent_steps += 1
        self._silent_points += len(why)
        if (
            self._silent_steps < SILENT_STEPS * self._patience
            or self._silent_points < SILENT_POINTS * self._patience
        ):
            return None
        codes, counts = np.unique(why, return_counts=True)
        most = Status(int(codes[counts.argmax()]))
        return (
            f"no hit in {self._silent_steps} steps ({self._silent_points} points, most of them "
            f"{_REASONS.get(most, most.name)})"
        )

    def _bound_moved(self, bound: Array, tolerance: float) -> bool:
        """A bound that is the tolerance itself is no estimate of this point, and may stand."""
        before, self._bound = self._bound, float(bound[0])
        if not np.isfinite(self._bound) or self._bound in (0.0, tolerance):
            return True
        same = bool((bound == bound[0]).all())
        return not same or (before is not None and before != self._bound)


def _differ(F: Array) -> bool:
    return bool(np.ptp(transpose(F) @ F, axis=0).max() > _DISTINCT)


def _is_one_answer(stress: Array) -> bool:
    """Whether trace and norm are the same everywhere: rotations of one stress are one answer."""
    norm = np.sqrt((stress**2).sum(axis=(1, 2)))
    spread = np.ptp(norm) + np.ptp(stress[:, 0, 0] + stress[:, 1, 1])
    return bool(spread <= 1e-9 * norm.max())

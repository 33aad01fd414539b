"""`CachedLaw`: the surrogate where it answers, the true law elsewhere, point by point, counted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.parts import Fallback, Surrogate
from surrofe2.errors import MismatchError
from surrofe2.stress_law import Acceptance, Status, StressResponse, check_deformation

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

_REASONS = {Status.OUT_OF_RANGE: "out_of_range", Status.NOT_FINITE: "not_finite"}
_NONE: Indices = np.empty(0, dtype=np.intp)
_NONE.flags.writeable = False


@dataclass(frozen=True, slots=True)
class CachedState:
    """The points that the fallback has just answered, rising, and its warm start for them."""

    points: Indices
    fallback: Any


class CachedLaw:
    """σ(F, Ḟ) from `surrogate` where it has a finite answer in range, else from `fallback`.

    `respond` is pure but for `counts`. The state holds a warm start for the points that the
    fallback answered last; a point that leaves the surrogate's range anew is solved cold.

    Args:
        surrogate: e.g. `surrofe2.surrogate.SurrogateLaw`.
        fallback: the law the surrogate was trained on, e.g. `surrofe2.rve.RveLaw`.

    Raises:
        MismatchError: they are not of the same plant cell and initialisation.
    """

    def __init__(self, surrogate: Surrogate, fallback: Fallback) -> None:
        _check_match(surrogate, fallback)
        self.surrogate = surrogate
        self.fallback = fallback
        self.reset_counts()

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.fallback.density

    @property
    def counts(self) -> dict[str, int]:
        """Points answered since the last reset: `hits`, `fallbacks` and, of these, by reason."""
        return dict(self._counts)

    def reset_counts(self) -> None:
        """Count from zero."""
        self._counts = dict(_NO_EFFORT)

    def respond(self, F: Array, F_dot: Array, state: CachedState | None = None) -> StressResponse:
        """Stress at n points; a point that neither part can answer has the fallback's status."""
        if not (_is_ready(F) and _is_ready(F_dot) and F.shape == F_dot.shape):
            F, F_dot = check_deformation(F, F_dot)
        stress, status, _ = self.surrogate.lookup(F, F_dot)
        missed = status.nonzero()[0]
        if not len(missed):
            effort = {**_NO_EFFORT, "hits": len(status)}
            self._count(effort)
            return StressResponse(stress, status, _NO_STATE, effort)
        check_deformation(F, F_dot)  # hits are in range, hence finite and det F > 0
        effort = _effort(status)
        self._count(effort)
        answer = self._ask_fallback(F, F_dot, missed, state or _NO_STATE)
        stress[missed], status[missed] = answer.stress, answer.status
        return StressResponse(
            stress, status, CachedState(missed, answer.state), _added(effort, answer.effort)
        )

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """Let the fallback check and commit the points it answered."""
        state: CachedState = response.state
        points = state.points
        if not len(points):
            return Acceptance(response.status, state)
        answer = StressResponse(response.stress[points], response.status[points], state.fallback)
        accepted = self.fallback.accept(F[points], F_dot[points], answer)
        status = response.status.copy()
        status[points] = accepted.status
        return Acceptance(status, CachedState(points, accepted.state))

    def _ask_fallback(
        self, F: Array, F_dot: Array, points: Indices, state: CachedState
    ) -> StressResponse:
        """The fallback's answer at some points: warm where it knows them, cold elsewhere."""
        if state.fallback is None:
            return self.fallback.respond(F[points], F_dot[points], None)
        _, known, places = np.intersect1d(
            points, state.points, assume_unique=True, return_indices=True
        )
        new = np.setdiff1d(np.arange(len(points)), known, assume_unique=True)
        if not len(known):
            return self.fallback.respond(F[points], F_dot[points], None)
        at, start = points[known], state.fallback.take(places)
        warm = self.fallback.respond(F[at], F_dot[at], start)
        if not len(new):
            return warm
        cold = self.fallback.respond(F[points[new]], F_dot[points[new]], None)
        return _joined((known, warm), (new, cold))

    def _count(self, effort: Mapping[str, int]) -> None:
        counts = self._counts
        for name in counts:
            counts[name] += effort[name]


_NO_STATE = CachedState(_NONE, None)


def _joined(
    known: tuple[Indices, StressResponse], new: tuple[Indices, StressResponse]
) -> StressResponse:
    """One answer from the answers at two parts of the points, the first of which has a state."""
    (first, warm), (second, cold) = known, new
    count = len(first) + len(second)
    stress, status = np.empty((count, 2, 2)), np.empty(count, dtype=np.int8)
    for chosen, answer in (known, new):
        stress[chosen], status[chosen] = answer.stress, answer.status
    places = np.zeros(count, dtype=np.intp)  # at the new points any will do, to be put over
    places[first] = np.arange(len(first))
    state = warm.state.take(places).put(second, cold.state)
    return StressResponse(stress, status, state, _added(warm.effort, cold.effort))


def _check_match(surrogate: Surrogate, fallback: Fallback) -> None:
    here, there = surrogate.cell.fingerprint, fallback.cell.fingerprint
    if here != there:
        raise MismatchError(
            f"cache: the surrogate is of cell parameters {here}, the fallback of {there}; "
            "train a surrogate for these parameters"
        )
    if surrogate.initialisation != fallback.initialisation:
        raise MismatchError(
            f"cache: the surrogate is of initialisation {surrogate.initialisation}, the fallback "
            f"of {fallback.initialisation}; train a surrogate for this initialisation"
        )


def _effort(status: NDArray[np.int8]) -> dict[str, int]:
    """How many points were hit and missed, by the surrogate's status."""
    missed = {
        f"fallbacks_{reason}": int(np.count_nonzero(status == code))
        for code, reason in _REASONS.items()
    }
    fallbacks = int(np.count_nonzero(status))
    return {"hits": len(status) - fallbacks, "fallbacks": fallbacks, **missed}


_NO_EFFORT = _effort(np.empty(0, dtype=np.int8))


def _is_ready(tensors: Any) -> bool:
    """Whether `lookup` can read the array as it is."""
    return (
        isinstance(tensors, np.ndarray)
        and tensors.dtype == np.float64
        and tensors.shape[1:] == (2, 2)
        and tensors.flags.c_contiguous
    )


def _added(effort: Mapping[str, int], more: Mapping[str, int]) -> dict[str, int]:
    total = dict(effort)
    for name, value in more.items():
        total[name] = total.get(name, 0) + value
    return total

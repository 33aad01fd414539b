"""Names by which the cache counts its answers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.stress_law import Status

_REASONS = {
    Status.OUT_OF_RANGE: "out_of_range",
    Status.NOT_FINITE: "not_finite",
    Status.NOT_TRUSTED: "not_trusted",
}


def effort_of(count: int, why: NDArray[np.int8]) -> dict[str, int]:
    """Of `count` points, hits and fallbacks, the latter also by the surrogate's reason (k,)."""
    counts = np.bincount(why, minlength=len(Status)).tolist()
    by_reason = {f"fallbacks_{name}": counts[code] for code, name in _REASONS.items()}
    return {"hits": count - len(why), "fallbacks": len(why), **by_reason}


NO_EFFORT = effort_of(0, np.empty(0, dtype=np.int8))

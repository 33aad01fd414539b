"""How wrong the cache was: the distribution of audited errors in constant memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BINS_A_DECADE = 50
"""A quantile is the upper edge of its bin: at most 4.7 % too large, never too small."""
_LOWEST, _HIGHEST = -12, 6
_EDGES = 10.0 ** np.linspace(_LOWEST, _HIGHEST, (_HIGHEST - _LOWEST) * BINS_A_DECADE + 1)
QUANTILES = (0.5, 0.9, 0.99, 0.999)


@dataclass
class ErrorRecord:
    """Audited answers of a cache and the error each had, µN/µm.

    Attributes:
        tolerance: allowed error, µN/µm; inf: none is.
        audited: answers that were audited.
        unsolved: of these, those for which the true law has no stress.
        violations: errors above the tolerance, and the unsolved.
        bins: (b,) errors by size, in logarithmic bins.
        worst: the largest error with what was asked and answered.
    """

    tolerance: float
    audited: int = 0
    unsolved: int = 0
    violations: int = 0
    largest: float = 0.0
    sum_of_squares: float = 0.0
    bins: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(len(_EDGES) + 1, dtype=np.int64)
    )
    worst: Mapping[str, Any] | None = None

    def add(self, error: Array) -> NDArray[np.bool_]:
        """Record errors (k,), NaN where there is no truth; which of them are violations."""
        broken: NDArray[np.bool_] = ~(error <= self.tolerance)
        known = error[~np.isnan(error)]
        self.audited += len(error)
        self.unsolved += len(error) - len(known)
        self.violations += int(broken.sum())
        self.sum_of_squares += float(known @ known)
        np.add.at(self.bins, np.searchsorted(_EDGES, known, side="left"), 1)
        return broken

    def quantile(self, share: float) -> float:
        """The error that a share of the solved audits does not exceed, µN/µm; NaN without any."""
        solved = int(self.bins.sum())
        if not solved:
            return float("nan")
        place = int(np.searchsorted(np.cumsum(self.bins), share * solved - 1e-9, side="left"))
        edge = _EDGES[place] if place < len(_EDGES) else np.inf
        return float(min(edge, self.largest))

    def to_dict(self) -> dict[str, Any]:
        """Plain values for run.json; µN/µm."""
        solved = self.audited - self.unsolved
        filled = self.bins.nonzero()[0]
        return {
            "audited": self.audited,
            "unsolved": self.unsolved,
            "violations": self.violations,
            "tolerance": self.tolerance,
            "rms": float(np.sqrt(self.sum_of_squares / solved)) if solved else None,
            "largest": self.largest if solved else None,
            "quantiles": {f"{share:g}": self.quantile(share) for share in QUANTILES}
            if solved
            else {},
            "histogram": {
                "bins_a_decade": BINS_A_DECADE,
                "smallest_edge": float(_EDGES[0]),
                "bins": filled.tolist(),
                "counts": self.bins[filled].tolist(),
            },
            "worst": self.worst,
        }

    def restore(self, stored: Mapping[str, Any]) -> None:
        """Go on from what `to_dict` gave."""
        solved = stored["audited"] - stored["unsolved"]
        self.audited, self.unsolved = stored["audited"], stored["unsolved"]
        self.violations, self.worst = stored["violations"], stored["worst"]
        self.largest = stored["largest"] or 0.0
        self.sum_of_squares = solved * (stored["rms"] or 0.0) ** 2
        histogram = stored["histogram"]
        self.bins[:] = 0
        self.bins[np.array(histogram["bins"], dtype=np.intp)] = histogram["counts"]


def bin_edges(histogram: Mapping[str, Any]) -> Array:
    """(k, 2) lower and upper edge of each filled bin of a stored histogram, µN/µm."""
    first, per_decade = histogram["smallest_edge"], histogram["bins_a_decade"]
    upper = first * 10.0 ** (np.array(histogram["bins"], dtype=np.float64) / per_decade)
    return np.stack([upper * 10.0 ** (-1.0 / per_decade), upper], axis=1)

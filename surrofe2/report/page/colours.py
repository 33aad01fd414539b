"""Colours of numbers and of stress sources, for Python and the script alike."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.stress_law import SURROGATE, TABLE, Status

STOPS = (
    "#440154", "#482878", "#3e4989", "#31688e", "#26828e", "#1f9e89", "#35b779", "#6ece58",
    "#b5de2b", "#fde725",
)  # fmt: skip
"""Viridis, evenly from lowest to highest."""
LEVELS, UNKNOWN = 254, 255
"""Numbers are stored as 0 … LEVELS; UNKNOWN is none."""
SOURCES: dict[int, tuple[str, str]] = {
    SURROGATE: ("network", "#3b82c4"),
    TABLE: ("table", "#3aa37f"),
    Status.OUT_OF_RANGE: ("RVE: out of the domain", "#d9822b"),
    Status.NOT_FINITE: ("RVE: not finite", "#8c5bb0"),
    Status.NOT_TRUSTED: ("RVE: risk above the limit", "#c2413b"),
}
"""By the codes of `stress_law.Sources`: what people read, and the colour."""


def levels_of(values: NDArray[np.float64]) -> tuple[NDArray[np.uint8], float, float]:
    """Values as stored numbers, with the lowest and highest value; NaN is unknown."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    width = high - low or 1.0
    share = np.clip((np.nan_to_num(values, nan=low) - low) / width, 0.0, 1.0)
    stored = np.rint(LEVELS * share).astype(np.uint8)
    stored[~np.isfinite(values)] = UNKNOWN
    return stored, low, high

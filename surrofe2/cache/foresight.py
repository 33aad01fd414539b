"""Where points will be at the end of the next step, from where they were at the last two ends."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def look_ahead(F: Array, F_dot: Array, before: tuple[Array, Array] | None) -> tuple[Array, Array]:
    """(F, Ḟ) a step of the last length h on, by the cubics through F and Ḟ at its two ends.

        F₊ = F − 5 ΔF + h (4 Ḟ + 2 Ḟ₋),    Ḟ₊ = 8 Ḟ + 5 Ḟ₋ − 12 ΔF/h

    A law is not told h; here it is that by which the mean of the two rates comes closest to
    ΔF = F − F₋, over all points. Without rates, as in a quasi-static run, F goes straight on;
    without a step before all is as it is now.
    """
    if before is None or before[0].shape != F.shape:
        return F, F_dot
    moved, rates = F - before[0], F_dot + before[1]
    speed = np.vdot(rates, rates)
    length = 2.0 * np.vdot(moved, rates) / speed if speed > 0.0 else 0.0
    if not length > 0.0:
        return F + moved, F_dot
    return (
        F - 5.0 * moved + length * (4.0 * F_dot + 2.0 * before[1]),
        8.0 * F_dot + 5.0 * before[1] - (12.0 / length) * moved,
    )

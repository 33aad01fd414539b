"""How wrong a stress is: one measure for training, bounds, audits and tables.

The error of a Cauchy stress is the Frobenius norm of its difference from the true one, µN/µm. It
does not change when both are rotated. Tolerances are shares of the spread of the stress.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def stress_error(stress: Array, true: Array) -> Array:
    """(n,) Frobenius norm of stress − true, (n, 2, 2) each, µN/µm; NaN where either is."""
    difference: Array = np.sqrt(((stress - true) ** 2).sum(axis=(1, 2)))
    return difference


def stress_spread(stress: Array) -> float:
    """Root mean square of the Frobenius norm of σ − mean σ, σ (n, 2, 2), n ≥ 1, µN/µm."""
    return float(np.sqrt(((stress - stress.mean(axis=0)) ** 2).sum(axis=(1, 2)).mean()))

"""How far answers are from samples, by component of the stress."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.square_symmetry import COMPONENTS
from surrofe2.stress_samples import StressSamples
from surrofe2.tensors import rotation, to_components, transpose

Array = NDArray[np.float64]

_ROUNDING = 1e-12  # of the largest spread: less is no spread


def errors_of(answer: Array, samples: StressSamples) -> dict[str, Any]:
    """Errors of answers (n, 2, 2) at samples, by component of S and of σ.

    Returns:
        `points`, and by component `spread` (standard deviation over the samples, µN/µm), `rms`
        and `worst` (relative to the spread).
    """
    R = rotation(samples.F)
    exact, found = (_all_components(stress, R) for stress in (samples.stress, answer))
    spread = exact.std(axis=0)
    largest = max(spread.max(), np.finfo(float).tiny)
    scale = np.where(spread > _ROUNDING * largest, spread, largest)
    error = np.abs(found - exact) / scale
    names = (*COMPONENTS, "xx", "xy", "yx", "yy")
    figures = {
        "spread": spread,
        "rms": np.sqrt((error**2).mean(axis=0)),
        "worst": error.max(axis=0),
    }
    named = {
        key: {name: float(value) for name, value in zip(names, values, strict=True)}
        for key, values in figures.items()
    }
    return {"points": len(R), **named}


def _all_components(stress: Array, R: Array) -> Array:
    rotated = to_components(transpose(R) @ stress @ R)
    return np.concatenate([rotated, stress.reshape(-1, 4)], axis=1)

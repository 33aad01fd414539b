"""Deformations over time that studies drive RVEs by: t in µs to (F, Ḟ)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Path = Callable[[float], tuple[Array, Array]]

SHEAR_RATE = 0.01
"""Ḟ_xy of eq. (74), 1/µs."""


def steady_shear(rate: float = SHEAR_RATE, start: float = 0.0) -> Path:
    """F of eq. (73) with F_xy = start + rate t, and Ḟ of eq. (74)."""
    F_dot = np.array([[0.0, rate], [0.0, 0.0]])
    return lambda t: (np.array([[1.0, start + rate * t], [0.0, 1.0]]), F_dot)


def oscillation(slowness: float = 1.0) -> Path:
    """F₁₁ = 1 + 0.04 sin ωt, F₁₂ = 0.05 sin ωt with ω = 2π/40 µs, slowed by a factor."""
    omega = 2.0 * np.pi / (40.0 * slowness)
    way = np.array([[0.04, 0.05], [0.0, 0.0]])
    return lambda t: (np.eye(2) + np.sin(omega * t) * way, omega * np.cos(omega * t) * way)


def along(path: Path, times: Array) -> tuple[Array, Array]:
    """F and Ḟ at many times, (m, 2, 2) each."""
    F, F_dot = zip(*(path(float(t)) for t in times), strict=True)
    return np.array(F), np.array(F_dot)

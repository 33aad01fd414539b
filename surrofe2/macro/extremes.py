"""What deformation and rate a run met: lowest and highest entries over all points and steps."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel

Array = NDArray[np.float64]

NO_EXTREMES = np.broadcast_to([[[[np.inf]]], [[[-np.inf]]]], (2, 4, 2, 2))
"""Of no point yet."""


@dataclass(frozen=True, slots=True)
class MetRange:
    """Lowest and highest entries that any point met at the end of any step, (2, 2, 2) each.

    With F = R U: a sampling range over (U, RᵀḞ) that holds these holds the run.
    """

    F: Array
    F_dot: Array
    U: Array
    RT_F_dot: Array

    @classmethod
    def of(cls, extremes: Array) -> MetRange:
        """From lowest and highest entries as `widen_extremes` has them."""
        return cls(*extremes.swapaxes(0, 1))

    def to_dict(self) -> dict[str, Any]:
        """The extremes, and `stretch`, `shear`, `rate` of the sampling range that holds them."""
        bounds = {"stretch": self.stretch, "shear": self.shear, "rate": self.rate}
        return asdict(self) | bounds

    @property
    def stretch(self) -> tuple[float, float]:
        """Lowest and highest of U₁₁ and U₂₂."""
        low, high = self.U
        return float(low.diagonal().min()), float(high.diagonal().max())

    @property
    def shear(self) -> float:
        """Largest |U₁₂|."""
        low, high = self.U
        return float(max(-low[0, 1], high[0, 1]))

    @property
    def rate(self) -> float:
        """Largest entry of |RᵀḞ|, 1/µs."""
        low, high = self.RT_F_dot
        return float(max(high.max(), -low.min()))


@kernel
def widen_extremes(extremes: Any, F: Any, F_dot: Any) -> None:
    """Widen (2, 4, 2, 2) lowest and highest values by F, Ḟ, U = RᵀF and RᵀḞ of all points.

    R is the rotation of the polar decomposition, cos θ : sin θ = F₁₁ + F₂₂ : F₂₁ − F₁₂.
    """
    values = np.empty((4, 2, 2))
    for p in range(F.shape[0]):
        c, s = F[p, 0, 0] + F[p, 1, 1], F[p, 1, 0] - F[p, 0, 1]
        norm = np.sqrt(c * c + s * s)
        c, s = c / norm, s / norm
        for j in range(2):
            for i in range(2):
                values[0, i, j] = F[p, i, j]
                values[1, i, j] = F_dot[p, i, j]
            for k in range(2):
                values[2 + k, 0, j] = c * values[k, 0, j] + s * values[k, 1, j]
                values[2 + k, 1, j] = c * values[k, 1, j] - s * values[k, 0, j]
        for k in range(4):
            for i in range(2):
                for j in range(2):
                    extremes[0, k, i, j] = min(extremes[0, k, i, j], values[k, i, j])
                    extremes[1, k, i, j] = max(extremes[1, k, i, j], values[k, i, j])

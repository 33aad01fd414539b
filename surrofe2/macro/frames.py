"""What is kept of whole fields: extremes over a run, and frames at a few times."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.law.stress_law import Sources
from surrofe2.macro.discretisation import Discretisation
from surrofe2.macro.internal_force import (
    deformation_gradient,
    element_mean_F,
    element_mean_stress,
)

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


NOTHING: Array = np.empty(0)
POINTS_EVERY = 10
"""Points of the law are kept at each frame whose number this divides, and at the last."""


@dataclass(frozen=True, slots=True)
class Frames:
    """Whole fields at k times, each the end of the first step that passed an even fraction of the
    duration: there the stress is the one the run went on with, and nothing is interpolated.

    Attributes:
        t: (k,) µs, increasing, from 0 to the end.
        displacement, velocity: (k, n_nodes, 2) µm and µm/µs.
        stress: (k, n_el, 2, 2) element mean of the Cauchy stress, µN/µm.
        F, F_dot: (k, n_el, 2, 2) element mean of the deformation gradient, and of its rate, 1/µs.
        source, risk: (k, n_el) of `Sources`, the largest of the element's points; (k, 0) of a law
            that does not tell.
        dissipated: (k, n_el) energy by reference area since t = 0, pJ/µm²; (k, 0) if not recorded.
            The rate is linear between the samples of `MacroState`, and constant after the last.
        point_t: (p,) µs, those of t at which the law's points are kept too: a tenth of them.
        point_stress: (p, n_points, 2, 2) Cauchy stress as the law answered, µN/µm.
        point_source, point_risk: (p, n_points) of `Sources`; (p, 0) of a law that does not tell.
    """

    t: Array
    displacement: Array
    velocity: Array
    stress: Array
    F: Array
    F_dot: Array
    source: Array
    risk: Array
    dissipated: Array
    point_t: Array
    point_stress: Array
    point_source: Array
    point_risk: Array

    @classmethod
    def of(
        cls,
        space: Discretisation,
        t: float,
        motion: tuple[Array, Array],
        F: Array,
        stress: Array,
        sources: Sources | None = None,
        dissipated: Array = NOTHING,
        *,
        points: bool = True,
    ) -> Frames:
        """Those of one time, from displacement and velocity (n, 2) of nodes and bodies, from
        values at the points, which are kept if `points` says so, and from `dissipated` (n_el,).
        """
        u, v = motion
        n = len(space.nodes)
        _, F_dot, _ = deformation_gradient(space, u, v)
        return cls(
            t=np.array([t]),
            displacement=u[None, :n],
            velocity=v[None, :n],
            stress=element_mean_stress(space, F, stress)[None],
            F=element_mean_F(space, F)[None],
            F_dot=element_mean_F(space, F_dot)[None],
            source=_largest(space, None if sources is None else sources.source),
            risk=_largest(space, None if sources is None else sources.risk),
            dissipated=dissipated[None],
            point_t=np.full(int(points), t),
            point_stress=np.repeat(stress[None], int(points), axis=0),
            point_source=_of_points(None if sources is None else sources.source, points),
            point_risk=_of_points(None if sources is None else sources.risk, points),
        )


def _of_points(values: NDArray | None, kept: bool) -> Array:
    """(1 or 0 as they are kept, n_points) values; (…, 0) of None."""
    told = NOTHING if values is None else values.astype(np.float64)
    return np.repeat(told[None], int(kept), axis=0)


def _largest(space: Discretisation, values: NDArray | None) -> Array:
    """(1, n_el) largest of values (n_points,) in each element; (1, 0) of None."""
    if values is None:
        return np.empty((1, 0))
    whole: Array = values.reshape(len(space.elements), -1).max(axis=1).astype(np.float64)[None]
    return whole

"""Displacement of the watched point over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError


@dataclass(frozen=True, slots=True)
class DisplacementCurve:
    """A displacement over time.

    Attributes:
        t: (m,) µs, increasing.
        displacement: (m, 2) µm.
    """

    t: Array
    displacement: Array

    def __post_init__(self) -> None:
        if self.t.ndim != 1 or self.displacement.shape != (self.t.size, 2):
            shapes = f"t {self.t.shape} and displacement {self.displacement.shape}"
            raise InputError(f"displacement curve: {shapes}; they must be (m,) and (m, 2)")

    def __repr__(self) -> str:
        if not self.t.size:
            return "<DisplacementCurve: no times>"
        largest = np.linalg.norm(self.displacement, axis=1).max()
        return (
            f"<DisplacementCurve: {self.t.size} times, {self.t[0]:g} to {self.t[-1]:g} µs, "
            f"largest displacement {largest:.4g} µm>"
        )


@dataclass(frozen=True, slots=True)
class CurveDifference:
    """The difference of two curves.

    Numbers are relative to the largest vector of the reference, or as they are where that is 0.

    Attributes:
        largest: largest distance at one time.
        rms: root mean square of the distance.
        at_time: time of the largest distance, µs.
        of_largest: largest vector less that of the reference, whenever they are reached.
        scale: largest vector of the reference, µm, or µN of forces.
    """

    largest: float
    rms: float
    at_time: float
    of_largest: float
    scale: float


def difference(curve: DisplacementCurve, reference: DisplacementCurve) -> CurveDifference:
    """Compute how far `curve` is from `reference`, at the reference's times that both cover.

    Vectors are compared by their Euclidean distance; `curve` is interpolated linearly where its
    times differ.

    Raises:
        InputError: they have no common time.

    Examples:
        Two oscillations, of which the first has an amplitude of 10.2 µm instead of 10 µm:

        >>> import numpy as np
        >>> from surrofe2 import DisplacementCurve, difference
        >>> t = np.linspace(0.0, 100.0, 201)  # µs
        >>> swing = np.outer(np.sin(0.1 * t), [0.0, 1.0])
        >>> reference = DisplacementCurve(t, 10.0 * swing)
        >>> result = difference(DisplacementCurve(t, 10.2 * swing), reference)
        >>> print(f"{result.largest:.1%} of {result.scale:.0f} µm")
        2.0% of 10 µm
    """
    within = (reference.t >= curve.t[0]) & (reference.t <= curve.t[-1])
    if not within.any():
        raise InputError("displacement curves: no common time; they must overlap")
    t = reference.t[within]
    of_reference = reference.displacement[within]
    components = [np.interp(t, curve.t, curve.displacement[:, k]) for k in range(2)]
    of_curve = np.stack(components, axis=1)
    distance = np.linalg.norm(of_curve - of_reference, axis=1)
    scale = float(np.linalg.norm(of_reference, axis=1).max())
    largest = float(np.linalg.norm(of_curve, axis=1).max())
    unit = scale or 1.0
    return CurveDifference(
        largest=float(distance.max() / unit),
        rms=float(np.sqrt(np.mean(distance**2)) / unit),
        at_time=float(t[distance.argmax()]),
        of_largest=(largest - scale) / unit,
        scale=scale,
    )

"""What the equations of motion are at one state, or why they are nothing there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from surrofe2.law.stress_law import StressResponse

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The equations of motion at one state.

    Attributes:
        t: µs.
        within: a time inside the piece of all amplitudes that it belongs to, µs.
        y: (2 m,) displacement and velocity of the m free unknowns, µm and µm/µs.
        u, v: (n, 2) displacement and velocity of all nodes and bodies.
        internal: (n, 2) internal force, µN.
        forces: (k, n, 2) the other forces of the system, µN.
        residual: (m,) forces − internal − what prescribed accelerations take, µN.
        powers: (k + 3,) of the internal force, the other forces, the supports and inertia M ü,
            pJ/µs.
        rate: (2 m,) rate of y.
        F, F_dot: (n_points, 2, 2).
        response: what the stress law answered.
    """

    t: float
    within: float
    y: Array
    u: Array
    v: Array
    internal: Array
    forces: Array
    residual: Array
    powers: Array
    rate: Array
    F: Array
    F_dot: Array
    response: StressResponse

    @property
    def acceleration(self) -> Array:
        """(m,) ü of the free unknowns, µm/µs²."""
        return self.rate[self.y.size // 2 :]


class NoStress(Exception):  # noqa: N818 - of a trial state; whoever tries another catches it
    """There is no stress at some point: whoever tried the state must take a shorter step.

    Its text says which point, where, when, its F, and why.
    """


class Switched(Exception):  # noqa: N818 - as above
    """Points left their branch of the law within a step: the step must be restarted.

    Attributes:
        y: (2 m,) state at which they were found.
        points: (n_points,) int8, as of `StressResponse.switched`.
    """

    def __init__(self, y: Array, points: NDArray[np.int8]) -> None:
        super().__init__("points left their branch of the law")
        self.y, self.points = y, points

"""What a cache asks of its surrogate, its fallback and the fallback's state."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.stress_law import StressLaw

Array = NDArray[np.float64]


class Surrogate(Protocol):
    """A stress that is quick to look up, and says where it may not be asked.

    It may have more, each of which the cache uses where it is there:

    - ``stress_spread: float``, µN/µm, the unit of the user's tolerance. Without it the surrogate
      is taken to know no bound of its error, and its range alone decides, with a warning.
    - ``tangents(F, F_dot) -> Tangents`` of the answers of `lookup`, or
      ``respond(F, F_dot, tangents=True)``: for implicit macro steps.
    - ``look_whether(F, F_dot, tolerance) -> (status, bound)`` of `lookup`, where that is cheaper
      without the stress: asked for a step ahead.
    - ``learn(F, F_dot, stress, state)``: true answers of the fallback at ends of kept steps, all
      of status 0, with its state for these points (or None). Called from `CachedLaw.accept` only,
      with what was not answered by the surrogate and what an audit found wrong.
    """

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell whose stress was learnt."""

    @property
    def initialisation(self) -> str:
        """How its RVE was initialised."""

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""

    def lookup(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """(stress (n, 2, 2), status (n,), bound (n,) of its error) in one pass, µN/µm.

        Input is contiguous float64 (n, 2, 2), else unchecked: status 0 only where it is finite,
        det F > 0, the point is in range and the bound is at most `tolerance`. Pure.
        """


class Fallback(StressLaw, Protocol):
    """The true law of the same plant cell; its states, if any, are `PointStates`."""

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell."""

    @property
    def initialisation(self) -> str:
        """How its RVE is initialised."""


class PointStates(Protocol):
    """A warm start of n points that can be taken apart; values, never changed in place.

    It may have `left_points` (n,), bool: where the stress is one of several, beyond a bifurcation,
    and not to be learnt.
    """

    def take(self, indices: NDArray[np.intp]) -> Any:
        """The state of these points, in this order; a point may be taken twice."""

    def put(self, indices: NDArray[np.intp], state: Any) -> Any:
        """This state with that of these points replaced."""


class Keep(Protocol):
    """Takes every true answer that a run has paid for, at accepted steps."""

    def __call__(
        self, F: Array, F_dot: Array, stress: Array, status: NDArray[np.int8], why: NDArray[np.int8]
    ) -> None:
        """Points (n, 2, 2) with stress and status of the fallback; why: 0 fallback, 1 audit."""

"""Laws that look where a step is about to go, so that little is computed in vain."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.law.stress_law import StressLaw


@runtime_checkable
class ForesightLaw(StressLaw, Protocol):
    """A switching law that knows before a trial step is computed which points will leave it."""

    def leaving(self, F: Array, F_dot: Array, state: Any) -> NDArray[np.int8] | None:
        """Return what `respond` would return as `StressResponse.switched`, at the cost of a lookup.

        A step in which points switch is repeated, so their stresses would be computed in vain.
        """

    def learn_ahead(self, F: Array, F_dot: Array, switched: NDArray[np.int8]) -> NDArray[np.int8]:
        """Learn at some of the points that `StressResponse.switched` marks.

        Args:
            F, F_dot: (n, 2, 2) deformation and rate at the end of the trial step.
            switched: (n,) codes why points must leave their branch, 0 where they need not.

        Returns:
            (n,) the same, 0 at the points that need not leave any more.
        """

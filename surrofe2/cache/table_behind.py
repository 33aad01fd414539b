"""`TableBehind`: a trained surrogate, and a table for what it may not answer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.protocols import Surrogate
from surrofe2.cache.table import StressTable
from surrofe2.errors import MismatchError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.stress_law import Status, Tangents

Array = NDArray[np.float64]


class TableBehind:
    """`lookup` asks the surrogate first and the table for the rest; the table alone learns.

    Attributes:
        stress_spread: µN/µm, the surrogate's.

    Raises:
        MismatchError: they are not of the same plant cell and initialisation.
    """

    def __init__(self, surrogate: Surrogate, table: StressTable) -> None:
        if surrogate.cell != table.cell or surrogate.initialisation != table.initialisation:
            raise MismatchError(
                f"table: of cell parameters {table.cell.fingerprint}, {table.initialisation}, the "
                f"surrogate of {surrogate.cell.fingerprint}, {surrogate.initialisation}; use a "
                "table of these parameters"
            )
        self.surrogate = surrogate
        self.table = table
        self.stress_spread = surrogate.stress_spread

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell."""
        return self.surrogate.cell

    @property
    def initialisation(self) -> str:
        """How its RVE is initialised."""
        return self.surrogate.initialisation

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.surrogate.density

    @property
    def has_bound(self) -> bool:
        """Whether the surrogate has one, as the table has."""
        return self.surrogate.has_bound

    @property
    def has_tangents(self) -> bool:
        """Never: a table has none."""
        return False

    @property
    def learns(self) -> bool:
        """Always: the table does."""
        return True

    def lookup(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """As `Surrogate.lookup`; a point that neither knows has the surrogate's status."""
        stress, status, bound = self.surrogate.lookup(F, F_dot, tolerance)
        missed = status.nonzero()[0]
        if not len(missed):
            return stress, status, bound
        answer, known, of_table = self.table.lookup(F[missed], F_dot[missed], tolerance)
        found = known == Status.OK
        at = missed[found]
        stress[at], status[at], bound[at] = answer[found], Status.OK, of_table[found]
        return stress, status, bound

    def status_and_bound(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """Those of `lookup`."""
        status, bound = self.surrogate.status_and_bound(F, F_dot, tolerance)
        missed = status.nonzero()[0]
        if len(missed):
            known, of_table = self.table.status_and_bound(F[missed], F_dot[missed], tolerance)
            found = known == Status.OK
            status[missed[found]], bound[missed[found]] = Status.OK, of_table[found]
        return status, bound

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """An InputError, the table's."""
        return self.table.tangents(F, F_dot)

    def learn(self, F: Array, F_dot: Array, stress: Array, state: Any = None) -> None:
        """Let the table take true answers in."""
        self.table.learn(F, F_dot, stress, state)

"""The surface law of a plant cell as runs use it: a table, and true slabs beyond its range."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from surrofe2.base.errors import InputError
from surrofe2.law.surface_law import SurfaceResponse
from surrofe2.surface.slab_law import SlabLaw
from surrofe2.surface.tabulated import TabulatedSurface, tabulate_surface

_HALVINGS = 3


class CellSurface:
    """A `SurfaceLaw` that asks its table, and the slab where that has no answer.

    Attributes:
        table: of the slab.
        rows: of the slab.
    """

    def __init__(self, table: TabulatedSurface, rows: int, slab: Callable[[], SlabLaw]) -> None:
        """Slab: gives it when it is first asked."""
        self.table, self.rows, self._make = table, rows, slab
        self._slab: SlabLaw | None = None

    @property
    def mass(self) -> float:
        return self.table.mass

    @property
    def depth(self) -> float:
        return self.table.depth

    @property
    def width(self) -> float:
        return self.table.width

    def respond(
        self, stretch: Any, stretch_rate: Any, *, tangents: bool = False
    ) -> SurfaceResponse:
        answer = self.table.respond(stretch, stretch_rate, tangents=tangents)
        if answer.valid.all():
            return answer
        if self._slab is None:
            self._slab = self._make()
        own = np.flatnonzero(~answer.valid)
        true = self._slab.respond(stretch[own], stretch_rate[own], tangents=tangents)
        answer.tension[own], answer.valid[own] = true.tension, true.valid
        if answer.tangent is not None and answer.rate_tangent is not None:
            answer.tangent[own], answer.rate_tangent[own] = true.tangent, true.rate_tangent
        return answer


def table_within(slab: SlabLaw, stretch: tuple[float, float], rate: float) -> TabulatedSurface:
    """The table over a range, or over half of it and less where the slab has no state out there.

    Raises:
        InputError: there is none over an eighth of the range.
    """
    for halvings in range(_HALVINGS + 1):
        share = 0.5**halvings
        low, high = (1.0 + share * (each - 1.0) for each in stretch)
        try:
            return tabulate_surface(slab, (low, high), share * rate)
        except InputError as error:
            failure = error
    raise failure

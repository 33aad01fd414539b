"""`SurfaceLaw`: (λ, λ̇) along a free side in, its line tension out, for all points at once.

A free side of a tissue differs from the bulk beside it: outer walls are single, and outer plant
cells relax into the open. What that adds to a continuum is a line tension (Gurtin, Murdoch 1975);
docs/theory.md, surface law. Slabs of plant cells, tables and test laws implement `SurfaceLaw`; the
macro scale knows nothing else of them.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from surrofe2.base.arrays import Array, Flags


class SurfaceResponse(NamedTuple):
    """The answer of a surface law at n points.

    Attributes:
        tension: (n,) nominal tension P_s, µN: its power is P_s λ̇ per undeformed length; NaN where
            there is no answer.
        tangent: (n,) ∂P_s/∂λ, µN; None unless asked for.
        rate_tangent: (n,) ∂P_s/∂λ̇, µN µs; None unless asked for.
    """

    tension: Array
    tangent: Array | None = None
    rate_tangent: Array | None = None

    @property
    def valid(self) -> Flags:
        """True where there is an answer, (n,)."""
        return ~np.isnan(self.tension)


class SurfaceLaw(Protocol):
    """A law P_s(λ, λ̇) of a free side of a tissue. It is pure and has no memory."""

    @property
    def mass(self) -> float:
        """Mass of the surface beyond that of the bulk, ng per µm of undeformed length; any sign."""

    @property
    def depth(self) -> float:
        """Depth below the outline at which it acts, µm: λ is the stretch there."""

    @property
    def width(self) -> float:
        """Length of side over which λ is the mean, µm."""

    def respond(
        self, stretch: Array, stretch_rate: Array, *, tangents: bool = False
    ) -> SurfaceResponse:
        """Compute the tension at n points.

        Args:
            stretch: (n,) λ along the side, positive.
            stretch_rate: (n,) λ̇, 1/µs.
            tangents: whether the answer shall carry its derivatives.
        """

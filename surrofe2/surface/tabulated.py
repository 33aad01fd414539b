"""A surface law from a table: Chebyshev polynomials in stretch and rate (docs/theory.md, (A47)).

The coefficients follow from the slab's answers at the roots of the next polynomials. Degrees rise
until answers at random points of the range are met; tangents are those of the polynomials. Runs ask
the table, and the slab beyond its range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebpts1, chebvander
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.law.surface_law import SurfaceLaw, SurfaceResponse
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.surface.slab_law import SlabLaw

TOLERANCE = 1e-4
"""Largest error of the tension over its spread."""
DEGREES = ((8, 4), (12, 4), (16, 4), (16, 8), (24, 8), (32, 8), (48, 12), (64, 16))
"""Coefficients by stretch and by rate, tried in turn."""
CHECKS = 96
"""Random points at which a table is compared with the slab."""
_KEPT = 0.5
"""Polynomials are left out while the error found is less than this part of the tolerance."""
_BATCH = 64
_HALVINGS = 3
_SLACK = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedSurface:
    """P_s(λ, λ̇) as polynomials.

    Attributes:
        coefficients: (p, q) C, µN.
        stretch: (low, high) of λ; rate: bound on |λ̇|, 1/µs.
        mass, depth, width: ng/µm, µm and µm, see `SurfaceLaw`.
        cell, initialisation: of the slab.
        error, spread: largest error found, and range of the tension, µN.
        rows: of the slab, where a run knows it; else 0.
        beyond: gives the law beyond the range, such as the slab; None: there is no answer.
    """

    coefficients: Array
    stretch: tuple[float, float]
    rate: float
    mass: float
    depth: float
    width: float
    cell: CellParameters
    initialisation: str
    error: float
    spread: float
    rows: int = 0
    beyond: Callable[[], SurfaceLaw] | None = None

    def respond(
        self, stretch: Any, stretch_rate: Any, *, tangents: bool = False
    ) -> SurfaceResponse:
        """Tension at n points; see `SurfaceLaw.respond`."""
        stretch, rate = np.asarray(stretch, np.float64), np.asarray(stretch_rate, np.float64)
        (low, high), C = self.stretch, self.coefficients
        x, y = 2.0 * (stretch - low) / (high - low) - 1.0, rate / self.rate
        valid = np.maximum(abs(x), abs(y)) <= 1.0 + _SLACK
        by_x = chebvander(np.clip(x, -1.0, 1.0), len(C) - 1)
        by_y = chebvander(np.clip(y, -1.0, 1.0), C.shape[1] - 1)
        parts: list[NDArray] = [C]
        if tangents:
            parts += chebder(C, scl=2.0 / (high - low)), chebder(C, scl=1.0 / self.rate, axis=1)
        values = np.array([_series(each, by_x, by_y) for each in parts])
        values[:, ~valid] = np.nan
        outside = np.flatnonzero(~valid)
        if outside.size and self.beyond is not None:
            answer = self.beyond().respond(stretch[outside], rate[outside], tangents=tangents)
            values[:, outside] = answer[: len(values)]
        return SurfaceResponse(*values)


def _series(C: NDArray, by_x: NDArray, by_y: NDArray) -> Array:
    """(n,) Σ C_ij T_i(x) T_j(y) from (n, …) polynomials at the points, of which C has the first."""
    p, q = C.shape
    return np.asarray(np.einsum("nj,nj->n", by_x[:, :p] @ C, by_y[:, :q]))


def tabulate_surface(
    law: SlabLaw,
    stretch: tuple[float, float],
    rate: float,
) -> TabulatedSurface:
    """The table of a slab's law over a range, within `TOLERANCE` at `CHECKS` random points.

    Args:
        stretch: (low, high) of λ. rate: bound on |λ̇|, 1/µs.

    Raises:
        InputError: a range without extent, a slab without an answer in it, or an answer that no
            table of `DEGREES` meets.
    """
    low, high = stretch
    if not (0.0 < low < high and rate > 0.0):
        raise InputError(
            f"surface: stretch ({low:g}, {high:g}), rate {rate:g}; low must be positive and below "
            "high, the rate positive"
        )
    rng = np.random.default_rng(1)
    checks = rng.uniform((low, -rate), (high, rate), (CHECKS, 2)).T
    wanted = _tensions(law, *checks)
    spread, whose = float(np.ptp(wanted)), (law.cell, law.initialisation)
    for p, q in DEGREES:
        C = _coefficients(law, (low, high), rate, p, q)
        acting = law.mass, law.depth, law.width
        table = TabulatedSurface(C, (low, high), rate, *acting, *whose, np.inf, spread)
        table = _with_error(table, checks, wanted)
        if table.error <= TOLERANCE * spread:
            return _trimmed(table, checks, wanted, _KEPT * TOLERANCE * spread)
    raise InputError(
        f"surface: no table is within {TOLERANCE:g} of the tension's spread, the last one within "
        f"{table.error / spread:.2g}; narrow the range of stretch ({low:g}, {high:g})"
    )


def _coefficients(law: SlabLaw, stretch: tuple[float, float], rate: float, p: int, q: int) -> Array:
    """(p, q) from the slab's answers at the roots of T_p and T_q."""
    (low, high), x, y = stretch, chebpts1(p), chebpts1(q)
    nodes = np.meshgrid(low + 0.5 * (high - low) * (x + 1.0), rate * y, indexing="ij")
    tension = _tensions(law, *(each.ravel() for each in nodes)).reshape(p, q)
    by_x = np.linalg.solve(chebvander(x, p - 1), tension)
    return np.ascontiguousarray(np.linalg.solve(chebvander(y, q - 1), by_x.T).T)


def _tensions(law: SlabLaw, stretch: Array, rate: Array) -> Array:
    """(n,) the slab's answers. Raises `InputError` where there is none at a point."""
    found = []
    for first in range(0, len(stretch), _BATCH):
        part = slice(first, first + _BATCH)
        answer = law.respond(stretch[part], rate[part])
        lost = np.flatnonzero(~answer.valid)
        if lost.size:
            at = first + int(lost[0])
            raise InputError(
                f"surface: no stable slab at stretch {stretch[at]:.4g}, rate {rate[at]:.3g} 1/µs; "
                "narrow the range"
            )
        found.append(answer.tension)
    return np.concatenate(found)


def _with_error(table: TabulatedSurface, checks: Array, wanted: Array) -> TabulatedSurface:
    return replace(table, error=float(np.abs(table.respond(*checks).tension - wanted).max()))


def _trimmed(
    table: TabulatedSurface, checks: Array, wanted: Array, most: float
) -> TabulatedSurface:
    """The table without the last polynomials that it does not need."""
    for axis in (0, 1):
        while table.coefficients.shape[axis] > 2:
            fewer = np.ascontiguousarray(np.delete(table.coefficients, -1, axis=axis))
            shorter = _with_error(replace(table, coefficients=fewer), checks, wanted)
            if shorter.error > most:
                break
            table = shorter
    return table


def table_within(slab: SlabLaw, stretch: tuple[float, float], rate: float) -> TabulatedSurface:
    """The table over a range, or over half of it and less where the slab has no state out there.
    Raises `InputError` where there is none over an eighth of the range.
    """
    for halvings in range(_HALVINGS + 1):
        share = 0.5**halvings
        low, high = (1.0 + share * (each - 1.0) for each in stretch)
        try:
            return tabulate_surface(slab, (low, high), share * rate)
        except InputError as error:
            failure = error
    raise failure

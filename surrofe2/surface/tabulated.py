"""A surface law from a table: Chebyshev polynomials in stretch and rate (docs/theory.md, (A47)).

The coefficients follow from the slab's answers at the roots of the next polynomials. Degrees rise
until answers at random points of the range are met; tangents are those of the polynomials. Runs ask
the table, and the slab beyond its range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.typing import NDArray

from surrofe2.base.compilation import kernel
from surrofe2.base.errors import InputError
from surrofe2.law.surface_law import SurfaceLaw, SurfaceResponse
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.surface.slab_law import SlabLaw

Array = NDArray[np.float64]

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
        along = np.ascontiguousarray(stretch, dtype=np.float64)
        rate = np.ascontiguousarray(stretch_rate, dtype=np.float64)
        values, valid = np.empty((3, len(along))), np.empty(len(along), dtype=np.bool_)
        evaluate(self.coefficients, (*self.stretch, self.rate), along, rate, values, valid)
        outside = np.flatnonzero(~valid)
        if outside.size and self.beyond is not None:
            answer = self.beyond().respond(along[outside], rate[outside], tangents=tangents)
            values[0, outside], valid[outside] = answer.tension, answer.valid
            if tangents:
                values[1, outside], values[2, outside] = answer.tangent, answer.rate_tangent
        if not tangents:
            return SurfaceResponse(values[0], valid)
        return SurfaceResponse(values[0], valid, values[1], values[2])


@kernel
def evaluate(
    coefficients: Array,
    bounds: tuple[float, float, float],
    stretch: Array,
    rate: Array,
    values: Array,
    valid: NDArray[np.bool_],
) -> None:
    """Set values (3, n): P_s, ∂P_s/∂λ, ∂P_s/∂λ̇ in µN, µN, µN µs; NaN where `valid` (n,) is not.

    bounds: low and high of λ, and of |λ̇|.
    """
    (p, q), (low, high, bound) = coefficients.shape, bounds
    polynomial, slope = np.empty(q), np.empty(q)
    x_scale, y_scale = 2.0 / (high - low), 1.0 / bound
    for n in range(stretch.shape[0]):
        x, y = (stretch[n] - low) * x_scale - 1.0, rate[n] * y_scale
        valid[n] = abs(x) <= 1.0 + _SLACK and abs(y) <= 1.0 + _SLACK
        if not valid[n]:
            values[0, n], values[1, n], values[2, n] = np.nan, np.nan, np.nan
            continue
        polynomial[0], slope[0] = 1.0, 0.0
        polynomial[1], slope[1] = y, 1.0
        for j in range(2, q):
            polynomial[j] = 2.0 * y * polynomial[j - 1] - polynomial[j - 2]
            slope[j] = 2.0 * (polynomial[j - 1] + y * slope[j - 1]) - slope[j - 2]
        # Clenshaw's recurrence in x of the value, its slope by x and its slope by y
        b1, b2, d1, d2, r1, r2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(p - 1, -1, -1):
            value, by_y = 0.0, 0.0
            for j in range(q):
                value += coefficients[i, j] * polynomial[j]
                by_y += coefficients[i, j] * slope[j]
            twice = 2.0 * x if i > 0 else x
            d0 = (2.0 * b1 if i > 0 else b1) + twice * d1 - d2
            b0, r0 = value + twice * b1 - b2, by_y + twice * r1 - r2
            b1, b2, d1, d2, r1, r2 = b0, b1, d0, d1, r0, r1
        values[0, n], values[1, n], values[2, n] = b1, d1 * x_scale, r1 * y_scale


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

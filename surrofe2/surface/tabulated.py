"""A surface law from a table: Chebyshev polynomials in stretch and rate (docs/theory.md, (A47)).

The coefficients follow from the slab's tension at the roots of the next polynomials. Degrees rise
until the table agrees with the slab at random points of the range; tangents are those of the
polynomials. Runs use the table, and the slab beyond its range.
"""

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
# The last polynomials are left out while the error stays below this fraction of the tolerance.
_TRIMMED_TO = 0.5
# Points at which slabs are solved at once; each holds the state of a slab.
_BATCH = 64
# A range in which the slab has no state is halved at most so often.
_HALVINGS = 3
# A point counts as in range up to this fraction of the half range beyond: rounding.
_SLACK = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class TabulatedSurface:
    """P_s(λ, λ̇) as polynomials.

    Attributes:
        coefficients: (p, q) coefficients C, µN.
        stretch: (low, high) bounds of λ.
        rate: bound on |λ̇|, 1/µs.
        mass: mass of the side, ng/µm, see `SurfaceLaw`.
        depth: depth at which the law acts, µm, see `SurfaceLaw`.
        width: length over which the law takes the mean stretch, µm, see `SurfaceLaw`.
        cell: plant cell of the slab.
        initialisation: initialisation of the slab.
        error: largest error at the random points, µN.
        spread: range of the tension at the random points, µN.
        rows: rows of the slab, where a run knows it; else 0.
        beyond: called for the law beyond the range, such as the slab; None: the tension is NaN
            there.
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
        """Compute the tension at n points; see `SurfaceLaw.respond`."""
        stretch = np.asarray(stretch, np.float64)
        rate = np.asarray(stretch_rate, np.float64)
        low, high = self.stretch
        C = self.coefficients
        # λ and λ̇ mapped to [−1, 1]
        x = 2.0 * (stretch - low) / (high - low) - 1.0
        y = rate / self.rate
        T_x = chebvander(np.clip(x, -1.0, 1.0), len(C) - 1)
        T_y = chebvander(np.clip(y, -1.0, 1.0), C.shape[1] - 1)
        series: list[NDArray] = [C]
        if tangents:
            C_by_stretch = chebder(C, scl=2.0 / (high - low))
            C_by_rate = chebder(C, scl=1.0 / self.rate, axis=1)
            series += [C_by_stretch, C_by_rate]
        # rows: the tension and, where wanted, its two tangents
        values = np.array([_series(coefficients, T_x, T_y) for coefficients in series])
        valid = np.maximum(abs(x), abs(y)) <= 1.0 + _SLACK
        values[:, ~valid] = np.nan
        outside = np.flatnonzero(~valid)
        if outside.size and self.beyond is not None:
            answer = self.beyond().respond(stretch[outside], rate[outside], tangents=tangents)
            # tension, tangent and rate tangent are the fields, in this order
            values[:, outside] = answer[: len(values)]
        return SurfaceResponse(*values)


def _series(C: NDArray, T_x: NDArray, T_y: NDArray) -> Array:
    """Sum the series Σ C_ij T_i(x) T_j(y) at n points, (n,).

    T_x (n, ≥ p) and T_y (n, ≥ q) are polynomials at the points; C (p, q) may have fewer of them.
    """
    p, q = C.shape
    return np.asarray(np.einsum("nj,nj->n", T_x[:, :p] @ C, T_y[:, :q]))


def tabulate_surface(
    law: SlabLaw,
    stretch: tuple[float, float],
    rate: float,
) -> TabulatedSurface:
    """Tabulate a slab's law over a range, within `TOLERANCE` at `CHECKS` random points.

    Args:
        stretch: (low, high) bounds of λ.
        rate: bound on |λ̇|, 1/µs.

    Raises:
        InputError: a range without extent, a slab without an equilibrium in it, or a tension that
            no table of `DEGREES` meets.
    """
    low, high = stretch
    if not (0.0 < low < high and rate > 0.0):
        raise InputError(
            f"surface: stretch ({low:g}, {high:g}), rate {rate:g}; low must be positive and below "
            "high, the rate positive"
        )
    # one seed for all: the same slab has the same table
    rng = np.random.default_rng(1)
    checks = rng.uniform((low, -rate), (high, rate), (CHECKS, 2)).T
    expected = _tensions(law, *checks)
    spread = float(np.ptp(expected))
    for p, q in DEGREES:
        table = TabulatedSurface(
            coefficients=_coefficients(law, (low, high), rate, p, q),
            stretch=(low, high),
            rate=rate,
            mass=law.mass,
            depth=law.depth,
            width=law.width,
            cell=law.cell,
            initialisation=law.initialisation,
            error=np.inf,  # known only once the table is compared
            spread=spread,
        )
        table = _with_error(table, checks, expected)
        if table.error <= TOLERANCE * spread:
            return _trimmed(table, checks, expected, _TRIMMED_TO * TOLERANCE * spread)
    raise InputError(
        f"surface: no table is within {TOLERANCE:g} of the tension's spread, the last one within "
        f"{table.error / spread:.2g}; narrow the range of stretch ({low:g}, {high:g})"
    )


def _coefficients(law: SlabLaw, stretch: tuple[float, float], rate: float, p: int, q: int) -> Array:
    """Return coefficients (p, q), µN, by the slab's tension at the roots of T_p and T_q."""
    low, high = stretch
    x = chebpts1(p)
    y = chebpts1(q)
    nodes = np.meshgrid(low + 0.5 * (high - low) * (x + 1.0), rate * y, indexing="ij")
    stretches, rates = nodes
    tension = _tensions(law, stretches.ravel(), rates.ravel()).reshape(p, q)
    # C of T_x C T_yᵀ = tension: one variable after the other
    by_x = np.linalg.solve(chebvander(x, p - 1), tension)
    return np.ascontiguousarray(np.linalg.solve(chebvander(y, q - 1), by_x.T).T)


def _tensions(law: SlabLaw, stretch: Array, rate: Array) -> Array:
    """Compute the slab's tension (n,), µN.

    Raises:
        InputError: the slab has no stable equilibrium at one of the points.
    """
    tensions = []
    for first in range(0, len(stretch), _BATCH):
        part = slice(first, first + _BATCH)
        answer = law.respond(stretch[part], rate[part])
        failed = np.flatnonzero(~answer.valid)
        if failed.size:
            point = first + int(failed[0])
            raise InputError(
                f"surface: no stable slab at stretch {stretch[point]:.4g}, "
                f"rate {rate[point]:.3g} 1/µs; narrow the range"
            )
        tensions.append(answer.tension)
    return np.concatenate(tensions)


def _with_error(table: TabulatedSurface, checks: Array, expected: Array) -> TabulatedSurface:
    """Return the table with its largest error at `checks`, (2, n) stretches and rates."""
    tension = table.respond(*checks).tension
    return replace(table, error=float(np.abs(tension - expected).max()))


def _trimmed(
    table: TabulatedSurface, checks: Array, expected: Array, most: float
) -> TabulatedSurface:
    """Return the table without the last polynomials that it does not need for an error of `most`.

    Fewer polynomials are faster to evaluate; two of each variable stay, so that slopes do.
    """
    for axis in (0, 1):
        while table.coefficients.shape[axis] > 2:
            fewer = np.ascontiguousarray(np.delete(table.coefficients, -1, axis=axis))
            shorter = _with_error(replace(table, coefficients=fewer), checks, expected)
            if shorter.error > most:
                break
            table = shorter
    return table


def table_within(slab: SlabLaw, stretch: tuple[float, float], rate: float) -> TabulatedSurface:
    """Tabulate over a range, or a half, a quarter or an eighth of it around λ = 1 and λ̇ = 0.

    It is the first of these ranges in which the slab has an equilibrium everywhere.

    Raises:
        InputError: there is no table even over an eighth of the range.
    """
    low, high = stretch
    for halvings in range(_HALVINGS + 1):
        fraction = 0.5**halvings
        narrowed = (1.0 + fraction * (low - 1.0), 1.0 + fraction * (high - 1.0))
        try:
            return tabulate_surface(slab, narrowed, fraction * rate)
        except InputError as error:
            failure = error
    raise failure

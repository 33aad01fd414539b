"""Mass of one displacement component, and its inverse between the free unknowns."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy  # scipy.sparse is loaded where a mesh is large
from numpy.typing import NDArray

from surrofe2.macro.forces import Matrix
from surrofe2.macro.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.int64]
DENSE_LIMIT = 300
_ROUNDING = 1e-14  # of the largest entry


def make_mass(problem: Problem, tissue: tuple[Array, Index, Index], n: int) -> Matrix:
    """Mass (n, n) of nodes and bodies, dense where that is small.

    Args:
        tissue: entries, rows and columns of its mass; those of the same place add up.
    """
    entries, row, column = tissue
    bodies = np.arange(n - len(problem.bodies), n)
    masses = [1.0 if body.mass is None else body.mass for body in problem.bodies]
    entries = np.concatenate([entries, masses])
    row, column = np.concatenate([row, bodies]), np.concatenate([column, bodies])
    if n > DENSE_LIMIT:
        return scipy.sparse.csc_matrix((entries, (row, column)), shape=(n, n))
    return np.bincount(n * row + column, entries, n * n).reshape(n, n)


def mass_solver(mass: Matrix, free: Index) -> Callable[[Array], Array]:
    """Inverse of the mass of the free unknowns; one factor where x and y are free alike."""
    rows = [free[free % 2 == k] // 2 for k in (0, 1)]
    if np.array_equal(*rows):
        solve = _factorised_mass(mass, rows[0])

        def solve_both(r: Array) -> Array:
            result: Array = solve(r.reshape(-1, 2)).ravel()
            return result

        return solve_both
    places = [np.flatnonzero(free % 2 == k) for k in (0, 1)]
    solvers = [_factorised_mass(mass, each) if each.size else None for each in rows]

    def solve_each(r: Array) -> Array:
        result = np.empty_like(r)
        for place, solve in zip(places, solvers, strict=True):
            if solve is not None:
                result[place] = solve(r[place])
        return result

    return solve_each


def _factorised_mass(mass: Matrix, rows: Index) -> Callable[[Array], Array]:
    """Inverse of the mass between these rows.

    The matrix is symmetric and positive definite, so a sparse one needs no pivoting and an
    ordering that keeps symmetry. That of a regular grid of equal density is a Kronecker product of
    two small ones, five times quicker to solve.
    """
    part = mass[rows][:, rows]
    if isinstance(part, np.ndarray):
        inverse = np.linalg.inv(part)
        return lambda r: inverse @ r
    both = _factors_of_product(part)
    if both is not None:
        inverses: Any = [np.linalg.inv(each) for each in both]
        return partial(_solve_product, *inverses)
    factor = scipy.sparse.linalg.splu(
        scipy.sparse.csc_matrix(part),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    solve: Callable[[Array], Array] = factor.solve
    return solve


def _factors_of_product(mass: Matrix) -> tuple[Array, Array] | None:
    """A (p, p) and B (q, q) where the mass (p q, p q) is A ⊗ B; None where it is none."""
    n, columns = mass.shape[0], mass[[0]].nonzero()[1]
    q = int(columns[2:].min(initial=n))  # of row 0, after itself and its neighbour in B
    if len(columns) != 4 or n % q:
        return None
    second = mass[:q, :q].toarray()
    first = mass[::q, ::q].toarray() / second[0, 0]
    off = mass - scipy.sparse.kron(first, second)
    return (first, second) if abs(off).max() <= _ROUNDING * abs(mass).max() else None


def _solve_product(first: Array, second: Array, r: Array) -> Array:
    """(A⁻¹ ⊗ B⁻¹) r of r (p q,) or (p q, k), both inverses given."""
    p, q = len(first), len(second)
    half = (first @ r.reshape(p, -1)).reshape(p, q, -1)
    whole = second @ half.transpose(1, 0, 2).reshape(q, -1)
    result: Array = whole.reshape(q, p, -1).transpose(1, 0, 2).reshape(r.shape)
    return result

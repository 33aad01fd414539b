"""Solutions with the factors of `systems`, dense or sparse by the type of the topology."""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from surrofe2.compilation import OPTIONS
from surrofe2.rve.linear import solve_factorised
from surrofe2.rve.linear_columns import solve_four, solve_four_transposed
from surrofe2.rve.sparse_linear import solve_sparse
from surrofe2.rve.sparse_transposed import solve_sparse_transposed
from surrofe2.rve.systems import is_dense


def solve(lu: Any, b: Any, topology: Any) -> None:
    """Replace b by the solution."""
    raise NotImplementedError("for kernels")


def solve_columns(lu: Any, b: Any, topology: Any) -> None:
    """Replace the four columns of b (4, unknowns, TILE) by the solutions."""
    raise NotImplementedError("for kernels")


def solve_transposed(lu: Any, b: Any, topology: Any) -> None:
    """As `solve_columns` with the transposed matrix."""
    raise NotImplementedError("for kernels")


@overload(solve, jit_options=OPTIONS)
def _solve(lu, b, topology):
    def dense(lu, b, topology):
        solve_factorised(lu, b)

    def sparse(lu, b, topology):
        solve_sparse(lu, b, topology)

    return dense if is_dense(topology) else sparse


@overload(solve_columns, jit_options=OPTIONS)
def _solve_columns(lu, b, topology):
    def dense(lu, b, topology):
        solve_four(lu, b)

    def sparse(lu, b, topology):
        for m in range(b.shape[0]):
            solve_sparse(lu, b[m], topology)

    return dense if is_dense(topology) else sparse


@overload(solve_transposed, jit_options=OPTIONS)
def _solve_transposed(lu, b, topology):
    def dense(lu, b, topology):
        solve_four_transposed(lu, b)

    def sparse(lu, b, topology):
        for m in range(b.shape[0]):
            solve_sparse_transposed(lu, b[m], topology)

    return dense if is_dense(topology) else sparse

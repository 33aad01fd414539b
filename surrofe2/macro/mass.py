"""The consistent mass of the tissue, and its inverse, which every evaluation of a run applies once.

Up to `DENSE_LIMIT` unknowns the inverse is a dense matrix. Beyond, the mass is factorised sparsely.
It never couples x and y, so both are solved for in the same pass over one factor.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
import skfem
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import kernel
from surrofe2.macro.elements import Matrix

# Unknowns up to which the mass is inverted and not factorised: such a product is as fast.
DENSE_LIMIT = 200


def tissue_mass(mesh: skfem.Mesh, density: Array) -> Matrix:
    """Compute the consistent mass (2 n_nodes, 2 n_nodes), ng, sparse.

    It is eq. 59 with the reference density (n_el,), ng/µm², over the reference area, which mass
    conservation makes constant.
    """
    basis = skfem.Basis(mesh, mesh.elem())
    form = skfem.BilinearForm(lambda u, v, w: w.density * u * v)
    mass = form.assemble(basis, density=np.broadcast_to(density[:, None], basis.dx.shape))
    return scipy.sparse.kron(mass, np.eye(2), "csc")


def mass_solver(mass: Matrix, free: Index) -> Callable[[Array], Array]:
    """Make the inverse of the mass (m, m) between the free unknowns, applied to (m,)."""
    if mass.shape[0] <= DENSE_LIMIT:
        inverse = np.linalg.inv(mass.toarray())
        return lambda r: inverse @ r
    if not _are_free_alike(free):
        solve: Callable[[Array], Array] = _factorised(mass).solve
        return solve
    lu = _factorised(mass[::2][:, ::2])
    factor = MassFactor.of(lu)
    if factor is None:
        return lambda r: lu.solve(r.reshape(-1, 2)).ravel()
    return partial(solve_both, factor)


def _are_free_alike(free: Index) -> bool:
    """Return whether x and y of each node or body are free together, so that both have one
    factor.
    """
    x = free[::2]
    y = free[1::2]
    return np.array_equal(x + 1, y) and not (x % 2).any()


def _factorised(mass: Matrix) -> Any:
    """Compute SuperLU's factors of a mass. The matrix is symmetric and positive definite, so it
    needs no pivoting and an ordering that keeps symmetry.
    """
    return scipy.sparse.linalg.splu(
        scipy.sparse.csc_matrix(mass),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )


class MassFactor(NamedTuple):
    """The factor P M Pᵀ = L D Lᵀ of a mass M (n, n), L unit lower triangular.

    Kernels take it as it is. Indices are unsigned: for others numba adds a test for counting from
    the end to every access.

    Attributes:
        begins: (n + 1,) places in `rows` and `values` at which the columns of L begin.
        rows, values: the entries of L below its diagonal, column by column.
        inverse_diagonal: (n,) inverse of the diagonal D, 1/ng.
        places: (n,) row to which P moves each row of M.
    """

    begins: NDArray[np.uint32]
    rows: NDArray[np.uint32]
    values: Array
    inverse_diagonal: Array
    places: NDArray[np.uint32]

    @classmethod
    def of(cls, lu: Any) -> MassFactor | None:
        """Take the symmetric factor from what SuperLU computed; None where it moved a pivot."""
        if not np.array_equal(lu.perm_r, lu.perm_c):
            return None
        below = scipy.sparse.tril(lu.L, -1, "csc")
        below.sort_indices()
        return cls(
            begins=below.indptr.astype(np.uint32),
            rows=below.indices.astype(np.uint32),
            values=below.data,
            inverse_diagonal=1.0 / lu.U.diagonal(),
            places=lu.perm_r.astype(np.uint32),
        )


@kernel
def solve_both(factor: Any, r: Any) -> Array:
    """Solve M x = r (2 n,), for the components x and y of each row at once."""
    begins = factor.begins
    rows = factor.rows
    values = factor.values
    n = begins.size - 1
    x = np.empty((n, 2))
    for i in range(n):
        place = factor.places[i]
        x[place, 0] = r[2 * i]
        x[place, 1] = r[2 * i + 1]
    for j in range(n):  # L z = P r
        a = x[j, 0]
        b = x[j, 1]
        for k in range(begins[j], begins[j + 1]):
            x[rows[k], 0] -= values[k] * a
            x[rows[k], 1] -= values[k] * b
    for j in range(n - 1, -1, -1):  # Lᵀ x = D⁻¹ z
        # Four sums at a time, since each would wait for its last term.
        a0 = x[j, 0] * factor.inverse_diagonal[j]
        b0 = x[j, 1] * factor.inverse_diagonal[j]
        a1 = 0.0
        b1 = 0.0
        a2 = 0.0
        b2 = 0.0
        a3 = 0.0
        b3 = 0.0
        k = begins[j]
        end = begins[j + 1]
        while k + 4 <= end:
            a0 -= values[k] * x[rows[k], 0]
            b0 -= values[k] * x[rows[k], 1]
            a1 -= values[k + 1] * x[rows[k + 1], 0]
            b1 -= values[k + 1] * x[rows[k + 1], 1]
            a2 -= values[k + 2] * x[rows[k + 2], 0]
            b2 -= values[k + 2] * x[rows[k + 2], 1]
            a3 -= values[k + 3] * x[rows[k + 3], 0]
            b3 -= values[k + 3] * x[rows[k + 3], 1]
            k += 4
        while k < end:
            a0 -= values[k] * x[rows[k], 0]
            b0 -= values[k] * x[rows[k], 1]
            k += 1
        x[j, 0] = (a0 + a1) + (a2 + a3)
        x[j, 1] = (b0 + b1) + (b2 + b3)
    out = np.empty(2 * n)
    for i in range(n):
        place = factor.places[i]
        out[2 * i] = x[place, 0]
        out[2 * i + 1] = x[place, 1]
    return out

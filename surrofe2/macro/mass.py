"""Mass of one displacement component, and its inverse between the free unknowns."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
import skfem
from numpy.typing import NDArray

from surrofe2.macro.forces import Matrix
from surrofe2.problem.problem import Problem

Array = NDArray[np.float64]
Index = NDArray[np.int64]
DENSE_LIMIT = 300


def tissue_mass(mesh: skfem.Mesh, density: Array) -> Matrix:
    """(n_nodes, n_nodes) consistent mass of one displacement component, ng, sparse.

    Eq. 59 with the reference density (n_el,), ng/µm², over the reference area, which mass
    conservation makes constant.
    """
    basis = skfem.Basis(mesh, mesh.elem())
    form = skfem.BilinearForm(lambda u, v, w: w.density * u * v)
    return form.assemble(basis, density=np.broadcast_to(density[:, None], basis.dx.shape))


def make_mass(problem: Problem, tissue: Matrix) -> Matrix:
    """Mass (n, n) of nodes and bodies, dense where that is small."""
    masses = [1.0 if body.mass is None else body.mass for body in problem.bodies]
    of_bodies = [scipy.sparse.diags(masses)] if masses else []
    mass = scipy.sparse.block_diag([tissue, *of_bodies], "csc")
    return mass if mass.shape[0] > DENSE_LIMIT else mass.toarray()


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
    ordering that keeps symmetry.
    """
    part = mass[rows][:, rows]
    if isinstance(part, np.ndarray):
        inverse = np.linalg.inv(part)
        return lambda r: inverse @ r
    factor = scipy.sparse.linalg.splu(
        scipy.sparse.csc_matrix(part),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    solve: Callable[[Array], Array] = factor.solve
    return solve

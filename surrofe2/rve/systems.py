"""One set of names for the linear systems of an RVE, dense (`linear`) or sparse (`sparse_linear`).

A `Topology` has dense matrices, a `SparseTopology` sparse ones; numba picks by its type. Unknowns
are those of all particles but the held one, b is (2n − 2, TILE). Factors are
(2n − 2, 2n − 2, TILE) dense and (size, TILE) sparse.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray

from surrofe2.compilation import OPTIONS, kernel
from surrofe2.plant_cell.block_pattern import Blocks, Pattern, factorisation_work
from surrofe2.plant_cell.tiles import SparseTopology, Topology
from surrofe2.rve.factors import Factors, kept, kept_sparse
from surrofe2.rve.linear import (
    copy_from,
    factorise,
    factorise_symmetric,
    is_negative_definite,
)
from surrofe2.rve.sparse_linear import factorise_sparse, has_negative_pivots
from surrofe2.simd import TILE, load, store

AnyTopology = Topology | SparseTopology
SPARSE_PAYS_BELOW = 0.8
"""Sparse where it multiplies less than this part of what dense does."""


class Matrices(NamedTuple):
    """Scratch of one tile for factorisations; n particles.

    jacobian: (2n, 2n, TILE), or `Blocks`. free: factors of what is left without particle 0.
    """

    jacobian: Any
    columns: NDArray[np.float64]
    no_columns: NDArray[np.float64]
    free: NDArray[np.float64]
    step: NDArray[np.float64]


def sparse_pays(pattern: Pattern) -> bool:
    """Whether the sparse factorisation is predicted to be the quicker one."""
    unknowns = len(pattern.unknown)
    return factorisation_work(pattern) < SPARSE_PAYS_BELOW * unknowns**3 / 3.0


def empty_factors(topology: AnyTopology, tiles: int) -> Factors:
    """Uninitialised factors to keep."""
    size = None if isinstance(topology, Topology) else topology.size
    return Factors.empty(tiles, 2 * topology.particles - 2, size)


@kernel
def make_matrices(topology):
    """Uninitialised scratch."""
    n = topology.particles
    return Matrices(
        _empty_jacobian(n, topology),
        np.empty((2 * n, 8, TILE)),
        np.empty((0, 8, TILE)),
        _empty_factors(n, topology),
        np.empty((2 * n - 2, TILE)),
    )


def _empty_jacobian(n: Any, topology: Any) -> Any:
    raise NotImplementedError("for kernels")


def _empty_factors(n: Any, topology: Any) -> Any:
    raise NotImplementedError("for kernels")


def factorise_free(matrices: Any, topology: Any) -> None:
    """Factors of the Jacobian without the held particle, into `matrices.free`."""
    raise NotImplementedError("for kernels")


def factorise_elastic(matrices: Any, topology: Any) -> None:
    """As `factorise_free` for the symmetric Jacobian of the elastic forces."""
    raise NotImplementedError("for kernels")


def check_definite(matrices: Any, topology: Any, answer: Any) -> None:
    """answer (TILE,): whether the symmetric Jacobian is negative definite; overwrites `free`."""
    raise NotImplementedError("for kernels")


def check_pivots(lu: Any, topology: Any, answer: Any) -> None:
    """answer (TILE,): the same from factors that are there already."""
    raise NotImplementedError("for kernels")


def keep_factors(lu: Any, target: Any, topology: Any) -> None:
    """Copy factors to where they are kept, in its precision."""
    raise NotImplementedError("for kernels")


def kept_factors(address: Any, topology: Any) -> Any:
    """(lu, slopes) of the block at an address, not copied; see `factors`."""
    raise NotImplementedError("for kernels")


def is_dense(topology: Any) -> bool:
    """Of numba's type of a topology: whether its matrices are dense."""
    return "size" not in topology.fields


@overload(_empty_jacobian, jit_options=OPTIONS)
def _make_jacobian(n, topology):
    def dense(n, topology):
        return np.empty((2 * n, 2 * n, TILE))

    def sparse(n, topology):
        return Blocks(np.empty((topology.size, TILE)), topology)

    return dense if is_dense(topology) else sparse


@overload(_empty_factors, jit_options=OPTIONS)
def _make_factors(n, topology):
    def dense(n, topology):
        return np.empty((2 * n - 2, 2 * n - 2, TILE))

    def sparse(n, topology):
        return np.empty((topology.size, TILE))

    return dense if is_dense(topology) else sparse


@overload(factorise_free, jit_options=OPTIONS)
def _factorise_free(matrices, topology):
    def dense(matrices, topology):
        copy_from(matrices.jacobian, 2, matrices.free)
        factorise(matrices.free)

    def sparse(matrices, topology):
        matrices.free[:] = matrices.jacobian.values
        factorise_sparse(matrices.free, topology)

    return dense if is_dense(topology) else sparse


@overload(factorise_elastic, jit_options=OPTIONS)
def _factorise_elastic(matrices, topology):
    def dense(matrices, topology):
        copy_from(matrices.jacobian, 2, matrices.free)
        factorise_symmetric(matrices.free)

    def sparse(matrices, topology):
        factorise_free(matrices, topology)

    return dense if is_dense(topology) else sparse


@overload(check_definite, jit_options=OPTIONS)
def _check_definite(matrices, topology, answer):
    def dense(matrices, topology, answer):
        copy_from(matrices.jacobian, 2, matrices.free)
        is_negative_definite(matrices.free, answer)

    def sparse(matrices, topology, answer):
        matrices.free[:] = matrices.jacobian.values
        factorise_sparse(matrices.free, topology)
        has_negative_pivots(matrices.free, topology, answer)

    return dense if is_dense(topology) else sparse


@overload(check_pivots, jit_options=OPTIONS)
def _check_pivots(lu, topology, answer):
    def dense(lu, topology, answer):
        for k in range(TILE):
            answer[k] = True
            for i in range(lu.shape[0]):
                if not lu[i, i, k] < 0.0:
                    answer[k] = False

    def sparse(lu, topology, answer):
        has_negative_pivots(lu, topology, answer)

    return dense if is_dense(topology) else sparse


@overload(keep_factors, jit_options=OPTIONS)
def _keep_factors(lu, target, topology):
    def dense(lu, target, topology):
        copy_from(lu, 0, target)

    def sparse(lu, target, topology):
        for i in range(lu.shape[0]):
            store(load(lu, i), target, i)

    return dense if is_dense(topology) else sparse


@overload(kept_factors, jit_options=OPTIONS)
def _kept_factors(address, topology):
    def dense(address, topology):
        return kept(address, 2 * topology.particles - 2)

    def sparse(address, topology):
        return kept_sparse(address, topology.size, 2 * topology.particles - 2)

    return dense if is_dense(topology) else sparse

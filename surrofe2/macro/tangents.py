"""Tangents of the internal force, assembled and sparse: K = ∂f/∂u and C = ∂f/∂v."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.sparse is loaded where tangents are added up
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.macro.discretisation import N_GAUSS, N_POINTS, Discretisation
from surrofe2.stress_law import StressResponse, Tangents
from surrofe2.tensors import det

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Assembly:
    """Adds up element matrices; unknown 2 a + i is component i of free node a.

    Attributes:
        discretisation: whose.
        size: number of unknowns, 2 n_free.
        kept: (k,) entries of the flattened (n_el, 8, 8) element matrices between free nodes.
        slot: (k,) place of each of them among the stored values, many to one.
        indices, indptr: of the compressed columns.
    """

    discretisation: Discretisation
    size: int
    kept: Index
    slot: Index
    indices: Index
    indptr: Index

    def sum(self, element_matrices: Array) -> scipy.sparse.csc_matrix:
        """Sum of (n_el, 8, 8) element matrices, sparse (2 n_free, 2 n_free)."""
        values = np.bincount(
            self.slot, weights=element_matrices.ravel()[self.kept], minlength=self.indices.size
        )
        return scipy.sparse.csc_matrix(
            (values, self.indices, self.indptr), shape=(self.size, self.size)
        )

    def tangents(
        self, F: Array, response: StressResponse
    ) -> tuple[scipy.sparse.csc_matrix, scipy.sparse.csc_matrix]:
        """K = ∂f/∂u (µN/µm) and C = ∂f/∂v (µN µs/µm) of `internal_force`, (2 n_free, 2 n_free).

        With Δu = Σ_b Δu_b N_b both are Σ w ∇N_a · ∂T/∂F · ∇N_b, T the effective first Piola stress
        of a point, see `effective_tangents`. Neither need be symmetric.

        Args:
            F: (n_points, 2, 2) deformation gradient.
            response: of the stress law there, with tangents.
        """
        if response.tangents is None:
            raise InputError("tangents: the stress law gave none; ask it for them")
        gradients = self.discretisation.gradients
        weighted = self.discretisation.weights[:, :, None, None] * gradients
        matrices = []
        for slope in effective_tangents(F, response.stress, response.tangents):
            # Σ_q w_q ∇N_a,j ∂T_ij/∂F_kl ∇N_b,l, rows (a, i), columns (b, k) of each element.
            slope = slope.reshape(-1, N_POINTS, 2, 2, 2, 2)
            right = np.einsum("eqijkl,eqbl->eqijbk", slope, gradients)
            matrices.append(self.sum(np.einsum("eqaj,eqijbk->eaibk", weighted, right)))
        return matrices[0], matrices[1]


def make_assembly(discretisation: Discretisation) -> Assembly:
    """Where the entries of the element matrices go; made once for a discretisation."""
    size = 2 * len(discretisation.free)
    unknowns = (2 * discretisation.rows[:, :, None] + np.arange(2)).reshape(-1, 8)
    held = np.repeat(discretisation.rows < 0, 2, axis=1)
    row, column = np.broadcast_arrays(unknowns[:, :, None], unknowns[:, None, :])
    kept = np.flatnonzero(~(held[:, :, None] | held[:, None, :]))
    code, slot = np.unique((column * size + row).ravel()[kept], return_inverse=True)
    indptr = np.searchsorted(code, size * np.arange(size + 1))
    return Assembly(discretisation, size, kept, slot, code % size, indptr)


def mass_matrix(discretisation: Discretisation) -> scipy.sparse.csc_matrix:
    """(2 n_free, 2 n_free) consistent mass of both components, ng."""
    mass = discretisation.mass
    of_one = scipy.sparse.kron(mass.along_x, mass.along_y)
    return scipy.sparse.csc_matrix(scipy.sparse.kron(of_one, np.eye(2)))


def factorised(matrix: scipy.sparse.csc_matrix) -> Callable[[Array], Array] | None:
    """matrix⁻¹ applied to (n,) or (n, k); None where the matrix is singular."""
    try:
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(matrix).solve
    except RuntimeError:
        return None
    return solve


def effective_tangents(F: Array, stress: Array, tangents: Tangents) -> tuple[Array, Array]:
    """∂T/∂F and ∂T/∂Ḟ, (n_points, 2, 2, 2, 2), T the part of P that a point contributes.

    The force is Σ w T ∇N with T = J dev(σ) F⁻ᵀ at Gauss points and J tr(σ)/2 F⁻ᵀ at the centre.
    As J tr σ = P : F, the pressure part is T_c = ½ (P : F) F⁻ᵀ, the deviator's P − T_c, and

        ∂T_c,ij/∂F_kl = ½ (P_kl + F_mn ∂P_mn/∂F_kl) F⁻ᵀ_ij − ½ (P : F) F⁻ᵀ_il F⁻ᵀ_kj
        ∂T_c,ij/∂Ḟ_kl = ½ F_mn ∂P_mn/∂Ḟ_kl F⁻ᵀ_ij
    """
    inverse_T = np.asarray(np.linalg.inv(F), dtype=np.float64).transpose(0, 2, 1)
    P = det(F)[:, None, None] * stress @ inverse_T
    work = np.einsum("nij,nij->n", P, F)
    slope = P + np.einsum("nij,nijkl->nkl", F, tangents.P_by_F)
    by_F = 0.5 * np.einsum("nij,nkl->nijkl", inverse_T, slope)
    by_F -= 0.5 * np.einsum("n,nil,nkj->nijkl", work, inverse_T, inverse_T)
    rate_slope = np.einsum("nij,nijkl->nkl", F, tangents.P_by_F_dot)
    by_F_dot = 0.5 * np.einsum("nij,nkl->nijkl", inverse_T, rate_slope)
    gauss = np.arange(len(F)) % N_POINTS < N_GAUSS
    by_F[gauss] = tangents.P_by_F[gauss] - by_F[gauss]
    by_F_dot[gauss] = tangents.P_by_F_dot[gauss] - by_F_dot[gauss]
    return by_F, by_F_dot

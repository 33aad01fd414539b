"""Tangents of all forces, assembled and sparse: K = ∂(f − l)/∂u and C = ∂(f − l)/∂v."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.sparse is loaded where tangents are added up
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.tensors import det
from surrofe2.law.stress_law import StressResponse
from surrofe2.macro.evaluation import Evaluation
from surrofe2.macro.forces import Matrix
from surrofe2.macro.system import System

Array = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Assembly:
    """Adds up element matrices for the m free unknowns of a system.

    Attributes:
        system: whose.
        kept: (k,) entries of the flattened element matrices between free unknowns.
        slot: (k,) place of each of them among the stored values, many to one.
        indices, indptr: of the compressed columns.
    """

    system: System
    kept: Index
    slot: Index
    indices: Index
    indptr: Index

    def sum(self, element_matrices: Array) -> Matrix:
        """Sum of the elements' matrices between their 2 k unknowns, sparse (m, m)."""
        values = np.bincount(
            self.slot, weights=element_matrices.ravel()[self.kept], minlength=self.indices.size
        )
        size = self.system.free.size
        return scipy.sparse.csc_matrix((values, self.indices, self.indptr), shape=(size, size))

    def tangents(self, now: Evaluation) -> tuple[Matrix, Matrix]:
        """K = ∂(f − l)/∂u (µN/µm) and C = ∂(f − l)/∂v (µN µs/µm), (m, m), at an evaluation.

        f is the internal force and l all others. With Δu = Σ_b Δu_b N_b, that of f is
        Σ w ∇N_a · ∂T/∂F · ∇N_b, T the first Piola stress of a point or, in quadrilaterals, the part
        of `effective_tangents`. Neither need be symmetric.
        """
        if now.response.tangents is None:
            raise InputError("tangents: the stress law gave none; ask it for them")
        K, C = self.internal(now.F, now.response)
        free = self.system.free
        for force in self.system.forces:
            slopes = force.slopes(now.t, now.within, now.u, now.v)
            if slopes is not None:
                K, C = (X + Y[free][:, free] for X, Y in zip((K, C), slopes, strict=True))
        return scipy.sparse.csc_matrix(K), scipy.sparse.csc_matrix(C)

    def stiffness_times(self, now: Evaluation, w: Array) -> Array:
        """(m,) ∂(f − l)/∂u w for a displacement w (n, 2) of all rows, those of supports as well."""
        elements = self.system.discretisation.elements
        of_elements = next(self._of_elements(now.F, now.response))
        product, pushed = np.einsum("eaibk,ebk->eai", of_elements, w[elements]), np.zeros(w.shape)
        np.add.at(pushed, elements, product)
        for force in self.system.forces:
            slopes = force.slopes(now.t, now.within, now.u, now.v)
            if slopes is not None:
                pushed += (slopes[0] @ w.ravel()).reshape(w.shape)
        return self.system.pick(pushed)

    def internal(self, F: Array, response: StressResponse) -> tuple[Matrix, Matrix]:
        """The part of the internal force in `tangents`."""
        K, C = (self.sum(matrices) for matrices in self._of_elements(F, response))
        return K, C

    def _of_elements(self, F: Array, response: StressResponse) -> Iterator[Array]:
        """(n_el, k, 2, k, 2) ∂f/∂u of each element, then ∂f/∂v."""
        space = self.system.discretisation
        gradients = space.gradients
        weighted = space.weights[:, :, None, None] * gradients
        assert response.tangents is not None
        slopes = response.tangents.P_by_F, response.tangents.P_by_F_dot
        if space.pressure_apart:
            slopes = effective_tangents(F, response, space.points_per_element)
        for slope in slopes:
            # Σ_q w_q ∇N_a,j ∂T_ij/∂F_kl ∇N_b,l, rows (a, i), columns (b, k) of each element.
            slope = slope.reshape(len(gradients), -1, 2, 2, 2, 2)
            right = np.einsum("eqijkl,eqbl->eqijbk", slope, gradients)
            yield np.einsum("eqaj,eqijbk->eaibk", weighted, right)


def make_assembly(system: System) -> Assembly:
    """Where the entries of the element matrices go; made once for a system."""
    size, elements = system.free.size, system.discretisation.elements
    number = np.full(2 * system.n_rows, -1)
    number[system.free] = np.arange(size)
    unknowns = number[(2 * elements[:, :, None] + np.arange(2)).reshape(len(elements), -1)]
    row, column = np.broadcast_arrays(unknowns[:, :, None], unknowns[:, None, :])
    kept = np.flatnonzero((row >= 0) & (column >= 0))
    code, slot = np.unique((column * size + row).ravel()[kept], return_inverse=True)
    indptr = np.searchsorted(code, size * np.arange(size + 1))
    return Assembly(system, kept, slot, code % size, indptr)


def mass_matrix(system: System) -> Matrix:
    """(m, m) mass between the free unknowns, ng."""
    both = scipy.sparse.csc_matrix(scipy.sparse.kron(system.mass, np.eye(2)))
    return scipy.sparse.csc_matrix(both[system.free][:, system.free])


def factorised(matrix: Matrix) -> Callable[[Array], Array] | None:
    """matrix⁻¹ applied to (n,) or (n, k); None where the matrix is singular."""
    try:
        solve: Callable[[Array], Array] = scipy.sparse.linalg.splu(matrix).solve
    except RuntimeError:
        return None
    return solve


def effective_tangents(
    F: Array, response: StressResponse, points_per_element: int
) -> tuple[Array, Array]:
    """∂T/∂F and ∂T/∂Ḟ, (n_points, 2, 2, 2, 2), T the part of P that a point contributes.

    The force is Σ w T ∇N with T = J dev(σ) F⁻ᵀ at Gauss points and J tr(σ)/2 F⁻ᵀ at the last.
    As J tr σ = P : F, the pressure part is T_c = ½ (P : F) F⁻ᵀ, the deviator's P − T_c, and

        ∂T_c,ij/∂F_kl = ½ (P_kl + F_mn ∂P_mn/∂F_kl) F⁻ᵀ_ij − ½ (P : F) F⁻ᵀ_il F⁻ᵀ_kj
        ∂T_c,ij/∂Ḟ_kl = ½ F_mn ∂P_mn/∂Ḟ_kl F⁻ᵀ_ij
    """
    tangents, stress = response.tangents, response.stress
    assert tangents is not None
    inverse_T = np.asarray(np.linalg.inv(F), dtype=np.float64).transpose(0, 2, 1)
    P = det(F)[:, None, None] * stress @ inverse_T
    work = np.einsum("nij,nij->n", P, F)
    slope = P + np.einsum("nij,nijkl->nkl", F, tangents.P_by_F)
    by_F = 0.5 * np.einsum("nij,nkl->nijkl", inverse_T, slope)
    by_F -= 0.5 * np.einsum("n,nil,nkj->nijkl", work, inverse_T, inverse_T)
    rate_slope = np.einsum("nij,nijkl->nkl", F, tangents.P_by_F_dot)
    by_F_dot = 0.5 * np.einsum("nij,nkl->nijkl", inverse_T, rate_slope)
    gauss = np.arange(len(F)) % points_per_element < points_per_element - 1
    by_F[gauss] = tangents.P_by_F[gauss] - by_F[gauss]
    by_F_dot[gauss] = tangents.P_by_F_dot[gauss] - by_F_dot[gauss]
    return by_F, by_F_dot

"""Tangents of all forces, assembled and sparse: K = ∂(f − l)/∂u and C = ∂(f − l)/∂v."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import scipy  # scipy.sparse is loaded where tangents are added up
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.law.stress_law import StressResponse, Tangents
from surrofe2.macro.equations_of_motion import Evaluation
from surrofe2.macro.forces import Matrix, Slopes
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

        f is the internal force and l all others. Neither need be symmetric.
        """
        tangents = _tangents(now.response)
        stress = now.response.first_piola(now.F)
        K = self.sum(self.of_elements(now.F, stress, tangents.P_by_F))
        C = self.sum(self.of_elements(now.F, 0.0 * stress, tangents.P_by_F_dot))
        for k_force, c_force in self._of_forces(now):
            K, C = K + self._free(k_force), C + self._free(c_force)
        return K, C

    def over_step(self, now: Evaluation, dt: float) -> Matrix:
        """K + C/dt of `tangents`, at about half the cost."""
        slope, P = _tangents(now.response).over_step(dt), now.response.first_piola(now.F)
        total = self.sum(self.of_elements(now.F, P, slope))
        for k_force, c_force in self._of_forces(now):
            total = total + self._free(k_force + c_force / dt)
        return total

    def stiffness_times(self, now: Evaluation, w: Array) -> Array:
        """(m,) ∂(f − l)/∂u w for a displacement w (n, 2) of all rows, those of supports as well."""
        elements, P = self.system.discretisation.elements, now.response.first_piola(now.F)
        blocks = self.of_elements(now.F, P, _tangents(now.response).P_by_F)
        product, pushed = np.einsum("eaibk,ebk->eai", blocks, w[elements]), np.zeros(w.shape)
        np.add.at(pushed, elements, product)
        for k_force, _ in self._of_forces(now):
            pushed += (k_force @ w.ravel()).reshape(w.shape)
        return self.system.pick(pushed)

    def of_elements(self, F: Array, P: Array, slope: Array) -> Array:
        """(n_el, k, 2, k, 2) Σ w ∇N_a · ∂T/∂F · ∇N_b of each element.

        T is the first Piola stress of a point or, in quadrilaterals, its part that
        `effective_tangents` has.

        Args:
            P, slope: (n_points, 2, 2) stress, (n_points, 2, 2, 2, 2) ∂P/∂F; or 0 and ∂P/∂Ḟ.
        """
        space = self.system.discretisation
        gradients = space.gradients
        weighted = space.weights[:, :, None, None] * gradients
        if space.pressure_apart:
            slope = effective_tangents(F, P, slope, space.points_per_element)
        # Σ_q w_q ∇N_a,j ∂T_ij/∂F_kl ∇N_b,l, rows (a, i), columns (b, k) of each element.
        slope = slope.reshape(len(gradients), -1, 2, 2, 2, 2)
        right = np.einsum("eqijkl,eqbl->eqijbk", slope, gradients)
        return np.einsum("eqaj,eqijbk->eaibk", weighted, right)

    def _of_forces(self, now: Evaluation) -> Iterator[Slopes]:
        for force in self.system.forces:
            slopes = force.slopes(now.t, now.within, now.u, now.v)
            if slopes is not None:
                yield slopes

    def _free(self, matrix: Matrix) -> Matrix:
        """(m, m) of (2 n, 2 n)."""
        free = self.system.free
        return scipy.sparse.csc_matrix(matrix[free][:, free])


def _tangents(response: StressResponse) -> Tangents:
    if response.tangents is None:
        raise InputError("tangents: the stress law gave none; ask it for them")
    return response.tangents


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


def effective_tangents(F: Array, P: Array, slope: Array, points_per_element: int) -> Array:
    """∂T/∂F (n_points, 2, 2, 2, 2), T the part of P that a point contributes; arguments as of
    `Assembly.of_elements`.

    The force is Σ w T ∇N with T = J dev(σ) F⁻ᵀ at Gauss points and J tr(σ)/2 F⁻ᵀ at the last.
    As J tr σ = P : F, the pressure part is T_c = ½ (P : F) F⁻ᵀ, the deviator's P − T_c, and

        ∂T_c,ij/∂F_kl = ½ (P_kl + F_mn ∂P_mn/∂F_kl) F⁻ᵀ_ij − ½ (P : F) F⁻ᵀ_il F⁻ᵀ_kj
        ∂T_c,ij/∂Ḟ_kl = ½ F_mn ∂P_mn/∂Ḟ_kl F⁻ᵀ_ij
    """
    inverse_T = np.asarray(np.linalg.inv(F), dtype=np.float64).transpose(0, 2, 1)
    of_work = P + np.einsum("nij,nijkl->nkl", F, slope)
    parts = 0.5 * np.einsum("nij,nkl->nijkl", inverse_T, of_work)
    work = np.einsum("nij,nij->n", P, F)
    parts -= 0.5 * np.einsum("n,nil,nkj->nijkl", work, inverse_T, inverse_T)
    gauss = np.arange(len(F)) % points_per_element < points_per_element - 1
    parts[gauss] = slope[gauss] - parts[gauss]
    return parts

"""From motion to deformation gradients, and from stresses to forces, element by element.

The macro scale goes through all elements; a law that goes from motion to forces at once, block by
block. Both do it by these kernels, so they agree to the bit. Points are numbered n_q e + q.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.compilation import kernel

Array = NDArray[np.float64]


class ElementArrays(NamedTuple):
    """Finite elements as kernels read them; see `macro.discretisation`.

    Attributes:
        elements: (n_el, k) rows of each element's nodes in what nodes have, k = 4 or 6.
        gradients: (n_el, n_q, k, 2) reference gradients ∇N, 1/µm.
        weights: (n_el, n_q) reference areas, µm².
    """

    elements: NDArray[np.int64]
    gradients: Array
    weights: Array

    def part(self, own: slice | NDArray[np.intp]) -> ElementArrays:
        """Those of some elements."""
        return ElementArrays(self.elements[own], self.gradients[own], self.weights[own])


@kernel
def set_deformation(first: Any, space: Any, u: Any, v: Any, F: Any, F_dot: Any) -> Any:
    """Set F = I + Σ_a u_a ⊗ ∇N_a and Ḟ = Σ_a v_a ⊗ ∇N_a of as many elements as there is room for.

    Args:
        first: number of the first element.
        u, v: (n, 2).
        F, F_dot: (n_q m, 2, 2) of m elements.
    """
    elements, gradients = space.elements, space.gradients
    n_q, k = gradients.shape[1], gradients.shape[2]
    nodal = np.zeros((k, 4))
    for e in range(F.shape[0] // n_q):
        for a in range(k):
            row = elements[first + e, a]
            for i in range(2):
                nodal[a, i] = u[row, i]
                nodal[a, 2 + i] = v[row, i]
        for q in range(n_q):
            p = n_q * e + q
            xx, xy, yx, yy, vxx, vxy, vyx, vyy = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            for a in range(k):
                gx, gy = gradients[first + e, q, a, 0], gradients[first + e, q, a, 1]
                xx += nodal[a, 0] * gx
                xy += nodal[a, 0] * gy
                yx += nodal[a, 1] * gx
                yy += nodal[a, 1] * gy
                vxx += nodal[a, 2] * gx
                vxy += nodal[a, 2] * gy
                vyx += nodal[a, 3] * gx
                vyy += nodal[a, 3] * gy
            F[p, 0, 0], F[p, 0, 1], F[p, 1, 0], F[p, 1, 1] = xx + 1.0, xy, yx, yy + 1.0
            F_dot[p, 0, 0], F_dot[p, 0, 1], F_dot[p, 1, 0], F_dot[p, 1, 1] = vxx, vxy, vyx, vyy


@kernel
def set_forces(first: Any, space: Any, F: Any, stress: Any, forces: Any) -> None:
    """Set f_a = Σ_Gauss J w dev(σ) F⁻ᵀ∇N_a + Σ_last J w tr(σ)/2 F⁻ᵀ∇N_a of each element.

    Of triangles Σ_Gauss J w σ F⁻ᵀ∇N_a. J F⁻ᵀ is the cofactor of F, so nothing is divided.

    Args:
        first: number of the first element.
        F, stress: (n_q m, 2, 2) of m elements.
        forces: (m, k, 2), µN.
    """
    n_q = space.gradients.shape[1]
    for e in range(forces.shape[0]):
        forces[e] = 0.0
        for q in range(n_q):
            p = n_q * e + q
            add_force(first + e, q, space, F[p], stress[p], forces[e])


@kernel
def add_force(e: Any, q: Any, space: Any, F: Any, stress: Any, force: Any) -> None:
    """Add what a point of element e contributes to the force (k, 2) on its nodes."""
    n_q, k = space.gradients.shape[1], space.gradients.shape[2]
    s00, s01, s10, s11 = stress[0, 0], stress[0, 1], stress[1, 0], stress[1, 1]
    if k == 4:
        pressure = 0.5 * (s00 + s11)
        if q < n_q - 1:
            s00, s11 = s00 - pressure, s11 - pressure
        else:
            s00, s11, s01, s10 = pressure, pressure, 0.0, 0.0
    w = space.weights[e, q]
    c00, c01, c10, c11 = F[1, 1], -F[1, 0], -F[0, 1], F[0, 0]
    p00, p01 = w * (s00 * c00 + s01 * c10), w * (s00 * c01 + s01 * c11)
    p10, p11 = w * (s10 * c00 + s11 * c10), w * (s10 * c01 + s11 * c11)
    for a in range(k):
        gx, gy = space.gradients[e, q, a, 0], space.gradients[e, q, a, 1]
        force[a, 0] += p00 * gx + p01 * gy
        force[a, 1] += p10 * gx + p11 * gy


@kernel
def add_at_nodes(elements: Any, forces: Any, total: Any) -> Any:
    """Add forces (n_el, k, 2) on the nodes of elements to `total` (n, 2), in their order."""
    for e in range(elements.shape[0]):
        for a in range(elements.shape[1]):
            row = elements[e, a]
            total[row, 0] += forces[e, a, 0]
            total[row, 1] += forces[e, a, 1]
    return total


def deformation_of_points(
    points: NDArray[np.intp], space: ElementArrays, u: Array, v: Array
) -> tuple[Array, Array]:
    """F and Ḟ (m, 2, 2) of some points, as `set_deformation` sets them."""
    _, some, rows = _around(points, space)
    F = np.empty((some.weights.size, 2, 2))
    F_dot = np.empty_like(F)
    set_deformation(0, some, u, v, F, F_dot)
    return F[rows], F_dot[rows]


def add_forces_of_points(
    points: NDArray[np.intp], space: ElementArrays, F: Array, stress: Array, forces: Array
) -> None:
    """Add to forces (n_el, k, 2) what some points contribute, F and stress (m, 2, 2) of these."""
    places, some, rows = _around(points, space)
    at, by = np.zeros((2, some.weights.size, 2, 2))
    at[rows], by[rows] = F, stress
    added = np.empty((*some.elements.shape, 2))
    set_forces(0, some, at, by, added)
    forces[places] += added


def _around(
    points: NDArray[np.intp], space: ElementArrays
) -> tuple[NDArray[np.intp], ElementArrays, NDArray[np.intp]]:
    """Elements that have some of the points, their arrays, and the points' numbers among theirs."""
    n_q = space.weights.shape[1]
    places = np.unique(points // n_q)
    return places, space.part(places), n_q * np.searchsorted(places, points // n_q) + points % n_q

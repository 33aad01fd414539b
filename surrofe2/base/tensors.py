"""Second-order tensors in the plane, points first, and the seven numbers a stress depends on.

With the polar decomposition F = R U and A = RᵀḞ a stress law without rotations is σ = R S Rᵀ, S a
function of

    x = (sum, difference, shear of U − I;  sum, difference, shear, spin of A)

where sum is T₁₁ + T₂₂, difference T₁₁ − T₂₂, shear T₁₂ + T₂₁ and spin T₂₁ − T₁₂.

The error of a Cauchy stress is the Frobenius norm of its difference from the exact one, µN/µm. It
does not change when both are rotated. Tolerances are shares of the spread of the stress.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, shortened

# Length of x, the inputs.
INPUTS = 7


def det(F: Array) -> Array:
    """Return the determinants (n,)."""
    return F[:, 0, 0] * F[:, 1, 1] - F[:, 0, 1] * F[:, 1, 0]


def transpose(F: Array) -> Array:
    """Return the transposes (n, 2, 2)."""
    return np.swapaxes(F, -1, -2)


def rotation(F: Array) -> Array:
    """Return R of the polar decomposition F = R U, for det F > 0.

    In the plane its angle has the tangent (F₂₁ − F₁₂)/(F₁₁ + F₂₂).
    """
    cosine = F[:, 0, 0] + F[:, 1, 1]
    sine = F[:, 1, 0] - F[:, 0, 1]
    length = np.sqrt(cosine**2 + sine**2)
    R = np.empty_like(F)
    R[:, 0, 0] = cosine / length
    R[:, 1, 1] = cosine / length
    R[:, 1, 0] = sine / length
    R[:, 0, 1] = -R[:, 1, 0]
    return R


def unrotated(F: Array, F_dot: Array) -> tuple[Array, Array, Array]:
    """Return (U, A, R) of F = R U and Ḟ = R A, (n, 2, 2) each."""
    R = rotation(F)
    return transpose(R) @ F, transpose(R) @ F_dot, R


def to_components(T: Array) -> Array:
    """Return sum, difference, shear and spin of T (…, 2, 2), as (…, 4)."""
    xx = T[..., 0, 0]
    xy = T[..., 0, 1]
    yx = T[..., 1, 0]
    yy = T[..., 1, 1]
    return np.stack([xx + yy, xx - yy, xy + yx, yx - xy], axis=-1)


def from_components(components: Array) -> Array:
    """Return T (…, 2, 2) by its sum, difference, shear and spin (…, 4)."""
    total, difference, shear, spin = (components[..., k] for k in range(4))
    T = np.stack([total + difference, shear - spin, shear + spin, total - difference], axis=-1)
    return 0.5 * T.reshape(*T.shape[:-1], 2, 2)


def to_inputs(F: Array, F_dot: Array) -> tuple[Array, Array]:
    """Return (x (n, 7), R (n, 2, 2)) of F and Ḟ, rates in 1/µs."""
    U, A, R = unrotated(F, F_dot)
    return np.concatenate([to_components(U - np.eye(2))[:, :3], to_components(A)], axis=1), R


def from_inputs(x: Array, R: Array) -> tuple[Array, Array]:
    """Return F = R U and Ḟ = R A, (n, 2, 2) each; the inverse of `to_inputs`."""
    stretch = np.concatenate([x[:, :3], np.zeros((len(x), 1))], axis=1)
    return R @ (np.eye(2) + from_components(stretch)), R @ from_components(x[:, 3:])


def stress_error(stress: Array, true: Array) -> Array:
    """Return the Frobenius norm (n,) of stress − true, (n, 2, 2) each, µN/µm; NaN if either is."""
    difference: Array = np.sqrt(((stress - true) ** 2).sum(axis=(1, 2)))
    return difference


def stress_spread(stress: Array) -> float:
    """Return the RMS of the Frobenius norm of σ − mean σ, σ (n, 2, 2), n ≥ 1, µN/µm."""
    return float(np.sqrt(((stress - stress.mean(axis=0)) ** 2).sum(axis=(1, 2)).mean()))


def cofactor(F: Array) -> Array:
    """Return J F⁻ᵀ of F (n, 2, 2)."""
    result = np.empty_like(F)
    result[:, 0, 0] = F[:, 1, 1]
    result[:, 0, 1] = -F[:, 1, 0]
    result[:, 1, 0] = -F[:, 0, 1]
    result[:, 1, 1] = F[:, 0, 0]
    return result


def check_arrays(
    what: str, arrays: Mapping[str, Array], shapes: Mapping[str, tuple[int, ...]]
) -> None:
    """Reject float64 arrays that are missing, unknown or of another shape.

    Raises:
        InputError: naming the first such array.
    """
    for name in (*arrays, *shapes):
        if name not in arrays or name not in shapes:
            problem = "unknown" if name in arrays else "missing"
            raise InputError(f"{what}.{shortened(name, 60)}: {problem}")
        values = arrays[name]
        if values.shape != shapes[name] or values.dtype != np.float64:
            raise InputError(
                f"{what}.{name}: {values.dtype} of shape {values.shape}; it must be float64 of "
                f"{shapes[name]}"
            )

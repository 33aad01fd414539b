"""What the compiled pass does before and after the network; layout and names as in `compiled`.

The rotation is taken out of a block of points and their inputs are scaled; the answer is turned to
Cauchy stress and the rotation put back. Rows of the frame: 0 to 3 F, then A = RᵀḞ; 4 to 7 Ḟ; 8, 9
cos and sin of R; 10 to 12 U₁₁, U₁₂, U₂₂; 13 to 16 components of the stress, then σ.
"""

from __future__ import annotations

import numpy as np

from surrofe2.compilation import kernel
from surrofe2.surrogate.lanes import BLOCK
from surrofe2.tensors import INPUTS

FRAME_ROWS = 17
_ONE = INPUTS  # row of x that holds ones


@kernel
def read_points(start, F, F_dot, frame):  # type: ignore[no-untyped-def]
    """Rows 0 to 3: F, rows 4 to 7: Ḟ; behind the last point it is repeated."""
    for p in range(BLOCK):
        point = min(start + p, F.shape[0] - 1)
        for i in range(2):
            for j in range(2):
                frame[2 * i + j, p] = F[point, i, j]
                frame[4 + 2 * i + j, p] = F_dot[point, i, j]


@kernel
def take_rotation_out(frame):  # type: ignore[no-untyped-def]
    """Rows 8, 9: cos and sin of R; rows 10 to 12: U₁₁, U₁₂, U₂₂; rows 0 to 3: A = RᵀḞ."""
    for p in range(BLOCK):
        xx, xy, yx, yy = frame[0, p], frame[1, p], frame[2, p], frame[3, p]
        along, across = xx + yy, yx - xy
        length = 1.0 / np.sqrt(along * along + across * across)
        c, s = along * length, across * length
        frame[8, p] = c
        frame[9, p] = s
        frame[10, p] = c * xx + s * yx
        frame[11, p] = c * xy + s * yy
        frame[12, p] = c * yy - s * xy
        vxx, vxy, vyx, vyy = frame[4, p], frame[5, p], frame[6, p], frame[7, p]
        frame[0, p] = c * vxx + s * vyx
        frame[1, p] = c * vxy + s * vyy
        frame[2, p] = c * vyx - s * vxx
        frame[3, p] = c * vyy - s * vxy


@kernel
def scale_inputs(frame, factor, x):  # type: ignore[no-untyped-def]
    """The inputs of `tensors`, scaled, and a row of ones."""
    for p in range(BLOCK):
        x[0, p] = ((frame[10, p] - 1.0) + (frame[12, p] - 1.0)) * factor[0]
        x[1, p] = (frame[10, p] - frame[12, p]) * factor[1]
        x[2, p] = 2.0 * frame[11, p] * factor[2]
        x[3, p] = (frame[0, p] + frame[3, p]) * factor[3]
        x[4, p] = (frame[0, p] - frame[3, p]) * factor[4]
        x[5, p] = (frame[1, p] + frame[2, p]) * factor[5]
        x[6, p] = (frame[2, p] - frame[1, p]) * factor[6]
        x[_ONE, p] = 1.0


@kernel
def turn_to_cauchy(y, frame):  # type: ignore[no-untyped-def]
    """Rows 13 to 16: components of S = P̂ U/det U."""
    for p in range(BLOCK):
        t, d, g = frame[10, p] + frame[12, p], frame[10, p] - frame[12, p], 2.0 * frame[11, p]
        factor = 2.0 / (t * t - d * d - g * g)
        frame[13, p] = factor * (t * y[0, p] + d * y[1, p] + g * y[2, p])
        frame[14, p] = factor * (d * y[0, p] + t * y[1, p] - g * y[3, p])
        frame[15, p] = factor * (g * y[0, p] + t * y[2, p] + d * y[3, p])
        frame[16, p] = factor * (t * y[3, p] - g * y[1, p] + d * y[2, p])


@kernel
def put_rotation_back(frame):  # type: ignore[no-untyped-def]
    """Rows 13 to 16: σ₁₁, σ₁₂, σ₂₁, σ₂₂; R turns (difference, shear) by twice its angle."""
    for p in range(BLOCK):
        c, s = frame[8, p], frame[9, p]
        c2, s2 = c * c - s * s, 2.0 * c * s
        total, spin = frame[13, p], frame[16, p]
        difference = c2 * frame[14, p] - s2 * frame[15, p]
        shear = s2 * frame[14, p] + c2 * frame[15, p]
        frame[13, p] = 0.5 * (total + difference)
        frame[14, p] = 0.5 * (shear - spin)
        frame[15, p] = 0.5 * (shear + spin)
        frame[16, p] = 0.5 * (total - difference)

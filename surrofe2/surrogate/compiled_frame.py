"""What the compiled pass does before and after the network: rotations, inputs, Cauchy stress.

Points are taken in blocks of `TILES` tiles (an even number) of `TILE` points; every quantity is a
row of a block, (TILES, TILE), and each operation is one of SIMD values of `base.simd`. Rows of
the frame of a block: components of F and Ḟ, cos and sin of R, U, A = RᵀḞ, whether the point is
within the range (1 or 0), and the stress. Sums of SIMD values keep their order, so the bits of an
answer do not depend on the place of its point in a block.
"""

from __future__ import annotations

from surrofe2.base.compilation import kernel
from surrofe2.base.simd import TILE, load, root, store, where_less
from surrofe2.base.tensors import INPUTS

TILES = 6
BLOCK = TILES * TILE
"""Points of a block."""

F11, F12, F21, F22, V11, V12, V21, V22 = range(8)  # V: Ḟ
COS, SIN, U11, U12, U22, A11, A12, A21, A22, INSIDE, S11, S12, S21, S22 = range(8, 22)
FRAME_ROWS = 22
ONE = INPUTS
"""Row of scaled inputs that holds ones."""


@kernel
def read_points(start, F, F_dot, frame):  # type: ignore[no-untyped-def]
    """The rows of F and Ḟ; behind the last point it is repeated."""
    for p in range(BLOCK):
        point = min(start + p, F.shape[0] - 1)
        t, lane = p // TILE, p % TILE
        frame[F11, t, lane], frame[F12, t, lane] = F[point, 0, 0], F[point, 0, 1]
        frame[F21, t, lane], frame[F22, t, lane] = F[point, 1, 0], F[point, 1, 1]
        frame[V11, t, lane], frame[V12, t, lane] = F_dot[point, 0, 0], F_dot[point, 0, 1]
        frame[V21, t, lane], frame[V22, t, lane] = F_dot[point, 1, 0], F_dot[point, 1, 1]


@kernel
def take_rotation_out(frame):  # type: ignore[no-untyped-def]
    """The rows of R, U and A from those of F and Ḟ."""
    for t in range(TILES):
        xx, xy = load(frame, F11, t), load(frame, F12, t)
        yx, yy = load(frame, F21, t), load(frame, F22, t)
        along, across = xx + yy, yx - xy
        length = 1.0 / root(along * along + across * across)
        c, s = along * length, across * length
        store(c, frame, COS, t)
        store(s, frame, SIN, t)
        store(c * xx + s * yx, frame, U11, t)
        store(c * xy + s * yy, frame, U12, t)
        store(c * yy - s * xy, frame, U22, t)
        xx, xy = load(frame, V11, t), load(frame, V12, t)
        yx, yy = load(frame, V21, t), load(frame, V22, t)
        store(c * xx + s * yx, frame, A11, t)
        store(c * xy + s * yy, frame, A12, t)
        store(c * yx - s * xx, frame, A21, t)
        store(c * yy - s * xy, frame, A22, t)


@kernel
def set_inside(frame, bounds):  # type: ignore[no-untyped-def]
    """Set `INSIDE` to 1 where low < U₁₁, U₂₂ < high, |U₁₂| < shear and |A| < rate, else 0.

    bounds: (4,) low, high, shear, rate. What is not a number is outside.
    """
    low, high, shear, rate = bounds[0], bounds[1], bounds[2], bounds[3]
    for t in range(TILES):
        inside = where_less(low, load(frame, U11, t), 1.0, 0.0)
        inside = where_less(load(frame, U11, t), high, inside, 0.0)
        inside = where_less(low, load(frame, U22, t), inside, 0.0)
        inside = where_less(load(frame, U22, t), high, inside, 0.0)
        inside = _where_within(load(frame, U12, t), shear, inside)
        for row in range(A11, A22 + 1):
            inside = _where_within(load(frame, row, t), rate, inside)
        store(inside, frame, INSIDE, t)


@kernel
def _where_within(value, bound, inside):  # type: ignore[no-untyped-def]
    return where_less(-bound, value, where_less(value, bound, inside, 0.0), 0.0)


@kernel
def scale_inputs(frame, factor, x):  # type: ignore[no-untyped-def]
    """The inputs of `tensors`, scaled, (7, TILES, TILE), and a row of ones."""
    for t in range(TILES):
        u11, u22 = load(frame, U11, t), load(frame, U22, t)
        a11, a12 = load(frame, A11, t), load(frame, A12, t)
        a21, a22 = load(frame, A21, t), load(frame, A22, t)
        store(((u11 - 1.0) + (u22 - 1.0)) * factor[0], x, 0, t)
        store((u11 - u22) * factor[1], x, 1, t)
        store(load(frame, U12, t) * (2.0 * factor[2]), x, 2, t)
        store((a11 + a22) * factor[3], x, 3, t)
        store((a11 - a22) * factor[4], x, 4, t)
        store((a12 + a21) * factor[5], x, 5, t)
        store((a21 - a12) * factor[6], x, 6, t)
        store(1.0, x, ONE, t)


@kernel
def set_stress(y, frame):  # type: ignore[no-untyped-def]
    """The rows of σ from the components of P̂ in rows 0 to 3 of y.

    S = P̂ U/det U; R turns its difference and shear by twice its angle.
    """
    for t in range(TILES):
        u11, u22 = load(frame, U11, t), load(frame, U22, t)
        n, d, g = u11 + u22, u11 - u22, 2.0 * load(frame, U12, t)
        total, difference, shear, spin = load(y, 0, t), load(y, 1, t), load(y, 2, t), load(y, 3, t)
        factor = 1.0 / (n * n - d * d - g * g)
        s = factor * (n * total + d * difference + g * shear)
        by_d = factor * (d * total + n * difference - g * spin)
        by_g = factor * (g * total + n * shear + d * spin)
        w = factor * (n * spin - g * difference + d * shear)
        cos, sin = load(frame, COS, t), load(frame, SIN, t)
        c2, s2 = cos * cos - sin * sin, 2.0 * cos * sin
        turned_d, turned_g = c2 * by_d - s2 * by_g, s2 * by_d + c2 * by_g
        store(s + turned_d, frame, S11, t)
        store(turned_g - w, frame, S12, t)
        store(turned_g + w, frame, S21, t)
        store(s - turned_d, frame, S22, t)

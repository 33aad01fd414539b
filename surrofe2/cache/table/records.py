"""Records of a table: linear models of the stress, each with its ellipsoid of accuracy.

A record says S(x) ≈ s₀ + G (x − x₀), x the seven inputs of `tensors` and S of the four components
sum, difference, shear and spin; |S| = √(s·s/2) is its Frobenius norm. Its error is bounded by

    bound(x) = dᵀ C d,    d = x − x₀,

with the record's curvature C (symmetric, positive definite), and the ellipsoid of accuracy for a
tolerance is where bound ≤ tolerance; ISAT keeps M = C/tolerance (Pope 1997, section 3.2).

Growing is like ISAT's (section 3.3): where the linear model of a near record is right at a point
outside its ellipsoid or near its surface, the ellipsoid grows along the point p until that is well
inside. In the metric of the ellipsoid that is a change of rank one:

    C ← C + (target − b)/b² (C p)(C p)ᵀ,    b = pᵀ C p,    so that pᵀ C p becomes `target`.

Shrinking is the same with a larger target: the error that was seen, and a margin.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array, Index
from surrofe2.base.compilation import kernel
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS
from surrofe2.base.tensors import INPUTS, from_components, to_components, transpose

OUTPUTS = 4  # components of a stress


class Records(NamedTuple):
    """n records.

    Attributes:
        centre: (n, 7) x₀, 1 and 1/µs.
        stress: (n, 4) s₀, µN/µm.
        slope: (n, 4, 7) G = ∂s/∂x.
        curvature: (n, 7, 7) C.
    """

    centre: Array
    stress: Array
    slope: Array
    curvature: Array

    def take(self, index: Index) -> Records:
        """Return those of the records that an index array chooses."""
        return Records(*(part[index] for part in self))


NO_RECORDS = Records(
    np.empty((0, INPUTS)),
    np.empty((0, OUTPUTS)),
    np.empty((0, OUTPUTS, INPUTS)),
    np.empty((0, INPUTS, INPUTS)),
)


def curvature_from_slopes(slope: Array, probed: Array, step: Array, reach: Array) -> Array:
    """Compute the curvature C from the change of exact slopes around a record.

    Args:
        slope: (n, 4, 7) slopes G at the centre.
        probed: (n, 7, 4, 7) slopes at x₀ + step along each input in turn.
        step: (7,) length of the step along each input.
        reach: (7,) units of the inputs, in which squares of different inputs are added up.

    Returns:
        (n, 7, 7). With the second derivatives H_k of the four components, the error is
        |½ (dᵀ H_k d)_k| in the Frobenius norm, which ½ dᵀ (½ Σ H_k²)^½ d follows closely (exactly
        where the H_k commute).
    """
    second = (probed - slope[:, None]) / step[:, None, None]  # [n, along, k, of]
    second = np.moveaxis(second, 1, 3) * reach[:, None] * reach
    second = 0.5 * (second + np.swapaxes(second, 2, 3))
    squares = 0.5 * (second @ second).sum(axis=1)
    size, axes = np.linalg.eigh(squares)
    root = axes * np.sqrt(np.maximum(size, 0.0))[:, None] @ np.swapaxes(axes, 1, 2)
    return 0.5 * root / (reach[:, None] * reach)


def curvature_from_constant(slope: Array, tolerance: float) -> Array:
    """Compute a curvature C (n, 7, 7) by which the stress changes by at most the tolerance.

    It is ISAT's first, conservative ellipsoid (Pope 1997, section 3.3), from the slopes (n, 4, 7)
    alone: within it even a constant stress would be right.
    """
    return 0.5 * np.swapaxes(slope, 1, 2) @ slope / tolerance


def input_slopes(R: Array, by_F: Array, by_F_dot: Array) -> Array:
    """Compute ∂s/∂x (n, 4, 7) from ∂σ/∂F and ∂σ/∂Ḟ, (n, 2, 2, 2, 2) each.

    A change of x at fixed R (n, 2, 2) changes F by R δU and Ḟ by R δA, and σ by R δS Rᵀ.
    """
    directions = from_components(np.eye(OUTPUTS))
    stretch = np.einsum("nabcd,nck,jkd->njab", by_F, R, directions[:3])
    rate = np.einsum("nabcd,nck,jkd->njab", by_F_dot, R, directions)
    turned = np.concatenate([stretch, rate], axis=1)
    slopes = to_components((transpose(R)[:, None] @ turned @ R[:, None]).reshape(-1, 2, 2))
    return np.swapaxes(slopes.reshape(-1, INPUTS, OUTPUTS), 1, 2)


class Rule(NamedTuple):
    """A rule when ellipsoids grow and shrink; bounds and errors as fractions of the tolerance.

    Attributes:
        reach: an ellipsoid grows to a point only where its bound there is at most this,
        growing: and the error there at most this, for the same is then claimed of the opposite
            point, and of those between;
        grown: it grows so far that its bound there is this, below 1, since a cache takes a point
            back only well within an ellipsoid.
        shrinking: errors above the bound are tolerated up to this.
        margin: a shrunk ellipsoid bounds so many times the error that was observed.
    """

    reach: float = 2.0
    growing: float = 0.4
    grown: float = 0.56
    shrinking: float = 0.7
    margin: float = 1.5


RULE = Rule()
NO_GROWTH = Rule(reach=1.0, growing=-1.0)  # no error is below 0
# A record within so small a fraction of the tolerance of another, by its bound, adds nothing.
SAME = 0.01


@kernel
def update_ellipsoids(x, s, images, records, tolerance, rule):  # type: ignore[no-untyped-def]
    """Grow and shrink the ellipsoids of records, in place, by m RVE answers.

    Args:
        x: (m, 7) inputs of the answers.
        s: (m, 4) components of their stress.
        images: 4 with the symmetry D4, 1 without.
        tolerance: µN/µm.
        rule: when to grow and when to shrink.

    Returns:
        (m,) whether an ellipsoid holds each answer now; how many have grown, and shrunk.
    """
    covered = np.zeros(x.shape[0], dtype=np.bool_)
    grown = 0
    shrunk = 0
    reach = rule.reach * tolerance
    p = np.empty(INPUTS)
    candidate = np.empty(INPUTS)
    for point in range(x.shape[0]):
        nearest = -1  # the record that may grow to this point; none yet
        least = reach
        within = False
        for k in range(records.centre.shape[0]):
            for flips in range(images):
                for i in range(INPUTS):
                    p[i] = x[point, i] * INPUT_SIGNS[flips, i] - records.centre[k, i]
                bound = _quadratic(p, records.curvature[k])
                if bound > reach:
                    continue
                error = _error(p, s[point], flips, records.stress[k], records.slope[k])
                if bound <= tolerance and error > max(bound, rule.shrinking * tolerance):
                    shrunk += 1
                    set_bound(p, rule.margin * error, records.curvature[k])
                    bound = rule.margin * error
                elif bound <= rule.grown * tolerance:
                    within = True
                elif error <= rule.growing * tolerance and bound < least:
                    nearest = k
                    least = bound
                    candidate[:] = p
                covered[point] |= bound <= tolerance
        if nearest >= 0 and not within:
            grown += 1
            set_bound(candidate, rule.grown * tolerance, records.curvature[nearest])
            covered[point] = True
    return covered, grown, shrunk


@kernel
def _quadratic(d, matrix):  # type: ignore[no-untyped-def]
    """Compute dᵀ M d."""
    total = 0.0
    for i in range(INPUTS):
        row = 0.0
        for j in range(INPUTS):
            row += matrix[i, j] * d[j]
        total += row * d[i]
    return total


@kernel
def _error(p, s, flips, stress, slope):  # type: ignore[no-untyped-def]
    """Compute the error of a linear model against an RVE's answer s, in the Frobenius norm.

    Args:
        p: (7,) distance of the answer's image `flips` from the record's centre.
    """
    total = 0.0
    for k in range(OUTPUTS):
        answer = stress[k]
        for i in range(INPUTS):
            answer += slope[k, i] * p[i]
        total += (answer - s[k] * COMPONENT_SIGNS[flips, k]) ** 2
    return np.sqrt(0.5 * total)


@kernel
def set_bound(p, target, curvature):  # type: ignore[no-untyped-def]
    """Change C (7, 7) by rank one, in place, so that pᵀ C p becomes `target`."""
    pull = np.zeros(INPUTS)
    bound = 0.0
    for i in range(INPUTS):
        for j in range(INPUTS):
            pull[i] += curvature[i, j] * p[j]
        bound += pull[i] * p[i]
    if bound <= 0.0:
        return
    factor = (target - bound) / (bound * bound)
    for i in range(INPUTS):
        for j in range(INPUTS):
            curvature[i, j] += factor * pull[i] * pull[j]


def merged(first: Records, second: Records, tolerance: float, images: int) -> Records:
    """Join two sets of records, without those of the second that the first has, too.

    The stress at each centre is an RVE's, and shrinks every ellipsoid that is wrong there.
    `tolerance` is in µN/µm.
    """
    is_new = []
    for centre in second.centre:
        away = centre - first.centre
        bounds = np.einsum("ni,nij,nj->n", away, first.curvature, away)
        is_new.append(not (bounds <= SAME * tolerance).any())
    new = second.take(np.flatnonzero(is_new))
    records = Records(*(np.concatenate(pair) for pair in zip(first, new, strict=True)))
    update_ellipsoids(records.centre, records.stress, images, records, tolerance, NO_GROWTH)
    return records

"""Deformations at which the stress is sampled: ranges and sequences of points in them.

A constant rotation leaves σ(F, Ḟ) unchanged but for the rotation, so with the polar decomposition
F = R U seven inputs are left: the stretch U (symmetric) and the rate A = RᵀḞ (any 2 × 2).
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.interruption import held
from surrofe2.base.settings import check_settings, setting
from surrofe2.base.tensors import INPUTS, transpose, unrotated
from surrofe2.base.units import RATE

# Fraction of its size to which a sample is drawn towards rest, at most.
NEAREST = 0.03
SLACK = 1e-12  # rounding of the polar decomposition at the edge of the range
# Name of the points of `training_points`, by which data sets of others are recognised.
SEQUENCE = "Sobol, every third drawn to rest"
_DRAWN = 3  # every so many samples of a data set, one
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # multiples of it, without their integers, are even in [0, 1)
_MOST_SAMPLES = 2**30  # points of the scrambled Sobol sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingRange:
    """Bounds on the stretch U and on A = RᵀḞ; mapped onto itself by the square cell's group D4.

    Examples:
        Within 5 % of stretch and shear, and rates up to 1 per ms:

        >>> from surrofe2 import SamplingRange
        >>> range = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=1e-3)
        >>> range.stretch
        (0.95, 1.05)
        >>> SamplingRange(stretch=(0.95, 1.05), shear=0.99, rate=1e-3)  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        surrofe2.base.errors.InputError: range.shear: 0.99; it must be below ...
    """

    stretch: tuple[float, float] = setting(about="(low, high) of U₁₁ and of U₂₂")
    shear: float = setting(about="bound on |U₁₂|", least=0.0)
    rate: float = setting(about="bound on the modulus of every entry of RᵀḞ", unit=RATE, least=0.0)

    def __post_init__(self) -> None:
        check_settings(self, "range")
        low, high = self.stretch
        if not 0.0 < low < high:
            raise InputError(
                "range.stretch", f"({low}, {high}); low must be below high, both positive"
            )
        if not low <= 1.0 <= high:
            raise InputError(
                "range.stretch", f"({low}, {high}); it must hold 1, the tissue at rest"
            )
        if self.shear >= low:
            raise InputError(
                "range.shear",
                f"{self.shear}; it must be below the lowest stretch {low}, so that det U > 0",
            )

    @property
    def ends(self) -> tuple[Array, Array]:
        """Lowest and highest value (7,) of each of `QUANTITIES`."""
        low, high = self.stretch
        both = np.array([self.shear, *[self.rate] * 4])
        return np.array([low, low, *-both]), np.array([high, high, *both])


def sample(range: SamplingRange, count: int, seed: int, start: int = 0) -> tuple[Array, Array]:
    """Draw points `start` to `start + count` of a scrambled Sobol sequence over the range.

    Returns:
        F (count, 2, 2) symmetric, so F = U, and F_dot (count, 2, 2) in 1/µs. The same seed gives
        the same sequence, however it is cut into calls.

    Raises:
        InputError: a number is negative, or the sequence ends before.

    Examples:
        >>> from surrofe2 import SamplingRange, sample
        >>> range = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=1e-3)
        >>> F, F_dot = sample(range, 1024, seed=1)
        >>> F.shape
        (1024, 2, 2)
        >>> print(f"{F[:, 0, 0].min():.2f} to {F[:, 0, 0].max():.2f}")
        0.95 to 1.05
    """
    for name, value in (("count", count), ("seed", seed), ("start", start)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
            raise InputError(f"{name}: {value!r}; it must be an integer of at least 0")
    if start + count > _MOST_SAMPLES:
        raise InputError(f"count: {count} from {start}; the sequence ends at {_MOST_SAMPLES}")
    lower, upper = range.ends
    points = lower + (upper - lower) * _sobol(int(count), int(seed), int(start))
    # columns as `QUANTITIES` has them: U₁₁, U₂₂, U₁₂, and the four entries of RᵀḞ
    U = points[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    return U, points[:, 3:].reshape(-1, 2, 2).copy()


def training_points(
    range: SamplingRange, count: int, seed: int, start: int = 0
) -> tuple[Array, Array]:
    """Draw points of a data set: of `sample`, the first put at rest, every third drawn towards it.

    A point is drawn by a factor whose logarithm is uniform down to that of `NEAREST`. A tissue is
    mostly near rest, and there are few points of seven inputs where all are small.

    Returns:
        F (count, 2, 2) symmetric and F_dot (count, 2, 2) in 1/µs, as of `sample`.
    """
    F, F_dot = sample(range, count, seed, start)
    n = np.arange(start, start + count)
    is_drawn = n % _DRAWN == _DRAWN - 1
    factor = np.where(is_drawn, NEAREST ** (n * _GOLDEN % 1.0), 1.0)
    factor = np.where(n == 0, 0.0, factor)[:, None, None]
    return np.eye(2) + factor * (F - np.eye(2)), factor * F_dot


def contains(range: SamplingRange, F: Array, F_dot: Array) -> Flags:
    """Return (n,) whether U and RᵀḞ of points are in the range; False where anything is NaN."""
    F = np.asarray(F, dtype=np.float64)
    F_dot = np.asarray(F_dot, dtype=np.float64)
    lower, upper = range.ends
    slack = SLACK * np.array([1.0, 1.0, 1.0, *[range.rate] * 4])
    with np.errstate(all="ignore"):
        values = _quantities(F, F_dot)
        inside = (values >= lower - slack) & (values <= upper + slack)
    return np.asarray(inside.all(axis=1))


# The quantities that a range bounds.
QUANTITIES = ("U₁₁", "U₂₂", "U₁₂", "(RᵀḞ)₁₁", "(RᵀḞ)₁₂", "(RᵀḞ)₂₁", "(RᵀḞ)₂₂")


def _quantities(F: Array, F_dot: Array) -> Array:
    """Return the `QUANTITIES` of n points, (n, 7)."""
    U, A, _ = unrotated(F, F_dot)
    return np.concatenate([U.reshape(-1, 4)[:, [0, 3, 1]], A.reshape(-1, 4)], axis=1)


def farthest_out(range: SamplingRange, F: Array, F_dot: Array) -> tuple[Index, Array, Array]:
    """Find the quantity that is farthest beyond its bound, by its half width, at n finite points.

    Returns:
        Its number (n,) among `QUANTITIES`, −1 where all are within; its value (n,) and the bound
        that it passed (n,).
    """
    values = _quantities(F, F_dot)
    lower, upper = range.ends
    bound = np.where(values > 0.5 * (upper + lower), upper, lower)
    half = np.maximum(0.5 * (upper - lower), SLACK)
    beyond = np.abs(values - 0.5 * (upper + lower)) / half
    which = beyond.argmax(axis=1)
    rows = np.arange(len(F))
    inside = contains(range, F, F_dot)
    return np.where(inside, -1, which), values[rows, which], bound[rows, which]


def out_of_range(quantity: str, value: float, bound: float) -> str:
    """Say by how much a quantity is beyond its bound."""
    side = "most" if value > bound else "least"
    return (
        f"{quantity} = {value:.6g} of at {side} {bound:g} after the rotation is taken out, "
        f"{abs(value - bound):.2g} beyond"
    )


def range_holding(range: SamplingRange, F: Array, F_dot: Array) -> SamplingRange:
    """Return the least range that holds another one and these points, (n, 2, 2) each."""
    if contains(range, F, F_dot).all():
        return range
    values = _quantities(F, F_dot)
    low, high = range.stretch
    return SamplingRange(
        stretch=(min(low, float(values[:, :2].min())), max(high, float(values[:, :2].max()))),
        shear=max(range.shear, float(np.abs(values[:, 2]).max())),
        rate=max(range.rate, float(np.abs(values[:, 3:]).max())),
    )


def neighbours(
    range: SamplingRange, F: Array, F_dot: Array, count: int, seed: int, distance: float = 0.1
) -> tuple[Array, Array]:
    """Draw `count` points (F, F_dot) about others, (n, 2, 2) each, n ≥ 1, taken in turn.

    U and RᵀḞ of each are drawn evenly within `distance` times the half widths of the range from
    those of its point; F is symmetric, as of `sample`.
    """
    random = np.random.default_rng(seed)
    chosen = random.permutation(len(F))[np.arange(count) % len(F)]
    U, A, _ = unrotated(F[chosen], F_dot[chosen])
    lower, upper = range.ends
    moved = 0.5 * distance * (upper - lower) * random.uniform(-1.0, 1.0, (count, INPUTS))
    U = U + moved[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    return 0.5 * (U + transpose(U)), A + moved[:, 3:].reshape(-1, 2, 2)


def half_widths(range: SamplingRange) -> Array:
    """Return half the width of the range in each input of `tensors`, (7,); 1 where it has none."""
    low, high = range.stretch
    widest = max(1.0 - low, high - 1.0)
    widths = 2.0 * np.array([widest, widest, range.shear, *[range.rate] * 4])
    return np.where(widths > 0.0, widths, 1.0)


def _sobol(count: int, seed: int, start: int) -> Array:
    """Draw points (count, 7) in [0, 1) of scipy's scrambled sequence."""
    from scipy.stats import qmc  # here, since it takes longer to load than a cached run

    # Where scipy reads its table it swallows an interruption, and draws other points from then on.
    with held():
        sequence = qmc.Sobol(INPUTS, seed=np.random.default_rng(seed))
    if start:
        sequence.fast_forward(start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # any number of points will do
        points: Array = sequence.random(count)
    return points

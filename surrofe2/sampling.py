"""Which deformations the stress is sampled at, and the samples themselves.

A constant rotation leaves σ(F, Ḟ) unchanged but for the rotation, so with the polar decomposition
F = R U seven inputs are left: the stretch U (symmetric) and the rate A = RᵀḞ (any 2 × 2).
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.tensors import rotation, transpose

Array = NDArray[np.float64]

SLACK = 1e-12  # rounding of the polar decomposition at the edge of the range
TANGENTS = ("P_by_F", "P_by_F_dot")
_INPUTS = 7
_MOST_SAMPLES = 2**30  # points of the scrambled Sobol sequence


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplingRange:
    """Bounds on the stretch U and on A = RᵀḞ; mapped onto itself by the square cell's group D4.

    Attributes:
        stretch: (low, high) of U₁₁ and of U₂₂, 1.
        shear: bound on |U₁₂|, 1.
        rate: bound on the modulus of every entry of RᵀḞ, 1/µs.
    """

    stretch: tuple[float, float]
    shear: float
    rate: float

    def __post_init__(self) -> None:
        low, high = _pair(self.stretch)
        if not 0.0 < low < high < np.inf:
            raise InputError(
                f"range.stretch: ({low}, {high}); low must be below high, both positive"
            )
        object.__setattr__(self, "stretch", (low, high))
        for name in ("shear", "rate"):
            bound = _number(f"range.{name}", getattr(self, name))
            if not 0.0 <= bound < np.inf:
                raise InputError(f"range.{name}: {bound}; it must be at least 0 and finite")
            object.__setattr__(self, name, bound)
        if self.shear >= low:
            raise InputError(
                f"range.shear: {self.shear}; it must be below the lowest stretch {low}, "
                "so that det U > 0"
            )

    def to_dict(self) -> dict[str, Any]:
        """All fields by name, for files."""
        return asdict(self)


def sample(range: SamplingRange, count: int, seed: int, start: int = 0) -> tuple[Array, Array]:
    """Points `start` to `start + count` of a scrambled Sobol sequence over the range.

    Returns:
        F (count, 2, 2) symmetric, so F = U, and F_dot (count, 2, 2) in 1/µs. The same seed gives
        the same sequence, however it is cut into calls.

    Raises:
        InputError: a number is negative, or the sequence ends before.
    """
    for name, value in (("count", count), ("seed", seed), ("start", start)):
        if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
            raise InputError(f"{name}: {value!r}; it must be an integer of at least 0")
    if start + count > _MOST_SAMPLES:
        raise InputError(f"count: {count} from {start}; the sequence ends at {_MOST_SAMPLES}")
    low, high = range.stretch
    upper = np.array([high, high, range.shear, *[range.rate] * 4])
    lower = np.array([low, low, -range.shear, *[-range.rate] * 4])
    points = lower + (upper - lower) * _sobol(int(count), int(seed), int(start))
    return points[:, [0, 2, 2, 1]].reshape(-1, 2, 2), points[:, 3:].reshape(-1, 2, 2).copy()


def contains(range: SamplingRange, F: Array, F_dot: Array) -> NDArray[np.bool_]:
    """(n,) whether U and RᵀḞ of each point are within the range; False where anything is NaN."""
    F, F_dot = np.asarray(F, dtype=np.float64), np.asarray(F_dot, dtype=np.float64)
    with np.errstate(all="ignore"):
        R_transposed = transpose(rotation(F))
        U, A = R_transposed @ F, R_transposed @ F_dot
        low, high = range.stretch
        inside = np.abs(A).max(axis=(1, 2), initial=0.0) <= range.rate + SLACK * range.rate
        inside &= np.abs(U[:, 0, 1]) <= range.shear + SLACK
        for k in (0, 1):
            inside &= (U[:, k, k] >= low - SLACK) & (U[:, k, k] <= high + SLACK)
    return inside


def range_holding(range: SamplingRange, F: Array, F_dot: Array) -> SamplingRange:
    """The least range that holds another one and these points, (n, 2, 2) each."""
    if contains(range, F, F_dot).all():
        return range
    R_transposed = transpose(rotation(F))
    U, A = R_transposed @ F, R_transposed @ F_dot
    stretches = np.concatenate([U[:, 0, 0], U[:, 1, 1]])
    low, high = range.stretch
    return SamplingRange(
        stretch=(min(low, float(stretches.min())), max(high, float(stretches.max()))),
        shear=max(range.shear, float(np.abs(U[:, 0, 1]).max())),
        rate=max(range.rate, float(np.abs(A).max())),
    )


def neighbours(
    range: SamplingRange, F: Array, F_dot: Array, count: int, seed: int, distance: float = 0.1
) -> tuple[Array, Array]:
    """`count` points (F, F_dot) about the given ones, (n, 2, 2) each, n ≥ 1, taken in turn.

    U and RᵀḞ of each are drawn evenly within `distance` times the half widths of the range from
    those of its point; F is symmetric, as of `sample`.
    """
    random = np.random.default_rng(seed)
    at = random.permutation(len(F))[np.arange(count) % len(F)]
    R_transposed = transpose(rotation(F[at]))
    low, high = range.stretch
    half = distance * np.array([0.5 * (high - low)] * 2 + [range.shear] + [range.rate] * 4)
    moved = half * random.uniform(-1.0, 1.0, (count, _INPUTS))
    U = R_transposed @ F[at] + moved[:, [0, 2, 2, 1]].reshape(-1, 2, 2)
    return 0.5 * (U + transpose(U)), R_transposed @ F_dot[at] + moved[:, 3:].reshape(-1, 2, 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class StressSamples:
    """Stress of one RVE at sampled deformations, and whose stress it is.

    Attributes:
        F: (n, 2, 2) deformation gradient.
        F_dot: (n, 2, 2) its material rate, 1/µs.
        stress: (n, 2, 2) Cauchy stress in µN/µm, finite where `status` is 0.
        status: (n,) int8 codes of `surrofe2.stress_law.Status`.
        cell: parameters of the plant cell.
        initialisation: how the RVE was initialised.
        range: bounds the points were drawn from.
        seed: seed of their sequence.
        rest_length: wall rest length in µm, if known.
        P_by_F: (n, 2, 2, 2, 2) ∂P/∂F in µN/µm as in `Tangents`, finite where `status` is 0; None
            where the samples have no tangents.
        P_by_F_dot: the same by Ḟ, µN µs/µm; given if and only if `P_by_F` is.
        left_bifurcation: (n,) whether the RVE left its branch at a bifurcation: its stress is
            that of one of several stable equilibria. None: nowhere.
    """

    F: Array
    F_dot: Array
    stress: Array
    status: NDArray[np.int8]
    cell: CellParameters
    initialisation: str
    range: SamplingRange
    seed: int
    rest_length: float | None = None
    P_by_F: Array | None = None
    P_by_F_dot: Array | None = None
    left_bifurcation: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        count = len(self.F)
        if (self.P_by_F is None) != (self.P_by_F_dot is None):
            raise InputError("samples.P_by_F, samples.P_by_F_dot: give both or neither")
        arrays = self._float_arrays
        for name, array in arrays.items():
            shape = (count, 2, 2, 2, 2) if name in TANGENTS else (count, 2, 2)
            if np.shape(array) != shape:
                raise InputError(f"samples.{name}: shape {np.shape(array)}; it must be {shape}")
        if np.shape(self.status) != (count,):
            raise InputError(
                f"samples.status: shape {np.shape(self.status)}; it must be ({count},)"
            )
        left = self.left_bifurcation
        if left is not None and np.shape(left) != (count,):
            raise InputError(
                f"samples.left_bifurcation: shape {np.shape(left)}; it must be ({count},)"
            )
        for name, array in arrays.items():
            if not np.isfinite(array[self.status == 0]).all():
                raise InputError(f"samples.{name}: not finite at a sample whose status is 0")

    @property
    def _float_arrays(self) -> dict[str, Array]:
        """The arrays of numbers that the samples have, by name."""
        arrays = {name: getattr(self, name) for name in ("F", "F_dot", "stress", *TANGENTS)}
        return {name: array for name, array in arrays.items() if array is not None}

    @property
    def fingerprint(self) -> str:
        """16 hexadecimal digits that two equal sets of samples share and no others."""
        digest = hashlib.sha256()
        identity = (self.cell.fingerprint, self.initialisation, self.range.to_dict(), self.seed)
        digest.update(repr((*identity, self.rest_length)).encode())
        for array in self._float_arrays.values():
            digest.update(np.ascontiguousarray(array, dtype=np.float64).tobytes())
        digest.update(np.ascontiguousarray(self.status, dtype=np.int8).tobytes())
        if self.left_bifurcation is not None and self.left_bifurcation.any():
            digest.update(np.packbits(self.left_bifurcation).tobytes())
        return digest.hexdigest()[:16]

    @property
    def valid(self) -> StressSamples:
        """The samples that have a stress, status 0, and only one: no bifurcation was left."""
        kept = self.status == 0
        if self.left_bifurcation is not None:
            kept &= ~self.left_bifurcation
        arrays = {name: array[kept] for name, array in self._float_arrays.items()}
        return replace(self, status=self.status[kept], left_bifurcation=None, **arrays)


def _sobol(count: int, seed: int, start: int) -> Array:
    from scipy.stats import qmc  # here, because it takes longer to import than a recipe to check

    sequence = qmc.Sobol(_INPUTS, scramble=True, rng=np.random.default_rng(seed))
    if count == 0:
        return np.empty((0, _INPUTS))
    if start:
        sequence.fast_forward(start)
        return np.asarray(sequence.random(count))
    # one point first: scipy warns when a sequence begins with a count that is no power of two
    return np.concatenate([sequence.random(1), sequence.random(count - 1)])


def _pair(value: Any) -> tuple[float, float]:
    if not isinstance(value, tuple | list) or len(value) != 2:
        raise InputError(f"range.stretch: {value!r}; it must be two numbers, low and high")
    return _number("range.stretch", value[0]), _number("range.stretch", value[1])


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise InputError(f"{name}: {value!r}; it must be a number")
    return float(value)

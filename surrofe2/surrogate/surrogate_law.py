"""`SurrogateLaw`: a trained network as a stress law, with its range and its error's bound."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags
from surrofe2.base.errors import InputError, MismatchError
from surrofe2.base.sampling import QUANTITIES, SamplingRange, farthest_out, out_of_range
from surrofe2.base.square_symmetry import COMPONENTS
from surrofe2.base.tensors import INPUTS, rotation, to_components, transpose
from surrofe2.law.samples import StressSamples
from surrofe2.law.stress_law import (
    Status,
    StressResponse,
    Tangents,
    check_deformation,
)
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.run.views import Facts, Viewed
from surrofe2.surrogate.domain import Calibration, Domain, scaled_inputs
from surrofe2.surrogate.features import NetworkParameters
from surrofe2.surrogate.lookup import (
    BoundArrays,
    NetworkArrays,
    evaluate_slopes,
    lookup,
)
from surrofe2.surrogate.piola import to_cauchy, to_tangents
from surrofe2.surrogate.settings import TrainingSettings

# A component whose spread is below this fraction of the largest is zero but for rounding; its
# errors are then relative to the largest spread.
_ROUNDING = 1e-12
# The stress of an RVE is known to this fraction of the spread, so no tolerance is smaller.
_SOLVED = 1e-8
# What is allowed at rest, over the bound there: a point at rest must be far from the threshold.
_AT_REST = 2.0
_STRESS_COMPONENTS = ("xx", "xy", "yx", "yy")


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SurrogateLaw(Viewed):
    """Stress law σ(F, Ḟ) of one RVE, learnt from samples of its stress.

    It turns with the material exactly, and for the square cell has its symmetry D4 and σ(I, 0) = 0
    exactly. It is smooth everywhere.

    Attributes:
        network: weights that give the components of RᵀP from those of U and RᵀḞ; see `network`.
        cell: plant cell of the RVE whose stress was learnt.
        initialisation: initialisation of that RVE.
        range: bounds of the data, outside which no stress is given.
        settings: settings of the training.
        errors: errors over held-out samples, see `score`.
        data_fingerprint: fingerprint of the samples trained on.
        rest_length: wall rest length in µm, if known.
        version: version of the package that trained.
        domain: part of the range in which samples did not fail; None: all of it.
        calibration: bound of the error, which counts only if made for these very weights and this
            range.
        seconds: time that its `data`, its `training` and its `calibration` took, as far as known.
        tolerance: (9,) the error allowed: first, for each scaled input, the square of what it adds,
            as a fraction of the tolerance; then what is allowed at rest, as such a fraction; last
            the tolerance, µN/µm. None: 1 µN/µm everywhere.
        arrays: the network as its kernels read it.
        bound_arrays: range, domain and bound as their kernel reads them.
    """

    has_tangents = True

    network: NetworkParameters
    cell: CellParameters
    initialisation: str
    range: SamplingRange
    settings: TrainingSettings
    errors: Mapping[str, Any]
    data_fingerprint: str
    rest_length: float | None = None
    version: str = "unknown"
    domain: Domain | None = None
    calibration: Calibration | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    tolerance: Array | None = None
    arrays: NetworkArrays = field(init=False)
    bound_arrays: BoundArrays = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "arrays", NetworkArrays.of(self.network))
        calibration = self.calibration if self.is_calibrated else None
        bounds = BoundArrays.of(self.range, self.domain, calibration, self.tolerance)
        object.__setattr__(self, "bound_arrays", bounds)

    def facts(self) -> Facts:
        """Return what a notebook shows of the surrogate, by name."""
        facts: dict[str, Any] = {
            "plant cell": self.cell.preset_name,
            "initialisation": self.initialisation,
            "range": self.range,
            "bound of its error": "calibrated" if self.is_calibrated else "none",
            "held-out samples": self.errors.get("points", "none"),
        }
        for name, rms in self.errors.get("rms", {}).items():
            if name in _STRESS_COMPONENTS:
                worst = self.errors["worst"][name]
                facts[f"error of {name}, of the spread"] = (
                    f"{100.0 * rms:.2g} % RMS, {100.0 * worst:.2g} % at worst"
                )
        return facts

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.cell.density

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Compute the stress at n points.

        Outside the range of the data the status is OUT_OF_RANGE, and stress and tangents are NaN.
        """
        F, F_dot = check_deformation(F, F_dot)
        stress, status, _ = self.lookup(F, F_dot)
        slopes = None
        if tangents:
            slopes = self.tangents(F, F_dot)
            slopes.P_by_F[status != 0] = np.nan
            slopes.P_by_F_dot[status != 0] = np.nan
        reasons = self._reasons_outside(F, F_dot, status) if status.any() else {}
        effort = {"surrogate_points": len(F)}
        return StressResponse(stress, status, state, effort, slopes, reasons=reasons)

    def _reasons_outside(self, F: Array, F_dot: Array, status: NDArray[np.int8]) -> dict[int, str]:
        """Say why the first point that is out of range is so, by its number; {} if none is.

        A message names one point, and each reason takes its time.
        """
        outside = np.flatnonzero(status == Status.OUT_OF_RANGE)
        if not len(outside):
            return {}
        first = int(outside[0])
        (quantity,), (value,), (bound,) = farthest_out(self.range, F[[first]], F_dot[[first]])
        is_in_range = quantity < 0
        if is_in_range:
            return {first: "beyond the failure boundary, where samples have no stress"}
        return {first: out_of_range(QUANTITIES[quantity], value, bound)}

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """Compute ∂P/∂F and ∂P/∂Ḟ of the surrogate, exactly; no range is tested.

        F, F_dot: contiguous float64 (n, 2, 2), det F > 0.
        """
        components, slopes = evaluate_slopes(F, F_dot, self.arrays)
        return to_tangents(F, F_dot, components, slopes)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Return the response as it is: a surrogate has nothing to check or to commit."""
        return response

    def in_range(self, F: Array, F_dot: Array) -> Flags:
        """Return (n,) whether U and RᵀḞ are where the data are; False where not a number."""
        F = np.ascontiguousarray(F, dtype=np.float64)
        F_dot = np.ascontiguousarray(F_dot, dtype=np.float64)
        status, _ = self.status_and_risk(F, F_dot)
        return status == Status.OK

    @property
    def is_calibrated(self) -> bool:
        """True if the bound was calibrated for these very weights and this range."""
        if self.calibration is None:
            return False
        return self.calibration.subject == self.network.fingerprint(self.range)

    @property
    def stress_spread(self) -> float:
        """The spread of stress in µN/µm, see `tensors.stress_spread`.

        It is that of all valid samples where the bound is calibrated, else that of the samples held
        out from training.
        """
        if self.calibration is not None:
            return self.calibration.stress_spread
        spreads = [self.errors["spread"][name] for name in _STRESS_COMPONENTS]
        return float(np.hypot.reduce(spreads))

    def with_tolerance(self, tolerance: float, relative: float) -> SurrogateLaw:
        """Return a copy whose risks refer to this tolerance; an infinite one leaves no risk.

        Args:
            tolerance: error allowed as a fraction of the spread of stress.
            relative: error allowed as a fraction of the local stress.
        """
        bound_at_rest = float(self.error_bound(np.eye(2)[None], np.zeros((1, 2, 2)))[0])
        spread = self.stress_spread
        # without a domain or a finite bound the tolerance is the same everywhere
        squares = np.zeros(INPUTS)
        allowed_at_rest = 1.0
        if self.domain is not None and np.isfinite([tolerance, relative, bound_at_rest]).all():
            sizes = self.network.sizes_at_rest() * self.domain.scale
            squares = (relative * sizes / (tolerance * spread)) ** 2
            least = max(_AT_REST * bound_at_rest, _SOLVED * spread)
            allowed_at_rest = least / (tolerance * spread)
        return replace(self, tolerance=np.array([*squares, allowed_at_rest, tolerance * spread]))

    def local_tolerance(self, F: Array, F_dot: Array) -> Array:
        """Return (n,) what an error may be, as a fraction of the tolerance, at most 1.

        See `domain` for the formula.
        """
        if self.tolerance is None or self.domain is None:
            return np.ones(len(F))
        x = scaled_inputs(F, F_dot, self.domain.scale)
        squares = self.tolerance[:-2]
        allowed_at_rest = self.tolerance[-2]
        return np.minimum(allowed_at_rest + np.sqrt(x**2 @ squares), 1.0)

    def error_bound(self, F: Array, F_dot: Array) -> Array:
        """Return the bound (n,) of the error of the stress in µN/µm, see `calibration`.

        It is infinite outside the domain, and where nothing was calibrated.
        """
        F = np.ascontiguousarray(F, dtype=np.float64)
        F_dot = np.ascontiguousarray(F_dot, dtype=np.float64)
        # the risk without a tolerance is by 1 µN/µm, so it is the bound
        law = self if self.tolerance is None else replace(self, tolerance=None)
        _, _, bound = law.lookup(F, F_dot)
        return bound

    def lookup(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """Compute (stress (n, 2, 2), status (n,), risk (n,)) in one pass; input is not checked.

        The risk is the bound of the error over the error that is allowed: by `with_tolerance`, or
        1 µN/µm without it. It is infinite where no bound is known. Where it exceeds the limit, the
        status is NOT_TRUSTED and the stress NaN.

        F, F_dot: contiguous float64 (n, 2, 2).
        """
        return lookup(F, F_dot, self.arrays, self.bound_arrays, limit)

    def status_and_risk(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """Compute (status (n,), risk (n,)) alone, at a fraction of the cost of `lookup`.

        Whether the network's stress is finite is not tested.
        """
        _, status, risk = lookup(F, F_dot, self.arrays, self.bound_arrays, limit, with_stress=False)
        return status, risk

    def extrapolate(self, F: Array, F_dot: Array) -> Array:
        """Compute the stress (n, 2, 2) in µN/µm by the network alone, in range or not."""
        F, F_dot = check_deformation(F, F_dot)
        components, _ = evaluate_slopes(F, F_dot, self.arrays)
        return to_cauchy(F, components)

    def score(self, samples: StressSamples) -> dict[str, Any]:
        """Compute errors on samples of the same RVE, by component, beyond the range too.

        Returns:
            `points`, the number of samples, and three figures by component of σ (``"xx"``, …) and
            of Rᵀ σ R: `spread`, the standard deviation over the samples in µN/µm, and the errors
            `rms` and `worst` relative to it.
            `surrogate.score(samples)["rms"]["xy"]` is that of the shear stress.

        Raises:
            MismatchError: they are of another plant cell or initialisation.
            InputError: none of them has a stress.
        """
        for name, of_surrogate, of_samples in (
            ("cell", self.cell.fingerprint, samples.cell.fingerprint),
            ("initialisation", self.initialisation, samples.initialisation),
        ):
            if of_surrogate != of_samples:
                raise MismatchError(
                    f"samples.{name}: {of_samples}, the surrogate's is {of_surrogate}; "
                    "sample its own RVE"
                )
        valid = samples.valid
        if not len(valid.F):
            raise InputError(f"samples: none of {len(samples.F)} has a stress; ask other states")
        R = rotation(valid.F)
        exact = _all_components(R, valid.stress)
        predicted = _all_components(R, self.extrapolate(valid.F, valid.F_dot))
        spread = exact.std(axis=0)
        largest_spread = max(spread.max(), np.finfo(float).tiny)
        reference = np.where(spread > _ROUNDING * largest_spread, spread, largest_spread)
        error = np.abs(predicted - exact) / reference
        rms = np.sqrt((error**2).mean(axis=0))
        worst = error.max(axis=0)
        return {
            "points": len(R),
            "spread": _by_component(spread),
            "rms": _by_component(rms),
            "worst": _by_component(worst),
        }


def _all_components(R: Array, stress: Array) -> Array:
    """Return (n, 8): the components of Rᵀ σ R, then the entries of σ (n, 2, 2)."""
    unrotated = to_components(transpose(R) @ stress @ R)
    return np.hstack([unrotated, stress.reshape(-1, 4)])


def _by_component(values: Array) -> dict[str, float]:
    """Return values (8,) of `_all_components` by the name of the component."""
    names = (*COMPONENTS, *_STRESS_COMPONENTS)
    return dict(zip(names, values.tolist(), strict=True))

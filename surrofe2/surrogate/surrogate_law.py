"""`SurrogateLaw`: a trained network as a stress law that knows where it may be asked."""

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

_ROUNDING = 1e-12  # of the largest spread: less is no spread
_SOLVED = 1e-8  # of the spread of stress: stresses of RVEs are known no more exactly
_AT_REST = 2.0  # times the bound there, so that a point at rest is far from the threshold


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class SurrogateLaw(Viewed):
    """σ(F, Ḟ) of one RVE, learnt; rotation and, for the square cell, D4 hold exactly.

    Smooth everywhere; for the square cell σ(I, 0) = 0.

    Attributes:
        network: components of RᵀP from those of U and RᵀḞ; see `network`.
        cell, initialisation: of the RVE whose stress was learnt.
        range: bounds of the data, outside which no stress is given.
        errors: over held-out samples, see `score`.
        data_fingerprint: of the samples trained on; version: of the package that trained.
        rest_length: wall rest length in µm, if known.
        domain: where in the range samples did not fail; None: all of it.
        calibration: of the bound of the error, valid for these very weights and this range.
        seconds: of its `data`, its `training` and its `calibration`, as far as known.
        tolerance: (9,) squares of what each scaled input adds to the error allowed, as a fraction
            of the tolerance, what is allowed at rest, and the tolerance, µN/µm; None: 1 µN/µm
            everywhere.
        arrays, bound_arrays: network, and range, domain and bound, as its kernels read them.
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
        errors = self.errors
        return {
            "plant cell": self.cell.preset_name,
            "initialisation": self.initialisation,
            "range": self.range,
            "bound of its error": "calibrated" if self.is_calibrated else "none",
            "held-out samples": errors.get("points", "none"),
            **{
                f"error of {name}, of the spread": f"{100.0 * rms:.2g} % RMS, "
                f"{100.0 * errors['worst'][name]:.2g} % at worst"
                for name, rms in errors.get("rms", {}).items()
                if name in ("xx", "xy", "yx", "yy")
            },
        }

    @property
    def density(self) -> float:
        """ng/µm²."""
        return self.cell.density

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Stress at n points; NaN and status OUT_OF_RANGE outside the range of the data, of the
        tangents too."""
        F, F_dot = check_deformation(F, F_dot)
        stress, status, _ = self.lookup(F, F_dot)
        slopes = self.tangents(F, F_dot) if tangents else None
        if slopes is not None:
            slopes.P_by_F[status != 0] = slopes.P_by_F_dot[status != 0] = np.nan
        reasons = {}
        if status.any():
            for k in np.flatnonzero(status == Status.OUT_OF_RANGE)[:1].tolist():
                (which,), (value,), (bound,) = farthest_out(self.range, F[[k]], F_dot[[k]])
                reasons[k] = "beyond the failure boundary, where samples have no stress"
                if which >= 0:
                    reasons[k] = out_of_range(QUANTITIES[which], value, bound)
        return StressResponse(
            stress, status, state, {"surrogate_points": len(F)}, slopes, reasons=reasons
        )

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """∂P/∂F and ∂P/∂Ḟ of the surrogate, exact; no range is tested.

        F, F_dot: contiguous float64 (n, 2, 2), det F > 0.
        """
        return to_tangents(F, F_dot, *evaluate_slopes(F, F_dot, self.arrays))

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> StressResponse:
        """Nothing is left to check or to commit."""
        return response

    def in_range(self, F: Array, F_dot: Array) -> Flags:
        """(n,) whether U and RᵀḞ are where the data are; False where not a number."""
        F, F_dot = (np.ascontiguousarray(tensors, dtype=np.float64) for tensors in (F, F_dot))
        return self.status_and_risk(F, F_dot)[0] == Status.OK

    @property
    def is_calibrated(self) -> bool:
        """Whether the bound was calibrated for these very weights and this range."""
        calibration = self.calibration
        return calibration is not None and calibration.subject == self.network.fingerprint(
            self.range
        )

    @property
    def stress_spread(self) -> float:
        """µN/µm, see `tensors.stress_spread`: of all valid samples where calibrated, else of those
        held out from training."""
        if self.calibration is not None:
            return self.calibration.stress_spread
        return float(np.hypot.reduce([self.errors["spread"][k] for k in ("xx", "xy", "yx", "yy")]))

    def with_tolerance(self, tolerance: float, relative: float) -> SurrogateLaw:
        """This law, whose risks are by this tolerance; an infinite one leaves no risk.

        Args:
            tolerance: fraction of the spread of stress; relative: fraction of the local stress.
        """
        at_rest = float(self.error_bound(np.eye(2)[None], np.zeros((1, 2, 2)))[0])
        spread, squares, least = self.stress_spread, np.zeros(INPUTS), 1.0
        if self.domain is not None and np.isfinite([tolerance, relative, at_rest]).all():
            sizes = self.network.sizes_at_rest() * self.domain.scale
            squares = (relative * sizes / (tolerance * spread)) ** 2
            least = max(_AT_REST * at_rest, _SOLVED * spread) / (tolerance * spread)
        return replace(self, tolerance=np.array([*squares, least, tolerance * spread]))

    def local_tolerance(self, F: Array, F_dot: Array) -> Array:
        """(n,) what an error may be, as a fraction of the tolerance, at most 1; see `domain`."""
        if self.tolerance is None or self.domain is None:
            return np.ones(len(F))
        x = scaled_inputs(F, F_dot, self.domain.scale)
        return np.minimum(self.tolerance[-2] + np.sqrt(x**2 @ self.tolerance[:-2]), 1.0)

    def error_bound(self, F: Array, F_dot: Array) -> Array:
        """(n,) bound of the error of the stress in µN/µm, see `calibration`; infinite outside the
        domain, and where nothing was calibrated."""
        F, F_dot = (np.ascontiguousarray(tensors, dtype=np.float64) for tensors in (F, F_dot))
        law = self if self.tolerance is None else replace(self, tolerance=None)
        return law.lookup(F, F_dot)[2]

    def lookup(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """(stress (n, 2, 2), status (n,), risk (n,)) in one compiled pass; input is not checked.

        The risk is the bound of the error over the error allowed there: by `with_tolerance`, else 1
        µN/µm; infinite where no bound is known. Where it exceeds the limit, the status is
        NOT_TRUSTED and the stress NaN.

        F, F_dot: contiguous float64 (n, 2, 2).
        """
        return lookup(F, F_dot, self.arrays, self.bound_arrays, limit)

    def status_and_risk(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """(status (n,), risk (n,)) of `lookup`, which costs several times as much; that the
        network's answer is finite is not tested."""
        return lookup(F, F_dot, self.arrays, self.bound_arrays, limit, with_stress=False)[1:]

    def extrapolate(self, F: Array, F_dot: Array) -> Array:
        """Stress (n, 2, 2) in µN/µm by the network alone, in range or not."""
        F, F_dot = check_deformation(F, F_dot)
        return to_cauchy(F, evaluate_slopes(F, F_dot, self.arrays)[0])

    def score(self, samples: StressSamples) -> dict[str, Any]:
        """Errors on samples of the same RVE, by component, beyond the range too.

        Returns:
            As `errors`: `points`, and by component of σ (``"xx"``, …) and of Rᵀ σ R `spread` in
            µN/µm, its standard deviation over the samples, `rms` and `worst` relative to it.

            >>> surrogate.score(samples)["rms"]["xy"]

        Raises:
            MismatchError: they are of another plant cell or initialisation.
            InputError: none of them has a stress.
        """
        for name, here, there in (
            ("cell", self.cell.fingerprint, samples.cell.fingerprint),
            ("initialisation", self.initialisation, samples.initialisation),
        ):
            if here != there:
                raise MismatchError(
                    f"samples.{name}: {there}, the surrogate's is {here}; sample its own RVE"
                )
        known = samples.valid
        if not len(known.F):
            raise InputError(f"samples: none of {len(samples.F)} has a stress; ask other states")
        R, answer = rotation(known.F), self.extrapolate(known.F, known.F_dot)
        exact, found = (
            np.hstack([to_components(transpose(R) @ stress @ R), stress.reshape(-1, 4)])
            for stress in (known.stress, answer)
        )
        spread = exact.std(axis=0)
        largest = max(spread.max(), np.finfo(float).tiny)
        error = np.abs(found - exact) / np.where(spread > _ROUNDING * largest, spread, largest)
        rms, worst = np.sqrt((error**2).mean(axis=0)), error.max(axis=0)
        names = (*COMPONENTS, "xx", "xy", "yx", "yy")
        figures = {"spread": spread, "rms": rms, "worst": worst}
        named = {k: dict(zip(names, each.tolist(), strict=True)) for k, each in figures.items()}
        return {"points": len(R), **named}

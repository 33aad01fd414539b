"""`SurrogateLaw`: a trained network as a stress law that knows where it may be asked."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange, contains
from surrofe2.stress_law import (
    Acceptance,
    Status,
    StressResponse,
    Tangents,
    check_deformation,
)
from surrofe2.surrogate.compiled import evaluate, without_rest
from surrofe2.surrogate.compiled_slopes import evaluate_slopes
from surrofe2.surrogate.components import to_inputs
from surrofe2.surrogate.network import StressNetwork
from surrofe2.surrogate.packing import Weights, pack
from surrofe2.surrogate.piola import to_cauchy, to_tangents
from surrofe2.surrogate.settings import TrainingSettings

Array = NDArray[np.float64]


def package_version() -> str:
    """Version of the installed surrofe2."""
    try:
        return version("surrofe2")
    except PackageNotFoundError:
        return "unknown"


@dataclass(frozen=True, eq=False, kw_only=True)
class SurrogateLaw:
    """σ(F, Ḟ) of one RVE, learnt; rotation and, for the square cell, D4 hold exactly.

    Smooth everywhere; for the square cell σ(I, 0) = 0, and with an energy P(F, 0) = ∂W/∂F.

    Attributes:
        network: components of RᵀP from those of U and RᵀḞ; see `network`.
        cell: parameters of the plant cell whose stress was learnt.
        initialisation: how its RVE was initialised.
        range: bounds of the data, outside which no stress is given.
        settings: of the training.
        errors: over held-out samples: `points`, and by component `spread` (standard deviation,
            µN/µm), `rms` and `worst` error relative to the spread.
        data_fingerprint: of the samples trained on.
        rest_length: wall rest length in µm, if known.
        version: of the package that trained.
    """

    network: StressNetwork
    cell: CellParameters
    initialisation: str
    range: SamplingRange
    settings: TrainingSettings
    errors: Mapping[str, Any]
    data_fingerprint: str
    rest_length: float | None = None
    version: str = field(default_factory=package_version)
    _weights: Weights = field(init=False, repr=False)

    def __post_init__(self) -> None:
        weights = pack(self.network, self.range)
        object.__setattr__(self, "_weights", without_rest(weights, self.network.features))

    @classmethod
    def load(cls, path: str | Path) -> SurrogateLaw:
        """The surrogate in a file written by `save`.

        Raises:
            FileError: missing, truncated, foreign or altered; code in the file is never run.
        """
        from surrofe2.surrogate.checkpoint import read_surrogate

        return read_surrogate(Path(path))

    def save(self, path: str | Path) -> None:
        """Write to a file, whole or not at all; a FileError where that fails."""
        from surrofe2.surrogate.checkpoint import write_surrogate

        write_surrogate(self, Path(path))

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.cell.density

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Stress at n points; NaN and status OUT_OF_RANGE outside the range of the data.

        With `tangents`, ∂P/∂F and ∂P/∂Ḟ of the surrogate too, NaN where the stress is.
        """
        F, F_dot = check_deformation(F, F_dot)
        stress, status, _ = self.lookup(F, F_dot)
        slopes = self._tangents(F, F_dot, status) if tangents else None
        return StressResponse(stress, status, state, {"surrogate_points": len(F)}, slopes)

    def _tangents(self, F: Array, F_dot: Array, status: NDArray[np.int8]) -> Tangents:
        answered = np.flatnonzero(status == Status.OK)
        P_by_F, P_by_F_dot = (np.full((len(F), 2, 2, 2, 2), np.nan) for _ in range(2))
        if len(answered):
            F, F_dot = F[answered], F_dot[answered]
            found = to_tangents(F, F_dot, *evaluate_slopes(F, F_dot, self._weights))
            P_by_F[answered], P_by_F_dot[answered] = found.P_by_F, found.P_by_F_dot
        return Tangents(P_by_F, P_by_F_dot)

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """Nothing is left to check or to commit."""
        return Acceptance(response.status, response.state)

    def in_range(self, F: Array, F_dot: Array) -> NDArray[np.bool_]:
        """(n,) whether U and RᵀḞ are within the range of the data; False where not a number."""
        return contains(self.range, F, F_dot)

    def lookup(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """(stress (n, 2, 2), status (n,), bound (n,)) in one compiled pass; input is not checked.

        The bound of the error in µN/µm is infinite where none is known, and then no finite
        tolerance accepts the stress.

        F, F_dot: contiguous float64 (n, 2, 2).
        """
        stress, status = evaluate(F, F_dot, self._weights)
        bound = np.full(len(F), np.inf)
        if tolerance < np.inf:
            status[status == 0] = Status.NOT_TRUSTED
            stress[:] = np.nan
        return stress, status, bound

    def reference(self, F: Array, F_dot: Array) -> Array:
        """Stress (n, 2, 2) by the torch network, in range or not: the twin of `lookup`."""
        F, F_dot = check_deformation(F, F_dot)
        inputs, _ = to_inputs(F, F_dot)
        with torch.no_grad():
            precision = self.network.input_scale.dtype
            components = self.network(torch.as_tensor(inputs, dtype=precision))
        return to_cauchy(F, components.double().numpy())

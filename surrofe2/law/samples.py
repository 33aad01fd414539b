"""Stress of one RVE at sampled deformations: what data sets hold and surrogates learn from."""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange
from surrofe2.law.stress_law import Status
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.run.views import Facts, Viewed

TANGENTS = ("P_by_F", "P_by_F_dot")  # the arrays of `Tangents`, by name


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class StressSamples(Viewed):
    """Stress of one RVE at sampled deformations, with the plant cell that it is of.

    Attributes:
        F: (n, 2, 2) deformation gradient.
        F_dot: (n, 2, 2) its material rate, 1/µs.
        stress: (n, 2, 2) Cauchy stress in µN/µm, finite where `status` is 0.
        status: (n,) int8 codes of `surrofe2.law.stress_law.Status`.
        cell: parameters of the plant cell.
        initialisation: initialisation of the RVE, see `RveSettings`.
        range: bounds the points were drawn from.
        seed: seed of their sequence.
        rest_length: wall rest length in µm, if known.
        P_by_F: (n, 2, 2, 2, 2) ∂P/∂F in µN/µm as in `Tangents`, finite where `status` is 0; None
            where the samples have no tangents.
        P_by_F_dot: (n, 2, 2, 2, 2) ∂P/∂Ḟ in µN µs/µm; there if and only if `P_by_F` is.
        left_bifurcation: (n,) whether the RVE left its branch at a bifurcation: its stress is
            that of one of several stable equilibria. None: nowhere.

    Raises:
        InputError: arrays of wrong shape, a code that is none, or a sample of status 0 that is not
            finite.

    Examples:
        `sample_stress` makes them, `read_data_set` reads them from a file:

        >>> from surrofe2 import RveLaw, SamplingRange, sample_stress
        >>> range = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=1e-3)
        >>> samples = sample_stress(RveLaw("apple"), range, 64)
        >>> samples.stress.shape
        (64, 2, 2)
        >>> largest = abs(samples.valid.stress).max() / samples.cell.tissue_thickness
        >>> print(f"up to {largest:.2f} MPa")
        up to 0.19 MPa
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
    left_bifurcation: Flags | None = None

    def __post_init__(self) -> None:
        if (self.P_by_F is None) != (self.P_by_F_dot is None):
            raise InputError("samples.P_by_F, samples.P_by_F_dot: give both or neither")
        shapes: dict[str, tuple[int, ...]] = {}  # of one sample
        for name in self._float_arrays:
            shapes[name] = (2, 2, 2, 2) if name in TANGENTS else (2, 2)
        shapes |= {"status": (), "left_bifurcation": ()}
        for name, shape in shapes.items():
            array = getattr(self, name)
            wanted = (len(self.F), *shape)
            if array is not None and np.shape(array) != wanted:
                raise InputError(f"samples.{name}: shape {np.shape(array)}; it must be {wanted}")
        unknown = np.setdiff1d(self.status, [*Status])
        if unknown.size:
            known = ", ".join(str(int(status)) for status in Status)
            raise InputError(f"samples.status: {unknown[0]}; it must be one of {known}")
        for name, array in self._float_arrays.items():
            if not np.isfinite(array[self.status == 0]).all():
                raise InputError(f"samples.{name}: not finite at a sample whose status is 0")

    def facts(self) -> Facts:
        """Return what a notebook shows: how many samples there are, and whose."""
        usable = len(self.valid.F)
        failed = int((self.status != 0).sum())
        return {
            "samples": f"{len(self.F):,}",
            "usable": f"{usable:,}",
            "failed": f"{failed:,}",
            "left a bifurcation": f"{len(self.F) - usable - failed:,}",
            "tangents": "no" if self.P_by_F is None else "yes",
            "plant cell": self.cell.preset_name,
            "initialisation": self.initialisation,
            "range": self.range,
        }

    @property
    def _float_arrays(self) -> dict[str, Array]:
        """The arrays of numbers that the samples have, by name."""
        arrays = {"F": self.F, "F_dot": self.F_dot, "stress": self.stress}
        if self.P_by_F is not None and self.P_by_F_dot is not None:
            arrays |= {"P_by_F": self.P_by_F, "P_by_F_dot": self.P_by_F_dot}
        return arrays

    @property
    def fingerprint(self) -> str:
        """A digest of 16 hexadecimal digits, the same for equal sets of samples alone."""
        digest = hashlib.sha256()
        identity = (self.cell.fingerprint, self.initialisation, asdict(self.range), self.seed)
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
        return replace(self, left_bifurcation=None).at(kept)

    def at(self, chosen: Flags | Index) -> StressSamples:
        """Return the samples with these numbers, or where True."""
        arrays: dict[str, Any] = {k: array[chosen] for k, array in self._float_arrays.items()}
        has_left = None if self.left_bifurcation is None else self.left_bifurcation[chosen]
        return replace(self, status=self.status[chosen], left_bifurcation=has_left, **arrays)

"""The reference state of plant cells as plain data: where their particles rest, free of stress.

It is costly to find for irregular cells, so it can be kept and handed to a law or a tissue again.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.plant_cell.parameters import CellParameters

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceState:
    """A stable equilibrium at F = I without stress.

    Attributes:
        fingerprint: of the `CellParameters` that it belongs to.
        position: (n, 2) µm, walls first; particle 0 is a wall corner at the origin.
        lattice: (2, 2) µm, its columns the periods of the RVE.
        rest_length: wall rest length l₀, µm.
    """

    fingerprint: str
    position: Array
    lattice: Array
    rest_length: float

    def check_belongs_to(self, cell: CellParameters) -> None:
        """Raise MismatchError unless this is the reference state of `cell`."""
        if self.fingerprint != cell.fingerprint:
            raise MismatchError(
                f"reference: it belongs to plant cells {self.fingerprint}, not to "
                f"{cell.fingerprint}; take that of these parameters, or none to have it settled"
            )

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """One array for each field; the fingerprint as its 16 character codes."""
        return {
            "fingerprint": np.frombuffer(self.fingerprint.encode("ascii"), dtype=np.uint8).copy(),
            "position": self.position.copy(),
            "lattice": self.lattice.copy(),
            "rest_length": np.array([self.rest_length]),
        }

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> ReferenceState:
        """The state whose `to_arrays` gave `arrays`.

        Raises:
            InputError: an array is missing, has another shape or is not finite.
        """
        letters, *values = (arrays.get(item.name, np.empty(0)) for item in fields(cls))
        position, lattice, length = (np.array(each, np.float64, order="C") for each in values)
        shapes = position.shape == (len(position), 2) and lattice.shape == (2, 2)
        finite = all(np.isfinite(each).all() for each in (position, lattice, length))
        if not (shapes and finite and len(letters) == 16 and length.size == 1):
            raise InputError(
                "reference: arrays are missing, not finite or of other shapes; compute it again"
            )
        name = np.asarray(letters).astype(np.uint8).tobytes().decode("ascii", "replace")
        return cls(name, position, lattice, float(length.item()))

"""Harvest of a run: every true RVE answer it has paid for, kept in HDF5 for training."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import FileError
from surrofe2.io.hdf5 import Column, store_columns, stored_rows, writing_hdf5
from surrofe2.io.provenance import Origin, check_same_rve, reading, stored_cell
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.units import RATE, STRESS

Array = NDArray[np.float64]

SCHEMA = "surrofe2-harvest"
SCHEMA_VERSION = 2
WHY = {
    0: "asked of the RVE because the cache might not answer",
    1: "audit of the cache's answer",
    2: "neighbour of such a state",
    3: "sample of the range widened to hold such states",
}
_COLUMNS = {
    "F": Column((2, 2)),
    "F_dot": Column((2, 2), unit=RATE),
    "stress": Column((2, 2), unit=STRESS),
    "status": Column(kind=np.int8),
    "why": Column(kind=np.int8, meaning=WHY),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Harvest:
    """A harvest read back; arrays as in `StressSamples`, and `why` (n,) as in `WHY`."""

    F: Array
    F_dot: Array
    stress: Array
    status: NDArray[np.int8]
    why: NDArray[np.int8]
    cell: CellParameters
    initialisation: str


class HarvestWriter:
    """Takes answers as `CachedLaw(on_true_answer=…)` gives them; `flush` writes the file anew."""

    def __init__(self, path: Path, origin: Origin) -> None:
        self.path, self.origin = path, origin
        self._parts: list[dict[str, NDArray[Any]]] = []
        self._is_stored = True

    def __call__(
        self, F: Array, F_dot: Array, stress: Array, status: NDArray[np.int8], why: NDArray[np.int8]
    ) -> None:
        """Take answers, (n, 2, 2) and (n,)."""
        taken = zip(_COLUMNS, map(np.array, (F, F_dot, stress, status, why)), strict=True)
        self._is_stored = self._is_stored and not len(F)
        self._parts.append(dict(taken))

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """All answers so far, for `restore`."""
        none: dict[str, NDArray[Any]] = {
            name: np.empty((0, *each.shape), each.kind) for name, each in _COLUMNS.items()
        }
        parts = self._parts or [none]
        self._parts = [{name: np.concatenate([part[name] for part in parts]) for name in _COLUMNS}]
        return self._parts[0]

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Hold these answers and no others."""
        self._parts = [{name: arrays[name] for name in _COLUMNS}]
        self._is_stored = not len(arrays["why"])

    def flush(self, seconds: float = 0.0) -> None:
        """Write all answers so far, and the seconds that they took."""
        if self._is_stored:
            return
        with writing_hdf5(self.path) as file:
            store_columns(file, _COLUMNS, self.to_arrays())
            file.attrs.update(self.origin.attributes(SCHEMA, SCHEMA_VERSION), seconds=seconds)
        self._is_stored = True


def read_harvest(path: str | Path) -> Harvest:
    """The answers in a harvest, each state once, also of a run that was interrupted.

    Raises:
        FileError: not a harvest of this schema, or damaged.
    """
    arrays, (cell, initialisation) = _read(Path(path))
    if not np.isfinite(arrays["stress"][arrays["status"] == 0]).all():
        raise FileError(f"{path}: stress: not finite where the status is 0; it is damaged")
    states = np.concatenate([arrays["F"], arrays["F_dot"]], axis=1).reshape(-1, 8)
    _, first = np.unique(states, axis=0, return_index=True)
    first.sort()
    once = {name: values[first] for name, values in arrays.items()}
    return Harvest(**once, cell=cell, initialisation=initialisation)


def check_harvest(path: Path, harvest: Harvest, cell: CellParameters, initialisation: str) -> None:
    """Refuse a harvest of other parameters.

    Raises:
        MismatchError: naming the first parameter that differs.
    """
    _check(path, (harvest.cell, harvest.initialisation), (cell, initialisation))


def _read(path: Path) -> tuple[dict[str, NDArray[Any]], tuple[CellParameters, str]]:
    """All rows, and the plant cells and initialisation that they are of."""
    with reading(path, SCHEMA, SCHEMA_VERSION) as file:
        return stored_rows(file, _COLUMNS), stored_cell(file)


def _check(path: Path, there: tuple[CellParameters, str], here: tuple[CellParameters, str]) -> None:
    check_same_rve(f"{path}: harvested", there, here, "leave it out")

"""Harvest of a run: every true RVE answer it has paid for, kept in HDF5 for training."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.io.arrays import Column, append_rows, completed, create_arrays, grow
from surrofe2.io.files import opened_hdf5
from surrofe2.io.provenance import Origin, check_same_rve, reading, stored_cell
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.units import RATE, STRESS

Array = NDArray[np.float64]

SCHEMA = "surrofe2-harvest"
SCHEMA_VERSION = 1
WHY = {
    0: "asked of the RVE because the cache might not answer",
    1: "audit of the cache's answer",
    2: "neighbour of such a state",
    3: "sample of the range widened to hold such states",
}
CHUNK = 4096
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
    """Takes answers as `CachedLaw(on_true_answer=…)` gives them; in the file after `flush`.

    Rows are written in chunks of `CHUNK`, and by `flush`, which a run calls with its checkpoints.
    The file is created with the first of them, or continued where it is of the same RVE.

    Raises:
        MismatchError: the file to be continued is of other parameters.
    """

    def __init__(self, path: Path, origin: Origin) -> None:
        self.path, self.origin = path, origin
        self._waiting: list[tuple[NDArray[Any], ...]] = []
        self._count = 0
        if path.exists():
            there = read_harvest(path)
            check_harvest(path, there, origin.cell, origin.rve["initialisation"])

    def __call__(
        self, F: Array, F_dot: Array, stress: Array, status: NDArray[np.int8], why: NDArray[np.int8]
    ) -> None:
        """Take answers, (n, 2, 2) and (n,)."""
        self._waiting.append(tuple(np.array(part) for part in (F, F_dot, stress, status, why)))
        self._count += len(F)
        if self._count >= CHUNK:
            self.flush()

    def flush(self) -> None:
        """Write what is waiting."""
        if not self._count:
            return
        parts = map(np.concatenate, zip(*self._waiting, strict=True))
        rows = dict(zip(_COLUMNS, parts, strict=True))
        if not self.path.exists():
            attributes = self.origin.attributes(SCHEMA, SCHEMA_VERSION)
            create_arrays(self.path, _COLUMNS, max(CHUNK, 2 * self._count), attributes)
        with opened_hdf5(self.path, "r") as file:
            needed, room = completed(file) + self._count, len(file["F"])
        if needed > room:
            grow(self.path, _COLUMNS, 2 * needed)
        with opened_hdf5(self.path, "r+") as file:
            append_rows(self.path, file, rows)
        self._waiting, self._count = [], 0


def read_harvest(path: str | Path) -> Harvest:
    """The answers in a harvest, each state once, also of a run that was interrupted.

    Raises:
        FileError: not a harvest of this schema, or damaged.
    """
    path = Path(path)
    with reading(path, SCHEMA, SCHEMA_VERSION) as file:
        count = completed(file)
        arrays = {name: file[name][:count] for name in _COLUMNS}
        cell, initialisation = stored_cell(file)
    states = np.concatenate([arrays["F"], arrays["F_dot"]], axis=1).reshape(count, 8)
    _, first = np.unique(states, axis=0, return_index=True)
    first.sort()
    once = {name: values[first] for name, values in arrays.items()}
    return Harvest(**once, cell=cell, initialisation=initialisation)


def check_harvest(path: Path, harvest: Harvest, cell: CellParameters, initialisation: str) -> None:
    """Refuse a harvest of other parameters.

    Raises:
        MismatchError: naming the first parameter that differs.
    """
    there = harvest.cell, harvest.initialisation
    check_same_rve(f"{path}: harvested", there, (cell, initialisation), "leave it out")

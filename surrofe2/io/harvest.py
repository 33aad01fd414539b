"""Harvest of a run: every true RVE answer it has paid for, kept in HDF5 for training.

Rows lie in arrays whose place in the file is fixed; a counter says how many count, and rows are
flushed before the counter that covers them, so a kill at any moment leaves a file to read. Full
arrays are copied into a file of twice the size, which then takes the old one's place.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import FileError
from surrofe2.io.checks import check_same_rve, check_schema
from surrofe2.io.data_set_layout import lay_out
from surrofe2.io.files import opened_hdf5, plain, replacing, reported
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.units import NONE, RATE, STRESS

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
_UNITS = {"F": NONE, "F_dot": RATE, "stress": STRESS, "status": NONE, "why": NONE}


@dataclass(frozen=True, slots=True, kw_only=True)
class HarvestHeader:
    """Where a harvest's answers come from; cell, initialisation and solver settings must match
    where it is continued."""

    cell: CellParameters
    rve: Mapping[str, Any]
    version: str
    recipe: Mapping[str, Any]


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
    """Takes answers as `CachedLaw(keep=…)` gives them; in the file after `flush`.

    Rows are written in chunks of `CHUNK`, and by `flush`, which a run calls with its checkpoints.
    The file is created with the first of them, or continued where it is of the same RVE.

    Raises:
        MismatchError: the file to be continued is of other parameters.
    """

    def __init__(self, path: Path, header: HarvestHeader) -> None:
        self.path, self.header = path, header
        self._waiting: list[tuple[NDArray[Any], ...]] = []
        self._count = 0
        if path.exists():
            there = read_harvest(path)
            check_harvest(path, there, header.cell, header.rve["initialisation"])

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
        rows = dict(zip(_UNITS, map(np.concatenate, zip(*self._waiting, strict=True)), strict=True))
        if not self.path.exists():
            _create(self.path, self.header, max(CHUNK, 2 * self._count), {})
        with opened_hdf5(self.path, "r") as file:
            done, room = int(file["completed"][()]), len(file["F"])
            held = {name: file[name][:done] for name in _UNITS} if done + self._count > room else {}
        if held:
            _create(self.path, self.header, 2 * (done + self._count), held)
        with opened_hdf5(self.path, "r+") as file, reported(self.path, "written"):
            for name, values in rows.items():
                file[name][done : done + self._count] = values
            file.flush()
            file["completed"][()] = done + self._count
            file.flush()
        self._waiting, self._count = [], 0


def _create(path: Path, header: HarvestHeader, room: int, held: Mapping[str, NDArray[Any]]) -> None:
    """A file with room for so many rows, the first of them filled; it replaces what is there."""
    with replacing(path) as partial, h5py.File(partial, "w") as file:
        for name, unit in _UNITS.items():
            tensor = unit != NONE or name == "F"
            shape, kind = ((room, 2, 2), np.float64) if tensor else ((room,), np.int8)
            lay_out(file, name, shape, kind).attrs["unit"] = unit
            if held:
                file[name][: len(held[name])] = held[name]
        file["why"].attrs["meaning"] = json.dumps(WHY)
        file["completed"] = np.int64(len(held["F"]) if held else 0)
        file.attrs.update(
            schema=SCHEMA,
            schema_version=SCHEMA_VERSION,
            package_version=header.version,
            created=datetime.now(UTC).isoformat(timespec="seconds"),
            recipe=json.dumps(plain(header.recipe)),
            cell=json.dumps(asdict(header.cell)),
            cell_fingerprint=header.cell.fingerprint,
            initialisation=header.rve["initialisation"],
            rve=json.dumps(plain(header.rve)),
        )


def read_harvest(path: str | Path) -> Harvest:
    """The answers in a harvest, each state once, also of a run that was interrupted.

    Raises:
        FileError: not a harvest of this schema, or damaged.
    """
    path = Path(path)
    with opened_hdf5(path, "r") as file:
        check_schema(path, file, SCHEMA, SCHEMA_VERSION, "harvest of surrofe2")
        try:
            count = int(file["completed"][()])
            arrays = {name: file[name][:count] for name in _UNITS}
            cell = CellParameters(**json.loads(file.attrs["cell"]))
            initialisation = str(file.attrs["initialisation"])
        except (KeyError, TypeError, ValueError) as error:
            raise FileError(f"{path}: not a whole harvest of surrofe2: {error}") from None
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
    check_same_rve(f"{path}: harvested", harvest, cell, initialisation, "leave it out")

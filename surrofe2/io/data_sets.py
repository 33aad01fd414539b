"""Data sets of (F, Ḟ) → σ in HDF5, continued after a kill at any moment; schema: data/README.md.

While samples are computed, the file is written anew every few seconds, whole, with all rows that
there are.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np
from numpy.typing import NDArray

from surrofe2.checkpoint_clock import CheckpointClock
from surrofe2.costs import Meter
from surrofe2.errors import InputError
from surrofe2.io.files import check_same, flat
from surrofe2.io.hdf5 import (
    Column,
    store_columns,
    stored_number,
    stored_rows,
    writing_hdf5,
)
from surrofe2.io.kept import attached
from surrofe2.io.lock import file_lock, locked_file
from surrofe2.io.provenance import (
    Origin,
    reading,
    stored_cell,
    stored_range,
    stored_text,
)
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.sampling import SEQUENCE, SamplingRange
from surrofe2.stress_law import Status, StressResponse, describe
from surrofe2.stress_samples import TANGENTS, StressSamples
from surrofe2.units import RATE, STRESS, VISCOSITY

SCHEMA = "surrofe2-data-set"
SCHEMA_VERSION = 2
INTERVAL = 5.0
"""Seconds between two writings of a data set, at least."""
LEFT = "left_bifurcation"
_COLUMNS = {
    "F": Column((2, 2)),
    "F_dot": Column((2, 2), unit=RATE),
    "stress": Column((2, 2), unit=STRESS),
    "status": Column(kind=np.int8, meaning={int(code): describe(code) for code in Status}),
    LEFT: Column(kind=np.int8, meaning="1: a stable state beyond a bifurcation, one of several"),
}
_TANGENT_COLUMNS = {
    name: Column((2, 2, 2, 2), unit=unit)
    for name, unit in zip(TANGENTS, (STRESS, VISCOSITY), strict=True)
}


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSetHeader(Origin):
    """What a data set is made from; two data sets with equal headers hold equal numbers.

    `tangents`: whether it holds ∂P/∂F and ∂P/∂Ḟ as well. `is_open`: whether it may get more than
    `count` samples later. `recipe` and the `reference` state of the RVEs are carried along and
    not compared.
    """

    range: SamplingRange
    count: int
    seed: int
    chunk: int
    version: str
    reference: ReferenceState | None = None
    tangents: bool = False
    is_open: bool = False

    def compared(self) -> dict[str, Any]:
        """Everything the numbers depend on, by the names a recipe uses."""
        return {
            "cell": self.cell.to_dict(),
            "rve": dict(self.rve),
            "range": asdict(self.range),
            "samples": {
                "count": None if self.is_open else self.count,
                "seed": self.seed,
                "chunk": self.chunk,
                "tangents": self.tangents,
                "sequence": SEQUENCE,
            },
            "surrofe2": {"version": self.version},
        }


class DataSetWriter:
    """A data set in the making: rows are appended in order, then it is finished."""

    def __init__(
        self,
        path: Path,
        header: DataSetHeader,
        rows: Mapping[str, np.ndarray],
        is_finished: bool,
        before: float,
    ) -> None:
        self.path, self.header, self.is_finished = path, header, is_finished
        self.meter = Meter(before)
        self._parts = [dict(rows)] if rows else []
        self._clock = CheckpointClock(INTERVAL)
        self._is_stored = bool(rows)

    @property
    def completed(self) -> int:
        """How many rows there are."""
        return sum(len(part["F"]) for part in self._parts)

    def append(
        self, F: NDArray[np.float64], F_dot: NDArray[np.float64], answer: StressResponse
    ) -> None:
        """Take the next n rows, F and Ḟ (n, 2, 2); with tangents if the data set holds them."""
        left = answer.left_bifurcation
        rows: dict[str, np.ndarray] = {"F": F, "F_dot": F_dot}
        rows |= {"stress": answer.stress, "status": answer.status}
        rows[LEFT] = np.zeros(len(F), np.int8) if left is None else left.astype(np.int8)
        if answer.tangents is not None and self.header.tangents:
            rows |= zip(TANGENTS, (answer.tangents.P_by_F, answer.tangents.P_by_F_dot), strict=True)
        self._is_stored = False
        self._parts.append({name: np.array(values) for name, values in rows.items()})
        if self._clock.is_due():
            self._clock.write(self.store)

    def left_count(self) -> int:
        """How many rows so far have a stress, but of an RVE that left a bifurcation."""
        rows = self._rows() if self.completed else None
        return 0 if rows is None else int((rows[LEFT].astype(bool) & (rows["status"] == 0)).sum())

    def status_counts(self) -> dict[int, int]:
        """How many rows so far have each status code."""
        if not self.completed:
            return {}
        codes, counts = np.unique(self._rows()["status"], return_counts=True)
        return {int(code): int(n) for code, n in zip(codes, counts, strict=True)}

    def store(self) -> None:
        """Write the rows that there are, to go on from."""
        if not self._is_stored:
            self._write("writing", {})

    def finish(self) -> StressSamples:
        """Write all rows, the list of those that failed and the fingerprint; as read back.

        Raises:
            InputError: rows are missing.
        """
        missing = self.header.count - self.completed
        if missing:
            raise InputError(f"{self.path}: {missing} samples are missing; it cannot be finished")
        if not self.is_finished:
            status = self._rows()["status"]
            index = np.flatnonzero(status)
            reasons = [describe(code) for code in status[index]]
            self._write("finished", {"index": index, "reason": reasons})
            self.is_finished = True
        return read_data_set(self.path)

    def _rows(self) -> dict[str, np.ndarray]:
        """One array for each column."""
        if len(self._parts) > 1:
            names = self._parts[0]
            whole = {name: np.concatenate([part[name] for part in self._parts]) for name in names}
            self._parts = [whole]
        return self._parts[0] if self._parts else {}

    def _write(self, status: str, failed: Mapping[str, Any]) -> None:
        with writing_hdf5(self.path) as file:
            store_columns(file, _COLUMNS | _TANGENT_COLUMNS, self._rows())
            if self.header.reference is not None:
                for name, values in attached(self.header.reference).items():
                    file[name] = values
            file.attrs.update(_attributes(self.header), status=status, completed=self.completed)
            file.attrs["seconds"] = self.meter.seconds
            if failed:
                text = h5py.string_dtype()
                file["failed/index"] = failed["index"]
                file.create_dataset("failed/reason", data=failed["reason"], dtype=text)
                file.attrs["fingerprint"] = _samples_of(file).fingerprint
        self._is_stored = True


@contextmanager
def writing_data_set(
    path: Path, header: DataSetHeader, *, fresh: bool = False
) -> Iterator[DataSetWriter]:
    """A data set to fill, or to go on with where it is there; the file has what the block took.

    Raises:
        FileError: the file is not a data set, or another process fills it.
        MismatchError: it was begun with other settings, and not `fresh`.
    """
    writer = _begun(path, header, fresh)
    if writer.is_finished and not file_lock(path).exists():
        yield writer
        return
    with locked_file(path):
        writer = _begun(path, header, fresh)  # what another process added is there now
        if not writer.completed:
            writer.store()
        try:
            yield writer
        finally:
            writer.store()


def _begun(path: Path, header: DataSetHeader, fresh: bool) -> DataSetWriter:
    rows: dict[str, np.ndarray] = {}
    is_finished, before = False, 0.0
    if path.exists() and not fresh:
        with reading(path, SCHEMA, SCHEMA_VERSION) as file:
            check_same(path, header.compared(), json.loads(stored_text(file, "compared")))
            completed = stored_number(file, "completed")
            is_finished = stored_text(file, "status") == "finished" and completed == header.count
            if completed:
                before = stored_number(file, "seconds")
                rows = stored_rows(file, _columns_in(file))
                if not len(rows["F"]) == completed <= header.count:
                    raise ValueError(f"completed: {completed:g} of {len(rows['F'])}")
    return DataSetWriter(path, header, rows, is_finished, before)


def _columns_in(file: h5py.File) -> dict[str, Column]:
    own = {name: column for name, column in _TANGENT_COLUMNS.items() if name in file}
    return _COLUMNS | own


def _attributes(header: DataSetHeader) -> dict[str, Any]:
    given = {
        "compared": json.dumps(flat(header.compared())),
        "range": json.dumps(asdict(header.range)),
        "count": header.count,
        "seed": header.seed,
    }
    if header.reference is not None:
        given["rest_length"] = header.reference.rest_length
    return header.attributes(SCHEMA, SCHEMA_VERSION) | given


class StoredCount(NamedTuple):
    """How many samples a data set has; whether it is finished, and may get more later."""

    rows: int
    is_finished: bool
    is_open: bool


def stored_count(path: Path) -> StoredCount:
    """What a data set says of its samples.

    Raises:
        FileError: not a data set of this schema, or damaged.
    """
    with reading(path, SCHEMA, SCHEMA_VERSION) as file:
        return StoredCount(
            rows=int(stored_number(file, "completed")),
            is_finished=stored_text(file, "status") == "finished",
            is_open=json.loads(stored_text(file, "compared")).get("samples.count") is None,
        )


def read_data_set(path: str | Path) -> StressSamples:
    """The samples of a finished data set, failed ones (status not 0, stress NaN) included.

    Raises:
        FileError: not a data set of this schema, or damaged.
        InputError: it is not finished.
    """
    path = Path(path)
    with reading(path, SCHEMA, SCHEMA_VERSION) as file:
        if stored_text(file, "status") != "finished":
            done, count = (stored_number(file, name) for name in ("completed", "count"))
            raise InputError(
                f"{path}: unfinished, {done:g} of {count:g} "
                "samples; continue it with `surrofe2 generate RECIPE`"
            )
        return _samples_of(file)


def _samples_of(file: h5py.File) -> StressSamples:
    arrays = stored_rows(file, _columns_in(file))
    left = arrays.pop(LEFT).astype(np.bool_)
    cell, initialisation = stored_cell(file)
    length = stored_number(file, "rest_length") if "rest_length" in file.attrs else None
    return StressSamples(
        **arrays,
        cell=cell,
        initialisation=initialisation,
        range=stored_range(file),
        seed=int(stored_number(file, "seed")),
        rest_length=length,
        left_bifurcation=left,
    )

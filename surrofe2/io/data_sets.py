"""Data sets of (F, Ḟ) → σ in HDF5, continued after a kill at any moment; schema: data/README.md."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import FileError, InputError
from surrofe2.io.arrays import Column, append_rows, completed, create_arrays
from surrofe2.io.files import check_same, flat, opened_hdf5, replacing
from surrofe2.io.kept import attached
from surrofe2.io.provenance import Origin, reading, stored_cell, stored_range
from surrofe2.plant_cell.reference_state import ReferenceState
from surrofe2.sampling import SamplingRange
from surrofe2.stress_law import Status, StressResponse, describe
from surrofe2.stress_samples import TANGENTS, StressSamples
from surrofe2.units import RATE, STRESS, VISCOSITY

SCHEMA = "surrofe2-data-set"
SCHEMA_VERSION = 1
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

    `tangents`: whether it holds ∂P/∂F and ∂P/∂Ḟ as well. `recipe` and the `reference` state of
    the RVEs are carried along and not compared.
    """

    range: SamplingRange
    count: int
    seed: int
    chunk: int
    version: str
    reference: ReferenceState | None = None
    tangents: bool = False

    def compared(self) -> dict[str, Any]:
        """Everything the numbers depend on, by the names a recipe uses."""
        return {
            "cell": self.cell.to_dict(),
            "rve": dict(self.rve),
            "range": asdict(self.range),
            "samples": {
                "count": self.count,
                "seed": self.seed,
                "chunk": self.chunk,
                "tangents": self.tangents,
            },
            "surrofe2": {"version": self.version},
        }


class DataSetWriter:
    """An open data set. Rows are appended in order; `finish_data_set` seals the file."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        self._path = path
        self._file = file

    @property
    def completed(self) -> int:
        """How many rows are safely in the file."""
        return completed(self._file)

    def append(
        self, F: NDArray[np.float64], F_dot: NDArray[np.float64], answer: StressResponse
    ) -> None:
        """Write the next n rows, F and Ḟ (n, 2, 2); with tangents if the data set holds them."""
        rows: dict[str, np.ndarray] = {"F": F, "F_dot": F_dot}
        rows |= {"stress": answer.stress, "status": answer.status}
        if answer.tangents is not None and TANGENTS[0] in self._file:
            rows |= zip(TANGENTS, (answer.tangents.P_by_F, answer.tangents.P_by_F_dot), strict=True)
        if answer.left_bifurcation is not None and LEFT in self._file:
            rows[LEFT] = answer.left_bifurcation
        append_rows(self._path, self._file, rows)

    def left_count(self) -> int:
        """How many rows so far are of RVEs that left a bifurcation."""
        return int(self._file[LEFT][: self.completed].sum()) if LEFT in self._file else 0

    def status_counts(self) -> dict[int, int]:
        """How many rows so far have each status code."""
        codes, counts = np.unique(self._file["status"][: self.completed], return_counts=True)
        return {int(code): int(n) for code, n in zip(codes, counts, strict=True)}


@contextmanager
def writing_data_set(
    path: Path, header: DataSetHeader, *, fresh: bool = False
) -> Iterator[DataSetWriter]:
    """Create a data set, or open the one that is there to continue it.

    Raises:
        FileError: the file is not a data set.
        MismatchError: it was begun with other settings, and not `fresh`.
    """
    if not path.exists() or fresh:
        columns = _COLUMNS | (_TANGENT_COLUMNS if header.tangents else {})
        fixed = {} if header.reference is None else attached(header.reference)
        create_arrays(path, columns, header.count, _attributes(header), fixed)
    with reading(path, SCHEMA, SCHEMA_VERSION) as file:
        there = {"samples.tangents": False} | json.loads(file.attrs["compared"])
        check_same(path, header.compared(), there)
    with opened_hdf5(path, "r+") as file:
        yield DataSetWriter(path, file)


def _attributes(header: DataSetHeader) -> dict[str, Any]:
    given = {
        "status": "writing",
        "compared": json.dumps(flat(header.compared())),
        "range": json.dumps(asdict(header.range)),
        "count": header.count,
        "seed": header.seed,
    }
    if header.reference is not None:
        given["rest_length"] = header.reference.rest_length
    return header.attributes(SCHEMA, SCHEMA_VERSION) | given


def finish_data_set(path: Path) -> None:
    """Seal a data set whose rows are all there: list the failed samples, set its fingerprint.

    Raises:
        InputError: rows are missing.
    """
    with replacing(path) as partial:
        partial.write_bytes(path.read_bytes())
        with h5py.File(partial, "r+") as file:
            if file.attrs["status"] == "finished":
                return
            missing = file["F"].shape[0] - completed(file)
            if missing:
                raise InputError(f"{path}: {missing} samples are missing; it cannot be finished")
            status = file["status"][:]
            index = np.flatnonzero(status)
            file["failed/index"] = index
            reasons = [describe(code) for code in status[index]]
            file.create_dataset("failed/reason", data=reasons, dtype=h5py.string_dtype())
            file.attrs["fingerprint"] = _samples_of(file).fingerprint
            file.attrs["status"] = "finished"


def read_data_set(path: str | Path) -> StressSamples:
    """The samples of a finished data set, failed ones (status not 0, stress NaN) included.

    Raises:
        FileError: not a data set of this schema, truncated, or changed since it was written.
        InputError: it is not finished.
    """
    path = Path(path)
    with reading(path, SCHEMA, SCHEMA_VERSION) as file:
        if file.attrs["status"] != "finished":
            raise InputError(
                f"{path}: unfinished, {completed(file)} of {file['F'].shape[0]} "
                "samples; continue it with `surrofe2 generate RECIPE`"
            )
        samples = _samples_of(file)
        if samples.fingerprint != file.attrs["fingerprint"]:
            raise FileError(f"{path}: its numbers changed since it was written; generate it anew")
    return samples


def _samples_of(file: h5py.File) -> StressSamples:
    given = [name for name in TANGENTS if name in file]
    arrays = {name: file[name][:] for name in ("F", "F_dot", "stress", "status", *given)}
    cell, initialisation = stored_cell(file)
    length = file.attrs.get("rest_length")
    return StressSamples(
        **arrays,
        cell=cell,
        initialisation=initialisation,
        range=stored_range(file),
        seed=int(file.attrs["seed"]),
        rest_length=None if length is None else float(length),
        left_bifurcation=file[LEFT][:].astype(np.bool_) if LEFT in file else None,
    )

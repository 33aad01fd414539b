"""Data sets of (F, Ḟ) → σ in HDF5; the schema is in data/README.md.

Every array is laid out in full at the start, and a counter says how many rows count. A row is
flushed before the counter that covers it, so the file can be continued after a kill at any
moment.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import h5py
import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import FileError, InputError
from surrofe2.io.checks import check_schema
from surrofe2.io.data_set_layout import (
    LEFT,
    SCHEMA,
    SCHEMA_VERSION,
    DataSetHeader,
    check_header,
    create_file,
    samples_of,
)
from surrofe2.io.files import opened_hdf5, replacing, reported
from surrofe2.stress_law import Tangents, describe
from surrofe2.stress_samples import StressSamples


class DataSetWriter:
    """An open, unfinished data set. Rows are appended in order; `finish` seals it."""

    def __init__(self, path: Path, file: h5py.File) -> None:
        self._path = path
        self._file = file

    @property
    def completed(self) -> int:
        """How many rows are safely in the file."""
        return int(self._file["completed"][()])

    @property
    def count(self) -> int:
        """How many rows it will have."""
        return int(self._file["F"].shape[0])

    @property
    def finished(self) -> bool:
        """Whether nothing is left to do."""
        return bool(self._file.attrs["status"] == "finished")

    def append(
        self,
        F: NDArray[np.float64],
        F_dot: NDArray[np.float64],
        stress: NDArray[np.float64],
        status: NDArray[np.int8],
        tangents: Tangents | None = None,
        left_bifurcation: NDArray[np.bool_] | None = None,
    ) -> None:
        """Write the next n rows, then count them; with tangents if the data set holds them.

        Args:
            F, F_dot, stress: (n, 2, 2); 1, 1/µs and µN/µm.
            status: (n,) codes of `Status`.
            left_bifurcation: as in `StressResponse`.
        """
        rows = slice(self.completed, self.completed + len(F))
        arrays = {"F": F, "F_dot": F_dot, "stress": stress, "status": status}
        if tangents is not None:
            arrays |= {"P_by_F": tangents.P_by_F, "P_by_F_dot": tangents.P_by_F_dot}
        if left_bifurcation is not None and LEFT in self._file:
            arrays[LEFT] = left_bifurcation
        with reported(self._path, "written"):
            for name, values in arrays.items():
                self._file[name][rows] = values
            self._file.flush()
            self._file["completed"][()] = rows.stop
            self._file.flush()

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
        create_file(path, header)
    with opened_hdf5(path, "r") as file:
        check_schema(path, file, SCHEMA, SCHEMA_VERSION, "surrofe2 data set")
        check_header(path, file, header)
    with opened_hdf5(path, "r+") as file:
        yield DataSetWriter(path, file)


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
            missing = file["F"].shape[0] - int(file["completed"][()])
            if missing:
                raise InputError(f"{path}: {missing} samples are missing; it cannot be finished")
            status = file["status"][:]
            index = np.flatnonzero(status)
            file["failed/index"] = index
            reasons = [describe(code) for code in status[index]]
            file.create_dataset("failed/reason", data=reasons, dtype=h5py.string_dtype())
            file.attrs["fingerprint"] = samples_of(path, file).fingerprint
            file.attrs["status"] = "finished"


def read_data_set(path: str | Path) -> StressSamples:
    """The samples of a finished data set, failed ones (status not 0, stress NaN) included.

    Raises:
        FileError: not a data set of this schema, truncated, or changed since it was written.
        InputError: it is not finished.
    """
    path = Path(path)
    with opened_hdf5(path, "r") as file:
        check_schema(path, file, SCHEMA, SCHEMA_VERSION, "surrofe2 data set")
        if file.attrs["status"] != "finished":
            raise InputError(
                f"{path}: unfinished, {int(file['completed'][()])} of {file['F'].shape[0]} "
                "samples; continue it with `surrofe2 generate RECIPE`"
            )
        samples = samples_of(path, file)
        if samples.fingerprint != file.attrs["fingerprint"]:
            raise FileError(f"{path}: its numbers changed since it was written; generate it anew")
    return samples


__all__ = [
    "DataSetHeader",
    "DataSetWriter",
    "finish_data_set",
    "read_data_set",
    "writing_data_set",
]

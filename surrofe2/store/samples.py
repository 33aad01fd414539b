"""Samples (F, Ḟ) → σ: data sets of a range, and harvests of runs; schema: data/README.md.

A data set is continued after a kill at any moment: while samples are computed, it is written again
every few seconds, whole, with all rows that there are. A harvest has the stresses of RVEs that a
run has computed. The settled reference state of an RVE is kept in the cache folder.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array
from surrofe2.base.clock import Meter
from surrofe2.base.errors import FileError, InputError
from surrofe2.base.kernel_cache import cache_folder
from surrofe2.base.sampling import SEQUENCE, SamplingRange
from surrofe2.base.units import RATE, STRESS, VISCOSITY
from surrofe2.law.samples import TANGENTS, StressSamples
from surrofe2.law.stress_law import Status, StressResponse, describe
from surrofe2.plant_cell.arrangement import ReferenceState
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.run.loop import CheckpointClock
from surrofe2.rve.unit_cell import settle_reference
from surrofe2.store.hdf5 import (
    ORIGIN,
    Column,
    Kind,
    check_same_rve,
    origin,
    read,
    read_header,
    reading,
    write,
)
from surrofe2.store.store import check_replaceable, check_same, file_lock, flat, locked_file

Arrays = dict[str, NDArray[Any]]

# Seconds between two writings of a data set, at least.
INTERVAL = 5.0
# Name of the column that says whether a state is beyond a bifurcation.
LEFT = "left_bifurcation"
# Reasons for which a state of a harvest was computed, by the code in its column `why`.
WHY = {
    0: "asked of the RVE because the cache might not answer",
    1: "audit of the cache's answer",
    2: "neighbour of such a state",
    3: "sample of the range widened to hold such states",
}
_CODES = json.dumps({int(code): describe(code) for code in Status})
_COLUMNS = {
    "F": Column((None, 2, 2)),
    "F_dot": Column((None, 2, 2), unit=RATE),
    "stress": Column((None, 2, 2), unit=STRESS),
    "status": Column(kind=np.int8, meaning=_CODES),
}
_LEFT_COLUMN = Column(
    kind=np.int8, meaning="1: a stable state beyond a bifurcation, one of several"
)
_OF_TANGENTS = {
    name: Column((None, 2, 2, 2, 2), unit=unit, optional=True)
    for name, unit in zip(TANGENTS, (STRESS, VISCOSITY), strict=True)
}
_OF_MAKING = {"status": str, "completed": int, "seconds": float | None, "compared": dict}
_OF_SAMPLES = {"range": SamplingRange, "count": int, "seed": int, "rest_length": float | None}
DATA_SET = Kind(
    "data set",
    2,
    ORIGIN | _OF_MAKING | _OF_SAMPLES,
    _COLUMNS | {LEFT: _LEFT_COLUMN} | _OF_TANGENTS,
)
HARVEST = Kind(
    "harvest", 2, ORIGIN, _COLUMNS | {"why": Column(kind=np.int8, meaning=json.dumps(WHY))}
)
REFERENCE = Kind("reference state", 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSetHeader:
    """The settings of a data set; two data sets with equal headers hold equal numbers.

    Attributes:
        cell: plant cell of the RVE.
        rve: settings of the RVE, by the names of a recipe.
        recipe: the whole recipe, for the record; it is not compared.
        range: range of (F, Ḟ).
        count: number of samples.
        seed: seed of their sequence.
        chunk: samples that are computed at once, on which warm starts depend.
        version: version of the package that computes them.
        rest_length: wall rest length in µm, for the record; it is not compared.
        tangents: whether it holds ∂P/∂F and ∂P/∂Ḟ as well.
        is_open: whether it may get more than `count` samples later.
    """

    cell: CellParameters
    rve: Mapping[str, Any]
    recipe: Mapping[str, Any]
    range: SamplingRange
    count: int
    seed: int
    chunk: int
    version: str
    rest_length: float | None = None
    tangents: bool = False
    is_open: bool = False

    def compared(self) -> dict[str, Any]:
        """Return everything that the numbers depend on, by the names that a recipe uses."""
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

    def entries(self) -> dict[str, Any]:
        """Return the entries of the file's header."""
        return {
            **origin(self.cell, str(self.rve["initialisation"]), recipe=self.recipe, rve=self.rve),
            "compared": flat(self.compared()),
            "range": asdict(self.range),
            "count": self.count,
            "seed": self.seed,
            "rest_length": self.rest_length,
        }


def rows_of(F: Array, F_dot: Array, answer: StressResponse) -> dict[str, Any]:
    """Return the columns of samples at F, Ḟ (n, 2, 2): these, the stress, and tangents if any."""
    left_bifurcation = answer.left_bifurcation
    if left_bifurcation is None:
        left_bifurcation = np.zeros(len(F), np.bool_)
    rows = {
        "F": F,
        "F_dot": F_dot,
        "stress": answer.stress,
        "status": answer.status,
        LEFT: left_bifurcation,
    }
    if answer.tangents is not None:
        rows |= zip(TANGENTS, (answer.tangents.P_by_F, answer.tangents.P_by_F_dot), strict=True)
    return rows


class SampleWriter:
    """A file of samples in the making: rows are taken in parts, each whole or not at all."""

    _stored: int | None = None
    """Number of rows in the file; None where it must be written even without new rows."""

    def __init__(self, path: Path, kind: Kind, header: Mapping[str, Any]) -> None:
        self.path = path
        self.kind = kind
        self.header = header
        self._parts: list[Arrays] = []

    @property
    def completed(self) -> int:
        """Number of rows that were taken."""
        return sum(len(part["F"]) for part in self._parts)

    def take(self, **rows: Any) -> None:
        """Take the next rows by column."""
        columns = self.kind.columns
        part: Arrays = {}
        for name, values in rows.items():
            part[name] = np.array(values, columns[name].kind)
        self._parts.append(part)

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Hold the rows that `to_arrays` has returned, and no others."""
        columns = {name: arrays[name] for name in self.kind.columns if name in arrays}
        self._parts = [columns] if len(columns["F"]) else []

    def to_arrays(self) -> Arrays:
        """Return all rows, one array for each column; empty ones before there are any."""
        if not self._parts:
            return {
                name: np.empty((0, 2, 2)[: len(column.shape)], column.kind)
                for name, column in self.kind.columns.items()
                if not column.optional
            }
        if len(self._parts) > 1:
            # the joined rows take the place of the parts, so that they are not joined again
            names = self._parts[0]
            joined = {name: np.concatenate([part[name] for part in self._parts]) for name in names}
            self._parts = [joined]
        return self._parts[0]

    def write(self, **entries: Any) -> None:
        """Write all rows so far, and these entries of the header, if there are new ones."""
        if self._stored != self.completed:
            write(self.path, self.kind, {**self.header, **entries}, self.to_arrays())
            self._stored = self.completed


class DataSetWriter(SampleWriter):
    """A data set in the making: rows are appended in order, then it is finished.

    It begins with the rows that are in the file, unless it is `fresh`.
    """

    def __init__(self, path: Path, header: DataSetHeader, fresh: bool) -> None:
        super().__init__(path, DATA_SET, header.entries())
        self.is_finished = False
        seconds_before = None
        if path.exists() and not fresh:
            stored, rows = read(path, DATA_SET)
            check_same(path, header.compared(), stored["compared"])
            completed = stored["completed"]
            if completed != len(rows["F"]) or completed > header.count:
                raise FileError(
                    f"{path}: not a whole {DATA_SET.title}: completed: {completed} of "
                    f"{len(rows['F'])}"
                )
            self.restore(rows)
            self._stored = completed or None  # a file without rows is written again
            self.is_finished = stored["status"] == "finished" and completed == header.count
            seconds_before = stored["seconds"]
        self.meter = Meter(seconds_before or 0.0)
        self._clock = CheckpointClock(INTERVAL)

    def append(self, F: Array, F_dot: Array, answer: StressResponse) -> None:
        """Take the next n rows, F and Ḟ (n, 2, 2), and write the file where that is due."""
        self.take(**rows_of(F, F_dot, answer))
        if self._clock.is_due():
            self._clock.write(self.store)

    def store(self, status: str = "writing") -> None:
        """Write the rows that there are, from which another process may resume."""
        self.write(status=status, completed=self.completed, seconds=self.meter.seconds)

    def finish(self) -> StressSamples:
        """Write all rows, none of which is missing, and return the data set as read back."""
        if not self.is_finished:
            self._stored = None  # all rows may be stored already, by a header that says "writing"
            self.store("finished")
            self.is_finished = True
        return read_data_set(self.path)


@contextmanager
def writing_data_set(
    path: Path, header: DataSetHeader, *, fresh: bool = False
) -> Iterator[DataSetWriter]:
    """Open a data set to fill, or to resume; the file has all rows that the block takes.

    Args:
        fresh: start over, whatever data set is there.

    Raises:
        FileError: the file is not a data set, or another process fills it.
        MismatchError: it was begun with other settings, and not `fresh`.
    """
    if fresh:
        check_replaceable(path, DATA_SET.title, DATA_SET.schema)
    writer = DataSetWriter(path, header, fresh)
    if writer.is_finished and not file_lock(path).exists():
        yield writer
        return
    with locked_file(path):
        writer = DataSetWriter(path, header, fresh)  # again: another process may have added rows
        if not writer.completed:
            writer.store()
        try:
            yield writer
        finally:
            writer.store()


class StoredCount(NamedTuple):
    """The size of a data set in a file.

    Attributes:
        rows: number of samples.
        is_finished: whether none of those wanted is missing.
        is_open: whether more may be added later.
    """

    rows: int
    is_finished: bool
    is_open: bool


def stored_count(path: Path) -> StoredCount:
    """Read the size of a data set from its header."""
    header = read_header(path, DATA_SET)
    return StoredCount(
        rows=header["completed"],
        is_finished=header["status"] == "finished",
        is_open=header["compared"].get("samples.count") is None,
    )


def read_data_set(path: str | Path) -> StressSamples:
    """Read the samples of a finished data set, failed ones (status not 0, stress NaN) included.

    Raises:
        FileError: not a data set of this schema, or damaged.
        InputError: it is not finished.
    """
    path = Path(path)
    with reading(path, DATA_SET) as stored:
        header = stored.header()
        if header["status"] == "finished":
            rows: dict[str, Any] = stored.arrays()
            _check_codes("left_bifurcation", rows[LEFT], (0, 1))
            rows[LEFT] = rows[LEFT].astype(np.bool_)
            return StressSamples(
                **rows,
                cell=header["cell"],
                initialisation=header["initialisation"],
                range=header["range"],
                seed=header["seed"],
                rest_length=header["rest_length"],
            )
    raise InputError(
        f"{path}: unfinished, {header['completed']} of {header['count']} samples; continue it with "
        "`surrofe2 generate RECIPE`"
    )


class Harvest(NamedTuple):
    """A harvest that was read from a file.

    `StressSamples` describes the fields; `why` (n,) has the codes of `WHY`.
    """

    F: Array
    F_dot: Array
    stress: Array
    status: NDArray[np.int8]
    why: NDArray[np.int8]
    cell: CellParameters
    initialisation: str


class HarvestWriter(SampleWriter):
    """The writer of a harvest, which a `CachedLaw` calls as its `on_true_answer`.

    `flush` writes the file again, with all that was taken so far.
    """

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        super().__init__(path, HARVEST, header)
        self._stored = 0  # there is no file without answers

    def __call__(
        self, F: Array, F_dot: Array, stress: Array, status: NDArray[np.int8], why: NDArray[np.int8]
    ) -> None:
        """Take stresses (n, 2, 2) of RVEs at F and Ḟ, with status and reason (n,)."""
        if len(F):
            self.take(F=F, F_dot=F_dot, stress=stress, status=status, why=why)

    def flush(self, seconds: float = 0.0) -> None:
        """Write all stresses so far, and the seconds that they took."""
        self.write(seconds=seconds)


def read_harvest(path: str | Path) -> Harvest:
    """Read a harvest, each state once; the run may have been interrupted."""
    with reading(Path(path), HARVEST) as stored:
        arrays = stored.arrays()
        header = stored.header()
        _check_codes("status", arrays["status"], [*Status])
        _check_codes("why", arrays["why"], [*WHY])
        if not np.isfinite(arrays["stress"][arrays["status"] == 0]).all():
            raise ValueError("stress: not finite where the status is 0")
    states = np.concatenate([arrays["F"], arrays["F_dot"]], axis=1).reshape(-1, 8)
    _, first = np.unique(states, axis=0, return_index=True)
    first.sort()  # in the order of the run
    once: dict[str, Any] = {name: values[first] for name, values in arrays.items()}
    return Harvest(**once, **header)


def _check_codes(name: str, codes: NDArray[np.int8], known: Sequence[int]) -> None:
    """Raise a ValueError where a column has a code that means nothing."""
    others = np.setdiff1d(codes, known)
    if others.size:
        raise ValueError(f"{name}: {others[0]}; known are {', '.join(str(int(k)) for k in known)}")


def kept_reference(cell: CellParameters) -> ReferenceState:
    """Return the settled reference state of a cell, from the cache folder where it is there.

    The first command settles it and keeps it for commands of these very sources.
    """
    path = cache_folder() / "references" / f"{cell.fingerprint}.h5"
    with suppress(FileError), reading(path, REFERENCE) as stored:
        reference = ReferenceState.from_arrays(stored.arrays())
        reference.check_belongs_to(cell)
        return reference
    settled = settle_reference(cell)
    with suppress(FileError):  # a folder that cannot be written keeps nothing
        write(path, REFERENCE, {}, settled.to_arrays())
    return settled


# Reject a harvest of another RVE; arguments: path, harvest, cell and initialisation.
check_harvest = partial(check_same_rve, "harvested", "leave it out")

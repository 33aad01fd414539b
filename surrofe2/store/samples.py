"""Samples (F, Ḟ) → σ: data sets of a range, and harvests of runs; schema: data/README.md.

A data set is continued after a kill at any moment: while samples are computed, it is written again
every few seconds, whole, with all rows that there are. A harvest has the answers of RVEs that a run
has paid for. The settled reference state of an RVE is kept in the cache folder.
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

INTERVAL = 5.0
"""Seconds between two writings of a data set, at least."""
LEFT = "left_bifurcation"
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
_MARK = Column(kind=np.int8, meaning="1: a stable state beyond a bifurcation, one of several")
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
    _COLUMNS | {LEFT: _MARK} | _OF_TANGENTS,
)
HARVEST = Kind(
    "harvest", 2, ORIGIN, _COLUMNS | {"why": Column(kind=np.int8, meaning=json.dumps(WHY))}
)
REFERENCE = Kind("reference state", 2)


@dataclass(frozen=True, slots=True, kw_only=True)
class DataSetHeader:
    """What a data set is made from; two data sets with equal headers hold equal numbers.

    `tangents`: whether it holds ∂P/∂F and ∂P/∂Ḟ as well. `is_open`: whether it may get more than
    `count` samples later. `recipe` and `rest_length` are carried along and not compared.
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

    def entries(self) -> dict[str, Any]:
        return {
            **origin(self.cell, str(self.rve["initialisation"]), recipe=self.recipe, rve=self.rve),
            "compared": flat(self.compared()),
            "range": asdict(self.range),
            "count": self.count,
            "seed": self.seed,
            "rest_length": self.rest_length,
        }


def rows_of(F: Array, F_dot: Array, answer: StressResponse) -> dict[str, Any]:
    """The columns of samples: F, Ḟ (n, 2, 2) and the answer there, with its tangents if any."""
    left = (
        np.zeros(len(F), np.bool_) if answer.left_bifurcation is None else answer.left_bifurcation
    )
    rows = {"F": F, "F_dot": F_dot, "stress": answer.stress, "status": answer.status, LEFT: left}
    if answer.tangents is not None:
        rows |= zip(TANGENTS, (answer.tangents.P_by_F, answer.tangents.P_by_F_dot), strict=True)
    return rows


class SampleWriter:
    """A file of samples in the making: rows are taken in parts, each whole or not at all."""

    _stored: int | None = None
    """Rows in the file."""

    def __init__(self, path: Path, kind: Kind, header: Mapping[str, Any]) -> None:
        self.path, self.kind, self.header = path, kind, header
        self._parts: list[Arrays] = []

    @property
    def completed(self) -> int:
        return sum(len(part["F"]) for part in self._parts)

    def take(self, **rows: Any) -> None:
        """Take the next rows by column."""
        columns = self.kind.columns
        self._parts.append({name: np.array(v, columns[name].kind) for name, v in rows.items()})

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Hold these rows, of `to_arrays`, and no others."""
        arrays = {name: arrays[name] for name in self.kind.columns if name in arrays}
        self._parts = [arrays] if len(arrays["F"]) else []

    def to_arrays(self) -> Arrays:
        """All rows, one array for each column; empty ones before there are any."""
        if not self._parts:
            of = {name: each for name, each in self.kind.columns.items() if not each.optional}
            return {k: np.empty((0, 2, 2)[: len(c.shape)], c.kind) for k, c in of.items()}
        if len(self._parts) > 1:
            names = self._parts[0]
            whole = {name: np.concatenate([part[name] for part in self._parts]) for name in names}
            self._parts = [whole]
        return self._parts[0]

    def write(self, **entries: Any) -> None:
        """Write all rows so far, and these entries of the header, if there are new ones."""
        if self._stored != self.completed:
            write(self.path, self.kind, {**self.header, **entries}, self.to_arrays())
            self._stored = self.completed


class DataSetWriter(SampleWriter):
    """A data set in the making: rows are appended in order, then it is finished. It begins with
    the rows that are in the file, unless `fresh`."""

    def __init__(self, path: Path, header: DataSetHeader, fresh: bool) -> None:
        super().__init__(path, DATA_SET, header.entries())
        self.is_finished, before = False, None
        if path.exists() and not fresh:
            known, rows = read(path, DATA_SET)
            check_same(path, header.compared(), known["compared"])
            done, there, before = known["completed"], len(rows["F"]), known["seconds"]
            if not there == done <= header.count:
                raise FileError(
                    f"{path}: not a whole {DATA_SET.title}: completed: {done} of {there}"
                )
            self.restore(rows)
            self._stored = done or None
            self.is_finished = known["status"] == "finished" and done == header.count
        self.meter, self._clock = Meter(before or 0.0), CheckpointClock(INTERVAL)

    def append(self, F: Array, F_dot: Array, answer: StressResponse) -> None:
        """Take the next n rows, F and Ḟ (n, 2, 2)."""
        self.take(**rows_of(F, F_dot, answer))
        if self._clock.is_due():
            self._clock.write(self.store)

    def store(self, status: str = "writing") -> None:
        """Write the rows that there are, to resume from."""
        self.write(status=status, completed=self.completed, seconds=self.meter.seconds)

    def finish(self) -> StressSamples:
        """Write all rows, none of which is missing; as read back."""
        if not self.is_finished:
            self._stored = None  # if all are, as of one that is not finished
            self.store("finished")
            self.is_finished = True
        return read_data_set(self.path)


@contextmanager
def writing_data_set(
    path: Path, header: DataSetHeader, *, fresh: bool = False
) -> Iterator[DataSetWriter]:
    """A data set to fill, or to resume where it is there; the file has what the block took.

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
        writer = DataSetWriter(path, header, fresh)  # what another process added is there now
        if not writer.completed:
            writer.store()
        try:
            yield writer
        finally:
            writer.store()


class StoredCount(NamedTuple):
    """How many samples a data set has; whether it is finished, and may get more later."""

    rows: int
    is_finished: bool
    is_open: bool


def stored_count(path: Path) -> StoredCount:
    """What a data set says of its samples."""
    known = read_header(path, DATA_SET)
    may_grow = known["compared"].get("samples.count") is None
    return StoredCount(known["completed"], known["status"] == "finished", may_grow)


def read_data_set(path: str | Path) -> StressSamples:
    """The samples of a finished data set, failed ones (status not 0, stress NaN) included.

    Raises:
        FileError: not a data set of this schema, or damaged.
        InputError: it is not finished.
    """
    path = Path(path)
    with reading(path, DATA_SET) as stored:
        known = stored.header()
        if known["status"] == "finished":
            rows: dict[str, Any] = stored.arrays()
            _check_codes("left_bifurcation", rows[LEFT], (0, 1))
            rows[LEFT] = rows[LEFT].astype(np.bool_)
            of = {name: known[name] for name in (*ORIGIN, "range", "seed", "rest_length")}
            return StressSamples(**rows, **of)
    raise InputError(
        f"{path}: unfinished, {known['completed']} of {known['count']} samples; continue it with "
        "`surrofe2 generate RECIPE`"
    )


class Harvest(NamedTuple):
    """A harvest read back; arrays as in `StressSamples`, and `why` (n,) as in `WHY`."""

    F: Array
    F_dot: Array
    stress: Array
    status: NDArray[np.int8]
    why: NDArray[np.int8]
    cell: CellParameters
    initialisation: str


class HarvestWriter(SampleWriter):
    """Takes answers as `CachedLaw(on_true_answer=…)` gives them; `flush` writes the file again."""

    def __init__(self, path: Path, header: Mapping[str, Any]) -> None:
        super().__init__(path, HARVEST, header)
        self._stored = 0  # there is no file without answers

    def __call__(
        self, F: Array, F_dot: Array, stress: Array, status: NDArray[np.int8], why: NDArray[np.int8]
    ) -> None:
        """Take answers, (n, 2, 2) and (n,)."""
        if len(F):
            self.take(F=F, F_dot=F_dot, stress=stress, status=status, why=why)

    def flush(self, seconds: float = 0.0) -> None:
        """Write all answers so far, and the seconds that they took."""
        self.write(seconds=seconds)


def read_harvest(path: str | Path) -> Harvest:
    """The answers in a harvest, each state once, also of a run that was interrupted."""
    with reading(Path(path), HARVEST) as stored:
        arrays, header = stored.arrays(), stored.header()
        _check_codes("status", arrays["status"], [*Status])
        _check_codes("why", arrays["why"], [*WHY])
        if not np.isfinite(arrays["stress"][arrays["status"] == 0]).all():
            raise ValueError("stress: not finite where the status is 0")
    states = np.concatenate([arrays["F"], arrays["F_dot"]], axis=1).reshape(-1, 8)
    _, first = np.unique(states, axis=0, return_index=True)
    first.sort()
    once: dict[str, Any] = {name: values[first] for name, values in arrays.items()}
    return Harvest(**once, **header)


def _check_codes(name: str, codes: NDArray[np.int8], known: Sequence[int]) -> None:
    """A ValueError at a code of a column that means nothing."""
    others = np.setdiff1d(codes, known)
    if others.size:
        raise ValueError(f"{name}: {others[0]}; known are {', '.join(str(int(k)) for k in known)}")


def kept_reference(cell: CellParameters) -> ReferenceState:
    """The settled reference state of a cell; the first command puts it into the cache folder, where
    it is kept for commands of these very sources."""
    path = cache_folder() / "references" / f"{cell.fingerprint}.h5"
    with suppress(FileError), reading(path, REFERENCE) as stored:
        known = ReferenceState.from_arrays(stored.arrays())
        known.check_belongs_to(cell)
        return known
    settled = settle_reference(cell)
    with suppress(FileError):  # a folder that cannot be written keeps nothing
        write(path, REFERENCE, {}, settled.to_arrays())
    return settled


check_harvest = partial(check_same_rve, "harvested", "leave it out")
"""Refuse a harvest of other plant cells: path, harvest, and the cell and initialisation wanted."""

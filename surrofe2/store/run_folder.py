"""Run folders: run.json, tables of curves, history and energies, fields, checkpoint.h5."""

from __future__ import annotations

import hashlib
import json
import logging
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass, field, fields, replace
from datetime import UTC, datetime
from importlib.metadata import version
from operator import attrgetter
from pathlib import Path
from types import MappingProxyType
from typing import Any, Protocol, TypeVar

import numpy as np

from surrofe2.base.errors import (
    FileError,
    InputError,
    MismatchError,
    SimulationError,
    Surrofe2Error,
    quoted,
    shortened,
)
from surrofe2.base.interruption import held, interruptible
from surrofe2.base.settings import check_value, hints_of
from surrofe2.base.units import ENERGY, FORCE, LENGTH, NONE, STRESS, TIME
from surrofe2.base.versions import describe_platform
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.run.journal import BEYOND, CROSSINGS
from surrofe2.run.responses import STRAIN_NAME, STRESS_NAME, Response, responses
from surrofe2.run.views import Facts, ViewedRun, course
from surrofe2.store.fields import (
    FIELDS,
    POINTS,
    frame_files,
    is_of_points,
    open_fields,
    read_fields,
    split_unit,
)
from surrofe2.store.hdf5 import Kind, check_units, read, write
from surrofe2.store.store import (
    check_replaceable,
    check_same,
    digest,
    folder_lock,
    leftovers,
    locked_folder,
    plain,
    read_columns,
    read_json,
    remove,
    reported,
    write_bytes,
    write_columns,
    write_json,
    write_text,
)

log = logging.getLogger(__name__)

# Name and version of the format of run.json.
SCHEMA = "surrofe2-run"
SCHEMA_VERSION = 3
CHECKPOINT = "checkpoint.h5"
# The log of what happened in a run, one JSON object a line.
EVENTS = "events.jsonl"
# A state from which a run resumes: any arrays; `of` names the law of the run.
STATE = Kind("checkpoint", 2, {"of": str})
# Seconds between two checkpoints, at least.
CHECKPOINT_INTERVAL = 5.0
# All files that a run folder may have, but for those of `_SERIES`.
FILES = (
    "run.json", "curve.csv", "history.csv", "energies.csv", "path.csv", "fields.xdmf", "fields.h5",
    "fields-last.xdmf", "points.xdmf", "points.h5", "points-last.xdmf", CHECKPOINT, "table.h5",
    "harvest.h5", EVENTS,
)  # fmt: skip
# The folder, in that of a run, of the files from which the run can be repeated.
INPUT = "input"
# The recipe among them, as the run took it, with defaults filled in.
RECIPE = "recipe.toml"
# The file of stresses that RVEs computed in a cached run; of several cells see `of_cell`.
HARVEST = "harvest.h5"
# The file of the table that a run by one has learnt; of several cells see `of_cell`.
TABLE = "table.h5"
# Patterns of names: a file in `INPUT`, and one of what the cache of a run has computed or learnt.
_OF_INPUT = re.compile(rf"{INPUT}/[^/]+")
_LEARNT = re.compile(r"(harvest|table)(-[^/]+)?\.h5")
_FRAMES = (frame_files(FIELDS), frame_files(POINTS))
# Patterns of files of which a run may have several.
_SERIES = ("harvest-*.h5", "table-*.h5", *_FRAMES, f"{INPUT}/*")
# Sections of a recipe in which users name the entries.
_NAMED_ENTRIES = ("cells", "conditions", "bodies", "watch")
_SECTIONS = (
    "cell", "rve", "mesh", *_NAMED_ENTRIES, "time", "macro", "tissue", "image", "rest",
    "surface",
)  # fmt: skip
# Sections of a cell on which a run depends by its surrogate alone.
_OF_TRAINING = ("range", "samples", "training")
# Laws on which the section [cache] has no effect.
_WITHOUT_CACHE = ("rve", "surrogate", "tissue")
UNITS = {
    "time": TIME, "length": LENGTH, "energy": ENERGY, "stress": STRESS, "force": FORCE,
    "wall_time": "s",
}  # fmt: skip
# Bytes of a CSV file of a run, which is read whole.
_MOST_OF_A_TABLE = 2**30
CURVE_HEADER = ("t_us", "u_x_um", "u_y_um")
# VTK's numbers of lines, triangles, quadrilaterals and six-node triangles, by their nodes.
_VTK_KINDS = {2: 3, 3: 5, 4: 9, 6: 22}
# Beginnings of the names of columns with components of a displacement.
_COMPONENTS = CURVE_HEADER[1:]


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """The content of run.json: what was computed, by what, how it ended and what it cost.

    Attributes:
        status: "running", "finished", "interrupted" or "failed".
        error: message of a failed run, else None.
        recipe: the whole recipe, defaults filled in.
        law: "rve", "surrogate", "cached", "table", or "tissue" for the full microscopic one.
        surrogate: file name, fingerprint and held-out errors of the surrogate, or None.
        wall_time: seconds: total = law + macro, cpu of all threads; compilation came before.
        counts: steps, stress calls and what the law's answers cost: RVE solves (of these the
            `audits` and those for a table, `table_rve_solves`), hits, fallbacks by reason, …
        rolled_back: the same of steps that audits took back, which do not count among `counts`.
        cache: of a cached law, `CachedLaw.report`; of several cells, that of each under `cells`.
        met: extremes of F, Ḟ, U and RᵀḞ at all points; `stretch`, `shear`, `rate` as in a
            recipe's range that would hold the run; `displacement`, the largest of watched points
            and boundaries, µm; of a rest also the displacement of the `watched` point.
        problem: counts of the mesh, its names, conditions, bodies and watched points; of a
            run also the largest `penetration` of each body, µm.
        ranks: of a run on several: how many and of how many threads each, how many exchanges,
            seconds of the law on the slowest rank and of messages, since the run last resumed.
        files: SHA-256 of each CSV file and the event log, as they were when this was written.
        inputs: SHA-256 of each file in `INPUT`.
        replaces: files of the folder's former run that are still to be removed.
    """

    status: str
    recipe: Mapping[str, Any]
    law: str
    initialisation: str
    solver: str
    package_version: str
    created: str
    cell_fingerprint: str
    threads: int
    error: str | None = None
    seed: int | None = None
    surrogate: Mapping[str, Any] | None = None
    wall_time: Mapping[str, float] = field(default_factory=dict)
    counts: Mapping[str, int] = field(default_factory=dict)
    rolled_back: Mapping[str, int] = field(default_factory=dict)
    cache: Mapping[str, Any] | None = None
    met: Mapping[str, Any] = field(default_factory=dict)
    problem: Mapping[str, Any] = field(default_factory=dict)
    platform: Mapping[str, str] = field(default_factory=dict)
    ranks: Mapping[str, Any] | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    inputs: Mapping[str, str] = field(default_factory=dict)
    replaces: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=UNITS.copy)

    @property
    def duration(self) -> float:
        """Duration that the recipe states, µs."""
        return float(self.recipe["time"]["duration"])

    @property
    def spent(self) -> Mapping[str, int]:
        """The counts above 0, of steps that stand and of those rolled back together."""
        return dict(Counter(self.counts) + Counter(self.rolled_back))

    def compared(self) -> dict[str, Any]:
        """Return everything that the numbers depend on, by the names that a recipe uses."""
        recipe = self.recipe
        compared: dict[str, Any] = {}
        sections = [*_SECTIONS]
        if self.law not in _WITHOUT_CACHE:
            sections.append("cache")
        for section in sections:
            for key, value in recipe.get(section, {}).items():
                compared[f"{section}.{key}"] = value
        for name, cell in recipe.get("cells", {}).items():
            compared[f"cells.{name}"] = {k: v for k, v in cell.items() if k not in _OF_TRAINING}
        for section in _NAMED_ENTRIES:
            if section in recipe:
                compared[section] = list(recipe[section])  # the names in their order
        rest = recipe.get("rest", {})  # of a run in time there is none
        return {
            **compared,
            "rest.factor": rest.get("factor"),
            "rest.load_steps": rest.get("load_steps"),
            "rest.correct": rest.get("correct", False),
            "law": self.law,
            "initialisation": self.initialisation,
            "solver": self.solver,
            "surrogate": self.surrogate and self.surrogate["fingerprint"],
            "version": self.package_version,
        }


@dataclass(frozen=True, slots=True, repr=False)
class StoredRun(ViewedRun):
    """A run read from its folder, with results as `MacroRun` has them; none without a file."""

    folder: Path
    record: RunRecord

    @property
    def name(self) -> str:
        """The name of its folder, in characters that can be drawn and printed."""
        return str(plain(self.folder.name))

    @property
    def is_rest(self) -> bool:
        """True for a rest, whose curves are over the factor of the load instead of time."""
        return is_rest(self.record)

    @property
    def responses(self) -> list[Response]:
        """Forces over displacements of supports, loads and bodies; see `run.responses`."""
        return [*responses(self.history, self.record.problem.get("places", {}))]

    @property
    def caches(self) -> dict[str, Mapping[str, Any]]:
        """The reports of its caches, by its name and that of the cell where there are several."""
        caches = caches_of(self.record.cache)
        return {
            self.name if cell is None else f"{self.name}, {cell}": report
            for cell, report in caches.items()
        }

    def fields_over_time(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Read whole fields of the folder and their coordinates, as `xarray.Dataset` takes them.

        There are none where the folder has no fields. Names are those of a run from Python.
        """
        if not (self.folder / f"{FIELDS}.h5").exists():
            return {}, {}
        stored = read_fields(self.folder, (), None)
        values: dict[str, Any] = {"elements": (("element", "corner"), stored.cells)}
        for column, array in stored.values.items():
            name, unit = split_unit(column)
            of_points = is_of_points(column, array.shape[1], len(stored.cells))
            where = "node" if of_points else "element"
            axes = {2: (), 3: ("axis",), 4: ("row", "column")}[array.ndim]
            values[f"field {name}"] = ("frame", where, *axes), array, {"units": unit}
        unit = NONE if self.is_rest else TIME
        return values, {
            "frame": ("frame", stored.t, {"units": unit}),
            "position": (("node", "axis"), stored.points, {"units": LENGTH}),
        }

    def to_pyvista(self, frame: int = -1) -> Any:
        """Make a `pyvista.UnstructuredGrid` of the unloaded mesh with all fields of one frame.

        `run.to_pyvista().warp_by_vector("displacement_um").plot()` shows the deformed mesh.

        Args:
            frame: number of the frame; −1 is the last one.

        Returns:
            The grid, with fields of nodes and elements under the names of fields.xdmf, vectors
            and tensors with zeros outside the plane, and the time or load factor as `t`.

        Raises:
            InputError: pyvista is not installed, or there is no such frame.
            FileError: the folder has no fields, or they are damaged.
        """
        try:
            import pyvista
        except ModuleNotFoundError:
            raise InputError(
                "to_pyvista: pyvista is not installed; install it: pip install pyvista"
            ) from None
        series = open_fields(self.folder)
        if not isinstance(frame, int | np.integer):
            raise InputError(f"frame: {quoted(frame)}; it must be a whole number")
        if not -series.count <= frame < series.count:
            raise InputError(f"frame: {frame}; there are {series.count} of them, from 0")
        frame %= series.count
        corners = series.cells.shape[1]
        counted = np.insert(series.cells, 0, corners, axis=1)
        kinds = np.full(len(series.cells), _VTK_KINDS[corners], np.uint8)
        grid = pyvista.UnstructuredGrid(counted.ravel(), kinds, _in_space(series.points))
        for name, values in series.frame(frame, (), None).items():
            of_points = is_of_points(name, len(values), len(series.cells))
            data = grid.point_data if of_points else grid.cell_data
            data[name] = values if values.ndim == 1 else _in_space(values)
        grid.field_data["t"] = [series.t[frame]]
        return grid

    def facts(self) -> Facts:
        """Return what a notebook shows of the run."""
        record = self.record
        named = []
        for name, cell in cells_of(record.recipe).items():
            preset = cell.get("preset", "none")
            named.append(preset if name is None else f"{name}: {preset}")
        return {
            "folder": plain(str(self.folder)),
            "law": f"{record.law}, {record.initialisation}",
            "plant cell": ", ".join(named) or "none",
            **course(self.curve, record.wall_time, record.counts, is_rest=self.is_rest),
            "RVE solves": f"{record.counts.get('rve_solves', 0):,}",
        }


def _in_space(values: np.ndarray) -> np.ndarray:
    """Return vectors (n, 2) as (n, 3), and tensors (n, 2, 2) as (n, 9), zero outside the plane."""
    padded = np.pad(values, [(0, 0), *[(0, 1)] * (values.ndim - 1)])
    return padded.reshape(len(values), -1)


def is_rest(record: RunRecord) -> bool:
    """Return whether a record is of a rest, not of a run in time."""
    return "rest" in record.recipe


def earlier_run(folder: Path, record: RunRecord) -> RunRecord | None:
    """Return the record of an earlier call of this very run in a folder; None: there is none.

    Raises:
        FileError: the folder has files but no run.
        MismatchError: it has a run of other settings.
    """
    path = folder / "run.json"
    if not path.exists():
        with reported(folder, "read"):
            entries = set(folder.iterdir() if folder.is_dir() else ())
        if entries - {folder_lock(folder), *leftovers(path)}:
            raise FileError(f"{folder}: has files but no run; write elsewhere or say --fresh")
        return None
    earlier = read_record(folder)
    check_same(folder, record.compared(), earlier.compared())
    return earlier


State = TypeVar("State")
Result = TypeVar("Result")
# Writes the files of a result, whole or partial, and returns the record with its cost.
Store = Callable[[RunRecord, Any], RunRecord]


class Job(Protocol[State, Result]):
    """A computation that `RunFolder.compute` carries out, begun or resumed from a checkpoint.

    It is called in this order: `restored` where there is a checkpoint, `compute`, which calls
    `RunFolder.checkpoint` meanwhile, `store`, and `close`. Where `compute` fails, `store` is called
    with the part of the result that is there.

    Attributes:
        record: the record that the run begins with.
        inputs: contents, by name, of the files from which the run can be repeated.
    """

    @property
    def record(self) -> RunRecord: ...

    @property
    def inputs(self) -> Mapping[str, bytes]: ...

    def restored(self, arrays: dict[str, np.ndarray]) -> State:
        """Return the state that a checkpoint holds."""
        ...

    def compute(self, run: RunFolder, state: State | None) -> Result:
        """Compute the result, from a state or from the beginning."""
        ...

    def store(self, record: RunRecord, result: Result) -> RunRecord:
        """Write the files of a result, whole or not, and return the record with what it came to."""
        ...

    def close(self) -> None:
        """Remove what only an unfinished run needs, once the run is recorded as finished."""
        ...


@dataclass(slots=True)
class RunFolder:
    """A run in its folder: begun or resumed, checkpointed, and finished, failed or interrupted.

    `compute` carries out a `Job`; `open` is for results that are there already.

    Attributes:
        record: the record that run.json has now.
        partial: result that is stored where the run ends early by an error without one.
        cache: report of a cached law at the last checkpoint.
        inputs: contents, by name, of the files from which the run can be repeated.
        has_begun: whether run.json is that of this run, and no longer that of a former one.
        is_finished: whether run.json says that it is finished, as then it stays.
        resumes: whether the run resumes from a checkpoint of an earlier call.
    """

    folder: Path
    record: RunRecord
    store: Store
    partial: Any = None
    cache: Mapping[str, Any] | None = None
    inputs: Mapping[str, bytes] = field(default_factory=dict)
    has_begun: bool = False
    is_finished: bool = False
    resumes: bool = False

    @classmethod
    def compute(cls, folder: Path, job: Job[Any, Any], *, fresh: bool = False) -> RunRecord:
        """Carry a job out in a folder and return its record; a run that is finished is kept.

        Raises:
            FileError, MismatchError: as of `open`.
            SimulationError: the run could not be carried on; the folder holds it up to there.
        """
        with cls.open(folder, job.record, job.store, inputs=job.inputs, fresh=fresh) as run:
            if not run.is_finished:
                state = run.restored(job.restored)
                run.finish(job.compute(run, state))
                job.close()
        return run.record

    @classmethod
    @contextmanager
    def open(
        cls,
        folder: Path,
        record: RunRecord,
        store: Store,
        *,
        inputs: Mapping[str, bytes] = MappingProxyType({}),
        fresh: bool = False,
    ) -> Iterator[RunFolder]:
        """Open a run that nobody else writes meanwhile; one that an earlier call finished is kept.

        The results of a run that fails or is interrupted are stored. Whatever ends the block,
        run.json says how.

        Args:
            inputs: contents, by name, of the files from which the run can be repeated.

        Raises:
            FileError: the folder cannot be written, has files but no run, or is in use.
            MismatchError: it has a run of other settings, and not `fresh`.
        """
        digests = {name: hashlib.sha256(content).hexdigest() for name, content in inputs.items()}
        run = cls(folder, replace(record, inputs=digests), store, inputs=inputs)
        state = folder / CHECKPOINT
        if fresh:  # which replaces nothing that may be of something else than a run
            check_replaceable(folder / "run.json", "surrofe2 run", SCHEMA)
            patterns = (*FILES, *_SERIES)
            files = [path for pattern in patterns for path in sorted(folder.glob(pattern))]
            if files and not (folder / "run.json").exists():
                name = files[0].relative_to(folder)
                raise FileError(
                    f"{folder}: has {name} but no run, so --fresh does not replace it; write "
                    "elsewhere"
                )
        earlier = None if fresh else earlier_run(folder, record)
        # Where lock or checkpoint is there, the process ended after its last file.
        is_whole = earlier is not None and earlier.status == "finished"
        is_whole &= not (folder_lock(folder).exists() or state.exists())
        with nullcontext() if is_whole else locked_folder(folder):
            if not (is_whole or fresh):
                earlier = earlier_run(folder, record)  # another process may have ended meanwhile
            try:
                with interruptible():
                    if earlier is not None and earlier.status == "finished":
                        run.record = earlier
                        run.is_finished = True
                        remove(state)
                        log.info("%s: finished before; --fresh starts over", folder)
                    else:
                        run.resumes = earlier is not None and state.exists()
                        run._begin()
                    yield run
            except BaseException as error:
                # A run that could not begin has ended nothing: the folder has the former one.
                if run.has_begun and not run.is_finished:
                    run._end_by(error)
                raise

    def _begin(self) -> None:
        """Record that the run is running, and remove the files of a former one.

        They are removed after the record is written, so that a kill in between leaves one run or
        the other. Harvests, tables and inputs have names that users give to files of their own,
        such as table-2.h5: those that the former run's record implies are removed, and what ends
        the process in between leaves their list in the new record.
        """
        if self.resumes:
            self._write_first_record()
            return
        replaced = _former_files(self.folder)
        remove(self.folder / CHECKPOINT)
        self.record = replace(self.record, replaces=replaced)
        self._write_first_record()
        others = [name for name in FILES[1:] if name not in (HARVEST, TABLE)]
        for pattern in (*others, *_FRAMES):
            for path in self.folder.glob(pattern):
                remove(path)
        for name in replaced:
            remove(self.folder / name)
        for name, content in self.inputs.items():
            write_bytes(self.folder / INPUT / name, content)
        if replaced:
            self.record = replace(self.record, replaces=())
            write_record(self.folder, self.record)

    def _write_first_record(self) -> None:
        """Replace the former run's record by this one's, and know it, without an interruption."""
        with held():
            write_record(self.folder, self.record)
            self.has_begun = True

    def restored(self, restore: Callable[[dict[str, np.ndarray]], State]) -> State | None:
        """Restore the state of the last checkpoint; None where the run starts at its beginning.

        Raises:
            FileError: the checkpoint is of another run, or `restore` fails on it.
        """
        if not self.resumes:
            return None
        path = self.folder / CHECKPOINT
        header, arrays = read(path, STATE)
        if header["of"] != self._kind:
            stored = shortened(header["of"], 60)
            raise FileError(f"{path}: a checkpoint of {stored}, not of {self._kind}")
        try:
            return restore(arrays)
        except (SimulationError, FileError, MismatchError):
            raise
        except Exception as error:
            why = error if isinstance(error, InputError) else type(error).__name__
            log.debug("%s: no state of this run", path, exc_info=error)
            raise FileError(
                f"{path}: no state of this run ({why}); start over with --fresh; --traceback "
                "shows where it failed"
            ) from error

    def checkpoint(
        self, arrays: Mapping[str, np.ndarray], cache: Mapping[str, Any] | None = None
    ) -> None:
        """Write a state to resume from; `cache` is the report of a cached law there."""
        write(self.folder / CHECKPOINT, STATE, {"of": self._kind}, arrays)
        self.cache = cache

    def finish(self, result: Any) -> None:
        """Store a whole result; run.json comes last, so a finished record has all its files."""
        self._end("finished" if getattr(result, "finished", True) else "failed", result)
        self.is_finished = True
        remove(self.folder / CHECKPOINT)

    def _end_by(self, error: BaseException) -> None:
        """Record which error ended the run, and store the results that there are.

        Raises:
            FileError: the results of a failed or interrupted simulation could not be stored.
        """
        status = "failed"
        partial = self.partial
        message: str | None = str(error)
        if isinstance(error, FileError):
            partial = None  # the disk may be full for this too
        elif isinstance(error, SimulationError):
            partial = self.partial if error.partial is None else error.partial
        elif not isinstance(error, Exception):
            status = "interrupted"
            message = None
        elif not isinstance(error, Surrofe2Error):
            message = f"{type(error).__name__}: {error}".rstrip(": ")
        try:
            self._end(status, partial, message)
        except BaseException as second:
            # There may be no room for results, but the state of the run is true all the same.
            with suppress(Exception):
                self._end(status, error=message)
            # The first error is the one to report, unless the second loses results.
            lost = isinstance(error, SimulationError | KeyboardInterrupt)
            if lost or not isinstance(second, Exception):
                raise
            log.debug("%s: its end could not be recorded whole", self.folder, exc_info=second)

    def _end(self, status: str, result: Any = None, error: str | None = None) -> None:
        """Store a result, where there is one, and record how the run ended."""
        self.record = replace(self.record, status=status, error=error, cache=self.cache)
        if result is not None:
            self.record = self.store(self.record, result)
        write_record(self.folder, self.record)

    @property
    def _kind(self) -> str:
        """Words for the run, by which a checkpoint of another law is recognised."""
        return f"a {self.record.law} run"


def of_cell(file: str, cell: str | None) -> str:
    """Return the file's name with that of the cell, harvest-skin.h5, if the cell has a name."""
    if cell is None:
        return file
    name, dot, kind = file.rpartition(".")
    return f"{name}-{cell}{dot}{kind}"


def cells_of(recipe: Mapping[str, Any]) -> dict[str | None, Mapping[str, Any]]:
    """Return the cells in the recipe of a record by name; that of [cell] has none."""
    if "cell" in recipe:
        return {None: recipe["cell"]}
    return dict(recipe.get("cells", {}))


def _former_files(folder: Path) -> tuple[str, ...]:
    """Return the names of harvests, tables and inputs that the run of a folder may have written."""
    try:
        stored = read_json(folder / "run.json")
    except FileError:  # no run, or nobody knows which
        return ()
    recipe = stored.get("recipe")
    cells = recipe.get("cells") if isinstance(recipe, dict) else None
    names = [*cells] if cells and isinstance(cells, dict) else [None]
    law = stored.get("law")
    harvests = [of_cell(HARVEST, name) for name in names if law in ("cached", "table")]
    tables = [of_cell(TABLE, name) for name in names if law == "table"]
    former = [str(name) for name in stored.get("replaces", ())]  # a kill kept these there
    inputs = [f"{INPUT}/{name}" for name in stored.get("inputs", ())]
    named = (*harvests, *tables, *inputs, *former)
    return tuple(name for name in named if _LEARNT.fullmatch(name) or _OF_INPUT.fullmatch(name))


def describe_origin() -> dict[str, Any]:
    """Return when and by what a record is made, by the names of its entries."""
    import numba  # late: programs that only read runs need none of it

    return {
        "package_version": version("surrofe2"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "threads": numba.get_num_threads(),
        "platform": describe_platform(),
    }


def caches_of(cache: Mapping[str, Any] | None) -> dict[str | None, Mapping[str, Any]]:
    """Return the reports in a record's `cache` by name of the cell; that of [cell] has none."""
    if not cache:
        return {}
    return dict(cache["cells"]) if "cells" in cache else {None: cache}


def write_record(folder: Path, record: RunRecord) -> None:
    """Write run.json, with the digests of the tables beside it."""
    tables = [folder / name for name in FILES if name.endswith((".csv", ".jsonl"))]
    record = replace(record, files={path.name: digest(path) for path in tables if path.exists()})
    header = {"schema": SCHEMA, "schema_version": SCHEMA_VERSION}
    write_json(folder / "run.json", header | asdict(record))


def read_record(folder: Path) -> RunRecord:
    """Read run.json; a FileError where it is missing, damaged or of another schema."""
    path = folder / "run.json"
    if not path.exists():
        raise FileError(f"{folder}: no run.json, so not a run; make one with `surrofe2 run`")
    stored = read_json(path)
    if stored.pop("schema", None) != SCHEMA:
        raise FileError(f"{path}: not the record of a surrofe2 run")
    schema_version = stored.pop("schema_version", None)
    known = {item.name for item in fields(RunRecord)}
    if schema_version != SCHEMA_VERSION or not known.issuperset(stored):
        raise FileError(
            f"{path}: run schema {quoted(schema_version)}; this surrofe2 reads {SCHEMA_VERSION}: "
            "run it again elsewhere"
        )
    try:
        record = RunRecord(**stored)
        for name, hint in hints_of(RunRecord).items():
            check_value(name, attrgetter(name)(record), hint, {})
        for name in (*_SECTIONS, "cache"):
            section = record.recipe.get(name, {})
            cells = section.values() if name == "cells" else ()
            for table in (section, *cells):
                if not isinstance(table, dict):
                    raise ValueError(f"recipe.{name}: {quoted(table)}; it must be a table")
        check_units("numbers of the run", record.units, UNITS)
        if record.surrogate is not None:
            record.surrogate["fingerprint"]
        check_value("recipe.duration", record.duration, float, {"above": 0.0})
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        reason = shortened(str(error), 80)
        raise FileError(f"{path}: not a whole record of a surrofe2 run: {reason}") from None
    return record


def write_curves(
    folder: Path,
    curves: Mapping[str, DisplacementCurve],
    history: Mapping[str, np.ndarray],
    energies: Mapping[str, np.ndarray],
    *,
    is_rest: bool = False,
) -> None:
    """Write curve.csv, history.csv and energies.csv; of a rest path.csv for the first two.

    Args:
        curves: displacements of watched points by name, all at m times, or factors of the load.
        history: (m,) forces in µN, places in µm and numbers of points by name, as `MacroRun` has
            them.
        energies: (m,) energies by name, pJ.
    """
    t = next(iter(curves.values())).t
    points = {
        f"u_{axis}_um {name if k else ''}".rstrip(): column
        for k, (name, curve) in enumerate(curves.items())
        for axis, column in zip("xy", curve.displacement.T, strict=True)
    }
    moved = {f"{name}_{_unit_of(name)}": values for name, values in history.items()}
    works = {f"{name}_pJ": values for name, values in energies.items()}
    if is_rest:
        write_columns(folder / "path.csv", {"factor": t, **points, **moved})
        write_columns(folder / "energies.csv", {"factor": t, **works})
        return
    for name, columns in (("curve.csv", points), ("history.csv", moved), ("energies.csv", works)):
        write_columns(folder / name, {"t_us": t, **columns})


def _unit_of(name: str) -> str:
    """Return the unit of a column of a history as it stands in the column's name in a file."""
    if name == BEYOND:
        return "points"
    if name.startswith(STRESS_NAME):
        return "MPa"
    if name.startswith(STRAIN_NAME):
        return "1"
    if name == CROSSINGS:
        return "pairs"
    if name.startswith("impulse "):
        return "uNus"
    return "uN" if name.startswith("force ") else "um"


def read_run(folder: str | Path, *, finished: bool = True) -> StoredRun:
    """Read a finished run; with `finished` False also one that has results but no end.

    Raises:
        FileError: not a run folder, or damaged.
        InputError: the run is not finished, and what to do.

    Examples:
        >>> from surrofe2 import LoadCase, RveLaw, read_run, save_run, simulate
        >>> bar = LoadCase(elements=(1, 1), duration=5.0)
        >>> record = save_run(simulate(bar, RveLaw("apple")), "out/bar")
        >>> run = read_run("out/bar")
        >>> run.name, run.record.status
        ('bar', 'finished')
        >>> len(run.curve.t)  # 5 µs, a row each half
        11
    """
    folder = Path(folder)
    record = read_record(folder)
    table = "path.csv" if is_rest(record) else "curve.csv"
    is_there = not finished and (folder / table).exists()
    if record.status != "finished" and not is_there:
        raise InputError(f"{folder}: the run is {record.status}; its command resumes it")
    for name, wanted in record.files.items():
        if name not in FILES:
            raise FileError(f"{folder / 'run.json'}: files: {quoted(name)} is no file of a run")
        if digest(folder / name, _MOST_OF_A_TABLE) != wanted:
            raise FileError(f"{folder / name}: damaged, or changed since the run was recorded")
    columns = _checked_columns(folder / table, is_rest(record))
    clock, *_ = columns
    components = [name for name in columns if name.startswith(_COMPONENTS)]
    names = [next(iter(record.problem.get("watched", ())), "watched point")]
    names += [name.partition("_um ")[2] for name in components[2::2]]
    curves = {
        name: DisplacementCurve(columns[clock], np.stack([columns[x], columns[y]], axis=1))
        for name, x, y in zip(names, components[::2], components[1::2], strict=True)
    }
    # path.csv has in the same table what history.csv has of a run
    others = {name: columns[name] for name in columns if name not in (clock, *components)}
    return StoredRun(
        folder,
        record,
        curve=curves[names[0]],
        curves=curves,
        history=_without_units(others | _over_clock(folder / "history.csv")),
        energies=_without_units(_over_clock(folder / "energies.csv")),
    )


def check_inputs(folder: Path, record: RunRecord) -> Path:
    """Check the files from which a run can be repeated, and return the path of its recipe.

    Raises:
        FileError: the run has none, or one of them is missing, damaged or changed.
    """
    if RECIPE not in record.inputs:
        raise FileError(
            f"{folder}: it keeps no {INPUT}/{RECIPE}, as runs saved from Python or by earlier "
            "versions; run its recipe instead"
        )
    for name, wanted in record.inputs.items():
        path = folder / INPUT / name
        if Path(name).name != name:
            raise FileError(f"{folder / 'run.json'}: inputs: {quoted(name)} is no name of a file")
        if digest(path) != wanted:
            raise FileError(
                f"{path}: damaged, or changed since the run was recorded; to run a changed recipe, "
                "copy the folder of its inputs elsewhere and run that recipe"
            )
    return folder / INPUT / RECIPE


def _checked_columns(path: Path, of_rest: bool) -> dict[str, np.ndarray]:
    """Read curve.csv or path.csv, whose first columns are the clock and a displacement.

    Raises:
        FileError: it is no such table, or its clock does not go one way.
    """
    header = ("factor", *CURVE_HEADER[1:]) if of_rest else CURVE_HEADER
    no_table = FileError(f"{path}: not a table of {','.join(header)}")
    columns = read_columns(path)
    if tuple(columns)[:3] != header:
        raise no_table
    clock = columns[header[0]]
    components = [name for name in columns if name.startswith(_COMPONENTS)]
    has_others = len(columns) > 1 + len(components)
    if len(components) % 2 or not clock.size or (has_others and not of_rest):
        raise no_table
    if not np.isfinite([*columns.values()]).all():
        raise no_table
    # a factor may fall from 0 to a negative one
    direction = np.sign(clock[-1]) if of_rest else 1.0
    if (direction * np.diff(clock) <= 0.0).any():
        raise no_table
    return columns


def _over_clock(path: Path) -> dict[str, np.ndarray]:
    """Read the columns of a table without the first, its clock; none where it is not there."""
    if not path.exists():
        return {}
    _, *others = read_columns(path).items()
    return dict(others)


def _without_units(columns: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return columns by their names without the unit."""
    return {name.rpartition("_")[0]: values for name, values in columns.items()}


def write_events(folder: Path, decisions: Iterable[Mapping[str, Any]]) -> None:
    """Write events.jsonl whole, a decision of a cached law a line; run.json has its SHA-256."""
    lines = [json.dumps(plain(decision), ensure_ascii=False) for decision in decisions]
    write_text(folder / EVENTS, "".join(f"{line}\n" for line in lines))

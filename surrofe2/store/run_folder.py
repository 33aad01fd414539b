"""Run folders: run.json, tables of curves, history and energies, fields, checkpoint.h5."""

from __future__ import annotations

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
from typing import Any, TypeVar

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
from surrofe2.base.interruption import interruptible
from surrofe2.base.settings import check_value, hints_of
from surrofe2.base.units import ENERGY, FORCE, LENGTH, STRESS, TIME
from surrofe2.base.versions import describe_platform
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.run.journal import BEYOND
from surrofe2.run.responses import STRAIN_NAME, STRESS_NAME, Response, responses
from surrofe2.run.views import Facts, ViewedRun, course
from surrofe2.store.fields import FIELDS, POINTS, frame_files
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
    write_columns,
    write_json,
    write_text,
)

log = logging.getLogger(__name__)

SCHEMA = "surrofe2-run"
SCHEMA_VERSION = 3
CHECKPOINT, EVENTS = "checkpoint.h5", "events.jsonl"
STATE = Kind("checkpoint", 2, {"of": str})
"""What a run resumes from: any arrays, `of` a run by a law."""
CHECKPOINT_INTERVAL = 5.0
"""Seconds between two checkpoints, at least."""
FILES = (
    "run.json", "curve.csv", "history.csv", "energies.csv", "path.csv", "fields.xdmf", "fields.h5",
    "fields-last.xdmf", "points.xdmf", "points.h5", "points-last.xdmf", CHECKPOINT, "table.h5",
    "harvest.h5", EVENTS,
)  # fmt: skip
HARVEST, TABLE = "harvest.h5", "table.h5"
"""What a cached run has learnt, and a run by a table; of several cells see `of_cell`."""
_LEARNT = re.compile(r"(harvest|table)(-[^/]+)?\.h5")
_FRAMES = (frame_files(FIELDS), frame_files(POINTS))
_SERIES = ("harvest-*.h5", "table-*.h5", *_FRAMES)
"""Patterns of files of which a run may have several."""
_NAMED_ENTRIES = ("cells", "conditions", "bodies", "watch")
"""Sections of a recipe in which users name what there is."""
_SECTIONS = (
    "cell", "rve", "mesh", *_NAMED_ENTRIES, "time", "macro", "tissue", "rest", "surface",
)  # fmt: skip
_OF_TRAINING = ("range", "samples", "training")
"""Sections of a cell that a run does not depend on but by its surrogate."""
_WITHOUT_CACHE = ("rve", "surrogate", "tissue")
UNITS = {
    "time": TIME, "length": LENGTH, "energy": ENERGY, "stress": STRESS, "force": FORCE,
    "wall_time": "s",
}  # fmt: skip
_MOST_OF_A_TABLE = 2**30
"""Bytes of a table of a run, which is read whole."""
CURVE_HEADER = ("t_us", "u_x_um", "u_y_um")


@dataclass(frozen=True, slots=True, kw_only=True)
class RunRecord:
    """What run.json says: what was computed, by what, how it ended and what it cost.

    Attributes:
        status: "running", "finished", "interrupted" or "failed"; error: of a failed run, else None.
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
            and boundaries, µm. Of a rest, also where the `watched` point
            came to.
        problem: counts of the mesh, its names, conditions, bodies and watched points; of a
            run also the largest `penetration` of each body, µm.
        ranks: of a run on several: how many and of how many threads each, how many exchanges,
            seconds of the law on the slowest rank and of messages, since the run last resumed.
        files: SHA-256 of each CSV file and the event log, as they were when this was written.
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
    replaces: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=UNITS.copy)

    @property
    def duration(self) -> float:
        return float(self.recipe["time"]["duration"])

    @property
    def spent(self) -> Mapping[str, int]:
        """Counts of what stands and of what was rolled back together; those above 0."""
        return dict(Counter(self.counts) + Counter(self.rolled_back))

    def compared(self) -> dict[str, Any]:
        """Everything the numbers depend on, by the names a recipe uses."""
        recipe, rest = self.recipe, self.recipe.get("rest", {})
        sections = (*_SECTIONS, *(() if self.law in _WITHOUT_CACHE else ("cache",)))
        return {
            **{f"{name}.{key}": v for name in sections for key, v in recipe.get(name, {}).items()},
            **{
                f"cells.{name}": {k: v for k, v in cell.items() if k not in _OF_TRAINING}
                for name, cell in recipe.get("cells", {}).items()
            },
            **{name: list(recipe[name]) for name in _NAMED_ENTRIES if name in recipe},
            "rest.factor": rest.get("factor"),  # of other runs, whose law may be the same, nothing
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
    """A run read back from its folder, with results as `MacroRun` has them; none without a file."""

    folder: Path
    record: RunRecord

    @property
    def name(self) -> str:
        """What people call it: its folder, in characters that can be drawn and printed."""
        return str(plain(self.folder.name))

    @property
    def is_rest(self) -> bool:
        """Whether it is a rest, whose curves are over the factor of the load instead of time."""
        return is_rest(self.record)

    @property
    def clock(self) -> str:
        """What its curves are over, as an axis of a picture says."""
        return "load factor" if self.is_rest else "time (µs)"

    @property
    def responses(self) -> list[Response]:
        """Forces over displacements of supports, loads and bodies; see `run.responses`."""
        return [*responses(self.history, self.record.problem.get("places", {}))]

    @property
    def caches(self) -> dict[str, Mapping[str, Any]]:
        """What its caches reported, by its name and that of the cell where there are several."""
        caches = caches_of(self.record.cache)
        return {f"{self.name}, {cell}" if cell else self.name: caches[cell] for cell in caches}

    def facts(self) -> Facts:
        record, recipe = self.record, self.record.recipe
        cells = {"": recipe["cell"]} if "cell" in recipe else recipe.get("cells", {})
        presets = {name: cell.get("preset", "none") for name, cell in cells.items()}
        named = [f"{name}: {preset}" if name else preset for name, preset in presets.items()]
        return {
            "folder": plain(str(self.folder)),
            "law": f"{record.law}, {record.initialisation}",
            "plant cell": ", ".join(named) or "none",
            **course(self.curve, record.wall_time, record.counts),
            "RVE solves": f"{record.counts.get('rve_solves', 0):,}",
        }


def is_rest(record: RunRecord) -> bool:
    """Whether a record is of a rest, not of a run in time."""
    return "rest" in record.recipe


def earlier_run(folder: Path, record: RunRecord) -> RunRecord | None:
    """The record of this very run that an earlier call left in a folder, if there is one; FileError
    where the folder has files but no run, MismatchError where it has a run of other settings."""
    path = folder / "run.json"
    if not path.exists():
        with reported(folder, "read"):
            there = set(folder.iterdir() if folder.is_dir() else ())
        if there - {folder_lock(folder), *leftovers(path)}:
            raise FileError(f"{folder}: has files but no run; write elsewhere or say --fresh")
        return None
    earlier = read_record(folder)
    check_same(folder, record.compared(), earlier.compared())
    return earlier


State = TypeVar("State")
Store = Callable[[RunRecord, Any], RunRecord]
"""Writes the files of a result, whole or partial; gives the record with what it cost."""


@dataclass(slots=True)
class RunFolder:
    """A run in its folder: begun or resumed, checkpointed, and finished, failed or interrupted.

        with RunFolder.open(folder, record, store) as run:
            if not run.is_finished:
                state = run.restored(State.from_arrays)
                run.finish(simulate(…, checkpoint=run.checkpoint, resume=state))

    Attributes:
        record: what run.json says now.
        partial: what to store where the run ends early and its error carries nothing.
        cache: what a cached law reported of itself at the last checkpoint.
        is_finished: whether run.json says that it is finished, as then it stays.
        resumes: whether the run resumes from a checkpoint of an earlier call.
    """

    folder: Path
    record: RunRecord
    store: Store
    partial: Any = None
    cache: Mapping[str, Any] | None = None
    is_finished: bool = False
    resumes: bool = False

    @classmethod
    @contextmanager
    def open(
        cls, folder: Path, record: RunRecord, store: Store, *, fresh: bool = False
    ) -> Iterator[RunFolder]:
        """A run that nobody else writes meanwhile; one that an earlier call finished is kept.

        A run that fails or is interrupted leaves what it computed. Whatever ends the block,
        run.json says how.

        Raises:
            FileError: the folder cannot be written, has files but no run, or is in use.
            MismatchError: it has a run of other settings, and not `fresh`.
        """
        run, state = cls(folder, record, store), folder / CHECKPOINT
        if fresh:  # which replaces nothing that may be of something else than a run
            check_replaceable(folder / "run.json", "surrofe2 run", SCHEMA)
            there = [path for each in (*FILES, *_SERIES) for path in sorted(folder.glob(each))]
            if there and not (folder / "run.json").exists():
                name = there[0].relative_to(folder)
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
            with interruptible():
                if earlier is not None and earlier.status == "finished":
                    run.record = earlier
                    run.is_finished = True
                    remove(state)
                    log.info("%s: finished before; --fresh starts over", folder)
                else:
                    run.resumes = earlier is not None and state.exists()
                    # An error in here ends no run: the folder has the former one, or one that
                    # began and was left, as by a kill.
                    run._begin()
            try:
                with interruptible():
                    yield run
            except BaseException as error:
                if not run.is_finished:
                    run._end_by(error)
                raise

    def _begin(self) -> None:
        """Record that the run is running; at its beginning it finds nothing of another one, which
        is removed afterwards, so that a kill in between leaves one run or the other.

        Harvests and tables have names that users give to files of their own, such as table-2.h5:
        those that the former run's record implies are removed, and a kill in between leaves their
        list in the new one.
        """
        if self.resumes:
            write_record(self.folder, self.record)
            return
        replaced = _learnt_files(self.folder)
        remove(self.folder / CHECKPOINT)
        write_record(self.folder, replace(self.record, replaces=replaced))
        others = [name for name in FILES[1:] if name not in (HARVEST, TABLE)]
        for pattern in (*others, *_FRAMES):
            for path in self.folder.glob(pattern):
                remove(path)
        for name in replaced:
            remove(self.folder / name)
        if replaced:
            write_record(self.folder, self.record)

    def restored(self, restore: Callable[[dict[str, np.ndarray]], State]) -> State | None:
        """What `restore` makes of the last checkpoint, whose fault it is if that fails; None where
        the run starts at its beginning."""
        if not self.resumes:
            return None
        path = self.folder / CHECKPOINT
        header, arrays = read(path, STATE)
        if header["of"] != self._kind:
            there = shortened(header["of"], 60)
            raise FileError(f"{path}: a checkpoint of {there}, not of {self._kind}")
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
        """Write a state to resume from; `cache` is what a cached law reports of itself there."""
        write(self.folder / CHECKPOINT, STATE, {"of": self._kind}, arrays)
        self.cache = cache

    def finish(self, result: Any) -> None:
        """Store a whole result; run.json comes last, so a finished record has all its files."""
        self._end("finished" if getattr(result, "finished", True) else "failed", result)
        self.is_finished = True
        remove(self.folder / CHECKPOINT)

    def _end_by(self, error: BaseException) -> None:
        """Say which error ended the run, and store what there is of it.

        Raises:
            FileError: what a failed simulation or an interrupt left could not be stored.
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
            # The first error is the one to report, unless what it left is lost by the second.
            lost = isinstance(error, SimulationError | KeyboardInterrupt)
            if lost or not isinstance(second, Exception):
                raise
            log.debug("%s: its end could not be recorded whole", self.folder, exc_info=second)

    def _end(self, status: str, result: Any = None, error: str | None = None) -> None:
        """Store what there is and say how the run ended."""
        self.record = replace(self.record, status=status, error=error, cache=self.cache)
        if result is not None:
            self.record = self.store(self.record, result)
        write_record(self.folder, self.record)

    @property
    def _kind(self) -> str:
        return f"a {self.record.law} run"


def of_cell(file: str, cell: str) -> str:
    """The file's name with that of the cell, "" of the only one: harvest-skin.h5."""
    name, dot, kind = file.rpartition(".")
    return f"{name}-{cell}{dot}{kind}" if cell else file


def _learnt_files(folder: Path) -> tuple[str, ...]:
    """Names of the harvests and tables that the run recorded in a folder may have left there."""
    try:
        stored = read_json(folder / "run.json")
    except FileError:  # no run, or nobody knows which
        return ()
    recipe = stored.get("recipe")
    cells = recipe.get("cells") if isinstance(recipe, dict) else None
    names = [*cells] if cells and isinstance(cells, dict) else [""]
    law = stored.get("law")
    harvests = [of_cell(HARVEST, name) for name in names if law in ("cached", "table")]
    tables = [of_cell(TABLE, name) for name in names if law == "table"]
    former = [str(each) for each in stored.get("replaces", ())]
    return tuple(name for name in (*harvests, *tables, *former) if _LEARNT.fullmatch(name))


def describe_origin() -> dict[str, Any]:
    """When and by what a record is made, by the names that it has."""
    import numba  # late: who only reads runs needs none of it

    return {
        "package_version": version("surrofe2"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "threads": numba.get_num_threads(),
        "platform": describe_platform(),
    }


def caches_of(cache: Mapping[str, Any] | None) -> dict[str, Mapping[str, Any]]:
    """The reports in a record's `cache` by name of the cell, which is "" where there is one."""
    return dict(cache.get("cells", {"": cache})) if cache else {}


def write_record(folder: Path, record: RunRecord) -> None:
    """Write run.json, with the digests of the tables beside it."""
    tables = [folder / name for name in FILES if name.endswith((".csv", ".jsonl"))]
    record = replace(record, files={path.name: digest(path) for path in tables if path.exists()})
    header = {"schema": SCHEMA, "schema_version": SCHEMA_VERSION}
    write_json(folder / "run.json", header | asdict(record))


def read_record(folder: Path) -> RunRecord:
    """The record in run.json; FileError: missing, damaged, or of another schema."""
    path = folder / "run.json"
    if not path.exists():
        raise FileError(f"{folder}: no run.json, so not a run; make one with `surrofe2 run`")
    stored = read_json(path)
    if stored.pop("schema", None) != SCHEMA:
        raise FileError(f"{path}: not the record of a surrofe2 run")
    found = stored.pop("schema_version", None)
    known = {item.name for item in fields(RunRecord)}
    if found != SCHEMA_VERSION or not known.issuperset(stored):
        raise FileError(
            f"{path}: run schema {quoted(found)}; this surrofe2 reads {SCHEMA_VERSION}: run it "
            "again elsewhere"
        )
    try:
        record = RunRecord(**stored)
        for name, hint in hints_of(RunRecord).items():
            check_value(name, attrgetter(name)(record), hint, {})
        for name in (*_SECTIONS, "cache"):
            section = record.recipe.get(name, {})
            for one in (section, *(section.values() if name == "cells" else ())):
                if not isinstance(one, dict):
                    raise ValueError(f"recipe.{name}: {quoted(one)}; it must be a table")
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
        curves: of watched points by name, all at m times, or factors of the load.
        history: (m,) forces in µN, places in µm and numbers of points by name, as `MacroRun` has
            them.
        energies: (m,) pJ by name.
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
    """The unit of a column of a history, as its name in a file has it."""
    if name == BEYOND:
        return "points"
    if name.startswith(STRESS_NAME):
        return "MPa"
    if name.startswith(STRAIN_NAME):
        return "1"
    return "uN" if name.startswith("force ") else "um"


def read_run(folder: str | Path, *, finished: bool = True) -> StoredRun:
    """A finished run; with `finished` False also what there is of another.

    Raises:
        FileError: not a run folder, or damaged.
        InputError: the run is not finished, and what to do.
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
    path = folder / table
    columns = read_columns(path)
    # path.csv has in the same table what history.csv has of a run
    moved = {name: columns[name] for name in columns if not name.startswith(("u_x_um", "u_y_um"))}
    t = next(iter(moved.values()), np.empty(0))
    clock = next(iter(moved), None)
    known = [name for name in columns if name not in moved]
    header = ("factor", *CURVE_HEADER[1:]) if is_rest(record) else CURVE_HEADER
    whole = tuple(columns)[:3] == header and len(known) % 2 == 0 and t.size > 0
    # a factor may fall from 0 to a negative one
    steps = np.diff(t) * (np.sign(t[-1]) if is_rest(record) and t.size else 1.0)
    if not whole or not np.isfinite([*columns.values()]).all() or (steps <= 0.0).any():
        raise FileError(f"{path}: not a table of {','.join(header)}")
    if not is_rest(record) and len(moved) > 1:
        raise FileError(f"{path}: not a table of {','.join(header)}")
    names = [next(iter(record.problem.get("watched", ())), "watched point")]
    names += [name.partition("_um ")[2] for name in known[2::2]]
    pairs = zip(names, known[::2], known[1::2], strict=True)
    curves = {
        name: DisplacementCurve(t, np.stack([columns[x], columns[y]], axis=1))
        for name, x, y in pairs
    }
    history = {name: values for name, values in moved.items() if name != clock}
    energies: dict[str, np.ndarray] = {}
    for path, into in ((folder / "history.csv", history), (folder / "energies.csv", energies)):
        if path.exists():
            _, *others = read_columns(path).items()
            into.update(others)
    history, energies = (
        {name.rpartition("_")[0]: values for name, values in each.items()}  # without unit
        for each in (history, energies)
    )
    return StoredRun(folder, record, curve=curves[names[0]], curves=curves,
                     history=history, energies=energies)  # fmt: skip


def write_events(folder: Path, decisions: Iterable[Mapping[str, Any]]) -> None:
    """Write events.jsonl whole, a decision of a cached law a line; run.json has its SHA-256."""
    lines = [json.dumps(plain(each), ensure_ascii=False) for each in decisions]
    write_text(folder / EVENTS, "".join(f"{line}\n" for line in lines))

"""One run in its folder: begun, checkpointed, and finished, failed or interrupted."""

from __future__ import annotations

import logging
import os
import platform
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numba
import numpy as np

from surrofe2.costs import processor
from surrofe2.errors import FileError, InputError, MismatchError, SimulationError
from surrofe2.recipe import Recipe
from surrofe2.store.hdf5 import read_checkpoint, write_checkpoint
from surrofe2.store.run_folder import (
    CHECKPOINT,
    RunRecord,
    earlier_run,
    open_run_folder,
    write_record,
)
from surrofe2.store.store import folder_lock, locked_folder, remove
from surrofe2.units import time_text as time_text

log = logging.getLogger(__name__)

CHECKPOINT_INTERVAL = 5.0  # s

Report = Callable[[float, str], None]
"""Is told how much is done and a remark."""
Stage = Callable[[str, float, str], AbstractContextManager[Report]]
"""Begins to display a stage: what is done, how much of it, in which unit."""
Store = Callable[[RunRecord, Any], RunRecord]
"""Writes the files of a result, whole or partial; gives the record with what it cost."""


def untold(done: float, note: str = "") -> None:
    """A report that nobody hears."""


def silent(what: str, total: float, unit: str) -> AbstractContextManager[Report]:
    """A stage that nobody sees."""
    return nullcontext(untold)


@dataclass(slots=True)
class Recording:
    """A run that is being recorded.

    Attributes:
        record: what run.json says now.
        earlier: the record that an earlier call left, if this run goes on from there.
        partial: what to store where the run ends early and its error carries nothing.
        cache: what a cached law reported of itself at the last checkpoint.
        goes_on: whether the run goes on from a checkpoint.
        is_whole: whether run.json says that it is finished, as then it stays.
    """

    folder: Path
    record: RunRecord
    earlier: RunRecord | None
    store: Store
    partial: Any = None
    cache: Mapping[str, Any] | None = None
    goes_on: bool = False
    is_whole: bool = False

    def last_state(self) -> dict[str, np.ndarray] | None:
        """The arrays of the last checkpoint; None where the run starts at its beginning."""
        path = self._checkpoint_path()
        self.goes_on = self.earlier is not None and path.exists()
        return read_checkpoint(path, self._kind()) if self.goes_on else None

    def checkpoint(
        self, arrays: Mapping[str, np.ndarray], cache: Mapping[str, Any] | None = None
    ) -> None:
        """Write a state to go on from; `cache` is what a cached law reports of itself there."""
        write_checkpoint(self._checkpoint_path(), arrays, self._kind())
        self.cache = cache

    @contextmanager
    def restoring(self) -> Iterator[None]:
        """While what the checkpoint holds becomes a state again: any failure is the checkpoint's.

        Raises:
            FileError: it has no state of this run.
        """
        try:
            yield
        except (SimulationError, FileError, MismatchError):
            raise
        except Exception as error:
            if not self.goes_on:
                raise
            why = error if isinstance(error, InputError) else type(error).__name__
            path = self._checkpoint_path()
            log.debug("%s: no state of this run", path, exc_info=error)
            raise FileError(
                f"{path}: no state of this run ({why}); start over with --fresh; --traceback "
                "shows where it failed"
            ) from error

    def finish(self, result: Any) -> None:
        """Store a whole result; run.json comes last, so a finished record has all its files."""
        self.end("finished", result)
        self.is_whole = True
        remove(self._checkpoint_path())

    def end(self, status: str, result: Any = None, error: str | None = None) -> None:
        """Store what there is and say how the run ended."""
        self.record = replace(self.record, status=status, error=error, cache=self.cache)
        if result is not None:
            self.record = self.store(self.record, result)
        write_record(self.folder, self.record)

    def _checkpoint_path(self) -> Path:
        return self.folder / CHECKPOINT

    def _kind(self) -> str:
        return f"a {self.record.law} run"


def record_run(
    folder: Path,
    record: RunRecord,
    compute: Callable[[Recording], Any],
    store: Store,
    *,
    fresh: bool = False,
) -> RunRecord:
    """Open a run folder, compute and record how that ends; an earlier call's finished run is kept.

    A run that fails or is interrupted leaves what it computed. Nobody else writes into the folder
    meanwhile.
    """
    earlier = None if fresh else earlier_run(folder, record)
    if earlier is None or earlier.status != "finished":
        with locked_folder(folder):
            return _recorded(folder, record, compute, store, fresh)
    if folder_lock(folder).exists() or (folder / CHECKPOINT).exists():  # ended after its last file
        with locked_folder(folder):
            remove(folder / CHECKPOINT)
    log.info("%s: finished before; --fresh starts over", folder)
    return earlier


def _recorded(
    folder: Path,
    record: RunRecord,
    compute: Callable[[Recording], Any],
    store: Store,
    fresh: bool,
) -> RunRecord:
    current = Recording(folder, record, None, store)
    try:
        current.earlier = open_run_folder(folder, record, fresh=fresh)
        if current.earlier is not None:
            write_record(folder, record)
        current.finish(compute(current))
    except SimulationError as error:
        partial = current.partial if error.partial is None else error.partial
        current.end("failed", partial, str(error))
        raise
    except FileError as error:
        if not current.is_whole:
            with suppress(FileError):  # the disk may be full for this too
                current.end("failed", error=str(error))
        raise
    except KeyboardInterrupt:
        if not current.is_whole:
            current.end("interrupted", current.partial)
        raise
    return current.record


def new_record(recipe: Recipe, law: str, surrogate: Mapping[str, Any] | None = None) -> RunRecord:
    """The record of a run by the law of this name that is about to start."""
    return RunRecord(
        status="running",
        recipe=recipe.to_dict(),
        law=law,
        initialisation=recipe.rve.initialisation,
        solver=recipe.rve.solver,
        cell_fingerprint=recipe.fingerprint,
        seed=None if recipe.types else recipe.samples.seed,
        surrogate=surrogate,
        **describe_origin(),
    )


def describe_origin() -> dict[str, Any]:
    """When and by what a record is made, by the names that it has."""
    return {
        "package_version": version("surrofe2"),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "threads": numba.get_num_threads(),
        "platform": describe_platform(),
    }


def describe_platform() -> dict[str, str]:
    """Processor, cores, system and library versions; nothing that identifies the machine."""
    libraries = {name: version(name) for name in ("numpy", "scipy", "numba", "torch")}
    return {
        "processor": processor(),
        "cores": str(os.cpu_count()),
        "system": platform.system(),
        "python": platform.python_version(),
        **libraries,
    }

"""Runs on one page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from surrofe2.base.errors import InputError, MismatchError
from surrofe2.report.comparison import compare, order_runs
from surrofe2.report.page import page_of
from surrofe2.report.player import OF_ELEMENTS, ReportData, RunData
from surrofe2.store.fields import DISPLACEMENT_NAME, FIELDS, read_fields
from surrofe2.store.run_folder import EVENTS, StoredRun, read_run
from surrofe2.store.store import check_replaceable, read_bytes, write_text

_MOST_PICTURES = 4


def write_report(folders: Sequence[str | Path], out: str | Path) -> Path:
    """Write one HTML file on these runs, which needs nothing else; its path.

    Args:
        out: the file; a page that is there is replaced, and no other file.

    Raises:
        FileError: a folder has no run, or the file cannot be written.
        InputError: a run has not begun to have results, or no folder is given.
    """
    if not folders:
        raise InputError("report: no run folder; give at least one")
    path, page = Path(out), page_of(load_runs(folders))
    check_replaceable(path, "page", "<!doctype html>", "surrofe2")
    write_text(path, page)
    return path


def load_runs(folders: Sequence[str | Path]) -> ReportData:
    """What these run folders hold, the reference first."""
    runs = [read_run(folder, finished=False) for folder in folders]
    if len(runs) == 1:
        return ReportData(
            (_load(runs[0]),), None, "One run, so there is nothing to compare it with."
        )
    seen = tuple(_load(run) for run in order_runs(runs))
    try:
        return ReportData(seen, compare(runs))
    except MismatchError as error:
        return ReportData(seen, None, f"Not compared: {error}.")


def _load(run: StoredRun) -> RunData:
    folder = run.folder
    has_fields = (folder / f"{FIELDS}.h5").exists()
    events = folder / EVENTS
    lines = read_bytes(events).decode("utf-8").splitlines() if events.exists() else []
    zooms = sorted(folder.glob("zoom-*/zoom.png"))[:_MOST_PICTURES]
    return RunData(
        run=run,
        fields=read_fields(folder, [DISPLACEMENT_NAME], OF_ELEMENTS) if has_fields else None,
        events=[json.loads(line) for line in lines],
        particles={path.parent.name: read_bytes(path) for path in zooms},
    )

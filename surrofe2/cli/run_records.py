"""The record that a run begins with, and what is kept of a run that is interrupted."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from surrofe2.cli.console import keeping

if TYPE_CHECKING:
    from surrofe2.io.runs import RunRecord
    from surrofe2.recipe import Recipe


def new_record(
    recipe: Recipe, law: str, threads: int, surrogate: Mapping[str, Any] | None = None
) -> RunRecord:
    """The record of a run by the law of this name that is about to start."""
    from datetime import UTC, datetime
    from importlib.metadata import version

    from surrofe2.cli.platforms import describe_platform
    from surrofe2.io.runs import RunRecord

    return RunRecord(
        status="running",
        recipe=recipe.to_dict(),
        law=law,
        initialisation=recipe.rve.initialisation,
        solver=recipe.rve.solver,
        package_version=version("surrofe2"),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        cell_fingerprint=recipe.cell.fingerprint,
        threads=threads,
        seed=recipe.samples.seed,
        surrogate=surrogate,
        platform=describe_platform(),
    )


def keeping_run(folder: Path) -> AbstractContextManager[None]:
    """`keeping` for a run that writes checkpoints into a folder."""
    return keeping(
        f"{folder} keeps the run up to its last checkpoint; continue it by the same command "
        "with --resume"
    )

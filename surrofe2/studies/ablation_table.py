"""The rows of an ablation as figure, table and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from surrofe2.report.study import Curve, Panel, Study
from surrofe2.studies.ablation import QUERIED, Row, contenders, is_of
from surrofe2.surrogate.settings import TrainingSettings


def describe(
    rows: list[Row],
    training: TrainingSettings,
    preset: str,
    name: str,
    settings: Mapping[str, Any],
) -> Study:
    """Error over samples and error over cost, with the table for people.

    Args:
        training: of the recipe, whose own contender the table marks.
        name: stem of the files.
        settings: for the record.
    """
    by_name = {
        contender: [row for row in rows if row.contender == contender]
        for contender in contenders()
        if any(row.contender == contender for row in rows)
    }
    return Study(
        name=name,
        title=f"Surrogate part by part, and what else there is; preset “{preset}”",
        panels=_panels(by_name),
        columns=2,
        table={
            "contender": [row.contender for row in rows],
            "samples": [row.samples for row in rows],
            "rms (of spread)": [_number(row.rms) for row in rows],
            "worst (of spread)": [_number(row.worst) for row in rows],
            "answered": [row.answered for row in rows],
            "query (µs/point)": [row.query for row in rows],
            "training (CPU s)": [row.training for row in rows],
        },
        results={"rows": [asdict(row) for row in rows]},
        units={
            "rms": "1", "worst": "1", "answered": "1", "query": "µs a point",
            "training": "s of CPU time",
        },
        settings=settings,
        shown=_shown(by_name, training),
    )  # fmt: skip


def _panels(by_name: Mapping[str, list[Row]]) -> tuple[Panel, Panel]:
    known = {name: [row for row in found if row.rms is not None] for name, found in by_name.items()}
    learning = tuple(
        Curve(
            name,
            np.array([float(row.samples) for row in found]),
            np.array([100.0 * _number(row.rms) for row in found]),
        )
        for name, found in known.items()
        if found
    )
    costs = tuple(
        Curve(name, np.array([found[-1].query]), np.array([100.0 * _number(found[-1].rms)]))
        for name, found in known.items()
        if found
    )
    error = "RMS error (% of spread)"
    most = max(row.samples for found in by_name.values() for row in found)
    return (
        Panel(x_label="RVE samples", y_label=error, curves=learning, log_x=True, log_y=True),
        Panel(
            x_label=f"cost a query (µs a point at {QUERIED})",
            y_label=error,
            curves=costs,
            title=f"{most} samples, or as many as it bears",
            log_x=True,
            log_y=True,
        ),
    )


def _shown(by_name: Mapping[str, list[Row]], training: TrainingSettings) -> dict[str, list[str]]:
    counts = sorted({row.samples for found in by_name.values() for row in found})
    table: dict[str, list[str]] = {
        "contender": [f"**{name}**" if is_of(name, training) else name for name in by_name]
    }
    for count in counts:
        table[f"{count} samples, RMS / worst, %"] = [
            next((_errors(row) for row in found if row.samples == count), "–")
            for found in by_name.values()
        ]
    table["query, µs"] = [f"{found[-1].query:.2g}" for found in by_name.values()]
    table["training, CPU s"] = [f"{found[-1].training:.0f}" for found in by_name.values()]
    return table


def _errors(row: Row) -> str:
    if row.rms is None or row.worst is None:
        return "none answered"
    part = "" if row.answered == 1.0 else f" ({100.0 * row.answered:.2g} % answered)"
    return f"{100.0 * row.rms:.2g} / {100.0 * row.worst:.2g}{part}"


def _number(value: float | None) -> float:
    return float("nan") if value is None else value

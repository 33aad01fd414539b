"""What a study hands to its files: panels of one figure, one table, its numbers.

Plain data, so that a study draws nothing and a drawing computes nothing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Curve:
    """One line of a panel.

    Attributes:
        name: decides colour, dash and marker, so that a name looks alike in all figures.
        x, y: (m,) values in the units of the panel's axes; NaN leaves a gap.
        label: for the legend; empty: the name.
        markers: whether single points are marked.
        note: drawn at the end of the line, for example a fitted order.
    """

    name: str
    x: Array
    y: Array
    label: str = ""
    markers: bool = True
    note: str = ""

    def __post_init__(self) -> None:
        if np.shape(self.x) != np.shape(self.y) or np.ndim(self.x) != 1:
            raise InputError(
                f"curve {self.name}: x {np.shape(self.x)} and y {np.shape(self.y)}; both must be "
                "(m,)"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class Panel:
    """One pair of axes; labels carry units."""

    x_label: str
    y_label: str
    curves: tuple[Curve, ...]
    title: str = ""
    log_x: bool = False
    log_y: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """A finished study.

    Attributes:
        name: stem of its files.
        title: of the figure, with the preset.
        panels: row by row; `columns` of them in a row.
        table: column heading with unit to values; all columns are of one length.
        results: the numbers of the study, for JSON.
        units: of the entries of `results`, by name.
        settings: what the study was told besides the cell.
        shown: the table for people, column heading to texts; the first column names. Empty: none.
    """

    name: str
    title: str
    panels: tuple[Panel, ...]
    columns: int
    table: Mapping[str, Sequence[Any] | Array]
    results: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    shown: Mapping[str, Sequence[str]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        lengths = {len(column) for column in self.table.values()}
        if len(lengths) > 1:
            raise InputError(f"study {self.name}: columns of {sorted(lengths)} rows; must be one")

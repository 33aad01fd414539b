"""A parameter study: its table, and its picture over the first of the values that change."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from surrofe2.recipe import SECTIONS
from surrofe2.recipe_entries import text_of
from surrofe2.report.comparison import ComparedRun, compared_run
from surrofe2.report.figures import Curve, Panel, write_figure
from surrofe2.report.tables import Quantity, Table, percent
from surrofe2.store.run_folder import StoredRun, caches_of
from surrofe2.units import NONE

_MOST_CURVES = 12
"""Of displacements over time that are drawn; more are not told apart."""
_DECADE = 10.0
"""Positive values that are so many times apart stand on a logarithm."""


@dataclass(frozen=True)
class GridRow:
    """One run of a grid, by its law.

    Attributes:
        values: of the entries that change and that it depends on, by dotted name.
        name: of the folder.
        run: None where it failed.
        true: the run of the same values by true RVEs, if there is one.
        error: the sentence of a run that failed.
    """

    values: Mapping[str, Any]
    law: str
    name: str
    run: StoredRun | None
    true: StoredRun | None
    error: str | None = None

    @cached_property
    def against(self) -> ComparedRun | None:
        """The run against that by true RVEs."""
        if self.run is None or self.true is None or self.law == "rve":
            return None
        return compared_run(self.run, self.true)

    @cached_property
    def caches(self) -> list[Mapping[str, Any]]:
        """What the caches of the run's cells report; of several, the worst is told."""
        return [] if self.run is None else [*caches_of(self.run.record.cache).values()]

    def of_run(self, get: Callable[[StoredRun], Any]) -> Any:
        """What `get` gives of the run; None where it failed."""
        return None if self.run is None else get(self.run)

    def of_comparison(self, get: Callable[[ComparedRun], Any]) -> Any:
        """What `get` gives of the comparison with true RVEs; None where there is none."""
        return None if self.against is None else get(self.against)

    def worst(self, get: Callable[[Mapping[str, Any]], float]) -> float | None:
        """The largest that `get` gives of a cache."""
        return max((get(cache) for cache in self.caches), default=None)

    def stress_error(self, get: Callable[[Mapping[str, Any]], float]) -> float | None:
        """An error that audits found, relative to the spread of stress where both are known."""
        found = [
            get(cache["audit"]) / cache["tolerance"]["spread"]
            for cache in self.caches
            if cache["audit"]["quantiles"] and cache["tolerance"]["spread"]
        ]
        return max(found, default=None)

    @property
    def allowed(self) -> float | None:
        """The tolerance of the cache, relative to the spread of stress."""
        return self.worst(lambda cache: float(cache["tolerance"]["share"]))

    @property
    def above(self) -> str | None:
        """How many of the audited answers were above the tolerance."""
        found = [sum(each["audit"][k] for each in self.caches) for k in ("violations", "audited")]
        return "{} of {}".format(*found) if self.caches else None

    @property
    def hits(self) -> float | None:
        """Share of the stresses that the cache answered."""
        counts = self.of_run(lambda run: run.record.counts) or {}
        asked = counts.get("hits", 0) + counts.get("fallbacks", 0)
        return counts["hits"] / asked if asked else None


def _inverse(ratio: float | None) -> float:
    return 1.0 / (ratio or float("inf"))


QUANTITIES: tuple[Quantity[GridRow], ...] = (
    Quantity("largest displacement", "µm", ".5g", lambda row: row.of_run(_largest_displacement)),
    Quantity(
        "displacement error",
        "",
        percent(".2g"),
        lambda row: row.of_comparison(lambda run: run.difference.largest),
    ),
    Quantity(
        "stress error",
        "",
        percent(".2g"),
        lambda row: row.stress_error(lambda audit: audit["quantiles"]["0.99"]),
    ),
    Quantity(
        "largest stress error",
        "",
        None,
        lambda row: row.stress_error(lambda audit: audit["largest"]),
    ),
    Quantity("above", "", "", lambda row: row.above),
    Quantity("hits", "", percent(".3g"), lambda row: row.hits),
    Quantity(
        "wall time", "s", ".3g", lambda row: row.of_run(lambda run: run.record.wall_time["total"])
    ),
    Quantity(
        "speed-up", "×", ".3g", lambda row: row.of_comparison(lambda run: run.speed_up["wall_time"])
    ),
    Quantity(
        "all counted",
        "×",
        ".3g",
        lambda row: row.of_comparison(lambda run: run.balance and run.balance.gain),
    ),
    Quantity(
        "RVE solves",
        "",
        None,
        lambda row: row.of_run(lambda run: run.record.counts.get("rve_solves", 0)),
    ),
    Quantity(
        "right-hand sides",
        "",
        None,
        lambda row: row.of_comparison(lambda run: _inverse(run.speed_up["right_hand_sides"])),
    ),
    Quantity("factor", "", None, lambda row: row.worst(lambda cache: cache["trust"]["factor"])),
    Quantity(
        "switched off",
        "",
        lambda off: "yes",
        lambda row: row.worst(lambda cache: cache["trust"]["off"]) or None,
    ),
    Quantity("run", "", None, lambda row: row.name),
    Quantity("error", "", lambda sentence: "failed", lambda row: row.error),
)
"""Stresses relative to their spread; the stress error is what 99 % of the audited answers keep,
right-hand sides are relative to those of true FE²."""


def _largest_displacement(run: StoredRun) -> float:
    return float(np.linalg.norm(run.curve.displacement, axis=1).max())


@dataclass(frozen=True, slots=True)
class Grid:
    """Runs of a recipe, called so, by the values of its entries."""

    recipe: str
    values: Mapping[str, tuple[Any, ...]]
    rows: tuple[GridRow, ...]

    @property
    def has_laws(self) -> bool:
        """Whether there are runs by more than one law."""
        return len({row.law for row in self.rows}) > 1

    @property
    def names(self) -> int:
        """How many columns of the table say which run it is."""
        return len(self.values) + self.has_laws

    @property
    def table(self) -> Table[GridRow]:
        """What people read of it."""
        law: Quantity[GridRow] = Quantity("law", "", "", lambda row: row.law)
        own = [_of_entry(name, self.values) for name in self.values] + [law] * self.has_laws
        return Table((*own, *QUANTITIES), self.rows)

    @property
    def failed(self) -> dict[str, str]:
        """Sentences of the errors of runs by their name."""
        return {row.name: row.error for row in self.rows if row.error}

    def to_dict(self) -> dict[str, Any]:
        """Plain values for grid.json."""
        return {
            "recipe": self.recipe,
            "values": self.values,
            "units": self.table.units,
            "rows": self.table.to_records(),
        }


def _short(name: str, among: Iterable[str]) -> str:
    """An entry without its section, where no other is called so."""
    key = name.partition(".")[2]
    return key if sum(other.partition(".")[2] == key for other in among) == 1 else name


def _of_entry(name: str, among: Iterable[str]) -> Quantity[GridRow]:
    """The column of an entry."""
    section, *parts = name.split(".")
    if section == "cells":
        section, parts = "cell", parts[1:]
    kind = SECTIONS.get(section)
    units = {each.name: each.metadata.get("unit", NONE) for each in fields(kind)} if kind else {}
    unit = units.get(parts[0], NONE)

    def get(row: GridRow) -> Any:
        value = row.values.get(name)
        return value if value is None or _is_number(value) else text_of(value)

    def shown(value: Any) -> str:
        return value if isinstance(value, str) else f"{value:g}"

    return Quantity(_short(name, among), "" if unit == NONE else unit, shown, get)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


_PANELS = (
    ("largest displacement", "µm", False),
    ("displacement error", "relative to the largest", True),
    ("stress error", "relative to the spread of stress", True),
    ("hits", "share of the stresses", False),
    ("speed-up", "times faster than true FE²", False),
    ("wall time", "s", False),
)
"""Quantities that are drawn over the values, label of their axis, and whether it is logarithmic."""


def write_grid_plot(path: Path, grid: Grid) -> None:
    """Draw displacements over time, and what runs came to over the first entry that changes."""
    changing = [name for name, values in grid.values.items() if len(values) > 1]

    def label(row: GridRow, names: list[str]) -> str:
        known = [name for name in names if name in row.values]
        told = [f"{_short(name, grid.values)} {text_of(row.values[name])}" for name in known]
        return ", ".join([*told, *([row.law] if grid.has_laws else [])])

    drawn = [row for row in grid.rows if row.run is not None]
    some = np.unique(np.linspace(0, len(drawn) - 1, min(len(drawn), _MOST_CURVES)).round())
    shown = [drawn[int(k)] for k in some]
    panels = [_over_time(shown, [label(row, changing) for row in shown])] if shown else []
    groups: dict[str, list[GridRow]] = {}
    for row in grid.rows if changing else ():
        if changing[0] in row.values:
            groups.setdefault(label(row, changing[1:]), []).append(row)
    for name, axis, log_y in _PANELS if groups else ():
        curves = _over_values(grid, changing[0], name, groups)
        if curves and not (name == "wall time" and panels[-1].title == "speed-up"):
            panels.append(_panel(grid, changing[0], name, axis, curves, log_y))
    of = ", ".join(f"{name} {_ends(values)}" for name, values in grid.values.items())
    write_figure(path, f"{grid.recipe}: {of}", panels, columns=2)


def _ends(values: tuple[Any, ...]) -> str:
    first, last = text_of(values[0]), text_of(values[-1])
    return first if len(values) == 1 else f"{first} … {last}"


def _over_time(rows: list[GridRow], labels: list[str]) -> Panel:
    """The larger component of the watched displacement."""
    found = [row.run.curve for row in rows if row.run is not None]
    sizes = np.array([abs(curve.displacement).max(axis=0) for curve in found])
    axis = int(sizes.max(axis=0).argmax())
    curves = [
        Curve("", curve.t, curve.displacement[:, axis], label, markers=False, colour=k)
        for k, (curve, label) in enumerate(zip(found, labels, strict=True))
    ]
    title = "displacement of the watched point"
    return Panel("time $t$ (µs)", f"$u_{'xy'[axis]}$ (µm)", tuple(curves), title)


def _places(grid: Grid, over: str) -> dict[str, float]:
    """Where each value stands on the axis, by its text; those that are no numbers one by one."""
    values = grid.values[over]
    are_numbers = all(map(_is_number, values))
    return {text_of(each): float(each if are_numbers else k) for k, each in enumerate(values)}


def _over_values(
    grid: Grid, over: str, name: str, groups: Mapping[str, list[GridRow]]
) -> list[Curve]:
    places = _places(grid, over)
    quantity = next(each for each in QUANTITIES if each.name == name)
    found = []
    for k, (label, rows) in enumerate(groups.items()):
        x = np.array([places[text_of(row.values[over])] for row in rows])
        order = np.argsort(x)
        y = np.array([quantity.get(row) for row in rows], dtype=np.float64)  # None: NaN
        if np.isnan(y).all():
            continue
        found.append(Curve("", x[order], y[order], label or grid.recipe, colour=k))
        if name == "stress error":
            allowed = np.array([row.allowed for row in rows], dtype=np.float64)
            found.append(Curve("reference", x[order], allowed[order], "tolerance of stress"))
    return found


def _panel(grid: Grid, over: str, name: str, axis: str, curves: list[Curve], log_y: bool) -> Panel:
    places, are_numbers = _places(grid, over), all(map(_is_number, grid.values[over]))
    x = [*places.values()]
    return Panel(
        _of_entry(over, grid.values).heading,
        axis,
        tuple(curves),
        name,
        log_x=are_numbers and min(x) > 0.0 and max(x) > _DECADE * min(x),
        log_y=log_y,
        x_ticks=() if are_numbers else tuple(x),
        x_names=() if are_numbers else tuple(places),
        zero=not log_y and name != "largest displacement",
    )

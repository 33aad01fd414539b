"""Views of results in a notebook: facts as HTML, pictures, tables of other libraries."""

from __future__ import annotations

from abc import ABC, abstractmethod
from base64 import b64encode
from collections.abc import Mapping
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError
from surrofe2.base.units import ENERGY, FORCE, LENGTH, NONE, TIME
from surrofe2.run.charts import Curve, Panel, draw_panels, encoded
from surrofe2.run.displacement_curve import DisplacementCurve
from surrofe2.run.journal import BEYOND, CROSSINGS
from surrofe2.run.responses import STRAIN_NAME, STRESS_NAME

Facts = Mapping[str, object]


class Viewed(ABC):
    """The base of results that a notebook shows as HTML, by their facts."""

    __slots__ = ()

    @abstractmethod
    def facts(self) -> Facts:
        """Return the facts that a notebook shows, by name."""

    def __repr__(self) -> str:
        facts = ", ".join(f"{name} {value}" for name, value in self.facts().items())
        return f"<{type(self).__name__}: {facts}>"

    def _repr_html_(self) -> str:
        rows = "".join(
            f'<tr><th style="text-align:left">{escape(name)}</th>'
            f'<td style="text-align:left">{escape(str(value))}</td></tr>'
            for name, value in self.facts().items()
        )
        return f"<div><strong>{type(self).__name__}</strong><table>{rows}</table></div>"


class Series(NamedTuple):
    """A quantity over time.

    Attributes:
        values: (m,).
        unit: their unit.
        group: "displacement", "force", "place", "energy" or another kind; one axis shows one group.
    """

    values: Array
    unit: str
    group: str


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ViewedRun(Viewed):
    """A run, which is looked at over its time, or a rest over the factor of its load.

    Attributes:
        curve: displacement of the first watched point.
        curves: those of all watched points by name.
        energies: (m,) by name, pJ.
        history: (m,) by name; forces in µN, places in µm.
    """

    curve: DisplacementCurve
    curves: Mapping[str, DisplacementCurve] = field(default_factory=dict)
    energies: Mapping[str, Array] = field(default_factory=dict)
    history: Mapping[str, Array] = field(default_factory=dict)

    def fields_over_time(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return whole fields and their coordinates, as `xarray.Dataset` takes them; here none."""
        return {}, {}

    def series(self) -> dict[str, Series]:
        """Return all quantities over the output times, by name."""
        series = {
            f"u_{axis} {name}": Series(values, LENGTH, "displacement")
            for name, curve in self.curves.items()
            for axis, values in zip("xy", curve.displacement.T, strict=True)
        }
        for name, values in self.history.items():
            if name in (BEYOND, CROSSINGS):
                series[name] = Series(values, NONE, "count")
            elif name.startswith(STRESS_NAME):
                series[name] = Series(values, "MPa", "nominal stress")
            elif name.startswith(STRAIN_NAME):
                series[name] = Series(values, NONE, "nominal strain")
            elif name.startswith("impulse "):
                series[name] = Series(values, "µN µs", "impulse")
            elif name.startswith("force"):
                series[name] = Series(values, FORCE, "force")
            else:
                series[name] = Series(values, LENGTH, "place")
        for name, values in self.energies.items():
            series[f"energy {name}"] = Series(values, ENERGY, "energy")
        return series

    def plot(self) -> Any:
        """Draw displacements, forces and energies over time, by matplotlib.

        Returns:
            The axes, from top to bottom; their `figure` can be saved.
        """
        import matplotlib.pyplot as plt

        return np.array(draw_panels(self.panels(), figure=plt.figure()).axes)

    def panels(self) -> list[Panel]:
        """Make panels of displacements, forces and energies over time, where there are any."""
        panels = []
        for group, unit in (("displacement", LENGTH), ("force", FORCE), ("energy", ENERGY)):
            curves = tuple(
                Curve(
                    "", self.curve.t, series.values, name.removeprefix(f"{group} "), markers=False
                )
                for name, series in self.series().items()
                if series.group == group
            )
            if curves:
                panels.append(Panel(self.clock, f"{group} ({unit})", curves, height=0.8))
        return panels

    @property
    def is_rest(self) -> bool:
        """True for a rest, whose curves are over the factor of the load instead of time."""
        return False

    @property
    def clock(self) -> str:
        """Label of the axis over which its curves are drawn."""
        return "load factor" if self.is_rest else "time (µs)"

    def relation(self, name: str, against: str) -> Array:
        """Return one column over another, (m, 2): a force–displacement or a stress–strain curve.

        Args:
            name, against: of `history`.

        Raises:
            InputError: there is no such column; it names those that there are.

        Examples:
            The force on a grip that pulls within 10 µs, over its displacement:

            >>> from surrofe2 import Fixed, PrescribedMotion, Problem, Ramp, rectangle
            >>> from surrofe2 import RveLaw, simulate
            >>> pull = Ramp(end=10.0, smooth=True)
            >>> grip = PrescribedMotion(
            ...     name="grip", on="right", displacement=(5.0, 0.0), amplitude=pull
            ... )
            >>> strip = Problem(
            ...     mesh=rectangle(400.0, 200.0, (2, 1)),
            ...     conditions=(Fixed(on="left"), grip),
            ...     duration=10.0,
            ... )
            >>> run = simulate(strip, RveLaw("apple"))
            >>> curve = run.relation("force grip x", against="mean displacement right x")
            >>> curve.shape
            (21, 2)
            >>> print(f"{curve[-1, 0]:.1f} µm")
            5.0 µm
        """
        return related(self.history, name, against)

    def to_pandas(self) -> Any:
        """Make a `pandas.DataFrame` of displacements, forces and energies.

        Its index is t in µs, or the load factor. Its `attrs["units"]` has the unit of each column.

        Raises:
            InputError: pandas is not installed.
        """
        pandas = _library("pandas", "to_pandas")
        all_series = self.series()
        columns = {name: series.values for name, series in all_series.items()}
        index, unit = ("factor", NONE) if self.is_rest else ("t_us", TIME)
        frame = pandas.DataFrame(columns, index=pandas.Index(self.curve.t, name=index))
        units = {name: series.unit for name, series in all_series.items()}
        frame.attrs["units"] = {index: unit, **units}
        return frame

    def to_xarray(self) -> Any:
        """Make an `xarray.Dataset` of the same, each variable with its unit, and of whole fields.

        Fields are those of a run from Python, over `frame` (t in µs), `node` and `element`.

        Raises:
            InputError: xarray is not installed.
        """
        xarray = _library("xarray", "to_xarray")
        fields, coordinates = self.fields_over_time()
        over, unit = ("factor", NONE) if self.is_rest else ("t", TIME)
        for name, series in self.series().items():
            fields[name] = (over, series.values, {"units": series.unit})
        coordinates[over] = (over, self.curve.t, {"units": unit})
        return xarray.Dataset(fields, coordinates, {"source": repr(self)})

    def _repr_html_(self) -> str:
        # a dataclass with slots is a second class, which super() without arguments does not know
        facts = super(ViewedRun, self)._repr_html_().removesuffix("</div>")
        if self.curve.t.size < 2:
            return f"{facts}</div>"
        source = b64encode(encoded(draw_panels(self.panels()[:1]))).decode()
        image = f'<img alt="displacement over time" src="data:image/svg+xml;base64,{source}"/>'
        return f"{facts}{image}</div>"


def related(history: Mapping[str, Array], name: str, against: str) -> Array:
    """Return two columns (m, 2) of a history side by side, `against` first; see
    `ViewedRun.relation`.
    """
    for column in (against, name):
        if column not in history:
            raise InputError(f"{column}: no such column; there are {', '.join(history)}")
    return np.stack([history[against], history[name]], axis=1)


def course(
    curve: DisplacementCurve,
    wall: Mapping[str, float],
    counts: Mapping[str, int],
    *,
    is_rest: bool = False,
) -> Facts:
    """Return the facts of all runs and rests: how long or under which load, how fast, how far."""
    end = curve.t[-1] if curve.t.size else 0.0
    way = {"time": f"{end:g} µs in {counts.get('steps', 0):,} steps"}
    if is_rest:
        way = {"load factor": f"{end:g} in {counts.get('load_steps', 0):,} load steps"}
    largest = np.linalg.norm(curve.displacement, axis=1).max(initial=0.0)
    return {
        **way,
        "wall time": f"{wall.get('total', 0.0):.3g} s",
        "largest displacement": f"{largest:.4g} µm",
    }


def _library(name: str, method: str) -> Any:
    """Import a library that surrofe2 does not need for anything else.

    Raises:
        InputError: it is not installed; `method` is the function that needs it.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError:
        message = f"{method}: {name} is not installed; install it: pip install {name}"
        raise InputError(message) from None

"""A run as a picture, as a table of pandas and as a data set of xarray."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.errors import InputError
from surrofe2.io.columns import read_columns
from surrofe2.io.run_folder import HISTORY_UNITS, StoredRun
from surrofe2.macro.simulation import MacroRun
from surrofe2.tissue.history import TissueRun
from surrofe2.units import ENERGY, LENGTH

Array = NDArray[np.float64]
Run = MacroRun | TissueRun | StoredRun

_OF_FIELDS = {
    "displacement": ("node", "µm"),
    "velocity": ("node", "µm/µs"),
    "stress": ("element", "µN/µm"),
    "F": ("element", "1"),
    "F_dot": ("element", "1/µs"),
}


@dataclass(frozen=True, slots=True)
class Series:
    """A quantity over time: (m,) values with its group, displacement, force, place or energy."""

    values: Array
    unit: str
    group: str


def series_of(run: Run) -> dict[str, Series]:
    """All quantities of a run over its output times, by name."""
    curves, energies = _curves_and_energies(run)
    found = {
        f"u_{axis} {name}": Series(values, LENGTH, "displacement")
        for name, u in curves.items()
        for axis, values in zip("xy", u.T, strict=True)
    }
    for name, values in run.history.items():
        unit = HISTORY_UNITS.get(name.split()[0], "um").replace("u", "µ")
        found[name] = Series(values, unit, "force" if name.startswith("force") else "place")
    return found | {
        f"energy {name}": Series(values, ENERGY, "energy") for name, values in energies.items()
    }


def _curves_and_energies(run: Run) -> tuple[dict[str, Array], dict[str, Array]]:
    """(m, 2) displacement by watched point, µm, and (m,) energies by name, pJ."""
    if not isinstance(run, StoredRun):
        return {name: curve.displacement for name, curve in run.curves.items()}, run.energies
    first = next(iter(run.record.problem.get("watched", {})), "watched point")
    curves = {first: run.curve.displacement}
    names, columns = read_columns(run.folder / "curve.csv")
    for k in range(3, len(names), 2):
        curves[names[k].partition("_um ")[2]] = columns[:, k : k + 2]
    path = run.folder / "energies.csv"
    if not path.exists():
        return curves, {}
    names, columns = read_columns(path)
    energies = zip(names[1:], columns.T[1:], strict=True)
    return curves, {name.removesuffix("_pJ"): column for name, column in energies}


def plot(run: Run) -> Any:
    """See `ViewedRun.plot`."""
    import matplotlib.pyplot as plt

    found, t = series_of(run), run.curve.t
    shown = {
        group: {name: each for name, each in found.items() if each.group == group}
        for group in ("displacement", "force", "energy")
    }
    shown = {group: those for group, those in shown.items() if those}
    figure, axes = plt.subplots(
        len(shown), sharex=True, squeeze=False, layout="constrained", figsize=(7, 2.6 * len(shown))
    )
    for place, (group, those) in zip(axes[:, 0], shown.items(), strict=True):
        for name, each in those.items():
            place.plot(t, each.values, label=name.removeprefix(f"{group} "))
        place.set_ylabel(f"{group} ({next(iter(those.values())).unit})")
        place.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small")
        place.grid(alpha=0.3)
    axes[-1, 0].set_xlabel("time t (µs)")
    figure.align_ylabels()
    return axes[:, 0]


def to_pandas(run: Run) -> Any:
    """See `ViewedRun.to_pandas`."""
    pandas, found = _library("pandas", "to_pandas"), series_of(run)
    columns = {name: each.values for name, each in found.items()}
    frame = pandas.DataFrame(columns, index=pandas.Index(run.curve.t, name="t_us"))
    frame.attrs["units"] = {"t_us": "µs", **{name: each.unit for name, each in found.items()}}
    return frame


def to_xarray(run: Run) -> Any:
    """See `ViewedRun.to_xarray`."""
    xarray = _library("xarray", "to_xarray")
    variables: dict[str, Any] = {
        name: ("t", each.values, {"units": each.unit}) for name, each in series_of(run).items()
    }
    coordinates: dict[str, Any] = {"t": ("t", run.curve.t, {"units": "µs"})}
    if isinstance(run, MacroRun):
        coordinates["frame"] = ("frame", run.frames.t, {"units": "µs"})
        coordinates["position"] = (("node", "axis"), run.nodes, {"units": "µm"})
        fields = {
            "displacement": run.frames.displacement,
            "velocity": run.frames.velocity,
            "stress": run.frames.stress,
            "F": run.frames.F,
            "F_dot": run.frames.F_dot,
        }
        for name, values in fields.items():
            at, unit = _OF_FIELDS[name]
            axes = ("axis",) if values.ndim == 3 else ("row", "column")
            variables[f"field {name}"] = (("frame", at, *axes), values, {"units": unit})
        variables["elements"] = (("element", "corner"), run.elements)
    return xarray.Dataset(variables, coordinates, {"source": repr(run)})


def _library(name: str, method: str) -> Any:
    """A library that surrofe2 does not need for anything else.

    Raises:
        InputError: it is not installed.
    """
    try:
        return import_module(name)
    except ModuleNotFoundError:
        raise InputError(
            f"{method}: {name} is not installed; install it: pip install {name}"
        ) from None

"""What people ask of results in a notebook: pictures, tables of other libraries, HTML.

What draws and converts stands in `surrofe2.report`, above all that it shows, and is imported when
it is asked for; results themselves know no drawing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any


class Viewed:
    """What a notebook shows as HTML."""

    __slots__ = ()

    def _repr_html_(self) -> str:
        shown: str = import_module("surrofe2.report.notebook").html(self)
        return shown


class ViewedRun(Viewed):
    """A run, which is looked at over its time."""

    __slots__ = ()

    def plot(self) -> Any:
        """Displacements, forces and energies over time, by matplotlib.

        Returns:
            The axes, from top to bottom; their `figure` can be saved.
        """
        return import_module("surrofe2.report.run_views").plot(self)

    def to_pandas(self) -> Any:
        """A `pandas.DataFrame` over t in µs of displacements, forces and energies.

        Its `attrs["units"]` has the unit of each column.

        Raises:
            InputError: pandas is not installed.
        """
        return import_module("surrofe2.report.run_views").to_pandas(self)

    def to_xarray(self) -> Any:
        """An `xarray.Dataset` of the same, each variable with its unit, and of whole fields.

        Fields are those of a run from Python, over `frame` (t in µs), `node` and `element`.

        Raises:
            InputError: xarray is not installed.
        """
        return import_module("surrofe2.report.run_views").to_xarray(self)

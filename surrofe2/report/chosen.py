"""Numbers that a parameter study shows of each of its runs: a column, and a statistic of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import unknown
from surrofe2.store.run_folder import StoredRun

# Statistics of a column: the value that is largest in size, the last one, the slope at the start
# and the work of a force over its displacement, and the period of an oscillation.
STATISTICS = ("maximum", "end", "slope", "work", "period")
_FEWEST_CROSSINGS = 3  # of the mean, by which a period is known


class Chosen(NamedTuple):
    """A column of a run by its name, and one of `STATISTICS`."""

    column: str
    statistic: str

    @classmethod
    def read(cls, text: str) -> Chosen:
        """Read COLUMN or COLUMN:STATISTIC; of a column alone the maximum.

        Raises:
            InputError: there is no such statistic.
        """
        column, colon, statistic = text.rpartition(":")
        if not colon:
            return cls(text, STATISTICS[0])
        if statistic not in STATISTICS:
            raise unknown(f"--quantity: {quoted(text)}", statistic, "statistic", STATISTICS)
        return cls(column, statistic)

    @property
    def name(self) -> str:
        """The name of the number in a table."""
        return f"{self.statistic} of {self.column}"

    def of(self, run: StoredRun) -> tuple[float | None, str]:
        """Compute the number of a run, None where it has none, and its unit.

        Raises:
            InputError: the run has no such column; it names those that it has.
        """
        series = run.series()
        if self.column not in series:
            known = ", ".join(series)
            raise InputError(f"--quantity: {quoted(self.column)}: {run.name} has only {known}")
        values, unit, _ = series[self.column]
        if self.statistic in ("slope", "work"):
            for response in run.responses:
                if self.column != f"force {response.name} {response.axis}":
                    continue
                if self.statistic == "slope":
                    return response.slope, "µN/µm"
                return response.work, "pJ"
            return None, ""
        if self.statistic == "period":
            return _period(run.curve.t, values), "" if run.is_rest else "µs"
        place = -1 if self.statistic == "end" else int(np.nanargmax(abs(values)))
        return float(values[place]), "" if unit == "1" else unit


def _period(t: Array, values: Array) -> float | None:
    """Compute twice the mean time between crossings of the mean; None of fewer than three."""
    apart = values - values.mean()
    above = apart > 0.0  # a value at the mean itself is below: each crossing counts once
    k = np.flatnonzero(above[:-1] != above[1:])  # the value before each crossing
    if k.size < _FEWEST_CROSSINGS:
        return None
    # the time of a crossing by interpolation
    crossings = t[k] - apart[k] * (t[k + 1] - t[k]) / (apart[k + 1] - apart[k])
    return float(2.0 * np.diff(crossings).mean())


def peaks_of(run: StoredRun) -> list[Chosen]:
    """Return the numbers of a run by default: the peak of each force over its displacement."""
    return [
        Chosen(f"force {response.name} {response.axis}", STATISTICS[0])
        for response in run.responses
    ]

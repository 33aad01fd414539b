"""Numbers that a study asks of each of its runs: a column, and what of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.errors import InputError, quoted
from surrofe2.base.settings import unknown
from surrofe2.store.run_folder import StoredRun

STATISTICS = ("maximum", "end", "slope", "work", "period")
"""The value of a column that is largest in size, the last one, the slope at the start and the work
of a force over its displacement, and the period of an oscillation."""


class Chosen(NamedTuple):
    """A column of a run by its name, and one of `STATISTICS`."""

    column: str
    statistic: str

    @classmethod
    def read(cls, text: str) -> Chosen:
        """From COLUMN or COLUMN:STATISTIC; of a column alone the maximum.

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
        """What a table calls it."""
        return f"{self.statistic} of {self.column}"

    def of(self, run: StoredRun) -> tuple[float | None, str]:
        """The number, None where the run has none, and its unit.

        Raises:
            InputError: the run has no such column; it names those that it has.
        """
        series = run.series()
        if self.column not in series:
            known = ", ".join(series)
            raise InputError(f"--quantity: {quoted(self.column)}: {run.name} has only {known}")
        values, unit, _ = series[self.column]
        if self.statistic in ("slope", "work"):
            for each in run.responses:
                if self.column == f"force {each.name} {each.axis}":
                    is_slope = self.statistic == "slope"
                    return (each.slope, "µN/µm") if is_slope else (each.work, "pJ")
            return None, ""
        if self.statistic == "period":
            return _period(run.curve.t, values), "" if run.is_rest else "µs"
        place = -1 if self.statistic == "end" else int(np.nanargmax(abs(values)))
        return float(values[place]), "" if unit == "1" else unit


def _period(t: Array, values: Array) -> float | None:
    """Twice the mean time between crossings of the mean; None where there are fewer than three."""
    apart = values - values.mean()
    above = apart > 0.0  # a value at the mean itself is below: each crossing counts once
    at = np.flatnonzero(above[:-1] != above[1:])
    if at.size < 3:
        return None
    crossings = t[at] - apart[at] * (t[at + 1] - t[at]) / (apart[at + 1] - apart[at])
    return float(2.0 * np.diff(crossings).mean())


def peaks_of(run: StoredRun) -> list[Chosen]:
    """What is asked of a run where nobody chose: the peak of each force over its displacement."""
    return [Chosen(f"force {each.name} {each.axis}", STATISTICS[0]) for each in run.responses]

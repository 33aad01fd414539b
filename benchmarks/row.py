"""One measured figure with all that is needed to judge it."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A figure, its limit, and the same work done in another way.

    Attributes:
        name: what was measured, `value` in `unit`; the median where it was repeated; None: it
            could not be measured, `note` says why.
        spread: interquartile range of the repeats, in `unit`.
        limit: what must hold: value ≤ limit, or value ≥ limit where `at_least`; None: nothing.
        baseline: what it is compared with, `baseline_value` in `unit`.
        ratio: baseline / value, the median over pairs timed one after the other.
        error, baseline_error: of either side, as `error_of` says.
        threads: that numba, BLAS and torch could use.
        note: a remark for the table.
    """

    name: str
    value: float | None
    unit: str
    spread: float | None = None
    limit: float | None = None
    at_least: bool = False
    baseline: str | None = None
    baseline_value: float | None = None
    ratio: float | None = None
    error: float | None = None
    baseline_error: float | None = None
    error_of: str = ""
    threads: int = 1
    note: str = ""

    @property
    def met(self) -> bool | None:
        """Whether the limit is kept; None where there is none."""
        if self.limit is None:
            return None
        if self.value is None or not math.isfinite(self.value):
            return False
        return self.value >= self.limit if self.at_least else self.value <= self.limit

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**asdict(self), "met": self.met}

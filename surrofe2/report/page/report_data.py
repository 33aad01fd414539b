"""What a page is made of, read from run folders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.report.comparison import Comparison
from surrofe2.store.fields import RISK_NAME, SOURCE_NAME, STRESS_NAME, StoredFields
from surrofe2.store.run_folder import RunRecord, StoredRun

Array = NDArray[np.float64]

VON_MISES, WALL_STRETCH = "von_mises_in_plane_uN_per_um", "largest_wall_stretch"
OF_ELEMENTS = (
    STRESS_NAME, "deformation_gradient", VON_MISES, SOURCE_NAME, RISK_NAME, WALL_STRETCH,
)  # fmt: skip
"""What a page shows of elements."""
OF_POINTS = (SOURCE_NAME, RISK_NAME)
"""What a page shows of points of the law."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RunData:
    """A run as a page shows it; what its folder lacks is None or empty.

    Attributes:
        energies: columns of energies.csv by heading.
        points: values at the points of the law by name, (m, n).
        events: lines of events.jsonl.
        particles: PNG of each look into the plant cells, by the name of its folder.
    """

    run: StoredRun
    energies: Mapping[str, Array] = field(default_factory=dict)
    fields: StoredFields | None = None
    points: Mapping[str, Array] = field(default_factory=dict)
    events: Sequence[Mapping[str, Any]] = ()
    particles: Mapping[str, bytes] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """That of its folder."""
        return self.run.folder.name

    @property
    def record(self) -> RunRecord:
        """What run.json says."""
        return self.run.record


@dataclass(frozen=True, slots=True)
class ReportData:
    """All that a page is made of.

    Attributes:
        runs: the reference first.
        comparison: of two runs and more of one load case.
        why_not: why there is none.
    """

    runs: tuple[RunData, ...]
    comparison: Comparison | None = None
    why_not: str = ""

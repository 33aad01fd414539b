"""`StressTable`: an in-situ adaptive table of RVE answers and their exact tangents.

ISAT (Pope 1997, Combust. Theory Modelling 1, 41-63) with two changes. A new record's ellipsoid is
not the small one within which the stress is as good as constant: a record costs one tile of eight
RVEs, so seven neighbours are solved with it, and the change of their exact tangents gives the
error of its linear model. And of all ellipsoids that hold a point the best one answers.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.cache.protocols import Fallback
from surrofe2.cache.table_evidence import weigh
from surrofe2.cache.table_inputs import INPUT_SIGNS, OUTPUT_SIGNS, canonical_image, input_scale
from surrofe2.cache.table_lookup import MANY, look_up
from surrofe2.cache.table_probing import probed_records
from surrofe2.cache.table_records import Records, joined, no_records
from surrofe2.cache.table_tree import make_tree
from surrofe2.errors import InputError
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.sampling import SamplingRange, sample
from surrofe2.stress_law import (
    Acceptance,
    StressResponse,
    Tangents,
    check_deformation,
    require_tangents,
)
from surrofe2.tensors import stress_spread, to_components, to_inputs, transpose

Array = NDArray[np.float64]

SPREAD_SAMPLES = 512
_WHOLE_TABLE = 100_000


class StressTable:
    """σ(F, Ḟ) from linear models about RVE answers, each within its ellipsoid of accuracy.

    `lookup` and `respond` are pure; the table changes in `learn` alone.

    Args:
        law: the true law, whose `respond(…, tangents=True)` gives records.
        tolerance: largest error of a stress that is given, µN/µm.
        range: whose half widths say how far neighbours lie from a record (a tenth) and how far
            an ellipsoid may reach at first; the table answers beyond it too.
        spread: of the stress, µN/µm, of which tolerances are shares.
        records: what is known already.
        most_records: after so many none is added.

    Attributes:
        counts: `added`, `grown`, `shrunk` ellipsoids and `table_rve_solves` since the start.

    Raises:
        InputError: the law gives no tangents, or the tolerance is not positive.
    """

    def __init__(
        self,
        law: Fallback,
        tolerance: float,
        range: SamplingRange,
        spread: float,
        records: Records | None = None,
        most_records: int = _WHOLE_TABLE,
    ) -> None:
        if not 0.0 < tolerance < np.inf:
            raise InputError(f"table.tolerance: {tolerance} µN/µm; it must be positive and finite")
        if not law.has_tangents:
            raise InputError(
                "table: a record needs exact tangents, which solver iterated does not give; use "
                "solver direct"
            )
        self.law = law
        self.tolerance = float(tolerance)
        self.range = range
        self.stress_spread = float(spread)
        self.most_records = most_records
        self.symmetry: str = law.cell.symmetry
        self.counts = {"added": 0, "grown": 0, "shrunk": 0, "table_rve_solves": 0}
        self._reach = input_scale(range)
        self.restore(records if records is not None else no_records())

    @property
    def cell(self) -> CellParameters:
        """Parameters of the plant cell."""
        return self.law.cell

    @property
    def initialisation(self) -> str:
        """How its RVE is initialised."""
        return self.law.initialisation

    @property
    def density(self) -> float:
        """Mass per reference area, ng/µm²."""
        return self.law.density

    @property
    def has_tangents(self) -> bool:
        """Never: the slope jumps from one record to the next."""
        return False

    @property
    def has_bound(self) -> bool:
        """Always, see `lookup`."""
        return True

    @property
    def learns(self) -> bool:
        """Always."""
        return True

    @property
    def records(self) -> Records:
        """What the table knows."""
        return self._records

    @property
    def size(self) -> int:
        """How many records it has."""
        return len(self._records.centre)

    def lookup(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """(stress (n, 2, 2), status (n,), bound (n,)) in one compiled pass; input is not checked.

        The bound of the error in µN/µm is the table's tolerance times the radius within the
        ellipsoid, 0 at the record and 1 at the surface. By the law through the errors seen it
        would be the squared radius, as of every linear model; what lies between is the margin. It
        is an estimate that true answers correct, no guarantee. Status 3 where no ellipsoid holds
        the point (bound infinite), 6 where the bound is above `tolerance`.

        F, F_dot: contiguous float64 (n, 2, 2).
        """
        return look_up(
            F, F_dot, float(tolerance), self.tolerance, self.images, self._records, self._tree
        )

    def respond(
        self, F: Array, F_dot: Array, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        """Stress at n points; NaN and status OUT_OF_RANGE where the table knows none."""
        if tangents:
            require_tangents(self)
        F, F_dot = check_deformation(F, F_dot)
        stress, status, _ = self.lookup(F, F_dot)
        return StressResponse(stress, status, state, {"table_points": len(F)})

    def status_and_bound(
        self, F: Array, F_dot: Array, tolerance: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """Those of `lookup`."""
        return self.lookup(F, F_dot, tolerance)[1:]

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """An InputError: each record has its own slope, which jumps from one to the next."""
        require_tangents(self)
        raise NotImplementedError

    def accept(self, F: Array, F_dot: Array, response: StressResponse) -> Acceptance:
        """Nothing is left to check or to commit."""
        return Acceptance(response.status, response.state)

    def learn(self, F: Array, F_dot: Array, stress: Array, state: Any = None) -> None:
        """Take true answers in: grow or shrink ellipsoids, and add records where none holds.

        Args:
            F, F_dot, stress: (m, 2, 2) true answers, be they a fallback's or an audit's.
            state: the law's warm start at these points (`PointStates`), or None.
        """
        x, R = to_inputs(F, F_dot)
        s = to_components(transpose(R) @ stress @ R)
        old = self._records
        records = old._replace(curvature=old.curvature.copy(), extent=old.extent.copy())
        covered, counts = weigh(x, s, self.tolerance, self.images, records)
        left = np.flatnonzero(~covered)
        while len(left) and len(records.centre) < self.most_records:
            chosen = left[self._apart(x[left], records)][: self.most_records - len(records.centre)]
            new = self._solved(x[chosen], R[chosen], state, chosen)
            left = np.setdiff1d(left, chosen, assume_unique=True)
            covered, more = weigh(x[left], s[left], self.tolerance, self.images, new)
            left = left[~covered]
            records = joined(records, new)
            counts = {name: counts[name] + more[name] for name in counts}
        counts["added"] = len(records.centre) - self.size
        for name, count in counts.items():
            self.counts[name] += count
        if any(counts.values()):
            self.restore(records)

    def warm_up(self) -> None:
        """Compile everything by letting an empty table of the same law learn once."""
        F = np.array([[[1.0, 1e-3], [0.0, 1.0]]])
        probe = StressTable(self.law, self.tolerance, self.range, self.stress_spread)
        answer = self.law.respond(F, 0.0 * F)
        state = self.law.accept(F, 0.0 * F, answer).state
        probe.learn(F, 0.0 * F, answer.stress, state)
        probe.learn(1.001 * F, 0.0 * F, answer.stress, state)
        probe.lookup(F, 0.0 * F)
        many = np.repeat(F, MANY, axis=0)
        probe.lookup(many, 0.0 * many)

    @property
    def images(self) -> int:
        """How many images the symmetry of the cell makes of a state."""
        return 4 if self.symmetry == "D4" else 1

    def restore(self, records: Records) -> None:
        """Know these records and no others."""
        self._records = records
        self._tree = make_tree(records.centre, records.half_width(self.tolerance))

    def _folded(self, x: Array) -> tuple[Array, NDArray[np.intp]]:
        image = canonical_image(x, self.symmetry)
        return x * INPUT_SIGNS[image], image

    def _apart(self, x: Array, records: Records) -> NDArray[np.intp]:
        """Which of these points should become records at once: none in the ellipsoid of another.

        Ellipsoids are taken to be like that of the latest record; a first record comes alone.
        """
        if not len(records.centre):
            return np.zeros(1, dtype=np.intp)
        curvature, x = records.curvature[-1], self._folded(x)[0]
        chosen, left = [], np.arange(len(x))
        while len(left):
            chosen.append(left[0])
            d = x[left] - x[left[0]]
            outside = np.einsum("ni,ij,nj->n", d, curvature, d) > self.tolerance
            outside[0] = False
            left = left[outside]
        return np.array(chosen, dtype=np.intp)

    def _solved(self, x: Array, R: Array, state: Any, points: NDArray[np.intp]) -> Records:
        """Records at canonical images of the points x, those without tangents left out."""
        records, found, solves = probed_records(
            self.law, x, R, state, points, self.tolerance, self._reach
        )
        self.counts["table_rve_solves"] += solves
        _, image = self._folded(x[found])
        inner, outer = INPUT_SIGNS[image], OUTPUT_SIGNS[image]
        return Records(
            records.centre * inner,
            records.stress * outer,
            records.slope * outer[:, :, None] * inner[:, None],
            records.curvature * inner[:, :, None] * inner[:, None],
            records.extent,
        )


def sampled_spread(law: Fallback, range: SamplingRange, seed: int = 1) -> float:
    """Spread of the stress over `SPREAD_SAMPLES` Sobol samples of a range, µN/µm.

    Raises:
        InputError: the law has no stress at any of them.
    """
    F, F_dot = sample(range, SPREAD_SAMPLES, seed)
    answer = law.respond(F, F_dot)
    valid = answer.stress[answer.status == 0]
    if not len(valid):
        raise InputError("range: no sample of it has a stress; narrow it")
    return stress_spread(valid)

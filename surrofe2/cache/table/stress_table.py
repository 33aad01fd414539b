"""`StressTable`: an in-situ adaptive table of RVE answers and their exact tangents.

ISAT (Pope 1997, Combust. Theory Modelling 1, 41-63) with two changes. A record costs one tile of
eight RVEs, so seven neighbours are solved with it, and the change of their exact tangents gives the
error of its linear model. And all ellipsoids that hold a point answer.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Mapping
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import InputError
from surrofe2.base.sampling import SamplingRange, half_widths, sample
from surrofe2.base.square_symmetry import COMPONENT_SIGNS, INPUT_SIGNS, canonical_image
from surrofe2.base.tensors import (
    INPUTS,
    from_inputs,
    stress_spread,
    to_components,
    to_inputs,
    transpose,
)
from surrofe2.cache.protocols import Fallback
from surrofe2.cache.table.lookup import look_up, make_screen
from surrofe2.cache.table.records import (
    NO_RECORDS,
    OUTPUTS,
    RULE,
    Records,
    curvature_from_constant,
    curvature_from_slopes,
    input_slopes,
    update_ellipsoids,
)
from surrofe2.cache.table.slopes import table_tangents
from surrofe2.law.stress_law import Tangents

SPREAD_SAMPLES = 32
"""By them the spread is known within 0.3 % of that of 512 on all recipes."""
NEIGHBOUR = 0.1
"""How far a neighbour lies from its record, in half widths of the range."""
MARGIN = 1.2
"""On the second derivatives, for what they change within the ellipsoid."""
MOST_RECORDS = 4096
"""All of them are screened for every point, so a lookup costs as much as there are."""

_GROUP = 1 + INPUTS
_log = logging.getLogger("surrofe2.cache")


def _no_counts() -> Counter[str]:
    return Counter(added=0, grown=0, shrunk=0, table_rve_solves=0)


@dataclass(slots=True)
class _Knowledge:
    """What a table has learnt, whoever looks it up by whatever tolerance.

    Attributes:
        records: the RVE answers with their ellipsoids.
        screen: of these records, for `look_up`; None: it is made when next needed.
        counts: see `StressTable`.
    """

    records: Records = NO_RECORDS
    screen: Array | None = None
    counts: Counter[str] = field(default_factory=_no_counts)


class StressTable:
    """σ(F, Ḟ) from linear models about RVE answers, each within its ellipsoid of accuracy.

    `lookup` is pure; the table changes in `learn` alone. Tables by `with_tolerance` share what is
    learnt, and each has the tolerance of its risks to itself.

    Args:
        law: that of the RVEs, whose `respond(…, tangents=True)` gives records.
        tolerance: largest error of a stress that is given, µN/µm.
        range: whose half widths say how far neighbours lie from a record (a tenth) and how far
            an ellipsoid may reach at first; the table answers beyond it too.
        spread: of the stress, µN/µm, of which tolerances are shares.
        most_records: after so many none is added; the law answers where none holds a point.

    Attributes:
        images: how many images the symmetry of the cell makes of a state.
        counts: `added`, `grown`, `shrunk` ellipsoids and `table_rve_solves` since the start.
        seconds: of what it began with, set by who made it.

    Raises:
        InputError: the law gives no tangents, or the tolerance is not positive.
    """

    has_tangents = True
    is_calibrated = True

    def __init__(
        self,
        law: Fallback,
        tolerance: float,
        range: SamplingRange,
        spread: float,
        most_records: int = MOST_RECORDS,
    ) -> None:
        if not 0.0 < tolerance < np.inf:
            raise InputError(f"table.tolerance: {tolerance} µN/µm; it must be positive and finite")
        if not law.has_tangents:
            raise InputError(
                "table: a record needs exact tangents, which solver iterated does not give; use "
                "solver direct"
            )
        self.law = law
        self.cell = law.cell
        self.initialisation = law.initialisation
        self.density = law.density
        self.images = 4 if law.cell.symmetry == "D4" else 1
        self.tolerance = float(tolerance)
        self.range = range
        self.stress_spread = float(spread)
        self._allowed = 1.0  # µN/µm, until `with_tolerance` says what is
        self.most_records = most_records
        self.seconds = 0.0
        self._reach = half_widths(range)
        self._known = _Knowledge()
        self.restore(NO_RECORDS)

    @property
    def size(self) -> int:
        """How many records it has."""
        return len(self._known.records.centre)

    @property
    def records(self) -> Records:
        """What the table knows now, a copy."""
        return Records(*(part.copy() for part in self._known.records))

    @property
    def counts(self) -> Counter[str]:
        return self._known.counts

    def with_tolerance(self, tolerance: float, relative: float) -> StressTable:
        """A table of the same records, whose risks are by this fraction of the spread.

        The records, their ellipsoids and the counts are shared, so that what one table learns all
        of them know: they are grown for `tolerance` of the table alone. The tolerance by which
        risks count is not shared.
        """
        table = copy(self)
        table._allowed = tolerance * self.stress_spread
        return table

    def local_tolerance(self, F: Array, F_dot: Array) -> Array:
        return np.ones(len(F))

    def lookup(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """(stress (n, 2, 2), status (n,), risk (n,)) in one compiled pass; input is not checked.

        The risk is a bound of the error over the tolerance of `with_tolerance`, of 1 µN/µm before
        it is called. The bound in µN/µm is the table's own tolerance times the radius within the
        ellipsoid, 0 at the record and 1 at the surface; the law through the errors seen would be
        its square. Status 3 where no ellipsoid holds the point (risk infinite), 6 where the risk is
        above `limit`.

        F, F_dot: contiguous float64 (n, 2, 2).
        """
        known = self._known
        if known.screen is None:
            known.screen = make_screen(known.records)
        tolerances = float(limit) * self._allowed, self.tolerance
        stress, status, risk = look_up(
            F, F_dot, tolerances, self.images, known.records, known.screen
        )
        np.divide(risk, self._allowed, out=risk, where=np.isfinite(risk))
        return stress, status, risk

    def status_and_risk(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        return self.lookup(F, F_dot, limit)[1:]

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """∂P/∂F and ∂P/∂Ḟ of the stress of `lookup` at the limit 1, exact to rounding; NaN where no
        ellipsoid holds the point.

        F, F_dot: contiguous float64 (n, 2, 2), det F > 0.
        """
        tolerances = self._allowed, self.tolerance
        return table_tangents(F, F_dot, tolerances, self.images, self._known.records)

    def learn(self, F: Array, F_dot: Array, stress: Array, state: Any = None) -> None:
        """Take RVE answers (m, 2, 2) in: grow or shrink ellipsoids, and add records where none
        holds; `state` is the law's warm start at these points, or None."""
        known = self._known
        known.screen = None
        x, R = to_inputs(F, F_dot)
        s = to_components(transpose(R) @ stress @ R)
        uncovered = np.flatnonzero(~self._cover(x, s, known.records))
        while len(uncovered) and self.size < self.most_records:
            chosen = uncovered[self._apart(x[uncovered], self.most_records - self.size)]
            new = self._solved(x[chosen], R[chosen], state, chosen)
            uncovered = np.setdiff1d(uncovered, chosen, assume_unique=True)
            uncovered = uncovered[~self._cover(x[uncovered], s[uncovered], new)]
            both = zip(known.records, new, strict=True)
            known.records = Records(*(np.concatenate(pair) for pair in both))
            self.counts["added"] += len(new.centre)
            if self.size >= self.most_records:
                _log.warning(
                    "the table is full with %d records; it grows its ellipsoids, and RVEs answer "
                    "where none holds. A larger table.tolerance needs fewer",
                    self.size,
                )

    def apart(self, F: Array, F_dot: Array, most: int) -> Index:
        """Numbers of at most so many states that lie apart, none in the ellipsoid of another if all
        are like that of the latest record; F, F_dot: (m, 2, 2)."""
        return self._apart(to_inputs(F, F_dot)[0], most)

    def learn_rest(self) -> None:
        """Make the undeformed state a record, at which all points of a tissue begin."""
        F = np.eye(2)[None]
        F_dot = np.zeros((1, 2, 2))
        answer = self.law.respond(F, F_dot)
        accepted = self.law.accept(F, F_dot, answer)
        if not accepted.status.any():
            self.learn(F, F_dot, accepted.stress, accepted.state)

    def restore(self, records: Records) -> None:
        """Know these records and no others."""
        self._known.records = Records(*(part.copy() for part in records))
        self._known.screen = None

    def to_arrays(self) -> dict[str, NDArray]:
        return {**self.records._asdict(), "counts": np.array(list(self.counts.values()))}

    def from_arrays(self, arrays: Mapping[str, NDArray]) -> None:
        self.restore(Records(*(arrays[name] for name in Records._fields)))
        counts = dict(zip(self.counts, arrays["counts"].tolist(), strict=True))
        self._known.counts = Counter(counts)

    def _cover(self, x: Array, s: Array, records: Records) -> Flags:
        """(m,) which RVE answers these records cover, after they have grown and shrunk by them."""
        covered: Flags
        at = self.images, records, self.tolerance, RULE
        covered, grown, shrunk = update_ellipsoids(x, s, *at)
        self.counts.update(grown=grown, shrunk=shrunk)
        return covered

    def _apart(self, x: Array, most: int) -> Index:
        """Return which of these points should become records at once, at most so many: none in the
        ellipsoid of another, taken to be like that of the latest record; a first one comes alone.
        """
        if not self.size:
            return np.zeros(1, dtype=np.intp)
        curvature = self._known.records.curvature[-1]
        x = x * INPUT_SIGNS[self._image(x)]
        chosen: list[int] = []
        candidates = np.arange(len(x))
        while len(candidates) and len(chosen) < most:
            chosen.append(int(candidates[0]))
            d = x[candidates] - x[candidates[0]]
            outside = np.einsum("ni,ij,nj->n", d, curvature, d) > self.tolerance
            outside[0] = False
            candidates = candidates[outside]
        return np.array(chosen, dtype=np.intp)

    def _solved(self, x: Array, R: Array, state: Any, points: Index) -> Records:
        """Records at canonical images of the points x (m, 7) at R (m, 2, 2).

        Eight RVEs each: the point, and a neighbour along every input. Where a neighbour has no
        tangents, the ellipsoid is that of the stress taken as constant; a point that has none
        itself gets no record. Their warm start is that of the `points` (m,) of the law's state.
        """
        m = len(x)
        step = NEIGHBOUR * self._reach
        nearby = x[:, None] + np.concatenate([np.zeros((1, INPUTS)), np.diag(step)])
        frame = np.repeat(R, _GROUP, axis=0)
        F, F_dot = from_inputs(nearby.reshape(-1, INPUTS), frame)
        warm = None if state is None else state.take(np.repeat(points, _GROUP))
        answer = self.law.respond(F, F_dot, warm, tangents=True)
        self.counts["table_rve_solves"] += len(F)
        assert answer.tangents is not None  # a law without them has no table
        stress = np.where(answer.status[:, None, None] == 0, answer.stress, 0.0)
        slopes = input_slopes(frame, *answer.tangents.cauchy(F, stress))
        slopes = slopes.reshape(m, _GROUP, OUTPUTS, INPUTS)
        sound = (answer.status == 0).reshape(m, _GROUP) & np.isfinite(slopes).all(axis=(2, 3))
        sampled = np.flatnonzero(sound[:, 0])
        whole = sound[sampled].all(axis=1)
        slopes = slopes[sampled]
        x = x[sampled]
        s = to_components(transpose(frame) @ stress @ frame).reshape(m, _GROUP, OUTPUTS)[sampled, 0]
        curvature = curvature_from_constant(slopes[:, 0], self.tolerance)
        curvature[whole] = MARGIN * curvature_from_slopes(
            slopes[whole, 0], slopes[whole, 1:], step, self._reach
        )
        curvature += np.diag(self.tolerance / self._reach**2)  # semi-axes of at most the reach
        image = self._image(x)
        inner = INPUT_SIGNS[image]
        outer = COMPONENT_SIGNS[image]
        return Records(
            x * inner,
            s * outer,
            slopes[:, 0] * outer[:, :, None] * inner[:, None],
            curvature * inner[:, :, None] * inner[:, None],
        )

    def _image(self, x: Array) -> Index:
        """(n,) which image of each state is its canonical one; 0 without symmetry."""
        return canonical_image(x) if self.images > 1 else np.zeros(len(x), dtype=np.intp)


def sampled_spread(law: Fallback, range: SamplingRange, seed: int = 1) -> float:
    """Spread of the stress over `SPREAD_SAMPLES` Sobol samples of a range, µN/µm; InputError
    without one."""
    F, F_dot = sample(range, SPREAD_SAMPLES, seed)
    answer = law.respond(F, F_dot)
    valid = answer.stress[answer.status == 0]
    if not len(valid):
        raise InputError("range: no sample of it has a stress; narrow it")
    return stress_spread(valid)

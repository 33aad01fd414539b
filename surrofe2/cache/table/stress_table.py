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

# Samples by which the spread of stress is known within 0.3 % of that of 512, on all recipes.
SPREAD_SAMPLES = 32
# Distance of a neighbour from its record, in half widths of the range: far enough that slopes
# change by more than rounding, near enough that the change is linear.
NEIGHBOUR = 0.1
# Factor of the second derivatives, which change within the ellipsoid.
MARGIN = 1.2
# All records are screened for every point, so a lookup costs as much as there are.
MOST_RECORDS = 4096

_GROUP = 1 + INPUTS  # a record's RVEs: at its centre, and a neighbour along each input
_log = logging.getLogger("surrofe2.cache")


def _no_counts() -> Counter[str]:
    """Return the counts of a table that has learnt nothing."""
    return Counter(added=0, grown=0, shrunk=0, table_rve_solves=0)


@dataclass(slots=True)
class _Knowledge:
    """The records that tables with several tolerances share.

    Attributes:
        records: the RVE answers with their ellipsoids.
        screen: of these records, for `look_up`; None: it is made when next needed.
        counts: see `StressTable`.
    """

    records: Records = NO_RECORDS
    screen: Array | None = None
    counts: Counter[str] = field(default_factory=_no_counts)


class StressTable:
    """The stress σ(F, Ḟ) from linear models about RVE answers, each within its ellipsoid.

    `lookup` is pure; the table changes in `learn` alone. Tables by `with_tolerance` share their
    records, and each has the tolerance of its risks to itself.

    Args:
        law: that of the RVEs, whose `respond(…, tangents=True)` gives records.
        tolerance: largest error of a stress that is looked up, µN/µm.
        range: its half widths say how far neighbours lie from a record (a tenth) and how far an
            ellipsoid may reach at first; the table answers beyond it too.
        spread: of the stress, µN/µm, of which tolerances are fractions.
        most_records: after so many none is added; the law answers where none holds a point.

    Attributes:
        images: number of states that the symmetry of the cell makes of one, itself included.
        counts: `added`, `grown`, `shrunk` ellipsoids and `table_rve_solves` since the start.
        seconds: what its first records took, s; set by the caller that made them.

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
        self._allowed = 1.0  # allowed error, µN/µm, until `with_tolerance` states one
        self.most_records = most_records
        self.seconds = 0.0
        self._reach = half_widths(range)
        self._known = _Knowledge()
        self.restore(NO_RECORDS)

    @property
    def size(self) -> int:
        """Number of records."""
        return len(self._known.records.centre)

    @property
    def records(self) -> Records:
        """A copy of the records that the table has now."""
        return Records(*(part.copy() for part in self._known.records))

    @property
    def counts(self) -> Counter[str]:
        """Counts of all that was learnt, shared by tables of the same records."""
        return self._known.counts

    def with_tolerance(self, tolerance: float, relative: float) -> StressTable:
        """Return a table of the same records whose risks are by this fraction of the spread.

        Records, ellipsoids and counts are shared: what one table learns all of them know, and
        ellipsoids are grown for the `tolerance` by which the first table was made. The tolerance of
        the risks is not shared. A table has no use for the `relative` one.
        """
        table = copy(self)
        table._allowed = tolerance * self.stress_spread
        return table

    def local_tolerance(self, F: Array, F_dot: Array) -> Array:
        """Return ones (n,): a table has one tolerance everywhere."""
        return np.ones(len(F))

    def lookup(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[Array, NDArray[np.int8], Array]:
        """Look up stress and risk at n points, in one compiled pass; input is not checked.

        The risk is a bound of the error over the tolerance of `with_tolerance`, of 1 µN/µm before
        it is called. The bound in µN/µm is the table's own tolerance times the radius within the
        ellipsoid, 0 at the record and 1 at the surface. Errors that were observed follow its
        square.

        Args:
            F, F_dot: contiguous float64 (n, 2, 2).
            limit: largest risk that is trusted.

        Returns:
            stress (n, 2, 2); status (n,): 3 where no ellipsoid holds the point, 6 where the risk is
            above `limit`; risk (n,), infinite where no ellipsoid holds the point.
        """
        known = self._known
        if known.screen is None:
            known.screen = make_screen(known.records)
        tolerances = (float(limit) * self._allowed, self.tolerance)
        stress, status, risk = look_up(
            F, F_dot, tolerances, self.images, known.records, known.screen
        )
        np.divide(risk, self._allowed, out=risk, where=np.isfinite(risk))
        return stress, status, risk

    def status_and_risk(
        self, F: Array, F_dot: Array, limit: float = np.inf
    ) -> tuple[NDArray[np.int8], Array]:
        """Return status and risk of `lookup`, which costs the same."""
        return self.lookup(F, F_dot, limit)[1:]

    def tangents(self, F: Array, F_dot: Array) -> Tangents:
        """Compute ∂P/∂F and ∂P/∂Ḟ of the stress of `lookup` at the limit 1, exact to rounding.

        They are NaN where no ellipsoid holds the point. F, F_dot: contiguous float64 (n, 2, 2),
        det F > 0.
        """
        tolerances = (self._allowed, self.tolerance)
        return table_tangents(F, F_dot, tolerances, self.images, self._known.records)

    def learn(self, F: Array, F_dot: Array, stress: Array, state: Any = None) -> None:
        """Learn from m RVE answers: change ellipsoids, and add records where none holds an answer.

        Args:
            F, F_dot, stress: (m, 2, 2) what was asked and answered.
            state: the law's warm start at these points, or None.
        """
        known = self._known
        known.screen = None
        x, R = to_inputs(F, F_dot)  # the seven inputs, and the rotation
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
        """Choose at most so many of m states that lie apart, and return their numbers.

        None is in the ellipsoid of another, if all ellipsoids are like that of the latest record.
        F, F_dot: (m, 2, 2).
        """
        x, _ = to_inputs(F, F_dot)
        return self._apart(x, most)

    def learn_rest(self) -> None:
        """Make the undeformed state a record, at which all points of a tissue begin."""
        F = np.eye(2)[None]
        F_dot = np.zeros((1, 2, 2))
        answer = self.law.respond(F, F_dot)
        accepted = self.law.accept(F, F_dot, answer)
        if not accepted.status.any():
            self.learn(F, F_dot, accepted.stress, accepted.state)

    def restore(self, records: Records) -> None:
        """Replace all records by these."""
        self._known.records = Records(*(part.copy() for part in records))
        self._known.screen = None

    def to_arrays(self) -> dict[str, NDArray]:
        """Return records and counts, for a checkpoint or a file."""
        return {**self.records._asdict(), "counts": np.array(list(self.counts.values()))}

    def from_arrays(self, arrays: Mapping[str, NDArray]) -> None:
        """Take records and counts from arrays that `to_arrays` gave."""
        self.restore(Records(*(arrays[name] for name in Records._fields)))
        counts = dict(zip(self.counts, arrays["counts"].tolist(), strict=True))
        self._known.counts = Counter(counts)

    def _cover(self, x: Array, s: Array, records: Records) -> Flags:
        """Let m RVE answers grow and shrink the ellipsoids of these records.

        Returns:
            (m,) whether an ellipsoid holds each answer then.
        """
        covered: Flags
        covered, grown, shrunk = update_ellipsoids(x, s, self.images, records, self.tolerance, RULE)
        self.counts.update(grown=grown, shrunk=shrunk)
        return covered

    def _apart(self, x: Array, most: int) -> Index:
        """Choose which of these points should become records at once, at most so many.

        None is in the ellipsoid of another, taken to be like that of the latest record. Where there
        is no record yet, a first one is chosen alone.

        Returns:
            Numbers of the points.
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
        """Solve records at the canonical images of m points.

        A record takes eight RVEs: the point, and a neighbour along every input. Where a neighbour
        has no tangents, the ellipsoid is that of the stress taken as constant. A point that has
        none itself gets no record.

        Args:
            x, R: (m, 7) inputs and (m, 2, 2) rotations of the points.
            state: the law's warm start at all points, or None.
            points: (m,) numbers of these points in `state`.
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
        sampled = np.flatnonzero(sound[:, 0])  # points that get a record
        whole = sound[sampled].all(axis=1)  # of which all neighbours have tangents, too
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
        """Return (n,) which image of each state is its canonical one; 0 without symmetry."""
        if self.images == 1:
            return np.zeros(len(x), dtype=np.intp)
        return canonical_image(x)


def sampled_spread(law: Fallback, range: SamplingRange, seed: int = 1) -> float:
    """Compute the spread of the stress over `SPREAD_SAMPLES` Sobol samples of a range, µN/µm.

    Raises:
        InputError: no sample has a stress.
    """
    F, F_dot = sample(range, SPREAD_SAMPLES, seed)
    answer = law.respond(F, F_dot)
    valid = answer.stress[answer.status == 0]
    if not len(valid):
        raise InputError("range: no sample of it has a stress; narrow it")
    return stress_spread(valid)

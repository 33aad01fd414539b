"""What a lesson costs a table of many records, the RVEs that it asks for left out."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.row import Row
from benchmarks.setting import Array, Setting
from benchmarks.timing import threads
from surrofe2.cache import StressTable
from surrofe2.cache.table.records import Records
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.rve import RveLaw
from surrofe2.sampling import SamplingRange, sample
from surrofe2.square_symmetry import INPUT_SIGNS, canonical_image
from surrofe2.stress_law import StressResponse
from surrofe2.tensors import to_inputs

TITLE = "A lesson of the table: one true answer, which becomes a record"
RANGE = SamplingRange(stretch=(0.95, 1.05), shear=0.05, rate=0.01)
SPREAD, TOLERANCE = 40.0, 1e-3
_SMALLER = 0.1  # ellipsoids are so much narrower that most lessons are new to 100,000 records


class _StoppedLaw(RveLaw):
    """The true law with a clock on its answers."""

    seconds = 0.0

    def respond(
        self, F: Any, F_dot: Any, state: Any = None, *, tangents: bool = False
    ) -> StressResponse:
        begin = perf_counter()
        answer = super().respond(F, F_dot, state, tangents=tangents)
        self.seconds += perf_counter() - begin
        return answer


def run(setting: Setting) -> list[Row]:
    """Tables of 1,000 and 100,000 records; 2,000 in quick mode."""
    lessons = setting.pick(1000, 50)
    with threads(1):
        few = _lessons(1000, lessons)
        many_records = setting.pick(100_000, 2000)
        many = _lessons(many_records, lessons)
    low, high = np.percentile(many, (25, 75))
    return [
        Row(
            name=f"a lesson of {many_records:,} records",
            value=1e3 * float(np.median(many)),
            spread=1e3 * float(high - low),
            unit="ms",
            limit=setting.if_full(1.0),
            baseline="the same of 1,000 records",
            baseline_value=1e3 * float(np.median(few)),
            ratio=float(np.median(few) / np.median(many)),
            note=f"longest {1e3 * float(many.max()):.1f} ms",
        )
    ]


def _lessons(records: int, count: int) -> Array:
    """Seconds of each lesson of a table that begins with so many records."""
    law = _StoppedLaw(CellParameters.preset("printed"))
    table = StressTable(law, TOLERANCE * SPREAD, RANGE, SPREAD, most_records=records + count)
    table.warm_up()
    F, F_dot = sample(RANGE, 16, 1)
    table.learn(F, F_dot, law.respond(F, F_dot).stress)
    known, x = table.records, to_inputs(*sample(RANGE, records, 2))[0]
    copies = known.take(np.arange(records) % table.size)
    table.restore(
        Records(
            x * INPUT_SIGNS[canonical_image(x)],
            copies.stress,
            copies.slope,
            copies.curvature / _SMALLER**2,
            copies.extent * _SMALLER**2,
        )
    )
    F, F_dot = sample(RANGE, count, 3)
    true = law.respond(F, F_dot).stress
    taken = np.empty(count)
    for k in range(count):
        begin, of_law = perf_counter(), law.seconds
        table.learn(F[k : k + 1], F_dot[k : k + 1], true[k : k + 1])
        taken[k] = perf_counter() - begin - (law.seconds - of_law)
    return taken

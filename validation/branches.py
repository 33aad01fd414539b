"""Whether irregular plant cells with a uniform fluid keep to one branch, by any path.

Random states, all entries of F − I up to a level, are led from I straight, and by way of their
shear alone. docs/validation/branches.md has the table.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from surrofe2.law.stress_law import Status, StressResponse
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.report.study import Study
from surrofe2.report.tables import Quantity, Table
from surrofe2.run.charts import Curve, Panel
from surrofe2.rve import RveLaw
from validation.case import Array, Setting

STATES = 200
SEEDS = (1, 2, 3, 4, 5)
LEVELS = (0.01, 0.02, 0.04, 0.08)
SAPS = {"drained": 0.0, "undrained": 2200.0}
"""Bulk modulus of the sap, MPa; the second is that of water."""
SAME = 1e-9
"""Difference of two stresses, over the turgor, that the solver's tolerance may leave."""


@dataclass(frozen=True, slots=True)
class Counted:
    """What became of the states of one RVE at one level.

    Attributes:
        sap, seed, level: of the RVE, and of its states.
        states: how many.
        left, failed: of them, on the straight path.
        by_shear: left or failed by way of their shear.
        unreported: two stresses that differ by more than `SAME` of the turgor and neither of which
            is reported.
        apart: largest difference of two stresses, neither reported, over the turgor.
        solves: of a state on the straight path, by Newton's method, mean.
    """

    sap: str
    seed: int
    level: float
    states: int
    left: int
    failed: int
    by_shear: int
    unreported: int
    apart: float
    solves: float


QUANTITIES: tuple[Quantity[Counted], ...] = (
    Quantity("sap", "", "", lambda row: row.sap),
    Quantity("seed", "", "d", lambda row: row.seed),
    Quantity("level", "%", "g", lambda row: 100.0 * row.level),
    Quantity("left their branch", "", "d", lambda row: row.left),
    Quantity("failed", "", "d", lambda row: row.failed),
    Quantity("left or failed by shear first", "", "d", lambda row: row.by_shear),
    Quantity("another branch, not reported", "", "d", lambda row: row.unreported),
    Quantity("difference of the others over turgor", "", ".1e", lambda row: row.apart),
    Quantity("solves by Newton's method", "", ".1f", lambda row: row.solves),
)


def branches(setting: Setting) -> Study:
    """Counts of all seeds and levels, drained and undrained."""
    seeds = SEEDS[:2] if setting.quick else SEEDS
    states = STATES // 5 if setting.quick else STATES
    rows = [
        count(law_of(setting.of.cell, sap, seed), sap, seed, level, states)
        for sap in SAPS
        for seed in seeds
        for level in LEVELS
    ]
    curves = []
    for sap in SAPS:
        shares = [
            lost_share([row for row in rows if (row.sap, row.level) == (sap, level)])
            for level in LEVELS
        ]
        curves.append(Curve(sap, 100.0 * np.array(LEVELS), 100.0 * np.array(shares)))
    panel = Panel("largest entry of F − I (%)", "left or failed (% of states)", tuple(curves))
    return Study(
        title=f"Random states of nine Voronoi cells, {states} each of {len(seeds)} seeds",
        panels=(panel,),
        table=Table(QUANTITIES, rows),
    )


def lost_share(rows: list[Counted]) -> float:
    """Part of all states that left their branch or failed."""
    return sum(row.left + row.failed for row in rows) / sum(row.states for row in rows)


def law_of(cell: CellParameters, sap: str, seed: int) -> RveLaw:
    """Elastic equilibria of nine Voronoi cells."""
    irregular = replace(
        cell,
        fluid="uniform",
        arrangement="voronoi",
        cells=9,
        arrangement_seed=seed,
        sap_bulk_modulus=SAPS[sap],
    )
    return RveLaw(irregular, initialisation="elastic")


def count(law: RveLaw, sap: str, seed: int, level: float, states: int) -> Counted:
    """What becomes of random states, straight and by way of their shear."""
    rng = np.random.default_rng(seed)
    F = np.eye(2) + level * rng.uniform(-1.0, 1.0, (states, 2, 2))
    sheared = F.copy()
    sheared[:, 0, 0] = sheared[:, 1, 1] = 1.0
    straight = settled(law, F)
    by_shear = settled(law, F, settled(law, sheared))
    reported = is_reported(straight) | is_reported(by_shear)
    turgor = law.cell.fluid_density * law.cell.sound_speed**2
    apart = np.abs(straight.stress - by_shear.stress).max(axis=(1, 2)) / turgor
    unreported = ~reported & (apart > SAME)
    same = ~reported & ~unreported
    return Counted(
        sap=sap,
        seed=seed,
        level=level,
        states=states,
        left=int((straight.state.left_points & (straight.status == Status.OK)).sum()),
        failed=int((straight.status != Status.OK).sum()),
        by_shear=int(is_reported(by_shear).sum()),
        unreported=int(unreported.sum()),
        apart=float(apart[same].max(initial=0.0)),
        solves=straight.effort["newton_solves"] / states,
    )


def settled(law: RveLaw, F: Array, before: StressResponse | None = None) -> StressResponse:
    """The accepted answer at rest at F, from a state before."""
    still = np.zeros_like(F)
    answer = law.respond(F, still, None if before is None else before.state)
    return law.accept(F, still, answer)


def is_reported(answer: StressResponse) -> NDArray[np.bool_]:
    """(n,) whether the law says that a point left its branch or has no stress."""
    return np.asarray(answer.state.left_points | (answer.status != Status.OK))

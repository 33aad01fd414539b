"""One call of an RVE law: tiles of deformation in, tiles of stress and status out."""

from __future__ import annotations

import numpy as np

from surrofe2.plant_cell.tiles import pack, unpack
from surrofe2.rve.particle_state import Drive
from surrofe2.rve.rve_state import RveState
from surrofe2.rve.settings import RveSettings
from surrofe2.rve.slow_solution import SlowSolution
from surrofe2.rve.solution import Solution, Ways, covered_by
from surrofe2.rve.unit_cell import UnitCell
from surrofe2.stress_law import Status


def solve_rves(
    unit: UnitCell,
    settings: RveSettings,
    drive: Drive,
    before: RveState,
    cold: bool,
    level: int = 0,
    earlier: Ways = None,
) -> Solution:
    """Initialise every RVE; where the list of contacts was too short, again with a longer.

    Args:
        drive: F and Ḟ in tiles.
        before: where to start from; it is not touched. `cold`: it is the state at rest.
        level: which of the unit's lists of contacts to take first.
        earlier: how far points have come by shorter lists.
    """
    kind = SlowSolution if settings.initialisation == "slow-manifold" else Solution
    solution = kind(unit, settings, drive, before, cold, level, earlier)
    solution.solve()
    covered = covered_by(unit, level, drive.F, solution.state.z) | solution.lost
    covered &= ~solution.held_up
    if covered.all():
        return solution
    if level == len(unit.patches) - 1:
        solution.status[~covered & (solution.status == Status.OK)] = Status.LIST_TOO_SHORT
        return solution
    index = np.flatnonzero(~unpack(covered, before.points))
    part_drive = Drive(*(pack(unpack(tensor, before.points)[index]) for tensor in drive))
    ways = solution.ways_of(index)
    part = solve_rves(unit, settings, part_drive, before.take(index), cold, level + 1, ways)
    if len(index) == before.points:
        part.newton_solves += solution.newton_solves
        return part
    solution.put(index, part)
    return solution

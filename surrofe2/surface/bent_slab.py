"""A slab bent evenly: how stiff it is, and so how far below the outline its sides act.

Column a is column 0 turned by a θ about a centre that lies λ h/θ above the slab's middle, so that
the middle keeps its stretch λ. With W the energy of a column the moment is dW/dθ, and κ = θ/h the
curvature by undeformed length (docs/theory.md, surface law, where it acts). Particles come to rest
by the factors of the straight slab.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from surrofe2.base.errors import InputError
from surrofe2.base.simd import TILE
from surrofe2.plant_cell.forces import local_forces
from surrofe2.plant_cell.tiles import make_workspace
from surrofe2.rve.block_lu import solve
from surrofe2.rve.rve_state import kept_factors
from surrofe2.rve.unit_cell import UnitCell

Array = NDArray[np.float64]

TURN = 2e-4
"""θ, by which the moment is differenced."""
_LIMIT, _DONE = 200, 1e-8


def bend(unit: UnitCell, F: Array, z: Array) -> tuple[float, Array]:
    """(∂(dW/dθ)/∂κ in µN µm², (n, 2) particles at θ = `TURN`) of a slab without resultant.

    Positions count from the middle of the slab, where column 0 begins and x runs along it.

    Args:
        F: (2, 2) diagonal, at which the straight slab has no resultant.
        z: (n, 2) material positions of its particles there.

    Raises:
        InputError: the bent slab does not come to rest.
    """
    topology, n = unit.topologies[-1], len(z)
    side, span = unit.cell.cell_side, F[0, 0] * unit.cell.cell_side
    theta = TURN * (-1.0) ** np.arange(TILE)
    x = z @ F.T
    x[:, 1] -= 0.5 * (x[:, 1].min() + x[:, 1].max())
    angle = theta * x[:, :1] / span
    radius = span / theta - x[:, 1:]
    at = np.stack([radius * np.sin(angle), x[:, 1:] + 2.0 * radius * np.sin(0.5 * angle) ** 2])
    column = np.rint(topology.image_offset[:, :1] / side)
    turn = column * theta
    cos, sin = np.cos(turn), np.sin(turn)
    moved = span / theta * np.stack([sin, 2.0 * np.sin(0.5 * turn) ** 2])
    by_theta = (column * span * np.stack([cos, sin]) - moved) / theta
    straight, work = unit.topologies[0], make_workspace(topology)
    lu, _ = kept_factors(unit.factors.address[0], straight)
    work.v[:] = 0.0
    for _ in range(_LIMIT):
        own = at[:, topology.owner]
        turned = np.stack([cos * own[0] - sin * own[1], sin * own[0] + cos * own[1]])
        work.x[:] = np.concatenate([at, turned + moved], axis=1)
        local_forces(work, topology, unit.constants)
        f, pulled = work.f[:, :n].copy(), work.f[:, n:]
        back = np.stack([cos * pulled[0] + sin * pulled[1], cos * pulled[1] - sin * pulled[0]])
        for axis in range(2):
            np.add.at(f[axis], topology.owner, back[axis])
        if abs(f[:, 1:]).max() < _DONE * abs(work.f).max():
            across = column * np.stack([-turned[1], turned[0]]) + by_theta
            moment = -(pulled * across).sum(axis=(0, 1))
            return float(side * np.mean(moment / theta)), at[..., 0].T.copy()
        step = np.ascontiguousarray(-np.swapaxes(f[:, 1:], 0, 1)).reshape(-1, TILE)
        solve(lu, step, straight)
        at[:, 1:] += np.swapaxes(step.reshape(-1, 2, TILE), 0, 1)
    raise InputError("surface: a bent slab finds no rest; check outer_wall and wall_stiffness")

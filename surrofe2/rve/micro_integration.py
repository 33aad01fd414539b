"""The RVE integrated in time while its lattice follows F(t): the reference of all initialisations.

The paper's "full microscopic time integration" (figure 5): corners move with F(t), the particles
obey the micro problem (40), m ü¹ = f(x, v) with x = F X + u¹ and v = Ḟ X + u̇¹. Classical
Runge–Kutta, fourth order where no pair crosses the cut-off.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import kernel
from surrofe2.base.errors import InputError, SimulationError
from surrofe2.base.simd import TILE, load, store
from surrofe2.plant_cell.forces import fold_images, local_forces
from surrofe2.plant_cell.pair_sums import make_workspace
from surrofe2.rve.constrained_runs import set_moving_images
from surrofe2.rve.rve_law import RveLaw
from surrofe2.rve.rve_state import Drive, cauchy_stress, drive_of, map_affine

Path = Callable[[float], tuple[Array, Array]]
"""A function of time t, µs, that returns F and Ḟ, each (2, 2)."""

_CHUNK = 500
"""Time steps for which F and Ḟ are computed at once."""


def integrate_rve(law: RveLaw, path: Path, times: Array, micro_step: float = 1e-3) -> Array:
    """Compute the stress along F(t), from rest at the elastic equilibrium of F(times[0]).

    Args:
        law: law whose plant cell is driven; its initialisation makes no difference.
        path: t to (F, Ḟ).
        times: (m,) times at which stresses are wanted, µs, increasing.
        micro_step: longest step, µs; stable to about 3e-3 with critical damping.

    Returns:
        (m, 2, 2) Cauchy stress, µN/µm; the first with the velocities of Ḟ(times[0]).

    Raises:
        SimulationError: particles flew apart: the step is too long or the path unstable.
    """
    times = np.asarray(times, dtype=np.float64)
    if times.ndim != 1 or (np.diff(times) <= 0.0).any() or not micro_step > 0.0:
        raise InputError("micro-integration: times must increase and micro_step be positive")
    unit = law.unit_cell
    # one RVE, the same in all lanes of a tile
    X = law.rest_state(1).z[0]
    mass = unit.neighbours.mass
    topology = unit.topology
    F, F_dot = path(times[0])
    elastic = RveLaw(law.cell, initialisation="elastic", reference=law.reference)
    z = elastic.respond(F[None], np.zeros((1, 2, 2))).state.z[0]
    u = np.einsum("ab,bpl->apl", F, z - X)
    # velocities begin affine: v = Ḟ X + w = Ḟ z
    w = np.einsum("ab,bpl->apl", F_dot, z - X)

    def stress(F: Array, F_dot: Array) -> Array:
        """Return the Cauchy stress (2, 2) of the particles as they are, at F and Ḟ."""
        tile = np.empty((2, 2, TILE))
        _set_stress(u, w, Drive(*_lanes([F, F_dot])), X, topology, unit.constants, tile)
        return tile[..., 0].copy()

    stresses = [stress(F, F_dot)]
    for begin, end in pairwise(times):
        steps = int(np.ceil((end - begin) / micro_step))
        dt = (end - begin) / steps
        for first in range(0, steps, _CHUNK):
            count = min(_CHUNK, steps - first)
            # Runge–Kutta needs F and Ḟ in the middle of a step, too
            half_steps = begin + dt * (first + 0.5 * np.arange(2 * count + 1))
            deformations = []
            rates = []
            for t in half_steps:
                F, F_dot = path(float(t))
                deformations.append(F)
                rates.append(F_dot)
            drive = Drive(_lanes(deformations), _lanes(rates))
            _integrate(u, w, drive, dt, X, mass, topology, unit.constants)
        if not np.isfinite(u).all():
            raise SimulationError(
                f"micro-integration: particles flew apart before t = {end} µs; take a shorter "
                f"micro_step than {micro_step} µs or a gentler path"
            )
        stresses.append(stress(*path(float(end))))
    return np.array(stresses)


def _lanes(tensors: list[Array]) -> Array:
    """Pack k tensors (2, 2) into (k, 2, 2, TILE), the same in every lane."""
    return np.ascontiguousarray(np.repeat(np.array(tensors)[..., None], TILE, axis=-1))


@kernel
def _set_forces(u, w, drive, X, topology, constants, workspace):
    """Fill workspace.f with the forces at x = F X + u and v = Ḟ X + w, not folded yet.

    u, w: (2, n, TILE) displacement u¹ and its rate. X: (2, n, TILE) reference positions, µm. Images
    have the u and w of their owners.
    """
    map_affine(drive.F, X, workspace.x)
    map_affine(drive.rate, X, workspace.v)
    for axis in range(2):
        for i in range(topology.particles):
            store(load(workspace.x, axis, i) + load(u, axis, i), workspace.x, axis, i)
            store(load(workspace.v, axis, i) + load(w, axis, i), workspace.v, axis, i)
    set_moving_images(drive.F, drive.rate, workspace.x, workspace.v, topology)
    local_forces(workspace, topology, constants)


@kernel
def _set_stress(u, w, drive, X, topology, constants, stress):
    """Fill stress (2, 2, TILE) with the Cauchy stress at u and w, µN/µm."""
    workspace = make_workspace(topology)
    _set_forces(u, w, drive, X, topology, constants, workspace)
    cauchy_stress(workspace.x, workspace.f, drive.F, topology.area, stress)


@kernel
def _accelerations(u, w, drive, X, mass, topology, constants, workspace, a):
    """Fill a (2, n, TILE) with the accelerations f/m at u and w, µm/µs²."""
    _set_forces(u, w, drive, X, topology, constants, workspace)
    fold_images(workspace.f, topology)
    for i in range(topology.particles):
        for axis in range(2):
            store(load(workspace.f, axis, i) / mass[i], a, axis, i)


@kernel
def _integrate(u, w, drive, dt, X, mass, topology, constants):
    """Make classical Runge–Kutta steps of u and w (2, n, TILE) of length dt, in place.

    drive: F and Ḟ at every half step, (2 steps + 1, 2, 2, TILE).
    """
    workspace = make_workspace(topology)
    a1 = np.empty_like(u)
    a2 = np.empty_like(u)
    a3 = np.empty_like(u)
    a4 = np.empty_like(u)
    half = 0.5 * dt
    for step in range((drive.F.shape[0] - 1) // 2):
        first = drive_of(drive, 2 * step)
        middle = drive_of(drive, 2 * step + 1)
        last = drive_of(drive, 2 * step + 2)
        # stages of u̇ = w, ẇ = a(t, u, w): the rates of u are w and w2 to w4, those of w are a1 to
        # a4
        _accelerations(u, w, first, X, mass, topology, constants, workspace, a1)
        w2 = w + half * a1
        _accelerations(u + half * w, w2, middle, X, mass, topology, constants, workspace, a2)
        w3 = w + half * a2
        _accelerations(u + half * w2, w3, middle, X, mass, topology, constants, workspace, a3)
        w4 = w + dt * a3
        _accelerations(u + dt * w3, w4, last, X, mass, topology, constants, workspace, a4)
        u += dt / 6.0 * (w + 2.0 * w2 + 2.0 * w3 + w4)
        w += dt / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)

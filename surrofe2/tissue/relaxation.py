"""The tissue at rest without load, `relax`, and its longest stable step, `stable_step`.

`relax` is adaptive dynamic relaxation: a drag −c m v instead of dashpots and viscosity, critical
for the slowest mode, c = 2 ω, with ω² = −Δx·Δf/(Δx·m Δx) on the way. Leapfrog with implicit drag:
v ← [(1 − c Δt/2) v + Δt f/m]/(1 + c Δt/2), x ← x + Δt v.

With lagged velocities a mode of stiffness κ and damping c by its mass is stable while
4 − 2 c Δt − κ Δt² > 0. The largest κ (walls, contacts and fluid) and the largest c of all modes,
taken together, give a limit on the safe side.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from math import sqrt

import numpy as np

from surrofe2.base.arrays import Array, Flags, Index
from surrofe2.base.errors import SimulationError
from surrofe2.plant_cell.arrangement import Arrangement, ReferenceState, rim_areas
from surrofe2.plant_cell.parameters import CellParameters
from surrofe2.tissue.dynamics import TissueDynamics
from surrofe2.tissue.layout import Tissue, make_tissue
from surrofe2.tissue.pair_lists import ELASTIC

STRETCH = 50
"""Steps between two estimates of the slowest mode."""
LIMIT = 200_000
"""Steps after which relaxation gives up."""
HALVINGS = 4
"""Most halvings of a step that turns out unstable."""
_STEP = 0.36
"""Step times √(k/m) of the wall. Undamped springs alone are stable up to 1; contacts and fluid add
to their stiffness."""
_FIRST_DRAG = 0.02
"""First drag over √(k/m)."""
_LEAST_DRAG = 1e-4
_LARGEST_DRAG = 0.1
"""Bounds of later drags over √(k/m), in case an estimate of the slowest mode is far off."""

LONGEST = 2e-3
"""Longest step that is chosen, µs; accuracy needs no shorter one on the paper's cells."""
OF_LIMIT = 0.87
"""Fraction of the stable step at rest that may be taken, as deformed cells are stiffer. `LONGEST`
is this fraction of the stable step of `printed`."""
_SIZINGS = 5
"""Most corrections of rest lengths for the area at rest to be that of an image."""
_SAME_SIZE = 0.005
"""Relative difference of these areas that may remain."""
_ROUGHLY = 1e-4
"""Force that may remain on a particle in these corrections, over the tension of a wall."""
_POWERS = 100
"""Power iterations for a largest eigenvalue."""
_SHIFT = 1e-6
"""Displacement, µm, of the differences of forces by which stiffness is estimated."""

_log = logging.getLogger(__name__)


def relax(dynamics: TissueDynamics, residual: float) -> Array:
    """Bring all particles to rest in a stable equilibrium.

    Args:
        dynamics: the tissue; it starts at rest where it is and ends at rest in equilibrium.
        residual: largest force that may remain on a free particle, µN.

    Returns:
        (particles, 2) positions, µm.

    Raises:
        SimulationError: no equilibrium within `LIMIT` steps, or the tissue collapses.
    """
    tissue = dynamics.tissue
    start = dynamics.x
    stiffest = max(each.wall_stiffness for each in tissue.types)
    # the mass of a whole wall particle: a boundary halves springs and masses alike
    lightest = min(each.wall_particle_mass for each in tissue.types)
    frequency = np.sqrt(stiffest / lightest)
    for halvings in range(HALVINGS + 1):
        try:
            return _settle(dynamics, residual, _STEP / frequency / 2**halvings, frequency)
        except SimulationError as error:
            _log.info("relaxation: %s; trying half the step", error)
            dynamics.place(start)
    raise SimulationError(
        f"tissue: the unloaded tissue does not come to rest within {residual:g} µN; "
        "check the parameters of the plant cell, or raise tissue.residual"
    )


def _settle(dynamics: TissueDynamics, residual: float, step: float, frequency: float) -> Array:
    """Relax with one step, µs; return the positions (particles, 2), µm.

    frequency: √(k/m) of the wall, 1/µs, by which drags are measured.

    Raises:
        SimulationError: no equilibrium within `LIMIT` steps, or the tissue collapses.
    """
    mass = dynamics.mass[:, None]
    drag = _FIRST_DRAG * frequency
    x = dynamics.x
    f = dynamics.forces(ELASTIC)
    for _ in range(0, LIMIT, STRETCH):
        implicit = 1.0 + 0.5 * drag * step
        drifts = np.full(STRETCH, step)
        dynamics.leap(
            drifts / implicit, drifts, factors=ELASTIC,
            retained=(1.0 - 0.5 * drag * step) / implicit,
        )  # fmt: skip
        x_before = x
        f_before = f
        x = dynamics.x
        f = dynamics.forces(ELASTIC)
        if np.hypot(*(f * dynamics.free).T).max() <= residual:
            dynamics.place(x)
            return x
        # critical drag 2 ω of the mode that still moves, ω² = −Δx·Δf/(Δx·m Δx)
        moved = x - x_before
        stiffness = -float(np.sum(moved * (f - f_before)))
        omega_squared = max(stiffness, 0.0) / float(np.sum(mass * moved * moved))
        drag = 2.0 * np.sqrt(omega_squared)
        drag = float(np.clip(drag, _LEAST_DRAG * frequency, _LARGEST_DRAG * frequency))
    raise SimulationError("no equilibrium within the limit of steps")


def rounded_step(limit: float) -> float:
    """Return `LONGEST`, or `OF_LIMIT` of the limit if that is less, rounded down to two digits, µs.

    limit: longest stable step at rest, µs.
    """
    longest = OF_LIMIT * limit
    if longest >= LONGEST:
        return LONGEST
    unit = 10.0 ** (np.floor(np.log10(longest)) - 1.0)  # of the second digit
    return float(f"{np.floor(longest / unit) * unit:.2g}")


def outlined_tissue(
    cell: CellParameters,
    kind: Index,
    arrangement: Arrangement,
    reference: ReferenceState | None = None,
) -> Tissue:
    """Make a tissue whose walls follow the outlines of an image, with its size at rest.

    A spring of length l has the rest length r l, with one r for all. It is chosen so that plant
    cells that are surrounded by others have the area of the image when the tissue has come to rest
    without load; where there are none, so that forces have no mean pressure as laid out. Shapes
    change a little, as walls straighten and those along the outline bulge.

    Args:
        kind: (1, 1, polygons) 0 of plant cells, −1 of air.
        reference: reference state of such a tissue, so that r need not be computed again; None:
            there is none.

    Raises:
        SimulationError: the tissue does not come to rest.
    """

    if reference is not None:
        return make_tissue([cell], [reference], kind, arrangement=arrangement)

    def tissue_of(ratio: float) -> Tissue:
        """Return the tissue with the rest length `ratio` over length."""
        stretched = ReferenceState(
            cell.fingerprint,
            arrangement.wall_position,
            arrangement.tessellation.lattice,
            ratio * cell.spring_length,
        )
        return make_tissue([cell], [stretched], kind, arrangement=arrangement)

    is_inside = _surrounded(arrangement, kind[0, 0] == 0)
    wanted = float(arrangement.tessellation.areas[is_inside].sum())
    tension = cell.sound_speed**2 * cell.fluid_density * cell.cell_side
    ratio = _without_pressure(tissue_of)
    tissue = tissue_of(ratio)
    if not is_inside.any():
        return tissue
    for _ in range(_SIZINGS):
        # rims number the particles of the whole image, of which the mesh may hold a part
        position = np.zeros((tissue.particles_per_period, 2))
        position[tissue.address[:, 1]] = relax(TissueDynamics(tissue), _ROUGHLY * tension)
        areas = rim_areas(arrangement.rims, position, np.eye(2))
        relative_area = float(areas[is_inside].sum()) / wanted
        if abs(relative_area - 1.0) < _SAME_SIZE:
            break
        # lengths go as the root of areas
        ratio /= sqrt(relative_area)
        tissue = tissue_of(ratio)
    return tissue


def _surrounded(arrangement: Arrangement, is_cell: Flags) -> Flags:
    """Return (polygons,) which plant cells have no particle in common with air."""
    at_air = np.zeros(arrangement.walls, dtype=np.bool_)
    for rim, is_plant_cell in zip(arrangement.rims, is_cell, strict=True):
        if not is_plant_cell:
            at_air[rim[:, 0]] = True
    inside = [not at_air[rim[:, 0]].any() for rim in arrangement.rims]
    return is_cell & np.array(inside)


def _without_pressure(tissue_of: Callable[[float], Tissue]) -> float:
    """Return the rest length over length at which forces have no mean pressure, as laid out.

    tissue_of: makes the tissue with such a ratio. The mean pressure is proportional to Σ x·f.
    """

    def virial(tissue: Tissue) -> float:
        """Return Σ x·f."""
        dynamics = TissueDynamics(tissue)
        return float(np.sum(dynamics.x * dynamics.forces(ELASTIC)))

    # forces are linear in the rest lengths
    virial_of_none = virial(tissue_of(0.0))
    virial_of_whole = virial(tissue_of(1.0))
    return virial_of_none / (virial_of_none - virial_of_whole)


def stable_step(
    cell: CellParameters, reference: ReferenceState, outside: tuple[float, float] = (0.0, 0.0)
) -> float:
    """Return the longest stable step of two by two RVEs at rest, µs.

    Args:
        outside: largest stiffness and damping, over mass, that contact and foundations add on the
            outline, 1/µs² and 1/µs.
    """
    kind = np.zeros((2, 2, cell.cells), dtype=np.int64)
    return stable_step_of(make_tissue([cell], [reference], kind), outside)


def stable_step_of(tissue: Tissue, outside: tuple[float, float] = (0.0, 0.0)) -> float:
    """Return the longest stable step of a tissue where it starts, µs.

    It is the Δt of 4 − 2 c Δt − κ Δt² = 0, with the largest κ and c; `outside` as of `stable_step`.
    """
    dynamics = TissueDynamics(tissue)
    at_rest = dynamics.x

    def stiffness(u: Array) -> Array:
        """Return K u, by a central difference of the forces."""
        dynamics.place(at_rest + _SHIFT * u)
        ahead = dynamics.forces()
        dynamics.place(at_rest - _SHIFT * u)
        return (dynamics.forces() - ahead) / (2.0 * _SHIFT)

    def damping(v: Array) -> Array:
        """Return C v: forces are linear in velocities."""
        dynamics.place(at_rest, v)
        moving = dynamics.forces()
        dynamics.place(at_rest)
        return dynamics.forces() - moving

    mass = dynamics.mass[:, None]
    outside_stiffness, outside_damping = outside
    kappa = _largest(stiffness, mass) + outside_stiffness
    c = _largest(damping, mass) + outside_damping
    return (sqrt(c * c + 4.0 * kappa) - c) / kappa


def _largest(product: Callable[[Array], Array], mass: Array) -> float:
    """Return the largest eigenvalue of a matrix over the masses (n, 1), by power iteration.

    product: returns the matrix times a vector (n, 2).
    """
    u = np.random.default_rng(1).standard_normal((len(mass), 2))
    largest = 0.0
    for _ in range(_POWERS):
        u /= np.sqrt((mass * u * u).sum())
        force = product(u)
        if not force.any():
            return 0.0
        largest = max(largest, float((u * force).sum()))
        u = force / mass
    return largest

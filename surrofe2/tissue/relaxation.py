"""The tissue at rest without load, `relax`, and the longest step that it bears, `stable_step`.

`relax` is adaptive dynamic relaxation: a drag −c m v in place of dashpots and viscosity, critical
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
"""How often a step that turns out unstable is halved."""
_STEP = 0.36
"""Step times √(k/m) of the wall; undamped springs are stable up to 1."""
_FIRST_DRAG = 0.02
"""First drag, times √(k/m)."""

LONGEST = 2e-3
"""µs; accuracy needs no less on the paper's cells."""
OF_LIMIT = 0.87
"""Of the limit at rest, as deformed cells are stiffer; `LONGEST` takes as much of `printed`'s."""
_SIZINGS = 5
_SAME_SIZE = 0.005
_ROUGHLY = 1e-4
"""How often rest lengths are corrected until the area at rest is that of an image, the relative
difference that is left, and the force left on a particle then, of a wall's tension."""
_POWERS = 100
_SHIFT = 1e-6  # µm, of differences

_log = logging.getLogger(__name__)


def relax(dynamics: TissueDynamics, residual: float) -> Array:
    """Bring all particles to rest in a stable equilibrium; (particles, 2) positions, µm.

    Args:
        dynamics: starts at rest where it is and ends at rest in equilibrium.
        residual: largest force that may remain on a free particle, µN.

    Raises:
        SimulationError: no equilibrium within `LIMIT` steps, or the tissue collapses.
    """
    tissue = dynamics.tissue
    start = dynamics.x
    stiffest = max(each.wall_stiffness for each in tissue.types)
    # Of wall particles, which are whole inside; a boundary halves springs and masses alike.
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
        moved = x - x_before
        stiffness = -float(np.sum(moved * (f - f_before)))
        square = max(stiffness, 0.0) / float(np.sum(mass * moved * moved))
        drag = float(np.clip(2.0 * np.sqrt(square), 1e-4 * frequency, 0.1 * frequency))
    raise SimulationError("no equilibrium within the limit of steps")


def rounded_step(limit: float) -> float:
    """`LONGEST`, or what is borne for sure if that is less, rounded down to two digits, µs."""
    wanted = OF_LIMIT * limit
    if wanted >= LONGEST:
        return LONGEST
    unit = 10.0 ** (np.floor(np.log10(wanted)) - 1.0)
    return float(f"{np.floor(wanted / unit) * unit:.2g}")


def outlined_tissue(
    cell: CellParameters,
    kind: Index,
    arrangement: Arrangement,
    reference: ReferenceState | None = None,
) -> Tissue:
    """A tissue whose walls follow the outlines of an image, with rest lengths that keep its size.

    A spring of length l has the rest length r l, with one r for all: that at which the plant cells
    that are surrounded by others have the area of the image when the tissue has come to rest
    without load; where there are none, that at which forces have no mean pressure as laid out.
    Shapes change a little, as walls straighten and those along the outline bulge.

    Args:
        kind: (1, 1, polygons) 0 of plant cells, −1 of air.
        reference: that of such a tissue, which need not be sought again; None: there is none.

    Raises:
        SimulationError: the tissue does not come to rest.
    """

    def stretched(part: float) -> Tissue:
        made = ReferenceState(
            cell.fingerprint,
            arrangement.wall_position,
            arrangement.tessellation.lattice,
            part * cell.spring_length,
        )
        return make_tissue([cell], [reference or made], kind, arrangement=arrangement)

    if reference is not None:
        return stretched(0.0)
    is_inside = _surrounded(arrangement, kind[0, 0] == 0)
    wanted = float(arrangement.tessellation.areas[is_inside].sum())
    tension = cell.sound_speed**2 * cell.fluid_density * cell.cell_side
    part = _without_pressure(stretched)
    tissue = stretched(part)
    for _ in range(_SIZINGS if is_inside.any() else 0):
        rest = np.zeros((tissue.particles, 2))
        rest[tissue.address[:, 1]] = relax(TissueDynamics(tissue), _ROUGHLY * tension)
        size = float(rim_areas(arrangement.rims, rest, np.eye(2))[is_inside].sum()) / wanted
        if abs(size - 1.0) < _SAME_SIZE:
            break
        part /= sqrt(size)
        tissue = stretched(part)
    return tissue


def _surrounded(arrangement: Arrangement, is_cell: Flags) -> Flags:
    """(polygons,) which plant cells have no particle in common with air."""
    at_air = np.zeros(arrangement.walls, dtype=np.bool_)
    for rim, there in zip(arrangement.rims, is_cell, strict=True):
        if not there:
            at_air[rim[:, 0]] = True
    inside = [not at_air[rim[:, 0]].any() for rim in arrangement.rims]
    return is_cell & np.array(inside)


def _without_pressure(stretched: Callable[[float], Tissue]) -> float:
    """Rest length over length at which forces have no mean pressure as laid out: Σ x·f = 0."""

    def virial(tissue: Tissue) -> float:
        dynamics = TissueDynamics(tissue)
        return float(np.sum(dynamics.x * dynamics.forces(ELASTIC)))

    # forces are linear in the rest lengths
    without = virial(stretched(0.0))
    whole = virial(stretched(1.0))
    return without / (without - whole)


def stable_step(
    cell: CellParameters, reference: ReferenceState, outside: tuple[float, float] = (0.0, 0.0)
) -> float:
    """The longest stable step of two by two RVEs at rest, µs.

    Args:
        outside: the largest stiffness and damping by mass that what acts on the outline adds, 1/µs²
            and 1/µs.
    """
    kind = np.zeros((2, 2, cell.cells), dtype=np.int64)
    return stable_step_of(make_tissue([cell], [reference], kind), outside)


def stable_step_of(tissue: Tissue, outside: tuple[float, float] = (0.0, 0.0)) -> float:
    """The longest stable step of a tissue where it starts, µs; `outside` as of `stable_step`."""
    dynamics = TissueDynamics(tissue)
    at_rest = dynamics.x

    def stiffness(u: Array) -> Array:
        dynamics.place(at_rest + _SHIFT * u)
        ahead = dynamics.forces()
        dynamics.place(at_rest - _SHIFT * u)
        return (dynamics.forces() - ahead) / (2.0 * _SHIFT)

    def damping(v: Array) -> Array:
        dynamics.place(at_rest, v)
        moving = dynamics.forces()
        dynamics.place(at_rest)
        return dynamics.forces() - moving

    mass = dynamics.mass[:, None]
    kappa, c = (_largest(product, mass) for product in (stiffness, damping))
    kappa = kappa + outside[0]
    c = c + outside[1]
    return (sqrt(c * c + 4.0 * kappa) - c) / kappa


def _largest(product: Callable[[Array], Array], mass: Array) -> float:
    """Largest eigenvalue of a matrix by the masses (n, 1), by power iteration."""
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

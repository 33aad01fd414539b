"""The law of contact with a rigid body: formulas of whole arrays, and of numbers in kernels.

Contact acts at points of a boundary, by unloaded length. A spring and a dashpot resist that a point
of the depth d comes closer, (A24) of docs/theory.md, with a continuous slope by d and by ḋ; they
never pull. The spring's part is the slope of an energy (Hunt and Crossley, J. Appl. Mech. 42 (1975)
440–445, have the form). Friction against the sliding velocity follows Coulomb's law where sliding
is fast and creeps where it is slow, (A25).

A gap comes with its gradient, the outward normal, and the curvature of its level line.
"""

from __future__ import annotations

from typing import Any, TypeVar

import numpy as np
from numba.extending import overload, register_jitable

from surrofe2.base.arrays import Array
from surrofe2.base.compilation import OPTIONS

Real = TypeVar("Real", float, Array)
formula = register_jitable(**OPTIONS)  # of arrays and, called in kernels, of numbers
TINY = float(np.finfo(float).tiny)  # keeps a quotient finite where both numbers are 0


def where(condition: Any, yes: Any, no: Any) -> Any:
    """Return np.where; of numbers in a kernel, one of both."""
    return np.where(condition, yes, no)


@overload(where, jit_options=OPTIONS, strict=False)
def _where(condition: Any, yes: Any, no: Any) -> Any:
    """Compile `where` for kernels."""
    return lambda condition, yes, no: yes if condition else no


@formula
def pressure(d: Real, closing: Real, law: tuple[float, float, float]) -> tuple[Real, Real, Real]:
    """Compute the pressure, and its slopes by depth and by the speed of closing.

    Args:
        d: depth, at least 0, µm.
        closing: speed of closing ḋ, µm/µs.
        law: stiffness k, µN/µm²; smoothing δ, µm; damping c, µN µs/µm².

    Returns:
        Pressure, µN/µm; its slope by d; its slope by ḋ.
    """
    k, delta, c = law
    near = np.minimum(d / delta, 1.0)
    spring = np.maximum(k * (d - delta * near * (1.0 - 0.5 * near)), 0.0)  # rounding may pull
    dashpot = c * near**2 * (3.0 - 2.0 * near) * closing
    total = np.maximum(spring - np.minimum(dashpot, 0.0), TINY)
    value = where(dashpot < 0.0, spring**2 / total, spring + dashpot)
    share = spring / total
    by_dashpot = share**2
    by_spring = share * (2.0 - share)
    growing = c * closing * 6.0 * near * (1.0 - near) / delta
    by_depth = by_spring * k * near + by_dashpot * growing
    return value, by_depth, by_dashpot * c * near**2 * (3.0 - 2.0 * near)


@formula
def stored(d: Real, k: float, delta: float) -> Real:
    """Compute the energy of the spring by length at the depth d ≥ 0, µN."""
    far = 0.5 * d**2 - 0.5 * delta * d + delta**2 / 6.0
    return k * where(d < delta, d**3 / (6.0 * delta), far)


@formula
def friction(pressed: Real, sliding: Real, law: tuple[float, float]) -> tuple[Real, Real, Real]:
    """Compute the friction against `sliding` (µm/µs), and its slopes by the pressure and by
    sliding.

    Args:
        pressed: pressure, µN/µm.
        law: Coulomb's coefficient µ; slip speed s, µm/µs.
    """
    coefficient, slip = law
    size = np.hypot(sliding, slip)
    share = coefficient * sliding / size
    return share * pressed, share, coefficient * pressed * slip**2 / size**3


@formula
def gap(x: Real, y: Real, outline: Any) -> tuple[Real, Real, Real, Real]:
    """Compute gap, normal (two) and curvature at points relative to a body's position.

    Every outline is a rounded wedge: the distance from a sharp one less the radius, with the tip of
    the rounding at the body's position. A half plane is a wedge of 180° without rounding, a disc is
    a tip without flanks.

    Args:
        outline: unit axis into the body (two, zero of a disc), cosine and sine of half the angle,
            radius (µm), and how far along the flanks the tip reaches, 0 or infinity (µm).
    """
    axis_x = outline[0]
    axis_y = outline[1]
    cosine = outline[2]
    sine = outline[3]
    radius = outline[4]
    reach = outline[5]
    # from the middle of the rounding
    x = x - radius * axis_x
    y = y - radius * axis_y
    side = where(axis_x * y - axis_y * x >= 0.0, 1.0, -1.0)
    across_x = -side * axis_y
    across_y = side * axis_x
    along = x * (cosine * axis_x + sine * across_x) + y * (cosine * axis_y + sine * across_y)
    at_tip = along < reach
    flank_x = cosine * across_x - sine * axis_x
    flank_y = cosine * across_y - sine * axis_y
    distance = np.maximum(np.sqrt(x * x + y * y), TINY)
    return (
        where(at_tip, distance, x * flank_x + y * flank_y) - radius,
        where(at_tip, x / distance, flank_x),
        where(at_tip, y / distance, flank_y),
        where(at_tip, 1.0 / distance, 0.0),
    )

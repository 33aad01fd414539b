"""Quasi-static equilibrium: the load in steps, Newton with line search at each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_matrix

from surrofe2.errors import InputError, SimulationError
from surrofe2.load_case import LoadCase
from surrofe2.macro.mesh import Bar, make_bar
from surrofe2.macro.right_hand_side import (
    Evaluation,
    RightHandSide,
    SwitchedError,
    Tally,
    TrialError,
)
from surrofe2.macro.settings import SECTION_6_2, MacroSettings
from surrofe2.macro.tangent_assembly import (
    Pattern,
    assembled_tangents,
    factorised,
    make_pattern,
)
from surrofe2.stress_law import StressLaw, require_tangents

Array = NDArray[np.float64]

MAX_HALVINGS = 10
MAX_ITERATIONS = 20
_LEAST_FRACTION = 1.0 / 64.0
_DECREASE = 1e-4


@dataclass(frozen=True, slots=True)
class Rest:
    """The bar at rest under a constant load.

    Attributes:
        bar: mesh, mass and load.
        factor: factor of the body force.
        u: (n_free, 2) displacement of the free nodes, µm.
        F, stress: (n_points, 2, 2) deformation gradient; Cauchy stress, µN/µm.
        stiffness, damping: (2 n_free, 2 n_free) K = ∂f/∂u and C = ∂f/∂v there.
        path: (steps + 1, 3) factor and displacement of the watched point at each load step, from
            (0, 0, 0) on.
        residuals: of Newton's iterations in the last load step, relative to the largest force.
        counts: load steps, halvings, Newton iterations.
    """

    bar: Bar
    factor: float
    u: Array
    F: Array
    stress: Array
    stiffness: csc_matrix
    damping: csc_matrix
    path: Array
    residuals: tuple[float, ...]
    counts: dict[str, int]

    @property
    def watched(self) -> Array:
        """(2,) displacement of the watched point, µm."""
        return self.bar.at_watched_point(self.u)


def find_rest(
    load_case: LoadCase,
    law: StressLaw,
    settings: MacroSettings = SECTION_6_2,
    *,
    factor: float = 1.0,
    load_steps: int = 1,
    reached: Callable[[Rest], None] | None = None,
) -> Rest:
    """Equilibrium internal force(u, v = 0) = factor · load, reached from factor 0.

    Each load step starts from the last equilibrium; Newton's correction is halved until the
    residual falls and every point has a stress, and a load step that cannot be solved is halved.

    Args:
        factor: of the body force; 0 is the bar without load. The load case's amplitude in time
            has no say here.
        load_steps: load steps to begin with.
        reached: called with each equilibrium on the way, the one without load first.

    Raises:
        InputError: the law has no tangents.
        SimulationError: a load step halved ten times finds no equilibrium; `partial` is the last
            `Rest`.
    """
    require_tangents(law, "rest")
    if not np.isfinite(factor):
        raise InputError(f"factor: {factor}; it must be finite")
    if load_steps < 1:
        raise InputError(f"load_steps: {load_steps}; it must be at least 1")
    bar = make_bar(load_case, settings.elements, law.density)
    tally = Tally()
    rhs = RightHandSide(bar, law, lambda x: x, tally, clock="load factor {:.6g}")
    pattern = make_pattern(bar)
    path = np.zeros((1, 3))
    try:
        rest = _rest_of(rhs, pattern, 0.0, np.zeros((len(bar.free), 2)), settings, path)
    except TrialError as failure:
        raise SimulationError(f"the load cannot start: {failure}") from None
    if reached is not None:
        reached(rest)
    step, failed = factor / load_steps, False
    while rest.factor != factor:
        left = factor - rest.factor
        target = factor if abs(step) >= abs(left) * (1.0 - 1e-9) else rest.factor + step
        try:
            rest = _rest_of(rhs, pattern, target, rest.u, settings, rest.path)
        except TrialError as failure:
            tally.counts["halvings"] += 1
            step, failed = 0.5 * (target - rest.factor), True
            # Counted from the first length: near a limit load every second step would succeed.
            if abs(step) < abs(factor) / load_steps * 0.5**MAX_HALVINGS:
                raise SimulationError(
                    f"no load step succeeds after {MAX_HALVINGS} halvings: {failure}", partial=rest
                ) from None
        else:
            if reached is not None:
                reached(rest)
            step, failed = (step if failed else 2.0 * step), False
            if abs(step) > abs(factor) / load_steps:
                step = factor / load_steps
    return replace(rest, counts=_counts(tally))


def _counts(tally: Tally) -> dict[str, int]:
    return {name: tally.counts[name] for name in ("load_steps", "halvings", "factorisations")}


def _rest_of(
    rhs: RightHandSide,
    pattern: Pattern,
    factor: float,
    u: Array,
    settings: MacroSettings,
    path: Array,
) -> Rest:
    """The equilibrium at `factor` by Newton from u; the law commits it.

    Newton begins anew as long as points leave their branch of the law, and goes on where the
    equilibrium of the bar has lost that of a point.
    """
    while True:
        try:
            now, residuals = _balanced(rhs, pattern, factor, u, settings.newton_tolerance)
        except SwitchedError as found:
            rhs.restart_step(found.switched)
        else:
            break
    K, C = assembled_tangents(rhs.bar, pattern, now.F, now.response)
    rhs.tally.counts["load_steps"] += factor != 0.0
    here = np.append(factor, rhs.bar.at_watched_point(now.u))
    path = np.vstack([path, here]) if factor != path[-1, 0] else path
    return Rest(
        bar=rhs.bar,
        factor=factor,
        u=now.u,
        F=now.F,
        stress=now.response.stress,
        stiffness=K,
        damping=C,
        path=path,
        residuals=tuple(residuals),
        counts=_counts(rhs.tally),
    )


def _balanced(
    rhs: RightHandSide, pattern: Pattern, factor: float, u: Array, tolerance: float
) -> tuple[Evaluation, list[float]]:
    """The equilibrium on one branch of the law, and the residuals on the way to it."""
    now = rhs.evaluate(factor, u, np.zeros_like(u), tangents=True)
    residuals = [_relative_residual(rhs.bar, now)]
    while True:
        while residuals[-1] > tolerance:
            if len(residuals) > MAX_ITERATIONS:
                _give_up(rhs, now, f"Newton did not converge in {MAX_ITERATIONS} iterations")
            now = _corrected(rhs, pattern, now)
            residuals.append(_relative_residual(rhs.bar, now))
        start = rhs.accept()
        if start is now or start.response.left_bifurcation is None:
            return now, residuals
        now = rhs.evaluate(factor, now.u, now.v, tangents=True)
        residuals.append(_relative_residual(rhs.bar, now))


def _corrected(rhs: RightHandSide, pattern: Pattern, now: Evaluation) -> Evaluation:
    """Newton's correction, halved until the residual is smaller and every point has a stress."""
    residual = now.internal - now.load
    K, _ = assembled_tangents(rhs.bar, pattern, now.F, now.response)
    rhs.tally.counts["factorisations"] += 1
    solve = factorised(K)
    if solve is None:
        _give_up(rhs, now, "the stiffness of the bar is singular")
    correction = solve(residual.ravel()).reshape(residual.shape)
    size = np.linalg.norm(residual)
    fraction, reason = 1.0, "the line search found no smaller residual"
    while fraction >= _LEAST_FRACTION:
        try:
            trial = rhs.evaluate(now.t, now.u - fraction * correction, now.v, tangents=True)
        except TrialError as failure:
            reason = str(failure)
        else:
            if np.linalg.norm(trial.internal - trial.load) <= (1.0 - _DECREASE * fraction) * size:
                return trial
        fraction *= 0.5
    return _give_up(rhs, now, reason)


def _relative_residual(bar: Bar, now: Evaluation) -> float:
    """Largest residual relative to the largest of internal force, load, and load at factor 1.

    A bar without any body force takes 1 µm/µs² for its load.
    """
    load = abs(bar.load).max() or bar.mass.sum(axis=1).max()
    scale = max(load, abs(now.internal).max(), abs(now.load).max())
    return float(abs(now.internal - now.load).max() / scale)


def _give_up(rhs: RightHandSide, now: Evaluation, reason: str) -> NoReturn:
    row = int(abs(now.internal - now.load).max(axis=1).argmax())
    rhs.fail(now.t, rhs.bar.point_near(row), now.F, reason)

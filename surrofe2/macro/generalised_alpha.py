"""Generalised-α: one implicit step by full Newton, with its error (docs/theory.md, (A26)).

Chung and Hulbert, A time integration algorithm for structural dynamics with improved numerical
dissipation, J. Appl. Mech. 60 (1993) 371–375, the forces averaged between the ends of the step. The
algorithmic acceleration a is not ü; it lags by (α_m − α_f) h, to second order.

A step of h leaves the error of [u, v] that a third-order method finds: the integral of the
parabola through the rates [v, ü] at the last three ends of steps (Adams–Moulton), minus the step.
Stiff modes would drown it, so it passes through S⁻¹ (1 − α_m) M, S the Newton matrix, which
leaves slow modes as they are and damps fast ones.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, NamedTuple

import numpy as np
import scipy  # scipy.sparse is loaded where a step is implicit

from surrofe2.base.arrays import Array
from surrofe2.law.stress_law import require_tangents
from surrofe2.macro.equations_of_motion import (
    EquationsOfMotion,
    Evaluation,
    Switched,
    factorised,
)
from surrofe2.macro.settings import MacroSettings
from surrofe2.macro.system import Works
from surrofe2.macro.time_stepping import StepControl, StepResult

MAX_ITERATIONS = 12  # of Newton's method in a step
# Errors of steps add up over an oscillation, so each may take only this fraction of the tolerance.
_ACCUMULATION = 25.0
# Length of the first step: where nothing accelerates, this fraction of the run; else so short that
# the acceleration moves something by five times the absolute tolerance.
_FIRST_FRACTION = 1e-2
_FIRST_GAIN = 10.0


class Weights(NamedTuple):
    """The weights α_m, α_f, β, γ; of second order and unconditionally stable for linear
    problems.
    """

    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float

    @classmethod
    def of(cls, spectral_radius: float) -> Weights:
        """Return the weights whose amplification at infinite frequency is `spectral_radius`."""
        rho = spectral_radius
        alpha_m = (2.0 * rho - 1.0) / (rho + 1.0)
        alpha_f = rho / (rho + 1.0)
        shift = alpha_f - alpha_m
        return cls(alpha_m, alpha_f, 0.25 * (1.0 + shift) ** 2, 0.5 + shift)


class Solved(NamedTuple):
    """The end of a step.

    Attributes:
        now: its evaluation.
        a: (m,) algorithmic acceleration, µm/µs².
        residual: (m,) residual with which Newton's method ended, µN.
        solve: S⁻¹ of the last correction, applied to (m,).
    """

    now: Evaluation
    a: Array
    residual: Array
    solve: Callable[[Array], Array]


class _Past(NamedTuple):
    """The step before.

    Attributes:
        h: its length, µs; 1 if there is none.
        a: (m,) algorithmic acceleration at its end.
        rate: (2 m,) [v, ü] at its start; None if there is none.
    """

    h: float
    a: Array
    rate: Array | None


def _past(start: Evaluation, memory: Array) -> _Past:
    """Read the step before from the memory it left: h, a, and the rates at both of its ends.

    Where the law has changed its branch since, what was known moves by the jump of the rate, so
    that neither the error nor the first guess of the next step takes it for a motion.
    """
    rate = start.rate
    size = start.y.size
    if memory.size == 0:
        return _Past(1.0, start.acceleration, None)
    m = size // 2
    h, a, rate_before, rate_after = np.split(memory, [1, 1 + m, 1 + m + size])
    jump = rate - rate_after
    return _Past(float(h[0]), a + jump[m:], rate_before + jump)


class GeneralisedAlpha:
    """The implicit `Method`.

    Raises:
        InputError: the law has no tangents.
    """

    control: ClassVar[StepControl] = StepControl(
        order=3, gain=1.0, largest_growth=2.0, splits_rest=True
    )

    def __init__(self, equations: EquationsOfMotion, settings: MacroSettings) -> None:
        require_tangents(equations.law, "integrator implicit")
        self.weights = Weights.of(settings.spectral_radius)
        self._settings = settings
        self._equations = equations
        self._mass = equations.system.free_mass
        self._inertia = (1.0 - self.weights.alpha_m) * self._mass

    def first_length(self, start: Evaluation, t_end: float) -> float:
        """Return a length by the largest acceleration, see `_FIRST_FRACTION` and `_FIRST_GAIN`."""
        limit = _FIRST_FRACTION * t_end
        strongest = float(abs(start.acceleration).max())
        if strongest == 0.0:
            return limit
        gain = _FIRST_GAIN * self._settings.absolute_tolerance
        return min(limit, float(np.sqrt(gain / strongest)))

    def step(
        self, start: Evaluation, memory: Array, t: float, restarted: Switched | None = None
    ) -> StepResult:
        """Make the step from `start` to time t; see `Method.step`."""
        h = t - start.t
        past = _past(start, memory)
        # The algorithmic acceleration, its lag brought from the last step's to this one's; at the
        # end of the step it is carried on straight, or as where the step was restarted.
        a = start.acceleration + h / past.h * (past.a - start.acceleration)
        guess = a
        if restarted is not None:
            beta = self.weights.beta
            u, v = np.split(start.y, 2)
            known = u + h * v + h**2 * (0.5 - beta) * a
            guess = (restarted.y[: u.size] - known) / (h**2 * beta)
        elif past.rate is not None:
            before = past.rate[past.rate.size // 2 :]
            guess = a + h / past.h * (start.acceleration - before)
        solved = self.solve(start, a, guess, t)
        end = solved.now
        return StepResult(
            start=start,
            end=end,
            error=self._error(start, past, solved, h),
            mean_power=self._works(start, solved) / h,
            bulge=0.0,
            power_bulge=0.0,
            memory=np.concatenate([[h], solved.a, start.rate, end.rate]),
        )

    def solve(self, start: Evaluation, a: Array, guess: Array, t: float) -> Solved:
        """Solve the step to time t from `start` with algorithmic acceleration a.

        Args:
            guess: (m,) acceleration at the end that Newton begins with.

        Raises:
            NoStress: a point has none, or Newton does not converge.
            Switched: as of `EquationsOfMotion.evaluate`.
        """
        w = self.weights
        equations = self._equations
        h = t - start.t
        u, v = np.split(start.y, 2)
        u_known = u + h * v + h**2 * (0.5 - w.beta) * a
        v_known = v + h * (1.0 - w.gamma) * a
        # the part of (A26) that the start of the step gives
        before = w.alpha_m * (self._mass @ a) - w.alpha_f * start.residual
        a_end = guess
        for iteration in range(MAX_ITERATIONS + 1):
            y = np.concatenate([u_known + h**2 * w.beta * a_end, v_known + h * w.gamma * a_end])
            now = equations.evaluate(t, y, tangents=True)
            inertia = self._inertia @ a_end
            residual = before + inertia - (1.0 - w.alpha_f) * now.residual
            # once in any case, since the error of the step is filtered by it
            if iteration == 0:
                solve, floor = self._factorised(now, h)
            forces = (now.internal, now.forces, inertia, before)
            scale = max(floor, *(abs(force).max(initial=0.0) for force in forces))
            converged = abs(residual).max() <= self._settings.newton_tolerance * scale
            if iteration > 0 and not converged:
                solve, floor = self._factorised(now, h)
            if solve is None:
                reason = "Newton near this point: the matrix is singular"
                raise equations.out_of_balance(now, residual, reason)
            if converged:
                return Solved(now, a_end, residual, solve)
            a_end = a_end - solve(residual)
        reason = f"Newton near this point: no convergence in {MAX_ITERATIONS} iterations"
        raise equations.out_of_balance(now, residual, reason)

    def _works(self, start: Evaluation, solved: Solved) -> Array:
        """Return a row of `Works` of a step, pJ: mean force times displacement, and impulses.

        Inertia is that of the method, which leaves Newton's residual. At spectral radius 1 its work
        is the gain of kinetic energy.
        """
        end = solved.now
        equations = self._equations
        system = equations.system
        moved = 0.5 * (end.u - start.u)  # half, since the sums below are twice the mean
        motion = 0.0
        if system.moving:
            reactions = equations.reaction(start) + equations.reaction(end)
            motion = float(np.vdot(reactions, moved))
        inertia = float(np.vdot(equations.inertia(start) + equations.inertia(end), moved))
        inertia += float(2.0 * system.pick(moved) @ solved.residual)
        return Works(
            internal=float(np.vdot(start.internal + end.internal, moved)),
            forces=np.einsum("kni,ni->k", start.forces + end.forces, moved),
            motion=motion,
            inertia=inertia,
            impulses=0.5 * (end.t - start.t) * (start.powers.impulses + end.powers.impulses),
        ).row

    def _factorised(
        self, now: Evaluation, h: float
    ) -> tuple[Callable[[Array], Array] | None, float]:
        """Factorise the Newton matrix S = (1 − α_m) M + (1 − α_f) h² β (K + γ/(h β) C).

        S is the slope of the residual by the acceleration at the end.

        Returns:
            S⁻¹, applied to (m,), None if S is singular; and the least scale of a residual: the
            force that moves the stiffest unknown by what the tolerance allows, for a body at rest
            has no other.
        """
        w = self.weights
        K = self._equations.slope(now, 1.0, 1.0 / (h * w.beta / w.gamma))
        S = self._inertia + (1.0 - w.alpha_f) * h**2 * w.beta * K
        self._equations.tally.counts["factorisations"] += 1
        acceleration = self._settings.absolute_tolerance / (h**2 * w.beta)
        least = float(abs(S.diagonal()).max()) * acceleration
        return factorised(scipy.sparse.csc_matrix(S)), least

    def _error(self, start: Evaluation, past: _Past, solved: Solved, h: float) -> float:
        """Compute the root mean square of the error of y relative to what is allowed."""
        end = solved.now
        # Mean rate over the step, (start + end)/2 − h²/6 [before, start, end] with the second
        # divided difference; without a step before, the straight line has to do.
        if past.rate is None:
            error = 0.5 * h * (end.rate - start.rate)
        else:
            curvature = (end.rate - start.rate) / h - (start.rate - past.rate) / past.h
            mean = 0.5 * (start.rate + end.rate) - h**2 / 6.0 * curvature / (h + past.h)
            error = end.y - start.y - h * mean
        settings = self._settings
        size = np.maximum(abs(end.y), abs(start.y))
        scale = settings.absolute_tolerance + settings.relative_tolerance * size
        u_error, v_error = np.split(error, 2)
        damped = solved.solve(self._inertia @ v_error)
        relative = np.concatenate([u_error, damped]) / scale
        return _ACCUMULATION * float(np.sqrt(np.mean(relative**2)))
